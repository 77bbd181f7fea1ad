"""Limits along a motion: every question about them is asked here, and the answers are drawn.

Spells at a limit become lanes of the state timeline, points on the trail and lines of text.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
import rerun as rr

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.limits import AT_LIMIT, LIMIT_TOLERANCE, LimitValues, Member, quantity_name
from microbot_ocp.robot import JointLimits, Robot
from microbot_ocp.views._scene import AxisLimits, display_factor, near_limits, reach
from microbot_ocp.views.recording._animated_arm import (
    BEYOND_COLOR,
    JOINT_CURVES,
    SATURATED_COLOR,
    SPEED_COLOR,
    VIA_COLOR,
    AnimatedArm,
    Color,
)
from microbot_ocp.views.recording._curves import draw_bound, draw_curve, draw_dashed
from microbot_ocp.views.recording._surroundings import upward
from microbot_ocp.views.recording._writer import (
    MARKS,
    TIME,
    Times,
    Writer,
    arm_path,
    lane_path,
    plot_path,
)

QUANTITIES = ("qd", "qdd", "tau")  # every motion comes near some limit of its positions
LABEL_HEIGHT = 0.05  # of a switch, share of the reach
LABEL_TIME = 0.1  # that it stands, share of the motion
FREE = "within"
SIDES = {-1: "min", 1: "max"}


class LimitSpell(NamedTuple):
    """A time spent at a limit: samples ``first`` to ``last``."""

    joint: int | None  # 0-based; None for a limit that is not of a joint
    text: str  # "torque max", "tool speed max exceeded"
    first: int
    last: int


def limit_spells(arm: AnimatedArm) -> list[LimitSpell]:
    """Every spell of an arm at a limit but those of positions, in order of time."""
    if arm.history is None:
        return []
    found = []
    t, family = arm.history.t, arm.history.family
    for spell in arm.history.every_spell():
        member, k = family[spell.quantity], spell.joint
        first, last = (int(i) for i in np.searchsorted(t, [spell.start, spell.end]))
        peak = float(arm.history.use[spell.quantity][first : last + 1, k].max())
        text = f"{member.name if member.limit is None else member.title(k)} {SIDES[spell.side]}"
        if peak > 1.0 + LIMIT_TOLERANCE:
            text += " exceeded"
        found.append(LimitSpell(k if member.limit is None else None, text, first, last))
    return sorted(found, key=lambda spell: (spell.first, lane_order(spell.joint)))


def lane_order(joint: int | None) -> float:
    """Joints in their order, then what is not of a joint."""
    return np.inf if joint is None else joint


def _further(arm: AnimatedArm) -> list[tuple[Member, LimitValues]]:
    """The limits beside those of position, velocity, acceleration and torque, with values."""
    if arm.history is None:
        return []
    family, limited = arm.history.family, arm.history.limited
    return [(family[key], limited[key]) for key in limited if key not in JOINT_CURVES]


class LimitPlot(NamedTuple):
    """A plot of one component of a further limit."""

    key: str
    label: str
    title: str


def limit_plots(arms: Sequence[AnimatedArm]) -> list[LimitPlot]:
    """Plots of the further limits that some arm has values of."""
    found = []
    for arm in arms:
        for member, _ in _further(arm):
            for k in np.flatnonzero(member.limited).tolist():
                unit = f" [{member.units[k]}]" if member.units[k] else ""
                label = member.labels[k] or "value"
                found.append(LimitPlot(member.key, label, f"{member.title(k)}{unit}"))
    return list(dict.fromkeys(found))


def draw_limit_curves(writer: Writer, arm: AnimatedArm, end: Times) -> None:
    """Values of the further limits along the motion; the bounds beside those of the solid arm."""
    whole = {key: (0.0, float(value[0])) for key, value in end.items()}
    for member, values in _further(arm):
        for k in np.flatnonzero(member.limited):
            path = plot_path(member.key, member.labels[k] or "value")
            draw_curve(writer, arm, f"{path}/{arm.name}", arm.times, values.value[:, k])
            if not arm.look.solid:
                continue
            for side, bound in (("lower", values.lower), ("upper", values.upper)):
                own = np.broadcast_to(bound, values.value.shape)[:, k]
                if np.isinf(own).all():
                    continue
                if np.ptp(own) == 0.0:
                    draw_dashed(writer, f"{path}/limit_{side}", [(whole, float(own[0]))])
                else:
                    draw_bound(writer, f"{path}/limit_{side}", arm.times, own)


def limit_notes(arm: AnimatedArm) -> list[str]:
    """A sentence on the peak of every further limit."""
    notes = []
    for member, drawn in _further(arm):
        assert arm.history is not None
        t, values, use = arm.history.judged(member.key)
        i, k = np.unravel_index(int(use.argmax()), use.shape)
        bound = member.nearest_bound(values)[i, k]
        title, unit = member.title(int(k)), member.units[k]
        asks = f"at most {100 * use[i, k]:.0f} % of its limit of"
        if i >= len(drawn.value) and use[i, k] > 1.0:
            asks = "the acceleration jumps, beyond its limit of"
        notes.append(
            f"{title[0].upper()}{title[1:]}: {asks} {bound:.4g} {unit}".rstrip()
            + f", at {t[i]:.3f} s."
        )
    return notes


def signed_share(
    limits: JointLimits, quantity: str, values: FloatArray, joint: int
) -> tuple[FloatArray, np.ndarray]:
    """Shares [N] of a joint's limit with the sign of the values [N], and whether it is met [N].

    Without a limit they are shares of the largest value, and it is never met.
    """
    lower, upper = (float(bound[joint]) for bound in limits.bounds(quantity))
    own = np.where(values >= 0.0, upper, -lower)
    if np.isfinite(own).all():
        share = np.divide(values, own, out=np.sign(values), where=own > 0.0)
        return share, np.abs(share) >= AT_LIMIT
    largest = float(np.abs(values).max())
    share = values / largest if largest > 0.0 else np.zeros_like(values)
    return share, np.zeros(len(values), dtype=bool)


def drawn_bounds(robot: Robot, quantity: str, joint: int) -> tuple[float, float]:
    """Lower and upper limit of a robot's joint in drawn units."""
    factor = display_factor(robot, quantity, joint)
    lower, upper = (factor * float(bound[joint]) for bound in robot.limits.bounds(quantity))
    return lower, upper


def axis_limits(
    robot: Robot, limits: JointLimits, arms: Sequence[AnimatedArm], quantity: str, joint: int
) -> AxisLimits:
    """Limits near enough to the curves of all arms to be drawn beside them."""
    values = [arm.curves[quantity][:, joint] for arm in arms if quantity in arm.curves]
    joined = np.concatenate(values) if values else np.zeros(0)
    return near_limits(robot, limits, quantity, joint, joined)


def peak_table(arm: AnimatedArm) -> tuple[list[str], list[list[str]]]:
    """Heads, and a row for every joint: an arm's peaks, % of the limits where there are any."""
    assert arm.history is not None
    use = {key: arm.history.use[key].max(axis=0) for key in QUANTITIES if key in arm.history.use}
    rows = [[name] for name in arm.history.family.robot.joint_names]
    for peaks in use.values():
        for row, peak in zip(rows, peaks, strict=True):
            row.append(f"{100 * peak:.0f}" if peak > 0.0 else "–")
    return ["joint", *(f"peak {key} [%]" for key in use)], rows


class Switch(NamedTuple):
    """A sample at which a spell begins or ends."""

    sample: int
    spell: LimitSpell
    begins: bool

    def text(self, robot: Robot) -> str:
        """Such as "elbow torque max begins"."""
        joint = self.spell.joint
        owner = "" if joint is None else f"{robot.joint_names[joint]} "
        return f"{owner}{self.spell.text} {'begins' if self.begins else 'ends'}"


def _switches(spells: Iterable[LimitSpell], count: int) -> list[Switch]:
    """Where spells begin and end within a motion of ``count`` samples, in order of time."""
    every = [Switch(spell.first, spell, True) for spell in spells if spell.first > 0]
    every += [Switch(spell.last, spell, False) for spell in spells if spell.last < count - 1]
    return sorted(every, key=lambda switch: switch.sample)


def draw_lanes(
    writer: Writer, robot: Robot, arm: AnimatedArm, spells: Sequence[LimitSpell]
) -> None:
    """A lane for every joint that shows at which limit it is, for the state timeline.

    One more lane is for the limits that are not of a joint, where one of them is met.
    """
    others = [None] if any(spell.joint is None for spell in spells) else []
    for joint in [*range(robot.joint_count), *others]:
        states = np.full(len(arm.q), "", dtype=object)
        for spell in spells:
            if spell.joint == joint:
                span = slice(spell.first, spell.last + 1)
                states[span] = [f"{s} + {spell.text}" if s else spell.text for s in states[span]]
        states[states == ""] = FREE
        states[-1] = FREE  # the lane ends where the motion does
        change = np.flatnonzero(np.append(True, states[1:] != states[:-1]))
        path = lane_path(robot, arm.name, joint)
        known = sorted(set(states))
        colors = [_lane_color(state) for state in known]
        visible = [state != FREE for state in known]
        writer.static(path, rr.StateConfiguration(values=known, colors=colors, visible=visible))
        times = {key: value[change] for key, value in arm.times.items()}
        writer.columns(path, times, rr.StateChange.columns(state=list(states[change])))


def _lane_color(state: str) -> Color:
    if "exceeded" in state:
        return BEYOND_COLOR
    return SATURATED_COLOR if quantity_name("tau") in state else SPEED_COLOR


def draw_switches(
    writer: Writer, robot: Robot, arm: AnimatedArm, spells: Sequence[LimitSpell], tool: FloatArray
) -> None:
    """A point on the trail ``tool`` [N,3] wherever a limit is reached or left."""
    switches = _switches(spells, len(arm.q))
    if not switches:
        return
    at = np.array([switch.sample for switch in switches])
    colors = [SATURATED_COLOR if switch.begins else VIA_COLOR for switch in switches]
    path = arm_path(arm.name, "switches")
    times = {key: value[at] for key, value in arm.times.items()}
    writer.static(path, rr.Points3D.from_fields(radii=[0.5 * arm.look.radius]))
    writer.columns(path, times, rr.Points3D.columns(positions=tool[at], colors=colors))
    # all labels at once would hide each other: one stands until the next, or for a while
    labels = [switch.text(robot) for switch in switches]
    tiny = rr.Points3D.from_fields(radii=[1e-3 * arm.look.radius], show_labels=True)
    writer.static(f"{path}/latest", tiny)
    above = tool[at] + LABEL_HEIGHT * reach(robot) * upward(robot)
    labelled = rr.Points3D.columns(positions=above, colors=colors, labels=labels)
    writer.columns(f"{path}/latest", times, labelled)
    following = np.append(at[1:], len(arm.q))
    gone = at + int(LABEL_TIME * len(arm.q))
    gone = gone[gone < following]
    if gone.size:
        times = {key: value[gone] for key, value in arm.times.items()}
        nothing = rr.Points3D.columns(positions=np.zeros((0, 3)), labels=[])
        empty = [column.partition(np.zeros(len(gone), dtype=int)) for column in nothing]
        writer.columns(f"{path}/latest", times, empty)


def draw_marks(
    writer: Writer, robot: Robot, arm: AnimatedArm, spells: Sequence[LimitSpell]
) -> None:
    """A line of text for every mark and every switch; whose it is, if there are several."""
    clock = arm.times[TIME]
    lines = [(mark.time, mark.name) for mark in arm.marks]
    for switch in _switches(spells, len(arm.q)):
        lines.append((float(clock[switch.sample]), switch.text(robot)))
    if not lines:
        return
    lines.sort(key=lambda line: line[0])
    columns = rr.TextLog.columns(
        text=[f"{text}: {arm.title}" if arm.title else text for _, text in lines],
        level=["INFO"] * len(lines),
        color=[arm.look.line_color] * len(lines),
    )
    t = np.array([time for time, _ in lines])
    times: Times = {
        key: t if key == TIME else np.rint(np.interp(t, clock, value))
        for key, value in arm.times.items()
    }
    writer.columns(f"{MARKS}/{arm.name}", times, columns)
