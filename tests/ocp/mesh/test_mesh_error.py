"""State errors by re-integration, and the pieces that they ask for."""

import casadi as ca
import numpy as np
import pytest

from helpers import sampled_rows, tells
from microbot_ocp.ocp.mesh import divide, state_errors
from microbot_ocp.ocp.problem import OptimalControlProblem
from microbot_ocp.ocp.refinement import PASSING
from microbot_ocp.ocp.search import solve
from microbot_ocp.ocp.solvers import SolverSettings
from microbot_ocp.ocp.transcription import Transcription
from microbot_ocp.ocp.transcription.schemes import SCHEMES
from microbot_ocp.ocp.verification import each_interval, judge, mesh_states
from ocp.textbook import double_integrator, oscillator

FINE = SolverSettings("ipopt", tolerance=1e-10)
by_every_scheme = pytest.mark.parametrize("scheme", SCHEMES)


# the estimate -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("scheme", "order"),
    sampled_rows([("shooting", 4), ("trapezoidal", 2), ("hermite_simpson", 4)], 2),
)
def test_local_errors_go_with_the_order_of_the_scheme(scheme, order):
    meshes = np.array([16, 32, 64])
    transcription = Transcription(oscillator(), scheme=scheme)
    errors = [state_errors(solve(transcription, int(n), settings=FINE))[0].max() for n in meshes]
    slope = np.polyfit(np.log(1 / meshes), np.log(errors), 1)[0]
    assert slope == pytest.approx(order + 1, abs=0.6)


@by_every_scheme
def test_what_a_scheme_integrates_exactly_has_no_error(scheme):
    solution = solve(double_integrator(), 10, scheme=scheme, settings=FINE)
    assert state_errors(solution)[0].max() < 1e-9
    again = each_interval(solution["move"])
    assert not again.failure
    np.testing.assert_allclose(again.states, mesh_states(solution["move"])[1:], atol=1e-9)


@pytest.mark.thorough
@pytest.mark.slow
def test_dynamics_that_break_down_are_a_status_and_an_infinite_error(capfd):
    problem = OptimalControlProblem("root")
    phase = problem.phase("down", 1.0)
    x = phase.state("x", initial=1.0, final=0.3)
    u = phase.control("u", shape="linear")
    phase.derivative(x, u)
    phase.running_cost(u**2)
    solution = solve(problem, 2, settings=FINE)
    phase.derivatives["x"] = u + 1e-3 * ca.sqrt(x - 0.5)
    failure = each_interval(solution["down"]).failure
    tells(failure, "state 'x'", "phase 'down'", "interval 2", "0.475")
    assert np.isinf(state_errors(solution)[0]).all()
    (finer,) = PASSING.finer(solution, judge(problem, solution), solution.history[-1], whole=False)
    assert finer.size == 13
    assert capfd.readouterr() == ("", "")


# meshes -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("error", "order", "pieces"),
    [(1e-7, 4, 1), (1e-6, 4, 2), (1e-5, 4, 2), (1e-4, 4, 3), (1e-4, 2, 6), (1.0, 2, 6)],
)
def test_an_interval_is_divided_as_the_order_predicts(error, order, pieces):
    mesh = divide(np.array([0.0, 0.5, 1.0]), np.array([error, 2e-6]), 1e-6, order)
    np.testing.assert_allclose(mesh[: pieces + 1], np.linspace(0, 0.5, pieces + 1))
    assert mesh.size == pieces + 3


def test_a_mesh_that_is_good_enough_stays():
    mesh = np.array([0.0, 0.3, 1.0])
    np.testing.assert_array_equal(divide(mesh, np.array([9e-7, 1e-9]), 1e-6, 4), mesh)


def test_an_infinite_error_is_divided_as_far_as_allowed():
    assert divide(np.array([0.0, 0.5, 1.0]), np.array([np.inf, 0.0]), 1e-6, 4).size == 8
