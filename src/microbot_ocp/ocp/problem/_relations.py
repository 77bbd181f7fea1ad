"""Relations between expressions, such as ``v <= 0.5`` or ``0 <= (x <= 1)``, as rows with bounds.

CasADi evaluates a relation to 0 or 1, a step function with zero derivative that no solver can use.
Relations are therefore converted to bounds here, and rejected wherever their value would be used.
"""

from __future__ import annotations

import itertools
from collections.abc import Container, Iterator
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base.checks import FloatArray, InputError, shown
from microbot_ocp._base.relations import ORDERS, RELATIONS, TABLES, is_relation
from microbot_ocp.ocp.problem._items import Bound, PathConstraint, converted, limit_of, moving


def declared_limits(
    name: str, given: Any, lower: ArrayLike, upper: ArrayLike, scale: ArrayLike | None, unit: str
) -> list[PathConstraint]:
    """Return the limits that a constraint sets, either by bounds or by a relation.

    Raises
    ------
    InputError
        The constraint has neither bounds nor a relation, or both, or a relation that cannot be
        written as rows with bounds.
    """
    expression = converted(given)
    related = is_relation(expression)
    limit = limit_of(name, expression, lower, upper, None if related else scale, unit)
    bare = bool(np.isneginf(limit.lower).all() and np.isposinf(limit.upper).all())
    if not related:
        if bare:
            raise InputError(
                f"constraint {name!r} has no bounds: give lower, upper, or a relation such as "
                "x <= 1, 0 <= (x <= 1) or x == y"
            )
        refuse_steps(f"constraint {name!r}", limit.expression)
        return [limit]
    if not bare:
        raise InputError(f"constraint {name!r} is a relation and has bounds as well: give one")
    limits = list(_limits_of(name, expression, scale, unit))
    if len(limits) == 1:
        return limits
    return [replace(limit, name=f"{name} ({k})") for k, limit in enumerate(limits, 1)]


def sides(given: Bound) -> Iterator[tuple[str, ca.MX, float, float]]:
    """Yield label, expression and bounds of the difference for each side of a condition."""
    if not moving(given):
        return
    bases: tuple[Any, ...] = given if isinstance(given, tuple) else (given,)
    pair = ((" (lower)", 0.0, np.inf), (" (upper)", -np.inf, 0.0))
    bounds = pair if len(bases) > 1 else (("", 0.0, 0.0),)
    for base, (side, low, high) in zip(bases, bounds, strict=True):
        if isinstance(base, ca.MX) or np.isfinite(base).all():
            yield side, ca.MX(base), low, high


def as_expression(value: Any, name: str = "expression") -> ca.MX:
    """Return a CasADi expression from an expression or numbers; reject a relation.

    Raises
    ------
    InputError
        The value is neither an expression nor numbers, or is empty, or is a relation.
    """
    expression = converted(value)
    if is_relation(expression):
        raise InputError(
            f"{name} must be a value, but {expression} is a relation: relations are constraints; "
            "for the value 1 or 0, write ca.if_else(condition, 1, 0)"
        )
    return expression


def refuse_steps(label: str, expression: ca.MX) -> None:
    """Raise InputError if a component, or a term of one, is piecewise constant."""
    for row in ca.vertsplit(expression) if _has(expression, RELATIONS) else ():
        # One branch of ca.if_else may be constant: a product with 0 or 1 is no term of its own.
        parts = [term for term in _terms(row) if term.op() != ca.OP_IF_ELSE_ZERO]
        for part in (row, *parts):
            symbols = ca.vertcat(*ca.symvar(part))
            if _has(part, RELATIONS) and ca.jacobian(part, symbols).is_zero():
                raise InputError(
                    f"{label} contains the value of a comparison, {shown(str(part))}: its "
                    "derivative is zero, so no solver can change it; declare the relation as a "
                    "constraint of its own"
                )


def refuse_indices(label: str, expression: ca.MX) -> None:
    """Raise InputError if an expression indexes entries by the value of an expression."""
    whole = _graph(expression)
    for graph in (k for k in (whole, *whole.find_functions()) if k.is_a("MXFunction")):
        for k in range(graph.n_instructions()):
            if graph.instruction_id(k) != ca.OP_GETNONZEROS_PARAM:
                continue
            entry = graph.instruction_MX(k)
            places = ca.vertcat(*(ca.vec(entry.dep(j)) for j in range(1, entry.n_dep())))
            symbols = ca.symvar(places)
            # CasADi's linear interpolation also indexes by value (OP_LOW) but is continuous.
            if symbols and not _has(places, (ca.OP_LOW,)):
                raise InputError(
                    f"{label} takes an entry of {shown(str(entry.dep(0)))} by the value of "
                    f"{', '.join(s.name() for s in symbols)}, which has no derivative: {TABLES}"
                )


def _graph(expression: ca.MX) -> ca.Function:
    return ca.Function("expression", ca.symvar(expression), [expression])


def _has(expression: ca.MX, operations: Container[int]) -> bool:
    graph = _graph(expression)
    return any(graph.instruction_id(k) in operations for k in range(graph.n_instructions()))


def _terms(sum_of_terms: ca.MX) -> list[ca.MX]:
    if sum_of_terms.op() not in (ca.OP_ADD, ca.OP_SUB, ca.OP_NEG):
        return [sum_of_terms]
    return [t for k in range(sum_of_terms.n_dep()) for t in _terms(sum_of_terms.dep(k))]


def _limits_of(
    name: str, relation: ca.MX, scale: ArrayLike | None, unit: str
) -> Iterator[PathConstraint]:
    if relation.op() == ca.OP_AND:
        for k in range(relation.n_dep()):
            yield from _limits_of(name, relation.dep(k), scale, unit)
        return
    equal, sides = relation.op() == ca.OP_EQ, _sides_of(name, relation)
    size = max(side.shape[0] for side in sides)

    def limit(side: ca.MX, lower: ArrayLike, upper: ArrayLike) -> PathConstraint:
        column = side if side.shape[0] == size else ca.repmat(side, size, 1)
        return limit_of(name, column, lower, upper, scale, unit)

    numbers = [_number(side, size) for side in sides]
    if len(sides) == 3 and numbers[0] is not None and numbers[2] is not None:
        yield limit(sides[1], numbers[0], numbers[2])
        return
    for (first, low), (second, high) in itertools.pairwise(zip(sides, numbers, strict=True)):
        if high is not None:
            yield limit(first, high if equal else -np.inf, high)
        elif low is not None:
            yield limit(second, low, low if equal else np.inf)
        else:
            yield limit(first - second, 0.0 if equal else -np.inf, 0.0)


def _sides_of(name: str, relation: ca.MX) -> list[ca.MX]:
    """Return the sides of an equation or of a chain of inequalities in order, as columns."""
    equal = relation.op() == ca.OP_EQ
    if not equal and relation.op() not in ORDERS:  # < is treated as <=: feasible sets are closed
        raise InputError(
            f"constraint {name!r} cannot be {relation}: a constraint is made of <=, >= and =="
        )
    sides = [relation.dep(0), relation.dep(1)] if equal else _chain(relation)
    for side in sides:
        if is_relation(side):
            raise InputError(f"constraint {name!r} compares a relation, {side}, with something")
    return [ca.vec(side) for side in sides]


def _number(side: ca.MX, size: int) -> FloatArray | None:
    """Return the value [size] of a side without symbols, else None."""
    return None if ca.symvar(side) else np.array(ca.evalf(side)).ravel() * np.ones(size)


def _chain(relation: ca.MX) -> list[ca.MX]:
    """Return the sides of ``a <= b <= c`` in order, for either bracketing."""
    if relation.op() not in ORDERS:
        return [relation]
    return [*_chain(relation.dep(0)), *_chain(relation.dep(1))]
