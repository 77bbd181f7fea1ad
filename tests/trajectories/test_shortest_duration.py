"""Shortest durations: closed forms, the limits kept and met, refusals in words."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import microbot_ocp as mo
from helpers import refused
from microbot_ocp.limits import LimitFamily, LimitValues
from microbot_ocp.motion import State, torque_along
from microbot_ocp.robot import torque_and_rate
from microbot_ocp.trajectories import (
    cubic,
    lspb,
    quintic,
    shortest_duration,
)

VIA_Q = np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]])
VIA_T = [0.0, 2.0, 4.0]
VIA_QD = np.radians([[0, 0, 0], [10, 40, 20], [0, 0, 0]])
MASS = 3.0


def slider(**link):
    """One mass on a rail, without gravity."""
    return mo.Robot.from_dh(
        alpha=[0.0],
        a=[0.0],
        d=[0.0],
        joint_type="prismatic",
        links=[mo.Link(MASS, [0.0, 0.0, 0.0], **link)],
        gravity=(0.0, 0.0, 0.0),
    )


def dense(polynomial, points):
    """State and jerk at ``points`` a piece, both one-sided limits at each break."""
    velocity = polynomial.derivative()
    acceleration = velocity.derivative()
    orders = (polynomial, velocity, acceleration, acceleration.derivative())
    b = polynomial.breaks
    t = np.concatenate([np.linspace(s, e, points)[:-1] for s, e in pairwise(b)])
    return [np.vstack([f(t), f(b[1:], from_left=True)]) for f in orders]


def worst(robot, limits, polynomial, points=2000):
    """Largest value divided by its limit, for symmetric limits, by a plain dense grid."""
    q, qd, qdd, jerk = dense(polynomial, points)
    limits = limits.for_joints(robot.joint_count)
    values = {"qd": qd, "qdd": qdd}
    if np.isfinite(limits.tau_max).any():
        values["tau"] = torque_along(robot, State(q, qd, qdd))
    if np.isfinite(limits.taud_max).any():
        values["taud"] = np.array(torque_and_rate(robot)(q.T, qd.T, qdd.T, jerk.T)[1]).T
    return max(float((np.abs(v) / limits.bounds(kind)[1]).max()) for kind, v in values.items())


L = 1.7


@pytest.mark.parametrize(
    ("limits", "duration", "quantity", "unit"),
    [
        (mo.Limits(qd_max=0.8), 1.5 * L / 0.8, "qd", "m/s"),
        (mo.Limits(qdd_max=2.5), np.sqrt(6 * L / 2.5), "qdd", "m/s^2"),
        (mo.Limits(tau_max=2.5), np.sqrt(6 * L * MASS / 2.5), "tau", "N"),
        (mo.Limits(qd_max=0.8, qdd_max=20.0, tau_max=900.0), 1.5 * L / 0.8, "qd", "m/s"),
    ],
)
def test_closed_forms_of_the_rest_to_rest_cubic(limits, duration, quantity, unit):
    found = shortest_duration(slider(), cubic([[0.0], [L]], [0.0, 10.0]), limits)
    assert found.duration == pytest.approx(duration, rel=1e-7)
    assert found.factor == pytest.approx(duration / 10.0, rel=1e-7)
    assert (found.quantity, found.joint, found.unit) == (quantity, "joint 1", unit)
    assert abs(found.value) == pytest.approx(abs(found.limit), rel=1e-6)
    assert 1 - 1e-7 <= found.utilisation <= 1.0


RATE_LIMITS = {"taud": mo.Limits(taud_max=2.5 * MASS), "qddd": mo.Limits(qddd_max=2.5)}


@pytest.mark.parametrize("key", RATE_LIMITS)
def test_a_quintic_begins_and_ends_at_rest_under_limits_of_rates(key):
    found = shortest_duration(slider(), quintic([[0.0], [L]], [0.0, 1.0]), RATE_LIMITS[key])
    assert found.duration == pytest.approx(np.cbrt(60 * L / 2.5), rel=1e-7)
    assert found.quantity == key


@pytest.mark.parametrize("duration", [0.1, 1.0, 1e5])
@pytest.mark.parametrize(("key", "limit"), [("taud", "7.5 N/s"), ("qddd", "2.5 m/s^3")])
def test_no_duration_of_a_cubic_keeps_a_rate(key, limit, duration):
    """From rest its acceleration jumps to 6 L / T^2."""
    with refused("jumps", "'joint 1'", "0 s", limit, "quintic"):
        shortest_duration(slider(), cubic([[0.0], [L]], [0.0, duration]), RATE_LIMITS[key])


def test_asymmetric_limits():
    """Braking is the weaker side here: a = 6 L / T^2 at both ends."""
    limits = mo.Limits(qdd_max=(-1.0, 4.0))
    found = shortest_duration(slider(), cubic([[0.0], [L]], [0.0, 1.0]), limits)
    assert found.duration == pytest.approx(np.sqrt(6 * L), rel=1e-7)
    assert found.limit == -1.0
    assert found.time == pytest.approx(found.duration)


def test_viscous_friction_has_a_closed_form_for_the_trapezoid():
    """At the end of the first blend force is m v / t_b + b v, v = L / (T - t_b), t_b = T / 4."""
    friction, force = 2.0, 6.0
    found = shortest_duration(
        slider(viscous_friction=friction),
        lspb([[0.0], [L]], [0.0, 1.0], 0.25),
        mo.Limits(tau_max=force),
    )
    # m * (16/3) L / T^2 + b * (4/3) L / T = force
    x = np.roots([MASS * 16 / 3 * L, friction * 4 / 3 * L, -force]).max()
    assert found.duration == pytest.approx(1 / x, rel=1e-7)


@pytest.mark.parametrize("name", ["cubic", "lspb", "quintic"])
def test_the_report_motions_are_as_short_as_the_limits_allow(name):
    robot = mo.load_robot("microbot")
    shape = {
        "cubic": lambda: cubic(VIA_Q, VIA_T, VIA_QD),
        "lspb": lambda: lspb(VIA_Q, VIA_T, 0.5, VIA_QD),
        "quintic": lambda: quintic(VIA_Q, VIA_T, VIA_QD),
    }[name]()
    found = shortest_duration(robot, shape)
    # Durations that this project found; the dense checks below are what proves them.
    wanted = {"cubic": 2.6767585, "lspb": 3.0726320, "quintic": 2.8390055}[name]
    assert found.duration == pytest.approx(wanted, rel=1e-6)
    assert 1 - 1e-6 <= worst(robot, robot.limits, found.polynomial, 20_000) <= 1 + 1e-9
    assert worst(robot, robot.limits, found.polynomial.stretched(0.999)) > 1.0
    assert worst(robot, robot.limits, found.polynomial.stretched(1.5)) < 1.0


@pytest.mark.thorough
@pytest.mark.slow
@settings(max_examples=6, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from(["none", "viscous", "coulomb"]))
def test_any_shape_keeps_and_meets_its_limits(seed, friction):
    random = np.random.default_rng(seed)
    robot = mo.load_robot("microbot")
    amount = {"none": {}, "viscous": {"viscous_friction": 10.0}, "coulomb": {"coulomb_friction": 5}}
    links = [
        mo.Link(link.mass, link.center_of_mass, link.inertia, **amount[friction])
        for link in robot.links
    ]
    robot = robot.with_links(links)
    limits = mo.Limits(qd_max=3.0, qdd_max=20.0, tau_max=[500.0, 900.0, 400.0], taud_max=20_000.0)
    shape = quintic(random.uniform(-1.0, 1.0, (3, 3)), [0.0, 1.0, 2.0])
    found = shortest_duration(robot, shape, limits)
    # The test's own grid misses the very top by some 1e-6.
    assert 1 - 1e-5 <= worst(robot, limits, found.polynomial) <= 1 + 1e-9
    assert found.utilisation >= 1 - 1e-7
    assert worst(robot, limits, found.polynomial.stretched(0.999)) > 1.0
    bisected = shortest_duration(robot, shape, limits, scan=False)
    assert worst(robot, limits, bisected.polynomial) <= 1 + 1e-9
    assert bisected.duration >= found.duration * (1 - 1e-7)
    assert bisected.iterations <= found.iterations


@pytest.mark.slow
def test_a_callable_of_the_duration():
    robot = mo.load_robot("microbot")
    shape = lspb(VIA_Q, VIA_T, 0.5)
    found = shortest_duration(robot, lambda T: lspb(VIA_Q, [0, T / 2, T], T / 8))
    assert found.duration == pytest.approx(shortest_duration(robot, shape).duration, rel=1e-6)
    assert np.isnan(found.factor)


def test_a_callable_that_refuses_short_durations():
    """Blends of 0.3 s need segments of 0.6 s."""
    robot = mo.load_robot("microbot").with_limits(mo.Limits(qd_max=50.0))
    found = shortest_duration(robot, lambda T: lspb(VIA_Q, [0, T / 2, T], 0.3))
    assert found.duration == pytest.approx(1.2, rel=1e-9)
    assert found.quantity == "shape"


def test_limit_use():
    limits = mo.Limits(q_min=-1.0, q_max=3.0, qd_max=(-1.0, 2.0), tau_max=(0.0, 10.0), qdd_max=0.0)
    family = LimitFamily.of(slider(), limits)

    def values(key, given):
        return LimitValues(np.array(given)[:, None], family[key].lower, family[key].upper)

    def use(key, *given):
        return family[key].use(values(key, given)).ravel().tolist()

    assert use("q", -1.0, 1.0, 3.0, 5.0) == [1.0, 0.0, 1.0, 2.0]
    assert use("qd", -1.0, 0.0, 1.0, 4.0) == [1.0, 0.0, 0.5, 2.0]
    assert family["qd"].nearest_bound(values("qd", [-0.4, 1.0])).ravel().tolist() == [-1.0, 2.0]
    # A limit of zero is not used at rest.
    assert use("tau", 0.0, 5.0, -1.0) == [0.0, 0.5, 2.0]
    assert use("qdd", 0.0)[0] <= 0.0
    assert use("qdd", 0.1)[0] > 1.0


def refuse(limits, shape=None):
    robot = mo.load_robot("microbot")
    shortest_duration(robot, shape or cubic(VIA_Q, VIA_T, VIA_QD), limits)


REFUSALS = [
    (
        lambda: refuse(mo.Limits(tau_max=[400.0, 150.0, 200.0])),
        ("(0 deg, 0 deg, 0 deg)", "196 N m", "'shoulder'", "-150 to 150 N m"),
    ),
    (
        lambda: refuse(mo.Limits(q_max=1.0, qd_max=1.0)),
        ("'elbow'", "90 deg (1.5708 rad)", "4 s", "57.2958 deg"),
    ),
    (lambda: refuse(mo.Limits(q_max=4.0)), ("limits", "finite", "qd_max, qdd_max, tau_max")),
    (lambda: refuse(mo.Limits(taud_max=1e3)), ("torque", "'waist'", "2 s", "1000 N m/s")),
    (
        lambda: refuse(
            mo.Limits(qd_max=[np.inf, np.inf, 1.0]), cubic([[0] * 3, [1, 1, 0]], [0, 1])
        ),
        ("make_motion", "no limit"),
    ),
    (
        lambda: refuse(mo.Limits(qd_max=1.0), cubic([[0], [1]], [0, 1])),
        ("make_motion", "1 joints", "robot", "3"),
    ),
    (
        lambda: refuse(mo.Limits(qd_max=1.0), 3.0),
        ("make_motion", "PiecewisePolynomial", "function", "3.0"),
    ),
    (
        lambda: refuse(mo.Limits(qd_max=1.0), lambda T: T),
        ("make_motion", "PiecewisePolynomial", "float"),
    ),
    (
        lambda: refuse(mo.Limits(qd_max=1.0), lambda T: cubic(VIA_Q, VIA_T)),
        ("make_motion(1)", "1 s", "4 s"),
    ),
    (
        lambda: refuse(mo.Limits(tau_max=100.0), lambda T: cubic(VIA_Q, [0, T / 2, T])),
        ("0 s", "196 N m", "'shoulder'", "-100 to 100 N m"),
    ),
]


@pytest.mark.parametrize(("call", "message"), REFUSALS)
def test_refusals(call, message):
    with refused(*message):
        call()


def test_a_robot_without_masses_can_be_limited_in_speed_only():
    robot = mo.Robot.from_dh(alpha=[0.0], a=[0.0], d=[0.0])
    shape = cubic([[0.0], [1.0]], [0.0, 1.0])
    assert shortest_duration(robot, shape, mo.Limits(qd_max=1.5)).duration == pytest.approx(1.0)
    with refused("tau_max", "'robot'", "masses"):
        shortest_duration(robot, shape, mo.Limits(tau_max=1.5))


def test_torque_rate_is_the_slope_of_the_torque():
    robot = mo.load_robot("microbot")
    q, qd, qdd, jerk = np.random.default_rng(1).uniform(-1, 1, (4, 3))
    step = 1e-5

    def torque(t):
        return mo.inverse_dynamics(robot)(
            q + t * qd + t**2 / 2 * qdd + t**3 / 6 * jerk,
            qd + t * qdd + t**2 / 2 * jerk,
            qdd + t * jerk,
        ).full()

    slope = (torque(step) - torque(-step)) / (2 * step)
    rate = torque_and_rate(robot)(q, qd, qdd, jerk)[1].full()
    np.testing.assert_allclose(rate, slope, rtol=1e-7)


def test_a_shape_keeps_its_limits_however_little_time_there_is() -> None:
    robot = mo.load_robot("panda")
    shape = quintic([np.zeros(7) + 0.1, np.full(7, 1.0)], [0.0, 0.01], np.zeros((2, 7)))
    limits = mo.Limits(qd_max=1.0)
    found = shortest_duration(robot, shape, limits, time_limit=1e-9)
    assert found.status is mo.Status.TIME_LIMIT
    assert found.utilisation <= 1.0
