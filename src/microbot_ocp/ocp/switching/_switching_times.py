"""Switching times as unknowns: the arcs of a solution, each a phase of free length.

On an arc every control is at a bound, follows from an active limit, or is free. Held controls need
no discretisation, and the dynamics are integrated by Radau collocation of order 9 to the wanted
accuracy. A bang-bang problem becomes a few equations for its switching times. Source: C. Y. Kaya
and J. L. Noakes, *Computational method for time-optimal switching control*, J. Optim. Theory Appl.
117 (2003) 69-92.

The loop (:meth:`_SwitchingSearch.run`) repeats these steps, one solve per round:

1. *solve* for the lengths of the planned arcs. If that fails, the plan is dropped and the next
   steps use the last solved arcs; without solved arcs the search ends.
2. *revise* the structure (``_revision.py``): arcs of zero length are removed; a control whose
   multiplier has the wrong sign leaves its limit; a free control at a limit is held. Arcs that have
   not been tried go back to 1.
3. *determine* singular arcs by their optimality conditions (``_singular.py``), once: a success ends
   the search.
4. *refine* the meshes of arcs with inaccurate dynamics or limits exceeded between mesh points, and
   go back to 1; otherwise continue.
5. *judge*: the cost against that of the first solution, limits, the gap, and the signs of the
   multipliers (Bryson and Ho, *Applied Optimal Control*, sections 3.8 and 3.9).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.checks import InputError
from microbot_ocp._base.outcome import Outcome
from microbot_ocp._base.status import Status
from microbot_ocp.ocp.arcs import ArcPlan, Signature, plan_of
from microbot_ocp.ocp.mesh import divide, state_errors
from microbot_ocp.ocp.problem import OptimalControlProblem
from microbot_ocp.ocp.refinement import CONVERGED
from microbot_ocp.ocp.search import solve
from microbot_ocp.ocp.solution import PhaseSolution, Solution, StepProgress, cost_size, quiet
from microbot_ocp.ocp.solvers import SolveContext, SolverSettings
from microbot_ocp.ocp.starts import scaled
from microbot_ocp.ocp.switching._answer import SINGULAR, SwitchingTimes, junctions_of
from microbot_ocp.ocp.switching._cutter import HIGH_ORDER, cut, is_cuttable
from microbot_ocp.ocp.switching._revision import (
    LEAST_INTERVALS,
    ArcSolution,
    with_finer_meshes,
    wrong_signs,
)
from microbot_ocp.ocp.switching._singular import NotPossibleError, solve_conditions
from microbot_ocp.ocp.transcription import Transcription
from microbot_ocp.ocp.verification import dense_phase, limit_uses, relative_excess, worst_along

SETTINGS = SolverSettings(
    "ipopt", tolerance=1e-10, gap=1e-7, initial_barrier=1e-4, max_iterations=300
)
MOST_ARCS = 12  # arcs in a phase; a chattering solution is not divided
MOST_INTERVALS = 8  # intervals of an arc on its first mesh
COARSER = 3  # intervals of a detected arc for one of its first mesh
NEGLIGIBLE_EXCESS = 1e-8  # excess between mesh points above which an arc is refined, by the limit
FINEST = 64  # intervals of an arc above which that excess no longer refines it
EXCEEDED = 1e-4  # excess between mesh points above which a solution is rejected, by the limit
COSTLIER = 1e-3  # cost above that of the start that is accepted, relative to that cost

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
    """Solve for the times at which controls switch and limits become active or inactive.

    Parameters
    ----------
    problem : OptimalControlProblem or Transcription
    start : Solution, optional
        Solution that shows the arcs, and whose cost the result may not exceed. Default:
        :func:`solve` on 50 intervals.
    accuracy : float
        Relative error of the dynamics that is accepted in each interval.
    settings : SolverSettings, optional
        Default: IPOPT to a tolerance of 1e-10 and a gap of 1e-7 of the cost.
    rounds : int
        Largest number of solves.
    time_limit : float
        Wall time limit, s.
    progress : callable
        Function called with a line of text after every solve.
    transcribe : callable
        Function that transcribes the problem with one phase per arc; its keyword is ``scheme``.

    Returns
    -------
    SwitchingTimes
        Also returned after a failure: see ``status``.

    Raises
    ------
    InputError
        ``start`` belongs to another problem, or the problem cannot be divided: an expression along
        a phase depends on its duration, or a constraint or cost holds at points inside it.

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
            raise InputError(f"start has the phases {names}, not those of the problem")
        # A mesh that is too coarse for the accuracy still shows the arcs.
        if first.status not in (Status.SOLVED, Status.TOO_COARSE):
            return SwitchingTimes(first.status, first.advice, (), first)
        for phase in declared.phases:
            if not is_cuttable(phase):
                raise InputError(
                    f"phase {phase.name!r} cannot be cut into arcs: an expression along it depends "
                    "on its duration, or a constraint or cost holds at points inside it"
                )
        plans, how = [_planned(phase) for phase in first.phases], settings or SETTINGS
        search = _SwitchingSearch(declared, first, accuracy, how, progress, transcribe, plans)
        return search.run(rounds)


def _planned(phase: PhaseSolution) -> ArcPlan:
    """Return the arcs of a solution, with meshes that suit a scheme of high order."""
    plan = plan_of(phase)
    arcs = []
    for arc in plan.arcs:
        intervals = np.clip(-(-arc.intervals // COARSER), LEAST_INTERVALS, MOST_INTERVALS)
        arcs.append(replace(arc, intervals=int(intervals)))
    return replace(plan, arcs=tuple(arcs))


@dataclass(eq=False)
class _SwitchingSearch:
    """State of the search: plans of the arcs, tried structures, and the last transcription."""

    problem: OptimalControlProblem
    first: Solution
    accuracy: float
    settings: SolverSettings
    progress: StepProgress
    transcribe: Transcribe
    plans: Sequence[ArcPlan]
    tried: set[tuple[tuple[Signature, ...], ...]] = field(default_factory=set)
    transcribed: tuple[Any, Transcription] | None = None  # signatures and their transcription
    not_singular: NotPossibleError | None = None  # reason why singular arcs are not determined

    def run(self, rounds: int) -> SwitchingTimes:
        """Run the loop of the module docstring."""
        solved: ArcSolution | None = None
        measured, error = solved, np.inf
        until = deadline.until()
        for done in range(rounds):
            stopped = self._stopped(until)
            if stopped is not None:
                return self._answer(measured, error, stopped)
            # A failed attempt leaves ``solved`` unchanged: refinement continues with the last
            # solved arcs.
            attempt = self._solve()
            if attempt.solution.status in CONVERGED:
                solved = attempt
            elif solved is None or attempt.solution.status is Status.INTERRUPTED:
                return self._answer(measured, error, _not_solved(attempt))
            self.plans = solved.plans
            revised = solved.revised() if done < rounds // 2 else solved.plans
            # Half of the rounds may change the structure; the rest is kept for refinement.
            if _signatures(revised) not in self.tried:
                self.plans = revised
                continue
            singular = self._determine(solved)
            if singular is not None:
                return singular
            errors = state_errors(solved.solution)
            measured, error = solved, max(float(e.max()) for e in errors)
            finer = self._finer(solved, errors)
            # The last round accepts limits that are still exceeded between mesh points; _judged
            # reports them.
            unkept = any(finer[p.name] > p.mesh.size - 1 for p in solved.solution.phases)
            if error <= self.accuracy and not (unkept and done < rounds - 1):
                return self._answer(measured, error, self._judged(solved))
            self.plans = with_finer_meshes(solved, finer)
        return self._answer(measured, error, Outcome.of(Status.ROUND_LIMIT))

    def _stopped(self, until: float) -> Outcome | None:
        most = 2 * MOST_ARCS  # short arcs may still vanish
        if any(len(plan.arcs) > most for plan in self.plans):
            advice = f"More than {most} arcs in a phase are too many to solve for."
            return Outcome.of(Status.NOT_POSSIBLE, advice)
        return Outcome.of(Status.TIME_LIMIT) if time.perf_counter() > until else None

    def _solve(self) -> ArcSolution:
        """Solve for the lengths of the arcs of the plans."""
        in_arcs = cut(self.problem, self.plans)
        signatures = _signatures(self.plans)
        self.tried.add(signatures)
        # Kernels depend on the structure of the arcs alone: refinement rounds reuse the
        # transcription.
        if self.transcribed is None or self.transcribed[0] != signatures:
            scaled_problem = scaled(in_arcs.problem, in_arcs.guesses)
            self.transcribed = signatures, self.transcribe(scaled_problem, scheme=HIGH_ORDER)
        context = SolveContext(self.transcribed[1], self.settings)
        solution = context.solve(in_arcs.meshes, in_arcs.guesses)
        self.progress(f"{len(in_arcs.meshes)} arcs: cost {solution.cost:.12g}, {solution.status}")
        return ArcSolution(tuple(self.plans), in_arcs.groups, solution)

    def _determine(self, solved: ArcSolution) -> SwitchingTimes | None:
        """Return the result with singular arcs by their conditions, or None if not possible."""
        # A transcription with given derivatives lacks the higher ones needed here.
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
            self._answer(solved, singular.state_error, Outcome.of(Status.SOLVED)),
            advice=f"{Status.SOLVED.sentence} A control is {SINGULAR}.",
            junctions=tuple(junctions_of(plan, singular.lengths, singular=True)),
            singular=singular,
        )

    def _finer(self, solved: ArcSolution, errors: Sequence[np.ndarray]) -> dict[str, int]:
        """Return the number of intervals of every arc, from state errors and excess of limits."""
        intervals = {}
        for piece, error in zip(solved.solution.phases, errors, strict=True):
            count = piece.mesh.size - 1
            divided = divide(piece.mesh, error, self.accuracy, HIGH_ORDER.order)
            intervals[piece.name] = divided.size - 1
            ratio = relative_excess(dense_phase(piece)).max(initial=0.0) / NEGLIGIBLE_EXCESS
            if ratio > 1.0 and count < FINEST:
                parts = int(np.clip(np.ceil(ratio ** (1 / HIGH_ORDER.degree)), 2, 4))
                # The excess between points falls with the interval length to the power ``degree``.
                intervals[piece.name] = max(intervals[piece.name], parts * count)
        return intervals

    def _judged(self, solved: ArcSolution) -> Outcome:
        """Return the verdict: locally optimal, or the reason why not."""
        solution, first = solved.solution, self.first
        # The detected structure allows the cost of the start: a higher cost proves it wrong.
        if solution.cost > first.cost + COSTLIER * abs(first.cost):
            return Outcome.of(
                Status.NOT_ACCEPTED,
                f"The arcs cost {solution.cost:.8g}, more than the {first.cost:.8g} of the "
                "solution that shows them: give a start on a finer mesh.",
            )
        worst = worst_along(use for p in solution.phases for use in limit_uses(dense_phase(p)))
        if worst is not None and worst.relative > EXCEEDED:
            return Outcome.of(
                Status.LIMITS_EXCEEDED,
                f"Between mesh points {worst.kind} {worst.name} of {worst.phase!r} is "
                f"{100 * worst.relative:.2g} % beyond its limit: the optimum has more arcs than "
                "the given start shows.",
            )
        # First-order conditions: a small gap, followed by the signs of the multipliers of held
        # controls.
        wanted = self.settings.gap * cost_size(solution.cost, solution.cost_scale)
        if not solution.gap.total <= wanted:
            return Outcome.of(
                Status.GAP_LEFT,
                f"{Status.GAP_LEFT.sentence} It is {solution.gap.total:.2g}, not {wanted:.2g}.",
            )
        wrong = wrong_signs(solved)
        if wrong:
            return Outcome.of(
                Status.NO_PROGRESS,
                f"In {', '.join(wrong)} the multiplier of a control at its limit has the wrong "
                "sign: a switch is missing. A start on a finer mesh may show it.",
            )
        return Outcome.of(Status.SOLVED)

    def _answer(self, solved: ArcSolution | None, error: float, verdict: Outcome) -> SwitchingTimes:
        status, advice = verdict.status, verdict.text
        if status is Status.ROUND_LIMIT:
            advice += f" The dynamics hold to {error:.1e} instead of {self.accuracy:.1e}."
        if status is not Status.INTERRUPTED:
            free = _undetermined(self.plans)
            if free:
                shares = [f"{100 * share:.2g} % of {name!r}" for name, share in free.items()]
                where = ", ".join(shares)
                advice += (
                    f" Along {where} fewer limits are active than there are controls: a control is "
                    "singular there, or several solutions are equally good, and its switching "
                    "times are not determined."
                )
            if self.not_singular is not None:
                advice += f" Its optimality conditions were not solved: {self.not_singular}."
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


def _not_solved(attempt: ArcSolution) -> Outcome:
    status = attempt.solution.status
    return Outcome.of(
        status,
        f"The {len(attempt.solution.phases)} arcs that the start shows do not lead to a solution: "
        "an arc is missing or wrong, and a start on a finer mesh may "
        f"show which. The last solve: {status.sentence}",
    )


def _undetermined(plans: Sequence[ArcPlan]) -> dict[str, float]:
    """Return the fraction of every phase with fewer active limits than controls."""
    shares = (
        sum(arc.end - arc.begin for arc in plan.arcs if plan.is_undetermined(arc)) for plan in plans
    )
    pairs = zip(plans, shares, strict=True)
    return {plan.declared.name: share for plan, share in pairs if share > 0}
