"""A stage as light formulas around calls of heavy functions, differentiated by the chain rule.

A stage evaluates a heavy function, such as the torques of an arm, at several points of its
interval. Inlined and differentiated by all variables of the stage, its derivatives would be many
times larger. Here it is differentiated once, by its own arguments; the formulas around it are
light, and matrix products combine both.

With calls ``w = f(A(v, c))`` and outer formulas ``g(v, c, w)``, and ``T = f'(A) A_v``:
Jacobian ``g_v + g_w T``; Hessian of a weighted sum, with ``p`` the gradient of the weighted f,
``(g + p' A)_vv + g_vw T + T' g_wv + T' g_ww T + A_v' f_AA A_v``.

Derivatives of a heavy function may be supplied: ``first_derivatives`` maps its inputs to values [w]
and Jacobian [w, a], ``second_derivatives`` maps its inputs and weights [w] to gradient [a] and
Hessian [a, a] of the weighted sum of its values, with respect to all inputs, stacked. A third
function for the values alone may follow if it is faster than the function itself.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca

from microbot_ocp._base.threads import expanded, makes_scalars

Functions = Sequence[ca.Function]
HEAVY = 400  # number of operations above which a function is differentiated separately


@dataclass(frozen=True, eq=False)
class Calls:
    """Calls of one heavy function; ``arguments`` is ``(v, c) -> A [a, K]``, one column per call."""

    function: ca.Function
    arguments: ca.Function

    @property
    def count(self) -> int:
        return self.arguments.size2_out(0)

    @property
    def results(self) -> int:
        """Number of results of all calls."""
        return sum(self.function.size1_out(k) for k in range(self.function.n_out())) * self.count


@dataclass(frozen=True, eq=False)
class Composition:
    """A stage ``(v, c) -> next, rows, cost`` divided into heavy calls and outer formulas.

    ``outer`` takes the results w of all calls as well: ``(v, c, w) -> next, rows, cost``.
    """

    calls: tuple[Calls, ...]
    outer: ca.Function


def divided(stage: ca.Function) -> Composition | None:
    """Return the stage divided at its heavy calls, or None if it has none."""
    v, c = stage.mx_in()
    results = ca.cse(list(stage.call([v, c], True, False)))
    heavy = _heavy_calls(results)
    if not heavy:
        return None
    calls, symbols, replaced, symbol_of = [], [], [], []
    try:
        for function, nodes in heavy:
            columns = []
            for node, outputs in nodes:
                outputs_of_call = [
                    ca.MX.sym("w", function.size1_out(k)) for k in range(function.n_out())
                ]
                columns.append(ca.vertcat(*(node.dep(i) for i in range(node.n_dep()))))
                symbols += outputs_of_call
                replaced += outputs
                symbol_of += [outputs_of_call[output.which_output()] for output in outputs]
            if _heavy_calls(columns):  # nested heavy calls are not supported
                return None
            arguments = ca.Function("stage_arguments", [v, c], [ca.horzcat(*columns)])
            calls.append(Calls(function, expanded(arguments)))
        outer = ca.graph_substitute(results, replaced, symbol_of)
        outer = expanded(ca.Function("stage_outer", [v, c, ca.vertcat(*symbols)], outer))
    except RuntimeError:  # an interpolant or callback has no scalar graph
        return None
    return Composition(tuple(calls), outer)


HeavyCalls = list[tuple[ca.Function, list[tuple[ca.MX, list[ca.MX]]]]]


def _heavy_calls(expressions: Sequence[ca.MX]) -> HeavyCalls:
    """Return the heavy functions in expressions, with each call and its used outputs."""
    calls: dict[int, dict[int, tuple[ca.MX, list[ca.MX]]]] = {}
    functions: dict[int, ca.Function] = {}
    seen: set[int] = set()
    waiting = list(expressions)
    while waiting:
        node = waiting.pop()
        if node.__hash__() in seen:
            continue
        seen.add(node.__hash__())
        waiting += [node.dep(i) for i in range(node.n_dep())]
        if not node.is_output() or not node.dep(0).is_call():
            continue
        call = node.dep(0)
        function = call.which_function()
        if function.is_a("SXFunction") and function.n_instructions() >= HEAVY:
            key = function.__hash__()
            functions[key] = function
            nodes_of = calls.setdefault(key, {})
            nodes_of.setdefault(call.__hash__(), (call, []))[1].append(node)
    return [(functions[key], list(nodes_of.values())) for key, nodes_of in calls.items()]


Derivatives = Callable[[ca.Function], tuple[ca.Function, ...] | None]


def automatic(function: ca.Function) -> None:
    """Return None: derivatives are found by automatic differentiation."""


def composed_derivatives(
    stage: Composition, derivatives: Derivatives = automatic
) -> tuple[ca.Function | None, ca.Function, ca.Function]:
    """Return value, Jacobian and Hessian functions of a stage, with the inputs of undivided ones.

    The value function is None if it is no faster than that of the undivided stage.
    """
    derived: list[tuple[ca.Function, ...]] = [
        derivatives(calls.function) or _derivatives_of(calls.function) for calls in stage.calls
    ]
    first, second = ([functions[k] for functions in derived] for k in range(2))
    fast = all(len(functions) > 2 for functions in derived)
    return (
        _composed_stage(stage, [functions[2] for functions in derived]) if fast else None,
        _composed_jacobian(stage, first),
        _composed_hessian(stage, first, second),
    )


def _composed_stage(stage: Composition, values: Functions) -> ca.Function:
    """Return the function ``(v, c) -> next, rows, cost``."""
    v, c = stage.outer.mx_in()[:2]
    results = []
    for calls, function in zip(stage.calls, values, strict=True):
        outputs = _at_every_call(function, calls.arguments(v, c))
        results.append(ca.vec(ca.vertcat(*outputs)))
    outer: Any = stage.outer
    return ca.Function("stage", [v, c], list(outer(v, c, ca.vertcat(*results))))


def _composed_jacobian(stage: Composition, first: Functions) -> ca.Function:
    """Return the function ``(v, c) -> [next; rows], Jacobian, cost, gradient``, all by v."""
    v, c = stage.outer.mx_in()[:2]
    w, through = _results(stage, first, v, c)
    both, cost, by_v, slope_v, by_w, slope_w = _light_jacobian(stage)(v, c, w)
    # Chain rule with T = dw/dv.
    gradient = ca.densify((slope_v + slope_w @ through).T)
    return ca.Function("stage_jacobian", [v, c], [both, by_v + by_w @ through, cost, gradient])


@makes_scalars
def _light_jacobian(stage: Composition) -> ca.Function:
    """Return derivatives of the outer formulas alone: g, phi, g_v, phi_v, g_w, phi_w."""
    v, c, w = stage.outer.sx_in()
    following, rows, cost = stage.outer(v, c, w)
    both = ca.vertcat(following, rows)
    outputs = [both, cost, *(ca.jacobian(k, x) for x in (v, w) for k in (both, cost))]
    return ca.Function("stage_light_jacobian", [v, c, w], ca.cse(outputs))


def _composed_hessian(stage: Composition, first: Functions, second: Functions) -> ca.Function:
    """Return the function ``(v, c, lam, sigma) -> H``.

    H is the Hessian by v of ``sigma cost + lam' [-next; rows]``.
    """
    v, c = stage.outer.mx_in()[:2]
    lam = ca.MX.sym("lam", stage.outer.size1_out(0) + stage.outer.size1_out(1))
    sigma = ca.MX.sym("sigma")
    weights, light = _light_hessian(stage)
    mixed = any(light.nnz_out(k) for k in (1, 2))  # g is not linear in w: T is needed
    w, through = (
        _results(stage, first, v, c) if mixed else (ca.MX(stage.outer.size1_in(2), 1), None)
    )
    # Weights of the results of every call: gradient of the weighted sum by w.
    pulled = ca.vertsplit(weights(v, c, w, lam, sigma), _edges([c.results for c in stage.calls]))
    gradients, total = [], ca.MX(v.shape[0], v.shape[0])
    for calls, function, weight in zip(stage.calls, second, pulled, strict=True):
        arguments, slopes = _slopes(calls)(v, c)
        columns = ca.reshape(weight, -1, calls.count)
        gradient, hessians = _at_every_call(function, arguments, columns)
        gradients.append(ca.vec(gradient))
        blocks = ca.vertsplit_n(slopes, calls.count), ca.horzsplit_n(hessians, calls.count)
        for slope, hessian in zip(*blocks, strict=True):
            # Curvature of the heavy functions: A_v' f_AA A_v, call by call.
            total = total + slope.T @ (hessian @ slope)
    # Curvature of the outer formulas, and of the arguments A weighted with p.
    straight, by_vw, by_ww = light(v, c, w, lam, sigma, ca.vertcat(*gradients))
    total = total + straight
    if through is not None:
        # Mixed terms g_vw T + T' g_wv, and T' g_ww T.
        half = by_vw @ through
        total = total + half + half.T + through.T @ (by_ww @ through)
    return ca.Function("stage_hessian", [v, c, lam, sigma], [total])


def _edges(sizes: Sequence[int]) -> list[int]:
    return [0, *itertools.accumulate(sizes)]


def _results(stage: Composition, first: Functions, v: ca.MX, c: ca.MX) -> tuple[ca.MX, ca.MX]:
    """Return results w of all calls, and their derivatives T by v."""
    results, through = [], []
    for calls, function in zip(stage.calls, first, strict=True):
        arguments, slopes = _slopes(calls)(v, c)
        values, inner = _at_every_call(function, arguments)
        results.append(ca.vec(values))
        blocks = ca.horzsplit_n(inner, calls.count), ca.vertsplit_n(slopes, calls.count)
        through += [jacobian @ slope for jacobian, slope in zip(*blocks, strict=True)]
    return ca.vertcat(*results), ca.vertcat(*through)


@makes_scalars
def _slopes(calls: Calls) -> ca.Function:
    """Return the function ``(v, c) -> A [a, K], A_v``, with the rows of A_v call by call."""
    v, c = calls.arguments.sx_in()
    arguments = calls.arguments(v, c)
    slopes = ca.jacobian(ca.vec(arguments), v)
    return ca.Function("stage_slopes", [v, c], ca.cse([ca.densify(arguments), slopes]))


@makes_scalars
def _light_hessian(stage: Composition) -> tuple[ca.Function, ca.Function]:
    """Return the functions of weights and of light second derivatives.

    ``(v, c, w, lam, sigma) -> g_w``, and with the gradients p of all calls as additional input the
    second derivatives by v, by v and w, and by w.
    """
    v, c, w = stage.outer.sx_in()
    following, rows, cost = stage.outer(v, c, w)
    lam, sigma = ca.SX.sym("lam", following.shape[0] + rows.shape[0]), ca.SX.sym("sigma")
    arguments = ca.vertcat(*(ca.vec(calls.arguments(v, c)) for calls in stage.calls))
    gradients = ca.SX.sym("p", arguments.shape[0])
    lagrangian = sigma * cost + ca.dot(lam, ca.vertcat(-following, rows))
    inputs = [v, c, w, lam, sigma]
    by_w = ca.densify(ca.gradient(lagrangian, w))
    straight = ca.hessian(lagrangian + ca.dot(gradients, arguments), v)[0]
    outputs = [straight, ca.jacobian(by_w, v).T, ca.jacobian(by_w, w)]
    return (
        ca.Function("stage_weights", inputs, [by_w]),
        ca.Function("stage_light_hessian", [*inputs, gradients], ca.cse(outputs)),
    )


def _at_every_call(function: ca.Function, arguments: ca.MX, *more: ca.MX) -> list[ca.MX]:
    """Return outputs for every column of the arguments, side by side."""
    count = function.n_in() - len(more)
    edges = _edges([function.size1_in(k) for k in range(count)])
    parts = ca.vertsplit(arguments, edges)
    mapped: Any = function.map(arguments.shape[1])
    outputs = mapped(*parts, *more)
    return list(outputs) if isinstance(outputs, tuple) else [outputs]


@makes_scalars
def _derivatives_of(function: ca.Function) -> tuple[ca.Function, ca.Function]:
    inputs = function.sx_in()
    stacked, values = ca.vertcat(*inputs), ca.vertcat(*function.call(inputs))
    first = ca.cse([ca.densify(values), ca.jacobian(values, stacked)])
    weights = ca.SX.sym("weights", values.shape[0])
    hessian, gradient = ca.hessian(ca.dot(weights, values), stacked)
    second = ca.cse([ca.densify(gradient), hessian])
    return (
        ca.Function("first_derivatives", inputs, first),
        ca.Function("second_derivatives", [*inputs, weights], second),
    )
