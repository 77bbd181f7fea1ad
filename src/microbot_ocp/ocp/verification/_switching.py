"""Switching structure: which limit is active when, and what relaxing it is worth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.ocp.transcription import Label, PhaseLayout
from microbot_ocp.ocp.verification._certificate import Arc
from microbot_ocp.ocp.verification._limits import POINTS, DensePhase


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


class Prices:
    """Multipliers of bounds and path constraints by phase and name, in cost per unit."""

    def __init__(
        self, layouts: Sequence[PhaseLayout], labels: Sequence[Label], multipliers: FloatArray
    ) -> None:
        self.entries: dict[tuple[str, str, int], list[tuple[float, int, float]]] = {}
        by_name = {layout.phase.name: layout for layout in layouts}
        for label, multiplier in zip(labels, multipliers, strict=True):
            if label.kind in ("state", "control", "algebraic", "bound", "constraint"):
                own = self.entries.setdefault((label.phase, label.name, label.component), [])
                place = by_name[label.phase].place_of(label)
                own.append((place, label.interval, multiplier / label.scale))

    def of(self, phase: str, name: str, component: int) -> np.ndarray:
        """Place, interval and multiplier [M, 3]."""
        return np.array(self.entries.get((phase, name, component), []), dtype=float).reshape(-1, 3)


def arcs_of(dense: DensePhase, prices: Prices, worth: float) -> list[Arc]:
    """Stretches of a phase during which a limit acts and is worth something."""
    phase = dense.phase
    arcs = []
    for limited in dense.limited:
        for i in range(0 if limited.end else limited.lower.size):
            low, high = float(limited.lower[i]), float(limited.upper[i])
            if low == high:
                continue
            size = limited.size(i)
            own = prices.of(phase.name, limited.name, i)
            for side, limit, sign in (("lower", low, -1.0), ("upper", high, 1.0)):
                if not np.isfinite(limit):
                    continue
                slack = sign * (limit - limited.values[:, i]) / size
                push = np.maximum(sign * own[:, 2], 0.0)
                strength = np.zeros(phase.mesh.size)
                np.maximum.at(strength, own[:, 1].astype(int), push * size)
                active = slack <= THRESHOLDS.active
                active |= (slack <= THRESHOLDS.nearly_active) & (strength[dense.interval] > slack)
                for first, last in _joined_runs(dense, active):
                    start, end = float(dense.t[first]), float(dense.t[last])
                    # to the nearest dense point, as the multipliers stand at points of the mesh
                    reach = 1e-9 + float(np.diff(phase.mesh).max()) / POINTS
                    near = own[:, 0] >= start / phase.duration - reach
                    near &= own[:, 0] <= end / phase.duration + reach
                    price = float(push[near].sum())
                    if price * size > worth:
                        arcs.append(
                            Arc(
                                phase.name,
                                limited.kind,
                                limited.name,
                                i,
                                side,
                                start,
                                end,
                                price,
                                limited.unit,
                            )
                        )
    return sorted(arcs, key=lambda arc: (arc.name, arc.component, arc.start))


def _joined_runs(dense: DensePhase, active: np.ndarray) -> list[tuple[int, int]]:
    """Runs of true values; those that are less than an interval apart are one.

    A limit that is kept at a few points of every interval leaves it a little between them.
    """
    steps = np.diff(dense.phase.t)
    joined: list[tuple[int, int]] = []
    for first, last in _runs(active):
        if joined:
            begin, end = joined[-1]
            if dense.t[first] - dense.t[end] < (1 - 1e-6) * steps[dense.interval[end]]:
                joined[-1] = (begin, last)
                continue
        joined.append((first, last))
    return joined


def _runs(active: np.ndarray) -> list[tuple[int, int]]:
    """First and last index of every run of true values."""
    change = np.diff(np.concatenate([[0], active.astype(int), [0]]))
    ends = np.flatnonzero(change < 0) - 1
    return list(zip(np.flatnonzero(change > 0).tolist(), ends.tolist(), strict=True))
