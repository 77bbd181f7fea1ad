"""A recording as data: the arms, the marked places, the text and curves beside them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
import rerun.blueprint as rrb

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.table import Table
from microbot_ocp.planning import Payload
from microbot_ocp.robot import JointLimits, Robot
from microbot_ocp.scene import Nearest, Scene, has_coal
from microbot_ocp.views._scene import QUANTITIES, AxisLimits, link_origins, reach
from microbot_ocp.views.recording._animated_arm import AnimatedArm
from microbot_ocp.views.recording._arm import (
    LABEL_GAP,
    LABEL_STEP,
    draw_arm,
    draw_labels,
    drawn_geometry,
)
from microbot_ocp.views.recording._blueprint import recording_blueprint
from microbot_ocp.views.recording._curves import draw_curve, draw_curves, draw_limits, draw_progress
from microbot_ocp.views.recording._limits import (
    LimitPlot,
    LimitSpell,
    axis_limits,
    draw_lanes,
    draw_limit_curves,
    draw_marks,
    draw_switches,
    limit_notes,
    limit_plots,
    limit_spells,
)
from microbot_ocp.views.recording._loads import (
    Arrows,
    arrows,
    draw_arrows,
    draw_torques,
    legend,
)
from microbot_ocp.views.recording._obstacles import CLEARANCE, draw_scene, nearest_along
from microbot_ocp.views.recording._surroundings import Eye, draw_surroundings, find_eye
from microbot_ocp.views.recording._writer import (
    APPLICATION,
    TIME,
    Times,
    Writer,
    arm_path,
    file_writer,
    link_path,
    plot_path,
    tool_path,
)


class Carried(NamedTuple):
    """A part and the pose [N,4,4] of the tool frame that it is rigid in, at the arm's samples."""

    payload: Payload
    poses: FloatArray


@dataclass(frozen=True, eq=False)
class Recording:
    """Arms on common timelines, ready to be saved to a file or sent to a stream.

    Attributes
    ----------
    title : str
        What it is of; recordings of one title share a layout in the viewer.
    robot : Robot
    limits : JointLimits
        Those that are drawn.
    arms : tuple of AnimatedArm
        Every arm with its motion.
    places : array [m,3]
        Places that are marked in space, m.
    place_names : tuple of str, m
    summary : Table
    target : array [4,4], optional
        A pose whose axes are drawn.
    scene : Scene, optional
        Obstacles around the arms.
    quantities : tuple of str
        What is plotted.
    timeline : str
        The one that plays.
    """

    title: str
    robot: Robot
    limits: JointLimits
    arms: tuple[AnimatedArm, ...]
    places: FloatArray
    place_names: tuple[str, ...]
    summary: Table
    target: FloatArray | None = None
    scene: Scene | None = None
    quantities: tuple[str, ...] = QUANTITIES
    timeline: str = TIME

    @cached_property
    def axis_limits(self) -> Mapping[tuple[str, int], AxisLimits]:
        """By quantity and joint: the limits that are drawn, and the range of the axis."""
        return {
            (quantity, joint): axis_limits(self.robot, self.limits, self.arms, quantity, joint)
            for quantity in self.quantities
            for joint in range(self.robot.joint_count)
        }

    @cached_property
    def spells(self) -> Mapping[str, list[LimitSpell]]:
        """Spells at limits by the name of the arm."""
        return {arm.name: limit_spells(arm) for arm in self._moving}

    @property
    def limit_plots(self) -> list[LimitPlot]:
        """Plots of limits beside those of position, velocity, acceleration and torque."""
        seen = self.scene is not None and has_coal() and bool(self._moving)
        return [*([CLEARANCE] if seen else []), *limit_plots(self._moving)]

    @property
    def application(self) -> str:
        """What the viewer files it under; it takes few characters."""
        return f"{APPLICATION} {re.sub(r'[^A-Za-z0-9]+', ' ', self.title).strip()}"

    @property
    def timelines(self) -> tuple[str, ...]:
        """Names of all timelines."""
        return tuple(dict.fromkeys(name for arm in self.arms for name in arm.times))

    @property
    def end(self) -> Times:
        """The last value [1] of every timeline."""
        return {
            timeline: np.array([max(float(arm.times[timeline][-1]) for arm in self.arms)])
            for timeline in self.timelines
        }

    @property
    def eye(self) -> Eye:
        """Where everything that moves is seen from."""
        labels = sum(bool(arm.title) for arm in self.arms)
        headroom = (LABEL_GAP + LABEL_STEP * (labels - 1)) * reach(self.robot) if labels else 0.0
        q = np.vstack([np.zeros((0, self.robot.joint_count)), *(arm.q for arm in self.arms)])
        obstacles = () if self.scene is None else self.scene.obstacles
        return find_eye(self.robot, q, self.places, headroom, obstacles)

    @property
    def hidden(self) -> list[str]:
        """Entities that are hidden at first, so that the scene is not crowded."""
        frames = range(1, self.robot.joint_count + 1)
        paths = []
        for arm in self.arms:
            paths += [link_path(arm.name, frame, "frame") for frame in frames]
            paths.append(tool_path(arm.name, "frame"))
            if len(self.arms) > 1 or drawn_geometry(self.robot.shapes).shapes:
                paths += [link_path(arm.name, frame, "center_of_mass") for frame in frames]
            if len(self.arms) > 1:
                paths.append(tool_path(arm.name, "force"))
                paths.append(arm_path(arm.name, "switches", "latest"))
            if not arm.look.solid:
                paths.append(tool_path(arm.name, "velocity"))
                paths.append(arm_path(arm.name, "switches"))
        return paths

    def blueprint(self) -> rrb.Blueprint:
        """The layout."""
        return recording_blueprint(self)

    def write(self, writer: Writer) -> None:
        """Send everything but the layout."""
        draw_surroundings(writer, self.robot, self.places, self.place_names, self.target)
        notes = [*self.summary.notes, *self._more_notes()]
        writer.summary(replace(self.summary, notes=notes))
        for arm in self.arms:
            draw_arm(writer, self.robot, arm, self.end)
            draw_curves(writer, self.robot, arm)
        if self.scene is not None and self.arms:
            arm = self.arms[-1]
            draw_scene(writer, self.robot, self.scene, arm, self.end, self._around())
        draw_labels(writer, self.robot, self._moving, self.eye, self.places, self.place_names)
        for arm in self._moving:
            self._write_motion(writer, arm)
        if self.arms:
            for (quantity, joint), near in self.axis_limits.items():
                path = plot_path(quantity, self.robot.joint_names[joint])
                draw_limits(writer, path, near, self.end)
        for kind in self._arrows:
            draw_arrows(writer, self._moving, kind)
            for arm, vectors in zip(self._moving, kind.vectors, strict=True):
                path = plot_path(kind.quantity, arm.name)
                draw_curve(writer, arm, path, arm.times, np.linalg.norm(vectors, axis=1))

    def _around(self) -> Sequence[tuple[float, float, Robot, Scene]]:
        """Stretches of time, s, with the arm that moves then and what is around it."""
        return [] if self.scene is None else [(0.0, np.inf, self.robot, self.scene)]

    @property
    def tubes(self) -> Sequence[tuple[FloatArray, float]]:
        """Points [k,3] of tool lines and the radii of the tubes around them, m."""
        return ()

    @property
    def carried(self) -> Sequence[Carried]:
        """Parts that the last arm picks and puts down."""
        return ()

    def nearest(self) -> list[Nearest]:
        """Where the last arm is nearest to something, at every one of its samples.

        Empty without a scene, and without coal.
        """
        if self.scene is None or not has_coal():
            return []
        return nearest_along(self._around(), self.arms[-1])

    def _write_motion(self, writer: Writer, arm: AnimatedArm) -> None:
        spells = self.spells[arm.name]
        tool = link_origins(self.robot, arm.q)[:, -1]
        draw_lanes(writer, self.robot, arm, spells)
        draw_switches(writer, self.robot, arm, spells, tool)
        draw_marks(writer, self.robot, arm, spells)
        draw_progress(writer, arm)
        draw_limit_curves(writer, arm, self.end)
        if arm.look.solid and "tau" in arm.curves and self.robot.has_dynamics:
            draw_torques(writer, self.robot, self.limits, arm)

    def save(self, path: str | Path) -> Path:
        """Write an ``.rrd`` with its layout, whole or not at all; it plays when opened."""
        with file_writer(path, self.blueprint(), self.application) as writer:
            self.write(writer)
        return Path(path)

    @property
    def _moving(self) -> list[AnimatedArm]:
        return [arm for arm in self.arms if arm.moves]

    @cached_property
    def _arrows(self) -> list[Arrows]:
        return arrows(self.robot, self._moving)

    def _more_notes(self) -> list[str]:
        """Sentences on the limits that are not drawn, and on what is drawn in space."""
        far = [
            f"{quantity} of {self.robot.joint_names[joint]}: {limits.far}"
            for (quantity, joint), limits in self.axis_limits.items()
            if limits.far
        ]
        solid = [arm for arm in self._moving if arm.look.solid]
        notes = [note for arm in solid for note in limit_notes(arm)]
        if solid:
            notes += drawn_geometry(self.robot.shapes).missing
        if far:
            notes.append(f"Too far off to be drawn: {'; '.join(far)}.")
        if self._moving:
            scales = [kind.scale for kind in self._arrows]
            notes.append(legend(self.robot, len(self._moving) == 1, scales))
        return notes
