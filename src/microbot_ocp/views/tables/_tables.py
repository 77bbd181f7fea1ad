"""A comparison as rows, as a table for the terminal, as Markdown, CSV and JSON."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Group
from rich.table import Table
from rich.text import Text

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.comparison import Certificate, Comparison, Entry, LimitCheck
from microbot_ocp.views._scene import display_unit
from microbot_ocp.views.plots._style import entry_styles

SCHEMA = 1
SHOWN_JOINTS = 4  # more joints than this: the table shows the busiest one only
NOTHING = "–"

Row = dict[str, Any]


def comparison_rows(comparison: Comparison) -> list[Row]:
    """One plain row an entry, ready for strict JSON: what is not known or not finite is None.

    Returns
    -------
    list of dict
        ``name``, ``title``, ``status``, ``duration`` (s), ``ratio`` (duration over the
        reference's), ``utilisation`` (quantity -> joint -> largest share of the limit, 1 is the
        limit), ``torque_squared`` ((N m)^2 s), ``work`` (J), ``certificate_ok``, ``verdict``,
        ``verdict_short``, ``worst_violation`` (quantity, joint, time, value, limit, unit and
        relative size; None where every limit holds), ``final_position_error`` (rad),
        ``final_velocity_error`` (rad/s), ``saturated_fraction``, ``condition_peak``,
        ``solve_time`` (s), ``note``, ``marks`` (time and name).
    """
    reference = _reference_duration(comparison)
    return [_row(comparison, entry, reference) for entry in comparison.entries]


def comparison_table(comparison: Comparison) -> Table:
    """Table for a terminal of 120 columns or more; :func:`comparison_notes` goes below it."""
    rows = comparison_rows(comparison)
    limited = [q for q in ("qd", "tau") if any(_shares(row, q) for row in rows)]
    table = Table(
        title=Text(table_title(comparison), style="bold"),
        title_justify="left",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
    )
    # Text, not str: rich would read "[s]" as markup
    table.add_column(Text("method"), overflow="fold", min_width=12)
    table.add_column(Text("T [s]"), justify="right", no_wrap=True)
    table.add_column(Text("ratio"), justify="right", no_wrap=True)
    for quantity in limited:
        table.add_column(Text(f"peak {quantity} [%]"), justify="right", overflow="fold")
    table.add_column(Text("∫tau² [(N m)² s]"), justify="right", overflow="fold")
    table.add_column(Text("work [J]"), justify="right", no_wrap=True)
    table.add_column(Text("certificate"), overflow="fold", min_width=10)
    table.add_column(Text("solve [s]"), justify="right", no_wrap=True)
    for row in rows:
        table.add_row(*map(Text, _cells(row, limited)), style=_row_style(row))
    return table


def _row_style(row: Row) -> str | None:
    if row["duration"] is None:
        return "dim"
    return "red" if row["certificate_ok"] is False else None


def comparison_notes(comparison: Comparison) -> Group:
    """What the table has no room for: failures, refused certificates, notes, how to read it."""
    lines = [Text("• ").append(sentence) for sentence in note_sentences(comparison)]
    return Group(*lines)


def comparison_markdown(comparison: Comparison) -> str:
    """The table and its notes as Markdown."""
    heads, rows = narrow_table(comparison)
    lines = [
        f"### {table_title(comparison)}",
        "",
        "| " + " | ".join(heads) + " |",
        "|" + " --- |" * len(heads),
    ]
    for row in rows:
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |")
    notes = [f"- {sentence}" for sentence in note_sentences(comparison)]
    return "\n".join([*lines, "", *notes, ""])


def narrow_table(comparison: Comparison) -> tuple[list[str], list[list[str]]]:
    """Heads and rows of text where there is room for the main columns only."""
    rows = comparison_rows(comparison)
    limited = [q for q in ("qd", "tau") if any(_shares(row, q) for row in rows)]
    peaks = [f"peak {quantity} [%]" for quantity in limited]
    cells = [_cells(row, limited) for row in rows]
    kept = [[*row[: 3 + len(limited)], *row[-2:]] for row in cells]
    return ["method", "T [s]", "ratio", *peaks, "certificate", "solve [s]"], kept


def write_csv(comparison: Comparison, path: str | Path) -> Path:
    """Write the rows as CSV, one column a joint for every limited quantity; unknown is empty."""
    rows = [_flat(row) for row in comparison_rows(comparison)]
    columns = list(dict.fromkeys(key for row in rows for key in row))
    target = Path(path)
    with target.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, columns, restval="")
        writer.writeheader()
        writer.writerows(rows)
    return target


def write_json(comparison: Comparison, path: str | Path) -> Path:
    """Write task and rows as strict JSON: NaN and infinity become null."""
    robot = comparison.robot
    document = {
        "schema": SCHEMA,
        "robot": robot.name,
        "joints": [
            {"name": name, "type": kind}
            for name, kind in zip(robot.joint_names, robot.joint_types, strict=True)
        ],
        "via_q": comparison.via_q,
        "via_q_unit": [robot.unit("q", j) for j in range(robot.joint_count)],
        "via_q_deg": _degrees(comparison),
        "limits": comparison.limits.as_dict(),
        "reference": comparison.reference,
        "entries": comparison_rows(comparison),
    }
    target = Path(path)
    text = json.dumps(_plain(document), indent=2, ensure_ascii=False, allow_nan=False)
    target.write_text(text + "\n", encoding="utf-8")
    return target


def _degrees(comparison: Comparison) -> FloatArray:
    """Via points [m,n] in degrees; NaN for a prismatic joint."""
    types = comparison.robot.joint_types
    scale = [180.0 / np.pi if kind == "revolute" else np.nan for kind in types]
    return np.round(comparison.via_q * scale, 10)  # 30, not 29.999999999999996


def _plain(value: Any) -> Any:
    """Plain JSON values; numbers that are not finite become None."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value


def _reference_duration(comparison: Comparison) -> float:
    for entry in comparison.entries:
        if entry.name == comparison.reference and entry.motion is not None:
            return entry.motion.duration
    return math.nan


def _row(comparison: Comparison, entry: Entry, reference: float) -> Row:
    motion, certificate = entry.motion, entry.certificate
    duration = motion.duration if motion is not None else math.nan
    row = {
        "name": entry.name,
        "title": entry_styles(comparison)[entry.name].title,
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
    return _plain(row)


def _utilisation(comparison: Comparison, certificate: Certificate | None) -> Row:
    names = comparison.robot.joint_names
    checks = certificate.limit_checks if certificate is not None else ()
    return {c.quantity: dict(zip(names, c.utilisation.tolist(), strict=True)) for c in checks}


def _proof(certificate: Certificate | None) -> Row:
    if certificate is None:
        unknown = (
            "certificate_ok",
            "verdict",
            "worst_violation",
            "final_position_error",
            "final_velocity_error",
            "saturated_fraction",
            "condition_peak",
        )
        return {**dict.fromkeys(unknown), "verdict_short": None}
    return {
        "certificate_ok": certificate.ok,
        "verdict": certificate.verdict,
        "verdict_short": _short_verdict(certificate),
        "worst_violation": _violation(_worst_check(certificate)),
        "final_position_error": certificate.final_position_error,
        "final_velocity_error": certificate.final_velocity_error,
        "saturated_fraction": certificate.saturated_fraction,
        "condition_peak": certificate.condition_peak,
    }


def _worst_check(certificate: Certificate) -> LimitCheck | None:
    broken = [check for check in certificate.limit_checks if check.violation > 0]
    return max(broken, key=lambda check: check.violation, default=None)


def _violation(check: LimitCheck | None) -> Row | None:
    if check is None:
        return None
    return {
        "quantity": check.quantity,
        "joint": check.joint,
        "time": check.time,
        "value": check.value,
        "limit": check.limit,
        "unit": check.unit,
        "relative": check.violation,
    }


def _short_verdict(certificate: Certificate) -> str:
    if certificate.ok:
        return "ok"
    worst = _worst_check(certificate)
    if not certificate.resimulation_status.solved:
        return "FAILED: re-simulation"
    if worst is not None and worst.violation > 1e-6:
        return f"FAILED: {worst.quantity} {worst.joint} +{_percent(worst.violation)}"
    return "FAILED"


def _percent(share: float) -> str:
    percent = 100 * share
    return f"{percent:.2g} %" if percent < 10 else f"{percent:.0f} %"


def _shares(row: Row, quantity: str) -> dict[str, float]:
    """Known utilisation of a quantity by joint."""
    shares = row["utilisation"].get(quantity, {})
    return {joint: share for joint, share in shares.items() if share is not None}


def _percentages(row: Row, quantity: str) -> str:
    shares = row["utilisation"].get(quantity, {})
    known = _shares(row, quantity)
    if not known:
        return NOTHING
    if len(shares) > SHOWN_JOINTS:
        joint = max(known, key=known.__getitem__)
        return f"{100 * known[joint]:.0f} ({joint})"
    return "/".join(NOTHING if s is None else f"{100 * s:.0f}" for s in shares.values())


def _cells(row: Row, limited: list[str]) -> list[str]:
    if row["duration"] is None:
        verdict = f"not solved: {row['status']}"
    else:
        verdict = row["verdict_short"] or "not checked"
    return [
        row["title"],
        _fixed(row["duration"], 3),
        _fixed(row["ratio"], 3),
        *(_percentages(row, quantity) for quantity in limited),
        _significant(row["torque_squared"]),
        _significant(row["work"]),
        verdict,
        _significant(row["solve_time"]),
    ]


def _fixed(value: float | None, digits: int) -> str:
    return NOTHING if value is None else f"{value:.{digits}f}"


def _significant(value: float | None) -> str:
    """Three significant digits without an exponent for what tables usually hold."""
    if value is None:
        return NOTHING
    if value == 0 or not 1e-3 <= abs(value) < 1e7:
        return f"{value:.3g}"
    digits = max(0, 2 - math.floor(math.log10(abs(value))))
    return f"{value:,.{digits}f}"


def table_title(comparison: Comparison) -> str:
    robot = comparison.robot
    shown = ", ".join(
        f"({_point(comparison, via)})" for via in range(min(len(comparison.via_q), 4))
    )
    more = ", ..." if len(comparison.via_q) > 4 else ""
    units = {display_unit(robot, "q", j) for j in range(robot.joint_count)}
    unit = next(iter(units)) if len(units) == 1 else "deg or m"
    return f"{robot.name} through {shown}{more} {unit}"


def _point(comparison: Comparison, via: int) -> str:
    degrees = _degrees(comparison)[via]
    values = np.where(np.isnan(degrees), comparison.via_q[via], degrees)
    return ", ".join(f"{round(value, 6) + 0.0:.4g}" for value in values)


def note_sentences(comparison: Comparison) -> Iterator[str]:
    rows = comparison_rows(comparison)
    joints = comparison.robot.joint_names
    order = "/".join(joints) if len(joints) <= SHOWN_JOINTS else "busiest joint only"
    reference = _reference_title(rows, comparison)
    yield f"Peaks: largest share of the limit ({order}). Ratio: to {reference}."
    for row in rows:
        told = []
        if row["duration"] is None:
            told.append(f"not solved: {row['status']}")
        if row["certificate_ok"] is False:
            told.append(f"certificate refused: {row['verdict']}")
            told += _violation_words(row["worst_violation"], row["verdict"])
        if row["note"]:
            told.append(row["note"])
        if told:
            yield f"{row['title']}: " + "; ".join(told) + "."


def _violation_words(violation: Row | None, verdict: str) -> list[str]:
    if violation is None or violation["joint"] in verdict:  # the verdict tells it already
        return []
    value, limit, time = (violation[key] for key in ("value", "limit", "time"))
    if value is None or limit is None or time is None:
        return []
    return [
        f"{violation['quantity']} of {violation['joint']} reaches {value:.4g} {violation['unit']} "
        f"at {time:.3f} s, limit {limit:.4g}"
    ]


def _reference_title(rows: list[Row], comparison: Comparison) -> str:
    for row in rows:
        if row["name"] == comparison.reference:
            return row["title"]
    return comparison.reference


def _flat(row: Row) -> Row:
    """One level only: a column for each joint's utilisation and for what is worst violated."""
    flat: Row = {}
    for key, value in row.items():
        if key == "utilisation":
            for quantity, shares in value.items():
                for joint, share in shares.items():
                    flat[f"utilisation_{quantity}_{joint}"] = share
        elif key == "worst_violation":
            for part in ("quantity", "joint", "time", "value", "limit", "unit", "relative"):
                flat[f"worst_violation_{part}"] = value[part] if value else None
        elif key == "marks":
            flat[key] = "; ".join(f"{mark['time']:.6g} {mark['name']}" for mark in value)
        else:
            flat[key] = value
    return {key: "" if value is None else value for key, value in flat.items()}
