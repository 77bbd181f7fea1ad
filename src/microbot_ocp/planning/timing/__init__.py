"""The timing of a given path under limits of any form: one program on places of the path.

Input: a path and a family of limits. Output: the motion along it. The entry point is
:func:`time_optimal_path` in ``_path_timing.py``. ``_places_timing.py`` handles torque rates, jerk
and further limits, which the passes of ``planning.path`` cannot, by the program of
``_places_program.py``.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
