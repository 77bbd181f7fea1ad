"""A third set whose first answers were counted before anything was mended on their account."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from math import atan, atanh, log, pi, radians, sqrt

import casadi as ca
import numpy as np

from benchmarks.suite.problem import SuiteProblem, line
from microbot_ocp.ocp import Guess, OptimalControlProblem, Phase


def coulomb_friction() -> OptimalControlProblem:
    """Two masses on springs with dry friction, moved in least time."""
    problem = OptimalControlProblem("dry friction")
    phase = problem.phase("only", (1.8, 4.0))
    q1 = phase.state("q1", initial=0.0, final=1.0)
    v1 = phase.state("v1", initial=-1.0, final=0.0)
    q2 = phase.state("q2", initial=0.0, final=2.0)
    v2 = phase.state("v2", initial=-2.0, final=0.0)
    u1 = phase.control("u1", lower=-4.0, upper=4.0)
    u2 = phase.control("u2", lower=-4.0, upper=4.0)
    phase.derivative(q1, v1)
    phase.derivative(v1, (-1.8 * q1 + 0.85 * q2 - ca.tanh(v1 / 0.01) + u1) / 1.1)
    phase.derivative(q2, v2)
    phase.derivative(v2, (0.85 * q1 - 0.85 * q2 - ca.tanh(v2 / 0.01) + u2) / 1.2)
    phase.end_cost(phase.duration)
    return problem


MU, FEET = 1.407645794e16, 20925662.73  # of the Earth, in feet and seconds
ZONAL = {2: 1082.639e-6, 3: -2.565e-6, 4: -1.608e-6}


def _legendre(x: ca.MX, n: int) -> tuple[ca.MX, ca.MX]:
    """Polynomial and derivative."""
    return {
        2: (0.5 * (3 * x**2 - 1), 3 * x),
        3: (0.5 * (5 * x**3 - 3 * x), 0.5 * (15 * x**2 - 3)),
        4: ((35 * x**4 - 30 * x**2 + 3) / 8, (140 * x**3 - 60 * x) / 8),
    }[n]


def _equinoctial(y: ca.MX, thrust: ca.MX, share: ca.MX) -> ca.MX:
    """Derivatives of p, f, g, h, k, L, w of a spacecraft; thrust: radial, along, normal."""
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


SPIRAL_START = (21837080.052835, 0.0, 0.0, -0.25396764647494, 0.0, pi, 1.0)


def low_thrust() -> OptimalControlProblem:
    """A spiral of eight revolutions with a thrust of 4.4e-3 lb a pound, for most final weight."""
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


def _spiral_guess() -> dict[str, Guess]:
    """A simulation with the thrust along the velocity."""
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


ORBIT = 1.1475e-3  # rad/s
INERTIA = np.array(
    [
        [18836544.0, 3666370.0, 2965301.0],
        [3666370.0, 27984088.0, -1129004.0],
        [2965301.0, -1129004.0, 39442649.0],
    ]
)
ATTITUDES = ((0.98996, 0.02650, -0.07891, 0.11422), (0.70531, -0.06201, -0.03518, -0.70531))
MOMENTA = ((1000.0, -500.0, -4200.0), (-9.0, -3557.0, -135.0))


def _orbit_rate(q):
    """Rate of the orbital frame in the body's, for an attitude."""
    return [
        -ORBIT * 2 * (q[1] * q[2] + q[0] * q[3]),
        -ORBIT * (1 - 2 * (q[1] ** 2 + q[3] ** 2)),
        -ORBIT * 2 * (q[2] * q[3] - q[0] * q[1]),
    ]


def _quaternion_matrix(q: ca.MX) -> ca.MX:
    return ca.vertcat(
        ca.horzcat(-q[1], -q[2], -q[3]),
        ca.horzcat(q[0], -q[3], q[2]),
        ca.horzcat(q[3], q[0], -q[1]),
        ca.horzcat(-q[2], q[1], q[0]),
    )


def zero_propellant() -> OptimalControlProblem:
    """The space station is turned by its gyroscopes alone, by commands to its controller."""
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
    pull = ca.cross(3 * ORBIT**2 * down, ca.DM(INERTIA) @ down)
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


TIMES = np.arange(1, 41) / 40
NOISE = 0.05 * np.sin(37.0 * np.arange(80) ** 1.5).reshape(2, 40)
SEEN = np.column_stack([np.sin(pi * TIMES) + NOISE[0], pi * np.cos(pi * TIMES) + NOISE[1]])


def bock() -> OptimalControlProblem:
    """Bock's notorious fit: one parameter of dynamics with a growth of exp(60)."""
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


def _bock_optimum() -> float:
    """With p = pi - 120 d exp(-60), the growing mode d exp(60 (t - 1)) is free and p is pi."""
    mode = np.exp(60 * (TIMES - 1))
    mode = np.concatenate([mode, 60 * mode])
    off = NOISE.ravel()
    return float(off @ off - (off @ mode) ** 2 / (mode @ mode))


def steps() -> OptimalControlProblem:
    """Down from 1 to 0, along it, and up again: three phases of a second each."""
    problem = OptimalControlProblem("steps")
    phases = []
    for k in range(3):
        phase = problem.phase(f"p{k}", 1.0)
        x = phase.state(
            "x",
            lower=0.0,
            upper=5.0,
            initial=1.0 if k == 0 else None,
            final=1.0 if k == 2 else None,
        )
        u = phase.control("u", lower=-1.0, upper=1.0)
        phase.derivative(x, u)
        phase.running_cost(x)
        if phases:
            problem.link(phases[-1], phase)
        phases.append(phase)
    return problem


def orbit_raise() -> OptimalControlProblem:
    """Burn, coast, burn: from the radius 1 to 3 with the least change of speed."""
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


def single_stage() -> OptimalControlProblem:
    """One stage to an orbit of 185 km in least time, from rest, in N, kg and m."""
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


def wind_shear() -> OptimalControlProblem:
    """A landing is broken off in a downburst; the least height is to be as large as can be."""
    problem = OptimalControlProblem("wind shear", maximize=True)
    least = problem.free_parameter("least height", lower=300.0, upper=1000.0, unit="ft")
    phase = problem.phase("abort", 40.0)
    x = phase.state("x", initial=0.0, lower=0.0, upper=1e4, unit="ft")
    h = phase.state("h", initial=600.0, lower=100.0, upper=1000.0, unit="ft")
    v = phase.state("v", initial=239.7, lower=1.0, unit="ft/s")
    path = phase.state("path", initial=-0.03925, final=0.12969)
    alpha = phase.state("alpha", initial=0.1283, lower=-0.3002, upper=0.3002)
    u = phase.control("u", lower=-0.05236, upper=0.05236)
    a, b, c = 6e-8, -4e-11, -log(25 / 30.6) * 1e-12
    d, e = -8.02881e-8, 6.28083e-11
    back = 4600 - x
    first = ca.if_else(x < 4100, (x - 2300) / 40, 50 - a * back**3 - b * back**4)
    first = ca.if_else(x < 500, -50 + a * x**3 + b * x**4, ca.if_else(x < 4600, first, 50))
    second = ca.if_else(x < 4100, -51 * ca.exp(-c * (x - 2300) ** 4), d * back**3 + e * back**4)
    second = ca.if_else(x < 500, d * x**3 + e * x**4, ca.if_else(x < 4600, second, 0))
    wind, down = first, second * h / 1000
    mass, gravity, pressure = 150000 / 32.172, 32.172, 0.5 * 0.2203e-2 * 0.1560e4
    thrust = ca.fmin(0.3825 + 0.2 * phase.time, 1) * (0.4456e5 - 23.98 * v + 0.01442 * v**2)
    drag = (0.1552 + 0.12369 * alpha + 2.4203 * alpha**2) * pressure * v**2
    lift = 0.7125 + 6.0877 * alpha - 9.0277 * ca.fmax(alpha - radians(12), 0) ** 2
    lift = lift * pressure * v**2
    sin, cos = ca.sin(path), ca.cos(path)
    dx, dh = v * cos + wind, v * sin + down
    d_wind = ca.jacobian(wind, x) * dx
    d_down = ca.jacobian(down, x) * dx + ca.jacobian(down, h) * dh
    push = alpha + radians(2)
    phase.derivative(x, dx)
    phase.derivative(h, dh)
    forward = (thrust * ca.cos(push) - drag) / mass - gravity * sin
    phase.derivative(v, forward - d_wind * cos - d_down * sin)
    upward = (thrust * ca.sin(push) + lift) / mass - gravity * cos
    phase.derivative(path, (upward + d_wind * sin - d_down * cos) / v)
    phase.derivative(alpha, u)
    phase.constraint("height", h - least, lower=0.0)
    problem.cost(least)
    return problem


def _shear_guess() -> dict[str, Guess]:
    values = {
        "x": line(0.0, 9000.0),
        "h": line(600.0, 850.0),
        "v": 239.7,
        "path": line(-0.03925, 0.12969),
        "alpha": 0.1283,
        "least height": 502.0,
    }
    return {"abort": Guess(40.0, values)}


def nishida() -> OptimalControlProblem:
    """Two damped oscillators are calmed by one bounded control."""
    problem = OptimalControlProblem("Nishida")
    phase = problem.phase("only", 4.2)
    x = phase.state("x", 4, initial=10.0)
    u = phase.control("u", lower=-1.0, upper=1.0)
    slopes = ca.vertcat(
        -0.5 * x[0] + 5 * x[1],
        -5 * x[0] - 0.5 * x[1] + u,
        -0.6 * x[2] + 10 * x[3],
        -10 * x[2] - 0.6 * x[3] + u,
    )
    phase.derivative(x, slopes)
    phase.end_cost(ca.sumsqr(x))
    return problem


def gas_absorber() -> OptimalControlProblem:
    """Six plates of an absorber are brought to their steady state."""
    problem = OptimalControlProblem("gas absorber")
    phase = problem.phase("only", 15.0)
    start = [-0.0342, -0.0619, -0.0837, -0.1004, -0.1131, -0.1224]
    x = phase.state("x", 6, initial=start)
    u1 = phase.control("u1", lower=0.0, upper=0.04)
    u2 = phase.control("u2", lower=-0.4, upper=0.09)
    matrix = -1.173113 * np.eye(6) + 0.634839 * np.eye(6, k=1) + 0.538273 * np.eye(6, k=-1)
    entry = ca.vertcat(0.538273 * u1, 0, 0, 0, 0, 0.634839 * u2)
    phase.derivative(x, ca.DM(matrix) @ x + entry)
    phase.running_cost(ca.sumsqr(x) + u1**2 + u2**2)
    return problem


def struck_oscillator() -> OptimalControlProblem:
    """An oscillator that is struck between 0.5 s and 0.6 s: three phases."""
    problem = OptimalControlProblem("struck oscillator")
    phases: list[Phase] = []
    for name, duration, force in (("calm", 0.5, 0.0), ("struck", 0.1, 100.0), ("after", 1.4, 0.0)):
        phase = problem.phase(name, duration)
        first = not phases
        x1 = phase.state("x1", initial=0.0 if first else None)
        x2 = phase.state("x2", initial=0.0 if first else None)
        u = phase.control("u")
        phase.derivative(x1, x2)
        phase.derivative(x2, -x1 - x2 + u + force)
        phase.running_cost(5 * x1**2 + 2.5 * x2**2 + 0.5 * u**2)
        if phases:
            problem.link(phases[-1], phase)
        phases.append(phase)
    return problem


CONTACT, RECOVERY, BEDS, INFECTED = 0.3, 0.1, 0.05, 1e-4


def epidemic() -> OptimalControlProblem:
    """The least distancing that keeps the infected within the beds."""
    problem = OptimalControlProblem("epidemic")
    phase = problem.phase("only", 300.0)
    s = phase.state("susceptible", initial=1 - INFECTED, lower=0.0, upper=1.0)
    i = phase.state("infected", initial=INFECTED, lower=0.0, upper=BEDS)
    b = phase.control("contact", lower=0.0, upper=CONTACT)
    phase.derivative(s, -b * s * i)
    phase.derivative(i, b * s * i - RECOVERY * i)
    phase.running_cost(CONTACT - b)
    return problem


def _epidemic_optimum() -> float:
    """Nothing until the beds are full, then as many new ones as recover, until herd immunity."""
    herd = RECOVERY / CONTACT
    low, high = herd, 1 - INFECTED
    for _ in range(200):  # s when the infected, 1 - s + herd log(s / s0), are as many as the beds
        middle = (low + high) / 2
        low, high = (
            (middle, high)
            if INFECTED + (1 - INFECTED) - middle + herd * log(middle / (1 - INFECTED)) > BEDS
            else (low, middle)
        )
    return CONTACT * (low - herd) / (RECOVERY * BEDS) - log(low / herd) / BEDS


def advertising() -> OptimalControlProblem:
    """Vidale and Wolfe: a market share is won by advertising and lost by itself."""
    problem = OptimalControlProblem("advertising", maximize=True)
    phase = problem.phase("only", 10.0)
    x = phase.state("share", initial=0.1, lower=0.0, upper=1.0)
    u = phase.control("u", lower=0.0, upper=2.0)
    phase.derivative(x, u * (1 - x) - 0.1 * x)
    phase.running_cost(ca.exp(-0.05 * phase.time) * (x - u))
    return problem


def windowed_speed() -> OptimalControlProblem:
    """From rest to rest with a speed limit that holds in the middle alone, by a steep gate."""
    problem = OptimalControlProblem("windowed speed")
    phase = problem.phase("only", 1.0)
    x = phase.state("x", initial=0.0, final=1.0)
    v = phase.state("v", initial=0.0, final=0.0)
    u = phase.control("u", lower=-20.0, upper=20.0)
    phase.derivative(x, v)
    phase.derivative(v, u)
    t = phase.time
    gate = 1 / (1 + ca.exp(-200 * (t - 0.35))) / (1 + ca.exp(200 * (t - 0.65)))
    phase.constraint("speed", v - 1.3 - 50 * (1 - gate), upper=0.0)
    phase.running_cost(u**2)
    return problem


def walled_brachistochrone() -> OptimalControlProblem:
    """The slide to x = 1 in least time above the wall y = x / 2 + 0.1, y downwards."""
    problem = OptimalControlProblem("walled brachistochrone")
    phase = problem.phase("slide", (0.1, 10.0))
    x = phase.state("x", initial=0.0, final=1.0)
    y = phase.state("y", initial=0.0)
    v = phase.state("v", initial=0.0)
    angle = phase.control("angle")
    phase.derivative(x, v * ca.cos(angle))
    phase.derivative(y, v * ca.sin(angle))
    phase.derivative(v, ca.sin(angle))
    phase.constraint("wall", y - x / 2 - 0.1, upper=0.0)
    phase.end_cost(phase.duration)
    return problem


def drag_sled() -> OptimalControlProblem:
    """A sled with quadratic drag goes 100 m from rest to rest in least time, in SI."""
    problem = OptimalControlProblem("sled")
    phase = problem.phase("run", (1.0, 1000.0))
    x = phase.state("x", initial=0.0, final=100.0, unit="m")
    v = phase.state("v", initial=0.0, final=0.0, lower=0.0, unit="m/s")
    force = phase.control("force", lower=-4000.0, upper=2000.0, unit="N")
    phase.derivative(x, v)
    phase.derivative(v, (force - 2.0 * v**2) / 800.0)
    phase.end_cost(phase.duration)
    return problem


@lru_cache
def _sled_optimum() -> float:
    """Push, then brake: both in closed form, meeting in place and speed."""
    push, brake, c, m = 2000.0, 4000.0, 2.0, 800.0
    low, high = 0.0, sqrt(push / c) * (1 - 1e-15)
    for _ in range(200):
        v = (low + high) / 2
        way = -m / (2 * c) * log(1 - c * v**2 / push) + m / (2 * c) * log(1 + c * v**2 / brake)
        low, high = (v, high) if way < 100.0 else (low, v)
    return m / sqrt(push * c) * atanh(v * sqrt(c / push)) + m / sqrt(brake * c) * atan(
        v * sqrt(c / brake)
    )


PSOPT = "PSOPT"
LUUS = "Luus, Iterative Dynamic Programming; PROPT"
MESHES = "Opti on 300 intervals"

PROBLEMS = (
    SuiteProblem(coulomb_friction, "bang-bang, stiff", PSOPT, 2.104992, 5e-3, MESHES, 2.11415),
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
        zero_propellant, "units", PSOPT, 6.6802e6, 2e-4, "Opti on 25 intervals", guess=_turn_guess
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
    SuiteProblem(steps, "phases, state constraint", PSOPT, 1.0, 1e-6, "closed form"),
    SuiteProblem(
        orbit_raise, "phases", "dymos", 0.3995, 1e-4, MESHES, 0.3994878, guess=_raise_guess
    ),
    SuiteProblem(
        single_stage, "units", "dymos", 143.0, 5e-3, MESHES, 143.58054, guess=_ascent_guess
    ),
    SuiteProblem(
        wind_shear,
        "minimax, piecewise",
        "Betts 2010, who smooths the wind; ICLOCS2",
        491.85230,
        3e-2,
        MESHES,
        502.2145,
        sign=-1.0,
        guess=_shear_guess,
    ),
    SuiteProblem(
        nishida, "bang-bang, linear", LUUS, 1.0035, 1e-3, "Opti on 600 intervals", 1.0034994
    ),
    SuiteProblem(gas_absorber, "linear", LUUS, 0.13375, 1e-4, MESHES, 0.13375113),
    SuiteProblem(struck_oscillator, "phases", LUUS, 58.065, 1e-4, MESHES, 58.065029),
    SuiteProblem(
        epidemic,
        "state constraint, singular",
        "Miclo, Spiro and Weibull 2020",
        _epidemic_optimum(),
        1e-6,
        "closed form",
    ),
    SuiteProblem(advertising, "singular", "Sethi 1973", 2.86062, 1e-5, MESHES, 2.860625, sign=-1.0),
    SuiteProblem(windowed_speed, "state constraint", PSOPT, 12.97886, 2e-4, MESHES, 12.980094),
    SuiteProblem(
        walled_brachistochrone,
        "state constraint",
        "Bryson and Ho 1975, section 3.11",
        1.834,
        1e-4,
        MESHES,
        1.8340032,
    ),
    SuiteProblem(
        drag_sled, "bang-bang, units", "closed form", _sled_optimum(), 1e-6, "closed form"
    ),
)
