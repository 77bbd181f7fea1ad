"""Grids on which a motion is sampled finely enough to verify its limits."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from microbot_ocp._base import checks
from microbot_ocp._base.checks import ROUNDING, FloatArray
from microbot_ocp.limits import JUMP_TIME, MotionSamples, StateHistory, jumps_between

if TYPE_CHECKING:
    from microbot_ocp.motion._motion import Motion

JUMP_GAP = JUMP_TIME  # s between the two samples that represent a jump of the acceleration

JUMP_SHARE = 0.02  # largest gap of a jump, relative to the interval before it


def jump_gaps(t: FloatArray, i: NDArray[np.intp] | None = None) -> NDArray[np.bool_]:
    """Return True for each interval [N-1] between times t [N], or only those in ``i``, of a jump.

    The first interval is none, as there is no acceleration before it. Two equal steps in sequence
    are samples of one interval, not a jump.
    """
    first = np.arange(t.size - 1) if i is None else i
    last = np.minimum(first + 2, t.size - 1)
    gap = t[first + 1] - t[first]
    before = np.where(first > 0, t[first] - t[np.maximum(first - 1, 0)], 0.0)
    even = np.abs(t[last] - t[first + 1] - gap) <= ROUNDING
    return (gap <= np.minimum(2 * JUMP_GAP, JUMP_SHARE * before)) & ~even


def nearest_samples(t: FloatArray, times: FloatArray) -> NDArray[np.intp]:
    """Return the indices of the samples at t [N] that are nearest to some times [K]."""
    after = np.clip(np.searchsorted(t, times), 1, t.size - 1)
    return after - (times - t[after - 1] < t[after] - times)


def mesh_of(motion: Motion) -> FloatArray:
    """Return the breaks of a motion with both ends, in which a jump's gap is not an interval."""
    breaks = motion.t if motion.breaks is None else motion.breaks
    inner = breaks[(breaks > 0.0) & (breaks < motion.duration)]
    mesh = np.concatenate([[0.0], inner, [motion.duration]])
    earlier = motion.t[:-1][jump_gaps(motion.t)]
    return mesh[~np.isin(mesh, earlier)]


def quadrature(t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return times [3(N-1)] between samples [N], s, and quadrature weights.

    Gauss's rule with three points is exact for the square of a torque that is quadratic between
    two samples.
    """
    points, weights = np.polynomial.legendre.leggauss(3)
    half = 0.5 * np.diff(t)[:, None]
    return (t[:-1, None] + half * (1.0 + points)).ravel(), (half * weights).ravel()


def numbered(counts: NDArray[np.int_]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return, for counts [N] of places in intervals, each place's interval and number within it."""
    i = np.repeat(np.arange(counts.size), counts)
    return i, np.arange(i.size) - (np.cumsum(counts) - counts)[i]


def with_parts(t: FloatArray, parts: NDArray[np.int_]) -> FloatArray:
    """Split each interval between times [N+1] into equal parts; their number is ``parts`` [N]."""
    i, k = numbered(parts)
    return np.append(t[i] + k / parts[i] * np.diff(t)[i], t[-1])


DENSE_STEP = 0.25e-3  # longest step of the grid on which limits are evaluated, s
POINTS_PER_INTERVAL = 20  # least number of grid points in a mesh interval
MANY_POINTS = 100_000  # points of a grid from which a mesh interval has fewer
LEAST_POINTS = 5  # least number of points in a mesh interval of such a grid


def dense_times(motion: Motion) -> tuple[FloatArray, float]:
    """Return the dense grid and the least number of its points in a mesh interval."""
    mesh = mesh_of(motion)
    lengths = np.diff(mesh)
    step = max(DENSE_STEP, checks.longest_step(motion.duration, round(checks.SLOW / DENSE_STEP)))
    ratio = int(np.clip(MANY_POINTS // lengths.size, LEAST_POINTS, POINTS_PER_INTERVAL))
    points = np.maximum(ratio, np.ceil(lengths / step - ROUNDING)).astype(int)
    # The numbers just below the breaks give the limits from the left.
    before = np.nextafter(mesh[1:-1], 0.0)
    grid = np.concatenate([with_parts(mesh, points), before, motion.t])
    return np.unique(grid), float(points.min())


def history_of(motion: Motion, t: FloatArray, cycle: bool = False) -> StateHistory:
    """Return states at times t [N], and the jumps of the acceleration at the ends and inside."""
    gaps = np.flatnonzero(jump_gaps(motion.t))
    first, last = np.append(0, gaps + 1), np.append(gaps, motion.t.size - 1)
    starts, ends = (
        MotionSamples(motion.q[k], motion.qd[k], motion.qdd[k], np.zeros_like(motion.qdd[k]))
        for k in (first, last)
    )
    # A linear change of the acceleration up to the break is no jump.
    evenly = np.diff(motion.t)[gaps, None] * motion.samples(motion.t[gaps]).qddd
    ends.qdd[:-1] += evenly
    jumps = jumps_between(starts, ends, cycle=cycle)
    return StateHistory(t, motion.samples(t), np.append(motion.t[first], motion.t[-1]), jumps)
