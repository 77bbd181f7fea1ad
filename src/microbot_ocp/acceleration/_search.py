"""The largest scale of a box of accelerations: states that break it, and a proof up to it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import FloatArray
from microbot_ocp.acceleration._demand import Boxes, Demand, States
from microbot_ocp.acceleration._region import Places

BATCH = 1000  # boxes that are split before the next ones are chosen
DRAWN = 2000  # states drawn for every joint, side and payload
KEPT, AROUND = 8, 24  # of them the worst are moved on: so many, to so many places each
ROUNDS = 14  # each draws from two thirds of the width of the one before
PLANES = 10  # for each joint, that are added at once
RIVAL = 1.3  # a joint whose worst state is farther from its limit is not looked at again


@dataclass(frozen=True, eq=False)
class Worst:
    """A state that breaks a box of accelerations once it is larger than ``scale`` of it."""

    scale: float
    demand: Demand
    states: States
    row: int


@dataclass(frozen=True, eq=False)
class Pool:
    """The worst states that are known, of every demand."""

    demands: tuple[Demand, ...]
    states: tuple[States, ...]

    def worst(self, box: FloatArray) -> Worst:
        """Return the state that breaks this box of accelerations first."""
        each = [states.scale(box) for states in self.states]
        k = int(np.argmin([scales.min(initial=np.inf) for scales in each]))
        row = int(each[k].argmin())
        return Worst(float(each[k][row]), self.demands[k], self.states[k], row)

    def with_states(self, index: int, states: States) -> Pool:
        """Return the pool with further states of one demand."""
        every = [*self.states]
        every[index] = States.joined([every[index], states])
        return Pool(self.demands, tuple(every))


def drawn(demands: Sequence[Demand], region: Places, rng: np.random.Generator) -> Pool:
    """Return states at random places of a region, the same for all demands."""
    q = _random_places(region, DRAWN, rng)
    return Pool(tuple(demands), tuple(demand.states_at(q) for demand in demands))


def _random_places(region: Places, count: int, rng: np.random.Generator) -> FloatArray:
    low, high = region.boxes
    joints = low.shape[1]
    kept = np.empty((0, joints))
    for _ in range(50):
        row = rng.integers(len(low), size=count)
        q = rng.uniform(low[row], high[row])
        kept = np.vstack([kept, q[region.inside(q)]])[:count]
        if len(kept) == count:
            break
    return kept


def attacked(pool: Pool, box: FloatArray, region: Places, rng: np.random.Generator) -> Pool:
    """Return the pool with states that were moved to where this box of accelerations breaks."""
    least = pool.worst(box).scale
    for index, demand in enumerate(pool.demands):
        scales = pool.states[index].scale(box)
        if not scales.size or scales.min() > RIVAL * max(least, 0.0):
            continue
        best = pool.states[index].taken(np.argsort(scales)[:KEPT])
        width = np.ptp(np.stack([region.boxes.low.min(axis=0), region.boxes.high.max(axis=0)]), 0)
        for halving in range(ROUNDS):
            step = 0.3 * width * (2 / 3) ** halving
            q = np.repeat(best.q, AROUND, axis=0)
            q = q + step * rng.uniform(-1.0, 1.0, q.shape) * (rng.random(q.shape) < 0.5)
            q = _moved_inside(q, region)
            if len(q):
                best = States.joined([best, demand.states_at(q)])
            best = best.taken(np.argsort(best.scale(box))[:KEPT])
        pool = pool.with_states(index, best)
        least = min(least, float(best.scale(box).min()))
    return pool


def _moved_inside(q: FloatArray, region: Places) -> FloatArray:
    """Return places in the nearest box of a region each, without those that do not count."""
    if len(region.boxes.low) == 1:
        q = np.clip(q, region.boxes.low, region.boxes.high)
    else:
        clipped = np.clip(q[:, None], region.boxes.low, region.boxes.high)
        nearest = np.linalg.norm(clipped - q[:, None], axis=2).argmin(axis=1)
        q = clipped[np.arange(len(q)), nearest]
    return q[region.inside(q)]


class Proof(NamedTuple):
    """How far a box of accelerations is proved.

    Attributes
    ----------
    scale : float
        No state needs more than the torques with the accelerations times this.
    pool : Pool
        With the states that were met on the way.
    count : int
        Boxes of positions and speeds that were looked at.
    done : bool
        Whether the gap is reached.
    """

    scale: float
    pool: Pool
    count: int
    done: bool


def proved(pool: Pool, box: FloatArray, region: Places, gap: float, most: int) -> Proof:
    """Return a scale of a box [n] of accelerations that no state breaks, by branch and bound.

    Boxes whose bound is lowest are split first, until the lowest is within ``gap`` of a scale that
    a known state breaks, or ``most`` boxes were looked at.
    """
    broken = pool.worst(box).scale
    fronts = []
    for demand in pool.demands:
        low, high = (np.tile(end, (len(region.boxes.low), 1)) for end in demand.all_shares)
        boxes = Boxes(np.hstack([region.boxes.low, low]), np.hstack([region.boxes.high, high]))
        bounds = demand.bounds(boxes, box, broken)
        weights = bounds.weights / demand.limit
        weights[:, : box.size] += region.across(*region.boxes)[1]
        fronts.append((bounds.scale, boxes, weights))
    count, settled = sum(len(front[0]) for front in fronts), np.inf
    while True:
        lowest = [front[0].min(initial=np.inf) for front in fronts]
        index = int(np.argmin(lowest))
        scale = min(lowest[index], settled)
        done = scale >= (1.0 - gap) * broken
        if done or count >= most or deadline.over():
            return Proof(min(scale, broken), pool, count, done)
        halves, after, rest = _split(fronts[index])
        demand = pool.demands[index]
        keep, across = region.across(halves.low[:, : box.size], halves.high[:, : box.size])
        halves, after = halves.taken(keep), after[keep]
        count += len(keep)
        bounds = demand.bounds(halves, box, broken)
        scales = np.maximum(bounds.scale, after)  # of a part it is no less than of the whole
        at = np.where(region.inside(bounds.states.q), bounds.states.scale(box), np.inf)
        if at.size and at.min() < broken:
            pool = pool.with_states(index, bounds.states.taken(np.array([int(at.argmin())])))
            broken = float(at.min())
        weights = bounds.weights / demand.limit
        weights[:, : box.size] += across[keep]
        left = scales < (1.0 - gap) * broken
        settled = min(settled, scales[~left].min(initial=np.inf))
        parts = (scales[left], halves.taken(left), weights[left])
        fronts[index] = (
            np.concatenate([rest[0], parts[0]]),
            Boxes(*(np.concatenate(pair) for pair in zip(rest[1], parts[1], strict=True))),
            np.concatenate([rest[2], parts[2]]),
        )


Front = tuple[FloatArray, Boxes, FloatArray]


def _split(front: Front) -> tuple[Boxes, FloatArray, Front]:
    """Return both halves of the lowest boxes, the bounds of the wholes, and the other boxes."""
    scales, boxes, weights = front
    order = np.argpartition(scales, min(BATCH, scales.size) - 1)
    chosen, others = order[:BATCH], order[BATCH:]
    low, high = boxes.taken(chosen)
    rows, along = np.arange(len(low)), weights[chosen].argmax(axis=1)
    middle = (low[rows, along] + high[rows, along]) / 2
    below, above = high.copy(), low.copy()
    below[rows, along] = above[rows, along] = middle
    halves = Boxes(np.concatenate([low, above]), np.concatenate([below, high]))
    rest = scales[others], boxes.taken(others), weights[others]
    return halves, np.tile(scales[chosen], 2), rest


def largest_box(
    pool: Pool,
    region: Places,
    shape: Callable[[Pool], FloatArray],
    rng: np.random.Generator,
    *,
    rounds: int = 40,
    accuracy: float = 1e-3,
) -> tuple[FloatArray, Pool]:
    """Return the largest box [n] of accelerations that no known state breaks, by cutting planes.

    Every state is a plane that the box must stay below; states that break the largest box below all
    planes are looked for and added, until there are none.
    """
    box = shape(pool)
    for _ in range(rounds):
        pool = attacked(pool, box, region, rng)
        worst = pool.worst(box).scale
        if worst > 1.0 - accuracy or worst <= 0.0:
            break
        box = shape(pool)
    return box, pool


def of_largest_product(pool: Pool, count: int) -> FloatArray:
    """Return the box [n] of accelerations with the largest product that no state of a pool breaks.

    Each state is a plane; those that a first box breaks most are taken, until none is broken.
    """
    planes = np.concatenate([states.rows / states.room[:, None] for states in pool.states])
    sizes = planes.max(axis=0)
    planes = planes / sizes
    box = np.full(count, 1.0 / count)
    active = np.zeros(len(planes), dtype=bool)
    active[planes.argmax(axis=0)] = True  # each acceleration is bounded
    while True:
        active[np.argsort(-planes @ box)[: PLANES * count]] = True
        box = _product_below(planes[active])
        if (largest := float((planes @ box).max())) <= 1.0 + 1e-6:
            return box / max(largest, 1.0) / sizes


def _product_below(planes: FloatArray) -> FloatArray:
    """Return the x > 0 with the largest product such that ``planes x <= 1``."""
    count = planes.shape[1]
    x = np.full(count, 0.5 / planes.sum(axis=1).max())
    weight = 1.0
    while weight > 1e-9:
        for _ in range(50):
            left = 1.0 - planes @ x
            slope = -1.0 / x + weight * (planes / left[:, None]).sum(axis=0)
            scaled = planes / left[:, None]
            step = np.linalg.solve(np.diag(1.0 / x**2) + weight * scaled.T @ scaled, -slope)
            if -slope @ step < 1e-12:
                break
            length = 1.0
            while (x + length * step).min() <= 0.0 or (planes @ (x + length * step)).max() >= 1.0:
                length /= 2
            x = x + 0.9 * length * step if length < 1.0 else x + step
        weight /= 5.0
    return x
