"""Comparisons of CasADi expressions, whose value is 0 or 1, and operations that symbols lack."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, NoReturn

import casadi as ca

from microbot_ocp._base.checks import InputError, shortened, shown

IF = "write casadi.if_else(condition, a, b) for if"
TABLES = "casadi.interpolant is a table of the time or a state"
ORDERS = (ca.OP_LE, ca.OP_LT)
RELATIONS = (*ORDERS, ca.OP_EQ, ca.OP_NE, ca.OP_NOT, ca.OP_AND, ca.OP_OR)


def is_relation(expression: ca.SX | ca.MX) -> bool:
    """Return True if an expression (a scalar one for SX) is a comparison."""
    return expression.op() in RELATIONS


def reason_of(problem: Exception) -> str:
    """Return the reason why a user's function gives no expression: its error, or advice on if."""
    lines = str(problem).strip().splitlines() or [type(problem).__name__]
    if "truth value" in lines[-1]:  # CasADi's message about a symbol in a condition
        return f"it asks whether a symbol is true: {IF}"
    return lines[-1]


# CasADi warns once about numpy functions of its symbols; a user of this package cannot avoid it.
warnings.filterwarnings("ignore", r"\s*casadi: a numpy function was called", FutureWarning)


class Symbol(ca.MX):
    """A CasADi symbol whose errors name the CasADi function to use where Python needs a number.

    The results of its operators are Symbols, those of CasADi's functions are not.
    """

    def __bool__(self) -> NoReturn:
        raise InputError(f"{self} is no truth value before it is solved for: {IF}, fmax for max")

    def __float__(self) -> NoReturn:
        raise InputError(
            f"{self} is no number before it is solved for: write casadi.sin for math.sin"
        )

    def __index__(self) -> NoReturn:
        raise InputError(
            f"{self} is no index before it is solved for: {TABLES}, and a sum of casadi.if_else "
            "steps where it is to jump"
        )

    @property
    def T(self) -> Symbol:  # CasADi's name
        """Transpose."""
        return Symbol(ca.transpose(self))

    def __array_function__(self, func: Any, types: Any, args: Any, kwargs: Any) -> Any:
        try:
            # CasADi tests for the exact class, which a Symbol is not.
            return super().__array_function__(func, (ca.MX,), args, kwargs)
        except (RuntimeError, NotImplementedError) as refused:
            line = str(refused).strip().splitlines()[-1].strip()
            raise InputError(
                f"numpy's {func.__name__} takes no such symbols ({shortened(line, 150)}): write "
                "a.T @ b, casadi.dot(a, b), casadi.vertcat(a, b)"
            ) from None


def _operator(name: str) -> Callable[..., Any]:
    """Return an operator of CasADi whose result is a Symbol."""
    plain = getattr(ca.MX, name)

    def operator(self: Symbol, *others: Any) -> Any:
        result = plain(self, *others)
        if result is NotImplemented and isinstance(others[0], ca.SX):
            raise InputError(
                f"{self} is of casadi.MX, {shown(others[0])} of casadi.SX, which do not mix: "
                "declare parameters of the problem, or call a casadi.Function of SX"
            )
        return Symbol(result) if isinstance(result, ca.MX) else result

    return operator


_ARITHMETIC = ("add", "sub", "mul", "truediv", "floordiv", "mod", "pow", "matmul")
_REVERSED = tuple(f"r{_name}" for _name in _ARITHMETIC)
for _name in (*_ARITHMETIC, *_REVERSED, "neg", "getitem", "lt", "le", "gt", "ge", "eq", "ne"):
    setattr(Symbol, f"__{_name}__", _operator(f"__{_name}__"))


def _junction(sign: str, join: Callable[..., ca.MX]) -> Callable[..., Symbol]:
    """Return a logical operator that joins two relations."""

    def operator(*relations: Any) -> Symbol:
        if not all(isinstance(each, ca.MX) and is_relation(each) for each in relations):
            raise InputError(
                f"{sign} joins relations, each in brackets, as (0 <= x) {sign} (x <= 1); a power "
                "is written **"
            )
        return Symbol(join(*relations))

    return operator


_JUNCTIONS = {"&": ca.logic_and, "|": ca.logic_or, "^": ca.MX.__ne__, "~": ca.logic_not}
for _sign, _name in (("&", "and"), ("|", "or"), ("^", "xor"), ("~", "invert")):
    for _prefix in ("", *("r" * (_sign != "~"))):
        setattr(Symbol, f"__{_prefix}{_name}__", _junction(_sign, _JUNCTIONS[_sign]))
