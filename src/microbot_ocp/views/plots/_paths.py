"""Figures of tool paths in space and in two projections, and of the arm in several poses."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from mpl_toolkits.mplot3d import Axes3D
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import ROUNDING, FloatArray, InputError
from microbot_ocp._base.showing import GivenAxes
from microbot_ocp.robot import Robot
from microbot_ocp.tasks import Comparison
from microbot_ocp.views import _scene as scene, _style as style
from microbot_ocp.views.plots._motion import legend_title
from microbot_ocp.views.plots._page import (
    AxesGrid,
    Page,
    ShownAxes,
    ShownAxes3D,
    axes_page,
    halo,
    new_page,
    styled,
)


@styled()
def paths(comparison: Comparison, axes: GivenAxes | None = None) -> AxesGrid:
    """Draw tool paths in three dimensions, from above and from the side, with equal scales, m.

    Parameters
    ----------
    comparison : Comparison
    axes : array of Axes [3], optional
        Axes, of which the first is three-dimensional; default a new figure.

    Returns
    -------
    AxesGrid [1, 3]
        Via points are numbered; the arm is drawn in grey at the first and last via point. For an
        arm with a vertical waist axis the side view is the plane of the arm.

    Raises
    ------
    InputError
        A number of axes other than three, or first axes without a third dimension.
    """
    page = _page(comparison, axes)
    space, above, side = page.axes.flat
    _draw_in_space(space, comparison)
    draw_paths(above, side, comparison)
    styles = style.entry_styles(comparison)
    handles = [
        Line2D([], [], label=legend_title(entry, motion), **_path_line(styles[entry.name]))
        for entry, motion in scene.solved_entries(comparison)
    ]
    handles += [
        Line2D([], [], marker="o", color="black", linestyle="none", label="via point"),
        Line2D([], [], marker="o", color="0.6", linewidth=3, label="arm at the first, last point"),
    ]
    page.legend(handles, 4, style.failures(comparison))
    return page.axes


def draw_paths(
    above: Axes, side: Axes, comparison: Comparison, methods: Sequence[str] | None = None
) -> None:
    """Draw the tool paths of some methods (default all) from above and from the side."""
    _draw_projection(above, comparison, _onto(0, 1), methods)
    above.set(title="from above", xlabel="x [m]", ylabel="y [m]")
    if has_vertical_waist(comparison):
        _draw_projection(side, comparison, _in_arm_plane, methods)
        side.set(title="in the plane of the arm", xlabel="r from the waist's axis [m]")
    else:
        _draw_projection(side, comparison, _onto(0, 2), methods)
        side.set(title="from the side", xlabel="x [m]")
    side.set_ylabel("z [m]")
    for flat in (above, side):
        flat.set_aspect("equal", adjustable="datalim")


def _page(comparison: Comparison, axes: GivenAxes | None) -> Page:
    if axes is not None:
        page = axes_page(axes, 1, 3, size=style.LANDSCAPE)
        if not isinstance(page.axes[0, 0], Axes3D):
            raise InputError("axes must begin with three-dimensional ones, projection='3d'")
        return page
    figure = new_page(style.LANDSCAPE, f"{comparison.robot.name}: tool paths")
    grid = figure.add_gridspec(2, 2, width_ratios=(4, 3))
    space = figure.add_subplot(grid[:, 0], axes_class=ShownAxes3D)
    above, side = (figure.add_subplot(grid[row, 1], axes_class=ShownAxes) for row in (0, 1))
    return Page(np.array([[space, above, side]]).view(AxesGrid), is_new=True)


def has_vertical_waist(comparison: Comparison) -> bool:
    """Return whether the first joint turns about the base's z axis."""
    robot = comparison.robot.chain
    along = abs(robot.alpha[0]) < ROUNDING and abs(robot.a[0]) < ROUNDING
    upright = np.allclose(robot.base[2, :3], [0, 0, 1]) and np.allclose(robot.base[:2, 3], 0)
    return bool(along and upright) and robot.joint_types[0] == "revolute"


def _path_line(entry: style.EntryStyle) -> dict[str, Any]:
    """Return the line style of a path: wide for the highlighted path, thin above it otherwise."""
    return {
        "color": entry.color,
        "linestyle": entry.linestyle,
        "linewidth": style.LINE_WIDTH * (1 + entry.highlighted),
        "zorder": 2 if entry.highlighted else 3,
    }


Projection = Callable[[Robot, FloatArray, FloatArray], FloatArray]


def _onto(*axes: int) -> Projection:
    """Return the projection of points onto some of the axes of the base frame."""
    return lambda robot, q, points: points[..., list(axes)]


def _in_arm_plane(robot: Robot, q: FloatArray, points: FloatArray) -> FloatArray:
    """Project onto the plane of link 1's x axis and z; r is negative behind the waist."""
    turn = robot.chain_positions(q)[:, 0] + robot.theta_offset[0]
    turn = turn.reshape(-1, *([1] * (points.ndim - 2)))
    r = points[..., 0] * np.cos(turn) + points[..., 1] * np.sin(turn)
    return np.stack([r, points[..., 2]], axis=-1)


def _draw(
    axes: Any, comparison: Comparison, project: Projection, methods: Sequence[str] | None
) -> FloatArray:
    """Draw the arm at both ends, tool paths and via points; return the via points [m,2 or 3]."""
    robot, styles, via_q = comparison.robot, style.entry_styles(comparison), comparison.via_q
    gray = {"color": "0.75", "linewidth": 3, "marker": "o", "zorder": 1, "label": "_arm"}
    ends = via_q[[0, -1]]
    for arm in project(robot, ends, scene.link_origins(robot, ends)):
        axes.plot(*arm.T, **gray)
    for entry, motion in scene.solved_entries(comparison):
        if methods is None or entry.name in methods:
            drawn = styles[entry.name]
            tool = project(robot, motion.q, scene.tool_places(robot, motion.q))
            axes.plot(*tool.T, label=drawn.title, **_path_line(drawn))
    vias = project(robot, via_q, scene.tool_places(robot, via_q))
    axes.plot(*vias.T, "o", color="black", markersize=6, zorder=7, label="_via")
    return vias


NUMBER: dict[str, Any] = {"fontsize": 10, "fontweight": "bold", "zorder": 8}


def _draw_projection(
    axes: Axes, comparison: Comparison, project: Projection, methods: Sequence[str] | None
) -> None:
    vias = _draw(axes, comparison, project, methods)
    drawn = np.concatenate([line.get_ydata() for line in axes.get_lines()])
    ceiling = drawn.max() - 0.15 * np.ptp(drawn)  # numbers above it would overlap the title
    for number, place in enumerate(vias.tolist(), start=1):
        offset: Any = (6, -13 if place[1] > ceiling else 5)
        note = {"textcoords": "offset points", "path_effects": halo(), **NUMBER}
        axes.annotate(str(number), place, xytext=offset, **note)


def _draw_in_space(axes: Any, comparison: Comparison) -> None:
    vias = _draw(axes, comparison, _onto(0, 1, 2), None)
    for number, place in enumerate(vias, start=1):
        axes.text(*place, f"  {number}", path_effects=halo(), **NUMBER)
    lines = [line for line in axes.get_lines() if line.get_label() != "_via"]
    set_space(axes, np.concatenate([np.array(line.get_data_3d()).T for line in lines]))
    axes.set_title("in space")
    axes.xaxis.labelpad = axes.yaxis.labelpad = 8
    axes.view_init(elev=24, azim=azimuth(vias))


def set_space(axes: Any, points: FloatArray) -> None:
    """Label the axes in m and fit them to the points [N,3] with equal scales."""
    low, high = points.min(axis=0), points.max(axis=0)
    span = np.maximum(high - low, 0.15 * (high - low).max())
    for name, center, width in zip("xyz", (low + high) / 2, 1.08 * span, strict=True):
        getattr(axes, f"set_{name}lim")(center - width / 2, center + width / 2)
    # set_box_aspect fixes the length of the diagonal, so a high box would overlap its neighbours.
    axes.set_box_aspect(span, zoom=min(1.0, 0.6 * np.linalg.norm(span) / span[2]))
    axes.set(xlabel="x [m]", ylabel="y [m]")
    axes.zaxis.set_rotate_label(False)  # matplotlib may turn it upside down
    axes.set_zlabel("z [m]", rotation=90)


def azimuth(vias: FloatArray) -> float:
    """Return the azimuth of the view, deg, in the direction of the mean of the points [m,3]."""
    center = vias[:, :2].mean(axis=0)
    return float(np.degrees(np.arctan2(center[1], center[0]))) if np.any(center) else -60.0


@styled()
def arms(
    robot: Robot,
    poses: Mapping[str, ArrayLike],
    axes: GivenAxes | None = None,
    *,
    title: str = "",
    target: ArrayLike | None = None,
) -> Axes3D:
    """Draw the arm in space at several joint positions, with equal scales.

    Parameters
    ----------
    robot : Robot
    poses : mapping from a label to array_like [n]
        Joint positions, rad (prismatic: m). If poses coincide in space, the first is a wide line
        and the others are dashed lines over it.
    axes : Axes3D, optional
        Default a new figure.
    title : str
        Title of a new figure; default the robot's name.
    target : array_like [3], optional
        Marked point in the base frame, m.

    Returns
    -------
    Axes3D

    Raises
    ------
    InputError
        No pose, a pose of another length or with values that are not finite; axes without a third
        dimension.
    """
    if not poses:
        raise InputError("poses must hold at least one pose")
    shape = (robot.joint_count,)
    q = np.array([checks.array(f"pose {k!r}", v, shape, "rad") for k, v in poses.items()])
    drawn_arms = scene.link_origins(robot, q)
    point = None if target is None else checks.array("target", target, (3,), "m")
    space = {"axes_class": ShownAxes3D}
    page = axes_page(axes, 1, 1, size=style.LANDSCAPE, title=title or robot.name, subplot_kw=space)
    panel: Any = page.axes[0, 0]
    if not isinstance(panel, Axes3D):
        raise InputError("axes must be three-dimensional, projection='3d'")
    alike = np.abs(drawn_arms[:, None] - drawn_arms).max(axis=(2, 3)) < 1e-3 * scene.reach(robot)
    for place, (label, arm) in enumerate(zip(poses, drawn_arms, strict=True)):
        line = style.look(place)
        if not alike[place, :place].any():  # an arm over a coincident one stays dashed
            line["linestyle"] = "solid"
        hidden = int(alike[place, place + 1 :].sum())  # number of coincident arms above
        line |= {"linewidth": 2 + 4 * hidden, "markersize": 6 + 3 * hidden}
        panel.plot(*arm.T, marker="o", label=label, zorder=3 + place, **line)
    drawn = drawn_arms.reshape(-1, 3)
    if point is not None:
        panel.plot(*point[:, None], "k*", markersize=13, zorder=8, label="target")
        drawn = np.vstack([drawn, point])
    x, y, z = drawn_arms[0, 0]
    panel.text(x, y, z, "  base", path_effects=halo(), zorder=8)
    set_space(panel, drawn)
    spans, each = np.ptp(drawn, axis=0), list[Any]("xyz")
    for axis, span in zip(each, spans, strict=True):  # six ticks along the longest axis
        panel.locator_params(axis=axis, nbins=max(2, round(6 * span / spans.max())))
    panel.view_init(elev=22, azim=azimuth(drawn_arms[:, -1]) - 40)
    page.legend(panel.get_legend_handles_labels()[0], 3)
    return panel
