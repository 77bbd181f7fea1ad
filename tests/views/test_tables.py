"""Rows, terminal table, Markdown, CSV and JSON of a comparison."""

import csv
import io
import json
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from helpers import tells
from microbot_ocp.views import tables


def printed(renderable, width=120):
    stream = io.StringIO()
    Console(file=stream, width=width).print(renderable)
    return stream.getvalue()


def strict(text):
    def refuse(constant):
        raise AssertionError(f"{constant} is not JSON")

    return json.loads(text, parse_constant=refuse)


def test_rows(comparison):
    rows = tables.comparison_rows(comparison)
    assert [row["name"] for row in rows] == ["cubic_report", "cubic", "time_optimal", "lspb"]
    report, cubic, fast, failed = rows
    assert report["ratio"] == 1.0
    assert cubic["duration"] == pytest.approx(2.6)
    assert cubic["ratio"] == pytest.approx(2.6 / 3.4)
    motion = comparison.entries[2].motion
    peak = np.abs(motion.qd).max(axis=0) / 2.0
    assert list(fast["utilisation"]["qd"]) == ["waist", "shoulder", "elbow"]
    np.testing.assert_allclose(list(fast["utilisation"]["qd"].values()), peak)
    assert fast["certificate_ok"] is False
    assert fast["worst_violation"]["quantity"] == "tau"
    assert fast["worst_violation"]["joint"] == "elbow"
    assert fast["verdict_short"].startswith("FAILED: torque of elbow +")
    assert fast["marks"][1] == {"time": 0.7, "name": "via 2"}
    assert failed["status"] == "infeasible"
    for key in ("duration", "ratio", "torque_squared", "work", "certificate_ok", "verdict"):
        assert failed[key] is None
    strict(json.dumps(rows, allow_nan=False))


def test_ratio_without_the_reference_is_unknown(comparison):
    rows = tables.comparison_rows(replace(comparison, reference="lspb"))
    assert {row["ratio"] for row in rows} == {None}


def test_table_fits_120_columns(comparison):
    text = printed(tables.comparison_table(comparison))
    assert max(len(line) for line in text.splitlines()) <= 120
    assert "…" not in text
    for words in ("T [s]", "solve [s]", "peak qd [%]", "60/37/44", "3.400", "0.765"):
        assert words in text
    assert "not solved:" in text
    assert "\x1b" not in text  # no colours into a file


def test_notes_tell_failures_and_refusals(comparison):
    text = printed(comparison.table(), width=200)
    tells(text, "LSPB, scaled", "not solved", "infeasible")
    tells(text, "certificate refused", "torque of elbow", "via point")


def test_a_comparison_prints_its_table(comparison):
    head, first, *_ = str(comparison.table()).splitlines()[1:]
    assert head.split()[:3] == ["method", "T", "[s]"]
    assert first.split()[:9] == [
        "cubic,",
        "as",
        "in",
        "the",
        "report",
        "3.400",
        "1.000",
        "60/37/44",
        "21/96/110",
    ]


def test_brackets_in_names_are_printed(comparison):
    entry = replace(comparison.entries[0], title="mine [s]")
    text = printed(tables.comparison_table(replace(comparison, entries=(entry,))))
    assert "mine [s]" in text


def test_uncertified_entry_says_so(comparison):
    entry = replace(comparison.entries[0], certificate=None)
    bare = replace(comparison, entries=(entry,))
    assert "not checked" in printed(tables.comparison_table(bare))
    assert "peak" not in printed(tables.comparison_table(bare)).split("Peaks")[0]


def test_markdown(comparison):
    lines = tables.narrow_table(comparison).markdown().splitlines()
    body = [line for line in lines if line.startswith("|")]
    assert len(body) == 2 + 4
    assert len({line.count("|") for line in body}) == 1


def test_json_is_strict_and_complete(comparison, tmp_path):
    path = tables.write_json(comparison, tmp_path / "comparison.json")
    document = strict(path.read_text(encoding="utf-8"))
    assert document["robot"] == "microbot"
    np.testing.assert_allclose(document["via_q"], comparison.via_q)
    np.testing.assert_allclose(document["via_q_deg"][2], [-90, 90, 90])
    assert document["limits"]["tau_max"] == [400.0, 500.0, 200.0]
    assert document["limits"]["qdd_max"] == [None, None, None]
    assert document["reference"] == "cubic_report"
    assert document["entries"] == tables.comparison_rows(comparison)


def test_csv(comparison, tmp_path):
    path = tables.write_csv(comparison, tmp_path / "comparison.csv")
    with path.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 4
    assert float(rows[1]["duration"]) == pytest.approx(2.6)
    expected = comparison.entries[0].certificate.limit_checks[2].utilisation[1]
    assert float(rows[0]["utilisation_tau_shoulder"]) == pytest.approx(expected)
    assert rows[3]["duration"] == rows[3]["utilisation_tau_shoulder"] == ""
    assert rows[0]["marks"] == "0 via 1; 1.6 via 2; 3.4 via 3"
