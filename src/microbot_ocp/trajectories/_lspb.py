"""Linear segments with parabolic blends, from via point to via point (Craig, section 7.3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.motion import PiecewisePolynomial
from microbot_ocp.trajectories._via_points import ViaPoints, via_points

ROUNDING = 1e-12  # relative to a segment: shorter linear parts are rounding and are left out


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
        Duration t_b of each parabola, s: one for all segments or one a segment; above 0, at most
        half the segment.
    via_qd : array_like [m,n], optional
        Velocities at the via points, rad/s (m/s); default zero, a stop at each.

    Returns
    -------
    PiecewisePolynomial
        Three pieces a segment (two where the blends fill it), exact.

    Raises
    ------
    InputError
        Wrong shapes, times that do not increase, a blend time not above zero or above half its
        segment, anything not finite.

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
    """Make :func:`lspb` through checked via points, with blend times [m-1] and velocities [m,n]."""
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
