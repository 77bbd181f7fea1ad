"""Stages that call heavy functions are differentiated by the chain rule."""

import casadi as ca
import numpy as np
import pytest

from helpers import sampled
from microbot_ocp.ocp import OptimalControlProblem, Transcription
from microbot_ocp.ocp.transcription import _composition, _kernels


def heavy(name):
    """A function of two arguments with more operations than are written out."""
    x, u = ca.SX.sym("x", 3), ca.SX.sym("u", 2)
    value = ca.vertcat(x, u)
    for turn in range(20):
        value = ca.sin(value + 0.1 * turn) + 0.3 * value[[1, 2, 3, 4, 0]] * value
    return ca.Function(name, [x, u], [value[:2], value[2:]])


def problem(*, mixed):
    function, other = heavy("one"), heavy("other")
    problem = OptimalControlProblem("heavy")
    phase = problem.phase("move", duration=(0.5, 2.0))
    x = phase.state("x", 3, initial=0.0)
    u = phase.control("u", 2, shape="linear")
    phase.derivative(x, ca.vertcat(u, x[0] * x[1]))
    first, second = function(x, u)
    phase.constraint("first", first, upper=1.0)
    if mixed:
        product = ca.dot(first, u) * second[0]
        phase.constraint("product", product + other(x, 2 * u)[0][1], upper=1.0)
    phase.running_cost(ca.sumsqr(u))
    phase.end_cost(phase.duration)
    return problem


@pytest.mark.parametrize("mixed", sampled([False, True], 2))
def test_they_are_those_of_the_stage_written_out(mixed):
    stage = Transcription(problem(mixed=mixed)).kernels[0].stage
    assert not stage.hessian.is_a("SXFunction")  # divided
    whole = _kernels.with_derivatives([stage.value])
    random = np.random.default_rng(0)
    for ours, theirs in ((stage.jacobian, whole[1]), (stage.hessian, whole[2])):
        at = [random.uniform(0.1, 0.6, ours.size_in(k)) for k in range(ours.n_in())]
        for mine, other in zip(ours.call(at), theirs.call(at), strict=True):
            assert np.allclose(np.array(mine), np.array(other), rtol=1e-10, atol=1e-10)


@pytest.mark.thorough
def test_derivatives_that_are_given_are_taken():
    asked = []

    def given(function):
        asked.append(function.name())

    Transcription(problem(mixed=True), derivatives=given)
    assert sorted(set(asked)) == ["one", "other"]


def test_the_end_is_divided_where_all_derivatives_are_given():
    def given(function):
        return (*_composition._derivatives_of(function), function)

    [end] = Transcription(problem(mixed=False), derivatives=given).kernels[0].points
    [written] = Transcription(problem(mixed=False)).kernels[0].points
    assert written.hessian.is_a("SXFunction")
    assert not end.hessian.is_a("SXFunction")
    random = np.random.default_rng(0)
    for name in ("value", "jacobian", "hessian"):
        ours, theirs = getattr(end, name), getattr(written, name)
        at = [random.uniform(0.1, 0.6, ours.size_in(k)) for k in range(ours.n_in())]
        for mine, other in zip(ours.call(at), theirs.call(at), strict=True):
            assert np.allclose(np.array(mine), np.array(other), rtol=1e-10, atol=1e-10)


@pytest.mark.thorough
def test_light_functions_are_written_out(monkeypatch):
    monkeypatch.setattr(_composition, "HEAVY", 10**9)
    assert Transcription(problem(mixed=True)).kernels[0].stage.hessian.is_a("SXFunction")


@pytest.mark.parametrize("in_cost", [False, True])
def test_a_light_cost_is_known_without_heavy_functions(in_cost):
    heavier = problem(mixed=False)
    [phase] = heavier.phases
    x, u = (symbol.symbol for symbol in (*phase.states, *phase.controls))
    if in_cost:
        phase.running_cost(ca.sumsqr(heavy("one")(x, u)[0]))
    stage = Transcription(heavier).kernels[0].stage
    assert (stage.cost is None) == in_cost
    if stage.cost is not None:
        random = np.random.default_rng(0)
        at = [random.uniform(0.1, 0.6, stage.cost.size_in(k)) for k in range(2)]
        for mine, other in zip(stage.cost(*at), stage.jacobian(*at)[2:], strict=True):
            assert np.allclose(np.array(mine), np.array(other), rtol=1e-12)


def test_a_constraint_may_hold_at_mesh_points_alone():
    rows = []
    for interior in (True, False):
        phase = OptimalControlProblem("speed").phase("move", duration=1.0)
        x = phase.state("x", initial=0.0, final=1.0)
        phase.derivative(x, phase.control("v"))
        phase.constraint("place", x**2, upper=2.0, interior_points=interior)
        kernels = Transcription(phase.problem, scheme="shooting").kernels[0]
        rows.append([row.fraction for row in kernels.stage.rows if row.name == "place"])
    assert rows[1] == [0.0]
    assert len(rows[0]) > 1
