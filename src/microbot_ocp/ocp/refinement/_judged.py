"""A converged solution, taken on until it passes: one loop, whatever is asked for.

What passes is told by the judgement that a certificate is made of; an accuracy may ask for more.
Meshes are made finer until that is met and the cost does not change any more. From a saddle the
solve goes on below it.

Steps of a solver stay in the valley that its point stands in, in every control at every point. The
costates tell which valley is the lower one; a solve from controls that are better by Pontryagin's
condition, which begins near its bounds so as to stay, is kept where it costs less.

Theory: docs/theory/transcription.md, "Refinement".
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from math import ceil
from typing import NamedTuple, cast

import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.status import Status
from microbot_ocp.ocp.diagnosis import START_OFFSET, falls_for_ever
from microbot_ocp.ocp.mesh import Refinement, Round, refined
from microbot_ocp.ocp.refinement._accuracy import (
    PASSING,
    Accuracy,
    History,
    RefinementStep,
    step_of,
)
from microbot_ocp.ocp.solution import Attempt, Journal, Solution, StepProgress, cost_size
from microbot_ocp.ocp.solvers import SolveContext
from microbot_ocp.ocp.starts import guess_from
from microbot_ocp.ocp.transcription import Guess
from microbot_ocp.ocp.verification import Judgement, Thresholds, better_controls, judge

CONVERGED = (Status.SOLVED, Status.GAP_LEFT)
# no other strategy would change it
FINAL = (*CONVERGED, Status.INTERRUPTED, Status.TOO_COARSE, Status.OUTSIDE_TABLE)


@dataclass(frozen=True)
class CostSettings:
    """When the cost of a solution counts as settled where no accuracy is asked for.

    Attributes
    ----------
    settled : times the change that is aimed at, at which it still is where meshes end
    finer : times the intervals of a mesh has one whose cost tells an error of the first
    unmet : share of the cost: where no solve saves it what is more is missed, less is said
    """

    settled: float = 5.0
    finer: float = 1.5
    unmet: float = 1e-2

    @property
    def most_left(self) -> float:
        """Change of the cost at which it still counts as settled."""
        return self.settled * PASSING.cost


COST = CostSettings()


@dataclass(frozen=True)
class Improvement:
    """When controls with a smaller Hamiltonian are worth a solve.

    Attributes
    ----------
    worth : share of the cost: less than this is not looked for
    least_gain : share of what is to be saved that has to be: where controls chatter little of
        it is
    solves : most solves
    barrier : parameter at which they begin: near the bounds, so as to stay
    iterations : of a solve
    """

    worth: float = 1e-5
    least_gain: float = 0.2
    solves: int = 6
    barrier: float = 1e-6
    iterations: int = 200


IMPROVEMENT = Improvement()


@dataclass(frozen=True)
class Left:
    """What the cost would still change by, seen from what it changed by from mesh to mesh."""

    change: float = np.inf
    ratios: tuple[float, float] = (0.5, 0.0)

    def entered(self, change: float) -> Left:
        """Return it with one change more."""
        ratios = self.ratios
        if 0 < self.change < np.inf:
            ratio = float(np.clip(change / self.change, 0.1, 0.9))
            ratios = (ratio, ratios[0] if ratios[1] else 0.1)
        return Left(change, ratios)

    @property
    def estimate(self) -> float:
        """The sum of all further changes, if they go on shrinking as they did."""
        ratio = max(self.ratios)  # one that happens to be small proves nothing
        return self.change * ratio / (1 - ratio)


@dataclass(frozen=True, eq=False)
class Seen:
    """What is known of a solution on its mesh.

    Attributes
    ----------
    judgement, step, left : of what passes, of the mesh, of the cost
    at : when it was known, by ``time.perf_counter``
    """

    judgement: Judgement
    step: RefinementStep
    left: Left
    at: float = field(default_factory=time.perf_counter)

    @property
    def coarse(self) -> bool:
        """Whether it does not pass for want of a finer mesh."""
        return any(k.status is Status.TOO_COARSE for k in self.judgement.failures)

    @property
    def worst(self) -> float:
        """Return the largest error of an interval, relative to the threshold of a pass."""
        parts = (*self.judgement.errors, *self.judgement.excess)
        return max(float(each.max()) for each in parts)


class Beside(NamedTuple):
    """Starts on both sides of a saddle."""

    above: Solution
    below: Solution


Course = Refinement[Solution, Seen]
Rounds = tuple[Round[Solution, Seen], ...]
Next = Beside | Sequence[FloatArray]


def judged(
    solution: Solution,
    context: SolveContext,
    journal: Journal,
    *,
    finer: bool,
    goal: Accuracy = PASSING,
    freer_cost: float = np.inf,
    patient: bool = True,
) -> tuple[Solution, bool]:
    """Return the solution with the status that its judgement gives it, and whether that is final.

    With ``finer`` on meshes so fine that it passes and meets the goal. It is final where no other
    strategy would do better. An error of the cost is also its distance to ``freer_cost``, of a
    solution with more freedom. Without ``patient`` it ends on the first mesh whose errors fall
    so slowly that even the most intervals would not pass.
    """
    if solution.status not in CONVERGED:
        return _alone(solution), solution.status is Status.INTERRUPTED
    return _Work(context, journal, finer, goal, freer_cost, patient).run(solution)


@dataclass(frozen=True, eq=False)
class _Work:
    """How a solution is taken on: what is solved, split, measured, and when it ends."""

    context: SolveContext
    journal: Journal
    finer: bool
    goal: Accuracy
    freer_cost: float
    patient: bool

    @property
    def _alone(self) -> bool:
        """Whether a solver was chosen: what others would save is not looked for."""
        return self.context.settings.solver != "auto"

    def run(self, first: Solution) -> tuple[Solution, bool]:
        began, state = time.perf_counter(), None
        measure = partial(self._measured, began)
        with suppress(KeyboardInterrupt):
            parts = self._split, self._accepts, self._ended
            for state in refined(first, self._solved, measure, *parts):
                self._report(state)
        if state is None:
            return _alone(first).ended(Status.INTERRUPTED), True
        last = state.refused
        if state.ended is None or Status.INTERRUPTED in (state.ended, last and last.status):
            return self._recorded(state).ended(Status.INTERRUPTED), True
        if last is not None and self._at_saddle(state.measure) and _endless(last):
            self._recorded(state)
            return last, True
        state, saved = self._improved(state)
        solution = self._recorded(state)
        # on a mesh that was given the mesh itself may cost more
        return self._judged(solution, state, saved if self.finer else 0.0)

    # the parts of a round --------------------------------------------------------------------

    def _solved(self, best: Solution, proposal: Next) -> Solution:
        if isinstance(proposal, Beside):
            return self._below(best, proposal).with_rivals_of(best)
        answer = self._solve(proposal, best)
        attempts = tuple(named("on a finer mesh", answer.attempts))
        return replace(answer, attempts=attempts).with_rivals_of(best)

    def _solve(self, meshes: Sequence[FloatArray], start: Solution) -> Solution:
        solver = self.context.settings.solver if self._alone else "ipopt"
        return self.context.solve(meshes, start, solver=solver, aimed=True)

    def _below(self, saddle: Solution, starts: Beside) -> Solution:
        """Return the cheaper of what solves lead to on both sides of a saddle.

        Where the cost falls for ever on one side that is what it is, though it did not converge.
        """
        answers: list[Solution] = []
        for start in starts:
            answers.append(self._solve([phase.mesh for phase in saddle.phases], start))
            if _endless(answers[-1]):
                break
        lowest = answers[-1]
        if not _endless(lowest):
            lowest = min(answers, key=lambda answer: (answer.status not in CONVERGED, answer.cost))
            worth = Thresholds().gap * cost_size(saddle.cost, saddle.cost_scale)
            if not lowest.cost < saddle.cost - worth:
                lowest = replace(lowest, status=Status.NOT_ACCEPTED)
        attempts = named("from beside a saddle", [a for k in answers for a in k.attempts])
        return replace(lowest, attempts=tuple(attempts))

    def _accepts(self, _: Solution, after: Solution) -> bool:
        return after.status in CONVERGED

    def _measured(self, began: float, rounds: Rounds, solution: Solution) -> Seen:
        judgement = judge(self.context.transcription, solution)
        before, left = rounds[-1].measure if rounds else None, self._left(rounds, solution)
        dearer = solution.cost - self.freer_cost
        error = max(left.estimate, dearer / cost_size(solution.cost, solution.cost_scale))
        spent = time.perf_counter() - (before.at if before else began)
        step = step_of(solution, judgement, spent)
        return Seen(judgement, replace(step, cost_error=error), left)

    def _left(self, rounds: Rounds, solution: Solution) -> Left:
        """Return what the cost would still change by, by the last mesh that is coarser by a factor:
        two that hardly differ agree wherever the optimum is.
        """
        count = _intervals([phase.mesh for phase in solution.phases])
        for each in reversed(rounds):
            if self._at_saddle(each.measure):
                return Left()
            if COST.finer * sum(each.measure.step.intervals) <= count:
                costs = solution.cost, each.solution.cost
                size = max(cost_size(cost, solution.cost_scale) for cost in costs)
                return each.measure.left.entered(abs(costs[0] - costs[1]) / size)
        return rounds[-1].measure.left if rounds else Left()

    def _split(self, rounds: Rounds) -> Next:
        solution, seen, goal = rounds[-1].solution, rounds[-1].measure, self.goal
        if self._at_saddle(seen):
            return _beside(solution, seen.judgement)
        whole = seen.step.cost_error > goal.cost
        meshes = goal.finer(solution, seen.judgement, seen.step, whole=whole)
        if whole and _intervals(meshes) > goal.most_intervals:
            meshes = goal.finer(solution, seen.judgement, seen.step, whole=False)
            least = ceil(COST.finer * sum(seen.step.intervals))
            if _intervals(meshes) < least <= goal.most_intervals:
                meshes = _widest_halved(meshes, least)
        return meshes

    def _ended(self, rounds: Rounds, proposal: Next) -> Status | None:
        seen, goal = rounds[-1].measure, self.goal
        saddle = self._at_saddle(seen)
        if not saddle and (not self.finer or (goal.met(seen.step) and not seen.coarse)):
            return Status.SOLVED
        if self.context.over:
            return deadline.status()
        if len(rounds) > goal.rounds:
            return Status.ROUND_LIMIT
        if not self.patient and self._hopeless(rounds):
            return Status.NO_PROGRESS
        if isinstance(proposal, Beside):
            return None
        phases = rounds[-1].solution.phases
        same = all(np.array_equal(mesh, p.mesh) for mesh, p in zip(proposal, phases, strict=True))
        return Status.SIZE_LIMIT if same or _intervals(proposal) > goal.most_intervals else None

    def _hopeless(self, rounds: Rounds) -> bool:
        """Return whether even the most intervals would not pass.

        The errors are extrapolated with the order at which they fell since a mesh with fewer
        intervals by a factor.
        """
        last = rounds[-1].measure
        count, error = sum(last.step.intervals), last.worst
        for before in (each.measure for each in reversed(rounds)):
            growth = count / sum(before.step.intervals)
            if last.coarse and growth >= COST.finer:
                order = np.log(max(before.worst / error, 1.0)) / np.log(growth)
                return order * np.log(self.goal.most_intervals / count) < np.log(error)
        return False

    def _at_saddle(self, seen: Seen) -> bool:
        return seen.judgement.status is Status.SADDLE and not self._alone

    # what comes of it ------------------------------------------------------------------------

    def _improved(self, state: Course) -> tuple[Course, float]:
        """Find better controls, and what others would save still."""
        saved = improvable(state.solution)
        if self._alone or not saved > PASSING.cost:
            return state, saved
        began, before = time.perf_counter(), state.measure
        better, tried = improved(state.solution, self.context)
        if better is state.solution:
            self.journal.attempts.extend(tried)
            return state, saved
        seen = self._measured(began, state.rounds, better)
        better = replace(better, attempts=tuple(tried))
        step = replace(seen.step, cost_error=before.step.cost_error)
        last = Round(better, replace(seen, step=step, left=before.left))
        return replace(state, rounds=(*state.rounds, last)), improvable(better)

    def _recorded(self, state: Course) -> Solution:
        """Return the solution with its meshes; what was tried is entered in the journal."""
        history, last = [each.measure.step for each in state.rounds], state.refused
        for old, new in pairwise(state.rounds):
            attempts, spent = new.solution.attempts, new.measure.at - old.measure.at
            self.journal.enter(attempts[-1].way, old.solution, new.solution, attempts, spent)
        if last is not None:
            spent = sum(attempt.wall_time for attempt in last.attempts)
            history.append(step_of(last, None, spent))
            before = state.rounds[-1].solution
            self.journal.enter(last.attempts[-1].way, before, None, last.attempts, spent)
        return replace(state.solution, history=History(history))

    def _report(self, state: Course) -> None:
        progress = self.context.progress
        if self.goal is not PASSING and progress is not None and state.ended is None:
            cast("StepProgress", progress)(str(state.measure.step))

    def _judged(self, solution: Solution, state: Course, saved: float) -> tuple[Solution, bool]:
        """Return the solution with a status and advice that says what is missing, and whether it is
        final.

        That is so, too, where only the mesh or the kind of control is missing.
        """
        goal, status = self.goal, state.measure.judgement.status
        failures = state.measure.judgement.failures
        settled = goal is PASSING and state.measure.left.estimate <= COST.most_left
        missing = list(goal.missing(state.measure.step)) if self.finer and not settled else []
        rises = [] if goal is PASSING else list(History(solution.history).rises(goal.cost))
        solution = solution.remarked(*rises)
        if not missing and not failures and saved > COST.most_left:
            lost = (
                f"Other controls would save {saved:.1g} of the cost, but no solve from there does: "
                "the optimum may be approached by controls that jump to and fro ever faster."
            )
            if saved <= COST.unmet:
                return solution.remarked(lost), True
            return solution.ended(Status.NO_PROGRESS, lost), True
        if not missing and (status is solution.status or not failures):
            return solution, True
        if self.finer and status in (Status.SOLVED, Status.TOO_COARSE):
            ended = state.ended or Status.SOLVED
            status = Status.NO_PROGRESS if ended is Status.SOLVED else ended
        parts = [*missing, *(failure.sentence for failure in failures[:1])]
        final = status in FINAL or (goal is not PASSING and not failures)
        return solution.ended(status, f"Missing: {'; '.join(parts)}.", *rises), final


def _endless(solution: Solution) -> bool:
    return falls_for_ever(solution.cost, solution.cost_scale)


def _alone(solution: Solution) -> Solution:
    """Return a solution of which nothing else is known, as the only one of its history."""
    spent = sum(attempt.wall_time for attempt in solution.attempts)
    return replace(solution, history=History([step_of(solution, None, spent)]))


def named(way: str, attempts: Sequence[Attempt]) -> list[Attempt]:
    """Return attempts that say what they were for."""
    return [replace(attempt, way=attempt.way or way) for attempt in attempts]


def _intervals(meshes: Sequence[FloatArray]) -> int:
    return sum(mesh.size - 1 for mesh in meshes)


def _widest_halved(meshes: Sequence[FloatArray], least: int) -> list[FloatArray]:
    """Return meshes of at least so many intervals in all: the widest of them are halved."""
    widths = np.concatenate([np.diff(mesh) for mesh in meshes])
    wide = np.zeros(widths.size, dtype=bool)
    wide[np.argsort(-widths, kind="stable")[: least - widths.size]] = True
    parts = np.split(wide, np.cumsum([mesh.size - 1 for mesh in meshes])[:-1])
    pairs = zip(meshes, parts, strict=True)
    return [np.union1d(mesh, (mesh[:-1] + mesh[1:])[part] / 2) for mesh, part in pairs]


def _beside(solution: Solution, judgement: Judgement) -> Beside:
    """Return starts on both sides of a saddle."""
    assert judgement.curvature is not None
    direction, x = judgement.curvature.direction, solution.variables
    assert direction is not None
    assert x is not None
    step = START_OFFSET / np.abs(direction).max() * direction
    from_there = replace(solution, variable_multipliers=None)
    return Beside(*(replace(from_there, variables=at) for at in (x + step, x - step)))


def improvable(solution: Solution) -> float:
    """Return what better controls would save, to first order, relative to the cost."""
    gain, _ = better_controls(solution)
    return gain / cost_size(solution.cost, solution.cost_scale)


def improved(solution: Solution, context: SolveContext) -> tuple[Solution, list[Attempt]]:
    """Return the solution, or one on its mesh that costs less, and what was tried."""
    attempts: list[Attempt] = []
    most = min(context.settings.max_iterations, IMPROVEMENT.iterations)
    how = {"solver": "ipopt", "initial_barrier": IMPROVEMENT.barrier, "max_iterations": most}
    for _ in range(IMPROVEMENT.solves):
        gain, controls = better_controls(solution)
        size = cost_size(solution.cost, solution.cost_scale)
        if not gain > IMPROVEMENT.worth * size or context.over:
            break
        guess = {
            name: Guess(old.duration, {**old.values, **controls.get(name, {})})
            for name, old in guess_from(context.transcription.problem, solution).items()
        }
        tried = context.solve([phase.mesh for phase in solution.phases], guess, **how)
        attempts += named("from controls with a smaller Hamiltonian", tried.attempts)
        if not (tried.status.solved and tried.cost < solution.cost - IMPROVEMENT.least_gain * gain):
            break
        solution = tried.with_rivals_of(solution)
    return solution, attempts
