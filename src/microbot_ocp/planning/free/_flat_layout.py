"""One phase of a flat program: its motion, and the names of its rows and unknowns."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.limits import LimitFamily
from microbot_ocp.ocp import Phase, PhaseSolution
from microbot_ocp.ocp.transcription import Block, Label, TableEntry
from microbot_ocp.planning.free._flat_rows import POINT_KEYS, FlatRows, Scales
from microbot_ocp.planning.free._point_limits import ORDERS
from microbot_ocp.planning.free._spline import IntArray, SplineLayout


@dataclass(frozen=True, eq=False)
class FlatLayout:
    """One phase of a flat program.

    Attributes
    ----------
    phase : Phase
    mesh : array [N+1]
    index : int
        Index of the phase.
    rows_of_all : FlatRows
    scales : Scales
    family : LimitFamily
    start : array [n]
        Position to which the coefficients of the phase are relative, rad (m).
    fixed : array of bool
        Mask of the program's unknowns that are given by conditions.
    """

    phase: Phase
    mesh: FloatArray
    index: int
    rows_of_all: FlatRows
    scales: Scales
    family: LimitFamily
    start: FloatArray
    fixed: np.ndarray

    @property
    def intervals(self) -> int:
        """Number of intervals."""
        return self.mesh.size - 1

    @property
    def stage_sizes(self) -> tuple[IntArray, IntArray, IntArray]:
        """Empty arrays, because the program has no stages with equations."""
        return np.zeros(0, dtype=int), np.zeros(0, dtype=int), np.zeros(0, dtype=int)

    def place_of(self, label: Label) -> float:
        """Return the place of a row or variable of the phase, as a fraction of the phase."""
        if label.interval == self.intervals:
            return 1.0
        start, end = self.mesh[label.interval : label.interval + 2]
        return float(start + label.fraction * (end - start))

    def unpacked(self, x: FloatArray) -> PhaseSolution:
        """Return the motion of the phase at its mesh points."""
        layout, unknowns = self.rows_of_all.layout, x * self.scales.unknowns
        duration = float(unknowns[layout.durations][self.index])
        q = _sampled(layout, self.index, unknowns, duration, self.start)
        values: dict[str, FloatArray] = dict(zip(POINT_KEYS, q, strict=True))
        stages = np.hstack([*q, np.full((self.mesh.size, 1), duration)])
        return PhaseSolution(self.phase.name, duration, self.mesh, values, self, stages)  # type: ignore[arg-type]

    def interpolated(
        self, stages: FloatArray, k: IntArray, share: FloatArray
    ) -> dict[str, FloatArray]:
        """Return the motion at shares [M] of intervals, from the stages [N+1,3n+1]."""
        parts = np.split(stages[:, :-1], ORDERS, axis=1)
        motion: dict[str, FloatArray] = dict(zip(POINT_KEYS, parts, strict=True))
        phase = PhaseSolution("", float(stages[0, -1]), self.mesh, motion)
        at = self.mesh[k] + share * np.diff(self.mesh)[k]
        return dict(zip(POINT_KEYS, resampled(phase, at), strict=True))

    # tables ---------------------------------------------------------------------------------------

    @cached_property
    def _points(self) -> slice:
        first = sum(2 * mesh.size - 1 for mesh in self.rows_of_all.layout.meshes[: self.index])
        return slice(first, first + 2 * self.mesh.size - 1)

    @cached_property
    def rows(self) -> tuple[Block, ...]:
        """Blocks of rows: at mesh points first, in the middles of intervals second."""
        rows, family, scales = self.rows_of_all, self.family, self.scales
        n, limits = rows.layout.count, rows.limits[self.index]

        def of_joints(kind: str, name: str, key: str, scale: FloatArray, joints: Any) -> Any:
            unit = family.robot.unit
            return [
                TableEntry(kind, None, name, k, n, 0.0, unit(key, k), float(scale[k]))
                for k in joints
            ]

        of_limits, sizes = [], Counter(key for key, *_ in limits.names)
        for (key, k, side), scale in zip(limits.names, limits.scale.tolist(), strict=True):
            name, unit = (family[key].name, family[key].units[k]) if key in family else (key, "")
            name = f"{name}, {side} limit" if side else name
            entry = TableEntry("constraint", None, name, k, sizes[key], 0.0, unit, scale)
            of_limits.append(entry)
        of_motion = [
            entry
            for key, scale in zip(POINT_KEYS, scales.motion, strict=True)
            for entry in of_joints("bound", key, key, scale, range(n))
        ]
        torques = [limits.names[row][1] for row in rows.torques]
        of_rates = of_joints("constraint", "torque rate", "taud", scales.rate, torques)
        of_jerks = of_joints("constraint", "jerk", "qddd", scales.jerk, range(n))
        blocks = []
        for numbers, entries, factors in (
            (rows.at_points[:, : len(of_limits)], of_limits, None),
            (rows.of_motion.reshape(-1, ORDERS * n), of_motion, None),
            (rows.of_rates, of_rates, rows.lengths() * scales.durations[self.index]),
            (rows.of_jerks, of_jerks, None),
        ):
            for step, fraction in ((0, 0.0), (1, 0.5)):
                at = slice(self._points.start + step, self._points.stop, 2)
                given = None if factors is None else factors[at]
                blocks += _blocks(numbers[at], entries, fraction, given)
        # A condition belongs to the phase that begins at its via point; the last, to its end.
        places = {self.index: ("point", 0)}
        if self.index + 1 == len(rows.limits):
            places[self.index + 1] = "end", self.intervals
        for stop in (stop for stop in rows.at_stops if stop.node in places):
            kind, interval = places[stop.node]
            entries = tuple(
                TableEntry(kind, None, stop.name, k, stop.numbers.size, 0.0, "", 1.0)
                for k in range(stop.numbers.size)
            )
            blocks.append(Block(entries, np.array([interval]), stop.numbers[None]))
        return tuple(blocks)

    @cached_property
    def variables(self) -> tuple[Block, ...]:
        """Blocks of unknowns: at the via points of the phase, coefficients, and the duration."""
        layout, n = self.rows_of_all.layout, self.rows_of_all.layout.count
        robot, index = self.family.robot, self.index
        last = index == len(layout.meshes) - 1

        def entry(kind: str, key: str, k: int, at: int, fraction: float = 0.0) -> TableEntry:
            if kind in ("state", "control") and self.fixed[at]:
                kind = "initial"  # a fixed value is a condition, not a limit
            unit, scale = robot.unit(key, k), float(self.scales.unknowns[at])
            return TableEntry(kind, None, key, k, n, fraction, unit, scale)

        blocks = []
        ends = [(0, layout.nodes[index], "initial")]
        ends += [(self.intervals, layout.nodes[index + 1], "final")] if last else []
        for interval, (q, v, before, after), kind in ends:
            a = before if kind == "final" else after
            # Names are those of the program with states, so that advice and slopes read alike.
            parts = [(kind, "q", q), ("state", "qd", v), ("control", "qdd", a)]
            # A via point with a jump has two accelerations, one for each side.
            if before != after and index > 0:
                parts.append(("control", "qdd", before))
            for kind_of, key, start in parts:
                places = start + np.arange(n)
                entries = tuple(entry(kind_of, key, k, at) for k, at in enumerate(places.tolist()))
                blocks.append(Block(entries, np.array([interval]), places[None]))
        inner = layout.inner[index]
        if inner.stop > inner.start:
            places = np.arange(inner.start, inner.stop).reshape(-1, n)
            entries = tuple(
                entry("coefficient", "q", k, at) for k, at in enumerate(places[0].tolist())
            )
            blocks.append(Block(entries, 1 + np.arange(len(places)), places))
        at = layout.durations.start + index
        duration = TableEntry(
            "duration", None, "duration", 0, 1, 0.0, "s", float(self.scales.unknowns[at])
        )
        blocks.append(Block((duration,), np.array([0]), np.array([[at]])))
        return tuple(blocks)


def _blocks(
    numbers: IntArray, entries: Sequence[TableEntry], fraction: float, factors: FloatArray | None
) -> Iterator[Block]:
    """Yield blocks of the existing rows of [M,K]; rows of the same intervals form one block."""
    patterns: dict[bytes, list[int]] = {}
    for k in range(len(entries)):
        there = numbers[:, k] >= 0
        if there.any():
            patterns.setdefault(there.tobytes(), []).append(k)
    for pattern, columns in patterns.items():
        intervals = np.flatnonzero(np.frombuffer(pattern, dtype=bool))
        table = tuple(replace(entries[k], fraction=fraction) for k in columns)
        given = None if factors is None else factors[intervals]
        yield Block(table, intervals, numbers[intervals][:, columns], given)


def _sampled(
    layout: SplineLayout, index: int, unknowns: FloatArray, T: float, start: FloatArray
) -> FloatArray:
    """Return position, velocity and acceleration [3,N+1,n] at the mesh points of a phase."""
    n, mesh = layout.count, layout.meshes[index]
    q = np.zeros((ORDERS, mesh.size, n))
    first = sum(2 * m.size - 1 for m in layout.meshes[:index])
    for windows in layout.every:
        mine = windows.phase == index
        if not mine.any():
            continue
        place = 0 if windows.is_interval else 2
        u = unknowns[windows.columns[mine][..., None] + np.arange(n)]
        u = u - windows.anchored[mine][..., None] * start
        exponents = windows.powers[mine][:, None] - np.arange(ORDERS)[:, None]
        # Equation (2) of docs/theory/flat.md.
        y = (windows.weights[mine, place] * T**exponents) @ u
        q[:, (windows.points[mine, place] - first) // 2] = y.swapaxes(0, 1)
    q[0] += start
    return q


def resampled(phase: PhaseSolution, mesh: FloatArray) -> FloatArray:
    """Return the motion [3,N+1,n] of a phase at the points of another mesh.

    In an interval the jerk is constant, so position, velocity and acceleration are polynomials.
    """
    q, qd, qdd = (phase[key] for key in POINT_KEYS)
    t, T = phase.t, phase.duration
    k = np.clip(np.searchsorted(phase.mesh, mesh, side="right") - 1, 0, phase.mesh.size - 2)
    h = (mesh - phase.mesh[k])[:, None] * T
    jerk = (np.diff(qdd, axis=0) / np.diff(t)[:, None])[k]
    a = qdd[k] + h * jerk
    v = qd[k] + h * (qdd[k] + 0.5 * h * jerk)
    p = q[k] + h * (qd[k] + h * (0.5 * qdd[k] + h * jerk / 6.0))
    return np.array([p, v, a])
