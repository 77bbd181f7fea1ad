"""A limit kept by all that is called inside it: solvers, compilers, loops between solves.

It is of wall time, of work, or of both. Work is processor time, of this thread and of the processes
that it waits for: however busy the machine is, as much is done.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import numpy as np

from microbot_ocp._base import checks, interrupts
from microbot_ocp._base.status import Status

_until: ContextVar[float] = ContextVar("until", default=np.inf)
_worked: ContextVar[float] = ContextVar("worked", default=np.inf)
_given_up: ContextVar[bool] = ContextVar("given_up", default=False)


class Over(Exception):
    """The time is over, and what was being made is given up."""


@contextmanager
def within(time_limit: float, work: float = np.inf) -> Iterator[None]:
    """End what is called inside after so much wall time, s, or work, s, with the best it has by
    then.

    Limits nest: the one that ends first counts.

    Raises
    ------
    InputError
        ``time_limit`` is no positive number; infinite is none.
    """
    seconds = checks.time_limit(time_limit)
    token = _until.set(min(_until.get(), time.perf_counter() + seconds))
    limit = _worked.set(min(_worked.get(), worked() + work))
    try:
        with interrupts.noted():
            yield
    finally:
        _until.reset(token)
        _worked.reset(limit)


def until() -> float:
    """Return when the time is over, by the clock of ``time.perf_counter``; infinite without a
    limit.
    """
    return 0.0 if interrupts.pressed() else _until.get()


def left() -> float:
    """Return the time that is left, s, if all of it is worked; infinite without a limit."""
    return max(0.0, min(until() - time.perf_counter(), work_left()))


def worked() -> float:
    """Return the work so far: processor time of this thread and of processes it waited for, s."""
    return time.thread_time() + sum(os.times()[2:4])


def work_left() -> float:
    """Return the work that is left, s; infinite without a limit."""
    limit = _worked.get()
    return limit - worked() if limit < np.inf else np.inf


def processor_time() -> float:
    """Return the time of this process and of those that it started and waited for, s."""
    return sum(os.times()[:4])


def over() -> bool:
    """Return whether the time is over, or the work, by its limit or by Ctrl-C."""
    return time.perf_counter() >= until() or work_left() <= 0


def status() -> Status:
    """Return the status of what ended because the time is over."""
    return Status.INTERRUPTED if interrupts.pressed() else Status.TIME_LIMIT


@contextmanager
def given_up(possible: bool = True) -> Iterator[None]:
    """Raise :class:`Over` in what is made inside when the time is over, where that is possible."""
    token = _given_up.set(possible)
    try:
        yield
    finally:
        _given_up.reset(token)


def check() -> None:
    """Raise :class:`Over` where the time is over and what is being made may be given up."""
    if _given_up.get() and over():
        raise Over
