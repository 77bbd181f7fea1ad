"""Motions through stops among obstacles, with the parts that the arm carries from a stop on.

Every way through the branches is led around the obstacles by the planner where its free segments
are blocked; the fastest of these, each timed, are what the search starts from. Every segment keeps
the distances of the arm with what it carries there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.status import Status
from microbot_ocp.limits import JointLimits, Limits
from microbot_ocp.motion import Motion, PiecewisePolynomial, pieces_of
from microbot_ocp.ocp.solution import StepProgress
from microbot_ocp.planning._among_obstacles import (
    AGAIN,
    DIFFERENT,
    NEAR,
    SAMPLES,
    as_plain,
    timed_leg,
    touching,
)
from microbot_ocp.planning._branches import Way, ways_through
from microbot_ocp.planning._free_problem import phase_names
from microbot_ocp.planning._free_search import TimeOptimalSettings
from microbot_ocp.planning._initial_guesses import InitialGuess
from microbot_ocp.planning._orders import best_order, hoped_of, rested_of, tasks_in_orders
from microbot_ocp.planning._parts import (
    Place,
    places_along,
    poses_at_stops,
    scenes_of,
    tool_poses,
)
from microbot_ocp.planning._stop_search import StopSearch, guess_along, segment_timings
from microbot_ocp.planning._stop_task import Task, task_of
from microbot_ocp.planning._stops import Stop
from microbot_ocp.planning._task import reach_of
from microbot_ocp.robot import Capsule, Robot
from microbot_ocp.scene import (
    Clearance,
    Pair,
    Scene,
    Surroundings,
    clearance_along,
    clearances,
    detour,
    with_arm_capsules,
)

SEEDS = 2  # of the planner, for each blocked segment
MOST_GUESSES = 4  # ways that the search starts from


@dataclass(frozen=True, eq=False)
class Around:
    """The scenes on the segments of a task as limits, of those pairs that come near."""

    scenes: tuple[Scene, ...]
    tolerance: float  # of limits
    near: set[str] = field(default_factory=set)
    rooms: dict[str, float] = field(default_factory=dict)  # of pairs on known ways, m

    def limits(self, robot: Robot, index: int) -> tuple[Any, ...]:
        """The distances of the pairs that come near on a segment."""
        scene = self.scenes[index]
        chosen = [pair for pair in _pairs(scene, robot) if pair.label in self.near]
        rooms = [self.rooms.get(pair.label, np.inf) for pair in chosen]
        given = {"tolerance": self.tolerance, "room": rooms}
        return (scene.limit(robot, chosen, **given),) if chosen else ()

    def add(self, robot: Robot, scene: Scene, q: FloatArray, distance: float) -> bool:
        """Take in the pairs that are nearer than a distance, m, in some pose [N,n]; whether new."""
        pairs = _pairs(scene, robot)
        if not pairs:
            return False
        apart = clearances(robot, pairs, q).min(axis=0)
        found = {p.label for p, least in zip(pairs, apart, strict=True) if least < distance}
        for pair, least in zip(pairs, apart - scene.clearance, strict=True):
            if least > 0.0:
                self.rooms[pair.label] = min(least, self.rooms.get(pair.label, np.inf))
        new = not found <= self.near
        self.near.update(found)
        return new


def _pairs(scene: Scene, robot: Robot) -> tuple[Pair, ...]:
    """What may touch where the arm carries what this robot has."""
    return scene.without_parts_of(robot).pairs(robot)


class Guide(NamedTuple):
    """A way whose free segments lead around the obstacles.

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


class _GuidedSearch(StopSearch):
    """The search from ways that lead around obstacles, with what else there is after them."""

    guided: Sequence[Guide] = ()

    def _again(self, task: Task) -> StopSearch:
        search = _GuidedSearch(task, self.settings, self.progress, None, self.ways)
        search.guided = self.guided
        return search

    def _all_guesses(self) -> Iterator[tuple[Way, InitialGuess]]:
        taken: list[Way] = []
        for guide in self.guided:
            way = guide.way
            again = any(way is other for other in taken)
            if (self.briefly and again) or self._leaves_out(way):
                continue
            taken.append(way)
            usual = self._rest_to_rest(way)
            led = {name: guess_along(shape) for name, shape in guide.shapes.items()}
            yield way, InitialGuess(guide.name, {**usual.guesses, **led})
        if not self.guided:
            yield from super()._all_guesses()


Plan = tuple[list[Any], Any, bool, str, float | None]
Made = tuple[list[tuple[float, Motion]], str]  # effort and motion of each, why there are no more


def stops_among(
    robot: Robot,
    limits: Limits | JointLimits | None,
    plan: Plan,
    scene: Scene,
    settings: TimeOptimalSettings,
    progress: StepProgress,
) -> Motion:
    """The fastest motion through stops that keeps clear of a scene.

    Of a free order of the stops all orders are compared among the obstacles.

    Raises
    ------
    InputError
        A stop at which every branch of the arm touches something.
    """
    stops, segments, cycle, order, duration = plan
    if order == "given":
        (found, *_), _ = motions_among(robot, limits, plan, scene, settings, progress, _fastest)
        return found[1]
    robot = with_arm_capsules(robot)
    legs = Legs(scene, settings)
    bare = [replace(s, payload=None) if isinstance(s, Stop) else s for s in stops]
    _clear_ways(task_of(robot, bare, limits, segments=segments, cycle=cycle), legs)
    return best_order(
        tasks_in_orders(robot, limits, stops, segments, cycle),
        lambda task: _Among(task, legs, settings, progress, duration),
        settings,
        progress,
        duration,
    )


def motions_among(
    robot: Robot,
    limits: Limits | JointLimits | None,
    plan: Plan,
    scene: Scene,
    settings: TimeOptimalSettings,
    progress: StepProgress,
    ask: Callable[[StopSearch], Made],
) -> Made:
    """The motions that a search is asked for, in a scene.

    Raises
    ------
    InputError
        As :func:`stops_among`.
    """
    stops, segments, cycle, _, duration = plan
    task = task_of(with_arm_capsules(robot), stops, limits, segments=segments, cycle=cycle)
    return _Among(task, Legs(scene, settings), settings, progress, duration).motions(ask)


def _fastest(search: StopSearch) -> Made:
    return [(0.0, search.run())], ""


class _Among:
    """Stops in one order among obstacles."""

    def __init__(
        self,
        task: Task,
        legs: Legs,
        settings: TimeOptimalSettings,
        progress: StepProgress,
        duration: float | None,
    ) -> None:
        self.task, self._scene = task, legs.scene
        self._given = settings, progress, duration
        carried = [capsule.name for own in task.robots for _, capsule in own.capsules]
        for name in sum(self._scene.ignore, ()):
            checks.one_of("name in ignore", name, sorted({*carried, *self._scene.names}))
        self._near = NEAR * reach_of(task.robot)
        self._guided = _ways_around(task, legs, settings.compiled, progress)
        times = [guide.durations for guide in self._guided]
        self.rested = min((rested_of(task, own) for own in times), default=np.inf)
        self.hoped = min((hoped_of(task, own) for own in times), default=np.inf)
        self._search: StopSearch | None = None

    @cached_property
    def _around(self) -> Around:
        task, guided = self.task, self._guided
        first = guided[0].way.via if guided else ways_through(task)[0].via
        scenes = scenes_of(task, self._scene, tool_poses(task.robot, first))
        around = Around(scenes, self._given[0].limit_tolerance)
        names = phase_names(len(task.segments))
        for guide in guided:
            for k, (name, path) in enumerate(zip(names, guide.way.paths, strict=True)):
                shape = guide.shapes.get(name)
                q = path if shape is None else shape(np.linspace(0.0, shape.duration, SAMPLES))
                around.add(task.robots[k], around.scenes[k], q, self._near)
        return around

    def _searching(self, around: Around) -> StopSearch:
        search = _GuidedSearch(replace(self.task, around=around), *self._given)
        search.guided = self._guided
        return search

    def coarse_duration(self, beaten: float) -> float:
        self._search = self._searching(self._around)
        return self._search.coarse_duration(beaten)

    def motion(self) -> Motion:
        return self.motions(_fastest)[0][0][1]

    def motions(self, ask: Callable[[StopSearch], Made]) -> Made:
        """The motions that a search is asked for, again where they miss some pair's distance."""
        task, scene, around, progress = self.task, self._scene, self._around, self._given[1]
        search = self._search or self._searching(around)
        made: Made = [], ""
        proofs: list[Clearance] = []
        for again in range(AGAIN):
            made = ask(self._searching(around) if again else search)
            solved = [motion for _, motion in made[0] if motion.solved]
            along = [places_along(task, motion, scene) for motion in solved]
            proofs = [clearance_along(*pair) for pair in zip(along, solved, strict=True)]
            if all(proof.proved for proof in proofs):
                break
            scenes = scenes_of(task, scene, poses_at_stops(task, solved[0]))
            around = replace(around, scenes=scenes)
            more = [
                around.add(p.robot, p.scene, _between(motion, p), self._near)
                for places, motion in zip(along, solved, strict=True)
                for p in places
            ]
            if not any(more) and around.scenes == (scene,) * len(around.scenes):
                break
            progress("more pairs come too near, or a part lies elsewhere: solved again")
        found = iter(proofs)
        names = list(scene.names)
        judged = [
            (effort, _judged(motion, names, next(found) if motion.solved else None))
            for effort, motion in made[0]
        ]
        return judged, made[1]


def _judged(motion: Motion, names: list[str], found: Clearance | None) -> Motion:
    """A motion with what its proof of clearance says."""
    told = {**motion.provenance, "scene": names}
    if motion.status is Status.INFEASIBLE:  # as the solver sees it, which proves nothing
        advice = Status.NOT_FOUND.sentence
        told |= {"status": str(Status.NOT_FOUND), "advice": advice}
        return replace(motion, provenance=told, note=f"not solved: {advice}")
    if found is not None:
        told["clearance"] = as_plain(found)
        if not found.proved:
            told |= {"status": str(Status.LIMITS_EXCEEDED), "advice": found.sentence}
            return replace(motion, provenance=told, note=f"not solved: {found.sentence}")
    return replace(motion, provenance=told)


def _between(motion: Motion, place: Place) -> FloatArray:
    return motion.sample(np.linspace(place.start, place.end, SAMPLES)).q


@dataclass(frozen=True, eq=False)
class Legs:
    """What was planned around the obstacles of a scene between two poses, for all orders of stops.

    Attributes
    ----------
    scene : Scene
    settings : TimeOptimalSettings
    surroundings : dict
        By the arm with what it carries, and the parts that lie around it.
    timed : dict
        Timed paths, None where there is none, by surroundings, both poses and the seed.
    """

    scene: Scene
    settings: TimeOptimalSettings
    surroundings: dict[Any, Surroundings] = field(default_factory=dict)
    timed: dict[Any, PiecewisePolynomial | None] = field(default_factory=dict)

    def places(self, task: Task, way: Way) -> list[tuple[Any, Surroundings]]:
        """What is around the arm on every segment of a way, each with its key."""
        found = []
        scenes = scenes_of(task, self.scene, tool_poses(task.robot, way.via))
        for payload, own in zip(task.payloads, scenes, strict=True):
            robot = payload.on(task.robot)
            lying = [c for c in own.obstacles[len(self.scene.obstacles) :] if type(c) is Capsule]
            parts = tuple((c.name, c.start.tobytes(), c.end.tobytes(), c.radius) for c in lying)
            key = robot, parts, own.ignore
            if key not in self.surroundings:
                self.surroundings[key] = Surroundings(robot, own.without_parts_of(robot))
            found.append((key, self.surroundings[key]))
        return found

    def around(
        self, place: tuple[Any, Surroundings], start: FloatArray, goal: FloatArray, seed: int
    ) -> PiecewisePolynomial | None:
        """A timed path from a pose [n] to another, from rest to rest; None where none is found."""
        own, around = place
        key = own, start.tobytes(), goal.tobytes(), seed
        if key not in self.timed:
            leg = detour(around, start, goal, self.settings.seed, seed)
            motion = None if leg.path is None else timed_leg(around.robot, leg, self.settings)
            self.timed[key] = None
            if motion is not None:
                self.timed[key] = PiecewisePolynomial(motion.t, pieces_of(motion))
        return self.timed[key]


def _clear_ways(task: Task, legs: Legs) -> list[tuple[Way, list[tuple[Any, Surroundings]]]]:
    """Ways whose poses at the stops touch nothing, with what is around each segment.

    Raises
    ------
    InputError
        There is none.
    """
    clear, refused = [], []
    for way in ways_through(task):
        places = legs.places(task, way)
        blocked = _blocked(task, [around for _, around in places], way)
        if blocked:
            refused.append(blocked)
        else:
            clear.append((way, places))
    if not clear:
        raise InputError(refused[0])
    return clear


def _ways_around(task: Task, legs: Legs, compiled: bool, progress: StepProgress) -> list[Guide]:
    """Ways with their free segments around the obstacles, the fastest first.

    None where the planner finds no way between the poses at the stops.
    """
    found: list[Guide] = []
    for way, places in _clear_ways(task, legs):
        before: list[float | None] = []
        for seed in range(SEEDS):
            shapes = _led_around(task, places, way, seed, legs)
            if shapes is None:
                break
            usual = segment_timings(task, way, compiled)
            names = phase_names(len(usual))
            own = [shapes.get(name, line) for name, line in zip(names, usual, strict=True)]
            durations = [None if shape is None else shape.duration for shape in own]
            if durations == before:
                break  # no segment is blocked: other seeds lead to the same
            found.append(Guide(way, shapes, durations, ""))
            before = durations
    found.sort(key=lambda guide: rested_of(task, guide.durations))
    kept: list[Guide] = []
    for guide in found:
        took = rested_of(task, guide.durations)
        known = [rested_of(task, g.durations) for g in kept if g.way is guide.way]
        if any(took <= (1 + DIFFERENT) * other for other in known):
            continue
        kept.append(guide._replace(name=f"{guide.way.name}, around {len(kept) + 1}"))
        progress(f"{guide.way.name}: {took:.4f} s around the obstacles from rest to rest")
        if len(kept) == MOST_GUESSES:
            break
    return kept


def _blocked(task: Task, places: Sequence[Surroundings], way: Way) -> str:
    """Which stop of a way touches what; empty where none does."""
    for k, q in enumerate(way.via):
        for place in {max(k - 1, 0), min(k, len(places) - 1)}:
            found = places[place].collision(q)
            if found is not None:
                said = touching(found, places[place].scene.clearance)
                return f"stop {task.stops[k].name!r} {said}"
    return ""


def _led_around(
    task: Task, places: Sequence[tuple[Any, Surroundings]], way: Way, seed: int, legs: Legs
) -> dict[str, PiecewisePolynomial] | None:
    """A timed path for every free segment of a way; None where the planner finds none."""
    shapes, names = {}, phase_names(len(task.segments))
    for k, (name, kind) in enumerate(zip(names, task.segments, strict=True)):
        if kind is not None:
            continue
        shape = legs.around(places[k], way.via[k], way.via[k + 1], seed)
        if shape is None:
            return None
        shapes[name] = shape
    return shapes
