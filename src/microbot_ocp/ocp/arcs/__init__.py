"""Where controls switch and limits begin or cease to act.

Comes in: a solution on a mesh. Goes out: :class:`Switch` es, arcs, or a mesh with points at the
switches. ``_detector.py`` reads them from a solution, ``_mesh_points.py`` moves the points.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
