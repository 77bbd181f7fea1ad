"""Motions that keep every limit, from one that exceeds some between the points of its mesh.

The path of such a motion is timed anew: no faster than before anywhere, and slower only where a
limit asks for it. That takes two passes of reachability, and costs about as much as one more mesh
would gain. Limits of jerk and torque rate, and others that reachability cannot keep, take a motion
that is slowed down evenly. Where nothing is found at all there are ways that need no search.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
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
from microbot_ocp.planning.task import TaskScale
from microbot_ocp.trajectories import cubic, quintic, shortest_duration, spline


@dataclass(frozen=True)
class SlowingDown:
    """Settings by which a motion is slowed down until limits hold.

    Attributes
    ----------
    grid : intervals at least, to begin with
    least_rounds : grids that are looked at though the time is over
    rounds : grids, each with the intervals cut in which a limit is exceeded
    finer : times the usual samples, until torques between them are no surprise
    close : share by which a motion that is slowed down evenly might be faster
    deciding : places of a motion that say first by how much it is slowed down evenly
    seen : places of a spline at which it may leave the position limits
    most_evenly : times the duration: a motion that must be slowed down more is none to go on
        from
    """

    grid: int = 1000
    least_rounds: int = 2
    rounds: int = 6
    finer: tuple[int, ...] = (1, 2, 4, 8)
    close: float = 1e-5
    deciding: int = 500
    seen: int = 1000
    most_evenly: float = 1.5


SLOWING = SlowingDown()


class Slowed(NamedTuple):
    """A motion that keeps its limits, with the name of what it was made from."""

    motion: Motion
    made_from: str


def within_limits(
    family: LimitFamily,
    shape: PiecewisePolynomial,
    via_times: FloatArray,
    tolerance: float,
    fast: bool,
    *,
    moving: bool = False,
) -> Motion | None:
    """Return the motion ``shape``, slowed down where it exceeds limits; None where that does not
    help.

    Parameters
    ----------
    family : LimitFamily
    shape : PiecewisePolynomial
        A motion that ends at rest, smooth but for its acceleration.
    via_times : array [m]
        When it passes the via points, s.
    tolerance : float
        Largest relative excess of a limit, between samples, too.
    fast : bool
        Use compiled functions.
    moving : bool
        Whether the motion begins at a speed that stays: nothing is slowed down evenly then.
    """

    def evenly() -> Motion | None:
        if moving:
            return None
        marks = _marks(via_times)
        motion = Motion.from_polynomial(family.robot, shape, label="time-optimal", marks=marks)
        return _slowed_evenly(family, motion, tolerance)

    if family.means:  # slower is no less of a mean
        return None
    if family.jerk_matters:
        return evenly()
    pieces = map(CurvePiece, shape.coefficients, np.diff(shape.breaks).tolist())
    curve = PathCurve(tuple(pieces), True, True)
    parts = max(2, -(-SLOWING.grid // len(curve.pieces)))
    count = parts * len(curve.pieces)
    s = np.interp(np.arange(count + 1) / parts, np.arange(shape.breaks.size), shape.breaks)
    s[::parts] = shape.breaks
    for number in range(SLOWING.rounds):
        along = CurveLimits.of(family, curve, s, fast)
        if along.limits.later:
            return evenly()
        ends = {"start_free": not moving, "end_free": True, "ends": (float(moving), 0.0)}
        timing = reach(along, fastest=1.0, **ends)
        if not timing.feasible:
            return None
        timing = with_steady_ends(timing, (-1,) if moving else (0, -1))
        excess = along.excess(timing)
        cut = excess > tolerance
        if not cut.any() or (deadline.over() and number >= SLOWING.least_rounds):
            break
        s = np.sort(np.concatenate([s, (0.5 * (s[1:] + s[:-1]))[cut]]))
    marks = _marks(np.interp(via_times, timing.s, timing.t))
    for finer in SLOWING.finer:
        t, state, breaks = sampled([(curve, timing)], finer)
        motion = Motion.from_state(
            family.robot, t, state, label="time-optimal", breaks=breaks, marks=marks
        )
        if not unresolved(family.robot, motion.t, motion.sample).size:
            break
    return _keeping(family, motion, tolerance, moving)


def with_steady_ends(timing: Reached, ends: Sequence[int] = (0, -1)) -> Reached:
    """Return the same with an even ds/dt in the first (0) and the last (-1) interval.

    At an end at rest d2s/dt2 asks for no torque, so that nothing bounds it there, but close by.
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
    """Return the fastest motion through via points [m,n] that needs no search, where there is one.

    A spline or straight lines with their best timing; where these have none that keeps all limits
    to the ``tolerance``, a shape that is slowed down evenly.
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
        except InputError:  # it leaves the position limits, or cannot be held at a corner
            continue
        if timing.solved and not timing.limits_kept_by[LATER]:
            marks = _marks(np.interp(path.breaks, timing.s, timing.t))
            yield Slowed(replace(timing.motion("time-optimal"), marks=marks), name)


def _smooth_ways(family: LimitFamily, via: FloatArray) -> Iterator[Slowed]:
    typical = TaskScale.of(family, via).durations
    if family.jerk_matters:
        shapes = [quintic(via, _sums(typical))]
    else:  # dry friction and gravity ask for other shares of the time than limits let expect
        shapes = [_smooth(family, via, _sums(times)) for times in (typical, np.ones_like(typical))]
    for shape in shapes:
        slowed = _scaled_shape(family, shape)
        if slowed is not None:
            yield Slowed(slowed, "a smooth way through the via points")


def _paths(family: LimitFamily, via: FloatArray) -> Iterator[tuple[str, PiecewisePolynomial]]:
    """Yield ways through via points by name; the parameter of the first is the distance
    travelled.
    """
    steps = np.diff(via, axis=0) / TaskScale.of(family, via).velocity
    lengths = np.linalg.norm(steps, axis=1)
    yield "a spline through the via points", _smooth(family, via, _sums(lengths))
    yield "straight lines between the via points", straight_through(via)


def _sums(steps: FloatArray) -> FloatArray:
    return np.concatenate([[0.0], np.cumsum(steps)])


def _smooth(family: LimitFamily, via: FloatArray, times: FloatArray) -> PiecewisePolynomial:
    """Return a spline, or cubic segments, which swing out less, where it leaves the position
    limits.
    """
    shape, limits = spline(via, times), family.robot.limits
    q = shape(np.linspace(times[0], times[-1], SLOWING.seen))
    out = ((q < limits.q_min) | (q > limits.q_max)).any()
    return cubic(via, times) if out else shape


def _keeping(
    family: LimitFamily, motion: Motion, tolerance: float, moving: bool = False
) -> Motion | None:
    """Return a motion that keeps its limits, as it is or, from rest, slowed down evenly; None where
    that is none.
    """
    if largest_excess(family, motion) <= tolerance:
        return motion
    return None if moving else _slowed_evenly(family, motion, tolerance)


def largest_excess(family: LimitFamily, motion: Motion) -> float:
    """Return that of any limit but those of rates, relative, between samples, too."""
    state = motion.sample(dense_times(motion)[0])
    use = family.use(MotionSamples(*state, np.zeros_like(state.q)), family.of_order(0, 1, 2))
    return max((float(ratio.max()) for ratio in use.values()), default=0.0) - 1.0


def _slowed_evenly(family: LimitFamily, motion: Motion, tolerance: float) -> Motion | None:
    """Return a motion slowed down until its limits hold to the tolerance, where that helps."""
    _, samples, _, jumps = motion.history()
    dense = MotionSamples(*map(np.concatenate, zip(samples, jumps, strict=True)))
    most, places = SLOWING.most_evenly, family.use(dense, family.of_order(0))
    if any(not ratio.max() <= 1.0 + tolerance for ratio in places.values()):
        return None  # slower is no other place
    slowed = family.of_order(1, 2, 3)

    def use(slower: float, rows: np.ndarray) -> FloatArray:
        powers = (part[rows] / slower**order for order, part in enumerate(dense))
        ratios = family.use(MotionSamples(*powers), slowed)
        return np.max([ratio.max(axis=1) for ratio in ratios.values()], axis=0)

    every = np.arange(len(dense.q))
    if not use(most, every).max() <= 1.0 + tolerance:
        return None
    # Few places decide by how much; all of them are looked at again with what those ask for.
    ratios, deciding, high = use(1.0, every), every[:0], 1.0
    while True:
        broken = ~(ratios <= 1.0 + tolerance)
        if not broken.any():
            break
        worst = np.argsort(-ratios)[: min(SLOWING.deciding, int(broken.sum()))]
        if np.isin(worst, deciding).all():
            return None
        deciding, low, high = np.union1d(deciding, worst), high, most
        while high - low > SLOWING.close:
            middle = 0.5 * (low + high)
            fits = use(middle, deciding).max() <= 1.0 + tolerance
            low, high = (low, middle) if fits else (middle, high)
        ratios = use(high, every)
    return motion.stretched(family.robot, high)


def slowed_together(
    families: Sequence[LimitFamily], shapes: Sequence[PiecewisePolynomial], tolerance: float
) -> list[PiecewisePolynomial] | None:
    """Return shapes that follow one another, slowed down evenly by one factor until each keeps the
    limits of its family to the tolerance; None where that does not help.
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
    """Give a shape at the shortest duration at which it keeps all limits; its breaks are marked."""
    try:
        scaled = shortest_duration(family.robot, shape, time_limit=max(deadline.left(), 1e-3))
    except InputError:  # gravity alone asks for more, or it leaves the position limits
        return None
    if not scaled.utilisation <= 1.0:  # when the time was over it may keep them, too
        return None
    marks = _marks(scaled.polynomial.breaks)
    return Motion.from_polynomial(
        family.robot, scaled.polynomial, label="time-optimal", marks=marks
    )


def _marks(times: FloatArray) -> tuple[Mark, ...]:
    return tuple(Mark(float(at), f"via {i + 1}") for i, at in enumerate(times))
