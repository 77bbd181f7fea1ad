"""Torques at speeds that are not the largest in all joints at once: within an ellipsoid.

Over a ball of shares of the speeds a quadratic form is largest along an eigenvector, and at most
its largest eigenvalue times the square of the radius.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.acceleration._demand import Boxes, Demand, States


@dataclass(frozen=True, eq=False)
class CoupledDemand(Demand):
    """The torque of a joint where the root of the sum of squared shares of speeds is bounded.

    Attributes
    ----------
    radius : float
        The bound: 1 for one joint at its largest speed, or all at a part of it.
    """

    radius: float

    @property
    def all_shares(self) -> tuple[FloatArray, FloatArray]:
        """Ends [n] of the shares of speeds, which are not split."""
        share = np.where(self.speed > 0, min(1.0, self.radius), 0.0)
        return -share, share

    def _at_corners(self, boxes: Boxes) -> tuple[States, tuple[FloatArray, ...]]:
        count = self.speed.size
        middle = ((boxes.low + boxes.high) / 2)[:, :count]
        terms = self.terms.at(middle)
        terms[:, :, 0] *= self.side
        terms[:, :, 1 + count :] *= self.side
        sizes, directions = np.linalg.eigh(self._forms(terms[:, 0, 1 + count :]))
        shares = self.radius * directions[:, :, -1] * (sizes[:, -1:] > 0.0)
        shares = shares / np.maximum(1.0, np.abs(shares).max(axis=1, keepdims=True))
        shares *= np.where(shares[:, self.joint] < 0.0, -1.0, 1.0)[:, None]
        speeds = shares * self.speed
        torque = terms[:, 0, 0] + self.viscous * speeds[:, self.joint] + self._coulomb_at(shares)
        form = terms[:, 0, 1 + count :][:, self._square]
        torque += np.einsum("bj,bjk,bk->b", speeds, form, speeds)
        inertia = np.abs(terms[:, 0, 1 : 1 + count])
        states = States(middle, shares, inertia, self.limit - torque)
        most = self.viscous * self.speed[self.joint] * min(1.0, self.radius)
        most = terms[:, 0, 0] + most + self.radius**2 * np.maximum(0.0, sizes[:, -1])
        return states, (terms, most[:, None], terms[:, 1:, :1])

    def _left_of_speeds(
        self, boxes: Boxes, terms: FloatArray, rest: FloatArray, swing: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        count = self.speed.size
        half = ((boxes.high - boxes.low) / 2)[:, :count]
        turned = np.abs(np.linalg.eigvalsh(self._forms(terms[:, 1:, 1 + count :]))).max(axis=2)
        across = self.radius**2 * half * turned
        curved = np.linalg.norm(self._forms(rest[:, 1 + count :]), axis=(1, 2))
        left = across.sum(axis=1) + self.radius**2 * curved
        return left, np.hstack([across, np.zeros_like(half)])

    def _forms(self, entries: FloatArray) -> FloatArray:
        """Return forms [...,n,n] of the shares of speeds from entries [...,P] of the speeds."""
        return entries[..., self._square] * np.outer(self.speed, self.speed)
