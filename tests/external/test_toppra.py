"""The best timing of given paths against toppra, which works on another robot model, too."""

from __future__ import annotations

import numpy as np
import pytest

import microbot_ocp as mo
from external.toppra_timing import even_grid, graded_grid, toppra_duration, toppra_problem
from helpers import random_robot, sampled, tells
from microbot_ocp.execution import CommandRows
from microbot_ocp.motion import PiecewisePolynomial
from microbot_ocp.planning import phase_plane, time_path

pytestmark = pytest.mark.slow

VIA_Q = np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]])
RELATIVE = 2e-3  # toppra itself is off by 3e-4 on 5,000 points: see the first test


def report_cubic() -> PiecewisePolynomial:
    return mo.cubic(VIA_Q, [0, 2, 4], np.radians([[0, 0, 0], [10, 40, 20], [0, 0, 0]]))


def six_joints() -> tuple[mo.Robot, PiecewisePolynomial]:
    """A random 6R arm with full inertias and tilted gravity, strong enough to rest anywhere."""
    robot = random_robot("rrrrrr")
    via_q = np.random.default_rng(3).uniform(-1.0, 1.0, (4, 6))
    path = mo.cubic(via_q, [0.0, 1.0, 2.0, 3.0])
    q = path(np.linspace(0, 3, 200))
    weight = np.abs(np.array(mo.gravity_torque(robot)(q.T))).max(axis=1)
    limits = mo.Limits(qd_max=3.0, tau_max=1.5 * weight + 20.0)
    return robot.with_limits(limits), path


TOPPRA_MOST = 3e3  # (ds/dt)^2 up to which no bound of its own is felt
CASES = {
    "cubic of the report": lambda: (mo.load_robot("microbot"), report_cubic()),
    "cubic, uneven": lambda: (mo.load_robot("microbot"), mo.cubic(VIA_Q, [0, 1, 3])),
    "quintic": lambda: (mo.load_robot("microbot"), mo.quintic(VIA_Q, [0, 2, 4])),
    "six joints": six_joints,
}
SOLVED = ["cubic of the report", "cubic, uneven", "quintic"]


def test_toppra_converges_to_one_duration_from_both_sides() -> None:
    robot, path = mo.load_robot("microbot"), report_cubic()
    even = toppra_duration(robot, path, even_grid(path, 5000))
    graded = toppra_duration(robot, path, graded_grid(path, 5000))
    assert 2.0650 < graded < 2.0657 < even < 2.0676


@pytest.mark.parametrize("name", sampled(CASES, 2))
def test_reachability_agrees(name: str) -> None:
    robot, path = CASES[name]()
    theirs = toppra_duration(robot, path, graded_grid(path, 5000))
    ours = time_path(robot, path, robot.limits, grid=5000, start_free=True, end_free=True)
    assert ours.solved
    assert ours.duration == pytest.approx(theirs, rel=RELATIVE)


@pytest.mark.parametrize("name", SOLVED)
def test_best_timing_agrees(name: str) -> None:
    robot, path = CASES[name]()
    theirs = toppra_duration(robot, path, graded_grid(path, 5000))
    motion = mo.time_optimal_path(robot, path, grid=1000)
    assert motion.solved
    assert motion.duration == pytest.approx(theirs, rel=RELATIVE)


@pytest.mark.parametrize("name", CASES)
def test_the_maximum_velocity_curve_agrees(name: str) -> None:
    """toppra's sets of (ds/dt)^2 that leave an acceleration: a pair of programs for each point."""
    robot, path = CASES[name]()
    plane = phase_plane(robot, path, grid=60)
    inner = slice(1, -1)  # at the ends the path itself is at rest, and nothing bounds the speed
    own = np.flatnonzero(~np.isin(plane.s, path.breaks))
    grid = np.concatenate([path.breaks[:1], plane.s[1:-1], path.breaks[-1:]])
    theirs = toppra_problem(robot, path, grid).compute_feasible_sets()
    ours = np.column_stack([plane.least, plane.bound]) ** 2
    ours, theirs = ours[own][inner], theirs[own][inner]
    capped = ours[:, 1] > TOPPRA_MOST  # its |d2s/dt2| <= 10^4 binds where the path nearly rests
    assert capped.sum() <= 2
    assert np.all(theirs[capped] < (1 + 1e-5) * ours[capped] + 1e-6)
    np.testing.assert_allclose(ours[~capped], theirs[~capped], rtol=1e-5, atol=1e-6)


def test_what_breaks_limits_between_its_samples_is_caught() -> None:
    """Rows of toppra's own timing, 20 a second, that keep the torques where they are."""
    robot, path = mo.load_robot("microbot"), report_cubic()
    trajectory = toppra_problem(robot, path, graded_grid(path, 2000)).compute_trajectory(0.0, 0.0)
    assert trajectory is not None
    duration = float(trajectory.path_interval[1])
    t = np.linspace(0.0, duration, int(20 * duration))
    q, qd, qdd = (trajectory(t, order) for order in range(3))
    tau = robot.torques_along(q, qd, qdd)["tau"]
    at_rows = (np.abs(tau) / robot.limits.tau_max).max()
    certificate = mo.check(robot, CommandRows(t, q, qd, qdd), "ros2_jtc_quintic")
    torque = next(check for check in certificate.limit_checks if check.quantity == "tau")
    again = mo.executed(robot, CommandRows(t, q, qd, qdd), "ros2_jtc_quintic")
    joint = robot.joint_names.index(torque.joint)
    state = again.sample([torque.time])
    value = robot.torques_along(*state)["tau"][0, joint]
    assert at_rows < 1.01
    assert torque.violation > 0.05
    assert torque.value == pytest.approx(value, rel=1e-6)
    tells(certificate.verdict, f"torque of {torque.joint}")
