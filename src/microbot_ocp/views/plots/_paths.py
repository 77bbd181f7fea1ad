"""Tool paths in space and in two projections, with the arm at the first and last via point."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from mpl_toolkits.mplot3d import Axes3D

from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.showing import GivenAxes
from microbot_ocp.comparison import Comparison
from microbot_ocp.robot import Robot
from microbot_ocp.views import _scene as scene
from microbot_ocp.views.plots._comparison import failures, legend_title
from microbot_ocp.views.plots._page import (
    A4_LANDSCAPE,
    HALO,
    AxesGrid,
    Page,
    ShownAxes,
    ShownAxes3D,
    axes_page,
    new_page,
    styled,
)
from microbot_ocp.views.plots._style import EntryStyle, entry_styles


@styled()
def paths(comparison: Comparison, axes: GivenAxes | None = None) -> AxesGrid:
    """Tool paths in space: in three dimensions, from above and from the side, equal scales, m.

    Parameters
    ----------
    comparison : Comparison
    axes : array of Axes [3], optional
        The first one three-dimensional; default a new figure.

    Returns
    -------
    AxesGrid [1, 3]
        Via points are numbered; the arm is drawn lightly at the first and last one. The side view
        of an arm on a vertical waist turns with the waist.

    Raises
    ------
    InputError
        Other axes than three, or a first one without a third dimension.
    """
    styles = entry_styles(comparison)
    page = _page(comparison, axes)
    space, above, side = page.axes.flat
    _draw_paths_in_space(space, comparison, styles)
    draw_paths(above, side, comparison)
    handles = [
        Line2D([], [], label=legend_title(entry, motion), **_path_line(styles[entry.name]))
        for entry, motion in scene.solved_entries(comparison)
    ]
    handles += [
        Line2D([], [], marker="o", color="black", linestyle="none", label="via point"),
        Line2D([], [], marker="o", color="0.6", linewidth=3, label="arm at the first, last point"),
    ]
    page.legend(handles, 4, "\n".join(failures(comparison)))
    return page.axes


def draw_paths(
    above: Axes, side: Axes, comparison: Comparison, methods: Sequence[str] | None = None
) -> None:
    """Tool paths from above and from the side, of some methods or all, on given axes."""
    chosen = comparison
    if methods is not None:
        chosen = replace(comparison, entries=tuple(comparison[name] for name in methods))
    styles = {name: entry_styles(comparison)[name] for name in (e.name for e in chosen.entries)}
    _draw_projection(above, chosen, styles, _from_above)
    above.set(title="from above", xlabel="x [m]", ylabel="y [m]")
    around_waist = has_vertical_waist(comparison)
    _draw_projection(side, chosen, styles, _in_arm_plane if around_waist else _from_side)
    side.set(
        title="in the plane of the arm" if around_waist else "from the side",
        xlabel="r from the waist's axis [m]" if around_waist else "x [m]",
        ylabel="z [m]",
    )
    for flat in (above, side):
        flat.margins(0.1)
        flat.set_aspect("equal", adjustable="datalim")


def _page(comparison: Comparison, axes: GivenAxes | None) -> Page:
    if axes is not None:
        given = axes_page(axes, 1, 3, size=A4_LANDSCAPE)
        if not isinstance(given.axes[0, 0], Axes3D):
            raise InputError("axes must begin with three-dimensional ones, projection='3d'")
        return given
    figure = new_page(A4_LANDSCAPE, f"{comparison.robot.name}: tool paths")
    layout = figure.add_gridspec(2, 2, width_ratios=(1.35, 1.0))
    made = np.empty((1, 3), dtype=object)
    made[0] = [
        figure.add_subplot(layout[:, 0], axes_class=ShownAxes3D),
        figure.add_subplot(layout[0, 1], axes_class=ShownAxes),
        figure.add_subplot(layout[1, 1], axes_class=ShownAxes),
    ]
    return Page(made.view(AxesGrid), own=True)


def has_vertical_waist(comparison: Comparison) -> bool:
    """Whether the first joint turns about the base's z axis."""
    robot = comparison.robot
    along = abs(robot.alpha[0]) < 1e-9 and abs(robot.a[0]) < 1e-9
    upright = (
        along and np.allclose(robot.base[2, :3], [0, 0, 1]) and np.allclose(robot.base[:2, 3], 0)
    )
    return bool(upright) and robot.joint_types[0] == "revolute"


def _path_line(style: EntryStyle) -> dict[str, Any]:
    """Paths lie on top of each other: a wide line below lets thin dashes above show."""
    return {
        "color": style.color,
        "linestyle": style.linestyle,
        "linewidth": 3.4 if style.highlighted else 1.6,
        "zorder": 2 if style.highlighted else 3,
    }


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
    drawn = np.concatenate([line.get_ydata() for line in axes.get_lines()])
    ceiling = drawn.max() - 0.15 * np.ptp(drawn)  # above it a number could reach the title
    for number, place in enumerate(zip(across, up, strict=True), start=1):
        axes.annotate(
            str(number),
            place,
            xytext=(6, -13 if place[1] > ceiling else 5),
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
    axes.zaxis.set_rotate_label(False)  # matplotlib may turn it upside down
    axes.set_zlabel("z [m]", rotation=90)
    axes.view_init(elev=24, azim=azimuth(vias))


def equal_box(axes: Any, points: FloatArray) -> None:
    """Fit the axes to the points [N,3] with one scale for all three directions."""
    low, high = points.min(axis=0), points.max(axis=0)
    span = np.maximum(high - low, 0.15 * (high - low).max())
    middle = (low + high) / 2
    for name, center, width in zip("xyz", middle, 1.08 * span, strict=True):
        getattr(axes, f"set_{name}lim")(center - width / 2, center + width / 2)
    # its diagonal has one length whatever the shape: high boxes would reach into what is around
    axes.set_box_aspect(span, zoom=min(1.0, 0.6 * np.linalg.norm(span) / span[2]))


def azimuth(vias: FloatArray) -> float:
    """Angle, deg, from which the tool's places [m,3] spread across the picture."""
    center = vias[:, :2].mean(axis=0)
    return float(np.degrees(np.arctan2(center[1], center[0]))) if np.any(center) else -60.0
