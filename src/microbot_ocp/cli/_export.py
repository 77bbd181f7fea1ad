"""``export``: saved motions for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import microbot_ocp as mo
from microbot_ocp.cli._options import Json, MotionRobot, one_number, writable
from microbot_ocp.cli._output import Written, answer
from microbot_ocp.cli._replay import robot_of
from microbot_ocp.motion import EXPORT_FORMATS
from microbot_ocp.robot import packaged_robots

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
    robot_name: MotionRobot = None,
    as_json: Json = False,
) -> int:
    """Write a saved motion for another program."""
    writable(target, tuple(EXPORT_FORMATS), "TARGET")
    motion = mo.Motion.load(file)
    named = robot_name or motion.provenance.get("robot")
    known = robot_name is not None or named in packaged_robots()
    robot = robot_of(motion, str(file), robot_name) if known else None
    sampled = motion if rate is None else motion.resample(rate, robot)
    samples = sampled.t.size
    written = Written()
    written.add(target, lambda path: sampled.export(path, robot=robot))
    document = {"robot": named if known else None, "samples": samples}

    def text(console: Console) -> None:
        console.print(f"{motion.label}: {motion.duration:.3f} s, {samples} samples")

    return answer(as_json, document, text, written=written)
