"""A motion is data: samples of position, velocity, acceleration and torque.

In: a robot and a :class:`PiecewisePolynomial` of the time, or states at given times. Out: a frozen
:class:`Motion`, which is sampled between its rows, resampled, saved and loaded. Begin with
``_motion.py``; the polynomials are in ``_polynomial.py``, the files in ``_files.py``.
"""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
