"""A pick-and-place cycle of a UR5e: its period against the sum of its single motions.

``python -m benchmarks cell``: the arm picks 2 kg, lifts it on a straight line, carries it over,
puts it down on a line and goes back. The table has durations of motions, not wall times, so a busy
machine does not change it.

``python -m benchmarks cell --robot panda --scene`` does this with a part that has a shape, without
and with a table and a fence around it, by one of three arms.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np

import microbot_ocp as mo
from microbot_ocp import Table

DOWN = np.diag([1.0, -1.0, -1.0])
ARMS = {"ur5e": (0.15, 0.5), "puma560": (0.4, 1.0), "panda": (0.15, 0.5)}  # height, m; mass, kg


def stops(dwell: float = 0.2) -> list[mo.Stop]:
    """Return the stops, with the tool pointing down; 0.1 m above the table the path is free."""
    held: dict[str, Any] = {"orientation": DOWN}
    return [
        mo.Stop(position=[0.4, -0.3, 0.2], payload=2.0, dwell=dwell, name="pick", **held),
        mo.Stop(position=[0.4, -0.3, 0.3], name="above pick", **held),
        mo.Stop(position=[0.4, 0.3, 0.3], name="above place", **held),
        mo.Stop(position=[0.4, 0.3, 0.2], payload=0.0, dwell=dwell, name="place", **held),
    ]


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks cell", description=__doc__)
    parser.add_argument("--robot", choices=ARMS)
    parser.add_argument("--scene", action="store_true", help="with a table and a fence")
    parser.add_argument("--mesh", type=int, help="intervals of each segment at first")
    options = parser.parse_args(arguments)
    if options.robot is None:
        run()
        return
    robot, line = mo.load_robot(options.robot), mo.Line(tolerance=0.002)
    task: dict[str, Any] = {"segments": [line, None, line, None], "cycle": True}
    places = with_part(*ARMS[options.robot])
    if options.scene:
        low = ARMS[options.robot][0] - 0.13
        table = mo.Box([0.4, 1.0, 0.02], [0.5, 0.0, low - 0.01], "table")
        fence = mo.Box([0.3, 0.02, 0.2], [0.5, 0.0, low + 0.1], "fence")
        task["scene"] = mo.Scene([table, fence], clearance=0.005)
    begin = time.process_time()
    motion = mo.time_optimal(robot, places, **task, mesh=options.mesh)
    certificate = mo.certify(robot, motion, via_q=places, **task)
    print(f"{options.robot}: {motion.duration:.4f} s, {motion.status}; {motion.note}")
    print(f"{certificate.verdict}\n{time.process_time() - begin:.0f} s of processor time")


def with_part(height: float, mass: float) -> list[mo.Stop]:
    """Return stops that pick a bolt, put it down at a height, m, and lift it by 0.12 m at both."""
    bolt = mo.Capsule([0.0, 0.0, 0.04], [0.0, 0.0, 0.08], 0.03, "bolt")
    part = mo.Payload(mass, [0.0, 0.0, 0.05], shape=bolt)
    low, high = height, height + 0.12
    held: dict[str, Any] = {"orientation": DOWN}
    return [
        mo.Stop(position=[0.45, -0.3, low], payload=part, dwell=0.2, name="pick", **held),
        mo.Stop(position=[0.45, -0.3, high], name="above pick", **held),
        mo.Stop(position=[0.45, 0.3, high], name="above place", **held),
        mo.Stop(position=[0.45, 0.3, low], payload=0.0, dwell=0.2, name="place", **held),
    ]


def run(_: int = 0) -> None:
    """Print one row per motion."""
    robot, line, rows = mo.load_robot("ur5e"), mo.Line(), []
    segments = [line, None, line, None]

    def solved(name: str, places: list[mo.Stop], ways: Any, cycle: bool = False) -> Any:
        begin = time.process_time()
        motion = mo.time_optimal(robot, places, segments=ways, cycle=cycle, mesh=40)
        spent = time.process_time() - begin
        certificate = mo.certify(robot, motion, via_q=places, segments=ways, cycle=cycle)
        verdict = "ok" if certificate.ok else certificate.verdict
        rows.append([name, f"{motion.duration:.4f}", str(motion.status), verdict, f"{spent:.0f}"])
        return motion

    cycle = solved("cycle", stops(), segments, cycle=True)
    poses = [cycle.sample(mark.time).q[0] for mark in cycle.marks]
    total = 0.0
    for k in range(4):
        load = 2.0 if k < 3 else 0.0
        pair = [
            mo.Stop(q=poses[k], payload=load, name=cycle.marks[k].name),
            mo.Stop(q=poses[k + 1], name=cycle.marks[k + 1].name),
        ]
        name = f"{pair[0].name} to {pair[1].name}"
        total += solved(name, pair, [segments[k]]).duration
    dwells = sum(stop.dwell for stop in stops())
    rows.append(["sum of the four, and the dwells", f"{total + dwells:.4f}", "", "", ""])
    heads = ["motion", "duration [s]", "status", "certificate", "processor time [s]"]
    print(Table.of_text(heads, rows).markdown())


if __name__ == "__main__":
    run()
