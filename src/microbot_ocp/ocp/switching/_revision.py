"""Revision of the arcs of a solution.

An arc that shrank to zero length is removed. If the multiplier of a held control has the wrong
sign, a switch is missing: the control leaves its limit there, and a state limit that is reached
becomes active instead. A free control that stays at a limit over whole intervals is held there.
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from microbot_ocp._base.checks import ROUNDING, FloatArray
from microbot_ocp.ocp.arcs import (
    ArcPlan,
    PlannedArc,
    control_activities,
    joined,
    jumping,
    merged,
    mixed_limits,
)
from microbot_ocp.ocp.problem import Phase
from microbot_ocp.ocp.solution import PhaseSolution, Solution
from microbot_ocp.ocp.switching._cutter import BOUND_MARGIN, SHORTEST_ARC, VANISHED_ARC
from microbot_ocp.ocp.transcription import labels_of
from microbot_ocp.ocp.transcription.schemes import Collocation
from microbot_ocp.ocp.verification import runs

LEAST_INTERVALS = 2  # intervals of an arc on its first mesh


@dataclass(frozen=True, eq=False)
class ArcSolution:
    """A solution with one phase per arc, and the plans of its arcs."""

    plans: tuple[ArcPlan, ...]
    groups: tuple[tuple[Phase, ...], ...]
    solution: Solution

    def pieces(self, index: int) -> list[PhaseSolution]:
        """Return the solved arcs of a phase."""
        return [self.solution[piece.name] for piece in self.groups[index]]

    def as_solved(self) -> list[ArcPlan]:
        """Return the plans with the lengths and values of the solution."""
        plans = []
        for index, plan in enumerate(self.plans):
            pieces = self.pieces(index)
            lengths = [piece.duration for piece in pieces]
            arcs = _laid_out(plan.arcs, lengths)
            sample = joined([piece.sample for piece in pieces], lengths)
            plans.append(replace(plan, arcs=arcs, duration=float(sum(lengths)), sample=sample))
        return plans

    def revised(self) -> list[ArcPlan]:
        """Return the revised plans; vanished arcs are removed first, before signs are judged."""
        pairs = [(plan, piece) for k, plan in enumerate(self.plans) for piece in self.pieces(k)]
        # An arc at its least length distorts the multipliers of its neighbours: remove it first.
        wrong = {} if any(_has_vanished(*pair) for pair in pairs) else wrong_signs(self)
        plans = []
        for index, (plan, solved) in enumerate(zip(self.plans, self.as_solved(), strict=True)):
            arcs: list[PlannedArc] = []
            signatures = [(), *plan.signatures, ()]
            for k, (arc, piece) in enumerate(zip(solved.arcs, self.pieces(index), strict=True)):
                if _has_vanished(plan, piece):
                    continue
                if plan.is_undetermined(arc):
                    arcs += _held_at_limits(plan, arc, piece)
                else:
                    beside = signatures[k : k + 3]
                    arcs += _freed_where_wrong(plan, arc, piece, wrong.get(piece.name, ()), beside)
            arcs = merged(arcs)
            # Removed arcs leave a gap and new arcs need time: rescale all lengths to the phase.
            lengths = [max(arc.end - arc.begin, SHORTEST_ARC) for arc in arcs]
            plans.append(replace(solved, arcs=_laid_out(arcs, lengths)))
        return plans


def _laid_out(arcs: Sequence[PlannedArc], lengths: Sequence[float]) -> tuple[PlannedArc, ...]:
    """Return arcs laid out consecutively, in proportion to their lengths."""
    ends = np.cumsum([0.0, *lengths])
    pairs = itertools.pairwise((ends / ends[-1]).tolist())
    return tuple(replace(arc, begin=a, end=b) for arc, (a, b) in zip(arcs, pairs, strict=True))


def _has_vanished(plan: ArcPlan, piece: PhaseSolution) -> bool:
    return piece.duration <= VANISHED_ARC * plan.duration and len(plan.arcs) > 1


def _held_at_limits(plan: ArcPlan, arc: PlannedArc, piece: PhaseSolution) -> list[PlannedArc]:
    """Divide a free arc at the intervals over which a free control or limit stays at a bound."""
    phase = copy.copy(piece.laid_out.phase)
    for kind, strict in (("controls", True), ("constraints", False)):  # restore declared limits
        pairs = zip(getattr(phase, kind), getattr(plan.declared, kind), strict=strict)
        setattr(phase, kind, [replace(k, lower=d.lower, upper=d.upper) for k, d in pairs])
    activities = [*control_activities(piece, jumping(phase)), *mixed_limits(piece, phase)]
    sides = {(a.name, a.component, a.limit is None): a.sides for a in activities}
    table = np.tile(arc.signature, (piece.mesh.size - 1, 1))
    for k, column in enumerate(plan.columns):
        if not arc.signature[k]:
            table[:, k] = sides.get((column.name, column.component, column.limit is None), 0)
    return [
        _part(arc, piece.mesh[[first, after]].tolist(), table[first].tolist(), after - first)
        for first, after, _ in runs(table)
    ]


@dataclass(frozen=True)
class WrongSign:
    """Fractions of an arc between which the multiplier of a column has the wrong sign."""

    column: int
    begin: float
    end: float


def _freed_where_wrong(
    plan: ArcPlan,
    arc: PlannedArc,
    piece: PhaseSolution,
    wrong: Sequence[WrongSign],
    beside: Sequence[tuple[int, ...]],
) -> list[PlannedArc]:
    """Divide an arc where held controls leave their limits."""
    places = sorted({0.0, 1.0, *(w.begin for w in wrong), *(w.end for w in wrong)})
    arcs = []
    for a, b in itertools.pairwise(places):
        signature = list(arc.signature)
        for column in (w.column for w in wrong if w.begin <= a and b <= w.end):
            signature[column] = 0
            # The freed control can follow one of the state limits that are reached here.
            for other, side in _met_on(plan, piece, a, b):
                # A part with the signature of its neighbour would merge with it: no switch remains.
                instead = (*signature[:other], side, *signature[other + 1 :])
                if not signature[other] and instead not in beside:
                    signature = list(instead)
                    break
        arcs.append(_part(arc, (a, b), signature, round((b - a) * arc.intervals)))
    return arcs


def _part(
    arc: PlannedArc, places: Sequence[float], signature: Sequence[int], intervals: int
) -> PlannedArc:
    """Return the part of an arc between two fractions of it."""
    begin, end = (arc.begin + place * (arc.end - arc.begin) for place in places)
    return PlannedArc(begin, end, tuple(signature), max(intervals, LEAST_INTERVALS))


def _met_on(plan: ArcPlan, piece: PhaseSolution, begin: float, end: float) -> list[tuple[int, int]]:
    """Return (column, side) of the state limits that are reached on a part of an arc."""
    first = max(int(np.searchsorted(piece.mesh, begin, side="right")) - 1, 0)
    last = int(np.searchsorted(piece.mesh, end - ROUNDING))
    met = []
    for k, column in enumerate(plan.columns):
        if column.limit is None or column.limit.mixed:
            continue
        values = column.limit.along(piece.values, plan.declared)[first : last + 1]
        sides = column.limit.sides(values, BOUND_MARGIN * column.limit.range)
        if np.any(sides):
            met.append((k, int(sides[sides != 0][0])))
    return met


WRONG_SIGN = 1e-3  # relative size from which a wrong multiplier shows a missing switch


def wrong_signs(solved: ArcSolution) -> dict[str, list[WrongSign]]:
    """Return the spans with multipliers of the wrong sign, by arc.

    The multiplier of an active upper limit is positive, of a lower limit negative (Bryson and Ho,
    *Applied Optimal Control*, sections 3.8 and 3.9).
    """
    multipliers = _multipliers(solved.solution)
    wrong: dict[str, list[WrongSign]] = {}
    for index, plan in enumerate(solved.plans):
        pieces = solved.pieces(index)
        for place, column in enumerate(plan.columns):
            # Limits of states act through a derivative, whose multiplier has no definite sign.
            if column.of_states:
                continue
            key = ("control", column.name, column.component)
            if column.limit is not None:
                key = ("constraint", f"{column.name}[{column.component}] met", 0)
            # Densities in time are comparable between arcs and meshes, multipliers of rows are not.
            densities = [
                (piece, arc.signature[place], *_density(piece, multipliers[piece.name, *key]))
                for piece, arc in zip(pieces, plan.arcs, strict=True)
                if (piece.name, *key) in multipliers
            ]
            largest = max((float(np.abs(k[-1]).max()) for k in densities), default=0.0)
            for piece, side, at, density in densities:
                if side:
                    spans = _negative(at, side * density, WRONG_SIGN * largest)
                    wrong.setdefault(piece.name, []).extend(WrongSign(place, *s) for s in spans)
    return {name: places for name, places in wrong.items() if places}


def _multipliers(solution: Solution) -> dict[tuple[str, str, str, int], list[float]]:
    """Return lists of multipliers by phase, kind, name and component."""
    layouts = [phase.laid_out for phase in solution.phases]
    labels = [*labels_of(layouts, "variables"), *labels_of(layouts, "rows")]
    values = [*np.asarray(solution.variable_multipliers), *np.asarray(solution.row_multipliers)]
    gathered: dict[tuple[str, str, str, int], list[float]] = {}
    for label, value in zip(labels, values, strict=True):
        key = (label.phase, label.kind, label.name, label.component)
        gathered.setdefault(key, []).append(float(value))
    return gathered


def _density(piece: PhaseSolution, multipliers: Sequence[float]) -> tuple[FloatArray, FloatArray]:
    """Return fractions of an arc, and multipliers there over their quadrature weights, 1/s."""
    count = piece.mesh.size - 1
    # A control constant over the interval has one multiplier per interval, others one per point.
    table = np.array(multipliers[: len(multipliers) // count * count]).reshape(count, -1)
    scheme = Collocation("radau", table.shape[1])
    points = np.array(scheme.points) if table.shape[1] > 1 else np.array([0.5])
    steps = np.diff(piece.mesh)[:, None]
    at = piece.mesh[:-1, None] + points * steps
    return at.ravel(), (table / (scheme.weights * steps * piece.duration)).ravel()


def _negative(at: FloatArray, values: FloatArray, least: float) -> list[tuple[float, float]]:
    """Return the spans of negative values that reach below ``-least``."""

    def edge(k: int) -> float:
        if k in (0, values.size):
            return float(k > 0)
        # Zero of the linear interpolation between both neighbours.
        (a, b), (x, y) = values[k - 1 : k + 1], at[k - 1 : k + 1]
        return float(x + (y - x) * a / (a - b))

    return [
        (edge(first), edge(after))
        for first, after, side in runs((values < 0).astype(int))
        if side and values[first:after].min() < -least
    ]


def with_finer_meshes(solved: ArcSolution, intervals: Mapping[str, int]) -> list[ArcPlan]:
    """Return the plans of the solved arcs with more mesh intervals."""
    plans = []
    for plan, pieces in zip(solved.as_solved(), solved.groups, strict=True):
        pairs = zip(plan.arcs, pieces, strict=True)
        arcs = tuple(replace(arc, intervals=intervals[piece.name]) for arc, piece in pairs)
        plans.append(replace(plan, arcs=arcs))
    return plans
