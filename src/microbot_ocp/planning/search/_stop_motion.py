"""A motion through stops: its segments and dwells one after the other, with what the tool holds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
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
from microbot_ocp.planning.task import Task
from microbot_ocp.robot import Robot


def motion_of(
    task: Task, shapes: Sequence[PiecewisePolynomial], provenance: dict[str, Any]
) -> Motion:
    """Return the segments one after the other, with the dwells; torques with what the tool
    holds then.
    """
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
    """Return a curve as a motion that reaches the stops at these marks; torques with what the tool
    holds then, ``about`` as of :meth:`Motion.from_polynomial`.

    Raises
    ------
    InputError
        Not one mark a stop.
    """
    parts = _stretches(task, marks, float(curve.breaks[-1]), about["label"])
    starts = np.array([part.start for part in parts[1:]])
    near = curve.breaks[nearest_samples(curve.breaks, starts)]
    whole = curve.divided(starts[np.abs(starts - near) > JUMP_GAP])
    loads = [task.payloads[part.segment] for part in parts]
    changes = [before != after for before, after in pairwise(loads)]
    jumps = whole.breaks[nearest_samples(whole.breaks, starts[changes])].tolist()
    motion = Motion.from_polynomial(task.robot, whole, marks=marks, jumps_at=jumps, **about)
    if not any(payload.mass for payload in task.payloads):
        return motion
    state = State(motion.q, motion.qd, motion.qdd)
    return replace(motion, tau=over_stretches(parts, motion.t, state))


class Stretch(NamedTuple):
    """A segment or a dwell of a motion: start and end, s, the robot that moves, with what it holds,
    and the segment, of a dwell the one before it.
    """

    start: float
    end: float
    robot: Robot
    segment: int


def stretches(task: Task, motion: Any) -> list[Stretch]:
    """Return every segment and dwell of a motion, or of the rows of one.

    The marks of the motion say when its stops are reached; what is before the first one and after
    the last belongs to the first stretch and to the last.

    Raises
    ------
    InputError
        A motion that has not one mark a stop.
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
            rested: Robot = loads[k].on(task.robot)
            before = (k - 1) % len(task.segments) if task.cycle else max(k - 1, 0)
            parts.append(Stretch(arrives, leaves, rested, before))
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
    """Return torques [N,n] of states at times t [N], each of the robot that moves there."""
    starts = [part.start for part in parts[1:]]
    which = np.searchsorted(starts, t + 0.1 * JUMP_GAP, side="right")
    tau = np.empty_like(state.q)
    for k in np.unique(which):
        here = which == k
        tau[here] = torque(parts[k].robot, State(*(column[here] for column in state)))
    return tau
