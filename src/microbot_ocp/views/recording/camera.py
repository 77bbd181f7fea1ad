"""Where the eye stands, and the grid under the arm."""

from __future__ import annotations

import numpy as np

from microbot_ocp.checks import FloatArray
from microbot_ocp.robot import Robot
from microbot_ocp.views import scene

EYE_DISTANCE = 0.84  # times the diagonal of everything that moves
TILT = np.radians(22.0)


def eye(
    robot: Robot, q: FloatArray, via_q: FloatArray, headroom: float
) -> tuple[FloatArray, FloatArray]:
    """Place and target of the eye [3], m: everything that moves, seen from the tool's side.

    ``headroom`` (m) is for the labels above.
    """
    points = scene.link_origins(robot, np.vstack([via_q, q])).reshape(-1, 3)
    low, high = points.min(axis=0), points.max(axis=0)
    high[2] += headroom
    middle = (low + high) / 2
    level = scene.link_origins(robot, via_q)[:, -1].mean(axis=0)[:2]
    angle = np.arctan2(level[1], level[0]) if np.linalg.norm(level) > 1e-6 else -np.pi / 4
    towards_eye = np.array(
        [np.cos(TILT) * np.cos(angle), np.cos(TILT) * np.sin(angle), np.sin(TILT)]
    )
    return middle + EYE_DISTANCE * np.linalg.norm(high - low) * towards_eye, middle


def grid_spacing(robot: Robot) -> float:
    """A power of ten or half of one, m, about an eighth of the reach."""
    wanted = scene.reach(robot) / 8
    decade = 10.0 ** np.floor(np.log10(wanted))
    return float(decade * (5.0 if wanted / decade >= 5 else 1.0))
