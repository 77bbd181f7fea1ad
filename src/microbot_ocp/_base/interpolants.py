"""Tables that expressions read: the argument of each lookup, and the range of its grid.

CasADi extrapolates beyond a grid without notice and has no function that returns a grid; the
grid is taken from CasADi's serialization with member names. Tables in functions with the option
never_inline and in short-circuited branches are not found.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import casadi as ca
import numpy as np

from microbot_ocp._base.calls import written_out
from microbot_ocp._base.checks import FloatArray


class Lookup(NamedTuple):
    """A table lookup in an expression.

    Outside of the branch of ``casadi.if_else`` that contains the lookup, the argument is replaced
    by the lower end of the grid.

    Attributes
    ----------
    name : str
        Name of the table.
    argument : MX [d,K]
        Arguments of K lookups in d dimensions.
    lower, upper : MX [d]
        Ends of the grid.
    """

    name: str
    argument: ca.MX
    lower: ca.MX
    upper: ca.MX


def lookups(expressions: Sequence[ca.MX]) -> list[Lookup]:
    """Return the lookups in expressions and the functions that they call, without duplicates.

    A lookup reads an interpolant or a B-spline of CasADi.
    """
    column = ca.vertcat(ca.MX(0, 1), *map(ca.vec, expressions))
    whole = ca.Function("whole", ca.symvar(column), [column])
    found: list[Lookup] = []
    for each in _all(expressions) if has_tables(whole) else ():
        if not any(ca.is_equal(each.argument, other.argument, 9) for other in found):
            found.append(each)
    return found


class Read(NamedTuple):
    """Values [M] of one argument of a table at M points, and the range of its grid."""

    name: str
    component: int
    values: FloatArray
    lower: float
    upper: float

    @property
    def relative(self) -> FloatArray:
        """Distance of each value [M] to the grid, divided by half of its range; negative inside."""
        beyond = np.maximum(self.lower - self.values, self.values - self.upper)
        return beyond / max((self.upper - self.lower) / 2, np.finfo(float).tiny)

    def at(self, k: int) -> str:
        """Return a sentence about the lookup at point ``k``."""
        value = self.values[k]
        end = self.upper if value > self.lower else self.lower
        name = f"{self.name}[{self.component}]" if self.component else self.name
        return f"table {name} is read at {value:.6g}, outside of its grid, which ends at {end:.6g}"


def reads(
    expressions: Sequence[ca.MX], symbols: Sequence[ca.MX], table: FloatArray
) -> Iterator[Read]:
    """Yield the arguments of all lookups for a table of the values of all symbols [..., M].

    Lookups that depend on other symbols are left out.
    """
    for name, *parts in lookups(expressions):
        given = [ca.vertcat(*symbols)]
        run = ca.Function("read", given, [ca.vec(k.T) for k in parts], {"allow_free": True})
        if run.has_free():
            continue
        argument, lower, upper = (np.array(k) for k in run(table))
        columns = len(argument) // len(lower)
        for row, values in enumerate(argument):
            k = row // columns
            yield Read(name, k, values, float(lower[k, 0]), float(upper[k, 0]))


_Waiting = tuple[ca.MX, str, ca.MX]  # node, name of its function, condition of its branch


def has_tables(function: ca.Function) -> bool:
    """Return True if a function, or one that it calls, reads a table."""
    for part in (function, *function.find_functions()):
        nodes = range(part.n_instructions() if part.is_a("MXFunction") else 0)
        in_place = any(part.instruction_id(k) in (ca.OP_LOW, ca.OP_BSPLINE) for k in nodes)
        if in_place or part.class_name().endswith("Interpolant"):
            return True
    return False


def _all(expressions: Sequence[ca.MX]) -> Iterator[Lookup]:
    always = ca.MX(1)
    waiting: list[_Waiting] = [(each, "a table", always) for each in expressions]
    seen: dict[tuple[int, int], _Waiting] = {}
    while waiting:
        node, label, used = here = waiting.pop()
        if (key := (node.__hash__(), used.__hash__())) in seen:
            continue
        seen[key] = here  # kept alive, so that no other node gets its hash
        given = [node.dep(k) for k in range(node.n_dep())]
        # Operands of if_else_zero after the condition (operand 0) count only where it holds.
        branch = ca.logic_and(used, given[0]) if node.op() == ca.OP_IF_ELSE_ZERO else used
        waiting += [(e, label, branch if k else used) for k, e in enumerate(given)]
        for name, argument, lower, upper in _read(node, label, given):
            inside = ca.repmat(lower, 1, argument.shape[1])
            yield Lookup(name, ca.if_else(used, argument, inside), lower, upper)
        if node.is_call():
            function = node.which_function()
            inside = written_out(function, given) or ()
            waiting += [(each, function.name(), used) for each in inside]


def _read(node: ca.MX, label: str, given: Sequence[ca.MX]) -> Iterator[Lookup]:
    """Yield the lookup of a node that reads a table."""
    if node.op() == ca.OP_LOW:  # an inlined linear interpolant
        yield Lookup(label, given[1], given[0][0], given[0][-1])
    elif node.op() == ca.OP_BSPLINE:
        whole = _written(ca.Function("spline", ca.symvar(node), [node]))
        knots = _vectors(whole, "BSplineCommon", "knots")
        degree = _member(whole, "BSplineCommon::degree", "<i8")
        ends = [(k[d], k[-d - 1]) for k, d in zip(knots, degree, strict=True)]
        yield Lookup(label, given[0], *(ca.MX(ca.DM(each)) for each in zip(*ends, strict=True)))
    elif node.is_call() and node.which_function().class_name().endswith("Interpolant"):
        yield _interpolant(node.which_function(), given)


def _interpolant(function: ca.Function, given: Sequence[ca.MX]) -> Lookup:
    whole = _written(function)
    if "g" in function.name_in():
        offsets = _member(whole, "Interpolant::offset", "<i8")
        grid = given[function.name_in().index("g")]
        ends = [(grid[a], grid[b - 1]) for a, b in pairwise(offsets)]
        lower, upper = (ca.vertcat(*each) for each in zip(*ends, strict=True))
    else:
        grids = _vectors(whole, "Interpolant", "grid")
        lower, upper = (ca.MX(ca.DM([grid[k] for grid in grids])) for k in (0, -1))
    return Lookup(function.name(), ca.reshape(given[0], lower.shape[0], -1), lower, upper)


def _written(function: ca.Function) -> bytes:
    """Return the serialization of a function with the names of its members."""
    letters = np.frombuffer(function.serialize({"debug": True}).encode(), np.uint8) - ord("a")
    # Two letters a byte, the lower four bits first.
    return (letters[::2] | letters[1::2] << 4).tobytes()


def _vectors(whole: bytes, owner: str, name: str) -> list[np.ndarray]:
    """Return the vectors that the serialization stacks in one, split at their offsets."""
    offsets = _member(whole, f"{owner}::offset", "<i8")
    return np.split(_member(whole, f"{owner}::{name}", "<f8"), offsets[1:-1])


def _member(whole: bytes, name: str, kind: str) -> np.ndarray:
    """Return a vector member: bytes "V", "J", its size, and entries, each after a letter."""
    start = whole.index(name.encode()) + len(name)
    count = int.from_bytes(whole[start + 2 : start + 10], "little")
    entry = np.dtype([("kind", "S1"), ("value", kind)])
    return np.frombuffer(whole, entry, count, start + 10)["value"]
