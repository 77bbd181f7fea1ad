"""A task as the search sees it: its program, its initial guesses, and its motions.

There are two: via points, which are passed at any velocity, and stops with what lies between them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.codegen import compiles
from microbot_ocp.limits import LimitFamily
from microbot_ocp.motion import Mark, Motion, PiecewisePolynomial, pieces_of
from microbot_ocp.ocp import Solution
from microbot_ocp.ocp.transcription import Guess, Transcription
from microbot_ocp.planning.free import (
    InitialGuess,
    Slowed,
    excess_between,
    guesses_along,
    initial_guesses,
    known_ways,
    phase_names,
    polynomial,
    transcription,
    via_times,
    within_limits,
)
from microbot_ocp.planning.search._settings import SEARCH, TimeOptimalSettings
from microbot_ocp.planning.task import TaskScale, with_locked_joints_held
from microbot_ocp.robot import Robot

if TYPE_CHECKING:
    from microbot_ocp.planning.search._search import MotionSearch, SearchState


@dataclass(frozen=True, eq=False)
class TrialStart:
    """What a solve on a coarse mesh starts from.

    Attributes
    ----------
    guess : InitialGuess
    solver : str or tuple of str
    most_iterations : int, optional
    origin : what the guess was made of
    options : of the solvers, in the place of the usual ones
    """

    guess: InitialGuess
    solver: str | tuple[str, ...]
    most_iterations: int | None = None
    origin: Any = None
    options: Mapping[str, Any] | None = None


class MotionProblem(Protocol):
    """What the search needs to know of a task.

    Attributes
    ----------
    family : LimitFamily
        Of the whole task.
    via : array [m,n], rad (m)
    settings : TimeOptimalSettings
    names : of the phases, one from each stop to the next
    scale : TaskScale
    is_free : nothing but via points is given, no velocity there and no timed path: starts go on
        until they agree, and a motion that exceeds limits may be slowed down until it keeps them
    timed_path : around obstacles, that the search starts from: it is not far to the answer
    """

    @property
    def family(self) -> LimitFamily: ...
    @property
    def settings(self) -> TimeOptimalSettings: ...
    @property
    def via(self) -> FloatArray: ...
    @property
    def names(self) -> list[str]: ...
    @property
    def scale(self) -> TaskScale: ...
    @property
    def is_free(self) -> bool: ...
    @property
    def timed_path(self) -> InitialGuess | None: ...
    @property
    def fallback(self) -> Slowed | None:
        """The fastest motion that needs no search."""
        ...

    def kernels(self, *, budgeted: bool = False) -> Transcription:
        """Return the program; ``budgeted`` that of the least effort in a time that is given."""
        ...

    def next_start(self, search: MotionSearch, state: SearchState) -> TrialStart | None:
        """Return the next initial guess; None where there are no more."""
        ...

    def guesses(self, solution: Solution) -> dict[str, Guess]:
        """Return a guess for every phase from a solution on another mesh."""
        ...

    def guesses_along(self, motion: Motion) -> dict[str, Guess]:
        """Return a guess for every phase from a motion whose marks are the via points."""
        ...

    def excess(self, solution: Solution) -> list[FloatArray]:
        """Give largest relative excess of any limit along every interval [N, K] of every phase."""
        ...

    def slowed(self, solution: Solution) -> Motion | None:
        """Return a solution slowed down until it keeps the limits; None where it is none."""
        ...

    def motion(self, solution: Solution, provenance: dict[str, Any]) -> Motion:
        """Return a solution as a motion."""
        ...


@dataclass(frozen=True, eq=False)
class FreeProblem:
    """Via points [m,n] that are passed at any velocity, from rest to rest."""

    family: LimitFamily
    via: FloatArray
    settings: TimeOptimalSettings
    given: Transcription | None = None  # kernels
    way: Slowed | None = None  # that needs no search
    timed_path: InitialGuess | None = None
    _drawn: list[InitialGuess] = field(default_factory=list)
    _excess: dict[Solution, list[FloatArray]] = field(default_factory=dict)
    _slowed: dict[Solution, Motion | None] = field(default_factory=dict)

    @property
    def names(self) -> list[str]:
        """Of the phases."""
        return phase_names(len(self.via) - 1)

    @property
    def scale(self) -> TaskScale:
        """Typical sizes of the task."""
        return TaskScale.of(self.family, self.via)

    @property
    def is_free(self) -> bool:
        """Not where it starts from a timed path, which is also there if limits are exceeded."""
        return self.timed_path is None

    @property
    def fast(self) -> bool:
        """Whether functions are compiled."""
        return compiles(self.settings.compiled)

    @property
    def fallback(self) -> Slowed | None:
        """The fastest way that needs no search, where motions may be slowed down."""
        return self.way if not self.is_free or self.way is not None else self._fallback

    @cached_property
    def _fallback(self) -> Slowed | None:
        return known_ways(self.family, self.via, self.settings.limit_tolerance, self.fast)

    def kernels(self, *, budgeted: bool = False) -> Transcription:
        """Return the program, built once."""
        if self.given is not None and not budgeted:
            return self.given
        held: Robot = with_locked_joints_held(self.family).robot
        compiled = self.settings.compiled
        via = np.ascontiguousarray(self.via)
        return transcription(held, via.tobytes(), len(via), compiled, budgeted=budgeted)

    def next_start(self, search: MotionSearch, state: SearchState) -> TrialStart | None:
        """Return the guess after those that were tried, with its solver."""
        tried = [answer for answer in state.of("start") if answer.before is None]
        given, index = self.settings, len(tried)
        if index == max(given.starts, given.tries):
            return None
        while len(self._drawn) <= index:
            self._drawn.append(next(self._drawing))
        both: str | tuple[str, ...] = ("fatrop", "ipopt")
        if index >= given.starts:  # what one misses the other may find
            both = "ipopt" if index % 3 == 2 else "fatrop"
        solver = both if given.solver == "auto" else given.solver
        solved = [answer for answer in tried if answer.solved]
        if not solved:
            return TrialStart(self._drawn[index], solver)
        # what takes so much longer than another start is given up
        allowed = [SEARCH.patience * a.solution.attempts[-1].iterations for a in solved]
        most = max(SEARCH.least_iterations, *(allowed if index > 1 else ()), 0)
        return TrialStart(
            self._drawn[index], solver if isinstance(solver, str) else solver[0], most
        )

    @cached_property
    def _drawing(self) -> Iterator[InitialGuess]:
        most, seed = max(self.settings.starts, self.settings.tries), self.settings.seed
        return initial_guesses(self.family, self.via, self.names, most, seed)

    def guesses(self, solution: Solution) -> dict[str, Guess]:
        """Return a guess for every phase from a solution."""
        return guesses_along(self.names, polynomial(solution), via_times(solution))

    def guesses_along(self, motion: Motion) -> dict[str, Guess]:
        """Return a guess for every phase from a motion whose marks are the via points."""
        shape = PiecewisePolynomial(motion.t, pieces_of(motion))
        return guesses_along(self.names, shape, np.array([mark.time for mark in motion.marks]))

    def excess(self, solution: Solution) -> list[FloatArray]:
        """Return the largest relative excess of any limit along every interval, asked for again and
        again.
        """
        if solution not in self._excess:
            self._excess[solution] = excess_between(self.family, solution)
        return self._excess[solution]

    def slowed(self, solution: Solution) -> Motion | None:
        """Return a solution slowed down until it keeps the limits; None where it is none."""
        if not self.is_free:
            return None
        if solution not in self._slowed:
            self._slowed[solution] = self._slowed_anew(solution)
        return self._slowed[solution]

    def slowed_before(self, solution: Solution) -> Motion | None:
        """Return the same where it was asked for before."""
        return self._slowed.get(solution)

    def _slowed_anew(self, solution: Solution) -> Motion | None:
        if not solution.phases or not np.isfinite(solution.duration):
            return None
        shape, times = polynomial(solution), via_times(solution)
        missed = np.abs(shape(times) - self.via).max()
        if not missed <= SEARCH.missed * np.abs(np.diff(self.via, axis=0)).max():
            return None
        velocity, inner = shape.derivative(), times[1:-1]
        jump = np.abs(velocity(inner) - velocity(inner, from_left=True)).max(initial=0.0)
        if not jump <= SEARCH.missed * np.abs(velocity(shape.breaks)).max():
            return None  # where a solve was stopped
        return within_limits(self.family, shape, times, self.settings.limit_tolerance, self.fast)

    def motion(self, solution: Solution, provenance: dict[str, Any]) -> Motion:
        """Return a solution as a motion with the via points marked."""
        return as_motion(self.family.robot, solution, provenance)


def as_motion(robot: Robot, solution: Solution, provenance: dict[str, Any]) -> Motion:
    """Return a solution as a motion with the via points marked."""
    marks = [Mark(float(t), f"via {i + 1}") for i, t in enumerate(via_times(solution))]
    return Motion.from_polynomial(
        robot,
        polynomial(solution),
        label="time-optimal",
        marks=marks,
        provenance=provenance,
    )
