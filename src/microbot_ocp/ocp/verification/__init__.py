"""Certificate of a solution: cost, dynamics, limits and optimality, evaluated independently.

Input: the declared problem and a solution. Output: an :class:`OCPCertificate`. Begin with
:func:`judge` in ``_judgement.py``; ``_recomputation.py`` evaluates the declared expressions
again, ``_reintegration.py`` integrates the dynamics again, ``_limits.py`` checks limits between
the mesh points, ``_conditions.py`` evaluates the Karush-Kuhn-Tucker conditions.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
