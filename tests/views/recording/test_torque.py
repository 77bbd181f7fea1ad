"""Arcs and arrows at the joints, read back against torque and limit."""

import numpy as np
import pytest
from every_kind import prismatic
from reading import FLOAT32, read
from rerun.chunk import RrdReader

from microbot_ocp.motion import Motion
from microbot_ocp.robot import Limits, Robot
from microbot_ocp.views import _palette as palette
from microbot_ocp.views._style import TORQUE_RING
from microbot_ocp.views.recording import arcs, of_motion, signed_share

PINK = int.from_bytes(bytes(palette.SATURATED), "big")


def swept_angle(points):
    """Angle that a polyline [P,3] turns about the z axis, rad, with its sign."""
    angle = np.unwrap(np.arctan2(points[:, 1], points[:, 0]))
    return angle[-1] - angle[0]


@pytest.fixture(scope="module")
def swing(microbot, tmp_path_factory):
    """A motion whose torques are made up to run through a limit, and its recording."""
    t = np.linspace(0.0, 1.0, 201)
    still = np.zeros((201, 3))
    tau = np.column_stack([300 * np.sin(2 * np.pi * t), 500 * (2 * t - 1), 50 * t])
    motion = Motion(t, still + 0.3 * t[:, None], still, still, tau)
    limits = Limits(tau_max=([-200.0, -500.0, -np.inf], [400.0, 500.0, np.inf]))
    robot = microbot.with_limits(limits)
    return motion, of_motion(robot, motion).save(tmp_path_factory.mktemp("rrd") / "swing.rrd")


def test_arc_sweeps_the_share_of_the_limit_and_closes_at_it(swing):
    motion, path = swing
    for joint, bounds in enumerate([(200.0, 400.0), (500.0, 500.0), (50.0, 50.0)]):
        entity = f"/world/motion/link_{joint + 1}/torque"
        t, strips = read(path, entity, "LineStrips3D:strips")
        tau = np.interp(t, motion.t, motion.tau[:, joint])
        share = np.clip(np.where(tau < 0, tau / bounds[0], tau / bounds[1]), -1, 1)
        found = [swept_angle(np.array(strip[0])[:-3]) for strip in strips]
        np.testing.assert_allclose(found, 2 * np.pi * share, atol=1e-4)
        radii = np.linalg.norm(np.array(strips)[:, 0, :-3], axis=-1)
        np.testing.assert_allclose(radii, radii[0, 0], rtol=FLOAT32)


def test_arc_is_pink_and_thick_at_the_limit_and_nowhere_else(swing):
    motion, path = swing
    for joint in range(3):
        entity = f"/world/motion/link_{joint + 1}/torque"
        t, colors = read(path, entity, "LineStrips3D:colors")
        _, radii = read(path, entity, "LineStrips3D:radii")
        tau = np.interp(t, motion.t, motion.tau[:, joint])
        full = [(tau >= 396) | (tau <= -198), np.abs(tau) >= 495, np.zeros(len(t), bool)][joint]
        np.testing.assert_array_equal([row[0] == PINK for row in colors], full)
        thick = np.array(radii)[:, 0]
        assert np.ptp(thick[~full]) == 0
        assert np.all(thick[full] > 1.5 * thick[~full][0])
    assert full.sum() == 0  # the last joint has no limit


def test_slide_has_an_arrow_along_its_axis(tmp_path):
    recording = prismatic()
    path = recording.save(tmp_path / "slide.rrd")
    joint = recording.robot.joint_types.index("prismatic")
    _, vectors = read(path, f"/world/motion/link_{joint + 1}/torque", "Arrows3D:vectors")
    vectors = np.array(vectors)[:, 0]
    np.testing.assert_array_equal(vectors[:, :2], 0.0)
    arm = recording.arms[0]
    share = arm.curves["tau"][:, joint] / recording.limits.tau_max[joint]
    assert 0.2 < np.abs(share).max() < 1.0
    np.testing.assert_allclose(vectors[:, 2], 3 * TORQUE_RING * arm.look.radius * share, rtol=1e-5)


def test_share_of_a_limit_of_zero():
    limits = Limits(tau_max=([0.0], [10.0])).for_joints(1)
    share, at_limit = signed_share(limits, "tau", np.array([-1.0, 0.0, 5.0]), 0)
    assert at_limit.tolist() == [True, False, False]
    np.testing.assert_array_equal(share, [-1.0, 0.0, 0.5])


def test_no_torque_draws_no_arc():
    strips = arcs(np.zeros(1), 2.0)
    np.testing.assert_array_equal(strips, np.broadcast_to([2.0, 0.0, 0.0], strips.shape))


def test_arms_without_masses_have_neither_arcs_nor_balls(microbot, swing, tmp_path):
    motion, heavy = swing
    bare = Robot.from_dh(microbot.alpha, microbot.a, microbot.d, tool=microbot.tool)
    path = of_motion(bare, motion).save(tmp_path / "bare.rrd")
    drawn = [
        {c.entity_path for c in RrdReader(file).stream().to_chunks()} for file in (heavy, path)
    ]
    for leaf in ("torque", "center_of_mass"):
        entity = f"/world/motion/link_2/{leaf}"
        assert [entity in paths for paths in drawn] == [True, False]
