"""Studies in TOML files; the schema is in docs/how-to/sweeps.md.

Whatever is wrong in a file is one sentence that names the file, the key and what is allowed.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from microbot_ocp._base.checks import InputError, naming, shown
from microbot_ocp._base.schema import (
    ANY,
    FLAG,
    NEEDED,
    TABLE,
    Key,
    check_schema,
    keys_of,
    read_kind,
    read_table,
    table_from,
)
from microbot_ocp.sweeps._cases import Between, Cases, OneOf
from microbot_ocp.sweeps._quantities import check_name
from microbot_ocp.sweeps._study import CaseSettings, Study
from microbot_ocp.tasks import COMMON, robot_from

SCHEMA = 1
STUDY = {
    **COMMON,
    "methods": ANY,
    "time_limit": ANY,
    "motions": FLAG,
    "cases": Key(dict, needed=True),
    "quantities": TABLE,
    "settings": TABLE,
}
CASES = {
    "random": {"count": NEEDED, "seed": ANY},
    "grid": {},
    "table": {"file": Key(str, needed=True)},
}
RANGE = {"from": NEEDED, "to": NEEDED, "steps": ANY}


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
    with table_from(source, "study") as data:
        return _study(data, str(source), source.parent)


def _study(data: dict[str, Any], origin: str, folder: Path) -> Study:
    given = read_table(data, STUDY)
    check_schema(data, SCHEMA)
    methods = given.get("methods", [])
    if not isinstance(methods, list) or not all(isinstance(name, str) for name in methods):
        raise InputError(f"methods must be a list of names, not {shown(methods)}")
    named = given.get("quantities", {})
    quantities = {name: _quantity(name, value) for name, value in named.items()}
    cases = _cases(given["cases"], quantities, folder)
    robot = robot_from(data, folder)
    cases.of(robot)
    settings = read_table(given.get("settings", {}), keys_of(CaseSettings), "in table [settings]")
    more = {key: given[key] for key in ("methods", "motions", "time_limit") if key in given}
    return Study(robot, cases, settings=settings, origin=origin, **more)


def _cases(table: Mapping[str, Any], quantities: dict[str, Any], folder: Path) -> Cases:
    kind, given = read_kind(table, CASES, "in table [cases]", "cases.{}")
    if kind == "table":
        return Cases.table(folder / given["file"], **quantities)
    with naming("cases."):
        return getattr(Cases, kind)(**given, **quantities)


def _quantity(name: str, given: Any) -> Any:
    """Return a constant, a range ``{from, to, steps}`` or values ``{one_of}``."""
    check_name(name)
    if not isinstance(given, dict):
        return given
    if set(given) == {"one_of"}:
        return OneOf(given["one_of"])
    where = f"quantities.{name}"
    ends = read_table(given, RANGE, f"of {where}, which is a range or has one_of", f"{where}.{{}}")
    return Between(ends["from"], ends["to"], ends.get("steps"))
