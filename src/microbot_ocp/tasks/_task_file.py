"""Tasks in TOML files: robot, via points, limits, methods, settings, outputs.

The schema is in docs/task_file.md. An error in a file is one sentence that names the file, the key,
the value and the allowed values.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError, naming, shown
from microbot_ocp._base.schema import (
    ANGLE,
    ANY,
    FLAG,
    TABLE,
    TABLES,
    TEXT,
    Key,
    check_schema,
    names_of,
    read_table,
    table_from,
)
from microbot_ocp.limits import JOINT_QUANTITIES, MEMBER_KEYS, changes_by_name
from microbot_ocp.planning import PathTimingSettings, TimeOptimalSettings
from microbot_ocp.robot import JointLimits, Robot, joint_scale, per_joint
from microbot_ocp.robot.files import is_robot_name, load_robot, packaged_robots
from microbot_ocp.tasks._comparison import METHODS, OUTPUTS, Comparison, Progress, compare, timing

SCHEMA = 1
ANGULAR = ("q", "qd", "qdd", "qddd")  # quantities that may be given in degrees
_SETTINGS: dict[str, Callable[..., Any]] = {
    f.name: TimeOptimalSettings for f in fields(TimeOptimalSettings)
} | {"grid": PathTimingSettings}
JOINT_KEYS = {
    f"{quantity}_{side}": Key(degrees=quantity in ANGULAR)
    for quantity in JOINT_QUANTITIES
    for side in ("min", "max")
}
LIMITS = JOINT_KEYS | dict.fromkeys(MEMBER_KEYS, ANY)
SETTINGS = {**dict.fromkeys(_SETTINGS, ANY), "compiled": FLAG, "blend": ANY}
COMMON = {"schema": ANY, "robot": ANY, "tip": TEXT}
TASK = {
    **COMMON,
    "methods": Key(choices=METHODS, several=True),
    "outputs": Key(choices=OUTPUTS, several=True),
    "via": TABLE,
    "limits": TABLE,
    "settings": TABLE,
}
CELL_OUTPUTS = ("json", "motion", "figure", "recording")  # default outputs
FILMS = ("gif", "mp4")
ON_REQUEST = ("report", *FILMS)  # slow outputs
CELL = {
    **COMMON,
    "outputs": Key(choices=(*CELL_OUTPUTS, *ON_REQUEST), several=True),
    "stop": TABLES,
    "segment": TABLES,
    "cycle": FLAG,
    "order": Key(choices=("given", "free")),
    "duration": ANY,
    "limits": TABLE,
    "settings": TABLE,
    "scene": ANY,
    "capsule": TABLES,
    "front": TABLE,
    "mounting": TABLE,
}
VIA = {"q": ANGLE, "t": ANY, "qd": ANGLE}
KEYS = {
    "": names_of(TASK),
    "via": names_of(VIA),
    "limits": names_of(LIMITS),
    "settings": names_of(SETTINGS),
}


@dataclass(frozen=True, eq=False)
class TaskFile:
    """Checked task of via points from a file, in SI units.

    Attributes
    ----------
    origin : str
        Name of the file, for messages.
    robot : Robot
        Robot with its own limits.
    via_q : array [m,n], rad (m)
    via_t : array [m], s, or None
    via_qd : array [m,n], rad/s (m/s), or None
    limits : JointLimits
        Limits of the robot with the changes of the file.
    methods : tuple of str, or None
        None for the default of :func:`microbot_ocp.compare`.
    settings : mapping
        Keywords of :func:`microbot_ocp.compare`.
    outputs : tuple of str
        Some of :data:`OUTPUTS`.
    """

    origin: str
    robot: Robot
    via_q: FloatArray
    via_t: FloatArray | None
    via_qd: FloatArray | None
    limits: JointLimits
    methods: tuple[str, ...] | None
    settings: Mapping[str, Any]
    outputs: tuple[str, ...]

    def compare(self, progress: Progress | None = None, time_limit: float = np.inf) -> Comparison:
        """Solve the task by its methods; ``time_limit`` (s) may shorten the file's time limit.

        Raises
        ------
        InputError
            Errors that only a method detects, such as a via point that cannot be held at rest.
        """
        task = self.robot, self.via_q, self.methods, self.limits
        settings = {**self.settings, "via_t": self.via_t, "via_qd": self.via_qd}
        settings["time_limit"] = min(time_limit, settings.get("time_limit", np.inf))
        with naming(f"{self.origin}: "):
            return compare(*task, progress=progress, **settings)


def read_task(path: str | Path) -> TaskFile:
    """Read a task from a TOML file.

    Parameters
    ----------
    path : str or Path
        Task file; paths of robots inside the file are relative to its folder.

    Returns
    -------
    TaskFile
        Checked task in SI units.

    Raises
    ------
    InputError
        A file that cannot be read, a key that is unknown or missing, a value of the wrong type.

    Examples
    --------
    >>> import tempfile
    >>> text = '''
    ... schema = 1
    ... robot = "microbot"
    ... methods = ["cubic"]
    ... [via]
    ... q_deg = [[0, 0, 0], [-90, 90, 90]]
    ... '''
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "task.toml"
    ...     _ = file.write_text(text)
    ...     task = read_task(file)
    >>> task.robot.name, task.via_q.shape
    ('microbot', (2, 3))
    """
    source = Path(path)
    with table_from(source, "task") as data:
        if "via" not in data:  # check all keys, because [[stops]] may be meant for [[stop]]
            read_table(data, TASK | CELL)
        given = read_table(data, TASK, elsewhere=dict.fromkeys(CELL, "is for tasks of [[stop]]"))
        check_schema(data, SCHEMA)
        robot = robot_from(data, source.parent)
        if "via" not in given:
            raise InputError("table [via] is missing: it holds the via points, q or q_deg")
        via = read_table(given["via"], VIA, "in table [via]", "via.{}", partial(_via_rows, robot))
        via_q = via.get("q")
        if via_q is None:
            raise InputError(
                "via.q or via.q_deg is missing: one row of joint positions per via point"
            )
        if len(via_q) < 2:
            raise InputError(f"via.q must have at least 2 rows, not {len(via_q)}")
        via_t, via_qd = timing(via_q, via.get("t"), via.get("qd"), "via.")
        methods = given.get("methods")
        for name in methods or ():
            if METHODS[name].timed and via_t is None:
                raise InputError(f"methods has {name!r}, which needs via.t, times in s")
        limits = limits_from(robot, given.get("limits", {}))
        settings = settings_from(given.get("settings", {}))
        methods, outputs = methods and tuple(methods), tuple(given.get("outputs", OUTPUTS))
        return TaskFile(
            source.name, robot, via_q, via_t, via_qd, limits, methods, settings, outputs
        )


def robot_from(data: Mapping[str, Any], folder: Path) -> Robot:
    """Return the robot that a file names."""
    source = data.get("robot")
    if not isinstance(source, str):
        instead = f"not {source!r}" if "robot" in data else "but it is missing"
        raise InputError(
            f"robot must be one of {', '.join(packaged_robots())}, or the path of a .toml or .urdf "
            f"file, {instead}"
        )
    path = source if is_robot_name(source) else str(folder / source)
    return load_robot(path, data.get("tip"))


def _via_rows(robot: Robot, key: str, name: str, rows: Any, in_degrees: bool) -> Any:
    """Return the rows [m,n] of the via points in SI units."""
    if key == "t":
        return rows
    if not isinstance(rows, list) or not all(isinstance(row, list) for row in rows) or not rows:
        raise InputError(f"{name} must be a list of rows, one per via point, not {shown(rows)}")
    for index, row in enumerate(rows):
        if len(row) != robot.joint_count:
            raise InputError(
                f"{name} must have {robot.joint_count} numbers in every row "
                f"({', '.join(robot.joint_names)}), but row {index + 1} is {row}"
            )
    values = checks.array(name, rows, (None, robot.joint_count))
    return values * joint_scale(robot) if in_degrees else values


def limits_from(robot: Robot, table: Mapping[str, Any]) -> JointLimits:
    """Return the limits of the robot with the changes of a table."""

    def of_joints(key: str, name: str, value: Any, in_degrees: bool) -> Any:
        if key in MEMBER_KEYS:
            return value
        values = per_joint(robot, name, value)
        return values * joint_scale(robot) if in_degrees else values

    changes = read_table(table, LIMITS, "in table [limits]", "limits.{}", of_joints)
    with naming("limits."):
        return robot.with_limits(**changes_by_name(robot.limits.also, changes)).limits


def settings_from(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return the checked settings of a table."""
    settings = read_table(table, SETTINGS, "in table [settings]", "settings.{}")
    with naming("settings."):
        for key, value in settings.items():
            if key == "blend":
                checks.number("blend", value, "of a segment", above=0.0, at_most=0.5)
            else:
                _SETTINGS[key](**{key: value})
    return settings
