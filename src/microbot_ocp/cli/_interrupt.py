"""Ctrl-C, also inside a solver: CasADi's solvers swallow it and end as if they had failed."""

from __future__ import annotations

import signal
import threading
from types import FrameType

_pressed = threading.Event()


def watch() -> None:
    """Remember the first Ctrl-C; a second one ends the process at once."""
    _pressed.clear()
    signal.signal(signal.SIGINT, _press)


def pressed() -> bool:
    """Whether there was a Ctrl-C."""
    return _pressed.is_set()


def check() -> None:
    """Raise the KeyboardInterrupt that a solver may have swallowed."""
    if pressed():
        raise KeyboardInterrupt


def _press(_: int, __: FrameType | None) -> None:
    _pressed.set()
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    raise KeyboardInterrupt
