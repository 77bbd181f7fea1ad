"""XML of robot files: harmless faults are tolerated with a warning, all others are refused.

The reader accepts undeclared prefixes (``drake:...``), comments of any form, and any encoding, with
or without a byte order mark. It refuses entity declarations and unlimited nesting.
"""

from __future__ import annotations

import codecs
import re
from typing import NoReturn
from xml.etree import ElementTree
from xml.parsers import expat

from microbot_ocp._base.checks import InputError, warn_user
from microbot_ocp._base.reading import DEEPEST

SHOWN = 12  # most examples in a warning; a file may repeat a fault a hundred times
BYTE_ORDER_MARKS = (
    (codecs.BOM_UTF32_LE, "utf-32"),  # tested before utf-16, whose mark is a prefix of this one
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
    (b"<\0", "utf-16-le"),
    (b"\0<", "utf-16-be"),
)
DECLARATION = re.compile(r"\A\s*<\?xml\s.*?\?>", re.DOTALL)
# A comment without an end extends to the end of the text.
COMMENT = re.compile(r"<!--.*?(?:-->|\Z)", re.DOTALL)


class RobotFileWarning(UserWarning):
    """A robot file was read although something in it is wrong, missing or not supported.

    The message names the file, the links or joints concerned, and the data that were assumed.
    """


class Remarks:
    """Remarks on one file, by kind."""

    def __init__(self) -> None:
        self._items: dict[str, list[str]] = {}

    def add(self, kind: str, item: str = "") -> None:
        """Add an ``item`` of a ``kind``, the start of the sentence that lists its items."""
        items = self._items.setdefault(kind, [])
        if item and item not in items:
            items.append(item)

    def warn(self, origin: str) -> None:
        """Warn about all remarks on the file ``origin``."""
        for kind, items in self._items.items():
            shown = items[:SHOWN]
            if len(items) > SHOWN:
                shown.append(f"{len(items) - SHOWN} more")
            words = f"{kind}: {', '.join(shown)}" if shown else kind
            warn_user(f"{origin}: {words}", RobotFileWarning)


def read_xml(data: str | bytes, remarks: Remarks) -> ElementTree.Element:
    """Return the root element of an XML text; names keep their prefixes."""
    text = data if isinstance(data, str) else _decoded(data, remarks)
    # Removed comments keep their line breaks, so that errors name the right line.
    text = COMMENT.sub(_blank, text.lstrip("\ufeff"))
    text = DECLARATION.sub(_blank, text, count=1)
    builder, depth = ElementTree.TreeBuilder(), 0

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > DEEPEST:
            raise InputError(f"elements are nested deeper than {DEEPEST}: <{name}> is no robot's")
        builder.start(name, attributes)

    def end(name: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(name)

    def entity(name: str, *_: object) -> NoReturn:
        raise InputError(f"XML entities are not read, but {name!r} is declared")

    parser = expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler, parser.EntityDeclHandler = builder.data, entity
    try:
        parser.Parse(text.encode(), True)
    except (expat.ExpatError, UnicodeEncodeError) as problem:
        raise InputError(f"the text is not valid XML: {problem}") from None
    return builder.close()


def _blank(match: re.Match[str]) -> str:
    return "\n" * match.group().count("\n")


def _decoded(data: bytes, remarks: Remarks) -> str:
    marked = [encoding for mark, encoding in BYTE_ORDER_MARKS if data.startswith(mark)]
    encoding = marked[0] if marked else _declared(data)
    try:
        return data.decode(encoding)
    except (LookupError, UnicodeError):
        remarks.add(f"the text is not {encoding}, as it should be: read as Latin-1")
        return data.decode("latin-1")


def _declared(data: bytes) -> str:
    declaration = re.match(rb"\s*<\?xml[^>]*?encoding\s*=\s*[\"']([\w.:-]+)", data)
    name = declaration.group(1).decode("ascii", "replace") if declaration else "utf-8"
    wide = name.lower().replace("-", "").startswith(("utf16", "utf32"))
    return "utf-8" if wide else name  # a declaration in wide characters would not have matched
