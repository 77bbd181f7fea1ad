"""The order of convergence of every transcription, measured and equal to theory.

The measured motion has no control: a spiral onto the unit circle, nonlinear in both states and with
a closed form. Theory speaks of such smooth problems; where a control is optimised, its own
parametrisation (constant, linear) is an error besides, and the second half of the file measures
that with the optimum of a linear regulator.
"""

from __future__ import annotations

from math import exp, log, tanh

import casadi as ca
import numpy as np
import pytest

from helpers import sampled_rows
from microbot_ocp._base.checks import FloatArray
from microbot_ocp.ocp.problem import OptimalControlProblem
from microbot_ocp.ocp.search import solve
from microbot_ocp.ocp.solvers import SolverSettings
from microbot_ocp.ocp.transcription import Guess, Transcription
from microbot_ocp.ocp.transcription.schemes import (
    Collocation,
    HermiteSimpson,
    IntegratorShooting,
    Scheme,
    Shooting,
    Trapezoidal,
)

pytestmark = pytest.mark.slow

RADIUS, DURATION = 0.3, 2.0


def spiral() -> OptimalControlProblem:
    """r' = r (1 - r^2), angle' = -1, in Cartesian states; the cost is the integral of r^2."""
    problem = OptimalControlProblem("spiral")
    phase = problem.phase("turn", DURATION)
    x = phase.state("x", initial=RADIUS)
    y = phase.state("y", initial=0.0)
    pull = 1 - x**2 - y**2
    phase.derivative(x, y + x * pull)
    phase.derivative(y, -x + y * pull)
    phase.running_cost(x**2 + y**2)
    return problem


def spiral_at(t: FloatArray) -> FloatArray:
    """Exact states [N, 2]."""
    radius = 1 / np.sqrt(1 + (1 / RADIUS**2 - 1) * np.exp(-2 * t))
    return np.column_stack([radius * np.cos(t), -radius * np.sin(t)])


SPIRAL_COST = log(1 + RADIUS**2 * (exp(2 * DURATION) - 1)) / 2
SPIRAL_GUESS = {
    "turn": Guess(
        DURATION,
        {
            "x": lambda s: spiral_at(DURATION * s)[:, :1],
            "y": lambda s: spiral_at(DURATION * s)[:, 1:],
        },
    )
}


def errors(scheme: Scheme, meshes: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
    """Largest error of the states at the mesh points, and error of the cost, by mesh."""
    states, costs = [], []
    for mesh in meshes:
        settings = SolverSettings(solver="ipopt", tolerance=1e-12)
        solution = solve(spiral(), mesh, SPIRAL_GUESS, settings, scheme=scheme)
        assert solution.attempts[-1].status.solved  # order one: the first mesh is too coarse
        phase = solution["turn"]
        reached = np.column_stack([phase["x"], phase["y"]])
        states.append(float(np.abs(reached - spiral_at(phase.t)).max()))
        costs.append(abs(solution.cost - SPIRAL_COST))
    return np.array(states), np.array(costs)


def slope(meshes: tuple[int, ...], values: FloatArray) -> float:
    """Order by least squares: error against step, both logarithmic."""
    return float(np.polyfit(-np.log(meshes), np.log(values), 1)[0])


COARSE, FINE, FINER = (6, 8, 12, 16, 24), (8, 16, 32, 64), (32, 64, 128, 256)
# scheme, its order by theory, meshes on which it is neither rough nor at rounding
SCHEMES = (
    (Trapezoidal(), 2, FINE),
    (HermiteSimpson(), 4, FINE),
    (Shooting(), 4, FINER),
    pytest.param(Shooting(steps=2), 4, FINER, marks=pytest.mark.thorough),
    (IntegratorShooting("rk", {"number_of_finite_elements": 2}), 4, FINE[1:]),
    (Collocation("radau", 1), 1, FINE),
    (Collocation("radau", 2), 3, FINE),
    pytest.param(Collocation("radau", 3), 5, COARSE, marks=pytest.mark.thorough),
    (Collocation("legendre", 1), 2, FINE),
    (Collocation("legendre", 2), 4, FINE),
    pytest.param(Collocation("legendre", 3), 6, COARSE, marks=pytest.mark.thorough),
)


def name(scheme: object) -> str | None:
    """Readable names of the parametrised tests."""
    if isinstance(scheme, Collocation):
        return f"{scheme.kind}_{scheme.degree}"
    if isinstance(scheme, Shooting):
        return f"shooting_{scheme.steps}"
    return type(scheme).__name__ if not isinstance(scheme, (int, tuple)) else None


@pytest.mark.parametrize(("scheme", "order", "meshes"), sampled_rows(SCHEMES, 3), ids=name)
def test_states_and_cost_converge_with_the_order_of_theory(scheme, order, meshes):
    states, costs = errors(scheme, meshes)
    assert scheme.order == order
    assert slope(meshes, states) == pytest.approx(order, abs=0.3)
    assert slope(meshes, costs) == pytest.approx(order, abs=0.3)


@pytest.mark.parametrize("degree", range(1, 10))
@pytest.mark.parametrize("kind", ["radau", "legendre"])
def test_the_quadrature_is_exact_for_polynomials(kind, degree):
    """A running cost of t^k over one second: 1 / (k + 1) up to twice the degree, as Gauss says."""
    highest = 2 * degree - (2 if kind == "radau" else 1)
    problem = OptimalControlProblem("power")
    phase = problem.phase("run", 1.0)
    phase.derivative(phase.state("x", initial=0.0), 0.0)
    phase.running_cost(phase.time ** phase.parameter("power", 1.0))
    stage = Transcription(problem, scheme=Collocation(kind, degree)).kernels[0].stage.value
    for power in range(highest + 1):
        *_, cost = stage(np.ones(stage.size1_in(0)), [0.0, 1.0, power])
        assert float(cost) == pytest.approx(1 / (power + 1), abs=1e-12)


def test_an_adaptive_integrator_controls_the_error_of_the_running_cost():
    """Its steps would otherwise suit the state alone, which is a straight line."""
    problem = OptimalControlProblem("wave")
    phase = problem.phase("run", 1.0)
    x = phase.state("x", initial=0.0)
    phase.derivative(x, 1.0)
    phase.running_cost(ca.cos(20 * x))
    stage = Transcription(problem, scheme=IntegratorShooting()).kernels[0].stage.value
    *_, cost = stage([0.0, 1.0], [0.0, 1.0])
    assert float(cost) == pytest.approx(np.sin(20.0) / 20, abs=1e-8)


# with an optimal control --------------------------------------------------------------------------


def regulator(shape: str) -> OptimalControlProblem:
    """Least half of the integral of x^2 + u^2 from x = 1 over 1 s: tanh(1) / 2."""
    problem = OptimalControlProblem("regulator")
    phase = problem.phase("calm", 1.0)
    x = phase.state("x", initial=1.0)
    u = phase.control("u", shape=shape)
    phase.derivative(x, u)
    phase.running_cost((x**2 + u**2) / 2)
    return problem


@pytest.mark.parametrize(
    ("scheme", "shape", "order", "meshes"),
    sampled_rows(
        [
            (Shooting(), "constant", 2, FINE),
            (Shooting(), "linear", 4, FINE),
            (HermiteSimpson(), "linear", 4, FINE),
            pytest.param(Collocation("radau", 3), "linear", 4, FINE, marks=pytest.mark.thorough),
            (Collocation("radau", 2), "polynomial", 3, FINE),
            pytest.param(
                *(Collocation("radau", 3), "polynomial", 5, (3, 4, 6, 8)),
                marks=pytest.mark.thorough,
            ),
            (Collocation("legendre", 2), "polynomial", 4, FINE),
        ],
        2,
    ),
    ids=name,
)
def test_the_optimum_converges_with_the_order_of_control_and_scheme(scheme, shape, order, meshes):
    """Twice the order of the control (1 constant, 2 linear), and not beyond that of the scheme."""
    settings = SolverSettings(solver="ipopt", tolerance=1e-12)
    found = [solve(regulator(shape), n, None, settings, scheme=scheme).cost for n in meshes]
    assert slope(meshes, np.abs(np.array(found) - tanh(1) / 2)) == pytest.approx(order, abs=0.3)
