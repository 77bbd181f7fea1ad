"""Ratings over a cycle against closed forms and the energy of the arm."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

import microbot_ocp as mo
from helpers import refused


@pytest.fixture(scope="module")
def joint():
    """An inertia of 2 kg m^2 about a vertical axis."""
    link = mo.Link(0.0, np.zeros(3), 2.0 * np.eye(3))
    return mo.Robot.from_dh([0.0], [0.0], [0.0], links=[link], gravity=[0, 0, 0])


def test_parabolic_speed(joint):
    """A cubic from rest to rest has the least r.m.s. torque of all: sqrt(12) I D / T^2."""
    way, lasts = 1.5, 0.7
    shape = mo.cubic([[0.0], [way]], [0.0, lasts])
    found = mo.execution.ratings(joint, mo.Motion.from_polynomial(joint, shape, label="cubic"))
    least = np.sqrt(12.0) * 2.0 * way / lasts**2
    assert found.rms_torque[0] == pytest.approx(least, rel=1e-9)
    assert found.peak_torque[0] == pytest.approx(np.sqrt(3.0) * least, rel=1e-9)
    assert found.energy_drawn[0] == pytest.approx(0.5 * 2.0 * (1.5 * way / lasts) ** 2, rel=1e-6)
    assert found.energy_returned[0] == pytest.approx(found.energy_drawn[0], rel=1e-6)
    assert found.mean_speed[0] == pytest.approx(way / lasts, rel=1e-9)
    other = mo.Motion.from_polynomial(joint, mo.quintic([[0.0], [way]], [0.0, lasts]), label="q")
    assert mo.execution.ratings(joint, other).rms_torque[0] > found.rms_torque[0]


def test_a_constant_torque_is_all_of_its_means(joint):
    steps = mo.motion.PiecewisePolynomial(np.array([0.0, 1.0]), np.array([[[0.0], [0.0], [3.0]]]))
    found = mo.execution.ratings(joint, mo.Motion.from_polynomial(joint, steps, label="constant"))
    for name in ("rms_torque", "cubic_torque", "peak_torque"):
        assert getattr(found, name)[0] == pytest.approx(12.0, rel=1e-8)


def test_what_is_drawn_and_returned_is_the_change_of_energy(microbot):
    shape = mo.quintic([[0.0, 0.3, 0.2], [0.5, 0.8, -0.4]], [0.0, 1.0])
    motion = mo.Motion.from_polynomial(microbot, shape, label="quintic")
    found = mo.execution.ratings(microbot, motion, 0.5)
    friction = microbot.with_links(microbot.links)
    energies = [np.array(mo.energy(friction)(q, np.zeros(3))[1]).item() for q in motion.q[[0, -1]]]
    work = float((found.energy_drawn - found.energy_returned).sum())
    assert work == pytest.approx(energies[1] - energies[0], rel=1e-6)
    assert found.mean_power == pytest.approx(work / 1.5)
    assert [row[0] for row in found.table().rows] == list(microbot.joint_names)


def test_a_motion_with_a_load_is_not_rated_as_the_empty_arm(microbot):
    loaded = microbot.with_payload(2.0)
    shape = mo.quintic([[0.0, 0.3, 0.2], [0.5, 0.8, -0.4]], [0.0, 1.0])
    motion = mo.Motion.from_polynomial(loaded, shape, label="quintic")
    assert mo.execution.ratings(loaded, motion).peak_torque.max() > 0.0
    with refused("torques", "'microbot'", "waist", "N m"):
        mo.execution.ratings(microbot, motion)


def test_what_is_carried_on_the_way_is_lifted(microbot):
    """The work of a pick and place is that of its arm and of the load between grip and release."""
    via = np.array([[0.0, 0.3, 0.2], [0.5, 0.8, -0.4], [0.9, 0.2, 0.1], [0.2, 0.6, 0.1]])
    loads = {1: 2.0, 2: 0.0}
    stops = [mo.Stop(q=q, payload=loads.get(k), velocity="rest") for k, q in enumerate(via)]
    task = mo.planning.task.task_of(microbot, stops)
    shapes = [mo.quintic(pair, [0.0, 1.0]) for pair in pairwise(via)]
    curve = mo.motion.PiecewisePolynomial(
        np.arange(4.0), np.concatenate([shape.coefficients for shape in shapes])
    )
    marks = [mo.motion.Mark(float(k), stop.name) for k, stop in enumerate(task.stops)]
    motion = mo.planning.search.motion_along(task, curve, marks, label="carried")
    found = mo.execution.ratings(microbot, motion, 0.5, via_q=stops)
    arm = [np.array(mo.energy(microbot)(q, np.zeros(3))[1]).item() for q in via]
    heights = [np.array(mo.forward_kinematics(microbot)(q))[2, 3] for q in via]
    work = float((found.energy_drawn - found.energy_returned).sum())
    lifted = 2.0 * 9.8 * (heights[2] - heights[1])
    assert abs(lifted) > 10.0
    assert work == pytest.approx(arm[-1] - arm[0] + lifted, rel=1e-6)
    held = microbot.torques_along(via[3:], 0.0 * via[3:], 0.0 * via[3:])["tau"][0]
    np.testing.assert_allclose(found.holding_torque, np.abs(held), rtol=1e-9)
    with refused("torques", "'microbot'", "shoulder", "N m", "via_q"):
        mo.execution.ratings(microbot, motion)
    with refused("'carried'", "4 marks", "3 stops"):
        mo.execution.ratings(microbot, motion, via_q=stops[1:])


def test_forces_of_sliding_joints_are_no_torques():
    robot = mo.load_robot("stanford")
    q = np.array([[0.1, 0.2, 0.3, 0.1, 0.2, 0.3], [0.4, 0.5, 0.5, 0.4, 0.5, 0.6]])
    motion = mo.Motion.from_polynomial(robot, mo.quintic(q, [0.0, 2.0]), label="quintic")
    units = [column.unit for column in mo.execution.ratings(robot, motion).table().columns]
    assert units == ["", *3 * ["N m or N"], "rad/s or m/s", "W", "J", "J"]


def test_the_dwell_that_a_rating_asks_for(microbot):
    shape = mo.quintic([[0.0, 0.0, 0.0], [0.5, 1.4, 0.1]], [0.0, 1.0])
    motion = mo.Motion.from_polynomial(microbot, shape, label="quintic")
    rated = 0.9 * mo.execution.ratings(microbot, motion).rms_torque
    dwell = mo.execution.ratings(microbot, motion).least_dwell(rated)
    assert dwell > 0.0
    with_it = mo.execution.ratings(microbot, motion, dwell)
    assert (with_it.rms_torque / rated).max() == pytest.approx(1.0, rel=1e-12)
    assert with_it.least_dwell(rated) == pytest.approx(dwell)
    assert mo.execution.ratings(microbot, motion).least_dwell(1e4) == 0.0
    with refused("dwell", "'shoulder'", "1 N m", "25.53"):
        mo.execution.ratings(microbot, motion).least_dwell([1e4, 1.0, 1e4])
    for rating, said in (([1.0, 2.0], ("[3]", "[2]")), (-300.0, ("above 0 N m", "-300.0"))):
        with refused("rms_max", *said):
            mo.execution.ratings(microbot, motion).least_dwell(rating)


@pytest.mark.parametrize("dwell", [pytest.param(0.0, marks=pytest.mark.thorough), 0.5])
def test_a_limit_of_the_mean_makes_the_speed_a_parabola(joint, dwell):
    """12 (I D)^2 / T^3 = r^2 (T + dwell): the torque is linear in time, so it is met exactly."""
    way, rated = 1.5, 10.0
    limits = joint.with_limits(tau_max=100.0, also=[mo.limits.rms_torque(rated, dwell)]).limits
    motion = mo.time_optimal(joint, [[0.0], [way]], limits, mesh=20, starts=1)
    roots = np.roots([rated**2, rated**2 * dwell, 0.0, 0.0, -12.0 * (2.0 * way) ** 2])
    shortest = roots[np.isreal(roots) & (roots.real > 0.0)].real[0]
    assert motion.solved
    assert motion.duration == pytest.approx(shortest, rel=1e-6)
    certificate = mo.certify(joint, motion, limits)
    assert certificate.ok
    assert certificate.limit_checks[-1].value == pytest.approx(rated, rel=1e-6)
    # the certificate judges the mean, which no instant exceeds
    faster = mo.Motion.from_polynomial(
        joint, mo.cubic([[0.0], [way]], [0.0, 0.98 * shortest]), label="cubic"
    )
    assert not mo.certify(joint, faster, limits).ok
    assert mo.certify(joint, faster, mo.Limits(tau_max=100.0)).ok


def test_what_cannot_keep_a_mean_refuses_it(joint):
    robot = joint.with_limits(tau_max=100.0, also=[mo.limits.rms_torque(10.0)])
    via, path = [[0.0], [1.0]], mo.cubic([[0.0], [1.0]], [0.0, 1.0])
    motion = mo.Motion.from_polynomial(robot, path, label="cubic")
    for planner in (
        lambda: mo.TimeOptimalSolver(robot, via),
        lambda: mo.time_optimal(robot, [mo.Stop(q=[0.0]), mo.Stop(q=[1.0])]),
        lambda: mo.time_optimal_path(robot, path),
        lambda: mo.planning.time_path(robot, path),
        lambda: mo.shortest_duration(robot, path),
        lambda: mo.compare(robot, via),
        lambda: mo.execution.overridden(robot, motion, 0.2, 0.5),
    ):
        with refused("limits", "rms torque", "time_optimal"):
            planner()
    with refused("limit 'rms torque'", "upper bound", "above 0"):
        mo.limits.rms_torque(0.0)
