"""Ctrl-C, which solvers swallow: what was interrupted never passes for an answer.

CasADi's solvers end as if they had failed when KeyboardInterrupt comes out of a function that they
evaluate, and Python drops it in finalizers. So it is noted beside being raised, for as long as a
public call lasts. Every limit of time is over from then on, and an answer that does not say that it
was interrupted is not returned.
"""

from __future__ import annotations

import inspect
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from types import FrameType
from typing import Any

from microbot_ocp._base.status import Status

# those of the C module: Python's look for an enumeration's member, 20 us a call
_handler, _set_handler = inspect.unwrap(signal.getsignal), inspect.unwrap(signal.signal)
_count = 0  # of interrupts so far
_before: int | None = None  # the count when the outermost public call of the main thread began


def note() -> None:
    """Note an interrupt that is dealt with here, such as that of a progress function."""
    global _count
    _count += _is_main()


@contextmanager
def noted(*, is_raised: bool = True) -> Iterator[Callable[[], bool]]:
    """Note KeyboardInterrupt of a signal inside, and raise it, or not.

    Yields a function that tells whether there was one. Whatever handler was installed decides
    whether a signal is an interrupt; only the main thread gets any.
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
    """Return whether there was an interrupt since the outermost public call began."""
    return _before is not None and _count > _before and _is_main()


def obeyed(function: Callable[..., Any], arguments: Any, named: Any, *, notes: bool) -> Any:
    """Return what a public call answers; KeyboardInterrupt where one was swallowed unsaid.

    ``notes`` asks for :func:`noted` around it, which takes some us: without, it is what solves
    inside that notes.
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
    except Exception as problem:  # CasADi makes others of it, such as SystemError
        if pressed():
            raise KeyboardInterrupt from problem
        raise
    finally:
        _before = None


def _is_main() -> bool:
    return threading.current_thread() is threading.main_thread()
