"""Curves of every joint with its limits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import rerun as rr

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.robot import JointLimits, Robot
from microbot_ocp.views import _scene as scene
from microbot_ocp.views.recording import _paths as entities
from microbot_ocp.views.recording._animated_arm import Actor
from microbot_ocp.views.recording._palette import LIMIT_COLOR
from microbot_ocp.views.recording._writer import Times, Writer

DASHES = 40  # of a limit's line, over the whole timeline


def draw(writer: Writer, robot: Robot, actor: Actor) -> None:
    """Every quantity of every joint over the time."""
    look = _look(actor)
    for quantity, values in actor.curves.items():
        for joint in range(robot.joint_count):
            path = entities.curve(robot, quantity, joint, actor.name)
            writer.static(path, look)
            shown = values[:, joint] * scene.display_factor(robot, quantity, joint)
            writer.columns(path, actor.times, rr.Scalars.columns(scalars=shown))


def _look(actor: Actor) -> rr.SeriesLines:
    return rr.SeriesLines.from_fields(
        names=[actor.title or actor.name],
        colors=[actor.look.line_color],
        widths=[2.5 if actor.look.solid else 1.6],
    )


def draw_tool(writer: Writer, actor: Actor, quantity: str, values: FloatArray) -> None:
    """A quantity [N] of the tool over the time."""
    path = entities.tool_curve(quantity, actor.name)
    writer.static(path, _look(actor))
    writer.columns(path, actor.times, rr.Scalars.columns(scalars=values))


def draw_progress(writer: Writer, actor: Actor) -> None:
    """How far the arm is over the time, %, and the time over how far it is, s."""
    for quantity, over, factor, of in (
        ("progress", entities.TIME, 100.0 / entities.WHOLE, entities.PROGRESS),
        ("elapsed", entities.PROGRESS, 1.0, entities.TIME),
    ):
        path = entities.tool_curve(quantity, actor.name)
        writer.static(path, _look(actor))
        scalars = rr.Scalars.columns(scalars=factor * actor.times[of])
        writer.columns(path, {over: actor.times[over]}, scalars)


def near_limits(
    robot: Robot, limits: JointLimits, actors: tuple[Actor, ...], quantity: str, joint: int
) -> scene.AxisLimits:
    """Limits near enough to the curves of all actors to be drawn beside them."""
    values = [actor.curves[quantity][:, joint] for actor in actors if quantity in actor.curves]
    joined = np.concatenate(values) if values else np.zeros(0)
    return scene.near_limits(robot, limits, quantity, joint, joined)


def draw_limits(
    writer: Writer, robot: Robot, quantity: str, joint: int, limits: scene.AxisLimits, end: Times
) -> None:
    """Dashed lines over all timelines."""
    whole = {key: (0.0, float(value[0])) for key, value in end.items()}
    for leaf, value in (("limit_lower", limits.lower), ("limit_upper", limits.upper)):
        if value is not None:
            path = entities.curve(robot, quantity, joint, leaf)
            dashed(writer, path, [(whole, value)])


def dashed(
    writer: Writer, path: str, spans: Sequence[tuple[Mapping[str, tuple[float, float]], float]]
) -> None:
    """Dashes at a value from begin to end on every timeline, for each span.

    Rows without a value interrupt the line.
    """
    spans = [span for span in spans if all(begin < end for begin, end in span[0].values())]
    if not spans:
        return
    gap = 1e-6  # share of the span after a dash, where the row without a value is
    edges = np.linspace(0.0, 1.0 - gap, 2 * DASHES)
    share = np.column_stack([edges[::2], edges[1::2], edges[1::2] + gap]).ravel()
    times = {
        key: np.concatenate([span[key][0] + np.diff(span[key]) * share for span, _ in spans])
        for key in spans[0][0]
    }
    look = rr.SeriesLines.from_fields(names=["limit"], colors=[LIMIT_COLOR], widths=[1.2])
    writer.static(path, look)
    values = np.repeat([value for _, value in spans], 2 * DASHES)
    lengths = np.tile([1, 1, 0], DASHES * len(spans))
    writer.columns(path, times, rr.Scalars.columns(scalars=values).partition(lengths=lengths))
