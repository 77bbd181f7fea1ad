"""Free motions of three, six and seven joints: with nothing compiled before, again, and prepared.

Through three random points, default settings, each in a fresh process that counts all from the
task to the motion, the imports not; processor time includes that of the solvers' own processes.
``python -m benchmarks arms``, or one line: ``python -m benchmarks.arms ROBOT SEED``.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import microbot_ocp as mo
from microbot_ocp._base.checks import FloatArray

ARMS = ("microbot", "ur5e", "puma560", "panda")
REACH = 2.0  # rad: via points are within, and within the limits
GOALS = {"microbot": (1.5, 0.5), "ur5e": (8, 2), "puma560": (8, 2), "panda": (20, 5)}  # s


def via_points(robot: mo.Robot, seed: int, count: int = 3) -> FloatArray:
    """Random via points [count,n], rad, in the middle of what the joints can reach."""
    low, high = np.maximum(robot.limits.q_min, -REACH), np.minimum(robot.limits.q_max, REACH)
    share = np.random.default_rng(seed).uniform(0.1, 0.9, (count, robot.joint_count))
    return low + (high - low) * share


def spent() -> tuple[float, float]:
    """Wall and processor time so far, s."""
    return time.perf_counter(), sum(os.times()[:4])


def child(name: str, seed: int) -> None:
    """In a fresh process: solve one task, then the prepared one, and print what came of it."""
    import casadi as ca

    for solver in ("ipopt", "fatrop"):  # loading them is an import
        ca.load_nlpsol(solver)
    robot = mo.load_robot(name)
    via = via_points(robot, seed)
    begin = spent()
    motion = mo.time_optimal(robot, via)
    once = np.subtract(spent(), begin)
    solver = mo.TimeOptimalSolver(robot, via)
    solver()
    begin = spent()
    again = solver(payload=0.05)
    twice = np.subtract(spent(), begin)
    found = {"once": once.tolist(), "again": twice.tolist(), "duration": motion.duration}
    found |= {"ok": bool(mo.certify(robot, motion).ok), "solved": motion.solved and again.solved}
    print(json.dumps(found))


def in_fresh_process(name: str, seed: int, cache: str) -> dict:
    """What a child printed, with its compiled kernels in a folder."""
    done = subprocess.run(
        [sys.executable, "-m", __name__, name, str(seed)],
        env={**os.environ, "MICROBOT_OCP_CACHE": cache},
        cwd=Path(__file__).resolve().parent.parent,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise RuntimeError(f"{name} failed:\n{done.stderr[-2000:]}")
    return json.loads(done.stdout.splitlines()[-1])


def run(repetitions: int = 0) -> None:
    """One seed an arm unless more are asked for."""
    print("Free motions through three random points: wall time (processor time), s")
    print("  arm        seed  first            again            prepared         duration, s")
    for name in ARMS:
        for seed in range(repetitions or 1):
            with tempfile.TemporaryDirectory() as cache:
                cold, warm = (in_fresh_process(name, seed, cache) for _ in range(2))
            times = [cold["once"], warm["once"], warm["again"]]
            shown = "".join(f"{f'{wall:.2f} ({own:.2f})':17}" for wall, own in times)
            said = "certified" if warm["ok"] and warm["solved"] else "not certified"
            first, again = GOALS[name]
            goal = f"goal {first:g} and {again:g}"
            print(f"  {name:11}{seed:<6}{shown}{warm['duration']:.5f}, {said}; {goal}", flush=True)


if __name__ == "__main__":
    child(sys.argv[1], int(sys.argv[2]))
