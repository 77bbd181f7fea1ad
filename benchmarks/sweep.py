"""Overhead of a sweep: rate, efficiency, memory, files.

    python -m benchmarks sweep --cases 200 --rounds 3 --trivial 10000

The same cases are solved by a plain loop, by one worker and by two, in turns (A B C A B C ...). All
three hold one prepared solver with kernels from the cache. Rates are measured between the first and
the last part file, so they exclude the start of processes; the time to the first file measures the
start. The plain loop runs in its own process with one thread of linear algebra, like dask's
workers.

- overhead: additional time of one worker, relative to the plain loop;
- efficiency: rate of N workers over N times the rate of the plain loop.

Other work on the machine disturbs both; two figures are hardly disturbed:

- processor time per case: of the processes that solve cases, and of all others (client, scheduler,
  workers of dask), against that of the loop;
- busy: the time of all cases over that of all workers, between the same two files.

A second table has trivial cases: memory of the client, which includes the scheduler, at 1,000 of
them and at the end, its processor time per chunk, and bytes per case.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psutil

import microbot_ocp as mo
from microbot_ocp.sweeps import Study, run_study

MB = 1e6
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
LOOP = """
import time
from benchmarks.sweep import study_of
from microbot_ocp.sweeps._solve import CaseSolver
study = study_of({count})
solver, rows = CaseSolver(study.plan()), study.source.rows(0, {count})
solver.row(0, rows[0])
wall, work = time.perf_counter(), time.process_time()
for case, row in enumerate(rows[1:], 1):
    solver.row(case, row)
print(time.perf_counter() - wall, time.process_time() - work)
"""


@dataclass
class Run:
    """Figures of one pass over the cases.

    Attributes
    ----------
    span, start : time from the first answer to the last, and to the first, s
    work : processor time of the processes that solve cases, s per case
    beside : processor time of all other processes, s per case
    busy : time of all cases over that of all workers
    """

    span: float
    start: float
    work: float
    beside: float = 0.0
    busy: float = 1.0


def study_of(count: int) -> Study:
    """Build a study of free motions, best timings and scaled cubics with payloads."""
    cases = mo.sweeps.Cases.random(
        count,
        start_q=[0.0, 1.0, -0.5],
        goal_q_deg=mo.Between([-90, 30, -90], [90, 120, 90]),
        payload=mo.Between(0.0, 2.0),
    )
    return Study(mo.load_robot("microbot"), cases)


def nothing(robot: mo.Robot, via_q: np.ndarray) -> mo.Motion:
    """Fail at once, so that only the cost of the sweep remains."""
    raise mo.InputError("nothing is asked")


def trivial_study(count: int) -> Study:
    """Build a study of trivial cases."""
    cases = mo.sweeps.Cases.random(
        count, start_q=[0.0, 1.0, -0.5], goal_q_deg=mo.Between([-90, 30, -90], [90, 120, 90])
    )
    return Study(mo.load_robot("microbot"), cases, {"nothing": nothing})


def plain_loop(count: int) -> Run:
    """Solve all cases one after the other in a separate process."""
    begin = time.perf_counter()
    code = [sys.executable, "-c", LOOP.format(count=count)]
    alone = {**os.environ, **ONE_THREAD}
    alone.pop("MALLOC_TRIM_THRESHOLD_", None)  # dask of an earlier sweep may have set it
    done = subprocess.run(code, capture_output=True, text=True, check=True, env=alone)
    span, work = map(float, done.stdout.split())
    return Run(span, time.perf_counter() - begin - span, work / (count - 1))


def spent() -> tuple[float, float]:
    """Return processor times so far, s: of the processes that solve cases, and of all others."""
    doing, beside = 0.0, time.process_time()
    for process in psutil.Process().children(recursive=True):
        with contextlib.suppress(psutil.Error):
            times = process.cpu_times()
            if any("serve()" in word for word in process.cmdline()):
                doing += times.user + times.system
            else:
                beside += times.user + times.system
    return doing, beside


def swept(study: Study, workers: int) -> Run:
    """Run a sweep into a new folder."""
    moments: list[tuple[int, float, float, float]] = []

    def note(step: Any) -> None:
        if step.done and (not moments or step.done > moments[-1][0]):
            moments.append((step.done, time.perf_counter(), *spent()))

    with tempfile.TemporaryDirectory() as folder:
        begin = time.perf_counter()
        results = run_study(study, folder, workers=workers, progress=note)
        assert results.finished
        each = results.read(["case_time"])["case_time"]
    done, at, *before = moments[0]
    last, end, *after = moments[-1]
    work, beside = (np.array(after) - before) / (last - done)
    span = (end - at) * (results.count - 1) / (last - done)  # scaled to the cases of the loop
    busy = each[workers:].mean() * (last - done) / (workers * (end - at))
    return Run(span, at - begin, float(work), float(beside), float(busy))


def memory() -> float:
    """Return the resident memory of this process, MB."""
    return psutil.Process().memory_info().rss / MB


def print_rates(count: int, rounds: int) -> None:
    """Print plain loop, one worker and two workers, run in turns."""
    study = study_of(count)
    ways: dict[str, Callable[[], Run]] = {
        "plain loop": lambda: plain_loop(count),
        "1 worker": lambda: swept(study, 1),
        "2 workers": lambda: swept(study, 2),
    }
    found: dict[str, list[Run]] = {name: [] for name in ways}
    for _ in range(rounds):
        for name, way in ways.items():
            run = way()
            found[name].append(run)
            told = f"{1e3 * run.work:.1f} + {1e3 * run.beside:.1f} ms of processor time a case"
            print(f"  {name:11} {told}, busy {100 * run.busy:.0f} %", flush=True)
    loads = ", ".join(f"{load:.1f}" for load in os.getloadavg())
    print(f"\nSweep of {count} cases, {rounds} rounds in turns (load of the machine: {loads})")
    print(
        "                 cases/s (each round)      ms a case   s to the first"
        "   processor ms a case: of cases, beside   busy"
    )
    for name, runs in found.items():
        rates = [(count - 1) / run.span for run in runs]
        each = " ".join(f"{rate:.3g}" for rate in rates)
        start = np.median([run.start for run in runs])
        rate = float(np.median(rates))
        work, beside = (1e3 * np.median([getattr(r, w) for r in runs]) for w in ("work", "beside"))
        busy = 100 * np.median([run.busy for run in runs])
        print(
            f"  {name:11} {rate:8.3g} ({each:18}) {1e3 / rate:8.1f} {start:12.1f}"
            f"          {work:22.1f} {beside:12.1f} {busy:8.0f} %"
        )
    spans = {name: np.array([run.span for run in runs]) for name, runs in found.items()}
    slower = 100 * (float(np.median(spans["1 worker"] / spans["plain loop"])) - 1)
    print(f"  overhead of 1 worker against the plain loop: {slower:.1f} %   goal: under 5 %")
    base = np.array([run.work for run in found["plain loop"]])
    for name in ("1 worker", "2 workers"):
        more = [np.array([getattr(r, what) for r in found[name]]) for what in ("work", "beside")]
        whole, other = (100 * float(np.median(x / base)) for x in (sum(more), more[1]))
        print(
            f"  processor time of {name}: {whole - 100:+.1f} % against the loop, "
            f"{other:.1f} % of it beside the cases"
        )
    for workers, name in ((1, "1 worker"), (2, "2 workers")):
        share = 100 * float(np.median(spans["plain loop"] / spans[name])) / workers
        print(f"  efficiency of {name}: {share:.1f} %" + ("   goal: over 90 %" * (workers == 2)))


def print_memory(count: int) -> None:
    """Print memory and processor time of the client with trivial cases."""
    study = trivial_study(count)
    seen: dict[int, float] = {}
    marks = sorted({1000, count // 2, count})

    def note(step: Any) -> None:
        for mark in marks:
            if step.done >= mark:
                seen.setdefault(mark, memory())

    with tempfile.TemporaryDirectory() as folder:
        begin, work = time.perf_counter(), time.process_time()
        results = run_study(study, folder, workers=2, progress=note)
        wall, work = time.perf_counter() - begin, time.process_time() - work
        sizes = [path.stat().st_size for path in (Path(folder) / "cases").iterdir()]
        assert results.finished
    print(f"\n{count:,} cases that cost nothing, 2 workers, {study.chunk} cases a chunk")
    for mark, size in seen.items():
        print(f"  resident memory of client and scheduler at {mark:,} cases: {size:.0f} MB")
    print(f"  {count / wall:.0f} cases a second with the start; {len(sizes)} files")
    print(f"  processor time of client and scheduler: {1e3 * work / len(sizes):.2f} ms a chunk")
    print(f"  {sum(sizes) / count:.0f} bytes a case, {np.median(sizes):.0f} bytes a file")


def main(arguments: list[str]) -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks sweep",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--trivial", type=int, default=10_000)
    options = parser.parse_args(arguments)
    print_rates(options.cases, options.rounds)
    if options.trivial:
        print_memory(options.trivial)
