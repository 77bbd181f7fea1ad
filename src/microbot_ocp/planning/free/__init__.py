"""The free motion as a problem in time, and what a search for it starts from.

Comes in: a family of limits and via points. Goes out: the problem, initial guesses, and motions
that keep every limit without a search. Begin with ``_problem.py``, the problem with states, and
``_flat_program.py``, the same without; ``_initial_guesses.py`` and ``_within_limits.py`` are the
two kinds of starts, ``_least_violation.py`` says what has to give, ``_switching.py`` solves for
switching times.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
