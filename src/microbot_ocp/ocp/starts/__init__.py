"""Starting points of a solve: guesses, rollouts, measurements and scales.

Input: a problem, guesses or an earlier solution. Output: a starting point, and scales that were not
declared. Begin with ``_initial_guess.py``; ``_rollout.py`` simulates, ``_measured_guess.py`` fits
measurements, ``_scaling.py`` determines scales, ``_problem_data.py`` converts limits and parameters
to plain values.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
