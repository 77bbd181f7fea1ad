"""Coupling of phases: values at other places, free parameters, and copies of a phase.

A value at another place is a symbol. Every phase that uses it carries it as a free parameter, and
a point constraint where the value is taken defines it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import casadi as ca

from microbot_ocp._base.checks import InputError
from microbot_ocp.ocp.problem._items import (
    CONSTANTS,
    VARIABLES,
    PointConstraint,
    PointValue,
    Variable,
    limit_of,
    variable_of,
)
from microbot_ocp.ocp.problem._relations import as_expression

if TYPE_CHECKING:
    from microbot_ocp.ocp.problem._phase import Phase

_SYMBOLIC = (*VARIABLES, *CONSTANTS)  # lists of items that have a symbol


def value_of(phase: Phase, expression: ca.MX, fraction: float, where: str) -> ca.MX:
    """Return the symbol of the value of an expression at a fraction of a phase."""
    given = as_expression(expression)
    expression = owned(phase, ca.vec(given))
    for point in phase._values:
        if point.fraction == fraction and ca.is_equal(point.expression, expression, 9):
            return ca.reshape(point.symbol, given.shape)
    variable = next((v for v in phase.variables if ca.is_equal(v.symbol, expression)), None)
    if ca.is_equal(expression, phase.duration):
        label, unit = "duration", "s"
    elif variable is not None:
        label, unit = variable.name, variable.unit
    else:
        label, unit = f"value {len(phase._values) + 1}", ""
    name = f"{label} {where} {phase.name!r}"
    symbol = ca.MX.sym(name, expression.shape[0])
    phase._values.append(PointValue(name, symbol, expression, fraction, unit))
    return ca.reshape(symbol, given.shape)


def owned(phase: Phase, expression: ca.MX | float, at: float | None = None) -> ca.MX:
    """Return an expression whose foreign symbols are free parameters of the phase.

    Point values taken at the fraction ``at``, where the expression itself is evaluated, are
    replaced by their expressions.
    """
    expression = as_expression(expression)
    if phase.problem is None:
        return expression
    for symbol in ca.symvar(expression):
        for other in phase.problem.phases:
            if other is not phase and ca.is_equal(symbol, other.duration):
                fixed = other.duration_bounds[0] == other.duration_bounds[1]
                value = ca.MX(other.duration_bounds[0]) if fixed else other.final(symbol)
                return owned(phase, ca.substitute(expression, symbol, value), at)
            for value in other._values:
                if ca.is_equal(symbol, value.symbol):
                    if other is phase and value.fraction == at:
                        replaced = ca.substitute(expression, symbol, value.expression)
                        return owned(phase, replaced, at)
                    _define_point_value(other, value)
                    _share_free_parameter(phase, other, symbol)
        for free in phase.problem.free_parameters:
            if ca.is_equal(symbol, free.symbol):
                holder = next((p for p in phase.problem.phases if free in p.free_parameters), phase)
                if holder is phase:
                    _add_free(phase, free)
                _share_free_parameter(phase, holder, symbol)
    return expression


def _define_point_value(phase: Phase, value: PointValue) -> None:
    """Add a point value to the free parameters of the phase, and the constraint defining it."""
    if value.name in {v.name for v in phase.free_parameters}:
        return
    free = limit_of(value.name, value.symbol, unit=value.unit)
    phase.free_parameters.append(variable_of(free, "parameter"))
    rest = value.expression - value.symbol
    demanded = limit_of(value.name, rest, 0.0, 0.0, unit=value.unit)
    phase.point_constraints.append(PointConstraint.of(demanded, value.fraction, value.name))


def _share_free_parameter(phase: Phase, owner: Phase, symbol: ca.MX) -> None:
    """Add a free parameter of another phase to this phase and to all phases between them."""
    assert phase.problem is not None
    phases = phase.problem.phases
    carried = next(v for v in owner.free_parameters if ca.is_equal(v.symbol, symbol))
    first, last = sorted((phases.index(owner), phases.index(phase)))
    for between in phases[first : last + 1]:
        _add_free(between, carried)


def _add_free(phase: Phase, parameter: Variable) -> None:
    by_name = {v.name: v for v in phase.variables}
    if parameter.name not in by_name:
        phase.free_parameters.append(parameter)
    elif not ca.is_equal(by_name[parameter.name].symbol, parameter.symbol):
        raise InputError(
            f"phase {phase.name!r} has a variable {parameter.name!r} of its own, and needs the "
            "free parameter of that name: call one of them something else"
        )


def renamed(expression: ca.MX, phase: Phase, copy: Phase) -> ca.MX:
    """Return an expression of one phase in the symbols of its copy."""

    def symbols(of: Phase) -> list[ca.MX]:
        items = (item for kind in _SYMBOLIC for item in getattr(of, kind))
        return [*(item.symbol for item in items), *of.rates.values(), of.time, of.duration]

    return ca.graph_substitute(ca.MX(expression), symbols(phase), symbols(copy))


def copied(phase: Phase, name: str, linked: Sequence[str]) -> Phase:
    """Return a copy with its own symbols; linked variables lose their initial conditions.

    Values from other phases and free parameters of the problem are shared with the copy.
    """
    duplicate = replace(phase, name=name, **{kind: [] for kind in _SYMBOLIC})
    defined = {c.defines for c in phase.point_constraints}

    def fresh(item: Any) -> Any:
        if item in phase.free_parameters and item.name not in defined:
            return item
        label = item.name.replace(repr(phase.name), repr(name))
        symbol = ca.MX.sym(f"{name}.{label}", item.symbol.shape[0])
        own = "expression" if isinstance(item, Variable) else "symbol"
        changes: dict[str, Any] = {"name": label, own: symbol}
        if getattr(item, "rate", None) is not None:
            changes["rate"] = ca.MX.sym(f"{name}.{label}.rate", item.size)
        if item.name in linked:
            changes["initial"] = None
        return replace(item, **changes)

    for kind in _SYMBOLIC:
        setattr(duplicate, kind, [fresh(item) for item in getattr(phase, kind)])
    renewed = partial(renamed, phase=phase, copy=duplicate)
    duplicate.derivatives = {k: renewed(e) for k, e in phase.derivatives.items()}
    for kind in ("algebraic_equations", "running_costs", "end_costs"):
        setattr(duplicate, kind, [renewed(e) for e in getattr(phase, kind)])
    for kind in ("constraints", "end_constraints", "point_constraints", "point_costs"):
        items = [replace(k, expression=renewed(k.expression)) for k in getattr(phase, kind)]
        setattr(duplicate, kind, items)
    duplicate.point_constraints = [
        replace(k, defines=k.defines.replace(repr(phase.name), repr(name)))
        for k in duplicate.point_constraints
    ]
    return duplicate
