"""Limits on a grid denser than the mesh: largest excess, active arcs and their prices."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import ROUNDING, FloatArray
from microbot_ocp._base.interpolants import reads
from microbot_ocp.ocp.problem import Expressions, Phase
from microbot_ocp.ocp.solution import PhaseSolution
from microbot_ocp.ocp.transcription import DURATION, IntArray
from microbot_ocp.ocp.verification._certificate import Arc, OCPLimitUse
from microbot_ocp.ocp.verification._conditions import Point

POINTS = 20  # dense points per interval
NOT_CONTROLS = ("state", "algebraic", "parameter")  # variable shapes that are also a kind
ALONG = ("state", "algebraic", "constraint")  # kinds of limits for which a mesh is refined


@dataclass(frozen=True, eq=False)
class Limited:
    """One component of a limited quantity on a dense grid [M]."""

    kind: str
    name: str
    component: int
    unit: str
    low: float
    high: float
    scale: float
    values: FloatArray
    end: bool = False  # True if the quantity is defined at the end of the phase only

    @property
    def size(self) -> float:
        """Reference of a relative excess: half the range, the limit, or the scale."""
        low, high = self.low, self.high
        if np.isfinite(low) and np.isfinite(high) and high > low:
            return (high - low) / 2
        limit = max((abs(k) for k in (low, high) if np.isfinite(k)), default=0.0)
        return limit if limit > 0 else self.scale

    @property
    def beyond(self) -> FloatArray:
        """Excess over the limits [M]; negative inside, infinite for NaN."""
        beyond = np.maximum(self.low - self.values, self.values - self.high)
        return np.nan_to_num(beyond, nan=np.inf, neginf=-np.inf)


@dataclass(frozen=True, eq=False)
class DensePhase:
    """A phase on its dense grid: both ends of every interval and the points between them."""

    phase: PhaseSolution
    t: FloatArray
    interval: np.ndarray
    limited: list[Limited]


def dense_phase(
    phase: PhaseSolution,
    interpolated: Callable[[IntArray, FloatArray], Mapping[str, FloatArray]] | None = None,
) -> DensePhase:
    """Return a phase with all its limited quantities on a dense grid.

    Parameters
    ----------
    phase : PhaseSolution
    interpolated : callable, optional
        Values [M, size] of all variables in given intervals [M] at given fractions [M]; by default
        the interpolation of the scheme.
    """
    layout = phase.laid_out
    declared = layout.phase
    assert phase.stages is not None
    interpolated = interpolated or partial(layout.interpolated, phase.stages)
    interval, place, t = phase.points(np.linspace(0.0, 1.0, POINTS + 1))
    sampled = interpolated(interval, place)
    limited: list[Limited] = []
    for v in declared.variables:
        kind = v.shape if v.shape in NOT_CONTROLS else "control"
        limited += _limited(kind, v, sampled[v.name])
    duration, bounds = np.array([phase.duration]), declared.duration_bounds
    limited.append(Limited("duration", DURATION, 0, "s", *bounds, 1.0, duration, end=True))
    columns, expressions = {k: v.T for k, v in sampled.items()}, Expressions(declared)
    table = expressions.table(columns, t, phase.duration, phase.rates(interval))
    for kind, limits, rows in (
        ("constraint", declared.constraints, slice(None)),
        ("end constraint", declared.end_constraints, slice(-1, None)),
    ):
        for limit in limits:
            values = expressions.function([limit.expression])(table[:, rows]).full().T
            limited += _limited(kind, limit, values, end=kind != "constraint")
    for terms, rows in _readers(declared, t / phase.duration):
        for name, k, values, low, high in reads(terms, expressions.symbols, table):
            inside = np.where(rows, values, low)
            limited.append(Limited("table", name, k, "", low, high, 1.0, inside))
    return DensePhase(phase, t, interval, limited)


def _readers(phase: Phase, fractions: FloatArray) -> Iterator[tuple[list[ca.MX], np.ndarray]]:
    """Yield the expressions of a phase and a mask of the fractions [M] at which they are used."""
    limits = [k.expression for k in phase.constraints]
    along = [*phase.derivatives.values(), *phase.running_costs, *phase.algebraic_equations]
    yield [*along, *limits], np.ones(fractions.size, bool)
    ends = [k.expression for k in phase.end_constraints]
    yield [*phase.end_costs, *ends], fractions >= fractions[-1]
    for point in (*phase.point_constraints, *phase.point_costs):
        near = np.abs(fractions[:, None] - point.fractions).argmin(axis=0)
        yield [point.expression], np.isin(np.arange(fractions.size), near)


def _limited(kind: str, item: Any, values: FloatArray, end: bool = False) -> Iterator[Limited]:
    """Yield the components of a variable or constraint with values [M, size]."""
    limits = (side.tolist() for side in (item.lower, item.upper, item.scale))
    for i, (low, high, scale, column) in enumerate(zip(*limits, values.T, strict=True)):
        yield Limited(kind, item.name, i, item.unit, low, high, scale, column, end)


def limit_uses(dense: DensePhase) -> list[OCPLimitUse]:
    """Return the largest use of every component that has a limit."""
    uses = []
    for limited in dense.limited:
        low, high, beyond = limited.low, limited.high, limited.beyond
        if not (np.isfinite(low) or np.isfinite(high)):
            continue
        k = int(beyond.argmax())
        value, excess = float(limited.values[k]), max(0.0, float(beyond[k]))
        uses.append(
            OCPLimitUse(
                phase=dense.phase.name,
                name=limited.name,
                component=limited.component,
                kind=limited.kind,
                time=dense.phase.duration if limited.end else float(dense.t[k]),
                value=value,
                limit=low if low - value >= value - high else high,
                unit=limited.unit,
                excess=excess,
                relative=excess / limited.size,
            )
        )
    return uses


def worst_along(uses: Iterable[OCPLimitUse]) -> OCPLimitUse | None:
    """Return the limit of a refinable kind with the largest relative excess, None if all are kept.

    The refinable kinds are states, algebraic variables and path constraints (``ALONG``).
    """
    exceeded = (use for use in uses if use.kind in ALONG and use.excess > 0)
    return max(exceeded, key=lambda use: use.relative, default=None)


def relative_excess(dense: DensePhase) -> FloatArray:
    """Return the largest relative excess over states, algebraic variables and path constraints.

    Array [N, K] over the K dense points of every interval, both ends included; 0 where kept.
    """
    worst = np.zeros(dense.t.size)
    for limited in dense.limited:
        if limited.kind in ALONG:
            np.maximum(worst, limited.beyond / limited.size, out=worst)
    return worst.reshape(-1, POINTS + 1)


class SideRun(NamedTuple):
    """Run of equal entries: indices from ``begin`` up to but excluding ``after``."""

    begin: int
    after: int
    side: int


def runs(sides: np.ndarray) -> list[SideRun]:
    """Return the runs of equal neighbouring entries; rows of a table [N, K] are compared whole."""
    table = sides.reshape(len(sides), -1)
    edges = np.flatnonzero(np.any(np.diff(table, axis=0) != 0, axis=1)) + 1
    pairs = itertools.pairwise([0, *edges.tolist(), len(table)])
    return [SideRun(a, b, int(table[a, 0])) for a, b in pairs]


def arcs_of(phases: Sequence[DensePhase], point: Point, worth: float) -> Iterator[Arc]:
    """Yield the arcs of all phases on which a limit is active and has a price above ``worth``."""
    prices, none = _prices(phases, point), np.zeros((0, 3))
    for dense in phases:
        arcs = []
        for limited in (k for k in dense.limited if not k.end and k.low != k.high):
            key = dense.phase.name, limited.name, limited.component
            acting = _acting(dense, limited, prices.get(key, none))
            arcs += [arc for arc in acting if arc.price * limited.size > worth]
        yield from sorted(arcs, key=lambda arc: (arc.name, arc.component, arc.start))


def _prices(phases: Sequence[DensePhase], point: Point) -> dict[tuple[str, str, int], np.ndarray]:
    """Return rows (fraction, interval, multiplier) [M, 3] of bounds and path constraints.

    Multipliers are in cost per unit of the limited quantity.
    """
    entries: dict[tuple[str, str, int], list[tuple[float, int, float]]] = {}
    layouts = {dense.phase.name: dense.phase.laid_out for dense in phases}
    for label, multiplier in zip(point.labels, point.multipliers, strict=True):
        if label.kind in ("state", "control", "algebraic", "bound", "constraint"):
            points = entries.setdefault((label.phase, label.name, label.component), [])
            place = layouts[label.phase].place_of(label)
            points.append((place, label.interval, multiplier / label.scale))
    return {key: np.array(points, dtype=float) for key, points in entries.items()}


ACTIVE = 1e-4  # distance below which a limit is active, relative to its size
NEARLY_ACTIVE = 1e-2  # distance below which it is active if its multiplier is larger


def _acting(dense: DensePhase, limited: Limited, prices: np.ndarray) -> Iterator[Arc]:
    """Yield the arcs of a phase on which one limit is active, with their prices."""
    phase, size = dense.phase, limited.size
    # Multipliers stand at mesh points, arcs end at dense points: match them up to one dense step.
    reach = ROUNDING + float(np.diff(phase.mesh).max()) / POINTS
    for side, limit, sign in (("lower", limited.low, -1.0), ("upper", limited.high, 1.0)):
        if not np.isfinite(limit):
            continue
        slack = sign * (limit - limited.values) / size
        push = np.maximum(sign * prices[:, 2], 0.0)
        strength = np.zeros(phase.mesh.size)
        np.maximum.at(strength, prices[:, 1].astype(int), push * size)
        # Complementarity: a limit is active if its slack is zero, or smaller than its multiplier.
        active = slack <= ACTIVE
        active |= (slack <= NEARLY_ACTIVE) & (strength[dense.interval] > slack)
        for first, last in _joined_runs(dense, active):
            start, end = float(dense.t[first]), float(dense.t[last])
            near = prices[:, 0] >= start / phase.duration - reach
            limit_of = phase.name, limited.kind, limited.name, limited.component, side
            yield Arc(*limit_of, start, end, float(push[near].sum()), limited.unit)


def _joined_runs(dense: DensePhase, active: np.ndarray) -> list[tuple[int, int]]:
    """Return first and last index of runs of true values, joining runs less than an interval apart.

    A limit that is kept at a few points per interval leaves it slightly between them.
    """
    steps = np.diff(dense.phase.t)
    joined: list[tuple[int, int]] = []
    for first, after, acts in runs(active):
        begin, end = joined[-1] if joined else (0, 0)
        if not acts:
            continue
        if joined and dense.t[first] - dense.t[end] < (1 - ROUNDING) * steps[dense.interval[end]]:
            joined[-1] = (begin, after - 1)
        else:
            joined.append((first, after - 1))
    return joined
