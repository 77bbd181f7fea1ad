"""Functions of numbers in expressions: what cannot be written in CasADi, by finite differences."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import casadi as ca
import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray

_KEPT: list[ca.Callback] = []  # expressions that call them do not keep them


def numeric_function(
    function: Callable[..., object], sizes: Sequence[int] = (1,), result: int = 1
) -> ca.Function:
    """Return a function of numbers, such as a table or a simulation, for expressions.

    Its derivatives are central differences, those of second order differences of differences: good
    to about 1e-6 and 1e-4, and every evaluation is a call of Python, of which an iteration needs
    some hundreds for every interval. It must be smooth, and is evaluated a little beside where the
    solver is. What CasADi can say (``ca.interpolant`` for tables) is better said there.

    Parameters
    ----------
    function : callable
        Gets an array [size] for every one of ``sizes``, returns a number or an array [result].
    sizes : sequence of int
    result : int

    Returns
    -------
    casadi.Function

    Raises
    ------
    InputError
        A size that is no whole number from 1 up; when it is evaluated, another number of results.

    Examples
    --------
    The fastest way over 1 m of a slope that slows down: 2 log 2 s.

    >>> from microbot_ocp.ocp import OptimalControlProblem, SolverSettings, solve
    >>> slower = numeric_function(lambda x: 1.0 - x / 2)
    >>> problem = OptimalControlProblem("slope")
    >>> phase = problem.phase("up", duration=(0.1, 10.0))
    >>> x = phase.state("x", initial=0.0, final=1.0, unit="m")
    >>> u = phase.control("u", lower=0.0, upper=1.0)
    >>> phase.derivative(x, u * slower(x))
    >>> phase.end_cost(phase.duration)
    >>> round(solve(problem, mesh=3, settings=SolverSettings("ipopt")).cost, 4)
    1.3863
    """
    for size in (*sizes, result):
        checks.whole("every size", size, at_most=np.inf)
    callback = _Numeric(function, sizes, result)
    _KEPT.append(callback)
    return callback


class _Numeric(ca.Callback):
    def __init__(self, function: Callable[..., object], sizes: Sequence[int], result: int) -> None:
        ca.Callback.__init__(self)
        self.function, self.sizes, self.result = function, tuple(sizes), result
        # kernels are shared by what they look like: every function has a name of its own
        self.construct(f"numeric_{len(_KEPT)}", {"enable_fd": True})

    def get_n_in(self) -> int:
        return len(self.sizes)

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self.sizes[i], 1)

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self.result, 1)

    def eval(self, arg: Sequence[ca.DM]) -> list[FloatArray]:
        values = self.function(*(np.array(value).ravel() for value in arg))
        label = f"result of {getattr(self.function, '__name__', 'the function')}"
        return [
            checks.array(label, np.ravel(np.asarray(values, float)), (self.result,), finite=False)
        ]
