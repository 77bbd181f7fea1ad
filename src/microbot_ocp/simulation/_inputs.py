"""Checks of what a simulation is given, before any integrator starts."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.fast_calls import deferred_call
from microbot_ocp.robot import Robot, mass_matrix_condition
from microbot_ocp.simulation._integration import INTEGRATORS, IntegratorSettings

Integrator = Literal["dop853", "cvodes", "idas", "collocation", "rk"]

MOST_TURNS = 2000  # some seconds of work
SINGULAR = 1e12  # condition number of the mass matrix from which on torques determine nothing
ARMATURE = "give the links armature (rotor inertia), such as mo.Link(..., armature=0.1)"


def checked_settings(integrator: str, tolerance: float, max_steps: int) -> IntegratorSettings:
    checks.one_of("integrator", integrator, INTEGRATORS)
    tolerance = checks.number("tolerance", tolerance, above=0.0, at_most=1e-2)
    if isinstance(max_steps, bool) or not isinstance(max_steps, int) or max_steps < 1:
        raise InputError(f"max_steps must be a whole number of at least 1, not {max_steps!r}")
    return IntegratorSettings(integrator, tolerance, max_steps)


def checked_times(t: ArrayLike) -> FloatArray:
    grid = checks.times("t", t)
    checks.size("the number of samples", grid.size, checks.MOST_GIVEN)
    return grid


def checked_start(
    robot: Robot, q0: ArrayLike, qd0: ArrayLike | None, duration: float = 0.0
) -> FloatArray:
    count = robot.joint_count
    q = checks.array("q0", q0, (count,), "rad")
    qd = np.zeros(count) if qd0 is None else checks.array("qd0", qd0, (count,), "rad/s")
    low, high = robot.limits.bounds("q")
    outside = np.flatnonzero((q < low - 1e-9) | (q > high + 1e-9))
    if outside.size:
        j = int(outside[0])
        raise InputError(
            f"q0 of {robot.joint_names[j]} is {q[j]:g} {robot.unit('q', j)}, outside its limits "
            f"[{low[j]:g}, {high[j]:g}] {robot.unit('q', j)}{checks.degrees_hint(q[j])}"
        )
    turns = np.abs(qd) * duration / (2.0 * np.pi) * (np.array(robot.joint_types) == "revolute")
    if turns.max() > MOST_TURNS:
        j = int(turns.argmax())
        raise InputError(
            f"qd0 of {robot.joint_names[j]} is {qd[j]:g} rad/s, {turns[j]:.3g} turns in "
            f"{duration:g} s: at most {MOST_TURNS} are simulated"
        )
    condition = float(deferred_call(mass_matrix_condition(robot))(q)[0])
    if not condition < SINGULAR:
        raise InputError(
            f"mass matrix is singular at q0 = {q.tolist()} (condition number {condition:.2g}): no "
            f"torque determines the acceleration there; {ARMATURE}"
        )
    return np.concatenate([q, qd])
