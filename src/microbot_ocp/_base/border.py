"""The border: what a face (``__init__.py`` with its stub) offers checks its arguments."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import lazy_loader


def attach_stub(name: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list], list]:
    """As that of lazy_loader; functions and classes come out of it with checked arguments."""
    load, directory, names = lazy_loader.attach_stub(name, file)

    def public(wanted: str) -> Any:
        found = load(wanted)
        from microbot_ocp._base.argument_types import checked  # with numpy, not before a name

        made = sys.modules[name].__dict__[wanted] = checked(found)
        return made

    return public, directory, names
