"""Convex obstacles as data; each knows its signed distance as a CasADi expression.

An obstacle is a core, inflated by a radius: a point or a segment for a sphere and a capsule, the
body itself with radius zero for the others. Outside of the core the distance of a point from it has
a continuous slope; inside it is minus the depth. Along a straight line it is convex.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.needed import needed
from microbot_ocp.robot import Capsule, rigid_transform
from microbot_ocp.scene._distance import (
    PointFunction,
    from_segment,
    length,
    segment_to_body,
    segment_to_function,
    segment_to_plane,
)

MOST_FACES = 26  # of a mesh as the solver sees it; hulls with more are enclosed by so many planes
ROUNDED = 0.05  # of a mesh's smallest half width: how far the solver's corners are rounded


@dataclass(frozen=True, eq=False)
class Sphere:
    """A ball.

    Parameters
    ----------
    center : array_like [3]
        In the base frame, m.
    radius : float
        m, above 0.
    name : str
        For messages, figures and files; a scene numbers those without one.

    Raises
    ------
    InputError
        A radius that is not positive, anything not finite.
    """

    center: FloatArray
    radius: float
    name: str = ""

    def __post_init__(self) -> None:
        _put(self, "center", checks.array("center of the sphere", self.center, (3,), "m"))
        _put(self, "radius", _positive("radius of the sphere", self.radius))


@dataclass(frozen=True, eq=False)
class Box:
    """A box.

    Parameters
    ----------
    size : array_like [3]
        Edge lengths along the axes of its frame, m.
    pose : array_like [4,4] or [3]
        Frame at its centre in the base frame, or the centre alone, m.
    name : str

    Raises
    ------
    InputError
        An edge that is not positive, a pose that is no rigid transform.
    """

    size: FloatArray
    pose: FloatArray = field(default_factory=lambda: np.eye(4))
    name: str = ""

    def __post_init__(self) -> None:
        _put(self, "size", checks.array("size of the box", self.size, (3,), "m"))
        _positive("every edge of the box", self.size.min())
        _put(self, "pose", _pose("pose of the box", self.pose))


@dataclass(frozen=True, eq=False)
class Cylinder:
    """A cylinder along the Z axis of its frame.

    Parameters
    ----------
    radius, length : float
        m.
    pose : array_like [4,4] or [3]
        Frame at its centre in the base frame, or the centre alone, m.
    name : str

    Raises
    ------
    InputError
        A radius or length that is not positive, a pose that is no rigid transform.
    """

    radius: float
    length: float
    pose: FloatArray = field(default_factory=lambda: np.eye(4))
    name: str = ""

    def __post_init__(self) -> None:
        _put(self, "radius", _positive("radius of the cylinder", self.radius))
        _put(self, "length", _positive("length of the cylinder", self.length))
        _put(self, "pose", _pose("pose of the cylinder", self.pose))


@dataclass(frozen=True, eq=False)
class HalfSpace:
    """All points x with ``normal . x <= offset``: a floor, a wall.

    Parameters
    ----------
    normal : array_like [3]
        Out of the obstacle, in the base frame; any length but zero.
    offset : float
        Distance of its plane from the base's origin along the normal, m.
    name : str

    Raises
    ------
    InputError
        A normal without direction, anything not finite.
    """

    normal: FloatArray = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    offset: float = 0.0
    name: str = ""

    def __post_init__(self) -> None:
        normal = checks.array("normal of the half space", self.normal, (3,))
        length = float(np.linalg.norm(normal))
        if length == 0.0:
            raise InputError("normal of the half space must have a direction, not [0, 0, 0]")
        _put(self, "normal", normal / length)
        _put(self, "offset", checks.number("offset of the half space", self.offset, "m"))


@dataclass(frozen=True, eq=False)
class ConvexMesh:
    """The convex hull of points, such as the vertices of a mesh.

    The solver sees it by its faces: of more than 26 those of a polyhedron around it, which touches
    it all around and where known ways pass it, with corners that are mitred and a little rounded.
    The hull itself, which certificates measure, is never nearer.

    Parameters
    ----------
    vertices : array_like [N,3]
        At least four that do not lie in a plane, m, in the frame of ``pose``.
    pose : array_like [4,4] or [3]
        In the base frame, m.
    name : str

    Raises
    ------
    InputError
        Fewer than four points or flat ones, anything not finite.
    """

    vertices: FloatArray
    pose: FloatArray = field(default_factory=lambda: np.eye(4))
    name: str = ""

    def __post_init__(self) -> None:
        points = checks.array("vertices of the mesh", self.vertices, (None, 3), "m")
        if len(points) < 4 or np.linalg.matrix_rank(points - points[0], tol=1e-9) < 3:
            raise InputError("vertices of the mesh must be at least 4 that do not lie in a plane")
        _put(self, "vertices", points)
        _put(self, "pose", _pose("pose of the mesh", self.pose))

    @property
    def points(self) -> FloatArray:
        """Its vertices [N,3] in the base frame, m."""
        return self.vertices @ self.pose[:3, :3].T + self.pose[:3, 3]

    @property
    def triangles(self) -> np.ndarray:
        """The faces of its hull [M,3], as indices of vertices."""
        return _hull(self.vertices).simplices


Obstacle = Sphere | Box | Capsule | Cylinder | HalfSpace | ConvexMesh
KINDS: Mapping[str, type] = {
    "sphere": Sphere,
    "box": Box,
    "capsule": Capsule,
    "cylinder": Cylinder,
    "half_space": HalfSpace,
    "mesh": ConvexMesh,
}


def core_radius(obstacle: Obstacle) -> float:
    """Return by how much the core of an obstacle is inflated, m."""
    return obstacle.radius if isinstance(obstacle, Sphere | Capsule) else 0.0


def core_parameters(
    obstacle: Obstacle, accuracy: float = np.inf, facing: Sequence[Sequence[float]] = ()
) -> FloatArray:
    """Return the numbers [k] that the distance of an obstacle's core depends on.

    What is rounded off the corners of a mesh is at most the ``accuracy``, m; one of many faces is
    seen as it is in the directions that it is ``facing``.
    """
    if isinstance(obstacle, Sphere):
        return obstacle.center
    if isinstance(obstacle, Capsule):
        return np.concatenate([obstacle.start, obstacle.end])
    if isinstance(obstacle, HalfSpace):
        return np.append(obstacle.normal, obstacle.offset)
    if isinstance(obstacle, ConvexMesh):
        normals, offsets, corner = solver_faces(obstacle, facing)
        corner = min(corner, accuracy / np.log(len(offsets)))
        return np.concatenate([normals.ravel("F"), offsets, [corner]])
    size = obstacle.size if isinstance(obstacle, Box) else [obstacle.radius, obstacle.length]
    return np.concatenate([size, obstacle.pose[:3, :3].ravel("F"), obstacle.pose[:3, 3]])


def core_distance(
    kind: type[Obstacle],
    numbers: ca.SX,
    start: ca.SX,
    end: ca.SX,
    rounding: ca.SX,
    contact: ca.SX,
) -> ca.SX:
    """Return signed distance of a segment from the core of an obstacle as an expression, m.

    Parameters
    ----------
    kind : type
        Of the obstacle.
    numbers : expression
        As :func:`core_parameters`.
    start, end : expression [3]
        In the base frame, m.
    rounding, contact : expression
        See :func:`microbot_ocp.scene._distance.segment_to_body`.
    """
    if kind is Sphere:
        return length(from_segment(numbers, start, end))
    if kind is HalfSpace:
        low, high = (ca.dot(numbers[:3], end) - numbers[3] for end in (start, end))
        return segment_to_plane(low, high, rounding)
    if kind is ConvexMesh:
        return segment_to_function(_to_faces, numbers, start, end, rounding)
    if kind is Capsule:
        ends = numbers[:3], numbers[3:]
        return segment_to_body(
            lambda x: from_segment(x, *ends), None, start, end, rounding, contact
        )
    turn, shift = ca.reshape(numbers[-12:-3], 3, 3).T, numbers[-3:]
    first, last = (ca.mtimes(turn, end - shift) for end in (start, end))
    of_body = _of_box if kind is Box else _of_cylinder
    return segment_to_body(*of_body(numbers[:-12]), first, last, rounding, contact)


def _of_box(size: ca.SX) -> tuple[PointFunction, PointFunction]:
    half = size / 2
    return (
        lambda x: ca.fmax(x - half, 0.0) + ca.fmin(x + half, 0.0),
        lambda x: ca.mmax(ca.fabs(x) - half),
    )


def _of_cylinder(size: ca.SX) -> tuple[PointFunction, PointFunction]:
    radius, half = size[0], size[1] / 2

    def away(x: ca.SX) -> ca.SX:
        share = 1.0 - radius / length(x[:2])
        beyond = ca.fmax(x[2] - half, 0.0) + ca.fmin(x[2] + half, 0.0)
        return ca.vertcat(ca.fmax(share, 0.0) * x[:2], beyond)

    return away, lambda x: ca.fmax(length(x[:2]) - radius, ca.fabs(x[2]) - half)


def _to_faces(x: ca.SX, numbers: ca.SX) -> ca.SX:
    faces = numbers.shape[0] // 4
    normals, offsets = ca.reshape(numbers[: 3 * faces], faces, 3), numbers[3 * faces : -1]
    return _rounded_maximum(ca.mtimes(normals, x) - offsets, numbers[-1])


@lru_cache(maxsize=256)
def has_many_faces(obstacle: Obstacle) -> bool:
    """Return whether solvers see an obstacle by fewer planes than it has."""
    return isinstance(obstacle, ConvexMesh) and len(_faces(obstacle.points)[0]) > MOST_FACES


def solver_faces(
    mesh: ConvexMesh, facing: Sequence[Sequence[float]] = ()
) -> tuple[FloatArray, FloatArray, float]:
    """Return normals [K,3], offsets [K] and rounding of the planes around a mesh that the solver
    sees.

    Of many faces those in directions all around, and in those that it is ``facing``.
    """
    points = mesh.points
    normals, offsets = _faces(points)
    if len(normals) > MOST_FACES:
        normals = np.array([*_directions(), *facing])
        offsets = (points @ normals.T).max(axis=0)
    width = (offsets + (points @ -normals.T).max(axis=0)).min() / 2
    return normals, offsets, ROUNDED * float(width)


def _rounded_maximum(values: ca.SX, rounding: ca.SX) -> ca.SX:
    """Return at most the largest of values [K], and near it, with continuous slopes."""
    largest = ca.mmax(values)
    rest = ca.sum1(ca.exp((values - largest) / rounding))
    return largest + rounding * (ca.log(rest) - np.log(values.shape[0]))


def _hull(points: FloatArray) -> Any:
    return needed("scipy.spatial", "convex meshes need", "cell").ConvexHull(points)


def _faces(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return outward normals [K,3] and offsets [K] of the faces of a convex hull."""
    planes = np.unique(np.round(_hull(points).equations, 9), axis=0)
    return planes[:, :3], -planes[:, 3]


def _directions() -> FloatArray:
    """Return the 26 directions to the faces, edges and corners of a cube."""
    grid = np.array(np.meshgrid(*[(-1, 0, 1)] * 3)).reshape(3, -1).T
    away = grid[np.abs(grid).sum(axis=1) > 0]
    return away / np.linalg.norm(away, axis=1)[:, None]


def _put(item: Any, name: str, value: Any) -> None:
    object.__setattr__(item, name, value)


def _positive(name: str, value: Any) -> float:
    return checks.number(name, value, "m", above=0.0)


def _pose(name: str, value: ArrayLike) -> FloatArray:
    if np.ndim(np.asarray(value, dtype=object)) == 1:
        pose = np.eye(4)
        pose[:3, 3] = checks.array(name, value, (3,), "m")
        return pose
    return rigid_transform(name, value)
