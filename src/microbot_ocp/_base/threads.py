"""Caches with one entry for each thread, and scalar expressions that several threads make.

CasADi's solvers and coal's distance queries keep their work memory between calls. If two threads
evaluate one object at once, its numbers mix, or the process crashes.

CasADi (3.8.2) has one node for equal constants of all scalar expressions (SX). If one thread drops
the last expression with a constant while another makes one with it, the other gets a node that is
being freed (``create`` and the destructor in ``casadi/core/constant_sx.hpp``), and the process
crashes. So one thread at a time makes scalar expressions, and their constants stay.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, wraps
from threading import RLock, active_count, get_ident
from typing import ParamSpec, TypeVar

import casadi as ca

P = ParamSpec("P")
T = TypeVar("T")

making_scalars = RLock()  # the thread that makes scalar expressions holds it


@lru_cache(maxsize=100_000)
def _constant(value: float) -> ca.SX:
    return ca.SX(value)


def with_constants_kept(function: ca.Function) -> ca.Function:
    """Return the function. While several threads run, its scalar constants stay in memory."""
    if active_count() > 1 and function.is_a("SXFunction"):
        for k in range(function.n_instructions()):
            if function.instruction_id(k) == ca.OP_CONST:
                _constant(function.instruction_constant(k))
    return function


def expanded(function: ca.Function) -> ca.Function:
    """Return the function as one graph of scalar operations.

    Raises
    ------
    RuntimeError
        If it calls a function without such a graph, as interpolants and compiled functions are.
    """
    with making_scalars:
        return with_constants_kept(function.expand())


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
