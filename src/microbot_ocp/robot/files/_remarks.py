"""Tolerated faults of a robot file, gathered and reported as warnings, one for each kind."""

from __future__ import annotations

import sys
import warnings

SHOWN = 12  # examples in a warning; a file may have the same fault a hundred times


class RobotFileWarning(UserWarning):
    """A robot file is read although something in it is wrong, missing or cannot be followed.

    The message names the file, the links or joints, and what was made of it.
    """


class Remarks:
    """Remarks on one file, by kind."""

    def __init__(self) -> None:
        self._items: dict[str, list[str]] = {}

    def add(self, kind: str, item: str = "") -> None:
        """Note an ``item`` of a ``kind``: the beginning of the sentence that lists its items."""
        items = self._items.setdefault(kind, [])
        if item and item not in items:
            items.append(item)

    def warn(self, origin: str) -> None:
        """Say all that was noted about the file ``origin``."""
        for kind, items in self._items.items():
            shown = items[:SHOWN]
            if len(items) > SHOWN:
                shown.append(f"{len(items) - SHOWN} more")
            told = f"{kind}: {', '.join(shown)}" if shown else kind
            warnings.warn(f"{origin}: {told}", RobotFileWarning, stacklevel=_caller())


def _caller() -> int:
    """Level of the first caller outside of this package, where the file was asked for."""
    frame, level = sys._getframe(1), 1
    while frame.f_back and frame.f_globals.get("__name__", "").startswith("microbot_ocp."):
        frame, level = frame.f_back, level + 1
    return level
