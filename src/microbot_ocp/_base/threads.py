"""What works in a memory of its own, once for each thread.

CasADi's solvers, called from Python, and coal's distances keep what they work with between calls;
an evaluation by two threads at once mixes their numbers, or ends the process.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, wraps
from threading import get_ident
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")


def cached_in_thread(maxsize: int) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Do as ``functools.lru_cache``, but that no two threads get the same object.

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
