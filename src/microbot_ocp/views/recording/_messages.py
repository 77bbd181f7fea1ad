"""The summary of a recording in Markdown: a heading, a table, what is drawn in space."""

from __future__ import annotations

from collections.abc import Sequence

from microbot_ocp.robot import Robot


def document(title: str, table: Sequence[str], sentences: Sequence[str]) -> str:
    """Markdown with a heading, a table and a list."""
    return "\n".join(
        [f"**{title}**", "", *table, "", *(f"- {text}" for text in sentences if text), ""]
    )


def table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a Markdown table."""
    lines = ["| " + " | ".join(heads) + " |", "|" + " --- |" * len(heads)]
    return lines + ["| " + " | ".join(row).replace("\n", " ") + " |" for row in rows]


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
