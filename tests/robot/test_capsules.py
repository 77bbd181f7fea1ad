"""Capsules around a robot's geometry: everything inside, and little else."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

import microbot_ocp as mo
from helpers import refused
from microbot_ocp.robot import Shape, dh_transform
from microbot_ocp.robot._capsules import enclosing_capsule

POSE = dh_transform(0.4, 0.3, -0.2, 1.1)
PRIMITIVES = {
    "box": [0.2, 0.3, 0.9],
    "sphere": [0.3],
    "cylinder": [0.1, 0.7],
    "capsule": [0.1, 0.7],
}


def shaped(*shapes: Shape) -> mo.Robot:
    return mo.Robot.from_dh([0.0, 0.0], [0.0, 1.0], [0.0, 0.0], shapes=shapes)


def made_of(shape: Shape, count: int = 4000) -> np.ndarray:
    """Random points [N,3] of a primitive, most on its surface, in its frame of the robot."""
    rng = np.random.default_rng(5)
    ball = rng.normal(size=(count, 3))
    ball /= np.linalg.norm(ball, axis=1)[:, None]
    if shape.kind == "box":
        points = rng.uniform(-0.5, 0.5, (count, 3)) * shape.size
    elif shape.kind == "cylinder":
        rim = ball[:, :2] / np.linalg.norm(ball[:, :2], axis=1)[:, None] * shape.size[0]
        points = np.column_stack([rim, rng.choice([-0.5, 0.5], count) * shape.size[1]])
    else:
        half = shape.size[1] / 2 if shape.kind == "capsule" else 0.0
        points = ball * shape.size[0] + np.outer(rng.choice([-half, half], count), [0, 0, 1])
    return points @ shape.pose[:3, :3].T + shape.pose[:3, 3]


@pytest.mark.parametrize("kind", PRIMITIVES)
def test_a_primitive_is_inside_its_capsule(kind: str) -> None:
    shape = Shape(1, POSE, kind, PRIMITIVES[kind])
    ((capsule,),) = mo.fit_capsules(shaped(shape), most=1).values()
    assert capsule.distance(made_of(shape)).max() < 1e-12
    if kind != "box":
        assert capsule.radius == PRIMITIVES[kind][0]
        length = PRIMITIVES[kind][-1] if kind != "sphere" else 0.0
        assert np.linalg.norm(capsule.end - capsule.start) == pytest.approx(length)
        assert (capsule.start + capsule.end) / 2 == pytest.approx(POSE[:3, 3])


def test_a_link_of_several_shapes_has_one_capsule_around_all() -> None:
    shapes = [
        Shape(2, dh_transform(0.1 * i, 0.3 * i, 0, 0.2), kind, size, link="hand")
        for i, (kind, size) in enumerate(PRIMITIVES.items())
    ]
    ((capsule,),) = mo.fit_capsules(shaped(*shapes), most=1).values()
    assert max(capsule.distance(made_of(shape)).max() for shape in shapes) < 1e-12


def test_each_link_has_its_capsule_in_the_frame_that_moves_it() -> None:
    robot = shaped(
        Shape(0, np.eye(4), "sphere", [1.0], link="foot"),
        Shape(2, POSE, "sphere", [0.2], link="palm"),
        Shape(2, POSE, "sphere", [0.1], link="thumb"),
        Shape(1, POSE, "sphere", [0.5], "visual", "eye"),
    )
    found = mo.fit_capsules(robot)
    assert {frame: [c.radius for c in each] for frame, each in found.items()} == {
        0: [1.0],
        2: [0.2, 0.1],
    }
    assert [c.radius for c in mo.fit_capsules(robot, "visual")[1]] == [0.5]
    with refused("role", "visual, collision", "'both'"):
        mo.fit_capsules(robot, "both")  # type: ignore[arg-type]


def test_a_long_bar_is_found_in_any_direction() -> None:
    """Around a bar of 0.2 x 0.2 x 2 m: the circle around its section, and hardly longer."""
    ((capsule,),) = mo.fit_capsules(shaped(Shape(1, POSE, "box", [0.2, 0.2, 2.0])), most=1).values()
    radius = 0.1 * np.sqrt(2)
    assert capsule.radius == pytest.approx(radius, rel=1e-3)
    assert capsule.volume < np.pi * radius**2 * (2.0 + 4 / 3 * radius) * 1.001


@given(
    st.integers(0, 10_000), st.integers(1, 60), st.sampled_from([(1, 1, 1), (1, 0.1, 0), (1, 0, 0)])
)
def test_every_point_is_inside(seed: int, count: int, spread: tuple[float, ...]) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(count, 3)) * spread + rng.normal(size=3)
    capsule = enclosing_capsule(points)
    assert capsule.distance(points).max() < 1e-12
    ball = np.linalg.norm(points - points.mean(axis=0), axis=1).max()
    assert capsule.volume <= 4 / 3 * np.pi * ball**3 * (1 + 1e-9) + 1e-30


def test_of_many_points_all_are_inside() -> None:
    points = np.random.default_rng(3).normal(size=(20_000, 3)) * [0.1, 0.2, 0.5]
    assert enclosing_capsule(points).distance(points).max() < 1e-12


def test_repeated_points_and_none() -> None:
    assert enclosing_capsule([[1.0, 2.0, 3.0]] * 5).radius == pytest.approx(0.0, abs=1e-12)
    with refused("points", "at least one"):
        enclosing_capsule(np.zeros((0, 3)))


def test_meshes_are_scaled_and_named_when_they_cannot_be_read(tmp_path: Path) -> None:
    pytest.importorskip("trimesh")
    path = tmp_path / "bar.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 100\nf 1 2 3\nf 1 2 4\n")
    shape = Shape(1, np.eye(4), "mesh", [0.1, 0.1, 0.01], path=str(path))
    ((capsule,),) = mo.fit_capsules(shaped(shape), most=1).values()
    corners = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 1.0]])
    assert capsule.distance(corners).max() < 1e-12
    assert capsule.radius < 0.1
    (tmp_path / "broken.stl").write_text("solid nothing")
    for broken in ("none.obj", "broken.stl"):
        shape = Shape(1, np.eye(4), "mesh", [1, 1, 1], link="arm", path=str(tmp_path / broken))
        with refused("mesh", broken, "link 'arm'"):
            mo.fit_capsules(shaped(shape))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"radius": -1.0}, ("radius", "capsule", "0 m", "not -1.0")),
        ({"start": [0, 0]}, ("start", "capsule", "shape [3]", "not [2]")),
    ],
)
def test_what_is_no_capsule_is_refused(changes: dict[str, Any], message: tuple[str, ...]) -> None:
    with refused(*message):
        mo.Capsule(**({"start": [0, 0, 0], "end": [0, 0, 1], "radius": 0.1} | changes))


def test_a_bent_link_has_two_capsules_that_hold_it_all() -> None:
    """Of an angle of two bars one capsule holds three times its volume."""
    arms = [
        Shape(1, np.eye(4), "box", [1.0, 0.1, 0.1], link="angle"),
        Shape(1, dh_transform(0, 0.5, 0, np.pi / 2), "box", [1.0, 0.1, 0.1], link="angle"),
    ]
    robot = shaped(*arms)
    ((one,),) = mo.fit_capsules(robot, most=1).values()
    (two,) = mo.fit_capsules(robot).values()
    assert len(two) == 2
    inside = np.concatenate([made_of(shape) for shape in arms])
    rng = np.random.default_rng(1)
    places = rng.uniform(-0.7, 0.7, (20_000, 3))
    assert np.min([capsule.distance(inside) for capsule in two], axis=0).max() < 1e-9
    volume = [
        np.any([c.distance(places) <= 0 for c in capsules], axis=0).mean()
        for capsules in ((one,), two)
    ]
    assert volume[1] < 0.5 * volume[0]
    assert max(capsule.excess for capsule in two) < 0.5 * one.excess


@pytest.mark.parametrize("kind", ["box", "cylinder"])
def test_the_excess_is_how_far_a_capsule_stands_out(kind: str) -> None:
    """Of a box and a cylinder in their own frame: the distance is known."""
    shape = Shape(1, np.eye(4), kind, PRIMITIVES[kind])
    ((capsule,),) = mo.fit_capsules(shaped(shape), most=1).values()
    ball = np.random.default_rng(2).normal(size=(20_000, 3))
    ball *= capsule.radius / np.linalg.norm(ball, axis=1)[:, None]
    points = np.concatenate([capsule.start + ball, capsule.end + ball])
    if kind == "box":
        apart = np.linalg.norm(np.maximum(np.abs(points) - shape.size / 2, 0.0), axis=1)
    else:
        across = np.maximum(np.linalg.norm(points[:, :2], axis=1) - shape.size[0], 0.0)
        apart = np.hypot(across, np.maximum(np.abs(points[:, 2]) - shape.size[1] / 2, 0.0))
    assert capsule.excess == pytest.approx(apart.max(), rel=0.05)
