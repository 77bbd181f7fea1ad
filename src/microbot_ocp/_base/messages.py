"""Fields of the messages of ROS and MoveIt: each is kept, harmless, or refused if it has content.

``messages.txt`` lists the fields of requests, scenes and trajectories; :func:`check_message`
compares every message that is read with the list, so that no field is ignored in silence.
``docs/messages.md`` is generated from it.
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
    """Verdict on a field, its reason, the type of nested messages, and the value for no content."""

    verdict: str
    why: str
    of: str
    neutral: int


def _fields(lines: Iterable[str]) -> Iterator[tuple[str, Field]]:
    for line in lines:
        verdict, names, of, neutral, why = LINE.fullmatch(line).groups("")  # type: ignore[union-attr]
        for name in names.split():
            yield name, Field(verdict, why.replace("{}", name), of, int(neutral or 0))


_TEXT = TABLE.read_text("utf-8")
MESSAGES: dict[str, dict[str, Field]] = {
    kind: dict(_fields(lines))
    for kind, *lines in (part.split("\n") for part in _TEXT.strip().split("\n\n")[1:])
}


def kind_of(document: Mapping[str, Any], kinds: Iterable[str]) -> str:
    """Return the candidate type that shares most keys with a document and its nested parts."""

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
    """Raise InputError for the first field that is unknown or refused; the message has its path."""
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
    """Return True if a value is empty, zero, or an identity rotation, at any depth."""
    if isinstance(value, Mapping):
        return all(_says_nothing(entry, key == "w" or neutral) for key, entry in value.items())
    if isinstance(value, list):
        return value == [0, 0, 0, 1] or all(_says_nothing(entry, neutral) for entry in value)
    return not value or value == neutral
