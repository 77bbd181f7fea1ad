"""A given path, and its fastest timing by two passes of reachability.

Input: a path of the joints. Output: its timing and the active limits along it. The entry point is
:func:`time_path` in ``_fast_timing.py``. ``_curve.py`` describes the path, ``_limits.py`` the
limits along it, ``_reachability.py`` the passes; ``_phase_plane.py`` returns both as data, and
``_blocked_path.py`` finds the reason why a path is infeasible.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
