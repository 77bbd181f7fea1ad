"""``fk`` and ``ik``: where the tool is, and which joints bring it there."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.table import Table
from microbot_ocp.cli._options import (
    Json,
    Open,
    Q,
    QDeg,
    Recording,
    RobotName,
    TimeLimit,
    Tip,
    joint_values,
    numbers,
    option,
    optional_joint_values,
    whole_number,
)
from microbot_ocp.cli._output import (
    Written,
    answer,
    in_degrees,
    joint_text,
    number,
    point_text,
    span,
)
from microbot_ocp.cli._recordings import check_recording, open_recording
from microbot_ocp.inverse_kinematics import IKSolution, solve_ik, solve_ik_all
from microbot_ocp.robot import Robot, fixed_angles, forward_kinematics, rotation_of
from microbot_ocp.robot.files import load_robot

if TYPE_CHECKING:
    from rich.console import Console

FEW_JOINTS = 4  # more joints than this, or wider heads: q1 and so on stand for their names
HEADS_WIDTH = 58  # columns


def fk(
    robot_name: RobotName,
    q_deg: QDeg = None,
    q: Q = None,
    frame: Annotated[
        int | None,
        typer.Option(
            help="Link frame 1 to n instead of the tool.",
            metavar="K",
            parser=whole_number,
        ),
    ] = None,
    tip: Tip = None,
    as_json: Json = False,
) -> int:
    """Forward kinematics: pose of the tool in the base frame."""
    robot = load_robot(robot_name, tip)
    joints = joint_values(robot, "q", q, q_deg)
    if frame is not None and not 1 <= frame <= robot.joint_count:
        raise InputError(f"--frame must be 1 to {robot.joint_count}, not {frame}")
    pose = _pose(robot, joints, frame)
    outside = _outside(robot, joints)
    document = {
        "robot": robot.name,
        "q": joints,
        "frame": frame or "tool",
        **_pose_document(pose),
        "within_limits": not outside,
    }

    def text(console: Console) -> None:
        what = "tool" if frame is None else f"link frame {frame}"
        console.print(f"{robot.name}, {what} at {joint_text(robot, joints)}", soft_wrap=True)
        _show_pose(console, pose)
        for sentence in outside:
            console.print(f"Outside its limits: {sentence}.", soft_wrap=True)

    return answer(as_json, document, text)


def ik(
    robot_name: RobotName,
    position: Annotated[str, option("--position", what="Tool position x,y,z in base, m.")],
    rpy_deg: Annotated[
        str | None,
        option("--rpy-deg", what="Orientation as roll,pitch,yaw about the base axes, deg."),
    ] = None,
    rpy: Annotated[str | None, option("--rpy", what="The same in rad.")] = None,
    seed_deg: Annotated[
        str | None,
        option("--seed-deg", what="Only the solution nearest to these joints, deg (m)."),
    ] = None,
    seed: Annotated[str | None, option("--seed", what="The same in rad (m).")] = None,
    time_limit: TimeLimit = None,
    rerun: Recording = None,
    open_viewer: Open = False,
    tip: Tip = None,
    as_json: Json = False,
) -> int:
    """Inverse kinematics: joints that bring the tool to a pose.

    Every branch within the limits, or the one nearest to a seed.

    Exit code 1 where the target is not reached; the nearest pose is printed then.
    """
    robot = load_robot(robot_name, tip)
    target = numbers("--position", position, 3, "x, y, z")
    rotation = _orientation(rpy, rpy_deg)
    start = optional_joint_values(robot, "seed", seed, seed_deg)
    check_recording(rerun, open_viewer)
    limit = np.inf if time_limit is None else time_limit
    if start is None:
        found = solve_ik_all(robot, target, rotation, time_limit=limit)
    else:
        found = (solve_ik(robot, target, rotation, start, time_limit=limit),)
    solved = all(solution.solved for solution in found)

    def save(path: Path) -> Path:
        from microbot_ocp.views.recording import of_branches

        return of_branches(robot, found, target, rotation).save(path)

    written = Written()
    written.add(rerun, save)
    document = {
        "robot": robot.name,
        "position": target,
        "rotation": rotation,
        "solved": solved,
        "solutions": [_solution_document(robot, solution) for solution in found],
    }

    def text(console: Console) -> None:
        where = f"{robot.name}, tool to {point_text(target)} m"
        if not solved:
            console.print(f"{where}: {found[0].status}", soft_wrap=True)
        else:
            count = f"{len(found)} solution{'s' * (len(found) != 1)}"
            console.print(f"{where}: {count}", soft_wrap=True)
        console.print()
        units = ["deg" if kind == "revolute" else "m" for kind in robot.joint_types]
        heads = [f"{n} [{u}]" for n, u in zip(robot.joint_names, units, strict=True)]
        few = robot.joint_count <= FEW_JOINTS and len(" ".join(heads)) <= HEADS_WIDTH
        digits = [4 if few or unit == "m" else 2 for unit in units]
        rows = [
            [*map(number, map(float, in_degrees(robot, s.q)), digits), f"{s.position_error:.1e}"]
            + ([] if rotation is None else [f"{np.degrees(s.orientation_error):.1e}"])
            for s in found
        ]
        if not few:
            heads = [f"q{j + 1}" for j in range(robot.joint_count)]
            slides = ", ".join(f"q{j + 1} in m" for j, unit in enumerate(units) if unit == "m")
            console.print(f"Joint positions in deg{f', {slides}' if slides else ''}")
        heads += ["off [m]"] + ([] if rotation is None else ["off [deg]"])
        console.print(Table.of_text(heads, rows, left=0), "")
        for sentence in dict.fromkeys(s.advice for s in found if not s.solved or s.self_motion):
            console.print(sentence)

    code = answer(as_json, document, text, 0 if solved else 1, written)
    if open_viewer:
        open_recording(save, rerun)
    return code


def _pose(robot: Robot, q: FloatArray, frame: int | None = None) -> FloatArray:
    function = forward_kinematics(robot) if frame is None else forward_kinematics(robot, frame)
    return np.array(function(q))


def _outside(robot: Robot, q: FloatArray) -> list[str]:
    low, high = (in_degrees(robot, bound) for bound in robot.limits.bounds("q"))
    shown = in_degrees(robot, q)
    units = ["deg" if kind == "revolute" else "m" for kind in robot.joint_types]
    return [
        f"{robot.joint_names[j]} at {number(shown[j])} {units[j]}, allowed "
        f"{span(low[j], high[j])} {units[j]}"
        for j in np.flatnonzero((shown < low - 1e-9) | (shown > high + 1e-9))
    ]


def _orientation(radians: str | None, degrees: str | None) -> FloatArray | None:
    """Rotation from fixed angles about X, Y, Z (Craig, 3rd ed., equation 2.64)."""
    if radians is not None and degrees is not None:
        raise InputError("give --rpy or --rpy-deg, not both")
    if radians is None and degrees is None:
        return None
    if degrees is not None:
        angles = np.radians(numbers("--rpy-deg", degrees, 3, "roll, pitch, yaw"))
    else:
        angles = numbers("--rpy", radians or "", 3, "roll, pitch, yaw")
    return rotation_of(angles)


def _pose_document(pose: FloatArray) -> dict[str, Any]:
    angles = fixed_angles(pose[:3, :3])
    return {
        "position": pose[:3, 3],
        "rotation": pose[:3, :3],
        "rpy": angles,
        "rpy_deg": np.round(np.degrees(angles), 10),
    }


def _show_pose(console: Console, pose: FloatArray) -> None:
    angles = np.degrees(fixed_angles(pose[:3, :3]))
    console.print(f"  position       {point_text(pose[:3, 3])} m")
    console.print(f"  roll,pitch,yaw {point_text(angles)} deg, about the base axes")
    for row, head in zip(pose, ("transform", "", "", ""), strict=True):
        console.print(f"  {head:14s} " + " ".join(f"{round(x, 6) + 0.0:10.6f}" for x in row))


def _solution_document(robot: Robot, solution: IKSolution) -> dict[str, Any]:
    return {
        "q": solution.q,
        "q_deg": in_degrees(robot, solution.q),
        "status": str(solution.status),
        "position_error": solution.position_error,
        "orientation_error": solution.orientation_error,
        "self_motion": solution.self_motion,
        "singular": solution.singular,
        "advice": solution.advice,
    }
