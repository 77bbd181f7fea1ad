"""What a sweep costs beside the work itself: rate, overhead, efficiency, memory, files.

    python -m benchmarks sweep --cases 200 --rounds 3 --trivial 10000

The same cases are done by a plain loop, by one worker and by two, in turns (A B C A B C ...). All
three hold one prepared solver with kernels from the cache. Rates are those between the first and
the last part file, so that the start of processes, which a long study pays once, is told apart: it
is the time to the first file. The plain loop runs in a process of its own with one thread of linear
algebra, as dask gives its workers.

- overhead: how much longer one worker takes than the plain loop;
- efficiency: rate of N workers over N times the rate of the plain loop.

Then cases that cost next to nothing: memory of the client, which holds the scheduler as well, at
1,000 of them and at the end, its processor time a chunk, bytes a case.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

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
wall = time.perf_counter()
for case, row in enumerate(rows[1:], 1):
    solver.row(case, row)
print(time.perf_counter() - wall)
"""


@dataclass
class Run:
    """One pass over the cases: s from the first answer to the last, s to the first."""

    span: float
    start: float


def study_of(count: int) -> Study:
    """Free motions, best timings and scaled cubics of the Microbot, with payloads."""
    cases = mo.Cases.random(
        count,
        start_q=[0.0, 1.0, -0.5],
        goal_q_deg=mo.Between([-90, 30, -90], [90, 120, 90]),
        payload=mo.Between(0.0, 2.0),
    )
    return Study(mo.load_robot("microbot"), cases)


def nothing(robot: mo.Robot, via_q: np.ndarray) -> mo.Motion:
    """A method that says no at once: what is left is the cost of the sweep."""
    raise mo.InputError("nothing is asked")


def trivial_study(count: int) -> Study:
    """Cases that cost next to nothing."""
    cases = mo.Cases.random(
        count, start_q=[0.0, 1.0, -0.5], goal_q_deg=mo.Between([-90, 30, -90], [90, 120, 90])
    )
    return Study(mo.load_robot("microbot"), cases, {"nothing": nothing})


def plain_loop(count: int) -> Run:
    """All cases one after the other in a process of their own."""
    begin = time.perf_counter()
    code = [sys.executable, "-c", LOOP.format(count=count)]
    alone = {**os.environ, **ONE_THREAD}
    done = subprocess.run(code, capture_output=True, text=True, check=True, env=alone)
    span = float(done.stdout)
    return Run(span, time.perf_counter() - begin - span)


def swept(study: Study, workers: int) -> Run:
    """A sweep into a new folder."""
    moments: list[tuple[int, float]] = []

    def note(step: Any) -> None:
        if not moments or step.done > moments[-1][0]:
            moments.append((step.done, time.perf_counter()))

    with tempfile.TemporaryDirectory() as folder:
        begin = time.perf_counter()
        results = run_study(study, folder, workers=workers, progress=note)
        assert results.finished
    first = next(k for k, (done, _) in enumerate(moments) if done)
    done, at = moments[first]
    share = (moments[-1][0] - done) / (results.count - 1)  # for as many as the loop is timed
    span = (moments[-1][1] - at) / share
    return Run(span, at - begin)


def memory() -> float:
    """Resident memory of this process now, MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / MB


def print_rates(count: int, rounds: int) -> None:
    """Plain loop, one worker, two workers in turns."""
    study = study_of(count)
    ways: dict[str, Callable[[], Run]] = {
        "plain loop": lambda: plain_loop(count),
        "1 worker": lambda: swept(study, 1),
        "2 workers": lambda: swept(study, 2),
    }
    found: dict[str, list[Run]] = {name: [] for name in ways}
    for _ in range(rounds):
        for name, way in ways.items():
            found[name].append(way())
    loads = ", ".join(f"{load:.1f}" for load in os.getloadavg())
    print(f"\nSweep of {count} cases, {rounds} rounds in turns (load of the machine: {loads})")
    print("                 cases/s (each round)      ms a case   s to the first")
    for name, runs in found.items():
        rates = [(count - 1) / run.span for run in runs]
        each = " ".join(f"{rate:.3g}" for rate in rates)
        start = np.median([run.start for run in runs])
        rate = float(np.median(rates))
        print(f"  {name:11} {rate:8.3g} ({each:18}) {1e3 / rate:8.1f} {start:12.1f}")
    spans = {name: np.array([run.span for run in runs]) for name, runs in found.items()}
    slower = 100 * (float(np.median(spans["1 worker"] / spans["plain loop"])) - 1)
    print(f"  overhead of 1 worker against the plain loop: {slower:.1f} %   goal: under 5 %")
    for workers, name in ((1, "1 worker"), (2, "2 workers")):
        share = 100 * float(np.median(spans["plain loop"] / spans[name])) / workers
        print(f"  efficiency of {name}: {share:.1f} %" + ("   goal: over 90 %" * (workers == 2)))


def print_memory(count: int) -> None:
    """Cases that cost nothing: memory, and what the client itself spends."""
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
