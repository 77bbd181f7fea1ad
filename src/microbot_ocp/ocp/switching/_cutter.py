"""A problem with one phase of free length per arc.

On an arc every control component is at a bound or free, and every limit is active or inactive. With
one phase per arc, of free duration and with controls held at their bounds, the junctions become
unknowns of the problem. A limit that is active on an arc holds with equality at both of its ends.
Source: J. T. Betts, *Practical Methods for Optimal Control and Estimation*, 2nd ed., chapter 4.

Active limits determine the controls: a limit that depends on controls becomes an equation. For a
limit of the states, its lowest time derivative that contains a control becomes the equation, and
all lower ones hold where the arc begins (A. E. Bryson and Y.-C. Ho, *Applied Optimal Control*,
section 3.11). Continuous controls are left free.
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.ocp.arcs import Activity, ArcPlan, PlannedArc, jumping
from microbot_ocp.ocp.problem import (
    OptimalControlProblem,
    PathConstraint,
    Phase,
    PhaseLink,
    PointConstraint,
    Variable,
    node_variables,
)
from microbot_ocp.ocp.transcription import Guess
from microbot_ocp.ocp.transcription.schemes import Collocation

HIGH_ORDER = Collocation("radau", 5)  # scheme of an arc, which is smooth; of order 9
SHORTEST_ARC = 1e-4  # least length of an arc, as a fraction of its phase
VANISHED_ARC = 2 * SHORTEST_ARC  # length at which an arc is removed, likewise
LONGEST_ARC = 3.0  # largest length of an arc, as a multiple of the duration of its phase
HIGHEST_ORDER = 3  # time derivatives of a state limit that are searched for a control
# Widening of a bound beside an arc where an equation holds it, and distance at which a bound still
# counts as reached or kept, relative to its range.
BOUND_MARGIN = 1e-6

Key = tuple[str, int]  # name and component of a limit


@dataclass(frozen=True, eq=False)
class ArcConditions:
    """Equations by which active limits determine an arc.

    Attributes
    ----------
    along : equations at all points of the arc
    entry : equations where the arc begins, imposed at the end of the previous arc, by limit
    """

    along: tuple[PathConstraint, ...] = ()
    entry: Mapping[Key, Sequence[PathConstraint]] = field(default_factory=dict)

    @property
    def replaced(self) -> frozenset[Key]:
        """Names and components of the limits that the equations replace."""
        return frozenset(self.entry)

    def entered(self, before: ArcConditions) -> list[PathConstraint]:
        """Return entry equations of limits that were not active on the arc before."""
        return [c for key, entry in self.entry.items() if key not in before.replaced for c in entry]


@dataclass(frozen=True, eq=False)
class CutProblem:
    """A problem in arcs: the arcs of every phase, their initial guesses and meshes."""

    problem: OptimalControlProblem
    groups: tuple[tuple[Phase, ...], ...]
    guesses: Mapping[str, Guess]
    meshes: tuple[int, ...]


def is_cuttable(declared: Phase) -> bool:
    """Return True if no expression along a phase depends on its duration or on inner points."""
    points = [*declared.point_constraints, *declared.point_costs]
    if any(len(k.fractions) > 1 for k in points) or declared.point_fractions:
        return False
    along = [*declared.derivatives.values(), *declared.running_costs]
    along += [*declared.algebraic_equations, *(c.expression for c in declared.constraints)]
    along += [k.expression for k in points if k.fractions[0] == 0.0]
    return not any(ca.depends_on(e, declared.duration) for e in along)


def cut(problem: OptimalControlProblem, plans: Sequence[ArcPlan]) -> CutProblem:
    """Return the problem with one phase per arc and a clock that runs through all arcs."""
    whole = OptimalControlProblem(f"{problem.name} in arcs")
    arcs = [(plan, arc) for plan in plans for arc in plan.arcs]
    held = [_conditions_on(*pair, start=k == 0) for k, pair in enumerate(arcs)]
    # Every arc also needs the conditions of both neighbours: pad the ends with empty ones.
    conditions = [ArcConditions(), *held, ArcConditions()]
    groups: list[tuple[Phase, ...]] = []
    guesses: dict[str, Guess] = {}
    for plan in plans:
        cutter = _ArcPhases(plan, conditions[len(whole.phases) :])
        pieces = [cutter.piece(index) for index in range(len(plan.arcs))]
        groups.append(tuple(phase for phase, _ in pieces))
        guesses |= {phase.name: guess for phase, guess in pieces}
        whole.phases += groups[-1]
    whole.links = list(_links(problem, groups))
    meshes = tuple(arc.intervals for _, arc in arcs)
    return CutProblem(whole, tuple(groups), guesses, meshes)


def _links(
    problem: OptimalControlProblem, groups: Sequence[Sequence[Phase]]
) -> Iterator[PhaseLink]:
    for index, pieces in enumerate(groups):
        for before, after in itertools.pairwise(pieces):
            names = tuple(v.name for v in node_variables(before))
            yield PhaseLink(before.name, after.name, names)
        if index + 1 < len(groups):
            yield PhaseLink(pieces[-1].name, groups[index + 1][0].name, problem.links[index].names)


class _ArcPhases:
    """Builder of the arcs of one phase from their conditions and those of their neighbours."""

    def __init__(self, plan: ArcPlan, conditions: Sequence[ArcConditions]) -> None:
        self.plan, self.declared = plan, plan.declared
        self.conditions = conditions
        self.clock = _clock(plan.declared, plan.duration)

    def timed(self, expression: ca.MX) -> ca.MX:
        """Return an expression with the clock in place of the phase time."""
        return ca.substitute(expression, self.declared.time, self.clock.symbol)

    def final(self, expression: ca.MX) -> ca.MX:
        """Return an expression at the end, with the clock in place of time and duration."""
        return ca.substitute(self.timed(expression), self.declared.duration, self.clock.symbol)

    def piece(self, index: int) -> tuple[Phase, Guess]:
        """Return the phase and the initial guess of an arc."""
        declared, timed, final = self.declared, self.timed, self.final
        arc, (before, here, after) = self.plan.arcs[index], self.conditions[index : index + 3]
        first, last = index == 0, index + 1 == len(self.plan.arcs)
        piece = copy.copy(declared)
        piece.name = f"{declared.name} {index + 1}"
        if not (first and last):
            # A positive least length keeps the program regular: an arc at that length has vanished.
            duration = self.plan.duration
            piece.duration_bounds = (SHORTEST_ARC * duration, LONGEST_ARC * duration)
        # Next to an arc on which an equation replaces a bound, the bound is met at the junction.
        beside = before.replaced | after.replaced
        low, high = declared.duration_bounds
        clock = replace(
            self.clock,
            initial=(np.zeros(1), np.zeros(1)) if first else None,
            final=(np.array([low]), np.array([high])) if last else None,
        )
        # The clock replaces the phase time; its final value carries the bounds of the duration.
        states = [_inside(s, first, last) for s in declared.states]
        piece.states = [*(_without_bounds(s, here.replaced, beside) for s in states), clock]
        piece.derivatives = {name: timed(e) for name, e in declared.derivatives.items()}
        piece.derivatives[clock.name] = ca.MX(1.0)
        piece.controls = self._controls(arc, first, last)
        piece.running_costs = [timed(e) for e in declared.running_costs]
        piece.algebraic_equations = [timed(e) for e in declared.algebraic_equations]
        limits = [_without_bounds(c, here.replaced, beside) for c in declared.constraints]
        piece.constraints = _mapped(timed, [*limits, *here.along])
        # Conditions at the end of the phase belong to its last arc. All other arcs end with the
        # entry equations of the next arc and with the limits that change there.
        piece.end_costs = [final(e) for e in declared.end_costs] if last else []
        piece.end_constraints = (
            _mapped(final, declared.end_constraints)
            if last
            else _mapped(timed, after.entered(here)) + self._met(index)
        )
        # Point items lie at the ends of the phase only: inner points are excluded by is_cuttable.
        ends = [place for place, here_too in ((0.0, first), (1.0, last)) if here_too]
        for kind in ("point_constraints", "point_costs"):
            chosen = [k for k in getattr(declared, kind) if k.fractions[0] in ends]
            setattr(piece, kind, _mapped(final, chosen))
        if first:
            entered = _mapped(timed, here.entered(before))
            piece.point_constraints += [PointConstraint.of(k, 0.0) for k in entered]
        piece.interior_points = None  # default: the scheme's points, at which controls have values
        return piece, self._guess(arc)

    def _controls(self, arc: PlannedArc, first: bool, last: bool) -> list[Variable]:
        """Return controls held at their bounds where active, else polynomial; linear ones stay."""
        controls, offset = [], 0
        for control in self.declared.controls:
            if control.shape == "linear":
                controls.append(_inside(control, first, last))
                continue
            sides = np.array(arc.signature[offset : offset + control.size])
            offset += control.size
            lower = np.where(sides > 0, control.upper, control.lower)
            upper = np.where(sides < 0, control.lower, control.upper)
            free = control.shape == "constant" and np.any(lower < upper)
            shape = "polynomial" if free else control.shape
            controls.append(replace(control, lower=lower, upper=upper, shape=shape))
        return controls

    def _met(self, index: int) -> list[PathConstraint]:
        """Return state limits that change after an arc as equations, if none replaces them yet."""
        keeping = self.conditions[index + 1].replaced | self.conditions[index + 2].replaced
        pair = self.plan.arcs[index].signature, self.plan.arcs[index + 1].signature
        return [
            column.limit.met(side)
            for column, sides in zip(self.plan.columns, zip(*pair, strict=True), strict=True)
            if column.limit is not None and column.of_states and sides[0] != sides[1]
            if (column.name, column.component) not in keeping
            for side in sides
            if side
        ]

    def _guess(self, arc: PlannedArc) -> Guess:
        declared, duration, sample = self.declared, self.plan.duration, self.plan.sample
        variables = (*node_variables(declared), *declared.controls, *declared.algebraics)
        length = arc.end - arc.begin

        def along(name: str) -> Callable[[FloatArray], FloatArray]:
            return lambda s: sample((arc.begin + s * length) * duration)[name]

        values: dict[str, Any] = {name: along(name) for name in {v.name: v for v in variables}}
        values[self.clock.name] = lambda s: (arc.begin + s * length)[:, None] * duration
        return Guess(length * duration, values)


def _mapped(change: Callable[[ca.MX], ca.MX], items: Sequence[Any]) -> list[Any]:
    """Return constraints or costs with changed expressions."""
    return [replace(item, expression=change(item.expression)) for item in items]


def _without_bounds(limited: Any, keeping: frozenset[Key], beside: frozenset[Key]) -> Any:
    """Return a state or path constraint without the bounds that equations on an arc replace.

    Next to such an arc the bound holds with equality at the junction. It is loosened slightly:
    a bound and an equation with one value would have undetermined multipliers.
    """
    low, high = limited.lower.copy(), limited.upper.copy()
    for i in (i for name, i in beside if name == limited.name):
        range_ = high[i] - low[i]
        margin = BOUND_MARGIN * (range_ if np.isfinite(range_) else limited.scale[i])
        low[i], high[i] = low[i] - margin, high[i] + margin
    rows = [i for name, i in keeping if name == limited.name]
    low[rows], high[rows] = -np.inf, np.inf
    return replace(limited, lower=low, upper=high)


def _conditions_on(plan: ArcPlan, arc: PlannedArc, *, start: bool) -> ArcConditions:
    """Return equations of the limits active on an arc, at most one per free control."""
    sides = dict(zip(plan.columns, arc.signature, strict=True))
    # Each equation determines one free control; without a free control it would be redundant.
    free = plan.controls - sum(side != 0 for column, side in sides.items() if column.limit is None)
    along: list[PathConstraint] = []
    entry: dict[Key, Sequence[PathConstraint]] = {}
    for column, side in sides.items():
        if column.limit is None or not side or free <= 0:
            continue
        chain = _derivatives(plan.declared, column, side)
        # A given initial state need not satisfy the lower derivatives of a limit.
        if not chain or (start and len(chain) > 1):
            continue
        along.append(chain[-1])
        entry[column.name, column.component] = chain[:-1]
        free -= 1
    return ArcConditions(tuple(along), entry)


def _derivatives(declared: Phase, activity: Activity, side: int) -> list[PathConstraint]:
    """Return an active limit and its time derivatives up to the first that contains a control.

    Empty if that derivative is of a higher order than ``HIGHEST_ORDER``. With the states x
    and their derivatives f, ``d/dt g = (dg/dx) f`` as long as g contains no control.
    """
    assert activity.limit is not None
    met = activity.limit.met(side)
    chain, value = [met], met.expression
    if activity.limit.mixed:
        return chain
    x = ca.vertcat(*(s.symbol for s in declared.states))
    slope = ca.vertcat(*(declared.derivatives[s.name] for s in declared.states))
    zero = np.zeros(1)
    for order in range(1, HIGHEST_ORDER + 1):
        # d/dt g(x) = (dg/dx) f(x, u) as long as g contains no control.
        value = ca.jtimes(value, x, slope)
        name = f"{met.name}, derivative {order}"
        chain.append(replace(met, name=name, expression=value, lower=zero, upper=zero))
        if any(ca.depends_on(value, c.symbol) for c in jumping(declared)):
            return chain
    return []


def _clock(phase: Phase, duration: float) -> Variable:
    name = "elapsed time"
    while name in {v.name for v in phase.variables}:
        name += "'"
    free, symbol = np.full(1, np.inf), ca.MX.sym(f"{phase.name}.{name}")
    return Variable(name, symbol, -free, free, np.array([duration]), "s", shape="state")


def _inside(variable: Variable, first: bool, last: bool) -> Variable:
    """Return a variable with its end conditions at the ends of the whole phase only."""
    initial, final = variable.initial if first else None, variable.final if last else None
    return replace(variable, initial=initial, final=final)
