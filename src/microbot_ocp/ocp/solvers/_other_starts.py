"""Whether other starts lead to a cheaper optimum than the one that was found.

A solver ends in the valley that its start lies in. Simulations with controls that are constant, or
change once, are other starts. They are compared on a coarse mesh, on which a solve takes a few
hundredths of a second, with what the answer itself becomes there.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from microbot_ocp.ocp.problem import OptimalControlProblem
from microbot_ocp.ocp.solution import (
    Attempt,
    Progress,
    Solution,
    cost_size,
    default_guess,
    rollouts,
)
from microbot_ocp.ocp.solvers._chain import solve_on
from microbot_ocp.ocp.solvers._settings import SolverSettings
from microbot_ocp.ocp.transcription import Guess, Meshes, Transcription

COARSE = 10  # intervals a phase
WORTH = 1e-3  # of the cost: less than this may be the mesh
ITERATIONS = 150
DURATIONS = (0.6, 2.0, 0.3, 4.0)  # times the usual ones, where they are free
EACH = 3  # simulations of these
WAY = "from another start"


def cheaper_elsewhere(
    solution: Solution,
    transcription: Transcription,
    settings: SolverSettings,
    most: int,
    until: float,
    progress: Progress | None,
) -> tuple[Solution, list[Attempt]]:
    """The solution, or a cheaper one on its mesh that one of ``most`` other starts leads to.

    With what was tried, where something was found.
    """
    here = _solved(transcription, COARSE, solution, settings, until, progress)
    if not here.status.solved:
        return solution, []
    worth = WORTH * cost_size(solution.cost, solution.cost_scale)
    least, attempts = cheapest_of_starts(transcription, settings, most, until, progress)
    if least is None or not least.cost < here.cost - worth:
        return solution, []
    meshes = [phase.mesh for phase in solution.phases]
    own = replace(settings, solver="ipopt", max_iterations=ITERATIONS)
    finer = solve_on(transcription, meshes, least, own, until, progress)
    if finer.status.solved and finer.cost < solution.cost - worth:
        return finer, [*attempts, *(replace(a, way=WAY) for a in finer.attempts)]
    return solution, []


def cheapest_of_starts(
    transcription: Transcription,
    settings: SolverSettings,
    most: int,
    until: float,
    progress: Progress | None,
) -> tuple[Solution | None, list[Attempt]]:
    """The cheapest answer on a coarse mesh that any of ``most`` simulations leads to."""
    least: Solution | None = None
    attempts: list[Attempt] = []
    for start in _starts(transcription.problem, most):
        if time.perf_counter() >= until:
            break
        found = _solved(transcription, COARSE, start, settings, until, progress)
        attempts += [replace(a, way=WAY) for a in found.attempts]
        if found.status.solved and (least is None or found.cost < least.cost):
            least = found
    return least, attempts


def _starts(problem: OptimalControlProblem, most: int) -> list[dict[str, Guess]]:
    ordinary = default_guess(problem)
    found = rollouts(problem, ordinary, steps=most > EACH)
    if all(low == high for low, high in (p.duration_bounds for p in problem.phases)):
        return found[:most]
    found = found[: max(1, most // 2)]
    for factor in DURATIONS:
        if len(found) >= most:
            break
        durations = {
            p.name: float(np.clip(factor * (ordinary[p.name].duration or 1.0), *p.duration_bounds))
            for p in problem.phases
        }
        found += rollouts(problem, ordinary, durations, steps=True)[:EACH]
    return found[:most]


def _solved(
    transcription: Transcription,
    mesh: Meshes,
    guess: dict[str, Guess] | Solution,
    settings: SolverSettings,
    until: float,
    progress: Progress | None,
) -> Solution:
    rough = replace(
        settings,
        solver="ipopt",
        gap=np.inf,
        max_iterations=min(settings.max_iterations, ITERATIONS),
    )
    return solve_on(transcription, mesh, guess, rough, until, progress)
