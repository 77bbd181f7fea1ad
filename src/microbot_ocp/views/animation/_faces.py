"""Faces of solid bodies, and their projection with shading and depth sorting."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from microbot_ocp._base.checks import ROUNDING, FloatArray
from microbot_ocp.robot import Capsule, Robot, Shape, TriangleMesh
from microbot_ocp.views import _palette as palette
from microbot_ocp.views._eye import Eye
from microbot_ocp.views._scene import reach
from microbot_ocp.views._solids import Solid, Tube, capsule_solid, drawn_geometry, joint_solid
from microbot_ocp.views._style import FRAME_LENGTH, LINE_RADIUS, LINK_RADIUS, Color

# Edge of an obstacle's face in a film, relative to the reach: depth sorting needs small faces.
LONGEST_EDGE = 0.07
MOST_TRIANGLES = 12_000  # triangles of a robot's meshes in a film; larger meshes are simplified
SQUARE = np.array([[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]])
CUBE = np.array([s * np.roll(SQUARE[::s], k, axis=1) for k in range(3) for s in (1, -1)])


class Faces(NamedTuple):
    """Quadrilaterals [N,4,3], m, counterclockwise seen from outside, and colours [N,3], 0 to 1."""

    corners: FloatArray
    colors: FloatArray

    def placed(self, pose: FloatArray) -> Faces:
        """Return the faces transformed by a pose [4,4]."""
        return self._replace(corners=self.corners @ pose[:3, :3].T + pose[:3, 3])


def joined(faces: Sequence[Faces]) -> Faces:
    """Return the faces of several bodies as one."""
    corners, colors = zip(*faces, strict=True)
    return Faces(np.concatenate(corners), np.concatenate(colors))


class Camera:
    """Pinhole camera with the picture plane at unit distance."""

    def __init__(self, eye: Eye) -> None:
        self.position, self.axes = eye.position, eye.axes
        self.light = _unit(np.array([-1.0, 1.0, 1.0]) @ self.axes)

    def project(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return picture positions [...,2] and depths [...], m, of points [...,3], m."""
        seen = (points - self.position) @ self.axes.T
        depth = np.maximum(-seen[..., 2], 1e-6)
        return seen[..., :2] / depth[..., None], depth

    def picture(self, faces: Faces) -> tuple[FloatArray, FloatArray]:
        """Return polygons [N,4,2] and colours [N,3] of the visible sides, the farthest first."""
        a, b, c, d = np.moveaxis(faces.corners, 1, 0)
        normals = _unit(np.cross(c - a, d - b))  # cross product of the diagonals; triangles: c = d
        sight = _unit(self.position - faces.corners.mean(axis=1))
        seen = np.einsum("ni,ni->n", normals, sight) > 0.0
        bright = 0.5 + 0.5 * np.maximum(0.0, normals[seen] @ self.light)
        # Painter's algorithm: draw far faces first.
        flat, depth = self.project(faces.corners[seen])
        order = np.argsort(-depth.mean(axis=1), kind="stable")
        return flat[order], (faces.colors[seen] * bright[:, None])[order]


def arm_bodies(
    robot: Robot, poses: FloatArray, link: Color, joint: Color
) -> Sequence[tuple[int, Faces]]:
    """Return the robot's geometry, or else capsules and drums, with link frames (0 is the base).

    ``poses`` [links+2,4,4] are from :func:`link_poses`. Only the capsule along a prismatic joint
    depends on the pose.
    """
    geometry = _geometry(robot.shapes)
    if geometry:
        return geometry
    size = reach(robot)
    edge, radius = LONGEST_EDGE * size, LINK_RADIUS * size
    bodies = [
        (0, Solid("cylinder", size * np.array([FRAME_LENGTH, 4 * LINE_RADIUS]), robot.base, joint))
    ]
    starts = [robot.base[:3, 3], *np.zeros((robot.link_count, 3))]
    for frame, (start, (pose, after)) in enumerate(zip(starts, pairwise(poses), strict=True)):
        end = pose[:3, :3].T @ (after[:3, 3] - pose[:3, 3])
        if np.linalg.norm(end - start) > ROUNDING * size:
            bodies.append((frame, capsule_solid(Capsule(start, end, radius), link)))
    for frame, kind in enumerate(robot.chain.joint_types, start=1):
        bodies.append((frame, joint_solid(kind, radius, joint)))
    return [(frame, solid_faces(solid, edge)) for frame, solid in bodies]


@lru_cache(maxsize=8)
def _geometry(shapes: tuple[Shape, ...]) -> tuple[tuple[int, Faces], ...]:
    """Return frame and faces of each shape of a robot; large meshes are simplified."""
    solids, cell = drawn_geometry(shapes).solids, 0.0
    meshes = [solid.mesh for _, solid in solids if solid.mesh is not None]
    finest = 0.002 * sum(float(np.ptp(mesh.vertices, axis=0).max()) for mesh in meshes)
    while True:
        faces = [(frame, solid_faces(solid, np.inf, cell)) for frame, solid in solids]
        pairs = zip(faces, solids, strict=True)
        if sum(len(f.corners) for (_, f), (_, s) in pairs if s.mesh) <= MOST_TRIANGLES:
            return tuple(faces)
        cell = max(finest, 1.5 * cell)


def solid_faces(solid: Solid, edge: float, cell: float = 0.0) -> Faces:
    """Return the faces of a solid in the frame of its pose, with edges up to ``edge``, m.

    Vertices of a mesh within one grid cell of size ``cell``, m, are merged.
    """
    color = np.array(solid.color[:3]) / 255.0
    if solid.mesh is not None:
        return _mesh_faces(solid.mesh, color, cell).placed(solid.pose)
    corners = _corners(solid.kind, tuple(np.round(solid.size, 9).tolist()), edge)
    return Faces(corners, np.broadcast_to(color, (len(corners), 3))).placed(solid.pose)


def _mesh_faces(mesh: TriangleMesh, color: FloatArray, cell: float) -> Faces:
    vertices, triangles = mesh.vertices, mesh.triangles
    colors = np.broadcast_to(color, (len(triangles), 3))
    if mesh.colors is not None:
        colors = mesh.colors[triangles[:, 0], :3] / 255.0
    if cell:  # replace the vertices in each cell of a cubic grid by their mean
        cells, index = np.unique(np.floor(vertices / cell), axis=0, return_inverse=True)
        sums = np.zeros_like(cells)
        np.add.at(sums, index.ravel(), vertices)
        vertices = sums / np.bincount(index.ravel(), minlength=len(cells))[:, None]
        triangles = index.ravel()[triangles]
        # Remove triangles that have collapsed or coincide after the merge.
        a, b, c = triangles.T
        once = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)[1]
        once = once[((a != b) & (b != c) & (c != a))[once]]
        triangles, colors = triangles[once], colors[once]
    return Faces(vertices[triangles[:, [0, 1, 2, 2]]], colors)


@lru_cache(maxsize=256)
def _corners(kind: str, size: tuple[float, ...], edge: float) -> FloatArray:
    if kind == "box":
        return np.concatenate([_split(face * np.array(size) / 2, edge) for face in CUBE])
    if kind == "plane":
        return _split(SQUARE * [size[0] / 2, size[1] / 2, 0.0], edge)
    radius, half = size[0], size[1] / 2 if len(size) > 1 else 0.0
    if kind == "cylinder":
        below = [(0.0, -half), (radius, -half)]
    else:
        turns = np.linspace(-np.pi / 2, 0, 6)
        below = [(radius * np.cos(turn), radius * np.sin(turn) - half) for turn in turns]
    profile = np.array([*below, *((r, -z) for r, z in reversed(below))])
    fine = [_along(a, b, edge)[:-1] for a, b in pairwise(profile)]
    rings = np.concatenate([*fine, profile[-1:]])
    angle = 2 * np.pi * np.arange(24) / 24
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    level = np.broadcast_to(rings[:, 1, None, None], (len(rings), 24, 1))
    return _between(np.concatenate([rings[:, :1, None] * circle, level], axis=2))


def _between(rings: FloatArray) -> FloatArray:
    """Return quadrilaterals [(m-1) k,4,3] between counterclockwise rings [m,k,3]."""
    after = np.roll(rings, -1, axis=1)
    corners = np.stack([rings[:-1], after[:-1], after[1:], rings[1:]], axis=2)
    return corners.reshape(-1, 4, 3)


def _along(a: FloatArray, b: FloatArray, edge: float) -> FloatArray:
    """Return points from a to b with distances up to ``edge``."""
    return np.linspace(a, b, int(np.ceil(np.linalg.norm(b - a) / edge)) + 1 if edge < np.inf else 2)


def _split(corners: FloatArray, edge: float) -> FloatArray:
    """Split a rectangle [4,3] into patches [N,4,3]."""
    a, b, _, d = corners
    grid = _along(a, b, edge)[:, None] + _along(a, d, edge)[None] - a
    patches = np.stack([grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]], axis=2)
    return patches.reshape(-1, 4, 3)


def tube_faces(tube: Tube, size: float) -> Faces:
    """Return the wall of a tube, with a radius that is visible beside an arm of ``size``, m."""
    along = _unit(np.gradient(tube.points, axis=0))
    side = np.eye(3)[int(np.abs(along).max(axis=0).argmin())]
    angle, rings = 2 * np.pi * np.arange(8)[:, None] / 8, []
    for point, direction in zip(tube.points, along, strict=True):
        side = _unit(side - (side @ direction) * direction)
        ring = np.cos(angle) * side + np.sin(angle) * np.cross(direction, side)
        rings.append(point + max(tube.radius, LINE_RADIUS * size) * ring)
    corners = _between(np.array(rings))
    color = np.array(palette.TUBE[:3]) / 255.0
    return Faces(corners, np.broadcast_to(color, (len(corners), 3)))


def _unit(vectors: FloatArray) -> FloatArray:
    return vectors / np.maximum(
        np.linalg.norm(vectors, axis=-1, keepdims=True), np.finfo(float).tiny
    )
