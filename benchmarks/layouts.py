"""Designs of cells against exhaustive maps, in which every node is solved on its own.

``python -m benchmarks layouts --only planar ur5e --nodes 9``: a map has nodes x nodes values of
both free quantities. A design may take 0.5 % longer than the best node, and a tenth of the solves
of a map of 21 x 21.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np

import microbot_ocp as mo
from microbot_ocp.layout._search import solved_with
from microbot_ocp.planning import TimeOptimalSettings
from microbot_ocp.tasks import CellFile

PLANAR = [[0.6, 0.3, 0.0], [0.5, -0.3, 0.0]]
SPATIAL = [[0.3, 0.2, 0.2], [0.2, -0.3, 0.3]]
BASE = dict.fromkeys(("base.x", "base.y"), (-0.2, 0.2))
BALL = mo.Scene((mo.Sphere(np.array([0.72, 0.0, 0.0]), 0.15, "ball"),), 0.01)


def cell(
    name: str, places: list[list[float]], payload: float | None = None, **more: Any
) -> CellFile:
    """Return a cell with stops at tool positions; the tool of a UR5e points down."""
    robot, down = mo.load_robot(name), {"orientation": np.diag([1.0, -1.0, -1.0])}
    held: dict[str, Any] = down if name == "ur5e" else {}
    stops = [
        mo.Stop(position=p, name=n, payload=payload, **held)
        for p, n in zip(places, "abc", strict=False)
    ]
    # A search for a path past a ball that blocks it would take ten minutes.
    settings = TimeOptimalSettings(starts=2, time_limit=15.0)
    return CellFile("task", robot, tuple(stops), robot.limits, settings=settings, **more)


TASKS = {
    "planar": (cell("planar_2r", PLANAR), {"base.x": (-0.2, 0.1), "base.y": (-0.1, 0.1)}),
    "stops": (
        cell("planar_2r", [*PLANAR, [0.3, 0.4, 0.0]], cycle=True),
        {"stops.b.x": (0.3, 0.7), "stops.b.y": (-0.5, -0.1)},
    ),
    "gears": (
        cell("planar_2r", PLANAR),
        dict.fromkeys(("gear ratio.shoulder", "gear ratio.elbow"), (0.5, 2.0)),
    ),
    "ball": (cell("planar_2r", PLANAR, scene=BALL), {"base.x": (-0.1, 0.1), "base.y": (-0.1, 0.1)}),
    "line": (
        cell("planar_2r", PLANAR, segments=(mo.Line(),)),
        {"base.x": (-0.1, 0.1), "base.y": (-0.1, 0.1)},
    ),
    "microbot": (cell("microbot", SPATIAL), BASE),
    "lift": (
        cell("microbot", SPATIAL, payload=0.5),
        dict.fromkeys(("base.x", "base.z"), (-0.1, 0.1)),
    ),
    "cycle": (cell("microbot", [*SPATIAL, [0.4, 0.0, 0.1]], cycle=True), BASE),
    "place": (
        cell("microbot", SPATIAL),
        {"stops.b.x": (0.1, 0.3), "stops.b.z": (0.2, 0.4)},
    ),
    "ur5e": (cell("ur5e", [[0.55, -0.35, 0.2], [0.35, 0.45, 0.4]]), BASE),
}


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks layouts", description=__doc__)
    parser.add_argument("--only", nargs="+", choices=TASKS, default=[*TASKS], metavar="NAME")
    parser.add_argument("--nodes", type=int, default=21, help="nodes of a side of the map")
    options = parser.parse_args(arguments)
    rows = []
    for name in options.only:
        task, bounds = TASKS[name]
        begin = time.process_time()
        found = mo.design(None, task, [*bounds], bounds, progress=print)
        between = time.process_time()
        axes = [np.linspace(low, high, options.nodes) for low, high in bounds.values()]
        places = np.stack(np.meshgrid(*axes), -1).reshape(-1, 2)
        nodes = [solved_with(task, found.quantities, place).period for place in places]
        spent = between - begin, time.process_time() - between
        more = 100.0 * (found.period / min(nodes) - 1.0)
        periods = (found.period_before, found.period, min(nodes))
        rows.append([name, *(f"{period:.4f}" for period in periods), f"{more:+.2f}"])
        rows[-1] += [str(len(found.solved)), str(len(nodes)), *(f"{taken:.0f}" for taken in spent)]
        print(f"{name}: {rows[-1]}", flush=True)
    heads = ["cell", "before [s]", "design [s]", "best node [s]", "more [%]", "solves", "nodes"]
    heads += ["design, processor [s]", "map, processor [s]"]
    print(mo.Table.of_text(heads, rows).markdown())
