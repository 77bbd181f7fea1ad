"""Curves of joints against time: one drawing function under every figure of motions."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.showing import GivenAxes
from microbot_ocp.motion import Motion
from microbot_ocp.robot import JointLimits, Robot
from microbot_ocp.simulation import Simulation, Tracking
from microbot_ocp.views import _scene as scene
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
from microbot_ocp.views.plots._style import LineStyle, look

ROW_HEIGHT = 2.3  # inches
COLUMN_JOINTS = 4  # with more joints than this each has a row, not a column
NAMES = {
    "q": "position",
    "qd": "velocity",
    "qdd": "acceleration",
    "tau": "torque",
    "error": "error",
}


@dataclass(frozen=True, eq=False)
class Curve:
    """One line in every axes.

    Attributes
    ----------
    label : str
        What the legend prints.
    t : array [N], s
    values : mapping from a quantity to array [N,n]
        "q", "qd", "qdd", "tau" and "error" (of the position), rad (m), N m (N); NaN is not drawn.
    color : str, optional
        Default by the place among the curves, as is the line style.
    linestyle : str or (offset, dashes), optional
    passages : sequence of float
        Times at which a via point is passed, s: marked.
    prominent : bool
        Whether it is drawn on top and a little wider.
    warning : str
        What is wrong with it, such as "not solved: ..."; printed in red above the legend.
    torque_limits : (lower [n], upper [n]), optional
        Its own, N m (N); where the torque is at one of them its axes are shaded.
    """

    label: str
    t: FloatArray
    values: Mapping[str, FloatArray] = field(default_factory=dict)
    color: str | None = None
    linestyle: LineStyle | None = None
    passages: Sequence[float] = ()
    prominent: bool = False
    warning: str = ""
    torque_limits: tuple[FloatArray, FloatArray] | None = None

    @classmethod
    def of(cls, source: Motion | Simulation, label: str | None = None) -> Curve:
        """Curve of a motion, a simulation or a tracking; its own label where none is given."""
        torque_limits = None
        values = {name: getattr(source, name) for name in ("q", "qd", "qdd", "tau")}
        name = label or str(getattr(source, "label", "simulation"))
        if isinstance(source, Tracking):
            values["error"] = source.error
            torque_limits = source.torque_limits
        if isinstance(source, Motion):
            inner = tuple(m.time for m in source.marks if 0 < m.time < source.duration)
            failure = "" if source.solved else f"{name}: not solved: {source.status}"
            return cls(name, source.t, values, passages=inner, warning=failure)
        warning = "" if source.solved else f"{name}: {source.status}"
        return cls(name, source.t, values, warning=warning, torque_limits=torque_limits)

    def saturated(self, joint: int) -> list[tuple[float, float]]:
        """Stretches of time, s, in which the torque of a joint is at one of its own limits."""
        if self.torque_limits is None or "tau" not in self.values:
            return []
        (lower, upper), tau = self.torque_limits, self.values["tau"][:, joint]
        at_limit = (tau <= lower[joint]) | (tau >= upper[joint])
        steps = np.diff(np.concatenate([[False], at_limit[:-1], [False]]).astype(int))
        spans = zip(self.t[steps == 1], self.t[steps == -1], strict=True)
        return [(float(start), float(end)) for start, end in spans]


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
        Of "q", "qd", "qdd", "tau", "error".
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
    for quantity in quantities:
        if quantity not in NAMES:
            raise InputError(f"quantity must be one of {', '.join(NAMES)}, not {quantity!r}")
    page = curve_page(robot, axes, len(quantities), shown, title)
    for row, quantity in zip(page.axes, quantities, strict=True):
        for panel, joint in zip(row, shown, strict=True):
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
        if len(curve.passages):
            axes.plot(
                curve.passages,
                np.interp(curve.passages, curve.t, values * factor),
                linestyle="none",
                marker="o",
                markersize=5.0 if quantity == "q" else 3.5,
                color=line["color"],
                markeredgecolor="white",
                markeredgewidth=0.6,
                zorder=5 + line["zorder"] / 10,
                label="_via",
            )
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
    """Limits of single curves, and a lane of its own for each curve that is at them."""
    lanes = [place for place, curve in enumerate(curves) if curve.saturated(joint)]
    for place, curve in enumerate(curves):
        if curve.torque_limits is None:
            continue
        color = line_of(curve, place, base)["color"]
        common = () if limits is None else [bound[joint] for bound in limits.bounds("tau")]
        for bound in curve.torque_limits:
            if np.isfinite(bound[joint]) and bound[joint] not in common:
                axes.axhline(
                    bound[joint],
                    color=color,
                    linestyle=":",
                    linewidth=1.2,
                    zorder=2.5,
                    label="_own limit",
                )
        if place in lanes:
            top = 1.0 - lanes.index(place) / len(lanes)
            for start, end in curve.saturated(joint):
                axes.axvspan(
                    start,
                    end,
                    top - 1.0 / len(lanes),
                    top,
                    color=color,
                    alpha=0.2,
                    linewidth=0,
                    zorder=1.5,
                    label="_saturated",
                )


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
        units = [scene.display_unit(robot, quantity, joint) for joint in joints]
        name = quantity if symbols else NAMES[quantity]
        for panel, unit in zip(grid[i], units, strict=True):
            panel.set_ylabel(f"{name} [{unit}]")
        if many:
            _many_labels(grid[i], name, units)
        else:
            for panel, unit in list(zip(grid[i], units, strict=True))[1:]:
                if unit == units[0] and page.own:
                    panel.set_ylabel("")
    for panel, joint in zip(grid[0], joints, strict=True):
        if many:
            name = robot.joint_names[joint]  # far limits are named at the right
            panel.set_title(name, fontweight="bold", loc="left", fontsize=9.5, pad=12)
        else:
            panel.set_title(robot.joint_names[joint], fontweight="bold", pad=15)
    for panel in [row[-1] for row in grid] if many else grid[-1]:
        panel.set_xlabel("t [s]")
    if page.own:
        page.figure.align_ylabels(list(grid.flat))


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
        p.get_facecolor()
        for a in page.axes.flat
        for p in a.patches
        if p.get_label() == "_saturated"
    }
    handles: list[Any] = []
    if "_own limit" in drawn:
        handles.append(
            Line2D(
                [],
                [],
                color="0.25",
                linestyle=":",
                linewidth=1.2,
                label="torque limit of the curve of its colour",
            )
        )
    if shades:
        color = shades.pop() if len(shades) == 1 else ("0.4", 0.2)
        text = (
            "torque at its limit"
            if len(curves) == 1
            else "torque at its limit, of the curve of its colour"
        )
        handles.append(Patch(facecolor=color, label=text))
    return handles
