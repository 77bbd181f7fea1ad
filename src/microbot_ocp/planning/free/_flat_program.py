"""The flat program of a free motion: spline coefficients and durations, limits as rows, no states.

A fully actuated arm is flat: torques are functions of q(t) and its derivatives. So the position
alone is unknown, as a cubic spline, whose acceleration is piecewise linear; velocities and
accelerations at via points and one duration a phase are shared. There are no equations, only rows.

Theory: docs/theory/flat.md.
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence, Sized
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.limits import LimitFamily
from microbot_ocp.ocp import OptimalControlProblem, Phase, PhaseSolution, Solution, SolverSettings
from microbot_ocp.ocp.problem import with_phases, with_values
from microbot_ocp.ocp.solution import StartingPoint
from microbot_ocp.ocp.transcription import (
    Block,
    Guess,
    Label,
    Meshes,
    Program,
    TableEntry,
    mesh_of,
)
from microbot_ocp.planning.free._flat_loops import Form, loops_of
from microbot_ocp.planning.free._flat_rows import (
    POINT_KEYS,
    FlatRows,
    Scales,
    WindowPlaces,
    flat_rows,
    window_places,
)
from microbot_ocp.planning.free._initial_guesses import guess_along
from microbot_ocp.planning.free._point_limits import ORDERS, PointLimits, point_limits
from microbot_ocp.planning.free._problem import JERK_WEIGHT, free_problem, phase_shapes
from microbot_ocp.planning.free._spline import (
    DEGREE,
    PLACES,
    SLOPES,
    IntArray,
    SplineLayout,
    spline_layout,
)
from microbot_ocp.planning.task import (
    Conditions,
    TaskScale,
    has_windows,
    passing,
)
from microbot_ocp.robot import Robot

DUAL = 1e-6  # tolerance of stationarity, scaled
LEAST_RATIO = 0.1  # of typical durations: from rest in a shorter segment a start may run off
LEAST_INTERVALS = 4  # of a phase: fewer leave nothing between what its ends decide


# values and derivatives ---------------------------------------------------------------------------


class FlatEvaluation:
    """Values and derivatives of a flat program at scaled unknowns; the last ones are kept."""

    def __init__(self, structure: FlatStructure, form: Form, payloads: FloatArray) -> None:
        rows = structure.rows
        self.rows, self.form = rows, form
        self.loops = loops_of(rows, form, structure.places)
        unknowns = form.scales.unknowns
        first, second = structure.of_hessian
        self._jacobian_scale = unknowns[structure.of_jacobian[1]]
        self._hessian_scale = unknowns[first] * unknowns[second]
        self._payload = payloads[rows.phase][:, None]
        self._starts = form.starts[rows.phase]
        self._groups = _phases_with(rows)
        self._q = np.zeros((ORDERS, form.points, form.joints))
        self._at: bytes = b""
        self._known: dict[str, Any] = {}
        point, order, joint = np.nonzero(rows.of_motion >= 0)
        self._motion = order, point, joint
        self._motion_scale = form.scales.motion[order, joint]
        self._limits = np.nonzero(rows.at_points >= 0)
        self._rated = np.flatnonzero((rows.of_rates >= 0).any(axis=1))  # starts and middles
        self._inside = self._rated[::2, None] + np.arange(PLACES.size)
        typical = form.scales.durations[rows.phase[self._rated]]
        self._rate_factor = typical[:, None] / form.scales.change[form.torques]
        self._jerks = np.nonzero(rows.of_jerks >= 0)
        counts = np.cumsum([0, *(int((table >= 0).sum()) for table in rows.tables)])
        self._parts = [slice(a, b) for a, b in itertools.pairwise(counts)]

    def _move(self, x: FloatArray) -> None:
        key = x.tobytes()
        if key == self._at:
            return
        unknowns = x * self.form.scales.unknowns
        self._T = np.ascontiguousarray(unknowns[self.rows.layout.durations])
        self.loops.move(unknowns, self._T, self._q)
        self._q[0] += self._starts
        self._at, self._known = key, {}

    def _called(self, name: str, *given: FloatArray) -> list[FloatArray]:
        """Return outputs of functions of the limits at all points."""
        if len(self._groups) == 1:
            answer = getattr(self._groups[0][1], name)(*self._q, self._payload, *given)
            given_back = answer if isinstance(answer, tuple) else (answer,)
            return [np.ascontiguousarray(output) for output in given_back]
        outputs: list[FloatArray] = []
        for points, limits in self._groups:
            size = limits.count
            weights = [np.ascontiguousarray(w[points, :size]) for w in given]
            moved = (np.ascontiguousarray(q) for q in self._q[:, points])
            answer = getattr(limits, name)(*moved, self._payload[points], *weights)
            for k, part in enumerate(answer if isinstance(answer, tuple) else (answer,)):
                if len(outputs) <= k:
                    outputs.append(np.zeros((self.form.points, part.shape[1])))
                outputs[k][points] = part
        return outputs

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
        if "values" not in self._known:
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
            g[rates] = (change / self._T[self.rows.phase[self._rated]][:, None]).ravel()
        if jerks.stop > jerks.start:
            table = np.zeros((self.form.points, self.form.joints))
            for moved in self.loops.moved:
                if moved.windows.is_interval:
                    table[moved.windows.points[:, 0]] = moved.jerk / self.form.scales.jerk
            g[jerks] = table[self._jerks]
        return g

    def jacobian(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return values of the rows and the nonzeros of their Jacobian."""
        self._move(x)
        self._with_slopes()
        entries = np.zeros(self._jacobian_scale.size)
        self.loops.jacobian(self._T, self._known["values"], self._known["slopes"], entries)
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
            of_torques = SLOPES.T @ of_rates[self._inside[:, :2]]
            for place, points in enumerate(self._inside.T):  # each point once
                weights[np.ix_(points, form.torques)] += of_torques[:, place]
        of_jerks[self._jerks] = lam[jerks] / form.scales.jerk[self._jerks[1]]
        gradient, blocks = self._called("curvature", weights)
        by_motion = np.zeros((form.points, ORDERS, form.joints))
        by_motion[self._motion[1], self._motion[0], self._motion[2]] = (
            lam[motion] / self._motion_scale
        )
        gradient = gradient + by_motion.reshape(form.points, -1)
        entries = np.zeros(self._hessian_scale.size)
        given = self._T, values, slopes, blocks, gradient, of_rates, of_jerks
        self.loops.hessian(*given, of_cost, entries)
        return entries * self._hessian_scale


def _phases_with(rows: FlatRows) -> list[tuple[Any, PointLimits]]:
    """Return points of phases with the same limits, and these."""
    groups: dict[int, list[int]] = {}
    for k, limits in enumerate(rows.limits):
        groups.setdefault(id(limits), []).append(k)
    return [
        (np.flatnonzero(np.isin(rows.phase, phases)), rows.limits[phases[0]])
        for phases in groups.values()
    ]


class _Numeric(ca.Callback):
    """A function of arrays as one of CasADi's, by the sparsities of its inputs and outputs."""

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


# the program --------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class FlatStructure:
    """What a program is by its meshes and kinds of limits alone.

    Attributes
    ----------
    rows : FlatRows
    jacobian, hessian : casadi.Sparsity
    places : list of WindowPlaces
    """

    rows: FlatRows
    jacobian: ca.Sparsity
    hessian: ca.Sparsity
    places: list[WindowPlaces]

    @cached_property
    def of_jacobian(self) -> tuple[IntArray, IntArray]:
        """Rows and columns of the nonzeros of the Jacobian."""
        return np.array(self.jacobian.row()), np.array(self.jacobian.get_col())

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
        With the scales.
    """

    structure: FlatStructure = None  # pyright: ignore[reportAssignmentType]
    evaluation: FlatEvaluation = None  # pyright: ignore[reportAssignmentType]

    @property
    def scales(self) -> Scales:
        """What the program is divided by."""
        return self.evaluation.form.scales

    def time_of(self, label: Label, x: FloatArray) -> float:
        """Return when a row or variable stands at x, s since the start of its phase."""
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
        """Return the gradient of the cost and the rows with their multipliers, and the rows."""
        slope, rows, entries = self.slopes(x)
        row, column = self.structure.of_jacobian
        along = np.bincount(column, entries * multipliers[row], minlength=slope.size)
        return slope + along, rows

    def slopes(self, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the gradient of the cost, the values of the rows and the nonzeros of their
        Jacobian.
        """
        rows, entries = self.evaluation.jacobian(x)
        return self.evaluation.gradient(x)[1], rows, entries


def _functions(structure: FlatStructure, evaluation: FlatEvaluation) -> dict[str, ca.Function]:
    """Return a flat program's functions as solvers ask for them."""
    size, height = structure.rows.layout.size, structure.rows.height
    dense = ca.Sparsity.dense
    x, p, one, g = dense(size), dense(0), dense(1), dense(height)
    jacobian, hessian = structure.jacobian, structure.hessian

    def of_lagrangian(x: FloatArray, _: Any, sigma: FloatArray, lam: FloatArray) -> Any:
        cost, slope = evaluation.gradient(x)
        rows, entries = evaluation.jacobian(x)
        along = ca.mtimes(ca.DM(jacobian, entries).T, ca.DM(lam))
        return cost, rows, sigma * slope + np.array(along).ravel(), np.zeros(0)

    def curvature(x: FloatArray, _: Any, sigma: FloatArray, lam: FloatArray) -> Any:
        return (evaluation.hessian(x, float(sigma[0]), lam),)

    return {
        "values": _Numeric(
            "nlp", [x], [one, g], lambda x: (evaluation.cost(x), evaluation.values(x))
        ),
        "jacobian": _Numeric(
            "nlp_jac_g", [x, p], [g, jacobian], lambda x, _: evaluation.jacobian(x)
        ),
        "gradient": _Numeric("nlp_grad_f", [x, p], [one, x], lambda x, _: evaluation.gradient(x)),
        "hessian_upper": _Numeric("nlp_hess_l", [x, p, one, g], [hessian], curvature),
        "lagrangian": _Numeric("nlp_grad", [x, p, one, g], [one, g, x, p], of_lagrangian),
    }


# where everything stands, for labels and multipliers ----------------------------------------------


@dataclass(frozen=True, eq=False)
class FlatLayout:
    """Where one phase stands in a flat program.

    Attributes
    ----------
    phase : Phase
    mesh : array [N+1]
    index : int
        Of the phase.
    rows_of_all : FlatRows
    scales : Scales
    families : tuple of LimitFamily
    """

    phase: Phase
    mesh: FloatArray
    index: int
    rows_of_all: FlatRows
    scales: Scales
    family: LimitFamily
    start: FloatArray
    fixed: np.ndarray

    @property
    def intervals(self) -> int:
        """Number of intervals."""
        return self.mesh.size - 1

    @property
    def stage_sizes(self) -> tuple[IntArray, IntArray, IntArray]:
        """Nothing: there are no stages with equations."""
        return np.zeros(0, dtype=int), np.zeros(0, dtype=int), np.zeros(0, dtype=int)

    def place_of(self, label: Label) -> float:
        """Return where a row or variable of the phase stands, as a fraction of the phase."""
        if label.interval == self.intervals:
            return 1.0
        start, end = self.mesh[label.interval : label.interval + 2]
        return float(start + label.fraction * (end - start))

    def unpacked(self, x: FloatArray) -> PhaseSolution:
        """Return the motion of the phase at its mesh points."""
        layout, unknowns = self.rows_of_all.layout, x * self.scales.unknowns
        duration = float(unknowns[layout.durations][self.index])
        q = _sampled(layout, self.index, unknowns, duration, self.start)
        values: dict[str, FloatArray] = {"q": q[0], "qd": q[1], "qdd": q[2]}
        stages = np.hstack([*q, np.full((self.mesh.size, 1), duration)])
        return PhaseSolution(self.phase.name, duration, self.mesh, values, self, stages)  # type: ignore[arg-type]

    def interpolated(
        self, stages: FloatArray, k: IntArray, share: FloatArray
    ) -> dict[str, FloatArray]:
        """Return the motion at shares [M] of intervals, from that at mesh points and the duration
        [N+1,3n+1].
        """
        q, qd, qdd = np.split(stages[:, :-1], ORDERS, axis=1)
        motion: dict[str, Any] = {"q": q, "qd": qd, "qdd": qdd}
        phase = PhaseSolution("", float(stages[0, -1]), self.mesh, motion)
        at = self.mesh[k] + share * np.diff(self.mesh)[k]
        q, qd, qdd = _resampled(phase, at)
        return {"q": q, "qd": qd, "qdd": qdd}

    # tables ---------------------------------------------------------------------------------------

    @cached_property
    def _points(self) -> slice:
        first = sum(2 * mesh.size - 1 for mesh in self.rows_of_all.layout.meshes[: self.index])
        return slice(first, first + 2 * self.mesh.size - 1)

    @cached_property
    def rows(self) -> tuple[Block, ...]:
        """Blocks of rows at mesh points, then in the middles of intervals."""
        rows, limits = self.rows_of_all, self.rows_of_all.limits[self.index]
        blocks = []
        unit = {
            key: self.family[key].units if key in self.family else () for key, *_ in limits.names
        }
        of_limits = [
            (
                "constraint",
                limits.labels[row],
                k,
                unit[key][k] if unit[key] else "",
                limits.scale[row],
            )
            for row, (key, k, _) in enumerate(limits.names)
        ]
        n = rows.layout.count
        of_motion = [
            ("bound", key, k, self.family.robot.unit(key, k), self.scales.motion[order, k])
            for order, key in enumerate(POINT_KEYS)
            for k in range(n)
        ]
        of_jerks = [
            ("constraint", "jerk", k, self.family.robot.unit("qddd", k), self.scales.jerk[k])
            for k in range(n)
        ]
        torques = [limits.names[row][1] for row in rows.torques]
        of_rates = [
            ("constraint", "torque rate", k, self.family.robot.unit("taud", k), self.scales.rate[k])
            for k in torques
        ]
        tables = (
            (rows.at_points[:, : len(of_limits)], of_limits, len(of_limits), None),
            (rows.of_motion.reshape(-1, ORDERS * n), of_motion, n, None),
            (rows.of_rates, of_rates, n, rows.lengths() * self.scales.durations[self.index]),
            (rows.of_jerks, of_jerks, n, None),
        )
        for numbers, entries, size, factors in tables:
            numbers = numbers[self._points]
            given = None if factors is None else factors[self._points]
            for step, fraction in ((0, 0.0), (1, 0.5)):
                blocks += _blocks(
                    numbers[step::2],
                    entries,
                    fraction,
                    size,
                    None if given is None else given[step::2],
                )
        return tuple(blocks)

    @cached_property
    def variables(self) -> tuple[Block, ...]:
        """Blocks of unknowns: at the via points of the phase, coefficients, and the duration."""
        layout, n = self.rows_of_all.layout, self.rows_of_all.layout.count
        robot, index = self.family.robot, self.index
        last = index == len(layout.meshes) - 1

        def entry(kind: str, key: str, k: int, at: int, fraction: float = 0.0) -> TableEntry:
            if kind in ("state", "control") and self.fixed[at]:
                kind = "initial"  # a condition, not a limit
            unit, scale = robot.unit(key, k), float(self.scales.unknowns[at])
            return TableEntry(kind, None, key, k, n, fraction, unit, scale)

        blocks = []
        ends = [(0, layout.nodes[index], "initial")]
        ends += [(self.intervals, layout.nodes[index + 1], "final")] if last else []
        for interval, (q, v, before, after), kind in ends:
            a = before if kind == "final" else after
            parts = [(kind, "q", q), ("state", "qd", v), ("control", "qdd", a)]
            if before != after and index > 0:
                parts.append(("control", "qdd", before))
            for kind_of, key, start in parts:
                places = start + np.arange(n)
                entries = tuple(entry(kind_of, key, k, at) for k, at in enumerate(places.tolist()))
                blocks.append(Block(entries, np.array([interval]), places[None]))
        inner = layout.inner[index]
        if inner.stop > inner.start:
            places = np.arange(inner.start, inner.stop).reshape(-1, n)
            entries = tuple(
                entry("coefficient", "q", k, at) for k, at in enumerate(places[0].tolist())
            )
            blocks.append(Block(entries, 1 + np.arange(len(places)), places))
        at = layout.durations.start + index
        duration = TableEntry(
            "duration", None, "duration", 0, 1, 0.0, "s", float(self.scales.unknowns[at])
        )
        blocks.append(Block((duration,), np.array([0]), np.array([[at]])))
        return tuple(blocks)


def _blocks(
    numbers: IntArray,
    entries: Sequence[tuple[Any, ...]],
    fraction: float,
    size: int,
    factors: FloatArray | None,
) -> Iterator[Block]:
    """Yield blocks of rows [M,K] that the program has, those of the same intervals together."""
    patterns: dict[bytes, list[int]] = {}
    for k in range(len(entries)):
        there = numbers[:, k] >= 0
        if there.any():
            patterns.setdefault(there.tobytes(), []).append(k)
    for pattern, columns in patterns.items():
        intervals = np.flatnonzero(np.frombuffer(pattern, dtype=bool))
        table = []
        for k in columns:
            kind, name, component, unit, scale = entries[k]
            table.append(
                TableEntry(kind, None, name, component, size, fraction, unit, float(scale))
            )
        given = None if factors is None else factors[intervals]
        yield Block(tuple(table), intervals, numbers[intervals][:, columns], given)


def _sampled(
    layout: SplineLayout, index: int, unknowns: FloatArray, T: float, start: FloatArray
) -> FloatArray:
    """Return position, velocity and acceleration [3,N+1,n] at the mesh points of a phase."""
    n, mesh = layout.count, layout.meshes[index]
    q = np.zeros((ORDERS, mesh.size, n))
    first = sum(2 * m.size - 1 for m in layout.meshes[:index])
    for windows in layout.every:
        mine = windows.phase == index
        if not mine.any():
            continue
        place = 0 if windows.is_interval else 2
        u = unknowns[windows.columns[mine][..., None] + np.arange(n)]
        u = u - windows.anchored[mine][..., None] * start
        exponents = windows.powers[mine][:, None] - np.arange(ORDERS)[:, None]
        y = (windows.weights[mine, place] * T**exponents) @ u
        q[:, (windows.points[mine, place] - first) // 2] = y.swapaxes(0, 1)
    q[0] += start
    return q


# transcription ------------------------------------------------------------------------------------


@dataclass(eq=False)
class FlatTranscription:
    """A free motion's problem in the unknowns of the flat program, for any mesh.

    It takes the place of a :class:`~microbot_ocp.ocp.transcription.Transcription` of the same
    problem.

    Attributes
    ----------
    problem : OptimalControlProblem
        As declared, with states: names of phases, and the parameters in use.
    families : tuple of LimitFamily
        One a phase.
    conditions : Conditions
    size : TaskScale
    payload : bool
        Whether the phases have the parameter "payload".
    widened : mapping from a key to (lower, upper), each [n]
        Bounds of the first phase, whose start is beyond those of its family.
    """

    problem: OptimalControlProblem
    families: tuple[LimitFamily, ...]
    conditions: Conditions
    size: TaskScale
    payload: bool = False
    widened: Mapping[str, tuple[FloatArray, FloatArray]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._structures: dict[tuple[bytes, ...], FlatStructure] = {}
        asked = [
            tuple(k for k in f.keys if k not in (*POINT_KEYS, "taud", "qddd"))
            for f in self.families
        ]
        rated = ["taud" in family for family in self.families]
        keys = [
            (*k, *(["tau"] if r and "tau" not in k else []))
            for k, r in zip(asked, rated, strict=True)
        ]
        self.limits = tuple(
            point_limits(f.robot, k, self.payload) for f, k in zip(self.families, keys, strict=True)
        )

    def with_parameters(self, values: Mapping[str, Mapping[str, Any]]) -> FlatTranscription:
        """Return the same with other values of phase parameters, by phase and name."""
        changed = copy.copy(self)
        phases = (with_values(p, values.get(p.name, {})) for p in self.problem.phases)
        changed.problem = with_phases(self.problem, phases)
        return changed

    def under(
        self,
        family: LimitFamily,
        conditions: Conditions,
        size: TaskScale,
        widened: Mapping[str, tuple[FloatArray, FloatArray]],
    ) -> FlatTranscription:
        """Return the same program with the numbers of other limits and conditions."""
        changed = copy.copy(self)
        changed.families = (family,) * len(self.families)
        changed.conditions, changed.size, changed.widened = conditions, size, widened
        return changed

    def _bounds(self, phase: int, key: str) -> tuple[FloatArray, FloatArray]:
        """Return bounds [n] of a joint's limit in a phase."""
        if phase == 0 and key in self.widened:
            return self.widened[key]
        return self.families[phase].robot.limits.bounds(key)

    def _meshes(self, meshes: Meshes) -> list[FloatArray]:
        count = len(self.families)
        several = isinstance(meshes, Sized) and getattr(meshes, "ndim", 1) > 0
        chosen: list[Any] = list(meshes) if several else [meshes] * count  # type: ignore[arg-type]
        return [mesh_of(max(m, LEAST_INTERVALS) if isinstance(m, int) else m) for m in chosen]

    def layouts(self, meshes: Meshes) -> tuple[FlatLayout, ...]:
        """Return where every phase stands on a mesh for each."""
        return self.program(meshes).layouts

    def structure(self, meshes: Sequence[FloatArray]) -> FlatStructure:
        """Return what the program on meshes is whatever the numbers, kept for further ones."""
        key = *(mesh.tobytes() for mesh in meshes), self._kinds
        if key not in self._structures:
            if len(self._structures) >= 8:
                self._structures.pop(next(iter(self._structures)))
            self._structures[key] = self._made(meshes)
        return self._structures[key]

    @property
    def _kinds(self) -> bytes:
        """Which limits of the joints there are, and where accelerations may jump."""
        keys = (*POINT_KEYS, "taud", "qddd")
        limits = [f.robot.limits.bounds(key) for f in self.families for key in keys]
        return np.isfinite(limits).tobytes() + bytes(end.leaps for end in self.conditions.ends)

    def _made(self, meshes: Sequence[FloatArray]) -> FlatStructure:
        n = self.families[0].robot.joint_count
        leaps = [end.leaps for end in self.conditions.ends]
        leaps[0] = leaps[-1] = False
        layout = spline_layout(meshes, n, leaps)
        rows = flat_rows(layout, self.families, self.limits)
        return FlatStructure(rows, *window_places(rows))

    @property
    def _starts(self) -> FloatArray:
        """Positions [m-1,n] where phases start, zero where they are free."""
        q = np.array([0.5 * (end.q[0] + end.q[1]) for end in self.conditions.ends[:-1]])
        return np.where(np.isfinite(q), q, 0.0)

    def _scales(self, structure: FlatStructure) -> Scales:
        layout = structure.rows.layout
        size, n = self.size, layout.count
        limits = self.families[0].robot.limits
        motion = np.array(
            [
                np.full(n, size.position),
                _finite(limits.bounds("qd"), size.velocity),
                _finite(limits.bounds("qdd"), size.acceleration),
            ]
        )
        unknowns = np.full(layout.size, size.position)
        for inner, duration in zip(layout.inner, size.durations, strict=True):
            if duration < size.durations.max():
                unknowns[inner] *= duration / size.durations.max()
        for _, v, before, after in layout.nodes:
            unknowns[v : v + n] = motion[1]
            unknowns[before : before + n] = unknowns[after : after + n] = motion[2]
        unknowns[layout.durations] = size.time
        torque = self.limits[0].torque_scale  # whatever the limits are now
        rate = _finite(limits.bounds("taud"), size.acceleration / size.time)
        jerk = _finite(limits.bounds("qddd"), size.jerk)
        return Scales(unknowns, motion, torque, rate, jerk, size.durations)

    def program(self, meshes: Meshes) -> FlatProgram:
        """Return the program on a mesh for each phase."""
        chosen = self._meshes(meshes)
        structure = self.structure(chosen)
        rows, phases, scales = structure.rows, self.problem.phases, self._scales(structure)
        weights = {p.name: float(p.value[0]) for p in phases[0].parameters}
        payloads = [
            float(next((p.value[0] for p in phase.parameters if p.name == "payload"), 0.0))
            for phase in phases
        ]
        pairs = np.array(rows.limits[0].pairs).reshape(-1, 2)
        form = Form(
            joints=rows.layout.count,
            rows=rows.at_points.shape[1],
            points=rows.layout.points,
            torques=rows.torques,
            pairs=pairs,
            scales=scales,
            starts=self._starts,
            jerk_weight=weights[JERK_WEIGHT] / self.size.jerk**2,
        )
        evaluation = FlatEvaluation(structure, form, np.array(payloads))
        functions = _functions(structure, evaluation)
        x = ca.MX.sym("x", rows.layout.size)
        f, g = functions["values"].call([x])
        low, high = self._variable_bounds(structure, scales)
        layouts = tuple(
            FlatLayout(phase, mesh, k, rows, scales, family, form.starts[k], low == high)
            for k, (phase, mesh, family) in enumerate(
                zip(phases, chosen, self.families, strict=True)
            )
        )
        return FlatProgram(
            low,
            high,
            *self._row_bounds(structure, scales),
            layouts=layouts,  # type: ignore[arg-type]
            nlp={"x": x, "f": f, "g": g},
            functions=functions,
            parameters=np.zeros(0),
            cost_scale=self.size.time,
            structure=structure,
            evaluation=evaluation,
        )

    def _variable_bounds(
        self, structure: FlatStructure, scales: Scales
    ) -> tuple[FloatArray, FloatArray]:
        layout, n = structure.rows.layout, structure.rows.layout.count
        low, high = np.full(layout.size, -np.inf), np.full(layout.size, np.inf)
        low[layout.durations], high[layout.durations] = self.size.shortest, self.size.longest
        last = len(layout.meshes)
        for k, ((q, v, before, after), end) in enumerate(
            zip(layout.nodes, self.conditions.ends, strict=True)
        ):
            beside = [j for j in (k - 1, k) if 0 <= j < last]
            for at, key, bounds in (
                (q, "q", end.q),
                (v, "qd", end.qd),
                (before, "qdd", end.qdd),
                (after, "qdd", end.qdd),
            ):
                low[at : at + n], high[at : at + n] = _within(
                    bounds, [self._bounds(j, key) for j in beside]
                )
        held = self._held
        if held.any():
            for (q, v, before, after), inner in zip(
                layout.nodes, (*layout.inner, None), strict=True
            ):
                start = low[layout.nodes[0][0] : layout.nodes[0][0] + n][held]
                for at, value in ((q, start), (v, 0.0), (before, 0.0), (after, 0.0)):
                    low[at : at + n][held] = high[at : at + n][held] = value
                if inner is not None:
                    for table in (low, high):
                        table[inner].reshape(-1, n)[:, held] = 0.0
        return low / scales.unknowns, high / scales.unknowns

    @cached_property
    def _held(self) -> np.ndarray:
        limits = self.families[0].robot.limits
        return (limits.qdd_min == 0.0) & (limits.qdd_max == 0.0)

    def _row_bounds(
        self, structure: FlatStructure, scales: Scales
    ) -> tuple[FloatArray, FloatArray]:
        rows = structure.rows
        lengths = rows.lengths()
        low = [np.full(rows.height, -np.inf), np.full(rows.height, np.inf)]
        for k, family in enumerate(self.families):
            mine, joints = rows.phase == k, rows.torques
            names = rows.limits[k]
            for side, (bound, values) in enumerate(
                zip(low, names.bounds(family, {} if k else self.widened), strict=True)
            ):
                for numbers, sizes in (
                    (rows.at_points[mine, : names.count], values[None]),
                    (
                        rows.of_motion[mine],
                        np.array([self._bounds(k, key)[side] for key in POINT_KEYS])
                        / scales.motion,
                    ),
                    (
                        rows.of_rates[mine],
                        (lengths[mine] * scales.durations[k])[:, None]
                        * (self._bounds(k, "taud")[side] / scales.rate)[joints],
                    ),
                    (rows.of_jerks[mine], self._bounds(k, "qddd")[side] / scales.jerk),
                ):
                    there = numbers >= 0
                    bound[numbers[there]] = np.broadcast_to(sizes, numbers.shape)[there]
        return low[0], low[1]

    @staticmethod
    def solver_settings(
        program: Program, settings: SolverSettings, barrier: float | None
    ) -> SolverSettings:
        """Return settings for the flat program: which barrier parameter it begins with, and that
        complementarity is met as closely as is asked for.

        Stationarity is not: an acceleration is a coefficient over the square of an interval, whose
        rounding is all that is left of it on short ones.
        """
        given: dict[str, Any] = {
            "linear_solver": "ldl" if (program.row_lower == program.row_upper).any() else "band",
            "nlp_scaling_method": "none",  # rows and unknowns are scaled
            "compl_inf_tol": 0.1 * settings.tolerance,
        }
        if barrier is not None:
            given["mu_init"] = barrier
        more = dict(settings.options.get("ipopt", {}))
        more.pop("linear_solver", None)
        given |= more
        options = {**settings.options, "ipopt": given}
        return replace(settings, tolerance=max(settings.tolerance, DUAL), options=options)

    # starts -----------------------------------------------------------------------------------

    def starting_point(self, program: FlatProgram, guess: Any) -> StartingPoint:
        """Return unknowns from guesses of q, qd and qdd, or from an earlier solution."""
        layout, names = program.structure.rows.layout, [p.name for p in self.problem.phases]
        if isinstance(guess, Solution):
            olds = [phase.layout for phase in guess.phases]
            if all(isinstance(old, FlatLayout) for old in olds) and guess.variables is not None:
                return self._from_solution(program, guess)
            guess = {n: guess_along(s) for n, s in zip(names, phase_shapes(guess), strict=True)}
        motion = []
        for name, mesh in zip(names, layout.meshes, strict=True):
            given: Guess = guess[name]
            tables = [_table(given.values.get(key, 0.0), mesh, layout.count) for key in POINT_KEYS]
            motion.append((float(given.duration or 1.0), np.array(tables)))
        x = self._packed(layout, motion, self._starts)
        return StartingPoint(self._inside(program, x / program.scales.unknowns))

    @staticmethod
    def _inside(program: FlatProgram, x: FloatArray) -> FloatArray:
        fixed = program.variable_lower == program.variable_upper
        return np.where(fixed, program.variable_lower, x)

    @staticmethod
    def _packed(
        layout: SplineLayout, motion: Sequence[tuple[float, FloatArray]], starts: FloatArray
    ) -> FloatArray:
        """Return unknowns from durations and motion [3,N+1,n] at the mesh points of all phases.

        The coefficient of a spline that has three knots around a mesh point is the blossom of its
        polynomial there: q + T v (b - a) / 3 - T^2 w a b / 6, with a and b the lengths before and
        after.
        """
        x, n = np.zeros(layout.size), layout.count
        for k, (T, (q, v, a)) in enumerate(motion):
            h = np.diff(layout.meshes[k])
            before, after = h[1:-2, None], h[2:-1, None]
            inner = slice(2, -2)
            c = (
                q[inner]
                - starts[k]
                + T * v[inner] * (after - before) / DEGREE
                - T**2 * a[inner] * before * after / 6.0
            )
            x[layout.inner[k]] = c.ravel()
            x[layout.durations.start + k] = T
            for (at_q, at_v, end, start), j in ((layout.nodes[k], 0), (layout.nodes[k + 1], -1)):
                x[at_q : at_q + n], x[at_v : at_v + n] = q[j], v[j]
                at = start if j == 0 else end
                x[at : at + n] = a[j]
        return x

    def _from_solution(self, program: FlatProgram, guess: Solution) -> StartingPoint:
        layout, scales = program.structure.rows.layout, program.scales
        olds: list[Any] = [phase.layout for phase in guess.phases]
        assert guess.variables is not None
        same = all(np.array_equal(o.mesh, m) for o, m in zip(olds, layout.meshes, strict=True))
        old_rows = olds[0].rows_of_all
        motion = []
        for phase, mesh in zip(guess.phases, layout.meshes, strict=True):
            motion.append((phase.duration, _resampled(phase, mesh)))
        packed = self._packed(layout, motion, self._starts)
        x = self._inside(program, packed / scales.unknowns)
        multipliers = guess.row_multipliers, guess.variable_multipliers
        if not guess.status.solved or multipliers[1] is None:
            return StartingPoint(x)
        if same and old_rows.height == program.structure.rows.height:
            return StartingPoint(x, *multipliers)
        moved = _moved_rows(old_rows, program.structure.rows, multipliers[0])
        variables = np.zeros(layout.size)
        old_layout = old_rows.layout
        n = layout.count
        for old, new in zip(old_layout.nodes, layout.nodes, strict=True):
            for a, b in zip(old, new, strict=True):
                variables[b : b + n] = multipliers[1][a : a + n]
        variables[layout.durations] = multipliers[1][old_layout.durations]
        return StartingPoint(x, moved, variables)


@lru_cache(maxsize=16)
def flat_form(
    robot: Robot,
    via_bytes: bytes,
    count: int,
    *,
    payload: bool = False,
    conditions: Conditions | None = None,
) -> FlatTranscription | None:
    """Return the flat transcription of the problem of a free motion; None where states are kept.

    They are without torques, with dry friction, whose turns take several times the iterations, with
    means over the motion, limits of the user's own, conditions on the pose of the tool, cycles,
    ends in motion, and segments that are far shorter than others.
    """
    via = np.frombuffer(via_bytes).reshape(count, -1)
    given = conditions or passing(robot, via)
    families = tuple(LimitFamily.of(moving) for moving in given.robots)
    size = TaskScale.of(LimitFamily.of(robot), via)
    if not _is_flat(families, given, size):
        return None
    problem = free_problem(robot, via, payload=payload, conditions=conditions)
    return FlatTranscription(problem, families, given, size, payload)


def _is_flat(families: Sequence[LimitFamily], conditions: Conditions, size: TaskScale) -> bool:
    for family in families:
        own = any(member.limit is not None for member in family)
        if has_windows(family) or family.means or own or family.keys != families[0].keys:
            return False
        if not {"tau", "taud"} & set(family.keys):
            return False
    start, *_, end = conditions.ends
    moves = not all(np.all(bound == 0.0) for point in (start, end) for bound in point.qd)
    posed = conditions.closed or any(point.rows for point in conditions.ends)
    durations = size.durations
    short = not durations.min() >= LEAST_RATIO * durations.max() > 0.0
    return not (moves or posed or short)


def _finite(bounds: tuple[FloatArray, FloatArray], typical: FloatArray) -> FloatArray:
    size = np.maximum(-bounds[0], bounds[1])
    return np.where(np.isfinite(size) & (size > 0), size, typical)


def _within(
    given: Any, beside: Sequence[tuple[FloatArray, FloatArray]]
) -> tuple[FloatArray, FloatArray]:
    """Return bounds at a via point: as given there, else those of the limits on both sides."""
    low = np.max([bounds[0] for bounds in beside], axis=0)
    high = np.min([bounds[1] for bounds in beside], axis=0)
    if given is None:
        return low, high
    fixed = np.isfinite(given[0]) & np.isfinite(given[1])
    return np.where(fixed, given[0], np.maximum(given[0], low)), np.where(
        fixed, given[1], np.minimum(given[1], high)
    )


def _table(value: Any, mesh: FloatArray, size: int) -> FloatArray:
    table = np.asarray(value(mesh) if callable(value) else value, dtype=float)
    return np.broadcast_to(table, (mesh.size, size))


def _resampled(phase: PhaseSolution, mesh: FloatArray) -> FloatArray:
    """Return the motion [3,N+1,n] of a phase at the points of another mesh."""
    q, qd, qdd = (phase[key] for key in POINT_KEYS)
    t, T = phase.t, phase.duration
    k = np.clip(np.searchsorted(phase.mesh, mesh, side="right") - 1, 0, phase.mesh.size - 2)
    h = (mesh - phase.mesh[k])[:, None] * T
    jerk = (np.diff(qdd, axis=0) / np.diff(t)[:, None])[k]
    a = qdd[k] + h * jerk
    v = qd[k] + h * (qdd[k] + 0.5 * h * jerk)
    p = q[k] + h * (qd[k] + h * (0.5 * qdd[k] + h * jerk / 6.0))
    return np.array([p, v, a])


def _moved_rows(old: FlatRows, new: FlatRows, values: FloatArray) -> FloatArray:
    """Return multipliers of rows on another mesh: their density along the phase stays.

    That of a difference of torques stays itself: it is the costate of the torque.
    """
    moved = np.zeros(new.height)
    places = [_fractions(rows) for rows in (old, new)]
    for index, (before, after) in enumerate(zip(old.tables, new.tables, strict=True)):
        before, after = (table.reshape(len(table), -1) for table in (before, after))
        for phase in range(len(new.layout.meshes)):
            for column in range(min(before.shape[1], after.shape[1])):
                there = [
                    np.flatnonzero((rows.phase == phase) & (table[:, column] >= 0))
                    for rows, table in ((old, before), (new, after))
                ]
                if not all(points.size for points in there):
                    continue
                (s_old, w_old), (s_new, w_new) = (
                    (fractions[points], np.ones(points.size) if index == 2 else weights[points])
                    for (fractions, weights), points in zip(places, there, strict=True)
                )
                density = values[before[there[0], column]] / w_old
                moved[after[there[1], column]] = np.interp(s_new, s_old, density) * w_new
    return moved


def _fractions(rows: FlatRows) -> tuple[FloatArray, FloatArray]:
    """Return where every point stands in its phase, and the length that belongs to it."""
    fractions, weights = [], []
    for mesh in rows.layout.meshes:
        s = np.empty(2 * mesh.size - 1)
        s[::2], s[1::2] = mesh, 0.5 * (mesh[:-1] + mesh[1:])
        h = np.diff(s)
        fractions.append(s)
        weights.append(0.5 * (np.append(h, 0.0) + np.insert(h, 0, 0.0)))
    return np.concatenate(fractions), np.concatenate(weights)
