"""Certificate of a solution: everything that is checked, in one call."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from microbot_ocp._base.growth import growth_said
from microbot_ocp._base.status import Status
from microbot_ocp.ocp.problem import OptimalControlProblem
from microbot_ocp.ocp.solution import Solution
from microbot_ocp.ocp.transcription import Transcription
from microbot_ocp.ocp.verification._certificate import Hamiltonian, OCPCertificate, Thresholds
from microbot_ocp.ocp.verification._hamiltonian import costates_of, hamiltonian_of
from microbot_ocp.ocp.verification._judgement import Judgement, judge
from microbot_ocp.ocp.verification._switching import THRESHOLDS, arcs_of


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
    judged = judge(problem, solution, thresholds)
    lam_x, lam_g = judged.multipliers
    costates = tuple(
        costates_of(phase, part, lam_g)
        for phase, part in zip(judged.phases, judged.derivatives, strict=True)
    )
    hamiltonians = tuple(
        hamiltonian_of(phase, part, lam_x)
        for phase, part in zip(judged.phases, judged.derivatives, strict=True)
    )
    worth = THRESHOLDS.worthless * max(abs(solution.cost), 1e-6)
    arcs = tuple(arcs_of(judged.dense, judged.labels, np.concatenate(judged.multipliers), worth))
    failures = [failure.sentence for failure in judged.failures]
    coarse = any(failure.status is Status.TOO_COARSE for failure in judged.failures)
    if coarse and (solution.solved or solution.status is Status.TOO_COARSE):
        failures.append("the mesh is too coarse: solve(problem, accuracy=1e-6) refines it")
    declared = problem.problem if isinstance(problem, Transcription) else problem
    sentences = failures or _summary(
        judged, hamiltonians, len(arcs), any(phase.has_cost for phase in declared.phases)
    )
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
        thresholds=thresholds or Thresholds(),
        wall_time=time.perf_counter() - started,
    )


def _summary(
    judged: Judgement, hamiltonians: Sequence[Hamiltonian], arcs: int, has_cost: bool
) -> list[str]:
    """Return what is to be said of a solution that passed."""
    optimality, worst = (
        judged.optimality,
        max((use.relative for use in judged.limits), default=0.0),
    )
    limits_kept = "is kept" if worst <= 1e-6 else f"is kept to within {100 * worst:.2g} %"
    growth = growth_said(max(check.amplification for check in judged.resimulations))
    error = max(check.error for check in judged.resimulations)
    sentences = [
        f"first-order conditions hold to {optimality.stationarity.scaled:.1e} (stationarity) and "
        f"{optimality.complementarity.scaled:.1e} (complementarity), and the second-order one of a "
        "minimum",
        f"the cost is at most {optimality.gap.total:.1e} above that of the local optimum"
        if has_cost
        else "no cost is declared, so any answer that keeps the constraints is as good",
        f"re-simulation by intervals stays within {error:.2g} of the states' size (errors grow up "
        f"to {growth})",
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
