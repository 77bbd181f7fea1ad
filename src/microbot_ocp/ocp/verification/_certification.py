"""Certificate of a solution: everything that is checked, in one call."""

from __future__ import annotations

import time

import numpy as np

from microbot_ocp._base.status import Status
from microbot_ocp.ocp.problem import OptimalControlProblem
from microbot_ocp.ocp.solution import Solution
from microbot_ocp.ocp.transcription import Transcription
from microbot_ocp.ocp.verification._certificate import OCPCertificate, Thresholds
from microbot_ocp.ocp.verification._hamiltonian import costates_of, hamiltonian_of
from microbot_ocp.ocp.verification._judgement import judge
from microbot_ocp.ocp.verification._messages import summary_of
from microbot_ocp.ocp.verification._switching import THRESHOLDS, Prices, arcs_of


def verify(
    problem: OptimalControlProblem | Transcription,
    solution: Solution,
    *,
    thresholds: Thresholds | None = None,
) -> OCPCertificate:
    """Check a solution independently of what made it.

    The declared expressions are evaluated again, with limits, conditions and parameters as they
    were solved with; neither the program nor the derivatives that the solver had are used, but for
    the curvature. What passes here is what :func:`~microbot_ocp.ocp.solve` calls solved.

    Parameters
    ----------
    problem : OptimalControlProblem or Transcription
        What was solved.
    solution : Solution
    thresholds : Thresholds, optional

    Returns
    -------
    OCPCertificate
        Conditions of the first and second order make no difference between a local optimum and the
        best one.

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
    own = judge(problem, solution, thresholds)
    lam_x, lam_g = own.multipliers
    costates = tuple(
        costates_of(phase, part, lam_g)
        for phase, part in zip(own.phases, own.derivatives, strict=True)
    )
    hamiltonians = tuple(
        hamiltonian_of(phase, part, lam_x)
        for phase, part in zip(own.phases, own.derivatives, strict=True)
    )
    prices = Prices(own.layouts, own.labels, np.concatenate([lam_x, lam_g]))
    worth = THRESHOLDS.worthless * max(abs(solution.cost), 1e-6)
    arcs = tuple(arc for dense in own.dense for arc in arcs_of(dense, prices, worth))
    checks = own.resimulations, own.limits, own.optimality
    failures = [failure.sentence for failure in own.failures]
    coarse = any(failure.status is Status.TOO_COARSE for failure in own.failures)
    if coarse and (solution.solved or solution.status is Status.TOO_COARSE):
        failures.append("the mesh is too coarse: solve(problem, accuracy=1e-6) refines it")
    declared = problem.problem if isinstance(problem, Transcription) else problem
    has_cost = any(phase.has_cost for phase in declared.phases)
    sentences = failures or summary_of(*checks, hamiltonians, arcs, has_cost)
    return OCPCertificate(
        problem=declared.name,
        ok=not failures,
        verdict=("Failed: " if failures else "Passed: ") + "; ".join(sentences) + ".",
        cost=own.cost,
        resimulations=own.resimulations,
        limits=own.limits,
        optimality=own.optimality,
        curvature=own.curvature,
        costates=costates,
        hamiltonians=hamiltonians,
        arcs=arcs,
        thresholds=thresholds or Thresholds(),
        wall_time=time.perf_counter() - started,
    )
