"""Textbook trajectories through via points: cubics, quintics, splines, lines with blends.

The formulas follow Craig, *Introduction to Robotics*, section 7.3.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import ROUNDING, FloatArray, InputError
from microbot_ocp.motion import PiecewisePolynomial, State, quintic_between


class ViaPoints(NamedTuple):
    """Checked via points: positions [m,n] (rad or m) at times [m] (s)."""

    q: FloatArray
    t: FloatArray

    def given(self, name: str, values: ArrayLike | None, unit: str) -> FloatArray:
        """Return checked values [m,n] at the via points; zeros by default."""
        if values is None:
            return np.zeros_like(self.q)
        return checks.array(name, values, self.q.shape, unit)


def via_points(via_q: ArrayLike, via_t: ArrayLike) -> ViaPoints:
    """Return checked via points and times.

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
        Fewer than two via points, wrong shapes, values not finite, or times that do not increase.
    """
    q = checks.array("via_q", via_q, (None, None), "rad")
    if q.shape[0] < 2 or q.shape[1] < 1:
        raise InputError(
            f"via_q must hold at least two via points of at least one joint, not {list(q.shape)}"
        )
    return ViaPoints(q, checks.times("via_t", via_t, len(q)))


def via_velocities(via: ViaPoints) -> FloatArray:
    """Return velocities at via points by the heuristic of Craig, section 7.3.

    For each joint, the velocity at an inner via point is zero where the slope of the straight
    lines between the via points changes sign (or is zero on a side), else the mean of the two
    slopes. The velocity is zero at both ends.

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
        zero where the slope between via points changes sign and at both ends, else the mean of
        the slopes on both sides.

    Returns
    -------
    PiecewisePolynomial
        One piece per segment, exact.

    Raises
    ------
    InputError
        Wrong shapes, times that do not increase, or values that are not finite.

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
    """Return :func:`cubic` through checked via points with velocities ``qd`` [m,n]."""
    h = np.diff(via.t)[:, None]
    q0, qf, v0, vf = via.q[:-1], via.q[1:], qd[:-1], qd[1:]
    a2 = (3 * (qf - q0) - (2 * v0 + vf) * h) / h**2
    a3 = (2 * (q0 - qf) + (v0 + vf) * h) / h**3
    return PiecewisePolynomial(via.t, np.stack([q0, v0, a2, a3], axis=1))


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
        Velocities at the via points, rad/s (m/s); by default those of :func:`cubic`.
    via_qdd : array_like [m,n], optional
        Accelerations at the via points, rad/s^2 (m/s^2); by default zero.

    Returns
    -------
    PiecewisePolynomial
        One piece per segment, exact.

    Raises
    ------
    InputError
        Wrong shapes, times that do not increase, or values that are not finite.

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


def spline(
    via_q: ArrayLike,
    via_t: ArrayLike,
    ends: str = "clamped",
    end_qd: ArrayLike | None = None,
) -> PiecewisePolynomial:
    """Return the cubic spline through via points, the curve of least mean square acceleration.

    The segments are cubics (Craig, *Introduction to Robotics*, 3rd ed., section 7.3) whose
    velocities at the inner via points make the acceleration continuous:
    ``v[i-1]/h[i-1] + 2 (1/h[i-1] + 1/h[i]) v[i] + v[i+1]/h[i] = 3 (s[i-1]/h[i-1] + s[i]/h[i])``
    with the durations h and mean speeds s of the segments (de Boor, *A Practical Guide to Splines*,
    chapter IV). Only the velocities at the ends are chosen.

    Parameters
    ----------
    via_q, via_t : array_like [m,n] and [m]
        Joint positions, rad (prismatic: m), and strictly increasing times, s, of the via points.
    ends : "clamped" or "natural"
        Condition at both ends: given velocities, or zero acceleration. A natural spline starts and
        ends with a velocity, so an arm at rest cannot follow it.
    end_qd : array_like [2,n], optional
        Velocities at the first and the last via point of a clamped spline, rad/s (m/s); default
        zero.

    Returns
    -------
    PiecewisePolynomial
        One piece per segment, exact.

    Raises
    ------
    InputError
        Wrong shapes, times that do not increase, values that are not finite, or end velocities
        for a natural spline.

    Examples
    --------
    >>> motion = spline([[0.0], [1.0], [0.0]], [0.0, 1.0, 2.0])
    >>> motion.derivative()([0.0, 1.0, 2.0]).ravel().tolist()
    [0.0, 0.0, 0.0]
    >>> spline([[0.0], [1.0], [0.0]], [0.0, 1.0, 2.0], "natural").derivative()(0.0).item()
    1.5
    """
    via = via_points(via_q, via_t)
    natural = checks.one_of("ends", ends, ("clamped", "natural")) == "natural"
    if natural and end_qd is not None:
        raise InputError("end_qd cannot be given for natural ends: their velocities follow")
    shape = (2, via.q.shape[1])
    end = np.zeros(shape) if end_qd is None else checks.array("end_qd", end_qd, shape, "rad/s")
    return cubic_through(via, spline_velocities(via, None if natural else end))


def spline_velocities(via: ViaPoints, end: FloatArray | float | None = 0.0) -> FloatArray:
    """Return the velocities [m,n] of :func:`spline`; ``end`` None makes it a natural spline."""
    # Rows of the system in the docstring of `spline`; a natural end has 2 v[0] + v[1] = 3 s[0].
    weight = 1.0 / np.diff(via.t)
    slope = np.diff(via.q, axis=0) * weight[:, None]
    pull = 3.0 * weight[:, None] * slope
    diagonal = np.concatenate([weight[:1], weight[:-1] + weight[1:], weight[-1:]]) * 2.0
    right = np.concatenate([pull[:1], pull[:-1] + pull[1:], pull[-1:]])
    below, above = weight.copy(), weight.copy()  # entries beside the diagonal
    if end is not None:
        diagonal[[0, -1]], right[[0, -1]] = 1.0, end
        below[-1] = above[0] = 0.0
    # Column j of a banded matrix holds the entries above, on and below the diagonal.
    columns = np.stack([np.append(0.0, above), diagonal, np.append(below, 0.0)], axis=1)
    matrix = ca.DM(ca.Sparsity.banded(diagonal.size, 1), columns.ravel()[1:-1])
    return np.array(ca.solve(matrix, right, "qr"))


def lspb(
    via_q: ArrayLike,
    via_t: ArrayLike,
    blend_time: ArrayLike,
    via_qd: ArrayLike | None = None,
) -> PiecewisePolynomial:
    """Return linear segments with parabolic blends that pass every via point.

    Each segment of duration T runs from (q0, v0) to (qf, vf): a parabola for the blend time t_b
    from v0 to the cruise velocity V, a straight line, a parabola for t_b from V to vf, with
    ``V = [qf - q0 - t_b (v0 + vf) / 2] / (T - t_b)`` (Craig, *Introduction to Robotics*, 3rd ed.,
    section 7.3, with end velocities that need not be zero). Unlike Craig's blends around the via
    points, the motion passes them. The acceleration is constant by pieces.

    Parameters
    ----------
    via_q, via_t : array_like [m,n] and [m]
        Joint positions, rad (prismatic: m), and strictly increasing times, s, of the via points.
    blend_time : float or array_like [m-1]
        Duration t_b of each parabola, s, one for all segments or one per segment; above 0, at most
        half the segment.
    via_qd : array_like [m,n], optional
        Velocities at the via points, rad/s (m/s); default zero, a stop at each.

    Returns
    -------
    PiecewisePolynomial
        Three pieces per segment (two where the blends fill it), exact.

    Raises
    ------
    InputError
        Wrong shapes, times that do not increase, a blend time not above zero or above half its
        segment, or values that are not finite.

    Examples
    --------
    >>> motion = lspb([[0.0], [3.0]], [0.0, 2.0], blend_time=0.5)
    >>> motion.breaks.tolist()
    [0.0, 0.5, 1.5, 2.0]
    >>> motion.derivative()([0.25, 1.0, 1.75]).ravel().tolist()
    [1.0, 2.0, 1.0]
    """
    via = via_points(via_q, via_t)
    blends = _blend_times(blend_time, np.diff(via.t))
    return lspb_through(via, blends, via.given("via_qd", via_qd, "rad/s"))


def lspb_through(via: ViaPoints, blends: FloatArray, qd: FloatArray) -> PiecewisePolynomial:
    """Return :func:`lspb` through checked via points; blend times [m-1], velocities [m,n]."""
    durations = np.diff(via.t)
    breaks, coefficients = [], []
    for i, (duration, blend) in enumerate(zip(durations, blends, strict=True)):
        start, end = via.t[i], via.t[i + 1]
        q0, qf, v0, vf = via.q[i], via.q[i + 1], qd[i], qd[i + 1]
        cruise = (qf - q0 - 0.5 * blend * (v0 + vf)) / (duration - blend)
        leaves = q0 + 0.5 * blend * (v0 + cruise)
        arrives = qf - 0.5 * blend * (cruise + vf)
        breaks.append(start)
        coefficients.append([q0, v0, (cruise - v0) / (2 * blend)])
        if duration - 2 * blend > ROUNDING * duration:
            breaks.append(start + blend)
            coefficients.append([leaves, cruise, np.zeros_like(q0)])
        breaks.append(end - blend)
        coefficients.append([arrives, cruise, (vf - cruise) / (2 * blend)])
    breaks.append(via.t[-1])
    return PiecewisePolynomial(np.array(breaks), np.array(coefficients))


def _blend_times(blend_time: ArrayLike, durations: FloatArray) -> FloatArray:
    given = blend_time
    if np.ndim(np.asarray(given, dtype=object)) == 0:
        given = np.full(durations.size, checks.number("blend_time", given, "s", above=0.0))
    blends = checks.array("blend_time", given, durations.shape, "s")
    for i, (blend, duration) in enumerate(zip(blends, durations, strict=True)):
        if blend <= 0:
            raise InputError(f"blend_time of segment {i + 1} must be above 0 s, not {blend:g} s")
        if blend > 0.5 * duration * (1 + ROUNDING):
            raise InputError(
                f"blend_time of segment {i + 1} must be at most half its duration, "
                f"{0.5 * duration:g} s, not {blend:g} s"
            )
    return np.minimum(blends, 0.5 * durations)
