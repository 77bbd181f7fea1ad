"""Arms of three to seven joints: a task solved for the first time, again, and prepared.

Tasks are free motions through three random points, and the timing of a spline through five, with
default settings. Each runs in a fresh process; the time from the task to the motion counts, without
imports. "first" starts without compiled functions. "prepared" is another payload in a
``TimeOptimalSolver``. Processor time includes the solvers' own processes.

``python -m benchmarks arms``, or one line: ``python -m benchmarks.arms free|path ROBOT SEED``.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import microbot_ocp as mo
from benchmarks.measure import in_fresh_process
from microbot_ocp._base.checks import FloatArray

REACH = 2.0  # largest distance of via points from zero, within the limits, rad
PAYLOAD = 0.05  # payload of the prepared solve, kg
# Goals for the first, the second and the prepared solve, s.
GOALS = {
    ("free", "microbot"): (1.5, 0.5, 0.05),
    ("free", "stanford"): (8, 2, 0.3),
    ("free", "ur5e"): (8, 2, 0.3),
    ("free", "puma560"): (8, 2, 0.3),
    ("free", "panda"): (20, 5, None),
    ("path", "microbot"): (None, None),
    ("path", "stanford"): (None, 1),
    ("path", "ur5e"): (None, 1),
    ("path", "puma560"): (None, 1),
    ("path", "panda"): (None, 1),
}


def via_points(robot: mo.Robot, seed: int, count: int) -> FloatArray:
    """Draw via points [count,n], rad (m), in the middle of the joint ranges."""
    low, high = np.maximum(robot.limits.q_min, -REACH), np.minimum(robot.limits.q_max, REACH)
    share = np.random.default_rng(seed).uniform(0.1, 0.9, (count, robot.joint_count))
    return low + (high - low) * share


def timed(make: Callable[[], mo.Motion]) -> tuple[mo.Motion, list[float]]:
    """Run ``make``; return its motion, and its wall and processor time, s."""
    begin = time.perf_counter(), sum(os.times()[:4])
    motion = make()
    return motion, [time.perf_counter() - begin[0], sum(os.times()[:4]) - begin[1]]


def child(what: str, name: str, seed: int) -> None:
    """Solve one task in this fresh process, and a prepared one, and print the results."""
    import casadi as ca

    for solver in ("ipopt", "fatrop"):  # loading a solver counts as an import
        ca.load_nlpsol(solver)
    assert callable(mo.time_optimal)  # the first access imports it, which does not count
    assert callable(mo.time_optimal_path)
    robot = mo.load_robot(name)
    found: dict[str, Any] = {}
    if what == "path":
        spline = mo.spline(via_points(robot, seed, 5), np.arange(5.0))
        motion, found["whole"] = timed(lambda: mo.time_optimal_path(robot, spline))
        solved = motion.solved
    else:
        via = via_points(robot, seed, 3)
        motion, found["whole"] = timed(lambda: mo.time_optimal(robot, via))
        solver = mo.TimeOptimalSolver(robot, via)
        solver()
        again, found["prepared"] = timed(lambda: solver(payload=PAYLOAD))
        solved = motion.solved and again.solved
    certified = bool(mo.certify(robot, motion).ok)
    print(json.dumps({**found, "duration": motion.duration, "ok": solved and certified}))


def run(repetitions: int = 0) -> None:
    """Run one seed per arm, or more if asked for."""
    print("Free motions through three random points, and the timing of a path through five:")
    print("wall time (processor time), s; what failed is said in its line")
    print("  task  arm       seed  first           again           prepared        duration, s")
    for what, name in GOALS:
        for seed in range(repetitions or 1):
            print(f"  {what:6}{name:10}{seed:<6}{_row(what, name, seed)}", flush=True)


def _row(what: str, name: str, seed: int) -> str:
    with tempfile.TemporaryDirectory() as cache:
        try:
            arguments = [what, name, str(seed)]
            cold, warm = (in_fresh_process(__name__, arguments, cache) for _ in range(2))
        except RuntimeError as problem:
            return str(problem).splitlines()[-1]
    times = [cold["whole"], warm["whole"], *([warm["prepared"]] if "prepared" in warm else [])]
    shown = "".join(f"{f'{wall:.2f} ({own:.2f})':16}" for wall, own in times)
    wanted = ", ".join("none" if goal is None else f"{goal:g}" for goal in GOALS[what, name])
    said = "certified" if warm["ok"] else "not certified"
    return f"{shown:48}{warm['duration']:.5f}, {said}; goals {wanted}"


if __name__ == "__main__":
    child(sys.argv[1], sys.argv[2], int(sys.argv[3]))
