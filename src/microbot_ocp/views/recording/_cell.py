"""A motion through stops: the stops' frames, the tubes of tool lines, and what the tool holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import rerun as rr

from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.comparison import Cell
from microbot_ocp.planning import Place, Task, parts_of, places_along, tool_poses
from microbot_ocp.robot import Robot
from microbot_ocp.scene import Scene
from microbot_ocp.views.recording._builders import of_motion
from microbot_ocp.views.recording._obstacles import drawn_capsule
from microbot_ocp.views.recording._recording import Carried, Recording
from microbot_ocp.views.recording._surroundings import grid_spacing
from microbot_ocp.views.recording._writer import TIME, Writer, quaternions

TUBE_COLOR, PART_COLOR = (0, 158, 115, 110), (160, 120, 255, 255)
POINTS = 60  # of a tube
DENSITY = 2700.0  # kg/m^3, aluminium: a part of unknown shape is drawn as a ball of it


@dataclass(frozen=True, eq=False)
class CellRecording(Recording):
    """A recording of a motion with the task that it does."""

    task: Task | None = None
    stretches: tuple[Place, ...] = ()

    def write(self, writer: Writer) -> None:
        """Send everything but the layout."""
        super().write(writer)
        assert self.task is not None
        for number, (points, radius) in enumerate(self.tubes, start=1):
            tube = rr.LineStrips3D([points], radii=radius, colors=[TUBE_COLOR])
            writer.static(f"world/task/tube_{number}", tube)
        size = 0.5 * grid_spacing(self.robot)
        for k, stop in enumerate(self.task.stops):
            place, turned = stop.pose(self.robot)
            if turned is None:
                continue
            axes = rr.Arrows3D(
                origins=np.tile(place, (3, 1)),
                vectors=size * turned.T,
                colors=[(200, 60, 60), (60, 160, 60), (60, 60, 200)],
            )
            writer.static(f"world/task/stop_{k + 1}", axes)
        self._write_parts(writer)

    def _around(self) -> Sequence[tuple[float, float, Robot, Scene]]:
        return self.stretches

    @property
    def tubes(self) -> Sequence[tuple[FloatArray, float]]:
        """Points [k,3] of tool lines and the radii of the tubes around them, m."""
        assert self.task is not None
        share = np.linspace(0.0, 1.0, POINTS)
        return [
            (curve[0].points(share), segment.tolerance)  # type: ignore[union-attr]
            for curve, segment in zip(self.task.curves, self.task.segments, strict=True)
            if curve is not None
        ]

    @property
    def carried(self) -> Sequence[Carried]:
        """Parts in the tool from where they are picked to where they go, lying there otherwise."""
        task, (arm,) = self.task, self.arms
        assert task is not None
        t = arm.times[TIME]
        marks = [mark.time for mark in arm.marks]
        leaves = [time + float(dwell) for time, dwell in zip(marks, task.dwells, strict=True)]
        tool = tool_poses(self.robot, arm.q)
        at = np.minimum(np.searchsorted(t, leaves), len(t) - 1)  # samples at which stops are left
        found = []
        for part in parts_of(task, tool[at]):
            pose = np.repeat(tool[None, at[part.carries[0][0]]], len(t), axis=0)
            for first, end in part.carries:
                pose[at[first] : at[end]] = tool[at[first] : at[end]]
                pose[at[end] :] = tool[at[end]]
            found.append(Carried(part.payload, pose))
        return found

    def _write_parts(self, writer: Writer) -> None:
        """One without a shape is a ball at its centre of mass."""
        (arm,) = self.arms
        for number, (payload, pose) in enumerate(self.carried, start=1):
            path = f"world/task/part_{number}"
            turned = quaternions(pose[:, :3, :3])
            moved = rr.Transform3D.columns(translation=pose[:, :3, 3], quaternion=turned)
            writer.columns(path, arm.times, moved)
            for k, capsule in enumerate(payload.shape, start=1):
                placed, drawn = drawn_capsule(capsule, PART_COLOR)
                own = f"{path}/capsule_{k}"
                frame = rr.Transform3D(translation=placed[:3, 3], mat3x3=placed[:3, :3])
                writer.static(own, frame)
                writer.static(own, drawn)
            ball = rr.Points3D(
                [payload.center_of_mass],
                radii=[0.0 if payload.shape else ball_radius(payload.mass)],
                colors=[PART_COLOR],
                labels=[f"{payload.mass:g} kg"],
            )
            if payload.mass:
                writer.static(f"{path}/mass", ball)


def ball_radius(mass: float) -> float:
    """Radius of an aluminium ball of a mass in kg, m."""
    return (3.0 * mass / (4.0 * np.pi * DENSITY)) ** (1.0 / 3.0)


def of_cell(cell: Cell, rate: float | None = None) -> CellRecording:
    """A motion through stops, with the tubes of its tool lines and the parts that it carries.

    Raises
    ------
    InputError
        A motion of another task.
    """
    task = cell.task
    if len(cell.motion.marks) != len(task.stops):
        raise InputError("the motion of this cell has other stops than its task")
    plain = of_motion(cell.robot, cell.motion, cell.certificate, rate, cell.scene)
    values = {field.name: getattr(plain, field.name) for field in fields(Recording)}
    values["places"] = np.array([stop.pose(cell.robot)[0] for stop in task.stops])
    values["place_names"] = tuple(stop.name for stop in task.stops)
    around = () if cell.scene is None else places_along(task, cell.motion, cell.scene)
    return CellRecording(**values, task=task, stretches=tuple(around))
