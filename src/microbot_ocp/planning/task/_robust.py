"""Limits that hold for every arm of a box of masses, frictions and payloads.

Inverse dynamics is affine in the masses of the links (each with its inertia and armature), in the
friction coefficients and in a point mass at the tool. Over a box of such parameters, each varied
independently, a torque is extreme at a corner, where it equals

    tau_middle +- sum_k |delta_k|,

with the change delta_k by the half width of each parameter. The formula covers every corner without
listing them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import InputError
from microbot_ocp.limits import JointLimits, Limit, Limits
from microbot_ocp.planning.task._friction import frictionless
from microbot_ocp.robot import Robot, inverse_dynamics

# Smoothing of |delta|, share of the torque limits: sqrt(delta^2 + (ROUNDED limit)^2) has no kink,
# and exceeds |delta| by less than that.
ROUNDED = 1e-3


@dataclass(frozen=True)
class _Extreme:
    """Largest (sign 1) or least (sign -1) torque of all arms of a box, an expression.

    The middle of the box is the torque of the state, which includes the current payload.
    """

    robot: Robot
    mass: float
    friction: float
    payload: tuple[float, float]
    near: tuple[float, ...]
    sign: float

    def __call__(self, state: Any) -> Any:
        def torque(robot: Robot) -> Any:
            return inverse_dynamics(robot)(state.q, state.qd, state.qdd)

        def size(value: Any) -> Any:
            return ca.sqrt(value**2 + ca.DM(self.near) ** 2)

        # Friction is varied as a whole, so masses are varied on the arm without it.
        smooth, whole = frictionless(self.robot), state.tau
        moved = torque(smooth)
        spread = self.friction * size(torque(self.robot) - moved)
        if self.mass:
            shares = (torque(_link_alone(smooth, link)) for link in range(len(smooth.links)))
            spread += self.mass * sum(map(size, shares))
        low, high = self.payload
        if high:
            a_kilogram = torque(smooth.with_payload(1.0)) - moved
            whole += 0.5 * (low + high) * a_kilogram
            spread += 0.5 * (high - low) * size(a_kilogram)
        return whole + self.sign * spread


def _link_alone(robot: Robot, number: int) -> Robot:
    """Return the robot with the mass of one link alone."""
    nothing = {"mass": 0.0, "inertia": np.zeros((3, 3)), "armature": 0.0, "rotor": None}
    alone = [
        replace(link, **({} if k == number else nothing)) for k, link in enumerate(robot.links)
    ]
    alone[number] = replace(alone[number], rotor=None)
    return robot.with_links(alone)


def checked_box(
    robot: Robot, mass: float, friction: float, payload: tuple[float, float]
) -> tuple[float, float]:
    """Return the least and the largest payload of a box, kg, after a check of all its numbers."""
    if not robot.has_dynamics:
        raise InputError(f"robot {robot.name!r} has no masses that could differ")
    for name, share in (("mass", mass), ("friction", friction)):
        checks.number(name, share, at_least=0.0, at_most=1.0)
    low, high = (checks.number("payload", each, "kg", at_least=0.0) for each in payload)
    if low > high:
        raise InputError(f"payload must be (least, largest) in kg, not {payload}")
    return low, high


def robust_limits(
    robot: Robot,
    limits: Limits | JointLimits | None = None,
    *,
    mass: float = 0.0,
    friction: float = 0.0,
    payload: tuple[float, float] = (0.0, 0.0),
) -> JointLimits:
    """Return limits that keep the torques of every arm of a box within their bounds.

    Two further limits bound the largest and the least torque of all arms of the box; plan and
    certify with them. Limits of the torque rate hold for the model alone.

    Parameters
    ----------
    robot : Robot
        Robot with masses and torque limits.
    limits : Limits, optional
        Default: the robot's own.
    mass : float
        Largest relative error of every link's mass, with its inertia and armature; links vary
        independently.
    friction : float
        Largest relative error of viscous and Coulomb friction of every joint.
    payload : (float, float)
        Least and largest point mass at the tool, kg.

    Returns
    -------
    JointLimits
        Limits of the robot, with two further ones on the torques of the box.

    Raises
    ------
    InputError
        Shares outside of 0 to 1, a payload below 0 or in the wrong order, or a robot without masses
        or torque limits.

    Examples
    --------
    >>> import numpy as np
    >>> import microbot_ocp as mo
    >>> robot = mo.load_robot("microbot")
    >>> limits = mo.execution.robust_limits(robot, mass=0.05)
    >>> via_q = np.radians([[0, 0, 0], [-90, 90, 90]])
    >>> motion = mo.time_optimal(robot, via_q, limits, mesh=20, starts=1)
    >>> mo.certify(robot, motion, limits).ok
    True
    """
    loads = checked_box(robot, mass, friction, payload)
    arm_limits = robot.limits if limits is None else limits.for_joints(robot.joint_count)
    if not np.isfinite(arm_limits.bounds("tau")).any():
        raise InputError(f"robot {robot.name!r} has no limits of torques: give tau_max")
    largest = np.maximum(-arm_limits.tau_min, arm_limits.tau_max)
    near = ROUNDED * np.where(np.isfinite(largest), largest, 1.0)
    bare = replace(robot, limits=Limits().for_joints(robot.joint_count))
    box = bare, mass, friction, loads, tuple(near.tolist())
    also = (
        Limit("largest torque", _Extreme(*box, 1.0), upper=arm_limits.tau_max, unit="N m"),
        Limit("least torque", _Extreme(*box, -1.0), lower=arm_limits.tau_min, unit="N m"),
    )
    keys = {limit.key for limit in also}
    others = tuple(limit for limit in arm_limits.also if limit.key not in keys)
    return replace(arm_limits, also=(*others, *also))
