"""What a solve starts from and what it returns.

Comes in: guesses or an earlier solution, and scaled variables. Goes out: a starting point, and a
:class:`Solution` with values by phase and name. Begin with ``_solution.py``; ``_initial_guess.py``
makes starting points, ``_scaling.py`` finds the scales that were not declared, ``_progress.py``
reports iterations, ``_problem_data.py`` holds limits and parameters as plain values.
"""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
