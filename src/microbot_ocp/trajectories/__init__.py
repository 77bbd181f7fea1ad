"""Textbook trajectories through via points, and the shortest duration of any shape.

Cubics (:func:`cubic`, :func:`spline`), quintics (:func:`quintic`) and lines with parabolic blends
(:func:`lspb`) turn joint positions at via points and their times into a ``PiecewisePolynomial``.
:func:`shortest_duration` stretches it until it just meets a limit, and :func:`best_split` chooses
the times at the via points, too. The first module to read is ``_through_points.py``.
"""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
