"""One task solved again with other numbers, against cold solves and closed forms."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

import microbot_ocp as mo
from helpers import refused
from microbot_ocp._base import codegen
from planning.shared import VIA_Q, arm, pendulum, slider

pytestmark = pytest.mark.slow

# Payload, kg, and factor on the torques
FAR = [(2.0, 1.0), (0.0, 0.7), (0.0, 1.6), (0.0, 4.0), (1.0, 2.0), (3.0, 1.5)]


@pytest.fixture(scope="module")
def prepared(microbot):
    return mo.TimeOptimalSolver(microbot, VIA_Q)


@pytest.mark.parametrize(
    ("share", "payload"), [pytest.param(0.9, 1.0, marks=pytest.mark.thorough), (1.3, 2.5)]
)
def test_equals_a_cold_solve_of_the_robot_with_these_limits_and_this_payload(
    microbot, prepared, share, payload
):
    own = microbot.limits
    limits = mo.Limits(own.q_min, own.q_max, qd_max=1.1 * own.qd_max, tau_max=share * own.tau_max)
    again = prepared(limits, payload)
    holding = microbot.with_payload(payload).with_limits(limits)
    cold = mo.time_optimal(holding, VIA_Q, mesh=20, starts=1)
    assert again.solved
    assert again.duration == pytest.approx(cold.duration, rel=2e-3)
    certificate = mo.certify(holding, again, via_q=VIA_Q)
    assert certificate.ok, certificate.verdict


@pytest.mark.thorough
def test_the_answer_does_not_depend_on_what_was_asked_before(microbot, prepared):
    first = prepared(payload=0.5)
    prepared(mo.Limits(qd_max=1.0, tau_max=0.8 * microbot.limits.tau_max))
    again = prepared(payload=0.5)
    assert np.array_equal(first.q, again.q)


def test_near_the_limits_of_the_robot_a_solve_takes_few_iterations(prepared):
    (start,) = prepared(payload=0.02).provenance["starts"]
    assert start["start"] == "prepared"
    assert start["iterations"] < 25


@pytest.mark.thorough
def test_a_search_finds_nothing_slower(prepared):
    quick, thorough = prepared(payload=1.5), prepared(payload=1.5, search=True)
    assert len(thorough.provenance["starts"]) == 6  # the prepared motion and five guesses
    assert thorough.duration <= quick.duration * (1 + 1e-4)


@pytest.mark.parametrize(("tau_max", "payload"), [(4.0, 0.0), (4.0, 3.0), (10.0, 1.0)])
def test_a_payload_on_a_rail_takes_the_closed_form(tau_max, payload):
    solver = mo.TimeOptimalSolver(slider(mass=2.0, tau_max=4.0), [[0.0], [1.5]], mesh=40)
    motion = solver(mo.Limits(tau_max=tau_max), payload)
    assert motion.duration == pytest.approx(2 * np.sqrt(1.5 * (2.0 + payload) / tau_max), rel=1e-3)


def test_another_payload_compiles_nothing(microbot, prepared, monkeypatch):
    prepared()

    def compiled(*_):
        pytest.fail("a compiler was called")

    monkeypatch.setattr(codegen, "_run", compiled)
    payload = 2.0 + np.random.default_rng().uniform()  # compiled never before
    assert prepared(payload=payload).solved


def test_torque_rates_know_the_payload():
    solver = mo.TimeOptimalSolver(slider(mass=2.0, tau_max=100.0, taud_max=10.0), [[0.0], [1.5]])
    for payload in (0.0, 2.0):
        jerk = 10.0 / (2.0 + payload)
        motion = solver(payload=payload)
        assert motion.duration == pytest.approx((32 * 1.5 / jerk) ** (1 / 3), rel=1e-3)


@pytest.mark.thorough
def test_what_cannot_be_done_is_not_called_solved():
    # at rest both ends need no torque, but no swing is allowed to help the arm over the level
    solver = mo.TimeOptimalSolver(
        pendulum(q_min=-0.01, q_max=3.2, tau_max=12.0), [[0.0], [np.pi]], mesh=20, starts=2
    )
    motion = solver(mo.Limits(q_min=-0.01, q_max=3.2, tau_max=3.0))
    assert not motion.solved
    assert motion.status in ("infeasible", "iteration limit")
    assert "not solved" in motion.note
    _, *guesses = (start["start"] for start in motion.provenance["starts"])
    assert guesses == ["cubic", "straight"]
    assert solver().solved


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"payload": -1.0}, ("mass", "payload", "0 kg", "-1.0")),
        ({"payload": float("nan")}, ("mass", "payload", "finite", "nan")),
        ({"payload": 3.5}, ("via point 1", "at rest", "'elbow'", "215.6 N m")),
        ({"limits": mo.Limits(qd_max=2.0, taud_max=50.0)}, ("limits", "taud", "with_limits")),
        (
            {"limits": mo.Limits(q_max=1.0, qd_max=2.0)},
            ("via point 3", "position limits", "57.2958 deg"),
        ),
        ({"limits": mo.Limits()}, ("limits", "'waist'", "velocity")),
    ],
)
def test_bad_numbers_are_refused_before_any_solve(prepared, no_solver, arguments, message):
    with refused(*message):
        prepared(**arguments)


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ({"mesh": 2}, ("4 intervals", "not 2")),
        ({"starts": 0}, ("1, not 0",)),
        ({"rounds": -1}, ("0, not -1",)),
        ({"mesh": 10.5}, ("whole number", "10.5")),
    ],
)
def test_bad_settings_are_refused(microbot, no_solver, setting, said):
    with refused(*setting, *said):
        mo.TimeOptimalSolver(microbot, VIA_Q, **setting)


def test_other_via_points_are_numbers_of_the_same_solver(microbot, prepared):
    via_q = VIA_Q + np.array([[0.1, 0.0, 0.2], [0.0, 0.1, 0.0], [0.2, -0.1, 0.0]])
    first = prepared(payload=1.0, via_q=via_q)
    prepared(via_q=VIA_Q[::-1])
    again = prepared(payload=1.0, via_q=via_q)
    assert first.solved
    assert np.array_equal(first.q, again.q)
    assert mo.certify(microbot.with_payload(1.0), first, via_q=via_q).ok
    with refused("via_q", "3 points", "2"):
        prepared(via_q=via_q[:2])


@pytest.mark.thorough
def test_a_prepared_answer_that_is_solved_keeps_its_limits_as_well_as_others(prepared):
    for share in (0.8, 1.1):
        limits = prepared.robot.limits
        motion = prepared(mo.Limits(qd_max=limits.qd_max, tau_max=share * limits.tau_max))
        assert motion.solved
        assert motion.provenance["excess"] <= mo.planning.TimeOptimalSettings().limit_tolerance


@pytest.mark.parametrize("rate", [np.inf, 10.0])
@pytest.mark.parametrize("share", [0.3])  # before its torque falls as fast as it can
def test_what_is_left_of_a_fastest_motion_is_the_fastest_from_where_it_is(rate, share):
    rail = slider(mass=2.0, tau_max=4.0, taud_max=rate)
    solver = mo.TimeOptimalSolver(rail, [[0.0], [1.5]], mesh=40)
    whole = solver()
    now = share * whole.duration
    rest = solver(start=whole.sample([now]))
    assert rest.solved
    assert rest.duration == pytest.approx(whole.duration - now, rel=2e-3)
    assert mo.certify(rail, rest).ok
    for had, has in zip(whole.sample([now]), (rest.q, rest.qd, rest.qdd), strict=True):
        if had is not None and (has is not rest.qdd or np.isfinite(rate)):
            np.testing.assert_allclose(has[:1], had, atol=1e-5)


def test_from_any_velocity_to_a_moved_goal_the_rail_takes_the_closed_form():
    solver = mo.TimeOptimalSolver(slider(mass=2.0, tau_max=4.0), [[0.0], [1.5]], mesh=60)
    way, most = 0.4, 2.0
    for speed in (1.0, -0.5, 2.0):  # at 2 the goal is passed, and the rail comes back
        side = 1.0 if speed * abs(speed) / (2.0 * most) < way else -1.0
        turn = np.sqrt(0.5 * speed**2 + side * most * way)
        motion = solver(via_q=[[0.0], [0.5 + way]], start=([0.5], [speed]))
        assert motion.duration == pytest.approx((2.0 * turn - side * speed) / most, rel=2e-3)


def test_a_copy_keeps_the_windows_of_dry_friction():
    rail = slider(mass=2.0, tau_max=4.0, taud_max=100.0)
    rail = rail.with_links([replace(rail.links[0], coulomb_friction=1.0)])
    solver = mo.TimeOptimalSolver(rail, [[0.0], [1.5]], mesh=20, starts=1, compiled=False)
    solver()
    again = pickle.loads(pickle.dumps(solver))
    assert again(payload=0.05).duration == solver(payload=0.05).duration


def test_an_arm_without_masses_is_prepared_as_well():
    arm = mo.Robot.from_dh([0, 0], [0, 1], [0, 0], limits=mo.Limits(qd_max=2.0, qdd_max=5.0))
    solver = mo.TimeOptimalSolver(arm, [[0.0, 0.0], [0.5, 0.8]], mesh=20, starts=1, compiled=False)
    motion = solver()
    assert motion.duration == pytest.approx(2.0 * np.sqrt(0.8 / 5.0), rel=1e-3)
    assert motion.sensitivities(arm).upper["qdd"][1] < -0.03
    on = solver(via_q=[[0.0, 0.0], [0.5, 0.6]], start=motion.sample([0.1]))
    assert mo.certify(arm, on).ok
    with refused("robot 'robot'", "payload", "masses"):
        solver(payload=1.0)


@pytest.mark.thorough
@pytest.mark.parametrize("speed", [-0.5, -1.0])
def test_a_rail_with_dry_friction_that_has_to_turn_back_keeps_its_force(speed):
    """Braking, friction helps; where it turns over the force jumps between two mesh points."""
    rail = slider(mass=2.0, tau_max=4.0)
    rail = rail.with_links([replace(rail.links[0], coulomb_friction=1.0)])
    solver = mo.TimeOptimalSolver(rail, [[0.0], [1.5]], mesh=40, compiled=False)
    motion = solver(via_q=[[0.0], [0.9]], start=([0.5], [speed]))
    assert motion.solved, motion.note
    assert mo.certify(rail, motion).ok
    gains, brakes = 1.5, 2.5
    per_speed = 1.0 / gains + 1.0 / brakes
    fastest = np.sqrt(2.0 * (0.4 + speed**2 / (2.0 * brakes)) / per_speed)
    assert motion.duration == pytest.approx(fastest * per_speed - speed / brakes, rel=0.02)


def test_a_start_beyond_the_limits_is_refused(microbot, prepared):
    still = np.zeros(3)
    with refused("start", "velocity", "%"):
        prepared(start=(still, 1.1 * microbot.limits.qd_max))
    with refused("start", "(q, qd) or (q, qd, qdd)", "1 arrays"):
        prepared(start=(still,))
    with refused("start", "via point 2"):
        prepared(start=(prepared.via_q[1], 0.1 * microbot.limits.qd_max))
    for over in (1e-4, 4e-3):  # what a certificate lets pass is no fault of the motion
        edge = prepared(start=(still, (1.0 + over) * microbot.limits.qd_max * [1, 0, 0]))
        assert edge.solved, edge.note
        assert mo.certify(microbot, edge).ok


@pytest.mark.thorough
@pytest.mark.parametrize(("rounds", "slowed"), [(0, True), (8, False)])
def test_on_a_coarse_mesh_a_motion_from_a_moving_start_keeps_its_limits(microbot, rounds, slowed):
    """Refined though that takes longer, or on its path slowed down: the start stays."""
    solver = mo.TimeOptimalSolver(microbot, VIA_Q, mesh=12, rounds=rounds)
    shape = mo.shortest_duration(microbot, mo.quintic(VIA_Q, [0.0, 1.0, 2.0])).polynomial
    under_way = mo.Motion.from_polynomial(microbot, shape, label="quintic")
    state = under_way.sample([0.1 * under_way.duration])
    motion = solver(start=state)
    assert motion.solved, motion.note
    assert ("slowed down" in motion.remark) == slowed
    assert mo.certify(microbot, motion, limit_tolerance=6e-4).ok
    np.testing.assert_allclose([motion.q[0], motion.qd[0]], [state.q[0], state.qd[0]], atol=1e-6)


@pytest.mark.thorough
@pytest.mark.parametrize(("mass", "torque"), FAR)
def test_far_from_the_own_limits_a_solve_is_as_fast_as_a_cold_one(microbot, prepared, mass, torque):
    robot = microbot.with_limits(
        tau_min=torque * microbot.limits.tau_min, tau_max=torque * microbot.limits.tau_max
    )
    motion = prepared(robot.limits, mass)
    cold = mo.time_optimal(robot.with_payload(mass), VIA_Q)
    assert motion.solved
    assert motion.duration <= (1.0 + 2e-4) * cold.duration
    assert mo.certify(robot.with_payload(mass), motion, via_q=VIA_Q).ok


def as_fast_as_cold(solver, robot, via_q):
    motion, cold = solver(via_q=via_q), mo.time_optimal(robot, via_q)
    assert motion.solved
    assert cold.solved
    assert motion.duration <= (1.0 + 1e-4) * cold.duration
    assert mo.certify(robot, motion, via_q=via_q).ok


@pytest.mark.thorough
@pytest.mark.parametrize(
    "via_q",
    [
        pytest.param([[0.2, -0.3], [1.2, 0.8]], marks=pytest.mark.thorough),
        [[0.0, 0.0], [-0.5, 1.0]],
    ],
)
def test_under_torque_rates_other_via_points_are_as_fast_as_a_cold_solve(via_q):
    """On an even mesh half an interval would be lost at every switch: 1 % of the motion."""
    robot = arm(tau_max=[60.0, 25.0], taud_max=[400.0, 150.0])
    as_fast_as_cold(mo.TimeOptimalSolver(robot, [[0, 0], [1, 0.5]], starts=2), robot, via_q)


def test_under_a_tool_speed_other_via_points_are_as_fast_as_a_cold_solve():
    """On a mesh split for other switches 0.3 % of the motion would be lost."""
    robot = mo.load_robot("ur5e").with_limits(also=[mo.limits.tool_speed(1.5)])
    via_q = np.array([[0.0, -1.2, 1.0, -1.0, -1.5, 0.0], [1.2, -0.8, 1.4, -1.2, -1.0, 0.5]])
    solver = mo.TimeOptimalSolver(robot, via_q, starts=2)
    as_fast_as_cold(solver, robot, via_q + 0.1)


@pytest.mark.thorough
def test_with_dry_friction_other_via_points_are_as_fast_as_a_cold_solve():
    robot = mo.load_robot("panda")
    via_q = np.array(
        [
            [-1.2005, -0.464, 0.8729, -1.4475, -1.1759, 1.7414, -0.0607],
            [-0.9858, 0.4135, -1.1193, -1.7341, 0.0485, 1.7367, 0.2515],
        ]
    )
    solver = mo.TimeOptimalSolver(robot, via_q, starts=2)
    as_fast_as_cold(solver, robot, via_q)
    as_fast_as_cold(solver, robot, via_q + 0.1 * np.sin(np.arange(14.0)).reshape(2, 7))
