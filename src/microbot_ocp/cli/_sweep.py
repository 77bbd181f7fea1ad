"""``sweep``: thousands of cases on the workers of dask, and what came of them."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from microbot_ocp._base.checks import InputError, plain
from microbot_ocp._base.writing import made_folder, write_whole
from microbot_ocp.cli import _interrupt as interrupt
from microbot_ocp.cli._options import Json, option, output_folder, whole_number
from microbot_ocp.cli._output import Written, answer, shown_progress
from microbot_ocp.comparison import Progress, Step
from microbot_ocp.sweeps import (
    Study,
    Sweep,
    SweepStopped,
    load_sweep,
    read_study,
    repeat_case,
    run_study,
)

if TYPE_CHECKING:
    from rich.console import Console

PERIOD = 30.0  # s between two lines of progress where there is no terminal


def sweep(
    study: Annotated[
        Path | None,
        typer.Argument(metavar="STUDY", help="Study file (.toml).", show_default=False),
    ] = None,
    out: Annotated[
        Path | None,
        option("--out", what="Folder of the results; the same again continues.", metavar="FOLDER"),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            help="Processes of this machine.",
            metavar="N",
            parser=whole_number,
            show_default="one a processor",
        ),
    ] = None,
    scheduler: Annotated[
        str | None,
        option(
            "--scheduler", what="Scheduler of dask instead: tcp://HOST:PORT.", metavar="ADDRESS"
        ),
    ] = None,
    case: Annotated[
        int | None,
        typer.Option(
            help="Do one case here and print its row; with --out its motions are written.",
            metavar="N",
            parser=whole_number,
            show_default=False,
        ),
    ] = None,
    summary: Annotated[
        Path | None,
        option(
            "--summary", what="Statistics and pictures of a folder of results.", metavar="FOLDER"
        ),
    ] = None,
    as_json: Json = False,
) -> int:
    """Do thousands of cases by several methods.

    On all processors of this machine, or on a cluster. Results are Parquet files in FOLDER/cases,
    one row a case. Whatever ends the command or its
    workers, the same command continues. Needs the extra "scale".
    """
    if (study is None) == (summary is None):
        raise InputError("give a study file, or --summary FOLDER")
    if summary is not None:
        return _summarise(load_sweep(summary), as_json)
    assert study is not None
    asked = read_study(study)
    if case is not None:
        return _repeat(asked, case, output_folder(out), as_json)
    if out is None:
        raise InputError("give --out FOLDER for the results")
    if scheduler is not None and workers is not None:
        raise InputError("give --scheduler or --workers, not both")
    output_folder(out)
    continues = f"microbot-ocp sweep {study} --out {out}"
    if scheduler is not None:
        continues += f" --scheduler {scheduler}"
    try:
        with _progress(as_json, continues) as progress:
            results = run_study(asked, out, client=scheduler, workers=workers, progress=progress)
    except SweepStopped as problem:
        print(f"error: {problem}", file=sys.stderr)
        return 1
    found = results.summary()
    return answer(as_json, plain(found), lambda console: _show(console, results, []))


def _repeat(study: Study, case: int, out: Path | None, as_json: bool) -> int:
    row, motions = repeat_case(replace(study, motions=True) if out else study, case)
    written = Written()
    for name, content in motions.items():
        if out is not None:
            made_folder(out)
            written.add(
                out / f"{name}.npz", lambda path, content=content: write_whole(path, content)
            )
    solved = row["status"] == "solved"

    def show(console: Console) -> None:
        for name, value in row.items():
            console.print(
                f"{name} = {value:.6g}" if isinstance(value, float) else f"{name} = {value}"
            )

    return answer(as_json, row, show, 0 if solved else 1, written)


def _summarise(results: Sweep, as_json: bool) -> int:
    written = Written()
    folder = made_folder(results.folder / "summary")
    if results.done:
        compared = ("atlas", "quantities") if len(results.methods) > 1 else ()
        for kind in (*compared, "limits", "failures"):
            written.add(
                folder / f"{kind}.png",
                lambda path, kind=kind: results.plot(kind=kind).savefig(path),  # type: ignore[union-attr]
            )
        written.add(folder / "atlas.rrd", results.to_rerun)
    found = results.summary()
    return answer(
        as_json,
        plain(found),
        lambda console: _show(console, results, found.failures),
        written=written,
        folder=folder,
    )


def _show(console: Console, results: Sweep, failures: Any) -> None:
    console.print(results.table(), "")
    origin = results.about.get("origin") or "STUDY.toml"
    for failure in failures:
        console.print(f"{failure.count:6,} {failure.status}: {failure.reason}", soft_wrap=True)
        console.print(f"       microbot-ocp sweep {origin} --case {failure.case}", soft_wrap=True)


@contextmanager
def _progress(as_json: bool, continues: str) -> Iterator[Progress]:
    """A bar on a terminal; anywhere else a line on standard error now and then."""
    last = time.monotonic() - PERIOD

    def line(step: Step) -> None:
        nonlocal last
        interrupt.check()
        if step.stage == "done" or time.monotonic() - last >= PERIOD:
            last = time.monotonic()
            print(step.text, file=sys.stderr, flush=True)

    def tell(step: Step) -> None:
        if step.stage == "interrupted":
            kept = f"{step.done:,} of {step.total:,} cases are kept; continue with: {continues}"
            print(kept, file=sys.stderr, flush=True)
        else:
            show(step)

    if sys.stderr.isatty() and not as_json:
        with shown_progress(as_json) as show:
            yield tell
    else:
        show = line
        yield tell
