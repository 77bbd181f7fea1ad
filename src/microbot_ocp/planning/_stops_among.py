"""Motions through stops among obstacles, with the parts that the arm carries from a stop on.

Every way through the branches is led around the obstacles by the planner where its free segments
are blocked; the fastest of these, each timed, are what the search starts from. Every segment keeps
the distances of the arm with what it carries there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

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
    touching,
)
from microbot_ocp.planning._branches import Way, ways_through
from microbot_ocp.planning._fast_timing import time_path
from microbot_ocp.planning._free_problem import phase_names
from microbot_ocp.planning._free_search import TimeOptimalSettings
from microbot_ocp.planning._initial_guesses import InitialGuess
from microbot_ocp.planning._parts import (
    Place,
    places_along,
    poses_at_stops,
    scenes_of,
    tool_poses,
)
from microbot_ocp.planning._stop_search import StopSearch, guess_along, in_order, solve_stops
from microbot_ocp.planning._stop_task import Task, task_of
from microbot_ocp.planning._stops import Stop
from microbot_ocp.planning._task import reach_of
from microbot_ocp.robot import Robot
from microbot_ocp.scene import (
    Clearance,
    Pair,
    Scene,
    Surroundings,
    clearance_along,
    clearances,
    detours,
    with_arm_capsules,
)

SEEDS = 2  # of the planner, for each blocked segment
MOST_GUESSES = 4  # ways that the search starts from


@dataclass(frozen=True, eq=False)
class Around:
    """The scenes on the segments of a task as limits, of those pairs that come near."""

    scenes: tuple[Scene, ...]
    near: set[str] = field(default_factory=set)

    def limits(self, robot: Robot, index: int) -> tuple[Any, ...]:
        """The distances of the pairs that come near on a segment."""
        scene = self.scenes[index]
        chosen = [pair for pair in _pairs(scene, robot) if pair.label in self.near]
        return (scene.limit(robot, chosen),) if chosen else ()

    def add(self, robot: Robot, scene: Scene, q: FloatArray, distance: float) -> bool:
        """Take in the pairs that are nearer than a distance, m, in some pose [N,n]; whether new."""
        pairs = _pairs(scene, robot)
        if not pairs:
            return False
        apart = clearances(robot, pairs, q).min(axis=0)
        found = {p.label for p, least in zip(pairs, apart, strict=True) if least < distance}
        new = not found <= self.near
        self.near.update(found)
        return new


def _pairs(scene: Scene, robot: Robot) -> tuple[Pair, ...]:
    """What may touch where the arm carries what this robot has."""
    return scene.without_parts_of(robot).pairs(robot)


class _GuidedSearch(StopSearch):
    """The search from ways that lead around obstacles, with what else there is after them."""

    guided: Sequence[tuple[Way, dict[str, PiecewisePolynomial]]] = ()

    def _again(self, task: Task) -> StopSearch:
        search = _GuidedSearch(task, self.settings, self.progress, None, self.ways)
        search.guided = self.guided
        return search

    def _all_guesses(self) -> Iterator[tuple[Way, InitialGuess]]:
        for number, (way, shapes) in enumerate(self.guided, start=1):
            if self._leaves_out(way):
                continue
            usual = self._rest_to_rest(way)
            led = {name: guess_along(shape) for name, shape in shapes.items()}
            name = f"{way.name}, around {number}"
            yield way, InitialGuess(name, {**usual.guesses, **led})
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

    A free order of the stops is the best one without obstacles.

    Raises
    ------
    InputError
        A stop at which every branch of the arm touches something.
    """
    (found, *_), _ = motions_among(
        robot, limits, plan, scene, settings, progress, lambda search: ([(0.0, search.run())], "")
    )
    return found[1]


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
    stops, segments, cycle, order, duration = plan
    robot = with_arm_capsules(robot)
    told: dict[str, Any] = {"scene": list(scene.names)}
    if order != "given":
        bare = [replace(s, payload=None) if isinstance(s, Stop) else s for s in stops]
        _clear_ways(task_of(robot, bare, limits, segments=segments, cycle=cycle), scene)
        first = solve_stops(robot, limits, *plan, settings, progress)
        if not first.solved:
            return [(0.0, first)], ""
        places = told["order"] = first.provenance["order"]
        stops = [stops[k] for k in places]
        segments = in_order(segments, places)
    task = task_of(robot, stops, limits, segments=segments, cycle=cycle)
    carried = [capsule.name for own in task.robots for _, capsule in own.capsules]
    for name in sum(scene.ignore, ()):
        checks.one_of("name in ignore", name, sorted({*carried, *scene.names}))
    near = NEAR * reach_of(robot)
    guided = _ways_around(task, scene, progress)
    first = guided[0][0].via if guided else ways_through(task)[0].via
    around = Around(scenes_of(task, scene, tool_poses(robot, first)))
    names = phase_names(len(task.segments))
    for way, shapes in guided:
        for k, (name, path) in enumerate(zip(names, way.paths, strict=True)):
            shape = shapes.get(name)
            q = path if shape is None else shape(np.linspace(0.0, shape.duration, SAMPLES))
            around.add(task.robots[k], around.scenes[k], q, near)
    made: Made = [], ""
    proofs: list[Clearance] = []
    for _ in range(AGAIN):
        search = _GuidedSearch(replace(task, around=around), settings, progress, duration)
        search.guided = guided
        made = ask(search)
        solved = [motion for _, motion in made[0] if motion.solved]
        along = [places_along(task, motion, scene) for motion in solved]
        proofs = [clearance_along(*pair) for pair in zip(along, solved, strict=True)]
        if all(proof.proved for proof in proofs):
            break
        around = Around(scenes_of(task, scene, poses_at_stops(task, solved[0])), around.near)
        more = [
            around.add(p.robot, p.scene, _between(motion, p), near)
            for places, motion in zip(along, solved, strict=True)
            for p in places
        ]
        if not any(more) and around.scenes == (scene,) * len(around.scenes):
            break
        progress("more pairs come too near, or a part lies elsewhere: solved again")
    found = iter(proofs)
    judged = [
        (effort, _judged(motion, told, next(found) if motion.solved else None))
        for effort, motion in made[0]
    ]
    return judged, made[1]


def _judged(motion: Motion, told: dict[str, Any], found: Clearance | None) -> Motion:
    """A motion with what its proof of clearance says."""
    told = {**motion.provenance, **told}
    if found is not None:
        told["clearance"] = as_plain(found)
        if not found.proved:
            told |= {"status": str(Status.LIMITS_EXCEEDED), "advice": found.sentence}
            return replace(motion, provenance=told, note=f"not solved: {found.sentence}")
    return replace(motion, provenance=told)


def _between(motion: Motion, place: Place) -> FloatArray:
    return motion.sample(np.linspace(place.start, place.end, SAMPLES)).q


def _clear_ways(task: Task, scene: Scene) -> list[tuple[Way, list[Surroundings]]]:
    """Ways whose poses at the stops touch nothing, with what is around each segment.

    Raises
    ------
    InputError
        There is none.
    """
    clear, refused = [], []
    for way in ways_through(task):
        scenes = scenes_of(task, scene, tool_poses(task.robot, way.via))
        places = [
            Surroundings(robot, own.without_parts_of(robot))
            for robot, own in zip(task.robots, scenes, strict=True)
        ]
        blocked = _blocked(task, places, way)
        if blocked:
            refused.append(blocked)
        else:
            clear.append((way, places))
    if not clear:
        raise InputError(refused[0])
    return clear


def _ways_around(
    task: Task, scene: Scene, progress: StepProgress
) -> list[tuple[Way, dict[str, PiecewisePolynomial]]]:
    """Ways with their free segments around the obstacles, the fastest first.

    None where the planner finds no way between the poses at the stops.
    """
    found = []
    for way, places in _clear_ways(task, scene):
        for seed in range(SEEDS):
            led = _led_around(task, places, way, seed)
            if led is None:
                break
            duration = sum(shape.duration for shape in led.values())
            if any(way is other and duration == known for known, other, _ in found):
                break  # no segment is blocked: other seeds lead to the same
            found.append((duration, way, led))
    found.sort(key=lambda entry: entry[0])
    kept: list[tuple[float, Way, dict[str, PiecewisePolynomial]]] = []
    for duration, way, led in found:
        if any(way is other and duration <= (1 + DIFFERENT) * known for known, other, _ in kept):
            continue
        kept.append((duration, way, led))
        progress(f"{way.name}: {duration:.4f} s around the obstacles from rest to rest")
    return [(way, led) for _, way, led in kept[:MOST_GUESSES]]


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
    task: Task, places: Sequence[Surroundings], way: Way, seed: int
) -> dict[str, PiecewisePolynomial] | None:
    """A timed path for every free segment of a way; None where the planner finds none."""
    shapes, names = {}, phase_names(len(task.segments))
    for k, (name, kind) in enumerate(zip(names, task.segments, strict=True)):
        if kind is not None:
            continue
        leg = next(iter(detours(places[k], way.via[k], way.via[k + 1], range(seed, seed + 1))))
        if leg.path is None:
            return None
        timing = time_path(task.robots[k], leg.path)
        if not timing.solved:
            return None
        motion = timing.motion("timed path")
        shapes[name] = PiecewisePolynomial(motion.t, pieces_of(motion))
    return shapes
