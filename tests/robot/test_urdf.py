"""URDF files read into modified-DH rows, written back, and refused by name."""

from __future__ import annotations

import io
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

import microbot_ocp as mo
from helpers import (
    RANDOM_CHAINS,
    any_robot,
    batch,
    crossed,
    difference,
    random_link,
    random_states,
    refused,
    sampled,
    tells,
    warned,
)
from microbot_ocp.cli import main
from microbot_ocp.robot import RobotFileWarning
from microbot_ocp.robot.files import parse_robot, parse_urdf, robot_to_toml, robot_to_urdf

yourdfpy = pytest.importorskip("yourdfpy")
pin = pytest.importorskip("pinocchio")

LIMIT = '<limit lower="-3" upper="3" effort="10" velocity="2"/>'
INERTIA = '<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/>'
BODY = f'<inertial><origin xyz="0.1 0.2 0.3"/><mass value="2"/>{INERTIA}</inertial>'

# Placements of a joint after the one before, xyz and rpy, for which the common normal is special.
SPECIAL = {
    "parallel": ("0.3 -0.2 0.4", "0 0 0.7"),
    "antiparallel": ("0.3 -0.2 0.4", f"{np.pi!r} 0 0.7"),
    "coincident": ("0 0 0.4", "0 0 0.7"),
    "reversed on the same axis": ("0 0 -0.4", f"0 {np.pi!r} 0"),
    "same place": ("0 0 0", "0 0 0"),
    "intersecting": ("0 0 0.4", "0.6 0 0.2"),
    "intersecting at right angles": ("0 0 0", f"{np.pi / 2!r} 0 0"),
    "at right angles": ("0.3 0 0", f"{-np.pi / 2!r} 0 0"),
    "skew": ("0.3 -0.2 0.4", "0.5 -0.6 0.7"),
    "barely off parallel": ("0.3 -0.2 0.4", "0.002 0 0"),
    "antiparallel to six digits": ("0.3 -0.2 0.4", "3.14159 0.00001 0"),
    "coincident to six digits": ("0 0 0.4", "0.000001 0 0"),
    "off parallel by a degree": ("0.3 -0.2 0.4", "0.015 0.01 0"),
    "parallel to nine digits": ("0.3 0 0", "3.141592654 0 0"),
}

# URDF has no place for rotors.
WRITTEN = [name for name in mo.packaged_robots() if not mo.load_robot(name).rotors]


def chain(*joints: str, links: tuple[str, ...] = (), more: str = "") -> str:
    """A URDF of links "l0", "l1", ... one after the other, of joints given by what is in them."""
    bodies = [*links, *[BODY] * len(joints)]
    text = ["<robot name='r'>", f"<link name='l0'>{bodies[0] if links else ''}</link>"]
    for i, inside in enumerate(joints):
        own = bodies[i + 1] if links else BODY
        text.append(f"<link name='l{i + 1}'>{own}</link>")
        opening = inside if inside.startswith("<joint") else f"<joint name='j{i + 1}' {inside}"
        text.append(f"{opening}<parent link='l{i}'/><child link='l{i + 1}'/></joint>")
    return "".join([*text, more, "</robot>"])


def revolute(xyz: str = "0 0 0", rpy: str = "0 0 0", axis: str = "0 0 1", more: str = LIMIT) -> str:
    return f"type='revolute'><origin xyz='{xyz}' rpy='{rpy}'/><axis xyz='{axis}'/>{more}"


def fixed(xyz: str = "0 0 0", rpy: str = "0 0 0") -> str:
    return f"type='fixed'><origin xyz='{xyz}' rpy='{rpy}'/>"


def quiet(text: str, tip: str | None = None) -> mo.Robot:
    """The robot, of whose file other tests ask what the warnings are."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RobotFileWarning)
        return parse_urdf(text, "arm.urdf", tip)


def words(values: np.ndarray) -> str:
    return " ".join(repr(float(value)) for value in values)


def random_urdf(seed: int, kinds: str) -> str:
    """Random placements, axes, masses, friction: r revolute, p prismatic, f fixed joints."""
    rng = np.random.default_rng(seed)
    text = ["<robot name='random'><link name='l0'/>"]
    for i, kind in enumerate(kinds):
        body = random_link(rng)
        i_text = " ".join(
            f"{key}='{float(body.inertia[row, column])!r}'"
            for key, row, column in (
                *(("ixx", 0, 0), ("ixy", 0, 1), ("ixz", 0, 2)),
                *(("iyy", 1, 1), ("iyz", 1, 2), ("izz", 2, 2)),
            )
        )
        axis = rng.normal(size=3)
        name = {"r": "revolute", "p": "prismatic", "f": "fixed"}[kind]
        text.append(
            f"<link name='l{i + 1}'><inertial><mass value='{body.mass!r}'/>"
            f"<origin xyz='{words(body.center_of_mass)}' rpy='{words(rng.uniform(-3, 3, 3))}'/>"
            f"<inertia {i_text}/></inertial></link>"
            f"<joint name='j{i + 1}' type='{name}'><parent link='l{i}'/><child link='l{i + 1}'/>"
            f"<origin xyz='{words(rng.uniform(-1, 1, 3))}' rpy='{words(rng.uniform(-3, 3, 3))}'/>"
        )
        if kind != "f":
            text.append(f"<axis xyz='{words(axis / np.linalg.norm(axis))}'/>{LIMIT}")
        text.append("</joint>")
    return "".join([*text, "</robot>"])


def parser_poses(text: str, q: np.ndarray, tip: str) -> np.ndarray:
    """Poses [N,4,4] of a link in the root's frame, as yourdfpy finds them."""
    model = yourdfpy.URDF.load(io.BytesIO(text.encode()), load_meshes=False)
    poses = []
    for row in q:
        model.update_cfg(row)
        poses.append(model.get_transform(tip, model.base_link).copy())
    return np.array(poses)


def assert_same_motion(text: str, tip: str, relative: float = 1e-12) -> mo.Robot:
    """Poses are those of the parser, the dynamics those of pinocchio."""
    robot = parse_urdf(text, "arm.urdf")
    q, qd, qdd = random_states(robot, 50)
    poses = parser_poses(text, q, tip)
    assert difference(batch(mo.forward_kinematics(robot), q), poses) < relative
    model = pin.buildModelFromXML(text)
    data = model.createData()
    states = list(zip(q, qd, qdd, strict=True))
    tau = [pin.rnea(model, data, *state).copy() for state in states]
    assert difference(batch(mo.inverse_dynamics(robot), q, qd, qdd), tau) < relative
    mass = [np.triu(pin.crba(model, data, row)) for row in q]
    mass = [upper + np.triu(upper, 1).T for upper in mass]
    shape = (len(q), robot.joint_count, robot.joint_count)  # a single joint has lost one axis
    assert difference(batch(mo.mass_matrix(robot), q).reshape(shape), mass) < relative
    held = [pin.computeGeneralizedGravity(model, data, row).copy() for row in q]
    assert difference(batch(mo.gravity_torque(robot), q), held) < relative
    frame = model.getFrameId(tip)
    aligned = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    slopes = [pin.computeFrameJacobian(model, data, row, frame, aligned).copy() for row in q]
    shape = (len(q), 6, robot.joint_count)
    slopes = np.reshape(slopes, shape)
    assert difference(batch(mo.jacobian(robot), q).reshape(shape), slopes) < relative
    kinetic, potential = (np.array(e).ravel() for e in mo.energy(robot)(q.T, qd.T))
    energies = [
        [pin.computeKineticEnergy(model, data, q, qd), pin.computePotentialEnergy(model, data, q)]
        for q, qd in zip(q, qd, strict=True)
    ]
    ours = np.column_stack([kinetic, potential])
    assert np.ptp((ours - energies)[:, 1]) < 100 * relative  # the root's own mass is a constant
    assert difference(ours[:, :1], np.array(energies)[:, :1]) < relative
    return robot


@pytest.mark.parametrize("kinds", ["r", "p", "rr", "rp", "frf", "rfrffp", "frpfrrf", "rrrrrrr"])
@pytest.mark.parametrize("seed", sampled([1, 2], 2))
def test_any_chain_moves_as_its_parser_says(seed: int, kinds: str) -> None:
    robot = assert_same_motion(random_urdf(seed, kinds), f"l{len(kinds)}", 1e-11)
    assert robot.joint_count == len(kinds.replace("f", ""))
    assert robot.name == "random"


@pytest.mark.slow
@given(st.integers(0, 10_000), st.text("rpf", min_size=1, max_size=7))
def test_poses_of_random_chains_are_those_of_the_parser(seed: int, kinds: str) -> None:
    text = random_urdf(seed, kinds + "r")
    robot = parse_urdf(text)
    q, *_ = random_states(robot, 5, seed)
    tip = f"l{len(kinds) + 1}"
    ours = batch(mo.forward_kinematics(robot), q)
    assert difference(ours, parser_poses(text, q, tip)) < 1e-11


def runs_of_every_pair(names: list[str], length: int) -> list[list[str]]:
    """Runs of names in which each follows every one, itself too, just once."""
    pairs = [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]]
    order = [n for a in names for n in (a, *(n for pair in pairs if pair[0] == a for n in pair))]
    order.append(order[0])
    return [order[k : k + length] for k in range(0, len(order) - 1, length - 1)]


@pytest.mark.slow
@pytest.mark.parametrize("names", sampled(runs_of_every_pair(list(SPECIAL), 5), 6), ids=", ".join)
def test_special_axes_have_rows_too(names: list[str]) -> None:
    text = chain(
        revolute("0.1 0.2 0.3", "0.4 0 0"),
        *(revolute(*SPECIAL[name]) for name in names),
        fixed("0.1 0 0.2", "0.3 0.2 0.1"),
    )
    robot = assert_same_motion(text, f"l{len(names) + 2}")
    assert np.abs(robot.d).max() < 2.0  # no common normal far away


def test_upright_first_axis_leaves_the_base_alone() -> None:
    text = chain(revolute("0 0 0.5"), revolute("0.3 0 0", f"{-np.pi / 2!r} 0 0"))
    robot = parse_urdf(text)
    assert np.array_equal(robot.base, np.eye(4))
    assert robot.d[0] == 0.5
    tilted = parse_urdf(chain(revolute("0.2 0 0.5", "0.3 0 0")))
    assert tilted.base[:3, 3].tolist() == [0.2, 0.0, 0.5]


def test_what_a_joint_says_is_read() -> None:
    inside = (
        '<limit lower="-1.5" upper="2.5" effort="12" velocity="3"/>'
        '<dynamics damping="0.7" friction="0.4"/>'
    )
    robot = parse_urdf(chain(revolute(more=inside), "type='continuous'><axis xyz='1 0 0'/>"))
    limits = robot.limits
    assert robot.joint_names == ("j1", "j2")
    assert limits.q_min.tolist() == [-1.5, -np.inf]
    assert limits.q_max.tolist() == [2.5, np.inf]
    assert limits.qd_min.tolist() == [-3.0, -np.inf]
    assert limits.tau_max.tolist() == [12.0, np.inf]
    assert limits.qdd_max.tolist() == [np.inf, np.inf]
    first, second = robot.links
    assert (first.viscous_friction, first.coulomb_friction) == (0.7, 0.4)
    assert (second.viscous_friction, second.coulomb_friction, second.armature) == (0, 0, 0)
    assert first.name == "l1"


def test_fixed_joints_merge_their_inertias() -> None:
    """Two equal balls 2 m apart are one body: mass, centre and the parallel axes by hand."""
    ball = f'<inertial><mass value="3"/>{INERTIA}</inertial>'
    text = chain(revolute(), fixed("2 0 0", "0.4 0.3 0.2"), links=("", ball, ball))
    (link,) = parse_urdf(text).links
    assert link.mass == 6.0
    assert link.center_of_mass == pytest.approx([1.0, 0.0, 0.0], abs=1e-15)
    expected = np.diag([0.2, 0.2 + 6.0, 0.2 + 6.0])
    assert link.inertia == pytest.approx(expected, abs=1e-14)


def test_masses_may_be_missing_altogether() -> None:
    text = chain(revolute(), revolute("1 0 0"), links=(BODY, "", ""))
    assert not parse_urdf(text).has_dynamics


BRANCH = (
    "<link name='left'/><joint name='to left' type='fixed'>"
    "<parent link='l1'/><child link='left'/></joint>"
)


def branch(name: str, parent: str, more: str = LIMIT, kind: str = "revolute") -> str:
    return (
        f"<link name='{name}'>{BODY}</link><joint name='to {name}' type='{kind}'>"
        f"<axis xyz='0 0 1'/><origin xyz='0.5 0 0'/><parent link='{parent}'/>"
        f"<child link='{name}'/>{more}</joint>"
    )


def test_side_links_that_do_not_move_are_merged() -> None:
    plate = f"<link name='plate'>{BODY}</link><joint name='on' type='fixed'><parent link='l1'/>"
    text = chain(revolute(), revolute("1 0 0"), more=plate + "<child link='plate'/></joint>")
    robot = parse_urdf(text)
    assert [link.mass for link in robot.links] == [4.0, 2.0]


def test_tip_chooses_one_end_of_several() -> None:
    text = chain(revolute(), more=BRANCH + BRANCH.replace("left", "right"))
    with warned("arm.urdf", "tool frame", "'l1'", "'left', 'right'", category=RobotFileWarning):
        assert np.array_equal(parse_urdf(text, "arm.urdf").tool, np.eye(4))
    assert quiet(text, tip="left").joint_names == ("j1",)
    with warned("arm.urdf", "tool frame", "'tool0'", "'left'", category=RobotFileWarning):
        parse_urdf(text.replace("right", "tool0"), "arm.urdf")


def test_joints_off_the_way_to_the_tip_are_held_at_zero() -> None:
    side = branch("side", "l1", '<limit lower="0.5" upper="1" effort="1" velocity="1"/>')
    text = chain(revolute(), revolute("1 0 0"), more=side)
    with refused("link 'l1'", "'j2', 'to side'", "tip", "'l1' (1)", "'l2' (2), 'side' (2)"):
        parse_urdf(text, "arm.urdf")
    robot = quiet(text, tip="l2")
    assert [link.mass for link in robot.links] == [4.0, 2.0]
    own = np.array([0.1, 0.2, 0.3])
    assert robot.links[0].center_of_mass == pytest.approx(own + 0.25 * np.eye(3)[0], abs=1e-15)
    shorter = quiet(text, tip="l1")
    assert shorter.joint_names == ("j1",)
    assert shorter.links[0].mass == 6.0


def gripper(kind: str = "prismatic", leader: str = "to one") -> str:
    one = branch("one", "l1", LIMIT)
    mimic = f"<mimic joint='{leader}' multiplier='-2' offset='0.3'/>"
    return chain(revolute(), more=one + branch("other", "l1", LIMIT + mimic, kind))


def test_fingers_that_mimic_each_other_are_carried() -> None:
    with warned("hand.urdf", "tool frame", "'l1'", category=RobotFileWarning):
        robot = parse_urdf(gripper(), "hand.urdf")
    assert robot.joint_names == ("j1",)
    assert robot.links[0].mass == 6.0
    # the finger slides along Z by its offset
    assert robot.links[0].center_of_mass[2] == pytest.approx((0.3 + 0.3 + 0.3 + 0.3) / 3)
    assert quiet(gripper(), tip="l1") == robot


@pytest.mark.parametrize(("finger", "held"), [("one", "'to other' at 0.3"), ("other", "'to one'")])
def test_each_finger_can_be_the_tip(finger: str, held: str) -> None:
    with warned("hand.urdf", "mimic", held, category=RobotFileWarning):
        robot = parse_urdf(gripper(), "hand.urdf", finger)
    assert robot.joint_names == ("j1", f"to {finger}")


def test_of_joints_on_one_way_that_mimic_each_other_the_leader_moves_both() -> None:
    """The first follows the second."""
    mimic = LIMIT + "<mimic joint='j2' offset='0.5'/>"
    robot = parse_urdf(chain(revolute(more=mimic), revolute("1 0 0")))
    assert robot.joint_names == ("j2",)
    pose = np.array(mo.forward_kinematics(robot)([0.2]))
    assert pose[:3, 3] == pytest.approx([np.cos(0.7), np.sin(0.7), 0.0], abs=1e-15)


@pytest.mark.parametrize("leader", ["nobody", "to other", "fixed"])
def test_a_mimic_without_a_leader_moves_on_its_own(leader: str) -> None:
    with warned("mimic", "'to other'", f"'{leader}'", category=RobotFileWarning):
        robot = parse_urdf(gripper(leader=leader), tip="other")
    assert robot.joint_names == ("j1", "to other")


@pytest.mark.parametrize("kind", ["planar", "floating"])
def test_joints_that_no_chain_has_are_held_on_the_way(kind: str) -> None:
    text = chain(revolute(), f"type='{kind}'><origin xyz='1 2 3'/>", revolute("1 0 0"))
    with warned("zero", f"'j2' ({kind})", category=RobotFileWarning):
        robot = parse_urdf(text)
    assert robot == quiet(text.replace(kind, "fixed"))
    aside = f"<link name='x'/><joint name='k' type='{kind}'>"
    aside += "<parent link='l1'/><child link='x'/></joint>"
    assert quiet(chain(revolute(), more=aside), tip="x").joint_names == ("j1",)


def test_massless_links_are_massless() -> None:
    """Their inertia counts all the same."""
    text = chain(revolute(), revolute("1 0 0"), links=("", BODY, ""))
    robot = assert_same_motion(text, "l2")
    assert [link.mass for link in robot.links] == [2.0, 0.0]
    empty = f'<inertial><mass value="0"/>{INERTIA}</inertial>'
    text = chain(revolute(), revolute("1 0 0"), links=("", empty, BODY))
    robot = assert_same_motion(text, "l2")
    assert robot.links[0].mass == 0.0
    assert robot.links[0].inertia == pytest.approx(0.1 * np.eye(3))


@pytest.mark.parametrize(
    ("moment", "fault"),
    [("0.3", "0.1 + 0.1 < 0.3 kg m^2"), ("-0.1", "-0.1 kg m^2")],
)
def test_inertias_that_no_body_has_are_taken_as_they_stand(moment: str, fault: str) -> None:
    text = chain(revolute(), revolute("1 0 0")).replace('izz="0.1"', f'izz="{moment}"')
    with warned("arm.urdf", "'l1'", fault, category=RobotFileWarning):
        robot = assert_same_motion(text, "l2")
    assert robot.links[0].allow_unphysical
    assert parse_robot(robot_to_toml(robot)) == robot


def test_inertias_of_links_that_stand_still_are_told_apart() -> None:
    body = BODY.replace('izz="0.1"', 'izz="0.3"')
    with warned("'l0'", "triangle inequality", "0.1 + 0.1 < 0.3", category=RobotFileWarning):
        robot = parse_urdf(chain(revolute(), links=(body, BODY)))
    assert not robot.links[0].allow_unphysical


def test_a_message_lists_no_more_than_it_has_room_for() -> None:
    many = "".join(branch(f"tip{i}", "l1") for i in range(100))
    with refused("'to tip4', 95 more", "95 more"):
        parse_urdf(chain(revolute(), revolute(), more=many))


def test_dust_is_no_inertia() -> None:
    dust = INERTIA.replace('"0.1"', '"0"').replace('izz="0"', 'izz="-1e-20"')
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        robot = parse_urdf(chain(revolute()).replace(INERTIA, dust))
    assert not robot.links[0].allow_unphysical


def test_a_mass_alone_is_a_point() -> None:
    text = chain(revolute()).replace(INERTIA, "")
    with warned("point masses", "'l1'", category=RobotFileWarning):
        robot = parse_urdf(text)
    assert not robot.links[0].inertia.any()


@pytest.mark.parametrize("limit", ["", "<limit effort='1' velocity='1'/>"])
def test_joints_without_a_range_are_unlimited(limit: str) -> None:
    with warned("unlimited", "'j1'", category=RobotFileWarning):
        robot = parse_urdf(chain(revolute(more=limit)))
    assert robot.limits.q_min.tolist() == [-np.inf]


@pytest.mark.parametrize("axis", ["0 0 2", "1 1 0"])
def test_axes_are_scaled(axis: str) -> None:
    with warned("unit vectors", "joint 'j1'", category=RobotFileWarning):
        assert_same_motion(chain(revolute(axis=axis), revolute("1 0 0")), "l2")


def test_a_warning_names_a_dozen_and_counts_the_rest() -> None:
    text = chain(*[revolute(axis="0 0 2")] * 20)
    with warned(
        "arm.urdf:", "unit vectors", "joint 'j12', of length 2, 8 more", category=RobotFileWarning
    ):
        parse_urdf(text, "arm.urdf")


PLAIN = chain(revolute(), revolute("1 0 0"))
UMLAUT = "<!-- Gelenk für später -- hier -->"


@pytest.mark.parametrize(
    "data",
    [
        f"\n\n <!-- first --><?xml version='1.0'?>{UMLAUT}{PLAIN}",
        f"\ufeff<?xml version='1.0' encoding='utf-16'?>{PLAIN}",
        f"<?xml version='1.1'?>{PLAIN}",
        PLAIN.encode("utf-8-sig"),
        PLAIN.encode("utf-16"),
        PLAIN.encode("utf-16-be"),
        PLAIN.encode("utf-32"),
        f"<?xml version='1.0' encoding='iso-8859-1'?>{UMLAUT}{PLAIN}".encode("latin-1"),
        f"<?xml version='1.0' encoding='utf-16'?>{PLAIN}".encode(),
        f"<!DOCTYPE robot>{PLAIN}",
        PLAIN.replace("<limit", "<limit drake:unknown='2'"),
        PLAIN.replace("</robot>", "<drake:group><drake:member link='l1'/></drake:group></robot>"),
        PLAIN.replace("<robot", "<robot xmlns='http://some.where' xmlns:xacro='x'"),
    ],
)
def test_sloppy_xml_and_odd_encodings_are_read(data: str | bytes) -> None:
    assert quiet(data) == quiet(PLAIN)


@pytest.mark.parametrize("declared", ["", "<?xml version='1.0' encoding='klingon'?>"])
def test_what_is_not_in_its_encoding_is_read_as_latin_1(declared: str) -> None:
    data = f"{declared}{UMLAUT}{PLAIN}".encode("latin-1")
    with warned("Latin-1", category=RobotFileWarning):
        assert parse_urdf(data) == quiet(PLAIN)


BOMB = "<!DOCTYPE r [<!ENTITY a 'aaaa'><!ENTITY b '&a;&a;&a;'>]><robot name='&b;'/>"
NESTED = "<robot name='r'>" + "<link name='l'>" * 5000 + "</link>" * 5000 + "</robot>"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (BOMB, ("XML entities", "'a'")),
        (BOMB.replace("'aaaa'", "SYSTEM 'file:///etc/passwd'"), ("XML entities", "'a'")),
        (NESTED, ("200:", "<link>")),
        ("<a>" * 100_000, ("200:", "<a>")),
        (PLAIN.replace("l1", "&nothing;"), ("valid XML", "undefined entity", "line 1")),
        (PLAIN.replace("</robot>", "\n\n</robots>"), ("valid XML", "mismatched tag", "line 3")),
        (f"{UMLAUT}\n<!--\n-->\n{PLAIN[:-1]}", ("valid XML", "line 4")),
        (PLAIN.encode("utf-16")[:-7], ("valid XML", "line 1")),
        ("\ud800", ("valid XML", "surrogates")),
        (b"\x00\xff" * 100, ("valid XML", "line 1")),
    ],
    ids=range(10),
)
def test_hostile_texts_are_refused(text: str | bytes, message: tuple[str, ...]) -> None:
    with refused("arm.urdf: ", *message):
        parse_urdf(text, "arm.urdf")


NO_BODY = ("", "", "")
TWICE = "<joint name='j1' type='fixed'><parent link='l1'/><child link='x'/></joint>"
LOOSE = "<joint name='k' type='fixed'><parent link='x'/><child link='y'/></joint>"
RING = (
    "<link name='x'/><link name='y'/>"
    "<joint name='k' type='fixed'><parent link='x'/><child link='y'/></joint>"
    "<joint name='m' type='fixed'><parent link='y'/><child link='x'/></joint>"
)


@pytest.mark.parametrize(
    ("text", "fragments"),
    [
        ("", ["valid XML"]),
        ("<robot name='r'>", ["valid XML", "line 1"]),
        ("<model name='r'/>", ["URDF", "<model>"]),
        ("<robot/>", ["moving joint"]),
        ("<robot name='r'><link/></robot>", ["link", "name"]),
        ("<robot name='r'><link name='l'/></robot>", ["moving joint"]),
        (chain(fixed()), ["moving joint"]),
        (
            chain(revolute()).replace("-3", "${low}"),
            ["lower limit", "joint 'j1'", "number", "'${low}'", "xacro"],
        ),
        (chain(revolute()).replace("-3", "1_0"), ["lower limit", "joint 'j1'", "not '1_0'"]),
        (chain(revolute(axis="0 0 0")), ["axis", "joint 'j1'", "unit vector", "length 0"]),
        (chain(revolute(axis="0 1")), ["axis", "joint 'j1'", "shape [3]", "not [2]"]),
        (chain(revolute(axis="0 nan 1")), ["axis", "joint 'j1'", "finite", "nan"]),
        (chain(revolute("nan 0 0")), ["origin", "joint 'j1'", "finite", "nan"]),
        (chain(revolute("0 0 0", "0 inf 0")), ["origin", "joint 'j1'", "finite", "inf"]),
        (chain(revolute()).replace("-3", "nan"), ["lower limit", "joint 'j1'", "nan"]),
        (chain(revolute()).replace("-3", "4"), ["lower limit", "joint 'j1'", "at most", "not 4"]),
        (chain(revolute()).replace('"10"', '"nan"'), ["effort", "joint 'j1'", "finite", "nan"]),
        (
            chain(revolute()).replace('city="2"', 'city="-2"'),
            ["velocity of joint 'j1'", "0,", "-2.0"],
        ),
        (
            chain(revolute(more=LIMIT + "<dynamics damping='-1'/>")),
            ["damping of joint 'j1'", "0,", "-1.0"],
        ),
        (
            chain(revolute(more=LIMIT + "<dynamics friction='x'/>")),
            ["friction of joint 'j1'", "number", "'x'"],
        ),
        (
            chain(revolute()).replace('mass value="2"', 'mass value="-1"'),
            ["mass of link 'l1'", "0,", "-1.0"],
        ),
        (
            chain(revolute()).replace('mass value="2"', 'mass value="nan"'),
            ["mass of link 'l1'", "finite", "nan"],
        ),
        (
            chain(revolute(), fixed("1e200 0 0")).replace("0.1", "1"),
            ["inertia", "link 'l1'", "finite"],
        ),
        (chain(revolute()).replace('mass value="2"', "mass"), ["mass of link 'l1'", "value"]),
        (
            chain(revolute()).replace(INERTIA, "<inertia ixx='1'/>"),
            ["inertia of link 'l1'", "ixy, ixz, iyy"],
        ),
        (chain(revolute()).replace('<mass value="2"/>', ""), ["mass of link 'l1'", "value"]),
        (chain(revolute()).replace('izz="0.1"', ""), ["inertia of link 'l1'", "izz"]),
        (chain(revolute()).replace('iyz="0"', 'iyz="nan"'), ["inertia of link 'l1'", "nan"]),
        (
            chain(revolute()).replace('"0.1 0.2 0.3"', '"0.1 nan 0"'),
            ["inertial origin", "link 'l1'", "[1] is nan"],
        ),
        (chain("type='planar'>"), ["moving joint"]),
        (chain("type='screw'>"), ["joint 'j1' is screw", "revolute, continuous, prismatic"]),
        (chain(revolute(), more=TWICE), ["two joints", "'j1'"]),
        (chain(revolute(), more="<link name='l1'/>"), ["two links", "'l1'"]),
        (chain(revolute(), more=LOOSE), ["parent", "joint 'k'", "link", "'x'"]),
        (chain(revolute(), more="<link name='x'/>"), ["root link", "'l0', 'x'"]),
        (chain(revolute(), more=RING), ["ring", "chain"]),
        (
            chain(revolute(), more=BRANCH + branch("left2", "l0").replace("'left2'/>", "'left'/>")),
            ["link 'left'", "'to left' and 'to left2'"],
        ),
        (
            chain(revolute(more=LIMIT + "<microbot_ocp armature='-1'/>")),
            ["armature", "joint 'j1'", "0,", "-1.0"],
        ),
        (
            chain(revolute(more=LIMIT + "<microbot_ocp rotor='1'/>")),
            ["<microbot_ocp>", "joint 'j1'", "armature", "'rotor'"],
        ),
        (chain(revolute(), more="<microbot_ocp gravity='0 0'/>"), ["gravity", "shape [3]"]),
        (
            chain(revolute(), more="<microbot_ocp g='0'/>"),
            ["<microbot_ocp>", "gravity, description", "'g'"],
        ),
    ],
)
def test_broken_urdf_is_refused_by_name(text: str, fragments: list[str]) -> None:
    with refused("arm.urdf: ", *fragments):
        parse_urdf(text, "arm.urdf")


def test_angles_rounded_hard_make_plain_rows_on_request(tmp_path: Path) -> None:
    text = chain(revolute(), revolute("1 1 0", "3.14159 0 0"))
    path = tmp_path / "rounded.urdf"
    path.write_text(text)
    assert mo.robot.load_urdf(path).beta.any()
    robot = mo.robot.load_urdf(path, parallel_tolerance=1e-5)
    assert not robot.beta.any()
    q, *_ = random_states(robot, 20)
    poses = parser_poses(text, q, "l2")
    assert difference(batch(mo.forward_kinematics(robot), q), poses) < 1e-5
    for bad, allowed in ((-1.0, "0 rad"), (np.nan, "finite"), (1.0, "0.1 rad"), ("x", "number")):
        with refused("parallel_tolerance", allowed, repr(bad)):
            mo.robot.load_urdf(path, parallel_tolerance=bad)  # type: ignore[arg-type]


def test_axis_written_with_four_digits_is_taken_as_a_unit_vector() -> None:
    robot = parse_urdf(chain(revolute(axis="0.7071 0.7071 0")))
    assert np.linalg.norm(robot.base[:3, 2]) == pytest.approx(1.0, abs=1e-15)


def test_urdf_is_loaded_by_its_path(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(random_urdf(3, "rfp"))
    assert mo.load_robot(path) == mo.load_robot(str(path)) == mo.robot.load_urdf(path)
    assert mo.load_robot(path, tip="l2").joint_names == ("j1",)
    with refused("tip", "link", "'l'", "'l3' (2)"):
        mo.load_robot(path, tip="l")
    with refused("'l0' and 'l0'", "'l3' (2)"):
        mo.load_robot(path, tip="l0")
    with refused("tip", "URDF", "MJCF", "'microbot'"):
        mo.load_robot("microbot", tip="hand")
    with refused("robot file", "none.urdf"):
        mo.load_robot(tmp_path / "none.urdf")


XACRO = """<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:include filename="$(find arm_description)/urdf/joint.xacro"/>
<link name="l0"/><link name="l1"/><xacro:joint_of length="${2 * 0.25}"/></robot>"""
MACRO = """<robot xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:macro name="joint_of" params="length"><joint name="j" type="continuous">
<origin xyz="${length} 0 0"/><axis xyz="0 0 1"/><parent link="l0"/><child link="l1"/></joint>
</xacro:macro></robot>"""


def test_xacro_is_expanded(tmp_path: Path) -> None:
    pytest.importorskip("xacro")
    folder = tmp_path / "arm_description" / "urdf"
    folder.mkdir(parents=True)
    (folder / "joint.xacro").write_text(MACRO)
    path = folder / "arm.urdf.xacro"
    path.write_text(XACRO)
    robot = mo.load_robot(path)
    assert np.array(mo.forward_kinematics(robot)([0.0]))[:3, 3].tolist() == [0.5, 0.0, 0.0]
    path.write_text(XACRO.replace("arm_description", "renamed"))
    assert mo.load_robot(path) == robot
    path.write_text(XACRO.replace("joint.xacro", "none.xacro").replace("arm_d", "d"))
    with refused("arm.urdf.xacro", "none.xacro", "'description'"):
        mo.load_robot(path)


def test_a_warning_points_at_who_asked_for_the_file(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(chain(revolute(more="")))
    with pytest.warns(RobotFileWarning) as caught:
        mo.load_robot(path)
    assert [w.filename for w in caught] == [__file__]


def test_missing_xacro_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "arm.xacro"
    path.write_text(XACRO)
    monkeypatch.setitem(sys.modules, "xacro", None)
    with refused("xacro:", "pip install 'microbot_ocp[urdf]'"):
        mo.load_robot(path)


def full_robot(name: str) -> mo.Robot:
    """The robot with friction, one-sided limits, and a base of its own."""
    robot = any_robot(name)
    links = [replace(link, viscous_friction=0.3, coulomb_friction=0.2) for link in robot.links]
    lower = [-1.0 - 0.1 * i for i in range(robot.joint_count)]
    limits = mo.Limits(
        q_min=lower, q_max=2.0, qd_max=(-1.0, 2.0), qdd_max=5.0, tau_max=(lower, 3.0), taud_max=7.0
    )
    return robot.with_links(links).with_limits(limits)


def test_rows_of_axes_nearly_parallel_survive_every_file() -> None:
    robot = parse_urdf(chain(revolute(), revolute("1 1 0", "3.14159 0.001 0")))
    assert robot.beta.any()
    assert parse_robot(robot_to_toml(robot)) == robot
    copy = parse_urdf(robot_to_urdf(robot))
    q, *_ = random_states(robot, 20)
    poses = [batch(mo.forward_kinematics(each), q) for each in (robot, copy)]
    assert difference(*poses) < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize(("name", "full"), crossed([*WRITTEN, *RANDOM_CHAINS], [False, True]))
def test_written_urdf_is_the_same_robot(tmp_path: Path, name: str, full: bool) -> None:
    robot = full_robot(name) if full else any_robot(name)
    path = tmp_path / "copy.urdf"
    mo.save_robot(robot, path)
    copy = mo.load_robot(path)
    assert (copy.name, copy.joint_types, copy.joint_names, copy.description) == (
        *(robot.name, robot.joint_types, robot.joint_names),
        robot.description,
    )
    assert np.array_equal(copy.gravity, robot.gravity)
    for bound, values in robot.limits.as_dict().items():
        assert getattr(copy.limits, bound).tolist() == values, bound
    for theirs, ours in zip(copy.links, robot.links, strict=True):
        assert theirs.mass == ours.mass
        for kind in ("armature", "viscous_friction", "coulomb_friction"):
            assert getattr(theirs, kind) == getattr(ours, kind)
    q, qd, qdd = random_states(robot, 100)
    for make, states in (
        (mo.forward_kinematics, (q,)),
        (mo.jacobian, (q,)),
        (mo.mass_matrix, (q,)),
        (mo.gravity_torque, (q,)),
        (mo.inverse_dynamics, (q, qd, qdd)),
    ):
        assert difference(batch(make(copy), *states), batch(make(robot), *states)) < 1e-12


@pytest.mark.parametrize("name", [n for n in WRITTEN if n != "microbot"])
def test_written_urdf_is_what_pinocchio_reads(name: str) -> None:
    robot = mo.load_robot(name)
    model = pin.buildModelFromXML(robot_to_urdf(robot))
    model.gravity.linear = robot.gravity
    model.armature = np.array([link.armature for link in robot.links])
    data = model.createData()
    q, qd, qdd = random_states(robot, 50)
    bare = [replace(link, viscous_friction=0.0, coulomb_friction=0.0) for link in robot.links]
    tau = [pin.rnea(model, data, *state).copy() for state in zip(q, qd, qdd, strict=True)]
    ours = batch(mo.inverse_dynamics(robot.with_links(bare)), q, qd, qdd)
    assert difference(ours, tau) < 1e-12
    assert list(model.names)[1:] == list(robot.joint_names)
    if name != "planar_2r":
        assert model.upperPositionLimit == pytest.approx(robot.limits.q_max, abs=1e-15)


def test_robot_without_masses_is_written_without(tmp_path: Path) -> None:
    robot = mo.Robot.from_dh(
        [0.0, 0.4], [0.0, 1.0], [0.2, 0.0], joint_type=["prismatic", "revolute"]
    )
    path = tmp_path / "bare.urdf"
    mo.save_robot(robot, path)
    assert "inertial" not in path.read_text()
    copy = mo.load_robot(path)
    assert not copy.has_dynamics
    assert copy.limits.q_max.tolist() == [np.inf, np.inf]


def test_names_that_collide_are_told_apart() -> None:
    links = [mo.Link(1.0, [0, 0, 0], name=name) for name in ("tool", "tool", "base_link")]
    robot = mo.Robot.from_dh(
        [0.0] * 3,
        [0.0, 1.0, 1.0],
        [0.0] * 3,
        links=links,
        joint_names=["tool_joint", "a & b", '"<'],
    )
    copy = parse_urdf(robot_to_urdf(robot))
    assert copy.joint_names == robot.joint_names
    assert copy.joint_count == 3


def test_names_that_xml_cannot_hold_are_refused() -> None:
    robot = mo.Robot.from_dh([0.0], [0.0], [0.0], name="bell \x07")
    with refused("bell", "XML", "line 1"):
        robot_to_urdf(robot)


def test_urdf_goes_to_a_file_of_its_ending(tmp_path: Path, microbot: mo.Robot) -> None:
    with refused("path", ".toml or .urdf", "arm.xml"):
        mo.save_robot(microbot, tmp_path / "arm.xml")
    with refused("arm.urdf", "folder"):
        mo.save_robot(microbot, tmp_path / "none" / "arm.urdf")


def test_limits_of_zero_are_not_stated() -> None:
    more = '<limit lower="-3" upper="3" effort="0" velocity="-0.0" drake:acceleration="0"/>'
    keys = ("effort", "velocity", "drake:acceleration")
    named = [f"{key} of joint 'j1'" for key in keys]
    with warned("arm.urdf", "0", *named, category=RobotFileWarning):
        robot = parse_urdf(chain(revolute(more=more), revolute()), "arm.urdf")
    assert robot.limits.tau_max.tolist() == [np.inf, 10.0]
    assert robot.limits.qd_max.tolist() == [np.inf, 2.0]
    assert robot.limits.qdd_max.tolist() == [np.inf, np.inf]


def test_accelerations_are_read_and_written_as_drake_has_them() -> None:
    more = LIMIT.replace("/>", ' drake:acceleration="2.5"/>')
    robot = parse_urdf(chain(revolute(more=more)), "arm.urdf")
    assert robot.limits.qdd_max.tolist() == [2.5]
    text = robot_to_urdf(robot)
    assert 'drake:acceleration="2.5"' in text
    assert "qdd_max" not in text
    assert parse_urdf(text) == robot


def test_a_locked_joint_is_written_as_one() -> None:
    robot = parse_urdf(chain(revolute())).with_limits(qd_max=0.0)
    assert parse_urdf(robot_to_urdf(robot)) == robot


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, ("any joint", "rotor inertia", "acceleration")),
        ({"tau_max": np.inf}, ("no limit", "torque", "jerk")),
        ({"qdd_max": [9.0, np.inf]}, ("j2", "rotor inertia")),
        ({"qdd_max": 9.0}, ()),
        ({"qddd_max": 9.0}, ()),
        ({"taud_max": 9.0}, ()),
    ],
)
def test_what_the_drives_lack_is_said(changes: dict[str, object], said: tuple[str, ...]) -> None:
    robot = parse_urdf(chain(revolute(), revolute(xyz="0.5 0 0"))).with_limits(**changes)
    advice = mo.robot.drive_advice(robot, [[30.0, 20.0]])
    assert bool(said) == bool(advice)
    tells(advice, *said)
    with_rotors = robot.with_links([replace(link, armature=0.1) for link in robot.links])
    asked = not said or "rotor inertia" in said
    assert asked == (mo.robot.drive_advice(with_rotors) == "")


@pytest.mark.thorough
def test_show_and_the_note_of_a_motion_say_what_drives_lack(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(chain(revolute(), revolute(xyz="0.5 0 0")))
    assert main(["show", str(path)]) == 0
    tells(" ".join(capsys.readouterr().out.split()), "any joint", "rotor inertia")
    robot = mo.load_robot(path)
    for motion in (
        mo.time_optimal(robot, [[0, 0], [1, 1]], mesh=10, starts=1),
        mo.time_optimal_path(robot, mo.cubic([[0, 0], [1, 1]], [0.0, 1.0])),
    ):
        peak = np.abs(motion.qdd).max()
        tells(motion.note, f"{peak:.5g} rad/s^2", "any joint")
    bounded = robot.with_limits(qdd_max=9.0)
    assert "reaches" not in mo.time_optimal(bounded, [[0, 0], [1, 1]], mesh=10, starts=1).note


SRDF = """<robot name='r'>
<group name='arm'><chain base_link='l0' tip_link='l3'/></group>
<group name='hand'><link name='l4'/></group>
<group_state name='home' group='arm'><joint name='j1' value='0.5'/><joint name='j2' value='1'/>
<joint name='j3' value='-1'/><joint name='j4' value='9'/></group_state>
<group_state name='open' group='hand'><joint name='j4' value='0.1'/></group_state>
<disable_collisions link1='l2' link2='l0' reason='Never'/>
<disable_collisions link1='l2' link2='other'/>
</robot>"""


def test_what_an_srdf_says_is_read_and_written(tmp_path: Path) -> None:
    path, elsewhere = tmp_path / "arm.urdf", tmp_path / "moveit.srdf"
    path.write_text(chain(*[revolute("0 0 1")] * 4))
    elsewhere.write_text(SRDF)
    plain = mo.robot.load_urdf(path)
    assert (plain.joint_count, plain.disabled_pairs, plain.named_poses) == (4, None, {})
    with warned("arm.urdf", "SRDF", "'other'", category=RobotFileWarning):
        robot = mo.robot.load_urdf(path, srdf=elsewhere)
    assert robot.joint_names == ("j1", "j2", "j3")
    assert robot.disabled_pairs == (("l0", "l2"),)
    assert {name: q.tolist() for name, q in robot.named_poses.items()} == {"home": [0.5, 1.0, -1.0]}
    mo.save_robot(robot, tmp_path / "arm.toml")
    copy = mo.load_robot(tmp_path / "arm.toml")
    assert copy == robot
    assert copy.named_poses["home"].tolist() == [0.5, 1.0, -1.0]
    assert robot != replace(robot, disabled_pairs=None)
    elsewhere.rename(tmp_path / "arm.srdf")
    with pytest.warns(RobotFileWarning):
        assert mo.load_robot(path) == robot
    with pytest.warns(RobotFileWarning):
        assert mo.load_robot(path, "arm") == robot
    with pytest.warns(RobotFileWarning):
        assert mo.load_robot(path, "l4").joint_count == 4


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("value='0.5'", "value='x'", ("value", "joint 'j1'", "'home'", "number", "'x'")),
        ("link2='l0'", "", ("<disable_collisions>", "link2")),
        ("<robot name='r'>", "<sdf>", ("arm.srdf:", "valid XML", "line")),
    ],
)
def test_a_wrong_srdf_is_refused(
    tmp_path: Path, old: str, new: str, message: tuple[str, ...]
) -> None:
    (tmp_path / "arm.urdf").write_text(chain(revolute()))
    (tmp_path / "arm.srdf").write_text(SRDF.replace(old, new))
    with refused(*message):
        mo.load_robot(tmp_path / "arm.urdf")
