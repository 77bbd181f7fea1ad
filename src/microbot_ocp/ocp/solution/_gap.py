"""Estimate of the cost of a solution above that of the nearby local optimum.

A barrier method stops before its inequalities are active: each of them costs its multiplier times
its remaining distance. For a convex program the sum of these products is the duality gap, so no
point is cheaper by more; for other programs it is that gap to first order near the optimum.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.ocp.transcription import Bounds


@dataclass(frozen=True)
class Gap:
    """Estimate of the cost above the local optimum, in the unit of the cost.

    Attributes
    ----------
    slack : sum of multipliers times distances to their limits, left by a barrier
    residuals : sum of the other terms: gradients of the Lagrangian times the scales of their
        variables, and multipliers times violations
    """

    slack: float
    residuals: float

    @property
    def total(self) -> float:
        """Sum of both parts, printed as the "at most" of a cost."""
        return self.slack + self.residuals

    def __str__(self) -> str:
        """Return the text printed behind the cost; empty if the gap is unknown."""
        finite = np.isfinite(self.total)
        return f" (at most {self.total:.1e} above the local optimum)" if finite else ""


FLAT = 1e-3  # least size of a cost, relative to its scale
UNKNOWN = Gap(float("nan"), float("nan"))


def cost_size(cost: float, scale: float) -> float:
    """Return the size that a gap is relative to: the cost, or a fraction of its scale if larger."""
    return max(abs(cost), FLAT * scale)


def gap_of(
    bounds: Bounds, x: FloatArray, rows: FloatArray, slope: FloatArray, multipliers: FloatArray
) -> Gap:
    """Return the gap of a point of a scaled program.

    Parameters
    ----------
    bounds : Bounds
    x, rows : values of the variables and rows
    slope : gradient of the Lagrangian with all multipliers
    multipliers : multipliers of the variables followed by the rows, positive at upper bounds
    """
    low, high, distance = _distances(bounds, x, rows, multipliers)
    # A multiplier of an infinite limit is a residual: mark it by a negative distance.
    distance = np.where(np.isfinite(distance), distance, -1.0)
    acts = (low < high) & (distance > 0)
    products = np.where(multipliers == 0, 0.0, np.abs(multipliers * distance))
    slack = float(products[acts].sum())
    return Gap(slack, float(products[~acts].sum() + np.abs(slope).sum()))


def complementarity(
    bounds: Bounds, x: FloatArray, rows: FloatArray, multipliers: FloatArray
) -> float:
    """Return the mean product of a multiplier and the distance to its limit, violated or not.

    This is the barrier parameter of the central path near the point; it is large if limits were
    moved far (Nocedal and Wright, Numerical Optimization, 2nd ed., section 19.3, adaptive
    strategies). Arguments as in :func:`gap_of`; unit of the cost.
    """
    low, high, distance = _distances(bounds, x, rows, multipliers)
    counted = (low < high) & np.isfinite(distance)
    products = np.abs(multipliers[counted] * distance[counted])
    return float(products.mean()) if products.size else 0.0


def _distances(
    bounds: Bounds, x: FloatArray, rows: FloatArray, multipliers: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return lower limits, upper limits, and distances to the limits with a multiplier."""
    low = np.concatenate([bounds.variable_lower, bounds.row_lower])
    high = np.concatenate([bounds.variable_upper, bounds.row_upper])
    value = np.concatenate([x, rows])
    with np.errstate(invalid="ignore"):
        return low, high, np.where(multipliers > 0, high - value, value - low)
