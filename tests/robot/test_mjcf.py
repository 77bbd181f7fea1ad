"""MJCF files against MuJoCo's own kinematics and inverse dynamics; robots by their names."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import microbot_ocp as mo
from helpers import refused, warned
from microbot_ocp.tasks import read_task

mujoco = pytest.importorskip("mujoco")

# Two joints in one body, anchors off the origin, references, a slide, degrees, classes, inertias
# from geoms, a base that is turned, gravity that is not vertical.
ODD = """<mujoco model="odd"><compiler angle="degree" autolimits="true"/>
<option gravity="0.5 0 -9.7"/><default><joint armature="0.05" damping="0.4"/></default>
<worldbody><body name="base" pos="0.1 0.2 0.3" euler="10 20 30"><geom type="box" size=".1 .1 .05"/>
<body name="one" pos="0 0 0.2" euler="40 0 20">
<joint name="a" axis="0.3 0.2 1" pos="0.05 0 0.1" ref="25" range="-100 120" frictionloss="0.2"/>
<joint name="b" axis="0 1 0" pos="0 0.1 0" ref="-10"/>
<geom type="capsule" fromto="0 0 0 0.3 0 0.1" size="0.04"/>
<body name="two" pos="0.3 0 0.1">
<joint name="c" type="slide" axis="1 0 0.2" ref="0.05" range="-0.2 0.3"/>
<geom type="cylinder" size="0.03 0.1" euler="0 30 0"/>
<body name="three" pos="0.1 0 0.2" quat="0.9 0.1 0.3 0">
<joint name="d" axis="0 0 1" range="-90 90" actuatorfrcrange="-20 20"/>
<geom type="sphere" size="0.06" pos="0.1 0 0"/>
<site name="flange" pos="0.2 0 0.05" euler="0 90 0"/></body></body></body></body></worldbody>
<actuator><motor joint="a" gear="10" ctrlrange="-3 5"/>
<position joint="b" kp="100" forcerange="-40 40"/><motor joint="d" gear="-50" ctrlrange="-1 1"/>
</actuator></mujoco>"""

# An arm with two fingers that follow each other, and something loose beside it.
GRIPPER = """<mujoco model="gripper"><compiler angle="radian"/><worldbody>
<body name="arm" pos="0 0 0.3"><joint name="j1"/>
<geom type="capsule" fromto="0 0 0 .3 0 0" size=".05"/>
<body name="hand" pos="0.3 0 0"><joint name="j2" axis="0 1 0"/><geom type="box" size=".05 .1 .03"/>
<body name="left"><joint name="f1" type="slide" axis="0 1 0"/>
<geom type="box" size=".01 .01 .03"/></body>
<body name="right"><joint name="f2" type="slide" axis="0 -1 0"/>
<geom type="box" size=".01 .01 .03"/>
</body></body></body>
<body name="loose" pos="2 0 0"><freejoint/><geom type="sphere" size="0.1"/></body></worldbody>
<equality><joint joint1="f1" joint2="f2"/></equality></mujoco>"""


def written(folder: Path, text: str) -> Path:
    path = folder / "arm.xml"
    path.write_text(text)
    return path


def test_kinematics_and_dynamics_are_those_of_mujoco(tmp_path: Path) -> None:
    path = written(tmp_path, ODD)
    robot = mo.load_robot(path)
    assert robot.joint_names == ("a", "b", "c", "d")
    assert [link.coulomb_friction for link in robot.links] == [0.2, 0, 0, 0]
    smooth = robot.with_links([replace(link, coulomb_friction=0.0) for link in robot.links])
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    for name in ("CONTACT", "CONSTRAINT", "ACTUATION"):
        model.opt.disableflags |= int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}"))
    pose, torque = mo.forward_kinematics(robot), mo.inverse_dynamics(smooth)
    for states in np.random.default_rng(0).uniform(-1, 1, (50, 3, 4)):
        q, qd, qdd = states * [[1], [3], [10]]
        data.qpos[:], data.qvel[:], data.qacc[:] = q, qd, qdd
        mujoco.mj_inverse(model, data)
        ours = np.array(torque(q, qd, qdd)).ravel()
        assert np.abs(ours - data.qfrc_inverse).max() < 1e-12 * max(1, np.abs(ours).max())
        at, site = np.array(pose(q)), data.site("flange")
        assert np.abs(at[:3, 3] - site.xpos).max() < 1e-13
        assert np.abs(at[:3, :3].ravel() - site.xmat).max() < 1e-13


def test_limits_are_those_of_joints_and_actuators(tmp_path: Path) -> None:
    limits = mo.load_robot(written(tmp_path, ODD)).limits
    assert limits.q_max == pytest.approx([np.radians(120), np.inf, 0.3, np.pi / 2])
    assert limits.tau_max.tolist() == [50, 40, np.inf, 20]
    assert limits.tau_min.tolist() == [-30, -40, -np.inf, -20]
    assert np.isinf(limits.qd_max).all()


def test_shapes_are_the_geoms(tmp_path: Path) -> None:
    robot = mo.load_robot(written(tmp_path, ODD))
    shapes = {shape.kind: shape for shape in robot.shapes}
    assert shapes["cylinder"].size.tolist() == [0.03, 0.2]
    assert shapes["box"].size.tolist() == [0.2, 0.2, 0.1]
    assert [shape.frame for shape in robot.shapes] == [0, 2, 3, 4]


def test_meshes_stand_where_mujoco_has_them(tmp_path: Path) -> None:
    """MuJoCo moves a mesh into its own centre and axes; the file's vertices are elsewhere."""
    (tmp_path / "meshes").mkdir()
    corners = np.array([[0.1, 0.2, 0], [0.4, 0.2, 0], [0.1, 0.3, 0.1], [0.1, 0.25, 0.5]])
    faces = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    lines = [f"v {x} {y} {z}" for x, y, z in corners]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    (tmp_path / "meshes" / "odd.obj").write_text("\n".join(lines))
    text = """<mujoco><compiler meshdir="meshes"/>
    <asset><mesh name="odd" file="odd.obj" scale="0.5 1 2"/></asset>
    <worldbody><body pos="0.1 0 0.3" euler="10 20 30"><joint/>
    <geom type="mesh" mesh="odd" pos="0.2 0 0" euler="0 0 40"/></body></worldbody></mujoco>"""
    path = written(tmp_path, text)
    robot = mo.robot.load_mjcf(path)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    theirs = model.mesh_vert @ data.geom_xmat[0].reshape(3, 3).T + data.geom_xpos[0]
    (shape,) = robot.shapes
    assert Path(shape.path).resolve() == tmp_path / "meshes" / "odd.obj"
    frames = np.hsplit(np.array(mo.robot.link_poses(robot)([0])), 2)
    pose = frames[shape.frame] @ shape.pose
    ours = (corners * shape.size) @ pose[:3, :3].T + pose[:3, 3]
    apart = np.linalg.norm(ours[:, None] - theirs[None], axis=2)
    assert apart.min(axis=1).max() < 1e-6  # MuJoCo's vertices have single precision


def test_a_gripper_and_what_lies_about_are_not_part_of_the_arm(tmp_path: Path) -> None:
    robot = mo.robot.load_mjcf(written(tmp_path, GRIPPER))
    assert robot.joint_names == ("j1", "j2")
    fingers = mo.robot.load_mjcf(tmp_path / "arm.xml", tip="left")
    assert fingers.joint_names == ("j1", "j2", "f1")


def test_damping_that_stands_for_a_controller_is_warned_of(tmp_path: Path) -> None:
    text = ODD.replace('damping="0.4"', 'damping="45"')
    with warned("arm.xml", "'b' (45 N m s/rad of 40 N m)", category=mo.robot.RobotFileWarning):
        mo.robot.load_mjcf(written(tmp_path, text))


def test_gravity_that_is_switched_off_is_off_and_a_fluid_is_warned_of(tmp_path: Path) -> None:
    text = ODD.replace("/><default>", ' density="1000"><flag gravity="disable"/></option><default>')
    with warned("arm.xml", "air or water", category=mo.robot.RobotFileWarning):
        robot = mo.load_robot(written(tmp_path, text))
    assert np.array_equal(robot.gravity, np.zeros(3))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("<mujoco><worldbody><nonsense/></worldbody></mujoco>", ("MuJoCo", "'nonsense'", "line 1")),
        ("<mujoco><worldbody/></mujoco>", ("moving joint", "no arm")),
        (
            GRIPPER.replace("<equality>", "<!--").replace("</equality>", "-->"),
            ("link 'hand'", "'f1', 'f2'", "tip", "'left' (3)"),
        ),
    ],
)
def test_what_is_no_arm_says_so(tmp_path: Path, text: str, says: tuple[str, ...]) -> None:
    with refused("arm.xml: ", *says):
        mo.load_robot(written(tmp_path, text))
    with refused("robot file", "other.xml", "file"):
        mo.load_robot(tmp_path / "other.xml")


# --- robot_descriptions ---------------------------------------------------------------------------

XACRO = """<robot name="rod" xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:arg name="length" default="1.0"/><link name="base"/><link name="rod"/><link name="end"/>
<joint name="hinge" type="continuous"><parent link="base"/><child link="rod"/>
<axis xyz="0 0 1"/></joint>
<joint name="weld" type="fixed"><parent link="rod"/><child link="end"/>
<origin xyz="$(arg length) 0 0"/></joint></robot>"""


@pytest.fixture
def descriptions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A package with modules as those of robot_descriptions 3, which clone what they name."""
    package = tmp_path / "robot_descriptions"
    package.mkdir()
    written(package, ODD)
    (package / "rod.xacro").write_text(XACRO)
    modules = {
        "__init__": "",
        "rod_description": f"XACRO_PATH = {str(package / 'rod.xacro')!r}\n"
        "XACRO_ARGS = {'length': '0.25'}",
        "odd_mj_description": f"MJCF_PATH = {str(package / 'arm.xml')!r}",
        "far_description": "raise OSError('no route to the host')",
    }
    for name, text in modules.items():
        (package / f"{name}.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    for name in [n for n in sys.modules if n.startswith("robot_descriptions")]:
        monkeypatch.delitem(sys.modules, name)


@pytest.mark.usefixtures("descriptions")
def test_robots_by_the_names_of_robot_descriptions(tmp_path: Path) -> None:
    rod = mo.load_robot("robot_descriptions:rod_description")
    assert rod.tool[0, 3] == 0.25
    odd = mo.load_robot("robot_descriptions:odd_mj_description", tip="two")
    assert odd.joint_names == ("a", "b", "c")
    via = "[via]\nq = [[0.0], [1.0]]"
    file = tmp_path / "task.toml"
    file.write_text(f'schema = 1\nrobot = "robot_descriptions:rod_description"\n{via}')
    assert read_task(file).robot == rod
    with refused("'rot_description'", "'rod_description'", "'far_description'"):
        mo.load_robot("robot_descriptions:rot_description")
    with refused("'odd'", "'odd_mj_description'"):
        mo.load_robot("robot_descriptions:odd")
    with refused("'far_description'", "no route"):
        mo.load_robot("robot_descriptions:far_description")
