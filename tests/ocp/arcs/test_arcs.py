"""Mesh points where controls switch, against closed forms."""

from math import sqrt

import numpy as np
import pytest

from external.published_problems import PROBLEMS
from helpers import sampled
from microbot_ocp.ocp.arcs import hold
from microbot_ocp.ocp.problem import OptimalControlProblem, with_shapes
from microbot_ocp.ocp.solvers import SolverSettings
from microbot_ocp.ocp.transcription.schemes import SCHEMES
from ocp.textbook import bryson_denham, double_integrator, solved_to

FINE = SolverSettings("ipopt", tolerance=1e-10)
BY_NAME = {problem.name: problem for problem in PROBLEMS}


def along() -> OptimalControlProblem:
    """5 m from rest to rest in the shortest time; |u| <= 1, which grows with the time."""
    problem = OptimalControlProblem("along")
    phase = problem.phase("move", (0.1, 10.0))
    x = phase.state("x", initial=0.0, final=5.0)
    v = phase.state("v", initial=0.0, final=0.0)
    u = phase.control("u", lower=-1.0, upper=1.0, shape="constant")
    phase.derivative(x, v)
    phase.derivative(v, u * (1 + phase.time))
    phase.end_cost(phase.duration)
    return problem


@pytest.mark.parametrize("scheme", sampled(SCHEMES, 3))
def test_the_switch_of_a_double_integrator_is_in_the_middle(scheme):
    refined = solved_to(double_integrator(), 1e-8, 7, scheme, settings=FINE, switches=1e-6)
    assert refined.history[0].cost > 2.001
    assert refined.cost == pytest.approx(2.0, abs=1e-5)
    (switch,) = refined.history[-1].switches[0]
    assert switch.place == pytest.approx(0.5, abs=1e-5)


def test_a_limit_of_second_order():
    """Bryson and Ho: the contact is of third order, so the cost hardly depends on its place."""
    refined = solved_to(bryson_denham(1 / 9), 1e-8, 10, "radau", settings=FINE)
    assert refined.history[0].cost == pytest.approx(4.0, abs=2e-3)
    assert refined.cost == pytest.approx(4.0, abs=2e-5)
    assert abs(refined.history[0].cost - 4.0) > 1e-3


def test_a_switch_is_found_where_dynamics_depend_on_the_time():
    """v' = u (1 + t): full force up to a, full brake to T: 2 (1 + a)^2 = 1 + (1 + T)^2."""
    refined = solved_to(along(), 1e-8, 12, "radau", settings=FINE, switches=1e-7)
    assert refined.status.solved
    (switch,) = refined.history[-1].switches[0]
    a, whole = switch.place * refined.duration, refined.duration
    assert a == pytest.approx(sqrt((1 + (1 + whole) ** 2) / 2) - 1, abs=1e-6)
    assert refined.history[0].cost > whole + 1e-5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "mesh", "before"),
    [
        ("van_der_pol_time", 20, 1e-4),
        pytest.param("pendulum", 40, 1e-3, marks=pytest.mark.thorough),
        pytest.param("cart_pole", 40, 1e-3, marks=pytest.mark.thorough),
        pytest.param("goddard_rocket", 20, 2e-7, marks=pytest.mark.thorough),
    ],
)
def test_the_cost_is_as_accurate_as_asked_for(name, mesh, before):
    problem = BY_NAME[name]
    optimum = {"goddard_rocket": 1.01283691}.get(name, problem.optimum)
    built = with_shapes(problem.build(), "constant")
    asked = {"switches": 1e-4, "cost": 1e-6}
    refined = solved_to(built, 1e-7, mesh, "radau", problem.guess, FINE, **asked)
    errors = [abs(problem.sign * step.cost / optimum - 1) for step in refined.history]
    assert errors[0] > before
    assert refined.solved
    assert errors[-1] < 1e-6


def test_points_are_moved_or_added():
    mesh = np.linspace(0, 1, 6)
    np.testing.assert_allclose(
        hold(mesh, np.array([0.45]), 1e-3), [0, 0.2, 0.435, 0.45, 0.465, 0.6, 0.8, 1]
    )
    np.testing.assert_allclose(hold(mesh, np.array([0.4005]), 1e-3)[2], 0.4005)
    assert hold(mesh, np.array([0.4005]), 1e-3).size == 6
    two = hold(mesh, np.array([0.4, 0.45]), 1e-3)
    assert {0.4, 0.45} <= set(two)
