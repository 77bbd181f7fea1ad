"""Items of a phase as data: variables, limits and parameters."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.calls import from_origins
from microbot_ocp._base.checks import FloatArray, InputError, shown
from microbot_ocp._base.portable import Portable

# Attributes of a phase that are lists of items.
VARIABLES = ("states", "controls", "algebraics", "free_parameters")
LIMITS = ("constraints", "end_constraints", "point_constraints")
CONSTANTS = ("parameters", "measurements")

Range = tuple[FloatArray, FloatArray]  # lower and upper bounds [size]
Bound = ArrayLike | ca.MX | tuple[ArrayLike | ca.MX, ArrayLike | ca.MX] | None


@dataclass(frozen=True, eq=False)
class PathConstraint(Portable):
    """``lower <= expression <= upper`` along a phase, or at its end."""

    name: str
    expression: ca.MX
    lower: FloatArray
    upper: FloatArray
    scale: FloatArray
    unit: str
    scaled: bool = True  # True if the scale was declared
    interior_points: bool = True  # True if the limit also holds inside the intervals

    @property
    def size(self) -> int:
        """Number of components."""
        return self.expression.shape[0]


@dataclass(frozen=True, eq=False, kw_only=True)
class Variable(PathConstraint):
    """A state, control or free parameter of a phase: a limit whose expression is its symbol."""

    shape: str  # "state", "auto", "constant", "linear", "polynomial", "algebraic", "parameter"
    initial: Range | None = None
    final: Range | None = None
    interior_points: bool = False
    rate: ca.MX | None = None
    columns: int = 1  # columns of the matrix whose entries are the components, column by column

    @property
    def symbol(self) -> ca.MX:
        """Symbol [size] of the variable in expressions."""
        return self.expression


@dataclass(frozen=True, eq=False, kw_only=True)
class PointConstraint(PathConstraint):
    """``lower <= expression <= upper`` at given fractions [M] of a phase.

    If ``defines`` names a free parameter, the expression is zero there: the parameter then equals
    the value of another expression at that point.
    """

    fractions: FloatArray
    defines: str = ""

    @classmethod
    def of(cls, limit: PathConstraint, fractions: ArrayLike, defines: str = "") -> Self:
        """Return a limit as a constraint at given fractions of the phase."""
        return cls(**vars(limit), fractions=np.atleast_1d(fractions), defines=defines)


@dataclass(frozen=True, eq=False)
class PointCost(Portable):
    """A cost that is added at each of the fractions [M] of a phase."""

    expression: ca.MX
    fractions: FloatArray


@dataclass(frozen=True, eq=False)
class Parameter(Portable):
    """A constant [size] of a phase; phases that differ only in parameters share kernels."""

    name: str
    symbol: ca.MX
    value: FloatArray

    def with_value(self, value: ArrayLike) -> Self:
        """Return a copy with another value."""
        flat = np.ravel(checks.numbers(f"parameter {self.name!r}", value), order="F")
        flat = checks.array(f"parameter {self.name!r}", flat, (self.value.size,))
        return replace(self, value=flat.reshape(self.value.shape, order="F"))


@dataclass(frozen=True, eq=False)
class Measurement(Parameter):
    """Data [M, size] at fractions [M] of a phase; the symbol stands for the row of one fraction."""

    fractions: FloatArray


@dataclass(frozen=True, eq=False)
class PointValue(Portable):
    """The value of an expression at a fraction of a phase, as a symbol for other expressions."""

    name: str
    symbol: ca.MX
    expression: ca.MX
    fraction: float
    unit: str


@dataclass(frozen=True)
class PhaseLink:
    """Continuity of the named states and linear controls from one phase to the next."""

    before: str
    after: str
    names: tuple[str, ...]


def moving(value: object) -> bool:
    """Return True if a bound or condition contains an expression."""
    if isinstance(value, tuple):
        return any(isinstance(side, ca.MX) for side in value)
    return isinstance(value, ca.MX)


def fill(name: str, value: ArrayLike, size: int) -> FloatArray:
    """Return an array [size] from a number, a vector, or a matrix taken column by column."""
    given = checks.numbers(name, value)
    if given.ndim == 0:
        given = np.full(size, float(given))
    return checks.array(name, given.ravel(order="F"), (size,), finite=False)


def duration_bounds(phase: str, value: float | tuple[float, float]) -> tuple[float, float]:
    """Return bounds of the duration of a phase, s, from a fixed duration or (lower, upper)."""
    low, high = value if isinstance(value, tuple | list) and len(value) == 2 else (value, value)
    try:
        low = checks.number(f"duration of phase {phase!r}", low, "s", above=0.0)
        return low, checks.number(f"upper duration of phase {phase!r}", high, "s", at_least=low)
    except InputError as refused:
        raise InputError(f"{refused}; a free duration is a range, such as (0.1, 100.0)") from None


def ordered(name: str, lower: ArrayLike, upper: ArrayLike, size: int, unit: str) -> Range:
    """Return lower and upper bounds [size]; raise InputError if a lower one is above its upper."""
    labels = (name, name) if lower is upper else (f"lower {name}", f"upper {name}")
    low, high = fill(labels[0], lower, size), fill(labels[1], upper, size)
    if np.any(low > high):
        i = int(np.argmax(low > high))
        text = f"bounds of {name!r} are crossed: lower {low[i]:g} is above upper {high[i]:g} {unit}"
        raise InputError(text.rstrip())
    return low, high


def condition(name: str, value: Bound, size: int, unit: str) -> Range | None:
    """Return bounds at an end of the phase; None for no condition or one with expressions."""
    if value is None or moving(value):
        return None
    sides: Any = value if isinstance(value, tuple) and len(value) == 2 else (value, value)
    low, high = sides
    if sides is value and size == 2 and np.ndim(low) == 0 and np.ndim(high) == 0:
        raise InputError(
            f"{name} has two components, so ({low}, {high}) may mean two values or a range: write "
            f"[{low}, {high}] for the values, ([{low}] * 2, [{high}] * 2) for the range"
        )
    return ordered(name, low, high, size, unit)


def limit_of(
    name: str,
    expression: ca.MX,
    lower: ArrayLike = -np.inf,
    upper: ArrayLike = np.inf,
    scale: ArrayLike | None = None,
    unit: str = "",
) -> PathConstraint:
    """Return a limit with checked bounds and scale."""
    if not isinstance(name, str):
        raise InputError(f"name must be text, not {shown(name)}; {checks.NAME_FIRST}")
    expression = ca.vec(expression)
    size = expression.shape[0]
    low, high = ordered(name, lower, upper, size, unit)
    sizes = fill(f"scale of {name}", 1.0 if scale is None else scale, size)
    if not np.all(np.isfinite(sizes) & (sizes > 0)):
        raise InputError(f"scale of {name!r} must be finite and above 0, not {scale}")
    return PathConstraint(name, expression, low, high, sizes, unit, scaled=scale is not None)


def variable_of(
    limit: PathConstraint, shape: str, initial: Bound = None, final: Bound = None, columns: int = 1
) -> Variable:
    """Return a variable from the limit of its symbol and its conditions at both ends.

    Conditions with expressions are left to point constraints.
    """
    size, ends = limit.expression.shape[0], {}
    for where, given in (("initial", initial), ("final", final)):
        label = f"{where} {limit.name}"
        end = ends[where] = condition(label, given, size, limit.unit)
        if end is not None and np.any(outside := (end[0] > limit.upper) | (end[1] < limit.lower)):
            i = int(np.argmax(outside))
            value = end[0][i] if end[0][i] > limit.upper[i] else end[1][i]
            bounds = f"{limit.lower[i]:g} to {limit.upper[i]:g} {limit.unit}".rstrip()
            raise InputError(f"{label} must be within its bounds, {bounds}, not {value:g}")
    rate = ca.MX.sym(f"{limit.expression.name()}.rate", size) if shape == "linear" else None
    given = {**vars(limit), **ends, "interior_points": False}
    return Variable(**given, shape=shape, rate=rate, columns=columns)


def converted(value: Any) -> ca.MX:
    """Return a CasADi expression from an expression or numbers.

    Raises
    ------
    InputError
        The value is neither an expression nor numbers, or is empty.
    """
    try:
        expression = ca.MX(value)
    except Exception:  # CasADi raises several unrelated types
        sentence = (
            f"expression must be a CasADi MX or numbers, not {shown(value)}; ca.vertcat makes one "
            "of several, and SX stays outside"
        )
        raise InputError(sentence) from None
    if 0 in expression.shape:
        raise InputError(f"expression must have entries, but its shape is {expression.shape}")
    return from_origins(expression)
