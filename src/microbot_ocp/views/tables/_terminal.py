"""Text and tables of numbers, robots and results for a terminal."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.table import NOTHING, Table
from microbot_ocp.inverse_kinematics import IKSolution
from microbot_ocp.limits import JOINT_QUANTITIES, LimitFamily, not_judged
from microbot_ocp.robot import Robot, drive_advice, joint_scale
from microbot_ocp.views import _scene as scene
from microbot_ocp.views._scene import range_text

if TYPE_CHECKING:  # tables of robots and poses need no planner
    from microbot_ocp.certificate import Certificate
    from microbot_ocp.tasks import Front


def number(value: float, digits: int = 4) -> str:
    """Format a number with at most ``digits`` decimals; a dash for NaN and infinity."""
    if not math.isfinite(value):
        return NOTHING
    return f"{round(value, digits) + 0.0:.{digits}f}".rstrip("0").rstrip(".")


def span(lower: float, upper: float, digits: int = 4) -> str:
    """Format a range, with ± if it is symmetric, and as a dash without bounds."""
    return range_text(lower, upper, show=lambda value: number(value, digits)) or NOTHING


def point_text(point: Iterable[float]) -> str:
    """Format a point as (x, y, z)."""
    return f"({', '.join(number(float(x)) for x in point)})"


def pose_text(robot: Robot, q: ArrayLike) -> str:
    """Format joint positions with their unit: degrees, or degrees and metres."""
    unit = "deg" if "prismatic" not in robot.joint_types else "deg, prismatic m"
    return f"{point_text(in_degrees(robot, q))} {unit}"


def joint_units(robot: Robot) -> list[str]:
    """Return the displayed unit of the position of each joint."""
    return ["deg" if kind == "revolute" else "m" for kind in robot.joint_types]


def in_degrees(robot: Robot, q: ArrayLike) -> FloatArray:
    """Convert joint values [..., n] to degrees; values of prismatic joints stay in metres."""
    return np.round(np.asarray(q, dtype=float) / joint_scale(robot), 10)


def robot_blocks(robot: Robot) -> Iterator[str | Table]:
    """Yield tables of a robot of at most 80 columns, and sentences between them."""
    yield f"{robot.name}{f': {robot.description}' if robot.description else ''}"
    yield "\nModified DH rows (Craig)"
    yield dh_table(robot)
    yield from following(robot)
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


def following(robot: Robot) -> Iterator[str]:
    """Yield a sentence for each mimic joint."""
    for name, (driver, factor, offset) in robot.mimic.items():
        sign = "-" if offset < 0 else "+"
        shift = f" {sign} {number(abs(offset))}" if offset else ""
        yield f"{name} follows {driver}: it stands at {number(factor)} q{shift} (rad or m)"


def dh_table(robot: Robot) -> Table:
    """Return the rows of modified DH parameters, in degrees and metres."""
    heads = ["joint", "type", "alpha [deg]", "a [m]", "d [m]", "theta [deg]"]
    heads += ["beta [deg]"] if robot.beta.any() else []
    robot = robot.chain
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
    masses, drives = [], []
    for name, link in zip(robot.chain.joint_names, robot.links, strict=True):
        centre = ", ".join(number(x) for x in link.center_of_mass)
        inertia = ", ".join(f"{x:.3g}" for x in np.diag(link.inertia))
        masses.append([name, number(link.mass), centre, inertia])
        reflected = link.rotor.inertia * link.rotor.gear_ratio**2 if link.rotor else 0.0
        drive = link.armature + reflected, link.viscous_friction, link.coulomb_friction
        drives.append([name, *(f"{x:.4g}" for x in drive)])
    heads = ["link", "mass [kg]", "centre of mass [m]", "Ixx, Iyy, Izz [kg m²]"]
    yield Table.of_text(heads, masses)
    if any(text != "0" for _, *texts in drives for text in texts):
        yield "Joints"
        heads = ["joint", "rotor inertia", "viscous friction", "Coulomb friction"]
        yield Table.of_text(heads, drives)


def _limits(robot: Robot) -> Iterator[str | Table]:
    quantities = [q for q in JOINT_QUANTITIES if np.isfinite(robot.limits.bounds(q)).any()]
    if not quantities:
        yield "Limits: none\n"
        return
    yield "Limits"
    alike = len(set(robot.joint_types)) == 1
    heads, rows = ["joint"], [[name] for name in robot.joint_names]
    for quantity in quantities:
        for joint, row in enumerate(rows):
            unit = scene.display_unit(robot, quantity, joint).replace("^2", "²")
            bounds = scene.drawn_bounds(robot, robot.limits, quantity, joint)
            text = span(*bounds, digits=2 if unit == "deg" else 4)
            row.append(text if alike or text == NOTHING else f"{text} {unit}")
        heads.append(f"{quantity} [{unit}]" if alike else quantity)
    yield Table.of_text(heads, rows)


def solutions_table(
    robot: Robot, solutions: Sequence[IKSolution], *, turned: bool, named: bool
) -> Table:
    """List solutions under the names of the joints, or under q1, q2 and so on in a narrow table."""
    units, title = joint_units(robot), ""
    heads = [f"{name} [{unit}]" for name, unit in zip(robot.joint_names, units, strict=True)]
    if not named:
        title = ", ".join(f"q{j} is {head}" for j, head in enumerate(heads, start=1))
        heads = [f"q{j + 1}" for j in range(robot.joint_count)]
    digits = [4 if named or unit == "m" else 2 for unit in units]
    rows = [
        [*map(number, map(float, in_degrees(robot, s.q)), digits), f"{s.position_error:.1e}"]
        + [f"{np.degrees(s.orientation_error):.1e}"] * turned
        for s in solutions
    ]
    heads += ["error [m]", *["error [deg]"] * turned]
    return replace(Table.of_text(heads, rows, left=0), title=title)


def use_blocks(robot: Robot, certificate: Certificate) -> list[str | Table]:
    """Return the largest use of every limit (by joint for joint limits) and the verdict."""
    checks = [check for check in certificate.limit_checks if np.isfinite(check.utilisation).any()]
    heads, rows, others = ["share of limit"], [[name] for name in robot.joint_names], []
    for check in checks:
        if check.labels == robot.joint_names:
            heads.append(f"{check.quantity} [%]")
            for row, share in zip(rows, check.utilisation, strict=True):
                row.append(_percent(share))
        else:
            pairs = zip(check.labels, check.utilisation, strict=True)
            shares = ", ".join(f"{label} {_percent(share)}".strip() for label, share in pairs)
            others.append(f"share of the limit of {check.name} [%]: {shares}")
    verdict = f"Certificate: {certificate.outcome}; {certificate.verdict}"
    return [Table.of_text(heads, rows), *others, verdict]


def front_blocks(front: Front) -> list[str | Table]:
    """List duration, effort and peak torque of every motion of a front, and why it ends early."""
    heads = ["duration [s]", "effort [s]", "peak torque [%]", "status", "certificate"]
    rows = []
    for point in front.points:
        numbers = f"{point.duration:.4f}", f"{point.effort:.4g}", _percent(point.peak_torque)
        proof = point.certificate
        outcome = proof.outcome if proof.ok else f"{proof.outcome}: {proof.verdict}"
        rows.append([*numbers, str(point.motion.status), outcome])
    return ["", Table.of_text(heads, rows), *[front.ended] * bool(front.ended)]


def _percent(share: float) -> str:
    return NOTHING if not np.isfinite(share) else f"{100 * share:.1f}"
