"""Quantities of a robot's joints: values per joint, rest pose, reach, advice on drives."""

from __future__ import annotations

from typing import Any

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.limits import JOINT_QUANTITIES
from microbot_ocp.robot._model import Robot


def joint_scale(robot: Robot) -> FloatArray:
    """Return factors [n] from degrees to radians; 1 for prismatic joints, whose unit is metres."""
    return np.where(np.array(robot.joint_types) == "revolute", np.pi / 180.0, 1.0)


def per_joint(robot: Robot, name: str, value: Any) -> FloatArray:
    """Return one number per joint [n] from a number or a list; infinite but not NaN is allowed."""
    count = robot.joint_count
    several = value if isinstance(value, list) else [value] * count
    if len(several) != count:
        raise InputError(
            f"{name} must be one number, or {count} with one per joint "
            f"({', '.join(robot.joint_names)}), not {value}"
        )
    for entry in several:
        if isinstance(entry, bool) or not isinstance(entry, int | float) or entry != entry:
            raise InputError(f"{name} must be numbers, not {value!r}")
    return checks.array(name, several, (count,), finite=False)


def rest_pose(robot: Robot) -> FloatArray:
    """Return joint positions [n], rad (prismatic: m), nearest to zero within the limits."""
    return np.clip(np.zeros(robot.joint_count), *robot.limits.bounds("q"))


def stretched_out(robot: Robot) -> float:
    """Return an upper bound of the tool's distance from the base origin, m."""
    robot = robot.chain
    revolute = np.array(robot.joint_types) == "revolute"
    low, high = robot.limits.bounds("q")
    slides = np.maximum(np.abs(robot.d + low), np.abs(robot.d + high))
    rows = np.hypot(robot.a, np.where(revolute, robot.d, slides))
    return float(rows.sum() + sum(np.linalg.norm(m[:3, 3]) for m in (robot.base, robot.tool)))


def largest_reach(robot: Robot, *, poses: int = 4000, rounds: int = 12) -> tuple[float, float]:
    """Return the largest distance found between tool and base origin, m, and an upper bound, m.

    Parameters
    ----------
    robot : Robot
    poses : int
        Random poses within the limits in each round, around the best pose so far.
    rounds : int
        Number of rounds, each of which halves the width of the distribution.

    Returns
    -------
    tuple of float
        Largest distance found, a lower bound of the reach, and the length of the stretched chain,
        an upper bound. Both are infinite if a prismatic joint has no limit.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> found, bound = largest_reach(mo.load_robot("planar_2r"))
    >>> round(found, 6), bound
    (1.0, 1.0)
    """
    from microbot_ocp.robot._kinematics import forward_kinematics  # imports CasADi

    low, high = robot.limits.bounds("q")
    bound = stretched_out(robot)
    if not np.isfinite(bound):
        return float("inf"), float("inf")
    rest = rest_pose(robot)  # poses repeat beyond half a turn from the rest pose
    low = np.where(robot.whole_turns | np.isinf(low), np.maximum(low, rest - np.pi), low)
    high = np.where(robot.whole_turns | np.isinf(high), np.minimum(high, rest + np.pi), high)
    rng = np.random.default_rng(0)
    best, distance = rest, 0.0
    batch = forward_kinematics(robot).map(poses + 1)
    for halvings in range(rounds):
        spread = (high - low) * 0.5**halvings
        drawn = np.clip(best + spread * rng.uniform(-1.0, 1.0, (poses, low.size)), low, high)
        q = np.vstack([best, drawn])
        origins = np.array(batch(q.T)).reshape(4, poses + 1, 4)[:3, :, 3]
        distances = np.linalg.norm(origins, axis=0)
        best, distance = q[distances.argmax()], float(distances.max())
    return min(distance, bound), bound


def drive_advice(robot: Robot, qdd: Any = None) -> str:
    """Return a warning about joints that could accelerate faster than any drive, and the remedy.

    It names joints with a limit of velocity only, and joints with a torque limit whose link has an
    inertia of its own but no rotor inertia, which dominates in a geared drive. Links that are point
    masses, as in textbooks, are exempt.

    Parameters
    ----------
    robot : Robot
    qdd : array_like [N,n], optional
        Accelerations of a motion, whose largest value the warning reports.

    Returns
    -------
    str
        Sentence without its full stop; empty if no joint is affected.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> drive_advice(mo.load_robot("microbot"))
    ''
    >>> drive_advice(mo.load_robot("planar_3r")).partition(" nor")[0]
    'motions may accelerate faster than a drive can: for wrist, neither the rotor inertia'
    """
    masses = robot.has_dynamics
    limited = {key: np.isfinite(robot.limits.bounds(key)).any(0) for key in JOINT_QUANTITIES}
    bounded = limited["qdd"] | limited["qddd"] | (limited["taud"] & masses)
    unlimited = np.flatnonzero(~bounded & ~(limited["tau"] & masses)).tolist()
    limitless = np.flatnonzero(~bounded).tolist()
    owned = [*zip(robot.transmission.nonzero()[1].tolist(), robot.links, strict=False)]
    geared = {k for k, link in owned if link.armature or link.rotor is not None}
    heavy = {k for k, link in owned if link.inertia.any()}
    without_rotor = sorted((heavy - geared) & {*limitless})
    if unlimited:
        joints, torque = unlimited, ("torque, ", "tau_max, ") if masses else ("", "")
        lacking = (
            f"no limit of {torque[0]}acceleration or jerk is given ({torque[1]}qdd_max, qddd_max)"
        )
    else:
        joints = without_rotor
        lacking = (
            "neither the rotor inertia nor a limit of acceleration, jerk or torque rate is given "
            "(armature, qdd_max, qddd_max, taud_max)"
        )
    if not joints:
        return ""
    everyone = len(joints) == robot.joint_count
    who = "any joint" if everyone else ", ".join(robot.joint_names[k] for k in joints)
    reached = "motions may accelerate faster than a drive can"
    if qdd is not None:
        peaks = np.abs(np.asarray(qdd)).max(axis=0)
        k = max(joints, key=lambda joint: peaks[joint])
        reached = f"{robot.joint_names[k]} reaches {peaks[k]:.5g} {robot.unit('qdd', k)}"
    return f"{reached}: for {who}, {lacking}"
