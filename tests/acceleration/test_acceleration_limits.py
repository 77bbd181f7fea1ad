"""Boxes of accelerations: closed forms, grids, attacks by samples and by ascent, refusals."""

from __future__ import annotations

from itertools import product
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import minimize

import microbot_ocp as mo
from microbot_ocp.acceleration._forms import torque_terms

RNG = np.random.default_rng(3)


def telescope() -> mo.Robot:
    """A slide whose second stage goes half as far, on a turning column, with an arm at its end."""
    links = [
        mo.Link(m, [0.1, 0.02, 0.05], np.diag([0.02, 0.03, 0.03])) for m in (5.0, 3.0, 2.0, 1.0)
    ]
    limits = mo.Limits(
        q_min=[-3.0, 0.0, 0.0, -2.0],
        q_max=[3.0, 0.5, 0.25, 2.0],
        qd_max=[2.0, 1.0, 1.0, 2.0],
        tau_max=[80.0, 300.0, 300.0, 40.0],
    )
    return mo.Robot.from_dh(
        alpha=[0.0, 0.3, 0.0, np.pi / 2],
        a=[0.0, 0.1, 0.0, 0.2],
        d=[0.2, 0.1, 0.0, 0.0],
        joint_type=["revolute", "prismatic", "prismatic", "revolute"],
        joint_names=["column", "lift", "second", "arm"],
        links=links,
        limits=limits,
        tool=[0.0, 0.3, 0.0, 0.0],
        mimic={"second": ("lift", 0.5, 0.0)},
    )


def turned(name: str) -> mo.Robot:
    """A packaged arm on a slope, so that gravity depends on its first joint."""
    return mo.load_robot(name).with_gravity([3.0, -2.0, -9.0])


def torques_within(found: mo.AccelerationLimits, loads: Any, count: int) -> float:
    """Largest share of a torque limit at states drawn from the box, corners and all."""
    robot, n = found.robot, found.robot.joint_count
    low, high = robot.limits.bounds("q")
    largest = 0.0
    for load in loads:
        q = RNG.uniform(low, high, (count, n))
        qd = found.speed * np.where(
            RNG.random((count, n)) < 0.7,
            RNG.choice([-1, 1], (count, n)),
            RNG.uniform(-1, 1, (count, n)),
        )
        arm = robot.with_payload(load)
        signs = np.sign(RNG.uniform(-1, 1, (count, n)))
        tau = arm.torques_along(q, qd, signs * found.qdd_max)["tau"]
        lower, upper = arm.limits.bounds("tau")
        largest = max(largest, float((tau / np.where(tau > 0, upper, -lower)).__abs__().max()))
    return largest


def climbed(found: mo.AccelerationLimits, load: float, starts: int) -> float:
    """Largest share of a torque limit after ascent over positions, speeds and accelerations."""
    robot = found.robot.with_payload(load)
    n = robot.joint_count
    z = ca.SX.sym("z", 3 * n)
    low, high = robot.limits.bounds("q")
    scale = np.concatenate([np.ones(n), found.speed, found.qdd_max])
    tau = mo.inverse_dynamics(robot)(*ca.vertsplit(z * scale, n))
    share = tau / robot.limits.tau_max
    both = ca.Function("both", [z], [share, ca.jacobian(share, z)])
    ends = np.array([*zip(low, high, strict=True), *[(-1.0, 1.0)] * (2 * n)])
    largest = 0.0
    for k in range(starts):
        joint, side = k % n, 1 if RNG.random() < 0.5 else -1

        def worst(x: Any, joint: int = joint, side: int = side) -> Any:
            values, slopes = both(x)
            return -side * float(values[joint]), -side * slopes[joint, :].full().ravel()

        end = minimize(worst, RNG.uniform(*ends.T), jac=True, bounds=ends, options={"maxiter": 60})
        largest = max(largest, -float(end.fun))
    return largest


@pytest.mark.parametrize(
    "robot",
    [mo.load_robot("planar_3r"), mo.load_robot("stanford"), telescope(), turned("puma560")],
    ids=lambda robot: robot.name,
)
def test_no_term_is_farther_from_its_tangent_or_parabola_than_bounded(robot: mo.Robot) -> None:
    n = robot.joint_count
    low, high = robot.limits.bounds("q")
    center = RNG.uniform(low, high, (500, n))
    for width in (0.05, 0.6):
        shift = np.clip(center + width * RNG.uniform(-1, 1, center.shape), low, high) - center
        for terms in torque_terms(robot, tuple(low.tolist()), tuple(high.tolist())):
            here, there = terms.at(center), terms.at(center + shift)[:, 0]
            off = there - here[:, 0] - np.einsum("bk,bkf->bf", shift, here[:, 1:])
            assert (np.abs(off) <= terms.rest(np.abs(shift)) + 1e-12).all()
            weights = np.zeros((len(center), 1 + n))
            for term in range(1 + n):
                weights[:], weights[:, term] = 0.0, 1.0
                bends = terms.bends(center, weights)
                left = off[:, term] - 0.5 * np.einsum("bi,bij,bj->b", shift, bends, shift)
                assert (np.abs(left) <= terms.rest_of_bends(np.abs(shift))[:, term] + 1e-12).all()
            assert (np.abs(there) <= terms.amplitude + 1e-12).all()


def test_terms_add_up_to_the_torque_of_inverse_dynamics() -> None:
    robot = telescope()
    n = robot.joint_count
    low, high = robot.limits.bounds("q")
    q, qd, qdd = RNG.uniform(low, high, (50, n)), *RNG.uniform(-1, 1, (2, 50, n))
    first, second = np.triu_indices(n)
    speeds = qd[:, first] * qd[:, second] * np.where(first == second, 1.0, 2.0)
    factors = np.hstack([np.ones((50, 1)), qdd, speeds])
    every = torque_terms(robot, tuple(low.tolist()), tuple(high.tolist()))
    tau = np.array([(terms.at(q)[:, 0] * factors).sum(axis=1) for terms in every]).T
    np.testing.assert_allclose(tau, robot.torques_along(q, qd, qdd)["tau"], atol=1e-11)


@pytest.mark.parametrize(("load", "torque"), [(0.0, [60.0, 25.0]), (1.5, [70.0, 90.0])])
def test_planar_arm_at_rest_by_its_closed_form(load: float, torque: list[float]) -> None:
    # stretched out and level, gravity and every entry of the mass matrix are largest at once
    robot = mo.load_robot("planar_2r").with_limits(tau_max=torque)
    level = robot.with_payload(load).torques_along(np.zeros((1, 2)), *np.zeros((2, 1, 2)))["tau"][0]
    inertia = np.array(mo.mass_matrix(robot.with_payload(load))([0.0, 0.0]))
    expected = ((torque - np.abs(level)) / inertia.sum(axis=1)).min()
    found = mo.acceleration_limits(robot, load, speed=0.0, equal=True, gap=0.01)
    assert found.solved
    np.testing.assert_allclose(found.broken, expected, rtol=1e-6)
    assert 0.99 * expected <= found.qdd_max[0] <= expected
    assert found.state.torque == pytest.approx(found.state.limit)


def test_planar_arm_at_speed_by_a_fine_grid() -> None:
    robot, speed, load = mo.load_robot("planar_3r"), [1.0, 1.5, 2.0], 0.5
    ratios = np.array([1.0, 2.0, 3.0])
    found = mo.acceleration_limits(robot, load, speed=speed, ratios=ratios, gap=0.02)
    arm = robot.with_payload(load)
    bend = np.linspace(-np.pi, np.pi, 37)
    q = np.array([*product(bend, bend, bend)])
    q = q[(np.abs(q) <= robot.limits.q_max).all(axis=1)]
    matrices = np.array(mo.mass_matrix(arm).map(len(q))(q.T)).reshape(3, len(q), 3)
    needed = np.abs(matrices).transpose(1, 0, 2) @ ratios
    least = np.inf
    for shares in product([-1.0, 0.0, 1.0], repeat=3):
        tau = arm.torques_along(q, np.tile(np.multiply(shares, speed), (len(q), 1)), 0 * q)["tau"]
        least = min(least, float(((arm.limits.tau_max - np.abs(tau)) / needed).min()))
    assert found.solved
    assert found.qdd_max[0] < least  # proved: no state of the grid breaks it
    assert found.broken[0] == pytest.approx(least, rel=0.02)


@pytest.mark.parametrize(
    ("robot", "load", "speed"),
    [
        pytest.param(mo.load_robot("ur5e"), (0.0, 5.0), 0.3, marks=pytest.mark.slow),
        (mo.load_robot("puma560"), (0.0, 2.0), 0.5),
        (mo.load_robot("microbot"), (0.0, 1.0), 0.4),
        (telescope(), (0.0, 1.0), 0.7),
        (turned("planar_3r"), (0.2, 0.4), 0.6),
    ],
    ids=lambda value: getattr(value, "name", None),
)
def test_no_state_breaks_a_proved_box(robot: mo.Robot, load: Any, speed: float) -> None:
    found = mo.acceleration_limits(robot, load, speed=speed)
    assert found.solved
    assert 0.9 <= found.qdd_max[0] / found.broken[0] <= 1.0
    assert torques_within(found, [*load, np.mean(load)], 3000) <= 1.0
    assert climbed(found, load[1], 12) <= 1.0
    # and the state that is said to break it needs that torque
    state, arm = found.state, robot.with_payload(found.state.payload)
    joint = robot.joint_names.index(state.joint)
    for factor, breaks in ((1.0 - 1e-6, False), (1.0 + 1e-6, True)):
        tau = arm.torques_along(state.q[None], state.qd[None], factor * state.qdd[None])["tau"]
        assert (abs(tau[0, joint]) > state.limit) == breaks


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("name", "load", "speed"),
    [
        ("ur5e", (0.0, 5.0), 0.5),
        ("panda", (0.0, 3.0), 0.0),
        ("puma560", (0.0, 2.0), 0.5),
        ("stanford", (0.0, 1.0), 0.5),
    ],
)
def test_no_state_of_very_many_breaks_a_proved_box(name: str, load: Any, speed: float) -> None:
    found = mo.acceleration_limits(mo.load_robot(name), load, speed=speed)
    assert found.solved
    assert torques_within(found, [*load, np.mean(load)], 100_000) <= 1.0
    assert max(climbed(found, end, 500) for end in load) <= 1.0


def test_product_is_larger_than_with_equal_accelerations() -> None:
    robot = mo.load_robot("puma560")
    equal, best = (mo.acceleration_limits(robot, 1.0, speed=0.3, equal=e) for e in (True, False))
    assert np.prod(best.broken) > np.prod(equal.broken)
    assert np.ptp(equal.qdd_max) == 0.0


def test_smaller_regions_allow_more() -> None:
    robot = mo.load_robot("planar_3r")
    everywhere = mo.acceleration_limits(robot, speed=0.2, equal=True)
    q = np.array([[1.4, 0.1, 0.0], [1.5, 0.2, 0.1], [1.6, 0.3, 0.0]])
    upright = mo.acceleration_limits(robot, speed=0.2, equal=True, region=q)
    corners = mo.acceleration_limits(robot, speed=0.2, equal=True, region=(q.min(0), q.max(0)))
    tool = mo.acceleration_limits(
        robot, speed=0.2, equal=True, region=mo.Box([0.3, 0.3, 0.1], [0.2, 0.1, 0.0])
    )
    # between the poses is less than between the least and largest positions of all
    assert upright.broken[0] >= corners.broken[0] * (1 - 1e-9) > everywhere.broken[0]
    assert tool.solved
    assert tool.broken[0] > everywhere.broken[0]
    place = np.array(mo.forward_kinematics(robot)(tool.state.q))[:3, 3]
    assert (np.abs(place - [0.2, 0.1, 0.0]) <= [0.15, 0.15, 0.05]).all()


def test_no_box_where_gravity_or_speed_alone_need_more_than_the_torque() -> None:
    robot = mo.load_robot("ur5e")
    heavy = mo.acceleration_limits(robot, 40.0, speed=0.0)
    fast = mo.acceleration_limits(robot, 5.0, speed=1.0)
    for found, words in ((heavy, "to hold the arm with 40 kg"), (fast, "of these speeds")):
        assert found.status == mo.Status.INFEASIBLE
        assert not found.qdd_max.any()
        assert words in found.advice
        assert found.state.joint in found.advice
        assert found.state.torque > found.state.limit


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"payload": -1.0}, "payload must be at least 0 kg"),
        ({"payload": (2.0, 1.0)}, "least, largest"),
        ({"speed": 1.5}, "at most 1"),
        ({"speed": [1.0, 2.0]}, "shape"),
        ({"speed": [1.0, -2.0, 1.0]}, "joint 2"),
        ({"ratios": [1.0, 0.0, 1.0]}, "ratios must be above 0"),
        ({"ratios": [1.0, 1.0, 1.0], "equal": True}, "not both"),
        ({"region": ([0.0, 0.0, 0.0], [9.0, 1.0, 1.0])}, "region of shoulder"),
        ({"region": [[0.0, 0.0, 9.0]]}, "pose 1 of region"),
        ({"region": mo.Box([0.1, 0.1, 0.1], [9.0, 0.0, 0.0])}, "positions of the tool"),
        ({"gap": 0.0}, "gap must be above 0"),
    ],
)
def test_bad_input(arguments: dict[str, Any], words: str) -> None:
    with pytest.raises(mo.InputError, match=words):
        mo.acceleration_limits(mo.load_robot("planar_3r"), **arguments)


def test_robots_that_lack_limits() -> None:
    robot = mo.load_robot("planar_3r")
    with pytest.raises(mo.InputError, match="limits of torque on both sides"):
        mo.acceleration_limits(robot.with_limits(tau_max=np.inf))
    with pytest.raises(mo.InputError, match="no limit of velocity"):
        mo.acceleration_limits(robot.with_limits(qd_max=np.inf))
