"""A solve goes on until its answer is as near the optimum as wanted, and keeps its rows and bounds.

Solvers stop at a barrier parameter that belongs to their tolerance, whatever that costs: on a flat
problem with many limits much more than the tolerance. The gap tells how much, and the solve goes on
from there with the barrier that the wanted gap asks for. IPOPT's tolerance is of rows divided by
their slopes, too, and it moves bounds by a share of their size: what it calls solved may miss a row
or bound of the program by a thousand times the tolerance.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base.status import Status
from microbot_ocp.ocp.solution import UNKNOWN, Attempt, Gap, cost_size, gap_of
from microbot_ocp.ocp.solvers._plugins import WARM_PUSHES
from microbot_ocp.ocp.solvers._run import Runner, SolverOutcome
from microbot_ocp.ocp.solvers._settings import SolverSettings
from microbot_ocp.ocp.transcription import Program
from microbot_ocp.ocp.verification import Thresholds


@dataclass(frozen=True)
class Tightening:
    """How far a barrier is lowered for a small gap.

    Attributes
    ----------
    ratio : of the wanted gap that the barrier may take
    least_barrier : parameter below which no solver gets
    """

    ratio: float = 0.5
    least_barrier: float = 1e-15


TIGHTENING = Tightening()

# Tolerance of every further solve and its options. The second moves what the first cannot: IPOPT
# exceeds bounds by 1e-8 of their size unless it is told not to, which takes a larger barrier.
FURTHER: tuple[tuple[float, dict[str, float]], ...] = (
    (1e-8, {}),
    (1e-10, {"bound_relax_factor": 1e-10, "mu_init": 1e-6}),
)


def gap_at(program: Program, outcome: SolverOutcome) -> Gap:
    """Return the gap of what a solver left; not a number where it is none."""
    x, lam_g, lam_x = outcome.point.x, *outcome.point.multipliers
    if not all(np.isfinite(k).all() for k in (x, lam_g, lam_x)):
        return UNKNOWN
    rows, jacobian = program.functions["jacobian"](x, program.parameters)
    _, slope = program.functions["gradient"](x, program.parameters)
    slope = np.array(slope + ca.mtimes(jacobian.T, ca.DM(lam_g))).ravel() + lam_x
    return gap_of(program, x, np.array(rows).ravel(), slope, np.concatenate([lam_x, lam_g]))


def wanted_gap(program: Program, settings: SolverSettings, cost: float) -> float:
    """Return the gap that the settings allow, in the unit of the cost."""
    return settings.gap * cost_size(cost, program.cost_scale)


def tightened(runner: Runner, outcome: SolverOutcome) -> tuple[SolverOutcome, Gap, list[Attempt]]:
    """Return an outcome as near its optimum as wanted, its gap, and the further attempts that it
    took.

    What did not converge stays as it is. Where the gap stays larger than wanted, that is the status
    of the last attempt. Where no gap is wanted no more is done.
    """
    if outcome.attempt.status is not Status.SOLVED:
        return outcome, UNKNOWN, []
    program, settings = runner.program, runner.settings
    best, gap = outcome, gap_at(program, outcome)
    attempts: list[Attempt] = []
    wanted = wanted_gap(program, settings, best.attempt.cost)
    for tolerance, options in FURTHER:
        near = not gap.total > wanted and (wanted == np.inf or _keeps_all(best))
        if near or time.perf_counter() > runner.until:
            break
        tried = _further(runner, best, min(wanted, gap.slack), tolerance, options)
        attempts.append(tried.attempt)
        if tried.attempt.status is Status.INTERRUPTED:
            return tried, UNKNOWN, attempts
        gap_there = gap_at(program, tried)
        nearer = gap_there.total < gap.total or (gap_there.total <= wanted and not _keeps_all(best))
        allowed = max(settings.tolerance, best.attempt.infeasibility)
        if nearer and tried.attempt.infeasibility <= allowed:
            best = replace(tried, attempt=replace(tried.attempt, status=Status.SOLVED))
            gap, attempts[-1] = gap_there, best.attempt
        wanted = wanted_gap(program, settings, best.attempt.cost)
    if not gap.total <= wanted:
        message = f"at most {gap.total:.2g} above the optimum, {wanted:.2g} is wanted"
        left = replace(
            best.attempt, status=Status.GAP_LEFT, message=message, iterations=0, wall_time=0.0
        )
        return replace(best, attempt=left), gap, [*attempts, left]
    return best, gap, attempts


def _keeps_all(outcome: SolverOutcome) -> bool:
    """Return whether rows and bounds are kept to what passes."""
    return outcome.attempt.infeasibility <= Thresholds().feasibility


def _further(
    runner: Runner,
    before: SolverOutcome,
    slack: float,
    tolerance: float,
    options: Mapping[str, float],
) -> SolverOutcome:
    program, settings = runner.program, runner.settings
    ranges = program.lower < program.upper
    count = sum(int(np.sum(np.isfinite(k) & ranges)) for k in (program.lower, program.upper))
    barrier = max(
        TIGHTENING.ratio * slack / program.cost_scale / max(count, 1), TIGHTENING.least_barrier
    )
    closer: dict[str, Any] = {
        "compl_inf_tol": barrier,
        "constr_viol_tol": settings.tolerance,
        "mu_init": barrier,
        **dict.fromkeys(WARM_PUSHES, 1e-16),
        **options,
        **settings.options.get("ipopt", {}),
    }
    finer = replace(
        settings,
        solver="ipopt",
        tolerance=min(settings.tolerance, tolerance),
        initial_barrier=None,
        options={**settings.options, "ipopt": closer},
    )
    # not kept for other solves: it has the barrier of this one
    return replace(runner, settings=finer, solvers=None).run("ipopt", before.point, variant=True)
