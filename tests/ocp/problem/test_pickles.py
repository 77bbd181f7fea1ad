"""Problems, transcriptions and solutions in other processes, and copies in this one."""

import copy
import multiprocessing
import operator
import pickle

import casadi as ca
import numpy as np
import pytest

from helpers import refused
from microbot_ocp import ocp
from microbot_ocp.ocp.transcription import mesh_of

cloudpickle = pytest.importorskip("cloudpickle")


def glider():
    """Two phases with a table, a matrix, a free parameter, a measurement and a coupled value."""
    drag = ca.interpolant("drag", "bspline", [[0.0, 0.5, 1.0, 1.5, 2.0]], [0.0, 0.1, 0.3, 0.7, 1.2])
    problem = ocp.OptimalControlProblem("glider")
    gain = problem.free_parameter("gain", lower=0.5, upper=2.0)
    first = problem.phase("first", (0.1, 3.0))
    x, v = first.state("x", initial=0.0), first.state("v", initial=0.5, lower=0.0, upper=1.9)
    u = first.control("u", lower=-1.0, upper=1.0)
    mass = first.parameter("mass", 1.2)
    first.derivative(x, v)
    first.derivative(v, (gain * u - drag(v)) / mass)
    second = problem.phase("second", 1.0)
    y, w = second.state("x", final=first.final(x) + 1.0), second.state("v")
    second.derivative(y, w)
    second.derivative(w, second.control("u", lower=-1.0, upper=1.0))
    datum = second.measurement("datum", at=[0.5, 1.0], values=[1.0, 1.5])
    second.point_cost((y - datum) ** 2)
    problem.link(first, second)
    problem.cost(first.duration + gain**2)
    return problem


@pytest.fixture(scope="module")
def problem():
    return glider()


@pytest.fixture(scope="module")
def solution(problem):
    return ocp.solve(problem, 8, settings=ocp.SolverSettings("ipopt"))


@pytest.fixture(scope="module")
def things(problem, solution):
    transcription = ocp.Transcription(problem)
    return {
        "problem": problem,
        "phase": problem.phases[0],
        "variable": problem.phases[0].states[1],
        "transcription": transcription,
        "program": transcription.program(4),
        "solution": solution,
        "values": solution["second"],
        "layout": solution["first"].layout,
        "certificate": ocp.verify(problem, solution),
        "parametric": ocp.ParametricSolver(problem, 4),
        "several": (problem, [solution, solution], {"again": problem}),
    }


KINDS = (
    *("problem", "phase", "variable", "transcription", "program", "solution", "values"),
    *("layout", "certificate", "parametric", "several"),
)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "passed",
    [
        lambda thing: pickle.loads(pickle.dumps(thing)),
        lambda thing: pickle.loads(pickle.dumps(thing, 2)),
        lambda thing: cloudpickle.loads(cloudpickle.dumps(thing)),
        copy.copy,
        copy.deepcopy,
    ],
    ids=["pickle", "protocol 2", "cloudpickle", "copy", "deepcopy"],
)
def test_everything_goes_through(things, kind, passed):
    again = passed(things[kind])
    assert type(again) is type(things[kind])
    if kind not in ("variable", "layout", "transcription", "parametric"):  # their repr is a place
        assert repr(again) == repr(things[kind])


def test_a_symbol_stays_one_symbol(problem):
    again = pickle.loads(pickle.dumps(problem))
    again.check()
    for phase in again.phases:
        assert phase.problem is again
        slopes = ca.vertcat(*phase.derivatives.values())
        known = ca.vertcat(*ocp.problem.Expressions(phase).symbols)
        assert all(ca.depends_on(known, symbol) for symbol in ca.symvar(slopes))


def test_a_copy_of_a_problem_knows_the_symbols_of_the_first(problem):
    for copied in (copy.copy, copy.deepcopy):
        second = copied(glider())
        phase = second.phases[0]
        phase.constraint("slow", phase.states[1].symbol, upper=1.0)
        second.check()
    first = glider()
    deep = copy.deepcopy(first)
    deep.phases[0].end_cost(deep.phases[0].duration)
    assert len(deep.phases[0].end_costs) == len(first.phases[0].end_costs) + 1


@pytest.mark.thorough
@pytest.mark.slow
def test_spawned_processes_solve_verify_and_answer(problem, solution):
    """As multiprocessing, joblib and Dask do: nothing is shared but what was pickled."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        other = pool.apply(
            ocp.solve, (problem, 8), {"settings": ocp.SolverSettings("ipopt"), "time_limit": 600.0}
        )
        slopes = pool.apply(operator.methodcaller("sensitivities"), (solution,))
        sampled = pool.apply(operator.methodcaller("sample", [0.1, 0.2]), (solution["first"],))
        certificate = pool.apply(ocp.verify, (problem, solution))
        laid_out = pool.apply(operator.methodcaller("program", 5), (ocp.Transcription(problem),))
    assert other.cost == solution.cost
    assert np.array_equal(other.variables, solution.variables)
    assert other["first"].sample([0.3])["v"] == pytest.approx(solution["first"].sample([0.3])["v"])
    here = solution.sensitivities()
    assert slopes["first"]["mass"] == pytest.approx(here["first"]["mass"], rel=1e-9)
    assert sampled["x"] == pytest.approx(solution["first"].sample([0.1, 0.2])["x"])
    assert certificate.ok == ocp.verify(problem, solution).ok
    assert [layout.mesh.size for layout in laid_out.layouts] == [mesh_of(5).size] * 2


def test_what_calls_python_says_why_it_stays():
    problem = ocp.OptimalControlProblem("slope")
    phase = problem.phase("up", (0.1, 10.0))
    x = phase.state("x", initial=0.0, final=1.0)
    phase.derivative(x, ocp.numeric_function(np.cos)(x))
    with refused("numeric_function", "casadi.Callback", "process", error=pickle.PicklingError):
        pickle.dumps(problem)
    assert copy.deepcopy(problem).phases[0].states[0].name == "x"
