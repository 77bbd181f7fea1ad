"""Outcome of a solve: its verdict, its provenance, and the sensitivities from its multipliers.

By the envelope theorem a bound that is relaxed by d changes the optimal cost by its multiplier
times d. The cost is the duration plus a smoothing term of about 1e-5 of it.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.digest import digest_of
from microbot_ocp._base.outcome import Advice, Outcome
from microbot_ocp._base.status import Status
from microbot_ocp.limits import (
    JOINT_QUANTITIES,
    JointLimits,
    LimitFamily,
    Limits,
    MotionSamples,
    not_judged,
)
from microbot_ocp.motion import Motion
from microbot_ocp.ocp import PhaseSolution, Solution
from microbot_ocp.ocp.transcription import TableEntry
from microbot_ocp.planning.task._task import Task
from microbot_ocp.robot import Robot, drive_advice

KEYS = {quantity.name: key for key, quantity in JOINT_QUANTITIES.items()}
DISTANCE = "distance"  # the limit that a search among obstacles adds
DIGITS = 8  # significant digits of the numbers stored with every motion
RowsOverTime = dict[str, dict[float, FloatArray]]  # slopes [k] by the key of a limit and the time


def one_remark(*remarks: str) -> str:
    """Return remarks on a motion joined to one; empty ones are skipped."""
    return "; ".join(filter(None, remarks))


def with_drives_noted(
    robot: Robot, motion: Motion, limits: Limits | JointLimits | None = None
) -> Motion:
    """Return the motion with remarks on missing data of its drives in its note and outcome.

    Data are missing for torque limits without masses, and for light links whose torques alone bound
    the initial acceleration. A motion that leaves the grid of a table of limits is not solved.
    """
    family = LimitFamily.of(robot, limits)
    advice = drive_advice(family.robot, motion.qdd)
    if motion.solved and (outside := family.outside_of_tables(motion.samples(motion.t))):
        read, k = outside
        rest = motion.outcome.advice[1:]
        ended = Outcome.of(Status.OUTSIDE_TABLE, None, Advice("table", read.at(k)), *rest)
        motion = motion.ended(replace(ended, ledger=motion.outcome.ledger))
    rows = [("drives", advice), ("not judged", not_judged(family.unjudged))]
    rows = [Advice(kind, text) for kind, text in rows if text]
    new = [row for row in rows if row not in motion.outcome.advice]
    remark = one_remark(motion.remark, *(row.sentence for row in new))
    return replace(motion, remark=remark, outcome=motion.outcome.and_(*new))


def verdict(
    family: LimitFamily, solution: Solution, excess: Sequence[FloatArray], limit_tolerance: float
) -> Outcome:
    """Return the status and advice of a motion, from the excess of its limits between mesh points.

    A solver that converged on the mesh points is overruled if limits are exceeded in between by
    more than ``limit_tolerance``.
    """
    # The order of the verdicts matters: time over, then limits between mesh points, then the
    # solver's own status.
    worst = largest(excess)
    if deadline.over() and solution.status is not Status.INTERRUPTED:
        return Outcome.of(deadline.status())
    if solution.status.solved and not worst <= limit_tolerance:
        return Outcome.of(
            Status.LIMITS_EXCEEDED,
            f"limits are exceeded by {100 * worst:.3g} % between mesh points, and refinement ended "
            "there: give a finer mesh, or look for a place that cannot be passed",
        )
    names = [phase.name for phase in solution.phases]
    rows = [row for row in solution.rows if row.kind != "program"]
    for k, row in enumerate(rows):
        if row.at is not None:
            label, at = row.at
            where = label.kind, label.name, label.component, label.phase
            rows[k] = row.named(place_in_task(family, *where, at, names))
    return Outcome(solution.status, tuple(rows))


def largest(excess: Sequence[FloatArray]) -> float:
    """Return the largest relative excess of all phases."""
    return max(float(e.max()) for e in excess)


_QUANTITIES = {"q": "position", "qd": "velocity", "qdd": "acceleration"}


def place_in_task(
    family: LimitFamily,
    kind: str,
    name: str,
    component: int,
    phase: str,
    at: float | None,
    phases: Sequence[str],
) -> str:
    """Return the name of a program's row in terms of via points, joints and limits.

    Parameters
    ----------
    family : LimitFamily
    kind, name, component, phase : str, str, int, str
        Fields of the row's label.
    at : float or None
        Time since the start of the phase, s; None omits it.
    phases : sequence of str
        Names of all phases.
    """
    members = {member.name: member for member in family}
    if name in members:
        subject = members[name].title(component)
    elif name in _QUANTITIES:
        subject = f"{_QUANTITIES[name]} of {family.robot.joint_names[component]}"
    else:
        subject = name
    number = phases.index(phase) + 1
    if kind in ("initial", "final"):
        return f"{subject} at via point {number + (kind == 'final')}"
    where = f"between via points {number} and {number + 1}"
    return f"{subject} {where}" + ("" if at is None else f", {at:.4g} s after the first of them")


def limits_digest(limits: JointLimits) -> str:
    """Return a digest of joint limits and further limits, 12 hexadecimal digits."""
    return digest_of(joints=limits.as_dict(), also=limits.also)[:12]


def provenance_of(
    method: str,
    family: LimitFamily,
    solution: Solution,
    excess: float,
    wall_time: float,
    smoothing: float,
    task: Task | None = None,
    **more: Any,
) -> dict[str, Any]:
    """Return the provenance of a time-optimal motion, with further entries ``more``."""
    stops = None if task is None or task.is_plain else task
    return {
        "method": method,
        "excess": excess,
        "solver": solution.attempts[-1].solver,
        "gap": solution.gap.total,  # bound on the distance to the smoothed task's local optimum, s
        "intervals": [phase.mesh.size - 1 for phase in solution.phases],
        "phase_durations": [phase.duration for phase in solution.phases],
        "multipliers": multipliers_of(solution, family, stops),
        "limits_digest": limits_digest(family.robot.limits),
        **more,
        "wall_time": wall_time,
        "smoothing": smoothing,
        "casadi": ca.CasadiMeta.version(),
    }


def multipliers_of(
    solution: Solution, family: LimitFamily, task: Task | None = None
) -> dict[str, Any] | None:
    """Return slopes of the duration by the limits of a family, as plain values.

    Distances that a search adds have slopes only in a task, as they differ between segments.

    Returns
    -------
    dict or None
        "lower" and "upper" have the slope, s per unit of each bound, by the key of its limit;
        "via" [m][n] the slopes of the via points, s/rad (s/m). "rows" has by key the times "t", s,
        and the "slopes" [K][k], s per unit by which the quantity is larger at that time. "beside"
        bounds the error of a slope times a change of data, s: the smoothing of the squared jerk,
        which scales with the fifth power of time, and the solver's remaining gap. For a task of
        stops "segments" has such rows of all limits of every segment, times from its start, and
        the indices of the "pairs" with a required distance; "stops" has for every stop the slopes
        of its conditions by their names. None without multipliers or without a program.
    """
    if solution.variable_multipliers is None or any(p.layout is None for p in solution.phases):
        return None
    found = _slopes_of(solution, family, None if task is None else task.families)
    count = solution.phases[0]["q"].shape[1]
    # Joints without a condition at a via point have the slope zero.
    via = [[found.via[k].get(j, 0.0) for j in range(count)] for k in sorted(found.via)]
    return {
        **_plain(found.sides),
        "via": _plain(np.array(via)),
        "beside": 5 * abs(solution.cost - found.duration) + abs(solution.gap.slack),
        "rows": _over_time(found.rows),
        **({} if task is None else _multipliers_of_stops(found, task)),
    }


class _Slopes(NamedTuple):
    """Slopes of the duration by the bounds of a program, s per unit.

    Attributes
    ----------
    sides : dict
        Sums of the slopes of each limit, by "lower" or "upper" and the key of the limit.
    via : dict
        Slopes of the via points, by the number of the via point and the joint.
    rows : dict
        Slopes of the limits of the family, times since the start of the motion.
    segments : list of dict
        Slopes of the limits of every segment, times since its start.
    stops : list of dict
        Slopes of the conditions of every stop by their names.
    duration : float
        Sum of the durations of all phases, s.
    """

    sides: dict[str, dict[str, FloatArray]]
    via: dict[int, dict[int, float]]
    rows: RowsOverTime
    segments: list[RowsOverTime]
    stops: list[dict[str, FloatArray]]
    duration: float


def _slopes_of(
    solution: Solution, family: LimitFamily, families: Sequence[LimitFamily] | None
) -> _Slopes:
    """Return the slopes by the bounds of a program; ``families`` are those of its segments."""
    sides: dict[str, dict[str, FloatArray]] = {"lower": {}, "upper": {}}
    via: dict[int, dict[int, float]] = defaultdict(dict)
    rows: RowsOverTime = defaultdict(dict)
    segments: list[RowsOverTime] = [defaultdict(dict) for _ in solution.phases]
    stops: list[dict[str, FloatArray]] = [{} for _ in range(len(solution.phases) + 1)]
    start = 0.0
    for number, phase in enumerate(solution.phases):
        own = family if families is None else families[number]
        for entry, times, multipliers in _bounds(solution, phase):
            # A limit whose bounds vary is named by its side, such as "tool speed, upper limit".
            name, _, side = entry.name.partition(", ")
            key = KEYS.get(name, name.replace(" ", "_"))
            slopes = (-1.0 if side.startswith("lower") else 1.0) * multipliers / entry.scale
            # Conditions at the end of phase k belong to via point k + 1.
            at = number + (entry.kind in ("final", "end"))
            if entry.kind in ("initial", "final"):
                if key == "q":
                    via[at][entry.component] = -float(slopes.sum())
                continue
            if entry.kind in ("point", "end"):
                amounts = stops[at].setdefault(entry.name, np.zeros(entry.size))
                amounts[entry.component] += slopes.sum()
                continue
            of_joints = key in MotionSamples._fields  # bounds of joints have a total slope alone
            if key in own and not of_joints:
                _add_over_time(segments[number], key, entry, times, slopes)
            # Limits that only a segment has, such as distances, have no total slope.
            if key not in family:
                continue
            for side, sign in (("lower", -1.0), ("upper", 1.0)):
                # A multiplier is positive at an upper bound and negative at a lower one: its sign
                # selects the side. A larger bound shortens the motion.
                amounts = sides[side].setdefault(key, np.zeros(entry.size))
                amounts[entry.component] -= slopes[sign * slopes > 0].sum()
            if not of_joints:
                _add_over_time(rows, key, entry, start + times, slopes)
        start += phase.duration
    return _Slopes(sides, via, rows, segments, stops, start)


def _add_over_time(
    rows: RowsOverTime, key: str, entry: TableEntry, times: FloatArray, slopes: FloatArray
) -> None:
    """Add the slopes [M] of one component of a limit at times [M], s."""
    for t, slope in zip(times.tolist(), slopes, strict=True):
        rows[key].setdefault(t, np.zeros(entry.size))[entry.component] += slope


def _multipliers_of_stops(found: _Slopes, task: Task) -> dict[str, Any]:
    """Return the slopes by the limits of segments and the conditions of stops, as plain values."""
    segments = list(map(_over_time, found.segments))
    for k, segment in enumerate(segments):
        if DISTANCE in segment:
            segment[DISTANCE]["pairs"] = task.around.pairs(k)
    return {"segments": segments, "stops": [_plain(conditions) for conditions in found.stops]}


def _over_time(rows: RowsOverTime) -> dict[str, Any]:
    """Return times and slopes [K][k] of each limit, as plain values."""
    return {
        key: {"t": sorted(row), "slopes": _plain(np.array([row[t] for t in sorted(row)]))}
        for key, row in rows.items()
    }


def _bounds(
    solution: Solution, phase: PhaseSolution
) -> Iterator[tuple[TableEntry, FloatArray, FloatArray]]:
    """Yield the bounded rows and variables of a phase, with times [M], s, and multipliers [M]."""
    layout = phase.layout
    assert layout is not None
    assert solution.variable_multipliers is not None
    kinds = {"state", "control", "bound", "constraint", "initial", "final", "point", "end"}
    for blocks, multipliers in (
        (layout.variables, solution.variable_multipliers),
        (layout.rows, solution.row_multipliers),
    ):
        for block in blocks:
            for column, entry in enumerate(block.entries):
                if entry.kind not in kinds:
                    continue
                # Entries at the last mesh point have the index N of an interval that does not
                # exist: they are at the end of interval N - 1.
                last = np.minimum(block.intervals, layout.mesh.size - 2)
                share = np.where(block.intervals > last, 1.0, entry.fraction)
                step = np.diff(layout.mesh)[last]
                times = (layout.mesh[last] + share * step) * phase.duration
                values = multipliers[block.places[:, column]]
                yield entry, times, values if block.factors is None else values * block.factors


def _plain(values: Any) -> Any:
    """Return numbers as nested lists, rounded to ``DIGITS`` significant digits."""
    if isinstance(values, dict):
        return {key: _plain(entry) for key, entry in values.items()}
    if values.ndim > 1:
        return [_plain(row) for row in values]
    return [float(f"{value:.{DIGITS}g}") for value in values]
