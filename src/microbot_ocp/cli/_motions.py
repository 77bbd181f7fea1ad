"""``demo``, ``simulate``, ``compare``, ``time-optimal`` and ``solve``: motions and certificates."""

from __future__ import annotations

import sys
import webbrowser
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated, Any

import numpy as np

import microbot_ocp as mo
from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.showing import view_for
from microbot_ocp._base.table import Column, Table
from microbot_ocp.cli._declaration import (
    ARM,
    FILE,
    JOINTS,
    LIMITS,
    OTHER_ROBOT,
    PROFILE,
    VIA,
    Kind,
    Numbers,
    command,
)
from microbot_ocp.cli._files import stops_of
from microbot_ocp.cli._report import Answer, Progress, has_display
from microbot_ocp.execution import read_rows
from microbot_ocp.motion import SAMPLE_STEP, Motion
from microbot_ocp.planning import time_optimal as find_time_optimal
from microbot_ocp.robot import JointLimits, Robot
from microbot_ocp.tasks import METHODS, OUTPUTS, is_cell_file, read_cell, read_task, request_cell
from microbot_ocp.views import tables

REPORT = "report.html"
REQUESTED = replace(OTHER_ROBOT, text="Robot of a request.")

NAMES = Kind(
    metavar="NAMES",
    text=f"Some of {', '.join(METHODS)}; default all, those of given times with --time.",
    choices=lambda: list(METHODS),
    convert=lambda word: [name.strip() for name in word.split(",")],
)


@command({"simulate": "time_limit"}, writes=(".npz",), recorded=True)
def simulate(
    robot: Annotated[Robot, ARM],
    tau: Annotated[FloatArray | None, Numbers()] = None,
    motion: Path | None = None,
    q0: Annotated[FloatArray | None, replace(JOINTS, name="q")] = None,
    qd0: Annotated[FloatArray | None, replace(JOINTS, name="qd")] = None,
    duration: float | None = None,
    step: float = SAMPLE_STEP,
    **settings: Any,
) -> Answer:
    """Simulate the arm: free fall, or given torques.

    Torques are constant or come from a saved motion. Exit code 1 if the integrator fails.

    Parameters
    ----------
    tau : LIST
        Constant torques, N m (N); without torques the arm falls.
    motion : FILE
        Torques of this motion (.npz), from its start.
    duration : S
        Simulated time, s; default 1, or the duration of the motion.
    step : S
        Time between two samples, s.

    Examples
    --------
    $ microbot-ocp simulate microbot --q-deg 0,30,20 --out fall.npz
    """
    if not robot.has_dynamics:
        raise InputError(f"robot {robot.name!r} has no masses: it cannot be simulated")
    if tau is not None and motion is not None:
        raise InputError("give --tau or --motion, not both")
    if motion is None and q0 is None:
        raise InputError("give the start: --q (rad) or --q-deg")
    torques: Motion | FloatArray | None = tau
    source = "free fall" if tau is None else "constant torques"
    grid = _samples(1.0 if duration is None else duration, step)
    if motion is not None:
        torques = Motion.load(motion)
        source = f"torques of {torques.label}"
        grid = torques.t if duration is None else grid
    result = mo.simulate(robot, torques, q0, qd0, grid, **settings)
    peaks = np.abs(result.qd).max(axis=0)
    document = {
        "robot": robot.name,
        "torques": source,
        "status": result.status,
        "advice": result.advice,
        "duration": float(grid[-1]),
        "q_start": result.q[0],
        "q_end": result.q[-1],
        "qd_end": result.qd[-1],
        "qd_peak": peaks,
        "condition_peak": result.condition_peak,
        "wall_time": result.wall_time,
    }
    units = tables.joint_units(robot)
    values = tables.in_degrees(robot, [result.q[0], result.q[-1], result.qd[-1], peaks])
    rows = [
        [name, unit, *(tables.number(float(value), 3) for value in column)]
        for name, unit, column in zip(robot.joint_names, units, values.T, strict=True)
    ]
    heads = ["joint", "unit", "start", "end", "speed at the end [/s]", "peak speed [/s]"]
    blocks = [
        f"{robot.name}, {source}, {tables.number(float(grid[-1]))} s: {result.status}\n",
        Table.of_text(heads, rows, left=2),
        *[f"Advice: {result.advice}"] * bool(result.advice),
    ]
    if not result.solved:
        return Answer(document, blocks, solved=False, files={})
    provenance = {"method": "simulation", "robot": robot.name, "torques": source}
    simulated = replace(result.as_motion(f"simulation, {source}"), provenance=provenance)
    record = partial(simulated.to_rerun, robot)
    return Answer(document, blocks, save=simulated.save, record=record)


def _samples(duration: float, step: float) -> FloatArray:
    """Return the sample times, s; the default step grows if there were too many samples."""
    length = checks.number("--duration", duration, "s", above=0.0, at_most=checks.LONGEST)
    if step == SAMPLE_STEP:
        step = min(max(step, checks.longest_step(length, checks.MOST_SAMPLES)), length)
    step = checks.number("--step", step, "s", above=0.0, at_most=length)
    return np.linspace(0.0, length, checks.step_count(length, step) + 1)


@command(
    {"planning.TimeOptimalSettings": "mesh", "compare": "time_limit profile"},
    writes=("",), recorded=True, solves=True,
)  # fmt: skip
def compare(
    robot: Annotated[Robot, ARM],
    via_q: Annotated[FloatArray, VIA],
    limits: Annotated[JointLimits, LIMITS],
    progress: Progress,
    methods: Annotated[Sequence[str] | None, NAMES] = None,
    via_t: Annotated[Sequence[float] | None, Numbers(labels=None, name="time")] = None,
    **settings: Any,
) -> Answer:
    """Compare several methods on one task, under the same limits.

    Every motion is certified; the Rerun recording shows all motions on one timeline. A limit is one
    number, or comma-separated numbers, one per joint; the default is the robot's limit. Exit code 1
    if a method found no certified solution.

    Parameters
    ----------
    out : FOLDER
        Folder for tables, figures, recording, motions.

    Examples
    --------
    $ microbot-ocp compare microbot --via-deg '0,0,0 -8,45,30 -90,90,90' --out out
    """
    comparison = mo.compare(
        robot, via_q, methods, limits, via_t=via_t, progress=progress, **settings
    )
    return _compared(comparison, OUTPUTS, progress)


@command(
    {"planning.TimeOptimalSettings": "mesh starts tries slack time_limit"},
    writes=(".npz",), recorded=True, solves=True,
)  # fmt: skip
def time_optimal(
    robot: Annotated[Robot, ARM],
    via_q: Annotated[FloatArray, VIA],
    limits: Annotated[JointLimits, LIMITS],
    progress: Progress,
    **settings: Any,
) -> Answer:
    """Find and certify the fastest motion through via points.

    The motion starts and ends at rest. A limit is one number, or comma-separated numbers, one per
    joint; the default is the robot's limit. Exit code 1 if the solver did not converge or the
    certificate is refused.

    Examples
    --------
    $ microbot-ocp time-optimal microbot --via-deg '0,0,0 -90,90,90' --qd-max 2
    """
    limited = robot.with_limits(limits)
    motion = find_time_optimal(limited, via_q, progress=progress, **settings)
    progress(f"certify: {motion.duration:.4f} s")
    certificate = mo.certify(limited, motion, via_q=via_q)
    motion = replace(motion, provenance={**motion.provenance, "robot": robot.name})

    def record(path: Path) -> object:
        from microbot_ocp.views.recording import of_motion

        return of_motion(limited, motion, certificate).save(path)

    document = {
        "robot": robot.name,
        "via_q": via_q,
        "limits": limited.limits.as_dict(),
        **{key: getattr(motion, key) for key in ("solved", "status", "advice", "duration")},
        "marks": [{"time": mark.time, "name": mark.name} for mark in motion.marks],
        "certificate": certificate.as_dict(),
    }
    inner = [mark.time for mark in motion.marks if 0 < mark.time < motion.duration]
    times = [0.0, *inner, motion.duration]
    passages = [(t, tables.pose_text(robot, via)) for t, via in zip(times, via_q, strict=False)]
    blocks = [
        *_motion(robot, motion, passages, ""),
        *tables.use_blocks(robot, certificate),
        *[f"Advice: {motion.advice}"] * (not motion.solved),
    ]
    good = motion.solved, certificate.ok
    return Answer(document, blocks, (), *good, save=motion.save, record=record)


@command({"planning.TimeOptimalSettings": ""}, writes=("",), solves=True)
def solve(
    file: Annotated[Path, FILE],
    progress: Progress,
    time_limit: float | None = None,
    robot: Annotated[str | None, REQUESTED] = None,
    scene: Path | None = None,
) -> Answer:
    """Solve a task (.toml) or a motion plan request of MoveIt.

    A task with [[stop]] tables gives a motion through stops, any other task a comparison of
    methods. Exit code 1 if a method found no certified solution.

    Parameters
    ----------
    file : FILE
        Task in TOML (docs/task_file.md has the keys), or moveit_msgs/MotionPlanRequest in .yaml.
    scene : FILE
        Obstacles around the arm of a request: .yaml (moveit_msgs/PlanningScene), .toml or .urdf.
    out : FOLDER
        Folder for tables, figures, recording, motions.

    Examples
    --------
    $ microbot-ocp solve task.toml --out out
    """
    if file.suffix.lower() in (".yaml", ".yml"):
        if robot is None:
            raise InputError(f"give --robot: {file.name} names joints, but no robot")
        arm = mo.load_robot(robot)
        around = None if scene is None else mo.load_scene(scene, robot=arm)
        stops = request_cell(file, arm, around)
    elif robot is not None or scene is not None:
        raise InputError("--robot and --scene are for a request in .yaml; a task names both itself")
    elif not is_cell_file(file):
        task = read_task(file)
        limit = np.inf if time_limit is None else time_limit
        return _compared(task.compare(progress, limit), task.outputs, progress)
    else:
        stops = read_cell(file)
    if time_limit is not None:
        stops = replace(stops, settings=replace(stops.settings, time_limit=time_limit))
    cell = stops.solve(progress)
    motion, front = cell.motion, cell.front
    note = f"{motion.note.rstrip('.')}." if motion.note else ""
    blocks = [
        *_motion(cell.robot, motion, [(mark.time, mark.name) for mark in motion.marks], note),
        *tables.use_blocks(cell.robot, cell.certificate),
        *(tables.front_blocks(front) if front is not None else ()),
    ]
    points = (cell,) if front is None else front.points
    solved = all(point.motion.solved for point in points)
    certified = all(point.certificate.ok for point in points)
    save = partial(cell.save, outputs=stops.outputs)
    return Answer(cell.as_dict(), blocks, (), solved, certified, save=save)


@command(writes=(".html",))
def check(
    file: Annotated[Path, FILE],
    profile: Annotated[str, PROFILE],
    robot: Annotated[str | None, replace(OTHER_ROBOT, text="Robot whose trajectory it is.")] = None,
    scene: Path | None = None,
    task: Path | None = None,
) -> Answer:
    """Check any trajectory as a controller executes it.

    The controller's interpolation of the rows is certified under the limits of the robot and of the
    profile. Exit code 1 if a limit is exceeded.

    Parameters
    ----------
    file : FILE
        Trajectory: .csv, .npz, or a JointTrajectory of ROS as .json or .yaml.
    scene : FILE
        Scene (.toml) with the obstacles to keep clear of.
    task : FILE
        Task of stops (.toml) with payloads, instead of --robot and --scene.
    out : FILE
        Write a report to this .html file.

    Examples
    --------
    $ microbot-ocp check best.csv --robot panda --profile panda
    """
    if (robot is None) == (task is None):
        raise InputError("give --robot, or --task, which names the robot")
    if task is not None and scene is not None:
        raise InputError("give --scene or --task, not both: a task has a scene")
    cell = None if task is None else read_cell(task)
    stops = stops_of(cell)
    arm = mo.load_robot(str(robot)) if cell is None else cell.robot.with_limits(cell.limits)
    surroundings = stops.pop("scene", None)
    if scene is not None:
        surroundings = mo.load_scene(scene, robot=arm)
    certificate = mo.check(arm, file, profile, scene=surroundings, **stops)
    document = {"robot": arm.name, "profile": profile, "certificate": certificate.as_dict()}

    def save(path: Path) -> object:
        played = mo.executed(arm, read_rows(file, arm), profile, **stops)
        return view_for(certificate, "html_report")(certificate, arm, played, path)

    blocks = tables.use_blocks(arm, certificate)
    return Answer(document, blocks, certified=certificate.ok, save=save)


@command(
    {"planning.TimeOptimalSettings": "mesh"},
    writes=("",), folder="microbot-demo", recorded=True, solves=True,
)  # fmt: skip
def demo(progress: Progress, **settings: Any) -> Answer:
    """Run a ready-made comparison of all methods.

    The 3R Microbot moves through three poses by every method, under the same limits. On a terminal
    with a screen the report opens at the end. Exit code 1 if a method found no certified solution.

    Parameters
    ----------
    out : FOLDER
        Folder for the report, tables, figures, recording, motions.

    Examples
    --------
    $ microbot-ocp demo
    """
    with as_file(files("microbot_ocp.tasks") / "packaged" / "demo.toml") as path:
        task = read_task(path)
    task = replace(task, settings={**task.settings, **settings})
    answer = _compared(task.compare(progress), task.outputs, progress)

    def save(path: Path) -> object:
        written = answer.save(path) if answer.save else []
        if sys.stdout.isatty() and has_display():
            webbrowser.open((path / REPORT).absolute().as_uri())
        return written

    return replace(answer, save=save)


@command()
def studio(
    robot: Annotated[Any, ARM] = "microbot",
    via_q: Annotated[FloatArray | None, VIA] = None,
    port: int = 8080,
    dark: bool = False,
) -> Answer:
    """Open a page with movable via points and limits.

    The page shows the fastest motion through these points, at an address of this machine; Ctrl-C
    closes it.

    Parameters
    ----------
    port
        Port of the page; the next free port if it is taken.
    dark
        Start with the dark theme.

    Examples
    --------
    $ microbot-ocp studio microbot --via-deg '0,0,0 -8,45,30 -90,90,90'
    """
    from microbot_ocp.views import studio as open_studio

    page = open_studio(robot, via_q, port=port, dark=dark)
    if has_display():
        webbrowser.open(page.address)
    print(f"{page.address} (Ctrl-C ends it)", file=sys.stderr, flush=True)
    try:
        page.wait_until_closed()
    finally:
        page.close()
    return Answer({"address": page.address})


def _compared(comparison: mo.Comparison, outputs: Sequence[str], progress: Progress) -> Answer:
    """Return the answer of a comparison: a full table, and a narrow one for narrow terminals."""
    document = {
        "robot": comparison.robot.name,
        "via_q": comparison.via_q,
        "limits": comparison.limits.as_dict(),
        **{key: getattr(comparison, key) for key in ("reference", "solved", "certified")},
        "entries": tables.comparison_rows(comparison),
    }
    save = partial(comparison.save, outputs=outputs, progress=progress)
    table = comparison.table()
    good = comparison.solved, comparison.certified
    return Answer(
        document, [[table, _narrow(table)]], (), *good, save=save, record=comparison.to_rerun
    )


def _narrow(table: Table) -> Table:
    """Return a table of at most 80 columns: no costs, broken heads, no names of limits."""

    def narrow(column: Column) -> Column:
        if not column.head.startswith("peak"):
            return column
        head = column.title.replace(" ", "\n")
        return Column(head, show=lambda value: column.text(value).split(" (")[0])

    main = table.without("∫tau²", "work", "solve")
    return replace(main, columns=[narrow(column) for column in main.columns])


def _motion(
    robot: Robot, motion: Motion, passages: Iterable[tuple[float, str]], note: str
) -> list[str]:
    """Return the title of a motion, the times of its via points or stops, and a note."""
    title = f"{robot.name}, {motion.label}: {motion.duration:.4f} s, {motion.status}"
    lines = [title, *(f"  {time:8.4f} s  {where}" for time, where in passages)]
    return ["\n".join([*lines, *[note] * bool(note)]) + "\n"]
