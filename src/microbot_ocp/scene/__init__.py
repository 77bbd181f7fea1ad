"""Obstacles around an arm: data, distances as limits of the arm, proved clearance, ways around.

:class:`Scene` holds obstacles; :meth:`Scene.limit` makes of their distances a member of the limits'
family, which motions are planned with; :func:`clearance` proves of any motion how near it comes.
Begin in ``_scene.py``.
"""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
