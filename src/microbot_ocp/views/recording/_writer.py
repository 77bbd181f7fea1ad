"""Writer of recordings: entity paths, timelines, and files that are complete or absent.

``docs/recordings.md`` describes the tree.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from microbot_ocp._base.checks import ROUNDING, FloatArray
from microbot_ocp._base.table import Table
from microbot_ocp._base.writing import check_writable, write_whole
from microbot_ocp.robot import TriangleMesh
from microbot_ocp.views import _palette as palette
from microbot_ocp.views._solids import Solid
from microbot_ocp.views._style import Color

LIMIT_DASHES = 40  # dashes of a limit's line over the whole timeline
APPLICATION = "microbot_ocp"

TIME = "sim_time"  # time since the start of the motion, s
PROGRESS = "progress_permille"  # share of the joint path travelled, 0 to 1000
BRANCH = "branch"  # number of a solution, from 1
Times = Mapping[str, FloatArray]  # values [N] by timeline: s on TIME, integers on the others

SUMMARY = "summary"
MARKS = "marks"
WORLD = "world"
LIMIT_WIDTH = 1.2  # width of the curve of a limit, points


def plot_path(*parts: str) -> str:
    """Return the path of curves from the quantity, the joint (if any) and the arm."""
    return rr.new_entity_path(["plots", *parts])


@dataclass(frozen=True)
class Writer:
    """Writer to a stream that raises an exception where Rerun only warns."""

    stream: rr.RecordingStream

    def static(self, path: str, entity: rr.AsComponents) -> None:
        """Log an entity that does not change over time."""
        self.stream.log(path, entity, static=True, strict=True)

    def columns(self, path: str, times: Times, columns: Iterable[rr.ComponentColumn]) -> None:
        """Log one row per time in one call."""
        indexes = [_time_column(timeline, values) for timeline, values in times.items()]
        self.stream.send_columns(path, indexes=indexes, columns=columns, strict=True)

    def summary(self, table: Table) -> None:
        """Log a table with its title and notes as Markdown."""
        text = replace(table, title="", notes=[note for note in table.notes if note]).markdown()
        document = rr.TextDocument(f"**{table.title}**\n\n{text}", media_type="text/markdown")
        self.static(SUMMARY, document)

    def curve(
        self,
        path: str,
        times: Times,
        values: FloatArray,
        name: str = "limit",
        color: Color = palette.DULL,
        width: float = LIMIT_WIDTH,
    ) -> None:
        """Log a curve of values [N]; the default style is that of a varying bound."""
        self._line(path, name, color, width)
        self.columns(path, times, rr.Scalars.columns(scalars=values))

    def dashes(self, path: str, spans: Sequence[tuple[Times, float]]) -> None:
        """Log a dashed horizontal line for each span: begin and end [2] by timeline, and a value.

        Rows without a value interrupt the line.
        """
        spans = [span for span in spans if all(begin < end for begin, end in span[0].values())]
        if not spans:
            return
        gap = 1e-6  # offset of the row without a value after a dash, relative to the span
        edges = np.linspace(0.0, 1.0 - gap, 2 * LIMIT_DASHES)
        share = np.column_stack([edges[::2], edges[1::2], edges[1::2] + gap]).ravel()
        times = {
            key: np.concatenate([span[key][0] + np.diff(span[key]) * share for span, _ in spans])
            for key in spans[0][0]
        }
        self._line(path, "limit", palette.DULL, LIMIT_WIDTH)
        scalars = rr.Scalars.columns(scalars=np.repeat([at for _, at in spans], len(edges)))
        lengths = np.tile([1, 1, 0], LIMIT_DASHES * len(spans))
        self.columns(path, times, scalars.partition(lengths=lengths))

    def level(self, path: str, value: float | None, end: Times) -> None:
        """Log a dashed line at a value over the timelines up to ``end`` [1]; None draws nothing."""
        if value is not None:
            whole = {key: np.array([0.0, last[0]]) for key, last in end.items()}
            self.dashes(path, [(whole, value)])

    def _line(self, path: str, name: str, color: Color, width: float) -> None:
        self.static(path, rr.SeriesLines.from_fields(names=[name], colors=[color], widths=[width]))

    def strips(self, path: str, radius: float, color: Color) -> None:
        """Log the style of the lines in space at a path."""
        self.static(path, rr.LineStrips3D.from_fields(radii=[radius], colors=[color]))

    def frame(self, path: str, pose: FloatArray) -> None:
        """Log a constant pose [4,4]."""
        self.static(path, rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]))

    def solid(self, path: str, solid: Solid) -> None:
        """Log a body in its frame."""
        if not np.array_equal(solid.pose, np.eye(4)):
            self.frame(path, solid.pose)
        self.static(path, _shape(solid))


def _shape(solid: Solid) -> Any:
    size, mesh = solid.size, solid.mesh
    style: dict[str, Any] = {"colors": [solid.color], "fill_mode": "solid"}
    if mesh is not None:
        return rr.Mesh3D(
            vertex_positions=mesh.vertices.astype(np.float32),
            triangle_indices=mesh.triangles,
            vertex_normals=_normals(mesh).astype(np.float32),
            vertex_colors=mesh.colors,
            albedo_factor=None if mesh.colors is not None else solid.color,
        )
    if solid.kind == "sphere":
        return rr.Ellipsoids3D(radii=[size[0]], **style)
    if solid.kind == "cylinder":
        return rr.Cylinders3D(radii=[size[0]], lengths=[size[1]], **style)
    if solid.kind == "capsule":  # capsules of Rerun begin at their origin
        start = [[0.0, 0.0, -size[1] / 2]]
        return rr.Capsules3D(radii=[size[0]], lengths=[size[1]], translations=start, **style)
    middle = [[0.0, 0.0, -size[2] / 2 if solid.kind == "plane" else 0.0]]
    return rr.Boxes3D(half_sizes=[size / 2], centers=middle, **style)


def _normals(mesh: TriangleMesh) -> FloatArray:
    """Return the unit normals [N,3] of the vertices, which the viewer needs for shading."""
    corners = mesh.vertices[mesh.triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(mesh.vertices)
    for corner in range(3):
        np.add.at(normals, mesh.triangles[:, corner], across)
    size = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.divide(normals, size, out=np.zeros_like(normals), where=size > 0)


def _time_column(timeline: str, values: FloatArray) -> rr.TimeColumn:
    if timeline == TIME:
        return rr.TimeColumn(timeline, duration=values)
    return rr.TimeColumn(timeline, sequence=np.asarray(values, dtype=np.int64))


@contextmanager
def file_writer(
    path: str | Path, blueprint: rrb.Blueprint | None = None, application: str = APPLICATION
) -> Iterator[Writer]:
    """Yield a writer of a file with its layout; the file appears after the last write.

    A viewer keeps one layout per ``application``. The recording is collected in memory, because
    Rerun's file sink blocks for ever on a full disk.
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
    """Return unit quaternions [N,4] (x, y, z, w) of rotation matrices [N,3,3].

    The matrix 4 q q' is linear in the rotation matrix, and each of its rows is a multiple of q. The
    row with the largest diagonal entry is normalised, because it is far from zero.
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
    """Return quaternions [N,4] that rotate the z axis into the directions of vectors [N,3]."""
    length = np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), np.finfo(float).tiny)
    x, y, z = (vectors / length).T
    turned = np.column_stack([-y, x, np.zeros_like(x), 1 + z])
    turned[z < -1 + ROUNDING] = (1.0, 0.0, 0.0, 0.0)  # half a turn about x: the axis is not unique
    return turned / np.linalg.norm(turned, axis=1, keepdims=True)
