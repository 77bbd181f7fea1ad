"""What a recording says: a heading, a table of the joints, what is drawn in space."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from microbot_ocp.checks import FloatArray
from microbot_ocp.robot import JointLimits, Robot

SHARES = ("qd", "qdd", "tau")  # shown as shares of their limits


def document(title: str, table: Sequence[str], sentences: Sequence[str]) -> str:
    """Markdown with a heading, a table and a list."""
    return "\n".join([f"**{title}**", "", *table, "", *(f"- {text}" for text in sentences), ""])


def table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a Markdown table."""
    lines = ["| " + " | ".join(heads) + " |", "|" + " --- |" * len(heads)]
    return lines + ["| " + " | ".join(row).replace("\n", " ") + " |" for row in rows]


def peaks(
    robot: Robot, limits: JointLimits, values: dict[str, FloatArray]
) -> tuple[list[str], list[list[str]]]:
    """Heads and rows of a table of peaks of values [N,n], % of the limits where there are any."""
    limited = [q for q in SHARES if q in values and np.isfinite(limits.bounds(q)).any()]
    rows = [[name] for name in robot.joint_names]
    for quantity in limited:
        lower, upper = limits.bounds(quantity)
        for joint, row in enumerate(rows):
            own = values[quantity][:, joint]
            share = max(_share(own.max(), upper[joint]), _share(-own.min(), -lower[joint]))
            row.append(f"{100 * share:.0f}" if share > 0.0 else "–")
    return ["joint", *(f"peak {quantity} [%]" for quantity in limited)], rows


def _share(value: float, limit: float) -> float:
    return value / limit if limit > 0.0 and np.isfinite(limit) else 0.0


def legend(robot: Robot, velocity_scale: float, force_scale: float = 0.0) -> str:
    """A sentence on what is drawn in space."""
    parts = []
    if robot.has_dynamics:
        parts.append(
            "arcs around the joints: torque, closed and pink at its limit (arrows for slides)"
        )
        parts.append("green balls: centres of mass, their volume as the mass")
    if velocity_scale:
        parts.append(f"pale blue arrow: velocity of the tool, {velocity_scale:.3g} m drawn per m/s")
    if force_scale:
        parts.append(f"yellow arrow: force in the wrist, {1e3 * force_scale:.3g} mm drawn per N")
    return f"In space: {'; '.join(parts)}." if parts else ""
