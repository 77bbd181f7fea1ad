"""What a solution has to pass to be solved: one judgement, of a certificate and of a solve alike.

The declared expressions are evaluated again, the dynamics integrated again interval by interval,
limits looked at between the mesh points, and the conditions of the first and second order judged at
the point itself. A solve goes on until nothing is missing here, or its status says what is.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.status import Status
from microbot_ocp.ocp.problem import OptimalControlProblem
from microbot_ocp.ocp.solution import PhaseSolution, Solution, cost_size, unpack
from microbot_ocp.ocp.transcription import (
    Label,
    PhaseLayout,
    Transcription,
    bounds_of,
    row_labels,
    variable_labels,
)
from microbot_ocp.ocp.verification._certificate import (
    CostCheck,
    Curvature,
    OCPLimitUse,
    Optimality,
    Residual,
    ResimulationCheck,
    Thresholds,
)
from microbot_ocp.ocp.verification._curvature import curvature_of
from microbot_ocp.ocp.verification._declared import as_declared, scaled_variables
from microbot_ocp.ocp.verification._limits import (
    DensePhase,
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
from microbot_ocp.ocp.verification._reintegration import (
    each_interval,
    interval_errors,
    phase_layout,
    resimulate,
)
from microbot_ocp.ocp.verification._stationarity import (
    Derivatives,
    bound_multipliers,
    differentiate,
    lagrangian_gradient,
    optimality_of,
)

JUDGED = (Status.TOO_COARSE, Status.SADDLE)  # by the same checks, which are made again
RESIDUALS = {
    "feasibility": "not feasible: {} is violated by {}",
    "stationarity": "not stationary: {} has a slope of {} left",
    "complementarity": "not complementary: {} has a multiplier away from its limit, worth {}",
    "sign": "multiplier of the wrong sign: {} with {}",
}
STALE = 1e-9  # relative difference between the values and the stages of a solution


@dataclass(frozen=True)
class Failure:
    """A check that did not pass: the status it stands for, and what is wrong."""

    status: Status
    sentence: str


@dataclass(frozen=True, eq=False)
class Judgement:
    """The checks of one solution.

    Attributes
    ----------
    failures : what did not pass, and the status that it stands for; none of a solution
    cost, resimulations, limits, optimality : as of a certificate
    curvature : second-order condition; None where other checks failed already
    errors : of every interval of a phase [N], by what it misses the next mesh state or the integral
        of the cost, as a share of what passes if all intervals miss as much
    excess : likewise by what it exceeds limits between its points, as a share of what passes
    passes : the thresholds
    phases, layouts, labels, derivatives, multipliers, dense : what they were made of
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
    layouts: tuple[PhaseLayout, ...]
    labels: tuple[Label, ...]
    derivatives: tuple[Derivatives, ...]
    multipliers: tuple[FloatArray, FloatArray]
    dense: tuple[DensePhase, ...]

    @property
    def state_errors(self) -> list[FloatArray]:
        """Relative errors of every interval of a phase [N]."""
        return [errors * (self.passes.state_error / errors.size) for errors in self.errors]

    @property
    def status(self) -> Status:
        """SOLVED where all passed, else what the first failure stands for."""
        return self.failures[0].status if self.failures else Status.SOLVED


def judge(
    problem: OptimalControlProblem | Transcription,
    solution: Solution,
    thresholds: Thresholds | None = None,
) -> Judgement:
    """Check a solution against everything that is asked of one.

    Raises
    ------
    InputError
        The solution is of another problem, or was not made by a solve.
    """
    passes = thresholds or Thresholds()
    declared = problem.problem if isinstance(problem, Transcription) else problem
    phases = as_declared(problem, solution)
    layouts = [phase_layout(phase) for phase in phases]
    bounds = bounds_of(layouts)
    labels = [*variable_labels(layouts), *row_labels(layouts)]
    lam_g = np.asarray(solution.row_multipliers, dtype=float)
    if lam_g.size != bounds.row_lower.size:
        raise InputError(
            f"the solution has {lam_g.size} row multipliers for {bounds.row_lower.size} rows of "
            f"problem {declared.name!r}"
        )
    x, again = scaled_variables(phases), [Recomputation(phase) for phase in phases]
    g = scaled_rows(declared, again)
    parts = tuple(differentiate(phase, lam_g) for phase in phases)
    gradient = lagrangian_gradient(parts, lam_g)
    lam_x, computed = bound_multipliers(bounds, solution, gradient)
    optimality = optimality_of(
        labels, bounds, x, g, gradient, lam_g, lam_x, computed, solution.cost_scale
    )
    local = [each_interval(phase, cost=True) for phase in phases]
    resimulations = tuple(map(resimulate, phases, local))
    cost = check_cost(solution.cost, again, local)
    dense = tuple(dense_phase(recomputed.phase, recomputed.interpolated) for recomputed in again)
    uses = tuple(use for d in dense for use in limit_uses(d))
    failures = [
        *_problems_of(solution, unpack(layouts, x)),
        *(Failure(Status.INFEASIBLE, k) for k in missed_conditions(again, passes.feasibility)),
        *_failures_of(cost, resimulations, uses, optimality, passes, solution.cost_scale),
    ]
    curvature = None
    if not failures:
        curvature = curvature_of(
            solution, bounds, x, g, np.concatenate([lam_x, lam_g]), passes.gap, cost.size
        )
        if not curvature.minimum:
            sentence = (
                "a saddle, not a minimum: where variables move by their scales along one direction "
                f"the cost curves downwards by {-curvature.least:.2g} of itself"
            )
            failures.append(Failure(Status.SADDLE, sentence))
    return Judgement(
        failures=tuple(failures),
        cost=cost,
        resimulations=resimulations,
        limits=uses,
        optimality=optimality,
        curvature=curvature,
        errors=tuple(
            interval_errors(phase, arrived, recomputed.costs, cost.size)
            / (passes.state_error / (phase.mesh.size - 1))
            for phase, recomputed, arrived in zip(phases, again, local, strict=True)
        ),
        excess=tuple(relative_excess(d).max(axis=1) / passes.excess for d in dense),
        passes=passes,
        phases=phases,
        layouts=tuple(layouts),
        labels=tuple(labels),
        derivatives=parts,
        multipliers=(lam_x, lam_g),
        dense=dense,
    )


# what did not pass --------------------------------------------------------------------------------


def _problems_of(solution: Solution, stages: Sequence[PhaseSolution]) -> list[Failure]:
    """Return what is wrong with a solution before anything is evaluated.

    ``stages`` are the phases as the stages of the program have them.
    """
    failures = []
    if not solution.status.solved and solution.status not in JUDGED:
        failures.append(Failure(solution.status, f"the solve did not converge: {solution.status}"))
    for phase, again in zip(solution.phases, stages, strict=True):
        for name, values in phase.values.items():
            size = max(1e-9, float(np.abs(again.values[name]).max()))
            if not np.abs(values - again.values[name]).max() <= STALE * size:
                sentence = (
                    f"the values of {name} in phase {phase.name!r} are not those of its stages"
                )
                failures.append(Failure(Status.FAILED, sentence))
    return failures


def _failures_of(
    cost: CostCheck,
    resimulations: Sequence[ResimulationCheck],
    uses: Sequence[OCPLimitUse],
    optimality: Optimality,
    passes: Thresholds,
    cost_scale: float,
) -> Iterator[Failure]:
    """Yield what did not pass; nothing where all did."""
    if not cost.error <= passes.cost:
        sentence = f"the cost is {cost.recomputed:.8g}, not the {cost.given:.8g} given"
        yield Failure(Status.FAILED, sentence)
    elif not cost.integration_error <= passes.state_error:
        sentence = f"the cost is {cost.integrated:.8g} when it is integrated again, not "
        yield Failure(Status.TOO_COARSE, f"{sentence}{cost.given:.8g}")
    for check in resimulations:
        start = f"re-simulation of phase {check.phase!r}"
        if not check.status.solved:
            yield Failure(Status.TOO_COARSE, f"{start} stopped: {check.failure}")
        elif not check.error <= passes.state_error:
            sentence = (
                f"{start} has {_component(check.state, check.component)} = {check.value:.6g} "
                f"{check.unit} instead of {check.wanted:.6g} at {check.time:.4g} s, after one "
                f"interval: an error of {check.local_error:.2g} of its size; those of all "
                f"intervals come to {check.error:.2g}"
            )
            yield Failure(Status.TOO_COARSE, sentence)
    for use in uses:
        if not use.relative <= passes.excess:
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
