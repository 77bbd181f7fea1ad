"""``compare``, ``time-optimal`` and ``solve``: motions found, certified and shown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from microbot_ocp._base.table import Column, Table
from microbot_ocp.cli._options import (
    AllowUncertified,
    Iterations,
    Json,
    Live,
    LiveConnect,
    LiveServe,
    MotionTimeLimit,
    Open,
    OutFolder,
    OutMotion,
    Recording,
    RobotName,
    Tip,
    Via,
    ViaDeg,
    limits_of,
    numbers,
    option,
    output_folder,
    via_points,
    whole_number,
    with_limit_options,
    writable,
)
from microbot_ocp.cli._output import Written, answer, joint_text, shown_progress
from microbot_ocp.cli._recordings import check_recording, open_recording
from microbot_ocp.cli._watching import Watchers
from microbot_ocp.comparison import (
    METHODS,
    OUTPUTS,
    Certificate,
    Comparison,
    Front,
    Progress,
    Step,
    certify,
    compare as compare_methods,
    is_cell_file,
    read_cell,
    read_task,
)
from microbot_ocp.motion import Motion
from microbot_ocp.ocp.solution import Iteration, StepProgress
from microbot_ocp.planning import TimeOptimalSettings, time_optimal as find_time_optimal
from microbot_ocp.robot import Robot
from microbot_ocp.robot.files import load_robot

if TYPE_CHECKING:
    from rich.console import Console

WIDE = 110  # columns that the full table of a comparison needs

Mesh = Annotated[
    int | None,
    typer.Option(
        help="Intervals between two via points.",
        metavar="N",
        parser=whole_number,
        show_default="100, fewer for many via points",
    ),
]


def _method_names(incomplete: str) -> list[str]:
    """Methods to complete the last name of a list with."""
    *named, last = incomplete.split(",")
    return [
        ",".join([*named, name]) for name in METHODS if name.startswith(last) and name not in named
    ]


@with_limit_options
def compare(
    context: typer.Context,
    robot_name: RobotName,
    via_deg: ViaDeg = None,
    via: Via = None,
    methods: Annotated[
        str | None,
        option(
            "--methods",
            what=f"Some of {', '.join(METHODS)}; default all, those of given times with --time.",
            metavar="NAMES",
            completion=_method_names,
        ),
    ] = None,
    time: Annotated[
        str | None,
        option("--time", what="Times at the via points for the methods of given times, s."),
    ] = None,
    mesh: Mesh = None,
    time_limit: MotionTimeLimit = None,
    out: OutFolder = None,
    rerun: Recording = None,
    open_viewer: Open = False,
    iterations: Iterations = None,
    live: Live = False,
    live_serve: LiveServe = False,
    live_connect: LiveConnect = None,
    tip: Tip = None,
    allow_uncertified: AllowUncertified = False,
    as_json: Json = False,
) -> int:
    """Compare several methods on one task, under the same limits.

    Every motion is certified. A limit is one number, or one a joint with commas between; those not
    given are the robot's own. Exit code 1 where a method found no certified solution.
    """
    robot = load_robot(robot_name, tip)
    points = via_points(robot, via, via_deg)
    output_folder(out)
    check_recording(rerun, open_viewer)
    watchers = Watchers(live, live_serve, live_connect, iterations)
    with watchers.progress(as_json) as progress:
        result = compare_methods(
            robot,
            points,
            [name.strip() for name in methods.split(",")] if methods is not None else None,
            limits_of(robot, context.params),
            via_t=numbers("--time", time, len(points)) if time is not None else None,
            progress=progress,
            time_limit=np.inf if time_limit is None else time_limit,
            **({} if mesh is None else {"mesh": mesh}),
        )
    written = _save(as_json, result, out, OUTPUTS, watchers.written, rerun)
    code = _show_comparison(as_json, result, written, out, allow_uncertified)
    if open_viewer:
        open_recording(result.to_rerun, rerun)
    watchers.linger()
    return code


@with_limit_options
def time_optimal(
    context: typer.Context,
    robot_name: RobotName,
    via_deg: ViaDeg = None,
    via: Via = None,
    mesh: Mesh = None,
    starts: Annotated[
        int,
        typer.Option(help="Starting motions to try.", metavar="N", parser=whole_number),
    ] = TimeOptimalSettings.starts,
    tries: Annotated[
        int,
        typer.Option(
            help="Starts to try at most, while another is likely to lead to an optimum that none "
            "of them led to.",
            metavar="N",
            parser=whole_number,
        ),
    ] = TimeOptimalSettings.tries,
    slack: Annotated[
        float,
        typer.Option(
            help="Share of the duration to give for less effort: 0.01 is the motion of least "
            "effort of all that are at most 1 % slower.",
            metavar="SHARE",
        ),
    ] = TimeOptimalSettings.slack,
    time_limit: MotionTimeLimit = None,
    out: OutMotion = None,
    rerun: Recording = None,
    open_viewer: Open = False,
    iterations: Iterations = None,
    live: Live = False,
    live_serve: LiveServe = False,
    live_connect: LiveConnect = None,
    tip: Tip = None,
    allow_uncertified: AllowUncertified = False,
    as_json: Json = False,
) -> int:
    """Find and certify the fastest motion through via points.

    It is at rest at both ends. A limit is one number, or one a joint with commas between; those not
    given are the robot's own. Exit code 1 where the solver did not converge or the certificate is
    refused.
    """
    robot = load_robot(robot_name, tip)
    points = via_points(robot, via, via_deg)
    limited = robot.with_limits(limits_of(robot, context.params))
    writable(out, ".npz", "--out")
    check_recording(rerun, open_viewer)
    watchers = Watchers(live, live_serve, live_connect, iterations)
    settings = TimeOptimalSettings(
        mesh=mesh,
        starts=starts,
        tries=tries,
        slack=slack,
        time_limit=time_limit,
    )
    with watchers.progress(as_json) as progress:
        motion = find_time_optimal(
            limited, points, settings=settings, progress=_steps(progress, "solve")
        )
        _steps(progress, "certify")(f"{motion.duration:.4f} s")
        certificate = certify(limited, motion, via_q=points)
    motion = replace(motion, provenance={**motion.provenance, "robot": robot.name})

    def save(path: Path) -> Path:
        from microbot_ocp.views.recording import of_motion

        return of_motion(limited, motion, certificate).save(path)

    written = watchers.written
    written.add(out, motion.save)
    written.add(rerun, save)
    document = {
        "robot": robot.name,
        "via_q": points,
        "limits": limited.limits.as_dict(),
        "solved": motion.solved,
        "status": motion.status,
        "advice": motion.provenance.get("advice", ""),
        "duration": motion.duration,
        "marks": [{"time": mark.time, "name": mark.name} for mark in motion.marks],
        "certificate": certificate.as_dict(),
    }

    def text(console: Console) -> None:
        _show_motion(console, limited, points, motion, certificate)
        if not motion.solved and document["advice"]:
            console.print(f"Advice: {document['advice']}")

    good = motion.solved and (certificate.ok or allow_uncertified)
    code = answer(as_json, document, text, 0 if good else 1, written)
    if open_viewer:
        open_recording(save, rerun)
    watchers.linger()
    return code


def solve(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="Task in TOML; docs/task_file.md has the keys.")
    ],
    time_limit: MotionTimeLimit = None,
    out: OutFolder = None,
    iterations: Iterations = None,
    live: Live = False,
    live_serve: LiveServe = False,
    live_connect: LiveConnect = None,
    allow_uncertified: AllowUncertified = False,
    as_json: Json = False,
) -> int:
    """Solve the task of a TOML file.

    With [[stop]] tables it is a motion through stops, else a comparison of methods. --out says
    where its outputs go. Exit code 1 where a method found no certified solution.
    """
    if is_cell_file(file):
        watchers = Watchers(live, live_serve, live_connect, iterations)
        return _solve_cell(file, time_limit, out, watchers, allow_uncertified, as_json)
    task = read_task(file)
    output_folder(out)
    watchers = Watchers(live, live_serve, live_connect, iterations)
    with watchers.progress(as_json) as progress:
        result = task.compare(progress, np.inf if time_limit is None else time_limit)
    written = _save(as_json, result, out, task.outputs, watchers.written)
    code = _show_comparison(as_json, result, written, out, allow_uncertified)
    watchers.linger()
    return code


def _solve_cell(
    file: Path,
    time_limit: float | None,
    out: Path | None,
    watchers: Watchers,
    allow_uncertified: bool,
    as_json: bool,
) -> int:
    """Find, certify and write a motion through stops."""
    task = read_cell(file)
    if time_limit is not None:
        task = replace(task, settings=replace(task.settings, time_limit=time_limit))
    output_folder(out)
    with watchers.progress(as_json) as progress:
        cell = task.solve(_steps(progress, "solve"))
    written = watchers.written
    written.add(out, lambda path: cell.save(path, task.outputs))

    def text(console: Console) -> None:
        motion, certificate = cell.motion, cell.certificate
        console.print(
            f"{cell.robot.name}, {motion.label}: {motion.duration:.4f} s, {motion.status}"
        )
        for mark in motion.marks:
            console.print(f"  {mark.time:8.4f} s  {mark.name}")
        console.print(f"{motion.note.rstrip('.')}." if motion.note else "", soft_wrap=True)
        console.print()
        _show_shares(console, cell.robot, certificate)
        if cell.front is not None:
            _show_front(console, cell.front)

    points = cell.front.points if cell.front is not None else (cell,)
    good = all(p.motion.solved and (p.certificate.ok or allow_uncertified) for p in points)
    code = answer(as_json, cell.as_dict(), text, 0 if good else 1, written, out)
    watchers.linger()
    return code


def _show_front(console: Console, front: Front) -> None:
    heads = ["duration [s]", "effort [s]", "peak torque [%]", "status", "certificate"]
    rows = [
        [
            f"{point.duration:.4f}",
            f"{point.effort:.4g}",
            _share(point.peak_torque),
            str(point.motion.status),
            point.certificate.outcome
            + ("" if point.certificate.ok else f": {point.certificate.verdict}"),
        ]
        for point in front.points
    ]
    console.print()
    console.print(Table.of_text(heads, rows))
    if front.ended:
        console.print(front.ended)


def _save(
    as_json: bool,
    comparison: Comparison,
    folder: Path | None,
    outputs: Sequence[str],
    written: Written,
    rerun: Path | None = None,
) -> Written:
    """Write some of :data:`OUTPUTS` into a folder and a recording, where they are given."""
    with shown_progress(as_json) as progress:
        written.add(folder, lambda path: comparison.save(path, outputs, progress=progress))
        if rerun is not None:
            progress(Step(0, 1, "write", str(rerun)))
        written.add(rerun, comparison.to_rerun)
    return written


def _show_comparison(
    as_json: bool,
    comparison: Comparison,
    written: Written,
    out: Path | None,
    allow_uncertified: bool,
) -> int:
    from microbot_ocp.views.tables import comparison_rows

    document = {
        "robot": comparison.robot.name,
        "via_q": comparison.via_q,
        "limits": comparison.limits.as_dict(),
        "reference": comparison.reference,
        "solved": comparison.solved,
        "certified": comparison.certified,
        "entries": comparison_rows(comparison),
    }

    def text(console: Console) -> None:
        table = comparison.table()
        console.print(table if console.width >= WIDE else _narrow(table))

    good = comparison.solved and (comparison.certified or allow_uncertified)
    return answer(as_json, document, text, 0 if good else 1, written, out)


def _narrow(table: Table) -> Table:
    """For 80 columns: without costs, and peaks under heads of several lines, without names."""
    kept = table.without("∫tau²", "work", "solve")

    def narrow(column: Column) -> Column:
        if not column.head.startswith("peak"):
            return column
        head = column.title.replace(" ", "\n")
        return Column(head, show=lambda value: column.text(value).split(" (")[0])

    return replace(kept, columns=[narrow(column) for column in kept.columns])


def _show_motion(
    console: Console, robot: Robot, via_q: Any, motion: Motion, certificate: Certificate
) -> None:
    console.print(f"{robot.name}, {motion.label}: {motion.duration:.4f} s, {motion.status}")
    times = [0.0, *(m.time for m in motion.marks if 0 < m.time < motion.duration), motion.duration]
    for time, via in zip(times, via_q, strict=False):
        console.print(f"  {time:8.4f} s  {joint_text(robot, via)}")
    console.print()
    _show_shares(console, robot, certificate)


def _show_shares(console: Console, robot: Robot, certificate: Certificate) -> None:
    checks = [check for check in certificate.limit_checks if np.isfinite(check.utilisation).any()]
    checked = [check for check in checks if check.labels == robot.joint_names]
    rows = [
        [name, *(_share(float(check.utilisation[j])) for check in checked)]
        for j, name in enumerate(robot.joint_names)
    ]
    heads = ["share of limit", *(f"{c.quantity} [%]" for c in checked)]
    console.print(Table.of_text(heads, rows), "")
    for check in checks:
        if check not in checked:
            shares = ", ".join(
                f"{label} {_share(float(share))}".strip()
                for label, share in zip(check.labels, check.utilisation, strict=True)
            )
            console.print(f"share of the limit of {check.name} [%]: {shares}")
    console.print(f"Certificate: {certificate.outcome}; {certificate.verdict}")


def _share(value: float) -> str:
    return "–" if not np.isfinite(value) else f"{100 * value:.1f}"


def _steps(progress: Progress, stage: str) -> StepProgress:
    """Progress of a solver, whose steps are not counted, as steps of a task."""

    def forward(event: Iteration | str) -> None:
        iteration = event if isinstance(event, Iteration) else None
        progress(Step(int(stage == "certify"), 2, stage, str(event), iteration))

    return forward
