"""Random tasks by seed: free motions and timings of paths, and their results.

``python -m benchmarks torture [--count 1000] [--first 0] [--step 1] [--limit 120] [--out FILE]``

A seed determines a task: its kind, robot, limits and via points. Every task is solved with default
settings and certified, in its own process, within a limit of wall time; the system ends the process
after twice as much processor time. One line of JSON per task goes to FILE. Seeds that FILE holds
are not solved again, except failed ones with ``--again``, so the command continues an interrupted
run; the table covers the whole FILE, with the last line of each seed. ``--task SEED`` solves one
task again and prints its progress.

A failure counts if the task is known to be solvable: if the scaled cubic keeps the limits, or the
straight path timed by reachability; or, for a path, if toppra times it. Other tasks may be
impossible, and the result must say so.
"""

from __future__ import annotations

import argparse
import itertools
import json
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import microbot_ocp as mo
from benchmarks.measure import limit_processor_time
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.deadline import processor_time
from microbot_ocp.limits import LimitFamily, MotionSamples
from microbot_ocp.motion import PiecewisePolynomial

COUNT, LIMIT = 1000, 120
KEPT = 5e-4  # allowed relative excess between the points of a timing by others
TIMING = 1e-4  # allowed relative excess of a path's duration over the best known one
ARMS = ("microbot", "planar_2r", "planar_3r", "stanford", "puma560", "ur5e", "panda")
REACH = 3.0  # largest distance of via points from zero, rad (m)


@dataclass(frozen=True, eq=False)
class RandomTask:
    """Task of a seed: a free motion through via points, or the timing of a path."""

    kind: str
    robot: mo.Robot
    via: FloatArray
    path: PiecewisePolynomial | None = None

    def __str__(self) -> str:
        return f"{self.kind}: {self.robot.name}, {len(self.via)} via points"


def packaged(random: np.random.Generator) -> RandomTask:
    """Draw a packaged robot with some limits changed, and two to five via points."""
    robot = mo.load_robot(str(random.choice(ARMS)))
    changed: dict[str, Any] = {}
    if random.random() < 0.3:
        changed["qd_max"] = np.minimum(robot.limits.qd_max, 10.0) * random.uniform(0.3, 2.0)
    if random.random() < 0.2:
        changed["qdd_max"] = random.uniform(2.0, 30.0)
    if random.random() < 0.2:
        changed["qddd_max"] = random.uniform(50.0, 500.0)
    robot = robot.with_limits(**changed)
    return RandomTask("packaged arm", robot, via_points(random, robot, int(random.integers(2, 6))))


def chain(random: np.random.Generator) -> RandomTask:
    """Draw one to eight joints, some prismatic, of 1 g to 1 t and 1 cm to 10 m."""
    robot = random_chain(random, int(random.integers(1, 9)), 10.0 ** random.uniform(-3, 3))
    strength = random.uniform(1.2, 5.0)
    robot = robot.with_limits(tau_max=strength * gravity_sizes(random, robot))
    return RandomTask("random chain", robot, via_points(random, robot, int(random.integers(2, 5))))


def tight(random: np.random.Generator) -> RandomTask:
    """Draw torques of 0.6 times the largest against gravity: the arm has to swing."""
    name = str(random.choice(["microbot", "planar_3r", "chain"]))
    robot = random_chain(random, int(random.integers(2, 5))) if name == "chain" else None
    robot = robot or mo.load_robot(name)
    robot = robot.with_limits(tau_max=0.6 * gravity_sizes(random, robot))
    return RandomTask("tight torques", robot, via_points(random, robot, int(random.integers(2, 5))))


def many(random: np.random.Generator) -> RandomTask:
    """Draw six to thirty via points."""
    robot = mo.load_robot(str(random.choice(["microbot", "planar_3r", "stanford"])))
    return RandomTask(
        "many via points", robot, via_points(random, robot, int(random.integers(6, 31)))
    )


def small(random: np.random.Generator) -> RandomTask:
    """Draw tiny paths, tiny velocities, a locked joint: sizes that no default expects."""
    robot = mo.load_robot(str(random.choice(["microbot", "planar_3r"])))
    via = via_points(random, robot, int(random.integers(2, 5)))
    if random.random() < 0.4:
        via = via[0] + 10.0 ** random.uniform(-5, -2) * (via - via[0])
    if random.random() < 0.4:
        robot = robot.with_limits(qd_max=10.0 ** random.uniform(-3, 0))
    if random.random() < 0.3:
        joint = int(random.integers(robot.joint_count))
        via[:, joint] = via[0, joint]
        locked = np.array(robot.limits.qd_max, dtype=float)
        locked[joint] = 0.0
        robot = robot.with_limits(qd_max=locked)
    return RandomTask("odd sizes", robot, via)


def shipped(random: np.random.Generator) -> RandomTask:
    """Draw a chain of two to eight joints of some URDF file, and two to four via points."""
    robot = shipped_chain(random)
    return RandomTask("URDF arm", robot, via_points(random, robot, int(random.integers(2, 5))))


def timing(random: np.random.Generator) -> RandomTask:
    """Draw a path to be timed: a cubic spline or straight lines through two to eight points."""
    return timing_of(random, mo.load_robot(str(random.choice(ARMS))))


def shipped_timing(random: np.random.Generator) -> RandomTask:
    """Draw a path to be timed of a chain from a URDF file."""
    return timing_of(random, shipped_chain(random))


def timing_of(random: np.random.Generator, robot: mo.Robot) -> RandomTask:
    """Draw a path of a robot: a cubic spline or straight lines through two to eight points."""
    robot = robot.with_limits(taud_max=np.inf)
    via = via_points(random, robot, int(random.integers(2, 9)), everywhere=True)
    path = mo.straight_path(via)
    if random.random() < 0.7:
        path = mo.cubic(via, np.arange(float(len(via))))
    q = path(np.linspace(path.breaks[0], path.breaks[-1], 400))
    if ((q < robot.limits.q_min) | (q > robot.limits.q_max)).any():  # the spline overshoots
        path = mo.straight_path(via)
    return RandomTask("path timing", robot, via, path)


KINDS: tuple[Callable[[np.random.Generator], RandomTask], ...] = (
    packaged,
    chain,
    tight,
    timing,
    many,
    shipped,
    chain,
    small,
    tight,
    shipped_timing,
)


def task_of(seed: int) -> RandomTask:
    """Draw the task of a seed."""
    return KINDS[seed % len(KINDS)](np.random.default_rng([seed, 20261121]))


def shipped_chain(random: np.random.Generator) -> mo.Robot:
    """Draw a chain of two to eight joints from the URDF files of three packages.

    Limits are those of the file. Missing limits of velocity, and missing torque limits or those
    that do not lift the arm, are replaced; without masses the acceleration is limited.
    """
    from external.urdf_packages import file_at, paths

    found = paths()
    while True:
        file = file_at(found[int(random.integers(len(found)))])
        if not file.tips:
            continue
        tip = str(random.choice(file.tips))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", mo.robot.RobotFileWarning)
            robot = mo.robot.load_urdf(file.path, tip)
        low, high = reach(robot)
        if 2 <= robot.joint_count <= 8 and (high > low).sum() >= 2:
            break
    qd_max = robot.limits.qd_max
    changed: dict[str, Any] = {
        "qd_max": np.where(np.isfinite(qd_max) & (qd_max > 0.0), qd_max, 3.0)
    }
    if robot.has_dynamics:
        strength = random.uniform(1.3, 4.0)
        inertia = np.array(mo.mass_matrix(robot)(np.zeros(robot.joint_count))).diagonal()
        needed = np.maximum(gravity_sizes(random, robot), 3.0 * inertia)
        own = robot.limits.tau_max
        usable = np.isfinite(own) & (own > 1.1 * needed)
        changed["tau_max"] = np.where(usable, own, strength * needed)
    else:
        changed["qdd_max"] = random.uniform(2.0, 20.0)
    label = f"{robot.name} to {tip}"
    return replace(robot.with_limits(**changed), name=label)


def random_chain(random: np.random.Generator, count: int, mass: float = 2.0) -> mo.Robot:
    """Draw a chain of links of similar lengths whose masses decrease outward."""
    length = 10.0 ** random.uniform(-2, 1) if mass != 2.0 else 0.5
    prismatic = (random.random(count) < 0.2) & (mass != 2.0)
    links = []
    for joint in range(count):
        own = mass * 0.7**joint * random.uniform(0.5, 1.5)
        inertia = own * length**2 * np.diag(random.uniform(0.05, 0.09, 3))
        center = length * random.uniform(-0.5, 0.5, 3)
        links.append(mo.Link(own, center, inertia))
    return mo.Robot.from_dh(
        alpha=random.choice([0.0, np.pi / 2, -np.pi / 2], count),
        a=length * random.uniform(0.0, 1.0, count),
        d=length * random.uniform(-0.3, 0.3, count),
        joint_type=["prismatic" if p else "revolute" for p in prismatic],
        links=links,
        gravity=(0.0, -9.81, 0.0),
        limits=mo.Limits(
            q_min=np.where(prismatic, -length, -6.0), q_max=np.where(prismatic, length, 6.0)
        ),
        name=f"chain of {count}",
        convention="modified",  # explicit, since a random first row looks like a standard table
    )


def gravity_sizes(random: np.random.Generator, robot: mo.Robot) -> FloatArray:
    """Return the largest torque [n] against gravity, at least a third of the largest of all."""
    q = random.uniform(*reach(robot), (500, robot.joint_count))
    found = np.abs(np.array(mo.gravity_torque(robot).map(len(q))(q.T))).max(axis=1)
    return np.maximum(found, 0.3 * found.max() + 1e-9)


def reach(robot: mo.Robot) -> tuple[FloatArray, FloatArray]:
    """Return the range of via points [n]."""
    low, high = robot.limits.q_min, robot.limits.q_max
    return np.clip(-REACH, low, high), np.clip(REACH, low, high)


def via_points(
    random: np.random.Generator, robot: mo.Robot, count: int, *, everywhere: bool = False
) -> FloatArray:
    """Draw poses [m,n]; the arm can rest at both ends, or ``everywhere``."""
    via = random.uniform(*reach(robot), (count, robot.joint_count))
    if not robot.has_dynamics:
        return via
    torque = mo.gravity_torque(robot)
    for k in range(count) if everywhere else (0, count - 1):
        for _ in range(2000):
            if (np.abs(np.array(torque(via[k])).ravel()) <= 0.98 * robot.limits.tau_max).all():
                break
            via[k] = random.uniform(*reach(robot))
    return via


def solve(
    task: RandomTask, progress: Callable[[Any], None] | None = None, limit: float = np.inf
) -> dict[str, Any]:
    """Solve a task within a limit of wall time, s; return its result as plain values."""
    more: dict[str, Any] = {"progress": progress, "time_limit": limit}
    begin = processor_time()
    try:
        if task.path is None:
            motion = mo.time_optimal(task.robot, task.via, **more)
        else:
            motion = mo.time_optimal_path(task.robot, task.path, **more)
        spent = processor_time() - begin
        certificate = mo.certify(task.robot, motion, via_q=task.via if task.path is None else None)
    except mo.InputError as problem:
        return {"status": f"refused: {problem}", "time": processor_time() - begin}
    return {
        "status": motion.status,
        "advice": motion.advice,
        "solved": bool(motion.solved),
        "certified": bool(certificate.ok),
        "verdict": certificate.verdict,
        "duration": motion.duration,
        "excess": certificate.worst_violation,
        "time": spent,
        "certificate_time": certificate.wall_time,
    }


def best_known(task: RandomTask) -> float:
    """Return the best duration that another method reaches, s; infinite without one."""
    robot, path = task.robot, task.path
    if path is not None:
        from external.toppra_timing import graded_grid, toppra_problem

        ways = [lambda: reachability(robot, path)]
        rubs = any(link.viscous_friction or link.coulomb_friction for link in robot.links)
        # toppra keeps torques without friction and velocities; it would violate other limits.
        plain = robot.has_dynamics and not rubs
        if plain and not np.isfinite(np.array(robot.limits.bounds("qdd"))).any():

            def by_toppra() -> float:
                grids = [(part, graded_grid(part, 4000)) for part in without_corners(path)]
                problems = [
                    toppra_problem(robot, part, np.union1d(grid, part.breaks))
                    for part, grid in grids
                ]
                return sum(lawful(robot, problem) for problem in problems)

            ways.append(by_toppra)
    else:
        # Under a jerk limit a free motion rests without acceleration, which no cubic does.
        shaped = mo.quintic if np.isfinite(robot.limits.qddd_max).any() else mo.cubic
        shape = shaped(task.via, np.arange(float(len(task.via))))
        ways = [
            lambda: reachability(robot, mo.straight_path(task.via)),
            lambda: mo.shortest_duration(robot, shape).duration,
        ]
    known = [np.inf]
    for duration in ways:
        try:
            known.append(float(np.nan_to_num(duration(), nan=np.inf, posinf=np.inf)))
        except (RuntimeError, ValueError):  # InputError, too: the method does not apply
            continue
    return min(known)


def reachability(robot: mo.Robot, path: PiecewisePolynomial) -> float:
    """Return the duration by the passes on a grid, s, if they keep every limit."""
    timing = mo.planning.time_path(robot, path, grid=4000)
    kept = len(timing.limits_kept_by["reachability"] + timing.limits_kept_by["speed bound"])
    every = sum(len(names) for names in timing.limits_kept_by.values())
    return timing.duration if kept == every else np.inf


def without_corners(path: PiecewisePolynomial) -> list[PiecewisePolynomial]:
    """Divide a path at its corners, which toppra would pass without a stop."""
    slope = path.derivative()
    ends = [
        np.polynomial.polynomial.polyval(step, table)
        for step, table in zip(np.diff(path.breaks), slope.coefficients, strict=True)
    ]
    jumps = np.abs(np.array(ends)[:-1] - slope.coefficients[1:, 0]).max(axis=1)
    corners = 1 + np.flatnonzero(jumps > 1e-9 * np.abs(slope.coefficients[:, 0]).max())
    edges = [0, *corners, len(path.coefficients)]
    return [
        PiecewisePolynomial(path.breaks[start : end + 1], path.coefficients[start:end])
        for start, end in itertools.pairwise(edges)
    ]


def lawful(robot: mo.Robot, problem: Any) -> float:
    """Return the duration of toppra's timing, s, if it keeps the limits between its points."""
    trajectory = problem.compute_trajectory(0.0, 0.0)
    if trajectory is None:
        return np.inf
    t = np.linspace(0.0, trajectory.duration, 20_001)
    states = [trajectory(t, order) for order in range(3)]
    samples = MotionSamples(*states, np.zeros_like(states[0]))
    excess = LimitFamily.of(robot).excess(samples).max()
    return trajectory.duration if excess <= KEPT else np.inf


def judged(task: RandomTask, found: dict[str, Any]) -> str:
    """Return the verdict: "certified", "failed", "late" or "open".

    "late" is certified, but not solved within the time limit; "open" is a failed task that no
    method is known to solve better.
    """
    done = found.get("solved") and found.get("certified")
    known = found["best_known"]
    if found.get("status") == "time limit" and found.get("certified"):
        return "late"
    if not done:
        return "failed" if np.isfinite(known) else "open"
    slower = found["duration"] / known - 1.0
    if task.path is not None and slower > TIMING:
        return "failed"
    return "certified" if slower <= 0.01 else "failed"


def table(results: Sequence[dict[str, Any]]) -> str:
    """Return the table of results by kind, as Markdown."""
    lines = [
        "| kind | tasks | certified | failed, though known to be possible | open | certified, but "
        "not solved at the limit of time | hung | median time, s | longest, s |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    kinds = list(dict.fromkeys(r["kind"] for r in results))
    for kind in [*kinds, "all"]:
        own = [r for r in results if kind in (r["kind"], "all")]
        counts = [
            sum(r["verdict_word"] == word for r in own)
            for word in ("certified", "failed", "open", "late", "hung")
        ]
        times = [r["time"] for r in own]
        row = [kind, len(own), *counts, f"{np.median(times):.2f}", f"{max(times):.1f}"]
        lines.append("| " + " | ".join(str(cell) for cell in row) + " |")
    return "\n".join(lines)


def main(arguments: Sequence[str]) -> None:
    """Run tasks and print the table."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks torture",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--count", type=int, default=COUNT, help="tasks")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--step", type=int, default=1, help="from one seed to the next")
    parser.add_argument("--limit", type=int, default=LIMIT, help="wall time of a task, s")
    parser.add_argument("--minutes", type=float, default=np.inf, help="begin no task after them")
    parser.add_argument("--again", action="store_true", help="those of FILE that failed again")
    parser.add_argument("--out", type=Path, default=Path("out/torture.jsonl"))
    parser.add_argument("--task", type=int, help="one seed only, here, telling how it goes")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.task is not None:
        _one(options.task, options.limit, quiet=options.child)
        return
    options.out.parent.mkdir(parents=True, exist_ok=True)
    text = options.out.read_text(encoding="utf-8") if options.out.exists() else ""
    results = {line["seed"]: line for line in map(json.loads, text.splitlines())}
    seeds = range(options.first, options.first + options.count * options.step, options.step)
    todo = [seed for seed in seeds if seed not in results]
    if options.again:
        todo = [s for s, found in results.items() if found["verdict_word"] != "certified"]
    end = time.monotonic() + 60.0 * options.minutes
    with options.out.open("a", encoding="utf-8") as file:
        for seed in todo:
            if time.monotonic() > end:
                break
            results[seed] = found = _in_a_process(seed, options.limit)
            file.write(json.dumps(found) + "\n")
            file.flush()
            if found["verdict_word"] != "certified":
                told = {k: found.get(k) for k in ("seed", "task", "verdict_word", "status")}
                print(json.dumps(told), flush=True)
    print(table(list(results.values())))


def _one(seed: int, limit: int, *, quiet: bool) -> None:
    task = task_of(seed)
    if not quiet:
        print(seed, task)
    else:
        limit_processor_time(2 * limit, 2 * limit + 5)
    said = None if quiet else lambda said: print(said) if _text(said) else None
    found = solve(task, said, limit)
    found |= {"seed": seed, "kind": task.kind, "task": str(task), "best_known": best_known(task)}
    print(json.dumps(found | {"verdict_word": judged(task, found)}))


def _text(said: Any) -> bool:
    return isinstance(said, str)


def _in_a_process(seed: int, limit: int) -> dict[str, Any]:
    command = [sys.executable, "-m", "benchmarks", "torture", "--child", "--task", str(seed)]
    command += ["--limit", str(limit)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=10 * limit)
        lines, code = done.stdout.splitlines(), done.returncode
        error = done.stderr.strip().splitlines()[-1:]
    except subprocess.TimeoutExpired:
        lines, code, error = [], 0, ["no answer"]
    if lines and lines[-1].startswith("{"):
        return json.loads(lines[-1])
    task = task_of(seed)
    said = {"seed": seed, "kind": task.kind, "task": str(task), "time": float(limit)}
    word = "hung" if code <= 0 else "failed"
    return said | {"status": f"ended: {code} {error}", "verdict_word": word}
