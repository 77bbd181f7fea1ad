"""What a recording says: a heading, a table of the joints, what is drawn in space."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from microbot_ocp.robot import JointLimits, Robot
from microbot_ocp.views.recording._animated_arm import Actor

SHARES = ("qd", "qdd", "tau")  # shown as shares of their limits


def document(title: str, table: Sequence[str], sentences: Sequence[str]) -> str:
    """Markdown with a heading, a table and a list."""
    return "\n".join(
        [f"**{title}**", "", *table, "", *(f"- {text}" for text in sentences if text), ""]
    )


def table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a Markdown table."""
    lines = ["| " + " | ".join(heads) + " |", "|" + " --- |" * len(heads)]
    return lines + ["| " + " | ".join(row).replace("\n", " ") + " |" for row in rows]


def peaks(robot: Robot, limits: JointLimits, actor: Actor) -> tuple[list[str], list[list[str]]]:
    """Heads and rows of a table of an arm's peaks, % of the limits where there are any."""
    limited = [q for q in SHARES if np.isfinite(limits.bounds(q)).any()]
    rows = [[name] for name in robot.joint_names]
    for quantity in limited:
        lower, upper = limits.bounds(quantity)
        for joint, row in enumerate(rows):
            own = actor.values(quantity)[:, joint]
            share = max(_share(own.max(), upper[joint]), _share(-own.min(), -lower[joint]))
            row.append(f"{100 * share:.0f}" if share > 0.0 else "–")
    return ["joint", *(f"peak {quantity} [%]" for quantity in limited)], rows


def _share(value: float, limit: float) -> float:
    return value / limit if limit > 0.0 and np.isfinite(limit) else 0.0


def legend(robot: Robot, alone: bool, scales: Sequence[float]) -> str:
    """A sentence on what is drawn in space; ``scales`` of velocity and force arrows, m a unit."""
    parts = []
    if robot.has_dynamics:
        parts.append(
            "arcs around the joints: torque, closed and pink at its limit (arrows for slides)"
        )
    if any(scales):
        arrow = "pale blue arrow" if alone else "arrow at the tool"
        parts.append(f"{arrow}: velocity, {scales[0]:.3g} m drawn per m/s")
    if alone and len(scales) > 1:
        parts.append(f"yellow arrow: force in the wrist, {1e3 * scales[1]:.3g} mm drawn per N")
    if alone and robot.has_dynamics:
        parts.append("green balls: centres of mass, their volume as the mass")
    hidden = "frames" if alone else "frames, centres of mass, forces, velocities of ghosts"
    parts.append(f"hidden until asked for: {hidden}")
    return f"In space: {'; '.join(parts)}."
