"""What the eye sees: everything, from the broad side, the right way up."""

import numpy as np
import pytest

import microbot_ocp as mo
from microbot_ocp.robot import Robot
from microbot_ocp.views import _scene as scene
from microbot_ocp.views._eye import FIELD_OF_VIEW, SCREEN_SIZE, find_eye, grid_spacing, upward
from microbot_ocp.views._solids import hidden_share, obstacle_solid

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
    half = np.tan(np.radians(FIELD_OF_VIEW) / 2)
    share = max((angles[:, 0] / SCREEN_SIZE[0]).max(), angles[:, 1].max()) / half
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


def test_the_eye_looks_past_a_wall() -> None:
    robot = mo.load_robot("microbot")
    q = np.linspace([-0.3, 0.4, 0.2], [0.3, 0.6, 0.4], 20)
    usual = find_eye(robot, q, NOWHERE, 0.0)
    middle = 0.5 * (usual.position + usual.target)
    wall = obstacle_solid(mo.Box([4.0, 4.0, 4.0], middle, "wall"), robot)
    eye = find_eye(robot, q, NOWHERE, 0.0, [wall])
    points = scene.link_origins(robot, q)[:, 1:].reshape(-1, 3)
    assert hidden_share(usual.position, points, [wall]) > 0.5
    assert hidden_share(eye.position, points, [wall]) < 0.1
    small = obstacle_solid(mo.Box([0.4, 0.4, 0.4], usual.target, "box"), robot)
    behind = usual.target - 0.4 * usual.axes[2:]  # nothing of the arm is hidden, but a stop is
    assert hidden_share(find_eye(robot, q, behind, 0.0).position, behind, [small]) == 1.0
    assert hidden_share(find_eye(robot, q, behind, 0.0, [small]).position, behind, [small]) == 0.0


@pytest.mark.parametrize(
    "obstacle",
    [
        mo.Sphere([1.0, 0.0, 0.0], 0.2),
        mo.Capsule([1.0, -1.0, 0.0], [1.0, 1.0, 0.0], 0.2),
        mo.Cylinder(0.2, 2.0, [1.0, 0.0, 0.0]),
        mo.HalfSpace([1.0, 0.0, 0.0], 1.0),
        mo.scene.ConvexMesh(np.vstack([np.zeros(3), np.eye(3)]) - 0.2, [1.0, 0.0, 0.0]),
    ],
)
def test_obstacles_hide_what_is_behind_them(obstacle, microbot) -> None:
    points = np.array([[2.0, 0.0, 0.0], [2.0, 0.0, 5.0], [1.5, 0.0, 0.0]])
    whole = isinstance(obstacle, mo.HalfSpace)
    share = hidden_share(np.zeros(3), points, [obstacle_solid(obstacle, microbot)])
    assert share == pytest.approx(1.0 if whole else 2 / 3)
