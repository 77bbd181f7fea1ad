"""Tables as data: heads with units, typed cells, notes."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from microbot_ocp._base.showing import view_for
from microbot_ocp._base.writing import write_whole

NOTHING = "–"  # printed for an unknown value


@dataclass(frozen=True)
class Column:
    """One column of a :class:`Table`.

    Attributes
    ----------
    head, unit : str
    show : str or callable
        Format of the cells, such as ".3f", or a function from a value to text.
    left : bool
        True for a column of words, which is aligned left and wrapped in narrow terminals.
    bar : bool
        True for a column whose numbers a notebook shows with a bar of 8 em times the number.
    """

    head: str
    unit: str = ""
    show: str | Callable[[Any], str] = ""
    left: bool = False
    bar: bool = False

    @property
    def title(self) -> str:
        """Head with its unit."""
        return f"{self.head} [{self.unit}]" if self.unit else self.head

    def text(self, value: Any) -> str:
        """Return the text of a cell; a dash for None and NaN."""
        if value is None or value != value:
            return NOTHING
        if callable(self.show):
            return self.show(value)
        return str(value) if isinstance(value, str) else format(value, self.show)


@dataclass(frozen=True)
class Table:
    """Table of results.

    ``print(table)`` writes aligned text, a rich console a table that fits the terminal, Jupyter
    shows it as HTML.

    Attributes
    ----------
    columns : sequence of Column
    rows : sequence of sequences
        Rows with one value per column; None or NaN if unknown.
    title : str
    notes : sequence of str
        Sentences below the table.
    emphasis : sequence of str
        One word per row: "bad", "missing" or "".

    Examples
    --------
    >>> columns = (Column("method", left=True), Column("T", "s", ".2f"))
    >>> table = Table(columns, [("cubic", 1.5), ("spline", None)], notes=["at rest at both ends"])
    >>> print(table)
    method  T [s]
    cubic    1.50
    spline      –
    at rest at both ends
    """

    columns: Sequence[Column]
    rows: Sequence[Sequence[Any]]
    title: str = ""
    notes: Sequence[str] = ()
    emphasis: Sequence[str] = ()

    @classmethod
    def of_text(cls, heads: Sequence[str], rows: Sequence[Sequence[str]], left: int = 1) -> Table:
        """Return a table of text whose first ``left`` columns are words, the others numbers."""
        return cls([Column(head, left=place < left) for place, head in enumerate(heads)], rows)

    @property
    def heads(self) -> list[str]:
        """Heads with their units."""
        return [column.title for column in self.columns]

    @property
    def cells(self) -> list[list[str]]:
        """The rows as text."""
        return [
            [column.text(value) for column, value in zip(self.columns, row, strict=True)]
            for row in self.rows
        ]

    def without(self, *heads: str) -> Table:
        """Return the table without the columns of these heads."""
        remaining = [place for place, column in enumerate(self.columns) if column.head not in heads]
        rows = [[row[place] for place in remaining] for row in self.rows]
        return replace(self, columns=[self.columns[place] for place in remaining], rows=rows)

    def __str__(self) -> str:
        lines = [self.heads, *self.cells]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        adjust = [str.ljust if column.left else str.rjust for column in self.columns]
        body = [
            "  ".join(map(lambda put, cell, width: put(cell, width), adjust, line, widths)).rstrip()
            for line in lines
        ]
        return "\n".join([*filter(None, [self.title]), *body, *self.notes])

    def markdown(self) -> str:
        """Return the table as Markdown, the notes as a list below it."""
        lines = [self.heads, ["---" if c.left else "---:" for c in self.columns], *self.cells]
        body = ["| " + " | ".join(c.replace("|", "\\|") for c in line) + " |" for line in lines]
        head = [f"### {self.title}", ""] if self.title else []
        notes = ["", *(f"- {note}" for note in self.notes)] if self.notes else []
        return "\n".join([*head, *body, *notes, ""])

    def write_csv(self, path: str | Path) -> Path:
        """Write heads and full-precision values as CSV; unknown values are empty."""
        present = [[value if value == value else None for value in row] for row in self.rows]
        stream = io.StringIO()
        csv.writer(stream).writerows([self.heads, *present])
        return write_whole(path, stream.getvalue())

    def __rich__(self) -> Any:
        return view_for(self, "terminal")(self)

    def _repr_html_(self) -> str:
        return view_for(self, "html")(self)
