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
from microbot_ocp.limits import JOINT_QUANTITIES
from microbot_ocp.ocp import PhaseSolution, Solution
from microbot_ocp.ocp.transcription import TableEntry

KEYS = {quantity.name: key for key, quantity in JOINT_QUANTITIES.items()}
DIGITS = 8  # significant ones: what is written with every motion


def multipliers_of(solution: Solution) -> dict[str, Any] | None:
    """Slopes of the duration of a motion, as plain values.

    Returns
    -------
    dict or None
        "lower" and "upper" have s per unit of each bound by the key of its limit, "via" [m][n]
        s/rad (s/m) of the via points. "torques" has times "t", s, and what the duration gains
        "slopes" [K][n] for each N m (N) that a torque is larger there. None where the solver gave
        no multipliers, and of a solution without a program.
    """
    if solution.variable_multipliers is None or any(p.layout is None for p in solution.phases):
        return None
    sides: dict[str, dict[str, FloatArray]] = {"lower": {}, "upper": {}}
    via: dict[int, dict[int, float]] = defaultdict(dict)
    torques: list[tuple[float, dict[int, float]]] = []
    start = 0.0
    for number, phase in enumerate(solution.phases):
        for entry, times, slopes in _bounds(solution, phase):
            key = KEYS.get(entry.name, entry.name.replace(" ", "_"))
            if entry.kind in ("initial", "final"):
                if key == "q":
                    at = number + (entry.kind == "final")
                    via[at][entry.component] = -float(slopes.sum())
                continue
            for side, sign in (("lower", -1.0), ("upper", 1.0)):
                own = sides[side].setdefault(key, np.zeros(entry.size))
                own[entry.component] -= slopes[sign * slopes > 0].sum()
            if key == "tau":
                torques += [
                    (start + float(t), {entry.component: float(slope)})
                    for t, slope in zip(times, slopes, strict=True)
                ]
        start += phase.duration
    count = solution.phases[0]["q"].shape[1]
    rows: dict[float, FloatArray] = defaultdict(lambda: np.zeros(count))
    for t, slope in torques:
        for joint, value in slope.items():
            rows[t][joint] += value
    points = [[via[k].get(j, 0.0) for j in range(count)] for k in sorted(via)]
    return {
        **{side: {key: _plain(own) for key, own in keys.items()} for side, keys in sides.items()},
        "via": _plain(np.array(points)),
        "torques": {
            "t": sorted(rows),
            "slopes": [_plain(rows[t]) for t in sorted(rows)],
        },
    }


def _bounds(
    solution: Solution, phase: PhaseSolution
) -> Iterator[tuple[TableEntry, FloatArray, FloatArray]]:
    """Every bounded row and variable of a phase, with times [M], s, and multipliers [M]."""
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
                yield entry, times, multipliers[block.places[:, column]] / entry.scale


def _plain(values: FloatArray) -> Any:
    """Nested lists of numbers with so many digits as they are known to."""
    if values.ndim > 1:
        return [_plain(row) for row in values]
    return [float(f"{value:.{DIGITS}g}") for value in values]
