"""Comparisons between expressions of CasADi, whose value is 0 or 1, and what no symbol has."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NoReturn

import casadi as ca

from microbot_ocp._base.checks import InputError

IF = "write casadi.if_else(condition, a, b) for if"
ORDERS = (ca.OP_LE, ca.OP_LT)
RELATIONS = (*ORDERS, ca.OP_EQ, ca.OP_NE, ca.OP_NOT, ca.OP_AND, ca.OP_OR)


def is_relation(expression: ca.SX | ca.MX) -> bool:
    """Return whether the value of an expression (of SX, a scalar one) is that of a comparison."""
    return expression.op() in RELATIONS


def reason_of(problem: Exception) -> str:
    """Return why a user's function has no expression: the last line, or how an if is written."""
    lines = str(problem).strip().splitlines() or [type(problem).__name__]
    if "truth value" in lines[-1]:  # CasADi, of a symbol
        return f"it asks whether a symbol is true: {IF}"
    return lines[-1]


class Symbol(ca.MX):
    """An expression that says what to write where Python asks for its number, which it has not.

    So do the results of its operators, but not those of CasADi's functions.
    """

    def __bool__(self) -> NoReturn:
        raise InputError(f"{self} is no truth value before it is solved for: {IF}, fmax for max")

    def __float__(self) -> NoReturn:
        raise InputError(
            f"{self} is no number before it is solved for: write casadi.sin for math.sin"
        )

    def __array_function__(self, func: Any, types: Any, args: Any, kwargs: Any) -> Any:
        return super().__array_function__(func, (ca.MX,), args, kwargs)  # it compares exact types


def _operator(name: str) -> Callable[..., Any]:
    """Return an operator of CasADi whose result is a Symbol, too."""
    plain = getattr(ca.MX, name)

    def operator(self: Symbol, *others: Any) -> Any:
        result = plain(self, *others)
        return Symbol(result) if isinstance(result, ca.MX) else result

    return operator


_ARITHMETIC = ("add", "sub", "mul", "truediv", "pow")
_REVERSED = tuple(f"r{_name}" for _name in _ARITHMETIC)
for _name in (*_ARITHMETIC, *_REVERSED, "neg", "getitem", "lt", "le", "gt", "ge", "eq", "ne"):
    setattr(Symbol, f"__{_name}__", _operator(f"__{_name}__"))
