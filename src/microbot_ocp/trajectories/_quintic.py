"""Quintic polynomial segments through via points (Craig, section 7.3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp.motion import PiecewisePolynomial, State, quintic_between
from microbot_ocp.trajectories._via_points import via_points, via_velocities


def quintic(
    via_q: ArrayLike,
    via_t: ArrayLike,
    via_qd: ArrayLike | None = None,
    via_qdd: ArrayLike | None = None,
) -> PiecewisePolynomial:
    """Return quintic segments through via points, with given velocities and accelerations there.

    Position, velocity and acceleration are continuous (Craig, *Introduction to Robotics*,
    3rd ed., section 7.3, equation 7.18), so the torque is, too.

    Parameters
    ----------
    via_q, via_t : array_like [m,n] and [m]
        Joint positions, rad (prismatic: m), and strictly increasing times, s, of the via points.
    via_qd : array_like [m,n], optional
        Velocities there, rad/s (m/s); by default the heuristic of :func:`cubic`.
    via_qdd : array_like [m,n], optional
        Accelerations there, rad/s^2 (m/s^2); by default zero.

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
    >>> motion = quintic([[0.0], [1.0]], [0.0, 2.0])
    >>> motion.derivative()(1.0).item()  # 15/8 of the mean speed
    0.9375
    """
    via = via_points(via_q, via_t)
    qd = via_velocities(via) if via_qd is None else via.given("via_qd", via_qd, "rad/s")
    qdd = via.given("via_qdd", via_qdd, "rad/s^2")
    start, end = (
        State(via.q[part], qd[part], qdd[part]) for part in (slice(None, -1), slice(1, None))
    )
    return PiecewisePolynomial(via.t, quintic_between(start, end, np.diff(via.t)))
