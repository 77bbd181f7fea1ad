"""Motions as data: samples of position, velocity, acceleration and torque.

A frozen :class:`Motion` is made from a robot and a :class:`PiecewisePolynomial` of time, or from
states at given times. It can be evaluated between its samples, resampled, saved and loaded. The
main module is ``_motion.py``; polynomials are in ``_polynomial.py``, exports in ``_export.py``.
"""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
