"""Changed numbers without rebuilding: what comes out is what a new problem would give."""

import copy
import pickle
import subprocess
import sys

import casadi as ca
import numpy as np
import pytest

import microbot_ocp as mo
from helpers import refused, sampled_rows
from microbot_ocp.ocp.problem import OptimalControlProblem
from microbot_ocp.ocp.search import solve
from microbot_ocp.ocp.solvers import ParametricSolver, SolverSettings, _run as run
from microbot_ocp.ocp.transcription import Transcription
from ocp.textbook import bryson_denham, everything, through_half_way


def cart(mass=1.0, force=1.0, goal=1.0, top=9.0, power=9.0, longest=10.0):
    """Shortest time over a distance: 2 sqrt(goal mass / force) where nothing else limits."""
    problem = OptimalControlProblem("cart")
    phase = problem.phase("move", (0.1, longest))
    x = phase.state("x", initial=0.0, final=goal, unit="m")
    v = phase.state("v", initial=0.0, final=0.0, upper=top, unit="m/s", interior_points=True)
    u = phase.control("u", lower=-force, upper=force, unit="N", scale=2.0)
    m = phase.parameter("mass", mass)
    phase.parameter("unused", [1.0, 2.0])
    phase.derivative(x, v)
    phase.derivative(v, u / m)
    phase.constraint("power", u * v, upper=power, scale=3.0, unit="W")
    phase.end_cost(phase.duration)
    return problem


@pytest.fixture(scope="module")
def solver():
    return ParametricSolver(cart(), 20, SolverSettings("ipopt"))


@pytest.mark.parametrize(
    ("changes", "declared"),
    sampled_rows(
        [
            ({}, {}),
            ({"parameters": {"move": {"mass": 1.3}}}, {"mass": 1.3}),
            ({"bounds": {"move": {"u": (-0.8, 0.8)}}}, {"force": 0.8}),
            ({"bounds": {"move": {"v": (None, 0.7)}}}, {"top": 0.7}),
            ({"bounds": {"move": {"power": (None, 0.4)}}}, {"power": 0.4}),
            ({"final": {"move": {"x": 1.5}}}, {"goal": 1.5}),
            ({"initial": {"move": {"x": -0.5}}}, {"goal": 1.5}),
            (
                {"durations": {"move": (0.1, 2.5)}, "parameters": {"move": {"mass": 1.2}}},
                {"longest": 2.5, "mass": 1.2},
            ),
        ],
        3,
    ),
)
def test_a_changed_number_is_a_newly_declared_one(solver, changes, declared):
    expected = solve(cart(**declared), 20, settings=SolverSettings("ipopt"))
    solution = solver.solve(**changes)
    assert solution.status.solved
    assert solution.cost == pytest.approx(expected.cost, rel=1e-6)
    np.testing.assert_allclose(solution["move"]["u"], expected["move"]["u"], atol=2e-3)


def test_the_next_solve_is_as_declared_again(solver):
    solver.solve(bounds={"move": {"u": (-0.8, 0.8)}})
    assert solver.solve().cost == pytest.approx(2.0, abs=1e-5)


def test_a_fixed_duration_is_a_change_like_another(solver):
    solution = solver.solve(durations={"move": 2.2})
    assert solution.duration == pytest.approx(2.2, rel=1e-6)


def test_a_neighbour_is_solved_in_a_fraction_of_the_iterations(solver):
    first = solver.solve()
    for change in (0.95, 1.05):
        limits = {"move": {"u": (-change, change)}}
        cold = solver.solve(bounds=limits)
        warm = solver.solve(bounds=limits, guess=first)
        assert warm.cost == pytest.approx(2.0 / np.sqrt(change), abs=2e-4)
        assert warm.cost == pytest.approx(cold.cost, abs=1e-5)
        assert warm.attempts[0].iterations <= cold.attempts[0].iterations / 2


def test_the_barrier_of_a_warm_start_grows_with_what_was_moved(monkeypatch):
    barriers = []
    create = run.create

    def noted(program, name, settings, **options):
        if options.get("variant") and "ipopt warm" in settings.options:
            barriers.append(settings.options["ipopt warm"]["mu_init"])
        return create(program, name, settings, **options)

    monkeypatch.setattr(run, "create", noted)
    solver = ParametricSolver(cart(), 20, SolverSettings("ipopt", gap=np.inf))
    first = solver.solve()
    for force in (1.0, 0.99, 0.5):
        solution = solver.solve(bounds={"move": {"u": (-force, force)}}, guess=first)
        assert solution.cost == pytest.approx(2.0 / np.sqrt(force), rel=1e-3)
    assert barriers == sorted(set(barriers))
    assert len(barriers) == 3


def test_solvers_are_made_once(monkeypatch):
    made = []
    create = run.create
    monkeypatch.setattr(run, "create", lambda *a, **k: (made.append(a[1]), create(*a, **k))[1])
    solver = ParametricSolver(cart(), 10)
    first = solver.solve()
    for mass in (1.1, 1.2, 1.3):
        assert solver.solve(parameters={"move": {"mass": mass}}, guess=first).status.solved
    assert len(made) <= 3  # fatrop, IPOPT from a solution, IPOPT to close the gap


def test_samples_are_of_the_parameters_that_were_solved_for(solver):
    solution = solver.solve(parameters={"move": {"mass": 4.0}})
    phase = solution["move"]
    t = phase.duration / 40
    u = phase["u"][0, 0]
    assert phase.sample(t)["v"][0, 0] == pytest.approx(u / 4.0 * t, rel=1e-6)


def test_derivatives_know_parameters_as_arguments():
    import casadi as ca

    from microbot_ocp.ocp.transcription import assemble

    problem = everything()
    transcription = Transcription(problem, duration_scale=0.7)
    fixed, free = (assemble(transcription.layouts([3, 4]), parametric=yes) for yes in (False, True))
    np.testing.assert_array_equal(free.parameters, [0.7, -1.3])
    x = np.random.default_rng(0).uniform(0.2, 1.5, fixed.variable_lower.size)
    lam = np.random.default_rng(1).normal(size=fixed.row_lower.size)
    for name, rest in (("jacobian", []), ("gradient", []), ("hessian", [1.3, lam])):
        values = (
            program.functions[name].call([x, program.parameters, *rest])[-1]
            for program in (fixed, free)
        )
        a, b = (np.array(ca.DM(v)) for v in values)
        np.testing.assert_allclose(a, b, rtol=1e-14)


def test_two_phases_are_changed_by_name():
    solver = ParametricSolver(through_half_way(("x", "v")), 24, SolverSettings("ipopt"))
    problem = through_half_way(("x", "v"))
    expected = solve(problem, 24, settings=SolverSettings("ipopt"))
    assert solver.solve().cost == pytest.approx(expected.cost, rel=1e-6)
    slower = solver.solve(bounds={"second": {"u": (-1.0, 1.0)}}, guess=expected)
    assert slower.cost == pytest.approx(2.0, abs=1e-3)


def test_it_goes_through_a_pickle(solver):
    again = pickle.loads(pickle.dumps(solver))
    for changes in ({}, {"parameters": {"move": {"mass": 1.3}}}):
        assert again.solve(**changes).cost == pytest.approx(solver.solve(**changes).cost, rel=1e-9)
    assert copy.copy(again).solve().status.solved


def test_another_process_takes_it(tmp_path):
    solver = ParametricSolver(bryson_denham(1 / 9), 12)
    (tmp_path / "solver.pickle").write_bytes(pickle.dumps(solver))
    code = (
        "import pickle, sys; s = pickle.load(open(sys.argv[1], 'rb')); "
        "print(s.solve(bounds={'fly': {'x': (None, 0.125)}}).cost)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "solver.pickle")],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    expected = solver.solve(bounds={"fly": {"x": (None, 0.125)}}).cost
    assert float(done.stdout) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"bounds": {"stay": {}}}, ("bounds", "'stay'", "['move']")),
        ({"bounds": {"move": {"w": (0, 1)}}}, ("phase 'move'", "limit 'w'", "'u', 'v', 'x'")),
        ({"bounds": {"move": {"u": 1.0}}}, ("bounds of 'u'", "(lower, upper)", "1.0")),
        ({"bounds": {"move": {"u": (1.0, -1.0)}}}, ("bounds of 'u'", "lower 1", "upper -1 N")),
        ({"bounds": {"move": {"u": ([1, 2], 3)}}}, ("lower u", "[1]", "[2]")),
        (
            {"parameters": {"move": {"k": 1.0}}},
            ("phase 'move'", "parameter 'k'", "['mass', 'unused']"),
        ),
        ({"parameters": {"move": {"mass": [1, 2]}}}, ("parameter 'mass'", "[1]", "[2]")),
        ({"parameters": {"move": {"mass": np.nan}}}, ("parameter 'mass'", "[0]", "nan")),
        ({"initial": {"move": {"u": 1.0}}}, ("phase 'move'", "initial 'u'", "['v', 'x']")),
        ({"durations": {"move": (1.0, np.inf)}}, ("upper duration", "phase 'move'", "inf s")),
    ],
)
def test_a_wrong_change_is_refused_in_words(solver, changes, said, no_solver):
    with refused(*said):
        solver.solve(**changes)


def test_a_condition_that_was_not_declared_is_refused(no_solver):
    solver = ParametricSolver(through_half_way(("x", "v")), 4)
    with refused("'v'", "phase 'first'", "final"):
        solver.solve(final={"first": {"v": 0.0}})


def test_slopes_of_the_cost_are_central_differences_of_solves(solver):
    def cost(**values):
        return solver.solve(parameters={"move": values}).cost

    slopes = solver.solve(parameters={"move": {"mass": 1.1}}).sensitivities()["move"]
    assert slopes["mass"] == pytest.approx([(cost(mass=1.11) - cost(mass=1.09)) / 0.02], rel=1e-3)
    assert slopes["mass"] == pytest.approx([(1 / 1.1) ** 0.5], rel=1e-5)  # sqrt(s / (F m))
    assert slopes["unused"].tolist() == [0.0, 0.0]


def test_slopes_of_a_gain_and_of_measurements_are_those_of_the_objective():
    problem = OptimalControlProblem("gain", maximize=True)
    phase = problem.phase("all", duration=1.0)
    x = phase.state("x", initial=0.0)
    phase.derivative(x, phase.control("u", lower=-1.0, upper=phase.parameter("top", 2.0)))
    y = phase.measurement("y", at=[0.5, 1.0], values=[0.3, 0.4])
    phase.point_cost(x - y**2)
    slopes = solve(problem, mesh=4).sensitivities()["all"]
    assert slopes["top"] == pytest.approx([1.5], abs=1e-5)
    assert slopes["y"].ravel() == pytest.approx([-0.6, -0.8], abs=1e-5)


def receding():
    """A double integrator with a disturbance that is regulated over 4 s, and its solver."""
    problem = OptimalControlProblem("regulator")
    phase = problem.phase("horizon", duration=4.0)
    x = phase.state("x", 2, initial=phase.parameter("now", [1.0, 0.0]))
    u = phase.control("u", lower=-1.0, upper=1.0)
    phase.derivative(x, ca.vertcat(x[1], u + 0.3 * ca.sin(3 * x[0])))
    phase.running_cost(ca.sumsqr(x) + 0.01 * u**2)
    return ParametricSolver(problem, 40)


def test_a_shifted_solution_is_the_same_curve_and_a_better_start():
    solver = receding()
    first = solver.solve()
    later = first.shifted(0.5)
    t = np.linspace(0.0, 3.5, 8)
    seen = later["horizon"].sample(t)["x"]
    np.testing.assert_allclose(seen, first["horizon"].sample(t + 0.5)["x"])
    assert later["horizon"].t[0] == -0.5
    changed = {"horizon": {"now": seen[0] + [0.02, 0.0]}}
    counts = [
        sum(a.iterations for a in solver.solve(parameters=changed, guess=guess).attempts)
        for guess in (later, first, None)
    ]
    assert counts[0] < 0.6 * min(counts[1:])


def test_only_one_phase_of_fixed_duration_is_shifted(solver):
    with refused("shifted", "one phase", "fixed duration"):
        solver.solve().shifted(0.1)


@pytest.mark.skipif(mo.compiler() is None, reason="no C compiler")
def test_exported_c_solves_the_problem_alone(solver, tmp_path):
    code = solver.export_c(tmp_path / "cart.c")
    library = str(tmp_path / "cart.so")
    flags = ["-O0", "-shared", "-fPIC", "-o", library, str(code), "-lm"]
    subprocess.run(["cc", *flags], check=True)
    data, run, values = (ca.external(name, library) for name in ("data", "solve", "values"))
    arguments = data()
    heavier = {**arguments, "p": [1.21, 1.0, 2.0]}
    for given, seconds in ((arguments, 2.0), (heavier, 2.2)):
        x = run(**given, lam_x0=0.0, lam_g0=0.0)["x"]
        solution = values(x=x)
        assert float(solution["move_duration"]) == pytest.approx(seconds, abs=1e-5)
        assert solution["move_x"].shape == (21, 1)
        assert float(solution["move_x"][-1]) == pytest.approx(1.0)


def test_what_is_compiled_is_not_exported_again(tmp_path):
    compiled = Transcription(cart(), prepare=lambda _, make: make())
    with refused("compiled functions", "exported"):
        ParametricSolver(compiled, 20).export_c(tmp_path / "x.c")
