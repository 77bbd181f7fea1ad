"""Conditions and costs at the end of a phase, and which symbols an expression may use where."""

import casadi as ca
import numpy as np
import pytest

from helpers import crossed, refused
from microbot_ocp.ocp.problem import OptimalControlProblem, Phase
from microbot_ocp.ocp.solvers import SolverSettings
from microbot_ocp.ocp.transcription import Guess, Transcription
from microbot_ocp.ocp.transcription.schemes import SCHEMES
from ocp.textbook import solve_once as solve


def point(duration=(0.1, 10.0), shape="constant"):
    """A point in the plane at a speed of one at most, from (3, 1)."""
    problem = OptimalControlProblem("point")
    phase = problem.phase("go", duration)
    x = phase.state("x", initial=3.0)
    y = phase.state("y", initial=1.0)
    u = phase.control("u", 2, lower=-3.0, upper=3.0, shape=shape)
    phase.derivative(x, u[0])
    phase.derivative(y, u[1])
    return problem, phase, x, y, u


GUESS = {"go": Guess(2.0, {"x": 2.0, "y": 0.5, "u": -0.5})}


@pytest.mark.parametrize(("scheme", "solver"), crossed(SCHEMES, ["fatrop", "ipopt"]))
def test_an_expression_of_the_end_is_kept(scheme, solver):
    """The shortest way to the unit circle is straight at its centre."""
    problem, phase, x, y, u = point(1.0)
    phase.end_constraint("circle", x**2 + y**2, 1.0, 1.0)
    phase.running_cost(ca.sumsqr(u))
    solution = solve(problem, 5, GUESS, SolverSettings(solver=solver), scheme=scheme)
    assert solution.status.solved
    assert solution.cost == pytest.approx((np.sqrt(10) - 1) ** 2, rel=1e-6)
    end = np.array([solution["go"]["x"][-1, 0], solution["go"]["y"][-1, 0]])
    np.testing.assert_allclose(end, np.array([3.0, 1.0]) / np.sqrt(10), atol=1e-6)


def test_a_condition_of_the_end_may_have_the_duration_and_several_rows():
    """It arrives on a train that leaves x = 0 at 1 m/s along y = 0: at x = duration."""
    problem, phase, x, y, u = point()
    phase.end_constraint("train", ca.vertcat(x - phase.duration, y), 0.0, 0.0, scale=[2.0, 0.5])
    phase.constraint("speed", ca.sumsqr(u), upper=1.0)
    phase.end_cost(phase.time)
    solution = solve(problem, 4, GUESS)
    arrival = solution.duration
    assert solution.status.solved
    assert (3.0 - arrival) ** 2 + 1.0 == pytest.approx(arrival**2, rel=1e-5)
    assert solution["go"]["x"][-1, 0] == pytest.approx(arrival, rel=1e-6)


def test_a_condition_holds_at_the_end_of_its_own_phase():
    problem = OptimalControlProblem("two")
    phases = []
    for name in ("first", "second"):
        phase = problem.phase(name, 1.0)
        x = phase.state("x", 2, initial=[0.0, 0.0] if not phases else None)
        u = phase.control("u", 2)
        phase.derivative(x, u)
        phase.running_cost(ca.sumsqr(u))
        phases.append((phase, x))
    phases[0][0].end_constraint("sum", ca.sum1(phases[0][1]), 2.0, 3.0)
    phases[1][0].end_constraint("difference", phases[1][1][0] - phases[1][1][1], 1.0, np.inf)
    problem.link(phases[0][0], phases[1][0])
    solution = solve(problem, 3)
    assert solution.status.solved
    middle, end = solution["first"]["x"][-1], solution["second"]["x"][-1]
    assert middle.sum() == pytest.approx(2.0, abs=1e-6)
    assert end[0] - end[1] == pytest.approx(1.0, abs=1e-6)


def end_cost_of_a_step(phase: Phase, x, u):
    phase.end_cost(u[0] ** 2)


def end_constraint_of_a_step(phase: Phase, x, u):
    phase.end_constraint("force", u[0], upper=1.0)


def undeclared(phase: Phase, x, u):
    phase.running_cost(ca.MX.sym("k") * x)


@pytest.mark.parametrize(
    ("declare", "said"),
    [
        (end_cost_of_a_step, ("end cost", "phase 'go'", "'go.u'", "shape 'linear'")),
        (end_constraint_of_a_step, ("end constraint", "phase 'go'", "'go.u'", "shape 'linear'")),
        (undeclared, ("phase 'go'", "'k'", "parameter()")),
    ],
)
def test_what_an_expression_cannot_know_is_refused_by_name(declare, said):
    problem, phase, x, _, u = point()
    declare(phase, x, u)
    with refused(*said):
        Transcription(problem)


def test_the_rate_of_a_linear_control_has_no_value_at_the_end():
    problem, phase, _, _, u = point(shape="linear")
    phase.end_cost(ca.sumsqr(phase.rate(u)))
    with refused("phase 'go'", "'go.u.rate'", "shape 'linear'"):
        problem.check()


def test_a_state_of_another_phase_is_refused():
    problem, phase, x, _, _ = point()
    other = problem.phase("other", 1.0)
    other.derivative(other.state("x"), x)
    problem.link(phase, other)
    with refused("phase 'other'", "'go.x'", "link()"):
        problem.check()


@pytest.mark.parametrize("kind", ["running", "end"])
def test_a_cost_is_one_number(kind):
    _, phase, x, y, _ = point()
    declare = phase.running_cost if kind == "running" else phase.end_cost
    with refused(f"{kind} cost", "phase 'go'", "one number", "(2, 1)"):
        declare(ca.vertcat(x, y))


def test_a_crossed_condition_of_the_end_is_refused():
    _, phase, x, _, _ = point()
    with refused("bounds of 'ring'", "lower 2", "upper 1"):
        phase.end_constraint("ring", x, 2.0, 1.0)


@pytest.mark.parametrize(("scheme", "solver"), crossed(SCHEMES, ["fatrop", "ipopt"]))
def test_an_equation_of_a_constant_control_is_said_once_an_interval(scheme, solver):
    """Repeated at the points between, it would leave the solver more equations than variables."""
    problem, phase, x, y, u = point(1.0)
    phase.constraint("diagonal", u[0] - u[1], 0.0, 0.0)
    phase.end_cost((x - 1.0) ** 2 + y**2)
    phase.running_cost(1e-3 * ca.sumsqr(u))
    transcription = Transcription(problem, scheme=scheme)
    assert (
        len(transcription.kernels[0].stage.rows)
        == len(Transcription(point_without_diagonal(), scheme=scheme).kernels[0].stage.rows) + 1
    )
    solution = solve(transcription, 5, GUESS, SolverSettings(solver=solver))
    assert solution.status.solved
    np.testing.assert_allclose(solution["go"]["u"][:, 0], solution["go"]["u"][:, 1], atol=1e-7)


def point_without_diagonal():
    problem, phase, _, _, u = point(1.0)
    phase.running_cost(ca.sumsqr(u))
    return problem
