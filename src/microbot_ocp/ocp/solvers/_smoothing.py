"""A first solve in which large controls cost, and less and less so: a start for the problem itself.

Where the cost grows no faster than in proportion to a control, a discretised problem may prefer one
enormous value on a single interval to the curve that it stands for, or have no optimum at all. With
a quadratic cost of the controls it has one, near which the problem itself is solved.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import replace

import casadi as ca
import numpy as np

from microbot_ocp.ocp.problem import OptimalControlProblem
from microbot_ocp.ocp.solution import Attempt, Progress, Solution, cost_change, starting_point
from microbot_ocp.ocp.solvers._chain import solve_on
from microbot_ocp.ocp.solvers._settings import SolverSettings
from microbot_ocp.ocp.transcription import Guess, Meshes, Transcription, assemble

WEIGHTS = (1e-2, 1e-3, 1e-4)  # shares of the size of the cost, for controls of their own size
ITERATIONS = 300


def smoothed(
    transcription: Transcription,
    mesh: Meshes,
    guess: Mapping[str, Guess] | Solution | str | None,
    settings: SolverSettings,
    until: float,
    progress: Progress | None,
) -> tuple[Solution | None, list[Attempt]]:
    """The last such solution that converged, None where the first does not; and what was tried."""
    problem = transcription.problem
    program = assemble(transcription.layouts(mesh))
    size = cost_change(program, starting_point(program, problem, guess).x)
    own = replace(settings, gap=np.inf, max_iterations=min(settings.max_iterations, ITERATIONS))
    found: Solution | None = None
    attempts: list[Attempt] = []
    for weight in WEIGHTS:
        costly = Transcription(_with_cost(problem, weight * size), scheme=transcription.scheme)
        start = guess if found is None else found
        made = solve_on(costly, mesh, start, own, until, progress)
        attempts += made.attempts
        if not made.status.solved:
            break
        found = made
    return found, attempts


def _with_cost(problem: OptimalControlProblem, weight: float) -> OptimalControlProblem:
    """The problem with a cost of the mean square of its controls, each relative to its size."""
    made = copy.copy(problem)
    made.phases = [copy.copy(phase) for phase in problem.phases]
    for phase in made.phases:
        cost = ca.MX(0)
        for control in phase.controls:
            both = np.isfinite(control.lower) & np.isfinite(control.upper)
            low, high = (np.where(both, side, 0.0) for side in (control.lower, control.upper))
            size = np.where(both, (high - low) / 2, control.scale)
            cost += ca.sumsqr((control.symbol - (low + high) / 2) / size)
        phase.running_costs = [*phase.running_costs, weight * cost / phase.duration]
    return made
