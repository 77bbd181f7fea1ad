"""Certificate of a solution: everything that is checked, in one call."""

from __future__ import annotations

import time

import numpy as np

from microbot_ocp._base.checks import InputError
from microbot_ocp.ocp.problem import OptimalControlProblem
from microbot_ocp.ocp.solution import Solution, unpack
from microbot_ocp.ocp.transcription import (
    Transcription,
    bounds_of,
    row_labels,
    variable_labels,
)
from microbot_ocp.ocp.verification._certificate import OCPCertificate, Thresholds
from microbot_ocp.ocp.verification._costates import costates_of
from microbot_ocp.ocp.verification._declared import as_declared, scaled_variables
from microbot_ocp.ocp.verification._hamiltonian import hamiltonian_of
from microbot_ocp.ocp.verification._limits import dense_phase, limit_uses
from microbot_ocp.ocp.verification._messages import judged, problems_of, summary_of
from microbot_ocp.ocp.verification._recomputation import (
    Recomputation,
    check_cost,
    missed_conditions,
    scaled_rows,
)
from microbot_ocp.ocp.verification._reintegration import each_interval, phase_layout
from microbot_ocp.ocp.verification._resimulation import resimulate
from microbot_ocp.ocp.verification._stationarity import (
    bound_multipliers,
    differentiate,
    lagrangian_gradient,
    optimality_of,
)
from microbot_ocp.ocp.verification._switching import WORTHLESS, Prices, arcs_of


def verify(
    problem: OptimalControlProblem | Transcription,
    solution: Solution,
    *,
    thresholds: Thresholds | None = None,
) -> OCPCertificate:
    """Check a solution independently of what made it.

    The declared expressions are evaluated again, with limits, conditions and parameters as they
    were solved with; neither the program nor the derivatives that the solver had are used.

    Parameters
    ----------
    problem : OptimalControlProblem or Transcription
        What was solved.
    solution : Solution
    thresholds : Thresholds, optional

    Returns
    -------
    OCPCertificate
        First-order conditions make no difference between a local optimum and the best one.

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
    limits_of = thresholds or Thresholds()
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
    parts = [differentiate(phase, lam_g) for phase in phases]
    gradient = lagrangian_gradient(parts, lam_g)
    lam_x, computed = bound_multipliers(bounds, solution, gradient)
    optimality = optimality_of(
        labels, bounds, x, g, gradient, lam_g, lam_x, computed, solution.cost_scale
    )
    local = [each_interval(phase, cost=True) for phase in phases]
    resimulations = tuple(map(resimulate, phases, local))
    cost = check_cost(solution.cost, again, local)
    dense = [dense_phase(own.phase, own.interpolated) for own in again]
    uses = tuple(use for d in dense for use in limit_uses(d))
    costates = tuple(
        costates_of(phase, part, lam_g) for phase, part in zip(phases, parts, strict=True)
    )
    hamiltonians = tuple(
        hamiltonian_of(phase, part, lam_x) for phase, part in zip(phases, parts, strict=True)
    )
    prices = Prices(layouts, labels, np.concatenate([lam_x, lam_g]))
    worth = WORTHLESS * max(abs(solution.cost), 1e-6)
    arcs = tuple(arc for d in dense for arc in arcs_of(d, prices, worth))
    problems = [
        *problems_of(solution, unpack(layouts, x)),
        *missed_conditions(again, limits_of.feasibility),
        *judged(cost, resimulations, uses, optimality, limits_of, solution.cost_scale),
    ]
    has_cost = any(phase.has_cost for phase in declared.phases)
    said = problems or summary_of(resimulations, uses, optimality, hamiltonians, arcs, has_cost)
    return OCPCertificate(
        problem=declared.name,
        ok=not problems,
        verdict=("Failed: " if problems else "Passed: ") + "; ".join(said) + ".",
        cost=cost,
        resimulations=resimulations,
        limits=uses,
        optimality=optimality,
        costates=costates,
        hamiltonians=hamiltonians,
        arcs=arcs,
        thresholds=limits_of,
        wall_time=time.perf_counter() - started,
    )
