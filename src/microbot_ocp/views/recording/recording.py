"""A recording as data: who plays, what is marked, which words and curves stand beside."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import rerun.blueprint as rrb

from microbot_ocp.checks import FloatArray
from microbot_ocp.robot import JointLimits, Robot
from microbot_ocp.views import scene
from microbot_ocp.views.recording import (
    arm,
    camera,
    curves,
    entities,
    marks,
    saturation,
    surroundings,
    torque,
    vectors,
    words,
)
from microbot_ocp.views.recording.actors import Actor
from microbot_ocp.views.recording.blueprint import blueprint
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
    via_names : tuple of str, m
    quantities : tuple of str
        What is plotted.
    timeline : str
        The one that plays.
    """

    robot: Robot
    limits: JointLimits
    actors: tuple[Actor, ...]
    via_q: FloatArray
    summary: str
    via_names: tuple[str, ...]
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
        q = np.vstack([self.via_q, *(actor.q for actor in self.actors)])
        return camera.eye(self.robot, q, headroom)

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
            if not actor.look.solid:
                paths.append(entities.tool(actor.name, "velocity"))
                paths.append(entities.switches(actor.name))
        return paths

    def has_limits(self, quantities: Iterable[str]) -> bool:
        """Whether any joint has a limit of one of the quantities."""
        return any(np.isfinite(self.limits.bounds(quantity)).any() for quantity in quantities)

    def blueprint(self) -> rrb.Blueprint:
        """The layout."""
        return blueprint(self)

    def write(self, writer: Writer) -> None:
        """Send everything but the layout."""
        surroundings.draw(writer, self.robot, self.via_q, self.via_names)
        surroundings.write_words(writer, self.summary + self._more_words())
        if not self.actors:
            return
        for actor in self.actors:
            arm.draw(writer, self.robot, actor, self.end)
            curves.draw(writer, self.robot, actor)
            if actor.moves:
                self._write_motion(writer, actor)
        for (quantity, joint), limits in self.axis_limits.items():
            curves.draw_limits(writer, self.robot, quantity, joint, limits, self.end)
        for kind in self._arrows:
            vectors.draw(writer, self._moving, kind)

    def _write_motion(self, writer: Writer, actor: Actor) -> None:
        found = saturation.spells(self.limits, actor)
        tool = scene.link_origins(self.robot, actor.q)[:, -1]
        saturation.draw_lanes(writer, self.robot, actor, found)
        saturation.draw_switches(writer, self.robot, actor, found, tool)
        marks.draw(writer, self.robot, actor, found)
        curves.draw_progress(writer, actor)
        if actor.look.solid and self.robot.has_dynamics:
            torque.draw(writer, self.robot, self.limits, actor)

    def save(self, path: str | Path) -> Path:
        """Write an ``.rrd`` with its layout, whole or not at all; it plays when opened."""
        with file_writer(path, self.blueprint()) as writer:
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
            items.append(words.legend(self.robot, *(kind.scale for kind in self._arrows)))
        return "".join(f"- {item}\n" for item in items if item)
