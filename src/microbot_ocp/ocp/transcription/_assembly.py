"""The nonlinear program in stages: kernels mapped over the mesh, nonzeros put in their places."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.child_process import spare_processor
from microbot_ocp.ocp.transcription._kernels import joined
from microbot_ocp.ocp.transcription._layout import (
    Bounds,
    PhaseLayout,
    PointGroup,
    StageGroup,
    bounds_of,
    row_labels,
    variable_labels,
)
from microbot_ocp.ocp.transcription._mesh import IntArray
from microbot_ocp.ocp.transcription._table import Label

# Variables of a stage and stages from which two threads evaluate them: to start one takes 30 us
LARGE_STAGE, MANY_STAGES = 24, 40


class MadeOnDemand(dict[str, ca.Function]):
    """Functions by name, each made when it is first asked for."""

    def __init__(self, makers: Mapping[str, Callable[[], ca.Function]]) -> None:
        super().__init__()
        self.makers = makers

    def __missing__(self, name: str) -> ca.Function:
        function = self[name] = self.makers[name]()
        return function


@dataclass(frozen=True, eq=False)
class Program(Bounds):
    """A nonlinear program in stages, ready for a solver.

    Attributes
    ----------
    layouts : where each phase stands
    nlp : ``x``, ``f`` and ``g`` as expressions, and ``p`` where phase parameters may change
    functions : derivatives: ``jacobian(x, p) -> g, J``, ``gradient(x, p) -> f, grad``,
        ``hessian(x, p, lam_f, lam_g) -> H`` and its upper triangle ``hessian_upper``
    parameters : values of p as declared; empty where the parameters are constants of the program
    cost_scale : what solvers divide the cost by; it is whole in ``nlp`` and ``functions``
    """

    layouts: tuple[PhaseLayout, ...]
    nlp: Mapping[str, ca.MX]
    functions: Mapping[str, ca.Function]
    parameters: FloatArray
    cost_scale: float = 1.0

    @cached_property
    def row_labels(self) -> list[Label]:
        """What every row is."""
        return row_labels(self.layouts)

    @cached_property
    def variable_labels(self) -> list[Label]:
        """What every variable is."""
        return variable_labels(self.layouts)

    @property
    def stage_sizes(self) -> tuple[IntArray, ...]:
        """Components of z, of w, and rows besides the steps, stage by stage."""
        sizes = zip(*(layout.stage_sizes for layout in self.layouts), strict=True)
        return tuple(np.concatenate(own) for own in sizes)

    def row_values(self, x: FloatArray) -> FloatArray:
        """Values of all rows at x, scaled."""
        return np.array(self.functions["jacobian"](x, self.parameters)[0]).ravel()


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
        rows, columns, values = rows[order], columns[order], ca.vertcat(*self.values)
        fresh = (np.diff(rows, prepend=-1) != 0) | (np.diff(columns, prepend=-1) != 0)
        own = np.cumsum(fresh) - 1  # nonzero of every entry
        nonzeros = values[order[fresh].tolist()]
        for turn in range(1, int(np.bincount(own).max(initial=0))):
            # points inside a phase add to what their stages have there
            again = np.flatnonzero(np.arange(own.size) - np.flatnonzero(fresh)[own] == turn)
            nonzeros[own[again].tolist()] += values[order[again].tolist()]
        rows, columns = rows[fresh], columns[fresh]
        first = np.searchsorted(columns, np.arange(width + 1))
        sparsity = ca.Sparsity(height, width, first.tolist(), rows.tolist())
        return ca.MX(sparsity, nonzeros)


def assemble(layouts: Sequence[PhaseLayout], *, parametric: bool = False) -> Program:
    """Put the stages of all phases together.

    With ``parametric`` the phase parameters are arguments p of the program, else constants in it.
    """
    bounds = bounds_of(layouts)
    width, height = bounds.variable_lower.size, bounds.row_lower.size
    x = ca.MX.sym("x", width)
    declared = [layout.data for layout in layouts]
    parameters = joined(declared) if parametric else np.zeros(0)
    p = ca.MX.sym("p", parameters.size)
    offsets = np.cumsum([0, *(d.size for d in declared)]).tolist()
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", height)
    cost, rows = ca.MX(0), _Parts()
    cost_again, rows_again, gradient = ca.MX(0), _Parts(), _Parts()
    jacobian, hessian = _Entries(), _Entries()
    for index, layout in enumerate(layouts):
        begin, end = offsets[index : index + 2]
        constants = p[begin:end] if parametric else ca.MX(ca.DM(declared[index]))
        piece = _PhasePiece(layout, x, constants)
        cost = cost + piece.values(rows)
        cost_again = cost_again + piece.first_order(rows_again, gradient, jacobian)
        piece.second_order(lam_f, lam_g, hessian)
    # without a cost it is a sparse zero, which solvers refuse
    cost, cost_again = ca.densify(cost), ca.densify(cost_again)
    curvature = [x, p, lam_f, lam_g]
    slope_of_p = ca.MX.zeros(parameters.size)  # solvers take it only if they are asked for it
    # solvers assume a dense gradient
    g_again, slope = rows_again.vector(), ca.densify(gradient.vector())
    jacobian_matrix = jacobian.matrix(height, width)
    stationarity = lam_f * slope + jacobian_matrix.T @ lam_g
    empty = ca.MX(width, 1)
    functions: dict[str, Callable[[], ca.Function]] = {
        "lagrangian": lambda: ca.Function(
            "nlp_grad", curvature, [cost_again, g_again, stationarity, slope_of_p]
        ),
        "jacobian": lambda: ca.Function("nlp_jac_g", [x, p], [g_again, jacobian_matrix]),
        "gradient": lambda: ca.Function("nlp_grad_f", [x, p], [cost_again, slope]),
        "gradient_only": lambda: ca.Function("nlp_grad_f", [x, p], [slope]),
        "hessian": lambda: ca.Function(
            "nlp_hess_l", curvature, [empty, hessian.matrix(width, width)]
        ),
        "hessian_upper": lambda: ca.Function(
            "nlp_hess_l", curvature, [hessian.matrix(width, width, upper=True)]
        ),
    }
    return Program(
        layouts=tuple(layouts),
        nlp={"x": x, "f": cost, "g": rows.vector(), **({"p": p} if parametric else {})},
        functions=MadeOnDemand(functions),
        **vars(bounds),
        parameters=parameters,
    )


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
        self.conditions = [
            (block.places[0], nodes[place, layout.node_columns(block)])
            for block, place in ((layout.initial, 0), (layout.final, -1))
        ]
        self.x = x
        self.points = [_PointPiece(layout, group, x, constants) for group in layout.points]
        fixed = constants[: layout.parameters.size]
        grid = np.vstack([layout.mesh[:-1], np.diff(layout.mesh)])
        self.groups = [
            _GroupPiece(
                group=group,
                v=_gathered(x, group.variables),
                z_next=_gathered(x, nodes[group.intervals + 1]),
                arrivals=nodes[group.intervals + 1],
                grid=ca.vertcat(
                    ca.MX(ca.DM(grid[:, group.intervals])),
                    ca.repmat(fixed, 1, group.intervals.size),
                ),
            )
            for group in layout.groups
        ]

    def _common_rows(self, rows: _Parts) -> None:
        layout, x = self.layout, self.x
        for places, columns in self.conditions:
            rows.add(places, x[columns.tolist()])
        source, target = x[layout.sources.tolist()], x[layout.targets.tolist()]
        rows.add(layout.link.places, target - ca.DM(layout.factors) * source)

    def values(self, rows: _Parts) -> ca.MX:
        """Cost; rows are added to those of the program."""
        self._common_rows(rows)
        cost = ca.MX(0)
        for point in self.points:
            constraints_there, added = point.mapped(point.kernel.point)(point.z, point.c)
            rows.add(point.group.block.places, constraints_there)
            cost = cost + ca.sum2(added)
        for own in self.groups:
            kernel = own.mapped(own.group.kind.kernels.stage)
            following, constraints, running = kernel(own.v, own.grid)
            rows.add(own.group.rows, ca.vertcat(own.z_next - following, constraints))
            cost = cost + ca.sum2(running)
        return cost

    def first_order(self, rows: _Parts, gradient: _Parts, jacobian: _Entries) -> ca.MX:
        """Cost; rows, its gradient and the Jacobian are added to those of the program."""
        layout = self.layout
        nz, cost = layout.node_size, ca.MX(0)
        self._common_rows(rows)
        slopes = ca.MX.zeros(nz, layout.intervals + 1)
        inner = any(point.group.nodes[0] < layout.intervals for point in self.points)
        for point in self.points:
            kernel = point.kernel.jacobian
            constraints_there, block, added, slope = point.mapped(kernel)(point.z, point.c)
            rows.add(point.group.block.places, constraints_there)
            slopes[:, point.group.nodes.tolist()] += slope
            at, column = _triplet(kernel, 1)
            jacobian.add(point.group.block.places[:, at], point.places[:, column], block.nz[:])
            cost = cost + ca.sum2(added)
        gradient.add(layout.nodes[-1], slopes[:, -1])
        gradient.add(layout.transition.places, ca.MX.zeros(layout.transition.places.size))
        for places, columns in self.conditions:
            jacobian.add(places, columns, np.ones(places.size))
        jacobian.add(layout.link.places, layout.targets, np.ones(layout.targets.size))
        jacobian.add(layout.link.places, layout.sources, -layout.factors)
        for own in self.groups:
            group, kernel = own.group, own.group.kind.kernels.stage_jacobian
            both, block, running, slope = own.mapped(kernel)(own.v, own.grid)
            at, column = _triplet(kernel, 1)
            sign = np.tile(np.where(at < nz, -1.0, 1.0), own.count)
            jacobian.add(group.rows[:, at], group.variables[:, column], block.nz[:] * ca.DM(sign))
            jacobian.add(group.rows[:, :nz], own.arrivals, np.ones(own.arrivals.size))
            rows.add(group.rows, ca.vertcat(own.z_next - both[:nz, :], both[nz:, :]))
            if inner:
                slope[:nz, :] += slopes[:, group.intervals.tolist()]
            gradient.add(group.variables, slope)
            cost = cost + ca.sum2(running)
        return cost

    def second_order(self, lam_f: ca.MX, lam_g: ca.MX, hessian: _Entries) -> None:
        """The Hessian is added to that of the program."""
        for point in self.points:
            kernel = point.kernel.hessian
            lam = _gathered(lam_g, point.group.block.places)
            factor = ca.repmat(lam_f, 1, point.group.nodes.size)
            block = point.mapped(kernel)(point.z, point.c, lam, factor)
            row, column = _triplet(kernel, 0)
            hessian.add(point.places[:, row], point.places[:, column], block.nz[:])
        for own in self.groups:
            group, kernel = own.group, own.group.kind.kernels.stage_hessian
            lam = _gathered(lam_g, group.rows)
            block = own.mapped(kernel)(own.v, own.grid, lam, ca.repmat(lam_f, 1, own.count))
            row, column = _triplet(kernel, 0)
            hessian.add(group.variables[:, row], group.variables[:, column], block.nz[:])


class _PointPiece:
    """Points of one kind: their z with its indices, and their constants."""

    def __init__(self, layout: PhaseLayout, group: PointGroup, x: ca.MX, constants: ca.MX) -> None:
        self.group, self.kernel = group, group.kernel
        self.places = layout.nodes[group.nodes]
        self.z = _gathered(x, self.places)
        fractions = ca.MX(ca.DM(layout.mesh[group.nodes]).T)
        self.c = ca.vertcat(fractions, _gathered(constants, layout.point_places(group).T))

    def mapped(self, function: ca.Function) -> ca.Function:
        return function.map(self.group.nodes.size)


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

    def mapped(self, kernel: ca.Function) -> ca.Function:
        """The kernel for all stages at once."""
        if self.v.size1() >= LARGE_STAGE and self.count >= MANY_STAGES and spare_processor():
            return kernel.map(self.count, "thread", 2)
        return kernel.map(self.count)


def _gathered(x: ca.MX, places: np.ndarray) -> ca.MX:
    """Entries of x: a column for every row of places [M, ...]."""
    return ca.reshape(x[places.ravel().tolist()], places.shape[1], places.shape[0])


def _triplet(function: ca.Function, output: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the nonzeros of one output, in storage order."""
    rows, columns = function.sparsity_out(output).get_triplet()
    return np.asarray(rows, dtype=int), np.asarray(columns, dtype=int)
