"""The layout of a recording: the arms and the text to the left, the curves to the right."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import rerun.blueprint as rrb
from rerun.components import Plane3D

from microbot_ocp.robot import Robot
from microbot_ocp.views._scene import display_unit
from microbot_ocp.views.recording._limits import lane_order
from microbot_ocp.views.recording._surroundings import Eye, grid_spacing, upward
from microbot_ocp.views.recording._writer import (
    MARKS,
    SUMMARY,
    TIME,
    WHOLE,
    WORLD,
    arm_path,
    lane_path,
    plot_path,
)

if TYPE_CHECKING:
    from microbot_ocp.views.recording._recording import Recording

SHORT = 4.0  # s; what is shorter plays at half its speed
PROGRESS_TIME = 5.0  # s that the whole progress takes to play
WIDE_ROBOT = 4  # more joints than this: one tab a quantity
LANES = (0.13, 0.055)  # height of the state timeline, and of a lane, by that of the curves
MOST_LABELS = 9  # on the axis of a small plot
EDGE = 0.04  # share of an axis beyond its last label
TOOL_CURVES = {
    "tool speed [m/s]": ("speed",),
    "force in the wrist [N]": ("force",),
    "progress [%] over time; elapsed time [s] over progress": ("progress", "elapsed"),
}


def recording_blueprint(recording: Recording) -> rrb.Blueprint:
    """Ready to play on the recording's first timeline."""
    text = rrb.TextDocumentView(origin=SUMMARY, name="summary")
    space = _arms_view(recording)
    if recording.quantities:
        marks = text_lines_view("marks and switches")
        below = rrb.Horizontal(text, marks, column_shares=[1.6, 1.0])
        left = rrb.Vertical(space, below, row_shares=[2.4, 1.0])
        whole = rrb.Horizontal(left, _right(recording), column_shares=[1.15, 1.0])
    else:
        whole = rrb.Horizontal(space, text, column_shares=[1.4, 1.0])
    last = float(max(recording.end.get(recording.timeline, [0.0])))
    return playing(whole, recording.timeline, last)


def playing(whole: rrb.Container, timeline: str, last: float) -> rrb.Blueprint:
    """A layout that plays a timeline, which ends at ``last``, over and over."""
    timed = timeline == TIME
    return folded(
        whole,
        timeline=timeline,
        play_state="playing",
        loop_mode="all",
        playback_speed=0.5 if timed and last < SHORT else 1.0,
        fps=WHOLE / PROGRESS_TIME if timed else 1.0,  # of counted timelines
    )


def folded(whole: rrb.Container, **time: Any) -> rrb.Blueprint:
    """A layout with the viewer's own panels folded away; ``time`` goes to its time panel."""
    return rrb.Blueprint(
        whole,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", **time),
    )


def plot_view(name: str, **settings: Any) -> rrb.TimeSeriesView:
    """Curves without a legend: the arms' labels show the colours."""
    return rrb.TimeSeriesView(name=name, plot_legend=rrb.PlotLegend(visible=False), **settings)


def text_lines_view(name: str) -> rrb.TextLogView:
    """Lines of text along the timeline."""
    columns = rrb.TextLogColumns(text_log_columns=["Body"])
    return rrb.TextLogView(origin=MARKS, name=name, columns=columns)


def space_view(robot: Robot, eye: Eye, overrides: dict[Any, Any]) -> rrb.Spatial3DView:
    """Everything in space, seen from ``eye``."""
    spacing, plane = grid_spacing(robot), Plane3D(upward(robot))
    return rrb.Spatial3DView(
        origin=WORLD,
        name=robot.name,
        line_grid=rrb.LineGrid3D(visible=True, spacing=spacing, plane=plane),
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital, position=eye.position, look_target=eye.target, eye_up=eye.up
        ),
        overrides=overrides,
    )


def _arms_view(recording: Recording) -> rrb.Spatial3DView:
    to_cursor = rrb.VisibleTimeRanges(
        [
            rrb.VisibleTimeRange(
                timeline,
                start=rrb.TimeRangeBoundary.infinite(),
                end=rrb.TimeRangeBoundary.cursor_relative(),
            )
            for timeline in recording.timelines
        ]
    )
    overrides: dict[str, Any] = {
        arm_path(arm.name, leaf): to_cursor
        for arm in recording.arms
        for leaf in ("trail", "switches")
    }
    for path in recording.hidden:
        overrides[path] = rrb.EntityBehavior(visible=False)
    return space_view(recording.robot, recording.eye, overrides)


def _right(recording: Recording) -> rrb.Container:
    robot = recording.robot
    rows = {
        quantity: [_joint_view(recording, quantity, j) for j in range(robot.joint_count)]
        for quantity in recording.quantities
    }
    if robot.joint_count > WIDE_ROBOT:
        tabs: list[rrb.Container] = [
            rrb.Grid(*views, grid_columns=2, name=quantity) for quantity, views in rows.items()
        ]
    else:
        every = [view for views in rows.values() for view in views]
        tabs = [rrb.Grid(*every, grid_columns=robot.joint_count, name="joints")]
    if recording.limit_plots:
        further = [
            plot_view(plot.title, origin=plot_path(plot.key, plot.label))
            for plot in recording.limit_plots
        ]
        tabs.append(rrb.Grid(*further, grid_columns=2, name="further limits"))
    if recording.timeline == TIME:
        tool = [
            plot_view(name, contents=[f"{plot_path(quantity)}/**" for quantity in quantities])
            for name, quantities in TOOL_CURVES.items()
        ]
        tabs.append(rrb.Vertical(*tool, name="tool and progress"))
    curves = rrb.Tabs(*tabs, active_tab=0)
    solid = next((arm for arm in recording.arms if arm.look.solid), None)
    if solid is None or not recording.spells.get(solid.name):
        return curves
    met = sorted({spell.joint for spell in recording.spells[solid.name]}, key=lane_order)
    lanes = rrb.StateTimelineView(
        contents=[lane_path(robot, solid.name, joint) for joint in met],
        name=f"limits met: {solid.title}" if solid.title else "limits met",
    )
    return rrb.Vertical(curves, lanes, row_shares=[1.0, LANES[0] + LANES[1] * len(met)])


def _joint_view(recording: Recording, quantity: str, joint: int) -> rrb.TimeSeriesView:
    robot = recording.robot
    name, unit = robot.joint_names[joint], display_unit(robot, quantity, joint)
    limits = recording.axis_limits[quantity, joint]
    far = ""
    if limits.far and robot.joint_count > WIDE_ROBOT:  # two columns have room for it
        far = f", {limits.far.removesuffix(unit).strip()}"
    return plot_view(
        f"{name} {quantity} [{unit}]{far}",
        origin=plot_path(quantity, name),
        axis_y=rrb.ScalarAxis(range=labelled_range(*limits.axis)),
    )


def labelled_range(low: float, high: float) -> tuple[float, float]:
    """The range of an axis, widened where Rerun would label fewer than two of its values.

    Rerun labels the multiples of a power of ten, the finest one that leaves room for its labels.
    """
    step = 10.0 ** np.floor(np.log10(high - low))
    if (high - low) / step > MOST_LABELS:
        step *= 10.0
    first, last = step * np.ceil(low / step), step * np.floor(high / step)
    margin = EDGE * (high - low)
    if last > first + step / 2:
        return low, high
    if last < first - step / 2:  # none
        return last - margin, first + margin
    if low - (first - step) < 0.99 * (last + step - high):
        return first - step - margin, high
    return low, last + step + margin
