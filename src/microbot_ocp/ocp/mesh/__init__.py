"""Errors of a solution on its mesh, division of intervals, and the loop of every refinement.

Input: a solution. Output: relative errors of its states, excess over limits between mesh points,
finer meshes. Begin with :func:`state_errors` and :func:`divide`; :func:`refined` is the loop.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
