"""Joints that follow others, against pinocchio: its mimic joints, and independent ones together."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import numpy as np
import pytest

import microbot_ocp as mo
from helpers import batch, difference, random_link, random_states, refused, sampled, warned
from microbot_ocp.robot import RobotFileWarning
from microbot_ocp.robot.files import parse_robot, parse_urdf, robot_to_toml, robot_to_urdf

pin = pytest.importorskip("pinocchio")


def urdf(*joints: str, limit: str = "lower='-2' upper='2' effort='90' velocity='2'") -> str:
    """A chain of joints, each "kind axis" and, if it mimics, "driver multiplier offset"."""
    rng = np.random.default_rng(5)
    text = ["<robot name='r'><link name='l0'/>"]
    for i, joint in enumerate(joints, start=1):
        kind, axis, *follows = joint.split()
        body, place = random_link(rng), " ".join(f"{v:.3f}" for v in rng.uniform(-0.5, 0.5, 3))
        (a, b, c), (_, d, e), (_, _, f) = body.inertia.tolist()
        center = " ".join(map(repr, body.center_of_mass.tolist()))
        direction = " ".join("1" if letter == axis else "0" for letter in "xyz")
        mimic = ""
        if follows:
            driver, factor, offset = follows
            mimic = f"<mimic joint='{driver}' multiplier='{factor}' offset='{offset}'/>"
        text.append(
            f"<link name='l{i}'><inertial><mass value='{body.mass!r}'/><origin xyz='{center}'/>"
            f"<inertia ixx='{a!r}' ixy='{b!r}' ixz='{c!r}' iyy='{d!r}' iyz='{e!r}' izz='{f!r}'/>"
            f"</inertial></link><joint name='j{i}' type='{kind}'><parent link='l{i - 1}'/>"
            f"<child link='l{i}'/><origin xyz='{place}' rpy='0.3 -0.2 {0.1 * i}'/>"
            f"<axis xyz='{direction}'/><limit {limit}/>{mimic}</joint>"
        )
    return "".join([*text, "</robot>"])


R, P = "revolute", "prismatic"
ARMS = {
    "telescope": (f"{P} z", f"{P} z j1 1 0"),
    "gripper": (f"{R} z", f"{R} y", f"{P} x", f"{P} x j3 -2 0.1"),
    "palletiser": (f"{R} z", f"{R} y", f"{R} y j2 -1 0.5", f"{R} y", f"{R} y j4 -1 0"),
    "turning slides": (f"{R} z", f"{P} x j1 0.15 0.2", f"{R} y j1 -0.5 0.1"),
    "slide turns": (f"{P} z", f"{R} x j1 3 -0.4", f"{R} y"),
    "of followers": (f"{R} z", f"{R} y j1 -0.5 0.2", f"{R} x j2 2 0.1", f"{P} z j3 0.3 0"),
    "driver outside": (f"{R} z j3 0.7 0.2", f"{R} y", f"{R} y", f"{R} x j3 -1 0"),
    "many": (*[f"{R} z", f"{R} y", f"{R} x"] * 2, f"{R} z j4 1.5 0.1", f"{R} y j6 -1 0"),
}


MIMIC_OF_PINOCCHIO = ("telescope", "gripper", "palletiser", "turning slides", "slide turns")


def selection(name: str) -> tuple[np.ndarray, np.ndarray]:
    """S [N,n] and offsets [N] of an arm, from its text alone."""
    rows = {f"j{k}": joint.split()[2:] for k, joint in enumerate(ARMS[name], start=1)}
    free = [joint for joint, follows in rows.items() if not follows]

    def row(joint: str) -> tuple[np.ndarray, float]:
        if not rows[joint]:
            return np.eye(len(free))[free.index(joint)], 0.0
        driver, factor, offset = rows[joint]
        slope, shift = row(driver)
        return float(factor) * slope, float(factor) * shift + float(offset)

    slopes, shifts = zip(*map(row, rows), strict=True)
    return np.array(slopes), np.array(shifts)


@pytest.mark.parametrize("name", ARMS)
def test_they_move_as_pinocchios_independent_joints_that_are_moved_together(name: str) -> None:
    text = urdf(*ARMS[name])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        robot = parse_urdf(text)
    model, (matrix, offsets) = pin.buildModelFromXML(text), selection(name)
    data, (q, qd, qdd) = model.createData(), random_states(robot, 20)
    frame, aligned = model.getFrameId(f"l{len(matrix)}"), pin.LOCAL_WORLD_ALIGNED
    tau, mass, poses, slopes = [], [], [], []
    for state in zip(q, qd, qdd, strict=True):
        place, *rates = (matrix @ part for part in state)
        place = place + offsets
        tau.append(matrix.T @ pin.rnea(model, data, place, *rates))
        upper = np.triu(np.reshape(pin.crba(model, data, place), (model.nv, model.nv)))
        mass.append(matrix.T @ (upper + np.triu(upper, 1).T) @ matrix)
        whole = pin.computeFrameJacobian(model, data, place, frame, aligned)
        slopes.append(np.reshape(whole, (6, -1)) @ matrix)
        pin.framesForwardKinematics(model, data, place)
        poses.append(data.oMf[frame].homogeneous.copy())
    ours = batch(mo.inverse_dynamics(robot), q, qd, qdd)
    assert difference(ours.reshape(q.shape), np.array(tau)) < 1e-12
    assert (
        difference(batch(mo.mass_matrix(robot), q).reshape(np.shape(mass)), np.array(mass)) < 1e-12
    )
    assert difference(batch(mo.forward_kinematics(robot), q), np.array(poses)) < 1e-12
    ours = batch(mo.jacobian(robot), q).reshape(np.shape(slopes))
    assert difference(ours, np.array(slopes)) < 1e-12
    if name in MIMIC_OF_PINOCCHIO:
        model = pin.buildModelFromXML(text, mimic=True)
        data, states = model.createData(), zip(q, qd, qdd, strict=True)
        assert model.nv == robot.joint_count
        torques = [pin.rnea(model, data, *state).copy() for state in states]
        assert difference(np.array(torques), np.array(tau)) < 1e-12


@pytest.mark.parametrize("name", sampled(ARMS, 2))
def test_the_rest_follows_from_the_joints_of_the_chain(name: str) -> None:
    robot = parse_urdf(urdf(*ARMS[name]))
    q, qd, qdd = random_states(robot, 10)
    selected, offsets = selection(name)
    chain, whole = robot.chain, q @ selected.T + offsets
    assert np.array_equal(robot.transmission, selected)
    assert np.allclose(robot.chain_positions(q), whole, rtol=1e-15)
    assert chain.joint_count == robot.link_count == len(ARMS[name])
    both = (robot, (q, qd)), (chain, (whole, qd @ selected.T))
    for maker in (mo.energy, mo.velocity_propagation):
        ours, theirs = (maker(arm)(*(part.T for part in state)) for arm, state in both)
        for one, other in zip(ours, theirs, strict=True):
            assert difference(np.array(one), np.array(other)) < 1e-12
    tau = batch(mo.inverse_dynamics(robot), q, qd, qdd)
    back = batch(mo.forward_dynamics(robot), q, qd, tau)
    assert difference(back.reshape(qdd.shape), qdd) < 1e-8
    coriolis = np.array(
        [mo.coriolis_matrix(robot)(*row) @ row[1] for row in zip(q, qd, strict=True)]
    )
    held = batch(mo.gravity_torque(robot), q)
    bias = batch(mo.bias_torque(robot), q, qd)
    rubbing = qd * robot.friction_of("viscous_friction") + robot.friction_of(
        "coulomb_friction"
    ) * np.tanh(qd / 0.01)
    assert (
        difference(
            np.reshape(coriolis, qd.shape) + held.reshape(qd.shape) + rubbing,
            bias.reshape(qd.shape),
        )
        < 1e-10
    )
    for frame in range(robot.link_count + 2):
        ours = batch(mo.forward_kinematics(robot, frame), q)
        assert difference(ours, batch(mo.forward_kinematics(chain, frame), whole)) < 1e-12


@pytest.mark.parametrize("name", ARMS)
def test_files_hold_joints_that_follow(name: str, tmp_path: Path) -> None:
    robot = parse_urdf(urdf(*ARMS[name]))
    assert parse_robot(robot_to_toml(robot)) == robot
    again = parse_urdf(robot_to_urdf(robot))
    assert again.joint_names == robot.joint_names
    states = random_states(robot, 5)
    ours, theirs = (batch(mo.inverse_dynamics(arm), *states) for arm in (robot, again))
    assert difference(ours, theirs) < 1e-12
    assert again.limits.q_max == pytest.approx(robot.limits.q_max, rel=1e-12)
    alone = parse_urdf(re.sub("<mimic[^>]*>", "", urdf(*ARMS[name])))
    assert alone != robot
    assert robot.chain == alone.with_limits(robot.chain.limits)


def test_the_tightest_limit_of_joints_that_move_together_holds() -> None:
    """j2 = 1 - 4 j1, j3 = 0.5 j2."""
    text = urdf(f"{R} z", f"{R} y j1 -4 1", f"{R} y j2 .5 0")
    robot = parse_urdf(text)
    assert (robot.limits.q_min[0], robot.limits.q_max[0]) == (-0.25, 0.75)
    assert robot.limits.qd_max.tolist() == [0.5]
    assert robot.limits.tau_max.tolist() == [90.0]
    assert robot.chain.limits.q_min.tolist() == [-0.25, -2.0, -1.0]
    jerk = text.replace("velocity='2'", "velocity='2' acceleration='8' jerk='20'")
    assert parse_urdf(jerk).limits.qdd_max.tolist() == [2.0]
    assert parse_urdf(jerk).limits.qddd_max.tolist() == [5.0]


def test_a_driver_off_the_way_limits_the_first_that_follows_it() -> None:
    side = (
        "<link name='s'/><joint name='drive' type='revolute'><parent link='l0'/><child link='s'/>"
    )
    side += (
        "<axis xyz='0 0 1'/><limit lower='-1' upper='3' effort='8' velocity='1'/></joint></robot>"
    )
    text = urdf(f"{R} z drive 0.5 0.25", f"{R} y drive -1 0").replace("</robot>", side)
    with warned("mimic", "'drive' at 0", category=RobotFileWarning):
        robot = parse_urdf(text, tip="l2")
    assert robot.mimic == {"j2": ("j1", -2.0, 0.5)}
    assert (robot.limits.q_min[0], robot.limits.q_max[0]) == (-0.25, 1.25)
    assert (robot.limits.qd_max[0], robot.limits.tau_max[0]) == (0.5, 16.0)


def test_friction_of_joints_that_follow_comes_to_their_drive() -> None:
    rows = [[0.0, 0.0]] * 3
    link = mo.Link(1.0, viscous_friction=2.0, coulomb_friction=3.0, armature=0.5)
    names, mimic = ["one", "two"], {"two": ("one", -3.0, 0.0)}
    robot = mo.Robot.from_dh(*rows, links=[link, link], joint_names=names, mimic=mimic)
    tau = float(mo.inverse_dynamics(robot)(0.0, 1.0, 0.0))
    assert tau == pytest.approx((1 + 9) * 2.0 + (1 + 3) * 3.0)
    assert float(mo.mass_matrix(robot)(0.0)) == pytest.approx((1 + 9) * 0.5)


@pytest.mark.parametrize(
    ("mimic", "message"),
    [
        (
            {"two": ("three", 1.0, 0.0), "three": ("two", 1.0, 0.0)},
            ("'two'", "itself", "['three', 'two']"),
        ),
        ({"two": ("nobody", 1.0, 0.0)}, ("joint", "'two'", "one, two, three", "'nobody'")),
        ({"nobody": ("two", 1.0, 0.0)}, ("joint", "one, two, three", "'nobody'")),
        ({"two": ("one", 0.0, 0.0)}, ("factor of joint 'two'", "'one'", "0")),
        ({"two": ("one", np.inf, 0.0)}, ("factor of joint 'two'", "finite", "inf")),
        ({"two": ("one", 1.0, 9.0)}, ("'one', 'two'", "position", "limits")),
    ],
)
def test_a_coupling_that_is_none_is_refused(mimic: dict, message: tuple[str, ...]) -> None:
    names, limits = ["one", "two", "three"], mo.Limits(q_min=-1.0, q_max=1.0)
    with refused(*message):
        mo.Robot.from_dh(*[[0.0] * 3] * 3, joint_names=names, mimic=mimic, limits=limits)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("factor = -1.0", "factr = -1.0", ("'factr'", "mimic", "joint 'j3'", "'factor'")),
        ('joint = "j2", ', "", ("joint of mimic", "joint 'j3'", "missing")),
        (
            '[[joint]]\nname = "j3"',
            '[[joint]]\ntau_max = 3\nname = "j3"',
            ("tau_max", "joint 'j3'", "'j2'"),
        ),
    ],
)
def test_a_wrong_table_of_a_joint_that_follows_is_refused(
    old: str, new: str, message: tuple[str, ...]
) -> None:
    text = robot_to_toml(parse_urdf(urdf(*ARMS["palletiser"])))
    assert old in text
    with refused(*message):
        parse_robot(text.replace(old, new))


def test_closed_forms_of_joints_that_follow() -> None:
    robot = parse_urdf(urdf(f"{R} z", f"{R} y j1 -2 0.3", f"{R} x"))
    program: dict = {}
    exec(mo.robot.closed_form(robot).text("python"), program)
    q, qd = [0.4, -0.7], [1.3, 0.2]
    for name in ("forward_kinematics", "mass_matrix", "gravity_torque"):
        ours = np.array(getattr(mo, name)(robot)(q))
        assert difference(np.array(program[name](q)).reshape(ours.shape), ours) < 1e-9
    coriolis = np.array(mo.coriolis_matrix(robot)(q, qd))
    assert difference(np.array(program["coriolis_matrix"](q, qd)), coriolis) < 1e-9
    with refused("closed_form", "'j1'", "whole numbers"):
        mo.robot.closed_form(parse_urdf(urdf(f"{R} z", f"{R} y j1 0.5 0")))


def test_whole_turns_are_those_of_every_joint_that_follows() -> None:
    turning = {name: parse_urdf(urdf(*rows)).whole_turns.tolist() for name, rows in ARMS.items()}
    assert turning["palletiser"] == [True, True, True]
    assert turning["turning slides"] == [False]
    assert turning["many"] == [True, True, True, False, True, True]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["telescope", "turning slides"])
def test_poses_are_found(name: str) -> None:
    robot = parse_urdf(urdf(*ARMS[name]))
    q = 0.4 * robot.limits.q_max + 0.6 * robot.limits.q_min
    pose = np.array(mo.forward_kinematics(robot)(q))
    solution = mo.solve_ik(robot, pose[:3, 3], seed=q + 0.05)
    assert solution.solved
    reached = np.array(mo.forward_kinematics(robot)(solution.q))
    assert difference(reached[:3, 3], pose[:3, 3]) < 1e-6


@pytest.mark.slow
def test_a_telescope_takes_the_time_of_its_whole_mass() -> None:
    """Its drive feels 2 + 4 * 1 kg; the force limits both ends, the speed the middle."""
    text = urdf(f"{P} z", f"{P} z j1 1 0", limit="lower='0' upper='0.5' effort='90' velocity='1'")
    for part, plain in ((r"rpy='[^']*'", ""), (r"<mass[^>]*>", "<mass value='{}'/>")):
        text = re.sub(part, plain, text)
    robot = parse_urdf(text.format(2.0, 1.0))
    assert float(mo.mass_matrix(robot)(0.4)) == pytest.approx(6.0)
    up, down = (np.array([90.0, -90.0]) - 6.0 / 1.5 * 9.81) / 6.0
    motion = mo.time_optimal(robot, [[0.0], [0.45]])
    assert motion.duration == pytest.approx(0.45 + 0.5 / up - 0.5 / down, rel=1e-3)
    assert mo.certify(robot, motion).ok


@pytest.mark.thorough
def test_motions_of_joints_that_follow_are_certified_followed_and_clear(tmp_path: Path) -> None:
    robot = parse_urdf(urdf(*ARMS["palletiser"]))
    robot = robot.with_capsules(mo.robot.link_capsules(robot, 0.02))
    assert {frame for frame, _ in robot.capsules} == {0, 1, 2, 3, 4, 5}
    via = [0.5 * robot.limits.q_min, 0.5 * robot.limits.q_max]
    motion = mo.time_optimal_path(robot, mo.quintic(via, [0.0, 1.0]))
    assert mo.certify(robot, motion).ok
    tracked = mo.track(robot, motion, mo.ComputedTorque(400.0))
    assert np.abs(tracked.error).max() < 1e-3
    clear = mo.clearance(robot, motion, mo.Scene([mo.Sphere([3.0, 3.0, 3.0], 0.1)]))
    dense = motion.sample(np.linspace(0.0, motion.duration, 500)).q
    origins = np.array(mo.robot.frame_origins(robot).map(500)(dense.T)).T.reshape(500, 7, 3)
    nearest = np.linalg.norm(origins - 3.0, axis=2).min() - 0.12
    assert clear.at_least <= clear.minimum <= nearest + 1e-9
    assert motion.to_rerun(robot, tmp_path / "a.rrd").stat().st_size > 1000
    assert [row.split()[0] for row in str(robot).splitlines()[2:7]] == [
        "j1",
        "j2",
        "j3",
        "j4",
        "j5",
    ]
