"""Mesh points where arcs meet: from a solve with one phase an arc, or from the switches alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.status import Status
from microbot_ocp.ocp.arcs._cutter import cut, is_cuttable
from microbot_ocp.ocp.arcs._detector import (
    SideRun,
    Switch,
    control_activities,
    jumping,
    plan_of,
    runs,
)
from microbot_ocp.ocp.arcs._settings import CUTTER, MESH_POINTS
from microbot_ocp.ocp.problem import OptimalControlProblem, Phase
from microbot_ocp.ocp.solution import PhaseSolution, Solution
from microbot_ocp.ocp.solvers import SolverSettings, solve_on, transcribed
from microbot_ocp.ocp.transcription.schemes import Scheme


def place_junctions(
    problem: OptimalControlProblem,
    solution: Solution,
    scheme: Scheme,
    settings: SolverSettings,
) -> list[FloatArray] | None:
    """Find where arcs meet, as fractions of every phase, by a solve with one phase an arc.

    None where there is nothing to place, where the problem cannot be cut (dynamics that depend on
    the duration of their phase), or where the solve fails or does not come as low. Limits that
    depend on controls are left aside.

    Raises
    ------
    KeyboardInterrupt
        The solve was interrupted.
    """
    plans = [plan_of(phase, mixed=False) for phase in solution.phases]
    most = max(len(plan.arcs) for plan in plans)
    if not 1 < most <= CUTTER.most_arcs or not all(is_cuttable(plan.declared) for plan in plans):
        return None
    least = MESH_POINTS.least_intervals
    plans = [
        replace(plan, arcs=[replace(a, intervals=max(a.intervals, least)) for a in plan.arcs])
        for plan in plans
    ]
    in_arcs = cut(problem, plans, exact=False)
    transcription = transcribed(in_arcs.problem, settings, scheme=scheme, guess=in_arcs.guesses)
    own = replace(settings, solver="ipopt")
    solved = solve_on(transcription, in_arcs.meshes, in_arcs.guesses, own)
    if solved.status is Status.INTERRUPTED:
        raise KeyboardInterrupt  # the solver kept it to itself
    if not solved.solved or solved.cost > solution.cost + MESH_POINTS.costlier * abs(solution.cost):
        return None
    return [
        _ends(plan.declared, [solved[piece.name] for piece in pieces])
        for plan, pieces in zip(plans, in_arcs.groups, strict=True)
    ]


def _ends(declared: Phase, pieces: Sequence[PhaseSolution]) -> FloatArray:
    """Find where the arcs of a phase end, and where controls change within them.

    Where a control was free to be at a bound, its arc may have taken a part of another one.
    """
    ends = np.cumsum([0.0, *(piece.duration for piece in pieces)])
    inner = [
        begin + piece.t[run.begin]
        for begin, piece in zip(ends[:-1], pieces, strict=True)
        for run in _control_runs(piece, declared)[1:]
    ]
    places = ends[1:-1]
    if len(inner) + places.size < CUTTER.most_arcs:
        places = np.sort(np.append(places, inner))
    places = places / ends[-1]
    # an arc that shrank to nothing is none
    apart = np.diff(np.append(places, 1.0)) > CUTTER.gone
    return places[apart & (places > CUTTER.gone)]


def _control_runs(piece: PhaseSolution, declared: Phase) -> list[SideRun]:
    activities = control_activities(piece, jumping(declared))
    return runs(np.stack([a.sides for a in activities], axis=1)) if activities else []


def hold(
    mesh: FloatArray, places: ArrayLike, accuracy: float, taken: Sequence[float] = ()
) -> FloatArray:
    """Move the nearest mesh point that is not taken to every place, or add a point there."""
    points, held = mesh.copy(), list(taken)
    for place in np.unique(np.clip(places, 0.0, 1.0)).tolist():
        if min(place, 1.0 - place) > accuracy:
            points = _with_point(points, place, held, accuracy)
            held.append(place)
    return points[np.concatenate([[True], np.diff(points) > 1e-9])]


def move_to_switches(mesh: FloatArray, switches: Sequence[Switch], accuracy: float) -> FloatArray:
    """Put mesh points where the controls switch.

    A ramp of a continuous control becomes shorter: points go to both sides of the switch, and what
    was inside the ramp is dropped.
    """
    points = mesh.copy()
    for ramp in (s for s in switches if s.continuous and s.offset > accuracy):
        reach = MESH_POINTS.ramp * (ramp.end - ramp.begin)
        inside = (points > ramp.begin) & (points < ramp.end)
        sides = [p for p in (ramp.place - reach, ramp.place + reach) if 0.0 < p < 1.0]
        points = np.sort(np.concatenate([points[~inside], sides]))
    jumps = [s for s in switches if not s.continuous]
    taken = [s.place for s in jumps if s.offset <= accuracy]
    return hold(points, [s.place for s in jumps if s.offset > accuracy], accuracy, taken)


def _with_point(
    points: FloatArray, place: float, held: Sequence[float], accuracy: float
) -> FloatArray:
    """Put a point at a place: the nearest one, unless it is an end or holds another place.

    Where that is news, points on both sides keep the intervals at the place short: a rest of the
    other arc, be it ever so small, takes the multipliers of one of them.
    """
    nearest = int(np.abs(points - place).argmin())
    point = float(points[nearest])
    news = abs(point - place) > accuracy
    if 0.0 < point < 1.0 and all(abs(point - other) > accuracy for other in held):
        points = np.delete(points, nearest)
    before, after = points[points < place].max(), points[points > place].min()
    reach = MESH_POINTS.bracket * min(place - before, after - place)
    sides = [place - reach, place + reach] if news and reach > accuracy else []
    return np.sort(np.concatenate([points, [place], sides]))


def distance(mesh: FloatArray, places: FloatArray) -> float:
    """Return the largest distance of a place from the mesh."""
    gaps = np.abs(mesh[:, None] - places[None, :]).min(axis=0)
    return float(gaps.max(initial=0.0))
