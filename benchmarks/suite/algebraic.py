"""Algebraic equations and complementarity."""

from __future__ import annotations

from itertools import pairwise
from math import pi

import casadi as ca
import numpy as np

from benchmarks.suite.problem import (
    SuiteProblem,
    line,
)
from microbot_ocp.ocp import Guess, OptimalControlProblem


def complementarity() -> OptimalControlProblem:
    """Minimise over y' = 2 - sign(y) by complementary variables and a penalty of 1000."""
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
    """Declare a stiff batch reactor as a differential-algebraic system in three phases.

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


def _heat_guess() -> dict[str, Guess]:
    values = 2 + np.cos(pi * np.arange(10) / 9)
    return {"only": Guess(0.5, {"y": values, "heating": 0.1, "left": 3.0, "right": 1.0})}


def heat() -> OptimalControlProblem:
    """Steer a nonlinear heat equation on ten lines; the values beyond its ends are algebraic."""
    count, a1, a2, a3, a4, rate = 10, 4.0, 1.0, 4.0, -1.0, -1.0
    problem = OptimalControlProblem("heat")
    phase = problem.phase("only", 0.5)
    starts = 2 + np.cos(pi * np.arange(count) / (count - 1))
    y = phase.state("y", count, initial=starts, lower=0.0, upper=3.0)
    heating = phase.control("heating", lower=0.0, upper=0.1)
    left = phase.algebraic("left", lower=0.0, upper=3.0)
    right = phase.algebraic("right", lower=0.0, upper=3.0)
    step = 1 / (count - 1)
    shape = np.cos(pi * np.arange(count) * step)
    slow, fast = ca.exp(rate * phase.time), ca.exp(2 * rate * phase.time)
    made = (rate * (a1 + 2 * a2) + pi**2 * (a3 + 2 * a4)) * slow * shape - a4 * pi**2 * fast
    made += (2 * a4 * pi**2 + rate * a2) * fast * shape**2
    wide = ca.vertcat(left, y, right)
    curvature = (wide[2:] - 2 * y + wide[:-2]) / step**2
    slope = (wide[2:] - wide[:-2]) / (2 * step)
    phase.derivative(y, (made + (a3 + a4 * y) * curvature + a4 * slope**2) / (a1 + a2 * y))
    phase.algebraic_equation(y[0] - heating - (a3 + a4 * y[0]) * slope[0])
    phase.algebraic_equation((a3 + a4 * y[-1]) * slope[-1])
    wanted = 2 - slow
    phase.running_cost(0.5 * ((y[-1] - wanted) ** 2 + 1e-3 * heating**2))
    return problem


def pendulum_of_index_1() -> OptimalControlProblem:
    """Steer a pendulum in Cartesian coordinates to rest; its tension is algebraic."""
    problem = OptimalControlProblem("pendulum")
    phase = problem.phase("only", 3.0)
    x = phase.state("x", initial=1.0, final=0.0, lower=-5.0, upper=5.0)
    y = phase.state("y", initial=0.0, lower=-5.0, upper=5.0)
    vx = phase.state("vx", initial=0.0, final=0.0, lower=-5.0, upper=5.0)
    vy = phase.state("vy", initial=0.0, lower=-5.0, upper=5.0)
    tension = phase.algebraic("tension", lower=-1.0, upper=15.0)
    u = phase.control("u")
    phase.derivative(x, vx)
    phase.derivative(y, vy)
    phase.derivative(vx, -2 * tension * x + u * y)
    phase.derivative(vy, -9.81 - 2 * tension * y - u * x)
    phase.algebraic_equation(vx**2 + vy**2 - 2 * tension - 9.81 * y)
    phase.running_cost(u**2)
    return problem


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
    SuiteProblem(
        heat,
        kind="algebraic, stiff",
        source="Betts, Practical Methods (2010), example 4.11; PSOPT example heat: 4.372837e-5",
        published=4.372837e-05,
        tolerance=1e-05,
        confirmed="fine mesh",
        guess=_heat_guess,
    ),
    SuiteProblem(
        pendulum_of_index_1,
        kind="algebraic",
        source="Betts, Practical Methods (2010), example 10.103: 12.8738850",
        published=12.873885,
        tolerance=1e-05,
        confirmed="fine mesh",
    ),
)
