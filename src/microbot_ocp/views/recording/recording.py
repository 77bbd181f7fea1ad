"""A recording as data: who plays, what is marked, which words and curves stand beside."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import rerun.blueprint as rrb

from microbot_ocp.checks import FloatArray
from microbot_ocp.robot import JointLimits, Robot
from microbot_ocp.views import scene
from microbot_ocp.views.recording import arm, curves, marks, surroundings
from microbot_ocp.views.recording.actors import Actor
from microbot_ocp.views.recording.blueprint import AxisLimits, blueprint
from microbot_ocp.views.recording.writer import Times, Writer, file_writer


@dataclass(frozen=True, eq=False)
class Recording:
    """Arms on common timelines, ready to be saved to a file or sent to a stream.

    Attributes
    ----------
    robot : Robot
    limits : JointLimits
        Those that are drawn.
    actors : tuple of Actor
        Every arm with its motion.
    via_q : array [m,n]
        Poses whose tool positions are marked, rad or m.
    summary : str
        Markdown.
    quantities : tuple of str
        What is plotted.
    """

    robot: Robot
    limits: JointLimits
    actors: tuple[Actor, ...]
    via_q: FloatArray
    summary: str
    quantities: tuple[str, ...] = scene.QUANTITIES

    @cached_property
    def axis_limits(self) -> AxisLimits:
        """By quantity and joint: the limits that are drawn, and the range of the axis."""
        return {
            (quantity, joint): curves.near_limits(
                self.robot, self.limits, self.actors, quantity, joint
            )
            for quantity in self.quantities
            for joint in range(self.robot.joint_count)
        }

    @property
    def end(self) -> Times:
        """The last value [1] of every timeline."""
        ends: dict[str, FloatArray] = {}
        for actor in self.actors:
            for timeline, values in actor.times.items():
                last = max(float(values[-1]), *ends.get(timeline, [0.0]))
                ends[timeline] = np.array([last])
        return ends

    def blueprint(self) -> rrb.Blueprint:
        """The layout."""
        return blueprint(self, self.axis_limits)

    def write(self, writer: Writer) -> None:
        """Send everything but the layout."""
        surroundings.draw(writer, self.robot, self.via_q)
        surroundings.write_words(writer, self.summary + self._far_limits())
        for actor in self.actors:
            arm.draw(writer, self.robot, actor, self.end)
            curves.draw(writer, self.robot, actor)
            marks.draw(writer, actor)
        if self.actors:
            for (quantity, joint), limits in self.axis_limits.items():
                curves.draw_limits(writer, self.robot, quantity, joint, limits, self.end)

    def save(self, path: str | Path) -> Path:
        """Write an ``.rrd`` with its layout, whole or not at all; it plays when opened."""
        with file_writer(path, self.blueprint()) as writer:
            self.write(writer)
        return Path(path)

    def _far_limits(self) -> str:
        """Markdown item on the limits that are not drawn; empty where all are."""
        told = [
            f"{quantity} of {self.robot.joint_names[joint]}: {limits.far}"
            for (quantity, joint), limits in self.axis_limits.items()
            if limits.far
        ]
        return f"- Too far off to be drawn: {'; '.join(told)}.\n" if told else ""
