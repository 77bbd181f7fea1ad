"""The nonlinear program in stages: kernels mapped over the mesh, nonzeros placed in matrices.

Theory: docs/theory/transcription.md, equation (3).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.child_process import spare_processor
from microbot_ocp._base.portable import Portable
from microbot_ocp.ocp.transcription._kernels import Kernel, joined
from microbot_ocp.ocp.transcription._layout import Bounds, PhaseLayout, bounds_of, labels_of
from microbot_ocp.ocp.transcription._table import IntArray, Label

# Least stage variables and stages for evaluation by two threads: starting one takes 30 us.
LARGE_STAGE, MANY_STAGES = 24, 40


class LazyFunctions(dict[str, ca.Function]):
    """Functions by name, each built on first access."""

    def __init__(self, makers: Mapping[str, Callable[[], ca.Function]]) -> None:
        super().__init__()
        self.makers = makers

    def __missing__(self, name: str) -> ca.Function:
        function = self[name] = self.makers[name]()
        return function


@dataclass(frozen=True, eq=False, repr=False)
class Program(Portable, Bounds):
    """A nonlinear program in stages, ready for a solver.

    Attributes
    ----------
    layouts : layouts of the phases
    nlp : ``x``, ``f`` and ``g`` as expressions, and ``p`` for variable phase parameters
    functions : derivatives: ``jacobian(x, p) -> g, J``, ``gradient(x, p) -> f, grad``,
        ``hessian(x, p, lam_f, lam_g) -> H`` and its upper triangle ``hessian_upper``
    parameters : declared values of p; empty if the parameters are constants of the program
    cost_scale : divisor of the cost inside solvers; ``nlp`` and ``functions`` are not divided
    """

    layouts: tuple[Any, ...]
    nlp: Mapping[str, ca.MX]
    functions: Mapping[str, ca.Function]
    parameters: FloatArray
    cost_scale: float = 1.0

    def __repr__(self) -> str:
        sizes = f"{self.nlp['x'].numel()} variables, {self.nlp['g'].numel()} rows"
        functions = ", ".join(self.functions)
        return f"<Program of {sizes}; functions {functions}>"

    def __reduce__(self) -> tuple[Any, ...]:
        return _assembled_again, (self.layouts, "p" in self.nlp, self.cost_scale)

    @cached_property
    def row_labels(self) -> list[Label]:
        """Labels of the rows."""
        return labels_of(self.layouts, "rows")

    @cached_property
    def variable_labels(self) -> list[Label]:
        """Labels of the variables."""
        return labels_of(self.layouts, "variables")

    @property
    def stage_sizes(self) -> tuple[IntArray, ...]:
        """Components of z, components of w, and rows without the step rows, for every stage."""
        sizes = zip(*(layout.stage_sizes for layout in self.layouts), strict=True)
        return tuple(np.concatenate(parts) for parts in sizes)

    def time_of(self, label: Label, x: FloatArray) -> float:
        """Return the time of a row or variable at x, s since the start of its phase."""
        layout = next(k for k in self.layouts if k.phase.name == label.phase)
        return layout.place_of(label) * float(x[layout.nodes[0, -1]] * layout.node_scale[-1])

    def row_values(self, x: FloatArray) -> FloatArray:
        """Return values of all rows at x, scaled."""
        return np.array(self.functions["jacobian"](x, self.parameters)[0]).ravel()

    def cost(self, x: FloatArray) -> float:
        """Return the cost at x."""
        return float(self.functions["gradient"](x, self.parameters)[0])

    def slopes(self, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return gradient of the cost, values of all rows, and nonzeros of their Jacobian at x."""
        rows, jacobian = self.functions["jacobian"](x, self.parameters)
        slope = self.functions["gradient"](x, self.parameters)[1]
        return np.array(slope).ravel(), np.array(rows).ravel(), np.array(jacobian.nonzeros())

    def stationarity(self, x: FloatArray, multipliers: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the gradient of the Lagrangian for given row multipliers, and the rows."""
        rows, jacobian = self.functions["jacobian"](x, self.parameters)
        slope = self.functions["gradient"](x, self.parameters)[1]
        along = slope + ca.mtimes(jacobian.T, ca.DM(multipliers))
        return np.array(along).ravel(), np.array(rows).ravel()


class _Entries:
    """Builder of a sparse matrix from blocks of entries; repeated places are added up."""

    def __init__(self) -> None:
        self.rows: list[np.ndarray] = []
        self.columns: list[np.ndarray] = []
        self.values: list[ca.MX] = []

    def add(self, rows: ArrayLike, columns: ArrayLike, values: ca.MX | FloatArray) -> None:
        self.rows.append(np.asarray(rows, dtype=int).ravel())
        self.columns.append(np.zeros_like(self.rows[-1]) + np.ravel(columns))
        # CasADi returns the nonzeros of a single row as a row: vec makes a column of them.
        self.values.append(ca.vec(values) if isinstance(values, ca.MX) else ca.MX(ca.DM(values)))

    def matrix(self, height: int, width: int, *, upper: bool = False) -> ca.MX:
        rows, columns = np.concatenate(self.rows), np.concatenate(self.columns)
        keep = np.flatnonzero((rows < height) & ((rows <= columns) | (not upper)))
        order = keep[np.lexsort((rows[keep], columns[keep]))]
        rows, columns, values = rows[order], columns[order], ca.vertcat(*self.values)
        # Entries are sorted by column and row (compressed columns): repeated places are adjacent.
        fresh = (np.diff(rows, prepend=-1) != 0) | (np.diff(columns, prepend=-1) != 0)
        slots = np.cumsum(fresh) - 1  # nonzero of every entry
        nonzeros = values[order[fresh].tolist()]
        for turn in range(1, int(np.bincount(slots).max(initial=0))):
            # Point kernels inside a phase add to entries of the stages there.
            again = np.flatnonzero(np.arange(slots.size) - np.flatnonzero(fresh)[slots] == turn)
            nonzeros[slots[again].tolist()] += values[order[again].tolist()]
        rows, columns = rows[fresh], columns[fresh]
        first = np.searchsorted(columns, np.arange(width + 1))
        sparsity = ca.Sparsity(height, width, first.tolist(), rows.tolist())
        return ca.MX(sparsity, nonzeros)

    def vector(self, height: int) -> ca.MX:
        return ca.densify(self.matrix(height, 1))


def assemble(layouts: Sequence[PhaseLayout], *, parametric: bool = False) -> Program:
    """Return the program of all phases.

    With ``parametric``, phase parameters are arguments p of the program, otherwise constants.
    """
    bounds = bounds_of(layouts)
    x = ca.MX.sym("x", bounds.variable_lower.size)
    declared = [layout.data for layout in layouts]
    parameters = joined(declared) if parametric else np.zeros(0)
    p = ca.MX.sym("p", parameters.size)
    edges = np.cumsum([0, *(d.size for d in declared)]).tolist()
    constants = ca.vertsplit(p, edges) if parametric else [ca.MX(ca.DM(d)) for d in declared]
    pieces = [k for pair in zip(layouts, constants, strict=True) for k in _pieces(*pair, x)]
    conditions = [condition for layout in layouts for condition in _conditions(layout)]
    nlp, functions = staged(x, p, bounds.row_lower.size, pieces, conditions)
    return Program(
        layouts=tuple(layouts),
        nlp={**nlp, **({"p": p} if parametric else {})},
        functions=functions,
        **vars(bounds),
        parameters=parameters,
    )


LinearRows = tuple[np.ndarray, np.ndarray, FloatArray]  # places, columns and factors


def staged(
    x: ca.MX,
    p: ca.MX,
    height: int,
    pieces: Sequence[KernelCalls],
    conditions: Sequence[LinearRows] = (),
) -> tuple[dict[str, ca.MX], LazyFunctions]:
    """Return ``nlp`` and ``functions`` of a program from its kernel calls and linear rows.

    Rows of calls with the index ``height`` are left out.
    """
    width = x.numel()
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", height)
    weights = ca.vertcat(lam_g, 0)  # rows that are left out have no weight
    cost = cost_again = ca.MX(0)
    rows, rows_again, gradient, jacobian, hessian = (_Entries() for _ in range(5))
    for places, columns, factors in conditions:
        for vector in (rows, rows_again):
            vector.add(places, 0, ca.DM(factors) * x[columns.tolist()])
        jacobian.add(places, columns, factors)
    for piece in pieces:
        cost = cost + piece.values(rows)
        cost_again = cost_again + piece.first_order(rows_again, gradient, jacobian)
        piece.second_order(lam_f, weights, hessian)
    # A sum without terms would be a sparse zero, which solvers reject.
    cost, cost_again = ca.densify(cost), ca.densify(cost_again)
    curvature = [x, p, lam_f, lam_g]
    slope_of_p = ca.MX.zeros(p.numel())  # solvers require this output but never use it
    g_again, slope = rows_again.vector(height), gradient.vector(width)
    jacobian_matrix = jacobian.matrix(height, width)
    # Gradient of the Lagrangian lam_f f + lam_g' g.
    stationarity = lam_f * slope + jacobian_matrix.T @ lam_g
    of_lagrangian = [cost_again, g_again, stationarity, slope_of_p]

    def with_hessian(*before: ca.MX, upper: bool) -> ca.Function:
        outputs = [*before, hessian.matrix(width, width, upper=upper)]
        return ca.Function("nlp_hess_l", curvature, outputs)

    functions: dict[str, Callable[[], ca.Function]] = {
        "lagrangian": lambda: ca.Function("nlp_grad", curvature, of_lagrangian),
        "jacobian": lambda: ca.Function("nlp_jac_g", [x, p], [g_again, jacobian_matrix]),
        "gradient": lambda: ca.Function("nlp_grad_f", [x, p], [cost_again, slope]),
        "gradient_only": lambda: ca.Function("nlp_grad_f", [x, p], [slope]),
        "hessian": lambda: with_hessian(ca.MX(width, 1), upper=False),
        "hessian_upper": lambda: with_hessian(upper=True),
    }
    return {"x": x, "f": cost, "g": rows.vector(height)}, LazyFunctions(functions)


def _assembled_again(
    layouts: Sequence[PhaseLayout], parametric: bool, cost_scale: float
) -> Program:
    return replace(assemble(layouts, parametric=parametric), cost_scale=cost_scale)


@dataclass(frozen=True, eq=False)
class KernelCalls:
    """All calls of one kernel: the stages of a phase, or a group of mesh points.

    Attributes
    ----------
    kernel : Kernel
    variables : indices of the variables of every call [M, K]
    rows : indices of the rows of every call [M, R]
    arrivals : indices of the next z, which the first rows determine [M, nz]; [M, 0] for points
    v, arrived : variables [K, M] and next z [nz, M]
    constants : second argument of the kernels [..., M]
    """

    kernel: Kernel
    variables: np.ndarray
    rows: np.ndarray
    arrivals: np.ndarray
    v: ca.MX
    arrived: ca.MX
    constants: ca.MX

    @classmethod
    def at_points(
        cls, kernel: Kernel, x: ca.MX, variables: np.ndarray, rows: np.ndarray, constants: ca.MX
    ) -> KernelCalls:
        """Return the calls of a kernel that determines no next z, for program variables x."""
        gathered = _gathered(x, variables)
        return cls(kernel, variables, rows, variables[:, :0], gathered, ca.MX(), constants)

    def called(self, function: ca.Function, *more: ca.MX) -> list[ca.MX]:
        """Return outputs of a function of the kernel for all stages or points at once."""
        count = self.rows.shape[0]
        threads = self.v.size1() >= LARGE_STAGE and count >= MANY_STAGES and spare_processor()
        mapped = function.map(count, "thread", 2) if threads else function.map(count)
        outputs = mapped.call([self.v, self.constants, *more])
        # A map over one call is inlined and drops structural zeros: restore the sparsity.
        return [ca.project(each, mapped.sparsity_out(k)) for k, each in enumerate(outputs)]

    def values(self, rows: _Entries) -> ca.MX:
        """Add the rows to those of the program, and return the cost."""
        *parts, cost = self.called(self.kernel.value)
        if self.arrivals.size:
            parts[0] = self.arrived - parts[0]
        rows.add(self.rows, 0, ca.vertcat(*parts))
        return ca.sum2(self.cost(cost)[0])

    def cost(self, *arguments: ca.MX) -> Sequence[ca.MX]:
        """Return the cost of every call, and its gradient if requested.

        A separate cost kernel is used if there is one, so that solvers that need the cost alone do
        not evaluate the dynamics. Otherwise ``arguments``, the outputs of another kernel, are it.
        """
        if self.kernel.cost is None:
            return arguments
        return self.kernel.cost.map(self.rows.shape[0]).call([self.v, self.constants])

    def first_order(self, rows: _Entries, gradient: _Entries, jacobian: _Entries) -> ca.MX:
        """Add rows, gradient and Jacobian to those of the program, and return the cost."""
        both, block, cost, slope = self.called(self.kernel.jacobian)
        at, column = np.array(self.kernel.jacobian.sparsity_out(1).get_triplet(), dtype=int)
        entries, steps = block.nz[:], self.arrivals.shape[1]
        # Step rows are z_next - next(z, w), equation (3): the sign of the kernel's block changes.
        if steps:
            entries *= ca.DM(np.tile(np.where(at < steps, -1.0, 1.0), self.rows.shape[0]))
            jacobian.add(self.rows[:, :steps], self.arrivals, np.ones(self.arrivals.size))
            both = ca.vertcat(self.arrived - both[:steps, :], both[steps:, :])
        jacobian.add(self.rows[:, at], self.variables[:, column], entries)
        rows.add(self.rows, 0, both)
        cost, slope = self.cost(cost, slope)
        gradient.add(self.variables, 0, slope)
        return ca.sum2(cost)

    def second_order(self, lam_f: ca.MX, lam_g: ca.MX, hessian: _Entries) -> None:
        """Add the Hessian of the Lagrangian to that of the program."""
        lam = _gathered(lam_g, self.rows)
        weights = lam, ca.repmat(lam_f, 1, self.rows.shape[0])
        (block,) = self.called(self.kernel.hessian, *weights)
        row, column = np.array(self.kernel.hessian.sparsity_out(0).get_triplet(), dtype=int)
        hessian.add(self.variables[:, row], self.variables[:, column], block.nz[:])


def _conditions(layout: PhaseLayout) -> Iterator[LinearRows]:
    """Yield the linear rows of a phase."""
    for block, node in ((layout.initial, 0), (layout.final, -1)):
        columns = layout.nodes[node, layout.node_columns(block)]
        yield block.places[0], columns, np.ones(columns.size)
    yield layout.link.places[0], layout.targets, np.ones(layout.targets.size)
    yield layout.link.places[0], layout.sources, -layout.factors


def _pieces(layout: PhaseLayout, constants: ca.MX, x: ca.MX) -> Iterator[KernelCalls]:
    """Yield the point kernels of a phase followed by its stages, called on all variables."""
    for group in layout.points:
        fractions = ca.MX(ca.DM(layout.mesh[group.nodes]).T)
        data = _gathered(constants, layout.point_places(group).T)
        at = layout.nodes[group.nodes], group.block.places
        yield KernelCalls.at_points(group.kernel, x, *at, ca.vertcat(fractions, data))
    grid = ca.MX(ca.DM(np.vstack([layout.mesh[:-1], np.diff(layout.mesh)])))
    fixed = ca.repmat(constants[: layout.parameters.size], 1, layout.intervals)
    at = layout.stage_variables, layout.stage_rows, layout.nodes[1:]
    v, arrived = _gathered(x, at[0]), _gathered(x, at[2])
    yield KernelCalls(layout.kind.kernels.stage, *at, v, arrived, ca.vertcat(grid, fixed))


def _gathered(x: ca.MX, places: np.ndarray) -> ca.MX:
    """Return entries of x: one column for every row of places [M, ...]."""
    return ca.reshape(x[places.ravel().tolist()], places.shape[1], places.shape[0])
