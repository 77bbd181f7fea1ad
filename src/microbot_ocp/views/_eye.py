"""From where arms are seen: everything in sight, from the broad side, the right way up."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.robot import Robot
from microbot_ocp.views._scene import link_origins, reach
from microbot_ocp.views._solids import Solid, hidden_share
from microbot_ocp.views._style import STYLE


class Eye(NamedTuple):
    """Place of the eye and what it looks at [3], m, and what is up for it [3]."""

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
    """Return the unit vector [3] of the base frame nearest to upward; z without gravity."""
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
    """Return an eye that sees the arm at all positions q [N,n] from its broad, the tool's side.

    It sees the places ``places`` [m,3] as well; ``headroom`` (m) is for the labels above the tool.
    Where obstacles hide more than a tenth of the arm, or a place, it looks from another side.
    """
    up = upward(robot)
    origins = link_origins(robot, q if len(q) else np.zeros((1, robot.joint_count)))
    points = np.vstack([origins.reshape(-1, 3), places, origins[:, -1] + headroom * up])
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    level = points - np.outer(points @ up, up)
    spread, directions = np.linalg.eigh(np.cov((level - level.mean(axis=0)).T) + np.outer(up, up))
    sideways = np.flatnonzero(np.abs(directions.T @ up) < 0.5)
    towards = directions[:, sideways[0]]
    side = float((origins[:, -1] - middle).mean(axis=0) @ towards)
    if abs(side) < 1e-3 * np.sqrt(spread[sideways].max()):  # the tool is on both sides alike
        side = float(np.array([1.0, -1.0, 1.0]) @ towards)
    towards = towards * (1.0 if side >= 0.0 else -1.0)
    height, width = np.ptp(points @ up), np.linalg.norm(np.ptp(level, axis=0))
    is_level = height - headroom < 0.12 * width
    tilt = np.radians(STYLE.steep_tilt if is_level else STYLE.tilt)
    seen = origins[:: max(1, len(origins) // 30), 1:].reshape(-1, 3)  # some 30 poses
    eyes = []
    for turn in np.radians([0, -45, 45, -90, 90, -135, 135, 180]):
        turned = np.cos(turn) * towards + np.sin(turn) * np.cross(up, towards)
        eye = _fitted(robot, points, middle, np.cos(tilt) * turned + np.sin(tilt) * up, up)
        hidden = sum(hidden_share(eye.position, p, obstacles) for p in (seen, places) if len(p))
        eyes.append((hidden, eye))
        if eyes[-1][0] <= 0.1:
            return eye
    return min(eyes, key=lambda entry: entry[0])[1]


def _fitted(
    robot: Robot, points: FloatArray, middle: FloatArray, towards: FloatArray, up: FloatArray
) -> Eye:
    """Return the nearest eye in a direction that sees the balls around all points [N,3].

    The balls are as large as what stands out from the links: arrows, arcs and masses.
    """
    axes = Eye(middle + towards, middle, up).axes
    across, above, depth = axes @ (points - middle).T
    centre = [(values.min() + values.max()) / 2 for values in (across, above)]
    aspect = STYLE.screen[0] / STYLE.screen[1]
    away = np.maximum(np.abs(above - centre[1]), np.abs(across - centre[0]) / aspect)
    radius = 2.0 * STYLE.ring * STYLE.link * reach(robot)
    need = (away + radius) / np.tan(np.radians(STYLE.field) / 2)
    target = middle + centre @ axes[:2]
    return Eye(target + float((depth + 1.05 * need).max()) * towards, target, up)


def grid_spacing(robot: Robot) -> float:
    """Return a power of ten or half of one, m, about an eighth of the reach."""
    wanted = reach(robot) / 8
    decade = 10.0 ** np.floor(np.log10(wanted))
    return float(decade * (5.0 if wanted / decade >= 5 else 1.0))
