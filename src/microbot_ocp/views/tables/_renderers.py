"""Writers of a table for the terminal and for notebooks (light and dark themes)."""

from __future__ import annotations

from html import escape
from typing import Any

from rich import box
from rich.console import Group
from rich.table import Table as RichTable
from rich.text import Text

from microbot_ocp._base.table import Column, Table
from microbot_ocp.views._style import FIXED, PREFERRED, WARNING_COLOR

STYLES = {"bad": "red", "missing": "dim"}
COLORS = {"bad": f"color:{WARNING_COLOR}", "missing": "opacity:.6"}
LOOK = "color:inherit;font-size:inherit;border-collapse:collapse"


def terminal(table: Table) -> Group:
    """Return a table for a rich console with its notes as a list below."""
    # Text instead of str, because rich reads "[s]" as markup.
    title = Text(table.title, style="bold") if table.title else None
    style: dict[str, Any] = {"box": box.SIMPLE_HEAD, "show_edge": False, "pad_edge": False}
    drawn = RichTable(title=title, title_justify="left", padding=(0, 1, 0, 0), **style)
    for place, column in enumerate(table.columns):
        longest = max((len(row[place]) for row in table.cells), default=0)
        drawn.add_column(
            Text(column.title),
            justify="left" if column.left else "right",
            overflow="fold",
            no_wrap=not place or longest <= 8,  # short cells are never broken
        )
    for row, mark in zip(table.cells, _marks(table), strict=True):
        drawn.add_row(*map(Text, row), style=STYLES.get(mark))
    notes = [Text("• ").append(note) for note in table.notes]
    return Group(drawn, *([Text("")] if notes else []), *notes)


def html(table: Table) -> str:
    """Return a table in HTML for Jupyter; a bar of 8 em represents 1."""
    head = "".join(f"<th {_style(column)}>{escape(column.title)}</th>" for column in table.columns)
    body = ""
    for row, mark in zip(table.rows, _marks(table), strict=True):
        row_style = f' style="{COLORS[mark]}"' if mark else ""
        body += f"<tr{row_style}>" + "".join(map(_cell, table.columns, row)) + "</tr>"
    drawn = f'<table style="{LOOK}"><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>'
    notes = "".join(f'<div style="font-size:90%">{escape(note)}</div>' for note in table.notes)
    title = f"<b>{escape(table.title)}</b>" if table.title else ""
    return f"<div>{title}{drawn}{notes}</div>"


def _marks(table: Table) -> list[str]:
    return list(table.emphasis) or [""] * len(table.rows)


def _style(column: Column) -> str:
    return f'style="padding:.15em .7em;text-align:{"left" if column.left else "right"}"'


def _cell(column: Column, value: object) -> str:
    text = escape(column.text(value))
    if column.bar and isinstance(value, int | float):
        width, color = 8 * min(value, 4), FIXED[PREFERRED][0]
        look = f"width:{width:.2f}em;height:.7em;background:{color};opacity:.75"
        text += f' <span style="display:inline-block;{look}"></span>'
    return f"<td {_style(column)}>{text}</td>"
