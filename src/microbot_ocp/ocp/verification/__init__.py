"""Certificate of an optimal-control solution: re-simulation, dense limits, optimality conditions.

Nothing here trusts the solver or the derivatives that it was given. The dynamics are integrated
again, the limits are looked at between the mesh points, and the conditions of Karush, Kuhn and
Tucker are formed anew from the declared problem.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
