"""Reachability passes against linear programs by scipy, convex programming and closed forms."""

from __future__ import annotations

from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import brentq, linprog

import microbot_ocp as mo
from helpers import two_link_arm
from microbot_ocp._base import fast_calls
from microbot_ocp._base.fast_calls import deferred_call
from microbot_ocp.motion import PiecewisePolynomial
from microbot_ocp.planning import straight_path, time_path
from microbot_ocp.planning.path import path_grid
from microbot_ocp.planning.path._limits import FAR, LimitRows
from microbot_ocp.planning.path._reachability import (
    _at_ends,
    _backward,
    _range,
)

ARM = two_link_arm(1.0, 0.8).with_limits(mo.Limits(tau_max=[60.0, 25.0], qd_max=3.0))
CURVE = mo.cubic([[0.0, 0.3], [1.2, -0.6]], [0.0, 1.0], [[0.9, 0.4], [1.1, -0.8]])
BENT = mo.cubic([[0.0, 0.3], [0.6, 0.5], [1.2, -0.6]], [0.0, 0.6, 1.0], np.full((3, 2), 0.8))


# one linear program -------------------------------------------------------------------------------


def random_interval(seed):
    """Limits at both ends of an interval around a point that keeps them, or (every third) none."""
    random = np.random.default_rng(seed)
    width, step = int(random.integers(2, 7)), np.array([10.0 ** random.uniform(-2, 0)])
    x = random.uniform(0.1, 3.0, 2)
    a = random.normal()
    u = np.array([a, (x[1] - x[0]) / step[0] - a])
    m, c = random.normal(size=(2, 2, width)) * 10 ** random.uniform(-2, 2, width)
    m[random.random((2, width)) < 0.1] = 0.0
    size = np.abs(m) + np.abs(c)
    # a limit of one end may count at the other, too
    values = np.stack([m * u[order, None] + c * x[order, None] for order in ([0, 1], [1, 0])])
    shift = 0.0 if seed % 3 else 1.0
    low, high = (
        extreme + side * size * (random.exponential(size=(2, width)) - shift)
        for side, extreme in ((-1, values.min(axis=0)), (1, values.max(axis=0)))
    )
    low, high = np.minimum(low, high), np.maximum(low, high)
    if not seed % 3:  # the last limit of an end contradicts the first
        m[0, -1], c[0, -1] = m[0, 0], c[0, 0]
        low[0, -1], high[0, -1] = high[0, 0] + size[0, 0], high[0, 0] + 2 * size[0, 0]
    rows = LimitRows(m, c, low, high, np.array([1]), ())
    target = np.sort(random.uniform(0.0, 4.0, 2))
    if seed % 3:
        target = np.array([min(target[0], x[1]), max(target[1], x[1])])
    return rows, step, target, random.uniform(3.0, 6.0)


def reachable_by_casadi(rows, step, target, top):
    tables = (rows.per_u, rows.per_x, rows.lower, rows.upper)
    one, other = np.hstack(tables)[:, None]
    left, right, x_range, y_range = deferred_call(_at_ends(len(one[0]) // 4))(
        one, other, step[None]
    )
    x_range[0, 1] = min(x_range[0, 1], top)
    y_range[0] = max(y_range[0, 0], target[0]), min(y_range[0, 1], target[1])
    size, ranges = left.shape[1], []
    for limits, widest, on_way in (
        (left, x_range, False),
        (right, y_range, False),
        (right, np.array([[-FAR, FAR]]), True),
    ):
        narrow = deferred_call(_range(size, on_way), size)
        ranges.append(narrow(widest, limits, step[None])[0][0])
    x, y, w = ranges
    bounds = np.concatenate([x, w])
    return np.array(_backward(size)(y, left[0], right[0], step, bounds)).ravel()


def interval_program(rows, step):
    """``matrix [x_i, a, x_{i+1}] <= bound`` of the limits at both ends; b follows from them.

    Where the inertia changes much the limits of the other end count, too.
    """
    d, size = step[0], np.abs(rows.per_u)
    unlike = np.abs(np.diff(rows.per_u, axis=0)[0]) > 0.1 * size.max(axis=0)
    matrix, bounds = [], []
    for side in (0, 1):
        for end, kept in ((side, unlike | True), (1 - side, unlike)):
            m, c, zero = rows.per_u[end], rows.per_x[end], 0.0 * size[0]
            at = [-m / d, -m, c + m / d] if side else [c, m, zero]
            matrix.append(np.column_stack(at)[kept])
            bounds.append(np.stack([rows.upper[end], -rows.lower[end]])[:, kept])
    matrix = np.vstack(matrix)
    return np.vstack([matrix, -matrix]), np.hstack(bounds).ravel()


@pytest.mark.parametrize("seed", range(60))
def test_the_reachable_interval_is_that_of_two_linear_programs(seed):
    rows, step, target, top = random_interval(seed)
    low, high = reachable_by_casadi(rows, step, target, top)
    matrix, bound = interval_program(rows, step)
    programs = [
        linprog([sign, 0.0, 0.0], matrix, bound, bounds=[(0.0, top), (None, None), tuple(target)])
        for sign in (1.0, -1.0)
    ]
    if programs[0].status == 2:
        assert high < low
    else:
        assert [low, high] == pytest.approx([p.x[0] for p in programs], rel=1e-6, abs=1e-6)


def test_random_intervals_are_of_at_ends_kinds():
    found = [np.diff(reachable_by_casadi(*random_interval(seed)))[0] < 0 for seed in range(60)]
    assert 3 < sum(found) < 30


# the passes ---------------------------------------------------------------------------------------


def rows_by_hand(robot, path, s):
    """Rows ``m u + c x + rest`` at both ends of every interval, from inverse dynamics."""
    tau = mo.inverse_dynamics(robot)
    tangent, curvature = path.derivative(), path.derivative().derivative()
    zero = np.zeros(robot.joint_count)

    def at(point, from_left):
        q, t, c = (f(point, from_left=from_left)[0] for f in (path, tangent, curvature))
        rest = np.array(tau(q, zero, zero)).ravel()
        per_u = np.array(tau(q, zero, t)).ravel() - rest
        return per_u, np.array(tau(q, t, c)).ravel() - rest, rest, t

    return [(at(a, False), at(b, True)) for a, b in pairwise(s)]


@pytest.mark.parametrize("path", [CURVE, BENT], ids=["one piece", "two pieces"])
def test_no_profile_on_the_same_grid_is_faster(path):
    """The duration is convex in x, so a local search of all profiles finds the best one.

    Its unknowns are x at the grid points, and u at the start of every interval; the duration is
    that of a u constant on the interval. On half as many intervals the passes are 2 % slower on two
    pieces: after the curvature's jump a larger x bars the largest at the next point.
    """
    timing = time_path(ARM, path, ARM.limits, grid=30)
    s, step = timing.s, np.diff(timing.s)
    n = step.size
    low, high = ARM.limits.bounds("tau")
    speed, top = ARM.limits.qd_max, np.full(n + 1, np.inf)
    matrix, bound = [], []
    for i, ends in enumerate(rows_by_hand(ARM, path, s)):
        for side, (here, there) in enumerate((ends, ends[::-1])):
            top[i + side] = min(top[i + side], np.min((speed / np.abs(here[3])) ** 2))
            # where the inertia changes much along the interval, both its values count
            other = np.abs(there[0] - here[0]) > 0.1 * np.maximum(*np.abs([there[0], here[0]]))
            for (m, c, rest, _), kept in ((here, other | True), (there, other)):
                row = np.zeros((ARM.joint_count, 2 * n + 1))
                row[:, i + side] = c
                row[:, n + 1 + i] = -m if side else m
                if side:  # b = (x_{i+1} - x_i)/d - a
                    row[:, i] -= m / step[i]
                    row[:, i + 1] += m / step[i]
                matrix += [row[kept], -row[kept]]
                bound += [(high - rest)[kept], (rest - low)[kept]]
    matrix, bound = np.vstack(matrix), np.concatenate(bound)
    along, reached = timing.parts[0]
    curve = along.curve
    start, end = (curve.pieces[0].unit * change for change in (reached.start, reached.end))
    chosen = np.concatenate([timing.speed**2, start])
    assert np.all(matrix @ chosen <= bound + 1e-6)
    assert np.all(timing.speed**2 <= top + 1e-9)
    assert np.all(np.abs(np.diff(timing.speed**2) / step - start - end) < 1e-9)
    x, u = ca.MX.sym("x", n + 1), ca.MX.sym("u", n)

    def duration(x):
        root = (x + 1e-12) ** 0.5
        return ca.sum1(2 * step / (root[:-1] + root[1:]))

    rows = ca.sparsify(ca.DM(matrix)) @ ca.vertcat(x, u)
    solver = ca.nlpsol(
        "best_profile",
        "ipopt",
        {"x": ca.vertcat(x, u), "f": duration(x), "g": rows},
        {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-10},
    )
    top[[0, -1]] = 0.0
    free = np.full(n, np.inf)
    found = solver(
        x0=0.5 * chosen,
        lbx=np.append(np.zeros(n + 1), -free),
        ubx=np.append(top, free),
        ubg=bound,
    )
    assert solver.stats()["success"]
    best = float(found["f"])
    assert float(duration(ca.DM(timing.speed**2))) == pytest.approx(best, rel=1e-6)


@pytest.mark.parametrize("path", [CURVE, BENT], ids=["one piece", "two pieces"])
def test_the_duration_settles_with_the_grid(path):
    durations = [time_path(ARM, path, ARM.limits, grid=n).duration for n in (100, 400, 1600)]
    assert abs(durations[2] - durations[1]) < 0.5 * abs(durations[1] - durations[0]) + 1e-7
    assert durations[2] == pytest.approx(durations[1], rel=2e-3)


def test_breaks_of_the_path_are_grid_points():
    grid = path_grid(BENT, 37)
    assert set(BENT.breaks) <= set(grid)
    assert np.all(np.diff(grid) > 0)


# closed forms -------------------------------------------------------------------------------------


def slider(mass=2.0, **friction):
    """One mass on a level rail."""
    return mo.Robot.from_dh(
        alpha=[0.0],
        a=[0.0],
        d=[0.0],
        joint_type="prismatic",
        links=[mo.Link(mass, [0.0, 0.0, 0.0], **friction)],
        gravity=(0.0, 0.0, 0.0),
    )


def line(length):
    return PiecewisePolynomial([0.0, length], [[[0.0], [1.0]]])


def joint_limits(**limits):
    return mo.Limits(**limits).for_joints(1)


@pytest.mark.parametrize(
    ("limits", "duration"),
    [
        ({"tau_max": 4.0}, 2 * np.sqrt(1.5 / 2.0)),
        ({"qdd_max": 3.0}, 2 * np.sqrt(1.5 / 3.0)),
        ({"qd_max": 1.2, "tau_max": 4.0}, 1.5 / 1.2 + 1.2 / 2.0),
        ({"qd_max": 1.2, "qdd_max": 3.0, "tau_max": 100.0}, 1.5 / 1.2 + 1.2 / 3.0),
        # pushing with 4 N, braking with 2 N
        ({"tau_max": (-2.0, 4.0)}, np.sqrt(2 * 1.5 * (1 / 2.0 + 1 / 1.0))),
    ],
)
def test_a_mass_on_a_rail_takes_the_closed_form(limits, duration):
    timing = time_path(slider(), line(1.5), joint_limits(**limits), grid=2000)
    assert timing.solved
    assert timing.duration == pytest.approx(duration, rel=3e-4)


def test_a_mass_with_coulomb_friction_pushes_less_and_brakes_more():
    timing = time_path(
        slider(coulomb_friction=1.0), line(1.5), joint_limits(tau_max=4.0), grid=1000
    )
    up, down = (4.0 - 1.0) / 2.0, (4.0 + 1.0) / 2.0
    assert timing.duration == pytest.approx(np.sqrt(2 * 1.5 * (1 / up + 1 / down)), rel=1e-3)


def rubbing_duration(mass, force, friction, length):
    """Full push, then full braking, against friction proportional to the speed."""
    lag, top = mass / friction, force / friction

    def way(push):
        speed = top * (1.0 - np.exp(-push / lag))
        brake = lag * np.log1p(speed / top)
        up = top * (push - lag * (1.0 - np.exp(-push / lag)))
        return up + (speed + top) * lag * (1.0 - np.exp(-brake / lag)) - top * brake, push + brake

    push = brentq(lambda t: way(t)[0] - length, 1e-3, 100.0)
    return way(push)[1]


@pytest.mark.parametrize("friction", [0.3, 1.0, 2.0])
def test_a_mass_with_viscous_friction_takes_the_closed_form(friction):
    robot = slider(viscous_friction=friction)
    timing = time_path(robot, line(1.5), joint_limits(tau_max=4.0), grid=2000)
    exact = rubbing_duration(2.0, 4.0, friction, 1.5)
    assert timing.duration == pytest.approx(exact, rel=1.5e-3)


def test_a_free_end_keeps_its_speed():
    limits = joint_limits(tau_max=4.0)
    timing = time_path(slider(), line(1.5), limits, grid=2000, end_free=True)
    assert timing.duration == pytest.approx(np.sqrt(2 * 1.5 / 2.0), rel=1e-3)
    assert (timing.speed**2)[-1] == pytest.approx(2 * 2.0 * 1.5, rel=1e-6)


PUMA_VIA = np.random.default_rng(1).uniform(-1.5, 1.5, (3, 6))


@pytest.mark.parametrize(
    "path",
    [mo.spline(PUMA_VIA, [0.0, 1.0, 2.0]), straight_path(PUMA_VIA[:2])],
    ids=["free start", "stops"],
)
def test_friction_near_rest_needs_no_solver(path):
    """Where the tangent vanishes s' is free; at a stop dry friction is none, then all at once."""
    motion = mo.time_optimal_path(mo.load_robot("puma560"), path)
    assert motion.solved
    assert motion.provenance["limits_kept_by"]["program on places"] == []
    assert motion.provenance["method"].endswith("reachability")
    assert motion.provenance["excess"] <= 5e-4


# what cannot be done ------------------------------------------------------------------------------


def pendulum(torque, speed=np.inf):
    """1 kg at 1 m, gravity down at q = 0 is along the link: m g l sin(q) to hold."""
    return mo.Robot.from_dh(
        alpha=[0.0],
        a=[0.0],
        d=[0.0],
        links=[mo.Link(1.0, [1.0, 0.0, 0.0])],
        gravity=(9.81, 0.0, 0.0),
        limits=mo.Limits(tau_max=torque, qd_max=speed),
    )


def test_a_pose_that_cannot_be_held_blocks_a_walk_at_low_speed():
    """Up to the horizontal needs 9.81 N m; from rest, with 6 N m, that is never reached."""
    robot = pendulum(6.0)
    timing = time_path(robot, line(np.pi), robot.limits, grid=400)
    assert not timing.solved
    assert timing.status is mo.Status.INFEASIBLE
    assert 0.0 <= timing.blocked_at <= np.pi


def test_momentum_carries_over_a_pose_that_cannot_be_held():
    """Between 80 and 100 degrees more than 9.65 N m would hold the arm; it has 9.7 N m."""
    robot = pendulum(9.7)
    path = PiecewisePolynomial([0.0, np.pi], [[[0.0], [1.0]]])
    timing = time_path(robot, path, robot.limits, grid=1000)
    assert timing.solved
    assert np.all((timing.speed**2)[1:-1] > 0)
    holding = 9.81 * np.sin(timing.s)
    assert np.any(holding > 9.7)
    energy = 0.5 * timing.speed**2 + 9.81 * (1 - np.cos(timing.s))
    assert np.all(np.diff(energy) <= 9.7 * np.diff(timing.s) + 1e-6)


def test_wider_limits_are_never_slower():
    durations = [
        time_path(ARM, CURVE, mo.Limits(tau_max=[60.0 * k, 25.0 * k]).for_joints(2)).duration
        for k in (1.0, 1.3, 2.0)
    ]
    assert durations == sorted(durations, reverse=True)


@pytest.mark.thorough
def test_a_compiled_pass_is_the_same_pass(monkeypatch):
    monkeypatch.setattr(fast_calls, "WORTH_COMPILING", -1.0)
    one, other = (
        time_path(ARM, CURVE, ARM.limits, grid=100, compiled=compiled) for compiled in (True, False)
    )
    np.testing.assert_array_equal(one.speed, other.speed)
