"""Rows of any trajectory: times, positions, and optional velocities, accelerations and torques."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.archive import METADATA, arrays_in
from microbot_ocp._base.checks import (
    FloatArray,
    InputError,
    naming,
    shown,
    warn_user,
)
from microbot_ocp._base.messages import check_message, kind_of
from microbot_ocp._base.reading import bytes_of, text_of, yaml_of
from microbot_ocp._base.schema import refuse_toml
from microbot_ocp._base.writing import digest
from microbot_ocp.motion import FIELDS, NANOSECONDS, Mark, Motion, marks_path
from microbot_ocp.robot import Robot

FORMATS = (".csv", ".json", ".yaml", ".yml", ".npz")
KEYS = tuple(FIELDS.values())
Order = dict[tuple[str, int], int]  # columns of a table by quantity and joint
ARRAYS = ("t", "q", "qd", "qdd", "tau", "joint_names")
TIME = ("t", "time")
MESSAGES_HERE = (
    "JointTrajectory", "RobotTrajectory", "DisplayTrajectory", "FollowJointTrajectoryGoal",
    "FollowJointTrajectoryActionGoal", "ExecuteTrajectoryGoal", "MotionPlanResponse",
    "GetMotionPlanResponse", "MoveGroupResult", "GetCartesianPathResponse",
)  # fmt: skip
# Heads such as "qd elbow [rad/s]", "elbow", "time (s)".
KEY = re.compile(r"(q|qd|qdd|tau) (.*)", re.DOTALL)
UNIT = re.compile(r"(.*?) ?[\[(]([^\[\]()]*)[\])]", re.DOTALL)


@dataclass(frozen=True, eq=False)
class CommandRows:
    """Trajectory as rows for a controller.

    Attributes
    ----------
    t : array [N]
        Increasing times, s; the first one is 0.
    q : array [N,n]
        Positions, rad (m).
    qd, qdd, tau : array [N,n] or None
        Velocities, rad/s (m/s), accelerations, rad/s^2 (m/s^2), and torques, N m (N); None if the
        file has none.
    label : str
        Label for figures and certificates.
    marks : tuple of Mark
        Named times, such as those of stops.
    """

    t: FloatArray
    q: FloatArray
    qd: FloatArray | None = None
    qdd: FloatArray | None = None
    tau: FloatArray | None = None
    label: str = "trajectory"
    marks: tuple[Mark, ...] = ()

    def __post_init__(self) -> None:
        put = object.__setattr__
        t = checks.times("t", self.t)
        put(self, "t", t - t[0])
        put(self, "q", checks.array("q", self.q, (t.size, None), "rad"))
        for name, unit in (("qd", "rad/s"), ("qdd", "rad/s^2"), ("tau", "N m")):
            if getattr(self, name) is not None:
                put(self, name, checks.array(name, getattr(self, name), self.q.shape, unit))


def read_rows(path: str | Path, robot: Robot) -> CommandRows | Motion:
    """Read a trajectory of this package, of ROS, or from a plain table.

    Parameters
    ----------
    path : str or Path
        File in s, rad (m) and N m (N). ``.csv``: a time and n positions, optionally n velocities,
        accelerations and torques, with or without heads; if heads name the joints, as "elbow" or,
        like those of :meth:`~microbot_ocp.Motion.export`, "qd elbow [rad/s]", in any order.
        ``.json``, ``.yaml``: a ``JointTrajectory`` of ROS, or a message that holds one, with joints
        in any order. ``.npz``: a saved motion, which is returned as a motion, or arrays ``t``,
        ``q``, ``qd``, ``qdd``, ``tau``, with ``joint_names`` in any order.
    robot : Robot
        Robot that has the joints.

    Raises
    ------
    InputError
        The file cannot be read, joints or units differ, times do not increase, or positions are
        more than a turn beyond the limits, as if they were in degrees.
    """
    target = Path(path)
    refuse_toml(target, "trajectory")
    checks.one_of("ending of the file", target.suffix, FORMATS)
    with naming(f"{target.name}: "):
        if target.suffix == ".csv":
            rows = _of_table(text_of(target, "trajectory"), robot)
        elif target.suffix == ".npz":
            rows = _of_archive(target, robot)
        else:
            try:
                rows = _of_message(_document(target), _marks_beside(target), robot)
            except OverflowError:  # an integer of the file exceeds the range of floats
                raise InputError("it holds a number that is too large") from None
        checks.joints("it", rows.q.shape[1], robot)
        beyond = np.maximum(rows.q - robot.limits.q_max, robot.limits.q_min - rows.q)
        far = (beyond > 2.0 * np.pi) & (np.array(robot.joint_types) == "revolute")
        for row, joint in np.argwhere(far)[:1]:
            low, high = robot.limits.q_min[joint], robot.limits.q_max[joint]
            raise InputError(
                f"position of {robot.joint_names[joint]} in row {row + 1} is {rows.q[row, joint]:g}"
                f" rad, more than a turn beyond its limits, {low:g} to {high:g} rad: give radians"
            )
    return rows


def _of_table(text: str, robot: Robot) -> CommandRows:
    lines = list(io.StringIO(text.lstrip(), newline=""))  # quoted names may contain line ends
    lines[:1] = [line.lstrip("# ") for line in lines[:1]]
    reader = csv.reader(lines)
    heads, names = next(reader, []), robot.joint_names
    if not heads:
        raise InputError("it is empty")
    has_marks = heads[-1].strip() == "mark" and "mark" not in names
    count, width = robot.joint_count, len(heads) - has_marks
    named = not _is_number(heads[0])
    parsed = _parsed_heads(heads[:width], robot) if named else []
    by_names = any(key or joint in names for key, joint, _ in parsed[1:])
    if not by_names and width not in (1 + count * np.arange(1, 5)):
        raise InputError(
            f"it must have a time and 1 to 4 columns for each of {count} joints, separated by "
            f"commas, not {width} columns"
        )
    first = reader.line_num if named else 0
    values = _numbers_of(lines, first, width)
    order: Order = {}
    if not by_names:
        order = {(KEYS[k // count], k % count): k + 1 for k in range(width - 1)}
    if named:
        order = _columns_of(heads, parsed, order, robot, by_names)
    present = [key for key in KEYS if (key, 0) in order]
    columns = [[order[key, joint] for joint in range(count)] for key in present]
    given: Any = {key: values[:, places] for key, places in zip(present, columns, strict=True)}
    marks = _marks_of(lines[first:], values[:, 0]) if has_marks else ()
    return CommandRows(values[:, 0], **given, marks=marks)


def _parsed_heads(heads: Sequence[str], robot: Robot) -> list[tuple[str | None, str, str | None]]:
    """Return quantity, joint and unit of each head, with the robot's own names of joints."""
    parsed = [_parsed(head, robot.joint_names) for head in heads]
    known = _renamed([joint for _, joint, _ in parsed[1:]], robot)
    rows = zip(parsed[1:], known, strict=True)
    return [*parsed[:1], *((key, name, unit) for (key, _, unit), name in rows)]


def _marks_of(lines: Sequence[str], times: FloatArray) -> tuple[Mark, ...]:
    """Return the marks in the last column of rows at the given times [N]."""
    texts = [row[-1] for row in csv.reader(lines) if row]
    return tuple(
        _mark(text, time)
        for time, several in zip((times - times[0]).tolist(), texts, strict=True)
        for text in filter(None, several.split("; "))
    )


def _parsed(head: str, names: Sequence[str]) -> tuple[str | None, str, str | None]:
    """Return quantity, joint and unit of a head; parts of a joint's name may look like a unit."""
    ways = []
    for text in (head, head.strip()):
        key, rest = found.groups() if (found := KEY.fullmatch(text)) else (None, text)
        (bare, unit), (whole, own) = (
            found.groups() if (found := UNIT.fullmatch(part)) else (part, None)
            for part in (rest, text)
        )
        ways += [(key, bare, unit), (None, text, None), (None, whole, own), (key, rest, None)]
    return next((way for way in ways if way[1] in names), (key, bare.strip(), unit))


def _numbers_of(lines: Sequence[str], first: int, width: int) -> FloatArray:
    """Return the numbers [N,width] of a table from the line ``first`` on."""
    if len(lines) == first:
        raise InputError("it has heads and no rows")
    try:
        return np.loadtxt(
            lines[first:], delimiter=",", usecols=range(width), comments=None, ndmin=2,
            quotechar='"',
        )  # fmt: skip
    except ValueError:  # a quoted mark may contain a line end
        rows = []
        reader = csv.reader(lines[first:])
        for row in filter(None, reader):
            if not (len(row) >= width and all(map(_is_number, row[:width]))):
                line = first + reader.line_num
                raise InputError(
                    f"line {line} must hold {width} numbers, not {shown(row)}"
                ) from None
            rows.append([float(entry) for entry in row[:width]])
        return np.array(rows)


def _columns_of(
    heads: Sequence[str], parsed: Sequence[Any], order: Order, robot: Robot, by_names: bool
) -> Order:
    """Return the column of each quantity of each joint, from heads that name joints.

    Heads that name no joints leave the columns as in ``order``.
    """
    names = robot.joint_names
    key, joint, unit = parsed[0]
    if (key or joint in names) and unit != "s" and joint not in TIME:
        raise InputError(f"its first column must be the time, s, not {heads[0]!r}")
    if by_names:
        order = _by_names([(key, joint) for key, joint, _ in parsed[1:]], robot)
    units = {0: "s"}
    for (key, place), column in order.items():
        units[column] = robot.unit(key, place)
        # A head such as "elbow_position" must not stand over the column of the waist.
        named = [] if by_names else [name for name in names if _speaks_of(heads[column], name)]
        if named and names[place] not in named:
            raise InputError(
                f"column {heads[column]!r} must be of {names[place]}, or named {named[0]!r}"
            )
    for column, (_, _, unit) in enumerate(parsed):
        if unit and unit != units.get(column, unit):
            raise InputError(f"column {heads[column]!r} must be in {units[column]}, not in {unit}")
    return order


def _speaks_of(head: str, name: str) -> bool:
    """Return True if a head contains a name as one of its words."""
    return bool(re.search(rf"(?<![^\W_]){re.escape(name)}(?![^\W_])", head)) and bool(name.strip())


def _by_names(heads: Sequence[tuple[str | None, str]], robot: Robot) -> Order:
    """Return the column of each quantity of each joint, from heads with joint names.

    A head without quantity belongs to the first quantity that its joint does not have yet.
    """
    _order(list(dict.fromkeys(joint for _, joint in heads)), robot)
    order: Order = {}
    for column, (key, joint) in enumerate(heads, 1):
        if joint not in robot.joint_names:
            continue
        place = robot.joint_names.index(joint)
        key = key or next((k for k in KEYS if (k, place) not in order), KEYS[-1])
        if (key, place) in order:
            raise InputError(f"it has two columns of {key} of {joint}")
        order[key, place] = column
    given = {"q", *(key for key, _ in order)}
    for key, place in product(KEYS, range(robot.joint_count)):
        if key in given and (key, place) not in order:
            raise InputError(f"it has no column of {key} of {robot.joint_names[place]}")
    return order


def _mark(text: str, time: float) -> Mark:
    """Return the mark of a row: "grip" is at the row's time, "above @ 0.71" at 0.71 s."""
    name, _, at = text.rpartition(" @ ")
    own = name and _is_number(at)
    return Mark(float(at), unquote(name)) if own else Mark(time, unquote(text))


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _renamed(names: Sequence[str], robot: Robot) -> Sequence[str]:
    """Replace the numbers that an export without a robot writes by the joints' names."""
    own = {f"joint_{number}": name for number, name in enumerate(robot.joint_names, start=1)}
    return [own[name] for name in names] if {*names} == {*own} - {*own.values()} else names


def _order(names: Sequence[str], robot: Robot) -> list[int]:
    """Return the place of each joint of the robot among these names."""
    given = list(map(str, names))
    if not set(given) >= set(robot.joint_names) or len(set(given)) != len(given):
        raise InputError(
            f"its joints must be {', '.join(robot.joint_names)}, not {', '.join(given)}"
        )
    if others := [name for name in given if name not in robot.joint_names]:
        warn_user(f"not judged, as {robot.name} has no such joints: {', '.join(others)}")
    return [given.index(name) for name in robot.joint_names]


def _of_archive(path: Path, robot: Robot) -> CommandRows | Motion:
    bytes_of(path, "trajectory")  # raises unless it is a plain file
    try:
        arrays: Any = arrays_in(path, (*ARRAYS, METADATA))
    except Exception as problem:  # numpy raises various errors on damaged archives
        raise InputError(f"it is no archive of numpy: {problem}") from None
    if arrays.pop(METADATA, None) is not None:
        return Motion.load(path)
    if not {"t", "q"} <= set(arrays):
        raise InputError(f"it must hold the arrays t and q, and may hold {', '.join(ARRAYS[2:])}")
    names = arrays.pop("joint_names", None)
    rows = CommandRows(**arrays)
    if names is None:
        return rows
    order = _order(given := np.atleast_1d(names).tolist(), robot)
    if rows.q.shape[1] != len(given):
        raise InputError(f"it has {rows.q.shape[1]} joints, but {len(given)} joint_names")
    return CommandRows(**{key: a[:, order] if key != "t" else a for key, a in arrays.items()})


def _document(path: Path) -> Any:
    if path.suffix != ".json":
        return yaml_of(path, "trajectory")
    try:
        return json.loads(text_of(path, "trajectory"))
    except (ValueError, RecursionError) as problem:
        raise InputError(f"it is no JSON: {problem}") from None


def _marks_beside(path: Path) -> Sequence[Any]:
    """Return the marks that were written beside a message; empty without such a file."""
    beside = marks_path(path)
    if not beside.is_file():
        return ()
    with naming(f"{beside.name}: "):
        document = _document(beside)
        if not isinstance(document, dict) or not isinstance(document.get("marks"), list):
            raise InputError("it must hold a list of marks")
        if document.get("of") != digest(path):
            raise InputError(f"it holds marks of another file than {path.name}: remove it")
    return document["marks"]


def _of_message(document: Any, given: Sequence[Any], robot: Robot) -> CommandRows:
    for message in document if isinstance(document, list) else [document]:
        if isinstance(message, dict):
            check_message(message, kind_of(message, MESSAGES_HERE))
    messages = list(_trajectories_in(document))
    if len(messages) != 1:
        raise InputError(
            f"it must hold one trajectory with joint_names and points, but holds {len(messages)}"
        )
    names, points = messages[0]["joint_names"], messages[0]["points"]
    if not isinstance(names, list) or not isinstance(points, list) or not points:
        raise InputError("joint_names and points must be lists that are not empty")
    order = _order(_renamed(list(map(str, names)), robot), robot)
    t = [_seconds(point, k) for k, point in enumerate(points)]
    columns = {}
    for field, key in FIELDS.items():
        rows = [point.get(field) or [] for point in points]
        if not any(rows):
            continue
        for k, row in enumerate(rows, 1):
            numbers = isinstance(row, list) and set(map(type, row)) <= {int, float}
            if not numbers or len(row) != len(names):
                raise InputError(
                    f"{field} of point {k} must be {len(names)} numbers, not {shown(row)}"
                )
        columns[key] = np.array(rows, dtype=float)[:, order]
    if "q" not in columns:
        raise InputError("its points have no positions")
    marks = [Mark(_seconds(mark, k) - t[0], str(mark.get("name"))) for k, mark in enumerate(given)]
    return CommandRows(np.array(t), **columns, marks=tuple(marks))


def _trajectories_in(document: Any, depth: int = 0) -> Iterator[Mapping[str, Any]]:
    """Yield the joint trajectories within a message, as MoveIt's plans nest them."""
    if depth > 6 or not isinstance(document, dict | list):
        return
    if isinstance(document, dict) and {"joint_names", "points"} <= set(document):
        if document["joint_names"] or document["points"]:
            yield document
        return
    inner = document.items() if isinstance(document, dict) else enumerate(document)
    for key, value in inner:
        if not str(key).startswith("multi_dof_"):
            yield from _trajectories_in(value, depth + 1)


def _seconds(point: Any, row: int) -> float:
    stamp = point.get("time_from_start") if isinstance(point, dict) else None
    if isinstance(stamp, dict):
        whole = stamp.get("sec", stamp.get("secs"))
        rest = stamp.get("nanosec", stamp.get("nsecs", 0))
        if isinstance(whole, int) and isinstance(rest, int):
            return whole + rest / NANOSECONDS
    elif isinstance(stamp, int | float):
        return float(stamp)
    raise InputError(f"time_from_start of point {row + 1} must be a time, not {shown(stamp)}")
