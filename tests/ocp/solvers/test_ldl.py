"""The linear solver without pivoting: against numpy, inside IPOPT, and where it cannot be used."""

import ctypes
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from helpers import warned
from microbot_ocp import ocp
from microbot_ocp._base import codegen
from microbot_ocp.ocp.solvers import _chain, _ldl

pytestmark = pytest.mark.skipif(
    _ldl.linear_solver_library() is None, reason="no C compiler, or no AMD"
)
ASKED = ocp.SolverSettings("ipopt", options={"ipopt": {"linear_solver": "ldl"}})


def solved(matrix, right, order=None):
    """Solution, and how many eigenvalues are negative, by the interface that IPOPT calls."""
    library = ctypes.CDLL(str(_ldl.linear_solver_library()))
    n = len(matrix)
    rows, columns = np.nonzero(np.triu(matrix != 0) | np.eye(n, dtype=bool))
    rng = np.random.default_rng(0)
    shuffled = rng.permutation(rows.size)
    rows, columns = rows[shuffled], columns[shuffled]
    irn, icn = (rows + 1).astype(np.int32), (columns + 1).astype(np.int32)
    values = matrix[rows, columns]

    def ints(count):
        return np.zeros(count, np.int32)

    def call(name, *arguments):
        given = [
            a.ctypes.data_as(ctypes.c_void_p)
            if isinstance(a, np.ndarray)
            else ctypes.byref(ctypes.c_int(a))
            for a in arguments
        ]
        getattr(library, name)(*given)

    icntl, cntl, info, keep = ints(30), np.zeros(5), ints(20), ints(3 * n)
    steps, ops, front = ints(1), np.zeros(1), ints(1)
    call("ma27id_", icntl, cntl)
    call(
        "ma27ad_", n, rows.size, irn, icn, ints(1), 1, keep, ints(2 * n), steps, 0, icntl, cntl,
        info, ops,
    )  # fmt: skip
    assert info[0] == 0
    a, iw = np.zeros(info[4]), ints(info[5])
    a[: rows.size] = values
    call(
        "ma27bd_", n, rows.size, irn, icn, a, a.size, iw, iw.size, keep, steps, front, ints(n),
        icntl, cntl, info,
    )  # fmt: skip
    assert info[0] == 0
    x = np.array(right, float)
    call("ma27cd_", n, a, a.size, iw, iw.size, np.zeros(1), front, x, ints(1), steps, icntl, cntl)
    return x, int(info[14])


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 12), st.integers(0, 8), st.floats(-3, 3))
def test_saddle_points_are_solved_and_their_signs_counted(seed, primal, dual, size):
    rng = np.random.default_rng(seed)
    dual = min(dual, primal)
    h = rng.normal(size=(primal, primal)) * (rng.uniform(size=(primal, primal)) < 0.4)
    h = 10.0**size * (h + h.T) + np.diag(rng.normal(size=primal))
    a = np.hstack([np.eye(dual), rng.normal(size=(dual, primal - dual))])
    matrix = np.block([[h, a.T], [a, np.zeros((dual, dual))]])
    eigenvalues = np.linalg.eigvalsh(matrix)
    if abs(eigenvalues).min() < 1e-3 * abs(eigenvalues).max():
        return  # nearly singular
    right = rng.normal(size=primal + dual)
    x, negative = solved(matrix, right)
    assert negative == (eigenvalues < 0).sum()
    assert np.abs(matrix @ x - right).max() < 1e-8 * np.abs(right).max()


def pendulum():
    problem = ocp.OptimalControlProblem("swing")
    phase = problem.phase("all", (0.5, 10.0))
    angle = phase.state("angle", initial=0.0, final=np.pi)
    speed = phase.state("speed", initial=0.0, final=0.0)
    torque = phase.control("torque", lower=-2.0, upper=2.0)
    phase.derivative(angle, speed)
    phase.derivative(speed, torque - ca.sin(angle))
    phase.end_cost(phase.duration)
    return problem


def test_ipopt_takes_the_same_iterations_with_it():
    usual, own = (
        ocp.solve(pendulum(), 30, settings=chosen) for chosen in (replace(ASKED, options={}), ASKED)
    )
    assert own.status.solved
    assert own.cost == pytest.approx(usual.cost, rel=1e-6)
    assert abs(own.attempts[0].iterations - usual.attempts[0].iterations) <= 3


def test_without_a_compiler_mumps_solves(monkeypatch):
    for module in (_ldl, codegen):
        monkeypatch.setattr(module, "compiler", lambda: None)
    assert "hsllib" not in _ldl.as_ipopt_knows({"linear_solver": "ldl"})


@pytest.mark.parametrize("name", [_ldl.NAME, _ldl.BAND])
def test_a_compiler_that_fails_is_asked_once(monkeypatch, name):
    asked = []

    def fails(*_, **__):
        asked.append(1)
        raise RuntimeError("it ended with status 1")

    monkeypatch.setattr(_ldl, "_known", {})
    monkeypatch.setattr(codegen, "_found", {})
    monkeypatch.setattr(codegen, "build_library", fails)
    with warned("MUMPS", name, "status 1", category=codegen.NotCompiled):
        assert _ldl.linear_solver_library(name) is None
    assert _ldl.linear_solver_library(name) is None
    assert "hsllib" not in _ldl.as_ipopt_knows({"linear_solver": name})
    assert len(asked) == 1


def test_mumps_is_tried_where_ipopt_breaks_down_with_it(monkeypatch):
    broken = {"linear_solver": "ma27", "hsllib": "/nowhere/library.so"}
    usual = _ldl.as_ipopt_knows
    monkeypatch.setattr(
        "microbot_ocp.ocp.solvers._plugins.as_ipopt_knows",
        lambda options: {**usual(options), **(broken if "linear_solver" in options else {})},
    )
    solution = ocp.solve(pendulum(), 20, settings=ASKED)
    assert solution.status.solved
    assert [str(a.status) for a in solution.attempts[:2]] == ["failed", "solved"]
    assert _chain.asks_for_ldl(ASKED.options)
