"""Free motions of arms whose torques lift far less to one side than to the other.

``python -m benchmarks one_sided [--count 30] [--first 0] [--out FILE]``

Gravity exceeds the torque of a joint's weak side, so the arm has to swing, and local optima differ
by several percent. Every task is solved with default settings, by the search of a prepared solver,
and with many starts; the table shows how much slower the first is than the best motion of all three
that keeps the limits.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import microbot_ocp as mo
from benchmarks.torture import RandomTask, gravity_sizes, random_chain, reach, via_points

COUNT = 30


def task_of(seed: int) -> RandomTask:
    """Draw the task of a seed: an arm with a weak side in every joint, two or three via points."""
    random = np.random.default_rng([seed, 20261123])
    name = str(random.choice(["microbot", "microbot", "planar_3r", "chain"]))
    chain = random_chain(random, int(random.integers(2, 5))) if name == "chain" else None
    robot = chain or mo.load_robot(name)
    size, sides = gravity_sizes(random, robot), random.random(robot.joint_count) < 0.5
    weak, strong = random.uniform(0.35, 0.7, sides.size), random.uniform(1.2, 1.7, sides.size)
    lower, upper = np.where(sides, [weak, strong], [strong, weak]) * size
    robot = robot.with_limits(tau_max=(-lower, upper))
    return RandomTask("one-sided torques", robot, poses_of_rest(random, robot))


def poses_of_rest(random: np.random.Generator, robot: mo.Robot) -> np.ndarray:
    """Draw two or three via points; the arm can rest at the first and the last of them."""
    via = via_points(random, robot, int(random.integers(2, 4)))
    low, high = robot.limits.tau_min, robot.limits.tau_max
    for k in (0, -1):
        while True:
            held = np.array(mo.gravity_torque(robot)(via[k])).ravel()
            if ((0.98 * low <= held) & (held <= 0.98 * high)).all():
                break
            via[k] = np.clip(random.uniform(-3.0, 3.0, robot.joint_count), *reach(robot))
    return via


def _row(task: RandomTask, solve: Callable[[], mo.Motion]) -> dict[str, Any]:
    begin = sum(os.times()[:4])
    motion = solve()
    spent = sum(os.times()[:4]) - begin
    certified = mo.certify(task.robot, motion, via_q=task.via).ok
    return {
        "status": str(motion.status),
        "duration": motion.duration,
        "certified": bool(certified),
        "time": spent,
    }


def results_of(seed: int, names: Sequence[str]) -> dict[str, Any]:
    """Return the results of all methods for a seed."""
    task = task_of(seed)
    ways: dict[str, Callable[[], mo.Motion]] = {
        "default": lambda: mo.time_optimal(task.robot, task.via),
        "many": lambda: mo.time_optimal(task.robot, task.via, starts=20, tries=60),
        "prepared": lambda: mo.TimeOptimalSolver(task.robot, task.via)(search=True),
    }
    return {"seed": seed, "task": str(task), **{n: _row(task, ways[n]) for n in names}}


def main(arguments: Sequence[str]) -> None:
    """Solve the tasks and print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks one_sided", description=__doc__)
    parser.add_argument("--count", type=int, default=COUNT, help="tasks")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--ways", default="default,many,prepared", help="some of them")
    parser.add_argument("--out", type=Path, help="one line of JSON a task")
    options = parser.parse_args(arguments)
    names = options.ways.split(",")
    print("| seed | task | " + " | ".join(f"{n}, s | of processor" for n in names) + " | slower |")
    print("|---|---|" + "---|" * (2 * len(names) + 1))
    for seed in range(options.first, options.first + options.count):
        found = results_of(seed, names)
        rows = [found[name] for name in names]
        best = min((r["duration"] for r in rows if r["certified"]), default=np.inf)
        words = [
            f"{r['duration']:.4f}{'' if r['status'] == 'solved' else ' ' + r['status']}"
            f"{'' if r['certified'] else ' (breaks limits)'} | {r['time']:.1f}"
            for r in rows
        ]
        slower = f"{100 * (rows[0]['duration'] / best - 1.0):.2f} %"
        print(f"| {seed} | {found['task']} | {' | '.join(words)} | {slower} |", flush=True)
        if options.out is not None:
            with options.out.open("a", encoding="utf-8") as file:
                file.write(json.dumps(found) + "\n")
