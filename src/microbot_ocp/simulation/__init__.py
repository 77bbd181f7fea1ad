"""Simulation of an arm under given torques or under a controller.

The input is a robot with masses, and torques (:func:`simulate`) or a reference motion and a
controller (:func:`track`). The result is a :class:`Simulation` or :class:`Tracking` with samples,
status and advice. A simulation calls one CasADi integrator once for the whole grid. Begin with
``_loops.py``; ``_integration.py`` holds the differential equation and the integrators.
"""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
