"""Public faces (``__init__.py`` with its stub) whose functions and classes check arguments."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import lazy_loader


def attach_stub(name: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list], list]:
    """Return lazy_loader's functions for a stub; loaded functions and classes check arguments."""
    load, directory, names = lazy_loader.attach_stub(name, file)
    seen: set[str] = set()

    def public(wanted: str) -> Any:
        try:
            value = load(wanted)
        except AttributeError:
            if wanted.startswith("_") or wanted in names:
                raise
            from microbot_ocp._base.checks import similar
            from microbot_ocp._base.foreign_words import WORDS, WORDS_OF_ARMS, remedy

            words = WORDS | WORDS_OF_ARMS if ".ocp" not in name else WORDS_OF_ARMS | WORDS
            hint = remedy(wanted, words) or similar(wanted, names)
            raise AttributeError(f"{name} has no {wanted!r}{hint}") from None
        # Imports numpy, which a mere import of the package must not do.
        from microbot_ocp._base.argument_types import checked

        # A user may get an object of a class without ever accessing the name of the class.
        for module in _loaded(name, seen):
            for kind in vars(sys.modules[module]).values():
                if isinstance(kind, type) and kind.__name__ in names and kind.__module__ == module:
                    checked(kind, name)
        value = sys.modules[name].__dict__[wanted] = checked(value, name)
        return value

    return public, directory, names


def _loaded(face: str, seen: set[str]) -> list[str]:
    """Return the modules behind a face that were imported since the last call."""
    new = [
        name
        for name, module in list(sys.modules.items())
        if name.startswith(f"{face}.")
        and name not in seen
        and not getattr(getattr(module, "__spec__", None), "_initializing", False)
    ]
    seen.update(new)
    return new
