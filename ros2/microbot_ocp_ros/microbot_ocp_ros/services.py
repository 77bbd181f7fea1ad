"""What the services do: messages in, messages out, no node."""

from __future__ import annotations

from typing import Any

import numpy as np

import microbot_ocp as mo
from microbot_ocp.execution import CommandRows

NANO = 1_000_000_000


def plan(robot: mo.Robot, request: Any, response: Any) -> Any:
    """Fill the answer with the fastest trajectory that the controller accepts, or say why not."""
    try:
        via_q = _columns(robot, request.via_points, "positions")
        limits = mo.execution.load_profile(request.profile).limits_of(robot)
        motion = mo.time_optimal(robot, via_q, limits)
        command = mo.execution.commanded(robot, motion, request.profile)
    except mo.InputError as problem:
        return _answered(response, False, str(problem))
    if motion.solved and command.accepted:
        _fill(response.trajectory, robot, command.rows)
    words = command.certificate.verdict if motion.solved else motion.note or str(motion.status)
    return _answered(response, motion.solved and command.accepted, words)


def check(robot: mo.Robot, request: Any, response: Any) -> Any:
    """Judge a trajectory as the controller plays it."""
    try:
        certificate = mo.check(robot, rows_of(robot, request.trajectory), request.profile)
    except mo.InputError as problem:
        return _answered(response, False, str(problem))
    return _answered(response, certificate.ok, certificate.verdict)


def rows_of(robot: mo.Robot, trajectory: Any) -> CommandRows:
    """Rows of a JointTrajectory, joints in the order of the robot."""
    times = [p.time_from_start.sec + p.time_from_start.nanosec / NANO for p in trajectory.points]
    given = {
        name: _columns(robot, trajectory, message)
        for name, message in (("q", "positions"), ("qd", "velocities"), ("qdd", "accelerations"))
        if all(len(getattr(point, message)) for point in trajectory.points)
    }
    if "q" not in given:
        raise mo.InputError("trajectory must have positions at every point")
    return CommandRows(t=np.array(times), **given)


def _columns(robot: mo.Robot, trajectory: Any, quantity: str) -> np.ndarray:
    """Values [N,n] of the points, joints in the order of the robot."""
    names = list(trajectory.joint_names)
    if sorted(names) != sorted(robot.joint_names):
        raise mo.InputError(f"joint_names must be {', '.join(robot.joint_names)}, not {names}")
    order = [names.index(name) for name in robot.joint_names]
    rows = [list(getattr(point, quantity)) for point in trajectory.points]
    for number, row in enumerate(rows, 1):
        if len(row) != len(order):
            raise mo.InputError(f"point {number} must have {len(order)} {quantity}, not {len(row)}")
    return np.array(rows, dtype=float).reshape(len(rows), len(order))[:, order]


def _fill(trajectory: Any, robot: mo.Robot, rows: CommandRows) -> None:
    from trajectory_msgs.msg import JointTrajectoryPoint

    trajectory.joint_names = list(robot.joint_names)
    trajectory.points = []
    for k, time in enumerate(np.round(rows.t * NANO).astype(np.int64).tolist()):
        point = JointTrajectoryPoint()
        point.positions = rows.q[k].tolist()
        for message, values in (("velocities", rows.qd), ("accelerations", rows.qdd)):
            if values is not None:
                setattr(point, message, values[k].tolist())
        point.time_from_start.sec, point.time_from_start.nanosec = divmod(time, NANO)
        trajectory.points.append(point)


def _answered(response: Any, success: bool, message: str) -> Any:
    response.success, response.message = bool(success), message
    return response
