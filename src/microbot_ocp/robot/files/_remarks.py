"""Tolerated faults of a robot file, gathered and reported as warnings, one for each kind."""

from __future__ import annotations

from microbot_ocp._base.checks import warn_user

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
            words = f"{kind}: {', '.join(shown)}" if shown else kind
            warn_user(f"{origin}: {words}", RobotFileWarning)
