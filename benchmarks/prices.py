"""Costs of reserves, controller profiles and parameter boxes, and values of the data of a task.

``python -m benchmarks prices --out out/prices.jsonl --page docs/how-to/controllers.md`` plans one
task of four arms as fast as they can, for controllers, with reserves, and for every arm of a box;
MuJoCo plays the plans with reserves on arms with masses 5 % off. The whole table goes to the end of
the page, which has parts of it, and the figure into its images.

``python -m benchmarks prices --check 50`` draws tasks of ``benchmarks/torture.py`` (free motions of
at most six joints) and compares slopes by the multipliers of one prepared solve with central
differences of other solves on the same mesh: of an active limit, of the payload, of a coordinate of
a via point, each drawn at random. Steps are halved until two of them agree. A slope is *flagged* if
it is below ``Sensitivities.least``, and *bent* if the differences to both sides differ by more than
a hundredth at the last step, because other limits become active there.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

import microbot_ocp as mo
from benchmarks.mujoco_arms import with_small_bodies
from benchmarks.plants import played, poses, publish
from benchmarks.scenes import read
from benchmarks.torture import RandomTask, task_of
from microbot_ocp.limits import ROUNDING, LimitFamily, MotionSamples

KINDS = (0, 1, 2, 5, 6, 7, 8)  # seeds by their last digit: not timings, not many via points
JOINTS, LOADED, TRIED, HALVINGS = 6, 0.02, 0.005, 5
AGREE, WITHIN = 0.003, 0.01
# Profiles that fit each arm, and the payload that its manufacturer allows, kg (Microbot: none).
ROS = ("ros2_jtc_linear@250", "ros2_jtc_cubic@250", "ros2_jtc_quintic@100")
ARMS = {
    "microbot": (("hold@500", *ROS), 1.0),
    "puma560": (("hold@500", *ROS), 2.5),
    "ur5e": (("ur_servoj", *ROS), 5.0),
    "panda": (("panda", "fr3", *ROS), 3.0),
}
RESERVES = (0.01, 0.02, 0.05, 0.1, 0.2)
LIMIT = 100.0  # wall time of a plan, s
BOX: dict[str, Any] = {"mass": 0.05}


@dataclass(frozen=True)
class Compared:
    """Slope of one datum: its name, its error, and its flags."""

    name: str
    error: float
    flagged: bool
    bent: bool


def central(duration: Callable[[float], float], middle: float, step: float) -> tuple[float, bool]:
    """Return a slope by central differences, and True if one-sided ones differ by over 1 %."""
    slopes: list[float] = []
    bent = False
    for k in range(HALVINGS):
        low, high = (duration(sign * step * 0.5**k) for sign in (-1.0, 1.0))
        slopes.append((high - low) / (2.0 * step * 0.5**k))
        bent = bool(abs(high + low - 2.0 * middle) > WITHIN * abs(high - low) / 2.0)
        if k and abs(slopes[-1] - slopes[-2]) < AGREE * abs(slopes[-1]):
            break
    return slopes[-1], bent


def duration_of(motion: mo.Motion) -> float:
    """Return the duration as the solver left it, without slowing down, s."""
    return float(sum(motion.provenance["phase_durations"]))


def compared(task: RandomTask, seed: int) -> Iterator[Compared | str]:
    """Yield the compared slopes of a task, or text if it has none."""
    robot, draw = task.robot, np.random.default_rng([seed, 31])
    solver = mo.TimeOptimalSolver(robot, task.via, mesh=40, starts=2, rounds=0, tolerance=1e-8)
    load = LOADED * sum(link.mass for link in robot.links) if robot.has_dynamics else 0.0
    solver(payload=load)  # the first call compiles
    begin = time.process_time()
    motion = solver(payload=load)
    solved = time.process_time()
    if not motion.solved:
        yield str(motion.status)
        return
    motion.sensitivities(robot)
    share = (time.process_time() - solved) / (solved - begin)
    slopes = motion.sensitivities(robot, load)
    middle, own = duration_of(motion), robot.limits

    def row(name: str, slope: float, size: float, f: Callable[[float], float]) -> Compared | str:
        try:
            difference, bent = central(f, middle, TRIED * abs(size))
        except mo.InputError as problem:  # a step may lead to values that the arm cannot hold
            return f"{name}: {problem}"
        nothing = abs(size) * max(abs(slope), abs(difference)) <= ROUNDING * middle
        error = 0.0 if nothing else abs(slope / difference - 1.0) if difference else np.inf
        return Compared(name, error, bool(abs(slope * size) < slopes.least), bent)

    family = LimitFamily.of(robot)
    limits = [
        (side, key, joint)
        for side in ("lower", "upper")
        for key, values in getattr(slopes, side).items()
        for joint, slope in enumerate(values)
        if key in family and abs(slope * own.bounds(key)[side == "upper"][joint]) > slopes.least
    ]
    if limits:
        side, key, joint = limits[draw.integers(len(limits))]
        bound = own.bounds(key)[side == "upper"][joint]

        def under(change: float) -> float:
            pair = [each.copy() for each in own.bounds(key)]
            pair[side == "upper"][joint] += change
            changed = own.changed({f"{key}_min": pair[0], f"{key}_max": pair[1]})
            return duration_of(solver(changed, load))

        yield row(f"{key} {side}", getattr(slopes, side)[key][joint], bound, under)
    if load:
        weight = load / LOADED
        yield row(
            "payload",
            slopes.payload_mass,
            weight,
            lambda change: duration_of(solver(payload=load + change)),
        )
        if not motion.remark.startswith("slowed"):  # a slowed motion has another duration
            yield f"scaling {scaling(motion, robot.with_payload(load), slopes):.1e}"
    yield f"{100 * share:.1f} % of the time of the solve"
    motion = solver(payload=load, via_q=task.via)
    if not motion.solved:
        return
    slopes, middle = motion.sensitivities(robot, load), duration_of(motion)
    point, joint = (int(draw.integers(size)) for size in task.via.shape)

    def through(change: float) -> float:
        via = task.via.copy()
        via[point, joint] += change
        return duration_of(solver(payload=load, via_q=via))

    way = float(np.abs(np.diff(task.via, axis=0)).max())
    yield row("via point", float(slopes.via[point, joint]), way, through)


def scaling(motion: mo.Motion, robot: mo.Robot, slopes: mo.motion.Sensitivities) -> float:
    """Return the elasticity of the duration in torques and masses together, which is zero."""
    rows = motion.provenance["multipliers"]["rows"]["tau"]
    samples = MotionSamples(*motion.sample(np.clip(rows["t"], 0.0, motion.duration)), np.zeros(0))
    masses = float((np.array(rows["slopes"]) * robot.torques_along(*samples[:3])["tau"]).sum())
    bounds = robot.limits.bounds("tau")
    pairs = zip((slopes.lower, slopes.upper), bounds, strict=True)
    return (masses + sum(float(own["tau"] @ bound) for own, bound in pairs)) / motion.duration


def check(count: int, first: int) -> None:
    """Print every slope, and the number of slopes within a hundredth."""
    rows: list[Compared] = []
    tasks, seed = 0, first
    while tasks < count:
        seed += 1
        if seed % 10 not in KINDS or (task := task_of(seed)).robot.joint_count > JOINTS:
            continue
        try:
            answers = list(compared(task, seed))
        except mo.InputError as problem:
            answers = [str(problem)]
        tasks += any(isinstance(each, Compared) for each in answers)
        own = [each for each in answers if isinstance(each, Compared)]
        texts = [each for each in answers if isinstance(each, str)]
        for each in own:
            marks = "flagged " * each.flagged + "bent" * each.bent
            texts.append(f"{each.name} {100 * each.error:.2f} % {marks}".strip())
        print(f"{seed} {task}: {'; '.join(texts)}", flush=True)
        rows += own
    sure = [each for each in rows if not (each.flagged or each.bent)]
    within = sum(each.error <= WITHIN for each in sure)
    worst = max(each.error for each in sure)
    print(
        f"{tasks} tasks, {len(rows)} slopes: {sum(e.error <= WITHIN for e in rows)} within 1 %, "
        f"{sum(e.flagged for e in rows)} flagged, {sum(e.bent for e in rows)} bent; of the other "
        f"{len(sure)} {within} within 1 %, the worst {100 * worst:.2f} % off"
    )


def ways(name: str) -> dict[str, Callable[[], dict[str, Any]]]:
    """Return a function for each way to plan that makes a row of one arm's motion."""
    robot = with_small_bodies(mo.load_robot(name))
    via_q, (profiles, load) = poses(robot, 0), ARMS[name]

    @cache
    def planned(reserve: float = 0.0, **box: Any) -> mo.Motion:
        settings: dict[str, Any] = {"reserve": reserve, "time_limit": LIMIT}
        uncertain = {"uncertain": dict(BOX)} if box.pop("off", False) else {}
        return mo.time_optimal(robot, via_q, **box, **uncertain, **settings)

    def kept(reserve: float) -> dict[str, Any]:
        motion = planned(reserve)
        plants = mo.execution.differing_plants(robot, **BOX, count=2)
        error = max(played(robot, motion, plant)[0] for plant in plants)
        return {"duration": motion.duration, "error": error, "solved": motion.solved}

    def commanded(profile: str) -> dict[str, Any]:
        command = mo.execution.commanded(robot, planned(), profile)
        return {"duration": float(command.rows.t[-1]) if command.accepted else np.nan}

    def boxed(**box: Any) -> dict[str, Any]:
        limits = mo.execution.robust_limits(robot, **(box if "payload" in box else BOX))
        try:
            motion = planned(**box)
        except mo.InputError:  # the arm cannot hold a via point
            return {"duration": np.nan}
        certified = mo.certify(robot, motion, limits).ok
        return {"duration": motion.duration if certified else np.nan, "solved": motion.solved}

    return {
        "ideal": partial(kept, 0.0),
        **{profile: partial(commanded, profile) for profile in profiles},
        **{f"reserve {100 * share:g} %": partial(kept, share) for share in RESERVES},
        "masses ± 5 %": partial(boxed, off=True),
        f"payload 0 to {load:g} kg": partial(boxed, payload=(0.0, load)),
    }


def report(rows: list[dict[str, Any]]) -> str:
    """Return a table of durations, s, and of their increases, with a column for each arm."""
    arms = list(dict.fromkeys(row["robot"] for row in rows))
    cells = {(row["robot"], row["what"].partition(" 0 to")[0]): row for row in rows}
    lines = ["| | " + " | ".join(arms) + " |", "|---|" + len(arms) * "---|"]
    for what in dict.fromkeys(what for _, what in cells):
        texts = []
        for arm in arms:
            row, ideal = cells.get((arm, what)), cells[arm, "ideal"]["duration"]
            if row is None:
                texts.append("")
                continue
            text = f"{row['duration']:.3f} s"
            if row["what"] != "ideal":
                text += f" ({100 * (row['duration'] / ideal - 1):+.1f}%)"
            if " 0 to" in row["what"]:
                text = f"{row['what'].partition(' ')[2]}: {text}"
            if not row.get("solved", True):
                text += " *"
            if row.get("error") is not None:
                text += f", {1e3 * row['error']:.3g} mm"
            texts.append(text.replace("nan s (+nan%)", "not possible"))
        lines.append(f"| {what} | " + " | ".join(texts) + " |")
    return "\n".join(lines)


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw the tool's error and the cost over the reserve."""
    from matplotlib.figure import Figure

    figure = Figure((9, 4), layout="constrained")
    left, right = figure.subplots(1, 2)
    for arm in ARMS:
        own = [row for row in rows if row["robot"] == arm and row.get("error") is not None]
        if not own:
            continue
        share = [float(row["what"].split()[1]) if row is not own[0] else 0.0 for row in own]
        error = 1e3 * np.array([row["error"] for row in own])
        slower = 100 * (np.array([row["duration"] for row in own]) / own[0]["duration"] - 1)
        left.semilogy(share, error, "o-", label=arm)
        right.plot(share, slower, "o-", label=arm)
    left.set(title="masses 5 % off: the tool strays", ylabel="largest error of the tool [mm]")
    right.set(title="what the reserve costs", ylabel="longer than the fastest [%]")
    for panel in (left, right):
        panel.set(xlabel="torque kept back for feedback [%]")
        panel.grid(alpha=0.3)
    left.legend()
    figure.savefig(path, dpi=110)


def main(arguments: list[str] | None = None) -> None:
    """Print the table of prices, or check slopes."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks prices",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--check", type=int, metavar="COUNT", help="tasks whose slopes to check")
    parser.add_argument("--first", type=int, default=-1, help="the seed before the first one")
    parser.add_argument("--out", type=Path, default=Path("out/prices.jsonl"), help="file of rows")
    parser.add_argument("--robot", nargs="*", choices=ARMS, default=tuple(ARMS))
    parser.add_argument("--table", action="store_true", help="of the rows there are, no others")
    parser.add_argument("--page", type=Path, help="Markdown to write the table into")
    options = parser.parse_args(arguments)
    if options.check is not None:
        check(options.check, options.first)
        return
    rows = read(options.out)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    done = {(row["robot"], row["what"]) for row in rows}
    for name in () if options.table else options.robot:
        for what, made in ways(name).items():
            if (name, what) not in done:
                rows.append({"robot": name, "what": what, **made()})
                with options.out.open("a") as file:
                    file.write(json.dumps(rows[-1]) + "\n")
    print(report(rows))
    if options.page:
        publish(options.page, "prices", report(rows))
        draw(rows, options.page.parents[1] / "images" / "reserve.png")
