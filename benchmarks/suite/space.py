"""Ascents, landings, orbits and turns of spacecraft, in the units of their sources."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from math import cos, exp, pi, radians, sqrt, tan

import casadi as ca
import numpy as np

from benchmarks.suite.problem import (
    ICLOCS,
    OPTI,
    PSOPT_EXAMPLE,
    SOURCELESS,
    SuiteProblem,
    line,
)
from microbot_ocp.ocp import Guess, OptimalControlProblem


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


def _equinoctial_slopes(orbit: list[ca.MX], push: ca.MX | None) -> list[ca.MX]:
    """Return slopes of modified equinoctial elements with J2 to J4; the push in velocity axes."""
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


def two_burns() -> OptimalControlProblem:
    """Maximise the mass from low to geostationary orbit: coast, burn, coast, burn."""
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
        for state, slope in zip(orbit, _equinoctial_slopes(orbit, push), strict=True):
            phase.derivative(state, slope)
        if k == 3:
            assert mass is not None
            phase.end_cost(-mass)
        phases.append(phase)
    for before, after in pairwise(phases):
        problem.link(before, after)
    return problem


def planar_lander() -> OptimalControlProblem:
    """Minimise the time of a lander with two thrusters, 5 m to the side and up, rest to rest."""
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


def to_mars() -> OptimalControlProblem:
    """Minimise the time from Earth's orbit to that of Mars with a small constant thrust."""
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


SPIRAL_START = (21837080.052835, 0.0, 0.0, -0.25396764647494, 0.0, pi, 1.0)


MU, FEET = 1.407645794e16, 20925662.73  # gravity and radius of the Earth, in feet and seconds


ZONAL = {2: 1082.639e-6, 3: -2.565e-6, 4: -1.608e-6}


def _legendre(x: ca.MX, n: int) -> tuple[ca.MX, ca.MX]:
    """Return a Legendre polynomial and its derivative."""
    return {
        2: (0.5 * (3 * x**2 - 1), 3 * x),
        3: (0.5 * (5 * x**3 - 3 * x), 0.5 * (15 * x**2 - 3)),
        4: ((35 * x**4 - 30 * x**2 + 3) / 8, (140 * x**3 - 60 * x) / 8),
    }[n]


def _equinoctial(y: ca.MX, thrust: ca.MX, share: ca.MX) -> ca.MX:
    """Return slopes of p, f, g, h, k, L, w of a spacecraft; thrust: radial, along, normal."""
    p, f, g, h, k, angle, weight = (y[i] for i in range(7))
    sin, cos = ca.sin(angle), ca.cos(angle)
    q = 1 + f * cos + g * sin
    r, alpha, s2 = p / q, h**2 - k**2, 1 + h**2 + k**2
    place = (
        r
        / s2
        * ca.vertcat(
            cos + alpha * cos + 2 * h * k * sin,
            sin - alpha * sin + 2 * h * k * cos,
            2 * (h * sin - k * cos),
        )
    )
    speed = (
        ca.sqrt(MU / p)
        / s2
        * ca.vertcat(
            -(sin + alpha * sin - 2 * h * k * cos + g - 2 * f * h * k + alpha * g),
            -(-cos + alpha * cos + 2 * h * k * sin - f + 2 * g * h * k + alpha * f),
            2 * (h * cos + k * sin + f * h + g * k),
        )
    )
    radial = place / ca.norm_2(place)
    normal = ca.cross(place, speed)
    normal = normal / ca.norm_2(normal)
    onward = ca.cross(normal, radial)
    north = ca.vertcat(0, 0, 1) - radial[2] * radial
    north = north / ca.norm_2(north)
    sin_latitude = radial[2]
    cos_latitude = ca.sqrt(1 - sin_latitude**2)
    to_north = to_radial = 0
    for n, factor in ZONAL.items():
        value, slope = _legendre(sin_latitude, n)
        to_north -= MU * cos_latitude / r**2 * (FEET / r) ** n * slope * factor
        to_radial -= MU / r**2 * (n + 1) * (FEET / r) ** n * value * factor
    pull = to_north * north - to_radial * radial
    force = 4.446618e-3 * (1 + 0.01 * share)
    total = ca.vertcat(ca.dot(radial, pull), ca.dot(onward, pull), ca.dot(normal, pull))
    total = total + 32.174 * force / weight * thrust
    d1, d2, d3 = total[0], total[1], total[2]
    root = ca.sqrt(p / MU)
    return ca.vertcat(
        2 * p / q * root * d2,
        root * (sin * d1 + ((q + 1) * cos + f) / q * d2 - g / q * (h * sin - k * cos) * d3),
        root * (-cos * d1 + ((q + 1) * sin + g) / q * d2 + f / q * (h * sin - k * cos) * d3),
        root * s2 * cos / (2 * q) * d3,
        root * s2 * sin / (2 * q) * d3,
        root / q * (h * sin - k * cos) * d3 + ca.sqrt(MU * p) * (q / p) ** 2,
        -force / 450.0,
    )


def _spiral_guess() -> dict[str, Guess]:
    """Return a guess by simulation with the thrust along the velocity."""
    y = ca.MX.sym("y", 7)
    p, f, g, angle = y[0], y[1], y[2], y[5]
    q = 1 + f * ca.cos(angle) + g * ca.sin(angle)
    speed = ca.vertcat(f * ca.sin(angle) - g * ca.cos(angle), q, 0) * ca.sqrt(MU / p)
    direction = speed / ca.norm_2(speed)
    times = np.linspace(0.0, 86810.0, 501)
    dae = {"x": y, "ode": _equinoctial(y, direction, ca.MX(-25.0))}
    run = ca.integrator("spiral", "cvodes", dae, 0.0, times[1:])
    table = np.array(run(x0=SPIRAL_START)["xf"]).T
    table = np.vstack([SPIRAL_START, table])
    thrust = np.array(ca.Function("u", [y], [direction]).map(times.size)(table.T)).T
    shares = times / times[-1]

    def sampled(values: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        return lambda s: np.column_stack([np.interp(s, shares, column) for column in values.T])

    values = {name: sampled(table[:, [i]]) for i, name in enumerate("pfghkLw")}
    return {"spiral": Guess(86810.0, {**values, "u": sampled(thrust), "share": -25.0})}


def low_thrust() -> OptimalControlProblem:
    """Maximise the final weight after a spiral of eight revolutions, thrust 4.4e-3 lb per lb."""
    problem = OptimalControlProblem("low thrust", maximize=True)
    share = problem.free_parameter("share", lower=-50.0, upper=0.0)
    phase = problem.phase("spiral", (50000.0, 100000.0))
    lower, upper = (10e6, -0.2, -0.1, -1, -0.2, pi, 0), (60e6, 0.2, 1, 1, 0.2, 20 * pi, 2)
    y = [
        phase.state(name, initial=start, lower=low, upper=high)
        for name, start, low, high in zip("pfghkLw", SPIRAL_START, lower, upper, strict=True)
    ]
    u = phase.control("u", 3, lower=-1.0, upper=1.0)
    slopes = _equinoctial(ca.vertcat(*y), u, share)
    for index, state in enumerate(y):
        phase.derivative(state, slopes[index])
    phase.constraint("direction", ca.sumsqr(u), 0.999, 1.001)
    p, f, g, h, k, _, weight = y
    phase.end_constraint("p", p, 40007346.015232, 40007346.015232)
    phase.end_constraint("eccentricity", ca.sqrt(f**2 + g**2), 0.73550320568829, 0.73550320568829)
    phase.end_constraint("inclination", ca.sqrt(h**2 + k**2), 0.61761258786099, 0.61761258786099)
    phase.end_constraint("node", f * h + g * k, 0.0, 0.0)
    phase.end_constraint("side", g * h - k * f, upper=0.0)
    phase.end_cost(weight)
    return problem


ORBIT_RATE = 1.1475e-3  # rad/s


def _orbit_rate(q):
    """Return the rate of the orbital frame in the body's, for an attitude."""
    return [
        -ORBIT_RATE * 2 * (q[1] * q[2] + q[0] * q[3]),
        -ORBIT_RATE * (1 - 2 * (q[1] ** 2 + q[3] ** 2)),
        -ORBIT_RATE * 2 * (q[2] * q[3] - q[0] * q[1]),
    ]


ATTITUDES = ((0.98996, 0.02650, -0.07891, 0.11422), (0.70531, -0.06201, -0.03518, -0.70531))


MOMENTA = ((1000.0, -500.0, -4200.0), (-9.0, -3557.0, -135.0))


def _quaternion_matrix(q: ca.MX) -> ca.MX:
    return ca.vertcat(
        ca.horzcat(-q[1], -q[2], -q[3]),
        ca.horzcat(q[0], -q[3], q[2]),
        ca.horzcat(q[3], q[0], -q[1]),
        ca.horzcat(-q[2], q[1], q[0]),
    )


INERTIA = np.array(
    [
        [18836544.0, 3666370.0, 2965301.0],
        [3666370.0, 27984088.0, -1129004.0],
        [2965301.0, -1129004.0, 39442649.0],
    ]
)


def zero_propellant() -> OptimalControlProblem:
    """Turn the space station by its gyroscopes alone, by commands to its controller."""
    problem = OptimalControlProblem("zero propellant")
    most = (3 * 3600.0) ** 2
    gamma = problem.free_parameter("gamma", lower=0.0, upper=most)
    phase = problem.phase("turn", 7200.0)
    begin, end = (np.array(k) for k in ATTITUDES)
    q = phase.state(
        "q",
        4,
        lower=[-1.0, -0.2, -0.2, -1.0],
        upper=[1.0, 0.2, 0.2, 1.0],
        initial=(begin - 1e-4, begin + 1e-4),
        final=(end - 1e-4, end + 1e-4),
    )
    rates = [np.array(_orbit_rate(k)) for k in ATTITUDES]
    w = phase.state("w", 3, lower=-1e-2, upper=1e-2, initial=rates[0], final=rates[1])
    h = phase.state(
        "h", 3, lower=-8e3, upper=8e3, initial=np.array(MOMENTA[0]), final=np.array(MOMENTA[1])
    )
    c = phase.control("c", 4, lower=-1.0, upper=1.0)
    off = 2 * _quaternion_matrix(c).T @ q
    rate = ca.vertcat(*_orbit_rate(q))
    u = ca.DM(INERTIA) @ (0.000128 * off + 0.015846 * (w - ca.vertcat(*_orbit_rate(c))))
    down = ca.vertcat(
        2 * (q[1] * q[3] - q[0] * q[2]),
        2 * (q[2] * q[3] + q[0] * q[1]),
        1 - 2 * (q[1] ** 2 + q[2] ** 2),
    )
    pull = ca.cross(3 * ORBIT_RATE**2 * down, ca.DM(INERTIA) @ down)
    phase.derivative(q, 0.5 * _quaternion_matrix(q) @ (w - rate))
    turning = pull - ca.cross(w, ca.DM(INERTIA) @ w) - u
    phase.derivative(w, ca.DM(np.linalg.inv(INERTIA)) @ turning)
    change = u - ca.cross(w, h)
    phase.derivative(h, change)
    phase.constraint("attitude", ca.sumsqr(q), 1 - 2e-4, 1 + 2e-4)
    phase.constraint("command", ca.sumsqr(c), 1 - 2e-4, 1 + 2e-4)
    phase.constraint("momentum", ca.sumsqr(h) - gamma, upper=0.0)
    phase.constraint("torque", ca.sumsqr(change), upper=200.0**2)
    phase.running_cost(ca.sumsqr(u))
    problem.cost(0.1 * gamma)
    return problem


def _turn_guess() -> dict[str, Guess]:
    begin = np.array(ATTITUDES[0])
    rates = [np.array(_orbit_rate(k)) for k in ATTITUDES]

    def between(a, b):
        return lambda s: np.asarray(a) + np.outer(s, np.asarray(b) - np.asarray(a))

    values = {"q": begin, "c": begin, "gamma": (3 * 3600.0) ** 2}
    return {"turn": Guess(7200.0, {**values, "w": between(*rates), "h": between(*MOMENTA)})}


def orbit_raise() -> OptimalControlProblem:
    """Minimise the change of speed from the radius 1 to 3: burn, coast, burn."""
    problem = OptimalControlProblem("orbit raise")
    burn1 = problem.phase("burn 1", (0.5, 10.0))
    coast = problem.phase("coast", (0.5, 50.0))
    burn2 = problem.phase("burn 2", (0.5, 10.0))
    thrust = ca.MX()
    for phase in (burn1, coast, burn2):
        first, last = phase is burn1, phase is burn2
        r = phase.state("r", initial=1.0 if first else None, final=3.0 if last else None)
        angle = phase.state("angle", initial=0.0 if first else None)
        vr = phase.state("vr", initial=0.0 if first else None, final=0.0 if last else None)
        vt = phase.state("vt", initial=1.0 if first else None, final=sqrt(1 / 3) if last else None)
        spent = phase.state("spent", initial=0.0 if first else None)
        acceleration, steer = ca.MX(0), ca.MX(0)
        if phase is not coast:
            begin = 0.1 if first else burn1.final(thrust)
            acceleration = phase.state("acceleration", initial=begin)
            steer = phase.control("steer", lower=-radians(90), upper=radians(90))
            phase.derivative(acceleration, acceleration**2 / 1.5)
            thrust = acceleration
        phase.derivative(r, vr)
        phase.derivative(angle, vt / r)
        phase.derivative(vr, vt**2 / r - 1 / r**2 + acceleration * ca.sin(steer))
        phase.derivative(vt, -vr * vt / r + acceleration * ca.cos(steer))
        phase.derivative(spent, acceleration)
        if last:
            phase.end_cost(spent)
    names = ("r", "angle", "vr", "vt", "spent")
    problem.link(burn1, coast, names)
    problem.link(coast, burn2, names)
    return problem


def _raise_guess() -> dict[str, Guess]:
    return {
        "burn 1": Guess(
            2.25,
            {
                "r": line(1.0, 1.5),
                "angle": line(0.0, 1.7),
                "vr": 0.0,
                "vt": 1.0,
                "acceleration": line(0.1, 0.0),
                "spent": line(0.0, 0.1),
                "steer": line(radians(-3.5), radians(13.0)),
            },
        ),
        "coast": Guess(
            3.0, {"r": line(1.3, 1.5), "angle": line(2.18, 1.7), "vr": line(0.3285, 0.0), "vt": 1.0}
        ),
        "burn 2": Guess(
            1.75,
            {
                "r": line(1.0, 3.0),
                "angle": line(0.0, 4.0),
                "vr": 0.0,
                "vt": line(1.0, sqrt(1 / 3)),
                "acceleration": line(0.1, 0.0),
                "spent": line(0.1, 0.2),
                "steer": 0.0,
            },
        ),
    }


def _ascent_guess() -> dict[str, Guess]:
    values = {
        "x": line(0.0, 1.15e5),
        "y": line(0.0, 1.85e5),
        "vx": line(0.0, 7796.6961),
        "vy": line(1e-6, 0.0),
        "mass": line(117000.0, 1163.0),
        "angle": line(1.5, -0.76),
    }
    return {"ascent": Guess(150.0, values)}


def single_stage() -> OptimalControlProblem:
    """Minimise the time of one stage from rest to an orbit of 185 km, in N, kg and m."""
    problem = OptimalControlProblem("single stage")
    phase = problem.phase("ascent", (10.0, 500.0))
    phase_x = phase.state("x", initial=0.0, unit="m")
    y = phase.state("y", initial=0.0, final=1.85e5, unit="m")
    vx = phase.state("vx", initial=0.0, final=7796.6961, unit="m/s")
    vy = phase.state("vy", initial=0.0, final=0.0, unit="m/s")
    mass = phase.state("mass", initial=117000.0, unit="kg")
    angle = phase.control("angle", lower=-1.57, upper=1.57)
    drag = 0.5 * 0.5 * 7.069 * 1.225 * ca.exp(-y / 8440.0)
    phase.derivative(phase_x, vx)
    phase.derivative(y, vy)
    phase.derivative(vx, (2.1e6 * ca.cos(angle) - drag * vx**2) / mass)
    phase.derivative(vy, (2.1e6 * ca.sin(angle) - drag * vy**2) / mass - 9.80665)
    phase.derivative(mass, -2.1e6 / (9.80665 * 265.2))
    phase.end_cost(phase.duration)
    return problem


def largest_orbit() -> OptimalControlProblem:
    """Maximise the circular orbit that a rocket with constant thrust reaches in a given time."""
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


def spaceship() -> OptimalControlProblem:
    """Minimise time and effort from one triangular point of two bodies to the other."""
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


def heated_shuttle() -> OptimalControlProblem:
    """Maximise the cross-range of the space shuttle, degrees, with heating of 70 BTU/ft^2/s."""
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


def limited_rocket() -> OptimalControlProblem:
    """Maximise the height of Goddard's rocket with a speed limit: bang, singular, limit, off."""
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


def satellite() -> OptimalControlProblem:
    """Minimise the effort to turn and stop a tumbling satellite."""
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
    """Minimise the time from an eccentric to the geostationary orbit, in km and h."""
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


def apollo() -> OptimalControlProblem:
    """Minimise the heating of an Apollo capsule's reentry, in 1e5 feet."""
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
    """Minimise the fuel of a powered descent on Mars; engines give at least 30 %."""
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


ORBIT, PUSH = 0.00113, 0.005  # mean motion, 1/s, and acceleration along every axis, m/s^2


def rendezvous() -> OptimalControlProblem:
    """Minimise the fuel of six thrusters for a rendezvous of spacecraft in half an hour."""
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


PROBLEMS = (
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
        planar_lander,
        kind="bang-singular",
        source="OptimalControlProblems.jl: moonlander, no figure",
        published=0.9618,
        tolerance=1e-05,
        confirmed="fine mesh",
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
        low_thrust,
        "parameters, units",
        "Betts 2010; PSOPT",
        0.220338,
        1e-4,
        "PSOPT, another scheme and its own refinement",
        sign=-1.0,
        guess=_spiral_guess,
    ),
    SuiteProblem(
        zero_propellant,
        "units",
        PSOPT_EXAMPLE,
        6.6802e6,
        2e-4,
        "Opti on 25 intervals",
        guess=_turn_guess,
    ),
    SuiteProblem(orbit_raise, "phases", "dymos", 0.3995, 1e-4, OPTI, 0.3994878, guess=_raise_guess),
    SuiteProblem(single_stage, "units", "dymos", 143.0, 5e-3, OPTI, 143.58054, guess=_ascent_guess),
    SuiteProblem(largest_orbit, "smooth", "Bryson and Ho", 1.52602, 1e-5, OPTI, sign=-1.0),
    SuiteProblem(spaceship, "free time", ICLOCS, 3.457997, 1e-6, OPTI),
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
        limited_rocket,
        "bang-singular, state constraint",
        "CTDirect",
        1.01257,
        1e-5,
        OPTI,
        1.0125778,
        sign=-1.0,
    ),
    SuiteProblem(satellite, "smooth, units", "PROPT, 7b: no figure at hand", 71.411096, 1e-7, OPTI),
    SuiteProblem(
        geostationary_transfer,
        "mixed constraint, local optima, units",
        "Caillau, Gergaud and Noailles 2003, planar; no figure for these ends",
        14.731378,
        1e-5,
        "Opti on 150 intervals",
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
    SuiteProblem(rendezvous, "bang-bang, linear", SOURCELESS, 2.76975, 5e-5, OPTI),
)
