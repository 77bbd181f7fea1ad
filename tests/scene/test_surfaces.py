"""Links with collision geometry are judged by hulls of it, not by the capsules around them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import microbot_ocp as mo
from helpers import sampled_rows, tells
from microbot_ocp.robot import Shape
from microbot_ocp.scene import clearances, contact_model

pytest.importorskip("coal")

PLATE = [0.3, 0.2, 0.02]  # m; flat ends: capsules stand out by 0.1 m


def plates() -> mo.Robot:
    """Return a planar arm of three joints whose first and third links are wide plates."""
    bare = mo.Robot.from_dh(alpha=[0, 0, 0], a=[0, 0.3, 0.1], d=[0, 0, 0])
    middle = np.eye(4)
    middle[0, 3] = 0.15
    shapes = tuple(
        Shape(frame, middle, "box", PLATE, "collision", f"plate {frame}") for frame in (1, 3)
    )
    robot = replace(bare, shapes=shapes)
    return robot.with_capsules(mo.fit_capsules(robot, most=1))


def turned(robot: mo.Robot, angle: float) -> mo.Motion:
    """Return a motion that folds the third link to an angle, rad."""
    return mo.Motion.from_polynomial(
        robot, mo.cubic([[0, 0, 0], [0, angle, 0]], [0, 1]), label="fold"
    )


def test_links_of_overlapping_capsules_are_judged_by_their_surfaces() -> None:
    robot = plates()
    assert not mo.Scene().pairs(robot)  # no solver sees them: the capsules overlap at zero
    near = mo.clearance(robot, turned(robot, 0.1), mo.Scene())
    assert near.proved
    assert near.pair == "plate 3 to plate 1"
    # a corner of the first plate from the turned edge of the third, in closed form
    least = 0.1 - 0.1 * np.sin(0.1)
    assert near.minimum == pytest.approx(least, abs=1e-5)
    assert 0.0 < near.at_least <= least
    folded = mo.clearance(robot, turned(robot, 2.5), mo.Scene())
    assert not folded.proved
    assert folded.minimum <= 1e-6


@pytest.mark.thorough
def test_ends_whose_capsules_touch_though_the_links_do_not_are_no_refusal() -> None:
    robot = plates().with_limits(qd_max=[2.0] * 3, qdd_max=[5.0] * 3)
    post = mo.Scene([mo.Cylinder(0.03, 1.0, [0.76, 0.0, 0.0], "post")])
    via = np.array([[0.0, 0.0, 0.0], [-0.6, 0.3, 0.3]])
    overlap = clearances(robot, post.pairs(robot), via[:1]).min()
    assert overlap < -0.02  # of capsules; the plate is 0.03 m away from the post
    apart = contact_model(robot, post).nearest(via[0])
    assert apart.distance == pytest.approx(0.03, abs=1e-6)
    motion = mo.time_optimal(robot, via, scene=post, mesh=20)
    assert motion.solved
    assert mo.clearance(robot, motion, post).proved


@pytest.mark.parametrize(
    ("center", "apart"),
    sampled_rows(
        [([0.25, 0.0, 0.0], 0.09), ([0.0, 0.0, 0.0], -0.01), ([0.25, 0.1, 0.0], -0.01)], 3
    ),
)
def test_a_bent_link_is_hollow_where_it_is_and_solid_where_it_is(center, apart: float) -> None:
    """A fork of three boxes: a ball between its teeth is free, one inside of a tooth is not."""
    teeth = [([0.4, 0.02, 0.1], [0.2, side, 0.0]) for side in (-0.11, 0.11)]
    shapes = []
    for size, place in [([0.05, 0.24, 0.1], [0.0, 0.0, 0.0]), *teeth]:
        pose = np.eye(4)
        pose[:3, 3] = place
        shapes.append(Shape(1, pose, "box", size, "collision", "fork"))
    bare = mo.Robot.from_dh(alpha=[0], a=[0], d=[0])
    robot = replace(bare, shapes=tuple(shapes))
    ball = mo.Scene([mo.Sphere(center, 0.01, "ball")])
    found = contact_model(robot, ball).nearest(np.zeros(1)).distance
    if apart > 0.0:
        assert 0.0 < found <= apart + 1e-6
    else:
        assert found <= apart + 1e-6


def test_links_that_touch_at_rest_by_their_capsules_alone_are_named() -> None:
    robot = replace(plates(), shapes=())
    far = mo.Scene([mo.Sphere([5, 5, 4], 0.1, "ball")])
    proof = mo.clearance(robot, turned(robot, 0.5), far)
    assert proof.proved
    assert proof.unwatched == ("plate 3 to plate 1",)
    tells(proof.sentence, "zero pose", "plate 3 to plate 1")


def test_an_srdf_file_and_ignore_decide_which_surfaces_may_touch() -> None:
    robot = plates()
    folded = turned(robot, 2.5)
    both, far = ("plate 1", "plate 3"), [mo.Sphere([5, 5, 5], 0.1, "ball")]
    for disabled, scene in (
        ((both,), mo.Scene(far)),
        (None, mo.Scene(far, ignore=[both])),
        (None, mo.Scene(far, self_collision=False)),
    ):
        assert mo.clearance(replace(robot, disabled_pairs=disabled), folded, scene).proved


@pytest.mark.thorough
def test_an_equal_robot_without_geometry_does_not_lend_its_answer() -> None:
    robot, far = plates(), mo.Scene([mo.Sphere([5, 5, 4], 0.1, "ball")])
    folded = turned(robot, 2.5)
    assert mo.clearance(replace(robot, shapes=()), folded, far).proved
    assert not mo.clearance(robot, folded, far).proved
