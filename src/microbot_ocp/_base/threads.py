"""Caches with one entry for each thread, for objects that work in a memory of their own.

CasADi's solvers and coal's distance queries keep their work memory between calls. If two threads
evaluate one object at once, its numbers mix, or the process crashes.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, wraps
from threading import get_ident
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")


def cached_in_thread(maxsize: int) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Return a decorator like ``functools.lru_cache`` with separate entries for each thread.

    Examples
    --------
    >>> @cached_in_thread(maxsize=4)
    ... def memory(size: int) -> list[float]:
    ...     return size * [0.0]
    >>> memory(2) is memory(2)
    True
    """

    def decorated(make: Callable[P, T]) -> Callable[P, T]:
        @lru_cache(maxsize)
        def made(_: int, *given: P.args, **named: P.kwargs) -> T:
            return make(*given, **named)

        @wraps(make)
        def of_this_thread(*given: P.args, **named: P.kwargs) -> T:
            return made(get_ident(), *given, **named)

        return of_this_thread

    return decorated
