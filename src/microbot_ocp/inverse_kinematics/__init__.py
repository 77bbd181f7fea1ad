"""Inverse kinematics: one solution, every branch, a line followed; by Gauss-Newton and by NLPs.

``search`` runs many starts at once through one compiled step; the NLPs of ``kernels`` (IPOPT) take
over where limits, a seed, a missed target or a continuum of solutions ask for an optimum.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
