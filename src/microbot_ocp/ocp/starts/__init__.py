"""What a solve starts from: guesses, rollouts, measurements, scales.

Comes in: a problem, guesses or an earlier solution. Goes out: a starting point and scales that were
not declared. Begin with ``_initial_guess.py``; ``_rollout.py`` simulates, ``_measured_guess.py``
follows measurements, ``_scaling.py`` finds scales, ``_problem_data.py`` holds limits and parameters
as plain values.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
