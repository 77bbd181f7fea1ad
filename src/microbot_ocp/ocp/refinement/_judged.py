"""A converged solution, taken on until it passes: one loop, whatever is asked for.

What passes is told by the judgement that a certificate is made of. Where nothing else is asked for
meshes are made finer until it passes and the cost does not change any more; with an accuracy until
that is met, too. From a saddle the solve goes on below it.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from typing import NamedTuple, cast

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.outcome import Ledger
from microbot_ocp._base.status import Status
from microbot_ocp.ocp.diagnosis import BESIDE, falls_for_ever
from microbot_ocp.ocp.mesh import Refinement, Round, divide, divide_phase, refined
from microbot_ocp.ocp.refinement._accuracy import Accuracy
from microbot_ocp.ocp.refinement._context import SolveContext
from microbot_ocp.ocp.refinement._cost_error import cost_error, with_more_freedom
from microbot_ocp.ocp.refinement._history import History, RefinementStep, step_of
from microbot_ocp.ocp.refinement._improvement import improvable, improved
from microbot_ocp.ocp.solution import Attempt, Solution, StepProgress, cost_size, entry
from microbot_ocp.ocp.transcription import Mesh, mesh_of
from microbot_ocp.ocp.verification import (
    Failure,
    Judgement,
    Thresholds,
    judge,
    relative_excess,
)

CONVERGED = (Status.SOLVED, Status.GAP_LEFT)
FINAL = (*CONVERGED, Status.INTERRUPTED, Status.TOO_COARSE)  # no other strategy would change it


@dataclass(frozen=True)
class Passing:
    """When a solution is good enough where no accuracy is asked for.

    Attributes
    ----------
    change : relative change of the cost from mesh to mesh, seen to the end, that is aimed at
    settled : times this change, at which the cost still counts as settled
    unmet : share of the cost: where no solve saves it what is more is missed, less is said
    rounds : most solves
    most_intervals : of all phases together
    """

    change: float = 1e-4
    settled: float = 5.0
    unmet: float = 1e-2
    rounds: int = 14
    most_intervals: int = 1000

    @property
    def most_left(self) -> float:
        """Change of the cost at which it still counts as settled."""
        return self.settled * self.change


PASSING = Passing()


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
    judgement, step, left : of all that is asked, of the mesh, of the cost
    freer : solution with finer controls or a higher degree, where the cost is all that is missing
    at : when it was known, by ``time.perf_counter``
    """

    judgement: Judgement
    step: RefinementStep
    left: Left
    freer: Solution | None = None
    at: float = field(default_factory=time.perf_counter)

    @property
    def settled(self) -> bool:
        """Whether the mesh is fine enough and the cost does not change any more."""
        coarse = any(k.status is Status.TOO_COARSE for k in self.judgement.failures)
        return self.left.estimate <= PASSING.change and not coarse


class Beside(NamedTuple):
    """Starts on both sides of a saddle."""

    above: Solution
    below: Solution


Course = Refinement[Solution, Seen]
Rounds = tuple[Round[Solution, Seen], ...]
Next = Beside | Solution | Sequence[Mesh | FloatArray]


def judged(
    solution: Solution,
    context: SolveContext,
    *,
    finer: bool,
    accuracy: Accuracy | None = None,
    freer_cost: float = np.inf,
) -> tuple[Solution, bool]:
    """Return the solution with the status that its judgement gives it, and whether that is final.

    With ``finer`` on meshes so fine that it passes and its cost does not change any more; with an
    accuracy until that is met. It is final where no other strategy would do better. An accuracy of
    the cost is also of its distance to ``freer_cost``, of a solution with more freedom.
    """
    if solution.status not in CONVERGED:
        return _alone(solution), solution.status is Status.INTERRUPTED
    return _Work(context, finer, accuracy, freer_cost).run(solution)


@dataclass(frozen=True, eq=False)
class _Work:
    """How a solution is taken on: what is solved, split, measured, and when it ends."""

    context: SolveContext
    finer: bool
    accuracy: Accuracy | None
    freer_cost: float

    @property
    def _alone(self) -> bool:
        """Whether a solver was chosen: what others would save is not looked for."""
        return self.context.settings.solver != "auto"

    def run(self, first: Solution) -> tuple[Solution, bool]:
        began, state = time.perf_counter(), None
        measure = partial(self._measured, began)
        with suppress(KeyboardInterrupt):
            for state in refined(
                first, self._solved, measure, self._split, self._accepts, self._ended
            ):
                self._report(state)
        if state is None:
            return _interrupted(_alone(first)), True
        last = state.refused
        if state.ended is None or Status.INTERRUPTED in (state.ended, last and last.status):
            return _interrupted(self._recorded(state)), True
        if last is not None and self._at_saddle(state.measure) and _endless(last):
            return replace(last, attempts=self._recorded(state).attempts), True
        state, saved, tried = self._improved(state)
        solution = self._recorded(state)
        solution = replace(solution, attempts=(*solution.attempts, *tried))
        # on a mesh that was given the mesh itself may cost more
        return self._judged(solution, state, saved if self.finer else 0.0)

    # the parts of a round --------------------------------------------------------------------

    def _solved(self, best: Solution, proposal: Next) -> Solution:
        if isinstance(proposal, Solution):
            return proposal
        if isinstance(proposal, Beside):
            return self._below(best, proposal).with_rivals_of(best)
        answer = _by("on a finer mesh", self._solve(proposal, best))
        rows = answer.rows if answer.status is Status.GAP_LEFT else best.rows
        return replace(answer, rows=rows).with_rivals_of(best)

    def _solve(self, meshes: Sequence[Mesh | FloatArray], start: Solution) -> Solution:
        solver = self.context.settings.solver if self._alone else "ipopt"
        return self.context.solve(meshes, start, solver=solver)

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
        attempts = tuple(a for answer in answers for a in answer.attempts)
        return _by("from beside a saddle", replace(lowest, attempts=attempts))

    def _accepts(self, before: Solution, after: Solution) -> bool:
        """Return whether a solve converged; to an accuracy no gap takes the place of what has
        none.
        """
        worse = after.status is Status.GAP_LEFT and before.solved and self.accuracy is not None
        return after.status in CONVERGED and not worse

    def _measured(self, began: float, rounds: Rounds, solution: Solution) -> Seen:
        judgement = judge(self.context.transcription, solution)
        before = rounds[-1].measure if rounds else None
        step = step_of(solution, judgement, time.perf_counter() - (before.at if before else began))
        if before is None or self._at_saddle(before):
            seen = Seen(judgement, step, Left())
        else:
            costs = solution.cost, rounds[-1].solution.cost
            size = max(cost_size(cost, solution.cost_scale) for cost in costs)
            left = before.left.entered(abs(costs[0] - costs[1]) / size)
            seen = Seen(judgement, step, left)
        if self.accuracy is None or self.context.over:
            return seen
        return self._with_cost_error(solution, seen, self.accuracy)

    def _with_cost_error(self, solution: Solution, seen: Seen, accuracy: Accuracy) -> Seen:
        """Add the error of the cost, where all else is good enough, by a solve more."""
        if not accuracy.met(seen.step):
            return seen
        if accuracy.cost == np.inf:
            return replace(seen, step=replace(seen.step, cost_error=0.0))
        freer = self._solved(solution, with_more_freedom(solution))
        error = cost_error(solution, freer) if freer.status in CONVERGED else np.inf
        missed = solution.cost - self.freer_cost
        error = max(error, missed / cost_size(solution.cost, solution.cost_scale))
        step = replace(seen.step, cost_error=error)
        return replace(seen, step=step, at=time.perf_counter(), freer=freer)

    def _split(self, rounds: Rounds) -> Next:
        solution, seen = rounds[-1].solution, rounds[-1].measure
        if self._at_saddle(seen):
            return _beside(solution, seen.judgement)
        if self.accuracy is None:
            whole = seen.left.estimate > PASSING.change
            meshes = _divided(solution, seen.judgement, whole=whole)
            if _intervals(meshes) <= PASSING.most_intervals:
                return meshes
            return _divided(solution, seen.judgement, whole=False)
        if seen.freer is not None:
            return seen.freer
        return [
            self.accuracy.finer(*phase)
            for phase in zip(
                solution.phases,
                seen.judgement.state_errors,
                [relative_excess(dense) for dense in seen.judgement.dense],
                seen.step.switches,
                strict=True,
            )
        ]

    def _ended(self, rounds: Rounds, proposal: Next) -> Status | None:
        seen, goal = rounds[-1].measure, self.accuracy
        saddle = self._at_saddle(seen)
        if not saddle:
            if goal is None and (not self.finer or seen.settled):
                return Status.SOLVED
            if goal is not None and goal.met(seen.step) and seen.step.cost_error <= goal.cost:
                return Status.SOLVED
        if self.context.over:
            return Status.TIME_LIMIT
        if len(rounds) > (PASSING if goal is None else goal).rounds:
            return Status.ROUND_LIMIT
        if saddle:
            return None
        if goal is not None:
            if seen.freer is not None and seen.freer.status not in CONVERGED:
                stopped = seen.freer.status is Status.INTERRUPTED
                return Status.INTERRUPTED if stopped else Status.NOT_ACCEPTED
            if goal.stalled([each.measure.step for each in rounds]):
                return Status.NO_PROGRESS
        if isinstance(proposal, Beside):
            return None
        if isinstance(proposal, Solution):
            proposal = [phase.mesh for phase in proposal.phases]
        count, most = _intervals(proposal), (PASSING if goal is None else goal).most_intervals
        same = goal is None and count <= sum(seen.step.intervals)
        return Status.SIZE_LIMIT if same or count > most else None

    def _at_saddle(self, seen: Seen) -> bool:
        return seen.judgement.status is Status.SADDLE and not self._alone

    # what comes of it ------------------------------------------------------------------------

    def _improved(self, state: Course) -> tuple[Course, float, list[Attempt]]:
        """Find better controls, what others would save still, and what was tried."""
        saved = improvable(state.solution)
        if self._alone or not saved > PASSING.change:
            return state, saved, []
        began, before = time.perf_counter(), state.measure
        better, tried = improved(state.solution, self.context)
        if better is state.solution:
            return state, saved, tried
        seen = self._measured(began, state.rounds, better)
        better = replace(better, attempts=tuple(tried), rows=state.solution.rows)
        last = Round(better, replace(seen, left=before.left))
        return replace(state, rounds=(*state.rounds, last)), improvable(better), []

    def _recorded(self, state: Course) -> Solution:
        """Return the solution with all that was tried, its meshes and its part of the ledger."""
        first, last = state.rounds[0].solution, state.refused
        answers = [each.solution for each in state.rounds]
        history = [each.measure.step for each in state.rounds]
        rows = [
            entry(
                new.solution.attempts[-1].way,
                old.solution,
                new.solution,
                new.solution.attempts,
                new.measure.at - old.measure.at,
            )
            for old, new in pairwise(state.rounds)
        ]
        if last is not None:
            spent = sum(attempt.wall_time for attempt in last.attempts)
            answers.append(last)
            history.append(step_of(last, None, spent))
            rows.append(entry(last.attempts[-1].way, answers[-2], None, last.attempts, spent))
        return replace(
            state.solution,
            attempts=tuple(a for each in answers for a in each.attempts),
            history=History(history),
            ledger=Ledger.of([*first.ledger, *rows]),
        )

    def _report(self, state: Course) -> None:
        progress = self.context.progress
        if self.accuracy is not None and progress is not None and state.ended is None:
            cast("StepProgress", progress)(str(state.measure.step))

    def _judged(self, solution: Solution, state: Course, saved: float) -> tuple[Solution, bool]:
        """Return the solution with a status and advice that says what is missing, and whether it is
        final.

        That is so, too, where only the mesh or the kind of control is missing.
        """
        seen, goal = state.measure, self.accuracy
        status, missing = seen.judgement.status, list(seen.judgement.failures)
        settled = goal is not None or not self.finer or seen.left.estimate <= PASSING.most_left
        if not settled:
            change = (
                f"by {seen.left.change:.1g} of itself" if seen.left.change < np.inf else "unknown"
            )
            sentence = f"what the cost changes from mesh to mesh: {change}"
            missing.append(Failure(Status.NO_PROGRESS, sentence))
        if goal is not None:
            missing = [*goal.missing(seen.step), *missing]
            status = _of_accuracy(status, state.ended, missing)
            rises = goal.rises(solution.history)
            solution = solution.remarked(*rises)
        if not missing and saved > PASSING.most_left:
            lost = (
                f"Other controls would save {saved:.1g} of the cost, but no solve from there does: "
                "the optimum may be approached by controls that jump to and fro ever faster."
            )
            if saved <= PASSING.unmet:
                return solution.remarked(lost), True
            return solution.ended(Status.NO_PROGRESS, lost), True
        if (status is solution.status and settled) or (not missing and status.solved):
            return solution, True
        if goal is None and self.finer and status in (Status.SOLVED, Status.TOO_COARSE):
            status = Status.TIME_LIMIT if self.context.over else Status.NO_PROGRESS
        parts = [failure.sentence for failure in missing[: None if goal is not None else 1]]
        remarks = [f"Missing: {'; '.join(parts)}."] if parts else []
        if goal is not None:
            remarks += rises
        final = status in FINAL or (goal is not None and not seen.judgement.failures)
        return solution.ended(status, *remarks), final


def _of_accuracy(judged: Status, ended: Status | None, missing: Sequence[Failure]) -> Status:
    """Return the status of what was refined to an accuracy."""
    if ended is not Status.SOLVED:
        return ended or Status.INTERRUPTED
    return (
        Status.NO_PROGRESS if missing and judged in (Status.SOLVED, Status.TOO_COARSE) else judged
    )


def _endless(solution: Solution) -> bool:
    return falls_for_ever(solution.cost, solution.cost_scale)


def _alone(solution: Solution) -> Solution:
    """Return a solution of which nothing else is known, as the only one of its history."""
    spent = sum(attempt.wall_time for attempt in solution.attempts)
    return replace(solution, history=History([step_of(solution, None, spent)]))


def _interrupted(solution: Solution) -> Solution:
    return solution.ended(Status.INTERRUPTED)


def _by(way: str, solution: Solution) -> Solution:
    """Return the solution, whose attempts say what they were for."""
    return replace(solution, attempts=tuple(replace(a, way=way) for a in solution.attempts))


def _intervals(meshes: Sequence[Mesh | FloatArray]) -> int:
    return sum(mesh_of(mesh).intervals for mesh in meshes)


def _beside(solution: Solution, judgement: Judgement) -> Beside:
    """Return starts on both sides of a saddle."""
    assert judgement.curvature is not None
    direction, x = judgement.curvature.direction, solution.variables
    assert direction is not None
    assert x is not None
    step = BESIDE / np.abs(direction).max() * direction
    starts = (
        replace(solution, variables=at, variable_multipliers=None) for at in (x + step, x - step)
    )
    return Beside(*starts)


def _divided(solution: Solution, judgement: Judgement, *, whole: bool) -> list[FloatArray]:
    """Return intervals divided as their errors ask for; with ``whole`` every one in two, if that
    will do.

    Where limits are exceeded in between they are divided further: where a control jumps a state
    leaves its limit by the step times the jump, whatever the order of the scheme.
    """
    pairs = list(zip(solution.phases, judgement.errors, judgement.excess, strict=True))
    divided = []
    for phase, errors, _ in pairs:
        divided.append(divide_phase(phase, errors, 1.0))
        whole &= int(np.histogram(divided[-1][:-1], phase.mesh)[0].max()) <= 2
    if whole:
        divided = [np.union1d(p.mesh, (p.mesh[:-1] + p.mesh[1:]) / 2) for p, *_ in pairs]
    return [
        np.union1d(mesh, divide(phase.mesh, excess, 1.0, 0))
        for mesh, (phase, _, excess) in zip(divided, pairs, strict=True)
    ]
