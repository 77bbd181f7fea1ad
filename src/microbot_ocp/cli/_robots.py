"""``robots``, ``show``, ``fk`` and ``ik``: robots and their kinematics."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import numpy as np

import microbot_ocp as mo
from microbot_ocp._base.checks import ROUNDING, FloatArray, InputError
from microbot_ocp._base.table import Table
from microbot_ocp._base.writing import write_whole
from microbot_ocp.cli._declaration import ARM, JOINTS, SOURCE, TIP, XACRO, Numbers, command
from microbot_ocp.cli._report import Answer
from microbot_ocp.robot import Robot, fixed_angles, rotation_of
from microbot_ocp.robot.files import load_robot, packaged_robots, robot_text
from microbot_ocp.views import tables

EQUATIONS = (".tex", ".py", ".c", ".m")  # formats of mo.robot.ClosedForm.export


@command()
def robots() -> Answer:
    """List the packaged robots.

    Examples
    --------
    $ microbot-ocp robots
    """
    entries, rows = [], []
    for name in packaged_robots():
        robot = load_robot(name)
        about = {"has_dynamics": robot.has_dynamics, "description": robot.description}
        entries.append({"name": name, "joints": robot.joint_count, **about})
        types = "".join("R" if kind == "revolute" else "P" for kind in robot.joint_types)
        rows.append([name, types, "yes" if robot.has_dynamics else "no", robot.description])
    heads = ["name", "joints", "masses", "description"]
    return Answer({"robots": entries}, [Table.of_text(heads, rows, left=4)])


@command(writes=(".toml", ".urdf", *EQUATIONS), recorded=True)
def show(
    robot: Annotated[str, SOURCE],
    tip: Annotated[str | None, TIP] = None,
    xacro: Annotated[Any, XACRO] = None,
    toml: bool = False,
    json: bool = False,
) -> Answer:
    """Show a robot: DH rows, masses, limits, workspace.

    The recording moves every joint in turn.

    Parameters
    ----------
    toml
        Print the robot as TOML, a template for a new robot file.
    out : FILE
        Write the robot to this .toml or .urdf file, or its equations in closed form to a .tex, .py,
        .c or .m file.

    Examples
    --------
    $ microbot-ocp show panda
    """
    from microbot_ocp.robot import largest_reach, rest_pose  # loads CasADi, which `robots` avoids
    from microbot_ocp.trajectories import joint_sweep

    arm = load_robot(robot, tip, xacro)
    if toml and json:
        raise InputError("give --toml or --json, not both")
    rest = rest_pose(arm)
    tool = np.array(mo.forward_kinematics(arm)(rest))[:3, 3]
    reach, bound = largest_reach(arm)

    def save(path: Path) -> object:
        if path.suffix in EQUATIONS:
            return mo.robot.closed_form(arm).export(path)
        if path.suffix == ".toml":
            return write_whole(path, robot_text(robot, tip, xacro))
        return mo.save_robot(arm, path)

    def record(path: Path) -> object:
        return joint_sweep(arm).to_rerun(arm, path)

    workspace = {"pose": rest, "tool_position": tool, "reach_found": reach, "reach_bound": bound}
    document = {
        "name": arm.name,
        "description": arm.description,
        "joints": [_joint_document(arm.chain, joint) for joint in range(arm.link_count)],
        **({"mimic": arm.mimic} if arm.mimic else {}),
        **{key: getattr(arm, key) for key in ("tool", "base", "gravity")},
        "total_mass": sum(link.mass for link in arm.links) if arm.has_dynamics else None,
        "workspace": workspace,
    }
    if toml:
        text = robot_text(robot, tip, xacro)
        return Answer(document, save=save, record=record, verbatim=text)
    at = f"{tables.pose_text(arm, rest)} (nearest to zero in limits)" if rest.any() else "zero"
    farthest = f"; at most {tables.number(bound, 3)} m with every link stretched out"
    blocks = [
        *tables.robot_blocks(arm),
        f"Tool at {at}: {tables.point_text(tool)} m",
        f"Reach: {tables.number(reach, 3)} m from the base origin found within the limits"
        f"{farthest if np.isfinite(bound) else ''}",
    ]
    return Answer(document, blocks, save=save, record=record)


@command({"acceleration_limits": "jerk equal gap work"}, writes=(".yaml", ".yml", ".urdf"))
def limits(
    robot: Annotated[Robot, ARM],
    payload: Annotated[FloatArray | None, Numbers(labels=None)] = None,
    speed: Annotated[FloatArray | None, Numbers(labels=None)] = None,
    form: str | None = None,
    **settings: Any,
) -> Answer:
    """Prove accelerations that torque allows.

    They are limits for planners that know no torque. Exit code 1 if there are none: gravity or
    speed alone need more than the torques.

    Parameters
    ----------
    payload : LIST
        Mass at the tool, kg, or the least and the largest one.
    speed : LIST
        Share of the velocity limits, or one speed a joint, rad/s (prismatic: m/s); default all of
        them.
    form : NAME
        moveit, curobo or urdf (1.2); default by the ending of --out.
    out : FILE
        Write the limits to this .yaml or .urdf file.

    Examples
    --------
    $ microbot-ocp limits ur5e --payload 0,5 --speed 0.5 --out joint_limits.yaml
    """
    loads = [0.0] if payload is None else [*payload]
    if len(loads) > 2:
        raise InputError(f"--payload must be one mass or two, kg, not {len(loads)}")
    shares = [1.0] if speed is None else [*speed]
    found = mo.acceleration_limits(
        robot,
        loads[0] if len(loads) == 1 else loads,
        speed=shares[0] if len(shares) == 1 else shares,
        **settings,
    )
    keys = "status", "qdd_max", "broken", "gap", "qddd_max", "jerk_broken", "speed", "payload"
    document = {"robot": robot.name, **{key: getattr(found, key) for key in (*keys, "advice")}}
    document["breaking_state"] = vars(found.state)
    solved = bool(found.qdd_max.all())
    blocks = [
        f"{robot.name}, {found.region}, payload {' to '.join(f'{m:g}' for m in loads)} kg: "
        f"{found.status}",
        *([f"Gap to what breaks: {100 * found.gap:.3g} %\n", found.table()] if solved else []),
        *([found.advice] if found.advice else []),
    ]
    save = (lambda path: found.export(path, form)) if solved else None
    return Answer(document, blocks, solved=solved, save=save)


@command()
def fk(
    robot: Annotated[Robot, ARM], q: Annotated[FloatArray, JOINTS], frame: int | None = None
) -> Answer:
    """Evaluate the forward kinematics: pose of the tool.

    The pose is given in the base frame.

    Parameters
    ----------
    q
        Joint positions, rad (prismatic: m).
    frame : K
        Link frame 1 to n instead of the tool.

    Examples
    --------
    $ microbot-ocp fk microbot --q-deg 0,45,30
    """
    if frame is not None and not 1 <= frame <= robot.link_count:
        raise InputError(f"--frame must be 1 to {robot.link_count}, not {frame}")
    pose = np.array(mo.forward_kinematics(robot, frame)(q))
    outside = _outside(robot, q)
    rpy = fixed_angles(pose[:3, :3])
    rpy_deg = np.round(np.degrees(rpy), 10)
    document = {
        "robot": robot.name,
        "q": q,
        "frame": frame or "tool",
        "position": pose[:3, 3],
        "rotation": pose[:3, :3],
        "rpy": rpy,
        "rpy_deg": rpy_deg,
        "within_limits": not outside,
    }
    moved = "tool" if frame is None else f"link frame {frame}"
    rows = [" ".join(f"{round(x, 6) + 0.0:10.6f}" for x in row) for row in pose]
    lines = [
        f"{robot.name}, {moved} at {tables.pose_text(robot, q)}",
        f"  position       {tables.point_text(pose[:3, 3])} m",
        f"  roll,pitch,yaw {tables.point_text(rpy_deg)} deg, about the base axes",
        *(f"  {head:14s} {row}" for head, row in zip(("transform", "", "", ""), rows, strict=True)),
        *(f"Outside the limits: {sentence}." for sentence in outside),
    ]
    return Answer(document, lines=lines)


@command({"solve_ik": "time_limit"}, recorded=True)
def ik(
    robot: Annotated[Robot, ARM],
    position: Annotated[FloatArray, Numbers(labels=("x", "y", "z"))],
    rpy: Annotated[
        FloatArray | None, Numbers(labels=("roll", "pitch", "yaw"), degrees=True)
    ] = None,
    seed: Annotated[FloatArray | None, JOINTS] = None,
    **settings: Any,
) -> Answer:
    """Solve the inverse kinematics: joints for a tool pose.

    It finds every branch within the limits, or the branch nearest to a seed; the recording shows
    all branches at once. Exit code 1 if the target is not reached; the nearest pose is printed.

    Parameters
    ----------
    rpy
        Orientation as roll,pitch,yaw about the base axes, rad.

    Examples
    --------
    $ microbot-ocp ik microbot --position 3,-1,4.5
    """
    rotation = None if rpy is None else rotation_of(rpy)
    if seed is None:
        solutions = mo.solve_ik_all(robot, position, rotation, **settings)
    else:
        solutions = (mo.solve_ik(robot, position, rotation, seed, **settings),)
    solved = all(solution.solved for solution in solutions)
    keys = "status", "position_error", "orientation_error", "self_motion", "singular", "advice"
    entries = [
        {"q": s.q, "q_deg": tables.in_degrees(robot, s.q), **{key: getattr(s, key) for key in keys}}
        for s in solutions
    ]
    document = {"robot": robot.name, "position": position, "rotation": rotation}
    document |= {"solved": solved, "solutions": entries}

    def record(path: Path) -> object:
        from microbot_ocp.views.recording import of_branches

        return of_branches(robot, solutions, position, rotation).save(path)

    count = f"{len(solutions)} solution{'s' * (len(solutions) != 1)}"
    blocks = [
        f"{robot.name}, tool to {tables.point_text(position)} m: "
        f"{count if solved else solutions[0].status}\n",
        [
            tables.solutions_table(robot, solutions, turned=rpy is not None, named=n)
            for n in (True, False)
        ],
        *dict.fromkeys(s.advice for s in solutions if not s.solved or s.self_motion),
    ]
    return Answer(document, blocks, solved=solved, record=record)


def _outside(robot: Robot, q: FloatArray) -> list[str]:
    low, high = (tables.in_degrees(robot, bound) for bound in robot.limits.bounds("q"))
    shown = tables.in_degrees(robot, q)
    rows = zip(robot.joint_names, shown, low, high, tables.joint_units(robot), strict=True)
    return [
        f"{name} at {tables.number(value)} {unit}, allowed {tables.span(lower, upper)} {unit}"
        for name, value, lower, upper, unit in rows
        if not lower - ROUNDING <= value <= upper + ROUNDING
    ]


def _joint_document(robot: Robot, joint: int) -> dict[str, Any]:
    document = {
        "name": robot.joint_names[joint],
        "type": robot.joint_types[joint],
        **{key: getattr(robot, key)[joint] for key in ("alpha", "a", "d", "theta_offset", "beta")},
        "limits": {key: bound[joint] for key, bound in robot.limits.as_dict().items()},
    }
    if robot.has_dynamics:
        values = asdict(robot.links[joint]).items()
        named = ("name", "allow_unphysical")
        document["link"] = {k: v for k, v in values if k not in named and v is not None}
    return document
