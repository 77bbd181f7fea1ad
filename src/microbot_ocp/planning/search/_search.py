"""The search for the fastest motion: its answers, and how they compare.

An answer is a candidate of the queue: an initial guess solved on a coarse mesh, then refined. All
answers of a search form a :class:`SearchState`, and the ledger has a row for each step.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.outcome import Ledger, LedgerRow
from microbot_ocp._base.status import Status
from microbot_ocp.ocp import Explanation, Solution
from microbot_ocp.ocp.refinement import Refiner
from microbot_ocp.ocp.solution import StepProgress
from microbot_ocp.planning.search._branches import Way
from microbot_ocp.planning.search._problem import MotionProblem
from microbot_ocp.planning.search._queue import Level
from microbot_ocp.planning.search._settings import (
    COARSE_TOLERANCE,
    LEAST_GAIN,
    SAME_OPTIMUM,
    TimeOptimalSettings,
)
from microbot_ocp.planning.task import largest

LARGE_MESH = 5000  # intervals times joints from which slowing down may replace refinement

START = "start"  # step of initial guesses that are compared


@dataclass(frozen=True, eq=False)
class MotionAnswer:
    """Result of one step of a search, from an initial guess or from an earlier answer.

    Attributes
    ----------
    start : name of the initial guess
    solution : solution, solved or not
    refiner : refiner that continues it
    smoothing : weight of the squared jerk
    before : answer that the step improved
    solves : records of all its solves
    way : way of the initial guess through the stops
    relaxed : least violation of the limits, if it was solved for
    step : name of the step in the ledger
    level : accuracy
    slowdown : relative slowdown with which a motion on a split mesh keeps its limits
    """

    start: str
    solution: Solution
    refiner: Refiner
    smoothing: float
    before: MotionAnswer | None = None
    solves: tuple[dict[str, Any], ...] = ()
    way: Way | None = None
    relaxed: Explanation | None = None
    step: str = ""
    level: Level = Level.COARSE
    slowdown: float = 0.0

    @property
    def keeps_limits(self) -> bool:
        """False if no slowdown keeps the limits."""
        return bool(np.isfinite(self.slowdown))

    @property
    def duration(self) -> float:
        """Duration without dwells, with the slowdown, s."""
        return self.solution.duration * (1.0 + self.slowdown if self.keeps_limits else 1.0)

    @property
    def solved(self) -> bool:
        """True if the solution converged on its mesh."""
        return self.solution.status.solved

    @property
    def interrupted(self) -> bool:
        """True if the user interrupted the solve."""
        return self.solution.status is Status.INTERRUPTED

    @property
    def iterations(self) -> int:
        """Number of iterations of all its solves."""
        return sum(a["iterations"] for solve in self.solves for a in solve["attempts"])

    @property
    def is_first(self) -> bool:
        """True for the answer of an initial guess or a timed path."""
        return self.before is None and self.way is not None

    @property
    def lineage(self) -> Iterator[MotionAnswer]:
        """Answers from this one back to the first."""
        answer: MotionAnswer | None = self
        while answer is not None:
            yield answer
            answer = answer.before

    @property
    def intervals(self) -> int:
        """Number of intervals of the first phase."""
        return self.solution.phases[0].mesh.size - 1 if self.solution.phases else 0


@dataclass(frozen=True, eq=False)
class SearchState:
    """Answers of a search in their order, solved or not, and the wall time of each, s."""

    answers: tuple[MotionAnswer, ...] = ()
    seconds: tuple[float, ...] = ()

    def at(self, level: Level) -> list[MotionAnswer]:
        """Return the answers of a level."""
        return [answer for answer in self.answers if answer.level is level]

    @property
    def starts(self) -> list[MotionAnswer]:
        """Coarse answers of initial guesses, those continued on a finer coarse mesh included."""
        return [answer for answer in self.answers if answer.step == START]

    def continued(self, subject: MotionAnswer) -> MotionAnswer | None:
        """Return the answer of a coarse one on a finer coarse mesh, if it was continued."""
        return next((answer for answer in self.starts if answer.before is subject), None)

    def and_(self, answer: MotionAnswer, begin: float) -> SearchState:
        """Return the state with an answer whose step began at ``time.perf_counter()``."""
        seconds = *self.seconds, time.perf_counter() - begin
        return SearchState((*self.answers, answer), seconds)

    @property
    def interrupted(self) -> bool:
        """True if the user interrupted the last solve."""
        return bool(self.answers) and self.answers[-1].interrupted


NOTHING = SearchState()


@dataclass(frozen=True, eq=False)
class MotionSearch:
    """Constants of a search, shared by all steps.

    Attributes
    ----------
    problem : MotionProblem
    refiner : Refiner
        Kernels and settings of every solve.
    progress : callable
    kernel_time : float
        Time to build the program, s.
    begin : float
        Start of the search, s, by ``time.perf_counter``.
    """

    problem: MotionProblem
    refiner: Refiner
    progress: StepProgress
    kernel_time: float = 0.0
    begin: float = field(default_factory=time.perf_counter)

    @property
    def settings(self) -> TimeOptimalSettings:
        """Settings of the search."""
        return self.problem.settings

    @property
    def over(self) -> bool:
        """True if the time limit is reached."""
        return deadline.over()

    @property
    def spent(self) -> float:
        """Used share of the time available to the search."""
        # The limit of the caller may be tighter than the settings', so the share refers to the time
        # that is left.
        passed = time.perf_counter() - self.begin
        return passed / (passed + max(deadline.left(), 0.0))

    def worst(self, solution: Solution) -> float:
        """Return the largest relative excess of a limit between mesh points."""
        return largest(self.problem.excess(solution))


def ledger_of(state: SearchState, last: MotionAnswer) -> Ledger:
    """Return the ledger: one row per answer, with a mark on the lineage of the last one."""
    lineage = set(map(id, last.lineage))
    rows, best = [], None
    for answer, seconds in zip(state.answers, state.seconds, strict=True):
        cost = answer.solution.duration if answer.solved else best
        figures = id(answer) in lineage, best, cost, answer.iterations, seconds
        rows.append(LedgerRow(answer.step, 1, *figures))
        # Each row shows the best duration before and after its step, whichever answer it belongs
        # to.
        best = min((c for c in (best, cost) if c is not None), default=None)
    return Ledger.of(rows)


# ranking of answers -----------------------------------------------------------------------


def slowdown(problem: MotionProblem, solution: Solution) -> float:
    """Return the relative slowdown with which a motion keeps its limits; infinite if none."""
    if not solution.status.solved:
        return np.inf
    if largest(problem.excess(solution)) <= problem.settings.limit_tolerance:
        return 0.0
    slower = None if problem.settings.slack else problem.slowed(solution)
    return np.inf if slower is None else slower.duration / solution.duration - 1.0


def is_enough(problem: MotionProblem, solution: Solution) -> bool:
    """Return True if a motion on a large mesh is to be slowed down slightly, not refined."""
    # Slowing down is accepted on large meshes only: there another mesh costs more than the
    # slowdown.
    size = sum(phase.mesh.size - 1 for phase in solution.phases) * problem.family.robot.joint_count
    return size >= LARGE_MESH and 0.0 < slowdown(problem, solution) <= LEAST_GAIN


def keeps_limits(search: MotionSearch, solution: Solution) -> bool:
    """Return True for a motion within its limits, if need be after a slight slowdown."""
    return slowdown(search.problem, solution) <= search.settings.limit_tolerance


def by_promise(answers: Sequence[MotionAnswer]) -> list[MotionAnswer]:
    """Return the distinct optima of coarse answers, the fastest first, each by its fastest."""
    different = list[MotionAnswer]()
    for answer in sorted((a for a in answers if a.solved), key=lambda a: a.duration):
        if not any(_is_same_optimum(answer, faster) for faster in different):
            different.append(answer)
    return different


def _is_same_optimum(answer: MotionAnswer, faster: MotionAnswer) -> bool:
    """Return True if an answer probably leads to the optimum of a faster one."""
    # Other branches of the arm are other motions, unless they mirror each other: then durations
    # agree to the tolerance of the solver.
    apart = SAME_OPTIMUM if answer.way is faster.way else COARSE_TOLERANCE
    return answer.duration <= (1.0 + apart) * faster.duration


def settled(answers: Sequence[MotionAnswer], settings: TimeOptimalSettings) -> bool:
    """Return True if another start would more likely than not lead to a known optimum.

    After w different outcomes of N starts, the next start leads to a new one with probability
    w (w + 1) / (N (N - 1)) (Boender and Rinnooy Kan, Math. Programming 37, 1987, 59-80). An answer
    continued from a coarser mesh is an outcome but no start.
    """
    # Starts that led nowhere count together as one outcome.
    solved, count = sum(answer.solved for answer in answers), len(answers)
    if solved == 0 or settings.starts == 1:  # the estimate needs two starts
        return solved > 0
    different = len(by_promise(answers)) + (solved < count)
    count = sum(answer.before is None for answer in answers)
    return 2 * different * (different + 1) <= count * (count - 1)
