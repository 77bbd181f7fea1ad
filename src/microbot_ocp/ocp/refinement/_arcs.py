"""Where arcs of a solution meet, to the accuracy of the solver: every arc as a phase of its own.

On an arc every control component is at one bound or free, and every limit of the states acts or
does not. Between mesh points nothing says where an arc begins. Solved again with one phase an arc,
of free duration and with its controls held at their bounds, the problem has its junctions among its
unknowns. A limit that acts on an arc is met at both of its ends. Source: J. T. Betts, *Practical
Methods for Optimal Control and Estimation*, 2nd ed., chapter 4.

Continuous controls are left free. Limits that depend on controls are not looked at.
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.status import Status
from microbot_ocp.ocp.problem import (
    OptimalControlProblem,
    PathConstraint,
    Phase,
    PhaseLink,
    Variable,
    node_variables,
)
from microbot_ocp.ocp.refinement._switches import AT_BOUND, BRACKET, interval_values
from microbot_ocp.ocp.solution import PhaseSolution, Solution
from microbot_ocp.ocp.solvers import SolverSettings, solve
from microbot_ocp.ocp.transcription import Guess, Mesh
from microbot_ocp.ocp.transcription.schemes import Scheme
from microbot_ocp.ocp.verification import phase_layout

ACTS = 3e-3  # of a state's range along the phase: nearer to a limit at both ends, it acts
SHORTEST = 2  # intervals of an arc: what is shorter is the smeared end of two others
MOST_ARCS = 12  # of a phase: a solution that chatters is not cut into pieces
SHORTEST_DURATION = 1e-4  # of the phase, that an arc may shrink to
LEAST_INTERVALS = 4  # of an arc's own mesh
WORSE = 1e-6  # share by which arcs may cost more than the solution that they come from


@dataclass(frozen=True, eq=False)
class _Limit:
    """A limit of the states alone, and where it acts: 1 at its upper side, -1 at its lower one."""

    constraint: PathConstraint
    component: int
    sides: np.ndarray  # of the intervals [N]

    def met(self, side: int) -> PathConstraint:
        """The limit as an equation for the end of an arc."""
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
    found = [_arcs(phase) for phase in solution.phases]
    if all(len(arcs) < 2 for arcs, _ in found):
        return None
    if any(len(arcs) > MOST_ARCS for arcs, _ in found):
        return None
    cut = OptimalControlProblem(f"{problem.name} in arcs")
    guesses, meshes = {}, []
    groups: list[list[Phase]] = []
    for phase, (arcs, limits) in zip(solution.phases, found, strict=True):
        made = _cut(phase, arcs, limits)
        if made is None:
            return None
        own, own_guesses, own_meshes = made
        groups.append(own)
        cut.phases += own
        guesses |= {piece.name: guess for piece, guess in zip(own, own_guesses, strict=True)}
        meshes += own_meshes
    cut.links = _links(problem, groups)
    solved = solve(cut, meshes, guesses, replace(settings, solver="ipopt"), scheme=scheme)
    if solved.status is Status.INTERRUPTED:
        raise KeyboardInterrupt  # the solver kept it to itself
    if not solved.status.solved or solved.cost > solution.cost + WORSE * abs(solution.cost):
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
        found, _ = _arcs(piece, declared)
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


def _arcs(phase: PhaseSolution, declared: Phase | None = None) -> tuple[list[_Arc], list[_Limit]]:
    """Arcs of a phase, and the limits of its states that act somewhere.

    Of a piece of a phase, with the declaration of the whole: arcs of its controls alone, however
    short.
    """
    whole, shortest = declared is None, SHORTEST if declared is None else 1
    declared = declared or phase_layout(phase).phase
    columns = []
    for control in _jumping(declared):
        values = interval_values(phase, control)
        near = AT_BOUND * (control.upper - control.lower)
        near = np.where(np.isfinite(near), near, AT_BOUND * control.scale)
        fixed = control.lower == control.upper
        upper = (values.least >= control.upper - near) & ~fixed
        lower = (values.largest <= control.lower + near) & ~fixed
        columns.append(upper.astype(int) - lower.astype(int))
    limits = _limits(phase, declared) if whole else []
    columns += [limit.sides[:, None] for limit in limits]
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


def _jumping(phase: Phase) -> list[Variable]:
    """Controls that may jump at a mesh point."""
    return [c for c in phase.controls if c.shape != "linear"]


def _limits(phase: PhaseSolution, declared: Phase) -> list[_Limit]:
    """Limits of the states alone, and the intervals on which they act."""
    symbols = [v.symbol for v in declared.states]
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
    nodes = [phase.values[v.name].T for v in declared.states]
    for constraint in known:
        values = ca.Function("value", symbols, [constraint.expression])(*nodes)
        for i, row in enumerate(np.array(values)):
            low, high = float(constraint.lower[i]), float(constraint.upper[i])
            near = ACTS * float(np.ptp(row))
            sides = (row >= high - near).astype(int) - (row <= low + near).astype(int)
            both = np.where(sides[:-1] == sides[1:], sides[1:], 0)
            if near > 0 and low < high and np.any(both):
                found.append(_Limit(constraint, i, both))
    return found


def _guessed(phase: PhaseSolution, arcs: Sequence[_Arc]) -> FloatArray:
    """Junctions in the middle between the arcs that meet there."""
    return np.array(
        [
            (phase.mesh[before.last + 1] + phase.mesh[after.first]) / 2
            for before, after in itertools.pairwise(arcs)
        ]
    )


# the problem in arcs ------------------------------------------------------------------------------


def _cut(
    phase: PhaseSolution, arcs: Sequence[_Arc], limits: Sequence[_Limit]
) -> tuple[list[Phase], list[Guess], list[Mesh]] | None:
    """A phase for every arc, with guesses and meshes; the clock goes on from one to the next."""
    declared = phase_layout(phase).phase
    along = [*declared.derivatives.values(), *declared.running_costs]
    along += [*declared.algebraic_equations, *(c.expression for c in declared.constraints)]
    points = [*declared.point_constraints, *declared.point_costs]
    if any(len(k.fractions) > 1 for k in points) or declared.point_fractions:
        return None
    along += [k.expression for k in points if k.fractions[0] == 0.0]
    if any(ca.depends_on(k, declared.duration) for k in along):
        return None
    clock = _clock(declared, phase.duration)
    # what was written with the time of the phase gets that of the clock
    timed: Callable[[ca.MX], ca.MX] = lambda e: ca.substitute(e, declared.time, clock.symbol)  # noqa: E731
    final: Callable[[ca.MX], ca.MX] = lambda e: ca.substitute(  # noqa: E731
        timed(e), declared.duration, clock.symbol
    )
    arcs = arcs or [_Arc(0, phase.mesh.size - 2, ())]
    edges = np.concatenate([[0.0], _guessed(phase, arcs), [1.0]])
    made, guesses, meshes = [], [], []
    for index, arc in enumerate(arcs):
        first, last = index == 0, index == len(arcs) - 1
        begin, end = float(edges[index]), float(edges[index + 1])
        piece = copy.copy(declared)
        piece.name = f"{declared.name} {index + 1}"
        piece.duration_bounds = (SHORTEST_DURATION * phase.duration, 3.0 * phase.duration)
        if len(arcs) == 1:
            piece.duration_bounds = declared.duration_bounds
        low, high = declared.duration_bounds
        ends = {
            "initial": (np.zeros(1), np.zeros(1)) if first else None,
            "final": (np.array([low]), np.array([high])) if last else None,
        }
        piece.states = [_inside(s, first, last) for s in declared.states]
        piece.states.append(replace(clock, **ends))
        piece.derivatives = {k: timed(e) for k, e in declared.derivatives.items()}
        piece.derivatives[clock.name] = ca.MX(1.0)
        piece.controls = _held(declared, arc, first, last)
        piece.running_costs = [timed(e) for e in declared.running_costs]
        piece.algebraic_equations = [timed(e) for e in declared.algebraic_equations]
        piece.constraints = [
            replace(c, expression=timed(c.expression)) for c in declared.constraints
        ]
        piece.end_costs = [final(e) for e in declared.end_costs] if last else []
        piece.end_constraints = [
            replace(c, expression=final(c.expression)) for c in declared.end_constraints
        ]
        if not last:
            piece.end_constraints = _met(limits, arc, arcs[index + 1])
        kept = [place for place, here in ((0.0, first), (1.0, last)) if here]
        for kind in ("point_constraints", "point_costs"):
            own = [k for k in getattr(declared, kind) if k.fractions[0] in kept]
            setattr(piece, kind, [replace(k, expression=final(k.expression)) for k in own])
        made.append(piece)
        guesses.append(_guess(phase, clock, begin, end))
        meshes.append(Mesh(max(arc.last - arc.first + 1, LEAST_INTERVALS)))
    return made, guesses, meshes


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


def _held(phase: Phase, arc: _Arc, first: bool, last: bool) -> list[Variable]:
    """Controls of an arc, fixed where they are at a bound."""
    held, offset = {}, 0
    for control in _jumping(phase):
        sides = np.array(arc.signature[offset : offset + control.size] or [0] * control.size)
        offset += control.size
        held[control.name] = replace(
            control,
            lower=np.where(sides > 0, control.upper, control.lower),
            upper=np.where(sides < 0, control.lower, control.upper),
        )
    return [held.get(c.name) or _inside(c, first, last) for c in phase.controls]


def _met(limits: Sequence[_Limit], arc: _Arc, after: _Arc) -> list[PathConstraint]:
    """Limits that begin or cease to act where two arcs meet."""
    found = []
    for column, limit in enumerate(limits, start=len(arc.signature) - len(limits)):
        sides = arc.signature[column], after.signature[column]
        if sides[0] != sides[1]:
            found += [limit.met(side) for side in sides if side]
    return found


def _guess(phase: PhaseSolution, clock: Variable, begin: float, end: float) -> Guess:
    declared = phase_layout(phase).phase
    names = [v.name for v in (*node_variables(declared), *declared.controls, *declared.algebraics)]

    def along(name: str) -> Callable[[FloatArray], FloatArray]:
        return lambda s: phase.sample((begin + s * (end - begin)) * phase.duration)[name]

    values = {name: along(name) for name in dict.fromkeys(names)}
    values[clock.name] = lambda s: (begin + s * (end - begin))[:, None] * phase.duration
    return Guess((end - begin) * phase.duration, values)


def _links(problem: OptimalControlProblem, groups: Sequence[Sequence[Phase]]) -> list[PhaseLink]:
    links = []
    for index, pieces in enumerate(groups):
        for before, after in itertools.pairwise(pieces):
            names = tuple(v.name for v in node_variables(before))
            links.append(PhaseLink(before.name, after.name, names))
        if index + 1 < len(groups):
            declared = problem.links[index]
            links.append(PhaseLink(pieces[-1].name, groups[index + 1][0].name, declared.names))
    return links
