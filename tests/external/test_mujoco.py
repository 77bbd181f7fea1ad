"""Inverse and forward dynamics against MuJoCo at random states, by way of an MJCF text."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import microbot_ocp as mo
from helpers import RANDOM_CHAINS, any_robot, batch, difference, random_states, two_link_arm
from microbot_ocp.robot import dh_transform

mujoco = pytest.importorskip("mujoco")

STATES = 200
RELATIVE = 1e-10  # MuJoCo diagonalises inertias and turns rotations into quaternions


def mjcf(robot: mo.Robot) -> str:
    """Nested bodies, one hinge or slide along Z each, explicit inertials, no contact."""

    def text(values: Any) -> str:
        return " ".join(f"{value:.17g}" for value in np.ravel(values))

    opening, closing = [], []
    for joint, link in enumerate(robot.links):
        row = (robot.alpha[joint], robot.a[joint], robot.d[joint], robot.theta_offset[joint])
        placement = dh_transform(*row)
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, placement[:3, :3].ravel())
        kind = "hinge" if robot.joint_types[joint] == "revolute" else "slide"
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = link.inertia
        opening.append(
            f'<body pos="{text(placement[:3, 3])}" quat="{text(quaternion)}">'
            f'<joint type="{kind}" axis="0 0 1" armature="{link.armature:.17g}" '
            f'damping="{link.viscous_friction:.17g}"/>'
            f'<inertial pos="{text(link.center_of_mass)}" mass="{link.mass:.17g}" '
            f'fullinertia="{text([xx, yy, zz, xy, xz, yz])}"/>'
        )
        closing.append("</body>")
    return (
        '<mujoco><compiler angle="radian"/>'
        f'<option gravity="{text(robot.gravity)}">'
        '<flag contact="disable" energy="disable" constraint="disable"/></option>'
        f"<worldbody>{''.join(opening + closing)}</worldbody></mujoco>"
    )


def with_small_bodies(robot: mo.Robot) -> mo.Robot:
    """MuJoCo takes no point masses: each link as a ball of 0.01 kg m^2."""
    return robot.with_links([replace(link, inertia=0.01 * np.eye(3)) for link in robot.links])


def with_damping(robot: mo.Robot) -> mo.Robot:
    return robot.with_links([replace(link, viscous_friction=0.7) for link in robot.links])


@pytest.fixture(scope="module", params=["microbot", *RANDOM_CHAINS])
def robot(request: pytest.FixtureRequest) -> mo.Robot:
    found = any_robot(request.param)
    return with_damping(with_small_bodies(found) if request.param == "microbot" else found)


def test_inverse_dynamics_is_the_one_of_mujoco(robot: mo.Robot) -> None:
    model = mujoco.MjModel.from_xml_string(mjcf(robot))
    data = mujoco.MjData(model)
    q, qd, qdd = random_states(robot, STATES, seed=5)
    theirs = []
    for data.qpos[:], data.qvel[:], data.qacc[:] in zip(q, qd, qdd, strict=True):
        mujoco.mj_inverse(model, data)
        theirs.append(data.qfrc_inverse.copy())
    assert difference(batch(mo.inverse_dynamics(robot), q, qd, qdd), theirs) < RELATIVE


def test_forward_dynamics_is_the_one_of_mujoco(robot: mo.Robot) -> None:
    model = mujoco.MjModel.from_xml_string(mjcf(robot))
    data = mujoco.MjData(model)
    q, qd, qdd = random_states(robot, STATES, seed=6)
    well = batch(mo.robot.mass_matrix_condition(robot), q)[:, 0] < 1e4
    assert well.mean() > 0.9
    q, qd, tau = q[well], qd[well], 10.0 * qdd[well]
    theirs = []
    for data.qpos[:], data.qvel[:], data.qfrc_applied[:] in zip(q, qd, tau, strict=True):
        mujoco.mj_forward(model, data)
        theirs.append(data.qacc.copy())
    assert difference(batch(mo.forward_dynamics(robot), q, qd, tau), theirs) < RELATIVE


def test_torques_of_a_cycle_are_those_of_mujoco_with_the_part_as_a_body_of_its_own():
    """Pick 0.8 kg with an inertia, bring it over, put it down, go back: two models, one motion."""
    robot = with_small_bodies(two_link_arm(1.0, 0.8)).with_limits(tau_max=[60.0, 25.0], qd_max=3.0)
    part = mo.Payload(0.8, [0.1, 0.05, 0.0], 0.02 * np.eye(3))
    stops = [mo.Stop(q=[0.3, 0.4], payload=part, name="pick"), mo.Stop(q=[1.2, -0.5], payload=0.0)]
    motion = mo.time_optimal(robot, stops, cycle=True, mesh=20, starts=1, compiled=False)
    assert mo.certify(robot, motion, via_q=stops, cycle=True).ok
    inertial = f'<body pos="{0.8 + 0.1} 0.05 0"><inertial pos="0 0 0" mass="0.8" '
    body = f'{inertial}diaginertia="0.02 0.02 0.02"/></body>'
    empty = mjcf(robot)
    text = {True: empty.replace("</body></body>", f"{body}</body></body>", 1), False: empty}
    for loaded, of_part in text.items():
        model = mujoco.MjModel.from_xml_string(of_part)
        data = mujoco.MjData(model)
        before = motion.t < motion.marks[1].time
        for k in np.flatnonzero(before if loaded else ~before)[::20]:
            data.qpos[:], data.qvel[:] = motion.q[k], motion.qd[k]
            data.qacc[:] = motion.qdd[k]
            mujoco.mj_inverse(model, data)
            np.testing.assert_allclose(data.qfrc_inverse, motion.tau[k], rtol=1e-9, atol=1e-8)
