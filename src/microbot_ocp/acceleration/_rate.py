"""Largest torque rate of one joint over boxes of positions.

``d tau_i/dt = sum_j M_ij qddd_j + 2 sum_jk C_ijk qd_j qdd_k + viscous qdd_i
+ sum_l qd_l d/dq_l (g_i + sum_j M_ij qdd_j + sum_jk C_ijk qd_j qd_k)``

Jerks: the rate is linear in them, as the torque is in accelerations. Accelerations: the rate is
linear in them too. Speeds: the rate is a polynomial of degree three. If each square qd_j^2 is
replaced by a free value between zero and the largest one, the polynomial is linear in every
variable, and its largest value over a box of speeds is at a corner.

Positions: in a box the slopes of the terms differ from those in the middle by their curvature.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.acceleration._demand import Boxes, Demand, ScaleBounds, States, joined


@dataclass(frozen=True, eq=False)
class RateDemand(Demand):
    """Torque rate of one joint with one payload, with equal limits on both sides.

    Attributes
    ----------
    acceleration : array [n]
        Largest accelerations, rad/s^2 (m/s^2).
    """

    acceleration: FloatArray

    @property
    def all_shares(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper ends [n] of the speed shares; the search does not split them."""
        share = np.where(self.speed > 0, 1.0, 0.0)
        return -share, share

    def _chunks(self, count: int) -> list[slice]:
        return [slice(begin, begin + 64) for begin in range(0, max(count, 1), 64)]

    def states_at(self, q: FloatArray) -> States:
        """Return the states [B] with the worst speeds and accelerations at positions [B,n]."""
        return joined([self._at(q[rows])[0] for rows in self._chunks(len(q))])

    @cached_property
    def _speeds(self) -> FloatArray:
        """Speeds [V,n] at the corners of the box of speeds, rad/s (m/s)."""
        return self._corners * self.speed

    def _at(self, q: FloatArray) -> tuple[States, FloatArray, FloatArray]:
        """Return the worst corner of the speeds, the terms [B,1 + n,F], and bounds [B] of the rate.

        A state's rate is exact at a corner; the bound holds for all speeds of the box.
        """
        count, speeds = self.speed.size, self._speeds
        terms = self.terms.at(q)
        gravity, inertia = terms[:, 1:, 0], terms[:, 1:, 1 : 1 + count]
        form = terms[:, :, 1 + count :][:, :, self._square]
        # Each acceleration takes the sign of its factor sum_j qd_j (dM_ik/dq_j + 2 C_ijk).
        paired = np.einsum("vj,bjk->bvk", speeds, inertia + 2.0 * form[:, 0], optimize=True)
        values = gravity @ speeds.T + np.abs(paired) @ self.acceleration
        values += self.viscous * self.acceleration[self.joint]
        cubic = form[:, 1:].reshape(-1, count * count)
        squares = (speeds[:, :, None] * speeds[:, None, :]).reshape(-1, count * count)
        by_speed = (cubic @ squares.T).reshape(len(q), count, -1)
        values += np.einsum("blv,vl->bv", by_speed, speeds)
        # Terms with qd_j^2 are qd_j^2 sum_k (dC_ijj/dq_k + 2 dC_ijk/dq_j) qd_k, but the cube
        # counts once: dC_ijj/dq_j qd_j^3. Where they are negative at a corner, the rate is larger
        # with qd_j^2 = 0, so the bound leaves them out.
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
        """Bounds [n] of the rate's change with each position through curvature, N m/s per rad."""
        # |curvature_kl| <= sqrt(curvature_kk curvature_ll), by Cauchy and Schwarz.
        roots = np.sqrt(np.einsum("fkk->fk", self.terms.curvature))
        sizes = np.concatenate([[1.0], self.acceleration, self._pairs(self.speed[None])[0]])
        return (sizes * (roots @ self.speed)) @ roots

    def _bounds(self, boxes: Boxes, box: FloatArray, scale: float) -> ScaleBounds:
        count = self.speed.size
        half = boxes.half[:, :count]
        states, terms, largest = self._at(boxes.middle[:, :count])
        swing = half[:, :, None] * np.abs(terms[:, 1:])
        rest = self.terms.tangent_error(half)
        # Factors of C_ijk in 2 sum_jk C_ijk qd_j qdd_k: 2 (qd_j qdd_k + qd_k qdd_j) for j < k, and
        # 2 qd_j qdd_j for j = k.
        mixed = 2.0 * np.outer(self.speed, self.acceleration)
        products = (mixed + np.triu(mixed.T, 1))[*np.triu_indices(count)]
        turned = np.concatenate([[0.0], scale * box, products])
        weights = half * self._bending + swing @ turned
        bound = largest + half @ self._bending + self._margin(box, scale)
        moved = swing.sum(axis=1) + rest
        bound += moved[:, 1 + count :] @ products
        inertia = (states.rows + moved[:, 1 : 1 + count]) @ box
        with np.errstate(divide="ignore"):
            possible = (self.limit - bound) / inertia
        return ScaleBounds(possible, states, np.hstack([weights, np.zeros_like(half)]))
