"""Obstacles around an arm: data, distances as limits of the arm, proved clearance, detours.

:class:`Scene` holds obstacles; :meth:`Scene.limit` turns their distances into a limit that motions
are planned under; :func:`clearance` proves the least distance of any motion. Begin in
``_scene.py``.
"""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
