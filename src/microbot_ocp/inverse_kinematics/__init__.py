"""Inverse kinematics: one solution, every branch, many targets at once, or a line of targets.

The input is a robot and targets: positions with or without orientations. The result is always an
:class:`IKSolution` or an :class:`IKPath`; if a target is missed it holds a status, the nearest pose
and an advice. Begin with ``_solve.py``; ``_kernels.py`` holds the compiled descent and the
nonlinear programs, ``_search.py`` the search of branches, continua and nearest poses.
"""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
