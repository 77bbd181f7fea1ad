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
from microbot_ocp import InputError, Limits, Link, Robot
from microbot_ocp.robot import dh_transform

POINT = Link(1.0, [0.0, 0.0, 0.0])


def planar(**changes: Any) -> Robot:
    rows: dict[str, Any] = {"alpha": [0.0, 0.0], "a": [0.0, 1.0], "d": [0.0, 0.0]}
    return Robot.from_dh(**(rows | changes))


# ---- links


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mass": -2.0}, "mass of link 'arm' must be at least 0 kg, not -2.0"),
        ({"allow_unphysical": 1}, "allow_unphysical of link 'arm' must be True or False, not 1"),
        ({"mass": np.nan}, "mass of link 'arm' must be finite, not nan kg"),
        ({"mass": "4"}, "mass of link 'arm' must be a number, not '4'"),
        ({"mass": True}, "mass of link 'arm' must be a number, not True"),
        ({"center_of_mass": [0, 0]}, "center_of_mass of link 'arm' must have shape [3], not [2]"),
        (
            {"center_of_mass": [0, np.inf, 0]},
            "center_of_mass of link 'arm' must be finite, but entry [1] is inf m",
        ),
        ({"inertia": [1, 1, 1]}, "inertia of link 'arm' must have shape [3, 3], not [3]"),
        (
            {"inertia": np.diag([1, np.nan, 1])},
            "inertia of link 'arm' must be finite, but entry [1, 1] is nan kg m^2",
        ),
        (
            {"inertia": [[1, 0.5, 0], [0, 1, 0], [0, 0, 1]]},
            "inertia of link 'arm' must be symmetric, not [[1.0, 0.5, 0.0], [0.0, 1.0, 0.0], "
            "[0.0, 0.0, 1.0]] kg m^2",
        ),
        (
            {"inertia": np.diag([1.0, 1.0, -0.5])},
            "inertia of link 'arm' must be positive semi-definite, but a principal moment is "
            "-0.5 kg m^2",
        ),
        (
            {"inertia": np.diag([1.0, 1.0, 3.0])},
            "inertia of link 'arm' breaks the triangle inequality: principal moments 1 + 1 < 3 "
            "kg m^2, which no rigid body has",
        ),
        ({"armature": -1.0}, "armature of link 'arm' must be at least 0 kg m^2, not -1.0"),
        (
            {"viscous_friction": -1.0},
            "viscous_friction of link 'arm' must be at least 0 N m s/rad, not -1.0",
        ),
        (
            {"coulomb_friction": np.inf},
            "coulomb_friction of link 'arm' must be finite, not inf N m",
        ),
    ],
)
def test_impossible_link_is_refused_in_one_sentence(changes: dict[str, Any], message: str) -> None:
    given = {"mass": 1.0, "center_of_mass": [0, 0, 0], "name": "arm"}
    with pytest.raises(InputError) as refused:
        Link(**(given | changes))
    assert str(refused.value) == message


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
    with pytest.raises(InputError, match="triangle inequality"):
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
        ({"q_min": np.inf}, ["q_min of joint 1", "inf"]),
        ({"q_max": -np.inf}, ["q_min of joint 1", "-inf"]),
        ({"qd_max": (1.0, -1.0)}, ["qd_min of joint 1", "qd_max of -1 rad/s", "m/s"]),
        ({"tau_max": -5.0}, ["tau_max of joint 1 must be at least 0 N m", "prismatic: N", "-5"]),
        ({"tau_max": [5.0, -5.0]}, ["tau_max of joint 2 must be at least 0", "-5"]),
        ({"tau_max": (100.0, 200.0)}, ["tau_max of joint 1 must leave room for zero", "a list"]),
        ({"qd_max": (1.0, 2.0)}, ["qd_max of joint 1 must leave room for zero", "[1, 2] rad/s"]),
        ({"qdd_max": (-2.0, -1.0)}, ["qdd_max of joint 1 must leave room for zero"]),
        ({"taud_max": ([-1.0, 1.0], 2.0)}, ["taud_max of joint 2 must leave room for zero"]),
        ({"tau_max": (1.0, 2.0, 3.0)}, ["tau_max as a tuple must be (lower, upper)", "3 entries"]),
        ({"tau_max": (1.0,)}, ["tau_max as a tuple must be (lower, upper)", "1 entries"]),
        ({"q_max": (-1.0, 1.0)}, ["q_max must be a number or a list", "not the tuple (-1.0, 1.0)"]),
        ({"q_min": (-1.0, 1.0)}, ["q_min must be a number or a list", "not the tuple"]),
        ({"qd_max": (-1.0, 1.0), "qd_min": -2.0}, ["qd_min is given twice", "-2.0"]),
        ({"tau_max": [1.0, 2.0, 3.0]}, ["tau_max must have shape [2], not [3]"]),
        ({"tau_max": np.nan}, ["tau_max must be finite", "nan"]),
        ({"q_min": [np.nan, 0.0]}, ["q_min must be finite", "entry [0] is nan"]),
        ({"tau_max": "strong"}, ["tau_max must be an array of numbers", "strong"]),
        ({"tau_max": "5"}, ["tau_max must be an array of numbers", "5"]),
        ({"tau_max": True}, ["tau_max must be an array of numbers", "True"]),
        ({"tau_max": [[1.0, 2.0]]}, ["tau_max must have shape [2], not [1, 2]"]),
        ({"tau_max": 5.0, "tau_min": [1.0]}, ["tau_min must have shape [2], not [1]"]),
    ],
    ids=str,
)
def test_impossible_limits_are_refused(given: dict[str, Any], fragments: list[str]) -> None:
    with pytest.raises(InputError) as refused:
        Limits(**given).for_joints(2)
    for fragment in fragments:
        assert fragment in str(refused.value)


def test_limits_of_another_robot_are_refused(microbot: Robot) -> None:
    with pytest.raises(InputError, match="limits are for 3 joints, but the robot has 2"):
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
        ({"limits": Limits(), "qd_max": 1.0}, "give limits or qd_max, not both"),
        ({"tau_max": -1.0}, "tau_max of joint 1 must be at least 0"),
        ({"q_max": -9.0}, "q_min of joint 1 must be finite or -inf and at most its q_max of -9"),
        ({"qdd_max": [1.0, 2.0]}, "qdd_max"),
        ({"qd_max": (-1.0, 1.0), "qd_min": -2.0}, "qd_min is given twice"),
    ],
)
def test_changes_of_limits_that_are_refused(
    microbot: Robot, given: dict[str, Any], words: str
) -> None:
    with pytest.raises(InputError, match=words):
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
        ({"a": [0.0]}, "the DH columns differ in length: alpha has 2 rows, a has 1"),
        ({"d": [0.0] * 3}, "the DH columns differ in length: alpha has 2 rows, d has 3"),
        ({"alpha": [], "a": [], "d": []}, "alpha must have at least one row, not 0"),
        ({"alpha": 0.0}, "alpha must have shape [any], not []"),
        ({"a": [0.0, np.nan]}, "a must be finite, but entry [1] is nan m"),
        ({"d": ["0", "1"]}, "d must be an array of numbers, not ['0', '1']"),
        (
            {"theta_offset": [0.0]},
            "the DH columns differ in length: alpha has 2 rows, theta_offset has 1",
        ),
        ({"joint_type": "screw"}, "joint_type must be one of revolute, prismatic, not 'screw'"),
        ({"joint_type": ["revolute"]}, "joint_type has 1 entries for 2 joints"),
        (
            {"joint_type": ["revolute", 3]},
            "joint_type must be one of revolute, prismatic, not 3",
        ),
        ({"joint_type": 3}, "joint_type must be text or a list of text, not 3"),
        ({"links": [POINT]}, "links has 1 entries for 2 joints"),
        ({"links": [POINT, 3.0]}, "links must hold Link objects, not 3.0"),
        ({"joint_names": ["a"]}, "joint_names must be 2 different names, not ['a']"),
        ({"joint_names": ["a", "a"]}, "joint_names must be 2 different names, not ['a', 'a']"),
        ({"joint_names": ["a", 2]}, "joint_names must be 2 different names, not ['a', 2]"),
        ({"name": 3}, "name must be text, not 3"),
        ({"description": None}, "description must be text, not None"),
        ({"gravity": 9.81}, "gravity must have shape [3], not []"),
        ({"gravity": [0.0, -9.81]}, "gravity must have shape [3], not [2]"),
        ({"gravity": "down"}, "gravity must be an array of numbers, not 'down'"),
        ({"gravity": [0, 0, np.inf]}, "gravity must be finite, but entry [2] is inf m/s^2"),
        ({"tool": [0.0, 1.0]}, "tool must have shape [4], not [2]"),
        ({"tool": np.eye(3)}, "tool must have shape [4, 4], not [3, 3]"),
        ({"tool": 1.0}, "tool must have shape [4, 4], not []"),
        ({"limits": 5.0}, "limits must be Limits, such as Limits(tau_max=100.0), not 5.0"),
    ],
    ids=lambda value: str(value) if isinstance(value, dict) else "",
)
def test_impossible_robot_is_refused_in_one_sentence(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as refused:
        planar(**changes)
    assert str(refused.value) == message


@pytest.mark.parametrize(
    "tool",
    [
        np.diag([1.0, 1.0, -1.0, 1.0]),
        np.diag([2.0, 0.5, 1.0, 1.0]),
        np.diag([1.0, 1.0, 1.0, 2.0]),
        np.eye(4) + 0.1 * np.eye(4)[::-1],
    ],
    ids=["mirror", "stretch", "last row", "shear"],
)
def test_tool_must_be_a_transform(tool: np.ndarray) -> None:
    wrong = r"tool(\[:3, :3\] must be a rotation| must be a homogeneous transform) .*\[\["
    with pytest.raises(InputError, match=wrong):
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
    with pytest.raises(InputError, match="robot 'robot' has no links with masses"):
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
        lambda r: r.with_limits(Limits(tau_max=1.0)),
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
        "limits",
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


def test_with_methods_check_what_they_are_given(microbot: Robot) -> None:
    with pytest.raises(InputError, match="links has 1 entries for 3 joints"):
        microbot.with_links([POINT])
    with pytest.raises(InputError, match="links must hold Link objects"):
        microbot.with_links([1, 2, 3])  # type: ignore[list-item]
    with pytest.raises(InputError, match=re.escape("gravity must have shape [3], not [2]")):
        microbot.with_gravity([0, 0])
    with pytest.raises(InputError, match="limits must be Limits, such as"):
        microbot.with_limits(5.0)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=re.escape("tau_max must have shape [3], not [2]")):
        microbot.with_limits(Limits(tau_max=[1.0, 2.0]))


def test_robot_cannot_be_changed_in_place(microbot: Robot) -> None:
    with pytest.raises(FrozenInstanceError):
        microbot.name = "other"  # type: ignore[misc]
    for values in (microbot.alpha, microbot.gravity, microbot.tool, microbot.limits.tau_max):
        with pytest.raises(ValueError, match="read-only"):
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
