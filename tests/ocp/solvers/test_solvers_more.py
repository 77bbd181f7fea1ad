"""The SQP method, warm starts from solutions, progress, Ctrl-C, starts that are no numbers."""

import ctypes
import os
import signal
import subprocess
import sys
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from helpers import refused, sampled, sampled_rows
from microbot_ocp.ocp.problem import OptimalControlProblem
from microbot_ocp.ocp.search import solve
from microbot_ocp.ocp.solution import Status
from microbot_ocp.ocp.solvers import SolverSettings
from microbot_ocp.ocp.starts import guess_from, starting_point
from microbot_ocp.ocp.transcription import Guess, Transcription, assemble
from ocp.textbook import (
    bryson_denham,
    double_integrator,
    regulator,
    spline,
    through_half_way,
)

ALL = ("fatrop", "ipopt", "sqp")


@pytest.mark.skipif(sys.platform != "linux", reason="the name of the library is another one")
@pytest.mark.skipif("OPENBLAS_NUM_THREADS" in os.environ, reason="the user says how many")
def test_the_blas_of_ipopt_does_not_wait_in_other_threads():
    assert solve(double_integrator(), 20, settings=SolverSettings("ipopt")).status is Status.SOLVED
    folder = Path(ca.GlobalOptions.getCasadiPath())
    library = ctypes.CDLL(str(folder / "libcasadi-tp-openblas.so.0"))
    assert library.openblas_get_num_threads() == 1


# the SQP method -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("problem", "mesh", "cost"),
    sampled_rows(
        [
            (double_integrator(), 20, 2.0),
            (bryson_denham(1 / 9), 36, 4.0),
            (regulator(), 40, np.tanh(1) / 2),
            (spline((1.0, 0.5), 0.3), 8, 19.29),
            (through_half_way(("x", "v")), 24, 0.5 + np.sqrt(1.5)),
        ],
        2,
    ),
    ids=lambda p: getattr(p, "name", ""),
)
def test_the_sqp_method_finds_known_optima(problem, mesh, cost):
    solution = solve(problem, mesh, settings=SolverSettings("sqp"), scheme="shooting")
    assert solution.status is Status.SOLVED
    assert solution.cost == pytest.approx(cost, rel=1e-3)
    assert solution.attempts[-1].iterations <= 20


def test_where_eigenvalues_are_not_found_the_hessian_is_regularised():
    settings = SolverSettings("sqp")
    solution = solve(double_integrator("linear"), 20, settings=settings, scheme="shooting")
    assert solution.status is Status.SOLVED
    assert [attempt.status.solved for attempt in solution.attempts] == [False, True]


# warm starts --------------------------------------------------------------------------------------


def iterations(solution):
    return sum(attempt.iterations for attempt in solution.attempts)


@pytest.mark.parametrize("scheme", sampled(["shooting", "radau", "hermite_simpson"], 2))
def test_a_solution_warms_the_same_mesh_and_another(scheme):
    transcription = Transcription(bryson_denham(1 / 9), scheme=scheme)
    settings = SolverSettings("ipopt")
    first = solve(transcription, 18, settings=settings)
    same = solve(transcription, 18, first, settings)
    assert iterations(same) <= 3
    cold = solve(transcription, 36, settings=settings)
    warm = solve(transcription, 36, first, settings)
    assert warm.cost == pytest.approx(cold.cost, rel=1e-6)
    assert iterations(warm) < iterations(cold)


def test_multipliers_on_a_finer_mesh_are_near_those_found_there():
    transcription = Transcription(bryson_denham(1 / 9), scheme="shooting")
    settings = SolverSettings("ipopt", tolerance=1e-9)
    coarse, fine = (solve(transcription, n, settings=settings) for n in (36, 72))
    program = assemble(transcription.layouts(72))
    start = starting_point(program, transcription.problem, coarse)
    layout = program.layouts[0]
    for column in (0, 1):  # the costates of x and v; that of x jumps at two mesh points
        rows = layout.stage_rows[2:-2, column]
        near = np.abs(start.row_multipliers[rows] - fine.row_multipliers[rows]) < 0.3
        assert near.sum() >= near.size - 4
    assert start.variable_multipliers.sum() == pytest.approx(
        fine.variable_multipliers.sum(), rel=0.02
    )


@pytest.mark.thorough
def test_one_phase_starts_from_two_and_two_from_one():
    two = through_half_way(("x", "v"))
    one = double_integrator()
    for target, source, first in ((one, two, "move"), (two, one, "first")):
        solved = solve(source, 24)
        guess = guess_from(target, solved)
        whole = sum(g.duration for g in guess.values())
        assert whole == pytest.approx(solved.duration, rel=1e-12)
        x = guess[first].values["x"](np.array([0.0, 1.0]))
        half = solved.phases[0]["x"][-1 if len(solved.phases) == 2 else 12, 0]
        assert x[0, 0] == pytest.approx(0.0, abs=1e-6)
        if target is two:
            assert x[1, 0] == pytest.approx(half, abs=1e-6)
        again = solve(target, 16, solved)
        assert again.status.solved


def test_a_solution_of_another_problem_gives_what_it_has():
    solved = solve(regulator(), 10)  # has x and u, no v
    solution = solve(double_integrator(), 10, solved)
    assert solution.status.solved
    assert solution.cost == pytest.approx(2.0, abs=1e-5)


# progress and interruption ------------------------------------------------------------------------


@pytest.mark.parametrize("solver", ALL)
def test_progress_is_told_at_every_iteration(solver):
    seen = []
    settings = SolverSettings(solver, gap=np.inf)
    solution = solve(double_integrator(), 20, settings=settings, progress=seen.append)
    assert solution.status.solved
    assert [iteration.number for iteration in seen] == list(range(len(seen)))
    assert abs(len(seen) - solution.attempts[0].iterations) <= 2
    assert {iteration.solver for iteration in seen} == {solver}
    assert seen[-1].cost == pytest.approx(2.0, abs=1e-3)
    assert seen[-1].infeasibility < 1e-5 < seen[0].infeasibility
    assert seen[-1].phases[0]["x"].shape == (21, 1)


@pytest.mark.parametrize("solver", ALL)
def test_an_interrupted_solve_returns_its_last_iterate(solver):
    seen = []

    def stop(iteration):
        seen.append(iteration)
        if iteration.number == 3:
            raise KeyboardInterrupt

    settings = SolverSettings(solver)
    solution = solve(double_integrator(), 20, settings=settings, progress=stop)
    assert solution.status is Status.INTERRUPTED
    assert solution.advice == Status.INTERRUPTED.sentence
    assert len(seen) == 4
    np.testing.assert_allclose(solution["move"]["x"], seen[-1].phases[0]["x"], atol=1e-12)
    assert len(solution.attempts) == 1


def test_an_interrupt_while_casadi_converts_an_iterate_prints_nothing(monkeypatch, capfd):
    """The conversion makes a SystemError of it, of which CasADi would print a traceback."""

    def interrupted(*_):
        monkeypatch.undo()
        raise KeyboardInterrupt

    def look(iteration):
        if iteration.number == 2:
            monkeypatch.setattr(ca.DM, "toarray", interrupted)

    solution = solve(double_integrator(), 20, settings=SolverSettings("ipopt"), progress=look)
    assert solution.status is Status.INTERRUPTED
    assert "Traceback" not in capfd.readouterr().err


def test_an_interrupted_solve_is_not_given_to_the_next_solver():
    def stop(iteration):
        raise KeyboardInterrupt

    solution = solve(double_integrator(), 20, progress=stop)
    assert [attempt.solver for attempt in solution.attempts] == ["ipopt"]
    assert solution.status is Status.INTERRUPTED


@pytest.mark.parametrize("solver", ALL)
def test_an_error_of_the_progress_function_is_raised(solver):
    def fail(iteration):
        raise LookupError("of the caller")

    with pytest.raises(LookupError, match="of the caller"):
        solve(double_integrator(), 20, settings=SolverSettings(solver), progress=fail)


SCRIPT = """
import os, signal, sys, threading, time
from microbot_ocp.ocp.search import solve
from microbot_ocp.ocp.solvers import SolverSettings
from ocp.textbook import double_integrator
watched = sys.argv[2] == "watched"
def look(iteration):
    if iteration.number == 3:
        os.kill(os.getpid(), signal.SIGINT)
    time.sleep(0.001)
if not watched:  # what the solver evaluates sends the signal, in the middle of it
    from microbot_ocp.ocp.solvers import _run as run
    made = run.create
    def create(*arguments, **options):
        threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGINT)).start()
        return made(*arguments, **options)
    run.create = create
settings = SolverSettings(sys.argv[1], tolerance=1e-300, max_iterations=3000)
problem = double_integrator("linear")
solution = solve(problem, 20 if watched else 1500, settings=settings,
                 progress=look if watched else None)
print(solution.status, len(solution.attempts), solution["move"]["x"].shape[1])
time.sleep(0.1)
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("how", "solver"),
    [
        ("watched", "fatrop"),
        ("alone", "ipopt"),
        pytest.param("watched", "ipopt", marks=pytest.mark.thorough),
        pytest.param("alone", "fatrop", marks=pytest.mark.thorough),
    ],
)
def test_a_real_signal_ends_a_solve_with_its_iterate(solver, how):
    if (solver, how) == ("fatrop", "alone"):
        pytest.skip("fatrop finishes first")
    here = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, solver, how],
        capture_output=True,
        text=True,
        timeout=60,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([here, *filter(None, sys.path)])},
        check=False,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["interrupted", "1", "1"]


def test_the_handler_of_signals_is_as_before():
    before = signal.getsignal(signal.SIGINT)
    solve(double_integrator(), 4)
    assert signal.getsignal(signal.SIGINT) is before


# starts that are no numbers -----------------------------------------------------------------------


def broken(place):
    problem = OptimalControlProblem("broken")
    phase = problem.phase("fall", 2.0)
    x = phase.state("x", 2, initial=[1.0, -0.5], final=[3.0, -0.5])
    u = phase.control("u", lower=-1.0, upper=1.0)
    bad = ca.sqrt(x[1])
    phase.derivative(x, ca.vertcat(u, bad if place == "dynamics" else -u))
    if place == "constraint":
        phase.constraint("height", ca.log(x[1] - x[0]), upper=1.0)
    phase.running_cost(u**2 + (u / (x[0] - 2.0) if place == "running" else 0))
    if place == "end":
        phase.end_cost(ca.acos(x[0]))
    if place == "slope":
        phase.constraint("size", ca.norm_2(x - ca.DM([1.0, -0.5])), upper=3.0)
    return problem


@pytest.mark.parametrize(
    ("place", "said"),
    [
        (
            "dynamics",
            (
                *("dynamics of state 'x'", "phase 'fall'", "nan", "interval 1", "t = 0 s"),
                *("square root of -0.5", "x[1] = -0.5"),
            ),
        ),
        ("constraint", ("constraint 'height'", "phase 'fall'", "nan", "interval 1")),
        ("constraint", ("logarithm of -1.5", "x[0] = 1, x[1] = -0.5")),
        ("running", ("running cost", "phase 'fall'", "nan", "interval 2", "t = 1 s")),
        ("running", ("divided by 0", "x[0] = 2, u = 0")),
        ("end", ("end cost", "phase 'fall'", "nan", "t = 2 s")),
        ("end", ("arccosine of 3", "x[0] = 3")),
        ("slope", ("slope of constraint 'size'", "phase 'fall'", "nan", "interval 1")),
    ],
)
def test_a_guess_that_gives_no_numbers_is_explained_before_a_solver_starts(place, said, no_solver):
    with refused(*said):
        solve(broken(place), 4, settings=SolverSettings("ipopt"), scheme="shooting")


def test_a_guess_on_a_bound_is_looked_at_where_solvers_start(no_solver):
    problem = OptimalControlProblem("flow")
    phase = problem.phase("drain", 1.0)
    x = phase.state("x", lower=0.0, upper=2.0)
    phase.derivative(x, 0.1)
    phase.constraint("level", ca.log(x), lower=-9.0)
    with refused("solver", "started", error=pytest.fail.Exception):
        solve(problem, 4, {"drain": Guess(1.0, {"x": 0.0})})
