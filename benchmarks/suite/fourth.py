"""A fourth set whose first answers were counted before anything was mended on their account."""

from __future__ import annotations

from math import exp, pi, radians

import casadi as ca
import numpy as np
from scipy.optimize import root_scalar

from benchmarks.suite.problem import SuiteProblem, line
from microbot_ocp.ocp import Guess, OptimalControlProblem


def greenhouse() -> OptimalControlProblem:
    """Heating of a greenhouse over two days whose sun and outside temperature are known."""
    problem = OptimalControlProblem("greenhouse")
    phase = problem.phase("days", 48.0)
    crop = phase.state("crop", initial=0.0)
    temperature = phase.state("temperature", initial=10.0)
    spent = phase.state("spent", initial=0.0)
    heat = phase.control("heat", lower=0.0, upper=10.0)
    swing = ca.sin(4 * pi * phase.time / 48 - 0.65 * pi)
    phase.derivative(crop, 3e-6 / 40 * 800 * swing * temperature)
    phase.derivative(temperature, 15 + 10 * swing - temperature + 0.1 * heat)
    phase.derivative(spent, 7.5e-2 / 220 * heat)
    phase.end_cost(spent - 3e4 / 220 * crop)
    return problem


def food_sterilization() -> OptimalControlProblem:
    """A can is heated until enough germs are dead, and cooled, with the least loss of quality."""
    problem = OptimalControlProblem("sterilization")
    phase = problem.phase("heat", 1500.0)
    core = phase.state("core", initial=20.0)
    outside = phase.state("outside", initial=20.0)
    killed = phase.state("killed", initial=0.0)
    lost = phase.state("lost", initial=0.0)
    heat = phase.control("heat", lower=0.0, upper=50.0)
    phase.derivative(core, 0.01 * (outside - core))
    phase.derivative(outside, 0.005 * (20 - outside) + 0.01 * heat)
    phase.derivative(killed, ca.exp(np.log(10) / 10 * (core - 121.11)))
    phase.derivative(lost, ca.exp(np.log(10) / 25.56 * (core - 121.11)))
    phase.end_cost(lost + (killed - 100) ** 2 + (core - 40) ** 2)
    return problem


def metabolic_pathway() -> OptimalControlProblem:
    """Four enzymes of a chain of reactions are made one after the other to reach a steady flux."""
    rates, flux, decay = (1.0, 2.0, 4.0, 3.0), 0.2, 0.5
    ends = (5.0, 0.65, 0.32, 0.27)
    problem = OptimalControlProblem("metabolic pathway")
    phase = problem.phase("start", (0.1, 50.0))
    food = [ca.MX(5.0)]
    for k in (1, 2, 3):
        food.append(phase.state(f"s{k}", initial=0.0, final=ends[k], lower=0.0, upper=100.0))
    enzymes = [
        phase.state(f"e{k}", initial=0.0, final=flux * (1 + end) / (rate * end), lower=0.0, upper=1)
        for k, (rate, end) in enumerate(zip(rates, ends, strict=True))
    ]
    speeds = [r * s * e / (1 + s) for r, s, e in zip(rates, food, enzymes, strict=True)]
    for k in (1, 2, 3):
        phase.derivative(food[k], speeds[k - 1] - speeds[k])
    for k, enzyme in enumerate(enzymes):
        made = phase.control(f"u{k}", lower=0.0, upper=1.0)
        phase.derivative(enzyme, made - decay * enzyme)
    phase.running_cost(1 + ca.sum1(ca.vertcat(*enzymes)))
    return problem


def _pathway_guess() -> dict[str, Guess]:
    values = {"s1": 0.0, "s2": 0.0, "s3": 0.0, "u0": 1.0, "u1": 0.0, "u2": 0.0, "u3": 0.0}
    starts = {"e0": 0.0, "e1": -0.1, "e2": -0.5, "e3": -0.6}
    return {"start": Guess(2.0, {**values, **{k: line(s, s + 1) for k, s in starts.items()}})}


def grusin() -> OptimalControlProblem:
    """A shortest way in a plane where moving north costs the more the nearer to the axis."""
    problem = OptimalControlProblem("Grusin")
    phase = problem.phase("way", 1.0)
    x = phase.state("x", initial=0.0, final=-0.01)
    y = phase.state("y", initial=0.0, final=-1.0)
    u1, u2 = phase.control("u1"), phase.control("u2")
    phase.derivative(x, u1)
    phase.derivative(y, u2 * x)
    phase.running_cost(u1**2 + u2**2)
    return problem


def _grusin_optimum() -> float:
    """Of the geodesics x = a sin(b t), y' = b x^2, the one that arrives with b below 2 pi."""

    def off(b: float) -> float:
        return (0.01 / np.sin(b)) ** 2 * (b / 2 - np.sin(2 * b) / 4) - 1

    # The amplitude has the sign of x; past half a turn it is on the other side of the axis.
    best = np.inf
    grid = np.linspace(0.5, 2 * pi, 200001)[:-1]
    values = np.array([off(b) for b in grid])
    for k in np.flatnonzero(np.diff(np.sign(values)) != 0):
        b = root_scalar(off, bracket=(grid[k], grid[k + 1])).root
        if abs(off(b)) < 1e-6:
            best = min(best, (0.01 / np.sin(b)) ** 2 * b**2)
    return best


def largest_orbit() -> OptimalControlProblem:
    """The largest circular orbit that a rocket with constant thrust reaches in a given time."""
    problem = OptimalControlProblem("largest orbit", maximize=True)
    phase = problem.phase("burn", 1.0)
    r = phase.state("r", initial=1.0)
    radial = phase.state("radial", initial=0.0, final=0.0)
    around = phase.state("around", initial=np.sqrt(11.0))
    angle = phase.control("angle")
    push = 1.55 / (1 - 0.25 * phase.time)
    phase.derivative(r, radial)
    phase.derivative(radial, around**2 / r - 11 / r**2 + push * ca.sin(angle))
    phase.derivative(around, -radial * around / r + push * ca.cos(angle))
    phase.end_constraint("circle", around - ca.sqrt(11 / r), 0.0, 0.0)
    phase.end_cost(r)
    return problem


def plug_flow() -> OptimalControlProblem:
    """Most product of a tubular reactor whose temperature is limited."""
    problem = OptimalControlProblem("plug flow", maximize=True)
    phase = problem.phase("flow", 5.0)
    product = phase.state("product", initial=0.0, lower=0.0, upper=10.0)
    temperature = phase.state("temperature", initial=380.0, lower=100.0, upper=460.0, unit="K")
    cooling = phase.control("cooling", lower=0.0, upper=0.5)
    k1 = 1.7536e5 * ca.exp(-1.1374e4 / 1.9872 / temperature)
    k2 = 2.4885e10 * ca.exp(-2.2748e4 / 1.9872 / temperature)
    made = (1 - product) * k1 - product * k2
    phase.derivative(product, made)
    phase.derivative(temperature, 300 * made - cooling * (temperature - 290))
    phase.end_cost(product)
    return problem


def third_order() -> OptimalControlProblem:
    """A third-order system with drag and friction is brought to rest in least time."""
    problem = OptimalControlProblem("third order")
    phase = problem.phase("move", (0.1, 100.0))
    x1 = phase.state("x1", initial=0.0, final=2.0)
    x2 = phase.state("x2", initial=0.931, final=0.0)
    x3 = phase.state("x3", initial=0.9, final=0.0)
    u = phase.control("u", lower=-1.0, upper=1.0)
    phase.derivative(x1, x2)
    phase.derivative(x2, -x2 - 0.1 * x2**3 + x3)
    phase.derivative(x3, -2 * x3 - 0.2 * x3 / ca.sqrt(x3**2 + 1e-4) + 2 * u)
    phase.end_cost(phase.duration)
    return problem


def spaceship() -> OptimalControlProblem:
    """From one triangular point of two bodies to the other, time and effort weighed."""
    mu = 0.01
    problem = OptimalControlProblem("spaceship")
    phase = problem.phase("fly", (0.01, 5.0))
    x = phase.state("x", initial=0.5, final=0.5)
    y = phase.state("y", initial=-0.866, final=0.866)
    vx = phase.state("vx", initial=0.0, final=0.0)
    vy = phase.state("vy", initial=0.0, final=0.0)
    ux = phase.control("ux", lower=-2.0, upper=2.0)
    uy = phase.control("uy", lower=-1.0, upper=1.0)
    r1 = ca.sqrt((x + mu) ** 2 + y**2)
    r2 = ca.sqrt((x - 1 + mu) ** 2 + y**2)
    phase.derivative(x, vx)
    phase.derivative(y, vy)
    pull = (1 - mu) * (x + mu) / r1**3 + mu * (x - 1 + mu) / r2**3
    phase.derivative(vx, 2 * vy + x - pull + ux)
    phase.derivative(vy, -2 * vx + y - (1 - mu) * y / r1**3 - mu * y / r2**3 + uy)
    phase.running_cost(ux**2 + uy**2)
    phase.end_cost(phase.duration)
    return problem


def battery() -> OptimalControlProblem:
    """A battery is charged in least time within limits of current, voltage and polarisation."""
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


SEEN_AT = np.linspace(0.0, pi, 129)[1:]
SEEN = np.exp(SEEN_AT)[:, None] + np.sin(37.0 * np.arange(384) ** 1.5).reshape(128, 3)


def two_rates() -> OptimalControlProblem:
    """A fit of two parameters of a boundary-value problem with growth and decay of exp(19 t)."""
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
    y = phase.measurement("y", SEEN_AT, SEEN)
    phase.point_cost(ca.sumsqr(x - y))
    return problem


def _rates_guess() -> dict[str, Guess]:
    def grow(s: np.ndarray) -> np.ndarray:
        return np.repeat(1 + (exp(pi) - 1) * s[:, None], 3, axis=1)

    return {"only": Guess(pi, {"x": grow, "p1": 28.5, "p2": 1.5})}


def economic_growth() -> OptimalControlProblem:
    """Two sectors grow to the same level in least time by what is shared between them."""
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


def marchal() -> OptimalControlProblem:
    """Chattering into a singular arc at rest and out of it again."""
    problem = OptimalControlProblem("Marchal")
    phase = problem.phase("only", 8.0)
    x = phase.state("x", initial=2.0, final=2.0)
    y = phase.state("y", initial=-2.0, final=2.0)
    u = phase.control("u", lower=-1.0, upper=1.0)
    phase.derivative(x, y)
    phase.derivative(y, u)
    phase.running_cost(0.5 * x**2)
    return problem


def heated_shuttle() -> OptimalControlProblem:
    """Largest cross-range of the space shuttle, in degrees, with heating of 70 BTU/ft^2/s."""
    problem = OptimalControlProblem("heated shuttle")
    phase = problem.phase("descend", (100.0, 4000.0))
    h = phase.state("h", initial=260000.0, final=80000.0, lower=0.0, upper=300000.0, unit="ft")
    lat = phase.state("latitude", initial=0.0, lower=radians(-89), upper=radians(89))
    v = phase.state("v", initial=25600.0, final=2500.0, lower=1000.0, upper=40000.0, unit="ft/s")
    path = phase.state(
        "path", initial=radians(-1), final=radians(-5), lower=radians(-89), upper=radians(89)
    )
    azimuth = phase.state("azimuth", initial=pi / 2, lower=-pi, upper=pi)
    alpha = phase.control("alpha", lower=radians(-90), upper=radians(90))
    bank = phase.control("bank", lower=radians(-89), upper=radians(1))
    mass, radius = 203000 / 32.174, 20902900 + h
    density = 0.002378 * ca.exp(-h / 23800)
    pressure, attack = 0.5 * density * v**2 * 2690, alpha * 180 / pi
    lift = (-0.20704 + 0.029244 * attack) * pressure
    drag = (0.07854 - 6.1592e-3 * attack + 6.21408e-4 * attack**2) * pressure
    gravity = 0.14076539e17 / radius**2
    phase.derivative(h, v * ca.sin(path))
    phase.derivative(lat, v / radius * ca.cos(path) * ca.cos(azimuth))
    phase.derivative(v, -drag / mass - gravity * ca.sin(path))
    turning = ca.cos(path) * (v / radius - gravity / v)
    phase.derivative(path, lift * ca.cos(bank) / (mass * v) + turning)
    drift = v / radius * ca.cos(path) * ca.sin(azimuth) * ca.tan(lat)
    phase.derivative(azimuth, lift * ca.sin(bank) / (mass * v * ca.cos(path)) + drift)
    wing = 1.0672181 - 0.19213774e-1 * attack + 0.21286289e-3 * attack**2
    wing -= 0.10117249e-5 * attack**3
    heating = 17700 * ca.sqrt(density) * (0.0001 * v) ** 3.07 * wing
    phase.constraint("heating", heating, upper=70.0, unit="BTU/ft^2/s")
    phase.end_cost(-lat * 180 / pi)
    return problem


def _shuttle_guess() -> dict[str, Guess]:
    values = {
        "h": line(260000.0, 80000.0),
        "latitude": 0.0,
        "v": line(25600.0, 2500.0),
        "path": line(radians(-1), radians(-5)),
        "azimuth": pi / 2,
        "alpha": 0.0,
        "bank": 0.0,
    }
    return {"descend": Guess(2012.0, values)}


def van_der_pol_in_least_time() -> OptimalControlProblem:
    """The Van der Pol oscillator from (-0.4, 0.6) to (0.6, 0.4) in least time, |u| <= 1."""
    problem = OptimalControlProblem("Van der Pol in least time")
    phase = problem.phase("only", (0.1, 10.0))
    x1 = phase.state("x1", initial=-0.4, final=0.6)
    x2 = phase.state("x2", initial=0.6, final=0.4)
    u = phase.control("u", lower=-1.0, upper=1.0)
    phase.derivative(x1, x2)
    phase.derivative(x2, -x1 - (x1**2 - 1) * x2 + u)
    phase.end_cost(phase.duration)
    return problem


def hanging_chain() -> OptimalControlProblem:
    """The least potential energy of a chain of length 4 between heights of 1 and 3."""
    problem = OptimalControlProblem("hanging chain")
    phase = problem.phase("chain", 1.0)
    y = phase.state("y", initial=1.0, final=3.0)
    u = phase.control("u")
    phase.derivative(y, u)
    arc = ca.sqrt(1 + u**2)
    phase.integral("length", arc, 4.0, 4.0)
    phase.running_cost(y * arc)
    return problem


def _chain_optimum() -> float:
    """The catenary y = c cosh((x - m) / c) + d."""
    c = root_scalar(lambda c: 2 * c * np.sinh(0.5 / c) - np.sqrt(12.0), bracket=(0.05, 1.0)).root
    m = 0.5 - c * np.arctanh(2.0 / 4.0)
    d = 1 - c * np.cosh(-m / c)
    x = np.array([0.0, 1.0])
    lengths = c * np.sinh((x - m) / c)
    squares = 0.5 * c * x + c**2 / 4 * np.sinh(2 * (x - m) / c)
    return float(squares[1] - squares[0] + d * (lengths[1] - lengths[0]))


def zermelo_in_shear() -> OptimalControlProblem:
    """A boat in a current that grows with the distance from the bank, home in least time."""
    problem = OptimalControlProblem("Zermelo")
    phase = problem.phase("cross", (0.1, 100.0))
    x = phase.state("x", initial=3.66, final=0.0)
    y = phase.state("y", initial=-1.86, final=0.0)
    heading = phase.control("heading")
    phase.derivative(x, ca.cos(heading) - y)
    phase.derivative(y, ca.sin(heading))
    phase.end_cost(phase.duration)
    return problem


def limited_rocket() -> OptimalControlProblem:
    """Goddard's rocket in units of its own with a limit of speed: bang, singular, limit, off."""
    problem = OptimalControlProblem("Goddard", maximize=True)
    phase = problem.phase("ascent", (0.01, 10.0))
    r = phase.state("r", initial=1.0, lower=1.0)
    v = phase.state("v", initial=0.0, lower=0.0, upper=0.1)
    m = phase.state("m", initial=1.0, final=0.6, lower=0.6)
    u = phase.control("u", lower=0.0, upper=1.0)
    drag = 310 * v**2 * ca.exp(-500 * (r - 1))
    phase.derivative(r, v)
    phase.derivative(v, (3.5 * u - drag) / m - 1 / r**2)
    phase.derivative(m, -7 * u)
    phase.end_cost(r)
    return problem


def beam() -> OptimalControlProblem:
    """A beam under a limit of 0.1, as Bocop has it."""
    problem = OptimalControlProblem("beam")
    phase = problem.phase("only", 1.0)
    x1 = phase.state("x1", initial=0.0, final=0.0, lower=0.0, upper=0.1)
    x2 = phase.state("x2", initial=1.0, final=-1.0)
    u = phase.control("u", lower=-10.0, upper=10.0)
    phase.derivative(x1, x2)
    phase.derivative(x2, u)
    phase.running_cost(u**2)
    return problem


def cushioned_oscillation() -> OptimalControlProblem:
    """An oscillating mass is brought to rest by a limited force in least time."""
    problem = OptimalControlProblem("cushioned oscillation")
    phase = problem.phase("only", (0.1, 100.0))
    x = phase.state("x", initial=2.0, final=0.0)
    v = phase.state("v", initial=5.0, final=0.0)
    u = phase.control("u", lower=-5.0, upper=5.0)
    phase.derivative(x, v)
    phase.derivative(v, (u - 10 * x) / 5)
    phase.end_cost(phase.duration)
    return problem


def _air(v: ca.MX, alpha: ca.MX, h: ca.MX | float = 0.0) -> tuple[ca.MX, ca.MX]:
    """Lift and drag of the aircraft on or above the ground, N."""
    part = 33 * ((h + 1.0) / 17.85) ** 1.5
    factor = part / (1 + part) / (pi * 9.45 * 0.801)
    lift = 0.5 + alpha / radians(10) * 1.5
    pressure = 0.5 * 1.225 * v**2 * 124.7
    return pressure * lift, pressure * (0.03 + factor * lift**2)


def balanced_field() -> OptimalControlProblem:
    """The shortest runway on which a take-off with a failed engine can be finished or rejected."""
    mass, thrust, g = 174200 * 0.45359237, 27000 * 4.4482216152605, 9.80665
    stall = float(np.sqrt(2 * mass * g / 1.225 / 124.7 / 2.0))
    problem = OptimalControlProblem("balanced field")
    data = (
        ("roll", 2 * thrust, 0.03),
        ("reject", 0.0, 0.3),
        ("go on", thrust, 0.03),
        ("rotate", thrust, 0.03),
        ("climb", thrust, 0.0),
    )
    phases, places = {}, {}
    for name, push, friction in data:
        first, climbs = name == "roll", name == "climb"
        branch = name in ("reject", "go on")
        ends = [phases["roll"].final(k) for k in places["roll"]] if branch else [None, None]
        phase = problem.phase(name, (1.0, 5.0 if name == "rotate" else 1000.0))
        r = phase.state("r", initial=0.0 if first else ends[0], lower=0.0, unit="m")
        v = phase.state(
            "v",
            initial=0.0 if first else ends[1],
            final=0.0 if name == "reject" else None,
            lower=0.0,
            unit="m/s",
        )
        phases[name], places[name] = phase, (r, v)
        alpha = ca.MX(0.0)
        if name == "rotate":
            alpha = phase.state("alpha", initial=0.0, lower=0.0, upper=radians(10))
            rate = problem.free_parameter("rate", lower=0.0, upper=radians(10))
            phase.derivative(alpha, rate)
        if climbs:
            alpha = phase.control("alpha", lower=radians(-10), upper=radians(15), shape="linear")
            h = phase.state("h", initial=0.0, final=35 * 0.3048, lower=0.0, unit="m")
            slope = phase.state("slope", initial=0.0, final=radians(5), lower=0.0, upper=radians(5))
            lift, drag = _air(v, alpha, h)
            phase.derivative(h, v * ca.sin(slope))
            phase.derivative(r, v * ca.cos(slope))
            phase.derivative(v, (push * ca.cos(alpha) - drag) / mass - g * ca.sin(slope))
            turned = (push * ca.sin(alpha) + lift) / (mass * v) - g / v * ca.cos(slope)
            phase.derivative(slope, turned)
            phase.end_constraint("fast enough", v, lower=1.25 * stall)
            continue
        lift, drag = _air(v, alpha)
        weight = mass * g - lift * ca.cos(alpha) - push * ca.sin(alpha)
        phase.derivative(r, v)
        phase.derivative(v, (push * ca.cos(alpha) - drag - friction * weight) / mass)
        if name == "go on":
            phase.end_constraint("fast enough", v, lower=1.2 * stall)
        if name == "rotate":
            phase.end_constraint("lifted", weight, 0.0, 0.0)
    problem.link(phases["roll"], phases["reject"], ())
    problem.link(phases["reject"], phases["go on"], ())
    problem.link(phases["go on"], phases["rotate"], ("r", "v"))
    problem.link(phases["rotate"], phases["climb"], ("r", "v", "alpha"))
    stopped = phases["reject"].final(places["reject"][0])
    problem.constraint("balance", phases["climb"].final(places["climb"][0]) - stopped, 0.0, 0.0)
    problem.cost(stopped)
    return problem


def _field_guess() -> dict[str, Guess]:
    return {
        "roll": Guess(35.0, {"r": line(0.0, 2500.0), "v": line(0.0, 100.0)}),
        "reject": Guess(35.0, {"r": line(2500.0, 5000.0), "v": line(110.0, 0.0)}),
        "go on": Guess(2.0, {"r": line(2500.0, 2600.0), "v": line(100.0, 110.0)}),
        "rotate": Guess(5.0, {"r": line(2600.0, 2700.0), "v": line(110.0, 115.0)}),
        "climb": Guess(
            15.0,
            {
                "r": line(2700.0, 3500.0),
                "v": line(115.0, 120.0),
                "h": line(0.0, 35 * 0.3048),
                "slope": line(0.0, radians(5)),
                "alpha": radians(5),
            },
        ),
    }


PROPT, ICLOCS, OPTI = "PROPT", "ICLOCS2", "Opti on 300 intervals"
PROBLEMS = (
    SuiteProblem(greenhouse, "bang-bang", PROPT, 1.87099, 1e-5, OPTI, sign=-1.0),
    SuiteProblem(
        food_sterilization,
        "bang-bang, local optima, units",
        PROPT,
        273.629625,
        1e-6,
        "two switches and another integrator",
    ),
    SuiteProblem(metabolic_pathway, "bang-bang", PROPT, 6.0852, 1e-5, OPTI, guess=_pathway_guess),
    SuiteProblem(
        grusin, "local optima", PROPT, 6.333416559, 2e-2, "closed form", _grusin_optimum()
    ),
    SuiteProblem(largest_orbit, "smooth", "Bryson and Ho", 1.52602, 1e-5, OPTI, sign=-1.0),
    SuiteProblem(plug_flow, "bang-singular, units", "Luus", 0.677289, 1e-5, OPTI, sign=-1.0),
    SuiteProblem(third_order, "bang-bang, stiff", PROPT, 2.94565, 1e-5, OPTI),
    SuiteProblem(spaceship, "free time", ICLOCS, 3.457997, 1e-6, OPTI),
    SuiteProblem(battery, "state constraint, units", ICLOCS, 434.627, 1e-5, OPTI),
    SuiteProblem(
        two_rates,
        "parameters, data, unstable",
        "PSOPT, with other data",
        194.266885,
        1e-8,
        OPTI,
        guess=_rates_guess,
    ),
    SuiteProblem(economic_growth, "bang-bang", "PINS", 1.1465736, 1e-7, OPTI),
    SuiteProblem(marchal, "chattering, singular", "Marchal 1973", 1.51523, 2e-5, OPTI),
    SuiteProblem(
        heated_shuttle,
        "state constraint, units",
        "Betts 2010, section 6.1",
        30.62551,
        2e-6,
        OPTI,
        sign=-1.0,
        guess=_shuttle_guess,
    ),
    SuiteProblem(
        van_der_pol_in_least_time, "bang-bang", "Kaya and Noakes 2003", 1.2540747, 1e-6, OPTI
    ),
    SuiteProblem(
        hanging_chain,
        "integral constraint",
        "COPS 3.0",
        5.06891,
        1e-4,
        "closed form",
        _chain_optimum(),
    ),
    SuiteProblem(
        zermelo_in_shear,
        "smooth",
        "Bryson and Ho 1975, section 2.7",
        5.46,
        1e-3,
        "shooting on the formula of the heading",
        5.45786526,
    ),
    SuiteProblem(
        limited_rocket,
        "bang-singular, state constraint",
        "CTDirect",
        1.01257,
        1e-5,
        OPTI,
        1.0125778,
        sign=-1.0,
    ),
    SuiteProblem(beam, "state constraint, order 2", "Bocop", 80 / 9, 1e-9, "closed form"),
    SuiteProblem(
        cushioned_oscillation,
        "bang-bang",
        "mintOC",
        8.99177,
        1e-6,
        "closed form: circles in the phase plane",
        8.9917704583,
    ),
    SuiteProblem(
        balanced_field,
        "phases, parameters, units",
        "dymos",
        2197.0,
        1e-2,
        "Opti on 50 intervals a phase",
        2196.69612,
        guess=_field_guess,
    ),
)
