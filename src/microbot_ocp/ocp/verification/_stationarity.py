"""Conditions of Karush, Kuhn and Tucker, with derivatives of the plain kernels.

The Lagrangian of the scaled program is ``f + lam_g' g + lam_x' x``: multipliers are positive at
upper bounds and negative at lower ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.ocp.problem import node_variables
from microbot_ocp.ocp.solution import PhaseSolution, Solution, gap_of
from microbot_ocp.ocp.transcription import Bounds, Label, PhaseLayout
from microbot_ocp.ocp.verification._certificate import Optimality, Residual
from microbot_ocp.ocp.verification._reintegration import phase_layout


@dataclass(frozen=True, eq=False)
class Derivatives:
    """Derivatives of the discrete Lagrangian of one phase, stage by stage, scaled.

    Attributes
    ----------
    layout : PhaseLayout
    by_stage : of the variables of the stages in turn, without the row that a stage arrives at
    by_start, by_length : with respect to start and length of the interval, as fractions [N]
    by_point : [N+1, node size], of costs and constraints at mesh points
    end_cost : of the end costs alone [node size]
    step : multipliers of the steps [N, node size]
    """

    layout: PhaseLayout
    by_stage: FloatArray
    by_start: FloatArray
    by_length: FloatArray
    by_point: FloatArray
    end_cost: FloatArray
    step: FloatArray


def differentiate(phase: PhaseSolution, lam_g: FloatArray) -> Derivatives:
    """Return derivatives of the discrete Lagrangian of a phase with the multipliers of all rows."""
    layout = phase_layout(phase)
    assert phase.stages is not None
    n = layout.intervals
    by_stage = np.zeros_like(phase.stages)
    by_grid = np.zeros((2, n))
    step = np.zeros((n, layout.node_size))
    for group in layout.groups:
        table = layout.table(phase.stages, group)
        run = _gradient(group.kind.kernels.stage).map(group.intervals.size)
        slope, slope_of_grid = run(table.T, layout.constants(group.intervals), lam_g[group.rows].T)
        by_stage[group.variables - layout.stages.start] = slope.full().T
        by_grid[:, group.intervals] = slope_of_grid.full()[:2]
        step[group.intervals] = lam_g[group.rows[:, : layout.node_size]]
    last = [phase.values[v.name][-1] for v in node_variables(layout.phase)]
    z = np.vstack(
        [
            phase.stages[layout.nodes[:-1] - layout.stages.start],
            np.append(np.concatenate(last), phase.duration) / layout.node_scale,
        ]
    )
    by_point, end_cost = np.zeros_like(z), np.zeros(layout.node_size)
    for group in layout.points:
        run = _gradient(group.kernel.point).map(group.nodes.size)
        constants, lam = layout.point_constants(group), lam_g[group.block.places].T
        by_point[group.nodes] += run(z[group.nodes].T, constants, lam)[0].full().T
        end_cost = run(z[group.nodes].T, constants, 0 * lam)[0].full()[:, -1]  # the end comes last
    return Derivatives(
        layout=layout,
        by_stage=by_stage,
        by_start=by_grid[0],
        by_length=by_grid[1],
        by_point=by_point,
        end_cost=end_cost,
        step=step,
    )


def _symbols(function: ca.Function) -> list[Any]:
    kind = ca.SX if function.is_a("SXFunction") else ca.MX
    return [kind.sym(f"i{k}", function.size1_in(k)) for k in range(function.n_in())]


def _gradient(function: ca.Function) -> ca.Function:
    """Return slopes of the Lagrangian of a stage, or of points, with respect to its inputs."""
    v, c = _symbols(function)
    *parts, cost = function(v, c)
    signed = ca.vertcat(-parts[0], *parts[1:]) if len(parts) > 1 else parts[0]
    lam = type(v).sym("lam", signed.shape[0])
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


def bound_multipliers(
    bounds: Bounds, solution: Solution, gradient: FloatArray
) -> tuple[FloatArray, bool]:
    """Return multipliers of the bounds, and whether they had to be computed from the gradient."""
    given = solution.variable_multipliers
    if given is not None and np.size(given) == gradient.size:
        return np.asarray(given, dtype=float), False
    bounded = np.isfinite(bounds.variable_lower) | np.isfinite(bounds.variable_upper)
    return np.where(bounded, -gradient, 0.0), True


def optimality_of(
    labels: Sequence[Label],
    bounds: Bounds,
    x: FloatArray,
    g: FloatArray,
    gradient: FloatArray,
    lam_g: FloatArray,
    lam_x: FloatArray,
    computed: bool,
    cost_scale: float,
) -> Optimality:
    """Return the largest residual of every condition, in the scaled program and in its own unit.

    Labels are of the variables x, then of the rows, whose values are g.
    """
    scale = np.array([label.scale for label in labels])
    value, lam = np.concatenate([x, g]), np.concatenate([lam_x, lam_g])
    low = np.concatenate([bounds.variable_lower, bounds.row_lower])
    high = np.concatenate([bounds.variable_upper, bounds.row_upper])
    size = max(100.0 * cost_scale, float(np.mean(np.abs(lam)))) / 100.0
    excess = np.maximum(np.maximum(low - value, value - high), 0.0)
    with np.errstate(invalid="ignore"):
        distance = np.where(lam > 0, high - value, value - low)
        acts = np.isfinite(distance) & (low < high)
        slack = np.where(acts, np.abs(lam) * np.maximum(distance, 0.0), 0.0)
    # a multiplier may push towards a bound that exists only
    wrong = np.where(np.where(lam > 0, np.isinf(high), np.isinf(low)), np.abs(lam), 0.0)

    def worst(sizes: FloatArray, factor: FloatArray, unit: str, divisor: float) -> Residual:
        sizes = np.nan_to_num(sizes, nan=np.inf)
        i = int(np.argmax(sizes))
        unit_of_row = labels[i].unit or "1"
        return Residual(
            float(sizes[i] / divisor),
            float(sizes[i] * factor[i]),
            unit.format(unit_of_row),
            str(labels[i]),
        )

    residual = np.abs(gradient + lam_x)
    return Optimality(
        stationarity=worst(residual, 1 / scale[: x.size], "cost per {}", size),
        feasibility=worst(excess, scale, "{}", 1.0),
        complementarity=worst(slack, np.ones(scale.size), "cost", size),
        sign=worst(wrong, 1 / scale, "cost per {}", size),
        computed_bounds=computed,
        gap=gap_of(bounds, x, g, gradient + lam_x, lam),
    )
