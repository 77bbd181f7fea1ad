"""Problems in unfortunate units are solved as well as in good ones."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from helpers import crossed, refused, sampled, sampled_rows, tells
from microbot_ocp.ocp import (
    Guess,
    OptimalControlProblem,
    ParametricSolver,
    SolverSettings,
    Transcription,
    explain,
    solve,
    verify,
)
from microbot_ocp.ocp.starts import scaled
from ocp.odd_units import EARTH, GODDARD, goddard_in_si, robot_arm


def scales(problem: OptimalControlProblem) -> dict[str, float]:
    (phase,) = problem.phases
    return {v.name: float(v.scale[0]) for v in (*phase.states, *phase.controls, *phase.algebraics)}


@pytest.mark.parametrize("solver", ["ipopt", pytest.param("fatrop", marks=pytest.mark.thorough)])
def test_a_rocket_in_si_units_needs_no_scales(solver):
    found = {
        how: solve(
            goddard_in_si(),
            100,
            settings=SolverSettings(solver=solver, scaling=how),
            scheme="hermite_simpson",
        )
        for how in ("auto", "declared")
    }
    best = found["auto"]
    assert best.status.solved
    assert 1 - best.cost / EARTH == pytest.approx(GODDARD, rel=1e-5)
    assert best.attempts[-1].infeasibility < 1e-7
    assert best.attempts[-1].iterations < 30
    assert found["declared"].attempts[0].iterations > 2 * best.attempts[0].iterations


@pytest.mark.slow
@pytest.mark.parametrize(("m", "s"), sampled_rows([(1e3, 1e3), (1e-3, 1e6)], 2))
@pytest.mark.parametrize("solver", ["ipopt", pytest.param("fatrop", marks=pytest.mark.thorough)])
def test_an_arm_in_odd_units_takes_the_time_that_it_takes_in_good_ones(solver, m, s):
    def time(length_unit, time_unit, how, **more):
        settings = SolverSettings(solver=solver, scaling=how, tolerance=1e-8, **more)
        problem = robot_arm(length_unit, time_unit)
        solution = solve(problem, 40, settings=settings, scheme="hermite_simpson")
        return solution, solution.cost / time_unit

    wanted, best = time(1.0, 1.0, "declared")
    assert wanted.status.solved
    solution, found = time(m, s, "auto")
    assert solution.status.solved
    assert found == pytest.approx(best, rel=1e-6)
    assert solution.attempts[-1].iterations <= 1.5 * wanted.attempts[-1].iterations
    twice = 2 * solution.attempts[-1].iterations
    unscaled, missed = time(m, s, "declared", max_iterations=twice)
    assert not unscaled.status.solved or abs(missed / best - 1) > 0.1


@pytest.mark.thorough
@pytest.mark.parametrize("scheme", ["shooting", "radau"])
def test_costates_and_certificate_are_in_the_units_of_the_declaration(scheme):
    """Least integral of u^2 from rest to rest over D in T: u = 6 D / T^2 (1 - 2 t / T)."""
    distance, duration = 2e5, 4e3  # um and ms
    problem = OptimalControlProblem("rest to rest")
    phase = problem.phase("move", duration)
    x = phase.state("x", initial=0.0, final=distance, unit="um")
    v = phase.state("v", initial=0.0, final=0.0, unit="um/ms")
    u = phase.control("u", shape="linear", unit="um/ms^2")
    phase.derivative(x, v)
    phase.derivative(v, u)
    phase.running_cost(u**2)
    solution = solve(problem, 20, settings=SolverSettings(tolerance=1e-10), scheme=scheme)
    certificate = verify(problem, solution)
    assert certificate.ok, certificate.verdict
    assert solution.cost == pytest.approx(12 * distance**2 / duration**3, rel=1e-8)
    costate, t = certificate.costate("move"), solution["move"].t
    slope = -24 * distance / duration**3
    np.testing.assert_allclose(costate["x"].ravel(), slope, rtol=1e-6)
    wanted = -12 * distance / duration**2 * (1 - 2 * t / duration)
    np.testing.assert_allclose(costate["v"].ravel(), wanted, atol=1e-6 * abs(wanted[0]))


@pytest.mark.parametrize("how", sampled(["auto", "declared"], 2))
def test_a_certificate_is_of_the_scales_of_the_solve(how):
    problem = robot_arm(1e3, 1e3)
    settings = SolverSettings(solver="ipopt", tolerance=1e-9, scaling=how, gap=np.inf)
    solution = solve(problem, 20, settings=settings, scheme="radau")
    assert solution.attempts[-1].status.solved
    for given in (problem, Transcription(problem, scheme="radau")):
        certificate = verify(given, solution)
        assert how == "declared" or certificate.optimality.feasibility.scaled < 1e-6
        assert certificate.optimality.stationarity.scaled < 1e-6
        assert certificate.hamiltonian("move").mean == pytest.approx(-1.0, abs=1e-4)


def test_sizes_are_read_from_conditions_bounds_and_dynamics():
    problem = OptimalControlProblem("sizes")
    phase = problem.phase("one", (50.0, 2e5))
    x = phase.state("x", initial=0.0, final=3e5)
    v = phase.state("v", initial=0.0)  # x in the time of the phase
    force = phase.control("force", lower=-4e6, upper=4e6)
    heat = phase.state("heat", 2, initial=[0.0, 1e-4])  # the first by its derivative
    phase.derivative(x, v)
    phase.derivative(v, force / 2e9)
    phase.derivative(heat, ca.vertcat(force, 1e-9 * v))
    phase.running_cost(force**2)
    phase.constraint("power", force * v, -1e9, 1e9)
    found = scaled(problem)
    (made,) = found.phases
    duration = np.sqrt(50.0 * 5e4)  # the guess of the layer
    sizes = {v.name: v.scale for v in (*made.states, *made.controls)}
    assert sizes["x"] == pytest.approx([1e5], rel=9.99)
    assert sizes["force"] == pytest.approx([1e7], rel=0.99)
    assert abs(np.log10(sizes["heat"][0] / (duration * 4e6))) <= 1
    assert sizes["heat"][1] == pytest.approx(1e-4)
    assert made.duration_scale == 1e3
    assert abs(np.log10(made.constraints[0].scale[0] / (sizes["v"][0] * 4e6))) <= 1
    # the problem itself stays as it was
    assert problem.phases[0].duration_scale is None
    assert all(np.all(v.scale == 1.0) for v in problem.phases[0].states)


def test_a_chain_of_unbounded_variables_is_sized_backwards():
    problem = OptimalControlProblem("chain")
    phase = problem.phase("one", 100.0)
    x = phase.state("x", initial=0.0, final=1e6)
    v = phase.state("v", initial=0.0, final=0.0)
    u = phase.control("u")
    phase.derivative(x, v)
    phase.derivative(v, u)
    phase.running_cost(u**2)
    assert scales(scaled(problem)) == {"x": 1e6, "v": 1e4, "u": 1e2}


def test_what_is_declared_wins():
    problem = OptimalControlProblem("declared")
    phase = problem.phase("one", (100.0, 1e5), scale=7.0)
    x = phase.state("x", initial=0.0, final=1e6, scale=30.0)
    u = phase.control("u", lower=-1e-3, upper=1e-3, scale=0.2)
    phase.derivative(x, u)
    phase.end_constraint("end", 1e5 * x, 0.0, 1e12, scale=11.0)
    (made,) = scaled(problem).phases
    assert (made.states[0].scale, made.controls[0].scale) == ([30.0], [0.2])
    assert made.end_constraints[0].scale == [11.0]
    assert made.duration_scale == 7.0
    with refused("scale", "duration of phase 'two'", "above 0 s", "0.0"):
        problem.phase("two", 1.0, scale=0.0)


def test_a_problem_in_good_units_stays_as_it_is():
    for found in scaled(robot_arm(1.0, 1.0)).phases:
        assert found.duration_scale is None
        assert {k: v for k, v in scales(scaled(robot_arm(1.0, 1.0))).items() if v != 1.0} == {
            "phi rate": 0.1
        }


def test_the_guess_says_the_size_where_nothing_else_does():
    problem = OptimalControlProblem("guess")
    phase = problem.phase("one", 1.0)
    x = phase.state("x")
    u = phase.control("u", lower=-1e12, upper=1e12)  # as good as none
    phase.derivative(x, u)
    phase.end_cost((x - 3e4) ** 2)
    phase.running_cost(u**2)
    guess = {"one": Guess(1.0, {"x": lambda s: 3e4 * s[:, None], "u": [3e4]})}
    assert scales(scaled(problem, guess)) == {"x": 1e4, "u": 1e4}


def spring(size: float) -> OptimalControlProblem:
    problem = OptimalControlProblem("spring")
    phase = problem.phase("one", 1.0)
    x = phase.state("x", initial=1.0)
    u = phase.control("u", lower=-2.0, upper=2.0)
    phase.derivative(x, -x + u)
    phase.running_cost(size * (x**2 + u**2))
    return problem


@pytest.mark.parametrize(("solver", "size"), crossed(["ipopt", "fatrop", "sqp"], [1e-9, 1e9]))
def test_cost_and_multipliers_are_those_of_the_cost_as_it_was_declared(solver, size):
    settings = SolverSettings(solver=solver, tolerance=1e-9)
    plain, odd = (solve(spring(k), 10, settings=settings) for k in (1.0, size))
    assert plain.status.solved
    assert odd.status.solved
    assert (plain.cost_scale, odd.cost_scale) == (1.0, pytest.approx(size, rel=10))
    assert odd.cost == pytest.approx(size * plain.cost, rel=1e-7)
    np.testing.assert_allclose(odd["one"]["u"], plain["one"]["u"], atol=1e-6)
    lam = plain.row_multipliers
    np.testing.assert_allclose(odd.row_multipliers / size, lam, atol=1e-6 * np.abs(lam).max())


@pytest.mark.thorough
def test_a_watched_solve_tells_the_cost_as_it_was_declared():
    for solver in ("ipopt", "fatrop"):
        seen = []
        solution = solve(
            spring(1e9), 10, settings=SolverSettings(solver=solver), progress=seen.append
        )
        assert seen[-1].cost == pytest.approx(solution.cost, rel=1e-3)


def test_warm_starts_of_a_parametric_solver_keep_the_scale_of_the_cost():
    problem = OptimalControlProblem("mass")
    phase = problem.phase("one", (1e2, 1e5))
    x = phase.state("x", initial=0.0, final=1e6)
    v = phase.state("v", initial=0.0, final=0.0)
    u = phase.control("u", lower=-50.0, upper=50.0)
    mass = phase.parameter("mass", 1.0)
    phase.derivative(x, v)
    phase.derivative(v, u / mass)
    phase.running_cost(1.0 + 1e-3 * u**2)
    solver = ParametricSolver(problem, 20, SolverSettings(solver="ipopt"))
    first = solver.solve()
    again = solver.solve(parameters={"one": {"mass": 1.02}}, guess=first)
    fresh = solver.solve(parameters={"one": {"mass": 1.02}})
    assert again.status.solved
    assert again.cost == pytest.approx(fresh.cost, rel=1e-5)
    assert again.attempts[0].iterations < fresh.attempts[0].iterations


def test_limits_in_odd_units_are_explained():
    problem = OptimalControlProblem("too far")
    phase = problem.phase("one", (1.0, 1e3))
    x = phase.state("x", initial=0.0, final=2e6, unit="um")
    u = phase.control("u", lower=0.0, upper=1e3, unit="um/s")
    phase.derivative(x, u)
    phase.end_cost(phase.duration)
    text = str(explain(problem, 5))
    tells(text, "end of x in phase 'one' (value 2e+06 um)", "1e+06 um")


def test_a_scaling_that_there_is_not():
    with refused("scaling", "auto, declared", "'none'"):
        SolverSettings(scaling="none")


# a floor ------------------------------------------------------------------------------------------


def gust(width: float, at: float) -> OptimalControlProblem:
    """Rest to rest at the same place in 10 s, against a push whose tail is all that samples see."""
    problem = OptimalControlProblem("gust")
    phase = problem.phase("one", 10.0)
    x, v = phase.state("x", initial=0.0, final=0.0), phase.state("v", initial=0.0, final=0.0)
    u = phase.control("u")
    phase.derivative(x, v)
    phase.derivative(v, u + 0.8 * ca.exp(-(((phase.time - at) / width) ** 2)))
    phase.running_cost(u**2)
    return problem


@pytest.mark.parametrize(
    ("width", "at"),
    sampled_rows(
        [
            (0.3, 4.1),
            (0.02, 2.222),
            *(
                pytest.param(*case, marks=pytest.mark.thorough)
                for case in ((0.1, 4.1), (0.05, 4.3))
            ),
        ],
        2,
    ),
)
def test_the_tail_of_a_pulse_is_no_size(width, at):
    """The least effort is linear in time: it undoes the impulse and its moment."""
    assert min(scales(scaled(gust(width, at))).values()) >= 1e-4
    impulse = 0.8 * width * np.sqrt(np.pi)
    moments = np.array([[10.0, 50.0], [50.0, 1000 / 3]])
    effort = np.linalg.solve(moments, -impulse * np.array([1.0, at]))
    found = solve(gust(width, at))
    assert found.status.solved
    assert found.cost == pytest.approx(effort @ moments @ effort, rel=1e-5)


@pytest.mark.thorough
def test_components_that_stay_zero_keep_a_scale():
    """A plane motion in space: nothing ever moves along z, and a second scaling sees zeros."""
    problem = OptimalControlProblem("in a plane")
    phase = problem.phase("one", 100.0)
    x, v = phase.state("x", 3, initial=0.0, final=[3e4, 1e4, 0.0]), phase.state("v", 3, initial=0.0)
    u = phase.control("u", 3)
    phase.derivative(x, v)
    phase.derivative(v, u)
    phase.running_cost(ca.sumsqr(u))
    found = solve(problem)
    assert found.cost == pytest.approx(3 * 1e9 / 100.0**3, rel=1e-6)
    again = scaled(problem, found).phases[0]
    assert min(variable.scale.min() for variable in again.variables) >= 1e-9


@pytest.mark.thorough
def test_a_fit_in_phases_with_rates_as_states_stays_near_its_data():
    """The barrier of a usual start outweighs what rates change, which ran away to a poor fit."""
    problem = OptimalControlProblem("a chain of reactions")
    seen = [(70.0, 22.0, 8.0), (50.0, 29.0, 21.0), (26.0, 26.0, 48.0), (10.0, 16.0, 74.0)]
    before = None
    for number, data in enumerate(seen):
        phase = problem.phase(f"phase {number}", 1e3 * (1 + number))
        y = phase.state("y", 3, initial=[100.0, 0.0, 0.0] if number == 0 else None)
        rate = phase.state("rate", 3, lower=0.0)
        first, second, back = (rate[i] * y[i] for i in range(3))
        phase.derivative(y, ca.vertcat(-first, first - second + back, second - back))
        phase.derivative(rate, ca.MX.zeros(3))
        phase.end_cost(ca.sumsqr(y - ca.DM(data)))
        if before is not None:
            problem.link(before, phase)
        before = phase
    found = solve(problem)
    assert found.status.solved
    assert found.cost == pytest.approx(FITTED, rel=1e-5)


FITTED = 125.8143213  # by matrix exponentials and scipy.optimize.least_squares from 20 starts


@pytest.mark.parametrize(
    ("start", "scale"), [(1e-3, 100.0), (1e-4, 100.0), (3.0, 1.0), (0.0, 100.0)]
)
def test_an_end_that_is_small_beside_the_bounds_tells_no_size(start, scale):
    problem = OptimalControlProblem("growth")
    phase = problem.phase("grow", 10.0)
    mass = phase.state("mass", initial=start, lower=0.0, upper=200.0)
    feed = phase.control("feed", lower=0.0, upper=25.0)
    phase.derivative(mass, feed)
    phase.end_cost(-mass)
    assert scaled(problem).phases[0].states[0].scale == pytest.approx(scale)
