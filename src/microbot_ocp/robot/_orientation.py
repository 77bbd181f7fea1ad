"""Fixed angles: roll, pitch, yaw about the axes of the base (Craig, 3rd ed., equation 2.64)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray


def rotation_of(angles: ArrayLike) -> FloatArray:
    """Rotation [3,3] from roll, pitch, yaw [3] about the base axes, rad."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(angles), np.sin(angles)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def fixed_angles(rotation: ArrayLike) -> FloatArray:
    """Roll, pitch, yaw [3], rad, of a rotation [3,3]; where pitch is a quarter turn the yaw is 0.

    >>> fixed_angles(rotation_of([0.1, 0.2, 0.3])).round(6).tolist()
    [0.1, 0.2, 0.3]
    """
    matrix = checks.array("rotation", rotation, (3, 3))
    pitch = np.arctan2(-matrix[2, 0], np.hypot(matrix[0, 0], matrix[1, 0]))
    if abs(np.cos(pitch)) < 1e-9:  # about the vertical, roll and yaw are one
        return np.array([np.sign(pitch) * np.arctan2(matrix[0, 1], matrix[1, 1]), pitch, 0.0])
    roll = np.arctan2(matrix[2, 1], matrix[2, 2])
    return np.array([roll, pitch, np.arctan2(matrix[1, 0], matrix[0, 0])])
