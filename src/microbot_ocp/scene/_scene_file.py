"""Scenes from TOML, URDF and MoveIt files.

Errors in a file are one sentence that names the file, the obstacle, the key and the allowed values.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError, naming, shown
from microbot_ocp._base.schema import (
    ANY,
    FLAG,
    NEEDED,
    TABLES,
    TEXT,
    Key,
    keys_of,
    read_kind,
    read_table,
    table_from,
)
from microbot_ocp.robot import Robot, Shape, read_mesh, rotation_of, transform_of
from microbot_ocp.robot.files import read_urdf_shapes
from microbot_ocp.scene._moveit import moveit_scene
from microbot_ocp.scene._obstacles import KINDS, ConvexMesh, Obstacle, solid_of
from microbot_ocp.scene._scene import Scene

PLACED = ("center", "rotation_deg", "matrix")  # keys that replace ``pose`` in a file
SCENE = {"clearance": ANY, "self_collision": FLAG, "ignore": ANY, "urdf": TEXT, "obstacle": TABLES}


def _schema(kind: str) -> dict[str, Key]:
    """Return the keys of an obstacle: the fields of its class, with the keys of its pose."""
    keys = keys_of(KINDS[kind], name=TEXT)
    if keys.pop("pose", None):
        keys |= dict.fromkeys(PLACED, ANY)
    if kind == "half_space":
        keys |= dict.fromkeys(("normal", "offset"), NEEDED)
    return keys | ({"file": TEXT, "scale": ANY, "vertices": ANY} if kind == "mesh" else {})


def load_scene(
    source: str | Path | Mapping[str, Any],
    folder: str | Path = ".",
    origin: str = "scene",
    robot: Robot | None = None,
) -> Scene:
    """Read a scene from a file or from a table of a task file.

    Parameters
    ----------
    source : str, Path or mapping
        Path of a file, or the contents of a TOML file as a mapping. A ``.toml`` file has
        ``clearance``, ``self_collision``, ``ignore``, ``urdf`` and ``[[obstacle]]`` tables with
        ``name``, ``kind`` and the fields of that kind. The collision geometry of a ``.urdf`` or
        ``.xacro`` file without moving joints becomes obstacles. From a ``.yaml`` file with a
        moveit_msgs/PlanningScene, boxes, spheres and cylinders are read, and the links that may
        touch them. Every field of a message is kept, or refused by its path, or is among the
        harmless fields that docs/messages.md lists.
    folder : str or Path
        Folder of the files that a mapping names; files named in a file are found beside it.
    origin : str
        Name of a mapping, for messages.
    robot : Robot, optional
        Robot read from a URDF file; its links are frames for the objects of a planning scene.
        Without a robot, "world", "base_link" and "link0" with any prefix count as the base.

    Returns
    -------
    Scene
        Obstacles of the file, with the clearance to keep.

    Raises
    ------
    InputError
        The file cannot be read, a key or kind is unknown or missing, a field of a message cannot be
        kept, a frame is unknown, or :class:`Scene` refuses the values.

    Examples
    --------
    >>> scene = load_scene({"clearance": 0.01, "obstacle": [
    ...     {"name": "post", "kind": "cylinder", "radius": 0.1, "length": 1.0, "center": [1, 0, 0]},
    ... ]})
    >>> scene.names, scene.clearance
    (('post',), 0.01)
    """
    if not isinstance(source, Mapping):
        path = Path(source)
        if path.suffix.lower() in (".urdf", ".xacro"):
            return Scene(_of_urdf(path))
        if path.suffix.lower() in (".yaml", ".yml"):
            return moveit_scene(path, robot)
        with table_from(path, "scene") as table:
            return _scene(read_table(table, SCENE), path.parent)
    with naming(f"{origin}: "):
        return _scene(read_table(source, SCENE), Path(folder))


def _scene(table: Mapping[str, Any], folder: Path) -> Scene:
    obstacles = [*_of_urdf(folder / table["urdf"])] if "urdf" in table else []
    for number, row in enumerate(table.get("obstacle", []), start=1):
        label = f"obstacle {row['name']!r}" if row.get("name") else f"obstacle {number}"
        with naming(f"{label}: "):
            obstacles.append(_obstacle(row, folder))
    settings = {key: value for key, value in table.items() if key not in ("urdf", "obstacle")}
    return Scene(tuple(obstacles), **settings)


def _obstacle(table: Mapping[str, Any], folder: Path) -> Obstacle:
    kind, row = read_kind(table, {kind: _schema(kind) for kind in KINDS}, "of it", "{}")
    if "pose" in keys_of(KINDS[kind]):
        row["pose"] = _pose({key: row.pop(key) for key in PLACED if key in row})
    if kind == "mesh":
        if ("file" in row) == ("vertices" in row):
            raise InputError("it must have a file or vertices, one of the two")
        if "file" in row:
            row["vertices"] = _vertices(folder / row.pop("file"), row.pop("scale", 1.0))
        row.pop("scale", None)
    return KINDS[kind](**row)


def _vertices(path: Path, scale: Any) -> FloatArray:
    if not path.is_file():
        raise InputError(f"there is no file {str(path)!r}")
    sizes = checks.array("scale", np.atleast_1d(scale), (None,))
    if sizes.size not in (1, 3) or not sizes.all():
        raise InputError(f"scale must be one number or three, none of them 0, not {shown(scale)}")
    sizes = np.broadcast_to(sizes, 3)
    return read_mesh(Shape(0, np.eye(4), "mesh", sizes, path=str(path))).vertices


def _pose(table: Mapping[str, Any]) -> FloatArray:
    """Return a frame [4,4] from a matrix, or from a centre and angles about fixed X, Y and Z."""
    if "matrix" in table:
        if len(table) > 1:
            raise InputError("it must have a matrix, or center and rotation_deg")
        return checks.array("matrix", table["matrix"], (4, 4), "m")
    center = checks.array("center", table.get("center", (0.0, 0.0, 0.0)), (3,), "m")
    angles = checks.array("rotation_deg", table.get("rotation_deg", (0, 0, 0)), (3,), "deg")
    return transform_of(rotation_of(np.radians(angles)), center)


def _of_urdf(path: Path) -> tuple[Obstacle, ...]:
    """Return the collision geometry of a URDF file as obstacles, named after its links."""
    shapes = read_urdf_shapes(path)
    if not shapes:
        raise InputError(f"{path.name} has no collision geometry")
    links = [shape.link for shape in shapes]
    obstacles = []
    for index, shape in enumerate(shapes):
        name = shape.link
        if links.count(name) > 1:
            name = f"{name} {links[: index + 1].count(name)}"
        if shape.kind == "mesh":
            obstacles.append(ConvexMesh(read_mesh(shape).vertices, shape.pose, name))
        else:
            obstacles.append(solid_of(shape.kind, shape.size, shape.pose, name))
    return tuple(obstacles)
