"""Rerun recordings: one entity tree, one layout; ``docs/recordings.md`` describes both.

A kind of recording is a function in ``_builders`` that makes a
:class:`Recording`, which is saved to a file or sent to a stream.
"""

import lazy_loader

from microbot_ocp.views._needed import need

need("recordings", "rerun", "rerun-sdk")
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
