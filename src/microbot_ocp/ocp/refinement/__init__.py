"""Meshes chosen for a wanted accuracy.

Comes in: a problem, an accuracy and a first mesh. Goes out: :class:`Refined`, the last accepted
solution with the history of its meshes. Begin with :func:`solve_refined` in ``_adaptive.py``;
``_cost_error.py`` estimates the error of the cost, ``_degrees.py`` raises degrees, ``_refiner.py``
solves from mesh to mesh.
"""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
