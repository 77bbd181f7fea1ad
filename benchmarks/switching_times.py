"""Share of fastest motions of random tasks with exact switching times, and reasons of the others.

Random rest-to-rest tasks by seed, on four arms, with limits of torque alone and of torque and
speed, without a via point and with one: ``python -m benchmarks switching_times --count 20``. A task
counts as exact if the status of the switching times is "solved" and the certificate of the motion
passed. Times are processor times.
"""

from __future__ import annotations

import argparse
import itertools
import os
from collections import Counter

import numpy as np

import microbot_ocp as mo

ARMS = ("planar_2r", "planar_3r", "microbot", "stanford")
FAMILIES = ("torque", "torque, speed")
REACH = 0.6  # part of every joint's range, which is at most half a turn to each side


def task(name: str, family: str, via: int, seed: int) -> tuple[mo.Robot, np.ndarray]:
    """Draw an arm with the limits of a family, and poses that it can hold at rest."""
    robot = mo.load_robot(name)
    own = robot.limits
    speed = {} if family == "torque" else {"qd_max": own.qd_max}
    robot = robot.with_limits(
        mo.Limits(q_min=own.q_min, q_max=own.q_max, tau_max=own.tau_max, **speed)
    )
    low, high = np.maximum(own.q_min, -np.pi), np.minimum(own.q_max, np.pi)
    middle, half = (low + high) / 2, REACH * (high - low) / 2
    gravity = mo.gravity_torque(robot)
    rng = np.random.default_rng([seed, via, ARMS.index(name)])
    poses: list[np.ndarray] = []
    while len(poses) < via + 2:
        pose = middle + half * rng.uniform(-1.0, 1.0, middle.size)
        if np.all(np.abs(np.array(gravity(pose)).ravel()) < 0.9 * own.tau_max):
            poses.append(pose)
    return robot, np.array(poses)


def main(arguments: list[str] | None = None) -> None:
    """Print one line per task, and one per class."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks switching_times", description=__doc__
    )
    parser.add_argument("--robots", nargs="+", default=ARMS, choices=ARMS)
    parser.add_argument("--families", nargs="+", default=FAMILIES, choices=FAMILIES)
    parser.add_argument("--via", nargs="+", type=int, default=(0, 1))
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=20)
    options = parser.parse_args(arguments)
    classes = itertools.product(options.robots, options.families, options.via)
    table = []
    for name, family, via in classes:
        exact, seconds, why = 0, list[float](), Counter[str]()
        for seed in range(options.first, options.first + options.count):
            robot, poses = task(name, family, via, seed)
            begin = measure()
            motion = mo.time_optimal(robot, poses, starts=1, switching_times=True)
            seconds.append(measure() - begin)
            found = motion.provenance
            said = found.get("switching_times", {"status": "no motion", "advice": ""})
            on_a_mesh = found.get("on_a_mesh")  # duration of the motion on a mesh, before
            if on_a_mesh is not None and mo.certify(robot, motion).ok:
                exact += 1
                print(f"{name}, {family}, {via} via, {seed}: {on_a_mesh:.7f} -> ", end="")
                print(f"{motion.duration:.10f} s, {len(said['junctions'])} changes", flush=True)
            else:
                why[said["status"]] += 1
                first = str(said["advice"]).partition("\n")[0]
                print(f"{name}, {family}, {via} via, {seed}: {said['status']}. {first}", flush=True)
        reasons = ", ".join(f"{status} {times}" for status, times in why.most_common())
        table.append(
            f"| {name} | {family} | {via} | {exact} of {options.count} | "
            f"{np.median(seconds):.1f} | {reasons} |"
        )
    print("| Arm | Limits | Via points | Exact | Median, s | Why not |")
    print("|---|---|---|---|---|---|", *table, sep="\n")


def measure() -> float:
    """Return the processor time, including the solvers' own processes, s."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


if __name__ == "__main__":
    main()
