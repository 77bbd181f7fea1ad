"""Tasks in TOML files: robot, via points, limits, methods, settings, outputs.

The schema is in docs/task_file.md.

Whatever is wrong in a file is one sentence that names the file, the key, the value and what is
allowed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError, naming
from microbot_ocp._base.reading import text_of
from microbot_ocp._base.toml_file import (
    check_keys,
    check_schema,
    parsed,
    suggestion,
    table_of,
)
from microbot_ocp.limits import JOINT_QUANTITIES, MEMBER_KEYS, with_further
from microbot_ocp.planning import PathTimingSettings, TimeOptimalSettings
from microbot_ocp.robot import JointLimits, Robot, joint_scale, per_joint
from microbot_ocp.robot.files import load_robot, packaged_robots
from microbot_ocp.tasks._comparison import (
    METHODS,
    OUTPUTS,
    Comparison,
    Progress,
    compare,
)

SCHEMA = 1
LIMIT_KEYS = tuple(f"{quantity}_{side}" for quantity in JOINT_QUANTITIES for side in ("min", "max"))
ANGULAR = ("q", "qd", "qdd", "qddd")  # quantities that may be given in degrees
_SETTINGS: dict[str, Callable[..., Any]] = {
    f.name: TimeOptimalSettings for f in fields(TimeOptimalSettings)
} | {"grid": PathTimingSettings}
KEYS: dict[str, tuple[str, ...]] = {
    "": ("schema", "robot", "tip", "methods", "outputs", "via", "limits", "settings"),
    "via": ("q", "q_deg", "t", "qd", "qd_deg"),
    "limits": (
        *(
            name
            for key in LIMIT_KEYS
            for name in ((key, f"{key}_deg") if key.split("_")[0] in ANGULAR else (key,))
        ),
        *MEMBER_KEYS,
    ),
    "settings": (*_SETTINGS, "blend"),
}


@dataclass(frozen=True, eq=False)
class TaskFile:
    """A task as a file states it, checked and in SI units.

    Attributes
    ----------
    origin : str
        Name of the file, for messages.
    robot : Robot
        With its own limits.
    via_q : array [m,n], rad (m)
    via_t : array [m], s, or None
    via_qd : array [m,n], rad/s (m/s), or None
    limits : JointLimits
        Those of the robot with the changes of the file.
    methods : tuple of str, or None
        None: what :func:`microbot_ocp.compare` does by default.
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
        """Do the task by its methods, in a time (s) that may be shorter than that of the file.

        Raises
        ------
        InputError
            What only the methods can tell, such as a via point that cannot be held at rest.
        """
        settings = dict(self.settings)
        settings["time_limit"] = min(time_limit, settings.get("time_limit", np.inf))
        with naming(f"{self.origin}: "):
            return compare(
                self.robot,
                self.via_q,
                self.methods,
                self.limits,
                via_t=self.via_t,
                via_qd=self.via_qd,
                progress=progress,
                **settings,
            )


def read_task(path: str | Path) -> TaskFile:
    """Read a task from a TOML file.

    Parameters
    ----------
    path : str or Path
        Paths of robots inside the file are relative to its folder.

    Returns
    -------
    TaskFile

    Raises
    ------
    InputError
        A file that cannot be read, a key that is unknown, missing or of the wrong kind.

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
    return parse_task(text_of(path, "task file"), source.name, source.parent)


def parse_task(text: str, origin: str, folder: Path) -> TaskFile:
    """Task from the text of a file; ``origin`` names it, ``folder`` holds the robots it names."""
    data = parsed(text, origin)
    with naming(f"{origin}: "):
        return _task(data, origin, folder)


def _task(data: dict[str, Any], origin: str, folder: Path) -> TaskFile:
    check_keys(data, KEYS[""])
    check_schema(data, SCHEMA)
    robot = robot_from(data, folder)
    via = table_of(data, "via", KEYS["via"])
    limits = table_of(data, "limits", KEYS["limits"])
    settings = settings_from(table_of(data, "settings", KEYS["settings"]))
    if "via" not in data:
        raise InputError("table [via] is missing: it holds the via points, q or q_deg")
    via_q = _via_array(robot, via, "q")
    if via_q is None:
        raise InputError("via.q or via.q_deg is missing: one row of joint positions a via point")
    if len(via_q) < 2:
        raise InputError(f"via.q must have at least 2 rows, not {len(via_q)}")
    via_qd = _via_array(robot, via, "qd")
    via_t = None
    if "t" in via:
        via_t = checks.array("via.t", via["t"], (len(via_q),), "s")
        if via_t[0] != 0.0 or np.any(np.diff(via_t) <= 0):
            raise InputError(f"via.t must increase from 0 s, not {via['t']}")
    if via_qd is not None and via_qd.shape != via_q.shape:
        raise InputError(f"via.qd must have {len(via_q)} rows as via.q has, not {len(via_qd)}")
    methods = _names(data, "methods", METHODS)
    if via_qd is not None and via_t is None:
        raise InputError("via.qd needs via.t, the times at which the via velocities are meant, s")
    for name in methods or ():
        if METHODS[name].timed and via_t is None:
            raise InputError(f"methods has {name!r}, which needs via.t, the times to take, s")
    return TaskFile(
        origin=origin,
        robot=robot,
        via_q=via_q,
        via_t=via_t,
        via_qd=via_qd,
        limits=limits_from(robot, limits),
        methods=methods,
        settings=settings,
        outputs=_names(data, "outputs", OUTPUTS) or OUTPUTS,
    )


def robot_from(data: Mapping[str, Any], folder: Path) -> Robot:
    """The robot that a file names."""
    source, tip = data.get("robot"), data.get("tip")
    if not isinstance(source, str):
        found = f"not {source!r}" if "robot" in data else "but it is missing"
        raise InputError(
            f"robot must be one of {', '.join(packaged_robots())}, or the path of a .toml or .urdf "
            f"file, {found}"
        )
    if tip is not None and not isinstance(tip, str):
        raise InputError(f"tip must be the name of a link, not {tip!r}")
    return load_robot(source if source in packaged_robots() else str(folder / source), tip)


def _via_array(robot: Robot, via: Mapping[str, Any], key: str) -> FloatArray | None:
    """Rows [m,n] of ``key`` or ``key_deg`` in SI units; None where neither is given."""
    in_degrees = f"{key}_deg"
    if key in via and in_degrees in via:
        raise InputError(f"via gives both {key} and {in_degrees}: give one of them")
    name = in_degrees if in_degrees in via else key
    if name not in via:
        return None
    rows = via[name]
    if not isinstance(rows, list) or not all(isinstance(row, list) for row in rows) or not rows:
        raise InputError(f"via.{name} must be a list of rows, one a via point, not {rows!r}")
    for index, row in enumerate(rows):
        if len(row) != robot.joint_count:
            raise InputError(
                f"via.{name} must have {robot.joint_count} numbers in every row "
                f"({', '.join(robot.joint_names)}), but row {index + 1} is {row}"
            )
    values = checks.array(f"via.{name}", rows, (None, robot.joint_count))
    return values * joint_scale(robot) if name == in_degrees else values


def limits_from(robot: Robot, table: Mapping[str, Any]) -> JointLimits:
    """The limits of the robot with the changes of a table."""
    changes: dict[str, Any] = {}
    further = {name: value for name, value in table.items() if name in MEMBER_KEYS}
    if further:
        changes["also"] = with_further(robot.limits.also, further)
    for name, value in table.items():
        if name in further:
            continue
        key = name.removesuffix("_deg")
        if key in changes:
            raise InputError(f"limits gives both {key} and {key}_deg: give one of them")
        values = per_joint(robot, f"limits.{name}", value)
        changes[key] = values * joint_scale(robot) if name != key else values
    with naming("limits."):
        return robot.with_limits(**changes).limits


def settings_from(table: Mapping[str, Any]) -> dict[str, Any]:
    """Checked settings of a table."""
    for key, value in table.items():
        with naming("settings."):
            if key == "blend":
                checks.number("blend", value, "of a segment", above=0.0, at_most=0.5)
            elif key == "compiled" and not isinstance(value, bool):
                raise InputError(f"compiled must be true or false, not {value!r}")
            else:
                _SETTINGS[key](**{key: value})
    return dict(table)


def _names(
    data: Mapping[str, Any], key: str, allowed: Mapping[str, Any] | Sequence[str]
) -> tuple[str, ...] | None:
    if key not in data:
        return None
    value = data[key]
    choices = ", ".join(allowed)
    if not isinstance(value, list) or not all(isinstance(name, str) for name in value):
        raise InputError(f"{key} must be a list of names out of {choices}, not {value!r}")
    for name in value:
        if name not in allowed:
            raise InputError(f"{key} has the unknown {name!r}{suggestion(name, allowed)}")
    if not value or len(set(value)) != len(value):
        raise InputError(f"{key} must be different names out of {choices}, not {value}")
    return tuple(value)
