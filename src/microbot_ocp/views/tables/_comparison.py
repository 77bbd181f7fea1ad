"""A comparison as rows, as a table, and as the files CSV and JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ocp._base.checks import FloatArray, plain
from microbot_ocp._base.table import NOTHING, Column, Table
from microbot_ocp._base.writing import write_whole
from microbot_ocp.comparison import Certificate, Comparison, Entry, LimitCheck
from microbot_ocp.limits import JOINT_QUANTITIES, LimitFamily, not_judged, quantity_name
from microbot_ocp.views._scene import display_factor, display_unit
from microbot_ocp.views._style import entry_title

SCHEMA = 1
SHOWN_JOINTS = 4  # more joints than this: the table shows the busiest one only
JUDGED = ("certificate_ok", "verdict", "verdict_short", "unjudged", "worst_violation")
MEASURED = (
    "defect",
    "amplification",
    "final_position_error",
    "final_velocity_error",
    "saturated_fraction",
    "condition_peak",
)
PLACE = ("quantity", "joint", "time", "value", "limit", "unit")  # of the worst violation

Row = dict[str, Any]


WHOLE = "arm"  # in the place of a joint's name, for a limit of one number


def comparison_rows(comparison: Comparison) -> list[Row]:
    """One plain row an entry, ready for strict JSON: what is not known or not finite is None.

    Returns
    -------
    list of dict
        ``name``, ``title``, ``status``, ``duration`` (s), ``ratio`` (duration over the
        reference's), ``utilisation`` (quantity -> joint -> largest share of the limit, 1 is the
        limit), ``torque_squared`` ((N m)^2 s), ``work`` (J), ``certificate_ok``, ``verdict``,
        ``verdict_short``, ``unjudged`` (names of limits that need masses that the robot has not),
        ``worst_violation`` (quantity, joint, time, value, limit, unit and
        relative size; None where every limit holds), ``defect``, ``amplification``,
        ``final_position_error`` (rad), ``final_velocity_error`` (rad/s), ``saturated_fraction``,
        ``condition_peak``,
        ``solve_time`` (s), ``note``, ``marks`` (time and name).
    """
    motion = comparison.motions.get(comparison.reference)
    reference = math.nan if motion is None else motion.duration
    return [_row(comparison, entry, reference) for entry in comparison.entries]


def comparison_table(comparison: Comparison) -> Table:
    """One row a method, with a column for the peak use of every kind of limit but the position's.

    The notes give failures, refused certificates and how to read the table.
    """
    rows = comparison_rows(comparison)
    kinds = dict.fromkeys(kind for row in rows for kind in row["utilisation"] if kind != "q")
    limited = [kind for kind in kinds if any(_known(row["utilisation"].get(kind)) for row in rows)]
    columns = (
        Column("method", left=True),
        Column("T", "s", ".3f"),
        Column("ratio", show=".3f", bar=True),
        *(Column(f"peak {_short_name(kind)}", "%", _percentages) for kind in limited),
        Column("∫tau²", "(N m)² s", _significant),
        Column("work", "J", _significant),
        Column("certificate", left=True),
        Column("solve", "s", _significant),
    )
    cells = [
        (
            row["title"],
            row["duration"],
            row["ratio"],
            *(row["utilisation"].get(kind) for kind in limited),
            row["torque_squared"],
            row["work"],
            _verdict(row),
            row["solve_time"],
        )
        for row in rows
    ]
    marks = [_mark(row) for row in rows]
    notes = list(_notes(comparison, rows))
    return Table(columns, cells, _title(comparison), notes, marks)


def narrow_table(comparison: Comparison) -> Table:
    """The table where there is room for the main columns only."""
    return comparison_table(comparison).without("∫tau²", "work")


def _mark(row: Row) -> str:
    if row["duration"] is None:
        return "missing"
    return "bad" if row["certificate_ok"] is False else ""


def _verdict(row: Row) -> str:
    if row["duration"] is None:
        return f"not solved: {row['status']}"
    return row["verdict_short"] or "not checked"


def write_csv(comparison: Comparison, path: str | Path) -> Path:
    """Write the rows as CSV, one column a joint for every limited quantity; unknown is empty."""
    rows = [_flat(row) for row in comparison_rows(comparison)]
    keys = list(dict.fromkeys(key for row in rows for key in row))
    cells = [[row.get(key) for key in keys] for row in rows]
    return Table([Column(key) for key in keys], cells).write_csv(path)


def write_json(comparison: Comparison, path: str | Path) -> Path:
    """Write task and rows as strict JSON: NaN and infinity become null."""
    robot = comparison.robot
    revolute = np.array(robot.joint_types) == "revolute"
    document = {
        "schema": SCHEMA,
        "robot": robot.name,
        "joints": [
            {"name": name, "type": kind}
            for name, kind in zip(robot.joint_names, robot.joint_types, strict=True)
        ],
        "via_q": comparison.via_q,
        "via_q_unit": [robot.unit("q", j) for j in range(robot.joint_count)],
        "via_q_deg": np.where(revolute, _shown_via(comparison), np.nan),
        "limits": comparison.limits.as_dict(),
        "reference": comparison.reference,
        "entries": comparison_rows(comparison),
    }
    text = json.dumps(plain(document), indent=2, ensure_ascii=False, allow_nan=False)
    return write_whole(path, text + "\n")


def _shown_via(comparison: Comparison) -> FloatArray:
    """Via points [m,n] in degrees, of prismatic joints in m."""
    robot = comparison.robot
    factors = [display_factor(robot, "q", joint) for joint in range(robot.joint_count)]
    return np.round(comparison.via_q * factors, 10)  # 30, not 29.999999999999996


def _row(comparison: Comparison, entry: Entry, reference: float) -> Row:
    motion, certificate = entry.motion, entry.certificate
    duration = motion.duration if motion is not None else math.nan
    row = {
        "name": entry.name,
        "title": entry_title(entry),
        "status": entry.status,
        "duration": duration,
        "ratio": duration / reference,
        "utilisation": _utilisation(comparison, certificate),
        "torque_squared": entry.torque_squared,
        "work": entry.work,
        **_proof(certificate),
        "solve_time": entry.solve_time,
        "note": entry.note or (motion.note if motion is not None else ""),
        "marks": [{"time": m.time, "name": m.name} for m in (motion.marks if motion else ())],
    }
    return plain(row)


def _utilisation(comparison: Comparison, certificate: Certificate | None) -> Row:
    checks = certificate.limit_checks if certificate is not None else ()
    return {
        c.quantity: dict(
            zip((name or WHOLE for name in c.labels), c.utilisation.tolist(), strict=True)
        )
        for c in checks
    }


def _proof(certificate: Certificate | None) -> Row:
    if certificate is None:
        return dict.fromkeys((*JUDGED, *MEASURED))
    short, unjudged = _short_verdict(certificate), list(certificate.unjudged)
    judged = certificate.ok, certificate.verdict, short, unjudged, _worst(certificate)
    measured = {key: getattr(certificate, key) for key in MEASURED}
    return dict(zip(JUDGED, judged, strict=True)) | measured


def _worst_check(certificate: Certificate) -> LimitCheck | None:
    broken = [check for check in certificate.limit_checks if check.violation > 0]
    return max(broken, key=lambda check: check.violation, default=None)


def _worst(certificate: Certificate) -> Row | None:
    check = _worst_check(certificate)
    if check is None:
        return None
    return {key: getattr(check, key) for key in PLACE} | {"relative": check.violation}


def _short_verdict(certificate: Certificate) -> str:
    if certificate.ok:
        return certificate.outcome.partition(":")[0]
    worst = _worst_check(certificate)
    if not certificate.resimulation_status.solved:
        return "FAILED: re-simulation"
    if worst is not None and worst.violation > 1e-6:
        place = f"{_short_name(worst.quantity)} {worst.joint}".strip()
        return f"FAILED: {place} +{_percent(worst.violation)}"
    return "FAILED"


def _short_name(quantity: str) -> str:
    """The symbol of a quantity of the joints, the name of any other."""
    return quantity if quantity in JOINT_QUANTITIES else quantity_name(quantity)


def _percent(share: float) -> str:
    percent = 100 * share
    return f"{percent:.2g} %" if percent < 10 else f"{percent:.0f} %"


def _known(shares: Mapping[str, float | None] | None) -> dict[str, float]:
    """Known shares by joint."""
    return {joint: share for joint, share in (shares or {}).items() if share is not None}


def _percentages(shares: Mapping[str, float | None]) -> str:
    known = _known(shares)
    if not known:
        return NOTHING
    if len(shares) > SHOWN_JOINTS:
        joint = max(known, key=known.__getitem__)
        return f"{100 * known[joint]:.0f} ({joint})"
    return "/".join(NOTHING if s is None else f"{100 * s:.0f}" for s in shares.values())


def _significant(value: float) -> str:
    """Three significant digits without an exponent for what tables usually hold."""
    if value == 0 or not 1e-3 <= abs(value) < 1e7:
        return f"{value:.3g}"
    digits = max(0, 2 - math.floor(math.log10(abs(value))))
    return f"{value:,.{digits}f}"


def _title(comparison: Comparison) -> str:
    robot = comparison.robot
    points = [
        ", ".join(f"{round(value, 6) + 0.0:.4g}" for value in via) for via in _shown_via(comparison)
    ]
    shown = ", ".join(f"({point})" for point in points[:4])
    more = ", ..." if len(comparison.via_q) > 4 else ""
    units = {display_unit(robot, "q", j) for j in range(robot.joint_count)}
    unit = next(iter(units)) if len(units) == 1 else "deg or m"
    return f"{robot.name} through {shown}{more} {unit}"


def _notes(comparison: Comparison, rows: list[Row]) -> Iterator[str]:
    joints = comparison.robot.joint_names
    order = " / ".join(joints) if len(joints) <= SHOWN_JOINTS else "busiest joint only"
    titles = {row["name"]: row["title"] for row in rows}
    reference = titles.get(comparison.reference, comparison.reference)
    yield f"Peaks: largest share of the limit ({order}). Ratio: to {reference}."
    if left := not_judged(LimitFamily.of(comparison.robot).unjudged):
        yield f"{left.capitalize()}."
    for row in rows:
        remarks = []
        if row["duration"] is None:
            remarks.append(f"not solved: {row['status']}")
        if row["certificate_ok"] is False:
            remarks.append(f"certificate refused: {row['verdict']}")
            remarks += _violation_text(row["worst_violation"], row["verdict"])
        if row["note"]:
            remarks.append(row["note"])
        if remarks:
            yield f"{row['title']}: " + "; ".join(remarks) + "."


def _violation_text(violation: Row | None, verdict: str) -> list[str]:
    if violation is None or (violation["joint"] or violation["quantity"]) in verdict:
        return []  # the verdict says so already
    value, limit, time = (violation[key] for key in ("value", "limit", "time"))
    if value is None or limit is None or time is None:
        return []
    joint = f" of {violation['joint']}" if violation["joint"] else ""
    return [
        f"{_short_name(violation['quantity'])}{joint} reaches {value:.4g} {violation['unit']} "
        f"at {time:.3f} s, limit {limit:.4g}"
    ]


def _flat(row: Row) -> Row:
    """One level only: a column for each joint's utilisation and for what is worst violated."""
    flat: Row = {}
    for key, value in row.items():
        if key == "utilisation":
            for quantity, shares in value.items():
                for joint, share in shares.items():
                    flat[f"utilisation_{quantity}_{joint}"] = share
        elif key == "worst_violation":
            for part in (*PLACE, "relative"):
                flat[f"worst_violation_{part}"] = value[part] if value else None
        elif key == "unjudged":
            flat[key] = "; ".join(value or ())
        elif key == "marks":
            flat[key] = "; ".join(f"{mark['time']:.6g} {mark['name']}" for mark in value)
        else:
            flat[key] = value
    return flat
