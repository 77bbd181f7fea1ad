"""How much of every limit a motion uses over time, and which actuator saturates when."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.showing import GivenAxes
from microbot_ocp.comparison import Comparison
from microbot_ocp.limits import LimitFamily, LimitHistory, Spell, limit_history
from microbot_ocp.motion import Motion
from microbot_ocp.robot import JointLimits, Limits, Robot
from microbot_ocp.views import _scene as scene
from microbot_ocp.views.plots._page import LIMIT_COLOR, AxesGrid, axes_page, styled
from microbot_ocp.views.plots._style import (
    JOINT_COLORS,
    JOINT_DASHES,
    entry_styles,
    failure_sentence,
)

WIDTH = 9.6  # inches
ROW = 2.1  # inches, of one kind of limit
LANE = 0.24  # inches, of one joint of one motion
TOP = 125.0  # percent, unless a limit is broken by more
# Upper limits are plain, lower ones hatched; velocity is a thin bar in the middle of a lane.
HEIGHTS = {"taud": 0.5, "qdd": 0.5, "qddd": 0.4, "qd": 0.26}
HEIGHT = 0.78  # of any other
SIDES = {1: " at its upper limit", -1: " at its lower limit", 0: " at a limit"}
LOWER_HATCH = "//////"
FACES = {"tau": "0.35", "taud": "0.6", "qdd": "0.6", "qddd": "#56B4E9", "qd": "#E69F00"}
JUMP_LINE: dict[str, Any] = {"color": LIMIT_COLOR, "linestyle": ":", "linewidth": 2.0}
FURTHER_FACES = ("#009E73", "#CC79A7", "#0072B2", "#882255")  # of limits beside the joints'


@styled()
def limit_use(
    robot: Robot,
    motion: Motion,
    axes: GivenAxes | None = None,
    *,
    quantities: Sequence[str] | None = None,
    limits: Limits | JointLimits | None = None,
) -> AxesGrid:
    """Use of every kind of limit over time: 100 % is the limit.

    Parameters
    ----------
    robot : Robot
    motion : Motion
    axes : array of Axes [quantities], optional
        Default a new figure.
    quantities : sequence of str, optional
        Keys of limits: "q", "qd", "qdd", "qddd", "tau", "taud", or of a further one, such as
        "tool_speed"; default all that the robot has but the position's.
    limits : Limits, optional
        Default the robot's own.

    Returns
    -------
    AxesGrid [quantities, 1]
        Joints differ by colour and dashes; thin vertical lines mark where a torque reaches or
        leaves its limit, which is where an actuator switches, and dotted ones where the
        acceleration jumps, at rest before or after the motion, too, though its rate is limited.

    Raises
    ------
    InputError
        No limits at all, a quantity without one, a motion of another number of joints.
    """
    history = limit_history(robot, motion, limits)
    limited = [quantity for quantity in history.use if quantity != "q"]
    shown = list(limited or history.use) if quantities is None else list(quantities)
    for quantity in shown:
        if quantity not in history.use:
            known = ", ".join(history.use) or "none"
            raise InputError(f"quantity must be one with a limit ({known}), not {quantity!r}")
    if not shown:
        raise InputError("limits must bound something: this robot has none")
    joints = {key for key in shown if scene.of_joints(history.family.robot, key)}
    size = (WIDTH, ROW * len(shown) + 1.3)
    title = f"{robot.name}, {motion.label}: use of the limits"
    page = axes_page(axes, len(shown), 1, size=size, title=title, sharex=True)
    switches = sorted({t for s in history.spells("tau") for t in (s.start, s.end)})
    for panel, quantity in zip(page.axes.flat, shown, strict=True):
        _draw_use(panel, history, quantity, switches)
        panel.set_xlim(0.0, motion.duration)
    page.axes[-1, 0].set_xlabel("t [s]")
    handles: list[Any] = [
        Line2D([], [], label=name, **joint_line(joint))
        for joint, name in enumerate(robot.joint_names if joints else ())
    ]
    handles.append(Line2D([], [], color=LIMIT_COLOR, linestyle="--", linewidth=1.0, label="limit"))
    if any(_jump_times(history, quantity).size for quantity in shown):
        handles.append(Line2D([], [], label="the acceleration jumps: beyond any rate", **JUMP_LINE))
    if switches:
        handles.append(
            Line2D([], [], color="0.55", linewidth=0.8, label="a torque meets or leaves its limit")
        )
    warning = "" if motion.solved else f"not solved: {motion.status}"
    page.legend(handles, 5, warning.replace("_", " "))
    return page.axes


def _jump_times(history: LimitHistory, quantity: str) -> FloatArray:
    """When the acceleration jumps though a limit depends on its rate, s."""
    jumps = history.jumps
    if jumps is None or quantity not in jumps.use:
        return np.zeros(0)
    return jumps.t[(jumps.use[quantity] > 1.0).any(axis=1)]


def joint_line(joint: int) -> dict[str, Any]:
    """Colour and dashes of a joint among others."""
    return {
        "color": JOINT_COLORS[joint % len(JOINT_COLORS)],
        "linestyle": JOINT_DASHES[joint % len(JOINT_DASHES)],
        "linewidth": 1.6,
    }


def _draw_use(axes: Axes, history: LimitHistory, quantity: str, switches: Sequence[float]) -> None:
    share = 100.0 * history.use[quantity]
    drawn = np.where(np.isfinite(share), np.maximum(share, 0.0), np.nan)
    member, of_joints = history.family[quantity], scene.of_joints(history.family.robot, quantity)
    for joint, label in enumerate(member.labels):
        line = joint_line(joint) if of_joints else {**joint_line(joint), "color": "black"}
        axes.plot(history.t, drawn[:, joint], zorder=3 + 0.01 * joint, label=label, **line)
    if not of_joints and len(member.labels) > 1:
        axes.legend(loc="best", fontsize=7.5)
    for time in switches:
        axes.axvline(time, color="0.55", linewidth=0.8, zorder=2, label="_switch")
    for time in _jump_times(history, quantity):
        axes.axvline(time, zorder=5, label="_jump", **JUMP_LINE)
    peak = float(np.nanmax(drawn))
    top = max(TOP, 1.06 * peak)
    axes.axhline(100.0, color=LIMIT_COLOR, linestyle="--", linewidth=1.0, zorder=4, label="_limit")
    axes.axhspan(100.0, top, color="0.5", alpha=0.18, linewidth=0, zorder=1)
    axes.set_ylim(0.0, top)
    step = next((step for step in (25, 50, 100) if top <= 5.5 * step), 100 * round(top / 500))
    axes.set_yticks(sorted({100, *range(0, int(top), step)}))
    axes.set_ylabel(f"{textwrap.fill(member.name, 20)} [%]")


@styled()
def saturation(
    subject: Comparison | Mapping[str, Motion],
    axes: GivenAxes | None = None,
    *,
    robot: Robot | None = None,
    methods: Sequence[str] | None = None,
) -> Axes:
    """Which limit is used up when: a lane for each joint of each motion.

    Limits of other quantities than the joints', such as the tool's speed, have lanes below them.

    Parameters
    ----------
    subject : Comparison, or mapping from a label to Motion
    axes : Axes, optional
        Default a new figure.
    robot : Robot, optional
        Of a mapping, with its limits.
    methods : sequence of str, optional
        Names of entries of a comparison; default all.

    Returns
    -------
    Axes
        Bars mark where a limit is used to 99 % or more: dark for torque (hatched at its lower
        limit), narrow for velocity.

    Raises
    ------
    InputError
        A mapping without its robot, or without motions.
    KeyError
        A method that is not there.
    """
    robot, limits, motions, failures = _motions(subject, robot, methods)
    family = LimitFamily.of(robot, limits)
    names = _lanes(family)
    lanes = len(motions) * len(names)
    size = (WIDTH, LANE * (lanes + len(motions)) + 1.6)
    page = axes_page(axes, 1, 1, size=size, title=f"{robot.name}: which limit is used up when")
    panel: Axes = page.axes[0, 0]
    ticks, kinds = [], set()
    longest = max((motion.duration for motion in motions.values()), default=1.0)
    for place, (label, motion) in enumerate(motions.items()):
        history = limit_history(robot, motion, limits)
        first = place * (len(names) + 1)
        for joint in range(len(names)):
            panel.barh(first + joint, motion.duration, height=0.86, color="0.93", zorder=1)
            ticks.append(first + joint)
        for spell in history.every_spell():
            _draw_spell(panel, first, family, spell)
            kinds.add((spell.quantity, 0 if spell.quantity == "qd" else spell.side))
        panel.annotate(
            f"{label}, {motion.duration:.3f} s", (0.0, first - 0.55), ha="left", va="bottom",
            fontsize=7.5 if page.own else 6.5, fontweight="bold", annotation_clip=False,
        )  # fmt: skip
    panel.set_yticks(ticks, list(names) * len(motions), fontsize=8.0 if page.own else 6.5)
    panel.set_ylim(lanes + len(motions) - 1.4, -1.35)
    panel.set_xlim(0.0, 1.01 * longest)
    panel.grid(axis="y", visible=False)
    panel.tick_params(axis="y", length=0)
    panel.set_xlabel("t [s]")
    kinds = sorted(kinds, key=lambda kind: (kind[0] in FACES, *kind), reverse=True)
    page.legend([_spell_patch(family, *kind) for kind in kinds], 4, failures)
    return panel


def _lanes(family: LimitFamily) -> list[str]:
    """Names of the lanes of one motion: its joints, then what further limits are of."""
    further = [member for member in family if not scene.of_joints(family.robot, member.key)]
    titles = [member.title(k) for member in further for k in range(len(member.labels))]
    return [*family.robot.joint_names, *titles]


def _motions(
    subject: Comparison | Mapping[str, Motion], robot: Robot | None, methods: Sequence[str] | None
) -> tuple[Robot, JointLimits, dict[str, Motion], str]:
    if isinstance(subject, Comparison):
        chosen = [e.name for e in subject.entries] if methods is None else list(methods)
        entries = [subject[name] for name in chosen]
        styles = entry_styles(subject)
        motions = {
            styles[entry.name].title: motion
            for entry, motion in scene.solved_entries(subject)
            if entry.name in chosen
        }
        failed = "\n".join(failure_sentence(e) for e in entries if e.motion is None)
        return subject.robot, subject.limits, motions, failed
    if robot is None:
        raise InputError("robot must be given with a mapping of motions")
    if not subject:
        raise InputError("motions must hold at least one motion")
    return robot, robot.limits, dict(subject), ""


def _draw_spell(axes: Axes, first: int, family: LimitFamily, spell: Spell) -> None:
    member = family[spell.quantity]
    lane = spell.joint
    if not scene.of_joints(family.robot, member.key):
        lane = _lanes(family).index(member.title(spell.joint))
    axes.barh(
        first + lane,
        spell.end - spell.start,
        left=spell.start,
        height=HEIGHTS.get(spell.quantity, HEIGHT),
        zorder=3 if spell.quantity == "qd" else 2,
        label="_spell",
        **_face(family, spell.quantity, spell.side),
    )


def _face(family: LimitFamily, quantity: str, side: int) -> dict[str, Any]:
    if quantity == "qd":
        return {"facecolor": FACES[quantity], "edgecolor": "black", "linewidth": 0.5}
    further = [key for key in family.keys if key != "q" and key not in FACES]
    colors = dict(zip(further, cycle(FURTHER_FACES), strict=False))
    color = FACES.get(quantity) or colors[quantity]
    if side > 0:
        return {"facecolor": color, "edgecolor": color, "linewidth": 0.5}
    return {"facecolor": "white", "edgecolor": color, "linewidth": 0.5, "hatch": LOWER_HATCH}


def _spell_patch(family: LimitFamily, quantity: str, side: int) -> Patch:
    return Patch(label=family[quantity].name + SIDES[side], **_face(family, quantity, side))
