"""Stops and other speeds on the path of a motion under way, against closed forms on a rail."""

import numpy as np
import pytest

import microbot_ocp as mo
from helpers import refused
from planning.shared import pendulum, slider


@pytest.fixture(scope="module")
def rail():
    return slider(mass=2.0, tau_max=4.0)


def test_a_stop_and_another_speed_come_as_soon_as_the_torque_lets_them(rail):
    motion = mo.Motion.from_polynomial(rail, mo.cubic([[0.0], [1.6]], [0.0, 2.5]), label="cubic")
    q, qd = (float(row[0, 0]) for row in motion.sample([1.0])[:2])
    stop = mo.execution.overridden(rail, motion, 1.0, 0.0)
    assert stop.solved
    assert mo.certify(rail, stop).ok
    np.testing.assert_allclose([stop.q[0, 0], stop.qd[0, 0]], [q, qd], atol=1e-9)
    assert stop.duration == pytest.approx(qd / 2.0, rel=2e-3)
    assert stop.q[-1, 0] == pytest.approx(q + qd**2 / 4.0, abs=2e-3)
    assert abs(stop.qd[-1, 0]) < 1e-9
    half = mo.execution.overridden(rail, motion, 1.0, 0.5)
    changed = half.sample([half.provenance["changed_at"] + 1e-6])
    assert half.solved
    assert mo.certify(rail, half).ok
    planned = np.interp(changed.q[0, 0], motion.q[:, 0], motion.qd[:, 0])
    assert changed.qd[0, 0] == pytest.approx(0.5 * planned, rel=1e-3)
    braking = half.sample([0.5 * half.provenance["changed_at"]]).qdd
    assert braking[0, 0] == pytest.approx(-2.0, rel=2e-3)
    on = mo.execution.overridden(rail, motion, stop.provenance["at"], 1.0, current=0.0)
    assert on.solved
    assert mo.certify(rail, on).ok
    assert on.q[-1, 0] == pytest.approx(1.6, abs=1e-9)


@pytest.mark.thorough
@pytest.mark.slow
def test_an_arm_under_gravity_keeps_its_torques_at_every_speed(microbot):
    via_q = np.radians([[0, 0, 0], [-90, 90, 90]])
    shape = mo.shortest_duration(microbot, mo.cubic(via_q, [0.0, 3.0])).polynomial
    motion = mo.Motion.from_polynomial(microbot, shape, label="cubic")
    for at, speed in ((0.5 * motion.duration, 0.0), (0.3 * motion.duration, 0.7)):
        other = mo.execution.overridden(microbot, motion, at, speed)
        assert other.solved
        certificate = mo.certify(microbot, other)
        assert certificate.ok, certificate.verdict
    assert mo.execution.overridden(microbot, motion, 0.0, 1.0).duration <= 1.001 * motion.duration


@pytest.mark.thorough
def test_an_arm_that_brakes_as_hard_as_it_can_has_no_sooner_stop(rail):
    """Between places of an even grid limits were exceeded by 0.3 %."""
    motion = mo.time_optimal(rail, [[0.0], [1.6]], compiled=False, starts=1)
    for at in motion.duration * np.array([0.7, 0.9, 0.97]):
        stop = mo.execution.overridden(rail, motion, at, 0.0)
        assert stop.solved
        assert stop.duration == pytest.approx(motion.duration - at, rel=1e-2)


def test_no_stop_is_where_the_arm_cannot_hold_itself():
    swing = pendulum(tau_max=5.0)  # the cubic takes up to 8.7 N m; 9.8 hold the arm level
    motion = mo.Motion.from_polynomial(swing, mo.cubic([[0.0], [2.2]], [0.0, 1.5]), label="cubic")
    most = np.abs(motion.tau).max()
    stop = mo.execution.overridden(swing, motion, 0.75, 0.0)
    assert stop.solved
    assert 9.81 * np.sin(stop.q[-1, 0]) <= 1.001 * most < 9.5
    level = mo.execution.overridden(swing, motion, 0.97, 1.0, current=0.0)
    assert level.status is mo.Status.INFEASIBLE


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ((2.5, 0.5), ("at", "motion", "2.5 s", "not 2.5")),
        ((1.0, 1.5), ("speed", "at most 1", "1.5")),
        ((1.0, 0.0, 0.0), ("speed", "above 0", "rests")),
    ],
)
def test_what_is_no_override_is_refused(rail, arguments, told):
    motion = mo.Motion.from_polynomial(rail, mo.cubic([[0.0], [1.6]], [0.0, 2.5]), label="cubic")
    at, speed, *current = arguments
    more = {"current": current[0]} if current else {}
    with refused(*told):
        mo.execution.overridden(rail, motion, at, speed, **more)


@pytest.mark.parametrize(
    ("slower", "limits"),
    [
        pytest.param(1.3, {"taud_max": 30.0}, id="torque rate"),
        *(
            pytest.param(slower, limits, id=name, marks=pytest.mark.thorough)
            for name, slower, limits in (
                ("jerk", 1.3, {"qddd_max": 15.0}),
                ("power", 1.0, {"also": [mo.limits.power(upper=6.0)]}),
                ("tool acceleration", 1.0, {"also": [mo.limits.tool_acceleration(2.0)]}),
                ("tool speed", 1.0, {"also": [mo.limits.tool_speed(1.2)]}),
            )
        ),
    ],
)
def test_limits_that_are_no_half_planes_are_kept_as_well(rail, slower, limits):
    robot = rail.with_limits(**limits)
    via_q = [[0.0], [1.6]]
    fastest = mo.shortest_duration(robot, mo.quintic(via_q, [0.0, 2.5])).duration
    shape = mo.quintic(via_q, [0.0, slower * fastest])
    motion = mo.Motion.from_polynomial(robot, shape, label="quintic")
    at = 0.5 * motion.duration  # at its top speed, which the last limit bounds
    stop = mo.execution.overridden(robot, motion, at, 0.0, compiled=False)
    half = mo.execution.overridden(robot, motion, 0.3 * motion.duration, 0.5, compiled=False)
    rest = stop.provenance["at"]
    on = mo.execution.overridden(robot, motion, rest, 1.0, current=0.0, compiled=False)
    for other, begin, share in (
        (stop, at, 1.0),
        (half, 0.3 * motion.duration, 1.0),
        (on, rest, 0.0),
    ):
        certificate = mo.certify(robot, other)
        assert other.solved
        assert certificate.ok, certificate.verdict
        state = motion.sample([begin])
        np.testing.assert_allclose(other.q[0], state.q[0], atol=1e-9)
        np.testing.assert_allclose(other.qd[0], share * state.qd[0], atol=1e-9)
    assert stop.q[-1, 0] == pytest.approx(motion.sample([rest]).q[0, 0], abs=1e-9)
    assert abs(stop.qd[-1, 0]) < 1e-9
    assert stop.duration < 0.75 * motion.duration
    after = half.sample([half.provenance["changed_at"] + 1e-6])
    planned = np.interp(after.q[0, 0], motion.q[:, 0], motion.qd[:, 0])
    assert after.qd[0, 0] == pytest.approx(0.5 * planned, rel=1e-3)
    assert on.q[-1, 0] == pytest.approx(1.6, abs=1e-9)


def test_a_motion_that_exceeds_such_a_limit_itself_is_refused(rail):
    motion = mo.Motion.from_polynomial(rail, mo.cubic([[0.0], [1.6]], [0.0, 2.5]), label="cubic")
    with refused("torque rate", "jerk of joint 1", "0 s", "20 m/s^3"):
        mo.execution.overridden(rail, motion, 1.0, 0.5, limits=mo.Limits(qddd_max=20.0))
