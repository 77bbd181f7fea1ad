"""What a solve returns.

Comes in: the variables of a program. Goes out: a :class:`Solution` with values by phase and name.
Begin with ``_solution.py``; ``_gap.py`` says by how much the cost may be lower, ``_progress.py``
reports iterations.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
