"""Search for the largest box of accelerations, between an upper and a lower bound of its scale.

A state at which a torque exceeds its limit bounds the scale of the box from above; random search
finds such states. Branch and bound over positions and speeds proves a scale from below.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import ROUNDING, FloatArray
from microbot_ocp.acceleration._demand import Boxes, Demand, States, joined, taken
from microbot_ocp.acceleration._region import PositionRegion

BATCH = 1000  # Boxes are split in batches: one call evaluates all halves.
SAMPLES = 2000  # Each demand (joint, side and payload) starts with this many random states.
# Local search keeps this many states and tries this many neighbours of each.
BEST_STATES, NEIGHBOURS = 8, 24
ROUNDS = 14  # Each round of local search narrows the neighbourhood to two thirds.
CUTS, FOUND = 40, 1e-3  # Most rounds of cutting planes, and the violation that ends them.
PLANES = 10  # Each step of the product problem adds this many planes for each joint.


@dataclass(frozen=True, eq=False)
class CriticalState:
    """State that exceeds a torque once a box of accelerations is larger than ``scale`` times it.

    Attributes
    ----------
    scale : float
        Scale of the box at which the torque is used up.
    demand : Demand
        Torque demand that reaches its limit.
    states : States
        Known states of the demand.
    row : int
        Index of the state in ``states``.
    """

    scale: float
    demand: Demand
    states: States
    row: int


@dataclass(frozen=True, eq=False)
class KnownStates:
    """Known states of every demand, each an upper bound of the box of accelerations."""

    demands: tuple[Demand, ...]
    states: tuple[States, ...]

    def worst(self, box: FloatArray) -> CriticalState:
        """Return the state with the smallest scale of this box [n] of accelerations."""
        each = [states.scale(box) for states in self.states]
        k = int(np.argmin([scales.min(initial=np.inf) for scales in each]))
        row = int(each[k].argmin())
        return CriticalState(float(each[k][row]), self.demands[k], self.states[k], row)

    def with_states(self, index: int, states: States) -> KnownStates:
        """Add states of one demand."""
        every = [*self.states]
        every[index] = joined([every[index], states])
        return KnownStates(self.demands, tuple(every))


def sampled_states(
    demands: Sequence[Demand], region: PositionRegion, rng: np.random.Generator
) -> KnownStates:
    """Sample random positions of a region, and return the worst states there for all demands."""
    q = region.drawn(SAMPLES, rng)
    return KnownStates(tuple(demands), tuple(demand.states_at(q) for demand in demands))


def with_local_search(
    known: KnownStates, box: FloatArray, region: PositionRegion, rng: np.random.Generator
) -> KnownStates:
    """Add states that a local random search finds, with smaller scales of this box [n]."""
    least = known.worst(box).scale
    for index, demand in enumerate(known.demands):
        scales = known.states[index].scale(box)
        if not scales.size or scales.min() > 2.0 * max(least, 0.0):
            continue
        best = taken(known.states[index], np.argsort(scales)[:BEST_STATES])
        width = np.ptp(np.stack([region.boxes.low.min(axis=0), region.boxes.high.max(axis=0)]), 0)
        for halving in range(ROUNDS):
            step = 0.5 * width * (2 / 3) ** halving
            q = np.repeat(best.q, NEIGHBOURS, axis=0)
            q = q + step * rng.uniform(-1.0, 1.0, q.shape) * (rng.random(q.shape) < 0.5)
            q = _moved_inside(q, region)
            if len(q):
                best = joined([best, demand.states_at(q)])
            best = taken(best, np.argsort(best.scale(box))[:BEST_STATES])
        known = known.with_states(index, best)
        least = min(least, float(best.scale(box).min()))
    return known


def _moved_inside(q: FloatArray, region: PositionRegion) -> FloatArray:
    """Move positions [B,n] into the nearest box of a region; drop those still outside of it."""
    if len(region.boxes.low) == 1:
        q = np.clip(q, region.boxes.low, region.boxes.high)
    else:
        clipped = np.clip(q[:, None], region.boxes.low, region.boxes.high)
        nearest = np.linalg.norm(clipped - q[:, None], axis=2).argmin(axis=1)
        q = clipped[np.arange(len(q)), nearest]
    return q[region.inside(q)]


class BoxProof(NamedTuple):
    """Proved scale of a box of accelerations.

    Attributes
    ----------
    scale : float
        Scale of the box within which no state of the region exceeds a torque.
    known : KnownStates
        Known states, with those found during the proof.
    count : int
        Number of boxes of positions and speeds that the proof evaluated.
    done : bool
        True if the gap is as small as required.
    """

    scale: float
    known: KnownStates
    count: int
    done: bool


def prove(
    known: KnownStates, box: FloatArray, region: PositionRegion, gap: float, most: int
) -> BoxProof:
    """Prove a scale of a box [n] of accelerations by branch and bound.

    Boxes of positions and speeds with the lowest bound are split first. The proof ends once the
    lowest bound is within ``gap`` of the smallest scale of a known state, after ``most`` boxes, or
    at the deadline.
    """
    # Invariant: min(lowest bound of all fronts, settled) <= true scale <= broken. Settled is the
    # lowest bound of the boxes that are good enough and no longer stored.
    broken = known.worst(box).scale
    fronts = []
    keep, across = region.across(region.boxes)
    positions = taken(region.boxes, keep)
    for demand in known.demands:
        low, high = (np.tile(end, (len(positions.low), 1)) for end in demand.all_shares)
        boxes = Boxes(np.hstack([positions.low, low]), np.hstack([positions.high, high]))
        bounds = demand.bounds(boxes, box, broken)
        weights = bounds.weights / demand.limit
        weights[:, : box.size] += across[keep]
        fronts.append(OpenBoxes(bounds.scale, boxes, weights))
    count, settled = sum(front.scales.size for front in fronts), np.inf
    while True:
        lowest = [front.scales.min(initial=np.inf) for front in fronts]
        index = int(np.argmin(lowest))
        scale = min(lowest[index], settled)
        done = scale >= (1.0 - gap) * broken
        if done or count >= most or deadline.over():
            return BoxProof(min(scale, broken), known, count, done)
        halves, after, rest = _split(fronts[index])
        demand = known.demands[index]
        keep, across = region.across(Boxes(*(end[:, : box.size] for end in halves)))
        halves, after = taken(halves, keep), after[keep]
        count += len(keep)
        bounds = demand.bounds(halves, box, broken)
        # A bound of the whole box holds for both halves.
        scales = np.maximum(bounds.scale, after)
        at = bounds.states.scale(box)
        rows = np.flatnonzero(at < broken)
        rows = rows[region.inside(bounds.states.q[rows])] if rows.size else rows
        if rows.size:
            row = rows[[at[rows].argmin()]]
            known, broken = known.with_states(index, taken(bounds.states, row)), float(at[row[0]])
        weights = bounds.weights / demand.limit
        # If a state outside of the region breaks, the border decides which half it is in.
        weights[:, : box.size] += across[keep] * (at < broken)[:, None]
        left = scales < (1.0 - gap) * broken
        settled = min(settled, scales[~left].min(initial=np.inf))
        fronts[index] = joined([rest, taken(OpenBoxes(scales, halves, weights), left)])


class OpenBoxes(NamedTuple):
    """Boxes that are not yet good enough, with their bounds of the scale [B] and weights [B,2n]."""

    scales: FloatArray
    boxes: Boxes
    weights: FloatArray


def _split(front: OpenBoxes) -> tuple[Boxes, FloatArray, OpenBoxes]:
    """Split the boxes with the lowest bounds along their coordinate of the largest weight.

    Returns
    -------
    halves : Boxes
        Lower halves, followed by the upper halves.
    scales : array
        Bound of the whole box for each half.
    rest : OpenBoxes
        Boxes that were not split.
    """
    order = np.argpartition(front.scales, min(BATCH, front.scales.size) - 1)
    scales, (low, high), weights = taken(front, order[:BATCH])
    rows, along = np.arange(len(low)), weights.argmax(axis=1)
    middle = (low[rows, along] + high[rows, along]) / 2
    below, above = high.copy(), low.copy()
    below[rows, along] = above[rows, along] = middle
    halves = Boxes(np.concatenate([low, above]), np.concatenate([below, high]))
    return halves, np.tile(scales, 2), taken(front, order[BATCH:])


def largest_box(
    known: KnownStates,
    region: PositionRegion,
    shape: Callable[[KnownStates], FloatArray],
    rng: np.random.Generator,
) -> tuple[FloatArray, KnownStates]:
    """Find the largest box [n] of accelerations that no known state breaks, by cutting planes.

    A state is a linear constraint ``rows . a <= room`` of the box a. Each round computes the
    largest box under all constraints, and searches for states that violate it. The rounds end when
    the search finds no violation above ``FOUND``.
    """
    box = shape(known)
    for _ in range(CUTS):
        known = with_local_search(known, box, region, rng)
        worst = known.worst(box).scale
        if worst > 1.0 - FOUND or worst <= 0.0:
            break
        box = shape(known)
    return box, known


def box_of_largest_product(known: KnownStates, count: int) -> FloatArray:
    """Find the box a [n] with the largest product of accelerations that no known state breaks.

    The constraints are ``rows . a <= room`` for all states. Only an active set enters the
    optimisation; the most violated constraints join it until none is violated.
    """
    planes = np.concatenate([states.rows / states.room[:, None] for states in known.states])
    # Scaling every acceleration by its tightest constraint leaves the maximiser unchanged, because
    # it multiplies the product by a constant.
    sizes = planes.max(axis=0)
    planes = planes / sizes
    box = np.full(count, 1.0 / count)
    active = np.zeros(len(planes), dtype=bool)
    active[planes.argmax(axis=0)] = True  # Each acceleration needs one constraint that bounds it.
    while True:
        active[np.argsort(-planes @ box)[: PLANES * count]] = True
        box = _product_below(planes[active])
        if (planes @ box).max() <= 1.0:
            return box / sizes


def _product_below(planes: FloatArray) -> FloatArray:
    """Find the x > 0 with the largest product such that ``planes x <= 1``.

    Newton steps minimise ``-sum log x_j - weight sum log(1 - planes x)`` while the weight of the
    barrier falls to zero.
    """
    count = planes.shape[1]
    x = np.full(count, 0.5 / planes.sum(axis=1).max())
    weight = 1.0
    while weight > ROUNDING:
        for _ in range(50):
            left = 1.0 - planes @ x
            slope = -1.0 / x + weight * (planes / left[:, None]).sum(axis=0)
            scaled = planes / left[:, None]
            step = np.linalg.solve(np.diag(1.0 / x**2) + weight * scaled.T @ scaled, -slope)
            if -slope @ step < ROUNDING:
                break
            length = 1.0
            while (x + length * step).min() <= 0.0 or (planes @ (x + length * step)).max() >= 1.0:
                length /= 2
            x = x + 0.5 * length * step if length < 1.0 else x + step
        weight /= 10.0
    return x
