"""State error of every interval by re-integration, and the pieces it has to be divided into.

The error of an interval is the difference between the next mesh state and what an adaptive
integrator arrives at from the interval's own mesh state with the solution's own control. A scheme
of order p makes local errors of order p + 1 in the step, which says into how many pieces an
interval has to be divided (Betts, *Practical Methods for Optimal Control*, 2nd ed., section 4.7;
the error there is a quadrature of the residual over the interval).

The loop of every refinement is here, too: solve, measure, split, solve again. What is solved, what
is measured, where it is split, which answer is accepted and when it ends are functions; what has
come of it so far is data.

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


# refinement -------------------------------------------------------------------------------------

S = TypeVar("S")  # answer
M = TypeVar("M")  # what is measured of it
P = TypeVar("P")  # what is proposed to be solved next


@dataclass(frozen=True, eq=False)
class Round(Generic[S, M]):
    """An accepted answer, and what was measured of it."""

    solution: S
    measure: M


@dataclass(frozen=True, eq=False)
class Refinement(Generic[S, M]):
    """A refinement so far.

    Attributes
    ----------
    rounds : what was accepted, in order
    refused : what was solved last, if it was not accepted
    ended : why no more is solved; None before that
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
        """What was measured of it."""
        return self.rounds[-1].measure


def refined(
    first: S,
    solve: Callable[[S, P], S],
    measure: Callable[[tuple[Round[S, M], ...], S], M],
    split: Callable[[tuple[Round[S, M], ...]], P],
    accept: Callable[[S, S], bool],
    stop: Callable[[tuple[Round[S, M], ...], P], Status | None],
) -> Iterator[Refinement[S, M]]:
    """Refine an answer round by round; yields how far it is after each, and at last why it ended.

    Parameters
    ----------
    first : the answer that it begins with
    solve : a new answer from the last one, by what ``split`` proposed
    measure : of an answer, seen from the rounds before it
    split : what is solved next, seen from all rounds: usually meshes
    accept : whether a new answer takes the place of the last one; else this was all
    stop : why what is proposed is not solved any more; None where it is
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
