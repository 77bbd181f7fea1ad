"""Numpy calls of CasADi functions: the extension module and what stands in for it."""

from __future__ import annotations

import inspect
import sysconfig
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import microbot_ocp as mo
from helpers import refused, sampled
from microbot_ocp._base import fast_calls
from microbot_ocp._base.codegen import interpreted
from microbot_ocp._base.fast_calls import FastCall, buffered_call, deferred_call

ROBOT = mo.load_robot("microbot")
FUNCTIONS = {
    "one vector": mo.inverse_dynamics(ROBOT),
    "a matrix": mo.mass_matrix(ROBOT),
    "two matrices": mo.velocity_propagation(ROBOT),
    "two scalars": mo.energy(ROBOT),
    "with a division": mo.forward_dynamics(ROBOT),
}
ROWS = 19  # two registers full of states and a rest, whatever the machine's width


needs_compiler = pytest.mark.skipif(mo.compiler() is None, reason="no C compiler")


@pytest.fixture(params=[pytest.param("extension", marks=needs_compiler), "buffer"])
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> str:
    if request.param == "buffer":
        monkeypatch.setattr(sysconfig, "get_path", lambda name: str(tmp_path / name))
    elif not (Path(sysconfig.get_path("include")) / "Python.h").exists():
        pytest.skip("this Python came without its headers")
    return request.param


def fresh(function: ca.Function) -> FastCall:
    """Not from the cache of another test."""
    return mo.fast_call.__wrapped__(function)


def states(function: ca.Function) -> list[np.ndarray]:
    random = np.random.default_rng(5)
    return [
        random.uniform(-1, 1, (ROWS, rows))
        for rows, _ in map(function.size_in, range(function.n_in()))
    ]


def expected(function: ca.Function, state: list[np.ndarray]) -> list[np.ndarray]:
    answers = [np.array(matrix) for matrix in function.call(state)]
    return [answer[:, 0] if answer.shape[1] == 1 else answer for answer in answers]


def as_tuple(answer: np.ndarray | tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
    return answer if isinstance(answer, tuple) else (answer,)


@pytest.mark.parametrize("kind", sampled(FUNCTIONS, 2))
def test_agrees_with_casadi(kind: str, way: str) -> None:
    function = FUNCTIONS[kind]
    call = fresh(function)
    assert inspect.isbuiltin(call) == (way == "extension")
    batch = states(function)
    wanted = [expected(function, [rows[i] for rows in batch]) for i in range(ROWS)]
    for output, answer in enumerate(as_tuple(call(*batch))):
        np.testing.assert_allclose(answer, [row[output] for row in wanted], rtol=0, atol=1e-11)
    for output, answer in enumerate(as_tuple(call(*(rows[0] for rows in batch)))):
        np.testing.assert_allclose(answer, wanted[0][output], rtol=0, atol=1e-11)


def test_converts_what_is_not_contiguous_float64(way: str) -> None:
    call = fresh(FUNCTIONS["one vector"])
    q, qd, qdd = states(FUNCTIONS["one vector"])
    turned = np.asfortranarray(q)
    np.testing.assert_array_equal(call(turned, qd, qdd), call(q, qd, qdd))
    rest = [0.0, 0.0, 0.0]
    converted = call([0, 0, 1], (0, 0, 0), np.zeros(6)[::2])
    np.testing.assert_array_equal(converted, call(np.array([0.0, 0.0, 1.0]), rest, rest))


def test_one_state_stands_for_every_row(way: str) -> None:
    call = fresh(FUNCTIONS["one vector"])
    q, qd, qdd = states(FUNCTIONS["one vector"])
    repeated = np.tile(qd[0], (ROWS, 1))
    np.testing.assert_array_equal(call(q, qd[0], qdd), call(q, repeated, qdd))


def test_answers_are_new_arrays(way: str) -> None:
    call = fresh(FUNCTIONS["one vector"])
    first = call([0, 0, 0], [0, 0, 0], [0, 0, 0])
    kept = first.copy()
    call([1, 1, 1], [0, 0, 0], [0, 0, 0])
    np.testing.assert_array_equal(first, kept)


def test_no_rows(way: str) -> None:
    empty = np.zeros((0, 3))
    assert fresh(FUNCTIONS["a matrix"])(empty).shape == (0, 3, 3)


@pytest.mark.parametrize(
    ("arrays", "said"),
    [
        ((np.zeros(3), np.zeros(3)), ("inverse_dynamics", "3 arrays", "not 2")),
        (
            (np.zeros(3), np.zeros(4), np.zeros(3)),
            ("qd of inverse_dynamics", "[3]", "[N, 3]", "not [4]"),
        ),
        (
            (np.zeros((2, 3)), np.zeros((3, 3)), np.zeros(3)),
            ("qd of inverse_dynamics", "[3]", "[N, 3]", "not [3, 3]"),
        ),
        (
            (np.zeros((2, 3, 1)), np.zeros(3), np.zeros(3)),
            ("q of inverse_dynamics", "[3]", "[N, 3]", "not [2, 3, 1]"),
        ),
    ],
)
def test_wrong_shapes(arrays: tuple[np.ndarray, ...], said: tuple[str, ...], way: str) -> None:
    with refused(*said):
        fresh(FUNCTIONS["one vector"])(*arrays)


def test_functions_of_matrices_are_refused() -> None:
    matrix = ca.SX.sym("matrix", 2, 2)
    with refused("matrix of f", "dense vector", "2x2"):
        mo.fast_call(ca.Function("f", [matrix], [ca.densify(matrix[:, 0])], ["matrix"], ["column"]))
    vector = ca.SX.sym("vector", 2)
    with refused("output of f", "dense"):
        mo.fast_call(ca.Function("f", [vector], [ca.diag(vector)], ["vector"], ["diagonal"]))


def test_buffered_call_takes_matrices() -> None:
    total, value = ca.SX.sym("total"), ca.SX.sym("value", 2)
    sums = ca.Function("sums", [total, value], [total + value[0] * value[1]]).mapaccum(4)
    values = np.arange(8.0).reshape(2, 4)
    call = buffered_call(sums)
    np.testing.assert_array_equal(call(1.0, values), np.array(sums(1.0, values)))
    np.testing.assert_array_equal(
        call([2.0], values[:, ::-1]), np.array(sums(2.0, values[:, ::-1]))
    )


def test_buffered_call_checks_shapes() -> None:
    call = buffered_call(FUNCTIONS["one vector"])
    with refused("inverse_dynamics", "3 arrays", "not 1"):
        call([0, 0, 0])
    with refused("qd of inverse_dynamics", "[3, 1]", "not [4]"):
        call([0, 0, 0], [0, 0, 0, 0], [0, 0, 0])
    diagonal = ca.SX.sym("vector", 2)
    with refused("input", "output of f", "dense"):
        buffered_call(ca.Function("f", [diagonal], [ca.diag(diagonal)]))


# ---- loops


def rest_of_division() -> ca.Function:
    """Subtract ``b`` from the state until its first entry is not above ``b``; counts calls."""
    x, b = ca.SX.sym("x", 2), ca.SX.sym("b")
    after = ca.vertcat(x[0] - b, x[1] + 1)
    return ca.Function("rest_of_division", [x, b], [after, after[0] > b, 2 * after], ["x", "b"],
                       ["after", "going", "double"])  # fmt: skip


def test_a_loop_ends_where_it_says_or_at_its_most(way: str, monkeypatch) -> None:
    monkeypatch.setattr(fast_calls, "WORTH_COMPILING", -1.0)
    loop = deferred_call.__wrapped__(rest_of_division(), 10)
    after, going, double = loop([7.0, 0.0], [2.0])
    assert (after.tolist(), going.tolist(), double.tolist()) == ([1.0, 3.0], [0.0], [2.0, 6.0])
    after, going, _ = loop([100.0, 0.0], [2.0])
    assert (after.tolist(), going.tolist()) == ([80.0, 10.0], [1.0])
    first = np.array([[7.0, 0.0], [100.0, 0.0], [1.0, 5.0]])
    after, going, double = loop(first, [2.0])
    assert after.tolist() == [[1.0, 3.0], [80.0, 10.0], [-1.0, 6.0]]
    assert going.tolist() == [[0.0], [1.0], [0.0]]
    np.testing.assert_array_equal(double, 2 * after)
    assert first[0].tolist() == [7.0, 0.0]
    after, _, _ = loop([7.0, 0.0], np.array([[2.0], [3.0]]))
    assert after.tolist() == [[1.0, 3.0], [1.0, 2.0]]
    assert loop(np.zeros((0, 2)), [2.0])[0].shape == (0, 2)


def test_rows_of_a_loop_end_after_as_many_calls_as_alone(way: str, monkeypatch) -> None:
    monkeypatch.setattr(fast_calls, "WORTH_COMPILING", -1.0)
    loop = deferred_call.__wrapped__(rest_of_division(), 10)
    first = np.column_stack([np.random.default_rng(2).uniform(0, 30, 5 * ROWS), np.zeros(5 * ROWS)])
    alone = [loop(row, [2.0]) for row in first]
    for together, each in zip(loop(first, [2.0]), zip(*alone, strict=True), strict=True):
        np.testing.assert_array_equal(together, np.array(each))
    assert np.unique(loop(first, [2.0])[0][:, 1]).size == 10


def test_every_operation_of_many_states_has_the_bits_of_one(way: str) -> None:
    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    unary = (ca.sin, ca.cos, ca.tan, ca.exp, ca.tanh, ca.floor, ca.ceil, ca.fabs, ca.atan)
    terms = [f(a) for f in unary] + [f(ca.fabs(a)) for f in (ca.sqrt, ca.log)]
    terms += [f(a / 100) for f in (ca.asin, ca.acos)] + [a + b, a - b, a * b, a / b, -a, a**2]
    terms += [2 * a, 1 / a, a < b, a <= b, a == b, a != b, ca.logic_not(a), ca.atan2(a, b)]
    terms += [ca.logic_and(a, b), ca.logic_or(a, b), ca.if_else(a < b, a, 3.0), ca.fmin(a, b)]
    terms += [ca.fmax(a, b), ca.if_else(a > 0, ca.inf, -0.5)]
    function = ca.Function("operations", [a, b], [ca.vertcat(*terms)])
    call = fresh(function)
    values = np.random.default_rng(4).uniform(-50, 50, (4 * ROWS, 2))
    values[:8] = [[0, 0], [1, 1], [0, 2], [3, 0], [np.nan, 1], [1, np.nan], [np.inf, 1], [-1, -1]]
    values[11::17] *= 1e6  # the sine of such an angle is the C library's, those beside it are not
    together = call(values[:, :1].copy(), values[:, 1:].copy())
    alone = np.array([call(*(np.array([number]) for number in row)) for row in values])
    np.testing.assert_array_equal(together, alone)


def test_a_loop_needs_a_state_and_a_number() -> None:
    x = ca.SX.sym("x", 2)
    with refused("wrong", "next state", "one number"):
        deferred_call(ca.Function("wrong", [x], [x, x]), 3)


@needs_compiler
def test_a_deferred_call_compiles_once_that_pays(monkeypatch):
    x = ca.SX.sym("x", 3)
    factor = np.random.default_rng().uniform()  # compiled never before
    function = ca.Function("once", [x], [factor * ca.sin(x), ca.cos(x)])
    made, build_library = [], fast_calls.build_library

    def built(*given, make, **named):
        if make:
            made.append(function.name())
        return build_library(*given, make=make, **named)

    monkeypatch.setattr(fast_calls, "build_library", built)
    monkeypatch.setattr(fast_calls, "WORTH_COMPILING", 0.0)
    call, rows = deferred_call(function), np.random.default_rng(0).normal(size=(ROWS, 3))
    as_it_is = call(rows)
    assert not made
    assert [part.shape for part in call(rows[:0])] == [(0, 3)] * 2  # some time has been spent
    assert made == ["once"]
    for before, after in zip(as_it_is, call(rows), strict=True):
        np.testing.assert_array_equal(before, after)
    again = deferred_call.__wrapped__(function)  # as in another process
    np.testing.assert_array_equal(again(rows)[0], as_it_is[0])
    assert made == ["once"]


@needs_compiler
def test_a_deferred_call_that_had_no_time_to_compile_tries_again(monkeypatch):
    x = ca.SX.sym("x", 2)
    call = deferred_call.__wrapped__(ca.Function("later", [x], [ca.sin(x)]))
    attempts, over = [], iter([False, True, False, False])
    monkeypatch.setattr(fast_calls, "WORTH_COMPILING", -1.0)
    monkeypatch.setattr(fast_calls, "_extension", lambda *_, **__: attempts.append(1))
    monkeypatch.setattr(fast_calls.deadline, "over", lambda: next(over))
    for _ in range(4):  # the first attempt ends with the time, the second for another reason
        np.testing.assert_array_equal(call([0.0, 0.0]), [0.0, 0.0])
    assert len(attempts) == 2


def test_compiled_torques_have_the_bits_of_those_that_are_not(monkeypatch):
    monkeypatch.setattr(fast_calls, "WORTH_COMPILING", 0.0)
    function = mo.inverse_dynamics(mo.load_robot("microbot"))
    states = np.random.default_rng(0).normal(size=(3, ROWS, 3))
    as_it_is = np.array(function(*(state.T for state in states))).T
    call = deferred_call.__wrapped__(function)
    for _ in range(2):  # the second time it is compiled
        np.testing.assert_array_equal(call(*states), as_it_is)


@pytest.mark.parametrize("kind", ["a matrix", "two matrices"])
def test_own_sines_have_the_same_bits_before_and_after_it_is_compiled(monkeypatch, kind):
    function = FUNCTIONS[kind]
    rows = [5.0 * state for state in states(function)]
    rows[0][3] *= 1e7  # the sine of such an angle is the C library's
    call = deferred_call.__wrapped__(function, alike=False)
    expected = [as_tuple(fresh(function)(*given)) for given in (rows, [row[0] for row in rows])]
    for worth in (np.inf, -1.0):
        monkeypatch.setattr(fast_calls, "WORTH_COMPILING", worth)
        for given, answers in zip((rows, [row[0] for row in rows]), expected, strict=True):
            for ours, answer in zip(as_tuple(call(*given)), answers, strict=True):
                np.testing.assert_array_equal(ours, answer)


@pytest.mark.skipif(np.finfo(np.longdouble).nmant < 63, reason="nothing more precise is at hand")
@pytest.mark.parametrize("largest", [1.0, 1e3, 1e6, 1e12])
def test_sines_are_right_to_three_units_in_the_last_place(largest):
    x = ca.SX.sym("x")
    call = mo.fast_call(ca.Function("turn", [x], [ca.vertcat(ca.sin(x), ca.cos(x))]))
    random = np.random.default_rng(0)
    quarters = np.round(random.uniform(-largest, largest, 20_000)) * (np.pi / 2)  # cancel most
    for angles in (random.uniform(-largest, largest, 20_000), quarters, np.nextafter(quarters, 0)):
        exact = np.column_stack([f(angles.astype(np.longdouble)) for f in (np.sin, np.cos)])
        error = np.abs(call(angles[:, None]) - exact)
        assert np.all(error < 3 * np.spacing(np.abs(exact.astype(float))))


def test_a_deferred_call_of_python_is_never_compiled(monkeypatch):
    class Twice(ca.Callback):
        def __init__(self):
            ca.Callback.__init__(self)
            self.construct("twice", {})

        def eval(self, arguments):
            return [2 * arguments[0]]

    monkeypatch.setattr(fast_calls, "WORTH_COMPILING", 0.0)
    twice, x = Twice(), ca.MX.sym("x")
    call = deferred_call(ca.Function("of_python", [x], [twice(x)]))
    for _ in range(2):  # the second call would compile, and warn that it cannot
        assert call(np.ones((ROWS, 1))).tolist() == [[2.0]] * ROWS


def test_a_deferred_call_without_a_compiler():
    with interpreted():
        call = deferred_call.__wrapped__(FUNCTIONS["one vector"])
        rows = np.random.default_rng(0).normal(size=(ROWS, 3))
        expected = mo.fast_call(FUNCTIONS["one vector"])(rows, rows, rows)
        np.testing.assert_allclose(call(rows, rows, rows), expected, rtol=1e-12)
        assert call(rows[:0], rows[:0], rows[:0]).shape == (0, 3)


@needs_compiler
def test_a_repetition_whose_calls_are_kept_ends_where_it_says_or_at_its_most(monkeypatch):
    x, a = ca.SX.sym("x", 2), ca.SX.sym("a")
    step = [a * x, x[0] < 7, ca.sin(x)]  # goes on from 1, 2, 4
    function = ca.Function("doubled", [x, a], [ca.densify(part) for part in step])
    as_it_is = deferred_call.__wrapped__(function, 5, True)([1.0, 3.0], [2.0])
    monkeypatch.setattr(fast_calls, "WORTH_COMPILING", -1.0)
    for most, left in ((5, 4), (3, 3), (1, 1)):
        states, going, kept = deferred_call.__wrapped__(function, most, True)([1.0, 3.0], [2.0])
        assert states[:, 0].tolist() == [2.0, 4.0, 8.0, 16.0][:left]
        assert going[:, 0].tolist() == [1.0, 1.0, 1.0, 0.0][:left]
        np.testing.assert_array_equal(kept, as_it_is[2][:left])
    with refused("doubled", "one state", "batch"):
        deferred_call.__wrapped__(function, 5, True)(np.ones((2, 2)), [2.0])


def test_rows_are_read_in_place_in_any_order(way: str) -> None:
    table = np.random.default_rng(0).normal(size=(ROWS, 5))
    before = table.copy()
    x, y = ca.SX.sym("x", 2), ca.SX.sym("y", 3)
    call = fresh(ca.Function("in_any_order", [x, y], [x * y[1:]]))
    for rows in (slice(None, None, -1), slice(None, None, 2), np.zeros(ROWS, dtype=int)):
        given = table[rows]
        np.testing.assert_array_equal(call(given[:, :2], given[:, 2:]), given[:, :2] * given[:, 3:])
    np.testing.assert_array_equal(table, before)
    repeated = np.broadcast_to(table[0], table.shape)
    np.testing.assert_array_equal(call(repeated[:, :2], table[:, 2:]), table[0, :2] * table[:, 3:])


@needs_compiler
def test_a_chain_goes_along_the_rows_from_one_state(monkeypatch):
    x, a, b = ca.SX.sym("x", 2), ca.SX.sym("a"), ca.SX.sym("b", 2)
    function = ca.Function("chain", [x, a, b], [a * x + b, ca.sin(x)])
    random = np.random.default_rng(0)
    rows, one = random.normal(size=(5, 1)), random.normal(size=2)
    expected = [np.array([1.0, 3.0])]
    for row in rows:
        expected.append(row * expected[-1] + one)
    monkeypatch.setattr(fast_calls, "WORTH_COMPILING", -1.0)
    for compiled in (False, True):
        call = deferred_call(function, kept=True, compiled=compiled)
        states, other = call([1.0, 3.0], rows, np.tile(one, (5, 1)))
        np.testing.assert_allclose(states, expected[1:], rtol=1e-15)
        np.testing.assert_allclose(other, np.sin(expected[:-1]), rtol=1e-15)
    with refused("chain", "one state", "batch"):
        call(np.ones((5, 2)), rows, np.tile(one, (5, 1)))


def test_a_call_that_is_not_to_be_compiled_is_not(monkeypatch):
    monkeypatch.setattr(fast_calls, "WORTH_COMPILING", -1.0)
    monkeypatch.setattr(fast_calls, "_extension", None)
    x = ca.SX.sym("x")
    call = deferred_call(ca.Function("plain", [x], [2 * x]), compiled=False)
    assert call(np.ones((2, 1))).tolist() == [[2.0], [2.0]]


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("rows", [1, 31, 32, 65])
def test_rows_in_place_are_evaluated_again_where_they_stand(monkeypatch, rows, compiled):
    if not compiled:
        monkeypatch.setattr(fast_calls, "_table_in_place", lambda function: None)
    x, y = ca.SX.sym("x", 3), ca.SX.sym("y")
    memory = fast_calls.rows_in_place(ca.Function("f", [x, y], [ca.sin(x) * y, ca.sumsqr(x)]))(rows)
    random = np.random.default_rng(rows)
    for _ in range(3):
        at, factor = random.normal(size=(rows, 3)), random.normal(size=(rows, 1))
        memory.inputs[0][...], memory.inputs[1][...] = at, factor
        memory.run()
        np.testing.assert_allclose(memory.outputs[0], np.sin(at) * factor, atol=1e-14)
        np.testing.assert_allclose(memory.outputs[1][:, 0], (at**2).sum(axis=1), atol=1e-13)
