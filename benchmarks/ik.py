"""Inverse kinematics: ours against ssik's closed forms, and the number of reachable targets missed.

ssik solves an arm's kinematics in closed form by geometric subproblems. It has our frames and
limits, and returns one representative of every branch (with its own lock angles for seven joints),
or the solution nearest to a seed. Targets are poses of random joint positions within limits; a near
seed is 0.05 rad away in every joint, a far seed is another random position.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import ssik

import microbot_ocp as mo
from benchmarks.measure import Benchmark

TARGETS = 10_000  # targets of every arm for the count of misses
BATCH = 1_000
FEW = {6: 50, 7: 5}  # targets per repetition of the slower calls, by number of joints


def random_arm(count: int, seed: int) -> mo.Robot:
    """Draw an arm of revolute joints with any twists and lengths, and limits of 2.5 rad."""
    random = np.random.default_rng(seed)
    twists, lengths = random.uniform(-np.pi, np.pi, count), random.uniform(-0.5, 0.5, (2, count))
    robot = mo.Robot.from_dh(
        twists, *lengths, tool=(0, 0.1, 0, 0.1), name=f"random {count}R {seed}"
    )
    return robot.with_limits(mo.Limits(q_min=-2.5, q_max=2.5))


def peer(robot: mo.Robot) -> ssik.Manipulator:
    """Convert the arm for ssik: frames at zero, each joint about its own z axis."""
    zero, last, steps = np.zeros(robot.joint_count), np.eye(4), []
    for frame in (*range(1, robot.joint_count + 1), None):
        pose = np.array(mo.forward_kinematics(robot, frame=frame)(zero))
        steps.append(np.linalg.solve(last, pose))
        last = pose
    bounds = np.column_stack([robot.limits.q_min, robot.limits.q_max])
    return ssik.Manipulator.from_transforms(np.array(steps), limits=bounds)


def reachable(robot: mo.Robot, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Draw joints [N,n] within limits, their tool poses [N,4,4], and other joints [N,n]."""
    bounds = robot.limits.q_min, robot.limits.q_max
    random = np.random.default_rng(42)
    q, other = random.uniform(*bounds, (2, count, robot.joint_count))
    return q, mo.fast_call(mo.forward_kinematics(robot))(q), other


def per_target(call: Callable[[int], object], count: int) -> Callable[[], float]:
    """Return the timing of one of ``count`` calls, one per target, s."""

    def seconds() -> float:
        begin = time.perf_counter()
        for index in range(count):
            call(index)
        return (time.perf_counter() - begin) / count

    return seconds


def compare(robot: mo.Robot, repetitions: int) -> None:
    """Time one solution from a near and a far seed, and every branch."""
    arm, few = peer(robot), FEW[robot.joint_count]
    q, poses, other = reachable(robot, BATCH)
    places, turns = np.array(poses[:, :3, 3]), np.array(poses[:, :3, :3])
    if robot.joint_count == 6:  # seven joints have continua of solutions
        for pose, place, turn in zip(poses[:few], places, turns, strict=False):
            branches = [s.q for s in mo.solve_ik_all(robot, place, turn)]
            peers = np.array([s.q for s in arm.solve(pose, enumerate_windings=False)])
            assert len(branches) == len(peers), (robot.name, place)
            gaps = np.abs((np.array(branches)[:, None] - peers + np.pi) % (2 * np.pi) - np.pi)
            assert gaps.max(axis=2).min(axis=1).max() < 1e-6, (robot.name, place)
    for distance, seeds in (("near", q + 0.05), ("far", other)):

        def theirs(k: int, seeds: np.ndarray = seeds) -> object:
            return arm.solve(poses[k], max_solutions=1, q_seed=seeds[k])

        def alone(k: int, seeds: np.ndarray = seeds) -> object:
            return mo.solve_ik(robot, places[k], turns[k], seeds[k])

        def together(_: int, seeds: np.ndarray = seeds) -> object:
            return mo.inverse_kinematics.solve_ik_each(robot, places, turns, seeds)

        batch = per_target(together, 1)
        Benchmark(
            f"One solution, seed {distance}, {robot.name}",
            ("ssik, max_solutions=1, q_seed", per_target(theirs, few)),
            {
                "solve_ik(seed=...)": per_target(alone, BATCH),
                f"solve_ik_each, {BATCH} targets": lambda batch=batch: batch() / BATCH,
            },
        ).run(repetitions)
    Benchmark(
        f"Every branch, {robot.name}",
        (
            "ssik, enumerate_windings=False",
            per_target(lambda k: arm.solve(poses[k], enumerate_windings=False), few),
        ),
        {
            "solve_ik_all": per_target(lambda k: mo.solve_ik_all(robot, places[k], turns[k]), few),
            f"solve_ik_batch, {few} targets": lambda: (
                per_target(
                    lambda _: mo.inverse_kinematics.solve_ik_batch(
                        robot, places[:few], turns[:few]
                    ),
                    1,
                )()
                / few
            ),
        },
    ).run(repetitions)


def count_missed(robot: mo.Robot) -> None:
    """Solve reachable targets from random seeds; positions only for three joints."""
    _, poses, seeds = reachable(robot, TARGETS)
    turns = poses[:, :3, :3] if robot.joint_count > 3 else None
    found = mo.inverse_kinematics.solve_ik_each(robot, poses[:, :3, 3], turns, seeds)
    missed = sum(not solution.solved for solution in found)
    print(f"  {robot.name:12}  {missed} of {TARGETS} missed")


def run(repetitions: int = 0) -> None:
    """Time packaged arms of six and seven joints; count misses on those and on random arms."""
    packaged = [mo.load_robot(name) for name in ("puma560", "ur5e", "panda")]
    for robot in packaged:
        compare(robot, repetitions or 7)
    print("\nReachable targets, seeds far off")
    random = [random_arm(6, 1), random_arm(6, 2), random_arm(6, 3), random_arm(7, 4)]
    for robot in (*packaged, mo.load_robot("microbot"), *random, random_arm(7, 5)):
        count_missed(robot)
