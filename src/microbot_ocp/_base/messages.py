"""Messages of ROS and MoveIt: each of their fields is kept, harmless, or refused where it speaks.

One table, ``messages.txt``, for requests, scenes and trajectories; :func:`check_message` asks it of
whatever is read, so that nothing is dropped in silence. ``docs/messages.md`` is made of it.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from importlib.resources import files
from typing import Any, NamedTuple

from microbot_ocp._base.checks import InputError, shown
from microbot_ocp._base.schema import suggestion

TABLE = files("microbot_ocp._base") / "messages.txt"
LINE = re.compile(r"(kept|harmless|refused) ([\w ]+?)(?: -> ([\w ]+))?(?: \((\d)\))?(?:: (.*))?")


class Field(NamedTuple):
    """Verdict on a field, why or how, the type of messages in it, and which value says nothing."""

    verdict: str
    why: str
    of: str
    neutral: int


def _fields(lines: Iterable[str]) -> Iterator[tuple[str, Field]]:
    for line in lines:
        verdict, names, of, neutral, why = LINE.fullmatch(line).groups("")  # type: ignore[union-attr]
        for name in names.split():
            yield name, Field(verdict, why.replace("{}", name), of, int(neutral or 0))


MESSAGES: dict[str, dict[str, Field]] = {
    kind: dict(_fields(lines))
    for kind, *lines in (part.split("\n") for part in TABLE.read_text().strip().split("\n\n")[1:])
}


def kind_of(document: Mapping[str, Any], kinds: Iterable[str]) -> str:
    """Return the type, out of some, that has most of the keys of a document and of its parts."""

    def fits(value: Any, of: str) -> bool:
        parts = [part for part in (value if isinstance(value, list) else [value]) if part]
        return not of or all(
            isinstance(part, Mapping) and MESSAGES[of].keys() & part.keys() for part in parts
        )

    def fitting(kind: str) -> int:
        fields = MESSAGES[kind]
        return sum(key in fields and fits(document[key], fields[key].of) for key in document)

    return max(kinds, key=fitting)


def check_message(document: Mapping[str, Any], kind: str, where: str = "") -> None:
    """Raise InputError for the first field that is unknown, or refused, by its path."""
    for key, value in document.items():
        path = f"{where}{key}"
        field = MESSAGES[kind].get(key)
        if field is None:
            name = kind.partition(" ")[0]
            raise InputError(f"{path} is no field of {name}{suggestion(str(key), MESSAGES[kind])}")
        if field.verdict == "refused" and not _says_nothing(value, field.neutral):
            raise InputError(f"{path} is {shown(value)}: {field.why}")
        several = isinstance(value, list)
        for number, entry in enumerate(value if several else [value]):
            if field.of and isinstance(entry, Mapping):
                check_message(entry, field.of, f"{path}[{number}]." if several else f"{path}.")


def _says_nothing(value: Any, neutral: int) -> bool:
    """Return whether a value is empty, or zeros, or a turn by nothing, at any depth."""
    if isinstance(value, Mapping):
        return all(_says_nothing(entry, key == "w" or neutral) for key, entry in value.items())
    if isinstance(value, list):
        return value == [0, 0, 0, 1] or all(_says_nothing(entry, neutral) for entry in value)
    return not value or value == neutral
