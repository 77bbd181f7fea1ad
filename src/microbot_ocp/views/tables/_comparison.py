"""Rows of a comparison, its table, and its files CSV and JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ocp._base.checks import plain
from microbot_ocp._base.status import Status
from microbot_ocp._base.table import NOTHING, Column, Table
from microbot_ocp._base.writing import write_whole
from microbot_ocp.certificate import Certificate, LimitCheck
from microbot_ocp.limits import JOINT_QUANTITIES, LimitFamily, not_judged, quantity_name
from microbot_ocp.tasks import Comparison, Entry
from microbot_ocp.views._style import SIDE_BY_SIDE, entry_title
from microbot_ocp.views.tables._terminal import in_degrees, joint_units

JUDGED = ("certificate_ok", "verdict", "verdict_short", "unjudged", "worst_violation")
MEASURED = (
    "defect",
    "amplification",
    "final_position_error",
    "final_velocity_error",
    "saturated_fraction",
    "condition_peak",
)
VIOLATION = ("quantity", "joint", "time", "value", "limit", "unit")  # keys of the worst violation

EXECUTED = {"executed_duration": "T executed", "trackable_duration": "T trackable"}

Row = dict[str, Any]


def comparison_rows(comparison: Comparison) -> list[Row]:
    """Return one row of plain values per entry, ready for strict JSON; unknown values are None.

    Returns
    -------
    list of dict
        ``name``, ``title``, ``status``, ``duration`` (s), ``ratio`` (duration relative to the
        reference), ``utilisation`` (quantity -> joint -> largest share of the limit; 1 is the
        limit), ``torque_squared`` ((N m)^2 s), ``work`` (J), ``certificate_ok``, ``verdict``,
        ``verdict_short``, ``unjudged`` (names of limits that need masses, for a robot without),
        ``worst_violation`` (quantity, joint, time, value, limit, unit and relative size; None if
        every limit holds), ``defect``, ``amplification``, ``final_position_error`` (rad),
        ``final_velocity_error`` (rad/s), ``saturated_fraction``, ``condition_peak``,
        ``executed_duration`` and ``trackable_duration`` (s; only with ``profile`` and
        ``trackable``), ``solve_time`` (s), ``note``, ``marks`` (time and name).
    """
    motion = comparison.motions.get(comparison.reference)
    reference = math.nan if motion is None else motion.duration
    return [_row(comparison, entry, reference) for entry in comparison.entries]


def comparison_table(comparison: Comparison) -> Table:
    """Return a table with one row per method and the peak use of every limit except positions.

    The notes explain the columns and list failures and refused certificates.
    """
    rows = comparison_rows(comparison)
    kinds = dict.fromkeys(kind for row in rows for kind in row["utilisation"] if kind != "q")
    limited = [kind for kind in kinds if any(_known(row["utilisation"].get(kind)) for row in rows)]
    pairs: list[tuple[Column, list[Any]]] = [
        (Column("method", left=True), [row["title"] for row in rows]),
        (Column("T", "s", ".3f"), [row["duration"] for row in rows]),
        (Column("ratio", show=".3f", bar=True), [row["ratio"] for row in rows]),
    ]
    for key, head in EXECUTED.items():
        if any(key in row for row in rows):
            pairs.append((Column(head, "s", ".3f"), [row.get(key) for row in rows]))
    for kind in limited:
        peaks = [row["utilisation"].get(kind) for row in rows]
        name = kind if kind in JOINT_QUANTITIES else quantity_name(kind)
        pairs.append((Column(f"peak {name}", "%", _percentages), peaks))
    pairs += [
        (Column("∫tau²", "(N m)² s", _significant), [row["torque_squared"] for row in rows]),
        (Column("work", "J", _significant), [row["work"] for row in rows]),
        (Column("certificate", left=True), [_verdict(row) for row in rows]),
        (Column("solve", "s", _significant), [row["solve_time"] for row in rows]),
    ]
    marks = [_mark(row) for row in rows]
    columns, values = zip(*pairs, strict=True)
    cells, notes = list(zip(*values, strict=True)), list(_notes(comparison, rows))
    return Table(columns, cells, _title(comparison), notes, marks)


def _verdict(row: Mapping[str, Any]) -> str:
    if row["duration"] is None:
        return f"not solved: {row['status']}"
    return row["verdict_short"] or "not checked"


def _mark(row: Mapping[str, Any]) -> str:
    """Return the mark of a row in the table."""
    if row["duration"] is None:
        return "missing"
    return "bad" if row["certificate_ok"] is False else ""


def narrow_table(comparison: Comparison) -> Table:
    """Return the table with the main columns only."""
    return comparison_table(comparison).without("∫tau²", "work")


def write_csv(comparison: Comparison, path: str | Path) -> Path:
    """Write the rows as CSV, with one column per joint and limit; unknown values are empty."""
    rows = [dict(_flat(row)) for row in comparison_rows(comparison)]
    keys = list(dict.fromkeys(key for row in rows for key in row))
    cells = [[row.get(key) for key in keys] for row in rows]
    return Table([Column(key) for key in keys], cells).write_csv(path)


def write_json(comparison: Comparison, path: str | Path) -> Path:
    """Write task and rows as strict JSON; NaN and infinity become null."""
    robot = comparison.robot
    revolute = np.array(robot.joint_types) == "revolute"
    pairs = zip(robot.joint_names, robot.joint_types, strict=True)
    document = {
        "schema": 1,
        "robot": robot.name,
        "joints": [{"name": name, "type": kind} for name, kind in pairs],
        "via_q": comparison.via_q,
        "via_q_unit": [robot.unit("q", j) for j in range(robot.joint_count)],
        "via_q_deg": np.where(revolute, in_degrees(robot, comparison.via_q), np.nan),
        "limits": comparison.limits.as_dict(),
        "reference": comparison.reference,
        "entries": comparison_rows(comparison),
    }
    text = json.dumps(plain(document), indent=2, ensure_ascii=False, allow_nan=False)
    return write_whole(path, text + "\n")


def _row(comparison: Comparison, entry: Entry, reference: float) -> Row:
    motion, certificate = entry.motion, entry.certificate
    duration = motion.duration if motion is not None else math.nan
    checks = certificate.limit_checks if certificate is not None else ()
    proof: Row = dict.fromkeys((*JUDGED, *MEASURED))
    if certificate is not None:
        worst = max((c for c in checks if c.violation > 0), key=lambda c: c.violation, default=None)
        proof = {
            "certificate_ok": certificate.ok,
            "verdict": certificate.verdict,
            "verdict_short": _short_verdict(certificate, worst),
            "unjudged": list(certificate.unjudged),
            "worst_violation": worst
            and {**{key: getattr(worst, key) for key in VIOLATION}, "relative": worst.violation},
            **{key: getattr(certificate, key) for key in MEASURED},
        }
    row = {
        "name": entry.name,
        "title": entry_title(entry),
        "status": entry.status,
        "duration": duration,
        "ratio": duration / reference,
        **{key: entry.details[key] for key in EXECUTED if key in entry.details},
        "utilisation": {
            c.quantity: {
                name or "arm": use for name, use in zip(c.labels, c.utilisation, strict=True)
            }
            for c in checks
        },
        "torque_squared": entry.torque_squared,
        "work": entry.work,
        **proof,
        "solve_time": entry.solve_time,
        "note": entry.note or (motion.note if motion is not None else ""),
        "marks": [{"time": m.time, "name": m.name} for m in (motion.marks if motion else ())],
    }
    return plain(row)


def _short_verdict(certificate: Certificate, worst: LimitCheck | None) -> str:
    if certificate.ok:
        return certificate.outcome.partition(":")[0]
    if not certificate.resimulation_status.solved:
        return "FAILED: re-simulation"
    if worst is None or worst.violation <= 1e-6:
        return "FAILED"
    percent = 100 * worst.violation
    return f"FAILED: {worst.title} +{percent:{'.2g' if percent < 10 else '.0f'}} %"


def _known(shares: Mapping[str, float | None] | None) -> dict[str, float]:
    """Return the known shares by joint."""
    return {joint: share for joint, share in (shares or {}).items() if share is not None}


def _percentages(shares: Mapping[str, float | None]) -> str:
    finite = _known(shares)
    if not finite:
        return NOTHING
    if len(shares) > SIDE_BY_SIDE:
        joint = max(finite, key=finite.__getitem__)
        return f"{100 * finite[joint]:.0f} ({joint})"
    return "/".join(NOTHING if s is None else f"{100 * s:.0f}" for s in shares.values())


def _significant(value: float) -> str:
    """Format three significant digits, without an exponent for usual sizes."""
    if value == 0 or not 1e-3 <= abs(value) < 1e7:
        return f"{value:.3g}"
    digits = max(0, 2 - math.floor(math.log10(abs(value))))
    return f"{value:,.{digits}f}"


def _title(comparison: Comparison) -> str:
    robot = comparison.robot
    points = [
        ", ".join(f"{round(value, 6) + 0.0:.4g}" for value in via)
        for via in in_degrees(robot, comparison.via_q)
    ]
    shown = ", ".join(f"({point})" for point in points[:4])
    more = ", ..." if len(comparison.via_q) > 4 else ""
    units = set(joint_units(robot))
    unit = next(iter(units)) if len(units) == 1 else "deg or m"
    return f"{robot.name} through {shown}{more} {unit}"


def _notes(comparison: Comparison, rows: list[Row]) -> Iterator[str]:
    joints = comparison.robot.joint_names
    order = " / ".join(joints) if len(joints) <= SIDE_BY_SIDE else "busiest joint only"
    titles = {row["name"]: row["title"] for row in rows}
    reference = titles.get(comparison.reference, comparison.reference)
    yield f"Peaks: largest share of the limit ({order}). Ratio: to {reference}."
    if left := not_judged(LimitFamily.of(comparison.robot).unjudged):
        yield f"{left.capitalize()}."
    for row in rows:
        remarks = []
        if row["duration"] is None:
            remarks.append(f"not solved: {row['status']}")
        elif row["status"] != Status.SOLVED:
            remarks.append(f"the best motion found, not solved: {row['status']}")
        if row["certificate_ok"] is False:
            remarks.append(f"certificate refused: {row['verdict']}")
            remarks += _violation_text(row["worst_violation"], row["verdict"])
        if row["note"]:
            remarks.append(row["note"])
        if remarks:
            yield f"{row['title']}: " + "; ".join(remarks) + "."


def _violation_text(violation: Row | None, verdict: str) -> list[str]:
    if violation is None or (violation["joint"] or violation["quantity"]) in verdict:
        return []  # the verdict names the violation already
    name, unit = quantity_name(violation["quantity"]), violation["unit"]
    value, limit, time = (violation[key] for key in ("value", "limit", "time"))
    if value is None or limit is None or time is None:
        return []
    joint = f" of {violation['joint']}" if violation["joint"] else ""
    return [f"{name}{joint} reaches {value:.4g} {unit} at {time:.3f} s, limit {limit:.4g}"]


def _flat(row: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the entries of nested mappings as columns with joined keys."""
    for key, value in row.items():
        if key == "worst_violation" and value is None:
            value = dict.fromkeys((*VIOLATION, "relative"))
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}_")
        elif key == "unjudged":
            yield key, "; ".join(value or ())
        elif key == "marks":
            yield key, "; ".join(f"{mark['time']:.6g} {mark['name']}" for mark in value)
        else:
            yield prefix + key, value
