"""Outcome of a solve: its verdict, its provenance, and the sensitivities from its multipliers.

By the envelope theorem a bound that is relaxed by d changes the optimal cost by its multiplier
times d. The cost is the duration plus a smoothing term of about 1e-5 of it.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

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
    sides: dict[str, dict[str, FloatArray]] = {"lower": {}, "upper": {}}
    via: dict[int, dict[int, float]] = defaultdict(dict)
    rows: dict[str, dict[float, FloatArray]] = defaultdict(dict)
    start = 0.0
    families = [family] * len(solution.phases) if task is None else task.families
    segments: list[dict[str, dict[float, FloatArray]]] = []
    stops: list[dict[str, FloatArray]] = [{} for _ in range(len(solution.phases) + 1)]
    for number, phase in enumerate(solution.phases):
        segments.append(defaultdict(dict))
        for entry, times, multipliers in _bounds(solution, phase):
            # A limit whose bounds vary is named by its side, such as "tool speed, upper limit".
            name, _, side = entry.name.partition(", ")
            key = KEYS.get(name, name.replace(" ", "_"))
            slopes = (-1.0 if side.startswith("lower") else 1.0) * multipliers / entry.scale
            if entry.kind in ("initial", "final"):
                if key == "q":
                    at = number + (entry.kind == "final")
                    via[at][entry.component] = -float(slopes.sum())
                continue
            if entry.kind in ("point", "end"):
                at = stops[number + (entry.kind == "end")]
                at.setdefault(entry.name, np.zeros(entry.size))[entry.component] += slopes.sum()
                continue
            if key in families[number] and key not in MotionSamples._fields:
                for t, slope in zip(times.tolist(), slopes, strict=True):
                    row = segments[-1][key].setdefault(t, np.zeros(entry.size))
                    row[entry.component] += slope
            if key not in family:
                continue
            for side, sign in (("lower", -1.0), ("upper", 1.0)):
                amounts = sides[side].setdefault(key, np.zeros(entry.size))
                amounts[entry.component] -= slopes[sign * slopes > 0].sum()
            if key in MotionSamples._fields:  # bounds of joints have a total slope alone
                continue
            for t, slope in zip((start + times).tolist(), slopes, strict=True):
                rows[key].setdefault(t, np.zeros(entry.size))[entry.component] += slope
        start += phase.duration
    count = solution.phases[0]["q"].shape[1]
    points = np.array([[via[k].get(j, 0.0) for j in range(count)] for k in sorted(via)])
    prices: dict[str, Any] = {
        **_plain(sides),
        "via": _plain(points),
        "beside": 5 * abs(solution.cost - start) + abs(solution.gap.slack),
        "rows": _over_time(rows),
    }
    if task is not None:
        prices["segments"] = [_over_time(segment) for segment in segments]
        prices["stops"] = [_plain(conditions) for conditions in stops]
        for k, segment in enumerate(prices["segments"]):
            if DISTANCE in segment:
                segment[DISTANCE]["pairs"] = task.around.pairs(k)
    return prices


def _over_time(rows: dict[str, dict[float, FloatArray]]) -> dict[str, Any]:
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
