"""Detection of expressions without finite value or slope: which one, where, and its cause."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.threads import makes_scalars
from microbot_ocp.ocp.problem import Expressions, Phase, as_scalars, operations
from microbot_ocp.ocp.solution import PhaseSolution, unpack
from microbot_ocp.ocp.transcription import Program

# Displacement of a start off kinks and symmetry, in units of the scales, and off its bounds as
# solvers move it, relative to bound or range.
START_OFFSET = 1e-2
GOLDEN = (np.sqrt(5) - 1) / 2


@dataclass(frozen=True, eq=False)
class _Term:
    """An expression of a phase and its name in messages."""

    label: str
    expression: ca.MX
    at_end: bool = False


_TERMS = {  # lists of a phase and the names of their items in messages
    "constraints": "constraint {!r}",
    "algebraic_equations": "an algebraic equation",
    "running_costs": "a running cost",
    "point_costs": "a point cost",
    "point_constraints": "point constraint {!r}",
    "end_constraints": "end constraint {!r}",
    "end_costs": "an end cost",
}


class NotFinite(InputError):
    """Start at which an expression has no finite value or slope."""


def finite_start(program: Program, x: FloatArray, *, uneven: bool = False) -> FloatArray:
    """Return the start, displaced slightly if it is at a kink, such as the norm of zero controls.

    The start is evaluated slightly inside its bounds, where a solver starts. With ``uneven`` it is
    always displaced: at a symmetric start all slopes are symmetric, so that a solver stays among
    symmetric points and ends at a saddle or among linearly dependent equations.

    Raises
    ------
    NotFinite
        Expressions are not finite there, or their slopes neither there nor at the displaced start.
        The message names the expression, its place and the variable that causes it.
    """
    inside = _inside(program, x)
    complaint = not_finite(program, inside, "the guess")
    if complaint is None and not uneven:
        return x
    # A slope alone may be infinite at a kink.
    if np.isfinite([program.cost(inside), *program.row_values(inside)]).all():
        free = (program.variable_lower < program.variable_upper) & ~_held(program, inside)
        beside = _inside(program, x + START_OFFSET * np.where(free, all_different(x.size), 0.0))
        if not_finite(program, beside, "the guess") is None:
            return beside
    if complaint is None:
        return x
    raise NotFinite(complaint)


def all_different(size: int) -> FloatArray:
    """Return numbers from 0.5 to 1.5, of which no two are equal: no difference stays zero."""
    return 0.5 + GOLDEN * np.arange(size) % 1.0


def _held(program: Program, x: FloatArray) -> np.ndarray:
    """Return a mask of the variables that an end condition determines."""
    equal = program.row_lower == program.row_upper
    ends = np.array([label.kind in ("initial", "final") for label in program.row_labels], bool)
    _, jacobian = program.functions["jacobian"](x, program.parameters)
    row, column = (np.array(k) for k in jacobian.sparsity().get_triplet())
    held = np.zeros(x.size, bool)
    held[column[(equal & ends)[row]]] = True
    return held


def not_finite(program: Program, x: FloatArray, where: str) -> str | None:
    """Return a sentence on the first expression that is not finite at x; None if there is none.

    Both values and slopes are checked.

    Parameters
    ----------
    program : Program
    x : scaled variables
    where : name of the point x in the message
    """
    parts = program.cost(x), *program.slopes(x)
    if all(np.isfinite(value).all() for value in parts):
        return None
    g, jacobian = program.functions["jacobian"](x, program.parameters)
    for slopes in (False, True):
        for phase in unpack(program.layouts, x):
            for term in _terms(phase.laid_out.phase):
                complaint = _complaint(phase, term, slopes, where)
                if complaint is not None:
                    return complaint
    bad = ~np.isfinite(np.array(g).ravel())
    entries = np.array(jacobian.sparsity().row())[~np.isfinite(np.array(jacobian.nonzeros()))]
    bad[entries] = True
    row = f": {program.row_labels[int(np.argmax(bad))]}" if bad.any() else ""
    return f"{where} gives values that are not finite between mesh points{row}"


def singular(phase: PhaseSolution) -> str:
    """Return a sentence on dynamics with infinite value or slope along a phase; empty if none.

    A state within rounding of zero counts as zero.
    """
    rounding = np.sqrt(np.finfo(float).eps)
    values = {
        name: np.where(np.abs(table) <= rounding * np.abs(table).max(), 0.0, table)
        for name, table in phase.values.items()
    }
    phase = replace(phase, values=values)
    terms = [term for term in _terms(phase.laid_out.phase) if term.label.startswith("the dynamics")]
    found = (_complaint(phase, term, k, "the solution") for k in (False, True) for term in terms)
    return next(filter(None, found), "")


def _inside(program: Program, x: FloatArray) -> FloatArray:
    low, high = program.variable_lower, program.variable_upper
    width = np.where(np.isfinite(high - low), high - low, np.inf)
    with np.errstate(invalid="ignore"):
        below, above = (
            START_OFFSET * np.minimum(np.maximum(1.0, np.abs(bound)), width)
            for bound in (low, high)
        )
        floor = np.where(np.isfinite(low), low + below, -np.inf)
        ceiling = np.where(np.isfinite(high), high - above, np.inf)
    return np.clip(x, floor, ceiling)


def _terms(phase: Phase) -> Iterator[_Term]:
    for name, expression in phase.derivatives.items():
        yield _Term(f"the dynamics of state {name!r}", expression)
    for kind, label in _TERMS.items():
        for item in getattr(phase, kind):
            named = getattr(item, "name", "")
            expression = item if isinstance(item, ca.MX) else item.expression
            yield _Term(label.format(named), expression, at_end=kind.startswith("end"))


def _complaint(values: PhaseSolution, term: _Term, slopes: bool, where: str) -> str | None:
    symbols, tables, times, intervals = _points(values, at_end=term.at_end)
    named = [symbol for _, symbol in symbols]
    expression = term.expression
    if slopes:
        expression = ca.jacobian(expression, ca.vertcat(*named))
    function = ca.Function("term", named, [ca.densify(expression)], {"allow_free": True})
    for column in range(times.size):
        point = [table[:, column] for table in tables]
        result = np.array(function(*point))
        if np.isfinite(result).all():
            continue
        kind = "slope" if slopes else "value"
        place = "at its end" if term.at_end else f"in interval {intervals[column] + 1}"
        bad = result[~np.isfinite(result)][0]
        return (
            f"the {kind} of {term.label} of phase {values.name!r} is {bad:g} at {where} {place} "
            f"(t = {times[column]:.4g} s): {_cause(function, symbols, point)}"
        )
    return None


def _points(
    values: PhaseSolution, *, at_end: bool
) -> tuple[list[tuple[str, ca.MX]], list[FloatArray], FloatArray, np.ndarray]:
    """Return symbols of a phase, values [size, M], times and intervals of its sample points."""
    phase = values.laid_out.phase
    k, share, times = values.points(np.linspace(0.0, 1.0, 5))
    if at_end:
        k, share, times = k[-1:], share[-1:], times[-1:]
    states = {name: table.T for name, table in _interpolated(values, k, share).items()}
    data = [np.tile(m.value.mean(axis=0)[:, None], (1, k.size)) for m in phase.measurements]
    expressions = Expressions(phase, phase.measurements)
    tables = expressions.tables(states, times, values.duration, values.rates(k), data)
    return expressions.inputs, tables, times, k


def _interpolated(values: PhaseSolution, k: np.ndarray, share: FloatArray) -> dict[str, FloatArray]:
    """Return values at fractions of intervals, with states at mesh points as guessed."""
    layout = values.laid_out
    assert values.stages is not None
    tables = layout.interpolated(values.stages, k, share)
    # States inside an interval follow from the dynamics, which may be the invalid expressions:
    # use straight lines in that case.
    states = layout.phase.states
    bad = ~np.isfinite(np.hstack([tables[v.name] for v in states])).all(axis=1)
    bad |= (share == 0.0) | (share == 1.0)
    for name in (v.name for v in states):
        start, end = values[name][k], values[name][k + 1]
        straight = start + share[:, None] * (end - start)
        tables[name] = np.where(bad[:, None], straight, tables[name])
    return tables


_OPERATIONS: dict[int, Callable[[float, float], str]] = {
    ca.OP_SQRT: lambda a, _: f"the square root of {a:.4g}",
    ca.OP_LOG: lambda a, _: f"the logarithm of {a:.4g}",
    ca.OP_DIV: lambda a, b: f"{a:.4g} divided by {b:.4g}",
    ca.OP_INV: lambda a, _: f"1 divided by {a:.4g}",
    ca.OP_POW: lambda a, b: f"{a:.4g} to the power {b:.4g}",
    ca.OP_CONSTPOW: lambda a, b: f"{a:.4g} to the power {b:.4g}",
    ca.OP_ASIN: lambda a, _: f"the arcsine of {a:.4g}",
    ca.OP_ACOS: lambda a, _: f"the arccosine of {a:.4g}",
    ca.OP_EXP: lambda a, _: f"the exponential of {a:.4g}",
    ca.OP_TAN: lambda a, _: f"the tangent of {a:.4g}",
    ca.OP_ATANH: lambda a, _: f"the inverse hyperbolic tangent of {a:.4g}",
    ca.OP_ACOSH: lambda a, _: f"the inverse hyperbolic cosine of {a:.4g}",
}


@makes_scalars
def _cause(
    function: ca.Function, symbols: Sequence[tuple[str, ca.MX]], point: Sequence[FloatArray]
) -> str:
    """Return the first operation with finite operands and infinite result, and its variables."""
    scalar = as_scalars(function)
    entries = [  # input, index, name and text of every variable
        (k, i, name, f"{name if values.size == 1 else f'{name}[{i}]'} = {values[i]:.4g}")
        for k, ((name, _), values) in enumerate(zip(symbols, point, strict=True))
        for i in range(values.size)
    ]
    if not scalar.is_a("SXFunction"):
        depends = [function.which_depends(n, function.name_out()) for n in function.name_in()]
        return "it depends on " + ", ".join(text for k, i, _, text in entries if depends[k][i])
    given = [ca.SX.sym("given", values.size) for values in point]
    steps = list(operations(scalar, given))
    run = ca.Function("steps", given, [ca.vertcat(*terms) for _, *terms in steps])
    for (operation, *operands, _), numbers in zip(steps, run.call(list(point)), strict=True):
        a, b, value = numbers.full().ravel().tolist()
        if np.isfinite([a, b]).all() and not np.isfinite(value):
            both, divides = ca.vertcat(*operands), operation in (ca.OP_DIV, ca.OP_INV)
            used = ", ".join(text for k, i, _, text in entries if ca.depends_on(both, given[k][i]))
            below = {n for k, i, n, _ in entries if ca.depends_on(operands[-1], given[k][i])}
            operand = _OPERATIONS.get(operation, lambda a, b: f"an operation on {a:.4g}")(a, b)
            divisor = f"; it divides by {' and '.join(sorted(below))}" if divides and below else ""
            return operand + (f", from {used}" if used else "") + divisor
    return "a parameter or variable is not finite"
