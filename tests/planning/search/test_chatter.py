"""Torques that swing to and fro are told with the price of calmer ones."""

from types import SimpleNamespace

import numpy as np
import pytest

import microbot_ocp as mo
from helpers import tells
from microbot_ocp.planning.search._chatter import chatter

DURATION = 1.2


def moved(robot, frequency, share):
    """A motion whose second torque swings by a share of its range, from 0.4 to 0.8 s."""
    t = np.linspace(0.0, DURATION, 601)
    tau = np.zeros((t.size, robot.joint_count))
    span = robot.limits.tau_max[1] - robot.limits.tau_min[1]
    square = np.sign(np.sin(2 * np.pi * frequency * (t - 0.4) + 1e-6))
    tau[:, 1] = np.where((t > 0.4) & (t < 0.8), 0.5 * share * span * square, 0.0)
    return SimpleNamespace(t=t, tau=tau, duration=DURATION)


@pytest.mark.parametrize(("frequency", "share"), [(15.0, 0.8), (8.0, 0.8), (30.0, 0.35)])
def test_a_torque_that_swings_is_told_with_the_price_of_the_remedy(microbot, frequency, share):
    (row,) = chatter(microbot, moved(microbot, frequency, share))
    assert (row.kind, row.label, row.unit) == ("chatter", microbot.joint_names[1], "%")
    assert row.amount == pytest.approx(100 * share)
    times = int(row.sentence.split(" times")[0].split()[-1])
    assert times == pytest.approx(2 * frequency * 0.3, abs=1.01)
    tells(row.sentence, "slack=0.001", f"{DURATION:.1f} ms")
    (row,) = chatter(microbot, moved(microbot, frequency, share), calmer=True)
    assert "slack" not in row.sentence


@pytest.mark.parametrize(("frequency", "share"), [(15.0, 0.25), (3.0, 0.8), (0.5, 1.0)])
def test_small_or_slow_swings_are_not_told(microbot, frequency, share):
    assert chatter(microbot, moved(microbot, frequency, share)) == ()


def test_without_a_limit_of_the_torque_or_masses_nothing_is_told(microbot):
    motion = moved(microbot, 15.0, 0.8)
    assert chatter(microbot.with_limits(tau_max=np.inf), motion) == ()


@pytest.mark.thorough
@pytest.mark.slow
def test_a_planned_motion_that_chatters_says_so_and_slack_calms_it():
    robot = mo.load_robot("microbot")
    via = [[-1.96, 1.88, -0.64], [-2.05, 0.6, -0.23], [-0.36, 1.76, -1.81]]
    fastest, calmer = (mo.time_optimal(robot, via, slack=slack, starts=1) for slack in (0.0, 1e-3))
    assert "chatter" in {row.kind for row in fastest.outcome.advice}
    prepared = mo.TimeOptimalSolver(robot, via, starts=1)(via_q=via)
    assert "chatter" in {row.kind for row in prepared.outcome.advice}
    assert "slack=0.001" in fastest.remark
    assert "slack=0.001" in prepared.remark
    assert "chatter" not in {row.kind for row in calmer.outcome.advice}
    assert calmer.duration == pytest.approx(1.001 * fastest.duration, rel=1e-4)


@pytest.mark.thorough
def test_less_effort_is_found_where_the_fastest_needs_its_own_mesh():
    """On an even mesh of 60 no motion of this arm is within 0.1 % of the fastest."""
    robot = mo.load_robot("ur5e")
    via = [[0.5, -1.2, 1.1, -0.4, 0.8, 0.0], [-0.7, -0.6, 0.3, 0.9, -0.5, 1.2]]
    calmer = mo.time_optimal(robot, via, slack=1e-3)
    least = calmer.provenance["least_effort"]
    assert least["status"] == "solved"
    assert least["effort"] < 0.9 * least["effort_of_the_fastest"]
    assert calmer.duration <= 1.001 * least["fastest"] * (1.0 + 1e-7)
    assert mo.certify(robot, calmer, via_q=via).ok
