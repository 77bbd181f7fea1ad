"""Words of other tools, and what is written beside Python's own rules: hints, and no raw errors."""

import casadi as ca
import numpy as np
import pytest

import microbot_ocp as mo
from helpers import refused
from microbot_ocp import InputError, ocp


def declared(size=2):
    problem = ocp.OptimalControlProblem("p")
    phase = problem.phase("a", 1.0)
    x, u = phase.state("x", size, initial=0.0), phase.control("u", size)
    phase.derivative(x, u)
    return problem, phase, x, u


@pytest.mark.parametrize(
    ("word", "ours"),
    [
        ("minimize", "running_cost"),
        ("add_objective", "end_cost"),
        ("subject_to", "phase.constraint"),
        ("parameter", "free_parameter"),
        ("state", "phase.state"),
        ("set_initial", "guess="),
        ("solve", "ocp.solve"),
        ("method", "scheme="),
        ("phases_", "mean 'phases'"),
    ],
)
def test_a_problem_knows_foreign_words(word, ours):
    with refused(f"'{word}'", ours, error=AttributeError):
        getattr(declared()[0], word)


@pytest.mark.parametrize(
    ("word", "ours"),
    [
        ("set_der", "derivative"),
        ("at_tf", "final"),
        ("T", "duration"),
        ("subject_to", "constraint"),
    ],
)
def test_so_does_a_phase(word, ours):
    with refused(f"'{word}'", ours, error=AttributeError):
        getattr(declared()[1], word)


def test_so_do_solutions_and_modules():
    problem, phase, x, u = declared()
    phase.running_cost(ca.sumsqr(u) + ca.sum(x))
    solution = ocp.solve(problem, 4, settings=ocp.SolverSettings("ipopt"))
    for thing, word, ours in (
        (solution, "value", 'solution["phase"]["x"]'),
        (solution, "x", 'solution["phase"]["x"]'),
        (solution, "stats", "status"),
        (solution["a"], "get_val", "sample"),
        (solution["a"], "time", ".t"),
        (ocp, "Ocp", "OptimalControlProblem"),
        (ocp, "Opti", "OptimalControlProblem"),
        (mo, "Ocp", "OptimalControlProblem"),
        (ocp, "MultipleShooting", "scheme="),
    ):
        with refused(f"'{word}'", ours, error=AttributeError):
            getattr(thing, word)
        assert not hasattr(thing, word)


@pytest.mark.parametrize(
    ("given", "ours"),
    [
        ({"N": 20}, "mesh="),
        ({"intervals": 20}, "mesh="),
        ({"solver": "ipopt"}, "settings="),
        ({"tol": 1e-6}, "settings="),
        ({"acuracy": 1e-6}, "mean 'accuracy'"),
    ],
)
def test_an_argument_of_another_name_is_refused_with_ours(given, ours):
    with refused("solve()", *map(repr, given), ours):
        ocp.solve(declared()[0], **given)
    with pytest.raises(TypeError):  # as Python has it
        ocp.solve(declared()[0], **given)


@pytest.mark.parametrize(
    "given",
    [{"integer": True}, {"discrete": True}, {"shape": "integer"}, {"shape": "binary"}],
)
def test_there_are_no_integer_controls(given):
    with refused("integer controls", "relax"):
        declared()[1].control("mode", lower=0.0, upper=1.0, **given)


@pytest.mark.parametrize("duration", [None, "free", (1.0, None), (0.1, np.inf), ()])
def test_a_free_duration_is_a_range(duration):
    with refused("duration of phase 'a'", "(0.1, 100.0)"):
        ocp.OptimalControlProblem("p").phase("a", duration)


@pytest.mark.parametrize("kind", ["constraint", "end_constraint", "point_constraint"])
def test_a_name_goes_first(kind):
    _, phase, x, _ = declared()
    with refused("name", "MX", "goes first"):
        getattr(phase, kind)(x <= 5.0)
    with refused("name", "MX", "goes first"):
        getattr(phase, kind)(phase.duration, 0.0, 1.0)


MIXED = {
    "added": lambda x, k: x + k,
    "the other way round": lambda x, k: k + x,
    "multiplied": lambda x, k: k * x,
    "compared": lambda x, k: x <= k,
    "a power": lambda x, k: x**k,
}


@pytest.mark.parametrize("how", MIXED)
def test_symbols_of_both_kinds_do_not_mix(how):
    with refused("a.x", "casadi.MX", "casadi.SX", "mix"):
        MIXED[how](declared()[2], ca.SX.sym("k", 2))


RAW = {
    "dot of a row": lambda p, f, x, u: np.dot(u.T, u),
    "dot of other sizes": lambda p, f, x, u: np.dot(np.ones(3), u),
    "a power sign": lambda p, f, x, u: x ^ 2,
    "and of numbers": lambda p, f, x, u: f.constraint("k", x & u),
    "and without brackets": lambda p, f, x, u: f.constraint("k", x >= 0.0 & x),
    "or": lambda p, f, x, u: f.constraint("k", (x <= 1.0) | (x >= 2.0)),
    "not": lambda p, f, x, u: f.constraint("k", ~(x <= 1.0)),
    "a list by a time": lambda p, f, x, u: [1.0, 2.0][f.time],
    "a range": lambda p, f, x, u: range(x[0]),
}


@pytest.mark.parametrize("mistake", RAW)
def test_what_symbols_cannot_do_is_said(mistake):
    with pytest.raises(InputError):
        RAW[mistake](*declared())


def test_relations_are_joined_by_and():
    problem = ocp.OptimalControlProblem("there and back")
    phase = problem.phase("a", 2.0)
    x, u = phase.state("x", initial=0.0), phase.control("u")
    phase.derivative(x, u)
    phase.constraint("both", (u <= 1.0) & (x <= 1.5))
    phase.end_cost(-x)
    assert ocp.solve(problem, 10).cost == pytest.approx(-1.5, abs=1e-5)


TABLE = [1.0, 2.0, 4.0, 8.0]
BY_A_VALUE = {
    "a parameter by the time": lambda f, x, d: d[f.time],
    "a parameter by a state": lambda f, x, d: d[x],
    "one of two indices": lambda f, x, d: ca.reshape(d, 2, 2)[1, f.time],
    "several entries": lambda f, x, d: ca.sum(d[ca.vertcat(f.time, f.time + 1.0)]),
    "rounded": lambda f, x, d: d[ca.floor(f.time)],
    "a constant": lambda f, x, d: ca.MX(TABLE)[f.time],
    "inside of a function": lambda f, x, d: ca.Function(
        "table", [t := ca.MX.sym("t")], [ca.MX(TABLE)[t]]
    )(f.time),
}


@pytest.mark.parametrize("where", ["dynamics", "cost", "end"])
@pytest.mark.parametrize("how", BY_A_VALUE)
def test_an_entry_by_the_value_of_an_expression_is_refused(how, where, no_solver):
    problem = ocp.OptimalControlProblem("profile")
    phase = problem.phase("a", 3.0)
    x, d = phase.state("x", initial=0.0), phase.parameter("d", TABLE)
    entry = BY_A_VALUE[how](phase, x, d)
    phase.derivative(x, entry if where == "dynamics" else 1.0)
    if where == "cost":
        phase.running_cost(entry * x)
    if where == "end":
        phase.end_cost(entry + x)
    with refused("phase 'a'", "casadi.interpolant"):
        ocp.solve(problem, 4)


@pytest.mark.parametrize("inline", [False, True])
def test_a_table_is_no_such_entry(inline):
    """An interpolant that is written out looks up its entries, too."""
    problem = ocp.OptimalControlProblem("profile")
    phase = problem.phase("a", 3.0)
    grid = [[0.0, 1.0, 2.0, 3.0]]
    table = ca.interpolant("table", "linear", grid, TABLE, {"inline": inline})
    x = phase.state("x", initial=0.0)
    phase.derivative(x, table(phase.time))
    solution = ocp.solve(problem, 6, settings=ocp.SolverSettings("ipopt"))
    assert solution["a"]["x"][-1] == pytest.approx([1.5 + 3.0 + 6.0], abs=1e-7)


def test_phases_without_a_state_in_common_are_not_linked_in_silence():
    problem = ocp.OptimalControlProblem("two")
    a, b = (problem.phase(name, 1.0) for name in "ab")
    a.derivative(a.state("x", initial=0.0), 1.0)
    y = b.state("y")
    b.derivative(y, 1.0)
    with refused("'a' and 'b'", "x and y", "names=()"):
        problem.link(a, b)
    problem.link(a, b, names=())


DIVIDED = {
    "by a state": (lambda x, u: u / x, "divides by x"),
    "by a root": (lambda x, u: u / ca.sqrt(x), "divides by x"),
    "by a power": (lambda x, u: u / x**1.5, "divides by x"),
}


@pytest.mark.slow
@pytest.mark.parametrize("how", DIVIDED)
def test_dynamics_that_are_singular_where_they_begin_are_named(how):
    expression, words = DIVIDED[how]
    problem = ocp.OptimalControlProblem("singular")
    phase = problem.phase("a", 1.0)
    x, u = phase.state("x", initial=0.0, final=1.0), phase.control("u")
    phase.derivative(x, expression(x, u))
    phase.running_cost(u**2)
    solution = ocp.solve(problem, 20)
    assert not solution.solved
    assert words in solution.advice
    assert words in ocp.verify(problem, solution).verdict
