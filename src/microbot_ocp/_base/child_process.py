"""Work in a process of its own, which is ended when its time is over.

fatrop may try one regularisation after the other without ever evaluating anything, MUMPS may spend
minutes in a single factorisation: neither can be stopped from inside. A fork costs about 8 ms.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable
from multiprocessing import Pipe, parent_process
from multiprocessing.connection import Connection
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

PR_SET_PDEATHSIG = 1
Send = Callable[[Any], None]

PACKAGE = str(Path(__file__).parents[1])
SIGNALS = str(Path(PACKAGE, "cli", "_process.py"))  # its thread waits for one and holds no lock
_is_child = False
_forking = threading.RLock()  # its owner, who forks, owns it in the child, too


class OutOfTime(Exception):
    """The work was not done in time, and was ended."""


class Died(Exception):
    """The process ended without an answer."""


def can_fork() -> bool:
    """Return whether work may be done in a copy of this process.

    Not while another thread is inside this package: a lock that it holds in native code (CasADi's
    of its cache of sparsities, IPOPT's of MUMPS) would stay locked in the copy for ever. Work is
    done in this process then, where solvers keep their own limits of time.
    """
    others = sys._current_frames()
    others.pop(threading.get_ident())
    return not any(_is_ours(frame) for frame in others.values())


def _is_ours(frame: FrameType | None) -> bool:
    while frame is not None:
        file = frame.f_code.co_filename
        if file.startswith(PACKAGE) and file != SIGNALS:
            return True
        frame = frame.f_back
    return False


def spare_processor() -> bool:
    """Return whether another process would run beside this one, which is no worker of many itself.

    Nor from any thread but the first.
    """
    if threading.current_thread() is not threading.main_thread():
        return False
    there = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else (0,)
    return can_fork() and not _is_child and len(there) > 1 and parent_process() is None


class Child:
    """Work in a copy of this process, beside what this one does.

    Parameters
    ----------
    work : callable
        Gets a function that sends an object to this process at once.
    """

    def __init__(self, work: Callable[[Send], Any]) -> None:
        with _forking:  # filters of warnings are for all threads, and no other child gets this pipe
            self.begun = time.perf_counter()
            self.reading, writing = Pipe(duplex=False)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", DeprecationWarning)  # of threads: only this forks
                self.process = os.fork()
            if self.process == 0:
                _work(work, self.reading, writing)
            writing.close()

    def answer(
        self,
        until: float,
        receive: Callable[[Any], bool] | None = None,
        silence: float = np.inf,
        steps: Callable[[], int] | None = None,
        most: float = np.inf,
    ) -> Any:
        """Return what the work returns, as :func:`in_child`."""
        heard = 0.0  # processor time of the process when something was known of it last
        last_count = 0
        while True:
            left = min(until - time.perf_counter(), 1e6)
            if np.isfinite(most):  # nothing is used faster than time goes by
                left = min(left, most - self._processor_time())
            if left <= 0:
                raise OutOfTime
            if not self.reading.poll(min(left, silence)):
                now, count = self._processor_time(), last_count if steps is None else steps()
                if count == last_count and now - heard > max(silence, heard):
                    raise OutOfTime
                last_count, heard = count, heard if count == last_count else now
                continue
            heard = self._processor_time() if np.isfinite(silence) else 0.0
            try:
                done, what = self.reading.recv()
            except (EOFError, OSError):  # between messages, or within one
                raise Died from None
            if done:
                return what
            if receive is not None and not receive(what):
                raise KeyboardInterrupt

    def _processor_time(self) -> float:
        """Return what the process has used, s; wall time where the system does not tell."""
        with contextlib.suppress(OSError):
            fields = Path(f"/proc/{self.process}/stat").read_text().rpartition(")")[2].split()
            return sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")
        return time.perf_counter() - self.begun

    def close(self) -> None:
        """End the process."""
        self.reading.close()
        os.kill(self.process, signal.SIGKILL)
        os.waitpid(self.process, 0)


def in_child(
    work: Callable[[Send], Any],
    until: float,
    receive: Callable[[Any], bool] | None = None,
    *,
    most_bytes: int | None = None,
    silence: float = np.inf,
    steps: Callable[[], int] | None = None,
    most: float = np.inf,
) -> Any:
    """Do work in a copy of this process and return what it returns.

    Parameters
    ----------
    work : callable
        Gets a function that sends an object to this process at once.
    until : by the clock of ``time.perf_counter``
    receive : callable, optional
        Gets what was sent; False ends the process.
    most_bytes : int, optional
        Of memory beyond that of this process (on Linux); a request for more is a MemoryError.
    silence : float
        Processor time of the copy, s, in which it sends nothing, and which is more than all that it
        used before, after which it counts as looping for ever. However busy the machine is, it is
        the same.
    most : processor time of the copy, s, after which it is out of time, too

    Raises
    ------
    OutOfTime, Died
        KeyboardInterrupt passes through; the process is ended before.
    """

    def limited(send: Send) -> Any:
        assert most_bytes is not None
        _limit_memory(most_bytes)
        return work(send)

    with contextlib.closing(Child(work if most_bytes is None else limited)) as child:
        return child.answer(until, receive, silence, steps, most)


def _work(work: Callable[[Send], Any], reading: Connection, writing: Connection) -> None:
    global _is_child
    try:
        _is_child = True
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends this process
        end_with_parent()
        reading.close()
        writing.send((True, work(lambda what: writing.send((False, what)))))
    finally:
        os._exit(0)


def _limit_memory(most_bytes: int) -> None:
    """Let this process take so many bytes more than it has."""
    with contextlib.suppress(OSError, ImportError, ValueError):
        import resource

        taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        _, hard = resource.getrlimit(resource.RLIMIT_AS)
        resource.setrlimit(resource.RLIMIT_AS, (taken + most_bytes, hard))


def end_with_parent() -> None:
    """Let Linux end this process when the one that started it is killed."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
