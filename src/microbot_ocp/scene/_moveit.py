"""Planning problems as MoveIt writes them: a planning scene, a motion plan request, both in YAML.

Messages: moveit_msgs/PlanningScene and moveit_msgs/MotionPlanRequest; poses may be lists, or
mappings of x, y, z, w as ROS prints them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError, naming, shown
from microbot_ocp._base.reading import yaml_of
from microbot_ocp.robot import Robot, of_quaternion
from microbot_ocp.scene._obstacles import Box, Cylinder, Obstacle, Sphere
from microbot_ocp.scene._scene import Scene

KINDS = {"box": (1, 3), "sphere": (2, 1), "cylinder": (3, 2)}  # number in ROS, count of dimensions
LEFT_OUT = ("meshes", "planes")


def moveit_scene(path: Path) -> Scene:
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
        base = _pose(row["pose"]) if "pose" in row else np.eye(4)
        for number, (primitive, placed) in enumerate(zip(primitives, poses, strict=True), start=1):
            label = name if len(poses) == 1 else f"{name} {number}"
            given, pose = _of(primitive, "type"), base @ _pose(placed)
            kind = next((kind for kind, (code, _) in KINDS.items() if given in (kind, code)), None)
            if kind is None:
                raise InputError(f"type must be one of {', '.join(KINDS)}, not {shown(given)}")
            count, given = KINDS[kind][1], list(_of(primitive, "dimensions"))
            size = checks.array("dimensions", given[:count], (count,), "m")
            if kind == "box":
                yield Box(size, pose, label)
            elif kind == "sphere":
                yield Sphere(pose[:3, 3], size[0], label)
            else:
                yield Cylinder(size[1], size[0], pose, label)


def _pose(table: Any) -> FloatArray:
    """Return the transform [4,4] of a position and a quaternion x, y, z, w."""
    pose, entries = np.eye(4), []
    for key, letters in (("position", "xyz"), ("orientation", "xyzw")):
        value = _of(table, key)
        value = [_of(value, letter) for letter in letters] if isinstance(value, Mapping) else value
        entries.append(checks.array(key, value, (len(letters),)))
    pose[:3, 3], (x, y, z, w) = entries
    if not np.any(entries[1]):
        raise InputError("orientation must be a quaternion, not zero")
    pose[:3, :3] = of_quaternion((w, x, y, z))
    return pose
