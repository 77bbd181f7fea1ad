"""Flame graphs of the wall time of a free motion, by module.

Each task runs in a fresh process, whose main thread is sampled every 2 ms. The width of a bar is
the time in a module, and the bars above it are the modules that it called; solvers in their own
processes appear as waiting in ``child_process``. The tasks are those of
``python -m benchmarks phases``.

``python -m benchmarks flames`` writes ``docs/images/flames.png``.
"""

from __future__ import annotations

import json
import sys
import tempfile
import threading
import time
from collections import Counter
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.axes import Axes

import microbot_ocp as mo
from benchmarks.arms import via_points
from benchmarks.measure import in_fresh_process

ROBOTS = ("microbot", "ur5e", "panda")
PICTURE = Path(__file__).parent.parent / "docs" / "images" / "flames.png"
PERIOD = 2e-3  # sampling period, s
HIGH = 14  # largest number of bars above each other
NARROW = 0.012  # width, relative to the picture, below which a bar has no name or is not drawn
SOURCE = str(Path(mo.__file__).parent)
COLOURS = ("#e8c547", "#e39b3b", "#d9713c", "#c9503f")

Stack = tuple[str, ...]


def child(name: str) -> None:
    """Solve one task and print the number of samples of each stack of modules."""
    import casadi as ca

    for solver in ("ipopt", "fatrop"):  # loading a solver counts as an import
        ca.load_nlpsol(solver)
    solve, robot = mo.time_optimal, mo.load_robot(name)
    via = via_points(robot, 0, 3)
    met: Counter[Stack] = Counter()
    done = threading.Event()
    main = threading.get_ident()

    def look() -> None:
        while not done.wait(PERIOD):
            met[_modules(main)] += 1

    watcher = threading.Thread(target=look)
    watcher.start()
    begin = time.perf_counter()
    solve(robot, via)
    seconds = time.perf_counter() - begin
    done.set()
    watcher.join()
    print(json.dumps({"met": [*met.items()], "seconds": seconds}))


def _modules(thread: int) -> Stack:
    """Return the modules of the package on the stack of a thread, the outermost first."""
    frame, names = sys._current_frames().get(thread), list[str]()
    while frame is not None:
        path = frame.f_code.co_filename
        if path.startswith(SOURCE):
            name = Path(path).relative_to(SOURCE).with_suffix("").as_posix()
            name = name.split("/")[-1].lstrip("_").replace("_", " ")
            if name != "argument types" and names[-1:] != [name]:
                names.append(name)
        frame = frame.f_back
    return tuple(names[::-1])


def run(_: int = 0) -> None:
    """Draw all tasks, each for the first time and again."""
    figure, panels = plt.subplots(len(ROBOTS), 2, figsize=(12, 11), layout="constrained")
    for name, row in zip(ROBOTS, panels, strict=True):
        with tempfile.TemporaryDirectory() as cache:
            for when, axes in zip(("first", "again"), row, strict=True):
                told = in_fresh_process(__name__, [name], cache)
                met = {tuple(stack): count for stack, count in told["met"]}
                _draw(axes, met, sum(met.values()), 0.0, 0)
                axes.set(xlim=(0.0, 1.0), ylim=(0.0, HIGH), xticks=[], yticks=[])
                axes.set_title(f"{name}, {when}: {told['seconds']:.1f} s", loc="left", fontsize=10)
                axes.spines[:].set_visible(False)
    figure.savefig(PICTURE, dpi=110)
    print(f"wrote {PICTURE}")


def _draw(axes: Axes, met: dict[Stack, int], whole: int, left: float, level: int) -> None:
    """Draw the first modules of stacks as bars, the widest first, and their callees above."""
    widths: Counter[str] = Counter()
    for stack, count in met.items():
        if stack:
            widths[stack[0]] += count
    for name, count in widths.most_common():
        width = count / whole
        if width < NARROW or level == HIGH:
            break
        axes.barh(level + 0.5, width, 0.94, left, color=COLOURS[level % 4], ec="white", lw=0.6)
        if width > NARROW * len(name):
            axes.text(left + width / 2, level + 0.5, name, ha="center", va="center", fontsize=7)
        _draw(axes, {s[1:]: n for s, n in met.items() if s[:1] == (name,)}, whole, left, level + 1)
        left += width


if __name__ == "__main__":
    child(sys.argv[1])
