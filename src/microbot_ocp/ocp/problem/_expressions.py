"""Functions of numbers made from expressions of a phase, and expressions made from functions."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.threads import expanded
from microbot_ocp.ocp.problem._items import Measurement
from microbot_ocp.ocp.problem._phase import Phase


class Expressions:
    """Inputs of the expressions of a phase, in a fixed order.

    Parameters
    ----------
    phase : Phase
    data : sequence of Measurement
        Measurements that the expressions also depend on.

    Attributes
    ----------
    inputs : list of (name, symbol)
        Variables, rates of linear controls, data, time, duration and parameters.
    """

    def __init__(self, phase: Phase, data: Sequence[Measurement] = ()) -> None:
        self.phase, self.data = phase, data
        self.inputs: list[tuple[str, ca.MX]] = [(v.name, v.symbol) for v in phase.variables]
        self.inputs += [(f"the rate of {name}", rate) for name, rate in phase.rates.items()]
        self.inputs += [(m.name, m.symbol) for m in data]
        self.inputs += [("time", phase.time), ("duration", phase.duration)]
        self.inputs += [(p.name, p.symbol) for p in phase.parameters]

    @property
    def symbols(self) -> list[ca.MX]:
        """Symbols of the inputs."""
        return [symbol for _, symbol in self.inputs]

    def function(self, expressions: Sequence[ca.MX]) -> ca.Function:
        """Return the expressions, stacked, as a function of the table of all inputs."""
        stacked = ca.densify(ca.vertcat(*expressions, ca.MX(0, 1)))
        return as_scalars(ca.Function("declared", [ca.vertcat(*self.symbols)], [stacked]))

    def with_slopes(
        self, expression: ca.MX, by: ca.MX, count: int
    ) -> Callable[[Sequence[FloatArray]], tuple[FloatArray, FloatArray]]:
        """Return a function of the tables of M points that returns an expression and its slopes.

        Its values are tables [M, rows] and [M, rows, columns]; ``count`` is M.
        """
        slopes = ca.densify(ca.jacobian(expression, by))
        outputs = [ca.densify(expression), slopes]
        run, (rows, columns) = ca.Function("look", self.symbols, outputs).map(count), slopes.shape

        def looked(tables: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
            values, blocks = (np.array(out) for out in run(*tables))
            # The mapped function returns one block of columns per point.
            return values.T, blocks.reshape(rows, count, columns).transpose(1, 0, 2)

        return looked

    def tables(
        self,
        values: Mapping[str, FloatArray],
        t: FloatArray,
        duration: float | FloatArray,
        rates: Mapping[str, FloatArray] | None = None,
        data: Sequence[FloatArray] | None = None,
    ) -> list[FloatArray]:
        """Return values [size, M] of the inputs at times t [M] since the start of the phase.

        Rates and variables without a given value are zero; data without values take the measured
        ones in turn.
        """
        phase, rates = self.phase, rates or {}
        if data is None:
            data = [m.value[np.arange(t.size) % len(m.value)].T for m in self.data]
        none = {v.name: np.zeros((v.size, t.size)) for v in phase.variables}
        moving = [values.get(v.name, none[v.name]) for v in phase.variables]
        moving += [rates.get(name, none[name]) for name in phase.rates]
        fixed = [np.tile(p.value[:, None], (1, t.size)) for p in phase.parameters]
        return [*moving, *data, t[None], np.full((1, t.size), duration), *fixed]

    def table(self, *values: Any, **more: Any) -> FloatArray:
        """Return the values of :meth:`tables`, stacked [inputs, M]."""
        return np.vstack(self.tables(*values, **more))


def as_scalars(function: ca.Function) -> ca.Function:
    """Return the function as one scalar graph, if its calls have scalar graphs."""
    try:
        return expanded(function)
    except RuntimeError:  # interpolants, callbacks and compiled functions have no scalar graph
        return function


def operations(
    function: ca.Function, inputs: Sequence[ca.SX]
) -> Iterator[tuple[int, ca.SX, ca.SX, ca.SX]]:
    """Yield the operations of a scalar graph with both operands and the value, for given inputs.

    The operands of an operation on one number are equal.
    """
    work: dict[int, ca.SX] = {}
    for k in range(function.n_instructions()):
        operation, operands = function.instruction_id(k), function.instruction_input(k)
        if operation == ca.OP_INPUT:
            value = inputs[operands[0]][operands[1]]
        elif operation == ca.OP_CONST:
            value = ca.SX(function.instruction_constant(k))
        elif operation == ca.OP_OUTPUT:
            continue
        elif operation == ca.OP_CALL:  # an interpolant has no scalar graph
            return
        else:
            a, b = work[operands[0]], work[operands[-1]]
            value = ca.SX.binary(operation, a, b)
            yield operation, a, b, value
        work[function.instruction_output(k)[0]] = value


class PythonFunction(ca.Callback):
    """A CasADi callback with one result, declared by sparsities; subclasses define ``eval``."""

    def __init__(
        self, name: str, inputs: Sequence[ca.Sparsity], result: ca.Sparsity, **options: Any
    ) -> None:
        ca.Callback.__init__(self)
        self.inputs, self.result = inputs, result
        self.construct(name, options)

    def get_n_in(self) -> int:
        return len(self.inputs)

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return self.inputs[i]

    def get_sparsity_out(self, _: int) -> ca.Sparsity:
        return self.result


_KEPT: list[ca.Callback] = []  # CasADi expressions hold no reference to their callbacks


def numeric_function(
    function: Callable[..., object], sizes: Sequence[int] = (1,), result: int = 1
) -> ca.Function:
    """Return a numerical function, such as a table or a simulation, for use in expressions.

    First derivatives are central differences, second derivatives differences of these: accurate to
    about 1e-6 and 1e-4. Each evaluation calls Python, and an iteration needs several hundred per
    interval. The function must be smooth, and is also evaluated slightly beside the solver's
    iterate. Prefer a function of CasADi if there is one, such as ``ca.interpolant`` for tables.

    Parameters
    ----------
    function : callable
        Function of one array [size] per entry of ``sizes`` that returns a number or an array
        [result].
    sizes : sequence of int
    result : int

    Returns
    -------
    casadi.Function
        Function of the given sizes, with differences as derivatives.

    Raises
    ------
    InputError
        A size is not a whole number from 1 up; on evaluation, the number of results is wrong.

    Examples
    --------
    The fastest motion over 1 m at a speed that falls with x: 2 log 2 s.

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


class _Numeric(PythonFunction):
    def __init__(self, function: Callable[..., object], sizes: Sequence[int], result: int) -> None:
        self.function = function
        # Kernels are cached by their printed form, so each function needs a unique name.
        name, dense = f"numeric_{len(_KEPT)}", ca.Sparsity.dense
        super().__init__(name, [dense(size) for size in sizes], dense(result), enable_fd=True)

    def eval(self, arg: Sequence[ca.DM]) -> list[FloatArray]:
        values = self.function(*(np.array(value).ravel() for value in arg))
        label = f"result of {getattr(self.function, '__name__', 'the function')}"
        flat = np.ravel(np.asarray(values, float))
        return [checks.array(label, flat, (self.result.size1(),), finite=False)]
