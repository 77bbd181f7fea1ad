"""Where controls switch and limits begin or cease to act.

Comes in: a solution on a mesh. Goes out: :class:`Switch` es, mesh points where arcs meet, or a
problem with one phase an arc. ``_detector.py`` reads the arcs of a solution, ``_cutter.py`` makes a
phase of each, ``_mesh_points.py`` puts the points of a mesh where they meet.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
