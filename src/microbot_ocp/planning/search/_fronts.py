"""Fronts of motions: time against effort, and time against peak torque.

Each motion of a front starts from the one before it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import InputError
from microbot_ocp.limits import JointLimits, Limits
from microbot_ocp.ocp.solution import StepProgress
from microbot_ocp.planning.search._among_obstacles import motions_among
from microbot_ocp.planning.search._refinement import search_of
from microbot_ocp.planning.search._result import (
    Fastest,
    effort_of,
    fastest,
    least_effort,
    motion_of_answer,
)
from microbot_ocp.planning.search._search import MotionSearch, SearchState, keeps_limits
from microbot_ocp.planning.search._settings import NEAR_WAY_BARRIER, TimeOptimalSettings
from microbot_ocp.planning.search._through_stops import Front, SolveRequest, problem_of
from microbot_ocp.planning.task import CELL_TIME_LIMIT, Segment, with_torques
from microbot_ocp.robot import Robot
from microbot_ocp.scene import Scene


def motions_of_front(
    robot: Robot,
    limits: Limits | JointLimits | None,
    stops: Sequence[Any],
    segments: Sequence[Segment] | None,
    cycle: bool,
    scene: Scene | None,
    settings: TimeOptimalSettings,
    progress: StepProgress,
    *,
    slacks: Sequence[float] = (),
    shares: Sequence[float] = (),
) -> Front:
    """Return the efforts and motions of a front, and the reason if it ends early.

    The first motion is the fastest. With ``slacks`` of the duration those of least effort follow,
    with ``shares`` of the torque limits the fastest under them.
    """
    front_of = (
        partial(effort_front, slacks=slacks) if slacks else partial(torque_front, shares=shares)
    )
    request = SolveRequest(
        robot, limits, list(stops), segments, cycle, settings, progress, scene=scene
    )
    with settings.within(CELL_TIME_LIMIT):
        if scene is None:
            return front_of(search_of(problem_of(request.task(), settings), progress), None)
        return motions_among(request, front_of)


def effort_front(search: MotionSearch, state: SearchState | None, slacks: Sequence[float]) -> Front:
    """Return effort and motion of the fastest, and of least effort for each slack.

    Each motion starts from the one before it.
    """
    best = fastest(search, state, slack=0.0)
    first = best.answer.solution.duration
    points = [(effort_of(search, best.answer.solution), motion_of_answer(best))]
    for slack in sorted(slacks) if best.answer.solved else ():
        if deadline.over():
            return points, deadline.status().sentence
        # Slacks refer to the fastest motion, and each search starts from the one before it.
        share = (1.0 + slack) * first / best.answer.solution.duration - 1.0
        calmer = least_effort(search, best.answer, share)
        best = replace(best, answer=calmer.answer, calmer=calmer)
        points.append((effort_of(search, calmer.answer.solution), motion_of_answer(best)))
    return points, ""


def torque_front(search: MotionSearch, state: SearchState | None, shares: Sequence[float]) -> Front:
    """Return effort and motion of the fastest, and of the fastest with shares of the torque limits.

    Each motion starts from the one before it. The text is the reason why the last shares failed.
    """
    problem, best = search.problem, fastest(search, state, slack=0.0)
    points, before = [(effort_of(search, best.answer.solution), motion_of_answer(best))], 1.0
    for share in sorted(shares, reverse=True) if best.answer.solved else ():
        if deadline.over():
            return points, deadline.status().sentence
        try:
            weaker = with_torques(problem.task, share)
        except InputError as refused:
            return points, f"With {100 * share:.3g} % of the torques {refused}."
        again = problem_of(weaker, problem.settings, None, problem.ways, problem.timed_path)
        search = search_of(again, search.progress)
        # Inertial torques scale with 1 / T^2 (Hollerbach's time scaling), so the duration grows
        # like the root of the torque ratio.
        best = _slower(search, best, float(np.sqrt(before / share)))
        before, motion = share, motion_of_answer(best)
        if not motion.solved:
            why = motion.advice or motion.status.sentence
            return points, f"With {100 * share:.3g} % of the torques: {why}"
        points.append((effort_of(search, best.answer.solution), motion))
    return points, ""


def _slower(search: MotionSearch, before: Fastest, factor: float) -> Fastest:
    """Return the fastest motion, from another one slowed down, or by a new search if that fails."""
    solution = before.answer.solution
    refiner = replace(search.refiner, history=[])
    meshes = [phase.mesh for phase in solution.phases]
    guesses = search.problem.guesses(solution, factor)
    slower = refiner.solve(meshes, guesses, barrier=NEAR_WAY_BARRIER)
    slower = refiner.refine(slower)
    slower = slower if refiner.is_finished(slower) else refiner.polished(slower)
    search.progress(f"slowed down: {slower.duration:.6f} s, {slower.status}")
    if keeps_limits(search, slower):
        answer = replace(
            before.answer, solution=slower, refiner=refiner, solves=tuple(refiner.history)
        )
        return replace(before, search=search, answer=answer, calmer=None)
    return fastest(search, slack=0.0)
