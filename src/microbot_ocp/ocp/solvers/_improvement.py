"""A solution with controls that are better by Pontryagin's condition, solved again from there.

Steps of a solver stay in the valley that its point stands in, in every control at every point. The
costates tell which valley is the lower one; a solve from there, which begins near its bounds so as
to stay, is kept where it costs less.
"""

from __future__ import annotations

import time
from dataclasses import replace

from microbot_ocp.ocp import verification
from microbot_ocp.ocp.solution import Attempt, Progress, Solution, cost_size, guess_from
from microbot_ocp.ocp.solvers._chain import solve_on
from microbot_ocp.ocp.solvers._settings import SolverSettings
from microbot_ocp.ocp.transcription import Guess, Transcription

WORTH = 1e-5  # of the cost: less than this is not looked for
LESS = 0.2  # of what is to be saved, that has to be: where controls chatter little of it is
MOST = 6  # solves
BARRIER = 1e-6
ITERATIONS = 200
WAY = "from controls with a smaller Hamiltonian"


def improvable(solution: Solution) -> float:
    """What better controls would save, to first order, relative to the cost."""
    gain, _ = verification.better_controls(solution)
    return gain / cost_size(solution.cost, solution.cost_scale)


def improved(
    solution: Solution,
    transcription: Transcription,
    settings: SolverSettings,
    until: float,
    progress: Progress | None,
) -> tuple[Solution, list[Attempt]]:
    """The solution, or one on its mesh that costs less, and what was tried."""
    attempts: list[Attempt] = []
    own = replace(
        settings,
        solver="ipopt",
        initial_barrier=BARRIER,
        max_iterations=min(settings.max_iterations, ITERATIONS),
    )
    for _ in range(MOST):
        gain, controls = verification.better_controls(solution)
        size = cost_size(solution.cost, solution.cost_scale)
        if not gain > WORTH * size or time.perf_counter() >= until:
            break
        guess = {
            name: Guess(old.duration, {**old.values, **controls.get(name, {})})
            for name, old in guess_from(transcription.problem, solution).items()
        }
        meshes = [phase.mesh for phase in solution.phases]
        tried = solve_on(transcription, meshes, guess, own, until, progress)
        attempts += [replace(a, way=WAY) for a in tried.attempts]
        if not (tried.status.solved and tried.cost < solution.cost - LESS * gain):
            break
        solution = tried.with_rivals_of(solution)
    return solution, attempts
