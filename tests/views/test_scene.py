"""Geometry, via points and limits as every view takes them."""

from dataclasses import replace

import numpy as np
import pytest

from microbot_ocp.robot import Limits, forward_kinematics
from microbot_ocp.views import _scene as scene


def test_origins_and_rotations_agree_with_single_poses(comparison):
    robot, q = comparison.robot, comparison.via_q
    origins = scene.link_origins(robot, q)
    assert origins.shape == (3, 5, 3)
    poses = scene.link_poses(robot, q)
    assert poses.shape == (3, 5, 4, 4)
    np.testing.assert_array_equal(poses[:, 0], np.broadcast_to(np.eye(4), (3, 4, 4)))
    for frame in (1, 2, 3, 4):
        for i, row in enumerate(q):
            pose = np.array(forward_kinematics(robot, frame)(row))
            np.testing.assert_allclose(origins[i, frame], pose[:3, 3], atol=1e-12)
            np.testing.assert_allclose(poses[i, frame], pose, atol=1e-12)


def test_via_passages_follow_the_marks(comparison):
    motion = comparison.entries[1].motion
    passages = scene.via_passages(comparison, motion)
    assert [p.via for p in passages] == [0, 1, 2]
    assert [p.time for p in passages] == pytest.approx([0.0, 1.2, 2.6])


def test_via_point_without_a_mark_is_left_out(comparison):
    motion = replace(comparison.entries[1].motion, marks=())
    assert [p.via for p in scene.via_passages(comparison, motion)] == [0, 2]


def test_near_limit_is_drawn_and_far_one_told(comparison):
    q = scene.axis_limits(comparison, "q", 0)
    assert (q.lower, q.upper) == (None, None)
    assert q.far == "limits ±360 deg"
    assert q.axis[1] - q.axis[0] < 110
    speed = scene.axis_limits(comparison, "qd", 0)
    assert (speed.lower, speed.upper) == (-2.0, 2.0)
    assert speed.far == ""
    one_sided = scene.axis_limits(comparison, "qd", 1)
    assert (one_sided.lower, one_sided.upper) == (None, 2.0)
    assert one_sided.far == "lower limit −2 rad/s"


def test_no_limit_is_neither_drawn_nor_told(comparison):
    limitless = replace(comparison, limits=Limits().for_joints(3))
    for quantity in scene.QUANTITIES:
        limits = scene.axis_limits(limitless, quantity, 0)
        assert (limits.lower, limits.upper, limits.far) == (None, None, "")
