"""Robots with closed forms, the report's task, and a dense look at limits."""

from __future__ import annotations

import numpy as np

import microbot_ocp as mo
from helpers import two_link_arm
from microbot_ocp.robot import torque_and_rate

VIA_Q = np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]])  # report, part 5
VIA_T = [0.0, 2.0, 4.0]
VIA_QD = np.radians([[0, 0, 0], [10, 40, 20], [0, 0, 0]])

ARM_VIA = np.array([[0.0, 0.3], [1.0, -0.5], [0.5, 0.8]])


def slider(mass: float = 2.0, **limits: object) -> mo.Robot:
    """One mass on a level rail."""
    return mo.Robot.from_dh(
        alpha=[0.0],
        a=[0.0],
        d=[0.0],
        joint_type="prismatic",
        links=[mo.Link(mass, [0.0, 0.0, 0.0])],
        gravity=(0.0, 0.0, 0.0),
        limits=mo.Limits(**limits),
    )


def pendulum(**limits: object) -> mo.Robot:
    """1 kg at 1 m, hanging at q = 0: 9.81 sin(q) N m hold it."""
    return mo.Robot.from_dh(
        alpha=[0.0],
        a=[0.0],
        d=[0.0],
        links=[mo.Link(1.0, [1.0, 0.0, 0.0])],
        gravity=(9.81, 0.0, 0.0),
        limits=mo.Limits(**limits),
        name="pendulum",
    )


def arm(gravity: float = 9.81, **limits: object) -> mo.Robot:
    """The two-link arm; limits default to torque and velocity."""
    chosen = limits or {"tau_max": [60.0, 25.0], "qd_max": 3.0}
    return two_link_arm(1.0, 0.8, gravity=gravity).with_limits(mo.Limits(**chosen))


def dense_excess(robot: mo.Robot, motion: mo.Motion, points: int = 50) -> dict[str, float]:
    """Largest relative excess over every kind of limit, ``points`` times in every interval."""
    breaks, inside = motion.breaks, (np.arange(points) + 0.5) / points
    t = (breaks[:-1, None] + inside * np.diff(breaks)[:, None]).ravel()
    state = motion.sample(t)
    step = 1e-6 * np.diff(breaks).min()
    jerk = (motion.sample(t + step).qdd - motion.sample(t - step).qdd) / (2 * step)
    columns = [values.T for values in (*state, jerk)]
    values = {
        **state._asdict(),
        "tau": np.array(mo.inverse_dynamics(robot)(*columns[:3])).T,
        "taud": np.array(torque_and_rate(robot)(*columns)[1]).T,
    }
    result = {}
    for quantity, value in values.items():
        low, high = robot.limits.bounds(quantity)
        limited = np.isfinite(low) & np.isfinite(high)
        if limited.any():
            middle = (low + high)[limited] / 2 if quantity == "q" else 0.0
            half = ((high - low) / 2 if quantity == "q" else high)[limited]
            result[quantity] = float(np.abs((value[:, limited] - middle) / half).max() - 1.0)
    return result
