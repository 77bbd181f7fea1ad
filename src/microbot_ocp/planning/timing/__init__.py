"""The timing of a given path under any limit: one program on places of the path.

Comes in: a path and a family of limits. Goes out: the motion along it. Begin with
:func:`time_optimal_path` in ``_path_timing.py``; ``_places_timing.py`` keeps torque rates, jerk and
further limits, which the passes of ``planning.path`` cannot, by the program of
``_places_program.py``.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
