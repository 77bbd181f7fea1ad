"""Problems that were written down, and their first answers counted, before anything was mended.

None of them had a part in the choice of defaults; the page tells what came of them at first sight.
"""

from __future__ import annotations

from itertools import pairwise
from math import exp, pi, radians

import casadi as ca
import numpy as np

from benchmarks.suite.problem import SuiteProblem, along, line
from microbot_ocp.ocp import Guess, OptimalControlProblem


def rayleigh_in_least_time() -> OptimalControlProblem:
    """Rayleigh's equation from (-5, -5) to rest, |u| <= 4."""
    problem = OptimalControlProblem("Rayleigh in least time")
    phase = problem.phase("only", (0.1, 100.0))
    x1 = phase.state("x1", initial=-5.0, final=0.0)
    x2 = phase.state("x2", initial=-5.0, final=0.0)
    u = phase.control("u", lower=-1.0, upper=1.0)
    phase.derivative(x1, x2)
    phase.derivative(x2, -x1 + x2 * (1.4 - 0.14 * x2**2) + 4 * u)
    phase.end_cost(phase.duration)
    return problem


def race_car() -> OptimalControlProblem:
    """One lap of a car whose speed is limited along the track."""
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


def van_der_pol_with_limit() -> OptimalControlProblem:
    """The Van der Pol oscillator of CasADi's examples, x1 >= -0.25."""
    problem = OptimalControlProblem("Van der Pol")
    phase = problem.phase("only", 10.0)
    x1 = phase.state("x1", initial=0.0, lower=-0.25)
    x2 = phase.state("x2", initial=1.0)
    u = phase.control("u", lower=-1.0, upper=1.0)
    phase.derivative(x1, (1 - x2**2) * x1 - x2 + u)
    phase.derivative(x2, x1)
    phase.running_cost(x1**2 + x2**2 + u**2)
    return problem


def heat() -> OptimalControlProblem:
    """A nonlinear heat equation by ten lines; the values beyond its ends are algebraic."""
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


def _heat_guess() -> dict[str, Guess]:
    values = 2 + np.cos(pi * np.arange(10) / 9)
    return {"only": Guess(0.5, {"y": values, "heating": 0.1, "left": 3.0, "right": 1.0})}


def fishing_with_two_fleets() -> OptimalControlProblem:
    """Lotka and Volterra, prey and predators fished by a fleet each."""
    problem = OptimalControlProblem("two fleets")
    phase = problem.phase("only", 12.0)
    prey = phase.state("prey", initial=0.5)
    predators = phase.state("predators", initial=0.7)
    first = phase.control("first", lower=0.0, upper=1.0)
    second = phase.control("second", lower=0.0, upper=1.0)
    phase.derivative(prey, prey - prey * predators - 0.4 * prey * first)
    phase.derivative(predators, prey * predators - predators - 0.2 * predators * second)
    phase.running_cost((prey - 1) ** 2 + (predators - 1) ** 2)
    return problem


def wheat_trading() -> OptimalControlProblem:
    """Buying and selling wheat at a price that swings, with fees and storage."""
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


def limited_rate() -> OptimalControlProblem:
    """Least effort from rest to rest with a force that changes by 4 a second at most."""
    problem = OptimalControlProblem("limited rate")
    phase = problem.phase("move", 2.0)
    x = phase.state("x", initial=0.0, final=1.0)
    v = phase.state("v", initial=0.0, final=0.0)
    u = phase.state("u", initial=0.0, lower=-10.0, upper=10.0)
    rate = phase.control("rate", lower=-4.0, upper=4.0)
    phase.derivative(x, v)
    phase.derivative(v, u)
    phase.derivative(u, rate)
    phase.running_cost(u**2)
    return problem


def target_line() -> OptimalControlProblem:
    """Least energy to a line of end states."""
    problem = OptimalControlProblem("target line")
    phase = problem.phase("move", 1.0)
    x1 = phase.state("x1", initial=0.0, lower=-5.0, upper=5.0)
    x2 = phase.state("x2", initial=0.0, lower=-5.0, upper=5.0)
    u = phase.control("u", lower=-50.0, upper=50.0)
    phase.derivative(x1, x2)
    phase.derivative(x2, u)
    phase.end_constraint("line", x1 - 2 * x2, 1.0, 1.0)
    phase.running_cost(0.5 * u**2)
    return problem


def geodesic() -> OptimalControlProblem:
    """The shortest way over a spheroid from New York to London: states tied by an equation."""
    problem = OptimalControlProblem("geodesic")
    phase = problem.phase("fly", (3.0, 10.0))
    ends = _airports()
    x, y, z = (
        phase.state(name, initial=ends[0][k], final=ends[1][k], lower=-size, upper=size, unit="km")
        for k, (name, size) in enumerate((("x", 6384.0), ("y", 6384.0), ("z", 6353.0)))
    )
    theta = phase.control("theta", lower=0.0, upper=pi)
    phi = phase.control("phi", lower=0.0, upper=2 * pi)
    speed = 900.0
    phase.derivative(x, speed * ca.sin(theta) * ca.cos(phi))
    phase.derivative(y, speed * ca.sin(theta) * ca.sin(phi))
    phase.derivative(z, speed * ca.cos(theta))
    phase.constraint("ground", (x**2 + y**2) / 6384.0**2 + z**2 / 6353.0**2 - 1, 0.0, 0.0)
    phase.end_cost(speed * phase.duration)
    return problem


def _airports() -> tuple[np.ndarray, np.ndarray]:
    here, there = _angles()
    return _on_ground(*here), _on_ground(*there)


def _angles() -> tuple[tuple[float, float], tuple[float, float]]:
    here = pi / 2 - radians(40.6413), 2 * pi - radians(73.7781)
    there = pi / 2 - radians(51.4700), 2 * pi - radians(0.4543)
    return here, there


def _on_ground(theta, phi) -> np.ndarray:
    return np.array(
        [
            6384.0 * np.sin(theta) * np.cos(phi),
            6384.0 * np.sin(theta) * np.sin(phi),
            6353.0 * np.cos(theta),
        ]
    )


def _geodesic_guess() -> dict[str, Guess]:
    s = np.linspace(0.0, 1.0, 101)
    (t0, p0), (t1, p1) = _angles()
    places = _on_ground(t0 + (t1 - t0) * s, p0 + (p1 - p0) * s)
    steps = np.diff(places, axis=1)
    lengths = np.linalg.norm(steps, axis=0)
    theta = np.arccos(steps[2] / lengths)
    phi = np.arctan2(steps[1], steps[0]) % (2 * pi)
    tables = {**dict(zip("xyz", places, strict=True))}
    tables |= {"theta": np.append(theta, theta[-1]), "phi": np.append(phi, phi[-1])}
    values = {
        name: along(lambda q, table=table: np.interp(q, s, table)) for name, table in tables.items()
    }
    return {"fly": Guess(lengths.sum() / 900.0, values)}


def predators_and_prey() -> OptimalControlProblem:
    """Four rates of Lotka and Volterra from ten measurements of both."""
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


def _predators_guess() -> dict[str, Guess]:
    rates = {"p1": 0.8, "p2": 0.8, "p3": 1.5, "p4": 1.5}
    return {"only": Guess(10.0, {"x1": 0.4, "x2": 1.0, **rates})}


def underwater_vehicle() -> OptimalControlProblem:
    """Least effort of a submarine around a bump of the current."""
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


def pendulum_of_index_1() -> OptimalControlProblem:
    """A pendulum in Cartesian coordinates brought to rest; its tension is algebraic."""
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


def delays() -> OptimalControlProblem:
    """x' = x(t - 1) u(t - 2), six stretches of time side by side, tied at their ends."""
    problem = OptimalControlProblem("delays")
    phase = problem.phase("only", 1.0)
    x = [phase.state(f"x{k}", initial=1.0 if k == 1 else None) for k in range(1, 7)]
    u = [phase.control(f"u{k}") for k in range(1, 7)]
    before, delayed = [ca.MX(1.0), *x[:-1]], [ca.MX(0.0), ca.MX(0.0), *u[:-2]]
    for state, own, late in zip(x, before, delayed, strict=True):
        phase.derivative(state, own * late)
    for k in range(6):
        phase.constraint(f"mixed {k}", u[k] + x[k], lower=0.3)
        phase.running_cost(x[k] ** 2 + u[k] ** 2)
    for k in range(5):
        phase.end_constraint(f"tie {k}", x[k] - phase.initial(x[k + 1]), 0.0, 0.0)
    return problem


def two_burns() -> OptimalControlProblem:
    """From low to geostationary orbit: coast, burn, coast, burn; most mass is left."""
    problem = OptimalControlProblem("two burns")
    starts = (21837080.052835, 0.0, 0.0, -0.25396764647494, 0.0, pi)
    ends = (19323 * 6076.1154855643 + 20925662.73, 0.0, 0.0, 0.0, 0.0)
    spans = ((2000.0, 3000.0), (1.0, 1000.0), (18500.0, 19700.0), (1.0, 300.0))
    phases, mass = [], None
    for k, span in enumerate(spans):
        phase = problem.phase(f"stretch {k + 1}", span)
        burns = k in (1, 3)
        lows = (10e6, -1.0, -1.0, -1.0, -1.0, pi)
        highs = (2e8, 1.0, 1.0, 1.0, 1.0, 30 * pi)
        orbit = [
            phase.state(
                name,
                initial=starts[i] if k == 0 else None,
                final=ends[i] if k == 3 and i < 5 else None,
                lower=lows[i],
                upper=highs[i],
            )
            for i, name in enumerate(("p", "f", "g", "h", "k", "L"))
        ]
        push = None
        if burns:
            mass = phase.state(
                "mass",
                initial=1.0 if k == 1 else phases[1].final(mass),
                lower=0.0,
                upper=2.0,
            )
            theta = phase.control("theta", lower=-pi, upper=pi)
            phi = phase.control("phi", lower=-pi, upper=pi)
            phase.derivative(mass, ca.MX(-1.2 / 300.0))
            size = 1.2 * 32.174 / mass
            push = size * ca.vertcat(
                ca.cos(theta) * ca.cos(phi), ca.cos(theta) * ca.sin(phi), ca.sin(theta)
            )
        for state, slope in zip(orbit, _equinoctial(orbit, push), strict=True):
            phase.derivative(state, slope)
        if k == 3:
            assert mass is not None
            phase.end_cost(-mass)
        phases.append(phase)
    for before, after in pairwise(phases):
        problem.link(before, after)
    return problem


def _equinoctial(orbit: list[ca.MX], push: ca.MX | None) -> list[ca.MX]:
    """Rates of modified equinoctial elements with J2 to J4; the push in velocity axes."""
    p, f, g, h, k, longitude = orbit
    mu, earth = 1.407645794e16, 20925662.73
    c, s = ca.cos(longitude), ca.sin(longitude)
    q = 1 + f * c + g * s
    r = p / q
    alpha, wide = h**2 - k**2, 1 + h**2 + k**2
    place = (r / wide) * ca.vertcat(
        c + alpha * c + 2 * h * k * s, s - alpha * s + 2 * h * k * c, 2 * (h * s - k * c)
    )
    velocity = (ca.sqrt(mu / p) / wide) * ca.vertcat(
        -(s + alpha * s - 2 * h * k * c + g - 2 * f * h * k + alpha * g),
        -(-c + alpha * c + 2 * h * k * s - f + 2 * g * h * k + alpha * f),
        2 * (h * c + k * s + f * h + g * k),
    )
    radial = place / ca.norm_2(place)
    normal = ca.cross(place, velocity)
    normal /= ca.norm_2(normal)
    along_track = ca.cross(normal, radial)
    sine = place[2] / ca.norm_2(place)
    cosine = ca.sqrt(1 - sine**2)
    north = ca.vertcat(0, 0, 1) - sine * radial
    north /= ca.norm_2(north)
    values = (
        0.5 * (3 * sine**2 - 1),
        0.5 * (5 * sine**3 - 3 * sine),
        (35 * sine**4 - 30 * sine**2 + 3) / 8,
    )
    slopes = (3 * sine, 0.5 * (15 * sine**2 - 3), (140 * sine**3 - 60 * sine) / 8)
    weights = (1082.639e-6, -2.565e-6, -1.608e-6)
    northward, inward = ca.MX(0), ca.MX(0)
    for j, (value, slope, weight) in enumerate(zip(values, slopes, weights, strict=True), 2):
        northward -= mu * cosine / r**2 * (earth / r) ** j * slope * weight
        inward -= mu / r**2 * (j + 1) * (earth / r) ** j * value * weight
    total = northward * north - inward * radial
    if push is not None:
        ahead = velocity / ca.norm_2(velocity)
        across = ca.cross(velocity, place)
        across /= ca.norm_2(across)
        third = ca.cross(ahead, across)
        total += push[0] * ahead + push[1] * across + push[2] * third
    d1, d2, d3 = ca.dot(radial, total), ca.dot(along_track, total), ca.dot(normal, total)
    root, twist = ca.sqrt(p / mu), h * s - k * c
    return [
        2 * p / q * root * d2,
        root * (s * d1 + ((q + 1) * c + f) / q * d2 - g / q * twist * d3),
        root * (-c * d1 + ((q + 1) * s + g) / q * d2 + f / q * twist * d3),
        root * wide * c / (2 * q) * d3,
        root * wide * s / (2 * q) * d3,
        root / q * twist * d3 + ca.sqrt(mu * p) * (q / p) ** 2,
    ]


def _two_burns_guess() -> dict[str, Guess]:
    starts = np.array([21837080.052835, 0.0, 0.0, -0.25396764647494, 0.0, pi])
    ends = np.array([19323 * 6076.1154855643 + 20925662.73, 0.0, 0.0, 0.0, 0.0, 9.4])
    light = exp(-8000 / (32.174 * 300))
    masses = {1: (1.0, light), 3: (light, light * exp(-3000 / (32.174 * 300)))}
    angles = {1: (0.148637e-2, -9.08446), 3: (-0.136658e-2, 49.7892)}
    guesses = {}
    for k, duration in enumerate((2690.0, 150.0, 18810.0, 50.0)):
        first, last = (starts + (ends - starts) * share / 4 for share in (k, k + 1))
        values = {
            name: line(first[i], last[i]) for i, name in enumerate(("p", "f", "g", "h", "k", "L"))
        }
        if k in masses:
            values["mass"] = line(*masses[k])
            values |= {"theta": radians(angles[k][0]), "phi": radians(angles[k][1])}
        guesses[f"stretch {k + 1}"] = Guess(duration, values)
    return guesses


def ducted_fan() -> OptimalControlProblem:
    """A planar ducted fan sideways by 1 m: time and effort, tilt within 30 degrees."""
    problem = OptimalControlProblem("ducted fan")
    phase = problem.phase("move", (0.1, 100.0))
    x1 = phase.state("x1", initial=0.0, final=1.0)
    v1 = phase.state("v1", initial=0.0, final=0.0)
    x2 = phase.state("x2", initial=0.0, final=0.0)
    v2 = phase.state("v2", initial=0.0, final=0.0)
    tilt = phase.state("tilt", initial=0.0, final=0.0, lower=-pi / 6, upper=pi / 6)
    rate = phase.state("rate", initial=0.0, final=0.0)
    u1 = phase.control("u1", lower=-5.0, upper=5.0)
    u2 = phase.control("u2", lower=0.0, upper=17.0)
    phase.derivative(x1, v1)
    phase.derivative(v1, (u1 * ca.cos(tilt) - u2 * ca.sin(tilt)) / 2.2)
    phase.derivative(x2, v2)
    phase.derivative(v2, (-4 + u1 * ca.sin(tilt) + u2 * ca.cos(tilt)) / 2.2)
    phase.derivative(tilt, rate)
    phase.derivative(rate, 0.2 * u1 / 0.05)
    phase.running_cost(2 * u1**2 + u2**2)
    phase.end_cost(1000 * phase.duration)
    return problem


def double_oscillator() -> OptimalControlProblem:
    """Two masses on springs shaken by a sine; the damping is the control."""
    problem = OptimalControlProblem("double oscillator")
    phase = problem.phase("period", 2 * pi)
    x1, x2 = phase.state("x1", initial=0.0), phase.state("x2", initial=0.0)
    v1, v2 = phase.state("v1"), phase.state("v2")
    u = phase.control("u", lower=-1.0, upper=1.0)
    phase.derivative(x1, v1)
    phase.derivative(x2, v2)
    phase.derivative(v1, (-103 * x1 + 3 * x2 + ca.sin(phase.time)) / 100)
    phase.derivative(v2, (3 * x1 - 3 * x2 - 0.5 * (1 - u) * v2) / 2)
    phase.running_cost(0.5 * (x1**2 + x2**2 + u**2))
    return problem


def electric_vehicle() -> OptimalControlProblem:
    """Least electric energy over a road with a slope that is a cubic."""
    problem = OptimalControlProblem("electric vehicle")
    phase = problem.phase("drive", 1.0)
    x = phase.state("x", initial=0.0, final=10.0)
    v = phase.state("v", initial=0.0, final=0.0)
    u = phase.control("u")
    phase.derivative(x, v)
    phase.derivative(v, u - 1e-3 * v**2 - 0.1 - (3 + 0.4 * x - x**2 + 0.1 * x**3))
    phase.running_cost(1e3 * u * v + 1e3 * u**2)
    return problem


def planar_lander() -> OptimalControlProblem:
    """A lander with two thrusters from rest to rest 5 m to the side and up, in least time."""
    problem = OptimalControlProblem("planar lander")
    phase = problem.phase("fly", (0.1, 100.0))
    x = phase.state("x", initial=0.0, final=5.0)
    y = phase.state("y", initial=0.0, final=5.0)
    vx = phase.state("vx", initial=0.0, final=0.0)
    vy = phase.state("vy", initial=0.0, final=0.0)
    angle = phase.state("angle", initial=0.0)
    rate = phase.state("rate", initial=0.0)
    f1 = phase.control("f1", lower=0.0, upper=2 * 9.81)
    f2 = phase.control("f2", lower=0.0, upper=2 * 9.81)
    phase.derivative(x, vx)
    phase.derivative(y, vy)
    phase.derivative(vx, -ca.sin(angle) * (f1 + f2))
    phase.derivative(vy, ca.cos(angle) * (f1 + f2) - 9.81)
    phase.derivative(angle, rate)
    phase.derivative(rate, (f2 - f1) / 2 / 0.1)
    phase.end_cost(phase.duration)
    return problem


def quadrotor() -> OptimalControlProblem:
    """A quadrotor from rest to rest in least time; tilts are limited in size and rate."""
    problem = OptimalControlProblem("quadrotor")
    phase = problem.phase("fly", (0.1, 100.0))
    starts, ends = (0.0, 0.0, 2.5), (0.01, 5.0, 2.5)
    place = phase.state("place", 3, initial=np.array(starts), final=np.array(ends))
    velocity = phase.state("velocity", 3, initial=np.zeros(3), final=np.zeros(3))
    roll = phase.state("roll", initial=0.0, lower=-pi / 2, upper=pi / 2)
    pitch = phase.state("pitch", initial=0.0, lower=-pi / 2, upper=pi / 2)
    thrust = phase.control("thrust", lower=0.0, upper=9.18 * 5)
    roll_rate = phase.control("roll_rate", lower=-3.0, upper=3.0)
    pitch_rate = phase.control("pitch_rate", lower=-3.0, upper=3.0)
    phase.derivative(place, velocity)
    axis = ca.vertcat(ca.sin(pitch) * ca.cos(roll), -ca.sin(roll), ca.cos(pitch) * ca.cos(roll))
    phase.derivative(velocity, thrust * axis - ca.vertcat(0, 0, 9.81))
    phase.derivative(roll, roll_rate)
    phase.derivative(pitch, pitch_rate)
    phase.constraint("tilt", ca.cos(roll) * ca.cos(pitch), lower=np.cos(0.55))
    phase.end_cost(phase.duration)
    return problem


def double_tank() -> OptimalControlProblem:
    """The lower of two tanks is to follow a level; inflow from 1 to 2."""
    problem = OptimalControlProblem("double tank")
    phase = problem.phase("only", 10.0)
    upper = phase.state("upper", initial=2.0, lower=1e-6)
    lower = phase.state("lower", initial=2.0, lower=1e-6)
    flow = phase.control("flow", lower=1.0, upper=2.0)
    phase.derivative(upper, flow - ca.sqrt(upper))
    phase.derivative(lower, ca.sqrt(upper) - ca.sqrt(lower))
    phase.running_cost(2 * (lower - 3) ** 2)
    return problem


def egerstedt() -> OptimalControlProblem:
    """Three modes that are mixed, and a state that has to stay above 0.4."""
    problem = OptimalControlProblem("Egerstedt")
    phase = problem.phase("only", 1.0)
    x1 = phase.state("x1", initial=0.5)
    x2 = phase.state("x2", initial=0.5, lower=0.4)
    w = [phase.control(f"w{k}", lower=0.0, upper=1.0) for k in range(3)]
    phase.derivative(x1, -x1 * w[0] + (x1 + x2) * w[1] + (x1 - x2) * w[2])
    phase.derivative(x2, (x1 + 2 * x2) * w[0] + (x1 - 2 * x2) * w[1] + (x1 + x2) * w[2])
    phase.constraint("one", w[0] + w[1] + w[2], 1.0, 1.0)
    phase.running_cost(x1**2 + x2**2)
    return problem


def integrator_chain() -> OptimalControlProblem:
    """Nagurka's linear problem with ten states."""
    problem = OptimalControlProblem("Nagurka")
    count = 10
    phase = problem.phase("only", 1.0)
    x = phase.state("x", count, initial=np.arange(1.0, count + 1))
    u = phase.control("u", count)
    matrix = np.diag(np.ones(count - 1), 1)
    matrix[-1] = [(k + 1) * (-1) ** k for k in range(count)]
    phase.derivative(x, ca.DM(matrix) @ x + u)
    phase.running_cost(ca.sumsqr(x) + ca.sumsqr(u))
    phase.end_cost(10 * x[0] ** 2)
    return problem


def hull() -> OptimalControlProblem:
    """x' = u with costs of the effort and of the end."""
    problem = OptimalControlProblem("Hull")
    phase = problem.phase("only", 10.0)
    x = phase.state("x", initial=1.5)
    u = phase.control("u")
    phase.derivative(x, u)
    phase.running_cost(0.5 * u**2)
    phase.end_cost(2.5 * x**2)
    return problem


def newton() -> OptimalControlProblem:
    """Newton's body of least resistance, as high as wide: a flat front and a curve."""
    problem = OptimalControlProblem("Newton")
    phase = problem.phase("only", 1.0)
    height = phase.state("height", initial=1.0, final=0.0, lower=0.0, upper=1.0)
    slope = phase.control("slope", lower=-100.0, upper=0.0)
    phase.derivative(height, slope)
    phase.running_cost(8 * phase.time / (1 + slope**2))
    return problem


def hiv() -> OptimalControlProblem:
    """Chemotherapy of HIV: most healthy cells with little medicine in 50 days."""
    problem = OptimalControlProblem("HIV")
    phase = problem.phase("treat", 50.0)
    healthy = phase.state("healthy", initial=982.8, lower=0.0)
    latent = phase.state("latent", initial=0.05155, lower=0.0)
    active = phase.state("active", initial=6.175e-4, lower=0.0)
    virus = phase.state("virus", initial=0.07306, lower=0.0)
    u = phase.control("u", lower=0.0, upper=1.0)
    infected = 2.4e-5 * virus * healthy
    crowd = 1 - (healthy + latent + active) / 1500
    phase.derivative(
        healthy, 10 / (1 + virus) - 0.02 * healthy + 0.03 * healthy * crowd - infected * (1 - u)
    )
    phase.derivative(latent, infected * (1 - u) - 0.02 * latent - 3e-3 * latent)
    phase.derivative(active, 3e-3 * latent - 0.24 * active)
    phase.derivative(virus, 1200 * 0.24 * active - infected * (1 - u) - 2.4 * virus)
    phase.running_cost(-(healthy - 50 * (1 - u) ** 2))
    return problem


def periodic_cruise() -> OptimalControlProblem:
    """Speyer's model of cruising on and off: the cycle with the least cost a second."""
    problem = OptimalControlProblem("periodic cruise")
    phase = problem.phase("cycle", (2.0, 20.0))
    x, v = phase.state("x"), phase.state("v")
    u = phase.control("u")
    phase.derivative(x, v)
    phase.derivative(v, u)
    state = ca.vertcat(x, v)
    phase.end_constraint("closed", state - phase.initial(state), 0.0, 0.0)
    phase.point_constraint("phase", x, 0.0, 0.0, at=0.0)
    phase.running_cost((x**2 / 2 + v**4 / 4 - v**2 / 2 + 0.1 * u**2 / 2) / phase.duration)
    return problem


def _cruise_guess() -> dict[str, Guess]:
    values = {
        "x": along(lambda s: np.sin(2 * pi * s)),
        "v": along(lambda s: np.cos(2 * pi * s)),
        "u": along(lambda s: -np.sin(2 * pi * s)),
    }
    return {"cycle": Guess(2 * pi, values)}


def brachistochrone_of_given_length() -> OptimalControlProblem:
    """The fastest wire of 11 m between two points."""
    problem = OptimalControlProblem("wire of given length")
    phase = problem.phase("slide", (0.5, 10.0))
    x = phase.state("x", initial=0.0, final=10.0)
    y = phase.state("y", initial=10.0, final=5.0)
    v = phase.state("v", initial=0.0)
    theta = phase.control("theta", lower=radians(0.01), upper=radians(179.9))
    phase.derivative(x, v * ca.sin(theta))
    phase.derivative(y, -v * ca.cos(theta))
    phase.derivative(v, 9.80665 * ca.cos(theta))
    phase.integral("length", v, upper=11.9)
    phase.end_cost(phase.duration)
    return problem


PROBLEMS = (
    SuiteProblem(
        rayleigh_in_least_time,
        kind="bang-bang",
        source="Maurer and Augustin, in Online Optimization of Large Scale Systems (2001): 3.66817",
        published=3.66817,
        tolerance=1e-05,
        confirmed="fine mesh",
    ),
    SuiteProblem(
        race_car,
        kind="state constraint, order 1",
        source="CasADi examples and MAPTOR examples: race car, no figure",
        published=1.90468,
        tolerance=1e-05,
        confirmed="fine mesh",
    ),
    SuiteProblem(
        van_der_pol_with_limit,
        kind="state constraint",
        source="CasADi examples: direct collocation of Van der Pol, no figure",
        published=3.61518,
        tolerance=1e-05,
        confirmed="fine mesh",
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
        fishing_with_two_fleets,
        kind="bang-singular",
        source="PSOPT example lotka2, relaxed: 1.088024 (640 nodes)",
        published=1.088024,
        tolerance=2e-05,
        reference=1.08801,
        confirmed="fine mesh",
    ),
    SuiteProblem(
        wheat_trading,
        kind="bang-bang, state constraint",
        source="Norman, commodity trading; PSOPT example wheat: 1.738501 (coarse)",
        published=-1.738501,
        tolerance=0.01,
        reference=-1.75036,
        confirmed="fine mesh",
    ),
    SuiteProblem(
        limited_rate,
        kind="state constraint",
        source="PSOPT example control_rate: 1.846315",
        published=1.846315,
        tolerance=0.0001,
        reference=1.846154,
        confirmed="fine mesh",
    ),
    SuiteProblem(
        target_line,
        kind="smooth",
        source="Locatelli, Optimal Control (2001); PSOPT example mineng_target_set: 3/14",
        published=0.21428571428571427,
        tolerance=1e-05,
        confirmed="closed form",
    ),
    SuiteProblem(
        geodesic,
        kind="states tied by an equation, units",
        source="PSOPT example geodesic: 5549.682 km",
        published=5549.682,
        tolerance=1e-05,
        confirmed="fine mesh",
        guess=_geodesic_guess,
    ),
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
        underwater_vehicle,
        kind="bounds",
        source="Büskens and Maurer; Betts, Practical Methods (2010): 236.527851",
        published=236.527851,
        tolerance=0.005,
        reference=237.34997,
        confirmed="fine mesh",
    ),
    SuiteProblem(
        pendulum_of_index_1,
        kind="algebraic",
        source="Betts, Practical Methods (2010), example 10.103: 12.8738850",
        published=12.873885,
        tolerance=1e-05,
        confirmed="fine mesh",
    ),
    SuiteProblem(
        delays,
        kind="values of other ends",
        source="Göllmann, Kern, Maurer; Betts, Practical Methods (2010), 10.50: 3.10812211",
        published=3.10812211,
        tolerance=1e-05,
        confirmed="fine mesh",
    ),
    SuiteProblem(
        two_burns,
        kind="phases, units",
        source="Betts, Practical Methods (2010); PSOPT example twoburn: 0.2367249",
        published=-0.2367249,
        tolerance=1e-05,
        confirmed="published in two places",
        guess=_two_burns_guess,
    ),
    SuiteProblem(
        ducted_fan,
        kind="free time",
        source="Graichen and Petit (2009); OptimalControlProblems.jl, no figure",
        published=1909.30001,
        tolerance=1e-05,
        confirmed="fine mesh",
    ),
    SuiteProblem(
        double_oscillator,
        kind="smooth",
        source="Coudurier, Lepreux and Petit (2018); OptimalControlProblems.jl, no figure",
        published=0.000911034863,
        tolerance=1e-05,
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
        planar_lander,
        kind="bang-singular",
        source="OptimalControlProblems.jl: moonlander, no figure",
        published=0.9618,
        tolerance=1e-05,
        confirmed="fine mesh",
    ),
    SuiteProblem(
        quadrotor,
        kind="bang-bang, state constraint",
        source="OptimalControlProblems.jl: quadrotor, without its small weights",
        published=1.492136,
        tolerance=1e-05,
        confirmed="fine mesh",
    ),
    SuiteProblem(
        double_tank,
        kind="bang-singular",
        source="mintOC: double tank, relaxed",
        published=4.731306,
        tolerance=1e-05,
        confirmed="fine mesh",
    ),
    SuiteProblem(
        egerstedt,
        kind="mixed constraint",
        source="mintOC: Egerstedt, relaxed",
        published=0.989124,
        tolerance=1e-05,
        confirmed="fine mesh",
    ),
    SuiteProblem(
        integrator_chain,
        kind="linear",
        source="Nagurka (1990), ten states",
        published=501.41822,
        tolerance=1e-05,
        confirmed="fine mesh",
    ),
    SuiteProblem(
        hull,
        kind="smooth",
        source="Hull; dymos example hull_problem: closed form",
        published=0.1102941176,
        tolerance=1e-05,
        confirmed="closed form",
    ),
    SuiteProblem(
        newton,
        kind="closed form",
        source="Newton (1687), as high as its radius",
        published=1.4992639505,
        tolerance=1e-05,
        confirmed="closed form",
    ),
    SuiteProblem(
        hiv,
        kind="smooth, units",
        source="Kirschner, Lenhart and Serbin (1997)",
        published=-49117.1588,
        tolerance=1e-05,
        confirmed="fine mesh",
    ),
    SuiteProblem(
        periodic_cruise,
        kind="periodic",
        source="Speyer and Evans (1984)",
        published=-0.0232710643,
        tolerance=1e-05,
        confirmed="fine mesh",
        guess=_cruise_guess,
    ),
    SuiteProblem(
        brachistochrone_of_given_length,
        kind="integral constraint",
        source="dymos example length_constrained_brachistochrone, 11.9 m",
        published=1.80767971,
        tolerance=1e-05,
        confirmed="fine mesh",
    ),
)
