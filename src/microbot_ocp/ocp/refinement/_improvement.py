"""A solution with controls that are better by Pontryagin's condition, solved again from there.

Steps of a solver stay in the valley that its point stands in, in every control at every point. The
costates tell which valley is the lower one; a solve from there, which begins near its bounds so as
to stay, is kept where it costs less.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from microbot_ocp.ocp import verification
from microbot_ocp.ocp.solution import Attempt, Solution, cost_size
from microbot_ocp.ocp.solvers import SolveContext
from microbot_ocp.ocp.starts import guess_from
from microbot_ocp.ocp.transcription import Guess


@dataclass(frozen=True)
class Improvement:
    """When controls with a smaller Hamiltonian are worth a solve.

    Attributes
    ----------
    worth : share of the cost: less than this is not looked for
    least_gain : share of what is to be saved that has to be: where controls chatter little of
        it is
    solves : most solves
    barrier : parameter at which they begin: near the bounds, so as to stay
    iterations : of a solve
    """

    worth: float = 1e-5
    least_gain: float = 0.2
    solves: int = 6
    barrier: float = 1e-6
    iterations: int = 200


IMPROVEMENT = Improvement()

WAY = "from controls with a smaller Hamiltonian"


def improvable(solution: Solution) -> float:
    """Return what better controls would save, to first order, relative to the cost."""
    gain, _ = verification.better_controls(solution)
    return gain / cost_size(solution.cost, solution.cost_scale)


def improved(solution: Solution, context: SolveContext) -> tuple[Solution, list[Attempt]]:
    """Return the solution, or one on its mesh that costs less, and what was tried."""
    attempts: list[Attempt] = []
    most = min(context.settings.max_iterations, IMPROVEMENT.iterations)
    how = {"solver": "ipopt", "initial_barrier": IMPROVEMENT.barrier, "max_iterations": most}
    for _ in range(IMPROVEMENT.solves):
        gain, controls = verification.better_controls(solution)
        size = cost_size(solution.cost, solution.cost_scale)
        if not gain > IMPROVEMENT.worth * size or context.over:
            break
        guess = {
            name: Guess(old.duration, {**old.values, **controls.get(name, {})})
            for name, old in guess_from(context.transcription.problem, solution).items()
        }
        tried = context.solve([phase.mesh for phase in solution.phases], guess, **how)
        attempts += [replace(a, way=WAY) for a in tried.attempts]
        if not (tried.status.solved and tried.cost < solution.cost - IMPROVEMENT.least_gain * gain):
            break
        solution = tried.with_rivals_of(solution)
    return solution, attempts
