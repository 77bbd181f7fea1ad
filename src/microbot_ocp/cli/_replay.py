"""``replay``: saved motions and comparisons in Rerun."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

import microbot_ocp as mo
from microbot_ocp._base import checks
from microbot_ocp._base.checks import InputError
from microbot_ocp.cli._options import Json, Open, Recording, option, robot_names
from microbot_ocp.cli._output import answer, close
from microbot_ocp.cli._recordings import (
    Save,
    check_recording,
    open_recording,
    write_recording,
)
from microbot_ocp.robot import JointLimits, Robot
from microbot_ocp.robot.files import load_robot, packaged_robots

if TYPE_CHECKING:
    from rich.console import Console

    from microbot_ocp.comparison import Comparison, Entry
    from microbot_ocp.motion import Motion


def replay(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE", help="Motion (.npz), or the folder that a comparison was saved in."
        ),
    ],
    robot_name: Annotated[
        str | None,
        option(
            "--robot",
            what="Robot of the motion, where the file names none.",
            metavar="ROBOT",
            completion=robot_names,
        ),
    ] = None,
    rerun: Recording = None,
    open_viewer: Open = False,
    as_json: Json = False,
) -> int:
    """Replay a saved motion or comparison in Rerun.

    --rerun writes the recording, --open shows it.
    """
    check_recording(rerun, open_viewer)
    if rerun is None and not open_viewer:
        raise InputError("give --rerun FILE.rrd to write the recording, or --open to see it")
    if file.suffix == ".rrd":
        raise InputError(f"{file} is a recording already: open it with rerun {file}")
    source = file.parent if file.name == "comparison.json" else file
    if source.is_dir():
        comparison = load_comparison(source, robot_name)
        robot, motions = comparison.robot, comparison.motions
        if not motions:
            raise InputError(f"{source}: none of the saved methods has a motion")
        save: Save = comparison.to_rerun
    else:
        motion = mo.Motion.load(file)
        robot = robot_of(motion, str(file), robot_name)
        motions = {"motion": motion}
        save = partial(motion.to_rerun, robot)
    written = write_recording(save, rerun)
    document = {
        "robot": robot.name,
        "motions": {
            name: {"label": m.label, "duration": m.duration} for name, m in motions.items()
        },
        "written": written,
    }

    def text(console: Console) -> None:
        for motion in motions.values():
            console.print(f"{motion.label}: {motion.duration:.3f} s", soft_wrap=True)
        close(console, "", written)

    code = answer(as_json, document, text)
    if open_viewer:
        open_recording(save, rerun)
    return code


def find_robot(origin: str, named: str | None, given: str | None) -> Robot:
    """The robot that was given, or the packaged one that a file names."""
    if given is not None:
        return load_robot(given)
    if named is None:
        raise InputError(f"{origin} does not name its robot: give --robot")
    if named not in packaged_robots():
        raise InputError(f"{origin} names the robot {named!r}, which is not packaged: give --robot")
    return load_robot(named)


def robot_of(motion: Motion, origin: str, given: str | None) -> Robot:
    """The robot of a motion; their joints fit."""
    robot = find_robot(origin, motion.provenance.get("robot"), given)
    if robot.joint_count != motion.joint_count:
        raise InputError(
            f"{origin} has {motion.joint_count} joints, but robot {robot.name!r} has "
            f"{robot.joint_count}"
        )
    return robot


def load_comparison(folder: Path, robot_name: str | None) -> Comparison:
    """A comparison from the folder it was saved in; its motions are certified anew."""
    origin = str(folder / "comparison.json")
    try:
        saved = json.loads((folder / "comparison.json").read_text("utf-8"))
        entries, via_q, limits = saved["entries"], saved["via_q"], _stored_limits(saved["limits"])
        name, reference = str(saved["robot"]), str(saved["reference"])
        rows = [(str(row["name"]), dict(row)) for row in entries]
    except OSError as problem:
        raise InputError(f"{origin} cannot be read: {problem.strerror}") from None
    except (ValueError, KeyError, TypeError, AttributeError) as problem:
        raise InputError(f"{origin} is not a saved comparison: {problem}") from None
    robot = find_robot(origin, name, robot_name)
    via = checks.array(f"via_q of {origin}", via_q, (None, robot.joint_count))
    robot = robot.with_limits(limits.for_joints(robot.joint_count))
    made = tuple(_entry(robot, via, folder, key, row) for key, row in rows)
    return mo.Comparison(robot, via, robot.limits, made, reference)


def _stored_limits(saved: Mapping[str, Any]) -> JointLimits:
    """Limits from JSON, where what is infinite is null."""
    arrays = {}
    for key, values in saved.items():
        none = -np.inf if key.endswith("_min") else np.inf
        arrays[key] = np.array([none if value is None else float(value) for value in values])
    return JointLimits(**arrays)


def _entry(robot: Robot, via: Any, folder: Path, name: str, row: Mapping[str, Any]) -> Entry:
    path = folder / "motions" / f"{name}.npz"
    motion = mo.Motion.load(path) if path.exists() else None
    if motion is not None and motion.joint_count != robot.joint_count:
        raise InputError(f"{path} has {motion.joint_count} joints, the robot {robot.joint_count}")
    return mo.Entry(
        name=name,
        title=str(row.get("title", name)),
        motion=motion,
        certificate=None if motion is None else mo.certify(robot, motion, via_q=via),
        status=str(row.get("status", "")),
        note=str(row.get("note", "")),
        **{key: _float(row.get(key)) for key in ("solve_time", "torque_squared", "work")},
        details={},
    )


def _float(value: Any) -> float:
    return float(value) if isinstance(value, int | float) else float("nan")
