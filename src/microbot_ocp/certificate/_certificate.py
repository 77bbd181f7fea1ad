"""A certificate of a motion as data: everything that was checked, and the verdict."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from microbot_ocp._base.check import Check
from microbot_ocp._base.checks import FloatArray, plain
from microbot_ocp._base.showing import view_for
from microbot_ocp._base.status import Status
from microbot_ocp.limits import not_judged
from microbot_ocp.scene import Clearance


@dataclass(frozen=True, eq=False)
class LimitCheck:
    """How one limit is used along a motion, on a dense grid.

    Attributes
    ----------
    quantity : str
        Key of the limit: "q", "qd", "qdd", "qddd", "tau", "taud", or that of a further one.
    name : str
        "torque", "tool speed".
    labels : tuple of str [k]
        Names of the joints, or of the components of a further limit; ("",) where it is one number.
    utilisation : array [k]
        Largest share of the limit that each joint uses: 1 is the limit, NaN where there is none.
        For q it is the place between the limits, 0 in the middle. k is 1 where the limit is not one
        of the joints.
    violation : float
        Worst relative violation, 0 where none: excess over the limit, divided by the limit (by half
        the range for q).
    joint, time, value, limit, unit
        Where the worst utilisation is: joint name (empty where the limit is not one of the joints),
        s, value and limit in ``unit``.
    jump : bool
        Whether that is a jump of the acceleration, which counts as if it took a microsecond.
    """

    quantity: str
    name: str
    labels: tuple[str, ...]
    utilisation: FloatArray
    violation: float
    joint: str
    time: float
    value: float
    limit: float
    unit: str
    jump: bool = False

    @property
    def title(self) -> str:
        """Such as "torque of elbow" or "tool speed"."""
        return f"{self.name} of {self.joint}" if self.joint else self.name

    @property
    def largest_use(self) -> float:
        """Largest share of the limit that is used; 0 where it has no finite bound."""
        return float(np.nanmax(self.utilisation, initial=0.0))

    @property
    def excess(self) -> str:
        """What is beyond the limit, where and by how much."""
        return (
            f"{self.title} is {self.value:.5g} {self.unit} at {self.time:.4g} s"
            + (", where the acceleration jumps" if self.jump else "")
            + f", {100 * self.violation:.3g} % beyond its limit of {self.limit:.5g} {self.unit}"
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class ResimulationFigures:
    """What a certificate has of a motion that was simulated again; see there."""

    final_position_error: float = np.nan
    final_velocity_error: float = np.nan
    resimulation_status: Status = Status.NOT_POSSIBLE
    path_position_error: float = np.nan
    path_error_time: float = np.nan
    segments: int = 0
    defect: float = np.nan
    defect_joint: str = ""
    defect_time: float = np.nan
    position_defect: float = np.nan
    amplification: float = np.nan
    undetermined_fraction: float = 0.0
    undetermined_direction: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class Certificate(ResimulationFigures):
    """What was checked of a motion, and the verdict.

    Attributes
    ----------
    label : str
    ok : bool
        Whether every check passed.
    verdict : str
        The result in words.
    limit_checks : tuple of LimitCheck
        One for every kind of limit that the robot has.
    final_position_error, final_velocity_error : float
        Largest joint error at the end of an open-loop simulation from the motion's first state,
        rad and rad/s: the defects of the segments, carried on by the linearised dynamics. For
        information: ``amplification`` says what share of it the instability of the arm has.
    resimulation_status : Status
        The verdict says why where it is not solved.
    grid_step : float
        Longest step of the dense grid, s.
    grid_ratio : float
        Dense grid points to each mesh interval, at least.
    condition_peak, condition_time : float
        Largest condition number of the mass matrix along the way and when, s.
    saturated_fraction : float
        Share of the time in which at least one limit (of velocity, acceleration, torque or torque
        rate) is used to 99 % or more.
    condition_pose : array [n]
        Joint positions at the largest condition number, rad.
    path_position_error, path_error_time : float
        Largest joint error along the open-loop simulation, rad, and when, s.
    segments : int
        How many are simulated, each from the motion's own state at its start.
    defect : float
        What the largest miss at the end of a segment comes to: the constant torque that would
        cause it, divided by the largest torque of the joint.
    defect_joint, defect_time
        Where that is: joint name and s.
    position_defect : float
        Largest miss of a position at the end of a segment, rad (m).
    amplification : float
        How far an error of the state (rad and rad/s) may have grown at the end of the motion, to
        first order: largest norm of the transition matrices to the end.
    undetermined_fraction : float
        Share of the time in which the mass matrix is so near to singular that the torques do not
        determine the motion; there it is judged by inverse dynamics.
    undetermined_direction : array [n] or None
        Direction in joint space that is determined least there, of length 1.
    stored_torque_error : float
        Largest difference between the stored torques and inverse dynamics, divided by the largest
        torque of the joint (at least a thousandth of the largest of all).
    stored_torque_joint, stored_torque_time
        Where that is: joint name and s.
    between_samples_error, between_samples_time : float
        How far the torque half-way between two samples lies outside those of the two (by more than
        they differ), divided by the largest torque of the motion, and when, s. It is large where
        the samples of position, velocity and acceleration deny each other.
    clearance : Clearance or None
        From a scene, where one was given.
    unjudged : tuple of str
        Names of the limits that the robot brings but that it takes masses to judge.
    wall_time : float
        What the certificate took, s.
    checks : tuple of Check
        Everything that was checked, each with its own verdict.
    """

    label: str
    ok: bool
    verdict: str
    limit_checks: tuple[LimitCheck, ...]
    grid_step: float = np.nan
    grid_ratio: float = np.nan
    condition_peak: float = np.nan
    condition_time: float = np.nan
    saturated_fraction: float = np.nan
    condition_pose: FloatArray | None = None
    stored_torque_error: float = np.nan
    stored_torque_joint: str = ""
    stored_torque_time: float = np.nan
    between_samples_error: float = np.nan
    between_samples_time: float = np.nan
    clearance: Clearance | None = None
    unjudged: tuple[str, ...] = ()
    wall_time: float = np.nan
    checks: tuple[Check, ...] = ()

    def __repr__(self) -> str:
        return f"<Certificate of {self.label!r}: {'passed' if self.ok else 'FAILED'}>"

    def _repr_html_(self) -> str:
        return view_for(self, "table")(self)._repr_html_()

    @property
    def outcome(self) -> str:
        """In short: "ok" or "REFUSED", and which limits were not judged."""
        left = not_judged(self.unjudged)
        return ("ok" if self.ok else "REFUSED") + (f", {left}" if left else "")

    @property
    def via_checks(self) -> tuple[Check, ...]:
        """How near the motion comes to every via point, and what it misses of every stop."""
        return tuple(check for check in self.checks if check.kind == "via")

    @property
    def segment_checks(self) -> tuple[Check, ...]:
        """How far the motion is from every tool line, circle and joint line."""
        return tuple(check for check in self.checks if check.kind == "segment")

    @property
    def worst_violation(self) -> float:
        """Worst relative violation of any limit, 0 where none."""
        return max((check.violation for check in self.limit_checks), default=0.0)

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; what is not finite becomes None."""
        return plain(self)
