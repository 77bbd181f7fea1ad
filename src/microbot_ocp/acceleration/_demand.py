"""Largest torque of one joint over boxes of positions and speeds.

The torque is exact at a point, and bounded from above in a box.

Accelerations: the torque is linear in them, so a box ``|qdd_j| <= a_j`` adds ``sum_j |M_ij| a_j``.

Speeds: the Coriolis torque is a quadratic form. If it is convex along every joint, its largest
value over a box is at a corner. A concave part ``-c (u - m)^2`` about the middle m is replaced by
zero. This overestimates the torque by at most ``c h^2``, with h half the width of the box, and the
error vanishes as boxes are split.

Sign: the form is equal at qd and -qd, and friction grows with the speed of the joint itself. The
largest torque therefore occurs at a speed of the joint that is not negative.

Last joint: it often turns a nearly round link, and changes the torque little over a whole turn. In
a box as wide as that the terms are replaced by their means over the turn, and the waves about the
means are added to the remainder.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

import numpy as np

from microbot_ocp._base.checks import ROUNDING, FloatArray
from microbot_ocp.acceleration._forms import Terms, pairs
from microbot_ocp.robot import COULOMB_SMOOTHING

LEAST_ROWS = 128  # The calls for fewer rows cost more than a cache that overflows.
CHUNK = 60_000  # Arrays of this many numbers fit several at once into the second-level cache.


class Boxes(NamedTuple):
    """Boxes [B,2n] of joint positions, rad (m), and of shares of the largest speeds, -1 to 1."""

    low: FloatArray
    high: FloatArray

    @property
    def middle(self) -> FloatArray:
        """Middle of each box."""
        return (self.low + self.high) / 2

    @property
    def half(self) -> FloatArray:
        """Half the width of each box."""
        return (self.high - self.low) / 2


class States(NamedTuple):
    """States at which the torque of one joint is evaluated.

    Attributes
    ----------
    q : array [B,n]
        Joint positions, rad (m).
    shares : array [B,n]
        Joint speeds as shares of the largest ones, -1 to 1.
    rows : array [B,n]
        Absolute values of the joint's row of the mass matrix, kg m^2.
    room : array [B]
        Torque that remains for accelerations, N m (N).
    """

    q: FloatArray
    shares: FloatArray
    rows: FloatArray
    room: FloatArray

    def scale(self, box: FloatArray) -> FloatArray:
        """Return the scale [B] of a box [n] of accelerations that uses up the torque."""
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = self.room / (self.rows @ box)
        return np.where(np.isnan(scale), np.inf, scale)


class ScaleBounds(NamedTuple):
    """Bounds over boxes of positions and speeds.

    Attributes
    ----------
    scale : array [B]
        Scale of the accelerations that is proved for every state of the box.
    states : States
        Worst state in the middle of each box.
    weights : array [B,2n]
        Contribution of each coordinate to the change of the torque in the box, N m (N).
    """

    scale: FloatArray
    states: States
    weights: FloatArray


Rows = TypeVar("Rows", bound="np.ndarray | tuple[Any, ...]")


def taken(table: Rows, rows: np.ndarray | slice) -> Rows:
    """Return some rows of an array, or of each array of a named tuple."""
    if isinstance(table, np.ndarray):
        return table[rows]  # type: ignore[return-value]
    return type(table)(*(taken(part, rows) for part in table))


def joined(tables: Sequence[Rows]) -> Rows:
    """Join the rows of arrays, or of named tuples of arrays."""
    if isinstance(tables[0], np.ndarray):
        return np.concatenate(tables)  # type: ignore[return-value]
    return type(tables[0])(*map(joined, zip(*tables, strict=True)))


@dataclass(frozen=True, eq=False)
class Demand:
    """Torque demand of one joint towards one of its limits, with one payload.

    Attributes
    ----------
    terms : Terms
        Gravity torque, row of the mass matrix and Coriolis coefficients of the joint.
    joint : int
        Index of the joint, from 0.
    side : float
        Sign of the limit: 1 for the upper one, -1 for the lower one.
    limit : float
        Largest torque towards this side, N m (N).
    speed : array [n]
        Largest speeds of all joints, rad/s (m/s).
    viscous, coulomb : float
        Friction coefficients of the joint, N m s (N s/m) and N m (N).
    payload : float
        Mass at the tool, kg.
    """

    terms: Terms
    joint: int
    side: float
    limit: float
    speed: FloatArray
    viscous: float
    coulomb: float
    payload: float

    @cached_property
    def _corners(self) -> FloatArray:
        """Signs [V,n] of the corners of a box of speeds; 0 for joints at rest."""
        moving = np.flatnonzero(self.speed > 0)
        signs = np.zeros((2**moving.size, self.speed.size))
        for bit, joint in enumerate(moving.tolist()):
            signs[:, joint] = 1.0 - 2.0 * ((np.arange(len(signs)) >> bit) & 1)
        return signs

    @cached_property
    def _mixed(self) -> tuple[np.ndarray, np.ndarray]:
        return np.triu_indices(self.speed.size, 1)

    @cached_property
    def _monomials(self) -> FloatArray:
        """Values [1 + n + n(n-1)/2, V] of 1, s_j and s_j s_k at the corners."""
        signs, (first, second) = self._corners, self._mixed
        ones = np.ones((len(signs), 1))
        return np.hstack([ones, signs, signs[:, first] * signs[:, second]]).T.copy()

    @cached_property
    def _square(self) -> np.ndarray:
        """Indices [n,n] of the Coriolis coefficients C_ijk in the list of pairs j <= k."""
        count = self.speed.size
        first, second = pairs(count)
        place = np.zeros((count, count), dtype=int)
        place[first, second] = place[second, first] = range(first.size)
        return place

    @property
    def all_shares(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper ends [n] of the speed shares; the joint's own share is not negative."""
        high = np.where(self.speed > 0, 1.0, 0.0)
        low = -high
        low[self.joint] = 0.0
        return low, high

    def states_at(self, q: FloatArray) -> States:
        """Return the states [B] with the worst corner of the speeds at positions [B,n]."""
        low, high = (np.broadcast_to(end, q.shape) for end in self.all_shares)
        boxes = Boxes(np.hstack([q, low]), np.hstack([q, high]))
        chunks = [taken(boxes, rows) for rows in self._chunks(len(q))]
        return joined([self._states(chunk, self._terms_at(chunk)[:, :1]) for chunk in chunks])

    def bounds(self, boxes: Boxes, box: FloatArray, scale: float) -> ScaleBounds:
        """Return bounds of the scale of a box [n] of accelerations, sharpest near ``scale``."""
        chunks = [taken(boxes, rows) for rows in self._chunks(len(boxes.low))]
        return joined([self._bounds(chunk, box, scale) for chunk in chunks])

    def _chunks(self, count: int) -> list[slice]:
        size = max(LEAST_ROWS, CHUNK // (self.speed.size * len(self._corners)))
        return [slice(begin, begin + size) for begin in range(0, max(count, 1), size)]

    def _terms_at(self, boxes: Boxes) -> FloatArray:
        """Return values [B,0,F] and slopes [B,1:,F] of the terms in the middle of boxes."""
        return self._towards(self.terms.at(boxes.middle[:, : self.speed.size]))

    def _towards(self, terms: FloatArray) -> FloatArray:
        """Turn the signs of gravity and Coriolis terms towards this side."""
        terms[:, :, 0] *= self.side
        terms[:, :, 1 + self.speed.size :] *= self.side
        return terms

    def _states(
        self, boxes: Boxes, terms: FloatArray, at_corners: FloatArray | None = None
    ) -> States:
        """Return the worst states in the middle of boxes, from the terms and torques there."""
        count, middle = self.speed.size, boxes.middle
        at_corners = self._at_corners(boxes, terms[:, :1]) if at_corners is None else at_corners
        torques = at_corners[:, 0]
        worst = torques.argmax(axis=1)
        shares = middle[:, count:] + boxes.half[:, count:] * self._corners[worst]
        torque = torques[np.arange(len(worst)), worst] + self._coulomb_at(shares)
        inertia = np.abs(terms[:, 0, 1 : 1 + count])
        return States(middle[:, :count], shares, inertia, self.limit - torque)

    def _at_corners(self, boxes: Boxes, terms: FloatArray) -> FloatArray:
        """Return torques without acceleration [B,0,V] at the corners of the speeds.

        Rows from the second on are slopes of the torque in the positions, as in the terms [B,R,F].
        """
        count, middle, half = self.speed.size, boxes.middle, boxes.half
        mean, spread = middle[:, count:] * self.speed, half[:, count:] * self.speed
        form = terms[:, :, 1 + count :][:, :, self._square]
        at_mean = np.matmul(form, mean[:, None, :, None])[..., 0]
        first, second = self._mixed
        # At a corner the speeds are m + d s, with middle m, half width d and signs s = +-1:
        # qd' C qd = m' C m + sum_j C_jj d_j^2 + 2 m' C (d s) + 2 sum_j<k C_jk d_j d_k s_j s_k.
        # One matrix product with the monomials of s evaluates it at all corners.
        numbers = np.empty((*terms.shape[:2], len(self._monomials)))
        bent = np.einsum("bkjj,bj->bk", form, spread**2)
        numbers[:, :, 0] = terms[:, :, 0] + np.einsum("bkj,bj->bk", at_mean, mean) + bent
        numbers[:, :, 1 : 1 + count] = 2.0 * at_mean * spread[:, None]
        products = spread[:, first] * spread[:, second]
        numbers[:, :, 1 + count :] = 2.0 * form[:, :, first, second] * products[:, None]
        numbers[:, 0, 0] += self.viscous * mean[:, self.joint]
        numbers[:, 0, 1 + self.joint] += self.viscous * spread[:, self.joint]
        values = numbers.reshape(-1, len(self._monomials)) @ self._monomials
        return values.reshape(*terms.shape[:2], len(self._corners))

    def _coulomb_at(self, shares: FloatArray) -> FloatArray:
        speed = shares[:, self.joint] * self.speed[self.joint]
        return self.coulomb * np.tanh(speed / COULOMB_SMOOTHING)

    def _bounds(self, boxes: Boxes, box: FloatArray, scale: float) -> ScaleBounds:
        count = self.speed.size
        terms, half = self._terms_at(boxes), boxes.half[:, :count]
        largest = np.maximum(np.abs(boxes.low), np.abs(boxes.high))[:, count:] * self.speed
        accelerations = np.broadcast_to(scale * box, half.shape)
        sizes = np.hstack([np.ones((len(half), 1)), accelerations, self._pairs(largest)])
        curvature = np.tensordot(sizes, self.terms.curvature, axes=1)
        wide = self._wide(half, terms, sizes, curvature)
        # Within 1 rad a wave changes by less than the amplitude by which it differs from its mean.
        # A hundredth of the torque for accelerations changes their bound by as little.
        by_last = np.einsum("bf,bf->b", sizes, wide[:, -1])
        needed = scale * np.abs(terms[:, 0, 1 : 1 + count]) @ box
        rolls = np.flatnonzero((by_last > 0.01 * needed) & (half[:, -1] > 1.0))
        if rolls.size and self.terms.rolling is not None:
            states = self._states(boxes, terms)
            terms[rolls], wide[rolls, -1] = self._rolled(
                taken(boxes, rolls), self._towards(terms[rolls]), wide[rolls]
            )
            at_corners = self._at_corners(boxes, terms)
        else:
            at_corners = self._at_corners(boxes, terms)
            states = self._states(boxes, terms, at_corners)
        values, slopes = at_corners[:, 0], at_corners[:, 1:]
        half, moved = np.where(wide.any(axis=2), 0.0, half), wide.sum(axis=1)
        rest = self.terms.tangent_error(half) + moved
        swing = np.einsum("bk,bkf->bf", half, np.abs(terms[:, 1:])) + rest
        # Accelerations add |M_ij| a_j. Where M_ij keeps its sign in the box, |M_ij| is as smooth
        # as M_ij and has a tangent; elsewhere only |M_ij(c)| + swing bounds it.
        inertia, swings = terms[:, 0, 1 : 1 + count], swing[:, 1 : 1 + count]
        keeps = np.abs(inertia) >= swings
        signed = np.where(keeps, np.sign(inertia), 0.0) * box
        tilt = np.einsum("bj,bkj->bk", signed, terms[:, 1:, 1 : 1 + count])
        fixed, across = self._coriolis_excess(boxes, half, terms, rest, swing)
        fixed += self.coulomb * np.tanh(self.speed[self.joint] / COULOMB_SMOOTHING)
        fixed += self._margin(box, scale)
        # Each pair in ``ends`` bounds the torque at scale 0 and at ``scale``, with the remainder of
        # Taylor polynomials of degree one (tangent) and of degree two (parabola).
        most = np.minimum(np.abs(inertia) + swings, self.terms.amplitude[1 : 1 + count])
        added = np.where(keeps, np.abs(inertia), most) @ box
        tilted = slopes + scale * tilt[:, :, None]
        tangent = rest[:, : 1 + count]
        parabola = self.terms.parabola_error(half) + moved[:, : 1 + count]
        bends, ends = self._bends(states.q, signed), []
        for rests, bent in ((tangent, None), (parabola, (bends[0], bends[0] + scale * bends[1]))):
            left, gained = fixed + rests[:, 0], added + (rests[:, 1:] * keeps) @ box
            at_rest = values + _largest(slopes, bent and bent[0], half)
            torques = values + _largest(tilted, bent and bent[1], half)
            ends.append((left + at_rest.max(axis=1), left + scale * gained + torques.max(axis=1)))
        (slow, fast), (bent_slow, bent_fast) = ends
        lower = bent_fast < fast
        slow, fast = np.where(lower, bent_slow, slow), np.where(lower, bent_fast, fast)
        # The bound b(s) is convex in the scale s, so for 0 <= s <= scale it lies below its chord:
        # b(s) <= slow + (fast - slow) s / scale. The chord reaches the limit at ``possible``.
        with np.errstate(divide="ignore", invalid="ignore"):
            possible = scale * (self.limit - slow) / (fast - slow)
        possible = np.where(fast > slow, possible, np.where(slow <= self.limit, np.inf, -np.inf))
        worst = torques.argmax(axis=1)
        steep = np.abs(tilted[np.arange(len(worst)), :, worst])
        turning = np.einsum("bj,bkj->bk", ~keeps * box, np.abs(terms[:, 1:, 1 : 1 + count]))
        weights = half * (steep + np.einsum("bkl,bl->bk", curvature, half) + 2 * scale * turning)
        across[:, :count] += weights + np.einsum("bf,bkf->bk", sizes, wide)
        return ScaleBounds(possible, states, across)

    def _wide(
        self, half: FloatArray, terms: FloatArray, sizes: FloatArray, curvature: FloatArray
    ) -> FloatArray:
        """Return changes [B,n,F] of terms by wide coordinates, and zero for all others.

        A tangent is far off in a wide box: there the slope, and the change over a whole turn, are
        sharper bounds. They hold whatever the other coordinates are, so they add up.
        """
        change = np.minimum(half[:, :, None] * self.terms.steep.T, self.terms.span.T)
        by_tangent = np.einsum("bf,bkf->bk", sizes, np.abs(terms[:, 1:]))
        by_tangent += 0.5 * np.einsum("bkl,bl->bk", curvature, half)
        wide = np.einsum("bf,bkf->bk", sizes, change) < half * by_tangent
        return change * wide[:, :, None]

    def _rolled(
        self, boxes: Boxes, here: FloatArray, wide: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return mean terms [B,1 + n,F] over a turn of the last joint, and changes [B,F] by it.

        The waves in that joint are known in the middle of the box. Within the box they change by
        slopes and curvature, and are at most the sum of all amplitudes. Their curvature counts
        once more because second derivatives are not means.
        """
        half = np.where(wide.any(axis=2), 0.0, boxes.half[:, : self.speed.size])
        mean, waves = self.terms.over_a_turn(boxes.middle[:, : self.speed.size], here)
        bent = self.terms.tangent_error(half, rolling=True)
        change = waves[:, 0] + np.einsum("bk,bkf->bf", half, waves[:, 1:]) + bent
        return self._towards(mean), np.minimum(change, self.terms.span[:, -1] / 2) + bent

    def _coriolis_excess(
        self,
        boxes: Boxes,
        half: FloatArray,
        terms: FloatArray,
        rest: FloatArray,
        swing: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """Return the largest excess [B] of the Coriolis torque over its tangents at the corners.

        The excess has two parts: the remainders of the Coriolis coefficients in the positions, and
        concave parts of the form along a speed. The second result [B,2n] splits it by coordinate.
        """
        count = self.speed.size
        low, high = (end[:, count:] * self.speed for end in boxes)
        each = np.arange(count)
        down = swing[:, 1 + count :] - terms[:, 0, 1 + count :]
        bent = np.maximum(0.0, down[:, self._square[each, each]]) * ((high - low) / 2) ** 2
        products = self._pairs(np.maximum(np.abs(low), np.abs(high)))
        left = bent.sum(axis=1) + np.einsum("bp,bp->b", rest[:, 1 + count :], products)
        return left, np.hstack([0.0 * bent, bent])

    def _bends(self, q: FloatArray, signed: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return second derivatives [B,n,n] of gravity, and of M qdd for qdd = ``signed`` [B,n]."""
        none = np.zeros((len(q), 1))
        gravity = np.hstack([none + self.side, 0.0 * signed])
        inertia = np.hstack([none, signed])
        return self.terms.bends(q, gravity), self.terms.bends(q, inertia)

    def _pairs(self, largest: FloatArray) -> FloatArray:
        first, second = pairs(self.speed.size)
        return np.where(first == second, 1.0, 2.0) * largest[:, first] * largest[:, second]

    def _margin(self, box: FloatArray, scale: float) -> float:
        """Return a torque above all rounding errors and neglected curvatures, N m (N)."""
        ones = np.concatenate([[1.0], scale * box, self._pairs(self.speed[None])[0]])
        return ROUNDING * (self.limit + float(self.terms.amplitude @ ones))


def _largest(slopes: FloatArray, bends: FloatArray | None, half: FloatArray) -> FloatArray:
    """Return upper bounds [B,V] of ``slope . x + x' bend x / 2`` for ``|x_j| <= half_j``.

    The arguments are slopes [B,n,V], second derivatives [B,n,n] (None for zero) and half widths
    [B,n]. Diagonal terms are maximised exactly: a concave parabola is largest at its vertex
    ``|slope| / -bend``, or at the end of the range. Mixed terms are bounded by their absolute
    values.
    """
    sizes = np.abs(slopes)
    if bends is None:
        return np.matmul(half[:, None], sizes)[:, 0]
    width, each = half[:, :, None], np.arange(half.shape[1])
    diagonal = bends[:, each, each][:, :, None]
    vertex = np.divide(sizes, -diagonal, out=np.full_like(sizes, np.inf), where=diagonal < 0.0)
    along = np.minimum(width, vertex)
    own = along * (sizes + 0.5 * diagonal * along)
    mixed = np.abs(bends)
    mixed[:, each, each] = 0.0
    return own.sum(axis=1) + 0.5 * np.einsum("bi,bij,bj->b", half, mixed, half)[:, None]
