"""A background job whose requests may come faster than it is done: only the newest counts."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

Request = TypeVar("Request")


class NewestOnly(Generic[Request]):
    """Does a job in the background for the newest request; older ones that wait are dropped.

    Parameters
    ----------
    job : callable
        Takes a request. It runs in one thread at a time, never twice at once, and must not raise.
    """

    def __init__(self, job: Callable[[Request], None]) -> None:
        self._job = job
        self._condition = threading.Condition()
        self._waiting: list[Request] = []  # one at most
        self._running = False

    def ask(self, request: Request) -> None:
        """Do the job for this request as soon as the one under way is done."""
        with self._condition:
            self._waiting = [request]
            if not self._running:
                self._running = True
                threading.Thread(target=self._run, daemon=True).start()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until nothing is left to do; False where ``timeout`` seconds were not enough."""
        with self._condition:
            return self._condition.wait_for(lambda: not self._running, timeout)

    def _run(self) -> None:
        while True:
            with self._condition:
                if not self._waiting:
                    self._running = False
                    self._condition.notify_all()
                    return
                request = self._waiting.pop()
            try:
                self._job(request)
            except BaseException:
                with self._condition:  # else ``wait`` would wait for a thread that is gone
                    self._waiting.clear()
                    self._running = False
                    self._condition.notify_all()
                raise
