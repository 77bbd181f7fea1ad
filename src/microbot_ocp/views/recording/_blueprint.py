"""Parts of the layouts of recordings: views, viewpoint, playback."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun.blueprint as rrb
from rerun.components import Plane3D

from microbot_ocp.robot import Robot
from microbot_ocp.views._eye import Eye, grid_spacing, upward
from microbot_ocp.views._scene import AXIS_MARGIN
from microbot_ocp.views.recording._writer import MARKS, SUMMARY, TIME, WORLD


def playing(whole: rrb.Container, timeline: str, last: float) -> rrb.Blueprint:
    """Return a layout that plays a timeline, which ends at ``last``, in a loop.

    Motions shorter than 4 s play at half speed; the progress timeline takes 5 s.
    """
    timed = timeline == TIME
    speed = 0.5 if timed and last < 4.0 else 1.0
    frames = 200.0 if timed else 1.0  # integers per second on the other timelines
    return folded(
        whole,
        timeline=timeline,
        play_state="playing",
        loop_mode="all",
        playback_speed=speed,
        fps=frames,
    )


def folded(whole: rrb.Container, **time: Any) -> rrb.Blueprint:
    """Return a layout with the viewer's panels folded away; ``time`` goes to its time panel."""
    return rrb.Blueprint(
        whole,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", **time),
    )


def plot_view(name: str, **settings: Any) -> rrb.TimeSeriesView:
    """Return a view of curves without a legend, because the arms' labels show the colours."""
    return rrb.TimeSeriesView(name=name, plot_legend=rrb.PlotLegend(visible=False), **settings)


def text_view() -> rrb.TextDocumentView:
    """Return the view of the summary."""
    return rrb.TextDocumentView(origin=SUMMARY, name="summary")


def marks_view(name: str) -> rrb.TextLogView:
    """Return a view of the lines of text along the timeline."""
    columns = rrb.TextLogColumns(text_log_columns=["Body"])
    return rrb.TextLogView(origin=MARKS, name=name, columns=columns)


def space_view(robot: Robot, eye: Eye, overrides: dict[Any, Any]) -> rrb.Spatial3DView:
    """Return the view of all entities in space, seen from ``eye``."""
    return rrb.Spatial3DView(
        origin=WORLD,
        name=robot.name,
        line_grid=rrb.LineGrid3D(
            visible=True, spacing=grid_spacing(robot), plane=Plane3D(upward(robot))
        ),
        eye_controls=eye_controls(eye),
        overrides=overrides,
    )


def eye_controls(eye: Eye) -> rrb.EyeControls3D:
    """Return the viewpoint as the viewer's controls."""
    place, kind = eye.position, rrb.Eye3DKind.Orbital
    return rrb.EyeControls3D(kind=kind, position=place, look_target=eye.target, eye_up=eye.up)


def behind_cursor(timeline: str, count: int | None = None) -> rrb.VisibleTimeRange:
    """Return the range of the last ``count`` rows (default all) up to the time cursor."""
    bound = rrb.TimeRangeBoundary
    start = bound.infinite() if count is None else bound.cursor_relative(seq=-count)
    return rrb.VisibleTimeRange(timeline, start=start, end=bound.cursor_relative())


def labelled_range(low: float, high: float) -> tuple[float, float]:
    """Return the range of an axis, widened until Rerun labels at least two values.

    Rerun labels multiples of a power of ten, of which at most nine fit on a small plot.
    """
    step = 10.0 ** np.floor(np.log10(high - low))
    if (high - low) / step > 9:
        step *= 10.0
    first, last = step * np.ceil(low / step), step * np.floor(high / step)
    margin = AXIS_MARGIN * (high - low)
    if last > first + step / 2:
        return low, high
    if last < first - step / 2:  # no multiple lies in the range
        return last - margin, first + margin
    if low - (first - step) < last + step - high:
        return first - step - margin, high
    return low, last + step + margin
