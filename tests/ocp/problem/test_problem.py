"""What a declaration of an optimal-control problem refuses, and in which words."""

import casadi as ca
import numpy as np
import pytest

from helpers import refused, tells
from microbot_ocp.ocp.problem import OptimalControlProblem, tied_controls
from microbot_ocp.ocp.solvers import ParametricSolver, SolverSettings
from microbot_ocp.ocp.starts import completed, default_guess
from microbot_ocp.ocp.transcription import Guess, Transcription
from microbot_ocp.ocp.verification import verify
from ocp.textbook import double_integrator, solve_once as solve, spline, through_half_way


def empty_phase(duration=1.0, **options):
    return OptimalControlProblem("test").phase("move", duration, **options)


def moving_phase(problem, name="move"):
    phase = problem.phase(name, 1.0)
    phase.derivative(phase.state("x"), 1.0)
    return phase


def no_phases():
    OptimalControlProblem("test").check()


def no_states():
    problem = OptimalControlProblem("test")
    problem.phase("move", 1.0)
    problem.check()


def no_dynamics():
    problem = OptimalControlProblem("test")
    moving_phase(problem).state("y")
    problem.check()


def not_linked():
    problem = OptimalControlProblem("test")
    moving_phase(problem, "first")
    moving_phase(problem, "second")
    problem.check()


def idle_control():
    problem = OptimalControlProblem("test")
    moving_phase(problem).control("u", shape="linear")
    problem.check()


@pytest.mark.parametrize(
    ("check", "said"),
    [
        (no_phases, ("'test'", "no phases")),
        (no_states, ("phase 'move'", "no states")),
        (no_dynamics, ("state 'y'", "phase 'move'", "no dynamics")),
        (not_linked, ("phase 'second'", "'first'", "link()")),
        (idle_control, ("control 'u'", "phase 'move'", "nowhere")),
    ],
)
def test_an_incomplete_problem_is_refused_by_name(check, said):
    with refused(*said):
        check()


def test_a_transcription_checks_the_problem_first():
    with refused("'test'", "no phases"):
        Transcription(OptimalControlProblem("test"))


def test_a_control_that_is_used_by_its_rate_only_is_used():
    problem = OptimalControlProblem("test")
    phase = moving_phase(problem)
    u = phase.control("u", shape="linear")
    phase.running_cost(phase.rate(u) ** 2)
    problem.check()


@pytest.mark.parametrize(
    ("declare", "said"),
    [
        (
            lambda p: p.state("x", lower=2.0, upper=1.0, unit="m"),
            ("bounds of 'x'", "lower 2", "upper 1 m"),
        ),
        (
            lambda p: p.state("x", initial=(1.0, 0.0)),
            ("bounds of 'initial x'", "lower 1", "upper 0"),
        ),
        (
            lambda p: p.state("x", upper=1.0, final=2.0),
            ("final x", "-inf to 1", "not 2"),
        ),
        (lambda p: p.state("x", 2, initial=[0.0] * 3), ("initial x", "[2]", "[3]")),
        (lambda p: p.state("x", 2, lower=[0.0, 1.0, 2.0]), ("lower x", "[2]", "[3]")),
        (lambda p: p.state("x", upper=np.nan), ("upper x", "[0]", "nan")),
        (lambda p: p.state("x", scale=0.0), ("scale of 'x'", "above 0", "0.0")),
        (lambda p: (p.state("x"), p.control("x")), ("'x'", "twice", "phase 'move'")),
        (lambda p: p.state("x", 0), ("size of 'x'", "at least 1", "not 0")),
        (lambda p: p.state("x", 1.5), ("size of 'x'", "whole number", "1.5")),
        (lambda p: (p.parameter("k", 1), p.parameter("k", 2)), ("parameter 'k'", "twice")),
        (lambda p: p.parameter("k", np.inf), ("parameter 'k'", "[0]", "inf")),
        (lambda p: p.control("u", shape="cubic"), ("shape", "auto, constant, linear", "'cubic'")),
        (
            lambda p: p.control("u", initial=0.0, shape="constant"),
            ("control 'u'", "constant", "shape='linear'"),
        ),
        (
            lambda p: p.control("u", final=0.0, shape="polynomial"),
            ("control 'u'", "polynomial", "shape='linear'"),
        ),
        (
            lambda p: p.rate(p.control("u", shape="constant")),
            ("rate", "shape 'linear'", "phase 'move'"),
        ),
        (
            lambda p: p.derivative(p.control("u"), 1.0),
            ("derivative", "phase 'move'", "move.u"),
        ),
        (lambda p: p.derivative(p.state("x", 2), 1.0), ("derivative of 'x'", "(2, 1)", "(1, 1)")),
        (
            lambda p: p.constraint("c", p.state("x"), 3.0, 2.0, unit="N"),
            ("bounds of 'c'", "lower 3", "upper 2 N"),
        ),
    ],
)
def test_a_wrong_declaration_is_refused_in_words(declare, said):
    with refused(*said):
        declare(empty_phase())


@pytest.mark.parametrize("duration", [0.0, -1.0, np.nan, np.inf, (2.0, 1.0), (0.0, 1.0)])
def test_a_duration_that_is_no_duration_is_refused(duration):
    with refused("duration of phase 'move'", "(0.1, 100.0)"):
        empty_phase(duration)


@pytest.mark.parametrize("points", [(0.0,), (0.5, 1.0), (-0.1,), (1.5,)])
def test_interior_points_lie_inside_an_interval(points):
    with refused("interior_points", "(0, 1)", points):
        empty_phase(interior_points=points)


def test_a_phase_name_is_used_once():
    problem = OptimalControlProblem("test")
    problem.phase("move", 1.0)
    with refused("phase 'move'", "twice"):
        problem.phase("move", 1.0)


def test_only_neighbours_with_the_same_variables_are_linked():
    problem = OptimalControlProblem("test")
    first, second, third = (moving_phase(problem, name) for name in ("one", "two", "three"))
    second.state("wide", 2)
    third.state("wide", 3)
    with refused("phase 'three'", "follow 'one'", "linked"):
        problem.link(first, third)
    for name in ("y", "wide"):
        with refused(f"'{name}'", "linked", "'two' and 'three'"):
            problem.link(second, third, [name])


@pytest.mark.parametrize(
    ("mesh", "said"),
    [
        (1, ("mesh", "2 intervals", "not 1")),
        (-3, ("mesh", "2 intervals", "not -3")),
        ([5, 5], ("mesh", "2 entries", "1 phases")),
        ([[0.0, 0.5, 0.9]], ("mesh", "increasing", "0 to 1")),
        ([[0.1, 0.5, 1.0]], ("mesh", "increasing", "0 to 1")),
        ([[0.0, 0.5, 0.5, 1.0]], ("mesh", "increasing", "0 to 1")),
        ([[0.0, np.nan, 1.0]], ("mesh", "[1]", "nan")),
        ([20.0], ("mesh", "whole number", "20.0")),
        (20.0, ("mesh", "whole number", "20.0")),
    ],
)
def test_a_wrong_mesh_is_refused_before_a_solver_starts(mesh, said, no_solver):
    with refused(*said):
        solve(double_integrator(), mesh)


@pytest.mark.parametrize("mesh", [np.int64(4), [4], [np.int32(4)], [np.linspace(0, 1, 5)]])
def test_a_mesh_is_a_number_or_fractions(mesh):
    (layout,) = Transcription(double_integrator()).layouts(mesh)
    np.testing.assert_array_equal(layout.mesh, [0.0, 0.25, 0.5, 0.75, 1.0])


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"x": 0.0, "v": [0.0, 1.0]}, ("guess of 'v'", "[5, 1]", "[2, 1]")),
        ({"x": np.zeros((4, 1)), "v": 0.0}, ("guess of 'x'", "phase 'move'", "[5, 1]", "[4, 1]")),
        ({"x": lambda s: s[1:], "v": 0.0}, ("guess of 'x'", "[5, 1]", "[4, 1]")),
        ({"x": 0.0, "v": np.nan}, ("guess of 'v'", "phase 'move'", "finite")),
        ({"x": 0.0, "v": 0.0, "u": np.inf}, ("guess of 'u'", "phase 'move'", "finite")),
    ],
)
def test_a_wrong_guess_is_refused_before_a_solver_starts(values, said, no_solver):
    with refused(*said):
        solve(double_integrator(), 4, {"move": Guess(1.0, values)})


def test_a_guess_of_a_scalar_may_be_a_row_or_a_column():
    column = {"x": lambda s: s[:, None] ** 2, "v": np.linspace(0, 1, 5)[:, None], "u": 0.0}
    row = {"x": lambda s: s**2, "v": np.linspace(0, 1, 5), "u": 0.0}
    found = [solve(double_integrator(), 4, {"move": Guess(1.0, v)}) for v in (column, row)]
    np.testing.assert_array_equal(found[0].variables, found[1].variables)


@pytest.mark.parametrize("duration", [np.nan, np.inf])
def test_a_guess_has_a_finite_duration(duration, no_solver):
    with refused("guess", "duration of phase 'move'", "finite"):
        solve(double_integrator(), 4, {"move": Guess(duration, {"x": 0.0, "v": 0.0})})


def test_a_guess_of_a_phase_that_there_is_not_is_refused(no_solver):
    guess = {"third": Guess(1.0, {"x": 0.0, "v": 0.0})}
    with refused("guess", "'third'", "['first', 'second']"):
        solve(through_half_way(("x", "v")), 4, guess)


def test_what_a_guess_leaves_out_starts_from_the_default():
    problem = through_half_way(("x", "v"))
    given = completed(problem, {"first": Guess(values={"x": 0.3})})
    ordinary = default_guess(problem)
    assert given["first"].values["x"] == 0.3
    assert given["first"].duration == ordinary["first"].duration
    assert given["second"].values.keys() == ordinary["second"].values.keys()
    assert solve(problem, 8, {"second": Guess(0.9)}).status.solved


def test_a_control_without_a_shape_has_that_of_its_scheme():
    for scheme, shape in (("shooting", "constant"), ("radau", "polynomial")):
        transcription = Transcription(double_integrator("auto"), scheme=scheme)
        assert [c.shape for c in transcription.problem.phases[0].controls] == [shape]
    phase = OptimalControlProblem("test").phase("move", 1.0)
    phase.control("begun", initial=0.0)
    phase.rate(phase.control("slow"))
    assert [c.shape for c in phase.controls] == ["linear", "linear"]


def test_an_unknown_solver_is_refused_with_those_there_are(no_solver):
    with refused("solver", "auto, fatrop", "ipopt, sqp", "'snopt'"):
        solve(double_integrator(), 4, settings=SolverSettings(solver="snopt"))


def test_links_default_to_the_states_of_both_phases():
    problem = spline((1.0, 1.0), 0.5)
    problem.links.clear()
    problem.link(*problem.phases)
    assert problem.links[0].names == ("x", "v")


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"tolerance": -1.0}, ("tolerance", "above 0", "-1.0")),
        ({"max_iterations": 0.5}, ("max_iterations", "whole number", "0.5")),
        ({"max_iterations": -1}, ("max_iterations", "at least 0", "-1")),
        ({"initial_barrier": 0.0}, ("initial_barrier", "above 0", "0.0")),
    ],
)
def test_wrong_settings_are_refused(settings, said):
    with refused(*said):
        SolverSettings(**settings)


def test_a_guess_of_what_there_is_not_is_refused(no_solver):
    guess = {"move": Guess(1.0, {"x": 0.0, "v": 0.0, "u": 0.0, "speed": 1.0})}
    with refused("guess of phase 'move'", "'speed'", "x, v, u"):
        solve(double_integrator(), 5, guess)


def test_a_problem_says_what_is_declared():
    problem = OptimalControlProblem("two", maximize=True)
    problem.free_parameter("k", lower=0.0, upper=1.0)
    go, back = problem.phase("go", (0.1, 5.0)), problem.phase("back", 2.0)
    position, force = go.state("position", 3), go.control("force", lower=-1.0, upper=1.0)
    mass = go.parameter("mass", 2.0)
    go.derivative(position, position * force / mass)
    go.constraint("length", ca.sumsqr(position), upper=1.0)
    back.derivative(back.state("position", 3), np.zeros(3))
    problem.link(go, back)
    assert repr(problem) == (
        "<OptimalControlProblem 'two', to maximise, 1 link, 1 free parameter\n"
        "  Phase 'go', 0.1 to 5 s: states position [3]; controls force; parameters mass; "
        "constraints length\n"
        "  Phase 'back', 2 s: states position [3]>"
    )


def test_a_state_may_be_a_matrix_with_shapes_everywhere():
    problem = OptimalControlProblem("matrix")
    phase = problem.phase("all", duration=1.0)
    begin, goal = np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]]), np.array([[1.0, 2, 3], [4, 5, 6]])
    x = phase.state("x", (2, 3), initial=begin, upper=9.0 * np.ones((2, 3)))
    u = phase.control("u", (2, 3))
    target = phase.parameter("target", goal)
    assert x.shape == u.shape == target.shape == phase.initial(x).shape == (2, 3)
    phase.derivative(x, u)
    phase.end_constraint("there", x == target)
    phase.constraint("never far", x - phase.initial(x), -9.0 * np.ones((2, 3)), 9.0)
    phase.running_cost(ca.sumsqr(u))
    solver = ParametricSolver(problem, 3)
    for end in (goal, goal[::-1]):
        solution = solver.solve(parameters={"all": {"target": end}})
        assert solution["all"]["x"].shape == (4, 2, 3)
        np.testing.assert_allclose(solution["all"]["x"][[0, -1]], [begin, end], atol=1e-6)
        assert solution.cost == pytest.approx(np.sum((end - begin) ** 2))
    assert verify(problem, solve(problem, 3)).ok


def test_a_derivative_of_another_shape_is_refused():
    phase = OptimalControlProblem("turn").phase("all", duration=1.0)
    frame = phase.state("frame", (2, 3))
    with refused("derivative of 'frame'", "(2, 3)", "(3, 2)"):
        phase.derivative(frame, frame.T)


def test_a_jump_is_of_a_state_that_the_next_phase_has():
    problem = OptimalControlProblem("jump")
    first, second = (problem.phase(name, duration=1.0) for name in "ab")
    x = first.state("x", initial=1.0)
    first.derivative(x, 0.0)
    second.derivative(second.state("x"), 0.0)
    with refused("jumps", "'v'", "'x'"):
        problem.link(first, second, jumps={"v": 2.0 * x})
    problem.link(first, second, jumps={"x": 2.0 * x})
    assert problem.links[0].names == ()
    assert solve(problem, 2)["b"]["x"][-1] == pytest.approx(2.0)


def test_a_problem_and_its_program_say_their_sizes():
    problem = OptimalControlProblem("lines")
    phase = problem.phase("move", 1.0)
    table = phase.state("table", (2, 3), initial=0.0)
    phase.derivative(table, ca.MX.ones(2, 3))
    assert "states table [2,3]" in repr(problem)
    said = repr(ParametricSolver(problem, mesh=4).program)
    tells(said, "variables")
    assert len(said) < 200


@pytest.mark.parametrize(
    ("tie", "names"),
    [
        (lambda x, a, b, c: [a - x], {"a"}),
        (lambda x, a, b, c: [a - b - x, b * b - c], {"b", "c"}),  # a has a limit
        (lambda x, a, b, c: [b - (a - x)], {"b"}),
        (lambda x, a, b, c: [b - ca.sin(x), c - ca.exp(b)], {"b", "c"}),
        (lambda x, a, b, c: [a**2 + b**2 - 1.0], set()),  # nothing that moves
        (lambda x, a, b, c: [a - x, a - 2 * x], set()),  # one control for two equations
        (lambda x, a, b, c: [x], set()),
    ],
)
def test_controls_that_equations_determine_are_found_by_structural_rank(tie, names):
    phase = OptimalControlProblem("tied").phase("only", 1.0)
    x = phase.state("x")
    controls = [phase.control(name, upper=limit) for name, limit in zip("abc", LIMITS, strict=True)]
    for k, equation in enumerate(tie(x, *controls)):
        phase.constraint(f"equation {k}", equation, 0.0, 0.0)
    phase.constraint("range", controls[0] - x, -1.0, 1.0)
    assert tied_controls(phase) == names


LIMITS = (1.0, np.inf, np.inf)
