"""Numbers, ranges, points and poses as people read them."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.table import NOTHING
from microbot_ocp.robot import Robot, joint_scale
from microbot_ocp.views._scene import range_text


def number(value: float, digits: int = 4) -> str:
    """Write a number with so many decimals, without those that say nothing; a dash for none."""
    if not math.isfinite(value):
        return NOTHING
    return f"{round(value, digits) + 0.0:.{digits}f}".rstrip("0").rstrip(".")


def span(lower: float, upper: float, digits: int = 4) -> str:
    """Write a range: ± where it is symmetric, a dash where there is none."""
    return range_text(lower, upper, show=lambda value: number(value, digits)) or NOTHING


def point_text(point: Iterable[float]) -> str:
    """Write a point as (x, y, z)."""
    return f"({', '.join(number(float(x)) for x in point)})"


def pose_text(robot: Robot, q: ArrayLike) -> str:
    """Write joint positions with their unit: degrees, or degrees and metres."""
    unit = "deg" if "prismatic" not in robot.joint_types else "deg, prismatic m"
    return f"{point_text(in_degrees(robot, q))} {unit}"


def joint_units(robot: Robot) -> list[str]:
    """Return the unit in which people read the position of each joint."""
    return ["deg" if kind == "revolute" else "m" for kind in robot.joint_types]


def in_degrees(robot: Robot, q: ArrayLike) -> FloatArray:
    """Turn joint values [..., n] into degrees; those of prismatic joints stay as they are."""
    return np.round(np.asarray(q, dtype=float) / joint_scale(robot), 10)
