"""Warm starts from other phases and schemes; one pendulum declared in three ways."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest

from helpers import sampled, sampled_rows, tells
from microbot_ocp.ocp import OptimalControlProblem, Solution, SolverSettings
from ocp.textbook import solve_once as solve

SPLIT = 0.4  # of the distance


def drive(names: tuple[str, ...], *, controlled: str = "u") -> OptimalControlProblem:
    """1 m from rest to rest in the shortest time, in as many phases as there are names."""
    problem = OptimalControlProblem("drive")
    for index, name in enumerate(names):
        first, last = index == 0, index == len(names) - 1
        phase = problem.phase(name, (0.05, 10.0))
        end = 1.0 if last else SPLIT
        x = phase.state("x", initial=0.0 if first else None, final=end, unit="m")
        v = phase.state("v", initial=0.0 if first else None, final=0.0 if last else None)
        u = phase.control(controlled, lower=-1.0, upper=1.0)
        phase.derivative(x, v)
        phase.derivative(v, u)
        phase.end_cost(phase.duration)
        if not first:
            problem.link(problem.phases[-2], phase)
    return problem


ONE, TWO, OTHER = ("whole",), ("a", "b"), ("b", "c")


@pytest.mark.parametrize(
    ("source", "target"), sampled_rows([(ONE, TWO), (TWO, ONE), (TWO, OTHER)], 3)
)
def test_a_solution_starts_a_problem_with_other_phases(source, target):
    before = solve(drive(source), 20, settings=SolverSettings("ipopt"))
    after = solve(drive(target), 20, before, SolverSettings("ipopt"))
    assert after.status.solved
    assert after.cost == pytest.approx(2.0, abs=2e-3)
    assert after.start is not None
    assert after.start.missing == ()
    start = solve(drive(target), 20, before, SolverSettings("ipopt", max_iterations=0))
    # the pieces of the start join where the source was at the same share of its time
    t = np.cumsum([0.0, *(phase.duration for phase in start.phases)])
    assert t[-1] == pytest.approx(before.duration, rel=0.05)
    assert start.phases[0]["x"][0] == pytest.approx(0.0, abs=0.02)
    assert start.phases[-1]["x"][-1] == pytest.approx(1.0, abs=0.02)
    middle = start.phases[0]["v"][len(start.phases[0]["v"]) // 2]
    assert middle > 0.3  # it moves there, where the default guess stands still


def test_what_the_source_does_not_have_is_said():
    before = solve(drive(ONE), 20)
    problem = drive(TWO, controlled="push")
    after = solve(problem, 20, before, SolverSettings("ipopt", max_iterations=1))
    assert after.start is not None
    assert after.start.missing == ("push of phase 'a'", "push of phase 'b'")
    tells(after.advice, ", ".join(after.start.missing))


@pytest.mark.thorough
def test_a_solution_starts_another_scheme():
    before = solve(drive(ONE), 20, settings=SolverSettings("ipopt"), scheme="radau")
    for scheme in ("gauss", "trapezoidal", "hermite_simpson", "shooting"):
        cold = solve(drive(ONE), 20, settings=SolverSettings("ipopt"), scheme=scheme)
        warm = solve(drive(ONE), 20, before, SolverSettings("ipopt"), scheme=scheme)
        assert warm.status.solved
        assert warm.cost == pytest.approx(cold.cost, rel=1e-6)


# a pendulum lifted to the side with the least squared torque, 1 kg m^2, 4 N m held level

WEIGHT, SIDE, DURATION = 4.0, np.pi / 2, 1.5


def _rest_to_rest(problem: OptimalControlProblem):
    phase = problem.phase("lift", DURATION)
    angle = phase.state("angle", initial=0.0, final=SIDE, unit="rad")
    rate = phase.state("rate", initial=0.0, final=0.0, unit="rad/s")
    phase.derivative(angle, rate)
    return phase, angle, rate


def explicit() -> OptimalControlProblem:
    problem = OptimalControlProblem("explicit")
    phase, angle, rate = _rest_to_rest(problem)
    torque = phase.control("torque", lower=-6.0, upper=6.0, shape="linear", unit="N m")
    phase.derivative(rate, torque - WEIGHT * ca.sin(angle))
    phase.running_cost(torque**2)
    return problem


def semi_explicit() -> OptimalControlProblem:
    problem = OptimalControlProblem("semi-explicit")
    phase, angle, rate = _rest_to_rest(problem)
    torque = phase.control("torque", lower=-6.0, upper=6.0, shape="linear", unit="N m")
    acceleration = phase.algebraic("acceleration", unit="rad/s^2")
    phase.derivative(rate, acceleration)
    phase.algebraic_equation(acceleration + WEIGHT * ca.sin(angle) - torque)
    phase.running_cost(torque**2)
    return problem


def inverse() -> OptimalControlProblem:
    problem = OptimalControlProblem("inverse dynamics")
    phase, angle, rate = _rest_to_rest(problem)
    acceleration = phase.control("acceleration", shape="linear", unit="rad/s^2")
    phase.derivative(rate, acceleration)
    torque = acceleration + WEIGHT * ca.sin(angle)
    phase.constraint("torque", torque, -6.0, 6.0, unit="N m")
    phase.running_cost(torque**2)
    return problem


@pytest.fixture(scope="module")
def lifted() -> Solution:
    return solve(explicit(), 60, settings=SolverSettings("ipopt", tolerance=1e-9), scheme="radau")


@pytest.mark.parametrize("build", sampled([semi_explicit, inverse], 2))
@pytest.mark.parametrize("solver", ["ipopt", "fatrop"])
def test_three_forms_of_one_pendulum_have_one_optimum(
    build: Callable[[], OptimalControlProblem], solver: str, lifted: Solution
):
    settings = SolverSettings(solver, tolerance=1e-9)
    found = solve(build(), 60, settings=settings, scheme="radau")
    assert lifted.status.solved
    assert found.status.solved
    assert found.cost == pytest.approx(lifted.cost, rel=1e-5)
    t = np.linspace(0.0, DURATION, 50)
    wanted = lifted["lift"].sample(t)["angle"]
    np.testing.assert_allclose(found["lift"].sample(t)["angle"], wanted, atol=2e-4)
