"""Cubic splines through via points: cubic segments whose acceleration does not jump."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.motion import PiecewisePolynomial
from microbot_ocp.trajectories._cubic import cubic_through
from microbot_ocp.trajectories._via_points import via_points


def spline(
    via_q: ArrayLike,
    via_t: ArrayLike,
    ends: str = "clamped",
    end_qd: ArrayLike | None = None,
) -> PiecewisePolynomial:
    """Return cubic spline: of the curves through the via points that of the least mean square
    curvature.

    Cubic segments (Craig, *Introduction to Robotics*, 3rd ed., section 7.3) whose velocities at the
    inner via points make the acceleration continuous there:
    ``v[i-1]/h[i-1] + 2 (1/h[i-1] + 1/h[i]) v[i] + v[i+1]/h[i] = 3 (s[i-1]/h[i-1] + s[i]/h[i])``
    with the durations h and mean speeds s of the segments (de Boor, *A Practical Guide to Splines*,
    chapter IV). No velocity is chosen by hand but those at the ends.

    Parameters
    ----------
    via_q, via_t : array_like [m,n] and [m]
        Joint positions, rad (prismatic: m), and strictly increasing times, s, of the via points.
    ends : "clamped" or "natural"
        Given velocities at both ends, or no acceleration there: a natural spline leaves and arrives
        at full speed, so an arm at rest cannot follow it.
    end_qd : array_like [2,n], optional
        Velocities at the first and the last via point of a clamped spline, rad/s (m/s); default
        zero.

    Returns
    -------
    PiecewisePolynomial
        One piece a segment, exact.

    Raises
    ------
    InputError
        Wrong shapes, times that do not increase, anything not finite, end velocities for a natural
        spline.

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
    weight = 1.0 / np.diff(via.t)
    slope = np.diff(via.q, axis=0) * weight[:, None]
    pull = 3.0 * weight[:, None] * slope
    diagonal = np.concatenate([weight[:1], weight[:-1] + weight[1:], weight[-1:]]) * 2.0
    right = np.concatenate([pull[:1], pull[:-1] + pull[1:], pull[-1:]])
    beside = np.stack([weight, weight])  # below and above the diagonal
    if not natural:
        diagonal[[0, -1]], right[[0, -1]] = 1.0, end
        beside[0, -1] = beside[1, 0] = 0.0
    return cubic_through(via, _solve_tridiagonal(beside[0], diagonal, beside[1], right))


def _solve_tridiagonal(
    below: FloatArray, diagonal: FloatArray, above: FloatArray, right: FloatArray
) -> FloatArray:
    """Solve for [m,n] without pivoting: the matrix is diagonally dominant."""
    pivot, answer = diagonal.copy(), right.copy()
    for i in range(1, pivot.size):
        factor = below[i - 1] / pivot[i - 1]
        pivot[i] -= factor * above[i - 1]
        answer[i] -= factor * answer[i - 1]
    answer[-1] /= pivot[-1]
    for i in reversed(range(pivot.size - 1)):
        answer[i] = (answer[i] - above[i] * answer[i + 1]) / pivot[i]
    return answer
