"""A table as data, and everything that is written from it."""

from __future__ import annotations

import csv
import io
from xml.etree import ElementTree

import numpy as np
import pytest
from rich.console import Console

import microbot_ocp as mo


@pytest.fixture
def table():
    columns = (
        mo.Column("method | way", left=True),
        mo.Column("T", "s", ".2f", bar=True),
        mo.Column("count"),
        mo.Column("worst", "%", lambda share: f"{100 * share:.0f}"),
    )
    rows = [("cubic <b>", 1.0 / 3, 3, 0.123), ("spline [s]", None, 12, np.nan)]
    return mo.Table(columns, rows, "a title", ["a note"], ["", "bad"])


def test_cells_are_typed_and_what_is_unknown_is_a_dash(table):
    assert table.heads == ["method | way", "T [s]", "count", "worst [%]"]
    assert table.cells == [["cubic <b>", "0.33", "3", "12"], ["spline [s]", "–", "12", "–"]]
    with pytest.raises(ValueError, match="zip"):
        _ = mo.Table(table.columns, [("too short",)]).cells


def test_printed(table):
    assert str(table).splitlines() == [
        "a title",
        "method | way  T [s]  count  worst [%]",
        "cubic <b>      0.33      3         12",
        "spline [s]        –     12          –",
        "a note",
    ]


def test_columns_left_out(table):
    less = table.without("T", "worst")
    assert less.heads == ["method | way", "count"]
    assert less.cells == [["cubic <b>", "3"], ["spline [s]", "12"]]
    assert (less.title, less.notes) == ("a title", ["a note"])


def test_markdown(table):
    assert table.markdown().splitlines() == [
        "### a title",
        "",
        "| method \\| way | T [s] | count | worst [%] |",
        "| --- | ---: | ---: | ---: |",
        "| cubic <b> | 0.33 | 3 | 12 |",
        "| spline [s] | – | 12 | – |",
        "",
        "- a note",
    ]


def test_csv_holds_the_numbers_in_full(table, tmp_path):
    with table.write_csv(tmp_path / "a.csv").open(encoding="utf-8", newline="") as stream:
        head, first, second = csv.reader(stream)
    assert head == table.heads
    assert float(first[1]) == 1.0 / 3
    assert (second[1], second[3]) == ("", "")


def test_a_notebook_shows_it_escaped_with_bars_and_alignment(table):
    page = ElementTree.fromstring(table._repr_html_())
    rows = page.findall(".//tbody/tr")
    assert "".join(rows[0][0].itertext()) == "cubic <b>"
    assert "width:2.67em" in rows[0][1].find("span").get("style")
    assert "text-align:left" in rows[0][0].get("style")
    assert "text-align:right" in rows[0][1].get("style")
    assert rows[1][1].find("span") is None
    assert "color" in rows[1].get("style")


@pytest.mark.parametrize("width", [40, 120])
def test_a_console_shows_it_within_its_width(table, width):
    stream = io.StringIO()
    Console(file=stream, width=width).print(table)
    lines = stream.getvalue().splitlines()
    assert max(map(len, lines)) <= width
    assert lines[0].rstrip() == "a title"
    assert lines[-1] == "• a note"
    assert "spline [s]" in stream.getvalue()
