"""Distances that solvers see, against coal on random poses and against closed forms."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import microbot_ocp as mo
from microbot_ocp._base.codegen import interpreted
from microbot_ocp.robot import dh_transform
from microbot_ocp.scene import clearances, contact_model
from microbot_ocp.scene._pairs import ROUNDING

POSE = dh_transform(0.4, 0.3, -0.2, 1.1)
STONE = np.array([[0, 0, 0], [0.4, 0, 0], [0, 0.3, 0], [0.1, 0.1, 0.5], [0.3, 0.3, 0.2]])
OBSTACLES = {
    "sphere": mo.Sphere([0.1, 0.2, 0.3], 0.2),
    "box": mo.Box([0.2, 0.3, 0.9], POSE),
    "capsule": mo.Capsule([0.1, 0, 0], [0.3, 0.2, 0.4], 0.1),
    "cylinder": mo.Cylinder(0.1, 0.7, POSE),
    "half space": mo.HalfSpace([0.2, 0.3, 2.0], -0.4),
    "mesh": mo.scene.ConvexMesh(STONE, POSE),
}
# one capsule that six sliding and turning joints bring anywhere
FLYING = mo.Robot.from_dh(
    alpha=[0, np.pi / 2, np.pi / 2, 0, np.pi / 2, np.pi / 2],
    a=np.zeros(6),
    d=np.zeros(6),
    theta_offset=[0, np.pi / 2, np.pi / 2, 0, 0, 0],
    joint_type=["prismatic"] * 3 + ["revolute"] * 3,
    name="flying",
)
RADIUS = 0.05
AXIS = mo.Capsule([-0.2, 0, 0], [0.3, 0, 0.1], RADIUS, "needle")
NEEDLE = FLYING.with_capsules({6: [AXIS]})


@pytest.fixture(autouse=True)
def not_compiled():
    """A compiler takes seconds for the faces of a mesh, and is called for every pair."""
    with interpreted():
        yield


@lru_cache
def scene(kind: str) -> mo.Scene:
    return mo.Scene([OBSTACLES[kind]])


@pytest.mark.parametrize("kind", OBSTACLES)
@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(-1.5, 1.5), min_size=6, max_size=6))
def test_a_distance_is_that_of_coal_and_never_more(kind: str, values: list[float]) -> None:
    q = np.array([values])
    own = clearances(NEEDLE, scene(kind).pairs(NEEDLE), q)[0, 0]
    other = contact_model(NEEDLE, scene(kind)).distances(q)[0, 0]
    if other > 1e-5:
        assert own < other + 1e-6
        if kind != "mesh":  # whose corners are mitred for the solver
            assert own > other - 0.3 * ROUNDING * RADIUS
    elif other < -1e-3:
        assert own < 0


@pytest.mark.parametrize("kind", OBSTACLES)
def test_first_and_second_derivatives_are_those_of_finite_differences(kind: str) -> None:
    limit = scene(kind).limit(NEEDLE)
    q, still = ca.SX.sym("q", 6), ca.SX.zeros(6)
    value = limit.expression(NEEDLE.motion_state(q, still, still, still))
    hessian, gradient = ca.hessian(value, q)
    function = ca.Function("f", [q], [value, gradient, hessian])
    poses = np.random.default_rng(3).uniform(-1.2, 1.2, (12, 6))
    worst = []
    for pose in poses:
        _, slope, curve = (np.array(a) for a in function(pose))
        steps = [(function(pose + h), function(pose - h)) for h in 1e-6 * np.eye(6)]
        numeric = [np.array(a[0] - b[0]).item() / 2e-6 for a, b in steps]
        bend = [np.array(a[1] - b[1]).ravel() / 2e-6 for a, b in steps]
        assert slope.ravel() == pytest.approx(numeric, abs=1e-7)
        worst.append(np.abs(curve - bend).max() / max(1.0, np.abs(curve).max()))
    assert np.median(worst) < 1e-5  # a pose or two may stand where curvature jumps


def test_a_needle_over_a_floor_stands_as_high_as_its_lower_end() -> None:
    floor = mo.Scene([mo.HalfSpace([0, 0, 1], 0.1)])
    pose = mo.forward_kinematics(NEEDLE, 6)
    q = np.array([0.2, -0.3, 0.9, 0.4, 0.1, 0.2])
    placed = np.array(pose(q))
    ends = [placed[:3, :3] @ end + placed[:3, 3] for end in (AXIS.start, AXIS.end)]
    lower = min(end[2] for end in ends) - 0.1 - RADIUS
    assert clearances(NEEDLE, floor.pairs(NEEDLE), q[None])[0, 0] == pytest.approx(lower, abs=1e-12)
    assert contact_model(NEEDLE, floor).distances(q[None])[0, 0] == pytest.approx(lower, abs=1e-9)


def test_a_mesh_with_many_faces_is_enclosed_for_the_solver() -> None:
    ball = np.random.default_rng(0).normal(size=(200, 3))
    ball *= 0.2 / np.linalg.norm(ball, axis=1)[:, None]
    around = mo.Scene([mo.scene.ConvexMesh(ball, [0.5, 0, 0])])
    q = np.random.default_rng(1).uniform(-1, 1, (40, 6))
    own = clearances(NEEDLE, around.pairs(NEEDLE), q)[:, 0]
    other = contact_model(NEEDLE, around).distances(q)[:, 0]
    far = other > 0
    assert far.sum() > 20
    assert (own[far] < other[far] + 1e-9).all()


def test_derivatives_of_all_pairs_together_are_those_of_automatic_differentiation() -> None:
    robot = mo.load_robot("planar_3r")
    robot = robot.with_capsules(mo.robot.link_capsules(robot))
    limit = mo.Scene(tuple(OBSTACLES.values())).limit(robot)
    q, still, weights = ca.SX.sym("q", 3), ca.SX.zeros(3), ca.SX.sym("w", len(limit.labels))
    value = limit.expression(robot.motion_state(q, still, still, still))
    hessian, gradient = ca.hessian(ca.dot(weights, value), q)
    automatic = ca.Function("f", [q, weights], [value, ca.jacobian(value, q), gradient, hessian])
    first, second = limit.expression.derivatives(robot, compiled=False)
    random = np.random.default_rng(4)
    poses = random.uniform(-2.0, 2.0, (5, 3))
    pulls = random.normal(size=(5, len(limit.labels)))
    at_once = limit.expression.in_poses(robot, 5)
    tables = (*at_once.slopes(poses), *at_once.curvature(poses, pulls))
    for k, (pose, pull) in enumerate(zip(poses, pulls, strict=True)):
        wanted = [np.array(part) for part in automatic(pose, pull)]
        made = [np.array(part) for part in (*first(pose), *second(pose, pull))]
        for own, table, expected in zip(made, tables, wanted, strict=True):
            np.testing.assert_allclose(own, expected, atol=1e-12)
            np.testing.assert_allclose(table[k], expected.reshape(table[k].shape), atol=1e-12)
