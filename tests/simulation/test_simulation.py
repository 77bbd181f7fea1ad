"""Simulations against closed forms, integrators against their tolerances, inputs refused."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import microbot_ocp as mo
from helpers import random_robot, refused, tells
from microbot_ocp.simulation import INTEGRATORS

# Course report, part 4a, recomputed: torques of the exponential motion, N m, by gravity and time.
REPORT_TORQUES = {
    (0.0, 0.0, -9.8): [
        (0.0, [235.61944901923476, 2058.585137187041, 1059.9021878651968]),
        (0.05, [224.4086219137247, 1557.0156511923399, 776.2547956091713]),
        (0.25, [520.3855648533712, 378.8565676747693, 75.7828007178992]),
        (0.5, [9.800997514635919, -68.77489923878784, -82.43213772406673]),
        (1.0, [-186.15243234564886, -55.397267151766165, -43.35613610725396]),
        (2.0, [-5.227998812758696, 61.50629782183369, -10.189459776884727]),
    ],
    (0.0, -9.8, 0.0): [
        (0.0, [294.4194490192347, 1861.192208074477, 1004.4650162201714]),
        (0.05, [286.6265997229219, 1358.6680816686705, 719.3423186900068]),
        (0.25, [641.0598693993358, 174.43481118970124, 2.8708126958852915]),
        (0.5, [200.96547345519963, -265.66226230623494, -160.81329709970748]),
        (1.0, [-44.196650494228265, -258.78372421189255, -119.09930142086182]),
        (2.0, [62.0107280155575, -138.08445843247506, -69.12791627357439]),
    ],
    (0.0, 0.0, 0.0): [
        (0.0, [235.61944901923476, 1975.4293797195025, 1059.9021878651968]),
        (0.05, [224.4086219137247, 1470.3046973718156, 773.9257320571601]),
        (0.25, [520.3855648533712, 239.01437752857467, 37.421416898961816]),
        (0.5, [9.800997514635917, -261.4356025585574, -158.40613751147424]),
        (1.0, [-186.15243234564883, -212.13210726918606, -93.57987803348333]),
        (2.0, [-5.227998812758695, -30.308544647580064, -15.882341326481674]),
    ],
}


def report_motion(t):
    return [np.pi / 4 * (1 + 6 * ca.exp(-t / 0.3) - 8 * ca.exp(-t / 0.4))] * 3


def report_torque(robot):
    def torque(t):
        q = ca.vertcat(*report_motion(t))
        qd = ca.jacobian(q, t)
        return mo.inverse_dynamics(robot)(q, qd, ca.jacobian(qd, t))

    return torque


@pytest.fixture(scope="module")
def robot():
    return mo.load_robot("microbot").with_limits(mo.Limits())


def pendulum(gravity=9.81, **link):
    """A point mass of 2 kg at 0.5 m, swinging in a vertical plane; it hangs at q = 0."""
    return mo.Robot.from_dh(
        [0.0], [0.0], [0.0], links=[mo.Link(2.0, [0.5, 0, 0], **link)], gravity=(gravity, 0, 0)
    )


def slider(**link):
    """A vertical prismatic joint of 3 kg."""
    return mo.Robot.from_dh(
        [0.0], [0.0], [0.0], joint_type="prismatic", links=[mo.Link(3.0, [0.1, 0, 0], **link)]
    )


@pytest.mark.parametrize("gravity", REPORT_TORQUES)
def test_the_reports_torques(robot, gravity):
    motion = mo.simulation.motion_from_formula(
        robot.with_gravity(gravity), report_motion, 2.0, label="report", step=0.05
    )
    for t, tau in REPORT_TORQUES[gravity]:
        at = int(np.abs(motion.t - t).argmin())
        assert motion.t[at] == pytest.approx(t, abs=1e-12)
        np.testing.assert_allclose(motion.tau[at], tau, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_forward_dynamics_give_the_reports_motion_back(robot, integrator):
    motion = mo.simulation.motion_from_formula(robot, report_motion, 2.0, label="report", step=0.05)
    errors = []
    for tolerance in (1e-4, 1e-7, 1e-10):
        run = mo.simulate(robot, report_torque(robot), motion.q[0], motion.qd[0], motion.t,
                          integrator=integrator, tolerance=tolerance)  # fmt: skip
        assert run.solved, run.advice
        assert run.integrator == integrator
        errors.append(np.abs(run.q - motion.q).max())
    # the open loop is unstable: errors grow a hundredfold in 2 s
    assert errors[0] < 1e-2
    assert errors[2] < 1e-7
    assert errors[0] > 5 * errors[1] > 25 * errors[2]
    np.testing.assert_allclose(run.qdd, motion.qdd, atol=1e-5)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_a_prismatic_joint_falls_freely(integrator):
    t = np.linspace(1.0, 2.5, 31)
    run = mo.simulate(slider(), None, [2.0], [0.5], t, integrator=integrator)
    assert run.solved
    assert run.tau.shape == (31, 1)
    fallen = t - t[0]
    np.testing.assert_allclose(run.q[:, 0], 2.0 + 0.5 * fallen - 4.905 * fallen**2, atol=1e-8)
    np.testing.assert_allclose(run.qd[:, 0], 0.5 - 9.81 * fallen, atol=1e-8)
    np.testing.assert_allclose(run.qdd, -9.81, atol=1e-12)


def test_a_pendulum_at_a_small_angle():
    t = np.linspace(0.0, 5.0, 101)
    run = mo.simulate(pendulum(), None, [1e-4], t=t, tolerance=1e-13)
    np.testing.assert_allclose(run.q[:, 0], 1e-4 * np.cos(np.sqrt(9.81 / 0.5) * t), atol=2e-11)


def test_a_pendulum_at_a_large_angle_has_the_period_of_the_elliptic_integral():
    """T = 2 pi sqrt(l/g) / agm(1, cos(q0/2)); after one period it is where it began."""
    mean, other = 1.0, np.cos(1.0)
    while abs(mean - other) > 1e-15:
        mean, other = 0.5 * (mean + other), np.sqrt(mean * other)
    period = 2 * np.pi * np.sqrt(0.5 / 9.81) / mean
    run = mo.simulate(pendulum(), None, [2.0], t=[0.0, 0.5 * period, period], tolerance=1e-12)
    np.testing.assert_allclose(run.q[:, 0], [2.0, -2.0, 2.0], atol=1e-9)


def test_viscous_friction_lets_speed_decay():
    t = np.linspace(0.0, 2.0, 21)
    run = mo.simulate(slider(viscous_friction=1.5), [3.0 * 9.81], [0.0], [2.0], t)
    np.testing.assert_allclose(run.qd[:, 0], 2.0 * np.exp(-0.5 * t), atol=1e-9)


@pytest.mark.parametrize("name", ["rr", "rprr"])
def test_energy_is_kept(name):
    robot = random_robot(name)
    n = robot.joint_count
    t = np.linspace(0.0, 2.0, 201)
    run = mo.simulate(robot, None, np.full(n, 0.3), np.full(n, 0.5), t, tolerance=1e-12)
    assert run.solved
    total = np.array(mo.energy(robot).map(t.size)(run.q.T, run.qd.T)).sum(axis=0)
    assert np.ptp(total) < 1e-7 * max(1.0, np.abs(total).max())


def test_jumping_torque_of_a_motion_costs_no_digits(robot):
    shape = mo.lspb(np.radians([[0, 0, 0], [-8, 45, 30]]), [0.0, 2.0], 0.5)
    motion = mo.Motion.from_polynomial(robot, shape, label="lspb")
    for integrator in ("dop853", "cvodes", "rk"):
        run = mo.simulate(robot, motion, integrator=integrator, tolerance=1e-12)
        np.testing.assert_allclose(run.q, motion.q, atol=1e-8)
    # The stored torques count, whoever is driven by them.
    heavy = robot.with_links([mo.Link(1.2 * k.mass, k.center_of_mass) for k in robot.links])
    assert np.abs(mo.simulate(heavy, motion).q - motion.q).max() > 0.05


@pytest.mark.slow
@pytest.mark.parametrize("arm", [mo.load_robot("microbot"), slider().with_gravity([0, 0, 0])])
def test_an_arm_that_waits_is_not_stepped_over(arm):
    """At rest nothing changes, at the edge of a piece neither: a free step may jump over both."""
    start = np.full(arm.joint_count, 0.3)
    wait = np.zeros((1, 6, start.size))
    wait[0, 0] = start
    go = mo.quintic([start, start + 0.4], [0.0, 2.0]).coefficients
    shape = mo.motion.PiecewisePolynomial([0.0, 2.0, 4.0], np.concatenate([wait, go]))
    motion = mo.Motion.from_polynomial(arm, shape, label="wait, then go")
    for integrator in ("dop853", "cvodes", "idas", "rk"):
        run = mo.simulate(arm, motion, integrator=integrator)
        assert run.solved, run.advice
        np.testing.assert_allclose(run.q, motion.q, atol=1e-5)
    assert mo.certify(arm, motion, mo.Limits()).ok


def test_torques_on_a_grid_are_linear_in_between():
    """A slider under a force that rises linearly: position of third order."""
    t = np.array([0.0, 0.5, 2.0])
    push = 3.0 * 9.81 + 6.0 * t[:, None]
    run = mo.simulate(slider(), push, [0.0], t=t)
    np.testing.assert_allclose(run.q[:, 0], t**3 / 3, atol=1e-8)
    kinked = np.array([[3.0 * 9.81], [3.0 * 9.81], [3.0 * 9.81 + 9.0]])
    run = mo.simulate(slider(), kinked, [0.0], t=t)
    np.testing.assert_allclose(run.q[:, 0], [0.0, 0.0, 2.0 / 6 * 1.5**3], atol=1e-8)


def test_a_result_becomes_a_motion():
    run = mo.simulate(slider(), None, [0.0], t=np.linspace(1.0, 2.0, 11))
    motion = run.as_motion("fall")
    assert motion.t[0] == 0.0
    assert motion.label == "fall"


def through_the_upright(robot):
    shape = mo.quintic(np.radians([[0, 60, 0], [60, 120, 0]]), [0.0, 2.0])
    return mo.Motion.from_polynomial(robot, shape, label="through the upright")


def test_singular_mass_matrix_is_told_with_advice(robot):
    run = mo.simulate(robot, through_the_upright(robot))
    assert not run.solved
    assert run.condition_peak > 1e12
    assert run.condition_time == pytest.approx(1.0, abs=1e-3)
    tells(run.advice, "condition number", "armature")

    with refused("singular", "q0 =", "condition number", "armature"):
        mo.simulate(robot, None, [0.0, np.pi / 2, 0.0], t=[0.0, 1.0])


def test_armature_heals_it(robot):
    links = [mo.Link(k.mass, k.center_of_mass, armature=0.1) for k in robot.links]
    arm = robot.with_links(links)
    motion = through_the_upright(arm)
    run = mo.simulate(arm, motion)
    assert run.solved
    np.testing.assert_allclose(run.q, motion.q, atol=1e-5)


def test_too_few_steps_are_told(robot):
    run = mo.simulate(robot, None, [0.0, 0.5, 0.5], t=[0.0, 3.0], max_steps=5)
    assert run.status is mo.Status.INTEGRATION_FAILED
    tells(run.advice, "max_steps")
    assert np.isnan(run.q).all()


SLIDER = slider(armature=0.0).with_limits(mo.Limits(q_min=-1.0, q_max=1.0))
BAD_INPUTS = [
    (lambda: mo.simulate(SLIDER, None, [0.0]), ("t and q0", "tau", "Motion")),
    (lambda: mo.simulate(SLIDER, None, [0.0], t=[0.0, 1.0, 1.0]), ("t[2] is 1 s", "t[1] of 1 s")),
    (lambda: mo.simulate(SLIDER, None, [0.0], t=[0.0]), ("t", "two", "s,", "[0.0]")),
    (lambda: mo.simulate(SLIDER, None, [0.0, 0.0], t=[0, 1]), ("q0", "shape [1]", "[2]")),
    (lambda: mo.simulate(SLIDER, None, [0.0], [0, 0], [0, 1]), ("qd0", "shape [1]", "[2]")),
    (lambda: mo.simulate(SLIDER, None, [1.5], t=[0, 1]), ("q0", "joint 1", "1.5 m", "[-1, 1] m")),
    (lambda: mo.simulate(SLIDER, [1.0, 2.0], [0.0], t=[0, 1]), ("tau", "shape [1]", "[2]")),
    (lambda: mo.simulate(SLIDER, [[1.0]], [0.0], t=[0, 1]), ("tau", "shape [2, 1]", "[1, 1]")),
    (
        lambda: mo.simulate(SLIDER, lambda t: [t, t], [0.0], t=[0, 1]),
        ("tau", "1 expressions", "(2, 1)"),
    ),
    (
        lambda: mo.simulate(SLIDER, lambda t: "t", [0.0], t=[0, 1]),
        ("tau", "1 CasADi expressions", "(str)"),
    ),
    (
        lambda: mo.simulate(SLIDER, None, [0.0], t=[0, 1], integrator="euler"),
        ("integrator", "dop853", "collocation", "'euler'"),
    ),  # type: ignore[arg-type]
    (lambda: mo.simulate(SLIDER, None, [0.0], t=[0, 1], tolerance=0.0), ("tolerance", "0", "0.0")),
    (lambda: mo.simulate(SLIDER, None, [0.0], t=[0, 1], max_steps=0), ("max_steps", "1, not 0")),
]


@pytest.mark.parametrize(("call", "message"), BAD_INPUTS)
def test_bad_inputs(call, message):
    with refused(*message):
        call()


def test_a_motion_that_does_not_fit(robot):
    fall = mo.simulate(slider(), None, [0.0], t=[0.0, 1.0]).as_motion("fall")
    with refused("motion", "1 joints", "robot", "3"):
        mo.simulate(robot, fall)
    with refused("t", "motion", "0 to 1 s"):
        mo.simulate(slider(), fall, t=[0.0, 2.0])
