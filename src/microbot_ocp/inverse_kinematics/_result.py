"""Results of inverse kinematics: a solution, or a line of solutions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.status import Status


@dataclass(frozen=True, eq=False)
class IKSolution:
    """Joint positions for one target.

    Attributes
    ----------
    q : array [n]
        Joint positions within the limits, rad (prismatic: m).
    status : Status
        Status "solved" if the target is reached, else the reason.
    position_error : float
        Distance from the tool's origin to the target, m.
    orientation_error : float
        Angle between the tool's orientation and the target's, rad; 0 without orientation.
    advice : str
        Status as a sentence, with figures and a remedy.
    pose : array [4,4]
        Tool in base at ``q``, by forward kinematics.
    self_motion : int
        Number of directions in which the joints can move while the tool stays: 0 for an isolated
        solution; otherwise ``q`` represents a continuum.
    singular : bool
        True if the Jacobian at ``q`` has a lower rank than it has for this arm in general.
    solve_time : float
        Wall time of the search, s; in a batch, the time per target.
    """

    _is_answer: ClassVar[bool] = True  # results are not accepted as arguments

    q: FloatArray
    status: Status
    position_error: float
    orientation_error: float
    advice: str
    pose: FloatArray
    self_motion: int = 0
    singular: bool = False
    solve_time: float = 0.0

    def __repr__(self) -> str:
        values = ", ".join(f"{value:.6g}" for value in self.q)
        return f"<IKSolution [{values}]: {self.status}, {self.position_error:.2g} m off>"

    @property
    def solved(self) -> bool:
        """True if the target is reached."""
        return self.status.solved


@dataclass(frozen=True, eq=False)
class IKPath:
    """Joint positions that follow a line of targets.

    Attributes
    ----------
    q : array [N,n]
        Joint positions, one row per target; joints continue past a full turn if the limits allow.
    statuses : tuple of Status, N
        Status of each row.
    position_error : array [N], m
        Distance from the tool's origin to the target.
    orientation_error : array [N], rad
        Angle between the tool's orientation and the target's.
    largest_step : float
        Largest change of one joint between neighbouring rows, rad (prismatic: m).
    jumps : tuple of int
        Rows that could not be joined to the row before without a jump; empty on success.
    advice : str
        Result in sentences, with remedies.
    solve_time : float
        Wall time, s.
    """

    q: FloatArray
    statuses: tuple[Status, ...]
    position_error: FloatArray
    orientation_error: FloatArray
    largest_step: float
    jumps: tuple[int, ...]
    advice: str
    solve_time: float = 0.0

    @property
    def status(self) -> Status:
        """First status that is not solved, or solved."""
        return next((each for each in self.statuses if each is not Status.SOLVED), Status.SOLVED)

    @property
    def solved(self) -> bool:
        """True if every target is reached and the joints never jump."""
        return self.status.solved and not self.jumps


def read_only(values: FloatArray) -> FloatArray:
    """Return a read-only copy."""
    result = np.array(values, dtype=float)
    result.setflags(write=False)
    return result
