"""How far the cost of an answer may be above that of the local optimum beside it.

A barrier method stops before its inequalities act: every one that it keeps away from costs its
multiplier times the distance that is left. Of a convex program the sum of all is the gap to the
dual cost, and no other point costs less by more; of any program it is so near the optimum, to first
order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.ocp.transcription import Bounds


@dataclass(frozen=True)
class Gap:
    """What an answer may cost more than the local optimum, in the unit of the cost.

    Attributes
    ----------
    slack : multipliers times the distances to their limits, what a barrier leaves
    residuals : the rest: slopes that are not zero, times the scales of their variables, and
        multipliers times violations
    """

    slack: float
    residuals: float

    @property
    def total(self) -> float:
        """Both, the "at most" of what is printed."""
        return self.slack + self.residuals

    def __str__(self) -> str:
        """Return what follows the cost where it is printed; nothing where the gap is not known."""
        finite = np.isfinite(self.total)
        return f" (at most {self.total:.1e} above the local optimum)" if finite else ""


FLAT = 1e-3  # of the scale of the cost: a cost below it is compared with this
UNKNOWN = Gap(float("nan"), float("nan"))


def cost_size(cost: float, scale: float) -> float:
    """Return what a gap is relative to: the cost, or a share of its scale where it is less."""
    return max(abs(cost), FLAT * scale)


def gap_of(
    bounds: Bounds, x: FloatArray, rows: FloatArray, slope: FloatArray, multipliers: FloatArray
) -> Gap:
    """Return the gap of a point of a scaled program.

    Parameters
    ----------
    bounds : Bounds
    x, rows : values of the variables and rows
    slope : of the Lagrangian with all multipliers
    multipliers : of the variables, then of the rows: positive at upper bounds
    """
    low, high, distance = _distances(bounds, x, rows, multipliers)
    # a multiplier of a limit that is not there is a slope that is not zero
    distance = np.where(np.isfinite(distance), distance, -1.0)
    acts = (low < high) & (distance > 0)
    products = np.where(multipliers == 0, 0.0, np.abs(multipliers * distance))
    slack = float(products[acts].sum())
    return Gap(slack, float(products[~acts].sum() + np.abs(slope).sum()))


def complementarity(
    bounds: Bounds, x: FloatArray, rows: FloatArray, multipliers: FloatArray
) -> float:
    """Return the mean product of a multiplier and the distance to its limit, kept or not.

    It is the barrier parameter on whose path a point is: where limits were moved by much it is
    large (Nocedal and Wright, Numerical Optimization, 2nd ed., section 19.3, adaptive strategies).
    Arguments as of :func:`gap_of`; in the unit of the cost.
    """
    low, high, distance = _distances(bounds, x, rows, multipliers)
    counted = (low < high) & np.isfinite(distance)
    products = np.abs(multipliers[counted] * distance[counted])
    return float(products.mean()) if products.size else 0.0


def _distances(
    bounds: Bounds, x: FloatArray, rows: FloatArray, multipliers: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return limits, and how far the values are from those that multipliers point at."""
    low = np.concatenate([bounds.variable_lower, bounds.row_lower])
    high = np.concatenate([bounds.variable_upper, bounds.row_upper])
    value = np.concatenate([x, rows])
    with np.errstate(invalid="ignore"):
        return low, high, np.where(multipliers > 0, high - value, value - low)
