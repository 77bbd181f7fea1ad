"""Entry point of the program. It imports next to nothing before it listens to signals."""

from __future__ import annotations

import contextlib
import os
import signal
import sys

from microbot_ocp.cli import _interrupt as interrupt

LEAST_DESCRIPTORS = 32


def entry() -> int:
    """Run the program of the command line; return its exit code.

    It exits silently when the reader of its output goes away.
    """
    try:
        _open_streams()
        if few := _few_descriptors():
            print(f"error: {few}", file=sys.stderr)
            return 1
        interrupt.watch()
        from microbot_ocp.cli._app import run

        code = run()
    except KeyboardInterrupt:
        code = interrupt.exit_code()
    except Exception:
        if not interrupt.pressed():  # else the signal came in the middle of an import
            raise
        code = interrupt.exit_code()
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError):  # told by then; Python would flush again on its way out
            with contextlib.suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    # Where the signal came inside an exec, as in a dataclass that is made, Python would end by the
    # signal in the place of the code; the next exec makes it forget that.
    exec("")
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: os._exit(code))  # Python is on its way out
    return code


def _few_descriptors() -> str:
    """What is wrong where a process may open too few files, after all are asked for that it may.

    The library that writes recordings ends the program there.
    """
    try:
        import resource
    except ImportError:  # Windows
        return ""
    now, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    if now == resource.RLIM_INFINITY or now >= LEAST_DESCRIPTORS:
        return ""
    if most == resource.RLIM_INFINITY or most >= LEAST_DESCRIPTORS:
        resource.setrlimit(resource.RLIMIT_NOFILE, (LEAST_DESCRIPTORS, most))
        return ""
    return f"{now} file descriptors are too few: {LEAST_DESCRIPTORS} are needed (ulimit -n)"


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
