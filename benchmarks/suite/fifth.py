"""A fifth set whose first answers were counted before anything was mended on their account."""

from __future__ import annotations

from math import cos, pi, radians, tan

import casadi as ca
import numpy as np
from scipy.optimize import root_scalar

from benchmarks.suite.problem import SuiteProblem
from microbot_ocp.ocp import OptimalControlProblem


def satellite() -> OptimalControlProblem:
    """A tumbling satellite is turned and stopped with the least effort."""
    problem = OptimalControlProblem("satellite")
    phase = problem.phase("turn", 100.0)
    starts, ends = (0.0, 0.0, 0.0, 1.0), (0.70106, 0.0923, 0.56098, None)
    e1, e2, e3, e4 = (phase.state(f"e{k + 1}", initial=starts[k], final=ends[k]) for k in range(4))
    w1, w2, w3 = (
        phase.state(f"w{k + 1}", initial=rate, final=0.0)
        for k, rate in enumerate((0.01, 0.005, 0.001))
    )
    t1, t2, t3 = (phase.control(f"torque {k + 1}") for k in range(3))
    phase.derivative(e1, 0.5 * (w1 * e4 - w2 * e3 + w3 * e2))
    phase.derivative(e2, 0.5 * (w1 * e3 + w2 * e4 - w3 * e1))
    phase.derivative(e3, 0.5 * (-w1 * e2 + w2 * e1 + w3 * e4))
    phase.derivative(e4, -0.5 * (w1 * e1 + w2 * e2 + w3 * e3))
    i1, i2, i3 = 1.0e6, 833333.0, 916667.0
    phase.derivative(w1, ((i2 - i3) * w2 * w3 + 550 * t1) / i1)
    phase.derivative(w2, ((i3 - i1) * w3 * w1 + 50 * t2) / i2)
    phase.derivative(w3, ((i1 - i2) * w1 * w2 + 550 * t3) / i3)
    phase.running_cost(0.5 * (t1**2 + t2**2 + t3**2))
    return problem


def geostationary_transfer() -> OptimalControlProblem:
    """From an eccentric orbit to the geostationary one in least time, in km and h."""
    mu, acceleration, radius = 5.1658620912e12, 60.0 * 3.6**2 * 1e3 / 1500.0, 42165.0
    problem = OptimalControlProblem("geostationary transfer")
    phase = problem.phase("transfer", (1.0, 50.0))
    x = phase.state("x", initial=-42272.67, unit="km")
    y = phase.state("y", initial=0.0, unit="km")
    vx = phase.state("vx", initial=0.0, unit="km/h")
    vy = phase.state("vy", initial=-5796.72, unit="km/h")
    ux, uy = phase.control("ux"), phase.control("uy")
    distance = ca.sqrt(x**2 + y**2)
    phase.derivative(x, vx)
    phase.derivative(y, vy)
    phase.derivative(vx, -mu * x / distance**3 + acceleration * ux)
    phase.derivative(vy, -mu * y / distance**3 + acceleration * uy)
    phase.constraint("thrust", ux**2 + uy**2, upper=1.0)
    phase.end_constraint("radius", distance, radius, radius, unit="km")
    speed = np.sqrt(mu / radius)
    phase.end_constraint("around x", vx + speed * y / radius, 0.0, 0.0, unit="km/h")
    phase.end_constraint("around y", vy - speed * x / radius, 0.0, 0.0, unit="km/h")
    phase.end_cost(phase.duration)
    return problem


def hovering_car() -> OptimalControlProblem:
    """The first example of ACADO: from rest to rest by a thrust whose square burns the mass."""
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


def apollo() -> OptimalControlProblem:
    """Reentry of an Apollo capsule with the least heating, in 1e5 feet."""
    radius, scale, surface, area, gravity = 209.0, 4.26, 2.704e-3, 53200.0, 3.2172e-4
    problem = OptimalControlProblem("Apollo")
    phase = problem.phase("reentry", (10.0, 1000.0))
    v = phase.state("v", initial=0.36, final=0.27)
    path = phase.state("path", initial=radians(-8.1), final=0.0)
    height = phase.state("height", initial=4 / radius, final=2.5 / radius)
    u = phase.control("u")
    density = surface * ca.exp(-scale * radius * height)
    drag, lift = 1.174 - 0.9 * ca.cos(u), 0.6 * ca.sin(u)
    phase.derivative(
        v, -0.5 * area * density * v**2 * drag - gravity * ca.sin(path) / (1 + height) ** 2
    )
    turning = v * ca.cos(path) / (radius * (1 + height))
    turning -= gravity * ca.cos(path) / (v * (1 + height) ** 2)
    phase.derivative(path, 0.5 * area * density * v * lift + turning)
    phase.derivative(height, v * ca.sin(path) / radius)
    phase.running_cost(10 * v**3 * ca.sqrt(density))
    return problem


def mars_landing() -> OptimalControlProblem:
    """Powered descent on Mars with the least fuel; engines cannot be turned down below 30 %."""
    cant, gravity = radians(27), 3.7114
    most = 6 * 3100.0 * cos(cant)
    problem = OptimalControlProblem("Mars landing")
    phase = problem.phase("descent", (10.0, 200.0))
    h = phase.state("h", initial=1500.0, final=0.0, lower=0.0, unit="m")
    x = phase.state("x", initial=2000.0, final=0.0, unit="m")
    vh = phase.state("vh", initial=-75.0, final=0.0, unit="m/s")
    vx = phase.state("vx", initial=100.0, final=0.0, unit="m/s")
    m = phase.state("m", initial=1905.0, lower=1505.0, unit="kg")
    up = phase.control("up", unit="N")
    along = phase.control("along", unit="N")
    thrust = ca.sqrt(up**2 + along**2)
    phase.derivative(h, vh)
    phase.derivative(x, vx)
    phase.derivative(vh, up / m - gravity)
    phase.derivative(vx, along / m)
    phase.derivative(m, -thrust / (225 * 9.807 * cos(cant)))
    phase.constraint("thrust", thrust, 0.3 * most, 0.8 * most, unit="N")
    phase.constraint("slope right", h - tan(radians(4)) * x, lower=0.0, unit="m")
    phase.constraint("slope left", h + tan(radians(4)) * x, lower=0.0, unit="m")
    phase.end_cost(1905 - m)
    return problem


def crystalliser() -> OptimalControlProblem:
    """Seeds of potassium sulphate grow by cooling, with the least volume of new crystals."""
    problem = OptimalControlProblem("crystalliser")
    phase = problem.phase("batch", 1800.0)
    new = [phase.state(f"new {k}", initial=0.0) for k in range(4)]
    seeds = 66.6667
    starts = (seeds * 275.0, seeds * 75750.0, seeds * 20968750.0)
    grown = [phase.state(f"grown {k + 1}", initial=start) for k, start in enumerate(starts)]
    dissolved = phase.state("dissolved", initial=0.1742)
    temperature = phase.state("temperature", initial=50.0, lower=30.0, upper=50.0, unit="C")
    cooling = phase.control("cooling", lower=0.0, upper=0.05, unit="K/s")
    soluble = 6.29e-2 + 2.46e-3 * temperature - 7.14e-6 * temperature**2
    metastable = 7.76e-2 + 2.46e-3 * temperature - 8.10e-6 * temperature**2
    above = ((dissolved - soluble) / soluble) ** 2 + 1e-8
    kelvin = temperature + 273.15
    growth = 1.44e8 * ca.exp(-4859 / kelvin) * above**0.75
    birth = 285.0 * ca.exp(-7517 / kelvin) * above**0.725 * (new[3] + grown[2])
    phase.derivative(new[0], birth)
    for k in (1, 2, 3):
        phase.derivative(new[k], k * growth * new[k - 1])
    phase.derivative(grown[0], growth * seeds)
    phase.derivative(grown[1], 2 * growth * grown[0])
    phase.derivative(grown[2], 3 * growth * grown[1])
    phase.derivative(dissolved, -3 * 2.66e-12 * 1.5 * growth * (new[2] + grown[1]))
    phase.derivative(temperature, -cooling)
    phase.constraint("not dissolving", dissolved - soluble, lower=0.0)
    phase.constraint("metastable", metastable - dissolved, lower=0.0)
    phase.end_constraint("large enough", grown[2], lower=8.3301e9)
    phase.end_cost(new[3])
    return problem


def hicks_ray() -> OptimalControlProblem:
    """A stirred tank is brought to a steady state that is unstable."""
    problem = OptimalControlProblem("Hicks and Ray")
    phase = problem.phase("change", 120.0)
    c = phase.state("c", initial=0.98, final=0.2632, lower=0.0, upper=1.0)
    temperature = phase.state("temperature", initial=0.39, final=0.6519, lower=0.0, upper=1.0)
    u = phase.control("u", lower=0.0, upper=2.0)
    reaction = 300 * c * ca.exp(-5 / temperature)
    phase.derivative(c, (1 - c) / 20 - reaction)
    phase.derivative(
        temperature,
        (0.3947 - temperature) / 20 + reaction - 600 * 1.95e-4 * u * (temperature - 0.38158),
    )
    phase.running_cost((c - 0.2632) ** 2 + (temperature - 0.6519) ** 2 + (u - 0.76) ** 2)
    return problem


def immune_response() -> OptimalControlProblem:
    """Four treatments of an infection that would be lethal without them."""
    problem = OptimalControlProblem("immune response")
    phase = problem.phase("cure", 10.0)
    pathogen = phase.state("pathogen", initial=3.0, lower=0.0)
    plasma = phase.state("plasma", initial=2.0)
    antibody = phase.state("antibody", initial=4 / 3)
    damage = phase.state("damage", initial=0.0, lower=0.0)
    u1, u2, u3, u4 = (phase.control(f"u{k}", lower=0.0) for k in (1, 2, 3, 4))
    able = ca.if_else(damage < 0.5, ca.cos(pi * damage), 0.0)
    phase.derivative(pathogen, (1 - antibody) * pathogen - u1)
    phase.derivative(plasma, 3 * able * pathogen * antibody - (plasma - 2) + u2)
    phase.derivative(antibody, plasma - (1.5 + 0.5 * pathogen) * antibody + u3)
    phase.derivative(damage, 0.5 * pathogen - damage - u4)
    phase.running_cost(0.5 * (pathogen**2 + damage**2 + u1**2 + u2**2 + u3**2 + u4**2))
    phase.end_cost(0.5 * (pathogen**2 + damage**2))
    return problem


SHARE, DECAY, IMPATIENCE = 0.3, 0.05, 0.03
EATEN = (IMPATIENCE + (1 - SHARE) * DECAY) / SHARE  # share of the capital that is consumed, 1/a


def _value_of_capital(k: ca.MX | float) -> ca.MX | float:
    return EATEN**-SHARE * (k ** (1 - SHARE) / (1 - SHARE) + 1 / IMPATIENCE)


def ramsey() -> OptimalControlProblem:
    """Growth over an infinite horizon as a finite one, s = 1 - exp(-rho t), with what is left."""
    problem = OptimalControlProblem("Ramsey", maximize=True)
    phase = problem.phase("growth", 0.99)
    k = phase.state("k", initial=1.0, lower=0.01)
    c = phase.control("c", lower=0.01)
    left = 1 - phase.time
    phase.derivative(k, (k**SHARE - DECAY * k - c) / (IMPATIENCE * left))
    phase.running_cost(c ** (1 - SHARE) / (1 - SHARE) / IMPATIENCE)
    phase.end_cost(left * _value_of_capital(k))
    return problem


def nitric_oxide() -> OptimalControlProblem:
    """Two rates of a reversible reaction from fourteen measurements."""
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


def _target(t: ca.MX | float) -> ca.MX | float:
    return 5 + 2 * ca.sin(t) + ca.cos(2.2 * t)


def _target_speed(t: ca.MX | float) -> ca.MX | float:
    return 2 * ca.cos(t) - 2.2 * ca.sin(2.2 * t)


def departure() -> OptimalControlProblem:
    """When to leave for a moving target, which is met 2 s later with the least effort."""
    problem = OptimalControlProblem("departure")
    phase = problem.phase("meet", 2.0, start=(0.0, 20.0))
    x, v = phase.state("x", initial=0.0), phase.state("v", initial=0.0)
    u = phase.control("u")
    phase.derivative(x, v)
    phase.derivative(v, u)
    phase.running_cost(u**2)
    end = phase.start + 2.0
    phase.end_constraint("place", x - _target(end), 0.0, 0.0)
    phase.end_constraint("speed", v - _target_speed(end), 0.0, 0.0)
    return problem


def _departure_optimum() -> float:
    """Of all departures, the least of the closed form."""

    def effort(t: float) -> float:
        d, v, duration = float(_target(t + 2)), float(_target_speed(t + 2)), 2.0
        return 12 * d**2 / duration**3 - 12 * d * v / duration**2 + 4 * v**2 / duration

    best, width = 10.0, 10.0
    for _ in range(6):
        grid = np.clip(best + width * np.linspace(-1.0, 1.0, 2001), 0.0, 20.0)
        best, width = grid[np.argmin([effort(t) for t in grid])], width / 100
    return effort(best)


def bouncing_ball() -> OptimalControlProblem:
    """A ball that loses speed at every bounce is brought back to its height by the least thrust."""
    problem = OptimalControlProblem("bouncing ball")
    before = None
    for k in range(3):
        phase = problem.phase(f"flight {k}", (0.05, 3.0))
        last = k == 2
        first = before is None
        h = phase.state("h", initial=1.0 if first else 0.0, final=1.0 if last else 0.0, lower=0.0)
        v = phase.state(
            "v",
            initial=0.0 if before is None else -0.8 * before[0].final(before[1]),
            final=0.0 if last else None,
        )
        u = phase.control("u")
        phase.derivative(h, v)
        phase.derivative(v, u - 9.81)
        phase.running_cost(u**2)
        if before is not None:
            problem.link(before[0], phase, ())
        before = phase, v
    return problem


def hanging_load() -> OptimalControlProblem:
    """A cart moves a hanging load from rest to rest; the force of the rope is algebraic."""
    problem = OptimalControlProblem("hanging load")
    phase = problem.phase("move", 2.5)
    x = phase.state("x", initial=0.0, final=2.0)
    v = phase.state("v", initial=0.0, final=0.0)
    place = phase.state("place", 2, initial=[0.0, -1.0], final=[2.0, -1.0])
    speed = phase.state("speed", 2, initial=[0.0, 0.0], final=[0.0, 0.0])
    rope = phase.algebraic("rope")
    u = phase.control("u")
    arm = place - ca.vertcat(x, 0)
    arm_rate = speed - ca.vertcat(v, 0)
    pull = rope * arm
    slope = (u + pull[0]) / 1.0
    load = ca.vertcat(0, -9.81) - pull / 0.5
    phase.derivative(x, v)
    phase.derivative(v, slope)
    phase.derivative(place, speed)
    phase.derivative(speed, load)
    phase.algebraic_equation(ca.dot(arm, load - ca.vertcat(slope, 0)) + ca.sumsqr(arm_rate))
    phase.running_cost(u**2)
    return problem


def intercept() -> OptimalControlProblem:
    """A target that flies straight on is hit in least time by an acceleration of 0.5."""
    problem = OptimalControlProblem("intercept")
    phase = problem.phase("chase", (0.1, 100.0))
    place = phase.state("place", 2, initial=[0.0, 0.0])
    speed = phase.state("speed", 2, initial=[0.0, 0.0])
    u = phase.control("u", 2)
    phase.derivative(place, speed)
    phase.derivative(speed, u)
    phase.constraint("acceleration", ca.sumsqr(u), upper=0.25)
    t = phase.duration
    phase.end_constraint("hit", place - ca.vertcat(10 - t, 5 + 1.5 * t), 0.0, 0.0)
    phase.end_cost(t)
    return problem


def _intercept_optimum() -> float:
    return root_scalar(
        lambda t: np.hypot(10 - t, 5 + 1.5 * t) - 0.25 * t**2, bracket=(0.1, 100.0)
    ).root


def experiment() -> OptimalControlProblem:
    """A feed that tells most about two parameters of growth."""
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


def sideways() -> OptimalControlProblem:
    """A car that turns on a radius of 1 at least is parked 1 sideways, forwards and backwards."""
    problem = OptimalControlProblem("sideways")
    phase = problem.phase("park", (0.1, 20.0))
    x = phase.state("x", initial=0.0, final=0.0)
    y = phase.state("y", initial=0.0, final=1.0)
    heading = phase.state("heading", initial=0.0, final=0.0)
    v = phase.control("v", lower=-1.0, upper=1.0)
    bend = phase.control("bend", lower=-1.0, upper=1.0)
    phase.derivative(x, v * ca.cos(heading))
    phase.derivative(y, v * ca.sin(heading))
    phase.derivative(heading, v * bend)
    phase.end_cost(phase.duration)
    return problem


def weak_swing_up() -> OptimalControlProblem:
    """A pendulum is swung up in least time by a torque of 0.3 of its weight."""
    problem = OptimalControlProblem("weak swing-up")
    phase = problem.phase("swing", (0.1, 50.0))
    q = phase.state("q", initial=0.0, final=pi)
    w = phase.state("w", initial=0.0, final=0.0)
    u = phase.control("u", lower=-0.3, upper=0.3)
    phase.derivative(q, w)
    phase.derivative(w, u - ca.sin(q))
    phase.end_cost(phase.duration)
    return problem


FORCE, RESISTANCE, BREATH, STORE = 12.2, 0.892, 41.61, 2409.0  # of a runner, in SI units for 1 kg


def middle_distance() -> OptimalControlProblem:
    """1500 m in least time by a runner whose store of energy is limited."""
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


def lift() -> OptimalControlProblem:
    """A lift goes 10 m in least time within limits of speed, acceleration and jerk."""
    problem = OptimalControlProblem("lift")
    phase = problem.phase("ride", (0.1, 100.0))
    x = phase.state("x", initial=0.0, final=10.0, unit="m")
    v = phase.state("v", initial=0.0, final=0.0, lower=-2.0, upper=2.0, unit="m/s")
    a = phase.state("a", initial=0.0, final=0.0, lower=-1.0, upper=1.0, unit="m/s^2")
    jerk = phase.control("jerk", lower=-1.0, upper=1.0, unit="m/s^3")
    phase.derivative(x, v)
    phase.derivative(v, a)
    phase.derivative(a, jerk)
    phase.end_cost(phase.duration)
    return problem


def cannonball() -> OptimalControlProblem:
    """The size and the elevation of an iron ball that flies farthest with 400 kJ."""
    problem = OptimalControlProblem("cannonball", maximize=True)
    radius = problem.free_parameter("radius", lower=0.01, upper=0.1, unit="m")
    mass = 4 / 3 * pi * radius**3 * 7870
    phases = []
    for name in ("rise", "fall"):
        phase = problem.phase(name, (1.0, 100.0))
        rises = name == "rise"
        r = phase.state("r", initial=0.0 if rises else None, lower=0.0, unit="m")
        h = phase.state(
            "h", initial=0.0 if rises else None, final=None if rises else 0.0, lower=0.0, unit="m"
        )
        v = phase.state("v", lower=10.0, unit="m/s")
        path = phase.state(
            "path", lower=radians(-89), upper=radians(89), final=0.0 if rises else None
        )
        drag = 0.5 * 1.225 * ca.exp(-h / 8500) * v**2 * 0.5 * pi * radius**2
        phase.derivative(r, v * ca.cos(path))
        phase.derivative(h, v * ca.sin(path))
        phase.derivative(v, -drag / mass - 9.80665 * ca.sin(path))
        phase.derivative(path, -9.80665 * ca.cos(path) / v)
        if rises:
            phase.point_constraint("energy", 0.5 * mass * v**2, upper=4e5, at=0.0, unit="J")
        phases.append(phase)
    problem.link(*phases)
    phases[1].end_cost(r)
    return problem


ORBIT, PUSH = 0.00113, 0.005  # mean motion, 1/s, and acceleration along every axis, m/s^2


def rendezvous() -> OptimalControlProblem:
    """Six thrusters bring a spacecraft to another one in half an hour with the least fuel."""
    problem = OptimalControlProblem("rendezvous")
    phase = problem.phase("approach", 1800.0)
    place = phase.state("place", 3, initial=[-500.0, 800.0, 100.0], final=[0, 0, 0], unit="m")
    speed = phase.state("speed", 3, initial=[0.5, -0.2, 0.1], final=[0, 0, 0], unit="m/s")
    ahead = phase.control("ahead", 3, lower=0.0, upper=PUSH, unit="m/s^2")
    back = phase.control("back", 3, lower=0.0, upper=PUSH, unit="m/s^2")
    x, _, z = ca.vertsplit(place)
    vx, vy, _ = ca.vertsplit(speed)
    drift = ca.vertcat(3 * ORBIT**2 * x + 2 * ORBIT * vy, -2 * ORBIT * vx, -(ORBIT**2) * z)
    phase.derivative(place, speed)
    phase.derivative(speed, drift + ahead - back)
    phase.running_cost(ca.sum1(ahead + back))
    return problem


def eight_masses() -> OptimalControlProblem:
    """Eight masses on hardening springs are calmed by a force on the last."""
    problem = OptimalControlProblem("eight masses")
    phase = problem.phase("calm", 12.0)
    x = phase.state("x", 8, initial=np.linspace(0.25, 2.0, 8))
    v = phase.state("v", 8, initial=np.zeros(8))
    u = phase.control("u", lower=-1.0, upper=1.0)
    stretch = x - ca.vertcat(0, x[:-1])
    force = stretch + stretch**3
    phase.derivative(x, v)
    phase.derivative(v, ca.vertcat(force[1:], u) - force)
    phase.running_cost(ca.sumsqr(x) + ca.sumsqr(v) + 0.1 * u**2)
    return problem


def vaccination() -> OptimalControlProblem:
    """Vaccination against a disease with a limit of how many are vaccinated in a year."""
    problem = OptimalControlProblem("vaccination")
    phase = problem.phase("years", 20.0)
    susceptible = phase.state("susceptible", initial=1000.0, lower=0.0)
    exposed = phase.state("exposed", initial=100.0, lower=0.0)
    ill = phase.state("ill", initial=50.0, lower=0.0)
    people = phase.state("people", initial=1165.0, lower=0.0)
    u = phase.control("u", lower=0.0, upper=1.0)
    caught = 0.001 * susceptible * ill
    phase.derivative(susceptible, 0.525 * people - 0.5 * susceptible - caught - u * susceptible)
    phase.derivative(exposed, caught - (0.5 + 0.5) * exposed)
    phase.derivative(ill, 0.5 * exposed - (0.1 + 0.2 + 0.5) * ill)
    phase.derivative(people, (0.525 - 0.5) * people - 0.2 * ill)
    phase.constraint("doses", u * susceptible, upper=125.0)
    phase.running_cost(ill + 10 * u)
    return problem


def lap() -> OptimalControlProblem:
    """A lap of a track of 300 m in least time, by the way along it, within a circle of friction."""
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


ROOF = 0.25


def touching() -> OptimalControlProblem:
    """A limit of order three is touched once by a motion of the least jerk."""
    problem = OptimalControlProblem("touching")
    phase = problem.phase("only", 1.0)
    x = phase.state("x", initial=0.0, final=0.0, upper=ROOF)
    v = phase.state("v", initial=1.0, final=-1.0)
    a = phase.state("a", initial=2.0, final=2.0)
    u = phase.control("u")
    phase.derivative(x, v)
    phase.derivative(v, a)
    phase.derivative(a, u)
    phase.running_cost(0.5 * u**2)
    return problem


OPTI, SOURCELESS = "Opti on 300 intervals", "no figure"
PROBLEMS = (
    SuiteProblem(satellite, "smooth, units", "PROPT, 7b: no figure at hand", 71.411096, 1e-7, OPTI),
    SuiteProblem(
        geostationary_transfer,
        "mixed constraint, local optima, units",
        "Caillau, Gergaud and Noailles 2003, planar; no figure for these ends",
        14.731378,
        1e-5,
        "Opti on 150 intervals",
    ),
    SuiteProblem(
        hovering_car,
        "state constraint, chattering",
        "ACADO, its first example",
        7.392677,
        1e-6,
        "Opti on 300 intervals, with the square of the thrust as a control of its own",
    ),
    SuiteProblem(apollo, "unstable", "Stoer and Bulirsch 2002, 7.3.7", 0.0277824, 1e-5, OPTI),
    SuiteProblem(
        mars_landing,
        "bang-bang, state constraint, units",
        "Acikmese and Ploen 2007, in a plane",
        398.0738,
        1e-5,
        OPTI,
    ),
    SuiteProblem(
        crystalliser,
        "state constraint, units",
        "Shi, El-Farra, Li, Mhaskar and Christofides 2006, with a limit of the rate",
        7.712562e8,
        1e-6,
        "Opti on 480 intervals, in units of its own",
    ),
    SuiteProblem(
        hicks_ray, "unstable, local optima", "ICLOCS2, in a fixed time", 106.86500, 1e-5, OPTI
    ),
    SuiteProblem(
        immune_response,
        "smooth",
        "Stengel et al. 2002",
        2.803027,
        1e-5,
        "Opti on 150 intervals, without the branch that is not met",
    ),
    SuiteProblem(
        ramsey,
        "stiff",
        "closed form",
        float(_value_of_capital(1.0)),
        1e-12,
        "closed form of the infinite horizon",
        sign=-1.0,
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
        departure,
        "free start, local optima",
        SOURCELESS,
        _departure_optimum(),
        1e-9,
        "closed form over all starts",
    ),
    SuiteProblem(bouncing_ball, "phases, jumps", SOURCELESS, 6.2714647539, 1e-9, OPTI),
    SuiteProblem(
        hanging_load,
        "algebraic, redundant ends",
        SOURCELESS,
        7.0352894,
        1e-8,
        "Opti on 300 intervals, with the angle in place of the algebraic variable",
    ),
    SuiteProblem(
        intercept, "mixed constraint", SOURCELESS, _intercept_optimum(), 1e-9, "closed form"
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
    SuiteProblem(
        sideways,
        "bang-bang, local optima",
        "Reeds and Shepp 1990",
        2.6362321,
        1e-7,
        "all words of four arcs",
    ),
    SuiteProblem(
        weak_swing_up,
        "bang-bang, local optima",
        SOURCELESS,
        12.567214,
        1e-5,
        "all numbers of switches up to seven",
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
    SuiteProblem(lift, "state constraint, order 1 and 2", "closed form", 8.0, 1e-12, "closed form"),
    SuiteProblem(
        cannonball,
        "phases, parameters, units",
        "dymos, with an exponential atmosphere",
        3212.184693,
        1e-8,
        "simplex search over another integrator",
        sign=-1.0,
    ),
    SuiteProblem(rendezvous, "bang-bang, linear", SOURCELESS, 2.76975, 5e-5, OPTI),
    SuiteProblem(eight_masses, "bang-bang", SOURCELESS, 46.13947, 1e-5, OPTI),
    SuiteProblem(
        vaccination,
        "mixed constraint, bang-bang",
        "Biswas, Paiva and de Pinho 2014, with other weights",
        353.3593,
        1e-6,
        OPTI,
    ),
    SuiteProblem(lap, "periodic", SOURCELESS, 16.18603, 1e-5, OPTI),
    SuiteProblem(
        touching,
        "state constraint, order 3",
        "closed form",
        256.0,
        1e-12,
        "the least norm with the value in the middle",
    ),
)
