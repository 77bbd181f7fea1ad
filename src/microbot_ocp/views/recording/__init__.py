"""Rerun recordings with one entity tree and one layout; ``docs/recordings.md`` describes both.

Each function in ``_builders`` returns a :class:`Recording` of one kind of result, which is saved to
a file or sent to a stream.
"""

import lazy_loader

from microbot_ocp._base.needed import needed

needed("rerun", "recordings need")
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
