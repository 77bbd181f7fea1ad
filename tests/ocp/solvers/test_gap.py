"""The gap to the local optimum: said with every answer, and closed."""

from functools import cache

import numpy as np
import pytest

from helpers import sampled, sampled_rows, tells
from microbot_ocp.ocp import (
    OptimalControlProblem,
    ParametricSolver,
    SolverSettings,
    Status,
    load_solution,
    save_solution,
    solve,
    verify,
)
from microbot_ocp.ocp.solution import complementarity, gap_of
from microbot_ocp.ocp.transcription import Bounds


def least_fuel(price=1.0):
    """1 m from rest to rest in 3 s, both thrusts within [0, 1]: flat where neither is used."""
    problem = OptimalControlProblem("least fuel")
    phase = problem.phase("move", 3.0)
    x = phase.state("x", initial=0.0, final=1.0)
    v = phase.state("v", initial=0.0, final=0.0)
    thrusts = [phase.control(name, lower=0.0, upper=1.0) for name in ("forward", "back")]
    phase.derivative(x, v)
    phase.derivative(v, thrusts[0] - thrusts[1])
    phase.running_cost(price * (thrusts[0] + thrusts[1]))
    return problem


@cache
def exact_cost(price=1.0):
    return solve(least_fuel(price), 40, settings=SolverSettings("ipopt", gap=1e-10)).cost


@pytest.mark.parametrize("solver", sampled(["fatrop", "ipopt"], 2))
@pytest.mark.parametrize("tolerance", [1e-3, pytest.param(1e-5, marks=pytest.mark.thorough), 1e-7])
def test_the_gap_is_a_bound_of_what_is_left(solver, tolerance):
    exact = exact_cost()
    loose = solve(least_fuel(), 40, settings=SolverSettings(solver, tolerance, gap=np.inf))
    assert len(loose.attempts) == 1
    assert loose.status is (Status.GAP_LEFT if loose.gap.total > 1e-5 * exact else Status.SOLVED)
    assert 0.0 < loose.cost - exact <= loose.gap.total < 1e4 * tolerance


@pytest.mark.parametrize("price", sampled([1.0, 1e-4, 1e5], 3))
def test_a_solve_goes_on_until_the_gap_is_small(price):
    loose = solve(least_fuel(price), 40, settings=SolverSettings(tolerance=1e-4))
    assert loose.solved
    assert loose.gap.total <= 1e-6 * loose.cost
    assert abs(loose.cost - exact_cost(price)) <= 1e-6 * exact_cost(price)
    tells(repr(loose), f"at most {loose.gap.total:.1e}")


@pytest.mark.thorough
def test_what_is_wanted_and_not_reached_is_no_success():
    left = solve(least_fuel(), 40, settings=SolverSettings(gap=1e-17))
    assert left.status is Status.GAP_LEFT
    assert not left.solved
    assert "gap" in {row.kind for row in left.rows}
    tells(left.advice, f"at most {left.gap.total:.2g}")
    assert left.cost == pytest.approx(exact_cost(), rel=1e-6)


@pytest.mark.thorough
def test_a_certificate_finds_the_same_gap():
    solution = solve(least_fuel(), 40)
    certificate = verify(least_fuel(), solution)
    assert certificate.ok
    assert certificate.optimality.gap.total == pytest.approx(solution.gap.total, rel=1e-3)
    assert certificate.as_dict()["optimality"]["gap"]["slack"] > 0
    loose = solve(least_fuel(), 40, settings=SolverSettings(tolerance=1e-5, gap=np.inf))
    found = verify(least_fuel(), loose)
    assert not found.ok
    tells(found.verdict, str(Status.GAP_LEFT), f"{found.optimality.gap.total:.2g}")


def test_a_saved_solution_keeps_its_gap(tmp_path):
    solution = solve(least_fuel(), 10)
    assert load_solution(save_solution(solution, tmp_path / "a.npz")).gap == solution.gap


def test_solves_with_other_data_are_tightened_too():
    solver = ParametricSolver(least_fuel(), 20, SolverSettings(tolerance=1e-4))
    for way in (1.0, 1.1, 0.5):
        solution = solver.solve(final={"move": {"x": way}})
        assert solution.solved
        assert solution.gap.total <= 1e-6 * solution.cost


def test_the_gap_counts_slack_slopes_violations_and_limits_that_are_not_there():
    def gap(x, multiplier, slope=0.0, low=0.0, high=1.0):
        bounds = Bounds(*(np.array([k]) for k in (low, high)), np.zeros(0), np.zeros(0))
        found = gap_of(
            bounds, np.array([x]), np.zeros(0), np.array([slope]), np.array([multiplier])
        )
        return found.slack, found.residuals

    assert gap(0.25, 2.0) == (1.5, 0.0)  # a positive multiplier is one of the upper bound
    assert gap(0.25, -2.0) == (0.5, 0.0)
    assert gap(1.5, 2.0) == (0.0, 1.0)
    assert gap(0.25, 0.0, slope=-0.1) == (0.0, 0.1)
    assert gap(0.25, 2.0, high=np.inf) == (0.0, 2.0)
    assert gap(0.5, 3.0, low=1.0) == (0.0, 1.5)  # an equation


def test_complementarity_is_the_mean_product_at_limits_kept_or_not():
    low, high = np.array([0.0, 0.0, -np.inf, 1.0]), np.array([1.0, 1.0, np.inf, 1.0])
    bounds = Bounds(low, high, np.zeros(0), np.ones(0))
    x, multipliers = np.array([0.75, -0.5, 3.0, 2.0]), np.array([2.0, -3.0, 0.0, 9.0])
    mean = complementarity(bounds, x, np.zeros(0), multipliers)
    assert mean == pytest.approx((2.0 * 0.25 + 3.0 * 0.5) / 2)  # no equation, no missing limit


@pytest.mark.thorough
def test_a_bound_of_many_scales_is_kept_to_what_passes():
    # IPOPT moves bounds by 1e-8 of their size: of 200 scales by twice what passes
    problem = OptimalControlProblem("tank")
    phase = problem.phase("fill", 1.0)
    level = phase.state("level", initial=0.0, upper=200.0, scale=1.0)
    inflow = phase.control("inflow", lower=0.0, upper=300.0, scale=1.0)
    phase.derivative(level, inflow)
    phase.end_cost(-level)
    solution = solve(problem, 10)
    assert solution.status is Status.SOLVED
    assert verify(problem, solution).ok
    assert solution.attempts[0].infeasibility > 1e-6 > solution.attempts[-1].infeasibility


def a_cost_of_zero(kind, price=1.0):
    """Nothing has to be done, and whatever is costs: the least is zero, at a bound."""
    problem = OptimalControlProblem("nothing to do")
    phase = problem.phase("rest", 1.0)
    if kind == "a slack above a size":
        x, u = phase.state("x", initial=0.0, final=0.0), phase.control("u")
        s = phase.control("s", lower=0.0)
        phase.derivative(x, u)
        phase.constraint("above", s - u, lower=0.0)
        phase.constraint("above minus", s + u, lower=0.0)
        phase.running_cost(price * s)
    elif kind == "thrusts both ways":
        x, v = (phase.state(name, initial=0.0, final=0.0) for name in "xv")
        thrusts = [phase.control(name, lower=0.0, upper=1.0) for name in ("forward", "back")]
        phase.derivative(x, v)
        phase.derivative(v, thrusts[0] - thrusts[1])
        phase.running_cost(price * (thrusts[0] + thrusts[1]))
    else:
        x, u = phase.state("x", initial=0.0), phase.control("u", lower=0.0, upper=1.0)
        phase.derivative(x, u)
        phase.end_cost(price * x)
    return problem


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "price"),
    sampled_rows(
        [
            ("a slack above a size", 1e-7),
            ("thrusts both ways", 1.0),
            ("a loss", 1e4),
            *(
                pytest.param(*case, marks=pytest.mark.thorough)
                for case in (("a slack above a size", 1.0), ("a loss", 1.0), ("a loss", 1e-7))
            ),
        ],
        3,
    ),
)
def test_a_least_cost_of_zero_is_solved(kind, price):
    solution = solve(a_cost_of_zero(kind, price))
    assert solution.solved, solution.advice
    assert abs(solution.cost) <= 2e-9 * price
    assert verify(a_cost_of_zero(kind, price), solution).ok
