"""Studies in TOML files; the schema is in docs/how-to/sweeps.md.

Whatever is wrong in a file is one sentence that names the file, the key and what is allowed.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from microbot_ocp._base.checks import InputError, naming, shown
from microbot_ocp._base.reading import text_of
from microbot_ocp._base.toml_file import (
    check_keys,
    check_schema,
    parsed,
    suggestion,
    table_of,
)
from microbot_ocp.robot import Robot
from microbot_ocp.robot.files import load_robot, packaged_robots
from microbot_ocp.sweeps._cases import Between, Cases, OneOf
from microbot_ocp.sweeps._quantities import check_name
from microbot_ocp.sweeps._study import SETTINGS, Study

SCHEMA = 1
KINDS = ("random", "grid", "table")
KEYS = {
    "": ("schema", "robot", "tip", "methods", "time_limit", "motions", "cases", "quantities",
         "settings"),
    "cases": ("kind", "count", "seed", "file"),
    "settings": tuple(SETTINGS),
}  # fmt: skip
RANGE = ("from", "to", "steps")


def read_study(path: str | Path) -> Study:
    """Read a study from a TOML file.

    Parameters
    ----------
    path : str or Path
        Robots and tables that it names are relative to its folder.

    Returns
    -------
    Study

    Raises
    ------
    InputError
        A file that cannot be read, a key that is unknown, missing or of the wrong kind.
    """
    source = Path(path)
    return parse_study(text_of(path, "study file"), str(source), source.parent)


def parse_study(text: str, origin: str, folder: Path) -> Study:
    """Study from the text of a file; ``origin`` names it, ``folder`` holds what it names.

    Raises
    ------
    InputError
        As :func:`read_study`.
    """
    name = Path(origin).name
    data = parsed(text, name)
    with naming(f"{name}: "):
        return _study(data, origin, folder)


def _study(data: dict[str, Any], origin: str, folder: Path) -> Study:
    check_keys(data, KEYS[""])
    check_schema(data, SCHEMA)
    more: dict[str, Any] = {}
    if "methods" in data:
        methods = data["methods"]
        if not isinstance(methods, list) or not all(isinstance(name, str) for name in methods):
            raise InputError(f"methods must be a list of names, not {shown(methods)}")
        more["methods"] = methods
    if "motions" in data:
        if not isinstance(data["motions"], bool):
            raise InputError(f"motions must be true or false, not {shown(data['motions'])}")
        more["motions"] = data["motions"]
    if "time_limit" in data:
        more["time_limit"] = data["time_limit"]
    cases = _cases(table_of(data, "cases", KEYS["cases"]), _quantities(data), folder)
    robot = _robot(data, folder)
    cases.of(robot)
    settings = table_of(data, "settings", KEYS["settings"])
    return Study(robot, cases, settings=settings, origin=origin, **more)


def _cases(table: Mapping[str, Any], quantities: dict[str, Any], folder: Path) -> Cases:
    kind = table.get("kind")
    if kind not in KINDS:
        raise InputError(f"cases.kind must be one of {', '.join(KINDS)}, not {shown(kind)}")
    own = {"random": ("count", "seed"), "grid": (), "table": ("file",)}[kind]
    for key in table:
        if key not in ("kind", *own):
            raise InputError(f"cases.{key} is not for cases of the kind {kind!r}")
    if kind == "grid":
        return Cases.grid(**quantities)
    if kind == "table":
        if not isinstance(table.get("file"), str):
            raise InputError("cases.file must be the path of a .csv or .parquet file")
        return Cases.table(folder / table["file"], **quantities)
    if "count" not in table:
        raise InputError("cases.count is missing: how many random draws")
    with naming("cases."):
        return Cases.random(table["count"], seed=table.get("seed", 0), **quantities)


def _quantities(data: Mapping[str, Any]) -> dict[str, Any]:
    table = data.get("quantities", {})
    if not isinstance(table, dict):
        raise InputError(f"quantities must be a table, [quantities], not {shown(table)}")
    return {name: _quantity(name, given) for name, given in table.items()}


def _quantity(name: str, given: Any) -> Any:
    """A constant, a range ``{from, to, steps}`` or values ``{one_of}``."""
    check_name(name)
    if not isinstance(given, dict):
        return given
    if set(given) == {"one_of"}:
        return OneOf(given["one_of"])
    for key in given:
        if key not in RANGE:
            close = suggestion(key, (*RANGE, "one_of"))
            raise InputError(f"quantities.{name} has the unknown key {key!r}{close}")
    if not {"from", "to"} <= set(given):
        raise InputError(f"quantities.{name} must have from and to, or one_of, not {shown(given)}")
    return Between(given["from"], given["to"], given.get("steps"))


def _robot(data: Mapping[str, Any], folder: Path) -> Robot:
    source, tip = data.get("robot"), data.get("tip")
    if not isinstance(source, str) or not (tip is None or isinstance(tip, str)):
        raise InputError(
            f"robot must be one of {', '.join(packaged_robots())}, or the path of a .toml or .urdf "
            f"file, not {shown(source)}; tip, if given, the name of a link"
        )
    return load_robot(source if source in packaged_robots() else str(folder / source), tip)
