"""Switching structure: which limit is active when, and what relaxing it is worth."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.ocp.transcription import Label
from microbot_ocp.ocp.verification._certificate import Arc
from microbot_ocp.ocp.verification._limits import POINTS, DensePhase, Limited
from microbot_ocp.ocp.verification._reintegration import phase_layout


@dataclass(frozen=True)
class ArcThresholds:
    """When a limit counts as active.

    Attributes
    ----------
    active : share of the size of a limit: nearer it is active
    nearly_active : the same where its multiplier is large enough
    worthless : share of the cost: a limit that is worth less over an arc does not act there
    """

    active: float = 1e-4
    nearly_active: float = 1e-2
    worthless: float = 1e-4


THRESHOLDS = ArcThresholds()


class SideRun(NamedTuple):
    """Entries from ``begin`` until before ``after`` with one side."""

    begin: int
    after: int
    side: int


def runs(sides: np.ndarray) -> list[SideRun]:
    """Join neighbouring entries that have a side in common; of rows [N, K], all sides."""
    table = sides.reshape(len(sides), -1)
    edges = np.flatnonzero(np.any(np.diff(table, axis=0) != 0, axis=1)) + 1
    pairs = itertools.pairwise([0, *edges.tolist(), len(table)])
    return [SideRun(a, b, int(table[a, 0])) for a, b in pairs]


def arcs_of(
    phases: Sequence[DensePhase], labels: Sequence[Label], multipliers: FloatArray, worth: float
) -> Iterator[Arc]:
    """Yield stretches of the phases during which a limit acts and is worth something."""
    prices = _prices(phases, labels, multipliers)
    none = np.zeros((0, 3))
    for dense in phases:
        arcs = [
            arc
            for limited in dense.limited
            for i in range(0 if limited.end else limited.lower.size)
            if limited.lower[i] != limited.upper[i]
            for arc in _acting(
                dense, limited, i, prices.get((dense.phase.name, limited.name, i), none)
            )
            if arc.price * limited.size(i) > worth
        ]
        yield from sorted(arcs, key=lambda arc: (arc.name, arc.component, arc.start))


def _prices(
    phases: Sequence[DensePhase], labels: Sequence[Label], multipliers: FloatArray
) -> dict[tuple[str, str, int], np.ndarray]:
    """Return the place, interval and multiplier [M, 3] of bounds and path constraints, in cost per
    unit.
    """
    entries: dict[tuple[str, str, int], list[tuple[float, int, float]]] = {}
    layouts = {dense.phase.name: phase_layout(dense.phase) for dense in phases}
    for label, multiplier in zip(labels, multipliers, strict=True):
        if label.kind in ("state", "control", "algebraic", "bound", "constraint"):
            points = entries.setdefault((label.phase, label.name, label.component), [])
            place = layouts[label.phase].place_of(label)
            points.append((place, label.interval, multiplier / label.scale))
    return {key: np.array(points, dtype=float) for key, points in entries.items()}


def _acting(dense: DensePhase, limited: Limited, i: int, prices: np.ndarray) -> Iterator[Arc]:
    """Yield stretches of a phase during which a component of a limit acts, and what each is
    worth.
    """
    phase, size = dense.phase, limited.size(i)
    # to the nearest dense point, as the multipliers stand at points of the mesh
    reach = 1e-9 + float(np.diff(phase.mesh).max()) / POINTS
    for side, limit, sign in (("lower", limited.lower[i], -1.0), ("upper", limited.upper[i], 1.0)):
        if not np.isfinite(limit):
            continue
        slack = sign * (limit - limited.values[:, i]) / size
        push = np.maximum(sign * prices[:, 2], 0.0)
        strength = np.zeros(phase.mesh.size)
        np.maximum.at(strength, prices[:, 1].astype(int), push * size)
        active = slack <= THRESHOLDS.active
        active |= (slack <= THRESHOLDS.nearly_active) & (strength[dense.interval] > slack)
        for first, last in _joined_runs(dense, active):
            start, end = float(dense.t[first]), float(dense.t[last])
            near = prices[:, 0] >= start / phase.duration - reach
            near &= prices[:, 0] <= end / phase.duration + reach
            what = phase.name, limited.kind, limited.name, i, side, start, end
            yield Arc(*what, float(push[near].sum()), limited.unit)


def _joined_runs(dense: DensePhase, active: np.ndarray) -> list[tuple[int, int]]:
    """Return first and last of runs of true values; those less than an interval apart are one.

    A limit that is kept at a few points of every interval leaves it a little between them.
    """
    steps = np.diff(dense.phase.t)
    joined: list[tuple[int, int]] = []
    for first, after, acts in runs(active):
        begin, end = joined[-1] if joined else (0, 0)
        if not acts:
            continue
        if joined and dense.t[first] - dense.t[end] < (1 - 1e-6) * steps[dense.interval[end]]:
            joined[-1] = (begin, after - 1)
        else:
            joined.append((first, after - 1))
    return joined
