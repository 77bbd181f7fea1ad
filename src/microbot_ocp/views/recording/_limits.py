"""Limits along a motion: every question about them is asked here, and the answers are drawn.

Spells at a limit become lanes of the state timeline, points on the trail and lines of text.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
import rerun as rr

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.limits import AT_LIMIT, quantity_name
from microbot_ocp.robot import JointLimits, Robot
from microbot_ocp.views._scene import AxisLimits, display_factor, near_limits, reach
from microbot_ocp.views.recording._animated_arm import (
    BEYOND_COLOR,
    SATURATED_COLOR,
    SPEED_COLOR,
    VIA_COLOR,
    AnimatedArm,
    Color,
)
from microbot_ocp.views.recording._surroundings import upward
from microbot_ocp.views.recording._writer import MARKS, TIME, Times, Writer, arm_path, lane_path

BEYOND = 1.005  # share of a limit from which on it counts as broken, as certificates have it
QUANTITIES = ("qd", "qdd", "tau")  # every motion comes near some limit of its positions
LABEL_HEIGHT = 0.05  # of a switch, share of the reach
LABEL_TIME = 0.1  # that it stands, share of the motion
FREE = "within"
SIDES = ("min", "max")


class Spell(NamedTuple):
    """A time that a joint (0-based) spends at a limit: samples ``first`` to ``last``."""

    joint: int
    quantity: str
    side: str  # "min" or "max"
    first: int
    last: int
    beyond: bool  # whether the limit is broken on the way

    @property
    def text(self) -> str:
        """Such as "torque max"."""
        name = f"{quantity_name(self.quantity)} {self.side}"
        return f"{name} exceeded" if self.beyond else name


def find_spells(limits: JointLimits, arm: AnimatedArm) -> list[Spell]:
    """Every spell of an arm at a limit of velocity, acceleration or torque, in order of time."""
    found = []
    for quantity in QUANTITIES:
        values = arm.values(quantity)
        if values is None:
            continue
        for side, bound in zip(SIDES, limits.bounds(quantity), strict=True):
            sign = 1.0 if side == "max" else -1.0
            used = np.isfinite(bound) & (sign * values >= AT_LIMIT * sign * bound)
            broken = np.isfinite(bound) & (sign * values > BEYOND * sign * bound + 1e-9)
            for joint in np.flatnonzero(used.any(axis=0)):
                edges = np.flatnonzero(np.diff(used[:, joint], prepend=False, append=False))
                for first, after in edges.reshape(-1, 2).tolist():
                    beyond = bool(broken[first:after, joint].any())
                    found.append(Spell(int(joint), quantity, side, first, after - 1, beyond))
    return sorted(found, key=lambda spell: (spell.first, spell.joint))


def torque_share(limits: JointLimits, tau: FloatArray, joint: int) -> tuple[FloatArray, np.ndarray]:
    """Shares [N] of the torque limit of a joint with the torque's sign, and whether it is met [N].

    Without a limit they are shares of the largest torque, and it is never met.
    """
    lower, upper = (float(bound[joint]) for bound in limits.bounds("tau"))
    own = np.where(tau >= 0.0, upper, -lower)
    if np.isfinite(own).all():
        share = np.divide(tau, own, out=np.sign(tau), where=own > 0.0)
        return share, np.abs(share) >= AT_LIMIT
    largest = float(np.abs(tau).max())
    share = tau / largest if largest > 0.0 else np.zeros_like(tau)
    return share, np.zeros(len(tau), dtype=bool)


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


def peak_table(
    robot: Robot, limits: JointLimits, arm: AnimatedArm
) -> tuple[list[str], list[list[str]]]:
    """Heads, and a row for every joint: an arm's peaks, % of the limits where there are any."""
    limited = [q for q in QUANTITIES if np.isfinite(limits.bounds(q)).any()]
    rows = [[name] for name in robot.joint_names]
    for quantity in limited:
        lower, upper = limits.bounds(quantity)
        values = arm.values(quantity)
        assert values is not None
        for joint, row in enumerate(rows):
            own = values[:, joint]
            share = max(_share(own.max(), upper[joint]), _share(-own.min(), -lower[joint]))
            row.append(f"{100 * share:.0f}" if share > 0.0 else "–")
    return ["joint", *(f"peak {quantity} [%]" for quantity in limited)], rows


def _share(value: float, limit: float) -> float:
    return value / limit if limit > 0.0 and np.isfinite(limit) else 0.0


class Switch(NamedTuple):
    """A sample at which a spell begins or ends."""

    sample: int
    spell: Spell
    begins: bool

    def text(self, robot: Robot) -> str:
        """Such as "elbow torque max begins"."""
        what = f"{robot.joint_names[self.spell.joint]} {self.spell.text}"
        return f"{what} {'begins' if self.begins else 'ends'}"


def _switches(spells: Iterable[Spell], count: int) -> list[Switch]:
    """Where spells begin and end within a motion of ``count`` samples, in order of time."""
    every = [Switch(spell.first, spell, True) for spell in spells if spell.first > 0]
    every += [Switch(spell.last, spell, False) for spell in spells if spell.last < count - 1]
    return sorted(every, key=lambda switch: switch.sample)


def draw_lanes(writer: Writer, robot: Robot, arm: AnimatedArm, spells: Sequence[Spell]) -> None:
    """A lane for every joint that shows at which limit it is, for the state timeline."""
    for joint in range(robot.joint_count):
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
    writer: Writer, robot: Robot, arm: AnimatedArm, spells: Sequence[Spell], tool: FloatArray
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


def draw_marks(writer: Writer, robot: Robot, arm: AnimatedArm, spells: Sequence[Spell]) -> None:
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
