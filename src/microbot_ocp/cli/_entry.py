"""Entry point of the program. It imports next to nothing before it listens to signals."""

from __future__ import annotations

import os
import signal
import sys

from microbot_ocp.cli import _interrupt as interrupt


def entry() -> int:
    """Run the program of the command line; return its exit code.

    It exits silently when the reader of its output goes away.
    """
    try:
        interrupt.watch()
        from microbot_ocp.cli._app import run

        code = run()
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
    except KeyboardInterrupt:
        code = interrupt.exit_code()
    except Exception:
        if not interrupt.pressed():  # else the signal came in the middle of an import
            raise
        code = interrupt.exit_code()
    # Where the signal came inside an exec, as in a dataclass that is made, Python would end by the
    # signal in the place of the code; the next exec makes it forget that.
    exec("")
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: os._exit(code))  # Python is on its way out
    return code
