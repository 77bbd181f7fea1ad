"""A planning task as the search sees it: its program, and its solutions as motions.

Via points are stops that are passed at any velocity. For a task of via points alone, a solution
that exceeds limits may be slowed down until it keeps them.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.codegen import compiles
from microbot_ocp.limits import LimitFamily
from microbot_ocp.motion import Motion, polynomial_of
from microbot_ocp.ocp import Solution
from microbot_ocp.ocp.transcription import Guess, Transcription
from microbot_ocp.planning.free import (
    JERK_WEIGHT,
    FlatTranscription,
    InitialGuess,
    Slowed,
    excess_along,
    excess_between,
    flat_form,
    guess_along,
    guesses_along,
    initial_guesses,
    known_ways,
    phase_names,
    phase_shapes,
    polynomial,
    slowed_together,
    transcription,
    via_times,
    within_limits,
)
from microbot_ocp.planning.search._branches import Way, segment_timings, straight_way
from microbot_ocp.planning.search._settings import TimeOptimalSettings
from microbot_ocp.planning.search._stop_motion import motion_of
from microbot_ocp.planning.task import (
    JERK_SMOOTHING,
    Conditions,
    Task,
    TaskScale,
    largest,
    with_locked_joints_held,
)
from microbot_ocp.robot import Robot

# Weight of the squared jerk among obstacles under limits of rates: joints of a redundant arm that
# do not decide the duration converge in fewer iterations
GUIDED_SMOOTHING = 100.0 * JERK_SMOOTHING
VIA_TOLERANCE = 1e-7  # relative position error and velocity jump allowed at a via point


@dataclass(frozen=True, eq=False)
class TrialStart:
    """Initial guess of a solve on a coarse mesh.

    Attributes
    ----------
    guess : InitialGuess
    way : Way
        Way with the poses of the guess at the stops.
    settings : mapping
        Solver settings by name that replace the usual ones.
    barrier : float, optional
        Barrier parameter of a guess that the solve stays near; the solver's own by default.
    """

    guess: InitialGuess
    way: Way
    settings: Mapping[str, Any] = field(default_factory=dict)
    barrier: float | None = None


@dataclass(frozen=True, eq=False)
class MotionProblem:
    """Stops, the segments between them, and the ways through them.

    Attributes
    ----------
    task : Task
    ways : tuple of Way
    settings : TimeOptimalSettings
    given : Transcription, optional
        Kernels built before.
    way : Slowed, optional
        Fastest motion known without a search.
    timed_path : InitialGuess, optional
        Start of a search among obstacles.
    finer : int
        Factor on the number of intervals of the coarse mesh.
    duration_to_beat : float
        Duration of another order of the stops, s, without dwells.
    for_comparison : bool
        Search only as far as needed to compare orders.
    again : bool
        True for a task that was solved before under other limits.
    first : InitialGuess, optional
        Initial guess before the random ones.
    moving : bool
        True if the arm moves at the start.
    weight : float
        Usual weight of the squared jerk.
    proved_excess : callable, optional
        Function of a solution whose capsules come too near. It returns the excess of all other
        limits if the links are proved to keep clear, and None otherwise.
    """

    task: Task
    ways: tuple[Way, ...]
    settings: TimeOptimalSettings
    given: Transcription | None = None
    way: Slowed | None = None
    timed_path: InitialGuess | None = None
    finer: int = 1
    duration_to_beat: float = np.inf
    for_comparison: bool = False
    again: bool = False
    first: InitialGuess | None = None
    moving: bool = False
    weight: float = JERK_SMOOTHING
    proved_excess: Callable[[Solution], list[FloatArray] | None] | None = None
    _excess: dict[Solution, list[FloatArray]] = field(default_factory=dict)
    _slowed: dict[Solution, Motion | None] = field(default_factory=dict)

    @classmethod
    def through(
        cls, family: LimitFamily, via: FloatArray, settings: TimeOptimalSettings, **more: Any
    ) -> MotionProblem:
        """Return the problem of checked via points [m,n], rad (m), passed at any velocity."""
        return cls(Task.through(family, via), (straight_way(via),), settings, **more)

    @property
    def family(self) -> LimitFamily:
        """Limits of all segments."""
        return self.task.family

    @property
    def via(self) -> FloatArray:
        """Poses [m,n] at the stops on the first way, rad (m)."""
        return self.ways[0].via

    @cached_property
    def names(self) -> list[str]:
        """Names of the phases, one from each stop to the next."""
        return phase_names(len(self.task.segments))

    @cached_property
    def scale(self) -> TaskScale:
        """Typical magnitudes of the task's variables."""
        return TaskScale.of(self.family, self.via, self.task.conditions.velocities)

    @property
    def dwell_time(self) -> float:
        """Sum of all dwells, s."""
        return float(self.task.dwells.sum())

    @property
    def is_free(self) -> bool:
        """True if a motion may be slowed down at limits, and starts are added until they agree.

        False for a search from a path around obstacles: that path is the fallback.
        """
        return self.task.is_plain and self.timed_path is None

    @property
    def fast(self) -> bool:
        """True if functions are compiled."""
        return compiles(self.settings.compiled)

    @cached_property
    def is_flat(self) -> bool:
        """True if the program has no states (docs/theory/flat.md)."""
        return isinstance(self._usual_kernels, FlatTranscription)

    @property
    def is_rated(self) -> bool:
        """True if the program has no states and jerks or torque rates are limited."""
        return self.is_flat and self.family.jerk_matters

    def kernels(self, *, budgeted: bool = False, stated: bool = False) -> Any:
        """Return the program with the limits and payloads of every segment, cached.

        ``budgeted`` selects the program of least effort in a given time, ``stated`` the one with
        states.
        """
        if budgeted or stated:
            return self._built(budgeted=budgeted, stated=True)
        return self._usual_kernels

    @cached_property
    def _usual_kernels(self) -> Any:
        if self.given is not None:
            return self.given
        built = self._built()
        return self.smoothed(built, self.smoothing) if self.is_guided_by_rates else built

    @property
    def is_guided_by_rates(self) -> bool:
        """True if a path around obstacles is given, and jerks or torque rates are limited."""
        return self.timed_path is not None and self.family.jerk_matters

    @property
    def smoothing(self) -> float:
        """Weight of the squared jerk."""
        return GUIDED_SMOOTHING if self.is_guided_by_rates else self.weight

    def smoothed(self, kernels: Transcription, weight: float) -> Transcription:
        """Return the program with another weight of the squared jerk."""
        return kernels.with_parameters({name: {JERK_WEIGHT: weight} for name in self.names})

    def _built(self, *, budgeted: bool = False, stated: bool = False) -> Any:
        conditions = None
        if not self.task.is_plain:
            held = tuple(with_locked_joints_held(f).robot for f in self.task.families)
            given = self.task.conditions
            conditions = Conditions(held, given.ends, given.closed)
        base: Robot = with_locked_joints_held(self.family).robot
        via = np.ascontiguousarray(self.via)
        if not stated:
            flat = flat_form(base, via.tobytes(), len(via), conditions=conditions)
            if flat is not None:
                return flat
        options: dict[str, Any] = {"budgeted": budgeted, "conditions": conditions}
        return transcription(base, via.tobytes(), len(via), self.settings.compiled, **options)

    # initial guesses --------------------------------------------------------------------------

    def drawn(self, index: int) -> InitialGuess | None:
        """Return the random initial guess of an index; None after the last."""
        guesses, further = self._drawn
        guesses.extend(itertools.islice(further, max(index + 1 - len(guesses), 0)))
        return guesses[index] if index < len(guesses) else None

    @cached_property
    def _drawn(self) -> tuple[list[InitialGuess], Iterator[InitialGuess]]:
        """Guesses drawn so far, and the iterator of further ones."""
        drawn = [] if self.first is None else [self.first]
        # The starts of a task that is solved again include its known motion.
        tries = self.settings.tries
        most = tries if self.again else max(self.settings.starts, tries)
        given = self.family, self.via, self.names, most, self.settings.seed
        return drawn, initial_guesses(*given, moving=self.moving)

    def guesses(self, solution: Solution, slower: float = 1.0) -> dict[str, Guess]:
        """Return a guess for every phase from a solution, slowed down by a factor."""
        shapes = zip(self.names, phase_shapes(solution), strict=True)
        return self.with_closed(
            {name: guess_along(shape.stretched(slower)) for name, shape in shapes}
        )

    def guesses_along(self, motion: Motion) -> dict[str, Guess]:
        """Return a guess for every phase from a motion whose marks are the via points."""
        shape = polynomial_of(motion)
        return guesses_along(self.names, shape, np.array([mark.time for mark in motion.marks]))

    def with_closed(self, guesses: Mapping[str, Guess]) -> dict[str, Guess]:
        """Return guesses of a cycle; the first phase holds the values to which the last returns."""
        first, start = self.names[0], np.zeros(1)
        added = {}
        for key in self.task.conditions.closed:
            value = guesses[first].values[key]
            given = np.asarray(value(start) if callable(value) else value, dtype=float)
            given = np.broadcast_to(given.ravel(), (self.task.robot.joint_count,))
            added[f"{key} at the start of {first!r}"] = given.copy()
        guess = guesses[first]
        return {**guesses, first: Guess(guess.duration, {**guess.values, **added})}

    # solutions --------------------------------------------------------------------------------

    def excess(self, solution: Solution) -> list[FloatArray]:
        """Return the largest relative excess of any limit in every interval [N,K] of every phase.

        The result is cached. Without states K is one, so that whole intervals are halved: a spline
        whose neighbouring intervals differ more in length loses digits.
        """
        if solution not in self._excess:
            families = self.task.families
            if families.count(families[0]) == len(families):  # one batched call is faster
                excess = excess_between(families[0], solution)
            else:
                pairs = zip(families, phase_shapes(solution), strict=True)
                excess = [excess_along(family, shape) for family, shape in pairs]
            if self.is_flat:
                excess = [table.max(axis=1, keepdims=True) for table in excess]
            if self.proved_excess is not None and largest(excess) > self.settings.limit_tolerance:
                excess = self.proved_excess(solution) or excess
            self._excess[solution] = excess
        return self._excess[solution]

    def motion(self, solution: Solution, provenance: dict[str, Any]) -> Motion:
        """Return a solution as a motion with marks at the stops."""
        return motion_of(self.task, phase_shapes(solution), provenance)

    # motions without a solver ----------------------------------------------------------------

    @cached_property
    def fallback(self) -> Slowed | None:
        """Fastest motion known without a search."""
        if self.way is not None or self.timed_path is not None:
            return self.way
        if self.again:  # it would take longer than the solve
            return None
        if self.is_free:
            return known_ways(self.family, self.via, self.settings.limit_tolerance, self.fast)
        return self._at_rest()

    def _at_rest(self) -> Slowed | None:
        """Return a motion that rests at every stop; None if a stop or segment does not allow it."""
        task, tolerance = self.task, self.settings.limit_tolerance
        if self._moves or task.around is not None:
            return None
        timings, shapes = segment_timings(task, self.ways[0], self.settings.compiled), []
        for k, (family, kind) in enumerate(zip(task.families, task.segments, strict=True)):
            if deadline.over():
                return None
            if kind is None:
                way = known_ways(family, self.via[k : k + 2], tolerance, self.fast)
                found = way and [polynomial_of(way.motion)]
            else:
                timed = timings[k]
                found = timed and slowed_together([family], [timed], tolerance)
            if not found:
                return None
            shapes += found
        return Slowed(motion_of(task, shapes, {}), "a way that rests at every stop")

    def slowed(self, solution: Solution) -> Motion | None:
        """Return a solution slowed down until it keeps the limits; None if that fails. Cached."""
        if solution not in self._slowed and self.timed_path is None:
            anew = self._slowed_anew if self.is_free else self._slowed_with_stops
            self._slowed[solution] = anew(solution)
        return self._slowed.get(solution)

    @property
    def _moves(self) -> bool:
        """True if a stop has a velocity, which a slower motion would not keep."""
        return any(stop.velocity not in (None, "any", "rest") for stop in self.task.stops)

    def _slowed_with_stops(self, solution: Solution) -> Motion | None:
        # A slower motion has other velocities at its stops, and not always smaller means.
        if self._moves or self.family.means or not solution.status.solved:
            return None
        shapes, tolerance = phase_shapes(solution), self.settings.limit_tolerance
        slower = slowed_together(self.task.families, shapes, tolerance)
        return None if slower is None else motion_of(self.task, slower, {})

    def _slowed_anew(self, solution: Solution) -> Motion | None:
        if not solution.phases or not np.isfinite(solution.duration):
            return None
        shape, times = polynomial(solution), via_times(solution)
        # An interrupted solve may miss via points or jump in velocity: slowing down mends neither.
        missed = np.abs(shape(times) - self.via).max()
        if not missed <= VIA_TOLERANCE * np.abs(np.diff(self.via, axis=0)).max():
            return None
        velocity, inner = shape.derivative(), times[1:-1]
        jump = np.abs(velocity(inner) - velocity(inner, from_left=True)).max(initial=0.0)
        if not jump <= VIA_TOLERANCE * np.abs(velocity(shape.breaks)).max():
            return None
        given = self.settings.limit_tolerance, self.fast
        return within_limits(self.family, shape, times, *given, moving=self.moving)
