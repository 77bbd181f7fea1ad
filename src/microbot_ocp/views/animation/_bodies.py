"""The solid bodies of an arm in one pose as faces, and their picture: projected and shaded."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.robot import Mesh, Robot, Shape
from microbot_ocp.views._scene import link_origins, link_poses, reach
from microbot_ocp.views.recording import Eye, drawn_geometry

AROUND = 24  # faces around a body
CAP = 5  # rings of a rounded end
LINK, JOINT = 0.021, (0.034, 0.085)  # radius of a link, radius and length of a joint; of the reach
FOOT = (0.065, 0.02)  # radius and height of the plate under the base, of the reach
MOST_TRIANGLES = 12_000  # of a robot's own meshes: more are drawn more coarsely
FINEST, COARSER = 0.002, 1.25  # first size of a cell in which corners are one, of the robot's size
DARKEST, SHINE = 0.45, 0.45  # brightness away from the light, share of white at its reflection

Color = tuple[float, float, float]
Drawn = tuple[tuple[Shape, Mesh | None], ...]


class Faces(NamedTuple):
    """Faces with as many corners each, and a colour of 0 to 1 for each."""

    corners: FloatArray  # [N,k,3], counterclockwise from outside, base frame, m
    colors: FloatArray  # [N,3]


class Camera:
    """A pinhole: positions in the picture at unit distance, and depths, m."""

    def __init__(self, eye: Eye) -> None:
        towards = eye.position - eye.target
        self.position = eye.position
        self.towards = towards / np.linalg.norm(towards)
        right = np.cross(eye.up, self.towards)
        self.right = right / np.linalg.norm(right)
        self.above = np.cross(self.towards, self.right)
        light = 0.8 * self.towards + 0.9 * self.above - 0.6 * self.right
        self.light = light / np.linalg.norm(light)

    def project(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Positions [...,2] in the picture, and depths [...], of points [...,3], m."""
        away = points - self.position
        depth = np.maximum(-(away @ self.towards), 1e-6)
        return np.stack([away @ self.right, away @ self.above], axis=-1) / depth[..., None], depth

    def picture(self, faces: Faces) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Polygons [N,k,2] of the faces that look at the eye, the far ones first.

        With their colours [N,3] and depths [N], m.
        """
        a, b, c, d = (faces.corners[:, i] for i in (0, 1, 2, -1))
        normals = np.cross(c - a, d - b)  # of the diagonals; of a triangle c and d are one
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        sight = self.position - faces.corners.mean(axis=1)
        sight /= np.linalg.norm(sight, axis=1, keepdims=True)
        seen = np.einsum("ni,ni->n", normals, sight) > 0.0
        normals, sight = normals[seen], sight[seen]
        bright = DARKEST + (1.0 - DARKEST) * np.maximum(0.0, normals @ self.light)
        half = sight + self.light
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        shine = SHINE * np.maximum(0.0, np.einsum("ni,ni->n", normals, half)) ** 24
        colors = faces.colors[seen] * bright[:, None]
        colors = colors + shine[:, None] * (1.0 - colors)
        flat, depth = self.project(faces.corners[seen])
        depths = depth.mean(axis=1)
        order = np.argsort(-depths)
        return flat[order], colors[order], depths[order]


def arm_faces(robot: Robot, q: FloatArray, link: Color, joint: Color) -> list[Faces]:
    """Faces of an arm in the pose q [n]: its own geometry, or capsules and drums."""
    poses = link_poses(robot, q[None])[0]
    own = _own_faces(robot.shapes)
    if own:
        return [_placed(poses[frame], faces) for frame, faces in own]
    size, origins = reach(robot), link_origins(robot, q[None])[0]
    points = [robot.base[:3, 3], *origins[1:]]
    colors = np.array(link), np.array(joint)
    found = [_placed(robot.base, colored(_drum(FOOT[0] * size, FOOT[1] * size), colors[1]))]
    for start, end in pairwise(points):
        if np.linalg.norm(end - start) > 1e-6 * size:
            found.append(colored(capsule_faces(start, end, LINK * size), colors[0]))
    radius, length = (share * size for share in JOINT)
    for pose, kind in zip(poses[1:-1], robot.joint_types, strict=True):
        corners = _drum(radius, length) if kind == "revolute" else box_faces(radius, length)
        found.append(_placed(pose, colored(corners, colors[1])))
    return found


def colored(corners: FloatArray, color: FloatArray) -> Faces:
    """Faces [N,k,3] of one colour [3]."""
    return Faces(corners, np.broadcast_to(color, (len(corners), 3)))


def _placed(pose: FloatArray, faces: Faces) -> Faces:
    return faces._replace(corners=faces.corners @ pose[:3, :3].T + pose[:3, 3])


@lru_cache(maxsize=8)
def _own_faces(shapes: tuple[Shape, ...]) -> tuple[tuple[int, Faces], ...]:
    """Frame and faces of each shape of a robot's file."""
    found = _thinned(drawn_geometry(shapes).shapes)
    faces = []
    for shape, mesh in found:
        color = np.array((0.75, 0.77, 0.80) if shape.color is None else shape.color[:3])
        colors = None
        if mesh is not None:
            corners = mesh.vertices[mesh.triangles]
            if mesh.colors is not None and shape.color is None:
                colors = mesh.colors[mesh.triangles[:, 0], :3] / 255.0
        elif shape.kind == "box":
            corners = box_faces(*shape.size / 2)
        elif shape.kind == "cylinder":
            corners = _drum(*shape.size)
        else:
            half = np.array([0.0, 0.0, shape.size[1] / 2 if shape.kind == "capsule" else 0.0])
            corners = capsule_faces(-half, half, shape.size[0])
        drawn = Faces(corners, colors) if colors is not None else colored(corners, color)
        faces.append((shape.frame, _placed(shape.pose, drawn)))
    return tuple(faces)


def _thinned(found: Drawn) -> Drawn:
    """The same shapes, their meshes with so many triangles together as a picture can do with."""
    meshes = [mesh for _, mesh in found if mesh is not None]
    if sum(len(mesh.triangles) for mesh in meshes) <= MOST_TRIANGLES:
        return found
    cell = FINEST * sum(float(np.ptp(mesh.vertices, axis=0).max()) for mesh in meshes)
    while True:
        coarser = [None if m is None else _with_corners_joined(m, cell) for _, m in found]
        if sum(len(m.triangles) for m in coarser if m is not None) <= MOST_TRIANGLES:
            return tuple((shape, m) for (shape, _), m in zip(found, coarser, strict=True))
        cell *= COARSER


def _with_corners_joined(mesh: Mesh, cell: float) -> Mesh:
    """The mesh with one corner, their mean, for all in a cell of a cubic grid of this size, m."""
    places, index = np.unique(np.floor(mesh.vertices / cell), axis=0, return_inverse=True)
    index = index.ravel()
    counts = np.bincount(index, minlength=len(places))[:, None]
    sums = np.zeros_like(places)
    np.add.at(sums, index, mesh.vertices)
    triangles = index[mesh.triangles]
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    kept = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)[1]
    colors = mesh.colors
    if colors is not None:
        first = np.zeros(len(places), dtype=int)
        first[index[::-1]] = np.arange(len(index))[::-1]
        colors = colors[first]
    return Mesh(sums / counts, triangles[kept], colors)


def quadrilaterals(rings: FloatArray) -> FloatArray:
    """Quadrilaterals [(m-1) k,4,3] between rings [m,k,3] that go around counterclockwise."""
    after = np.roll(rings, -1, axis=1)
    corners = np.stack([rings[:-1], after[:-1], after[1:], rings[1:]], axis=2)
    return corners.reshape(-1, 4, 3)


def _circle() -> FloatArray:
    angle = 2 * np.pi * np.arange(AROUND) / AROUND
    return np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)


def _turned(start: Any, end: Any) -> Any:
    """A rotation [3,3] that takes z along the way from start to end."""
    along = end - start
    length = np.linalg.norm(along)
    z = along / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
    x = np.cross(z, np.eye(3)[int(np.abs(z).argmin())])
    x = x / float(np.linalg.norm(x))
    return np.array([x, np.cross(z, x), z], dtype=float).T


def capsule_faces(start: FloatArray, end: FloatArray, radius: float) -> FloatArray:
    """A cylinder with round ends between two points."""
    length = np.linalg.norm(end - start)
    latitude = np.linspace(-np.pi / 2, 0.0, CAP + 1)
    below = [np.cos(v) * _circle() + [0.0, 0.0, np.sin(v)] for v in latitude]
    above = [ring * [1.0, 1.0, -1.0] for ring in reversed(below)]
    lengths = np.linspace(0.0, length, max(2, int(length / (2 * radius))))  # short faces sort well
    rings = [radius * ring for ring in below]
    rings += [radius * below[-1] + [0.0, 0.0, v] for v in lengths[1:-1]]
    rings += [radius * ring + [0.0, 0.0, length] for ring in above]
    return quadrilaterals(np.array(rings)) @ _turned(start, end).T + start


def _drum(radius: float, length: float) -> FloatArray:
    """A cylinder along z about the origin, with the edges rounded off a little."""
    return cylinder_faces(radius, length, 0.12 * radius)


def cylinder_faces(radius: float, length: float, bevel: float = 0.0) -> FloatArray:
    """A cylinder along z about the origin."""
    half = length / 2
    profile = [(0.0, -half), (radius - bevel, -half), (radius, bevel - half)]
    profile += [(r, -z) for r, z in reversed(profile)]
    rings = [r * _circle() + [0.0, 0.0, z] for r, z in profile]
    return quadrilaterals(np.array(rings))


def box_faces(x: float, y: float, z: float | None = None) -> FloatArray:
    """A box about the origin of half edges x, y, z; of two, a square bar along z."""
    half = np.array([x, y, z]) if z is not None else np.array([x, x, y / 2])
    square = np.array([[1, -1, 0], [1, 1, 0], [-1, 1, 0], [-1, -1, 0]])
    levels = [(0.0, -1.0), (1.0, -1.0), (1.0, 1.0), (0.0, 1.0)]
    return quadrilaterals(np.array([r * square + [0.0, 0.0, v] for r, v in levels])) * half
