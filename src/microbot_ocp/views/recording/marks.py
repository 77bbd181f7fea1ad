"""Named instants of a motion as lines of text."""

from __future__ import annotations

import numpy as np
import rerun as rr

from microbot_ocp.views.recording import entities
from microbot_ocp.views.recording.actors import Actor
from microbot_ocp.views.recording.writer import Times, Writer


def draw(writer: Writer, actor: Actor) -> None:
    """One line of text for every mark."""
    marks = sorted(actor.marks, key=lambda mark: mark.time)
    if not marks:
        return
    columns = rr.TextLog.columns(
        text=[f"{mark.name}: {actor.title}" for mark in marks],
        level=["INFO"] * len(marks),
        color=[actor.look.line_color] * len(marks),
    )
    times = at(actor.times, np.array([mark.time for mark in marks]))
    writer.columns(entities.marks(actor.name), times, columns)


def at(times: Times, t: np.ndarray) -> Times:
    """What every timeline says at times t [N], s."""
    clock = times[entities.TIME]
    return {key: t if key == entities.TIME else np.rint(np.interp(t, clock, value))
            for key, value in times.items()}  # fmt: skip
