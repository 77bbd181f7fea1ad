"""Limits along a motion in a recording.

Intervals at a limit (spells) are drawn as lanes of the state timeline, points on the trail and
lines of text.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import rerun as rr

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.limits import AT_LIMIT, LIMIT_TOLERANCE, LimitValues, Member, quantity_name
from microbot_ocp.motion import Mark
from microbot_ocp.robot import JointLimits, Robot
from microbot_ocp.views import _palette as palette
from microbot_ocp.views._eye import upward
from microbot_ocp.views._scene import SIDES, limit_text, reach, tool_places
from microbot_ocp.views._style import LABEL_HEIGHT, Color
from microbot_ocp.views.recording._animated_arm import AnimatedArm
from microbot_ocp.views.recording._writer import MARKS, TIME, Times, Writer, plot_path

JOINT_CURVES = ("q", "qd", "qdd", "tau")  # quantities that are drawn for every motion
QUANTITIES = ("qd", "qdd", "tau")  # columns of the table of peaks
FREE = "within"


class LimitSpell(NamedTuple):
    """Interval at a limit: samples ``first`` to ``last``."""

    joint: int | None  # 0-based; None for a limit of the arm
    title: str  # such as "torque of elbow" or "tool speed"
    text: str  # such as "torque at its upper limit" or "tool speed beyond its upper limit"
    first: int
    last: int
    side: int  # 1 upper, -1 lower limit
    exceeded: bool


def limit_spells(arm: AnimatedArm) -> list[LimitSpell]:
    """Return the spells of an arm at all limits except position limits, in order of time."""
    if arm.history is None:
        return []
    spells = []
    for spell in arm.history.every_spell():
        member, k = arm.history.family[spell.quantity], spell.joint
        first, last = np.searchsorted(arm.history.t, [spell.start, spell.end]).tolist()
        peak = arm.history.use[spell.quantity][first : last + 1, k].max()
        joint, title = (k if member.limit is None else None), member.title(k)
        exceeded = bool(peak > 1.0 + LIMIT_TOLERANCE)
        # The lane of a joint has its name, so the text of a lane does not repeat it.
        text = limit_text(title if joint is None else member.name, spell.side, exceeded)
        spells.append(LimitSpell(joint, title, text, first, last, spell.side, exceeded))
    return sorted(spells, key=lambda spell: (spell.first, spell.joint is None, spell.joint or 0))


def lane_path(robot: Robot, name: str, joint: int | None) -> str:
    """Return the path of the lane of a joint (0-based), or of the limits of the arm (None).

    The viewer sorts lanes by their paths.
    """
    digits, number = len(str(robot.joint_count)), robot.joint_count if joint is None else joint
    label = [*robot.joint_names, "other"][number].replace(" ", "_")
    return rr.new_entity_path(["saturation", name, f"{number + 1:0{digits}d}_{label}"])


class LimitPlot(NamedTuple):
    """Plot of one component of a further limit."""

    path: str  # entity path of the curves
    title: str


def _further(arm: AnimatedArm) -> list[tuple[LimitPlot, int, Member, LimitValues]]:
    """Return the components of all limits except position, velocity, acceleration and torque."""
    if arm.history is None:
        return []
    rows = []
    for key, values in arm.history.limited.items():
        member = arm.history.family[key]
        for k in np.flatnonzero(member.limited).tolist() if key not in JOINT_CURVES else ():
            unit = f" [{member.units[k]}]" if member.units[k] else ""
            path = plot_path(key, member.labels[k] or "value")
            rows.append((LimitPlot(path, f"{member.title(k)}{unit}"), k, member, values))
    return rows


def limit_plots(arms: Sequence[AnimatedArm]) -> list[LimitPlot]:
    """Return the plots of the further limits that at least one arm has values of."""
    return list(dict.fromkeys(plot for arm in arms for plot, *_ in _further(arm)))


def draw_limit_curves(writer: Writer, arm: AnimatedArm, end: Times) -> None:
    """Draw the values of the further limits along the motion, with bounds for the solid arm."""
    for plot, k, _, values in _further(arm):
        arm.draw_curve(writer, plot.path, values.value[:, k])
        for side in ("lower", "upper") if arm.look.solid else ():
            bound = np.broadcast_to(getattr(values, side), values.value.shape)[:, k]
            path = f"{plot.path}/limit_{side}"
            if np.isfinite(bound).any() and np.ptp(bound) > 0.0:
                writer.curve(path, arm.times, bound)
            elif np.isfinite(bound).any():
                writer.level(path, float(bound[0]), end)


def limit_notes(arm: AnimatedArm) -> list[str]:
    """Return a sentence on the peak of every further limit."""
    notes = []
    for member, drawn in {m.key: (m, values) for _, _, m, values in _further(arm)}.values():
        assert arm.history is not None
        t, values, use = arm.history.judged(member.key)
        i, k = np.unravel_index(int(use.argmax()), use.shape)
        bound = member.nearest_bound(values)[i, k]
        title = member.title(int(k))
        asks = f"at most {100 * use[i, k]:.0f} % of its limit of"
        if i >= len(drawn.value) and use[i, k] > 1.0:
            asks = "the acceleration jumps, beyond its limit of"
        value = f"{bound:.4g} {member.units[k]}".rstrip()
        notes.append(f"{title[0].upper()}{title[1:]}: {asks} {value}, at {t[i]:.3f} s.")
    return notes


def signed_share(
    limits: JointLimits, quantity: str, values: FloatArray, joint: int
) -> tuple[FloatArray, np.ndarray]:
    """Return signed shares [N] of a joint's limit, and a mask [N] of the samples at the limit.

    Without a limit the shares are relative to the largest value, and no sample is at the limit.
    """
    lower, upper = (float(bound[joint]) for bound in limits.bounds(quantity))
    bound = np.where(values >= 0.0, upper, -lower)
    if np.isfinite(bound).all():
        share = np.divide(values, bound, out=np.sign(values), where=bound > 0.0)
        return share, np.abs(share) >= AT_LIMIT
    largest = float(np.abs(values).max())
    share = values / largest if largest > 0.0 else np.zeros_like(values)
    return share, np.zeros(len(values), dtype=bool)


def peak_table(arm: AnimatedArm) -> tuple[list[str], list[list[str]]]:
    """Return heads and rows of the table of an arm's peaks by joint, in % of the limits."""
    assert arm.history is not None
    use = {key: arm.history.use[key].max(axis=0) for key in QUANTITIES if key in arm.history.use}
    rows = [
        [name, *(f"{100 * peaks[k]:.0f}" if peaks[k] > 0.0 else "–" for peaks in use.values())]
        for k, name in enumerate(arm.history.family.robot.joint_names)
    ]
    return ["joint", *(f"peak {key} [%]" for key in use)], rows


class LimitSwitch(NamedTuple):
    """Begin or end of a spell, such as "torque of elbow reaches its upper limit"."""

    sample: int
    text: str
    begins: bool


def _switches(spells: Sequence[LimitSpell], count: int) -> list[LimitSwitch]:
    """Return the begins and ends of spells within a motion of ``count`` samples, sorted by time."""
    every = []
    for spell in spells:
        limit, verb = f"its {SIDES[spell.side]}limit", "exceeds" if spell.exceeded else "reaches"
        if spell.first > 0:
            every.append(LimitSwitch(spell.first, f"{spell.title} {verb} {limit}", True))
        if spell.last < count - 1:
            every.append(LimitSwitch(spell.last, f"{spell.title} leaves {limit}", False))
    return sorted(every, key=lambda switch: switch.sample)


def draw_spells(
    writer: Writer, robot: Robot, arm: AnimatedArm, spells: Sequence[LimitSpell]
) -> None:
    """Draw spells at limits as lanes, points on the trail, and lines of text."""
    switches = _switches(spells, len(arm.q))
    _draw_lanes(writer, robot, arm, spells)
    _draw_switches(writer, robot, arm, switches)
    _draw_marks(writer, arm, switches)


def _draw_lanes(
    writer: Writer, robot: Robot, arm: AnimatedArm, spells: Sequence[LimitSpell]
) -> None:
    """Draw one lane per joint on the state timeline with the limits that the joint is at.

    One more lane shows the limits of the arm, if one of them is met.
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
        path, values = lane_path(robot, arm.name, joint), sorted(set(states))
        colors, visible = map(_lane_color, values), [state != FREE for state in values]
        look = rr.StateConfiguration(values=values, colors=list(colors), visible=visible)
        writer.static(path, look)
        columns = rr.StateChange.columns(state=list(states[change]))
        writer.columns(path, arm.at(change), columns)


def _lane_color(state: str) -> Color:
    if "beyond" in state:
        return palette.BROKEN
    return palette.SATURATED if quantity_name("tau") in state else palette.SPEED


def _draw_switches(
    writer: Writer, robot: Robot, arm: AnimatedArm, switches: Sequence[LimitSwitch]
) -> None:
    """Draw a point on the trail at every sample at which a limit is reached or left."""
    if not switches:
        return
    at = np.array([switch.sample for switch in switches])
    colors = [palette.SATURATED if switch.begins else palette.BRIGHT for switch in switches]
    path, places = arm.path("switches"), tool_places(robot, arm.q[at])
    writer.static(path, rr.Points3D.from_fields(radii=[0.5 * arm.look.radius]))
    points = rr.Points3D.columns(positions=places, colors=colors)
    writer.columns(path, arm.at(at), points)
    # Only one label at a time, because labels overlap: until the next one or a tenth of the motion.
    tiny = rr.Points3D.from_fields(radii=[0.0], show_labels=True)
    writer.static(f"{path}/latest", tiny)
    above = places + LABEL_HEIGHT * reach(robot) * upward(robot)
    labels = [switch.text for switch in switches]
    labelled = rr.Points3D.columns(positions=above, colors=colors, labels=labels)
    writer.columns(f"{path}/latest", arm.at(at), labelled)
    gone = at + len(arm.q) // 10
    gone = gone[gone < np.append(at[1:], len(arm.q))]
    if gone.size:
        nothing = rr.Points3D.columns(positions=np.zeros((0, 3)), labels=[])
        empty = [column.partition(np.zeros(len(gone), dtype=int)) for column in nothing]
        writer.columns(f"{path}/latest", arm.at(gone), empty)


def _draw_marks(writer: Writer, arm: AnimatedArm, switches: Sequence[LimitSwitch]) -> None:
    """Write a line of text for every mark and switch, with the title of the arm if it has one."""
    clock = arm.times[TIME]
    marks = [*arm.marks, *(Mark(float(clock[s.sample]), s.text) for s in switches)]
    if not marks:
        return
    marks.sort(key=lambda mark: mark.time)
    columns = rr.TextLog.columns(
        text=[f"{mark.name}: {arm.title}" if arm.title else mark.name for mark in marks],
        level=["INFO"] * len(marks),
        color=[arm.look.line_color] * len(marks),
    )
    t = np.array([mark.time for mark in marks])
    times: Times = {
        key: t if key == TIME else np.rint(np.interp(t, clock, value))
        for key, value in arm.times.items()
    }
    writer.columns(f"{MARKS}/{arm.name}", times, columns)
