"""A second set whose first answers were counted before anything was mended on their account."""

from __future__ import annotations

import casadi as ca
import numpy as np

from benchmarks.suite.problem import SuiteProblem, along, line
from microbot_ocp.ocp import Guess, OptimalControlProblem


def two_drugs() -> OptimalControlProblem:
    """Warfarin and phenylbutazone in the blood are brought to their levels in least time."""
    problem = OptimalControlProblem("two drugs")
    phase = problem.phase("only", (1.0, 500.0))
    x1 = phase.state("warfarin", initial=0.02, final=0.02)
    x2 = phase.state("phenylbutazone", initial=0.0, final=2.0)
    u = phase.control("u", lower=0.0, upper=8.0)
    free = (1 + 0.2 * (x1 + x2)) ** 2
    second, first = free + 232 + 46.4 * x2, free + 232 + 46.4 * x1
    factor = free / (second * first - 2152.96 * x1 * x2)
    phase.derivative(x1, factor * (first * (0.02 - x1) + 46.4 * x1 * (u - 2 * x2)))
    phase.derivative(x2, factor * (second * (u - 2 * x2) + 46.4 * (0.02 - x1)))
    phase.end_cost(phase.duration)
    return problem


def oil_shale() -> OptimalControlProblem:
    """Temperature and time of a pyrolysis for most bitumen."""
    problem = OptimalControlProblem("oil shale", maximize=True)
    phase = problem.phase("only", (9.1, 12.0))
    kerogen = phase.state("kerogen", initial=1.0, lower=0.0, upper=1.0)
    bitumen = phase.state("bitumen", initial=0.0, lower=0.0, upper=1.0)
    temperature = phase.control("temperature", lower=698.15, upper=748.15, unit="K")
    exponents = (8.86, 24.25, 23.67, 18.75, 20.70)
    energies = np.array([20300.0, 37400.0, 33800.0, 28200.0, 31000.0]) / 1.9872
    k = [ca.exp(a - b / temperature) for a, b in zip(exponents, energies, strict=True)]
    phase.derivative(kerogen, -k[0] * kerogen - (k[2] + k[3] + k[4]) * kerogen * bitumen)
    phase.derivative(bitumen, k[0] * kerogen - k[1] * bitumen + k[2] * kerogen * bitumen)
    phase.end_cost(bitumen)
    return problem


def two_stage_reactor() -> OptimalControlProblem:
    """Two stirred tanks are brought to their steady state in least time."""
    problem = OptimalControlProblem("two-stage reactor")
    phase = problem.phase("only", (0.1, 100.0))
    starts = (0.1962, -0.0372, 0.0946, 0.0)
    x1, x2, x3, x4 = (
        phase.state(f"x{k}", initial=start, final=0.0) for k, start in enumerate(starts, start=1)
    )
    u1 = phase.control("u1", lower=-1.0, upper=1.0)
    u2 = phase.control("u2", lower=-1.0, upper=1.0)
    first = 1.5e7 * (0.5251 - x1) * ca.exp(-10 / (x2 + 0.6932)) - 1.4280
    first -= 1.5e10 * (0.4748 + x1) * ca.exp(-15 / (x2 + 0.6932))
    second = 1.5e7 * (0.4236 - x2) * ca.exp(-10 / (x4 + 0.6560)) - 0.5086
    second -= 1.5e10 * (0.5764 + x3) * ca.exp(-15 / (x4 + 0.6560))
    phase.derivative(x1, -3 * x1 + first)
    phase.derivative(x2, -11.1558 * x2 + first - 8.1558 * (x2 + 0.1592) * u1)
    phase.derivative(x3, 1.5 * (0.5 * x1 - x3) + second)
    phase.derivative(x4, 0.75 * x2 - 4.9385 * x4 + second - 3.4385 * (x4 + 0.122) * u2)
    phase.end_cost(phase.duration)
    return problem


def turbo_generator() -> OptimalControlProblem:
    """A generator is held near a state that is no equilibrium."""
    problem = OptimalControlProblem("turbo generator")
    phase = problem.phase("only", 20.0)
    s1, s2, s3, s4 = 0.60295, 0.0, 1.87243, 0.79778
    x1, x2 = phase.state("x1", initial=s1), phase.state("x2", initial=s2)
    x3, x4 = phase.state("x3", initial=s3), phase.state("x4", initial=s4)
    u1, u2 = phase.control("u1"), phase.control("u2")
    phase.derivative(x1, x2 * x4)
    phase.derivative(x2, (u1 - 0.02535 * x2) / 0.04225)
    phase.derivative(x3, u2 - 0.17 * x3)
    phase.derivative(x4, -x1 * x2)
    phase.running_cost(2.5 * ((x1 - s1) ** 2 + (x4 - s4) ** 2) + x2**2 + 0.1 * (x3 - s3) ** 2)
    phase.running_cost((u1 - 0.80) ** 2 + (u2 - 0.73962) ** 2)
    return problem


def mountain_car() -> OptimalControlProblem:
    """A weak car swings out of a valley in least time; its speed is free."""
    problem = OptimalControlProblem("mountain car")
    phase = problem.phase("only", (0.05, 10000.0))
    x = phase.state("x", initial=-0.5, final=0.5)
    v = phase.state("v", initial=0.0, final=(0.0, np.inf))
    u = phase.control("u", lower=-1.0, upper=1.0)
    phase.derivative(x, v)
    phase.derivative(v, 0.001 * u - 0.0025 * ca.cos(3 * x))
    phase.end_cost(phase.duration)
    return problem


def four_integrators() -> OptimalControlProblem:
    """A chain of four integrators is brought to rest in least time."""
    problem = OptimalControlProblem("four integrators")
    phase = problem.phase("only", (0.1, 100.0))
    chain = [
        phase.state(f"x{k}", initial=start, final=0.0)
        for k, start in enumerate((0.1, 0.2, 0.3, 0.0), start=1)
    ]
    u = phase.control("u", lower=-1.0, upper=1.0)
    for state, slope in zip(chain, [*chain[1:], u], strict=True):
        phase.derivative(state, slope)
    phase.end_cost(phase.duration)
    return problem


def to_mars() -> OptimalControlProblem:
    """Least time from the orbit of the Earth to that of Mars with a small constant thrust."""
    problem = OptimalControlProblem("to Mars")
    phase = problem.phase("only", (0.5, 10.0))
    r = phase.state("r", initial=1.0, final=1.5237, lower=0.9, upper=1.6)
    radial = phase.state("radial", initial=0.0, final=0.0)
    around = phase.state("around", initial=1.0, final=1.5237**-0.5)
    angle = phase.control("angle", lower=0.0, upper=2 * np.pi)
    push = 0.1405 / (1 - 0.0749 * phase.time)
    phase.derivative(r, radial)
    phase.derivative(radial, around**2 / r - 1 / r**2 + push * ca.sin(angle))
    phase.derivative(around, -radial * around / r + push * ca.cos(angle))
    phase.end_cost(phase.duration)
    return problem


def penicillin() -> OptimalControlProblem:
    """The feed of a fermentation of 126 h for most penicillin."""
    problem = OptimalControlProblem("penicillin", maximize=True)
    phase = problem.phase("only", 126.0)
    biomass = phase.state("biomass", initial=1.5, lower=0.0, upper=40.0)
    product = phase.state("product", initial=0.0, lower=0.0, upper=50.0)
    substrate = phase.state("substrate", initial=0.0, lower=0.0, upper=25.0)
    volume = phase.state("volume", initial=7.0, lower=0.0, upper=10.0)
    feed = phase.control("feed", lower=0.0, upper=50.0)
    growth = 0.11 * substrate / (0.006 * biomass + substrate)
    making = 0.0055 * substrate / (0.0001 + substrate * (1 + 10 * substrate))
    upkeep = 0.029 * substrate / (0.0001 + substrate)
    phase.derivative(biomass, growth * biomass - feed * biomass / 500 / volume)
    phase.derivative(product, making * biomass - 0.01 * product - feed * product / 500 / volume)
    phase.derivative(
        substrate,
        -(growth / 0.47 + making / 1.2 + upkeep) * biomass + feed / volume * (1 - substrate / 500),
    )
    phase.derivative(volume, feed / 500)
    phase.end_cost(product * volume)
    return problem


LUUS = "Luus, Iterative Dynamic Programming; PROPT"
MESHES = "Opti on 300 intervals"

PROBLEMS = (
    SuiteProblem(
        two_drugs,
        "bang-bang",
        LUUS,
        221.3334,
        5e-4,
        MESHES,
        221.2430,
        guess=lambda: {
            "only": Guess(
                300.0, {"phenylbutazone": line(0.0, 2.0), "u": along(lambda s: 8.0 - 8.0 * s)}
            )
        },
    ),
    SuiteProblem(
        oil_shale,
        "bang-singular",
        "Carrasco and Banga 1997; PROPT",
        0.353,
        3e-3,
        MESHES,
        0.353815,
        sign=-1.0,
        guess=lambda: {"only": Guess(9.3, {"temperature": 725.0})},
    ),
    SuiteProblem(
        two_stage_reactor,
        "bang-bang, stiff",
        LUUS,
        0.3244,
        3e-3,
        "Opti on 100 intervals",
        0.32365,
        guess=lambda: {"only": Guess(0.3, {"x1": 0.1962, "x2": -0.0372, "x3": 0.0946, "x4": 0.0})},
    ),
    SuiteProblem(turbo_generator, "smooth", "OCCAL; PROPT", 15.0198, 1e-5, MESHES, 15.01983),
    SuiteProblem(
        mountain_car,
        "bang-bang",
        "dymos, without the limit of the speed",
        102.368,
        1e-4,
        MESHES,
        102.3676,
        guess=lambda: {"only": Guess(500.0, {"x": line(-0.5, 0.5), "v": line(0.0, 1.0)})},
    ),
    SuiteProblem(
        four_integrators,
        "bang-bang",
        "the equations of three switches",
        4.831895,
        1e-6,
        "solved for the arcs",
    ),
    SuiteProblem(
        to_mars,
        "smooth",
        "Bryson and Ho 1975, with the time free",
        3.3155,
        1e-4,
        "the digits that are printed",
        3.315567,
    ),
    SuiteProblem(
        penicillin,
        "bang-singular, local optima",
        "Cuthrell and Biegler 1989",
        87.69,
        2e-3,
        MESHES,
        87.832,
        sign=-1.0,
    ),
)
