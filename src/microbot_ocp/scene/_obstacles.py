"""Convex obstacles as data, and their signed distances as CasADi expressions.

An obstacle is a convex core inflated by a radius: a point for a sphere, a segment for a capsule,
the body itself with radius zero for the others. Outside of the core the distance of a point has a
continuous gradient; inside it is minus the depth. Along a straight line it is convex.

For the point p of a convex body that is nearest to x, the gradient of half the squared distance is
x - p. Along a segment the squared distance is convex, so bisection of its slope finds the nearest
place; a final secant step carries the derivatives of that place. If a segment lies flat on a face,
the nearest place is not unique; a small parabola about the middle of the segment makes it unique.
The result is at most the distance, and at contact smaller by at most a quarter of ``rounding``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import ROUNDING, FloatArray, InputError
from microbot_ocp._base.needed import needed
from microbot_ocp.robot import Capsule, rigid_transform, transform_of

MOST_FACES = 26  # faces of a mesh in the solver; a hull with more is enclosed by this many planes
ROUNDED = 0.05  # rounding of a mesh's corners in the solver, relative to its smallest half width
BISECTIONS = 8  # the secant starts from a 256th of the segment
TINY = 1e-20  # keeps square roots and quotients differentiable
PointFunction = Callable[[ca.SX], ca.SX]
Body = tuple[PointFunction, PointFunction | None]  # vector from the nearest point, and minus depth


@dataclass(frozen=True, eq=False)
class Sphere:
    """Sphere.

    Parameters
    ----------
    center : array_like [3]
        Centre in the base frame, m.
    radius : float
        Radius, m, above 0.
    name : str
        Name for messages, figures and files; a scene numbers unnamed obstacles.

    Raises
    ------
    InputError
        The radius is not positive, or a number is not finite.
    """

    center: FloatArray
    radius: float
    name: str = ""

    def __post_init__(self) -> None:
        _put(self, "center", checks.array("center of the sphere", self.center, (3,), "m"))
        _put(self, "radius", _positive("radius of the sphere", self.radius))


@dataclass(frozen=True, eq=False)
class Box:
    """Box.

    Parameters
    ----------
    size : array_like [3]
        Edge lengths along the axes of its frame, m.
    pose : array_like [4,4] or [3]
        Frame at its centre in the base frame, or the centre alone, m.
    name : str
        Name for messages, figures and files; a scene numbers unnamed obstacles.

    Raises
    ------
    InputError
        An edge is not positive, or the pose is no rigid transform.
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
    """Cylinder along the Z axis of its frame.

    Parameters
    ----------
    radius, length : float
        Radius and length, m, above 0.
    pose : array_like [4,4] or [3]
        Frame at its centre in the base frame, or the centre alone, m.
    name : str
        Name for messages, figures and files; a scene numbers unnamed obstacles.

    Raises
    ------
    InputError
        The radius or length is not positive, or the pose is no rigid transform.
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
    """Half space of all points x with ``normal . x <= offset``, such as a floor or a wall.

    Parameters
    ----------
    normal : array_like [3]
        Outward normal in the base frame, of any length but zero.
    offset : float
        Distance of its plane from the base's origin along the normal, m.
    name : str
        Name for messages, figures and files; a scene numbers unnamed obstacles.

    Raises
    ------
    InputError
        The normal is zero, or a number is not finite.
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
    """Convex hull of points, such as the vertices of a mesh.

    The solver sees the hull by its faces. A hull of more than 26 faces is replaced by a polyhedron
    around it, which touches it in directions all around and where known paths pass it; corners are
    mitred and slightly rounded. Certificates measure the hull itself, which is never nearer.

    Parameters
    ----------
    vertices : array_like [N,3]
        Points in the frame of ``pose``, m; at least four that do not lie in a plane.
    pose : array_like [4,4] or [3]
        Frame of the vertices in the base frame, or its origin alone, m.
    name : str
        Name for messages, figures and files; a scene numbers unnamed obstacles.

    Raises
    ------
    InputError
        There are fewer than four points, all lie in a plane, or a number is not finite.
    """

    vertices: FloatArray
    pose: FloatArray = field(default_factory=lambda: np.eye(4))
    name: str = ""

    def __post_init__(self) -> None:
        points = checks.array("vertices of the mesh", self.vertices, (None, 3), "m")
        # A hull needs volume: qhull fails on points in a plane.
        if len(points) < 4 or np.linalg.matrix_rank(points - points[0], tol=ROUNDING) < 3:
            raise InputError("vertices of the mesh must be at least 4 that do not lie in a plane")
        _put(self, "vertices", points)
        _put(self, "pose", _pose("pose of the mesh", self.pose))

    @property
    def points(self) -> FloatArray:
        """Vertices [N,3] in the base frame, m."""
        return self.vertices @ self.pose[:3, :3].T + self.pose[:3, 3]

    @property
    def triangles(self) -> np.ndarray:
        """Faces of the hull [M,3], as indices of vertices."""
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
    """Return the radius that inflates the core of an obstacle, m."""
    return obstacle.radius if isinstance(obstacle, Sphere | Capsule) else 0.0


def core_parameters(
    obstacle: Obstacle, accuracy: float = np.inf, facing: Sequence[Sequence[float]] = ()
) -> FloatArray:
    """Return the numbers [k] that determine the distance of an obstacle's core.

    ``accuracy`` bounds the rounding of a mesh's corners, m. A mesh of many faces is exact in the
    directions ``facing``.
    """
    if isinstance(obstacle, Sphere):
        return obstacle.center
    if isinstance(obstacle, Capsule):
        return np.concatenate([obstacle.start, obstacle.end])
    if isinstance(obstacle, HalfSpace):
        return np.append(obstacle.normal, obstacle.offset)
    if isinstance(obstacle, ConvexMesh):
        normals, offsets, corner = solver_faces(obstacle, facing)
        # The soft maximum is up to rounding * log(faces) below the largest height.
        corner = min(corner, accuracy / np.log(len(offsets)))
        return np.concatenate([normals.ravel("F"), offsets, [corner]])
    size = obstacle.size if isinstance(obstacle, Box) else [obstacle.radius, obstacle.length]
    return np.concatenate([size, obstacle.pose[:3, :3].ravel("F"), obstacle.pose[:3, 3]])


def core_distance(
    kind: type[Obstacle], numbers: ca.SX, start: ca.SX, end: ca.SX, rounding: ca.SX, contact: ca.SX
) -> ca.SX:
    """Return the signed distance of a segment from the core of an obstacle as an expression, m.

    Parameters
    ----------
    kind : type
        Class of the obstacle.
    numbers : expression
        Numbers from :func:`core_parameters`.
    start, end : expression [3]
        Ends of the segment in the base frame, m.
    rounding, contact : expression
        Rounding and contact distance, m; see :func:`_segment_to_body`.
    """
    if kind is Sphere:
        return _length(_from_segment(numbers, start, end))
    if kind is HalfSpace:
        low, high = (ca.dot(numbers[:3], end) - numbers[3] for end in (start, end))
        return _segment_to_plane(low, high, rounding)
    if kind is ConvexMesh:
        return _segment_to_faces(numbers, start, end, rounding)
    if kind is Capsule:
        axis: Body = lambda x: _from_segment(x, numbers[:3], numbers[3:]), None
        return _segment_to_body(axis, start, end, rounding, contact)
    # Boxes and cylinders are evaluated in their own frame, aligned with its axes.
    turn, shift = ca.reshape(numbers[-12:-3], 3, 3).T, numbers[-3:]
    first, last = (ca.mtimes(turn, end - shift) for end in (start, end))
    of_body = _of_box if kind is Box else _of_cylinder
    return _segment_to_body(of_body(numbers[:-12]), first, last, rounding, contact)


def _of_box(size: ca.SX) -> Body:
    # Clamping each coordinate gives the nearest point of a box.
    half = size / 2
    return (
        lambda x: ca.fmax(x - half, 0.0) + ca.fmin(x + half, 0.0),
        lambda x: ca.mmax(ca.fabs(x) - half),
    )


def _of_cylinder(size: ca.SX) -> Body:
    radius, half = size[0], size[1] / 2

    # Clamping the radial and the axial coordinate gives the nearest point of a cylinder.
    def away(x: ca.SX) -> ca.SX:
        share = 1.0 - radius / _length(x[:2])
        beyond = ca.fmax(x[2] - half, 0.0) + ca.fmin(x[2] + half, 0.0)
        return ca.vertcat(ca.fmax(share, 0.0) * x[:2], beyond)

    return away, lambda x: ca.fmax(_length(x[:2]) - radius, ca.fabs(x[2]) - half)


def _to_faces(x: ca.SX, numbers: ca.SX) -> ca.SX:
    """Return a smooth lower bound of the largest height of a point over the faces.

    It is the soft maximum rounding * log(mean(exp(heights / rounding))), which is below the largest
    height by at most rounding * log(faces).
    """
    faces = numbers.shape[0] // 4
    normals, offsets = ca.reshape(numbers[: 3 * faces], faces, 3), numbers[3 * faces : -1]
    heights, rounding = ca.mtimes(normals, x) - offsets, numbers[-1]
    # Heights relative to the largest keep the exponentials from overflow.
    largest = ca.mmax(heights)
    rest = ca.sum1(ca.exp((heights - largest) / rounding))
    return largest + rounding * (ca.log(rest) - np.log(faces))


def solid_of(kind: str, size: FloatArray, pose: FloatArray, name: str) -> Obstacle:
    """Return the obstacle of a kind and size of :class:`~microbot_ocp.robot.Shape`."""
    center = pose[:3, 3]
    if kind == "sphere":
        return Sphere(center, size[0], name)
    if kind == "box":
        return Box(size, pose, name)
    if kind == "cylinder":
        return Cylinder(size[0], size[1], pose, name)
    half = size[1] / 2 * pose[:3, 2]
    return Capsule(center - half, center + half, size[0], name)


@lru_cache(maxsize=256)
def has_many_faces(obstacle: Obstacle) -> bool:
    """Return True if solvers see an obstacle by fewer planes than it has."""
    return isinstance(obstacle, ConvexMesh) and len(_faces(obstacle.points)[0]) > MOST_FACES


def solver_faces(
    mesh: ConvexMesh, facing: Sequence[Sequence[float]] = ()
) -> tuple[FloatArray, FloatArray, float]:
    """Return normals [K,3], offsets [K] and rounding (m) of the mesh's planes in the solver.

    A mesh of many faces is enclosed by planes in 26 directions and in the directions ``facing``.
    """
    points = mesh.points
    normals, offsets = _faces(points)
    if len(normals) > MOST_FACES:
        normals = np.array([*_directions(), *facing])
        # The support function gives the plane that touches the mesh in each direction.
        offsets = (points @ normals.T).max(axis=0)
    # Rounding scales with the thinnest extent, so that a thin plate keeps its shape.
    width = (offsets + (points @ -normals.T).max(axis=0)).min() / 2
    return normals, offsets, ROUNDED * float(width)


def _hull(points: FloatArray) -> Any:
    return needed("scipy.spatial", "convex meshes need", "cell").ConvexHull(points)


def _faces(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return outward normals [K,3] and offsets [K] of the faces of a convex hull."""
    # qhull returns triangles; triangles of one face have one plane, up to rounding.
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
        return transform_of(np.eye(3), checks.array(name, value, (3,), "m"))
    return rigid_transform(name, value)


# distances of segments ----------------------------------------------------------------------------


def _segment_to_body(
    body: Body, start: ca.SX, end: ca.SX, rounding: ca.SX, contact: ca.SX
) -> ca.SX:
    """Return the distance of a segment from a convex body, m.

    Parameters
    ----------
    body : pair of callables
        Function of a point [3] that returns the vector [3] from the nearest point of the body; and
        function that returns minus the depth inside the body and a positive value outside, or None
        for a body without interior.
    start, end : expression [3]
        Ends of the segment, m.
    rounding, contact : expression
        Scale of the parabola, m, above 0; and the distance at contact, m.
    """
    # The parabola 2 rounding contact t (t - 1) lowers the squared distance by at most
    # rounding contact / 2, so the distance at contact by at most rounding / 4.
    (away, depth), along, parabola = body, end - start, 2.0 * rounding * contact

    def slope(t: ca.SX) -> ca.SX:
        return ca.dot(away(start + t * along), along) + parabola * (t - 0.5)

    t = _least(slope)
    point = start + t * along
    square = ca.sumsqr(away(point)) + parabola * t * (t - 1.0)
    outside = ca.sqrt(ca.fmax(square, TINY))
    return outside if depth is None else outside + ca.fmin(depth(point), 0.0)


def _segment_to_faces(numbers: ca.SX, start: ca.SX, end: ca.SX, rounding: ca.SX) -> ca.SX:
    """Return the least of :func:`_to_faces` along a segment, a convex function of its parameter."""
    t, bow, given = ca.SX.sym("t"), ca.SX.sym("bow"), ca.SX.sym("given", numbers.shape[0])
    first, last = ca.SX.sym("first", 3), ca.SX.sym("last", 3)
    value = _to_faces(first + t * (last - first), given) + bow * t * (t - 1.0)
    both = ca.Function("along", [t, first, last, given, bow], [value, ca.gradient(value, t)])
    rest = start, end, numbers, rounding
    return both(_least(lambda t: both(t, *rest)[1]), *rest)[0]


def _least(slope: PointFunction) -> ca.SX:
    """Return the minimiser in [0, 1] of a convex function with this slope, differentiably."""
    # A fixed number of halvings makes the search one expression without a loop.
    low, high = ca.SX(0.0), ca.SX(1.0)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        falls = slope(middle) < 0
        low, high = ca.if_else(falls, middle, low), ca.if_else(falls, high, middle)
    before, after = slope(low), slope(high)
    # Bisection has zero derivatives; the secant through the last bracket carries them.
    share = -before / ca.fmax(after - before, TINY)
    return low + (high - low) * ca.fmin(ca.fmax(share, 0.0), 1.0)


def _segment_to_plane(start_height: ca.SX, end_height: ca.SX, rounding: ca.SX) -> ca.SX:
    """Return the least height of a segment over a plane, from the heights of its ends."""
    # Height along the segment plus rounding t (t - 1) has its least value at this t.
    rise = end_height - start_height
    t = ca.fmin(ca.fmax(0.5 - rise / (2.0 * rounding), 0.0), 1.0)
    return start_height + t * rise + rounding * t * (t - 1.0)


def _from_segment(point: ca.SX, start: ca.SX, end: ca.SX) -> ca.SX:
    """Return the vector [3] to a point from the nearest point of a segment."""
    along = end - start
    share = ca.dot(point - start, along) / ca.fmax(ca.sumsqr(along), TINY)
    return point - start - ca.fmin(ca.fmax(share, 0.0), 1.0) * along


def _length(vector: ca.SX) -> ca.SX:
    """Return the norm of a vector, with zero gradient at zero."""
    return ca.sqrt(ca.fmax(ca.sumsqr(vector), TINY))
