"""``simulate``: the arm under given torques."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from microbot_ocp._base import checks
from microbot_ocp._base.checks import InputError
from microbot_ocp._base.table import Table
from microbot_ocp.cli._options import (
    Json,
    Open,
    OutMotion,
    Q,
    QDeg,
    Recording,
    RobotName,
    TimeLimit,
    Tip,
    numbers,
    one_number,
    option,
    optional_joint_values,
    writable,
)
from microbot_ocp.cli._output import Written, answer, in_degrees, number
from microbot_ocp.cli._recordings import Save, check_recording, open_recording
from microbot_ocp.motion import SAMPLE_STEP, Motion
from microbot_ocp.robot.files import load_robot
from microbot_ocp.simulation import simulate as integrate

if TYPE_CHECKING:
    from rich.console import Console


def simulate(
    robot_name: RobotName,
    tau: Annotated[
        str | None,
        option("--tau", what="Constant torques, N m (N); without torques the arm falls."),
    ] = None,
    motion_file: Annotated[
        Path | None,
        option("--motion", what="Torques of this motion (.npz), from its start.", metavar="FILE"),
    ] = None,
    q_deg: QDeg = None,
    q: Q = None,
    qd_deg: Annotated[
        str | None, option("--qd-deg", what="Speeds at the start, deg/s (m/s); default rest.")
    ] = None,
    qd: Annotated[str | None, option("--qd", what="The same in rad/s (m/s).")] = None,
    duration: Annotated[
        float | None,
        typer.Option(
            help="s; default 1, or that of the motion.",
            show_default=False,
            metavar="S",
            parser=one_number,
        ),
    ] = None,
    step: Annotated[
        float,
        typer.Option(help="Between the samples, s.", metavar="S", parser=one_number),
    ] = SAMPLE_STEP,
    time_limit: TimeLimit = None,
    out: OutMotion = None,
    rerun: Recording = None,
    open_viewer: Open = False,
    tip: Tip = None,
    as_json: Json = False,
) -> int:
    """Simulate the arm: free fall, or given torques.

    Torques are constants or those of a saved motion. Exit code 1 where the integrator fails.
    """
    robot = load_robot(robot_name, tip)
    if not robot.has_dynamics:
        raise InputError(f"robot {robot.name!r} has no masses: it cannot be simulated")
    writable(out, ".npz", "--out")
    check_recording(rerun, open_viewer)
    if tau is not None and motion_file is not None:
        raise InputError("give --tau or --motion, not both")
    start = optional_joint_values(robot, "q", q, q_deg)
    speeds = optional_joint_values(robot, "qd", qd, qd_deg)
    torques: Any = None
    if motion_file is not None:
        torques = Motion.load(motion_file)
        if torques.joint_count != robot.joint_count:
            raise InputError(
                f"{motion_file} has {torques.joint_count} joints, the robot {robot.joint_count}"
            )
    elif start is None:
        raise InputError("give the start: --q (rad) or --q-deg")
    elif tau is not None:
        torques = numbers("--tau", tau, robot.joint_count, ", ".join(robot.joint_names))
    length = duration
    if length is None:
        length = torques.duration if isinstance(torques, Motion) else 1.0
    length = checks.number("--duration", length, "s", above=0.0, at_most=checks.LONGEST)
    if step == SAMPLE_STEP:
        step = min(max(step, checks.longest_step(length, checks.MOST_SAMPLES)), length)
    step = checks.number("--step", step, "s", above=0.0, at_most=length)
    grid = np.linspace(0.0, length, checks.step_count(length, step) + 1)
    if isinstance(torques, Motion) and duration is None:
        grid = torques.t
    limit = np.inf if time_limit is None else time_limit
    result = integrate(robot, torques, start, speeds, grid, time_limit=limit)
    source = "free fall" if torques is None else "constant torques"
    if isinstance(torques, Motion):
        source = f"torques of {torques.label}"
    document: dict[str, Any] = {
        "robot": robot.name,
        "torques": source,
        "status": result.status,
        "advice": result.advice,
        "duration": length,
        "q_start": result.q[0],
        "q_end": result.q[-1],
        "qd_end": result.qd[-1],
        "qd_peak": np.abs(result.qd).max(axis=0),
        "condition_peak": result.condition_peak,
        "wall_time": result.wall_time,
    }
    written = Written()
    save: Save | None = None
    if result.solved:
        provenance = {"method": "simulation", "robot": robot.name, "torques": source}
        motion = replace(result.as_motion(f"simulation, {source}"), provenance=provenance)
        written.add(out, motion.save)
        save = partial(motion.to_rerun, robot)
        written.add(rerun, save)

    def text(console: Console) -> None:
        console.print(f"{robot.name}, {source}, {number(length)} s: {result.status}\n")
        units = ["deg" if kind == "revolute" else "m" for kind in robot.joint_types]
        ends = in_degrees(robot, result.q[0]), in_degrees(robot, result.q[-1])
        rates = in_degrees(robot, result.qd[-1]), in_degrees(robot, document["qd_peak"])
        rows = [
            [name, unit, *(number(float(column[j]), 3) for column in (*ends, *rates))]
            for j, (name, unit) in enumerate(zip(robot.joint_names, units, strict=True))
        ]
        heads = ["joint", "unit", "start", "end", "speed at the end [/s]", "peak speed [/s]"]
        console.print(Table.of_text(heads, rows, left=2), "")
        if result.advice:
            console.print(f"Advice: {result.advice}")

    code = answer(as_json, document, text, 0 if result.solved else 1, written)
    if open_viewer and save is not None:
        open_recording(save, rerun)
    return code
