"""The best timing of a path in milliseconds, by reachability alone, without a solver."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.checks import ROUNDING, FloatArray
from microbot_ocp._base.codegen import compiles
from microbot_ocp._base.status import Status
from microbot_ocp.limits import JointLimits, LimitFamily, Limits
from microbot_ocp.motion import JUMP_GAP, SAMPLE_STEP, Motion, PiecewisePolynomial, State, numbered
from microbot_ocp.planning.path._curve import PathCurve, check_path, samples_along, segments
from microbot_ocp.planning.path._limits import LATER, limits_kept_by
from microbot_ocp.planning.path._reachability import CurveLimits, Reached, reach
from microbot_ocp.planning.task import check_limits, with_locked_joints_held
from microbot_ocp.robot import Robot


@dataclass(frozen=True, eq=False)
class PathTiming:
    """Timing of a path on a grid.

    Attributes
    ----------
    status : Status
        Solved, infeasible (the end cannot be reached within the limits), or "time limit".
    s : array [N+1]
        Path parameter of the grid points; an inner stop has two points. At the time limit the
        arrays cover the finished segments.
    speed : array [N+1]
        ds/dt; NaN on an infeasible path.
    t : array [N+1], s
        Times of the grid points.
    blocked_at : float
        Path parameter from which the end cannot be reached; NaN on a feasible path.
    limits_kept_by : dict
        Names of the limits kept as half planes ("reachability"), as bounds of ds/dt ("speed
        bound"), and **not** kept ("program on places").
    parts : tuple of (CurveLimits, Reached)
        Limits and timing of each segment between two stops.
    """

    robot: Robot
    status: Status
    s: FloatArray
    speed: FloatArray
    t: FloatArray
    blocked_at: float
    limits_kept_by: dict[str, list[str]]
    parts: tuple[tuple[CurveLimits, Reached], ...]

    @property
    def solved(self) -> bool:
        """True if the path is feasible within the limits."""
        return self.status.solved

    @property
    def duration(self) -> float:
        """Duration, s; NaN if the path is infeasible or time was over."""
        return float(self.t[-1]) if self.solved else float("nan")

    def motion(self, label: str = "path, reachability") -> Motion:
        """Return the timing as a motion; d2s/dt2 is linear in s between grid points.

        Raises
        ------
        InputError
            The path is infeasible, or the time limit was reached.
        """
        if self.status not in (Status.SOLVED, Status.INFEASIBLE):
            raise checks.InputError(f"the time was over at s = {self.s[-1]:g} of the path")
        if not self.solved:
            raise checks.InputError(
                f"the path cannot be travelled within the limits beyond s = {self.blocked_at:g}"
            )
        t, state, breaks = sampled([(along.curve, reached) for along, reached in self.parts])
        unkept = ", ".join(self.limits_kept_by[LATER])
        return Motion.from_state(
            self.robot,
            t,
            state,
            label=label,
            breaks=breaks,
            provenance={
                "method": "timing of a path by reachability on a grid",
                "limits_kept_by": self.limits_kept_by,
            },
            remark=f"not kept: {unkept}" if unkept else "",
        )


def time_path(
    robot: Robot,
    path: PiecewisePolynomial,
    limits: Limits | JointLimits | None = None,
    *,
    grid: int = 1000,
    start_free: bool | None = None,
    end_free: bool | None = None,
    compiled: bool = True,
    time_limit: float = np.inf,
) -> PathTiming:
    """Find the best timing of a path on a grid, from rest to rest, by two passes.

    The function takes milliseconds and starts no solver. Limits hold at both ends of every grid
    interval, with d2s/dt2 linear between them, and may be exceeded slightly inside.
    :func:`time_optimal_path` refines the grid until they are not, and keeps limits of any other
    form, too.

    Parameters
    ----------
    robot : Robot
        Robot; with masses if torques are limited.
    path : PiecewisePolynomial
        Joint positions over any path parameter; the arm stops at its corners.
    limits : Limits, optional
        Default: the robot's own.
    grid : int
        Intervals of each segment between two stops; every break of the path is a grid point.
    start_free, end_free : bool, optional
        Leave ds/dt free at an end of the path. Default: True for a vanishing tangent, because the
        arm rests there at any ds/dt.
    compiled : bool
        Use compiled functions if they exist already or compilation pays.
    time_limit : float
        Wall time, s, after which no further segment is started.

    Returns
    -------
    PathTiming
        Speed and time at every grid point, with a status.

    Raises
    ------
    InputError
        A path outside the position limits, an end or corner that cannot be held at rest, or limits
        that leave the duration unbounded from below.

    Notes
    -----
    Pham and Pham, "A new approach to time-optimal path parameterization based on reachability
    analysis", IEEE T-RO 34(3), 2018.

    Examples
    --------
    >>> import numpy as np
    >>> import microbot_ocp as mo
    >>> path = mo.straight_path(np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]]))
    >>> timing = mo.planning.time_path(mo.load_robot("microbot"), path)
    >>> timing.solved, round(timing.duration, 3), timing.limits_kept_by["speed bound"]
    (True, 2.575, ['velocity'])
    """
    checks.whole("grid", grid, "points", at_least=10)
    family = check_limits(robot, limits)
    curves = segments(path, check_path(family, path))
    moving = with_locked_joints_held(family, None)
    free, fast = (start_free, end_free), compiles(compiled)
    return replace(timed(moving, path, curves, grid, time_limit, fast, free), robot=family.robot)


def timed(
    family: LimitFamily,
    path: PiecewisePolynomial,
    curves: Sequence[PathCurve],
    grid: int,
    time_limit: float,
    fast: bool,
    free: tuple[bool | None, bool | None] = (None, None),
) -> PathTiming:
    """Return the timing of a path by the curves between its stops, as :func:`time_path`."""
    parts, s, speed, t, blocked, kept_by = [], [], [], [], [], {}
    begin, start = float(path.breaks[0]), 0.0
    with deadline.within(time_limit):
        for index, curve in enumerate(curves):
            if index and deadline.over():
                break
            along = CurveLimits.of(family, curve, grid, fast)
            reached = reach(
                along,
                start_free=free[0] if index == 0 else None,
                end_free=free[1] if index == len(curves) - 1 else None,
            )
            kept_by = kept_by or limits_kept_by(along.limits)
            parts.append((along, reached))
            place, slope = curve.parameter(reached.s)
            s.append(begin + place)
            factor = 1.0 if reached.feasible else np.nan
            speed.append(factor * np.sqrt(reached.speed_squared) * slope)
            t.append(start + factor * reached.t)
            if not reached.feasible:
                blocked.append(float(np.interp(reached.blocked_at, reached.s, s[-1])))
            begin, start = float(s[-1][-1]), float(t[-1][-1])
    status = Status.SOLVED if len(parts) == len(curves) else deadline.status()
    status = Status.INFEASIBLE if blocked else status
    return PathTiming(
        robot=family.robot,
        status=status,
        s=np.concatenate(s),
        speed=np.concatenate(speed),
        t=np.concatenate(t),
        blocked_at=blocked[0] if blocked else float("nan"),
        limits_kept_by=kept_by,
        parts=tuple(parts),
    )


CUBIC_STEPS = 3  # smallest number of steps in an interval with a cubic acceleration
BENT_STEPS = 12  # smallest number of steps in other intervals, and next to stops


def sampled(
    parts: Sequence[tuple[PathCurve, Reached]], finer: int = 1
) -> tuple[FloatArray, State, FloatArray]:
    """Return times, states and breaks of a motion, with s'' from both sides at every grid point.

    ``finer`` multiplies the number of samples.
    """
    times, states, breaks, begin = [], [], [np.zeros(1)], 0.0
    lasts = sum(reached.duration for _, reached in parts)
    # A long motion has longer steps, so that the number of samples stays bounded.
    step = max(SAMPLE_STEP, checks.longest_step(lasts, checks.MOST_SAMPLES))
    for curve, reached in parts:
        lengths = np.diff(reached.t)
        bent = _bent(curve, reached, lengths)
        # At an end with a vanishing tangent the state is a fractional power of the parameter.
        bent[[0, -1]] = True
        least = np.where(bent, BENT_STEPS, CUBIC_STEPS)
        count = finer * np.maximum(least, np.ceil(lengths / step - ROUNDING)).astype(int)
        i, k = numbered(count + 1)
        # The last sample of an interval lies just before its end, because s'' may jump there.
        early = np.minimum(JUMP_GAP, 0.01 * lengths / count)[i]
        local = k / count[i] * lengths[i] - np.where(k == count[i], early, 0.0)
        # Only at the end of the motion no acceleration follows that could jump.
        if len(times) == len(parts) - 1:
            local[-1] = lengths[-1]
        times.append(begin + reached.t[i] + local)
        states.append(_state(curve, reached, i, local))
        breaks.append(begin + reached.t[1:])
        begin += reached.duration
    t = np.concatenate(times)
    keep = np.append(True, np.diff(t) > 0.0)
    keep[-1] = True
    joined = (np.concatenate(parts)[keep] for parts in zip(*states, strict=True))
    return t[keep], State(*joined), np.concatenate(breaks)


def _state(curve: PathCurve, reached: Reached, i: np.ndarray, local: FloatArray) -> State:
    """Return the state [K,n] at times after the start of intervals i."""
    r, v, u = reached.after(i, local)
    return State(*samples_along(curve.inside(r, i, reached.s), (v, u))[:3])


CUBIC_ROUNDING = 1e-5  # fourth difference that counts as zero, per largest acceleration


def _bent(curve: PathCurve, reached: Reached, lengths: FloatArray) -> NDArray[np.bool_]:
    """Return a mask [N] of intervals in which the acceleration differs from a cubic in time."""
    i = np.repeat(np.arange(lengths.size), 5)
    local = np.linspace(0.0, 1.0, 5) * lengths[:, None]
    qdd = _state(curve, reached, i, local.ravel()).qdd.reshape(lengths.size, 5, -1)
    largest = np.abs(qdd).max(axis=(0, 1))
    # The fourth difference of five samples vanishes for a cubic.
    return (np.abs(np.diff(qdd, 4, axis=1)[:, 0]) > CUBIC_ROUNDING * largest).any(axis=1)
