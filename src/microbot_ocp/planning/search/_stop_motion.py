"""A motion through stops: segments, dwells and payloads, and the parts that it moves.

A part is an obstacle before it is picked and after it is placed.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.motion import (
    JUMP_GAP,
    Mark,
    Motion,
    PiecewisePolynomial,
    State,
    nearest_samples,
    torque_along,
)
from microbot_ocp.planning.free import joined
from microbot_ocp.planning.task import EMPTY, Payload, Task
from microbot_ocp.robot import Capsule, Robot, forward_kinematics
from microbot_ocp.scene import Scene


def motion_of(
    task: Task, shapes: Sequence[PiecewisePolynomial], provenance: dict[str, Any]
) -> Motion:
    """Return the segments one after another, with dwells and with the torques of the payloads."""
    moves, marks, now = list[PiecewisePolynomial](), list[Mark](), 0.0
    for k, stop in enumerate(task.stops):
        marks.append(Mark(now, stop.name))
        here = [shapes[k]] if k < len(shapes) else []
        if task.dwells[k] > 0.0:
            q = here[0](0.0)[0] if here else shapes[-1](shapes[-1].breaks[-1])[0]
            held = np.zeros((1, 6, q.size))
            held[0, 0] = q
            here.insert(0, PiecewisePolynomial(np.array([0.0, task.dwells[k]]), held))
        for shape in here:
            now += shape.duration
        moves += here
    whole = joined(moves)
    return motion_along(task, whole, marks, label="time-optimal", provenance=provenance)


def motion_along(
    task: Task, curve: PiecewisePolynomial, marks: Sequence[Mark], **about: Any
) -> Motion:
    """Return a curve as a motion that reaches the stops at the marks, with torques of the payloads.

    ``about`` holds further arguments of :meth:`Motion.from_polynomial`.

    Raises
    ------
    InputError
        The number of marks differs from the number of stops.
    """
    parts = _stretches(task, marks, float(curve.breaks[-1]), about["label"])
    starts = np.array([part.start for part in parts[1:]])
    near = curve.breaks[nearest_samples(curve.breaks, starts)]
    whole = curve.divided(starts[np.abs(starts - near) > JUMP_GAP])
    loads = [task.payloads[part.segment] for part in parts]
    changes = [before != after for before, after in itertools.pairwise(loads)]
    jumps = whole.breaks[nearest_samples(whole.breaks, starts[changes])].tolist()
    motion = Motion.from_polynomial(task.robot, whole, marks=marks, jumps_at=jumps, **about)
    if not any(payload.mass for payload in task.payloads):
        return motion
    state = State(motion.q, motion.qd, motion.qdd)
    return replace(motion, tau=over_stretches(parts, motion.t, state))


class Stretch(NamedTuple):
    """A segment or dwell of a motion.

    Attributes
    ----------
    start : start time, s
    end : end time, s
    robot : robot with its payload
    segment : index of the segment; a dwell has the index of the segment before it
    """

    start: float
    end: float
    robot: Robot
    segment: int


def stretches(task: Task, motion: Any) -> list[Stretch]:
    """Return every segment and dwell of a motion, or of the rows of a recording.

    The marks are the arrival times at the stops. Times before the first mark belong to the first
    stretch, times after the last mark to the last.

    Raises
    ------
    InputError
        The number of marks differs from the number of stops.
    """
    return _stretches(task, motion.marks, float(motion.t[-1]), motion.label)


def _stretches(task: Task, marks: Sequence[Mark], duration: float, label: str) -> list[Stretch]:
    if len(marks) != len(task.stops):
        raise InputError(
            f"motion {label!r} has {len(marks)} marks, but the task {len(task.stops)} stops: it is "
            "not a motion of this task"
        )
    loads = (task.payloads[-1 if task.cycle else 0], *task.payloads)
    parts: list[Stretch] = []
    times = [mark.time for mark in marks]
    for k, arrives in enumerate(times):
        leaves = arrives + float(task.dwells[k])
        if leaves > arrives:
            resting: Robot = loads[k].on(task.robot)
            before = (k - 1) % len(task.segments) if task.cycle else max(k - 1, 0)
            parts.append(Stretch(arrives, leaves, resting, before))
        if k < len(task.segments):
            parts.append(Stretch(leaves, times[k + 1], task.robots[k], k))
    parts[0] = parts[0]._replace(start=0.0)
    parts[-1] = parts[-1]._replace(end=duration)
    return parts


def over_stretches(
    parts: Sequence[Stretch],
    t: FloatArray,
    state: State,
    torque: Callable[[Robot, State], FloatArray] = torque_along,
) -> FloatArray:
    """Return torques [N,n], N m (N), of states at times t [N], each of the stretch's own robot."""
    starts = [part.start for part in parts[1:]]
    which = np.searchsorted(starts, t + 0.5 * JUMP_GAP, side="right")
    tau = np.empty_like(state.q)
    for k in np.unique(which):
        here = which == k
        tau[here] = torque(parts[k].robot, State(*(column[here] for column in state)))
    return tau


# parts ------------------------------------------------------------------------------------------
#
# Stops pick and place a part: one shape, carried over some segments, perhaps several times. A lying
# part is an obstacle. Links whose distance from the part is ignored while it is held may also touch
# it as it lies, but only on the segment to the pick and on the segment from the place: there the
# gripper closes and opens.

# A picked part is identified with a placed one if it is at most this far from it: share of its
# smallest radius, or m for a part without a shape.
SAME_PLACE, SAME_POINT = 0.5, 0.01


@dataclass(frozen=True)
class Part:
    """A part that is picked and placed.

    Attributes
    ----------
    payload : Payload
        Payload at the first pick.
    carries : tuple of (first, end)
        Half-open ranges of segments on which it is held; also the indices of the stops that pick
        and place it.
    """

    payload: Payload
    carries: tuple[tuple[int, int], ...]

    def rests(self, count: int) -> list[tuple[int, range]]:
        """Return each stop at which the part lies, with its segments out of ``count``."""
        edges = [0, *sum(self.carries, ()), count]
        places = [self.carries[0][0], *(end for _, end in self.carries)]
        waits = [range(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True)]
        return [(place, wait) for place, wait in zip(places, waits, strict=True) if wait]


class Place(NamedTuple):
    """A stretch of a motion: start and end, s, the robot with its payload, and its scene."""

    start: float
    end: float
    robot: Robot
    scene: Scene


def tool_poses(robot: Robot, q: FloatArray) -> FloatArray:
    """Return poses [N,4,4] of the tool in the base frame for q [N,n], rad (m)."""
    poses = np.array(forward_kinematics(robot).map(len(q))(q.T))
    return poses.reshape(4, len(q), 4).transpose(1, 0, 2)


def poses_at_stops(task: Task, motion: Motion) -> FloatArray:
    """Return poses [m,4,4] of the tool at the stops of a motion."""
    return tool_poses(task.robot, motion.sample([mark.time for mark in motion.marks]).q)


def parts_of(task: Task, tool: FloatArray) -> tuple[Part, ...]:
    """Return the parts of a task whose tool has poses [m,4,4] at its stops."""
    held = [payload.shape or payload for payload in task.payloads]
    parts: list[Part] = []
    end = 0
    for held_payload, carried in itertools.groupby(held):
        first, end = end, end + len(list(carried))
        payload = task.payloads[first]
        if payload == EMPTY:
            continue
        for k, part in enumerate(parts):
            same = (part.payload.shape or part.payload) == held_payload
            if same and _same_place(payload, tool[part.carries[-1][1]], tool[first]):
                parts[k] = replace(part, carries=(*part.carries, (first, end)))
                break
        else:
            parts.append(Part(payload, ((first, end),)))
    return tuple(parts)


def _same_place(payload: Payload, before: FloatArray, after: FloatArray) -> bool:
    points = [p for capsule in payload.shape for p in (capsule.start, capsule.end)]
    body_points = np.array(points or [payload.center_of_mass])
    apart = [body_points @ pose[:3, :3].T + pose[:3, 3] for pose in (before, after)]
    radii = (SAME_PLACE * capsule.radius for capsule in payload.shape)
    least = min(radii, default=SAME_POINT)
    return float(np.linalg.norm(apart[1] - apart[0], axis=1).max()) < least


def scenes_of(task: Task, scene: Scene, tool: FloatArray) -> tuple[Scene, ...]:
    """Return the scene on every segment, with the lying parts as obstacles.

    Parameters
    ----------
    task : Task
        Task of a robot with capsules.
    scene : Scene
    tool : array [m,4,4]
        Poses of the tool in the base frame at the stops, m.
    """
    count = len(task.segments)
    lying: list[list[Capsule]] = [[] for _ in range(count)]
    ignored: list[list[tuple[str, str]]] = [[] for _ in range(count)]
    for part in parts_of(task, tool):
        for stop, wait in part.rests(count):
            placed = _placed(part.payload.shape, tool[stop], task.stops[stop].name)
            for k in wait:
                lying[k] += [c for c in placed if c.name not in {other.name for other in lying[k]}]
                may = _ignored_with(scene, part.payload.shape)
                if any(k + 1 == first or k == end for first, end in part.carries):
                    may |= _touching_in_the_tool(scene, task.robot, part.payload)
                ignored[k] += [(name, c.name) for c in placed for name in sorted(may)]
    return tuple(
        replace(scene, obstacles=(*scene.obstacles, *parts), ignore=(*scene.ignore, *pairs))
        if parts
        else scene
        for parts, pairs in zip(lying, ignored, strict=True)
    )


def _placed(shape: Sequence[Capsule], pose: FloatArray, where: str) -> list[Capsule]:
    """Return the capsules of a part in the base frame for a tool pose [4,4], named by the stop."""
    capsules = []
    for number, capsule in enumerate(shape, start=1):
        name = f"{capsule.name} at {where}" + (f", {number}" if number > 1 else "")
        capsules.append(replace(capsule.moved(pose), name=name))
    return capsules


def _ignored_with(scene: Scene, shape: Sequence[Capsule]) -> set[str]:
    """Return the names that the scene allows to touch a part."""
    names = {capsule.name for capsule in shape}
    return {b if a in names else a for a, b in scene.ignore if {a, b} & names}


def _touching_in_the_tool(scene: Scene, robot: Robot, payload: Payload) -> set[str]:
    """Return the links whose distance from a held part is ignored."""
    held = payload.on(robot)
    carried = held.capsules[len(robot.capsules) :]
    looked_at = {
        frozenset((_key(pair.frame, pair.capsule), _key(pair.other_frame, pair.other)))
        for pair in scene.without_parts_of(held).pairs(held)
        if isinstance(pair.other, Capsule)
    }
    may = {
        link.name
        for frame, link in robot.capsules
        for carrier, part in carried
        if frame > 0 and frozenset((_key(frame, link), _key(carrier, part))) not in looked_at
    }
    return may | {part.name for _, part in carried}


def _key(frame: int, capsule: Capsule) -> tuple[int, bytes]:
    """Return a value that identifies a capsule, also across equal robots."""
    return frame, np.concatenate([capsule.start, capsule.end, [capsule.radius]]).tobytes()


def places_along(task: Task, motion: Motion, scene: Scene) -> list[Place]:
    """Return the stretches of a motion, each with its robot and its scene."""
    scenes = scenes_of(task, scene, poses_at_stops(task, motion))
    return [Place(s.start, s.end, s.robot, scenes[s.segment]) for s in stretches(task, motion)]
