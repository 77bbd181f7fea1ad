"""The free motion as a problem in time, and the initial guesses of a search.

Input: a family of limits and via points. Output: the problem, initial guesses, and motions within
all limits that need no search. ``_problem.py`` states the problem with states, ``_flat_program.py``
without. Guesses come from ``_initial_guesses.py`` and ``_within_limits.py``.
``_least_violation.py`` finds the limits of an infeasible task, ``_switching.py`` solves for
switching times.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
