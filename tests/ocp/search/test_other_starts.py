"""Other starts reach as far as the dynamics, whether or not anything has bounds."""

import casadi as ca
import numpy as np
import pytest

from microbot_ocp.ocp import OptimalControlProblem, SolverSettings, load_solution, save_solution
from microbot_ocp.ocp.search import solve
from microbot_ocp.ocp.solution import Status


def least(tilts, start=0.2, effort=0.05):
    """Return the least of effort and tilted double wells in a table of end values."""
    x = np.linspace(-3.0, 3.0, 600_001)
    return sum((effort * (x - start) ** 2 + (x**2 - 1) ** 2 + tilt * x).min() for tilt in tilts)


def wells(tilts=(0.2,), start=0.2, **bounds):
    """A point that is moved into the deeper of two wells in every direction."""
    problem = OptimalControlProblem("wells")
    phase = problem.phase("one", 1.0)
    x = phase.state("x", len(tilts), initial=start)
    u = phase.control("u", len(tilts), **bounds)
    phase.derivative(x, u)
    phase.running_cost(0.05 * ca.sumsqr(u))
    phase.end_cost(ca.sumsqr(x**2 - 1) + ca.dot(ca.DM(tilts), x))
    return problem


def by_parameter():
    problem = OptimalControlProblem("a slope")
    slope = problem.free_parameter("slope")
    phase = problem.phase("one", 1.0)
    x = phase.state("x", initial=0.2)
    phase.derivative(x, slope)
    phase.end_cost((x**2 - 1) ** 2 + 0.2 * x + 0.05 * slope**2)
    return problem


def by_start():
    problem = OptimalControlProblem("a start")
    phase = problem.phase("one", 1.0)
    x = phase.state("x")
    phase.derivative(x, -0.1 * x)
    phase.end_cost((x**2 - 1) ** 2 + 0.2 * x)
    return problem


@pytest.mark.parametrize(
    ("problem", "cost"),
    [
        pytest.param(wells(), least([0.2]), marks=pytest.mark.thorough),
        pytest.param(wells(upper=2.0), least([0.2]), marks=pytest.mark.thorough),
        pytest.param(
            wells(tilts=(0.2, -0.2), start=0.1),
            least([0.2, -0.2], 0.1),
            marks=pytest.mark.thorough,
        ),
        pytest.param(by_parameter(), least([0.2]), marks=pytest.mark.thorough),
        (by_start(), least([0.2], effort=0.0)),
    ],
    ids=["no bounds", "one bound", "two directions", "a parameter", "a free start"],
)
def test_the_deeper_well_is_found(problem, cost):
    found = solve(problem)
    assert found.status is Status.SOLVED
    assert found.cost == pytest.approx(cost, abs=1e-6)
    assert found.compared > 0


@pytest.mark.thorough
def test_an_answer_says_that_it_was_compared_with_nothing(tmp_path):
    alone = solve(wells(), settings=SolverSettings("ipopt"))
    assert alone.compared == 0
    for said in (repr(alone), alone.advice, alone._repr_html_()):
        assert "compared with nothing" in said
    compared = solve(wells())
    for said in (repr(compared), compared.advice, compared._repr_html_()):
        assert "compared with nothing" not in said
    restored = load_solution(save_solution(compared, tmp_path / "wells.npz"))
    assert (restored.compared, restored.agreed) == (compared.compared, compared.agreed)
    assert restored.rivals == pytest.approx(compared.rivals)
