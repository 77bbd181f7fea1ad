"""Errors of a solution on its mesh, interval by interval, and where to divide it.

Comes in: a solution. Goes out: relative errors of its states, how far limits are exceeded between
mesh points, finer meshes. Begin with :func:`state_errors` and :func:`divide`.
"""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
