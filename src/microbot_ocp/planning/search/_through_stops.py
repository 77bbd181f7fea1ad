"""Stops as the search sees them, the fastest motion through them, and the one of least effort.

Every segment has the limits and the payload that hold on it, and the search starts from the ways
through every branch of the inverse kinematics, or from ways that lead around obstacles.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.codegen import compiles
from microbot_ocp._base.outcome import Outcome
from microbot_ocp._base.status import Status
from microbot_ocp.limits import LimitFamily, MotionSamples
from microbot_ocp.motion import Motion, PiecewisePolynomial, pieces_of
from microbot_ocp.ocp import Solution
from microbot_ocp.ocp.solution import StepProgress
from microbot_ocp.ocp.transcription import Guess, Transcription
from microbot_ocp.planning.free import (
    InitialGuess,
    Slowed,
    excess_along,
    initial_guesses,
    known_ways,
    phase_names,
    polynomial,
    transcription,
)
from microbot_ocp.planning.path import time_path
from microbot_ocp.planning.search._branches import (
    Way,
    few_poses,
    least_duration,
    least_time,
    ways_through,
)
from microbot_ocp.planning.search._problem import TrialStart
from microbot_ocp.planning.search._result import (
    Fastest,
    fastest,
    further_remarks,
    motion_of_answer,
    returned,
    starts_of,
)
from microbot_ocp.planning.search._search import MotionSearch, SearchState
from microbot_ocp.planning.search._settings import SEARCH, TimeOptimalSettings, sparing
from microbot_ocp.planning.search._stop_motion import motion_of
from microbot_ocp.planning.search._strategies import STRATEGIES, search_of
from microbot_ocp.planning.task import (
    CELL_TIME_LIMIT,
    LDL,
    Conditions,
    Task,
    TaskScale,
    with_locked_joints_held,
)
from microbot_ocp.robot import Robot, jacobian
from microbot_ocp.trajectories import spline

if TYPE_CHECKING:
    from collections.abc import Iterator


@dataclass(frozen=True)
class StopSearchSettings:
    """Settings of the search through stops.

    Attributes
    ----------
    slowest : times the shortest duration: no longer time is given for less effort
    most_iterations : of a start on the coarse mesh
    bows : further guesses from the best way
    spare : a way is left out whose poses are so many times the best duration apart at the
        highest velocities, where the arm has joints or tolerances to spare: its poses might
        move. Without, it is never better
    slowed : times the duration of a first guess, until it keeps its limits
    most_slowed : times that it is slowed down
    timed : intervals of the timing of a first guess
    """

    slowest: float = 20.0
    most_iterations: int = 300
    bows: int = 2
    spare: float = 1.25
    slowed: float = 1.3
    most_slowed: int = 20
    timed: int = 100


STOPS = StopSearchSettings()

LEFT_OUT = "left out"  # status of a way that was not tried


class Guide(NamedTuple):
    """A way whose free segments lead around obstacles.

    Attributes
    ----------
    way : Way
    shapes : dict of str to PiecewisePolynomial
        The timed path of every free segment, from rest to rest.
    durations : list of float or None
        What every segment takes so, s; None of one that could not be timed.
    name : str
    """

    way: Way
    shapes: dict[str, PiecewisePolynomial]
    durations: list[float | None]
    name: str


@dataclass(frozen=True, eq=False)
class StopProblem:
    """A task of stops, and the ways through it.

    Attributes
    ----------
    task : Task
    ways : tuple of Way
    settings : TimeOptimalSettings
    guides : ways around obstacles; starts are these alone then
    beaten : s, dwells not included: another order of the stops takes so long
    briefly : whether only what is needed to compare orders is tried
    """

    task: Task
    ways: tuple[Way, ...]
    settings: TimeOptimalSettings
    guides: tuple[Guide, ...] = ()
    beaten: float = np.inf
    briefly: bool = False
    _excess: dict[Solution, list[FloatArray]] = field(default_factory=dict)

    is_free = False  # velocities and cycles at stops are given; every way through branches is tried
    timed_path: InitialGuess | None = None
    fallback: Slowed | None = None

    @property
    def family(self) -> LimitFamily:
        """Limits that hold everywhere."""
        return self.task.family

    @property
    def via(self) -> FloatArray:
        """Poses [m,n] at the stops on the first way."""
        return self.ways[0].via

    @property
    def names(self) -> list[str]:
        """Of the phases."""
        return phase_names(len(self.via) - 1)

    @property
    def scale(self) -> TaskScale:
        """Typical sizes of the task."""
        return TaskScale.of(self.family, self.via)

    @property
    def rested(self) -> float:
        """All dwells together, s."""
        return float(self.task.dwells.sum())

    def kernels(self, *, budgeted: bool = False) -> Transcription:
        """Return the program with the limits and payloads of every segment, built once."""
        held = [with_locked_joints_held(family).robot for family in self.task.families]
        given = self.task.conditions
        base: Any = with_locked_joints_held(self.family).robot
        return transcription(
            base,
            self.via.tobytes(),
            len(self.via),
            self.settings.compiled,
            budgeted=budgeted,
            conditions=Conditions(tuple(held), given.ends, given.closed),
        )

    # initial guesses --------------------------------------------------------------------------

    def next_start(self, search: MotionSearch, state: SearchState) -> TrialStart | None:
        """Return the next way that may be the fastest; bows beside the best of them at last."""
        pair = next(self._guesses(state), None)
        if pair is None:
            return None
        way, guess = pair
        closed = {name: self._with_closed(name, g) for name, g in guess.guesses.items()}
        solved = [answer for answer in state.of("start") if answer.solved]
        most = STOPS.most_iterations
        if solved:
            iterations = max(a.solution.attempts[-1].iterations for a in solved)
            most = min(max(SEARCH.least_iterations, SEARCH.patience * iterations), most)
        auto = self.settings.solver == "auto"
        return TrialStart(
            replace(guess, guesses=closed),
            ("fatrop", "ipopt") if auto else self.settings.solver,
            most,
            origin=way,
            # IPOPT solves what takes it more
            options={**LDL, "fatrop": {"max_iter": SEARCH.least_iterations}},
        )

    def _guesses(self, state: SearchState) -> Iterator[tuple[Way, InitialGuess]]:
        """Yield what was not tried yet: ways, or guides, and then bows beside the best of them."""
        tried = {answer.start for answer in state.of("start")}
        taken: list[Way] = []
        for guide in self.guides:
            again = any(guide.way is other for other in taken)
            if not (self.briefly and again):
                taken.append(guide.way)
                if guide.name not in tried and self.least(state, guide.way) is None:
                    usual = self._rest_to_rest(guide.way)
                    led = {name: guess_along(shape) for name, shape in guide.shapes.items()}
                    yield guide.way, InitialGuess(guide.name, {**usual.guesses, **led})
        if self.guides:
            return
        for way in self.ways if self.settings.starts > 1 else self.ways[:1]:
            if way.name not in tried and self.least(state, way) is None:
                yield way, self._rest_to_rest(way)
        single = self.settings.starts == 1 or any(kind is not None for kind in self.task.segments)
        if self.briefly or single or not tried:
            return
        of_ways = [a for a in state.of("start") if a.start == a.origin.name]
        key = lambda a: (not a.solved, a.solution.duration)  # noqa: E731
        best = min(of_ways, key=key).origin
        further = min(STOPS.bows, self.settings.starts - 1) + 1
        for g in initial_guesses(self.family, best.via, self.names, further, self.settings.seed):
            name = f"{best.name}, {g.name}"
            if name not in tried:
                yield best, replace(g, name=name)

    def least(self, state: SearchState, way: Way) -> float | None:
        """Return what a way takes at the highest velocities, s; None where no other one takes
        less.
        """
        durations = [a.solution.duration for a in state.of("start") if a.solved]
        exact = all(few_poses(self.task.robot, stop) is not None for stop in self.task.stops)
        least = least_time(self.task, way)
        slower = least > (1.0 if exact else STOPS.spare) * min([*durations, self.beaten])
        return least if slower else None

    def _rest_to_rest(self, way: Way) -> InitialGuess:
        """Return every segment from rest to rest, with its best timing where its path can be
        travelled.
        """
        guesses = {}
        durations = TaskScale.of(self.family, way.via).durations
        timings = segment_timings(self.task, way, self.settings.compiled)
        rows = zip(self.names, way.paths, self.task.payloads, durations, timings, strict=True)
        for name, path, payload, duration, timed in rows:
            shape = spline(path, np.linspace(0.0, float(duration), len(path)))
            robot = payload.on(self.task.robot)
            guesses[name] = guess_along(timed or _slowed(robot, shape))
        return InitialGuess(way.name, guesses)

    def _with_closed(self, name: str, guess: Guess) -> Guess:
        """Return a guess of the first phase with the values at its start that the last one
        returns to.
        """
        if name != self.names[0] or not self.task.conditions.closed:
            return guess
        start = np.zeros(1)
        added = {}
        for key in self.task.conditions.closed:
            value = guess.values[key]
            given = np.asarray(value(start) if callable(value) else value, dtype=float)
            given = np.broadcast_to(given.ravel(), (self.task.robot.joint_count,))
            added[f"{key} at the start of {name!r}"] = given.copy()
        return Guess(guess.duration, {**guess.values, **added})

    # solutions --------------------------------------------------------------------------------

    def guesses(self, solution: Solution) -> dict[str, Guess]:
        """Return a guess for every phase from a solution."""
        return self.stretched(solution, 1.0)

    def stretched(self, solution: Solution, factor: float) -> dict[str, Guess]:
        """Return the same, slowed down evenly."""
        shapes = zip(self.names, phase_shapes(solution), strict=True)
        return {
            name: self._with_closed(name, guess_along(shape.stretched(factor)))
            for name, shape in shapes
        }

    def guesses_along(self, motion: Motion) -> dict[str, Guess]:
        """Raise: nothing is known that needs no search."""
        raise NotImplementedError

    def excess(self, solution: Solution) -> list[FloatArray]:
        """Return the largest relative excess of any limit along every interval of every phase."""
        if solution not in self._excess:
            pairs = zip(self.task.families, phase_shapes(solution), strict=True)
            self._excess[solution] = [excess_along(family, shape) for family, shape in pairs]
        return self._excess[solution]

    def slowed(self, solution: Solution) -> Motion | None:
        """Return None: velocities at stops are given."""
        return None

    def motion(self, solution: Solution, provenance: dict[str, Any]) -> Motion:
        """Return a solution as a motion with the stops marked."""
        return motion_of(self.task, phase_shapes(solution), provenance)


@dataclass(frozen=True, eq=False)
class StopSearch:
    """A search through stops, and what it has come to: orders of stops ask for more step by step.

    Attributes
    ----------
    search : MotionSearch
    duration : s, in which the motion of least effort is wanted
    state : SearchState
    """

    search: MotionSearch
    duration: float | None = None
    state: SearchState = field(default_factory=SearchState)

    @classmethod
    def of(
        cls,
        task: Task,
        settings: TimeOptimalSettings,
        progress: StepProgress,
        duration: float | None = None,
        ways: Sequence[Way] = (),
        guides: Sequence[Guide] = (),
    ) -> StopSearch:
        """Return the search of a task.

        Raises
        ------
        InputError
            A velocity that no branch allows, a duration below what velocities ask for.
        """
        _check_velocities(task)
        if duration is not None and (least := least_duration(task)) > duration:
            raise InputError(
                f"duration must be at least the {least:.4g} s that the velocity limits ask for, "
                f"not {duration:g} s"
            )
        chosen = [guide.way for guide in guides] or list(ways) or ways_through(task)
        problem = StopProblem(task, tuple(chosen), settings, tuple(guides))
        return cls(search_of(problem, settings, progress), duration)

    @property
    def stops(self) -> StopProblem:
        """The problem."""
        problem = self.search.problem
        assert isinstance(problem, StopProblem)
        return problem

    def explored(self, beaten: float) -> StopSearch:
        """Return the same with coarse answers, of ways that may take less than ``beaten``, s,
        alone.
        """
        least = replace(self.stops, beaten=beaten - self.stops.rested, briefly=True)
        state = replace(self.search, problem=least).run(STRATEGIES[:1], self.state)
        return replace(self, state=state)

    @property
    def coarse_duration(self) -> float:
        """What the best coarse answer takes, s; infinite where there is none."""
        durations = [a.solution.duration for a in self.state.of("start") if a.solved]
        return min(durations, default=np.inf) + self.stops.rested

    def run(self) -> Motion:
        """Return the fastest motion, or the one of least effort in the duration that is given."""
        with sparing():
            best = fastest(self.search, self.state, slack=0.0 if self.duration else None)
            shortest = best.answer.solution.duration + self.stops.rested
            if self.duration is not None and best.answer.solved:
                rested = self.stops.rested
                slack = (self.duration - rested) / best.answer.solution.duration - 1.0
                if slack > 0.0:
                    best = fastest(self.search, best.state, slack=min(slack, STOPS.slowest))
            motion = self.motion_from(best, shortest)
        late = motion.status is Status.TIME_LIMIT
        slow = self._at_rest() if late and self.duration is None else None
        if slow is None:
            return motion
        shapes, made_from = slow
        provenance = {**motion.provenance, "made_from": made_from}
        at_rest = motion_of(self.stops.task, shapes, provenance)
        return at_rest.ended(motion.outcome.and_(returned(made_from)))

    def _at_rest(self) -> tuple[list[PiecewisePolynomial], str] | None:
        """Return segments that need no search, from rest to rest, where stops and segments
        allow them.
        """
        task, settings = self.stops.task, self.search.settings
        moves = any(stop.velocity not in (None, "any", "rest") for stop in task.stops)
        if moves or task.around is not None or any(kind is not None for kind in task.segments):
            return None
        via, shapes, fast = self.stops.via, [], compiles(settings.compiled)
        for k, family in enumerate(task.families):
            way: Slowed | None = None
            if not deadline.over():
                way = known_ways(family, via[k : k + 2], settings.limit_tolerance, fast)
            if way is None:
                return None
            shapes.append(PiecewisePolynomial(way.motion.t, pieces_of(way.motion)))
        return shapes, "a way that rests at every stop"

    def motion_from(self, best: Fastest, shortest: float = np.nan) -> Motion:
        """Return the answer as a motion through the stops; one that comes too late is infeasible.

        ``shortest`` is what the fastest takes, s, where a duration is asked for.
        """
        task, solution = self.stops.task, best.answer.solution
        motion = motion_of_answer(best)
        provenance = dict(motion.provenance)
        provenance["method"] = "time-optimal motion through stops"
        provenance["starts"] = starts_of(best.state, self.stops.rested)
        provenance["branches"] = branches(self.stops, best.state, solution)
        provenance["segments"] = [type(kind).__name__ if kind else "free" for kind in task.segments]
        outcome = motion.outcome
        late = self.duration is not None and self.duration < shortest * (1 - SEARCH.same)
        if motion.solved and late:
            advice = (
                f"The task cannot be done in {self.duration:g} s: the fastest motion that was "
                f"found takes {shortest:.6g} s."
            )
            outcome = replace(Outcome.of(Status.INFEASIBLE, advice), ledger=outcome.ledger)
        remark = _remark(provenance) + further_remarks(best)
        return replace(motion, remark=remark, outcome=outcome, provenance=provenance)


def branches(stops: StopProblem, state: SearchState, solution: Solution) -> list[dict[str, Any]]:
    """Return what every way through the branches took on the coarse mesh, the one taken first."""
    via = _poses(solution)
    best: dict[str, dict[str, Any]] = {}
    for answer in state.of("start"):
        way, coarse = answer.origin, answer.solution
        entry = {
            "branches": list(way.branches),
            "q": way.via.tolist(),
            "duration": coarse.duration + stops.rested if answer.solved else None,
            "status": str(coarse.status),
            "taken": False,
            "apart": float(np.abs(_poses(coarse) - via).max()),
        }
        before = best.get(way.name)
        longest = np.inf
        if before is None or (before["duration"] or longest) > (entry["duration"] or longest):
            best[way.name] = entry
    rows = sorted(best.values(), key=lambda e: e.pop("apart"))
    rows[0]["taken"] = True
    rows = [rows[0], *sorted(rows[1:], key=lambda e: e["duration"] or np.inf)]
    for way in stops.ways:
        least = stops.least(state, way)
        if way.name not in best and least is not None:
            entry = {"branches": list(way.branches), "q": way.via.tolist(), "duration": None}
            rows.append(
                entry | {"status": LEFT_OUT, "taken": False, "at_least": least + stops.rested}
            )
    return rows


def _remark(provenance: dict[str, Any]) -> str:
    """Say what other ways of reaching the stops would take; both on the same coarse mesh."""
    taken, *others = provenance["branches"]
    if not others:
        return "the arm reaches the stops in one way only"
    parts = [f"the best of {len(provenance['branches'])} ways in which the arm reaches the stops"]
    tried = [entry["duration"] for entry in others if entry["status"] != LEFT_OUT]
    solved = [duration for duration in tried if duration is not None]
    if solved and taken["duration"] is not None:
        longer = 100.0 * (min(solved) / taken["duration"] - 1.0)
        near = "the next one is about as fast"
        parts.append(near if longer < 0.05 else f"the next one takes {longer:.1f} % longer")
    if len(tried) > len(solved):
        parts.append(f"{len(tried) - len(solved)} led to no motion")
    if slow := [entry["at_least"] for entry in others if entry["status"] == LEFT_OUT]:
        parts.append(f"others need {min(slow):.3f} s or more at the highest joint velocities")
    return "; ".join(parts)


def fastest_through(
    task: Task,
    settings: TimeOptimalSettings,
    progress: StepProgress,
    duration: float | None = None,
) -> Motion:
    """Return the fastest motion of a task, or the one of least effort in ``duration`` s."""
    if settings.switching_times:
        raise InputError("switching_times are found for joint poses alone, not for stops")
    if duration is not None:
        checks.number("duration", duration, "s", above=0.0)
        if settings.slack:
            raise InputError("give a duration or a slack for less effort, not both")
    with settings.within(CELL_TIME_LIMIT):
        return StopSearch.of(task, settings, progress, duration).run()


def phase_shapes(solution: Solution) -> list[PiecewisePolynomial]:
    """Return the polynomial of every phase, from time 0 each."""
    return [polynomial(replace(solution, phases=(phase,))) for phase in solution.phases]


def _poses(solution: Solution) -> FloatArray:
    """Return joint poses [m,n] at the stops."""
    ends = [phase["q"][-1] for phase in solution.phases]
    return np.array([solution.phases[0]["q"][0], *ends])


def _along(curve: PiecewisePolynomial, s: FloatArray) -> FloatArray:
    return curve(s * curve.duration)


def guess_along(shape: PiecewisePolynomial) -> Guess:
    """Return a guess for a phase of this shape."""
    velocity = shape.derivative()
    curves = {"q": shape, "qd": velocity, "qdd": velocity.derivative()}
    return Guess(shape.duration, {key: partial(_along, curve) for key, curve in curves.items()})


def segment_timings(task: Task, way: Way, compiled: bool) -> tuple[PiecewisePolynomial | None, ...]:
    """Return the best timing from rest to rest of every segment of a way; None where there is
    none.
    """
    rows = zip(way.paths, task.payloads, strict=True)
    return tuple(
        _best_timing(payload.on(task.robot), path.tobytes(), len(path), compiled)
        for path, payload in rows
    )


@lru_cache(maxsize=1024)
def _best_timing(
    robot: Robot, path_bytes: bytes, count: int, compiled: bool
) -> PiecewisePolynomial | None:
    """Do as :func:`segment_timings`, of one path [count,n]; other orders of stops have it, too."""
    shape = spline(np.frombuffer(path_bytes).reshape(count, -1), np.linspace(0.0, 1.0, count))
    with contextlib.suppress(InputError):
        timing = time_path(robot, shape, grid=STOPS.timed, compiled=compiled)
        if timing.solved:
            motion = timing.motion()
            return PiecewisePolynomial(motion.t, pieces_of(motion))
    return None


def _slowed(robot: Robot, shape: PiecewisePolynomial) -> PiecewisePolynomial:
    """Return a shape slowed down until it keeps the limits of velocities, accelerations and
    torques.
    """
    family = LimitFamily.of(robot)
    keys = [key for key in family.of_order(1, 2, 3) if key != "taud"]
    for _ in range(STOPS.most_slowed):
        t, curves = np.linspace(0.0, shape.duration, 50), [shape]
        for _ in range(3):
            curves.append(curves[-1].derivative())
        use = family.use(MotionSamples(*(curve(t) for curve in curves)), keys)
        if all(float(share.max()) <= 1.0 for share in use.values()):
            break
        shape = shape.stretched(STOPS.slowed)
    return shape


def _check_velocities(task: Task) -> None:
    """Raise InputError where no branch at a stop gives the tool the velocity that is asked for."""
    robot = task.robot
    fastest = np.maximum(-robot.limits.qd_min, robot.limits.qd_max)
    for stop in task.stops:
        if stop.q is not None or stop.velocity is None or isinstance(stop.velocity, str):
            continue
        wanted = float(np.linalg.norm(stop.velocity))
        poses = few_poses(robot, stop)
        if poses is None or not wanted:
            continue
        slopes = [np.array(jacobian(robot)(q))[:3].T @ stop.velocity / wanted for q in poses]
        shares = np.abs(slopes)
        reached = np.multiply(shares, fastest, out=np.zeros_like(shares), where=shares > 0.0)
        most = float(reached.sum(axis=1).max())
        if wanted > most:
            raise InputError(
                f"stop {stop.name!r}: the velocity limits of the joints allow the tool at most "
                f"{most:.3g} m/s in that direction, not {wanted:.3g} m/s"
            )
