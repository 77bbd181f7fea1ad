"""Visual and collision geometry of a robot as data: primitives and mesh files in its frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.needed import needed
from microbot_ocp._base.reading import opened

# Names of the entries of a shape's size.
SIZES = {
    "box": ("x", "y", "z"),
    "sphere": ("radius",),
    "cylinder": ("radius", "length"),
    "capsule": ("radius", "length"),
    "mesh": ("scale x", "scale y", "scale z"),
}
Role = Literal["visual", "collision"]
ROLES: tuple[Role, ...] = ("visual", "collision")


@dataclass(frozen=True, eq=False)
class Shape:
    """A rigid piece of geometry in one of a robot's frames.

    Parameters
    ----------
    frame : int
        Number of the frame: 0 for the base frame, 1 to n for the link frames, as in
        :func:`microbot_ocp.forward_kinematics`.
    pose : array_like [4,4]
        Pose of the shape in that frame, m.
    kind : str
        "box", "sphere", "cylinder", "capsule" or "mesh", centred at the shape's origin; a cylinder
        and a capsule lie along its Z.
    size : array_like
        Box: edge lengths [3], m. Sphere: radius [1], m. Cylinder and capsule: radius and length
        [2], m, without the caps of a capsule. Mesh: scale factors [3]; meshes are in m.
    role : str
        "visual" or "collision".
    link : str
        Name of the shape's link in the file.
    path : str
        File of a mesh.
    color : tuple of float, optional
        Red, green, blue and opacity, 0 to 1.

    Raises
    ------
    InputError
        An unknown kind or role, a size that is negative or of the wrong length, a value that is
        not finite, or a mesh without a path.
    """

    frame: int
    pose: FloatArray
    kind: str
    size: FloatArray
    role: Role = "collision"
    link: str = ""
    path: str = field(default="", compare=False)  # differs between machines
    color: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        label = f"{self.role} geometry of link {self.link!r}"
        checks.one_of(f"kind of {label}", self.kind, SIZES)
        checks.one_of("role of a shape", self.role, ROLES)
        put = object.__setattr__
        put(self, "pose", checks.array(f"pose of {label}", self.pose, (4, 4), "m"))
        names = SIZES[self.kind]
        size = checks.array(f"{', '.join(names)} of {label}", self.size, (len(names),))
        if self.kind != "mesh" and (size < 0).any():  # a negative scale mirrors a mesh
            raise InputError(
                f"{', '.join(names)} of {label} must be at least 0 m, not {size.tolist()}"
            )
        put(self, "size", size)
        if (self.kind == "mesh") != bool(self.path):
            raise InputError(f"{label} must have a path if it is a mesh, and only then")
        if self.color is not None:
            put(self, "color", tuple(checks.array(f"color of {label}", self.color, (4,)).tolist()))


def checked_shapes(shapes: Sequence[Shape], count: int) -> tuple[Shape, ...]:
    """Return shapes whose frames exist in a chain of ``count`` joints."""
    for shape in shapes:
        if not isinstance(shape, Shape) or not 0 <= shape.frame <= count:
            raise InputError(
                f"shapes must hold Shape objects of frames 0 to {count}, not {shape!r}"
            )
    return tuple(shapes)


@dataclass(frozen=True, eq=False)
class Capsule:
    """Set of all points within ``radius`` of the segment from ``start`` to ``end``.

    Parameters
    ----------
    start, end : array_like [3]
        Ends of the segment, m; equal ends make a sphere.
    radius : float
        Radius, m.
    name : str
        Name of the link or obstacle, for messages and figures.
    excess : float
        Largest distance between the capsule's surface and the hull that it encloses, m.

    Raises
    ------
    InputError
        A negative radius or excess, or a value that is not finite.
    """

    start: FloatArray
    end: FloatArray
    radius: float
    name: str = ""
    excess: float = 0.0

    def __post_init__(self) -> None:
        put = object.__setattr__
        for name in ("start", "end"):
            put(self, name, checks.array(f"{name} of the capsule", getattr(self, name), (3,), "m"))
        for name in ("radius", "excess"):
            value = checks.number(f"{name} of the capsule", getattr(self, name), "m", at_least=0.0)
            put(self, name, value)

    @property
    def volume(self) -> float:
        """Volume, m^3."""
        length = float(np.linalg.norm(self.end - self.start))
        return np.pi * self.radius**2 * (length + 4 / 3 * self.radius)

    def moved(self, transform: FloatArray) -> Capsule:
        """Return the capsule moved by a transform [4,4]."""
        rotation, shift = transform[:3, :3], transform[:3, 3]
        start, end = (rotation @ place + shift for place in (self.start, self.end))
        return Capsule(start, end, self.radius, self.name, self.excess)

    def distance(self, points: ArrayLike) -> FloatArray:
        """Return the distance [N] of points [N,3] from the surface, m; negative inside."""
        places, along = np.asarray(points, dtype=float) - self.start, self.end - self.start
        square = along @ along
        share = np.clip(places @ along / square, 0.0, 1.0) if square else np.zeros(len(places))
        return np.linalg.norm(places - share[:, None] * along, axis=1) - self.radius


class TriangleMesh(NamedTuple):
    """Triangles of a mesh file, in the frame of its shape.

    Attributes
    ----------
    vertices : array [N,3]
        Positions, m.
    triangles : array [M,3]
        Indices of vertices.
    colors : array [N,4] or None
        Red, green, blue and opacity of the vertices, 0 to 255; None if the file has no colours.
    """

    vertices: FloatArray
    triangles: np.ndarray
    colors: np.ndarray | None


def read_mesh(shape: Shape) -> TriangleMesh:
    """Return the mesh of a shape, at its scale; needs the extra ``urdf``.

    Raises
    ------
    InputError
        The file is empty or cannot be read, or the extra is missing.
    """
    mesh = _mesh_file(shape.path, shape.link)
    return mesh._replace(vertices=mesh.vertices * shape.size)


@lru_cache(maxsize=64)
def _mesh_file(path: str, link: str) -> TriangleMesh:
    trimesh = needed("trimesh", "reading meshes needs", "urdf")
    try:
        opened(path).close()  # a pipe would block the reader
        scene: Any = trimesh.load_scene(path, process=False)
        if scene.units:
            scene = scene.convert_units("meters")
        given: Any = scene.to_geometry()
        vertices = np.array(given.vertices, dtype=float).reshape(-1, 3)
        triangles = np.array(getattr(given, "faces", ()), dtype=np.uint32).reshape(-1, 3)
        visual = given.visual
        colored = visual.defined and (visual.kind != "texture" or visual.uv is not None)
        colors = np.array(visual.to_color().vertex_colors) if colored else None
    except Exception as problem:  # trimesh raises many kinds of errors
        raise InputError(f"mesh {path!r} of link {link!r} cannot be read: {problem}") from None
    if not len(vertices) or not np.isfinite(vertices).all():
        raise InputError(f"mesh {path!r} of link {link!r} has no vertices to go by")
    if colors is not None and colors.shape != (len(vertices), 4):
        colors = None
    return TriangleMesh(vertices, triangles, colors)
