"""Checks of one quantity each, of which every certificate is a list."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Check:
    """Verdict on one quantity, with the time and place at which it is worst.

    Attributes
    ----------
    what : str
        Quantity, such as "torque", "stored torque", "clearance", "position of stop 'a'".
    passed : bool
    problem : str
        Sentence about a failure, without the name of the stop.
    where : str
        Joint or pair of bodies; empty if the quantity has one place only.
    time : float
        Time of the worst value, s; NaN if the quantity has no time.
    value, allowed : float
        Worst value and its bound, in ``unit``; NaN if the check is not numerical.
    unit : str
        Unit of both; empty for a ratio.
    kind : str
        Kind of requirement in a task, "via" or "segment"; empty for all others.
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
    """Return the sentences of the checks that failed."""
    return [check.problem for check in checks if not check.passed]
