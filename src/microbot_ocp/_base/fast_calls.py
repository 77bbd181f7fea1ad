"""CasADi functions as numpy functions at the cost of a C call.

A CasADi function called from Python takes 40 us to convert arrays to its own matrices and back, and
0.5 us more for every column. :func:`fast_call` compiles its C code together with a few lines that
read numpy memory in place and write a new array: 0.1 us for the inverse dynamics of three joints. A
batch is one loop in C, over as many rows at once as a vector register has numbers.
:func:`buffered_call` evaluates any function without compilation, with matrices as arguments.
"""

from __future__ import annotations

import ctypes
import subprocess
import sys
import sysconfig
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from importlib.machinery import EXTENSION_SUFFIXES, ExtensionFileLoader
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base import codegen, deadline
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.codegen import (
    CommonLibrary,
    build_library,
    c_source,
    compile_function,
    compiles,
    package,
)
from microbot_ocp._base.interpreter import (
    ALIGNMENT,
    COLUMNS,
    FORMULAS,
    c_numbers,
    interpreter_text,
    table_of,
    with_products,
)

FastCall = Callable[..., Any]


@dataclass(frozen=True, eq=False)
class RowsInPlace:
    """Memory of a function for a number of rows.

    Attributes
    ----------
    inputs : list of arrays [rows, size]
        Arguments, to write to.
    outputs : list of arrays [rows, size]
        Values, until the next evaluation.
    run : callable
        Evaluation.
    kept : tuple
        Owners of the memory that the evaluation has addresses of.
    """

    inputs: list[FloatArray]
    outputs: list[FloatArray]
    run: Callable[[], None]
    kept: tuple[Any, ...] = ()


WORTH_COMPILING = 0.5  # s of uncompiled evaluation, about the compile time
# Rows before a table is built: it costs 3.4 us an operation, the virtual machine 5 ns for each row.
WORTH_A_TABLE = 700
NESTED = {"base": 4}  # CasADi builds a chain of 1000 in 5 ms; its default of 10 takes 50 ms
# No fused multiply-add: a state has equal bits alone and in a batch, and code compiled later has
# the bits of CasADi's virtual machine. FMA would save 10 % of a call with 7 joints.
ROUNDED_ALIKE = ("-ffp-contract=off",)

# Template of the Python module around the C code of a function.
GLUE = Path(__file__).with_suffix(".c")
# Sines and cosines for functions that are always compiled.
TRIGONOMETRY = GLUE.with_name("trigonometry.c")


@lru_cache(maxsize=128)
def fast_call(function: ca.Function) -> FastCall:
    """Return a CasADi function as a numpy function of one state or of many.

    Parameters
    ----------
    function : casadi.Function
        Uncompiled function, which is compiled here; its inputs are vectors.

    Returns
    -------
    callable
        Function of one array [n] for each input, or a batch [N,n]; a single [n] among batches
        is repeated for all rows. It returns an array [m] or [N,m] ([m,k] or [N,m,k] for a
        matrix), several outputs as a tuple. Arguments other than float64 arrays of contiguous
        rows are converted. Sines and cosines have an error of at most three units in the last
        place. Without Python's headers or a C compiler a call takes some us.

    Raises
    ------
    InputError
        An input is a matrix or sparse; in later calls, an array has a wrong shape.

    Warns
    -----
    NotCompiled
        There is no C compiler.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> tau = fast_call(mo.inverse_dynamics(mo.load_robot("microbot")))
    >>> tau([0, 0, 0], [0, 0, 0], [0, 0, 0]).round(6).tolist()
    [0.0, 196.0, 78.4]
    >>> tau(np.zeros((5, 3)), [0, 0, 0], [0, 0, 0]).shape
    (5, 3)
    """
    _check_vectors(function)
    return _extension(function, 0) or _stand_in(compile_function(function))


@lru_cache(maxsize=128)
def deferred_call(
    function: ca.Function,
    most: int = 0,
    kept: bool = False,
    compiled: bool = True,
    alike: bool = True,
) -> FastCall:
    """Return a CasADi function as a numpy function of many states, compiled when that pays.

    Compiled code from the cache is used at once. Otherwise the function runs uncompiled, many
    states as a table (:mod:`~microbot_ocp._base.interpreter`), until that has taken
    :data:`WORTH_COMPILING`; the few thousand states of a motion take less. All give equal bits.

    Parameters
    ----------
    function : casadi.Function
        Function as for :func:`fast_call` with dense outputs. If ``most`` is above zero it takes a
        state and further inputs, and returns the next state, a number that is positive as long as
        the repetition continues, and further outputs.
    most : int
        Largest number of repetitions, of each row of a batch, with the other inputs constant; zero
        for a single evaluation.
    kept : bool
        True to return the outputs of every repetition from one state; with ``most`` of zero, the
        function runs along the rows of the other inputs, its first output the next state.
    compiled : bool
        False to never compile.
    alike : bool
        True for sines with the bits of CasADi's virtual machine. False for those of
        :func:`fast_call`, which take a third less time in batches, also before compilation; but
        CasADi's without a compiler or with ``kept``.

    Returns
    -------
    callable
        Function of a batch [N,n] for each input, which returns a batch [N,m], several outputs as
        a tuple. If ``kept``, its first input (with ``most`` every input) is an array [n].

    Raises
    ------
    InputError
        Errors of :func:`fast_call`; the state's size changes.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> tau = deferred_call(mo.inverse_dynamics(mo.load_robot("microbot")))
    >>> tau(*np.zeros((3, 5, 3))).shape
    (5, 3)
    >>> x, a = ca.SX.sym("x"), ca.SX.sym("a")
    >>> better = (x + a / x) / 2
    >>> step = ca.Function("heron", [x, a], [better, ca.fabs(better - x) > 1e-15])
    >>> root, _ = deferred_call(step, 50)([1.0], np.array([[2.0], [9.0]]))
    >>> root.round(6).tolist()
    [[1.414214], [3.0]]
    """
    _check_vectors(function)
    if most and (function.size_in(0) != function.size_out(0) or function.size_out(1) != (1, 1)):
        raise InputError(f"{function.name()} must return the next state, then one number")

    def extension(make: bool = True) -> FastCall | None:
        return _extension(function, most, make=make, kept=kept, alike=alike)

    fast = extension(make=False) if compiled else None
    inner = (function, *function.find_functions())
    in_python = any(part.class_name() == "CallbackInternal" for part in inner)
    spent = -np.inf if in_python or not compiled else 0.0  # a Python callback has no C code
    as_it_is = _as_it_is(function, most, kept, compiled, alike)

    def call(*given: Any) -> Any:
        nonlocal fast, spent
        if fast is None and spent > WORTH_COMPILING and compiles() and not deadline.over():
            fast = extension()
            if fast is None and not deadline.over():  # after a time limit, a later call tries again
                fast = as_it_is
        if fast is not None:
            return fast(*given)
        begin = time.thread_time()
        answer = as_it_is(*given)
        spent += time.thread_time() - begin
        return answer

    return call


@lru_cache(maxsize=128)
def table_call(function: ca.Function) -> FastCall:
    """Return a CasADi function as a numpy function of many states, evaluated as a table.

    Nothing is compiled for the function: one interpreter serves all. Without a compiler CasADi's
    virtual machine gives the same results more slowly.

    Parameters
    ----------
    function : casadi.Function
        Function as for :func:`deferred_call`.

    Raises
    ------
    InputError
        Errors of :func:`fast_call`.
    """
    _check_vectors(function)
    return _stand_in(function)


def rows_in_place(function: ca.Function) -> Callable[[int], RowsInPlace]:
    """Return the maker of memory for a number of rows of a function as for :func:`table_call`,
    whose outputs are vectors.
    """
    _check_vectors(function)
    prepared = _table_in_place(function)
    if prepared is not None:
        return prepared

    def mapped(rows: int) -> RowsInPlace:
        memory = _Memory(function.map(rows))
        inputs, outputs = ([array.T for array in side] for side in (memory.inputs, memory.outputs))
        return RowsInPlace(inputs, outputs, memory.run, (memory,))

    return mapped


def _check_vectors(function: ca.Function) -> None:
    for i in range(function.n_in()):
        if not (function.sparsity_in(i).is_dense() and function.size2_in(i) == 1):
            raise InputError(
                f"{function.name_in(i)} of {function.name()} must be a dense vector, not "
                f"{function.sparsity_in(i).dim()}"
            )
    if not all(function.sparsity_out(i).is_dense() for i in range(function.n_out())):
        raise InputError(f"every output of {function.name()} must be dense")


def _extension(
    function: ca.Function,
    most: int,
    *,
    make: bool = True,
    kept: bool = False,
    alike: bool = False,
) -> FastCall | None:
    """Return the function of the compiled module; None if it is not in the cache and not built.

    Sines and cosines come from this package; with ``alike`` from the C library, which gives the
    bits of CasADi's virtual machine.
    """
    headers = [sysconfig.get_path("include"), np.get_include()]
    cc = codegen.compiler() if compiles() else None
    if cc is None or not (Path(headers[0]) / "Python.h").exists():
        return None
    try:
        # The C text takes ten times as long as this identity, which finds a cached library.
        recipe = repr((function.serialize(), most, kept, alike, package()))
        library = build_library(
            lambda: _source(function, most, kept, alike),
            f"fast_{function.name()}",
            cc,
            "-O2",
            further=(*ROUNDED_ALIKE, *(f"-I{header}" for header in headers)),
            suffix=EXTENSION_SUFFIXES[0],
            serves=f"{sys.version} {np.__version__}",
            recipe=recipe,
            make=make,
        )
        return _load(function.name(), library)
    except (OSError, subprocess.SubprocessError, RuntimeError, ImportError):
        return None  # the caller evaluates the function uncompiled


def _source(function: ca.Function, most: int, kept: bool, alike: bool) -> str:
    """Return the C text of a module."""
    single, wide = ("", "") if alike else map(_sines_of, ("double", "vector"))
    return single + c_source([function]) + _glue(function, most, kept, wide)


def _sines_of(real: str) -> str:
    return TRIGONOMETRY.read_text("utf-8").replace("REAL", real)


def _glue(function: ca.Function, most: int, kept: bool, trigonometry: str) -> str:
    sizes, shapes = _sizes(function)
    wide = "" if kept else _wide(function)
    values = {
        "IN_SIZE": ", ".join(map(str, sizes)),
        "IN_NAME": ", ".join(f'"{name}"' for name in function.name_in()),
        "OUT_ROWS": ", ".join(str(rows) for rows, _ in shapes),
        "OUT_COLUMNS": ", ".join(str(columns) for _, columns in shapes),
        "SZ_ARG": function.sz_arg(),
        "SZ_RES": function.sz_res(),
        "SZ_W": function.sz_w() + 1,  # C has no arrays of length zero
        "SZ_IW": function.sz_iw() + 1,
        "N_IN": function.n_in(),
        "N_OUT": function.n_out(),
        "NAME": function.name(),
        "MOST": most,
        "KEPT": int(kept),
        "STATE": sizes[0],
        "IN_TOTAL": sum(sizes),
        "OUT_TOTAL": function.numel_out(),
        "HAS_WIDE": int(bool(wide)),
        "WIDE": wide,
        "TRIGONOMETRY": trigonometry,
    }
    text = GLUE.read_text("utf-8")
    for key, value in values.items():
        text = text.replace(f"@{key}@", str(value))
    return text


def _wide(function: ca.Function) -> str:
    """Return C statements that compute a function for a vector of states, from x to y.

    Empty if an operation is unknown. A compiler cannot vectorise CasADi's own code for one state,
    as it calls the sine of the C library.
    """
    table = table_of(function) if function.is_a("SXFunction") else None
    if table is None:
        return ""
    sizes, shapes = _sizes(function)
    inputs = np.cumsum([0, *sizes])
    outputs = np.cumsum([0, *(rows * columns for rows, columns in shapes)])
    lines = []
    for operation, to, one, two in table.code.tolist():
        if operation == ca.OP_INPUT:
            lines.append(f"a{to}=x[{inputs[one] + two}];")
        elif operation == ca.OP_OUTPUT:
            lines.append(f"y[{outputs[one] + two}]=a{to};")
        elif operation == ca.OP_CONST:
            lines.append(f"a{to}=NOTHING+{c_numbers([float(table.constants[one])])};")
        else:
            lines.append(f"a{to}={FORMULAS[operation].format(f'a{one}', f'a{two}')};")
    work = ", ".join(f"a{k}" for k in range(table.places))
    return "\n  ".join([f"vector {work};" if work else "", *lines])


def _sizes(function: ca.Function) -> tuple[list[int], list[tuple[int, int]]]:
    """Return the lengths of the inputs, which are vectors, and the shapes of the outputs."""
    shapes = [function.size_out(i) for i in range(function.n_out())]
    return [function.size1_in(i) for i in range(function.n_in())], shapes


def _load(name: str, library: Path) -> FastCall:
    loader = ExtensionFileLoader(name, str(library))
    spec = spec_from_file_location(name, library, loader=loader)
    assert spec is not None
    module = module_from_spec(spec)
    loader.exec_module(module)
    return getattr(module, name)


def buffered_call(function: ca.Function) -> FastCall:
    """Return a CasADi function, mapped or compiled ones too, as a function of numpy matrices.

    Nothing is compiled; only the conversion to CasADi's matrices is avoided, which costs 40 ns an
    entry and most of the time of a long ``map`` or ``mapaccum``.
    Parameters
    ----------
    function : casadi.Function
        Function with dense inputs and outputs.

    Returns
    -------
    callable
        Function of one array [rows,columns] ([rows] for a vector) for each input, which returns
        a new array for each output, several as a tuple.

    Raises
    ------
    InputError
        An input or output is sparse; in later calls, an array has a wrong shape.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> tau = mo.inverse_dynamics(mo.load_robot("microbot")).map(4)
    >>> buffered_call(tau)(np.zeros((3, 4)), np.zeros((3, 4)), np.zeros((3, 4))).shape
    (3, 4)
    """
    inputs = map(function.sparsity_in, range(function.n_in()))
    outputs = map(function.sparsity_out, range(function.n_out()))
    if not all(sparsity.is_dense() for sparsity in (*inputs, *outputs)):
        raise InputError(f"every input and output of {function.name()} must be dense")
    name, labels = function.name(), function.name_in()
    # Memories not in use: each call takes one, so threads do not share them.
    idle: list[_Memory] = []

    def call(*given: Any) -> Any:
        if len(given) != len(labels):
            raise InputError(f"{name} takes {len(labels)} arrays, not {len(given)}")
        try:
            used = idle.pop()
        except IndexError:
            used = _Memory(function)
        for label, memory, value in zip(labels, used.inputs, given, strict=True):
            array = np.asarray(value, dtype=float)
            if array.ndim < 2 and array.size == memory.size and memory.shape[1] == 1:
                array = array.reshape(-1, 1)
            if array.shape != memory.shape:
                raise InputError(
                    f"{label} of {name} must have shape {list(memory.shape)}, not "
                    f"{list(array.shape)}"
                )
            memory[...] = array
        used.run()
        answers = [memory.copy(order="K") for memory in used.outputs]
        idle.append(used)
        return answers[0] if len(answers) == 1 else tuple(answers)

    return call


class _Memory:
    """Work memory of one evaluation of a function."""

    def __init__(self, function: ca.Function) -> None:
        self.inputs = [np.zeros(function.size_in(i), order="F") for i in range(function.n_in())]
        self.outputs = [np.zeros(function.size_out(i), order="F") for i in range(function.n_out())]
        self._owner, self.run = function.buffer()  # run works in memory that the buffer owns
        for i, memory in enumerate(self.inputs):
            self._owner.set_arg(i, memoryview(memory.ravel("K")))  # pyright: ignore
        for i, memory in enumerate(self.outputs):
            self._owner.set_res(i, memoryview(memory.ravel("K")))  # pyright: ignore


def _by_table(
    function: ca.Function, alike: bool = True
) -> Callable[[int, list[FloatArray]], tuple[FloatArray, ...]] | None:
    """Return a function of many rows by an operation table, with transposed outputs.

    None if the function has no such table or the interpreter is missing.
    """
    prepared = _table_in_place(function, alike)
    if prepared is None:
        return None

    def call(rows: int, given: list[FloatArray]) -> tuple[FloatArray, ...]:
        memory = prepared(rows)
        for array, value in zip(memory.inputs, given, strict=True):
            array[...] = value
        memory.run()
        return tuple(array.T for array in memory.outputs)

    return call


def _table_in_place(
    function: ca.Function, alike: bool = True
) -> Callable[[int], RowsInPlace] | None:
    """Return the maker of memory for a number of rows, evaluated by an operation table.

    None if the function has no such table or the interpreter is missing.
    """
    table = table_of(function)
    if table is None:
        return None
    table = with_products(table)
    try:
        interpret = _interpreter(alike)
    except (OSError, subprocess.SubprocessError, RuntimeError):
        return None  # the caller uses CasADi's virtual machine
    sizes, shapes = _sizes(function)
    numels = [rows * columns for rows, columns in shapes]
    counts = [np.array(numbers, dtype=np.intc) for numbers in (sizes, numels)]
    code, constants = (array.ctypes.data for array in (table.code, table.constants))

    def prepared(rows: int) -> RowsInPlace:
        # The interpreter takes whole blocks of columns, so rows are padded with zeros.
        height = -(-rows // COLUMNS) * COLUMNS
        inputs = [np.zeros((height, size)) for size in sizes]
        outputs = [np.empty((height, size)) for size in numels]
        work = np.empty(COLUMNS * table.places + ALIGNMENT)
        places = [
            (ctypes.c_void_p * len(side))(*(array.ctypes.data for array in side))
            for side in (inputs, outputs)
        ]
        sides = [(len(side), array.ctypes.data) for side, array in zip(places, counts, strict=True)]
        end = code + table.code.nbytes
        given = height, code, end, constants, *sides[0], *sides[1], *places, work.ctypes.data
        before, after = ([array[:rows] for array in side] for side in (inputs, outputs))
        return RowsInPlace(before, after, partial(interpret, *given), (table, counts, work))

    return prepared


@lru_cache(maxsize=2)
def rows_library(alike: bool) -> CommonLibrary:
    """Return the interpreter's library, with sines of the C library (``alike``) or of ours."""
    text = ("" if alike else _sines_of("double")) + interpreter_text()
    return CommonLibrary("rows", text, ("-O3", *ROUNDED_ALIKE))


@lru_cache(maxsize=2)
def _interpreter(alike: bool) -> Callable[..., None]:
    """Return the interpreter of operation tables, which is compiled once for all functions.

    Parameters
    ----------
    alike : bool
        Kind of its sines, as for :func:`deferred_call`.

    Raises
    ------
    OSError, subprocess.SubprocessError, RuntimeError
        Errors of :meth:`CommonLibrary.path`.
    """
    run = ctypes.CDLL(str(rows_library(alike).path())).interpret_rows
    count, address = ctypes.c_long, ctypes.c_void_p
    side = (count, address)
    run.argtypes = (count, *(address,) * 3, *side, *side, *(address,) * 3)
    run.restype = None
    return run


def _stand_in(function: ca.Function, by_table: bool = True, alike: bool = True) -> FastCall:
    """Return the function of :func:`fast_call` without an extension module."""
    sizes, shapes = _sizes(function)
    single, many = buffered_call(function), _many_rows(function, by_table)
    if not alike and by_table and (table := _by_table(function, alike)) is not None:
        single, many = (lambda *arrays: table(1, [*arrays])), table

    def call(*given: Any) -> Any:
        arrays, rows = _vectors_or_batches(function, sizes, given)
        results = single(*arrays) if rows is None else many(rows, arrays)
        results = results if isinstance(results, tuple) else (results,)
        lead = () if rows is None else (rows,)
        answers = []
        for answer, (height, width) in zip(results, shapes, strict=True):
            # CasADi stores matrices by columns: a row of the batch holds the transposed matrix.
            blocks = answer.T.reshape(*lead, width, height)
            answers.append(blocks[..., 0, :] if width == 1 else blocks.swapaxes(-1, -2))
        return answers[0] if len(answers) == 1 else tuple(answers)

    return call


def _vectors_or_batches(
    function: ca.Function, sizes: list[int], given: Sequence[Any]
) -> tuple[list[FloatArray], int | None]:
    """Return the inputs as arrays [n] or [N,n], and N; None if there is no batch."""
    if len(given) != len(sizes):
        raise InputError(f"{function.name()} takes {len(sizes)} arrays, not {len(given)}")
    arrays, rows = [np.asarray(value, dtype=float) for value in given], None
    for label, size, array in zip(function.name_in(), sizes, arrays, strict=True):
        if array.ndim == 2 and array.shape[1] == size and rows in (None, len(array)):
            rows = len(array)
        elif array.ndim > 1 or array.size != size:
            raise InputError(
                f"{label} of {function.name()} must have shape [{size}] or [N, {size}], with the "
                f"same N in every batch, not {list(array.shape)}"
            )
    return arrays, rows


def _many_rows(
    function: ca.Function, by_table: bool
) -> Callable[[int, list[FloatArray]], FloatArray | tuple[FloatArray, ...]]:
    """Return a function of many rows with transposed outputs.

    It evaluates CasADi's map, and a table once the number of rows pays for building it.
    """
    sizes, shapes = _sizes(function)
    mapped = lru_cache(maxsize=1)(lambda rows: buffered_call(function.map(rows)))
    table = lru_cache(maxsize=1)(lambda: _by_table(function) if by_table else None)
    seen = 0

    def call(rows: int, arrays: list[FloatArray]) -> FloatArray | tuple[FloatArray, ...]:
        nonlocal seen
        seen += rows
        if not rows:
            return tuple(np.zeros((height, 0)) for height, _ in shapes)
        if seen > WORTH_A_TABLE and (fast := table()) is not None:
            return fast(rows, arrays)
        wide = [np.broadcast_to(a, (rows, s)).T for a, s in zip(arrays, sizes, strict=True)]
        return mapped(rows)(*wide)

    return call


def _repeated(single: FastCall, most: int) -> FastCall:
    """Return a function that repeats another as :func:`deferred_call` says, without an extension
    module.
    """

    def call(*given: Any) -> Any:
        arrays = [np.asarray(value, dtype=float) for value in given]
        counts = [len(array) for array in arrays if array.ndim == 2]
        size = max(counts, default=1)
        wide = [np.array(np.broadcast_to(array, (size, array.shape[-1]))) for array in arrays]
        answers = single(*wide)
        for _ in range(most - 1):
            going = np.flatnonzero(answers[1][:, 0] > 0)
            if not going.size:
                break
            again = single(answers[0][going], *(array[going] for array in wide[1:]))
            for answer, part in zip(answers, again, strict=True):
                answer[going] = part
        return answers if counts else tuple(answer[0] for answer in answers)

    return call


def _as_it_is(
    function: ca.Function, most: int, kept: bool, by_table: bool, alike: bool
) -> FastCall:
    """Return the function of :func:`deferred_call` without an extension module."""
    single = _stand_in(function, by_table, alike)
    chained = lru_cache(maxsize=1)(lambda rows: buffered_call(function.mapaccum(rows, NESTED)))

    def repeated(*given: Any) -> tuple[FloatArray, ...]:
        calls = [single(*given)]
        while len(calls) < most and calls[-1][1][0] > 0:
            calls.append(single(calls[-1][0], *given[1:]))
        return tuple(map(np.array, zip(*calls, strict=True)))

    def along_rows(first: Any, *given: Any) -> Any:
        answers = chained(len(given[0]))(first, *(np.transpose(rows) for rows in given))
        return tuple(a.T for a in answers) if isinstance(answers, tuple) else answers.T

    if kept:
        return repeated if most else along_rows
    return _repeated(single, most) if most else single
