"""How a solve ends: the verdict, what a motion keeps of it, and what its multipliers say.

They say how the duration changes with each bound: one that gives way by d changes the cost by its
multiplier times d (the envelope theorem). The cost is the duration but for what smooths it, which
is a hundred-thousandth of it.
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
from microbot_ocp.robot import Robot, drive_advice

KEYS = {quantity.name: key for key, quantity in JOINT_QUANTITIES.items()}
DIGITS = 8  # significant ones: what is written with every motion


def one_remark(*remarks: str) -> str:
    """Return remarks on a motion as one; empty ones say nothing."""
    return "; ".join(filter(None, remarks))


def with_drives_noted(
    robot: Robot, motion: Motion, limits: Limits | JointLimits | None = None
) -> Motion:
    """Return the motion, whose note and outcome say what of the drives nothing is known of.

    These are limits of torques without masses, and torques on light links that alone decide how
    fast it begins. A motion that reads a table of a limit outside of its grid is not solved.
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
    """Return the status and advice of a motion, by the excess of its limits between mesh points.

    A solver that converged on the mesh points is not believed where limits are exceeded in between
    by more than was asked for.
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
    """Return the largest excess of all phases, relative to its limit."""
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
    """Name a row of a program by via points, joints and limits.

    Parameters
    ----------
    family : LimitFamily
    kind, name, component, phase : as in the label of the row
    at : s, since the start of its phase; None leaves it out
    phases : names of all phases
    """
    members = {member.name: member for member in family}
    if name in members:
        what = members[name].title(component)
    elif name in _QUANTITIES:
        what = f"{_QUANTITIES[name]} of {family.robot.joint_names[component]}"
    else:
        what = name
    number = phases.index(phase) + 1
    if kind in ("initial", "final"):
        return f"{what} at via point {number + (kind == 'final')}"
    where = f"between via points {number} and {number + 1}"
    return f"{what} {where}" + ("" if at is None else f", {at:.4g} s after the first of them")


def limits_digest(limits: JointLimits) -> str:
    """Return a digest of limits, of the joints and others: 12 digits."""
    return digest_of(joints=limits.as_dict(), also=limits.also)[:12]


def provenance_of(
    method: str,
    family: LimitFamily,
    solution: Solution,
    excess: float,
    wall_time: float,
    smoothing: float,
    **more: Any,
) -> dict[str, Any]:
    """Return how a motion was made: what every time-optimal motion says, and ``more``."""
    return {
        "method": method,
        "excess": excess,
        "solver": solution.attempts[-1].solver,
        "gap": solution.gap.total,  # s: from the local optimum of the smoothed task, at most
        "intervals": [phase.mesh.size - 1 for phase in solution.phases],
        "phase_durations": [phase.duration for phase in solution.phases],
        "multipliers": multipliers_of(solution, family),
        "limits_digest": limits_digest(family.robot.limits),
        **more,
        "wall_time": wall_time,
        "smoothing": smoothing,
        "casadi": ca.CasadiMeta.version(),
    }


def multipliers_of(solution: Solution, family: LimitFamily) -> dict[str, Any] | None:
    """Return slopes of the duration of a motion by the limits of a family, as plain values.

    Distances that a search adds to them, other ones in every segment, have none.

    Returns
    -------
    dict or None
        "lower" and "upper" have s per unit of each bound by the key of its limit, "via" [m][n]
        s/rad (s/m) of the via points. "rows" has by key the times "t", s, and what the duration
        gains "slopes" [K][k] for each unit that the quantity is larger there. "beside" is what a
        datum may change beside the duration, s: the smoothing of the squared jerk, by the fifth
        power of a time that scales, and what the solver left. None where the solver gave no
        multipliers, and of a solution without a program.
    """
    if solution.variable_multipliers is None or any(p.layout is None for p in solution.phases):
        return None
    sides: dict[str, dict[str, FloatArray]] = {"lower": {}, "upper": {}}
    via: dict[int, dict[int, float]] = defaultdict(dict)
    rows: dict[str, dict[float, FloatArray]] = defaultdict(dict)
    start = 0.0
    for number, phase in enumerate(solution.phases):
        for entry, times, multipliers in _bounds(solution, phase):
            name, _, side = entry.name.partition(", ")  # "tool speed, upper limit": one that varies
            key = KEYS.get(name, name.replace(" ", "_"))
            slopes = (-1.0 if side.startswith("lower") else 1.0) * multipliers / entry.scale
            if entry.kind in ("initial", "final"):
                if key == "q":
                    at = number + (entry.kind == "final")
                    via[at][entry.component] = -float(slopes.sum())
                continue
            if key not in family:
                continue
            for side, sign in (("lower", -1.0), ("upper", 1.0)):
                amounts = sides[side].setdefault(key, np.zeros(entry.size))
                amounts[entry.component] -= slopes[sign * slopes > 0].sum()
            if key in MotionSamples._fields:  # no slopes over time are given for these
                continue
            for t, slope in zip((start + times).tolist(), slopes, strict=True):
                rows[key].setdefault(t, np.zeros(entry.size))[entry.component] += slope
        start += phase.duration
    count = solution.phases[0]["q"].shape[1]
    points = np.array([[via[k].get(j, 0.0) for j in range(count)] for k in sorted(via)])
    return {
        **_plain(sides),
        "via": _plain(points),
        "beside": 5 * abs(solution.cost - start) + abs(solution.gap.slack),
        "rows": {
            key: {"t": sorted(row), "slopes": _plain(np.array([row[t] for t in sorted(row)]))}
            for key, row in rows.items()
        },
    }


def _bounds(
    solution: Solution, phase: PhaseSolution
) -> Iterator[tuple[TableEntry, FloatArray, FloatArray]]:
    """Yield every bounded row and variable of a phase, with times [M], s, and multipliers [M]."""
    layout = phase.layout
    assert layout is not None
    assert solution.variable_multipliers is not None
    kinds = {"state", "control", "bound", "constraint", "initial", "final"}
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
    """Return nested lists of numbers with so many digits as they are known to."""
    if isinstance(values, dict):
        return {key: _plain(entry) for key, entry in values.items()}
    if values.ndim > 1:
        return [_plain(row) for row in values]
    return [float(f"{value:.{DIGITS}g}") for value in values]
