"""Switching times as unknowns: a solution with one phase per arc.

Input: a problem and a solution that shows its arcs. Output: :class:`SwitchingTimes`. Begin with
:func:`solve_switching_times`; ``_cutter.py`` converts every arc to a phase, ``_revision.py``
changes the arcs where a solution requires it, ``_singular.py`` solves singular arcs by their
optimality conditions.
"""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
