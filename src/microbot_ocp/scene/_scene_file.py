"""Scenes from TOML and URDF files.

Whatever is wrong in a file is one sentence that names the file, the obstacle, the key and what is
allowed.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError, naming
from microbot_ocp._base.toml_file import table_from
from microbot_ocp.robot import Capsule, Shape, read_mesh
from microbot_ocp.robot.files import read_urdf_shapes
from microbot_ocp.scene._obstacles import (
    KINDS,
    Box,
    ConvexMesh,
    Cylinder,
    HalfSpace,
    Obstacle,
    Sphere,
)
from microbot_ocp.scene._scene import Scene

PLACED = ("center", "rotation_deg", "matrix")  # where a frame is: any of these
KEYS: dict[str, tuple[str, ...]] = {
    "sphere": ("center", "radius"),
    "box": ("size", *PLACED),
    "capsule": ("start", "end", "radius"),
    "cylinder": ("radius", "length", *PLACED),
    "half_space": ("normal", "offset"),
    "mesh": ("file", "scale", "vertices", *PLACED),
}
NEEDED = {
    "sphere": ("center", "radius"),
    "box": ("size",),
    "capsule": ("start", "end", "radius"),
    "cylinder": ("radius", "length"),
    "half_space": ("normal", "offset"),
    "mesh": (),
}
SCENE_KEYS = ("clearance", "self_collision", "ignore", "urdf", "obstacle")


def read_scene(
    source: str | Path | Mapping[str, Any], folder: str | Path = ".", origin: str = "scene"
) -> Scene:
    """Read a scene from a file or from a table of a task file.

    Parameters
    ----------
    source : str, Path or mapping
        A ``.toml`` file with ``clearance``, ``self_collision``, ``ignore``, ``urdf`` and
        ``[[obstacle]]`` tables of ``name``, ``kind`` and the fields of that kind; a ``.urdf`` or
        ``.xacro`` file without moving joints, whose collision geometry becomes obstacles; or what
        such a TOML file holds, as a mapping.
    folder : str or Path
        Files named in a mapping are looked for here; those in a file beside it.
    origin : str
        Name of a mapping, for messages.

    Returns
    -------
    Scene

    Raises
    ------
    InputError
        A file that cannot be read, an unknown or missing key or kind, what :class:`Scene` refuses.

    Examples
    --------
    >>> scene = read_scene({"clearance": 0.01, "obstacle": [
    ...     {"name": "post", "kind": "cylinder", "radius": 0.1, "length": 1.0, "center": [1, 0, 0]},
    ... ]})
    >>> scene.names, scene.clearance
    (('post',), 0.01)
    """
    if not isinstance(source, Mapping):
        path = Path(source)
        if path.suffix.lower() in (".urdf", ".xacro"):
            return Scene(_of_urdf(path))
        source = table_from(path, "scene")
        folder, origin = path.parent, path.name
    for key in source:
        checks.one_of(f"key of {origin}", key, SCENE_KEYS)
    given = source.get("obstacle", [])
    if not isinstance(given, list) or not all(isinstance(entry, Mapping) for entry in given):
        raise InputError(f"obstacles of {origin} must be [[obstacle]] tables")
    obstacles: list[Obstacle] = []
    if "urdf" in source:
        obstacles += _of_urdf(Path(folder) / _text("urdf", source["urdf"], origin))
    for number, table in enumerate(given, start=1):
        name = table.get("name", "")
        label = f"obstacle {name!r}" if name else f"obstacle {number}"
        try:
            obstacles.append(_obstacle(table, Path(folder), f"{label} of {origin}"))
        except InputError as problem:
            told = str(problem)
            raise InputError(told if origin in told else f"{label} of {origin}: {told}") from None
    own = source.get("self_collision", True)
    if not isinstance(own, bool):
        raise InputError(f"self_collision of {origin} must be true or false, not {own!r}")
    with naming(f"{origin}: "):
        return Scene(
            tuple(obstacles),
            clearance=source.get("clearance", 0.0),
            self_collision=own,
            ignore=source.get("ignore", ()),
        )


def _obstacle(table: Mapping[str, Any], folder: Path, label: str) -> Obstacle:
    kind = table.get("kind")
    if kind is None:
        raise InputError(f"kind of {label} is missing; allowed: {', '.join(KINDS)}")
    checks.one_of(f"kind of {label}", kind, KINDS)
    for key in table:
        checks.one_of(f"key of {label}", key, ("name", "kind", *KEYS[kind]))
    for key in NEEDED[kind]:
        if key not in table:
            raise InputError(f"{key} of {label} is missing")
    name = _text("name", table.get("name", ""), label)
    if kind == "sphere":
        return Sphere(table["center"], table["radius"], name)
    if kind == "capsule":
        return Capsule(table["start"], table["end"], table["radius"], name)
    if kind == "half_space":
        return HalfSpace(table["normal"], table["offset"], name)
    pose = _pose(table, label)
    if kind == "box":
        return Box(table["size"], pose, name)
    if kind == "cylinder":
        return Cylinder(table["radius"], table["length"], pose, name)
    if ("file" in table) == ("vertices" in table):
        raise InputError(f"{label} must have a file or vertices, one of the two")
    if "vertices" in table:
        return ConvexMesh(table["vertices"], pose, name)
    path = folder / _text("file", table["file"], label)
    if not path.is_file():
        raise InputError(f"there is no file {str(path)!r}")
    scale = checks.array("scale", np.atleast_1d(table.get("scale", 1.0)), (None,))
    if scale.size not in (1, 3) or not scale.all():
        said = checks.shown(table["scale"])
        raise InputError(f"scale must be one number or three, none of them 0, not {said}")
    scale = np.broadcast_to(scale, 3)
    mesh = read_mesh(Shape(0, np.eye(4), "mesh", scale, link=name, path=str(path)))
    return ConvexMesh(mesh.vertices, pose, name)


def _pose(table: Mapping[str, Any], label: str) -> FloatArray:
    """Frame [4,4] from a matrix, or from a centre and angles about the fixed axes X, Y, Z."""
    if "matrix" in table:
        if "center" in table or "rotation_deg" in table:
            raise InputError(f"{label} must have a matrix, or center and rotation_deg")
        return checks.array("matrix", table["matrix"], (4, 4), "m")
    pose = np.eye(4)
    pose[:3, 3] = checks.array("center", table.get("center", (0.0, 0.0, 0.0)), (3,), "m")
    angles = checks.array("rotation_deg", table.get("rotation_deg", (0, 0, 0)), (3,), "deg")
    for axis, angle in enumerate(np.radians(angles)):
        turn, (i, j) = np.eye(3), ((1, 2), (2, 0), (0, 1))[axis]
        turn[i, i] = turn[j, j] = np.cos(angle)
        turn[j, i] = np.sin(angle)
        turn[i, j] = -np.sin(angle)
        pose[:3, :3] = turn @ pose[:3, :3]
    return pose


def _of_urdf(path: Path) -> tuple[Obstacle, ...]:
    """Obstacles of the links of a URDF file, named after them."""
    shapes = read_urdf_shapes(path)
    if not shapes:
        raise InputError(f"{path.name} has no collision geometry")
    links = [shape.link for shape in shapes]
    found = []
    for index, shape in enumerate(shapes):
        name = shape.link
        if links.count(name) > 1:
            name = f"{name} {links[: index + 1].count(name)}"
        found.append(_of_shape(shape, name))
    return tuple(found)


def _of_shape(shape: Shape, name: str) -> Obstacle:
    center, axis = shape.pose[:3, 3], shape.pose[:3, 2]
    if shape.kind == "sphere":
        return Sphere(center, shape.size[0], name)
    if shape.kind == "box":
        return Box(shape.size, shape.pose, name)
    if shape.kind == "cylinder":
        return Cylinder(shape.size[0], shape.size[1], shape.pose, name)
    if shape.kind == "capsule":
        half = shape.size[1] / 2 * axis
        return Capsule(center - half, center + half, shape.size[0], name)
    return ConvexMesh(read_mesh(shape).vertices, shape.pose, name)


def _text(key: str, value: Any, label: str) -> str:
    if not isinstance(value, str):
        raise InputError(f"{key} of {label} must be text, not {value!r}")
    return value
