"""An interpreter in C for CasADi functions that are evaluated for many columns at once.

In generated C code a derivative is thousands of operations without a loop: a compiler takes
seconds, and the processor fetches each instruction from memory. Here the operations are a table. A
short loop executes each for a block of columns, whose numbers are adjacent in memory, and combines
a product with the sum that uses it. An operation on 32 columns takes 5 to 7 ns. Short functions are
as fast as compiled ones, Hessians of six and seven joints 3 and 5 times as fast. The results have
the bits of CasADi's virtual machine. The C compiler takes 1 s for the interpreter, once for all
tasks, and 0.1 s for the tables of a task.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.threads import expanded

# Columns of a block; with 64, a stage of seven joints would exceed the second-level cache.
COLUMNS = 32
ALIGNMENT = 8  # numbers in a cache line
NAME = "interpreter"  # prefix of the names of libraries
FLAGS = ("-ffp-contract=off",)

HERE = Path(__file__).parent
_LINE = re.compile(r"^OPERATION\((\w+), (.+)\)$", re.MULTILINE)
_LINES = _LINE.findall((HERE / "operations.c").read_text("utf-8"))
# C expression of each operation.
FORMULAS = {getattr(ca, f"OP_{name}"): formula for name, formula in _LINES}
MOVES = {f"MOVE_{name}": getattr(ca, f"OP_{name}") for name in ("CONST", "INPUT", "OUTPUT")}
# A sum or difference with a product has a second row, for a second product or the other operand.
PRODUCTS = ("PRODUCT_PLUS", "PRODUCT_MINUS", "MINUS_PRODUCT")
PRODUCTS += ("SUM_OF_PRODUCTS", "DIFFERENCE_OF_PRODUCTS")
FIRST_PRODUCT = 1000  # above all operations of CasADi
ESCAPED = [chr(k) if chr(k).isalnum() else f"\\{k:03o}" for k in range(128)]
ESCAPED += [f"\\{k:03o}" for k in range(128, 256)]


class ManyColumns(ca.Function):
    """A function of one column, from a library that also has the function of a block of columns."""

    def __init__(self, name: str, library: str) -> None:
        super().__init__(ca.external(name, library))
        self._block = ca.external(f"{name}_block", library)

    def map(self, count: int, *_: Any) -> ca.Function:
        """Return the function of ``count`` columns, evaluated in one thread.

        With several threads CasADi would compute all outputs, even those not requested.
        """
        if count == 1:
            return super().map(count)
        blocks = -(-count // COLUMNS)
        inputs, given, outputs = [], [], []
        for k in range(self.n_in()):
            width = self.size2_in(k)
            inputs.append(ca.MX.sym(self.name_in(k), self.size1_in(k), count * width))
            # The last column is repeated to fill its block.
            _, last = ca.horzsplit(inputs[-1], [0, (count - 1) * width, count * width])
            given.append(ca.horzcat(inputs[-1], ca.repmat(last, 1, blocks * COLUMNS - count)))
        for k, output in enumerate(self._block.map(blocks).call(given)):
            edges = [0, count * self.size2_out(k), output.shape[1]]
            outputs.append(ca.horzsplit(output, edges)[0])
        return ca.Function(self.name(), inputs, outputs, {"always_inline": True})


def c_text(functions: Sequence[ca.Function]) -> str | None:
    """Return C text of functions, for one column and for a block, without the interpreter.

    None if a function cannot be expanded into scalar operations or has an unknown one.
    """
    tables = [table_of(function) for function in functions]
    interpreted = [with_products(table) for table in tables if table is not None]
    if len(interpreted) < len(tables):
        return None
    definitions = map(_definitions, functions, interpreted)
    return "#define TABLES\n" + interpreter_text() + "".join(chain.from_iterable(definitions))


def interpreter_text() -> str:
    """Return the C text of the interpreter."""
    cases = " ".join(f"CASE({k}, {FORMULAS[k].format('x', 'y')})" for k in sorted(FORMULAS))
    products = {name: FIRST_PRODUCT + k for k, name in enumerate(PRODUCTS)}
    numbers = {"COLUMNS": COLUMNS, "ALIGNMENT": ALIGNMENT, **MOVES, **products}
    names = "".join(f"#define {name} {number}\n" for name, number in numbers.items())
    text = (HERE / "interpreter.c").read_text("utf-8")
    return names + text.replace("/* further cases */", cases)


@dataclass(frozen=True, eq=False)
class OperationTable:
    """A function as a list of operations on a work array.

    Attributes
    ----------
    code : array of 16-bit integers [N,4]
        Operation, index of its result, and indices of its two operands.
    constants : array [C]
    places : int
        Length of the work array.
    """

    code: np.ndarray
    constants: FloatArray
    places: int

    def ends(self, function: ca.Function) -> list[int]:
        """Return, for each output, the number of operations after which it is complete."""
        of_outputs = np.flatnonzero(self.code[:, 0] == ca.OP_OUTPUT)
        ends = np.zeros(function.n_out(), dtype=int)
        np.maximum.at(ends, self.code[of_outputs, 2], of_outputs + 1)
        return ends.tolist()


def table_of(function: ca.Function) -> OperationTable | None:
    """Return the operation table of a function, which computes the last outputs first.

    The last outputs are a cost and its gradient, which solvers often request alone. None if the
    function cannot be expanded into scalar operations, has an unknown one or is too large.
    """
    try:
        function = expanded(function)
    except RuntimeError:
        return None
    given, last = function.sx_in(), function.n_out() - 1
    turned = ca.Function(function.name(), given, function.call(given)[::-1])
    rows, constants = list[tuple[int, int, int, int]](), list[float]()
    for k in range(turned.n_instructions()):
        operation, to = turned.instruction_id(k), turned.instruction_output(k)
        if operation == ca.OP_CONST:
            rows.append((operation, to[0], len(constants), 0))
            constants.append(turned.instruction_constant(k))
            continue
        of = turned.instruction_input(k)
        if operation == ca.OP_OUTPUT:
            rows.append((operation, of[0], last - to[0], to[1]))
        elif operation in FORMULAS or operation == ca.OP_INPUT:
            rows.append((operation, to[0], of[0], of[-1]))
        else:
            return None
    code = np.array(rows, dtype=int).reshape(-1, 4)
    if code.max(initial=0) > np.iinfo(np.uint16).max:
        return None
    return OperationTable(code.astype(np.uint16), np.array(constants), turned.sz_w())


def with_products(table: OperationTable) -> OperationTable:
    """Return a table in which a product with a single use is computed by the sum that uses it.

    The product is rounded as before, so the bits do not change. Nearly half of the operations of a
    derivative are such products; they are no longer written to and read from memory.
    """
    code = table.code.astype(int)
    rows, (operation, to, *of) = np.arange(len(code)), code.T
    is_output = operation == ca.OP_OUTPUT
    writes = np.flatnonzero(~is_output)
    writes = writes[np.lexsort((writes, to[writes]))]
    # Writes sorted by place and row let a bisection find the last write before each read.
    keys = to[writes] * len(code) + writes

    def writer(place: np.ndarray, row: np.ndarray) -> np.ndarray:
        """Return the row that last wrote to a place before a row reads it."""
        return writes[np.searchsorted(keys, place * len(code) + row) - 1]

    overwritten = np.full(len(code), len(code))  # next row that writes to the result of each row
    again = to[writes[1:]] == to[writes[:-1]]
    overwritten[writes[:-1][again]] = writes[1:][again]
    source = np.array([writer(places, rows) for places in of])
    reads = ~(is_output | np.isin(operation, (ca.OP_INPUT, ca.OP_CONST)))
    reads_two = reads & (source[0] != source[1])
    is_sum = reads_two & np.isin(operation, (ca.OP_ADD, ca.OP_SUB))
    read = [source[0, reads], source[1, reads_two], writer(to[is_output], rows[is_output])]
    uses = np.bincount(np.concatenate(read), minlength=len(code))
    user = np.full(len(code), -1)
    for side in source:
        user[side[is_sum]] = rows[is_sum]
    moved = (operation == ca.OP_MUL) & (uses == 1) & (user >= 0)
    # Valid only if the factors are intact at the sum; the product's own result may replace one.
    for side in source:
        moved &= (overwritten[side] >= user) | (overwritten[side] == rows)
    left, right = is_sum & moved[source]
    merged, is_difference = left | right, operation == ca.OP_SUB
    # A moved product loses its row; its sum takes two rows.
    begin = np.cumsum(1 + merged - moved) - 1 - merged
    result = np.zeros((len(code) + merged.sum() - moved.sum(), 4), dtype=np.uint16)
    result[begin[~moved]] = code[~moved]
    # The kinds number PRODUCTS: 0 to 2 with one product, 3 and 4 with two.
    kind = np.where(left & right, 3 + is_difference, is_difference * (2 - left))
    product = np.where(left, *source)
    first = [FIRST_PRODUCT + kind, to, *(places[product] for places in of)]
    other = np.where(left, *of[::-1])
    second = [np.where(left & right, places[source[1]], other) for places in of]
    result[begin[merged]] = np.array(first).T[merged]
    result[begin[merged] + 1, 2:] = np.array(second).T[merged]
    return replace(table, code=result)


def c_numbers(values: Iterable[float]) -> str:
    """Return numbers as C source, separated by commas."""
    return ",".join(map(repr, values)).replace("inf", "INFINITY").replace("nan", "NAN")


def _definitions(function: ca.Function, table: OperationTable) -> Iterator[str]:
    """Yield C text: the tables of a function and the functions that CasADi calls in a library."""
    name = function.name()
    values = c_numbers(table.constants.tolist())
    code = "".join(map(ESCAPED.__getitem__, table.code.tobytes()))
    yield f'static const char {name}_code[] __attribute__((aligned(8))) = "{code}";\n'
    yield f"static const double {name}_constants[] = {{{values or 0}}};\n"
    yield f"static const int {name}_ends[] = {{{','.join(map(str, table.ends(function)))}}};\n"
    sides = (
        ("in", [function.sparsity_in(k) for k in range(function.n_in())]),
        ("out", [function.sparsity_out(k) for k in range(function.n_out())]),
    )
    for side, sparsities in sides:
        lengths = ",".join(str(sparsity.nnz()) for sparsity in sparsities)
        yield f"static const int {name}_{side}[] = {{{lengths}}};\n"
    for suffix, columns in (("", 1), ("_block", COLUMNS)):
        for side, sparsities in sides:
            labels = [f"{name}{suffix}_{side}{k}" for k in range(len(sparsities))]
            for label, sparsity in zip(labels, sparsities, strict=True):
                numbers = ",".join(map(str, ca.repmat(sparsity, 1, columns).compress()))
                yield f"static const casadi_int {label}[] = {{{numbers}}};\n"
            yield f"SPARSITY({name}{suffix}, {side}, {len(labels)}, {', '.join(labels)})\n"
        counts = f"{columns}, {function.n_in()}, {function.n_out()}, {table.places}"
        yield f"FUNCTION({name}, {name}{suffix}, {counts})\n"
