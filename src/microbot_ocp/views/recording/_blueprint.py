"""The layout of a recording: the arms and the text to the left, the curves to the right."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import rerun.blueprint as rrb
from rerun.components import Plane3D

from microbot_ocp.robot import Robot
from microbot_ocp.views._eye import Eye, grid_spacing, upward
from microbot_ocp.views._scene import display_unit
from microbot_ocp.views._style import STYLE
from microbot_ocp.views.recording._limits import lane_order, lane_path
from microbot_ocp.views.recording._writer import MARKS, SUMMARY, TIME, WORLD, plot_path

if TYPE_CHECKING:
    from microbot_ocp.views.recording._recording import Recording

TOOL_CURVES = {
    "tool speed [m/s]": ("speed",),
    "force in the wrist [N]": ("force",),
    "progress [%] over time; elapsed time [s] over progress": ("progress", "elapsed"),
}


def recording_blueprint(recording: Recording) -> rrb.Blueprint:
    """Return the layout, ready to play on the recording's first timeline."""
    text, space = text_view(), _arms_view(recording)
    if recording.quantities:
        below = rrb.Horizontal(text, marks_view("marks and switches"), column_shares=[1.6, 1.0])
        left = rrb.Vertical(space, below, row_shares=[2.4, 1.0])
        whole = rrb.Horizontal(left, _right(recording), column_shares=[1.15, 1.0])
    else:
        whole = rrb.Horizontal(space, text, column_shares=[1.4, 1.0])
    last = float(max(recording.end.get(recording.timeline, [0.0])))
    return playing(whole, recording.timeline, last)


def playing(whole: rrb.Container, timeline: str, last: float) -> rrb.Blueprint:
    """Return a layout that plays a timeline, which ends at ``last``, over and over.

    What is shorter than 4 s plays at half its speed; the whole progress takes 5 s.
    """
    timed = timeline == TIME
    speed = 0.5 if timed and last < 4.0 else 1.0
    frames = 200.0 if timed else 1.0  # a second, of counted timelines
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
    """Return curves without a legend: the arms' labels show the colours."""
    return rrb.TimeSeriesView(name=name, plot_legend=rrb.PlotLegend(visible=False), **settings)


def text_view() -> rrb.TextDocumentView:
    """Return the summary."""
    return rrb.TextDocumentView(origin=SUMMARY, name="summary")


def marks_view(name: str) -> rrb.TextLogView:
    """Return lines of text along the timeline."""
    columns = rrb.TextLogColumns(text_log_columns=["Body"])
    return rrb.TextLogView(origin=MARKS, name=name, columns=columns)


def space_view(robot: Robot, eye: Eye, overrides: dict[Any, Any]) -> rrb.Spatial3DView:
    """Return everything in space, seen from ``eye``."""
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
    """Return the viewer's eye."""
    place, kind = eye.position, rrb.Eye3DKind.Orbital
    return rrb.EyeControls3D(kind=kind, position=place, look_target=eye.target, eye_up=eye.up)


def behind_cursor(timeline: str, count: int | None = None) -> rrb.VisibleTimeRange:
    """Return the last so many rows up to the time cursor, or all."""
    bound = rrb.TimeRangeBoundary
    start = bound.infinite() if count is None else bound.cursor_relative(seq=-count)
    return rrb.VisibleTimeRange(timeline, start=start, end=bound.cursor_relative())


def _arms_view(recording: Recording) -> rrb.Spatial3DView:
    to_cursor = rrb.VisibleTimeRanges([behind_cursor(timeline) for timeline in recording.end])
    overrides: dict[str, Any] = {
        arm.path(leaf): to_cursor for arm in recording.arms for leaf in ("trail", "switches")
    }
    overrides |= {path: rrb.EntityBehavior(visible=False) for path in recording.hidden}
    return space_view(recording.robot, recording.eye, overrides)


def _right(recording: Recording) -> rrb.Container:
    robot = recording.robot
    rows = {
        quantity: [_joint_view(recording, quantity, j) for j in range(robot.joint_count)]
        for quantity in recording.quantities
    }
    tabs: list[rrb.Container]
    if robot.joint_count > STYLE.side_by_side:
        tabs = [rrb.Grid(*views, grid_columns=2, name=quantity) for quantity, views in rows.items()]
    else:
        every = [view for views in rows.values() for view in views]
        tabs = [rrb.Grid(*every, grid_columns=robot.joint_count, name="joints")]
    further = [plot_view(plot.title, origin=plot.path) for plot in recording.limit_plots]
    if further:
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
    return rrb.Vertical(curves, lanes, row_shares=[1.0, 0.13 + 0.055 * len(met)])


def _joint_view(recording: Recording, quantity: str, joint: int) -> rrb.TimeSeriesView:
    robot, limits = recording.robot, recording.axis_limits[quantity, joint]
    name, unit = robot.joint_names[joint], display_unit(robot, quantity, joint)
    far = ""
    if limits.far and robot.joint_count > STYLE.side_by_side:  # two columns have room for it
        far = f", {limits.far.removesuffix(unit).strip()}"
    return plot_view(
        f"{name} {quantity} [{unit}]{far}",
        origin=plot_path(quantity, name),
        axis_y=rrb.ScalarAxis(range=labelled_range(*limits.axis)),
    )


def labelled_range(low: float, high: float) -> tuple[float, float]:
    """Return the range of an axis, widened where Rerun would label fewer than two of its values.

    Rerun labels the multiples of a power of ten, the finest one that leaves room for its labels,
    which are nine on a small plot.
    """
    step = 10.0 ** np.floor(np.log10(high - low))
    if (high - low) / step > 9:
        step *= 10.0
    first, last = step * np.ceil(low / step), step * np.floor(high / step)
    margin = 0.04 * (high - low)
    if last > first + step / 2:
        return low, high
    if last < first - step / 2:  # none
        return last - margin, first + margin
    if low - (first - step) < 0.99 * (last + step - high):
        return first - step - margin, high
    return low, last + step + margin
