"""The robot as data: validation, limits, equality."""

from __future__ import annotations

import re
from dataclasses import FrozenInstanceError, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

import microbot_ocp as mo
from helpers import refused
from microbot_ocp import Limits, Link, Robot
from microbot_ocp.robot import dh_transform

POINT = Link(1.0, [0.0, 0.0, 0.0])


def planar(**changes: Any) -> Robot:
    rows: dict[str, Any] = {"alpha": [0.0, 0.0], "a": [0.0, 1.0], "d": [0.0, 0.0]}
    return Robot.from_dh(**(rows | changes))


# ---- links


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mass": -2.0}, ("mass", "link 'arm'", "0 kg", "not -2.0")),
        ({"allow_unphysical": 1}, ("allow_unphysical", "link 'arm'", "True or False", "not 1")),
        ({"mass": np.nan}, ("mass", "link 'arm'", "finite", "nan kg")),
        ({"mass": "4"}, ("mass", "link 'arm'", "number", "'4'")),
        ({"mass": True}, ("mass", "link 'arm'", "number", "not True")),
        ({"center_of_mass": [0, 0]}, ("center_of_mass", "link 'arm'", "shape [3]", "not [2]")),
        (
            {"center_of_mass": [0, np.inf, 0]},
            ("center_of_mass", "link 'arm'", "finite", "[1] is inf m"),
        ),
        ({"inertia": [1, 1, 1]}, ("inertia", "link 'arm'", "shape [3, 3]", "not [3]")),
        (
            {"inertia": np.diag([1, np.nan, 1])},
            ("inertia", "link 'arm'", "finite", "[1, 1] is nan kg m^2"),
        ),
        (
            {"inertia": [[1, 0.5, 0], [0, 1, 0], [0, 0, 1]]},
            (
                "inertia",
                "link 'arm'",
                "symmetric",
                "[[1.0, 0.5, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] kg m^2",
            ),
        ),
        (
            {"inertia": np.diag([1.0, 1.0, -0.5])},
            ("inertia", "link 'arm'", "positive semi-definite", "-0.5 kg m^2"),
        ),
        (
            {"inertia": np.diag([1.0, 1.0, 3.0])},
            ("inertia", "link 'arm'", "triangle inequality", "1 + 1 < 3 kg m^2"),
        ),
        ({"armature": -1.0}, ("armature", "link 'arm'", "0 kg m^2", "not -1.0")),
        (
            {"viscous_friction": -1.0},
            ("viscous_friction", "link 'arm'", "0 N m s/rad", "not -1.0"),
        ),
        (
            {"coulomb_friction": np.inf},
            ("coulomb_friction", "link 'arm'", "finite", "inf N m"),
        ),
    ],
)
def test_impossible_link_is_refused_in_one_sentence(
    changes: dict[str, Any], message: tuple[str, ...]
) -> None:
    given = {"mass": 1.0, "center_of_mass": [0, 0, 0], "name": "arm"}
    with refused(*message) as caught:
        Link(**(given | changes))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "inertia",
    [np.zeros((3, 3)), np.diag([1.0, 1.0, 2.0]), np.diag([0.0, 1.0, 1.0])],
    ids=["point", "lamina", "rod"],
)
def test_limiting_bodies_are_links_too(inertia: np.ndarray) -> None:
    assert np.array_equal(Link(1.0, [0, 0, 0], inertia).inertia, inertia)


def test_turned_inertia_is_checked_by_its_principal_moments() -> None:
    turn = dh_transform(0.3, 0.0, 0.0, 0.7)[:3, :3]
    Link(1.0, [0, 0, 0], turn @ np.diag([1.0, 1.0, 1.99]) @ turn.T)
    with refused("inertia", "triangle inequality", "1 + 1 < 2.01 kg m^2"):
        Link(1.0, [0, 0, 0], turn @ np.diag([1.0, 1.0, 2.01]) @ turn.T)


def test_link_is_frozen_and_keeps_its_own_arrays() -> None:
    center = np.zeros(3)
    link = Link(1.0, center)
    center[0] = 5.0
    assert link.center_of_mass[0] == 0.0
    with pytest.raises(FrozenInstanceError):
        link.mass = 2.0  # type: ignore[misc]


# ---- limits


def test_limits_not_given_are_infinite() -> None:
    limits = Limits().for_joints(2)
    for quantity in ("q", "qd", "qdd", "tau", "taud"):
        lower, upper = limits.bounds(quantity)
        assert lower.tolist() == [-np.inf, -np.inf]
        assert upper.tolist() == [np.inf, np.inf]


@pytest.mark.parametrize("quantity", ["qd", "qdd", "tau", "taud"])
@pytest.mark.parametrize(
    ("value", "lower", "upper"),
    [
        (2.0, [-2, -2], [2, 2]),
        ([2.0, 3.0], [-2, -3], [2, 3]),
        (np.array([2.0, np.inf]), [-2, -np.inf], [2, np.inf]),
        ((-1.0, 2.0), [-1, -1], [2, 2]),
        (([-1.0, -4.0], 2.0), [-1, -4], [2, 2]),
        ((-1.0, [2.0, 3.0]), [-1, -1], [2, 3]),
        (0.0, [0, 0], [0, 0]),
    ],
)
def test_scalar_list_and_pair_become_arrays(
    quantity: str, value: Any, lower: list[float], upper: list[float]
) -> None:
    limits = Limits(**{f"{quantity}_max": value}).for_joints(2)
    have_lower, have_upper = limits.bounds(quantity)
    assert have_lower.tolist() == lower
    assert have_upper.tolist() == upper


def test_lower_limit_may_be_named() -> None:
    limits = Limits(tau_max=[5.0, 6.0], tau_min=-1.0).for_joints(2)
    assert limits.tau_min.tolist() == [-1.0, -1.0]
    assert limits.tau_max.tolist() == [5.0, 6.0]


@pytest.mark.parametrize(
    ("given", "fragments"),
    [
        ({"q_min": [0.0, 2.0], "q_max": 1.0}, ["q_min of joint 2", "2", "q_max of 1 rad"]),
        ({"q_min": np.inf}, ["q_min", "joint 1", "not inf"]),
        ({"q_max": -np.inf}, ["q_min", "joint 1", "not -inf"]),
        ({"qd_max": (1.0, -1.0)}, ["qd_min", "joint 1", "qd_max of -1 rad/s", "m/s"]),
        ({"tau_max": -5.0}, ["tau_max", "joint 1", "0 N m", "prismatic: N", "-5"]),
        ({"tau_max": [5.0, -5.0]}, ["tau_max", "joint 2", "0 N m", "-5"]),
        ({"tau_max": (100.0, 200.0)}, ["tau_max", "joint 1", "zero", "a list"]),
        ({"qd_max": (1.0, 2.0)}, ["qd_max", "joint 1", "zero", "[1, 2] rad/s"]),
        ({"qdd_max": (-2.0, -1.0)}, ["qdd_max", "joint 1", "zero", "[-2, -1] rad/s^2"]),
        ({"taud_max": ([-1.0, 1.0], 2.0)}, ["taud_max", "joint 2", "zero", "[1, 2] N m/s"]),
        ({"tau_max": (1.0, 2.0, 3.0)}, ["tau_max", "tuple", "(lower, upper)", "3 entries"]),
        ({"tau_max": (1.0,)}, ["tau_max", "tuple", "(lower, upper)", "1 entries"]),
        ({"q_max": (-1.0, 1.0)}, ["q_max", "number", "list", "not the tuple (-1.0, 1.0)"]),
        ({"q_min": (-1.0, 1.0)}, ["q_min", "number", "list", "not the tuple"]),
        ({"qd_max": (-1.0, 1.0), "qd_min": -2.0}, ["qd_min", "twice", "-2.0", "qd_max"]),
        ({"tau_max": [1.0, 2.0, 3.0]}, ["tau_max", "shape [2]", "not [3]"]),
        ({"tau_max": np.nan}, ["tau_max", "finite", "nan"]),
        ({"q_min": [np.nan, 0.0]}, ["q_min", "finite", "entry [0] is nan"]),
        ({"tau_max": "strong"}, ["tau_max", "array of numbers", "strong"]),
        ({"tau_max": "5"}, ["tau_max", "array of numbers", "5"]),
        ({"tau_max": True}, ["tau_max", "array of numbers", "True"]),
        ({"tau_max": [[1.0, 2.0]]}, ["tau_max", "shape [2]", "[1, 2]"]),
        ({"tau_max": 5.0, "tau_min": [1.0]}, ["tau_min", "shape [2]", "not [1]"]),
    ],
    ids=str,
)
def test_impossible_limits_are_refused(given: dict[str, Any], fragments: list[str]) -> None:
    with refused(*fragments):
        Limits(**given).for_joints(2)


def test_limits_of_another_robot_are_refused(microbot: Robot) -> None:
    with refused("limits", "3 joints", "robot", "2"):
        planar(limits=microbot.limits)


def test_some_limits_are_changed_and_the_others_stay(microbot: Robot) -> None:
    changed = microbot.with_limits(tau_min=-100.0, qd_max=1.0, taud_max=([-1, -2, -3], 4.0)).limits
    assert changed.tau_min.tolist() == [-100, -100, -100]
    assert changed.tau_max.tolist() == [400, 500, 200]
    assert changed.qd_min.tolist() == [-1, -1, -1]
    assert changed.taud_min.tolist() == [-1, -2, -3]
    assert changed.taud_max.tolist() == [4, 4, 4]
    assert changed.q_max.tolist() == microbot.limits.q_max.tolist()
    upper = microbot.with_limits(q_max=[1.0, 2.0, 3.0]).limits
    assert upper.q_max.tolist() == [1, 2, 3]
    assert upper.q_min.tolist() == microbot.limits.q_min.tolist()
    assert microbot.with_limits() == microbot


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"limits": Limits(), "qd_max": 1.0}, ("limits or qd_max",)),
        ({"tau_max": -1.0}, ("tau_max", "joint 1", "0 N m", "-1")),
        ({"q_max": -9.0}, ("q_min", "joint 1", "q_max of -9 rad", "-6.28319")),
        ({"qdd_max": [1.0, 2.0]}, ("qdd_max", "shape [3]", "not [2]")),
        ({"qd_max": (-1.0, 1.0), "qd_min": -2.0}, ("qd_min", "twice", "-2.0", "qd_max")),
    ],
)
def test_changes_of_limits_that_are_refused(
    microbot: Robot, given: dict[str, Any], words: tuple[str, ...]
) -> None:
    with refused(*words):
        microbot.with_limits(**given)


def test_limits_as_plain_lists(microbot: Robot) -> None:
    plain = microbot.limits.as_dict()
    assert plain["tau_max"] == [400.0, 500.0, 200.0]
    assert plain["taud_min"] == [-np.inf] * 3
    assert len(plain) == 12


# ---- robots


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"a": [0.0]}, ("DH columns", "alpha has 2 rows", "a has 1")),
        ({"d": [0.0] * 3}, ("DH columns", "alpha has 2 rows", "d has 3")),
        ({"alpha": [], "a": [], "d": []}, ("alpha", "one row", "not 0")),
        ({"alpha": 0.0}, ("alpha", "shape [any]", "not []")),
        ({"a": [0.0, np.nan]}, ("a", "finite", "[1] is nan m")),
        ({"d": ["0", "1"]}, ("d", "array of numbers", "['0', '1']")),
        (
            {"theta_offset": [0.0]},
            ("DH columns", "alpha has 2 rows", "theta_offset has 1"),
        ),
        ({"joint_type": "screw"}, ("joint_type", "revolute, prismatic", "'screw'")),
        ({"joint_type": ["revolute"]}, ("joint_type", "1 entries", "2 joints")),
        (
            {"joint_type": ["revolute", 3]},
            ("joint_type", "revolute, prismatic", "not 3"),
        ),
        ({"joint_type": 3}, ("joint_type", "text", "not 3")),
        ({"links": [POINT]}, ("links", "1 entries", "2 joints")),
        ({"links": [POINT, 3.0]}, ("links", "Link objects", "3.0")),
        ({"joint_names": ["a"]}, ("joint_names", "2 different names", "['a']")),
        ({"joint_names": ["a", "a"]}, ("joint_names", "2 different names", "['a', 'a']")),
        ({"joint_names": ["a", 2]}, ("joint_names", "2 different names", "['a', 2]")),
        ({"name": 3}, ("name", "text", "not 3")),
        ({"description": None}, ("description", "text", "not None")),
        ({"gravity": 9.81}, ("gravity", "shape [3]", "not []")),
        ({"gravity": [0.0, -9.81]}, ("gravity", "shape [3]", "not [2]")),
        ({"gravity": "down"}, ("gravity", "array of numbers", "'down'")),
        ({"gravity": [0, 0, np.inf]}, ("gravity", "finite", "[2] is inf m/s^2")),
        ({"tool": [0.0, 1.0]}, ("tool", "shape [4]", "not [2]")),
        ({"tool": np.eye(3)}, ("tool", "shape [4, 4]", "[3, 3]")),
        ({"tool": 1.0}, ("tool", "shape [4, 4]", "not []")),
        ({"limits": 5.0}, ("limits", "Limits(tau_max=100.0)", "5.0")),
    ],
    ids=lambda value: str(value) if isinstance(value, dict) else "",
)
def test_impossible_robot_is_refused_in_one_sentence(
    changes: dict[str, Any], message: tuple[str, ...]
) -> None:
    with refused(*message) as caught:
        planar(**changes)
    assert "\n" not in str(caught.value)
    assert set(changes) & set(re.findall(r"\w+", str(caught.value)))


@pytest.mark.parametrize(
    ("tool", "said"),
    [
        (np.diag([1.0, 1.0, -1.0, 1.0]), ("tool[:3, :3]", "rotation", "0.001", "mirrors")),
        (np.diag([2.0, 0.5, 1.0, 1.0]), ("tool[:3, :3]", "rotation", "0.001", "3 off")),
        (np.diag([1.0, 1.0, 1.0, 2.0]), ("tool", "homogeneous", "0 0 0 1", "2.0]]")),
        (np.eye(4) + 0.1 * np.eye(4)[::-1], ("tool", "homogeneous", "0 0 0 1", "1.0]]")),
    ],
    ids=["mirror", "stretch", "last row", "shear"],
)
def test_tool_must_be_a_transform(tool: np.ndarray, said: tuple[str, ...]) -> None:
    with refused(*said):
        planar(tool=tool)


def test_tool_as_a_row_and_as_a_matrix_are_the_same_robot() -> None:
    row = (0.1, 2.0, 0.3, 0.4)
    assert planar(tool=row) == planar(tool=dh_transform(*row))


def test_joint_type_may_be_one_word_for_all() -> None:
    assert planar(joint_type="prismatic").joint_types == ("prismatic", "prismatic")


@pytest.mark.parametrize(
    ("quantity", "revolute", "prismatic"),
    [
        ("q", "rad", "m"),
        ("qd", "rad/s", "m/s"),
        ("qdd", "rad/s^2", "m/s^2"),
        ("tau", "N m", "N"),
        ("taud", "N m/s", "N/s"),
    ],
)
def test_units_follow_the_joint(quantity: str, revolute: str, prismatic: str) -> None:
    robot = planar(joint_type=["revolute", "prismatic"])
    assert robot.unit(quantity, 0) == revolute
    assert robot.unit(quantity, 1) == prismatic


def test_robot_without_links_has_kinematics_only() -> None:
    robot = planar()
    assert not robot.has_dynamics
    mo.forward_kinematics(robot)
    with refused("robot 'robot'", "masses", "dynamics"):
        mo.inverse_dynamics(robot)
    assert planar(links=[POINT, POINT]).has_dynamics


def test_equal_figures_make_equal_robots_that_share_their_functions(microbot: Robot) -> None:
    again = mo.load_robot("microbot")
    assert again is not microbot
    assert again == microbot
    assert hash(again) == hash(microbot)
    assert mo.inverse_dynamics(again) is mo.inverse_dynamics(microbot)


def changed_link(robot: Robot, **changes: Any) -> Robot:
    return robot.with_links([*robot.links[:-1], replace(robot.links[-1], **changes)])


@pytest.mark.parametrize(
    "change",
    [
        lambda r: r.with_gravity([0, 0, -9.81]),
        lambda r: changed_link(r, mass=2.1),
        lambda r: changed_link(r, center_of_mass=[4.0, 0.0, 0.1]),
        lambda r: changed_link(r, inertia=np.eye(3)),
        lambda r: changed_link(r, armature=0.1),
        lambda r: changed_link(r, viscous_friction=0.1),
        lambda r: changed_link(r, coulomb_friction=0.1),
        lambda r: replace(r, name="other"),
        lambda r: replace(r, a=r.a + 0.1),
        lambda r: replace(r, joint_types=("revolute", "revolute", "prismatic")),
        lambda r: replace(r, links=()),
    ],
    ids=[
        "gravity",
        "mass",
        "center",
        "inertia",
        "armature",
        "viscous",
        "coulomb",
        "name",
        "a",
        "type",
        "links",
    ],
)
def test_any_changed_figure_makes_another_robot(microbot: Robot, change: Any) -> None:
    other = change(microbot)
    assert other != microbot
    assert mo.forward_kinematics(other) is not mo.forward_kinematics(microbot)
    assert microbot == mo.load_robot("microbot")


def test_robots_with_other_limits_share_their_functions(microbot: Robot) -> None:
    other = microbot.with_limits(Limits(tau_max=1.0))
    assert other != microbot
    for make in (mo.forward_kinematics, mo.inverse_dynamics, mo.robot.torque_and_rate):
        assert make(other) is make(microbot)


def test_with_methods_check_what_they_are_given(microbot: Robot) -> None:
    with refused("links", "1 entries", "3 joints"):
        microbot.with_links([POINT])
    with refused("links", "Link objects", "not 1"):
        microbot.with_links([1, 2, 3])  # type: ignore[list-item]
    with refused("gravity", "shape [3]", "not [2]"):
        microbot.with_gravity([0, 0])
    with refused("limits", "Limits(tau_max=100.0)", "5.0"):
        microbot.with_limits(5.0)  # type: ignore[arg-type]
    with refused("tau_max", "shape [3]", "not [2]"):
        microbot.with_limits(Limits(tau_max=[1.0, 2.0]))


def test_robot_cannot_be_changed_in_place(microbot: Robot) -> None:
    with pytest.raises(FrozenInstanceError):
        microbot.name = "other"  # type: ignore[misc]
    for values in (microbot.alpha, microbot.gravity, microbot.tool, microbot.limits.tau_max):
        with refused("read-only", error=ValueError):
            values[0] = 1.0


@given(arrays(float, 4, elements=st.floats(-10.0, 10.0)))
def test_dh_transform_is_craigs_product_of_two_screws(row: np.ndarray) -> None:
    """Rot_x(alpha) Trans_x(a) Rot_z(theta) Trans_z(d), each written out."""
    alpha, a, d, theta = row
    about_x, about_z = np.eye(4), np.eye(4)
    about_x[1:3, 1:3] = [[np.cos(alpha), -np.sin(alpha)], [np.sin(alpha), np.cos(alpha)]]
    about_z[:2, :2] = [[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]]
    about_x[0, 3], about_z[2, 3] = a, d
    assert dh_transform(*row) == pytest.approx(about_x @ about_z, abs=1e-12)
