"""A time limit for everything that is called inside of a context: solvers, compilers, loops.

The limit is a wall time, an amount of work, or both. Work is processor time of this thread and of
the child processes that it waits for, so it is independent of the load of the machine.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar

import numpy as np

from microbot_ocp._base import checks, interrupts
from microbot_ocp._base.status import Status

_until: ContextVar[float] = ContextVar("until", default=np.inf)
_worked: ContextVar[float] = ContextVar("worked", default=np.inf)
_given_up: ContextVar[bool] = ContextVar("given_up", default=False)


WALL_FACTOR = 10.0  # wall time limit relative to the work limit, for a busy machine
BUSY = "It ended at the wall time of {:.3g} s, of which it had the processor for {:.3g} s."


class Over(Exception):
    """The time limit expired, and the unfinished result is dropped."""


class Begin:
    """Begin of a time limit."""

    def __init__(self) -> None:
        self._wall, self._work = time.perf_counter(), worked()

    @property
    def busy(self) -> str:
        """Sentence on a limit that ended at its wall time, with work left; empty otherwise."""
        if not over() or interrupts.pressed() or work_left() <= 0:
            return ""
        return BUSY.format(time.perf_counter() - self._wall, worked() - self._work)


@contextmanager
def within(time_limit: float, work: float = np.inf) -> Iterator[Begin]:
    """Limit the wall time, s, and the work, s, of everything called inside of the context.

    Searches that reach the limit return their best result. Limits nest: the earliest end counts.

    Raises
    ------
    InputError
        ``time_limit`` is no positive number; infinite means no limit.
    """
    seconds = checks.time_limit(time_limit)
    token = _until.set(min(_until.get(), time.perf_counter() + seconds))
    limit = _worked.set(min(_worked.get(), worked() + work))
    try:
        with interrupts.noted():
            yield Begin()
    finally:
        _until.reset(token)
        _worked.reset(limit)


def of_work(work: float, time_limit: float = np.inf) -> AbstractContextManager[Begin]:
    """Limit the work, s, and the wall time to ten times as much, or to ``time_limit``, s, if less.

    Raises
    ------
    InputError
        ``work`` is no positive number.
    """
    seconds = checks.time_limit(work)
    return within(min(WALL_FACTOR * seconds, time_limit), seconds)


def until() -> float:
    """Return the end of the time limit on the clock ``time.perf_counter``; infinite without one."""
    return 0.0 if interrupts.pressed() else _until.get()


def left() -> float:
    """Return the remaining time, s, if all of it is spent on work; infinite without a limit."""
    return max(0.0, min(until() - time.perf_counter(), work_left()))


def worked() -> float:
    """Return the work done: processor time of this thread and of awaited child processes, s."""
    return time.thread_time() + sum(os.times()[2:4])


def work_left() -> float:
    """Return the remaining work, s; infinite without a limit."""
    limit = _worked.get()
    return limit - worked() if limit < np.inf else np.inf


def processor_time() -> float:
    """Return the processor time of this process and of its awaited child processes, s."""
    return sum(os.times()[:4])


def over() -> bool:
    """Return True if the time or work limit is reached, or Ctrl-C was pressed."""
    return time.perf_counter() >= until() or work_left() <= 0


def status() -> Status:
    """Return the status of a search that the limit or Ctrl-C ended."""
    return Status.INTERRUPTED if interrupts.pressed() else Status.TIME_LIMIT


@contextmanager
def given_up(possible: bool = True) -> Iterator[None]:
    """Raise :class:`Over` from :func:`check` inside of the context once the limit is reached."""
    token = _given_up.set(possible)
    try:
        yield
    finally:
        _given_up.reset(token)


def check() -> None:
    """Raise :class:`Over` if the limit is reached and the result may be dropped."""
    if _given_up.get() and over():
        raise Over
