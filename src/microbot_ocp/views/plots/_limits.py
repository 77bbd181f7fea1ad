"""Use of limits over time, and saturation of actuators."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.showing import GivenAxes
from microbot_ocp.limits import LimitFamily, LimitHistory, limit_history
from microbot_ocp.motion import Motion
from microbot_ocp.robot import JointLimits, Limits, Robot
from microbot_ocp.tasks import Comparison
from microbot_ocp.views import _scene as scene, _style as style
from microbot_ocp.views._scene import AXIS_MARGIN
from microbot_ocp.views.plots._curves import limit_handle
from microbot_ocp.views.plots._page import AxesGrid, axes_page, styled

LANE_HEIGHT = 0.24  # height of the lane of one joint, inches

# Bars of the saturation chart: upper limits are plain, lower limits hatched; the bar of the torque
# is the highest, the bar of the velocity thin.
HEIGHTS = {"taud": 0.5, "qdd": 0.5, "qddd": 0.5, "qd": 0.25}
JUMP_LINE: dict[str, Any] = {"color": style.LIMIT_COLOR, "linestyle": ":", "linewidth": 2.0}
SWITCH_LINE: dict[str, Any] = {"color": "0.55", **style.THIN}


@styled()
def limit_use(
    robot: Robot,
    motion: Motion,
    axes: GivenAxes | None = None,
    *,
    quantities: Sequence[str] | None = None,
    limits: Limits | JointLimits | None = None,
) -> AxesGrid:
    """Draw the use of every kind of limit over time in percent of the limit.

    Parameters
    ----------
    robot : Robot
    motion : Motion
    axes : array of Axes [quantities], optional
        Default a new figure.
    quantities : sequence of str, optional
        Keys of limits: "q", "qd", "qdd", "qddd", "tau", "taud", or another limit such as
        "tool_speed"; default all limits of the robot except position limits.
    limits : Limits, optional
        Default the robot's limits.

    Returns
    -------
    AxesGrid [quantities, 1]
        Joints differ by colour and dashes. Thin vertical lines mark the times at which a torque
        reaches or leaves its limit (an actuator switches). Dotted lines mark jumps of the
        acceleration that a limit of its rate forbids, including jumps from and to rest.

    Raises
    ------
    InputError
        No limits at all, a quantity without a limit, a motion of another number of joints.
    """
    history = limit_history(robot, motion, limits)
    limited = [quantity for quantity in history.use if quantity != "q"]
    shown = list(limited or history.use) if quantities is None else list(quantities)
    if not history.use or not shown:
        raise InputError("limits must bound something: this robot has none")
    for quantity in shown:
        checks.one_of("quantity with a limit", quantity, history.use)
    size = (style.FIGURE_WIDTH, style.ROW_HEIGHT * len(shown) + 1)
    title = f"{robot.name}, {motion.label}: use of the limits"
    page = axes_page(axes, len(shown), 1, size=size, title=title, sharex=True)
    switches = sorted({t for s in history.spells("tau") for t in (s.start, s.end)})
    jumps = False
    for panel, quantity in zip(page.axes.flat, shown, strict=True):
        times = _jump_times(history, quantity)
        jumps = jumps or bool(times.size)
        _draw_use(panel, history, quantity, switches, times)
        panel.set_xlim(0.0, motion.duration)
    page.axes[-1, 0].set_xlabel("t [s]")
    of_joints = any(scene.of_joints(history.family.robot, key) for key in shown)
    handles: list[Any] = [
        Line2D([], [], label=name, **style.look(joint, joints=True))
        for joint, name in enumerate(robot.joint_names if of_joints else ())
    ]
    handles.append(limit_handle())
    if jumps:
        handles.append(Line2D([], [], label="the acceleration jumps: beyond any rate", **JUMP_LINE))
    if switches:
        label = "a torque reaches or leaves its limit"
        handles.append(Line2D([], [], label=label, **SWITCH_LINE))
    warning = "" if motion.solved else f"not solved: {motion.status}".replace("_", " ")
    page.legend(handles, 5, [warning])
    return page.axes


def _jump_times(history: LimitHistory, quantity: str) -> FloatArray:
    """Return the times at which the acceleration jumps although its rate is limited, s."""
    jumps = history.jumps
    if jumps is None or quantity not in jumps.use:
        return np.zeros(0)
    return jumps.t[(jumps.use[quantity] > 1.0).any(axis=1)]


def _draw_use(
    axes: Axes, history: LimitHistory, quantity: str, switches: Sequence[float], jumps: FloatArray
) -> None:
    share = 100.0 * history.use[quantity]
    drawn = np.where(np.isfinite(share), np.maximum(share, 0.0), np.nan)
    member, of_joints = history.family[quantity], scene.of_joints(history.family.robot, quantity)
    for joint, label in enumerate(member.labels):
        line = style.look(joint, joints=True)
        line["color"] = line["color"] if of_joints else "black"
        axes.plot(history.t, drawn[:, joint], zorder=3 + joint / 100, label=label, **line)
    if not of_joints and len(member.labels) > 1:
        axes.legend(loc="best", fontsize=style.SMALL_FONT)
    for time in switches:
        axes.axvline(time, zorder=2, label="_switch", **SWITCH_LINE)
    for time in jumps:
        axes.axvline(time, zorder=5, label="_jump", **JUMP_LINE)
    top = max(125.0, (1.0 + AXIS_MARGIN) * float(np.nanmax(drawn)))
    axes.axhline(100.0, zorder=4, **style.LIMIT_LINE)
    axes.axhspan(100.0, top, zorder=1, **style.BEYOND_LIMIT)
    axes.set_ylim(0.0, top)
    axes.set_ylabel(f"{textwrap.fill(member.name, 20)} [%]")


@styled()
def saturation(
    subject: Comparison | Mapping[str, Motion],
    axes: GivenAxes | None = None,
    *,
    robot: Robot | None = None,
    methods: Sequence[str] | None = None,
) -> Axes:
    """Draw the times at each limit: one lane per joint of each motion.

    Limits of the arm, such as the tool speed, have lanes below the joints.

    Parameters
    ----------
    subject : Comparison, or mapping from a label to Motion
    axes : Axes, optional
        Default a new figure.
    robot : Robot, optional
        Robot with limits; needed for a mapping.
    methods : sequence of str, optional
        Names of entries of a comparison; default all.

    Returns
    -------
    Axes
        Bars cover the times at which a limit is used to 99 % or more: dark for torque (hatched at
        the lower limit), narrow for velocity.

    Raises
    ------
    InputError
        A mapping without robot, or without motions.
    KeyError
        An unknown method.
    """
    warnings: list[str] = []
    if isinstance(subject, Comparison):
        names = [e.name for e in subject.entries] if methods is None else list(methods)
        chosen = [subject[name] for name in names]
        motions = {style.entry_title(entry): entry.motion for entry in chosen if entry.motion}
        warnings = list(style.failures(subject, names))
        robot, limits = subject.robot, subject.limits
    elif robot is None:
        raise InputError("robot must be given with a mapping of motions")
    elif not subject:
        raise InputError("motions must hold at least one motion")
    else:
        motions, limits = dict(subject), robot.limits
    family = LimitFamily.of(robot, limits)
    others = [member for member in family if not scene.of_joints(family.robot, member.key)]
    titles = {(each.key, k): each.title(k) for each in others for k in range(len(each.labels))}
    lane_of = {key: lane for lane, key in enumerate(titles, robot.joint_count)}
    names = [*robot.joint_names, *titles.values()]
    lanes = len(motions) * len(names)
    size = (style.FIGURE_WIDTH, LANE_HEIGHT * (lanes + len(motions)) + 2)
    page = axes_page(axes, 1, 1, size=size, title=f"{robot.name}: quantities at their limits")
    panel: Axes = page.axes[0, 0]
    ticks, kinds = [], set()
    longest = max((motion.duration for motion in motions.values()), default=1.0)
    font = style.SMALL_FONT if page.is_new else style.TINY_FONT
    for place, (label, motion) in enumerate(motions.items()):
        first = place * (len(names) + 1)
        rows = range(first, first + len(names))
        panel.barh(rows, motion.duration, color="0.93", zorder=1)
        ticks += rows
        for spell in limit_history(robot, motion, limits).every_spell():
            quantity, thin = spell.quantity, spell.quantity == "qd"
            lane = first + lane_of.get((quantity, spell.joint), spell.joint)
            bar = {"height": HEIGHTS.get(quantity, 0.8), "zorder": 3 if thin else 2}
            bar |= _face(family, quantity, spell.side)
            panel.barh(lane, spell.end - spell.start, left=spell.start, label="_spell", **bar)
            kinds.add((quantity, 0 if thin else spell.side))
        panel.annotate(
            f"{label}, {motion.duration:.3f} s", (0.0, first - 0.5), ha="left", va="bottom",
            fontsize=font, fontweight="bold", annotation_clip=False,
        )  # fmt: skip
    panel.set_yticks(ticks, names * len(motions))
    panel.set_ylim(lanes + len(motions) - 1, -2)
    panel.set_xlim(0.0, longest)
    panel.grid(axis="y", visible=False)
    panel.tick_params(axis="y", length=0, labelsize=font)
    panel.set_xlabel("t [s]")
    kinds = sorted(kinds, key=lambda kind: (kind[0] in style.LIMIT_COLORS, *kind), reverse=True)
    patches = [
        Patch(label=scene.limit_text(family[q].name, s), **_face(family, q, s)) for q, s in kinds
    ]
    page.legend(patches, 4, warnings)
    return panel


def _face(family: LimitFamily, quantity: str, side: int) -> dict[str, Any]:
    further = [key for key in family.keys if key != "q" and key not in style.LIMIT_COLORS]
    colors = dict(zip(further, cycle(style.FURTHER_LIMIT_COLORS), strict=False))
    color = (style.LIMIT_COLORS | colors)[quantity]
    if quantity == "qd":
        return {"facecolor": color, "edgecolor": "black", "linewidth": 0.5}
    plain = {"facecolor": color, "edgecolor": color, "linewidth": 0.5}
    return plain if side > 0 else {**plain, "facecolor": "white", "hatch": "//////"}
