"""The border: what a face (``__init__.py`` with its stub) offers checks its arguments."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import lazy_loader


def attach_stub(name: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list], list]:
    """As that of lazy_loader; functions and classes come out of it with checked arguments."""
    load, directory, names = lazy_loader.attach_stub(name, file)
    seen: set[str] = set()

    def public(wanted: str) -> Any:
        found = load(wanted)
        from microbot_ocp._base.argument_types import checked  # with numpy, not before a name

        for module, kind in _loaded_classes(name, seen):
            if kind.__name__ in names and kind.__module__ == module:
                checked(kind)
        made = sys.modules[name].__dict__[wanted] = checked(found)
        return made

    return public, directory, names


def _loaded_classes(face: str, seen: set[str]) -> list[tuple[str, type]]:
    """Classes of the modules behind a face that were imported since this was asked before.

    A user may get an object of a class whose name nobody has asked for.
    """
    new = [
        (name, module)
        for name, module in list(sys.modules.items())
        if name.startswith(f"{face}.") and name not in seen and not _is_loading(module)
    ]
    seen.update(name for name, _ in new)
    return [(name, x) for name, module in new for x in vars(module).values() if isinstance(x, type)]


def _is_loading(module: Any) -> bool:
    return getattr(getattr(module, "__spec__", None), "_initializing", False)
