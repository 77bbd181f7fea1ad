"""Where limits are met: spells at a limit, and the switches at which they begin and end."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import rerun as rr

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.limits import QUANTITY_NAMES, SATURATED
from microbot_ocp.robot import JointLimits, Robot
from microbot_ocp.views import _scene as scene
from microbot_ocp.views.recording import _camera as camera, _paths as entities
from microbot_ocp.views.recording._animated_arm import Actor
from microbot_ocp.views.recording._palette import (
    BEYOND_COLOR,
    SATURATED_COLOR,
    SPEED_COLOR,
    VIA_COLOR,
    Color,
)
from microbot_ocp.views.recording._writer import Times, Writer

BEYOND = 1.005  # share of a limit from which on it counts as broken, as certificates have it
QUANTITIES = ("qd", "qdd", "tau")  # every motion comes near some limit of its positions
LABEL_HEIGHT = 0.05  # of a switch, share of the reach
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
        """Such as "torque max", the lane's and the marks' word for it."""
        name = f"{QUANTITY_NAMES[self.quantity]} {self.side}"
        return f"{name} exceeded" if self.beyond else name


def spells(limits: JointLimits, actor: Actor) -> list[Spell]:
    """Every spell of an actor at a limit of velocity, acceleration or torque."""
    found = []
    for quantity in QUANTITIES:
        if quantity != "qdd" and quantity not in actor.curves:
            continue
        values = actor.values(quantity)
        for side, bound in zip(SIDES, limits.bounds(quantity), strict=True):
            sign = 1.0 if side == "max" else -1.0
            used = np.isfinite(bound) & (sign * values >= SATURATED * sign * bound)
            broken = np.isfinite(bound) & (sign * values > BEYOND * sign * bound + 1e-9)
            for joint in np.flatnonzero(used.any(axis=0)):
                for first, last in _runs(used[:, joint]):
                    beyond = bool(broken[first : last + 1, joint].any())
                    found.append(Spell(int(joint), quantity, side, first, last, beyond))
    return sorted(found, key=lambda spell: (spell.first, spell.joint))


class Switch(NamedTuple):
    """A sample at which a spell begins or ends."""

    sample: int
    spell: Spell
    begins: bool

    def text(self, robot: Robot) -> str:
        """Such as "elbow torque max begins"."""
        what = f"{robot.joint_names[self.spell.joint]} {self.spell.text}"
        return f"{what} {'begins' if self.begins else 'ends'}"


def switches(found: Iterable[Spell], count: int) -> list[Switch]:
    """Where spells begin and end within a motion of ``count`` samples, in order of time."""
    every = [Switch(spell.first, spell, True) for spell in found if spell.first > 0]
    every += [Switch(spell.last, spell, False) for spell in found if spell.last < count - 1]
    return sorted(every, key=lambda switch: switch.sample)


def _runs(flags: np.ndarray) -> Iterable[tuple[int, int]]:
    """First and last index of every stretch that is true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    return [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def lane(robot: Robot, name: str, joint: int) -> str:
    """Entity of the lane of a joint (0-based); lanes stand in the order of their paths."""
    digits = len(str(robot.joint_count))
    label = robot.joint_names[joint].replace(" ", "_")
    return entities.saturation(name, f"{joint + 1:0{digits}d}_{label}")


def draw_lanes(writer: Writer, robot: Robot, actor: Actor, found: list[Spell]) -> None:
    """A lane for every joint that shows at which limit it is, for the state timeline."""
    count = len(actor.q)
    for joint in range(robot.joint_count):
        words = np.full(count, "", dtype=object)
        for spell in found:
            if spell.joint != joint:
                continue
            span = slice(spell.first, spell.last + 1)
            words[span] = [f"{word} + {spell.text}" if word else spell.text for word in words[span]]
        words[words == ""] = FREE
        words[-1] = FREE  # the lane ends where the motion does
        change = np.flatnonzero(np.append(True, words[1:] != words[:-1]))
        path = lane(robot, actor.name, joint)
        told = sorted(set(words))
        colors = [_lane_color(word) for word in told]
        visible = [word != FREE for word in told]
        writer.static(path, rr.StateConfiguration(values=told, colors=colors, visible=visible))
        times = {key: value[change] for key, value in actor.times.items()}
        writer.columns(path, times, rr.StateChange.columns(state=list(words[change])))


def _lane_color(word: str) -> Color:
    if "exceeded" in word:
        return BEYOND_COLOR
    return SATURATED_COLOR if QUANTITY_NAMES["tau"] in word else SPEED_COLOR


def draw_switches(
    writer: Writer, robot: Robot, actor: Actor, found: list[Spell], tool: FloatArray
) -> None:
    """A point on the trail wherever a limit is reached or left; ``tool`` [N,3] is the trail."""
    events = switches(found, len(actor.q))
    if not events:
        return
    at = np.array([event.sample for event in events])
    colors = [SATURATED_COLOR if event.begins else VIA_COLOR for event in events]
    path = entities.switches(actor.name)
    times: Times = {key: value[at] for key, value in actor.times.items()}
    writer.static(path, rr.Points3D.from_fields(radii=[0.5 * actor.look.radius]))
    writer.columns(path, times, rr.Points3D.columns(positions=tool[at], colors=colors))
    # all labels at once would hide each other: the latest one stands until the next
    words = [event.text(robot) for event in events]
    tiny = rr.Points3D.from_fields(radii=[1e-3 * actor.look.radius], show_labels=True)
    writer.static(entities.switches(actor.name, "latest"), tiny)
    above = tool[at] + LABEL_HEIGHT * scene.reach(robot) * camera.upward(robot)
    labelled = rr.Points3D.columns(positions=above, colors=colors, labels=words)
    writer.columns(entities.switches(actor.name, "latest"), times, labelled)
