"""``export``: saved motions for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import microbot_ocp as mo
from microbot_ocp._base.checks import InputError
from microbot_ocp.cli._options import Json, one_number, option, robot_names, writable
from microbot_ocp.cli._output import Written, answer
from microbot_ocp.motion import EXPORT_FORMATS
from microbot_ocp.robot import load_robot, packaged_robots

if TYPE_CHECKING:
    from rich.console import Console


def export(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Motion (.npz).")],
    target: Annotated[
        Path,
        typer.Argument(
            metavar="TARGET",
            help="What to write: .csv, .json (ROS trajectory), .mat, .parquet or .xml (MuJoCo).",
        ),
    ],
    rate: Annotated[
        float | None,
        typer.Option(help="Samples a second, Hz.", metavar="HZ", parser=one_number),
    ] = None,
    robot_name: Annotated[
        str | None,
        option(
            "--robot",
            what="Robot of the motion, where the file names none.",
            metavar="ROBOT",
            completion=robot_names,
        ),
    ] = None,
    as_json: Json = False,
) -> int:
    """Write a saved motion for another program."""
    writable(target, tuple(EXPORT_FORMATS), "TARGET")
    motion = mo.Motion.load(file)
    named = robot_name or motion.provenance.get("robot")
    if robot_name is None and named not in packaged_robots():
        named = None
    robot = None if named is None else load_robot(named)
    if robot is not None and robot.joint_count != motion.joint_count:
        raise InputError(f"{file} has {motion.joint_count} joints, the robot {robot.joint_count}")
    samples = len(motion.t) if rate is None else motion.resample(rate).t.size
    written = Written()
    written.add(target, lambda path: motion.export(path, rate, robot))
    document = {"robot": named, "samples": samples}

    def text(console: Console) -> None:
        console.print(f"{motion.label}: {motion.duration:.3f} s, {samples} samples")

    return answer(as_json, document, text, written=written)
