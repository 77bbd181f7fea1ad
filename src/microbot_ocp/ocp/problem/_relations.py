"""Relations between expressions, ``v <= 0.5`` or ``0 <= (x <= 1)``, as rows with bounds.

CasADi evaluates a relation to 0 or 1. As a row of a program that is a step without a slope, so a
relation is taken apart here, before it gets there, and refused wherever its value would be used.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base.checks import FloatArray, InputError, shown
from microbot_ocp._base.relations import ORDERS, RELATIONS, is_relation
from microbot_ocp.ocp.problem._items import Bound, converted, moving, ordered


class BoundedRow(NamedTuple):
    """``lower <= expression <= upper``, each [size]."""

    name: str
    expression: ca.MX
    lower: FloatArray
    upper: FloatArray


def bounded_rows(
    name: str, given: Any, lower: ArrayLike, upper: ArrayLike, unit: str
) -> list[BoundedRow]:
    """Return the rows that a constraint demands: of an expression with bounds, or of a relation.

    Raises
    ------
    InputError
        Neither bounds nor a relation, or both, or a relation that no row expresses.
    """
    expression = converted(given)
    low, high = ordered(name, lower, upper, expression.shape[0], unit)
    bare = bool(np.isneginf(low).all() and np.isposinf(high).all())
    if not is_relation(expression):
        if bare:
            raise InputError(
                f"constraint {name!r} has no bounds: give lower, upper, or a relation such as "
                "x <= 1, 0 <= (x <= 1) or x == y"
            )
        refuse_steps(f"constraint {name!r}", expression)
        return [BoundedRow(name, expression, low, high)]
    if not bare:
        raise InputError(f"constraint {name!r} is a relation and has bounds as well: give one")
    rows = list(_rows_of(name, expression, unit))
    if len(rows) == 1:
        return rows
    return [row._replace(name=f"{name} ({k})") for k, row in enumerate(rows, 1)]


def sides(given: Bound) -> Iterator[tuple[str, ca.MX, float, float]]:
    """What a condition by expressions compares with, and the bounds of the difference."""
    if not moving(given):
        return
    given_sides: tuple[Any, ...] = given if isinstance(given, tuple) else (given,)
    bounds = ((" (lower)", 0.0, np.inf), (" (upper)", -np.inf, 0.0))
    for base, (side, low, high) in zip(
        given_sides, bounds if len(given_sides) > 1 else (("", 0.0, 0.0),), strict=True
    ):
        if isinstance(base, ca.MX) or np.isfinite(base).all():
            yield side, ca.MX(base), low, high


def as_expression(value: Any, name: str = "expression") -> ca.MX:
    """Return an expression of CasADi from one, or from numbers; refuse a relation.

    Raises
    ------
    InputError
        It is neither, or empty, or a relation.
    """
    expression = converted(value)
    if is_relation(expression):
        raise InputError(
            f"{name} must be a value, but {expression} is a relation: relations are constraints; "
            "where 1 or 0 is meant, write ca.if_else(condition, 1, 0)"
        )
    return expression


def refuse_steps(label: str, expression: ca.MX) -> None:
    """Raise InputError where a component, or a term of one, only steps where something compares."""
    for row in ca.vertsplit(expression) if _compares(expression) else ():
        # one branch of ca.if_else may be constant, but not both
        parts = [term for term in _terms(row) if term.op() != ca.OP_IF_ELSE_ZERO]
        for part in (row, *parts):
            symbols = ca.vertcat(*ca.symvar(part))
            if _compares(part) and ca.jacobian(part, symbols).is_zero():
                raise InputError(
                    f"{label} holds the value of a comparison, {shown(str(part))}: it is constant "
                    "on either side, so no solver can act on it; a relation is a constraint of "
                    "its own"
                )


def _compares(expression: ca.MX) -> bool:
    graph = ca.Function("expression", ca.symvar(expression), [expression])
    return any(graph.instruction_id(k) in RELATIONS for k in range(graph.n_instructions()))


def _terms(sum_of_terms: ca.MX) -> list[ca.MX]:
    if sum_of_terms.op() not in (ca.OP_ADD, ca.OP_SUB, ca.OP_NEG):
        return [sum_of_terms]
    return [t for k in range(sum_of_terms.n_dep()) for t in _terms(sum_of_terms.dep(k))]


def _rows_of(name: str, relation: ca.MX, unit: str) -> Iterator[BoundedRow]:
    if relation.op() == ca.OP_AND:
        for k in range(relation.n_dep()):
            yield from _rows_of(name, relation.dep(k), unit)
        return
    equal = relation.op() == ca.OP_EQ
    if not equal and relation.op() not in ORDERS:  # < is <=: the solvers know closed ranges only
        raise InputError(
            f"constraint {name!r} cannot be {relation}: a constraint is made of <=, >= and =="
        )
    sides = [relation.dep(0), relation.dep(1)] if equal else _chain(relation)
    for side in sides:
        if is_relation(side):
            raise InputError(f"constraint {name!r} compares a relation, {side}, with something")
    size = max(side.shape[0] for side in sides)

    def row(side: ca.MX, lower: ArrayLike, upper: ArrayLike) -> BoundedRow:
        column = side if side.shape[0] == size else ca.repmat(side, size, 1)
        return BoundedRow(name, column, *ordered(name, lower, upper, size, unit))

    numbers = [None if ca.symvar(side) else np.array(ca.evalf(side)).ravel() for side in sides]
    if len(sides) == 3 and numbers[0] is not None and numbers[2] is not None:
        yield row(sides[1], numbers[0] * np.ones(size), numbers[2] * np.ones(size))
        return
    for (first, low), (second, high) in itertools.pairwise(zip(sides, numbers, strict=True)):
        if high is not None:
            yield row(first, high * np.ones(size) if equal else -np.inf, high * np.ones(size))
        elif low is not None:
            yield row(second, low * np.ones(size), low * np.ones(size) if equal else np.inf)
        else:
            yield row(first - second, 0.0 if equal else -np.inf, 0.0)


def _chain(relation: ca.MX) -> list[ca.MX]:
    """Return the sides of ``a <= b <= c`` in order, however it is nested."""
    if relation.op() not in ORDERS:
        return [relation]
    return [*_chain(relation.dep(0)), *_chain(relation.dep(1))]
