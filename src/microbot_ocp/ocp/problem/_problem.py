"""An optimal-control problem as data: a sequence of phases, their links, and free parameters.

Write the physics with the symbols that the declarations return; the transcription converts the
declaration to a nonlinear program. Nothing here depends on a robot.
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.calls import refuse_without_derivatives
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.foreign_words import Hinting
from microbot_ocp._base.portable import Portable
from microbot_ocp._base.relations import Symbol
from microbot_ocp.ocp.problem._coupling import copied, renamed
from microbot_ocp.ocp.problem._items import (
    CONSTANTS,
    Parameter,
    PathConstraint,
    PhaseLink,
    Variable,
    converted,
    duration_bounds,
    limit_of,
    variable_of,
)
from microbot_ocp.ocp.problem._phase import Phase
from microbot_ocp.ocp.problem._relations import (
    as_expression,
    refuse_indices,
)


class OptimalControlProblem(Hinting, Portable):
    """A sequence of linked phases; the sum of their costs is minimised.

    With ``maximize`` the costs are gains and their sum is maximised: ``objective`` of a solution is
    the sum of the gains, ``cost`` its negative.

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
    >>> problem
    <OptimalControlProblem 'double integrator', to minimise
      Phase 'move', 0.1 to 10 s: states x, v; controls u>
    >>> from microbot_ocp.ocp import solve
    >>> round(solve(problem, mesh=20).cost, 5)
    2.0
    """

    def __init__(self, name: str = "problem", *, maximize: bool = False) -> None:
        self.name = name
        self.maximize = maximize
        self.phases: list[Phase] = []
        self.links: list[PhaseLink] = []
        self.free_parameters: list[Variable] = []

    def __repr__(self) -> str:
        counted = {"link": len(self.links), "free parameter": len(self.free_parameters)}
        more = "".join(f", {n} {kind}{'s' * (n > 1)}" for kind, n in counted.items() if n)
        head = f"{self.name!r}, to {'maximise' if self.maximize else 'minimise'}{more}"
        phases = "".join(f"\n  {f'{phase!r}'[1:-1]}" for phase in self.phases)
        return f"<OptimalControlProblem {head}{phases}>"

    def phase(
        self,
        name: str,
        duration: float | tuple[float, float],
        *,
        interior_points: Sequence[float] | None = None,
        scale: float | None = None,
        start: float | tuple[float, float] | ca.MX | None = None,
    ) -> Phase:
        """Add a phase of fixed duration, or free within (lower, upper), s.

        ``interior_points`` are the fractions of every interval at which path constraints hold
        besides the mesh points; by default those of the scheme. ``scale`` is a typical duration, s.
        ``start`` is the start time of the phase, s: a value, (lower, upper) for a free start, or an
        expression; by default 0 or the end of the previous phase.

        Examples
        --------
        The start of the interval of 1 s with the least integral of sin(t): its middle is 3 pi / 2.

        >>> from microbot_ocp.ocp import solve
        >>> problem = OptimalControlProblem("when")
        >>> phase = problem.phase("second", 1.0, start=(0.0, 6.0))
        >>> phase.derivative(phase.state("x", initial=0.0), 1.0)
        >>> phase.running_cost(ca.sin(phase.start + phase.time))
        >>> start = solve(problem, mesh=20).parameters["start of 'second'"]
        >>> round(float(start[0]) + 0.5, 3)
        4.712
        """
        if name in {phase.name for phase in self.phases}:
            raise InputError(f"phase {name!r} is declared twice")
        bounds = duration_bounds(name, duration)
        inner = None if interior_points is None else tuple(interior_points)
        if any(not 0 < fraction < 1 for fraction in inner or ()):
            raise InputError(f"interior_points must be fractions inside (0, 1), not {inner}")
        if scale is not None:
            scale = checks.number(f"scale of the duration of phase {name!r}", scale, "s", above=0.0)
        if start is None:
            before = self.phases[-1] if self.phases else None
            start = ca.MX(0.0) if before is None else before.begins + before.duration
        elif isinstance(start, tuple):
            low, high = start
            start = self.free_parameter(f"start of {name!r}", lower=low, upper=high, unit="s")
        begins = as_expression(start, f"start of phase {name!r}")
        phase = Phase(name, bounds, inner, scale, problem=self, begins=begins)
        self.phases.append(phase)
        return phase

    def repeat(
        self,
        phase: Phase,
        times: int,
        *,
        names: Sequence[str] | None = None,
        parameters: Sequence[Mapping[str, ArrayLike]] = (),
        jumps: Mapping[str, ca.MX] | None = None,
    ) -> list[Phase]:
        """Repeat the last phase: add copies of it, each linked to the previous one.

        Parameters
        ----------
        phase : Phase
            The last phase, completely declared.
        times : int
            Number of passes through the phase, the first included.
        names : sequence of str, optional
            Variables that are continuous from each phase to the next; by default all states.
            Their initial conditions hold in the first phase only, final conditions in the last.
        parameters : sequence of mappings from name to value, optional
            Values of parameters and measurements that differ in the copies, from the second phase
            on.
        jumps : mapping from name to expression, optional
            Values after the jumps from each phase to the next; see :meth:`link`.

        Returns
        -------
        list of Phase
            The phase and its copies, named with " 2", " 3" ... appended.

        Examples
        --------
        Three laps of 1 m, each with its own speed limit.

        >>> from microbot_ocp.ocp import solve
        >>> problem = OptimalControlProblem("laps")
        >>> lap = problem.phase("lap", duration=(0.1, 10.0))
        >>> x = lap.state("x", initial=0.0, unit="m")
        >>> v = lap.control("v", lower=0.0, unit="m/s")
        >>> limit = lap.parameter("limit", 1.0)
        >>> lap.derivative(x, v)
        >>> lap.constraint("limit", v - limit, upper=0.0)
        >>> lap.end_constraint("one lap", x - lap.initial(x), 1.0, 1.0)
        >>> lap.end_cost(lap.duration)
        >>> laps = problem.repeat(lap, 3, parameters=[{"limit": 2.0}, {"limit": 4.0}])
        >>> round(solve(problem, mesh=10).duration, 3)
        1.75

        A ball that is dropped from 1 m and loses 0.4 of its speed at each of three impacts.

        >>> problem = OptimalControlProblem("bouncing ball")
        >>> flight = problem.phase("flight", duration=(0.1, 5.0))
        >>> height = flight.state("height", initial=1.0, unit="m")
        >>> v = flight.state("v", initial=0.0, final=(-10.0, 0.0), unit="m/s")
        >>> flight.derivative(height, v)
        >>> flight.derivative(v, -9.81)
        >>> flight.end_constraint("ground", height, 0.0, 0.0)
        >>> flights = problem.repeat(flight, 3, jumps={"v": -0.6 * v})
        >>> round(solve(problem, mesh=4).duration, 4)  # (1 + 2 (0.6 + 0.36)) sqrt(2 / 9.81)
        1.3184
        """
        if not self.phases or phase is not self.phases[-1]:
            raise InputError(f"repeat takes the last phase of a problem, not {phase.name!r}")
        if phase._asked_start:
            raise InputError(
                f"phase {phase.name!r} uses its start, which differs in its copies: declare a "
                "state with the derivative 1"
            )
        checks.whole("times", times)
        if len(parameters) not in (0, times - 1):
            raise InputError(
                f"parameters must have {times - 1} entries, one per copy, not {len(parameters)}"
            )
        jumps = jumps or {}
        states = [v.name for v in phase.states] if names is None else names
        continuous = [name for name in states if name not in jumps]
        linked = [*continuous, *jumps]
        phases = [phase]
        for k in range(2, times + 1):
            copy = copied(phase, f"{phase.name} {k}", linked)
            copy = with_values(copy, parameters[k - 2] if parameters else {})
            self.phases.append(copy)
            copy.begins = phases[-1].begins + phases[-1].duration
            phases.append(copy)
        # Translate the jumps first: links add constraints to the phases.
        landings = [{k: renamed(e, phase, member) for k, e in jumps.items()} for member in phases]
        for (before, after), landing in zip(itertools.pairwise(phases), landings, strict=False):
            self.link(before, after, continuous, jumps=landing)
        for member in phases[:-1]:
            for kind in ("states", "controls"):
                items = getattr(member, kind)
                freed = [replace(v, final=None) if v.name in linked else v for v in items]
                setattr(member, kind, freed)
        return phases

    def free_parameter(
        self,
        name: str,
        size: int = 1,
        *,
        lower: ArrayLike = -np.inf,
        upper: ArrayLike = np.inf,
        scale: ArrayLike | None = None,
        unit: str = "",
    ) -> ca.MX:
        """Declare a constant [size] that the solver determines, for expressions of any phase.

        Give an initial guess among the values of the first phase that uses the constant; the
        result is in ``solution.parameters``.

        Examples
        --------
        The length of a pendulum that swings from side to side in 1 s.

        >>> from microbot_ocp.ocp import solve
        >>> problem = OptimalControlProblem("seconds pendulum")
        >>> length = problem.free_parameter("length", lower=0.1, upper=10.0, unit="m")
        >>> phase = problem.phase("half swing", duration=1.0)
        >>> angle = phase.state("angle", initial=0.01, final=-0.01, unit="rad")
        >>> speed = phase.state("speed", initial=0.0, unit="rad/s")
        >>> phase.derivative(angle, speed)
        >>> phase.derivative(speed, -9.81 / length * ca.sin(angle))
        >>> round(float(solve(problem, mesh=20).parameters["length"][0]), 3)  # 9.81 / pi^2
        0.994
        """
        if name in {v.name for v in self.free_parameters}:
            raise InputError(f"free parameter {name!r} is declared twice")
        checks.whole(f"size of {name!r}", size, at_most=np.inf)
        limit = limit_of(name, ca.MX.sym(name, size), lower, upper, scale, unit)
        self.free_parameters.append(variable_of(limit, "parameter"))
        return Symbol(limit.expression)

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
        """Require ``lower <= expression <= upper`` of phase ends, durations and free parameters.

        ``initial``, ``final`` and ``value`` of the phases return values for the expression. A
        relation, such as ``a.duration + b.duration == 3``, may replace expression and bounds.
        """
        last = self._last_of(expression)
        last.end_constraint(name, expression, lower, upper, scale=scale, unit=unit)

    def cost(self, expression: ca.MX) -> None:
        """Add an expression of phase ends, durations and free parameters to the cost.

        Examples
        --------
        Two phases of 3 s in total, with a cost of both durations.

        >>> from microbot_ocp.ocp import solve
        >>> problem = OptimalControlProblem("shares")
        >>> phases = [problem.phase(name, (0.1, 5.0)) for name in ("a", "b")]
        >>> for phase in phases:
        ...     phase.derivative(phase.state("x"), 1.0)
        >>> problem.link(*phases)
        >>> a, b = (phase.duration for phase in phases)
        >>> problem.constraint("in all", a + b, 3.0, 3.0, unit="s")
        >>> problem.cost(a**2 + 2 * b**2)
        >>> round(solve(problem, mesh=4)["a"].duration, 4)
        2.0
        """
        self._last_of(expression).end_cost(expression)

    def _last_of(self, expression: ca.MX) -> Phase:
        """Return the last phase that occurs in an expression; the last of all if none does."""
        if not self.phases:
            raise InputError(f"problem {self.name!r} has no phases")
        symbols = ca.symvar(converted(expression))

        def occurs(phase: Phase) -> bool:
            declared = [phase.duration, *(value.symbol for value in phase._values)]
            return any(ca.is_equal(a, b) for a in symbols for b in declared)

        return next((phase for phase in reversed(self.phases) if occurs(phase)), self.phases[-1])

    def link(
        self,
        before: Phase,
        after: Phase,
        names: Sequence[str] | None = None,
        *,
        jumps: Mapping[str, ca.MX] | None = None,
    ) -> None:
        """Make states and linear controls continuous from one phase to the next.

        ``names`` default to all states that both phases have, without those whose initial
        condition in ``after`` is an expression; all other variables may jump. ``jumps`` gives the
        initial value of a state of ``after`` by name, as an expression of the variables of
        ``before`` at its end, such as ``{"v": -0.6 * v}``.
        """
        order = [phase.name for phase in self.phases]
        if order.index(after.name) != order.index(before.name) + 1:
            raise InputError(
                f"phase {after.name!r} must follow {before.name!r} to be linked to it; a branch "
                "begins with initial=before.final(state), and is linked with names=()"
            )
        sizes, sizes_after = ({v.name: v.size for v in node_variables(p)} for p in (before, after))
        if any(link.before == before.name for link in self.links):
            raise InputError(
                f"phases {before.name!r} and {after.name!r} are linked twice: give all names in "
                "one link()"
            )
        jumps = jumps or {}
        chosen = tuple(_common_states(before, after, jumps) if names is None else names)
        for name in chosen:
            if name not in sizes or sizes[name] != sizes_after.get(name):
                raise InputError(
                    f"{name!r} cannot be linked: phases {before.name!r} and {after.name!r} must "
                    "both have it as a state or linear control of the same size"
                )
        for name, landing in jumps.items():
            state = checks.by_name("jumps", {v.name: v for v in after.states}, name)
            missed = state.symbol - ca.vec(before.final(landing))
            like = {"scale": state.scale if state.scaled else None, "unit": state.unit}
            after.point_constraint(f"start of {name}", missed, 0.0, 0.0, at=0.0, **like)
        self.links.append(PhaseLink(before.name, after.name, chosen))

    def check(self) -> None:
        """Raise InputError if the declaration is incomplete."""
        if not self.phases:
            raise InputError(f"problem {self.name!r} has no phases")
        linked = {(link.before, link.after) for link in self.links}
        for before, after in itertools.pairwise(self.phases):
            if (before.name, after.name) not in linked:
                raise InputError(
                    f"phase {after.name!r} is not linked to {before.name!r}: call link(), with "
                    "names=() if nothing is continuous"
                )
        for phase in self.phases:
            _check_phase(phase)
        names = {v.name for phase in self.phases for v in phase.free_parameters}
        for free in self.free_parameters:
            if free.name not in names:
                raise InputError(f"free parameter {free.name!r} appears nowhere")


def _check_phase(phase: Phase) -> None:
    """Raise InputError if the declaration of a phase is incomplete."""
    if not phase.states:
        raise InputError(f"phase {phase.name!r} has no states")
    for state in phase.states:
        if state.name not in phase.derivatives:
            raise InputError(f"state {state.name!r} of phase {phase.name!r} has no dynamics")
    limits = [c.expression for c in (*phase.constraints, *phase.end_constraints)]
    costs = [*phase.running_costs, *phase.end_costs]
    slopes = phase.derivatives.values()
    used = ca.vertcat(*slopes, *limits, *costs, *phase.algebraic_equations)
    _check_symbols(phase, used)
    points = (c.expression for c in (*phase.point_constraints, *phase.point_costs))
    every = ca.vertcat(used, *points)
    refuse_indices(f"phase {phase.name!r}", every)
    refuse_without_derivatives(f"phase {phase.name!r}", every)
    unknowns = sum(v.size for v in phase.algebraics)
    equations = sum(e.shape[0] for e in phase.algebraic_equations)
    if unknowns != equations:
        raise InputError(
            f"phase {phase.name!r} has {unknowns} algebraic variables but {equations} "
            "algebraic equations"
        )
    for control in phase.controls:
        rate = phase.rates.get(control.name, control.symbol)
        if not (ca.depends_on(used, control.symbol) or ca.depends_on(used, rate)):
            raise InputError(f"control {control.name!r} of phase {phase.name!r} appears nowhere")


def _check_symbols(phase: Phase, used: ca.MX) -> None:
    """Raise InputError for symbols that are unknown to a phase or have no value at its end."""
    symbols = [*(v.symbol for v in phase.variables), *phase.rates.values()]
    constants = [p.symbol for p in phase.parameters]
    data = [m.symbol for m in phase.measurements]
    declared = [*symbols, *constants, phase.time, phase.duration]
    points = ca.vertcat(*(c.expression for c in (*phase.point_constraints, *phase.point_costs)))
    for symbol in ca.symvar(ca.vertcat(used, points)):
        if any(ca.is_equal(symbol, other) for other in data):
            if ca.depends_on(used, symbol):
                raise InputError(
                    f"phase {phase.name!r} uses measurement {symbol.name()!r} along its time: "
                    "measurements are for point_cost() and point_constraint()"
                )
        elif not any(ca.is_equal(symbol, other) for other in declared):
            raise InputError(
                f"phase {phase.name!r} uses {symbol.name()!r}, which is no variable of its own; "
                "declare constants with parameter(), share variables of other phases with link(), "
                "or take their values at an end with initial() and final()"
            )
    at_end = ca.vertcat(*phase.end_costs, *(c.expression for c in phase.end_constraints))
    nodes = node_variables(phase)
    lost = [v.symbol for v in phase.variables if v not in nodes]
    for where, name in ((at_end, "end"), (points, "point")):
        for symbol in [*lost, *phase.rates.values()]:
            if ca.depends_on(where, symbol):
                raise InputError(
                    f"{name} cost or {name} constraint of phase {phase.name!r} uses "
                    f"{symbol.name()!r}, which has no value at the {name}: use states and "
                    "controls of shape 'linear'"
                )


def with_shapes(
    problem: OptimalControlProblem, shape: str, *, tied: bool = True
) -> OptimalControlProblem:
    """Return the problem with ``shape`` for every control that was declared without a shape.

    Without ``tied``, controls that equations tie to what moves keep theirs.
    """

    def shaped(phase: Phase) -> Phase:
        kept = () if tied else tied_controls(phase)

        def change(control: Variable) -> Variable:
            free = control.shape == "auto" and control.name not in kept
            return replace(control, shape=shape) if free else control

        return with_items(phase, change, ["controls"])

    return with_phases(problem, map(shaped, problem.phases))


def control_equations(phase: Phase) -> ca.MX:
    """Return the constraints with equal bounds that depend on controls, as expressions = 0."""
    controls = _controls_of(phase)
    equal = [c for c in phase.constraints if (c.lower == c.upper).all()]
    parts = (c.expression - c.lower for c in equal if ca.depends_on(c.expression, controls))
    return ca.vertcat(*parts, ca.MX(0, 1))


def _controls_of(phase: Phase) -> ca.MX:
    return ca.vertcat(*(c.symbol for c in phase.controls), ca.MX(0, 1))


def tied_controls(phase: Phase) -> set[str]:
    """Return controls that constraints with equal bounds determine, one for each equation.

    Such a control follows states or time all along an interval; controls without limits come
    first, because limits shorten what the other controls do if these are constant in their place.
    None are returned where the equations do not have full structural rank by the controls.
    """
    moving = ca.vertcat(phase.time, *(v.symbol for v in (*phase.states, *phase.shaped("linear"))))
    controls, equations = _controls_of(phase), control_equations(phase)
    slopes = ca.DM(ca.jacobian_sparsity(equations, controls), 1.0)
    if not ca.depends_on(equations, moving) or ca.sprank(slopes) < slopes.size1():
        return set()
    owners = [c for c in phase.controls for _ in range(c.size)]
    limited = np.concatenate([np.isfinite(c.lower) | np.isfinite(c.upper) for c in phase.controls])
    tied: list[int] = []
    for column in np.argsort(limited, kind="stable"):
        if ca.sprank(slopes[:, [*tied, int(column)]]) > len(tied):
            tied.append(int(column))
    return {owners[column].name for column in tied}


def _common_states(before: Phase, after: Phase, jumps: Mapping[str, ca.MX]) -> list[str]:
    """Return the states of two phases that are continuous unless others are named."""
    # A state whose start is an expression is already determined.
    tied = {*(c.name for c in after.point_constraints), *(f"start of {k}" for k in jumps)}
    there = [v.name for v in node_variables(after)]
    states = (v.name for v in before.states if f"start of {v.name}" not in tied)
    names = [name for name in states if name in there]
    if not names and not jumps and not tied:
        known = ", ".join(v.name for v in node_variables(before))
        raise InputError(
            f"phases {before.name!r} and {after.name!r} have no state in common to be linked: "
            f"{known} and {', '.join(there)}; give initial=before.final(state) to the states of "
            "the second, or names=()"
        )
    return names


def with_phases(problem: OptimalControlProblem, phases: Iterable[Phase]) -> OptimalControlProblem:
    """Return the problem with other phases, but its own symbols and links."""
    changed = copy.copy(problem)
    changed.phases = list(phases)
    return changed


def with_items(phase: Phase, change: Callable[[Any], Any], kinds: Iterable[str]) -> Phase:
    """Return the phase with the items of some lists changed; symbols and expressions stay."""
    changed = copy.copy(phase)
    for kind in kinds:
        setattr(changed, kind, [change(item) for item in getattr(phase, kind)])
    return changed


def with_values(phase: Phase, values: Mapping[str, ArrayLike]) -> Phase:
    """Return the phase with new values of the named parameters and measurements."""

    def valued(item: Parameter) -> Parameter:
        return item.with_value(values[item.name]) if item.name in values else item

    return with_items(phase, valued, CONSTANTS)


def parts_of(
    items: Sequence[PathConstraint], table: FloatArray, axis: int = -1
) -> dict[str, FloatArray]:
    """Split a table by item along an axis, and return the parts by item name; a rest is dropped."""
    parts = np.split(table, np.cumsum([item.size for item in items]), axis)
    return {item.name: part for item, part in zip(items, parts[:-1], strict=True)}


def node_variables(phase: Phase) -> list[Variable]:
    """Return states, linear controls and free parameters: variables with values at mesh points."""
    return [*phase.states, *phase.shaped("linear"), *phase.free_parameters]
