"""State errors of the intervals by re-integration, their division, and the refinement loop.

The error of an interval is the difference between the next mesh state and the result of an adaptive
integrator from the interval's own mesh state with the solution's own control. A scheme of order p
has local errors of order p + 1 in the step, which determines the number of pieces of an interval
(Betts, *Practical Methods for Optimal Control*, 2nd ed., section 4.7; there the error is a
quadrature of the residual over the interval).

The loop of every refinement is defined here: solve, measure, split, solve again. Its steps are
functions and its progress is data, so that it serves any kind of solution.

Theory: docs/theory/transcription.md, equation (5).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.status import Status
from microbot_ocp.ocp.solution import PhaseSolution, Solution, cost_size
from microbot_ocp.ocp.verification import Recomputation, each_interval, interval_errors

MOST_PIECES = 6  # pieces of an interval in one round: estimates of errors may be poor
SAFETY = 0.5  # target error of the divided intervals, relative to the accuracy


def state_errors(solution: Solution) -> list[FloatArray]:
    """Return the relative state error of every interval: one array [N] per phase.

    ``max_i |x_i(t_k+1) - reached_i| / weight_i``, where reached is the integral of the dynamics
    from the mesh state at t_k and the weight is the largest magnitude of the state along the phase,
    or a hundredth of its scale if that is larger. The running cost counts as an additional state
    with the size of the cost as weight. Infinite if the integrator fails.
    """
    errors = []
    size = cost_size(solution.cost, solution.cost_scale)
    for phase in solution.phases:
        running = bool(phase.laid_out.phase.running_costs)
        costs = Recomputation(phase).costs if running else np.zeros(phase.mesh.size)
        errors.append(interval_errors(phase, each_interval(phase, cost=running), costs, size))
    return errors


def divide_phase(phase: PhaseSolution, errors: FloatArray, accuracy: float) -> FloatArray:
    """Divide the mesh of a phase for given interval errors and the order of its scheme."""
    return divide(phase.mesh, errors, accuracy, phase.laid_out.kind.scheme.order)


def divide(mesh: FloatArray, errors: FloatArray, accuracy: float, order: int) -> FloatArray:
    """Divide the intervals above the accuracy into as many pieces as the order predicts.

    A local error e proportional to the power ``order + 1`` of the step falls below the target with
    ``(e / target)^(1 / (order + 1))`` pieces, equation (5). The target is half the accuracy: a
    changed mesh also changes the errors of neighbours that just met the accuracy.
    """
    if errors.max() <= accuracy:
        return mesh.copy()
    # n pieces reduce the error of an interval by n^(order + 1).
    wanted = np.ceil((errors / (SAFETY * accuracy)) ** (1.0 / (order + 1)))
    pieces = np.clip(wanted, 1, MOST_PIECES).astype(int)
    parts = [
        np.linspace(a, b, n, endpoint=False)
        for a, b, n in zip(mesh[:-1], mesh[1:], pieces, strict=True)
    ]
    return np.append(np.concatenate(parts), mesh[-1])


# refinement -------------------------------------------------------------------------------------

S = TypeVar("S")  # answer
M = TypeVar("M")  # measure of an answer
P = TypeVar("P")  # proposal for the next solve


@dataclass(frozen=True, eq=False)
class Round(Generic[S, M]):
    """An accepted answer and its measure."""

    solution: S
    measure: M


@dataclass(frozen=True, eq=False)
class Refinement(Generic[S, M]):
    """State of a refinement.

    Attributes
    ----------
    rounds : accepted answers in order
    refused : last answer, if it was not accepted
    ended : reason of the end; None before the end
    """

    rounds: tuple[Round[S, M], ...]
    refused: S | None = None
    ended: Status | None = None

    @property
    def solution(self) -> S:
        """The last accepted answer."""
        return self.rounds[-1].solution

    @property
    def measure(self) -> M:
        """Measure of the last accepted answer."""
        return self.rounds[-1].measure


def refined(
    first: S,
    solve: Callable[[S, P], S],
    measure: Callable[[tuple[Round[S, M], ...], S], M],
    split: Callable[[tuple[Round[S, M], ...]], P],
    accept: Callable[[S, S], bool],
    stop: Callable[[tuple[Round[S, M], ...], P], Status | None],
) -> Iterator[Refinement[S, M]]:
    """Refine an answer round by round; yield the state after each round, and last the final state.

    Parameters
    ----------
    first : initial answer
    solve : function of the last answer and a proposal that returns a new answer
    measure : function of the earlier rounds and an answer that returns its measure
    split : function of all rounds that returns the proposal of the next solve, usually meshes
    accept : function that returns True if a new answer replaces the last one; if not, this ends
    stop : function that returns a reason not to solve a proposal, or None
    """
    state = Refinement[S, M]((Round(first, measure((), first)),))
    while True:
        yield state
        proposal = split(state.rounds)
        ended = stop(state.rounds, proposal)
        if ended is not None:
            yield replace(state, ended=ended)
            return
        answer = solve(state.solution, proposal)
        if not accept(state.solution, answer):
            yield replace(state, refused=answer, ended=Status.NOT_ACCEPTED)
            return
        state = Refinement((*state.rounds, Round(answer, measure(state.rounds, answer))))
