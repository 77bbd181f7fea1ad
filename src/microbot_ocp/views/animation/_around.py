"""What is around an arm as small faces: obstacles, tubes of tool lines, and parts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.robot import Capsule
from microbot_ocp.scene import Box, ConvexMesh, Cylinder, HalfSpace, Sphere
from microbot_ocp.views._scene import reach
from microbot_ocp.views.animation._bodies import (
    Faces,
    capsule_faces,
    colored,
    cylinder_faces,
    quadrilaterals,
)
from microbot_ocp.views.recording import (
    OBSTACLE_COLOR,
    PART_COLOR,
    TUBE_COLOR,
    Carried,
    Recording,
    ball_radius,
)

PATCH = 0.07  # longest edge of a face, of the reach: small faces sort well by depth
MOST_CUT = 30  # patches along an edge of a face
SIDES = 8  # of a tube
THINNEST = 0.006  # radius of a tube that is still seen, of the reach
PLANE = 0.9  # from the middle to the edge of what is drawn of a wall, of the reach

SQUARE = np.array([[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]])
CUBE = np.array([s * np.roll(SQUARE[::s], k, axis=1) for k in range(3) for s in (1, -1)])


def still_faces(recording: Recording, up: FloatArray) -> tuple[Faces | None, float | None]:
    """Faces of obstacles and tubes, and the height along ``up`` of a level floor among them, m."""
    size, floor = reach(recording.robot), None
    found = []
    for obstacle in () if recording.scene is None else recording.scene.obstacles:
        if isinstance(obstacle, HalfSpace) and obstacle.normal @ up > 1.0 - 1e-9:
            floor = obstacle.offset
            continue
        corners = _split(_corners(obstacle, recording.robot.base[:3, 3], size), PATCH * size)
        found.append(colored(corners, _rgb(OBSTACLE_COLOR)))
    for points, radius in recording.tubes:
        corners = _tube(points, max(radius, THINNEST * size))
        found.append(colored(corners, _rgb(TUBE_COLOR)))
    return joined(found) if found else None, floor


def part_faces(part: Carried, at: float) -> Faces:
    """Faces of a part at a sample of its arm; between samples where ``at`` is no whole number."""
    below = int(at)
    after = min(below + 1, len(part.poses) - 1)
    pose = (below + 1 - at) * part.poses[below] + (at - below) * part.poses[after]
    payload = part.payload
    center, radius = payload.center_of_mass, ball_radius(payload.mass)
    shape = payload.shape or (Capsule(center, center, max(radius, 1e-6)),)
    faces = [capsule_faces(capsule.start, capsule.end, capsule.radius) for capsule in shape]
    corners = np.concatenate(faces) @ pose[:3, :3].T + pose[:3, 3]
    return colored(corners, _rgb(PART_COLOR))


def joined(faces: Sequence[Faces]) -> Faces:
    """One body of several; triangles become quadrilaterals with a corner twice where both occur."""
    most = max(each.corners.shape[1] for each in faces)
    corners = [
        np.concatenate([c, np.repeat(c[:, -1:], most - c.shape[1], axis=1)], axis=1)
        for c, _ in faces
    ]
    return Faces(np.concatenate(corners), np.concatenate([colors for _, colors in faces]))


def _rgb(color: tuple[int, ...]) -> FloatArray:
    return np.array(color[:3]) / 255.0


def _corners(obstacle: Any, base: FloatArray, size: float) -> FloatArray:
    """Corners [N,4,3] of the faces of an obstacle."""
    if isinstance(obstacle, Sphere):
        return capsule_faces(obstacle.center, obstacle.center, obstacle.radius)
    if isinstance(obstacle, Capsule):
        return capsule_faces(obstacle.start, obstacle.end, obstacle.radius)
    if isinstance(obstacle, HalfSpace):
        normal = obstacle.normal
        foot = base + (obstacle.offset - normal @ base) * normal
        first: Any = np.cross(normal, np.eye(3)[int(np.abs(normal).argmin())])
        first = first / np.linalg.norm(first)
        second: Any = np.cross(normal, first)
        signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        corners: Any = foot + PLANE * size * signs @ np.array([first, second])
        return corners[None]
    if isinstance(obstacle, ConvexMesh):
        corners = obstacle.points[obstacle.triangles]
        middle = obstacle.points.mean(axis=0)
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        inward = np.einsum("ni,ni->n", normals, corners.mean(axis=1) - middle) < 0.0
        corners[inward] = corners[inward, ::-1]
        return np.concatenate([corners, corners[:, -1:]], axis=1)
    if isinstance(obstacle, Box):
        corners = CUBE * obstacle.size / 2
    else:
        assert isinstance(obstacle, Cylinder)
        corners = cylinder_faces(obstacle.radius, obstacle.length)
    return corners @ obstacle.pose[:3, :3].T + obstacle.pose[:3, 3]


def _split(corners: FloatArray, edge: float) -> FloatArray:
    """Quadrilaterals [N,4,3] cut into patches whose edges are at most ``edge`` long, m."""
    found = []
    for a, b, c, d in corners:
        across = max(np.linalg.norm(b - a), np.linalg.norm(c - d))
        along = max(np.linalg.norm(d - a), np.linalg.norm(c - b))
        count = [int(np.clip(np.ceil(length / edge), 1, MOST_CUT)) for length in (across, along)]
        u, v = (np.linspace(0.0, 1.0, n + 1)[:, None] for n in count)
        low, high = a + u * (b - a), d + u * (c - d)
        grid = low[:, None] + v[None] * (high - low)[:, None]
        patches = np.stack([grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]], axis=2)
        found.append(patches.reshape(-1, 4, 3))
    return np.concatenate(found)


def _tube(points: FloatArray, radius: float) -> FloatArray:
    """Faces [N,4,3] of a tube around points [k,3]."""
    along = np.gradient(points, axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    side = np.eye(3)[int(np.abs(along).max(axis=0).argmin())]
    angle = 2 * np.pi * np.arange(SIDES) / SIDES
    rings = []
    for point, direction in zip(points, along, strict=True):
        side = side - (side @ direction) * direction
        side /= max(float(np.linalg.norm(side)), 1e-12)
        other = np.cross(direction, side)
        around = np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * other
        rings.append(point + radius * around)
    return quadrilaterals(np.array(rings))
