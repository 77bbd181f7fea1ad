"""What every certificate is a list of: checks of one thing each."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Check:
    """One thing that was checked, where and when it is worst, and the verdict.

    Attributes
    ----------
    what : str
        Such as "torque", "stored torque", "clearance", "position of stop 'a'".
    passed : bool
    problem : str
        A sentence without its stop, for where it did not pass.
    where : str
        A joint, a pair of bodies; empty where there is but one place.
    time : float
        When, s; NaN where it is of no time.
    value, allowed : float
        How much, and how much would pass, in ``unit``; NaN where it is not of numbers.
    unit : str
        Empty for a ratio.
    kind : str
        "via" or "segment", of those that a task asks for.
    """

    what: str
    passed: bool
    problem: str = ""
    where: str = ""
    time: float = np.nan
    value: float = np.nan
    allowed: float = np.nan
    unit: str = ""
    kind: str = ""

    def __str__(self) -> str:
        return f"{self.where}: {self.what} {self.value:.3g} of {self.allowed:.3g} {self.unit}"


def problems_of(checks: Iterable[Check]) -> list[str]:
    """Return sentences of what did not pass."""
    return [check.problem for check in checks if not check.passed]
