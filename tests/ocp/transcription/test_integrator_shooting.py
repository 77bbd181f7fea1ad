"""Shooting on integrators of CasADi that fail or do not exist: statuses and sentences, no noise."""

import numpy as np
import pytest

from helpers import crossed, refused, sampled, tells
from microbot_ocp.ocp import (
    IntegratorShooting,
    OptimalControlProblem,
    ParametricSolver,
    SolverSettings,
    Status,
    Transcription,
    solve,
    verify,
)


def car(curve=0.0):
    problem = OptimalControlProblem("car")
    phase = problem.phase("move", 2.0)
    x, v = phase.state("x", initial=0.0, final=1.0), phase.state("v", initial=0.0)
    u = phase.control("u", lower=-1.0, upper=1.0)
    phase.derivative(x, v)
    phase.derivative(v, u + curve * v**2)
    phase.running_cost(u**2)
    return problem


STOPPED = {
    "cvodes": {"max_num_steps": 1},
    "idas": {"max_num_steps": 1},
    "collocation": {"rootfinder_options": {"max_iter": 0}},
}


@pytest.mark.parametrize(("name", "solver"), crossed(STOPPED, ["auto", "ipopt", "fatrop"]))
def test_an_integrator_without_an_answer_is_a_status(name, solver, capfd):
    scheme = IntegratorShooting(name, STOPPED[name])
    settings = SolverSettings(solver)
    solution = solve(car(1.0), 4, scheme=scheme, settings=settings)
    assert solution.status is Status.FAILED
    assert not solution.solved
    tells(solution.advice, "no answer")
    assert solution["move"]["x"].shape == (5, 1)
    again = ParametricSolver(Transcription(car(1.0), scheme=scheme), 4, settings).solve()
    assert again.status is Status.FAILED
    assert capfd.readouterr() == ("", "")


@pytest.mark.thorough
def test_one_that_fails_on_the_way_only_is_stepped_around(capfd):
    problem = OptimalControlProblem("escape")
    phase = problem.phase("a", 2.0)
    x, u = phase.state("x", initial=1.0), phase.control("u", lower=-1.0, upper=1.0)
    phase.derivative(x, x**2 + u)
    phase.running_cost(u**2 + x**2)
    scheme = IntegratorShooting("cvodes", {"max_num_steps": 200})
    solution = solve(problem, 6, scheme=scheme, settings=SolverSettings("ipopt"))
    assert solution.status in (Status.SOLVED, Status.TOO_COARSE)
    assert verify(problem, solution).cost.error < 1e-6
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (("ode45",), ("integrator", "cvodes, idas, collocation", "'ode45'")),
        (("cvode",), ("integrator", "mean 'cvodes'")),
        ((3,), ("integrator", "cvodes, idas, collocation", "not 3")),
        (("cvodes", {"tol": 1e-3}), ("'cvodes'", "option: tol")),
        (("idas", {"abstol": "small"}), ("'idas'", "abstol")),
        (
            ("cvodes", {"linear_multistep_method": "x"}),
            ("'cvodes'", "linear multistep", "method: x"),
        ),
        (("rk", {"number_of_elements": 4}), ("'rk'", "option: number_of_elements")),
    ],
)
def test_what_no_integrator_takes_is_refused_at_once(given, said, no_solver, capfd):
    with refused(*said):
        IntegratorShooting(*given)
    assert capfd.readouterr() == ("", "")


DAES = {
    "divided by a state": (0.0, lambda x, z, u: z * x - u),
    "two roots that meet": (1.0, lambda x, z, u: z**3 - x * z + 0.1 * x),
    "a turning point": (1.0, lambda x, z, u: z**2 - x + u),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", sampled(DAES, 3))
def test_equations_that_integrators_stop_at_print_nothing(kind, capfd):
    begin, equation = DAES[kind]
    problem = OptimalControlProblem("dae")
    phase = problem.phase("a", 1.0)
    x, z = phase.state("x", initial=begin), phase.algebraic("z", lower=-3.0, upper=3.0)
    u = phase.control("u", lower=-1.0, upper=1.0)
    phase.derivative(x, z)
    phase.algebraic_equation(equation(x, z, u))
    phase.running_cost(u**2 + z**2)
    solution = solve(problem, 8)
    verify(problem, solution)
    assert capfd.readouterr() == ("", "")


@pytest.mark.thorough
def test_what_a_progress_function_prints_is_heard(capfd):
    import sys

    solve(car(), 4, progress=lambda _: print("heard", file=sys.stderr))
    assert "heard" in capfd.readouterr().err
    assert np.isfinite(solve(car(), 4).cost)
