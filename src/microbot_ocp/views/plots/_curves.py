"""Curves of joints over time: the drawing function of every figure of motions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.showing import GivenAxes
from microbot_ocp.limits import AT_LIMIT, LimitFamily, limit_history, quantity_name, use_of
from microbot_ocp.motion import Motion
from microbot_ocp.robot import JointLimits, Robot
from microbot_ocp.simulation import Simulation, Tracking
from microbot_ocp.views import _scene as scene, _style as style
from microbot_ocp.views.plots._page import AxesGrid, Page, axes_page, halo, styled

PASSED = "via point passed"
DOT: dict[str, Any] = {"marker": "o", "linestyle": "none", "markeredgecolor": "white"}
OWN_LIMIT: dict[str, Any] = {"linestyle": ":"}  # limit of a single curve
# Note at the right edge of a panel.
NOTE: Any = {"xycoords": "axes fraction", "textcoords": "offset points", "ha": "right"}
NOTE |= {"fontsize": style.SMALL_FONT, "color": style.LIMIT_COLOR}
PLAIN = ("q", "qd", "qdd", "tau", "error")  # quantities of every robot, also without limits


@dataclass(frozen=True, eq=False)
class Curve:
    """Curve of one motion, drawn as one line in every axes.

    Attributes
    ----------
    label : str
        Label in the legend.
    t : array [N], s
    values : mapping from a quantity to array [N,n]
        Values in SI units, by "q", "qd", "qdd", "tau", "error" (position error) or the key of a
        limit; [N,1] for a quantity of the arm, such as "tool_speed". NaN is not drawn.
    color : str, optional
        Colour; default by the index of the curve, like the line style.
    linestyle : str or (offset, dashes), optional
    passages : sequence of float
        Times at which a via point is passed, s, for markers.
    prominent : bool
        True for a wider line on top of the others.
    warning : str
        Failure, such as "not solved: ...", in red above the legend.
    torque_limits : (lower [n], upper [n]), optional
        Torque limits of this curve, N m (N); times at these limits are shaded.
    bounds : mapping from a quantity to arrays [N,n]
        Bounds that vary along the motion.
    """

    label: str
    t: FloatArray
    values: Mapping[str, FloatArray] = field(default_factory=dict)
    color: str | None = None
    linestyle: style.LineStyle | None = None
    passages: Sequence[float] = ()
    prominent: bool = False
    warning: str = ""
    torque_limits: tuple[FloatArray, FloatArray] | None = None
    bounds: Mapping[str, Sequence[FloatArray]] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        source: Motion | Simulation,
        label: str | None = None,
        *,
        robot: Robot | None = None,
        quantities: Sequence[str] = (),
    ) -> Curve:
        """Return the curve of a motion, a simulation or a tracking.

        Parameters
        ----------
        source : Motion, Simulation or Tracking
        label : str, optional
            Label in the legend; default the label of the source.
        robot : Robot, optional
            Robot; needed for quantities that its limits define.
        quantities : sequence of str
            Keys of limits to evaluate, too, such as "tool_speed".
        """
        label = label or str(getattr(source, "label", "simulation"))
        values = {name: getattr(source, name) for name in ("q", "qd", "qdd", "tau")}
        more: dict[str, Any] = {"warning": "" if source.solved else f"{label}: {source.status}"}
        if robot is not None:
            keys = [quantity for quantity in quantities if quantity not in PLAIN]
            limited, more["bounds"] = _limited_values(robot, source, keys)
            values |= limited
        if isinstance(source, Motion):
            inner = (mark.time for mark in source.marks if 0 < mark.time < source.duration)
            more["passages"] = tuple(inner)
            more["warning"] = "" if source.solved else f"{label}: not solved: {source.status}"
        elif isinstance(source, Tracking):
            values["error"], more["torque_limits"] = source.error, source.torque_limits
        return cls(label, source.t, values, **more)

    def saturated(self, joint: int) -> list[tuple[float, float]]:
        """Return the intervals, s, in which the torque of a joint is at a limit of this curve."""
        if self.torque_limits is None or "tau" not in self.values:
            return []
        (lower, upper), tau = self.torque_limits, self.values["tau"][:, joint]
        at_limit = use_of(tau, lower[joint], upper[joint]) >= AT_LIMIT
        steps = np.diff(np.concatenate([[False], at_limit[:-1], [False]]).astype(int))
        spans = zip(self.t[steps == 1], self.t[steps == -1], strict=True)
        return [(float(start), float(end)) for start, end in spans]


def _limited_values(
    robot: Robot, source: Motion | Simulation, keys: Sequence[str]
) -> tuple[dict[str, FloatArray], dict[str, list[FloatArray]]]:
    """Return the values of limited quantities at the samples, and their varying bounds."""
    values, bounds = {}, {}
    if keys:
        motion = source if isinstance(source, Motion) else source.as_motion("")
        history = limit_history(robot, motion)
        at = np.searchsorted(history.t, motion.t)  # history.t contains every sample
        for key in (key for key in keys if key in history.limited):
            value, *sides = history.limited[key]
            values[key] = value[at]
            bounds[key] = [side[at] for side in sides if side.shape == value.shape]
    return values, bounds


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
    """Draw quantities of joints over time.

    Parameters
    ----------
    robot : Robot
        Robot with names and units.
    curves : sequence of Curve
        Curves; a curve without a quantity is left out of its axes.
    quantities : sequence of str
        Rows of panels: "q", "qd", "qdd", "tau", "error", or the key of another limit of the robot,
        such as "taud" or "tool_speed". A quantity of the arm has one panel across the row.
    axes : array of Axes [quantities, joints], optional
        Default a new figure with one column per joint (one row per joint for more than four).
    joints : sequence of int, optional
        Indices from 0; default all.
    limits : JointLimits, optional
        Limits, drawn as lines near the curves or else named above the axes.
    via : (times [m], positions [m,n]), optional
        Via points, s and rad (m), drawn with the position.
    bounds : mapping, optional
        Largest drawn value per quantity, in drawn units; a note in the axes marks cut curves.
    base : bool
        True to draw the first curve wide and below the others, as their reference.
    title : str
        Title of a new figure.
    symbols : bool
        Label axes with q, qd, tau instead of position, velocity, torque.
    warnings : sequence of str
        Failures, besides the warnings of the curves.

    Returns
    -------
    AxesGrid [quantities, joints]

    Raises
    ------
    InputError
        An unknown quantity or joint, axes of another shape.
    """
    shown = _shown_joints(robot, joints)
    robot = robot if limits is None else robot.with_limits(limits)
    for quantity in quantities:
        _check_quantity(robot, quantity)
    page = _page(axes, len(quantities), len(shown), title)
    for row, quantity in enumerate(quantities):
        panels = list(zip(page.axes[row], shown, strict=True))
        if not scene.of_joints(robot, quantity):
            panels = [(_across(page, row), 0)]
        for panel, joint in panels:
            draw_panel(panel, robot, curves, quantity, joint, limits, via, base)
            if bounds and quantity in bounds:
                _cut(panel, bounds[quantity])
    _label_panels(page, robot, quantities, shown, symbols)
    every = [*warnings, *(curve.warning for curve in curves)]
    page.legend(_handles(curves, via is not None, page), 4, every)
    return page.axes


def _check_quantity(robot: Robot, quantity: str) -> None:
    family = LimitFamily.of(robot)
    checks.one_of("quantity", quantity, dict.fromkeys([*PLAIN, *family.keys]))
    if not scene.of_joints(robot, quantity) and len(family[quantity].labels) > 1:
        raise InputError(
            f"quantity {quantity!r} has {len(family[quantity].labels)} components other than the "
            "joints: draw it by plots.limit_use"
        )


def _shown_joints(robot: Robot, joints: Sequence[int] | None) -> list[int]:
    shown = list(range(robot.joint_count) if joints is None else joints)
    for joint in shown:
        if not 0 <= joint < robot.joint_count:
            raise InputError(
                f"joints must be indices from 0 to {robot.joint_count - 1}, not {joint}"
            )
    return shown


def _page(axes: GivenAxes | None, rows: int, joints: int, title: str) -> Page:
    """Return axes [rows, joints], laid out with a column per joint, or a row if they are many."""
    (width, height), many, panels = style.PAGE, joints > style.SIDE_BY_SIDE, style.ROW_HEIGHT * rows
    if many:
        size = (max(width, panels), height)
    else:
        size = (width if joints == 1 else height, min(style.FIGURE_WIDTH, panels + 1))
    return axes_page(axes, rows, joints, size=size, title=title, transposed=many, sharex=True)


def _across(page: Page, row: int) -> Axes:
    """Return one axes for a whole row; the other axes of the row are removed or hidden."""
    first, *others = page.axes[row]
    if page.is_new:
        grid = first.get_gridspec()
        turned = grid.nrows != page.axes.shape[0] or grid.ncols != page.axes.shape[1]
        first.set_subplotspec(grid[:, row] if turned else grid[row, :])
        page.axes[row, :] = first
    for panel in others:
        panel.remove() if page.is_new else panel.set_visible(False)
    for panel in page.axes.flat:  # panels of other widths below do not share their ticks
        panel.tick_params(labelbottom=True)
    return first


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
    """Draw one quantity of one joint for every curve; see :func:`curves` for the arguments."""
    factor, columns = scene.display_factor(robot, quantity, joint), [np.zeros(0)]
    for place, curve in enumerate(curves):
        if quantity not in curve.values:
            continue
        values, line = curve.values[quantity][:, joint], line_of(curve, place, base)
        columns.append(values)
        axes.plot(curve.t, values * factor, label=curve.label, **line)
        for bound in (table[:, joint] for table in curve.bounds.get(quantity, ())):
            own = {**OWN_LIMIT, "color": line["color"], "label": "_own limit"}
            axes.plot(curve.t, bound * factor, **own)
            columns.append(bound)
        if len(curve.passages):
            places = np.interp(curve.passages, curve.t, values * factor)
            dot = {"color": line["color"], "markersize": 4, "zorder": 5 + line["zorder"] / 10}
            axes.plot(curve.passages, places, label="_via", **DOT, **dot)
    if via is not None and quantity == "q":
        columns.append(via[1][:, joint])
        dot = {"color": "black", "markersize": 6, "zorder": 6}
        axes.plot(via[0], via[1][:, joint] * factor, label="_via point", **DOT, **dot)
    values = np.concatenate(columns)
    axes.margins(x=0.015)
    _draw_limits(axes, scene.near_limits(robot, limits, quantity, joint, values))
    if quantity == "tau":
        _draw_saturation(axes, curves, joint, limits, base)


def _draw_saturation(
    axes: Axes, curves: Sequence[Curve], joint: int, limits: JointLimits | None, base: bool
) -> None:
    """Draw the limits of single curves and shade the times at them, one strip per curve."""
    common = () if limits is None else [bound[joint] for bound in limits.bounds("tau")]
    shaded = [place for place, curve in enumerate(curves) if curve.saturated(joint)]
    for place, curve in enumerate(curves):
        color = line_of(curve, place, base)["color"]
        for bound in curve.torque_limits or ():
            if np.isfinite(bound[joint]) and bound[joint] not in common:
                axes.axhline(bound[joint], color=color, zorder=2, label="_own limit", **OWN_LIMIT)
        for start, end in curve.saturated(joint):
            top, share = 1.0 - shaded.index(place) / len(shaded), 1.0 / len(shaded)
            shade = style.BEYOND_LIMIT | {"facecolor": color, "label": "_saturated"}
            axes.axvspan(start, end, top - share, top, zorder=2, **shade)


def line_of(curve: Curve, place: int, base: bool = False) -> dict[str, Any]:
    """Return the line style of the curve with an index ``place``."""
    line = style.look(place)
    return {
        "color": curve.color or line["color"],
        "linestyle": curve.linestyle or line["linestyle"],
        "linewidth": 3 if base and not place else style.LINE_WIDTH * (1 + curve.prominent / 2),
        "zorder": 3 + curve.prominent + place / 100,
    }


def _draw_limits(axes: Axes, limits: scene.AxisLimits) -> None:
    """Set the range of the axes; draw near limits as lines and name far limits at the edge."""
    axes.set_ylim(*limits.axis)
    for limit, edge in zip((limits.lower, limits.upper), limits.axis, strict=True):
        if limit is not None:
            axes.axhline(limit, zorder=2, **style.LIMIT_LINE)
            axes.axhspan(*sorted((limit, edge)), zorder=1, **style.BEYOND_LIMIT)
    if limits.far:
        below = limits.far.startswith("lower")  # the upper edge has the line of the upper limit
        place: Any = {"xy": (1.0, 0.0), "path_effects": halo()} if below else {"xy": (1.0, 1.0)}
        axes.annotate(limits.far, xytext=(-2, 2), va="bottom", **place, **NOTE)


def _cut(axes: Axes, bound: float) -> None:
    low, high = axes.get_ylim()
    if low < -bound or high > bound:
        axes.set_ylim(max(low, -bound), min(high, bound))
        place: Any = {"xytext": (-3, -3), "va": "top", "path_effects": halo()}
        axes.annotate("curves go on beyond", (1.0, 1.0), **place, **NOTE)


def _name_of(robot: Robot, quantity: str, symbols: bool) -> str:
    """Return the symbol or name of a quantity; a limit of the user's own has its own name."""
    if quantity not in PLAIN:
        return LimitFamily.of(robot)[quantity].name
    return quantity if symbols else quantity_name(quantity)


def _label_panels(
    page: Page, robot: Robot, quantities: Sequence[str], joints: Sequence[int], symbols: bool
) -> None:
    """Label the panels (only the first of a row if labels are equal) and name the joints."""
    grid, many = page.axes, len(joints) > style.SIDE_BY_SIDE and page.is_new
    named = False
    for row, quantity in zip(grid, quantities, strict=True):
        of_joints = scene.of_joints(robot, quantity)
        units = [scene.display_unit(robot, quantity, j if of_joints else 0) for j in joints]
        name = _name_of(robot, quantity, symbols)
        for panel, unit in zip(row, units, strict=True):
            repeated = page.is_new and not many and unit == units[0] and panel is not row[0]
            size = "small" if many else "medium"
            panel.set_ylabel("" if repeated else f"{name} [{unit}]", fontsize=size)
        for panel, joint in zip(row, joints, strict=True) if of_joints and not named else ():
            # The title stands left, because notes on far limits stand at the right.
            left = {"loc": "left", "fontsize": "medium", "pad": 12} if many else {"pad": 15}
            panel.set_title(robot.joint_names[joint], fontweight="bold", **left)
        named = named or of_joints
    for panel in grid[:, -1] if many else grid[-1]:
        panel.set_xlabel("t [s]")
    if page.is_new:
        page.axes.figure.align_ylabels(list(grid.flat))


def _handles(curves: Sequence[Curve], marked: bool, page: Page) -> list[Any]:
    """Return the entries of the legend: curves, markers, limits and shades."""
    handles: list[Any] = [
        Line2D([], [], label=curve.label, **line_of(curve, place))
        for place, curve in enumerate(curves)
    ]
    drawn = {str(line.get_label()) for panel in page.axes.flat for line in panel.get_lines()}
    if "_via" in drawn or marked:
        color = "black" if marked else "0.35"
        dot: dict[str, Any] = {"marker": "o", "color": color, "linestyle": "none"}
        handles.append(Line2D([], [], label=PASSED, **dot))
    if "_limit" in drawn:
        handles.append(limit_handle())
        handles.append(Patch(label="beyond a limit", **style.BEYOND_LIMIT))
    if "_own limit" in drawn:
        text = "limit of the curve of its colour"
        handles.append(Line2D([], [], color=style.LIMIT_COLOR, label=text, **OWN_LIMIT))
    patches = [patch for panel in page.axes.flat for patch in panel.patches]
    shades = {p.get_facecolor() for p in patches if p.get_label() == "_saturated"}
    if shades:
        color = shades.pop() if len(shades) == 1 else ("0.4", style.BEYOND_LIMIT["alpha"])
        whose = "" if len(curves) == 1 else ", of the curve of its colour"
        handles.append(Patch(facecolor=color, label=f"{scene.limit_text('torque', 0)}{whose}"))
    return handles


def limit_handle() -> Line2D:
    """Return the legend entry of a limit."""
    return Line2D([], [], **{**style.LIMIT_LINE, "label": "limit"})
