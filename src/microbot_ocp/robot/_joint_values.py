"""Values of joints as task files and command lines give them: one for all or one each."""

from __future__ import annotations

from typing import Any

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.robot._model import Robot


def joint_scale(robot: Robot) -> FloatArray:
    """Return factors [n] from degrees to radians; 1 for prismatic joints, which are in metres."""
    return np.where(np.array(robot.joint_types) == "revolute", np.pi / 180.0, 1.0)


def per_joint(robot: Robot, name: str, value: Any) -> FloatArray:
    """Return one number a joint [n] from a single number or a list; infinite is allowed, NaN is
    not.
    """
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
