"""Each declaration is given once, and None is free wherever a value may be."""

import numpy as np
import pytest

from helpers import refused
from microbot_ocp.ocp import OptimalControlProblem, ParametricSolver, SolverSettings, solve


def car(distance=10.0, **at_end):
    """Shortest time over a distance from rest: 2 sqrt(distance) to rest, else sqrt(2 distance)."""
    problem = OptimalControlProblem("car")
    phase = problem.phase("move", (0.1, 20.0))
    x = phase.state("x", initial=0.0, final=distance, unit="m")
    v = phase.state("v", initial=0.0, **at_end)
    u = phase.control("u", lower=-1.0, upper=1.0)
    phase.derivative(x, v)
    phase.derivative(v, u)
    phase.end_cost(phase.duration)
    return problem, phase, x, v, u


def linked():
    problem = OptimalControlProblem("two")
    phases = [problem.phase(name, 1.0) for name in ("a", "b")]
    for phase in phases:
        phase.derivative(phase.state("x"), 1.0)
    problem.link(*phases)
    problem.link(*phases)


TWICE = {
    "derivative": lambda: (lambda p, f, x, v, u: f.derivative(x, 2 * v))(*car()),
    "path constraint": lambda: (
        lambda p, f, x, v, u: [f.constraint("top", v, upper=top) for top in (3.0, 2.0)]
    )(*car()),
    "path and end constraint": lambda: (
        lambda p, f, x, v, u: (
            f.constraint("top", v, upper=3.0),
            f.end_constraint("top", v, upper=2.0),
        )
    )(*car()),
    "point constraint": lambda: (
        lambda p, f, x, v, u: [f.point_constraint("k", x - v, 0.0, 0.0, at=0.0) for _ in "ab"]
    )(*car()),
    "constraint of the problem": lambda: (
        lambda p, f, x, v, u: [p.constraint("k", f.duration, upper=top) for top in (9.0, 8.0)]
    )(*car()),
    "link": linked,
}


@pytest.mark.parametrize("kind", TWICE)
def test_a_second_declaration_of_the_same_name_is_refused(kind):
    with refused("twice", "link()" if kind == "link" else "phase 'move'"):
        TWICE[kind]()


def test_what_holds_at_the_start_may_be_named_like_what_holds_at_the_end():
    _, phase, x, v, _ = car()
    phase.point_constraint("pose", x - v, 0.0, 0.0, at=0.0)
    phase.end_constraint("pose", x, 10.0, 10.0)
    assert phase.point_constraints[0].name == phase.end_constraints[0].name == "pose"


@pytest.fixture(scope="module")
def solver():
    return ParametricSolver(car(final=0.0)[0], mesh=20)


def test_none_frees_what_was_declared_with_a_condition(solver):
    assert solver.solve(final={"move": {"v": None}}).cost == pytest.approx(np.sqrt(20.0), abs=1e-4)
    assert solver.solve().cost == pytest.approx(2 * np.sqrt(10.0), abs=1e-4)
    back = solver.solve(initial={"move": {"x": None}}, final={"move": {"x": 0.1}})
    assert back.cost == pytest.approx(0.1, abs=1e-4)  # the shortest duration: it begins at its end
    free = ParametricSolver(car()[0], mesh=20).solve(final={"move": {"v": None}})
    assert free.cost == pytest.approx(np.sqrt(20.0), abs=1e-4)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"parameters": {"move": {"m": None}}}, ("parameter 'm'", "None")),
        ({"bounds": {"move": {"v": None}}}, ("bounds of 'v'", "(lower, upper)", "None")),
        ({"durations": {"move": None}}, ("duration of phase 'move'", "None", "(0.1, 100.0)")),
        ({"final": {"move": None}}, ("final of phase 'move'", "mapping", "None")),
        ({"bounds": {"move": 3.0}}, ("bounds of phase 'move'", "mapping", "3.0")),
    ],
)
def test_none_is_refused_where_nothing_is_free(changes, said):
    problem, phase, *_ = car(final=0.0)
    phase.parameter("m", 1.0)
    with refused(*said):
        ParametricSolver(problem, mesh=5).solve(**changes)


SQUARES = np.linspace(0.0, 1.0, 11) ** 2


@pytest.mark.parametrize("mesh", [SQUARES, SQUARES.tolist(), tuple(SQUARES), [SQUARES]])
def test_one_mesh_of_fractions_is_that_of_every_phase(mesh):
    solution = solve(car(final=0.0)[0], mesh, settings=SolverSettings("ipopt"))
    assert solution["move"].mesh == pytest.approx(SQUARES, abs=1e-15)


@pytest.mark.parametrize("mesh", [SQUARES, [SQUARES, SQUARES], [SQUARES, 10], [10, 10]])
def test_a_mesh_for_all_phases_or_one_for_each(mesh):
    problem = OptimalControlProblem("two")
    phases = [problem.phase(name, 1.0) for name in ("a", "b")]
    for phase in phases:
        phase.derivative(phase.state("x"), 1.0)
    problem.link(*phases)
    solution = solve(problem, mesh, settings=SolverSettings("ipopt"))
    assert [phase.mesh.size for phase in solution.phases] == [11, 11]


def test_fractions_that_do_not_reach_one_are_refused_as_such():
    with refused("mesh", "increasing", "0 to 1"):
        solve(car(final=0.0)[0], np.linspace(0.0, 0.9, 10))
