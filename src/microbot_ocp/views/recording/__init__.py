"""Rerun recordings: one entity tree, one layout; ``docs/recordings.md`` describes both.

A kind of recording is a function in ``_builders`` that makes a
:class:`Recording`, which is saved to a file or sent to a stream.
"""

import lazy_loader

from microbot_ocp._base.needed import needed

needed("rerun", "recordings need")
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
