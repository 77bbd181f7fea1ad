"""The best timing of a given path: ours against toppra with pinocchio's inverse dynamics.

Both start from the path and the robot and end with the timed trajectory (ours sampled, with its
torques). toppra runs as it comes: Seidel's solver, collocation of the torque limits at the grid
points, equal steps of the path parameter; its cheaper output, constant path acceleration.
"""

from __future__ import annotations

import numpy as np

import microbot_ocp as mo
from benchmarks.measure import Benchmark, timed
from external.toppra_timing import even_grid, toppra_duration
from microbot_ocp.motion import PiecewisePolynomial

GOAL = 3.0
GRIDS = {200: None, 1000: GOAL, 5000: None}  # the other two show how it scales


def report_path() -> PiecewisePolynomial:
    """The cubic of the course report: 2 s + 2 s, passing the via point at (10, 40, 20) deg/s."""
    via_q = np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]])
    via_qd = np.radians([[0, 0, 0], [10, 40, 20], [0, 0, 0]])
    return mo.cubic(via_q, [0.0, 2.0, 4.0], via_qd)


def run(repetitions: int = 0) -> None:
    """Three grids."""
    robot, path = mo.load_robot("microbot"), report_path()
    for intervals, goal in GRIDS.items():
        grid = even_grid(path, intervals)
        peer = timed("f(robot, path, grid)", f=toppra_duration, robot=robot, path=path, grid=grid)
        theirs = toppra_duration(robot, path, grid)
        if not hasattr(mo, "time_optimal_path"):
            Benchmark(f"Path timing, {intervals} intervals", ("toppra", peer), {}).run(5)
            print(f"  toppra {theirs:.5f} s; microbot_ocp has no time_optimal_path yet")
            continue
        call = "f(robot, path, grid=intervals)"
        names = {"robot": robot, "path": path, "intervals": intervals}
        ours = mo.time_optimal_path(robot, path, grid=intervals).duration
        Benchmark(
            f"Path timing, {intervals} intervals (toppra {theirs:.5f} s, ours {ours:.5f} s)",
            ("toppra", peer),
            {"time_optimal_path": timed(call, f=mo.time_optimal_path, **names)},
            {} if goal is None else {"time_optimal_path": goal},
        ).run(repetitions or 15)
