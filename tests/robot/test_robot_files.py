"""Packaged robots and robot files: what they hold and how a broken one is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import microbot_ocp as mo
from microbot_ocp import InputError
from microbot_ocp.robot import dh_transform
from microbot_ocp.robot.files import parse_robot

JOINT = "[[joint]]\nalpha = 0.0\na = 1.0\nd = 0.0\n"
SHAPE = f"[[shape]]\nkind = 'sphere'\nsize = [1]\npose = {np.eye(4).tolist()}\n"
HEAVY = JOINT + "mass = 1.0\n"


def test_microbot_is_the_robot_of_the_report(microbot: mo.Robot) -> None:
    """Part 1: h = 2, e = 3, f = 4; part 4a: point masses 4, 2, 2 kg at the ends of the links."""
    assert microbot.alpha == pytest.approx([0.0, np.pi / 2, 0.0], abs=1e-15)
    assert microbot.a.tolist() == [0.0, 0.0, 3.0]
    assert microbot.d.tolist() == [2.0, 0.0, 0.0]
    assert microbot.tool == pytest.approx(dh_transform(0.0, 4.0, 0.0, 0.0), abs=1e-15)
    assert [link.mass for link in microbot.links] == [4.0, 2.0, 2.0]
    centers = [link.center_of_mass.tolist() for link in microbot.links]
    assert centers == [[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [4.0, 0.0, 0.0]]
    assert not any(link.inertia.any() for link in microbot.links)
    assert microbot.joint_types == ("revolute",) * 3
    assert microbot.limits.q_max == pytest.approx([2 * np.pi] * 3)
    assert microbot.limits.qd_min.tolist() == [-2.0] * 3


@pytest.mark.parametrize("name", mo.packaged_robots())
def test_packaged_robots_load_and_have_finite_dynamics(name: str) -> None:
    robot = mo.load_robot(name)
    assert robot.name == name
    q = np.full(robot.joint_count, 0.3)
    assert np.isfinite(np.array(mo.inverse_dynamics(robot)(q, q, q))).all()


def test_robot_file_by_path_is_the_packaged_robot(tmp_path: Path, microbot: mo.Robot) -> None:
    source = Path(mo.__file__).parent / "robot" / "packaged" / "microbot.toml"
    copy = tmp_path / "copy.toml"
    copy.write_bytes(source.read_bytes())
    assert mo.load_robot(copy) == microbot
    assert mo.load_robot(str(copy)) == microbot


@pytest.mark.parametrize("name", ["macrobot", "", "microbot.json", "Microbot", 3])
def test_unknown_robot_lists_what_there_is(name: object) -> None:
    with pytest.raises(InputError) as refused:
        mo.load_robot(name)  # type: ignore[arg-type]
    assert ", ".join(mo.packaged_robots()) in str(refused.value)
    assert str(name) in str(refused.value)


def test_missing_and_unreadable_files_are_named(tmp_path: Path) -> None:
    missing = tmp_path / "missing.toml"
    with pytest.raises(InputError, match=r"robot file '.*missing\.toml' cannot be read: "):
        mo.load_robot(missing)
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"robot file '.*binary\.toml' cannot be read: "):
        mo.load_robot(binary)


@pytest.mark.parametrize(
    ("text", "fragments"),
    [
        ("name = 1 2", ["arm.toml: it is not valid TOML", "line 1"]),
        ("", ["arm.toml: there must be at least one [[joint]] table"]),
        ("joint = []", ["at least one [[joint]] table"]),
        ("joint = [1]", ["at least one [[joint]] table"]),
        ("[joint]\na = 1", ["at least one [[joint]] table"]),
        ("colour = 1\n" + JOINT, ["arm.toml: unknown key 'colour' at the top level", "name"]),
        ("name = 3\n" + JOINT, ["arm.toml: name must be text, not 3"]),
        ("description = 3\n" + JOINT, ["arm.toml: description must be text, not 3"]),
        (
            JOINT.replace("[[joint]]", "[[joints]]"),
            ["unknown key 'joints'", "did you mean 'joint'?"],
        ),
        (JOINT + "lenght = 1.0", ["joint 1", "unknown key 'lenght'", "theta_offset"]),
        (JOINT + "a_deg = 1.0", ["joint 1", "unknown key 'a_deg'"]),
        (JOINT + "tau_max_deg = 1.0", ["unknown key 'tau_max_deg'"]),
        (JOINT + "alpha_deg = 1.0", ["alpha of joint 1 is given twice: give alpha or alpha_deg"]),
        ("[[joint]]\na = 1.0\nd = 0.0", ["alpha of joint 1 is missing"]),
        (JOINT + "name = 3", ["name of joint 3 must be text, not 3"]),
        (JOINT + "type = 'screw'", ["type of joint 1", "revolute, prismatic", "'screw'"]),
        (JOINT + "type = 1", ["type of joint 1", "revolute, prismatic", "1"]),
        (JOINT.replace("1.0", "'1.0'"), ["a of joint 1 must be a number", "'1.0'"]),
        (JOINT.replace("1.0", "true"), ["a of joint 1 must be a number", "True"]),
        (JOINT.replace("1.0", "[1.0]"), ["a of joint 1 must be a number", "[1.0]"]),
        (JOINT.replace("1.0", "nan"), ["a of joint 1 must be finite", "nan"]),
        (JOINT + "theta_offset_deg = 'x'", ["theta_offset_deg of joint 1", "a number", "'x'"]),
        (JOINT + "theta_offset_deg = '90'", ["theta_offset_deg of joint 1", "a number", "'90'"]),
        (JOINT + "theta_offset_deg = [1, 2]", ["theta_offset_deg of joint 1", "must be a number"]),
        (JOINT + "mass = -1.0", ["arm.toml: mass of link 'joint 1' must be at least 0 kg", "-1"]),
        (HEAVY + "allow_unphysical = 1", ["arm.toml: allow_unphysical of link", "not 1"]),
        (JOINT + "[shape]\nframe = 1", ["shape must be [[shape]] tables"]),
        (JOINT + "[[shape]]\nshade = 1", ["unknown key 'shade' of a shape"]),
        (JOINT + "[[shape]]\nframe = 1", ["pose of a shape is missing"]),
        (JOINT + SHAPE + "frame = 2", ["arm.toml: shapes must hold Shape objects of frames 0 to"]),
        (JOINT + SHAPE + "frame = 1\nrole = 'x'", ["role of a shape", "visual, collision", "'x'"]),
        (JOINT + "mass = '4'", ["arm.toml: mass of link 'joint 1' must be a number", "'4'"]),
        (JOINT + "armature = 1.0", ["mass of joint 'joint 1' is missing", "armature is given"]),
        (HEAVY + JOINT, ["mass of joint 'joint 2' is missing: give all or none"]),
        (HEAVY + "center_of_mass = [1, 2]", ["center_of_mass", "shape [3], not [2]"]),
        (HEAVY + "center_of_mass = [true, 0, 0]", ["center_of_mass", "array of numbers", "True"]),
        (HEAVY + "inertia = [1, 1, 1]", ["inertia of link 'joint 1'", "shape [3, 3], not [3]"]),
        (HEAVY + "inertia = [[1, 0], [0, 1]]", ["shape [3, 3], not [2, 2]"]),
        (HEAVY + "inertia = [[1, 0, 0], [0], [0]]", ["inertia", "must be an array of numbers"]),
        (HEAVY + "inertia = [[1,0,0],[0,1,0],[0,0,9]]", ["arm.toml", "triangle inequality"]),
        (JOINT + "q_min = 1.0\nq_max = 0.0", ["arm.toml: q_min of joint 1", "not 1"]),
        (JOINT + "q_max = [0.0, 1.0]", ["q_max of joint 'joint 1' must be a number, not [0.0"]),
        (JOINT + "tau_max = -5.0", ["tau_max of joint 1 must be at least 0", "not -5"]),
        (JOINT + "tau_max = '5'", ["tau_max of joint 'joint 1' must be a number, not '5'"]),
        (JOINT + "tau_max = true", ["tau_max of joint 'joint 1' must be a number, not True"]),
        (JOINT + "tau_max = nan", ["tau_max of joint 'joint 1' must be finite", "nan"]),
        (JOINT + "tau_max = [-1.0]", ["tau_max of joint 'joint 1' as [lower, upper]", "[2]"]),
        (JOINT + "tau_max = [-1.0, '2']", ["tau_max", "as [lower, upper]", "array of numbers"]),
        (JOINT + "tau_max = [1.0, 2.0]", ["tau_max of joint 1 must leave room for zero"]),
        (JOINT + "tau_max = [-1, 1]\n" + JOINT + "tau_max = '5'", ["'joint 2'", "number", "'5'"]),
        (JOINT + "qd_max_deg = [1, 2, 3]", ["qd_max_deg of joint 1", "shape [2], not [3]"]),
        (JOINT + "type = 'prismatic'\nq_max_deg = 9", ["q_max_deg", "the joint is prismatic"]),
        ("gravity = 'down'\n" + JOINT, ["arm.toml: gravity must be an array of numbers", "down"]),
        ("gravity = 9.81\n" + JOINT, ["arm.toml: gravity must have shape [3], not []"]),
        ("gravity = [0, -9.81]\n" + JOINT, ["arm.toml: gravity must have shape [3], not [2]"]),
        ("gravity = [0, 0, '9']\n" + JOINT, ["arm.toml: gravity must be an array of numbers"]),
        ("gravity = [0, 0, false]\n" + JOINT, ["arm.toml: gravity must be an array of numbers"]),
        ("tool = 3\n" + JOINT, ["tool must be a table"]),
        (JOINT + "[tool]\nlength = 1.0", ["unknown key 'length' of tool", "theta"]),
        (JOINT + "[tool]\na = '4'", ["a of tool must be a number, not '4'"]),
        (JOINT + "[tool]\na = nan", ["a of tool must be finite"]),
        (JOINT + "[tool]\nmatrix = [[1, 0], [0, 1]]", ["arm.toml: tool must have shape [4, 4]"]),
        (JOINT + "[tool]\nmatrix = [0, 1, 0, 0]", ["arm.toml: tool must have shape [4, 4]"]),
        (JOINT + "[tool]\nmatrix = 'x'", ["arm.toml: tool must be an array of numbers"]),
        (JOINT + "[tool]\nmatrix = [[1]]\na = 2.0", ["tool", "a matrix or a DH row, not both"]),
        (JOINT + "name = 'x'\n" + JOINT + "name = 'x'", ["joint_names", "2 different names"]),
    ],
)
def test_broken_robot_file_is_refused_by_name(text: str, fragments: list[str]) -> None:
    with pytest.raises(InputError) as refused:
        parse_robot(text, "arm.toml")
    message = str(refused.value)
    for fragment in ["arm.toml", *fragments]:
        assert fragment in message


def test_file_with_every_key_says_what_it_says() -> None:
    robot = parse_robot(
        """
        name = "full"
        description = "every key"
        gravity = [1.0, 2.0, 3.0]
        [[joint]]
        name = "lift"
        type = "prismatic"
        alpha_deg = 90.0
        a = 0.5
        d = 0.25
        theta_offset_deg = -90.0
        mass = 2.0
        center_of_mass = [0.1, 0.2, 0.3]
        inertia = [[2.0, 0.1, 0.0], [0.1, 2.0, 0.0], [0.0, 0.0, 3.0]]
        armature = 0.4
        viscous_friction = 0.5
        coulomb_friction = 0.6
        q_min = -1.0
        q_max = inf
        qd_max = [-1.0, 2.0]
        taud_max = 7.0
        [[joint]]
        alpha = 0.1
        a = 0.2
        d = 0.3
        mass = 1.0
        q_min_deg = -180
        q_max_deg = 180
        qd_max_deg = 90
        qdd_max_deg = [-90, 180]
        [tool]
        matrix = [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
        """
    )
    expected = mo.Robot.from_dh(
        alpha=[np.pi / 2, 0.1],
        a=[0.5, 0.2],
        d=[0.25, 0.3],
        theta_offset=[-np.pi / 2, 0.0],
        joint_type=["prismatic", "revolute"],
        links=[
            mo.Link(
                2.0, [0.1, 0.2, 0.3], [[2, 0.1, 0], [0.1, 2, 0], [0, 0, 3]], 0.4, 0.5, 0.6, "lift"
            ),
            mo.Link(1.0, [0, 0, 0]),
        ],
        limits=mo.Limits(
            q_min=[-1.0, -np.pi],
            q_max=[np.inf, np.pi],
            qd_max=([-1.0, -np.pi / 2], [2.0, np.pi / 2]),
            qdd_max=([-np.inf, -np.pi / 2], [np.inf, np.pi]),
            taud_max=[7.0, np.inf],
        ),
        gravity=(1.0, 2.0, 3.0),
        tool=[[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]],
        name="full",
        joint_names=["lift", "joint 2"],
    )
    assert robot == expected
    assert robot.description == "every key"


def test_what_a_file_leaves_out_has_its_default() -> None:
    robot = parse_robot(JOINT, "arm.toml")
    assert robot.name == "arm"
    assert robot.gravity.tolist() == [0.0, 0.0, -9.81]
    assert np.array_equal(robot.tool, np.eye(4))
    assert not robot.has_dynamics
    assert robot.limits.q_max.tolist() == [np.inf]
