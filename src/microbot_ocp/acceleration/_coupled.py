"""Torque demand over an ellipsoid of joint speeds instead of a box.

With u_j = qd_j / speed_j the speeds fill the ball ``|u| <= radius``. A quadratic form ``u' C u`` is
largest there along the eigenvector of its largest eigenvalue: ``radius^2 max(0, lambda_max(C))``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.acceleration._demand import Boxes, Demand, States


@dataclass(frozen=True, eq=False)
class CoupledDemand(Demand):
    """Torque demand of one joint with the Euclidean norm of the speed shares bounded.

    Attributes
    ----------
    radius : float
        Largest norm of the shares ``qd_j / speed_j``. With 1, one joint alone may reach its
        largest speed.
    """

    radius: float

    @property
    def all_shares(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper ends [n] of the speed shares; the search does not split them."""
        share = np.where(self.speed > 0, min(1.0, self.radius), 0.0)
        return -share, share

    def _states(
        self, boxes: Boxes, terms: FloatArray, at_corners: FloatArray | None = None
    ) -> States:
        count = self.speed.size
        sizes, directions = np.linalg.eigh(self._forms(terms[:, 0, 1 + count :]))
        # The state has to be possible: no share exceeds 1, and the joint's own speed is positive.
        shares = self.radius * directions[:, :, -1] * (sizes[:, -1:] > 0.0)
        shares = shares / np.maximum(1.0, np.abs(shares).max(axis=1, keepdims=True))
        shares *= np.where(shares[:, self.joint] < 0.0, -1.0, 1.0)[:, None]
        speeds = shares * self.speed
        torque = terms[:, 0, 0] + self.viscous * speeds[:, self.joint] + self._coulomb_at(shares)
        form = terms[:, 0, 1 + count :][:, self._square]
        torque += np.einsum("bj,bjk,bk->b", speeds, form, speeds)
        inertia = np.abs(terms[:, 0, 1 : 1 + count])
        return States(boxes.middle[:, :count], shares, inertia, self.limit - torque)

    def _at_corners(self, boxes: Boxes, terms: FloatArray) -> FloatArray:
        count = self.speed.size
        sizes = np.linalg.eigvalsh(self._forms(terms[:, 0, 1 + count :]))
        # The bound adds the maxima of friction and of the form, reached at different speeds.
        most = self.viscous * self.speed[self.joint] * min(1.0, self.radius)
        gravity = terms[:, :, :1].copy()
        gravity[:, 0, 0] += most + self.radius**2 * np.maximum(0.0, sizes[:, -1])
        return gravity

    def _coriolis_excess(
        self,
        boxes: Boxes,
        half: FloatArray,
        terms: FloatArray,
        rest: FloatArray,
        swing: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        count = self.speed.size
        # |u' A u| <= radius^2 |A| in the spectral norm, which the Frobenius norm bounds.
        turned = np.abs(np.linalg.eigvalsh(self._forms(terms[:, 1:, 1 + count :]))).max(axis=2)
        across = self.radius**2 * half * turned
        curved = np.linalg.norm(self._forms(rest[:, 1 + count :]), axis=(1, 2))
        left = across.sum(axis=1) + self.radius**2 * curved
        return left, np.hstack([across, np.zeros_like(half)])

    def _forms(self, entries: FloatArray) -> FloatArray:
        """Return the form in the shares as matrices [...,n,n] from coefficients [...,P]."""
        return entries[..., self._square] * np.outer(self.speed, self.speed)
