"""The flat program for a solver: values and derivatives of its rows and cost.

Arrays hold all points at once, and CasADi receives them as functions. Equations:
docs/theory/flat.md.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.fast_calls import RowsInPlace
from microbot_ocp.ocp.transcription import Label, Program
from microbot_ocp.planning.free._flat_loops import ENDS, Form, loops_of
from microbot_ocp.planning.free._flat_rows import NOWHERE, FlatRows, Places, Scales, WindowPlaces
from microbot_ocp.planning.free._point_limits import ORDERS, PointLimits
from microbot_ocp.planning.free._spline import PLACES, SLOPES, IntArray


class FlatEvaluation:
    """Values and derivatives of a flat program at scaled unknowns, cached for the last unknowns."""

    def __init__(self, structure: FlatStructure, form: Form, held: FloatArray) -> None:
        rows = structure.rows
        self.rows, self.form = rows, form
        self.loops = loops_of(rows, form, structure.places)
        self._at_stops = structure.at_stops
        unknowns = form.scales.unknowns
        first, second = structure.of_hessian
        self._jacobian_scale = unknowns[structure.of_jacobian[1]]
        self._hessian_scale = unknowns[first] * unknowns[second]
        self._starts = form.starts[rows.phase]
        phases = _phases_with(rows)
        self._groups = [
            _LimitsInPlace(points, limits, held[points], form.pairs) for points, limits in phases
        ]
        self._distances = [
            _DistancesInPlace(rows, points, limits, *each)
            for points, limits in phases
            for each in limits.distances
        ]
        self._q = np.zeros((ORDERS, form.points, form.joints))
        self._at: bytes = b""
        self._known: dict[str, Any] = {}
        point, order, joint = np.nonzero(rows.of_motion >= 0)
        self._motion = order, point, joint
        self._motion_scale = form.scales.motion[order, joint]
        self._limits = np.nonzero(rows.at_points >= 0)
        # Rates belong to the starts and to the middles of intervals, alternately.
        self._rated = np.flatnonzero((rows.of_rates >= 0).any(axis=1))
        self._inside = self._rated[::2, None] + np.arange(PLACES.size)
        # A row of a rate is a difference of torques over the actual, relative to the typical
        # duration: see the bounds of rows.
        typical = form.scales.durations[rows.phase[self._rated]]
        self._rate_factor = typical[:, None] / form.scales.change[form.torques]
        # Half of an interval, by which the rate of friction becomes a torque difference.
        self._friction_factor = self._rate_factor * rows.lengths()[self._rated][:, None]
        self._jerks = np.nonzero(rows.of_jerks >= 0)
        counts = np.cumsum([0, *(int((table >= 0).sum()) for table in rows.tables)])
        self._parts = [slice(a, b) for a, b in itertools.pairwise(counts)]

    def _move(self, x: FloatArray) -> None:
        # Solvers ask for values and derivatives at one point in separate calls.
        key = x.tobytes()
        if key == self._at:
            return
        self._unknowns = unknowns = x * self.form.scales.unknowns
        self._T = np.ascontiguousarray(unknowns[self.rows.layout.durations])
        self.loops.move(unknowns, self._T, self._q)
        self._q[0] += self._starts
        self._at, self._known = key, {}

    def _called(self, name: str, weights: FloatArray | None = None) -> list[FloatArray]:
        """Return the outputs of a limit function at all points; valid until the next call."""
        if len(self._groups) == 1 and not self._distances:
            return self._groups[0].called(name, self._q, weights)
        n, rows, blocks = self.form.joints, self.form.rows, len(self.form.pairs)
        shapes = {"values": [(rows,)], "slopes": [(rows,), (ORDERS, rows, n)]}
        shapes["curvature"] = [(ORDERS * n,), (blocks, n**2)]
        outputs = [np.zeros((self.form.points, *shape)) for shape in shapes[name]]
        for group in (*self._groups, *self._distances):
            group.put(name, self._q, weights, outputs)
        return [output.reshape(len(output), -1) for output in outputs]

    def cost(self, x: FloatArray) -> float:
        return self.gradient(x)[0]

    def gradient(self, x: FloatArray) -> tuple[float, FloatArray]:
        """Return the cost and its gradient."""
        self._move(x)
        if "gradient" not in self._known:
            slope = np.zeros(x.size)
            cost = self.loops.cost(self._T, slope)
            self._known["gradient"] = cost, slope * self.form.scales.unknowns
        return self._known["gradient"]

    def values(self, x: FloatArray) -> FloatArray:
        """Return the values of all rows."""
        self._move(x)
        if self._distances:  # the slopes of distances are a part of their values
            self._with_slopes()
        elif "values" not in self._known:
            self._known["values"] = self._called("values")[0]
        return self._rows_of(self._known["values"])

    def _rows_of(self, values: FloatArray) -> FloatArray:
        g = np.empty(self.rows.height)
        limits, motion, rates, jerks = self._parts
        g[limits] = values[self._limits]
        g[motion] = self._q[self._motion] / self._motion_scale
        if self.form.torques.size:
            torques = values[:, self.form.torques][self._inside]
            change = (SLOPES @ torques).reshape(self._rate_factor.shape) * self._rate_factor
            change /= self._T[self.rows.phase[self._rated]][:, None]
            if self.form.friction.size:
                extra = values[:, self.form.friction][self._inside[:, ENDS]]
                change += extra.reshape(change.shape) * self._friction_factor
            g[rates] = change.ravel()
        if jerks.stop > jerks.start:
            table = np.zeros((self.form.points, self.form.joints))
            for moved in self.loops.moved:
                if moved.windows.is_interval:
                    table[moved.windows.points[:, 0]] = moved.jerk / self.form.scales.jerk
            g[jerks] = table[self._jerks]
        for stop, (values, _) in zip(self.rows.at_stops, self._stops(), strict=True):
            g[stop.numbers] = values
        return g

    def _stops(self) -> list[tuple[FloatArray, FloatArray]]:
        """Return values and slopes of the conditions at via points."""
        if "stops" not in self._known:
            self._known["stops"] = [stop.slopes(self._unknowns) for stop in self.rows.at_stops]
        return self._known["stops"]

    def jacobian(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the values of the rows and the nonzeros of their Jacobian."""
        self._move(x)
        self._with_slopes()
        entries = np.zeros(self._jacobian_scale.size)
        self.loops.jacobian(self._T, self._known["values"], self._known["slopes"], entries)
        for (places, _), (_, slopes) in zip(self._at_stops, self._stops(), strict=True):
            entries[places] = slopes
        return self._rows_of(self._known["values"]), entries * self._jacobian_scale

    def _with_slopes(self) -> None:
        if "slopes" not in self._known:
            self._known["values"], self._known["slopes"] = self._called("slopes")

    def hessian(self, x: FloatArray, of_cost: float, lam: FloatArray) -> FloatArray:
        """Return the nonzeros of the upper triangle of the Hessian of the Lagrangian."""
        self._move(x)
        rows, form = self.rows, self.form
        limits, motion, rates, jerks = self._parts
        weights = np.zeros(rows.at_points.shape)
        weights[self._limits] = lam[limits]
        of_rates = np.zeros(rows.of_rates.shape)
        of_jerks = np.zeros(rows.of_jerks.shape)
        nothing = np.zeros(1)
        values = slopes = nothing
        if form.torques.size:
            self._with_slopes()
            values, slopes = self._known["values"], self._known["slopes"]
            spans = self._T[rows.phase[self._rated]][:, None]
            of_rates[self._rated] = lam[rates].reshape(spans.size, -1) * self._rate_factor / spans
            # Weights of rates act on the torques by the transpose of the difference.
            of_torques = SLOPES.T @ of_rates[self._inside[:, :2]]
            # A mesh point is in two intervals, but an in-place addition of numpy counts a repeated
            # index once: one place at a time has distinct points.
            for place, points in enumerate(self._inside.T):
                weights[np.ix_(points, form.torques)] += of_torques[:, place]
            if form.friction.size:
                # Ends of neighbouring intervals are one point: one end at a time, as above.
                of_friction = lam[rates].reshape(spans.size, -1) * self._friction_factor
                for end, place in enumerate(ENDS):
                    points = self._inside[:, place]
                    weights[np.ix_(points, form.friction)] += of_friction[end::2]
        of_jerks[self._jerks] = lam[jerks] / form.scales.jerk[self._jerks[1]]
        # Second derivatives of all rows at a point come from one weighted sum, equation (3) of
        # docs/theory/flat.md.
        gradient, blocks = self._called("curvature", weights)
        by_motion = np.zeros((form.points, ORDERS, form.joints))
        by_motion[self._motion[1], self._motion[0], self._motion[2]] = (
            lam[motion] / self._motion_scale
        )
        gradient = gradient + by_motion.reshape(form.points, -1)
        entries = np.zeros(self._hessian_scale.size)
        given = self._T, values, slopes, blocks, gradient, of_rates, of_jerks
        self.loops.hessian(*given, of_cost, entries)
        for stop, (_, places) in zip(rows.at_stops, self._at_stops, strict=True):
            kept = places != NOWHERE
            bent = stop.curvature(self._unknowns, lam[stop.numbers])
            np.add.at(entries, places[kept], bent[kept])
        return entries * self._hessian_scale


class _LimitsInPlace:
    """Limit functions of one or more phases, at some points of a program, in their own memory."""

    def __init__(self, points: Any, limits: PointLimits, held: FloatArray, pairs: IntArray) -> None:
        self.points, self._limits = points, limits
        # Blocks of second derivatives among those of all phases.
        every = list(map(tuple, pairs.tolist()))
        self._blocks = np.array([every.index(pair) for pair in limits.pairs])
        self._memory: dict[str, RowsInPlace] = {}
        self._held = held

    def called(self, name: str, q: FloatArray, weights: FloatArray | None) -> list[FloatArray]:
        memory = self._memory.get(name)
        if memory is None:
            memory = self._memory[name] = getattr(self._limits, name)(len(self._held))
            for k, column in enumerate(self._held.T[:, :, None], start=ORDERS):
                memory.inputs[k][...] = column
        for order in range(ORDERS):
            memory.inputs[order][...] = q[order, self.points]
        if weights is not None:
            memory.inputs[-1][...] = weights[self.points, : self._limits.in_tables]
        memory.run()
        return memory.outputs

    def put(
        self, name: str, q: FloatArray, weights: FloatArray | None, outputs: list[FloatArray]
    ) -> None:
        """Store the outputs of a function among those of all points, with their shapes."""
        first, *second = self.called(name, q, weights)
        if name == "curvature":
            outputs[0][self.points] = first
            place = np.ix_(np.arange(len(q[0]))[self.points], self._blocks)
            outputs[1][place] = second[0].reshape(len(first), len(self._blocks), -1)
            return
        count = self._limits.in_tables
        outputs[0][self.points, :count] = first
        if second:
            by_order = second[0].reshape(len(first), ORDERS, count, q.shape[2])
            outputs[1][self.points, :, :count] = by_order


class _DistancesInPlace:
    """Limits with derivatives of their own, at the points of a program that have their rows."""

    def __init__(
        self,
        rows: FlatRows,
        points: Any,
        limits: PointLimits,
        in_poses: Callable[[int], Any],
        columns: slice,
    ) -> None:
        points = np.arange(rows.layout.points)[points]
        self.points = points[(rows.at_points[points, columns] >= 0).any(axis=1)]
        self.columns, self._scale = columns, limits.scale[columns]
        self._rows = in_poses(self.points.size)

    def put(
        self, _: str, q: FloatArray, weights: FloatArray | None, outputs: list[FloatArray]
    ) -> None:
        """Store values and slopes of the rows, or with weights add their curvature."""
        at = q[0, self.points]
        if weights is not None:
            given = weights[self.points, self.columns] / self._scale
            gradient, hessian = self._rows.curvature(at, given)
            outputs[0][self.points, : at.shape[1]] += gradient
            outputs[1][self.points, 0] += hessian.reshape(len(at), -1)
            return
        values, slopes = self._rows.slopes(at)
        outputs[0][self.points, self.columns] = values / self._scale
        outputs[1][self.points, 0, self.columns] = slopes / self._scale[:, None]


def _phases_with(rows: FlatRows) -> list[tuple[Any, PointLimits]]:
    """Return each distinct set of limits with the points of its phases."""
    groups: dict[int, list[int]] = {}
    for k, limits in enumerate(rows.limits):
        groups.setdefault(id(limits), []).append(k)
    if len(groups) == 1:
        return [(slice(None), rows.limits[0])]
    return [
        (np.flatnonzero(np.isin(rows.phase, phases)), rows.limits[phases[0]])
        for phases in groups.values()
    ]


class _ArrayFunction(ca.Callback):
    """A numpy function as a CasADi function, by the sparsities of its inputs and outputs."""

    def __init__(
        self,
        name: str,
        inputs: Sequence[ca.Sparsity],
        outputs: Sequence[ca.Sparsity],
        function: Callable[..., Sequence[Any]],
    ) -> None:
        ca.Callback.__init__(self)
        self.inputs, self.outputs, self.function = inputs, outputs, function
        self.construct(name, {})

    def get_n_in(self) -> int:
        return len(self.inputs)

    def get_n_out(self) -> int:
        return len(self.outputs)

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return self.inputs[i]

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return self.outputs[i]

    def has_eval_buffer(self) -> bool:
        return True

    def eval_buffer(self, arg: Sequence[Any], res: Sequence[Any]) -> int:
        given = (np.frombuffer(a) if a is not None else np.zeros(0) for a in arg)
        for to, value in zip(res, self.function(*given), strict=True):
            if to is not None:
                np.frombuffer(to)[:] = value
        return 0


@dataclass(frozen=True, eq=False)
class FlatStructure:
    """Structure of a program, a function of its meshes and kinds of limits alone.

    Attributes
    ----------
    rows : FlatRows
    jacobian, hessian : casadi.Sparsity
    places : list of WindowPlaces
    at_stops : list of (array [r,2n], array [2n,2n])
        Places of the conditions at via points in both.
    """

    rows: FlatRows
    jacobian: ca.Sparsity
    hessian: ca.Sparsity
    places: list[WindowPlaces]
    at_stops: Places

    @cached_property
    def of_jacobian(self) -> tuple[IntArray, IntArray]:
        """Rows and columns of the nonzeros of the Jacobian."""
        return np.array(self.jacobian.row()), np.array(self.jacobian.get_col())

    def along(self, entries: FloatArray, multipliers: FloatArray) -> FloatArray:
        """Return the product of the transposed Jacobian, with these entries, and multipliers."""
        row, column = self.of_jacobian
        weights, size = entries * multipliers[row], self.jacobian.size2()
        return np.bincount(column, weights, size).astype(float, copy=False)

    @cached_property
    def of_hessian(self) -> tuple[IntArray, IntArray]:
        """Rows and columns of the nonzeros of the Hessian."""
        return np.array(self.hessian.row()), np.array(self.hessian.get_col())


@dataclass(frozen=True, eq=False, repr=False)
class FlatProgram(Program):
    """A flat program, ready for a solver.

    Attributes
    ----------
    structure : FlatStructure
    evaluation : FlatEvaluation
        Evaluation of rows and cost, with the scales.
    """

    structure: FlatStructure = None  # pyright: ignore[reportAssignmentType]
    evaluation: FlatEvaluation = None  # pyright: ignore[reportAssignmentType]

    @property
    def scales(self) -> Scales:
        """Units of the program's unknowns and rows."""
        return self.evaluation.form.scales

    def time_of(self, label: Label, x: FloatArray) -> float:
        """Return the time of a row or variable at x, s since the start of its phase."""
        names = [layout.phase.name for layout in self.layouts]
        k = names.index(label.phase)
        scales, layout = self.scales, self.structure.rows.layout
        at = layout.durations.start + k
        return self.layouts[k].place_of(label) * float(x[at] * scales.unknowns[at])

    def row_values(self, x: FloatArray) -> FloatArray:
        """Return values of all rows at x, scaled."""
        return self.evaluation.values(x)

    def cost(self, x: FloatArray) -> float:
        """Return the cost at x."""
        return self.evaluation.cost(x)

    def stationarity(self, x: FloatArray, multipliers: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the gradient of the Lagrangian, and the values of the rows."""
        slope, rows, entries = self.slopes(x)
        return slope + self.structure.along(entries, multipliers), rows

    def slopes(self, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the gradient of the cost, the values of the rows and their Jacobian's nonzeros."""
        rows, entries = self.evaluation.jacobian(x)
        return self.evaluation.gradient(x)[1], rows, entries


def functions_of(structure: FlatStructure, evaluation: FlatEvaluation) -> dict[str, ca.Function]:
    """Return the functions of a flat program by the names that solvers use."""
    size, height = structure.rows.layout.size, structure.rows.height
    dense = ca.Sparsity.dense
    x, p, one, g = dense(size), dense(0), dense(1), dense(height)
    jacobian, hessian = structure.jacobian, structure.hessian

    def of_lagrangian(x: FloatArray, _: Any, sigma: FloatArray, lam: FloatArray) -> Any:
        cost, slope = evaluation.gradient(x)
        rows, entries = evaluation.jacobian(x)
        return cost, rows, sigma * slope + structure.along(entries, lam), np.zeros(0)

    def curvature(x: FloatArray, _: Any, sigma: FloatArray, lam: FloatArray) -> Any:
        return (evaluation.hessian(x, float(sigma[0]), lam),)

    return {
        "values": _ArrayFunction(
            "nlp", [x], [one, g], lambda x: (evaluation.cost(x), evaluation.values(x))
        ),
        "jacobian": _ArrayFunction(
            "nlp_jac_g", [x, p], [g, jacobian], lambda x, _: evaluation.jacobian(x)
        ),
        "gradient": _ArrayFunction(
            "nlp_grad_f", [x, p], [one, x], lambda x, _: evaluation.gradient(x)
        ),
        "hessian_upper": _ArrayFunction("nlp_hess_l", [x, p, one, g], [hessian], curvature),
        "lagrangian": _ArrayFunction("nlp_grad", [x, p, one, g], [one, g, x, p], of_lagrangian),
    }
