"""Files are read back as they were written, however joints and marks are called."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st

import microbot_ocp as mo
from helpers import refused, warned
from microbot_ocp.execution import read_rows
from microbot_ocp.motion import Columns, write_columns

yaml = pytest.importorskip("yaml")

UNUSUAL = [
    "t", "q", "time", "mark", "joint (1)", "joint [rad]", "elbow ", " elbow", "q elbow", "elbow",
    "qd elbow [rad/s]", "[m]", "a,b", 'the "third"', "line\nbreak", "# 1", "1", "1e3",
    "é\u2028", "joint_1", "joint_2",
]  # fmt: skip
NAME = st.one_of(st.sampled_from(UNUSUAL), st.text(min_size=1, max_size=8))


def arm(names: list[str], kind: str = "revolute") -> mo.Robot:
    count = len(names)
    kinds = [kind] + ["revolute"] * (count - 1)
    zero = np.zeros(count)
    return mo.Robot.from_dh(
        zero, zero + 1.0, zero, zero, kinds, joint_names=names, convention="modified"
    )


@cache
def moved(count: int) -> mo.Motion:
    goal = 0.1 * np.arange(1, count + 1)
    shape = mo.quintic([np.zeros_like(goal), goal], [0.0, 1.0])
    robot = arm([f"joint {number}" for number in range(count)])
    return mo.Motion.from_polynomial(robot, shape, label="quintic").resample(4.0)


def the_same(rows: object, motion: mo.Motion) -> None:
    for key in ("t", "q", "qd", "qdd"):
        np.testing.assert_allclose(getattr(rows, key), getattr(motion, key), rtol=0, atol=1e-9)


@pytest.mark.slow
@settings(max_examples=6, deadline=None)
@given(
    st.lists(NAME, min_size=2, max_size=4, unique=True), st.sampled_from(["revolute", "prismatic"])
)
@example(["joint (1)", "joint [rad]", "t", "elbow "], "prismatic")
@example(["elbow", "q elbow", "qd elbow [rad/s]"], "revolute")
@example(["joint_2", "joint_1"], "revolute")
def test_any_names_of_joints(names: list[str], kind: str) -> None:
    robot = arm(names, kind)
    motion = moved(robot.joint_count)
    with TemporaryDirectory() as folder:
        for ending in ("csv", "json"):
            the_same(read_rows(motion.export(f"{folder}/a.{ending}", robot=robot), robot), motion)
        message = json.loads(Path(folder, "a.json").read_text("utf-8"))
        Path(folder, "a.yaml").write_text(yaml.safe_dump(message), "utf-8")
        the_same(read_rows(f"{folder}/a.yaml", robot), motion)
        the_same(read_rows(motion.save(f"{folder}/a.npz"), robot), motion)
        numbered = arm(["waist", "shoulder", "elbow", "wrist"][: len(names)], "revolute")
        for ending in ("csv", "json"):  # without a robot joints are numbered
            the_same(read_rows(motion.export(f"{folder}/b.{ending}"), numbered), motion)
        path = f"{folder}/a.toml"
        mo.save_robot(robot, path)
        assert mo.load_robot(path).joint_names == robot.joint_names


@settings(max_examples=15, deadline=None)
@given(st.lists(st.text(min_size=1, max_size=8), max_size=3))
@example(["a; b", "50% @ 0.7", "over\nthe edge ", "%40"])
def test_any_names_of_marks(names: list[str]) -> None:
    robot = arm(["waist", "elbow"])
    motion = moved(robot.joint_count)
    marks = tuple(
        (float(time), name) for time, name in zip([0.25, 0.25, 0.27, 1.0], names, strict=False)
    )
    with TemporaryDirectory() as folder:
        for ending in ("csv", "json"):
            path = write_columns(f"{folder}/a.{ending}", Columns.of(motion, robot, marks=marks))
            rows = read_rows(path, robot)
            assert [mark.name for mark in rows.marks] == [name for _, name in marks]
            times = [mark.time for mark in rows.marks]
            np.testing.assert_allclose(times, [time for time, _ in marks], atol=1e-9)
            the_same(rows, motion)


@pytest.mark.parametrize("ending", ["csv", "json", "yaml", "npz"])
def test_joints_of_a_gripper_are_passed_over_with_a_warning(tmp_path: Path, ending: str) -> None:
    arm_and_hand, robot = arm(["finger", "waist", "elbow"]), arm(["waist", "elbow"])
    motion, path = moved(3), tmp_path / f"a.{ending}"
    if ending == "npz":
        np.savez(path, t=motion.t, q=motion.q, joint_names=arm_and_hand.joint_names)
    elif ending == "yaml":
        path.write_text(motion.export(tmp_path / "a.json", robot=arm_and_hand).read_text())
    else:
        motion.export(path, robot=arm_and_hand)
    with warned("not judged", "joints: finger"):
        rows = read_rows(path, robot)
    np.testing.assert_allclose(rows.q, motion.q[:, 1:], rtol=0, atol=1e-12)


@pytest.mark.parametrize("names", [["waist"], ["waist", "elbow", "elbow"], ["waist", "wrist"]])
def test_a_joint_that_is_missing_or_there_twice(tmp_path: Path, names: list[str]) -> None:
    point = {"positions": [0.0] * len(names), "time_from_start": 0.0}
    document = {"joint_names": names, "points": [point, {**point, "time_from_start": 1.0}]}
    path = tmp_path / "a.json"
    path.write_text(json.dumps(document))
    with refused("a.json", "waist, elbow, not", ", ".join(names)):
        read_rows(path, arm(["waist", "elbow"]))


def test_names_that_yaml_reads_as_numbers(tmp_path: Path) -> None:
    rows = [{"positions": [float(k), 2.0 * k], "time_from_start": float(k)} for k in range(2)]
    path = tmp_path / "a.yaml"
    path.write_text(json.dumps({"joint_names": [2, 1], "points": rows}))
    assert read_rows(path, arm(["1", "2"])).q.tolist() == [[0.0, 0.0], [2.0, 1.0]]


TWO = [{"positions": [0.1 * k, 0.2 * k], "time_from_start": float(k)} for k in range(2)]
ROWS = {"joint_names": ["waist", "elbow"], "points": TWO}
EMPTY = {"joint_names": [], "points": []}


@pytest.mark.parametrize(
    "message",
    [
        ROWS,
        {"joint_trajectory": ROWS, "multi_dof_joint_trajectory": EMPTY},
        {"model_id": "arm", "trajectory": [{"joint_trajectory": ROWS}], "trajectory_start": {}},
        {"trajectory": {"joint_trajectory": ROWS}, "error_code": {"val": 1}, "group_name": "arm"},
        {"motion_plan_response": {"trajectory": {"joint_trajectory": ROWS}}},
        {
            "planned_trajectory": {"joint_trajectory": ROWS},
            "executed_trajectory": {"joint_trajectory": EMPTY},
        },
        {
            "trajectory": ROWS,
            "multi_dof_trajectory": EMPTY,
            "path_tolerance": [{"name": "waist", "position": 0.1}],
            "goal_time_tolerance": {"sec": 1, "nanosec": 0},
        },
        {"header": {}, "goal_id": {"id": ""}, "goal": {"trajectory": ROWS}},
    ],
)
def test_messages_that_hold_a_trajectory(tmp_path: Path, message: dict[str, Any]) -> None:
    path = tmp_path / "a.json"
    path.write_text(json.dumps(message))
    assert read_rows(path, arm(["waist", "elbow"])).q.tolist() == [[0.0, 0.0], [0.1, 0.2]]


@pytest.mark.parametrize(
    ("message", "path"),
    [
        ({**ROWS, "joint_name": []}, "joint_name is "),
        (
            {**ROWS, "points": [{**TWO[0], "velocity": [0, 0]}, TWO[1]]},
            "points[0].velocity is ",
        ),
        (
            {"joint_trajectory": ROWS, "multi_dof_joint_trajectory": {"points": [{"a": 1}]}},
            "multi_dof_joint_trajectory.points is ",
        ),
        (
            {
                "trajectory": [{"joint_trajectory": ROWS}],
                "trajectory_start": {"attached_collision_objects": [{"link_name": "hand"}]},
            },
            "trajectory_start.attached_collision_objects is ",
        ),
        (
            {"trajectory": {"joint_trajectory": ROWS}, "error_code": {"val": -1}},
            "error_code.val is -1",
        ),
        ({"trajectory": ROWS, "goal_tolerences": []}, "goal_tolerences is "),
    ],
)
def test_fields_that_a_check_cannot_keep(tmp_path: Path, message: Any, path: str) -> None:
    file = tmp_path / "a.json"
    file.write_text(json.dumps(message))
    with refused(f"a.json: {path}"):
        read_rows(file, arm(["waist", "elbow"]))


def test_marks_of_a_message_are_beside_it(tmp_path):
    """A message of ROS has no field of marks, and strict readers refused the whole file."""
    robot = mo.load_robot("microbot")
    shape = mo.quintic([[0.0, 0.0, 0.0], [0.3, 0.4, 0.2]], [0.0, 2.0])
    marks = [mo.motion.Mark(0.0, "grip"), mo.motion.Mark(2.0, "release")]
    motion = mo.Motion.from_polynomial(robot, shape, label="a", marks=marks)
    path, beside = tmp_path / "a.json", tmp_path / "a.marks.json"
    for names, marked in ((["grip", "release"], motion), ([], replace(motion, marks=()))):
        marked.export(path, profile="ros2_jtc_quintic@50", robot=robot)
        document = json.loads(path.read_text("utf-8"))
        assert set(document) == {"header", "joint_names", "points"}
        assert beside.exists() == bool(names)
        assert [mark.name for mark in mo.execution.read_rows(path, robot).marks] == names
    motion.export(path, robot=robot)  # without a profile a file has no marks
    assert not beside.exists()
    motion.export(path, profile="ros2_jtc_quintic@50", robot=robot)
    for text, said in (
        ('{"of": "0", "marks": []}', ("another file", "a.json: remove")),
        ("[]", ("list", "marks")),
        ("{", ("no JSON",)),
    ):
        beside.write_text(text)
        with refused("a.marks.json: ", *said):
            mo.execution.read_rows(path, robot)
