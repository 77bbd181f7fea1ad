"""Refinement of a converged solution until it passes its judgement: one loop for all requirements.

A solution passes if the judgement behind its certificate finds no failure; an accuracy may require
more. Meshes are refined until this holds and the cost has settled. From a saddle the solve
continues on both sides of it.

Solver steps stay near the local minimum of the Hamiltonian at the current controls, at every point.
The costates show whether another local minimum is lower; a solve from controls that are better by
Pontryagin's condition, started near its bounds to stay there, is kept if it is cheaper.

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
# No other strategy would change these statuses.
FINAL = (*CONVERGED, Status.INTERRUPTED, Status.TOO_COARSE, Status.OUTSIDE_TABLE)

UNREACHED_SAVING = 1e-2  # relative saving that a settled cost may still miss
MESH_RATIO = 1.5  # least ratio of intervals of two meshes whose costs show an error
BARRIER_NEAR_BOUNDS = 1e-6  # initial barrier parameter that keeps a start near its bounds


@dataclass(frozen=True)
class CostExtrapolation:
    """Estimate of the remaining change of the cost, from its changes from mesh to mesh."""

    change: float = np.inf
    ratios: tuple[float, float] = (0.5, 0.0)

    def updated(self, change: float) -> CostExtrapolation:
        """Return the estimate with one further change."""
        ratios = self.ratios
        if 0 < self.change < np.inf:
            ratio = float(np.clip(change / self.change, 0.1, 0.9))
            ratios = (ratio, ratios[0] if ratios[1] else 0.1)
        return CostExtrapolation(change, ratios)

    @property
    def estimate(self) -> float:
        """Sum of all further changes, a geometric series with the ratio of the past changes."""
        ratio = max(self.ratios)  # a single small ratio may be a coincidence
        return self.change * ratio / (1 - ratio)


@dataclass(frozen=True, eq=False)
class MeshAssessment:
    """Judgement, results and cost estimate of a solution on its mesh.

    Attributes
    ----------
    judgement : Judgement
    step : RefinementStep
    extrapolation : estimate of the remaining change of the cost
    at : time of the judgement, ``time.perf_counter``
    """

    judgement: Judgement
    step: RefinementStep
    extrapolation: CostExtrapolation
    at: float = field(default_factory=time.perf_counter)

    @property
    def coarse(self) -> bool:
        """True if the solution fails because its mesh is too coarse."""
        return any(k.status is Status.TOO_COARSE for k in self.judgement.failures)

    @property
    def worst(self) -> float:
        """Return the largest error of an interval, relative to the threshold of a pass."""
        parts = (*self.judgement.errors, *self.judgement.excess)
        return max(float(each.max()) for each in parts)


class SaddleStarts(NamedTuple):
    """Starts on both sides of a saddle."""

    above: Solution
    below: Solution


MeshRefinement = Refinement[Solution, MeshAssessment]
Rounds = tuple[Round[Solution, MeshAssessment], ...]
Proposal = SaddleStarts | Sequence[FloatArray]


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
    """Return the solution with the status of its judgement, and whether that is final.

    With ``finer``, meshes are refined until it passes and meets the goal. It is final if no other
    strategy would improve it. The error of the cost includes the distance to ``freer_cost``, the
    cost of a solution with more freedom. With ``patient=False``, refinement ends on the first mesh
    whose errors decrease too slowly to pass with the largest number of intervals.
    """
    if solution.status not in CONVERGED:
        return _with_own_step(solution), solution.status is Status.INTERRUPTED
    return _RefinementLoop(context, journal, finer, goal, freer_cost, patient).run(solution)


@dataclass(frozen=True, eq=False)
class _RefinementLoop:
    """Functions of the refinement loop: solve, split, measure, accept and end."""

    context: SolveContext
    journal: Journal
    finer: bool
    goal: Accuracy
    freer_cost: float
    patient: bool

    @property
    def _solver_is_fixed(self) -> bool:
        """True if a solver was chosen: better controls are not searched."""
        return self.context.settings.solver != "auto"

    def run(self, first: Solution) -> tuple[Solution, bool]:
        began, state = time.perf_counter(), None
        measure = partial(self._measured, began)
        with suppress(KeyboardInterrupt):
            parts = self._split, self._accepts, self._ended
            for state in refined(first, self._solved, measure, *parts):
                self._report(state)
        if state is None:
            return _with_own_step(first).ended(Status.INTERRUPTED), True
        last = state.refused
        if state.ended is None or Status.INTERRUPTED in (state.ended, last and last.status):
            return self._recorded(state).ended(Status.INTERRUPTED), True
        if last is not None and self._at_saddle(state.measure) and _is_unbounded(last):
            self._recorded(state)
            return last, True
        state, saved = self._improved(state)
        solution = self._recorded(state)
        # On a given mesh the saving may be an error of that mesh.
        return self._judged(solution, state, saved if self.finer else 0.0)

    # one round -------------------------------------------------------------------------------

    def _solved(self, best: Solution, proposal: Proposal) -> Solution:
        if isinstance(proposal, SaddleStarts):
            return self._below(best, proposal).with_rivals_of(best)
        answer = self._solve(proposal, best)
        attempts = tuple(named("on a finer mesh", answer.attempts))
        return replace(answer, attempts=attempts).with_rivals_of(best)

    def _solve(self, meshes: Sequence[FloatArray], start: Solution) -> Solution:
        solver = self.context.settings.solver if self._solver_is_fixed else "ipopt"
        return self.context.solve(meshes, start, solver=solver, aimed=True)

    def _below(self, saddle: Solution, starts: SaddleStarts) -> Solution:
        """Return the cheaper of the solutions from both sides of a saddle.

        An unbounded cost on one side is returned as such, although it did not converge.
        """
        answers: list[Solution] = []
        for start in starts:
            answers.append(self._solve([phase.mesh for phase in saddle.phases], start))
            if _is_unbounded(answers[-1]):
                break
        lowest = answers[-1]
        if not _is_unbounded(lowest):
            lowest = min(answers, key=lambda answer: (answer.status not in CONVERGED, answer.cost))
            worth = Thresholds().gap * cost_size(saddle.cost, saddle.cost_scale)
            if not lowest.cost < saddle.cost - worth:
                lowest = replace(lowest, status=Status.NOT_ACCEPTED)
        attempts = named("from beside a saddle", [a for k in answers for a in k.attempts])
        return replace(lowest, attempts=tuple(attempts))

    def _accepts(self, _: Solution, after: Solution) -> bool:
        return after.status in CONVERGED

    def _measured(self, began: float, rounds: Rounds, solution: Solution) -> MeshAssessment:
        judgement = judge(self.context.transcription, solution)
        before, extrapolation = (
            rounds[-1].measure if rounds else None,
            self._extrapolated(rounds, solution),
        )
        dearer = solution.cost - self.freer_cost
        error = max(extrapolation.estimate, dearer / cost_size(solution.cost, solution.cost_scale))
        spent = time.perf_counter() - (before.at if before else began)
        step = step_of(solution, judgement, spent)
        return MeshAssessment(judgement, replace(step, cost_error=error), extrapolation)

    def _extrapolated(self, rounds: Rounds, solution: Solution) -> CostExtrapolation:
        """Return the estimate updated by the last mesh that is coarser by the factor ``finer``.

        Two nearly equal meshes have nearly equal costs wherever the optimum is.
        """
        count = _intervals([phase.mesh for phase in solution.phases])
        for each in reversed(rounds):
            if self._at_saddle(each.measure):
                return CostExtrapolation()
            if MESH_RATIO * sum(each.measure.step.intervals) <= count:
                costs = solution.cost, each.solution.cost
                size = max(cost_size(cost, solution.cost_scale) for cost in costs)
                return each.measure.extrapolation.updated(abs(costs[0] - costs[1]) / size)
        return rounds[-1].measure.extrapolation if rounds else CostExtrapolation()

    def _split(self, rounds: Rounds) -> Proposal:
        solution, assessment, goal = rounds[-1].solution, rounds[-1].measure, self.goal
        if self._at_saddle(assessment):
            return _saddle_starts(solution, assessment.judgement)
        whole = assessment.step.cost_error > goal.cost
        meshes = goal.finer(solution, assessment.judgement, assessment.step, whole=whole)
        if whole and _intervals(meshes) > goal.most_intervals:
            meshes = goal.finer(solution, assessment.judgement, assessment.step, whole=False)
            least = ceil(MESH_RATIO * sum(assessment.step.intervals))
            if _intervals(meshes) < least <= goal.most_intervals:
                meshes = _widest_halved(meshes, least)
        return meshes

    def _ended(self, rounds: Rounds, proposal: Proposal) -> Status | None:
        assessment, goal = rounds[-1].measure, self.goal
        saddle = self._at_saddle(assessment)
        if not saddle and (not self.finer or (goal.met(assessment.step) and not assessment.coarse)):
            return Status.SOLVED
        if self.context.over:
            return deadline.status()
        if len(rounds) > goal.rounds:
            return Status.ROUND_LIMIT
        if not self.patient and self._cannot_pass(rounds):
            return Status.NO_PROGRESS
        if isinstance(proposal, SaddleStarts):
            return None
        phases = rounds[-1].solution.phases
        same = all(np.array_equal(mesh, p.mesh) for mesh, p in zip(proposal, phases, strict=True))
        return Status.SIZE_LIMIT if same or _intervals(proposal) > goal.most_intervals else None

    def _cannot_pass(self, rounds: Rounds) -> bool:
        """Return whether even the most intervals would not pass.

        The errors are extrapolated with the order at which they fell since a mesh with fewer
        intervals by a factor.
        """
        last = rounds[-1].measure
        count, error = sum(last.step.intervals), last.worst
        for before in (each.measure for each in reversed(rounds)):
            growth = count / sum(before.step.intervals)
            if last.coarse and growth >= MESH_RATIO:
                order = np.log(max(before.worst / error, 1.0)) / np.log(growth)
                return order * np.log(self.goal.most_intervals / count) < np.log(error)
        return False

    def _at_saddle(self, assessment: MeshAssessment) -> bool:
        return assessment.judgement.status is Status.SADDLE and not self._solver_is_fixed

    # results ---------------------------------------------------------------------------------

    def _improved(self, state: MeshRefinement) -> tuple[MeshRefinement, float]:
        """Return the refinement with better controls if found, and the saving still promised."""
        saved = improvable(state.solution)
        if self._solver_is_fixed or not saved > PASSING.cost:
            return state, saved
        began, before = time.perf_counter(), state.measure
        better, tried = improved(state.solution, self.context)
        if better is state.solution:
            self.journal.attempts.extend(tried)
            return state, saved
        assessment = self._measured(began, state.rounds, better)
        better = replace(better, attempts=tuple(tried))
        step = replace(assessment.step, cost_error=before.step.cost_error)
        last = Round(better, replace(assessment, step=step, extrapolation=before.extrapolation))
        return replace(state, rounds=(*state.rounds, last)), improvable(better)

    def _recorded(self, state: MeshRefinement) -> Solution:
        """Return the solution with its history, and record the attempts in the journal."""
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

    def _report(self, state: MeshRefinement) -> None:
        progress = self.context.progress
        if self.goal is not PASSING and progress is not None and state.ended is None:
            cast("StepProgress", progress)(str(state.measure.step))

    def _judged(
        self, solution: Solution, state: MeshRefinement, saved: float
    ) -> tuple[Solution, bool]:
        """Return the solution with status and advice, and True if it is final.

        It is also final if only the mesh or the shape of a control prevents that it passes.
        """
        goal, status = self.goal, state.measure.judgement.status
        failures = state.measure.judgement.failures
        missing = list(goal.missing(state.measure.step)) if self.finer else []
        rises = [] if goal is PASSING else list(History(solution.history).rises(goal.cost))
        solution = solution.remarked(*rises)
        if not missing and not failures and saved > PASSING.cost:
            lost = (
                f"Other controls promise to save {saved:.1g} of the cost, but no solve reaches it: "
                "the optimum may be a limit of controls that switch ever faster."
            )
            if saved <= UNREACHED_SAVING:
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


def _is_unbounded(solution: Solution) -> bool:
    return falls_for_ever(solution.cost, solution.cost_scale)


def _with_own_step(solution: Solution) -> Solution:
    """Return a solution with a history of its own mesh only."""
    spent = sum(attempt.wall_time for attempt in solution.attempts)
    return replace(solution, history=History([step_of(solution, None, spent)]))


def named(way: str, attempts: Sequence[Attempt]) -> list[Attempt]:
    """Return attempts labelled with their strategy."""
    return [replace(attempt, way=attempt.way or way) for attempt in attempts]


def _intervals(meshes: Sequence[FloatArray]) -> int:
    return sum(mesh.size - 1 for mesh in meshes)


def _widest_halved(meshes: Sequence[FloatArray], least: int) -> list[FloatArray]:
    """Return meshes of at least ``least`` intervals together, by halving the widest ones."""
    widths = np.concatenate([np.diff(mesh) for mesh in meshes])
    wide = np.zeros(widths.size, dtype=bool)
    wide[np.argsort(-widths, kind="stable")[: least - widths.size]] = True
    parts = np.split(wide, np.cumsum([mesh.size - 1 for mesh in meshes])[:-1])
    pairs = zip(meshes, parts, strict=True)
    return [np.union1d(mesh, (mesh[:-1] + mesh[1:])[part] / 2) for mesh, part in pairs]


def _saddle_starts(solution: Solution, judgement: Judgement) -> SaddleStarts:
    """Return starts on both sides of a saddle, displaced along its direction."""
    assert judgement.curvature is not None
    direction, x = judgement.curvature.direction, solution.variables
    assert direction is not None
    assert x is not None
    step = START_OFFSET / np.abs(direction).max() * direction
    from_there = replace(solution, variable_multipliers=None)
    return SaddleStarts(*(replace(from_there, variables=at) for at in (x + step, x - step)))


def improvable(solution: Solution) -> float:
    """Return the first-order saving of better controls, relative to the cost."""
    gain, _ = better_controls(solution)
    return gain / cost_size(solution.cost, solution.cost_scale)


LEAST_GAIN = 1e-5  # relative saving below which no solve is tried
LEAST_REACHED_SHARE = 0.2  # least fraction of a promised saving; chattering reaches little of it
MOST_IMPROVEMENTS = 6  # solves from controls with a smaller Hamiltonian
IMPROVEMENT_ITERATIONS = 200  # iteration limit of such a solve


def improved(solution: Solution, context: SolveContext) -> tuple[Solution, list[Attempt]]:
    """Return the solution or a cheaper one on its mesh, and the attempts."""
    attempts: list[Attempt] = []
    most = min(context.settings.max_iterations, IMPROVEMENT_ITERATIONS)
    how = {"solver": "ipopt", "initial_barrier": BARRIER_NEAR_BOUNDS, "max_iterations": most}
    for _ in range(MOST_IMPROVEMENTS):
        gain, controls = better_controls(solution)
        size = cost_size(solution.cost, solution.cost_scale)
        if not gain > LEAST_GAIN * size or context.over:
            break
        guess = {
            name: Guess(old.duration, {**old.values, **controls.get(name, {})})
            for name, old in guess_from(context.transcription.problem, solution).items()
        }
        tried = context.solve([phase.mesh for phase in solution.phases], guess, **how)
        attempts += named("from controls with a smaller Hamiltonian", tried.attempts)
        if not (tried.status.solved and tried.cost < solution.cost - LEAST_REACHED_SHARE * gain):
            break
        solution = tried.with_rivals_of(solution)
    return solution, attempts
