"""The COPS robot arm stated in microbot_ocp, rockit and dymos: lines, time, accuracy.

Each form is a separate file, which docs/side_by_side.md shows. All use 100 intervals of Radau
collocation of degree 3 and solve to 1e-8. Ours and dymos give the controls a value at each
collocation point; rockit holds them over an interval.

Every run is a separate process, in turns. ``code`` is the time of the form's file after its
imports; ``solver`` is its part in the solver with the evaluations of the model; ``process`` is the
time from the start of Python to its end. dymos finds a colouring of its Jacobian, which may be kept
for later runs: it is measured with a kept one and without.
"""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
PUBLISHED = 9.14093
COLD = ", no colouring kept"
WAYS = ("ours", "rockit_form", "dymos_form", "dymos_form" + COLD)
HEADS = ("lines", "final time", "error", "iterations", "solver", "code", "process", "code / ours")
TITLES = {"ours": "microbot_ocp", "rockit_form": "rockit", "dymos_form": "dymos"}


def code_lines(path: Path) -> int:
    """Count the lines that are neither blank nor comment."""
    lines = (line.strip() for line in path.read_text("utf-8").splitlines())
    return sum(bool(line) and not line.startswith("#") for line in lines)


def in_fresh_process(way: str, kept: Path) -> dict[str, float]:
    """Run one form in a fresh process; return its result and times, s."""
    name = way.removesuffix(COLD)
    with tempfile.TemporaryDirectory() as empty:
        folder = Path(empty) if way.endswith(COLD) else kept
        environment = {
            **os.environ,
            "MICROBOT_OCP_CACHE": str(folder),
            "PYTHONPATH": os.pathsep.join(
                [str(HERE.parent.parent), os.environ.get("PYTHONPATH", "")]
            ),
            "PYTHONWARNINGS": "ignore",
        }
        with tempfile.TemporaryDirectory() as work:  # dymos writes files into the working folder
            begin = time.perf_counter()
            done = subprocess.run(
                [sys.executable, "-m", "benchmarks.cops_arm.child", name, str(folder)],
                env=environment,
                cwd=work,
                capture_output=True,
                text=True,
                check=False,
            )
            process = time.perf_counter() - begin
    if done.returncode:
        raise RuntimeError(f"{way} failed:\n{done.stderr[-2000:]}")
    return {**json.loads(done.stdout.splitlines()[-1]), "process": process}


def run(repetitions: int = 0) -> None:
    """Print medians of the runs in turns, without the forms of packages that are not installed."""
    peers = {name: name.removesuffix("_form") for name in TITLES if name != "ours"}
    absent = [name for name, peer in peers.items() if importlib.util.find_spec(peer) is None]
    for name in absent:
        print(f"left out: {peers[name]} is not installed (pip install {peers[name]})")
    taken: dict[str, list[dict[str, float]]] = defaultdict(list)
    with tempfile.TemporaryDirectory() as kept:
        for name in (name for name in TITLES if name not in absent):
            in_fresh_process(name, Path(kept))  # fills the folder
        for _ in range(repetitions or 5):
            for way in (way for way in WAYS if way.removesuffix(COLD) not in absent):
                taken[way].append(in_fresh_process(way, Path(kept)))
    count = repetitions or 5
    print(f"\nCOPS robot arm, published {PUBLISHED} s (medians of {count} runs in turns)")
    print(f"  {'':28}" + "".join(f"{head:>12}" for head in HEADS))
    ours = np.array([one["code"] for one in taken["ours"]])
    for way, runs in taken.items():
        name = way.removesuffix(COLD)
        middle = {key: float(np.median([one[key] for one in runs])) for key in runs[0]}
        ratio = np.array([one["code"] for one in runs]) / ours
        cells = (
            f"{code_lines(HERE / f'{name}.py')}",
            f"{middle['found']:.6f}",
            f"{middle['found'] - PUBLISHED:+.1e}",
            f"{middle['iterations']:.0f}",
            *(f"{middle[key]:.3f} s" for key in ("solver", "code", "process")),
            f"  {np.median(ratio):.3g} ({ratio.min():.3g}..{ratio.max():.3g})",
        )
        title = way.replace(name, TITLES[name])
        print(f"  {title:28}" + "".join(f"{cell:>12}" for cell in cells))
