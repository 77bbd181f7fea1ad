"""Meshes chosen for a wanted accuracy.

Comes in: a problem, an accuracy and a first mesh. Goes out: :class:`Refined`, the last accepted
solution with the history of its meshes. Begin with :func:`solve_refined` in ``_adaptive.py``;
``_mesh_error.py`` and ``_cost_error.py`` estimate errors, ``_degrees.py`` raises degrees,
``_switches.py`` and ``_arcs.py`` move mesh points to switches, ``_refiner.py`` solves from mesh to
mesh. :func:`solve_switching_times` needs none: the times of the switches are its unknowns.
"""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
