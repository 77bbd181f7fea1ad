"""Motions through via points or stops among obstacles, with the parts that the arm carries.

A way is one branch of the arm at every stop. A planner leads the blocked free segments of each way
around the obstacles, the most promising way first, and the search starts from these timed ways. On
every segment the arm and its payload keep clear.

Exact geometry decides: where it is known, paths and proofs use it. Capsules are the smooth
approximation in the nonlinear program, and may overlap as far as they do on the path. If the exact
check fails, the required capsule distance of that pair is raised and the program is solved again.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.codegen import interpreted
from microbot_ocp._base.status import Status
from microbot_ocp.limits import LIMIT_TOLERANCE, LimitFamily
from microbot_ocp.motion import Motion, PiecewisePolynomial, polynomial_of
from microbot_ocp.planning.free import InitialGuess, excess_along, guess_along, phase_names
from microbot_ocp.planning.search._branches import Way, bound_of, ways_through
from microbot_ocp.planning.search._guided import (
    CoarseResult,
    FrontFunction,
    GuidedSearch,
    is_clear,
    poses_along,
)
from microbot_ocp.planning.search._legs import (
    Leg,
    ProvedPath,
    as_plain,
    at_least,
    choices_of,
    differs,
    not_found,
    nothing_found,
    touching,
)
from microbot_ocp.planning.search._orders import (
    best_order,
    optimistic_duration_of,
    rest_duration_of,
    tasks_in_orders,
)
from microbot_ocp.planning.search._queue import Level, Queue
from microbot_ocp.planning.search._result import (
    LEFT_OUT,
    is_accepted,
    remark_of_branches,
    row_of_way,
    taken_first,
)
from microbot_ocp.planning.search._settings import SAME_OPTIMUM, reserving
from microbot_ocp.planning.search._starts import rest_to_rest, segment_timings
from microbot_ocp.planning.search._stop_motion import motion_of, places_along, scenes_of, tool_poses
from microbot_ocp.planning.search._through_stops import Front, SolveRequest
from microbot_ocp.planning.task import Stop, Task, TaskScale, one_remark
from microbot_ocp.robot import Capsule, Robot
from microbot_ocp.scene import (
    FIRST_SEARCHES,
    Clearance,
    Scene,
    Surroundings,
    clearance_along,
    with_arm_capsules,
)
from microbot_ocp.trajectories import quintic, shortest_duration


def stops_among(request: SolveRequest) -> Motion:
    """Return the fastest motion through stops that keeps clear of a scene.

    A free order of the stops is decided among the obstacles.

    Raises
    ------
    InputError
        At some stop every branch of the arm touches an obstacle.
    """
    request = replace(request, robot=with_arm_capsules(request.robot))
    if request.order == "given":
        (fastest, *_), _ = motions_among(request)
        return fastest[1]
    legs = LegPlanner(request)
    # A stop that is blocked without payloads is blocked in every order: report it at once.
    bare = [replace(s, payload=None) if isinstance(s, Stop) else s for s in request.stops]
    legs.clear_ways(replace(request, stops=bare).task())
    tasks = tasks_in_orders(request)
    legs.search(list(tasks.values()))
    return best_order(request, tasks, partial(_OrderAmongObstacles, request, legs))


def motions_among(request: SolveRequest, front_of: FrontFunction | None = None) -> Front:
    """Return the requested motions in a scene, by default the fastest one.

    Raises
    ------
    InputError
        As :func:`stops_among`.
    """
    request = replace(request, robot=with_arm_capsules(request.robot))
    return _OrderAmongObstacles(request, LegPlanner(request), request.task()).motions(front_of)


class GuidedWay(NamedTuple):
    """A way whose free segments lead around obstacles.

    Attributes
    ----------
    way : Way
    shapes : dict of str to PiecewisePolynomial
        Path of every free segment, timed from rest to rest under the limits of reachability.
    durations : list of float or None
        Duration of every segment, s; None if its timing failed.
    name : str
    legs : list of Leg or None
        Leg of every free segment.
    choice : int
        Number of the path that every leg takes.
    rest_duration : float
        Duration from rest to rest, s, with dwells.
    """

    way: Way
    shapes: dict[str, PiecewisePolynomial]
    durations: list[float | None]
    name: str
    legs: list[Leg | None]
    choice: int
    rest_duration: float


MOST_SEARCHES = FIRST_SEARCHES + 3  # searches for each leg of a way if none leads to a motion


@dataclass(frozen=True, eq=False)
class _Guided:
    """A way as a candidate of the queue: without a path, or along one around obstacles."""

    way: Way
    duration: float
    level: Level = Level.BOUND
    guide: GuidedWay | None = None
    searches: int = 1
    paths: int = 0  # number of paths of the way that are candidates of their own
    solved: bool = True
    front: Front = field(default_factory=lambda: ([], ""))
    proofs: list[Clearance | None] = field(default_factory=list)

    @property
    def keeps_limits(self) -> bool:
        """False for a motion that is not solved or not proved to keep clear."""
        return self.solved and np.isfinite(self.duration)

    @property
    def rank(self) -> tuple[bool, bool, float]:
        """Sort key: solved and clear motions first, then other clear ones; ties by duration."""
        # The first motion of a front decides: its other motions start from the first.
        return not self.keeps_limits, not any(map(is_clear, self.proofs[:1])), self.duration


class _OrderAmongObstacles:
    """One order of stops among obstacles."""

    def __init__(self, request: SolveRequest, legs: LegPlanner, task: Task) -> None:
        self._request, self.task, self._scene, self._legs = request, task, legs.scene, legs
        legs.search([task])
        self._searches: dict[str, GuidedSearch] = {}
        self._steps: list[tuple[str, CoarseResult]] = []

    @property
    def _coarse_results(self) -> dict[str, CoarseResult]:
        """Latest coarse answer along every guided way, by name, in the order of the first ones."""
        return dict(self._steps)

    @cached_property
    def _timed(self) -> list[GuidedWay]:
        """Paths of all ways whose lower bound is below the best timing from rest to rest."""
        guides, least = list[GuidedWay](), np.inf
        for way, _ in self._legs.ways(self.task):
            if bound_of(self.task, way) + float(self.task.dwells.sum()) < least:
                guides += self._legs.guides_of(self.task, way)
                least = min((guide.rest_duration for guide in guides), default=np.inf)
        return guides

    @property
    def rest_duration(self) -> float:
        """Least duration from rest to rest, s; infinite if no way was found."""
        return min((guide.rest_duration for guide in self._timed), default=np.inf)

    @property
    def optimistic_duration(self) -> float:
        """Estimate of the least duration from below, s; infinite if no way was found."""
        times = (optimistic_duration_of(self.task, guide.durations) for guide in self._timed)
        return min(times, default=np.inf)

    @cached_property
    def _fallback(self) -> ProvedPath | None:
        """Fastest way that rests at every stop, within all limits and proved clear, or None."""
        guides = sorted(self._legs.guides(self.task), key=lambda guide: guide.rest_duration)
        timed = (self._legs.timed(self.task, guide) for guide in guides)
        found = next((path for path in timed if path is not None), None)
        known = [path for path in (found, self._legs.known.get(self.task)) if path is not None]
        return min(known, key=lambda path: path.motion.duration, default=None)

    def _search(self, guide: GuidedWay) -> GuidedSearch:
        """Return the search along a guided way, cached."""
        if guide.name in self._searches:
            return self._searches[guide.name]
        task, way = self.task, guide.way
        names = phase_names(len(task.segments))
        usual = rest_to_rest(task, way, names, self._request.settings.compiled)
        around = {name: guess_along(shape) for name, shape in guide.shapes.items()}
        start = InitialGuess(guide.name, {**usual.guesses, **around})
        poses = tuple(
            poses_along(guide.shapes[name]) if name in guide.shapes else path
            for name, path in zip(names, way.paths, strict=True)
        )
        search = GuidedSearch(self._request, task, self._scene, way, start, poses)
        return self._searches.setdefault(guide.name, search)

    def _coarse(self, guide: GuidedWay) -> CoarseResult | None:
        """Return the first coarse answer along a way, or the next one if it needs a further one.

        None if the time limit has passed.
        """
        known = self._coarse_results.get(guide.name)
        if known is not None and known.further is None:
            return known
        with suppress(deadline.Over):
            search = self._search(guide)
            step = search.coarse_step() if known is None else search.next_step(known)
            self._steps.append((guide.name, step))
            return step
        return None

    def coarse_duration(self, duration_to_beat: float) -> float:
        """Return the least coarse duration of all ways on their fastest paths, s, with dwells."""
        dwell_time, least = float(self.task.dwells.sum()), np.inf
        for way, _ in self._legs.ways(self.task):
            most = min(duration_to_beat - dwell_time, least)
            if bound_of(self.task, way) > most or (np.isfinite(most) and deadline.over()):
                continue
            for guide in self._legs.guides_of(self.task, way)[:1]:
                result = self._coarse(guide)
                while result is not None and result.further is not None:
                    result = self._coarse(guide)
                least = min(least, np.inf if result is None else result.duration)
        return least + dwell_time

    def motion(self) -> Motion:
        return self.motions()[0][0][1]

    def motions(self, front_of: FrontFunction | None = None) -> Front:
        """Return the requested motions; the fallback replaces the first if the first is worse.

        The best coarse answer is refined; if it leads to no motion that is proved to keep clear,
        the next one follows.
        """
        found = self._found(front_of)
        # A solved and clear motion that is faster than any timed path needs no fallback.
        guides = self._legs.guides(self.task)
        rested = min((guide.rest_duration for guide in guides), default=np.inf)
        # Timings of paths leave out rates, so under those they are not faster in truth.
        rested = np.inf if self.task.family.jerk_matters else rested
        best = found is not None and found.keeps_limits and found.duration <= rested
        fallback = None if best else self._fallback
        front, proofs = (([], ""), []) if found is None else (found.front, found.proofs)
        branches = [] if found is None else self._branches(found.way)
        judged: list[tuple[float, Motion]] = []
        for place, ((effort, motion), proof) in enumerate(zip(front[0], proofs, strict=True)):
            remark = one_remark(remark_of_branches(branches), motion.remark)
            motion = replace(_with(motion, branches=branches), remark=remark)
            # Only the fastest motion has a fallback: motions of less effort start from the fastest.
            if place == 0 and (fallback is not None or is_clear(proof)):
                motion = at_least(fallback, motion, proof, self._request.duration)
                effort = np.nan if "made_from" in motion.provenance else effort
            elif proof is None or not proof.proved:
                motion = self._not_found(motion, proof)
            else:
                motion = _with(motion, clearance=as_plain(proof))
            judged.append((effort, motion))
        if not judged and fallback is not None:
            judged = [(np.nan, at_least(fallback, None, None, self._request.duration))]
        elif not judged:
            judged = [(np.nan, self._not_found(None, None))]
        paths = [{"start": guide.name, "duration": guide.rest_duration} for guide in guides]
        about = {"scene": list(self._scene.names), "paths": paths, **self._legs.times}
        return [(effort, _with(motion, **about)) for effort, motion in judged], front[1]

    def _found(self, front_of: FrontFunction | None) -> _Guided | None:
        """Return the way with the best of the requested motions, or None."""
        ways = (way for way, _ in self._legs.ways(self.task))
        queue = Queue(_Guided(way, bound_of(self.task, way)) for way in ways)
        for candidate in queue:
            known = candidate.guide and self._coarse_results.get(candidate.guide.name)
            expected = 0.0 if known else self._expected(candidate.way)
            if expected > candidate.duration:
                raised = [replace(candidate, duration=expected)]
            elif candidate.guide is None:
                raised = self._along_paths(candidate)
            elif known is None or known.further is not None:
                raised = self._on_coarse_mesh(candidate, candidate.guide, known)
            else:
                search, most = self._search(candidate.guide), queue.duration_to_beat
                raised = _finished(candidate, *search.motions(known, front_of, most))
            queue.put(raised, before=candidate)
        return min(queue.finished, key=lambda guided: guided.rank, default=None)

    def _along_paths(self, candidate: _Guided) -> list[_Guided]:
        """Return a way along each of its new paths around obstacles, and the way itself."""
        way, count = candidate.way, candidate.searches
        guides = self._legs.guides_of(self.task, way, count)
        # A motion may be far faster than the timing of its path from rest to rest, so each path is
        # bounded like its way.
        new = guides[candidate.paths :]
        along = [_Guided(way, candidate.duration, Level.TIMED, guide) for guide in new]
        if count == MOST_SEARCHES:
            return along
        # The last paths are searched for only if no way leads to a motion.
        further = {"searches": count + 1, "solved": count < FIRST_SEARCHES}
        return [*along, replace(candidate, paths=len(guides), **further)]

    def _on_coarse_mesh(
        self, candidate: _Guided, guide: GuidedWay, known: CoarseResult | None
    ) -> list[_Guided]:
        """Return a way with its next coarse answer."""
        # Poses of a redundant arm slide: several ways may lead to one optimum, which is raised
        # again only if nothing else leads to a motion.
        if known and candidate.solved and self._is_settled(known):
            return [replace(candidate, solved=False)]
        result = self._coarse(guide)
        if result is None:
            return []
        solved = not self._is_settled(result)
        return [replace(candidate, level=result.level, duration=result.duration, solved=solved)]

    def _is_settled(self, result: CoarseResult) -> bool:
        """Return True if another coarse answer is the same optimum and needs no further one.

        Of answers that only need a finer mesh the earliest one is refined.
        """
        steps = [step for _, step in self._steps]
        known = [other for other in steps if other.further is None]
        if result.further is not None:
            earlier = steps[: steps.index(result)]
            known += [other for other in earlier if other.only_refines]
        return any(other is not result and result.is_optimum_of(other) for other in known)

    def _expected(self, way: Way) -> float:
        """Return the duration expected of further paths of a way, s; zero if it is unknown.

        Paths of a way often lead to one optimum, so after a path that led to a known optimum the
        further ones are expected to lead there.
        """
        results = self._coarse_results
        tried = [result for name, result in results.items() if self._searches[name].way is way]
        others = (other for other in results.values() if other is not tried[-1])
        return tried[-1].duration if tried and any(map(tried[-1].is_optimum_of, others)) else 0.0

    def _branches(self, taken: Way) -> list[dict[str, Any]]:
        """Return the coarse duration of every way through the branches, the taken one first."""
        rows = list[dict[str, Any]]()
        dwell_time, guides = float(self.task.dwells.sum()), self._legs.guides(self.task)
        for way, legs in self._legs.ways(self.task):
            tried = [self._coarse_results.get(guide.name) for guide in guides if guide.way is way]
            durations = [result.duration for result in tried if result is not None]
            least = min(durations, default=np.inf)
            given: tuple[float | None, str] = None, str(Status.FAILED)
            more = dict[str, float]()
            if np.isfinite(least):
                given = least + dwell_time, str(Status.SOLVED)
            elif not durations and not any(leg and leg.is_blocked for leg in legs):
                given = None, LEFT_OUT
                more["at_least"] = bound_of(self.task, way) + dwell_time
            rows.append(row_of_way(way, *given, way is taken, **more))
        return sorted(rows, key=taken_first)

    def _not_found(self, attempt: Motion | None, proof: Clearance | None) -> Motion:
        """Return a motion that ignores the obstacles, with the status "not found"."""
        task, legs = self.task, self._legs
        way, parts = legs.ways(task)[0]
        if attempt is None:
            names = [f"stop {stop.name!r}" for stop in task.stops]
            free = [None if kind else leg for kind, leg in zip(task.segments, parts, strict=True)]
            why = nothing_found(free, names)
        else:
            why = attempt.advice if proof is None else proof.sentence
        with interpreted():  # compilation does not pay for one motion, often after the deadline
            shapes = [_unhindered(task, way, k) for k in range(len(task.segments))]
        motion = _joined(task, way, shapes)
        hit = clearance_along(places_along(task, motion, self._scene), motion)
        return not_found(motion, why, hit)


def _finished(candidate: _Guided, front: Front, proofs: list[Clearance | None]) -> list[_Guided]:
    """Return a way with its motions; nothing without any."""
    if not front[0]:
        return []
    motion = front[0][0][1]
    solved = is_accepted(motion) and is_clear(proofs[0])
    given = {"duration": motion.duration, "solved": solved, "front": front}
    return [replace(candidate, level=Level.FINISHED, proofs=proofs, **given)]


def _with(motion: Motion, **more: Any) -> Motion:
    return replace(motion, provenance={**motion.provenance, **more})


def _joined(task: Task, way: Way, shapes: Sequence[PiecewisePolynomial]) -> Motion:
    """Return segments one after another as a motion through the stops."""
    provenance = {
        "method": "path through stops, at rest at each of them",
        "branches": [{"branches": list(way.branches), "q": way.via.tolist(), "taken": True}],
        "segments": [type(kind).__name__ if kind else "free" for kind in task.segments],
    }
    return motion_of(task, shapes, provenance)


def _may_rest(stop: Stop) -> bool:
    """Return True if the arm may be at rest at a stop."""
    return stop.velocity is None or isinstance(stop.velocity, str) or not np.any(stop.velocity)


def _keeps_limits(robot: Robot, shape: PiecewisePolynomial) -> bool:
    return bool(excess_along(LimitFamily.of(robot), shape).max() <= LIMIT_TOLERANCE)


def _unhindered(task: Task, way: Way, index: int) -> PiecewisePolynomial:
    """Return a segment from rest to rest along its own path, within the limits if possible."""
    path = way.paths[index]
    shape = quintic(path, np.linspace(0.0, 1.0, len(path)))
    try:
        return shortest_duration(task.robots[index], shape, tolerance=SAME_OPTIMUM).polynomial
    except InputError:  # no duration keeps all limits
        typical = TaskScale.of(LimitFamily.of(task.payloads[index].on(task.robot)), path)
        return shape.stretched(float(typical.durations.sum()))


class LegPlanner:
    """Planner of paths between poses among obstacles, shared by all orders of the stops.

    Attributes
    ----------
    scene : Scene
    planning : float
        Wall time of the searches for paths, s.
    known : dict of Task to ProvedPath
        First motion of a task that was proved clear, for tasks with one.
    first_certified : float
        Processor time until a motion was first proved clear, s; infinite before that.
    """

    def __init__(self, request: SolveRequest) -> None:
        assert request.scene is not None
        self._begin, self._begin_processor = time.perf_counter(), deadline.processor_time()
        self.planning, self.first_certified = 0.0, np.inf
        self.known: dict[Task, ProvedPath] = {}
        self.scene, self._settings, self._progress = (
            request.scene,
            request.settings,
            request.progress,
        )
        self._surroundings: dict[Any, Surroundings] = {}
        self._legs: dict[Any, Leg] = {}
        self._ways: dict[Task, list[tuple[Way, list[Leg | None]]]] = {}
        self._guides: dict[tuple[Task, Way], list[GuidedWay]] = {}

    def search(self, tasks: Sequence[Task]) -> None:
        """Search for paths between the stops of several tasks until a motion is proved clear.

        The most promising way comes first. Without a proof the search ends after the first round in
        which some way is complete.
        """
        self._check_ignored(tasks)
        ways, refused = list[tuple[Task, Way, list[Leg | None]]](), None
        for task in tasks:
            try:
                ways += [(task, way, legs) for way, legs in self.ways(task)]
            except InputError as problem:  # another order may be feasible
                refused = refused or problem
        if refused is not None and not ways:
            raise refused
        ways.sort(key=lambda each: bound_of(*each[:2]))
        for number in itertools.count():
            complete = False
            for task, way, legs in ways:
                self._search_legs([leg for leg in legs if leg and not leg.ways], [number])
                if all(not leg or leg.ways for leg in legs):
                    complete = True
                    self._prove_first(task, way, legs)
                    if self.known:
                        return
            # The next seed may find a path, so without a complete way the searches go on.
            if complete or deadline.over():
                return

    def _check_ignored(self, tasks: Sequence[Task]) -> None:
        """Raise InputError for an ignored pair with an unknown link or body."""
        for task in tasks:
            carried = [capsule.name for held in task.robots for _, capsule in held.capsules]
            for name in sum(self.scene.ignore, ()):
                checks.one_of("name in ignore", name, sorted({*carried, *self.scene.names}))

    def _search_legs(self, legs: Iterable[Leg], numbers: Sequence[int]) -> None:
        begin = time.perf_counter()
        with reserving():
            for leg, number in itertools.product(legs, numbers):
                if not deadline.over():
                    leg.search(number, self._progress)
        self.planning += time.perf_counter() - begin

    def _prove_first(self, task: Task, way: Way, legs: Sequence[Leg | None]) -> None:
        """Prove the first timed paths of a way."""
        found = self._proved(task, way, [leg and leg.first_motion for leg in legs])
        if found is not None:
            self._progress(f"{found.motion.duration:.4f} s, the first motion that is known")

    @property
    def times(self) -> dict[str, float]:
        """Times of the record, s: planning and wall time, and processor time to a first proof."""
        times = {"planning_time": self.planning, "wall_time": time.perf_counter() - self._begin}
        known = {"first_certified": self.first_certified}
        return times | known if np.isfinite(self.first_certified) else times

    def ways(self, task: Task) -> list[tuple[Way, list[Leg | None]]]:
        """Return ways whose poses at the stops touch nothing, with the legs of their free segments.

        Raises
        ------
        InputError
            Every way touches something.
        """
        if task not in self._ways:
            clear = self.clear_ways(task)
            self._ways[task] = [(way, self._legs_of(task, way, places)) for way, places in clear]
        return self._ways[task]

    def clear_ways(self, task: Task) -> list[tuple[Way, list[Surroundings]]]:
        """Return ways without contact at the stops, with the obstacles of each segment."""
        clear, refused = [], []
        for way in ways_through(task, partial(self._is_free, task)):
            places = self._places(task, way)
            blocked = _blocked(task, places, way)
            if blocked:
                refused.append(blocked)
            else:
                clear.append((way, places))
        if not clear:
            raise InputError(refused[0])
        return clear

    def _is_free(self, task: Task, index: int, q: FloatArray) -> bool:
        """Return True if the arm is free in a pose [n] at a stop, apart from parts put down."""
        payloads = {task.payloads[k] for k in (index - 1, index) if 0 <= k < len(task.payloads)}
        robots = [payload.on(task.robot) for payload in payloads]
        return all(self._among(robot, self.scene).is_free(q) for robot in robots)

    def _places(self, task: Task, way: Way) -> list[Surroundings]:
        """Return the obstacles of every segment of a way; equal surroundings are one object.

        Collision models are expensive to build, and surroundings are part of the key of a leg.
        """
        scenes = scenes_of(task, self.scene, tool_poses(task.robot, way.via))
        rows = zip(task.payloads, scenes, strict=True)
        return [self._among(payload.on(task.robot), scene) for payload, scene in rows]

    def _among(self, robot: Robot, scene: Scene) -> Surroundings:
        """Return an arm with its payload in a scene, the given one with parts put down."""
        # Obstacles beyond the given ones are parts that the arm has put down.
        lying = [c for c in scene.obstacles[len(self.scene.obstacles) :] if type(c) is Capsule]
        parts = tuple((c.name, c.start.tobytes(), c.end.tobytes(), c.radius) for c in lying)
        # All segments share the given obstacles, so the lying parts complete the key.
        key = robot, parts, scene.ignore
        if key not in self._surroundings:
            self._surroundings[key] = Surroundings(robot, scene.without_parts_of(robot))
        return self._surroundings[key]

    def _legs_of(self, task: Task, way: Way, places: Sequence[Surroundings]) -> list[Leg | None]:
        legs: list[Leg | None] = []
        ends = itertools.pairwise(way.via)
        for kind, around, (start, goal) in zip(task.segments, places, ends, strict=True):
            key = around, start.tobytes(), goal.tobytes()
            if kind is None and key not in self._legs:
                self._legs[key] = Leg(around, start, goal, self._settings)
            legs.append(self._legs[key] if kind is None else None)
        return legs

    def guides(self, task: Task) -> list[GuidedWay]:
        """Return the guided ways of a task that are known so far, see :meth:`guides_of`."""
        return [guide for way, _ in self.ways(task) for guide in self._guides.get((task, way), ())]

    def guides_of(self, task: Task, way: Way, searches: int = FIRST_SEARCHES) -> list[GuidedWay]:
        """Return a way around the obstacles, along all paths after some searches for every leg.

        The paths of one call are sorted by their durations and follow those of earlier calls. The
        list is empty if a leg of the way has no path.
        """
        known, guides = self._guides.setdefault((task, way), []), list[GuidedWay]()
        legs = next(legs for other, legs in self.ways(task) if other is way)
        free = [leg for leg in legs if leg]
        names, usual = phase_names(len(task.segments)), self._usual(task, way)
        self._search_legs(free, range(searches))
        choices = choices_of(free)
        for choice in sorted(choices, key=lambda choice: sum(leg.bound(choice) for leg in free)):
            motions = [leg and leg.guess(choice) for leg in legs]
            if any(leg and not motion for leg, motion in zip(legs, motions, strict=True)):
                continue
            shapes = {
                name: polynomial_of(motion)
                for name, motion in zip(names, motions, strict=True)
                if motion
            }
            # Obstacles do not bend a segment with a kind, such as a tool line: its timing is the
            # same for all choices.
            moves = [shapes.get(name, line) for name, line in zip(names, usual, strict=True)]
            durations = [None if shape is None else shape.duration for shape in moves]
            total = rest_duration_of(task, durations)
            if differs(total, (guide.rest_duration for guide in (*known, *guides))):
                name = f"{way.name}, around {len(known) + len(guides) + 1}"
                guides.append(GuidedWay(way, shapes, durations, name, legs, choice, total))
                self._progress(f"{way.name}: {total:.4f} s around the obstacles from rest to rest")
        guides.sort(key=lambda guide: guide.rest_duration)
        known += guides
        return known

    def _usual(self, task: Task, way: Way) -> tuple[PiecewisePolynomial | None, ...]:
        """Return the best timing of every segment along its own path, or None."""
        if not any(task.segments):
            return (None,) * len(task.segments)
        return segment_timings(task, way, self._settings.compiled)

    def timed(self, task: Task, guide: GuidedWay) -> ProvedPath | None:
        """Return a guided way with the best timing of every segment from rest to rest, or None."""
        return self._proved(
            task, guide.way, (leg and leg.motion(guide.choice) for leg in guide.legs)
        )

    def _proved(self, task: Task, way: Way, motions: Iterable[Motion | None]) -> ProvedPath | None:
        """Return a way that rests at every stop, with a motion for every free segment.

        Tool lines keep their own paths. The result is None if a segment has no timing within the
        limits, a stop is passed in motion, or the way is not proved clear. No motion is computed
        after a missing one.
        """
        if not all(map(_may_rest, task.stops)):
            return None
        shapes: list[PiecewisePolynomial] = []
        rows = zip(task.segments, task.robots, self._usual(task, way), motions, strict=True)
        for k, (kind, robot, usual, motion) in enumerate(rows):
            if kind is None:
                shape = None if motion is None else polynomial_of(motion)
            else:
                kept = usual is not None and _keeps_limits(robot, usual)
                shape = usual if kept else _unhindered(task, way, k)
            if shape is None or not _keeps_limits(robot, shape):
                return None
            shapes.append(shape)
        motion = _joined(task, way, shapes)
        proof = clearance_along(places_along(task, motion, self.scene), motion)
        if not proof.proved:
            return None
        spent = deadline.processor_time() - self._begin_processor
        self.first_certified = min(self.first_certified, spent)
        path = ProvedPath(motion, proof)
        self.known.setdefault(task, path)
        return path


def _blocked(task: Task, places: Sequence[Surroundings], way: Way) -> str:
    """Return a sentence on the first stop of a way in collision; empty if there is none."""
    for k, q in enumerate(way.via):
        for place in {max(k - 1, 0), min(k, len(places) - 1)}:
            contact = places[place].collision(q)
            if contact is not None:
                sentence = touching(contact, places[place].scene.clearance)
                return f"stop {task.stops[k].name!r} {sentence}"
    return ""
