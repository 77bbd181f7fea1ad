"""Meshes that become as fine as an accuracy asks for."""

import itertools
import json
from dataclasses import replace
from functools import cache

import casadi as ca
import numpy as np
import pytest

from helpers import refused, tells
from microbot_ocp.ocp import OptimalControlProblem
from microbot_ocp.ocp.mesh import state_errors
from microbot_ocp.ocp.search import solve
from microbot_ocp.ocp.solution import Status
from microbot_ocp.ocp.solvers import SolveContext, SolverSettings
from microbot_ocp.ocp.transcription.schemes import SCHEMES
from microbot_ocp.ocp.verification import judge, verify
from ocp.textbook import (
    bryson_denham,
    double_integrator,
    oscillator,
    pendulum,
    solved_to,
    through_half_way,
)

pytestmark, thorough = pytest.mark.slow, pytest.mark.thorough

FINE = SolverSettings("ipopt", tolerance=1e-10)
by_every_scheme = pytest.mark.parametrize(
    "scheme",
    [scheme if scheme == "radau" else pytest.param(scheme, marks=thorough) for scheme in SCHEMES],
)


@by_every_scheme
def test_the_accuracy_is_reached_and_the_errors_fall(scheme):
    refined = solved_to(oscillator(), 1e-6, mesh=10, scheme=scheme)
    assert refined.status is Status.SOLVED
    assert refined.advice == Status.SOLVED.sentence
    errors = [step.state_error for step in refined.history]
    above = [error for error in errors if error > 1e-6]
    assert above == sorted(above, reverse=True)
    assert errors[0] > 1e-6 >= errors[-1]
    assert refined.history[-1].cost_error <= 1e-5
    assert refined.history[-1].intervals[0] == refined["calm"].mesh.size - 1 > 10
    assert refined.history[-1].cost == refined.cost
    assert max(e.max() for e in state_errors(refined)) == pytest.approx(errors[-1])
    cost = solve(oscillator(), 200, settings=FINE).cost
    assert refined.cost == pytest.approx(cost, rel=3e-5)
    certificate = verify(oscillator(), refined)
    assert certificate.ok, certificate.verdict
    assert certificate.resimulations[0].error < 1e-3


@by_every_scheme
def test_a_mesh_point_moves_to_the_switch(scheme):
    refined = solved_to(pendulum(), 1e-6, mesh=11, scheme=scheme)
    assert refined.status is Status.SOLVED
    (switch,) = refined.history[-1].switches[0]
    mesh = refined["swing"].mesh
    assert np.abs(mesh - switch.place).min() <= 1e-3
    before = refined.history[0]
    assert before.switch_offset > 0.01
    assert refined.history[-1].switch_offset <= 1e-3
    assert refined.cost == pytest.approx(2.56664, abs=2e-4)
    assert refined.cost < before.cost + 1e-4 or scheme == "trapezoidal"


@pytest.mark.thorough
def test_points_gather_at_the_ramp_of_a_continuous_control():
    refined = solved_to(double_integrator("linear"), 1e-6, mesh=10)
    assert refined.status is Status.SOLVED
    costs = [step.cost for step in refined.history]
    offsets = [step.switch_offset for step in refined.history]
    assert costs == sorted(costs, reverse=True)
    assert offsets == sorted(offsets, reverse=True)
    mesh = refined["move"].mesh
    assert np.count_nonzero(np.abs(mesh - 0.5) < 0.05) > 3
    assert refined.cost == pytest.approx(2.0, abs=2e-6)


@pytest.mark.thorough
def test_every_phase_has_its_own_mesh():
    refined = solved_to(through_half_way(("x", "v")), mesh=[4, 7], switches=1e-4)
    assert refined.status is Status.SOLVED
    assert refined.duration == pytest.approx(0.5 + np.sqrt(1.5), abs=1e-5)
    first, second = refined.history[-1].intervals
    assert (first, second) == tuple(phase.mesh.size - 1 for phase in refined.phases)
    assert second > first


@pytest.mark.thorough
def test_a_certificate_follows_a_refinement():
    settings = SolverSettings("ipopt")
    refined = solved_to(pendulum(), 1e-7, 11, settings=settings, switches=1e-5)
    certificate = verify(pendulum(), refined)
    assert certificate.ok, certificate.verdict
    hamiltonian = certificate.hamiltonian("swing")
    assert hamiltonian.mean == pytest.approx(-1.0, abs=1e-5)
    assert hamiltonian.drift < 0.01
    assert [(a.name, a.side) for a in certificate.arcs] == [("u", "upper"), ("u", "lower")]


@pytest.mark.thorough
def test_what_is_not_reached_is_said():
    late = solved_to(oscillator(), 1e-6, mesh=[10], scheme="trapezoidal", rounds=1)
    assert late.status is Status.ROUND_LIMIT
    assert len(late.history) == 2
    large = solved_to(oscillator(), 1e-6, mesh=10, scheme="trapezoidal", most_intervals=30)
    assert large.status is Status.SIZE_LIMIT
    assert not large.solved
    settings = SolverSettings("ipopt", max_iterations=2)
    broken = solved_to(bryson_denham(1 / 9), mesh=[10], settings=settings)
    assert broken.status is Status.ITERATION_LIMIT
    for refined in (late, large):
        assert refined.advice.startswith(refined.status.sentence)
        tells(refined.advice, "Missing", "state error")


@pytest.mark.thorough
def test_a_finer_mesh_that_is_not_accepted_ends_the_refinement_and_is_shown(monkeypatch):
    from microbot_ocp.ocp.refinement import _judged

    monkeypatch.setattr(_judged._RefinementLoop, "_accepts", lambda self, before, after: False)
    refined = solved_to(oscillator(), 1e-6, mesh=[10])
    assert refined.status is Status.NOT_ACCEPTED
    assert [step.accepted for step in refined.history] == [True, False]
    assert refined["calm"].mesh.size == 11
    assert "not accepted" in str(refined.history).splitlines()[-1]


@pytest.mark.parametrize("solves", [1, 2, 3])
def test_an_interruption_returns_the_last_accepted_solution(monkeypatch, solves):
    """The solver's own answer to Ctrl-C, in the first solve or a later one."""
    calls, whole = [], SolveContext.solve

    def interrupted(*arguments, **named):
        made = whole(*arguments, **named)
        calls.append(made)
        if len(calls) < solves:
            return made
        return replace(made, status=Status.INTERRUPTED)

    monkeypatch.setattr(SolveContext, "solve", interrupted)
    refined = solved_to(oscillator(), 1e-9, mesh=10)
    assert refined.status is Status.INTERRUPTED
    assert not refined.status.solved
    assert len(calls) == solves  # nothing is begun after it
    assert refined.phases == calls[0].phases  # those that follow it are comparisons


def test_an_interruption_of_the_estimate_returns_the_last_accepted_solution(monkeypatch):
    from microbot_ocp.ocp.refinement import _judged

    judged = []

    def estimate(transcription, solution):
        if judged:
            raise KeyboardInterrupt
        judged.append(solution)
        return judge(transcription, solution)

    monkeypatch.setattr(_judged, "judge", estimate)
    refined = solved_to(oscillator(), 1e-9, mesh=10)
    assert refined.status is Status.INTERRUPTED
    assert refined.phases is judged[0].phases
    assert len(refined.history) == 1


def test_the_time_limit_is_said():
    refined = solved_to(oscillator(), 1e-9, mesh=10, time_limit=1e-3)
    assert refined.status is Status.TIME_LIMIT
    assert len(refined.history) == 1
    with refused("time_limit", "above 0 s", "0.0"):
        solved_to(oscillator(), 1e-9, time_limit=0.0)


# limits between the mesh points -------------------------------------------------------------------

TOP = 1 / 9  # the ceiling of the Bryson-Denham problem at which its cost is 4


def under_a_path_constraint():
    """The Bryson-Denham problem with its ceiling as a constraint of an expression."""
    problem = bryson_denham(1.0, "polynomial")
    phase = problem.phases[0]
    x = phase.states[0]
    phase.constraint("ceiling", 2 * x.symbol, upper=2 * TOP)
    return problem


@cache
def refined_by_radau(made):
    return solved_to(made(), scheme="radau")


@pytest.mark.parametrize(
    "made",
    [
        lambda: bryson_denham(TOP, "polynomial"),
        pytest.param(under_a_path_constraint, marks=thorough),
    ],
)
def test_a_limit_exceeded_between_mesh_points_is_refined(made):
    loose = solved_to(made(), scheme="radau", limits=1.0, cost=np.inf)
    refined = refined_by_radau(made)
    assert loose.status.solved
    assert refined.status.solved
    assert loose.history[-1].limit_excess > 5e-5
    assert refined.history[-1].limit_excess <= 1e-5
    for own in (loose, refined):
        phase = own["fly"]
        highest = phase.sample(np.linspace(0.0, 1.0, 20001))["x"].max()
        assert highest / TOP - 1 == pytest.approx(own.history[-1].limit_excess, rel=0.05, abs=1e-8)
    # who rises above the ceiling gets there cheaper than anyone can
    assert loose.cost < 4 - 5e-5
    assert refined.cost == pytest.approx(4.0, abs=5e-6)


@pytest.mark.thorough
def test_a_limit_that_stays_exceeded_is_said():
    refined = solved_to(bryson_denham(TOP, "polynomial"), mesh=[20], scheme="radau", rounds=0)
    assert refined.status is Status.ROUND_LIMIT
    assert refined.advice.startswith(refined.status.sentence)
    tells(refined.advice, "state x", "phase 'fly'", "1e-05 m", "0.111111")
    assert "limit excess" in str(refined.history)
    assert refined.history[0].as_dict()["worst_limit"]["name"] == "x"


@pytest.mark.thorough
def test_a_constraint_that_jumps_with_its_control_is_not_called_kept():
    problem = double_integrator("polynomial")
    phase = problem.phases[0]
    v, u = phase.states[1].symbol, phase.controls[0].symbol
    phase.constraint("power", u * v, lower=-0.3, upper=0.3, unit="W")
    even = np.linspace(0.0, 1.0, 21)
    refined = solved_to(problem, 1e-6, [even], scheme="radau", rounds=4)
    assert not refined.status.solved
    tells(refined.advice, "constraint power", "phase 'move'")
    assert verify(problem, refined).worst_limit.relative > 1e-5


def test_the_history_is_a_table_and_plain_values_and_progress_is_told():
    lines = []
    refined = solved_to(oscillator(), 1e-4, mesh=10, progress=lines.append)
    table = str(refined.history).splitlines()
    assert len(table) == len(refined.history) + 1
    tells(table[0], "intervals", "variables", "state error")
    stored = json.loads(json.dumps([step.as_dict() for step in refined.history]))
    assert stored[0]["intervals"] == [10]
    assert stored[0]["status"] == "solved"
    assert any("state error" in str(line) for line in lines)


@pytest.mark.parametrize("accuracy", [0.0, -1.0, np.nan, "fine"])
def test_a_bad_accuracy_is_refused(accuracy, no_solver):
    with refused("accuracy of states"):
        solved_to(oscillator(), accuracy)
    with refused("accuracy of limits"):
        solved_to(oscillator(), limits=accuracy)


# the cost -----------------------------------------------------------------------------------------


def smooth_effort():
    """x' = u from 0 to 1 in 1 s with the least integral of u^2 + x^2: coth(1) by hand."""
    problem = OptimalControlProblem("smooth effort")
    phase = problem.phase("rise", 1.0)
    x = phase.state("x", initial=0.0, final=1.0)
    u = phase.control("u", shape="constant")
    phase.derivative(x, u)
    phase.running_cost(u**2 + x**2)
    return problem


@pytest.mark.thorough
def test_a_control_that_follows_its_dynamics_but_is_too_coarse_is_refined():
    exact = 1 / np.tanh(1.0)
    loose = solved_to(smooth_effort(), mesh=4, cost=np.inf)
    assert loose.cost / exact - 1 > 1e-3
    assert loose.history[-1].state_error <= 1e-6
    refined = solved_to(smooth_effort(), mesh=4)
    assert refined.status is Status.SOLVED
    assert abs(refined.cost / exact - 1) < 1e-5
    errors = [(step.cost_error, step.cost / exact - 1) for step in refined.history]
    for estimated, true in errors[1:]:
        assert 0.9 * true < estimated < 4 * true


@pytest.mark.thorough
def test_a_cost_that_is_not_reached_is_said():
    refined = solved_to(smooth_effort(), mesh=4, rounds=0)
    assert refined.status is Status.ROUND_LIMIT
    tells(refined.advice, "Missing", "the cost")
    with refused("accuracy of cost", "above 0", "0.0"):
        solved_to(smooth_effort(), cost=0.0)


@pytest.mark.thorough
def test_the_running_cost_is_part_of_the_error_of_an_interval():
    """A cost that the states do not show: its quadrature alone is coarse."""
    problem = OptimalControlProblem("waves")
    phase = problem.phase("wait", 1.0)
    x = phase.state("x", initial=0.0)
    u = phase.control("u", lower=-1.0, upper=1.0)
    phase.derivative(x, u)
    phase.running_cost(1 + ca.sin(40 * phase.time) + u**2)
    refined = solved_to(problem, mesh=4)
    assert refined.history[0].state_error > 1e-2
    assert refined.cost == pytest.approx(1 + (1 - np.cos(40.0)) / 40, rel=1e-5)


@pytest.mark.thorough
def test_a_finer_mesh_that_costs_more_says_why():
    refined = refined_by_radau(under_a_path_constraint)
    costs = [step.cost for step in refined.history if step.accepted]
    rises = [b > a + 1e-5 * abs(a) for a, b in itertools.pairwise(costs)]
    assert any(rises)
    assert refined.advice.count("The cost rises from") == sum(rises)


@thorough
def test_constant_controls_are_as_accurate_as_the_free_ones_that_they_replace():
    """Halving 50 intervals gains 2e-6 of the cost only, of the 5e-5 that they cost too much."""
    mixing = OptimalControlProblem("Egerstedt, relaxed (mintOC)")
    phase = mixing.phase("only", 1.0)
    x = phase.state("x", initial=0.5)
    y = phase.state("y", initial=0.5, lower=0.4)
    a, b, c = (phase.control(name, lower=0.0, upper=1.0) for name in "abc")
    phase.derivative(x, -x * a + (x + y) * b + (x - y) * c)
    phase.derivative(y, (x + 2 * y) * a + (x - 2 * y) * b + (x + y) * c)
    phase.constraint("one", a + b + c, 1.0, 1.0)
    phase.running_cost(x**2 + y**2)
    refined = solve(mixing, accuracy=1e-6)
    assert refined.solved, refined.advice
    assert abs(refined.cost / 0.989124 - 1) < 1e-6


def test_a_solved_cost_is_as_accurate_as_is_claimed_for_controls_of_first_order():
    """A force under a power limit is set by the end of its interval, so errors halve with it."""
    problem = OptimalControlProblem("push", maximize=True)
    phase = problem.phase("push", 0.3)
    v, x = phase.state("v", initial=1.0), phase.state("x", initial=0.0)
    u = phase.control("u", lower=0.0, shape="constant")
    phase.derivative(v, 1.0)
    phase.derivative(x, u)
    phase.constraint("power", u * v, upper=1.0)
    phase.end_cost(x)
    solution = solve(problem)
    assert solution.status.solved
    assert solution.objective == pytest.approx(np.log(1.3), rel=1e-4)
