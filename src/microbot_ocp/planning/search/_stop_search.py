"""The fastest motion through stops, the one of least effort in a given time, and fronts of both.

As :class:`FreeSearch`, but every segment has the limits and the payload that hold on it, and the
search starts from the ways through every branch of the inverse kinematics.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.status import Status
from microbot_ocp.limits import LimitFamily, MotionSamples
from microbot_ocp.motion import Mark, Motion, PiecewisePolynomial, State, pieces_of, torque_along
from microbot_ocp.ocp import Solution
from microbot_ocp.ocp.solution import StepProgress
from microbot_ocp.ocp.transcription import Guess, Transcription
from microbot_ocp.planning.free import (
    InitialGuess,
    excess_along,
    initial_guesses,
    known_ways,
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
from microbot_ocp.planning.search._free_search import (
    KEEPS_LIMITS,
    SEARCH,
    FreeSearch,
    TimeOptimalSettings,
    sparing,
)
from microbot_ocp.planning.task import (
    CELL_TIME_LIMIT,
    LDL,
    Conditions,
    Task,
    TaskScale,
    with_locked_joints_held,
    with_torques,
)
from microbot_ocp.robot import Robot, jacobian
from microbot_ocp.trajectories import spline


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


def fastest_through(
    task: Task,
    settings: TimeOptimalSettings,
    progress: StepProgress,
    duration: float | None = None,
) -> Motion:
    """The fastest motion of a task, or the one of least effort in ``duration`` s."""
    if settings.switching_times:
        raise InputError("switching_times are found for joint poses alone, not for stops")
    if duration is not None:
        checks.number("duration", duration, "s", above=0.0)
        if settings.slack:
            raise InputError("give a duration or a slack for less effort, not both")
    with settings.within(CELL_TIME_LIMIT):
        return StopSearch(task, settings, progress, duration).run()


class StopSearch(FreeSearch):
    """Ways through every branch on a coarse mesh, the best refined until limits hold."""

    slows_down = False  # velocities and cycles at stops are given

    def __init__(
        self,
        task: Task,
        settings: TimeOptimalSettings,
        progress: StepProgress,
        duration: float | None,
        ways: Sequence[Way] = (),
    ) -> None:
        self.task = task
        _check_velocities(task)
        if duration is not None and (least := least_duration(task)) > duration:
            raise InputError(
                f"duration must be at least the {least:.4g} s that the velocity limits ask for, "
                f"not {duration:g} s"
            )
        self.ways = list(ways) or ways_through(task)
        self.allowed = duration
        self.shortest = np.nan  # s, dwells included
        self.led_to: list[tuple[Way, str, Solution]] = []
        self.tried: list[dict[str, Any]] = []
        self.found: list[Solution] = []
        self.beaten = np.inf  # s, dwells not included: another order takes so long
        self.briefly = False  # whether only what is needed to compare orders is tried
        self.left_out: dict[str, tuple[Way, float]] = {}
        super().__init__(task.family, self.ways[0].via, settings, progress)

    def _kernels(self, budgeted: bool = False) -> Transcription:
        held = [with_locked_joints_held(family).robot for family in self.task.families]
        told = self.task.conditions
        conditions = Conditions(tuple(held), told.ends, told.closed)
        base: Any = with_locked_joints_held(self.family).robot
        return transcription(
            base,
            self.via.tobytes(),
            len(self.via),
            self.settings.compiled,
            budgeted=budgeted,
            conditions=conditions,
        )

    # starts ---------------------------------------------------------------------------------

    def _explore(self) -> tuple[list[dict[str, Any]], list[Solution]]:
        """What every way led to on a coarse mesh, and some others beside the best of them."""
        solver = ("fatrop", "ipopt") if self.settings.solver == "auto" else self.settings.solver
        coarse = self._coarse_refiner
        brief = replace(
            self.refiner.settings,
            max_iterations=STOPS.most_iterations,
            # IPOPT solves what takes it more
            options={**LDL, "fatrop": {"max_iter": SEARCH.least_iterations}},
        )
        tried, found = self.tried, self.found
        for way, guess in self._all_guesses():
            if any(guess.name == said["start"] for said in tried):
                continue  # when orders were compared
            solved = [s for s in found if s.status.solved]
            most = STOPS.most_iterations
            if solved:
                allowed = SEARCH.patience * max(s.attempts[-1].iterations for s in solved)
                most = min(max(SEARCH.least_iterations, allowed), most)
            explorer = replace(coarse, settings=replace(brief, max_iterations=most))
            guesses = {name: self._with_closed(name, g) for name, g in guess.guesses.items()}
            solution = explorer.solve(
                self._explore_mesh,
                guesses,
                tolerance=SEARCH.explore_tolerance,
                solver=solver,
            )
            said = {
                "start": guess.name,
                "status": str(solution.status),
                "duration": solution.duration + float(self.task.dwells.sum()),
            }
            tried.append(said)
            found.append(solution)
            self.led_to.append((way, guess.name, solution))
            self.progress(f"start {guess.name}: {said['duration']:.4f} s, {solution.status}")
            if solution.status is Status.INTERRUPTED or deadline.over():
                break
        return tried, found

    def coarse_duration(self, beaten: float = np.inf) -> float:
        """What the best coarse answer takes, s; infinite where there is none.

        Parameters
        ----------
        beaten : float
            What another order of the stops takes, s: ways that cannot be faster are left out.
        """
        rested = float(self.task.dwells.sum())
        self.beaten, self.briefly = beaten - rested, True
        self._explore()
        self.beaten, self.briefly = np.inf, False
        durations = [led.duration for led in self.found if led.status.solved]
        return min(durations, default=np.inf) + rested

    def _all_guesses(self) -> Iterator[tuple[Way, InitialGuess]]:
        for way in self.ways if self.settings.starts > 1 else self.ways[:1]:
            if not self._leaves_out(way):
                yield way, self._rest_to_rest(way)
        if not self.led_to:
            return
        best = min(
            self.led_to,
            key=lambda told: (not told[2].status.solved, told[2].duration),
        )[0]
        if self.briefly or any(kind is not None for kind in self.task.segments):
            return
        further = min(STOPS.bows, self.settings.starts - 1) + 1
        others = initial_guesses(self.family, best.via, self.names, further, self.settings.seed)
        if self.settings.starts > 1:
            yield from ((best, replace(g, name=f"{best.name}, {g.name}")) for g in others)

    def _leaves_out(self, way: Way) -> bool:
        """Whether a way needs more time at the highest velocities than another one takes."""
        durations = [led.duration for _, _, led in self.led_to if led.status.solved]
        exact = all(few_poses(self.robot, stop) is not None for stop in self.task.stops)
        least = least_time(self.task, way)
        if least <= (1.0 if exact else STOPS.spare) * min([*durations, self.beaten]):
            return False
        self.left_out[way.name] = way, least
        return True

    def _rest_to_rest(self, way: Way) -> InitialGuess:
        """Every segment from rest to rest, with its best timing where its path can be travelled."""
        guesses = {}
        durations = TaskScale.of(self.family, way.via).durations
        timings = segment_timings(self.task, way, self.settings.compiled)
        rows = zip(self.names, way.paths, self.task.payloads, durations, timings, strict=True)
        for name, path, payload, duration, timed in rows:
            shape = spline(path, np.linspace(0.0, float(duration), len(path)))
            guesses[name] = guess_along(timed or _slowed(payload.on(self.robot), shape))
        return InitialGuess(way.name, guesses)

    def _with_closed(self, name: str, guess: Guess) -> Guess:
        """A guess of the first phase with the values at its start that the last one returns to."""
        if name != self.names[0] or not self.task.conditions.closed:
            return guess
        start = np.zeros(1)
        added = {}
        for key in self.task.conditions.closed:
            value = guess.values[key]
            given = np.asarray(value(start) if callable(value) else value, dtype=float)
            given = np.broadcast_to(given.ravel(), (self.robot.joint_count,))
            added[f"{key} at the start of {name!r}"] = given.copy()
        return Guess(guess.duration, {**guess.values, **added})

    # refinement -----------------------------------------------------------------------------

    def _finish(self, found: list[Solution]) -> Solution:
        fastest = super()._finish(found)
        rested = float(self.task.dwells.sum())
        self.shortest = fastest.duration + rested
        if self.allowed is not None and fastest.status.solved:
            slack = (self.allowed - rested) / fastest.duration - 1.0
            if slack > 0.0:
                self.settings = replace(self.settings, slack=min(slack, STOPS.slowest))
        return fastest

    def _excess(self, solution: Solution) -> list[FloatArray]:
        return _excess_of(self.task.families, solution)

    def _guess_from(self, solution: Solution) -> dict[str, Guess]:
        shapes = zip(self.names, phase_shapes(solution), strict=True)
        return {name: self._with_closed(name, guess_along(shape)) for name, shape in shapes}

    def effort_front(self, slacks: Sequence[float]) -> tuple[list[tuple[float, Motion]], str]:
        """Effort and motion of the fastest, and of those of least effort that are slower by shares.

        Each starts from the one before it.
        """
        starts, fastest, wall = self._first()
        solution, shared = fastest, (starts, wall)
        made = [(self._effort(fastest), self._motion(fastest, *shared))]
        for slack in sorted(slacks) if fastest.status.solved else ():
            share = (1.0 + slack) * fastest.duration / solution.duration - 1.0
            self.settings = replace(self.settings, slack=share)
            solution = self._calmer(solution)
            made.append((self._effort(solution), self._motion(solution, *shared)))
        return made, ""

    def torque_front(self, shares: Sequence[float]) -> tuple[list[tuple[float, Motion]], str]:
        """Effort and motion of the fastest, and of the fastest with shares of the torques.

        Each starts from the one before it. The text says why the last shares have no motion.
        """
        starts, solution, wall = self._first()
        made = [(self._effort(solution), self._motion(solution, starts, wall))]
        before = 1.0
        for share in sorted(shares, reverse=True) if solution.status.solved else ():
            try:
                weaker = with_torques(self.task, share)
            except InputError as problem:
                return made, f"With {100 * share:.3g} % of the torques {problem}."
            search = self._again(weaker)
            search.led_to = self.led_to
            solution = search.slower(solution, float(np.sqrt(before / share)))
            before = share
            motion = search._motion(solution, starts, wall)
            if not motion.solved:
                why = motion.provenance["advice"] or motion.status.sentence
                return made, f"With {100 * share:.3g} % of the torques: {why}"
            made.append((self._effort(solution), motion))
        return made, ""

    def _again(self, task: Task) -> StopSearch:
        """A search for another task of the same ways."""
        return StopSearch(task, self.settings, self.progress, None, self.ways)

    def _first(self) -> tuple[list[dict[str, Any]], Solution, float]:
        begin = time.perf_counter()
        starts, fastest = self.search()
        return starts, fastest, time.perf_counter() - begin + self.kernel_time

    def slower(self, solution: Solution, factor: float) -> Solution:
        """The fastest motion, from another one slowed down; by a new search if that fails."""
        shapes = zip(self.names, phase_shapes(solution), strict=True)
        guesses = {
            name: self._with_closed(name, guess_along(shape.stretched(factor)))
            for name, shape in shapes
        }
        meshes = [phase.mesh for phase in solution.phases]
        found = self.refiner.solve(meshes, guesses, barrier=SEARCH.calmer_barrier)
        found = self.refiner.finished(self.refiner.refine(found))
        self.progress(f"slowed down: {found.duration:.6f} s, {found.status}")
        if self._rank(found)[0] is False:
            return found
        self.led_to, self.tried, self.found = [], [], []  # with other torques
        return self.search()[1]

    # result ---------------------------------------------------------------------------------

    def run(self) -> Motion:
        with sparing():
            motion = super().run()
        late = motion.status is Status.TIME_LIMIT
        slow = self._at_rest() if late and self.allowed is None else None
        if slow is None:
            return motion
        shapes, made_from = slow
        advice = f"{motion.provenance['advice']}\n{KEEPS_LIMITS.format(made_from)}"
        told = {**motion.provenance, "advice": advice, "made_from": made_from}
        return motion_of(self.task, shapes, told, f"not solved: {advice}")

    def _at_rest(self) -> tuple[list[PiecewisePolynomial], str] | None:
        """Segments that need no search, from rest to rest, where stops and segments allow them."""
        task = self.task
        moves = any(stop.velocity not in (None, "any", "rest") for stop in task.stops)
        if moves or task.around is not None or any(kind is not None for kind in task.segments):
            return None
        tolerance, via, shapes = self.settings.limit_tolerance, self.ways[0].via, []
        for k, family in enumerate(task.families):
            over = deadline.over()
            known = None if over else known_ways(family, via[k : k + 2], tolerance, self._fast)
            if known is None:
                return None
            shapes.append(PiecewisePolynomial(known.motion.t, pieces_of(known.motion)))
        return shapes, "a way that rests at every stop"

    def _motion(self, solution: Solution, starts: list[dict[str, Any]], wall: float) -> Motion:
        motion = super()._motion(solution, starts, wall)
        told = dict(motion.provenance)
        told["method"] = "time-optimal motion through stops"
        told["branches"] = self._branches(solution)
        told["segments"] = [type(kind).__name__ if kind else "free" for kind in self.task.segments]
        late = self.allowed is not None and self.allowed < self.shortest * (1 - SEARCH.same)
        if motion.solved and late:
            told["status"] = str(Status.INFEASIBLE)
            told["advice"] = (
                f"The task cannot be done in {self.allowed:g} s: the fastest motion that was found "
                f"takes {self.shortest:.6g} s."
            )
        note = self._note(told) if told["status"] == "solved" else f"not solved: {told['advice']}"
        return replace(motion, provenance=told, note=note + self._slack_note(solution))

    def _branches(self, solution: Solution) -> list[dict[str, Any]]:
        """What every way through the branches took on the coarse mesh, the one taken first."""
        rested = float(self.task.dwells.sum())
        via = _poses(solution)
        best: dict[str, dict[str, Any]] = {}
        for way, _, led in self.led_to:
            entry = {
                "branches": list(way.branches),
                "q": way.via.tolist(),
                "duration": led.duration + rested if led.status.solved else None,
                "status": str(led.status),
                "taken": False,
                "apart": float(np.abs(_poses(led) - via).max()),
            }
            known = best.get(way.name)
            slower = known is not None and (known["duration"] or np.inf) <= (
                entry["duration"] or np.inf
            )
            if not slower:
                best[way.name] = entry
        found = sorted(best.values(), key=lambda e: e.pop("apart"))
        found[0]["taken"] = True
        rows = [found[0], *sorted(found[1:], key=lambda e: e["duration"] or np.inf)]
        for way, least in self.left_out.values():
            if way.name not in best:
                entry = {"branches": list(way.branches), "q": way.via.tolist(), "duration": None}
                rows.append(
                    entry | {"status": LEFT_OUT, "taken": False, "at_least": least + rested}
                )
        return rows

    def _note(self, told: dict[str, Any]) -> str:
        taken, *others = told["branches"]
        named = "-".join(map(str, taken["branches"]))
        if not others:
            return "the only branch"
        tried = [e["duration"] for e in others if e["status"] != LEFT_OUT]
        costs = ", ".join(f"{value:.3f}" for value in tried[:5] if value is not None)
        said = [f"the others led to {costs or 'no motion'} s on the coarse mesh"] if tried else []
        slow = [e["at_least"] for e in others if e["status"] == LEFT_OUT]
        if slow:
            said.append(
                f"{len(slow)} left out: their joints need {min(slow):.3f} s and more at their "
                "highest velocities"
            )
        return "; ".join([f"branches {named}", *said])

    def _shaped(self, solution: Solution, provenance: dict[str, Any], note: str) -> Motion:
        return motion_of(self.task, phase_shapes(solution), provenance, note)


def phase_shapes(solution: Solution) -> list[PiecewisePolynomial]:
    """The polynomial of every phase, from time 0 each."""
    return [polynomial(replace(solution, phases=(phase,))) for phase in solution.phases]


def _excess_of(families: Sequence[LimitFamily], solution: Solution) -> list[FloatArray]:
    pairs = zip(families, phase_shapes(solution), strict=True)
    return [excess_along(family, shape) for family, shape in pairs]


def _poses(solution: Solution) -> FloatArray:
    """Joint poses [m,n] at the stops."""
    ends = [phase["q"][-1] for phase in solution.phases]
    return np.array([solution.phases[0]["q"][0], *ends])


def _along(curve: PiecewisePolynomial, s: FloatArray) -> FloatArray:
    return curve(s * curve.duration)


def guess_along(shape: PiecewisePolynomial) -> Guess:
    """A guess for a phase of this shape."""
    velocity = shape.derivative()
    curves = {"q": shape, "qd": velocity, "qdd": velocity.derivative()}
    return Guess(shape.duration, {key: partial(_along, curve) for key, curve in curves.items()})


def segment_timings(task: Task, way: Way, compiled: bool) -> tuple[PiecewisePolynomial | None, ...]:
    """The best timing from rest to rest of every segment of a way; None where there is none."""
    rows = zip(way.paths, task.payloads, strict=True)
    return tuple(
        _best_timing(payload.on(task.robot), path.tobytes(), len(path), compiled)
        for path, payload in rows
    )


@lru_cache(maxsize=1024)
def _best_timing(
    robot: Robot, path_bytes: bytes, count: int, compiled: bool
) -> PiecewisePolynomial | None:
    """As :func:`segment_timings`, of one path [count,n]; other orders of stops have it, too."""
    shape = spline(np.frombuffer(path_bytes).reshape(count, -1), np.linspace(0.0, 1.0, count))
    with contextlib.suppress(InputError):
        timing = time_path(robot, shape, grid=STOPS.timed, compiled=compiled)
        if timing.solved:
            motion = timing.motion()
            return PiecewisePolynomial(motion.t, pieces_of(motion))
    return None


def _slowed(robot: Robot, shape: PiecewisePolynomial) -> PiecewisePolynomial:
    """A shape slowed down until it keeps the limits of velocities, accelerations and torques."""
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


def motion_of(
    task: Task, shapes: Sequence[PiecewisePolynomial], provenance: dict[str, Any], note: str
) -> Motion:
    """The segments one after the other, with the dwells; torques with what the tool holds then."""
    breaks, pieces, marks = [np.zeros(1)], [], []
    changes: list[tuple[float, int]] = []  # from when on which segment's payload is held
    now = 0.0
    for k, stop in enumerate(task.stops):
        marks.append(Mark(now, stop.name))
        if task.dwells[k] > 0.0:
            at_start = k < len(shapes)
            shape = shapes[k] if at_start else shapes[-1]
            q = shape(0.0)[0] if at_start else shape(shape.breaks[-1])[0]
            held = np.zeros((1, 6, q.size))
            held[0, 0] = q
            pieces.append(held)
            now += float(task.dwells[k])
            breaks.append(np.array([now]))
        if k < len(shapes):
            changes.append((now, k))
            pieces.append(shapes[k].coefficients)
            breaks.append(now + shapes[k].breaks[1:])
            now = float(breaks[-1][-1])
    whole = PiecewisePolynomial(np.concatenate(breaks), np.concatenate(pieces))
    later = changes if task.cycle and changes[0][0] > 0.0 else changes[1:]  # what was held before
    jumps = [when for (when, k) in later if task.payloads[k] != task.payloads[k - 1]]
    motion = Motion.from_polynomial(
        task.robot,
        whole,
        label="time-optimal",
        marks=marks,
        provenance=provenance,
        note=note,
        jumps_at=jumps,
    )
    if not any(payload.mass for payload in task.payloads):
        return motion
    tau = np.array(motion.tau)
    for start, end, robot, _ in stretches(task, motion):
        here = (motion.t >= start) & ((motion.t < end) | (end == motion.duration))
        tau[here] = torque_along(robot, State(motion.q[here], motion.qd[here], motion.qdd[here]))
    return replace(motion, tau=tau)


class Stretch(NamedTuple):
    """A segment or a dwell of a motion: start and end, s, the robot that moves, with what it holds,
    and the segment, of a dwell the one before it.
    """

    start: float
    end: float
    robot: Robot
    segment: int


def stretches(task: Task, motion: Motion) -> list[Stretch]:
    """Every segment and dwell of a motion.

    The marks of the motion say when its stops are reached.

    Raises
    ------
    InputError
        A motion that has not one mark a stop.
    """
    if len(motion.marks) != len(task.stops):
        raise InputError(
            f"motion {motion.label!r} has {len(motion.marks)} marks, but the task "
            f"{len(task.stops)} stops: it is not a motion of this task"
        )
    found: list[Stretch] = []
    loads = (
        (task.payloads[-1], *task.payloads) if task.cycle else (task.payloads[0], *task.payloads)
    )
    times = [mark.time for mark in motion.marks]
    for k, arrives in enumerate(times):
        leaves = arrives + float(task.dwells[k])
        if leaves > arrives:
            rested: Robot = loads[k].on(task.robot)
            before = (k - 1) % len(task.segments) if task.cycle else max(k - 1, 0)
            found.append(Stretch(arrives, leaves, rested, before))
        if k < len(task.segments):
            found.append(Stretch(leaves, times[k + 1], task.robots[k], k))
    return found


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
