"""What inverse kinematics returns: a solution, or a line of them."""

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
    position_error : float
        Distance from the tool's origin to the target, m.
    orientation_error : float
        Angle between the tool's orientation and the target's, rad; 0 where none was asked.
    advice : str
        The status as a sentence, with figures and what may help.
    pose : array [4,4]
        Tool in base at ``q``, by forward kinematics.
    self_motion : int
        Number of directions in which the joints can move while the tool stays: 0 for an isolated
        solution; otherwise ``q`` stands for a continuum.
    singular : bool
        Whether the Jacobian has lost rank at ``q`` beyond what the arm's redundancy explains.
    solve_time : float
        Wall time of the search, s; for a batch its share of it.
    """

    _is_answer: ClassVar[bool] = True  # made here only: nobody's arguments

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
        """Whether the target is reached."""
        return self.status.solved


@dataclass(frozen=True, eq=False)
class IKPath:
    """Joint positions that follow a line of targets.

    Attributes
    ----------
    q : array [N,n]
        One row a target, continuous: joints count on past a full turn where the limits allow it.
    statuses : tuple of Status, N
    position_error : array [N], m
    orientation_error : array [N], rad
    largest_step : float
        Largest change of one joint between neighbouring rows, rad (prismatic: m).
    jumps : tuple of int
        Rows that could not be joined to the row before without a jump; empty on success.
    advice : str
        What happened, as sentences.
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
        """The first status that is not solved, else solved."""
        return next((each for each in self.statuses if each is not Status.SOLVED), Status.SOLVED)

    @property
    def solved(self) -> bool:
        """Whether every target is reached and the joints never jump."""
        return self.status.solved and not self.jumps


def read_only(values: FloatArray) -> FloatArray:
    """Return a copy that cannot be written to."""
    result = np.array(values, dtype=float)
    result.setflags(write=False)
    return result
