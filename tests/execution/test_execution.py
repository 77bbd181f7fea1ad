"""What controllers make of samples, against their published formulas."""

import json
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

import microbot_ocp as mo
from execution import franka
from helpers import refused, tells
from microbot_ocp.execution import CommandRows
from microbot_ocp.execution._check import efforts
from microbot_ocp.execution._curve import NEAR, played_task, rows_of

MESSAGE = {
    "joint_names": ["elbow", "waist", "shoulder"],
    "points": [
        {"positions": [0.0, 0.0, 0.0], "time_from_start": 0.0},
        {"positions": [1.0], "time_from_start": 0.01},
    ],
}
LIMITERS = {"panda": franka.panda, "fr3": franka.fr3}


@pytest.fixture(scope="module")
def panda():
    return mo.load_robot("panda")


@lru_cache
def shape(robot, profile, seed):
    """The fastest quintic between two random poses under the robot's own limits."""
    limits = mo.execution.load_profile(profile).limits_of(robot)
    share = np.random.default_rng(seed).uniform(0.1, 0.9, (2, robot.joint_count))
    q = limits.q_min + (limits.q_max - limits.q_min) * share
    fastest = mo.shortest_duration(robot, mo.quintic(q, [0.0, 1.0]))
    marks = [mo.motion.Mark(0.0, "grip"), mo.motion.Mark(fastest.duration, "release")]
    return mo.Motion.from_polynomial(robot, fastest.polynomial, label="quintic", marks=marks)


@pytest.mark.parametrize("profile", ["panda", pytest.param("fr3", marks=pytest.mark.thorough)])
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.thorough)])
def test_libfranka_leaves_what_is_exported_as_it_is(panda, profile, seed):
    motion = shape(panda, profile, seed)
    command = mo.execution.commanded(panda, motion, profile)
    assert command.accepted
    assert 0.0 < command.cost < 0.1
    q = command.rows.q
    np.testing.assert_allclose(LIMITERS[profile](q), q, rtol=0, atol=1e-12)
    middle = len(q) // 2
    planted = q.copy()
    planted[middle, 3] += 1e-4  # a jerk of 3e5 rad/s^3
    assert np.abs(LIMITERS[profile](planted) - planted).max() > 5e-5
    certificate = mo.check(panda, CommandRows(command.rows.t, planted), profile)
    jerk = next(each for each in certificate.limit_checks if each.quantity == "qddd")
    assert not certificate.ok
    assert jerk.joint == "panda_joint4"
    assert abs(jerk.value) == pytest.approx(3e5, rel=0.01)
    assert abs(jerk.time - command.rows.t[middle]) < 0.004


@pytest.mark.thorough
def test_torques_that_jump_are_rounded_off_rather_than_slowed_down(panda):
    """A cubic, whose acceleration jumps at its ends, planned without torque rates."""
    share = np.random.default_rng(1).uniform(0.2, 0.8, (2, panda.joint_count))
    q = panda.limits.q_min + (panda.limits.q_max - panda.limits.q_min) * share
    fastest = mo.shortest_duration(panda.with_limits(taud_max=np.inf), mo.cubic(q, [0.0, 1.0]))
    motion = mo.Motion.from_polynomial(panda, fastest.polynomial, label="cubic")
    command = mo.execution.commanded(panda, motion, "panda")
    assert command.accepted
    assert command.cost < 0.1 * motion.duration  # 3 times its duration, evenly
    rows = command.rows.q
    np.testing.assert_allclose(franka.panda(rows), rows, rtol=0, atol=1e-12)
    way = np.linspace(0.0, motion.duration, 20_001)
    planned = motion.sample(way).q
    away = [np.abs(planned - row).max(axis=1).min() for row in rows[::20]]
    assert max(away) < 1e-3
    np.testing.assert_allclose(rows[[0, -1]], q, atol=1e-9)


def test_held_commands_have_their_differences_as_derivatives(panda):
    motion = shape(panda, "panda", 3)
    rows = CommandRows(np.linspace(0.0, 0.199, 200), motion.resample(1000.0).q[:200])
    curve = mo.executed(panda, rows, "panda")
    q = np.concatenate([rows.q[:1], rows.q[:1], rows.q, rows.q[-1:], rows.q[-1:]])
    state = curve.sample(np.arange(len(q) - 2) * 1e-3)
    np.testing.assert_allclose(state.qdd, np.diff(q, n=2, axis=0) / 1e-6, atol=1e-6)
    np.testing.assert_allclose(state.qd, (q[2:] - q[:-2]) / 2e-3, atol=1e-9)


def jtc(rows, t, order):
    """Positions by the formulas of ros2_controllers, trajectory.cpp, row by row."""
    found = []
    for at in t:
        i = min(int(np.searchsorted(rows.t, at, side="right")) - 1, len(rows.t) - 2)
        T, x = rows.t[i + 1] - rows.t[i], at - rows.t[i]
        (p, P), (v, V) = rows.q[i : i + 2], rows.qd[i : i + 2]
        if order == 3:
            c2 = (-3 * p + 3 * P - 2 * v * T - V * T) / T**2
            c3 = (2 * p - 2 * P + v * T + V * T) / T**3
            found.append(p + v * x + c2 * x**2 + c3 * x**3)
            continue
        a, A = rows.qdd[i : i + 2]
        c3 = (-20 * p + 20 * P - 3 * a * T**2 + A * T**2 - 12 * v * T - 8 * V * T) / (2 * T**3)
        c4 = (30 * p - 30 * P + 3 * a * T**2 - 2 * A * T**2 + 16 * v * T + 14 * V * T) / (2 * T**4)
        c5 = (-12 * p + 12 * P - a * T**2 + A * T**2 - 6 * v * T - 6 * V * T) / (2 * T**5)
        found.append(p + v * x + a / 2 * x**2 + c3 * x**3 + c4 * x**4 + c5 * x**5)
    return np.array(found)


@pytest.mark.parametrize(("name", "order"), [("cubic", 3), ("quintic", 5)])
def test_splines_of_joint_trajectory_controller(microbot, name, order):
    rng = np.random.default_rng(4)
    t = np.concatenate([[0.0], np.cumsum(rng.uniform(0.05, 0.2, 6))])
    q, qd, qdd = rng.normal(size=(3, 7, 3))
    rows = CommandRows(t, q, qd, qdd)
    curve = mo.executed(microbot, rows, f"ros2_jtc_{name}")
    at = np.sort(rng.uniform(0.0, t[-1], 200))
    np.testing.assert_allclose(curve.sample(at).q, jtc(rows, at, order), rtol=0, atol=1e-9)


@pytest.mark.parametrize("profile", ["ros2_jtc_cubic@250", "ros2_jtc_quintic@250"])
def test_accelerations_that_jump_between_rows_cost_some_steps_only(microbot, tmp_path, profile):
    robot = microbot.with_limits(tau_max=np.inf, qdd_max=5.0)
    via_q = np.array(
        [[0.0, 0.2, 0.1], [0.6, 0.7, 0.94]]
    )  # 205 steps, with the switch in the middle
    motion = mo.time_optimal_path(robot, mo.straight_path(via_q), compiled=False)
    assert np.ptp(motion.qdd, axis=0).max() > 9.0
    command = mo.execution.commanded(robot, motion, profile)
    assert command.accepted
    assert 0.0 < command.cost <= 4 * 0.004
    rows = mo.execution.read_rows(command.export(tmp_path / "a.json", robot), robot)
    t = np.linspace(0.0, rows.t[-1], 4001)
    q = jtc(rows, t, 3) if rows.qdd is None else jtc(rows, t, 5)
    assert np.abs(np.diff(q, n=2, axis=0)).max() <= 5.0 * t[1] ** 2 * (1 + 1e-6)
    share = (rows.q - via_q[0]) / (via_q[1] - via_q[0])
    np.testing.assert_allclose(share, share[:, [0]] @ np.ones((1, 3)), atol=1e-9)  # on the line
    assert (np.diff(share[:, 0]) >= -1e-12).all()


def test_what_toppra_breaks_between_the_rows_is_found(microbot):
    """Every row keeps the limits; the cubic through two of them, over a switch, does not."""
    toppra = pytest.importorskip("toppra")
    robot = microbot.with_limits(qd_max=1.5, qdd_max=4.0, tau_max=np.inf)
    via = np.array([[0.0, 0.2, 0.1], [0.6, 0.7, 0.9], [0.9, 0.1, 0.4]])
    velocity, acceleration = ([[-most, most]] * 3 for most in (1.45, 3.9))
    shape = toppra.algorithm.TOPPRA(
        [
            toppra.constraint.JointVelocityConstraint(velocity),
            toppra.constraint.JointAccelerationConstraint(acceleration),
        ],
        toppra.SplineInterpolator(np.linspace(0.0, 1.0, 3), via),
        gridpoints=np.linspace(0.0, 1.0, 201),
    ).compute_trajectory()
    t = np.linspace(0.0, shape.duration, 30)
    rows = CommandRows(t, shape(t), shape(t, 1), shape(t, 2))
    assert rows.qd is not None
    assert rows.qdd is not None
    assert np.abs(rows.qd).max() < 1.5
    assert np.abs(rows.qdd).max() < 4.0
    certificate = mo.check(robot, rows, "ros2_jtc_cubic")
    h = np.diff(t)[:, None]
    slope = np.diff(rows.q, axis=0) / h  # the acceleration of a cubic is largest at its ends
    start = (6.0 * slope - 4.0 * rows.qd[:-1] - 2.0 * rows.qd[1:]) / h
    end = (2.0 * rows.qd[:-1] + 4.0 * rows.qd[1:] - 6.0 * slope) / h
    sides = np.abs([start, end])
    _, row, joint = np.unravel_index(sides.argmax(), sides.shape)
    worst = next(each for each in certificate.limit_checks if each.quantity == "qdd")
    assert not certificate.ok
    assert worst.violation == pytest.approx(sides.max() / 4.0 - 1.0, rel=1e-3)
    assert worst.violation > 0.1
    assert worst.joint == robot.joint_names[joint]
    assert t[row] - 1e-9 <= worst.time <= t[row + 1] + 1e-9


@pytest.mark.parametrize(
    ("profile", "fields"),
    [
        ("ros2_jtc_linear@200", {"positions"}),
        ("ros2_jtc_cubic@200", {"positions", "velocities"}),
        ("ros2_jtc_quintic@50", {"positions", "velocities", "accelerations"}),
    ],
)
def test_a_file_is_whole_at_its_own_rate(microbot, tmp_path, profile, fields):
    motion = shape(microbot, "hold", 5)
    path = motion.export(tmp_path / "a.json", profile=profile, robot=microbot)
    document = json.loads(path.read_text("utf-8"))
    points = document["points"]
    assert set(points[0]) == {*fields, "time_from_start"}
    stamps = [p["time_from_start"]["sec"] + 1e-9 * p["time_from_start"]["nanosec"] for p in points]
    step = mo.execution.load_profile(profile).step
    np.testing.assert_allclose(np.diff(stamps), step, atol=2e-9)
    assert set(document) == {"header", "joint_names", "points"}  # as strict readers ask
    marks = mo.execution.read_rows(path, microbot).marks
    assert [mark.name for mark in marks] == ["grip", "release"]
    assert np.abs(points[-1].get("velocities", 0.0)).max() < 1e-9
    assert mo.check(microbot, path, profile).ok


@pytest.mark.thorough
def test_efforts_without_gravity(panda, tmp_path):
    motion = shape(panda, "panda", 1)
    path = motion.export(tmp_path / "a.csv", profile="panda", robot=panda)
    lines = path.read_text("utf-8").splitlines()
    assert lines[1].endswith(",grip")
    assert lines[-1].endswith(",release")
    last = np.array(lines[-1].split(",")[:-1], dtype=float)
    np.testing.assert_allclose(last[-7:], 0.0, atol=1e-6)  # at rest nothing but gravity is left


def test_a_robot_without_limits_is_not_slowed_down():
    robot = mo.Robot.from_dh(alpha=[0.0], a=[1.0], d=[0.0])
    motion = mo.Motion.from_polynomial(robot, mo.quintic([[0.0], [1.0]], [0.0, 1.0]), label="any")
    command = mo.execution.commanded(robot, motion, "hold@100")
    assert command.accepted
    assert command.cost == 0.0


def test_what_slowing_down_does_not_help(microbot):
    beyond = float(microbot.limits.q_max[1]) + 0.1
    leaves = mo.quintic([[0.0, 0.0, 0.0], [0.0, beyond, 0.0]], [0.0, 20.0])
    motion = mo.Motion.from_polynomial(microbot, leaves, label="quintic")
    with refused("position of shoulder", "rad at 20 s", "'hold'", "-6.2832 to 6.2832"):
        mo.execution.commanded(microbot, motion, "hold@100")


def test_what_moves_at_an_end_is_no_command(microbot):
    state = shape(microbot, "hold", 5).resample(100.0)
    half = mo.Motion.from_state(
        microbot,
        state.t[50:] - state.t[50],
        mo.motion.State(state.q[50:], state.qd[50:], state.qdd[50:]),
        label="from the middle",
    )
    for profile in ("hold@100", "ros2_jtc_linear@100"):
        with refused("motion", "begin at rest", "0.137 rad/s"):
            mo.execution.commanded(microbot, half, profile)
    with refused("motion", "3 joints", "robot has 6"):
        mo.execution.commanded(mo.load_robot("ur5e"), half, "hold@100")


def test_a_motion_with_another_payload_is_refused(microbot, tmp_path):
    """Its efforts and the check of its torques would be those of the empty arm."""
    loaded = microbot.with_payload(1.0)
    path = shape(loaded, "hold", 5).save(tmp_path / "a.npz")
    motion = mo.Motion.load(path)
    for played in (
        lambda robot: mo.execution.commanded(robot, motion, "hold@250").certificate,
        lambda robot: mo.check(robot, motion, "hold@250"),
        lambda robot: mo.check(robot, path, "hold@250"),
        lambda robot: mo.executed(robot, motion, "hold@250"),
        lambda robot: mo.execution.overridden(robot, motion, 0.5 * motion.duration, 0.5),
        lambda robot: mo.smallest_reserve(robot, motion, mo.ComputedTorque(kp=100.0), [robot], 1.0),
    ):
        played(loaded)
        with refused("torques", "'microbot'", "waist", "N m", "robot.with_payload"):
            played(microbot)


def test_segments_without_stops_are_refused(microbot):
    """They were left out without a word."""
    motion = shape(microbot, "hold", 5)
    for asked in (
        lambda **given: mo.execution.commanded(microbot, motion, "hold@250", **given),
        lambda **given: mo.check(microbot, motion, "hold@250", **given),
        lambda **given: mo.executed(microbot, motion, "hold@250", **given),
        lambda **given: mo.execution.ratings(microbot, motion, **given),
    ):
        for given in ({"cycle": True}, {"segments": [None]}):
            with refused("segments and cycle", "stops", "via_q"):
                asked(**given)


def test_a_profile_file_may_limit_the_tool(microbot, tmp_path):
    path = tmp_path / "mine.toml"
    head = "name = 'mine'\ninterpolation = 'cubic'\nrate = 200.0\n[limits]\n"
    path.write_text(
        f"{head}tool_speed_max = 7.0\ntool_acceleration_max = 12.0\ntool_jerk_max = 900.0\n",
        "utf-8",
    )
    motion = shape(microbot, "hold", 1)
    found = mo.check(microbot, motion, path)
    assert not found.ok
    assert found.verdict.startswith("Failed: tool")
    command = mo.execution.commanded(microbot, motion, path)
    assert command.accepted
    speed = mo.limits.tool_speed(7.0)
    history = mo.limits.limit_history(microbot, command.executed, mo.Limits(also=[speed]))
    assert history.values["tool_speed"].max() <= 7.0 * (1 + 1e-9)


@pytest.mark.parametrize(("own", "tighter"), [(1.5, 1.5), (3.0, 2.0)])
def test_of_two_limits_of_the_tool_the_tighter_one_counts(microbot, own, tighter):
    robot = microbot.with_limits(also=[mo.limits.tool_speed(own), mo.limits.power(upper=900.0)])
    profile = mo.execution.load_profile("hold@100")
    other = replace(profile, limits=mo.Limits(also=[mo.limits.tool_speed(2.0)]))
    speed, power = other.limits_of(robot).also
    assert speed.upper == (tighter,)
    assert power.upper == (900.0,)
    varying = replace(profile, limits=mo.Limits(also=[replace(speed, upper=lambda state: 2.0)]))
    assert callable(varying.limits_of(robot).also[0].upper)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[limits]\nqd_max = 'a'", ("qd_max", "numbers", "'a'")),
        (
            "look_ahead = 0.002",
            ("look_ahead", "qd_max", "[limits]", "[braking]"),
        ),
        ("columns = 5", ("columns", "list", "not 5")),
        ("columns = 'q'", ("columns", "list", "'q'")),
        (
            "[braking]\nq_min = 1.0\nq_max = [1.0]\nqd_max = [1.0]\ndeceleration = [1.0]\n"
            "offset = [0.0]",
            ("q_min", "[any]", "[]"),
        ),
    ],
)
def test_profile_files_of_other_kinds(tmp_path, text, said):
    path = tmp_path / "mine.toml"
    path.write_text(f"name = 'mine'\ninterpolation = 'hold'\nrate = 100.0\n{text}\n", "utf-8")
    with refused("mine.toml", *said):
        mo.execution.load_profile(path)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.csv", "", ("empty",)),
        ("a.csv", "0,1,2\n1,2,3\n", ("1 to 4 columns", "3 joints", "not 3")),
        (
            "a.csv",
            "t,a,b,c\n0,0,0,0\n1,1,1\n",
            ("line 3", "4 numbers", "['1', '1', '1']"),
        ),
        ("a.csv", "0,0,0,0\n0,1,1,1\n", ("increasing", "t[1] is 0 s", "t[0] of 0 s")),
        ("a.csv", "t,a,b,c\n0,0,0,x\n", ("line 2", "4 numbers", "'x'")),
        ("a.csv", "t,a,b,c\n", ("no rows",)),
        (
            "a.csv",
            "t,q a [deg],b,c\n0,0,0,0\n",
            ("joints", "waist, shoulder, elbow", "a, b, c"),
        ),
        ("a.csv", "t,q1 [deg],b,c\n0,0,0,0\n", ("'q1 [deg]'", "in rad", "in deg")),
        ("a.csv", "t (ms),a,b,c\n0,0,0,0\n", ("'t (ms)'", "in s", "in ms")),
        (
            "a.csv",
            "t,elbow_q,b,c\n0,0,0,0\n",
            ("'elbow_q'", "waist", "'elbow'"),
        ),
        (
            "a.csv",
            "waist,shoulder,elbow,t\n0,0,0,0\n",
            ("first column", "time, s", "'waist'"),
        ),
        (
            "a.csv",
            "0,0,0,0\n0.01,0,99,0\n",
            ("position of shoulder", "row 2", "99 rad", "-6.28319 to 6.28319 rad"),
        ),
        (
            "a.csv",
            "0,0,0,0\n9,0,0,0\n",
            ("row 2", "9 s", "'hold'", "0.01 s"),
        ),
        ("a.json", "{", ("no JSON",)),
        ("a.json", "{}", ("one trajectory", "joint_names", "points", "holds 0")),
        ("a.json", json.dumps([MESSAGE, MESSAGE]), ("one trajectory", "holds 2")),
        (
            "a.json",
            json.dumps(MESSAGE).replace("0.01", "1" + 400 * "0"),
            ("number", "too large"),
        ),
        ("a.json", json.dumps(MESSAGE), ("positions of point 2", "3 numbers", "[1.0]")),
        (
            "a.yaml",
            "joint_names: [a, b, c]\npoints: [{}]",
            ("joints", "waist, shoulder, elbow", "a, b, c"),
        ),
        ("a.npz", "x", ("archive", "numpy")),
        ("a.txt", "x", ("ending", ".csv, .json, .yaml", "'.txt'")),
    ],
)
def test_files_that_are_no_trajectories(microbot, tmp_path, name, text, said):
    (tmp_path / name).write_text(text, "utf-8")
    with refused(*said if name == "a.txt" else (name, *said)):
        mo.check(microbot, tmp_path / name, "hold@100")


def test_archives_of_other_arrays(microbot, tmp_path):
    path = tmp_path / "a.npz"
    with path.open("wb") as file:
        np.save(file, np.zeros(3))
    with refused("a.npz", "archive", "numpy"):
        mo.check(microbot, path, "hold@100")
    path.write_bytes(b"PK\x03\x04" + bytes(100))  # damaged
    with refused("a.npz", "archive", "numpy"):
        mo.check(microbot, path, "hold@100")
    np.savez(path, time=[0.0, 0.01])
    with refused("a.npz", "t and q", "qd, qdd, tau"):
        mo.check(microbot, path, "hold@100")
    shape(microbot, "hold", 5).save(path)
    assert mo.check(microbot, path, "hold@100").ok  # sampled at the rate, as a motion is


@pytest.mark.parametrize("ending", ["heads.csv", "names.csv", "npz"])
def test_joints_in_another_order_are_found_by_their_names(microbot, tmp_path, ending):
    t = np.array([0.0, 0.5, 1.0])
    q, qd = np.random.default_rng(5).normal(size=(2, 3, 3))
    order, path = [2, 0, 1], tmp_path / f"a.{ending}"
    names = [microbot.joint_names[k] for k in order]
    if ending == "npz":
        np.savez(path, t=t, q=q[:, order], qd=qd[:, order], joint_names=names)
    else:
        heads = [*(f"qd {name} [rad/s]" for name in names), *(f"q {name} [rad]" for name in names)]
        columns = [t, *qd[:, order].T, *q[:, order].T]
        if ending == "names.csv":
            heads, columns = [*names, *names], [t, *q[:, order].T, *qd[:, order].T]
        head = ",".join(["t [s]", *heads])
        np.savetxt(path, np.column_stack(columns), delimiter=",", header=head)  # behind a "#"
    rows = mo.execution.read_rows(path, microbot)
    np.testing.assert_allclose(rows.q, q, rtol=0, atol=1e-12)
    np.testing.assert_allclose(rows.qd, qd, rtol=0, atol=1e-12)


def test_joints_in_another_order_and_times_of_both_kinds(microbot, tmp_path):
    """A plan of MoveIt, as ``ros2 topic echo`` prints it."""
    text = (
        "trajectory:\n- multi_dof_joint_trajectory: {joint_names: [], points: []}\n"
        "  joint_trajectory:\n    joint_names: [elbow, waist, shoulder]\n    points:\n"
        "    - {positions: [0.0, 0.0, 0.0], time_from_start: {sec: 0, nanosec: 0}}\n"
        "    - {positions: [0.3, 0.1, 0.2], time_from_start: {secs: 1, nsecs: 500000000}}\n"
    )
    (tmp_path / "plan.yaml").write_text(text, "utf-8")
    certificate = mo.check(microbot, tmp_path / "plan.yaml", "ros2_jtc_linear@500")
    position = certificate.limit_checks[0]
    limits = microbot.limits
    middle, half = 0.5 * (limits.q_max + limits.q_min), 0.5 * (limits.q_max - limits.q_min)
    ends = np.abs(np.array([[0.0, 0.0, 0.0], [0.1, 0.2, 0.3]]) - middle).max(axis=0) / half
    np.testing.assert_allclose(position.utilisation, ends, atol=1e-6)


@pytest.mark.parametrize(
    ("profile", "said"),
    [
        ("nothing", ("profile", "fr3, hold, panda", "'nothing'")),
        ("hold", ("'hold'", "Hz", "'hold@500'")),
        ("hold@fast", ("'hold'", "Hz", "'fast'")),
        ("hold@0", ("rate", "above 0 Hz", "not 0.0")),
        ("panda", ("profile panda", "microbot", "qd_max", "[3]", "[7]")),
        ("hold@100", ("row 2", "0.5 s", "'hold'", "0.01 s")),
        ("ros2_jtc_cubic", ("'ros2_jtc_cubic'", "qd in every")),
    ],
)
def test_profiles_that_do_not_fit(microbot, profile, said):
    rows = CommandRows(np.array([0.0, 0.5]), np.zeros((2, 3)))
    with refused(*said):
        mo.check(microbot, rows, profile)


@pytest.mark.slow
def test_an_obstacle_on_the_way_is_found(tmp_path):
    pytest.importorskip("coal")
    robot = mo.load_robot("planar_3r")
    q = np.array([[0.0, 0.3, 0.2], [1.2, 0.3, 0.2]])
    shape = mo.Motion.from_polynomial(robot, mo.quintic(q, [0.0, 2.0]), label="quintic")
    middle = np.array(mo.forward_kinematics(robot)(shape.sample([1.0]).q[0]))[:3, 3]
    path = shape.export(tmp_path / "a.csv", profile="hold@100", robot=robot)
    for center, clear in ((middle, False), (middle + np.array([0.0, 0.0, 2.0]), True)):
        scene = mo.Scene([mo.Sphere(center, 0.05)])
        certificate = mo.check(robot, path, "hold@100", scene=scene)
        assert certificate.clearance is not None
        assert certificate.ok == clear


@pytest.fixture(scope="module")
def pick_and_place():
    """A Microbot that picks 3 kg, passes a stop, and puts it down: stops and the motion."""
    robot = mo.load_robot("microbot")
    stops = [
        mo.Stop(q=[0.0, 0.3, 0.2], name="home"),
        mo.Stop(q=[0.4, 0.9, 0.6], payload=3.0, dwell=0.103, name="grip"),
        mo.Stop(q=[0.6, 0.5, 0.6], name="above"),
        mo.Stop(q=[1.0, 0.8, 0.3], payload=0.0, name="release"),
        mo.Stop(q=[0.0, 0.3, 0.2], name="back"),
    ]
    return robot, stops, mo.time_optimal(robot, stops, mesh=12, starts=1)


@pytest.mark.slow
@pytest.mark.parametrize(
    "profile",
    [
        pytest.param("hold@500", marks=pytest.mark.thorough),
        pytest.param("ros2_jtc_linear@500", marks=pytest.mark.thorough),
        pytest.param("ros2_jtc_cubic@250", marks=pytest.mark.thorough),
        "ros2_jtc_quintic@100",
    ],
)
def test_a_payload_that_changes_on_the_way(pick_and_place, tmp_path, profile):
    robot, stops, motion = pick_and_place
    command = mo.execution.commanded(robot, motion, profile, via_q=stops)
    assert command.accepted, command.certificate.verdict
    assert 0.0 <= command.cost < 0.15 * motion.duration
    step, rows = command.profile.step, command.rows
    np.testing.assert_allclose(np.diff(rows.t), step, rtol=1e-9)
    for mark in [rows.marks[k] for k in (0, 1, 3, 4)]:  # grip and release are rows at rest
        row = round(mark.time / step)
        assert mark.time == pytest.approx(rows.t[row], abs=1e-12)
        target = next(stop.q for stop in stops if stop.name == mark.name)
        np.testing.assert_allclose(rows.q[row], target, atol=1e-6)
        np.testing.assert_allclose(rows.qd[row], 0.0, atol=1e-9)
    loaded, (_, grip, above, release, _) = robot.with_payload(3.0), rows.marks
    carried = (rows.t > grip.time + 0.103 + step) & (rows.t < release.time - step)
    for here, arm in ((carried, loaded), (rows.t > release.time, robot), (rows.t < 0.2, robot)):
        want = arm.torques_along(rows.q[here], rows.qd[here], rows.qdd[here])["tau"]
        np.testing.assert_allclose(rows.tau[here], want, atol=1e-9)
    assert grip.time + 0.103 < above.time < release.time
    for ending in ("json", "csv"):
        path = motion.export(tmp_path / f"a.{ending}", profile=profile, robot=robot, via_q=stops)
        read = mo.execution.read_rows(path, robot)
        assert [mark.name for mark in read.marks] == [stop.name for stop in stops]
        certificate = mo.check(robot, path, profile, via_q=stops)
        assert certificate.ok
        assert "assumed" not in certificate.verdict
        assumed = mo.check(robot, path, profile).verdict
        tells(assumed, "assumed", f"marks ({', '.join(stop.name for stop in stops)})")
    heavier = [stops[0], replace(stops[1], payload=6.0), *stops[2:]]
    certificate = mo.check(robot, path, profile, via_q=heavier)
    torque = next(each for each in certificate.limit_checks if each.quantity == "tau")
    assert not certificate.ok
    assert torque.violation > 0.05
    assert grip.time <= torque.time <= release.time + 3 * step
    with refused("torques", "'microbot'", "shoulder", "N m", "via_q"):
        mo.check(robot, motion, profile)


@pytest.fixture(scope="module")
def line():
    """A Microbot on a tool line whose tube it uses up: stops, segments and the motion."""
    robot = mo.load_robot("microbot")
    stops = [mo.Stop(q=[0.3, 0.6, 0.5]), mo.Stop(q=[0.9, 0.9, 0.3])]
    task = {"via_q": stops, "segments": [mo.Line(tolerance=2e-3)]}
    return robot, task, mo.time_optimal(robot, stops, segments=task["segments"], mesh=20, starts=1)


@pytest.mark.slow
@pytest.mark.parametrize(
    "profile",
    [
        "hold@100",
        pytest.param("ros2_jtc_linear@50", marks=pytest.mark.thorough),
        pytest.param("ros2_jtc_cubic@50", marks=pytest.mark.thorough),
        pytest.param("ros2_jtc_quintic@50", marks=pytest.mark.thorough),
    ],
)
def test_a_tool_line_that_the_plan_uses_up_is_kept(line, profile):
    """What the controller rounds off left the tube by up to a quarter, and was refused."""
    robot, task, motion = line
    command = mo.execution.commanded(robot, motion, profile, **task)
    assert command.accepted, command.certificate.verdict
    assert command.cost < 0.25 * motion.duration
    ends = [np.array(mo.forward_kinematics(robot)(stop.q))[:3, 3] for stop in task["via_q"]]
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    t = np.linspace(0.0, command.executed.duration, 3001)
    poses = mo.forward_kinematics(robot).map(t.size)(command.executed.sample(t).q.T)
    offset = np.array(poses).reshape(4, -1, 4)[:3, :, 3].T - ends[0]
    across = np.linalg.norm(offset - np.outer(offset @ along, along), axis=1)
    assert across.max() <= 2e-3
    rows = command.rows
    np.testing.assert_allclose(rows.q[[0, -1]], [stop.q for stop in task["via_q"]], atol=1e-9)
    for derivative in (rows.qd, rows.qdd):
        np.testing.assert_allclose(derivative[[0, -1]], 0.0, atol=1e-9)


@pytest.fixture(scope="module")
def moving_onto_a_line():
    """A Microbot that passes a stop at speed and goes on along a tool line: stops and motion."""
    robot = mo.load_robot("microbot")
    tool = mo.forward_kinematics(robot)
    middle, end = (np.array(tool(q))[:3, 3] for q in ([0.9, 0.9, 0.3], [1.3, 0.6, 0.6]))
    stops = [mo.Stop(q=[0.3, 0.6, 0.5]), mo.Stop(position=middle, tolerance=0.05)]
    stops.append(mo.Stop(position=end))
    task = {"via_q": stops, "segments": [None, mo.Line(tolerance=2e-3)]}
    return robot, task, mo.time_optimal(robot, stops, segments=task["segments"], mesh=20, starts=1)


@pytest.mark.thorough
@pytest.mark.slow
@pytest.mark.parametrize(
    ("profile", "most"),  # s that rows take longer
    [
        ("ur_servoj", 0.02),
        ("ros2_jtc_cubic@100", 0.2),
        ("hold@250", 0.05),
        ("ros2_jtc_linear@200", 0.08),
        ("ros2_jtc_quintic@100", 0.2),
    ],
)
def test_a_line_that_is_reached_at_speed_is_kept_from_its_first_point_on(
    moving_onto_a_line, profile, most
):
    """The tube was judged from the next sample on, and rows were drawn in one by one, with jerks:
    all these were refused, ``ur_servoj`` 0.23 s longer.
    """
    robot, task, motion = moving_onto_a_line
    command = mo.execution.commanded(robot, motion, profile, **task)
    assert command.accepted, command.certificate.verdict
    assert 0.0 < command.cost < most
    tool = mo.forward_kinematics(robot)
    start, end = (task["via_q"][k].position for k in (1, 2))
    along = np.subtract(end, start) / np.linalg.norm(np.subtract(end, start))
    played, mark = command.executed, command.executed.marks[1].time
    q = played.sample(np.linspace(mark, played.duration, 2001)).q
    points = np.array(tool.map(len(q))(q.T)).reshape(4, -1, 4)[:3, :, 3].T - start
    across = np.linalg.norm(points - np.outer(points @ along, along), axis=1)
    assert across.max() <= 2e-3
    np.testing.assert_allclose(np.array(tool(command.rows.q[-1]))[:3, 3], end, atol=1e-6)


def test_a_pose_outside_of_a_profile_is_refused_by_its_position(panda):
    """It was refused as "velocity before the end" of the joint."""
    inside = [0.0, -0.6, 0.0, -2.2, 0.0, 1.6, 0.7]
    for joint, value, allowed in ((3, -0.1, "-3.0421 to -0.1518"), (5, 0.3, "0.5445 to 4.5169")):
        outside = np.array(inside)
        outside[joint] = value
        free = panda.with_limits(q_min=-10.0, q_max=10.0)
        motion = mo.Motion.from_polynomial(
            free, mo.quintic([inside, outside], [0.0, 5.0]), label="quintic"
        )
        moved = f"position of {panda.joint_names[joint]}"
        with refused(moved, f"{value:g} rad at 5 s", "'fr3'", allowed):
            mo.execution.commanded(free, motion, "fr3")


@pytest.mark.thorough
def test_a_corner_that_is_blended_is_passed_as_nearly_as_stops(microbot):
    """Where the blend begins and ends was asked for exactly, so that no controller was left."""
    tool = mo.forward_kinematics(microbot)
    corner = np.array(tool([0.9, 0.9, 0.3]))[:3, 3]
    stops = [[0.3, 0.6, 0.5], mo.Stop(position=corner, blend=0.3), [1.3, 0.6, 0.6]]
    task = {"via_q": stops, "segments": 2 * [mo.Line(tolerance=5e-3)]}
    motion = mo.time_optimal(microbot, stops, segments=task["segments"], mesh=20)
    command = mo.execution.commanded(microbot, motion, "hold@250", **task)
    assert command.accepted, command.certificate.verdict
    places = np.array([np.array(tool(q))[:3, 3] for q in command.rows.q])
    nearest = np.linalg.norm(places - corner, axis=1).min()
    assert 0.01 < nearest < 0.305


def test_efforts_say_whether_marks_are_of_the_arm_as_it_is(microbot, tmp_path):
    motion = shape(microbot, "hold@250", 1)
    path = motion.export(tmp_path / "a.csv", profile="hold@250", robot=microbot)
    assert "assumed" not in mo.check(microbot, path, "hold@250").verdict
    loaded = mo.check(microbot.with_payload(1.0), path, "hold@250")
    tells(loaded.verdict, "assumed", "marks (grip, release)")


@pytest.mark.parametrize("gravity", [True, False])
def test_efforts_of_another_load_are_told(microbot, gravity):
    """A file without marks was judged as the empty arm without a word."""
    loaded, motion = microbot.with_payload(1.0), shape(microbot, "hold@250", 1)
    rows = rows_of(motion, mo.execution.load_profile("hold@250"))
    profile = replace(mo.execution.load_profile("hold@250"), gravity=gravity)
    state = mo.motion.State(rows.q, rows.qd, rows.qdd)
    for arm, told in ((microbot, False), (loaded, True)):
        given = replace(rows, tau=efforts(arm, state, profile), marks=())
        verdict = mo.check(microbot, given, "hold@250").verdict
        assert ("assumed" in verdict) == ("efforts" in verdict) == told
    assert (
        "assumed" not in mo.check(microbot, replace(rows, tau=None, marks=()), "hold@250").verdict
    )


def test_a_trajectory_without_marks_is_no_motion_of_stops(microbot):
    stops = [mo.Stop(q=[0.0, 0.0, 0.0], payload=1.0), mo.Stop(q=[0.1, 0.1, 0.1])]
    rows = CommandRows(np.array([0.0, 0.5]), np.zeros((2, 3)))
    with refused("'trajectory, by ros2_jtc_linear'", "0 marks", "2 stops"):
        mo.check(microbot, rows, "ros2_jtc_linear@100", via_q=stops)


def test_a_pose_that_is_passed_is_kept_as_nearly_as_via_points() -> None:
    """Of a UR5e between two tool lines the orientation was missed by 2e-4 rad, and refused."""
    stops = [mo.Stop(position=[0.4, 0.1 * k, 0.3], orientation=np.eye(3)) for k in range(3)]
    profile = mo.execution.load_profile("hold@500")
    kept = played_task(mo.load_robot("ur5e"), profile, stops, None, False).stops
    assert [stop.orientation_tolerance for stop in kept] == [0.0, NEAR, 0.0]
    assert [float(stop.tolerance) for stop in kept] == [0.0, NEAR, 0.0]


def test_marks_on_the_way_need_no_stops(microbot):
    """Via points of a plain motion were taken for stops that nobody had given."""
    shape = mo.quintic([[0, 0, 0], [0.3, 0.4, 0.2], [0.5, 0.8, 0.4]], [0.0, 1.5, 3.0])
    marks = [mo.motion.Mark(t, name) for t, name in zip((0.0, 1.5, 3.0), "abc", strict=True)]
    motion = mo.Motion.from_polynomial(microbot, shape, label="via", marks=marks)
    for profile in ("hold@100", "ros2_jtc_cubic@50", "ros2_jtc_linear@50"):
        command = mo.execution.commanded(microbot, motion, profile)
        assert command.accepted
        assert [mark.name for mark in command.rows.marks] == ["a", "b", "c"]


@pytest.mark.thorough
@pytest.mark.slow
def test_a_plan_is_made_again_where_rounding_its_jumps_off_costs_more():
    """Rows of a free motion took up to 17 % longer than those of a plan that limits the jerk."""
    robot, profile = mo.load_robot("ur5e"), "ros2_jtc_cubic@100"
    via = np.random.default_rng(0).uniform(-1.5, 1.5, (3, 6))
    motion = mo.time_optimal(robot, via, starts=1)
    anonymous = replace(motion, provenance={})  # of it nobody knows how it was planned
    command, before = (mo.execution.commanded(robot, m, profile) for m in (motion, anonymous))
    assert command.accepted
    assert before.accepted
    assert command.rows.t[-1] < 0.97 * before.rows.t[-1]
    assert "planned again" in command.rows.label
    assert "again" not in before.rows.label
    assert mo.check(robot, command.rows, profile).ok
    passed = [np.abs(command.executed.q - pose).max(axis=1).min() for pose in via]
    assert max(passed) < 5e-3
    # what had other limits, or shall take longer, keeps its way
    for other in (robot.with_limits(qd_max=9.0), robot.with_limits(also=[mo.limits.power(9e9)])):
        rows = mo.execution.commanded(other, motion, profile).rows
        assert "again" not in rows.label
    calm = motion.stretched(robot, 1.05)
    rows = mo.execution.commanded(robot, calm, "ros2_jtc_cubic@50").rows
    assert "again" not in rows.label
    assert rows.t[-1] >= calm.duration
