"""The torque rate that one joint needs at most, over boxes of positions.

The rate is linear in jerks, as the torque is in accelerations. All else in it are slopes of the
terms of the torque, times speeds and accelerations: it is linear in the accelerations, and of the
third degree in the speeds, whose largest value is at a corner once squares of a speed may be
anything from zero to that of the corner. In a box of positions slopes differ from those in its
middle by their curvature.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.acceleration._demand import Bounds, Boxes, Demand, States


@dataclass(frozen=True, eq=False)
class RateDemand(Demand):
    """The torque rate of one joint, with one payload; the same on both sides of its limits.

    Attributes
    ----------
    acceleration : array [n]
        Largest accelerations, rad/s^2 (m/s^2).
    """

    acceleration: FloatArray

    @property
    def all_shares(self) -> tuple[FloatArray, FloatArray]:
        """Ends [n] of the shares of speeds, which are not split."""
        share = np.where(self.speed > 0, 1.0, 0.0)
        return -share, share

    def _chunks(self, count: int) -> list[slice]:
        return [slice(begin, begin + 64) for begin in range(0, max(count, 1), 64)]

    def states_at(self, q: FloatArray) -> States:
        """Return the worst speeds and accelerations at positions [B,n]."""
        return States.joined([self._at(q[rows])[0] for rows in self._chunks(len(q))])

    @cached_property
    def _speeds(self) -> FloatArray:
        """Speeds [V,n] at the corners."""
        return self._corners * self.speed

    def _at(self, q: FloatArray) -> tuple[States, FloatArray, FloatArray]:
        """Return the states, the terms [B,1 + n,F], and bounds [B] over all speeds."""
        count, speeds = self.speed.size, self._speeds
        terms = self.terms.at(q)
        gravity, inertia = terms[:, 1:, 0], terms[:, 1:, 1 : 1 + count]
        form = terms[:, :, 1 + count :][:, :, self._square]
        paired = np.einsum("vj,bjk->bvk", speeds, inertia + 2.0 * form[:, 0], optimize=True)
        values = gravity @ speeds.T + np.abs(paired) @ self.acceleration
        values += self.viscous * self.acceleration[self.joint]
        cubic = form[:, 1:].reshape(-1, count * count)
        squares = (speeds[:, :, None] * speeds[:, None, :]).reshape(-1, count * count)
        by_speed = (cubic @ squares.T).reshape(len(q), count, -1)
        values += np.einsum("blv,vl->bv", by_speed, speeds)
        # without the square of a speed the terms that have it may be missed, if they are negative
        each = np.arange(count)
        twice = np.swapaxes(form[:, 1:][:, :, each, each], 1, 2) + 2.0 * form[:, 1 + each, each]
        twice[:, each, each] /= 3.0
        missed = np.einsum("bjk,vk,j->bvj", twice, speeds, self.speed**2, optimize=True)
        bounds = values + np.maximum(0.0, -missed).sum(axis=2)
        worst = values.argmax(axis=1)
        room = self.limit - values[np.arange(len(q)), worst]
        states = States(q, self._corners[worst], np.abs(terms[:, 0, 1 : 1 + count]), room)
        return states, terms, bounds.max(axis=1)

    @cached_property
    def _bending(self) -> FloatArray:
        """How much all slopes together may change with each position [n], N m/s."""
        count = self.speed.size
        roots = np.sqrt(np.einsum("fkk->fk", self.terms.curvature))  # a mixed one is their product
        sizes = np.concatenate([[1.0], self.acceleration, self._pairs(self.speed[None])[0]])
        return (sizes * (roots @ self.speed)) @ roots + np.zeros(count)

    def _bounds(self, boxes: Boxes, box: FloatArray, scale: float) -> Bounds:
        count = self.speed.size
        middle, half = (boxes.low + boxes.high) / 2, (boxes.high - boxes.low) / 2
        half = half[:, :count]
        states, terms, largest = self._at(middle[:, :count])
        swing = half[:, :, None] * np.abs(terms[:, 1:])
        rest = self.terms.rest(half)
        products = 2.0 * np.outer(self.speed, self.acceleration)[*np.triu_indices(count)]
        products += 2.0 * np.outer(self.acceleration, self.speed)[*np.triu_indices(count)]
        products[np.equal(*np.triu_indices(count))] /= 2.0
        turned = np.concatenate([[0.0], scale * box, products])
        weights = half * self._bending + swing @ turned
        bound = largest + half @ self._bending + self._margin(box, scale)
        moved = swing.sum(axis=1) + rest
        bound += moved[:, 1 + count :] @ products
        inertia = (states.rows + moved[:, 1 : 1 + count]) @ box
        with np.errstate(divide="ignore"):
            possible = (self.limit - bound) / inertia
        return Bounds(possible, states, np.hstack([weights, np.zeros_like(half)]))
