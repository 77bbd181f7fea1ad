"""Problems with known answers by both solvers; what a solve says when there is no answer."""

import time

import casadi as ca
import numpy as np
import pytest

from helpers import crossed, refused, tells
from microbot_ocp._base import deadline
from microbot_ocp.ocp.problem import OptimalControlProblem
from microbot_ocp.ocp.search import solve
from microbot_ocp.ocp.solution import Status
from microbot_ocp.ocp.solvers import SolverSettings, _chain
from microbot_ocp.ocp.transcription import Guess
from ocp.textbook import (
    bryson_denham,
    double_integrator,
    mass,
    regulator,
    spline,
    through_half_way,
)

SOLVERS = ("fatrop", "ipopt")
by_both = pytest.mark.parametrize("solver", SOLVERS)


def solved(problem, mesh, solver="auto", **options):
    solution = solve(problem, mesh, settings=SolverSettings(solver=solver, **options))
    assert solution.status is Status.SOLVED
    assert solution.attempts[-1].infeasibility < 1e-7
    return solution


@by_both
def test_the_double_integrator_takes_two_seconds(solver):
    solution = solved(double_integrator(), 20, solver, tolerance=1e-9)
    assert solution.cost == pytest.approx(2.0, abs=1e-6)
    assert solution.duration == pytest.approx(solution.cost)
    phase = solution["move"]
    np.testing.assert_allclose(phase["u"].ravel(), np.repeat([1.0, -1.0], 10), atol=1e-4)
    np.testing.assert_allclose(phase["v"].max(), 1.0, atol=1e-4)
    assert phase["x"].shape == (21, 1)
    assert phase["u"].shape == (20, 1)


@pytest.mark.thorough
@by_both
def test_a_continuous_control_costs_the_ramp_between_its_limits(solver):
    """It turns from 1 to -1 over a step or two of the mesh: second order above 2 s."""
    durations = [solved(double_integrator("linear"), n, solver).cost for n in (10, 20, 40)]
    excess = np.array(durations) - 2.0
    assert np.all(excess > 0)
    np.testing.assert_allclose(excess[:-1] / excess[1:], 4.0, rtol=0.1)
    assert excess[-1] < 1e-3


@by_both
@pytest.mark.parametrize("top", [1 / 9, 1 / 12])
def test_bryson_and_denham_have_their_cost(solver, top):
    """The optimal control has its corners at 3 top and 1 - 3 top: mesh points of 36 intervals."""
    solution = solved(bryson_denham(top), 36, solver, tolerance=1e-9)
    assert solution.cost == pytest.approx(4 / (9 * top), rel=1e-6)
    assert solution["fly"]["x"].max() == pytest.approx(top, abs=1e-6)
    t = solution["fly"].t
    exact = -2 / (3 * top) * np.maximum(1 - np.minimum(t, 1 - t) / (3 * top), 0.0)
    np.testing.assert_allclose(solution["fly"]["u"].ravel(), exact, atol=0.01)


@pytest.mark.thorough
def test_a_ceiling_is_kept_between_mesh_points():
    """On 4 intervals the mesh points alone would let the flight bulge between them."""
    peaks = []
    for between in (True, False):
        problem = OptimalControlProblem("ceiling")
        phase = problem.phase("fly", 1.0, interior_points=(0.25, 0.5, 0.75) if between else ())
        x = phase.state("x", initial=0.0, final=0.0, upper=0.05, interior_points=True)
        v = phase.state("v", initial=1.0, final=-1.0)
        u = phase.control("u", shape="linear")
        phase.derivative(x, v)
        phase.derivative(v, u)
        phase.running_cost(u**2)
        fly = solve(problem, 4, scheme="shooting")["fly"]
        h, inside = 0.25, np.linspace(0, 0.25, 101)
        slope = np.diff(fly["u"], axis=0) / h
        arcs = (
            fly["x"][:-1]
            + fly["v"][:-1] * inside
            + fly["u"][:-1] * inside**2 / 2
            + slope * inside**3 / 6
        )
        peaks.append(arcs.max())
    assert peaks[0] < 0.0525
    assert peaks[1] > peaks[0] + 0.005


@by_both
def test_two_phases_with_continuous_speed_have_their_duration(solver):
    solution = solved(through_half_way(("x", "v")), 24, solver, tolerance=1e-9)
    # the switch from pushing to braking is a mesh point of neither: second order in the step
    assert solution.duration == pytest.approx(0.5 + np.sqrt(1.5), abs=1e-3)
    assert solution["first"].duration == pytest.approx(1.0, abs=1e-5)
    np.testing.assert_allclose(solution["first"]["v"][-1], solution["second"]["v"][0], atol=1e-9)
    np.testing.assert_allclose(solution["first"]["x"][-1], 0.5, atol=1e-9)


@by_both
def test_what_is_not_linked_may_jump(solver):
    solution = solved(through_half_way(("x",)), 24, solver, tolerance=1e-9)
    assert solution.duration == pytest.approx(1.0 + np.sqrt(0.5), abs=1e-5)
    assert solution["first"]["v"][-1, 0] == pytest.approx(1.0, abs=1e-4)
    assert solution["second"]["v"][0, 0] == pytest.approx(np.sqrt(2.0), abs=1e-4)


@pytest.mark.parametrize(("mesh", "solver"), crossed([2, 3, 8], SOLVERS))
@pytest.mark.parametrize(("times", "middle"), [((1.0, 0.5), 0.3), ((0.4, 2.0), 0.7)])
def test_least_effort_through_a_point_is_the_clamped_spline(solver, mesh, times, middle):
    solution = solved(spline(times, middle), mesh, solver)
    first, second = times
    speed = 1.5 * (middle / first**2 + (1 - middle) / second**2) / (1 / first + 1 / second)
    effort = 0.0
    for h, rise, begin, end in ((first, middle, 0.0, speed), (second, 1 - middle, speed, 0.0)):
        u0, u1 = 6 * rise / h**2 - (4 * begin + 2 * end) / h, (2 * begin + 4 * end) / h
        u1 -= 6 * rise / h**2
        effort += h * (u0**2 + u0 * u1 + u1**2) / 3
    assert solution.cost == pytest.approx(effort, rel=1e-9)
    assert solution["second"]["v"][0, 0] == pytest.approx(speed, rel=1e-8)
    assert [phase.duration for phase in solution.phases] == pytest.approx(times, rel=1e-12)
    assert solution.attempts[-1].iterations <= 5  # a quadratic program without inequalities


def test_a_problem_without_end_cost_in_any_phase_has_its_whole_gradient():
    assert solved(spline((1.0, 0.5), 0.3), 5, "ipopt").cost == pytest.approx(19.29, rel=1e-9)


@pytest.mark.parametrize(
    ("shape", "order"),
    [("linear", 4.0), pytest.param("constant", 2.0, marks=pytest.mark.thorough)],
)
def test_the_cost_converges_with_the_order_of_its_control(shape, order):
    meshes = np.array([4, 8, 16, 32])
    errors = [
        abs(solved(regulator(shape), int(n), "ipopt", tolerance=1e-12).cost - np.tanh(1) / 2)
        for n in meshes
    ]
    slope = np.polyfit(np.log(1 / meshes), np.log(errors), 1)[0]
    assert slope == pytest.approx(order, abs=0.25)


@pytest.mark.thorough
def test_a_linear_control_converges_with_second_order():
    meshes = np.array([4, 8, 16, 32])
    errors = []
    for n in meshes:
        phase = solved(regulator(), int(n), "ipopt", tolerance=1e-12)["calm"]
        exact = -np.sinh(1 - phase.t) / np.cosh(1)
        errors.append(np.abs(phase["u"].ravel() - exact).max())
    assert np.polyfit(np.log(1 / meshes), np.log(errors), 1)[0] == pytest.approx(2.0, abs=0.25)


def test_scales_do_not_change_the_answer():
    problem = OptimalControlProblem("scaled")
    phase = problem.phase("move", (0.01, 10.0))
    x = phase.state("x", initial=0.0, final=1000.0, scale=500.0)
    v = phase.state("v", initial=0.0, final=0.0, scale=800.0)
    u = phase.control("u", lower=-1000.0, upper=1000.0, scale=1000.0)
    phase.derivative(x, v)
    phase.derivative(v, u)
    phase.end_cost(phase.duration)
    assert solved(problem, 20).duration == pytest.approx(2.0, abs=1e-5)


def test_a_mesh_of_uneven_fractions_is_solved_as_it_is():
    mesh = np.array([0.0, 0.05, 0.2, 0.5, 0.6, 0.9, 1.0])
    solution = solved(double_integrator(), [mesh])
    np.testing.assert_array_equal(solution["move"].mesh, mesh)
    assert solution.duration == pytest.approx(2.0, abs=1e-5)


# failures -----------------------------------------------------------------------------------------


def test_what_one_solver_leaves_open_goes_to_the_next():
    settings = SolverSettings(("ipopt", "fatrop"), options={"ipopt": {"max_iter": 1}}, gap=np.inf)
    solution = solve(double_integrator(), 20, settings=settings)
    assert [attempt.solver for attempt in solution.attempts] == ["ipopt", "fatrop"]
    assert [attempt.status.solved for attempt in solution.attempts] == [False, True]
    assert solution.attempts[0].status is Status.ITERATION_LIMIT
    assert solution.status is Status.SOLVED
    assert solution.cost == solution.attempts[1].cost == pytest.approx(2.0, abs=1e-5)


def test_only_the_limit_of_time_of_all_ends_a_solver_that_another_follows(monkeypatch):
    ends, runner = [], _chain.Runner
    monkeypatch.setattr(
        _chain, "Runner", lambda *given: ends.append(deadline.until()) or runner(*given)
    )
    before = time.perf_counter()
    settings = SolverSettings(("fatrop", "ipopt"), time_limit=100.0)
    assert solve(double_integrator(), 10, settings=settings, time_limit=100.0).status.solved
    assert ends[0] >= before + 100.0


def test_a_limit_counts_work_and_what_the_wall_time_ends_says_so():
    """A progress that sleeps takes wall time alone: ten times the limit are enough, not more."""

    def idle(_):
        time.sleep(0.005)

    begun = time.perf_counter()
    solution = solve(double_integrator(), time_limit=3.0, progress=idle)
    assert solution.status.solved
    assert time.perf_counter() - begun > 0.4
    ended = solve(double_integrator(), time_limit=0.05, progress=idle)
    assert not ended.compared or not ended.status.solved
    with deadline.within(np.inf, 1.0):
        assert 0.0 < deadline.work_left() <= 1.0
        time.sleep(0.1)
        assert deadline.work_left() > 0.95
    assert deadline.work_left() == np.inf


def test_a_solver_that_succeeds_is_the_last_one_tried():
    solution = solved(double_integrator(), 20)
    assert {attempt.solver for attempt in solution.attempts} == {"ipopt"}


@pytest.mark.parametrize("solver", ["auto", *SOLVERS])
def test_the_iteration_limit_is_said_with_advice(solver):
    settings = SolverSettings(solver=solver, max_iterations=2)
    solution = solve(double_integrator("linear"), 20, settings=settings)
    assert solution.status is Status.ITERATION_LIMIT
    tells(solution.advice, Status.ITERATION_LIMIT.sentence, "explain(")
    ways = {attempt.way for attempt in solution.attempts}
    assert (len(ways) > 1) == (solver == "auto")
    assert np.isfinite(solution["move"]["x"]).all()


def contradictory():
    """1 m from rest to rest in 1 s takes 4 m/s^2 at least."""
    problem = OptimalControlProblem("contradictory")
    phase, u = mass(problem, "move", 1.0, force=1.0, ends=((0.0, 0.0), (1.0, 0.0)))
    phase.running_cost(u**2)
    return problem


def undefined():
    problem = OptimalControlProblem("undefined")
    phase = problem.phase("move", 1.0)
    x = phase.state("x", initial=-1.0, final=-2.0)
    u = phase.control("u")
    phase.derivative(x, ca.sqrt(x) + u)
    phase.running_cost(u**2)
    return problem


@pytest.mark.parametrize("solver", ["auto", *SOLVERS])
def test_a_problem_without_an_answer_is_a_status_not_an_exception(solver):
    settings = SolverSettings(solver=solver, max_iterations=100)
    solution = solve(contradictory(), 10, settings=settings)
    assert not solution.status.solved
    assert solution.advice.startswith(solution.status.sentence)
    solvers = [attempt.solver for attempt in solution.attempts if not attempt.way]
    assert solvers == ["ipopt" if solver == "auto" else solver]
    assert not solution.attempts[-1].infeasibility < 1e-6


def test_dynamics_that_end_on_the_way_are_a_status_too():
    settings = SolverSettings("ipopt", max_iterations=100)
    solution = solve(undefined(), 10, {"move": Guess(1.0, {"x": 1.0})}, settings)
    assert not solution.status.solved


def test_contradictory_limits_are_called_infeasible():
    solution = solve(contradictory(), 10, settings=SolverSettings(solver="ipopt"))
    assert solution.status is Status.INFEASIBLE
    tells(solution.advice, Status.INFEASIBLE.sentence)


def test_attempts_are_plain_values():
    (attempt,) = solved(double_integrator(), 4).attempts
    stored = attempt.as_dict()
    assert stored["status"] == "solved"
    assert all(isinstance(value, str | int | float) for value in stored.values())
    assert attempt.wall_time > 0


def test_an_unknown_phase_of_a_solution_is_a_key_error():
    with refused("'stay'", "'move'", error=KeyError):
        solved(double_integrator(), 4)["stay"]


@pytest.mark.thorough
def test_a_small_barrier_stays_near_a_good_guess():
    problem = double_integrator()
    first = solved(problem, 20, "ipopt", tolerance=1e-9)
    phase = first["move"]
    guess = {"move": Guess(phase.duration, {"x": phase["x"], "v": phase["v"], "u": phase["u"]})}
    counts = []
    for barrier in (None, 1e-6):
        settings = SolverSettings("ipopt", tolerance=1e-9, initial_barrier=barrier)
        again = solve(problem, 20, guess, settings)
        assert again.cost == pytest.approx(2.0, abs=1e-6)
        counts.append(again.attempts[0].iterations)
    assert counts[1] < counts[0]
