"""Inverse and forward dynamics against MuJoCo at random states, by way of an MJCF text."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.mujoco_arms import mjcf, with_small_bodies

import microbot_ocp as mo
from helpers import RANDOM_CHAINS, any_robot, batch, difference, random_states, two_link_arm

mujoco = pytest.importorskip("mujoco")

STATES = 200
RELATIVE = 1e-10  # MuJoCo diagonalises inertias and turns rotations into quaternions


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


@pytest.mark.thorough
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
