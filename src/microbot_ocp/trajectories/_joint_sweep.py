"""A motion that demonstrates every joint in turn."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from microbot_ocp.motion import SAMPLE_STEP, Motion
from microbot_ocp.robot import Robot, rest_pose
from microbot_ocp.trajectories._through_points import quintic


def joint_sweep(
    robot: Robot, *, angle: float = np.pi / 3, distance: float = 0.35, least_time: float = 1.0
) -> Motion:
    """Return a motion of every joint in turn to both sides of the rest pose, from rest to rest.

    The motion keeps the limits of position, velocity and acceleration, not of torque.

    Parameters
    ----------
    robot : Robot
    angle, distance : float
        Deflection of a revolute joint to either side, rad, and of a prismatic one, m, within the
        position limits.
    least_time : float
        Duration of one deflection, s; longer if velocity or acceleration limits require it.

    Returns
    -------
    Motion
        Motion, with torques of zero for a robot without masses.

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
    # A joint that cannot move in both directions.
    steps[np.minimum(speed, acceleration) <= 0.0] = 0.0
    points, times = [rest], [0.0]
    for joint, step in enumerate(steps):
        for target in (rest[joint] + step, rest[joint] - step, rest[joint]):
            point = rest.copy()
            point[joint] = np.clip(target, low[joint], high[joint])
            points.append(point)
    for start, end in pairwise(points):
        way = np.abs(end - start)
        moves = way > 0.0
        # A quintic from rest to rest has peaks of 15/8 d/T and 10/sqrt(3) d/T^2.
        by_speed = 15 / 8 * way[moves] / speed[moves]
        by_acceleration = np.sqrt(10 / np.sqrt(3) * way[moves] / acceleration[moves])
        times.append(times[-1] + float(max([least_time, *by_speed, *by_acceleration])))
    # A quintic is exact between samples.
    step = SAMPLE_STEP if robot.has_dynamics else 10.0 * SAMPLE_STEP
    return Motion.from_polynomial(robot, quintic(points, times), label="joint by joint", step=step)
