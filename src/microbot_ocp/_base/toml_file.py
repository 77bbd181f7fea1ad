"""TOML files of known keys: a fault is one sentence with the key and what is allowed."""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from microbot_ocp._base.checks import InputError, shown
from microbot_ocp._base.reading import DEEPEST, text_of

MOST_CHARACTERS = 5_000_000  # of TOML, which are read in seconds; a robot file has a few thousand
_PART = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
# tomllib takes as long as the square of the parts of a key
_DEEP_KEY = re.compile(rf"""(?<![\w."'-]){_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{DEEPEST},}}""")


def parsed(text: str, origin: str) -> dict[str, Any]:
    """What a text holds; ``origin`` names its file.

    Raises
    ------
    InputError
    """
    try:
        if len(text) > MOST_CHARACTERS:
            raise ValueError(f"it has more than {MOST_CHARACTERS:,} characters")
        if _DEEP_KEY.search(text):
            raise ValueError(f"tables are nested deeper than {DEEPEST}")
        return tomllib.loads(text)
    except (ValueError, RecursionError) as problem:  # an integer of 5,000 digits; nesting
        raise InputError(f"{origin} is not valid TOML: {problem}") from None


def table_from(path: str | Path, kind: str) -> dict[str, Any]:
    """What a file of this kind holds.

    Raises
    ------
    InputError
    """
    return parsed(text_of(path, f"{kind} file"), Path(path).name)


def check_schema(data: Mapping[str, Any], schema: int) -> None:
    """Raise InputError where a file is of another version of the format."""
    if type(data.get("schema")) is not int or data["schema"] != schema:
        found = f"not {data['schema']!r}" if "schema" in data else "but it is missing"
        raise InputError(f"schema must be {schema}, {found}")


def check_keys(
    table: Mapping[str, Any], allowed: Sequence[str], where: str = "at the top level"
) -> None:
    """Raise InputError, with a suggestion, where a table has an unknown key."""
    for key in table:
        if key not in allowed:
            raise InputError(f"unknown key {key!r} {where}{suggestion(key, allowed)}")


def table_of(data: Mapping[str, Any], name: str, allowed: Sequence[str]) -> dict[str, Any]:
    """A checked table; empty where it is not given.

    Raises
    ------
    InputError
    """
    table = data.get(name, {})
    if not isinstance(table, dict):
        raise InputError(f"{name} must be a table, [{name}], not {shown(table)}")
    check_keys(table, allowed, f"in table [{name}]")
    return table


def suggestion(word: str, allowed: Iterable[str]) -> str:
    """The nearest of the allowed words, and all of them."""
    names = list(allowed)
    close = difflib.get_close_matches(word, names, n=1, cutoff=0.6)
    asked = f"; did you mean {close[0]!r}?" if close else ";"
    return f"{asked} allowed: {', '.join(names)}"
