"""Named instants of a motion, and its switches, as lines of text."""

from __future__ import annotations

import numpy as np
import rerun as rr

from microbot_ocp.robot import Robot
from microbot_ocp.views.recording import _paths as entities
from microbot_ocp.views.recording._animated_arm import Actor
from microbot_ocp.views.recording._saturation import Spell, switches
from microbot_ocp.views.recording._writer import Times, Writer


def draw(writer: Writer, robot: Robot, actor: Actor, found: list[Spell]) -> None:
    """A line of text for every mark and every switch; whose it is, if there are several."""
    clock = actor.times[entities.TIME]
    lines = [(mark.time, mark.name) for mark in actor.marks]
    for switch in switches(found, len(actor.q)):
        lines.append((float(clock[switch.sample]), switch.text(robot)))
    if not lines:
        return
    lines.sort(key=lambda line: line[0])
    columns = rr.TextLog.columns(
        text=[f"{text}: {actor.title}" if actor.title else text for _, text in lines],
        level=["INFO"] * len(lines),
        color=[actor.look.line_color] * len(lines),
    )
    times = at(actor.times, np.array([time for time, _ in lines]))
    writer.columns(entities.marks(actor.name), times, columns)


def at(times: Times, t: np.ndarray) -> Times:
    """What every timeline says at times t [N], s."""
    clock = times[entities.TIME]
    others = {key: value for key, value in times.items() if key != entities.TIME}
    return {
        entities.TIME: t,
        **{key: np.rint(np.interp(t, clock, value)) for key, value in others.items()},
    }
