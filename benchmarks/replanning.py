"""Closed-loop re-plans of a moving arm: their times, and the number of late answers.

An arm is sent to random goals. While it moves, the goal changes every ``period`` seconds, and a
prepared solver is asked for a motion from the arm's state one period later. An answer is late if it
takes longer than the period, by processor time of this process. After a late, unsolved or
uncertified answer the arm continues with its present motion. With ``--out`` every drive to a goal
is a line of a file; drives found in the file are not repeated.

    python -m benchmarks replanning --robot microbot --period 0.05 --count 100
    python -m benchmarks replanning --robot ur5e --period 0.3 --count 1000 --out out/replans.jsonl
    python -m benchmarks replanning --table out/replans.jsonl
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

import microbot_ocp as mo
from benchmarks.scenes import read

# A line of the file belongs to these values.
TASK = ("robot", "period", "moved", "reserve", "mesh", "seed")
KEPT, LATE = "in time", "late"


def main(arguments: list[str] | None = None) -> None:
    """Run one arm; print one table line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks replanning", description=__doc__)
    parser.add_argument("--robot", default="microbot")
    parser.add_argument("--count", type=int, default=100, help="re-plans at least")
    parser.add_argument("--period", type=float, default=0.1, help="s between two of them")
    parser.add_argument("--moved", type=float, default=0.05, help="rad, of the goal at a re-plan")
    parser.add_argument("--reserve", type=float, default=0.1, help="of the torques, of first plans")
    parser.add_argument("--mesh", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="file of lines to go on with")
    parser.add_argument("--table", type=Path, help="print the table of such a file, and no more")
    options = parser.parse_args(arguments)
    if options.table is not None:
        _print(read(options.table))
        return
    robot = mo.load_robot(options.robot)
    low = np.maximum(robot.limits.q_min, -1.5) + options.moved
    high = np.minimum(robot.limits.q_max, 1.5) - options.moved
    first = np.random.default_rng(options.seed).uniform(low, high, (2, low.size))
    solver = mo.TimeOptimalSolver(robot, first, mesh=options.mesh)
    solver(via_q=solver.via_q)  # the first call compiles the kernels
    task = {key: getattr(options, key) for key in TASK}
    rows = read(options.out)
    rows = [row for row in rows if {key: row[key] for key in TASK} == task]
    while sum(len(row["spent"]) for row in rows) < options.count:
        draw = np.random.default_rng([options.seed, len(rows)])
        spent, outcomes = _driven(solver, draw.uniform(low, high, (2, low.size)), draw, options)
        rows.append({**task, "spent": spent, "outcomes": outcomes})
        if options.out:
            with options.out.open("a") as file:
                file.write(json.dumps(rows[-1]) + "\n")
    _print(rows)


def _driven(
    solver: mo.TimeOptimalSolver, via_q: np.ndarray, draw: np.random.Generator, options: Any
) -> tuple[list[float], list[str]]:
    """Run one drive; return the time of every re-plan, s, and its result."""
    motion = solver(via_q=via_q, reserve=options.reserve)
    goal, at, spent, outcomes = via_q[1], 0.0, [], []
    low, high = solver.robot.limits.bounds("q")
    while motion.solved and at + options.period < motion.duration:
        at += options.period
        moved = np.clip(goal + draw.uniform(-1, 1, goal.size) * options.moved, low, high)
        begin, answer = time.process_time(), None
        try:
            answer = solver(via_q=[goal, moved], start=motion.sample([at]))
            outcome = str(answer.status)
        except mo.InputError:
            outcome = "refused"
        spent.append(time.process_time() - begin)
        if answer is not None and answer.solved:
            late = spent[-1] > options.period
            certified = mo.certify(solver.robot, answer).ok
            outcome = (LATE if late else KEPT) if certified else "solved without a certificate"
        outcomes.append(outcome)
        if answer is not None and outcome == KEPT:
            motion, at, goal = answer, 0.0, moved
    return spent, outcomes


def _print(rows: list[dict[str, Any]]) -> None:
    heads = (
        "arm",
        "period, ms",
        "drives",
        "re-plans",
        "median, ms",
        "95 %, ms",
        "worst, ms",
        "answers",
    )
    print("| " + " | ".join(heads) + " |\n|" + len(heads) * "---|")
    for arm, period in dict.fromkeys((row["robot"], row["period"]) for row in rows):
        own = [row for row in rows if (row["robot"], row["period"]) == (arm, period)]
        spent = 1e3 * np.concatenate([row["spent"] for row in own])
        counts = Counter(outcome for row in own for outcome in row["outcomes"])
        cells = (
            arm,
            f"{1e3 * period:g}",
            f"{len(own)}",
            f"{spent.size}",
            f"{np.median(spent):.0f}",
            f"{np.quantile(spent, 0.95):.0f}",
            f"{spent.max():.0f}",
            ", ".join(f"{count} {outcome}" for outcome, count in counts.most_common()),
        )
        print("| " + " | ".join(cells) + " |")
