"""Free time-optimal motions among obstacles.

A planner finds joint paths around the obstacles. Each path, with a timing that keeps every limit,
is a motion that is proved to keep clear. The search for the fastest motion starts from these paths,
timed by reachability, one after another until one converges. The result is the motion found, or
a path with its best timing, if that is faster or the search failed or ran out of time.

Exact geometry decides: where it is known, paths and proofs use it. Capsules are the smooth
approximation in the nonlinear program, and may overlap as far as they do on the path. If the exact
check fails, the required capsule distance of that pair is raised and the program is solved again.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.codegen import compiles, interpreted
from microbot_ocp._base.outcome import Advice, Outcome
from microbot_ocp._base.status import Status
from microbot_ocp.limits import LIMIT_TOLERANCE, LimitFamily
from microbot_ocp.motion import Mark, Motion, dense_times, polynomial_of
from microbot_ocp.ocp.solution import StepProgress, quiet
from microbot_ocp.planning.free import InitialGuess, guesses_along, joined, known_ways, phase_names
from microbot_ocp.planning.path import LATER, PathTiming, check_path, time_path
from microbot_ocp.planning.search._branches import straight_way
from microbot_ocp.planning.search._guided import GuidedSearch, is_clear, poses_along
from microbot_ocp.planning.search._queue import Level, best_first
from microbot_ocp.planning.search._result import NONE_WITHIN, returned
from microbot_ocp.planning.search._settings import TimeOptimalSettings, reserving
from microbot_ocp.planning.search._through_stops import SolveRequest
from microbot_ocp.planning.task import Task, TaskScale, length_text
from microbot_ocp.planning.timing import PathTimingSettings, best_timing
from microbot_ocp.robot import Robot
from microbot_ocp.scene import (
    FIRST_SEARCHES,
    Clearance,
    Detour,
    Scene,
    Surroundings,
    clearance,
    detour,
    with_arm_capsules,
)
from microbot_ocp.trajectories import quintic, shortest_duration

DIFFERENT = 0.02  # relative difference of durations from which two timed paths are different
NOTHING_FASTER = "the search found nothing faster"
THE_MOTION = "the motion found"
AT_CORNERS = "path around obstacles, at rest at its corners"


@dataclass(frozen=True, eq=False)
class TimedPath:
    """A path around the obstacles with a timing; its motion is marked at the via points."""

    name: str
    motion: Motion


@dataclass(frozen=True, eq=False)
class ProvedPath(TimedPath):
    """A timed path within all limits, with the proof that it keeps clear."""

    clearance: Clearance

    @property
    def made_from(self) -> str:
        """Origin of the motion, for messages."""
        how = self.motion.provenance
        if how.get("method") == AT_CORNERS:
            return f"a {AT_CORNERS}"
        return how.get("made_from", "the best timing of a path around the obstacles")


@dataclass(eq=False)
class WayAround:
    """A way from one pose to another around the obstacles, and its timings."""

    family: LimitFamily
    settings: TimeOptimalSettings
    detour: Detour

    @cached_property
    def reached(self) -> PathTiming | None:
        """Best timing under the limits of reachability; None if the path leaves the position
        limits, or if the arm cannot hold one of its poses.
        """
        path = self.detour.path
        assert path is not None
        with suppress(InputError):
            timing = time_path(self.family.robot, path, compiled=self.settings.compiled)
            return timing if timing.solved else None
        return None

    @property
    def bound(self) -> float:
        """Lower bound on the duration, s: reachability leaves out some limits, such as rates."""
        return np.inf if self.reached is None else self.reached.duration

    @property
    def kept(self) -> Motion | None:
        """Motion of the best timing, if reachability covers every limit; None otherwise."""
        timing = self.reached
        if timing is None or self.family.jerk_matters or timing.limits_kept_by[LATER]:
            return None
        return timing.motion("timed path")

    @cached_property
    def motion(self) -> Motion | None:
        """Motion of the best timing within all limits; None if none is found in time."""
        best = self.kept
        if best is not None or deadline.over():
            return best
        path = self.detour.path
        assert path is not None
        with suppress(InputError):
            check_path(self.family, path)
            request = PathTimingSettings(
                limit_tolerance=self.settings.limit_tolerance, compiled=self.settings.compiled
            )
            motion = best_timing(self.family, path, request, "timed path", quiet)
            if motion.solved and _keeps_limits(self.family, motion):
                return motion
        return None if deadline.over() else _resting_at_corners(self.family, self.detour)


@dataclass(eq=False)
class Leg:
    """Ways from one pose [n] to another, found by numbered searches.

    Attributes
    ----------
    ways : list of WayAround
        Ways; the first is feasible within the limits.
    failed : list of Detour
        Searches without a feasible way.
    first_motion : Motion or None
        First way with a timing within all limits, available at once: the best timing, or one that
        rests at every corner if the best takes long to compute.
    certified : float
        Processor time, s, at which a motion along all legs was first proved clear.
    refused : bool
        True if a way was infeasible within the limits.
    searches : int
        Number of searches made.
    """

    around: Surroundings
    start: FloatArray
    goal: FloatArray
    settings: TimeOptimalSettings
    ways: list[WayAround] = field(default_factory=list)
    failed: list[Detour] = field(default_factory=list)
    first_motion: Motion | None = None
    certified: float = np.inf
    refused: bool = False
    searches: int = 0

    def search(self, number: int, progress: StepProgress) -> None:
        """Make the search with this number, unless it was made before or is needless."""
        routes = [*(way.detour for way in self.ways), *self.failed]
        straight = any(candidate.name == "straight" for candidate in routes)
        # A free straight path, or a motion after the first searches, makes this search needless.
        if number < self.searches or straight or (number >= FIRST_SEARCHES and self.first_motion):
            return
        self.searches = number + 1
        candidate = detour(self.around, self.start, self.goal, self.settings.seed, number)
        if candidate.path is None:
            self.failed.append(candidate)
            progress(f"search {number}: no path in {candidate.checks} poses")
            return
        family = LimitFamily.of(self.around.robot)
        way = WayAround(family, self.settings, candidate)
        # The first way gives a certified motion as soon as possible; its best timing may take
        # longer than the search for others.
        if self.first_motion is None:
            self.first_motion = way.kept or _resting_at_corners(family, candidate)
        if self.first_motion is None:
            self.refused = True
            self.failed.append(candidate)
        else:
            self.ways.append(way)

    def way(self, choice: int) -> WayAround:
        """Return the way of a number; the last one if there are fewer."""
        return self.ways[min(choice, len(self.ways) - 1)]

    def bound(self, choice: int) -> float:
        """Return a lower bound on the duration of a way, s."""
        return self.way(choice).bound

    def guess(self, choice: int) -> Motion | None:
        """Return the start of a search: a way timed under the limits of reachability."""
        timing = self.way(choice).reached
        return self.motion(choice) if timing is None else timing.motion("timed path")

    def motion(self, choice: int) -> Motion | None:
        """Return a way with its best timing within all limits; None if none is found in time."""
        way = self.way(choice)
        return way.motion or (self.first_motion if way is self.ways[0] else None)


def _resting_at_corners(family: LimitFamily, way: Detour) -> Motion | None:
    """Return a motion along a polyline that rests at its corners; None if limits forbid it."""
    robot: Robot = family.robot
    # A quintic from rest to rest has zero velocity at both ends, so the polyline is followed
    # exactly and keeps the proof of the path.
    assert way.corners is not None
    ends = itertools.pairwise(way.corners)
    shapes = [quintic(pair, [0.0, 1.0], np.zeros((2, robot.joint_count))) for pair in ends]
    try:  # a loose tolerance suffices: the motion is only a fallback
        scaled = [shortest_duration(robot, path, tolerance=1e-3).polynomial for path in shapes]
    except InputError:  # the path leaves the position limits, or the arm cannot hold a pose
        return None
    how = {"method": AT_CORNERS}
    motion = Motion.from_polynomial(robot, joined(scaled), label="timed path", provenance=how)
    return motion if _keeps_limits(family, motion) else None


def _keeps_limits(family: LimitFamily, motion: Motion) -> bool:
    dense = motion.samples(dense_times(motion)[0])
    return bool(family.excess(dense).max() <= LIMIT_TOLERANCE)


def search_legs(
    ways: Sequence[Sequence[Leg]], progress: StepProgress, searches: int = FIRST_SEARCHES
) -> None:
    """Search for paths on the legs of several ways.

    Each leg gets at least ``searches`` searches. If no way is feasible on all of its legs, further
    searches follow until one is or the time is over.
    """
    with reserving():
        for number in itertools.count():
            for leg in itertools.chain(*ways):
                leg.search(number, progress)
                if deadline.over():
                    return
            # One complete way ends the searches; without one they go on, because a path may be
            # found by the next seed.
            is_there = any(all(leg.first_motion for leg in legs) for legs in ways)
            if is_there and number + 1 >= searches:
                return


def choices_of(legs: Sequence[Leg]) -> range:
    """Return the numbers of the ways along all legs; empty if a leg has no way."""
    there = all(leg.first_motion for leg in legs)
    # Choice k takes the k-th path of every leg: all combinations of n legs with k paths would be
    # k^n.
    return range(max((len(leg.ways) for leg in legs), default=1) if there else 0)


def differs(duration: float, others: Iterable[float]) -> bool:
    """Return True if a duration differs from all others, s, so that its path is a new one."""
    return all(abs(duration - other) > DIFFERENT * other for other in others)


@dataclass(frozen=True, eq=False)
class _Start:
    """A timed path as a candidate of the queue, with the motion and proof that a search found."""

    path: TimedPath
    duration: float
    level: Level = Level.TIMED
    motion: Motion | None = None
    proof: Clearance | None = None

    @property
    def keeps_limits(self) -> bool:
        """False for a motion that is not solved or not proved to keep clear."""
        return self.motion is None or (self.motion.solved and is_clear(self.proof))

    @property
    def fallback(self) -> ProvedPath | None:
        """Motion that keeps clear and the limits, but is not solved."""
        if self.motion is None or self.motion.solved or not is_clear(self.proof):
            return None
        return ProvedPath(self.path.name, self.motion, self.proof)


def fastest_among(
    request: SolveRequest, family: LimitFamily, via: FloatArray, names: Sequence[str] = ()
) -> Motion:
    """Return the fastest motion through via points [m,n], rad (m), that keeps clear of a scene.

    ``names`` are the names of the via points in messages.

    Raises
    ------
    InputError
        A via point is in collision, or OMPL or coal is not installed.
    """
    begin, begin_processor = time.perf_counter(), deadline.processor_time()
    settings, progress, scene = request.settings, request.progress, request.scene
    assert scene is not None
    robot: Robot = with_arm_capsules(family.robot)
    family = LimitFamily.of(robot)
    around = Surroundings(robot, scene)
    names = names or ["start", *(f"via point {k}" for k in range(2, len(via))), "goal"]
    check_apart(around, via, names)
    legs = legs_between(around, via, settings, progress)
    planned = time.perf_counter()
    task, tried = Task.through(family, via), list[TimedPath]()

    def raised(start: _Start, _: float) -> list[_Start]:
        tried.append(start.path)
        progress(f"{start.path.name}: {start.duration:.4f} s by reachability")
        front, proofs = _guided(request, task, scene, start.path).motions()
        motions = front[0]
        if not motions:
            return []
        motion, proof = motions[0][1], proofs[0]
        if not motion.solved and is_clear(proof):
            motion = replace(motion, provenance={"made_from": THE_MOTION, **motion.provenance})
        given = {"duration": motion.duration, "motion": motion, "proof": proof}
        return [replace(start, level=Level.FINISHED, **given)]

    starts = [_Start(path, path.motion.duration) for path in starts_of(legs)]
    finished = sorted(best_first(starts, raised), key=lambda f: (not f.keeps_limits, f.duration))
    search, proof = (finished[0].motion, finished[0].proof) if finished else (None, None)
    below = finished[0].duration if finished and finished[0].keeps_limits else None
    proved_paths = [proved for f in finished if (proved := f.fallback) is not None]
    # Other paths are timed only if their lower bound is below the duration of the motion found.
    names_tried = () if below is None else [path.name for path in tried]
    paths = [*proved_paths, *timed_paths(around, legs, progress, below=below, tried=names_tried)]
    more: dict[str, Any] = {
        "scene": list(scene.names),
        "paths": [{"start": p.name, "duration": p.motion.duration} for p in tried],
        "planning_time": planned - begin,
    }
    if paths or below is not None:
        # Processor time, which does not depend on other programs of the machine.
        more["first_certified"] = legs[0].certified - begin_processor
        fallback = min(paths, key=lambda path: path.motion.duration, default=None)
        is_fallback = any(path.motion is search for path in proved_paths)
        best = at_least(fallback, search, None if is_fallback else proof)
    else:
        with interpreted():  # compilation does not pay for one motion, often after the deadline
            motion = _ignoring(family, via, settings)
        proof = clearance(robot, motion, scene)
        best = not_found(motion, nothing_found(legs, names), proof)
    more["wall_time"] = time.perf_counter() - begin
    return replace(best, provenance={**best.provenance, **more})


def at_least(fallback: ProvedPath | None, motion: Motion | None, proof: Clearance | None) -> Motion:
    """Return the motion of a search, or else the fallback.

    The motion counts if it is proved clear, and is faster than the fallback, of less effort, or not
    solved. The fallback is a timed path, or a motion of the search slowed down at limits.
    """
    if motion is not None:
        faster = fallback is None or motion.duration < fallback.motion.duration
        faster = faster or "least_effort" in motion.provenance
        if is_clear(proof) and (faster or not motion.solved):
            provenance = {**motion.provenance, "clearance": as_plain(proof)}
            return replace(motion, provenance=provenance)
    assert fallback is not None
    outcome = _outcome_of(fallback, motion, proof)
    remark = f"{fallback.made_from}: {outcome.text}"
    if not outcome.solved:
        outcome = outcome.and_(returned(fallback.made_from))
    return replace(fallback.motion, label="time-optimal", remark=remark).ended(
        outcome, made_from=fallback.made_from, clearance=as_plain(fallback.clearance)
    )


def _outcome_of(fallback: ProvedPath, motion: Motion | None, proof: Clearance | None) -> Outcome:
    """Return the outcome of a search whose motion is replaced by a fallback."""
    if motion is None:
        return Outcome.of(deadline.status())
    outcome, ledger = motion.outcome, motion.outcome.ledger.discarded()
    is_timed_path = "made_from" not in fallback.motion.provenance
    # A timed path obeys every limit of the search, so the search should not end slower.
    slower = is_timed_path and motion.duration >= fallback.motion.duration
    if slower and outcome.status is Status.LIMITS_EXCEEDED:  # the faster path keeps the limits
        outcome = Outcome.of(Status.SOLVED, NOTHING_FASTER)
    if is_clear(proof):
        outcome = Outcome.of(outcome.status, NOTHING_FASTER)
        if deadline.over():
            outcome = Outcome.of(deadline.status())
    elif proof is not None:
        outcome = Outcome.of(Status.NOT_ACCEPTED, proof.sentence)
    elif outcome.status in (Status.INFEASIBLE, Status.LIMITS_EXCEEDED):  # the fallback is feasible
        outcome = Outcome.of(Status.FAILED, NONE_WITHIN)
    if motion is fallback.motion:
        ledger = motion.outcome.ledger
        if motion.status in (Status.INFEASIBLE, Status.LIMITS_EXCEEDED):
            outcome = Outcome.of(Status.NOT_ACCEPTED)  # within the tolerance of a certificate
    # The fallback is named by the caller, once.
    advice = tuple(row for row in outcome.advice if row.kind != "returned")
    return replace(outcome, advice=advice, ledger=ledger)


def not_found(motion: Motion, why: str, hit: Clearance) -> Motion:
    """Return a motion that ignores the obstacles, with its contact and the status "not found"."""
    advice = f"{why}. {Status.NOT_FOUND.sentence}\nReturned is a motion that ignores the obstacles."
    provenance = {"method": "free time-optimal motion among obstacles", **motion.provenance}
    outcome = Outcome.of(Status.NOT_FOUND, advice, Advice("contact", hit.sentence))
    unsolved = replace(motion, label="time-optimal", provenance=provenance)
    return unsolved.ended(outcome, clearance=as_plain(hit))


def check_apart(around: Surroundings, via: FloatArray, names: Sequence[str]) -> None:
    """Raise InputError if the arm touches something at a via point [m,n], rad (m)."""
    for name, q in zip(names, via, strict=True):
        contact = around.collision(q)
        if contact is not None:
            raise InputError(f"{name} {touching(contact, around.scene.clearance)}")


def touching(hit: Any, wanted: float) -> str:
    other, link = hit.pair.other.name, hit.pair.capsule.name
    if hit.distance <= 0.0:
        sentence = (
            f"in collision with {other!r} by {length_text(abs(hit.distance))} at link {link!r}"
        )
        # Capsules stand out from the meshes of links that they enclose: at a contact within that
        # excess the meshes may not touch.
        excess = sum(getattr(shape, "excess", 0.0) for shape in (hit.pair.capsule, hit.pair.other))
        if -hit.distance < excess:
            sentence += (
                f", whose capsules stand out by up to {length_text(excess)}: the link itself may "
                "be free there; closer ones: robot.with_capsules(mo.fit_capsules(robot, most=4))"
            )
        return sentence
    return (
        f"too near to {other!r}: {length_text(hit.distance)} at link {link!r}, not more than the "
        f"clearance of {length_text(wanted)}"
    )


def legs_between(
    around: Surroundings, via: FloatArray, settings: TimeOptimalSettings, progress: StepProgress
) -> list[Leg]:
    """Return the legs from each via point [m,n] to the next, with their ways.

    The first way through all legs is timed and proved before others are searched for.
    """
    legs = [Leg(around, start, end, settings) for start, end in itertools.pairwise(via)]
    search_legs([legs], progress, searches=1)
    first = _proved(around, legs, 0, [leg.first_motion for leg in legs])
    if first is not None:
        progress(f"path {first.name}: {first.motion.duration:.4f} s, the first that is known")
    search_legs([legs], progress)
    return legs


def starts_of(legs: Sequence[Leg]) -> Iterator[TimedPath]:
    """Yield different ways through via points as starts of a search, the fastest first."""
    durations: list[float] = []
    for choice in _by_bound(legs):
        path = _joined(legs, choice, (leg.guess(choice) for leg in legs))
        if path is not None and differs(path.motion.duration, durations):
            durations.append(path.motion.duration)
            yield path


def timed_paths(
    around: Surroundings,
    legs: Sequence[Leg],
    progress: StepProgress,
    below: float | None = None,
    tried: Sequence[str] = (),
) -> Iterator[ProvedPath]:
    """Yield different ways through via points with a timing within all limits, and proofs.

    Ways come in the order of their lower bounds. With ``below``, s, only ways with a smaller bound
    are timed, and none named in ``tried``. After the time limit one way is enough.
    """
    durations: list[float] = []
    for choice in _by_bound(legs):
        if durations and deadline.over():
            return
        if below is not None and sum(leg.bound(choice) for leg in legs) >= below:
            return
        if _name(legs, choice) in tried:
            continue
        timed = _proved(around, legs, choice, (leg.motion(choice) for leg in legs))
        if timed is not None and differs(timed.motion.duration, durations):
            durations.append(timed.motion.duration)
            progress(f"path {timed.name}: {durations[-1]:.4f} s with its best timing")
            yield timed


def _by_bound(legs: Sequence[Leg]) -> list[int]:
    return sorted(choices_of(legs), key=lambda choice: sum(leg.bound(choice) for leg in legs))


def _proved(
    around: Surroundings, legs: Sequence[Leg], choice: int, timed: Iterable[Motion | None]
) -> ProvedPath | None:
    """Return a way with a timing of each leg, at rest at via points; None if not proved clear."""
    path = _joined(legs, choice, timed)
    proof = None if path is None else clearance(around.robot, path.motion, around.scene)
    if path is None or proof is None or not proof.proved:
        return None
    for leg in legs:
        leg.certified = min(leg.certified, deadline.processor_time())
    return ProvedPath(path.name, path.motion, proof)


def _joined(legs: Sequence[Leg], choice: int, timed: Iterable[Motion | None]) -> TimedPath | None:
    """Return the motions of all legs one after another; None if one is missing.

    The timings are lazy: none is computed after a missing one.
    """
    motions = list[Motion]()
    for motion in timed:
        if motion is None:
            return None
        motions.append(motion)
    times, whole = np.cumsum([0.0, *(m.duration for m in motions)]), motions[0]
    if len(motions) > 1:
        shape = joined([polynomial_of(m) for m in motions])
        robot, how = legs[0].around.robot, whole.provenance
        whole = Motion.from_polynomial(robot, shape, label="timed path", provenance=how)
    marks = tuple(Mark(float(t), f"via {i + 1}") for i, t in enumerate(times))
    return TimedPath(_name(legs, choice), replace(whole, marks=marks))


def _name(legs: Sequence[Leg], choice: int) -> str:
    return "path " + ", ".join(leg.way(choice).detour.name for leg in legs)


def _guided(request: SolveRequest, task: Task, scene: Scene, path: TimedPath) -> GuidedSearch:
    """Return the search that starts from a timed path."""
    via = np.array([stop.q for stop in task.stops])
    shape = polynomial_of(path.motion)
    times = np.array([mark.time for mark in path.motion.marks])
    start = InitialGuess(path.name, guesses_along(phase_names(len(via) - 1), shape, times))
    poses = tuple(poses_along(shape, *pair) for pair in itertools.pairwise(times))
    return GuidedSearch(request, task, scene, straight_way(via), start, poses)


def as_plain(clearance: Clearance) -> dict[str, Any]:
    names = ("minimum", "time", "pair", "proved", "at_least")
    return {name: getattr(clearance, name) for name in names}


def nothing_found(legs: Sequence[Leg | None], names: Sequence[str]) -> str:
    """Return the reason why no free leg between poses of these names has a timed path."""
    missing = next((k for k, leg in enumerate(legs) if leg and leg.first_motion is None), 0)
    leg = legs[missing]
    if leg is None or leg.first_motion is not None or leg.refused:
        return "no path around the obstacles that was found can be travelled within the limits"
    failed, start, end = leg.failed, names[missing], names[missing + 1]
    poses = sum(search.checks for search in failed)
    sentence = f"no path from the {start} to the {end} was found in {poses} poses"
    if not failed:
        return sentence
    left = np.degrees(min(search.left for search in failed))
    return f"{sentence}; the search came within {left:.3g} deg (in joint space) of the {end}"


def _ignoring(family: LimitFamily, via: FloatArray, settings: TimeOptimalSettings) -> Motion:
    unhindered = known_ways(family, via, settings.limit_tolerance, compiles(settings.compiled))
    if unhindered is not None:
        return unhindered.motion
    times = np.cumsum([0.0, *TaskScale.of(family, via).durations])
    shape = quintic(via, times, np.zeros_like(via))
    return Motion.from_polynomial(family.robot, shape, label="time-optimal")
