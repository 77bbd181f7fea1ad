"""Phase plane of a path: admissible speeds, fastest profile and active limits."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from microbot_ocp._base.showing import GivenAxes
from microbot_ocp.limits import JOINT_QUANTITIES, quantity_name
from microbot_ocp.motion import PiecewisePolynomial
from microbot_ocp.planning import PhasePlane, phase_plane as make_plane
from microbot_ocp.planning.path import PathLimit
from microbot_ocp.robot import Robot
from microbot_ocp.views import _style as style
from microbot_ocp.views._scene import limit_text
from microbot_ocp.views.plots._page import axes_page, halo, styled

FURTHER: dict[str, Any] = {"color": "black", "linestyle": (0.0, (8.0, 1.0, 2.0, 1.0))}
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
    """Draw the speed ds/dt over the path parameter s with its bounds.

    Parameters
    ----------
    robot : Robot
        Robot with joint names; its limits apply if a path is given.
    plane : PhasePlane or PiecewisePolynomial
        Result of :func:`microbot_ocp.planning.phase_plane`, or a path.
    axes : Axes, optional
        Default a new figure.
    unit : str
        Unit of the path parameter, such as "rad" for a straight path.
    title : str
        Title of a new figure; default the robot's name and the duration.

    Returns
    -------
    Axes
        The shade covers states in which no acceleration keeps every limit. The colour of the
        profile names the joint at its limit (solid: upper, dashed: lower torque limit; dotted:
        velocity limit); diamonds are switches. A red text marks a path that cannot be timed.

    Raises
    ------
    InputError
        More than one axes; a path that does not fit the robot.
    """
    if isinstance(plane, PiecewisePolynomial):
        plane = make_plane(robot, plane)
    duration = f", {plane.duration:.3f} s" if plane.feasible else ""
    title = title or f"{robot.name}: phase plane of the path{duration}"
    page = axes_page(axes, 1, 1, size=style.LANDSCAPE, title=title)
    panel: Axes = page.axes[0, 0]
    top = _top(plane)
    handles = _draw_bounds(panel, robot, plane, top)
    handles += _draw_profile(panel, robot, plane)
    panel.set_xlim(float(plane.s[0]), float(plane.s[-1]))
    panel.set_ylim(0.0, top)
    panel.set_xlabel(f"path parameter s [{unit}]" if unit else "path parameter s")
    panel.set_ylabel(f"ds/dt [{unit or 1}/s]")
    if not plane.feasible:
        panel.axvline(plane.blocked_at, color=style.WARNING_COLOR, linewidth=style.LINE_WIDTH)
        text = f"not solved: the end cannot be reached from s = {plane.blocked_at:.4g}"
        corner: dict[str, Any] = {"xytext": (6, -6), "textcoords": "offset points", "va": "top"}
        corner |= {"xy": (0, 1), "xycoords": "axes fraction"}
        panel.annotate(text, color=style.WARNING_COLOR, path_effects=halo(), **corner)
    page.legend(handles, 3)
    return panel


def limit_name(robot: Robot, limit: PathLimit | None) -> str:
    """Return a text on a limit, such as "torque of elbow at its upper limit"."""
    if limit is None:
        return "no quantity at its limit"
    name = quantity_name(limit.quantity)
    if limit.quantity == "tau" and robot.joint_types[limit.joint] == "prismatic":
        name = "force"
    if limit.quantity in JOINT_QUANTITIES:
        name = f"{name} of {robot.joint_names[limit.joint]}"
    return limit_text(name, limit.side)


def _top(plane: PhasePlane) -> float:
    """Return the top of the axes: above the profile, and above bounds up to twice its peak.

    The ends of the path are ignored, because the speed may be unbounded there.
    """
    margin = 0.02 * (plane.s[-1] - plane.s[0])
    inner = (plane.s > plane.s[0] + margin) & (plane.s < plane.s[-1] - margin)
    shown = plane.speed[inner] if plane.feasible else plane.bound[inner]
    shown = shown[np.isfinite(shown)]
    if not shown.size:
        return 1.0
    bounds = np.concatenate([plane.torque_bound[inner], plane.velocity_bound[inner]])
    highest = float(np.max(bounds, where=np.isfinite(bounds), initial=0.0))
    peak = float(shown.max())
    return min(max(1.5 * peak, highest), 2.0 * peak)


def _draw_bounds(axes: Axes, robot: Robot, plane: PhasePlane, top: float) -> list[Any]:
    s, far = plane.s, 10.0 * top
    for low, high in ((np.minimum(plane.bound, far), far), (0.0, plane.least)):
        axes.fill_between(s, low, high, zorder=1, **style.BEYOND_LIMIT)
    handles: list[Any] = [Patch(label="inadmissible", **style.BEYOND_LIMIT)]
    whose = "velocity limits" if (plane.velocity_joint < 0).any() else "joint velocity limits"
    black: dict[str, Any] = {"color": "black", "label": "maximum-velocity curve (torque)"}
    dashed: dict[str, Any] = {"color": "0.35", "label": whose, "linestyle": (0.0, (6.0, 2.0))}
    for bound, line in ((plane.torque_bound, black), (plane.velocity_bound, dashed)):
        if np.isfinite(bound).any():
            handles += axes.plot(s, np.minimum(bound, far), zorder=2, **line)
    _name_velocity_limits(axes, robot, plane, top)
    return handles


def _name_velocity_limits(axes: Axes, robot: Robot, plane: PhasePlane, top: float) -> None:
    """Write the joint beside each part of the velocity bound that is wide enough and visible."""
    joints, least = plane.velocity_joint, 0.08 * (plane.s[-1] - plane.s[0])
    edges = [0, *(np.flatnonzero(np.diff(joints)) + 1), joints.size]
    above: Any = {"xytext": (0, 4), "textcoords": "offset points", "ha": "center", "va": "bottom"}
    for first, last in pairwise(edges):
        s, value = plane.s[first:last], plane.velocity_bound[first:last]
        inside = np.flatnonzero(value < top)
        other = joints[first] < 0  # a limit of the arm; the legend of the profile names it
        if other or inside.size < 2 or np.ptp(s[inside]) < least:
            continue
        middle = inside[inside.size // 2]
        place = (s[middle], value[middle])
        font = {"fontsize": "small", "color": "0.35", "path_effects": halo(), "zorder": 5}
        axes.annotate(robot.joint_names[joints[first]], place, **above, **font)


def _draw_profile(axes: Axes, robot: Robot, plane: PhasePlane) -> list[Any]:
    handles: dict[str, Any] = {}
    for arc in plane.arcs:
        line = {**limit_look(arc.limit), "linewidth": 2 * style.LINE_WIDTH}
        # At a stop s has two samples: take the one on the side of this arc.
        first = int(np.searchsorted(plane.s, arc.start, side="right")) - 1
        last = int(np.searchsorted(plane.s, arc.end, side="left")) + 1
        s, speed = plane.s[first:last], plane.speed[first:last]
        axes.plot(s, speed, color="white", linewidth=3 * style.LINE_WIDTH, zorder=3)
        axes.plot(s, speed, **line, zorder=4, solid_capstyle="butt")
        name = limit_name(robot, arc.limit)
        handles.setdefault(name, Line2D([], [], label=name, **line))
    if plane.switches.size:
        mark = {"markersize": 6, "markeredgecolor": "white", "zorder": 6}
        places = plane.switches, plane.switch_speeds
        (handles["switch"],) = axes.plot(*places, "D", color="black", label="switch", **mark)
    return list(handles.values())


def limit_look(limit: PathLimit | None) -> dict[str, Any]:
    """Return the line style of a limit: colour of the joint, dashes of the kind of limit."""
    if limit is None:
        return {"color": "0.4", "linestyle": "solid"}
    if (limit.quantity, limit.side) not in DASHES:
        return FURTHER
    return style.look(limit.joint, joints=True) | {"linestyle": DASHES[limit.quantity, limit.side]}
