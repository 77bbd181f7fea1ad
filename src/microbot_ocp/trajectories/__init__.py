"""Textbook trajectories through via points, and the shortest duration of any shape.

In: joint positions at via points and their times. Out: a ``PiecewisePolynomial`` of cubics
(:func:`cubic`, :func:`spline`), quintics (:func:`quintic`) or lines with parabolic blends
(:func:`lspb`); :func:`shortest_duration` stretches it until a limit is just met, and
:func:`best_split` chooses the times at the via points, too. Begin with ``_through_points.py``.
"""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
