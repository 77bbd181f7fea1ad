"""How a search ended: status, advice by rows, and a ledger with a row for every strategy."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

from microbot_ocp._base.status import Status
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


class Ledger(tuple[LedgerRow, ...]):
    """Rows of a search in the order in which strategies were first run; printed as a table."""

    __slots__ = ()

    @classmethod
    def of(cls, rows: Iterable[LedgerRow]) -> Ledger:
        """Return one row a strategy."""
        sums: dict[str, LedgerRow] = {}
        for row in rows:
            total, before = row, sums.get(row.strategy)
            if before is not None:
                total = replace(
                    row,
                    run=before.run + row.run,
                    decided=before.decided or row.decided,
                    cost_before=before.cost_before,
                    iterations=before.iterations + row.iterations,
                    seconds=before.seconds + row.seconds,
                )
            sums[row.strategy] = total
        return cls(sums.values())

    @classmethod
    def read(cls, rows: Iterable[Mapping[str, Any]]) -> Ledger:
        """Return the ledger that a file holds."""
        return cls(LedgerRow(**row) for row in rows)

    def discarded(self) -> Ledger:
        """Return the same of an answer that was not returned."""
        return Ledger(replace(row, decided=False) for row in self)

    def as_dicts(self) -> list[dict[str, Any]]:
        """Return plain values for JSON."""
        return [asdict(row) for row in self]

    def table(self) -> Table:
        """Return one row a strategy."""
        return Table(COLUMNS, [tuple(row.values()) for row in self.as_dicts()])

    def __str__(self) -> str:
        return str(self.table())


NO_LEDGER = Ledger()


@dataclass(frozen=True)
class Advice:
    """One thing that is known of how something ended.

    Attributes
    ----------
    kind : what programs tell rows apart by: "status", "limit", "remark", "returned", ...
    sentence : what it means, for the user
    label : what it is about, such as the name of a limit
    amount : by how much, in ``unit``; None where there is none
    unit : of the amount
    at : the part of a program that it is about, and when, s; not written to files
    """

    kind: str
    sentence: str
    label: str = ""
    amount: float | None = None
    unit: str = ""
    at: tuple[Any, float] | None = None

    def named(self, label: str) -> Advice:
        """Return the same with another name of what it is about."""
        return replace(
            self, sentence=self.sentence.replace(self.label, label), label=label, at=None
        )


def remark(sentence: str) -> Advice:
    """Return advice that programs have no use for."""
    return Advice("remark", sentence)


@dataclass(frozen=True)
class Outcome:
    """How something that may fail ended, and why.

    Attributes
    ----------
    status : Status
    advice : rows, the most important one first
    ledger : what the strategies of a search did

    Examples
    --------
    >>> ended = Outcome.of(Status.TIME_LIMIT)
    >>> ended.solved, ended.text
    (False, 'Stopped at the time limit: the best so far is returned.')
    """

    status: Status = Status.SOLVED
    advice: tuple[Advice, ...] = ()
    ledger: Ledger = NO_LEDGER

    @classmethod
    def of(cls, status: Status, sentence: str | None = None, *more: Advice) -> Outcome:
        """Return an outcome with one sentence on its status (default: what the status means)."""
        words = status.sentence if sentence is None else sentence
        return cls(status, (*((Advice("status", words),) if words else ()), *more))

    @classmethod
    def read(cls, values: Mapping[str, Any]) -> Outcome:
        """Return the outcome that a file holds; failed where its status is not known."""
        try:
            status = Status(values["status"])
        except ValueError:
            status = Status.FAILED
        rows = tuple(Advice(**row) for row in values["advice"])
        return cls(status, rows, Ledger.read(values["ledger"]))

    @property
    def solved(self) -> bool:
        """Whether it ended well."""
        return self.status.solved

    @property
    def text(self) -> str:
        """All sentences, one a line."""
        return "\n".join(row.sentence for row in self.advice)

    def and_(self, *rows: Advice) -> Outcome:
        """Return the outcome with more advice."""
        return replace(self, advice=(*self.advice, *rows))

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        rows = [{k: v for k, v in vars(row).items() if k != "at"} for row in self.advice]
        return {"status": str(self.status), "advice": rows, "ledger": self.ledger.as_dicts()}


SOLVED = Outcome()
