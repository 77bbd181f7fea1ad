"""The verdict in sentences."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from microbot_ocp._base.growth import growth_said
from microbot_ocp._base.status import Status
from microbot_ocp.ocp.solution import PhaseSolution, Solution, cost_size
from microbot_ocp.ocp.verification._certificate import (
    Arc,
    CostCheck,
    Curvature,
    Hamiltonian,
    OCPLimitUse,
    Optimality,
    ResimulationCheck,
    Thresholds,
)

JUDGED = (Status.TOO_COARSE, Status.SADDLE)  # by the same checks, which are made again
STALE = 1e-9  # relative difference between the values and the stages of a solution


@dataclass(frozen=True)
class Failure:
    """A check that did not pass: the status it stands for, and what is wrong."""

    status: Status
    sentence: str


def problems_of(solution: Solution, stages: Sequence[PhaseSolution]) -> list[Failure]:
    """What is wrong with a solution before anything is evaluated.

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


def judged(
    cost: CostCheck,
    resimulations: Sequence[ResimulationCheck],
    uses: Sequence[OCPLimitUse],
    optimality: Optimality,
    passes: Thresholds,
    cost_scale: float,
) -> Iterator[Failure]:
    """What did not pass; nothing where all did."""
    if not cost.error <= passes.cost:
        sentence = f"the cost is {cost.recomputed:.8g}, not the {cost.given:.8g} given"
        yield Failure(Status.FAILED, sentence)
    elif not cost.integration_error <= passes.state_error:
        sentence = (
            f"the cost is {cost.integrated:.8g} when it is integrated again, not {cost.given:.8g}"
        )
        yield Failure(Status.TOO_COARSE, sentence)
    for check in resimulations:
        where = f"phase {check.phase!r}"
        if not check.status.solved:
            yield Failure(Status.TOO_COARSE, f"re-simulation of {where} stopped: {check.failure}")
        elif not check.error <= passes.state_error:
            sentence = (
                f"re-simulation of {where} has {_component(check.state, check.component)} = "
                f"{check.value:.6g} {check.unit} instead of {check.wanted:.6g} at "
                f"{check.time:.4g} s, after one interval: an error of {check.local_error:.2g} of "
                f"its size; those of all intervals come to {check.error:.2g}"
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
        sentence = (
            f"the cost of {cost.recomputed:.8g} may be {optimality.gap.total:.2g} above that of "
            "the local optimum"
        )
        yield Failure(Status.GAP_LEFT, sentence)
    for residual, limit, template in (
        (optimality.feasibility, passes.feasibility, "not feasible: {} is violated by {}"),
        (optimality.stationarity, passes.stationarity, "not stationary: {} has a slope of {} left"),
        (
            optimality.complementarity,
            passes.complementarity,
            "not complementary: {} has a multiplier away from its limit, worth {}",
        ),
        (optimality.sign, passes.sign, "multiplier of the wrong sign: {} with {}"),
    ):
        if not residual.scaled <= limit:
            amount = f"{residual.value:.3g} {residual.unit}"
            yield Failure(Status.GAP_LEFT, template.format(residual.where, amount))


def curved(curvature: Curvature) -> Iterator[Failure]:
    """What the second order says of a point that passed all else."""
    if not curvature.minimum:
        yield Failure(
            Status.SADDLE,
            "a saddle, not a minimum: where variables move by their scales along one direction the "
            f"cost curves downwards by {-curvature.least:.2g} of itself",
        )


def _component(name: str, component: int) -> str:
    return f"{name}[{component}]" if component else name


def summary_of(
    resimulations: Sequence[ResimulationCheck],
    uses: Sequence[OCPLimitUse],
    optimality: Optimality,
    hamiltonians: Sequence[Hamiltonian],
    arcs: Sequence[Arc],
    has_cost: bool,
) -> list[str]:
    """What was found of a solution that passed."""
    error = max(check.error for check in resimulations)
    worst = max((use.relative for use in uses), default=0.0)
    limits_kept = "is kept" if worst <= 1e-6 else f"is kept to within {100 * worst:.2g} %"
    sentences = [
        f"first-order conditions hold to {optimality.stationarity.scaled:.1e} (stationarity) and "
        f"{optimality.complementarity.scaled:.1e} (complementarity), and the second-order one of a "
        "minimum",
        f"the cost is at most {optimality.gap.total:.1e} above that of the local optimum"
        if has_cost
        else "no cost is declared, so any answer that keeps the constraints is as good",
        f"re-simulation by intervals stays within {error:.2g} of the states' size (errors grow up "
        f"to {growth_said(max(check.amplification for check in resimulations))})",
        f"every limit {limits_kept} between mesh points",
    ]
    for own in hamiltonians:
        if own.autonomous:
            due = "" if own.expected is None else f" (expected {own.expected:.4g})"
            sentences.append(
                f"Hamiltonian of phase {own.phase!r} {own.mean:.4g}{due} with a drift of "
                f"{own.drift:.1e}"
            )
    count = len(arcs)
    sentences.append(f"{count} arc{'' if count == 1 else 's'} on limits")
    return sentences
