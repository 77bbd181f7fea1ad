"""Description of every row and variable of a program: one table for all its users.

Kernels describe their rows while building them, and the layout adds their places in the program.
Bounds, labels, initial guesses, advice and verification use both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.ocp.problem import LIMITS, VARIABLES, PathConstraint, Phase

IntArray = np.ndarray
DURATION = "duration"
EQUATIONS = ("step", "defect", "equation", "link", "value")
"""Kinds of rows that are zero; other rows have declared limits."""

_FREE = ("arrival", "transition")  # variables whose bounds apply at the next stage or phase
_LISTS = (*VARIABLES, *LIMITS)
_DESCRIPTIONS = {
    "step": "step of {}",
    "defect": "dynamics of {}",
    "bound": "bound of {}",
    "equation": "algebraic equation {}",
    "constraint": "constraint {}",
    "initial": "start condition of {}",
    "link": "link of {} to the next phase",
    "end": "end constraint {}",
    "point": "point constraint {}",
    "value": "{}",
    "final": "end condition of {}",
    "state": "state {}",
    "control": "control {}",
    "parameter": "free parameter {}",
    "arrival": "control {} at the end of the interval",
    "algebraic": "algebraic variable {}",
    "duration": "{}",
    "transition": "start of {} in the next phase",
    "coefficient": "spline coefficient of {}",
}


@dataclass(frozen=True)
class TableEntry:
    """Description of one row or variable of a stage.

    Attributes
    ----------
    kind : str
        Kind of a row: "step" (next mesh point equals the result of the scheme), "defect" (dynamics
        inside an interval), "bound" (bound of a state between mesh points), "equation" (algebraic),
        "constraint" (along the phase), "initial", "link", "end" (constraint at the end), "point"
        (constraint at given times), "value" (definition of a free parameter) or "final".
        Kind of a variable: "state", "control", "parameter" (free parameter), "arrival" (linear
        control at the end of its interval), "algebraic", "duration" or "transition" (variable at
        the last mesh point that equals an initial value of the next phase).
    source : tuple of str and int, or None
        List of the phase with the declaration, and position in it; None for the duration and the
        algebraic equations.
    name : str
        Declared name; "duration" for the duration of the phase.
    component, size : int
        Index of the component, and number of components.
    fraction : float
        Place in the interval, 0 to 1.
    unit : str
    scale : float
        Ratio of the value in ``unit`` to the value in the program.
    """

    kind: str
    source: tuple[str, int] | None
    name: str
    component: int
    size: int
    fraction: float
    unit: str
    scale: float

    @property
    def component_name(self) -> str:
        """Name, with an index if there are several components."""
        return f"{self.name}[{self.component}]" if self.size > 1 else self.name

    @property
    def description(self) -> str:
        """Kind and name, without the place."""
        return _DESCRIPTIONS[self.kind].format(self.component_name)


@dataclass(frozen=True)
class Label(TableEntry):
    """Description of one row or variable of a program, with phase and interval.

    Attributes
    ----------
    phase : str
    interval : int
        Interval of the mesh; the number of intervals at the last mesh point.
    """

    phase: str
    interval: int

    def __str__(self) -> str:
        return f"{self.description} in phase {self.phase!r}, interval {self.interval + 1}"


@dataclass(frozen=True, eq=False)
class Block:
    """Rows or variables with equal entries in several intervals.

    Attributes
    ----------
    entries : descriptions [K]
    intervals : indices of the intervals [M]
    places : indices in the program [M, K]
    factors : additional scales [M]: value in the program = factor * value / entry scale; None
        stands for one
    """

    entries: tuple[TableEntry, ...]
    intervals: IntArray
    places: IntArray
    factors: FloatArray | None = None


def entries_of(
    phase: Phase, kind: str, item: PathConstraint, fraction: float = 0.0
) -> list[TableEntry]:
    """Return one entry per component of a variable or constraint of a phase."""
    source = next(
        (name, items.index(item)) for name in _LISTS if item in (items := getattr(phase, name))
    )
    return [
        TableEntry(kind, source, item.name, i, item.size, fraction, item.unit, float(item.scale[i]))
        for i in range(item.size)
    ]


def conditions_of(phase: Phase, which: str, node: Sequence[TableEntry]) -> tuple[TableEntry, ...]:
    """Return entries of the conditions at the start ("initial") or end ("final") of a phase."""
    has = [e for e in node if getattr(_item(phase, e), which, None) is not None]
    conditions = (replace(entry, kind=which) for entry in has)
    return tuple(entry for entry in conditions if np.isfinite(_pair(phase, entry)).any())


def limits_of(phase: Phase, entries: Sequence[TableEntry]) -> tuple[FloatArray, FloatArray]:
    """Return declared lower and upper limits of entries, divided by their scales."""
    pairs = np.array([_pair(phase, entry) for entry in entries]).reshape(-1, 2)
    low, high = pairs.T / np.array([entry.scale for entry in entries])
    return low, high


def _item(phase: Phase, entry: TableEntry) -> PathConstraint | None:
    if entry.source is None:
        return None
    name, position = entry.source
    return getattr(phase, name)[position]


def _pair(phase: Phase, entry: TableEntry) -> tuple[float, float]:
    if entry.kind in EQUATIONS:
        return 0.0, 0.0
    if entry.kind in _FREE:
        return -np.inf, np.inf
    item = _item(phase, entry)
    if item is None:
        return phase.duration_bounds
    conditioned = entry.kind in ("initial", "final")
    low, high = getattr(item, entry.kind) if conditioned else (item.lower, item.upper)
    return low[entry.component], high[entry.component]
