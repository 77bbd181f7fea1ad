"""Points where fatrop stops without success, at an optimum all the same, and not at one."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from external.published_problems import zermelo_in_a_vortex
from helpers import tells
from microbot_ocp.ocp import (
    Guess,
    OptimalControlProblem,
    Solution,
    SolverSettings,
    Status,
    Transcription,
    solve,
    verify,
)
from microbot_ocp.ocp.solution import StartingPoint
from microbot_ocp.ocp.solvers import accepted
from microbot_ocp.ocp.transcription import assemble


def regulator() -> OptimalControlProblem:
    """Linear-quadratic, with nothing but equations."""
    problem = OptimalControlProblem("regulator")
    phase = problem.phase("one", 1.0)
    x = phase.state("x", initial=1.0)
    u = phase.control("u", shape="linear")
    phase.derivative(x, -x + u)
    phase.running_cost(x**2 + u**2)
    return problem


def riccati_cost() -> float:
    """p of p' = 2 p + p^2 - 1 backwards from p = 0 during 1 s."""
    root = np.sqrt(2.0)
    return float(np.tanh(root) / (root + np.tanh(root)))


@pytest.mark.parametrize("scheme", ["shooting", "radau", "hermite_simpson"])
def test_fatrop_solves_a_regulator(scheme):
    settings = SolverSettings(solver="fatrop", max_iterations=50)
    solution = solve(regulator(), 40, settings=settings, scheme=scheme)
    assert solution.status is Status.SOLVED
    assert solution.cost == pytest.approx(riccati_cost(), rel=1e-4)
    certificate = verify(regulator(), solution)
    assert certificate.ok, certificate.verdict
    costate = certificate.costate("one")["x"]
    assert costate[0, 0] == pytest.approx(2 * riccati_cost(), rel=1e-3)


def test_without_inequalities_ipopt_comes_first():
    solution = solve(regulator(), 40)
    assert [(a.solver, a.iterations <= 3) for a in solution.attempts] == [("ipopt", True)]


def stopped(x: float) -> tuple[Transcription, Solution]:
    problem = OptimalControlProblem("limited")
    phase = problem.phase("one", 1.0)
    state = phase.state("x", initial=1.0, upper=2.0)
    u = phase.control("u", lower=-0.2, upper=1.0)
    phase.derivative(state, u)
    phase.running_cost(ca.cosh(state) + u**2)
    transcription = Transcription(problem)
    guess = {"one": Guess(1.0, {"x": lambda s: 1.0 + x * s[:, None], "u": [x]})}
    return transcription, solve(
        transcription, 10, guess, SolverSettings(solver="ipopt", tolerance=1e-10)
    )


def test_multipliers_of_equations_are_found_again():
    transcription, solution = stopped(0.0)
    program = assemble(transcription.layouts(10))
    assert solution.variables is not None
    assert solution.variable_multipliers is not None
    equal = program.row_lower == program.row_upper
    forgotten = np.where(equal, 0.0, solution.row_multipliers)
    found = accepted(
        program, StartingPoint(solution.variables, forgotten, solution.variable_multipliers), 1e-8
    )
    assert found is not None
    np.testing.assert_allclose(found[0].row_multipliers, solution.row_multipliers, atol=1e-7)


def test_what_is_no_optimum_is_not_accepted():
    transcription, solution = stopped(0.0)
    program = assemble(transcription.layouts(10))
    x, lam_g, lam_x = solution.variables, solution.row_multipliers, solution.variable_multipliers
    assert x is not None
    assert lam_x is not None
    assert accepted(program, StartingPoint(x, lam_g, lam_x), 1e-8) is not None
    # another feasible point, with the same multipliers and with none
    guess = solve(
        transcription,
        10,
        {"one": Guess(1.0, {"x": 1.0, "u": 0.0})},
        SolverSettings(solver="ipopt", max_iterations=0),
    )
    assert guess.variables is not None
    for lam in (lam_x, np.zeros_like(lam_x)):
        assert accepted(program, StartingPoint(guess.variables, lam_g, lam), 1e-8) is None
    # multipliers of the wrong sign, multipliers away from limits, and none at all
    assert accepted(program, StartingPoint(x, lam_g, -lam_x), 1e-8) is None
    assert accepted(program, StartingPoint(x, lam_g, lam_x + 0.1), 1e-8) is None
    assert accepted(program, StartingPoint(x, lam_g, np.zeros_like(lam_x)), 1e-8) is None
    assert accepted(program, StartingPoint(np.full_like(x, np.nan), lam_g, lam_x), 1e-8) is None
    tight = replace(program, variable_upper=np.minimum(program.variable_upper, x - 1e-3))
    assert accepted(tight, StartingPoint(x, lam_g, lam_x), 1e-8) is None


def test_the_scale_of_the_cost_is_in_the_multipliers():
    transcription, solution = stopped(0.0)
    program = assemble(transcription.layouts(10))
    assert solution.variables is not None
    assert solution.variable_multipliers is not None
    scaled = replace(program, cost_scale=1e3)
    given = (solution.variables, solution.row_multipliers, solution.variable_multipliers)
    found = accepted(scaled, StartingPoint(*given), 1e-8)
    assert found is not None
    np.testing.assert_allclose(found[0].row_multipliers, solution.row_multipliers, atol=1e-6)


def test_an_optimum_that_is_no_trajectory_is_seen_at_once_and_by_its_certificate():
    """From the default guess the heading turns twice within an interval of the mesh."""
    problem = zermelo_in_a_vortex()
    settings = SolverSettings(solver="fatrop", tolerance=1e-9)
    solution = solve(problem, 60, settings=settings, scheme="hermite_simpson")
    assert solution.status is Status.TOO_COARSE
    assert solution.cost > 1.05 * 3.6820085
    certificate = verify(problem, solution)
    assert not certificate.ok
    tells(certificate.verdict, "re-simulation", "phase 'fly'", "one interval")
