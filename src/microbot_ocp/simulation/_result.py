"""Results of simulations: motion, accelerations, conditioning, status and advice."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.fast_calls import deferred_call
from microbot_ocp._base.showing import DrawnAxes, GivenAxes, view_for
from microbot_ocp._base.status import Status
from microbot_ocp.motion import Motion, State
from microbot_ocp.robot import JointLimits, Limits, Robot, forward_dynamics, mass_matrix_condition
from microbot_ocp.simulation._integration import IntegrationRun, IntegratorSettings

SINGULAR = 1e12  # condition number of the mass matrix above which torques determine no motion
NEAR_SINGULAR = 1e6  # condition number of the mass matrix above which the advice mentions it
UNBOUNDED = 1e4  # size of a state beyond the reach of any arm, rad and rad/s
ARMATURE = "give the links armature (rotor inertia), such as mo.Link(..., armature=0.1)"
OPEN_LOOP = "the torques accelerate the arm without bound: change them, or simulate a shorter time"
CLOSED_LOOP = "the loop is unstable: raise sample_rate, or lower the gains"


@dataclass(frozen=True, eq=False)
class Simulation:
    """Motion of an arm under given torques.

    Attributes
    ----------
    t : array [N]
        Times, s.
    q, qd, qdd, tau : array [N,n]
        Positions, rad (m), velocities, accelerations and driving torques, N m (N); NaN if the
        integrator did not reach them.
    status : Status
        Status of the integration.
    integrator : str
        Method.
    tolerance : float
        Tolerance of the integration.
    steps : int
        Number of steps of a fixed-step integrator, 0 for the others.
    condition_peak, condition_time : float
        Largest condition number of the mass matrix among the samples, and its time, s.
    advice : str
        Reason of a failure, and a remedy; empty without failure.
    wall_time : float
        Wall time, s.
    """

    t: FloatArray
    q: FloatArray
    qd: FloatArray
    qdd: FloatArray
    tau: FloatArray
    status: Status
    integrator: str
    tolerance: float
    steps: int
    condition_peak: float
    condition_time: float
    advice: str
    wall_time: float

    @property
    def solved(self) -> bool:
        """True if the integrator reached the end within its tolerance."""
        return self.status.solved

    def as_motion(self, label: str) -> Motion:
        """Return the simulation as a motion that starts at time 0.

        Raises
        ------
        InputError
            The integrator did not reach the end.
        """
        return Motion(self.t - self.t[0], self.q, self.qd, self.qdd, self.tau, label)

    def plot(self, robot: Robot, axes: GivenAxes | None = None, **options: Any) -> DrawnAxes:
        """Draw position, velocity and torque over time; see :func:`microbot_ocp.plots.motion`."""
        return view_for(self, "plot")(robot, self, axes, **options)


@dataclass(frozen=True, eq=False)
class Tracking(Simulation):
    """Motion of an arm under a controller, with its reference.

    Attributes
    ----------
    t, q, qd, qdd, tau, status, ...
        Fields of :class:`Simulation`; ``tau`` is the torque of the drives, within their limits and
        without the disturbance. Under sampled control it is held between the samples.
    reference : State
        Reference positions, velocities and accelerations [N,n].
    label : str
        Name of the controller.
    sample_rate : float or None
        Sampling rate, Hz; None for continuous control.
    saturated_fraction : float
        Fraction of the time in which at least one torque is at its limit.
    torque_limits : (lower [n], upper [n])
        Torque limits of the drives, N m (N); infinite if there is none.
    """

    reference: State = field(default_factory=lambda: State(*(np.zeros((0, 0)),) * 3))
    label: str = ""
    sample_rate: float | None = None
    saturated_fraction: float = 0.0
    torque_limits: tuple[FloatArray, FloatArray] = field(kw_only=True)

    @property
    def error(self) -> FloatArray:
        """Reference minus position [N,n], rad (m)."""
        return self.reference.q - self.q

    def plot(self, robot: Robot, axes: GivenAxes | None = None, **options: Any) -> DrawnAxes:
        """Draw errors and torques over time; see :func:`microbot_ocp.plots.tracking`."""
        return view_for(self, "plot")(robot, self, axes, **options)

    def to_rerun(
        self, robot: Robot, path: str | Path, limits: Limits | JointLimits | None = None
    ) -> Path:
        """Write a Rerun recording (``.rrd``) of the arm beside a ghost of its reference.

        ``limits`` are the limits to draw; default ``robot.limits``.
        """
        return view_for(self, "rerun")(robot, self, limits).save(path)

    @property
    def rms(self) -> FloatArray:
        """Root mean square over time of the error of every joint [n], rad (m)."""
        return self.rms_after(self.t[0])

    @property
    def peak(self) -> FloatArray:
        """Largest error of every joint [n], rad (m)."""
        return np.abs(self.error).max(axis=0)

    def rms_after(self, start: float) -> FloatArray:
        """Return the root mean square of the error [n] from the time ``start``, s, to the end."""
        late = self.t >= checks.number("start", start, "s", at_most=float(self.t[-2]))
        t, square = self.t[late], self.error[late] ** 2
        mean = (0.5 * (square[:-1] + square[1:]) * np.diff(t)[:, None]).sum(axis=0)
        return np.sqrt(mean / (t[-1] - t[0]))

    def peak_after(self, start: float) -> FloatArray:
        """Return the largest error [n] from the time ``start``, s, to the end."""
        late = self.t >= checks.number("start", start, "s", at_most=float(self.t[-2]))
        return np.abs(self.error[late]).max(axis=0)


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
    """Return the fields of :class:`Simulation` from a run, with accelerations and conditioning."""
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
    # Before that time the mass matrix was regular, so the torques are the cause.
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
    """Return the time at which the state first exceeds ``UNBOUNDED``, s; None if it never does."""
    if not np.isfinite(trace[0]).all():
        return None
    with np.errstate(invalid="ignore"):
        gone = ~(np.abs(trace).max(axis=1) < UNBOUNDED)
    return float(times[gone.argmax()]) if gone.any() else None
