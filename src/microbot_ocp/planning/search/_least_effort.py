"""The motion of least effort in a time that is allowed, from the fastest one slowed down."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.ocp import Solution
from microbot_ocp.ocp.transcription import Guess
from microbot_ocp.planning.free import BUDGET, effort_scale, via_times
from microbot_ocp.planning.search._search import MotionAnswer, MotionSearch, rank
from microbot_ocp.planning.search._settings import SEARCH


@dataclass(frozen=True, eq=False)
class LeastEffort:
    """What less effort than that of the fastest motion came to.

    Attributes
    ----------
    answer : the motion of least effort; the fastest where none was solved
    slack : share of the duration that was allowed
    fastest : duration of the fastest, s
    effort, effort_of_the_fastest : time integral of the squared relative torques, s
    status : of the solve
    """

    answer: MotionAnswer
    slack: float
    fastest: float
    effort: float
    effort_of_the_fastest: float
    status: str

    def as_dict(self) -> dict[str, Any]:
        """Plain values for the provenance."""
        return {key: value for key, value in vars(self).items() if key != "answer"}

    @property
    def remark(self) -> str:
        """What it saves, for a remark."""
        duration = self.answer.solution.duration
        if duration == self.fastest:
            return f"; no motion of less effort was found ({self.status})"
        saved = 1.0 - self.effort / self.effort_of_the_fastest
        slower = duration / self.fastest - 1.0
        return f"; {100 * slower:.3g} % slower than the fastest for {100 * saved:.3g} % less effort"


def least_effort(search: MotionSearch, fastest: MotionAnswer, slack: float) -> LeastEffort:
    """Give the motion of least effort that takes at most the slack longer; the fastest if none."""
    problem, solution, slower = search.problem, fastest.solution, 1.0 + slack
    kernels = problem.kernels(budgeted=True)
    allowed = {problem.names[-1]: {BUDGET: slower * solution.duration}}
    refiner = replace(
        fastest.refiner,
        transcription=kernels.with_parameters(allowed),
        guess_from=partial(_with_clock, search),
        rough=None,
        history=[],
    )
    # what is smooth needs no mesh that was made for jumps
    meshes: list[Any] = [min(SEARCH.calmer_mesh, phase.mesh.size - 1) for phase in solution.phases]
    guesses = _with_clock(search, solution, slower)
    calmer = refiner.refine(refiner.solve(meshes, guesses, barrier=SEARCH.calmer_barrier))
    search.progress(f"least effort: {calmer.duration:.6f} s, {calmer.status}")
    solved = rank(search, calmer)[0] is False
    answer = replace(
        fastest,
        strategy="least effort",
        solution=calmer if solved else solution,
        refiner=refiner if solved else fastest.refiner,
        smoothing=fastest.smoothing,
        before=fastest,
        solves=tuple(refiner.history),
    )
    effort = effort_of(search, answer.solution)
    before = effort_of(search, solution)
    return LeastEffort(answer, slack, solution.duration, effort, before, str(calmer.status))


def effort_of(search: MotionSearch, solution: Solution) -> float:
    """Return the time integral of the squared torques (accelerations without masses), each
    relative, s.
    """
    problem = search.problem
    motion = problem.motion(solution, {})
    moved = motion.tau if problem.family.robot.has_dynamics else motion.qdd
    scaled = moved / effort_scale(problem.family, problem.scale.acceleration)
    return float(np.trapezoid((scaled**2).sum(axis=1), motion.t))


def _with_clock(search: MotionSearch, solution: Solution, slower: float = 1.0) -> dict[str, Guess]:
    """Return guesses from a solution, with the time that has passed, slowed down evenly."""
    problem, edges = search.problem, slower * via_times(solution)
    guesses = problem.guesses(solution)
    with_clock = {}
    for name, start, end in zip(problem.names, edges[:-1], edges[1:], strict=True):
        rates = {
            key: partial(_slowed, guesses[name].values[key], slower**power)
            for power, key in enumerate(("q", "qd", "qdd"))
        }
        values = {**guesses[name].values, **rates, "clock": partial(_clock, start, end)}
        with_clock[name] = Guess(float(end - start), values)
    return with_clock


def _slowed(curve: Any, by: float, s: FloatArray) -> FloatArray:
    return curve(s) / by


def _clock(start: float, end: float, s: FloatArray) -> FloatArray:
    return start + (end - start) * s[:, None]
