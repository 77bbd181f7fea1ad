"""Start and end of the process, also by Ctrl-C, SIGTERM or SIGHUP.

Signal handlers are installed before any slow import. A signal raises KeyboardInterrupt, so that
open files are closed; the exit code is 128 plus the number of the signal. CasADi's solvers swallow
the exception and end as if they had failed, and compiled code handles no signal before it returns.
Therefore :func:`check` raises the exception again, and a thread ends the process and its child
processes after a short time in any case.
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

from microbot_ocp._base.system import signals

SIGNALS = signals("SIGINT", "SIGTERM", "SIGHUP")
_pressed = threading.Event()
_code = 128 + signal.SIGINT
_watched = False
_taken = False  # True after the main thread has handled a signal; the other thread may be earlier
_messages: Any = None  # standard error before the signal replaced it


class NotDone(Exception):
    """Failure of a command in one sentence: exit code 1 and no result."""


def entry() -> int:
    """Run the program of the command line; return its exit code.

    The program exits silently if the reader of its output closes the pipe.
    """
    try:
        _open_streams()
        watch()
        from microbot_ocp.cli._program import run

        code = run()
    except KeyboardInterrupt:
        code = exit_code()
    except Exception:
        if not pressed():  # a signal in the middle of an import raises other exceptions
            raise
        code = exit_code()
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError):  # reported already; Python would flush again at exit
            with contextlib.suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    # After a KeyboardInterrupt inside exec (a dataclass is built by exec) Python kills itself with
    # the signal at exit, whatever the exit code is. The next exec resets that state.
    exec("")
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: os._exit(code))  # no handler may run at interpreter exit
    return code


def _open_streams() -> None:
    """Open closed standard streams again, because the next opened file would get their numbers.

    Printing to standard output is an error afterwards, as on a full disk; messages are dropped.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            mode = os.O_WRONLY if name == "stderr" else os.O_RDONLY
            os.open(os.devnull, mode)  # the system assigns the lowest free number
            stream = open(number, "r" if name == "stdin" else "w", closefd=False)  # noqa: SIM115
            setattr(sys, name, stream)


def watch() -> None:
    """Install the signal handlers; a second signal ends the process at once."""
    global _watched, _taken, _messages
    _taken, _messages = False, None
    _pressed.clear()
    for number in SIGNALS:
        if number.name != "SIGHUP" or signal.getsignal(number) is not signal.SIG_IGN:  # nohup
            signal.signal(number, _press)
    sys.unraisablehook = _unraisable
    if not _watched:
        reader, writer = os.pipe()
        if hasattr(os, "set_blocking"):  # Windows: from Python 3.12 on
            os.set_blocking(writer, False)
        signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
        threading.Thread(target=_end_late, args=(reader,), daemon=True).start()
        _watched = True


def pressed() -> bool:
    """Return whether a signal has arrived."""
    return _pressed.is_set()


def messages() -> Any:
    """Return the stream for messages: standard error, also after a signal."""
    return _messages or sys.stderr


def exit_code() -> int:
    """Return 128 plus the number of the signal."""
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
    # CasADi's solvers print on standard error that a function was interrupted.
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
    """End the process at once; kill its child processes and delete half-written files."""
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
