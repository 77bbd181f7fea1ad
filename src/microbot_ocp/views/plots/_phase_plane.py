"""The phase plane of a path: admissible speeds, the best profile, and what limits it where."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.showing import GivenAxes
from microbot_ocp.limits import JOINT_QUANTITIES, quantity_name
from microbot_ocp.motion import PiecewisePolynomial
from microbot_ocp.planning import PathLimit, PhasePlane, phase_plane as make_plane
from microbot_ocp.robot import Robot
from microbot_ocp.views.plots._page import HALO, WARNING_COLOR, axes_page, styled
from microbot_ocp.views.plots._style import JOINT_COLORS

SIZE = (9.6, 6.2)  # inches
ROOM, MOST_ROOM = 1.35, 2.0  # height of the axes over the largest speed, least and most
ENDS = 0.02  # share of the path at each end where its parameter may run off
FURTHER_DASHES: Any = (0.0, (8.0, 1.0, 2.0, 1.0))  # of limits beside the joints'
DASHES: dict[tuple[str, int], Any] = {
    ("tau", 1): "solid",
    ("tau", -1): (0.0, (4.0, 1.2)),
    ("qdd", 1): (0.0, (6.0, 1.0, 1.0, 1.0)),
    ("qdd", -1): (0.0, (3.0, 1.0, 1.0, 1.0, 1.0, 1.0)),
    ("qd", 1): (0.0, (1.0, 0.8)),
    ("qd", -1): (0.0, (1.0, 0.8)),
}


@styled()
def phase_plane(
    robot: Robot,
    plane: PhasePlane | PiecewisePolynomial,
    axes: GivenAxes | None = None,
    *,
    unit: str = "",
    title: str = "",
) -> Axes:
    """Speed of the path parameter over the path parameter, with all that bounds it.

    Parameters
    ----------
    robot : Robot
        For names; with the limits where a path is given.
    plane : PhasePlane or PiecewisePolynomial
        From :func:`microbot_ocp.phase_plane`, or a path to make one of.
    axes : Axes, optional
        Default a new figure.
    unit : str
        Of the path parameter, such as "rad" for a straight path.
    title : str
        Of a new figure; default the robot's name and the duration.

    Returns
    -------
    Axes
        Shaded where no acceleration keeps every limit. The profile's colour is that of the joint at
        its limit (solid: upper, dashed: lower torque limit; dotted: velocity limit), switches are
        diamonds. A path that cannot be travelled says so in red.

    Raises
    ------
    InputError
        More than one axes; a path that does not fit the robot.
    """
    if isinstance(plane, PiecewisePolynomial):
        plane = make_plane(robot, plane)
    duration = f", {plane.duration:.3f} s" if plane.feasible else ""
    page = axes_page(
        axes, 1, 1, size=SIZE, title=title or f"{robot.name}: phase plane of the path{duration}"
    )
    panel: Axes = page.axes[0, 0]
    top = _top(plane)
    handles = _draw_bounds(panel, robot, plane, top)
    handles += _draw_profile(panel, robot, plane)
    panel.set_xlim(float(plane.s[0]), float(plane.s[-1]))
    panel.set_ylim(0.0, top)
    panel.set_xlabel(f"path parameter s [{unit}]" if unit else "path parameter s")
    panel.set_ylabel(f"ds/dt [{unit}/s]" if unit else "ds/dt [1/s]")
    if not plane.feasible:
        panel.axvline(plane.blocked_at, color=WARNING_COLOR, linewidth=1.5)
        panel.annotate(
            f"not solved: the end cannot be reached from s = {plane.blocked_at:.4g}",
            (0.02, 0.97), xycoords="axes fraction", va="top", color=WARNING_COLOR,
            path_effects=HALO,
        )  # fmt: skip
    page.legend(handles, 3)
    return panel


def limit_name(robot: Robot, limit: PathLimit | None) -> str:
    """Name of a limit, such as "elbow: upper torque limit"."""
    if limit is None:
        return "no limit used up"
    side = "upper" if limit.side > 0 else "lower"
    name = quantity_name(limit.quantity)
    if limit.quantity not in JOINT_QUANTITIES:
        return f"{side} limit of the {name}"
    if limit.quantity == "tau" and robot.joint_types[limit.joint] == "prismatic":
        name = "force"
    return f"{robot.joint_names[limit.joint]}: {side} {name} limit"


def _top(plane: PhasePlane) -> float:
    """Room for the profile, and for the bounds as far as they are not much above it."""
    span = plane.s[-1] - plane.s[0]
    inner = (plane.s > plane.s[0] + ENDS * span) & (plane.s < plane.s[-1] - ENDS * span)
    shown = plane.speed[inner] if plane.feasible else plane.bound[inner]
    shown = shown[np.isfinite(shown)]
    if not shown.size:
        return 1.0
    bounds = np.concatenate([plane.torque_bound[inner], plane.velocity_bound[inner]])
    bounds = bounds[np.isfinite(bounds)]
    highest = 1.05 * float(bounds.max()) if bounds.size else 0.0
    peak = float(shown.max())
    return min(max(ROOM * peak, highest), MOST_ROOM * peak)


def _draw_bounds(axes: Axes, robot: Robot, plane: PhasePlane, top: float) -> list[Any]:
    s, far = plane.s, 10.0 * top
    bound = np.minimum(plane.bound, far)
    axes.fill_between(s, bound, far, color="0.5", alpha=0.2, linewidth=0, zorder=1)
    axes.fill_between(s, 0.0, plane.least, color="0.5", alpha=0.2, linewidth=0, zorder=1)
    handles: list[Any] = [Patch(facecolor="0.5", alpha=0.2, label="inadmissible")]
    if np.isfinite(plane.torque_bound).any():
        (line,) = axes.plot(
            s, np.minimum(plane.torque_bound, far), color="black", linewidth=1.3, zorder=2,
            label="maximum-velocity curve (torque)",
        )  # fmt: skip
        handles.append(line)
    if np.isfinite(plane.velocity_bound).any():
        every = "velocity limits" if (plane.velocity_joint < 0).any() else "joint velocity limits"
        (line,) = axes.plot(
            s, np.minimum(plane.velocity_bound, far), color="0.35", linewidth=1.3,
            linestyle=(0.0, (6.0, 2.0)), zorder=2, label=every,
        )  # fmt: skip
        handles.append(line)
        _name_velocity_limits(axes, robot, plane, top)
    return handles


def _name_velocity_limits(axes: Axes, robot: Robot, plane: PhasePlane, top: float) -> None:
    """The joint beside each part of the velocity bound that is wide enough and in sight."""
    joints, least = plane.velocity_joint, 0.08 * (plane.s[-1] - plane.s[0])
    edges = [0, *(np.flatnonzero(np.diff(joints)) + 1), joints.size]
    for first, last in pairwise(edges):
        place = slice(first, last)
        value = plane.velocity_bound[place]
        inside = np.flatnonzero(value < 0.97 * top)
        other = joints[first] < 0  # such as the tool's speed: the profile's legend names it
        if other or inside.size < 2 or np.ptp(plane.s[place][inside]) < least:
            continue
        middle = inside[inside.size // 2]
        axes.annotate(
            robot.joint_names[joints[first]],
            (plane.s[place][middle], value[middle]),
            xytext=(0, 4), textcoords="offset points", ha="center", va="bottom", fontsize=8,
            color="0.35", path_effects=HALO, zorder=5,
        )  # fmt: skip


def _draw_profile(axes: Axes, robot: Robot, plane: PhasePlane) -> list[Any]:
    handles: dict[str, Any] = {}
    for arc in plane.arcs:
        look = limit_look(arc.limit)
        s, speed = _between(plane, arc.start, arc.end)
        axes.plot(s, speed, color="white", linewidth=4.5, zorder=3)
        axes.plot(s, speed, **look, linewidth=2.8, zorder=4, solid_capstyle="butt")
        name = limit_name(robot, arc.limit)
        handles.setdefault(name, Line2D([], [], **look, linewidth=2.8, label=f"on {name}"))
    if plane.switches.size:
        (marks,) = axes.plot(
            plane.switches, plane.switch_speeds, "D", color="black", markersize=6,
            markeredgecolor="white", markeredgewidth=0.8, zorder=6, label="switch",
        )  # fmt: skip
        handles["switch"] = marks
    return list(handles.values())


def limit_look(limit: PathLimit | None) -> dict[str, Any]:
    """Colour of the joint and line style of the kind of limit."""
    if limit is None:
        return {"color": "0.4", "linestyle": "solid"}
    if (limit.quantity, limit.side) not in DASHES:
        return {"color": "black", "linestyle": FURTHER_DASHES}
    color = JOINT_COLORS[limit.joint % len(JOINT_COLORS)]
    return {"color": color, "linestyle": DASHES[limit.quantity, limit.side]}


def _between(plane: PhasePlane, start: float, end: float) -> tuple[FloatArray, FloatArray]:
    """The profile from one path parameter to another; a stop belongs to the side that is asked."""
    first = int(np.searchsorted(plane.s, start, side="right")) - 1
    last = int(np.searchsorted(plane.s, end, side="left"))
    return plane.s[first : last + 1], plane.speed[first : last + 1]
