"""The layout of every recording: the arms and the words to the left, the curves to the right."""

from __future__ import annotations

from typing import TYPE_CHECKING

import rerun.blueprint as rrb
from rerun.components import Plane3D

from microbot_ocp.views import _scene as scene
from microbot_ocp.views.recording import (
    _camera as camera,
    _paths as entities,
    _saturation as saturation,
)

if TYPE_CHECKING:
    from microbot_ocp.views.recording._recording import Recording

SHORT = 4.0  # s; what is shorter plays at half its speed
PROGRESS_TIME = 5.0  # s that the whole progress takes to play
WIDE_ROBOT = 4  # more joints than this: one tab a quantity
LANES = (0.13, 0.055)  # height of the state timeline, and of a lane, by that of the curves
TOOL_CURVES = {
    "tool speed [m/s]": ("speed",),
    "force in the wrist [N]": ("force",),
    "progress [%] over time; elapsed time [s] over progress": ("progress", "elapsed"),
}


def blueprint(recording: Recording) -> rrb.Blueprint:
    """Ready to play on the recording's first timeline."""
    marks = rrb.TextLogView(
        origin=entities.MARKS,
        name="marks and switches",
        columns=rrb.TextLogColumns(text_log_columns=["Body"]),
    )
    words = rrb.TextDocumentView(origin=entities.SUMMARY, name="summary")
    space = _space(recording)
    if recording.quantities:
        below = rrb.Horizontal(words, marks, column_shares=[1.6, 1.0])
        left = rrb.Vertical(space, below, row_shares=[2.4, 1.0])
        whole = rrb.Horizontal(left, _right(recording), column_shares=[1.15, 1.0])
    else:
        whole = rrb.Horizontal(space, words, column_shares=[1.4, 1.0])
    last = float(max(recording.end.get(recording.timeline, [0.0])))
    return playing(whole, recording.timeline, last)


def playing(whole: rrb.Container, timeline: str, last: float) -> rrb.Blueprint:
    """A layout that plays a timeline, which ends at ``last``, over and over."""
    timed = timeline == entities.TIME
    return rrb.Blueprint(
        whole,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(
            state="collapsed",
            timeline=timeline,
            play_state="playing",
            loop_mode="all",
            playback_speed=0.5 if timed and last < SHORT else 1.0,
            fps=entities.WHOLE / PROGRESS_TIME if timed else 1.0,  # of counted timelines
        ),
    )


def _space(recording: Recording) -> rrb.Spatial3DView:
    robot, actors = recording.robot, recording.actors
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
    overrides = {}
    for actor in actors:
        for path in (entities.trail(actor.name), entities.switches(actor.name)):
            overrides[path] = to_cursor
    for path in recording.hidden:
        overrides[path] = rrb.EntityBehavior(visible=False)
    position, target, up = recording.eye
    return rrb.Spatial3DView(
        origin=entities.WORLD,
        name=robot.name,
        line_grid=rrb.LineGrid3D(
            visible=True,
            spacing=camera.grid_spacing(robot),
            plane=Plane3D(camera.upward(robot)),
        ),
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital, position=position, look_target=target, eye_up=up
        ),
        overrides=overrides,
    )


def _right(recording: Recording) -> rrb.Container:
    count = recording.robot.joint_count
    rows = {
        quantity: [_plot(recording, quantity, joint) for joint in range(count)]
        for quantity in recording.quantities
    }
    if count > WIDE_ROBOT:
        tabs: list[rrb.Container] = [
            rrb.Grid(*views, grid_columns=2, name=q) for q, views in rows.items()
        ]
    else:
        every = [view for views in rows.values() for view in views]
        tabs = [rrb.Grid(*every, grid_columns=count, name="joints")]
    if recording.timeline == entities.TIME:
        tool = [
            rrb.TimeSeriesView(
                contents=[f"{entities.tool_curve(quantity)}/**" for quantity in quantities],
                name=name,
                plot_legend=rrb.PlotLegend(visible=False),
            )
            for name, quantities in TOOL_CURVES.items()
        ]
        tabs.append(rrb.Vertical(*tool, name="tool and progress"))
    curves = rrb.Tabs(*tabs, active_tab=0)
    met = _joints_at_limits(recording)
    if not met:
        return curves
    (solid,) = {name for name, _ in met}
    title = next(actor.title for actor in recording.actors if actor.name == solid)
    lanes = rrb.StateTimelineView(
        contents=[saturation.lane(recording.robot, name, joint) for name, joint in met],
        name=f"limits met: {title}" if title else "limits met",
    )
    return rrb.Vertical(curves, lanes, row_shares=[1.0, LANES[0] + LANES[1] * len(met)])


def _joints_at_limits(recording: Recording) -> list[tuple[str, int]]:
    """Name of the solid arm with every joint (0-based) of it that is ever at a limit."""
    return [
        (actor.name, joint)
        for actor in recording.actors
        if actor.look.solid
        for joint in sorted({spell.joint for spell in recording.spells.get(actor.name, [])})
    ]


def _plot(recording: Recording, quantity: str, joint: int) -> rrb.TimeSeriesView:
    robot = recording.robot
    limits = recording.axis_limits[quantity, joint]
    unit = scene.display_unit(robot, quantity, joint)
    return rrb.TimeSeriesView(
        origin=entities.curve(robot, quantity, joint),
        name=f"{robot.joint_names[joint]} {quantity} [{unit}]",
        axis_y=rrb.ScalarAxis(range=limits.axis),
        plot_legend=rrb.PlotLegend(visible=False),  # the arms' labels show the colours
    )
