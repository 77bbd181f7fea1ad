"""What is around an arm as data: obstacles, tool lines, stops and parts, for every picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.planning import Payload, Place, parts_of, places_along, tool_poses
from microbot_ocp.robot import Robot
from microbot_ocp.scene import Nearest, Scene, contact_model, has_coal
from microbot_ocp.tasks import Cell
from microbot_ocp.views._solids import Solid, obstacle_solid


class CarriedPart(NamedTuple):
    """A part and the pose [N,4,4] of the tool frame that it is rigid in, at the arm's samples."""

    payload: Payload
    poses: FloatArray


class Tube(NamedTuple):
    """Points [k,3] of a tool line, and the radius of the tube around it, m."""

    points: FloatArray
    radius: float


@dataclass(frozen=True, eq=False)
class DrawnSurroundings:
    """What is around an arm in motion.

    Attributes
    ----------
    scene : Scene, optional
    stretches : tuple of Place
        Which arm moves among what, from when to when.
    tubes : tuple of Tube
    stops : tuple of array [4,4]
        Poses that the task asks for at stops.
    parts : tuple of Carried
        What the arm picks and puts down, lying there before and after.
    """

    scene: Scene | None = None
    stretches: tuple[Place, ...] = ()
    tubes: tuple[Tube, ...] = ()
    stops: tuple[FloatArray, ...] = ()
    parts: tuple[CarriedPart, ...] = ()

    @classmethod
    def of_scene(cls, robot: Robot, scene: Scene | None) -> DrawnSurroundings:
        """Return the obstacles of a scene, the same at all times."""
        return cls(scene, () if scene is None else (Place(0.0, np.inf, robot, scene),))

    @classmethod
    def of_cell(cls, cell: Cell, t: FloatArray, q: FloatArray) -> DrawnSurroundings:
        """Return what is around an arm at q [N,n] at times t [N] that does the task of a cell."""
        task, marks = cell.task, cell.motion.marks
        if len(marks) != len(task.stops):
            raise InputError("the motion of this cell has other stops than its task")
        leaves = [mark.time + float(d) for mark, d in zip(marks, task.dwells, strict=True)]
        at = np.minimum(np.searchsorted(t, leaves), len(t) - 1)  # samples at which stops are left
        tool, parts = tool_poses(cell.robot, q), []
        for part in parts_of(task, tool[at]):
            poses = np.repeat(tool[None, at[part.carries[0][0]]], len(t), axis=0)
            for first, end in part.carries:
                poses[at[first] : at[end]] = tool[at[first] : at[end]]
                poses[at[end] :] = tool[at[end]]
            parts.append(CarriedPart(part.payload, poses))
        stops = []
        for place, rotation in (stop.pose(cell.robot) for stop in task.stops):
            if rotation is not None:
                stops.append(np.eye(4))
                stops[-1][:3] = np.column_stack([rotation, place])
        tubes = [
            Tube(curve[0].points(np.linspace(0.0, 1.0, 60)), segment.tolerance)  # type: ignore[union-attr]
            for curve, segment in zip(task.curves, task.segments, strict=True)
            if curve is not None
        ]
        stretches = () if cell.scene is None else places_along(task, cell.motion, cell.scene)
        return cls(cell.scene, tuple(stretches), tuple(tubes), tuple(stops), tuple(parts))

    def obstacles(self, robot: Robot) -> list[tuple[str, Solid]]:
        """Return names and bodies of the scene's obstacles."""
        every = () if self.scene is None else self.scene.obstacles
        return [(obstacle.name, obstacle_solid(obstacle, robot)) for obstacle in every]

    def nearest(self, t: FloatArray, q: FloatArray) -> list[Nearest]:
        """Return where an arm at q [N,n] at times t [N] is nearest to something.

        Empty without a scene, and without coal.
        """
        if self.scene is None or not has_coal():
            return []
        models = [contact_model(p.robot, p.scene.without_parts_of(p.robot)) for p in self.stretches]
        at = np.searchsorted([place.end for place in self.stretches[:-1]], t, side="right")
        return [models[k].nearest(pose) for k, pose in zip(at, q, strict=True)]
