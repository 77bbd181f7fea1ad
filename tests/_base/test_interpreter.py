"""Functions of many columns, interpreted in blocks: equal to the virtual machine's to the bit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from helpers import sampled
from microbot_ocp._base import codegen, interpreter
from microbot_ocp._base.codegen import compile_recipe

pytestmark = pytest.mark.skipif(codegen.compiler() is None, reason="no C compiler")


def in_blocks(*functions: ca.Function) -> tuple[ca.Function, ...]:
    recipe = " ".join(function.serialize() for function in functions)
    return compile_recipe(recipe, lambda: functions, columns=True)


def stage() -> ca.Function:
    """Return a function with a sparse Jacobian, constants, and a number that is an output, too."""
    v, c = ca.SX.sym("v", 4), ca.SX.sym("c", 2)
    rows = ca.vertcat(c[0] * v[0] ** 3 + 0.1, ca.sin(v[1] * v[2]), v[3], ca.inf)
    return ca.Function("stage", [v, c], [rows, ca.jacobian(rows, v), c[1] * ca.sumsqr(v), c[1]])


def results(function: ca.Function, count: int, *given: np.ndarray) -> list[np.ndarray]:
    mapped = function.map(count)
    assert isinstance(mapped, ca.Function)
    return [np.array(ca.DM(value)) for value in mapped.call([ca.DM(table) for table in given])]


@pytest.mark.parametrize("count", [1, 2, interpreter.COLUMNS, 2 * interpreter.COLUMNS + 1])
def test_blocks_have_the_bits_of_the_virtual_machine(count: int) -> None:
    plain = stage()
    (blocked,) = in_blocks(plain)
    assert isinstance(blocked, interpreter.ManyColumns)
    draw = np.random.default_rng(0)
    given = draw.normal(size=(4, count)), draw.normal(size=(2, count))
    for ours, expected in zip(
        results(blocked, count, *given), results(plain, count, *given), strict=True
    ):
        np.testing.assert_array_equal(ours, expected)
    threads = blocked.map(count, "thread", 2)
    np.testing.assert_array_equal(np.array(threads(*given)[0]), results(plain, count, *given)[0])


def test_a_cost_alone_is_what_it_is_with_the_rest() -> None:
    plain = stage()
    (blocked,) = in_blocks(plain)
    v, c = ca.MX.sym("v", 4, 40), ca.MX.sym("c", 2, 40)
    given = np.random.default_rng(1).normal(size=(4, 40)), np.ones((2, 40))
    for output in range(4):
        ours, expected = (
            ca.Function("one", [v, c], [f.map(40).call([v, c])[output]]) for f in (blocked, plain)
        )
        np.testing.assert_array_equal(np.array(ours(*given)), np.array(expected(*given)))


def test_every_operation_is_that_of_casadi() -> None:
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    one = (
        *("sqrt", "exp", "log", "floor", "ceil", "erf", "expm1", "log1p", "fabs", "sign"),
        *("sin", "cos", "tan", "asin", "acos", "atan", "logic_not"),
        *("sinh", "cosh", "tanh", "asinh", "acosh", "atanh"),
    )
    two = ("fmin", "fmax", "atan2", "copysign", "fmod", "hypot", "logic_and", "logic_or")
    values: list[Any] = [getattr(ca, name)(x) for name in one]
    values += [getattr(ca, name)(x, y) for name in two]
    values += [x + y, x - y, x * y, x / y, -x, x * x, 2 * x, 1 / x, x**y, x**2.5]
    values += [x < y, x <= y, x == y, x != y, ca.if_else(x, y, 0.0)]
    plain = ca.Function("every", [x, y], [ca.vertcat(*values)])
    (blocked,) = in_blocks(plain)
    assert isinstance(blocked, interpreter.ManyColumns)
    special = [-2.0, -0.3, -0.0, 0.0, 0.3, 1.0, 2.5, np.inf, -np.inf, np.nan]
    table = np.array(np.meshgrid(special, special)).reshape(2, -1)
    for count in (1, table.shape[1]):
        given = table[:1, :count], table[1:, :count]
        (ours,), (expected,) = (results(f, count, *given) for f in (blocked, plain))
        np.testing.assert_array_equal(ours, expected)


def test_what_has_no_scalar_graph_is_compiled_as_it_is() -> None:
    table = ca.interpolant("table", "bspline", [[0.0, 1.0, 2.0, 3.0, 4.0]], [0.0, 1, 4, 9, 16])
    x = ca.MX.sym("x")
    (compiled,) = in_blocks(ca.Function("looked_up", [x], [table(x)]))
    assert not isinstance(compiled, interpreter.ManyColumns)
    assert float(compiled(1.5)) == pytest.approx(2.25)


def test_the_library_is_found_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MICROBOT_OCP_CACHE", str(tmp_path / "compiled"))
    plain = stage()
    in_blocks(plain)

    def refuse() -> list[ca.Function]:
        raise AssertionError("made again")

    (again,) = compile_recipe(plain.serialize(), refuse, columns=True)
    assert isinstance(again, interpreter.ManyColumns)
    assert np.array(again([1.0, 2.0, 3.0, 4.0], [1.0, 2.0])[2]).item() == 60.0


@pytest.mark.parametrize("seed", sampled(range(4), 4))
def test_sums_of_products_have_the_bits_of_the_virtual_machine(seed: int) -> None:
    random = np.random.default_rng(seed)
    x = ca.SX.sym("x", 6)
    values = ca.vertsplit(x)
    for _ in range(300):
        one, two, three, four = (values[k] for k in random.integers(len(values), size=4))
        product = one * two
        makers = (product + three, product - three, three - product, product + three * four)
        makers += (product - three * four, product, one + two, product + product, product * product)
        values.append(ca.tanh(makers[random.integers(len(makers))]))
        if random.integers(3) == 0:
            values.append(makers[random.integers(len(makers))] / 4)
    plain = ca.Function("products", [x], [ca.vertcat(*values)])
    table = interpreter.table_of(plain)
    assert table is not None
    assert len(interpreter.with_products(table).code) < len(table.code)
    (blocked,) = in_blocks(plain)
    given = random.uniform(-1, 1, (6, 40))
    np.testing.assert_array_equal(results(blocked, 40, given), results(plain, 40, given))
