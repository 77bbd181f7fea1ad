"""Closed form of the course report for an elbow arm, a reference for numerical solutions."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import ROUNDING, FloatArray, InputError


def elbow_arm_branches(
    position: ArrayLike, height: float = 2.0, upper: float = 3.0, forearm: float = 4.0
) -> FloatArray:
    """Return the joint angles of an elbow arm by the law of cosines (course report, part 2).
    Parameters
    ----------
    position : array_like [3]
        Tool origin in the base frame, m.
    height, upper, forearm : float
        Height of the shoulder, and lengths of the two links, m (the report's h, e, f).

    Returns
    -------
    array [4,3]
        Joint angles in (-pi, pi], rad, in the report's order: facing the target, elbow up and down;
        turned away, elbow down and up.

    Raises
    ------
    InputError
        The target is out of reach.

    Examples
    --------
    >>> np.degrees(elbow_arm_branches([3, -1, 4.5])).round(4)[0].tolist()
    [-18.4349, 105.8439, -111.3819]
    """
    x, y, z = checks.array("position", position, (3,), "m")
    radius, rise = np.hypot(x, y), z - height
    square = radius**2 + rise**2
    cosine = (square - upper**2 - forearm**2) / (2 * upper * forearm)
    if abs(cosine) > 1 + ROUNDING:
        raise InputError(
            f"position must be between {abs(upper - forearm):g} and {upper + forearm:g} m from "
            f"the shoulder, not {np.sqrt(square):g} m"
        )
    bend = np.arccos(np.clip(cosine, -1.0, 1.0))
    lift = np.arctan2(rise, radius)
    # Angle at the shoulder between the line to the target and the upper arm.
    inner = np.arctan2(forearm * np.sin(bend), upper + forearm * np.cos(bend))
    facing = np.arctan2(y, x)
    away = np.arctan2(-y, -x)
    rows = [
        [facing, lift + inner, -bend],
        [facing, lift - inner, bend],
        [away, np.pi - lift - inner, bend],
        [away, np.pi - lift + inner, -bend],
    ]
    return (np.array(rows) + np.pi) % (2 * np.pi) - np.pi
