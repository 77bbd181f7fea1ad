"""Singular arcs by the conditions of first order, against closed forms and published digits."""

from math import exp, inf

import casadi as ca
import numpy as np
import pytest
from benchmarks.suite.table import BY_NAME
from scipy.optimize import root_scalar

from helpers import tells
from microbot_ocp.ocp import OptimalControlProblem, Status, solve, solve_switching_times

SINGULAR = "singular, by its own conditions"


def integrator(bound=1.0, end=None, power=2):
    """Least integral of a power of x with x' = u from 1 in 2 s."""
    problem = OptimalControlProblem("integrator")
    phase = problem.phase("only", 2.0)
    x = phase.state("x", initial=1.0, final=end)
    u = phase.control("u", lower=-1.0, upper=bound)
    phase.derivative(x, u)
    phase.running_cost(x**power)
    return problem, phase, x, u


def double_integrator(duration=5.0):
    """Least integral of x1^2 + x2^2 from (0, 1): x1 is the singular control."""
    problem = OptimalControlProblem("double integrator")
    phase = problem.phase("only", duration)
    x1, x2 = phase.state("x1", initial=0.0), phase.state("x2", initial=1.0)
    u = phase.control("u", lower=-1.0, upper=1.0)
    phase.derivative(x1, x2)
    phase.derivative(x2, u)
    phase.running_cost(x1**2 + x2**2)
    return problem


def solved(problem):
    return solve_switching_times(problem, solve(problem, 30, scheme="radau"))


def times(found):
    return [junction.time for junction in found.junctions]


@pytest.mark.thorough
def test_a_singular_arc_that_ends_the_motion():
    found = solved(integrator()[0])
    assert found.solved
    assert [(j.before, j.after) for j in found.junctions] == [("lower limit", SINGULAR)]
    assert times(found) == pytest.approx([1.0], abs=1e-9)
    assert found.cost == pytest.approx(1 / 3, abs=1e-9)
    assert found.singular is not None
    assert found.singular.kelley == pytest.approx(-2.0)
    known = found.sample("only", [0.5, 1.0, 1.5])
    np.testing.assert_allclose(known["u"][:, 0], [-1.0, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(known["x"][:, 0], [0.5, 0.0, 0.0], atol=1e-9)


@pytest.mark.thorough
def test_a_feedback_that_is_not_constant():
    """u = x1 from where x1 and x2 reach the surface of those that end with x2 = 0 at T.

    On the arc x1'' = x1 and x2(T) = 0, so x2 = -x1 tanh(T - t); before it u = -1.
    """
    found = solved(double_integrator())

    def missed(t):
        x1, x2 = t - t**2 / 2, 1 - t
        return x2 + x1 * np.tanh(5.0 - t)

    t = float(root_scalar(missed, bracket=(1.0, 1.9), xtol=1e-14).root)
    assert found.solved
    assert times(found) == pytest.approx([t], abs=1e-9)
    known = found.sample("only", np.linspace(t + 0.01, 4.9, 20))
    np.testing.assert_allclose(known["u"], known["x1"], atol=1e-8)


def test_between_two_that_are_held_with_a_free_duration():
    """Half of time and of the integral of v^2, 3 m from rest to rest: at 1 m/s from 1 to 3 s."""
    found = solved(BY_NAME["slow_transfer"].build())
    assert found.solved
    assert times(found) == pytest.approx([1.0, 3.0], abs=1e-9)
    assert found.cost == pytest.approx(10 / 3, abs=1e-9)
    assert found.duration("move") == pytest.approx(4.0, abs=1e-9)


@pytest.mark.thorough
def test_time_and_parameters_in_the_dynamics_and_an_end_constraint():
    """x follows exp(-t / 2) as soon as it reaches it, and comes to another place at the end."""
    problem = OptimalControlProblem("follow")
    phase = problem.phase("only", 4.0)
    rate = phase.parameter("rate", 0.5)
    x = phase.state("x", initial=2.0)
    u = phase.control("u", lower=-1.0, upper=1.0)
    phase.derivative(x, u)
    phase.running_cost((x - ca.exp(-rate * phase.time)) ** 2)
    phase.end_constraint("place", x**2, 0.64, 0.64)
    found = solved(problem)
    meets, leaves = lambda t: 2 - t - exp(-t / 2), lambda t: exp(-t / 2) + 4 - t - 0.8
    begin = root_scalar(meets, bracket=(0.5, 2.0), xtol=1e-14).root
    end = root_scalar(leaves, bracket=(begin, 4.0), xtol=1e-14).root
    assert found.solved
    assert [j.after for j in found.junctions] == [SINGULAR, "upper limit"]
    assert times(found) == pytest.approx([begin, end], abs=1e-9)


@pytest.mark.thorough
def test_a_motion_that_is_to_end_where_the_singular_arc_is():
    found = solved(integrator(end=0.0)[0])
    assert found.solved
    assert times(found) == pytest.approx([1.0], abs=1e-9)
    assert found.junctions[0].after == SINGULAR


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("name", "cost", "wanted"),
    [
        ("bressan", -500 / 9, [10 / 3]),
        pytest.param(
            *("goddard_in_feet", -18550.8718638, [13.75127, 21.98736]),
            marks=pytest.mark.thorough,
        ),
    ],
)
def test_digits_that_a_solve_for_the_least_cost_does_not_have(name, cost, wanted):
    own = BY_NAME[name]
    guess = own.guess() if own.guess else None
    first = solve(own.build(), 50, guess, scheme="radau")
    found = solve_switching_times(own.build(), first)
    assert found.solved
    assert found.cost == pytest.approx(cost, rel=1e-11)
    assert times(found) == pytest.approx(wanted, rel=1e-6 if name != "bressan" else 1e-10)
    assert found.singular is not None
    assert found.singular.kelley < 0.0


@pytest.mark.thorough
def test_other_problems_keep_the_polynomial_and_say_why():
    problem, phase, _, u = integrator()
    phase.running_cost(1e-3 * u**2)
    found = solved(problem)
    assert found.singular is None
    tells(found.advice, "Hamiltonian", "not affine")
    problem, phase, x, _ = integrator()
    phase.constraint("floor", x, 0.25, inf)
    found = solved(problem)
    assert found.singular is None
    assert found.junctions
    assert SINGULAR not in str(found)


@pytest.mark.thorough
def test_a_control_of_higher_order_is_said():
    problem = BY_NAME["luus_singular_4"].build()
    found = solve_switching_times(problem, solve(problem, 30, scheme="radau"), rounds=2)
    assert found.singular is None
    assert found.status is not Status.INTERRUPTED
    tells(found.advice, "singular control", "second time derivative")
