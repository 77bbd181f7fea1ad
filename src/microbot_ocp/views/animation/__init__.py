"""Animations: GIF and MP4 files of a recording's arms, seen from the recording's camera.

:func:`write_animation` takes a recording and writes a file; ``motion.export("x.gif")`` and
``comparison.export("x.mp4")`` call it. Begin with ``_film.py``, which draws one frame.
"""

from microbot_ocp._base import border
from microbot_ocp._base.needed import needed

needed("matplotlib", "films need")
__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
