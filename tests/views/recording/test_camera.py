"""What the eye sees: everything, from the broad side, the right way up."""

import numpy as np
import pytest

from microbot_ocp.robot import Robot
from microbot_ocp.views import _scene as scene
from microbot_ocp.views.recording import grid_spacing
from microbot_ocp.views.recording._surroundings import (
    ASPECT,
    FIELD_OF_VIEW,
    find_eye,
    upward,
)

NOWHERE = np.zeros((0, 3))


def arm(name, microbot, **changes):
    """An arm like a planar 3R whose axes stand along ``name``."""
    base = {"y": [[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]], "z": np.eye(4)}[name]
    return Robot.from_dh([0, 0, 0], [0, 1, 1], [0, 0, 0], tool=[0, 1, 0, 0], base=base, **changes)


def poses(robot, count=50):
    rng = np.random.default_rng(1)
    return rng.uniform(-1.2, 1.2, (count, robot.joint_count))


def seen(eye, points):
    """Tangents [N,2] of the angles right of and above the line of sight."""
    forward = eye.target - eye.position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, eye.up)
    right /= np.linalg.norm(right)
    above = np.cross(right, forward)
    offset = points - eye.position
    depth = offset @ forward
    assert (depth > 0).all()
    return np.column_stack([offset @ right / depth, offset @ above / depth])


@pytest.mark.parametrize("place", ["upright", "planar", "level", "far"])
def test_everything_is_in_sight_and_fills_it(place, microbot):
    robot = {
        "upright": microbot,
        "planar": arm("y", microbot),
        "level": arm("z", microbot),
        "far": microbot.with_gravity([0.0, -9.81, 0.0]),
    }[place]
    q = poses(robot)
    marked = np.array([[9.0, 9.0, 9.0]]) if place == "far" else NOWHERE
    eye = find_eye(robot, q, marked, 0.2)
    points = np.vstack([scene.link_origins(robot, q).reshape(-1, 3), marked])
    angles = np.abs(seen(eye, points))
    half = np.tan(FIELD_OF_VIEW / 2)
    share = max((angles[:, 0] / ASPECT).max(), angles[:, 1].max()) / half
    assert 0.5 < share < 1.0


def test_a_planar_arm_is_not_seen_edge_on(microbot):
    for axis, normal in (("y", [0, 1, 0]), ("z", [0, 0, 1])):
        robot = arm(axis, microbot)
        eye = find_eye(robot, poses(robot), NOWHERE, 0.0)
        sight = eye.target - eye.position
        cosine = abs(sight @ normal) / np.linalg.norm(sight)
        assert cosine > 0.8


def test_up_is_where_things_do_not_fall(microbot):
    assert upward(microbot).tolist() == [0, 0, 1]
    assert upward(microbot.with_gravity([0, -9.8, 0.1])).tolist() == [0, 1, 0]
    assert upward(microbot.with_gravity([2.0, 0, 0])).tolist() == [-1, 0, 0]
    assert upward(microbot.with_gravity([0, 0, 0])).tolist() == [0, 0, 1]


def test_grid_spacing_is_round(microbot):
    assert grid_spacing(microbot) == 1.0
