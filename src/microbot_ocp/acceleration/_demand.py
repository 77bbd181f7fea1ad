"""The torque that one joint needs at most, over boxes of positions and speeds: exact at a point,
bounded in a box.

The torque is linear in the accelerations, so ``sum_j |M_ij| a_j`` is what a box of them adds. It is
a quadratic form of the speeds, whose largest value over a box of them is at a corner, once what
bends down along a joint, ``-c (u - m)^2``, is taken as zero: too much by ``c`` times the square of
half the box's width, which splitting takes away. The form has one value for a speed and its
reverse, so that of the joint itself, which friction follows, need not be negative.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.acceleration._forms import ROUNDING, Terms, pairs
from microbot_ocp.robot import COULOMB_SMOOTHING

Rows = np.ndarray | slice
CHUNK = 60_000  # numbers of an array that the second cache holds with some others


class Boxes(NamedTuple):
    """Boxes [B,2n] of joint positions and of shares of the largest speeds, -1 to 1."""

    low: FloatArray
    high: FloatArray

    def taken(self, rows: Rows) -> Boxes:
        """Return some of them."""
        return Boxes(self.low[rows], self.high[rows])


class States(NamedTuple):
    """States in which a joint's torque is looked at.

    Attributes
    ----------
    q : array [B,n]
        rad (m).
    shares : array [B,n]
        Of the largest speeds.
    rows : array [B,n]
        Sizes of the entries of the mass matrix in the row of the joint, kg m^2.
    room : array [B]
        Torque that is left for accelerations, N m (N).
    """

    q: FloatArray
    shares: FloatArray
    rows: FloatArray
    room: FloatArray

    def scale(self, box: FloatArray) -> FloatArray:
        """Return the factor [B] of a box [n] of accelerations at which the torque is used up."""
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = self.room / (self.rows @ box)
        return np.where(np.isnan(scale), np.inf, scale)

    def taken(self, rows: Rows) -> States:
        """Return some of them."""
        return States(*(part[rows] for part in self))

    @staticmethod
    def joined(parts: list[States]) -> States:
        """Return the states of several."""
        return States(*(np.concatenate(part) for part in zip(*parts, strict=True)))


class Bounds(NamedTuple):
    """Of boxes: a scale of the accelerations that is surely possible, states in the middle, and
    how much of the torque's change stems from each of the 2n coordinates.
    """

    scale: FloatArray
    states: States
    weights: FloatArray


@dataclass(frozen=True, eq=False)
class Demand:
    """The torque of one joint, on one side of its limits, with one payload.

    Attributes
    ----------
    terms : Terms
        Gravity, the row of the mass matrix, the Coriolis coefficients.
    joint : int
        From 0.
    side : float
        1 for the upper limit, -1 for the lower.
    limit : float
        Its size, N m (N).
    speed : array [n]
        Largest speeds, rad/s (m/s).
    viscous, coulomb : float
        Friction of the joint.
    payload : float
        kg.
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
        """Signs [V,n] of the corners of a box of speeds, without those that are always zero."""
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
        """Places [n,n] of the Coriolis coefficients among the pairs."""
        count = self.speed.size
        first, second = pairs(count)
        place = np.zeros((count, count), dtype=int)
        place[first, second] = place[second, first] = range(first.size)
        return place

    @property
    def all_shares(self) -> tuple[FloatArray, FloatArray]:
        """Ends [n] of the shares of speeds: that of the joint itself is not negative."""
        high = np.where(self.speed > 0, 1.0, 0.0)
        low = -high
        low[self.joint] = 0.0
        return low, high

    def states_at(self, q: FloatArray) -> States:
        """Return the worst corner of the speeds at positions [B,n]."""
        low, high = (np.broadcast_to(end, q.shape) for end in self.all_shares)
        boxes = Boxes(np.hstack([q, low]), np.hstack([q, high]))
        parts = [self._at_corners(boxes.taken(rows))[0] for rows in self._chunks(len(q))]
        return States.joined(parts)

    def bounds(self, boxes: Boxes, box: FloatArray, scale: float) -> Bounds:
        """Return bounds for accelerations within ``box`` [n], sharpest near this scale of them."""
        parts = [
            self._bounds(boxes.taken(rows), box, scale) for rows in self._chunks(len(boxes.low))
        ]
        scales, states, weights = zip(*parts, strict=True)
        return Bounds(np.concatenate(scales), States.joined([*states]), np.concatenate(weights))

    def _chunks(self, count: int) -> list[slice]:
        size = max(16, CHUNK // (self.speed.size * len(self._corners)))
        return [slice(begin, begin + size) for begin in range(0, max(count, 1), size)]

    def _at_corners(self, boxes: Boxes) -> tuple[States, tuple[FloatArray, ...]]:
        """Return the states in the middle, and the terms and values at the corners of the speeds.

        The latter are terms [B,1 + n,F], and torques [B,V] and their slopes [B,n,V].
        """
        count = self.speed.size
        middle, half = (boxes.low + boxes.high) / 2, (boxes.high - boxes.low) / 2
        terms = self.terms.at(middle[:, :count])
        terms[:, :, 0] *= self.side
        terms[:, :, 1 + count :] *= self.side
        mean, spread = middle[:, count:] * self.speed, half[:, count:] * self.speed
        form = terms[:, :, 1 + count :][:, :, self._square]
        at_mean = np.matmul(form, mean[:, None, :, None])[..., 0]
        first, second = self._mixed
        numbers = np.empty((len(terms), 1 + count, len(self._monomials)))
        bent = np.einsum("bkjj,bj->bk", form, spread**2)
        numbers[:, :, 0] = terms[:, :, 0] + np.einsum("bkj,bj->bk", at_mean, mean) + bent
        numbers[:, :, 1 : 1 + count] = 2.0 * at_mean * spread[:, None]
        products = spread[:, first] * spread[:, second]
        numbers[:, :, 1 + count :] = 2.0 * form[:, :, first, second] * products[:, None]
        numbers[:, 0, 0] += self.viscous * mean[:, self.joint]
        numbers[:, 0, 1 + self.joint] += self.viscous * spread[:, self.joint]
        values = numbers.reshape(-1, len(self._monomials)) @ self._monomials
        values = values.reshape(len(terms), 1 + count, len(self._corners))
        worst = values[:, 0].argmax(axis=1)
        shares = middle[:, count:] + half[:, count:] * self._corners[worst]
        torque = values[np.arange(len(values)), 0, worst] + self._coulomb_at(shares)
        inertia = np.abs(terms[:, 0, 1 : 1 + count])
        states = States(middle[:, :count], shares, inertia, self.limit - torque)
        return states, (terms, values[:, 0], values[:, 1:])

    def _coulomb_at(self, shares: FloatArray) -> FloatArray:
        speed = shares[:, self.joint] * self.speed[self.joint]
        return self.coulomb * np.tanh(speed / COULOMB_SMOOTHING)

    def _bounds(self, boxes: Boxes, box: FloatArray, scale: float) -> Bounds:
        count = self.speed.size
        states, (terms, values, slopes) = self._at_corners(boxes)
        half = (boxes.high[:, :count] - boxes.low[:, :count]) / 2
        largest = np.maximum(np.abs(boxes.low), np.abs(boxes.high))[:, count:] * self.speed
        rest = self.terms.rest(half)
        swing = np.einsum("bk,bkf->bf", half, np.abs(terms[:, 1:])) + rest
        # what accelerations add: an entry that keeps its sign is as smooth as its term
        inertia, swings = terms[:, 0, 1 : 1 + count], swing[:, 1 : 1 + count]
        keeps = np.abs(inertia) >= swings
        signed = np.where(keeps, np.sign(inertia), 0.0) * box
        tilt = np.einsum("bj,bkj->bk", signed, terms[:, 1:, 1 : 1 + count])
        fixed, across = self._left_of_speeds(boxes, terms, rest, swing)
        fixed += self.coulomb * np.tanh(self.speed[self.joint] / COULOMB_SMOOTHING)
        fixed += self._margin(box, scale)
        # what is left of gravity and inertia, as (at no acceleration, for each of the scale)
        added = (np.abs(inertia) + np.where(keeps, 0.0, swings)) @ box
        tilted = slopes + scale * tilt[:, :, None]
        tangent, parabola = rest[:, : 1 + count], self.terms.rest_of_bends(half)
        bends = self._bends(states.q, signed)
        ends = []
        for rests, by in ((tangent, 0.0), (parabola, 1.0)):
            left, gained = fixed + rests[:, 0], added + (rests[:, 1:] * keeps) @ box
            at_rest = values + _largest(slopes, by * bends[0], half)
            torques = values + _largest(tilted, by * (bends[0] + scale * bends[1]), half)
            ends.append((left + at_rest.max(axis=1), left + scale * gained + torques.max(axis=1)))
        (slow, fast), (bent_slow, bent_fast) = ends
        lower = bent_fast < fast
        slow, fast = np.where(lower, bent_slow, slow), np.where(lower, bent_fast, fast)
        # a bound is convex in the scale: below this one it is under its chord from zero
        with np.errstate(divide="ignore", invalid="ignore"):
            possible = scale * (self.limit - slow) / (fast - slow)
        possible = np.where(fast > slow, possible, np.where(slow <= self.limit, np.inf, -np.inf))
        worst = torques.argmax(axis=1)
        steep = np.abs(tilted[np.arange(len(worst)), :, worst])
        accelerations = np.broadcast_to(scale * box, half.shape)
        sizes = np.hstack([np.ones((len(half), 1)), accelerations, self._pairs(largest)])
        curvature = np.tensordot(sizes, self.terms.curvature, axes=1)
        turning = np.einsum("bj,bkj->bk", ~keeps * box, np.abs(terms[:, 1:, 1 : 1 + count]))
        weights = half * (steep + np.einsum("bkl,bl->bk", curvature, half) + 2 * scale * turning)
        across[:, :count] += weights
        return Bounds(possible, states, across)

    def _left_of_speeds(
        self, boxes: Boxes, terms: FloatArray, rest: FloatArray, swing: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return what speeds add at most to the torque at the corners [B], and the shares of each
        coordinate [B,2n] in it: the rest of the terms, and what bends down in a speed.
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
        """Return second derivatives [B,n,n] of gravity and of what accelerations [B,n] add."""
        none = np.zeros((len(q), 1))
        gravity = np.hstack([none + self.side, 0.0 * signed])
        inertia = np.hstack([none, signed])
        return self.terms.bends(q, gravity), self.terms.bends(q, inertia)

    def _pairs(self, largest: FloatArray) -> FloatArray:
        first, second = pairs(self.speed.size)
        return np.where(first == second, 1.0, 2.0) * largest[:, first] * largest[:, second]

    def _margin(self, box: FloatArray, scale: float) -> float:
        """Return a torque above all errors of rounding, and of curvatures that are left out."""
        ones = np.concatenate([[1.0], scale * box, self._pairs(self.speed[None])[0]])
        return ROUNDING * (self.limit + float(self.terms.amplitude @ ones))


def _largest(slopes: FloatArray, bends: FloatArray, half: FloatArray) -> FloatArray:
    """Return bounds [B,V] of ``slope . x + x' bend x / 2`` at distances up to ``half`` [B,n], of
    slopes [B,n,V].

    Along one joint a parabola that bends down is largest where its slope is zero, or at the end.
    """
    width, each, sizes = half[:, :, None], np.arange(half.shape[1]), np.abs(slopes)
    diagonal = bends[:, each, each][:, :, None]
    top = np.minimum(width, sizes / np.maximum(-diagonal, 1e-300))
    along = np.where(diagonal < 0.0, top, width)
    own = along * (sizes + 0.5 * diagonal * along)
    mixed = np.abs(bends)
    mixed[:, each, each] = 0.0
    return own.sum(axis=1) + 0.5 * np.einsum("bi,bij,bj->b", half, mixed, half)[:, None]
