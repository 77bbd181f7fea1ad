"""An optimal-control problem as data: phases with states, controls, dynamics, costs and limits.

Comes in: CasADi expressions of the symbols that the declarations return. Goes out: an
:class:`OptimalControlProblem`, whose :class:`Phase` s hold names, units, bounds and expressions.
Begin with ``_problem.py``; ``_phase.py`` has the words of a phase, ``_items.py`` what they leave,
``_expressions.py`` what is between expressions and numbers. Nothing here knows how a problem is
solved.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
