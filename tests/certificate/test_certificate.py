"""Certificates: what is right passes, what is wrong is found where and as large as it is."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

import microbot_ocp as mo
from helpers import refused, tells
from microbot_ocp.certificate import certify
from microbot_ocp.certificate._task_certificate import _part, _steps
from microbot_ocp.motion import Mark, Motion, PiecewisePolynomial, State, jump_gaps, torque_along
from microbot_ocp.trajectories import (
    cubic,
    lspb,
    quintic,
    shortest_duration,
)

VIA_Q = np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]])
VIA_T = [0.0, 2.0, 4.0]
VIA_QD = np.radians([[0, 0, 0], [10, 40, 20], [0, 0, 0]])


@pytest.fixture(scope="module")
def robot():
    return mo.load_robot("microbot")


def by_quantity(certificate):
    return {check.quantity: check for check in certificate.limit_checks}


def sampled(robot, shape, **more):
    return Motion.from_polynomial(robot, shape, label="test", **more)


def report_cubic(robot, **more):
    return sampled(robot, cubic(VIA_Q, VIA_T, VIA_QD), **more)


def slider():
    """One mass of 2 kg on a rail, without gravity."""
    return mo.Robot.from_dh(
        alpha=[0.0],
        a=[0.0],
        d=[0.0],
        joint_type="prismatic",
        links=[mo.Link(2.0, [0.0, 0.0, 0.0])],
        gravity=(0.0, 0.0, 0.0),
    )


def random_jumps(pieces, duration, seed):
    """Constant accelerations by pieces, a jump at each break, around a pose far from singular."""
    random = np.random.default_rng(seed)
    step = duration / pieces
    home = q = np.array([0.0, 0.2, 0.4])
    qd = np.zeros(3)
    coefficients = []
    for _ in range(pieces):
        qdd = random.uniform(-2.0, 2.0, 3) - 0.5 * qd - 0.5 * (q - home)
        coefficients.append([q, qd, 0.5 * qdd])
        q = q + step * qd + 0.5 * step**2 * qdd
        qd = qd + step * qdd
    return PiecewisePolynomial(np.linspace(0.0, duration, pieces + 1), np.array(coefficients))


@pytest.mark.parametrize(
    "shape",
    [
        cubic(VIA_Q, VIA_T, VIA_QD),
        lspb(VIA_Q, VIA_T, 0.5, VIA_QD),
        quintic(VIA_Q, VIA_T, VIA_QD),
        cubic(VIA_Q[:2], VIA_T[:2]),
    ],
    ids=["cubic", "lspb", "quintic", "one segment"],
)
@pytest.mark.parametrize("scaled", [False, True])
def test_textbook_motions_come_back_from_their_own_torques(robot, shape, scaled):
    if scaled:
        shape = shortest_duration(robot, shape).polynomial
    certificate = certify(robot, sampled(robot, shape))
    assert certificate.ok, certificate.verdict
    assert certificate.resimulation_status.solved
    assert certificate.final_position_error < 1e-6
    assert certificate.final_velocity_error < 1e-6
    assert certificate.path_position_error < 1e-6
    assert certificate.worst_violation < 1e-8
    assert certificate.grid_ratio >= 20
    assert certificate.grid_step <= 0.25e-3 * (1 + 1e-9)
    if scaled:
        used = [np.nanmax(c.utilisation) for c in certificate.limit_checks if c.quantity != "q"]
        assert max(used) == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize(("pieces", "duration", "seed"), [(7, 1.5, 1), (50, 1.5, 2), (200, 2, 3)])
def test_jumps_of_the_torque_do_not_upset_the_resimulation(robot, pieces, duration, seed):
    motion = sampled(robot, random_jumps(pieces, duration, seed))
    certificate = certify(robot, motion, mo.Limits())
    assert certificate.resimulation_status.solved
    assert certificate.final_position_error < 1e-6
    assert certificate.limit_checks == ()


def test_a_violation_is_found_with_joint_time_and_amount(robot):
    """The report's cubic needs 276.11 N m at the shoulder, at its start (196 N m are gravity)."""
    certificate = certify(robot, report_cubic(robot), mo.Limits(tau_max=[400.0, 250.0, 200.0]))
    assert not certificate.ok
    check = by_quantity(certificate)["tau"]
    assert (check.joint, check.unit, check.limit) == ("shoulder", "N m", 250.0)
    assert check.time == 0.0
    assert check.value == pytest.approx(276.11061267, rel=2e-6)
    assert check.violation == pytest.approx(26.11061267 / 250.0, rel=1e-4)
    assert check.utilisation[1] == pytest.approx(276.11061267 / 250.0, rel=2e-6)
    tells(certificate.verdict, "torque of shoulder", "276.11 N m", "0 s", "10.4 %", "250 N m")
    (refused,) = (check for check in certificate.checks if not check.passed)
    assert (refused.what, refused.where, refused.value) == ("torque", "shoulder", check.value)
    assert certificate.verdict == f"Failed: {refused.problem}."
    # the same motion passes with the excess allowed
    limits = mo.Limits(tau_max=[400.0, 250.0, 200.0])
    assert certify(robot, report_cubic(robot), limits, limit_tolerance=0.11).ok


def test_a_peak_between_the_mesh_points_is_found():
    """A rest-to-rest cubic on two mesh points: the speed peaks at 1.5 L/T half-way."""
    arm = slider()
    motion = sampled(arm, cubic([[0.0], [1.0]], [0.0, 1.0]))
    limits = mo.Limits(
        q_min=-1.0, q_max=0.9, qd_max=1.2, qdd_max=5.0, tau_max=(-20.0, 11.0), taud_max=20.0
    )
    certificate = certify(arm, motion, limits)
    found = {c.quantity: c for c in certificate.limit_checks}
    assert list(found) == ["q", "qd", "qdd", "tau", "taud"]
    assert found["qd"].value == pytest.approx(1.5, rel=1e-6)
    assert found["qd"].time == pytest.approx(0.5, abs=1e-3)
    assert found["qd"].violation == pytest.approx(0.25, rel=1e-6)
    assert found["q"].violation == pytest.approx(0.1 / 0.95, rel=1e-6)
    assert found["qdd"].violation == pytest.approx(0.2, rel=1e-6)
    assert (found["tau"].limit, found["tau"].time) == (11.0, 0.0)
    assert found["tau"].violation == pytest.approx(1 / 11, rel=1e-6)
    assert found["taud"].jump  # by 12 N where it begins at rest, as if within a microsecond
    assert found["taud"].value == pytest.approx(12e6)
    assert [c.unit for c in certificate.limit_checks] == ["m", "m/s", "m/s^2", "N", "N/s"]


def test_unlimited_joints_are_not_a_number(robot):
    limits = mo.Limits(qd_max=[1.0, np.inf, 2.0])
    certificate = certify(robot, report_cubic(robot), limits, limit_tolerance=1.0)
    (check,) = certificate.limit_checks
    assert np.isnan(check.utilisation).tolist() == [False, True, False]
    assert check.utilisation[0] == pytest.approx(1.1185915707, rel=1e-6)
    assert "tau" not in by_quantity(certificate)


@pytest.mark.filterwarnings("error")
def test_a_further_limit_without_a_finite_bound_is_not_the_tightest(robot):
    limits = mo.Limits(qd_max=3.0, also=[mo.limits.tool_speed(upper=np.inf)])
    certificate = certify(robot, report_cubic(robot), limits)
    tells(certificate.verdict, "velocity of waist", "37.29 %", "3.036 s")


def test_a_jump_of_the_torque_breaks_any_rate_limit(robot):
    certificate = certify(robot, report_cubic(robot), mo.Limits(taud_max=1e4))
    check = by_quantity(certificate)["taud"]
    assert (check.joint, round(check.time, 5)) == ("waist", 2.0)
    assert check.violation > 100
    smooth = sampled(robot, quintic(VIA_Q, VIA_T, VIA_QD))
    assert certify(robot, smooth, mo.Limits(taud_max=1e4)).ok


def test_stored_torques_that_are_not_the_motions(robot):
    motion = report_cubic(robot)
    tau = motion.tau.copy()
    tau[1200, 2] += 3.0
    certificate = certify(robot, replace(motion, tau=tau))
    assert not certificate.ok
    assert certificate.stored_torque_joint == "elbow"
    assert certificate.stored_torque_time == pytest.approx(motion.t[1200])
    peak = np.abs(motion.tau[:, 2]).max()
    assert certificate.stored_torque_error == pytest.approx(3.0 / peak, rel=1e-4)
    tells(certificate.verdict, "stored torque", "elbow", "1.2 s", "0.0226", "1e-05")


def test_velocities_that_are_not_the_slope_of_the_positions(robot):
    """The samples deny each other, though each has the torque of inverse dynamics."""
    t = np.linspace(0.0, 1.0, 501)
    q = np.column_stack([0.3 * t**2, 0.2 * t**2, 0.1 * t**2])
    qd, qdd = np.column_stack([0.6 * t, 0.2 * t, 0.2 * t]), np.tile([0.6, 0.4, 0.2], (t.size, 1))
    state = State(q, qd, qdd)
    motion = Motion(t, q, qd, qdd, torque_along(robot, state))
    certificate = certify(robot, motion, mo.Limits())
    assert not certificate.ok
    assert certificate.stored_torque_error == 0.0
    assert "torque between samples" in {c.what for c in certificate.checks if not c.passed}


def test_a_wrong_acceleration_is_found_where_breaks_are_dense(robot):
    """Three samples say little of how the acceleration runs, but it must fit all the same."""
    shape = cubic(VIA_Q[:2], VIA_T[:2])
    motion = Motion.from_polynomial(robot, shape, label="cubic", step=0.02)
    motion = replace(motion, breaks=np.append(motion.t[:-1:2], motion.duration))
    for share, ok in ((0.0, True), (0.01, False)):
        qdd = motion.qdd * (1.0 + share * (np.arange(motion.t.size) % 2)[:, None])
        tau = torque_along(robot, State(motion.q, motion.qd, qdd))
        wrong = replace(motion, qdd=qdd, tau=tau)
        assert certify(robot, wrong, mo.Limits()).ok is ok


def light_and_rubbing() -> tuple[mo.Robot, Motion]:
    light = mo.Link(1e-5, [0.0, 0.0, 0.0], viscous_friction=1.0, coulomb_friction=1.0)
    robot = replace(slider(), links=[light])
    t = np.linspace(0.0, 1.0, 51)
    sine, cosine = np.sin(3.0 * t[:, None]), np.cos(3.0 * t[:, None])
    return robot, Motion.from_state(robot, t, State(sine, 3.0 * cosine, -9.0 * sine), label="sine")


def test_friction_that_makes_the_equations_stiff():
    """A light joint that rubs settles within microseconds: long segments do all the same."""
    robot, motion = light_and_rubbing()
    certificate = certify(robot, motion, mo.Limits())
    assert certificate.ok, certificate.verdict
    assert certificate.segments < 50
    assert not certify(robot, replace(motion, tau=1.001 * motion.tau), mo.Limits()).ok


def test_what_is_wrong_is_told_in_long_segments_where_friction_is_stiff():
    """Wrong torques leave a light joint that rubs where no iteration follows; nor need it."""
    robot, motion = light_and_rubbing()
    backwards = State(motion.q, -motion.qd, motion.qdd)
    wrong = {
        "sign of the torque": replace(motion, tau=-motion.tau),
        "torque": replace(motion, tau=1.001 * motion.tau),
        "sign of the velocity": Motion.from_state(robot, motion.t, backwards, label="backwards"),
    }
    for what, other in wrong.items():
        certificate = certify(robot, other, mo.Limits())
        assert not certificate.ok, what
        assert certificate.segments < 500, what
        assert certificate.resimulation_status.solved, what
    assert certify(robot, wrong["sign of the torque"], mo.Limits()).defect > 0.1
    assert certify(robot, wrong["sign of the velocity"], mo.Limits()).defect > 1e-3


def test_what_is_wrong_in_a_later_part_is_told_in_the_time_of_the_whole():
    robot = slider()
    made = sampled(robot, quintic([[0.0], [0.1], [1.1]], [0.0, 1.0, 2.0], np.zeros((3, 1))))
    at = int(np.searchsorted(made.t, 1.7))
    tau = made.tau.copy()
    tau[at] += 1.0
    motion = replace(made, tau=tau, marks=[Mark(t, f"stop {t:g}") for t in (0.0, 1.0, 2.0)])
    stops = [mo.Stop(q) for q in ([0.0], [0.1], [1.1])]
    found = certify(robot, motion, mo.Limits(qd_max=1.5), via_q=stops)
    velocity, torque = found.verdict.removeprefix("Failed: between 1 s and 2 s: ").split("; ")[:2]
    tells(velocity, "velocity of joint 1", "1.875 m/s", "1.5 s")
    tells(torque, "stored torque", "joint 1", f"{made.t[at]:.4g} s")
    assert by_quantity(found)["qd"].time == pytest.approx(1.5, abs=1e-3)
    assert found.stored_torque_time == made.t[at]
    refused = [(check.what, check.time) for check in found.checks if not check.passed]
    assert ("stored torque", made.t[at]) in refused
    assert {"step of the velocity", "joint pose"} <= {check.what for check in found.checks}


def test_samples_within_microseconds_are_no_jump():
    assert not jump_gaps(np.array([0.0, 1.5e-6, 3e-6, 4.5e-6])).any()
    assert not jump_gaps(np.array([0.0, 1.0, 1.0 + 1e-6, 1.0 + 2e-6, 1.0 + 3e-6])).any()
    assert not jump_gaps(np.array([0.0, 7.7e-6, 8.5e-6, 1.1e-5])).any()  # a mesh of 6 ms in all
    assert jump_gaps(np.array([0.0, 1.0, 1.0 + 1e-6, 2.0])).tolist() == [False, True, False]


def test_a_part_whose_samples_are_all_breaks_passes(robot):
    """Accelerations that run straight from break to break, in the part between two stops."""
    breaks = np.linspace(0.0, 0.06, 61)
    jerk = 2000.0 * np.random.default_rng(3).uniform(-1.0, 1.0, (60, 3))
    step = breaks[1]
    qdd = np.concatenate([np.zeros((1, 3)), step * np.cumsum(jerk, axis=0)])
    qd = np.concatenate([np.zeros((1, 3)), step * np.cumsum((qdd[1:] + qdd[:-1]) / 2, axis=0)])
    rise = step * qd[:-1] + step**2 * (2 * qdd[:-1] + qdd[1:]) / 6
    q = np.concatenate([np.zeros((1, 3)), np.cumsum(rise, axis=0)])
    pieces = np.stack([q[:-1], qd[:-1], qdd[:-1] / 2, jerk / 6], axis=1)
    motion = sampled(robot, PiecewisePolynomial(breaks, pieces))
    part = _part(motion, robot, breaks[20], breaks[40])
    assert certify(robot, part, mo.Limits()).ok, certify(robot, part, mo.Limits()).verdict
    assert not certify(robot, replace(part, tau=1.001 * part.tau), mo.Limits()).ok


def test_timings_of_paths_in_milliseconds(robot):
    """Intervals of less than a microsecond hold jumps, too, and both sides of each are known."""
    tau_max = 1e6 * robot.limits.tau_max
    quick = robot.with_limits(qd_max=np.inf, tau_max=tau_max, taud_max=np.inf)
    motion = mo.time_optimal_path(quick, mo.cubic(VIA_Q, VIA_T))
    assert motion.duration < 2e-3
    assert np.isin(motion.breaks, motion.t).all()
    certificate = certify(quick, motion)
    assert certificate.ok, certificate.verdict


def test_via_points(robot):
    marks = [Mark(t, name) for t, name in zip(VIA_T, ("start", "shelf", "goal"), strict=True)]
    motion = report_cubic(robot, marks=marks)
    certificate = certify(robot, motion, via_q=VIA_Q)
    assert [via.where for via in certificate.via_checks] == ["start", "shelf", "goal"]
    assert [via.time for via in certificate.via_checks] == pytest.approx(VIA_T, abs=1e-3)
    assert max(via.value for via in certificate.via_checks) < 1e-9
    assert certificate.ok
    off = VIA_Q + np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0.05]])
    missed = certify(robot, motion, via_q=off)
    assert not missed.ok
    assert missed.via_checks[2].value == pytest.approx(0.05, rel=1e-3)
    tells(missed.verdict, "goal", "0.05 rad", "4 s")


def test_a_singular_pose_is_reported(robot):
    """Straight up (q2 = 90 deg, q3 = 0) the masses are on the axis of the waist: M11 = 0."""
    shape = quintic(np.radians([[0, 60, 30], [30, 90, 0], [60, 100, -20]]), [0.0, 1.0, 2.0])
    certificate = certify(robot, sampled(robot, shape), mo.Limits())
    assert certificate.condition_peak > 1e6
    assert certificate.condition_time == pytest.approx(1.0, abs=1e-3)
    np.testing.assert_allclose(np.degrees(certificate.condition_pose), [30, 90, 0], atol=0.1)
    tells(certificate.verdict, "singular at 1 s", "1.25 %", "waist", "inverse dynamics")
    assert certificate.ok
    assert 0 < certificate.undetermined_fraction < 0.1
    np.testing.assert_allclose(certificate.undetermined_direction, [1, 0, 0], atol=1e-3)
    # With rotor inertia the same motion is determined by its torques.
    links = [
        mo.Link(link.mass, link.center_of_mass, link.inertia, armature=1.0) for link in robot.links
    ]
    geared = robot.with_links(links)
    certificate = certify(geared, sampled(geared, shape), mo.Limits())
    assert certificate.ok, certificate.verdict
    assert "singular" not in certificate.verdict
    assert certificate.undetermined_direction is None


@pytest.mark.parametrize(("step", "passed"), [(0.0, True), (0.01, False)])
def test_a_small_step_of_the_velocity_between_segments_is_found(step, passed):
    t = np.array([0.0, 0.5, 1.0 - 1e-6, 1.0, 1.5, 2.0])
    speed = 0.5 + step * (t >= 1.0)
    q, qd, qdd = speed * t - step * (t >= 1.0), speed, 10.0 * (t >= 1.0)
    q, qd = q + 5.0 * np.maximum(t - 1.0, 0.0) ** 2, qd + 10.0 * np.maximum(t - 1.0, 0.0)
    columns = (column[:, None] for column in (q, qd, qdd, 0.0 * t))
    position, velocity = _steps(Motion(t, *columns), [1.0])
    assert position.passed
    assert velocity.passed is passed


@pytest.mark.thorough
def test_links_without_mass_at_the_tip_are_counted():
    robot = mo.load_robot("puma560")
    none = mo.Link(0.0, [0.0, 0.0, 0.0])
    shape = cubic(
        np.array([[0.1, 0.2, 0.3, 0.4, 0.5, 0.6], [1.0, 0.5, 0.8, 0.0, 1.0, 0.0]]), [0, 8]
    )
    for count, said in ((1, ""), (2, "1 more direction"), (3, "2 more directions")):
        bare = robot.with_links([*robot.links[:-count], *[none] * count])
        motion = sampled(bare, shape)
        certificate = certify(bare, motion, mo.Limits())
        assert certificate.ok
        assert certificate.undetermined_fraction == pytest.approx(1.0)
        tells(certificate.verdict, "100 %", said, "inverse dynamics")
        assert ("direction" in certificate.verdict) == bool(said)
        assert "re-simulation" not in certificate.verdict
        assert not certify(bare, replace(motion, tau=1.001 * motion.tau), mo.Limits()).ok


def test_a_start_in_the_singular_pose_is_judged_by_inverse_dynamics(robot):
    shape = quintic(np.radians([[0, 90, 0], [30, 50, 0]]), [0.0, 1.0])
    motion = sampled(robot, shape)
    certificate = certify(robot, motion, mo.Limits())
    assert certificate.ok, certificate.verdict
    assert certificate.undetermined_fraction > 0
    tau = motion.tau.copy()
    tau[:20, 1] *= 1.001
    assert not certify(robot, replace(motion, tau=tau), mo.Limits()).ok


def test_saturated_fraction():
    """A trapezoid whose cruise, the middle half, is at the speed limit."""
    arm = slider()
    motion = sampled(arm, lspb([[0.0], [0.75]], [0.0, 1.0], 0.25))
    cruise = certify(arm, motion, mo.Limits(qd_max=1.0)).saturated_fraction
    # within 1 % of the speed limit the blends count as well: 0.5 + 2 * 0.01 * 0.25
    assert cruise == pytest.approx(0.505, abs=1e-3)
    both = certify(arm, motion, mo.Limits(qd_max=1.0, qdd_max=4.0)).saturated_fraction
    assert both == pytest.approx(1.0, abs=1e-3)
    assert certify(arm, motion, mo.Limits(qd_max=2.0)).saturated_fraction == 0.0


def test_resampled_motions_pass(robot):
    for rate in (50.0, 500.0):
        certificate = certify(robot, report_cubic(robot).resample(rate))
        assert certificate.ok, certificate.verdict
        assert certificate.stored_torque_error < 1e-6


def test_as_dict_is_plain(robot):
    certificate = certify(robot, report_cubic(robot), mo.Limits(qd_max=[1.2, np.inf, 2.0]))
    again = json.loads(json.dumps(certificate.as_dict(), allow_nan=False))
    assert again["ok"] is True
    assert again["limit_checks"][0]["utilisation"][1] is None
    assert again["resimulation_status"] == "solved"


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda r, m: certify(slider(), m), ("motion", "3 joints", "robot has 1")),
        (lambda r, m: certify(r, m, mo.Limits(qd_max=[1.0, 2.0])), ("qd_max", "[3]", "[2]")),
        (lambda r, m: certify(r, m, via_q=[[0.0, 0.0]]), ("via_q", "[any, 3]", "[1, 2]")),
        (
            lambda r, m: certify(r, m, limit_tolerance=-0.1),
            ("limit_tolerance", "at least 0", "-0.1"),
        ),
        (lambda r, m: certify(r, m, torque_tolerance=0.0), ("torque_tolerance", "above 0", "0.0")),
    ],
)
def test_bad_inputs(robot, call, said):
    with refused(*said):
        call(robot, report_cubic(robot))


def test_a_velocity_that_is_missed_is_told_in_the_unit_of_its_stop() -> None:
    """That of a joint pose was told in m/s."""
    robot, via = mo.load_robot("microbot"), [[0.0, 0.3, 0.2], [0.5, 0.6, 0.4], [1.0, 0.8, 0.3]]
    marks = [mo.motion.Mark(float(k), f"stop {k + 1}") for k in range(3)]
    shape = mo.spline(via, [0.0, 1.0, 2.0])
    motion = mo.Motion.from_polynomial(robot, shape, label="spline", marks=marks)
    place, slow = np.array(mo.forward_kinematics(robot)(via[1]))[:3, 3], [0.1, 0.0, 0.0]
    ends = [mo.Stop(q=via[k]) for k in (0, 2)]
    for stop, unit in (
        (mo.Stop(q=via[1], velocity=slow), "rad/s"),
        (mo.Stop(position=place, velocity=slow), "m/s"),
    ):
        verdict = mo.certify(robot, motion, via_q=[ends[0], stop, ends[1]]).verdict
        assert re.search(rf"missed in its velocity by [0-9.]+ {unit}", verdict)
