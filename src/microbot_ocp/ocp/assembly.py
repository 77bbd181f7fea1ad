"""The nonlinear program in stages: kernels mapped over the mesh, nonzeros put in their places.

For each phase the variables are (z_0, w_0, z_1, w_1, ..., z_N, transition) and the rows
``[z_1 - next(z_0, w_0), constraints_0, start conditions, z_2 - next(z_1, w_1), constraints_1, ...,
link to the next phase, end constraints, end conditions]``: the block order that fatrop wants, and a
banded matrix for everyone else.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp.checks import FloatArray
from microbot_ocp.ocp.problem import Link, OptimalControlProblem, node_variables
from microbot_ocp.ocp.transcription import Kernels, PhaseLayout, condition_bounds, joined


@dataclass(frozen=True, eq=False)
class Program:
    """A nonlinear program in stages, ready for a solver.

    Attributes
    ----------
    layouts : where each phase stands
    nlp : ``x``, ``f`` and ``g`` as expressions, and ``p`` where phase parameters may change
    functions : derivatives: ``jacobian(x, p) -> g, J``, ``gradient(x, p) -> f, grad``,
        ``hessian(x, p, lam_f, lam_g) -> H`` and its upper triangle ``hessian_upper``
    variable_lower, variable_upper, row_lower, row_upper : bounds, scaled
    nodes, controls, constraints : sizes of z, w and the constraints, stage by stage
    parameters : values of p as declared; empty where the parameters are constants of the program
    """

    layouts: tuple[PhaseLayout, ...]
    links: tuple[Link, ...]
    nlp: Mapping[str, ca.MX]
    functions: Mapping[str, ca.Function]
    variable_lower: FloatArray
    variable_upper: FloatArray
    row_lower: FloatArray
    row_upper: FloatArray
    nodes: tuple[int, ...]
    controls: tuple[int, ...]
    constraints: tuple[int, ...]
    parameters: FloatArray


class _Entries:
    """Entries of a sparse matrix, gathered block by block."""

    def __init__(self) -> None:
        self.rows: list[np.ndarray] = []
        self.columns: list[np.ndarray] = []
        self.values: list[ca.MX] = []

    def add(self, rows: ArrayLike, columns: ArrayLike, values: ca.MX | FloatArray) -> None:
        self.rows.append(np.asarray(rows, dtype=int).ravel())
        self.columns.append(np.asarray(columns, dtype=int).ravel())
        # the nonzeros of a single row come as a row
        self.values.append(ca.vec(values) if isinstance(values, ca.MX) else ca.MX(ca.DM(values)))

    def matrix(self, height: int, width: int, *, upper: bool = False) -> ca.MX:
        rows, columns = np.concatenate(self.rows), np.concatenate(self.columns)
        keep = np.flatnonzero(rows <= columns) if upper else np.arange(rows.size)
        order = keep[np.lexsort((rows[keep], columns[keep]))]
        sparsity = ca.Sparsity.triplet(height, width, rows[order].tolist(), columns[order].tolist())
        return ca.MX(sparsity, ca.vertcat(*self.values)[order.tolist()])


def assemble(
    problem: OptimalControlProblem,
    layouts: Sequence[PhaseLayout],
    kernels: Sequence[Kernels],
    *,
    parametric: bool = False,
) -> Program:
    """Put the stages of all phases together.

    With ``parametric`` the phase parameters are arguments p of the program, else constants in it.
    """
    last = layouts[-1]
    width = last.variable_offset + last.variable_count
    height = last.row_offset + last.row_count
    x = ca.MX.sym("x", width)
    declared = [phase_constants(layout) for layout in layouts]
    parameters = joined(declared) if parametric else np.zeros(0)
    p = ca.MX.sym("p", parameters.size)
    offsets = np.cumsum([0, *(d.size for d in declared)]).tolist()
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", height)
    cost, rows = ca.MX(0), []
    cost_again, rows_again, gradient = ca.MX(0), [], []
    jacobian, hessian = _Entries(), _Entries()
    for index, (layout, kernel) in enumerate(zip(layouts, kernels, strict=True)):
        after = layouts[index + 1] if index + 1 < len(layouts) else None
        link = _link_rows(problem, index, layout, after, x)
        begin, end = offsets[index : index + 2]
        constants = p[begin:end] if parametric else ca.MX(ca.DM(declared[index]))
        piece = _PhasePiece(layout, kernel, x, constants)
        f, g = piece.values(link.values)
        cost, rows = cost + f, [*rows, g]
        f, g, slope = piece.first_order(link.values, jacobian)
        cost_again, rows_again, gradient = cost_again + f, [*rows_again, g], [*gradient, slope]
        jacobian.add(layout.last_row + link.rows, link.columns, link.entries)
        piece.second_order(lam_f, lam_g, hessian)
    bounds = [phase_bounds(layout, kernel) for layout, kernel in zip(layouts, kernels, strict=True)]
    curvature = [x, p, lam_f, lam_g]
    slope_of_p = ca.MX.zeros(parameters.size)  # solvers take it only if they are asked for it
    # solvers take the gradient for dense, whatever its sparsity says
    g_again, slope = ca.vertcat(*rows_again), ca.densify(ca.vertcat(*gradient))
    jacobian_matrix = jacobian.matrix(height, width)
    stationarity = lam_f * slope + jacobian_matrix.T @ lam_g
    functions = {
        "lagrangian": ca.Function(
            "nlp_grad", curvature, [cost_again, g_again, stationarity, slope_of_p]
        ),
        "jacobian": ca.Function("nlp_jac_g", [x, p], [g_again, jacobian_matrix]),
        "gradient": ca.Function("nlp_grad_f", [x, p], [cost_again, slope]),
        "gradient_only": ca.Function("nlp_grad_f", [x, p], [slope]),
        "hessian": ca.Function(
            "nlp_hess_l", curvature, [ca.MX(width, 1), hessian.matrix(width, width)]
        ),
        "hessian_upper": ca.Function(
            "nlp_hess_l", curvature, [hessian.matrix(width, width, upper=True)]
        ),
    }
    return Program(
        layouts=tuple(layouts),
        links=tuple(problem.links),
        nlp={"x": x, "f": cost, "g": ca.vertcat(*rows), **({"p": p} if parametric else {})},
        functions=functions,
        variable_lower=joined([b.variables[0] for b in bounds]),
        variable_upper=joined([b.variables[1] for b in bounds]),
        row_lower=joined([b.rows[0] for b in bounds]),
        row_upper=joined([b.rows[1] for b in bounds]),
        nodes=tuple(n for k in layouts for n in [k.node_size] * (k.intervals + 1)),
        controls=tuple(
            n for k in layouts for n in ([k.control_size] * k.intervals + [k.transition])
        ),
        constraints=tuple(
            n
            for k in layouts
            for n in (
                [k.stage_rows + len(k.initial_rows)]
                + [k.stage_rows] * (k.intervals - 1)
                + [k.end_rows + len(k.final_rows)]
            )
        ),
        parameters=parameters,
    )


def phase_constants(layout: PhaseLayout) -> FloatArray:
    """Declared values of the parameters of a phase, in one array."""
    return joined([p.value for p in layout.phase.parameters])


class _PhasePiece:
    """Values and derivatives of one phase as expressions of all variables."""

    def __init__(self, layout: PhaseLayout, kernel: Kernels, x: ca.MX, constants: ca.MX) -> None:
        n, s, nz = layout.intervals, layout.stage_size, layout.node_size
        first, last = layout.variable_offset, layout.last_node
        self.layout, self.kernel = layout, kernel
        self.stage_columns = first + s * np.arange(n)
        self.arrivals = ((self.stage_columns + s)[:, None] + np.arange(nz)).ravel()
        self.v = ca.reshape(x[first:last], s, n)
        self.z_next = ca.reshape(x[self.arrivals.tolist()], nz, n)
        self.z_last = x[last : last + nz]
        self.at_start = x[[first + i for i in layout.initial_rows]]
        self.at_end = x[[last + i for i in layout.final_rows]]
        grid = ca.MX(ca.DM(np.vstack([layout.mesh[:-1], np.diff(layout.mesh)])))
        self.constants = constants
        self.grid = ca.vertcat(grid, ca.repmat(constants, 1, n))

    def _rows(self, gap: ca.MX, constraints: ca.MX, link: ca.MX, tail: ca.MX) -> ca.MX:
        stages = ca.vertcat(gap, constraints)
        head, body = ca.vec(stages[:, 0]), ca.vec(stages[:, 1:])
        return ca.vertcat(head, self.at_start, body, link, tail, self.at_end)

    def values(self, link: ca.MX) -> tuple[ca.MX, ca.MX]:
        following, constraints, running = self.kernel.stage.map(self.layout.intervals)(
            self.v, self.grid
        )
        tail, end_cost = self.kernel.end(self.z_last, self.constants)
        rows = self._rows(self.z_next - following, constraints, link, tail)
        return ca.sum2(running) + end_cost, rows

    def first_order(self, link: ca.MX, jacobian: _Entries) -> tuple[ca.MX, ca.MX, ca.MX]:
        layout, kernel = self.layout, self.kernel
        n, nz = layout.intervals, layout.node_size
        both, block, running, slope = kernel.stage_jacobian.map(n)(self.v, self.grid)
        tail, end_block, end_cost, end_slope = kernel.end_jacobian(self.z_last, self.constants)
        rows, columns = _triplet(kernel.stage_jacobian, 1)
        sign = np.tile(np.where(rows < nz, -1.0, 1.0), n)
        stage_row = layout.stage_row[:, None]
        jacobian.add(
            stage_row + rows, self.stage_columns[:, None] + columns, block.nz[:] * ca.DM(sign)
        )
        jacobian.add(stage_row + np.arange(nz), self.arrivals, np.ones(n * nz))
        start = np.arange(len(layout.initial_rows))
        jacobian.add(
            layout.row_offset + layout.rows_per_stage + start,
            layout.variable_offset + np.array(layout.initial_rows, dtype=int),
            np.ones(start.size),
        )
        end_row = layout.last_row + layout.next_nodes
        rows, columns = _triplet(kernel.end_jacobian, 1)
        jacobian.add(end_row + rows, layout.last_node + columns, end_block.nz[:])
        end = np.arange(len(layout.final_rows))
        jacobian.add(
            end_row + layout.end_rows + end,
            layout.last_node + np.array(layout.final_rows, dtype=int),
            np.ones(end.size),
        )
        gap, constraints = self.z_next - both[:nz, :], both[nz:, :]
        gradient = ca.vertcat(ca.vec(slope), end_slope, ca.MX.zeros(layout.transition))
        return (
            ca.sum2(running) + end_cost,
            self._rows(gap, constraints, link, tail),
            gradient,
        )

    def second_order(self, lam_f: ca.MX, lam_g: ca.MX, hessian: _Entries) -> None:
        layout, kernel = self.layout, self.kernel
        n, per_stage = layout.intervals, layout.rows_per_stage
        rows = (layout.stage_row[:, None] + np.arange(per_stage)).ravel()
        lam = ca.reshape(lam_g[rows.tolist()], per_stage, n)
        block = kernel.stage_hessian.map(n)(self.v, self.grid, lam, ca.repmat(lam_f, 1, n))
        rows, columns = _triplet(kernel.stage_hessian, 0)
        corner = self.stage_columns[:, None]
        hessian.add(corner + rows, corner + columns, block.nz[:])
        end_row = layout.last_row + layout.next_nodes
        lam_end = lam_g[end_row : end_row + layout.end_rows]
        block = kernel.end_hessian(self.z_last, self.constants, lam_end, lam_f)
        rows, columns = _triplet(kernel.end_hessian, 0)
        hessian.add(layout.last_node + rows, layout.last_node + columns, block.nz[:])


@dataclass(frozen=True, eq=False)
class _LinkRows:
    """Rows that tie the first z of the next phase to the last mesh point of this one."""

    values: ca.MX
    rows: np.ndarray
    columns: np.ndarray
    entries: FloatArray


def _link_rows(
    problem: OptimalControlProblem,
    index: int,
    layout: PhaseLayout,
    after: PhaseLayout | None,
    x: ca.MX,
) -> _LinkRows:
    if after is None:
        empty = np.zeros(0, dtype=int)
        return _LinkRows(ca.MX(0, 1), empty, empty, np.zeros(0))
    names = problem.links[index].names
    place, offset = {}, 0
    for variable in node_variables(layout.phase):
        place[variable.name] = (offset, variable)
        offset += variable.size
    source, factor = [], []
    free = layout.last_node + layout.node_size  # the transition controls
    for variable in node_variables(after.phase):
        if variable.name in names:
            start, before = place[variable.name]
            source += [layout.last_node + start + i for i in range(variable.size)]
            factor += (before.scale / variable.scale).tolist()
        else:
            source += range(free, free + variable.size)
            factor += [1.0] * variable.size
            free += variable.size
    source.append(free)  # the duration of the next phase
    factor.append(1.0)
    target = after.variable_offset + np.arange(after.node_size)
    rows = np.arange(after.node_size)
    return _LinkRows(
        values=x[target.tolist()] - ca.DM(factor) * x[source],
        rows=np.concatenate([rows, rows]),
        columns=np.concatenate([target, np.array(source)]),
        entries=np.concatenate([np.ones(after.node_size), -np.array(factor)]),
    )


def _triplet(function: ca.Function, output: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the nonzeros of one output, in storage order."""
    rows, columns = function.sparsity_out(output).get_triplet()
    return np.asarray(rows, dtype=int), np.asarray(columns, dtype=int)


@dataclass(frozen=True, eq=False)
class PhaseBounds:
    """Lower and upper bounds of the variables and rows of a phase."""

    variables: tuple[FloatArray, FloatArray]
    rows: tuple[FloatArray, FloatArray]


def phase_bounds(layout: PhaseLayout, kernel: Kernels) -> PhaseBounds:
    """Lower and upper bounds of the phase's variables and rows."""
    initial = condition_bounds(layout, "initial", layout.initial_rows)
    final = condition_bounds(layout, "final", layout.final_rows)
    fixed = layout.phase.duration_bounds[0] == layout.phase.duration_bounds[1]
    variables, rows = [], []
    for side, (infinite, which, duration) in enumerate(
        (
            (-np.inf, "lower", layout.phase.duration_bounds[0]),
            (np.inf, "upper", layout.phase.duration_bounds[1]),
        )
    ):
        node = joined([getattr(v, which) / v.scale for v in node_variables(layout.phase)])
        node = np.append(node, duration / layout.node_scale[-1])
        control = joined(
            [
                # a linear control is bounded as the node that it becomes
                np.full(k.source.size, infinite)
                if k.source.shape == "linear"
                else getattr(k.source, which) / k.source.scale
                for k in layout.inner
            ]
        )
        stage = np.concatenate([node, control])
        free = np.full(layout.transition, infinite)  # bounded as the node that it becomes
        every = np.concatenate([np.tile(stage, layout.intervals), node, free])
        if fixed:  # at the first node; to fix the others as well would say the same twice
            later = layout.stage_size * np.arange(1, layout.intervals + 1) + layout.node_size - 1
            every[later] = infinite
        variables.append(every)
        path = (kernel.stage_lower, kernel.stage_upper)[side]
        end = (kernel.end_lower, kernel.end_upper)[side]
        step = np.concatenate([np.zeros(layout.node_size), path])
        linked = np.zeros(layout.next_nodes)
        rows.append(
            np.concatenate(
                [
                    step,
                    initial[side],
                    np.tile(step, layout.intervals - 1),
                    linked,
                    end,
                    final[side],
                ]
            )
        )
    return PhaseBounds((variables[0], variables[1]), (rows[0], rows[1]))
