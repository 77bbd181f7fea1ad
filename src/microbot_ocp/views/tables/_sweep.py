"""Results of a sweep as a table: one row a method, what decides and what failed below."""

from __future__ import annotations

from microbot_ocp._base.table import Column, Table
from microbot_ocp.sweeps import Quartiles, Sweep, SweepSummary
from microbot_ocp.views._style import method_title


def sweep(results: Sweep) -> Table:
    """Return durations of every method and what the best one saves: medians and quartiles."""
    summary = results.summary()
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
        duration, saving = summary.durations[method], summary.savings.get(method)
        saved = (None, None, None)
        if saving:
            saved = 100 * saving.median, _span(saving, 100.0, ".1f"), saving.count
        times = duration.median, _span(duration, 1.0, ".3f")
        counts = summary.solved[method], summary.certified[method]
        rows.append((method_title(method), *counts, *times, *saved))
    title = f"{summary.done:,} of {summary.count:,} cases on {results.about['robot']}"
    return Table(columns, rows, title, _notes(results, summary))


def _notes(results: Sweep, summary: SweepSummary) -> list[str]:
    notes = [f"Time saved by: {method_title(summary.best)}, where both are solved."]
    decides = sorted(summary.decides.items(), key=lambda pair: -pair[1])
    if decides:
        shares = ", ".join(
            f"{name} {100 * share:.1f} % ({100 * summary.at_limit[name]:.1f} %)"
            for name, share in decides
        )
        notes.append(
            "Limit that is at work longest, share of the solved cases (mean share of the time at "
            f"each): {shares}."
        )
    if summary.failures:
        several = [f"{f.status} {f.count:,} (first: case {f.case})" for f in summary.failures[:4]]
        rest = sum(f.count for f in summary.failures[4:])
        notes.append(f"Not solved: {', '.join(several)}{f', others {rest:,}' if rest else ''}.")
    time = summary.case_time
    if time.count:
        notes.append(f"Wall time of a case: median {time.median:.3g} s.")
    if summary.not_compiled and "time_optimal" in results.methods:
        notes.append(f"Not compiled, on CasADi's virtual machine: {summary.not_compiled:,} cases.")
    return notes


def _span(values: Quartiles, scale: float, show: str) -> str | None:
    if not values.count:
        return None
    return f"{scale * values.lower:{show}} to {scale * values.upper:{show}}"
