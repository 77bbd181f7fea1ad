"""Robots from TOML files: one ``[[joint]]`` a row of the modified-DH table.

Angles are in radians, or in degrees where the key ends in ``_deg``. Keys of a joint: ``name``,
``type``, ``alpha``, ``a``, ``d``, ``theta_offset``; ``mass``, ``center_of_mass``, ``inertia``,
``armature``, ``viscous_friction``, ``coulomb_friction``; ``q_min``, ``q_max``, ``qd_max``,
``qdd_max``, ``tau_max``, ``taud_max``. ``qd_max`` and the like may be ``[lower, upper]``.
"""

from __future__ import annotations

import math
import tomllib
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ocp import checks
from microbot_ocp.checks import InputError
from microbot_ocp.robot import Limits, Link, Robot, dh_transform

ANGLES = ("alpha", "theta_offset", "theta", "q_min", "q_max", "qd_max", "qdd_max")
GEOMETRY = ("alpha", "a", "d", "theta_offset")
INERTIAL = ("mass", "center_of_mass", "inertia", "armature")
FRICTION = ("viscous_friction", "coulomb_friction")
BOUNDS = ("q_min", "q_max", "qd_max", "qdd_max", "tau_max", "taud_max")
JOINT_KEYS = ("name", "type", *GEOMETRY, *INERTIAL, *FRICTION, *BOUNDS)
ROBOT_KEYS = ("name", "description", "gravity", "sources", "joint", "tool")


def packaged_robots() -> tuple[str, ...]:
    """Names of the robots that come with the package."""
    folder = resources.files("microbot_ocp.robots")
    return tuple(sorted(f.name[:-5] for f in folder.iterdir() if f.name.endswith(".toml")))


def load_robot(source: str | Path) -> Robot:
    """Load a packaged robot by name, or a robot file by path.

    Parameters
    ----------
    source : str or Path
        A name from :func:`packaged_robots`, or the path of a ``.toml`` file.

    Returns
    -------
    Robot

    Raises
    ------
    InputError
        Unknown name (lists what there is), missing file, malformed TOML, a key that is unknown,
        missing or of the wrong kind.

    Examples
    --------
    >>> load_robot("microbot").joint_names
    ('waist', 'shoulder', 'elbow')
    """
    name = str(source)
    if name in packaged_robots():
        text = (resources.files("microbot_ocp.robots") / f"{name}.toml").read_text("utf-8")
        return parse_robot(text, f"{name}.toml")
    path = Path(name)
    if path.suffix != ".toml":
        raise InputError(
            f"robot must be one of {', '.join(packaged_robots())}, or the path of a .toml file, "
            f"not {name!r}"
        )
    try:
        text = path.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as problem:
        raise InputError(f"robot file {name!r} cannot be read: {problem}") from None
    return parse_robot(text, path.name)


def parse_robot(text: str, origin: str = "robot") -> Robot:
    """Robot from the text of a TOML file; ``origin`` names it in error messages."""
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as problem:
        raise InputError(f"{origin} is not valid TOML: {problem}") from None
    for key in data:
        checks.one_of(f"key in {origin}", key, ROBOT_KEYS)
    joints = data.get("joint")
    if not isinstance(joints, list) or not joints or not all(isinstance(j, dict) for j in joints):
        raise InputError(f"{origin} must have at least one [[joint]] table")
    rows = [_row(joint, i, origin) for i, joint in enumerate(joints)]
    links = [_link(row, origin) for row in rows]
    if any(link is None for link in links) and any(link is not None for link in links):
        missing = next(row["name"] for row, link in zip(rows, links, strict=True) if link is None)
        raise InputError(f"mass of joint {missing!r} is missing in {origin}: give all or none")
    try:
        return Robot.from_dh(
            *([row[key] for row in rows] for key in GEOMETRY),
            joint_type=[row["type"] for row in rows],
            links=[link for link in links if link is not None],
            limits=_limits(rows),
            gravity=data.get("gravity", (0.0, 0.0, -9.81)),
            tool=_tool(data.get("tool"), origin),
            name=data.get("name", Path(origin).stem),
            joint_names=[row["name"] for row in rows],
            description=data.get("description", ""),
        )
    except InputError as problem:
        raise InputError(f"{origin}: {problem}") from None


def _in_radians(table: dict[str, Any], where: str, allowed: tuple[str, ...]) -> dict[str, Any]:
    """The table with every ``*_deg`` key turned into radians."""
    result: dict[str, Any] = {}
    for key, value in table.items():
        plain = key.removesuffix("_deg")
        if plain not in allowed or (plain != key and plain not in ANGLES):
            raise InputError(f"{where} has the unknown key {key!r}; allowed: {', '.join(allowed)}")
        if plain in result:
            raise InputError(f"{where} gives {plain!r} twice, in radians and in degrees")
        if plain != key:
            if plain in BOUNDS and table.get("type") == "prismatic":
                raise InputError(f"{key} of {where} cannot be in degrees: the joint is prismatic")
            if isinstance(value, list):
                value = np.radians(checks.array(f"{key} of {where}", value, (2,), "deg")).tolist()
            else:
                value = float(np.radians(_number_or_inf(f"{key} of {where}", value, "deg")))
        result[plain] = value
    return result


def _number_or_inf(name: str, value: Any, unit: str = "") -> float:
    """A number that may be infinite, which TOML writes as inf."""
    return value if value in (math.inf, -math.inf) else checks.number(name, value, unit)


def _row(table: dict[str, Any], index: int, origin: str) -> dict[str, Any]:
    label = f"joint {table.get('name', index + 1)!r} in {origin}"
    row = _in_radians(table, label, JOINT_KEYS)
    row.setdefault("name", f"joint {index + 1}")
    if not isinstance(row["name"], str):
        raise InputError(f"name of {label} must be text, not {row['name']!r}")
    row["type"] = checks.one_of(
        f"type of {label}", row.get("type", "revolute"), ("revolute", "prismatic")
    )
    row.setdefault("theta_offset", 0.0)
    for key in GEOMETRY:
        if key not in row:
            raise InputError(f"{key} of {label} is missing")
        row[key] = checks.number(f"{key} of {label}", row[key])
    return row


def _link(row: dict[str, Any], origin: str) -> Link | None:
    given = {key: row[key] for key in (*INERTIAL, *FRICTION) if key in row}
    if not given:
        return None
    if "mass" not in given:
        raise InputError(
            f"mass of joint {row['name']!r} is missing in {origin}, but {', '.join(given)} is given"
        )
    given.setdefault("center_of_mass", (0.0, 0.0, 0.0))
    try:
        return Link(**given, name=row["name"])
    except InputError as problem:
        raise InputError(f"{origin}: {problem}") from None


def _limits(rows: list[dict[str, Any]]) -> Limits:
    free = {"q_min": -math.inf}
    columns: dict[str, Any] = {}
    for key in BOUNDS:
        values = [row.get(key, free.get(key, math.inf)) for row in rows]
        for row, value in zip(rows, values, strict=True):
            name = f"{key} of joint {row['name']!r}"
            if not isinstance(value, list):
                _number_or_inf(name, value)
            elif key.startswith("q_m"):
                raise InputError(f"{name} must be a number, not {value}")
            else:
                checks.array(f"{name} as [lower, upper]", value, (2,), finite=False)
        if any(isinstance(value, list) for value in values):
            pairs = [value if isinstance(value, list) else [-value, value] for value in values]
            columns[key] = ([pair[0] for pair in pairs], [pair[1] for pair in pairs])
        else:
            columns[key] = values
    return Limits(**columns)


def _tool(table: Any, origin: str) -> Any:
    if table is None:
        return None
    if not isinstance(table, dict):
        raise InputError(f"tool in {origin} must be a table")
    if "matrix" in table:
        if len(table) > 1:
            raise InputError(f"tool in {origin} must be a matrix or a DH row, not both")
        return checks.array("tool", table["matrix"], (4, 4))
    row = _in_radians(table, f"tool in {origin}", ("alpha", "a", "d", "theta"))
    numbers = [
        checks.number(f"{key} of tool in {origin}", row.get(key, 0.0))
        for key in ("alpha", "a", "d", "theta")
    ]
    return dh_transform(*numbers)
