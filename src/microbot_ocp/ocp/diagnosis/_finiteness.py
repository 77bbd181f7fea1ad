"""Where the expressions of a problem are not finite: which, where, and by which variable."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.ocp.problem import Expressions, Phase
from microbot_ocp.ocp.solution import PhaseSolution, unpack
from microbot_ocp.ocp.transcription import Program

PUSH = 1e-2  # how far solvers move a guess off its bounds, as a share of their size or distance
BESIDE = 1e-2  # of the scales: how far a start is moved from kinks and symmetry
GOLDEN = (np.sqrt(5) - 1) / 2


@dataclass(frozen=True, eq=False)
class _Term:
    """An expression of a phase with the name that its user knows it by."""

    label: str
    expression: ca.MX
    at_end: bool = False


_TERMS = {  # lists of a phase with what their items are called
    "constraints": "constraint {!r}",
    "algebraic_equations": "an algebraic equation",
    "running_costs": "a running cost",
    "point_costs": "a point cost",
    "point_constraints": "point constraint {!r}",
    "end_constraints": "end constraint {!r}",
    "end_costs": "an end cost",
}


class NotFinite(InputError):
    """A start at which something has no finite value or slope."""


def finite_start(program: Program, x: FloatArray, *, uneven: bool = False) -> FloatArray:
    """Return the start, moved a little where it is at a kink, such as the norm of controls that are
    zero.

    It is looked at where a solver will: a little inside its bounds. With ``uneven`` it is moved
    wherever it is: from a start that is symmetric a solver does not leave what is symmetric, for
    all slopes lie in it, and ends at a saddle or among equations that depend on each other.

    Raises
    ------
    NotFinite
        The user's expressions are not finite there, or their slopes neither there nor beside it.
        Names the expression, the place and the variable that it comes from.
    """
    inside = _inside(program, x)
    complaint = not_finite(program, inside, "the guess")
    if complaint is None and not uneven:
        return x
    if complaint is None or _has_values(program, inside):
        free = (program.variable_lower < program.variable_upper) & ~_held(program, inside)
        shares = 0.5 + GOLDEN * np.arange(x.size) % 1.0  # differences of variables are no longer 0
        beside = _inside(program, x + BESIDE * np.where(free, shares, 0.0))
        if not_finite(program, beside, "the guess") is None:
            return beside
    if complaint is None:
        return x
    raise NotFinite(complaint)


def _held(program: Program, x: FloatArray) -> np.ndarray:
    """Return variables that a condition at an end leaves no choice."""
    equal = program.row_lower == program.row_upper
    ends = np.array([label.kind in ("initial", "final") for label in program.row_labels], bool)
    _, jacobian = program.functions["jacobian"](x, program.parameters)
    row, column = (np.array(k) for k in jacobian.sparsity().get_triplet())
    held = np.zeros(x.size, bool)
    held[column[(equal & ends)[row]]] = True
    return held


def _has_values(program: Program, x: FloatArray) -> bool:
    """Return whether the cost and all rows are finite, whatever their slopes."""
    f, _ = program.functions["gradient"](x, program.parameters)
    g, _ = program.functions["jacobian"](x, program.parameters)
    return bool(np.isfinite(f.nonzeros()).all() and np.isfinite(g.nonzeros()).all())


def not_finite(program: Program, x: FloatArray, where: str) -> str | None:
    """Return the first expression that has no finite value or slope at x; None where all have one.

    Parameters
    ----------
    program : Program
    x : scaled variables
    where : what x is, for the message
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
    """Return where the dynamics have no finite value or slope along a phase; empty where they
    have.

    A state that is zero but for rounding counts as zero.
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
            np.minimum(PUSH * np.maximum(1.0, np.abs(bound)), PUSH * width) for bound in (low, high)
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
        what = "slope" if slopes else "value"
        place = "at its end" if term.at_end else f"in interval {intervals[column] + 1}"
        bad = result[~np.isfinite(result)][0]
        return (
            f"the {what} of {term.label} of phase {values.name!r} is {bad:g} at {where} {place} "
            f"(t = {times[column]:.4g} s): {_cause(function, symbols, point)}"
        )
    return None


def _points(
    values: PhaseSolution, *, at_end: bool
) -> tuple[list[tuple[str, ca.MX]], list[FloatArray], FloatArray, np.ndarray]:
    """Return symbols of a phase, their values [size, M], times and intervals of some points."""
    phase, h = values.laid_out.phase, np.diff(values.mesh)
    fractions = np.array([1.0]) if at_end else np.array([0.0, 0.25, 0.5, 0.75, 1.0])
    intervals = np.arange(h.size)[-1:] if at_end else np.arange(h.size)
    k = np.repeat(intervals, fractions.size)
    share = np.tile(fractions, intervals.size)
    states = {name: table.T for name, table in _interpolated(values, k, share).items()}
    rates = {
        c.name: (np.diff(values[c.name], axis=0).T / (h * values.duration))[:, k]
        for c in phase.controls
        if c.rate is not None
    }
    data = [np.tile(m.value.mean(axis=0)[:, None], (1, k.size)) for m in phase.measurements]
    times = (values.mesh[k] + share * h[k]) * values.duration
    expressions = Expressions(phase, phase.measurements)
    tables = expressions.tables(states, times, values.duration, rates, data)
    return expressions.inputs, tables, times, k


def _interpolated(values: PhaseSolution, k: np.ndarray, share: FloatArray) -> dict[str, FloatArray]:
    """Return values at fractions of intervals; states at mesh points as they are guessed."""
    layout = values.laid_out
    assert values.stages is not None
    tables = layout.interpolated(values.stages, k, share)
    # inside an interval the state follows from the dynamics, which may be what is wrong
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


def _cause(
    function: ca.Function, symbols: Sequence[tuple[str, ca.MX]], point: Sequence[FloatArray]
) -> str:
    """Return the first operation that leaves the finite numbers, and the variables behind it."""
    try:
        scalar = function.expand()
    except RuntimeError:  # calls that have no scalar graph
        used = [
            _entry(name, values, i)
            for k, ((name, _), values) in enumerate(zip(symbols, point, strict=True))
            for i in range(values.size)
            if function.which_depends(function.name_in(k), function.name_out())[i]
        ]
        return "it depends on " + ", ".join(used)
    work: dict[int, float] = {}
    sources: dict[int, frozenset[tuple[int, int]]] = {}
    for k in range(scalar.n_instructions()):
        operation = scalar.instruction_id(k)
        inputs, outputs = scalar.instruction_input(k), scalar.instruction_output(k)
        if operation == ca.OP_INPUT:
            work[outputs[0]] = float(point[inputs[0]][inputs[1]])
            sources[outputs[0]] = frozenset({(inputs[0], inputs[1])})
        elif operation == ca.OP_CONST:
            work[outputs[0]] = scalar.instruction_constant(k)
            sources[outputs[0]] = frozenset()
        elif operation != ca.OP_OUTPUT:
            a, b = (work[i] for i in (inputs[0], inputs[-1]))
            value = _apply(operation, a, b)
            behind = frozenset().union(*(sources[i] for i in inputs))
            if not np.isfinite(value) and np.isfinite(a) and np.isfinite(b):
                operand = _OPERATIONS.get(operation, lambda a, b: f"an operation on {a:.4g}")(a, b)
                used = [_entry(symbols[i][0], point[i], j) for i, j in sorted(behind)]
                divisor = sources[inputs[-1]] if operation in (ca.OP_DIV, ca.OP_INV) else ()
                names = " and ".join(sorted({symbols[i][0] for i, _ in divisor}))
                divides = f"; it divides by {names}" if names else ""
                return operand + (f", from {', '.join(used)}" if used else "") + divides
            work[outputs[0]], sources[outputs[0]] = value, behind
    return "a parameter or variable is not finite"


def _apply(operation: int, a: float, b: float) -> float:
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    result = ca.SX.binary(operation, x, y)  # of unary operations too, without their second input
    return float(ca.Function("one", [x, y], [result])(a, b))


def _entry(name: str, values: FloatArray, index: int) -> str:
    label = name if values.size == 1 else f"{name}[{index}]"
    return f"{label} = {values[index]:.4g}"
