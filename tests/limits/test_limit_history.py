"""Use of limits over time against closed forms and the certificate."""

from __future__ import annotations

import numpy as np
import pytest

import microbot_ocp as mo
from helpers import refused
from microbot_ocp.limits import limit_history
from microbot_ocp.limits._history import _runs
from microbot_ocp.motion import PiecewisePolynomial
from planning.shared import slider


def bang_cruise_bang() -> PiecewisePolynomial:
    """2 m/s^2 for 0.5 s, 1 m/s for 0.5 s, then back to rest."""
    table = [[0.0, 0.0, 1.0], [0.25, 1.0, 0.0], [0.75, 1.0, -1.0]]
    return PiecewisePolynomial([0.0, 0.5, 1.0, 1.5], np.array(table)[:, :, None])


def test_spells_of_a_slider_that_speeds_up_cruises_and_brakes() -> None:
    """4 N on 2 kg with 1 m/s at most."""
    robot = slider(tau_max=4.0, qd_max=1.0)
    motion = mo.Motion.from_polynomial(robot, bang_cruise_bang(), label="mine")
    history = limit_history(robot, motion)
    force = history.spells("tau")
    assert [(s.joint, s.side) for s in force] == [(0, 1), (0, -1)]
    np.testing.assert_allclose([force[0][3:], force[1][3:]], [[0, 0.5], [1, 1.5]], atol=1e-3)
    (speed,) = history.spells("qd")
    assert speed.side == 1
    # 99 % of the speed from 0.495 s to 1.005 s
    np.testing.assert_allclose(speed[3:], [0.495, 1.005], atol=1e-3)
    assert history.spells("taud") == []


def test_shares_are_values_over_limits() -> None:
    robot = slider(tau_max=(-8.0, 4.0), qd_max=2.0)
    motion = mo.Motion.from_polynomial(robot, bang_cruise_bang(), label="mine")
    history = limit_history(robot, motion)
    assert list(history.use) == ["qd", "tau"]
    np.testing.assert_allclose(history.use["qd"], np.abs(history.values["qd"]) / 2.0)
    assert history.use["tau"][0, 0] == pytest.approx(1.0)
    assert history.use["tau"][-1, 0] == pytest.approx(0.5)  # -4 N of -8 N
    other = limit_history(robot, motion, mo.Limits(q_min=0.0, q_max=1.0))
    np.testing.assert_allclose(other.use["q"][[0, -1], 0], 1.0, atol=1e-9)
    assert [s.side for s in other.spells("q")] == [-1, 1]


def test_the_largest_shares_are_those_of_the_certificate() -> None:
    robot = mo.load_robot("microbot")
    shape = mo.cubic(np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]]), [0, 1.0, 2.1])
    motion = mo.Motion.from_polynomial(robot, shape, label="cubic")
    history, certificate = limit_history(robot, motion), mo.certify(robot, motion)
    for check in certificate.limit_checks:
        largest = history.use[check.quantity].max(axis=0)
        np.testing.assert_array_equal(largest, check.utilisation)


def test_short_gaps_are_closed_and_touches_left_out() -> None:
    t = 0.0009 * np.arange(100)
    busy = np.zeros(t.size, dtype=bool)
    busy[10:20] = busy[21:30] = busy[50] = True
    ((start, end),) = _runs(t, busy)
    assert (start, end) == pytest.approx((0.009, 0.0261))


def test_a_motion_of_another_arm_is_refused() -> None:
    robot = slider(tau_max=4.0)
    motion = mo.Motion.from_polynomial(robot, bang_cruise_bang(), label="mine")
    with refused("motion", "1 joints", "robot has 3"):
        limit_history(mo.load_robot("microbot"), motion)


def test_what_changes_evenly_up_to_a_break_is_no_jump_at_it() -> None:
    """The change in the last microsecond, with what is taken up there, was over the rate."""
    robot = mo.load_robot("planar_2r")
    shape = mo.quintic([[0, 0], [1, 1], [0, 0]], [0, 1, 2], np.zeros((3, 2)))
    motion = mo.Motion.from_polynomial(robot, shape, label="to and fro", jumps_at=[1.0])
    assert np.abs(motion.history().jumps.qddd[1]).max() < 0.1  # 60 at both sides
