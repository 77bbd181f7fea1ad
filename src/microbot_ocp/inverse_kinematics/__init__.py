"""Joint positions for poses of the tool: one solution, every branch, many targets, a line.

In: a robot and targets, positions with or without orientations. Out: :class:`IKSolution` (or an
:class:`IKPath`), always, with a status, the nearest pose and a sentence where a target is missed.
Begin with ``_solve.py``; ``_kernels.py`` holds the compiled descent and the nonlinear programs,
``_search.py`` what is built of them: branches, continua, nearest poses.
"""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
