"""Cars, boats and runners."""

from __future__ import annotations

from functools import lru_cache
from math import atan, atanh, log, pi, sqrt

import casadi as ca
import numpy as np

from benchmarks.suite.problem import (
    ICLOCS,
    OPTI,
    SOURCELESS,
    SuiteProblem,
    line,
)
from microbot_ocp.ocp import Guess, OptimalControlProblem


def race_car() -> OptimalControlProblem:
    """Minimise the time of one lap of a car whose speed is limited along the track."""
    problem = OptimalControlProblem("race car")
    phase = problem.phase("lap", (0.1, 100.0))
    place = phase.state("place", initial=0.0, final=1.0)
    speed = phase.state("speed", initial=0.0)
    throttle = phase.control("throttle", lower=0.0, upper=1.0)
    phase.derivative(place, speed)
    phase.derivative(speed, throttle - speed)
    phase.constraint("limit", speed - 1 + ca.sin(2 * pi * place) / 2, upper=0.0)
    phase.end_cost(phase.duration)
    return problem


def underwater_vehicle() -> OptimalControlProblem:
    """Minimise the effort of a submarine around a bump of the current."""
    problem = OptimalControlProblem("underwater vehicle")
    phase = problem.phase("dive", 1.0)
    starts = (0.0, 0.0, 0.2, pi / 2, 0.1, -pi / 4, 1.0, 0.0, 0.5, 0.1)
    ends = (1.0, 0.5, 0.0, pi / 2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    bounds = [(-np.inf, np.inf)] * 10
    bounds[3] = pi / 2 - 0.02, pi / 2 + 0.02
    y1, y2, y3, y4, y5, y6, y7, y8, y9, y10 = (
        phase.state(f"y{k + 1}", initial=a, final=b, lower=low, upper=high)
        for k, (a, b, (low, high)) in enumerate(zip(starts, ends, bounds, strict=True))
    )
    u1, u2, u3, u4 = (phase.control(f"u{k}", lower=-15.0, upper=15.0) for k in range(1, 5))
    bump = ca.exp(-(((y1 - 0.5) / 0.1) ** 2)) * ((y3 - 0.1) / 0.1) ** 2
    phase.derivative(y1, y7 * ca.cos(y6) * ca.cos(y5) - 2 * bump * (y1 - 0.5))
    phase.derivative(y2, y7 * ca.sin(y6) * ca.cos(y5))
    phase.derivative(y3, -y7 * ca.sin(y5) - 0.1 * bump)
    phase.derivative(y4, y8 + (y9 * ca.sin(y4) + y10 * ca.cos(y4)) * ca.tan(y5))
    phase.derivative(y5, y9 * ca.cos(y4) - y10 * ca.sin(y4))
    phase.derivative(y6, (y9 * ca.sin(y4) + y10 * ca.cos(y4)) / ca.cos(y5))
    for state, control in ((y7, u1), (y8, u2), (y9, u3), (y10, u4)):
        phase.derivative(state, control)
    phase.running_cost(u1**2 + u2**2 + u3**2 + u4**2)
    return problem


def electric_vehicle() -> OptimalControlProblem:
    """Minimise the electric energy over a road with a slope that is a cubic."""
    problem = OptimalControlProblem("electric vehicle")
    phase = problem.phase("drive", 1.0)
    x = phase.state("x", initial=0.0, final=10.0)
    v = phase.state("v", initial=0.0, final=0.0)
    u = phase.control("u")
    phase.derivative(x, v)
    phase.derivative(v, u - 1e-3 * v**2 - 0.1 - (3 + 0.4 * x - x**2 + 0.1 * x**3))
    phase.running_cost(1e3 * u * v + 1e3 * u**2)
    return problem


def mountain_car() -> OptimalControlProblem:
    """Minimise the time of a weak car that swings out of a valley; its final speed is free."""
    problem = OptimalControlProblem("mountain car")
    phase = problem.phase("only", (0.05, 10000.0))
    x = phase.state("x", initial=-0.5, final=0.5)
    v = phase.state("v", initial=0.0, final=(0.0, np.inf))
    u = phase.control("u", lower=-1.0, upper=1.0)
    phase.derivative(x, v)
    phase.derivative(v, 0.001 * u - 0.0025 * ca.cos(3 * x))
    phase.end_cost(phase.duration)
    return problem


@lru_cache
def _sled_optimum() -> float:
    """Return the time of a push and a brake, closed forms that meet in place and speed."""
    push, brake, c, m = 2000.0, 4000.0, 2.0, 800.0
    low, high = 0.0, sqrt(push / c) * (1 - 1e-15)
    for _ in range(200):
        v = (low + high) / 2
        way = -m / (2 * c) * log(1 - c * v**2 / push) + m / (2 * c) * log(1 + c * v**2 / brake)
        low, high = (v, high) if way < 100.0 else (low, v)
    return m / sqrt(push * c) * atanh(v * sqrt(c / push)) + m / sqrt(brake * c) * atan(
        v * sqrt(c / brake)
    )


def drag_sled() -> OptimalControlProblem:
    """Minimise the time of a sled with quadratic drag over 100 m from rest to rest, SI."""
    problem = OptimalControlProblem("sled")
    phase = problem.phase("run", (1.0, 1000.0))
    x = phase.state("x", initial=0.0, final=100.0, unit="m")
    v = phase.state("v", initial=0.0, final=0.0, lower=0.0, unit="m/s")
    force = phase.control("force", lower=-4000.0, upper=2000.0, unit="N")
    phase.derivative(x, v)
    phase.derivative(v, (force - 2.0 * v**2) / 800.0)
    phase.end_cost(phase.duration)
    return problem


def battery() -> OptimalControlProblem:
    """Minimise the time to charge a battery within limits of current, voltage, polarisation."""
    problem = OptimalControlProblem("battery")
    phase = problem.phase("charge", (1.0, 1e5))
    charge = phase.state("charge", initial=0.0, final=1.0, lower=0.0, upper=1.0)
    polarisation = phase.state("polarisation", initial=0.0, lower=0.0, upper=0.25, unit="V")
    current = phase.control("current", lower=0.0, upper=150.0, unit="A")
    phase.derivative(charge, current / 54000)
    phase.derivative(polarisation, -polarisation / 16 + current / 8000)
    open_circuit = 3.64 + 0.55 * charge - 0.72 * charge**2 + 0.75 * charge**3
    phase.constraint("voltage", open_circuit + polarisation + 0.003 * current, 3.5, 4.7, unit="V")
    phase.end_cost(phase.duration)
    return problem


def hovering_car() -> OptimalControlProblem:
    """Minimise the time from rest to rest by a thrust whose square burns the mass (ACADO)."""
    problem = OptimalControlProblem("rocket of ACADO")
    phase = problem.phase("move", (5.0, 15.0))
    s = phase.state("s", initial=0.0, final=10.0)
    v = phase.state("v", initial=0.0, final=0.0, lower=-0.1, upper=1.7)
    m = phase.state("m", initial=1.0)
    u = phase.control("u", lower=-1.1, upper=1.1)
    phase.derivative(s, v)
    phase.derivative(v, (u - 0.2 * v**2) / m)
    phase.derivative(m, -0.01 * u**2)
    phase.end_cost(phase.duration)
    return problem


# Data of a runner, in SI units for 1 kg.
FORCE, RESISTANCE, BREATH, STORE = 12.2, 0.892, 41.61, 2409.0


def middle_distance() -> OptimalControlProblem:
    """Minimise the time of 1500 m of a runner whose store of energy is limited."""
    problem = OptimalControlProblem("1500 m")
    phase = problem.phase("run", (50.0, 1000.0))
    x = phase.state("x", initial=0.0, final=1500.0, unit="m")
    v = phase.state("v", initial=0.0, unit="m/s")
    energy = phase.state("energy", initial=STORE, lower=0.0, unit="J/kg")
    f = phase.control("f", lower=0.0, upper=FORCE, unit="N/kg")
    phase.derivative(x, v)
    phase.derivative(v, f - v / RESISTANCE)
    phase.derivative(energy, BREATH - f * v)
    phase.end_cost(phase.duration)
    return problem


def lap() -> OptimalControlProblem:
    """Minimise the time of a lap of 300 m, by distance along it, within a friction circle."""
    problem = OptimalControlProblem("lap")
    phase = problem.phase("track", 300.0)
    s = phase.time
    bend = 2 * pi / 300 * (1 + 1.5 * ca.cos(4 * pi * s / 300))
    aside = phase.state("aside", lower=-4.0, upper=4.0, unit="m")
    heading = phase.state("heading", lower=-1.0, upper=1.0)
    v = phase.state("v", lower=1.0, upper=60.0, unit="m/s")
    along = phase.control("along", upper=4.0, unit="m/s^2")
    across = phase.control("across", unit="m/s^2")
    slowness = (1 - aside * bend) / (v * ca.cos(heading))
    phase.derivative(aside, v * ca.sin(heading) * slowness)
    phase.derivative(heading, across / v * slowness - bend)
    phase.derivative(v, along * slowness)
    phase.constraint("friction", along**2 + across**2, upper=64.0)
    state = ca.vertcat(aside, heading, v)
    phase.end_constraint("closed", state - phase.initial(state), 0.0, 0.0)
    phase.running_cost(slowness)
    return problem


PROBLEMS = (
    SuiteProblem(
        race_car,
        kind="state constraint, order 1",
        source="CasADi examples and MAPTOR examples: race car, no figure",
        published=1.90468,
        tolerance=1e-05,
        confirmed="fine mesh",
    ),
    SuiteProblem(
        underwater_vehicle,
        kind="bounds",
        source="Büskens and Maurer; Betts, Practical Methods (2010): 236.527851",
        published=236.527851,
        tolerance=0.005,
        reference=237.34997,
        confirmed="fine mesh",
    ),
    SuiteProblem(
        electric_vehicle,
        kind="smooth",
        source="Petit and Sciarretta (2011); OptimalControlProblems.jl, no figure",
        published=1228580.29,
        tolerance=1e-05,
        confirmed="fine mesh",
    ),
    SuiteProblem(
        mountain_car,
        "bang-bang",
        "dymos, without the limit of the speed",
        102.368,
        1e-4,
        OPTI,
        102.3676,
        guess=lambda: {"only": Guess(500.0, {"x": line(-0.5, 0.5), "v": line(0.0, 1.0)})},
    ),
    SuiteProblem(
        drag_sled, "bang-bang, units", "closed form", _sled_optimum(), 1e-6, "closed form"
    ),
    SuiteProblem(battery, "state constraint, units", ICLOCS, 434.627, 1e-5, OPTI),
    SuiteProblem(
        hovering_car,
        "state constraint, chattering",
        "ACADO, its first example",
        7.392677,
        1e-6,
        "Opti on 300 intervals, with the square of the thrust as a control of its own",
    ),
    SuiteProblem(
        middle_distance,
        "state constraint, singular",
        "Keller 1974: 3:39.44",
        219.44,
        1e-3,
        "an even speed between full force and what is breathed",
        219.2924759,
    ),
    SuiteProblem(lap, "periodic", SOURCELESS, 16.18603, 1e-5, OPTI),
)
