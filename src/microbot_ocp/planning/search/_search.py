"""The search for the fastest motion: a table of strategies, run by one loop.

A strategy is a row: the answer that it works on next, and what it makes of it. The loop runs the
first row that has something to work on, until none has; what has come of it is a
:class:`SearchState`, and the ledger has a row for every strategy. Which answer is better, and which
is enough, is said here, too.
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
    """What a strategy made of another answer, or of nothing.

    Attributes
    ----------
    start : name of the initial guess that it goes back to
    solution : solved or not
    refiner : what refines it further
    smoothing : weight of the squared jerk
    before : the answer that it was made of
    solves : records of all solves that it took
    seconds : wall time that it took
    way : through the stops, that the initial guess goes along
    relaxed : what limits have to give, where that was asked
    strategy : name of the strategy, which the loop knows
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
        """Whether it was solved on its mesh."""
        return self.solution.status.solved

    @property
    def lineage(self) -> Iterator[MotionAnswer]:
        """This answer, the one that it was made of, and so on to the first."""
        answer: MotionAnswer | None = self
        while answer is not None:
            yield answer
            answer = answer.before

    @property
    def intervals(self) -> int:
        """Of the first phase."""
        return self.solution.phases[0].mesh.size - 1 if self.solution.phases else 0


@dataclass(frozen=True, eq=False)
class SearchState:
    """What a search has come to: its answers in their order, solved or not."""

    answers: tuple[MotionAnswer, ...] = ()

    def of(self, *strategies: str) -> list[MotionAnswer]:
        """Return the answers of these strategies."""
        return [answer for answer in self.answers if answer.strategy in strategies]

    def made_of(self, subject: MotionAnswer | None, strategy: str) -> MotionAnswer | None:
        """Return what a strategy made of an answer; None where it was not run on it."""
        rows = (a for a in self.answers if a.before is subject and a.strategy == strategy)
        return next(rows, None)

    def and_(self, answer: MotionAnswer) -> SearchState:
        """Return the same with one answer more."""
        return SearchState((*self.answers, answer))

    @property
    def interrupted(self) -> bool:
        """Whether the last solve was interrupted by the user."""
        return bool(self.answers) and self.answers[-1].solution.status is Status.INTERRUPTED


Choose = Callable[["MotionSearch", SearchState], "NextStep | None"]
Run = Callable[["MotionSearch", "NextStep"], MotionAnswer]


@dataclass(frozen=True, eq=False)
class NextStep:
    """What a strategy works on next.

    Attributes
    ----------
    subject : an answer; None where the strategy makes the first ones
    start : what is tried then
    intervals : a phase, on which it is tried
    """

    subject: MotionAnswer | None = None
    start: TrialStart | None = None
    intervals: int = 0

    @property
    def answer(self) -> MotionAnswer:
        """The answer that is worked on, by strategies that always have one."""
        assert self.subject is not None
        return self.subject


@dataclass(frozen=True)
class MotionStrategy:
    """A row of the table.

    Attributes
    ----------
    name : the word in the ledger
    next_step : what it works on next; None where it has nothing to do
    run : what it makes of that
    why : the kind of problem that needs it
    share : of the time after which it is not run again
    """

    name: str
    next_step: Choose
    run: Run
    why: str
    share: float = 1.0


@dataclass(frozen=True, eq=False)
class MotionSearch:
    """What strategies work with; none of it changes while the search goes on.

    Attributes
    ----------
    problem : MotionProblem
    refiner : Refiner
        With the kernels and settings of every solve.
    progress : callable
    kernel_time : s, that the program took to be made
    begin : when it began, s of ``time.perf_counter``
    """

    problem: MotionProblem
    refiner: Refiner
    progress: StepProgress
    kernel_time: float = 0.0
    begin: float = field(default_factory=time.perf_counter)
    memory: dict[Any, MotionAnswer] = field(default_factory=dict)  # of what was run early

    @property
    def settings(self) -> TimeOptimalSettings:
        """How hard to look."""
        return self.problem.settings

    @property
    def over(self) -> bool:
        """Whether the time is over."""
        return deadline.over()

    @property
    def spent(self) -> float:
        """Share of the time that was there for the search."""
        passed = time.perf_counter() - self.begin
        return passed / (passed + max(deadline.left(), 0.0))

    def worst(self, solution: Solution) -> float:
        """Return the largest relative excess of a limit between mesh points."""
        return largest(self.problem.excess(solution))

    def run(
        self, strategies: Sequence[MotionStrategy], state: SearchState | None = None
    ) -> SearchState:
        """Run strategies from a state on until none has anything to do, or the time is over."""
        state = state or SearchState()
        while not state.interrupted:
            pair = _first(self, strategies, state)
            if pair is None or (self.over and state.answers):
                break
            strategy, step = pair
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
        """Return whether further starts are tried in another process from here on."""
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
        """Try further starts in a process of their own while the first of them is refined.

        What is found does not depend on it: what is refined early counts only where it would have
        been refined. Not where no motion within the limits comes of the first, whose refinement may
        take all the time.
        """
        starts, *others, _ = strategies
        with closing(Child(lambda _: self._plain(self.run([starts], state), state))) as child:
            self.run(others, state)
            try:
                return self._with_plain(state, child.answer(deadline.until()))
            except (OutOfTime, Died):
                return state

    def _plain(self, state: SearchState, before: SearchState) -> list[dict[str, Any]]:
        """Return the new answers of a state as plain data: values without kernels."""
        rows = []
        for answer in state.answers[len(before.answers) :]:
            subject = None if answer.before is None else state.answers.index(answer.before)
            phases = [phase.layout.phase for phase in answer.solution.phases if phase.layout]
            solution = plain_of(answer.solution, phases)
            given = {"solution": solution, "refiner": None, "before": subject}
            rows.append(vars(answer) | given)
        return rows

    def _with_plain(self, state: SearchState, rows: Sequence[dict[str, Any]]) -> SearchState:
        """Return the state with answers of another process."""
        for row in rows:
            solution, _ = from_plain(self.refiner.transcription, row["solution"])
            before = None if row["before"] is None else state.answers[row["before"]]
            again = {"solution": solution, "refiner": self.refiner, "before": before}
            state = state.and_(MotionAnswer(**(row | again)))
        return state


def plain_of(solution: Solution, phases: Iterable[Phase]) -> tuple[Any, ...]:
    """Return a solution as plain data, without the kernels of these phases."""
    parameters = {phase.name: {p.name: p.value for p in phase.parameters} for phase in phases}
    meshes = [phase.mesh for phase in solution.phases]
    return replace(solution, phases=()), meshes, parameters


def from_plain(kernels: Transcription, plain: tuple[Any, ...]) -> tuple[Solution, Transcription]:
    """Return the solution again, and the kernels with the values that their parameters had."""
    solution, meshes, parameters = plain
    if any(parameters.values()):
        kernels = kernels.with_parameters(parameters)
    phases = unpack(kernels.layouts(meshes), solution.variables)
    return replace(solution, phases=phases), kernels


def _first(
    search: MotionSearch, strategies: Sequence[MotionStrategy], state: SearchState
) -> tuple[MotionStrategy, NextStep] | None:
    """Return the first strategy that has something to do."""
    for strategy in strategies:
        if state.answers and search.spent > strategy.share:
            continue
        step = strategy.next_step(search, state)
        if step is not None:
            return strategy, step
    return None


def ledger_of(state: SearchState, last: MotionAnswer) -> Ledger:
    """Return what every strategy did, and which of them the answer comes from."""
    lineage = set(map(id, last.lineage))
    rows, best = [], None
    for answer in state.answers:
        cost = answer.solution.duration if answer.solved else best
        iterations = sum(a["iterations"] for solve in answer.solves for a in solve["attempts"])
        figures = id(answer) in lineage, best, cost, iterations, answer.seconds
        rows.append(LedgerRow(answer.strategy, 1, *figures))
        best = min((c for c in (best, cost) if c is not None), default=None)
    return Ledger.of(rows)


# what answers are worth -----------------------------------------------------------------------


def is_enough(problem: MotionProblem, solution: Solution) -> bool:
    """Return whether a motion on a large mesh is slowed down, by next to nothing, not refined."""
    size = sum(phase.mesh.size - 1 for phase in solution.phases) * problem.family.robot.joint_count
    if size < SEARCH.large or not solution.status.solved or problem.settings.slack:
        return False
    if largest(problem.excess(solution)) <= problem.settings.limit_tolerance:
        return False
    slower = problem.slowed(solution)
    return slower is not None and slower.duration <= (1.0 + SEARCH.enough) * solution.duration


def rank(search: MotionSearch, solution: Solution) -> tuple[bool, float]:
    """Return what keeps its limits first, then what is faster."""
    valid = solution.status.solved and (
        search.worst(solution) <= search.settings.limit_tolerance
        or (search.problem.is_free and is_enough(search.problem, solution))
    )
    return not valid, solution.duration


def by_promise(answers: Sequence[MotionAnswer]) -> list[MotionAnswer]:
    """Give the different optima among coarse answers, the fastest first; of the same the first."""
    different = list[MotionAnswer]()
    for coarse in answers:
        if coarse.solved and not any(
            abs(coarse.solution.duration - other.solution.duration)
            <= SEARCH.same * other.solution.duration
            for other in different
        ):
            different.append(coarse)
    return sorted(different, key=lambda coarse: coarse.solution.duration)


def settled(answers: Sequence[MotionAnswer], settings: TimeOptimalSettings) -> bool:
    """Return whether another start would more likely than not lead to what has been seen before.

    After w different outcomes of N starts it leads to a new one with the probability
    w (w + 1) / (N (N - 1)) (Boender and Rinnooy Kan, Math. Programming 37, 1987, 59-80). What was
    carried on from a coarser mesh is an outcome, but no start.
    """
    solved, count = sum(answer.solved for answer in answers), len(answers)
    if solved == 0 or settings.starts == 1:  # of a single start nothing is asked
        return solved > 0
    different = len(by_promise(answers)) + (solved < count)
    count = sum(answer.before is None for answer in answers)
    return 2 * different * (different + 1) <= count * (count - 1)
