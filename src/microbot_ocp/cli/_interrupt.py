"""Signals that end the program: Ctrl-C, SIGTERM, SIGHUP, also inside a solver or an import.

Each raises KeyboardInterrupt, so that everything open is closed on the way out; the exit code is
128 and the number of the signal. CasADi's solvers swallow the exception and end as if they had
failed, and compiled code does not see it before it returns: hence :func:`check`, and a thread that
ends the process after :data:`GRACE` in any case, with the processes that it started.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from types import FrameType
from typing import Any

GRACE = 0.7  # s
_pressed = threading.Event()
_code = 128 + signal.SIGINT
_watched = False
_taken = False  # by the main thread; the other one may know of the signal before it


def watch() -> None:
    """Take the signals; a second one ends the process at once."""
    global _watched, _taken
    _taken = False
    _pressed.clear()
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if number is None or (name == "SIGHUP" and signal.getsignal(number) is signal.SIG_IGN):
            continue  # nohup
        signal.signal(number, _press)
    sys.unraisablehook = _unraisable
    if not _watched and os.name == "posix":
        reader, writer = os.pipe()
        os.set_blocking(writer, False)
        signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
        threading.Thread(target=_end_late, args=(reader,), daemon=True).start()
        _watched = True


def pressed() -> bool:
    """Whether there was a signal."""
    return _pressed.is_set()


def exit_code() -> int:
    """128 and the number of the signal."""
    return _code


def check() -> None:
    """Raise the KeyboardInterrupt that a solver may have swallowed."""
    if pressed():
        raise KeyboardInterrupt


def _press(number: int, _: FrameType | None) -> None:
    global _code, _taken
    _code = 128 + number
    if _taken:
        _end()
    _taken = True
    _pressed.set()
    raise KeyboardInterrupt


def _end_late(reader: int) -> None:
    """End the process some time after the signal, whatever its main thread does."""
    global _code
    while True:
        number = os.read(reader, 1)[0]
        if number in (signal.SIGINT, signal.SIGTERM, getattr(signal, "SIGHUP", None)):
            break
    _code = 128 + number
    _pressed.set()
    time.sleep(GRACE)
    _end()


def _end() -> None:
    """End at once, with the processes that were started and without what was half written."""
    for name in ("_base.codegen", "views.live._viewer", "_base.writing"):
        module = sys.modules.get(f"microbot_ocp.{name}")
        if module is not None:
            module.abandon()
    processes = sys.modules.get("multiprocessing.process")
    for child in () if processes is None else processes.active_children():  # workers of a sweep
        child.kill()
    os._exit(_code)


def _unraisable(problem: Any) -> None:
    if not pressed():
        sys.__unraisablehook__(problem)
