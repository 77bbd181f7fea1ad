"""A solution evaluated again from the declared expressions, unscaled and numerically.

Only the places of the values in the solved program are used: no kernel, scale or derivative.
Functions of the declared symbols are built anew, and the formulas of the schemes are implemented a
second time. Schemes without a formula here, such as shooting with an integrator, are integrated
again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import product

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.ocp.problem import (
    Expressions,
    OptimalControlProblem,
    PathConstraint,
    PointConstraint,
    Variable,
    node_variables,
)
from microbot_ocp.ocp.solution import PhaseSolution
from microbot_ocp.ocp.transcription import IntArray, labels_of
from microbot_ocp.ocp.transcription.schemes import (
    Collocation,
    HermiteSimpson,
    Shooting,
    Trapezoidal,
    within_bounds,
)
from microbot_ocp.ocp.verification._certificate import CostCheck
from microbot_ocp.ocp.verification._reintegration import Integrated, each_interval

Values = Mapping[str, FloatArray]  # tables [size, M] of variables or rates by name


class Recomputation:
    """A phase evaluated again.

    Attributes
    ----------
    rows : unscaled values of the rows by their places in the program, without the link rows
    costs : running cost of every interval [N], followed by the point costs and the end cost
    """

    def __init__(self, phase: PhaseSolution) -> None:
        layout = phase.laid_out
        self.phase = phase
        self.expressions = _Declared(layout.phase)
        self.intervals = _Intervals(phase, self.expressions)
        self.costs = self.intervals.step.running
        self.rows: dict[int, float] = {}
        rows = self.intervals.rows(self._node(np.arange(1, layout.intervals + 1)))
        self._enter(layout.stage_rows.T, rows)
        self._add_ends()
        self._add_points()

    def interpolated(self, intervals: IntArray, share: FloatArray) -> dict[str, FloatArray]:
        """Return all variables [M, size] in given intervals [M] at given fractions [M]."""
        declared = self.phase.laid_out.phase
        tables = {v.name: np.zeros((share.size, v.size)) for v in declared.variables}
        for part in np.unique(share).tolist():
            chosen = np.flatnonzero(share == part)
            x = self.intervals.step.state(part)
            for name, table in self.intervals.values(x, part, declared.controls).items():
                tables[name][chosen] = table.T[intervals[chosen]]
        return tables

    def _node(self, k: Sequence[int] | np.ndarray) -> tuple[dict[str, FloatArray], FloatArray]:
        """Return values [size, M] at the mesh points k, and the duration variables [M] there."""
        layout, stages = self.phase.laid_out, self.phase.stages
        assert stages is not None
        nodes = node_variables(layout.phase)
        last = np.concatenate([*(self.phase.values[v.name][-1] for v in nodes), [0.0]])
        last[-1] = self.phase.duration
        inner = stages[layout.nodes[:-1] - layout.stages.start] * layout.node_scale
        table = np.vstack([inner, last])[k].T
        return parts_of(nodes, table[:-1], 0), table[-1]

    def _enter(self, places: IntArray, values: FloatArray) -> None:
        self.rows |= dict(zip(places.ravel().tolist(), values.ravel().tolist(), strict=True))

    def _add_points(self) -> None:
        """Add costs and constraints at given times, in the order of declaration and of time."""
        layout = self.phase.laid_out
        declared = layout.phase
        items = (*declared.point_constraints, *declared.point_costs)
        for item, group in zip(items, layout.points, strict=False):  # the last group is the end
            data = [m for m in declared.measurements if ca.depends_on(item.expression, m.symbol)]
            expressions = Expressions(declared, data)
            function = expressions.function([item.expression])
            results = []
            for k, fraction in enumerate(item.fractions.tolist()):
                node = int(np.abs(self.phase.mesh - fraction).argmin())
                values, duration = self._node([node])
                measured = [m.value[k][:, None] for m in data]
                table = expressions.table(values, fraction * duration, duration, data=measured)
                results.append(function(table).full().ravel())
            if isinstance(item, PointConstraint):
                self._enter(group.block.places, np.concatenate(results))
            else:
                self.costs = np.insert(self.costs, -1, np.concatenate(results))

    def _add_ends(self) -> None:
        """Add conditions and constraints at the ends, and the end cost."""
        layout, expressions = self.phase.laid_out, self.expressions
        declared = layout.phase
        last, duration = self._node([-1])
        # End expressions contain node variables only, so no other variable needs a value here.
        table = expressions.table(last, duration, duration)
        cost = float(expressions.function([sum(declared.end_costs, ca.MX(0))])(table))
        self.costs = np.append(self.costs, cost)
        limits = expressions.limits(table)
        for block, values in ((layout.initial, self._node([0])[0]), (layout.final, last)):
            for place, entry in zip(block.places[0].tolist(), block.entries, strict=True):
                self.rows[place] = float(values[entry.name][entry.component, 0])
        for place, entry in zip(layout.end.places[0].tolist(), layout.end.entries, strict=True):
            self.rows[place] = float(limits[entry.source][entry.component, 0])


def scaled_rows(problem: OptimalControlProblem, phases: Sequence[Recomputation]) -> FloatArray:
    """Return the values of all rows of the program, divided by their scales."""
    layouts = [recomputed.phase.laid_out for recomputed in phases]
    scale = np.array([label.scale for label in labels_of(layouts, "rows")])
    values = np.zeros(scale.size)
    for recomputed in phases:
        values[list(recomputed.rows)] = list(recomputed.rows.values())
    # Rows of links: start of the next phase minus end of this one.
    pairs = zip(problem.links, layouts, phases[:-1], phases[1:], strict=False)
    for link, layout, before, after in pairs:
        for place, entry in zip(layout.link.places[0].tolist(), layout.link.entries, strict=True):
            # A link does not constrain its other states: their rows stay zero.
            carried = entry.name in link.names or entry.name in before.phase.parameters
            if entry.source is not None and carried:
                end, start = before.phase.values[entry.name][-1], after.phase.values[entry.name][0]
                values[place] = start[entry.component] - end[entry.component]
    return values / scale


def missed_conditions(phases: Sequence[Recomputation], tolerance: float) -> list[str]:
    """Return sentences on start and end conditions that the mesh values miss.

    Conditions are those declared; the tolerance is a fraction of the scale of a variable.
    """
    missed = []
    ends = ("initial", 0, "start"), ("final", -1, "end")
    for phase in (recomputed.phase for recomputed in phases):
        for variable, (side, k, place) in product(node_variables(phase.laid_out.phase), ends):
            condition = getattr(variable, side)
            if condition is not None:
                value = phase.values[variable.name][k]
                beyond = np.maximum(condition[0] - value, value - condition[1])
                missed += [
                    f"{place} of {variable.name}{f'[{i}]' if variable.size > 1 else ''} in phase "
                    f"{phase.name!r} is {value[i]:.6g} {variable.unit}, {beyond[i]:.3g} beyond its "
                    "declared condition"
                    for i in np.flatnonzero(~(beyond <= tolerance * variable.scale))
                ]
    return missed


def check_cost(
    given: float, phases: Sequence[Recomputation], integrated: Sequence[Integrated]
) -> CostCheck:
    """Return the check of a cost: given, recomputed and integrated."""
    parts = np.concatenate([recomputed.costs for recomputed in phases])
    integrals = sum(float(recomputed.costs.sum()) for recomputed in integrated)
    ends = sum(float(each.costs[each.phase.mesh.size - 1 :].sum()) for each in phases)
    size = max(float(np.abs(parts).sum()), np.finfo(float).eps)  # a zero cost has an error too
    return CostCheck(given, float(parts.sum()), integrals + ends, size)


def parts_of(
    items: Sequence[PathConstraint], table: FloatArray, axis: int = -1
) -> dict[str, FloatArray]:
    """Split a table by item along an axis, and return the parts by item name."""
    parts = np.split(table, np.cumsum([item.size for item in items])[:-1], axis)
    return {item.name: part for item, part in zip(items, parts, strict=bool(items))}


class _Declared(Expressions):
    """Functions of the declared expressions of a phase."""

    @cached_property
    def dynamics(self) -> ca.Function:
        """Function that returns the derivatives of all states and the running cost."""
        phase = self.phase
        slopes = [phase.derivatives[state.name] for state in phase.states]
        return self.function([*slopes, sum(phase.running_costs, ca.MX(0))])

    @cached_property
    def _limits(self) -> ca.Function:
        phase = self.phase
        limits = [*phase.constraints, *phase.end_constraints]
        return self.function([*(k.expression for k in limits), *phase.algebraic_equations])

    def limits(self, table: FloatArray) -> dict[tuple[str, int] | None, FloatArray]:
        """Return path and end constraints by (list, index); algebraic equations by None."""
        phase = self.phase
        names = [("constraints", i) for i in range(len(phase.constraints))]
        names += [("end_constraints", i) for i in range(len(phase.end_constraints))]
        sizes = [k.size for k in (*phase.constraints, *phase.end_constraints)]
        parts = np.split(self._limits(table).full(), np.cumsum(sizes))
        return dict(zip([*names, None], parts, strict=True))


class _Intervals:
    """Unscaled stages of a phase, one column per interval."""

    def __init__(self, phase: PhaseSolution, expressions: _Declared) -> None:
        layout = phase.laid_out
        assert phase.stages is not None
        self.phase, self.kind, self.expressions = phase, layout.kind, expressions
        self.states = layout.phase.states
        table = (layout.table(phase.stages) * self.kind.scale).T
        nodes = node_variables(layout.phase)
        self.node = parts_of(nodes, table[: layout.node_size - 1], 0)
        self.duration = table[layout.node_size - 1]
        self.start = layout.mesh[:-1] * self.duration
        self.length = np.diff(layout.mesh) * self.duration
        self.constant: dict[str, FloatArray] = {}
        self.arrival: dict[str, FloatArray] = {}
        self.inside: dict[str, dict[float, FloatArray]] = {}
        row = layout.node_size
        for value in self.kind.inner:
            variable, part = value.source, table[row : row + value.source.size]
            row += variable.size
            if variable.shape == "constant":
                self.constant[variable.name] = part
            elif variable.shape == "linear":
                self.arrival[variable.name] = part
            else:
                self.inside.setdefault(variable.name, {})[value.fraction] = part
        self.free = {v.name: self.node[v.name] for v in layout.phase.free_parameters}
        ends = self.arrival.items()
        self.rates = {name: (end - self.node[name]) / self.length for name, end in ends}
        self.x = np.vstack([self.node[s.name] for s in self.states])
        self.step = _FORMULAS.get(type(self.kind.scheme), _integrated)(self)

    def states_inside(self) -> dict[float, FloatArray]:
        """Return states [n, M] at the fractions of an interval where they are variables."""
        fractions = self.inside[self.states[0].name]
        return {f: np.vstack([self.inside[s.name][f] for s in self.states]) for f in fractions}

    def values(
        self, x: FloatArray, share: float, applied: Sequence[Variable] = ()
    ) -> dict[str, FloatArray]:
        """Return all variables [size, M] at a fraction of the intervals, for states x there.

        The polynomials of the controls in ``applied`` are limited to their bounds.
        """
        tables = parts_of(self.states, x, 0) | self.constant | self.free
        for name, end in self.arrival.items():
            tables[name] = self.node[name] + share * (end - self.node[name])
        limited = {control.name: control for control in applied}
        for name, points in self.inside.items():
            if name in tables:  # a state, given by x
                continue
            weights, bounds = _lagrange(tuple(points), share), limited.get(name)
            if bounds is None:
                tables[name] = np.tensordot(weights, np.stack([*points.values()]), axes=1)
            else:
                values = np.stack([table.T for table in points.values()], axis=1)
                within = within_bounds(values, list(points), bounds.lower, bounds.upper)
                tables[name] = np.tensordot(weights, within, axes=(0, 1)).T
        return tables

    def table(self, x: FloatArray, share: float) -> FloatArray:
        t = self.start + share * self.length
        return self.expressions.table(self.values(x, share), t, self.duration, self.rates)

    def slope(self, x: FloatArray, share: float) -> tuple[FloatArray, FloatArray]:
        """Return derivatives of the states [n, M] and running cost [M]."""
        slopes = self.expressions.dynamics(self.table(x, share)).full()
        return slopes[:-1], slopes[-1]

    def rows(self, following: tuple[Values, FloatArray]) -> FloatArray:
        """Return the values of all stage rows [rows, M], given the next mesh points."""
        ahead, duration = following
        arrived = parts_of(self.states, self.step.arrived, 0) | self.arrival | self.free
        defects = {f: parts_of(self.states, value, 0) for f, value in self.step.defects.items()}
        places: dict[float, tuple[Values, Mapping[tuple[str, int] | None, FloatArray]]] = {}
        rows = []
        for entry in self.kind.rows:
            name, i, share = entry.name, entry.component, entry.fraction
            if entry.kind == "step" and entry.source is None:
                rows.append(duration - self.duration)
            elif entry.kind == "step":
                rows.append(ahead[name][i] - arrived[name][i])
            elif entry.kind == "defect":
                rows.append(defects[share][name][i])
            else:
                if share not in places:
                    x = self.step.state(share)
                    limits = self.expressions.limits(self.table(x, share))
                    places[share] = parts_of(self.states, x, 0), limits
                states, limits = places[share]
                rows.append(states[name][i] if entry.kind == "bound" else limits[entry.source][i])
        return np.array(rows)


# formulas of the schemes --------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Step:
    """One step of a scheme over all M intervals.

    Attributes
    ----------
    arrived : states at the end [n, M]
    running : integral of the running cost [M]
    state : function of a fraction of the interval that returns the states [n, M]
    defects : residuals of the dynamics [n, M] by fraction
    """

    arrived: FloatArray
    running: FloatArray
    state: Callable[[float], FloatArray]
    defects: Mapping[float, FloatArray]


def _runge_kutta(intervals: _Intervals) -> _Step:
    scheme = intervals.kind.scheme
    assert isinstance(scheme, Shooting)

    def reach(share: float) -> tuple[FloatArray, FloatArray]:
        x, cost, part = intervals.x, np.zeros(intervals.length.size), share / scheme.steps
        h = part * intervals.length
        for i in range(scheme.steps):
            k1, l1 = intervals.slope(x, i * part)
            k2, l2 = intervals.slope(x + h / 2 * k1, (i + 0.5) * part)
            k3, l3 = intervals.slope(x + h / 2 * k2, (i + 0.5) * part)
            k4, l4 = intervals.slope(x + h * k3, (i + 1) * part)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            cost = cost + h / 6 * (l1 + 2 * l2 + 2 * l3 + l4)
        return x, cost

    return _Step(*reach(1.0), lambda share: reach(share)[0], {})


def _trapezoidal(intervals: _Intervals) -> _Step:
    h, x, after = intervals.length, intervals.x, intervals.states_inside()[1.0]
    (f0, l0), (f1, l1) = intervals.slope(x, 0.0), intervals.slope(after, 1.0)
    defect = after - x - h / 2 * (f0 + f1)

    def parabola(s: float) -> FloatArray:
        """Return the integral of the derivative, which is linear in s."""
        return x + h * (s * f0 + s**2 / 2 * (f1 - f0))

    return _Step(after, h / 2 * (l0 + l1), parabola, {0.5: defect})


def _hermite_simpson(intervals: _Intervals) -> _Step:
    h, x, after = intervals.length, intervals.x, intervals.states_inside()[1.0]
    (f0, l0), (f1, l1) = intervals.slope(x, 0.0), intervals.slope(after, 1.0)

    def cubic(s: float) -> FloatArray:
        """Return the cubic Hermite interpolant of both ends and their derivatives."""
        rest, turn = after - x - h * f0, h * (f1 - f0)
        return x + h * f0 * s + (3 * rest - turn) * s**2 + (turn - 2 * rest) * s**3

    fm, lm = intervals.slope(cubic(0.5), 0.5)
    defect = after - x - h / 6 * (f0 + 4 * fm + f1)
    return _Step(after, h / 6 * (l0 + 4 * lm + l1), cubic, {0.5: defect})


def _collocation(intervals: _Intervals) -> _Step:
    inside = intervals.states_inside()
    points, nodes = tuple(inside), (0.0, *inside)
    x = np.stack([intervals.x, *inside.values()])
    slopes, costs = zip(*(intervals.slope(inside[s], s) for s in points), strict=True)

    def state(share: float) -> FloatArray:
        return np.tensordot(_lagrange(nodes, share), x, axes=1)

    defects = {
        s: np.tensordot(_lagrange(nodes, s, derivative=1), x, axes=1) - intervals.length * slope
        for s, slope in zip(points, slopes, strict=True)
    }
    weights = _lagrange(points, 1.0, derivative=-1)
    running = intervals.length * sum(w * cost for w, cost in zip(weights, costs, strict=True))
    return _Step(state(1.0), running, state, defects)


def _integrated(intervals: _Intervals) -> _Step:
    """Return the step of a scheme without a formula here, by accurate integration."""

    def reach(share: float) -> tuple[FloatArray, FloatArray]:
        integrated = each_interval(intervals.phase, until=share, cost=True)
        return integrated.states.T, integrated.costs

    return _Step(*reach(1.0), lambda share: reach(share)[0] if share else intervals.x, {})


_FORMULAS: Mapping[type, Callable[[_Intervals], _Step]] = {
    Shooting: _runge_kutta,
    Trapezoidal: _trapezoidal,
    HermiteSimpson: _hermite_simpson,
    Collocation: _collocation,
}


@lru_cache(maxsize=1024)  # a judgement asks for the same few again and again
def _lagrange(points: tuple[float, ...], s: float, derivative: int = 0) -> FloatArray:
    """Return Lagrange polynomials at s [points], their derivatives, or (-1) integrals from 0."""
    weights = []
    for point in points:
        others = [other for other in points if other != point]
        basis = np.poly1d(others, r=True) / np.prod([point - other for other in others])
        if derivative > 0:
            basis = basis.deriv(derivative)
        elif derivative < 0:
            basis = basis.integ(-derivative)
        weights.append(float(basis(s)))
    found = np.array(weights)
    found.flags.writeable = False
    return found
