"""Interleaved timing, and the table of its results."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import time
import timeit
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ocp._base import fast_calls

Seconds = np.ndarray
PEER = "peer"


@dataclass
class Benchmark:
    """Benchmark of a peer and our ways to do the same task, as callables that return s per call.

    ``goals`` holds the wanted ratio peer / ours by the name of our way.
    """

    title: str
    peer: tuple[str, Callable[[], float]]
    ours: Mapping[str, Callable[[], float]]
    goals: Mapping[str, float] = field(default_factory=dict)

    def run(self, repetitions: int) -> None:
        """Run in turns, A B C A B C ..., so that a slow spell of the machine hits all alike."""
        ways = {PEER: self.peer[1], **self.ours}
        # Kernels that are compiled after half a second of use are compiled at once.
        fast_calls.WORTH_COMPILING = -1.0
        for way in ways.values():
            way()  # the first call warms the caches and imports
        taken: dict[str, list[float]] = {name: [] for name in ways}
        for _ in range(repetitions):
            for name, way in ways.items():
                taken[name].append(way())
        self._print({name: np.array(values) for name, values in taken.items()})

    def _print(self, taken: dict[str, Seconds]) -> None:
        repetitions = taken[PEER].size
        width = max(map(len, [*taken, self.peer[0]]))
        print(f"\n{self.title} ({repetitions} interleaved repetitions: median, min..max)")
        print(f"  {self.peer[0]:{width}}  {_spread(taken[PEER])}")
        for name in self.ours:
            ratio = taken[PEER] / taken[name]
            line = (
                f"  {name:{width}}  {_spread(taken[name])}   {np.median(ratio):6.3g} times as fast "
                f"({ratio.min():.3g}..{ratio.max():.3g})"
            )
            print(line + _verdict(float(np.median(ratio)), self.goals.get(name)))


def _verdict(ratio: float, goal: float | None) -> str:
    if goal is None:
        return ""
    if ratio >= goal:
        return f"   goal {goal:g}: met"
    return f"   goal {goal:g}: MISSED by a factor of {goal / ratio:.2f}"


def _spread(seconds: Seconds) -> str:
    units = {"ns": 1e-9, "us": 1e-6, "ms": 1e-3, "s": 1.0}
    unit = max((u for u in units if np.median(seconds) >= units[u]), key=units.__getitem__)
    low, middle, high = (f(seconds) / units[unit] for f in (np.min, np.median, np.max))
    return f"{middle:6.4g} {unit:2} ({low:.3g}..{high:.3g})"


def timed(statement: str, number: int = 1, **names: Any) -> Callable[[], float]:
    """Return the mean time of ``number`` calls, s, by timeit's loop without a wrapper."""
    timer = timeit.Timer(statement, timer=time.process_time, globals=names)
    return lambda: timer.timeit(number) / number


def in_fresh_process(module: str, arguments: list[str], cache: str) -> dict[str, Any]:
    """Run ``python -m module arguments`` with a folder of kernels; return its last line as JSON.

    Raises
    ------
    RuntimeError
        The process failed.
    """
    done = subprocess.run(
        [sys.executable, "-m", module, *arguments],
        env={**os.environ, "MICROBOT_OCP_CACHE": cache},
        cwd=Path(__file__).resolve().parent.parent,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise RuntimeError(f"{module} {' '.join(arguments)} failed:\n{done.stderr[-2000:]}")
    return json.loads(done.stdout.splitlines()[-1])


def limit_processor_time(soft: int, hard: int) -> None:
    """End this process after its limit of processor time, s; Windows has no such limit."""
    with contextlib.suppress(ImportError):
        import resource

        resource.setrlimit(resource.RLIMIT_CPU, (soft, hard))
