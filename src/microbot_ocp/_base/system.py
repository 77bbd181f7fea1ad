"""Parts of the operating system that Linux has, and macOS or Windows lack."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from subprocess import Popen

with contextlib.suppress(ImportError):  # Windows
    import fcntl

# A fork on macOS may hang in the system's libraries: multiprocessing does not fork there either.
FORKS = hasattr(os, "fork") and sys.platform != "darwin"
# GCC for Windows misaligns AVX registers on the stack (GCC bug 54412), which ends the process.
COMPILES = sys.platform != "win32"
# Options of subprocess.Popen: Ctrl-C does not reach the process, and end_group ends its children.
NEW_GROUP = 0x200  # subprocess.CREATE_NEW_PROCESS_GROUP
OWN_GROUP: Any = (
    {"creationflags": NEW_GROUP} if sys.platform == "win32" else {"start_new_session": True}
)


def signals(*names: str) -> tuple[signal.Signals, ...]:
    """Return the signals of these names that the system has."""
    return tuple(getattr(signal, name) for name in names if hasattr(signal, name))


def alive(pid: int) -> bool:
    """Return False if no process of this machine has the number; True on Windows."""
    if sys.platform == "win32":  # os.kill would end the process
        return True
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        pass
    return True


def end_group(process: Popen[Any], patience: float = 0.0) -> None:
    """Kill a process that was started with ``OWN_GROUP``, and its children.

    With ``patience``, s, they are first asked to end, and killed if they take longer.
    """
    if sys.platform == "win32":
        import subprocess  # loaded by the program of the command line after its signal handlers

        command = ["taskkill", "/F", "/T", "/PID", str(process.pid)]
        subprocess.run(command, capture_output=True, check=False)
        return
    with contextlib.suppress(OSError):  # raised after the last process of the group has ended
        if patience:
            os.killpg(process.pid, signal.SIGTERM)
            process.wait()
            until = time.monotonic() + patience
            while time.monotonic() < until:
                os.killpg(process.pid, 0)
                time.sleep(0.02)
        os.killpg(process.pid, signal.SIGKILL)


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock a folder for other processes, if the system can lock folders."""
    handle = None
    with contextlib.suppress(OSError, NameError):
        handle = os.open(folder, os.O_RDONLY)
        fcntl.flock(handle, fcntl.LOCK_EX)
    try:
        yield
    finally:
        if handle is not None:
            os.close(handle)


@contextlib.contextmanager
def uninterrupted_children() -> Iterator[None]:
    """Start threads and processes that ignore Ctrl-C inside of the context; not on Windows.

    They inherit the signal mask of the thread that starts them.
    """
    if sys.platform == "win32":
        yield
        return
    # The resource tracker unblocks SIGINT when it starts, so start it before the mask is set. Its
    # warnings on semaphores of killed processes are expected.
    from multiprocessing import resource_tracker

    silent = "ignore:resource_tracker"
    sys.warnoptions.append(silent)
    resource_tracker.ensure_running()
    sys.warnoptions.remove(silent)
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
