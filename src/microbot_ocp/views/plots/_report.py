"""Report of a comparison on one page: task, limits, methods, curves, tool path, certificates."""

from __future__ import annotations

import platform
import shlex
import sys
import textwrap
from dataclasses import replace
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from microbot_ocp._base.table import Table
from microbot_ocp.limits import JOINT_QUANTITIES, LimitFamily, limit_history, quantity_name
from microbot_ocp.robot import Robot
from microbot_ocp.tasks import Comparison
from microbot_ocp.views import _scene as scene, _style as style
from microbot_ocp.views.plots._curves import draw_panel
from microbot_ocp.views.plots._limits import saturation
from microbot_ocp.views.plots._motion import entry_curves
from microbot_ocp.views.plots._page import new_page, styled, write
from microbot_ocp.views.plots._paths import draw_paths
from microbot_ocp.views.tables import narrow_table

LINE = 142  # characters per line of text
MARGIN = 0.05  # share of the page that a printer leaves free at every edge


def report(comparison: Comparison, path: str | Path, *, footer: str | None = None) -> Path:
    """Write a comparison as one A4 page that also prints in grey.

    Parameters
    ----------
    comparison : Comparison
    path : str or Path
        File; its ending is the format: ``.pdf``, ``.svg`` or ``.png``.
    footer : str, optional
        Line at the bottom; default versions, date and command.

    Returns
    -------
    Path
    """
    return write(report_figure(comparison, footer=footer), path)


@styled(f"{__package__}.report")
def report_figure(comparison: Comparison, *, footer: str | None = None) -> Figure:
    """Return the page of :func:`report` as a figure."""
    robot, chosen = comparison.robot, style.main_methods(comparison)
    table = narrow_table(comparison)
    task, closing = _task_text(comparison, table), _closing_text(comparison, table)
    lanes = len(chosen) * (robot.joint_count + 1) + 1
    heights = (
        0.3,
        0.17 * task.count("\n") + 0.35,
        0.19 * (len(comparison.entries) + 1) + 0.1,
        2.9,
        2.35,
        max(1.0, min(2.6, 0.135 * lanes + 0.5)),
        0.125 * (closing.count("\n") + 2),
    )
    figure = new_page(style.PAGE)
    figure.set_layout_engine("constrained", rect=(MARGIN, MARGIN, 1 - 2 * MARGIN, 1 - 2 * MARGIN))
    grid = figure.add_gridspec(len(heights), 1, height_ratios=heights)
    # The heading is a row of the grid: the layout puts a suptitle outside of the margins.
    heading = {"fontsize": 13, "fontweight": "bold", "ha": "center"}
    _write(figure.add_subplot(grid[0]), f"{robot.name}: the same task by every method", **heading)
    _write(figure.add_subplot(grid[1]), task)
    _draw_table(figure.add_subplot(grid[2]), comparison, str(replace(table, title="", notes=())))
    _draw_curves(grid[3], comparison, chosen)
    tool: Any = grid[4].subgridspec(1, 2).subplots()
    draw_paths(tool[0], tool[1], comparison, chosen)
    for panel in tool:
        panel.set_title(f"tool, {panel.get_title()}", pad=3)
    panel = figure.add_subplot(grid[5])
    saturation(comparison, panel, methods=chosen)
    panel.set_title("a limit used to 99 % or more", loc="right", pad=3)
    if legend := panel.get_legend():
        legend.set_loc("lower right")
        for text in legend.get_texts():
            text.set_fontsize(style.TINY_FONT)
    _write(figure.add_subplot(grid[6]), closing)
    figure.supxlabel(_footer() if footer is None else footer, fontsize=6.0, color="0.3", x=0.5)
    return figure


def _write(axes: Axes, text: str, **font: Any) -> None:
    axes.axis("off")
    place = 0.5 if font else 0.0
    font = {"fontsize": style.TINY_FONT, "va": "top", "linespacing": 1.35, **font}
    axes.text(place, 1.0, text, transform=axes.transAxes, **font)


def _task_text(comparison: Comparison, table: Table) -> str:
    robot = comparison.robot.with_limits(comparison.limits)
    lines = [
        f"Robot: {robot.name}, {robot.joint_count} joints ({', '.join(robot.joint_names)})",
        robot.description,
        f"Task: {table.title}, at rest at both ends",
    ]
    for quantity in dict.fromkeys([*JOINT_QUANTITIES, *LimitFamily.of(robot).keys]):
        lines.append(_limits_text(robot, quantity))
    return "\n".join(line for text in lines for line in textwrap.wrap(text, LINE))


def _limits_text(robot: Robot, quantity: str) -> str:
    """Return the limits of one quantity joint by joint, with a common unit only once."""
    texts = scene.limit_texts(robot, quantity)
    name = quantity_name(quantity)
    if not any(texts):
        return f"Limits of {name}: none" if quantity in scene.QUANTITIES else ""
    units = {scene.display_unit(robot, quantity, k) for k in range(len(texts))}
    unit = f" {units.pop()}" if len(units) == 1 else ""
    return f"Limits of {name}: {' / '.join(t.removesuffix(unit) or 'none' for t in texts)}{unit}"


def _draw_table(axes: Axes, comparison: Comparison, text: str) -> None:
    """Write the rows of a table, each beside the line style of its method."""
    axes.axis("off")
    axes.set(xlim=(0.0, 1.0), ylim=(0.0, 1.0))
    head, *rows = text.splitlines()
    size = min(style.SMALL_FONT, 780 / max(map(len, [head, *rows])))  # largest size that fits
    font: dict[str, Any] = {"family": "DejaVu Sans Mono", "fontsize": size, "va": "center"}
    step = 1.0 / (len(rows) + 1)
    axes.text(MARGIN, 1.0 - step / 2, head, fontweight="bold", **font)
    for place, (row, entry, shown) in enumerate(
        zip(rows, comparison.entries, style.entry_styles(comparison).values(), strict=True), start=1
    ):
        height = 1.0 - (place + 0.5) * step
        axes.axhline(1.0 - place * step, color="0.8", **style.THIN)
        color = "black" if entry.motion else style.WARNING_COLOR
        axes.text(MARGIN, height, row, color=color, **font)
        if entry.motion is not None:
            line: dict[str, Any] = {"color": shown.color, "linestyle": shown.linestyle}
            axes.plot([0.0, 0.04], [height] * 2, linewidth=style.LINE_WIDTH, **line)


def _draw_curves(place: Any, comparison: Comparison, chosen: list[str]) -> None:
    robot, quantities = comparison.robot, ("qd", "tau")
    joints = _busiest(comparison, chosen)
    shown = entry_curves(comparison, chosen, quantities)
    panels = place.subgridspec(2, len(joints), wspace=0.08).subplots(sharex=True, squeeze=False)
    for row, quantity in zip(panels, quantities, strict=True):
        for panel, joint in zip(row, joints, strict=True):
            draw_panel(panel, robot, shown, quantity, joint, comparison.limits)
        units = {scene.display_unit(robot, quantity, j) for j in joints}
        name, unit = quantity_name(quantity), f" [{units.pop()}]" if len(units) == 1 else ""
        row[0].set_ylabel(f"{name}{unit}")
    for panel, joint in zip(panels[0], joints, strict=True):
        panel.set_title(robot.joint_names[joint], loc="left", fontweight="bold", pad=12)
    for panel in panels[1]:
        panel.set_xlabel("t [s]")
    if len(joints) < robot.joint_count:
        corner: Any = {"xycoords": "axes fraction", "textcoords": "offset points"}
        text = f"the {len(joints)} joints nearest to their limits"
        panels[0][0].annotate(text, (0, 1), xytext=(0, 26), fontsize=style.TINY_FONT, **corner)


def _busiest(comparison: Comparison, chosen: list[str]) -> list[int]:
    """Return the joints with the largest use of their torque limits, in ascending order."""
    peak = np.zeros(comparison.robot.joint_count)
    for motion in (comparison.motions[name] for name in chosen if len(peak) > style.SIDE_BY_SIDE):
        history = limit_history(comparison.robot, motion, comparison.limits)
        if "tau" in history.use:
            peak = np.maximum(peak, history.use["tau"].max(axis=0))
    return sorted(np.argsort(-peak, kind="stable")[: style.SIDE_BY_SIDE].tolist())


def _closing_text(comparison: Comparison, table: Table) -> str:
    lines = ["Certificates:"]
    for entry in comparison.entries:
        if entry.motion is None:
            text = style.failure_sentence(entry)
        else:
            verdict = entry.certificate.verdict if entry.certificate else "not certified"
            text = f"{style.entry_title(entry)}: {verdict}"
        lines += textwrap.wrap(text, LINE, subsequent_indent="    ", break_on_hyphens=False)
    return "\n".join([*lines, *textwrap.wrap(table.notes[0], LINE)])


def _footer() -> str:
    packages = " ".join(f"{name} {version(name)}" for name in ("microbot_ocp", "casadi", "numpy"))
    command = textwrap.shorten(shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]), 90)
    command = command.encode(errors="replace").decode()  # arguments may hold invalid UTF-8
    date = datetime.now().astimezone().strftime("%Y-%m-%d %H:%M")
    return f"{packages} Python {platform.python_version()}; {date}; {command}"
