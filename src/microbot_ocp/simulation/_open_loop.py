"""The arm under given torques."""

from __future__ import annotations

import time
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.checks import InputError
from microbot_ocp.motion import Motion
from microbot_ocp.robot import Robot, forward_dynamics
from microbot_ocp.simulation._inputs import (
    Integrator,
    checked_settings,
    checked_start,
    checked_times,
)
from microbot_ocp.simulation._integration import ForcedEquation, integrate
from microbot_ocp.simulation._outcome import OPEN_LOOP, result_fields
from microbot_ocp.simulation._result import Simulation
from microbot_ocp.simulation._signals import Formula, torque_signal


def simulate(
    robot: Robot,
    tau: Motion | ArrayLike | Formula | None = None,
    q0: ArrayLike | None = None,
    qd0: ArrayLike | None = None,
    t: ArrayLike | None = None,
    *,
    integrator: Integrator = "dop853",
    tolerance: float = 1e-10,
    max_steps: int = 20_000,
    time_limit: float = np.inf,
) -> Simulation:
    """Simulate an arm from given torques: ``M(q) qdd = tau - C(q, qd) qd - g(q) - friction``.

    Craig, *Introduction to Robotics*, 3rd ed., section 6.9, with a solver that knows its error.

    Parameters
    ----------
    robot : Robot
        A robot with masses.
    tau : Motion, callable, array_like [N,n] or [n], optional
        Torques, N m (N): the stored ones of a motion (they may jump at its breaks), a function of
        the CasADi time that returns n expressions, values on the grid ``t`` (linear between), or
        constants; default none.
    q0 : array_like [n]
        Joint positions at the start, rad (prismatic: m); default those of the motion.
    qd0 : array_like [n], optional
        Velocities at the start, rad/s (m/s); default those of the motion, else zero.
    t : array_like [N]
        Strictly increasing times of the result, s, the first being that of the start; default those
        of the motion.
    integrator : "dop853", "cvodes", "idas", "collocation" or "rk"
        With error control: the Runge-Kutta method of Dormand and Prince of order 8, Adams' method,
        backward differences. Radau collocation of degree 3 or the classical Runge-Kutta method with
        a fixed step, halved until two solutions agree within the tolerance.
    tolerance : float
        Absolute and relative tolerance.
    max_steps : int
        Most steps: from one time of the grid to the next, of a fixed step in all.
    time_limit : float
        Wall time, s, after which the integrator is stopped: the status is "time limit", and what it
        has not reached, NaN. Up to a tenth of the duration that was reached may be missing.

    Returns
    -------
    Simulation
        After a failure its status and advice say why.

    Raises
    ------
    InputError
        Wrong shapes, times that do not increase, a start outside the limits or where the mass
        matrix is singular, or so fast that a joint would turn more than 2000 times.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> robot = mo.load_robot("microbot")
    >>> hold = mo.gravity_torque(robot)([0.0, 0.5, 0.5]).full().ravel()
    >>> still = simulate(robot, hold, q0=[0.0, 0.5, 0.5], t=[0.0, 1.0])
    >>> str(still.status), still.q[-1].round(6).tolist()
    ('solved', [0.0, 0.5, 0.5])
    """
    started = time.perf_counter()
    count = robot.joint_count
    settings = checked_settings(integrator, tolerance, max_steps)
    if isinstance(tau, Motion):
        checks.joints("motion", tau.joint_count, robot)
        q0, qd0 = tau.q[0] if q0 is None else q0, tau.qd[0] if qd0 is None else qd0
        t = tau.t if t is None else t
    if t is None or q0 is None:
        raise InputError("t and q0 must be given unless tau is a Motion")
    grid = checked_times(t)
    start = checked_start(robot, q0, qd0, float(grid[-1] - grid[0]))
    signal = torque_signal(tau, grid, count)

    forced = ForcedEquation(OpenLoop(robot), 2 * count, signal, np.zeros(0))
    with deadline.within(time_limit):
        run = integrate(forced, start, grid, settings)
    return Simulation(
        **result_fields(robot, grid, run, signal.values(grid), None, settings, started, OPEN_LOOP)
    )


class OpenLoop(NamedTuple):
    """An arm under torques w: ``x' = rate(t, x, w, none)``."""

    arm: Robot

    def __call__(self, t: ca.SX, x: ca.SX, w: ca.SX, parameters: ca.SX) -> ca.SX:
        """Give the derivative of the state."""
        q, qd = ca.vertsplit(x, self.arm.joint_count)
        return ca.vertcat(qd, forward_dynamics(self.arm)(q, qd, w))
