"""A motion through stops: the stops' frames, the tubes of tool lines, and what the tool holds."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import rerun as rr

from microbot_ocp._base.checks import InputError
from microbot_ocp.comparison import Cell
from microbot_ocp.planning import Task
from microbot_ocp.robot import forward_kinematics
from microbot_ocp.views.recording._builders import of_motion
from microbot_ocp.views.recording._recording import Recording
from microbot_ocp.views.recording._surroundings import grid_spacing
from microbot_ocp.views.recording._writer import TIME, Writer

TUBE_COLOR, PART_COLOR = (0, 158, 115, 110), (213, 94, 0)
POINTS = 60  # of a tube
DENSITY = 2700.0  # kg/m^3, aluminium: a part of unknown shape is drawn as a ball of it


@dataclass(frozen=True, eq=False)
class CellRecording(Recording):
    """A recording of a motion with the task that it does."""

    task: Task | None = None

    def write(self, writer: Writer) -> None:
        """Send everything but the layout."""
        super().write(writer)
        assert self.task is not None
        for k, curve in enumerate(self.task.curves):
            if curve is not None:
                points = curve[0].points(np.linspace(0.0, 1.0, POINTS))
                tolerance = self.task.segments[k].tolerance  # type: ignore[union-attr]
                tube = rr.LineStrips3D([points], radii=tolerance, colors=[TUBE_COLOR])
                writer.static(f"world/task/tube_{k + 1}", tube)
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

    def _write_parts(self, writer: Writer) -> None:
        """What is held, as a ball at its centre of mass from where it is picked to where it goes.

        Before that and after it the ball lies where it was taken or left.
        """
        task, (arm,) = self.task, self.arms
        assert task is not None
        t = arm.times[TIME]
        marks = [mark.time for mark in arm.marks]
        leaves = [time + float(dwell) for time, dwell in zip(marks, task.dwells, strict=True)]
        tool = np.array(forward_kinematics(self.robot).map(len(t))(arm.q.T))
        tool = tool.reshape(4, len(t), 4).transpose(1, 0, 2)
        begin = 0
        while begin < len(task.payloads):
            payload, end = task.payloads[begin], begin + 1
            while end < len(task.payloads) and task.payloads[end] == payload:
                end += 1
            if payload.mass > 0:
                held = tool[:, :3, 3] + tool[:, :3, :3] @ np.array(payload.center_of_mass)
                first, last = np.searchsorted(t, [leaves[begin], leaves[end]])
                held[:first] = held[min(first, len(t) - 1)]
                held[last:] = held[min(last, len(t) - 1)]
                radius = (3.0 * payload.mass / (4.0 * np.pi * DENSITY)) ** (1.0 / 3.0)
                path = f"world/task/part_{begin + 1}"
                label = f"{payload.mass:g} kg"
                ball = rr.Points3D.from_fields(radii=[radius], colors=[PART_COLOR], labels=[label])
                writer.static(path, ball)
                writer.columns(path, arm.times, rr.Points3D.columns(positions=held))
            begin = end


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
    plain = of_motion(cell.robot, cell.motion, cell.certificate, rate)
    values = {field.name: getattr(plain, field.name) for field in fields(Recording)}
    values["places"] = np.array([stop.pose(cell.robot)[0] for stop in task.stops])
    values["place_names"] = tuple(stop.name for stop in task.stops)
    return CellRecording(**values, task=task)
