"""The family of limits: what a member is, and that every consumer asks the same engine."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import microbot_ocp as mo
from helpers import refused, sampled, two_link_arm
from microbot_ocp.limits import (
    LimitFamily,
    MotionSamples,
    limit_history,
    limits_from_table,
    limits_to_table,
)

MICROBOT = mo.load_robot("microbot")
VIA_Q = np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]])
HEIGHT = mo.Limit("tool height", lambda state: state.tool[2, 3], lower=0.5, unit="m")


def samples(robot: mo.Robot, count: int = 20, seed: int = 0) -> MotionSamples:
    random = np.random.default_rng(seed)
    return MotionSamples(*random.uniform(-2.0, 2.0, (4, count, robot.joint_count)))


def test_limits_with_replaced_numbers_are_arrays_and_checked() -> None:
    changed = replace(MICROBOT.limits, qd_max=1.0, tau_max=[300.0, 400.0, 100.0])
    limits = MICROBOT.with_limits(changed).limits
    assert limits.qd_max.tolist() == [1.0] * 3
    assert limits.tau_max.tolist() == [300.0, 400.0, 100.0]
    assert MICROBOT.with_limits(MICROBOT.limits).limits is MICROBOT.limits
    with refused("qd_max of joint 1", "zero", "[-2, -1] rad/s"):
        MICROBOT.with_limits(replace(MICROBOT.limits, qd_max=-1.0))
    with refused("tau_max", "[3]", "[4]"):
        MICROBOT.with_limits(replace(MICROBOT.limits, tau_max=np.ones(4)))


# what a limit is ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("", abs, None, 1.0), ("name", "text", "''")),
        (("speed", 3.0, None, 1.0), ("expression of limit 'speed'", "function", "float")),
        (("speed", abs), ("limit 'speed'", "lower", "upper bound")),
        (("speed", abs, 2.0, 1.0), ("lower bound", "limit 'speed'", "[2.0]", "[1.0]")),
        (("speed", abs, None, "fast"), ("upper bound", "limit 'speed'", "numbers", "'fast'")),
        (("speed", abs, None, np.nan), ("upper bound", "limit 'speed'", "[0]", "nan")),
    ],
)
def test_bad_limits_are_refused(arguments, said):
    with refused(*said):
        mo.Limit(*arguments)


def test_names_must_differ():
    twice = [mo.limits.tool_speed(1.0), mo.limits.tool_speed(2.0)]
    with refused("also", "two limits", "'tool speed'"):
        MICROBOT.with_limits(also=twice)
    with refused("also", "list", "'tool height'"):
        MICROBOT.with_limits(also=HEIGHT)


def test_an_expression_that_cannot_be_evaluated_is_named():
    robot = MICROBOT.with_limits(also=[mo.Limit("grip", lambda state: state.gripper, upper=1.0)])
    with refused("limit 'grip'", "'gripper'", "tool_velocity"):
        mo.time_optimal(robot, VIA_Q)


def test_bounds_must_have_the_width_of_the_expression():
    robot = MICROBOT.with_limits(also=[mo.limits.power([1.0, 2.0])])
    with refused("upper bound", "limit 'power'", "3", "not 2"):
        LimitFamily.of(robot)


def test_robots_differ_by_their_further_limits():
    slow, fast = (MICROBOT.with_limits(also=[mo.limits.tool_speed(v)]) for v in (1.0, 2.0))
    assert slow == MICROBOT.with_limits(also=[mo.limits.tool_speed(1.0)])
    assert hash(slow) == hash(MICROBOT.with_limits(also=[mo.limits.tool_speed(1.0)]))
    assert slow != fast
    assert slow != MICROBOT
    assert slow.with_limits(qd_max=1.0).limits.also == slow.limits.also


# values -------------------------------------------------------------------------------------------


def test_values_are_those_of_the_models():
    members = [
        mo.limits.tool_speed(1.0),
        mo.limits.power(300.0),
        mo.limits.total_power(500.0),
        HEIGHT,
    ]
    robot = MICROBOT.with_limits(also=members, qddd_max=50.0, taud_max=1e3)
    given = samples(robot)
    values = {key: v.value for key, v in LimitFamily.of(robot).values(given).items()}
    jacobian, pose = mo.jacobian(robot), mo.forward_kinematics(robot)
    for k in range(len(given.q)):
        q, qd, qdd, _ = (rows[k] for rows in given)
        velocity = np.array(jacobian(q)) @ qd
        tau = np.array(mo.inverse_dynamics(robot)(q, qd, qdd)).ravel()
        assert values["tool_speed"][k, 0] == pytest.approx(np.linalg.norm(velocity[:3]))
        assert values["tool_height"][k, 0] == pytest.approx(float(pose(q)[2, 3]))
        np.testing.assert_allclose(values["tau"][k], tau, rtol=1e-12)
        np.testing.assert_allclose(values["power"][k], tau * qd, rtol=1e-12)
        assert values["total_power"][k, 0] == pytest.approx(float(tau @ qd))
    np.testing.assert_array_equal(values["qddd"], given.qddd)


def test_torque_rate_tool_acceleration_and_jerk_are_slopes():
    """Against central differences along a quartic motion."""
    robot = MICROBOT.with_limits(
        taud_max=1e3,
        also=[
            mo.Limit("tool acceleration", lambda s: s.tool_acceleration, upper=1e3),
            mo.Limit("tool jerk", lambda s: s.tool_jerk, upper=1e4),
        ],
    )
    family = LimitFamily.of(robot)
    q0, qd0, qdd0, qddd0 = (rows[0] for rows in samples(robot, 1))

    def at(t):
        q = q0 + t * qd0 + t**2 / 2 * qdd0 + t**3 / 6 * qddd0
        return q, qd0 + t * qdd0 + t**2 / 2 * qddd0, qdd0 + t * qddd0

    step = 1e-4
    values = family.values(
        MotionSamples(*(rows[:1] for rows in (q0[None], qd0[None], qdd0[None], qddd0[None])))
    )
    tau = [np.array(mo.inverse_dynamics(robot)(*at(t))).ravel() for t in (-step, step)]
    np.testing.assert_allclose(
        values["taud"].value[0], np.subtract(*tau[::-1]) / (2 * step), rtol=1e-5
    )
    times = (-step, 0.0, step)
    velocity = [np.array(mo.jacobian(robot)(at(t)[0])) @ at(t)[1] for t in times]
    slope = (velocity[2] - velocity[0]) / (2 * step)
    np.testing.assert_allclose(values["tool_acceleration"].value[0], slope, rtol=1e-5, atol=1e-6)
    bend = np.diff(velocity, n=2, axis=0)[0] / step**2
    np.testing.assert_allclose(values["tool_jerk"].value[0], bend, rtol=1e-5, atol=1e-5)


def test_slopes_at_rest_are_numbers():
    """A norm has no slope at zero; limits of it have."""
    robot = MICROBOT.with_limits(also=[mo.limits.tool_speed(1.0)])
    state = [ca.MX.sym(name, 3) for name in "abcd"]
    value = LimitFamily.of(robot).expressions(["tool_speed"], state)["tool_speed"][0]
    slopes = ca.Function(
        "slopes", state, [value, ca.jacobian(value, state[1]), *ca.hessian(value, state[1])]
    )
    for number in slopes(VIA_Q[1], 0, 0, 0):
        assert np.isfinite(np.array(number)).all()
    assert float(slopes(VIA_Q[1], 0, 0, 0)[0]) == pytest.approx(0.0, abs=1e-9)


def test_a_table_may_bound_a_limit():
    """An interpolant exists as an MX function only."""
    table = ca.interpolant("torque", "linear", [[0.0, 1.0, 2.0]], [400.0, 300.0, 100.0])
    curve = mo.Limit(
        "torque by speed",
        lambda s: s.tau[0],
        upper=lambda s: table(ca.fabs(s.qd[0])),
        unit="N m",
    )
    family = LimitFamily.of(MICROBOT.with_limits(also=[curve]))
    zero = np.zeros((1, 3))
    qd = np.array([[1.5, 0.0, 0.0]])
    values = family.values(MotionSamples(zero, qd, zero, zero))["torque_by_speed"]
    assert values.upper == pytest.approx(200.0)


@given(st.floats(-4.0, 4.0), st.floats(-3.0, -0.1), st.floats(0.1, 3.0))
@settings(max_examples=50, deadline=None)
def test_use_is_one_at_the_bounds_and_grows_outwards(value, lower, upper):
    limit = mo.Limit("speed", lambda s: s.qd[0], lower=lower, upper=upper)
    family = LimitFamily.of(MICROBOT.with_limits(also=[limit]))
    rows = np.zeros((4, 3))
    qd = rows.copy()
    qd[:, 0] = [value, lower, upper, 0.0]
    use = family.use(MotionSamples(rows, qd, rows, rows), ["speed"])["speed"].ravel()
    assert use[1:] == pytest.approx([1.0, 1.0, 0.0])
    assert (use[0] > 1.0) == (value < lower or value > upper) or use[0] == pytest.approx(1.0)


# consumers ----------------------------------------------------------------------------------------


FURTHER = {
    "tool speed": {"also": [mo.limits.tool_speed(4.0)]},
    "tool acceleration": {"also": [mo.limits.tool_acceleration(20.0)]},
    "tool jerk": {"also": [mo.limits.tool_jerk(300.0)]},
    "total power": {"also": [mo.limits.total_power(500.0, -400.0)]},
    "jerk": {"qddd_max": 200.0},
    "own": {
        "also": [
            mo.Limit(
                "motor torque",
                lambda s: s.tau,
                lower=lambda s: -450.0 * (1.0 + s.qd / 4.0),
                upper=lambda s: 450.0 * (1.0 - s.qd / 4.0),
                unit="N m",
            )
        ]
    },
    "zone": {
        "also": [
            mo.Limit(
                "tool speed",
                lambda s: ca.norm_2(s.tool_velocity[:3]),
                upper=lambda s: 3.0 + ca.tanh(4.0 * (s.tool[2, 3] - 5.0)),
                unit="m/s",
            )
        ]
    },
}


LONG = (
    "tool acceleration",
    "tool jerk",
    "total power",
    "zone",
    "jerk",
)  # jerks are those of other tests, too


@pytest.fixture(scope="module")
def plain():
    """The fastest motion under the robot's own limits."""
    return mo.time_optimal(MICROBOT, VIA_Q, mesh=40, starts=1)


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind",
    [pytest.param(kind, marks=() if kind == "own" else pytest.mark.thorough) for kind in FURTHER],
)
def test_free_motions_keep_it_and_certificates_judge_it(kind, plain):
    robot = MICROBOT.with_limits(**FURTHER[kind])
    motion = mo.time_optimal(robot, VIA_Q, mesh=20, starts=1)
    assert motion.solved
    certificate = mo.certify(robot, motion)
    assert certificate.ok
    assert motion.duration > plain.duration
    member = LimitFamily.of(robot).members[-1]
    judged = mo.certify(robot, plain)  # what knows nothing of the limit breaks it
    broken = {check.quantity: check for check in judged.limit_checks}
    key = "qddd" if kind == "jerk" else member.key
    assert broken[key].violation > 0.005
    assert not judged.ok
    assert broken[key].name in judged.verdict


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind",
    [pytest.param(kind, marks=pytest.mark.thorough if kind in LONG else ()) for kind in FURTHER],
)
def test_paths_are_timed_under_it(kind):
    robot = MICROBOT.with_limits(**FURTHER[kind])
    path = mo.straight_path(VIA_Q[[0, 2]])
    motion = mo.time_optimal_path(robot, path)
    assert motion.solved
    assert mo.certify(robot, motion).ok
    kept = motion.provenance["limits_kept_by"]
    name = {"own": "motor torque", "zone": "tool speed"}.get(kind, kind)
    home = "speed bound" if name == "tool speed" else "program on places"
    assert name in kept[home]
    assert "torque" in kept["reachability"]


@pytest.mark.slow
@pytest.mark.parametrize("kind", sampled(FURTHER, 5))
def test_shapes_are_scaled_to_it(kind):
    robot = MICROBOT.with_limits(**FURTHER[kind]).with_limits(tau_max=1e4, qd_max=100.0)
    found = mo.shortest_duration(robot, mo.quintic(VIA_Q, [0.0, 1.0, 2.0]))
    assert found.utilisation == pytest.approx(1.0, abs=1e-6)
    member = LimitFamily.of(robot).members[-1]
    assert found.quantity == ("qddd" if kind == "jerk" else member.key)
    motion = mo.Motion.from_polynomial(robot, found.polynomial, label="scaled")
    assert mo.certify(robot, motion).worst_violation < 1e-4


def test_affine_limits_are_half_planes_for_reachability():
    """A bound on each component of the tool's acceleration is affine in s'' and s'^2."""
    limit = mo.Limit("lift", lambda s: s.tool_acceleration[:3], lower=-8.0, upper=8.0, unit="m/s^2")
    robot = MICROBOT.with_limits(also=[limit])
    path = mo.straight_path(VIA_Q[[0, 2]])
    timing = mo.planning.time_path(robot, path)
    assert "lift" in timing.limits_kept_by["reachability"]
    history = limit_history(robot, timing.motion())
    assert np.percentile(history.use["lift"].max(axis=1), 99.0) <= 1.01
    assert timing.duration > mo.planning.time_path(MICROBOT, path).duration


@pytest.mark.parametrize(
    "expression",
    [lambda state: state.tool[2, 3] >= 0.2, lambda state: ca.vertcat(state.qd[0] <= 1, state.q[0])],
)
def test_a_relation_is_no_expression_of_a_limit(expression):
    robot = mo.load_robot("microbot").with_limits(also=[mo.Limit("height", expression, upper=1)])
    with refused("limit 'height'", "relation"):
        mo.time_optimal(robot, [[0.0, 0.0, 0.0], [0.3, 0.3, 0.3]])


def test_a_pose_that_breaks_a_limit_is_refused_before_any_solver():
    robot = MICROBOT.with_limits(
        also=[mo.Limit("tool height", HEIGHT.expression, lower=3.0, unit="m")]
    )
    with refused("via point 1", "tool height", "2 m", "3 to inf m"):
        mo.time_optimal(robot, VIA_Q)
    with refused("tool height", "2 m", "0 s", "3 m"):
        mo.shortest_duration(robot, mo.cubic(VIA_Q, [0.0, 1.0, 2.0]))


def test_a_prepared_solver_takes_other_numbers_and_refuses_other_expressions():
    robot = two_link_arm(1.0, 0.8).with_limits(
        tau_max=[60.0, 25.0], qd_max=3.0, also=[mo.limits.tool_speed(2.0)]
    )
    via_q, settings = [[0.0, 0.3], [1.2, -0.6]], {"mesh": 40, "starts": 1, "compiled": False}
    solver = mo.TimeOptimalSolver(robot, via_q, **settings)
    slower = robot.with_limits(also=[mo.limits.tool_speed(1.0)])
    cold = mo.time_optimal(slower, via_q, starts=1, compiled=False)
    assert solver(slower.limits).duration == pytest.approx(cold.duration, rel=1e-4)
    other = robot.with_limits(also=[mo.Limit("tool speed", lambda s: s.qd[0], upper=1.0)])
    with refused("limit 'tool speed'", "another expression"):
        solver(other.limits)


# files --------------------------------------------------------------------------------------------


def test_files_hold_the_members_of_the_package(tmp_path):
    robot = MICROBOT.with_limits(
        qddd_max=80.0,
        also=[mo.limits.tool_speed(1.5), mo.limits.power([300.0, 400.0, 150.0], -50.0)],
    )
    mo.save_robot(robot, tmp_path / "arm.toml")
    again = mo.load_robot(tmp_path / "arm.toml")
    assert again == robot
    assert limits_from_table(limits_to_table(robot.limits.also)) == robot.limits.also
    with refused("limit 'tool height'", "expression", "file"):
        mo.save_robot(MICROBOT.with_limits(also=[HEIGHT]), tmp_path / "own.toml")
