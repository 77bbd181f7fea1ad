"""Errors of a solution on its mesh, where to divide it, and the loop of every refinement.

Comes in: a solution. Goes out: relative errors of its states, how far limits are exceeded between
mesh points, finer meshes. Begin with :func:`state_errors` and :func:`divide`;
:func:`refined` is the loop.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
