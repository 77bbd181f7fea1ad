"""Ctrl-C, which solvers swallow: an interrupted call never returns a normal answer.

If KeyboardInterrupt leaves a function that a solver of CasADi evaluates, the solver reports a mere
failure; in a finalizer, Python drops it. Therefore an interrupt is counted as well as raised, for
the duration of a public call. From then on every time limit has expired, and the call returns its
answer only if the answer's status says that it was interrupted.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from types import FrameType
from typing import Any

from microbot_ocp._base.status import Status

# Python's own versions convert to an enumeration, which takes 20 us a call.
_handler = getattr(signal.getsignal, "__wrapped__", signal.getsignal)
_set_handler = getattr(signal.signal, "__wrapped__", signal.signal)
_count = 0  # number of interrupts
# Number of interrupts at the start of the main thread's outermost public call.
_before: int | None = None


def note() -> None:
    """Count an interrupt that the caller handles, such as one in a progress function."""
    global _count
    _count += _is_main()


@contextmanager
def noted(*, is_raised: bool = True) -> Iterator[Callable[[], bool]]:
    """Count each KeyboardInterrupt of a signal inside of the context, and raise it if asked to.

    Yields a function that returns True after an interrupt. The previously installed handler decides
    whether a signal is an interrupt. Only the main thread receives signals.
    """
    before, usual = _count, _handler(signal.SIGINT)

    def handle(number: int, frame: FrameType | None) -> None:
        try:
            usual(number, frame)  # type: ignore[operator]
        except KeyboardInterrupt:
            note()
            if is_raised:
                raise

    handle.notes = True  # pyright: ignore[reportFunctionMemberAccess]
    listens = callable(usual) and not (is_raised and hasattr(usual, "notes")) and _is_main()
    if listens:
        _set_handler(signal.SIGINT, handle)
    try:
        yield lambda: _count > before
    finally:
        if listens and _handler(signal.SIGINT) is handle:
            _set_handler(signal.SIGINT, usual)


def pressed() -> bool:
    """Return True if an interrupt came since the outermost public call began."""
    return _before is not None and _count > _before and _is_main()


def obeyed(function: Callable[..., Any], arguments: Any, named: Any, *, notes: bool) -> Any:
    """Return the answer of a public call; raise KeyboardInterrupt if a solver swallowed one.

    ``notes`` wraps the call in :func:`noted`, which takes some us; without it, only the functions
    that run solvers count interrupts.
    """
    global _before
    if _before is not None or not _is_main():
        return function(*arguments, **named)
    try:
        _before = _count
        with noted() if notes else nullcontext():
            answer = function(*arguments, **named)
        if pressed() and getattr(answer, "status", None) is not Status.INTERRUPTED:
            raise KeyboardInterrupt
        return answer
    except Exception as problem:  # CasADi turns an interrupt into other errors, such as SystemError
        if pressed():
            raise KeyboardInterrupt from problem
        raise
    finally:
        _before = None


def _is_main() -> bool:
    return threading.current_thread() is threading.main_thread()
