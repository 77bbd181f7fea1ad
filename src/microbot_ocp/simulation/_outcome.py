"""The fields of a simulation's result: accelerations, conditioning, status and advice."""

from __future__ import annotations

import time
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.fast_calls import deferred_call
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
    unbounded_hint: str,
) -> dict[str, Any]:
    """Fields of :class:`Simulation` from a run, with its accelerations and the conditioning."""
    count = robot.joint_count
    states = run.states
    times, trace = (grid, states) if run.trace is None else run.trace
    stopped = run.status is Status.TIME_LIMIT
    if not (stopped or np.isfinite(states).all()):
        states = np.full_like(states, np.nan)
    q, qd = states[:, :count], states[:, count:]
    outer = 0.0 if disturbance is None else np.array(disturbance(grid[None, :])).T
    qdd, condition = deferred_call(_accelerations(robot))(q, qd, tau + outer)
    if run.trace is not None:
        condition = deferred_call(mass_matrix_condition(robot))(trace[:, :count])
    condition = condition.ravel()
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
        hint = unbounded_hint
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


@lru_cache(maxsize=64)
def _accelerations(robot: Robot) -> ca.Function:
    """Return accelerations and the condition number, which share the mass matrix."""
    dynamics, conditioning = forward_dynamics(robot), mass_matrix_condition(robot)
    state = [ca.SX.sym(name, robot.joint_count) for name in ("q", "qd", "tau")]
    both = ca.cse([dynamics(*state), conditioning(state[0])])
    return ca.Function("accelerations", state, both)


def _unbounded(times: FloatArray, trace: FloatArray) -> float | None:
    """Time at which the state first exceeds ``UNBOUNDED``, s; None where it never does."""
    if not np.isfinite(trace[0]).all():
        return None
    with np.errstate(invalid="ignore"):
        gone = ~(np.abs(trace).max(axis=1) < UNBOUNDED)
    return float(times[gone.argmax()]) if gone.any() else None
