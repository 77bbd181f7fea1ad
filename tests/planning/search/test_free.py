"""Free time-optimal motions against closed forms, laws of scaling, and their own limits."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from benchmarks import one_sided

import microbot_ocp as mo
from helpers import tells
from microbot_ocp._base import deadline
from microbot_ocp.motion import PiecewisePolynomial
from microbot_ocp.ocp.refinement import _refiner as refinement
from microbot_ocp.ocp.solution import PhaseSolution, Solution
from microbot_ocp.ocp.solvers import SolveContext
from microbot_ocp.planning import TimeOptimalSettings, time_optimal
from microbot_ocp.planning.free import polynomial, within_limits
from microbot_ocp.planning.search import _search
from microbot_ocp.planning.task import verdict
from planning.shared import ARM_VIA, VIA_Q, VIA_QD, VIA_T, arm, dense_excess, pendulum, slider


@pytest.fixture(scope="module")
def report(microbot):
    return time_optimal(microbot, VIA_Q, mesh=100, starts=3)


# closed forms -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("limits", "duration"),
    [
        ({"tau_max": 4.0}, 2 * np.sqrt(1.5 / 2.0)),
        pytest.param({"qdd_max": 3.0}, 2 * np.sqrt(1.5 / 3.0), marks=pytest.mark.thorough),
        ({"qd_max": 1.2, "tau_max": 4.0}, 1.5 / 1.2 + 1.2 / 2.0),
        ({"tau_max": (-2.0, 4.0)}, np.sqrt(2 * 1.5 * (1 / 2.0 + 1 / 1.0))),
        ({"tau_max": 100.0, "taud_max": 10.0}, (32 * 1.5 / 5.0) ** (1 / 3)),
    ],
)
def test_a_single_joint_takes_the_closed_form(limits, duration):
    motion = time_optimal(slider(**limits), [[0.0], [1.5]], mesh=100, starts=2)
    assert motion.solved
    assert motion.duration == pytest.approx(duration, rel=1e-3)
    assert motion.duration > duration * (1 - 1e-4)


@pytest.mark.parametrize("rate", [{"taud_max": 10.0}, {"qddd_max": 5.0}])
def test_meshes_are_split_where_torque_rates_and_jerks_switch(rate):
    motion = time_optimal(slider(tau_max=4.0, **rate), [[0.0], [1.5]], mesh=10, starts=1)
    assert motion.provenance["intervals"][0] > 20
    ramp = 2.0 / 5.0  # of the acceleration, s
    assert motion.duration == pytest.approx(ramp + np.sqrt(ramp**2 + 4 * 1.5 / 2.0), rel=1e-4)


def test_a_point_on_the_way_of_a_single_joint_costs_nothing():
    motion = time_optimal(slider(tau_max=4.0), [[0.0], [0.4], [1.5]], mesh=60, starts=2)
    assert motion.duration == pytest.approx(2 * np.sqrt(1.5 / 2.0), rel=2e-3)
    passed = next(mark.time for mark in motion.marks if mark.name == "via 2")
    assert passed == pytest.approx(np.sqrt(2 * 0.4 / 2.0), rel=5e-3)


def test_turning_back_at_a_point_is_two_rests():
    motion = time_optimal(slider(tau_max=4.0), [[0.0], [1.5], [0.0]], mesh=60, starts=2)
    # beyond the point at no speed is the best: there and back, braking and leaving in one push
    assert motion.duration == pytest.approx(4 * np.sqrt(1.5 / 2.0), rel=2e-3)


@pytest.mark.parametrize("torque", [9.7, 12.0, 30.0])
def test_in_one_joint_the_free_motion_is_the_timing_of_the_only_path(torque):
    robot = pendulum(tau_max=torque)
    via_q = [[0.0], [np.pi]]
    free = time_optimal(robot, via_q, mesh=80, starts=3)
    path = mo.time_optimal_path(robot, mo.straight_path(via_q))
    assert free.duration == pytest.approx(path.duration, rel=1e-3)


@pytest.mark.thorough
def test_a_weak_pendulum_swings_back_first():
    """6 N m hold it below 37 degrees only: no path straight up exists, swinging does it."""
    robot = pendulum(tau_max=6.0, qd_max=10.0)
    motion = time_optimal(robot, [[0.0], [np.pi]], mesh=60, starts=5)
    assert motion.solved
    assert motion.q.min() < -0.3
    assert dense_excess(robot, motion)["tau"] < 1.5e-3


# laws ---------------------------------------------------------------------------------------------


@pytest.mark.thorough
@pytest.mark.slow
def test_without_gravity_the_way_back_takes_as_long_and_half_with_four_times_the_torque():
    there, again, strong = (
        time_optimal(arm(0.0, tau_max=tau_max), via_q, mesh=60, starts=1).duration
        for tau_max, via_q in (
            ([15.0, 6.0], ARM_VIA),
            ([15.0, 6.0], ARM_VIA[::-1]),
            ([60.0, 24.0], ARM_VIA),
        )
    )
    assert there == pytest.approx(again, rel=5e-4)
    assert there / strong == pytest.approx(2.0, rel=1.5e-3)


@pytest.mark.thorough
@pytest.mark.slow
def test_larger_limits_are_faster_and_never_slower_than_the_scaled_cubic():
    durations = []
    for k in (1.0, 1.5, 3.0):
        limits = mo.Limits(tau_max=[60.0 * k, 25.0 * k], qd_max=3.0 * k)
        robot = arm().with_limits(limits)
        motion = time_optimal(robot, ARM_VIA, mesh=20, starts=1)
        assert motion.duration < mo.shortest_duration(robot, mo.cubic(ARM_VIA, [0, 1, 2])).duration
        durations.append(motion.duration)
    assert durations[0] > 1.05 * durations[1] > 1.05**2 * durations[2]


@pytest.mark.thorough
def test_a_point_less_is_never_slower():
    robot = arm()
    all_points = time_optimal(robot, ARM_VIA, mesh=25, starts=1).duration
    ends_only = time_optimal(robot, ARM_VIA[[0, 2]], mesh=50, starts=1).duration
    assert ends_only < all_points


# the report's task --------------------------------------------------------------------------------


@pytest.mark.thorough
@pytest.mark.slow
def test_the_report_task_is_solved_in_less_than_any_given_path(microbot, report):
    assert report.solved
    assert report.duration == pytest.approx(1.9236, abs=1e-3)
    cubic = mo.cubic(VIA_Q, VIA_T, VIA_QD)
    assert report.duration < mo.time_optimal_path(microbot, cubic).duration
    assert report.duration < mo.shortest_duration(microbot, cubic).duration


def test_every_limit_holds_fifty_times_as_finely_as_the_mesh(microbot, report):
    excess = dense_excess(microbot, report, points=50)
    assert set(excess) == {"q", "qd", "tau"}
    # what was asked for, and what linear sampling may add
    assert max(excess.values()) < TimeOptimalSettings().limit_tolerance + 2e-4
    assert max(excess["qd"], excess["tau"]) > -1e-3


def test_via_points_are_passed_exactly(report):
    times = [mark.time for mark in report.marks]
    assert [mark.name for mark in report.marks] == ["via 1", "via 2", "via 3"]
    np.testing.assert_allclose(report.sample(times).q, VIA_Q, rtol=0, atol=1e-9)
    np.testing.assert_allclose(report.qd[[0, -1]], 0.0, atol=1e-9)
    assert np.abs(report.sample(times[1]).qd).max() > 0.1


def test_the_acceleration_is_continuous_and_so_is_the_torque(report):
    np.testing.assert_allclose(
        report.sample(report.breaks[1:-1] - 1e-9).qdd,
        report.sample(report.breaks[1:-1] + 1e-9).qdd,
        atol=1e-4,
    )


@pytest.mark.thorough
@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [
        {"seed": 7, "starts": 4},
        pytest.param({"starts": 1}, marks=pytest.mark.thorough),
        pytest.param({"compiled": False, "starts": 2}, marks=pytest.mark.thorough),
        pytest.param({"mesh": 100, "starts": 2}, marks=pytest.mark.thorough),
    ],
)
def test_other_starts_and_meshes_lead_to_the_same_optimum(microbot, report, changes):
    motion = time_optimal(microbot, VIA_Q, **{"mesh": 40, **changes})
    assert motion.solved
    assert motion.duration == pytest.approx(report.duration, rel=1e-3)


@pytest.mark.thorough
@pytest.mark.slow
def test_the_same_seed_is_the_same_motion():
    one, other = (time_optimal(arm(), ARM_VIA, mesh=20, starts=3, seed=3) for _ in range(2))
    assert one.duration == other.duration
    np.testing.assert_array_equal(one.q, other.q)


@pytest.mark.parametrize(
    ("led_to", "enough"),
    [
        ([1.0] * 3, True),
        ([1.0, 1.0], False),
        ([1.0, 1.0, 0.9, 1.0, 1.0], True),
        ([1.0, 1.1, 0.9, 1.0, 1.0], False),  # 3 of 5: the next is another with 12 in 20
        ([1.0, 1.1, 0.9, 1.0, 1.0, 1.0], True),
        ([1.0, None, None, 1.0, None], True),  # to lead nowhere is an outcome, too
        ([1.0, None, 0.9, None, None], False),
        ([None] * 9, False),
    ],
)
def test_starts_go_on_while_another_is_likely_to_lead_elsewhere(led_to, enough):
    found = [
        SimpleNamespace(before=None, solved=d is not None, duration=d, way=None) for d in led_to
    ]
    assert _search.settled(found, TimeOptimalSettings()) is enough
    assert _search.settled(found, TimeOptimalSettings(starts=1)) is (led_to[0] is not None)


@pytest.mark.thorough
def test_starts_leave_half_of_the_time_for_finer_meshes(microbot, monkeypatch):
    monkeypatch.setattr(_search.MotionSearch, "spent", 0.6)
    motion = time_optimal(microbot, VIA_Q, mesh=20)
    rows = {row.strategy: row.run for row in motion.outcome.ledger}
    assert rows["start"] == rows["full mesh"] == rows["splitting"] == 1
    assert motion.status is mo.Status.TIME_LIMIT


@pytest.mark.thorough
def test_an_optimum_that_few_starts_led_to_is_not_called_the_fastest(microbot):
    motion = time_optimal(microbot, VIA_Q, mesh=20, starts=2, tries=2)
    assert motion.status is mo.Status.LOCAL_OPTIMUM
    assert "2 starts" in motion.note
    assert mo.certify(microbot, motion).ok


@pytest.mark.thorough
def test_starts_are_compared_on_one_mesh():
    """With a weak side in every joint; on a mesh of their own swings seemed faster than bows."""
    task = one_sided.task_of(100)
    motion = time_optimal(task.robot, task.via)
    assert motion.solved
    assert motion.duration < 3.37


def test_the_provenance_tells_every_start_and_every_mesh(report):
    provenance = report.provenance
    assert [start["start"] for start in provenance["starts"]] == ["cubic", "straight", "bow 1"]
    assert sum(provenance["phase_durations"]) == pytest.approx(report.duration, rel=1e-12)
    assert 1e-5 < provenance["smoothing_cost"] / report.duration < 1e-4
    assert provenance["solves"][-1]["accepted"]
    sizes = [sum(solve["intervals"]) for solve in provenance["solves"]]
    assert max(sizes) >= 200
    assert all(solve["attempts"] for solve in provenance["solves"])
    tells(report.note, "3 starts")


@pytest.mark.slow
def test_settings_are_given_as_one_or_singly(microbot):
    one = time_optimal(arm(), ARM_VIA, settings=TimeOptimalSettings(mesh=20, starts=1))
    other = time_optimal(arm(), ARM_VIA, settings=TimeOptimalSettings(mesh=80, starts=1), mesh=20)
    assert one.duration == other.duration


@pytest.mark.slow
def test_progress_is_told_in_lines_and_iterations(microbot):
    told = []
    motion = time_optimal(arm(), ARM_VIA, mesh=30, starts=3, progress=told.append)
    said = [event for event in told if isinstance(event, str)]
    iterations = [event for event in told if not isinstance(event, str)]
    solves = [attempt for one in motion.provenance["solves"] for attempt in one["attempts"]]
    # fatrop asks for a Jacobian at every iterate, the first included
    assert len(iterations) >= sum(attempt["iterations"] for attempt in solves)
    t, state = iterations[-1].motion()
    assert t[-1] == pytest.approx(motion.duration, rel=1e-6)
    np.testing.assert_allclose(state.q[[0, -1]], ARM_VIA[[0, -1]], atol=1e-6)
    np.testing.assert_allclose(state.q, motion.sample(t).q, atol=1e-6)
    limit = iterations[-1].robot.limits.tau_max
    assert np.abs(iterations[-1].torque() / limit).max() == pytest.approx(1.0, abs=1e-5)
    assert sum(line.startswith("start ") for line in said) == 3
    assert any(line.startswith("mesh ") for line in said)
    assert all(line and "\n" not in line for line in said)


# other limits -------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("limits", "met", "allowed"),
    [
        ({"tau_max": [60.0, 25.0], "qdd_max": [4.0, 6.0]}, "qdd", 1e-3),
        ({"qd_max": 2.0, "qdd_max": 8.0}, "qd", 1e-3),
        pytest.param(
            {"tau_max": [60.0, 25.0], "taud_max": [400.0, 150.0]},
            "taud",
            5e-3,
            marks=pytest.mark.thorough,
        ),
    ],
)
def test_acceleration_and_torque_rate_limits_hold(limits, met, allowed):
    robot = arm(**limits)
    motion = time_optimal(robot, ARM_VIA, mesh=20, starts=1)
    assert motion.solved
    excess = dense_excess(robot, motion)
    assert set(excess) == {name.removesuffix("_max") for name in limits}
    assert max(excess.values()) < allowed
    assert excess[met] > -5e-3
    certificate = mo.certify(robot, motion, via_q=ARM_VIA)
    assert {c.quantity: c for c in certificate.limit_checks}[met].violation < allowed


def test_position_limits_hold():
    """Unlimited, joint 2 swings out further than its points."""
    wide, narrow = arm(), arm(tau_max=[60.0, 25.0], qd_max=3.0, q_min=-0.52, q_max=1.02)
    free = time_optimal(wide, ARM_VIA, mesh=40, starts=1)
    motion = time_optimal(narrow, ARM_VIA, mesh=40, starts=1)
    assert free.q.min() < -0.55
    assert dense_excess(narrow, motion)["q"] < 1e-3
    assert motion.duration > free.duration


@pytest.mark.slow
@pytest.mark.parametrize(
    ("friction", "allowed"),
    [
        pytest.param({"viscous_friction": 3.0}, 1e-3, marks=pytest.mark.thorough),
        pytest.param({"coulomb_friction": 3.0}, 5e-3, marks=pytest.mark.thorough),
        ({"viscous_friction": 2.0, "coulomb_friction": 2.0}, 5e-3),
    ],
)
def test_torque_limits_hold_with_friction(friction, allowed):
    robot = arm()
    rubbing = robot.with_links([replace(link, **friction) for link in robot.links])
    motion = time_optimal(rubbing, ARM_VIA, mesh=50, starts=1)
    assert motion.solved
    excess = dense_excess(rubbing, motion)
    assert excess["tau"] < allowed
    assert excess["qd"] < 1e-3
    # the friction is in the torques: without it they would be others
    smooth = np.array(mo.inverse_dynamics(robot)(motion.q.T, motion.qd.T, motion.qdd.T)).T
    assert np.abs(motion.tau - smooth).max() > 1.0


def test_a_motion_that_was_not_solved_says_so(monkeypatch):
    whole = SolveContext.solve

    def stopped(context, mesh, guess, **how):
        return whole(context, mesh, guess, **how, max_iterations=2)

    monkeypatch.setattr(SolveContext, "solve", stopped)
    motion = time_optimal(arm(), ARM_VIA, mesh=20, starts=2)
    assert not motion.solved
    assert motion.status == "iteration limit"
    tells(motion.note, "not solved", "iteration limit")
    assert motion.advice in motion.note
    # what is returned all the same keeps the limits
    assert "returned" in {row.kind for row in motion.outcome.advice}
    assert max(dense_excess(arm(), motion).values()) < 5e-3


def test_where_the_time_ends_before_limits_hold_between_mesh_points_it_says_so(monkeypatch):
    def ended(self, solution, *_, **__):
        deadline._until.set(0.0)  # of the search: what keeps the limits has some time left
        return solution

    monkeypatch.setattr(refinement.Refiner, "refine", ended)
    motion = time_optimal(arm(), ARM_VIA, mesh=5, starts=1)
    assert motion.status == "time limit"
    assert "returned" in {row.kind for row in motion.outcome.advice}


def test_a_motion_is_slowed_down_only_where_it_exceeds_a_limit():
    robot = arm()
    family = mo.limits.LimitFamily.of(robot)
    shape = mo.quintic(ARM_VIA, np.arange(float(len(ARM_VIA))))
    shape = mo.shortest_duration(robot, shape).polynomial
    faster = PiecewisePolynomial(  # by 2 %: what is at its limit exceeds it by 4 % or less
        shape.breaks / 1.02, shape.coefficients * 1.02 ** np.arange(6)[:, None]
    )
    motion = within_limits(family, faster, faster.breaks, 5e-4, False)
    assert motion is not None
    assert mo.certify(robot, motion, via_q=ARM_VIA).ok
    assert max(dense_excess(robot, motion).values()) < 1e-3
    assert faster.breaks[-1] < motion.duration < shape.breaks[-1]
    unchanged = within_limits(family, shape, shape.breaks, 5e-4, False)
    assert unchanged is not None
    np.testing.assert_allclose(unchanged.duration, shape.breaks[-1], rtol=1e-6)


def test_gaps_of_a_solver_on_short_intervals_are_no_jerk():
    steps = np.where(np.arange(200) % 20 == 7, 1e-5, 1e-2)
    t = np.append(0.0, np.cumsum(steps))
    qdd = np.column_stack([np.sin(t), np.cos(3 * t)])
    step, h = np.diff(qdd, axis=0), steps[:, None]
    start = np.zeros((1, 2))
    qd = np.vstack([start, np.cumsum(h * (qdd[:-1] + step / 2), axis=0)])
    moved = h * (qd[:-1] + h * (qdd[:-1] / 2 + step / 6))
    q = np.vstack([start, np.cumsum(moved, axis=0)])
    q += 1e-8 * np.random.default_rng(0).uniform(-1, 1, q.shape)
    phase = PhaseSolution("phase 1", t[-1], t / t[-1], {"q": q, "qd": qd, "qdd": qdd})
    solved = Solution(mo.Status.SOLVED, t[-1], (phase,), (), np.zeros(0), 0.0)
    motion = polynomial(solved)
    assert np.abs(motion(t) - q).max() < 1e-7
    np.testing.assert_allclose(motion(t[[0, -1]]), q[[0, -1]], rtol=0, atol=1e-14)
    acceleration = motion.derivative().derivative()
    np.testing.assert_allclose(acceleration(t), qdd, rtol=0, atol=1e-5)
    middle = 0.5 * (t[:-1] + t[1:])
    np.testing.assert_allclose(acceleration.derivative()(middle), step / h, rtol=0, atol=1e-4)


def test_a_motion_slowed_down_evenly_may_be_beyond_a_position_as_far_as_is_tolerated():
    """A limit of the jerk takes a motion that is slowed down evenly, which moves no place."""
    shape = mo.quintic([[0.0], [1.0]], [0.0, 1.0])
    fast = np.abs(mo.Motion.from_polynomial(slider(), shape, label="fast").qdd).max()
    for q_max, kept in ((1.0 / 1.0004, True), (1.0 / 1.0006, False)):
        robot = slider(q_max=q_max, q_min=-q_max, qdd_max=fast / 1.21, qddd_max=1e3)
        motion = within_limits(mo.limits.LimitFamily.of(robot), shape, shape.breaks, 5e-4, False)
        assert (motion is not None) is kept
        if motion is not None:
            assert motion.duration == pytest.approx(1.1, rel=1e-3)


def test_solved_keeps_its_limits_as_well_as_was_asked_for():
    converged: Any = SimpleNamespace(status=mo.Status.SOLVED, rows=(), phases=())
    family = mo.limits.LimitFamily.of(arm())
    for excess, said in ((0.9e-6, "solved"), (1.1e-6, "limits exceeded")):
        found = verdict(family, converged, [np.array([0.0, excess])], limit_tolerance=1e-6)
        assert found.status == said


def test_who_says_nothing_of_time_has_two_minutes_and_infinite_is_no_limit():
    for limit, left in ((None, 120.0), (3.0, 3.0), (np.inf, np.inf)):
        with TimeOptimalSettings(time_limit=limit).within(120.0):
            assert deadline.left() == pytest.approx(left, abs=1.0)
    assert mo.planning.PathTimingSettings().time_limit == 120.0


@pytest.mark.thorough
def test_of_coarse_answers_the_one_that_is_fastest_within_its_limits_is_refined():
    """A coarse answer that exceeds limits by more took 3.787 s, one that led to 4.027 s 4.151."""
    tau_max = ([-21.9, -83.2, -125.4], [78.1, 312.5, 38.2])
    robot = mo.load_robot("microbot").with_limits(tau_max=tau_max)
    motion = time_optimal(robot, [[-0.28, 1.0, 2.33], [1.81, -0.06, -1.48]])
    assert motion.solved
    assert motion.duration < 1.001 * 3.7093
