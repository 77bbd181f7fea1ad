"""Least fuel by the size of a thrust: the kink at zero is named, with a form that has none."""

import casadi as ca
import numpy as np
import pytest

from helpers import sampled, sampled_rows
from microbot_ocp.ocp import OptimalControlProblem, SolverSettings, Status, solve
from microbot_ocp.ocp.diagnosis import kinks, unheld


def fuel(form):
    """To [1, 0.5] from rest to rest in 4 s with a thrust of at most 1."""
    problem = OptimalControlProblem("least fuel")
    phase = problem.phase("a", 4.0)
    x = phase.state("x", 2, initial=np.zeros(2), final=[1.0, 0.5])
    v = phase.state("v", 2, initial=np.zeros(2), final=np.zeros(2))
    u = phase.control("u", 2, lower=-1.0, upper=1.0)
    phase.derivative(x, v)
    phase.derivative(v, u)
    if form == "slack":
        size = phase.control("s", lower=0.0, upper=1.0)
        phase.constraint("size", ca.sumsqr(u) - size**2, upper=0.0)
    else:
        phase.constraint("ball", ca.sumsqr(u), upper=1.0)
        sizes = {
            "norm": ca.norm_2(u),
            "root": ca.sqrt(ca.sumsqr(u)),
            "absolute": ca.sum(ca.fabs(u)),
        }
        size = sizes[form]
    phase.running_cost(size)
    return problem


@pytest.mark.parametrize("form", sampled(["slack", "norm", "root", "absolute"], 2))
def test_the_kink_and_a_form_without_are_named(form):
    solution = solve(fuel(form), 24, settings=SolverSettings("ipopt", max_iterations=60))
    assert not solution.solved
    where = "Constraint 'size'" if form == "slack" else "A running cost"
    assert where in solution.advice
    assert "sumsqr(u) + e**2 <= (s + e)**2" in solution.advice


@pytest.mark.thorough
def test_the_form_that_is_named_is_solved_and_not_sent_round_in_a_circle():
    problem = OptimalControlProblem("least fuel")
    phase = problem.phase("a", 4.0)
    x = phase.state("x", 2, initial=np.zeros(2), final=[1.0, 0.5])
    v = phase.state("v", 2, initial=np.zeros(2), final=np.zeros(2))
    u, s = phase.control("u", 2), phase.control("s", lower=0.0, upper=1.0)
    phase.derivative(x, v)
    phase.derivative(v, u)
    phase.constraint("size", ca.sumsqr(u) + 1e-6 <= (s + 1e-3) ** 2)
    phase.running_cost(s)
    solution = solve(problem, 48)
    assert solution.attempts[-1].status.solved
    assert kinks(solution) == ""
    # half of the time at full thrust speeds up, the other half slows down
    distance, duration = np.hypot(1.0, 0.5), 4.0
    thrust = duration / 2 - np.sqrt(duration**2 / 4 - distance)
    assert 2 * thrust - 1e-3 * duration <= solution.cost <= 1.01 * 2 * thrust


def test_without_a_kink_nothing_is_said():
    problem = OptimalControlProblem("least effort")
    phase = problem.phase("a", 1.0)
    x, u = phase.state("x", 2, initial=np.zeros(2), final=[1.0, 0.5]), phase.control("u", 2)
    phase.derivative(x, u)
    phase.constraint("ball", ca.sumsqr(u), upper=4.0)
    phase.running_cost(ca.norm_2(u))
    assert kinks(solve(problem, 6, settings=SolverSettings("ipopt"))) == ""


@pytest.mark.parametrize(
    ("declared", "told"),
    sampled_rows(
        [
            ({}, True),
            ({"shape": "linear"}, False),
            ({"lower": -9.0}, False),
            ({"shape": "constant"}, False),
        ],
        2,
    ),
)
def test_a_control_that_a_constraint_alone_limits_is_named_where_a_gap_is_left(declared, told):
    problem = OptimalControlProblem("pendulum")
    phase = problem.phase("swing", (0.1, 5.0))
    q, v = phase.state("q", initial=0.0, final=1.0), phase.state("v", initial=0.0, final=0.0)
    a = phase.control("a", **declared)
    phase.derivative(q, v)
    phase.derivative(v, a)
    phase.constraint("torque", 2.0 * a + 5.0 * ca.sin(q), lower=-8.0, upper=8.0)
    phase.end_cost(phase.duration)
    solution = solve(problem, 10)
    assert unheld(solution) == ""
    sentence = unheld(solution.ended(Status.GAP_LEFT))
    assert ("'torque' limits control 'a' of phase 'swing'" in sentence) is told
