"""Planning scenes and motion plan requests of MoveIt, in YAML.

Messages are moveit_msgs/PlanningScene and moveit_msgs/MotionPlanRequest; poses may be lists, or
mappings of x, y, z, w as ROS prints them. ``_base/messages.txt`` lists the fields that are not
read here, with the reason.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError, naming, shown, warn_user
from microbot_ocp._base.messages import check_message
from microbot_ocp._base.reading import yaml_of
from microbot_ocp.limits import Limit, tool_speed
from microbot_ocp.robot import Robot, link_poses, of_quaternion, transform_of
from microbot_ocp.scene._obstacles import Obstacle, solid_of
from microbot_ocp.scene._scene import Scene, with_arm_capsules

# Code of each primitive in ROS, and its number of dimensions.
PRIMITIVES = {"box": (1, 3), "sphere": (2, 1), "cylinder": (3, 2)}
OPERATIONS = ("ADD", "REMOVE", "APPEND", "MOVE")
SHAPED = ("LIN", "CIRC", "PTP")  # planners of MoveIt that prescribe the path
USUAL_BASE = re.compile(r"world|base_link|(.*_)?link_?0")  # base frames of robots without links
ANY_TURN = 3.14  # tolerance that stands for half a turn to either side, so for no limit, rad
SAME = 1e-6  # tolerance of equal positions and angles, m and rad

Frames = Mapping[str, FloatArray]
Change = tuple[str, dict[str, Any]]  # path of a field, and arguments of Robot.with_limits


def moveit_scene(path: Path, robot: Robot | None) -> Scene:
    """Return the obstacles of a planning scene, and the links that may touch them.

    Raises
    ------
    InputError
        The file is no planning scene, a field cannot be kept, or a frame is unknown.
    """
    with naming(f"{path.name}: "):
        document = yaml_of(path, "scene file")
        rows = _of(_of(document, "world"), "collision_objects", [])
        check_message(document, "PlanningScene")
        frames = _frames(document, robot, [_frame_of(row) for row in rows])
        objects = _objects(rows, frames)
        ignore = _touching(_of(document, "allowed_collision_matrix", {}), objects, robot)
        obstacles = [obstacle for several in objects.values() for obstacle in several]
        return Scene(tuple(obstacles), ignore=tuple(ignore))


def _objects(rows: Any, frames: Frames) -> dict[str, list[Obstacle]]:
    """Apply the operations of a scene in their order; return the obstacles of every object."""
    solids: dict[str, list[tuple[str, FloatArray, FloatArray]]] = {}
    for number, row in enumerate(rows):
        name, where = str(_of(row, "id")), f"world.collision_objects[{number}]"
        given = row.get("operation") or 0
        code: Any = ord(given) if isinstance(given, str | bytes) and len(given) == 1 else given
        operation = dict(enumerate(OPERATIONS)).get(code, str(given).upper())
        if operation not in OPERATIONS[:3]:
            allowed = ", ".join(OPERATIONS[:3])
            raise InputError(f"{where}.operation must be one of {allowed}, not {shown(given)}")
        if operation != "APPEND":
            for gone in [name] if name else list(solids):
                solids.pop(gone, None)
        if operation != "REMOVE":
            base = _known(frames, _frame_of(row), f"{where}.header.frame_id")
            with naming(f"object {name!r}: "):
                solids[name] = [*solids.get(name, ()), *_solids(row, base)]
    return {
        name: [
            solid_of(*solid, name if len(several) == 1 else f"{name} {number}")
            for number, solid in enumerate(several, start=1)
        ]
        for name, several in solids.items()
    }


def _solids(row: Any, base: FloatArray) -> Iterator[tuple[str, FloatArray, FloatArray]]:
    """Yield kind, size and pose of the primitives of an object with frame ``base``."""
    primitives, poses = _of(row, "primitives"), _of(row, "primitive_poses")
    if len(primitives) != len(poses) or not primitives:
        raise InputError(f"it has {len(primitives)} primitives, but {len(poses)} poses")
    place = base @ _pose(row["pose"]) if row.get("pose") else base
    for primitive, placed in zip(primitives, poses, strict=True):
        given = _of(primitive, "type")
        kind = next((k for k, (code, _) in PRIMITIVES.items() if given in (k, code)), None)
        if kind is None:
            raise InputError(f"type must be one of {', '.join(PRIMITIVES)}, not {shown(given)}")
        count, given = PRIMITIVES[kind][1], list(_of(primitive, "dimensions"))
        size = checks.array("dimensions", given[:count], (count,), "m")
        # ROS lists the height of a cylinder before its radius.
        yield kind, size[::-1] if kind == "cylinder" else size, place @ _pose(placed)


def _allowed(matrix: Any) -> tuple[Sequence[str], Sequence[Sequence[Any]]]:
    """Return the names of a matrix, and its rows of pairs that are allowed to touch."""
    names, rows = _of(matrix, "entry_names", ()), _of(matrix, "entry_values", ())
    table = [_of(row, "enabled", ()) if isinstance(row, Mapping) else row for row in rows]
    if {len(names)} != {len(table), *map(len, table)}:
        raise InputError(
            f"allowed_collision_matrix.entry_values must have {len(names)} rows of {len(names)}, "
            "as many as entry_names"
        )
    return names, table


def _touching(
    matrix: Any, objects: Mapping[str, list[Obstacle]], robot: Robot | None
) -> Iterator[tuple[str, str]]:
    """Yield the pairs of links and obstacles, and of two links, that a matrix allows to touch.

    Links without geometry cannot touch; they are left out if the robot names its links.
    """
    names, table = _allowed(matrix)
    links, bare, disabled = set[str](), set[str](), set[frozenset[str]]()
    if names and robot is not None:
        links = {capsule.name for _, capsule in with_arm_capsules(robot).capsules}
        bare = robot.frames.keys() - links
        disabled = {frozenset(pair) for pair in robot.disabled_pairs or ()}
    for (i, first), (j, second) in product(enumerate(names), repeat=2):
        may, of_links = table[i][j], i < j and {first, second} <= links
        if may and first in objects and second not in objects and second not in bare:
            yield from ((second, obstacle.name) for obstacle in objects[first])
        elif may and of_links and {first, second} not in disabled:
            yield first, second
        elif not may and of_links and {first, second} in disabled:
            raise InputError(
                f"allowed_collision_matrix.entry_values[{i}][{j}] keeps {first} and {second} "
                "apart, but the SRDF file of the robot allows them to touch"
            )


# requests -----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Request:
    """Motion plan request: start and goal, and the robot under the requested limits.

    Attributes
    ----------
    q : array [2,n]
        Start and goal, rad (m).
    robot : Robot
        Robot under the limits of the request.
    asked : tuple of str
        Paths of the fields that set these limits.
    time_limit : float
        Allowed planning time, s; infinite if not given.
    """

    q: FloatArray
    robot: Robot
    asked: tuple[str, ...]
    time_limit: float


def load_request(path: str | Path, robot: Robot) -> FloatArray:
    """Read start and goal of a MoveIt motion plan request.

    Needs PyYAML, from the extra ``export``.

    Parameters
    ----------
    path : str or Path
        Motion plan request (moveit_msgs/MotionPlanRequest) in YAML, with joint constraints as goal.
    robot : Robot
        Robot that owns the joints, by name; a warning lists other joints of the start state.

    Returns
    -------
    array [2,n]
        Start and goal, rad or m.

    Raises
    ------
    InputError
        The file is no such request, a joint has no position, or a field cannot be kept. Requests
        that limit the path are refused, too; :func:`microbot_ocp.tasks.request_cell` keeps the
        limits that it can.
    """
    request = read_request(path, robot)
    if request.asked:
        raise InputError(
            f"{Path(path).name}: {request.asked[0]} is a limit, which start and goal cannot hold: "
            "mo.tasks.request_cell(path, robot, scene).solve() keeps it"
        )
    return request.q


def read_request(path: str | Path, robot: Robot) -> Request:
    """Read a motion plan request with the limits that it sets.

    Raises
    ------
    InputError
        The file is refused as by :func:`load_request`, except for its limits.
    """
    with naming(f"{Path(path).name}: "):
        document = yaml_of(path, "request file")
        state, goals = _of(document, "start_state"), _of(document, "goal_constraints")
        check_message(document, "MotionPlanRequest")
        if len(goals) != 1 or not isinstance(goals[0], Mapping):
            raise InputError(f"there must be one set of goal_constraints, not {len(goals)}")
        joints, aims = _of(state, "joint_state"), _of(goals[0], "joint_constraints")
        start = _by_joint("start_state", _of(joints, "name"), _of(joints, "position"))
        aimed = [[_of(row, key) for row in aims] for key in ("joint_name", "position")]
        goal = _by_joint("the goal", *aimed)
        rows = [_in_order("start", start, robot), _in_order("goal", goal, robot)]
        q = checks.array("positions of joints", rows, (2, robot.joint_count), "rad")
        if others := start.keys() - {*robot.chain.joint_names}:
            warn_user(
                f"joints that {robot.name} does not have keep the position of its file: "
                f"{', '.join(sorted(others))}"
            )
        for name in goal.keys() - robot.joint_names:
            if start.get(name) != goal[name]:
                raise InputError(f"the goal moves {name}, a joint that {robot.name} does not have")
        planner = str(document.get("planner_id") or "").upper()
        if planner in SHAPED:
            raise InputError(
                f"planner_id is {planner}, which prescribes the path: use the segments of a task "
                "of stops for that"
            )
        ways = _of(document, "path_constraints", {})
        limits = [*_scaled(document, robot), *_tool_speed(document, robot)]
        limits += [*_joints_on_the_way(ways, robot, q), *turns_on_the_way(ways, robot, q)]
        limited = robot
        for _, change in limits:
            also = (*limited.limits.also, *change.pop("also", ()))
            limited = limited.with_limits(**change, also=also)
        seconds = checks.number("allowed_planning_time", document.get("allowed_planning_time") or 0)
        time_limit = seconds if seconds > 0.0 else np.inf
        return Request(q, limited, tuple(where for where, _ in limits), time_limit)


def _by_joint(label: str, names: Any, values: Any) -> dict[str, Any]:
    """Return values by joint name; a name that occurs twice is refused."""
    if len(names) != len(values):
        raise InputError(f"{label} has {len(names)} joints, but {len(values)} positions")
    if twice := sorted({str(name) for name in names if list(names).count(name) > 1}):
        raise InputError(f"{label} has {', '.join(twice)} twice")
    return dict(zip(names, values, strict=True))


def _in_order(label: str, values: Mapping[str, Any], robot: Robot) -> list[Any]:
    if missing := [name for name in robot.joint_names if name not in values]:
        raise InputError(f"the {label} lacks {', '.join(missing)}")
    return [values[name] for name in robot.joint_names]


def _scaled(document: Any, robot: Robot) -> Iterator[Change]:
    """Yield velocity and acceleration limits scaled by factors in (0, 1]; 0 is 1 in MoveIt."""
    for name, quantity in (("velocity", "qd"), ("acceleration", "qdd")):
        where = f"max_{name}_scaling_factor"
        share = checks.number(where, document.get(where) or 1.0, above=0.0, at_most=1.0)
        low, high = robot.limits.bounds(quantity)
        free = [
            joint
            for joint, wide in zip(robot.joint_names, high - low, strict=True)
            if wide == np.inf
        ]
        if share < 1.0 and free:
            raise InputError(
                f"{where} is {share:g}, but {robot.name} has no limit of {name} of "
                f"{', '.join(free)} to scale: give it {quantity}_max, in its file or with_limits"
            )
        if share < 1.0:
            yield where, {f"{quantity}_max": (share * low, share * high)}


def _tool_speed(document: Any, robot: Robot) -> Iterator[Change]:
    """Yield the speed limit of the tool's origin; a missing link is the tool, as in MoveIt."""
    where = "max_cartesian_speed"
    speed = checks.number(where, document.get(where) or 0.0, "m/s")
    for key in ("cartesian_speed_limited_link", "cartesian_speed_end_effector_link"):
        if speed > 0.0 and document.get(key):
            number, frame = _link(document[key], robot, key)
            away = np.abs(frame[:3, 3] - robot.tool[:3, 3]).max()
            if number != robot.joint_count or away > SAME:
                raise InputError(f"{key} is {shown(document[key])}, whose origin is not the tool's")
    if speed > 0.0:
        yield where, {"also": (replace(tool_speed(speed), name="requested tool speed"),)}


def _joints_on_the_way(ways: Any, robot: Robot, q: FloatArray) -> Iterator[Change]:
    """Yield position limits from joint constraints; joints without limits ignore full turns."""
    low, high = (bound.copy() for bound in robot.limits.bounds("q"))
    for number, row in enumerate(_of(ways, "joint_constraints", ())):
        where = f"path_constraints.joint_constraints[{number}]"
        name = checks.one_of(f"{where}.joint_name", _of(row, "joint_name"), robot.joint_names)
        j = robot.joint_names.index(name)
        middle = checks.number(f"{where}.position", row.get("position") or 0.0)
        below, above = (
            checks.number(
                f"{where}.tolerance_{side}", row.get(f"tolerance_{side}") or 0.0, at_least=0
            )
            for side in ("below", "above")
        )
        if robot.joint_types[j] == "revolute" and np.isinf(robot.limits.bounds("q"))[:, j].all():
            middle += 2.0 * np.pi * np.round((q[0, j] - middle) / (2.0 * np.pi))
        low[j], high[j] = max(low[j], middle - below), min(high[j], middle + above)
        for end, value in zip(("start", "goal"), q[:, j], strict=True):
            if not low[j] - SAME <= value <= high[j] + SAME:
                raise InputError(
                    f"{where} keeps {name} from {low[j]:g} to {high[j]:g}, but the {end} is at "
                    f"{value:g}"
                )
        yield where, {"q_min": low.copy(), "q_max": high.copy()}


def turns_on_the_way(ways: Any, robot: Robot, q: FloatArray) -> Iterator[Change]:
    """Yield limits of the angles between links and given orientations."""
    for number, row in enumerate(_of(ways, "orientation_constraints", ())):
        where = f"path_constraints.orientation_constraints[{number}]"
        if row.get("parameterization"):
            raise InputError(f"{where}.parameterization must be 0, angles about X, Y and Z")
        base = _known(
            _frames({}, robot, [_frame_of(row)]), _frame_of(row), f"{where}.header.frame_id"
        )
        wanted = base[:3, :3] @ _rotation(_of(row, "orientation"))
        frame, pose = _link(_of(row, "link_name"), robot, f"{where}.link_name")
        keys = [f"absolute_{axis}_axis_tolerance" for axis in "xyz"]
        wide = [checks.number(f"{where}.{k}", row.get(k) or 0.0, "rad", above=0.0) for k in keys]
        axes = tuple(axis for axis in range(3) if wide[axis] < ANY_TURN)
        if not axes:
            continue
        bound = [wide[axis] for axis in axes]
        turn = Turn(frame, _tuples(wanted.T), _tuples(pose[:3, :3]), axes)
        labels = tuple("XYZ"[axis] for axis in axes)
        low = [-angle for angle in bound]
        title = f"turn of {row['link_name']}" + (f" ({number})" if number else "")
        limit = Limit(title, turn, low, bound, "rad", labels)
        for end, pose_there in zip(("start", "goal"), q, strict=True):
            state = robot.motion_state(ca.DM(pose_there), *3 * [ca.DM.zeros(robot.joint_count)])
            off = np.abs(np.array(ca.evalf(turn(state)))).ravel()
            if (off > bound).any():
                raise InputError(
                    f"{where} keeps {row['link_name']} within {np.round(bound, 4).tolist()} rad, "
                    f"but the {end} is off by {np.round(off, 4).tolist()} rad"
                )
        yield where, {"also": (limit,)}


def _tuples(matrix: FloatArray) -> tuple[tuple[float, ...], ...]:
    return tuple(map(tuple, matrix.tolist()))


def _link(name: Any, robot: Robot, where: str) -> tuple[int, FloatArray]:
    """Return the number of the joint that moves a link, and the link's frame in that joint's."""
    if name not in robot.frames:
        known = checks.similar(name, robot.frames) if robot.frames else ": it was read from no URDF"
        raise InputError(f"{where} is {shown(name)}, which is no link of {robot.name}{known}")
    return robot.frames[name]


@dataclass(frozen=True)
class Turn:
    """Limited angles about X, Y and Z from a given orientation to that of a link.

    They are MoveIt's: the rotation R = Rx(a) Ry(b) Rz(c) from the given orientation to the link is
    a rotation about X, then about the moved Y, then about the moved Z.
    """

    frame: int
    wanted: tuple[tuple[float, ...], ...]  # inverse of the given orientation in the base frame
    pose: tuple[tuple[float, ...], ...]  # orientation of the link in its joint's frame
    axes: tuple[int, ...]

    def __call__(self, state: Any) -> Any:
        turn = state.link_poses[self.frame][:3, :3] @ np.array(self.pose)
        turn = ca.mtimes(np.array(self.wanted), turn)
        level = ca.sqrt(turn[0, 0] ** 2 + turn[0, 1] ** 2)
        angles = (
            ca.atan2(-turn[1, 2], turn[2, 2]),
            ca.atan2(turn[0, 2], level),
            ca.atan2(-turn[0, 1], turn[0, 0]),
        )
        return ca.vertcat(*(angles[axis] for axis in self.axes))


# frames, poses and fields -------------------------------------------------------------------------


def _frames(document: Mapping[str, Any], robot: Robot | None, named: Iterable[str]) -> Frames:
    """Return the poses [4,4] of frames in the base frame.

    Parameters
    ----------
    document
        Planning scene; ``fixed_frame_transforms`` and ``robot_state`` are read.
    robot : Robot, optional
        Robot with named links; frames of moving links are known if the scene gives its joint state.
    named
        Frames to place; usual names of the base count as the base if nothing else places them.
    """
    links = {} if robot is None else robot.frames
    known = {"": np.eye(4)} | {name: place for name, (frame, place) in links.items() if not frame}
    joints = _of(_of(document, "robot_state", {}), "joint_state", {})
    stand = dict(zip(_of(joints, "name", ()), _of(joints, "position", ()), strict=False))
    if robot is not None and links and stand.keys() >= {*robot.joint_names}:
        there = np.array(link_poses(robot)([stand[name] for name in robot.joint_names]))
        poses = np.split(there, robot.joint_count + 1, axis=1)
        known |= {name: poses[frame] @ place for name, (frame, place) in links.items()}
    rows = []
    for row in _of(document, "fixed_frame_transforms", ()):
        move = _of(row, "transform")
        shift = checks.array("translation", _letters(_of(move, "translation"), "xyz"), (3,), "m")
        pose = transform_of(_rotation(_of(move, "rotation")), shift)
        rows.append((_frame_of(row), str(_of(row, "child_frame_id")).lstrip("/"), pose))
    _spread(known, rows)
    every = {*named, *(name for row in rows for name in row[:2])}
    usual = {
        name for name in every if name == "world" or (not links and USUAL_BASE.fullmatch(name))
    }
    known = dict.fromkeys(usual, np.eye(4)) | known
    _spread(known, rows)
    return known


def _spread(known: dict[str, FloatArray], rows: list[tuple[str, str, FloatArray]]) -> None:
    """Add the frames that transforms from parent to child connect to known frames.

    Raises
    ------
    InputError
        Two chains of transforms place a frame differently.
    """
    for _ in rows:  # every pass places at least one more frame, or none is left
        for parent, child, pose in rows:
            if parent in known:
                place = known[parent] @ pose
                if not np.allclose(known.setdefault(child, place), place, rtol=0.0, atol=SAME):
                    raise InputError(f"fixed_frame_transforms give {child!r} two different poses")
            elif child in known:
                known[parent] = known[child] @ np.linalg.inv(pose)


def _known(frames: Frames, name: str, where: str) -> FloatArray:
    if name not in frames:
        raise InputError(
            f"{where} is {name!r}, an unknown frame: give fixed_frame_transforms, or the robot "
            "that has this link, read from a URDF file"
        )
    return frames[name]


def _frame_of(row: Any) -> str:
    return str(_of(_of(row, "header", {}), "frame_id", "")).lstrip("/")


def _of(table: Any, key: str, default: Any = None) -> Any:
    """Return the value of a key; a missing key without default is refused."""
    if not isinstance(table, Mapping) or (key not in table and default is None):
        raise InputError(f"{key} is missing: the message is of another kind")
    value = table.get(key)
    return value if value is not None else () if default is None else default


def _letters(value: Any, letters: str) -> Any:
    return [_of(value, letter) for letter in letters] if isinstance(value, Mapping) else value


def _pose(table: Any) -> FloatArray:
    """Return the transform [4,4] of a position and a quaternion x, y, z, w."""
    position = checks.array("position", _letters(_of(table, "position"), "xyz"), (3,), "m")
    return transform_of(_rotation(_of(table, "orientation")), position)


def _rotation(value: Any) -> FloatArray:
    x, y, z, w = checks.array("orientation", _letters(value, "xyzw"), (4,))
    if not any((x, y, z, w)):
        raise InputError("orientation must be a quaternion, not zero")
    return of_quaternion((w, x, y, z))
