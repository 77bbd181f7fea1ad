"""Tracking, inverse kinematics and bad input; the other kinds have files of their own."""

import numpy as np
import pytest
from every_kind import branches, tracking
from reading import poses, read, scalars, static

import microbot_ocp as mo
from helpers import refused
from microbot_ocp.robot import forward_kinematics
from microbot_ocp.views.recording import file_writer, of_branches, of_motion, of_tracking


def test_tracking_shows_the_arm_beside_its_reference(tmp_path):
    recording = tracking()
    path = recording.save(tmp_path / "tracking.rrd")
    t, wanted = scalars(path, "/plots/q/elbow/desired")
    _, actual = scalars(path, "/plots/q/elbow/actual")
    _, error = scalars(path, "/plots/error/elbow/actual")
    np.testing.assert_allclose(error, wanted - actual, atol=1e-9)
    assert error[0] == pytest.approx(-10.0)
    ghost, arm = recording.arms
    assert (ghost.look.solid, arm.look.solid) == (False, True)
    for each in recording.arms:
        _, tool = poses(path, f"/world/{each.name}/tool")
        pose = np.array(forward_kinematics(recording.robot)(each.q[100]))
        np.testing.assert_allclose(tool[100], pose[:3, 3], atol=1e-5)
    assert not scalars(path, "/plots/tau/elbow/desired")[0].size
    _, words = read(path, "/saturation/actual/3_elbow", "StateChange:state")
    assert words[0] == ["torque at its upper limit"]
    assert t[-1] == pytest.approx(3.2)


def test_every_branch_is_a_ghost_and_one_arm_takes_them_in_turn(tmp_path):
    recording = branches()
    path = recording.save(tmp_path / "branches.rrd")
    count = len(recording.arms) - 1
    assert count == 8
    number, places = read(path, "/world/solution/tool", "Transform3D:translation", "branch")
    assert number.tolist() == list(range(1, count + 1))
    (target,) = static(path, "/world/places", "Points3D:positions")
    np.testing.assert_allclose(np.array(places)[:, 0], np.tile(target, (count, 1)), atol=1e-5)
    _, elbows = read(path, "/world/solution/link_3", "Transform3D:translation", "branch")
    for k in range(count):
        entity = f"/world/branch_{k + 1}/link_3"
        _, alone = read(path, entity, "Transform3D:translation", "branch")
        assert alone == [elbows[k]] * len(alone)
    axes = static(path, "/world/target", "TransformAxes3D:axis_length")
    assert axes[0] > 0
    text = static(path, "/summary", "TextDocument:text")[0]
    assert sum("solved" in line for line in text.splitlines()) == count


def test_bad_input_is_named(microbot, tmp_path):
    still = mo.Motion([0.0, 1.0], *np.zeros((4, 2, 2)))
    with refused("motion", "2 joints", "robot", "3"):
        of_motion(microbot, still)
    with refused("solutions", "IKSolution"):
        of_branches(microbot, [], np.zeros(3))
    run = mo.track(
        microbot, mo.Motion([0.0, 1.0], *np.zeros((4, 2, 3))), mo.Feedforward(), q0=[0.1, 0, 0]
    )
    with refused("tracking", "3 joints", "robot", "7"):
        of_tracking(mo.load_robot("panda"), run)


def test_what_fails_leaves_no_file_behind(tmp_path, comparison):
    from microbot_ocp.views.recording import of_comparison

    target = tmp_path / "half.rrd"
    layout = of_comparison(comparison).blueprint()
    with pytest.raises(RuntimeError, match="on the way"), file_writer(target, layout):
        raise RuntimeError("on the way")
    assert list(tmp_path.iterdir()) == []


def test_motion_and_tracking_write_themselves(microbot, tmp_path):
    motion = mo.Motion.from_polynomial(
        microbot, mo.cubic([[0, 0, 0], [1, 1, 1]], [0, 3]), label="m"
    )
    path = motion.to_rerun(microbot, tmp_path / "m.rrd")
    assert static(path, "/world/places", "Points3D:labels") == ["start", "end"]
    run = mo.track(microbot, motion, mo.ComputedTorque(100.0))
    path = run.to_rerun(microbot, tmp_path / "t.rrd")
    _, error = scalars(path, "/plots/error/waist/actual")
    assert np.abs(error).max() < 1e-3  # deg


def test_title_makes_a_name_that_the_viewer_takes(microbot, tmp_path, capfd):
    motion = mo.Motion.from_polynomial(
        microbot, mo.cubic([[0, 0, 0], [1, 1, 1]], [0, 3]), label="cubic's, 50 % / ü: (1)"
    )
    of_motion(microbot, motion).save(tmp_path / "odd.rrd")
    assert capfd.readouterr().err == ""
