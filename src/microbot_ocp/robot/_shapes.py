"""Visual and collision geometry of a robot as data: primitives and mesh files in its frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError

# Kind -> what its size holds.
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
    """One piece of a robot's geometry, rigid in one of its frames.

    Parameters
    ----------
    frame : int
        0 for the base frame, 1 to n for the link frames, as in
        :func:`microbot_ocp.forward_kinematics`.
    pose : array_like [4,4]
        Frame of the shape in that frame, m.
    kind : str
        "box", "sphere", "cylinder", "capsule" or "mesh", centred at the shape's frame; a cylinder
        and a capsule lie along its Z.
    size : array_like
        Box: edge lengths [3], m. Sphere: radius [1]. Cylinder and capsule: radius and length [2],
        that of a capsule without its caps. Mesh: factors [3] along its axes; meshes are in m.
    role : str
        "visual" or "collision".
    link : str
        Name of the link that it belongs to in the file.
    path : str
        File of a mesh.
    color : tuple of float, optional
        Red, green, blue and opacity, 0 to 1.

    Raises
    ------
    InputError
        An unknown kind or role, a size that is negative or of the wrong length, anything not
        finite, a mesh without a path.
    """

    frame: int
    pose: FloatArray
    kind: str
    size: FloatArray
    role: Role = "collision"
    link: str = ""
    path: str = ""
    color: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        label = f"{self.role} geometry of link {self.link!r}"
        checks.one_of(f"kind of {label}", self.kind, SIZES)
        checks.one_of("role of a shape", self.role, ROLES)
        put = object.__setattr__
        put(self, "pose", checks.array(f"pose of {label}", self.pose, (4, 4), "m"))
        names = SIZES[self.kind]
        size = checks.array(f"{', '.join(names)} of {label}", self.size, (len(names),))
        if self.kind != "mesh" and (size < 0).any():  # a mesh may be mirrored
            raise InputError(
                f"{', '.join(names)} of {label} must be at least 0 m, not {size.tolist()}"
            )
        put(self, "size", size)
        if (self.kind == "mesh") != bool(self.path):
            raise InputError(f"{label} must have a path if it is a mesh, and only then")
        if self.color is not None:
            put(self, "color", tuple(checks.array(f"color of {label}", self.color, (4,)).tolist()))
