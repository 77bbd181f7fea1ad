"""A motion from a formula of the time."""

from __future__ import annotations

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp.motion import SAMPLE_STEP, Motion, State
from microbot_ocp.robot import Robot
from microbot_ocp.simulation._signals import Formula, reference_signal


def motion_from_formula(
    robot: Robot, formula: Formula, duration: float, *, label: str, step: float = SAMPLE_STEP
) -> Motion:
    """Motion whose positions are a function of the CasADi time, with exact derivatives.

    Parameters
    ----------
    robot : Robot
        A robot with masses, for the torques.
    formula : callable
        Takes the CasADi time, s, and returns n expressions, rad (m), smooth in between.
    duration : float
        s.
    label : str
    step : float
        Longest step between the samples, s.

    Returns
    -------
    Motion

    Examples
    --------
    >>> import casadi as ca
    >>> import microbot_ocp as mo
    >>> robot = mo.load_robot("microbot")
    >>> wave = motion_from_formula(robot, lambda t: [ca.sin(t), 0.2 * t, 0.0], 2.0, label="wave")
    >>> wave.qd[0].tolist()
    [1.0, 0.2, 0.0]
    """
    duration = checks.number("duration", duration, "s", above=0.0)
    step = checks.number("step", step, "s", above=0.0)
    count = robot.joint_count
    _, _, signal = reference_signal(formula, duration, robot)
    t = np.linspace(0.0, duration, checks.step_count(duration, step) + 1)
    q, qd, qdd = np.split(signal.values(t), [count, 2 * count], axis=1)
    return Motion.from_state(
        robot,
        t,
        State(q, qd, qdd),
        label=label,
        breaks=[0.0, duration],
        provenance={"method": "formula"},
    )
