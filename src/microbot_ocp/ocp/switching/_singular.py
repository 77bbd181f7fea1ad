"""Singular arcs by first-order conditions: a boundary value problem in states and costates.

If the Hamiltonian ``H = L + lambda' f`` is affine in the controls, the switching function ``H_u``
is at most 0 where the control is at its upper bound, at least 0 at its lower bound, and 0 along a
singular arc. On a singular arc of first order the second time derivative ``A + B u`` of ``H_u``
contains the control, so ``u = -A / B``; ``H_u`` and its first derivative then vanish along the
whole arc if they vanish at its end. States and costates satisfy the canonical equations, and the
lengths of the arcs are unknowns that the zeros of the switching functions determine. The cost is
flat in these lengths, so minimising it yields half of the digits; the conditions yield all of them.

Source: A. E. Bryson and Y.-C. Ho, *Applied Optimal Control*, chapter 8. Kelley's condition (the
generalised Legendre-Clebsch condition) is ``B <= 0``: H. J. Kelley, R. E. Kopp and H. G. Moyer,
*Singular extremals*, in G. Leitmann, *Topics in Optimization* (1967).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import ROUNDING, FloatArray
from microbot_ocp._base.status import Status
from microbot_ocp.ocp.arcs import ArcPlan, PlannedArc, Sample, joined
from microbot_ocp.ocp.mesh import divide_phase, state_errors
from microbot_ocp.ocp.problem import OptimalControlProblem, Phase, Variable
from microbot_ocp.ocp.solution import PhaseSolution, Solution, cost_size
from microbot_ocp.ocp.solvers import SolveContext, SolverSettings
from microbot_ocp.ocp.starts import guess_from, scaled
from microbot_ocp.ocp.switching._cutter import (
    BOUND_MARGIN,
    HIGH_ORDER,
    LONGEST_ARC,
    SHORTEST_ARC,
    VANISHED_ARC,
)
from microbot_ocp.ocp.transcription import Guess, MeshLike, Transcription, interpolate
from microbot_ocp.ocp.verification import costates_of, differentiate

SETTINGS = SolverSettings("ipopt", tolerance=1e-12, gap=np.inf, max_iterations=60)
LEAST_INTERVALS = 4  # intervals of an arc on its first mesh
MOST_ROUNDS = 6  # solves, each on a finer mesh
TIMES_CHECKED = 200  # instants of an arc at which signs and limits are checked
AGREEING_COST = 1e-2  # difference to the cost of the nearby solution, relative to that cost

COST, CLOCK, COSTATE = "cost so far", "elapsed time", "costate of "


@dataclass(frozen=True, eq=False)
class SingularArcs:
    """A solution whose singular arcs satisfy the first-order conditions.

    Attributes
    ----------
    solution : Solution
        Solution of the boundary value problem with one phase per arc, in states and costates.
    cost : float
        Cost of the declared problem.
    lengths : lengths of the arcs, s
    kelley : float
        Largest derivative of the second time derivative of a switching function with respect to
        its singular control; negative where Kelley's condition holds strictly.
    switching : float
        Largest magnitude of a switching function where it must vanish, relative to its largest
        value anywhere.
    state_error : largest relative error of the canonical equations in any interval
    samples : functions that return all variables of an arc at times since its start
    """

    solution: Solution
    cost: float
    lengths: FloatArray
    kelley: float
    switching: float
    state_error: float
    samples: tuple[Sample, ...]

    def sample(self, t: FloatArray) -> dict[str, FloatArray]:
        """Return all variables at times [M] since the start, s."""
        return joined(self.samples, self.lengths)(t)


class NotPossibleError(Exception):
    """Reason why the conditions cannot be solved, or their solution is rejected."""


def costate_sample(solution: Solution) -> Sample:
    """Return a function of time that returns costates, from the multipliers of the dynamics."""
    tables: dict[str, list[FloatArray]] = {}
    times, start = [], 0.0
    multipliers = np.asarray(solution.row_multipliers, dtype=float)
    for phase in solution.phases:
        costates = costates_of(phase, differentiate(phase, multipliers), multipliers)
        at_points = costates.point_t.size > 0
        times.append(start + (costates.point_t if at_points else costates.t))
        for name, values in (costates.point_values if at_points else costates.values).items():
            tables.setdefault(name, []).append(values)
        start += phase.duration
    t = np.concatenate(times)
    joint = {name: np.vstack(values) for name, values in tables.items()}
    return lambda at: {name: interpolate(table, at, t) for name, table in joint.items()}


def solve_conditions(
    problem: OptimalControlProblem, plan: ArcPlan, solution: Solution, accuracy: float
) -> SingularArcs:
    """Solve the first-order conditions from a nearby solution in arcs.

    Parameters
    ----------
    problem : OptimalControlProblem
    plan : ArcPlan
        Arcs of the single phase, with the lengths of the solution.
    solution : Solution
    accuracy : float
        Relative error of the canonical equations that is accepted in each interval.

    Raises
    ------
    NotPossibleError
        The problem is not of the kind treated here, or the result is rejected.
    """
    phase, controls = plan.declared, sum(c.size for c in plan.declared.controls)
    limited = any(any(arc.signature[controls:]) for arc in plan.arcs)
    at_points = phase.point_constraints or phase.point_costs
    reasons = {  # the conditions below do not cover these cases
        "the problem has several phases": len(problem.phases) > 1,
        "the problem has free parameters": phase.free_parameters,
        "the problem has algebraic equations": phase.algebraics,
        "a control is continuous": any(c.shape == "linear" for c in phase.controls),
        "a constraint or cost holds at points of the phase": at_points,
        "limits of states or path constraints are active on an arc": limited,
    }
    for reason, holds in reasons.items():
        if holds:
            raise NotPossibleError(reason)
    return _FirstOrderConditions(plan, solution).solved(accuracy)


class _ArcLaw(NamedTuple):
    """Control law and derivatives of the switching function on an arc.

    ``free`` is the index of the singular control, if any. ``terms`` are functions of states,
    costates, controls and time: the first time derivative of its switching function, and A and B of
    the second one, ``A + B u``. ``controls`` [m] is a function of states, costates and time.
    """

    free: int | None
    terms: ca.Function
    controls: ca.Function


class _FirstOrderConditions:
    """The canonical equations of a phase, with conditions at the junctions of its arcs."""

    def __init__(self, plan: ArcPlan, solution: Solution) -> None:
        self.plan, phase = plan, plan.declared
        self.solution = solution
        self.costates = costate_sample(solution)
        self.size = sum(s.size for s in phase.states)
        self.state_parts, self.control_parts = _parts(phase.states), _parts(phase.controls)
        self.lower = np.concatenate([c.lower for c in phase.controls])
        self.upper = np.concatenate([c.upper for c in phase.controls])
        x, costate = ca.MX.sym("x", self.size), ca.MX.sym("costate", self.size)
        u, time = ca.MX.sym("u", self.lower.size), ca.MX.sym("time")
        self.arguments = [x, costate, u, time]
        slopes = ca.vertcat(*(phase.derivatives[s.name] for s in phase.states))
        running = sum(phase.running_costs, ca.MX(0.0))
        f, running = self.declared([slopes, running], x, u, time)
        hamiltonian = running + ca.dot(costate, f)
        # The Hessian of H in u must vanish: otherwise a free control is regular, not singular.
        if not ca.is_linear(hamiltonian, u):
            raise NotPossibleError("the Hamiltonian is not affine in the controls")
        # Canonical equations: dx/dt = dH/dlambda = f, dlambda/dt = -dH/dx.
        self.f, self.slope = f, -ca.gradient(hamiltonian, x)
        self.switching = ca.gradient(hamiltonian, u)
        along = [f, self.slope, running, hamiltonian, ca.densify(self.switching)]
        self.along = ca.Function("along", self.arguments, along)
        self.laws = [self._law(arc) for arc in plan.arcs]
        self.near = [self._nearby(arc) for arc in plan.arcs]
        # Switching functions are compared with their largest magnitudes [m] on the given solution.
        self.sizes = _largest(_values(self.along, *values)[-1] for values in self.near)
        for law, values in zip(self.laws, self.near, strict=True):
            if law.free is not None:
                # The arc is of first order only if B does not vanish, compared with H_u over time
                # squared.
                size = self.sizes[law.free] / plan.duration**2
                if not np.abs(_values(law.terms, *values)[-1]).max() > ROUNDING * size:
                    raise NotPossibleError(
                        "a singular control does not appear in the second time derivative of its "
                        "switching function"
                    )

    def declared(
        self, expressions: Sequence[ca.MX], x: ca.MX, u: ca.MX, time: ca.MX
    ) -> list[ca.MX]:
        """Return declared expressions in the symbols of the canonical equations."""
        phase = self.plan.declared
        symbols = [v.symbol for v in (*phase.states, *phase.controls)]
        symbols += [phase.time, phase.duration, *(p.symbol for p in phase.parameters)]
        run = ca.Function("declared", symbols, list(expressions))
        values = [x[part] for part in self.state_parts.values()]
        values += [u[part] for part in self.control_parts.values()]
        # Only end expressions contain the duration, which equals the time there.
        return run.call([*values, time, time, *(p.value for p in phase.parameters)], True, False)

    def _law(self, arc: PlannedArc) -> _ArcLaw:
        x, costate, u, time = self.arguments
        sides = np.array(arc.signature[: self.lower.size])
        held = np.where(sides > 0, self.upper, self.lower)
        free = np.flatnonzero((sides == 0) & (self.lower < self.upper)).tolist()
        inputs = [x, costate, time]
        if not free:
            none = ca.Function("none", self.arguments, [ca.MX(0.0)] * 3)
            return _ArcLaw(None, none, ca.Function("controls", inputs, [ca.MX(held)]))
        if len(free) > 1:
            raise NotPossibleError("more than one control is singular at a time")
        singular = free[0]
        # A is the second derivative at a singular control of zero, B its derivative by that
        # control.
        held[singular] = 0.0
        # H_u has no explicit u, and its first derivative cancels u analytically for one control,
        # but not in the expression graph: substitute the control to remove it.
        rest = ca.DM(held)

        def rate(e: ca.MX) -> ca.MX:
            # Total time derivative along the canonical equations.
            along = ca.jtimes(e, x, self.f) + ca.jtimes(e, costate, self.slope)
            return along + ca.jtimes(e, time, ca.MX(1.0))

        first = ca.substitute(rate(self.switching[singular]), u, rest)
        second = rate(first)
        factor = ca.jacobian(second, u)[singular]
        terms = [ca.substitute(e, u, rest) for e in (first, second, factor)]
        controls = ca.MX(held)
        controls[singular] = -terms[1] / terms[2]
        run = ca.Function("terms", self.arguments, terms)
        return _ArcLaw(singular, run, ca.Function("controls", inputs, [controls]))

    def _nearby(self, arc: PlannedArc) -> list[FloatArray]:
        """Return states, costates, controls and times along an arc of the given solution."""
        t = self.plan.duration * np.linspace(arc.begin, arc.end, TIMES_CHECKED)
        values, costates = self.plan.sample(t), self.costates(t)
        x = np.hstack([values[name] for name in self.state_parts]).T
        costate = np.hstack([costates[name] for name in self.state_parts]).T
        u = np.hstack([values[name] for name in self.control_parts]).T
        return [x, costate, u, t[None, :]]

    # the problem ----------------------------------------------------------------------------------

    def _problem(self) -> OptimalControlProblem:
        conditions = OptimalControlProblem("conditions of first order")
        before: Phase | None = None
        for index, law in enumerate(self.laws):
            first, last = index == 0, index == len(self.laws) - 1
            name = f"{self.plan.declared.name} {index + 1}"
            reach = self.plan.duration
            phase = conditions.phase(name, (SHORTEST_ARC * reach, LONGEST_ARC * reach))
            x, costate = self._moving(phase, first, last)
            # Time and cost are states: each arc continues them from the one before.
            clock = phase.state(CLOCK, initial=0.0 if first else None)
            cost = phase.state(COST, initial=0.0 if first else None)
            u = law.controls(x, costate, clock)
            slopes = self.along.call([x, costate, u, clock], True, False)
            symbols = {v.name: v.symbol for v in phase.states}
            for state, part in self.state_parts.items():
                phase.derivative(symbols[state], slopes[0][part])
                phase.derivative(symbols[COSTATE + state], slopes[1][part])
            phase.derivative(cost, slopes[2])
            phase.derivative(clock, ca.MX(1.0))
            self._switch(phase, index, [x, costate, u, clock], slopes[-1])
            if last:
                self._end(phase, x, costate, clock, slopes[3])
            if before is not None:
                names = [s.name for s in before.states]
                conditions.link(before, phase, names)
            before = phase
        return conditions

    def _moving(self, phase: Phase, first: bool, last: bool) -> tuple[ca.MX, ca.MX]:
        """Declare states and costates, with their conditions at start and end."""
        x, costates = [], []
        for s in self.plan.declared.states:
            scale = s.scale if s.scaled else None
            x.append(phase.state(s.name, s.size, scale=scale, unit=s.unit))
            costates.append(phase.state(COSTATE + s.name, s.size))
            if first:
                fixed, values = self._at_end(s, s.initial, 0.0)
                for i in range(s.size):  # the costate of a free initial state is zero
                    here = x[-1][i] - values[i] if fixed[i] else costates[-1][i]
                    phase.point_constraint(f"start of {s.name}[{i}]", here, 0.0, 0.0, at=0.0)
            if last:
                fixed, values = self._at_end(s, s.final, self.plan.duration)
                for i in np.flatnonzero(fixed).tolist():
                    phase.end_constraint(f"end of {s.name}[{i}]", x[-1][i] - values[i], 0.0, 0.0)
        return ca.vertcat(*x), ca.vertcat(*costates)

    def _at_end(self, state: Variable, given: Any, time: float) -> tuple[np.ndarray, FloatArray]:
        """Return a mask of the components that are fixed at an end, and their values."""
        if given is None:
            return np.zeros(state.size, dtype=bool), np.zeros(state.size)
        value = self.plan.sample(np.array([time]))[state.name][0]
        low, high = given
        return _at_bound(value, low, high, state.scale)

    def _switch(self, phase: Phase, index: int, values: list[ca.MX], switching: ca.MX) -> None:
        """Add squares of the switching functions that must vanish where an arc ends to the cost.

        If the motion begins or ends with a singular arc, one of these conditions follows from the
        end conditions: as equations, they would be one too many.
        """
        reach, law = self.plan.duration, self.laws[index]
        if law.free is not None:
            size = float(self.sizes[law.free])
            phase.end_cost((switching[law.free] / size) ** 2)
            first = law.terms.call(values, True, False)[0]
            phase.end_cost((first * reach / size) ** 2)
        both = self.plan.signatures[index : index + 2]  # the last arc has no successor: no pairs
        for i, sides in enumerate(itertools.islice(zip(*both, strict=True), self.lower.size)):
            # A jump between the bounds of a control needs H_u = 0 at the junction.
            if min(sides) * max(sides) < 0:
                phase.end_cost((switching[i] / float(self.sizes[i])) ** 2)

    def _end(
        self, phase: Phase, x: ca.MX, costate: ca.MX, clock: ca.MX, hamiltonian: ca.MX
    ) -> None:
        """Declare the transversality conditions at the end.

        With multipliers nu of the active end conditions psi and end cost phi, costates are
        ``lambda = d/dx (phi + nu' psi)`` for free end states and, for a free duration,
        ``H + d/dt (phi + nu' psi) = 0`` (Bryson and Ho, sections 2.7 and 2.8).
        """
        near, declared = self.plan, self.plan.declared
        there, time = ca.MX.sym("there", self.size), ca.MX.sym("time")
        none = ca.MX.zeros(self.lower.size)
        fixed_states = [self._at_end(s, s.final, near.duration)[0] for s in declared.states]
        # Active end constraints hold with equality, with constant multipliers nu ("prices") as
        # states.
        rows: list[ca.MX] = []
        at_end = near.sample(np.array([near.duration]))
        value = np.concatenate([at_end[s.name][0] for s in declared.states])
        for constraint in declared.end_constraints:
            expression = self.declared([constraint.expression], there, none, time)[0]
            run = ca.Function("end", [there, time], [expression])
            reached = np.array(run(value, near.duration)).ravel()
            fixed, values = _at_bound(reached, constraint.lower, constraint.upper, constraint.scale)
            rows += [expression[i] - values[i] for i in np.flatnonzero(fixed).tolist()]
        prices = ca.MX.sym("prices", len(rows))
        worth = self.declared([sum(declared.end_costs, ca.MX(0.0))], there, none, time)[0]
        whole = worth + ca.dot(prices, ca.vertcat(*rows)) if rows else worth
        self.worth = ca.Function("worth", [there, time], [worth])
        slopes = [ca.gradient(whole, there), ca.gradient(whole, time), ca.vertcat(*rows)]
        run = ca.Function("end", [there, time, prices], slopes)
        end_prices = phase.state("prices of the end", len(rows)) if rows else ca.MX(0, 1)
        by_state, by_time, missed = run.call([x, clock, end_prices], True, False)
        if rows:
            phase.derivative(end_prices, ca.MX.zeros(len(rows)))
            phase.end_constraint("end", missed, 0.0, 0.0)
        price = costate - by_state
        for i in np.flatnonzero(~np.concatenate(fixed_states)).tolist():
            phase.end_constraint(f"transversality {i}", price[i], 0.0, 0.0)
        # A fixed duration replaces the transversality condition of time.
        low, high = declared.duration_bounds
        bounds = np.array([low]), np.array([high])
        fixed, values = _at_bound(np.array([near.duration]), *bounds, np.array([near.duration]))
        if fixed[0]:
            phase.end_constraint("duration", clock - values[0], 0.0, 0.0)
        else:
            phase.end_constraint("transversality of time", hamiltonian + by_time, 0.0, 0.0)

    def _guesses(self) -> dict[str, Guess]:
        guesses, cost = {}, 0.0
        for index, (x, costate, u, time) in enumerate(self.near):
            t = time[0]
            values = {CLOCK: t[:, None]}
            for name, part in self.state_parts.items():
                values[name], values[COSTATE + name] = x[part].T, costate[part].T
            running = _values(self.along, x, costate, u, time)[2][0]
            steps = (running[1:] + running[:-1]) / 2 * np.diff(t)
            values[COST] = np.append(cost, cost + np.cumsum(steps))[:, None]
            cost = float(values[COST][-1, 0])
            curves = {key: partial(interpolate, table) for key, table in values.items()}
            name = f"{self.plan.declared.name} {index + 1}"
            guesses[name] = Guess(float(t[-1] - t[0]), curves)
        return guesses

    # its solution ---------------------------------------------------------------------------------

    def solved(self, accuracy: float) -> SingularArcs:
        problem, guesses = self._problem(), self._guesses()
        transcription = Transcription(scaled(problem, guesses), scheme=HIGH_ORDER)
        meshes: list[MeshLike] = [max(arc.intervals, LEAST_INTERVALS) for arc in self.plan.arcs]
        # Refine until the canonical equations are accurate: the costs vanish at a solution, so only
        # the discretisation limits the accuracy of the lengths.
        start: dict[str, Guess] = guesses
        for _ in range(MOST_ROUNDS):
            if deadline.over():
                raise NotPossibleError("the time limit is reached")
            solution = SolveContext(transcription, SETTINGS).solve(meshes, start)
            if solution.status not in (Status.SOLVED, Status.GAP_LEFT):
                raise NotPossibleError(f"their solve failed: {solution.status}")
            errors = state_errors(solution)
            error = max(float(e.max()) for e in errors)
            if error <= accuracy:
                return self._accepted(solution, error)
            pairs = zip(solution.phases, errors, strict=True)
            meshes = [divide_phase(phase, of_phase, accuracy) for phase, of_phase in pairs]
            start = guess_from(problem, solution)
        raise NotPossibleError(f"the canonical equations hold to {error:.1e} only")

    def _accepted(self, solution: Solution, error: float) -> SingularArcs:
        near = self.plan
        lengths = np.array([phase.duration for phase in solution.phases])
        # An arc at its least length has vanished: the structure is another one.
        if lengths.min() <= VANISHED_ARC * near.duration:
            raise NotPossibleError("an arc has no length")
        pairs = list(zip(solution.phases, self.laws, strict=True))
        tables = [
            self._stacked(phase.sample(np.linspace(0.0, phase.duration, TIMES_CHECKED)), law)
            for phase, law in pairs
        ]
        self._check_limits(tables)
        switching = [_values(self.along, *table)[-1] for table in tables]
        largest = _largest(switching)
        sides = [np.array(signature[: self.lower.size]) for signature in near.signatures]
        vanishing, kelley = 0.0, -np.inf
        for index, (law, along) in enumerate(zip(self.laws, switching, strict=True)):
            # Pontryagin: side 1 requires H_u <= 0, side -1 requires H_u >= 0.
            against = (sides[index][:, None] * along).max(axis=1) / largest
            if against.max() > BOUND_MARGIN:
                raise NotPossibleError(
                    "a switching function of a control at a bound has the wrong sign"
                )
            if law.free is not None:
                # Along a singular arc H_u vanishes, and Kelley's condition B <= 0 must hold.
                vanishing = max(vanishing, np.abs(along[law.free]).max() / largest[law.free])
                kelley = max(kelley, float(_values(law.terms, *tables[index])[-1].max()))
            if index + 1 < len(tables):
                # H_u also vanishes at the end of an arc where the control jumps between its bounds.
                switches = sides[index] * sides[index + 1] < 0
                jumps = np.abs(along[:, -1]) / largest
                vanishing = max(vanishing, float(jumps[switches].max(initial=0.0)))
        if vanishing > ROUNDING:
            raise NotPossibleError(
                f"a switching function comes to {vanishing:.1e} of its largest value where it must "
                "vanish"
            )
        if kelley >= 0.0:
            raise NotPossibleError("Kelley's condition does not hold: the arc is no minimum")
        last = solution.phases[-1]
        states = np.concatenate([last.values[s.name][-1] for s in near.declared.states])
        worth = float(self.worth(states, last.values[CLOCK][-1, 0]))
        cost = float(last.values[COST][-1, 0]) + worth
        # A root of the conditions far from the given cost belongs to another extremal.
        other = self.solution
        if not abs(cost - other.cost) <= AGREEING_COST * cost_size(other.cost, other.cost_scale):
            raise NotPossibleError(
                f"their cost is {cost:.10g}, that of the nearby solution {other.cost:.10g}"
            )
        samples = tuple(self._sample(*pair) for pair in pairs)
        return SingularArcs(solution, cost, lengths, kelley, float(vanishing), error, samples)

    def _stacked(self, values: dict[str, FloatArray], law: _ArcLaw) -> list[FloatArray]:
        """Return stacked states, costates, controls and times [*, M] of sampled values."""
        x = np.hstack([values[name] for name in self.state_parts]).T
        costate = np.hstack([values[COSTATE + name] for name in self.state_parts]).T
        time = values[CLOCK].T
        return [x, costate, _values(law.controls, x, costate, time)[0], time]

    def _sample(self, phase: PhaseSolution, law: _ArcLaw) -> Sample:
        def sample(t: FloatArray) -> dict[str, FloatArray]:
            values = phase.sample(t)
            u = self._stacked(values, law)[2].T
            return values | {name: u[:, part] for name, part in self.control_parts.items()}

        return sample

    def _check_limits(self, tables: Sequence[Sequence[FloatArray]]) -> None:
        """Raise NotPossibleError if a limit of a state, control or path constraint is exceeded."""
        phase = self.plan.declared
        limits = [*phase.states, *phase.controls, *phase.constraints]
        x, _, u, time = self.arguments
        # The boundary value problem contains no limits, so they are checked afterwards.
        expressions = self.declared([k.expression for k in limits], x, u, time)
        expressions = [ca.densify(e) for e in expressions]
        run = ca.Function("limited", self.arguments, expressions)
        of_arcs = [_values(run, *table) for table in tables]
        for limit, *arcs in zip(limits, *of_arcs, strict=True):
            values = np.hstack(arcs)
            reach = limit.upper - limit.lower
            reach = np.where(np.isfinite(reach), reach, np.ptp(values, axis=1) + limit.scale)
            excess = np.maximum(values.max(axis=1) - limit.upper, limit.lower - values.min(axis=1))
            size = np.maximum(reach, BOUND_MARGIN * limit.scale)
            if np.any(excess > BOUND_MARGIN * size):
                raise NotPossibleError(f"{limit.name!r} is beyond its limit along an arc")


def _largest(tables: Iterable[FloatArray]) -> FloatArray:
    """Return the largest magnitude in every row over all tables."""
    return np.maximum.reduce([np.abs(table).max(axis=1) for table in tables])


def _values(run: ca.Function, *tables: FloatArray) -> list[FloatArray]:
    return [np.array(value) for value in run.map(tables[0].shape[1]).call(list(tables))]


def _parts(variables: Sequence[Variable]) -> dict[str, slice]:
    """Return the rows of every variable in a stacked table."""
    edges = np.cumsum([0, *(v.size for v in variables)]).tolist()
    pairs = zip(variables, itertools.pairwise(edges), strict=True)
    return {v.name: slice(*ends) for v, ends in pairs}


def _at_bound(
    values: FloatArray, lower: FloatArray, upper: FloatArray, scale: FloatArray
) -> tuple[np.ndarray, FloatArray]:
    """Return a mask of the values that are at a bound, and those bounds."""
    reach = upper - lower
    near = BOUND_MARGIN * np.where(np.isfinite(reach), reach, scale)
    at_lower, at_upper = values <= lower + near, values >= upper - near
    return at_lower | at_upper, np.where(at_lower, lower, np.where(at_upper, upper, values))
