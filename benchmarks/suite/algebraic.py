"""Algebraic equations and complementarity."""

from __future__ import annotations

from itertools import pairwise

import casadi as ca

from benchmarks.suite.problem import SuiteProblem, line
from microbot_ocp.ocp import Guess, OptimalControlProblem


def complementarity() -> OptimalControlProblem:
    """y' = 2 - sign(y) written with complementary variables and a penalty of 1000."""
    problem = OptimalControlProblem("dynamic MPEC")
    phase = problem.phase("only", 2.0)
    y = phase.state("y", initial=-1.0)
    s = phase.control("s", lower=-1.0, upper=1.0)
    p = phase.control("p", lower=0.0, upper=10.0)
    q = phase.control("q", lower=0.0, upper=10.0)
    phase.derivative(y, 2 - s)
    phase.constraint("split", q - p - y, 0.0, 0.0)
    phase.running_cost(y**2 + 1000 * (p * (s + 1) + q * (1 - s)))
    phase.end_cost((y - 5 / 3) ** 2)
    return problem


def _complementarity_guess() -> dict[str, Guess]:
    return {"only": Guess(2.0, {"y": -1.0, "s": 0.0, "p": 0.0, "q": 0.0})}


def kinetic_batch_reactor() -> OptimalControlProblem:
    """A stiff batch reactor as a differential-algebraic system in three phases.

    The acid's concentration starts from the catalyst's; a clock is a state.
    """
    problem = OptimalControlProblem("kinetic batch reactor")
    p = problem.free_parameter("p", lower=0.0, upper=0.0262)
    phases, middle = [], ca.MX(0)
    for k, duration in enumerate((0.01, (0.01, 2.5), (0.5, 8.0))):
        phase = problem.phase(f"stage {k + 1}", duration)
        starts = (1.5776, 8.32, 0.0, 0.0, 0.0) if k == 0 else (None,) * 5
        lows, highs = (0.0, 5.0, 0.0, 0.0, 0.0), (2.0, 10.0, 2.0, 2.0, 2.0)
        y1, y2, y3, y4, y5 = (
            phase.state(f"y{i + 1}", initial=starts[i], lower=lows[i], upper=highs[i])
            for i in range(5)
        )
        more = phase.state("y6 more than p", initial=0.0 if k == 0 else None)
        clock = phase.state("clock", initial=0.0 if k == 0 else None, unit="h")
        u1 = phase.algebraic("pH", lower=0.0, upper=15.0)
        u2 = phase.algebraic("u2", lower=0.0, upper=0.02)
        u3 = phase.algebraic("u3", lower=0.0, upper=5e-5)
        u4 = phase.algebraic("u4", lower=0.0, upper=5e-5)
        temperature = phase.control("temperature", lower=293.15, upper=393.15, unit="K")
        y6 = p + more
        k1 = 1.3708e12 * ca.exp(-9.2984e3 / temperature)
        back = 1.6215e20 * ca.exp(-1.3108e4 / temperature)
        k2 = 5.2282e12 * ca.exp(-9.5999e3 / temperature)
        made = k2 * y2 * u2
        first = k1 * y2 * y6 - back * u4
        third = k1 * y4 * y6 - back / 2 * u3
        phase.derivative(y1, -made)
        phase.derivative(y2, -first - made)
        phase.derivative(y3, made + third)
        phase.derivative(y4, -third)
        phase.derivative(y5, first)
        phase.derivative(more, -first - third)
        phase.derivative(clock, ca.MX(1))
        acid = 10**-u1
        phase.algebraic_equation(p - y6 + acid - u2 - u3 - u4)
        phase.algebraic_equation(u2 - 4.876e-14 * y1 / (4.876e-14 + acid))
        phase.algebraic_equation(u3 - 1.7884e-16 * y3 / (1.7884e-16 + acid))
        phase.algebraic_equation(u4 - 2.575e-16 * y5 / (2.575e-16 + acid))
        if k < 2:
            phase.constraint("slow start", y4 - 2 * clock**2, upper=0.0)
        if k == 1:
            middle = phase.final(clock)
        if k == 2:
            phase.end_constraint("the end", clock - 4 * middle, 0.0, 0.0)
            phase.end_constraint("enough", y4, lower=1.0)
            phase.end_cost(clock + 100 * p)
        phases.append(phase)
    for before, after in pairwise(phases):
        problem.link(before, after)
    return problem


def _kinetic_guess() -> dict[str, Guess]:
    ends = {
        "y1": (1.5776, 0.5, 0.5, 0.1),
        "y2": (8.32, 6.0, 6.0, 5.0),
        "y3": (0.0, 0.6, 0.6, 0.6),
        "y4": (0.0, 0.5, 0.5, 0.9),
        "y5": (0.0, 0.5, 0.5, 0.9),
        "clock": (0.0, 0.01, 2.5, 10.0),
        "pH": (7.0, 10.0, 10.0, 10.0),
        "u3": (0.0, 1e-5, 1e-5, 1e-5),
        "u4": (0.0, 1e-5, 1e-5, 1e-5),
        "temperature": (373.0, 393.15, 393.15, 393.15),
    }
    guesses = {}
    for k, duration in enumerate((0.01, 2.49, 7.5)):
        values = {name: line(*ends[name][k : k + 2]) for name in ends}
        values |= {"y6 more than p": 0.0, "p": 0.013, "u2": 0.0}
        guesses[f"stage {k + 1}"] = Guess(duration, values)
    return guesses


PROBLEMS = (
    SuiteProblem(
        complementarity,
        kind="complementarity",
        source="Baumrucker and Biegler, J. Process Control 19 (2009); PSOPT "
        "example mpec: 1.654223; closed form of the limit 134/81",
        published=1.654223,
        tolerance=2e-3,
        reference=134 / 81,
        confirmed="closed form",
        guess=_complementarity_guess,
    ),
    SuiteProblem(
        kinetic_batch_reactor,
        kind="algebraic, stiff, phases",
        source="Betts, Practical Methods (2010), example 6.14 (Caracotsios and Stewart 1985): "
        "3.16466910",
        published=3.16466910,
        tolerance=2e-5,
        confirmed="fine mesh",
        guess=_kinetic_guess,
    ),
)
