"""What a terminal shows of joints that reach a pose, of the use of limits, of a front."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from microbot_ocp._base.table import NOTHING, Table
from microbot_ocp.certificate import Certificate
from microbot_ocp.inverse_kinematics import IKSolution
from microbot_ocp.robot import Robot
from microbot_ocp.tasks import Front
from microbot_ocp.views.tables._texts import in_degrees, joint_units, number


def solutions_table(
    robot: Robot, solutions: Sequence[IKSolution], *, turned: bool, named: bool
) -> Table:
    """List solutions under the names of the joints, or shorter under q1, q2 and so on."""
    units = joint_units(robot)
    heads, title = [f"q{j + 1}" for j in range(robot.joint_count)], ""
    if named:
        heads = [f"{name} [{unit}]" for name, unit in zip(robot.joint_names, units, strict=True)]
    else:
        slides = (f"{head} in m" for head, unit in zip(heads, units, strict=True) if unit == "m")
        title = ", ".join(["Joint positions in deg", *slides])
    digits = [4 if named or unit == "m" else 2 for unit in units]
    rows = [
        [*map(number, map(float, in_degrees(robot, s.q)), digits), f"{s.position_error:.1e}"]
        + [f"{np.degrees(s.orientation_error):.1e}"] * turned
        for s in solutions
    ]
    heads += ["off [m]", *["off [deg]"] * turned]
    return replace(Table.of_text(heads, rows, left=0), title=title)


def use_blocks(robot: Robot, certificate: Certificate) -> list[str | Table]:
    """Say how much of every limit is used, by joint where it is one of the joints; the verdict."""
    checks = [check for check in certificate.limit_checks if np.isfinite(check.utilisation).any()]
    by_joint = [check for check in checks if check.labels == robot.joint_names]
    heads = ["share of limit", *(f"{check.quantity} [%]" for check in by_joint)]
    rows = [
        [name, *(_percent(check.utilisation[joint]) for check in by_joint)]
        for joint, name in enumerate(robot.joint_names)
    ]
    others = []
    for check in checks:
        if check not in by_joint:
            pairs = zip(check.labels, check.utilisation, strict=True)
            shares = ", ".join(f"{label} {_percent(share)}".strip() for label, share in pairs)
            others.append(f"share of the limit of {check.name} [%]: {shares}")
    verdict = f"Certificate: {certificate.outcome}; {certificate.verdict}"
    return [Table.of_text(heads, rows), *others, verdict]


def front_blocks(front: Front) -> list[str | Table]:
    """List duration, effort and peak torque of every motion of a front; say why it ends."""
    heads = ["duration [s]", "effort [s]", "peak torque [%]", "status", "certificate"]
    rows = [
        [
            f"{point.duration:.4f}",
            f"{point.effort:.4g}",
            _percent(point.peak_torque),
            str(point.motion.status),
            point.certificate.outcome
            + ("" if point.certificate.ok else f": {point.certificate.verdict}"),
        ]
        for point in front.points
    ]
    return ["", Table.of_text(heads, rows), *[front.ended] * bool(front.ended)]


def _percent(share: float) -> str:
    return NOTHING if not np.isfinite(share) else f"{100 * share:.1f}"
