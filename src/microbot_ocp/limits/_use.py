"""How much of a limit a value uses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.robot import JointLimits

ROUNDING = 1e-9  # excess over a limit, relative, that is put down to rounding


@dataclass(frozen=True, eq=False)
class LimitUse:
    """How much of a limit a value uses, joint by joint: 0 at rest or mid-range, 1 at the limit.

    For q it is the distance from the middle of the range, divided by half the range (one-sided
    limits: 1 plus the excess over the limit, divided by the limit). For the other quantities, whose
    limits have zero between them, it is the value divided by the limit of its sign.

    Attributes
    ----------
    quantity : "q", "qd", "qdd", "tau" or "taud"
    lower, upper : array [n]
    lower_scale, upper_scale : array [n]
        Excess over the limit that counts as 1.
    """

    quantity: str
    lower: FloatArray
    upper: FloatArray
    lower_scale: FloatArray
    upper_scale: FloatArray

    @classmethod
    def of(cls, limits: JointLimits, quantity: str) -> LimitUse:
        """The use of one kind of limit."""
        lower, upper = limits.bounds(quantity)
        span = upper - lower
        scales = []
        for bound in (lower, upper):
            scale = np.where(np.isfinite(bound) & (bound != 0), np.abs(bound), 1.0)
            if quantity == "q":
                scale = np.where(np.isfinite(span) & (span > 0), 0.5 * span, scale)
            scales.append(scale)
        return cls(quantity, lower, upper, scales[0], scales[1])

    @property
    def limited(self) -> np.ndarray:
        """Which joints [n] have such a limit, on either side."""
        return np.isfinite(self.lower) | np.isfinite(self.upper)

    def __call__(self, values: FloatArray) -> FloatArray:
        """Use [..., n] of values [..., n]; minus infinity where there is no limit."""
        above = self._side(values - self.upper, self.upper, self.upper_scale)
        below = self._side(self.lower - values, self.lower, self.lower_scale)
        return np.maximum(above, below)

    def _side(self, excess: FloatArray, bound: FloatArray, scale: FloatArray) -> FloatArray:
        use = 1.0 + excess / scale
        if self.quantity != "q":
            # A limit of zero (a joint that must not move that way) is not "used" at rest.
            at_zero = (bound == 0) & (excess <= ROUNDING * scale)
            use = np.where(at_zero, np.minimum(use - 1.0, 0.0), use)
        return use

    def limit(self, value: float, joint: int) -> float:
        """The limit of this joint (lower or upper) that the value is nearer to or beyond."""
        values = np.full(self.lower.size, value)
        above = self._side(values - self.upper, self.upper, self.upper_scale)[joint]
        below = self._side(self.lower - values, self.lower, self.lower_scale)[joint]
        return float(self.upper[joint] if above >= below else self.lower[joint])

    def violation(self, use: float, value: float, joint: int) -> float:
        """Excess over the limit, divided by the limit (by the range for q); 0 where kept."""
        if not use > 1.0:
            return 0.0
        limit = self.limit(value, joint)
        excess = abs(value - limit)
        span = self.upper[joint] - self.lower[joint]
        if self.quantity == "q" and np.isfinite(span) and span > 0:
            return float(excess / span)
        return float(excess / (abs(limit) or 1.0))
