"""Boxes of accelerations: closed forms, grids, attacks by samples and by ascent, refusals."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import casadi as ca
import numpy as np
import pytest
import ruckig
import yaml
from scipy.optimize import minimize

import microbot_ocp as mo
from helpers import refused, sampled_rows, tells
from microbot_ocp.acceleration._coupled import CoupledDemand
from microbot_ocp.acceleration._demand import Boxes, Demand
from microbot_ocp.acceleration._forms import torque_terms
from microbot_ocp.acceleration._region import position_region
from microbot_ocp.cli import main

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
    [
        mo.load_robot("planar_3r"),
        pytest.param(mo.load_robot("stanford"), marks=pytest.mark.thorough),
        telescope(),
        pytest.param(turned("puma560"), marks=pytest.mark.thorough),
    ],
    ids=lambda robot: robot.name,
)
def test_no_term_is_farther_from_its_tangent_parabola_or_value_than_bounded(
    robot: mo.Robot,
) -> None:
    n = robot.joint_count
    low, high = robot.limits.bounds("q")
    center = RNG.uniform(low, high, (500, n))
    for width in (0.05, 0.6, 4.0):
        shift = np.clip(center + width * RNG.uniform(-1, 1, center.shape), low, high) - center
        for terms in torque_terms(robot, tuple(low.tolist()), tuple(high.tolist())):
            here, there = terms.at(center), terms.at(center + shift)[:, 0]
            off = there - here[:, 0] - np.einsum("bk,bkf->bf", shift, here[:, 1:])
            assert (np.abs(off) <= terms.tangent_error(np.abs(shift)) + 1e-12).all()
            weights = np.zeros((len(center), 1 + n))
            for term in range(1 + n):
                weights[:], weights[:, term] = 0.0, 1.0
                bends = terms.bends(center, weights)
                left = off[:, term] - 0.5 * np.einsum("bi,bij,bj->b", shift, bends, shift)
                assert (np.abs(left) <= terms.parabola_error(np.abs(shift))[:, term] + 1e-12).all()
            assert (np.abs(there) <= terms.amplitude + 1e-12).all()
            for k in range(n):
                alone = terms.at(center + shift * (np.arange(n) == k))[:, 0] - here[:, 0]
                by_slope = np.abs(shift[:, k, None]) * terms.steep[:, k]
                assert (np.abs(alone) <= np.minimum(by_slope, terms.span[:, k]) + 1e-12).all()


@pytest.mark.parametrize("name", ["panda", "planar_3r"])
@pytest.mark.parametrize("coupled", [None, 1.0])
def test_no_state_within_a_box_has_a_smaller_scale_than_its_bound(
    name: str, coupled: float | None
) -> None:
    robot, n = (arm := turned(name)), arm.joint_count
    low, high = robot.limits.bounds("q")
    terms = torque_terms(robot, tuple(low.tolist()), tuple(high.tolist()))
    speed, box, load = 0.2 * robot.limits.qd_max, RNG.uniform(0.5, 2.0, n), 0.0
    for joint, side in product(range(n), (1.0, -1.0)):
        given = terms[joint], joint, side, robot.limits.tau_max[joint], speed, 0.1, 0.0, load
        demand = Demand(*given) if coupled is None else CoupledDemand(*given, coupled)
        ends = np.tile(demand.all_shares, (100, 1, 1))
        half = RNG.uniform(0.0, [0.2] * (n - 1) + [2.8], (100, n))
        middle = RNG.uniform(low, high, (100, n))
        boxes = Boxes(
            np.hstack([middle - half, ends[:, 0]]), np.hstack([middle + half, ends[:, 1]])
        )
        most = float(np.median(demand.states_at(middle).scale(box)))
        bounds = demand.bounds(boxes, box, most)  # they hold up to this scale
        for _ in range(20):
            q = middle + half * RNG.uniform(-1.0, 1.0, half.shape)
            scales = demand.states_at(q).scale(box)
            assert (np.minimum(scales, most) >= np.minimum(bounds.scale, most)).all()
        assert (bounds.scale > 0.0).any()


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
        pytest.param(mo.load_robot("ur5e"), (0.0, 5.0), 0.2, marks=pytest.mark.thorough),
        pytest.param(mo.load_robot("puma560"), (0.0, 2.0), 0.5, marks=pytest.mark.thorough),
        (mo.load_robot("microbot"), (0.0, 1.0), 0.4),
        (telescope(), (0.0, 1.0), 0.7),
        (turned("planar_3r"), (0.2, 0.4), 0.6),
    ],
    ids=lambda value: getattr(value, "name", None),
)
def test_no_state_breaks_a_proved_box(robot: mo.Robot, load: Any, speed: float) -> None:
    found = mo.acceleration_limits(robot, load, speed=speed, equal=True, gap=0.2)
    assert found.solved
    assert 0.0 <= found.gap <= 0.2
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
    assert found.solved == (found.gap <= 0.1 + 1e-9)
    assert torques_within(found, [*load, np.mean(load)], 100_000) <= 1.0
    assert max(climbed(found, end, 500) for end in load) <= 1.0


@pytest.mark.parametrize("radius", [0.6, 1.0])
def test_coupled_speeds(radius: float) -> None:
    robot = mo.load_robot("planar_3r")
    boxed, found = (
        mo.acceleration_limits(robot, 0.5, speed=0.6, coupled=coupled, equal=True)
        for coupled in (None, radius)
    )
    assert found.solved
    assert found.broken[0] > boxed.broken[0]
    shares = RNG.normal(size=(30_000, 3))
    shares *= radius / np.linalg.norm(shares, axis=1, keepdims=True)
    shares = shares[(np.abs(shares) <= 1.0).all(axis=1)]
    q = RNG.uniform(*robot.limits.bounds("q"), shares.shape)
    signs = np.sign(RNG.uniform(-1, 1, q.shape))
    arm = robot.with_payload(0.5)
    tau = arm.torques_along(q, shares * found.speed, signs * found.qdd_max)["tau"]
    assert np.abs(tau / robot.limits.tau_max).max() <= 1.0
    assert np.linalg.norm(found.state.qd / found.speed) <= radius * (1 + 1e-12)
    assert found.state.torque == pytest.approx(found.state.limit)


@pytest.mark.parametrize(
    ("robot", "load", "speed"),
    sampled_rows(
        [
            (mo.load_robot("planar_3r").with_limits(taud_max=[800.0, 400.0, 200.0]), 1.0, 0.4),
            (telescope().with_limits(taud_max=[900.0, 2000.0, 300.0]), 0.5, 0.5),
            (turned("planar_3r").with_limits(taud_max=500.0), 0.2, [1.0, 2.0, 0.0]),
        ],
        3,
    ),
)
def test_no_state_breaks_a_proved_box_of_jerks(robot: mo.Robot, load: float, speed: Any) -> None:
    found = mo.acceleration_limits(robot, load, speed=speed, jerk=True)
    assert found.solved
    assert 0.0 < found.jerk_gap <= 0.1
    n, count = robot.joint_count, 5000
    arm = robot.with_payload(load)
    q = RNG.uniform(*robot.limits.bounds("q"), (count, n))
    parts = [found.speed, found.qdd_max, found.qddd_max]
    shares = np.sign(RNG.uniform(-1, 1, (3, count, n)))
    shares[0, : count // 2] = RNG.uniform(-1, 1, (count // 2, n))
    rates = arm.torques_along(q, *(p * s for p, s in zip(parts, shares, strict=True)))["taud"]
    use = np.abs(rates / arm.limits.taud_max).max()
    assert 0.5 < use <= 1.0


@pytest.mark.thorough
def test_product_is_larger_than_with_equal_accelerations() -> None:
    robot = mo.load_robot("planar_3r")
    equal, best = (mo.acceleration_limits(robot, 1.0, speed=0.3, equal=e) for e in (True, False))
    assert np.prod(best.broken) > np.prod(equal.broken)
    assert np.ptp(equal.qdd_max) == 0.0


@pytest.mark.thorough
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


def post_and_forearm(radius: float = 0.05) -> mo.Robot:
    """A planar arm that has to fold to keep its forearm off a post of its base at x = -0.5 m."""
    capsules = {
        0: [mo.Capsule([-0.5, -3.0, 0.0], [-0.5, 3.0, 0.0], radius, "post")],
        2: [mo.Capsule([0.0, 0.0, 0.0], [0.5, 0.0, 0.0], radius, "forearm")],
    }
    return mo.load_robot("planar_2r").with_capsules(capsules)


def off_the_post(q: Any, apart: float = 0.1) -> Any:
    """True where both ends of the forearm of half a metre are far enough from x = -0.5 m."""
    elbow = 0.5 * np.cos(q[:, 0])
    return np.minimum(elbow, elbow + 0.5 * np.cos(q.sum(axis=1))) > apart - 0.5


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_poses_in_which_the_arm_touches_itself_are_left_out(share: float) -> None:
    arm, low, high = post_and_forearm(), [-2.9, -2.5], [-1.5, 2.5]
    limits = {"speed": share, "region": (low, high), "equal": True, "gap": 0.02}
    found = mo.acceleration_limits(arm, **limits)
    everywhere = mo.acceleration_limits(arm.with_capsules({}), **limits)
    q = np.array([*product(*map(np.linspace, low, high, [201, 201]))])
    free = off_the_post(q)
    matrices = np.array(mo.mass_matrix(arm).map(len(q))(q.T)).reshape(2, len(q), 2)
    needed, scales = np.abs(matrices).sum(axis=0), np.full(len(q), np.inf)
    for signs in product([-1.0, 0.0, 1.0], repeat=2):
        speeds = np.tile(share * np.multiply(signs, arm.limits.qd_max), (len(q), 1))
        tau = arm.torques_along(q, speeds, 0 * q)["tau"]
        scales = np.minimum(scales, ((arm.limits.tau_max - np.abs(tau)) / needed).min(axis=1))
    assert found.solved
    assert found.qdd_max[0] < scales[free].min()
    assert found.broken[0] == pytest.approx(scales[free].min(), rel=0.02)
    assert off_the_post(found.state.q[None]).all()
    assert everywhere.broken[0] < found.qdd_max[0]  # those poses would have decided


def test_no_box_of_positions_with_a_free_pose_is_dropped() -> None:
    arm = post_and_forearm()
    region = position_region(arm, None)
    middle, half = RNG.uniform(-2.9, 2.9, (4000, 2)), RNG.uniform(0.0, 0.1, (4000, 2))
    low, high = middle - half, middle + half
    dropped = ~region.across(Boxes(low, high))[0]
    poses = RNG.uniform(low[dropped], high[dropped], (50, dropped.sum(), 2))
    assert 100 < dropped.sum() < 3000
    assert not off_the_post(poses.reshape(-1, 2)).any()


def test_which_capsules_leave_poses_out() -> None:
    arm = post_and_forearm()
    assert "self-collision" in position_region(arm, None).words
    fitted = {f: [replace(c, excess=0.01)] for f, c in arm.capsules}  # the links may be apart
    for robot in (mo.load_robot("ur5e"), arm.with_capsules(fitted)):
        assert not position_region(robot, None).pairs
    with refused("region", "without self-collision", "100,000"):
        mo.acceleration_limits(arm, region=([-2.9, -0.1], [-2.8, 0.1]))


@pytest.mark.thorough
def test_no_box_where_gravity_or_speed_alone_need_more_than_the_torque() -> None:
    robot = mo.load_robot("ur5e")
    heavy = mo.acceleration_limits(robot, 40.0, speed=0.0)
    fast = mo.acceleration_limits(robot, 5.0, speed=1.0)
    for found, words in ((heavy, "40 kg"), (fast, "speeds")):
        assert found.status == mo.Status.INFEASIBLE
        assert not found.qdd_max.any()
        tells(found.advice, words, found.state.joint)
        assert found.state.torque > found.state.limit


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"payload": -1.0}, ("payload", "0 kg", "-1.0")),
        ({"payload": (2.0, 1.0)}, ("payload", "(least, largest)", "(2, 1) kg")),
        ({"speed": 1.5}, ("speed", "share", "at most 1", "1.5")),
        ({"speed": [1.0, 2.0]}, ("speed", "[3]", "[2]")),
        ({"speed": [1.0, -2.0, 1.0]}, ("speed", "0 rad/s", "joint 2", "-2")),
        ({"ratios": [1.0, 0.0, 1.0]}, ("ratios", "above 0", "joint 2")),
        ({"ratios": [1.0, 1.0, 1.0], "equal": True}, ("equal=True", "ratios", "both")),
        (
            {"region": ([0.0, 0.0, 0.0], [9.0, 1.0, 1.0])},
            ("region of shoulder", "[-2.96706, 2.96706] rad", "[0, 9]"),
        ),
        ({"region": [[0.0, 0.0, 9.0]]}, ("pose 1 of region", "wrist", "[-2.96706, 2.96706] rad")),
        (
            {"region": mo.Box([0.1, 0.1, 0.1], [9.0, 0.0, 0.0])},
            ("region", "tool", "[9.0, 0.0, 0.0] m"),
        ),
        ({"gap": 0.0}, ("gap", "above 0", "not 0.0")),
        ({"coupled": 0.0}, ("coupled", "above 0", "not 0.0")),
        ({"coupled": 1.5}, ("coupled", "at most 1", "1.5")),
        ({"coupled": 1.0, "jerk": True}, ("jerk=True", "coupled", "both")),
    ],
)
def test_bad_input(arguments: dict[str, Any], said: tuple[str, ...]) -> None:
    with refused(*said):
        mo.acceleration_limits(mo.load_robot("planar_3r"), **arguments)


def test_robots_that_lack_limits() -> None:
    robot = mo.load_robot("planar_3r")
    with refused("shoulder", "torque", "[-inf, inf] N m"):
        mo.acceleration_limits(robot.with_limits(tau_max=np.inf))
    with refused("shoulder", "velocity", "speed", "rad/s"):
        mo.acceleration_limits(robot.with_limits(qd_max=np.inf))


def test_jerks_need_limits_of_torque_rates() -> None:
    with refused("shoulder", "torque rate", "[-inf, inf] N m/s"):
        mo.acceleration_limits(mo.load_robot("planar_3r"), jerk=True)


def test_files_hold_the_limits_as_other_planners_read_them(tmp_path: Path) -> None:
    robot = mo.load_robot("planar_3r").with_limits(taud_max=500.0)
    found = mo.acceleration_limits(robot, 0.3, speed=0.3, jerk=True)
    limits = yaml.safe_load(found.export(tmp_path / "joint_limits.yaml").read_text())
    for k, name in enumerate(robot.joint_names):
        assert limits["joint_limits"][name] == {
            "has_velocity_limits": True,
            "max_velocity": found.speed[k],
            "has_acceleration_limits": True,
            "max_acceleration": found.qdd_max[k],
            "has_jerk_limits": True,
            "max_jerk": found.qddd_max[k],
        }
    part = yaml.safe_load(found.export(tmp_path / "arm.yml", "curobo").read_text())
    space = part["robot_cfg"]["kinematics"]["cspace"]
    assert space["joint_names"] == list(robot.joint_names)
    assert space["max_acceleration"] == found.qdd_max.tolist()
    assert space["max_jerk"] == found.qddd_max.tolist()
    again = mo.load_robot(found.export(tmp_path / "arm.urdf"))
    assert ElementTree.parse(tmp_path / "arm.urdf").getroot().get("version") == "1.2"
    for key in ("qdd_max", "qddd_max"):
        np.testing.assert_array_equal(getattr(again.limits, key), getattr(found, key))
    np.testing.assert_array_equal(again.limits.qd_max, found.speed)
    np.testing.assert_array_equal(found.limited.limits.qddd_max, found.qddd_max)
    with refused("urdf", "end in .urdf", "a.yaml"):
        found.export(tmp_path / "a.yaml", "urdf")
    with refused("form", "moveit, curobo, urdf", "'toppra'"):
        found.export(tmp_path / "a.yaml", "toppra")
    with refused("at rest", "speed", "above 0"):
        mo.acceleration_limits(robot, speed=0.0).export(tmp_path / "none.yaml")
    assert not (tmp_path / "none.yaml").exists()


def test_what_ruckig_makes_of_the_limits_keeps_the_torques() -> None:
    robot = mo.load_robot("planar_3r")
    found = mo.acceleration_limits(robot, (0.0, 0.5), speed=0.5)
    given = found.ruckig()
    given.max_jerk = [1e4] * 3
    given.current_position, given.target_position = [-1.0, 0.5, -1.0], [1.5, -1.0, 1.0]
    path = ruckig.Trajectory(3)
    assert ruckig.Ruckig(3).calculate(given, path) == ruckig.Result.Working
    samples = np.array([path.at_time(t) for t in np.linspace(0.0, path.duration, 500)])
    q, qd, qdd = samples[:, 0], samples[:, 1], samples[:, 2]
    for load in (0.0, 0.5):
        tau = robot.with_payload(load).torques_along(q, qd, qdd)["tau"]
        assert (np.abs(tau) <= robot.limits.tau_max).all()


def test_map_of_payload_and_speed() -> None:
    robot = mo.load_robot("planar_2r")
    found = mo.acceleration.acceleration_map(robot, [0.0, 2.0, 50.0], [0.0, 0.3, 1.0])
    assert (np.diff(found.broken, axis=0) <= 0.0).all()
    assert (np.diff(found.broken, axis=1) <= 1e-9).all()
    assert not found.qdd_max[2].any()
    assert [row[0] for row in found.table().rows] == [0.0, 2.0, 50.0]
    axes = found.plot(guess=5.0)[0]
    np.testing.assert_array_equal(axes.lines[1].get_ydata(), found.qdd_max[1])
    assert axes.lines[3].get_ydata()[0] == 5.0
    with refused("payloads", "rising", "[1.0, 0.0]"):
        mo.acceleration.acceleration_map(robot, [1.0, 0.0])


def test_command(tmp_path: Path) -> None:
    path = tmp_path / "joint_limits.yaml"
    asked = ("limits", "planar_2r", "--payload", "0,1", "--equal")
    assert main([*asked, "--speed", "0.2", "--out", str(path)]) == 0
    expected = mo.acceleration_limits(mo.load_robot("planar_2r"), (0.0, 1.0), speed=0.2, equal=True)
    limits = yaml.safe_load(path.read_text())["joint_limits"]
    assert limits["elbow"]["max_acceleration"] == expected.qdd_max[1]
    none = tmp_path / "none.yaml"
    assert main(["limits", "planar_2r", "--payload", "50", "--out", str(none)]) == 1
    assert not none.exists()
    assert main(["limits", "planar_2r", "--payload", "1,2,3"]) == 2
