"""A motion that shows what every joint does."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from microbot_ocp.motion import SAMPLE_STEP, Motion
from microbot_ocp.robot import Robot, rest_pose
from microbot_ocp.trajectories._through_points import quintic


def joint_sweep(
    robot: Robot, *, angle: float = np.pi / 3, distance: float = 0.35, least_time: float = 1.0
) -> Motion:
    """Return every joint in turn to either side of the rest pose and back, from rest to rest.

    The limits of position, velocity and acceleration hold; torques are what it takes.

    Parameters
    ----------
    robot : Robot
    angle, distance : float
        How far a revolute joint turns to either side, rad, and a prismatic one slides, m, where
        its limits allow.
    least_time : float
        Of one way, s; longer where the limits of velocity and acceleration ask for it.

    Returns
    -------
    Motion
        Of a robot without masses with torques of zero.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> joint_sweep(mo.load_robot("planar_2r")).duration
    6.0
    """
    rest = rest_pose(robot)
    low, high = robot.limits.bounds("q")
    speed, acceleration = (
        np.minimum(-lower, upper) for lower, upper in map(robot.limits.bounds, ("qd", "qdd"))
    )
    steps = np.where(np.array(robot.joint_types) == "revolute", angle, distance)
    steps[np.minimum(speed, acceleration) <= 0.0] = 0.0  # what a joint cannot do in both directions
    points, times = [rest], [0.0]
    for joint, step in enumerate(steps):
        for target in (rest[joint] + step, rest[joint] - step, rest[joint]):
            point = rest.copy()
            point[joint] = np.clip(target, low[joint], high[joint])
            points.append(point)
    for start, end in pairwise(points):
        way = np.abs(end - start)
        moves = way > 0.0
        # the peaks of a quintic from rest to rest, over the mean of its velocity
        by_speed = 15 / 8 * way[moves] / speed[moves]
        by_acceleration = np.sqrt(10 / np.sqrt(3) * way[moves] / acceleration[moves])
        times.append(times[-1] + float(max([least_time, *by_speed, *by_acceleration])))
    step = SAMPLE_STEP if robot.has_dynamics else 10.0 * SAMPLE_STEP  # a quintic is exact
    return Motion.from_polynomial(robot, quintic(points, times), label="joint by joint", step=step)
