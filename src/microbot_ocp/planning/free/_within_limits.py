"""Motions within every limit, from one that exceeds some between its mesh points.

The path of such a motion gets a new timing: nowhere faster than before, and slower only at a limit.
That takes two passes of reachability, and costs about as much time of motion as another mesh would
gain. Under limits of jerk and torque rate, and others outside of reachability, the whole motion is
slowed down by one factor. If there is no such motion, known ways need no search.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.limits import LimitFamily, MotionSamples
from microbot_ocp.motion import Mark, Motion, PiecewisePolynomial, dense_times, unresolved
from microbot_ocp.planning.free._problem import excess_along
from microbot_ocp.planning.path import (
    LATER,
    CurveLimits,
    CurvePiece,
    PathCurve,
    Reached,
    reach,
    sampled,
    straight_through,
    time_path,
)
from microbot_ocp.planning.task import GAP, TaskScale
from microbot_ocp.trajectories import cubic, quintic, shortest_duration, spline

MOST_GRIDS = 6  # largest number of grids, each refined where a limit is exceeded
LARGEST_SLOWDOWN = 1.5  # largest factor of a uniform slowdown


class Slowed(NamedTuple):
    """A motion within its limits, and the name of its origin."""

    motion: Motion
    made_from: str


FIRST_GRID = 1000  # smallest number of intervals of the first grid
LEAST_GRIDS = 2  # number of grids that are solved even after the time limit
SAMPLE_FACTORS = (1, 2, 4, 8)  # factors on the number of samples, tried in turn


def within_limits(
    family: LimitFamily,
    shape: PiecewisePolynomial,
    via_times: FloatArray,
    tolerance: float,
    fast: bool,
    *,
    moving: bool = False,
) -> Motion | None:
    """Return the motion ``shape``, slowed down where it exceeds limits; None if that fails.

    Parameters
    ----------
    family : LimitFamily
    shape : PiecewisePolynomial
        Motion that ends at rest, with a continuous velocity.
    via_times : array [m]
        Times at the via points, s.
    tolerance : float
        Largest relative excess of a limit, also between samples.
    fast : bool
        Use compiled functions.
    moving : bool
        Keep the initial velocity, which excludes a uniform slowdown.
    """

    def evenly() -> Motion | None:
        if moving:
            return None
        marks = _marks(via_times)
        motion = Motion.from_polynomial(family.robot, shape, label="time-optimal", marks=marks)
        return _slowed_evenly(family, motion, tolerance)

    if family.means:  # a slower motion need not have a smaller mean: gravity remains
        return None
    if family.jerk_matters:
        return evenly()
    pieces = map(CurvePiece, shape.coefficients, np.diff(shape.breaks).tolist())
    curve = PathCurve(tuple(pieces), True, True)
    # Every piece has equally many intervals, so that breaks are grid points.
    parts = max(2, -(-FIRST_GRID // len(curve.pieces)))
    count = parts * len(curve.pieces)
    s = np.interp(np.arange(count + 1) / parts, np.arange(shape.breaks.size), shape.breaks)
    s[::parts] = shape.breaks
    for number in range(MOST_GRIDS):
        along = CurveLimits.of(family, curve, s, fast)
        if along.limits.later:
            return evenly()
        ends = {"start_free": not moving, "end_free": True, "ends": (float(moving), 0.0)}
        # The parameter of the path is the old time: ds/dt <= 1 is nowhere faster than before.
        timing = reach(along, fastest=1.0, **ends)
        if not timing.feasible:
            return None
        timing = with_steady_ends(timing, (-1,) if moving else (0, -1))
        excess = along.excess(timing)
        cut = excess > tolerance
        if not cut.any() or (deadline.over() and number >= LEAST_GRIDS):
            break
        s = np.sort(np.concatenate([s, (0.5 * (s[1:] + s[:-1]))[cut]]))
    marks = _marks(np.interp(via_times, timing.s, timing.t))
    for finer in SAMPLE_FACTORS:
        t, state, breaks = sampled([(curve, timing)], finer)
        motion = Motion.from_state(
            family.robot, t, state, label="time-optimal", breaks=breaks, marks=marks
        )
        if not unresolved(family.robot, motion.t, motion.sample).size:
            break
    return _keeping(family, motion, tolerance, moving)


def with_steady_ends(timing: Reached, ends: Sequence[int] = (0, -1)) -> Reached:
    """Return the timing with constant ds/dt in the first (0) and the last (-1) interval.

    At an end at rest the tangent vanishes, so that d2s/dt2 needs no torque and no limit bounds it
    there, but limits do nearby.
    """
    x, start, end = (a.copy() for a in (timing.speed_squared, timing.start, timing.end))
    lasts = np.diff(timing.t)
    for k in ends:
        x[k] = x[1 if k == 0 else -2]
        start[k] = end[k] = 0.0
        lasts[k] = np.diff(timing.s)[k] / np.sqrt(x[k])
    t = np.concatenate([[0.0], np.cumsum(lasts)])
    return replace(timing, speed_squared=x, start=start, end=end, t=t)


def known_ways(family: LimitFamily, via: FloatArray, tolerance: float, fast: bool) -> Slowed | None:
    """Return the fastest motion through via points [m,n] that needs no search, or None.

    Candidates are a spline and straight lines with their best timings. If none keeps all limits to
    the ``tolerance``, a smooth shape is slowed down by one factor.
    """
    for ways in (_timed_ways(family, via, fast), _smooth_ways(family, via)):
        motions = ((_keeping(family, way.motion, tolerance), way.made_from) for way in ways)
        slowed = [Slowed(motion, name) for motion, name in motions if motion is not None]
        if slowed:
            return min(slowed, key=lambda way: way.motion.duration)
    return None


def _timed_ways(family: LimitFamily, via: FloatArray, fast: bool) -> Iterator[Slowed]:
    for name, path in () if family.jerk_matters else _paths(family, via):
        try:
            timing = time_path(family.robot, path, compiled=fast)
        except InputError:  # the path leaves the position limits, or cannot be held at a corner
            continue
        if timing.solved and not timing.limits_kept_by[LATER]:
            marks = _marks(np.interp(path.breaks, timing.s, timing.t))
            yield Slowed(replace(timing.motion("time-optimal"), marks=marks), name)


def _smooth_ways(family: LimitFamily, via: FloatArray) -> Iterator[Slowed]:
    typical = TaskScale.of(family, via).durations
    if family.jerk_matters:
        shapes = [quintic(via, _sums(typical))]
    else:  # dry friction and gravity change the shares of the durations, so equal ones follow
        shapes = [_smooth(family, via, _sums(times)) for times in (typical, np.ones_like(typical))]
    for shape in shapes:
        slowed = _scaled_shape(family, shape)
        if slowed is not None:
            yield Slowed(slowed, "a smooth way through the via points")


def _paths(family: LimitFamily, via: FloatArray) -> Iterator[tuple[str, PiecewisePolynomial]]:
    """Yield ways through via points by name; the parameter of the first is its length."""
    steps = np.diff(via, axis=0) / TaskScale.of(family, via).velocity
    lengths = np.linalg.norm(steps, axis=1)
    yield "a spline through the via points", _smooth(family, via, _sums(lengths))
    yield "straight lines between the via points", straight_through(via)


def _sums(steps: FloatArray) -> FloatArray:
    return np.concatenate([[0.0], np.cumsum(steps)])


POSITION_CHECKS = 1000  # places of a spline at which position limits are checked


def _smooth(family: LimitFamily, via: FloatArray, times: FloatArray) -> PiecewisePolynomial:
    """Return a spline, or cubic segments if the spline overshoots the position limits."""
    shape, limits = spline(via, times), family.robot.limits
    q = shape(np.linspace(times[0], times[-1], POSITION_CHECKS))
    out = ((q < limits.q_min) | (q > limits.q_max)).any()
    return cubic(via, times) if out else shape


def _keeping(
    family: LimitFamily, motion: Motion, tolerance: float, moving: bool = False
) -> Motion | None:
    """Return a motion if it keeps its limits, otherwise its uniform slowdown from rest, or None."""
    if largest_excess(family, motion) <= tolerance:
        return motion
    return None if moving else _slowed_evenly(family, motion, tolerance)


def largest_excess(family: LimitFamily, motion: Motion) -> float:
    """Return the largest relative excess of any limit except rates, also between samples."""
    state = motion.sample(dense_times(motion)[0])
    use = family.use(MotionSamples(*state, np.zeros_like(state.q)), family.of_order(0, 1, 2))
    return max((float(ratio.max()) for ratio in use.values()), default=0.0) - 1.0


DECIDING_PLACES = 500  # places that determine the factor of a uniform slowdown first


def _slowed_evenly(family: LimitFamily, motion: Motion, tolerance: float) -> Motion | None:
    """Return a motion slowed down by one factor until its limits hold, or None."""
    _, samples, _, jumps = motion.history()
    dense = MotionSamples(*map(np.concatenate, zip(samples, jumps, strict=True)))
    most, places = LARGEST_SLOWDOWN, family.use(dense, family.of_order(0))
    if any(not ratio.max() <= 1.0 + tolerance for ratio in places.values()):
        return None  # limits of position do not depend on the speed
    slowed = family.of_order(1, 2, 3)

    def use(slower: float, rows: np.ndarray) -> FloatArray:
        # A slowdown divides the k-th time derivative by its k-th power.
        powers = (part[rows] / slower**order for order, part in enumerate(dense))
        ratios = family.use(MotionSamples(*powers), slowed)
        return np.max([ratio.max(axis=1) for ratio in ratios.values()], axis=0)

    every = np.arange(len(dense.q))
    if not use(most, every).max() <= 1.0 + tolerance:
        return None
    # A few places determine the factor; all places are checked with it, and the worst ones join.
    ratios, deciding, high = use(1.0, every), every[:0], 1.0
    while True:
        broken = ~(ratios <= 1.0 + tolerance)
        if not broken.any():
            break
        worst = np.argsort(-ratios)[: min(DECIDING_PLACES, int(broken.sum()))]
        # The bisection included all of these places: a larger factor does not help them.
        if np.isin(worst, deciding).all():
            return None
        deciding, low, high = np.union1d(deciding, worst), high, most
        while high - low > GAP:
            middle = 0.5 * (low + high)
            fits = use(middle, deciding).max() <= 1.0 + tolerance
            low, high = (low, middle) if fits else (middle, high)
        ratios = use(high, every)
    return motion.stretched(family.robot, high)


def slowed_together(
    families: Sequence[LimitFamily], shapes: Sequence[PiecewisePolynomial], tolerance: float
) -> list[PiecewisePolynomial] | None:
    """Return consecutive shapes slowed down by one common factor until each keeps its limits.

    None if no factor helps.
    """

    def kept(shape: PiecewisePolynomial, family: LimitFamily) -> bool:
        return float(excess_along(family, shape).max()) <= tolerance

    if all(map(kept, shapes, families)):
        return list(shapes)
    factor = 1.0
    for family, shape in zip(families, shapes, strict=True):
        motion = Motion.from_polynomial(family.robot, shape, label="")
        slowed = _slowed_evenly(family, motion, tolerance)
        if slowed is None:
            return None
        factor = max(factor, slowed.duration / shape.duration)
    slower = [shape.stretched(factor) for shape in shapes]
    return slower if all(map(kept, slower, families)) else None


def _scaled_shape(family: LimitFamily, shape: PiecewisePolynomial) -> Motion | None:
    """Return a shape at its shortest duration within all limits, with marks at its breaks."""
    try:
        scaled = shortest_duration(family.robot, shape)
    except InputError:  # gravity alone exceeds a limit, or the shape leaves the position limits
        return None
    if not scaled.utilisation <= 1.0:  # the time limit may end the scaling early
        return None
    marks = _marks(scaled.polynomial.breaks)
    return Motion.from_polynomial(
        family.robot, scaled.polynomial, label="time-optimal", marks=marks
    )


def _marks(times: FloatArray) -> tuple[Mark, ...]:
    return tuple(Mark(float(at), f"via {i + 1}") for i, at in enumerate(times))
