"""Planning scenes and requests as MoveIt writes them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import microbot_ocp as mo
from microbot_ocp import InputError
from microbot_ocp.cli import main

pytest.importorskip("yaml")

SCENE = """
allowed_collision_matrix:
  entry_names: [elbow, can]
  entry_values: [[false, true], [true, false]]
world:
  collision_objects:
    - id: can
      pose: {position: [0, 3, 0], orientation: [0, 0, 1, 1]}
      primitives: [{type: cylinder, dimensions: [0.4, 0.05]}]
      primitive_poses: [{position: [1, 0, 0], orientation: [0, 0, 0, 1]}]
    - id: wall
      primitives:
        - {type: 1, dimensions: [0.1, 0.2, 0.3]}
        - {type: sphere, dimensions: [0.2]}
      primitive_poses:
        - {position: {x: 0, y: 5, z: 0}, orientation: {x: 0, y: 0, z: 0, w: 1}}
        - {position: [0, 6, 0], orientation: [0, 0, 0, 1]}
"""
REQUEST = """
start_state:
  joint_state: {name: [elbow, finger, shoulder], position: [0.2, 9.0, 0.1]}
goal_constraints:
  - joint_constraints:
      - {joint_name: shoulder, position: 0.4}
      - {joint_name: elbow, position: 0.3}
"""


def arm() -> mo.Robot:
    return mo.load_robot("planar_2r")


def test_a_scene_is_read(tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(SCENE)
    scene = mo.load_scene(path)
    can, wall, ball = scene.obstacles
    assert scene.names == ("can", "wall 1", "wall 2")
    assert isinstance(can, mo.Cylinder)
    assert (can.radius, can.length) == (0.05, 0.4)
    assert can.pose[:3, 3] == pytest.approx([0, 4, 0])  # the object is turned by 90 degrees
    assert can.pose[:3, 0] == pytest.approx([0, 1, 0])
    assert isinstance(wall, mo.Box)
    assert wall.size.tolist() == [0.1, 0.2, 0.3]
    assert isinstance(ball, mo.Sphere)
    assert ball.center.tolist() == [0, 6, 0]
    assert scene.ignore == (("elbow", "can"),)


def test_a_request_is_read_and_solved_from_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "request.yaml"
    path.write_text(REQUEST)
    assert mo.scene.load_request(path, arm()).tolist() == [[0.1, 0.2], [0.4, 0.3]]
    assert main(["solve", str(path)]) == 2
    assert "give --robot" in capsys.readouterr().err
    assert main(["solve", str(path), "--robot", "planar_2r"]) == 0
    assert "goal" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("joint_name: elbow", "joint_name: wrist", "request.yaml: the goal lacks elbow"),
        ("position: 0.3", "position: .nan", "positions of joints must be finite"),
        ("joint_constraints", "position_constraints", "not of position_constraints"),
        ("position: [0.2, 9.0, 0.1]", "position: [0.2]", "has 3 joints, but 1 positions"),
        ("start_state", "state", "start_state is missing: the message is of another kind"),
    ],
)
def test_a_wrong_request_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "request.yaml"
    path.write_text(REQUEST.replace(old, new))
    with pytest.raises(InputError, match=message):
        mo.scene.load_request(path, arm())


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("type: sphere", "type: cone", "object 'wall': type must be one of box, sphere, cylinder"),
        ("primitives:\n", "meshes: [1]\n      primitives:\n", "meshes of object 'wall' cannot"),
        ("[0, 0, 1, 1]", "[0, 0, 0, 0]", "orientation must be a quaternion, not zero"),
        ("world:", "land:", "scene.yaml: world is missing"),
        ("world:", "world: [", "it is no YAML"),
    ],
)
def test_a_wrong_scene_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(SCENE.replace(old, new))
    with pytest.raises(InputError, match=message):
        mo.load_scene(path)


def test_a_start_that_touches_by_less_than_the_fit_stands_out_names_the_remedy() -> None:
    robot = arm()
    capsule = mo.Capsule([0.2, 0, 0], [0.5, 0, 0], 0.05, "forearm", 0.02)
    robot = robot.with_capsules({2: [capsule]})
    tip = np.array(mo.forward_kinematics(robot, frame=2)([0.0, 0.0]))[:3, 3]
    scene = mo.Scene([mo.Sphere(tip + np.array([0.4, 0.14, 0.0]), 0.1, "ball")])
    with pytest.raises(InputError, match=r"by 10 mm at link 'forearm', whose capsules stand out"):
        mo.time_optimal(robot, [[0.0, 0.0], [0.5, 0.5]], scene=scene)
