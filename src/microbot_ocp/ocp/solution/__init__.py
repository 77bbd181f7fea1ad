"""Result of a solve.

Input: the variables of a program. Output: a :class:`Solution` with values by phase and name. Begin
with ``_solution.py``; ``_gap.py`` estimates the cost above the local optimum, ``_progress.py``
reports iterations.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
