"""How a solve ended: by what the solver reports, and by the point that it returns."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.status import Status
from microbot_ocp.ocp.solvers._settings import SolverSettings
from microbot_ocp.ocp.transcription import Program

FEASIBLE = 1e-4  # largest violation, scaled, at which a solver's success is believed


def status_of(
    name: str, stats: Mapping[str, Any], settings: SolverSettings, infeasibility: float
) -> Status:
    """Return the status from the statistics of a solver and the violation at its point."""
    message = str(stats.get("return_status", ""))
    limit = settings.options.get(name, {}).get("max_iter", settings.max_iterations)
    if "Time" in message:  # Maximum_WallTime_Exceeded, Maximum_CpuTime_Exceeded
        return Status.TIME_LIMIT
    if "Acceptable" in message:
        return Status.FAILED
    if stats.get("success"):  # fatrop reports it even of points that are not finite
        return Status.SOLVED if infeasibility <= FEASIBLE else Status.FAILED
    if stats.get("unified_return_status") == "SOLVER_RET_LIMITED" or "Maximum" in message:
        return Status.ITERATION_LIMIT
    if name == "fatrop" and stats.get("iter_count", -1) >= limit:  # it reports no reason
        return Status.ITERATION_LIMIT
    if "Infeasible" in message or "Restoration" in message:
        return Status.INFEASIBLE
    if "User" in message:
        return Status.INTERRUPTED
    return Status.FAILED


def stats_of(solver: ca.Function) -> Mapping[str, Any]:
    """Return statistics of a solver; empty where it has none."""
    try:
        return solver.stats()
    except RuntimeError:  # the SQP method's, where its quadratic program had no answer
        return {}


def first_cause(problem: BaseException) -> str:
    """Return the innermost line of an error of CasADi, without the places in its source."""
    lines = [line.strip() for line in str(problem).splitlines() if line.strip()]
    rest = [line for line in lines if not line.startswith("Error in ")] or lines or [repr(problem)]
    return re.sub(r"^\S+\.\w+:\d+: | (at: /|\[\.\.\./).*$", "", rest[-1])


def checked(program: Program, x: FloatArray) -> tuple[float, float]:
    """Return the cost and largest violation of a bound or row at x, independent of what the solver
    reports.
    """
    cost = float(program.functions["gradient"](x, program.parameters)[0])
    worst = float(program.violations(x, program.row_values(x)).max())
    return cost, worst if np.isfinite(cost) else np.inf
