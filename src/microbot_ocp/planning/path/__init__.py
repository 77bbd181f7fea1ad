"""A given path, and its fastest timing by two passes of reachability.

Comes in: a path of the joints. Goes out: its timing and the limits that decide along it. Begin
with :func:`time_path` in ``_fast_timing.py``; ``_curve.py`` is the path, ``_limits.py`` the limits
along it, ``_reachability.py`` the passes, ``_phase_plane.py`` has them as data,
``_blocked_path.py`` says why a path cannot be travelled.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
