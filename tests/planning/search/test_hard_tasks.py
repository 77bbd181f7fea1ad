"""Tasks that are hard: locked joints, tiny and huge sizes, torques too small to lift the arm."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from benchmarks.torture import task_of

import microbot_ocp as mo
from helpers import refused, sampled, tells
from microbot_ocp._base.outcome import Advice
from microbot_ocp.limits import LimitFamily
from microbot_ocp.ocp.solution import quiet
from microbot_ocp.planning import TimeOptimalSettings
from microbot_ocp.planning.free import known_ways
from microbot_ocp.planning.search._problem import MotionProblem
from microbot_ocp.planning.search._refinement import search_of
from microbot_ocp.planning.search._result import fastest
from planning.shared import arm, pendulum, slider

LOCKED_VIA = np.array([[0.0, 0.3], [1.0, 0.3], [0.5, 0.3]])


@pytest.fixture
def locked():
    return arm().with_limits(qd_max=[3.0, 0.0])


@pytest.mark.thorough
def test_a_locked_joint_stands_still_in_a_free_motion(locked):
    motion = mo.time_optimal(locked, LOCKED_VIA, mesh=20, starts=1, compiled=False)
    assert motion.solved
    assert mo.certify(locked, motion, via_q=LOCKED_VIA).ok
    np.testing.assert_allclose(motion.q[:, 1], 0.3, atol=1e-9)
    free = mo.time_optimal(arm(), LOCKED_VIA, mesh=20, starts=1, compiled=False)
    assert free.duration <= motion.duration * (1 + 1e-6)


def test_a_locked_joint_stands_still_along_a_path(locked):
    path = mo.straight_path(LOCKED_VIA)
    motion = mo.time_optimal_path(locked, path, compiled=False)
    assert motion.solved
    assert mo.certify(locked, motion).ok
    assert mo.planning.time_path(locked, path).duration == pytest.approx(motion.duration, rel=1e-3)


@pytest.mark.parametrize("quantity", ["qd_max", "qdd_max", "qddd_max"])
def test_a_locked_joint_that_must_move_is_named(quantity):
    changes: dict[str, Any] = {quantity: [3.0, 0.0]}
    robot = arm().with_limits(**changes)
    via = [[0.0, 0.3], [1.0, 0.3], [0.5, 0.4]]
    with refused("'joint 2'", "17.1887 deg", "via point 2", "22.9183 deg"):
        mo.time_optimal(robot, via)
    with refused("path", "'joint 2'", "0"):
        mo.time_optimal_path(robot, mo.straight_path(via))


@pytest.mark.parametrize("way", sampled([1e-5, 1.0, 1e4], 3))
@pytest.mark.parametrize("mass", [1e-3, 1e3])
def test_a_rail_of_any_length_takes_the_closed_form(way, mass):
    motion = mo.time_optimal(slider(mass, tau_max=5.0), [[0.0], [way]], mesh=40, compiled=False)
    assert motion.solved
    assert motion.duration == pytest.approx(2 * np.sqrt(way * mass / 5.0), rel=2e-3)


def test_a_velocity_limit_may_be_tiny():
    robot = slider(qd_max=1e-4, tau_max=5.0)
    motion = mo.time_optimal(robot, [[0.0], [1.0]], mesh=40, compiled=False)
    assert motion.solved
    assert motion.duration == pytest.approx(1e4, rel=0.03)


@pytest.mark.thorough
@pytest.mark.parametrize("apart", [1e-3, 1e-5])
def test_via_points_close_together_cost_nothing(apart):
    robot = slider(tau_max=2.0)
    via = [[0.0], [0.5], [0.5 + apart], [1.0]]
    motion = mo.time_optimal(robot, via, mesh=20, compiled=False)
    assert motion.solved
    assert motion.duration == pytest.approx(2.0, rel=2e-3)


@pytest.mark.thorough
@pytest.mark.slow
def test_a_pendulum_too_weak_to_be_lifted_swings_several_times():
    robot = pendulum(tau_max=3.0, qd_max=20.0)
    via = [[0.0], [np.pi]]
    motion = mo.time_optimal(robot, via, mesh=15, compiled=False)
    assert motion.solved
    assert mo.certify(robot, motion, via_q=via).ok
    assert np.count_nonzero(np.diff(np.sign(motion.qd[1:-1, 0]))) >= 2
    tried = motion.provenance["starts"]
    assert len(tried) <= 30
    one = mo.time_optimal(robot, via, mesh=15, compiled=False, starts=1, tries=1)
    assert len(one.provenance["starts"]) == 1


@pytest.mark.thorough
@pytest.mark.slow
def test_starts_that_disagree_on_a_coarse_mesh_are_compared_on_a_finer_one():
    """A light arm that turns by radians in 0.1 s: a coarse mesh exceeds its torques by 114 %."""
    task = task_of(16)
    motion = mo.time_optimal(task.robot, task.via)
    rows = {row.strategy: row.run for row in motion.outcome.ledger}
    assert rows["start"] > len(motion.provenance["starts"])  # some were solved on both meshes
    assert motion.solved
    assert motion.duration < 0.09323  # 0.0932088 s; the coarse mesh promises 0.0930
    assert mo.certify(task.robot, motion, via_q=task.via).ok


def test_without_a_search_cubics_stay_within_position_limits_that_a_spline_leaves():
    robot = mo.load_robot("planar_2r").with_limits(q_min=-1.0, q_max=1.0)
    via = [[0.9, 0.0], [1.0, 0.5], [-0.9, 0.0]]
    motion = mo.time_optimal(robot, via, time_limit=1e-3, compiled=False)
    assert motion.status == "time limit"
    assert mo.certify(robot, motion, via_q=via).ok


def test_an_iterate_whose_velocity_jumps_at_a_via_point_is_not_slowed_down():
    robot, via = arm(), np.array([[0.0, 0.3], [1.0, -0.5], [0.5, 0.8]])
    settings = TimeOptimalSettings(mesh=20, starts=1, compiled=False)
    search = MotionProblem.through(LimitFamily.of(robot), via, settings)
    solution = fastest(search_of(search, quiet)).answer.solution
    assert search.slowed(solution) is not None
    first, second = solution.phases
    turned = {**second.values, "qd": second["qd"] + 1e-3}
    assert search.slowed(replace(solution, phases=(first, replace(second, values=turned)))) is None


@pytest.mark.thorough
@pytest.mark.slow
def test_without_a_search_even_shares_of_the_time_are_tried():
    """A light arm whose dry friction takes more than gravity: limits do not tell the shares."""
    task = task_of(865)
    known = known_ways(LimitFamily.of(task.robot), task.via, 5e-4, fast=False)
    assert known is not None
    assert known.motion.duration < 2.2  # 3.12 s with the shares of its typical durations
    assert mo.certify(task.robot, known.motion, via_q=task.via).ok


@pytest.mark.thorough
@pytest.mark.slow
def test_an_answer_on_a_bound_of_the_duration_says_so(monkeypatch):
    from microbot_ocp.planning.task import _scale

    robot = slider(1.0, tau_max=5.0)
    with monkeypatch.context() as patched:
        patched.setattr(_scale, "LONGEST_DURATION", 0.3)
        motion = mo.time_optimal(robot, [[0.0], [1.234]], mesh=10, tries=2, compiled=False)
    assert not motion.solved
    monkeypatch.setattr(_scale, "SHORTEST_DURATION", 5.0)
    motion = mo.time_optimal(robot, [[0.0], [1.2345]], mesh=10, tries=2, compiled=False)
    tells(motion.advice, "shorter")


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("jerk", [np.inf, 50.0])
def test_a_robot_without_masses_does_what_kinematics_allows(jerk):
    limits = mo.Limits(qd_max=2.0, qdd_max=5.0, qddd_max=jerk, tau_max=1.0)
    bare = mo.Robot.from_dh([0.0, np.pi / 2], [0.0, 0.0], [0.5, 0.0], limits=limits, name="bare")
    assert not bare.has_dynamics
    via = np.array([[0.0, 0.0], [1.0, 0.5], [0.2, 1.0]])
    free = mo.time_optimal(bare, via, mesh=30, starts=1, compiled=False)
    path = mo.time_optimal_path(bare, mo.straight_path(via), compiled=False)
    for motion in (free, path):
        assert motion.solved
        certificate = mo.certify(bare, motion, via_q=via)
        assert certificate.ok, certificate.verdict
        tells(certificate.verdict, "kinematics only", "bare", "masses")
        assert not motion.tau.any()
    assert free.duration < 1.001 * path.duration  # what 30 intervals cost the free one
    faster = bare.with_limits(qd_max=1.8)
    assert "velocity of joint 1" in mo.certify(faster, free).verdict
    q = free.q.copy()
    q[len(q) // 2, 0] += 0.01
    assert not mo.certify(bare, replace(free, q=q)).ok
    assert not mo.certify(bare, free, via_q=via + 0.01).ok


@pytest.mark.parametrize(
    ("row", "said"),
    [
        (("initial", "q", 1, "phase 2", 0.0), ("position of joint 2", "via point 2")),
        (("final", "qd", 0, "phase 2", 2.0), ("velocity of joint 1", "via point 3")),
        (
            ("constraint", "torque", 1, "phase 1", 0.5),
            ("torque of joint 2", "via points 1 and 2", "0.5 s"),
        ),
        (
            ("constraint", "torque", 1, "phase 1", None),
            ("torque of joint 2", "via points 1 and 2"),
        ),
    ],
)
def test_advice_speaks_of_via_points_joints_and_limits(row, said):
    from microbot_ocp.limits import LimitFamily
    from microbot_ocp.planning.task import place_in_task

    place = place_in_task(LimitFamily.of(arm()), *row, ["phase 1", "phase 2"])
    tells(place, *said)
    assert "phase" not in place
    assert (" s " in place) == ("0.5 s" in said)


def test_the_row_of_a_program_is_named_by_the_task():
    row = Advice("violation", "Most violated: x in phase 1, by 2 N m.", "x in phase 1", 2.0, "N m")
    named = row.named("torque of the elbow")
    tells(named.sentence, named.label, "2 N m")
    assert "phase" not in named.sentence
    assert (named.amount, named.unit, named.label) == (2.0, "N m", "torque of the elbow")


def test_a_task_that_cannot_be_done_is_told_in_its_own_words():
    robot = pendulum(q_min=-0.01, q_max=3.2, tau_max=3.0)
    motion = mo.time_optimal(robot, [[0.0], [np.pi]], mesh=10, tries=3, starts=2, compiled=False)
    assert not motion.solved
    for word in ("phase", "q[", "explain", "declare"):
        assert word not in motion.advice


@pytest.mark.slow
def test_slack_is_given_for_less_effort():
    robot, via = arm(), [[0.0, 0.3], [1.0, -0.5], [0.5, 0.8]]
    fastest = mo.time_optimal(robot, via, mesh=15, starts=1, compiled=False)
    before = np.inf
    for slack in (1e-3, 0.1):
        motion = mo.time_optimal(robot, via, mesh=15, starts=1, slack=slack, compiled=False)
        assert motion.solved
        assert mo.certify(robot, motion, via_q=via).ok
        assert motion.duration <= fastest.duration * (1 + slack) * (1 + 1e-6)
        told = motion.provenance["least_effort"]
        assert told["fastest"] == pytest.approx(fastest.duration, rel=1e-6)
        assert told["effort"] < min(before, told["effort_of_the_fastest"])
        assert "less effort" in motion.note
        before = told["effort"]


def test_without_gravity_the_motion_of_least_effort_has_a_torque_linear_in_time():
    # least integral of tau^2 over a given time from rest to rest: tau falls in a straight line
    robot, slack = slider(1.0, tau_max=2.0), 0.25
    motion = mo.time_optimal(robot, [[0.0], [1.0]], mesh=60, slack=slack, compiled=False)
    assert motion.duration == pytest.approx(2 * np.sqrt(0.5) * (1 + slack), rel=1e-3)
    least = 12.0 / motion.duration**3 / 4.0  # of (tau / 2)^2
    assert motion.provenance["least_effort"]["effort"] == pytest.approx(least, rel=2e-3)
