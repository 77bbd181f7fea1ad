"""Where the eye stands, which way is up, and the grid under the arm."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.robot import Robot
from microbot_ocp.views import _scene as scene

FIELD_OF_VIEW = np.radians(55.0)  # of Rerun's eye, from bottom to top
ASPECT = 1.25  # width of the view to its height, about
MARGIN = 1.05
THICK = 0.14  # share of the reach that arrows, arcs and masses stand out from the links
TILT = np.radians(20.0)  # of the line of sight, from above
STEEP_TILT = np.radians(60.0)  # the same where all that moves is level
FLAT = 0.12  # height to width from which on a motion counts as level
AXES = ("X", "Y", "Z")


class Eye(NamedTuple):
    """Place of the eye and what it looks at [3], m, and what is up for it [3]."""

    position: FloatArray
    target: FloatArray
    up: FloatArray


def up_axis(robot: Robot) -> int:
    """Axis of the base frame against which things fall, 0 to 2; z without gravity."""
    size = np.abs(robot.gravity)
    return int(size.argmax()) if size.any() else 2


def upward(robot: Robot) -> FloatArray:
    """Unit vector [3] of the base frame nearest to upward."""
    axis = up_axis(robot)
    sign = -1.0 if robot.gravity[axis] > 0.0 else 1.0
    return sign * np.eye(3)[axis]


def eye(robot: Robot, q: FloatArray, marked: FloatArray, headroom: float) -> Eye:
    """An eye that sees the arm at all positions q [N,n] from its broad side, on the tool's side.

    It sees the places ``marked`` [m,3] as well; ``headroom`` (m) is for the labels above the tool.
    """
    up = upward(robot)
    at_zero = np.zeros((1, robot.joint_count))
    origins = scene.link_origins(robot, q if len(q) else at_zero)
    points = np.vstack([origins.reshape(-1, 3), marked, origins[:, -1] + headroom * up])
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    level = points - np.outer(points @ up, up)
    spread, directions = np.linalg.eigh(np.cov((level - level.mean(axis=0)).T) + np.outer(up, up))
    sideways = np.abs(directions.T @ up) < 0.5
    broad = spread[sideways].max() if sideways.any() else 0.0
    towards = directions[:, np.flatnonzero(sideways)[0]]
    side = float((origins[:, -1] - middle).mean(axis=0) @ towards)
    preferred = np.array([1.0, -1.0, 1.0]) @ towards
    if side * np.sign(side) < 1e-3 * np.sqrt(broad):
        side = preferred
    towards = towards * (1.0 if side >= 0.0 else -1.0)
    height, width = np.ptp(points @ up), np.linalg.norm(np.ptp(level, axis=0))
    tilt = STEEP_TILT if height - headroom < FLAT * width else TILT
    towards = np.cos(tilt) * towards + np.sin(tilt) * up
    return _fitted(points, THICK * scene.reach(robot), middle, towards, up)


def _fitted(
    points: FloatArray, radius: float, middle: FloatArray, towards: FloatArray, up: FloatArray
) -> Eye:
    """The nearest eye in a direction that sees the balls around all points [N,3]."""
    right = np.cross(up, towards)
    right /= np.linalg.norm(right)
    above = np.cross(towards, right)
    across, high = ((points - middle) @ axis for axis in (right, above))
    centre = [(values.min() + values.max()) / 2 for values in (across, high)]
    target = middle + centre[0] * right + centre[1] * above
    depth = (points - target) @ towards
    half_height = np.tan(FIELD_OF_VIEW / 2)
    away = np.maximum(np.abs(high - centre[1]), (np.abs(across - centre[0])) / ASPECT) + radius
    need = away / half_height
    distance = float((depth + MARGIN * need).max())
    return Eye(target + distance * towards, target, up)


def grid_spacing(robot: Robot) -> float:
    """A power of ten or half of one, m, about an eighth of the reach."""
    wanted = scene.reach(robot) / 8
    decade = 10.0 ** np.floor(np.log10(wanted))
    return float(decade * (5.0 if wanted / decade >= 5 else 1.0))
