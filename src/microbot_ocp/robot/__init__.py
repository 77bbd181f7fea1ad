"""Robots as data, their files, and their kinematics and dynamics as CasADi functions."""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
