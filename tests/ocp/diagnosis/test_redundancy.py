"""Conditions that say the same twice are left out and named; those that contradict are, too."""

import numpy as np
import pytest

from helpers import refused, sampled, tells
from microbot_ocp.ocp import OptimalControlProblem, Transcription, solve, verify
from microbot_ocp.ocp.diagnosis import _redundancy


def bounce(**start):
    """A ball that falls 1 m and rises with 0.6 of its speed: as many rows as unknowns."""
    problem = OptimalControlProblem("ball")
    fall, rise = (problem.phase(name, (0.1, 5.0)) for name in ("fall", "rise"))
    h, v = fall.state("h", initial=1.0, final=0.0), fall.state("v", initial=0.0)
    fall.derivative(h, v)
    fall.derivative(v, -9.81)
    top, w = rise.state("h", **start), rise.state("v", initial=-0.6 * fall.final(v), final=0.0)
    rise.derivative(top, w)
    rise.derivative(w, -9.81)
    problem.link(fall, rise, names=["h"])
    rise.end_cost(rise.duration)
    return problem


@pytest.mark.thorough
def test_a_link_and_the_ends_that_it_ties():
    solution = solve(bounce(initial=0.0))
    assert solution.solved
    assert len(solution.attempts) <= 3
    assert solution.duration == pytest.approx(1.6 * np.sqrt(2 / 9.81), rel=1e-6)
    tells(solution.advice, "Left out", "start condition of h", "phase 'rise'", "link of h")
    assert verify(bounce(initial=0.0), solution).ok
    assert "Left out" not in solve(bounce()).advice


def test_a_link_and_ends_that_differ_are_refused_before_a_solver_starts(no_solver):
    with refused("start condition of h", "phase 'rise'", "contradicts", "link of h"):
        solve(bounce(initial=0.5))


def mover(change):
    """x from 0 to 1 in 1 s at the least effort: 1; ``change`` adds to it."""
    problem = OptimalControlProblem("mover")
    phase = problem.phase("a", 1.0)
    x, y = phase.state("x", initial=0.0, final=1.0), phase.state("y", initial=0.0)
    u, w = phase.control("u"), phase.control("w")
    phase.derivative(x, u)
    phase.derivative(y, w)
    phase.running_cost(u**2 + w**2)
    change(phase, x, y)
    return problem


TWICE = {
    "an end": lambda f, x, y: f.end_constraint("again", 2.0 * x, 2.0, 2.0),
    "a start": lambda f, x, y: f.point_constraint("again", x, 0.0, 0.0, at=0.0),
    "a sum of two": lambda f, x, y: (
        f.end_constraint("sum", x + y, 1.0, 1.0),
        f.end_constraint("other", y, 0.0, 0.0),
    ),
    "a square": lambda f, x, y: f.end_constraint("square", (x + 2.0) ** 2, 9.0, 9.0),
    "a fixed duration": lambda f, x, y: f.end_constraint("time", 3.0 * f.duration, 3.0, 3.0),
    "a value elsewhere": lambda f, x, y: f.end_constraint("far", x - f.initial(x), 1.0, 1.0),
}


@pytest.mark.parametrize("kind", sampled(TWICE, 3))
def test_what_is_said_twice_is_solved_in_one_try(kind):
    problem = mover(TWICE[kind])
    solution = solve(problem, 8)
    assert solution.solved
    assert solution.cost == pytest.approx(1.0, abs=1e-6)
    assert verify(problem, solution).ok


@pytest.mark.parametrize(
    "kind", sampled(["an end", "a start", "a sum of two", "a fixed duration"], 2)
)
def test_what_follows_is_named(kind):
    assert "Left out: " in solve(mover(TWICE[kind]), 8).advice


NEITHER = {
    "one more condition": lambda f, x, y: f.end_constraint("y", y, 0.2, 0.2),
    "a range": lambda f, x, y: f.end_constraint("x", x, 0.9, 1.1),
    "a slope that is zero at the guess": lambda f, x, y: f.end_constraint("z", y**2, 0.0, 0.0),
}


@pytest.mark.parametrize("kind", sampled(NEITHER, 3))
def test_what_says_something_is_kept(kind):
    assert "Left out" not in solve(mover(NEITHER[kind]), 8).advice


AGAINST = {
    "an end": lambda f, x, y: f.end_constraint("other", 2.0 * x, 3.0, 3.0),
    "a start": lambda f, x, y: f.point_constraint("other", x, 0.5, 0.5, at=0.0),
    "a sum of two": lambda f, x, y: (
        f.end_constraint("sum", x + y, 1.0, 1.0),
        f.end_constraint("other", y, 0.5, 0.5),
    ),
    "a fixed duration": lambda f, x, y: f.end_constraint("time", f.duration, 3.0, 3.0),
}


@pytest.mark.parametrize("kind", AGAINST)
def test_a_contradiction_is_named_before_a_solver_starts(kind, no_solver):
    with refused("phase 'a'", "contradicts"):
        solve(mover(AGAINST[kind]), 8)


def test_only_gradients_by_variables_of_the_equations_are_compared():
    """Two hundred intervals have thousands of variables; links and ends contain a few of them."""
    program = Transcription(bounce()).program(200)
    rows = _redundancy._equations(program)
    _, slopes = _redundancy._values(program, np.full(program.variable_lower.size, 0.3), rows)
    assert slopes.shape[0] == rows.size
    assert slopes.shape[1] <= 2 * rows.size
