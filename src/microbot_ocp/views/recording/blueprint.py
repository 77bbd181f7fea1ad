"""The layout of every recording: the arms, the words, the curves."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import rerun.blueprint as rrb

from microbot_ocp.views import scene
from microbot_ocp.views.recording import camera, entities

if TYPE_CHECKING:
    from microbot_ocp.views.recording.recording import Recording

WIDE_ROBOT = 4  # more joints than this: one tab a quantity
AxisLimits = Mapping[tuple[str, int], scene.AxisLimits]


def blueprint(recording: Recording, limits: AxisLimits) -> rrb.Blueprint:
    """Arms and words to the left, curves to the right; it plays when opened."""
    words = rrb.TextDocumentView(origin=entities.SUMMARY, name="summary")
    marks = rrb.TextLogView(
        origin=entities.MARKS,
        name="marks",
        columns=rrb.TextLogColumns(text_log_columns=["Body"]),
    )
    below = rrb.Horizontal(words, marks, column_shares=[2.5, 1.0])
    left = rrb.Vertical(_space(recording), below, row_shares=[2.2, 1.0])
    return rrb.Blueprint(
        rrb.Horizontal(left, _plots(recording, limits), column_shares=[1.15, 1.0]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(
            state="collapsed",
            timeline=entities.TIME,
            play_state="playing",
            loop_mode="all",
            playback_speed=0.5,
        ),
    )


def _space(recording: Recording) -> rrb.Spatial3DView:
    to_cursor = [
        rrb.VisibleTimeRanges(
            timeline=timeline,
            start=rrb.TimeRangeBoundary.infinite(),
            end=rrb.TimeRangeBoundary.cursor_relative(),
        )
        for timeline in (entities.TIME,)
    ]
    robot, actors = recording.robot, recording.actors
    headroom = max((actor.look.label_height for actor in actors), default=0.0)
    positions = np.vstack([recording.via_q, *(actor.q for actor in actors)])
    eye, target = camera.eye(robot, positions, recording.via_q, headroom)
    return rrb.Spatial3DView(
        origin=entities.WORLD,
        name=robot.name,
        line_grid=rrb.LineGrid3D(visible=True, spacing=camera.grid_spacing(robot)),
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital, position=eye, look_target=target, eye_up=(0.0, 0.0, 1.0)
        ),
        overrides={entities.trail(actor.name): to_cursor for actor in actors},
    )


def _plots(recording: Recording, limits: AxisLimits) -> rrb.Container:
    count = recording.robot.joint_count
    rows = {
        quantity: [
            _plot(recording, quantity, joint, limits[quantity, joint]) for joint in range(count)
        ]
        for quantity in recording.quantities
    }
    if count > WIDE_ROBOT:
        tabs = [rrb.Grid(*views, grid_columns=2, name=q) for q, views in rows.items()]
        return rrb.Tabs(*tabs, active_tab=0)
    every = [view for views in rows.values() for view in views]
    return rrb.Grid(*every, grid_columns=count)


def _plot(
    recording: Recording, quantity: str, joint: int, limits: scene.AxisLimits
) -> rrb.TimeSeriesView:
    robot = recording.robot
    unit = scene.display_unit(robot, quantity, joint)
    return rrb.TimeSeriesView(
        origin=entities.curve(robot, quantity, joint),
        name=f"{robot.joint_names[joint]} {quantity} [{unit}]",
        axis_y=rrb.ScalarAxis(range=limits.axis),
        plot_legend=rrb.PlotLegend(visible=False),  # the arms' labels show the colours
    )
