"""Best timing of a given path: ours against toppra with pinocchio's inverse dynamics.

toppra runs with Seidel's solver, collocation of the torque limits at the grid points, equal steps
of the path parameter, and its cheaper output, constant path acceleration. Ours is the reachability
analysis on as many points, with limits at both ends of every interval. A further row is
``time_optimal_path`` with its defaults, which also refines the grid until limits hold between its
points, and samples the motion with its torques. The largest excess over the limits between the grid
points is printed last: over the whole motion, and without its first and last 2 %, because this path
starts and ends at q'(s) = 0, where toppra's grid constrains little.
"""

from __future__ import annotations

import numpy as np
import toppra

import microbot_ocp as mo
from benchmarks.measure import Benchmark, timed
from external.toppra_timing import even_grid, toppra_duration, toppra_problem
from microbot_ocp.limits import LimitFamily, MotionSamples
from microbot_ocp.motion import PiecewisePolynomial
from microbot_ocp.planning import time_path

GOAL = 10.0
PLACES = 20_000
PROMISED = 1000
GRIDS = {200: None, PROMISED: GOAL, 5000: None}  # only one has a goal; the others show the scaling


def report_path() -> PiecewisePolynomial:
    """Return the report's cubic: 2 s + 2 s, passing the via point at (10, 40, 20) deg/s."""
    via_q = np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]])
    via_qd = np.radians([[0, 0, 0], [10, 40, 20], [0, 0, 0]])
    return mo.cubic(via_q, [0.0, 2.0, 4.0], via_qd)


def run(repetitions: int = 0) -> None:
    """Time three grids; an uncounted first round compiles everything."""
    robot, path = mo.load_robot("microbot"), report_path()
    names = {"robot": robot, "path": path, "limits": robot.limits}
    for intervals, goal in GRIDS.items():
        names |= {"intervals": intervals, "grid": even_grid(path, intervals)}
        # The cubic starts and ends at rest by itself, whatever the speed along it.
        reach = "f(robot, path, limits, grid=intervals, start_free=True, end_free=True)"
        toppra = timed("f(robot, path, grid)", f=toppra_duration, **names)
        ways = {"time_path": timed(reach, f=time_path, **names)}
        if intervals == PROMISED:
            call = "f(robot, path, grid=intervals)"
            ways["time_optimal_path"] = timed(call, f=mo.time_optimal_path, **names)
        free = {"start_free": True, "end_free": True}
        ours = time_path(robot, path, robot.limits, grid=intervals, **free).duration
        theirs = toppra_duration(robot, path, even_grid(path, intervals))
        Benchmark(
            f"Path timing, {intervals} intervals; found: toppra {theirs:.5f} s, ours {ours:.5f} s",
            ("toppra", toppra),
            ways,
            {} if goal is None else {"time_path": goal},
        ).run(repetitions or 15)
    print_excesses(robot, path)


def print_excesses(robot: mo.Robot, path: PiecewisePolynomial) -> None:
    """Print the worst relative excess of torque or velocity at 20,000 places of each motion."""
    family = LimitFamily.of(robot.with_limits(taud_max=np.inf))  # toppra has no torque rates
    ways = {}
    for name in ("ParametrizeSpline", "ParametrizeConstAccel"):
        task = toppra_problem(robot, path, even_grid(path, PROMISED))
        task.parametrizer = getattr(toppra.parametrizer, name)
        ways[f"toppra, {name}"] = task.compute_trajectory(0.0, 0.0)
    ours = mo.time_optimal_path(robot, path, grid=PROMISED)
    print(f"\nLimits between the grid points, {PROMISED} intervals: duration, excess, without ends")
    for name, curve in {**ways, "time_optimal_path": ours}.items():
        excesses = []
        for margin in (0.0, 0.02):
            t = curve.duration * np.linspace(margin, 1.0 - margin, PLACES)
            state = curve.sample(t) if curve is ours else [curve(t, order) for order in range(3)]
            samples = MotionSamples(*state, np.zeros_like(state[0]))
            excesses.append(100 * float(family.excess(samples).max()))
        print(f"  {name:30} {curve.duration:.4f} s {excesses[0]:9.3g} % {excesses[1]:9.3g} %")
