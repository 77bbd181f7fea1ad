"""One phase as data: states, controls, dynamics, costs and limits.

Values at other places (the start, the end, another phase) and free parameters are symbols. Every
phase that uses one carries it as a free parameter, and a row where the value is taken defines it.
Each stage of the program therefore depends on its own variables alone, however phases are coupled.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.foreign_words import Hinting, remedy
from microbot_ocp._base.portable import Portable
from microbot_ocp._base.relations import Symbol
from microbot_ocp.ocp.problem._coupling import owned, value_of
from microbot_ocp.ocp.problem._items import (
    Bound,
    Measurement,
    Parameter,
    PathConstraint,
    PointConstraint,
    PointCost,
    PointValue,
    Variable,
    converted,
    limit_of,
    ordered,
    variable_of,
)
from microbot_ocp.ocp.problem._relations import as_expression, declared_limits, refuse_steps, sides

if TYPE_CHECKING:
    from microbot_ocp.ocp.problem._problem import OptimalControlProblem

Limit = ArrayLike | ca.MX
Size = int | tuple[int, int]


@dataclass(eq=False)
class Phase(Hinting, Portable):
    """One phase: a time span with one set of dynamics.

    Created by :meth:`OptimalControlProblem.phase`. The symbols ``time`` (since the start of the
    phase, s) and ``duration`` may be used in expressions, ``duration`` also in those of other
    phases. :attr:`start` is the start time of the phase: ``start + time`` is the time since the
    start of the first phase, unless another start was declared.

    Expressions may contain the variables and parameters of the phase, the free parameters of the
    problem, and values that :meth:`initial`, :meth:`final` and :meth:`value` of any phase return.
    """

    name: str
    duration_bounds: tuple[float, float]
    interior_points: tuple[float, ...] | None = None
    duration_scale: float | None = None
    states: list[Variable] = field(default_factory=list)
    controls: list[Variable] = field(default_factory=list)
    parameters: list[Parameter] = field(default_factory=list)
    algebraics: list[Variable] = field(default_factory=list)
    algebraic_equations: list[ca.MX] = field(default_factory=list)
    derivatives: dict[str, ca.MX] = field(default_factory=dict)
    constraints: list[PathConstraint] = field(default_factory=list)
    end_constraints: list[PathConstraint] = field(default_factory=list)
    running_costs: list[ca.MX] = field(default_factory=list)
    end_costs: list[ca.MX] = field(default_factory=list)
    free_parameters: list[Variable] = field(default_factory=list)
    measurements: list[Measurement] = field(default_factory=list)
    point_constraints: list[PointConstraint] = field(default_factory=list)
    point_costs: list[PointCost] = field(default_factory=list)
    problem: OptimalControlProblem | None = field(default=None, repr=False)
    begins: ca.MX = field(default_factory=lambda: ca.MX(0.0), repr=False)

    def __post_init__(self) -> None:
        if not isinstance(self.name, str):
            raise InputError(f"name must be text, not {checks.shown(self.name)}")
        self.time = Symbol(ca.MX.sym(f"{self.name}.time"))
        self.duration = Symbol(ca.MX.sym(f"{self.name}.duration"))
        self._values: list[PointValue] = []
        self._asked_start = False

    @property
    def start(self) -> ca.MX:
        """Start time of the phase, s: as declared, or the end of the previous phase."""
        self._asked_start = True
        return self.begins

    def __repr__(self) -> str:
        low, high = self.duration_bounds
        declared = {
            "states": self.states,
            "controls": self.controls,
            "algebraic variables": self.algebraics,
            "parameters": [*self.parameters, *self.free_parameters],
            "constraints": [*self.constraints, *self.end_constraints, *self.point_constraints],
        }
        named = {kind: ", ".join(map(_named, items)) for kind, items in declared.items()}
        lists = [f"{kind} {names}" for kind, names in named.items() if names]
        duration = f"{low:g} s" if low == high else f"{low:g} to {high:g} s"
        return f"<Phase {self.name!r}, {duration}: {'; '.join(lists)}>"

    @property
    def variables(self) -> list[Variable]:
        """States, controls, algebraic variables and free parameters."""
        return [*self.states, *self.controls, *self.algebraics, *self.free_parameters]

    def shaped(self, shape: str) -> list[Variable]:
        """Return the controls of a shape."""
        return [control for control in self.controls if control.shape == shape]

    @property
    def rates(self) -> dict[str, ca.MX]:
        """Time derivatives of the linear controls, by name of the control."""
        return {c.name: c.rate for c in self.controls if c.rate is not None}

    @property
    def point_fractions(self) -> tuple[float, ...]:
        """Fractions inside the phase with a point constraint or cost; they become mesh points."""
        items = (*self.point_constraints, *self.point_costs)
        fractions = {fraction for item in items for fraction in item.fractions.tolist()}
        return tuple(sorted(fractions - {0.0, 1.0}))

    @property
    def has_cost(self) -> bool:
        """True if a cost is declared that depends on a symbol."""
        costs = [*self.running_costs, *self.end_costs, *(c.expression for c in self.point_costs)]
        return any(ca.symvar(cost) for cost in costs)

    def state(
        self,
        name: str,
        size: Size = 1,
        *,
        lower: Limit = -np.inf,
        upper: Limit = np.inf,
        initial: Bound = None,
        final: Bound = None,
        scale: ArrayLike | None = None,
        unit: str = "",
        interior_points: bool = False,
    ) -> ca.MX:
        """Declare a state; give it dynamics with :meth:`derivative`.

        Parameters
        ----------
        name : str
        size : int or (int, int)
            Number of components, or (rows, columns) of a matrix.
        lower, upper : array_like [size] or expression
            Bounds at the mesh points. A bound with an expression becomes a path constraint.
        initial, final : value, (lower, upper) or None
            Conditions at the start and the end of the phase; None leaves the state free. An
            expression of free parameters and of values that :meth:`initial` and :meth:`final` of
            other phases return couples phases: a jump, a drop of mass, a period.
        scale : array_like [size], optional
            Typical size; the solver works with the state divided by it. By default
            :func:`~microbot_ocp.ocp.solution.scaled` determines it.
        unit : str
            Unit for messages.
        interior_points : bool
            True if the bounds also hold at the points inside the intervals where path constraints
            hold.

        Examples
        --------
        A rocket drops a tank of a quarter of its mass between two phases.

        >>> from microbot_ocp.ocp import OptimalControlProblem, solve
        >>> problem = OptimalControlProblem("two stages")
        >>> first = problem.phase("first", duration=1.0)
        >>> m1 = first.state("m", initial=4.0, unit="kg")
        >>> first.derivative(m1, -1.0)
        >>> second = problem.phase("second", duration=1.0)
        >>> m2 = second.state("m", initial=first.final(m1) - 1.0, unit="kg")
        >>> second.derivative(m2, -0.5)
        >>> problem.link(first, second)
        >>> solution = solve(problem, mesh=4)
        >>> solution["second"]["m"][[0, -1], 0].round(6)
        array([2. , 1.5])
        """
        ends = initial, final
        symbol = self._declare(self.states, name, size, "state", (lower, upper), scale, unit, ends)
        self.states[-1] = replace(self.states[-1], interior_points=interior_points)
        return symbol

    def control(
        self,
        name: str,
        size: Size = 1,
        *,
        lower: Limit = -np.inf,
        upper: Limit = np.inf,
        initial: Bound = None,
        final: Bound = None,
        scale: ArrayLike | None = None,
        unit: str = "",
        shape: str = "auto",
    ) -> ca.MX:
        """Declare a control.

        Over each interval a control is "constant", "linear" (and continuous), or "polynomial" with
        a value at each collocation point. "auto" is linear if the control has a condition at an
        end or its :meth:`rate` is used, otherwise polynomial with collocation and constant with
        other schemes. A bound with an expression becomes a path constraint.
        """
        if hint := remedy(shape):
            raise InputError(f"shape of control {name!r} cannot be {shape!r}{hint}")
        checks.one_of("shape", shape, ("auto", "constant", "linear", "polynomial"))
        if shape == "auto" and (initial is not None or final is not None):
            shape = "linear"
        if shape != "linear" and (initial is not None or final is not None):
            raise InputError(f"control {name!r} is {shape}: initial and final need shape='linear'")
        ends = initial, final
        return self._declare(self.controls, name, size, shape, (lower, upper), scale, unit, ends)

    def algebraic(
        self,
        name: str,
        size: Size = 1,
        *,
        lower: Limit = -np.inf,
        upper: Limit = np.inf,
        scale: ArrayLike | None = None,
        unit: str = "",
    ) -> ca.MX:
        """Declare an algebraic variable; :meth:`algebraic_equation` determines it (collocation)."""
        bounds = lower, upper
        return self._declare(self.algebraics, name, size, "algebraic", bounds, scale, unit)

    def algebraic_equation(self, expression: ca.MX) -> None:
        """Require ``expression`` to be zero, or an equation ``x == y``, at collocation points."""
        expression = converted(expression)
        if expression.op() == ca.OP_EQ:
            expression = expression.dep(0) - expression.dep(1)
        self.algebraic_equations.append(ca.vec(owned(self, expression)))

    def parameter(self, name: str, value: ArrayLike) -> ca.MX:
        """Declare a constant of the phase, [size] or a matrix, and return its symbol.

        Phases that differ only in parameters share compiled kernels. For a constant that the
        solver determines, use :meth:`~OptimalControlProblem.free_parameter` of the problem.
        """
        self._refuse_second(f"parameter {name!r}", name, self.parameters, self.measurements)
        table = np.asarray(value, dtype=float)
        given = checks.array(f"parameter {name!r}", table.ravel(order="F"), (None,))
        symbol = ca.MX.sym(f"{self.name}.{name}", given.size)
        self.parameters.append(Parameter(name, symbol, given))
        is_matrix = table.ndim == 2 and min(table.shape) > 1
        return Symbol(ca.reshape(symbol, table.shape) if is_matrix else symbol)

    def measurement(self, name: str, at: ArrayLike, values: ArrayLike) -> ca.MX:
        """Declare data at given times of the phase; the symbol stands for the value at each time.

        Parameters
        ----------
        name : str
        at : array_like [M]
            Times since the start of the phase, s; the duration of the phase must be fixed. The
            times become mesh points.
        values : array_like [M] or [M, size]
            Data, which ``parameters`` of a :class:`~microbot_ocp.ocp.ParametricSolver` may change
            from solve to solve.

        Returns
        -------
        casadi.MX [size]
            Symbol for :meth:`point_cost` and :meth:`point_constraint`, which hold at these times.

        Examples
        --------
        The rate of a decay from three measurements.

        >>> from microbot_ocp.ocp import OptimalControlProblem, solve
        >>> problem = OptimalControlProblem("decay")
        >>> rate = problem.free_parameter("rate", lower=0.0, upper=5.0, unit="1/s")
        >>> phase = problem.phase("decay", duration=2.0)
        >>> x = phase.state("x", initial=1.0)
        >>> phase.derivative(x, -rate * x)
        >>> y = phase.measurement("y", at=[0.5, 1.0, 2.0], values=np.exp([-0.35, -0.7, -1.4]))
        >>> phase.point_cost((x - y) ** 2)
        >>> round(float(solve(problem, mesh=10).parameters["rate"][0]), 4)
        0.7
        """
        self._refuse_second(f"measurement {name!r}", name, self.parameters, self.measurements)
        fractions = self._fractions(f"times of {name!r}", at)
        table = checks.numbers(f"values of {name!r}", values)
        table = table[:, None] if table.ndim == 1 else table
        table = checks.array(f"values of {name!r}", table, (fractions.size, None))
        symbol = ca.MX.sym(f"{self.name}.{name}", table.shape[1])
        self.measurements.append(Measurement(name, symbol, table, fractions))
        return Symbol(symbol)

    def rate(self, control: ca.MX) -> ca.MX:
        """Return the time derivative of a linear control, as a symbol for path constraints."""
        control = ca.vec(as_expression(control))
        for index, variable in enumerate(self.controls):
            if ca.is_equal(variable.symbol, control) and variable.shape == "auto":
                rate = ca.MX.sym(f"{self.name}.{variable.name}.rate", variable.size)
                self.controls[index] = replace(variable, shape="linear", rate=rate)
                return rate
            if ca.is_equal(variable.symbol, control) and variable.rate is not None:
                return variable.rate
        raise InputError(f"rate needs a control of shape 'linear' of phase {self.name!r}")

    def derivative(self, state: ca.MX, expression: ca.MX | float) -> None:
        """Set the time derivative of a state."""
        state = as_expression(state)
        given = [v for v in self.states if v.name in self.derivatives]
        for variable in self.states:
            if ca.is_equal(variable.symbol, ca.vec(state)):
                expression = owned(self, expression)
                self._refuse_second(f"derivative of {variable.name!r}", variable.name, given)
                if expression.shape != state.shape:
                    raise InputError(
                        f"derivative of {variable.name!r} must have shape {state.shape}, not "
                        f"{expression.shape}"
                    )
                self.derivatives[variable.name] = ca.vec(expression)
                return
        raise InputError(f"derivative needs a state of phase {self.name!r}, not {state}")

    def integral(
        self,
        name: str,
        expression: ca.MX,
        lower: ArrayLike = -np.inf,
        upper: ArrayLike = np.inf,
        *,
        scale: ArrayLike | None = None,
        unit: str = "",
    ) -> ca.MX:
        """Return the time integral of an expression since the start of the phase, as a state.

        The bounds hold at the end of the phase, where the state is the integral over the whole
        phase. Use the state in end costs and end constraints, its ``final`` value elsewhere.

        Examples
        --------
        The largest distance in 1 s from rest to rest with an effort of 1 m^2/s^3: 1/sqrt(12) m.

        >>> from microbot_ocp.ocp import OptimalControlProblem, solve
        >>> problem = OptimalControlProblem("least effort")
        >>> phase = problem.phase("move", duration=1.0)
        >>> x = phase.state("x", initial=0.0, unit="m")
        >>> v = phase.state("v", initial=0.0, final=0.0, unit="m/s")
        >>> u = phase.control("u", shape="linear", unit="m/s^2")
        >>> phase.derivative(x, v)
        >>> phase.derivative(v, u)
        >>> effort = phase.integral("effort", u**2, upper=1.0)
        >>> phase.end_cost(-x)
        >>> round(-solve(problem, mesh=20).cost, 4)
        0.2887
        """
        expression = as_expression(expression)
        size = expression.shape[0]
        low, high = ordered(name, lower, upper, size, unit)
        bounds = None if np.isinf(low).all() and np.isinf(high).all() else (low, high)
        symbol = self.state(
            name, size, initial=np.zeros(size), final=bounds, scale=scale, unit=unit
        )
        self.derivative(symbol, expression)
        return symbol

    def constraint(
        self,
        name: str,
        expression: ca.MX,
        lower: ArrayLike = -np.inf,
        upper: ArrayLike = np.inf,
        *,
        scale: ArrayLike | None = None,
        unit: str = "",
        interior_points: bool = True,
    ) -> None:
        """Keep ``lower <= expression <= upper`` at the mesh points and the interior points.

        With ``interior_points=False`` the constraint holds at the mesh points alone, like bounds of
        states by default.

        A relation may replace expression and bounds, here and in all other constraints:
        ``v <= 0.5``, ``x == y``, ``-1 <= (x <= 1)`` with these brackets, or several relations
        joined by ``ca.logic_and``.

        Examples
        --------
        A distance of 1 m at no more than 0.5 m/s takes 2 s.

        >>> from microbot_ocp.ocp import OptimalControlProblem, solve
        >>> problem = OptimalControlProblem("speed limit")
        >>> phase = problem.phase("move", duration=(0.1, 10.0))
        >>> x = phase.state("x", initial=0.0, final=1.0, unit="m")
        >>> v = phase.control("v", unit="m/s")
        >>> phase.derivative(x, v)
        >>> phase.constraint("speed", v <= 0.5, unit="m/s")
        >>> phase.end_cost(phase.duration)
        >>> round(solve(problem, mesh=4).duration, 4)
        2.0
        """
        limits = declared_limits(name, expression, lower, upper, scale, unit)
        held = [replace(limit, interior_points=interior_points) for limit in limits]
        self.constraints += self._owned([*self.end_constraints, *self.point_constraints], held)

    def end_constraint(
        self,
        name: str,
        expression: ca.MX,
        lower: ArrayLike = -np.inf,
        upper: ArrayLike = np.inf,
        *,
        scale: ArrayLike | None = None,
        unit: str = "",
    ) -> None:
        """Require ``lower <= expression <= upper`` at the end of the phase.

        The expression may contain states, linear controls, parameters, ``duration`` and values at
        other places. For a bound of a single state use its ``final`` argument.

        Examples
        --------
        The cheapest periodic orbit of a forced oscillator has its natural period, and no force.

        >>> from microbot_ocp.ocp import OptimalControlProblem, solve
        >>> problem = OptimalControlProblem("period")
        >>> phase = problem.phase("lap", duration=(5.0, 8.0))
        >>> x, v = phase.state("x"), phase.state("v")
        >>> u = phase.control("u", shape="linear")
        >>> phase.derivative(x, v)
        >>> phase.derivative(v, u - x)
        >>> phase.running_cost(u**2 + (x**2 + v**2 - 1.0) ** 2)
        >>> state = ca.vertcat(x, v)
        >>> phase.end_constraint("period", state - phase.initial(state), 0.0, 0.0)
        >>> phase.point_constraint("start", x, lower=0.5, at=0.0)
        >>> round(solve(problem, mesh=40).duration, 3)  # 2 pi
        6.283
        """
        limits = declared_limits(name, expression, lower, upper, scale, unit)
        self.end_constraints += self._owned(self.end_constraints, limits, at=1.0)

    def point_constraint(
        self,
        name: str,
        expression: ca.MX,
        lower: ArrayLike = -np.inf,
        upper: ArrayLike = np.inf,
        *,
        at: ArrayLike | None = None,
        scale: ArrayLike | None = None,
        unit: str = "",
    ) -> None:
        """Require ``lower <= expression <= upper`` at given times of the phase.

        The expression may contain quantities with a value at a mesh point: states and linear
        controls. ``at`` is one time or several [M], s since the start of the phase; by default the
        times of the measurement in the expression. Times other than 0 need a phase of fixed
        duration.
        """
        limits = declared_limits(name, expression, lower, upper, scale, unit)
        whole = ca.vertcat(*(limit.expression for limit in limits))
        fractions = self._point_fractions(f"constraint {name!r}", whole, at)
        place = float(fractions[0]) if fractions.size == 1 else None
        there = self._owned(self.point_constraints, limits, at=place)
        self.point_constraints += [PointConstraint.of(limit, fractions) for limit in there]

    def running_cost(self, expression: ca.MX) -> None:
        """Add the time integral of ``expression`` to the cost."""
        self.running_costs.append(self._cost("running cost", expression))

    def end_cost(self, expression: ca.MX) -> None:
        """Add ``expression`` of the end state and ``duration`` to the cost."""
        self.end_costs.append(self._cost("end cost", expression, at=1.0))

    def point_cost(self, expression: ca.MX, *, at: ArrayLike | None = None) -> None:
        """Add ``expression`` at each of several times of the phase to the cost.

        For the times see :meth:`point_constraint`; for an example see :meth:`measurement`.
        """
        fractions = self._point_fractions("a point cost", expression, at)
        expression = self._cost("point cost", expression)
        self.point_costs.append(PointCost(expression, fractions))

    # values at other places -----------------------------------------------------------------------

    def initial(self, expression: ca.MX) -> ca.MX:
        """Return the value at the start of the phase, for expressions of this and other phases.

        ``expression`` may contain quantities with a value there: states, linear controls,
        ``duration`` and free parameters.
        """
        return value_of(self, expression, 0.0, "at the start of")

    def final(self, expression: ca.MX) -> ca.MX:
        """Return the value at the end of the phase, for expressions of this and other phases."""
        return value_of(self, expression, 1.0, "at the end of")

    def value(self, expression: ca.MX, at: float) -> ca.MX:
        """Return the value at a time since the start of the phase, s; the duration must be fixed.

        Examples
        --------
        A control of least cost from x(0) = 1 such that x(2) = 2 x(1).

        >>> from microbot_ocp.ocp import OptimalControlProblem, solve
        >>> problem = OptimalControlProblem("half way")
        >>> phase = problem.phase("all", duration=2.0)
        >>> x = phase.state("x", initial=1.0)
        >>> u = phase.control("u")
        >>> phase.derivative(x, u)
        >>> phase.running_cost(u**2)
        >>> phase.end_constraint("twice", x - 2 * phase.value(x, at=1.0), 0.0, 0.0)
        >>> round(solve(problem, mesh=10).cost, 4)
        0.5
        """
        fraction = float(self._fractions("at", at)[0])
        return value_of(self, expression, fraction, f"at {float(at):g} s of")

    # checks ---------------------------------------------------------------------------------------

    def _fractions(self, label: str, at: ArrayLike) -> FloatArray:
        """Return increasing fractions [M] of the phase from times [M], s."""
        times = checks.array(label, np.atleast_1d(checks.numbers(label, at)), (None,), "s")
        low, high = self.duration_bounds
        if low < high and np.any(times != 0):
            raise InputError(
                f"{label}: phase {self.name!r} has a free duration, so only its start is a fixed "
                "fraction of it; end the phase at that time, link a second phase, and use final()"
            )
        if np.any(times < 0) or np.any(times > high):
            raise InputError(
                f"{label} must be within phase {self.name!r}, 0 to {high:g} s, not "
                f"{times.min():g} to {times.max():g} s"
            )
        if np.any(np.diff(times) <= 0):
            raise InputError(f"{label} must increase, not {times.tolist()}")
        return times / high if low == high else times

    def _point_fractions(self, label: str, expression: ca.MX, at: ArrayLike | None) -> FloatArray:
        """Return fractions of a point item: those of ``at``, or of the measurements used."""
        expression = as_expression(expression)
        used = [m for m in self.measurements if ca.depends_on(expression, m.symbol)]
        places = [m.fractions for m in used]
        if at is not None:
            places.append(self._fractions(f"at of {label}", at))
        if not places:
            raise InputError(f"{label} of phase {self.name!r} needs times: at=...")
        if any(not np.array_equal(places[0], other) for other in places[1:]):
            names = [m.name for m in used]
            raise InputError(f"{label} of phase {self.name!r}: {names} and at differ in times")
        return places[0]

    def _cost(self, kind: str, given: ca.MX, at: float | None = None) -> ca.MX:
        label = f"{kind} of phase {self.name!r}"
        expression = owned(self, as_expression(given, label), at)
        if not expression.is_scalar():
            raise InputError(f"{label} must be one number, but has shape {expression.shape}")
        refuse_steps(label, expression)
        gains = self.problem is not None and self.problem.maximize
        return -expression if gains else expression

    def _owned(
        self,
        given: Sequence[PathConstraint],
        limits: Sequence[PathConstraint],
        at: float | None = None,
    ) -> list[PathConstraint]:
        """Return limits whose foreign symbols are free parameters of the phase.

        Raises InputError if the name is that of a path constraint or of an item of ``given``; a
        constraint at the start and one at the end may share a name.
        """
        for limit in limits:
            self._refuse_second(f"constraint {limit.name!r}", limit.name, self.constraints, given)
        return [replace(k, expression=owned(self, k.expression, at)) for k in limits]

    def _refuse_second(
        self, label: str, name: str, *lists: Sequence[Parameter | PathConstraint]
    ) -> None:
        if any(item.name == name for items in lists for item in items):
            raise InputError(f"{label} is declared twice in phase {self.name!r}")

    def _declare(
        self,
        variables: list[Variable],
        name: str,
        size: Size,
        shape: str,
        bounds: tuple[Limit, Limit],
        scale: ArrayLike | None,
        unit: str,
        ends: tuple[Bound, Bound] = (None, None),
    ) -> ca.MX:
        """Append a variable to a list; bounds and ends with expressions become constraints."""
        self._refuse_second(repr(name), name, self.variables)
        rows, columns = size if isinstance(size, tuple | list) and len(size) == 2 else (size, 1)
        for each in (rows, columns):
            checks.whole(f"size of {name!r}", each, at_most=np.inf)
        places = ("lower", "upper", "initial", "final")
        for place, given in zip(places, (*bounds, *ends), strict=True):
            for side in given if isinstance(given, tuple) else (given,):
                if isinstance(side, ca.MX):
                    as_expression(side, f"{place} of {name!r}")
        symbol = ca.MX.sym(f"{self.name}.{name}", rows * columns)
        shaped = Symbol(ca.reshape(symbol, rows, columns))
        lower, upper = bounds
        low = -np.inf if isinstance(lower, ca.MX) else lower
        high = np.inf if isinstance(upper, ca.MX) else upper
        limit = limit_of(name, symbol, low, high, scale, unit)
        variables.append(variable_of(limit, shape, *ends, columns))
        if isinstance(lower, ca.MX):
            self.constraint(f"lower bound of {name}", shaped - lower, 0.0, scale=scale, unit=unit)
        if isinstance(upper, ca.MX):
            label = f"upper bound of {name}"
            self.constraint(label, shaped - upper, upper=0.0, scale=scale, unit=unit)
        for given, fraction, where in zip(ends, (0.0, 1.0), ("start", "end"), strict=True):
            for side, base, low, high in sides(given):
                difference = owned(self, shaped - base, at=fraction)
                limit = limit_of(f"{where} of {name}{side}", difference, low, high, scale, unit)
                self.point_constraints.append(PointConstraint.of(limit, fraction))
        return shaped


def _named(item: Parameter | PathConstraint) -> str:
    """Return the name, followed by the size of a vector or matrix."""
    size = (item.expression if isinstance(item, PathConstraint) else item.symbol).numel()
    if isinstance(item, Variable) and item.columns > 1:
        return f"{item.name} [{size // item.columns},{item.columns}]"
    return item.name if size == 1 else f"{item.name} [{size}]"
