"""What is solved is what a certificate passes: one judgement, saddles left, budgets counted."""

import time

import casadi as ca
import numpy as np
import pytest
from benchmarks.suite.table import BY_NAME

from helpers import sampled_rows, tells
from microbot_ocp import Status
from microbot_ocp.ocp import Guess, OptimalControlProblem, SolverSettings, solve, verify
from microbot_ocp.ocp.search import _other_starts

# what a symmetric guess never leaves --------------------------------------------------------------


def brockett():
    """The nonholonomic integrator: the circle of area 1/2, whose squared length is 2 pi."""
    problem = OptimalControlProblem("nonholonomic integrator")
    phase = problem.phase("all", 1.0)
    x, y = (phase.state(name, initial=0.0, final=0.0) for name in "xy")
    z = phase.state("z", initial=0.0, final=1.0)
    u, v = phase.control("u"), phase.control("v")
    phase.derivative(x, u)
    phase.derivative(y, v)
    phase.derivative(z, x * v - y * u)
    phase.running_cost(u**2 + v**2)
    return problem


def vibrating_string():
    """The mean square of x is 3/4, fixed at both ends: half a sine, 3 pi^2 / 4."""
    problem = OptimalControlProblem("string")
    phase = problem.phase("all", 1.0)
    x = phase.state("x", initial=0.0, final=0.0)
    square = phase.state("square", initial=0.0, final=0.75)
    u = phase.control("u")
    phase.derivative(x, u)
    phase.derivative(square, x**2)
    phase.running_cost(u**2)
    return problem


def elastica():
    """A clamped strip of length 1 whose ends are 0.7 apart has to buckle."""
    problem = OptimalControlProblem("clamped elastica")
    phase = problem.phase("all", 1.0)
    x = phase.state("x", initial=0.0, final=0.7)
    y, angle = (phase.state(name, initial=0.0, final=0.0) for name in ("y", "angle"))
    u = phase.control("u")
    phase.derivative(x, ca.cos(angle))
    phase.derivative(y, ca.sin(angle))
    phase.derivative(angle, u)
    phase.running_cost(u**2)
    return problem


def around_a_disc():
    """From -5 to 5 around a disc of radius 2: two tangents and an arc, squared."""
    problem = OptimalControlProblem("disc")
    phase = problem.phase("all", 1.0)
    x, y = phase.state("x", initial=-5.0, final=5.0), phase.state("y", initial=0.0, final=0.0)
    u, v = phase.control("u"), phase.control("v")
    phase.derivative(x, u)
    phase.derivative(y, v)
    phase.constraint("disc", x**2 + y**2, lower=4.0)
    phase.running_cost(u**2 + v**2)
    return problem


AROUND = (2 * np.sqrt(21.0) + 4 * (np.pi / 2 - np.arccos(0.4))) ** 2


@pytest.mark.parametrize(
    ("problem", "cost"),
    sampled_rows(
        [
            (brockett, 2 * np.pi),
            pytest.param(vibrating_string, 0.75 * np.pi**2, marks=pytest.mark.thorough),
            # Of an integration of the pendulum's equation.
            pytest.param(elastica, 25.694048, marks=pytest.mark.thorough),
            pytest.param(around_a_disc, AROUND, marks=pytest.mark.thorough),
        ],
        2,
    ),
)
def test_a_symmetric_guess_is_left(problem, cost):
    solution = solve(problem())
    assert solution.status.solved
    assert solution.cost == pytest.approx(cost, rel=1e-5)
    assert verify(problem(), solution).ok


def two_wells():
    """Least at x^2 = 3/4, 7/16; standing still at the ridge between costs 1."""
    problem = OptimalControlProblem("two wells")
    phase = problem.phase("all", 1.0)
    x = phase.state("x", initial=0.0)
    u = phase.control("u")
    phase.derivative(x, u)
    phase.running_cost(u**2 / 2)
    phase.end_cost((x**2 - 1) ** 2)
    return problem


@pytest.mark.thorough
def test_a_saddle_is_said_to_be_none_and_left_by_its_direction():
    saddle = solve(two_wells(), settings=SolverSettings("ipopt"))  # as it is told, and no other way
    assert saddle.status is Status.SADDLE
    certificate = verify(two_wells(), saddle)
    assert not certificate.ok
    tells(certificate.verdict, "saddle", "curvature", "-0.8")
    assert certificate.curvature is not None
    # along x = t, u = 1 the cost curves by 1 - 4, where both move by 1 / sqrt(3) and 1
    assert certificate.curvature.least < -0.5
    left = solve(two_wells(), guess=saddle)
    assert left.status.solved
    assert left.cost == pytest.approx(0.4375, rel=1e-6)
    assert any(attempt.way == "from beside a saddle" for attempt in left.attempts)
    passed = verify(two_wells(), left)
    assert passed.ok
    assert passed.curvature is not None
    assert passed.curvature.minimum


@pytest.mark.thorough
def test_a_body_is_turned_as_fast_as_is_known():
    solution = solve(BY_NAME["reorientation"].build())
    assert solution.status.solved
    assert BY_NAME["reorientation"].error(solution.cost) < 1e-4


# one judge ----------------------------------------------------------------------------------------


@pytest.mark.thorough
@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "rayleigh_mixed",
        *(
            pytest.param(n, marks=pytest.mark.thorough)
            for n in ("hang_glider", "orbit_raising", "battery")
        ),
    ],
)
def test_what_is_solved_passes_its_certificate(name):
    """Within 1 % of a state an interval, or with limits exceeded in between, it did not."""
    problem = BY_NAME[name].build()
    solution = solve(problem, guess=BY_NAME[name].guess and BY_NAME[name].guess())
    assert solution.status.solved
    assert verify(problem, solution).ok
    assert BY_NAME[name].error(solution.cost) < 1e-5


def test_what_is_missing_on_a_given_mesh_is_said_in_the_words_of_the_certificate():
    problem = BY_NAME["rayleigh_mixed"].build()
    solution = solve(problem, 20)
    certificate = verify(problem, solution)
    assert solution.status is Status.TOO_COARSE
    assert not certificate.ok
    assert certificate.verdict.removeprefix("Failed: ").split(";")[0] in solution.advice


# scales -------------------------------------------------------------------------------------------


@pytest.mark.thorough
def test_rates_that_are_states_do_not_run_to_infinity():
    """Fitted rates as constant states: solved again in other scales they went to 3e9."""
    marine = BY_NAME["marine_population"]
    (declared,) = marine.build().phases
    (data,) = declared.measurements
    problem = OptimalControlProblem("marine population")
    phase = problem.phase("all", 10.0)
    y, growth, mortality = phase.state("y", 8), *(phase.state(n, k, lower=0.0) for n, k in RATES)
    grown = growth * y[:7]
    phase.derivative(y, ca.vertcat(0, grown) - ca.vertcat(grown, 0) - mortality * y)
    phase.derivative(growth, ca.MX.zeros(7))
    phase.derivative(mortality, ca.MX.zeros(8))
    counts = phase.measurement("data", np.linspace(0.0, 10.0, 21), data.value)
    phase.point_cost(ca.sumsqr(y - counts))
    assert marine.error(solve(problem).cost) < 1e-4


RATES = (("growth", 7), ("mortality", 8))


# budgets ------------------------------------------------------------------------------------------


def test_an_answer_that_was_compared_with_nothing_says_so(monkeypatch):
    monkeypatch.setattr(_other_starts, "_until_they_agree", lambda *_: iter(()))
    solution = solve(two_wells())
    assert solution.compared == 0
    tells(solution.advice, "with nothing")


@pytest.mark.thorough
def test_a_busy_machine_gives_the_same_bits(monkeypatch):
    """A clock that runs twenty times as fast cuts nothing while the limit of time is far."""
    problem = BY_NAME["oscillator_in_least_time"]
    quiet = solve(problem.build(), time_limit=600.0)
    clock = time.perf_counter
    monkeypatch.setattr(time, "perf_counter", lambda: 20 * clock())
    busy = solve(problem.build(), time_limit=600.0)
    assert quiet.variables is not None
    np.testing.assert_array_equal(busy.variables, quiet.variables)


# costs without a lower bound ----------------------------------------------------------------------


@pytest.mark.thorough
def test_a_cost_that_falls_for_ever_is_called_unbounded():
    problem = OptimalControlProblem("as far as possible")
    phase = problem.phase("all", 1.0)
    x, u = phase.state("x", initial=0.0), phase.control("u")
    phase.derivative(x, u)
    phase.end_cost(-x)
    solution = solve(problem, 10)
    assert not solution.status.solved
    assert "unbounded" in {row.kind for row in solution.rows}
    assert "declare scale" not in solution.advice


@pytest.mark.thorough
def test_a_saddle_from_which_the_cost_falls_for_ever_ends_the_search():
    problem = OptimalControlProblem("past a conjugate point")
    phase = problem.phase("all", 5.0)
    x, u = phase.state("x", initial=0.0), phase.control("u")
    phase.derivative(x, u)
    phase.running_cost(u**2 - x**2)
    solution = solve(problem, guess={"all": Guess(values={"x": 0.0, "u": 0.0})})
    assert not solution.status.solved
    assert "unbounded" in {row.kind for row in solution.rows}
    assert len(solution.attempts) < 5
