"""An optimal-control problem as data: phases with states, controls, dynamics, costs and limits.

Input: CasADi expressions of the symbols that the declarations return. Output: an
:class:`OptimalControlProblem`, whose :class:`Phase` s hold names, units, bounds and expressions.
Begin with ``_problem.py``; ``_phase.py`` has the methods that declare a phase, ``_items.py`` the
data that they store, ``_expressions.py`` conversions between expressions and numbers. Nothing here
depends on the solution method.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
