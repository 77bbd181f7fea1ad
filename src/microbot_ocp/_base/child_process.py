"""Work in a child process, which is killed at a time limit.

fatrop may try one regularisation after the other without an evaluation, MUMPS may spend minutes in
a single factorisation: neither can be interrupted from inside. A fork costs about 8 ms.
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
from itertools import chain
from multiprocessing import Pipe, parent_process
from multiprocessing.connection import Connection
from pathlib import Path
from traceback import walk_stack
from typing import Any

import numpy as np

from microbot_ocp._base.system import FORKS

PR_SET_PDEATHSIG = 1
Send = Callable[[Any], None]

PACKAGE = str(Path(__file__).parents[1])
# Its thread waits for a signal and holds no lock.
SIGNALS = str(Path(PACKAGE, "cli", "_process.py"))
_is_child = False
_forking = threading.RLock()  # the forking thread owns the lock in the child, too


class OutOfTime(Exception):
    """The time limit expired and the process was killed."""


class Died(Exception):
    """The process ended without an answer."""


def can_fork() -> bool:
    """Return True if a fork of this process may do work.

    While another thread runs code of this package it may hold a lock in native code (in CasADi's
    cache of sparsity patterns, in IPOPT's use of MUMPS), which would stay locked in the fork for
    ever. In that case, and on macOS and Windows, the caller works in this process, where solvers
    keep their own time limits.
    """
    if not FORKS:
        return False
    others = sys._current_frames()
    others.pop(threading.get_ident())
    frames = chain.from_iterable(map(walk_stack, others.values()))
    files = {frame.f_code.co_filename for frame, _ in frames} - {SIGNALS}
    return not any(file.startswith(PACKAGE) for file in files)


def spare_processor() -> bool:
    """Return True if a processor is free for a child process.

    False in a child process, in a worker of a pool, and in all threads but the main one.
    """
    if threading.current_thread() is not threading.main_thread():
        return False
    there = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else (0,)
    return can_fork() and not _is_child and len(there) > 1 and parent_process() is None


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
    """Run work in a fork of this process and return its result.

    Parameters
    ----------
    work : callable
        Function of one argument, a function that sends an object to this process at once.
    until : float
        End of the time limit on the clock ``time.perf_counter``, s.
    receive : callable, optional
        Function of a sent object; if it returns False the child is killed.
    most_bytes : int, optional
        Memory beyond that of this process (Linux only), bytes; a larger request is a MemoryError.
    silence : float
        Processor time of the child without a message, s, from which the child counts as stuck, if
        it is also longer than all of its processor time before; independent of the machine's load.
    steps : callable, optional
        Function that returns a count of the child's progress; an increase counts as a message.
    most : float
        Limit of the child's processor time, s.

    Raises
    ------
    OutOfTime, Died
        KeyboardInterrupt is raised, too, after the child was killed.
    """

    begun = time.perf_counter()
    process, reading = _forked(work, most_bytes)
    try:
        heard = 0.0  # processor time of the child at its last sign of progress, s
        last_count = 0
        while True:
            left = min(until - time.perf_counter(), 1e6)
            if np.isfinite(most):  # processor time does not grow faster than wall time
                left = min(left, most - _processor_time(process, begun))
            if left <= 0:
                raise OutOfTime
            if not reading.poll(min(left, silence)):
                now = _processor_time(process, begun)
                count = last_count if steps is None else steps()
                # Stuck means no message and no step for longer than all of the work before.
                if count == last_count and now - heard > max(silence, heard):
                    raise OutOfTime
                last_count, heard = count, heard if count == last_count else now
                continue
            heard = _processor_time(process, begun) if np.isfinite(silence) else 0.0
            try:
                done, message = reading.recv()
            except (EOFError, OSError):  # the pipe ended between or within messages
                raise Died from None
            if done:
                return message
            if receive is not None and not receive(message):
                raise KeyboardInterrupt
    finally:
        reading.close()
        os.kill(process, signal.SIGKILL)
        os.waitpid(process, 0)


def _forked(work: Callable[[Send], Any], most_bytes: int | None) -> tuple[int, Connection]:
    """Return the number of a new process that does the work, and the pipe of its messages."""
    # Warning filters are shared by all threads; no other child may inherit this pipe.
    with _forking:
        reading, writing = Pipe(duplex=False)
        with warnings.catch_warnings():
            # A warning about threads, which can_fork has tested.
            warnings.simplefilter("ignore", DeprecationWarning)
            process = os.fork()
        if process == 0:
            _work(work, reading, writing, most_bytes)
        writing.close()
    return process, reading


def _work(
    work: Callable[[Send], Any], reading: Connection, writing: Connection, most_bytes: int | None
) -> None:
    global _is_child
    try:
        _is_child = True
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent kills this process
        end_with_parent()
        reading.close()
        if most_bytes is not None:
            _limit_memory(most_bytes)
        writing.send((True, work(lambda message: writing.send((False, message)))))
    finally:
        os._exit(0)


def _processor_time(process: int, begun: float) -> float:
    """Return the processor time of a process, s; wall time if the system does not report it."""
    with contextlib.suppress(OSError):
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
        return sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")
    return time.perf_counter() - begun


def _limit_memory(most_bytes: int) -> None:
    """Limit the memory of this process to its present size plus ``most_bytes``."""
    with contextlib.suppress(OSError, ImportError, ValueError):
        import resource

        taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        _, hard = resource.getrlimit(resource.RLIMIT_AS)
        resource.setrlimit(resource.RLIMIT_AS, (taken + most_bytes, hard))


def end_with_parent() -> None:
    """Ask Linux to kill this process when its parent dies."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
