"""Outcome of a search: status, rows of advice, and a ledger with a row for every strategy."""

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
    """Contribution of one strategy to a search.

    Attributes
    ----------
    strategy : str
        Name of the strategy.
    run : int
        Number of runs.
    decided : bool
        True if the returned answer comes from this strategy.
    cost_before, cost_after : float or None
        Cost of the best answer before the first and after the last run; None without an answer.
    iterations : int
        Iterations of all solves.
    seconds : float
        Wall time, s.
    """

    strategy: str
    run: int
    decided: bool
    cost_before: float | None
    cost_after: float | None
    iterations: int
    seconds: float


class Ledger(tuple[LedgerRow, ...]):
    """Rows of a search in the order in which strategies first ran; printed as a table."""

    __slots__ = ()

    @classmethod
    def of(cls, rows: Iterable[LedgerRow]) -> Ledger:
        """Return a ledger in which the rows of each strategy are added up."""
        sums: dict[str, LedgerRow] = {}
        for row in rows:
            if before := sums.get(row.strategy):
                row = replace(
                    row,
                    run=before.run + row.run,
                    decided=before.decided or row.decided,
                    cost_before=before.cost_before,
                    iterations=before.iterations + row.iterations,
                    seconds=before.seconds + row.seconds,
                )
            sums[row.strategy] = row
        return cls(sums.values())

    @classmethod
    def read(cls, rows: Iterable[Mapping[str, Any]]) -> Ledger:
        """Return the ledger stored in a file."""
        return cls(LedgerRow(**row) for row in rows)

    def discarded(self) -> Ledger:
        """Return the ledger of an answer that was not returned: no strategy decided."""
        return Ledger(replace(row, decided=False) for row in self)

    def as_dicts(self) -> list[dict[str, Any]]:
        """Return plain values for JSON."""
        return [asdict(row) for row in self]

    def table(self) -> Table:
        """Return a table with one row per strategy."""
        return Table(COLUMNS, [tuple(row.values()) for row in self.as_dicts()])

    def __str__(self) -> str:
        return str(self.table())


NO_LEDGER = Ledger()


@dataclass(frozen=True)
class Advice:
    """One remark about the ending of a search.

    Attributes
    ----------
    kind : str
        Category for programs: "status", "limit", "remark", "returned", ...
    sentence : str
        Explanation for the user.
    label : str
        Subject of the remark, such as the name of a limit.
    amount : float or None
        Excess in ``unit``, if any.
    unit : str
        Unit of the amount.
    at : (object, float) or None
        Part of the program concerned, and time, s; not written to files.
    """

    kind: str
    sentence: str
    label: str = ""
    amount: float | None = None
    unit: str = ""
    at: tuple[Any, float] | None = None

    def named(self, label: str) -> Advice:
        """Return the advice about the same subject under another name."""
        return replace(
            self, sentence=self.sentence.replace(self.label, label), label=label, at=None
        )


def remark(sentence: str) -> Advice:
    """Return advice without meaning for programs."""
    return Advice("remark", sentence)


@dataclass(frozen=True)
class Outcome:
    """Status of a computation that may fail, with advice and a ledger.

    Attributes
    ----------
    status : Status
    advice : tuple of Advice
        Remarks, the most important one first.
    ledger : Ledger
        Rows of the strategies of a search.

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
        """Return an outcome with one sentence on its status, by default ``status.sentence``."""
        words = status.sentence if sentence is None else sentence
        return cls(status, (*((Advice("status", words),) if words else ()), *more))

    @classmethod
    def read(cls, values: Mapping[str, Any]) -> Outcome:
        """Return the outcome stored in a file; FAILED if its status is unknown."""
        try:
            status = Status(values["status"])
        except ValueError:
            status = Status.FAILED
        rows = tuple(Advice(**row) for row in values["advice"])
        return cls(status, rows, Ledger.read(values["ledger"]))

    @property
    def solved(self) -> bool:
        """True only for SOLVED."""
        return self.status.solved

    @property
    def text(self) -> str:
        """Sentences of all advice, one per line."""
        return "\n".join(row.sentence for row in self.advice)

    def and_(self, *rows: Advice) -> Outcome:
        """Return the outcome with further advice."""
        return replace(self, advice=(*self.advice, *rows))

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        rows = [{k: v for k, v in vars(row).items() if k != "at"} for row in self.advice]
        return {"status": str(self.status), "advice": rows, "ledger": self.ledger.as_dicts()}


SOLVED = Outcome()
