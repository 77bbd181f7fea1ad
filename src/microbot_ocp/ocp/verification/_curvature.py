"""Whether a point that meets the conditions of the first order is a minimum: the second order.

At a minimum the Lagrangian curves upwards along every direction that keeps what acts: the matrix
of the KKT conditions, with multiplier over distance for every inequality, has one negative
eigenvalue a row and no more. Its rows are eliminated here, each weighing so much that the matrix
that is left has none (Nocedal and Wright, *Numerical Optimization*, 2nd ed., theorems 16.3 and
17.5); factors L D L' tell. A guess that is symmetric leads to a point that is stationary only: a
saddle, from which the cost falls to either side.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.ocp.solution import Solution, cost_size
from microbot_ocp.ocp.transcription import Bounds, PhaseLayout, assemble
from microbot_ocp.ocp.verification._certificate import Curvature
from microbot_ocp.ocp.verification._reintegration import phase_layout

DIGITS = float(np.sqrt(np.finfo(float).eps))  # half of them: what stands for zero in the matrix


def curvature_of(
    solution: Solution,
    bounds: Bounds,
    x: FloatArray,
    g: FloatArray,
    lam: FloatArray,
    gap: float,
    size: float,
) -> Curvature:
    """Return the least curvature at a point, where it is negative by more than thresholds let pass.

    Parameters
    ----------
    solution : Solution
    bounds : Bounds
    x, g : scaled variables and rows
    lam : multipliers of the variables, then of the rows
    gap : what a move by the scales of the variables may save, relative to the cost
    size : sum of the sizes of the parts of the cost
    """
    unit = cost_size(size, solution.cost_scale) / solution.cost_scale
    least = 2 * gap * unit
    matrix = _Matrix(solution, bounds, x, g, lam, least)
    if matrix.positive(least):
        return Curvature(0.0, None)
    high = least
    while not matrix.positive(high):
        high *= 2
        if not high < 1 / DIGITS:
            return Curvature(0.0, None)
    value, direction = matrix.least(high)
    if not value < -least:
        return Curvature(0.0, None)
    return Curvature(value / unit, direction)


class _Matrix:
    """Second derivatives of the Lagrangian, of a scaled cost, with the weights of its rows."""

    def __init__(
        self,
        solution: Solution,
        bounds: Bounds,
        x: FloatArray,
        g: FloatArray,
        lam: FloatArray,
        least: float,
    ) -> None:
        layouts = [phase_layout(phase) for phase in solution.phases]
        program, scale = assemble(layouts), solution.cost_scale
        p = program.parameters
        self.free = np.flatnonzero(bounds.variable_lower < bounds.variable_upper)
        free = self.free.tolist()
        lam_x, lam_g = lam[: x.size] / scale, lam[x.size :] / scale
        hessian = program.functions["hessian"](x, p, 1 / scale, lam_g)[1][free, free]
        rows = program.functions["jacobian"](x, p)[1][:, free]
        most = max(1.0, float(ca.norm_inf(hessian.nz[:]))) / DIGITS
        bends = _stiffness(lam_x, x, bounds.variable_lower, bounds.variable_upper, most)
        keeps = _stiffness(lam_g, g, bounds.row_lower, bounds.row_upper, most)
        self.parts = hessian, bends[self.free], rows, keeps
        self.matrix = hessian + ca.diag(ca.DM(bends[self.free]))
        self.matrix += rows.T @ ca.diag(ca.DM(keeps)) @ rows
        # of the shortest intervals rounding tells more than the derivatives
        self.mass = np.maximum(_mass(layouts, x.size)[self.free], DIGITS**2 * most / least)
        self.size = x.size
        self.solver = ca.Linsol("curvature", "ldl", self.matrix.sparsity())
        self.solver.sfact(self.matrix)

    def positive(self, shift: float) -> bool:
        """Give whether no direction curves downwards by more, per mean square of what it moves."""
        moved = self.matrix + ca.diag(ca.DM(shift * self.mass))
        self.solver.nfact(moved)
        return self.solver.neig(moved) == 0

    def least(self, shift: float) -> tuple[float, FloatArray]:
        """Return the least curvature, between ``-shift`` and half of it, and its direction.

        Powers of the inverse come down to it; what they change in the digits that count for zero is
        none of it.
        """
        moved = self.matrix + ca.diag(ca.DM(shift * self.mass))
        self.solver.nfact(moved)
        d = np.cos(np.arange(self.free.size) ** 1.5)  # uneven, and always the same
        values: list[float] = []
        while len(values) < 2 or values[-2] - values[-1] > DIGITS * abs(values[-1]):
            d = np.array(self.solver.solve(moved, ca.DM(self.mass * d))).ravel()
            d /= np.sqrt(np.sum(self.mass * d**2))
            values.append(self._along(d))
        whole = np.zeros(self.size)
        whole[self.free] = d
        return values[-1], whole

    def _along(self, d: FloatArray) -> float:
        """Return the curvature along a direction, without the rounding of the sum of all parts."""
        hessian, bends, rows, keeps = self.parts
        moved = np.array(ca.mtimes(rows, ca.DM(d))).ravel()
        curvature = float(ca.mtimes([ca.DM(d).T, hessian, ca.DM(d)]))
        return curvature + float(np.sum(bends * d**2) + np.sum(keeps * moved**2))


def _stiffness(
    lam: FloatArray, value: FloatArray, low: FloatArray, high: FloatArray, most: float
) -> FloatArray:
    """Give multiplier over distance: nothing of a limit that does not act, most of an equation."""
    with np.errstate(invalid="ignore", divide="ignore"):
        distance = np.maximum(np.where(lam > 0, high - value, value - low), 0.0)
        stiffness = np.where(lam == 0, 0.0, np.abs(lam) / distance)
    return np.clip(np.where(low == high, np.inf, np.nan_to_num(stiffness)), 0.0, most)


def _mass(layouts: Sequence[PhaseLayout], size: int) -> FloatArray:
    """Return what share of its phase every variable stands for."""
    mass = np.zeros(size)
    for layout in layouts:
        steps = np.diff(layout.mesh)
        mass[layout.nodes] = np.append(steps, steps[-1])[:, None]
        for group in layout.groups:
            mass[group.variables] = steps[group.intervals, None]
    return np.where(mass > 0, mass, 1.0)
