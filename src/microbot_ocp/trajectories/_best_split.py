"""The shortest duration of a shape whose parts may share the time as suits the limits best."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.limits import ROUNDING, LimitFamily, MotionSamples
from microbot_ocp.limits._history import PEAK_SEARCH, orders_of, samples_of
from microbot_ocp.motion import PiecewisePolynomial
from microbot_ocp.robot import JointLimits, Limits, Robot
from microbot_ocp.trajectories._shortest_duration import (
    DURATION_SEARCH,
    Scaled,
    checked_shape,
    shortest_duration,
)

MakeSplit = Callable[[FloatArray], PiecewisePolynomial]
DIFFERENCE = float(np.sqrt(np.finfo(float).eps))  # of logarithms, for slopes by differences


def best_split(
    robot: Robot,
    make_motion: MakeSplit,
    first_durations: ArrayLike,
    limits: Limits | JointLimits | None = None,
    *,
    tolerance: float = 1e-4,
    time_limit: float = np.inf,
) -> Scaled:
    """Return the shortest duration of a shape over all splits of its time between its parts.

    :func:`shortest_duration` stretches all parts alike; here each part, such as the segment between
    two via points, has a duration of its own. The uses of the limits are linearised at all their
    local maxima in the logarithms of the durations, and a linear program (HiGHS) proposes the best
    durations within a factor, which grows where promises are kept and shrinks where they are not;
    what is proposed is stretched until a limit is just met. This is a trust-region method for the
    maximum of smooth functions (Fletcher, *Practical Methods of Optimization*, 2nd ed., chapter
    14). Splits that leave the position limits, or whose poses cannot be held at rest, are left the
    same way. The answer is a local optimum: the best of those from the first splits.

    Parameters
    ----------
    robot : Robot
    make_motion : callable
        ``durations of the parts (array [k], s) -> PiecewisePolynomial``, which is stretched as they
        are: twice the durations give the same shape, twice as slow.
    first_durations : array_like [k] or [s,k]
        One or several splits to start from, s; only their ratios matter. :func:`first_splits` has
        two for segments between via points.
    limits : Limits or JointLimits, optional
        Default ``robot.limits``.
    tolerance : float
        The search ends where, to first order, no split promises a duration that is shorter by more
        than this share.
    time_limit : float
        Wall time, s, after which the best so far is returned with the status "time limit".

    Returns
    -------
    Scaled
        ``split`` holds the durations of the parts.

    Raises
    ------
    InputError
        As of :func:`shortest_duration`, for the best split; a ``make_motion`` that does not stretch
        its shape; first durations that are not above zero.

    Examples
    --------
    >>> import numpy as np
    >>> import microbot_ocp as mo
    >>> robot = mo.load_robot("microbot")
    >>> via_q = [[0.0, 0.0, 0.0], [0.5, 0.2, 0.0], [2.0, 0.0, 0.0]]
    >>> def make(durations):
    ...     return mo.cubic(via_q, np.cumsum([0.0, *durations]))
    >>> even = mo.shortest_duration(robot, make([1.0, 1.0]))
    >>> best = mo.best_split(robot, make, [1.0, 1.0])
    >>> best.duration < 0.9 * even.duration
    True
    """
    started = time.perf_counter()
    with deadline.within(time_limit):
        search = _SplitSearch(robot, make_motion, limits, tolerance)
        durations = search.best(first_durations)
        ended = deadline.over()
        scaled = shortest_duration(robot, make_motion(durations), limits)
    return replace(
        scaled,
        split=durations * scaled.factor,
        factor=np.nan,
        iterations=search.tried + scaled.iterations,
        wall_time=time.perf_counter() - started,
        status=deadline.status() if ended else scaled.status,
    )


def best_durations(
    robot: Robot,
    make_motion: MakeSplit,
    first_durations: ArrayLike,
    limits: Limits | JointLimits | None = None,
) -> FloatArray:
    """Return durations [k] of the parts as :func:`best_split` chooses them, of a shape that it may
    refuse.

    For the timing of a path, whose shape depends on their ratios.
    """
    return _SplitSearch(robot, make_motion, limits).best(first_durations)


def first_splits(via_q: ArrayLike) -> FloatArray:
    """Return splits [2,m-1] to start from: segments of equal times, and as long as their largest
    step.

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


def _check_stretch(robot: Robot, make: MakeSplit, durations: FloatArray) -> None:
    shape, slower = checked_shape(robot, make(durations)), make(2.0 * durations)
    same = shape.stretched(2.0)
    if slower.coefficients.shape != same.coefficients.shape or not (
        np.allclose(slower.breaks, same.breaks)
        and np.allclose(slower.coefficients, same.coefficients)
    ):
        raise InputError(
            "make_motion must return the same shape, twice as slow, where all durations are twice "
            "as long"
        )


@dataclass(frozen=True, eq=False)
class _Split:
    """Durations of the parts, and the local maxima of every use along the shape.

    Attributes
    ----------
    logs : array [k]
        Logarithms of the durations.
    shape : PiecewisePolynomial
    piece, fraction : array [S]
        Where the maxima are.
    at, channel, use : array [R]
        Sample, limit and value of each maximum.
    lasting : array [R] of bool
        Whether it does not depend on the duration: of positions, and of the arm held at rest.
    violation : float
        Largest excess of those.
    log_duration : float
    """

    logs: FloatArray
    shape: PiecewisePolynomial
    piece: np.ndarray
    fraction: FloatArray
    at: np.ndarray
    channel: np.ndarray
    use: FloatArray
    lasting: np.ndarray
    violation: float
    log_duration: float


class _SplitSearch:
    """Searches for the best split from first ones; counts the shapes that are tried."""

    def __init__(
        self,
        robot: Robot,
        make: MakeSplit,
        limits: Limits | JointLimits | None,
        tolerance: float = 1e-4,
    ) -> None:
        self.family = LimitFamily.of(robot, limits)
        self.family.refuse_means()
        self.make = make
        self.tolerance = checks.number("tolerance", tolerance, above=0.0, at_most=0.1)
        self.tried = 0
        self.weights = np.empty(0)  # of the parts' durations in the whole one

    def best(self, first_durations: ArrayLike) -> FloatArray:
        """Return the durations of the best split that is found from any of the first ones."""
        first = checks.array("first_durations", np.atleast_2d(first_durations), (None, None), "s")
        if not first.size or not np.all(first > 0.0):
            raise InputError(f"first_durations must be above 0 s, not {first.tolist()}")
        _check_stretch(self.family.robot, self.make, first[0])
        if first.shape[1] == 1:
            return first[0]
        units = first[0] * (1.0 + np.eye(first.shape[1]))
        longer = np.array([self.make(durations).duration for durations in units])
        self.weights = (longer - self.make(first[0]).duration) / first[0]
        splits = [self.best_from(np.log(durations)) for durations in first]
        best = min(splits, key=lambda split: (split.violation, split.log_duration))
        return np.exp(best.logs)

    def best_from(self, logs: FloatArray) -> _Split:
        """Follow linear programs downhill."""
        split, reach = self.stretched(logs), np.log(2.0)
        slopes = None
        while (split.violation or not split.lasting.all()) and not deadline.over():
            slopes = self.slopes(split) if slopes is None else slopes
            step, promise = self.step(split, slopes, reach)
            if promise <= self.tolerance:
                break
            logs = split.logs + step
            if split.violation:  # which no stretch changes
                logs = logs - np.log(self.weights @ np.exp(logs))
            other = self.stretched(logs)
            gain = split.violation - other.violation
            if not split.violation:
                gain = -np.inf if other.violation else split.log_duration - other.log_duration
            reach *= 2.0 if gain > 0.5 * promise else 0.5
            if gain > 0.0:
                split, slopes = other, None
        return split

    def stretched(self, logs: FloatArray) -> _Split:
        """Return the split with these ratios that just meets a limit: Newton's method, with a
        bracket.
        """
        first, too_short, enough = float(logs[0]), -np.inf, np.inf
        while True:
            split = self.at(logs)
            moving = ~split.lasting
            if split.violation or not moving.any() or deadline.over():
                return split
            use = split.use[moving]
            slower = split.shape.stretched(1.0 + DIFFERENCE)
            slope = (self.uses(slower, split)[moving] - use) / DIFFERENCE
            here, double = float(logs[0]), float(np.log(2.0))
            if here - first > np.log(DURATION_SEARCH.longest):
                return replace(split, violation=float(use.max()) - 1.0)
            too_short, enough = (here, enough) if use.max() > 1.0 else (too_short, here)
            held = np.where(use > 1.0, double, -np.inf)  # slower is not less here
            falls = slope < 0.0
            wanted = np.where(falls, -use * np.log(use) / np.where(falls, slope, 1.0), held)
            change = float(np.clip(wanted.max(), -double, np.log(DURATION_SEARCH.longest)))
            if abs(change) <= self.tolerance or enough - too_short <= self.tolerance:
                return replace(split, log_duration=split.log_duration + change)
            if not too_short < here + change < enough:
                change = 0.5 * (too_short + enough) - here
            logs = logs + change

    def at(self, logs: FloatArray) -> _Split:
        """Look for the maxima at these durations."""
        self.tried += 1
        shape = self.make(np.exp(logs))
        count, points = len(shape.breaks) - 1, PEAK_SEARCH.points_per_piece + 1
        piece = np.repeat(np.arange(count), points)
        fraction = np.tile(np.linspace(0, 1, points), count)
        lasting, moving = self.uses_at(shape, piece, fraction)
        use = np.hstack([lasting, moving]).reshape(count, points, -1)
        beside = np.pad(use, ((0, 0), (1, 1), (0, 0)), constant_values=-np.inf)
        peaks = (use >= beside[:, :-2]) & (use > beside[:, 2:]) & (use > 0.0)
        row, channel = np.nonzero(peaks.reshape(count * points, -1))
        sample, at = np.unique(row, return_inverse=True)
        violation = float(lasting.max(initial=0.0)) - 1.0
        return _Split(
            logs=logs,
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

    def uses(self, shape: PiecewisePolynomial, split: _Split) -> FloatArray:
        """Use [R] of another shape at the places of the maxima."""
        uses = np.hstack(self.uses_at(shape, split.piece, split.fraction))
        return uses[split.at, split.channel]

    def uses_at(
        self, shape: PiecewisePolynomial, piece: np.ndarray, fraction: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Use [S, ...] of the limits at any duration, and of those of the motion."""
        samples = samples_of(orders_of(shape), piece, np.diff(shape.breaks)[piece] * fraction)
        rest, limited = MotionSamples.at_rest(samples.q), self.family.of_order(1, 2, 3)
        held = [key for key in limited if key not in ("qd", "qdd", "qddd", "taud")]
        lasting = self.family.use(samples, self.family.of_order(0)) | self.family.use(rest, held)
        empty = np.empty((len(piece), 0))
        moving = self.family.use(samples, limited)
        return np.hstack([empty, *lasting.values()]), np.hstack([empty, *moving.values()])

    def slopes(self, split: _Split) -> FloatArray:
        """Return slopes [R,k] of the maxima in the logarithms of the durations."""
        changed = np.exp(split.logs + DIFFERENCE * np.eye(split.logs.size))
        uses = [self.uses(self.make(durations), split) for durations in changed]
        return (np.stack(uses, axis=1) - split.use[:, None]) / DIFFERENCE

    def step(self, split: _Split, slopes: FloatArray, reach: float) -> tuple[FloatArray, float]:
        """Return the change of the logarithms, each by at most ``reach``, that promises most,
        and what.
        """
        weights = self.weights * np.exp(split.logs - split.log_duration)
        # Limits that last are aimed at from inside, so that a step along them does not leave them.
        inside = 1.0 - self.tolerance
        nearest = -0.5 * reach * np.abs(slopes).sum(axis=1)
        room = np.maximum(1.0 - split.use, 0.0)
        room = np.where(split.lasting, np.maximum(inside - split.use, nearest), room)
        cost, rows = weights, slopes
        # A part shorter than this share of the whole is not told from nothing.
        shortest = np.minimum(np.log(DIFFERENCE) + split.log_duration - split.logs, 0.0)
        least, farthest = np.maximum(shortest, -reach), np.full(weights.size, reach)
        if split.violation:  # the largest use that lasts is the last variable
            rows = np.column_stack([slopes, -np.ones(len(slopes))])[split.lasting]
            room, cost = -split.use[split.lasting], np.append(0.0 * weights, 1.0)
            least, farthest = np.append(least, inside), np.append(farthest, np.inf)
        i, j = np.nonzero(rows)
        matrix = ca.DM.triplet(i.tolist(), j.tolist(), rows[i, j], *rows.shape)
        solver = ca.conic(
            "split",
            "highs",
            {"h": ca.Sparsity(cost.size, cost.size), "a": matrix.sparsity()},
            {"error_on_fail": False, "highs": {"output_flag": False}},
        )
        answer = solver(g=cost, a=matrix, uba=room, lbx=least, ubx=farthest)
        change = np.array(answer["x"]).ravel()
        if not solver.stats()["success"]:
            return 0.0 * weights, 0.0
        promise = 1.0 + split.violation - change[-1] if split.violation else -weights @ change
        return change[: weights.size], float(promise)
