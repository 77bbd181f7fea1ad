"""Controllers: error dynamics in closed form, what spoils them, sampling, noise, bad input."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import pytest

import microbot_ocp as mo
from helpers import random_robot, refused, tells
from microbot_ocp.simulation import SensorNoise


def report_motion(t):
    return [np.pi / 4 * (1 + 6 * ca.exp(-t / 0.3) - 8 * ca.exp(-t / 0.4))] * 3


@pytest.fixture(scope="module")
def robot():
    return mo.load_robot("microbot").with_limits(mo.Limits())


def heavier(robot, factor=1.2):
    return robot.with_links([replace(link, mass=factor * link.mass) for link in robot.links])


def critically_damped(start, kp, t):
    """Solution of e'' + 2 w e' + w^2 e = 0 from e = start at rest, w = sqrt(kp)."""
    w = np.sqrt(kp)
    return start * (1 + np.outer(t, w)) * np.exp(-np.outer(t, w))


def references(robot):
    via = np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 60]])
    shape = mo.lspb(via, [0.0, 2.0, 4.0], 0.5, np.radians([[0, 0, 0], [10, 40, 20], [0, 0, 0]]))
    return {
        "formula": report_motion,
        "polynomial with jumps": shape,
        "motion with jumps": mo.Motion.from_polynomial(robot, shape, label="lspb"),
        "sampled motion": mo.simulation.motion_from_formula(
            robot, report_motion, 2.0, label="report"
        ),
    }


@pytest.mark.parametrize("kp", [0.1, 100.0, [25.0, 100.0, 400.0]])
@pytest.mark.parametrize(
    "kind", ["formula", "polynomial with jumps", "motion with jumps", "sampled motion"]
)
def test_error_dynamics_in_closed_form(robot, kp, kind):
    motion = references(robot)[kind]
    begin = np.array([-np.pi / 4] * 3 if kind in ("formula", "sampled motion") else [0.0] * 3)
    start = np.radians([-45.0, 20.0, -10.0])
    run = mo.track(robot, motion, mo.ComputedTorque(kp), q0=begin - start, duration=2.0)
    assert run.solved, run.status
    wanted = critically_damped(start, np.broadcast_to(kp, 3), run.t)
    np.testing.assert_allclose(run.error, wanted, atol=1e-6)
    np.testing.assert_allclose(run.peak, np.abs(wanted).max(axis=0), atol=1e-6)
    mean = np.trapezoid(wanted**2, run.t, axis=0) / run.t[-1]
    np.testing.assert_allclose(run.rms, np.sqrt(mean), atol=1e-6)


@pytest.mark.parametrize("integrator", ["dop853", "cvodes", "idas", "collocation", "rk"])
def test_underdamped_errors_by_every_integrator(robot, integrator):
    kp, kv = 50.0, 4.0
    run = mo.track(robot, report_motion, mo.ComputedTorque(kp, kv), q0=[-0.5, -0.9, 0.1],
                   duration=1.0, step=0.02, integrator=integrator)  # fmt: skip
    w = np.sqrt(kp - kv**2 / 4)
    decay = np.exp(-0.5 * kv * run.t) * (np.cos(w * run.t) + 0.5 * kv / w * np.sin(w * run.t))
    np.testing.assert_allclose(run.error, np.outer(decay, run.error[0]), atol=1e-6)


def test_computed_torque_of_a_chain_with_all_kinds_of_joints():
    robot = random_robot("rprr")
    n = robot.joint_count
    shape = mo.quintic([[0.0] * n, [0.5] * n], [0.0, 1.0])
    run = mo.track(robot, shape, mo.ComputedTorque(64.0), q0=[0.1] * n)
    wanted = critically_damped(np.full(n, -0.1), np.full(n, 64.0), run.t)
    np.testing.assert_allclose(run.error, wanted, atol=1e-6)


def test_feedforward_with_an_exact_model_is_exact(robot):
    run = mo.track(robot, report_motion, mo.Feedforward(), duration=2.0)
    assert run.peak.max() < 1e-6
    motion = mo.simulation.motion_from_formula(robot, report_motion, 2.0, label="report")
    np.testing.assert_allclose(run.tau, motion.tau, atol=1e-8)
    np.testing.assert_allclose(run.reference.qd, motion.qd, atol=1e-12)


def hold(q):
    """A reference that stays at q [n] for 12 s."""
    return mo.motion.PiecewisePolynomial([0.0, 12.0], np.reshape(q, (1, 1, -1)))


def test_pd_with_gravity_arrives_where_it_should(robot):
    run = mo.track(robot, hold([0.3, -0.4, 0.6]), mo.PDGravity(900.0, 400.0), q0=[0, 0, 0])
    assert np.abs(run.error[-1]).max() < 1e-5


def test_mass_error_leaves_the_error_that_statics_predicts(robot):
    """At rest M(q) kp e = g_plant(q) - g_model(q)."""
    plant, kp = heavier(robot), 100.0
    run = mo.track(robot, hold([0.3, -0.4, 0.6]), mo.ComputedTorque(kp), plant=plant)
    q = run.q[-1]
    missing = mo.gravity_torque(plant)(q) - mo.gravity_torque(robot)(q)
    wanted = np.linalg.solve(mo.mass_matrix(robot)(q).full(), missing.full().ravel()) / kp
    assert np.abs(wanted).max() > 1e-3
    np.testing.assert_allclose(run.error[-1], wanted, atol=1e-6)


def test_a_disturbance_leaves_the_error_that_statics_predicts(robot):
    """kp e + M^-1 d = 0 at rest, d constant; a function of the time is the same thing."""
    push, kp = np.array([5.0, -20.0, 10.0]), 100.0
    for disturbance in (push, lambda t: ca.DM(push) * (1 - ca.exp(-10 * t))):
        run = mo.track(
            robot, hold([0.3, -0.4, 0.6]), mo.ComputedTorque(kp), disturbance=disturbance
        )
        mass = mo.mass_matrix(robot)(run.q[-1]).full()
        np.testing.assert_allclose(run.error[-1], -np.linalg.solve(mass, push) / kp, atol=1e-6)


def test_friction_slows_the_arm(robot):
    rough = [replace(link, viscous_friction=10.0, coulomb_friction=10.0) for link in robot.links]
    run = mo.track(robot, report_motion, mo.ComputedTorque(100.0), plant=robot.with_links(rough),
                   duration=2.0)  # fmt: skip
    assert run.solved
    assert 1e-3 < run.peak.max() < 0.1


@pytest.mark.parametrize("sample_rate", [None, 200.0])
@pytest.mark.parametrize(
    ("saturation", "lower", "upper"),
    [
        (True, [-400, -500, -200], [400, 500, 200]),
        (300.0, [-300] * 3, [300] * 3),
        (([-300, -np.inf, -100], [350, 700, np.inf]), [-300, -np.inf, -100], [350, 700, np.inf]),
        (mo.Limits(tau_max=[400, 1600, 800]), [-400, -1600, -800], [400, 1600, 800]),
    ],
)
def test_saturation_is_respected(saturation, lower, upper, sample_rate):
    robot = mo.load_robot("microbot")
    run = mo.track(robot, report_motion, mo.ComputedTorque(25.0), duration=1.0,
                   saturation=saturation, sample_rate=sample_rate, tolerance=1e-6)  # fmt: skip
    assert run.solved, run.status
    assert (run.tau >= np.array(lower)).all()
    assert (run.tau <= np.array(upper)).all()
    assert 0.02 < run.saturated_fraction <= 1.0
    free = mo.track(robot, report_motion, mo.ComputedTorque(25.0), duration=1.0, saturation=False)
    assert free.saturated_fraction == 0.0
    assert free.peak.max() < 1e-6 < run.peak.max()


def test_sampled_control_tends_to_continuous_control(robot):
    continuous = mo.track(robot, report_motion, mo.ComputedTorque(100.0), q0=[0, 0, 0],
                          duration=1.0, step=1e-3)  # fmt: skip
    errors = []
    for rate in (100.0, 200.0, 400.0, 1000.0):
        run = mo.track(robot, report_motion, mo.ComputedTorque(100.0), q0=[0, 0, 0], duration=1.0,
                       step=1e-3, sample_rate=rate)  # fmt: skip
        assert run.solved, run.status
        each = np.searchsorted(run.t, continuous.t[::50] - 1e-9)
        np.testing.assert_allclose(run.t[each], continuous.t[::50], atol=1e-9)
        errors.append(np.abs(run.q[each] - continuous.q[::50]).max())
    # a hold of one period is a delay of half of it: first order
    np.testing.assert_allclose(errors[0] / errors[1], 2.0, rtol=0.1)
    np.testing.assert_allclose(errors[1] / errors[2], 2.0, rtol=0.1)
    np.testing.assert_allclose(errors[2] / errors[3], 2.5, rtol=0.1)


def test_the_integrator_of_a_sampled_loop_does_not_matter(robot):
    runs = [
        mo.track(robot, report_motion, mo.ComputedTorque(100.0), q0=[0, 0, 0], duration=0.5,
                 sample_rate=100.0, integrator=name)
        for name in ("rk", "cvodes", "collocation")
    ]  # fmt: skip
    for run in runs:
        np.testing.assert_allclose(run.q, runs[0].q, atol=1e-6)
        held = run.tau[:-1].reshape(50, -1, 3)
        assert np.ptp(held, axis=1).max() == 0.0


def test_the_last_period_may_be_cut(robot):
    run = mo.track(
        robot, report_motion, mo.ComputedTorque(100.0), duration=0.505, sample_rate=100.0
    )
    assert run.t[-1] == pytest.approx(0.505, abs=1e-12)
    assert (np.diff(run.t) > 0).all()
    assert len(run.t) == len(run.q) == len(run.tau) == len(run.reference.q)


def test_noise_is_reproducible_by_its_seed(robot):
    def noisy(seed, q=1e-3):
        noise = mo.simulation.SensorNoise(q=q, qd=[0.01, 0.02, 0.03], seed=seed)
        return mo.track(robot, report_motion, mo.ComputedTorque(100.0), duration=0.3,
                        sample_rate=500.0, noise=noise)  # fmt: skip

    first, again, other = noisy(1), noisy(1), noisy(2)
    np.testing.assert_array_equal(first.q, again.q)
    assert np.abs(first.q - other.q).max() > 1e-6
    drawn = mo.simulation.SensorNoise(q=1e-3, qd=[0.01, 0.02, 0.03], seed=1).draw(20_000, 3)
    np.testing.assert_allclose(drawn.std(axis=0), [1e-3] * 3 + [0.01, 0.02, 0.03], rtol=0.03)
    np.testing.assert_allclose(drawn.mean(axis=0), 0.0, atol=1e-3)


@pytest.mark.thorough
@pytest.mark.slow
def test_an_unstable_loop_is_told():
    slider = mo.Robot.from_dh(
        [0.0], [0.0], [0.0], joint_type="prismatic", links=[mo.Link(1.0, [0.0, 0, 0])]
    )
    run = mo.track(slider, hold([0.0]), mo.PDGravity(1e4, 1e3), q0=[0.1], sample_rate=100.0)
    assert run.status is mo.Status.UNBOUNDED
    assert "sample_rate" in run.advice


def test_a_failure_is_data(robot):
    for sample_rate in (None, 100.0):
        run = mo.track(robot, report_motion, mo.ComputedTorque(100.0), duration=1.0, max_steps=2,
                       sample_rate=sample_rate, integrator="cvodes")  # fmt: skip
        assert not run.solved
        assert run.status is mo.Status.INTEGRATION_FAILED
        tells(run.advice, "max_steps")
        assert run.q.shape == run.tau.shape == run.error.shape == (1001, 3)
        assert np.isnan(run.q).all()


@dataclass(frozen=True)
class Own:
    """A controller from outside the package."""

    label: str = "own"

    def torque(self, model, reference, q, qd):
        return mo.gravity_torque(model)(q) - 50.0 * qd


def test_a_controller_of_ones_own(robot):
    run = mo.track(robot, hold([0.3, -0.4, 0.6]), Own())
    assert run.label == "own"
    assert np.abs(run.error).max() < 1e-8


def track(*arguments, **keywords):
    return mo.track(mo.load_robot("microbot"), *arguments, **{"duration": 1.0, **keywords})


LAW = mo.ComputedTorque(100.0)
BAD_INPUTS = [
    (lambda: mo.ComputedTorque(0.0), ("kp", "0 1/s^2", "0.0")),
    (lambda: mo.ComputedTorque([1.0, -2.0]), ("kp", "joint 2", "0 1/s^2", "-2.0")),
    (lambda: mo.ComputedTorque(1.0, kv=-1.0), ("kv", "0 1/s", "-1.0")),
    (lambda: mo.ComputedTorque(np.nan), ("kp", "finite", "nan 1/s^2")),
    (lambda: mo.ComputedTorque("high"), ("kp", "'high'")),  # type: ignore[arg-type]
    (lambda: mo.PDGravity(0.0, 1.0), ("kp", "0 N m/rad", "0.0")),
    (lambda: mo.PDGravity(1.0, 0.0), ("kv", "0 N m s/rad", "0.0")),
    (lambda: mo.simulation.SensorNoise(q=-1.0), ("noise q", "0 rad", "-1.0")),
    (lambda: mo.simulation.SensorNoise(seed=-1), ("seed", "whole number", "0", "-1")),
    (lambda: track(report_motion, mo.ComputedTorque([1.0, 2.0])), ("kp", "2 entries", "3 joints")),
    (lambda: track(report_motion, LAW, q0=[0, 0]), ("q0", "shape [3]", "[2]")),
    (
        lambda: track(report_motion, LAW, q0=[7, 0, 0]),
        ("q0", "waist", "7 rad", "6.28319", "degrees"),
    ),
    (
        lambda: track(report_motion, LAW, q0=[0, np.pi / 2, 0]),
        ("singular", "q0 =", "condition number", "armature"),
    ),
    (lambda: track(report_motion, LAW, duration=None), ("duration", "function")),
    (lambda: track(report_motion, LAW, duration=0.0), ("duration", "0 s", "0.0")),
    (lambda: track(hold([0.0] * 3), LAW, duration=13.0), ("duration", "12 s", "13.0")),
    (lambda: track(hold([0.0] * 2), LAW), ("motion", "2 joints", "robot", "3")),
    (lambda: track(lambda t: [t, t], LAW), ("motion", "3 expressions", "(2, 1)")),
    (lambda: track([1.0, 2.0], LAW), ("motion", "Motion", "PiecewisePolynomial", "[1.0, 2.0]")),  # type: ignore[arg-type]
    (lambda: track(report_motion, LAW, sample_rate=0.0), ("sample_rate", "0 Hz", "0.0")),
    (
        lambda: track(report_motion, LAW, sample_rate=100.0, integrator="dop853"),
        ("integrator", "cvodes", "collocation", "'dop853'"),
    ),
    (lambda: track(report_motion, LAW, noise=SensorNoise(1e-3)), ("noise", "sample_rate")),
    (lambda: track(report_motion, LAW, step=0.0), ("step", "0 s", "0.0")),
    (lambda: track(report_motion, LAW, saturation=-5.0), ("tau_max", "joint 1", "0 N m", "-5")),
    (lambda: track(report_motion, LAW, disturbance=[1.0]), ("disturbance", "shape [3]", "[1]")),
    (
        lambda: track(report_motion, LAW, plant=random_robot("rr")),
        ("plant", "2 joints", "robot", "3"),
    ),
]


@pytest.mark.parametrize(("call", "message"), BAD_INPUTS)
def test_bad_inputs(call, message):
    with refused(*message):
        call()


@pytest.mark.parametrize("kp", [10.0, 100.0])
@pytest.mark.parametrize("kind", ["formula", "polynomial with jumps"])
def test_errors_are_as_small_as_the_tolerance(robot, kind, kp):
    """Between the ends of steps, too, which are long where the gains are low."""
    motion = references(robot)[kind]
    start = np.radians([-45.0, 20.0, -10.0])
    begin = np.full(3, -np.pi / 4 if kind == "formula" else 0.0)
    for tolerance in (1e-6, 1e-9, 1e-12):
        run = mo.track(robot, motion, mo.ComputedTorque(kp), q0=begin - start, duration=2.0,
                       tolerance=tolerance)  # fmt: skip
        wanted = critically_damped(start, np.full(3, kp), run.t)
        worst = np.abs(run.error - wanted).max()
        assert worst < 5 * tolerance + 1e-12
