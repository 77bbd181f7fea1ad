"""Switching times as unknowns: the arcs of a solution, each a phase of free length.

On an arc every control is at a bound, or follows from an active limit, or is free; what is held has
no discretisation, and the dynamics are integrated by Radau collocation of order 9 until they hold
to a wanted accuracy. A bang-bang problem becomes a handful of equations for its switching times.
Source: C. Y. Kaya and J. L. Noakes, *Computational method for time-optimal switching control*,
J. Optim. Theory Appl. 117 (2003) 69-92.

The loop (:meth:`_SwitchingSearch.run`) goes round with these steps, one solve each round:

1. *solve* for the lengths of the arcs as they are planned. Where that fails the plan is dropped,
   and what follows is done with the arcs that were solved for last; without any the search ends.
2. *revise* the structure (``_revision.py``): arcs that shrank to nothing go; where a multiplier has
   the wrong sign what is held leaves its limit; what is free and lies at a limit is held. If these
   arcs were not tried before: back to 1.
3. *determine* singular arcs by their own conditions (``_singular.py``), once: that ends the search.
4. *refine* the meshes of the arcs on which the dynamics, or limits between mesh points, are not
   accurate, if there are any: back to 1.
5. *judge*: the cost against that of the first solution, limits, the gap, the signs of multipliers
   (those of a minimum: Bryson and Ho, *Applied Optimal Control*, sections 3.8 and 3.9).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.checks import InputError
from microbot_ocp._base.status import Status
from microbot_ocp.ocp.arcs import ArcPlan, Signature, plan_of
from microbot_ocp.ocp.mesh import divide, state_errors
from microbot_ocp.ocp.problem import OptimalControlProblem
from microbot_ocp.ocp.refinement import CONVERGED
from microbot_ocp.ocp.search import solve
from microbot_ocp.ocp.solution import PhaseSolution, Solution, StepProgress, cost_size, quiet
from microbot_ocp.ocp.solvers import SolverSettings, solve_on
from microbot_ocp.ocp.starts import scaled
from microbot_ocp.ocp.switching._answer import SINGULAR, SwitchingTimes, junctions_of
from microbot_ocp.ocp.switching._cutter import cut, is_cuttable
from microbot_ocp.ocp.switching._revision import ArcSolution, with_finer_meshes, wrong_signs
from microbot_ocp.ocp.switching._settings import CUTTER, HIGH_ORDER, SWITCHING
from microbot_ocp.ocp.switching._singular import NotPossibleError, solve_conditions
from microbot_ocp.ocp.transcription import Transcription
from microbot_ocp.ocp.verification import dense_phase, limit_uses, relative_excess, worst_along

SETTINGS = SolverSettings(
    "ipopt", tolerance=1e-10, gap=1e-7, initial_barrier=1e-4, max_iterations=300
)

Transcribe = Callable[..., Transcription]


def solve_switching_times(
    problem: OptimalControlProblem | Transcription,
    start: Solution | None = None,
    *,
    accuracy: float = 1e-9,
    settings: SolverSettings | None = None,
    rounds: int = 16,
    time_limit: float = 60.0,
    progress: StepProgress = quiet,
    transcribe: Transcribe = Transcription,
) -> SwitchingTimes:
    """Solve for the times at which controls switch and limits begin or cease to act.

    Parameters
    ----------
    problem : OptimalControlProblem or Transcription
    start : Solution, optional
        That shows the arcs; its cost is what theirs may not exceed. Default: :func:`solve` on 50
        intervals.
    accuracy : float
        Relative error of the dynamics that is accepted in any interval.
    settings : SolverSettings, optional
        Default: IPOPT to a tolerance of 1e-10 and a gap of 1e-7 of the cost.
    rounds : int
        Most solves of one set of arcs.
    time_limit : float
        Wall time after which it is stopped, s.
    progress : callable
        Called with a line of text for every solve.
    transcribe : callable
        Makes a transcription of the problem with one phase an arc; its keyword is ``scheme``.

    Returns
    -------
    SwitchingTimes
        Also where that failed: look at ``status``.

    Raises
    ------
    InputError
        The start is none of the problem, or the problem cannot be cut: it has expressions of the
        duration of a phase along that phase, or demands at points within it.

    Examples
    --------
    >>> problem = OptimalControlProblem("double integrator")
    >>> phase = problem.phase("move", duration=(0.1, 10.0))
    >>> x = phase.state("x", initial=0.0, final=3.0)
    >>> v = phase.state("v", initial=0.0, final=0.0)
    >>> u = phase.control("u", lower=-1.0, upper=2.0)
    >>> phase.derivative(x, v)
    >>> phase.derivative(v, u)
    >>> phase.end_cost(phase.duration)
    >>> exact = solve_switching_times(problem)  # 1 s at 2, then 2 s at -1
    >>> [(j.name, round(j.time, 9), j.after) for j in exact.junctions], round(exact.cost, 9)
    ([('u', 1.0, 'lower limit')], 3.0)
    """
    accuracy = checks.number("accuracy", accuracy, above=0.0)
    with deadline.within(time_limit):
        declared = problem.problem if isinstance(problem, Transcription) else problem
        first = solve(problem, 50) if start is None else start
        names = [phase.name for phase in first.phases]
        if names != [phase.name for phase in declared.phases]:
            raise InputError(f"start has the phases {names}, which are not those of the problem")
        if first.status not in (Status.SOLVED, Status.TOO_COARSE):  # which shows the arcs, too
            return SwitchingTimes(first.status, first.advice, (), first)
        for phase in declared.phases:
            if not is_cuttable(phase):
                raise InputError(
                    f"phase {phase.name!r} cannot be cut into arcs: what holds along it depends on "
                    "its duration, or is demanded at points within it"
                )
        plans, how = [_planned(phase) for phase in first.phases], settings or SETTINGS
        search = _SwitchingSearch(declared, first, accuracy, how, progress, transcribe, plans)
        return search.run(rounds)


def _planned(phase: PhaseSolution) -> ArcPlan:
    """Plan the arcs that a solution shows, with meshes that suit a scheme of high order."""
    plan = plan_of(phase)
    least, most = SWITCHING.least_intervals, SWITCHING.most_intervals
    arcs = [
        replace(arc, intervals=int(np.clip(-(-arc.intervals // SWITCHING.coarser), least, most)))
        for arc in plan.arcs
    ]
    return replace(plan, arcs=tuple(arcs))


class _Verdict(NamedTuple):
    """What the search ends with."""

    status: Status
    advice: str = ""


@dataclass(eq=False)
class _SwitchingSearch:
    """Solves with one phase an arc, and what changes between them."""

    problem: OptimalControlProblem
    first: Solution
    accuracy: float
    settings: SolverSettings
    progress: StepProgress
    transcribe: Transcribe
    plans: Sequence[ArcPlan]
    tried: set[tuple[tuple[Signature, ...], ...]] = field(default_factory=set)
    transcribed: tuple[Any, Transcription] | None = None  # for which signatures
    not_singular: NotPossibleError | None = None  # why conditions do not determine singular arcs

    def run(self, rounds: int) -> SwitchingTimes:
        """Go round the steps of the header."""
        solved: ArcSolution | None = None
        measured, error = solved, np.inf
        until = deadline.until()
        for done in range(rounds):
            stopped = self._stopped(until)
            if stopped is not None:
                return self._answer(measured, error, stopped)
            attempt = self._solve()
            if attempt.solution.status in CONVERGED:
                solved = attempt
            elif solved is None or attempt.solution.status is Status.INTERRUPTED:
                return self._answer(measured, error, _not_solved(attempt))
            self.plans = solved.plans
            revised = solved.revised() if done < rounds // 2 else solved.plans
            if _signatures(revised) not in self.tried:
                self.plans = revised
                continue
            singular = self._determine(solved)
            if singular is not None:
                return singular
            errors = state_errors(solved.solution)
            measured, error = solved, max(float(e.max()) for e in errors)
            finer = self._finer(solved, errors)
            unkept = any(finer[p.name] > p.mesh.size - 1 for p in solved.solution.phases)
            if error <= self.accuracy and not (unkept and done < rounds - 1):
                return self._answer(measured, error, self._judged(solved))
            self.plans = with_finer_meshes(solved, finer)
        return self._answer(measured, error, _Verdict(Status.ROUND_LIMIT))

    def _stopped(self, until: float) -> _Verdict | None:
        most = 2 * CUTTER.most_arcs  # short ones may turn out to be none
        if any(len(plan.arcs) > most for plan in self.plans):
            advice = f"More than {most} arcs in a phase are too many to solve for."
            return _Verdict(Status.NOT_POSSIBLE, advice)
        return _Verdict(Status.TIME_LIMIT) if time.perf_counter() > until else None

    def _solve(self) -> ArcSolution:
        """Solve for the lengths of the arcs of the plans."""
        in_arcs = cut(self.problem, self.plans)
        signatures = _signatures(self.plans)
        self.tried.add(signatures)
        if self.transcribed is None or self.transcribed[0] != signatures:
            scaled_problem = scaled(in_arcs.problem, in_arcs.guesses)
            self.transcribed = signatures, self.transcribe(scaled_problem, scheme=HIGH_ORDER)
        solution = solve_on(self.transcribed[1], in_arcs.meshes, in_arcs.guesses, self.settings)
        self.progress(f"{len(in_arcs.meshes)} arcs: cost {solution.cost:.12g}, {solution.status}")
        return ArcSolution(tuple(self.plans), in_arcs.groups, solution)

    def _determine(self, solved: ArcSolution) -> SwitchingTimes | None:
        """Answer with singular arcs by their own conditions, where these can be solved."""
        # dynamics with derivatives of their own have no higher ones
        possible = self.transcribe is Transcription and bool(_undetermined(solved.plans))
        if self.not_singular is not None or not possible:
            return None
        plan = solved.as_solved()[0]
        count = len(plan.arcs)
        try:
            singular = solve_conditions(self.problem, plan, solved.solution, self.accuracy)
        except NotPossibleError as error:
            self.progress(f"conditions of {count} arcs: {error}")
            self.not_singular = error
            return None
        self.progress(f"conditions of {count} arcs: cost {singular.cost:.12g}")
        return replace(
            self._answer(solved, singular.state_error, _Verdict(Status.SOLVED)),
            advice=f"{Status.SOLVED.sentence} A control is {SINGULAR}.",
            junctions=tuple(junctions_of(plan, singular.lengths, singular=True)),
            singular=singular,
        )

    def _finer(self, solved: ArcSolution, errors: Sequence[np.ndarray]) -> dict[str, int]:
        """Count intervals of every arc: for its dynamics, and for limits between points."""
        intervals = {}
        for piece, error in zip(solved.solution.phases, errors, strict=True):
            count = piece.mesh.size - 1
            divided = divide(piece.mesh, error, self.accuracy, HIGH_ORDER.order)
            intervals[piece.name] = divided.size - 1
            ratio = relative_excess(dense_phase(piece)).max(initial=0.0) / SWITCHING.negligible
            if ratio > 1.0 and count < SWITCHING.finest:
                parts = int(np.clip(np.ceil(ratio ** (1 / SWITCHING.degree)), 2, 4))
                intervals[piece.name] = max(intervals[piece.name], parts * count)
        return intervals

    def _judged(self, solved: ArcSolution) -> _Verdict:
        """Judge whether the arcs are those of a local optimum, and why not."""
        solution, first = solved.solution, self.first
        if solution.cost > first.cost + SWITCHING.costlier * abs(first.cost):
            return _Verdict(
                Status.NOT_ACCEPTED,
                f"The arcs cost {solution.cost:.8g}, more than the {first.cost:.8g} of the "
                "solution that they were read from: give one of a finer mesh.",
            )
        worst = worst_along(use for p in solution.phases for use in limit_uses(dense_phase(p)))
        if worst is not None and worst.relative > SWITCHING.exceeded:
            return _Verdict(
                Status.LIMITS_EXCEEDED,
                f"Between mesh points {worst.kind} {worst.name} of {worst.phase!r} is "
                f"{100 * worst.relative:.2g} % beyond its limit: there are more arcs than the "
                "solution that was given shows.",
            )
        wanted = self.settings.gap * cost_size(solution.cost, solution.cost_scale)
        if not solution.gap.total <= wanted:
            return _Verdict(
                Status.GAP_LEFT,
                f"{Status.GAP_LEFT.sentence} It is {solution.gap.total:.2g}, not {wanted:.2g}.",
            )
        wrong = wrong_signs(solved)
        if wrong:
            return _Verdict(
                Status.NO_PROGRESS,
                f"In {', '.join(wrong)} the multiplier of a control that is held at its limit has "
                "the wrong sign: a switch is missing. A solution on a finer mesh may show it.",
            )
        return _Verdict(Status.SOLVED)

    def _answer(
        self, solved: ArcSolution | None, error: float, verdict: _Verdict
    ) -> SwitchingTimes:
        status, advice = verdict.status, verdict.advice or verdict.status.sentence
        if status is Status.ROUND_LIMIT:
            advice += f" The dynamics hold to {error:.1e}, {self.accuracy:.1e} is wanted."
        if status is not Status.INTERRUPTED:
            free = _undetermined(self.plans)
            if free:
                shares = [f"{100 * share:.2g} % of {name!r}" for name, share in free.items()]
                where = ", ".join(shares)
                advice += (
                    f" Along {where} fewer limits act than there are controls: a control is "
                    "singular there, or other solutions are as good, and it has no switching times "
                    "of its own."
                )
            if self.not_singular is not None:
                advice += f" Its own conditions do not determine it: {self.not_singular}."
        if solved is None:
            return SwitchingTimes(status, advice, (), self.first)
        junctions, pieces = [], {}
        for index, plan in enumerate(solved.plans):
            phases = solved.pieces(index)
            junctions += junctions_of(plan, [phase.duration for phase in phases])
            pieces[plan.declared.name] = tuple(phase.name for phase in phases)
        return SwitchingTimes(status, advice, tuple(junctions), solved.solution, pieces, error)


def _signatures(plans: Sequence[ArcPlan]) -> tuple[tuple[Signature, ...], ...]:
    return tuple(plan.signatures for plan in plans)


def _not_solved(attempt: ArcSolution) -> _Verdict:
    status = attempt.solution.status
    return _Verdict(
        status,
        f"The {len(attempt.solution.phases)} arcs that the solution shows cannot follow one "
        "another, or were not made to: one is missing or wrong, and a start on a finer mesh may "
        f"show which. Of their solve: {status.sentence}",
    )


def _undetermined(plans: Sequence[ArcPlan]) -> dict[str, float]:
    """Return the share of every phase in which fewer limits act than there are controls."""
    shares = (
        sum(arc.end - arc.begin for arc in plan.arcs if plan.is_undetermined(arc)) for plan in plans
    )
    pairs = zip(plans, shares, strict=True)
    return {plan.declared.name: share for plan, share in pairs if share > 0}
