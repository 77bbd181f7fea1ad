"""The fastest motion of a task, or the one of least effort in a given time.

Via points are stops that are passed at any velocity.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.checks import InputError
from microbot_ocp._base.outcome import Outcome, remark
from microbot_ocp._base.status import Status
from microbot_ocp.limits import JointLimits, Limits
from microbot_ocp.motion import Motion
from microbot_ocp.ocp.solution import StepProgress
from microbot_ocp.planning.free import InitialGuess, Slowed
from microbot_ocp.planning.search._branches import (
    Way,
    few_poses,
    least_duration,
    straight_way,
    ways_through,
)
from microbot_ocp.planning.search._problem import MotionProblem
from microbot_ocp.planning.search._refinement import search_of
from microbot_ocp.planning.search._result import (
    fastest,
    motion_from,
    returned,
)
from microbot_ocp.planning.search._settings import TimeOptimalSettings, reserving
from microbot_ocp.planning.task import (
    CELL_TIME_LIMIT,
    Segment,
    Stop,
    Task,
    task_of,
    too_near,
    with_drives_noted,
)
from microbot_ocp.robot import Robot, jacobian
from microbot_ocp.scene import Scene

Front = tuple[list[tuple[float, Motion]], str]  # effort and motion each; reason of an early end
LEAST_WAY = 1e-6  # rad (m) between via points: shorter steps are near the solvers' tolerance


@dataclass(frozen=True, eq=False)
class SolveRequest:
    """A request for a motion through stops: the arguments of :func:`microbot_ocp.time_optimal`."""

    robot: Robot
    limits: Limits | JointLimits | None
    stops: Sequence[Any]
    segments: Sequence[Segment] | None
    cycle: bool
    settings: TimeOptimalSettings
    progress: StepProgress
    order: str = "given"
    duration: float | None = None
    scene: Scene | None = None

    def task(self, places: Sequence[int] | None = None) -> Task:
        """Return the task, with the stops in another order if ``places`` are given.

        Raises
        ------
        InputError
            As :func:`task_of`.
        """
        stops, segments = self.stops, self.segments
        if places is not None:
            named = [stop if isinstance(stop, Stop) else Stop(q=stop) for stop in stops]
            stops = [named[k].named(f"stop {k + 1}") for k in places]
            segments = in_order(segments, places)
        return task_of(self.robot, stops, self.limits, segments=segments, cycle=self.cycle)


def in_order(
    segments: Sequence[Segment] | None, order: Sequence[int]
) -> tuple[Segment, ...] | None:
    """Return the segments for another order of the stops: each stays with its first stop."""
    if segments is None:
        return None
    return tuple(segments[k] if k < len(segments) else None for k in order)[: len(segments)]


def fastest_through(
    task: Task,
    settings: TimeOptimalSettings,
    progress: StepProgress,
    duration: float | None = None,
    usual: float = CELL_TIME_LIMIT,
) -> Motion:
    """Return the fastest motion of a task, or the one of least effort in ``duration``, s.

    ``usual`` is the default time limit, s.

    Raises
    ------
    InputError
        Via points too close for a solver, switching times of stops, and as :func:`problem_of`.
    """
    if settings.switching_times and not task.is_plain:
        raise InputError("switching_times are found for joint poses alone, not for stops")
    if duration is not None:
        checks.number("duration", duration, "s", above=0.0)
        if settings.slack:
            raise InputError("give a duration or a slack for less effort, not both")
    begin = time.perf_counter()
    problem = problem_of(task, settings, duration)
    given = min(usual if settings.time_limit is None else settings.time_limit, deadline.left())

    with settings.within(usual) as limit:
        # Under a short limit the known motion comes first, so that there is something to return.
        if given < usual and duration is None:
            problem = replace(problem, way=problem.fallback)
        try:
            with reserving(), deadline.given_up(problem.way is not None):
                search = search_of(problem, progress)
        except deadline.Over:
            assert problem.way is not None
            motion = _without_search(problem.way, time.perf_counter() - begin)
        else:
            motion = with_drives_noted(task.robot, motion_from(fastest(search, duration=duration)))
        return with_load_noted(motion, limit)


def with_load_noted(motion: Motion, limit: deadline.Begin) -> Motion:
    """Return a motion with a remark if its time limit ended because the machine was busy."""
    if motion.status is not Status.TIME_LIMIT or not limit.busy:
        return motion
    return replace(motion, outcome=motion.outcome.and_(remark(limit.busy)))


def problem_of(
    task: Task,
    settings: TimeOptimalSettings,
    duration: float | None = None,
    ways: Sequence[Way] = (),
    timed_path: InitialGuess | None = None,
    finer: int = 1,
) -> MotionProblem:
    """Return the problem of a task, with all its ways by default, or with a timed path.

    Raises
    ------
    InputError
        A velocity that no branch allows, or a duration below the bound of the velocity limits.
    """
    _check_velocities(task)
    if duration is not None and (least := least_duration(task)) > duration:
        raise InputError(
            f"duration must be at least the {least:.4g} s that the velocity limits ask for, "
            f"not {duration:g} s"
        )
    if task.is_plain and timed_path is None:
        via = np.array([stop.q for stop in task.stops])
        steps = np.abs(np.diff(via, axis=0)).max(axis=1)
        if steps.min() < LEAST_WAY:
            near, why = int(np.argmin(steps)), f"free motions are looked for from {LEAST_WAY:g} on"
            raise too_near(near + 1, steps[near], why)
        ways = [straight_way(via)]
    chosen = tuple(ways or ways_through(task))
    return MotionProblem(task, chosen, settings, timed_path=timed_path, finer=finer)


def _without_search(way: Slowed, wall: float) -> Motion:
    """Return a known motion if there was no time to prepare a search."""
    provenance = {
        "method": "free motion without a search",
        "made_from": way.made_from,
        "wall_time": wall,
    }
    outcome = Outcome.of(deadline.status()).and_(returned(way.made_from))
    return replace(way.motion, provenance=provenance).ended(outcome)


def _check_velocities(task: Task) -> None:
    """Raise InputError if no branch at a stop allows the tool's required velocity.

    The velocity of the tool along a unit vector e is at most ``sum_i |(J^T e)_i| qd_max_i``.
    """
    robot = task.robot
    fastest = np.maximum(-robot.limits.qd_min, robot.limits.qd_max)
    for stop in task.stops:
        if stop.q is not None or stop.velocity is None or isinstance(stop.velocity, str):
            continue
        wanted = float(np.linalg.norm(stop.velocity))
        poses = few_poses(robot, stop)
        if poses is None or not wanted:
            continue
        # Row e^T J of the Jacobian along the wanted direction, per m/s.
        slopes = [np.array(jacobian(robot)(q))[:3].T @ stop.velocity / wanted for q in poses]
        shares = np.abs(slopes)
        reached = np.multiply(shares, fastest, out=np.zeros_like(shares), where=shares > 0.0)
        most = float(reached.sum(axis=1).max())
        if wanted > most:
            raise InputError(
                f"stop {stop.name!r}: the velocity limits of the joints allow the tool at most "
                f"{most:.3g} m/s in that direction, not {wanted:.3g} m/s"
            )
