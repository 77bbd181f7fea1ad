"""What the multipliers of a solve say about its data: how the duration changes with each bound.

A bound that gives way by d changes the cost by its multiplier times d: the envelope theorem. The
cost is the duration but for what smooths it, which is a hundred-thousandth of it.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from typing import Any

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.limits import JOINT_QUANTITIES, LimitFamily, MotionSamples
from microbot_ocp.ocp import PhaseSolution, Solution
from microbot_ocp.ocp.transcription import TableEntry

KEYS = {quantity.name: key for key, quantity in JOINT_QUANTITIES.items()}
DIGITS = 8  # significant ones: what is written with every motion


def multipliers_of(solution: Solution, family: LimitFamily) -> dict[str, Any] | None:
    """Return slopes of the duration of a motion by the limits of a family, as plain values.

    Distances that a search adds to them, other ones in every segment, have none.

    Returns
    -------
    dict or None
        "lower" and "upper" have s per unit of each bound by the key of its limit, "via" [m][n]
        s/rad (s/m) of the via points. "rows" has by key the times "t", s, and what the duration
        gains "slopes" [K][k] for each unit that the quantity is larger there. "beside" is what a
        datum may change beside the duration, s: the smoothing of the squared jerk, by the fifth
        power of a time that scales, and what the solver left. None where the solver gave no
        multipliers, and of a solution without a program.
    """
    if solution.variable_multipliers is None or any(p.layout is None for p in solution.phases):
        return None
    sides: dict[str, dict[str, FloatArray]] = {"lower": {}, "upper": {}}
    via: dict[int, dict[int, float]] = defaultdict(dict)
    rows: dict[str, dict[float, FloatArray]] = defaultdict(dict)
    start = 0.0
    for number, phase in enumerate(solution.phases):
        for entry, times, multipliers in _bounds(solution, phase):
            name, _, side = entry.name.partition(", ")  # "tool speed, upper limit": one that varies
            key = KEYS.get(name, name.replace(" ", "_"))
            slopes = (-1.0 if side.startswith("lower") else 1.0) * multipliers / entry.scale
            if entry.kind in ("initial", "final"):
                if key == "q":
                    at = number + (entry.kind == "final")
                    via[at][entry.component] = -float(slopes.sum())
                continue
            if key not in family:
                continue
            for side, sign in (("lower", -1.0), ("upper", 1.0)):
                amounts = sides[side].setdefault(key, np.zeros(entry.size))
                amounts[entry.component] -= slopes[sign * slopes > 0].sum()
            for t, slope in zip((start + times).tolist(), slopes, strict=True):
                rows[key].setdefault(t, np.zeros(entry.size))[entry.component] += slope
        start += phase.duration
    count = solution.phases[0]["q"].shape[1]
    points = np.array([[via[k].get(j, 0.0) for j in range(count)] for k in sorted(via)])
    limited = {key: row for key, row in rows.items() if key not in MotionSamples._fields}
    return {
        **_plain(sides),
        "via": _plain(points),
        "beside": 5 * abs(solution.cost - start) + abs(solution.gap.slack),
        "rows": {
            key: {"t": sorted(row), "slopes": _plain(np.array([row[t] for t in sorted(row)]))}
            for key, row in limited.items()
        },
    }


def _bounds(
    solution: Solution, phase: PhaseSolution
) -> Iterator[tuple[TableEntry, FloatArray, FloatArray]]:
    """Yield every bounded row and variable of a phase, with times [M], s, and multipliers [M]."""
    layout = phase.layout
    assert layout is not None
    assert solution.variable_multipliers is not None
    kinds = {"state", "control", "bound", "constraint", "initial", "final"}
    for blocks, multipliers in (
        (layout.variables, solution.variable_multipliers),
        (layout.rows, solution.row_multipliers),
    ):
        for block in blocks:
            for column, entry in enumerate(block.entries):
                if entry.kind not in kinds:
                    continue
                last = np.minimum(block.intervals, layout.mesh.size - 2)
                share = np.where(block.intervals > last, 1.0, entry.fraction)
                step = np.diff(layout.mesh)[last]
                times = (layout.mesh[last] + share * step) * phase.duration
                yield entry, times, multipliers[block.places[:, column]]


def _plain(values: Any) -> Any:
    """Return nested lists of numbers with so many digits as they are known to."""
    if isinstance(values, dict):
        return {key: _plain(entry) for key, entry in values.items()}
    if values.ndim > 1:
        return [_plain(row) for row in values]
    return [float(f"{value:.{DIGITS}g}") for value in values]
