"""Decay of Legendre coefficients, and what it says of the next mesh."""

import casadi as ca
import numpy as np
import pytest

from microbot_ocp.ocp.problem import OptimalControlProblem
from microbot_ocp.ocp.refinement import Degrees, decay_rates, degrees_on, refine_hp
from microbot_ocp.ocp.search import solve
from microbot_ocp.ocp.solvers import SolverSettings
from microbot_ocp.ocp.transcription import Mesh
from ocp.textbook import double_integrator

FINE = SolverSettings("ipopt", tolerance=1e-10)


def known(slope):
    """A state with a known slope and nothing to choose."""
    problem = OptimalControlProblem("known")
    phase = problem.phase("run", 1.0)
    x = phase.state("x", initial=1.0)
    phase.derivative(x, slope(phase.time, x))
    return problem


def rates(problem, mesh):
    return decay_rates(solve(problem, [mesh], settings=FINE, scheme="radau").phases[0])


def test_the_rate_is_that_of_the_series_of_an_exponential():
    """exp(-t) from 0 to 0.5, expanded by numpy."""
    (rate, _) = rates(known(lambda _, x: -x), Mesh(2, 6))
    s = np.polynomial.legendre.leggauss(7)[0]
    series = np.polynomial.legendre.legfit(s, np.exp(-(s + 1) / 4), 6)
    expected = -np.polyfit(np.arange(1, 7), np.log10(np.abs(series[1:])), 1)[0]
    assert rate == pytest.approx(expected, abs=0.1)


def test_a_corner_decays_slowly_and_a_polynomial_at_once():
    corner = known(lambda t, _: ca.if_else(t < 0.3, 1.0, -1.0))
    bent, straight = rates(corner, Mesh(2, 8))
    assert bent < 0.5
    assert straight > 2.0


def test_what_is_constant_has_an_infinite_rate():
    assert np.isinf(rates(known(lambda t, _: 0.0), Mesh(2, 4))).all()


def test_the_jump_of_a_polynomial_control_is_seen():
    problem = double_integrator("polynomial")
    phase = solve(problem, [Mesh(3, 6)], settings=FINE, scheme="radau").phases[0]
    assert np.argmin(decay_rates(phase)) == 1
    assert decay_rates(phase)[1] < 0.5


@pytest.mark.parametrize(
    ("degree", "error", "rate", "pieces", "wanted"),
    [
        (4, 1e-9, 1.0, 1, 4),  # good enough
        (4, 1e-12, 1.0, 1, 3),  # to spare
        (3, 1e-12, 1.0, 1, 3),  # at the least degree
        (4, 1e-6, 1.0, 1, 6),  # 2.3 powers of ten missing, two a degree
        (4, 1e-3, 1.0, 1, 7),  # no more at once
        (7, 1e-3, 1.0, 3, 7),  # the most degree is too little
        (4, 1e-6, 0.2, 2, 4),  # a corner
        (4, np.inf, 1.0, 6, 4),
    ],
)
def test_smooth_intervals_are_raised_and_others_divided(degree, error, rate, pieces, wanted):
    mesh = Mesh([0.0, 0.4, 1.0], [degree, 5])
    errors = np.array([error, 5e-9])
    made = refine_hp(mesh, errors, np.array([rate, 1.0]), 1e-8, Degrees(3, 8))
    assert made.intervals == pieces + 1
    assert made.degrees.tolist() == [wanted] * pieces + [5]
    np.testing.assert_allclose(made.fractions[: pieces + 1], np.linspace(0, 0.4, pieces + 1))


def test_moved_points_keep_the_degree_of_their_place():
    mesh = Mesh([0.0, 0.5, 1.0], [3, 7])
    assert degrees_on(np.array([0.0, 0.2, 0.48, 0.7, 1.0]), mesh).tolist() == [3, 3, 7, 7]
