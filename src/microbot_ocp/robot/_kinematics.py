"""Kinematics of a serial chain as CasADi functions, built from its modified-DH rows.

Sources: Craig, *Introduction to Robotics*, 3rd ed.: transforms (3.6), velocity propagation
(5.45) to (5.48), Jacobian section 5.7.

Theory: docs/theory/kinematics.md, equations (2) to (4).
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.robot._function import function_maker, robot_function, symbols
from microbot_ocp.robot._model import Robot
from microbot_ocp.robot._transforms import PARALLEL, without_rounding


def _cos_sin(angle: float) -> tuple[float, float]:
    """Return cosine and sine, exact at multiples of a right angle so that graphs stay sparse."""
    quarter = angle / (np.pi / 2)
    if abs(quarter - round(quarter)) < PARALLEL:
        turn = round(quarter) % 4
        return (1.0, 0.0, -1.0, 0.0)[turn], (0.0, 1.0, 0.0, -1.0)[turn]
    return float(np.cos(angle)), float(np.sin(angle))


def _turn(axis: int, cos: float | ca.SX, sin: float | ca.SX) -> ca.SX:
    """Return the rotation [3,3] about X, Y or Z (0 to 2) by the cosine and sine of its angle."""
    i, k = (axis + 1) % 3, (axis + 2) % 3
    rotation = ca.SX.eye(3)
    rotation[i, i] = rotation[k, k] = cos
    rotation[k, i], rotation[i, k] = sin, -sin
    return ca.sparsify(rotation)


def joint_transform(robot: Robot, joint: int, q: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return rotation [3,3] and position [3] of link frame ``joint`` (0-based) in the one before.

    Returns
    -------
    rotation, position : SX
        Sparse expressions without structural zeros.
    """
    d, offset = ca.SX(float(robot.d[joint])), float(robot.theta_offset[joint])
    if robot.joint_types[joint] == "revolute":
        angle = q + offset if offset else q
        about_z = _turn(2, ca.cos(angle), ca.sin(angle))
    else:
        about_z = _turn(2, *_cos_sin(offset))
        d = d + q
    # Craig (3.6); constant angles enter as numbers, so that zeros drop out of the graph.
    about_x = _turn(0, *_cos_sin(float(robot.alpha[joint])))
    about_y = _turn(1, *_cos_sin(float(robot.beta[joint])))
    rotation = about_x @ (about_y @ about_z)
    position = ca.vertcat(float(robot.a[joint]), 0, 0) + rotation[:, 2] * d
    return ca.sparsify(rotation), ca.sparsify(position)


def constant(values: Any) -> ca.SX:
    """Return numbers as an expression without structural zeros."""
    return ca.sparsify(ca.SX(ca.DM(values)))


def constant_transform(transform: FloatArray) -> tuple[ca.SX, ca.SX]:
    """Return the rotation [3,3] and position [3] of a constant transform [4,4]."""
    clean = without_rounding(transform)
    return constant(clean[:3, :3]), constant(clean[:3, 3])


def selection(robot: Robot) -> ca.SX:
    """Return S [N,n], which maps rates of the coordinates to rates of all joints."""
    return constant(robot.transmission)


def chain_motion(robot: Robot, q: ca.SX, *rates: ca.SX) -> list[ca.SX]:
    """Return positions and rates [N] of all joints of the chain from those of the coordinates."""
    if robot.coupling is None:
        return [q, *rates]
    matrix = selection(robot)
    return [matrix @ q + ca.DM(robot.coupling.offsets), *(matrix @ rate for rate in rates)]


def frames(robot: Robot, q: ca.SX) -> list[tuple[ca.SX, ca.SX]]:
    """Return rotation and origin of link frames 1 to N and of the tool in the base frame."""
    (q,), robot = chain_motion(robot, q), robot.chain
    rotation, origin = constant_transform(robot.base)
    placed = []
    for joint in range(robot.joint_count):
        turn, step = joint_transform(robot, joint, q[joint])
        origin = origin + rotation @ step
        rotation = rotation @ turn
        placed.append((rotation, origin))
    turn, step = constant_transform(robot.tool)
    return [*placed, (rotation @ turn, origin + rotation @ step)]


def _homogeneous(rotation: ca.SX, origin: ca.SX) -> ca.SX:
    top = ca.horzcat(ca.densify(rotation), ca.densify(origin))
    return ca.vertcat(top, ca.SX([[0, 0, 0, 1]]))


@function_maker
def forward_kinematics(
    robot: Robot, frame: int | None = None, *, compiled: bool = False
) -> ca.Function:
    """Return the pose of a frame in the base frame.

        Parameters
        ----------
        robot : Robot
        frame : int, optional
            Link frame 1 to N (0 is the base); default the tool frame N+1.
        compiled : bool
            True to compile to C (cached); on failure CasADi's virtual machine runs, with a warning.

        Returns
        -------
        casadi.Function
            ``(q[n]) -> T[4,4]``.

        Examples
        --------
        >>> import numpy as np
    from numpy.typing import ArrayLike
        >>> import microbot_ocp as mo
        >>> pose = mo.forward_kinematics(mo.load_robot("microbot"))
        >>> np.array(pose([0, 0, 0]))[:3, 3].tolist()
        [7.0, 0.0, 2.0]
    """
    last = robot.link_count + 1
    index = last if frame is None else frame
    if not isinstance(index, int | np.integer) or not 0 <= index <= last:
        raise InputError(
            f"frame must be a whole number from 0 (base) to {last} (tool), not {frame!r}"
        )
    state = symbols(robot, "q")
    pose = ca.SX.eye(4) if index == 0 else _homogeneous(*frames(robot, **state)[index - 1])
    return robot_function("forward_kinematics", state, {"T": pose}, compiled)


@function_maker
def link_poses(robot: Robot, *, compiled: bool = False) -> ca.Function:
    """Return poses of the base and link frames 1 to N: ``(q[n]) -> poses[4, 4 (N+1)]``, m."""
    state = symbols(robot, "q")
    poses = [ca.SX.eye(4), *(_homogeneous(*frame) for frame in frames(robot, **state)[:-1])]
    return robot_function("link_poses", state, {"poses": ca.horzcat(*poses)}, compiled)


@function_maker
def frame_origins(robot: Robot, *, compiled: bool = False) -> ca.Function:
    """Return origins of the base, link frames and tool: ``(q[n]) -> origins[3, N+2]``, m."""
    state = symbols(robot, "q")
    origins = [ca.SX.zeros(3), *(ca.densify(origin) for _, origin in frames(robot, **state))]
    return robot_function("frame_origins", state, {"origins": ca.horzcat(*origins)}, compiled)


@function_maker
def jacobian(robot: Robot, *, compiled: bool = False) -> ca.Function:
    """Return the geometric Jacobian at the tool origin in the base frame.

    Returns
    -------
    casadi.Function
        ``(q[n]) -> J[6,n]``: rows of linear velocity (m/s) and angular velocity (rad/s) per joint
        speed.
    """
    state = symbols(robot, "q")
    poses = frames(robot, **state)
    tool = poses[-1][1]
    columns = []
    for joint, kind in enumerate(robot.chain.joint_types):
        rotation, origin = poses[joint]
        # Columns are (Z x (p_tool - p), Z) of a revolute and (Z, 0) of a prismatic joint.
        axis = ca.densify(rotation)[:, 2]
        if kind == "revolute":
            columns.append(ca.vertcat(ca.cross(axis, ca.densify(tool - origin)), axis))
        else:
            columns.append(ca.vertcat(axis, ca.SX.zeros(3)))
    of_coordinates = ca.horzcat(*columns) @ selection(robot)
    return robot_function("jacobian", state, {"J": of_coordinates}, compiled)


@function_maker
def velocity_propagation(robot: Robot, *, compiled: bool = False) -> ca.Function:
    """Return velocities of all link frames by outward propagation (Craig, equations 5.45 to 5.48).

    Returns
    -------
    casadi.Function
        ``(q[n], qd[n]) -> v[3,N+1], omega[3,N+1]``: column i is the velocity of the origin of link
        frame i+1 (m/s) and its angular velocity (rad/s), expressed in that frame; the tool is last.
    """
    state = symbols(robot, "q", "qd")
    (q, qd), robot = chain_motion(robot, *state.values()), robot.chain
    steps = [joint_transform(robot, joint, q[joint]) for joint in range(robot.joint_count)]
    steps.append(constant_transform(robot.tool))
    v, omega = ca.SX.zeros(3), ca.SX.zeros(3)
    all_v, all_omega = [], []
    for joint, (turn, step) in enumerate(steps):
        # Craig (5.45) to (5.48): velocities of the frame before, to which the joint adds its rate.
        v = turn.T @ (v + ca.cross(omega, ca.densify(step)))
        omega = turn.T @ omega
        if joint < robot.joint_count:
            along_axis = ca.vertcat(0, 0, qd[joint])
            if robot.joint_types[joint] == "revolute":
                omega = omega + along_axis
            else:
                v = v + along_axis
        all_v.append(ca.densify(v))
        all_omega.append(ca.densify(omega))
    velocities = {"v": ca.horzcat(*all_v), "omega": ca.horzcat(*all_omega)}
    return robot_function("velocity_propagation", state, velocities, compiled)
