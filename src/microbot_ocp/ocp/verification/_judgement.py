"""What a solution has to pass to be solved: one judgement, of a certificate and of a solve alike.

The declared expressions are evaluated again, the dynamics integrated again interval by interval,
limits looked at between the mesh points, and the conditions of the first and second order judged at
the point itself. A solve goes on until nothing is missing here, or its status says what is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.status import Status
from microbot_ocp.ocp.problem import OptimalControlProblem
from microbot_ocp.ocp.solution import PhaseSolution, Solution, unpack
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
from microbot_ocp.ocp.verification._messages import Failure, curved, judged, problems_of
from microbot_ocp.ocp.verification._recomputation import (
    Recomputation,
    check_cost,
    missed_conditions,
    scaled_rows,
)
from microbot_ocp.ocp.verification._reintegration import (
    each_interval,
    mesh_states,
    phase_layout,
    resimulate,
    state_weights,
)
from microbot_ocp.ocp.verification._stationarity import (
    Derivatives,
    bound_multipliers,
    differentiate,
    lagrangian_gradient,
    optimality_of,
)


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
        return [own * (self.passes.state_error / own.size) for own in self.errors]

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
    dense = tuple(dense_phase(own.phase, own.interpolated) for own in again)
    uses = tuple(use for d in dense for use in limit_uses(d))
    failures = [
        *problems_of(solution, unpack(layouts, x)),
        *(Failure(Status.INFEASIBLE, k) for k in missed_conditions(again, passes.feasibility)),
        *judged(cost, resimulations, uses, optimality, passes, solution.cost_scale),
    ]
    errors = []
    for phase, own, arrived in zip(phases, again, local, strict=True):
        missed = np.abs(arrived.states - mesh_states(phase)[1:]) / state_weights(phase)
        share = np.abs(arrived.costs - own.costs[: missed.shape[0]]) / cost.size
        allowed = passes.state_error / missed.shape[0]
        errors.append(np.nan_to_num(np.maximum(missed.max(axis=1), share) / allowed, nan=np.inf))
    curvature = None
    if not failures:
        curvature = curvature_of(
            solution, bounds, x, g, np.concatenate([lam_x, lam_g]), passes.gap, cost.size
        )
        failures += curved(curvature)
    return Judgement(
        failures=tuple(failures),
        cost=cost,
        resimulations=resimulations,
        limits=uses,
        optimality=optimality,
        curvature=curvature,
        errors=tuple(errors),
        excess=tuple(relative_excess(d).max(axis=1) / passes.excess for d in dense),
        passes=passes,
        phases=phases,
        layouts=tuple(layouts),
        labels=tuple(labels),
        derivatives=parts,
        multipliers=(lam_x, lam_g),
        dense=dense,
    )
