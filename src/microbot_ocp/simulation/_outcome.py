"""The fields of a simulation's result: accelerations, conditioning, status and advice."""

from __future__ import annotations

import time
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.status import Status
from microbot_ocp.robot import Robot, forward_dynamics, mass_matrix_condition
from microbot_ocp.simulation._inputs import ARMATURE, SINGULAR
from microbot_ocp.simulation._integration import IntegrationRun, IntegratorSettings

NEAR_SINGULAR = 1e6  # condition number of the mass matrix from which on the advice mentions it
UNBOUNDED = 1e4  # rad and rad/s: no arm goes there
OPEN_LOOP = "the torques accelerate the arm without bound: give others, or simulate a shorter time"
CLOSED_LOOP = "the loop is unstable: raise sample_rate, or lower the gains"


def result_fields(
    robot: Robot,
    grid: FloatArray,
    run: IntegrationRun,
    tau: FloatArray,
    disturbance: ca.Function | None,
    settings: IntegratorSettings,
    started: float,
) -> dict[str, Any]:
    """Fields of :class:`Simulation` from a run, with its accelerations and the conditioning."""
    count = robot.joint_count
    states = run.states
    times, trace = (grid, states) if run.trace is None else run.trace
    stopped = run.status is Status.TIME_LIMIT
    if not (stopped or np.isfinite(states).all()):
        states = np.full_like(states, np.nan)
    q, qd = states[:, :count], states[:, count:]
    outer = 0.0 if disturbance is None else np.array(disturbance.map(grid.size)(grid[None, :])).T
    qdd = np.array(forward_dynamics(robot).map(grid.size)(q.T, qd.T, (tau + outer).T)).T
    conditioning = mass_matrix_condition(robot).map(times.size)
    condition = np.array(conditioning(trace[:, :count].T)).ravel()
    condition[~np.isfinite(trace).all(axis=1)] = 0.0
    worst = int(condition.argmax())
    status, message = run.status, run.message
    moment = None if stopped else _unbounded(times, trace)
    # The mass matrix was regular until then, so the torques are the cause.
    unbounded = moment is not None and condition[times < moment].max(initial=0.0) < NEAR_SINGULAR
    if moment is not None and not status.solved:
        status = Status.UNBOUNDED
        message = f"the motion grows without bound from {moment:.3g} s on"
    elif status.solved and condition[worst] > SINGULAR:
        status = Status.SINGULAR
        message = f"mass matrix singular at {times[worst]:.4g} s: no torque determines the motion"
    hint = "ask for a coarser tolerance, or for more steps by max_steps" if message else ""
    if unbounded:
        hint = OPEN_LOOP if disturbance is None else CLOSED_LOOP
    elif condition[worst] > NEAR_SINGULAR:
        hint = (
            f"mass matrix near singular at {times[worst]:.4g} s (condition number "
            f"{condition[worst]:.2g} at q = {np.round(trace[worst, :count], 4).tolist()}): "
            f"{ARMATURE}"
        )
    return {
        "t": grid,
        "q": q,
        "qd": qd,
        "qdd": qdd,
        "tau": tau,
        "status": status,
        "integrator": settings.integrator,
        "tolerance": settings.tolerance,
        "steps": run.steps,
        "condition_peak": float(condition[worst]),
        "condition_time": float(times[worst]),
        "advice": message if stopped else "; ".join(filter(None, (message, hint))),
        "wall_time": time.perf_counter() - started,
    }


def _unbounded(times: FloatArray, trace: FloatArray) -> float | None:
    """Time at which the state first exceeds ``UNBOUNDED``, s; None where it never does."""
    if not np.isfinite(trace[0]).all():
        return None
    with np.errstate(invalid="ignore"):
        gone = ~(np.abs(trace).max(axis=1) < UNBOUNDED)
    return float(times[gone.argmax()]) if gone.any() else None
