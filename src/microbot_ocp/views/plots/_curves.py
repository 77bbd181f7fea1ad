"""Curves of joints against time: one drawing function under every figure of motions."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.showing import GivenAxes
from microbot_ocp.limits import LimitFamily
from microbot_ocp.robot import JointLimits, Robot
from microbot_ocp.views import _scene as scene
from microbot_ocp.views.plots._curve import NAMES, Curve
from microbot_ocp.views.plots._page import (
    A4,
    A4_LANDSCAPE,
    HALO,
    LIMIT_COLOR,
    AxesGrid,
    Page,
    axes_page,
    styled,
)
from microbot_ocp.views.plots._style import look

ROW_HEIGHT = 2.3  # inches
COLUMN_JOINTS = 4  # with more joints than this each has a row, not a column
OWN_LIMIT: dict[str, Any] = {"linestyle": ":", "linewidth": 1.2}  # of one curve


@styled()
def curves(
    robot: Robot,
    curves: Sequence[Curve],
    quantities: Sequence[str] = ("q", "qd", "tau"),
    axes: GivenAxes | None = None,
    *,
    joints: Sequence[int] | None = None,
    limits: JointLimits | None = None,
    via: tuple[FloatArray, FloatArray] | None = None,
    bounds: Mapping[str, float] | None = None,
    base: bool = False,
    title: str = "",
    symbols: bool = False,
    warnings: Sequence[str] = (),
) -> AxesGrid:
    """Quantities of joints against time.

    Parameters
    ----------
    robot : Robot
        For names and units.
    curves : sequence of Curve
        Those without a quantity are left out of its axes.
    quantities : sequence of str
        Of "q", "qd", "qdd", "tau", "error", or the key of another limit of the robot, such as
        "taud" or "tool_speed"; what is one number, not one a joint, has one panel across.
    axes : array of Axes [quantities, joints], optional
        Where to draw; default a new figure, in which each joint has a column (a row where there are
        more than four).
    joints : sequence of int, optional
        Indices from 0; default all.
    limits : JointLimits, optional
        Drawn as lines where they are near the curves, otherwise named above the axes.
    via : (times [m], positions [m,n]), optional
        Via points, s and rad (m), drawn with the position.
    bounds : mapping, optional
        Largest value shown of a quantity, in its drawn unit; curves beyond are cut, with a note in
        the axes.
    base : bool
        Whether the first curve is drawn wider and below the others, as their reference.
    title : str
        Of a new figure.
    symbols : bool
        Label axes with q, qd, tau instead of position, velocity, torque.
    warnings : sequence of str
        What went wrong, besides the curves' own warnings.

    Returns
    -------
    AxesGrid [quantities, joints]

    Raises
    ------
    InputError
        A quantity or joint that is not there, axes of another shape.
    """
    shown = _shown_joints(robot, joints)
    robot = robot if limits is None else robot.with_limits(limits)
    for quantity in quantities:
        _check_quantity(robot, quantity)
    page = curve_page(robot, axes, len(quantities), shown, title)
    for row, quantity in enumerate(quantities):
        panels = list(zip(page.axes[row], shown, strict=True))
        if not scene.of_joints(robot, quantity):
            panels = [(_across(page, row), 0)]
        for panel, joint in panels:
            draw_panel(panel, robot, curves, quantity, joint, limits, via, base)
            if bounds and quantity in bounds:
                _cut(panel, bounds[quantity])
    _label_panels(page, robot, quantities, shown, symbols)
    end = max((float(curve.t[-1]) for curve in curves if curve.t.size), default=1.0)
    start = min((float(curve.t[0]) for curve in curves if curve.t.size), default=0.0)
    margin = 0.015 * (end - start)
    for panel in page.axes.flat:
        panel.set_xlim(start - margin, end + margin)
    stated = [*warnings, *(curve.warning for curve in curves if curve.warning)]
    width = int(13 * page.figure.get_figwidth()) if page.own else 40
    wrapped = [line for text in stated for line in textwrap.wrap(text, width)]
    page.legend(_handles(curves, via is not None, page), 4, "\n".join(wrapped))
    return page.axes


def _check_quantity(robot: Robot, quantity: str) -> None:
    family = LimitFamily.of(robot)
    if quantity not in NAMES and quantity not in family:
        known = ", ".join(dict.fromkeys([*NAMES, *family.keys]))
        raise InputError(f"quantity must be one of {known}, not {quantity!r}")
    if not scene.of_joints(robot, quantity) and len(family[quantity].labels) > 1:
        raise InputError(
            f"quantity {quantity!r} has {len(family[quantity].labels)} components that are not the "
            "joints': plots.limit_use shows them"
        )


def _across(page: Page, row: int) -> Axes:
    """One axes in the place of a row; on axes of the caller the first one, the others hidden."""
    first, *others = page.axes[row]
    if page.own:
        grid = first.get_gridspec()
        turned = grid.nrows != page.axes.shape[0] or grid.ncols != page.axes.shape[1]
        first.set_subplotspec(grid[:, row] if turned else grid[row, :])
        page.axes[row, :] = first
    for panel in others:
        panel.remove() if page.own else panel.set_visible(False)
    for panel in page.axes.flat:  # panels of other widths below do not share their ticks
        panel.tick_params(labelbottom=True)
    return first


def curve_page(
    robot: Robot, axes: GivenAxes | None, rows: int, joints: Sequence[int], title: str
) -> Page:
    """Axes [rows, joints]: a column for each joint, or a row for each where they are many."""
    many = len(joints) > COLUMN_JOINTS
    if many:
        size = (max(A4[0], 2.6 * rows), min(A4[1], 1.45 * len(joints) + 1.4))
    else:
        width = A4[0] if len(joints) == 1 else A4_LANDSCAPE[0]
        size = (width, min(9.6, ROW_HEIGHT * rows + 1.3))
    return axes_page(axes, rows, len(joints), size=size, title=title, transposed=many, sharex=True)


def _shown_joints(robot: Robot, joints: Sequence[int] | None) -> list[int]:
    chosen = range(robot.joint_count) if joints is None else joints
    for joint in chosen:
        if not 0 <= joint < robot.joint_count:
            raise InputError(
                f"joints must be indices from 0 to {robot.joint_count - 1}, not {joint}"
            )
    return list(chosen)


def draw_panel(
    axes: Axes,
    robot: Robot,
    curves: Sequence[Curve],
    quantity: str,
    joint: int,
    limits: JointLimits | None,
    via: tuple[FloatArray, FloatArray] | None = None,
    base: bool = False,
) -> None:
    """One quantity of one joint of every curve; the arguments are those of :func:`curves`."""
    factor = scene.display_factor(robot, quantity, joint)
    columns = []
    for place, curve in enumerate(curves):
        if quantity not in curve.values:
            continue
        values = curve.values[quantity][:, joint]
        columns.append(values)
        line = line_of(curve, place, base)
        axes.plot(curve.t, values * factor, label=curve.label, **line)
        for bound in curve.bounds.get(quantity, ()):
            own = bound[:, joint]
            axes.plot(curve.t, own * factor, color=line["color"], label="_own limit", **OWN_LIMIT)
            columns.append(own)
        if len(curve.passages):
            axes.plot(
                curve.passages, np.interp(curve.passages, curve.t, values * factor), "o",
                markersize=5.0 if quantity == "q" else 3.5, color=line["color"],
                markeredgecolor="white", markeredgewidth=0.6, zorder=5 + line["zorder"] / 10,
                label="_via",
            )  # fmt: skip
    if via is not None and quantity == "q":
        columns.append(via[1][:, joint])
        axes.plot(
            via[0], via[1][:, joint] * factor, "o", color="black", markersize=6,
            markeredgecolor="white", zorder=6, label="_via point",
        )  # fmt: skip
    values = np.concatenate([*columns, np.zeros(0)])
    draw_limits(axes, scene.near_limits(robot, limits, quantity, joint, values))
    if quantity == "tau":
        _draw_saturation(axes, curves, joint, limits, base)


def _draw_saturation(
    axes: Axes, curves: Sequence[Curve], joint: int, limits: JointLimits | None, base: bool
) -> None:
    """Limits of single curves, and shades where a curve is at them, each in its share of height."""
    common = () if limits is None else [bound[joint] for bound in limits.bounds("tau")]
    shaded = [place for place, curve in enumerate(curves) if curve.saturated(joint)]
    for place, curve in enumerate(curves):
        color = line_of(curve, place, base)["color"]
        for bound in curve.torque_limits or ():
            if np.isfinite(bound[joint]) and bound[joint] not in common:
                axes.axhline(bound[joint], color=color, zorder=2.5, label="_own limit", **OWN_LIMIT)
        for start, end in curve.saturated(joint):
            top = 1.0 - shaded.index(place) / len(shaded)
            axes.axvspan(
                start, end, top - 1.0 / len(shaded), top, color=color, alpha=0.2, linewidth=0,
                zorder=1.5, label="_saturated",
            )  # fmt: skip


def line_of(curve: Curve, place: int, base: bool = False) -> dict[str, Any]:
    """How the curve at a place among others is drawn."""
    color, dashes = look(place)
    width = 2.2 if curve.prominent else 1.6
    return {
        "color": curve.color or color,
        "linestyle": curve.linestyle or dashes,
        "linewidth": 3.0 if base and not place else width,
        "zorder": (4.0 if curve.prominent else 3.0) + 0.01 * place,
    }


def draw_limits(axes: Axes, limits: scene.AxisLimits) -> None:
    """Set the range of the axes; draw near limits as lines, name far ones above the axes."""
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
            limits.far, (1.0, 1.0), xycoords="axes fraction", xytext=(-2, 2),
            textcoords="offset points", ha="right", va="bottom", fontsize=7.5, color=LIMIT_COLOR,
        )  # fmt: skip


def _cut(axes: Axes, bound: float) -> None:
    low, high = axes.get_ylim()
    if low < -bound or high > bound:
        axes.set_ylim(max(low, -bound), min(high, bound))
        axes.annotate(
            "curves go on beyond", (1.0, 1.0), xycoords="axes fraction", xytext=(-3, -3),
            textcoords="offset points", ha="right", va="top", fontsize=7.5, color=LIMIT_COLOR,
            path_effects=HALO,
        )  # fmt: skip


def _label_panels(
    page: Page, robot: Robot, quantities: Sequence[str], joints: Sequence[int], symbols: bool
) -> None:
    grid, many = page.axes, len(joints) > COLUMN_JOINTS and page.own
    for i, quantity in enumerate(quantities):
        components = joints if scene.of_joints(robot, quantity) else [0] * len(joints)
        units = [scene.display_unit(robot, quantity, k) for k in components]
        name = quantity if symbols and quantity in NAMES else _name(robot, quantity)
        for panel, unit in zip(grid[i], units, strict=True):
            panel.set_ylabel(f"{name} [{unit}]")
        if many:
            _many_labels(grid[i], name, units)
        else:
            for panel, unit in list(zip(grid[i], units, strict=True))[1:]:
                if unit == units[0] and page.own and panel is not grid[i][0]:
                    panel.set_ylabel("")
    first = next(
        (row for row, q in zip(grid, quantities, strict=True) if scene.of_joints(robot, q)), ()
    )
    for panel, joint in zip(first, joints, strict=False):
        if many:
            name = robot.joint_names[joint]  # far limits are named at the right
            panel.set_title(name, fontweight="bold", loc="left", fontsize=9.5, pad=12)
        else:
            panel.set_title(robot.joint_names[joint], fontweight="bold", pad=15)
    for panel in [row[-1] for row in grid] if many else grid[-1]:
        panel.set_xlabel("t [s]")
    if page.own:
        page.figure.align_ylabels(list(grid.flat))


def _name(robot: Robot, quantity: str) -> str:
    return NAMES.get(quantity) or LimitFamily.of(robot)[quantity].name


def _many_labels(column: Sequence[Axes], name: str, units: Sequence[str]) -> None:
    for panel, unit in zip(column, units, strict=True):
        panel.set_ylabel(f"{name} [{unit}]", fontsize=8.5)


def _handles(curves: Sequence[Curve], marked: bool, page: Page) -> list[Any]:
    """Entries of the legend: every curve, then what the markers and shades mean."""
    handles: list[Any] = [
        Line2D([], [], label=curve.label, **line_of(curve, place))
        for place, curve in enumerate(curves)
    ]
    drawn = {str(line.get_label()) for panel in page.axes.flat for line in panel.get_lines()}
    if "_via" in drawn or marked:
        color = "black" if marked else "0.35"
        handles.append(
            Line2D([], [], marker="o", color=color, linestyle="none", label="via point passed")
        )
    if "_limit" in drawn:
        handles += [
            Line2D([], [], color=LIMIT_COLOR, linestyle="--", linewidth=1.0, label="limit"),
            Patch(facecolor="0.5", alpha=0.18, label="beyond a limit"),
        ]
    return handles + _saturation_handles(curves, drawn, page)


def _saturation_handles(curves: Sequence[Curve], drawn: set[str], page: Page) -> list[Any]:
    shades = {
        patch.get_facecolor()
        for panel in page.axes.flat
        for patch in panel.patches
        if patch.get_label() == "_saturated"
    }
    handles: list[Any] = []
    if "_own limit" in drawn:
        text = "limit of the curve of its colour"
        handles.append(Line2D([], [], color=LIMIT_COLOR, label=text, **OWN_LIMIT))
    if shades:
        color = shades.pop() if len(shades) == 1 else ("0.4", 0.2)
        whose = "" if len(curves) == 1 else ", of the curve of its colour"
        handles.append(Patch(facecolor=color, label=f"torque at its limit{whose}"))
    return handles
