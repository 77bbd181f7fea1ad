"""The recording, read back."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from reading import FLOAT32, poses, read, rotations, scalars, static
from rerun.chunk import RrdReader

from helpers import refused, tells
from microbot_ocp.motion import Motion, State
from microbot_ocp.robot import Limits, Link, Robot, forward_kinematics
from microbot_ocp.tasks import Comparison
from microbot_ocp.views import _scene as scene
from microbot_ocp.views.recording import of_comparison
from microbot_ocp.views.recording._writer import LIMIT_DASHES, plot_path

pytestmark = pytest.mark.slow


def test_curves_hold_the_samples_of_the_motion(comparison, recording):
    for entry in comparison.entries[:3]:
        motion = entry.motion
        for quantity, factor in (("q", 180 / np.pi), ("qd", 1.0), ("tau", 1.0)):
            for joint, name in enumerate(comparison.robot.joint_names):
                t, values = scalars(recording, f"/plots/{quantity}/{name}/{entry.name}")
                index = np.abs(motion.t[:, None] - t).argmin(axis=0)
                np.testing.assert_allclose(t, motion.t[index], atol=1e-9)
                expected = getattr(motion, quantity)[index, joint] * factor
                np.testing.assert_allclose(values, expected, rtol=1e-12, atol=1e-12)
                assert t[-1] == pytest.approx(motion.duration)


def test_curves_keep_both_sides_of_a_jump(comparison, recording):
    motion = comparison.entries[0].motion
    t, values = scalars(recording, "/plots/tau/shoulder/cubic_report")
    before = np.flatnonzero(np.diff(t) < 3e-6)
    assert t[before + 1] == pytest.approx([1.6])
    jump = values[before + 1] - values[before]
    at = int(np.searchsorted(motion.t, 1.6 - 1e-9))
    assert jump == pytest.approx([motion.tau[at, 1] - motion.tau[at - 1, 1]])
    assert abs(jump[0]) > 100


def test_tool_follows_forward_kinematics(comparison, recording):
    size = scene.reach(comparison.robot)
    for entry in comparison.entries[:3]:
        t, tool = poses(recording, f"/world/{entry.name}/tool")
        q = entry.motion.sample(np.minimum(t, entry.motion.duration)).q
        expected = scene.link_origins(comparison.robot, q)[:, -1]
        np.testing.assert_allclose(tool, expected, atol=FLOAT32 * size)


def test_links_and_tool_have_the_pose_of_their_frames(comparison, recording):
    robot, count = comparison.robot, comparison.robot.joint_count
    for frame in range(1, count + 2):
        turning = f"link_{frame}" if frame <= count else "tool/frame"
        placed = f"link_{frame}" if frame <= count else "tool"
        t, rows = read(recording, f"/world/cubic/{turning}", "Transform3D:quaternion")
        turned = rotations(np.array(rows)[:, 0])
        _, places = poses(recording, f"/world/cubic/{placed}")
        q = comparison.entries[1].motion.sample(np.minimum(t, 2.6)).q
        for i in (0, 100, 317, len(t) - 1):
            pose = np.array(forward_kinematics(robot, frame)(q[i]))
            np.testing.assert_allclose(turned[i], pose[:3, :3], atol=1e-5)
            np.testing.assert_allclose(places[i], pose[:3, 3], atol=1e-5)


def test_links_have_their_lengths(recording):
    lengths = [
        static(recording, f"/world/cubic/link_{k}/shape", "Capsules3D:lengths") for k in (0, 2, 3)
    ]
    np.testing.assert_allclose(lengths, [[2.0], [3.0], [4.0]])


def test_early_motion_waits_in_its_last_pose(recording):
    t, tool = poses(recording, "/world/time_optimal/tool")
    assert t[-1] == pytest.approx(3.4)
    assert t[-2] == pytest.approx(1.5)
    np.testing.assert_allclose(tool[-1], [0, 4, 5], atol=1e-5)


def test_trail_is_one_short_strip_a_frame(recording):
    t, tool = poses(recording, "/world/cubic/tool")
    t_trail, strips = read(recording, "/world/cubic/trail", "LineStrips3D:strips")
    np.testing.assert_allclose(t_trail, t[1:])
    ends = np.array(strips)
    assert ends.shape == (len(t) - 1, 1, 2, 3)
    np.testing.assert_allclose(ends[:, 0, 1], tool[1:])
    np.testing.assert_allclose(ends[:, 0, 0], tool[:-1])


def test_limits_are_dashed_and_far_ones_left_out(recording):
    t, rows = read(recording, "/plots/qd/waist/limit_upper", "Scalars:scalars")
    assert t[-1] <= 3.4 + 1e-9
    assert {tuple(row) for row in rows} == {(2.0,), ()}
    assert rows[2::3] == [[]] * LIMIT_DASHES
    with refused("expected 1", "got 0", error=ValueError):
        static(recording, "/plots/q/waist/limit_upper", "SeriesLines:names")
    (text,) = static(recording, "/summary", "TextDocument:text")
    tells(text, "position of waist", "±360 deg")


def test_words_and_marks(recording):
    text = static(recording, "/summary", "TextDocument:text")[0]
    tells(text, "not solved", "infeasible")
    t, rows = read(recording, "/marks/cubic", "TextLog:text")
    told = {row[0]: time for time, row in zip(t, rows, strict=True)}
    for number, time in enumerate((0.0, 1.2, 2.6), start=1):
        assert told[f"via {number}: cubic, scaled"] == pytest.approx(time)
    vias = static(recording, "/world/places", "Points3D:labels")
    assert vias == ["via 1", "via 2", "via 3"]


def test_one_solid_arm_among_ghosts(recording):
    alphas = {
        name: static(recording, f"/world/{name}/link_2/shape", "Capsules3D:colors")[0] & 0xFF
        for name in ("cubic_report", "cubic", "time_optimal")
    }
    assert alphas == {"cubic_report": 110, "cubic": 110, "time_optimal": 255}
    radii = {
        static(recording, f"/world/{name}/link_2/shape", "Capsules3D:radii")[0] for name in alphas
    }
    assert len(radii) == 3


def test_file_is_valid_small_and_holds_its_layout(recording):
    assert recording.stat().st_size < 3e6
    assert len(RrdReader(recording).blueprints()) == 1
    assert not list(recording.parent.glob("*.part"))
    command = [sys.executable, "-m", "rerun", "rrd", "verify", str(recording)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_failures_alone_can_be_recorded(comparison, tmp_path):
    nothing = replace(comparison, entries=comparison.entries[3:])
    path = of_comparison(nothing).save(tmp_path / "nothing.rrd")
    assert "not solved" in static(path, "/summary", "TextDocument:text")[0]


def test_prismatic_joint_stretches_its_link(solved_entry, tmp_path):
    robot = Robot.from_dh(
        alpha=[0.0, 0.0],
        a=[0.0, 0.5],
        d=[0.3, 0.1],
        joint_type=["revolute", "prismatic"],
        links=[Link(1.0, [0.1, 0, 0], np.eye(3) * 0.01)] * 2,
        limits=Limits(q_min=-4, q_max=4, qd_max=5.0, tau_max=50.0),
        joint_names=["turn it", "slide"],
        tool=[0.0, 0.0, 0.2, 0.0],
    )
    t = np.linspace(0, 1, 101)
    q = np.column_stack([t, 0.4 * t])
    state = State(q, np.tile([1.0, 0.4], (101, 1)), np.zeros((101, 2)))
    motion = Motion.from_state(robot, t, state, label="line")
    entry = solved_entry(robot, robot.limits, "line", "line", motion)
    comparison = Comparison(robot, q[[0, -1]], robot.limits, (entry,), "line")
    path = of_comparison(comparison).save(tmp_path / "slide.rrd")
    times, lengths = read(path, "/world/line/link_1/shape", "Capsules3D:lengths")
    np.testing.assert_allclose(
        np.array(lengths)[:, 0], np.hypot(0.5, 0.1 + 0.4 * times), rtol=FLOAT32
    )
    _, values = scalars(path, plot_path("q", "turn it", "line"))
    assert values[-1] == pytest.approx(180 / np.pi)
    _, values = scalars(path, "/plots/q/slide/line")
    assert values[-1] == pytest.approx(0.4)
