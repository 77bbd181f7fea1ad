"""What a robot looks like, as data: read from URDF, in the robot's frames, and written again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import microbot_ocp as mo
from helpers import batch, difference, random_states, refused, warned
from microbot_ocp.robot import RobotFileWarning, Shape
from microbot_ocp.robot.files import parse_robot, parse_urdf, robot_to_toml, robot_to_urdf

pin = pytest.importorskip("pinocchio")

SHAPES = {
    "box": "<box size='0.1 0.2 0.3'/>",
    "sphere": "<sphere radius='0.1'/>",
    "cylinder": "<cylinder radius='0.1' length='0.5'/>",
    "capsule": "<capsule radius='0.2' length='0.4'/>",
}
BLUE = "<material name='blue'><color rgba='0 0 1 0.5'/></material>"


def looks(geometry: str, role: str = "collision", material: str = "") -> str:
    origin = "<origin xyz='0.1 0.2 0.3' rpy='0.4 -0.5 0.6'/>"
    return f"<{role}>{origin}<geometry>{geometry}</geometry>{material}</{role}>"


def arm(*links: str, more: str = "") -> str:
    """Links "l0" to "l3" with what is in them; the joint to "l2" is fixed."""
    text = ["<robot name='r'>", more, f"<link name='l0'>{links[0]}</link>"]
    for i, inside in enumerate(links[1:]):
        kind = "fixed" if i == 1 else "continuous"
        text.append(
            f"<link name='l{i + 1}'>{inside}</link><joint name='j{i}' type='{kind}'>"
            f"<origin xyz='0.3 0.{i} 0.2' rpy='0.{i}5 1 0.7'/><axis xyz='0.6 0 0.8'/>"
            f"<parent link='l{i}'/><child link='l{i + 1}'/></joint>"
        )
    return "".join([*text, "</robot>"])


def test_shapes_move_as_pinocchio_moves_them() -> None:
    text = arm(*(looks(geometry) for geometry in SHAPES.values()))
    robot = parse_urdf(text)
    assert [(s.kind, s.frame, s.link, *s.size) for s in robot.shapes] == [
        ("box", 0, "l0", 0.1, 0.2, 0.3),
        ("sphere", 1, "l1", 0.1),
        ("cylinder", 1, "l2", 0.1, 0.5),
        ("capsule", 2, "l3", 0.2, 0.4),
    ]
    model = pin.buildModelFromXML(text)
    frames = [model.getFrameId(shape.link, pin.BODY) for shape in robot.shapes]
    data, q = model.createData(), random_states(robot, 20)[0]
    placement = pin.SE3(pin.rpy.rpyToMatrix(0.4, -0.5, 0.6), np.array([0.1, 0.2, 0.3]))
    for shape, frame in zip(robot.shapes, frames, strict=True):
        poses = []
        for row in q:
            turned = np.column_stack([np.cos(row), np.sin(row)]).ravel()
            pin.framesForwardKinematics(model, data, turned)
            poses.append((data.oMf[frame] * placement).homogeneous)
        ours = batch(mo.forward_kinematics(robot, shape.frame), q) @ shape.pose
        assert difference(ours, np.array(poses)) < 1e-12


def drawn(robot: mo.Robot, shape: Shape) -> tuple[Any, ...]:
    """All of a shape, with its pose in the base frame at zero."""
    zero = np.zeros((1, robot.joint_count))
    pose = batch(mo.forward_kinematics(robot, shape.frame), zero)[0] @ shape.pose
    figures = np.concatenate([shape.size, pose.ravel()]).round(12) + 0.0
    return (shape.kind, shape.role, shape.path, shape.color, *figures.tolist())


def test_shapes_survive_every_file(tmp_path: Path) -> None:
    (tmp_path / "a b.stl").write_text("")
    text = arm(
        looks(SHAPES["capsule"], "visual", "<material name='blue'/>"),
        looks("<mesh filename='a b.stl' scale='1 -1 0.001'/>"),
        looks(SHAPES["box"]) + looks(SHAPES["cylinder"], "visual"),
        looks("<mesh filename='a b.stl' scale='0.5'/>", "visual", BLUE),
        more=BLUE,
    )
    robot = parse_urdf(text, folder=tmp_path)
    colors = [shape.color for shape in robot.shapes if shape.role == "visual"]
    assert colors == [(0, 0, 1, 0.5), None, (0, 0, 1, 0.5)]
    scales = [shape.size.tolist() for shape in robot.shapes if shape.kind == "mesh"]
    assert scales == [[1, -1, 0.001], [0.5] * 3]
    for copy in (parse_robot(robot_to_toml(robot)), parse_urdf(robot_to_urdf(robot))):
        ours = sorted(map(repr, (drawn(robot, shape) for shape in robot.shapes)))
        assert sorted(map(repr, (drawn(copy, shape) for shape in copy.shapes))) == ours


@pytest.mark.parametrize(
    "reference",
    [
        "../meshes/arm.stl",
        "{folder}/meshes/arm.stl",
        "file://{folder}/meshes/arm.stl",
        "package://arm_description/meshes/arm.stl",
        "model://arm_description/meshes/arm.stl",
        "package://renamed/meshes/arm.stl",
        "package://elsewhere/arm.stl",
    ],
)
def test_meshes_are_found(tmp_path: Path, reference: str, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, other = tmp_path / "arm_description", tmp_path / "workspace" / "elsewhere"
    for made in (folder / "meshes", folder / "urdf", other):
        made.mkdir(parents=True)
    wanted = (other if "elsewhere" in reference else folder / "meshes") / "arm.stl"
    wanted.write_text("")
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(other.parent))
    path = folder / "urdf" / "arm.urdf"
    path.write_text(arm("", looks(f"<mesh filename='{reference.format(folder=folder)}'/>")))
    (shape,) = mo.robot.load_urdf(path).shapes
    assert Path(shape.path).resolve() == wanted.resolve()


@pytest.mark.parametrize("name", ["none.stl", "package://nowhere/n.stl", "x" * 5000, "bell \u20ac"])
def test_a_missing_mesh_is_a_warning(tmp_path: Path, name: str) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(arm("", looks(f"<mesh filename='{name}'/>")), "utf-8")
    with warned("arm.urdf", "mesh files", name * (len(name) < 100), category=RobotFileWarning):
        (shape,) = mo.robot.load_urdf(path).shapes
    assert shape.path == name


@pytest.mark.parametrize(
    ("geometry", "message"),
    [
        ("", ("link 'l1'", "box, sphere")),
        ("<plane/>", ("<plane>", "link 'l1'")),
        ("<mesh/>", ("link 'l1'", "path", "mesh")),
        ("<box/>", ("x, y, z", "link 'l1'", "shape [3]", "[0]")),
        ("<box size='1 1 -1'/>", ("x, y, z", "link 'l1'", "0 m", "-1.0]")),
        (
            "<sphere radius='big'/>",
            ("radius", "collision geometry", "link 'l1'", "number", "'big'"),
        ),
        ("<mesh filename='/' scale='1 2'/>", ("scale x", "link 'l1'", "shape [3]", "[2]")),
        (
            "<cylinder radius='nan' length='1'/>",
            ("radius, length", "link 'l1'", "finite", "[0] is nan"),
        ),
    ],
)
def test_geometry_that_cannot_be_read_is_left_out(geometry: str, message: tuple[str, ...]) -> None:
    with warned(*message, category=RobotFileWarning):
        assert parse_urdf(arm("", looks(geometry))).shapes == ()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"kind": "cone"}, ("kind", "collision geometry", "link 'arm'", "box, sphere", "'cone'")),
        ({"role": "both"}, ("role", "a shape", "visual, collision", "'both'")),
        ({"size": [1, 2]}, ("radius", "link 'arm'", "shape [1]", "[2]")),
        ({"size": [-1]}, ("radius", "collision geometry", "link 'arm'", "0 m", "-1.0")),
        ({"pose": np.eye(3)}, ("pose", "collision geometry", "link 'arm'", "shape [4, 4]")),
        ({"path": "x.stl"}, ("link 'arm'", "path", "mesh")),
        ({"color": (1, 0, 0)}, ("color", "collision geometry", "link 'arm'", "shape [4]")),
    ],
)
def test_what_is_no_shape_is_refused(changes: dict[str, Any], message: tuple[str, ...]) -> None:
    given = {"frame": 1, "pose": np.eye(4), "kind": "sphere", "size": [1.0], "link": "arm"}
    with refused(*message):
        Shape(**(given | changes))
