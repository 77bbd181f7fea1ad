"""What a simulation returns."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.showing import DrawnAxes, GivenAxes, view_for
from microbot_ocp._base.status import Status
from microbot_ocp.motion import Motion, State
from microbot_ocp.robot import JointLimits, Limits, Robot


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
        """The same as a motion from time 0.

        Raises
        ------
        InputError
            The integrator did not arrive.
        """
        return Motion(self.t - self.t[0], self.q, self.qd, self.qdd, self.tau, label)

    def plot(self, robot: Robot, axes: GivenAxes | None = None, **options: Any) -> DrawnAxes:
        """Position, velocity and torque over time: :func:`microbot_ocp.plots.motion`."""
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
        """Errors and torques over time: :func:`microbot_ocp.plots.tracking`."""
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
        """Root mean square of the error [n] from the time ``start``, s, to the end."""
        late = self.t >= checks.number("start", start, "s", at_most=float(self.t[-2]))
        t, square = self.t[late], self.error[late] ** 2
        mean = (0.5 * (square[:-1] + square[1:]) * np.diff(t)[:, None]).sum(axis=0)
        return np.sqrt(mean / (t[-1] - t[0]))

    def peak_after(self, start: float) -> FloatArray:
        """Largest error [n] from the time ``start``, s, to the end."""
        late = self.t >= checks.number("start", start, "s", at_most=float(self.t[-2]))
        return np.abs(self.error[late]).max(axis=0)
