"""Cubic polynomial segments through via points (Craig, section 7.3), and the shared via checks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.motion import PiecewisePolynomial


class ViaPoints(NamedTuple):
    """Checked via points: positions [m,n] (rad or m) at times [m] (s)."""

    q: FloatArray
    t: FloatArray


def via_points(via_q: ArrayLike, via_t: ArrayLike) -> ViaPoints:
    """Check via points and their times.

    Parameters
    ----------
    via_q : array_like [m,n]
        Joint positions, rad (prismatic: m); at least two rows.
    via_t : array_like [m]
        Strictly increasing times, s.

    Returns
    -------
    ViaPoints

    Raises
    ------
    InputError
        Fewer than two via points, wrong shapes, anything not finite, times that do not increase.
    """
    q = checks.array("via_q", via_q, (None, None), "rad")
    if q.shape[0] < 2 or q.shape[1] < 1:
        raise InputError(
            f"via_q must hold at least two via points of at least one joint, not {list(q.shape)}"
        )
    t = checks.array("via_t", via_t, (q.shape[0],), "s")
    stuck = np.flatnonzero(np.diff(t) <= 0)
    if stuck.size:
        i = stuck[0]
        raise InputError(
            f"via_t must be strictly increasing, but via_t[{i + 1}] is {t[i + 1]:g} s after "
            f"via_t[{i}] of {t[i]:g} s; each segment must last longer than 0 s"
        )
    return ViaPoints(q, t)


def via_velocities(via: ViaPoints) -> FloatArray:
    """Velocities at via points by the heuristic of Craig, section 7.3.

    At each inner via point and for each joint: zero where the slope of the straight lines between
    the via points changes sign (or is zero on a side), else the mean of the two slopes. Zero at
    both ends.

    Parameters
    ----------
    via : ViaPoints
        Positions [m,n] at times [m].

    Returns
    -------
    array [m,n]
        Velocities, rad/s (m/s).

    Examples
    --------
    >>> via_velocities(via_points([[0.0, 0.0], [1.0, 1.0], [3.0, 0.0]], [0.0, 1.0, 2.0])).tolist()
    [[0.0, 0.0], [1.5, 0.0], [0.0, 0.0]]
    """
    slope = np.diff(via.q, axis=0) / np.diff(via.t)[:, None]
    velocity = np.zeros_like(via.q)
    same_sign = slope[:-1] * slope[1:] > 0
    velocity[1:-1] = np.where(same_sign, 0.5 * (slope[:-1] + slope[1:]), 0.0)
    return velocity


def cubic(
    via_q: ArrayLike, via_t: ArrayLike, via_qd: ArrayLike | None = None
) -> PiecewisePolynomial:
    """Cubic segments through via points, with given velocities there.

    On each segment of duration T, from (q0, v0) to (qf, vf), with x the time since its start:
    ``q = q0 + v0 x + a2 x^2 + a3 x^3``, ``a2 = [3 (qf - q0) - (2 v0 + vf) T] / T^2``,
    ``a3 = [2 (q0 - qf) + (v0 + vf) T] / T^3`` (Craig, *Introduction to Robotics*, 3rd ed.,
    section 7.3, equation 7.11). Position and velocity are continuous, the acceleration jumps at
    the inner via points.

    Parameters
    ----------
    via_q : array_like [m,n]
        Joint positions at the via points, rad (prismatic: m).
    via_t : array_like [m]
        Strictly increasing times of the via points, s.
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
    velocity = (
        via_velocities(via)
        if via_qd is None
        else checks.array("via_qd", via_qd, via.q.shape, "rad/s")
    )
    h = np.diff(via.t)[:, None]
    q0, qf, v0, vf = via.q[:-1], via.q[1:], velocity[:-1], velocity[1:]
    a2 = (3 * (qf - q0) - (2 * v0 + vf) * h) / h**2
    a3 = (2 * (q0 - qf) + (v0 + vf) * h) / h**3
    return PiecewisePolynomial(via.t, np.stack([q0, v0, a2, a3], axis=1))
