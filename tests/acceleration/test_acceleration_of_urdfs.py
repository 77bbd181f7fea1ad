"""Boxes of accelerations of arms from URDF files that others maintain, attacked by samples."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import microbot_ocp as mo

pytest.importorskip("pinocchio")
from external.urdf_packages import files

CHAINS = {
    "arms/ur3e.urdf": "tool0",
    "allegro_hand_description/allegro_left_hand.urdf": "link_11.0_tip",
    "g1_description/g1_29dof_rev_1_0.urdf": "left_ankle_roll_link",
    "human_description/human.urdf": "left_foot",
    "kinova_description/kinova.urdf": "j2s6s200_end_effector",
    "romeo_description/romeo_small.urdf": "gaze",
    "simple_humanoid_description/simple_humanoid.urdf": "r_ankle",
    "so_arm_description/so101.urdf": "gripper_frame_link",
    "ur_description/ur10_robot.urdf": "ee_link",
    "xarm_description/xarm7.urdf": "link_eef",
}


@pytest.mark.thorough
@pytest.mark.parametrize("label", CHAINS)
def test_no_state_breaks_a_proved_box(label: str) -> None:
    (path,) = (file.path for file in files() if file.label == label)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        robot = mo.load_robot(str(path), CHAINS[label])
    share = 0.1 if robot.joint_count > 6 else 0.3
    speed = np.minimum(share * robot.limits.qd_max, 2.0)
    found = mo.acceleration_limits(robot, (0.0, 0.2), speed=speed, equal=True, work=30.0)
    if found.status == mo.Status.INFEASIBLE:
        assert found.state.torque > found.state.limit
        return
    assert found.qdd_max.all()
    assert found.solved == (found.gap <= 0.1 + 1e-9)
    assert found.state.torque == pytest.approx(found.state.limit)
    rng = np.random.default_rng(1)
    for load in (0.0, 0.1, 0.2):
        low, high = np.clip(robot.limits.bounds("q"), -np.pi, np.pi)
        q = rng.uniform(low, high, (100_000, robot.joint_count))
        shares, signs = np.sign(rng.uniform(-1, 1, (2, *q.shape)))
        arm = robot.with_payload(load)
        tau = arm.torques_along(q, shares * speed, signs * found.qdd_max)["tau"]
        assert (tau <= robot.limits.tau_max).all()
        assert (tau >= robot.limits.tau_min).all()
