"""Rerun recordings: one entity tree, one layout; ``docs/recordings.md`` describes both.

A kind of recording is a function in ``_builders`` that makes a
:class:`Recording`, which is saved to a file or sent to a stream.
"""

from microbot_ocp._base import border
from microbot_ocp.views._needed import need

need("recordings", "rerun", "rerun-sdk")
__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
