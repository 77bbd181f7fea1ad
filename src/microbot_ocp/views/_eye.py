"""Viewpoint of figures in space: the whole arm in view, from its broad side, upright."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.robot import Robot
from microbot_ocp.views._scene import AXIS_MARGIN, link_origins, reach
from microbot_ocp.views._solids import Solid, hidden_share
from microbot_ocp.views._style import LINK_RADIUS, TORQUE_RING

SCREEN_SIZE = (1.25, 1.0)  # width and height of Rerun's view of the arms, up to a factor
FIELD_OF_VIEW = 55.0  # vertical field of view in Rerun, deg
EYE_TILT = 20.0  # downward angle of the eye, deg
STEEP_EYE_TILT = 60.0  # downward angle of the eye for motions in a level plane, deg


class Eye(NamedTuple):
    """Viewpoint: position of the eye [3], target point [3], m, and up direction [3]."""

    position: FloatArray
    target: FloatArray
    up: FloatArray

    @property
    def axes(self) -> FloatArray:
        """Unit vectors [3,3] to the right and upwards in the picture, and towards the eye."""
        towards = self.position - self.target
        right = np.cross(self.up, towards)
        rows = np.array([right, np.cross(towards, right), towards])
        return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def upward(robot: Robot) -> FloatArray:
    """Return the axis [3] of the base frame that is closest to upward; z without gravity."""
    size = np.abs(robot.gravity)
    axis = int(size.argmax()) if size.any() else 2
    return (-1.0 if robot.gravity[axis] > 0.0 else 1.0) * np.eye(3)[axis]


def find_eye(
    robot: Robot,
    q: FloatArray,
    places: FloatArray,
    headroom: float,
    obstacles: Sequence[Solid] = (),
) -> Eye:
    """Return a viewpoint that has the arm in view at all positions q [N,n].

    The eye stands on the broad side of the motion, on the side of the tool, and has ``places``
    [m,3] in view, too; ``headroom`` (m) is the height of the labels above the tool. If obstacles
    hide more than a tenth of the arm or of the places, the eye moves to another side.
    """
    up = upward(robot)
    origins = link_origins(robot, q if len(q) else np.zeros((1, robot.joint_count)))
    points = np.vstack([origins.reshape(-1, 3), places, origins[:, -1] + headroom * up])
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    level = points - np.outer(points @ up, up)
    # The smallest eigenvector of the covariance is the level direction of least spread, so that the
    # view along it is the broad side. up up' keeps the vertical eigenvector apart.
    spread, directions = np.linalg.eigh(np.cov((level - level.mean(axis=0)).T) + np.outer(up, up))
    sideways = np.flatnonzero(np.abs(directions.T @ up) < 0.5)
    towards = directions[:, sideways[0]]
    side = float((origins[:, -1] - middle).mean(axis=0) @ towards)
    if abs(side) < 1e-3 * np.sqrt(spread[sideways].max()):  # the tool prefers neither side
        side = float(np.array([1.0, -1.0, 1.0]) @ towards)
    towards = towards * (1.0 if side >= 0.0 else -1.0)
    height, width = np.ptp(points @ up), np.linalg.norm(np.ptp(level, axis=0))
    is_level = height - headroom < 0.12 * width
    tilt = np.radians(STEEP_EYE_TILT if is_level else EYE_TILT)
    seen = origins[:: max(1, len(origins) // 30), 1:].reshape(-1, 3)  # about 30 poses
    # Arrows, arcs and masses are drawn around the links.
    around, eyes = 2.0 * TORQUE_RING * LINK_RADIUS * reach(robot), []
    for turn in np.radians([0, -45, 45, -90, 90, -135, 135, 180]):
        turned = np.cos(turn) * towards + np.sin(turn) * np.cross(up, towards)
        eye = fitted(points, np.cos(tilt) * turned + np.sin(tilt) * up, up, around)
        hidden = sum(hidden_share(eye.position, p, obstacles) for p in (seen, places) if len(p))
        eyes.append((hidden, eye))
        if eyes[-1][0] <= 0.1:
            return eye
    return min(eyes, key=lambda entry: entry[0])[1]


def fitted(points: FloatArray, towards: FloatArray, up: FloatArray, radius: float) -> Eye:
    """Return the closest viewpoint in a direction that has spheres around all points [N,3] in view.

    ``towards`` [3] is the unit vector from the points to the eye, ``radius`` (m) of the spheres.
    """
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    axes = Eye(middle + towards, middle, up).axes
    across, above, depth = axes @ (points - middle).T
    centre = [(values.min() + values.max()) / 2 for values in (across, above)]
    aspect = SCREEN_SIZE[0] / SCREEN_SIZE[1]
    # A sphere of radius r at a distance a from the axis of view is visible at a depth d if
    # a + r <= d tan(field / 2).
    away = np.maximum(np.abs(above - centre[1]), np.abs(across - centre[0]) / aspect)
    need = (away + radius) / np.tan(np.radians(FIELD_OF_VIEW) / 2)
    target = middle + centre @ axes[:2]
    return Eye(target + float((depth + (1 + AXIS_MARGIN) * need).max()) * towards, target, up)


def grid_spacing(robot: Robot) -> float:
    """Return a grid spacing of about an eighth of the reach: a power of ten or half of it, m."""
    wanted = reach(robot) / 8
    decade = 10.0 ** np.floor(np.log10(wanted))
    return float(decade * (5.0 if wanted / decade >= 5 else 1.0))
