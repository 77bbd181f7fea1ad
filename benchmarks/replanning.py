"""Closed-loop re-plans from a moving arm: how long they take, and how many answers come too late.

An arm is sent to goals at random. While it is under way the goal moves every ``period`` seconds; a
prepared solver is asked for a motion from the state that the arm will be in by then. Counted are
answers that took longer than a period, by processor time of this process, and those that are not
solved or whose certificate fails: the arm then goes on with the motion that it has.

    python -m benchmarks replanning --robot microbot --count 100
"""

from __future__ import annotations

import argparse
import time

import numpy as np

import microbot_ocp as mo


def main(arguments: list[str] | None = None) -> None:
    """One arm, one table line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks replanning", description=__doc__)
    parser.add_argument("--robot", default="microbot")
    parser.add_argument("--count", type=int, default=100, help="re-plans")
    parser.add_argument("--period", type=float, default=0.1, help="s between two of them")
    parser.add_argument("--moved", type=float, default=0.05, help="rad, of the goal at a re-plan")
    parser.add_argument("--reserve", type=float, default=0.1, help="of the torques, of first plans")
    parser.add_argument("--mesh", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    robot, draw = mo.load_robot(options.robot), np.random.default_rng(options.seed)
    low = np.maximum(robot.limits.q_min, -1.5) + options.moved
    high = np.minimum(robot.limits.q_max, 1.5) - options.moved
    q = draw.uniform(low, high)
    solver = mo.TimeOptimalSolver(robot, [q, draw.uniform(low, high)], mesh=options.mesh)
    solver(via_q=solver.via_q)  # kernels are made once
    spent, unsolved, refused, uncertified = [], 0, 0, 0
    while len(spent) < options.count:
        goal = draw.uniform(low, high)
        motion = solver(via_q=[q, goal], reserve=options.reserve)
        q, at = goal, 0.0
        while motion.solved and at + options.period < motion.duration:
            if len(spent) == options.count:
                break
            at += options.period
            moved = np.clip(goal + draw.uniform(-1, 1, q.size) * options.moved, low, high)
            begin = time.process_time()
            try:
                answer = solver(via_q=[q, moved], start=motion.sample([at]))
            except mo.InputError:
                refused += 1
                spent.append(time.process_time() - begin)
                continue
            spent.append(time.process_time() - begin)
            certified = answer.solved and mo.certify(robot, answer).ok
            unsolved += not answer.solved
            uncertified += answer.solved and not certified
            if certified:
                motion, at, q, goal = answer, 0.0, moved, moved
    late = sum(each > options.period for each in spent)
    print(
        f"{options.robot}: {len(spent)} re-plans, median {1e3 * np.median(spent):.0f} ms, "
        f"95 % {1e3 * np.quantile(spent, 0.95):.0f} ms, worst {1e3 * max(spent):.0f} ms; "
        f"{late} later than {1e3 * options.period:.0f} ms, {unsolved} not solved, {refused} "
        f"refused, {uncertified} solved without a certificate"
    )
