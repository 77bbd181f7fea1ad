"""A motion through stops: its segments and dwells one after the other, with what the tool holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from microbot_ocp._base.checks import InputError
from microbot_ocp.motion import Mark, Motion, PiecewisePolynomial, State, torque_along
from microbot_ocp.planning.task import Task
from microbot_ocp.robot import Robot


def motion_of(
    task: Task, shapes: Sequence[PiecewisePolynomial], provenance: dict[str, Any]
) -> Motion:
    """Return the segments one after the other, with the dwells; torques with what the tool
    holds then.
    """
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
    """Return every segment and dwell of a motion.

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
    parts: list[Stretch] = []
    loads = (
        (task.payloads[-1], *task.payloads) if task.cycle else (task.payloads[0], *task.payloads)
    )
    times = [mark.time for mark in motion.marks]
    for k, arrives in enumerate(times):
        leaves = arrives + float(task.dwells[k])
        if leaves > arrives:
            rested: Robot = loads[k].on(task.robot)
            before = (k - 1) % len(task.segments) if task.cycle else max(k - 1, 0)
            parts.append(Stretch(arrives, leaves, rested, before))
        if k < len(task.segments):
            parts.append(Stretch(leaves, times[k + 1], task.robots[k], k))
    return parts
