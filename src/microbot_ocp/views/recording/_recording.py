"""A recording as data: who plays, what is marked, which words and curves stand beside."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import rerun.blueprint as rrb

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.robot import JointLimits, Robot
from microbot_ocp.views import _scene as scene
from microbot_ocp.views.recording import (
    _arm as arm,
    _camera as camera,
    _curves as curves,
    _marks as marks,
    _messages as words,
    _paths as entities,
    _saturation as saturation,
    _surroundings as surroundings,
    _torque as torque,
    _vectors as vectors,
)
from microbot_ocp.views.recording._animated_arm import Actor
from microbot_ocp.views.recording._blueprint import blueprint
from microbot_ocp.views.recording._writer import APPLICATION, Times, Writer, file_writer


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
    actors : tuple of Actor
        Every arm with its motion.
    marked : array [m,3]
        Places that are marked in space, m.
    mark_names : tuple of str, m
    summary : str
        Markdown.
    target : array [4,4], optional
        A pose whose axes are drawn.
    quantities : tuple of str
        What is plotted.
    timeline : str
        The one that plays.
    """

    title: str
    robot: Robot
    limits: JointLimits
    actors: tuple[Actor, ...]
    marked: FloatArray
    mark_names: tuple[str, ...]
    summary: str
    target: FloatArray | None = None
    quantities: tuple[str, ...] = scene.QUANTITIES
    timeline: str = entities.TIME

    @cached_property
    def axis_limits(self) -> Mapping[tuple[str, int], scene.AxisLimits]:
        """By quantity and joint: the limits that are drawn, and the range of the axis."""
        return {
            (quantity, joint): curves.near_limits(
                self.robot, self.limits, self.actors, quantity, joint
            )
            for quantity in self.quantities
            for joint in range(self.robot.joint_count)
        }

    @property
    def application(self) -> str:
        """What the viewer files it under; it takes few characters."""
        return f"{APPLICATION} {re.sub(r'[^A-Za-z0-9]+', ' ', self.title).strip()}"

    @property
    def timelines(self) -> tuple[str, ...]:
        """Names of all timelines."""
        return tuple(dict.fromkeys(name for actor in self.actors for name in actor.times))

    @property
    def end(self) -> Times:
        """The last value [1] of every timeline."""
        return {
            timeline: np.array([max(float(actor.times[timeline][-1]) for actor in self.actors)])
            for timeline in self.timelines
        }

    @property
    def eye(self) -> camera.Eye:
        """Where everything that moves is seen from."""
        headroom = max((actor.look.label_height for actor in self.actors), default=0.0)
        q = np.vstack([np.zeros((0, self.robot.joint_count)), *(actor.q for actor in self.actors)])
        return camera.eye(self.robot, q, self.marked, headroom)

    @property
    def hidden(self) -> list[str]:
        """Entities that are there but shown on request only, lest the scene be crowded."""
        crowd = len(self.actors) > 1
        frames = range(1, self.robot.joint_count + 1)
        paths = []
        for actor in self.actors:
            paths += [entities.link(actor.name, frame, "frame") for frame in frames]
            paths.append(entities.tool(actor.name, "frame"))
            if crowd:
                paths += [entities.link(actor.name, k, "center_of_mass") for k in frames]
                paths.append(entities.tool(actor.name, "force"))
                paths.append(entities.switches(actor.name, "latest"))
            if not actor.look.solid:
                paths.append(entities.tool(actor.name, "velocity"))
                paths.append(entities.switches(actor.name))
        return paths

    @cached_property
    def spells(self) -> Mapping[str, list[saturation.Spell]]:
        """Spells at limits by the name of the arm."""
        return {actor.name: saturation.spells(self.limits, actor) for actor in self._moving}

    def blueprint(self) -> rrb.Blueprint:
        """The layout."""
        return blueprint(self)

    def write(self, writer: Writer) -> None:
        """Send everything but the layout."""
        surroundings.draw(writer, self.robot, self.marked, self.mark_names, self.target)
        surroundings.write_words(writer, self.summary + self._more_words())
        if not self.actors:
            return
        for actor in self.actors:
            arm.draw(writer, self.robot, actor, self.end)
            curves.draw(writer, self.robot, actor)
            if actor.moves:
                self._write_motion(writer, actor)
        for (quantity, joint), near in self.axis_limits.items():
            curves.draw_limits(writer, self.robot, quantity, joint, near, self.end)
        for kind in self._arrows:
            vectors.draw(writer, self._moving, kind)

    def _write_motion(self, writer: Writer, actor: Actor) -> None:
        found = self.spells[actor.name]
        tool = scene.link_origins(self.robot, actor.q)[:, -1]
        saturation.draw_lanes(writer, self.robot, actor, found)
        saturation.draw_switches(writer, self.robot, actor, found, tool)
        marks.draw(writer, self.robot, actor, found)
        curves.draw_progress(writer, actor)
        if actor.look.solid and "tau" in actor.curves and self.robot.has_dynamics:
            torque.draw(writer, self.robot, self.limits, actor)

    def save(self, path: str | Path) -> Path:
        """Write an ``.rrd`` with its layout, whole or not at all; it plays when opened."""
        with file_writer(path, self.blueprint(), self.application) as writer:
            self.write(writer)
        return Path(path)

    @property
    def _moving(self) -> list[Actor]:
        return [actor for actor in self.actors if actor.moves]

    @cached_property
    def _arrows(self) -> list[vectors.Arrows]:
        return vectors.arrows(self.robot, self._moving)

    def _more_words(self) -> str:
        """Markdown items on the limits that are not drawn, and on what is drawn in space."""
        told = [
            f"{quantity} of {self.robot.joint_names[joint]}: {limits.far}"
            for (quantity, joint), limits in self.axis_limits.items()
            if limits.far
        ]
        items = [f"Too far off to be drawn: {'; '.join(told)}."] if told else []
        if self._moving:
            scales = [kind.scale for kind in self._arrows]
            items.append(words.legend(self.robot, len(self._moving) == 1, scales))
        return "".join(f"- {item}\n" for item in items if item)
