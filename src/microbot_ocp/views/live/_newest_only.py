"""A background job whose requests may come faster than it is done: only the newest counts."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Generic, TypeVar

Request = TypeVar("Request")


class NewestOnly(Generic[Request]):
    """Does a job in the background for the newest request; older ones that wait are dropped.

    Parameters
    ----------
    job : callable
        Takes a request. It runs in one thread, never twice at once; what it raises is logged.
    """

    def __init__(self, job: Callable[[Request], None]) -> None:
        self._job = job
        self._thread = ThreadPoolExecutor(1)
        self._newest: Future[None] | None = None

    def ask(self, request: Request) -> None:
        """Do the job for this request as soon as the one under way is done."""
        if self._newest is not None:
            self._newest.cancel()  # nothing happens to the one under way
        self._newest = self._thread.submit(self._job, request)
        self._newest.add_done_callback(lambda job: job.cancelled() or job.result())

    @property
    def newer(self) -> bool:
        """Whether a newer request waits for the job under way to end."""
        return self._newest is not None and not (self._newest.running() or self._newest.done())

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until nothing is left to do; False where ``timeout`` seconds were not enough."""
        return self._newest is None or not wait([self._newest], timeout).not_done
