"""An interpreter in C of CasADi functions that are called for many columns at once.

Written out in C a derivative is thousands of operations without a loop: a compiler takes seconds,
and the processor fetches every one of them from memory. Here operations are a table, and a short
loop takes each for a block of columns, whose numbers stand side by side. To choose an operation
takes 4 ns, to do it for 32 columns 6 ns more: short functions are as fast as compiled, those of
seven joints up to 5 times as fast, with the bits of CasADi's virtual machine, and a compiler takes
0.2 to 0.6 s for all of a task.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import casadi as ca

COLUMNS = 32  # of a block; of 64 the numbers of a stage of seven joints fill the second cache
NAME = "interpreter"  # that names of libraries begin with
FLAGS = ("-ffp-contract=off",)

# C of an operation on numbers or on vectors of them, entry by entry what CasADi does. The macros
# in it are those of numbers in interpreter.c, of vectors in fast_calls.c.
FORMULAS = {
    ca.OP_ASSIGN: "{0}",
    ca.OP_ADD: "{0}+{1}",
    ca.OP_SUB: "{0}-{1}",
    ca.OP_MUL: "{0}*{1}",
    ca.OP_DIV: "{0}/{1}",
    ca.OP_NEG: "-{0}",
    ca.OP_SQ: "{0}*{0}",
    ca.OP_TWICE: "2.*{0}",
    ca.OP_INV: "1./{0}",
    ca.OP_LT: "TRUTH({0}<{1})",
    ca.OP_LE: "TRUTH({0}<={1})",
    ca.OP_EQ: "TRUTH({0}=={1})",
    ca.OP_NE: "TRUTH({0}!={1})",
    ca.OP_NOT: "TRUTH({0}==0)",
    ca.OP_AND: "TRUTH(({0}!=0)&({1}!=0))",
    ca.OP_OR: "TRUTH(({0}!=0)|({1}!=0))",
    ca.OP_IF_ELSE_ZERO: "WHERE({0}!=0,{1},NOTHING)",
    ca.OP_FMIN: "WHERE(({0}<{1})|({1}!={1}),{0},{1})",
    ca.OP_FMAX: "WHERE(({0}>{1})|({1}!={1}),{0},{1})",
    ca.OP_FABS: "MAGNITUDE({0})",
    ca.OP_SIGN: "WHERE({0}>0,NOTHING+1.,WHERE({0}<0,NOTHING-1.,{0}))",
    ca.OP_CONSTPOW: "EACH_PAIR(pow,{0},{1})",
}
FORMULAS |= {
    getattr(ca, f"OP_{name.upper()}"): f"EACH({name},{{0}})"
    for name in (
        *("sqrt", "exp", "log", "floor", "ceil", "erf", "expm1", "log1p"),
        *("sin", "cos", "tan", "asin", "acos", "atan"),
        *("sinh", "cosh", "tanh", "asinh", "acosh", "atanh"),
    )
}
FORMULAS |= {
    getattr(ca, f"OP_{name.upper()}"): f"EACH_PAIR({name},{{0}},{{1}})"
    for name in ("pow", "atan2", "copysign", "fmod", "hypot")
}
MOVES = {f"MOVE_{name}": getattr(ca, f"OP_{name}") for name in ("CONST", "INPUT", "OUTPUT")}


class ManyColumns(ca.Function):
    """A function of one column from a library that has the same of a block of columns."""

    def __init__(self, name: str, library: str) -> None:
        super().__init__(ca.external(name, library))
        self._block = ca.external(f"{name}_block", library)

    def map(self, count: int, *_: Any) -> ca.Function:
        """Return the function of ``count`` columns, in one thread.

        In several CasADi computes all outputs, whichever are asked for.
        """
        if count == 1:
            return super().map(count)
        blocks = -(-count // COLUMNS)
        inputs, given, outputs = [], [], []
        for k in range(self.n_in()):
            width = self.size2_in(k)
            inputs.append(ca.MX.sym(self.name_in(k), self.size1_in(k), count * width))
            # the last one fills its block
            _, last = ca.horzsplit(inputs[-1], [0, (count - 1) * width, count * width])
            given.append(ca.horzcat(inputs[-1], ca.repmat(last, 1, blocks * COLUMNS - count)))
        for k, output in enumerate(self._block.map(blocks).call(given)):
            edges = [0, count * self.size2_out(k), output.shape[1]]
            outputs.append(ca.horzsplit(output, edges)[0])
        return ca.Function(self.name(), inputs, outputs, {"always_inline": True})


def c_text(functions: Sequence[ca.Function]) -> str | None:
    """Return C text of functions, of one column and of a block; None where one has no scalar graph
    of operations that are known.
    """
    used, tables = set[int](), list[str]()
    for function in functions:
        try:
            rows, constants, places = _table(function.expand())
        except RuntimeError:
            return None
        used |= {row[0] for row in rows}
        tables += _definitions(function, rows, constants, places)
    known = FORMULAS.keys() & used
    if used - known - {*MOVES.values()}:
        return None
    cases = " ".join(f"CASE({k}, {FORMULAS[k].format('x', 'y')})" for k in sorted(known))
    names = "".join(
        f"#define {name} {number}\n" for name, number in {"COLUMNS": COLUMNS, **MOVES}.items()
    )
    text = Path(__file__).with_suffix(".c").read_text("utf-8")
    return names + text.replace("/* further cases */", cases) + "".join(tables)


Row = tuple[int, int, int, int]  # an operation, where its result goes, and what it is of


def _table(function: ca.Function) -> tuple[list[Row], list[float], int]:
    """Return operations, constants, and how many numbers are at work at once.

    The last outputs come first: a cost and its gradient, which solvers ask for alone.
    """
    given, last = function.sx_in(), function.n_out() - 1
    turned = ca.Function(function.name(), given, function.call(given)[::-1])
    rows, constants = list[Row](), list[float]()
    for k in range(turned.n_instructions()):
        operation, to = turned.instruction_id(k), turned.instruction_output(k)
        if operation == ca.OP_CONST:
            rows.append((operation, to[0], len(constants), 0))
            constants.append(turned.instruction_constant(k))
            continue
        of = turned.instruction_input(k)
        if operation == ca.OP_OUTPUT:
            rows.append((operation, of[0], last - to[0], to[1]))
        else:
            rows.append((operation, to[0], of[0], of[-1]))
    return rows, constants, turned.sz_w()


def _definitions(
    function: ca.Function, rows: Sequence[Row], constants: Sequence[float], places: int
) -> Iterator[str]:
    """Yield the tables of a function in C, and what CasADi asks of a library about it."""
    name = function.name()
    ends = [0] * function.n_out()
    for index, (operation, _, output, _) in enumerate(rows):
        if operation == ca.OP_OUTPUT:
            ends[output] = index + 1
    values = ",".join(map(repr, constants)).replace("inf", "INFINITY").replace("nan", "NAN")
    code = ",".join(f"{{{a},{b},{c},{d}}}" for a, b, c, d in rows)
    yield f"static const Operation {name}_code[] = {{{code}}};\n"
    yield f"static const double {name}_constants[] = {{{values or 0}}};\n"
    yield f"static const int {name}_ends[] = {{{','.join(map(str, ends))}}};\n"
    sides = (
        ("in", [function.sparsity_in(k) for k in range(function.n_in())]),
        ("out", [function.sparsity_out(k) for k in range(function.n_out())]),
    )
    for side, sparsities in sides:
        lengths = ",".join(str(sparsity.nnz()) for sparsity in sparsities)
        yield f"static const int {name}_{side}[] = {{{lengths}}};\n"
    for suffix, columns in (("", 1), ("_block", COLUMNS)):
        for side, sparsities in sides:
            tables = [f"{name}{suffix}_{side}{k}" for k in range(len(sparsities))]
            for table, sparsity in zip(tables, sparsities, strict=True):
                numbers = ",".join(map(str, ca.repmat(sparsity, 1, columns).compress()))
                yield f"static const casadi_int {table}[] = {{{numbers}}};\n"
            yield f"SPARSITY({name}{suffix}, {side}, {len(tables)}, {', '.join(tables)})\n"
        counts = f"{columns}, {function.n_in()}, {function.n_out()}, {places}"
        yield f"FUNCTION({name}, {name}{suffix}, {counts})\n"
