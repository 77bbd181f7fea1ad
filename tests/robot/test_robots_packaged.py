"""The packaged robots: where their figures come from, what the sources say, base frames, TOML."""

from __future__ import annotations

import re
import tomllib
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, strategies as st

import microbot_ocp as mo
from helpers import (
    RANDOM_CHAINS,
    any_robot,
    batch,
    difference,
    random_robot,
    random_states,
    refused,
    sampled,
)
from microbot_ocp.robot import dh_transform
from microbot_ocp.robot.files import parse_robot, robot_to_toml

FOLDER = Path(mo.__file__).parent / "robot" / "packaged"
NEW = [name for name in mo.packaged_robots() if name != "microbot"]

# Standard DH rows of the sources: theta offset, d, a, alpha; q adds to theta, or to d where marked.
STANDARD = {
    "puma560": [
        (0.0, 26.45 * 0.0254, 0.0, np.pi / 2),
        (0.0, 0.0, 0.4318, 0.0),
        (0.0, 0.15005, 0.0203, -np.pi / 2),
        (0.0, 0.4318, 0.0, np.pi / 2),
        (0.0, 0.0, 0.0, -np.pi / 2),
        (0.0, 0.0, 0.0, 0.0),
    ],
    "stanford": [
        (0.0, 0.412, 0.0, -np.pi / 2),
        (0.0, 0.154, 0.0, np.pi / 2),
        (-np.pi / 2, "q", 0.0, 0.0),
        (0.0, 0.0, 0.0, -np.pi / 2),
        (0.0, 0.0, 0.0, np.pi / 2),
        (0.0, 0.263, 0.0, 0.0),
    ],
    "ur5e": [
        (0.0, 0.1625, 0.0, np.pi / 2),
        (0.0, 0.0, -0.425, 0.0),
        (0.0, 0.0, -0.3922, 0.0),
        (0.0, 0.1333, 0.0, np.pi / 2),
        (0.0, 0.0997, 0.0, -np.pi / 2),
        (0.0, 0.0996, 0.0, 0.0),
    ],
}


def standard_frames(name: str, q: np.ndarray) -> list[np.ndarray]:
    """Frames [4,4] at the far ends of the links: Rz(theta) Tz(d) Tx(a) Rx(alpha), row by row."""
    frame, frames = np.eye(4), []
    for (offset, d, a, alpha), position in zip(STANDARD[name], q, strict=True):
        turn, slide = (offset, position) if d == "q" else (offset + position, d)
        frame = frame @ dh_transform(0.0, 0.0, float(slide), turn)
        frame = frame @ dh_transform(alpha, a, 0.0, 0.0)
        frames.append(frame)
    return frames


@pytest.mark.parametrize("name", STANDARD)
def test_modified_rows_move_the_hand_as_the_standard_rows_of_the_source(name: str) -> None:
    robot = mo.load_robot(name)
    q, *_ = random_states(robot, 50)
    expected = [standard_frames(name, row)[-1] for row in q]
    assert difference(batch(mo.forward_kinematics(robot), q), expected) < 1e-14


# Of links in their standard frames: mass, centre of mass; as the sources print them.
PUMA_CENTERS = [
    (17.4, [-0.3638, 0.006, 0.2275]),
    (4.8, [-0.0203, -0.0141, 0.070]),
    (0.82, [0.0, 0.019, 0.0]),
    (0.34, [0.0, 0.0, 0.0]),
    (0.09, [0.0, 0.0, 0.032]),
]
UR5E_CENTERS = [  # X, Y, Z of the maker's table
    (3.761, [0.0, -0.02561, 0.00193]),
    (8.058, [0.2125, 0.0, 0.11336]),
    (2.846, [0.15, 0.0, 0.0265]),
    (1.37, [0.0, -0.0018, 0.01634]),
    (1.3, [0.0, 0.0018, 0.01634]),
    (0.365, [0.0, 0.0, -0.001159]),
]


@pytest.mark.parametrize(
    ("name", "first", "centers"), [("puma560", 1, PUMA_CENTERS), ("ur5e", 0, UR5E_CENTERS)]
)
def test_centers_of_mass_are_where_the_source_puts_them(
    name: str, first: int, centers: list[tuple[float, list[float]]]
) -> None:
    robot = mo.load_robot(name)
    q = np.linspace(-1.0, 2.0, robot.joint_count)
    standard = standard_frames(name, q)
    for i, (mass, center) in enumerate(centers, start=first):
        link = robot.links[i]
        assert link.mass == mass
        ours = np.array(mo.forward_kinematics(robot, i + 1)(q)) @ [*link.center_of_mass, 1.0]
        assert ours == pytest.approx(standard[i] @ [*center, 1.0], abs=1e-14)


def test_puma_masses_that_no_torque_depends_on() -> None:
    """Link 1 may weigh anything on its axis, and links 2 and 3 share the inertia across theirs."""
    puma = mo.load_robot("puma560")
    links = list(puma.links)
    links[0] = mo.Link(50.0, [0, 0, 0.3], np.diag([3.0, 3.0, 0.35]))
    links[0] = replace(links[0], armature=puma.links[0].armature)
    across = 0.003 * np.diag([1.0, 1.0, 0.0])
    links[1] = replace(links[1], inertia=links[1].inertia - across)
    links[2] = replace(links[2], inertia=links[2].inertia + across)
    links = [replace(link, viscous_friction=0.0, coulomb_friction=0.0) for link in links]
    bare = [replace(link, viscous_friction=0.0, coulomb_friction=0.0) for link in puma.links]
    states = random_states(puma, 200)
    ours, theirs = (
        batch(mo.inverse_dynamics(puma.with_links(each)), *states) for each in (bare, links)
    )
    assert difference(ours, theirs) < 1e-13


@pytest.mark.parametrize("name", mo.packaged_robots())
def test_every_figure_has_a_source(name: str) -> None:
    """A joint's figures are spoken for in [sources], or beside them by the words "chosen here"."""
    text = (FOLDER / f"{name}.toml").read_text("utf-8")
    data = tomllib.loads(text)
    sources = data["sources"]
    assert all(isinstance(entry, str) and entry.strip() for entry in sources.values())
    spoken_for = {
        "dh": ("alpha", "a", "d", "theta_offset"),
        "masses": ("mass", "center_of_mass", "inertia"),
        "center_of_mass": ("center_of_mass",),
        "inertia": ("inertia",),
        "armature": ("armature",),
        "rotor": ("rotor",),
        "friction": ("viscous_friction", "coulomb_friction"),
        "viscous_friction": ("viscous_friction",),
        "coulomb_friction": ("coulomb_friction",),
        "position_limits": ("q_min", "q_max"),
        "velocity_limits": ("qd_max",),
        "acceleration_limits": ("qdd_max",),
        "torque_limits": ("tau_max",),
        "torque_rate_limits": ("taud_max",),
        "gravity": (),
        "tool": (),
    }
    assert set(sources) <= set(spoken_for)
    covered = {key for source in sources for key in spoken_for[source]}
    used = {key.removesuffix("_deg") for joint in data["joint"] for key in joint}
    assert used - {"name", "type"} <= covered
    assert "gravity" in sources or re.search(r"^gravity = .* # .*(standard|Craig)", text, re.M)


@pytest.mark.parametrize("name", NEW)
def test_packaged_robots_can_hold_themselves_up_anywhere(name: str) -> None:
    robot = mo.load_robot(name)
    limits = robot.limits
    rng = np.random.default_rng(3)
    assert np.isfinite(limits.tau_max).all()
    q = rng.uniform(limits.q_min, limits.q_max, (2000, robot.joint_count))
    held = np.abs(batch(mo.gravity_torque(robot), q)).max(axis=0)
    assert (held < 0.75 * limits.tau_max).all()
    assert batch(mo.robot.mass_matrix_condition(robot), q).max() < 1e3


def test_kinds_of_packaged_robots() -> None:
    kinds = {
        name: "".join(kind[0] for kind in mo.load_robot(name).joint_types)
        for name in mo.packaged_robots()
    }
    assert kinds == {
        "manutec_r3": "rrr",
        "microbot": "rrr",
        "panda": "rrrrrrr",
        "planar_2r": "rr",
        "planar_3r": "rrr",
        "puma560": "rrrrrr",
        "stanford": "rrprrr",
        "ur5e": "rrrrrr",
    }


def test_planar_arm_is_the_closed_form_of_the_textbook() -> None:
    """Craig, equation 6.58: point masses at the ends of two links."""
    robot = mo.load_robot("planar_2r")
    q, qd, qdd = random_states(robot, 50)
    l1 = l2 = 0.5
    m1, m2, g = 4.6, 2.3, 9.8
    (q1, q2), (d1, d2), (a1, a2) = q.T, qd.T, qdd.T
    c1, c2, s2, c12 = np.cos(q1), np.cos(q2), np.sin(q2), np.cos(q1 + q2)
    tau1 = (
        m2 * l2**2 * (a1 + a2)
        + m2 * l1 * l2 * c2 * (2 * a1 + a2)
        + (m1 + m2) * l1**2 * a1
        - m2 * l1 * l2 * s2 * d2**2
        - 2 * m2 * l1 * l2 * s2 * d1 * d2
        + m2 * l2 * g * c12
        + (m1 + m2) * l1 * g * c1
    )
    tau2 = (
        m2 * l1 * l2 * c2 * a1
        + m2 * l1 * l2 * s2 * d1**2
        + m2 * l2 * g * c12
        + m2 * l2**2 * (a1 + a2)
    )
    ours = batch(mo.inverse_dynamics(robot), q, qd, qdd)
    assert difference(ours, np.column_stack([tau1, tau2])) < 1e-14


def test_friction_is_the_documented_formula() -> None:
    robot = mo.load_robot("panda")
    q, qd, qdd = random_states(robot, 50)
    qd *= 0.01
    bare = [replace(link, viscous_friction=0.0, coulomb_friction=0.0) for link in robot.links]
    both = (batch(mo.inverse_dynamics(r), q, qd, qdd) for r in (robot, robot.with_links(bare)))
    rubbed, free = both
    assert difference(rubbed - free, 0.003 * qd + 0.2 * np.tanh(qd / 0.01)) < 1e-13


# --- base -----------------------------------------------------------------------------------------

PLACEMENT = dh_transform(0.7, 0.3, -0.4, 1.1)


def moved(robot: mo.Robot) -> mo.Robot:
    return replace(robot, base=PLACEMENT)


@pytest.mark.slow
@pytest.mark.parametrize("name", sampled(["microbot", "panda", *RANDOM_CHAINS], 2))
def test_base_moves_poses_and_turns_gravity(name: str) -> None:
    """On a base, a robot is itself seen from a frame moved the other way."""
    plain, based = any_robot(name), moved(any_robot(name))
    turn = PLACEMENT[:3, :3]
    alike = plain.with_gravity(turn.T @ plain.gravity)  # the same gravity, seen from frame 0
    q, qd, qdd = random_states(plain, 30)
    for frame in (1, plain.joint_count, None):
        poses = batch(mo.forward_kinematics(plain, frame), q)
        ours = batch(mo.forward_kinematics(based, frame), q)
        assert difference(ours, PLACEMENT @ poses) < 1e-13
    assert np.array_equal(np.array(mo.forward_kinematics(based, 0)(q[0])), np.eye(4))
    slopes = batch(mo.jacobian(plain), q)
    turned = np.concatenate([turn @ slopes[:, :3], turn @ slopes[:, 3:]], axis=1)
    assert difference(batch(mo.jacobian(based), q), turned) < 1e-13
    origins = batch(mo.robot.frame_origins(plain), q)
    placed = np.einsum("ij,kjl->kil", turn, origins) + PLACEMENT[:3, 3:]
    placed[:, :, 0] = 0.0  # the base frame itself
    assert difference(batch(mo.robot.frame_origins(based), q), placed) < 1e-13
    states = (q, qd, qdd)
    for make, count in (
        (mo.inverse_dynamics, 3),
        (mo.gravity_torque, 1),
        (mo.bias_torque, 2),
        (mo.mass_matrix, 1),
    ):
        ours, theirs = (batch(make(robot), *states[:count]) for robot in (based, alike))
        assert difference(ours, theirs) < 1e-12
    for one, other in zip(
        mo.velocity_propagation(based)(q[0], qd[0]),
        mo.velocity_propagation(plain)(q[0], qd[0]),
        strict=True,
    ):
        assert np.array_equal(np.array(one), np.array(other))


@pytest.mark.parametrize("name", ["microbot", "puma560", "rrrprrr"])
def test_gravity_on_a_base_is_the_slope_of_the_potential(name: str) -> None:
    robot = moved(any_robot(name))
    q = ca.SX.sym("q", robot.joint_count)
    potential = mo.energy(robot)(q, ca.SX(robot.joint_count, 1))[1]
    slope = ca.Function("slope", [q], [ca.gradient(potential, q)])
    states, *_ = random_states(robot, 50)
    assert difference(batch(mo.gravity_torque(robot), states), batch(slope, states)) < 1e-13


def test_base_is_part_of_what_makes_robots_equal(microbot: mo.Robot) -> None:
    assert moved(microbot) != microbot
    assert replace(microbot, base=np.eye(4)) == microbot
    table = {"alpha": [0.0], "a": [0.0], "d": [0.0]}
    assert mo.Robot.from_dh(**table, base=(0.0, 1.0, 0.0, 0.0)).base[0, 3] == 1.0
    with refused("base", "homogeneous", "0 0 0 1", "2.0]]"):
        mo.Robot.from_dh(**table, base=2 * np.eye(4))
    with refused("base", "shape [4, 4]", "not [3, 3]"):
        mo.Robot.from_dh(**table, base=np.eye(3))


# --- TOML -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [*mo.packaged_robots(), *RANDOM_CHAINS])
def test_written_toml_is_the_same_robot(tmp_path: Path, name: str) -> None:
    for robot in (any_robot(name), moved(any_robot(name))):
        path = tmp_path / "copy.toml"
        mo.save_robot(robot, path)
        copy = mo.load_robot(path)
        assert copy == robot
        assert copy.description == robot.description
        assert [link.mass for link in copy.links] == [link.mass for link in robot.links]


AWKWARD = st.floats(-1e6, 1e6)
ANGLE = st.floats(-2.0 * np.pi, 2.0 * np.pi)
BOUND = st.one_of(st.just(np.inf), st.floats(0.0, 1e300))


@pytest.mark.slow
@given(
    rows=st.lists(st.tuples(ANGLE, AWKWARD, AWKWARD, ANGLE), min_size=3, max_size=3),
    bounds=st.lists(st.tuples(BOUND, BOUND), min_size=3, max_size=3),
    names=st.lists(
        st.text(st.characters(codec="utf-8"), min_size=1), min_size=3, max_size=3, unique=True
    ),
)
def test_any_robot_survives_a_toml_file_to_the_last_bit(
    rows: list[tuple[float, ...]], bounds: list[tuple[float, float]], names: list[str]
) -> None:
    alpha, a, d, theta = np.array(rows).T
    lower, upper = [-low for low, _ in bounds], [high for _, high in bounds]
    robot = mo.Robot.from_dh(
        *(alpha, a, d, theta),
        limits=mo.Limits(
            q_min=lower, q_max=upper, qd_max=upper, tau_max=(lower, upper), taud_max=(lower, 0.0)
        ),
        joint_names=names,
        name="".join(names),
        description='a "quote", a \\, a tab\t, a line\nand \x7f',
        gravity=(0.1, -0.0, 1e-300),
        tool=dh_transform(*rows[0]),
        base=dh_transform(*rows[1]),
    )
    copy = parse_robot(robot_to_toml(robot))
    assert copy == robot
    assert (copy.name, copy.description) == (robot.name, robot.description)


def test_toml_goes_to_a_file_of_its_ending(tmp_path: Path, microbot: mo.Robot) -> None:
    with refused("path", ".toml or .urdf", "arm.txt"):
        mo.save_robot(microbot, tmp_path / "arm.txt")
    with refused("arm.toml", "folder"):
        mo.save_robot(microbot, tmp_path / "none" / "arm.toml")


def test_base_is_read_from_a_table() -> None:
    joint = "[[joint]]\nalpha = 0.0\na = 1.0\nd = 0.0\n"
    assert parse_robot(joint + "[base]\nd = 0.5").base[2, 3] == 0.5
    for text, parts in (
        ("base = 3\n" + joint, ("base", "table", "not 3")),
        (joint + "[base]\nlength = 1.0", ("'length'", "base", "theta")),
        (joint + "[base]\nmatrix = [[1]]\na = 2.0", ("base", "matrix", "DH row")),
        (joint + "[base]\nmatrix = [[1, 0], [0, 1]]", ("base", "shape [4, 4]", "[2, 2]")),
    ):
        with refused("arm.toml: ", *parts):
            parse_robot(text, "arm.toml")


def test_table_with_rows_of_different_length_is_refused() -> None:
    with refused("DH columns", "alpha has 2 rows", "d has 3"):
        mo.Robot.from_dh([0.0, 0.0], [0.0, 0.0], [0.0, 0.0, 0.0])
    random = random_robot("rr")
    with refused("links", "1 entries", "2 joints"):
        random.with_links(random.links[:1])
