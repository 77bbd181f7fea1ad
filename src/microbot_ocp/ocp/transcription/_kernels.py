"""Kernels of one interval: its step, rows and cost as functions, with their derivatives.

Every mesh point has variables z = (states, linear controls, free parameters, duration); an interval
adds w = (constant controls, linear controls at its end, inner variables of its scheme). All are
scaled.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.threads import makes_scalars
from microbot_ocp.ocp.problem import (
    PathConstraint,
    Phase,
    PointConstraint,
    Variable,
    as_scalars,
    node_variables,
)
from microbot_ocp.ocp.transcription._composition import (
    HEAVY,
    Composition,
    Derivatives,
    automatic,
    composed_derivatives,
    divided,
)
from microbot_ocp.ocp.transcription._table import TableEntry, entries_of
from microbot_ocp.ocp.transcription.schemes import (
    Interval,
    IntervalStep,
    Scheme,
    StageVariable,
    pointwise,
)


@dataclass(frozen=True, eq=False)
class Kernel:
    """A stage, or a constraint or cost at mesh points, in scaled variables.

    Solvers evaluate the cost and its gradient separately from the rows, at every trial point. If
    the cost contains no heavy function, such as a shortest duration, ``cost(v, c) -> cost,
    gradient`` avoids the evaluation of the dynamics.

    Attributes
    ----------
    value : for a stage ``(v, c) -> next, constraints, cost`` with v = (z, w) and c = (fraction at
        the start, length of the interval as a fraction, parameters); for points ``(z, c) ->
        constraints, cost`` with c = (fraction, parameters, data)
    jacobian, hessian : derivatives of ``value``
    cost : cost alone with its gradient, if it is light
    rows : descriptions of the constraints, in order
    fractions : fractions [M] of the phase at which points lie
    data : names of the measurements whose data are in c
    """

    value: ca.Function
    jacobian: ca.Function
    hessian: ca.Function
    cost: ca.Function | None
    rows: tuple[TableEntry, ...] = ()
    fractions: tuple[float, ...] = ()
    data: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Kernels:
    """Kernels of a phase: its stage and its points; the last point is the end.

    ``dense(v, c, fraction) -> x, u`` returns unscaled values.
    """

    stage: Kernel
    points: tuple[Kernel, ...]
    dense: ca.Function


def stage_variables(phase: Phase, scheme: Scheme) -> list[StageVariable]:
    """Return the variables w: constant controls, linear controls at the end, inner variables."""
    constant = [StageVariable(v, 0.5) for v in phase.shaped("constant")]
    linear = [StageVariable(v, 1.0) for v in phase.shaped("linear")]
    return [*constant, *linear, *scheme.variables(phase)]


def interpolated_variables(phase: Phase) -> list[Variable]:
    """Return the variables with values all along an interval, in the order of ``dense``.

    States, constant and linear controls, free parameters, polynomial controls, algebraic variables.
    """
    controls = [*phase.shaped("constant"), *phase.shaped("linear")]
    return [*phase.states, *controls, *phase.free_parameters, *pointwise(phase)]


Derive = Callable[[Sequence[ca.Function], Sequence[Composition | None]], Sequence[ca.Function]]


def with_derivatives(
    functions: Sequence[ca.Function],
    compositions: Sequence[Composition | None] = (None,),
    derivatives: Derivatives = automatic,
) -> Sequence[ca.Function]:
    """Return value, Jacobian and Hessian of the stage function, followed by those of the points.

    Points are divided only if all their derivatives are supplied: expanding the 426 distances at
    the end of a phase took 5 s of processor time.
    """
    derived: list[ca.Function] = []
    for function, composition in itertools.zip_longest(functions, compositions):
        is_point = bool(derived)
        if composition is not None and is_point:
            given = (derivatives(calls.function) or () for calls in composition.calls)
            composition = composition if all(len(parts) > 2 for parts in given) else None
        if composition is None:
            derived += _derivatives(_without_repeats(function))
            continue
        composed, *rest = composed_derivatives(composition, derivatives)
        value = None if is_point else composed
        derived += [value or _without_repeats(function), *rest]
    return derived


def build_kernels(
    phase: Phase, duration_scale: float, scheme: Scheme, derive: Derive = with_derivatives
) -> Kernels:
    """Return kernels of a phase, expanded to scalar graphs if its expressions allow it."""
    physics = _Physics(phase, duration_scale)
    inner, node_scale = stage_variables(phase, scheme), physics.node_scale
    scale = np.concatenate([node_scale, *(k.source.scale for k in inner)])
    v = ca.MX.sym("v", scale.size)
    c = ca.MX.sym("c", 2 + physics.constants.shape[0])
    interval, values = _interval(physics, v * scale, c, inner)
    step = scheme.step(phase, interval, values)
    following = ca.vertcat(step.arrived, interval.end, interval.duration) / node_scale
    rows = _Rows(phase)
    for point, defect in step.defects:
        rows.add("defect", phase.states, defect, point)
    _path_rows(physics, scheme, interval, step, rows)
    stage = ca.Function("stage", [v, c], [following, rows.stacked(), step.running])
    s = ca.MX.sym("s")
    dense = ca.Function("dense", [v, c, s], list(step.at(s)))
    parts: list[_Part] = [(stage, rows, (), ()), *_points(physics), _end(physics)]
    functions = [part[0] for part in parts]
    stages = [stage, *(_as_stage(point) for point in functions[1:])]
    compositions = [divided(k) for k in stages]
    kernels = kernels_of(functions, lambda scalar: derive(scalar, compositions))
    first, *points = (
        replace(kernel, rows=tuple(held.entries), fractions=at, data=data)
        for kernel, (_, held, at, data) in zip(kernels, parts, strict=True)
    )
    return Kernels(first, tuple(points), _without_repeats(as_scalars(dense)))


def kernels_of(
    functions: Sequence[ca.Function],
    derive: Callable[[Sequence[ca.Function]], Sequence[ca.Function]],
) -> list[Kernel]:
    """Return kernels of functions ``(v, c) -> ..., cost``, derived from their scalar graphs."""
    derived = derive([as_scalars(function) for function in functions])
    each = zip(derived[::3], derived[1::3], derived[2::3], functions, strict=True)
    return [
        Kernel(value, jacobian, hessian, light_cost(function))
        for value, jacobian, hessian, function in each
    ]


@makes_scalars
def light_cost(function: ca.Function) -> ca.Function | None:
    """Return the cost of a stage or of points, their last output, with its gradient.

    None if the cost contains a heavy function.
    """
    given: Any = function.mx_in()
    cost = as_scalars(ca.Function("cost", given, function.call(given, True, False)[-1:]))
    if not cost.is_a("SXFunction") or cost.n_instructions() >= HEAVY:
        return None
    v, c = cost.sx_in()
    value = cost(v, c)
    return ca.Function("cost", [v, c], [value, ca.densify(ca.gradient(value, v))])


class _Rows:
    """Scaled rows and their descriptions."""

    def __init__(self, phase: Phase) -> None:
        self.phase = phase
        self.values: list[ca.MX] = []
        self.entries: list[TableEntry] = []

    def add(
        self, kind: str, items: Sequence[PathConstraint], value: ca.MX, fraction: float = 0.0
    ) -> None:
        """Add values of variables or constraints, stacked, divided by their scales."""
        self.values.append(value / np.concatenate([item.scale for item in items]))
        for item in items:
            self.entries += entries_of(self.phase, kind, item, fraction)

    def add_equations(self, residual: ca.MX, fraction: float) -> None:
        """Add the residual of the algebraic equations."""
        self.values.append(residual)
        size = residual.shape[0]
        self.entries += [
            TableEntry("equation", None, "", i, size, fraction, "", 1.0) for i in range(size)
        ]

    def stacked(self) -> ca.MX:
        return ca.vertcat(*self.values) if self.values else ca.MX(0, 1)


class _Physics:
    """Functions of a phase: dynamics with running cost, limits, algebraic equations, end cost."""

    def __init__(self, phase: Phase, duration_scale: float) -> None:
        self.phase = phase
        scales = joined([v.scale for v in node_variables(phase)])
        self.node_scale = np.append(scales, duration_scale)
        x = ca.vertcat(*(s.symbol for s in phase.states))
        controls = interpolated_variables(phase)[len(phase.states) :]
        u = ca.vertcat(*(k.symbol for k in controls), ca.MX(0, 1))
        rate = ca.vertcat(*phase.rates.values(), ca.MX(0, 1))
        self.constants = ca.vertcat(*(p.symbol for p in phase.parameters), ca.MX(0, 1))
        arguments = [x, u, rate, phase.time, phase.duration, self.constants]
        slope = ca.vertcat(*(phase.derivatives[s.name] for s in phase.states))
        running = sum(phase.running_costs, ca.MX(0))
        self.dynamics = ca.Function("dynamics", arguments, [slope, running])
        limits = [k.expression for k in phase.constraints]
        inline = {"always_inline": True}  # exposes heavy calls to ``divided``
        self.limits = ca.Function("limits", arguments, limits, inline)
        equations = ca.vertcat(*phase.algebraic_equations, ca.MX(0, 1))
        self.equations = ca.Function("equations", arguments, [equations])
        total = sum(phase.end_costs, ca.MX(0))
        self.at_point = [x, u, phase.time, phase.duration, self.constants]
        self.end_cost = ca.Function("end_cost", self.at_point, [total])
        ends = [k.expression for k in phase.end_constraints]
        self.end_limits = ca.Function("end_limits", self.at_point, ends)
        self.missing = ca.MX.zeros(sum(k.size for k in pointwise(phase)))


def _interval(
    physics: _Physics, unscaled: ca.MX, c: ca.MX, inner: Sequence[StageVariable]
) -> tuple[Interval, list[ca.MX]]:
    """Return the symbols of an interval, and the inner variables of its scheme."""
    phase, sizes = physics.phase, [k.source.size for k in inner]
    node = (phase.states, phase.shaped("linear"), phase.free_parameters)
    head = [*(sum(v.size for v in variables) for variables in node), 1]
    edges = np.cumsum([0, *head, *sizes]).tolist()
    x, begin, free, duration, *rest = (unscaled[a:b] for a, b in itertools.pairwise(edges))
    constants, linear = len(phase.shaped("constant")), len(phase.shaped("linear"))
    none = ca.MX(0, 1)
    end = ca.vertcat(*rest[constants : constants + linear], none)
    length = c[1] * duration
    interval = Interval(
        x=x,
        begin=ca.vertcat(begin, free),
        end=ca.vertcat(end, free),
        constant=ca.vertcat(*rest[:constants], none),
        rate=(end - begin) / length if linear else none,
        start=c[0] * duration,
        length=length,
        duration=duration,
        constants=c[2:],
        dynamics=physics.dynamics,
    )
    return interval, rest[constants + linear :]


def _path_rows(
    physics: _Physics, scheme: Scheme, interval: Interval, step: IntervalStep, rows: _Rows
) -> None:
    """Add bounds of states, algebraic equations and path constraints at the points of a stage."""
    phase = physics.phase
    inner = scheme.points if phase.interior_points is None else phase.interior_points
    inner = tuple(p for p in inner if p < 1.0)
    # A state that is an inner variable has bounds of its own: no row is needed.
    held = {(k.source.name, k.fraction) for k in scheme.variables(phase)}
    points = {0.0, *inner, 1.0, *(scheme.points if pointwise(phase) else ())}
    for point in sorted(points):
        x, u = step.at(point) if point else (interval.x, interval.control(0.0))
        if point == 0.0:
            u = ca.vertcat(u, physics.missing)
        parts = ca.vertsplit(x, np.cumsum([0, *(s.size for s in phase.states)]).tolist())
        for state, part in zip(phase.states, parts, strict=True):
            if point in inner and state.interior_points and (state.name, point) not in held:
                rows.add("bound", [state], part, point)
        time = interval.start + point * interval.length
        arguments = (x, u, interval.rate, time, interval.duration, interval.constants)
        if point in scheme.points and phase.algebraic_equations:
            rows.add_equations(physics.equations(*arguments), point)
        values = physics.limits.call(arguments)
        for limit, value in zip(phase.constraints, values, strict=True):
            if _holds(phase, limit, point, inner, scheme):
                rows.add("constraint", [limit], value, point)


def _holds(
    phase: Phase, limit: PathConstraint, point: float, inner: Sequence[float], scheme: Scheme
) -> bool:
    """Return True if a path constraint has a row at a point of the interval."""
    expression = limit.expression
    if _depends(expression, [v.symbol for v in pointwise(phase)]):
        return point in scheme.points  # its variables have no value elsewhere
    moving = [phase.time, *(v.symbol for v in (*phase.states, *phase.shaped("linear")))]
    if not _depends(expression, moving):
        return point == 0.0  # constant over the interval: a second row would be dependent
    if point == 1.0:
        # A continuous expression at the end has its row in the next stage.
        return _jumps(phase, expression)
    return point == 0.0 or (limit.interior_points and point in inner)


# Function and rows of a kernel; for points also fractions and measurement names.
_Part = tuple[ca.Function, _Rows, tuple[float, ...], tuple[str, ...]]


def _end(physics: _Physics) -> _Part:
    """Return cost, end constraints and continuous path constraints at the end of the phase."""
    phase = physics.phase
    z, c, at_end = _node(physics)
    no_rate = ca.MX.zeros(sum(v.size for v in phase.shaped("linear")))
    x, u, *rest = at_end
    values = physics.limits.call([x, u, no_rate, *rest])
    rows = _Rows(phase)
    for limit, value in zip(phase.constraints, values, strict=True):
        local = [v.symbol for v in pointwise(phase)]  # undefined at mesh points
        if not _depends(limit.expression, local) and not _jumps(phase, limit.expression):
            rows.add("constraint", [limit], value)
    ends = physics.end_limits.call(at_end)
    for limit, value in zip(phase.end_constraints, ends, strict=True):
        rows.add("end", [limit], value)
    cost = physics.end_cost(*at_end)
    return ca.Function("point", [z, c], [rows.stacked(), cost]), rows, (1.0,), ()


def _points(physics: _Physics) -> Iterator[_Part]:
    """Yield the constraints and costs at given times, one per declaration."""
    phase = physics.phase
    for k, item in enumerate((*phase.point_constraints, *phase.point_costs)):
        data = [m for m in phase.measurements if ca.depends_on(item.expression, m.symbol)]
        symbols = ca.vertcat(*(m.symbol for m in data), ca.MX(0, 1))
        z, c, at_point = _node(physics, symbols.shape[0])
        value = ca.Function("value", [*physics.at_point, symbols], [item.expression])
        values = value(*at_point, c[c.shape[0] - symbols.shape[0] :])
        rows, cost = _Rows(phase), ca.MX(0)
        if isinstance(item, PointConstraint):
            rows.add("value" if item.defines else "point", [item], values)
        else:
            cost = values
        point = ca.Function(f"point_{k}", [z, c], [rows.stacked(), cost])
        yield point, rows, tuple(item.fractions.tolist()), tuple(m.name for m in data)


def _node(physics: _Physics, data: int = 0) -> tuple[ca.MX, ca.MX, list[ca.MX]]:
    """Return scaled z and constants of a mesh point, and the arguments of point functions."""
    phase = physics.phase
    z = ca.MX.sym("z", physics.node_scale.size)
    size = physics.constants.shape[0]
    c = ca.MX.sym("c", 1 + size + data)
    last = z * physics.node_scale
    states = sum(v.size for v in phase.states)
    duration = last[-1]
    no_control = ca.MX.zeros(sum(v.size for v in phase.shaped("constant")))
    u = ca.vertcat(no_control, last[states:-1], physics.missing)
    return z, c, [last[:states], u, c[0] * duration, duration, c[1 : 1 + size]]


def joined(parts: Sequence[ArrayLike]) -> FloatArray:
    return np.concatenate([*parts, np.zeros(0)])


def _depends(expression: ca.MX, symbols: Sequence[ca.MX]) -> bool:
    return any(ca.depends_on(expression, symbol) for symbol in symbols)


def _jumps(phase: Phase, expression: ca.MX) -> bool:
    """Return True if an expression may differ between both sides of a mesh point."""
    constant = (k.symbol for k in phase.shaped("constant"))
    return _depends(expression, [*constant, *phase.rates.values()])


def _as_stage(point: ca.Function) -> ca.Function:
    """Return a point function in the form of a stage, with an empty next mesh point."""
    given: Any = point.mx_in()
    return ca.Function(point.name(), given, [ca.MX(0, 1), *point.call(given, True, False)])


@makes_scalars
def _without_repeats(function: ca.Function) -> ca.Function:
    deadline.check()
    if not function.is_a("SXFunction"):
        return function
    inputs = function.sx_in()
    return ca.Function(function.name(), inputs, ca.cse(function.call(inputs)))


@makes_scalars
def _derivatives(function: ca.Function) -> tuple[ca.Function, ca.Function, ca.Function]:
    """Return the function of a stage or of points, its Jacobian and its Hessian."""
    symbols: Any = function.sx_in() if function.is_a("SXFunction") else function.mx_in()
    v, c = symbols
    *parts, cost = function(v, c)
    both, name = ca.vertcat(*parts), function.name()
    lam, sigma = type(v).sym("lam", both.shape[0]), type(v).sym("sigma")
    # Step rows are z_next - next(z, w), equation (3), so the first output counts negative.
    signed = ca.vertcat(-parts[0], *parts[1:]) if len(parts) > 1 else both
    hessian = ca.hessian(sigma * cost + ca.dot(lam, signed), v)[0]
    outputs = [both, ca.jacobian(both, v), cost, ca.densify(ca.gradient(cost, v))]
    return (
        function,
        _without_repeats(ca.Function(f"{name}_jacobian", [v, c], outputs)),
        _without_repeats(ca.Function(f"{name}_hessian", [v, c, lam, sigma], [hessian])),
    )
