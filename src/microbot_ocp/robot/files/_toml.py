"""TOML files of robots, with one ``[[joint]]`` for each row of the DH table.

The key ``convention``, "modified" or "standard", is that of :meth:`~microbot_ocp.Robot.from_dh`.
Angles are in radians, or in degrees under a key with the ending ``_deg``. Keys of a joint:
``name``, ``type``, ``alpha``, ``a``, ``d``, ``theta_offset``, ``beta``; ``mass``,
``center_of_mass``, ``inertia``, ``armature``, ``viscous_friction``, ``coulomb_friction``,
``allow_unphysical``; a table ``rotor`` with ``inertia``, ``gear_ratio``, ``axis``, ``carrier``; a
table ``mimic`` with ``joint``, ``factor``, ``offset`` for a joint that follows another; ``q_min``,
``q_max``, ``qd_max``, ``qdd_max``, ``qddd_max``, ``tau_max``, ``taud_max``. All but the first two
bounds may be ``[lower, upper]``. The table ``[limits]`` holds further limits, such as
``tool_speed_max``. The tables ``[tool]`` and ``[base]`` hold a DH row or a ``matrix``; each
``[[shape]]`` holds the fields of a :class:`~microbot_ocp.robot.Shape`; ``disabled_pairs`` and
``[named_poses]`` are data of an SRDF file; the program ignores ``[sources]``.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import InputError, naming, shown
from microbot_ocp._base.schema import (
    ANGLE,
    ANY,
    NEEDED,
    TABLE,
    TABLES,
    TEXT,
    Key,
    keys_of,
    parsed,
    read_table,
)
from microbot_ocp._base.toml_text import toml_value
from microbot_ocp.limits import JOINT_QUANTITIES, Limit, Limits
from microbot_ocp.robot._links import Link, Rotor
from microbot_ocp.robot._model import GRAVITY, Robot
from microbot_ocp.robot._shapes import Shape
from microbot_ocp.robot._transforms import dh_transform

GEOMETRY = ("alpha", "a", "d", "theta_offset")
LINK = (
    "mass",
    "center_of_mass",
    "inertia",
    "allow_unphysical",
    "armature",
    "viscous_friction",
    "coulomb_friction",
    "rotor",
)
BOUNDS = ("q_min", *(f"{key}_max" for key in JOINT_QUANTITIES))
ROBOT = {
    "name": TEXT,
    "description": TEXT,
    "convention": ANY,
    "gravity": ANY,
    "sources": ANY,
    "joint": ANY,
    "limits": TABLE,
    "tool": TABLE,
    "base": TABLE,
    "shape": TABLES,
    "disabled_pairs": ANY,
    "named_poses": TABLE,
}
JOINT = {
    "name": TEXT,
    "type": Key(choices=("revolute", "prismatic")),
    "alpha": Key(needed=True, degrees=True),
    **dict.fromkeys(("a", "d"), NEEDED),
    **dict.fromkeys(("theta_offset", "beta"), ANGLE),
    **dict.fromkeys(LINK, ANY),
    "rotor": TABLE,
    "mimic": TABLE,
    **{key: Key(degrees=not key.startswith("tau")) for key in BOUNDS},
}
MIMIC = {"joint": Key(needed=True), "factor": ANY, "offset": ANGLE}
PLACEMENT = {"matrix": ANY, "alpha": ANGLE, "a": ANY, "d": ANY, "theta": ANGLE}
ROTOR = keys_of(Rotor)
SHAPE = keys_of(Shape)


def parse_robot(text: str, origin: str = "robot") -> Robot:
    """Return the robot from the text of a TOML file; ``origin`` names the file in messages."""
    with naming(f"{origin}: "):
        return _robot(read_table(parsed(text), ROBOT), Path(origin).stem)


def _robot(data: dict[str, Any], name: str) -> Robot:
    joints = data.get("joint")
    if not isinstance(joints, list) or not joints or not all(isinstance(j, dict) for j in joints):
        raise InputError("there must be at least one [[joint]] table")
    rows = [_row(joint, i) for i, joint in enumerate(joints)]
    links = [_link(row) for row in rows]
    if None in links and any(links):
        missing = rows[links.index(None)]["name"]
        raise InputError(f"mass of joint {missing!r} is missing: give all or none")
    robot = Robot.from_dh(
        *([row[key] for row in rows] for key in GEOMETRY),
        joint_type=[row["type"] for row in rows],
        links=[link for link in links if link is not None],
        limits=_limits(rows, _further(data.get("limits", {}))),
        gravity=data.get("gravity", GRAVITY),
        tool=_placement("tool", data.get("tool")),
        base=_placement("base", data.get("base")),
        name=data.get("name", name),
        joint_names=[row["name"] for row in rows],
        description=data.get("description", ""),
        beta=[row["beta"] for row in rows],
        shapes=[Shape(**read_table(table, SHAPE, "of a shape")) for table in data.get("shape", [])],
        convention=data.get("convention"),
        mimic={row["name"]: _mimic(row) for row in rows if "mimic" in row},
    )
    pairs = _pairs(data["disabled_pairs"]) if "disabled_pairs" in data else None
    shape, named = (robot.joint_count,), data.get("named_poses", {}).items()
    poses = {key: checks.array(f"pose {key!r}", q, shape, "rad") for key, q in named}
    return replace(robot, disabled_pairs=pairs, named_poses=poses)


def _mimic(row: dict[str, Any]) -> tuple[str, float, float]:
    """Return the joint that a joint follows, the factor and the offset."""
    where = f"of mimic of joint {row['name']!r}"
    in_radians = partial(_in_radians, prismatic=row["type"] == "prismatic")
    table: dict[str, Any] = {"factor": 1.0, "offset": 0.0}
    table |= read_table(row["mimic"], MIMIC, where, convert=in_radians)
    if torques := [key for key in ("tau_max", "taud_max") if key in row]:
        raise InputError(
            f"{torques[0]} of joint {row['name']!r} has no meaning: the drive of "
            f"{table['joint']!r} moves it"
        )
    return table["joint"], table["factor"], table["offset"]


def _pairs(pairs: Any) -> tuple[tuple[str, str], ...]:
    """Return pairs of names of links, as an SRDF file disables them."""
    for pair in pairs if isinstance(pairs, list) else [pairs]:
        if not isinstance(pair, list) or [*map(type, pair)] != [str, str]:
            raise InputError(f"disabled_pairs must be pairs of names of links, not {shown(pair)}")
    return tuple((first, second) for first, second in pairs)


def _in_radians(key: str, name: str, value: Any, in_degrees: bool, prismatic: bool = False) -> Any:
    if not in_degrees:
        return value
    if key in (*BOUNDS, "offset") and prismatic:
        raise InputError(f"{name} cannot be in degrees: the joint is prismatic")
    if key in BOUNDS and isinstance(value, list):
        return np.radians(checks.array(name, value, (2,), "deg")).tolist()
    return float(np.radians(_number_or_inf(name, value, "deg")))


def _number_or_inf(name: str, value: Any, unit: str = "") -> float:
    """Return a number that may be infinite, which TOML writes as inf."""
    return value if value in (math.inf, -math.inf) else checks.number(name, value, unit)


def _row(table: dict[str, Any], index: int) -> dict[str, Any]:
    where = f"of joint {table.get('name', index + 1)!r}"
    in_radians = partial(_in_radians, prismatic=table.get("type") == "prismatic")
    row = {"name": f"joint {index + 1}", "type": "revolute", "theta_offset": 0.0, "beta": 0.0}
    row |= read_table(table, JOINT, where, convert=in_radians)
    return row | {key: checks.number(f"{key} {where}", row[key]) for key in (*GEOMETRY, "beta")}


def _link(row: dict[str, Any]) -> Link | None:
    given = {key: row[key] for key in LINK if key in row}
    if not given:
        return None
    if "mass" not in given:
        raise InputError(
            f"mass of joint {row['name']!r} is missing, but {', '.join(given)} is given"
        )
    given.setdefault("center_of_mass", (0.0, 0.0, 0.0))
    if "rotor" in given:
        where = f"of rotor of joint {row['name']!r}"
        given["rotor"] = Rotor(**read_table(given["rotor"], ROTOR, where))
    return Link(**given, name=row["name"])


def _limits(rows: list[dict[str, Any]], also: tuple[Limit, ...]) -> Limits:
    columns: dict[str, Any] = {}
    for key in BOUNDS:
        values = [row.get(key, -math.inf if key == "q_min" else math.inf) for row in rows]
        for row, value in zip(rows, values, strict=True):
            name = f"{key} of joint {row['name']!r}"
            if isinstance(value, list) and not key.startswith("q_"):
                checks.array(f"{name} as [lower, upper]", value, (2,), finite=False)
            else:
                _number_or_inf(name, value)
        columns[key] = values
        if any(isinstance(value, list) for value in values):
            pairs = [value if isinstance(value, list) else [-value, value] for value in values]
            columns[key] = tuple(map(list, zip(*pairs, strict=True)))
    return Limits(**columns, also=also)


def _further(table: dict[str, Any]) -> tuple[Limit, ...]:
    if not table:
        return ()
    from microbot_ocp.limits import MEMBER_KEYS, limits_from_table  # imports CasADi

    return limits_from_table(read_table(table, dict.fromkeys(MEMBER_KEYS, ANY), "in [limits]"))


def _placement(name: str, table: Any) -> Any:
    """Return a constant transform [4,4] from its table: a matrix, or a DH row."""
    if table is None:
        return None
    where = f"of {name}"
    row = read_table(table, PLACEMENT, where, convert=_in_radians)
    if "matrix" in row:
        if len(row) > 1:
            raise InputError(f"{name} must be a matrix or a DH row, not both")
        return checks.array(name, row["matrix"], (4, 4))
    keys = ("alpha", "a", "d", "theta")
    return dh_transform(*(checks.number(f"{key} {where}", row.get(key, 0.0)) for key in keys))


def robot_to_toml(robot: Robot) -> str:
    """Return the text of the TOML file of a robot, angles in radians.

    Every number has the fewest digits from which reading restores it. Data that a robot does not
    hold, such as the sources of a packaged file, are lost.
    """
    lines = [f"name = {toml_value(robot.name)}"]
    if robot.description:
        lines.append(f"description = {toml_value(robot.description)}")
    lines += ['convention = "modified"', f"gravity = {toml_value(robot.gravity.tolist())}"]
    if robot.disabled_pairs is not None:
        rows = (f"  {toml_value([*pair])}," for pair in robot.disabled_pairs)
        lines += ["disabled_pairs = [", *rows, "]"]
    chain = robot.chain
    for joint, name in enumerate(chain.joint_names):
        lines += ["", "[[joint]]", f"name = {toml_value(name)}"]
        lines.append(f"type = {toml_value(chain.joint_types[joint])}")
        if name in robot.mimic:
            followed = dict(zip(MIMIC, robot.mimic[name], strict=True))
            lines.append(f"mimic = {toml_value(followed)}")
        lines += [f"{key} = {float(getattr(robot, key)[joint])!r}" for key in GEOMETRY]
        if robot.beta[joint]:
            lines.append(f"beta = {float(robot.beta[joint])!r}")
        if robot.has_dynamics:
            lines += _lines(robot.links[joint], *LINK)
        for key in () if name in robot.mimic else BOUNDS:
            lines += _bound_line(chain, key, joint)
    if robot.limits.also:
        from microbot_ocp.limits import limits_to_table

        further = limits_to_table(robot.limits.also).items()
        lines += ["", "[limits]", *(f"{key} = {toml_value(value)}" for key, value in further)]
    for name, matrix in (("tool", robot.tool), ("base", robot.base)):
        if not np.array_equal(matrix, np.eye(4)) or np.signbit(matrix).any():
            lines += ["", f"[{name}]", f"matrix = {toml_value(matrix.tolist())}"]
    if robot.named_poses:
        poses = robot.named_poses.items()
        rows = (f"{toml_value(name)} = {toml_value(q.tolist())}" for name, q in poses)
        lines += ["", "[named_poses]", *rows]
    for shape in robot.shapes:
        lines += ["", "[[shape]]", *_lines(shape, *SHAPE)]
    return "\n".join(lines) + "\n"


def _lines(item: Any, *keys: str) -> list[str]:
    """Return lines for the attributes of an object that are not empty."""
    given = ((key, getattr(item, key)) for key in keys)
    return [f"{key} = {_value(value)}" for key, value in given if not _is_empty(value)]


def _is_empty(value: Any) -> bool:
    return value is None or value is False or (isinstance(value, str) and not value)


def _value(value: Any) -> str:
    if isinstance(value, Rotor):
        return f"{{ {', '.join(_lines(value, *ROTOR))} }}"
    if isinstance(value, np.ndarray | tuple):
        return toml_value(np.asarray(value).tolist())
    return toml_value(value)


def _bound_line(robot: Robot, key: str, joint: int) -> list[str]:
    quantity = key.split("_")[0]
    if quantity == "q":
        value = float(getattr(robot.limits, key)[joint])
        return [f"{key} = {value!r}"] if math.isfinite(value) else []
    lower, upper = (float(bound[joint]) for bound in robot.limits.bounds(quantity))
    if (lower, upper) == (-math.inf, math.inf):
        return []
    same = lower == -upper and math.copysign(1.0, lower) == math.copysign(1.0, -upper)
    return [f"{key} = {toml_value(upper if same else [lower, upper])}"]
