"""Reader of saved comparisons."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.archive import read_document
from microbot_ocp._base.checks import FloatArray, InputError, shown
from microbot_ocp._base.schema import check_schema
from microbot_ocp._base.status import Status
from microbot_ocp.certificate import certify
from microbot_ocp.motion import Motion
from microbot_ocp.planning.task import check_limits, check_via
from microbot_ocp.robot import Limits, Robot, load_robot, packaged_robots
from microbot_ocp.tasks._comparison import Comparison, Entry
from microbot_ocp.tasks._folder import INDEX, NAME, check_run
from microbot_ocp.tasks._task_file import JOINT_KEYS

SCHEMA = 1
KINDS = {
    **dict.fromkeys(("robot", "reference"), str),
    "via_q": list,
    "entries": list[dict],
    "limits": dict[str, list],
}


def load_comparison(folder: str | Path, robot: Robot | str | None = None) -> Comparison:
    """Read a comparison from the folder of :meth:`Comparison.save`; certify its motions again.

    Parameters
    ----------
    folder : path
        Folder of the comparison.
    robot : Robot or str, optional
        Robot, or an argument of :func:`microbot_ocp.load_robot`; default the packaged robot that
        the file names.

    Raises
    ------
    InputError
        The folder holds no comparison, its files are damaged or from two runs, or it names an
        unknown robot.
    """
    folder = Path(folder)
    origin = str(folder / INDEX)
    saved = read_document(origin, "comparison", KINDS)
    with checks.naming(f"{origin}: "):
        check_schema(saved, SCHEMA)
    names = [str(row.get("name")) for row in saved["entries"]]
    if not all(map(NAME.fullmatch, names)) or len(set(names)) < len(names):
        raise InputError(f"entries of {origin} must have different names, not {shown(names)}")
    arm = named_robot(origin, saved["robot"], robot)
    arm = arm.with_limits(_stored_limits(origin, saved["limits"]))
    via = checks.array(f"via_q of {origin}", saved["via_q"], (None, arm.joint_count))
    check_via(check_limits(arm, None), via)
    rows = zip(names, saved["entries"], strict=True)
    entries = tuple(_entry(arm, via, folder, name, row) for name, row in rows)
    check_run(folder, saved)  # checked after reading, so that every file read is of this run
    return Comparison(arm, via, arm.limits, entries, saved["reference"])


def named_robot(origin: str, named: str | None, given: Robot | str | None) -> Robot:
    """Return the given robot, or the packaged robot that the file ``origin`` names."""
    if given is not None:
        return given if isinstance(given, Robot) else load_robot(given)
    if named is None:
        raise InputError(f"{origin} does not name its robot: give robot (--robot)")
    if named not in packaged_robots():
        raise InputError(
            f"{origin} names robot {named!r}, which is not packaged: give robot (--robot)"
        )
    return load_robot(named)


def _stored_limits(origin: str, saved: Mapping[str, list[Any]]) -> Limits:
    """Return limits from JSON, in which null is an infinite limit."""
    arrays = {}
    for key, values in saved.items():
        checks.one_of(f"limits of {origin}", key, JOINT_KEYS)
        none = -np.inf if key.endswith("_min") else np.inf
        arrays[key] = [none if value is None else value for value in values]
    return Limits(**arrays)


def _entry(robot: Robot, via: FloatArray, folder: Path, name: str, row: Mapping[str, Any]) -> Entry:
    path = folder / "motions" / f"{name}.npz"
    motion = Motion.load(path) if path.exists() else None
    if motion is not None:
        checks.joints(str(path), motion.joint_count, robot)
    return Entry(
        name=name,
        title=str(row.get("title", name)),
        motion=motion,
        certificate=None if motion is None else certify(robot, motion, via_q=via),
        status=Status(checks.one_of("status", row.get("status", ""), list(Status))),
        note=str(row.get("note", "")),
        solve_time=_float(row.get("solve_time")),
        torque_squared=_float(row.get("torque_squared")),
        work=_float(row.get("work")),
    )


def _float(value: Any) -> float:
    usable = isinstance(value, int | float) and abs(value) <= sys.float_info.max
    return float(value) if usable else np.nan
