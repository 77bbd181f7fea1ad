"""The loop of every refinement: solve, measure, split, solve again.

What is solved, what is measured, where it is split, which answer is accepted and when it ends are
functions; what has come of it so far is data.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

from microbot_ocp._base.status import Status

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
