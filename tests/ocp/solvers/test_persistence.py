"""Solutions come back from their file as they were, and nothing else is taken for one."""

import json
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from helpers import refused, sampled, tells
from microbot_ocp import InputError
from microbot_ocp.ocp import Status
from microbot_ocp.ocp.problem import OptimalControlProblem
from microbot_ocp.ocp.search import solve
from microbot_ocp.ocp.solvers import (
    ParametricSolver,
    SolverSettings,
    load_solution,
    repeat,
    save_solution,
    saved_with,
)
from microbot_ocp.ocp.transcription import Guess, Transcription
from microbot_ocp.ocp.verification import verify
from ocp.textbook import double_integrator, through_half_way


@pytest.fixture(scope="module")
def transcription():
    return Transcription(through_half_way(("x", "v")), scheme="radau")


@pytest.fixture(scope="module")
def solution(transcription):
    settings = SolverSettings("ipopt", options={"ipopt": {"mu_strategy": "adaptive"}})
    return solve(transcription, [6, np.linspace(0, 1, 9) ** 1.2], settings=settings)


def test_a_solution_comes_back_as_it_was(solution, tmp_path):
    again = load_solution(save_solution(solution, tmp_path / "run.npz"))
    assert again.status is solution.status
    assert again.cost == solution.cost
    assert again.attempts == solution.attempts
    assert again.settings == solution.settings
    for key in ("row_multipliers", "variable_multipliers", "variables"):
        np.testing.assert_array_equal(getattr(again, key), getattr(solution, key))
    for before, after in zip(solution.phases, again.phases, strict=True):
        assert (before.name, before.duration) == (after.name, after.duration)
        np.testing.assert_array_equal(before.mesh, after.mesh)
        assert before.values.keys() == after.values.keys()
        for name in before.values:
            np.testing.assert_array_equal(before[name], after[name])
    assert [path.name for path in tmp_path.iterdir()] == ["run.npz"]


def test_with_its_transcription_it_is_sampled_and_solved_again(solution, transcription, tmp_path):
    again = load_solution(save_solution(solution, tmp_path / "run.npz"), transcription)
    t = np.linspace(0.0, again["first"].duration, 7)
    for name, values in solution["first"].sample(t).items():
        np.testing.assert_array_equal(again["first"].sample(t)[name], values)
    meshes = [phase.mesh for phase in again.phases]
    once_more = solve(transcription, meshes, again, SolverSettings("ipopt"))
    assert once_more.cost == pytest.approx(solution.cost, rel=1e-6)
    assert once_more.attempts[0].iterations < solution.attempts[0].iterations


def test_without_its_transcription_it_starts_another_solve(solution, transcription, tmp_path):
    again = load_solution(save_solution(solution, tmp_path / "run.npz"))
    assert solve(transcription, 10, again).status.solved
    with refused("phase 'first'", "mesh values"):
        again["first"].sample(0.1)


def test_what_is_needed_to_repeat_a_run_is_inside(solution, tmp_path):
    inside = saved_with(save_solution(solution, tmp_path / "run.npz"))
    assert inside["versions"]["casadi"] == ca.CasadiMeta.version()
    assert inside["settings"]["solver"] == "ipopt"
    assert inside["settings"]["options"] == {"ipopt": {"mu_strategy": "adaptive"}}
    repeated = SolverSettings(**inside["settings"])
    assert repeated.tolerance == 1e-7


def test_another_problem_is_refused(solution, tmp_path):
    path = save_solution(solution, tmp_path / "run.npz")
    with refused("run.npz", "['first', 'second']", "['move']"):
        load_solution(path, Transcription(double_integrator()))
    other = through_half_way(("x", "v"))
    other.phases[0].parameter("mass", 1.0)
    with refused("run.npz", "phase 'first'", "parameters []", "['mass']"):
        load_solution(path, Transcription(other))


def test_a_newer_or_broken_file_is_refused_in_one_line(solution, tmp_path):
    path = save_solution(solution, tmp_path / "run.npz")
    with np.load(path) as stored:
        arrays = dict(stored)
    newer = {**json.loads(str(arrays["metadata"])), "schema": 99}
    np.savez(tmp_path / "newer.npz", **{**arrays, "metadata": json.dumps(newer)})
    (tmp_path / "text.npz").write_text("no archive")
    (tmp_path / "cut.npz").write_bytes(path.read_bytes()[:-200])
    np.savez(tmp_path / "other.npz", t=np.zeros(3))
    arrays.pop("row_multipliers")
    np.savez(tmp_path / "less.npz", **arrays)
    for name, said in (
        ("newer", ("newer.npz", "schema 99", "up to 1")),
        ("text", ("text.npz", "saved solution", "zip")),
        ("cut", ("cut.npz", "saved solution", "zip")),
        ("other", ("other.npz", "saved solution", "'metadata'")),
        ("less", ("less.npz", "saved solution", "changed")),
        ("none", ("none.npz", "no file")),
    ):
        with refused(*said) as raised:
            load_solution(tmp_path / f"{name}.npz")
        assert "\n" not in str(raised.value)


def test_options_that_are_no_plain_values_are_refused(tmp_path):
    settings = SolverSettings("ipopt", options={"ipopt": {"tol": np.array([1e-8])}})
    with pytest.raises((InputError, NotImplementedError, RuntimeError)):
        save_solution(solve(double_integrator(), 4, settings=settings), tmp_path / "run.npz")


def pull(mass=1.0, strength=1.0):
    problem = OptimalControlProblem("pull")
    phase = problem.phase("move", (1.0, 1e4))
    x = phase.state("x", initial=0.0, final=5e4, unit="mm")
    v = phase.state("v", initial=0.0, final=0.0, unit="mm/s")
    u = phase.control("u", lower=-strength, upper=strength)
    constant = phase.parameter("mass", mass)
    phase.derivative(x, v)
    phase.derivative(v, u / constant)
    phase.constraint("power", u * v, upper=3e3)
    phase.end_cost(1e6 * phase.duration)
    return problem


@pytest.mark.parametrize(
    "solver", sampled(["auto", "ipopt", pytest.param("fatrop", marks=pytest.mark.thorough)], 2)
)
def test_a_run_is_repeated_from_its_file(solver, tmp_path):
    guess = {"move": Guess(400.0, {"x": lambda s: 5e4 * s[:, None], "v": 100.0, "u": 0.1})}
    settings = SolverSettings(solver, tolerance=1e-8)
    first = solve(pull(), [np.linspace(0, 1, 17) ** 1.1], guess, settings, scheme="radau")
    assert first.attempts[-1].status.solved
    assert first.cost_scale != 1.0
    path = save_solution(first, tmp_path / "run.npz")
    again = repeat(path, pull(mass=7.0, strength=9.0))  # what the file says counts
    assert again.cost == first.cost
    assert again.cost_scale == first.cost_scale
    assert [a.iterations for a in again.attempts] == [a.iterations for a in first.attempts]
    for name, values in first["move"].values.items():
        np.testing.assert_array_equal(again["move"][name], values)
    # a warm start is repeated, too
    warm = solve(pull(1.1), 20, first, settings, scheme="radau")
    assert repeat(save_solution(warm, tmp_path / "warm.npz"), pull()).cost == warm.cost


def test_a_parametric_solve_keeps_what_it_was_solved_with(tmp_path):
    solver = ParametricSolver(pull(), 20, SolverSettings("ipopt"))
    changes = {
        "parameters": {"move": {"mass": 2.5}},
        "bounds": {"move": {"u": (-0.5, 2.0), "power": (None, 1e9)}},
        "final": {"move": {"x": 3e4}},
        "durations": {"move": (2.0, 5e3)},
    }
    solved = solver.solve(**changes)
    assert solved.status.solved
    path = save_solution(solved, tmp_path / "run.npz")
    for given in (pull(), solver.transcription):
        loaded = load_solution(path, given)
        phase = loaded["move"].layout.phase
        assert phase.parameters[0].value == [2.5]
        assert (phase.controls[0].lower, phase.controls[0].upper) == ([-0.5], [2.0])
        assert phase.duration_bounds == (2.0, 5e3)
        t = np.linspace(0.0, loaded.duration, 33)
        np.testing.assert_array_equal(loaded["move"].sample(t)["v"], solved["move"].sample(t)["v"])
        certificate = verify(given, loaded)
        assert certificate.optimality.stationarity.scaled < 1e-6
        assert certificate.optimality.feasibility.scaled < 1e-6
    assert repeat(path, pull()).cost == pytest.approx(solved.cost, rel=1e-9)


def test_a_file_without_a_start_is_not_repeated(transcription, solution, tmp_path):
    path = save_solution(replace(solution, start=None), tmp_path / "run.npz")
    with refused("run.npz", "without the start"):
        repeat(path, transcription)


@pytest.mark.parametrize(
    ("name", "status"),
    [("solved", Status.SOLVED), ("iteration_limit", Status.ITERATION_LIMIT)],
)
def test_a_file_that_an_earlier_version_wrote_is_read(name, status):
    stored = Path(__file__).parent / "data" / f"{name}_schema_1.npz"
    loaded = load_solution(stored, double_integrator())
    assert loaded.status is loaded.attempts[-1].status is status
    assert loaded["move"]["x"].shape == (11, 1)
    if status.solved:
        assert verify(double_integrator(), loaded).ok
        assert repeat(stored, double_integrator()).cost == pytest.approx(loaded.cost, rel=1e-6)
    else:
        tells(loaded.advice, "explain(")
