"""``robots`` and ``show``: what there is, and what a robot is made of."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

import microbot_ocp as mo
from microbot_ocp._base.checks import InputError
from microbot_ocp._base.table import Table
from microbot_ocp.cli._options import (
    Json,
    Open,
    Recording,
    RobotName,
    Tip,
    option,
    writable,
)
from microbot_ocp.cli._output import (
    Written,
    answer,
    joint_text,
    number,
    point_text,
    span,
)
from microbot_ocp.cli._recordings import check_recording, open_recording
from microbot_ocp.limits import JOINT_QUANTITIES
from microbot_ocp.robot import Robot, drive_advice, largest_reach, rest_pose
from microbot_ocp.robot.files import load_robot, packaged_robots, robot_text, save_text
from microbot_ocp.trajectories import joint_sweep

if TYPE_CHECKING:
    from rich.console import Console

EQUATION_ENDINGS = (".tex", ".py", ".c", ".m")  # of mo.ClosedForm.export


def robots(as_json: Json = False) -> int:
    """List the packaged robots."""
    every = [load_robot(name) for name in packaged_robots()]
    document = [
        {
            "name": name,
            "joints": robot.joint_count,
            "has_dynamics": robot.has_dynamics,
            "description": robot.description,
        }
        for name, robot in zip(packaged_robots(), every, strict=True)
    ]

    def show_them(console: Console) -> None:
        rows = [
            [d["name"], _types(robot), "yes" if d["has_dynamics"] else "no", d["description"]]
            for d, robot in zip(document, every, strict=True)
        ]
        console.print(Table.of_text(["name", "joints", "masses", "what it is"], rows, left=4))

    return answer(as_json, {"robots": document}, show_them)


def show(
    robot_name: RobotName,
    tip: Tip = None,
    toml: Annotated[
        bool, typer.Option("--toml", help="Print its TOML file instead: a start for your own.")
    ] = False,
    out: Annotated[
        Path | None,
        option(
            "--out",
            what="Write the robot to this .toml or .urdf file, or its equations in closed form to "
            "a .tex, .py, .c or .m file.",
            metavar="FILE",
        ),
    ] = None,
    rerun: Recording = None,
    open_viewer: Open = False,
    as_json: Json = False,
) -> int:
    """Show a robot: DH rows, masses, limits, workspace.

    --toml and --out copy it. In Rerun every joint moves in turn.
    """
    robot = load_robot(robot_name, tip)
    if toml and as_json:
        raise InputError("give --toml or --json, not both")
    writable(out, (".toml", ".urdf", *EQUATION_ENDINGS), "--out")
    check_recording(rerun, open_viewer)
    written = Written()
    written.add(out, lambda path: _write(robot_name, tip, robot, path))

    def save(path: Path) -> Path:
        return joint_sweep(robot).to_rerun(robot, path)

    written.add(rerun, save)
    rest = rest_pose(robot)
    pose = np.array(mo.forward_kinematics(robot)(rest))
    found, bound = largest_reach(robot)
    document = {
        "name": robot.name,
        "description": robot.description,
        "joints": [_joint_document(robot, joint) for joint in range(robot.joint_count)],
        "tool": robot.tool,
        "base": robot.base,
        "gravity": robot.gravity,
        "total_mass": sum(link.mass for link in robot.links) if robot.has_dynamics else None,
        "workspace": {
            "pose": rest,
            "tool_position": pose[:3, 3],
            "reach_found": found,
            "reach_bound": bound,
        },
    }

    def tables(console: Console) -> None:
        _show_robot(console, robot)
        at = "zero" if not rest.any() else f"{joint_text(robot, rest)} (nearest to zero in limits)"
        console.print(f"Tool at {at}: {point_text(pose[:3, 3])} m")
        reach = f"{number(found, 3)} m from the base origin found within the limits"
        most = f"; at most {number(bound, 3)} m with every link stretched out"
        console.print(f"Reach: {reach}{most if np.isfinite(bound) else ''}")

    def file(console: Console) -> None:
        console.file.write(robot_text(robot_name, tip))

    if toml:  # and nothing else, so that it can be piped into a file
        code = answer(as_json, document, file)
        for missing in written.missing:
            print(f"error: {missing['file']}: {missing['reason']}", file=sys.stderr)
        code = 1 if written.missing else code
    else:
        code = answer(as_json, document, tables, written=written)
    if open_viewer:
        open_recording(save, rerun)
    return code


def _write(source: str, tip: str | None, robot: Robot, path: Path) -> Path:
    """Write a robot, or its equations, in the format that the ending says."""
    if path.suffix in EQUATION_ENDINGS:
        return mo.closed_form(robot).export(path)
    if path.suffix == ".urdf":
        mo.write_urdf(robot, path)
    else:
        save_text(robot_text(source, tip), path, ".toml")
    return path


def _types(robot: Robot) -> str:
    return "".join("R" if kind == "revolute" else "P" for kind in robot.joint_types)


def _joint_document(robot: Robot, joint: int) -> dict[str, Any]:
    document: dict[str, Any] = {
        "name": robot.joint_names[joint],
        "type": robot.joint_types[joint],
        **{key: getattr(robot, key)[joint] for key in ("alpha", "a", "d", "theta_offset", "beta")},
        "limits": {
            key: bound[joint]
            for quantity in JOINT_QUANTITIES
            for key, bound in zip(
                (f"{quantity}_min", f"{quantity}_max"), robot.limits.bounds(quantity), strict=True
            )
        },
    }
    if robot.has_dynamics:
        link = robot.links[joint]
        keys = ("mass", "center_of_mass", "inertia", "armature")
        keys += ("viscous_friction", "coulomb_friction")
        document["link"] = {key: getattr(link, key) for key in keys}
        if link.rotor is not None:
            document["link"]["rotor"] = asdict(link.rotor)
    return document


def _show_robot(console: Console, robot: Robot) -> None:
    about = f": {robot.description}" if robot.description else ""
    console.print(f"{robot.name}{about}")
    console.print("\nModified DH rows (Craig)")
    heads = ["joint", "type", "alpha [deg]", "a [m]", "d [m]", "theta [deg]"]
    rows = [_dh_row(robot, j) for j in range(robot.joint_count)]
    if robot.beta.any():
        heads.append("beta [deg]")
        rows = [
            [*row, number(np.degrees(beta))] for row, beta in zip(rows, robot.beta, strict=True)
        ]
    console.print(Table.of_text(heads, rows, left=2), "")
    tool, base = robot.tool[:3, 3], robot.base[:3, 3]
    console.print(f"Tool origin in the last link frame: {point_text(tool)} m")
    if not np.array_equal(robot.base, np.eye(4)):
        turned = "" if np.array_equal(robot.base[:3, :3], np.eye(3)) else ", turned"
        console.print(f"Origin of frame 0 in the base frame: {point_text(base)} m{turned}")
    console.print(f"Gravity: {point_text(robot.gravity)} m/s²\n")
    joints = range(robot.joint_count)
    if robot.has_dynamics:
        total = number(sum(link.mass for link in robot.links))
        console.print(f"Links, {total} kg in all; inertia about the centre of mass")
        heads = ["link", "mass [kg]", "centre of mass [m]", "Ixx, Iyy, Izz [kg m²]"]
        console.print(Table.of_text(heads, [_link_row(robot, j) for j in joints]), "")
        if any(any(_drive(robot, j)) for j in joints):
            console.print("Joints")
            heads = ["joint", "rotor inertia", "viscous friction", "Coulomb friction"]
            rows = [[robot.joint_names[j], *(f"{x:.4g}" for x in _drive(robot, j))] for j in joints]
            console.print(Table.of_text(heads, rows), "")
    else:
        console.print("No masses: kinematics only.\n")
    if advice := drive_advice(robot):
        console.print(f"Note: {advice}.\n")
    quantities = [q for q in JOINT_QUANTITIES if np.isfinite(robot.limits.bounds(q)).any()]
    if not quantities:
        console.print("Limits: none\n")
        return
    console.print("Limits")
    alike = len(set(robot.joint_types)) == 1
    heads = [f"{q} [{_shown_unit(robot, q, 0)}]" if alike else q for q in quantities]
    rows = [
        [robot.joint_names[j], *(_limit_cell(robot, q, j, alike) for q in quantities)]
        for j in joints
    ]
    console.print(Table.of_text(["joint", *heads], rows), "")
    from microbot_ocp.limits import LimitFamily, not_judged  # with CasADi, which lists do without

    if left := not_judged(LimitFamily.of(robot).unjudged):
        console.print(f"{left.capitalize()}.\n")


def _dh_row(robot: Robot, joint: int) -> list[str]:
    revolute = robot.joint_types[joint] == "revolute"
    offset, d = number(np.degrees(robot.theta_offset[joint])), number(robot.d[joint])
    theta = ("q" if offset == "0" else f"q + {offset}") if revolute else offset
    return [
        robot.joint_names[joint],
        robot.joint_types[joint],
        number(np.degrees(robot.alpha[joint])),
        number(robot.a[joint]),
        d if revolute else ("q" if d == "0" else f"q + {d}"),
        theta.replace("+ -", "- "),
    ]


def _link_row(robot: Robot, joint: int) -> list[str]:
    link = robot.links[joint]
    return [
        robot.joint_names[joint],
        number(link.mass),
        ", ".join(number(x) for x in link.center_of_mass),
        ", ".join(f"{x:.3g}" for x in np.diag(link.inertia)),
    ]


def _drive(robot: Robot, joint: int) -> tuple[float, float, float]:
    link = robot.links[joint]
    rotor = link.rotor
    reflected = rotor.inertia * rotor.gear_ratio**2 if rotor else 0.0
    return link.armature + reflected, link.viscous_friction, link.coulomb_friction


def _shown_unit(robot: Robot, quantity: str, joint: int) -> str:
    unit = robot.unit(quantity, joint)
    return "deg" if unit == "rad" else unit.replace("^2", "²")


def _limit_cell(robot: Robot, quantity: str, joint: int, bare: bool) -> str:
    lower, upper = (float(bound[joint]) for bound in robot.limits.bounds(quantity))
    unit = _shown_unit(robot, quantity, joint)
    if unit == "deg":
        lower, upper = float(np.degrees(lower)), float(np.degrees(upper))
    text = span(lower, upper, 2 if unit == "deg" else 4)
    return text if bare or text == "–" else f"{text} {unit}"
