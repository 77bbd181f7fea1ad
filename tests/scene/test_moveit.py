"""Planning scenes and requests as MoveIt writes them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import microbot_ocp as mo
from helpers import refused, tells, warned
from microbot_ocp.cli import main
from microbot_ocp.scene._moveit import turns_on_the_way

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
  joint_state: {name: [elbow, finger, shoulder], position: [0.2, 0.5, 0.1]}
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


@pytest.mark.filterwarnings("ignore:held as")
def test_a_request_is_read_and_solved_from_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "request.yaml"
    path.write_text(REQUEST)
    with warned("planar_2r", "finger"):
        assert mo.scene.load_request(path, arm()).tolist() == [[0.1, 0.2], [0.4, 0.3]]
    assert main(["solve", str(path)]) == 2
    tells(capsys.readouterr().err, "--robot")
    assert main(["solve", str(path), "--robot", "planar_2r"]) == 0
    assert "goal" in capsys.readouterr().out


@pytest.mark.filterwarnings("ignore:held as")
@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("joint_name: elbow", "joint_name: wrist", ("request.yaml:", "goal", "elbow")),
        ("position: 0.3", "position: .nan", ("positions", "finite", "[1, 1] is nan rad")),
        (
            "joint_constraints",
            "position_constraints",
            ("goal_constraints[0].position_constraints", "joint_constraints"),
        ),
        (
            "position: [0.2, 0.5, 0.1]",
            "position: [0.2]",
            ("start_state", "3 joints", "1 positions"),
        ),
        ("start_state", "state", ("start_state", "missing")),
    ],
)
def test_a_wrong_request_is_refused(
    tmp_path: Path, old: str, new: str, message: tuple[str, ...]
) -> None:
    path = tmp_path / "request.yaml"
    path.write_text(REQUEST.replace(old, new))
    with refused(*message):
        mo.scene.load_request(path, arm())


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "type: sphere",
            "type: cone",
            ("object 'wall'", "type", "box, sphere, cylinder", "'cone'"),
        ),
        (
            "primitives:\n",
            "meshes: [1]\n      primitives:\n",
            ("world.collision_objects[1].meshes is [1]", "primitives"),
        ),
        ("[0, 0, 1, 1]", "[0, 0, 0, 0]", ("object 'can'", "orientation", "quaternion", "zero")),
        ("world:", "land:", ("scene.yaml", "world", "missing")),
        ("world:", "world: [", ("scene.yaml", "YAML", "line 7")),
    ],
)
def test_a_wrong_scene_is_refused(
    tmp_path: Path, old: str, new: str, message: tuple[str, ...]
) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(SCENE.replace(old, new))
    with refused(*message):
        mo.load_scene(path)


# frames, operations, matrices ---------------------------------------------------------------------

PLANAR = """
<robot name="planar">
  <link name="world_plate"/> <link name="column"/> <link name="upper"/> <link name="lower"/>
  <link name="hand"/> <link name="tip"/>
  <joint name="stand" type="fixed"><parent link="world_plate"/><child link="column"/>
    <origin xyz="0 0 1" rpy="0 0 1.5707963267948966"/></joint>
  <joint name="a" type="revolute"><parent link="column"/><child link="upper"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="1" effort="100"
    drake:acceleration="4"/></joint>
  <joint name="b" type="revolute"><parent link="upper"/><child link="lower"/>
    <origin xyz="1 0 0"/><axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="2" effort="100"
    drake:acceleration="4"/></joint>
  <joint name="c" type="revolute"><parent link="lower"/><child link="hand"/>
    <origin xyz="1 0 0"/><axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="2" effort="100"
    drake:acceleration="4"/></joint>
  <joint name="end" type="fixed"><parent link="hand"/><child link="tip"/>
    <origin xyz="0.5 0 0"/></joint>
</robot>
"""
NOWHERE = {"position": [0, 0, 0], "orientation": [0, 0, 0, 1]}


@pytest.fixture
def planar(tmp_path: Path) -> mo.Robot:
    path = tmp_path / "planar.urdf"
    path.write_text(PLANAR.replace("<robot", '<robot xmlns:drake="http://drake.mit.edu"'))
    return mo.load_robot(path)


def written(tmp_path: Path, document: dict[str, Any]) -> Path:
    path = tmp_path / "message.yaml"
    path.write_text(json.dumps(document))
    return path


def ball(frame: str | None = None, name: str = "ball", **fields: Any) -> dict[str, Any]:
    header = {} if frame is None else {"header": {"frame_id": frame}}
    shapes = {
        "primitives": [{"type": 2, "dimensions": [0.1]}],
        "primitive_poses": [{"position": [1, 0, 0], "orientation": [0, 0, 0, 1]}],
    }
    return {"id": name, **header, **shapes, **fields}


def scene_of(*objects: dict[str, Any], **fields: Any) -> dict[str, Any]:
    return {"world": {"collision_objects": list(objects)}, **fields}


def moved(parent: str, child: str, x: float, turn: float = 0.0) -> dict[str, Any]:
    half = 0.5 * turn
    transform = {
        "translation": {"x": x, "y": 0, "z": 0},
        "rotation": {"x": 0, "y": 0, "z": np.sin(half), "w": np.cos(half)},
    }
    return {"header": {"frame_id": parent}, "child_frame_id": child, "transform": transform}


@pytest.mark.parametrize("frame", [None, "", "world", "/world", "base_link", "fr3_link0"])
def test_without_a_file_that_names_links_usual_names_are_the_base(
    tmp_path: Path, frame: str | None
) -> None:
    scene = mo.load_scene(written(tmp_path, scene_of(ball(frame))))
    assert scene.ignore == ()  # no matrix: nothing may be touched
    assert scene.obstacles[0].center.tolist() == [1, 0, 0]


@pytest.mark.parametrize(
    ("frame", "center"),
    [
        ("world_plate", [1, 0, 0]),
        ("column", [0, 1, 1]),  # turned by a right angle about Z
        ("upper", [0, 1, 1]),
        ("lower", [-1, 1, 1]),
        ("tip", [-2.5, 1, 1]),
        ("camera", [2, 0, 0]),  # turned by half a turn
        ("lens", [0, 0, 0]),
        ("ceiling", [-6, 0, 0]),
    ],
)
def test_objects_stand_in_their_frames(
    tmp_path: Path, planar: mo.Robot, frame: str, center: list[float]
) -> None:
    """Links of the arm, b at a right angle and c at none; and frames of transforms, both ways."""
    transforms = [
        moved("camera", "lens", 2.0),
        moved("world_plate", "camera", 3.0, np.pi),
        moved("ceiling", "world_plate", 7.0),
    ]
    state = {"joint_state": {"name": ["a", "b", "c"], "position": [0.0, np.pi / 2, 0.0]}}
    given = scene_of(ball(frame), fixed_frame_transforms=transforms, robot_state=state)
    scene = mo.load_scene(written(tmp_path, given), robot=planar)
    np.testing.assert_allclose(scene.obstacles[0].center, center, atol=1e-9)


@pytest.mark.parametrize("frame", ["camera_optical_frame", "base_link", "tip", "ball/top"])
def test_an_unknown_frame_is_refused_by_its_path(
    tmp_path: Path, planar: mo.Robot, frame: str
) -> None:
    """Of a robot that names its links, and of one whose pose the scene does not tell."""
    path = written(tmp_path, scene_of(ball(), ball(frame, "other")))
    with refused(
        "world.collision_objects[1].header.frame_id", repr(frame), "fixed_frame_transforms"
    ):
        mo.load_scene(path, robot=planar)


def test_frames_that_contradict_each_other_are_refused(tmp_path: Path) -> None:
    given = scene_of(ball(), fixed_frame_transforms=[moved("world", "base_link", 0.5)])
    with refused("fixed_frame_transforms", "'base_link'"):
        mo.load_scene(written(tmp_path, given))


@pytest.mark.parametrize(
    ("objects", "names"),
    [
        ([ball(), ball(operation=2)], ("ball 1", "ball 2")),
        ([ball(operation="\0"), ball()], ("ball",)),  # added again: in its place
        ([ball(), {"id": "ball", "operation": 1}], ()),
        ([ball(), ball(name="other"), {"id": "", "operation": 1}], ()),
        ([ball(), {"id": "ball", "operation": "\x01"}, ball(operation=2)], ("ball",)),
        ([ball(), {"id": "other", "operation": 1}], ("ball",)),
    ],
)
def test_operations_one_after_the_other(
    tmp_path: Path, objects: list[dict[str, Any]], names: tuple[str, ...]
) -> None:
    assert mo.load_scene(written(tmp_path, scene_of(*objects))).names == names


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        (
            {"operation": 3},
            ("world.collision_objects[0].operation", "ADD, REMOVE, APPEND", "not 3"),
        ),
        ({"planes": [{"coef": [0, 0, 1, 0.3]}]}, ("collision_objects[0].planes", "0.3")),
        ({"primitives": [], "primitive_poses": []}, ("object 'ball'", "0 primitives")),
        ({"poze": NOWHERE}, ("collision_objects[0].poze", "'pose'")),
    ],
)
def test_what_changes_an_object_is_not_passed_over(
    tmp_path: Path, fields: dict[str, Any], message: tuple[str, ...]
) -> None:
    with refused(*message):
        mo.load_scene(written(tmp_path, scene_of(ball(**fields))))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"is_diff": True}, ("message.yaml", "is_diff is True")),
        (
            {"link_padding": [{"link_name": "a", "padding": 0.02}]},
            ("link_padding[0].padding", "0.02"),
        ),
        ({"link_scale": [{"link_name": "a", "scale": 1.1}]}, ("link_scale[0].scale is 1.1",)),
        (
            {"robot_state": {"attached_collision_objects": [{"link_name": "hand"}]}},
            ("robot_state.attached_collision_objects", "hand"),
        ),
        (
            {"robot_state": {"multi_dof_joint_state": {"transforms": [{"translation": {"x": 1}}]}}},
            ("robot_state.multi_dof_joint_state.transforms",),
        ),
        (
            {"allowed_collision_matrix": {"default_entry_values": [True]}},
            ("allowed_collision_matrix.default_entry_values",),
        ),
        (
            {"allowed_collision_matrix": {"entry_names": ["a", "b"], "entry_values": [[1, 1]]}},
            ("allowed_collision_matrix.entry_values", "2 rows of 2"),
        ),
    ],
)
def test_what_changes_a_scene_is_not_passed_over(
    tmp_path: Path, fields: dict[str, Any], message: tuple[str, ...]
) -> None:
    with refused(*message):
        mo.load_scene(written(tmp_path, scene_of(ball(), **fields)))


def test_fields_that_say_nothing_are_read(tmp_path: Path) -> None:
    nothing = {
        "is_diff": False,
        "link_padding": [{"link_name": "a", "padding": 0.0}],
        "link_scale": [{"link_name": "a", "scale": 1.0}],
        "robot_state": {"multi_dof_joint_state": {"transforms": [moved("", "", 0.0)["transform"]]}},
        "allowed_collision_matrix": None,
        "object_colors": [{"id": "ball", "color": {"r": 1.0}}],
    }
    octomap = {"origin": NOWHERE, "octomap": {"resolution": 0.1, "data": []}}
    given = scene_of(ball(planes=[], subframe_names=["top"], subframe_poses=[NOWHERE]), **nothing)
    given["world"]["octomap"] = octomap
    assert mo.load_scene(written(tmp_path, given)).names == ("ball",)
    octomap["octomap"]["data"] = [1]
    with refused("world.octomap.octomap.data is [1]"):
        mo.load_scene(written(tmp_path, given))


def test_a_matrix_speaks_of_all_primitives_of_an_object_and_of_links(tmp_path: Path) -> None:
    robot = arm().with_capsules(
        {k: [mo.Capsule([0, 0, 0], [0.3, 0, 0], 0.05, f"link {k}")] for k in (0, 1, 2)}
    )
    names = ["link 2", "ball", "link 1", "link 0"]
    table = np.zeros((4, 4), dtype=int)
    table[0, 1] = table[1, 0] = table[0, 3] = table[3, 0] = 1
    matrix = {"entry_names": names, "entry_values": [{"enabled": row} for row in table.tolist()]}
    given = scene_of(ball(), ball(operation=2), allowed_collision_matrix=matrix)
    path = written(tmp_path, given)
    touching = (("link 2", "link 0"), ("link 2", "ball 1"), ("link 2", "ball 2"))
    assert mo.load_scene(path, robot=robot).ignore == touching
    assert mo.load_scene(path).ignore == touching[1:]
    strict = replace(robot, disabled_pairs=(("link 1", "link 2"),))
    with refused("entry_values[0][2]", "link 2 and link 1"):
        mo.load_scene(path, robot=strict)


# limits of requests -------------------------------------------------------------------------------


def request(robot: mo.Robot, start: Any, goal: Any, **fields: Any) -> dict[str, Any]:
    names = list(robot.joint_names)
    aims = [{"joint_name": n, "position": p} for n, p in zip(names, goal, strict=True)]
    state = {"joint_state": {"name": names, "position": list(start)}}
    return {"start_state": state, "goal_constraints": [{"joint_constraints": aims}], **fields}


START, GOAL = [0.0, 1.0, -1.0], [1.5, -2.0, 0.5]  # their sums are 0


def upright(width: float, **fields: Any) -> dict[str, Any]:
    constraint = {
        "header": {"frame_id": "column"},
        "orientation": {"x": 0, "y": 0, "z": 0, "w": 1},
        "link_name": "tip",
        "absolute_x_axis_tolerance": 3.14,
        "absolute_y_axis_tolerance": 7.0,
        "absolute_z_axis_tolerance": width,
    }
    return {"orientation_constraints": [constraint | fields]}


def within(position: float, below: float, above: float, name: str = "b") -> dict[str, Any]:
    rows = {"joint_name": name, "position": position}
    return {
        "joint_constraints": [rows | {"tolerance_below": below, "tolerance_above": above}],
    }


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fields", "largest"),
    [
        ({"max_velocity_scaling_factor": 0.25}, {"qd": [0.25, 0.5, 0.5]}),
        ({"path_constraints": upright(0.02)}, {"turn": [0.02]}),
        *(
            pytest.param(fields, largest, marks=pytest.mark.thorough)
            for fields, largest in (
                (
                    {"max_cartesian_speed": 0.4, "cartesian_speed_limited_link": "tip"},
                    {"speed": [0.4]},
                ),
                ({"max_acceleration_scaling_factor": 0.25}, {"qdd": [1.0, 1.0, 1.0]}),
                ({"path_constraints": within(0.0, 1.0, 1.0, "c")}, {"q": [9.0, 9.0, 1.0]}),
            )
        ),
    ],
)
def test_limits_of_a_request_are_kept(
    tmp_path: Path, planar: mo.Robot, fields: dict[str, Any], largest: dict[str, list[float]]
) -> None:
    path = written(tmp_path, request(planar, START, GOAL, **fields))
    given = mo.tasks.request_cell(path, planar, None)
    with refused("message.yaml", "limit", next(iter(fields))):
        mo.scene.load_request(path, planar)
    cell = given.solve()
    assert cell.motion.solved
    assert cell.certificate.ok
    q, qd, qdd = cell.motion.sample(np.linspace(0.0, cell.motion.duration, 2000))
    heading, turning = np.cumsum(q, axis=1), np.cumsum(qd, axis=1)
    along = np.stack([np.sin(heading), np.cos(heading)]) * [1.0, 1.0, 0.5] * turning
    speed = np.linalg.norm(along.sum(axis=2), axis=0)
    values = {"q": q, "qd": qd, "qdd": qdd, "speed": speed[:, None], "turn": heading[:, 2:]}
    for key, bound in largest.items():
        share = (np.abs(values[key]).max(axis=0) / bound).max()
        assert share < 1.001
        assert share > 0.99 or key == "turn"  # which the fastest motion need not reach


def test_turns_are_the_angles_of_another_package() -> None:
    """By scipy, as intrinsic angles about X, Y, Z, for an arm in space."""
    rotation = pytest.importorskip("scipy.spatial.transform").Rotation
    robot, rng = mo.load_robot("ur5e"), np.random.default_rng(7)
    robot = replace(robot, frames={"flange": (5, rigid(rotation.random(rng=1).as_matrix()))})
    for q in rng.uniform(-1.5, 1.5, (20, 6)):
        wanted = rotation.random(rng=rng)
        row = {"link_name": "flange", "orientation": wanted.as_quat().tolist()}
        row |= {f"absolute_{axis}_axis_tolerance": 3.13 for axis in "xyz"}
        found = list(turns_on_the_way({"orientation_constraints": [row]}, robot, np.array([q, q])))
        state = robot.motion_state(ca.DM(q), *3 * [ca.DM.zeros(6)])
        angles = np.array(ca.evalf(found[0][1]["also"][0].expression(state))).ravel()
        link = np.array(mo.forward_kinematics(robot, frame=5)(q))[:3, :3]
        there = rotation.from_matrix(link @ robot.frames["flange"][1][:3, :3])
        expected = (wanted.inv() * there).as_euler("XYZ")
        np.testing.assert_allclose(angles, expected, atol=1e-9)


def rigid(rotation: np.ndarray) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    return matrix


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"max_velocity_scaling_factor": 1.5}, ("max_velocity_scaling_factor", "1, not 1.5")),
        ({"max_velocity_scaling_factor": -0.1}, ("max_velocity_scaling_factor", "0, not -0.1")),
        (
            {"max_acceleration_scaling_factor": "fast"},
            ("max_acceleration_scaling_factor", "number", "'fast'"),
        ),
        (
            {"max_velocity_scaling_facter": 0.1},
            ("max_velocity_scaling_facter", "'max_velocity_scaling_factor'"),
        ),
        (
            {"max_cartesian_speed": 0.1, "cartesian_speed_limited_link": "lower"},
            ("cartesian_speed_limited_link", "'lower'", "tool"),
        ),
        ({"planner_id": "LIN"}, ("planner_id", "LIN")),
        (
            {"trajectory_constraints": {"constraints": [{"name": "x"}]}},
            ("trajectory_constraints", "'x'"),
        ),
        ({"path_constraints": within(1.0, 0.1, 0.1)}, ("joint_constraints[0]", "b from 0.9")),
        (
            {"path_constraints": within(0, 9, 9, "d")},
            ("joint_constraints[0].joint_name", "a, b, c", "'d'"),
        ),
        ({"path_constraints": upright(0.1, link_name="cup")}, ("link_name", "'cup'")),
        (
            {"path_constraints": upright(0.1, parameterization=1)},
            ("orientation_constraints[0].parameterization", "0,", "X, Y and Z"),
        ),
        ({"path_constraints": upright(0.1, header={"frame_id": "map"})}, ("frame_id", "'map'")),
        (
            {"path_constraints": upright(0.1, orientation=[0, 0, 1, 1])},
            ("orientation_constraints[0]", "tip", "[0.1] rad", "start"),
        ),
        (
            {"path_constraints": {"position_constraints": [{"link_name": "tip"}]}},
            ("path_constraints.position_constraints", "'tip'"),
        ),
        ({"goal_constraints": [{}, {}]}, ("goal_constraints", "one set", "not 2")),
    ],
)
def test_what_a_request_asks_for_is_not_passed_over(
    tmp_path: Path, planar: mo.Robot, fields: dict[str, Any], message: tuple[str, ...]
) -> None:
    path = written(tmp_path, request(planar, START, GOAL) | fields)
    with refused(*message):
        mo.tasks.request_cell(path, planar, None)


def test_what_says_nothing_in_a_request_is_read(tmp_path: Path, planar: mo.Robot) -> None:
    given = request(
        planar, START, GOAL,
        max_velocity_scaling_factor=0.0, max_acceleration_scaling_factor=1.0,
        max_cartesian_speed=0.0, cartesian_speed_limited_link="lower", planner_id="RRTConnect",
        path_constraints={"name": "", "joint_constraints": []}, trajectory_constraints={},
        workspace_parameters={"max_corner": [1, 1, 1]}, allowed_planning_time=7.0,
    )  # fmt: skip
    path = written(tmp_path, given)
    assert mo.scene.load_request(path, planar).tolist() == [START, GOAL]
    assert mo.tasks.request_cell(path, planar, None).settings.time_limit == 7.0


def test_a_share_of_no_limit_is_refused(tmp_path: Path) -> None:
    given = request(arm(), [0, 0], [1, 1], max_acceleration_scaling_factor=0.5)
    with refused("max_acceleration_scaling_factor", "planar_2r", "shoulder, elbow", "qdd_max"):
        mo.tasks.request_cell(written(tmp_path, given), arm(), None)


def test_joints_twice_and_goals_of_other_joints_are_refused(tmp_path: Path) -> None:
    given = request(arm(), [0, 0], [1, 1])
    aims = given["goal_constraints"][0]["joint_constraints"]
    aims.append({"joint_name": "finger", "position": 0.04})
    with refused("goal", "finger", "planar_2r"):
        mo.scene.load_request(written(tmp_path, given), arm())
    aims[-1] = aims[0]
    with refused("goal", "shoulder", "twice"):
        mo.scene.load_request(written(tmp_path, given), arm())
    given["start_state"]["joint_state"] |= {"velocity": [0.0, 0.1]}
    with refused("start_state.joint_state.velocity is [0.0, 0.1]"):
        mo.scene.load_request(written(tmp_path, given), arm())


def test_the_command_line_knows_links_as_frames(
    tmp_path: Path, planar: mo.Robot, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = ["--robot", str(tmp_path / "planar.urdf")]
    scene = written(tmp_path, scene_of(ball("camera"))).rename(tmp_path / "scene.yaml")
    task = written(tmp_path, request(planar, START, GOAL))
    assert main(["solve", str(task), *robot, "--scene", str(scene)]) == 2
    tells(capsys.readouterr().err, "collision_objects[0].header.frame_id", "'camera'")


def test_a_start_that_touches_by_less_than_the_fit_stands_out_names_the_remedy() -> None:
    robot = arm()
    capsule = mo.Capsule([0.2, 0, 0], [0.5, 0, 0], 0.05, "forearm", 0.02)
    robot = robot.with_capsules({2: [capsule]})
    tip = np.array(mo.forward_kinematics(robot, frame=2)([0.0, 0.0]))[:3, 3]
    scene = mo.Scene([mo.Sphere(tip + np.array([0.4, 0.14, 0.0]), 0.1, "ball")])
    with refused("'ball'", "10 mm", "link 'forearm'", "20 mm"):
        mo.time_optimal(robot, [[0.0, 0.0], [0.5, 0.5]], scene=scene)
