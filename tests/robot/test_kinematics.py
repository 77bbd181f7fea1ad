"""Kinematics against the course report, Craig's worked example and the definitions themselves."""

from __future__ import annotations

from functools import partial, reduce

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

import microbot_ocp as mo
from helpers import any_robot, batch, difference, random_states, refused, two_link_arm
from microbot_ocp.robot import dh_transform

ROBOTS = ("microbot", "rp", "rprr", "rrrprrr")
ANGLES = st.floats(-np.pi, np.pi)

robots = st.sampled_from(ROBOTS)


def joint_values(robot: mo.Robot) -> st.SearchStrategy[np.ndarray]:
    return arrays(float, robot.joint_count, elements=ANGLES)


def pose(robot: mo.Robot, q: np.ndarray, frame: int | None = None) -> np.ndarray:
    return np.array(mo.forward_kinematics(robot, frame)(q))


# ---- the course report, recomputed


@pytest.mark.parametrize(
    ("degrees", "position", "printed_to"),
    [
        # part 1: the pose; part 2: angles of its other solutions to their printed digits
        ((161.5651, 74.1561, 111.3819), (3.0, -1.0, 4.5), 1e-4),
        ((161.57, -150.81, -111.38), (3.0, -1.0, 4.5), 1e-3),
        # part 1, the angles of the listing: another pose than the printed one
        ((-86.41, 22.886, -3.415), (0.4092, -6.5223, 4.5), 1e-3),
        # part 3.2: the printed input reaches another point than (3, -1, 4.5)
        ((-18.4349, -29.18, -111.38), (-0.4458, 0.1486, -2.0037), 1e-4),
        ((-18.4349, -29.1863, 111.3819), (3.0, -1.0, 4.5), 1e-4),
    ],
)
def test_microbot_reaches_the_points_of_the_report(
    microbot: mo.Robot, degrees: tuple[float, ...], position: tuple[float, ...], printed_to: float
) -> None:
    assert pose(microbot, np.radians(degrees))[:3, 3] == pytest.approx(position, abs=printed_to)


def test_second_entry_of_the_report_pose_is_positive(microbot: mo.Robot) -> None:
    """Part 1 prints entry (2,2) of frame 3 in the base as -0.0305, and of the tool as +0.0305."""
    q = np.radians((161.57, 74.16, 111.38))
    assert pose(microbot, q, 3)[1, 1] == pytest.approx(0.0305, abs=5e-5)
    assert pose(microbot, q)[1, 1] == pytest.approx(0.0305, abs=5e-5)


REPORT_Q = np.radians((-18.4349, -29.18, -111.38))  # part 3.2
REPORT_QD = np.radians((35.0, 20.0, 45.0))


def test_link_velocities_are_those_of_the_report(microbot: mo.Robot) -> None:
    """Part 3.2; the third entry of V3 is negative, which the printed V4 needs as well."""
    v, omega = (np.array(x) for x in mo.velocity_propagation(microbot)(REPORT_Q, REPORT_QD))
    assert v[:, :2] == pytest.approx(np.zeros((3, 2)), abs=1e-12)
    assert v[2, 2] == pytest.approx(-1.6000, abs=2e-4)
    assert v[:, 3] == pytest.approx([-0.9751, 4.1561, 0.2870], abs=2e-4)
    assert omega[:, 0] == pytest.approx([0.0, 0.0, 0.6109], abs=1e-4)
    assert omega[2, 1:] == pytest.approx([0.3491, 1.1345, 1.1345], abs=1e-4)


def test_tool_velocity_in_the_base_frame_is_that_of_the_report(microbot: mo.Robot) -> None:
    twist = np.array(mo.jacobian(microbot)(REPORT_Q)) @ REPORT_QD
    assert twist[:3] == pytest.approx([3.1285, -1.3451, -2.5902], abs=5e-4)
    assert twist[3:] == pytest.approx([-0.3587, -1.0763, 0.6109], abs=1e-4)


# ---- Craig, Introduction to Robotics, example 5.3


@pytest.mark.parametrize("state", range(5))
def test_two_link_velocities_are_those_of_craigs_example(state: int) -> None:
    l1, l2 = 0.7, 1.3
    q, qd, _ = (x[state] for x in random_states(two_link_arm(l1, l2), 5))
    (t1, t2), (w1, w2) = q, qd
    v, omega = (np.array(x) for x in mo.velocity_propagation(two_link_arm(l1, l2))(q, qd))
    s2, c2 = np.sin(t2), np.cos(t2)
    assert v[:, 0] == pytest.approx(np.zeros(3))
    assert v[:, 1] == pytest.approx([l1 * s2 * w1, l1 * c2 * w1, 0.0])
    assert v[:, 2] == pytest.approx([l1 * s2 * w1, l1 * c2 * w1 + l2 * (w1 + w2), 0.0])
    assert omega[2] == pytest.approx([w1, w1 + w2, w1 + w2])
    s1, c1, s12, c12 = np.sin(t1), np.cos(t1), np.sin(t1 + t2), np.cos(t1 + t2)
    jacobian = np.array(mo.jacobian(two_link_arm(l1, l2))(q))
    assert jacobian[:2] == pytest.approx(
        np.array([[-l1 * s1 - l2 * s12, -l2 * s12], [l1 * c1 + l2 * c12, l2 * c12]])
    )


# ---- definitions


@given(data=st.data(), name=robots)
def test_pose_is_the_product_of_the_rows(data: st.DataObject, name: str) -> None:
    robot = any_robot(name)
    q = data.draw(joint_values(robot))
    rows = []
    for j, value in enumerate(q):
        turns = robot.joint_types[j] == "revolute"
        slide, turn = (0.0, value) if turns else (value, 0.0)
        rows.append(
            dh_transform(
                robot.alpha[j], robot.a[j], robot.d[j] + slide, robot.theta_offset[j] + turn
            )
        )
    for frame in range(robot.joint_count + 1):
        expected = reduce(np.matmul, rows[:frame], np.eye(4))
        assert pose(robot, q, frame) == pytest.approx(expected, abs=1e-12)
    whole = reduce(np.matmul, [*rows, robot.tool])
    assert pose(robot, q) == pytest.approx(whole, abs=1e-12)
    assert pose(robot, q, robot.joint_count + 1) == pytest.approx(whole, abs=1e-12)


@given(data=st.data(), name=robots)
def test_pose_is_a_rigid_transform(data: st.DataObject, name: str) -> None:
    robot = any_robot(name)
    matrix = pose(robot, data.draw(joint_values(robot)))
    rotation = matrix[:3, :3]
    assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0, abs=1e-12)
    assert matrix[3].tolist() == [0.0, 0.0, 0.0, 1.0]


@given(data=st.data(), name=robots)
def test_a_full_turn_of_revolute_joints_comes_back(data: st.DataObject, name: str) -> None:
    robot = any_robot(name)
    q = data.draw(joint_values(robot))
    turn = 2 * np.pi * np.array([kind == "revolute" for kind in robot.joint_types])
    assert pose(robot, q + turn) == pytest.approx(pose(robot, q), abs=1e-12)


def test_reversed_chain_leads_back(microbot: mo.Robot) -> None:
    """The tool seen from the base, and the base seen from the tool through the inverse rows."""
    q = np.array([0.3, -0.8, 1.9])
    back = np.linalg.inv(microbot.tool)
    for j in reversed(range(3)):
        row = dh_transform(microbot.alpha[j], microbot.a[j], microbot.d[j], q[j])
        back = back @ np.linalg.inv(row)
    assert back @ pose(microbot, q) == pytest.approx(np.eye(4), abs=1e-12)


@pytest.mark.parametrize("name", ROBOTS)
def test_frame_origins_are_the_positions_of_all_frames(name: str) -> None:
    robot = any_robot(name)
    q = random_states(robot, 1)[0][0]
    origins = np.array(mo.robot.frame_origins(robot)(q))
    assert origins.shape == (3, robot.joint_count + 2)
    for frame in range(robot.joint_count + 2):
        assert origins[:, frame] == pytest.approx(pose(robot, q, frame)[:3, 3], abs=1e-12)


@pytest.mark.parametrize("name", ROBOTS)
def test_linear_jacobian_is_the_derivative_of_the_position(name: str) -> None:
    robot = any_robot(name)
    q = ca.SX.sym("q", robot.joint_count)
    position = mo.forward_kinematics(robot)(q)[:3, 3]
    slope = ca.Function("slope", [q], [ca.densify(ca.jacobian(position, q))])
    states, _, _ = random_states(robot, 100)
    assert difference(batch(mo.jacobian(robot), states)[:, :3], batch(slope, states)) < 1e-12


@pytest.mark.parametrize("name", ROBOTS)
def test_angular_jacobian_is_the_derivative_of_the_rotation(name: str) -> None:
    """dR/dt R' is the cross-product matrix of J qd."""
    robot = any_robot(name)
    q, qd = ca.SX.sym("q", robot.joint_count), ca.SX.sym("qd", robot.joint_count)
    rotation = mo.forward_kinematics(robot)(q)[:3, :3]
    rate = ca.reshape(ca.jtimes(ca.vec(rotation), q, qd), 3, 3) @ rotation.T
    spin = ca.Function("spin", [q, qd], [ca.densify(ca.inv_skew(rate))])
    states, speeds, _ = random_states(robot, 100)
    angular = batch(mo.jacobian(robot), states)[:, 3:]
    ours = np.einsum("kij,kj->ki", angular, speeds)
    assert difference(ours, batch(spin, states, speeds)) < 1e-12


@given(data=st.data(), name=robots)
def test_propagated_tool_velocity_is_the_jacobian_times_the_joint_speeds(
    data: st.DataObject, name: str
) -> None:
    robot = any_robot(name)
    q, qd = data.draw(joint_values(robot)), data.draw(joint_values(robot))
    v, omega = (np.array(x)[:, -1] for x in mo.velocity_propagation(robot)(q, qd))
    rotation = pose(robot, q)[:3, :3]
    twist = np.array(mo.jacobian(robot)(q)) @ qd
    assert np.concatenate([rotation @ v, rotation @ omega]) == pytest.approx(twist, abs=1e-11)


# ---- arguments


@pytest.mark.parametrize("frame", [-1, 5, 1.0, "tool", 1.5])
def test_unknown_frame_is_refused(microbot: mo.Robot, frame: object) -> None:
    mo.forward_kinematics(microbot, 1)  # a cached neighbour must not answer for 1.0
    with refused("frame", "whole number", "0 (base) to 4 (tool)", repr(frame)):
        mo.forward_kinematics(microbot, frame)  # type: ignore[arg-type]


def test_frame_may_be_a_numpy_integer(microbot: mo.Robot) -> None:
    q = np.array([0.1, 0.2, 0.3])
    assert np.array_equal(pose(microbot, q, np.int64(2)), pose(microbot, q, 2))


@pytest.mark.parametrize(
    ("make", "inputs", "outputs"),
    [
        (mo.forward_kinematics, ["q"], ["T"]),
        (mo.robot.frame_origins, ["q"], ["origins"]),
        (mo.jacobian, ["q"], ["J"]),
        (mo.velocity_propagation, ["q", "qd"], ["v", "omega"]),
    ],
)
def test_functions_name_their_arguments(
    microbot: mo.Robot, make: object, inputs: list[str], outputs: list[str]
) -> None:
    function = make(microbot)  # type: ignore[operator]
    assert function.name_in() == inputs
    assert function.name_out() == outputs
    assert make(microbot) is function  # type: ignore[operator]


def test_beta_turns_about_y_between_the_two_screws_of_a_row() -> None:
    rng = np.random.default_rng(11)
    alpha, a, d, theta, beta = rng.uniform(-1.0, 1.0, (5, 3))
    kinds = ("revolute", "prismatic", "revolute")
    rows = (alpha, a, d, theta)
    make = partial(mo.Robot.from_dh, *rows, joint_type=kinds, convention="modified")
    robot = make(beta=beta)
    (q,), (qd,), _ = random_states(robot, 1)
    pose = np.eye(4)
    for j, kind in enumerate(kinds):
        turn, slide = (q[j], 0.0) if kind == "revolute" else (0.0, q[j])
        about_y = np.eye(4)
        about_y[:3:2, :3:2] = [
            [np.cos(beta[j]), np.sin(beta[j])],
            [-np.sin(beta[j]), np.cos(beta[j])],
        ]
        pose = pose @ dh_transform(alpha[j], a[j], 0.0, 0.0) @ about_y
        pose = pose @ dh_transform(0.0, 0.0, d[j] + slide, theta[j] + turn)
    assert np.array(mo.forward_kinematics(robot)(q)) == pytest.approx(pose, abs=1e-14)
    v, omega = (np.array(x) for x in mo.velocity_propagation(robot)(q, qd))
    twist = np.array(mo.jacobian(robot)(q)).reshape(6, 3) @ qd
    assert np.concatenate([pose[:3, :3] @ v[:, -1], pose[:3, :3] @ omega[:, -1]]) == pytest.approx(
        twist, abs=1e-14
    )
    plain = make()
    assert robot != plain
    assert make(beta=np.zeros(3)) == plain
