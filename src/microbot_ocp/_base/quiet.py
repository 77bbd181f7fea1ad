"""Silence for one thread while CasADi prints messages on its way to an exception.

A redirection of ``sys.stdout`` would redirect all threads: their output would be lost, and two
overlapping redirections would never be undone.
"""

from __future__ import annotations

import contextlib
import sys
import threading
from collections import Counter
from collections.abc import Iterator
from contextvars import ContextVar
from typing import Any

STREAMS = ("stdout", "stderr")
_silent: ContextVar[frozenset[str]] = ContextVar("silent", default=frozenset())  # names of streams
_lock = threading.Lock()
_uses: Counter[str] = Counter()  # contexts that suppress each stream


class _Stream:
    """A stream that drops the output of silent threads."""

    def __init__(self, stream: Any, name: str) -> None:
        self.stream, self.name = stream, name

    def write(self, text: str) -> int:
        return len(text) if self.name in _silent.get() else self.stream.write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


@contextlib.contextmanager
def quiet(*names: str) -> Iterator[None]:
    """Suppress the output of this thread to the named streams, by default to both."""
    names = names or STREAMS
    with _lock:
        for name in names:
            if not _uses[name]:
                setattr(sys, name, _Stream(getattr(sys, name), name))
            _uses[name] += 1
    token = _silent.set(_silent.get().union(names))
    try:
        yield
    finally:
        _silent.reset(token)
        with _lock:
            for name in names:
                _uses[name] -= 1
                stream = getattr(sys, name)
                if not _uses[name] and isinstance(stream, _Stream):
                    setattr(sys, name, stream.stream)


@contextlib.contextmanager
def aloud() -> Iterator[None]:
    """Print the output of this thread inside of :func:`quiet`, for a user's function."""
    token = _silent.set(frozenset())
    try:
        yield
    finally:
        _silent.reset(token)
