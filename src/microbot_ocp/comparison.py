"""The same task by every method under the same limits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from microbot_ocp.certificate import Certificate
from microbot_ocp.checks import FloatArray
from microbot_ocp.motion import Motion
from microbot_ocp.robot import JointLimits, Robot


@dataclass(frozen=True, eq=False)
class Entry:
    """One method's motion with what it costs.

    Attributes
    ----------
    name : str
        Key of the method, also the file name of its motion.
    title : str
        What legends and tables print.
    motion : Motion or None
        None where the method failed; ``status`` and ``note`` then say why.
    certificate : Certificate or None
    status : str
        "solved", or why not.
    note : str
    solve_time : float
        Wall time, s.
    torque_squared : float
        Integral of tau' tau, (N m)^2 s.
    work : float
        Mechanical work: integral of the sum over the joints of abs(tau qd), J.
    """

    name: str
    title: str
    motion: Motion | None
    certificate: Certificate | None
    status: str
    note: str
    solve_time: float
    torque_squared: float
    work: float
    details: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Comparison:
    """Motions of one task by several methods, under the same limits."""

    robot: Robot
    via_q: FloatArray
    limits: JointLimits
    entries: tuple[Entry, ...]
    reference: str  # name of the entry to which durations are compared
