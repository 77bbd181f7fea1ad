"""Packaged robots and robot files: what they hold and how a broken one is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import microbot_ocp as mo
from helpers import refused
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
    with refused(", ".join(mo.packaged_robots()), f"'{name}'"):
        mo.load_robot(name)  # type: ignore[arg-type]


def test_missing_and_unreadable_files_are_named(tmp_path: Path) -> None:
    missing = tmp_path / "missing.toml"
    with refused("robot file", "missing.toml", "file or"):
        mo.load_robot(missing)
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    with refused("robot file", "binary.toml", "text"):
        mo.load_robot(binary)


@pytest.mark.parametrize(
    ("text", "fragments"),
    [
        ("name = 1 2", ["valid TOML", "line 1"]),
        ("", ["at least one", "[[joint]]"]),
        ("joint = []", ["at least one", "[[joint]]"]),
        ("joint = [1]", ["at least one", "[[joint]]"]),
        ("[joint]\na = 1", ["at least one", "[[joint]]"]),
        ("colour = 1\n" + JOINT, ["'colour'", "top level", "name"]),
        ("name = 3\n" + JOINT, ["name", "text", "not 3"]),
        ("description = 3\n" + JOINT, ["description", "text", "not 3"]),
        (
            JOINT.replace("[[joint]]", "[[joints]]"),
            ["'joints'", "top level", "'joint'"],
        ),
        (JOINT + "lenght = 1.0", ["joint 1", "'lenght'", "theta_offset"]),
        (JOINT + "a_deg = 1.0", ["joint 1", "'a_deg'", "theta_offset"]),
        (JOINT + "tau_max_deg = 1.0", ["'tau_max_deg'", "joint 1", "theta_offset"]),
        (JOINT + "alpha_deg = 1.0", ["alpha of joint 1", "twice", "alpha_deg"]),
        ("[[joint]]\na = 1.0\nd = 0.0", ["alpha of joint 1", "missing"]),
        (JOINT + "name = 3", ["name", "joint 3", "text", "not 3"]),
        (JOINT + "type = 'screw'", ["type of joint 1", "revolute, prismatic", "'screw'"]),
        (JOINT + "type = 1", ["type of joint 1", "revolute, prismatic", "1"]),
        (JOINT.replace("1.0", "'1.0'"), ["a of joint 1", "number", "'1.0'"]),
        (JOINT.replace("1.0", "true"), ["a of joint 1", "number", "True"]),
        (JOINT.replace("1.0", "[1.0]"), ["a of joint 1", "number", "[1.0]"]),
        (JOINT.replace("1.0", "nan"), ["a of joint 1", "finite", "nan"]),
        (JOINT + "theta_offset_deg = 'x'", ["theta_offset_deg of joint 1", "a number", "'x'"]),
        (JOINT + "theta_offset_deg = '90'", ["theta_offset_deg of joint 1", "a number", "'90'"]),
        (JOINT + "theta_offset_deg = [1, 2]", ["theta_offset_deg of joint 1", "number", "[1, 2]"]),
        (JOINT + "mass = -1.0", ["mass", "link 'joint 1'", "0 kg", "-1.0"]),
        (HEAVY + "allow_unphysical = 1", ["arm.toml: allow_unphysical of link", "not 1"]),
        (JOINT + "[shape]\nframe = 1", ["[[shape]] tables", "{'frame': 1}"]),
        (JOINT + "[[shape]]\nshade = 1", ["'shade'", "shape", "frame"]),
        (JOINT + "[[shape]]\nframe = 1", ["pose", "shape", "missing"]),
        (JOINT + SHAPE + "frame = 2", ["Shape objects", "frames 0 to 1"]),
        (JOINT + SHAPE + "frame = 1\nrole = 'x'", ["role", "shape", "visual, collision", "'x'"]),
        (JOINT + "mass = '4'", ["mass", "link 'joint 1'", "number", "'4'"]),
        (JOINT + "armature = 1.0", ["mass of joint 'joint 1'", "missing", "armature"]),
        (HEAVY + JOINT, ["mass of joint 'joint 2'", "missing"]),
        (HEAVY + "center_of_mass = [1, 2]", ["center_of_mass", "shape [3], not [2]"]),
        (HEAVY + "center_of_mass = [true, 0, 0]", ["center_of_mass", "array of numbers", "True"]),
        (HEAVY + "inertia = [1, 1, 1]", ["inertia of link 'joint 1'", "shape [3, 3], not [3]"]),
        (HEAVY + "inertia = [[1, 0], [0, 1]]", ["shape [3, 3], not [2, 2]"]),
        (
            HEAVY + "inertia = [[1, 0, 0], [0], [0]]",
            ["inertia", "link 'joint 1'", "array of numbers", "[[1, 0, 0], [0], [0]]"],
        ),
        (HEAVY + "inertia = [[1,0,0],[0,1,0],[0,0,9]]", ["arm.toml", "triangle inequality"]),
        (JOINT + "q_min = 1.0\nq_max = 0.0", ["arm.toml: q_min of joint 1", "not 1"]),
        (JOINT + "q_max = [0.0, 1.0]", ["q_max", "joint 'joint 1'", "number", "[0.0"]),
        (JOINT + "tau_max = -5.0", ["tau_max", "joint 1", "0 N m", "not -5"]),
        (JOINT + "tau_max = '5'", ["tau_max", "joint 'joint 1'", "number", "'5'"]),
        (JOINT + "tau_max = true", ["tau_max", "joint 'joint 1'", "number", "not True"]),
        (JOINT + "tau_max = nan", ["tau_max", "joint 'joint 1'", "finite", "nan"]),
        (JOINT + "tau_max = [-1.0]", ["tau_max of joint 'joint 1' as [lower, upper]", "[2]"]),
        (JOINT + "tau_max = [-1.0, '2']", ["tau_max", "as [lower, upper]", "array of numbers"]),
        (JOINT + "tau_max = [1.0, 2.0]", ["tau_max", "joint 1", "zero", "[1, 2] N m"]),
        (JOINT + "tau_max = [-1, 1]\n" + JOINT + "tau_max = '5'", ["'joint 2'", "number", "'5'"]),
        (JOINT + "qd_max_deg = [1, 2, 3]", ["qd_max_deg of joint 1", "shape [2], not [3]"]),
        (JOINT + "type = 'prismatic'\nq_max_deg = 9", ["q_max_deg", "joint 1", "prismatic"]),
        ("gravity = 'down'\n" + JOINT, ["gravity", "array of numbers", "down"]),
        ("gravity = 9.81\n" + JOINT, ["gravity", "shape [3]", "not []"]),
        ("gravity = [0, -9.81]\n" + JOINT, ["gravity", "shape [3]", "not [2]"]),
        ("gravity = [0, 0, '9']\n" + JOINT, ["gravity", "array of numbers", "[0, 0, '9']"]),
        ("gravity = [0, 0, false]\n" + JOINT, ["gravity", "array of numbers", "[0, 0, False]"]),
        ("tool = 3\n" + JOINT, ["tool", "table", "not 3"]),
        (JOINT + "[tool]\nlength = 1.0", ["'length'", "tool", "theta"]),
        (JOINT + "[tool]\na = '4'", ["a of tool", "number", "'4'"]),
        (JOINT + "[tool]\na = nan", ["a of tool", "finite", "nan"]),
        (JOINT + "[tool]\nmatrix = [[1, 0], [0, 1]]", ["tool", "shape [4, 4]", "not [2, 2]"]),
        (JOINT + "[tool]\nmatrix = [0, 1, 0, 0]", ["tool", "shape [4, 4]", "not [4]"]),
        (JOINT + "[tool]\nmatrix = 'x'", ["tool", "array of numbers", "'x'"]),
        (JOINT + "[tool]\nmatrix = [[1]]\na = 2.0", ["tool", "matrix", "DH row"]),
        (JOINT + "name = 'x'\n" + JOINT + "name = 'x'", ["joint_names", "2 different names"]),
    ],
)
def test_broken_robot_file_is_refused_by_name(text: str, fragments: list[str]) -> None:
    with refused("arm.toml: ", *fragments):
        parse_robot(text, "arm.toml")


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
