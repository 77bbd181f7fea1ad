"""URDF 1.1 and 1.2, and all that a file says besides: read, harmless, or left out by name."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import microbot_ocp as mo
from helpers import batch, difference, random_states, refused, warned
from microbot_ocp.robot import RobotFileWarning
from microbot_ocp.robot.files import parse_urdf, robot_to_urdf

pin = pytest.importorskip("pinocchio")

QUARTER = "quat_xyzw='0 .34289780745 0 .93937271285'"


def arm(
    *, origin: str = "", limit: str = "", joint: str = "", link: str = "", more: str = "",
    version: str = "version='1.2'",
) -> str:  # fmt: skip
    """Two joints; each text stands in the element of its name."""
    body = "<inertial><origin xyz='.2 .1 0' {}/><mass value='2'/><inertia ixx='.01' iyy='.05' "
    body += "izz='.05' ixy='0.003' ixz='0' iyz='0'/></inertial>"
    bound = "lower='-2' upper='2' effort='9' velocity='2'"
    return f"""<robot name='x' {version} xmlns:xacro='http://ros.org/wiki/xacro'><link name='b'/>
    <link name='u'>{body.format(origin)}{link}</link><link name='v'>{body.format("")}</link>
    <joint name='one' type='revolute'><parent link='b'/><child link='u'/>
    <origin xyz='.1 0 .2' {origin}/><axis xyz='0 0 1'/><limit {bound} {limit}/>{joint}</joint>
    <joint name='two' type='revolute'><parent link='u'/><child link='v'/>
    <origin xyz='.1 0 .2'/><axis xyz='0 1 0'/><limit {bound}/></joint>{more}</robot>"""


def said(text: str) -> tuple[mo.Robot, list[str]]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        robot = parse_urdf(text, "arm.urdf")
    assert all(w.category is RobotFileWarning for w in caught)
    return robot, [str(w.message) for w in caught]


@pytest.mark.parametrize("version", ["1.1", "1.2"])
@pytest.mark.parametrize(
    "turn", [QUARTER, "quat_xyzw='1 2 3 4'", "quat_xyzw='-.5 .5 -.5 .5'", "quat_xyzw='0 0 0 -1'"]
)
def test_quaternions_turn_joints_and_inertias_as_pinocchio_has_them(
    turn: str, version: str
) -> None:
    text = arm(origin=turn, version=f"version='{version}'")
    robot, remarks = said(text)
    assert not remarks
    model = pin.buildModelFromXML(text)
    data, states = model.createData(), random_states(robot, 20)
    tau = [pin.rnea(model, data, *state).copy() for state in zip(*states, strict=True)]
    assert difference(batch(mo.inverse_dynamics(robot), *states), np.array(tau)) < 1e-12
    again = parse_urdf(robot_to_urdf(robot))
    assert difference(batch(mo.inverse_dynamics(again), *states), np.array(tau)) < 1e-12


def test_quaternions_place_geometry() -> None:
    box = f"<collision><origin {QUARTER}/><geometry><capsule radius='.1' length='.3'/></geometry>"
    robot, remarks = said(arm(link=f"{box}</collision>"))
    (shape,) = robot.shapes
    assert not remarks
    assert (shape.kind, shape.size.tolist()) == ("capsule", [0.1, 0.3])
    assert shape.pose[0, 0] == pytest.approx(1 - 2 * 0.34289780745**2)


@pytest.mark.parametrize(
    ("turn", "part"),
    [
        (f"rpy='0 0 0' {QUARTER}", "both"),
        ("quat_xyzw='0 0 0 0'", "zero"),
        ("quat_xyzw=''", "shape [4]"),
    ],
)
def test_a_turn_given_twice_or_by_no_quaternion_is_refused(turn: str, part: str) -> None:
    with refused("quat_xyzw", "link 'u'", part):
        parse_urdf(arm(origin=turn))


@pytest.mark.parametrize(("version", "word"), [("2.0", "'2.0'"), ("new", "'new'"), ("1.0", "1.1")])
def test_a_version_that_is_unknown_or_too_old_is_said(version: str, word: str) -> None:
    text = arm(origin=QUARTER, version=f"version='{version}'")
    robot, (remark,) = said(text)
    assert word in remark
    assert robot == parse_urdf(text.replace(version, "1.2"))


def test_limits_of_acceleration_and_jerk() -> None:
    robot, remarks = said(arm(limit="acceleration='5' jerk='70'"))
    assert not remarks
    assert robot.limits.qdd_max.tolist() == [5.0, np.inf]
    assert robot.limits.qddd_min.tolist() == [-70.0, -np.inf]
    assert parse_urdf(robot_to_urdf(robot)).limits.qddd_max.tolist() == [70.0, np.inf]
    robot, (remark,) = said(arm(limit="acceleration='5' deceleration='3'"))
    assert robot.limits.qdd_max.tolist() == [3.0, np.inf]
    assert "'one'" in remark


@pytest.mark.parametrize(
    ("part", "name"),
    [
        ({"joint": "<dynamics damping='0' spring_stiffness='3'/>"}, "spring_stiffness"),
        ({"joint": "<dynamics damping='0' mu_viscous='16'/>"}, "mu_viscous"),
        ({"joint": "<safety_controller soft_upper_limit='1' k_velocity='9'/>"}, "[-2, 1]"),
        ({"joint": "<spring k='1'/>"}, "<spring>"),
        ({"limit": "current='1'"}, "current"),
        ({"link": "<inertia_scaling value='3'/>"}, "<inertia_scaling>"),
        ({"link": "<contact><inertia_scaling value='3'/></contact>"}, "<inertia_scaling>"),
        ({"more": "<gazebo reference='u'><turnGravityOff>true</turnGravityOff></gazebo>"}, "'u'"),
        ({"more": "<gazebo reference='u'><gravity>0</gravity></gazebo>"}, "<gravity>"),
        ({"more": "<gazebo reference='j'><springStiffness>3</springStiffness></gazebo>"}, "'j'"),
        ({"more": "<gazebo><joint name='loop' type='revolute'/></gazebo>"}, "<joint>"),
        ({"more": "<mujoco><option gravity='0 0 0'/></mujoco>"}, "<option>"),
        ({"more": "<loop_joint name='k'/>"}, "<loop_joint>"),
        ({"more": "<xacro:include filename='x'/>"}, "<xacro:include>"),
        (
            {
                "more": "<transmission name='t'><actuator name='m'><drake:rotor_inertia value='1'/>"
                "</actuator></transmission>"
            },
            "<drake:rotor_inertia>",
        ),
    ],
)
def test_parts_that_may_change_the_motion_are_left_out_by_name(
    part: dict[str, str], name: str
) -> None:
    with warned(name, category=RobotFileWarning):
        robot = parse_urdf(arm(**part))
    assert robot == parse_urdf(arm())


@pytest.mark.parametrize(
    "part",
    [
        {"joint": "<safety_controller soft_lower_limit='-2' soft_upper_limit='2' k_velocity='9'/>"},
        {"joint": "<calibration rising='0'/><dynamics damping='0' D='0' K='0.0'/>"},
        {"link": "<visual convex='yes'><geometry><box size='1 1 1'/></geometry></visual>"},
        {"link": "<contact><lateral_friction value='1'/></contact>"},
        {"more": "<gazebo reference='u'><turnGravityOff>False</turnGravityOff></gazebo>"},
        {"more": "<gazebo><plugin name='p' filename='q'/></gazebo><sensor name='s'/>"},
        {"more": "<transmission name='t'><joint name='one'/><actuator name='m'/></transmission>"},
        {"version": ""},
    ],
)
def test_harmless_parts_are_left_out_in_silence(part: dict[str, str]) -> None:
    assert said(arm(**part))[1] == []
