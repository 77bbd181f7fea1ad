"""Recording as data: arms, marked places, surroundings, text and curves."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import rerun.blueprint as rrb

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.table import Table
from microbot_ocp.limits import quantity_name
from microbot_ocp.robot import JointLimits, Robot
from microbot_ocp.scene import has_coal
from microbot_ocp.views._eye import Eye, find_eye
from microbot_ocp.views._scene import QUANTITIES, AxisLimits, display_unit, near_limits, reach
from microbot_ocp.views._solids import DrawnSurroundings, drawn_geometry
from microbot_ocp.views._style import LABEL_HEIGHT, SIDE_BY_SIDE
from microbot_ocp.views.recording import _blueprint as layout, _limits, _loads, _space
from microbot_ocp.views.recording._animated_arm import AnimatedArm
from microbot_ocp.views.recording._writer import (
    APPLICATION,
    TIME,
    Times,
    Writer,
    file_writer,
    plot_path,
)

TOOL_CURVES = {
    "tool speed [m/s]": ("speed",),
    "force in the wrist [N]": ("force",),
    "progress [%] over time; elapsed time [s] over progress": ("progress", "elapsed"),
}


@dataclass(frozen=True, eq=False)
class Recording:
    """Recording of arms on common timelines, for a file or a stream.

    Attributes
    ----------
    title : str
        Title; recordings of one title share a layout in the viewer.
    robot : Robot
    limits : JointLimits
        Drawn limits.
    arms : tuple of AnimatedArm
        Arms with their motions.
    places : array [m,3]
        Marked places in space, m.
    place_names : tuple of str [m]
        Names of the marked places.
    summary : Table
    target : array [4,4], optional
        Pose whose axes are drawn.
    around : DrawnSurroundings
        Surroundings of the last arm.
    quantities : tuple of str
        Plotted quantities.
    timeline : str
        Timeline that plays.
    """

    title: str
    robot: Robot
    limits: JointLimits
    arms: tuple[AnimatedArm, ...]
    places: FloatArray
    place_names: tuple[str, ...]
    summary: Table
    target: FloatArray | None = None
    around: DrawnSurroundings = field(default_factory=DrawnSurroundings)
    quantities: tuple[str, ...] = QUANTITIES
    timeline: str = TIME

    @cached_property
    def axis_limits(self) -> Mapping[tuple[str, int], AxisLimits]:
        """Drawn limits and range of the axis, by quantity and joint."""
        limits = {}
        for quantity in self.quantities:
            tables = [arm.curves[quantity] for arm in self.arms if quantity in arm.curves]
            values = np.concatenate([np.zeros((0, self.robot.joint_count)), *tables])
            for joint, column in enumerate(values.T):
                near = near_limits(self.robot, self.limits, quantity, joint, column)
                limits[quantity, joint] = near
        return limits

    @cached_property
    def spells(self) -> Mapping[str, list[_limits.LimitSpell]]:
        """Spells at limits by the name of the arm."""
        return {arm.name: _limits.limit_spells(arm) for arm in self.moving}

    @property
    def limit_plots(self) -> list[_limits.LimitPlot]:
        """Plots of all limits except position, velocity, acceleration and torque."""
        among = self.around.scene is not None and has_coal() and bool(self.moving)
        return [*([_space.CLEARANCE] if among else []), *_limits.limit_plots(self.moving)]

    @property
    def application(self) -> str:
        """Application identifier for the viewer, which allows few characters."""
        return f"{APPLICATION} {re.sub(r'[^A-Za-z0-9]+', ' ', self.title).strip()}"

    @property
    def moving(self) -> list[AnimatedArm]:
        """Arms with a motion over time."""
        return [arm for arm in self.arms if arm.moves]

    @property
    def end(self) -> Times:
        """Last value [1] of every timeline."""
        names = dict.fromkeys(name for arm in self.arms for name in arm.times)
        return {n: np.array([max(float(arm.times[n][-1]) for arm in self.arms)]) for n in names}

    @cached_property
    def eye(self) -> Eye:
        """Viewpoint with the whole motion in view."""
        headroom = LABEL_HEIGHT * sum(bool(arm.title) for arm in self.arms) * reach(self.robot)
        q = np.vstack([np.zeros((0, self.robot.joint_count)), *(arm.q for arm in self.arms)])
        obstacles = [solid for _, solid in self.around.obstacles(self.robot)]
        return find_eye(self.robot, q, self.places, headroom, obstacles)

    @property
    def hidden(self) -> list[str]:
        """Entities that are hidden by default, to keep the view clear."""
        frames, alone = range(1, self.robot.link_count + 1), len(self.arms) == 1
        paths = []
        for arm in self.arms:
            paths += [arm.tool("frame"), *(arm.link(frame, "frame") for frame in frames)]
            if not alone or drawn_geometry(self.robot.shapes).solids:
                paths += [arm.link(frame, "center_of_mass") for frame in frames]
            if not alone:
                paths += [arm.tool("force"), arm.path("switches", "latest")]
            if not arm.look.solid:
                paths += [arm.tool("velocity"), arm.path("switches")]
        return paths

    def blueprint(self) -> rrb.Blueprint:
        """Return the layout: arms and text at the left, curves at the right, playing."""
        text, space = layout.text_view(), self._arms_view()
        if self.quantities:
            marks = layout.marks_view("marks and switches")
            below = rrb.Horizontal(text, marks, column_shares=[2, 1])
            left = rrb.Vertical(space, below, row_shares=[2, 1])
            whole = rrb.Horizontal(left, self._curves_view())
        else:
            whole = rrb.Horizontal(space, text, column_shares=[3, 2])
        last = float(max(self.end.get(self.timeline, [0.0])))
        return layout.playing(whole, self.timeline, last)

    def _arms_view(self) -> rrb.Spatial3DView:
        to_cursor = rrb.VisibleTimeRanges([layout.behind_cursor(name) for name in self.end])
        overrides: dict[str, Any] = {
            arm.path(leaf): to_cursor for arm in self.arms for leaf in ("trail", "switches")
        }
        overrides |= {path: rrb.EntityBehavior(visible=False) for path in self.hidden}
        return layout.space_view(self.robot, self.eye, overrides)

    def _curves_view(self) -> rrb.Container:
        robot = self.robot
        rows = {
            quantity: [self._joint_view(quantity, j) for j in range(robot.joint_count)]
            for quantity in self.quantities
        }
        tabs: list[rrb.Container]
        if robot.joint_count > SIDE_BY_SIDE:
            tabs = [rrb.Grid(*views, grid_columns=2, name=key) for key, views in rows.items()]
        else:
            every = [view for views in rows.values() for view in views]
            tabs = [rrb.Grid(*every, grid_columns=robot.joint_count, name="joints")]
        further = [layout.plot_view(plot.title, origin=plot.path) for plot in self.limit_plots]
        if further:
            tabs.append(rrb.Grid(*further, grid_columns=2, name="further limits"))
        if self.timeline == TIME:
            tool = [
                layout.plot_view(name, contents=[f"{plot_path(quantity)}/**" for quantity in each])
                for name, each in TOOL_CURVES.items()
            ]
            tabs.append(rrb.Vertical(*tool, name="tool and progress"))
        curves = rrb.Tabs(*tabs, active_tab=0)
        solid = next((arm for arm in self.arms if arm.look.solid), None)
        if solid is None or not self.spells.get(solid.name):
            return curves
        spells = sorted(self.spells[solid.name], key=lambda s: (s.joint is None, s.joint or 0))
        paths = (_limits.lane_path(robot, solid.name, spell.joint) for spell in spells)
        met = list(dict.fromkeys(paths))
        title = f"limits met: {solid.title}" if solid.title else "limits met"
        lanes = rrb.StateTimelineView(contents=met, name=title)
        return rrb.Vertical(curves, lanes, row_shares=[20, 2 + len(met)])

    def _joint_view(self, quantity: str, joint: int) -> rrb.TimeSeriesView:
        robot, limits = self.robot, self.axis_limits[quantity, joint]
        name, unit = robot.joint_names[joint], display_unit(robot, quantity, joint)
        far = ""
        if limits.far and robot.joint_count > SIDE_BY_SIDE:  # plots in two columns are wide
            far = f", {limits.far.removesuffix(unit).strip()}"
        return layout.plot_view(
            f"{name} {quantity} [{unit}]{far}",
            origin=plot_path(quantity, name),
            axis_y=rrb.ScalarAxis(range=layout.labelled_range(*limits.axis)),
        )

    def write(self, writer: Writer) -> None:
        """Write all entities; the layout is separate."""
        robot, end = self.robot, self.end
        _space.draw_base(writer, robot, self.places, self.place_names, self.target)
        notes = [*self.summary.notes, *self._more_notes()]
        writer.summary(replace(self.summary, notes=notes))
        for arm in self.arms:
            _space.draw_arm(writer, robot, arm, end)
            arm.draw_curves(writer, robot)
        if self.moving:
            _space.draw_surroundings(writer, robot, self.around, self.moving[-1])
            _space.draw_nearest(writer, robot, self.around, self.moving[-1], end)
        _space.draw_labels(writer, robot, self.moving, self.eye, self.places, self.place_names)
        for arm in self.moving:
            _limits.draw_spells(writer, robot, arm, self.spells[arm.name])
            _limits.draw_limit_curves(writer, arm, end)
            if arm.look.solid and "tau" in arm.curves and robot.has_dynamics:
                _loads.draw_torques(writer, robot, self.limits, arm)
        for (quantity, joint), near in self.axis_limits.items() if self.arms else ():
            path = plot_path(quantity, robot.joint_names[joint])
            writer.level(f"{path}/limit_lower", near.lower, end)
            writer.level(f"{path}/limit_upper", near.upper, end)
        for kind in self._arrows:
            _loads.draw_arrows(writer, self.moving, kind)

    def save(self, path: str | Path) -> Path:
        """Write an ``.rrd`` with its layout, completely or not at all; it plays when opened."""
        with file_writer(path, self.blueprint(), self.application) as writer:
            self.write(writer)
        return Path(path)

    @cached_property
    def _arrows(self) -> list[_loads.Arrows]:
        return _loads.arrows(self.robot, self.moving)

    def _more_notes(self) -> list[str]:
        """Return sentences on the limits that are not drawn, and a legend of the view in space."""
        far = [
            f"{quantity_name(quantity)} of {self.robot.joint_names[joint]}: {limits.far}"
            for (quantity, joint), limits in self.axis_limits.items()
            if limits.far
        ]
        solid = [arm for arm in self.moving if arm.look.solid]
        notes = [note for arm in solid for note in _limits.limit_notes(arm)]
        if solid:
            notes += drawn_geometry(self.robot.shapes).missing
        if far:
            notes.append(f"Limits outside of the plots: {'; '.join(far)}.")
        if self.moving:
            scales = [kind.scale for kind in self._arrows]
            notes.append(_loads.legend(self.robot, len(self.moving) == 1, scales))
        return notes
