"""Where a recording goes: its entity paths and timelines, and a file that is whole or absent.

``docs/recordings.md`` describes the tree.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.table import Table
from microbot_ocp._base.writing import check_writable, write_whole
from microbot_ocp.robot import Robot

APPLICATION = "microbot_ocp"

TIME = "sim_time"  # duration since the start of the motion, s
PROGRESS = "progress_permille"  # share of the joint path travelled, 0 to 1000
BRANCH = "branch"  # number of a solution, from 1
WHOLE = 1000  # the last value of PROGRESS
Times = Mapping[str, FloatArray]  # values [N] by timeline: s on TIME, whole numbers elsewhere

SUMMARY = "summary"
MARKS = "marks"
SATURATION = "saturation"
PHASES = "phases"
WORLD = "world"
BASE = "world/base"
PLACES = "world/places"
TARGET = "world/target"


def arm_path(name: str, *below: str) -> str:
    """Path of an arm, or of something below it."""
    return "/".join([WORLD, name, *below])


def link_path(name: str, frame: int, *below: str) -> str:
    """Path of the link frame ``frame`` (0 is the base) of an arm, or of something in it."""
    return arm_path(name, f"link_{frame}", *below)


def tool_path(name: str, *below: str) -> str:
    """Path of an arm's tool, which does not turn, or of something at it."""
    return arm_path(name, "tool", *below)


def plot_path(*parts: str) -> str:
    """Path of curves: a quantity, then the joint if it has one, then whose it is."""
    return rr.new_entity_path(["plots", *parts])


def lane_path(robot: Robot, name: str, joint: int | None) -> str:
    """Path of the lane of a joint (0-based), or of limits that are not of a joint.

    Lanes are shown in the order of their paths.
    """
    count = robot.joint_count
    number = count + 1 if joint is None else joint + 1
    label = "other" if joint is None else robot.joint_names[joint].replace(" ", "_")
    return rr.new_entity_path([SATURATION, name, f"{number:0{len(str(count))}d}_{label}"])


@dataclass(frozen=True)
class Writer:
    """Writes to a stream, and raises where Rerun would only warn."""

    stream: rr.RecordingStream

    def static(
        self, path: str, *what: rr.AsComponents | Iterable[rr.DescribedComponentBatch]
    ) -> None:
        """Log what never changes."""
        self.stream.log(path, *what, static=True, strict=True)

    def columns(self, path: str, times: Times, columns: Iterable[rr.ComponentColumn]) -> None:
        """Log a row for every time, in one call."""
        indexes = [_time_column(timeline, values) for timeline, values in times.items()]
        self.stream.send_columns(path, indexes=indexes, columns=columns, strict=True)

    def summary(self, table: Table) -> None:
        """Log a table with its title and notes as Markdown."""
        text = replace(table, title="", notes=[note for note in table.notes if note]).markdown()
        document = rr.TextDocument(f"**{table.title}**\n\n{text}", media_type="text/markdown")
        self.static(SUMMARY, document)

    def layout(self, blueprint: rrb.Blueprint) -> None:
        """Send a layout that was not known at the start."""
        self.stream.send_blueprint(blueprint)


def _time_column(timeline: str, values: FloatArray) -> rr.TimeColumn:
    if timeline == TIME:
        return rr.TimeColumn(timeline, duration=values)
    return rr.TimeColumn(timeline, sequence=np.asarray(values, dtype=np.int64))


@contextmanager
def file_writer(
    path: str | Path, blueprint: rrb.Blueprint | None = None, application: str = APPLICATION
) -> Iterator[Writer]:
    """Writer of a file with its layout inside; the file appears when all is written.

    A viewer keeps one layout for each ``application``. The recording is gathered in memory: Rerun's
    own file sink waits for ever on a full disk.
    """
    check_writable(path)
    stream = rr.RecordingStream(application)
    try:
        memory = stream.memory_recording()
        if blueprint is not None:
            stream.send_blueprint(blueprint, make_active=False, make_default=True)
        yield Writer(stream)
        content = memory.drain_as_bytes()
    finally:
        stream.disconnect()
    write_whole(path, content)


def quaternions(rotations: FloatArray) -> FloatArray:
    """Unit quaternions [N,4] (x, y, z, w) of rotation matrices [N,3,3].

    4 q q' is linear in the matrix, and every row of it is a multiple of q; the row with the
    largest diagonal entry is far from zero.
    """
    r = rotations
    square = np.empty((len(r), 4, 4))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        square[:, i, i] = 1 + r[:, i, i] - r[:, j, j] - r[:, k, k]
        square[:, i, j] = square[:, j, i] = r[:, i, j] + r[:, j, i]
        square[:, i, 3] = square[:, 3, i] = r[:, k, j] - r[:, j, k]
    square[:, 3, 3] = 1 + np.trace(r, axis1=1, axis2=2)
    best = np.diagonal(square, axis1=1, axis2=2).argmax(axis=1)
    rows = square[np.arange(len(r)), best]
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def along_z(vectors: FloatArray) -> FloatArray:
    """Quaternions [N,4] that turn the z axis into the directions of vectors [N,3]."""
    length = np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12)
    x, y, z = (vectors / length).T
    turned = np.column_stack([-y, x, np.zeros_like(x), 1 + z])
    turned[z < -1 + 1e-9] = (1.0, 0.0, 0.0, 0.0)  # half a turn, about any level axis
    return turned / np.linalg.norm(turned, axis=1, keepdims=True)
