"""What a search did: a row for every strategy, so that one sees which of them decide answers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

from microbot_ocp._base.table import Column, Table

COLUMNS = (
    Column("strategy", left=True),
    Column("run"),
    Column("decided"),
    Column("cost before", show=".8g"),
    Column("cost after", show=".8g"),
    Column("iterations"),
    Column("time", "s", ".2f"),
)


@dataclass(frozen=True)
class LedgerRow:
    """One strategy of a search.

    Attributes
    ----------
    strategy : its name
    run : how often it was run
    decided : whether the answer that was returned comes from it
    cost_before, cost_after : of the answer when it was run first and after it was run last; None
        where there was none
    iterations : of all its solves
    seconds : wall time, s
    """

    strategy: str
    run: int
    decided: bool
    cost_before: float | None
    cost_after: float | None
    iterations: int
    seconds: float

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)


class Ledger(tuple[LedgerRow, ...]):
    """Rows of a search in the order in which strategies were first run; printed as a table."""

    __slots__ = ()

    @classmethod
    def of(cls, rows: Iterable[LedgerRow]) -> Ledger:
        """One row a strategy."""
        sums: dict[str, LedgerRow] = {}
        for row in rows:
            before = sums.get(row.strategy)
            sums[row.strategy] = row if before is None else _sum(before, row)
        return cls(sums.values())

    @classmethod
    def read(cls, rows: Iterable[Mapping[str, Any]]) -> Ledger:
        """The ledger that a file holds."""
        return cls(LedgerRow(**row) for row in rows)

    def discarded(self) -> Ledger:
        """The same of an answer that was not returned."""
        return Ledger(replace(row, decided=False) for row in self)

    def as_dicts(self) -> list[dict[str, Any]]:
        """Plain values for JSON."""
        return [row.as_dict() for row in self]

    def table(self) -> Table:
        """One row a strategy."""
        return Table(COLUMNS, [tuple(row.as_dict().values()) for row in self])

    def __str__(self) -> str:
        return str(self.table())


def _sum(one: LedgerRow, other: LedgerRow) -> LedgerRow:
    return LedgerRow(
        one.strategy,
        one.run + other.run,
        one.decided or other.decided,
        one.cost_before,
        other.cost_after,
        one.iterations + other.iterations,
        one.seconds + other.seconds,
    )
