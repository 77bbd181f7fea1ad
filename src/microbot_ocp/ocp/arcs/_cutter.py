"""Where arcs of a solution meet, to the accuracy of the solver: every arc as a phase of its own.

On an arc every control component is at one bound or free, and every limit of the states acts or
does not. Between mesh points nothing says where an arc begins. Solved again with one phase an arc,
of free duration and with its controls held at their bounds, the problem has its junctions among its
unknowns. A limit that acts on an arc is met at both of its ends. Source: J. T. Betts, *Practical
Methods for Optimal Control and Estimation*, 2nd ed., chapter 4.

Continuous controls are left free. Limits that depend on controls are looked at where the arcs are
the answer (``_switching_times.py``), not where they only place mesh points.
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.status import Status
from microbot_ocp.ocp.arcs._switches import AT_BOUND, BRACKET, interval_values
from microbot_ocp.ocp.problem import (
    OptimalControlProblem,
    PathConstraint,
    Phase,
    PhaseLink,
    PointConstraint,
    Variable,
    node_variables,
)
from microbot_ocp.ocp.solution import PhaseSolution, Solution
from microbot_ocp.ocp.solvers import SolverSettings, solve
from microbot_ocp.ocp.transcription import Guess, Mesh
from microbot_ocp.ocp.transcription.schemes import Collocation, Scheme
from microbot_ocp.ocp.verification import phase_layout

ACTS = 3e-3  # of a state's range along the phase: nearer to a limit at both ends, it acts
SHORTEST = 2  # intervals of an arc: what is shorter is the smeared end of two others
MOST_ARCS = 12  # of a phase: a solution that chatters is not cut into pieces
SHORTEST_DURATION = 1e-4  # of the phase, that an arc may shrink to
LEAST_INTERVALS = 4  # of an arc's own mesh
LOOSER = 1e-6  # of its range: a bound beside an arc on which it is kept by an equation
AT_START = " at the start"  # of an arc: names of controls there
HIGHEST_ORDER = 3  # of a limit of the states whose derivative determines a control
MIXED = 2e-3  # of its range: nearer to a limit that depends on controls it acts
INSIDE = np.array([0.1, 0.5, 0.9])  # of an interval at which they are, without collocation points
WEIGHTS = np.array([25.0, 46.0, 25.0]) / 96  # of the mean of a parabola by its values there
WORSE = 1e-6  # share by which arcs may cost more than the solution that they come from


@dataclass(frozen=True, eq=False)
class Limit:
    """A limit of the states alone, and where it acts: 1 at its upper side, -1 at its lower one."""

    constraint: PathConstraint
    component: int
    sides: np.ndarray  # of the intervals [N]
    mixed: bool = False  # whether it depends on controls
    shares: FloatArray | None = None  # mean in every interval, from -1 at the lower side to 1

    def values(self, phase: PhaseSolution, declared: Phase) -> FloatArray:
        """Of a limit of the states alone at the mesh points [N+1]."""
        states = [v for v in declared.states if v.name in phase.values]
        value = ca.Function("value", [v.symbol for v in states], [self.constraint.expression])
        return np.array(value(*(phase.values[v.name].T for v in states)))[self.component]

    def touched(self, values: FloatArray, near: float) -> np.ndarray:
        """Sides to which values [N+1] come so near, at every one."""
        low, high = self.constraint.lower[self.component], self.constraint.upper[self.component]
        return (values >= high - near).astype(int) - (values <= low + near).astype(int)

    def met(self, side: int) -> PathConstraint:
        """The limit as an equation."""
        own, i = self.constraint, self.component
        value = (own.lower if side < 0 else own.upper)[i : i + 1]
        return PathConstraint(
            f"{own.name}[{i}] met", own.expression[i], value, value, own.scale[i : i + 1], own.unit
        )


@dataclass(frozen=True, eq=False)
class _Arc:
    """Intervals ``first`` to ``last`` of a phase, and what they have in common."""

    first: int
    last: int
    signature: tuple[int, ...]  # of all control components, then of all limits


@dataclass(frozen=True, eq=False)
class Stretch:
    """An arc as it is guessed: fractions of its phase, what acts, and its mesh."""

    begin: float
    end: float
    signature: tuple[int, ...]
    intervals: int


Sample = Callable[[FloatArray], dict[str, FloatArray]]  # of the times since the start of a phase


def place_junctions(
    problem: OptimalControlProblem,
    solution: Solution,
    scheme: Scheme,
    settings: SolverSettings,
) -> list[FloatArray] | None:
    """Where arcs meet, as fractions of every phase, by a solve with one phase an arc.

    None where there is nothing to place, where the problem cannot be cut (dynamics that depend on
    the duration of their phase), or where the solve fails or does not come as low.

    Raises
    ------
    KeyboardInterrupt
        The solve was interrupted.
    """
    found = [arcs_of(phase) for phase in solution.phases]
    if all(len(arcs) < 2 for arcs, _ in found):
        return None
    if any(len(arcs) > MOST_ARCS for arcs, _ in found):
        return None
    in_arcs = OptimalControlProblem(f"{problem.name} in arcs")
    guesses, meshes = {}, []
    groups: list[list[Phase]] = []
    for phase, (arcs, limits) in zip(solution.phases, found, strict=True):
        declared = phase_layout(phase).phase
        made = cut(declared, phase.duration, stretches(phase, arcs), limits, phase.sample)
        if made is None:
            return None
        own, own_guesses, own_meshes = made
        groups.append(own)
        in_arcs.phases += own
        guesses |= {piece.name: guess for piece, guess in zip(own, own_guesses, strict=True)}
        meshes += own_meshes
    in_arcs.links = links_between(problem, groups)
    solved = solve(in_arcs, meshes, guesses, replace(settings, solver="ipopt"), scheme=scheme)
    if solved.status is Status.INTERRUPTED:
        raise KeyboardInterrupt  # the solver kept it to itself
    converged = solved.status in (Status.SOLVED, Status.TOO_COARSE)  # it only places mesh points
    if not converged or solved.cost > solution.cost + WORSE * abs(solution.cost):
        return None
    return [
        _ends(phase_layout(phase).phase, [solved[piece.name] for piece in pieces])
        for phase, pieces in zip(solution.phases, groups, strict=True)
    ]


def _ends(declared: Phase, pieces: Sequence[PhaseSolution]) -> FloatArray:
    """Where the arcs of a phase end, and where something changes within them.

    Where a control was free to be at a bound, its arc may have taken a part of another one.
    """
    ends = np.cumsum([0.0, *(piece.duration for piece in pieces)])
    inner = []
    for begin, piece in zip(ends[:-1], pieces, strict=True):
        found, _ = arcs_of(piece, declared)
        inner += [begin + piece.t[arc.first] for arc in found[1:]]
    places = ends[1:-1]
    if len(inner) + places.size < MOST_ARCS:
        places = np.sort(np.append(places, inner))
    places = places / ends[-1]
    # an arc that shrank to nothing is none
    apart = np.diff(np.append(places, 1.0)) > 2 * SHORTEST_DURATION
    return places[apart & (places > 2 * SHORTEST_DURATION)]


def hold(mesh: FloatArray, places: FloatArray, accuracy: float) -> FloatArray:
    """Move the nearest free mesh point to every place, or add a point there.

    Where that is news, points on both sides keep the intervals at the place short: a rest of the
    other arc, be it ever so small, takes the multipliers of one of them.
    """
    points = mesh.copy()
    held: list[float] = []
    for place in np.unique(np.clip(places, 0.0, 1.0)).tolist():
        nearest = int(np.abs(points - place).argmin())
        own = float(points[nearest])
        gap = abs(own - place)
        at_end = own in (0.0, 1.0)
        if at_end and gap <= accuracy:
            continue
        if not at_end and own not in held:
            points = np.delete(points, nearest)
        before, after = points[points < place].max(), points[points > place].min()
        reach = BRACKET * min(place - before, after - place)
        sides = [place - reach, place + reach] if gap > accuracy and reach > accuracy else []
        points = np.sort(np.concatenate([points, [place], sides]))
        held.append(place)
    return points[np.concatenate([[True], np.diff(points) > 1e-9])]


def distance(mesh: FloatArray, places: FloatArray) -> float:
    """Largest distance of a place from the mesh."""
    gaps = np.abs(mesh[:, None] - places[None, :]).min(axis=0)
    return float(gaps.max(initial=0.0))


# arcs of a solution -------------------------------------------------------------------------------


def arcs_of(phase: PhaseSolution, declared: Phase | None = None) -> tuple[list[_Arc], list[Limit]]:
    """Arcs of a phase, and the limits of its states that act somewhere.

    Of a piece of a phase, with the declaration of the whole: arcs of its controls alone, however
    short.
    """
    whole, shortest = declared is None, SHORTEST if declared is None else 1
    declared = declared or phase_layout(phase).phase
    columns, _ = controls_at_bounds(phase, declared)
    limits = limits_of(phase, declared, mixed=False) if whole else []
    columns = [own[:, None] for own in (*columns, *(limit.sides for limit in limits))]
    if not columns or not np.any(np.hstack(columns)):
        return [], limits
    table = np.hstack(columns)
    edges = np.flatnonzero(np.any(np.diff(table, axis=0) != 0, axis=1)) + 1
    bounds = [0, *edges.tolist(), table.shape[0]]
    arcs: list[_Arc] = []
    for first, after in itertools.pairwise(bounds):
        signature = tuple(int(k) for k in table[first])
        if after - first < shortest:
            continue
        if arcs and arcs[-1].signature == signature:
            arcs[-1] = replace(arcs[-1], last=after - 1)
        else:
            arcs.append(_Arc(first, after - 1, signature))
    return arcs, limits


def controls_at_bounds(
    phase: PhaseSolution, declared: Phase
) -> tuple[list[np.ndarray], list[FloatArray | None]]:
    """Side [N] of every component that may jump, and its mean [N] from -1 to 1 where both exist."""
    sides: list[np.ndarray] = []
    shares: list[FloatArray | None] = []
    for control in _jumping(declared):
        values = interval_values(phase, control)
        near = AT_BOUND * (control.upper - control.lower)
        near = np.where(np.isfinite(near), near, AT_BOUND * control.scale)
        fixed = control.lower == control.upper
        upper = (values.least >= control.upper - near) & ~fixed
        lower = (values.largest <= control.lower + near) & ~fixed
        sides += list((upper.astype(int) - lower.astype(int)).T)
        for mean, low, high in zip(values.mean.T, control.lower, control.upper, strict=True):
            shares.append(_share(mean, float(low), float(high)))
    return sides, shares


def _share(mean: FloatArray, low: float, high: float) -> FloatArray | None:
    if not (np.isfinite(high - low) and low < high):
        return None
    return (2 * mean - high - low) / (high - low)


def limits_of(phase: PhaseSolution, declared: Phase, *, mixed: bool) -> list[Limit]:
    """Limits of the states that act somewhere, and those that depend on controls, too."""
    return _limits(phase, declared) + (_mixed_limits(phase, declared) if mixed else [])


def _jumping(phase: Phase) -> list[Variable]:
    """Controls that may jump at a mesh point."""
    return [c for c in phase.controls if c.shape != "linear"]


def _limits(phase: PhaseSolution, declared: Phase) -> list[Limit]:
    """Limits of the states alone, and the intervals on which they act."""
    others = [v.symbol for v in declared.variables if v not in declared.states]
    others += [c.rate for c in declared.controls if c.rate is not None]
    others += [declared.time, declared.duration, *(p.symbol for p in declared.parameters)]
    known = [
        PathConstraint(s.name, s.symbol, s.lower, s.upper, s.scale, s.unit) for s in declared.states
    ]
    known += [
        c
        for c in declared.constraints
        if not any(ca.depends_on(c.expression, symbol) for symbol in others)
    ]
    found = []
    for constraint in known:
        for i in range(constraint.lower.size):
            limit = Limit(constraint, i, np.zeros(phase.mesh.size - 1, dtype=int))
            row = limit.values(phase, declared)
            near = ACTS * float(np.ptp(row))
            sides = limit.touched(row, near)
            both = np.where(sides[:-1] == sides[1:], sides[1:], 0)
            low, high = float(constraint.lower[i]), float(constraint.upper[i])
            if near > 0 and low < high and np.any(sides):
                found.append(replace(limit, sides=both))
    return found


def _mixed_limits(phase: PhaseSolution, declared: Phase) -> list[Limit]:
    """Limits that depend on controls that may jump, and the intervals all along which they act."""
    jumping = [c.symbol for c in _jumping(declared)]
    own = [*declared.states, *declared.controls]
    others = [c.rate for c in declared.controls if c.rate is not None]
    others += [v.symbol for v in declared.variables if v not in own]
    chosen = [
        c
        for c in declared.constraints
        if any(ca.depends_on(c.expression, symbol) for symbol in jumping)
        and not any(ca.depends_on(c.expression, symbol) for symbol in others)
    ]
    if not chosen:
        return []
    steps = np.diff(phase.mesh)
    inside, weights = _places_inside(phase)
    # just before the end of an interval its own polynomial counts
    t = (phase.mesh[:-1, None] + (1 - 1e-9) * inside * steps[:, None]).ravel() * phase.duration
    known = phase.sample(t)
    variables = [*declared.states, *declared.controls]
    symbols = [*(v.symbol for v in variables), declared.time, declared.duration]
    symbols += [p.symbol for p in declared.parameters]
    tables = [
        *(known[v.name].T for v in variables),
        t[None, :],
        np.full((1, t.size), phase.duration),
    ]
    tables += [np.tile(p.value[:, None], (1, t.size)) for p in declared.parameters]
    found = []
    for constraint in chosen:
        run = ca.Function("value", symbols, [ca.densify(constraint.expression)]).map(t.size)
        for i, row in enumerate(np.array(run(*tables))):
            low, high = float(constraint.lower[i]), float(constraint.upper[i])
            near = MIXED * (high - low if np.isfinite(high - low) else float(np.ptp(row)))
            acts = (row >= high - near).astype(int) - (row <= low + near).astype(int)
            table = acts.reshape(steps.size, inside.size)
            sides = np.where(np.all(table == table[:, :1], axis=1), table[:, 0], 0)
            mean = row.reshape(steps.size, inside.size) @ weights
            if near > 0 and low < high and np.any(sides):
                share = _share(mean, low, high)
                found.append(Limit(constraint, i, sides, mixed=True, shares=share))
    return found


def _places_inside(phase: PhaseSolution) -> tuple[FloatArray, FloatArray]:
    """Places in an interval at which its limits are looked at, and weights of the mean."""
    kinds = phase_layout(phase).kinds
    scheme = kinds[0].scheme
    if len(kinds) == 1 and isinstance(scheme, Collocation):
        return np.array(scheme.points), scheme.weights
    return INSIDE, WEIGHTS


def stretches(phase: PhaseSolution, arcs: Sequence[_Arc]) -> list[Stretch]:
    """Arcs with junctions in the middle between those that meet there; without arcs all is one."""
    arcs = arcs or [_Arc(0, phase.mesh.size - 2, ())]
    edges = np.concatenate([[0.0], _guessed(phase, arcs), [1.0]])
    return [
        Stretch(float(a), float(b), arc.signature, max(arc.last - arc.first + 1, LEAST_INTERVALS))
        for arc, (a, b) in zip(arcs, itertools.pairwise(edges), strict=True)
    ]


def _guessed(phase: PhaseSolution, arcs: Sequence[_Arc]) -> FloatArray:
    """Junctions in the middle between the arcs that meet there."""
    return np.array(
        [
            (phase.mesh[before.last + 1] + phase.mesh[after.first]) / 2
            for before, after in itertools.pairwise(arcs)
        ]
    )


# the problem in arcs ------------------------------------------------------------------------------


def cut(
    declared: Phase,
    duration: float,
    arcs: Sequence[Stretch],
    limits: Sequence[Limit],
    sample: Sample,
    conditions: Sequence[Conditions] | None = None,
) -> tuple[list[Phase], list[Guess], list[Mesh]] | None:
    """A phase for every arc, with guesses and meshes; the clock goes on from one to the next.

    Parameters
    ----------
    declared, duration, sample : the phase, and the values that guesses are made of
    arcs : its arcs in turn
    limits : what their signatures say after all control components
    conditions : of the arc before the phase, of its own, and of the arc after it
        What acts on an arc determines it then: mixed limits are equations, limits of states act
        through the derivative that the controls appear in, and what is left free is polynomial.
    """
    along = [*declared.derivatives.values(), *declared.running_costs]
    along += [*declared.algebraic_equations, *(c.expression for c in declared.constraints)]
    points = [*declared.point_constraints, *declared.point_costs]
    if any(len(k.fractions) > 1 for k in points) or declared.point_fractions:
        return None
    along += [k.expression for k in points if k.fractions[0] == 0.0]
    if any(ca.depends_on(k, declared.duration) for k in along):
        return None
    clock = _clock(declared, duration)
    # what was written with the time of the phase gets that of the clock
    timed: Callable[[ca.MX], ca.MX] = lambda e: ca.substitute(e, declared.time, clock.symbol)  # noqa: E731
    final: Callable[[ca.MX], ca.MX] = lambda e: ca.substitute(  # noqa: E731
        timed(e), declared.duration, clock.symbol
    )
    held = [_held(declared, arc) for arc in arcs]
    exact = conditions is not None
    known = conditions or [Conditions()] * (len(arcs) + 2)
    own = known[1:-1]
    made, guesses, meshes = [], [], []
    for index, arc in enumerate(arcs):
        first, last = index == 0, index == len(arcs) - 1
        piece = copy.copy(declared)
        piece.name = f"{declared.name} {index + 1}"
        piece.duration_bounds = (SHORTEST_DURATION * duration, 3.0 * duration)
        if len(arcs) == 1:
            piece.duration_bounds = declared.duration_bounds
        low, high = declared.duration_bounds
        ends = {
            "initial": (np.zeros(1), np.zeros(1)) if first else None,
            "final": (np.array([low]), np.array([high])) if last else None,
        }
        beside = known[index].replaced | known[index + 2].replaced
        free: Callable[[Any], Any] = partial(_freed, own=own[index].replaced, beside=beside)
        piece.states = [free(_inside(s, first, last)) for s in declared.states]
        piece.states.append(replace(clock, **ends))
        piece.derivatives = {k: timed(e) for k, e in declared.derivatives.items()}
        piece.derivatives[clock.name] = ca.MX(1.0)
        piece.controls = [
            held[index].get(c.name) or _inside(c, first, last) for c in declared.controls
        ]
        piece.running_costs = [timed(e) for e in declared.running_costs]
        piece.algebraic_equations = [timed(e) for e in declared.algebraic_equations]
        piece.constraints = [
            replace(c, expression=timed(c.expression))
            for c in (*map(free, declared.constraints), *own[index].along)
        ]
        piece.end_costs = [final(e) for e in declared.end_costs] if last else []
        piece.end_constraints = [
            replace(c, expression=final(c.expression)) for c in declared.end_constraints
        ]
        if not last:
            piece.end_constraints = [
                replace(c, expression=timed(c.expression))
                for c in own[index + 1].entered(own[index])
            ]
            piece.end_constraints += _met(limits, arc, arcs[index + 1], own[index], own[index + 1])
        kept = [place for place, here in ((0.0, first), (1.0, last)) if here]
        for kind in ("point_constraints", "point_costs"):
            there = [k for k in getattr(declared, kind) if k.fractions[0] in kept]
            setattr(piece, kind, [replace(k, expression=final(k.expression)) for k in there])
        if first:
            piece.point_constraints += [
                PointConstraint(
                    **{**vars(c), "expression": timed(c.expression)}, fractions=np.zeros(1)
                )
                for c in own[0].entered(known[0])
            ]
        if exact:
            piece.interior_points = None  # the points of the scheme, where controls have values
            piece.controls = [
                replace(c, shape="polynomial")
                if c.shape == "constant" and np.any(c.lower < c.upper)
                else c
                for c in piece.controls
            ]
        guess = _guess(declared, duration, sample, clock, arc)
        if exact and any(own[index].entry.values()):
            guess = _with_start(piece, guess, timed)
        made.append(piece)
        guesses.append(guess)
        meshes.append(Mesh(arc.intervals))
    return made, guesses, meshes


def _with_start(piece: Phase, guess: Guess, timed: Callable[[ca.MX], ca.MX]) -> Guess:
    """Let what follows from a limit of the states keep its own limits where the arc begins, too.

    Radau collocation has no point there, and a control that jumps into it no value before: it
    becomes a state that stays as it is.
    """
    jumping = [c for c in _jumping(piece) if np.any(c.lower < c.upper)]
    there = [replace(c, symbol=ca.MX.sym(f"{c.name}{AT_START}", c.size)) for c in jumping]
    before, after = ca.vertcat(*(c.symbol for c in jumping)), ca.vertcat(*(c.symbol for c in there))
    for own in piece.constraints:
        if ca.depends_on(own.expression, before):
            known = {**vars(own), "expression": timed(ca.substitute(own.expression, before, after))}
            piece.point_constraints.append(PointConstraint(**known, fractions=np.zeros(1)))
    values = dict(guess.values)
    for control, state in zip(jumping, there, strict=True):
        name, along = control.name, values[control.name]
        assert callable(along)
        state = replace(state, name=name + AT_START, initial=None, final=None, shape="state")
        piece.states.append(state)
        piece.derivatives[state.name] = ca.MX.zeros(control.size)
        values[state.name] = np.asarray(along(np.array([1e-6])))[0]
    return Guess(guess.duration, values)


@dataclass(frozen=True, eq=False)
class Conditions:
    """What limits demand of an arc on which they act.

    Attributes
    ----------
    along : equations at all its points
    entry : equations where it begins, for the end of the arc before it, by what they keep
    """

    along: tuple[PathConstraint, ...] = ()
    entry: Mapping[tuple[str, int], Sequence[PathConstraint]] = field(default_factory=dict)

    @property
    def replaced(self) -> frozenset[tuple[str, int]]:
        """Names and components of the limits that these keep."""
        return frozenset(self.entry)

    def entered(self, before: Conditions) -> list[PathConstraint]:
        """Equations where the arc begins, but for what is met as it acted before."""
        return [c for key, begun in self.entry.items() if key not in before.replaced for c in begun]


def _freed(
    limited: Any, own: frozenset[tuple[str, int]], beside: frozenset[tuple[str, int]]
) -> Any:
    """A state or path constraint without the bounds that equations keep on an arc.

    Beside such an arc they are met at one end, and a little looser: a bound and an equation of the
    same value would have no multipliers of their own.
    """
    low, high = limited.lower.copy(), limited.upper.copy()
    for name, i in beside:
        if name == limited.name:
            reach = high[i] - low[i]
            reach = LOOSER * (reach if np.isfinite(reach) else limited.scale[i])
            low[i], high[i] = low[i] - reach, high[i] + reach
    kept = [i for name, i in own if name == limited.name]
    low[kept], high[kept] = -np.inf, np.inf
    return replace(limited, lower=low, upper=high)


def conditions_of(
    declared: Phase, arcs: Sequence[Stretch], limits: Sequence[Limit], *, first: bool
) -> list[Conditions]:
    """What limits demand of every arc of a phase, the first one or a later one."""
    return [
        _conditions_on(declared, arc, limits, start=first and index == 0)
        for index, arc in enumerate(arcs)
    ]


def _conditions_on(
    declared: Phase, arc: Stretch, limits: Sequence[Limit], *, start: bool
) -> Conditions:
    """Equations of the limits that act on an arc, as many as it has free control components."""
    sides = arc.signature[len(arc.signature) - len(limits) :] if arc.signature else ()
    free = sum(c.size for c in _jumping(declared))
    free -= sum(k != 0 for k in arc.signature[: len(arc.signature) - len(limits)])
    along: list[PathConstraint] = []
    entry: dict[tuple[str, int], Sequence[PathConstraint]] = {}
    for limit, side in zip(limits, sides, strict=True):
        if not side or free <= 0:
            continue
        chain = [limit.met(side)] if limit.mixed else _derivatives(declared, limit, side)
        if not chain or (start and len(chain) > 1):  # what is given there may not be at the limit
            continue
        along.append(chain[-1])
        entry[limit.constraint.name, limit.component] = chain[:-1]
        free -= 1
    return Conditions(tuple(along), entry)


def _derivatives(declared: Phase, limit: Limit, side: int) -> list[PathConstraint]:
    """A limit of the states that is met, and its time derivatives up to one with a jumping control.

    Nothing where that is none of the first three.
    """
    x = ca.vertcat(*(s.symbol for s in declared.states))
    slope = ca.vertcat(*(declared.derivatives[s.name] for s in declared.states))
    own = limit.met(side)
    found, value = [own], own.expression
    for order in range(1, HIGHEST_ORDER + 1):
        value = ca.jtimes(value, x, slope)
        zero = np.zeros(1)
        name = f"{own.name}, derivative {order}"
        found.append(replace(own, name=name, expression=value, lower=zero, upper=zero))
        if any(ca.depends_on(value, c.symbol) for c in _jumping(declared)):
            return found
    return []


def _clock(phase: Phase, duration: float) -> Variable:
    name = "elapsed time"
    while name in {v.name for v in phase.variables}:
        name += "'"
    free = np.full(1, np.inf)
    symbol = ca.MX.sym(f"{phase.name}.{name}")
    scale = np.array([duration])
    return Variable(name, symbol, -free, free, None, None, scale, "s", "state")


def _inside(variable: Variable, first: bool, last: bool) -> Variable:
    """A state or continuous control with its end conditions at the ends of the phase only."""
    return replace(
        variable,
        initial=variable.initial if first else None,
        final=variable.final if last else None,
    )


def _held(phase: Phase, arc: Stretch) -> dict[str, Variable]:
    """Controls of an arc that may jump, fixed where they are at a bound."""
    held, offset = {}, 0
    for control in _jumping(phase):
        sides = np.array(arc.signature[offset : offset + control.size] or [0] * control.size)
        offset += control.size
        held[control.name] = replace(
            control,
            lower=np.where(sides > 0, control.upper, control.lower),
            upper=np.where(sides < 0, control.lower, control.upper),
        )
    return held


def _met(
    limits: Sequence[Limit], arc: Stretch, after: Stretch, own: Conditions, following: Conditions
) -> list[PathConstraint]:
    """Limits of states that begin or cease to act where two arcs meet, but for what keeps them."""
    found = []
    for column, limit in enumerate(limits, start=len(arc.signature) - len(limits)):
        sides = arc.signature[column], after.signature[column]
        key = (limit.constraint.name, limit.component)
        if limit.mixed or sides[0] == sides[1] or key in own.replaced | following.replaced:
            continue
        found += [limit.met(side) for side in sides if side]
    return found


def _guess(
    declared: Phase, duration: float, sample: Sample, clock: Variable, arc: Stretch
) -> Guess:
    names = [v.name for v in (*node_variables(declared), *declared.controls, *declared.algebraics)]
    reach = arc.end - arc.begin

    def along(name: str) -> Callable[[FloatArray], FloatArray]:
        return lambda s: sample((arc.begin + s * reach) * duration)[name]

    values = {name: along(name) for name in dict.fromkeys(names)}
    values[clock.name] = lambda s: (arc.begin + s * reach)[:, None] * duration
    return Guess(reach * duration, values)


def links_between(
    problem: OptimalControlProblem, groups: Sequence[Sequence[Phase]]
) -> list[PhaseLink]:
    links = []
    for index, pieces in enumerate(groups):
        for before, after in itertools.pairwise(pieces):
            names = tuple(v.name for v in node_variables(before) if not v.name.endswith(AT_START))
            links.append(PhaseLink(before.name, after.name, names))
        if index + 1 < len(groups):
            declared = problem.links[index]
            links.append(PhaseLink(pieces[-1].name, groups[index + 1][0].name, declared.names))
    return links
