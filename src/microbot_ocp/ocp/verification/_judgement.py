"""Judgement of a solution: one set of checks for the certificate and for the solve.

The declared expressions are evaluated again, the dynamics are integrated again interval by
interval, limits are checked between the mesh points, and the optimality conditions of first and
second order are evaluated at the solution. A solve refines until every check passes, or its status
names the check that fails.

:func:`verify` adds costates, Hamiltonians, arcs and a verdict: the certificate.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import ROUNDING, FloatArray, InputError
from microbot_ocp._base.growth import growth_said
from microbot_ocp._base.status import Status
from microbot_ocp.ocp.problem import OptimalControlProblem, Phase, node_variables
from microbot_ocp.ocp.solution import PhaseSolution, Solution, cost_size, unpack
from microbot_ocp.ocp.starts import problem_data, with_problem_data
from microbot_ocp.ocp.transcription import (
    PhaseLayout,
    PointGroup,
    Transcription,
    bounds_of,
    fill_transitions,
    labels_of,
    stage_kind,
)
from microbot_ocp.ocp.verification._certificate import (
    CostCheck,
    Curvature,
    Hamiltonian,
    OCPCertificate,
    OCPLimitUse,
    Optimality,
    Residual,
    ResimulationCheck,
    Thresholds,
)
from microbot_ocp.ocp.verification._conditions import (
    Derivatives,
    Point,
    bound_multipliers,
    curvature_of,
    differentiate,
    lagrangian_gradient,
    optimality_of,
)
from microbot_ocp.ocp.verification._hamiltonian import costates_of, hamiltonian_of
from microbot_ocp.ocp.verification._limits import (
    DensePhase,
    arcs_of,
    dense_phase,
    limit_uses,
    relative_excess,
)
from microbot_ocp.ocp.verification._recomputation import (
    Recomputation,
    check_cost,
    missed_conditions,
    scaled_rows,
)
from microbot_ocp.ocp.verification._reintegration import each_interval, interval_errors, resimulate

# Statuses that the same checks assign: they are decided anew here.
JUDGED = (Status.TOO_COARSE, Status.SADDLE, Status.OUTSIDE_TABLE)
RESIDUALS = {
    "feasibility": "not feasible: {} is violated by {}",
    "stationarity": "not stationary: the gradient of the Lagrangian by {} is {}",
    "complementarity": "not complementary: {} has a multiplier away from its limit, worth {}",
    "sign": "multiplier of the wrong sign: {} with {}",
}


@dataclass(frozen=True)
class Failure:
    """A failed check: its status, and a sentence."""

    status: Status
    sentence: str


@dataclass(frozen=True, eq=False)
class Judgement:
    """The checks of one solution.

    Attributes
    ----------
    failures : failed checks; empty if the solution passes
    cost, resimulations, limits, optimality : entries of the certificate
    curvature : second-order condition; None if other checks failed
    errors : error of every interval of a phase [N]: larger of the missed mesh state and the missed
        cost, as a fraction of an equal share of the threshold
    excess : largest excess over a limit in every interval of a phase [N], as a fraction of the
        threshold
    passes : Thresholds
    phases, point, derivatives, dense : intermediate results that the checks are computed from
    """

    failures: tuple[Failure, ...]
    cost: CostCheck
    resimulations: tuple[ResimulationCheck, ...]
    limits: tuple[OCPLimitUse, ...]
    optimality: Optimality
    curvature: Curvature | None
    errors: tuple[FloatArray, ...]
    excess: tuple[FloatArray, ...]
    passes: Thresholds
    phases: tuple[PhaseSolution, ...]
    point: Point
    derivatives: tuple[Derivatives, ...]
    dense: tuple[DensePhase, ...]

    @property
    def state_errors(self) -> list[FloatArray]:
        """Relative errors of every interval of each phase [N]."""
        return [errors * (self.passes.state_error / errors.size) for errors in self.errors]

    @property
    def status(self) -> Status:
        """SOLVED if all checks passed, otherwise the status of the first failure."""
        return self.failures[0].status if self.failures else Status.SOLVED


def judge(
    problem: OptimalControlProblem | Transcription,
    solution: Solution,
    thresholds: Thresholds | None = None,
) -> Judgement:
    """Check a solution, and return the results of all checks.

    Raises
    ------
    InputError
        The solution is of another problem, or was not made by a solve.
    """
    passes = thresholds or Thresholds()
    declared = problem.problem if isinstance(problem, Transcription) else problem
    phases = as_declared(declared, solution)
    layouts = [phase.laid_out for phase in phases]
    bounds = bounds_of(layouts)
    labels = [*labels_of(layouts, "variables"), *labels_of(layouts, "rows")]
    lam_g = np.asarray(solution.row_multipliers, dtype=float)
    if lam_g.size != bounds.row_lower.size:
        raise InputError(
            f"the solution has {lam_g.size} row multipliers for {bounds.row_lower.size} rows of "
            f"problem {declared.name!r}"
        )
    x, again = scaled_variables(phases), [Recomputation(phase) for phase in phases]
    parts = tuple(differentiate(phase, lam_g) for phase in phases)
    gradient = lagrangian_gradient(parts, lam_g)
    lam_x, computed = bound_multipliers(bounds, solution, gradient)
    g = scaled_rows(declared, again)
    point = Point(labels, bounds, x, g, gradient, lam_x, lam_g, computed)
    local = [each_interval(phase, cost=True) for phase in phases]
    cost = check_cost(solution.cost, again, local)
    dense = tuple(dense_phase(recomputed.phase, recomputed.interpolated) for recomputed in again)
    checked = Judgement(
        failures=(),
        cost=cost,
        resimulations=tuple(map(resimulate, phases, local)),
        limits=tuple(use for d in dense for use in limit_uses(d)),
        optimality=optimality_of(point, solution.cost_scale),
        curvature=None,
        errors=tuple(
            interval_errors(phase, arrived, recomputed.costs, cost.size)
            / (passes.state_error / (phase.mesh.size - 1))
            for phase, recomputed, arrived in zip(phases, again, local, strict=True)
        ),
        excess=tuple(relative_excess(d).max(axis=1) / passes.excess for d in dense),
        passes=passes,
        phases=phases,
        point=point,
        derivatives=parts,
        dense=dense,
    )
    failures = [
        *_problems_of(solution, unpack(layouts, x)),
        *(Failure(Status.INFEASIBLE, k) for k in missed_conditions(again, passes.feasibility)),
        *_failures_of(checked, solution.cost_scale),
    ]
    if failures:
        return replace(checked, failures=tuple(failures))
    curvature = curvature_of(solution, point, passes.gap, cost.size)
    if not curvature.minimum:
        sentence = (
            "a saddle, not a minimum: along one direction, in units of the scales of variables, "
            f"the curvature of the Lagrangian is {curvature.least:.2g} of the cost"
        )
        failures = [Failure(Status.SADDLE, sentence)]
    return replace(checked, failures=tuple(failures), curvature=curvature)


# phases with the declared expressions -------------------------------------------------------------


def as_declared(problem: OptimalControlProblem, solution: Solution) -> tuple[PhaseSolution, ...]:
    """Return the phases of a solution with the declared expressions and the data of the solve.

    Limits, conditions, parameters and scales are those of the solve, which may differ from the
    declared ones, see :class:`~microbot_ocp.ocp.ParametricSolver`. Kernels are built anew, without
    derivatives; only the places of rows and variables are taken from the solved program.

    Raises
    ------
    InputError
        The solution is of another problem.
    """
    names = [phase.name for phase in problem.phases]
    if names != [phase.name for phase in solution.phases]:
        raise InputError(
            f"the solution has phases {[p.name for p in solution.phases]}, but problem "
            f"{problem.name!r} has {names}"
        )
    restated = []
    for declared, phase in zip(problem.phases, solution.phases, strict=True):
        given = phase.laid_out
        layout = _laid_out(with_problem_data(declared, problem_data(given)), given)
        same = [[block.entries for block in (*k.rows, *k.variables)] for k in (layout, given)]
        if same[0] != same[1]:
            raise InputError(
                f"phase {declared.name!r} of the solution has other variables or constraints than "
                f"that of problem {problem.name!r}"
            )
        restated.append(replace(phase, layout=layout))
    return tuple(restated)


def _laid_out(phase: Phase, given: PhaseLayout) -> PhaseLayout:
    """Return a layout with the places of another layout and kernels of its own."""

    def derive(functions: Sequence[ca.Function], _: object) -> Sequence[ca.Function]:
        # The checks differentiate the functions themselves: leave out the builder's derivatives.
        return [function for function in functions for _ in range(3)]

    kind = stage_kind(phase, given.kind.scheme, float(given.node_scale[-1]), derive)
    pairs = zip(kind.kernels.points, given.points, strict=True)
    points = tuple(PointGroup(k, replace(point.block, entries=k.rows)) for k, point in pairs)
    return replace(given, phase=phase, kind=kind, points=points)


def scaled_variables(phases: Sequence[PhaseSolution]) -> FloatArray:
    """Return the variables of the program from the stages and last mesh values of all phases."""
    layouts = [phase.laid_out for phase in phases]
    x = np.zeros(sum(layout.variable_count for layout in layouts))
    for layout, phase in zip(layouts, phases, strict=True):
        assert phase.stages is not None
        end = [phase.values[v.name][-1] for v in node_variables(layout.phase)]
        x[layout.stages] = phase.stages
        x[layout.nodes[-1]] = np.append(np.concatenate(end), phase.duration) / layout.node_scale
    fill_transitions(layouts, x)
    return x


# failed checks ------------------------------------------------------------------------------------


def _problems_of(solution: Solution, stages: Sequence[PhaseSolution]) -> list[Failure]:
    """Return failures that need no evaluation: no convergence, inconsistent values.

    ``stages`` are the phases as unpacked from the stages of the program.
    """
    failures = []
    if not solution.status.solved and solution.status not in JUDGED:
        failures.append(Failure(solution.status, f"the solve did not converge: {solution.status}"))
    for phase, again in zip(solution.phases, stages, strict=True):
        for name, values in phase.values.items():
            size = max(ROUNDING, float(np.abs(again.values[name]).max()))
            if not np.abs(values - again.values[name]).max() <= ROUNDING * size:
                sentence = (
                    f"the values of {name} in phase {phase.name!r} differ from those of its stages"
                )
                failures.append(Failure(Status.FAILED, sentence))
    return failures


def _failures_of(checked: Judgement, cost_scale: float) -> Iterator[Failure]:
    """Yield the failed checks, most fundamental first."""
    cost, optimality, passes = checked.cost, checked.optimality, checked.passes
    tables = [use for use in checked.limits if use.kind == "table"]
    if tables and not (use := max(tables, key=lambda use: use.relative)).relative <= passes.excess:
        sentence = (
            f"table {_component(use.name, use.component)} is read at {use.value:.6g}, outside of "
            f"its grid, which ends at {use.limit:.6g}, in phase {use.phase!r} at {use.time:.4g} s"
        )
        yield Failure(Status.OUTSIDE_TABLE, sentence)
    if not cost.error <= passes.cost:
        sentence = f"the cost is {cost.recomputed:.8g}, not the {cost.given:.8g} given"
        yield Failure(Status.FAILED, sentence)
    elif not cost.integration_error <= passes.state_error:
        sentence = f"the integrated cost is {cost.integrated:.8g}, the given one"
        yield Failure(Status.TOO_COARSE, f"{sentence} {cost.given:.8g}")
    for check in checked.resimulations:
        start = f"re-simulation of phase {check.phase!r}"
        if not check.status.solved:
            yield Failure(Status.TOO_COARSE, f"{start} stopped: {check.failure}")
        elif not check.error <= passes.state_error:
            sentence = (
                f"{start} has {_component(check.state, check.component)} = {check.value:.6g} "
                f"{check.unit} instead of {check.wanted:.6g} at {check.time:.4g} s, after one "
                f"interval: an error of {check.local_error:.2g} relative to its size; the "
                f"errors of all intervals amount to {check.error:.2g}"
            )
            yield Failure(Status.TOO_COARSE, sentence)
    for use in checked.limits:
        if use.kind != "table" and not use.relative <= passes.excess:
            sentence = (
                f"{use.kind} {_component(use.name, use.component)} of phase {use.phase!r} is "
                f"{use.value:.6g} {use.unit} at {use.time:.4g} s, {use.excess:.3g} beyond its "
                f"limit of {use.limit:.6g}"
            )
            yield Failure(Status.TOO_COARSE, sentence)
    if not optimality.gap.total <= passes.gap * cost_size(cost.size, cost_scale):
        above = f"may be {optimality.gap.total:.2g} above that of the local optimum"
        yield Failure(Status.GAP_LEFT, f"the cost of {cost.recomputed:.8g} {above}")
    for name, template in RESIDUALS.items():
        residual: Residual = getattr(optimality, name)
        if not residual.scaled <= getattr(passes, name):
            amount = f"{residual.value:.3g} {residual.unit}"
            yield Failure(Status.GAP_LEFT, template.format(residual.where, amount))


def _component(name: str, component: int) -> str:
    return f"{name}[{component}]" if component else name


def verify(
    problem: OptimalControlProblem | Transcription,
    solution: Solution,
    *,
    thresholds: Thresholds | None = None,
) -> OCPCertificate:
    """Check a solution independently of the solver that made it.

    The declared expressions are evaluated again, with the limits, conditions and parameters of the
    solve; the program and its derivatives are not used, except for the curvature. A solution that
    passes is one that :func:`~microbot_ocp.ocp.solve` calls solved.

    Parameters
    ----------
    problem : OptimalControlProblem or Transcription
        The problem that was solved.
    solution : Solution
    thresholds : Thresholds, optional

    Returns
    -------
    OCPCertificate
        The conditions of first and second order hold at every local optimum, not only at the best
        one.

    Raises
    ------
    InputError
        The solution is of another problem, or was not made by a solve.

    Examples
    --------
    >>> from microbot_ocp.ocp import solve
    >>> problem = OptimalControlProblem("double integrator")
    >>> phase = problem.phase("move", duration=(0.1, 10.0))
    >>> x = phase.state("x", initial=0.0, final=1.0, unit="m")
    >>> v = phase.state("v", initial=0.0, final=0.0, unit="m/s")
    >>> u = phase.control("u", lower=-1.0, upper=1.0, unit="m/s^2")
    >>> phase.derivative(x, v)
    >>> phase.derivative(v, u)
    >>> phase.end_cost(phase.duration)
    >>> certificate = verify(problem, solve(problem, mesh=20))
    >>> certificate.ok, round(certificate.hamiltonian("move").mean, 3)
    (True, -1.0)
    >>> [(arc.name, arc.side, round(arc.end, 3)) for arc in certificate.arcs]
    [('u', 'upper', 1.0), ('u', 'lower', 2.0)]
    """
    started = time.perf_counter()
    judged = judge(problem, solution, thresholds)
    point, pairs = judged.point, list(zip(judged.phases, judged.derivatives, strict=True))
    costates = tuple(costates_of(phase, part, point.lam_g) for phase, part in pairs)
    hamiltonians = tuple(hamiltonian_of(phase, part, point.lam_x) for phase, part in pairs)
    # An arc with a price within the allowed gap is dropped.
    worth = judged.passes.gap * cost_size(solution.cost, solution.cost_scale)
    arcs = tuple(arcs_of(judged.dense, point, worth))
    failures = [failure.sentence for failure in judged.failures]
    coarse = any(failure.status is Status.TOO_COARSE for failure in judged.failures)
    if coarse and (solution.solved or solution.status is Status.TOO_COARSE):
        failures.append("the mesh is too coarse: solve(problem, accuracy=1e-6) refines it")
    declared = problem.problem if isinstance(problem, Transcription) else problem
    has_cost = any(phase.has_cost for phase in declared.phases)
    sentences = failures or _summary(judged, hamiltonians, len(arcs), has_cost)
    return OCPCertificate(
        problem=declared.name,
        ok=not failures,
        verdict=("Failed: " if failures else "Passed: ") + "; ".join(sentences) + ".",
        cost=judged.cost,
        resimulations=judged.resimulations,
        limits=judged.limits,
        optimality=judged.optimality,
        curvature=judged.curvature,
        costates=costates,
        hamiltonians=hamiltonians,
        arcs=arcs,
        thresholds=judged.passes,
        wall_time=time.perf_counter() - started,
    )


def _summary(
    judged: Judgement, hamiltonians: Sequence[Hamiltonian], arcs: int, has_cost: bool
) -> list[str]:
    """Return the sentences of the verdict on a solution that passed."""
    optimality = judged.optimality
    worst = max((use.relative for use in judged.limits), default=0.0)
    kept = worst <= judged.passes.feasibility
    limits_kept = "is kept" if kept else f"is kept to within {100 * worst:.2g} %"
    growth = growth_said(max(check.amplification for check in judged.resimulations))
    error = max(check.error for check in judged.resimulations)
    sentences = [
        f"first-order conditions hold to {optimality.stationarity.scaled:.1e} (stationarity) and "
        f"{optimality.complementarity.scaled:.1e} (complementarity), and the second-order one of a "
        "minimum",
        f"the cost is at most {optimality.gap.total:.1e} above that of the local optimum"
        if has_cost
        else "no cost is declared, so every solution within the constraints is optimal",
        f"re-simulation by intervals misses the states by a relative error of {error:.2g} (over "
        f"the phase, errors grow up to {growth})",
        f"every limit {limits_kept} between mesh points",
    ]
    for along in hamiltonians:
        if along.autonomous:
            due = "" if along.expected is None else f" (expected {along.expected:.4g})"
            sentences.append(
                f"Hamiltonian of phase {along.phase!r} {along.mean:.4g}{due} with a drift of "
                f"{along.drift:.1e}"
            )
    return [*sentences, f"{arcs} arc{'' if arcs == 1 else 's'} on limits"]
