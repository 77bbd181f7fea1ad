"""The process: its beginning and its end, by itself or by Ctrl-C, SIGTERM or SIGHUP.

It imports next to nothing before it listens to signals. Each raises KeyboardInterrupt, so that
everything open is closed on the way out; the exit code is 128 and the number of the signal.
CasADi's solvers swallow the exception and end as if they had failed, and compiled code does not see
it before it returns: hence :func:`check`, and a thread that ends the process soon in any case,
with the processes that it started.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import time
from types import FrameType
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_pressed = threading.Event()
_code = 128 + signal.SIGINT
_watched = False
_taken = False  # by the main thread; the other one may know of the signal before it
_messages: Any = None  # standard error as it was before the signal


class NotDone(Exception):
    """What could not be done, in one sentence: exit code 1, and nothing is printed."""


def entry() -> int:
    """Run the program of the command line; return its exit code.

    It exits silently when the reader of its output goes away.
    """
    try:
        _open_streams()
        watch()
        from microbot_ocp.cli._program import run

        code = run()
    except KeyboardInterrupt:
        code = exit_code()
    except Exception:
        if not pressed():  # else the signal came in the middle of an import
            raise
        code = exit_code()
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError):  # said by then; Python would flush again on its way out
            with contextlib.suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    # Where the signal came inside an exec, as in a dataclass that is made, Python would end by the
    # signal in the place of the code; the next exec makes it forget that.
    exec("")
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: os._exit(code))  # Python is on its way out
    return code


def _open_streams() -> None:
    """Take the place of standard streams that are closed, which the next file would get.

    What is printed is an error then, as on a full disk; messages are dropped.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            mode = os.O_WRONLY if name == "stderr" else os.O_RDONLY
            os.open(os.devnull, mode)  # the lowest number that is free
            stream = open(number, "r" if name == "stdin" else "w", closefd=False)  # noqa: SIM115
            setattr(sys, name, stream)


def watch() -> None:
    """Take the signals; a second one ends the process at once."""
    global _watched, _taken, _messages
    _taken, _messages = False, None
    _pressed.clear()
    for number in SIGNALS:
        if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:  # nohup
            signal.signal(number, _press)
    sys.unraisablehook = _unraisable
    if not _watched:
        reader, writer = os.pipe()
        os.set_blocking(writer, False)
        signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
        threading.Thread(target=_end_late, args=(reader,), daemon=True).start()
        _watched = True


def pressed() -> bool:
    """Return whether there was a signal."""
    return _pressed.is_set()


def messages() -> Any:
    """Return where messages go: standard error, also after a signal."""
    return _messages or sys.stderr


def exit_code() -> int:
    """Return 128 and the number of the signal."""
    return _code


def check() -> None:
    """Raise the KeyboardInterrupt that a solver may have swallowed."""
    if pressed():
        raise KeyboardInterrupt


def _press(number: int, _: FrameType | None) -> None:
    global _code, _taken, _messages
    _code = 128 + number
    if _taken:
        _end()
    _taken = True
    _pressed.set()
    # CasADi's solvers write on it that a function of theirs was interrupted
    _messages, sys.stderr = sys.stderr, open(os.devnull, "w")  # noqa: SIM115
    raise KeyboardInterrupt


def _end_late(reader: int, grace: float = 0.7) -> None:
    """End the process ``grace`` s after the signal, whatever its main thread does."""
    global _code
    while (number := os.read(reader, 1)[0]) not in SIGNALS:
        pass
    _code = 128 + number
    _pressed.set()
    time.sleep(grace)
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
