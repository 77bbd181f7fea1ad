"""The best timing of a path against closed forms, reachability and its own limits."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import brentq

import microbot_ocp as mo
from helpers import refused, sampled, tells
from microbot_ocp.limits import LimitFamily
from microbot_ocp.motion import PiecewisePolynomial
from microbot_ocp.planning import phase_plane, straight_path, time_optimal_path
from microbot_ocp.planning.path import corners, stops
from planning.shared import ARM_VIA, VIA_Q, VIA_QD, VIA_T, arm, dense_excess, pendulum, slider

REPORT_CUBIC = mo.cubic(VIA_Q, VIA_T, VIA_QD)
ARM_CUBIC = mo.cubic(ARM_VIA, [0.0, 1.0, 2.0])


# paths --------------------------------------------------------------------------------------------


def test_a_straight_path_runs_at_unit_speed_through_its_points():
    path = straight_path(VIA_Q)
    steps = np.linalg.norm(np.diff(VIA_Q, axis=0), axis=1)
    np.testing.assert_allclose(path.breaks, [0.0, steps[0], steps.sum()], rtol=1e-15)
    np.testing.assert_allclose(path(path.breaks), VIA_Q, atol=1e-15)
    s = np.linspace(0.01, path.breaks[-1] - 0.01, 50)
    np.testing.assert_allclose(np.linalg.norm(path.derivative()(s), axis=1), 1.0, rtol=1e-14)


@pytest.mark.parametrize(
    ("path", "expected"),
    [
        (straight_path(VIA_Q), [1]),
        (straight_path([[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]]), []),
        (straight_path([[0.0, 0.0], [1.0, 1.0], [0.0, 0.0]]), [1]),
        (straight_path([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [2.0, 1.0]]), [1, 2]),
        (REPORT_CUBIC, []),
        (ARM_CUBIC, [1]),  # both joints turn round there
        (mo.cubic([[0.0], [1.0], [2.0]], [0.0, 1.0, 2.0], [[0.0], [0.0], [0.0]]), []),
    ],
)
def test_corners_are_where_the_tangent_jumps_or_turns_at_rest(path, expected):
    np.testing.assert_array_equal(corners(path), path.breaks[expected])


def test_under_torque_rate_limits_jumps_of_the_curvature_are_stops():
    plain, rated = map(LimitFamily.of, (arm(), arm(tau_max=[60.0, 25.0], taud_max=[400.0, 150.0])))
    passing = mo.cubic(ARM_VIA, [0.0, 1.0, 2.0], np.full((3, 2), 0.3))
    assert stops(passing, plain).size == 0
    np.testing.assert_array_equal(stops(passing, rated), [1.0])
    straight = straight_path([[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]])
    assert stops(straight, rated).size == 0


UNITS = [1e-9, 1e6, 1e9]


def with_units(path, units):
    """Return the same path with a parameter of other units, one a piece."""
    powers = np.arange(path.coefficients.shape[1])[:, None]
    table = path.coefficients / np.reshape(units, (-1, 1, 1)) ** powers
    return PiecewisePolynomial(np.append(0.0, np.cumsum(np.diff(path.breaks) * units)), table)


@pytest.mark.parametrize("offset", [0.0, -1e7])
@pytest.mark.parametrize(
    "path",
    [
        REPORT_CUBIC,
        *(
            pytest.param(path, marks=pytest.mark.thorough)
            for path in (mo.quintic(VIA_Q, VIA_T), straight_path(VIA_Q))
        ),
    ],
    ids=["cubic", "quintic", "straight"],
)
def test_neither_the_unit_nor_the_offset_of_the_parameter_decides(path, offset):
    robot = mo.load_robot("microbot")
    expected = time_optimal_path(robot, path)
    expected_speed = phase_plane(robot, path).speed
    for unit in UNITS if not offset else [1.0]:
        other = with_units(path, [unit, unit])
        other = PiecewisePolynomial(other.breaks + offset, other.coefficients)
        motion, plane = time_optimal_path(robot, other), phase_plane(robot, other)
        assert motion.solved
        assert motion.duration == pytest.approx(expected.duration, rel=1e-9)
        ours = [x * unit + offset for x in expected.provenance["stops"]]
        np.testing.assert_allclose(motion.provenance["stops"], ours, rtol=1e-9)
        np.testing.assert_allclose(plane.speed, expected_speed * unit, rtol=1e-6, atol=1e-9 * unit)


@pytest.mark.parametrize("units", sampled([[1.0, 1e-4], [1e6, 1.0], [1e-9, 3.0]], 2))
@pytest.mark.parametrize("path", [REPORT_CUBIC, straight_path(VIA_Q)], ids=["cubic", "straight"])
def test_each_piece_may_have_a_unit_of_its_own(path, units):
    robot = mo.load_robot("microbot")
    motion = time_optimal_path(robot, with_units(path, units))
    assert len(motion.provenance["stops"]) == len(corners(path))
    assert motion.duration == pytest.approx(time_optimal_path(robot, path).duration, rel=1e-6)


@pytest.mark.thorough
@pytest.mark.slow
def test_the_unit_does_not_decide_under_torque_rates_either():
    robot = arm(tau_max=[60.0, 25.0], taud_max=[400.0, 150.0])
    path = mo.quintic(ARM_VIA, [0.0, 1.0, 2.0])
    expected = time_optimal_path(robot, path).duration
    motion = time_optimal_path(robot, with_units(path, [1e6, 1e6]))
    assert motion.duration == pytest.approx(expected, rel=1e-7)


# closed forms -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("limits", "duration"),
    [
        ({"tau_max": 4.0}, 2 * np.sqrt(1.5 / 2.0)),
        ({"qdd_max": 3.0}, 2 * np.sqrt(1.5 / 3.0)),
        ({"qd_max": 1.2, "tau_max": 4.0}, 1.5 / 1.2 + 1.2 / 2.0),
        ({"qd_max": 0.2, "tau_max": 4.0}, 1.5 / 0.2 + 0.2 / 2.0),  # hardly a grid point accelerates
        # at rest or at the velocity limit nearly everywhere: few places tell an acceleration
        ({"qd_max": 0.2, "tau_max": 4.0, "taud_max": 40.0}, 1.5 / 0.2 + 0.2 / 2.0 + 4.0 / 40.0),
        ({"tau_max": (-2.0, 4.0)}, np.sqrt(2 * 1.5 * (1 / 2.0 + 1 / 1.0))),
        pytest.param(
            {"tau_max": 100.0, "taud_max": 10.0},
            (32 * 1.5 / 5.0) ** (1 / 3),
            marks=pytest.mark.thorough,
        ),
    ],
)
def test_a_mass_on_a_rail_takes_the_closed_form(limits, duration):
    motion = time_optimal_path(slider(**limits), straight_path([[0.0], [1.5]]))
    assert motion.solved
    assert motion.duration == pytest.approx(duration, rel=1e-3)
    assert motion.duration > duration * (1 - 1e-4)


def test_an_arm_that_swings_up_in_one_joint_loses_what_gravity_takes():
    """Level at rest to level at rest on the other side, symmetric about the bottom.

    Down to the bottom the work of torque and gravity is kinetic energy; at the constant torque k
    the speed is v^2 = 2 (k s + g (sin s)) / l^2, s the way travelled.
    """
    limit = 12.0
    robot = pendulum(tau_max=limit)
    motion = time_optimal_path(robot, straight_path([[-np.pi / 2], [np.pi / 2]]))
    way = np.linspace(0.0, np.sqrt(np.pi / 2), 20001)[1:] ** 2
    speed = np.sqrt(2 * (limit * way + 9.81 * np.sin(way)))
    root = np.sqrt(way)
    half = np.trapezoid(2 * root / speed, root)  # ds = 2 root d(root)
    half += root[0] * 2 * root[0] / speed[0]
    assert motion.duration == pytest.approx(2 * half, rel=1e-3)


# reachability -------------------------------------------------------------------------------------


def on_places(robot, path):
    """By the program on places: a limit that is never met, but that the passes cannot keep."""
    motion = time_optimal_path(robot.with_limits(also=[mo.limits.power(1e6)]), path)
    tells(motion.provenance["method"], "program", "places")
    return motion


@pytest.fixture(scope="module")
def report_cubic(microbot):
    return on_places(microbot, REPORT_CUBIC)


@pytest.fixture(scope="module")
def report_straight(microbot):
    return on_places(microbot, straight_path(VIA_Q))


@pytest.mark.slow
@pytest.mark.parametrize("name", sampled(["report_straight", "report_cubic"], 2))
def test_two_methods_find_the_same_duration(name, request):
    motion = request.getfixturevalue(name)
    assert motion.solved
    assert motion.duration == pytest.approx(motion.provenance["reachability_duration"], rel=2e-4)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["report_cubic", "report_straight"])
def test_limits_hold_between_mesh_points(microbot, name, request):
    excess = dense_excess(microbot, request.getfixturevalue(name))
    assert set(excess) == {"q", "qd", "tau"}
    assert max(excess.values()) < 1e-3
    assert max(excess["qd"], excess["tau"]) > -1e-3  # some limit is met


def test_some_limit_is_met_nearly_all_the_time(microbot, report_cubic):
    motion = report_cubic
    use = np.maximum(
        np.abs(motion.qd / microbot.limits.qd_max).max(axis=1),
        np.abs(motion.tau / microbot.limits.tau_max).max(axis=1),
    )
    assert np.trapezoid((use > 0.98).astype(float), motion.t) > 0.9 * motion.duration


def on_path(path, q):
    s = np.linspace(path.breaks[0], path.breaks[-1], 20001)
    points = path(s)
    return max(float(np.abs(points - row).max(axis=1).min()) for row in q[:: max(1, len(q) // 40)])


@pytest.mark.parametrize(
    ("name", "path"),
    [("report_cubic", REPORT_CUBIC), ("report_straight", straight_path(VIA_Q))],
)
def test_the_motion_stays_on_its_path(name, path, request):
    motion = request.getfixturevalue(name)
    assert on_path(path, motion.q) < 2e-4
    np.testing.assert_allclose(motion.q[[0, -1]], VIA_Q[[0, -1]], atol=1e-9)
    np.testing.assert_allclose(motion.qd[[0, -1]], 0.0, atol=1e-6)
    (via,) = (mark.time for mark in motion.marks if mark.name == "via 2")
    np.testing.assert_allclose(motion.sample(via).q[0], VIA_Q[1], atol=1e-5)


def test_the_arm_stops_at_a_corner_only(report_cubic, report_straight):
    for motion, stopped in ((report_straight, True), (report_cubic, False)):
        via = next(mark.time for mark in motion.marks if mark.name == "via 2")
        speed = np.abs(motion.sample(via).qd).max()
        assert (speed < 1e-3) == stopped
    assert len(report_straight.provenance["stops"]) == 1
    assert report_cubic.provenance["stops"] == []


@pytest.mark.slow
def test_a_path_backwards_takes_as_long_without_gravity():
    robot = arm(gravity=0.0)
    curve = mo.cubic(ARM_VIA, [0.0, 1.0, 2.0])
    back = mo.cubic(ARM_VIA[::-1], [0.0, 1.0, 2.0])
    there, again = (time_optimal_path(robot, path).duration for path in (curve, back))
    assert there == pytest.approx(again, rel=2e-4)


@pytest.mark.parametrize("torque", [(-12.0, 12.0), (-2.0, 12.0)])
def test_a_pendulum_goes_down_as_it_came_up(torque):
    """A motion played backwards asks for the same torques, gravity or not."""
    robot = pendulum(tau_max=torque)
    up, down = (
        time_optimal_path(robot, straight_path(points))
        for points in ([[0.0], [np.pi / 2]], [[np.pi / 2], [0.0]])
    )
    assert up.duration == pytest.approx(down.duration, rel=3e-4)
    assert up.tau.max() == pytest.approx(12.0, rel=1e-3)
    assert up.tau.min() == pytest.approx(torque[0], rel=1e-3)


@pytest.mark.slow
def test_four_times_the_torque_halves_the_time_without_gravity():
    path = mo.cubic(ARM_VIA, [0.0, 1.0, 2.0])
    durations = [
        time_optimal_path(arm(0.0, tau_max=[15.0 * k, 6.0 * k]), path).duration for k in (1.0, 4.0)
    ]
    assert durations[0] / durations[1] == pytest.approx(2.0, rel=3e-4)


@pytest.mark.thorough
@pytest.mark.slow
@pytest.mark.parametrize(
    ("friction", "allowed"),
    [
        pytest.param({"viscous_friction": 3.0}, 1.5e-3, marks=pytest.mark.thorough),
        pytest.param({"coulomb_friction": 2.0}, 5e-3, marks=pytest.mark.thorough),
        ({"viscous_friction": 2.0, "coulomb_friction": 2.0}, 5e-3),
    ],
)
def test_torque_limits_hold_with_friction(friction, allowed):
    robot = arm()
    rubbing = robot.with_links([replace(link, **friction) for link in robot.links])
    motion = time_optimal_path(rubbing, straight_path(ARM_VIA))
    assert motion.solved
    assert dense_excess(rubbing, motion)["tau"] < allowed
    # without friction the same motion would have to brake harder than the limits allow
    assert dense_excess(robot, motion)["tau"] > 0.05


@pytest.mark.slow
def test_acceleration_limits_hold():
    robot = arm(tau_max=[60.0, 25.0], qdd_max=[4.0, 6.0])
    motion = time_optimal_path(robot, ARM_CUBIC)
    excess = dense_excess(robot, motion)
    assert -1e-3 < excess["qdd"] < 1.5e-3
    assert excess["tau"] < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("corner", [True, pytest.param(False, marks=pytest.mark.thorough)])
def test_torque_rate_limits_hold_also_where_pieces_meet(corner):
    robot = arm(tau_max=[60.0, 25.0], taud_max=[400.0, 150.0])
    path = straight_path(ARM_VIA) if corner else ARM_CUBIC
    motion = time_optimal_path(robot, path)
    check = next(c for c in mo.certify(robot, motion).limit_checks if c.quantity == "taud")
    assert check.violation < (2e-3 if corner else 2e-2)
    if not corner:  # where the tangent vanishes the ends are hard to follow: held, or admitted
        assert motion.solved == (motion.provenance["excess"] <= 5e-3)
        assert motion.status in (mo.Status.SOLVED, mo.Status.LIMITS_EXCEEDED)
    else:
        assert motion.solved
    without = time_optimal_path(robot, path, mo.Limits(tau_max=[60.0, 25.0]))
    assert motion.duration > 1.05 * without.duration


@pytest.mark.thorough
def test_a_smooth_path_needs_no_stop_under_torque_rate_limits():
    """A single polynomial cut in two: as fast as in one piece."""
    whole = mo.cubic([[0.0, 0.3], [1.0, -0.5]], [0.0, 1.0], [[0.5, 0.5], [0.5, 0.5]])
    middle = [f(0.4)[0] for f in (whole, whole.derivative())]
    cut = mo.cubic(
        [[0.0, 0.3], middle[0], [1.0, -0.5]], [0.0, 0.4, 1.0], [[0.5, 0.5], middle[1], [0.5, 0.5]]
    )
    robot = arm(tau_max=[60.0, 25.0], taud_max=[400.0, 150.0])
    durations = [time_optimal_path(robot, path).duration for path in (whole, cut)]
    assert durations[1] == pytest.approx(durations[0], rel=1e-4)


# what cannot be done ------------------------------------------------------------------------------


@pytest.mark.thorough
def test_momentum_carries_over_a_pose_that_cannot_be_held():
    robot = pendulum(tau_max=9.7)
    motion = time_optimal_path(robot, straight_path([[0.0], [np.pi]]))
    assert motion.solved
    assert motion.duration == pytest.approx(motion.provenance["reachability_duration"], rel=2e-3)
    assert dense_excess(robot, motion)["tau"] < 1e-3


def test_a_path_that_cannot_be_travelled_is_a_status_with_the_place():
    robot = pendulum(tau_max=6.0)
    said = []
    motion = time_optimal_path(robot, straight_path([[0.0], [np.pi]]), progress=said.append)
    assert not motion.solved
    assert motion.provenance["blocked_at"] != []
    assert motion.provenance["reachability_duration"] is None
    assert "blocked" in {row.kind for row in motion.outcome.advice}
    assert any("s = " in line for line in said)
    assert motion.status is mo.Status.INFEASIBLE
    tells(motion.advice, "torque of joint 1", "N m")
    (least,) = motion.provenance["least_violation"]
    # the work up to every angle must be what the weight gains: 9.81 (1 - cos q) / q at its largest
    q = np.linspace(0.1, np.pi, 10_000)
    assert 6.0 + least["exceeded_by"] == pytest.approx((9.81 * (1 - np.cos(q)) / q).max(), rel=2e-3)
    assert least["q"] == pytest.approx(straight_path([[0.0], [np.pi]])(least["s"])[0])


def test_what_cannot_be_travelled_is_named_without_a_solver(monkeypatch):
    """Work of 6 N m over half a turn is less than the weight gains."""
    monkeypatch.setattr(ca, "nlpsol", None)
    robot = pendulum(tau_max=6.0, qd_max=10.0)
    assert 6.0 * np.pi < 2 * 9.81
    motion = time_optimal_path(robot, mo.cubic([[0.0], [np.pi]], [0.0, 2.0]))
    assert motion.status is mo.Status.INFEASIBLE
    tells(motion.note, "not solved", "No timing")
    assert motion.provenance["excess"] > 0.05
    np.testing.assert_allclose(motion.q[[0, -1]], [[0.0], [np.pi]], atol=1e-6)


def power_limited(robot, most):
    return robot.with_limits(also=[mo.limits.power(most)])


def test_the_least_relaxation_of_a_swing_takes_the_closed_form():
    """A torque T lifts a pendulum to q if its work T q is that of gravity, 9.81 (1 - cos q)."""
    motion = time_optimal_path(pendulum(tau_max=5.0), straight_path([[0.0], [3.1]]))
    (entry,) = motion.provenance["least_violation"]
    q = np.linspace(0.1, 3.1, 10_000)
    needed = (9.81 * (1.0 - np.cos(q)) / q).max()
    assert entry["exceeded_by"] == pytest.approx(needed - 5.0, rel=1e-3)


def test_power_on_a_rail_takes_the_closed_form():
    """Full force up to P/F, then constant power, until it brakes at full force.

    ``P = m v v'``: the speed grows like the third root of the way.
    """
    mass, force, power, way = 2.0, 20.0, 15.0, 1.5
    motion = time_optimal_path(
        power_limited(slider(mass, tau_max=force), power), straight_path([[0.0], [way]])
    )
    first = power / force  # speed at which the force meets the power

    def past(v):  # way and time until it would brake from v
        rest = mass * (v**3 - first**3) / (3 * power), mass * (v**2 - first**2) / (2 * power)
        return mass * first**2 / (2 * force) + rest[0], mass * first / force + rest[1]

    v = float(brentq(lambda v: past(v)[0] + mass * v**2 / (2 * force) - way, first, 10.0))  # type: ignore[arg-type]
    assert motion.solved
    assert motion.duration == pytest.approx(past(v)[1] + mass * v / force, rel=1e-4)


@pytest.mark.thorough
@pytest.mark.parametrize(
    "limits",
    [
        {"taud_max": 1500.0},
        *(pytest.param(limits, marks=pytest.mark.thorough) for limits in ({}, {"qddd_max": 60.0})),
    ],
)
def test_power_is_kept_with_and_without_rates(microbot, limits):
    """With rates, from a start that knew nothing of them, the guess was no number."""
    robot = power_limited(microbot.with_limits(taud_max=np.inf), [300.0, 400.0, 150.0])
    robot = robot.with_limits(**limits)
    motion = time_optimal_path(robot, REPORT_CUBIC)
    assert motion.solved
    assert mo.certify(robot, motion).ok


@pytest.mark.thorough
def test_a_tight_power_limit_is_met_from_a_start_that_knows_of_it(microbot):
    robot = power_limited(microbot.with_limits(taud_max=np.inf), [40.0, 60.0, 20.0])
    motion = time_optimal_path(robot, REPORT_CUBIC)
    assert motion.solved
    assert motion.duration > 1.5 * motion.provenance["reachability_duration"]
    assert mo.certify(robot, motion).ok


@pytest.mark.thorough
def test_a_table_is_kept_along_a_path_too(microbot):
    """A motor whose torque falls with its speed by a table: no expression of scalars."""
    table = ca.interpolant("table", "bspline", [np.linspace(-8.0, 8.0, 9)], 9 * [450.0])
    falling = mo.Limit("motor", lambda s: s.tau[0] / table(s.qd[0]), lower=-1.0, upper=1.0)
    robot = microbot.with_limits(taud_max=np.inf, also=[falling])
    motion = time_optimal_path(robot, REPORT_CUBIC)
    assert motion.solved
    assert mo.certify(robot, motion).ok


def test_a_limit_without_derivatives_is_named(microbot):
    class Blind(ca.Callback):
        def __init__(self):
            ca.Callback.__init__(self)
            self.construct("blind", {})

        def get_n_in(self):
            return 2

        def eval(self, arguments):
            return [arguments[0] * arguments[1]]

    blind = Blind()
    limit = mo.Limit("blind", lambda s: blind(s.qd[0], s.tau[0]), upper=100.0)
    with refused("limit 'blind'", "derivatives", "enable_fd"):
        time_optimal_path(microbot.with_limits(also=[limit]), REPORT_CUBIC)


@pytest.mark.thorough
def test_more_viscous_friction_than_reachability_can_follow_is_said():
    """A crawl at terminal speed: reachability may fail on the way, the answer is right."""
    robot = slider(tau_max=4.0)
    robot = robot.with_links([replace(k, viscous_friction=5.0) for k in robot.links])
    motion = time_optimal_path(robot, straight_path([[0.0], [6.0]]))
    lag, top = 2.0 / 5.0, 4.0 / 5.0
    braking_way, braking_time = lag * top * (1.0 - np.log(2.0)), lag * np.log(2.0)
    assert motion.solved
    assert motion.duration == pytest.approx(
        (6.0 - braking_way) / top + lag + braking_time, rel=2e-3
    )
    assert motion.provenance["reachability_duration"] == pytest.approx(motion.duration, rel=1e-3)


def test_what_happened_is_in_the_provenance(report_cubic):
    provenance = report_cubic.provenance
    assert sum(provenance["phase_durations"]) == pytest.approx(report_cubic.duration)
    assert provenance["solves"][0]["solver"] == "ipopt"
    assert provenance["limits_kept_by"]["program on places"] == ["power"]
    tells(report_cubic.note, "reachability")


@pytest.mark.slow
def test_a_path_over_any_parameter_takes_the_same_time():
    stretched = PiecewisePolynomial(
        7.0 + 3.0 * ARM_CUBIC.breaks,
        ARM_CUBIC.coefficients / 3.0 ** np.arange(4)[None, :, None],
    )
    durations = [time_optimal_path(arm(), path).duration for path in (ARM_CUBIC, stretched)]
    assert durations[1] == pytest.approx(durations[0], rel=1e-4)


@pytest.mark.thorough
def test_a_robot_without_masses_keeps_a_jerk_limit_along_a_path(microbot):
    limits = mo.Limits(qd_max=2.0, qddd_max=50.0)
    bare = mo.Robot.from_dh(alpha=microbot.alpha, a=microbot.a, d=microbot.d, limits=limits)
    path = mo.spline([[0.0, 0.0, 0.0], [0.5, 0.8, 0.2], [1.0, 0.2, 0.9]], [0.0, 1.0, 2.0])
    motion = mo.time_optimal_path(bare, path, compiled=False)
    assert motion.solved
    assert mo.certify(bare, motion).ok


@pytest.mark.thorough
def test_dry_friction_turns_as_fast_as_a_torque_rate_lets_it():
    """A slider that turns back: its friction of 4 N, with the sign of the velocity."""
    robot = slider(tau_max=20.0, taud_max=300.0)
    robot = robot.with_links([replace(robot.links[0], coulomb_friction=4.0)])
    path = mo.spline([[0.0], [1.0], [0.3]], [0.0, 1.0, 2.0])
    motion = time_optimal_path(robot, path)
    assert motion.solved
    tells(motion.provenance["method"], "program", "places")
    excess = dense_excess(robot, motion)
    assert max(excess["taud"], excess["tau"]) < 1e-3
    unrated = time_optimal_path(robot.with_limits(taud_max=np.inf), path)
    assert motion.duration > 1.005 * unrated.duration


def test_short_motions_are_timed_as_well_as_long_ones():
    """Without gravity torques of 10,000 times the size take a hundredth of the time."""
    usual, short = (
        time_optimal_path(arm(0.0, tau_max=[60.0 * k, 25.0 * k]), ARM_CUBIC) for k in (1.0, 1e4)
    )
    assert short.duration == pytest.approx(usual.duration / 100.0, rel=1e-9)
