"""Solves that end badly say what to do, in the names and units of the problem."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from helpers import refused, tells
from microbot_ocp.ocp import (
    Guess,
    OptimalControlProblem,
    SolverSettings,
    Status,
    load_solution,
    save_solution,
    solve,
)


def lines(problem: OptimalControlProblem, mesh: int = 10, guess=None, **settings) -> list[str]:
    solution = solve(problem, mesh, guess, SolverSettings(**settings))
    assert not solution.status.solved
    return solution.advice.splitlines()


def crane(scaling_of_height: float | None = None) -> OptimalControlProblem:
    problem = OptimalControlProblem("crane")
    phase = problem.phase("lift", (1.0, 100.0))
    height = phase.state("height", initial=0.0, final=20.0, unit="m", scale=scaling_of_height)
    speed = phase.state("speed", initial=0.0, final=0.0, unit="m/s")
    pull = phase.control("pull", lower=-2.0, upper=2.0, unit="m/s^2")
    phase.derivative(height, speed)
    phase.derivative(speed, pull)
    phase.end_cost(phase.duration)
    return problem


@pytest.mark.parametrize("solver", ["ipopt", "fatrop"])
def test_the_worst_row_is_named_with_place_amount_and_unit(solver):
    guess = {"lift": Guess(10.0, {"height": 0.0, "speed": 7.0, "pull": 0.0})}
    said = lines(crane(), 10, guess, solver=solver, max_iterations=1)
    assert said[0] == Status.ITERATION_LIMIT.sentence
    (worst,) = (line for line in said if line.startswith("Most violated: "))
    tells(worst, "phase 'lift'", "t = ")
    assert worst.endswith((" m.", " m/s."))
    (start,) = (line for line in said if "guess" in line and "no trajectory" in line)
    # one interval of 1 s at 7 m/s, and a guess that stands still
    tells(start, "dynamics of height", "phase 'lift'", "t = ", "7 m")
    assert said[-1].startswith("Call explain(problem, mesh, solution)")


@pytest.mark.thorough
def test_a_good_guess_is_not_blamed():
    good = solve(crane(), 10)
    said = lines(
        crane(),
        10,
        {"lift": Guess(good.duration, dict(good["lift"].values))},
        solver="ipopt",
        max_iterations=0,
    )
    assert not any("no trajectory" in line for line in said)


def test_bad_scales_are_named_with_what_would_do():
    said = lines(crane(1e-5), solver="ipopt", max_iterations=3)
    (line,) = (line for line in said if "state height" in line and "scale=" in line)
    tells(line, "phase 'lift'", "1e-05", "scale=10")


def test_rows_that_are_badly_scaled_are_named():
    problem = crane()
    (phase,) = problem.phases
    phase.constraint("power", 1e7 * phase.states[1].symbol, upper=1e9, unit="W", scale=1.0)
    said = lines(problem, solver="ipopt", max_iterations=1)
    (line,) = (line for line in said if "constraint power" in line)
    tells(line, "phase 'lift'", "1e+08 times", "scale of 1")  # speed is seen in 10 m/s


def overdetermined() -> OptimalControlProblem:
    problem = OptimalControlProblem("overdetermined")
    phase = problem.phase("one", 1.0)
    x = phase.state("x", initial=0.0, final=1.0)
    u = phase.control("u", lower=-5.0, upper=5.0)
    phase.derivative(x, u)
    for name, value in (("a", u + x), ("b", u - x), ("c", 2 * u - x)):
        phase.constraint(name, value, 1.0, 1.0)
    phase.running_cost(u**2)
    return problem


@pytest.mark.thorough
def test_a_solver_that_breaks_down_is_an_attempt_and_the_chain_goes_on():
    assert len({a.way for a in solve(overdetermined(), 5).attempts}) > 2  # of other strategies
    solution = solve(overdetermined(), 5, settings=SolverSettings(("ipopt", "fatrop")))
    assert [a.solver for a in solution.attempts] == ["ipopt", "fatrop"]
    assert not solution.status.solved
    first = solution.attempts[1]
    assert first.status is Status.FAILED
    assert first.iterations == 0
    assert first.broke_down
    assert first.message.startswith("Assertion failed: number_of_eq_constraints")
    assert "\n" not in first.message
    (line,) = (line for line in solution.advice.splitlines() if "13 equations" in line)
    tells(line, *(f"constraint {name}" for name in "abc"), "8 variables", "interval 1")


def test_options_that_a_solver_does_not_have_are_bad_input():
    for solver in ("ipopt", "fatrop"):
        settings = SolverSettings(solver=solver, options={solver: {"no_such_option": 1}})
        with refused(f"options of {solver}", "no_such_option"):
            solve(crane(), 5, settings=settings)


def bent(*, limited: bool) -> OptimalControlProblem:
    """Slopes of the arcsine are infinite at 1.2 m/s, and beyond there is none."""
    problem = OptimalControlProblem("bent")
    phase = problem.phase("one", (0.5, 10.0))
    bound = 1.19 if limited else np.inf
    x = phase.state("x", initial=0.0, final=2.0, unit="m")
    v = phase.state("v", lower=-bound, upper=bound, initial=0.0, final=0.0, unit="m/s")
    u = phase.control("u", lower=-5.0, upper=5.0, unit="m/s^2")
    phase.derivative(x, v)
    phase.derivative(v, u + ca.asin(v / 1.2))
    phase.end_cost(phase.duration)
    return problem


@pytest.mark.parametrize("scheme", ["shooting", "radau"])
def test_fatrop_ends_where_steps_lead_to_what_is_no_number(scheme):
    """It used to run for ever."""
    settings = SolverSettings(solver="fatrop", max_iterations=60)
    solution = solve(bent(limited=False), 30, settings=settings, scheme=scheme)
    assert not solution.status.solved
    assert solution.attempts[0].iterations <= 61


def test_a_value_that_is_none_on_the_way_is_named_with_its_variable(capfd):
    settings = SolverSettings(solver="ipopt")
    inside = solve(bent(limited=False), 30, settings=settings, scheme="shooting")
    tells(inside.advice, "not finite", "step of v", "phase 'one'", "interval")
    advice = solve(bent(limited=False), 30, settings=settings, scheme="radau").advice
    (line,) = (line for line in advice.splitlines() if "last iterate" in line)
    tells(line, "dynamics of state 'v'", "phase 'one'", "nan", "arcsine of 1.001", "v = 1.201")
    assert capfd.readouterr() == ("", "")


def test_the_bound_that_is_advised_helps():
    for solver in ("ipopt", "fatrop"):
        solution = solve(bent(limited=True), 30, settings=SolverSettings(solver=solver))
        assert solution.attempts[-1].status.solved


def test_steps_over_an_edge_are_taken_back_by_fatrop():
    problem = OptimalControlProblem("tank")
    phase = problem.phase("drain", (0.1, 20.0))
    level = phase.state("level", initial=1.0, final=0.0001, unit="m")
    valve = phase.control("valve", lower=0.0, upper=1.0)
    phase.derivative(level, -valve * ca.sqrt(level))
    phase.end_cost(phase.duration)
    solution = solve(problem, 40, settings=SolverSettings(solver="fatrop"), scheme="radau")
    assert solution.status.solved
    assert solution.cost == pytest.approx(2 * (1 - 0.01), rel=1e-5)  # of sqrt(level)


def test_advice_is_saved_with_the_solution(tmp_path):
    solution = solve(crane(), 10, settings=SolverSettings(solver="ipopt", max_iterations=1))
    loaded = load_solution(save_solution(solution, tmp_path / "stopped.npz"))
    assert loaded.advice == solution.advice
    assert len(loaded.advice.splitlines()) > 1
    solved = solve(crane(), 10)
    assert solved.advice == Status.SOLVED.sentence
