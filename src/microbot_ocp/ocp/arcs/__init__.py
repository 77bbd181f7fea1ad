"""Where controls switch and limits begin or cease to act.

Comes in: a solution on a mesh. Goes out: :class:`Switch` es, mesh points where arcs meet, or
:class:`SwitchingTimes`, the solution with one phase an arc. Begin with
:func:`solve_switching_times`; ``_detector.py`` reads the arcs of a solution, ``_cutter.py`` makes a
phase of each, ``_singular.py`` determines singular arcs by their own conditions.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
