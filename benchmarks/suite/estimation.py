"""Parameter estimation from measurements, and design of experiments for it."""

from __future__ import annotations

from math import exp, pi

import casadi as ca
import numpy as np

from benchmarks.suite.problem import (
    OPTI,
    SuiteProblem,
)
from microbot_ocp.ocp import Guess, OptimalControlProblem


def _predators_guess() -> dict[str, Guess]:
    rates = {"p1": 0.8, "p2": 0.8, "p3": 1.5, "p4": 1.5}
    return {"only": Guess(10.0, {"x1": 0.4, "x2": 1.0, **rates})}


def predators_and_prey() -> OptimalControlProblem:
    """Fit four rates of Lotka and Volterra to ten measurements of both populations."""
    problem = OptimalControlProblem("predators and prey")
    p1, p2, p3, p4 = (problem.free_parameter(f"p{k}", lower=-1.0, upper=5.0) for k in range(1, 5))
    phase = problem.phase("only", 10.0)
    x1 = phase.state("x1", initial=0.4, lower=0.0, upper=3.0)
    x2 = phase.state("x2", initial=1.0, lower=0.0, upper=3.0)
    phase.derivative(x1, -p1 * x1 + p2 * x1 * x2)
    phase.derivative(x2, p3 * x2 - p4 * x1 * x2)
    table = [
        (0.58462429, 1.653802752),
        (1.480323792, 1.898433328),
        (1.941197515, 0.791087389),
        (1.266090393, 0.402385741),
        (0.68499583, 0.435968041),
        (0.435253441, 0.725707829),
        (0.404814065, 1.244405746),
        (0.822427034, 2.052562952),
        (1.771604896, 1.426515341),
        (1.754832745, 0.548344791),
    ]
    seen = phase.measurement("seen", np.arange(1.0, 11.0), table)
    phase.point_cost(ca.sumsqr(ca.vertcat(x1, x2) - seen))
    return problem


NOISE = 0.05 * np.sin(37.0 * np.arange(80) ** 1.5).reshape(2, 40)


TIMES = np.arange(1, 41) / 40


def _bock_optimum() -> float:
    """Return the optimum: p = pi - 120 d exp(-60) leaves the growing mode free, so p is pi."""
    mode = np.exp(60 * (TIMES - 1))
    mode = np.concatenate([mode, 60 * mode])
    off = NOISE.ravel()
    return float(off @ off - (off @ mode) ** 2 / (mode @ mode))


SEEN = np.column_stack([np.sin(pi * TIMES) + NOISE[0], pi * np.cos(pi * TIMES) + NOISE[1]])


def bock() -> OptimalControlProblem:
    """Fit one parameter of dynamics that grow by exp(60), Bock's notorious problem."""
    problem = OptimalControlProblem("notorious")
    p = problem.free_parameter("p", lower=-10.0, upper=10.0)
    phase = problem.phase("only", 1.0)
    x1 = phase.state("x1", initial=0.0, lower=-10.0, upper=10.0)
    x2 = phase.state("x2", initial=pi, lower=-100.0, upper=100.0)
    phase.derivative(x1, x2)
    phase.derivative(x2, 3600 * x1 - (3600 + p**2) * ca.sin(p * phase.time))
    y = phase.measurement("y", TIMES, SEEN)
    phase.point_cost((x1 - y[0]) ** 2 + (x2 - y[1]) ** 2)
    return problem


RATES_AT = np.linspace(0.0, pi, 129)[1:]


RATES_SEEN = np.exp(RATES_AT)[:, None] + np.sin(37.0 * np.arange(384) ** 1.5).reshape(128, 3)


def two_rates() -> OptimalControlProblem:
    """Fit two parameters of a boundary-value problem with growth and decay of exp(19 t)."""
    problem = OptimalControlProblem("two rates")
    p1 = problem.free_parameter("p1", lower=0.0, upper=30.0)
    p2 = problem.free_parameter("p2", lower=0.0, upper=30.0)
    phase = problem.phase("only", pi)
    x = phase.state("x", 3, lower=0.0, upper=30.0)
    t = phase.time
    cos, sin = p1 * ca.cos(p2 * t), p1 * ca.sin(p2 * t)
    f1 = ca.exp(t) * (-1 + 19 * (ca.cos(t) - ca.sin(t)))
    f3 = ca.exp(t) * (1 - 19 * (ca.cos(t) + ca.sin(t)))
    slopes = (
        (p2 - cos) * x[0] + (p2 + sin) * x[2] + f1,
        p1 * x[1] - 18 * ca.exp(t),
        (sin - p2) * x[0] + (p2 + cos) * x[2] + f3,
    )
    phase.derivative(x, ca.vertcat(*slopes))
    phase.end_constraint("ends", phase.initial(x) + x, 1 + exp(pi), 1 + exp(pi))
    y = phase.measurement("y", RATES_AT, RATES_SEEN)
    phase.point_cost(ca.sumsqr(x - y))
    return problem


def _rates_guess() -> dict[str, Guess]:
    def grow(s: np.ndarray) -> np.ndarray:
        return np.repeat(1 + (exp(pi) - 1) * s[:, None], 3, axis=1)

    return {"only": Guess(pi, {"x": grow, "p1": 28.5, "p2": 1.5})}


def nitric_oxide() -> OptimalControlProblem:
    """Fit two rates of a reversible reaction to fourteen measurements."""
    minutes = [1, 2, 3, 4, 5, 6, 7, 9, 11, 14, 19, 24, 29, 39]
    seen = [1.4, 6.3, 10.5, 14.2, 17.6, 21.4, 23.0, 27.0, 30.5, 34.4, 38.8, 41.6, 43.5, 45.3]
    problem = OptimalControlProblem("nitric oxide")
    k1 = problem.free_parameter("k1", lower=0.0, upper=0.1)
    k2 = problem.free_parameter("k2", lower=0.0, upper=0.1)
    phase = problem.phase("reaction", 39.0)
    x = phase.state("x", initial=0.0)
    phase.derivative(x, k1 * (126.2 - x) * (91.9 - x) ** 2 - k2 * x**2)
    y = phase.measurement("y", minutes, seen)
    phase.point_cost((x - y) ** 2)
    return problem


def experiment() -> OptimalControlProblem:
    """Maximise the information of a feed about two parameters of growth."""
    most, half, scale = 2.62e-4 * 4e3 / 0.64, 1.0, (1 / 250, 3e-2 / 250)
    problem = OptimalControlProblem("experiment", maximize=True)
    phase = problem.phase("batch", 250.0)
    x = phase.state("x", initial=0.0, lower=0.0, upper=100.0)
    by_rate = phase.state("by rate", initial=0.0)
    by_half = phase.state("by half", initial=0.0)
    known = phase.state("known", initial=0.0)
    u = phase.control("u", lower=0.0, upper=20.0)
    base = half + x
    phase.derivative(x, -most * x / base + u)
    phase.derivative(by_rate, most * (x - half * by_rate) / base**2)
    phase.derivative(by_half, -most * half * by_half / base**2 - x / base)
    phase.derivative(known, scale[0] * by_rate**2 + scale[1] * by_half**2)
    phase.end_cost(known)
    return problem


PROBLEMS = (
    SuiteProblem(
        predators_and_prey,
        kind="parameters, data",
        source="Floudas et al. (1999); PSOPT example predator: 0.02753366",
        published=0.02753366,
        tolerance=1e-05,
        confirmed="fine mesh",
        guess=_predators_guess,
    ),
    SuiteProblem(
        bock,
        "parameters, data, unstable",
        "Bock 1987, with other data",
        _bock_optimum(),
        1e-5,
        "closed form",
        guess=lambda: {"only": Guess(1.0, {"x1": 0.0, "x2": 0.0, "p": 0.0})},
    ),
    SuiteProblem(
        two_rates,
        "parameters, data, unstable",
        "PSOPT, with other data",
        194.266885,
        1e-8,
        OPTI,
        guess=_rates_guess,
    ),
    SuiteProblem(
        nitric_oxide,
        "parameters, data, units",
        "Bellman et al. 1967; Tjoa and Biegler 1991: 22.03",
        22.03,
        1e-2,
        OPTI,
        21.86670965,
    ),
    SuiteProblem(
        experiment,
        "bang-singular",
        "Stigter and Keesman 2004; PROPT: 599.5578",
        599.5578,
        1e-3,
        OPTI,
        599.403,
        sign=-1.0,
    ),
)
