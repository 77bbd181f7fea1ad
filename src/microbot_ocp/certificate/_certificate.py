"""Certificate of a motion as data: all checks with their figures, and the verdict."""

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
    """Use of one limit along a motion, evaluated on a dense grid.

    Attributes
    ----------
    quantity : str
        Key of the limit: "q", "qd", "qdd", "qddd", "tau", "taud", or the key of a further limit.
    name : str
        Name of the limit, such as "torque" or "tool speed".
    labels : tuple of str [k]
        Names of the joints, or of the components of a further limit; ("",) if it is a scalar.
    utilisation : array [k]
        Largest use of the limit by each joint: 1 at the limit, NaN without a limit. For q it is the
        distance from the middle of the range, divided by half the range. k is 1 for a limit that
        does not belong to joints.
    violation : float
        Worst relative violation, 0 if the limit is kept: excess over the limit, divided by the
        limit (for q by half the range).
    joint, time, value, limit, unit
        Joint (empty for a limit that does not belong to joints), time (s), value and limit (both in
        ``unit``) at the worst utilisation.
    jump : bool
        True if the worst utilisation is a jump of the acceleration; its rate is computed as if the
        jump took a microsecond.
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
        """Title of the limit, such as "torque of elbow" or "tool speed"."""
        return f"{self.name} of {self.joint}" if self.joint else self.name

    @property
    def largest_use(self) -> float:
        """Largest use of the limit; 0 if it has no finite bound."""
        return float(np.nanmax(self.utilisation, initial=0.0))

    @property
    def excess(self) -> str:
        """Sentence that names the violated limit, its time and the excess."""
        return (
            f"{self.title} is {self.value:.5g} {self.unit} at {self.time:.4g} s"
            + (", where the acceleration jumps" if self.jump else "")
            + f", {100 * self.violation:.3g} % beyond its limit of {self.limit:.5g} {self.unit}"
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class ResimulationFigures:
    """Figures of a re-simulation; :class:`Certificate` documents each of them."""

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
    """Result of :func:`certify`: every check of a motion with its figures, and the verdict.

    Attributes
    ----------
    label : str
        Label of the motion.
    ok : bool
        True if every check passed.
    verdict : str
        Result in words.
    limit_checks : tuple of LimitCheck
        One check for every limit of the robot.
    final_position_error, final_velocity_error : float
        Largest joint error at the end of an open-loop simulation from the motion's first state,
        rad and rad/s, to first order: the defects of the segments, carried to the end by the
        linearised dynamics. Reported, not judged, because an unstable arm amplifies it; see
        ``amplification``.
    resimulation_status : Status
        Status of the re-simulation; the verdict explains a failure.
    grid_step : float
        Longest step of the dense grid, s.
    grid_ratio : float
        Smallest number of dense grid points in a mesh interval.
    condition_peak, condition_time : float
        Largest condition number of the mass matrix along the motion, and its time, s.
    saturated_fraction : float
        Fraction of the time in which at least one limit (of velocity, acceleration, torque or
        torque rate) is used to 99 % or more.
    condition_pose : array [n]
        Joint positions at the largest condition number, rad.
    path_position_error, path_error_time : float
        Largest joint error along the open-loop simulation, rad, and its time, s.
    segments : int
        Number of simulated segments, each started from the motion's own state.
    defect : float
        Largest defect as a torque: the constant torque that would explain the error at the end of a
        segment, divided by the largest torque of the joint.
    defect_joint, defect_time
        Joint name and time (s) of ``defect``.
    position_defect : float
        Largest position error at the end of a segment, rad (m).
    amplification : float
        Largest factor by which an error of the state (rad and rad/s) can grow until the end of the
        motion, to first order: largest norm of the transition matrices to the end.
    undetermined_fraction : float
        Fraction of the time in which the mass matrix is so near to singular that the torques do not
        determine the motion; inverse dynamics judge the motion there.
    undetermined_direction : array [n] or None
        Unit vector of the least determined direction in joint space.
    stored_torque_error : float
        Largest difference between the stored torques and inverse dynamics, divided by the largest
        torque of the joint (at least a thousandth of the largest torque of all joints).
    stored_torque_joint, stored_torque_time
        Joint name and time (s) of ``stored_torque_error``.
    between_samples_error, between_samples_time : float
        Largest excess of the torque half-way between two samples over the range of the two, beyond
        their difference and relative to the largest torque of the motion, and its time, s. It is
        large if the samples of position, velocity and acceleration contradict each other.
    clearance : Clearance or None
        Clearance from the obstacles of a scene; None without a scene.
    unjudged : tuple of str
        Names of the robot's limits that cannot be judged because it has no masses.
    wall_time : float
        Wall time of the certification, s.
    checks : tuple of Check
        All checks, each with its own verdict.
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
        """Short result: "ok" or "REFUSED", and the limits that were not judged."""
        left = not_judged(self.unjudged)
        return ("ok" if self.ok else "REFUSED") + (f", {left}" if left else "")

    @property
    def via_checks(self) -> tuple[Check, ...]:
        """Checks of the distance to every via point and of every stop."""
        return tuple(check for check in self.checks if check.kind == "via")

    @property
    def segment_checks(self) -> tuple[Check, ...]:
        """Checks of the distance to every tool line, circle and joint line."""
        return tuple(check for check in self.checks if check.kind == "segment")

    @property
    def worst_violation(self) -> float:
        """Worst relative violation of any limit, 0 if all are kept."""
        return max((check.violation for check in self.limit_checks), default=0.0)

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; numbers that are not finite become None."""
        return plain(self)
