"""Silence for one thread: what CasADi prints on its way to an exception.

To redirect ``sys.stdout`` is to redirect it for all threads: what others print is lost, and two
redirections that overlap leave it redirected for ever.
"""

from __future__ import annotations

import contextlib
import sys
import threading
from collections.abc import Iterator
from typing import Any

STREAMS = ("stdout", "stderr")
_lock = threading.Lock()
_silent: dict[str, set[int]] = {name: set() for name in STREAMS}  # threads


class _Stream:
    """A stream that silent threads do not write to."""

    def __init__(self, stream: Any, name: str) -> None:
        self.stream, self.name = stream, name

    def write(self, text: str) -> int:
        silent = threading.get_ident() in _silent[self.name]
        return len(text) if silent else self.stream.write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


@contextlib.contextmanager
def quiet(*names: str) -> Iterator[None]:
    """Print nothing from this thread, to some streams or to both."""
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
    """Let through what this thread prints inside of :func:`quiet`: that of a user's function."""
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
