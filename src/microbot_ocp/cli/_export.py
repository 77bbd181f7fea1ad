"""``export``: saved motions and comparisons for other programs, and as films."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import microbot_ocp as mo
from microbot_ocp.cli._options import Json, MotionRobot, one_number, writable
from microbot_ocp.cli._output import Written, answer, shown_progress
from microbot_ocp.cli._replay import robot_of
from microbot_ocp.comparison import read_cell
from microbot_ocp.motion import EXPORT_FORMATS, FILM_FORMATS
from microbot_ocp.robot import packaged_robots

if TYPE_CHECKING:
    from rich.console import Console


def export(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE", help="Motion (.npz), or for a film the folder of a comparison."
        ),
    ],
    target: Annotated[
        Path,
        typer.Argument(
            metavar="TARGET",
            help="What to write: .csv, .json (ROS trajectory), .mat, .parquet, .xml (MuJoCo), "
            "or a film, .gif or .mp4.",
        ),
    ],
    rate: Annotated[
        float | None,
        typer.Option(help="Samples or frames a second, Hz.", metavar="HZ", parser=one_number),
    ] = None,
    robot_name: MotionRobot = None,
    task: Annotated[
        Path | None,
        typer.Option(
            help="Task of stops (.toml) whose obstacles, tool lines and parts a film shows.",
            metavar="FILE",
        ),
    ] = None,
    as_json: Json = False,
) -> int:
    """Write a saved motion for another program, or as a film."""
    writable(target, (*EXPORT_FORMATS, *FILM_FORMATS), "TARGET")
    written = Written()
    if file.is_dir() and target.suffix in FILM_FORMATS:
        comparison = mo.load_comparison(file, robot_name)
        from microbot_ocp.views.animation import animate_comparison

        with shown_progress(as_json) as progress:
            animate = partial(animate_comparison, comparison, rate=rate, progress=progress)
            written.add(target, animate)
        named = {name: motion.duration for name, motion in comparison.motions.items()}
        document = {"robot": comparison.robot.name, "motions": named}
        return answer(as_json, document, lambda console: None, written=written)
    motion = mo.Motion.load(file)
    if task is not None:
        return _cell_film(motion, task, target, rate, as_json)
    named = robot_name or motion.provenance.get("robot")
    film = target.suffix in FILM_FORMATS
    known = film or robot_name is not None or named in packaged_robots()
    robot = robot_of(motion, str(file), robot_name) if known else None
    sampled = motion if rate is None or film else motion.resample(rate, robot)
    samples = sampled.t.size
    if film and robot is not None:
        from microbot_ocp.views.animation import animate_motion

        with shown_progress(as_json) as progress:
            draw = partial(animate_motion, robot, motion, rate=rate, progress=progress)
            written.add(target, draw)
    else:
        written.add(target, lambda path: sampled.export(path, robot=robot))
    document = {"robot": named if known else None, "samples": samples}

    def text(console: Console) -> None:
        amount = "" if film else f", {samples} samples"
        console.print(f"{motion.label}: {motion.duration:.3f} s{amount}")

    return answer(as_json, document, text, written=written)


def _cell_film(
    motion: mo.Motion, task: Path, target: Path, rate: float | None, as_json: bool
) -> int:
    """A film of a motion through stops with all that belongs to its task."""
    if target.suffix not in FILM_FORMATS:
        raise mo.InputError(
            f"--task is for films, {' and '.join(FILM_FORMATS)}, not {target.suffix}"
        )
    cell, written = read_cell(task).certified(motion), Written()
    with shown_progress(as_json) as progress:
        written.add(target, partial(cell.export, rate=rate, progress=progress))
    document = {"robot": cell.robot.name, "certified": cell.certificate.ok}

    def text(console: Console) -> None:
        console.print(f"{motion.label}: {motion.duration:.3f} s", soft_wrap=True)

    return answer(as_json, document, text, written=written)
