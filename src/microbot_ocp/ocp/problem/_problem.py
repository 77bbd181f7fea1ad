"""An optimal-control problem as data: phases with states, controls, dynamics and constraints.

Write the physics with the symbols that the declarations return; the transcription turns the
declaration into a nonlinear program. Nothing here knows a robot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError

Bound = ArrayLike | tuple[ArrayLike, ArrayLike] | None


@dataclass(frozen=True, eq=False)
class Variable:
    """A state or control of a phase, with bounds [size] in its own unit."""

    name: str
    symbol: ca.MX
    lower: FloatArray
    upper: FloatArray
    initial: tuple[FloatArray, FloatArray] | None
    final: tuple[FloatArray, FloatArray] | None
    scale: FloatArray
    unit: str
    shape: str  # "state", "constant", "linear", "polynomial" or "algebraic"
    interior_points: bool = False
    rate: ca.MX | None = None
    scaled: bool = True  # whether the scale was declared

    @property
    def size(self) -> int:
        """Number of components."""
        return self.symbol.shape[0]


@dataclass(frozen=True, eq=False)
class PathConstraint:
    """``lower <= expression <= upper`` along a phase, or at its end."""

    name: str
    expression: ca.MX
    lower: FloatArray
    upper: FloatArray
    scale: FloatArray
    unit: str
    scaled: bool = True  # whether the scale was declared


@dataclass(frozen=True, eq=False)
class Parameter:
    """A constant of a phase; phases that differ in parameters only share compiled kernels."""

    name: str
    symbol: ca.MX
    value: FloatArray


@dataclass(frozen=True)
class PhaseLink:
    """Continuity of the named states and linear controls from one phase to the next."""

    before: str
    after: str
    names: tuple[str, ...]


@dataclass(eq=False)
class Phase:
    """One phase: a stretch of time with one set of dynamics.

    Made by :meth:`OptimalControlProblem.phase`. The symbols ``time`` (since the start of the
    phase, s) and ``duration`` may be used in expressions.
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

    def __post_init__(self) -> None:
        self.time = ca.MX.sym(f"{self.name}.time")
        self.duration = ca.MX.sym(f"{self.name}.duration")

    def state(
        self,
        name: str,
        size: int = 1,
        *,
        lower: ArrayLike = -np.inf,
        upper: ArrayLike = np.inf,
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
        size : int
        lower, upper : array_like [size]
            Bounds at the mesh points.
        initial, final : value, (lower, upper) or None
            At the two ends of the phase; None leaves them free.
        scale : array_like [size], optional
            Typical size; the solver sees the state divided by it. Where none is given,
            :func:`~microbot_ocp.ocp.solution.scaled` finds one.
        unit : str
            For messages.
        interior_points : bool
            Whether the bounds also hold at the points inside the intervals at which path
            constraints hold.
        """
        variable = self._declare(name, size, lower, upper, initial, final, scale, unit, "state")
        self.states.append(replace(variable, interior_points=interior_points))
        return variable.symbol

    def control(
        self,
        name: str,
        size: int = 1,
        *,
        lower: ArrayLike = -np.inf,
        upper: ArrayLike = np.inf,
        initial: Bound = None,
        final: Bound = None,
        scale: ArrayLike | None = None,
        unit: str = "",
        shape: str = "constant",
    ) -> ca.MX:
        """Declare a control.

        Over each interval it is "constant", "linear" (and continuous), or "polynomial" with a
        value at each collocation point.
        """
        checks.one_of("shape", shape, ("constant", "linear", "polynomial"))
        variable = self._declare(name, size, lower, upper, initial, final, scale, unit, shape)
        if shape != "linear" and (initial is not None or final is not None):
            raise InputError(f"control {name!r} is {shape}: initial and final need shape='linear'")
        self.controls.append(variable)
        return variable.symbol

    def algebraic(
        self,
        name: str,
        size: int = 1,
        *,
        lower: ArrayLike = -np.inf,
        upper: ArrayLike = np.inf,
        scale: ArrayLike | None = None,
        unit: str = "",
    ) -> ca.MX:
        """Declare an algebraic variable; :meth:`algebraic_equation` determines it (collocation)."""
        variable = self._declare(name, size, lower, upper, None, None, scale, unit, "algebraic")
        self.algebraics.append(variable)
        return variable.symbol

    def algebraic_equation(self, expression: ca.MX) -> None:
        """Demand that ``expression`` be zero at every collocation point."""
        self.algebraic_equations.append(ca.MX(expression))

    def parameter(self, name: str, value: ArrayLike) -> ca.MX:
        """Declare a constant [size] of the phase and return its symbol.

        Phases that differ in parameters only share compiled kernels.
        """
        if name in {p.name for p in self.parameters}:
            raise InputError(f"parameter {name!r} is declared twice in phase {self.name!r}")
        given = checks.array(f"parameter {name!r}", np.ravel(np.asarray(value, float)), (None,))
        symbol = ca.MX.sym(f"{self.name}.{name}", given.size)
        self.parameters.append(Parameter(name, symbol, given))
        return symbol

    def rate(self, control: ca.MX) -> ca.MX:
        """Time derivative of a linear control, as a symbol for path constraints."""
        for variable in self.controls:
            if ca.is_equal(variable.symbol, control) and variable.rate is not None:
                return variable.rate
        raise InputError(f"rate needs a control of shape 'linear' of phase {self.name!r}")

    def derivative(self, state: ca.MX, expression: ca.MX) -> None:
        """Set the time derivative of a state."""
        for variable in self.states:
            if ca.is_equal(variable.symbol, state):
                expression = ca.MX(expression)
                if expression.shape != state.shape:
                    raise InputError(
                        f"derivative of {variable.name!r} must have shape {state.shape}, not "
                        f"{expression.shape}"
                    )
                self.derivatives[variable.name] = expression
                return
        raise InputError(f"derivative needs a state of phase {self.name!r}, not {state}")

    def constraint(
        self,
        name: str,
        expression: ca.MX,
        lower: ArrayLike = -np.inf,
        upper: ArrayLike = np.inf,
        *,
        scale: ArrayLike | None = None,
        unit: str = "",
    ) -> None:
        """Keep ``lower <= expression <= upper`` at the mesh points and the interior points."""
        expression = ca.MX(expression)
        size = expression.shape[0]
        low, high = _ordered(name, lower, upper, size, unit)
        self.constraints.append(_limit(name, expression, (low, high), scale, unit))

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
        """Demand ``lower <= expression <= upper`` of the state at the end of the phase.

        The expression is of states, linear controls, parameters and ``duration``. What is a bound
        of a state itself is said by its ``final``.
        """
        expression = ca.MX(expression)
        size = expression.shape[0]
        low, high = _ordered(name, lower, upper, size, unit)
        self.end_constraints.append(_limit(name, expression, (low, high), scale, unit))

    def running_cost(self, expression: ca.MX) -> None:
        """Add the time integral of ``expression`` to the cost."""
        self.running_costs.append(self._scalar("running cost", expression))

    def end_cost(self, expression: ca.MX) -> None:
        """Add ``expression`` of the end state and ``duration`` to the cost."""
        self.end_costs.append(self._scalar("end cost", expression))

    def _scalar(self, kind: str, expression: ca.MX) -> ca.MX:
        expression = ca.MX(expression)
        if not expression.is_scalar():
            raise InputError(
                f"a {kind} of phase {self.name!r} must be one number, but has shape "
                f"{expression.shape}"
            )
        return expression

    def _declare(
        self,
        name: str,
        size: int,
        lower: ArrayLike,
        upper: ArrayLike,
        initial: Bound,
        final: Bound,
        scale: ArrayLike | None,
        unit: str,
        shape: str,
    ) -> Variable:
        if name in {v.name for v in (*self.states, *self.controls, *self.algebraics)}:
            raise InputError(f"{name!r} is declared twice in phase {self.name!r}")
        if not isinstance(size, int | np.integer) or size < 1:
            raise InputError(f"size of {name!r} must be a whole number from 1 up, not {size!r}")
        low, high = _ordered(name, lower, upper, size, unit)
        return Variable(
            name=name,
            symbol=ca.MX.sym(f"{self.name}.{name}", size),
            lower=low,
            upper=high,
            initial=_range(f"initial {name}", initial, size, unit),
            final=_range(f"final {name}", final, size, unit),
            scale=_scale(name, scale, size),
            scaled=scale is not None,
            unit=unit,
            shape=shape,
            rate=ca.MX.sym(f"{self.name}.{name}.rate", size) if shape == "linear" else None,
        )


class OptimalControlProblem:
    """Phases in a row, linked; minimise the sum of their costs.

    Examples
    --------
    The double integrator from rest to rest over 1 m with acceleration within 1 m/s^2: 2 s.

    >>> problem = OptimalControlProblem("double integrator")
    >>> phase = problem.phase("move", duration=(0.1, 10.0))
    >>> x = phase.state("x", initial=0.0, final=1.0, unit="m")
    >>> v = phase.state("v", initial=0.0, final=0.0, unit="m/s")
    >>> u = phase.control("u", lower=-1.0, upper=1.0, unit="m/s^2")
    >>> phase.derivative(x, v)
    >>> phase.derivative(v, u)
    >>> phase.end_cost(phase.duration)
    >>> from microbot_ocp.ocp import solve
    >>> round(solve(problem, mesh=20).cost, 5)
    2.0
    """

    def __init__(self, name: str = "problem") -> None:
        self.name = name
        self.phases: list[Phase] = []
        self.links: list[PhaseLink] = []

    def phase(
        self,
        name: str,
        duration: float | tuple[float, float],
        *,
        interior_points: Sequence[float] | None = None,
        scale: float | None = None,
    ) -> Phase:
        """Add a phase of fixed duration, or free within (lower, upper), s.

        ``interior_points`` are the fractions of every interval at which path constraints hold
        besides the mesh points; by default those of the scheme. ``scale`` is a typical duration, s.
        """
        if name in {phase.name for phase in self.phases}:
            raise InputError(f"phase {name!r} is declared twice")
        low, high = duration if isinstance(duration, tuple) else (duration, duration)
        low = checks.number(f"duration of phase {name!r}", low, "s", above=0.0)
        high = checks.number(f"upper duration of phase {name!r}", high, "s", at_least=low)
        inner = None if interior_points is None else tuple(interior_points)
        if any(not 0 < fraction < 1 for fraction in inner or ()):
            raise InputError(f"interior_points must be fractions inside (0, 1), not {inner}")
        if scale is not None:
            scale = checks.number(f"scale of the duration of phase {name!r}", scale, "s", above=0.0)
        self.phases.append(Phase(name, (low, high), inner, scale))
        return self.phases[-1]

    def link(self, before: Phase, after: Phase, names: Sequence[str] | None = None) -> None:
        """Make states and linear controls continuous from one phase to the next.

        ``names`` default to all states that both have; whatever is not named may jump.
        """
        order = [phase.name for phase in self.phases]
        if order.index(after.name) != order.index(before.name) + 1:
            raise InputError(f"phase {after.name!r} must follow {before.name!r} to be linked to it")
        sizes_before = {v.name: v.size for v in node_variables(before)}
        sizes_after = {v.name: v.size for v in node_variables(after)}
        chosen = (
            tuple(v.name for v in before.states if v.name in sizes_after)
            if names is None
            else tuple(names)
        )
        for name in chosen:
            if sizes_before.get(name) is None or sizes_before.get(name) != sizes_after.get(name):
                raise InputError(
                    f"{name!r} cannot be linked: phases {before.name!r} and {after.name!r} must "
                    "both have it as a state or linear control of the same size"
                )
        self.links.append(PhaseLink(before.name, after.name, chosen))

    def check(self) -> None:
        """Raise InputError where the declaration is not complete."""
        if not self.phases:
            raise InputError(f"problem {self.name!r} has no phases")
        linked = {(link.before, link.after) for link in self.links}
        for before, after in zip(self.phases[:-1], self.phases[1:], strict=True):
            if (before.name, after.name) not in linked:
                raise InputError(
                    f"phase {after.name!r} is not linked to {before.name!r}: call link(), with "
                    "names=() if nothing is continuous"
                )
        for phase in self.phases:
            if not phase.states:
                raise InputError(f"phase {phase.name!r} has no states")
            for state in phase.states:
                if state.name not in phase.derivatives:
                    raise InputError(
                        f"state {state.name!r} of phase {phase.name!r} has no dynamics"
                    )
            used = ca.vertcat(
                *phase.derivatives.values(),
                *(c.expression for c in phase.constraints),
                *(c.expression for c in phase.end_constraints),
                *phase.running_costs,
                *phase.end_costs,
                *phase.algebraic_equations,
            )
            _check_symbols(phase, used)
            unknowns = sum(v.size for v in phase.algebraics)
            equations = sum(e.shape[0] for e in phase.algebraic_equations)
            if unknowns != equations:
                raise InputError(
                    f"phase {phase.name!r} has {unknowns} algebraic variables but {equations} "
                    "algebraic equations"
                )
            for control in phase.controls:
                symbols = [control.symbol]
                symbols += [] if control.rate is None else [control.rate]
                if not any(ca.depends_on(used, symbol) for symbol in symbols):
                    raise InputError(
                        f"control {control.name!r} of phase {phase.name!r} appears nowhere"
                    )


def _check_symbols(phase: Phase, used: ca.MX) -> None:
    """Raise InputError for symbols that a phase cannot know, or not at its end."""
    variables = [*phase.states, *phase.controls, *phase.algebraics]
    rates = [c.rate for c in phase.controls if c.rate is not None]
    constants = [p.symbol for p in phase.parameters]
    known = [*(v.symbol for v in variables), *rates, *constants, phase.time, phase.duration]
    for symbol in ca.symvar(used):
        if not any(ca.is_equal(symbol, other) for other in known):
            raise InputError(
                f"phase {phase.name!r} uses {symbol.name()!r}, which is no variable of its own; "
                "constants are declared with parameter(), variables of other phases with link()"
            )
    at_end = ca.vertcat(*phase.end_costs, *(c.expression for c in phase.end_constraints))
    nodes = {v.name for v in node_variables(phase)}
    lost = [v.symbol for v in variables if v.name not in nodes]
    for symbol in [*lost, *rates]:
        if ca.depends_on(at_end, symbol):
            raise InputError(
                f"an end cost or end constraint of phase {phase.name!r} uses {symbol.name()!r}, "
                "which has no value at the end: use states and controls of shape 'linear'"
            )


def node_variables(phase: Phase) -> list[Variable]:
    """States and linear controls: what has a value at every mesh point."""
    return [*phase.states, *(c for c in phase.controls if c.shape == "linear")]


def _fill(name: str, value: ArrayLike, size: int) -> FloatArray:
    given = np.asarray(value, dtype=float)
    if given.ndim == 0:
        given = np.full(size, float(given))
    return checks.array(name, given.ravel(), (size,), finite=False)


def _ordered(
    name: str, lower: ArrayLike, upper: ArrayLike, size: int, unit: str
) -> tuple[FloatArray, FloatArray]:
    low, high = _fill(f"lower {name}", lower, size), _fill(f"upper {name}", upper, size)
    if np.any(low > high):
        i = int(np.argmax(low > high))
        raise InputError(
            f"bounds of {name!r} are crossed: lower {low[i]:g} is above upper {high[i]:g} {unit}"
        )
    return low, high


def _range(name: str, value: Bound, size: int, unit: str) -> tuple[FloatArray, FloatArray] | None:
    if value is None:
        return None
    low, high = value if isinstance(value, tuple) and len(value) == 2 else (value, value)
    return _ordered(name, low, high, size, unit)


def _limit(
    name: str,
    expression: ca.MX,
    bounds: tuple[FloatArray, FloatArray],
    scale: ArrayLike | None,
    unit: str,
) -> PathConstraint:
    size = _scale(name, scale, expression.shape[0])
    return PathConstraint(name, expression, *bounds, size, unit, scaled=scale is not None)


def _scale(name: str, value: ArrayLike | None, size: int) -> FloatArray:
    if value is None:
        return np.ones(size)
    scale = _fill(f"scale of {name}", value, size)
    if np.any(~np.isfinite(scale)) or np.any(scale <= 0):
        raise InputError(f"scale of {name!r} must be finite and above 0, not {value}")
    return scale
