"""Published optima met by two schemes and two solvers; their figures recomputed another way."""

from __future__ import annotations

import ast
import inspect
import runpy
import sys
import textwrap
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, fsolve, minimize_scalar

from external.published_problems import (
    CART_POLE_SIGNS,
    FORCE,
    PROBLEMS,
    PublishedProblem,
    cart_pole_slopes,
    robot_arm,
)
from helpers import tells

pytestmark = pytest.mark.slow

BY_NAME = {problem.name: problem for problem in PROBLEMS}
LONG = (
    "robot_arm",
    "goddard_phases",
    "cart_pole",
    "cart_pole_arcs",
    "van_der_pol_time",
    "pendulum",
    "hanging_chain",
    "zermelo_vortex",
    "goddard_rocket",
    "van_der_pol",
)
SCRIPT = Path(__file__).resolve().parents[2] / "problems" / "10_published_optima.py"
CASES = [
    pytest.param(
        problem,
        scheme,
        solver,
        id=f"{problem.name}-{scheme}-{solver}",
        marks=()
        if (scheme, solver) == ("radau", "ipopt") and problem.name not in LONG
        else pytest.mark.thorough,
    )
    for problem in PROBLEMS
    for scheme in ("radau", "hermite_simpson")
    for solver in ("fatrop", "ipopt")
]


@pytest.mark.parametrize(("problem", "scheme", "solver"), CASES)
def test_the_optimum_is_met(problem: PublishedProblem, scheme: str, solver: str):
    solution = problem.solve(scheme, solver)
    assert solution.status.solved
    assert solution.attempts[-1].infeasibility < 1e-7
    assert problem.error(solution) <= problem.tolerance


CHECKED = ("bryson_denham", "double_integrator", "two_phases")


@pytest.mark.parametrize("scheme", [pytest.param("shooting", marks=pytest.mark.thorough), "gauss"])
@pytest.mark.parametrize(
    "problem",
    [
        p if p.name in CHECKED else pytest.param(p, marks=pytest.mark.thorough)
        for p in PROBLEMS
        if p.mesh < 200 and p.name != "particle_steering"
    ],
    ids=lambda p: p.name,
)
def test_other_schemes_meet_it_too(problem, scheme):
    solution = problem.solve(scheme, "ipopt")
    assert solution.status.solved
    assert problem.error(solution) <= problem.tolerance


@pytest.mark.parametrize("problem", [p for p in PROBLEMS if p.printed], ids=lambda p: p.name)
def test_closed_forms_agree_with_the_figures_printed_by_the_source(problem):
    assert problem.optimum == pytest.approx(problem.printed, rel=problem.printed_tolerance)


# figures by another integrator --------------------------------------------------------------------


def test_two_arcs_of_the_oscillator_take_the_time_given():
    """u = -1, then u = 1 until the circle is met; the switch is the best, near 0.7139 s."""

    def after(switch: float) -> float:
        def slopes(_, x, u):
            return [x[1], -x[0] + x[1] * (1 - x[0] ** 2) + u]

        accurate = {"rtol": 1e-11, "atol": 1e-12, "dense_output": True, "method": "DOP853"}
        first = solve_ivp(slopes, (0.0, switch), [1.0, 1.0], args=(-1.0,), **accurate)
        second = solve_ivp(slopes, (0.0, 2.4), first.y[:, -1], args=(1.0,), **accurate)
        distance = lambda t: float(np.sum(second.sol(t) ** 2) - 0.04)  # noqa: E731
        times = np.linspace(1.8, 2.4, 61)
        inside = int(np.argmax([distance(t) < 0 for t in times]))
        return switch + brentq(distance, times[inside - 1], times[inside], xtol=1e-13)

    best = minimize_scalar(after, bounds=(0.7, 0.73), method="bounded", options={"xatol": 1e-8})
    assert best.x == pytest.approx(0.7139356, abs=1e-5)
    assert best.fun == pytest.approx(BY_NAME["van_der_pol_time"].optimum, rel=1e-8)


def cart_pole_end(durations: np.ndarray) -> np.ndarray:
    """State (x, angle and their rates) after arcs of full force, from rest."""
    state = np.zeros(4)
    for sign, duration in zip(CART_POLE_SIGNS, durations, strict=True):

        def slopes(_, z, force=sign * FORCE):
            return [*z[2:], *cart_pole_slopes(z[3], force, np.sin(z[1]), np.cos(z[1]))]

        run = solve_ivp(slopes, (0.0, duration), state, "DOP853", rtol=1e-11, atol=1e-12)
        state = run.y[:, -1]
    return state


@pytest.mark.thorough
def test_four_arcs_of_full_force_swing_the_cart_pole_up():
    """Four durations for the four conditions of rest above the start: nothing is left to choose."""
    guess = np.array([0.25, 0.56, 0.46, 0.17])
    durations = fsolve(lambda d: cart_pole_end(d) - [0.0, np.pi, 0.0, 0.0], guess, xtol=1e-12)
    assert durations.sum() == pytest.approx(BY_NAME["cart_pole"].optimum, abs=1e-8)
    phases = BY_NAME["cart_pole_arcs"].solve("gauss", "ipopt").phases
    np.testing.assert_allclose([p.duration for p in phases], durations, atol=1e-6)


@pytest.mark.thorough
def test_the_best_cart_pole_motion_found_has_those_arcs():
    solution = BY_NAME["cart_pole"].solve("hermite_simpson", "ipopt")
    force = solution["swing"]["force"].ravel() / FORCE
    full = np.abs(force) > 1 - 1e-4
    assert np.sum(~full) <= 3  # a switch inside an interval is a force between
    signs = np.sign(force[full])
    assert tuple(signs[np.flatnonzero(np.diff(signs, prepend=0.0))]) == CART_POLE_SIGNS


@pytest.mark.thorough
def test_the_pendulum_found_swings_up_by_another_integrator():
    solution = BY_NAME["pendulum"].solve("hermite_simpson", "ipopt")["swing"]
    state = np.zeros(2)
    for begin, end, torque in zip(
        solution.t[:-1], solution.t[1:], solution["torque"].ravel(), strict=True
    ):
        run = solve_ivp(
            lambda _, z, u: [z[1], u - np.sin(z[0])],
            (begin, end),
            state,
            args=(torque,),
            rtol=1e-9,
            atol=1e-10,
        )
        state = run.y[:, -1]
    np.testing.assert_allclose(state, [np.pi, 0.0], atol=1e-6)


@pytest.mark.thorough
def test_the_rocket_climbs_as_high_in_three_phases_as_in_one():
    """To a digit more than the source prints; the singular arc is the middle phase."""
    one = BY_NAME["goddard_rocket"].solve("hermite_simpson", "ipopt")
    three = BY_NAME["goddard_phases"].solve("hermite_simpson", "ipopt")
    assert one.cost == pytest.approx(three.cost, rel=2e-7)
    assert -three.cost == pytest.approx(1.0128369, abs=1e-7)
    thrust = three["between"]["thrust"]
    assert np.all((thrust > 0.01) & (thrust < 3.49))


# the measure of the interface ---------------------------------------------------------------------


def test_the_robot_arm_is_stated_in_few_lines_without_indices():
    source = textwrap.dedent(inspect.getsource(robot_arm))
    assert len(source.splitlines()) < 30
    used = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Subscript)]
    assert used == []


# the script ---------------------------------------------------------------------------------------


@pytest.fixture
def run(capsys, monkeypatch):
    def run(*arguments: str) -> SimpleNamespace:
        monkeypatch.setattr(sys, "argv", [str(SCRIPT), *arguments])
        with pytest.raises(SystemExit) as end:
            runpy.run_path(str(SCRIPT), run_name="__main__")
        out, err = capsys.readouterr()
        return SimpleNamespace(returncode=end.value.code, stdout=out, stderr=err)

    return run


def test_the_script_prints_the_table_and_succeeds_where_all_is_met(run):
    done = run("--only", "double_integrator", "two_phases", "--scheme", "radau")
    assert done.returncode == 0, done.stderr
    assert "19.29000000" in done.stdout
    assert "2 optima met" in done.stdout


@pytest.mark.thorough
def test_the_script_has_a_column_for_every_solver(run):
    done = run("--only", "double_integrator", "--by-solver", "--solver", "fatrop", "ipopt", "sqp")
    assert done.returncode == 0, done.stderr
    (head,) = [line for line in done.stdout.splitlines() if "fatrop" in line]
    assert head.index("fatrop") < head.index("ipopt") < head.index("sqp")
    assert "double_integrator" in done.stdout


@pytest.mark.thorough
def test_a_solver_that_misses_is_shown_in_its_column(run):
    done = run("--only", "bryson_denham", "--scheme", "radau", "--by-solver", "--solver", "sqp")
    assert done.returncode == 1
    assert "iteration limit" in done.stdout
    assert "missed: bryson_denham" in done.stdout


def test_the_script_fails_where_an_optimum_is_missed(run):
    done = run("--only", "van_der_pol_time", "--mesh", "12", "--solver", "ipopt")
    assert done.returncode == 1
    assert "missed: van_der_pol_time" in done.stdout


def test_the_script_says_in_a_line_what_is_wrong(run):
    done = run("--only", "two_phases", "--scheme", "magic")
    assert done.returncode == 2
    tells(done.stderr, "error: scheme", "shooting, radau", "'magic'")
