"""MuJoCo arms that differ from the model, under saturated and sampled computed torque.

The reserve is found on a few arms in the package's own simulation, which promises a bound of the
tool's error and a share of the time at the torque limits. MuJoCo simulates other arms, drawn from
the same box of masses and frictions, along the plan with that reserve and along the ideal plan.
With ``--out`` every arm is a line of a file; arms found in the file are not simulated again.

    python -m benchmarks plants --robot microbot --count 20
    python -m benchmarks plants --robot ur5e --out out/plants.jsonl
    python -m benchmarks plants --table out/plants.jsonl
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

import microbot_ocp as mo
from benchmarks.mujoco_arms import mjcf, with_small_bodies
from benchmarks.scenes import read
from microbot_ocp.planning.search import tool_poses
from microbot_ocp.robot import COULOMB_SMOOTHING

RATE, GAIN, BOUND = 500.0, 100.0, 0.02
# A line of the file belongs to these values.
TASK = ("robot", "seed", "mass", "friction", "payload", "gain", "bound", "few")
END = "end of the table of benchmarks"
SUBSTEPS = 4  # steps of the simulation per period of the controller


def poses(robot: mo.Robot, seed: int) -> np.ndarray:
    """Draw two poses [2,n], rad."""
    low, high = np.maximum(robot.limits.q_min, -1.2), np.minimum(robot.limits.q_max, 1.2)
    return np.random.default_rng(seed).uniform(low, high, (2, robot.joint_count))


def played(
    robot: mo.Robot, motion: mo.Motion, plant: mo.Robot, gain: float = GAIN
) -> tuple[float, float]:
    """Simulate computed torque at RATE, clipped and held over the period.

    Returns the largest error of the tool, m, and the fraction of the time at a torque limit.
    """
    model = mujoco.MjModel.from_xml_string(mjcf(plant))
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    model.opt.timestep = 1.0 / (RATE * SUBSTEPS)
    data = mujoco.MjData(model)
    law = mo.fast_call(mo.inverse_dynamics(robot))
    low, high = robot.limits.bounds("tau")
    dry = np.array([link.coulomb_friction for link in plant.links])
    data.qpos[:] = motion.q[0]
    wanted = motion.sample(np.append(np.arange(0.0, motion.duration, 1.0 / RATE), motion.duration))
    passed, saturated = np.zeros_like(wanted.q), 0
    for k, (q, qd, qdd) in enumerate(zip(*wanted, strict=True)):
        passed[k] = data.qpos
        error, rate = q - data.qpos, qd - data.qvel
        asked = qdd + 2.0 * np.sqrt(gain) * rate + gain * error
        tau = law(data.qpos.copy(), data.qvel.copy(), asked)
        saturated += bool(np.any((tau <= low) | (tau >= high)))
        for _ in range(SUBSTEPS):
            friction = dry * np.tanh(data.qvel / COULOMB_SMOOTHING)
            data.qfrc_applied[:] = np.clip(tau, low, high) - friction
            mujoco.mj_step(model, data)
    tool, aim = (tool_poses(robot, q)[:, :3, 3] for q in (passed, wanted.q))
    return float(np.linalg.norm(tool - aim, axis=1).max()), saturated / len(passed)


def publish(page: Path, name: str, table: str) -> None:
    """Write a table of a benchmark between its marks in a page."""
    first, last = (f"<!-- {how} {name} -->\n" for how in ("made by benchmarks", END))
    before, _, rest = page.read_text("utf-8").partition(first)
    after = rest.partition(last)[2]
    page.write_text(f"{before}{first}\n{table}\n\n{last}{after}", "utf-8")


def main(arguments: list[str] | None = None) -> None:
    """Simulate one arm; print a line for each plan."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks plants", description=__doc__)
    parser.add_argument("--robot", default="microbot")
    parser.add_argument("--count", type=int, default=500, help="arms that are drawn")
    parser.add_argument("--mass", type=float, default=0.05, help="share of every link's mass")
    parser.add_argument("--friction", type=float, default=0.3, help="share of every friction")
    parser.add_argument("--payload", type=float, default=0.0, help="at the tool, in the model, kg")
    parser.add_argument("--gain", type=float, default=GAIN, help="of the controller, 1/s^2")
    parser.add_argument("--bound", type=float, default=BOUND, help="of the tool's error, m")
    parser.add_argument("--few", type=int, default=2, help="arms besides the corners to plan with")
    parser.add_argument("--seed", type=int, default=0, help="of the task and of the arms")
    parser.add_argument("--out", type=Path, help="file of lines to go on with")
    parser.add_argument("--table", type=Path, help="print the table of such a file, and no more")
    parser.add_argument("--page", type=Path, help="Markdown to write that table into")
    options = parser.parse_args(arguments)
    if options.table is not None:
        table = _table(read(options.table))
        print(table)
        if options.page:
            publish(options.page, "plants", table)
        return
    robot = with_small_bodies(mo.load_robot(options.robot)).with_payload(options.payload)
    via_q = poses(robot, options.seed)
    box: dict[str, Any] = {"mass": options.mass, "friction": options.friction}
    few = mo.execution.differing_plants(robot, **box, count=options.few, seed=options.seed)
    loop: Any = mo.ComputedTorque(kp=options.gain)
    reserve = mo.smallest_reserve(robot, via_q, loop, few, options.bound, sample_rate=RATE)
    if not reserve.solved:
        sys.exit(reserve.advice)
    stated = next(t.saturated for t in reserve.trials if t.reserve == reserve.reserve)
    plants = mo.execution.differing_plants(robot, **box, count=options.count, seed=options.seed + 1)
    task = {key: getattr(options, key) for key in TASK}
    rows = read(options.out)
    rows = [row for row in rows if {key: row[key] for key in task} == task]
    for plant in plants[len(rows) :]:
        row: dict[str, Any] = {**task, "reserve": reserve.reserve, "stated": stated}
        for name, motion in (("ideal", reserve.ideal), ("kept", reserve.motion)):
            error, saturated = played(robot, motion, plant, options.gain)
            row[name] = {"duration": motion.duration, "error": error, "saturated": saturated}
        rows.append(row)
        if options.out:
            with options.out.open("a") as file:
                file.write(json.dumps(row) + "\n")
    print(_table(rows))


def _table(rows: list[dict[str, Any]]) -> str:
    heads = ("arm, payload", "plan", "T, s", "arms played", "error, median and worst, mm")
    heads += ("above the bound", "at a limit, worst, % of the time", "above the stated share")
    lines = ["| " + " | ".join(heads) + " |", "|" + len(heads) * "---|"]
    for arm in dict.fromkeys(row["robot"] for row in rows):
        own = [row for row in rows if row["robot"] == arm]
        first = own[0]
        for name, title in (("ideal", "ideal"), ("kept", f"reserve {first['reserve']:.1%}")):
            error = np.array([row[name]["error"] for row in own])
            at = np.array([row[name]["saturated"] for row in own])
            cells = (
                f"{arm}, {first['payload']:g} kg",
                title,
                f"{first[name]['duration']:.3f}",
                f"{len(own)}",
                f"{1e3 * np.median(error):.1f}, {1e3 * error.max():.1f}",
                f"{(error > first['bound']).sum()} above {1e3 * first['bound']:g} mm",
                f"{100 * at.max():.1f}",
                f"{(at > first['stated']).sum()} above {100 * first['stated']:.1f} %",
            )
            lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)
