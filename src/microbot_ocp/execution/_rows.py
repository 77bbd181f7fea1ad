"""Rows of anyone's trajectory: times, positions, and velocities and accelerations where given."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.archive import METADATA, arrays_in
from microbot_ocp._base.checks import FloatArray, InputError, naming, shortened, shown
from microbot_ocp._base.reading import bytes_of, text_of, yaml_of
from microbot_ocp.motion import FIELDS, Mark, Motion
from microbot_ocp.robot import Robot

FORMATS = (".csv", ".json", ".yaml", ".yml", ".npz")
KEYS = tuple(FIELDS.values())
Order = dict[tuple[str, int], int]  # columns of a table by quantity and joint
ARRAYS = ("t", "q", "qd", "qdd", "tau", "joint_names")
# "qd elbow [rad/s]", "elbow", "time (s)"
HEAD = re.compile(r"(?:(q|qd|qdd|tau) )?(.*?)(?: *[\[(](.*)[\])])?")


@dataclass(frozen=True, eq=False)
class CommandRows:
    """What a file for a controller holds.

    Attributes
    ----------
    t : array [N]
        Increasing times from 0, s: those of the file from its first one on.
    q : array [N,n]
        rad (m).
    qd, qdd, tau : array [N,n] or None
        rad/s (m/s), rad/s^2 (m/s^2), N m (N); None where the file has none.
    label : str
    marks : tuple of Mark
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
    """Read a trajectory of this package, of ROS, or a plain table.

    Parameters
    ----------
    path : str or Path
        ``.csv``: a time and n positions, then n velocities, accelerations and torques as far as
        there are any, with or without heads; where heads name the joints, as "elbow" or, like
        those of :meth:`~microbot_ocp.Motion.export`, "qd elbow [rad/s]", in any order.
        ``.json``, ``.yaml``: a ``JointTrajectory`` of ROS, or a message that holds one, with joints
        in any order. ``.npz``: a saved motion, which is returned as one, or arrays ``t``, ``q``,
        ``qd``, ``qdd``, ``tau``, with ``joint_names`` in any order. All in s, rad (m) and N m (N).
    robot : Robot
        Whose joints they are.

    Raises
    ------
    InputError
        A file that cannot be read, other joints or units, times that do not increase, positions
        more than a turn beyond the limits, such as degrees.
    """
    target = Path(path)
    checks.one_of("ending of the file", target.suffix, FORMATS)
    with naming(f"{target.name}: "):
        if target.suffix == ".csv":
            rows = _of_table(text_of(target, "trajectory"), robot)
        elif target.suffix == ".npz":
            rows = _of_archive(target, robot)
        else:
            try:
                rows = _of_message(_document(target), robot)
            except OverflowError:  # of a whole number that is no float
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
    lines = text.strip().splitlines()
    first = next(csv.reader([line.lstrip("# ") for line in lines[:1]]), [])
    heads = [head.strip() for head in first]
    if not heads:
        raise InputError("it is empty")
    count, width = robot.joint_count, len(heads) - (heads[-1] == "mark")
    if width not in (1 + count * np.arange(1, 5)):
        raise InputError(
            f"it must have a time and 1 to 4 columns for each of {count} joints, parted by commas, "
            f"not {width} columns"
        )
    named = not _is_number(heads[0])
    values = _numbers_of(lines, int(named), width)
    order = {(KEYS[k // count], k % count): k + 1 for k in range(width - 1)}
    if named:
        order = _columns_of(heads[:width], order, robot)
    present = [key for key in KEYS if (key, 0) in order]
    columns = [[order[key, joint] for joint in range(count)] for key in present]
    given: Any = {key: values[:, places] for key, places in zip(present, columns, strict=True)}
    marks: list[Mark] = []
    if heads[-1] == "mark":
        texts = [row[-1] for row in csv.reader(lines[1:]) if row]
        times = (values[:, 0] - values[0, 0]).tolist()
        marks = [
            _mark(text, time)
            for time, several in zip(times, texts, strict=True)
            for text in filter(None, several.split("; "))
        ]
    return CommandRows(values[:, 0], **given, marks=tuple(marks))


def _numbers_of(lines: Sequence[str], first: int, width: int) -> FloatArray:
    """Return the numbers [N,width] of a table from its line ``first`` on."""
    if len(lines) == first:
        raise InputError("it has heads and no rows")
    try:
        return np.loadtxt(
            lines[first:], delimiter=",", usecols=range(width), comments=None, ndmin=2,
            quotechar='"',
        )  # fmt: skip
    except ValueError:
        for k, row in enumerate(csv.reader(lines[first:]), first + 1):
            if row and not (len(row) >= width and all(map(_is_number, row[:width]))):
                raise InputError(f"line {k} must hold {width} numbers, not {shown(row)}") from None
        raise


def _columns_of(heads: Sequence[str], order: Order, robot: Robot) -> Order:
    """Return where each quantity of each joint is, by heads that name joints; else as in
    ``order``.
    """
    parsed = [match.groups() for head in heads if (match := HEAD.fullmatch(head))]
    names = robot.joint_names
    if parsed[0][1] in names or any(key or joint in names for key, joint, _ in parsed[1:]):
        if parsed[0][0] or parsed[0][1] in names:
            raise InputError(f"its first column must be the time, s, not {heads[0]!r}")
        order = _by_names([(key, joint) for key, joint, _ in parsed[1:]], robot)
    units = {0: "s"}
    for (key, place), column in order.items():
        units[column] = robot.unit(key, place)
        # "elbow_position" in the place of the waist
        named = [name for name in names if name in heads[column]]
        if named and names[place] not in named:
            raise InputError(
                f"column {heads[column]!r} must be of {names[place]}, or named {named[0]!r}"
            )
    for column, (_, _, unit) in enumerate(parsed):
        if unit and unit != units[column]:
            raise InputError(f"column {heads[column]!r} must be in {units[column]}, not in {unit}")
    return order


def _by_names(heads: Sequence[tuple[str | None, str]], robot: Robot) -> Order:
    """Return where each quantity of each joint is, by heads that may name the first and do the
    second.
    """
    _order(list(dict.fromkeys(joint for _, joint in heads)), robot)
    order: Order = {}
    for column, (key, joint) in enumerate(heads, 1):
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
    """Return a mark of a row: "grip" is at its time, "above @ 0.71" before it."""
    name, _, at = text.rpartition(" @ ")
    return Mark(float(at), name) if name and _is_number(at) else Mark(time, text)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _order(names: Sequence[str], robot: Robot) -> list[int]:
    """Return where each joint of the robot is among these names."""
    if sorted(map(str, names)) != sorted(robot.joint_names):
        raise InputError(
            f"its joints must be {', '.join(robot.joint_names)}, not {', '.join(map(str, names))}"
        )
    return [list(names).index(name) for name in robot.joint_names]


def _of_archive(path: Path, robot: Robot) -> CommandRows | Motion:
    bytes_of(path, "trajectory")  # a plain file
    try:
        arrays: Any = arrays_in(path, (*ARRAYS, METADATA))
    except Exception as problem:  # as archives raise on damage
        raise InputError(f"it is no archive of numpy: {shortened(str(problem), 120)}") from None
    if arrays.pop(METADATA, None) is not None:
        return Motion.load(path)
    if not {"t", "q"} <= set(arrays):
        raise InputError(f"it must hold the arrays t and q, and may hold {', '.join(ARRAYS[2:])}")
    names = arrays.pop("joint_names", None)
    rows = CommandRows(**arrays)
    if names is None:
        return rows
    order = _order(np.atleast_1d(names).tolist(), robot)
    checks.joints("it", rows.q.shape[1], robot)
    return CommandRows(**{key: a[:, order] if key != "t" else a for key, a in arrays.items()})


def _document(path: Path) -> Any:
    if path.suffix != ".json":
        return yaml_of(path, "trajectory")
    try:
        return json.loads(text_of(path, "trajectory"))
    except (ValueError, RecursionError) as problem:
        raise InputError(f"it is no JSON: {problem}") from None


def _of_message(document: Any, robot: Robot) -> CommandRows:
    messages = list(_trajectories_in(document))
    if len(messages) != 1:
        raise InputError(
            f"it must hold one trajectory with joint_names and points, but holds {len(messages)}"
        )
    names, points = messages[0]["joint_names"], messages[0]["points"]
    if not isinstance(names, list) or not isinstance(points, list) or not points:
        raise InputError("joint_names and points must be lists that are not empty")
    order = _order(names, robot)
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
    given = document.get("marks", ()) if isinstance(document, dict) else ()
    marks = [Mark(_seconds(mark, k) - t[0], str(mark.get("name"))) for k, mark in enumerate(given)]
    return CommandRows(np.array(t), **columns, marks=tuple(marks))


def _trajectories_in(document: Any, depth: int = 0) -> Iterator[Mapping[str, Any]]:
    """Return trajectories of joints within a message, as MoveIt's plans hold them."""
    if depth > 6 or not isinstance(document, dict | list):
        return
    if isinstance(document, dict) and {"joint_names", "points"} <= set(document):
        yield document
        return
    inner = document.items() if isinstance(document, dict) else enumerate(document)
    for key, value in inner:
        if key != "multi_dof_joint_trajectory":
            yield from _trajectories_in(value, depth + 1)


def _seconds(point: Any, row: int) -> float:
    stamp = point.get("time_from_start") if isinstance(point, dict) else None
    if isinstance(stamp, dict):
        whole = stamp.get("sec", stamp.get("secs"))
        rest = stamp.get("nanosec", stamp.get("nsecs", 0))
        if isinstance(whole, int) and isinstance(rest, int):
            return whole + 1e-9 * rest
    elif isinstance(stamp, int | float):
        return float(stamp)
    raise InputError(f"time_from_start of point {row + 1} must be a time, not {shown(stamp)}")
