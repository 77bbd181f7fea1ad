"""Random tasks among obstacles by seed: solved share, duration against the usual chain, wall time.

``python -m benchmarks scenes --count 200`` runs five robots among posts, over tables, into shelves
and through gaps, in turn. ``--out FILE`` writes a line of JSON for every task and continues with
the tasks missing in that file. The usual chain is RRT-Connect (one seed), shortcuts, corners
rounded by parabolas as far as they keep clear, and the best timing of that path under equal limits.
A lower bound is the time of the joint with the longest path at its largest speed.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from pathlib import Path
from typing import Any

import numpy as np

import microbot_ocp as mo
from microbot_ocp._base import deadline
from microbot_ocp._base.deadline import processor_time
from microbot_ocp.limits import LimitFamily
from microbot_ocp.ocp.solution import quiet
from microbot_ocp.planning.search import LegPlanner, SolveRequest
from microbot_ocp.planning.task import check_via, reach_of
from microbot_ocp.scene import Surroundings

ROBOTS = ("microbot", "planar_3r", "puma560", "ur5e", "panda")
KINDS = ("post", "table", "shelf", "gap")
POSES = 20_000  # random poses from which start and goal are chosen
TRIES = 60  # scenes drawn until one blocks the straight path
SEARCHING = 60.0  # time after which a task counts as one without a path, s

Region = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks scenes", description=__doc__)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--out", type=Path, help="file with a line of JSON a task")
    parser.add_argument("--seconds", type=float, default=np.inf, help="start no task after these")
    options = parser.parse_args(arguments)
    rows = read(options.out)
    known, until = {row["number"] for row in rows}, time.perf_counter() + options.seconds
    for number in range(options.first, options.first + options.count):
        if number in known or time.perf_counter() > until:
            continue
        row = measured(number)
        rows.append(row)
        print(line(row), flush=True)
        if options.out:
            with options.out.open("a") as file:
                file.write(json.dumps(row) + "\n")
    print(table(rows))


def read(path: Path | None) -> list[dict[str, Any]]:
    if path is None or not path.exists():
        return []
    return [json.loads(text) for text in path.read_text().splitlines()]


def measured(number: int) -> dict[str, Any]:
    """Solve one task, and by the usual chain; return the row."""
    name, kind = ROBOTS[number % len(ROBOTS)], KINDS[number // len(ROBOTS) % len(KINDS)]
    row: dict[str, Any] = {"number": number, "robot": name, "kind": kind}
    drawn = draw(name, kind, number)
    if drawn is None:
        return row | {"outcome": "no task drawn"}
    robot, scene, via = drawn
    settings = mo.planning.TimeOptimalSettings()
    request = SolveRequest(robot, None, list(via), None, False, settings, quiet, scene=scene)
    planner, task = LegPlanner(request), request.task()
    with deadline.within(SEARCHING):
        planner.search([task])
    # The paths in the order of their seeds; the first is the usual chain.
    guides = sorted(planner.guides(task), key=lambda guide: guide.choice)
    timed = [path.motion.duration for g in guides if (path := planner.timed(task, g)) is not None]
    failed = sum(len(leg.failed) for _, legs in planner.ways(task) for leg in legs if leg)
    row |= {"found": bool(timed), "searches_failed": failed}
    if not timed:
        return row | {"outcome": "no path"}
    row |= {"chain": timed[0], "best_chain": min(timed)}
    row["bound"] = float((np.abs(via[1] - via[0]) / robot.limits.qd_max).max())
    begun = processor_time()
    motion = mo.time_optimal(robot, via, scene=scene)
    spent = processor_time() - begun
    told = motion.provenance
    certificate = mo.certify(robot, motion, via_q=via, scene=scene)
    held = bool(told.get("clearance", {}).get("proved")) and certificate.ok
    row |= {
        "outcome": "solved" if motion.solved and held else "not certified",
        "optimised": "starts" in told,
        "duration": motion.duration,
        "clearance": told["clearance"]["at_least"],
        "certified": held,
        "verdict": certificate.verdict,
        "processor": spent,
        "wall": told["wall_time"],
        "planning": told["planning_time"],
        "advice": motion.advice,
    }
    return row


def line(row: dict[str, Any]) -> str:
    said = f"{row['number']:4d} {row['robot']:10s} {row['kind']:6s} {row['outcome']}"
    if "duration" not in row:
        return said
    saved = 100 * (1 - row["duration"] / row["chain"])
    return said + (
        f": {row['duration']:.3f} s, chain {row['chain']:.3f} s ({saved:.0f} % saved), clearance "
        f"{1e3 * row['clearance']:.2f} mm, {row['processor']:.1f} s of processor time"
        + ("" if row["optimised"] else f"; chain kept: {row['advice']}")
    )


def table(rows: list[dict[str, Any]]) -> str:
    """Return the table of counts and medians by robot and by kind, as Markdown."""
    found = [
        "| | tasks | path found | solved and certified | saved against the chain, median "
        "(least) | could be saved at most, median | processor time, median |",
        "|---|---|---|---|---|---|---|",
    ]
    groups = [("all", rows)]
    groups += [(robot, [r for r in rows if r["robot"] == robot]) for robot in ROBOTS]
    groups += [(kind, [r for r in rows if r["kind"] == kind]) for kind in KINDS]
    for name, group in groups:
        possible = [r for r in group if r.get("found")]
        solved = [r for r in possible if r["outcome"] == "solved"]
        if not solved:
            continue
        saved = [100 * (1 - r["duration"] / r["chain"]) for r in solved]
        most = [100 * (1 - r["bound"] / r["chain"]) for r in solved]
        spent = [r["processor"] for r in solved]
        found.append(
            f"| {name} | {len(group)} | {len(possible)} | {len(solved)} "
            f"({100 * len(solved) / len(possible):.0f} %) | {statistics.median(saved):.1f} % "
            f"({min(saved):.1f} %) | {statistics.median(most):.1f} % | "
            f"{statistics.median(spent):.1f} s |"
        )
    return "\n".join(found)


# tasks --------------------------------------------------------------------------------------


def draw(name: str, kind: str, seed: int) -> tuple[mo.Robot, mo.Scene, np.ndarray] | None:
    """Draw a robot with capsules, a scene, and start and goal with a blocked straight path."""
    random = np.random.default_rng(seed)
    robot = mo.load_robot(name)
    robot = robot.with_capsules(mo.robot.link_capsules(robot))
    frame, size = _frame(robot, name, random)
    lower = np.maximum(robot.limits.q_min, -np.pi)
    upper = np.minimum(robot.limits.q_max, np.pi)
    for _ in range(TRIES):
        obstacles, regions = _scene(kind, size, _radius(robot), frame, random)
        scene = mo.Scene(obstacles)
        around = Surroundings(robot, scene)
        q = random.uniform(lower, upper, (POSES, robot.joint_count))
        tool = np.array(mo.forward_kinematics(robot)(q.T)).T.reshape(-1, 4, 4)[:, 3, :3]
        local = (tool - frame[:3, 3]) @ frame[:3, :3] / size
        ends = []
        for region in regions:
            inside = np.all(
                [(local[:, k] > low) & (local[:, k] < high) for k, (low, high) in enumerate(region)
                 if not (name.startswith("planar") and k == 1)],
                axis=0,
            )  # fmt: skip
            ends.append(next((p for p in q[inside] if _fit(around, p)), None))
        if ends[0] is None or ends[1] is None:
            continue
        if not around.is_clear(ends[0], ends[1]):
            return robot, scene, np.array(ends)
    return None


def _fit(around: Surroundings, q: np.ndarray) -> bool:
    """Return True if the arm is free of contact and can be held at rest."""
    if not around.is_free(q):
        return False
    try:
        check_via(LimitFamily.of(around.robot), np.array([q, q + 1e-6]))
    except mo.InputError:
        return False
    return True


def _frame(robot: mo.Robot, name: str, random: np.random.Generator) -> tuple[np.ndarray, float]:
    """Return the frame of obstacles at the shoulder, X outward and Z up, and the reach, m."""
    frame = np.eye(4)
    if name.startswith("planar"):
        frame[:3, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
        return frame, reach_of(robot)
    turn = random.uniform(-1.0, 1.0)
    frame[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    height = float(robot.d[0] + robot.base[2, 3])
    frame[2, 3] = height
    return frame, reach_of(robot) - abs(height)


def _radius(robot: mo.Robot) -> float:
    return max(capsule.radius for _, capsule in robot.capsules)


def _scene(
    kind: str, size: float, radius: float, frame: np.ndarray, random: np.random.Generator
) -> tuple[list[Any], tuple[Region, Region]]:
    """Draw obstacles of a kind, and start and end of the tool, relative to the reach."""

    def at(*place: float) -> np.ndarray:
        return frame[:3, :3] @ (size * np.array(place)) + frame[:3, 3]

    def box(name: str, center: tuple[float, ...], edges: tuple[float, ...]) -> mo.Box:
        pose = frame.copy()
        pose[:3, 3] = at(*center)
        return mo.Box(size * np.array(edges), pose, name)

    floor = mo.HalfSpace(frame[:3, 2], float(frame[:3, 2] @ at(0, 0, -0.75)), "floor")
    if kind == "post":
        obstacles: list[Any] = [floor]
        for k in range(int(random.integers(1, 3))):
            x, y, top = random.uniform((0.4, -0.15, 0.1), (0.6, 0.15, 0.6))
            ends = at(x, y, -0.6), at(x, y, top)
            if frame[1, 2] == 1.0:  # planar arms have posts across their plane
                ends = at(x, -0.2, top - 0.35), at(x, 0.2, top - 0.35)
            obstacles.append(mo.Capsule(*ends, 0.04 * size, f"post {k + 1}"))
        if frame[1, 2] == 1.0:
            return obstacles, (
                ((0.2, 0.8), (-1, 1), (-0.6, -0.1)),
                ((0.2, 0.8), (-1, 1), (0.2, 0.7)),
            )
        return obstacles, (
            ((0.3, 0.7), (0.2, 0.6), (-0.2, 0.3)),
            ((0.3, 0.7), (-0.6, -0.2), (-0.2, 0.3)),
        )
    if kind == "table":
        x, y, top, width = random.uniform((0.4, -0.1, 0.0, 0.08), (0.6, 0.1, 0.25, 0.2))
        obstacles = [
            box("table", (0.65, 0, -0.35), (0.9, 1.4, 0.05)),
            box("crate", (x, y, (top - 0.325) / 2), (0.3, width, top + 0.325)),
        ]
        if frame[1, 2] == 1.0:
            obstacles[1] = box("crate", (x, 0, (top - 0.325) / 2), (width, 0.3, top + 0.325))
            return obstacles, (
                ((0.1, x - width / 2 - 0.03), (-1, 1), (-0.28, 0.0)),
                ((x + width / 2 + 0.03, 0.9), (-1, 1), (-0.28, 0.0)),
            )
        return obstacles, (
            ((0.3, 0.75), (y + width / 2 + 0.05, 0.6), (-0.25, 0.05)),
            ((0.3, 0.75), (-0.6, y - width / 2 - 0.05), (-0.25, 0.05)),
        )
    if kind == "shelf":
        x, low, pitch = random.uniform((0.42, -0.3, 0.3), (0.55, -0.15, 0.4))
        boards = [
            box(f"board {k + 1}", (x + 0.2, 0, low + k * pitch), (0.4, 0.8, 0.02)) for k in range(3)
        ]
        obstacles = [*boards, box("back", (x + 0.41, 0, low + pitch), (0.02, 0.8, 2 * pitch))]
        first, second = (
            (
                (x + 0.05, x + 0.3),
                (-0.3, 0.3),
                (low + k * pitch + 0.04, low + (k + 1) * pitch - 0.04),
            )
            for k in range(2)
        )
        return obstacles, (first, second)
    x, y, z, wide = random.uniform((0.35, -0.1, 0.0, 4.0), (0.5, 0.1, 0.2, 7.0))
    half = wide * radius / size / 2
    if frame[1, 2] == 1.0:
        obstacles = [
            box("wall below", (x, 0, z - half - 0.5), (0.05, 0.4, 1.0)),
            box("wall above", (x, 0, z + half + 0.5), (0.05, 0.4, 1.0)),
        ]
        return obstacles, (
            ((0.0, x - 0.1), (-1, 1), (-0.6, 0.6)),
            ((x + 0.1, 0.9), (-1, 1), (-0.3, 0.4)),
        )
    obstacles = [
        box("wall left", (x, y + half + 0.4, 0.1), (0.05, 0.8, 1.2)),
        box("wall right", (x, y - half - 0.4, 0.1), (0.05, 0.8, 1.2)),
    ]
    return obstacles, (
        ((-0.2, x - 0.1), (0.1, 0.6), (-0.2, 0.5)),
        ((x + 0.1, 0.85), (-0.4, 0.4), (-0.3, 0.4)),
    )


def run(repetitions: int) -> None:
    """Run the first tasks only, as part of all benchmarks."""
    main(["--count", str(repetitions or 10)])
