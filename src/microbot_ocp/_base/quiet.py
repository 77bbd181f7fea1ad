"""Silence for one thread while CasADi prints messages on its way to an exception.

A redirection of ``sys.stdout`` would redirect all threads: their output would be lost, and two
overlapping redirections would never be undone.
"""

from __future__ import annotations

import contextlib
import sys
import threading
from collections.abc import Iterator
from typing import Any

STREAMS = ("stdout", "stderr")
_lock = threading.Lock()
_silent: dict[str, set[int]] = {name: set() for name in STREAMS}  # identities of silent threads


class _Stream:
    """A stream that drops the output of silent threads."""

    def __init__(self, stream: Any, name: str) -> None:
        self.stream, self.name = stream, name

    def write(self, text: str) -> int:
        silent = threading.get_ident() in _silent[self.name]
        return len(text) if silent else self.stream.write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


@contextlib.contextmanager
def quiet(*names: str) -> Iterator[None]:
    """Suppress the output of this thread to the named streams, by default to both."""
    me = threading.get_ident()
    with _lock:
        new = [name for name in names or STREAMS if me not in _silent[name]]
        for name in new:
            if not _silent[name]:
                setattr(sys, name, _Stream(getattr(sys, name), name))
            _silent[name].add(me)
    try:
        yield
    finally:
        with _lock:
            for name in new:
                _silent[name].discard(me)
                stream = getattr(sys, name)
                if not _silent[name] and isinstance(stream, _Stream):
                    setattr(sys, name, stream.stream)


@contextlib.contextmanager
def aloud() -> Iterator[None]:
    """Print the output of this thread inside of :func:`quiet`, for a user's function."""
    me = threading.get_ident()
    with _lock:
        held = [name for name in STREAMS if me in _silent[name]]
        for name in held:
            _silent[name].remove(me)
    try:
        yield
    finally:
        with _lock:
            for name in held:
                _silent[name].add(me)
