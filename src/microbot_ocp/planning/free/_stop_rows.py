"""Conditions on the tool's pose or velocity at via points, and cycles, as rows of a flat program.

Position, velocity and acceleration at via points are unknowns: these rows depend on few of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.planning.free._spline import IntArray, SplineLayout
from microbot_ocp.planning.task import Bounds, Conditions, Row


@dataclass(frozen=True, eq=False)
class StopRow:
    """A condition at a via point, or on both ends of a cycle.

    Attributes
    ----------
    name : str
    node : int
        Index of the via point; of the last one for a cycle.
    value : callable
        Expression [r] of the unknowns in ``columns``.
    bounds : (lower, upper)
    numbers : array of int [r]
        Indices of the rows.
    columns : array of int [c]
        Indices of the unknowns: position and velocity at a via point, or one quantity at both ends.
    """

    name: str
    node: int
    value: Callable[[Any], Any]
    bounds: Bounds
    numbers: IntArray
    columns: IntArray

    @cached_property
    def _functions(self) -> tuple[ca.Function, ca.Function]:
        given, weights = ca.SX.sym("x", self.columns.size), ca.SX.sym("w", self.numbers.size)
        value: Any = ca.SX(self.value(given))
        slopes = ca.densify(ca.jacobian(value, given))
        curvature = ca.densify(ca.hessian(ca.dot(weights, value), given)[0])
        return (
            ca.Function("condition", [given], [ca.densify(value), slopes]),
            ca.Function("condition_curve", [given, weights], [curvature]),
        )

    def slopes(self, unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the values [r], and their slopes [r,c] by the unknowns in ``columns``."""
        values, slopes = self._functions[0](unknowns[self.columns])
        return np.array(values)[:, 0], np.array(slopes)

    def curvature(self, unknowns: FloatArray, weights: FloatArray) -> FloatArray:
        """Return the second derivatives [c,c] of the sum with weights [r]."""
        return np.array(self._functions[1](unknowns[self.columns], weights))


def stop_rows(layout: SplineLayout, conditions: Conditions, height: int) -> tuple[StopRow, ...]:
    """Return the conditions at all via points and of a cycle; their rows begin at ``height``."""
    steps, rows = np.arange(layout.count), list[StopRow]()

    def add(name: str, node: int, value: Any, bounds: Bounds, columns: list[IntArray]) -> None:
        first = height if not rows else int(rows[-1].numbers[-1]) + 1
        numbers = first + np.arange(np.broadcast(*bounds).size)
        rows.append(StopRow(name, node, value, bounds, numbers, np.concatenate(columns)))

    for node, ((q, v, *_), end) in enumerate(zip(layout.nodes, conditions.ends, strict=True)):
        for row in end.rows:
            add(row.name, node, partial(_of_state, row), row.bounds, [q + steps, v + steps])
    (q, v, _, a), (last_q, last_v, last_a, _) = layout.nodes[0], layout.nodes[-1]
    ends = {"q": (q, last_q), "qd": (v, last_v), "qdd": (a, last_a)}
    still = np.zeros(layout.count)
    for key in conditions.closed:
        columns = [at + steps for at in ends[key]]
        add(f"{key} of the cycle", len(layout.nodes) - 1, _change, (still, still), columns)
    return tuple(rows)


def _of_state(row: Row, state: Any) -> Any:
    return row.expression(*ca.vertsplit(state, state.shape[0] // 2))


def _change(ends: Any) -> Any:
    first, last = ca.vertsplit(ends, ends.shape[0] // 2)
    return last - first
