"""Caches with one entry for each thread, and scalar expressions that several threads make.

CasADi's solvers and coal's distance queries keep their work memory between calls. If two threads
evaluate one object at once, its numbers mix, or the process crashes.

CasADi (3.8.2) has one node for equal constants of all scalar expressions (SX). If one thread drops
the last expression with a constant while another makes one with it, the other gets a node that is
being freed (``create`` and the destructor in ``casadi/core/constant_sx.hpp``), and the process
crashes. What is made anew for each problem and each payload is therefore made by one thread at a
time, and while several threads run its constants stay. Functions that a robot has once are made
without the lock: their constants live as long as the caches of these functions.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import lru_cache, wraps
from threading import RLock, active_count, get_ident
from typing import Any, ParamSpec, TypeVar

import casadi as ca

P = ParamSpec("P")
T = TypeVar("T")

_scalars = RLock()  # the thread that makes scalar expressions holds it
if hasattr(os, "register_at_fork"):  # a child process must not inherit a lock that is held
    os.register_at_fork(
        before=_scalars.acquire, after_in_parent=_scalars.release, after_in_child=_scalars.release
    )


@lru_cache(maxsize=100_000)
def _constant(value: float) -> ca.SX:
    return ca.SX(value)


def makes_scalars(make: Callable[P, T]) -> Callable[P, T]:
    """Return a function that makes functions of scalar expressions, in one thread at a time.

    While several threads run, the constants of the functions that it returns stay in memory.
    """

    @wraps(make)
    def made_alone(*given: P.args, **named: P.kwargs) -> T:
        with _scalars:
            made = make(*given, **named)
            if active_count() > 1:
                for function in made if isinstance(made, tuple) else (made,):
                    _keep_constants(function)
            return made

    return made_alone


def _keep_constants(function: Any) -> None:
    if isinstance(function, ca.Function) and function.is_a("SXFunction"):
        for k in range(function.n_instructions()):
            if function.instruction_id(k) == ca.OP_CONST:
                _constant(function.instruction_constant(k))


@makes_scalars
def expanded(function: ca.Function) -> ca.Function:
    """Return the function as one graph of scalar operations, made in one thread at a time.

    Raises
    ------
    RuntimeError
        If it calls a function without such a graph, as interpolants and compiled functions are.
    """
    return function.expand()


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
