"""``replay``: saved motions and comparisons in Rerun."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import microbot_ocp as mo
from microbot_ocp._base.checks import InputError, shortened
from microbot_ocp.cli._options import Json, MotionRobot, Open, Recording
from microbot_ocp.cli._output import Written, answer
from microbot_ocp.cli._recordings import Save, check_is_recording, check_recording, open_recording
from microbot_ocp.comparison import named_robot
from microbot_ocp.robot import Robot

if TYPE_CHECKING:
    from rich.console import Console

    from microbot_ocp.motion import Motion


def replay(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            help="Motion (.npz), recording (.rrd), or the folder that a comparison was saved in.",
        ),
    ],
    robot_name: MotionRobot = None,
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
        if rerun is not None or not file.is_file():
            raise InputError(
                f"{shortened(str(file), 150)} is a recording already, which replay can show only: "
                f"microbot-ocp replay {shortened(file.name, 60)} --open"
            )
        check_is_recording(file)
        code = answer(as_json, {"recording": str(file)}, lambda console: None)
        open_recording(lambda path: path, file)
        return code
    source = file.parent if file.name == "comparison.json" else file
    if source.is_dir():
        comparison = mo.load_comparison(source, robot_name)
        robot, motions = comparison.robot, comparison.motions
        if not motions:
            raise InputError(f"{source}: none of the saved methods has a motion")
        save: Save = comparison.to_rerun
    else:
        motion = mo.Motion.load(file)
        robot = robot_of(motion, str(file), robot_name)
        motions = {"motion": motion}
        save = partial(motion.to_rerun, robot)
    written = Written()
    written.add(rerun, save)
    document = {
        "robot": robot.name,
        "motions": {
            name: {"label": m.label, "duration": m.duration} for name, m in motions.items()
        },
    }

    def text(console: Console) -> None:
        for motion in motions.values():
            console.print(f"{motion.label}: {motion.duration:.3f} s", soft_wrap=True)

    code = answer(as_json, document, text, written=written)
    if open_viewer:
        open_recording(save, rerun)
    return code


def robot_of(motion: Motion, origin: str, given: str | None) -> Robot:
    """The robot of a motion; their joints fit."""
    robot = named_robot(origin, motion.provenance.get("robot"), given)
    if robot.joint_count != motion.joint_count:
        raise InputError(
            f"{origin} has {motion.joint_count} joints, but robot {robot.name!r} has "
            f"{robot.joint_count}"
        )
    return robot
