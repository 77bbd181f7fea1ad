"""Tables of the standard (distal) convention against published figures and an own product."""

from __future__ import annotations

import warnings
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import microbot_ocp as mo
from helpers import refused, tells
from microbot_ocp import Link
from microbot_ocp.robot import Rotor, Shape
from microbot_ocp.robot.files import parse_robot

# P. Corke, Robotics Toolbox, models/mdl_puma560.m: standard DH, figures in distal frames.
ALPHA = np.pi / 2 * np.array([1, 0, -1, 1, -1, 0])
A = np.array([0, 0.4318, 0.0203, 0, 0, 0])
D = np.array([0, 0, 0.15005, 0.4318, 0, 0])
MASS = [0, 17.4, 4.8, 0.82, 0.34, 0.09]
CENTER = [
    [0, 0, 0],
    [-0.3638, 0.006, 0.2275],
    [-0.0203, -0.0141, 0.070],
    [0, 0.019, 0],
    [0, 0, 0],
    [0, 0, 0.032],
]
INERTIA = [
    [0, 0.35, 0],
    [0.13, 0.524, 0.539],
    [0.066, 0.086, 0.0125],
    [1.8e-3, 1.3e-3, 1.8e-3],
    [0.3e-3, 0.4e-3, 0.3e-3],
    [0.15e-3, 0.15e-3, 0.04e-3],
]
MOTOR = [200e-6, 200e-6, 200e-6, 33e-6, 33e-6, 33e-6]
GEAR = [-62.6111, 107.815, -53.7063, 76.0364, 71.923, 76.686]
NOMINAL = np.array([0, np.pi / 4, np.pi, 0, np.pi / 4, 0])


def puma() -> mo.Robot:
    links = [
        Link(m, r, np.diag(moments), jm * g**2, allow_unphysical=True)
        for m, r, moments, jm, g in zip(MASS, CENTER, INERTIA, MOTOR, GEAR, strict=True)
    ]
    return mo.Robot.from_dh(ALPHA, A, D, links=links, name="puma", convention="standard")


def standard_row(alpha: float, a: float, d: float, theta: float) -> np.ndarray:
    """Spong, Hutchinson and Vidyasagar, Robot Modeling and Control, equation 3.10."""
    ca_, sa, ct, st = np.cos(alpha), np.sin(alpha), np.cos(theta), np.sin(theta)
    return np.array(
        [
            [ct, -st * ca_, st * sa, a * ct],
            [st, ct * ca_, -ct * sa, a * st],
            [0, sa, ca_, d],
            [0, 0, 0, 1],
        ]
    )


def test_puma_has_the_published_torques_and_mass_matrix() -> None:
    """Those in the tests of Corke's toolbox for Python (tests/test_DHRobot.py), to their digits."""
    robot = puma()
    published = np.array(
        [
            [3.6594, -0.4044, 0.1006, -0.0025, 0, 0],
            [-0.4044, 4.4137, 0.3509, 0, 0.0024, 0],
            [0.1006, 0.3509, 0.9378, 0, 0.0015, 0],
            [-0.0025, 0, 0, 0.1925, 0, 0],
            [0, 0.0024, 0.0015, 0, 0.1713, 0],
            [0, 0, 0, 0, 0, 0.1941],
        ]
    )
    assert np.array(mo.mass_matrix(robot)(NOMINAL)) == pytest.approx(published, abs=5.1e-5)
    still = mo.inverse_dynamics(robot)(NOMINAL, np.zeros(6), np.zeros(6))
    assert np.array(still).ravel() == pytest.approx([0, 31.6399, 6.0351, 0, 0.0283, 0], abs=5.1e-5)
    qdd = [1, 2, 3, 1, 2, 3]
    inertial = np.array(mo.mass_matrix(robot)(NOMINAL)) @ qdd
    assert inertial == pytest.approx([3.15, 9.4805, 3.6189, 0.1901, 0.3519, 0.5823], abs=5.1e-5)


def test_tool_and_shapes_are_at_the_far_ends() -> None:
    rng = np.random.default_rng(2)
    alpha, a, d, offset, q = rng.uniform(-2, 2, (5, 4))
    tool = standard_row(0.3, 0.2, 0.1, 0.4)
    pose = standard_row(0.1, 0.5, -0.2, 1.0)
    shapes = [Shape(k, pose, "sphere", np.array([0.1])) for k in (0, 2, 4)]
    kinds = ["revolute", "prismatic", "revolute", "revolute"]
    robot = mo.Robot.from_dh(
        *(alpha, a, d, offset),
        joint_type=kinds,
        tool=tool,
        shapes=shapes,
        convention="standard",
    )
    frames = [np.eye(4)]
    for k, kind in enumerate(kinds):
        slide = q[k] if kind == "prismatic" else 0.0
        turn = 0.0 if kind == "prismatic" else q[k]
        row = standard_row(alpha[k], a[k], d[k] + slide, offset[k] + turn)
        frames.append(frames[-1] @ row)
    ours = np.hsplit(np.array(mo.robot.link_poses(robot)(q)), 5)
    reached = np.array(mo.forward_kinematics(robot)(q))
    assert reached == pytest.approx(frames[-1] @ tool, abs=1e-14)
    for shape, k in zip(robot.shapes, (0, 2, 4), strict=True):
        assert ours[shape.frame] @ shape.pose == pytest.approx(frames[k] @ pose, abs=1e-14)


def test_a_rotor_keeps_its_axis_in_space() -> None:
    """An axis along that of joint 2 seen from the far end of link 1 is the joint's own Z there."""
    links = [
        Link(1.0),
        Link(1.0, rotor=Rotor(0.1, 50.0, axis=np.array([0.0, 0.0, 1.0]), carrier=1)),
    ]
    robot = mo.Robot.from_dh([np.pi / 2, 0], [0.3, 0.4], [0, 0], links=links, convention="standard")
    ((_, rotor, _),) = robot.rotors
    (_, alpha) = robot.alpha
    assert rotor.axis == pytest.approx([0, -np.sin(alpha), np.cos(alpha)], abs=1e-15)


def test_a_file_may_have_either_convention(tmp_path: Path) -> None:
    rows = "".join(
        f"[[joint]]\nalpha = {alpha!r}\na = {a}\nd = {d}\nmass = {m}\ncenter_of_mass = {list(r)}\n"
        f"inertia = {np.diag(moments).tolist()}\narmature = {jm * g**2!r}\n"
        "allow_unphysical = true\n"
        for alpha, a, d, m, r, moments, jm, g in zip(
            ALPHA.tolist(), A, D, MASS, CENTER, INERTIA, MOTOR, GEAR, strict=True
        )
    )
    robot = parse_robot(f'name = "puma"\nconvention = "standard"\n{rows}')
    same = [mo.inverse_dynamics(arm)(NOMINAL, NOMINAL, NOMINAL) for arm in (robot, puma())]
    assert float(ca.norm_inf(same[0] - same[1])) == 0.0
    with refused("convention", "modified, standard", "'craig'"):
        parse_robot(f'convention = "craig"\n{rows}')
    mo.save_robot(robot, tmp_path / "puma.toml")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert mo.load_robot(tmp_path / "puma.toml") == robot


@pytest.mark.parametrize(
    ("alpha", "a", "convention", "says"),
    [
        (ALPHA, A, None, ("joints 5 and 6", "alpha 90 deg, a 0 m", "convention='standard'")),
        ([0, 0], [1, 1], None, ("alpha 0 deg, a 1 m", "convention='standard'")),
        ([np.pi / 2, np.pi], [0, 0.4], None, ("alpha 90 deg, a 0 m", "convention='standard'")),
        ([0, -np.pi / 2, 0], [0, 0, 0.4], "standard", ("joints 1 and 2", "convention='modified'")),
    ],
)
def test_a_table_of_the_other_convention_is_recognised(
    alpha: list[float], a: list[float], convention: str | None, says: tuple[str, ...]
) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        mo.Robot.from_dh(alpha, a, np.zeros(len(a)), convention=convention)  # type: ignore[arg-type]
    assert caught[0].category is UserWarning
    tells(str(caught[0].message), *says)
    assert caught[0].filename == __file__


@pytest.mark.parametrize("name", mo.packaged_robots())
def test_tables_as_they_should_be_raise_no_doubt(name: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        arm = mo.load_robot(name)
        mo.Robot.from_dh(arm.alpha, arm.a, arm.d, joint_type=arm.joint_types)
        mo.Robot.from_dh(ALPHA, A, D, convention="modified")
        puma()


def test_a_first_row_that_places_the_base_is_not_odd() -> None:
    """Of Craig's tables with any twists, and of parallel last axes where something follows."""
    rng = np.random.default_rng(0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for count in rng.integers(2, 8, 50):
            mo.Robot.from_dh(*rng.uniform(-2.0, 2.0, (3, count)))
        mo.Robot.from_dh([0, 0], [1, 1], [0, 0], tool=[0, 0.3, 0, 0])
        mo.Robot.from_dh([0, 0], [1, 1], [0, 0], base=np.eye(4))


def test_standard_rows_have_no_turn_about_y() -> None:
    with refused("beta", "modified", "convention='standard'"):
        mo.Robot.from_dh([1.0, 0], [0, 1], [0, 0], beta=[0.1, 0], convention="standard")


def test_printing_a_robot_shows_its_table(microbot: mo.Robot) -> None:
    text = str(microbot)
    tells(text, "Modified DH", "Craig")
    assert text.count("\n") >= microbot.joint_count
    assert all(name in text for name in microbot.joint_names)
    assert repr(microbot) == "<Robot 'microbot': 3 joints>"
