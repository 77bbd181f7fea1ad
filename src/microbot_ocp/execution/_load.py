"""Payload of an arm along a motion: constant, or given by the stops of a task."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.certificate import Tolerances
from microbot_ocp.execution._rows import CommandRows
from microbot_ocp.limits import JointLimits
from microbot_ocp.motion import Motion, State, other_arm, torque_along
from microbot_ocp.planning.search import over_stretches, stretches
from microbot_ocp.planning.task import Segment, Task, task_of
from microbot_ocp.robot import Robot


def given_task(
    robot: Robot,
    limits: JointLimits | None,
    via_q: Sequence[Any] | None,
    segments: Sequence[Segment] | None,
    cycle: bool,
) -> Task | None:
    """Return the task of the given stops; None without stops."""
    if via_q is not None:
        return task_of(robot, via_q, limits, segments=segments, cycle=cycle)
    if segments is not None or cycle:
        raise InputError("segments and cycle belong to stops: give the stops, too, via_q=...")
    return None


def torques_through(
    robot: Robot,
    motion: Motion | CommandRows,
    task: Task | None,
    torque: Callable[[Robot, State], FloatArray] = torque_along,
) -> Callable[[FloatArray, State], FloatArray]:
    """Return torques [N,n] as a function of times [N] and states, with the payload at each time."""
    if task is None:
        return lambda _, state: torque(robot, state)
    parts = stretches(task, motion)
    return lambda t, state: over_stretches(parts, t, state, torque)


def refuse_other_arm(robot: Robot, motion: Motion, task: Task | None = None) -> None:
    """Reject a motion whose stored torques are not those of the robot with its payload."""
    checks.joints("motion", motion.joint_count, robot)
    if not robot.has_dynamics or not motion.tau.any():
        return
    state = State(motion.q, motion.qd, motion.qdd)
    off = np.abs(motion.tau - torques_through(robot, motion, task)(motion.t, state))
    sample, joint = np.unravel_index(int(off.argmax()), off.shape)
    if off[sample, joint] > Tolerances().torque * np.abs(motion.tau).max():
        other = other_arm(robot, motion)
        raise InputError(
            f"{other and other + ': '}torques of the motion are not those of {robot.name!r}: that "
            f"of {robot.joint_names[joint]} differs by {off[sample, joint]:.4g} "
            f"{robot.unit('tau', int(joint))} at "
            f"{motion.t[sample]:.4g} s. Give the arm with its payload, robot.with_payload(...), "
            "or, if the payload changes on the way, the stops, via_q=... or --task"
        )
