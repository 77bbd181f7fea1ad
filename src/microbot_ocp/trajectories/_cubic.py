"""Cubic polynomial segments through via points (Craig, section 7.3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.motion import PiecewisePolynomial
from microbot_ocp.trajectories._via_points import ViaPoints, via_points, via_velocities


def cubic(
    via_q: ArrayLike, via_t: ArrayLike, via_qd: ArrayLike | None = None
) -> PiecewisePolynomial:
    """Return cubic segments through via points, with given velocities there.

    On each segment of duration T, from (q0, v0) to (qf, vf), with x the time since its start:
    ``q = q0 + v0 x + a2 x^2 + a3 x^3``, ``a2 = [3 (qf - q0) - (2 v0 + vf) T] / T^2``,
    ``a3 = [2 (q0 - qf) + (v0 + vf) T] / T^3`` (Craig, *Introduction to Robotics*, 3rd ed.,
    section 7.3, equation 7.11). Position and velocity are continuous, the acceleration jumps at
    the inner via points.

    Parameters
    ----------
    via_q, via_t : array_like [m,n] and [m]
        Joint positions, rad (prismatic: m), and strictly increasing times, s, of the via points.
    via_qd : array_like [m,n], optional
        Velocities at the via points, rad/s (m/s). By default the heuristic of Craig, section 7.3:
        zero where the slope between via points changes sign, else the mean of the slopes on both
        sides; zero at both ends.

    Returns
    -------
    PiecewisePolynomial
        One piece a segment, exact.

    Raises
    ------
    InputError
        Wrong shapes, times that do not increase, anything not finite.

    Examples
    --------
    >>> motion = cubic([[0.0], [1.0]], [0.0, 2.0])
    >>> motion([0.0, 1.0, 2.0]).ravel().tolist()
    [0.0, 0.5, 1.0]
    >>> motion.derivative()(1.0).item()  # 1.5 times the mean speed
    0.75
    """
    via = via_points(via_q, via_t)
    qd = via_velocities(via) if via_qd is None else via.given("via_qd", via_qd, "rad/s")
    return cubic_through(via, qd)


def cubic_through(via: ViaPoints, qd: FloatArray) -> PiecewisePolynomial:
    """Make :func:`cubic` through checked via points with the velocities ``qd`` [m,n] there."""
    h = np.diff(via.t)[:, None]
    q0, qf, v0, vf = via.q[:-1], via.q[1:], qd[:-1], qd[1:]
    a2 = (3 * (qf - q0) - (2 * v0 + vf) * h) / h**2
    a3 = (2 * (q0 - qf) + (v0 + vf) * h) / h**3
    return PiecewisePolynomial(via.t, np.stack([q0, v0, a2, a3], axis=1))
