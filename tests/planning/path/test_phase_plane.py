"""The phase plane against closed forms, point-wise inverse dynamics and a search of all speeds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import microbot_ocp as mo
from helpers import refused
from microbot_ocp.motion import PiecewisePolynomial
from microbot_ocp.planning import phase_plane
from microbot_ocp.planning.path import PathLimit
from planning.shared import VIA_Q, VIA_QD, VIA_T, arm, pendulum, slider

BEND = 0.5  # 1/m, of the gantry's parabola


def gantry(**limits: object) -> mo.Robot:
    """Two sliders at right angles without gravity; the second carries 2 kg, both together 2 kg."""
    light = mo.Link(1e-9, [0.0, 0.0, 0.0])
    return mo.Robot.from_dh(
        alpha=[0.0, np.pi / 2],
        a=[0.0, 0.0],
        d=[0.0, 0.0],
        joint_type="prismatic",
        links=[light, mo.Link(2.0, [0.0, 0.0, 0.0])],
        gravity=(0.0, 0.0, 0.0),
        limits=mo.Limits(**limits),
    )


def parabola() -> PiecewisePolynomial:
    """(s, c s^2) from s = -1 m to 1 m."""
    start = [[-1.0, BEND], [1.0, -2 * BEND], [0.0, BEND]]
    return PiecewisePolynomial([-1.0, 1.0], [start])


def report_cubic() -> PiecewisePolynomial:
    return mo.cubic(VIA_Q, VIA_T, VIA_QD)


def torques(robot: mo.Robot, path: PiecewisePolynomial, s, v, a):
    """Torques [N,n] at path parameters s, speeds v and accelerations a [N], point by point."""
    slope = path.derivative()
    bend = slope.derivative()
    tau = mo.inverse_dynamics(robot)
    rows = []
    for at, speed, push in zip(s, v, a, strict=True):
        q, t, c = path(at)[0], slope(at)[0], bend(at)[0]
        rows.append(np.array(tau(q, t * speed, t * push + c * speed**2)).ravel())
    return np.array(rows)


def test_a_slider_speeds_up_cruises_and_brakes():
    """4 N on 2 kg: v^2 = 4 s until 1 m/s at 0.25 m."""
    plane = phase_plane(slider(tau_max=4.0, qd_max=1.0), mo.straight_path([[0.0], [1.0]]))
    assert np.all(np.isinf(plane.torque_bound))
    np.testing.assert_allclose(plane.velocity_bound, 1.0)
    exact = np.sqrt(np.minimum(np.minimum(4 * plane.s, 4 * (1 - plane.s)), 1.0))
    np.testing.assert_allclose(plane.speed, exact, atol=2e-6)
    limits = [arc.limit for arc in plane.arcs]
    assert limits == [PathLimit("tau", 0, 1), PathLimit("qd", 0, 1), PathLimit("tau", 0, -1)]
    np.testing.assert_allclose(plane.switches, [0.25, 0.75], atol=2e-3)
    np.testing.assert_allclose(plane.switch_speeds, 1.0, atol=1e-3)
    assert plane.duration == pytest.approx(1.5, abs=1e-3)


def test_the_curve_of_a_gantry_on_a_parabola():
    """With F = k m on both: |u| <= k and |2 c (s u + v^2)| <= k leave v^2 <= k (1/(2c) + |s|)."""
    force, mass = 6.0, 2.0
    plane = phase_plane(gantry(tau_max=force), parabola())
    k, s = force / mass, plane.s
    np.testing.assert_allclose(plane.torque_bound**2, k * (0.5 / BEND + np.abs(s)), rtol=1e-6)
    assert np.all(np.isinf(plane.velocity_bound))
    assert np.all(plane.least == 0.0)
    assert np.all(plane.speed <= plane.torque_bound * (1 + 1e-9))


def test_the_best_timing_of_a_gantry_on_a_parabola():
    """k = 3: 3 m/s^2 up to v^2 = k/(2c) = 3 at s = -0.5 m, on the second force from there."""
    plane = phase_plane(gantry(tau_max=6.0), parabola())
    limits = [arc.limit for arc in plane.arcs]
    assert limits == [PathLimit("tau", 0, 1), PathLimit("tau", 1, 1), PathLimit("tau", 0, -1)]
    np.testing.assert_allclose(plane.switches, [-0.5, 0.5], atol=4e-3)
    np.testing.assert_allclose(plane.switch_speeds, np.sqrt(3.0), atol=4e-3)
    assert plane.duration == pytest.approx(np.sqrt(3.0), abs=1e-3)


def test_the_curve_with_viscous_friction_is_that_of_a_search_of_all_speeds():
    """A grid of speeds and accelerations, every torque by the inverse dynamics."""
    robot = gantry(tau_max=6.0)
    robot = robot.with_links([replace(link, viscous_friction=1.5) for link in robot.links])
    plane = phase_plane(robot, parabola(), grid=20)
    speeds, pushes = np.linspace(0, 4, 401), np.linspace(-12, 12, 2401)
    for i in range(0, plane.s.size, 4):
        slope = parabola().derivative()
        t, c = slope(plane.s[i])[0], slope.derivative()(plane.s[i])[0]
        force = 2.0 * (t[:, None, None] * pushes + c[:, None, None] * speeds[:, None] ** 2)
        force = force + 1.5 * t[:, None, None] * speeds[:, None]
        admissible = (np.abs(force) <= 6.0).all(axis=0).any(axis=1)
        assert plane.torque_bound[i] == pytest.approx(speeds[admissible].max(), abs=0.02)


@pytest.mark.parametrize(
    ("robot", "path"),
    [
        (mo.load_robot("microbot"), report_cubic()),
        (mo.load_robot("microbot"), mo.straight_path(VIA_Q)),
        (mo.load_robot("microbot"), mo.quintic(VIA_Q, VIA_T)),
        (arm(tau_max=[60.0, 25.0]), mo.straight_path([[0.0, 0.3], [1.2, -0.6]])),
    ],
    ids=["cubic", "corner", "quintic", "two links"],
)
def test_the_profile_lies_below_the_curve_and_rides_on_the_limit_of_each_arc(robot, path):
    plane = phase_plane(robot, path, grid=4000)
    assert plane.feasible
    assert np.all(plane.speed <= plane.bound * (1 + 1e-9))
    assert np.all(plane.speed >= plane.least)
    assert plane.arcs[0].start == pytest.approx(path.breaks[0], abs=1e-4)
    assert plane.arcs[-1].end == pytest.approx(path.breaks[-1], abs=1e-4)
    s, x = plane.s, plane.speed**2
    step = np.diff(s)
    middle, inside = 0.5 * (s[1:] + s[:-1]), step > 0
    with np.errstate(divide="ignore", invalid="ignore"):
        push = np.diff(x) / (2 * step)
    speed = np.sqrt(0.5 * (x[1:] + x[:-1]))
    for arc in plane.arcs:
        inset = 0.1 * (arc.end - arc.start)
        near = (middle > arc.start + inset) & (middle < arc.end - inset)
        own = np.flatnonzero(inside & near)[::40]
        assert arc.limit is not None
        quantity, joint, side = arc.limit
        if quantity == "tau":
            value = torques(robot, path, middle[own], speed[own], push[own])
        else:
            value = path.derivative()(middle[own]) * speed[own, None]
        low, high = robot.limits.bounds(quantity)
        limit = (high if side > 0 else low)[joint]
        np.testing.assert_allclose(value[:, joint], limit, rtol=0.02)
        assert np.all(value <= high * 1.02)
        assert np.all(value >= low * 1.02)


def test_switches_are_where_the_acceleration_jumps():
    """The elbow's reversals of the corner path: the largest jumps of s'' stand at the switches."""
    plane = phase_plane(mo.load_robot("microbot"), mo.straight_path(VIA_Q))
    s, x = plane.s, plane.speed**2
    step = np.diff(s)
    push = np.full(step.size, np.nan)
    push[step > 0] = np.diff(x)[step > 0] / (2 * step[step > 0])
    jump = np.abs(np.diff(push))
    largest = s[1:-1][np.argsort(np.nan_to_num(jump))[-2:]]  # into braking before each stop
    for at in largest:
        assert np.abs(plane.switches - at).min() < 0.01


def test_where_gravity_is_too_much_there_is_a_least_speed():
    """Over a hill z = -c s^2 the second slider, too weak to hang still, must be thrown.

    F2 < m g: 2 c (s u + v^2) >= g - F2/m and <= g + F2/m with abs(u) <= k.
    """
    k, c, lift, g = 3.0, BEND, 2.0, 4.0
    robot = gantry(tau_max=[k * 2.0, lift * 2.0])
    up = np.array(mo.jacobian(robot)([0.0, 0.0]))[:3, 1]
    hill = PiecewisePolynomial([-1.0, 1.0], [[[-1.0, -c], [1.0, 2 * c], [0.0, -c]]])
    plane = phase_plane(robot.with_gravity(-g * up), hill)
    s = np.abs(plane.s)
    least = np.maximum((g - lift) / (2 * c) - s * k, 0.0)
    np.testing.assert_allclose(plane.least**2, least, atol=1e-6)
    np.testing.assert_allclose(plane.torque_bound**2, (g + lift) / (2 * c) + s * k, rtol=1e-6)
    assert not plane.feasible  # down the other side it can only gain speed
    assert plane.blocked_at > 0.9


def test_a_path_that_cannot_be_travelled_says_where():
    weak = pendulum(tau_max=5.0)
    plane = phase_plane(weak, PiecewisePolynomial([0.0, np.pi], [[[0.0], [1.0]]]))
    assert not plane.feasible
    assert np.isnan(plane.speed).all()
    assert 0.0 <= plane.blocked_at < np.pi
    assert plane.arcs == ()


def test_bad_input_is_named():
    robot = slider(tau_max=4.0)
    with refused("path", "1 joints", "not 2"):
        phase_plane(robot, parabola())
    with refused("grid", "10 points", "not 3"):
        phase_plane(robot, mo.straight_path([[0.0], [1.0]]), grid=3)
