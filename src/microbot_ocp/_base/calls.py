"""Calls of functions in expressions: inlined, replaced by differentiable ones, or refused."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress

import casadi as ca

from microbot_ocp._base.checks import InputError
from microbot_ocp._base.codegen import ORIGINS


def written_out(function: ca.Function, given: Sequence[ca.MX]) -> list[ca.MX] | None:
    """Return the results of a call as expressions in which the inner calls are visible.

    None if CasADi cannot inline the function.
    """
    if function.class_name() in ("Map", "OmpMap", "ThreadMap"):
        inner = function.find_functions(0)[0]
        columns = [inner.size2_in(k) for k in range(inner.n_in())]
        parts = [ca.horzsplit(e, n) for e, n in zip(given, columns, strict=True)]
        results = zip(*(inner.call(each) for each in zip(*parts, strict=True)), strict=True)
        return [ca.horzcat(*each) for each in results]
    if function.is_a("MXFunction") or (function.is_a("SXFunction") and function.find_functions()):
        with suppress(RuntimeError):  # a function with the option never_inline
            return function.call(given, True, False)
    return None


def from_origins(expression: ca.MX) -> ca.MX:
    """Return an expression in which each compiled function is replaced by its CasADi original.

    Calls inside of other functions are replaced, too.
    """
    old: list[ca.MX] = [expression]
    while ORIGINS and old and any(map(_is_compiled, _called(expression))):
        old, new = [], []
        for output in _outputs_of_calls(expression):
            call = output.dep(0)
            function, given = call.which_function(), [call.dep(k) for k in range(call.n_dep())]
            results = None
            if _is_compiled(function):
                results = ORIGINS[function.__hash__()][1].call(given)
            elif any(map(_is_compiled, function.find_functions())):
                results = written_out(function, given)
            if results is not None:
                old.append(output)
                new.append(results[output.which_output()])
        (expression,) = ca.graph_substitute([expression], old, new)
    return expression


def refuse_without_derivatives(label: str, expression: ca.MX) -> None:
    """Raise InputError for external or Python functions that have no second derivatives."""
    for function in _called(expression):
        if function.class_name() not in ("External", "CallbackInternal"):
            continue
        given = [ca.MX.sym("k", function.sparsity_in(k)) for k in range(function.n_in())]
        symbols = ca.vertcat(*map(ca.vec, given))
        try:
            values = ca.vertcat(*map(ca.vec, function.call(given)))
            ca.hessian(ca.dot(values, ca.MX.sym("w", values.shape[0])), symbols)
        except RuntimeError:
            raise InputError(
                f"{label} calls {function.name()!r}, which has no second derivatives: make it of "
                "CasADi's expressions, or of numbers by ocp.numeric_function, or give it the "
                "option enable_fd"
            ) from None


def _called(expression: ca.MX) -> list[ca.Function]:
    whole = ca.Function("whole", ca.symvar(expression), [expression])
    return whole.find_functions()


def _is_compiled(function: ca.Function) -> bool:
    return function.__hash__() in ORIGINS


def _outputs_of_calls(expression: ca.MX) -> Iterator[ca.MX]:
    waiting, seen = [expression], {}
    while waiting:
        node = waiting.pop()
        if node.__hash__() not in seen:
            seen[node.__hash__()] = node  # kept alive, so that no other node gets its hash
            waiting += [node.dep(k) for k in range(node.n_dep())]
            if node.is_output() and node.dep(0).is_call():
                yield node
