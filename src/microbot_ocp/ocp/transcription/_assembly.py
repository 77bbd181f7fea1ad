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

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.ocp.problem import Link, OptimalControlProblem, node_variables
from microbot_ocp.ocp.transcription._kernels import joined
from microbot_ocp.ocp.transcription._layout import PhaseLayout, StageGroup, condition_bounds


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
    cost_scale : what solvers divide the cost by; it is whole in ``nlp`` and ``functions``
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
    cost_scale: float = 1.0


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
    cost, rows = ca.MX(0), _Parts()
    cost_again, rows_again, gradient = ca.MX(0), _Parts(), _Parts()
    jacobian, hessian = _Entries(), _Entries()
    for index, layout in enumerate(layouts):
        after = layouts[index + 1] if index + 1 < len(layouts) else None
        link = _link_rows(problem, index, layout, after, x)
        begin, end = offsets[index : index + 2]
        constants = p[begin:end] if parametric else ca.MX(ca.DM(declared[index]))
        piece = _PhasePiece(layout, x, constants)
        cost = cost + piece.values(link.values, rows)
        cost_again = cost_again + piece.first_order(link.values, rows_again, gradient, jacobian)
        jacobian.add(layout.last_row + link.rows, link.columns, link.entries)
        piece.second_order(lam_f, lam_g, hessian)
    # without a cost it is a sparse zero, which solvers refuse
    cost, cost_again = ca.densify(cost), ca.densify(cost_again)
    bounds = [phase_bounds(layout) for layout in layouts]
    curvature = [x, p, lam_f, lam_g]
    slope_of_p = ca.MX.zeros(parameters.size)  # solvers take it only if they are asked for it
    # solvers take the gradient for dense, whatever its sparsity says
    g_again, slope = rows_again.vector(), ca.densify(gradient.vector())
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
        nlp={"x": x, "f": cost, "g": rows.vector(), **({"p": p} if parametric else {})},
        functions=functions,
        variable_lower=joined([b.variables[0] for b in bounds]),
        variable_upper=joined([b.variables[1] for b in bounds]),
        row_lower=joined([b.rows[0] for b in bounds]),
        row_upper=joined([b.rows[1] for b in bounds]),
        nodes=tuple(n for k in layouts for n in [k.node_size] * (k.intervals + 1)),
        controls=tuple(
            n
            for k in layouts
            for n in [*(k.kinds[i].control_size for i in k.kind_of), k.transition]
        ),
        constraints=tuple(n for k in layouts for n in _constraint_counts(k)),
        parameters=parameters,
    )


def phase_constants(layout: PhaseLayout) -> FloatArray:
    """Declared values of the parameters of a phase, in one array."""
    return joined([p.value for p in layout.phase.parameters])


class _Parts:
    """A vector, gathered part by part."""

    def __init__(self) -> None:
        self.places: list[np.ndarray] = []
        self.values: list[ca.MX] = []

    def add(self, places: np.ndarray, values: ca.MX) -> None:
        """Values at places; of a matrix [..., M] those of column m are at the places [m, ...]."""
        self.places.append(np.asarray(places, dtype=int).ravel())
        self.values.append(ca.vec(values))

    def vector(self) -> ca.MX:
        # every place is filled once
        order = np.argsort(np.concatenate(self.places))
        return ca.vertcat(*self.values)[order.tolist()]


class _PhasePiece:
    """Values and derivatives of one phase as expressions of all variables."""

    def __init__(self, layout: PhaseLayout, x: ca.MX, constants: ca.MX) -> None:
        nodes = layout.nodes
        self.layout = layout
        self.end = layout.kinds[0].kernels
        self.z_last = x[nodes[-1].tolist()]
        self.at_start = x[nodes[0, list(layout.initial_rows)].tolist()]
        self.at_end = x[nodes[-1, list(layout.final_rows)].tolist()]
        self.constants = constants
        grid = np.vstack([layout.mesh[:-1], np.diff(layout.mesh)])
        self.groups = [
            _GroupPiece(
                group=group,
                v=_gathered(x, group.variables),
                z_next=_gathered(x, nodes[group.intervals + 1]),
                arrivals=nodes[group.intervals + 1],
                grid=ca.vertcat(
                    ca.MX(ca.DM(grid[:, group.intervals])),
                    ca.repmat(constants, 1, group.intervals.size),
                ),
            )
            for group in layout.groups
        ]
        self.start_rows = layout.start_row + np.arange(len(layout.initial_rows))
        tail = layout.last_row + np.arange(layout.row_offset + layout.row_count - layout.last_row)
        self.link_rows, self.end_rows, self.final_rows = np.split(
            tail, np.cumsum([layout.next_nodes, layout.end_rows])
        )

    def _common_rows(self, rows: _Parts, link: ca.MX, tail: ca.MX) -> None:
        rows.add(self.start_rows, self.at_start)
        rows.add(self.link_rows, link)
        rows.add(self.end_rows, tail)
        rows.add(self.final_rows, self.at_end)

    def values(self, link: ca.MX, rows: _Parts) -> ca.MX:
        """Cost; rows are added to those of the program."""
        tail, cost = self.end.end(self.z_last, self.constants)
        self._common_rows(rows, link, tail)
        for own in self.groups:
            kernel = own.group.kind.kernels.stage.map(own.count)
            following, constraints, running = kernel(own.v, own.grid)
            rows.add(own.group.rows, ca.vertcat(own.z_next - following, constraints))
            cost = cost + ca.sum2(running)
        return cost

    def first_order(self, link: ca.MX, rows: _Parts, gradient: _Parts, jacobian: _Entries) -> ca.MX:
        """Cost; rows, its gradient and the Jacobian are added to those of the program."""
        layout = self.layout
        nz, last = layout.node_size, layout.nodes[-1]
        tail, block, cost, slope = self.end.end_jacobian(self.z_last, self.constants)
        self._common_rows(rows, link, tail)
        gradient.add(last, slope)
        transition = layout.last_node + nz + np.arange(layout.transition)
        gradient.add(transition, ca.MX.zeros(layout.transition))
        at, column = _triplet(self.end.end_jacobian, 1)
        jacobian.add(self.end_rows[at], last[column], block.nz[:])
        for conditions, node, which in (
            (self.start_rows, layout.nodes[0], layout.initial_rows),
            (self.final_rows, last, layout.final_rows),
        ):
            jacobian.add(conditions, node[list(which)], np.ones(len(which)))
        for own in self.groups:
            group, kernel = own.group, own.group.kind.kernels.stage_jacobian
            both, block, running, slope = kernel.map(own.count)(own.v, own.grid)
            at, column = _triplet(kernel, 1)
            sign = np.tile(np.where(at < nz, -1.0, 1.0), own.count)
            jacobian.add(group.rows[:, at], group.variables[:, column], block.nz[:] * ca.DM(sign))
            jacobian.add(group.rows[:, :nz], own.arrivals, np.ones(own.arrivals.size))
            rows.add(group.rows, ca.vertcat(own.z_next - both[:nz, :], both[nz:, :]))
            gradient.add(group.variables, slope)
            cost = cost + ca.sum2(running)
        return cost

    def second_order(self, lam_f: ca.MX, lam_g: ca.MX, hessian: _Entries) -> None:
        """The Hessian is added to that of the program."""
        lam_end = lam_g[self.end_rows.tolist()]
        block = self.end.end_hessian(self.z_last, self.constants, lam_end, lam_f)
        row, column = _triplet(self.end.end_hessian, 0)
        last = self.layout.nodes[-1]
        hessian.add(last[row], last[column], block.nz[:])
        for own in self.groups:
            group, kernel = own.group, own.group.kind.kernels.stage_hessian
            lam = _gathered(lam_g, group.rows)
            block = kernel.map(own.count)(own.v, own.grid, lam, ca.repmat(lam_f, 1, own.count))
            row, column = _triplet(kernel, 0)
            hessian.add(group.variables[:, row], group.variables[:, column], block.nz[:])


@dataclass(frozen=True, eq=False)
class _GroupPiece:
    """Stages of one kind: their (z, w), the next z with its indices, and their constants."""

    group: StageGroup
    v: ca.MX
    z_next: ca.MX
    arrivals: np.ndarray
    grid: ca.MX

    @property
    def count(self) -> int:
        return self.group.intervals.size


def _gathered(x: ca.MX, places: np.ndarray) -> ca.MX:
    """Entries of x: a column for every row of places [M, ...]."""
    return ca.reshape(x[places.ravel().tolist()], places.shape[1], places.shape[0])


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


def _constraint_counts(layout: PhaseLayout) -> list[int]:
    counts = layout.stage_row_counts.tolist()
    counts[0] += len(layout.initial_rows)
    return [*counts, layout.end_rows + len(layout.final_rows)]


@dataclass(frozen=True, eq=False)
class PhaseBounds:
    """Lower and upper bounds of the variables and rows of a phase."""

    variables: tuple[FloatArray, FloatArray]
    rows: tuple[FloatArray, FloatArray]


def phase_bounds(layout: PhaseLayout) -> PhaseBounds:
    """Lower and upper bounds of the phase's variables and rows."""
    lower, upper = _one_side(layout, "lower"), _one_side(layout, "upper")
    return PhaseBounds((lower[0], upper[0]), (lower[1], upper[1]))


def _one_side(layout: PhaseLayout, which: str) -> tuple[FloatArray, FloatArray]:
    """Bounds of the variables and rows of a phase, on one side."""
    side = ("lower", "upper").index(which)
    infinite, duration = (-np.inf, np.inf)[side], layout.phase.duration_bounds[side]
    variables = np.full(layout.variable_count, infinite)
    rows = np.zeros(layout.row_count)  # steps and links are equations
    nodes = layout.nodes - layout.variable_offset
    node = joined([getattr(v, which) / v.scale for v in node_variables(layout.phase)])
    variables[nodes] = np.append(node, duration / layout.node_scale[-1])
    if layout.phase.duration_bounds[0] == layout.phase.duration_bounds[1]:
        # at the first node; to fix the others as well would say the same twice
        variables[nodes[1:, -1]] = infinite
    kernels = layout.kinds[0].kernels
    for group in layout.groups:
        own = [
            # a linear control is bounded as the node that it becomes
            np.full(k.source.size, infinite)
            if k.source.shape == "linear"
            else getattr(k.source, which) / k.source.scale
            for k in group.kind.inner
        ]
        variables[group.variables[:, layout.node_size :] - layout.variable_offset] = joined(own)
        limits = getattr(group.kind.kernels, f"stage_{which}")
        rows[group.rows[:, layout.node_size :] - layout.row_offset] = limits
    initial = condition_bounds(layout, "initial", layout.initial_rows)[side]
    start = layout.start_row - layout.row_offset
    rows[start : start + initial.size] = initial
    final = condition_bounds(layout, "final", layout.final_rows)[side]
    tail = np.concatenate([getattr(kernels, f"end_{which}"), final])
    rows[rows.size - tail.size :] = tail
    return variables, rows
