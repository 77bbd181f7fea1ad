"""Motions read back from the files of other programs."""

import csv
import json

import numpy as np
import pytest

import microbot_ocp as mo
from helpers import refused

FIELDS = {"positions": "q", "velocities": "qd", "accelerations": "qdd", "effort": "tau"}


@pytest.fixture(scope="module")
def robot():
    return mo.load_robot("stanford")


@pytest.fixture(scope="module")
def motion(robot):
    """A motion whose acceleration jumps on the way: two samples 1 us apart."""
    via = np.zeros((3, robot.joint_count))
    via[:, 2] = 0.5
    via[1] += 0.2
    via[2] += 0.5
    shape = mo.lspb(via, [0.0, 1.0, 2.2], 0.3)
    return mo.Motion.from_polynomial(robot, shape, label="lspb")


def test_csv_has_units_in_its_heads(motion, robot, tmp_path):
    path = motion.export(tmp_path / "a.csv", robot=robot)
    with path.open(newline="", encoding="utf-8") as stream:
        heads, *rows = csv.reader(stream)
    assert heads[0] == "t [s]"
    third = robot.joint_names[2]
    assert f"q {third} [m]" in heads
    assert f"tau {third} [N]" in heads
    assert f"qd {robot.joint_names[0]} [rad/s]" in heads
    expected = np.column_stack([motion.t, motion.q, motion.qd, motion.qdd, motion.tau])
    np.testing.assert_array_equal(np.array(rows, dtype=float), expected)


def test_a_rate_gives_evenly_spaced_samples_and_the_end(motion, tmp_path):
    path = motion.export(tmp_path / "a.csv", rate=100.0)
    t = np.loadtxt(path, delimiter=",", skiprows=1)[:, 0]
    np.testing.assert_allclose(t, np.append(np.arange(220) / 100.0, 2.2))


def test_ros_trajectory(motion, robot, tmp_path):
    """Fields of trajectory_msgs/JointTrajectory and its point, builtin_interfaces/Duration."""
    document = json.loads(motion.export(tmp_path / "a.json", robot=robot).read_text("utf-8"))
    assert set(document) == {"header", "joint_names", "points"}
    assert set(document["header"]) == {"stamp", "frame_id"}
    assert document["joint_names"] == list(robot.joint_names)
    points = document["points"]
    assert all(set(point) == {*FIELDS, "time_from_start"} for point in points)
    stamps = [point["time_from_start"] for point in points]
    assert all(set(stamp) == {"sec", "nanosec"} for stamp in stamps)
    assert all(isinstance(value, int) for stamp in stamps for value in stamp.values())
    assert all(0 <= stamp["nanosec"] < 1_000_000_000 for stamp in stamps)
    t = np.array([stamp["sec"] + 1e-9 * stamp["nanosec"] for stamp in stamps])
    assert np.diff(t).min() > 1e-5  # controllers refuse times that do not increase
    at = motion.sample(t)
    for field, key in FIELDS.items():
        values = np.array([point[field] for point in points])
        assert values.shape == (t.size, robot.joint_count)
        if key in ("q", "qd"):
            np.testing.assert_allclose(values, getattr(at, key), atol=1e-7)


def test_matlab(motion, tmp_path):
    scipy_io = pytest.importorskip("scipy.io")
    found = scipy_io.loadmat(motion.export(tmp_path / "a.mat"), simplify_cells=True)
    np.testing.assert_array_equal(found["tau"], motion.tau)
    np.testing.assert_array_equal(found["t"].ravel(), motion.t)
    assert found["label"] == "lspb"


def test_parquet(motion, robot, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    table = parquet.read_table(motion.export(tmp_path / "a.parquet", robot=robot))
    assert table.num_rows == motion.t.size
    name = f"qdd {robot.joint_names[1]} [rad/s^2]"
    np.testing.assert_array_equal(table[name].to_numpy(), motion.qdd[:, 1])
    assert table.schema.metadata[b"label"] == b"lspb"


def test_keyframes_are_taken_by_mujoco(motion, robot, tmp_path):
    mujoco = pytest.importorskip("mujoco")
    path = motion.export(tmp_path / "keys.xml", rate=20.0)
    joints = "".join('<body><joint type="hinge"/><geom size=".1"/>' for _ in robot.joint_names)
    text = f"<mujoco><include file='{path.name}'/><worldbody>{joints}"
    text += "</body>" * robot.joint_count + "</worldbody></mujoco>"
    (tmp_path / "arm.xml").write_text(text)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    sampled = motion.resample(20.0)
    assert model.nkey == sampled.t.size
    np.testing.assert_allclose(model.key_qpos, sampled.q)
    np.testing.assert_allclose(model.key_qvel, sampled.qd)
    np.testing.assert_allclose(model.key_time, sampled.t)


def test_what_cannot_be_written_is_refused(motion, tmp_path):
    with refused("ending of path", ".csv, .json", "'.txt'"):
        motion.export(tmp_path / "a.txt")
    with refused("rate", "above 0 Hz", "not 0.0"):
        motion.export(tmp_path / "a.csv", rate=0.0)
    with refused("motion", "6 joints", "robot has 3"):
        motion.export(tmp_path / "a.csv", robot=mo.load_robot("microbot"))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("ending", [".csv", ".json", ".xml", ".mat", ".parquet"])
def test_what_takes_minutes_to_write_is_refused(motion, tmp_path, ending):
    with refused("number of samples", f"{ending} file", "2.2e+06"):
        motion.export(tmp_path / f"a{ending}", rate=1e6)
    assert not list(tmp_path.iterdir())


def test_a_trajectory_of_ros_ends_before_its_clock(motion, tmp_path):
    late = mo.Motion([0.0, 1e10], *(np.zeros((2, 3)),) * 4, label="late")
    with refused("ROS", "2^31 s", "1e+10 s"):
        late.export(tmp_path / "a.json")
    with refused("rate", "above 0 Hz", "not 0.0"):
        motion.export(tmp_path / "a.json", rate=0.0)
