"""Comparisons between expressions of CasADi, whose value is 0 or 1."""

from __future__ import annotations

import casadi as ca

ORDERS = (ca.OP_LE, ca.OP_LT)
RELATIONS = (*ORDERS, ca.OP_EQ, ca.OP_NE, ca.OP_NOT, ca.OP_AND, ca.OP_OR)


def is_relation(expression: ca.SX | ca.MX) -> bool:
    """Return whether the value of an expression (of SX, a scalar one) is that of a comparison."""
    return expression.op() in RELATIONS


def reason_of(problem: Exception) -> str:
    """Why a user's function has no expression: the last line, or how an if is written."""
    lines = str(problem).strip().splitlines() or [type(problem).__name__]
    if "truth value" in lines[-1]:  # CasADi, of a symbol
        return "it asks whether a symbol is true: write casadi.if_else(condition, a, b) for if"
    return lines[-1]
