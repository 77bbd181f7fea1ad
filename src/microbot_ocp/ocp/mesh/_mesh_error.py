"""State error of every interval by re-integration, and the pieces it has to be divided into.

The error of an interval is the difference between the next mesh state and what an adaptive
integrator arrives at from the interval's own mesh state with the solution's own control. A scheme
of order p makes local errors of order p + 1 in the step, which says into how many pieces an
interval has to be divided (Betts, *Practical Methods for Optimal Control*, 2nd ed., section 4.7;
the error there is a quadrature of the residual over the interval).

Theory: docs/theory/transcription.md, equation (5).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.ocp.solution import PhaseSolution, Solution, cost_size
from microbot_ocp.ocp.verification import Recomputation, each_interval, interval_errors


@dataclass(frozen=True)
class Division:
    """Into how many pieces an interval is divided.

    Attributes
    ----------
    most_pieces : at once: an error may be estimated badly
    safety : share of the accuracy that the divided intervals aim at
    """

    most_pieces: int = 6
    safety: float = 0.5


DIVISION = Division()


def state_errors(solution: Solution) -> list[FloatArray]:
    """Return relative state error of every interval: one array [N] a phase.

    ``max_i |x_i(t_k+1) - reached_i| / weight_i``, where reached is the integral of the dynamics
    from the mesh state at t_k and the weight is the largest magnitude of the state along the phase,
    or a hundredth of its scale if that is more. The running cost counts as one state more, whose
    weight is the size of the cost. Infinite where the integrator fails.
    """
    errors = []
    size = cost_size(solution.cost, solution.cost_scale)
    for phase in solution.phases:
        running = bool(phase.laid_out.phase.running_costs)
        costs = Recomputation(phase).costs if running else np.zeros(phase.mesh.size)
        errors.append(interval_errors(phase, each_interval(phase, cost=running), costs, size))
    return errors


def divide_phase(phase: PhaseSolution, errors: FloatArray, accuracy: float) -> FloatArray:
    """Divide the mesh of a phase by errors of its intervals, of the order of its scheme."""
    return divide(phase.mesh, errors, accuracy, phase.laid_out.kind.scheme.order)


def divide(mesh: FloatArray, errors: FloatArray, accuracy: float, order: int) -> FloatArray:
    """Divide the intervals above the accuracy into the number of pieces that the order predicts.

    A local error e that goes with the power ``order + 1`` of the step comes below the goal with
    ``(e / goal)^(1 / (order + 1))`` pieces. The goal is half the accuracy: once a mesh is changed,
    its neighbours that were just good enough may not be any more.
    """
    if errors.max() <= accuracy:
        return mesh.copy()
    wanted = np.ceil((errors / (DIVISION.safety * accuracy)) ** (1.0 / (order + 1)))
    pieces = np.clip(wanted, 1, DIVISION.most_pieces).astype(int)
    parts = [
        np.linspace(a, b, n, endpoint=False)
        for a, b, n in zip(mesh[:-1], mesh[1:], pieces, strict=True)
    ]
    return np.append(np.concatenate(parts), mesh[-1])
