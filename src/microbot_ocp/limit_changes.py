"""Limits given piecemeal, in degrees or radians, as task files and command lines give them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from microbot_ocp import checks
from microbot_ocp.checks import FloatArray, InputError
from microbot_ocp.robot import LIMIT_UNITS, JointLimits, Limits, Robot


def joint_scale(robot: Robot) -> FloatArray:
    """Factors [n] from degrees to radians; 1 for prismatic joints, which are in metres."""
    return np.where(np.array(robot.joint_types) == "revolute", np.pi / 180.0, 1.0)


def changed_limits(robot: Robot, changes: Mapping[str, Any]) -> JointLimits:
    """Limits of a robot with some of them replaced.

    Parameters
    ----------
    robot : Robot
    changes : mapping
        Keys of quantity and side, such as ``qd_max``, each a number for all joints or one a joint,
        in SI units. A ``qd_max`` without ``qd_min`` holds in both directions, as in
        :class:`Limits`.

    Raises
    ------
    InputError
        Wrong length, NaN, a lower limit above its upper one, a negative bound.
    """
    given: dict[str, Any] = {}
    for quantity in LIMIT_UNITS:
        low, high = f"{quantity}_min", f"{quantity}_max"
        lower, upper = robot.limits.bounds(quantity)
        if quantity == "q" or low in changes:
            given[low], given[high] = changes.get(low, lower), changes.get(high, upper)
        else:
            given[high] = changes.get(high, (lower, upper))
    return Limits(**given).for_joints(robot.joint_count)


def per_joint(robot: Robot, name: str, value: Any) -> FloatArray:
    """One number a joint [n] from a single number or a list; infinite is allowed, NaN is not."""
    count = robot.joint_count
    several = value if isinstance(value, list) else [value] * count
    if len(several) != count:
        raise InputError(
            f"{name} must be one number, or {count} with one a joint "
            f"({', '.join(robot.joint_names)}), not {value}"
        )
    for entry in several:
        if isinstance(entry, bool) or not isinstance(entry, int | float) or entry != entry:
            raise InputError(f"{name} must be numbers, not {value!r}")
    return checks.array(name, several, (count,), finite=False)
