"""Controls that equations determine start where the equations hold."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from microbot_ocp.ocp import Guess, solve
from microbot_ocp.ocp.problem import OptimalControlProblem
from microbot_ocp.ocp.starts import completed, default_guess, scaled
from microbot_ocp.ocp.transcription import sampled


def growth(upper: float = np.inf) -> OptimalControlProblem:
    """Move x from 0 to 3 with a control that is 1e-4 exp(x), and another that is twice as large."""
    problem = OptimalControlProblem("growth")
    phase = problem.phase("all", 2.0)
    x = phase.state("x", initial=0.0, final=3.0)
    u = phase.control("u")
    w = phase.control("w", lower=1e-9, upper=upper)
    y = phase.control("y")
    phase.derivative(x, u)
    phase.constraint("exponential", w - 1e-4 * ca.exp(x), 0.0, 0.0)
    phase.constraint("double", y - 2 * w, 0.0, 0.0)
    phase.running_cost(u**2)
    return problem


SHARE = np.linspace(0.0, 1.0, 40)


@pytest.mark.parametrize("end", [3.0, 1.0])
def test_the_equations_hold_along_the_guess_of_the_states(end: float) -> None:
    problem = growth()
    given = {} if end == 3.0 else {"all": Guess(values={"x": end * SHARE})}
    guess = completed(problem, given)["all"]
    w, y = (
        sampled(guess.values[c], problem.phases[0].controls[k], SHARE)[:, 0]
        for k, c in ((1, "w"), (2, "y"))
    )
    np.testing.assert_allclose(w, 1e-4 * np.exp(end * SHARE), rtol=1e-9)
    np.testing.assert_allclose(y, 2 * w, rtol=1e-9)


def test_limits_and_given_values_come_first() -> None:
    limited = default_guess(growth(upper=1e-3))["all"]
    assert np.max(limited.values["w"](SHARE)) == pytest.approx(1e-3)  # type: ignore[operator]
    given = completed(growth(), {"all": Guess(values={"w": 5.0})})["all"]
    assert given.values["w"] == 5.0
    assert "y" not in given.values


def test_their_scales_are_those_of_the_equations() -> None:
    sizes = {v.name: float(v.scale[0]) for v in scaled(growth()).phases[0].controls}
    assert sizes["w"] == pytest.approx(1e-3)
    assert sizes["y"] == pytest.approx(1e-2)


@pytest.mark.thorough
@pytest.mark.slow
def test_an_insurance_with_four_tied_controls_is_solved() -> None:
    """Bocop's collection, problem insurance: 2.059511."""
    problem, rate, end = OptimalControlProblem("insurance"), 0.25, 10.0
    phase = problem.phase("all", end)
    premium = problem.free_parameter("P", lower=0.0)
    cover = phase.state("I", initial=0.0, lower=0.0, upper=1.1)
    expense = phase.state("m", initial=0.001, lower=0.0, upper=1.1)
    paid = phase.state("paid", initial=0.0)
    spent = phase.control("h", lower=0.0, upper=25.0)
    revenue, health, utility = (phase.control(name, lower=0.0) for name in ("R", "H", "U"))
    slope = phase.control("dU/dR", lower=1e-8)
    illness = rate * ca.exp(-rate * phase.time) + np.exp(-rate * end) / end
    effect, change = expense**2 / (1 + expense**2), 2 * expense / (1 + expense**2) ** 2
    equations = {
        "revenue": revenue - (1 - premium + cover - expense),
        "health": health - (1.5 - 0.2 * phase.time * (1 - effect)),
        "utility": utility - (1 - ca.exp(-10 * revenue) + health),
        "slope": slope - 10 * ca.exp(-10 * revenue),
    }
    for name, equation in equations.items():
        phase.constraint(name, equation, 0.0, 0.0)
    phase.derivative(cover, (1 - 0.2 * phase.time * change / slope) * spent)
    phase.derivative(expense, spent)
    phase.derivative(paid, cover * illness)
    phase.end_constraint("premium", paid - premium, 0.0, 0.0)
    phase.running_cost(-utility * illness)
    solution = solve(problem, time_limit=200.0)
    assert solution.solved, solution.advice
    assert -solution.cost == pytest.approx(2.059511, rel=1e-3)
