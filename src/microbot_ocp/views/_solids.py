"""Solid bodies for recordings and films: a robot's geometry, obstacles, carried parts.

Recordings write a :class:`Solid` as a shape of Rerun, films draw its faces, and the choice of the
viewpoint tests whether it hides the arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.planning import Payload
from microbot_ocp.planning.search import Place, parts_of, places_along, tool_poses
from microbot_ocp.robot import Capsule, Robot, Shape, TriangleMesh, read_mesh, transform_of
from microbot_ocp.scene import (
    Box,
    ConvexMesh,
    Cylinder,
    HalfSpace,
    Nearest,
    Scene,
    Sphere,
    contact_model,
    has_coal,
    rotation_to,
)
from microbot_ocp.tasks import Cell
from microbot_ocp.views import _palette as palette
from microbot_ocp.views._scene import reach
from microbot_ocp.views._style import LINE_RADIUS, Color

JOINT_SIZE = (1.5, 3.6)  # radius and length of a joint's drum, in link radii
HALF_SPACE_EDGE = 1.0  # half the edge of the drawn part of a half space, relative to the reach


class Solid(NamedTuple):
    """Body, centred at its frame.

    Attributes
    ----------
    kind : str
        "box", "sphere", "cylinder", "capsule", "mesh", or "plane" (top side at z = 0).
    size : array
        Box and plane: edge lengths [3], m. Sphere: radius [1]. Cylinder and capsule, along z:
        radius and length [2]; the length of a capsule excludes its caps.
    pose : array [4,4]
        Pose in the frame of the link or world that the body is fixed to.
    color : Color
    mesh : TriangleMesh, optional
    """

    kind: str
    size: FloatArray
    pose: FloatArray
    color: Color
    mesh: TriangleMesh | None = None


class Geometry(NamedTuple):
    """Drawn geometry of a robot per frame, with sentences on missing parts."""

    solids: tuple[tuple[int, Solid], ...]
    missing: tuple[str, ...]


@lru_cache(maxsize=8)
def drawn_geometry(shapes: tuple[Shape, ...]) -> Geometry:
    """Return the visual shapes, or collision shapes for links without; empty if a file is bad."""
    visual = {shape.link for shape in shapes if shape.role == "visual"}
    chosen = [s for s in shapes if s.role == "visual" or s.link not in visual]
    try:
        return Geometry(tuple((shape.frame, _of_shape(shape)) for shape in chosen), ())
    except InputError as problem:
        return Geometry((), (f"Links are drawn as capsules: {problem}.",))


def _of_shape(shape: Shape) -> Solid:
    mesh, color = read_mesh(shape) if shape.kind == "mesh" else None, palette.METAL
    if shape.color is not None:
        red, green, blue, alpha = (*(round(255 * part) for part in shape.color), 255)[:4]
        color = (red, green, blue, alpha)
        mesh = None if mesh is None else mesh._replace(colors=None)
    return Solid(shape.kind, shape.size, shape.pose, color, mesh)


def joint_solid(kind: str, radius: float, color: Color) -> Solid:
    """Return a drum about the axis of a revolute joint, or a bar along a prismatic axis.

    ``radius`` is the drawn radius of a link, m.
    """
    thick, length = (factor * radius for factor in JOINT_SIZE)
    if kind == "revolute":
        return Solid("cylinder", np.array([thick, length]), np.eye(4), color)
    return Solid("box", np.array([2 * thick, 2 * thick, length]), np.eye(4), color)


def capsule_solid(capsule: Capsule, color: Color) -> Solid:
    """Return a capsule as a solid, in the frame of its end points."""
    along = capsule.end - capsule.start
    length = float(np.linalg.norm(along))
    rotation = rotation_to(along / length if length else np.eye(3)[2])
    pose = transform_of(rotation, (capsule.start + capsule.end) / 2)
    return Solid("capsule", np.array([capsule.radius, length]), pose, color)


def _ball(center: FloatArray, radius: float, color: Color) -> Solid:
    return Solid("sphere", np.array([radius]), transform_of(np.eye(3), center), color)


def obstacle_solid(obstacle: Any, robot: Robot) -> Solid:
    """Return an obstacle of a scene as a solid; a half space is a plate near the robot."""
    color, size = palette.OBSTACLE, reach(robot)
    if isinstance(obstacle, Capsule):
        return capsule_solid(obstacle, color)
    if isinstance(obstacle, HalfSpace):
        normal, base = obstacle.normal, robot.base[:3, 3]
        foot = base + (obstacle.offset - normal @ base) * normal
        pose = transform_of(rotation_to(normal), foot)
        edges = size * np.array([2 * HALF_SPACE_EDGE, 2 * HALF_SPACE_EDGE, 4 * LINE_RADIUS])
        return Solid("plane", edges, pose, (*color[:3], 90))
    if isinstance(obstacle, Sphere):
        return _ball(obstacle.center, obstacle.radius, color)
    if isinstance(obstacle, Box):
        return Solid("box", obstacle.size, obstacle.pose, color)
    if isinstance(obstacle, Cylinder):
        size = np.array([obstacle.radius, obstacle.length])
        return Solid("cylinder", size, obstacle.pose, color)
    assert isinstance(obstacle, ConvexMesh)
    corners = obstacle.vertices[obstacle.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outward = corners.mean(axis=1) - obstacle.vertices.mean(axis=0)
    inside_out = np.einsum("ni,ni->n", normals, outward) < 0.0  # hulls have no fixed orientation
    triangles = np.where(inside_out[:, None], obstacle.triangles[:, ::-1], obstacle.triangles)
    mesh = TriangleMesh(obstacle.vertices, triangles, None)
    return Solid("mesh", np.ones(3), obstacle.pose, color, mesh)


def part_solids(payload: Payload) -> list[Solid]:
    """Return the capsules of a part; without a shape a ball of aluminium (2700 kg/m^3)."""
    if payload.shape:
        return [capsule_solid(capsule, palette.PART) for capsule in payload.shape]
    radius = np.cbrt(3.0 * payload.mass / (4.0 * np.pi * 2700.0))
    return [_ball(payload.center_of_mass, radius, palette.PART)] if payload.mass else []


def is_inside(solid: Solid, points: FloatArray) -> Any:
    """Return a mask of the points [N,3] inside a solid; a mesh counts as its bounding box."""
    x = (points - solid.pose[:3, 3]) @ solid.pose[:3, :3]
    if solid.kind == "plane":
        return x[:, 2] < 0.0
    if solid.kind == "box":
        return (np.abs(x) < solid.size / 2).all(axis=1)
    if solid.mesh is not None:
        low, high = solid.mesh.vertices.min(axis=0), solid.mesh.vertices.max(axis=0)
        return ((x > low) & (x < high)).all(axis=1)
    half = solid.size[1] / 2 if len(solid.size) > 1 else 0.0
    if solid.kind == "cylinder":
        return (np.hypot(x[:, 0], x[:, 1]) < solid.size[0]) & (np.abs(x[:, 2]) < half)
    x[:, 2] -= np.clip(x[:, 2], -half, half)
    return np.linalg.norm(x, axis=1) < solid.size[0]


def hidden_share(eye: FloatArray, points: FloatArray, solids: Sequence[Solid]) -> float:
    """Return the share of points [N,3] that a solid hides from an eye [3]."""
    along = np.linspace(0.0, 1.0, 42)[1:-1, None, None]
    between = (eye + along * (points - eye)).reshape(-1, 3)
    hidden = np.zeros(len(points), dtype=bool)
    for solid in solids:
        hidden |= is_inside(solid, between).reshape(len(along), -1).any(axis=0)
    return float(hidden.mean())


class CarriedPart(NamedTuple):
    """Carried part with the poses [N,4,4] of its frame at the samples of the motion."""

    payload: Payload
    poses: FloatArray


class Tube(NamedTuple):
    """Tolerance tube of a tool line: points [k,3] and radius, m."""

    points: FloatArray
    radius: float


@dataclass(frozen=True, eq=False)
class DrawnSurroundings:
    """Surroundings of a moving arm.

    Attributes
    ----------
    scene : Scene, optional
    stretches : tuple of Place
        Intervals of time with the arm (and its payload) and the scene of each.
    tubes : tuple of Tube
    stops : tuple of array [4,4]
        Poses of the stops that have an orientation.
    parts : tuple of CarriedPart
        Parts that the arm carries, with their rest poses before and after.
    """

    scene: Scene | None = None
    stretches: tuple[Place, ...] = ()
    tubes: tuple[Tube, ...] = ()
    stops: tuple[FloatArray, ...] = ()
    parts: tuple[CarriedPart, ...] = ()

    @classmethod
    def of_scene(cls, robot: Robot, scene: Scene | None) -> DrawnSurroundings:
        """Return the surroundings with the fixed obstacles of a scene."""
        return cls(scene, () if scene is None else (Place(0.0, np.inf, robot, scene),))

    @classmethod
    def of_cell(cls, cell: Cell, t: FloatArray, q: FloatArray) -> DrawnSurroundings:
        """Return the surroundings for the task of a cell; the arm is at q [N,n] at times t [N]."""
        task, marks = cell.task, cell.motion.marks
        if len(marks) != len(task.stops):
            raise InputError("the motion of this cell has other stops than its task")
        leaves = [mark.time + float(d) for mark, d in zip(marks, task.dwells, strict=True)]
        at = np.minimum(np.searchsorted(t, leaves), len(t) - 1)  # sample at the end of each rest
        tool, parts = tool_poses(cell.robot, q), []
        for part in parts_of(task, tool[at]):
            poses = np.repeat(tool[None, at[part.carries[0][0]]], len(t), axis=0)
            for first, end in part.carries:
                poses[at[first] : at[end]] = tool[at[first] : at[end]]
                poses[at[end] :] = tool[at[end]]
            parts.append(CarriedPart(part.payload, poses))
        poses = (stop.pose(cell.robot) for stop in task.stops)
        stops = [transform_of(turned, place) for place, turned in poses if turned is not None]
        tubes = [
            Tube(curve[0].points(np.linspace(0.0, 1.0, 60)), segment.tolerance)  # type: ignore[union-attr]
            for curve, segment in zip(task.curves, task.segments, strict=True)
            if curve is not None
        ]
        stretches = () if cell.scene is None else places_along(task, cell.motion, cell.scene)
        return cls(cell.scene, tuple(stretches), tuple(tubes), tuple(stops), tuple(parts))

    def obstacles(self, robot: Robot) -> list[tuple[Any, Solid]]:
        """Return the obstacles of the scene with their solids."""
        every = () if self.scene is None else self.scene.obstacles
        return [(obstacle, obstacle_solid(obstacle, robot)) for obstacle in every]

    def nearest(self, t: FloatArray, q: FloatArray) -> list[Nearest]:
        """Return the closest pair of points at each sample of the arm, q [N,n] at times t [N].

        The list is empty without a scene, and without coal.
        """
        if self.scene is None or not has_coal():
            return []
        models = [contact_model(p.robot, p.scene.without_parts_of(p.robot)) for p in self.stretches]
        at = np.searchsorted([place.end for place in self.stretches[:-1]], t, side="right")
        return [models[k].nearest(pose) for k, pose in zip(at, q, strict=True)]
