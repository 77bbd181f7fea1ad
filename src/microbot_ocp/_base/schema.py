"""TOML files with declared keys: an error is one sentence that lists the allowed keys or values.

:func:`read_table` is the entry. Robots, tasks, cells, studies and scenes declare a schema for each
of their tables.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any

from microbot_ocp._base import checks
from microbot_ocp._base.checks import InputError, shown
from microbot_ocp._base.reading import DEEPEST, text_of

# Longest TOML text, read in seconds; a robot file has a few thousand characters.
MOST_CHARACTERS = 5_000_000
_PART = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
# The time of tomllib grows with the square of the number of parts of a key.
_DEEP_KEY = re.compile(rf"""(?<![\w."'-]){_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{DEEPEST},}}""")


def parsed(text: str) -> dict[str, Any]:
    """Return the tables of a TOML text.

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
    # A ValueError about an integer of 5,000 digits; a RecursionError about nesting.
    except (ValueError, RecursionError) as problem:
        raise InputError(f"it is not valid TOML: {problem}") from None


OF_KIND = {  # kind of a file and its commands, by a key that only this kind has
    "cases": "a study: microbot-ocp sweep FILE",
    "quantities": "a study: microbot-ocp sweep FILE",
    "stop": "a task of stops: microbot-ocp solve FILE, or --task FILE of export and check",
    "via": "a task of via points: microbot-ocp solve FILE",
    "joint": 'a robot: microbot-ocp show FILE, and robot = "FILE" in a task or study',
    "obstacle": 'a scene: scene = "FILE" in a task, or --scene FILE of check',
    "interpolation": "the profile of a controller: --profile FILE of check, compare and export",
}
ENDINGS = {
    ".npz": "a saved motion or solution: microbot-ocp check, export or replay FILE",
    ".csv": "a trajectory: microbot-ocp check FILE",
    ".json": "a trajectory or a result: microbot-ocp check FILE",
    ".rrd": "a recording: microbot-ocp replay FILE --open",
    ".urdf": 'a robot: microbot-ocp show FILE, and robot = "FILE" in a task or study',
    ".xacro": 'a robot: microbot-ocp show FILE, and robot = "FILE" in a task or study',
}


def refuse_toml(path: str | Path, wanted: str) -> None:
    """Raise InputError for a TOML file in the place of ``wanted``; the message has its kind."""
    if Path(path).suffix.lower() == ".toml":
        with table_from(path, "TOML") as table:
            kind = next((OF_KIND[key] for key in OF_KIND if key in table), "a table of TOML")
        raise InputError(f"{Path(path).name} is no {wanted}, but {kind}")


@contextmanager
def table_from(path: str | Path, kind: str) -> Iterator[dict[str, Any]]:
    """Yield the content of a file of this kind; errors inside of the context name the file.

    Raises
    ------
    InputError
    """
    if (ending := Path(path).suffix.lower()) in ENDINGS:
        raise InputError(f"{Path(path).name} is no {kind} file, but {ENDINGS[ending]}")
    text = text_of(path, f"{kind} file")
    with checks.naming(f"{Path(path).name or path}: "):
        yield parsed(text)


def check_schema(data: Mapping[str, Any], schema: int) -> None:
    """Raise InputError if a file has another version of the format."""
    if type(data.get("schema")) is not int or data["schema"] != schema:
        missing = f"but it is missing: write schema = {schema} in the first line"
        instead = f"not {data['schema']!r}" if "schema" in data else missing
        raise InputError(f"schema must be {schema}, {instead}")


@dataclass(frozen=True)
class Key:
    """Rule for one key of a table; the receiver of its value checks ranges and shapes.

    Attributes
    ----------
    type : type or None
        Type bool, str, dict (a table) or list (tables, ``[[key]]``); None allows all.
    needed : bool
        True for a mandatory key.
    degrees : bool
        True if ``key_deg`` is an alternative to the key.
    choices : collection of str
        Allowed words.
    several : bool
        True if the value is a list of different words of ``choices``.
    """

    type: type | None = None
    needed: bool = False
    degrees: bool = False
    choices: Collection[str] = ()
    several: bool = False

    def check(self, name: str, value: Any) -> None:
        """Raise InputError if a value does not obey the rule."""
        if self.several:
            _check_names(name, value, self.choices)
        elif self.choices:
            checks.one_of(name, value, self.choices)
        elif self.type is list:
            if not isinstance(value, list) or not all(isinstance(row, Mapping) for row in value):
                key = name.split()[0]
                raise InputError(f"{name} must be [[{key}]] tables, not {shown(value)}")
        elif self.type is not None and not isinstance(value, TYPES[self.type][0]):
            raise InputError(f"{name} must be {TYPES[self.type][1]}, not {shown(value)}")


TYPES: dict[type, tuple[type, str]] = {
    bool: (bool, "true or false"),
    str: (str, "text"),
    dict: (Mapping, "a table"),
}
ANY, TEXT, FLAG, TABLE, TABLES = Key(), Key(str), Key(bool), Key(dict), Key(list)
NEEDED = Key(needed=True)
ANGLE = Key(degrees=True)
Schema = Mapping[str, Key]
Convert = Callable[[str, str, Any, bool], Any]


def keys_of(kind: Any, /, **others: Key) -> dict[str, Key]:
    """Return rules for the fields of a dataclass; ``others`` replace some of them."""
    return {
        f.name: Key(needed=f.default is MISSING and f.default_factory is MISSING)
        for f in fields(kind)
    } | others


def names_of(schema: Schema) -> tuple[str, ...]:
    """Return all keys as files may write them, including those in degrees."""
    return tuple(
        name
        for key, entry in schema.items()
        for name in ((key, f"{key}_deg") if entry.degrees else (key,))
    )


def read_table(
    table: Mapping[str, Any],
    schema: Schema,
    where: str = "at the top level",
    named: str = "",
    convert: Convert | None = None,
    elsewhere: Mapping[str, str] | None = None,
) -> dict[str, Any]:
    """Return the values of a table by the keys of its schema, without ``_deg``.

    Parameters
    ----------
    table, schema
    where : str
        Place of the table, for messages: "in stop 'pick'".
    named : str
        Text for a key in messages, in which {} becomes the key; default "{}" and ``where``.
    convert : callable
        Function of a key, its name in messages, the value in the file, and True if that is in
        degrees; returns the value.
    elsewhere : mapping
        Keys that belong to another kind of file, each with the end of its message.

    Raises
    ------
    InputError
        An unknown key, with a suggestion; a key given twice, missing or of a wrong type.
    """
    named = named or ("{}" if where == "at the top level" else f"{{}} {where}")
    allowed = names_of(schema)
    read: dict[str, Any] = {}
    for written, value in table.items():
        if written not in allowed:
            if elsewhere and written in elsewhere:
                raise InputError(f"key {written!r} {where} {elsewhere[written]}")
            of_another = next((key for key in OF_KIND if key in table), written)
            if where == "at the top level" and of_another not in allowed and of_another in OF_KIND:
                raise InputError(f"it is {OF_KIND[of_another]}")
            raise InputError(f"unknown key {written!r} {where}{suggestion(written, allowed)}")
        key = written if written in schema else written.removesuffix("_deg")
        name = named.replace("{}", written)
        if key in read:
            name = named.replace("{}", key)
            raise InputError(f"{name} is given twice: give {key} or {key}_deg, not both")
        schema[key].check(name, value)
        read[key] = value if convert is None else convert(key, name, value, key != written)
    for key, entry in schema.items():
        if entry.needed and key not in read:
            choices = f": it must be one of {', '.join(entry.choices)}" if entry.choices else ""
            raise InputError(f"{named.replace('{}', key)} is missing{choices}")
    return read


def read_kind(
    table: Mapping[str, Any], kinds: Mapping[str, Schema], where: str, named: str = ""
) -> tuple[str, dict[str, Any]]:
    """Return the ``kind`` of a table and the values under the keys of that kind.

    ``kinds`` has a schema for every kind; see :func:`read_table` for parameters and errors.
    """
    kind = table.get("kind")
    Key(choices=kinds).check((named or f"{{}} {where}").replace("{}", "kind"), kind)
    rest = {key: value for key, value in table.items() if key != "kind"}
    of_others = {key for keys in kinds.values() for key in keys}
    elsewhere = dict.fromkeys(of_others, f"is not for the kind {kind!r}")
    return str(kind), read_table(rest, kinds[str(kind)], where, named, elsewhere=elsewhere)


def _check_names(name: str, value: Any, allowed: Collection[str]) -> None:
    choices = ", ".join(allowed)
    if not isinstance(value, list) or not all(isinstance(entry, str) for entry in value):
        raise InputError(f"{name} must be a list of names out of {choices}, not {shown(value)}")
    for entry in value:
        if entry not in allowed:
            raise InputError(f"{name} has the unknown {entry!r}{suggestion(entry, allowed)}")
    if not value or len(set(value)) != len(value):
        raise InputError(f"{name} must be different names out of {choices}, not {shown(value)}")


def suggestion(word: str, allowed: Iterable[str]) -> str:
    """Return the most similar allowed word, and all of them."""
    names = list(allowed)
    return f"{checks.did_you_mean(word, names) or ';'} allowed: {', '.join(names)}"
