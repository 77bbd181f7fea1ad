"""What a robot is made of, for a terminal: DH rows, masses, drives, limits."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from microbot_ocp._base.table import NOTHING, Table
from microbot_ocp.limits import JOINT_QUANTITIES, LimitFamily, not_judged
from microbot_ocp.robot import Link, Robot, drive_advice
from microbot_ocp.views import _scene as scene
from microbot_ocp.views.tables._texts import number, point_text, span


def robot_blocks(robot: Robot) -> Iterator[str | Table]:
    """Yield tables that fit 80 columns, and sentences between them."""
    yield f"{robot.name}{f': {robot.description}' if robot.description else ''}"
    yield "\nModified DH rows (Craig)"
    yield dh_table(robot)
    yield f"Tool origin in the last link frame: {point_text(robot.tool[:3, 3])} m"
    if not np.array_equal(robot.base, np.eye(4)):
        turned = "" if np.array_equal(robot.base[:3, :3], np.eye(3)) else ", turned"
        yield f"Origin of frame 0 in the base frame: {point_text(robot.base[:3, 3])} m{turned}"
    yield f"Gravity: {point_text(robot.gravity)} m/s²\n"
    yield from _masses(robot)
    if advice := drive_advice(robot):
        yield f"Note: {advice}.\n"
    yield from _limits(robot)
    if left := not_judged(LimitFamily.of(robot).unjudged):
        yield f"{left.capitalize()}.\n"


def dh_table(robot: Robot) -> Table:
    """Return the rows of modified DH parameters, in degrees and metres."""
    heads = ["joint", "type", "alpha [deg]", "a [m]", "d [m]", "theta [deg]"]
    heads += ["beta [deg]"] if robot.beta.any() else []
    rows = [_dh_row(robot, joint)[: len(heads)] for joint in range(robot.joint_count)]
    return Table.of_text(heads, rows, left=2)


def _dh_row(robot: Robot, joint: int) -> list[str]:
    revolute = robot.joint_types[joint] == "revolute"
    angles = (robot.alpha[joint], robot.theta_offset[joint], robot.beta[joint])
    alpha, theta, beta = (number(float(np.degrees(angle))) for angle in angles)
    a, d = number(robot.a[joint]), number(robot.d[joint])
    moving = "q" if (fixed := theta if revolute else d) == "0" else f"q + {fixed}"
    moving = moving.replace("+ -", "- ")
    ends = [d, moving] if revolute else [moving, theta]
    return [robot.joint_names[joint], robot.joint_types[joint], alpha, a, *ends, beta]


def _masses(robot: Robot) -> Iterator[str | Table]:
    if not robot.has_dynamics:
        yield "No masses: kinematics only.\n"
        return
    total = number(sum(link.mass for link in robot.links))
    yield f"Links, {total} kg in all; inertia about the centre of mass"
    rows = [
        [
            name,
            number(link.mass),
            ", ".join(number(x) for x in link.center_of_mass),
            ", ".join(f"{x:.3g}" for x in np.diag(link.inertia)),
        ]
        for name, link in zip(robot.joint_names, robot.links, strict=True)
    ]
    heads = ["link", "mass [kg]", "centre of mass [m]", "Ixx, Iyy, Izz [kg m²]"]
    yield Table.of_text(heads, rows)
    drives = [_drive(link) for link in robot.links]
    if any(map(any, drives)):
        yield "Joints"
        heads = ["joint", "rotor inertia", "viscous friction", "Coulomb friction"]
        texts = [[f"{x:.4g}" for x in drive] for drive in drives]
        yield Table.of_text(heads, [[n, *t] for n, t in zip(robot.joint_names, texts, strict=True)])


def _drive(link: Link) -> tuple[float, float, float]:
    reflected = link.rotor.inertia * link.rotor.gear_ratio**2 if link.rotor else 0.0
    return link.armature + reflected, link.viscous_friction, link.coulomb_friction


def _limits(robot: Robot) -> Iterator[str | Table]:
    quantities = [q for q in JOINT_QUANTITIES if np.isfinite(robot.limits.bounds(q)).any()]
    if not quantities:
        yield "Limits: none\n"
        return
    yield "Limits"
    alike = len(set(robot.joint_types)) == 1
    heads = [f"{q} [{_unit(robot, q, 0)}]" if alike else q for q in quantities]
    rows = [
        [name, *(_limit(robot, q, joint, bare=alike) for q in quantities)]
        for joint, name in enumerate(robot.joint_names)
    ]
    yield Table.of_text(["joint", *heads], rows)


def _unit(robot: Robot, quantity: str, joint: int) -> str:
    return scene.display_unit(robot, quantity, joint).replace("^2", "²")


def _limit(robot: Robot, quantity: str, joint: int, *, bare: bool) -> str:
    unit = _unit(robot, quantity, joint)
    bounds = scene.drawn_bounds(robot, robot.limits, quantity, joint)
    text = span(*bounds, digits=2 if unit == "deg" else 4)
    return text if bare or text == NOTHING else f"{text} {unit}"
