"""The shortest duration of a shape over all divisions of the time between its parts."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.limits import ROUNDING, LimitFamily, MotionSamples, orders_of, samples_of
from microbot_ocp.motion import PiecewisePolynomial
from microbot_ocp.robot import JointLimits, Limits, Robot
from microbot_ocp.trajectories._shortest_duration import (
    LONGEST_DURATION,
    Scaled,
    checked_shape,
    shortest_duration,
)

MakeSplit = Callable[..., PiecewisePolynomial]
DIFFERENCE = float(np.sqrt(np.finfo(float).eps))  # step of the logarithms for finite differences
POINTS = 48  # points of a piece for the largest uses; the result is stretched exactly
SPLIT_TOLERANCE = 1e-4  # relative gain in duration below which a search ends
STRIDE = 3  # every third point is a row of the program, too


def best_split(
    robot: Robot,
    make_motion: MakeSplit,
    first_durations: ArrayLike,
    limits: Limits | JointLimits | None = None,
    *,
    first_shape: ArrayLike | None = None,
    tolerance: float = SPLIT_TOLERANCE,
    time_limit: float = np.inf,
) -> Scaled:
    """Return the shortest duration of a shape over the durations of its parts and further numbers.

    :func:`shortest_duration` stretches all parts alike; here each part, such as the segment between
    two via points, has a duration of its own. The method is a trust-region method for the maximum
    of smooth functions (Fletcher, *Practical Methods of Optimization*, 2nd ed., chapter 14). It
    linearises the uses of the limits, at their local maxima and on a coarse grid, in the logarithms
    of the durations and in the further numbers. A quadratic program (DAQP; a linear one, HiGHS, at
    first) with the curvature of the Lagrangian (damped BFGS) proposes the best step within the
    trust region, and the new split is stretched until it just meets a limit. The region grows if
    the predicted gain is achieved and shrinks otherwise. Splits that leave the position limits, or
    whose poses cannot be held at rest, are repaired by similar steps. The result is the best of
    the local optima from all first splits.

    Parameters
    ----------
    robot : Robot
    make_motion : callable
        Function ``durations of the parts (array [k], s) -> PiecewisePolynomial``; twice the
        durations must give the motion at half the speed. With ``first_shape``:
        ``(durations, shape (array [p])) -> PiecewisePolynomial``.
    first_durations : array_like [k] or [s,k]
        Initial durations of the parts, s; only their ratios matter. :func:`first_splits` has two
        for segments between via points.
    limits : Limits or JointLimits, optional
        Limits; default ``robot.limits``.
    first_shape : array_like [p] or [s,p], optional
        Initial further numbers, which must not depend on the speed and have the magnitude of a
        joint's travel, such as velocities at via points times the sum of the durations.
    tolerance : float
        Relative gain in duration, predicted by the quadratic program, below which the search ends.
    time_limit : float
        Wall time, s, after which the best result so far has the status "time limit".

    Returns
    -------
    Scaled
        Motion; ``split`` holds the durations of the parts.

    Raises
    ------
    InputError
        Errors of :func:`shortest_duration` for the best split; a ``make_motion`` whose motion does
        not scale with the durations; or first durations that are not above zero.

    Examples
    --------
    >>> import numpy as np
    >>> import microbot_ocp as mo
    >>> robot = mo.load_robot("microbot")
    >>> via_q = [[0.0, 0.0, 0.0], [0.5, 0.2, 0.0], [2.0, 0.0, 0.0]]
    >>> def make(durations, shape):
    ...     speeds = [np.zeros(3), shape / sum(durations), np.zeros(3)]
    ...     return mo.cubic(via_q, np.cumsum([0.0, *durations]), speeds)
    >>> even = mo.shortest_duration(robot, mo.cubic(via_q, [0.0, 1.0, 2.0]))
    >>> best = mo.best_split(robot, make, [1.0, 1.0], first_shape=[0.0, 0.0, 0.0])
    >>> best.duration < 0.9 * even.duration
    True
    """
    started = time.perf_counter()
    with deadline.within(time_limit):
        search = _SplitSearch(robot, make_motion, limits, tolerance)
        split = search.best(first_durations, first_shape)
        ended = deadline.over()
        scaled = shortest_duration(robot, split.shape, limits)
    return replace(
        scaled,
        split=np.exp(split.point[: search.parts]) * scaled.factor,
        factor=np.nan,
        iterations=search.tried + scaled.iterations,
        wall_time=time.perf_counter() - started,
        status=deadline.status() if ended else scaled.status,
    )


def split_and_shape(
    robot: Robot,
    make_motion: MakeSplit,
    first_durations: ArrayLike,
    limits: Limits | JointLimits | None = None,
    *,
    first_shape: ArrayLike | None = None,
) -> tuple[FloatArray, PiecewisePolynomial]:
    """Return the durations [k] and the shape from :func:`best_split`, even a refused one.

    A path timing may keep limits that the shape violates at any duration.
    """
    search = _SplitSearch(robot, make_motion, limits)
    split = search.best(first_durations, first_shape)
    return np.exp(split.point[: search.parts]), split.shape


def first_splits(via_q: ArrayLike) -> FloatArray:
    """Return initial splits [2,m-1]: equal, and proportional to the largest step of a segment.

    Examples
    --------
    >>> first_splits([[0.0, 0.0], [1.0, 3.0], [1.5, 3.0]]).tolist()
    [[1.0, 1.0], [1.0, 0.16666666666666666]]
    """
    via = checks.array("via_q", via_q, (None, None))
    if min(via.shape) == 0 or len(via) < 2:
        raise InputError(f"via_q must have at least 2 rows and a column, not shape {via.shape}")
    steps = np.abs(np.diff(via, axis=0)).max(axis=1)
    return np.stack([np.ones(steps.size), steps / steps.max()])


@dataclass(frozen=True, eq=False)
class _Split:
    """A shape, and the uses of the limits at their local maxima and on a coarse grid along it.

    Attributes
    ----------
    point : array [k+p]
        Logarithms of the durations of the parts, followed by the further numbers.
    shape : PiecewisePolynomial
    piece, fraction : array [S]
        Piece, and share of its duration, of each sample.
    at, channel, use : array [R]
        Sample, limit and value of each use.
    lasting : array [R] of bool
        True for uses that do not depend on the duration: of positions, and of the arm at rest.
    violation : float
        Largest excess of the uses in ``lasting``.
    log_duration : float
    """

    point: FloatArray
    shape: PiecewisePolynomial
    piece: np.ndarray
    fraction: FloatArray
    at: np.ndarray
    channel: np.ndarray
    use: FloatArray
    lasting: np.ndarray
    violation: float
    log_duration: float


class _Trial(NamedTuple):
    """A step of the point, its predicted relative gain, and the multipliers [R] of the uses."""

    change: FloatArray
    promise: float
    multipliers: FloatArray


class _SplitSearch:
    """Search for the best split, which counts the shapes that it tries."""

    def __init__(
        self,
        robot: Robot,
        make: MakeSplit,
        limits: Limits | JointLimits | None,
        tolerance: float = SPLIT_TOLERANCE,
    ) -> None:
        self.family = LimitFamily.of(robot, limits)
        self.family.refuse_means()
        self.make = make
        self.tolerance = checks.number("tolerance", tolerance, above=0.0, at_most=0.1)
        self.tried = 0
        self.parts, self.shaped = 0, False
        self.weights = np.empty(0)  # derivatives of the whole duration by the parts' durations
        self.units = np.empty(0)  # scales of a point's entries

    def best(self, first_durations: ArrayLike, first_shape: ArrayLike | None = None) -> _Split:
        """Return the best split that the search finds from any of the first ones."""
        first = checks.array("first_durations", np.atleast_2d(first_durations), (None, None), "s")
        if not first.size or not np.all(first > 0.0):
            raise InputError(f"first_durations must be above 0 s, not {first.tolist()}")
        count, self.parts = first.shape
        shapes = np.empty((count, 0))
        self.shaped = first_shape is not None
        if first_shape is not None:
            shapes = np.atleast_2d(first_shape)
            shapes = checks.array("first_shape", shapes, (count, None))
        points = np.unique(np.hstack([np.log(first), shapes]), axis=0)
        shape = self._check_stretch(points[0])
        extent = max(np.ptp(shape(shape.breaks), axis=0).max(), DIFFERENCE)
        self.units = np.append(np.ones(self.parts), np.full(shapes.shape[1], extent))
        # The whole duration is linear in those of the parts: doubling each gives its weight.
        longer = points[0] + np.log(2.0) * np.eye(self.parts, points.shape[1])
        added = np.array([self.shape_at(point).duration for point in longer]) - shape.duration
        self.weights = added / np.exp(points[0, : self.parts])
        splits = [self.best_from(point) for point in points]
        return min(splits, key=lambda split: (split.violation, split.log_duration))

    def _check_stretch(self, point: FloatArray) -> PiecewisePolynomial:
        shape = checked_shape(self.family.robot, self.shape_at(point))
        slower = self.shape_at(point + np.log(2.0) * (np.arange(point.size) < self.parts))
        same = shape.stretched(2.0)
        if slower.coefficients.shape != same.coefficients.shape or not (
            np.allclose(slower.breaks, same.breaks)
            and np.allclose(slower.coefficients, same.coefficients)
        ):
            raise InputError(
                "make_motion must return the same shape, twice as slow, where all durations are "
                "twice as long"
            )
        return shape

    def shape_at(self, point: FloatArray) -> PiecewisePolynomial:
        """Return the shape of a point."""
        durations = np.exp(point[: self.parts])
        return self.make(durations, point[self.parts :]) if self.shaped else self.make(durations)

    def best_from(self, point: FloatArray) -> _Split:
        """Return the local optimum that quadratic programs reach from a point."""
        split, reach = self.stretched(point), np.log(2.0)
        slopes, curvature = None, np.zeros((point.size, point.size))
        while (split.violation or not split.lasting.all()) and not deadline.over():
            slopes = self.slopes(split.point, split) if slopes is None else slopes
            step = self.step(split, slopes, curvature, reach)
            if step.promise <= self.tolerance * (split.violation or 1.0):
                break
            point = split.point + self.units * step.change
            if split.violation:  # a violation that stretching does not change
                point[: self.parts] -= np.log(self.weights @ np.exp(point[: self.parts]))
            other = self.stretched(point)
            gain = split.violation - other.violation
            if not split.violation:
                gain = -np.inf if other.violation else split.log_duration - other.log_duration
                curvature = self.updated(curvature, split, slopes, other, step.multipliers)
            if gain > 0.5 * step.promise:
                reach *= 2.0
            elif gain < 0.25 * step.promise:
                reach = 0.5 * min(reach, np.abs(step.change).max())
            if gain > 0.0:
                split, slopes = other, None
        return split

    def stretched(self, point: FloatArray) -> _Split:
        """Return the split at these ratios that just meets a limit (bracketed Newton's method)."""
        first, too_short, enough = float(point[0]), -np.inf, np.inf
        while True:
            split = self.at(point)
            moving = ~split.lasting
            if split.violation or not moving.any() or deadline.over():
                return split
            use = split.use[moving]
            pair = self.uses([split.shape, split.shape.stretched(1.0 + DIFFERENCE)], split)
            slope = (pair[1] - pair[0])[moving] / DIFFERENCE
            here, double = float(point[0]), float(np.log(2.0))
            if here - first > np.log(LONGEST_DURATION):
                return replace(split, violation=float(use.max()) - 1.0)
            too_short, enough = (here, enough) if use.max() > 1.0 else (too_short, here)
            # The use does not fall with the duration here.
            held = np.where(use > 1.0, double, -np.inf)
            falls = slope < 0.0
            # The model use0 exp(slope / use0 x) in x = log T is 1 at x = -use0 log(use0) / slope.
            wanted = np.where(falls, -use * np.log(use) / np.where(falls, slope, 1.0), held)
            change = float(np.clip(wanted.max(), -double, np.log(LONGEST_DURATION)))
            if abs(change) <= self.tolerance or enough - too_short <= self.tolerance:
                return replace(split, log_duration=split.log_duration + change)
            if not too_short < here + change < enough:
                change = 0.5 * (too_short + enough) - here
            point = point + change * (np.arange(point.size) < self.parts)

    def at(self, point: FloatArray) -> _Split:
        """Return the split of a point, with the maxima of its uses."""
        self.tried += 1
        shape = self.shape_at(point)
        count, points = len(shape.breaks) - 1, POINTS + 1
        piece = np.repeat(np.arange(count), points)
        fraction = np.tile(np.linspace(0, 1, points), count)
        lasting, moving = self.uses_at(_samples(shape, piece, fraction))
        use = np.hstack([lasting, moving]).reshape(count, points, -1)
        padded = np.pad(use, ((0, 0), (1, 1), (0, 0)), constant_values=-np.inf)
        before, after = padded[:, :-2], padded[:, 2:]
        chosen = (use >= before) & (use > after)
        inside = chosen & np.isfinite(before) & np.isfinite(after)
        bend = np.where(inside, 2.0 * use - before - after, 1.0)
        # The vertex of a parabola through a maximum and its neighbours lies above the maximum.
        use = use + np.where(inside, (after - before) ** 2, 0.0) / (8.0 * bend)
        chosen[:, ::STRIDE] = True  # the maxima move with the step, and new ones arise between them
        row, channel = np.nonzero((chosen & (use > 0.0)).reshape(count * points, -1))
        sample, at = np.unique(row, return_inverse=True)
        violation = float(use[..., : lasting.shape[1]].max(initial=0.0)) - 1.0
        return _Split(
            point=point,
            shape=shape,
            piece=piece[sample],
            fraction=fraction[sample],
            at=at,
            channel=channel,
            use=use.reshape(count * points, -1)[row, channel],
            lasting=channel < lasting.shape[1],
            violation=violation if violation > ROUNDING else 0.0,
            log_duration=float(np.log(shape.duration)),
        )

    def uses(self, shapes: Sequence[PiecewisePolynomial], split: _Split) -> FloatArray:
        """Return uses [c,R] of other shapes at the samples and channels of a split."""
        samples = [_samples(shape, split.piece, split.fraction) for shape in shapes]
        joined = MotionSamples(*map(np.concatenate, zip(*samples, strict=True)))
        uses = np.hstack(self.uses_at(joined)).reshape(len(shapes), split.piece.size, -1)
        return uses[:, split.at, split.channel]

    def uses_at(self, samples: MotionSamples) -> tuple[FloatArray, FloatArray]:
        """Return the uses [S, ...] that do not depend on the duration, and those of the motion."""
        rest, limited = MotionSamples.at_rest(samples.q), self.family.of_order(1, 2, 3)
        held = [key for key in limited if key not in ("qd", "qdd", "qddd", "taud")]
        lasting = self.family.use(samples, self.family.of_order(0)) | self.family.use(rest, held)
        empty = np.empty((len(samples.q), 0))
        moving = self.family.use(samples, limited)
        return np.hstack([empty, *lasting.values()]), np.hstack([empty, *moving.values()])

    def slopes(self, point: FloatArray, split: _Split) -> FloatArray:
        """Return derivatives [R,k+p] of the uses at a point, at the samples of a split."""
        changes = np.vstack([np.zeros(point.size), DIFFERENCE * np.diag(self.units)])
        uses = self.uses([self.shape_at(point + change) for change in changes], split)
        return (uses[1:] - uses[0]).T / DIFFERENCE

    def shares(self, point: FloatArray) -> FloatArray:
        """Return derivatives [k+p] of the logarithm of the duration."""
        durations = self.weights * np.exp(point[: self.parts])
        return np.append(durations / durations.sum(), np.zeros(point.size - self.parts))

    def updated(
        self,
        curvature: FloatArray,
        split: _Split,
        slopes: FloatArray,
        other: _Split,
        multipliers: FloatArray,
    ) -> FloatArray:
        """Return the curvature [k+p,k+p] of the Lagrangian after a damped BFGS update."""
        active = multipliers > 0.0
        if not active.any():
            return curvature
        at = split.at[active]
        places = replace(
            split,
            piece=split.piece[at],
            fraction=split.fraction[at],
            at=np.arange(at.size),
            channel=split.channel[active],
        )
        turned = self.slopes(other.point, places) - slopes[active]
        change = (other.point - split.point) / self.units
        rise = multipliers[active] @ turned + self.shares(other.point) - self.shares(split.point)
        if not curvature.any():  # the first step gives the scale
            size = max(float(change @ rise), 0.0) / max(float(change @ change), DIFFERENCE)
            curvature = max(size, DIFFERENCE) * np.eye(change.size)
        there = curvature @ change
        known, seen = float(change @ there), float(change @ rise)
        if known <= 0.0:
            return curvature
        # Powell's damping keeps the curvature positive definite.
        damping = 1.0 if seen >= 0.2 * known else 0.8 * known / (known - seen)
        rise = damping * rise + (1.0 - damping) * there
        return curvature + np.outer(rise, rise) / (change @ rise) - np.outer(there, there) / known

    def step(
        self, split: _Split, slopes: FloatArray, curvature: FloatArray, reach: float
    ) -> _Trial:
        """Return the step of the largest predicted gain, at most ``reach`` units in each entry."""
        cost = self.shares(split.point)
        size = cost.size
        # Uses that stretching cannot reduce get a margin, so that a step along them keeps them.
        inside = 1.0 - self.tolerance
        farthest = reach * np.abs(slopes).sum(axis=1)
        room = np.maximum(1.0 - split.use, 0.0)
        room = np.where(split.lasting, np.maximum(inside - split.use, -0.5 * farthest), room)
        within, rows = farthest > room, slopes
        least, most = np.full(size, -reach), np.full(size, reach)
        # A part shorter than this share of the whole is indistinguishable from zero.
        shortest = np.log(DIFFERENCE) + split.log_duration - split.point[: self.parts]
        least[: self.parts] = np.maximum(np.minimum(shortest, 0.0), -reach)
        if split.violation:  # the last variable is the largest such use
            within, room, cost = split.lasting, -split.use, np.append(np.zeros(size), 1.0)
            rows = np.column_stack([slopes, -np.ones(len(slopes))])
            least, most = np.append(least, inside), np.append(most, np.inf)
            curvature = np.zeros((cost.size, cost.size))
        solver = _program(cost.size, int(within.sum()), bool(curvature.any()))
        given = {"h": curvature} if curvature.any() else {}
        answer = solver(**given, g=cost, a=rows[within], uba=room[within], lbx=least, ubx=most)
        change = np.array(answer["x"]).ravel()
        multipliers = np.zeros(room.size)
        multipliers[within] = np.maximum(np.array(answer["lam_a"]).ravel(), 0.0)
        if not solver.stats()["success"]:
            return _Trial(np.zeros(size), 0.0, multipliers)
        promise = 1.0 + split.violation - change[-1] if split.violation else -cost @ change
        promise = promise if split.violation else promise - 0.5 * change @ curvature @ change
        return _Trial(change[:size], float(promise), multipliers)


def _program(count: int, rows: int, curved: bool) -> ca.Function:
    """Return the solver of a step, for quadratic or for linear programs."""
    h = ca.Sparsity.dense(count, count) if curved else ca.Sparsity(count, count)
    options: dict[str, Any] = {} if curved else {"highs": {"output_flag": False}}
    return ca.conic(
        "step",
        "daqp" if curved else "highs",
        {"h": h, "a": ca.Sparsity.dense(rows, count)},
        {"error_on_fail": False, **options},
    )


def _samples(shape: PiecewisePolynomial, piece: np.ndarray, fraction: FloatArray) -> MotionSamples:
    return samples_of(orders_of(shape), piece, np.diff(shape.breaks)[piece] * fraction)
