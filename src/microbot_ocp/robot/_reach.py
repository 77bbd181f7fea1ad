"""How far an arm reaches, and its rest pose: the one nearest to zero within the limits."""

from __future__ import annotations

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.robot._kinematics import forward_kinematics
from microbot_ocp.robot._model import Robot


def rest_pose(robot: Robot) -> FloatArray:
    """Return joint positions [n], rad (prismatic: m), nearest to zero within the limits."""
    return np.clip(np.zeros(robot.joint_count), *robot.limits.bounds("q"))


def stretched_out(robot: Robot) -> float:
    """Return the distance of the tool from the base origin that is never exceeded, m."""
    revolute = np.array(robot.joint_types) == "revolute"
    low, high = robot.limits.bounds("q")
    slides = np.maximum(np.abs(robot.d + low), np.abs(robot.d + high))
    rows = np.hypot(robot.a, np.where(revolute, robot.d, slides))
    return float(rows.sum() + sum(np.linalg.norm(m[:3, 3]) for m in (robot.base, robot.tool)))


def largest_reach(robot: Robot, *, poses: int = 4000, rounds: int = 12) -> tuple[float, float]:
    """Give distance of the tool from the base origin, m: the largest found, and one never exceeded.

    Parameters
    ----------
    robot : Robot
    poses : int
        Drawn within the limits in each round, around the best so far.
    rounds : int
        Each draws from half the width of the one before.

    Returns
    -------
    tuple of float
        What the search finds is a lower bound; the upper one is the chain stretched out. Both are
        infinite where a prismatic joint has no limit.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> found, bound = largest_reach(mo.load_robot("planar_2r"))
    >>> round(found, 6), bound
    (1.0, 1.0)
    """
    revolute = np.array(robot.joint_types) == "revolute"
    low, high = robot.limits.bounds("q")
    bound = stretched_out(robot)
    if not np.isfinite(bound):
        return float("inf"), float("inf")
    rest = rest_pose(robot)  # beyond half a turn from it poses recur
    low = np.where(revolute, np.maximum(low, rest - np.pi), low)
    high = np.where(revolute, np.minimum(high, rest + np.pi), high)
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
