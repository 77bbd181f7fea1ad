"""The fastest motion of a task, or the one of least effort in a given time.

Via points are stops that are passed at any velocity. Orders of stops and fronts of motions ask a
search step by step.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.checks import InputError
from microbot_ocp._base.outcome import Outcome
from microbot_ocp._base.status import Status
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
from microbot_ocp.planning.search._result import fastest, motion_from, returned
from microbot_ocp.planning.search._search import MotionSearch, SearchState
from microbot_ocp.planning.search._settings import TimeOptimalSettings, sparing
from microbot_ocp.planning.search._strategies import STRATEGIES, search_of
from microbot_ocp.planning.task import CELL_TIME_LIMIT, Task, too_near, with_drives_noted
from microbot_ocp.robot import jacobian

LEAST_WAY = 1e-6  # rad (m) between via points: shorter ones are near the tolerance of the solvers


def fastest_through(
    task: Task,
    settings: TimeOptimalSettings,
    progress: StepProgress,
    duration: float | None = None,
    usual: float = CELL_TIME_LIMIT,
) -> Motion:
    """Return the fastest motion of a task, or the one of least effort in ``duration`` s.

    Its time limit is the ``usual`` one, s, where the settings have none.

    Raises
    ------
    InputError
        Ways too short for a solver, switching times of stops, and as of :func:`problem_of`.
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
    with settings.within(usual):
        if given < usual and duration is None:  # there may be no time for it later
            problem = replace(problem, way=problem.fallback)
        try:
            with sparing(), deadline.given_up(problem.way is not None):
                search = search_of(problem, settings, progress)
        except deadline.Over:
            assert problem.way is not None
            return _without_search(problem.way, time.perf_counter() - begin)
        motion = motion_from(fastest(search, duration=duration))
        return with_drives_noted(task.robot, motion)


def problem_of(
    task: Task,
    settings: TimeOptimalSettings,
    duration: float | None = None,
    ways: Sequence[Way] = (),
    timed_path: InitialGuess | None = None,
    finer: int = 1,
) -> MotionProblem:
    """Return the problem of a task, by default with all ways through it; among obstacles from a
    timed path.

    Raises
    ------
    InputError
        A velocity that no branch allows, a duration below what velocities ask for.
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
    """Return what needs no search, where there was no time to prepare one."""
    provenance = {
        "method": "free motion without a search",
        "made_from": way.made_from,
        "wall_time": wall,
    }
    outcome = Outcome.of(Status.TIME_LIMIT).and_(returned(way.made_from))
    return replace(way.motion, provenance=provenance).ended(outcome)


@dataclass(frozen=True, eq=False)
class StopSearch:
    """A search through stops, and what it has come to: orders of stops ask for more step by step.

    Attributes
    ----------
    search : MotionSearch
    duration : s, in which the motion of least effort is wanted
    state : SearchState
    """

    search: MotionSearch
    duration: float | None = None
    state: SearchState = field(default_factory=SearchState)

    @classmethod
    def of(
        cls,
        task: Task,
        settings: TimeOptimalSettings,
        progress: StepProgress,
        duration: float | None = None,
        ways: Sequence[Way] = (),
        timed_path: InitialGuess | None = None,
    ) -> StopSearch:
        """Return the search of a task, as :func:`problem_of`."""
        problem = problem_of(task, settings, duration, ways, timed_path)
        return cls(search_of(problem, settings, progress), duration)

    @property
    def problem(self) -> MotionProblem:
        """The task as the search sees it."""
        return self.search.problem

    def explored(self, beaten: float) -> StopSearch:
        """Return the same with coarse answers, of ways that may take less than ``beaten``, s,
        alone.
        """
        least = replace(self.problem, beaten=beaten - self.problem.rested, briefly=True)
        state = replace(self.search, problem=least).run(STRATEGIES[:1], self.state)
        return replace(self, state=state)

    @property
    def coarse_duration(self) -> float:
        """What the best coarse answer takes, s; infinite where there is none."""
        durations = [a.solution.duration for a in self.state.of("start") if a.solved]
        return min(durations, default=np.inf) + self.problem.rested

    def run(self) -> Motion:
        """Return the fastest motion, or the one of least effort in the duration that is given."""
        return motion_from(fastest(self.search, self.state, duration=self.duration))


def _check_velocities(task: Task) -> None:
    """Raise InputError where no branch at a stop gives the tool the velocity that is asked for."""
    robot = task.robot
    fastest = np.maximum(-robot.limits.qd_min, robot.limits.qd_max)
    for stop in task.stops:
        if stop.q is not None or stop.velocity is None or isinstance(stop.velocity, str):
            continue
        wanted = float(np.linalg.norm(stop.velocity))
        poses = few_poses(robot, stop)
        if poses is None or not wanted:
            continue
        slopes = [np.array(jacobian(robot)(q))[:3].T @ stop.velocity / wanted for q in poses]
        shares = np.abs(slopes)
        reached = np.multiply(shares, fastest, out=np.zeros_like(shares), where=shares > 0.0)
        most = float(reached.sum(axis=1).max())
        if wanted > most:
            raise InputError(
                f"stop {stop.name!r}: the velocity limits of the joints allow the tool at most "
                f"{most:.3g} m/s in that direction, not {wanted:.3g} m/s"
            )
