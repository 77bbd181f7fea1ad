"""Rows of anyone's trajectory: times, positions, and velocities and accelerations where given."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError, naming, shown
from microbot_ocp._base.reading import bytes_of, text_of, yaml_of
from microbot_ocp.motion import FIELDS, Mark, Motion
from microbot_ocp.robot import Robot

FORMATS = (".csv", ".json", ".yaml", ".yml", ".npz")


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


def read_rows(path: str | Path, robot: Robot) -> CommandRows:
    """Read a trajectory of this package, of ROS, or a plain table.

    Parameters
    ----------
    path : str or Path
        ``.csv``: a time and n positions, then n velocities, accelerations and torques as far as
        there are any, with or without heads; where heads name the joints, as those of
        :meth:`~microbot_ocp.Motion.export` do, in any order. ``.json``, ``.yaml``: a
        ``JointTrajectory`` of ROS, or a message that holds one, with joints in any order. ``.npz``:
        a saved motion, or arrays ``t``, ``q``, ``qd``, ``qdd``, ``tau``.
    robot : Robot
        Whose joints they are.

    Raises
    ------
    InputError
        A file that cannot be read, other joints, times that do not increase.
    """
    target = Path(path)
    checks.one_of("ending of the file", target.suffix, FORMATS)
    with naming(f"{target.name}: "):
        if target.suffix == ".csv":
            rows = _of_table(text_of(target, "trajectory"), robot)
        elif target.suffix == ".npz":
            rows = _of_archive(target)
        else:
            rows = _of_message(_document(target), robot)
        checks.joints("it", rows.q.shape[1], robot)
    return rows


def _of_table(text: str, robot: Robot) -> CommandRows:
    stream = io.StringIO(text.strip())
    heads = [head.strip() for head in next(csv.reader(stream), [])]
    if not heads:
        raise InputError("it is empty")
    count, width = robot.joint_count, len(heads) - (heads[-1] == "mark")
    if width not in (1 + count * np.arange(1, 5)):
        raise InputError(
            f"it must have a time and 1 to 4 columns for each of {count} joints, not {width} in all"
        )
    if _is_number(heads[0]):
        stream.seek(0)
    try:
        values = np.loadtxt(
            stream, delimiter=",", usecols=range(width), comments=None, ndmin=2, quotechar='"'
        )
    except ValueError:
        raise InputError("every line below the heads must hold as many numbers") from None
    columns = [values[:, k : k + count] for k in range(1, values.shape[1], count)]
    keys = tuple(FIELDS.values())[: len(columns)]
    named = {
        (match[1], match[2]): k
        for k, head in enumerate(heads)
        if (match := re.fullmatch(r"(q|qd|qdd|tau) (.+) \[.*\]", head))
    }
    if named:
        order = _order([joint for key, joint in named if key == "q"], robot)
        names = [[joint for key, joint in named if key == "q"][k] for k in order]
        try:
            columns = [values[:, [named[key, joint] for joint in names]] for key in keys]
        except KeyError as missing:
            raise InputError(f"it has no column of {missing}") from None
    given: Any = dict(zip(keys, columns, strict=True))
    return CommandRows(values[:, 0], **given)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _order(names: Sequence[str], robot: Robot) -> list[int]:
    """Where each joint of the robot is among these names."""
    if sorted(names) != sorted(robot.joint_names):
        raise InputError(
            f"its joints must be {', '.join(robot.joint_names)}, not {', '.join(map(str, names))}"
        )
    return [list(names).index(name) for name in robot.joint_names]


def _of_archive(path: Path) -> CommandRows:
    bytes_of(path, "trajectory")  # a plain file
    try:
        with np.load(path, allow_pickle=False) as archive:
            saved = "metadata" in archive
            arrays = {key: archive[key] for key in ("t", *FIELDS.values()) if key in archive}
    except (OSError, ValueError, EOFError, KeyError):
        raise InputError("it is no archive of numpy") from None
    if saved:
        motion = Motion.load(path)
        return CommandRows(
            motion.t, motion.q, motion.qd, motion.qdd, motion.tau, motion.label, motion.marks
        )
    if not {"t", "q"} <= set(arrays):
        raise InputError("it must hold the arrays t and q")
    given: Any = arrays
    return CommandRows(**given)


def _document(path: Path) -> Any:
    if path.suffix != ".json":
        return yaml_of(path, "trajectory")
    try:
        return json.loads(text_of(path, "trajectory"))
    except (ValueError, RecursionError) as problem:
        raise InputError(f"it is no JSON: {problem}") from None


def _of_message(document: Any, robot: Robot) -> CommandRows:
    message = _trajectory_in(document)
    if message is None:
        raise InputError("it holds no trajectory with joint_names and points")
    names, points = message["joint_names"], message["points"]
    if not isinstance(names, list) or not isinstance(points, list) or not points:
        raise InputError("joint_names and points must be lists that are not empty")
    order = _order(names, robot)
    t = [_seconds(point, k) for k, point in enumerate(points)]
    columns = {}
    for field, key in FIELDS.items():
        rows = [point.get(field) or [] for point in points]
        if any(rows):
            with naming(f"{field}: "):
                columns[key] = checks.array(key, rows, (len(points), len(names)))[:, order]
    if "q" not in columns:
        raise InputError("its points have no positions")
    return CommandRows(np.array(t), **columns)


def _trajectory_in(document: Any, depth: int = 0) -> Mapping[str, Any] | None:
    """A trajectory, or the first one within a message, as MoveIt's plans hold them."""
    if not isinstance(document, dict) or depth > 4:
        return None
    if {"joint_names", "points"} <= set(document):
        return document
    inner = (_trajectory_in(value, depth + 1) for value in document.values())
    return next((found for found in inner if found is not None), None)


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
