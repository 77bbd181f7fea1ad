"""``sweep``, ``replay`` and ``export``: studies and saved motions."""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import microbot_ocp as mo
from microbot_ocp._base import checks
from microbot_ocp._base.checks import InputError, plain
from microbot_ocp._base.reading import opened
from microbot_ocp._base.writing import made_folder, write_whole
from microbot_ocp.cli._declaration import FILE, OTHER_ROBOT, PROFILE, command
from microbot_ocp.cli._process import NotDone
from microbot_ocp.cli._report import Answer, Progress, Save, check_output, say
from microbot_ocp.motion import EXPORT_FORMATS, FILM_FORMATS, Motion, other_arm
from microbot_ocp.robot import Robot, packaged_robots
from microbot_ocp.tasks import Step, named_robot, read_cell

if TYPE_CHECKING:
    from microbot_ocp.sweeps import Study


@command(writes=("",))
def sweep(
    progress: Progress,
    study: Annotated[Path | None, FILE] = None,
    out: Path | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    case: int | None = None,
    summary: Path | None = None,
) -> Answer:
    """Solve thousands of cases by several methods.

    It uses all processors of this machine, or a cluster. Results are Parquet files in FOLDER/cases,
    one row per case. After an interruption the same command continues. Needs the extra "scale".

    Parameters
    ----------
    study : STUDY
        Study file (.toml).
    out : FOLDER
        Folder of the results; an unfinished study in it continues.
    workers : N
        Processes on this machine; default one per processor.
    scheduler : ADDRESS
        Dask scheduler of a cluster instead: tcp://HOST:PORT.
    case : N
        Solve one case here and print its row; --out writes its motions.
    summary : FOLDER
        Folder of results, whose statistics and figures are written.

    Examples
    --------
    $ microbot-ocp sweep study.toml --out results --workers 2
    """
    from microbot_ocp.sweeps import SweepStopped, read_study, run_study

    if (study is None) == (summary is None):
        raise InputError("give a study file, or --summary FOLDER")
    if summary is not None:
        return _summary(mo.load_sweep(summary))
    assert study is not None
    cases = read_study(study)
    if case is not None:
        return _case(cases, case, out)
    if out is None:
        raise InputError("give --out FOLDER for the results")
    if scheduler is not None and workers is not None:
        raise InputError("give --scheduler or --workers, not both")
    again = f"microbot-ocp sweep {study} --out {out}"
    again += "" if scheduler is None else f" --scheduler {scheduler}"
    shown = _shown(progress, again)
    try:
        results = run_study(cases, out, client=scheduler, workers=workers, progress=shown)
    except SweepStopped as problem:
        raise NotDone(str(problem)) from None
    return Answer(plain(results.summary()), [results.table()])


def _case(study: Study, case: int, out: Path | None) -> Answer:
    from microbot_ocp.sweeps import repeat_case

    row, motions = repeat_case(replace(study, motions=True) if out else study, case)
    saves = {name: partial(write_whole, content=content) for name, content in motions.items()}
    files = {made_folder(out) / f"{name}.npz": save for name, save in saves.items()} if out else {}
    values = {k: f"{v:.6g}" if isinstance(v, float) else v for k, v in row.items()}
    lines = [f"{name} = {value}" for name, value in values.items()]
    return Answer(row, lines=lines, solved=row["status"] == "solved", files=files)


def _summary(results: mo.sweeps.Sweep) -> Answer:
    """Collect statistics, failures with the commands that repeat them, figures, a recording."""
    files: dict[Path, Save] = {}
    if results.done:
        folder = made_folder(results.folder / "summary")
        compared = ["atlas", "quantities"] if len(results.methods) > 1 else []
        for kind in (*compared, "limits", "failures"):
            files[folder / f"{kind}.png"] = partial(_draw, results, kind)
        files[folder / "atlas.rrd"] = results.to_rerun
    statistics = results.summary()
    origin = results.about.get("origin") or "STUDY.toml"
    lines = [
        f"{failure.count:6,} {failure.status}: {failure.reason}\n"
        f"       microbot-ocp sweep {origin} --case {failure.case}"
        for failure in statistics.failures
    ]
    return Answer(plain(statistics), [results.table()], lines, files=files)


def _draw(results: mo.sweeps.Sweep, kind: str, path: Path) -> object:
    return results.plot(kind=kind).savefig(path)


def _shown(progress: Progress, again: str) -> Progress:
    """Return a progress function that also reports the end of the study without a terminal."""

    def show(step: Step) -> None:
        if step.stage == "interrupted":
            say(f"{step.done:,} of {step.total:,} cases are kept; continue with: {again}")
            return
        progress(step)
        if step.stage == "done" and not sys.stderr.isatty():
            say(step.text)

    return show


@command(recorded=True)
def replay(
    file: Annotated[Path, FILE],
    robot: Annotated[str | None, OTHER_ROBOT] = None,
    rerun: Path | None = None,
    open: bool = False,
) -> Answer:
    """Replay a saved motion or comparison in Rerun.

    --rerun writes the recording, --open shows it.

    Parameters
    ----------
    file : FILE
        Motion (.npz), recording (.rrd), or folder of a saved comparison.

    Examples
    --------
    $ microbot-ocp replay best.npz --rerun best.rrd
    """
    if rerun is None and not open:
        raise InputError("give --rerun FILE.rrd to write the recording, or --open to see it")
    if file.suffix == ".rrd":
        if rerun is not None or not file.is_file():
            raise InputError(
                f"{file} is already a recording, so replay can only show it: "
                f"microbot-ocp replay {file.name} --open"
            )
        _check_recording(file)
        return Answer({"recording": str(file)}, record=file)
    source = file.parent if file.name == "comparison.json" else file
    if source.is_dir():
        comparison = mo.load_comparison(source, robot)
        name, motions = comparison.robot.name, comparison.motions
        if not motions:
            raise InputError(f"{source}: none of the saved methods has a motion")
        record: Save = comparison.to_rerun
    else:
        motion = Motion.load(file)
        arm = _robot_of(motion, str(file), robot)
        name, motions = arm.name, {"motion": motion}
        record = partial(motion.to_rerun, arm)
    entries = {key: {"label": m.label, "duration": m.duration} for key, m in motions.items()}
    lines = [f"{motion.label}: {_lasting(motion)}" for motion in motions.values()]
    return Answer({"robot": name, "motions": entries}, lines=lines, record=record)


def _lasting(motion: Motion) -> str:
    """Return the duration of a motion, with its status if it is not solved."""
    status = "" if motion.solved else f", best motion found, not solved: {motion.status}"
    return f"{motion.duration:.3f} s{status}"


def _check_recording(path: Path) -> None:
    """Reject a file that Rerun cannot read."""
    from rerun.chunk import RrdReader

    try:
        opened(path).close()  # refuses a pipe, on which the reader would block
        RrdReader(path)
    except Exception as problem:  # the reader documents no exception type
        reason = getattr(problem, "strerror", None) or " ".join(str(problem).split())
        raise InputError(f"{path} is no recording: {reason}") from None


def _robot_of(motion: Motion, origin: str, named: str | None) -> Robot:
    """Load the robot of a motion; refuse a robot with other joints."""
    robot = named_robot(origin, motion.provenance.get("robot"), named)
    checks.joints(origin, motion.joint_count, robot)
    if named is None and (other := other_arm(robot, motion)):
        raise InputError(f"{origin}: {other}: name its own with --robot, a packaged name or a file")
    return robot


def stops_of(cell: Any) -> dict[str, Any]:
    """Return stops, segments, cycle and scene of a task as keywords; empty without a task."""
    keys = ("segments", "cycle", "scene")
    return {"via_q": cell.stops, **{key: getattr(cell, key) for key in keys}} if cell else {}


@command()
def export(
    file: Annotated[Path, FILE],
    target: Annotated[Path, FILE],
    progress: Progress,
    rate: float | None = None,
    robot: Annotated[str | None, OTHER_ROBOT] = None,
    profile: Annotated[str | None, PROFILE] = None,
    task: Path | None = None,
) -> Answer:
    """Write a saved motion for another program, or as a film.

    Parameters
    ----------
    file : FILE
        Motion (.npz), or for a film the folder of a comparison.
    target : TARGET
        File to write: .csv, .json (ROS trajectory), .mat, .parquet, .xml (MuJoCo keyframes), or a
        film, .gif or .mp4.
    rate : HZ
        Rate of the samples or frames, Hz.
    task : FILE
        Task of stops (.toml): a film shows its obstacles, tool lines and parts, a profile uses its
        payloads.

    Examples
    --------
    $ microbot-ocp export best.npz best.csv --rate 100
    """
    check_output("TARGET", target, (*EXPORT_FORMATS, *FILM_FORMATS))
    if target.suffix not in FILM_FORMATS:
        return _rows(file, target, rate, robot, profile, task)
    if profile is not None:
        raise InputError(f"--profile is for rows of a controller, not for films, {target.suffix}")
    return _film(file, target, robot, task, {"rate": rate, "progress": progress})


def _film(
    file: Path, target: Path, robot: str | None, task: Path | None, options: dict[str, Any]
) -> Answer:
    """Return the answer of ``export`` to a film."""
    from microbot_ocp.views.animation import animate_comparison, animate_motion

    if file.is_dir():
        comparison = mo.load_comparison(file, robot)
        durations = {name: motion.duration for name, motion in comparison.motions.items()}
        document = {"robot": comparison.robot.name, "motions": durations}
        return Answer(document, files={target: partial(animate_comparison, comparison, **options)})
    motion = Motion.load(file)
    cell = _cell_of(motion, robot, task)
    if cell is not None:
        document = {"robot": cell.robot.name, "certified": cell.certificate.ok}
        save = partial(cell.export, **options)
    else:
        arm = _robot_of(motion, str(file), robot)
        document = {"robot": robot or motion.provenance.get("robot"), "samples": motion.t.size}
        save = partial(animate_motion, arm, motion, **options)
    return Answer(document, lines=[_labelled(motion)], files={target: save})


def _rows(
    file: Path,
    target: Path,
    rate: float | None,
    robot: str | None,
    profile: str | None,
    task: Path | None,
) -> Answer:
    """Return the answer of ``export`` to a file of samples."""
    motion = Motion.load(file)
    if task is not None and profile is None:
        films = " and ".join(FILM_FORMATS)
        raise InputError(f"--task is for films, {films}, or a profile, not {target.suffix} alone")
    cell = _cell_of(motion, robot, task)
    name, arm = robot or motion.provenance.get("robot"), None
    if cell is not None:
        arm, name = cell.robot, cell.robot.name
    elif robot is not None or profile is not None or name in packaged_robots():
        arm = _robot_of(motion, str(file), robot)
    document: dict[str, Any] = {"robot": None if arm is None else name}
    line = _labelled(motion)
    if profile is None:
        sampled = motion if rate is None else motion.resample(rate, arm)
        save = partial(sampled.export, robot=arm)
    else:
        assert arm is not None
        if rate is not None:
            raise InputError("give --rate or --profile, not both: a profile has a rate")
        command = mo.execution.commanded(arm, motion, profile, **stops_of(cell))
        sampled, save = command.rows, partial(command.export, robot=arm)
        document |= {"profile": profile, "cost": command.cost}
        line += f", {1e3 * command.cost:.1f} ms longer by {command.profile.name}"
    document["samples"] = sampled.t.size
    return Answer(document, lines=[f"{line}, {sampled.t.size} samples"], files={target: save})


def _labelled(motion: Motion) -> str:
    return f"{motion.label}: {_lasting(motion)}"


def _cell_of(motion: Motion, robot: str | None, task: Path | None) -> Any:
    """Return the cell of a task with a motion in it, or None without a task."""
    cell = None if task is None else read_cell(task).certified(motion)
    if cell and robot and mo.load_robot(robot).chain_digest != cell.robot.chain_digest:
        raise InputError(f"give --robot or --task, not both: the task's is {cell.robot.name!r}")
    return cell
