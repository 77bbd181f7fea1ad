"""What a simulation returns: its motion, accelerations, conditioning, status and advice."""

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

SINGULAR = 1e12  # condition number of the mass matrix from which on torques determine nothing
NEAR_SINGULAR = 1e6  # condition number of the mass matrix from which on the advice mentions it
UNBOUNDED = 1e4  # rad and rad/s: no arm goes there
ARMATURE = "give the links armature (rotor inertia), such as mo.Link(..., armature=0.1)"
OPEN_LOOP = "the torques accelerate the arm without bound: give others, or simulate a shorter time"
CLOSED_LOOP = "the loop is unstable: raise sample_rate, or lower the gains"


@dataclass(frozen=True, eq=False)
class Simulation:
    """What an arm did under given torques.

    Attributes
    ----------
    t : array [N]
        Times, s.
    q, qd, qdd, tau : array [N,n]
        Positions, rad (m), velocities, accelerations and the torques that drove them, N m (N).
        NaN where the integrator did not arrive.
    status : Status
    integrator : str
    tolerance : float
    steps : int
        Steps taken by a fixed-step integrator, 0 for the others.
    condition_peak, condition_time : float
        Largest condition number of the mass matrix among the samples, and when, s.
    advice : str
        What went wrong and what to do about it; empty where nothing is wrong.
    wall_time : float
        s.
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
        """Whether the integrator arrived, within its tolerance."""
        return self.status.solved

    def as_motion(self, label: str) -> Motion:
        """Return the same as a motion from time 0.

        Raises
        ------
        InputError
            The integrator did not arrive.
        """
        return Motion(self.t - self.t[0], self.q, self.qd, self.qdd, self.tau, label)

    def plot(self, robot: Robot, axes: GivenAxes | None = None, **options: Any) -> DrawnAxes:
        """Draw position, velocity and torque over time: :func:`microbot_ocp.plots.motion`."""
        return view_for(self, "plot")(robot, self, axes, **options)


@dataclass(frozen=True, eq=False)
class Tracking(Simulation):
    """What an arm did under a controller, and how far from its reference.

    Attributes
    ----------
    t, q, qd, qdd, tau, status, ...
        As in :class:`Simulation`; ``tau`` is what the drives gave, within their limits, without
        the disturbance. Under sampled control it is held between the samples.
    reference : State
        Wanted positions, velocities and accelerations [N,n].
    label : str
        Name of the controller.
    sample_rate : float or None
        Hz; None for continuous control.
    saturated_fraction : float
        Share of the time in which at least one torque is at its limit.
    torque_limits : (lower [n], upper [n])
        Those of the drives, N m (N); infinite where there is none.
    """

    reference: State = field(default_factory=lambda: State(*(np.zeros((0, 0)),) * 3))
    label: str = ""
    sample_rate: float | None = None
    saturated_fraction: float = 0.0
    torque_limits: tuple[FloatArray, FloatArray] = field(kw_only=True)

    @property
    def error(self) -> FloatArray:
        """Reference less position [N,n], rad (m)."""
        return self.reference.q - self.q

    def plot(self, robot: Robot, axes: GivenAxes | None = None, **options: Any) -> DrawnAxes:
        """Draw errors and torques over time: :func:`microbot_ocp.plots.tracking`."""
        return view_for(self, "plot")(robot, self, axes, **options)

    def to_rerun(
        self, robot: Robot, path: str | Path, limits: Limits | JointLimits | None = None
    ) -> Path:
        """Write a Rerun recording (``.rrd``) of the arm beside the ghost of its reference.

        ``limits`` are those of its drives; default ``robot.limits``.
        """
        return view_for(self, "rerun")(robot, self, limits).save(path)

    @property
    def rms(self) -> FloatArray:
        """Root mean square over the time of the error of every joint [n], rad (m)."""
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
    """Return fields of :class:`Simulation` from a run, with its accelerations and the
    conditioning.
    """
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
