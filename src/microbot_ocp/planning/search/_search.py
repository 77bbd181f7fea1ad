"""The search for the fastest motion: a table of strategies, run by one loop.

A strategy is a row of the table: it selects an answer and improves it. The loop runs the first row
that finds an answer to improve, until none does. The answers form a :class:`SearchState`, and the
ledger has a row for every step. This module also ranks answers and decides that one is enough.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from typing import Any

from microbot_ocp._base import deadline
from microbot_ocp._base.child_process import Child, Died, OutOfTime, spare_processor
from microbot_ocp._base.outcome import Ledger, LedgerRow
from microbot_ocp._base.status import Status
from microbot_ocp.ocp import Explanation, Phase, Solution
from microbot_ocp.ocp.refinement import Refiner
from microbot_ocp.ocp.solution import StepProgress, quiet, unpack
from microbot_ocp.ocp.transcription import Transcription
from microbot_ocp.planning.search._branches import Way
from microbot_ocp.planning.search._problem import MotionProblem, TrialStart
from microbot_ocp.planning.search._settings import SEARCH, TimeOptimalSettings
from microbot_ocp.planning.task import largest


@dataclass(frozen=True, eq=False)
class MotionAnswer:
    """Result of a strategy, from an earlier answer or from an initial guess.

    Attributes
    ----------
    start : name of the initial guess
    solution : solution, solved or not
    refiner : refiner that continues it
    smoothing : weight of the squared jerk
    before : answer that the strategy improved
    solves : records of all its solves
    seconds : wall time, s
    way : way of the initial guess through the stops
    relaxed : least violation of the limits, if it was solved for
    strategy : name of the strategy, set by the loop
    """

    start: str
    solution: Solution
    refiner: Refiner
    smoothing: float
    before: MotionAnswer | None = None
    solves: tuple[dict[str, Any], ...] = ()
    seconds: float = 0.0
    way: Way | None = None
    relaxed: Explanation | None = None
    strategy: str = ""

    @property
    def solved(self) -> bool:
        """True if the solution converged on its mesh."""
        return self.solution.status.solved

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
    """Answers of a search in their order, solved or not."""

    answers: tuple[MotionAnswer, ...] = ()

    def of(self, *strategies: str) -> list[MotionAnswer]:
        """Return the answers of these strategies."""
        return [answer for answer in self.answers if answer.strategy in strategies]

    def made_of(self, subject: MotionAnswer | None, strategy: str) -> MotionAnswer | None:
        """Return the result of a strategy on an answer; None if it was not run on it."""
        rows = (a for a in self.answers if a.before is subject and a.strategy == strategy)
        return next(rows, None)

    def and_(self, answer: MotionAnswer) -> SearchState:
        """Return the state with one more answer."""
        return SearchState((*self.answers, answer))

    @property
    def interrupted(self) -> bool:
        """True if the user interrupted the last solve."""
        return bool(self.answers) and self.answers[-1].solution.status is Status.INTERRUPTED


Choose = Callable[["MotionSearch", SearchState], "NextStep | None"]
Run = Callable[["MotionSearch", "NextStep"], MotionAnswer]


@dataclass(frozen=True, eq=False)
class NextStep:
    """Next input of a strategy.

    Attributes
    ----------
    subject : answer to improve; None for a first answer
    start : initial guess
    intervals : intervals per phase
    """

    subject: MotionAnswer | None = None
    start: TrialStart | None = None
    intervals: int = 0

    @property
    def answer(self) -> MotionAnswer:
        """Answer to improve, for strategies that always have one."""
        assert self.subject is not None
        return self.subject


@dataclass(frozen=True)
class MotionStrategy:
    """A row of the table of strategies.

    Attributes
    ----------
    name : name in the ledger
    next_step : function that selects the next input, or None
    run : function that makes an answer of it
    why : kind of problem that needs the strategy
    share : share of the time limit after which the strategy is skipped
    """

    name: str
    next_step: Choose
    run: Run
    why: str
    share: float = 1.0


@dataclass(frozen=True, eq=False)
class MotionSearch:
    """Constants of a search, shared by all strategies.

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
    memory : dict
        Results of steps that were run early, by strategy and subject.
    """

    problem: MotionProblem
    refiner: Refiner
    progress: StepProgress
    kernel_time: float = 0.0
    begin: float = field(default_factory=time.perf_counter)
    memory: dict[Any, MotionAnswer] = field(default_factory=dict)

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
        passed = time.perf_counter() - self.begin
        return passed / (passed + max(deadline.left(), 0.0))

    def worst(self, solution: Solution) -> float:
        """Return the largest relative excess of a limit between mesh points."""
        return largest(self.problem.excess(solution))

    def run(
        self, strategies: Sequence[MotionStrategy], state: SearchState | None = None
    ) -> SearchState:
        """Run strategies from a state until none finds an answer to improve, or time is over."""
        state = state or SearchState()
        while not state.interrupted:
            pair = _first(self, strategies, state)
            if pair is None or (self.over and state.answers):
                break
            strategy, step = pair
            # The same step may have run early, while a child process tried further starts.
            key = None if step.subject is None else (strategy.name, id(step.subject))
            answer = None if key is None else self.memory.get(key)
            if answer is None:
                begin = time.perf_counter()
                proposed, spent = strategy.run(self, step), time.perf_counter() - begin
                fields = {"before": step.subject, "seconds": spent, "strategy": strategy.name}
                answer = replace(proposed, **fields)
            if key is not None:
                self.memory[key] = answer
            state = state.and_(answer)
            if self._may_fork(strategies, state):
                state = self._with_starts_beside(strategies, state)
        return state

    def _may_fork(self, strategies: Sequence[MotionStrategy], state: SearchState) -> bool:
        """Return True if further starts may run in another process from now on."""
        return (
            len(state.answers) == 1
            and state.answers[0].solved
            and self.settings.starts > 1
            and self.progress is quiet
            and self.problem.is_free
            and not self.problem.is_flat
            and strategies[0].next_step(self, state) is not None
            and not self.over
            and spare_processor()
            and self.problem.slowed(state.answers[0].solution) is not None
        )

    def _with_starts_beside(
        self, strategies: Sequence[MotionStrategy], state: SearchState
    ) -> SearchState:
        """Try further starts in a child process while the first answer is refined.

        The result does not depend on the child: a refinement made early counts only if the
        sequential order would have made it. The first answer must lead to a motion within the
        limits, because its refinement may take all the time.
        """
        starts, *others, _ = strategies
        with closing(Child(lambda _: self._plain(self.run([starts], state), state))) as child:
            self.run(others, state)
            try:
                return self._with_plain(state, child.answer(deadline.until()))
            # A failed child loses its starts alone: the answers of this process remain.
            except (OutOfTime, Died):
                return state

    def _plain(self, state: SearchState, before: SearchState) -> list[dict[str, Any]]:
        """Return the new answers of a state as plain data, without kernels."""
        rows = []
        for answer in state.answers[len(before.answers) :]:
            subject = None if answer.before is None else state.answers.index(answer.before)
            phases = [phase.layout.phase for phase in answer.solution.phases if phase.layout]
            solution = plain_of(answer.solution, phases)
            given = {"solution": solution, "refiner": None, "before": subject}
            rows.append(vars(answer) | given)
        return rows

    def _with_plain(self, state: SearchState, rows: Sequence[dict[str, Any]]) -> SearchState:
        """Return the state with the answers of another process added."""
        for row in rows:
            solution, _ = from_plain(self.refiner.transcription, row["solution"])
            before = None if row["before"] is None else state.answers[row["before"]]
            again = {"solution": solution, "refiner": self.refiner, "before": before}
            state = state.and_(MotionAnswer(**(row | again)))
        return state


def plain_of(solution: Solution, phases: Iterable[Phase]) -> tuple[Any, ...]:
    """Return a solution as plain data, without the kernels of the phases."""
    parameters = {phase.name: {p.name: p.value for p in phase.parameters} for phase in phases}
    meshes = [phase.mesh for phase in solution.phases]
    return replace(solution, phases=()), meshes, parameters


def from_plain(kernels: Transcription, plain: tuple[Any, ...]) -> tuple[Solution, Transcription]:
    """Return the solution of plain data, and the kernels with its parameter values."""
    solution, meshes, parameters = plain
    if any(parameters.values()):
        kernels = kernels.with_parameters(parameters)
    phases = unpack(kernels.layouts(meshes), solution.variables)
    return replace(solution, phases=phases), kernels


def _first(
    search: MotionSearch, strategies: Sequence[MotionStrategy], state: SearchState
) -> tuple[MotionStrategy, NextStep] | None:
    """Return the first strategy with an answer to improve, and its input."""
    for strategy in strategies:
        if state.answers and search.spent > strategy.share:
            continue
        step = strategy.next_step(search, state)
        if step is not None:
            return strategy, step
    return None


def ledger_of(state: SearchState, last: MotionAnswer) -> Ledger:
    """Return the ledger: one row per answer, with a mark on the lineage of the last one."""
    lineage = set(map(id, last.lineage))
    rows, best = [], None
    for answer in state.answers:
        cost = answer.solution.duration if answer.solved else best
        iterations = sum(a["iterations"] for solve in answer.solves for a in solve["attempts"])
        figures = id(answer) in lineage, best, cost, iterations, answer.seconds
        rows.append(LedgerRow(answer.strategy, 1, *figures))
        best = min((c for c in (best, cost) if c is not None), default=None)
    return Ledger.of(rows)


# ranking of answers -----------------------------------------------------------------------


def is_enough(problem: MotionProblem, solution: Solution) -> bool:
    """Return True if a motion on a large mesh is to be slowed down slightly, not refined."""
    size = sum(phase.mesh.size - 1 for phase in solution.phases) * problem.family.robot.joint_count
    if size < SEARCH.large_mesh or not solution.status.solved or problem.settings.slack:
        return False
    if largest(problem.excess(solution)) <= problem.settings.limit_tolerance:
        return False
    slower = problem.slowed(solution)
    return (
        slower is not None
        and slower.duration <= (1.0 + SEARCH.largest_slowdown) * solution.duration
    )


def rank(search: MotionSearch, solution: Solution) -> tuple[bool, float]:
    """Return a sort key: motions within the limits first, then the fastest."""
    valid = solution.status.solved and (
        search.worst(solution) <= search.settings.limit_tolerance
        or (search.problem.is_free and is_enough(search.problem, solution))
    )
    return not valid, solution.duration


def by_promise(answers: Sequence[MotionAnswer]) -> list[MotionAnswer]:
    """Return the distinct optima of coarse answers, the fastest first, each by its first answer."""
    different = list[MotionAnswer]()
    for coarse in answers:
        if coarse.solved and not any(
            abs(coarse.solution.duration - other.solution.duration)
            <= SEARCH.same_optimum * other.solution.duration
            for other in different
        ):
            different.append(coarse)
    return sorted(different, key=lambda coarse: coarse.solution.duration)


def settled(answers: Sequence[MotionAnswer], settings: TimeOptimalSettings) -> bool:
    """Return True if another start would more likely than not lead to a known optimum.

    After w different outcomes of N starts, the next start leads to a new one with probability
    w (w + 1) / (N (N - 1)) (Boender and Rinnooy Kan, Math. Programming 37, 1987, 59-80). An answer
    continued from a coarser mesh is an outcome but no start.
    """
    solved, count = sum(answer.solved for answer in answers), len(answers)
    if solved == 0 or settings.starts == 1:  # the estimate needs two starts
        return solved > 0
    different = len(by_promise(answers)) + (solved < count)
    count = sum(answer.before is None for answer in answers)
    return 2 * different * (different + 1) <= count * (count - 1)
