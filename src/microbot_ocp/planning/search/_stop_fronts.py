"""Fronts of motions through stops: time against effort, and time against peak torque."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from microbot_ocp._base.checks import InputError
from microbot_ocp.motion import Motion
from microbot_ocp.planning.search._least_effort import effort_of, least_effort
from microbot_ocp.planning.search._ranking import rank
from microbot_ocp.planning.search._result import Fastest, fastest, motion_of_answer
from microbot_ocp.planning.search._settings import SEARCH
from microbot_ocp.planning.search._through_stops import StopSearch
from microbot_ocp.planning.task import with_torques

Front = tuple[list[tuple[float, Motion]], str]  # effort and motion of each, why there are no more


def effort_front(asked: StopSearch, slacks: Sequence[float]) -> Front:
    """Return the effort and motion of the fastest, and of those of least effort that are slower by
    shares.

    Each starts from the one before it.
    """
    best = fastest(asked.search, asked.state, slack=0.0)
    first = best.answer.solution.duration
    points = [(effort_of(asked.search, best.answer.solution), motion_of_answer(best))]
    for slack in sorted(slacks) if best.answer.solved else ():
        share = (1.0 + slack) * first / best.answer.solution.duration - 1.0
        calmer = least_effort(asked.search, best.answer, share)
        best = replace(best, answer=calmer.answer, calmer=calmer)
        points.append((effort_of(asked.search, calmer.answer.solution), motion_of_answer(best)))
    return points, ""


def torque_front(asked: StopSearch, shares: Sequence[float]) -> Front:
    """Return the effort and motion of the fastest, and of the fastest with shares of the torques.

    Each starts from the one before it. The text says why the last shares have no motion.
    """
    best = fastest(asked.search, asked.state, slack=0.0)
    points, before = [(effort_of(asked.search, best.answer.solution), motion_of_answer(best))], 1.0
    for share in sorted(shares, reverse=True) if best.answer.solved else ():
        try:
            weaker = with_torques(asked.problem.task, share)
        except InputError as problem:
            return points, f"With {100 * share:.3g} % of the torques {problem}."
        settings, problem = asked.search.settings, asked.problem
        given = settings, asked.search.progress, None, problem.ways, problem.timed_path
        search = StopSearch.of(weaker, *given)
        best = _slower(search, best, float(np.sqrt(before / share)))
        before, motion = share, motion_of_answer(best)
        if not motion.solved:
            why = motion.advice or motion.status.sentence
            return points, f"With {100 * share:.3g} % of the torques: {why}"
        points.append((effort_of(search.search, best.answer.solution), motion))
    return points, ""


def _slower(asked: StopSearch, before: Fastest, factor: float) -> Fastest:
    """Return the fastest motion, from another one slowed down; by a new search if that fails."""
    search, solution = asked.search, before.answer.solution
    refiner = replace(search.refiner, history=[])
    meshes = [phase.mesh for phase in solution.phases]
    guesses = asked.problem.guesses(solution, factor)
    slower = refiner.solve(meshes, guesses, barrier=SEARCH.calmer_barrier)
    slower = refiner.finished(refiner.refine(slower))
    search.progress(f"slowed down: {slower.duration:.6f} s, {slower.status}")
    if rank(search, slower)[0] is False:
        answer = replace(
            before.answer, solution=slower, refiner=refiner, solves=tuple(refiner.history)
        )
        return replace(before, search=search, answer=answer, calmer=None)
    return fastest(search, slack=0.0)
