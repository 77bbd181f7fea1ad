"""A solution in arcs: times at which controls switch and limits become active or inactive."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.status import Status
from microbot_ocp._base.table import Column, Table
from microbot_ocp.ocp.arcs import ArcPlan, joined
from microbot_ocp.ocp.solution import UNKNOWN, Gap, Solution
from microbot_ocp.ocp.switching._singular import SingularArcs

NAMES = {-1: "lower limit", 0: "free", 1: "upper limit"}
SINGULAR = "singular, by its own conditions"
COLUMNS = (
    Column("phase", left=True),
    Column("time", "s", ".12g"),
    Column("name", left=True),
    Column("before", left=True),
    Column("after", left=True),
)


@dataclass(frozen=True)
class Junction:
    """A change of one control or limit between two arcs.

    Attributes
    ----------
    phase : str
    time : time since the start of the phase, s
    name, component : identity of the control or limit
    before, after : "lower limit", "upper limit", "free", or "singular, by its own conditions"
    """

    phase: str
    time: float
    name: str
    component: int
    before: str
    after: str


def junctions_of(
    plan: ArcPlan, lengths: Sequence[float] | FloatArray, *, singular: bool = False
) -> Iterator[Junction]:
    """Yield the changes between arcs; with ``singular``, free controls are called singular."""
    ends = np.cumsum(lengths)[:-1].tolist()
    for end, pair in zip(ends, itertools.pairwise(plan.signatures), strict=True):
        for column, *sides in zip(plan.columns, *pair, strict=True):
            if sides[0] != sides[1]:
                free = SINGULAR if singular and column.limit is None else NAMES[0]
                before, after = (NAMES[side] if side else free for side in sides)
                where = plan.declared.name, end, column.name, column.component
                yield Junction(*where, before, after)


@dataclass(frozen=True, eq=False)
class SwitchingTimes:
    """A solution in arcs.

    Attributes
    ----------
    status : Status
    advice : str
    junctions : junctions in the order of time
    solution : solution of the problem with one phase per arc, with the gap of the switching times
    pieces : names of the arcs of every phase
    state_error : largest relative error of the dynamics in any interval
    singular : solution of the optimality conditions of singular arcs; if present, times, cost and
        samples are taken from it, and ``solution`` is its initial guess
    """

    status: Status
    advice: str
    junctions: tuple[Junction, ...]
    solution: Solution
    pieces: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    state_error: float = np.inf
    singular: SingularArcs | None = None

    @property
    def solved(self) -> bool:
        """True if the arcs are locally optimal and the dynamics accurate."""
        return self.status.solved

    @property
    def cost(self) -> float:
        """Cost of all phases together."""
        return self.solution.cost if self.singular is None else self.singular.cost

    @property
    def gap(self) -> Gap:
        """Estimate of the cost above the local optimum; unknown for singular arcs."""
        return self.solution.gap if self.singular is None else UNKNOWN

    def duration(self, phase: str) -> float:
        """Return the duration of a phase, s."""
        if self.singular is not None:
            return float(self.singular.lengths.sum())
        return float(sum(self.solution[name].duration for name in self.pieces[phase]))

    def sample(self, phase: str, t: ArrayLike) -> dict[str, FloatArray]:
        """Sample every variable [M, size] of a phase at times t [M] since its start.

        A time at a junction belongs to the arc that begins there.
        """
        times = checks.array("t", np.atleast_1d(np.asarray(t, dtype=float)), (None,), "s")
        if self.singular is not None:
            return self.singular.sample(times)
        pieces = [self.solution[name] for name in self.pieces[phase]]
        return joined([p.sample for p in pieces], [p.duration for p in pieces])(times)

    def table(self) -> Table:
        """Return a table with one row per junction."""
        rows = [
            (j.phase, j.time, f"{j.name}[{j.component}]", j.before, j.after) for j in self.junctions
        ]
        return Table(COLUMNS, rows)

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "status": str(self.status),
            "advice": self.advice,
            "cost": self.cost,
            "gap": self.gap.total if self.singular is None else None,
            "state_error": self.state_error,
            "junctions": [vars(junction) for junction in self.junctions],
        }

    def __str__(self) -> str:
        return f"{self.table()}\ncost {self.cost:.15g}{self.gap}\n{self.advice}"

    def __repr__(self) -> str:
        count = len(self.junctions)
        return f"<SwitchingTimes: {self.status}, {count} switches, cost {self.cost:.12g}{self.gap}>"
