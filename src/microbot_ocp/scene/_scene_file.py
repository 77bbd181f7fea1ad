"""Scenes from TOML, URDF and MoveIt files, and MoveIt's requests.

Whatever is wrong in a file is one sentence that names the file, the obstacle, the key and what is
allowed. Messages of MoveIt are moveit_msgs/PlanningScene and moveit_msgs/MotionPlanRequest in YAML;
poses may be lists, or mappings of x, y, z, w as ROS prints them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError, naming, shown
from microbot_ocp._base.reading import yaml_of
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
from microbot_ocp.robot import Capsule, Robot, Shape, of_quaternion, read_mesh, rotation_of
from microbot_ocp.robot._transforms import transform_of
from microbot_ocp.robot.files import read_urdf_shapes
from microbot_ocp.scene._obstacles import KINDS, Box, ConvexMesh, Cylinder, Obstacle, Sphere
from microbot_ocp.scene._scene import Scene

PLACED = ("center", "rotation_deg", "matrix")  # where a frame is: any of these
SCENE = {"clearance": ANY, "self_collision": FLAG, "ignore": ANY, "urdf": TEXT, "obstacle": TABLES}
# of MoveIt: their number in ROS, and how many dimensions they have
PRIMITIVES = {"box": (1, 3), "sphere": (2, 1), "cylinder": (3, 2)}
LEFT_OUT = ("meshes", "planes")


def _schema(kind: str) -> dict[str, Key]:
    """Return keys of an obstacle: those of its class, and where its frame is."""
    keys = keys_of(KINDS[kind], name=TEXT)
    if keys.pop("pose", None):
        keys |= dict.fromkeys(PLACED, ANY)
    if kind == "half_space":
        keys |= dict.fromkeys(("normal", "offset"), NEEDED)
    return keys | ({"file": TEXT, "scale": ANY, "vertices": ANY} if kind == "mesh" else {})


def load_scene(
    source: str | Path | Mapping[str, Any], folder: str | Path = ".", origin: str = "scene"
) -> Scene:
    """Read a scene from a file or from a table of a task file.

    Parameters
    ----------
    source : str, Path or mapping
        A ``.toml`` file with ``clearance``, ``self_collision``, ``ignore``, ``urdf`` and
        ``[[obstacle]]`` tables of ``name``, ``kind`` and the fields of that kind; a ``.urdf`` or
        ``.xacro`` file without moving joints, whose collision geometry becomes obstacles; a
        ``.yaml`` file with a moveit_msgs/PlanningScene, of which boxes, spheres and cylinders are
        read, and which links may touch them; or what such a TOML file holds, as a mapping.
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
            return _moveit_scene(path)
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
    """Give frame [4,4] from a matrix, or from a centre and angles about the fixed axes X, Y, Z."""
    if "matrix" in table:
        if len(table) > 1:
            raise InputError("it must have a matrix, or center and rotation_deg")
        return checks.array("matrix", table["matrix"], (4, 4), "m")
    center = checks.array("center", table.get("center", (0.0, 0.0, 0.0)), (3,), "m")
    angles = checks.array("rotation_deg", table.get("rotation_deg", (0, 0, 0)), (3,), "deg")
    return transform_of(rotation_of(np.radians(angles)), center)


def _of_urdf(path: Path) -> tuple[Obstacle, ...]:
    """Return obstacles of the links of a URDF file, named after them."""
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
            obstacles.append(_solid(shape.kind, shape.size, shape.pose, name))
    return tuple(obstacles)


def _solid(kind: str, size: FloatArray, pose: FloatArray, name: str) -> Obstacle:
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


# MoveIt -------------------------------------------------------------------------------------------


def _moveit_scene(path: Path) -> Scene:
    """Return the obstacles of a planning scene, and what of them links may touch.

    Raises
    ------
    InputError
        A file that is no planning scene, geometry other than boxes, spheres and cylinders.
    """
    with naming(f"{path.name}: "):
        document = yaml_of(path, "scene file")
        world, touching = _of(document, "world"), _of(document, "allowed_collision_matrix", {})
        rows = _of(world, "collision_objects", [])
        obstacles = tuple(solid for row in rows for solid in _obstacles(row))
        names, objects = _of(touching, "entry_names", ()), {obstacle.name for obstacle in obstacles}
        ignore = []
        for first, row in zip(names, _of(touching, "entry_values", ()), strict=False):
            entries = _of(row, "enabled") if isinstance(row, Mapping) else row
            for second, may in zip(names, entries, strict=False):
                if may and first in objects and second not in objects:
                    ignore.append((second, first))
        return Scene(obstacles, ignore=tuple(ignore))


def load_request(path: str | Path, robot: Robot) -> FloatArray:
    """Read start and goal of a MoveIt motion plan request.

    Needs PyYAML, of the extra ``export``.

    Parameters
    ----------
    path : str or Path
        A moveit_msgs/MotionPlanRequest in YAML, whose goal is constraints of the joints.
    robot : Robot
        Whose joints, by name, are asked for; others in the file play no part.

    Returns
    -------
    array [2,n]
        Rad or m.

    Raises
    ------
    InputError
        A file that is no such request, a joint without a position, goals or constraints of another
        kind, of which there is no single pose.
    """
    with naming(f"{Path(path).name}: "):
        document = yaml_of(path, "request file")
        state = _of(_of(document, "start_state"), "joint_state")
        names, positions = _of(state, "name"), _of(state, "position")
        if len(names) != len(positions):
            raise InputError(f"start_state has {len(names)} joints, but {len(positions)} positions")
        goals = _of(document, "goal_constraints")
        if len(goals) != 1 or not isinstance(goals[0], Mapping):
            raise InputError(f"there must be one set of goal_constraints, not {len(goals)}")
        for kind, constraints in goals[0].items():
            if kind.endswith("_constraints") and kind != "joint_constraints" and constraints:
                raise InputError(f"the goal must be of joint_constraints alone, not of {kind}")
        joints = _of(goals[0], "joint_constraints")
        goal = {_of(joint, "joint_name"): _of(joint, "position") for joint in joints}
        rows = []
        for label, pose in (("start", dict(zip(names, positions, strict=True))), ("goal", goal)):
            missing = [name for name in robot.joint_names if name not in pose]
            if missing:
                raise InputError(f"the {label} lacks {', '.join(missing)}")
            rows.append([pose[name] for name in robot.joint_names])
        return checks.array("positions of joints", rows, (2, robot.joint_count), "rad")


def _of(table: Any, key: str, default: Any = None) -> Any:
    """Return what a mapping has under a key."""
    if not isinstance(table, Mapping) or (key not in table and default is None):
        raise InputError(f"{key} is missing: the message is of another kind")
    return table[key] if table.get(key) is not None else default or ()


def _obstacles(row: Any) -> Iterator[Obstacle]:
    """Yield obstacles of a collision object, named after it, numbered if they are several."""
    name = str(_of(row, "id"))
    for kind in LEFT_OUT:
        if row.get(kind):
            raise InputError(f"{kind} of object {name!r} cannot be read, only primitives")
    with naming(f"object {name!r}: "):
        primitives, poses = _of(row, "primitives"), _of(row, "primitive_poses")
        if len(primitives) != len(poses):
            raise InputError(f"it has {len(primitives)} primitives, but {len(poses)} poses")
        base = _pose_of_message(row["pose"]) if "pose" in row else np.eye(4)
        for number, (primitive, placed) in enumerate(zip(primitives, poses, strict=True), start=1):
            label = name if len(poses) == 1 else f"{name} {number}"
            given, pose = _of(primitive, "type"), base @ _pose_of_message(placed)
            kind = next((k for k, (code, _) in PRIMITIVES.items() if given in (k, code)), None)
            if kind is None:
                raise InputError(f"type must be one of {', '.join(PRIMITIVES)}, not {shown(given)}")
            count, given = PRIMITIVES[kind][1], list(_of(primitive, "dimensions"))
            size = checks.array("dimensions", given[:count], (count,), "m")
            # of a cylinder its height comes first there
            yield _solid(kind, size[::-1] if kind == "cylinder" else size, pose, label)


def _pose_of_message(table: Any) -> FloatArray:
    """Return the transform [4,4] of a position and a quaternion x, y, z, w."""
    entries = []
    for key, letters in (("position", "xyz"), ("orientation", "xyzw")):
        value = _of(table, key)
        value = [_of(value, letter) for letter in letters] if isinstance(value, Mapping) else value
        entries.append(checks.array(key, value, (len(letters),)))
    position, (x, y, z, w) = entries
    if not np.any(entries[1]):
        raise InputError("orientation must be a quaternion, not zero")
    return transform_of(of_quaternion((w, x, y, z)), position)
