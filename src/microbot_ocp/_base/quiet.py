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
_silent: set[int] = set()  # threads


class _Stream:
    """A stream that silent threads do not write to."""

    def __init__(self, stream: Any) -> None:
        self.stream = stream

    def write(self, text: str) -> int:
        return len(text) if threading.get_ident() in _silent else self.stream.write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Print nothing from this thread; not to be entered twice by one."""
    with _lock:
        if not _silent:
            for name in STREAMS:
                setattr(sys, name, _Stream(getattr(sys, name)))
        _silent.add(threading.get_ident())
    try:
        yield
    finally:
        with _lock:
            _silent.remove(threading.get_ident())
            for name in STREAMS if not _silent else ():
                stream = getattr(sys, name)
                setattr(sys, name, stream.stream if isinstance(stream, _Stream) else stream)
