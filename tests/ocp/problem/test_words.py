"""Free parameters, values at other places, measurements, integrals: against closed forms."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from helpers import crossed, refused
from microbot_ocp.ocp import (
    OptimalControlProblem,
    ParametricSolver,
    SolverSettings,
    load_solution,
    numeric_function,
    repeat,
    save_solution,
    verify,
)
from ocp.textbook import solve_once as solve

TIMES = np.array([0.25, 0.5, 1.0])


def decay(rate: float = 2.0, duration: float = 1.0) -> OptimalControlProblem:
    """The rate of a decay from three measurements."""
    problem = OptimalControlProblem("decay")
    unknown = problem.free_parameter("rate", lower=0.0, upper=10.0, unit="1/s")
    phase = problem.phase("decay", duration)
    x = phase.state("x", initial=1.0)
    phase.derivative(x, -unknown * x)
    y = phase.measurement("y", at=TIMES, values=np.exp(-rate * TIMES))
    phase.point_cost((x - y) ** 2)
    return problem


def chain() -> OptimalControlProblem:
    """Three phases: a jump, a condition on the start of the first, all durations in one cost."""
    problem = OptimalControlProblem("chain")
    first = problem.phase("first", 1.0)
    x = first.state("x", initial=(0.5, 3.0))
    first.derivative(x, -x)
    second = problem.phase("second", (0.1, 5.0))
    y = second.state("x", initial=first.final(x) + 1.0)
    u = second.control("u", lower=-1.0, upper=1.0)
    second.derivative(y, u)
    effort = second.integral("effort", u**2)
    third = problem.phase("third", 1.0)
    z = third.state("x", initial=second.final(y))
    third.derivative(z, 0.0)
    problem.link(first, second)
    problem.link(second, third)
    problem.constraint("twice", third.final(z) - 2.0 * first.initial(x), 0.0, 0.0)
    problem.cost(second.final(effort) + second.duration + first.initial(x) ** 2)
    return problem


@pytest.mark.parametrize(
    ("scheme", "solver"),
    crossed(
        ["shooting", "trapezoidal", "hermite_simpson", "radau", "gauss"],
        ["fatrop", "ipopt", "sqp"],
    ),
)
def test_a_free_parameter_is_found_by_every_scheme_and_solver(scheme, solver):
    solution = solve(decay(), 20, scheme=scheme, settings=SolverSettings(solver=solver))
    assert solution.solved
    accuracy = 2e-3 if scheme == "trapezoidal" else 1e-5
    assert solution.parameters["rate"] == pytest.approx([2.0], abs=accuracy)


@pytest.mark.parametrize("scheme", [pytest.param("shooting", marks=pytest.mark.thorough), "radau"])
def test_what_is_coupled_is_verified_from_the_declaration(scheme):
    problem = chain()
    solution = solve(problem, 10, scheme=scheme)
    # x0: second phase goes from x0/e + 1 to 2 x0 at speed 1 (cost 2 a distance) in the optimum
    share = 2.0 - np.exp(-1.0)
    start = solution.parameters["x at the start of 'first'"][0]
    way = abs(share * start - 1.0)
    assert solution.solved
    assert solution.cost == pytest.approx(
        way**2 / solution["second"].duration + solution["second"].duration + start**2, abs=1e-6
    )
    jump = solution["second"]["x"][0] - solution["first"]["x"][-1]
    assert jump == pytest.approx([1.0], abs=1e-7)
    certificate = verify(problem, solution)
    assert certificate.ok, certificate.verdict
    assert certificate.cost.recomputed == pytest.approx(solution.cost, rel=1e-9)


def test_costs_at_given_times_are_evaluated_again():
    problem = decay()
    solution = solve(problem, 7, scheme="radau")
    assert np.isin(TIMES, solution["decay"].t).all()  # mesh points
    wrong = decay(rate=2.5)
    assert verify(problem, solution).ok
    assert verify(wrong, solution).ok  # data are those that it was solved with
    biased = decay()
    biased.phases[0].point_costs.clear()
    biased.phases[0].point_cost(1.01 * (biased.phases[0].states[0].symbol - 1.0) ** 2, at=TIMES)
    assert not verify(biased, solution).ok


def test_measurements_change_from_solve_to_solve():
    solver = ParametricSolver(decay(), 20)
    first = solver.solve()
    second = solver.solve(parameters={"decay": {"y": np.exp(-3.0 * TIMES)}}, guess=first)
    assert second.parameters["rate"] == pytest.approx([3.0], rel=1e-5)
    with refused("phase 'decay'", "given times", "duration"):
        solver.solve(durations={"decay": 2.0})


def test_what_is_new_is_kept_in_files(tmp_path):
    solution = solve(chain(), 10)
    path = save_solution(solution, tmp_path / "chain.npz")
    alone = load_solution(path)
    assert alone.parameters == solution.parameters
    again = load_solution(path, chain())
    assert verify(chain(), again).ok
    assert repeat(path, chain()).cost == pytest.approx(solution.cost, rel=1e-9)
    fit = save_solution(solve(decay(), 10, scheme="radau"), tmp_path / "fit.npz")
    assert verify(decay(), load_solution(fit, decay())).ok


@pytest.mark.thorough
def test_refinement_keeps_the_times_and_the_parameters():
    refined = solve(decay(), 5, accuracy=1e-8)
    assert refined.status.solved
    assert refined.parameters["rate"] == pytest.approx([2.0], abs=1e-6)
    assert solve(chain(), 5, accuracy=1e-7).status.solved


def test_a_period_of_a_linear_system_is_the_closed_form():
    # x' = -x + sin(2 pi t): the periodic solution starts at -w / (1 + w^2)
    problem = OptimalControlProblem("period")
    phase = problem.phase("lap", 1.0)
    x = phase.state("x")
    phase.derivative(x, -x + ca.sin(2 * np.pi * phase.time))
    phase.end_constraint("period", x - phase.initial(x), 0.0, 0.0)
    solution = solve(problem, 40)
    w = 2 * np.pi
    assert solution["lap"]["x"][0] == pytest.approx([-w / (1 + w**2)], abs=1e-6)
    assert verify(problem, solution).ok


def test_bounds_that_are_expressions_hold():
    # fastest x' = u with u <= 1 - x / 2 from 0 to 1: 2 log 2
    problem = OptimalControlProblem("slower and slower")
    phase = problem.phase("go", (0.1, 10.0))
    x = phase.state("x", initial=0.0, final=1.0)
    u = phase.control("u", lower=-x, upper=1.0 - x / 2, shape="linear")
    phase.derivative(x, u)
    phase.end_cost(phase.duration)
    solution = solve(problem, 50)
    assert solution.cost == pytest.approx(2 * np.log(2.0), rel=1e-4)


def test_a_parameter_of_all_phases_is_one_number():
    problem = OptimalControlProblem("two decays")
    rate = problem.free_parameter("rate", lower=0.0, upper=10.0)
    phases = []
    for name, start in (("a", 1.0), ("between", 1.0), ("b", 3.0)):
        phase = problem.phase(name, 1.0)
        x = phase.state("x", initial=start)
        phase.derivative(x, -x if name == "between" else -rate * x)
        if name != "between":
            data = start * np.exp([-0.5 + (0.1 if name == "a" else 0.0), -1.0])
            y = phase.measurement("y", at=[0.5, 1.0], values=data)
            phase.point_cost((x - y) ** 2)
        phases.append(phase)
    problem.link(phases[0], phases[1], ())
    problem.link(phases[1], phases[2], ())
    solution = solve(problem, 10)
    found = {name: solution[name].parameters["rate"][0] for name in ("a", "between", "b")}
    assert found["a"] == pytest.approx(found["b"], abs=1e-9)
    assert found["a"] == pytest.approx(found["between"], abs=1e-9)
    assert 0.9 < found["a"] < 1.0


def fit(states, rates, slopes, start, times, data, most):
    """A reaction with unknown rates from measurements of all states."""
    problem = OptimalControlProblem("reaction")
    k = problem.free_parameter("k", rates, lower=0.0, upper=most)
    phase = problem.phase("all", times[-1])
    x = phase.state("x", states, initial=start)
    phase.derivative(x, slopes(x, k))
    phase.point_cost(ca.sumsqr(x - phase.measurement("y", times, np.transpose(data))))
    return problem


def predators(z, k):
    return ca.vertcat(k[0] * z[0] * (1 - z[1]), k[1] * z[1] * (z[0] - 1))


def consecutive(y, k):
    return ca.vertcat(-k[0] * y[0], k[0] * y[0] - k[1] * y[1])


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("arguments", "cost", "rates"),
    [
        pytest.param(  # Esposito and Floudas, Ind. Eng. Chem. Res. 39 (2000), Lotka-Volterra
            (
                2,
                2,
                predators,
                [1.2, 1.1],
                np.arange(1.0, 11.0),
                [
                    [0.799, 0.8731, 1.2487, 1.0362, 0.7483, 1.0024, 1.2816, 0.8944, 0.7852, 1.1527],
                    [
                        1.0758,
                        0.8711,
                        0.9393,
                        1.1468,
                        1.0027,
                        0.8577,
                        1.0274,
                        1.1369,
                        0.9325,
                        0.9074,
                    ],
                ],
                10.0,
            ),
            1.24924e-3,
            [3.2434, 0.9209],
            marks=pytest.mark.thorough,
        ),
        (  # Tjoa and Biegler, Ind. Eng. Chem. Res. 30 (1991), example 1
            (
                2,
                2,
                consecutive,
                [1.0, 0.0],
                np.arange(1, 11) / 10,
                [
                    [0.606, 0.368, 0.223, 0.135, 0.082, 0.05, 0.03, 0.018, 0.011, 0.007],
                    [0.373, 0.564, 0.647, 0.669, 0.656, 0.624, 0.583, 0.539, 0.494, 0.451],
                ],
                10.0,
            ),
            1.18584e-6,
            [5.0035, 1.0],
        ),
    ],
)
def test_published_fits_are_reproduced_without_a_guess(arguments, cost, rates):
    problem = fit(*arguments)
    solution = solve(problem, scheme="radau")
    assert solution.solved
    assert solution.cost == pytest.approx(cost, rel=2e-5)
    assert solution.parameters["k"] == pytest.approx(rates, rel=2e-3)
    assert verify(problem, solution).ok


def test_what_is_maximised_is_the_objective(tmp_path):
    problem = OptimalControlProblem("as high as possible", maximize=True)
    phase = problem.phase("go", 1.0)
    x = phase.state("x", initial=0.0)
    u = phase.control("u", lower=-1.0, upper=2.0)
    phase.derivative(x, u)
    phase.end_cost(x)
    solution = solve(problem, 5)
    assert solution.objective == pytest.approx(2.0, abs=1e-6)
    assert solution.cost == -solution.objective
    assert "objective 1.99999" in repr(solution)
    assert verify(problem, solution).ok
    path = save_solution(solution, tmp_path / "high.npz")
    assert load_solution(path).objective == solution.objective


@pytest.mark.thorough
def test_the_clock_goes_on_from_phase_to_phase():
    problem = OptimalControlProblem("clock")
    phases = [
        problem.phase("a", 1.0, start=(2.0, 5.0)),
        problem.phase("b", (0.5, 2.0)),
        problem.phase("c", 1.0),
    ]
    for phase in phases:
        x = phase.state("x", initial=0.0 if phase is phases[0] else None)
        phase.derivative(x, phase.start + phase.time)
    problem.link(*phases[:2])
    problem.link(*phases[1:])
    problem.constraint("end", phases[2].start + 1.0, 6.0, 6.0)
    problem.cost(phases[2].final(x) - 2.0 * phases[1].duration)
    solution = solve(problem, 5)
    start = solution.parameters["start of 'a'"][0]
    duration = solution["b"].duration
    assert start + 2.0 + duration == pytest.approx(6.0, abs=1e-7)
    assert solution["c"]["x"][-1] == pytest.approx([(36.0 - start**2) / 2], abs=1e-6)
    assert duration == pytest.approx(0.5, abs=1e-4)  # a second costs the start's 4 s, less 2
    assert verify(problem, solution).ok


@pytest.mark.thorough
def test_a_template_is_repeated_with_data_of_its_own():
    # two experiments, a decay each from its own start: one rate, two data
    problem = OptimalControlProblem("experiments")
    rate = problem.free_parameter("rate", lower=0.0, upper=10.0)
    phase = problem.phase("experiment", 1.0)
    start = phase.parameter("start", 1.0)
    x = phase.state("x", initial=start)
    phase.derivative(x, -rate * x)
    y = phase.measurement("y", [0.5, 1.0], np.exp([-0.4, -0.8]))
    phase.point_cost((x - y) ** 2)
    phase.point_cost((phase.initial(x) - start) ** 2, at=1.0)  # its own start
    made = problem.repeat(
        phase, 3, names=(), parameters=[{"start": s, "y": s * np.exp([-0.4, -0.8])} for s in (2, 3)]
    )
    assert [own.name for own in made] == ["experiment", "experiment 2", "experiment 3"]
    solution = solve(problem, 10, scheme="radau")
    assert solution.cost == pytest.approx(0.0, abs=1e-10)
    assert solution["experiment 3"].parameters["rate"] == pytest.approx([0.8], abs=1e-5)
    assert [p["x"][0, 0] for p in solution.phases] == pytest.approx([1.0, 2.0, 3.0], abs=1e-7)
    assert verify(problem, solution).ok
    phase.start  # noqa: B018
    with refused("repeat", "last phase", "'experiment'"):
        problem.repeat(phase, 2)


def test_two_components_with_a_pair_are_ambiguous():
    phase = OptimalControlProblem("pair").phase("go", 1.0)
    with refused("initial x", "(1.0, 2.0)", "two values", "[1.0, 2.0]"):
        phase.state("x", 2, initial=(1.0, 2.0))


@pytest.mark.thorough
def test_functions_of_numbers_are_differentiated_by_differences():
    problem = OptimalControlProblem("slope")
    slower = numeric_function(lambda x, share: 1.0 - share * x / 2, sizes=(1, 1))
    phase = problem.phase("up", duration=(0.1, 10.0))
    x = phase.state("x", initial=0.0, final=1.0)
    u = phase.control("u", lower=0.0, upper=1.0)
    phase.derivative(x, u * slower(x, phase.parameter("share", 1.0)))
    phase.end_cost(phase.duration)
    solution = solve(problem, 3, settings=SolverSettings("ipopt"))
    assert solution.solved
    assert solution.cost == pytest.approx(2 * np.log(2.0), rel=1e-5)
    assert verify(problem, solution).ok
    with refused("size", "at least 1", "not 0"):
        numeric_function(np.sin, sizes=(0,))


def refusals():
    problem = OptimalControlProblem("refused")
    phase = problem.phase("go", (1.0, 2.0))
    x = phase.state("x", initial=0.0)
    phase.derivative(x, 1.0)
    fixed = problem.phase("stay", 1.0)
    z = fixed.state("z")
    fixed.derivative(z, 1.0)
    problem.link(phase, fixed, ())
    y = fixed.measurement("y", [0.5], [1.0])
    return problem, phase, x, fixed, z, y


def test_what_cannot_be_said_is_refused_by_name():
    problem, phase, x, fixed, z, y = refusals()
    with refused("point cost", "phase 'go'", "free duration"):
        phase.point_cost(x**2, at=1.0)
    with refused("at", "phase 'stay'", "0 to 1 s", "1.5 s"):
        fixed.value(z, at=1.5)
    with refused("point cost", "phase 'stay'", "at=..."):
        fixed.point_cost(z**2)
    with refused("point cost", "phase 'stay'", "['y'] and at"):
        fixed.point_cost((z - y) ** 2, at=0.25)
    with refused("point cost", "increase", "[0.5, 0.5]"):
        fixed.point_cost(z**2, at=[0.5, 0.5])
    fixed.end_cost(x)
    with refused("phase 'stay'", "'go.x'", "initial()"):
        problem.check()
    problem, phase, x, fixed, z, y = refusals()
    fixed.running_cost((z - y) ** 2)
    with refused("phase 'stay'", "measurement 'stay.y'", "point_cost()"):
        problem.check()
    problem, phase, *_ = refusals()
    z = problem.free_parameter("z")
    phase.end_cost(z)
    with refused("phase 'stay'", "variable 'z'", "free parameter"):
        problem.phases[1].end_cost(z)
    problem, *_ = refusals()
    problem.free_parameter("mass")
    with refused("free parameter 'mass'", "nowhere"):
        problem.check()
