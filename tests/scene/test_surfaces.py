"""Links whose fitted capsules overlap in the zero pose, judged by their collision geometry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import microbot_ocp as mo
from microbot_ocp.robot import Shape

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


def test_an_equal_robot_without_geometry_does_not_lend_its_answer() -> None:
    robot, far = plates(), mo.Scene([mo.Sphere([5, 5, 4], 0.1, "ball")])
    folded = turned(robot, 2.5)
    assert mo.clearance(replace(robot, shapes=()), folded, far).proved
    assert not mo.clearance(robot, folded, far).proved
