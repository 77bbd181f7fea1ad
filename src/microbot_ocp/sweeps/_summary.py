"""What a sweep says as a whole: durations, savings, which limit decides, what failed and why."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.status import Status
from microbot_ocp.sweeps._sweep import Sweep

_NUMBER = re.compile(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?")


class Quartiles(NamedTuple):
    """Of a sample: how many, and the values below which a quarter, half, three quarters lie."""

    count: int
    lower: float
    median: float
    upper: float

    @classmethod
    def of(cls, values: FloatArray) -> Quartiles:
        """Return that of the values that are finite; NaN where there are none."""
        finite = values[np.isfinite(values)]
        if not finite.size:
            return cls(0, np.nan, np.nan, np.nan)
        return cls(finite.size, *map(float, np.quantile(finite, (0.25, 0.5, 0.75))))


@dataclass(frozen=True)
class CaseFailure:
    """Cases that ended alike.

    Attributes
    ----------
    status : Status
    count : int
    case : int
        The first of them, to be done again.
    reason : str
        Of that case.
    """

    status: Status
    count: int
    case: int
    reason: str


@dataclass(frozen=True, eq=False)
class SweepSummary:
    """Statistics of a sweep.

    Attributes
    ----------
    count, done : int
        Of all cases, and of those that have a row.
    solved : mapping from a method to int
    certified : mapping from a method to int
    durations : mapping from a method to Quartiles, s
    savings : mapping from a method to Quartiles
        Of all others: share of their time that the best method (``best``) saves, where both are
        solved.
    best : str
        "time_optimal" where it is among the methods, else the last one.
    decides : mapping from a limit to float
        Share of the solved cases in which this limit is at work for most of the best motion.
    at_limit : mapping from a limit to float
        Mean share of the time of the best motion at this limit.
    failures : tuple of Failure
        The most frequent first.
    case_time : Quartiles
        Wall time of a case, s.
    not_compiled : int
        Cases that were done without a compiler though the study could have used one.
    """

    count: int
    done: int
    solved: Mapping[str, int]
    certified: Mapping[str, int]
    durations: Mapping[str, Quartiles]
    savings: Mapping[str, Quartiles]
    best: str
    decides: Mapping[str, float]
    at_limit: Mapping[str, float]
    failures: tuple[CaseFailure, ...]
    case_time: Quartiles
    not_compiled: int = 0


def summary_of(sweep: Sweep) -> SweepSummary:
    """Return statistics of what is done so far."""
    limits, best = list(sweep.about["limits"]), sweep.best
    columns = ["case", "status", "reason", "case_time", "compiled", f"{best}_limit"]
    for method in sweep.methods:
        columns += [f"{method}_{what}" for what in ("status", "duration", "certified")]
    columns += [f"{best}_at_{name}" for name in limits]
    read = sweep.read(columns)
    solved = {m: read[f"{m}_status"] == Status.SOLVED for m in sweep.methods}
    durations = {m: np.where(solved[m], read[f"{m}_duration"], np.nan) for m in sweep.methods}
    solved_best = solved[best]
    decided = read[f"{best}_limit"][solved_best]
    return SweepSummary(
        count=sweep.count,
        done=read["case"].size,
        solved={m: int(s.sum()) for m, s in solved.items()},
        certified={m: int((s & read[f"{m}_certified"]).sum()) for m, s in solved.items()},
        durations={m: Quartiles.of(d) for m, d in durations.items()},
        savings={
            m: Quartiles.of(1.0 - durations[best] / durations[m])
            for m in sweep.methods
            if m != best
        },
        best=best,
        decides={name: float((decided == name).mean()) for name in limits if decided.size},
        at_limit={
            name: float(np.mean(read[f"{best}_at_{name}"][solved_best]))
            for name in limits
            if solved_best.any()
        },
        failures=_failures(read),
        case_time=Quartiles.of(read["case_time"]),
        not_compiled=int((~read["compiled"] & np.isfinite(read["case_time"])).sum()),
    )


def _failures(read: Mapping[str, np.ndarray]) -> tuple[CaseFailure, ...]:
    """Return failures that differ in their numbers only count as one."""
    places_of: dict[tuple[str, str], list[int]] = {}
    for k in np.flatnonzero(read["status"] != Status.SOLVED):
        kind = _NUMBER.sub("#", read["reason"][k])[:120]
        places_of.setdefault((read["status"][k], kind), []).append(int(k))
    failures = []
    for (status, _), places in places_of.items():
        case = int(read["case"][places[0]])
        checks.one_of(f"status of case {case}", status, Status)
        failures.append(CaseFailure(Status(status), len(places), case, read["reason"][places[0]]))
    return tuple(sorted(failures, key=lambda failure: -failure.count))
