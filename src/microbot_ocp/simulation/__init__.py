"""The arm in motion: from given torques, or under a controller.

In: a robot with masses, and torques (:func:`simulate`) or a reference motion and a controller
(:func:`track`). Out: a :class:`Simulation` or :class:`Tracking` with samples, status and advice.
Every simulation is one call of one CasADi integrator on the whole grid. Begin with
``_loops.py``; ``_integration.py`` holds the equation and the integrators.
"""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
