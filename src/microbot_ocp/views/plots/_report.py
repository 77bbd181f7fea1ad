"""A comparison on one printed page: task, limits, methods, curves, tool path, certificates."""

from __future__ import annotations

import platform
import shlex
import sys
import textwrap
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from microbot_ocp.comparison import Comparison
from microbot_ocp.limits import JOINT_QUANTITIES, LimitFamily, limit_history, quantity_name
from microbot_ocp.robot import Robot
from microbot_ocp.views import _scene as scene
from microbot_ocp.views.plots._comparison import entry_curves
from microbot_ocp.views.plots._curves import draw_panel
from microbot_ocp.views.plots._limits import saturation
from microbot_ocp.views.plots._page import A4, WARNING_COLOR, new_page, styled, write
from microbot_ocp.views.plots._paths import draw_paths
from microbot_ocp.views.plots._style import entry_styles, failure_sentence, highlighted_name
from microbot_ocp.views.tables import narrow_table

SHOWN_JOINTS = 4  # columns of curves
SMALL = 6.8  # points
MARGINS = (0.06, 0.03, 0.88, 0.94)  # left, bottom, width, height, as printers leave them
LINE_WIDTH = 142  # characters of small text on the page
TABLE_WIDTH = 100  # characters of the table in its own size
HEAD_WIDTH, HEAD_COLUMN = 80, 11  # characters of the table's heads on one line, and else of each
MAIN_LIMITS = ("q", "qd", "tau")  # listed even where there are none


def report(comparison: Comparison, path: str | Path, *, footer: str | None = None) -> Path:
    """Write a comparison as one A4 page of vectors that prints in grey.

    Parameters
    ----------
    comparison : Comparison
    path : str or Path
        The ending says how: ``.pdf``, ``.svg`` or ``.png``.
    footer : str, optional
        Default versions, date and command.

    Returns
    -------
    Path
    """
    return write(report_figure(comparison, footer=footer), path)


@styled()
def report_figure(comparison: Comparison, *, footer: str | None = None) -> Figure:
    """The page of :func:`report` as a figure."""
    robot = comparison.robot
    figure = new_page(A4)
    figure.set_layout_engine("constrained", rect=MARGINS)
    chosen = _main_methods(comparison)
    lanes = len(chosen) * (robot.joint_count + 1) + 1
    heights = (
        0.3,
        0.17 * _task_text(comparison).count("\n") + 0.35,
        0.19 * (len(comparison.entries) + _head_lines(comparison)) + 0.1,
        2.9,
        2.35,
        max(1.0, min(2.6, 0.135 * lanes + 0.5)),
        0.125 * (_closing_text(comparison).count("\n") + 2),
    )
    grid = figure.add_gridspec(len(heights), 1, height_ratios=heights)
    # a row of its own: the layout leaves no room for a figure's title inside the margins
    title = figure.add_subplot(grid[0])
    title.axis("off")
    heading = f"{robot.name}: the same task by every method"
    title.text(0.5, 1.0, heading, fontsize=13, fontweight="bold", ha="center", va="top")
    _text(figure.add_subplot(grid[1]), _task_text(comparison))
    _draw_table(figure.add_subplot(grid[2]), comparison)
    _draw_curves(figure, grid[3], comparison, chosen)
    _draw_paths(figure, grid[4], comparison, chosen)
    panel = figure.add_subplot(grid[5])
    saturation(comparison, panel, methods=chosen)
    panel.set_title("a limit used to 99 % or more", fontsize=8.5, loc="right", pad=3)
    panel.tick_params(axis="x", labelsize=SMALL)
    panel.xaxis.label.set_fontsize(7.5)
    legend = panel.get_legend()
    if legend is not None:
        legend.set_loc("lower right")
        for text in legend.get_texts():
            text.set_fontsize(SMALL)
    _text(figure.add_subplot(grid[6]), _closing_text(comparison))
    figure.supxlabel(_footer() if footer is None else footer, fontsize=6.0, color="0.3", x=0.5)
    return figure


def _main_methods(comparison: Comparison) -> list[str]:
    """The reference and the one on top, as far as they were solved."""
    wanted = [comparison.reference, highlighted_name(comparison)]
    solved = [entry.name for entry, _ in scene.solved_entries(comparison)]
    return [name for name in dict.fromkeys(wanted) if name in solved]


def _text(axes: Axes, text: str) -> None:
    axes.axis("off")
    axes.text(
        0.0, 1.0, text, transform=axes.transAxes, va="top", ha="left", fontsize=SMALL,
        linespacing=1.35,
    )  # fmt: skip


def _task_text(comparison: Comparison) -> str:
    robot = comparison.robot
    lines = [f"Robot: {robot.name}, {robot.joint_count} joints ({', '.join(robot.joint_names)})"]
    if robot.description:
        lines += textwrap.wrap(robot.description, LINE_WIDTH)
    lines += textwrap.wrap(
        f"Task: {narrow_table(comparison).title}, at rest at both ends", LINE_WIDTH
    )
    limited = robot.with_limits(comparison.limits)
    for quantity in dict.fromkeys([*JOINT_QUANTITIES, *LimitFamily.of(limited).keys]):
        lines += textwrap.wrap(_limits_text(limited, quantity), LINE_WIDTH)
    return "\n".join(lines)


def _limits_text(robot: Robot, quantity: str) -> str:
    """Limits of one kind, joint by joint; their unit once where it is the same."""
    texts = scene.limit_texts(robot, quantity)
    name = quantity_name(quantity)
    if not any(texts):
        return f"Limits of {name}: none" if quantity in MAIN_LIMITS else ""
    units = {scene.display_unit(robot, quantity, k) for k in range(len(texts))}
    unit = f" {units.pop()}" if len(units) == 1 else ""
    return f"Limits of {name}: {' / '.join(t.removesuffix(unit) or 'none' for t in texts)}{unit}"


def _heads(comparison: Comparison) -> list[str]:
    """Heads of the table, in several lines where one line of all would not fit."""
    heads = narrow_table(comparison).heads
    if len("  ".join(heads)) <= HEAD_WIDTH:
        return heads
    return [textwrap.fill(head, HEAD_COLUMN, break_long_words=False) for head in heads]


def _head_lines(comparison: Comparison) -> int:
    return max(head.count("\n") + 1 for head in _heads(comparison))


def _draw_table(axes: Axes, comparison: Comparison) -> None:
    axes.axis("off")
    shown = narrow_table(comparison)
    heads = _heads(comparison)
    rows = [["", *(textwrap.shorten(c, 48, placeholder="…") for c in row)] for row in shown.cells]
    certificate = heads.index("certificate") + 1
    heads = ["", *heads]
    if not rows:
        return
    longest = [max(map(len, head.splitlines()), default=0) for head in heads]
    lengths = [max([n, *(len(row[k]) for row in rows)]) + 2.5 for k, n in enumerate(longest)]
    lengths[0] = 5.0  # the line of the legend
    for row in [heads, *rows]:
        row[certificate] = f"    {row[certificate]}"  # apart from the numbers before it
    widths = [length / sum(lengths) for length in lengths]
    table = axes.table(
        rows, colLabels=heads, colWidths=widths, loc="upper center", edges="horizontal",
        bbox=[0.0, 0.0, 1.0, 1.0],  # pyright: ignore[reportArgumentType]
    )  # fmt: skip
    table.auto_set_font_size(False)
    table.set_fontsize((SMALL + 0.4) * min(1.0, TABLE_WIDTH / sum(lengths)))
    for (row, column), cell in table.get_celld().items():
        cell.set_linewidth(0.4)
        cell.set_text_props(ha="left" if column in (1, certificate) else "right")
        cell.PAD = 0.02
        if row == 0:
            cell.set_height(_head_lines(comparison) * cell.get_height())
            cell.set_text_props(fontweight="bold")
        elif comparison.entries[row - 1].motion is None:
            cell.set_text_props(color=WARNING_COLOR)
    styles = entry_styles(comparison)
    axes.set_xlim(0.0, 1.0)
    axes.set_ylim(0.0, 1.0)
    for place, (entry, _) in enumerate(scene.solved_entries(comparison)):
        style = styles[entry.name]
        index = comparison.entries.index(entry)
        tall = _head_lines(comparison)
        height = 1.0 - (index + tall + 0.5) / (len(rows) + tall)
        axes.plot(
            [0.004, widths[0] - 0.004], [height, height], linewidth=1.6, zorder=5 + place,
            color=style.color, linestyle=style.linestyle,
        )  # fmt: skip


def _draw_curves(figure: Figure, place: Any, comparison: Comparison, chosen: list[str]) -> None:
    robot, count = comparison.robot, comparison.robot.joint_count
    joints = _busiest(comparison, chosen) if count > SHOWN_JOINTS else list(range(count))
    shown = entry_curves(comparison, chosen, ("qd", "tau"))
    panels = place.subgridspec(2, len(joints), wspace=0.08).subplots(sharex=True, squeeze=False)
    end = max((curve.t[-1] for curve in shown), default=1.0)
    for row, quantity in zip(panels, ("qd", "tau"), strict=True):
        for panel, joint in zip(row, joints, strict=True):
            draw_panel(panel, robot, shown, quantity, joint, comparison.limits)
            panel.tick_params(labelsize=SMALL)
            panel.set_xlim(-0.015 * end, 1.015 * end)
        unit = scene.display_unit(robot, quantity, joints[0])
        alike = all(scene.display_unit(robot, quantity, j) == unit for j in joints)
        word = {"qd": "velocity", "tau": "torque"}[quantity]
        row[0].set_ylabel(f"{word} [{unit}]" if alike else word, fontsize=7.5)
    for panel, joint in zip(panels[0], joints, strict=True):
        pad = 13.0 if panel.texts else 6.0  # above a limit that is named there
        panel.set_title(
            robot.joint_names[joint], loc="left", fontsize=8.5, fontweight="bold", pad=pad
        )
    for panel in panels[1]:
        panel.set_xlabel("t [s]", fontsize=7.5)
    if len(joints) < count:
        panels[0][0].annotate(
            f"the {len(joints)} joints nearest to their limits", (0, 1), xytext=(0, 26),
            xycoords="axes fraction", textcoords="offset points", fontsize=SMALL, ha="left",
        )  # fmt: skip


def _busiest(comparison: Comparison, chosen: list[str]) -> list[int]:
    """The joints whose torques come nearest to their limits, in their order."""
    peak = np.zeros(comparison.robot.joint_count)
    for name in chosen:
        motion = comparison[name].motion
        if motion is not None:
            history = limit_history(comparison.robot, motion, comparison.limits)
            if "tau" in history.use:
                peak = np.maximum(peak, history.use["tau"].max(axis=0))
    return sorted(np.argsort(-peak, kind="stable")[:SHOWN_JOINTS].tolist())


def _draw_paths(figure: Figure, place: Any, comparison: Comparison, chosen: list[str]) -> None:
    panels = place.subgridspec(1, 2).subplots()
    draw_paths(panels[0], panels[1], comparison, chosen)
    for panel in panels:
        panel.tick_params(labelsize=SMALL)
        panel.set_title(f"tool, {panel.get_title()}", fontsize=8.5, pad=3)
        panel.xaxis.label.set_fontsize(7.5)
        panel.yaxis.label.set_fontsize(7.5)


def _closing_text(comparison: Comparison) -> str:
    styles, lines = entry_styles(comparison), ["Certificates:"]
    for entry in comparison.entries:
        if entry.motion is None:
            text = failure_sentence(entry)
        elif entry.certificate is None:
            text = f"{styles[entry.name].title}: not certified"
        else:
            text = f"{styles[entry.name].title}: {entry.certificate.verdict}"
        lines += textwrap.wrap(text, LINE_WIDTH, subsequent_indent="    ", break_on_hyphens=False)
    peaks = narrow_table(comparison).notes[0]
    return "\n".join([*lines, *textwrap.wrap(peaks, LINE_WIDTH)])


def _footer() -> str:
    packages = " ".join(f"{name} {version(name)}" for name in ("microbot_ocp", "casadi", "numpy"))
    command = textwrap.shorten(shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]), 90)
    command = command.encode(errors="replace").decode()  # bytes that are no text
    date = datetime.now().astimezone().strftime("%Y-%m-%d %H:%M")
    return f"{packages} Python {platform.python_version()}; {date}; {command}"
