"""Switching times as unknowns, against closed forms and published digits."""

import json
from dataclasses import replace
from math import sqrt

import casadi as ca
import numpy as np
import pytest
from benchmarks.suite.table import BY_NAME

from helpers import refused
from microbot_ocp.ocp import (
    OptimalControlProblem,
    SolverSettings,
    Status,
    solve,
    solve_switching_times,
)

# Luus, Iterative Dynamic Programming (2000), and PROPT's guide
PUBLISHED = {
    "luus_arm": (2.98227994254954, [0.94314035486444, 1.49113997127477, 2.62754506676178]),
    "dissanayake_arm": (0.391854539515663, [0.04570932123295, 0.19592726975783, 0.23530043137035]),
}


def switching(name, mesh=50):
    problem = BY_NAME[name].build()
    return solve_switching_times(problem, solve(problem, mesh, scheme="radau"))


@pytest.mark.thorough
@pytest.mark.parametrize(
    "name", [pytest.param("luus_arm", marks=pytest.mark.thorough), "dissanayake_arm"]
)
def test_two_link_arms_to_ten_digits(name):
    cost, times = PUBLISHED[name]
    found = switching(name)
    assert found.status is Status.SOLVED
    assert found.cost == pytest.approx(cost, abs=1e-10)
    np.testing.assert_allclose([j.time for j in found.junctions], times, atol=1e-8)
    assert found.state_error <= 1e-9
    assert found.gap.total <= 1e-7 * cost


def test_bang_bang_is_exact_from_a_coarse_mesh():
    """A bridge crane: four arcs in closed form."""
    found = switching("bridge_crane", 20)
    assert found.solved
    assert found.cost == pytest.approx(8.5801026370781, abs=1e-9)
    assert [j.after for j in found.junctions] == ["lower limit", "upper limit", "lower limit"]


@pytest.mark.thorough
def test_a_singular_arc_between_two_that_are_held():
    """Catalyst mixing: 0.1363 and 0.7252 are published; 1 - 0.7252 as in the longer one."""
    found = switching("catalyst_mixing")
    assert found.solved
    np.testing.assert_allclose([j.time for j in found.junctions], [0.136299, 0.725230], atol=2e-6)
    assert [(j.before, j.after) for j in found.junctions] == [
        ("upper limit", "singular, by its own conditions"),
        ("singular, by its own conditions", "lower limit"),
    ]
    assert found.cost == pytest.approx(-0.04805568586, abs=1e-10)


def along(top_speed, acceleration=1.0):
    """5 m from rest to rest in the shortest time."""
    problem = OptimalControlProblem("along")
    phase = problem.phase("move", (0.1, 10.0))
    x = phase.state("x", initial=0.0, final=5.0)
    v = phase.state("v", initial=0.0, final=0.0, upper=top_speed)
    u = phase.control("u", lower=-1.0, upper=1.0)
    phase.derivative(x, v)
    phase.derivative(v, acceleration * u)
    phase.end_cost(phase.duration)
    return problem


@pytest.mark.thorough
def test_a_limit_of_a_state_determines_the_control_of_its_arc():
    found = solve_switching_times(along(2.0))
    assert found.solved
    assert found.cost == pytest.approx(4.5, abs=1e-10)
    times = {(j.name, round(j.time, 9), j.after) for j in found.junctions}
    assert ("v", 2.0, "upper limit") in times
    assert ("u", 2.5, "lower limit") in times
    u = found.sample("move", [0.5, 2.2, 3.0])["u"]
    np.testing.assert_allclose(u[:, 0], [1.0, 0.0, -1.0], atol=1e-9)
    assert found.duration("move") == pytest.approx(4.5)


@pytest.mark.thorough
def test_a_limit_of_second_order():
    """Breakwell's problem: on the ceiling from 3 L to 1 - 3 L, cost 4 / (9 L)."""
    found = switching("breakwell")
    assert found.cost == pytest.approx(4 / 0.9, abs=1e-9)
    np.testing.assert_allclose([j.time for j in found.junctions], [0.3, 0.7], atol=5e-5)


def test_a_limit_that_depends_on_a_control_is_an_equation_on_its_arc():
    """|u| <= 1 as a path constraint of a control without bounds."""
    problem = along(np.inf)
    phase = problem.phases[0]
    free = np.full(1, np.inf)
    phase.controls[0] = replace(phase.controls[0], lower=-free, upper=free)
    phase.constraint("force", phase.controls[0].symbol * 2.0, -2.0, 2.0)
    found = solve_switching_times(problem, solve(problem, 20, scheme="radau"))
    assert found.solved
    assert found.cost == pytest.approx(2 * sqrt(5.0), abs=1e-9)
    assert [(j.name, j.after) for j in found.junctions] == [("force", "lower limit")]


@pytest.mark.thorough
def test_a_limit_of_a_state_goes_on_where_others_begin_and_end():
    """One mass 5 m in the least time, 4.5 s; another as far as it comes by then, 4 m."""
    problem = OptimalControlProblem("two masses")
    phase = problem.phase("move", (0.1, 10.0))
    for name, way, speed, force in (("a", 5.0, 2.0, 1.0), ("b", None, 1.0, 2.0)):
        x = phase.state(f"x{name}", initial=0.0, final=way)
        v = phase.state(f"v{name}", initial=0.0, final=0.0, upper=speed)
        u = phase.control(f"u{name}", lower=-force, upper=force)
        phase.derivative(x, v)
        phase.derivative(v, u)
    phase.end_cost(phase.duration - 0.1 * x)
    found = solve_switching_times(problem)
    assert found.solved
    assert found.cost == pytest.approx(4.5 - 0.4, abs=1e-9)
    times = {(j.name, j.after): j.time for j in found.junctions if j.name in ("va", "vb")}
    wanted = {
        ("vb", "upper limit"): 0.5,
        ("va", "upper limit"): 2.0,
        ("va", "free"): 2.5,
        ("vb", "free"): 4.0,
    }
    assert times == pytest.approx(wanted, abs=1e-7)


@pytest.mark.thorough
def test_several_phases_have_their_own_times():
    problem = OptimalControlProblem("there and back")
    for name, ends, force in (("there", (0.0, 1.0), 1.0), ("back", (None, 0.0), 2.0)):
        phase = problem.phase(name, (0.1, 10.0))
        x = phase.state("x", initial=ends[0], final=ends[1])
        v = phase.state("v", initial=0.0, final=0.0)
        u = phase.control("u", lower=-force, upper=force)
        phase.derivative(x, v)
        phase.derivative(v, u)
        phase.end_cost(phase.duration)
    problem.link(*problem.phases, ("x",))
    found = solve_switching_times(problem)
    assert found.cost == pytest.approx(2 + sqrt(2), abs=1e-9)
    times = [(j.phase, j.time) for j in found.junctions]
    assert [phase for phase, _ in times] == ["there", "back"]
    np.testing.assert_allclose([t for _, t in times], [1.0, sqrt(0.5)], atol=1e-9)


def test_the_result_prints_and_is_plain_data():
    found = solve_switching_times(along(np.inf))
    assert "2.2360679775" in str(found)
    assert repr(found).startswith("<SwitchingTimes: solved, 1 switches")
    stored = json.loads(json.dumps(found.as_dict()))
    assert stored["junctions"][0]["after"] == "lower limit"


def test_what_does_not_work_is_said():
    problem = along(np.inf)
    failed = solve(problem, 20, settings=SolverSettings("ipopt", max_iterations=1))
    assert solve_switching_times(problem, failed).status is Status.ITERATION_LIMIT
    late = solve_switching_times(problem, rounds=1, accuracy=1e-30)
    assert late.status is Status.ROUND_LIMIT
    assert "1.0e-30" in late.advice
    with refused("start", "['move']", "problem"):
        solve_switching_times(another(), solve(problem, 10))
    scaled = along(np.inf)
    phase = scaled.phases[0]
    phase.derivatives[phase.states[0].name] = phase.states[1].symbol * phase.duration
    with refused("phase 'move'", "arcs", "duration"):
        solve_switching_times(scaled, solve(scaled, 20))
    halfway = OptimalControlProblem("halfway")
    phase = halfway.phase("only", 2.0)
    x, u = phase.state("x", initial=1.0), phase.control("u", lower=-1.0, upper=1.0)
    phase.derivative(x, u)
    phase.running_cost(x**2)
    phase.point_constraint("halfway", x, 0.0, 0.6, at=1.0)
    with refused("phase 'only'", "arcs", "points inside"):
        solve_switching_times(halfway, solve(halfway, 20))


def another():
    problem = OptimalControlProblem("other")
    phase = problem.phase("another", 1.0)
    x = phase.state("x", initial=0.0)
    phase.derivative(x, ca.MX(1.0))
    return problem
