"""Switching times as unknowns: a solution with one phase an arc.

Comes in: a problem and a solution that shows its arcs. Goes out: :class:`SwitchingTimes`. Begin
with :func:`solve_switching_times`; ``_cutter.py`` makes a phase of every arc, ``_revision.py``
plans other arcs where a solution asks for them, ``_singular.py`` determines singular arcs by their
own conditions.
"""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
