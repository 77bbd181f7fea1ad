"""Figures of a comparison: joint curves on one page, tool paths in space."""

from __future__ import annotations

import textwrap
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke

from microbot_ocp.checks import FloatArray
from microbot_ocp.comparison import Comparison, Entry
from microbot_ocp.robot import Robot
from microbot_ocp.views import scene
from microbot_ocp.views.style import EntryStyle, entry_styles, failure_sentence

A4_LANDSCAPE = (11.69, 8.27)  # inches
NOTEBOOK_DPI = 90  # a page is as wide as a notebook's column
LIMIT_COLOR = "0.25"
WARNING_COLOR = "#B00020"
HALO = [withStroke(linewidth=2.5, foreground="white")]  # text stays legible on curves
SETTINGS: dict[Any, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 11.0,
    "axes.labelsize": 9.5,
    "legend.fontsize": 9.0,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "axes.grid": True,
    "grid.color": "0.88",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "pdf.fonttype": 42,  # text stays text
    "text.parse_math": False,  # names may hold a dollar sign
}


def comparison_figure(comparison: Comparison) -> Figure:
    """Positions, velocities and torques of every entry with the limits, on one landscape page.

    Parameters
    ----------
    comparison : Comparison

    Returns
    -------
    matplotlib.figure.Figure
        Rows q [deg or m], qd [rad/s or m/s], tau [N m or N]; a column for each joint. Via points
        are markers at the times they are passed. An entry without a motion is told in words.
    """
    robot = comparison.robot
    styles = entry_styles(comparison)
    with matplotlib.rc_context(SETTINGS):
        figure = page(f"{robot.name}: the same task, the same limits")
        grid = figure.subplots(len(scene.QUANTITIES), robot.joint_count, sharex=True, squeeze=False)
        for row, quantity in zip(grid, scene.QUANTITIES, strict=True):
            for joint, axes in enumerate(row):
                _draw_curves(axes, comparison, styles, quantity, joint)
        for joint, axes in enumerate(grid[0]):
            axes.set_title(robot.joint_names[joint], fontweight="bold", pad=15)
        for axes in grid[-1]:
            axes.set_xlabel("t [s]")
        duration = scene.longest_duration(comparison) or 1.0
        grid[0, 0].set_xlim(-0.015 * duration, 1.02 * duration)
        figure.align_ylabels(grid[:, 0])
        extra = [
            Line2D([], [], marker="o", color="0.35", linestyle="none", label="via point passed"),
            Line2D([], [], color=LIMIT_COLOR, linestyle="--", linewidth=1.0, label="limit"),
            Patch(facecolor="0.5", alpha=0.18, label="beyond a limit"),
        ]
        _legend(figure, comparison, styles, extra)
    return figure


def paths_figure(comparison: Comparison) -> Figure:
    """Tool paths in space: in three dimensions, from above and from the side, equal scales, m.

    Parameters
    ----------
    comparison : Comparison

    Returns
    -------
    matplotlib.figure.Figure
        Three axes. Via points are numbered; the arm is drawn lightly at the first and last one.
        The side view of an arm on a vertical waist turns with the waist.
    """
    robot = comparison.robot
    styles = entry_styles(comparison)
    with matplotlib.rc_context(SETTINGS):
        figure = page(f"{robot.name}: tool paths")
        layout = figure.add_gridspec(2, 2, width_ratios=(1.35, 1.0))
        space: Any = figure.add_subplot(layout[:, 0], projection="3d")
        above = figure.add_subplot(layout[0, 1])
        side = figure.add_subplot(layout[1, 1])
        _draw_paths_in_space(space, comparison, styles)
        _draw_projection(above, comparison, styles, _from_above)
        above.set(title="from above", xlabel="x [m]", ylabel="y [m]")
        around_waist = has_vertical_waist(comparison)
        _draw_projection(side, comparison, styles, _in_arm_plane if around_waist else _from_side)
        side.set(
            title="in the plane of the arm" if around_waist else "from the side",
            xlabel="r from the waist's axis [m]" if around_waist else "x [m]",
            ylabel="z [m]",
        )
        for axes in (above, side):
            axes.margins(0.1)
            axes.set_aspect("equal", adjustable="datalim")
        extra = [
            Line2D(
                [], [], marker="o", color="black", linestyle="none", markersize=6, label="via point"
            ),
            Line2D(
                [], [], marker="o", color="0.6", linewidth=3, label="arm at the first, last point"
            ),
        ]
        _legend(figure, comparison, styles, extra)
    return figure


def save_figure(figure: Figure, folder: str | Path, stem: str) -> tuple[Path, Path]:
    """Write a figure as ``stem.png`` (150 dpi) and ``stem.pdf`` into ``folder``.

    Returns
    -------
    png, pdf : Path
    """
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    png, pdf = target / f"{stem}.png", target / f"{stem}.pdf"
    with matplotlib.rc_context(SETTINGS):
        figure.savefig(png, dpi=150)
        figure.savefig(pdf)
    return png, pdf


def has_vertical_waist(comparison: Comparison) -> bool:
    """Whether the first joint turns about the base's z axis."""
    robot = comparison.robot
    along = abs(robot.alpha[0]) < 1e-9 and abs(robot.a[0]) < 1e-9
    upright = (
        along and np.allclose(robot.base[2, :3], [0, 0, 1]) and np.allclose(robot.base[:2, 3], 0)
    )
    return bool(upright) and robot.joint_types[0] == "revolute"


class Page(Figure):
    """A figure that a notebook shows by itself: without pyplot nobody else would draw it."""

    def _repr_png_(self) -> bytes:
        stream = BytesIO()
        with matplotlib.rc_context(SETTINGS):
            self.savefig(stream, format="png", dpi=NOTEBOOK_DPI)
        return stream.getvalue()


def page(title: str, size: tuple[float, float] = A4_LANDSCAPE, layout: Any = "constrained") -> Page:
    """An empty figure of a size in inches with its title."""
    figure = Page(figsize=size, layout=layout)
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=13, fontweight="bold")
    return figure


def _draw_curves(
    axes: Axes,
    comparison: Comparison,
    styles: dict[str, EntryStyle],
    quantity: str,
    joint: int,
) -> None:
    robot = comparison.robot
    factor = scene.display_factor(robot, quantity, joint)
    for entry, motion in scene.solved_entries(comparison):
        style = styles[entry.name]
        values = getattr(motion, quantity)[:, joint] * factor
        axes.plot(motion.t, values, label=style.title, **_line(style))
        times = [passage.time for passage in scene.via_passages(comparison, motion)]
        axes.plot(
            times,
            np.interp(times, motion.t, values),
            linestyle="none",
            marker="o",
            markersize=5.0 if quantity == "q" else 3.5,
            color=style.color,
            markeredgecolor="white",
            markeredgewidth=0.6,
            zorder=6 if style.highlighted else 5,
            label="_via",
        )
    _draw_limits(axes, scene.axis_limits(comparison, quantity, joint))
    axes.set_ylabel(f"{quantity} [{scene.display_unit(robot, quantity, joint)}]")


def _draw_limits(axes: Axes, limits: scene.AxisLimits) -> None:
    low, high = limits.axis
    axes.set_ylim(low, high)
    for limit, edge in ((limits.lower, low), (limits.upper, high)):
        if limit is not None:
            axes.axhline(
                limit, color=LIMIT_COLOR, linestyle="--", linewidth=1.0, zorder=2, label="_limit"
            )
            axes.axhspan(*sorted((limit, edge)), color="0.5", alpha=0.18, linewidth=0, zorder=1)
    if limits.far:
        axes.annotate(
            limits.far,
            (1.0, 1.0),
            xycoords="axes fraction",
            xytext=(-2, 2),
            textcoords="offset points",
            ha="right",
            va="bottom",
            fontsize=7.5,
            color=LIMIT_COLOR,
        )


def _line(style: EntryStyle) -> dict[str, Any]:
    return {
        "color": style.color,
        "linestyle": style.linestyle,
        "linewidth": 2.2 if style.highlighted else 1.6,
        "zorder": 4 if style.highlighted else 3,
    }


def _path_line(style: EntryStyle) -> dict[str, Any]:
    """Paths lie on top of each other: a wide line below lets thin dashes above show."""
    line = _line(style)
    return {**line, "linewidth": 3.4, "zorder": 2} if style.highlighted else line


def _legend_title(entry: Entry, duration: float, style: EntryStyle) -> str:
    title = f"{style.title}, {duration:.3f} s"
    if entry.certificate is not None and not entry.certificate.ok:
        title += " (NOT CERTIFIED)"
    return title


def _legend(
    figure: Figure, comparison: Comparison, styles: dict[str, EntryStyle], extra: list[Any]
) -> None:
    handles: list[Any] = [
        Line2D(
            [],
            [],
            label=_legend_title(entry, motion.duration, styles[entry.name]),
            **_line(styles[entry.name]),
        )
        for entry, motion in scene.solved_entries(comparison)
    ]
    handles += extra
    widest = max(len(str(handle.get_label())) for handle in handles)
    legend = figure.legend(
        handles=handles,
        title="\n".join(_failures(comparison)),
        loc="outside lower center",
        ncols=min(4, max(1, 150 // (widest + 10))),  # what the page's width holds
        frameon=False,
        handlelength=3.6,
    )
    legend.get_title().set_color(WARNING_COLOR)


def _failures(comparison: Comparison) -> list[str]:
    """Lines that tell which entries have no motion, and why."""
    sentences = [failure_sentence(entry) for entry in scene.failed_entries(comparison)]
    return [line for text in sentences for line in textwrap.wrap(text, 150)]


Projection = Callable[[Robot, FloatArray, FloatArray], tuple[FloatArray, FloatArray]]


def _from_above(robot: Robot, q: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    return points[..., 0], points[..., 1]


def _from_side(robot: Robot, q: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    return points[..., 0], points[..., 2]


def _in_arm_plane(robot: Robot, q: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Along link 1's x axis, so that an arm that folds over its waist has r below zero."""
    turn = q[:, 0] + robot.theta_offset[0]
    turn = turn.reshape(-1, *([1] * (points.ndim - 2)))
    return points[..., 0] * np.cos(turn) + points[..., 1] * np.sin(turn), points[..., 2]


def _tool_positions(comparison: Comparison, q: FloatArray) -> FloatArray:
    """Tool positions [N,3] at joint positions q [N,n], m."""
    return scene.link_origins(comparison.robot, q)[:, -1]


def _arms(comparison: Comparison) -> FloatArray:
    """Origins [2,n+2,3] of the arm at the first and last via point, m."""
    return scene.link_origins(comparison.robot, comparison.via_q[[0, -1]])


def _draw_projection(
    axes: Axes, comparison: Comparison, styles: dict[str, EntryStyle], project: Projection
) -> None:
    robot, via_q = comparison.robot, comparison.via_q
    for across, up in zip(*project(robot, via_q[[0, -1]], _arms(comparison)), strict=True):
        axes.plot(across, up, color="0.75", linewidth=3, marker="o", zorder=1, label="_arm")
    for entry, motion in scene.solved_entries(comparison):
        style = styles[entry.name]
        tool = _tool_positions(comparison, motion.q)
        axes.plot(*project(robot, motion.q, tool), label=style.title, **_path_line(style))
    across, up = project(robot, via_q, _tool_positions(comparison, via_q))
    axes.plot(across, up, "o", color="black", markersize=6, zorder=7, label="_via")
    for number, place in enumerate(zip(across, up, strict=True), start=1):
        axes.annotate(
            str(number),
            place,
            xytext=(6, 5),
            textcoords="offset points",
            fontsize=10,
            fontweight="bold",
            zorder=8,
            path_effects=HALO,
        )


def _draw_paths_in_space(axes: Any, comparison: Comparison, styles: dict[str, EntryStyle]) -> None:
    drawn = [_arms(comparison).reshape(-1, 3)]
    for arm in _arms(comparison):
        axes.plot(*arm.T, color="0.75", linewidth=3, marker="o", label="_arm")
    for entry, motion in scene.solved_entries(comparison):
        style = styles[entry.name]
        tool = _tool_positions(comparison, motion.q)
        axes.plot(*tool.T, label=style.title, **_path_line(style))
        drawn.append(tool)
    vias = _tool_positions(comparison, comparison.via_q)
    axes.plot(*vias.T, "o", color="black", markersize=6, zorder=7, label="_via")
    for number, place in enumerate(vias, start=1):
        axes.text(
            *place, f"  {number}", fontsize=10, fontweight="bold", zorder=8, path_effects=HALO
        )
    equal_box(axes, np.concatenate(drawn))
    axes.set_title("in space", y=1.04)
    axes.set_xlabel("x [m]", labelpad=8)
    axes.set_ylabel("y [m]", labelpad=8)
    axes.zaxis.set_rotate_label(False)  # matplotlib's own choice may stand on its head
    axes.set_zlabel("z [m]", rotation=90)
    axes.view_init(elev=24, azim=azimuth(vias))


def equal_box(axes: Any, points: FloatArray) -> None:
    """Fit the axes to the points [N,3] with one scale for all three directions."""
    low, high = points.min(axis=0), points.max(axis=0)
    span = np.maximum(high - low, 0.15 * (high - low).max())
    middle = (low + high) / 2
    for name, center, width in zip("xyz", middle, 1.08 * span, strict=True):
        getattr(axes, f"set_{name}lim")(center - width / 2, center + width / 2)
    axes.set_box_aspect(span, zoom=1.0)


def azimuth(vias: FloatArray) -> float:
    """Angle, deg, from which the tool's places [m,3] spread across the picture."""
    center = vias[:, :2].mean(axis=0)
    return float(np.degrees(np.arctan2(center[1], center[0]))) if np.any(center) else -60.0
