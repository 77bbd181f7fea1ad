"""Karush-Kuhn-Tucker conditions of first and second order.

The Lagrangian of the scaled program is ``f + lam_g' g + lam_x' x``: multipliers are positive at
upper bounds and negative at lower ones. Its derivatives are formed here from the values of the
kernels, not taken from the program that was solved.

Second order: at a minimum the KKT matrix, with multiplier over distance on the diagonal of every
inequality, has exactly one negative eigenvalue per row. Eliminating the rows leaves the condensed
matrix ``H + S_x + J' S_g J``, which must be positive definite (Nocedal and Wright, *Numerical
Optimization*, 2nd ed., theorems 16.3 and 17.5); the inertia of its factors L D L' decides. A
symmetric initial guess can converge to a stationary point that is a saddle, from which the cost
decreases on both sides.

Theory: docs/theory/certificates.md, equation (4).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.ocp.problem import node_variables
from microbot_ocp.ocp.solution import PhaseSolution, Solution, cost_size, gap_of
from microbot_ocp.ocp.transcription import Bounds, Label, PhaseLayout, assemble
from microbot_ocp.ocp.verification._certificate import Curvature, Optimality, Residual


@dataclass(frozen=True, eq=False)
class Derivatives:
    """Scaled derivatives of the discrete Lagrangian of one phase.

    Attributes
    ----------
    layout : PhaseLayout
    by_stage : with respect to the stage variables, stage by stage, without the step multipliers
    by_start, by_length : with respect to start and length of an interval, as fractions of the
        phase [N]
    by_point : costs and constraints at mesh points, with respect to the node [N+1, node size]
    end_cost : end costs, with respect to the last node [node size]
    step : multipliers of the step rows [N, node size]
    """

    layout: PhaseLayout
    by_stage: FloatArray
    by_start: FloatArray
    by_length: FloatArray
    by_point: FloatArray
    end_cost: FloatArray
    step: FloatArray


def differentiate(phase: PhaseSolution, lam_g: FloatArray) -> Derivatives:
    """Return derivatives of the discrete Lagrangian of a phase for given row multipliers."""
    layout = phase.laid_out
    assert phase.stages is not None
    intervals, of_stages = np.arange(layout.intervals), lam_g[layout.stage_rows]
    table = layout.table(phase.stages)
    run = _gradient(layout.kind.kernels.stage.value).map(intervals.size)
    slope, slope_of_grid = run(table.T, layout.constants(intervals), of_stages.T)
    by_grid = slope_of_grid.full()
    last = [*(phase.values[v.name][-1] for v in node_variables(layout.phase)), [phase.duration]]
    inner = phase.stages[layout.nodes[:-1] - layout.stages.start]
    z = np.vstack([inner, np.concatenate(last) / layout.node_scale])
    by_point, end_cost = np.zeros_like(z), np.zeros(layout.node_size)
    for group in layout.points:
        run = _gradient(group.kernel.value).map(group.nodes.size)
        constants, lam = layout.point_constants(group), lam_g[group.block.places].T
        by_point[group.nodes] += run(z[group.nodes].T, constants, lam)[0].full().T
        end_cost = run(z[group.nodes].T, constants, 0 * lam)[0].full()[:, -1]  # the last is the end
    return Derivatives(
        layout=layout,
        by_stage=slope.full().T.ravel(),
        by_start=by_grid[0],
        by_length=by_grid[1],
        by_point=by_point,
        end_cost=end_cost,
        step=of_stages[:, : layout.node_size],
    )


def _gradient(function: ca.Function) -> ca.Function:
    """Return the gradient of a kernel's Lagrangian with respect to its inputs v and c."""
    kind: Any = ca.SX if function.is_a("SXFunction") else ca.MX
    v, c = (kind.sym(name, function.size1_in(k)) for k, name in enumerate("vc"))
    *parts, cost = function(v, c)
    signed = ca.vertcat(-parts[0], *parts[1:]) if len(parts) > 1 else parts[0]
    lam = kind.sym("lam", signed.shape[0])
    lagrangian = cost + ca.dot(lam, signed)
    slopes = [ca.densify(ca.gradient(lagrangian, w)) for w in (v, c)]
    return ca.Function("gradient", [v, c, lam], slopes)


def lagrangian_gradient(parts: Sequence[Derivatives], lam_g: FloatArray) -> FloatArray:
    """Return ``grad f + J' lam_g`` of the scaled program."""
    gradient = np.zeros(sum(part.layout.variable_count for part in parts))
    for part in parts:
        layout = part.layout
        gradient[layout.stages] += part.by_stage
        gradient[layout.nodes[1:]] += part.step
        gradient[layout.nodes] += part.by_point
        for block, node in ((layout.initial, layout.nodes[0]), (layout.final, layout.nodes[-1])):
            gradient[node[layout.node_columns(block)]] += lam_g[block.places[0]]
        lam_link = lam_g[layout.link.places[0]]
        gradient[layout.targets] += lam_link
        gradient[layout.sources] -= layout.factors * lam_link
    return gradient


class Point(NamedTuple):
    """A solution as a point of its scaled program.

    Attributes
    ----------
    labels : labels of the variables followed by those of the rows
    bounds : Bounds
    x, g : values of the variables and rows
    gradient : ``grad f + J' lam_g``
    lam_x, lam_g : multipliers of the bounds and rows
    computed : True if the bound multipliers were computed from the gradient
    """

    labels: Sequence[Label]
    bounds: Bounds
    x: FloatArray
    g: FloatArray
    gradient: FloatArray
    lam_x: FloatArray
    lam_g: FloatArray
    computed: bool

    @property
    def multipliers(self) -> FloatArray:
        """Multipliers of the variables followed by those of the rows."""
        return np.concatenate([self.lam_x, self.lam_g])


def bound_multipliers(
    bounds: Bounds, solution: Solution, gradient: FloatArray
) -> tuple[FloatArray, bool]:
    """Return bound multipliers, and True if they were computed from the gradient."""
    given = solution.variable_multipliers
    if given is not None and np.size(given) == gradient.size:
        return np.asarray(given, dtype=float), False
    bounded = np.isfinite(bounds.variable_lower) | np.isfinite(bounds.variable_upper)
    return np.where(bounded, -gradient, 0.0), True


def optimality_of(point: Point, cost_scale: float) -> Optimality:
    """Return the largest residual of every condition, scaled and in the unit of its quantity."""
    labels, bounds, x, g, gradient, lam_x, _, computed = point
    scale = np.array([label.scale for label in labels])
    value, lam = np.concatenate([x, g]), point.multipliers
    low = np.concatenate([bounds.variable_lower, bounds.row_lower])
    high = np.concatenate([bounds.variable_upper, bounds.row_upper])
    size = max(100.0 * cost_scale, float(np.mean(np.abs(lam)))) / 100.0
    excess = np.maximum(np.maximum(low - value, value - high), 0.0)
    with np.errstate(invalid="ignore"):
        distance = np.where(lam > 0, high - value, value - low)
        acts = np.isfinite(distance) & (low < high)
        slack = np.where(acts, np.abs(lam) * np.maximum(distance, 0.0), 0.0)
    # Dual feasibility: the multiplier of an infinite bound must be zero.
    wrong = np.where(np.where(lam > 0, np.isinf(high), np.isinf(low)), np.abs(lam), 0.0)

    def worst(sizes: FloatArray, factor: FloatArray, unit: str, divisor: float) -> Residual:
        sizes = np.nan_to_num(sizes, nan=np.inf)
        i = int(np.argmax(sizes))
        amounts = float(sizes[i] / divisor), float(sizes[i] * factor[i])
        return Residual(*amounts, unit.format(labels[i].unit or "1"), str(labels[i]))

    residual = np.abs(gradient + lam_x)
    return Optimality(
        stationarity=worst(residual, 1 / scale[: x.size], "cost per {}", size),
        feasibility=worst(excess, scale, "{}", 1.0),
        complementarity=worst(slack, np.ones(scale.size), "cost", size),
        sign=worst(wrong, 1 / scale, "cost per {}", size),
        computed_bounds=computed,
        gap=gap_of(bounds, x, g, gradient + lam_x, lam),
    )


DIGITS = float(np.sqrt(np.finfo(float).eps))  # relative size of a numerical zero in the matrix


def curvature_of(solution: Solution, point: Point, gap: float, size: float) -> Curvature:
    """Return the least curvature at a point if it is more negative than the threshold.

    ``gap`` is the allowed decrease, relative to the cost, of a move by the scales of the
    variables; ``size`` is the sum of the magnitudes of the terms of the cost.
    """
    unit = cost_size(size, solution.cost_scale) / solution.cost_scale
    least = 2 * gap * unit
    matrix = _CondensedMatrix(solution, point, least)
    if matrix.positive(least):
        return Curvature(0.0, None)
    # Double the shift until matrix + shift * mass is positive definite: the least generalised
    # eigenvalue then lies between -shift and -shift / 2.
    high = least
    while not matrix.positive(high):
        high *= 2
        if not high < 1 / DIGITS:
            return Curvature(0.0, None)
    value, direction = matrix.least(high)
    if not value < -least:
        return Curvature(0.0, None)
    return Curvature(value / unit, direction)


class _CondensedMatrix:
    """Hessian of the Lagrangian plus ``S_x + J' S_g J``, for a scaled cost."""

    def __init__(self, solution: Solution, point: Point, least: float) -> None:
        layouts = [phase.laid_out for phase in solution.phases]
        program, scale = assemble(layouts), solution.cost_scale
        bounds, x = point.bounds, point.x
        p = program.parameters
        self.free = np.flatnonzero(bounds.variable_lower < bounds.variable_upper)
        free = self.free.tolist()
        lam_x, lam_g = point.lam_x / scale, point.lam_g / scale
        hessian = program.functions["hessian"](x, p, 1 / scale, lam_g)[1][free, free]
        rows = program.functions["jacobian"](x, p)[1][:, free]
        # Weights beyond this bound would drown the Hessian in rounding.
        most = max(1.0, float(ca.norm_inf(hessian.nz[:]))) / DIGITS
        bound_weights = _stiffness(lam_x, x, bounds.variable_lower, bounds.variable_upper, most)
        row_weights = _stiffness(lam_g, point.g, bounds.row_lower, bounds.row_upper, most)
        self.parts = hessian, bound_weights[self.free], rows, row_weights
        self.matrix = hessian + ca.diag(ca.DM(bound_weights[self.free]))
        self.matrix += rows.T @ ca.diag(ca.DM(row_weights)) @ rows
        # On very short intervals rounding exceeds the derivatives: bound the mass from below.
        self.mass = np.maximum(_mass(layouts, x.size)[self.free], DIGITS**2 * most / least)
        self.size = x.size
        self.solver = ca.Linsol("curvature", "ldl", self.matrix.sparsity())
        self.solver.sfact(self.matrix)

    def positive(self, shift: float) -> bool:
        """Return True if ``matrix + shift * mass`` is positive definite."""
        moved = self.matrix + ca.diag(ca.DM(shift * self.mass))
        self.solver.nfact(moved)
        return self.solver.neig(moved) == 0

    def least(self, shift: float) -> tuple[float, FloatArray]:
        """Return the least curvature, between ``-shift`` and ``-shift / 2``, and its direction.

        Inverse iteration, stopped when the value changes by less than its numerical accuracy.
        """
        moved = self.matrix + ca.diag(ca.DM(shift * self.mass))
        self.solver.nfact(moved)
        # Inverse iteration d <- (matrix + shift mass)^-1 mass d: the eigenvalue nearest to -shift.
        d = np.random.default_rng(0).standard_normal(self.free.size)
        values: list[float] = []
        while len(values) < 2 or values[-2] - values[-1] > DIGITS * abs(values[-1]):
            d = np.array(self.solver.solve(moved, ca.DM(self.mass * d))).ravel()
            d /= np.sqrt(np.sum(self.mass * d**2))
            values.append(self._along(d))
        whole = np.zeros(self.size)
        whole[self.free] = d
        return values[-1], whole

    def _along(self, d: FloatArray) -> float:
        """Return ``d' matrix d``, added up term by term: the assembled matrix loses digits."""
        hessian, bound_weights, rows, row_weights = self.parts
        moved = np.array(ca.mtimes(rows, ca.DM(d))).ravel()
        curvature = float(ca.mtimes([ca.DM(d).T, hessian, ca.DM(d)]))
        return curvature + float(np.sum(bound_weights * d**2) + np.sum(row_weights * moved**2))


def _stiffness(
    lam: FloatArray, value: FloatArray, low: FloatArray, high: FloatArray, most: float
) -> FloatArray:
    """Return multiplier over distance: 0 for an inactive limit, ``most`` for an equation."""
    with np.errstate(invalid="ignore", divide="ignore"):
        distance = np.maximum(np.where(lam > 0, high - value, value - low), 0.0)
        stiffness = np.where(lam == 0, 0.0, np.abs(lam) / distance)
    return np.clip(np.where(low == high, np.inf, np.nan_to_num(stiffness)), 0.0, most)


def _mass(layouts: Sequence[PhaseLayout], size: int) -> FloatArray:
    """Return the fraction of its phase that every variable represents."""
    mass = np.zeros(size)
    for layout in layouts:
        steps = np.diff(layout.mesh)
        mass[layout.nodes] = np.append(steps, steps[-1])[:, None]
        mass[layout.stage_variables] = steps[:, None]
    return np.where(mass > 0, mass, 1.0)
