"""Results of a sweep as a table: one row a method, what decides and what failed below."""

from __future__ import annotations

from microbot_ocp._base.table import Column, Table
from microbot_ocp.comparison import METHODS
from microbot_ocp.sweeps import Quartiles, Sweep, SweepSummary

MOST = 4  # failures and limits that are named


def sweep(results: Sweep) -> Table:
    """Durations of every method and what the best one saves, as medians and quartiles."""
    found = results.summary()
    columns = (
        Column("method", left=True),
        Column("solved"),
        Column("certified"),
        Column("duration: median", "s", ".3f"),
        Column("quartiles", "s"),
        Column("time saved: median", "%", ".1f"),
        Column("quartiles", "%"),
        Column("cases"),
    )
    rows = []
    for method in results.methods:
        duration, saving = found.durations[method], found.savings.get(method)
        rows.append(
            (
                METHODS[method].title if method in METHODS else method,
                found.solved[method],
                found.certified[method],
                duration.median,
                _span(duration, 1.0, ".3f"),
                100 * saving.median if saving else None,
                _span(saving, 100.0, ".1f") if saving else None,
                saving.count if saving else None,
            )
        )
    title = f"{found.done:,} of {found.count:,} cases on {results.about['robot']}"
    return Table(columns, rows, title, _notes(results, found))


def _notes(results: Sweep, found: SweepSummary) -> list[str]:
    best = METHODS[found.best].title if found.best in METHODS else found.best
    notes = [f"Time saved by: {best}, where both are solved."]
    decides = sorted(found.decides.items(), key=lambda pair: -pair[1])
    if decides:
        shares = ", ".join(
            f"{name} {100 * share:.1f} % ({100 * found.at_limit[name]:.1f} %)"
            for name, share in decides
        )
        notes.append(
            "Limit that is at work longest, share of the solved cases (mean share of the time at "
            f"each): {shares}."
        )
    if found.failures:
        several = [f"{f.status} {f.count:,} (first: case {f.case})" for f in found.failures[:MOST]]
        rest = sum(f.count for f in found.failures[MOST:])
        notes.append(f"Not solved: {', '.join(several)}{f', others {rest:,}' if rest else ''}.")
    time = found.case_time
    if time.count:
        notes.append(f"Wall time of a case: median {time.median:.3g} s.")
    if found.not_compiled and "time_optimal" in results.methods:
        notes.append(f"Not compiled, on CasADi's virtual machine: {found.not_compiled:,} cases.")
    return notes


def _span(values: Quartiles, scale: float, show: str) -> str | None:
    if not values.count:
        return None
    return f"{scale * values.lower:{show}} to {scale * values.upper:{show}}"
