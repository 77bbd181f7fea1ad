"""Growth, trade and advertising."""

from __future__ import annotations

from math import pi

import casadi as ca

from benchmarks.suite.problem import (
    OPTI,
    SuiteProblem,
)
from microbot_ocp.ocp import OptimalControlProblem


def wheat_trading() -> OptimalControlProblem:
    """Maximise the profit of trading wheat at an oscillating price, with fees and storage."""
    problem = OptimalControlProblem("wheat")
    phase = problem.phase("year", 12.0)
    cash = phase.state("cash", initial=1.0, lower=0.0)
    wheat = phase.state("wheat", initial=0.0, lower=0.0)
    buy = phase.control("buy", lower=0.0, upper=1.0)
    sell = phase.control("sell", lower=-1.0, upper=0.0)
    price = 1 + 0.5 * ca.sin(4 * pi / 12 * phase.time + 1.5 * pi)
    earned = 0.01 * cash - 0.2 * wheat - price * (buy + sell) - 0.01 * buy + 0.05 * sell
    phase.derivative(cash, earned)
    phase.derivative(wheat, -0.05 * wheat + buy + sell)
    final = 1 + 0.5 * ca.sin(4 * pi / 12 * phase.duration + 1.5 * pi)
    phase.end_cost(-(cash + final * wheat))
    return problem


def advertising() -> OptimalControlProblem:
    """Maximise profit of a market share won by advertising and lost by itself (Vidale, Wolfe)."""
    problem = OptimalControlProblem("advertising", maximize=True)
    phase = problem.phase("only", 10.0)
    x = phase.state("share", initial=0.1, lower=0.0, upper=1.0)
    u = phase.control("u", lower=0.0, upper=2.0)
    phase.derivative(x, u * (1 - x) - 0.1 * x)
    phase.running_cost(ca.exp(-0.05 * phase.time) * (x - u))
    return problem


def economic_growth() -> OptimalControlProblem:
    """Minimise the time of two sectors to one level, by the division of their output."""
    problem = OptimalControlProblem("growth")
    phase = problem.phase("only", (0.01, 100.0))
    x1 = phase.state("x1", initial=1.0)
    x2 = phase.state("x2", initial=2.0)
    share = phase.control("share", lower=0.0, upper=1.0)
    phase.derivative(x1, share * x1 * x2)
    phase.derivative(x2, (1 - share) * x1 * x2)
    phase.end_constraint("level", x1 * x2, 100.0, 100.0)
    phase.end_constraint("even", x1 - x2, 0.0, 0.0)
    phase.end_cost(phase.duration)
    return problem


SHARE, DECAY, IMPATIENCE = 0.3, 0.05, 0.03


EATEN = (IMPATIENCE + (1 - SHARE) * DECAY) / SHARE  # consumed share of the capital, 1/a


def _value_of_capital(k: ca.MX | float) -> ca.MX | float:
    return EATEN**-SHARE * (k ** (1 - SHARE) / (1 - SHARE) + 1 / IMPATIENCE)


def ramsey() -> OptimalControlProblem:
    """Maximise utility over an infinite horizon, mapped by s = 1 - exp(-rho t), and final value."""
    problem = OptimalControlProblem("Ramsey", maximize=True)
    phase = problem.phase("growth", 0.99)
    k = phase.state("k", initial=1.0, lower=0.01)
    c = phase.control("c", lower=0.01)
    left = 1 - phase.time
    phase.derivative(k, (k**SHARE - DECAY * k - c) / (IMPATIENCE * left))
    phase.running_cost(c ** (1 - SHARE) / (1 - SHARE) / IMPATIENCE)
    phase.end_cost(left * _value_of_capital(k))
    return problem


PROBLEMS = (
    SuiteProblem(
        wheat_trading,
        kind="bang-bang, state constraint",
        source="Norman, commodity trading; PSOPT example wheat: 1.738501 (coarse)",
        published=-1.738501,
        tolerance=0.01,
        reference=-1.75036,
        confirmed="fine mesh",
    ),
    SuiteProblem(advertising, "singular", "Sethi 1973", 2.86062, 1e-5, OPTI, 2.860625, sign=-1.0),
    SuiteProblem(economic_growth, "bang-bang", "PINS", 1.1465736, 1e-7, OPTI),
    SuiteProblem(
        ramsey,
        "stiff",
        "closed form",
        float(_value_of_capital(1.0)),
        1e-12,
        "closed form of the infinite horizon",
        sign=-1.0,
    ),
)
