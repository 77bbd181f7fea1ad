"""Aircraft, launchers and spacecraft, in the units of their sources."""

from __future__ import annotations

from itertools import pairwise
from math import cos, log, pi, radians, sin, sqrt

import casadi as ca
import numpy as np
from scipy.optimize import root_scalar

from benchmarks.suite.problem import (
    OPTI,
    SOURCELESS,
    SuiteProblem,
    along,
    line,
)
from microbot_ocp.ocp import Guess, OptimalControlProblem


def missile() -> OptimalControlProblem:
    """Minimise the time of a cruise missile's terminal dive, height at least 30 m for 7.5 km."""
    problem = OptimalControlProblem("missile")
    phase = problem.phase("dive", (10.0, 100.0))
    path = phase.state("gamma", initial=0.0, final=-pi / 2, lower=-pi / 2, upper=pi / 2)
    v = phase.state("v", initial=272.0, final=310.0, lower=200.0, upper=310.0, unit="m/s")
    x = phase.state("x", initial=0.0, final=10000.0, lower=0.0, upper=10000.0, unit="m")
    h = phase.state("h", initial=30.0, final=0.0, lower=0.0, upper=1900.0, unit="m")
    thrust = phase.control("thrust", lower=1000.0, upper=6000.0, unit="N")
    alpha = phase.control("alpha", lower=-0.3, upper=0.3, unit="rad")
    mass, gravity, area = 1005.0, 9.81, 0.3376
    density = 3.312e-9 * h**2 - 1.142e-4 * h + 1.224
    pressure = 0.5 * density * v**2 * area
    drag = (-1.9431 * alpha**2 - 0.1499 * alpha + 0.2359) * pressure
    lift = 21.9 * alpha * pressure
    forward = thrust - drag
    turn = (forward * ca.sin(alpha) + lift * ca.cos(alpha)) / mass - gravity * ca.cos(path)
    phase.derivative(path, turn / v)
    phase.derivative(
        v, (forward * ca.cos(alpha) - lift * ca.sin(alpha)) / mass - gravity * ca.sin(path)
    )
    phase.derivative(x, v * ca.cos(path))
    phase.derivative(h, v * ca.sin(path))
    phase.constraint("load", lift / (mass * gravity), -4.0, 4.0)
    near = 0.5 * (1 + ca.tanh((7500 - x) / 10))
    phase.constraint("ground", near * (h - 30) + (1 - near) * h, 0.0, 1900.0)
    phase.end_cost(phase.duration)
    return problem


def _missile_guess() -> dict[str, Guess]:
    values = {
        "gamma": line(0.0, -pi / 2),
        "v": line(272.0, 310.0),
        "x": line(0.0, 10000.0),
        "h": line(30.0, 0.0),
        "thrust": 6000.0,
        "alpha": 0.0,
    }
    return {"dive": Guess(50.0, values)}


def hang_glider() -> OptimalControlProblem:
    """Maximise the range of a hang glider through an updraft, losing 100 m."""
    problem = OptimalControlProblem("hang glider")
    phase = problem.phase("glide", (10.0, 200.0))
    x = phase.state("x", initial=0.0, lower=0.0, unit="m")
    y = phase.state("y", initial=1000.0, final=900.0, unit="m")
    vx = phase.state("vx", initial=13.23, final=13.23, lower=0.0, unit="m/s")
    vy = phase.state("vy", initial=-1.288, final=-1.288, unit="m/s")
    lift = phase.control("lift", lower=0.0, upper=1.4)
    r = (x / 100 - 2.5) ** 2
    sink = vy - 2.5 * (1 - r) * ca.exp(-r)
    speed = ca.sqrt(vx**2 + sink**2)
    pressure = 0.5 * 1.13 * 14 * speed / 100  # divided by the speed, over the mass
    drag = 0.034 + 0.069662 * lift**2
    phase.derivative(x, vx)
    phase.derivative(y, vy)
    phase.derivative(vx, pressure * (-lift * sink - drag * vx))
    phase.derivative(vy, pressure * (lift * vx - drag * sink) - 9.81)
    phase.end_cost(-x)
    return problem


def _hang_glider_guess() -> dict[str, Guess]:
    duration = 100 / 1.288
    values = {"x": line(0.0, 13.23 * duration), "y": line(1000.0, 900.0), "vx": 13.23}
    return {"glide": Guess(duration, {**values, "vy": -1.288, "lift": 0.7})}


def shuttle_reentry() -> OptimalControlProblem:
    """Maximise the cross-range of the space shuttle, degrees of latitude, without heat limit."""
    problem = OptimalControlProblem("shuttle re-entry")
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
    mass = 203000 / 32.174
    radius = 20902900 + h
    pressure = 0.5 * 0.002378 * ca.exp(-h / 23800) * v**2 * 2690
    attack = alpha * 180 / pi
    lift = (-0.20704 + 0.029244 * attack) * pressure
    drag = (0.07854 - 6.1592e-3 * attack + 6.21408e-4 * attack**2) * pressure
    gravity = 0.14076539e17 / radius**2
    phase.derivative(h, v * ca.sin(path))
    phase.derivative(lat, v / radius * ca.cos(path) * ca.cos(azimuth))
    phase.derivative(v, -drag / mass - gravity * ca.sin(path))
    phase.derivative(
        path, lift * ca.cos(bank) / (mass * v) + ca.cos(path) * (v / radius - gravity / v)
    )
    phase.derivative(
        azimuth,
        lift * ca.sin(bank) / (mass * v * ca.cos(path))
        + v / radius * ca.cos(path) * ca.sin(azimuth) * ca.tan(lat),
    )
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


def orbit_raising() -> OptimalControlProblem:
    """Maximise the circular orbit reached in 3.32 by a low thrust of constant size."""
    problem = OptimalControlProblem("orbit raising")
    phase = problem.phase("spiral", 3.32)
    r = phase.state("r", initial=1.0, lower=1.0, upper=10.0)
    theta = phase.state("theta", initial=0.0)
    vr = phase.state("vr", initial=0.0, final=0.0, lower=-10.0, upper=10.0)
    vt = phase.state("vt", initial=1.0)
    u1 = phase.control("u1", lower=-1.1, upper=1.1)
    u2 = phase.control("u2", lower=-1.1, upper=1.1)
    push = 0.1405 / (1 - 0.0749 * phase.time)
    phase.derivative(r, vr)
    phase.derivative(theta, vt / r)
    phase.derivative(vr, vt**2 / r - 1 / r**2 + push * u1)
    phase.derivative(vt, -vr * vt / r + push * u2)
    phase.constraint("direction", u1**2 + u2**2, 1.0, 1.0)
    phase.end_constraint("circle", vt - ca.sqrt(1 / r), 0.0, 0.0)
    phase.end_cost(-r)
    return problem


def _orbit_raising_guess() -> dict[str, Guess]:
    values = {"r": line(1.0, 1.5), "theta": line(0.0, pi), "vr": 0.0, "vt": line(1.0, 0.5)}
    return {"spiral": Guess(3.32, {**values, "u1": line(0.0, 1.0), "u2": line(1.0, 0.0)})}


def dynamic_soaring() -> OptimalControlProblem:
    """Minimise the wind gradient in which a glider can soar for ever, ft and slug."""
    problem = OptimalControlProblem("dynamic soaring")
    gradient = problem.free_parameter("gradient", lower=0.0, upper=1.0, unit="1/s")
    phase = problem.phase("cycle", (10.0, 30.0))
    x = phase.state("x", initial=0.0, final=0.0, lower=-1500.0, upper=1500.0, unit="ft")
    y = phase.state("y", initial=0.0, final=0.0, lower=-1000.0, upper=1000.0, unit="ft")
    h = phase.state("h", initial=0.0, final=0.0, lower=0.0, upper=1000.0, unit="ft")
    v = phase.state("v", lower=10.0, upper=350.0, unit="ft/s")
    path = phase.state("path", lower=radians(-75), upper=radians(75))
    heading = phase.state("heading", lower=radians(-225), upper=radians(225))
    lift = phase.control("lift", lower=0.0, upper=1.5)
    bank = phase.control("bank", lower=radians(-75), upper=radians(75))
    mass, gravity, area, density = 5.6, 32.2, 45.09703, 0.002378
    pressure = 0.5 * density * area * v**2
    force, drag = pressure * lift, pressure * (0.00873 + 0.045 * lift**2)
    rise = v * ca.sin(path)
    shear = mass * gradient * rise
    phase.derivative(x, v * ca.cos(path) * ca.sin(heading) + gradient * h)
    phase.derivative(y, v * ca.cos(path) * ca.cos(heading))
    phase.derivative(h, rise)
    phase.derivative(
        v, -(drag + shear * ca.cos(path) * ca.sin(heading)) / mass - gravity * ca.sin(path)
    )
    phase.derivative(
        path,
        (
            force * ca.cos(bank)
            - mass * gravity * ca.cos(path)
            + shear * ca.sin(path) * ca.sin(heading)
        )
        / (mass * v),
    )
    phase.derivative(
        heading, (force * ca.sin(bank) - shear * ca.cos(heading)) / (mass * v * ca.cos(path))
    )
    phase.constraint("load", force / (mass * gravity), -2.0, 5.0)
    state, turned = ca.vertcat(v, path, heading), [0.0, 0.0, 2 * pi]
    phase.end_constraint("period", state - phase.initial(state), turned, turned)
    phase.end_cost(gradient)
    return problem


def _soaring_guess() -> dict[str, Guess]:
    x = lambda s: 600 * (np.cos(2 * pi * s) - 1)  # noqa: E731
    values = {
        "x": along(x),
        "y": along(lambda s: -200 * np.sin(2 * pi * s)),
        "h": along(lambda s: -0.7 * x(s)),
        "v": 150.0,
        "path": 0.0,
        "heading": line(0.0, 2 * pi),
        "gradient": 0.08,
        "lift": 0.5,
        "bank": radians(45),
    }
    return {"cycle": Guess(24.0, values)}


# launch -------------------------------------------------------------------------------------------

_EARTH, _RADIUS, _SPIN, _G0 = 3.986012e14, 6378145.0, 7.29211585e-5, 9.80665
_LATITUDE = radians(28.5)
_BOOSTER, _FIRST, _SECOND, _PAYLOAD = 19290.0, 104380.0, 19300.0, 4164.0  # masses, kg
_BOOSTER_FUEL, _FIRST_FUEL, _SECOND_FUEL = 17010.0, 95550.0, 16820.0
_BOOSTER_FLOW, _FIRST_FLOW, _SECOND_FLOW = 17010.0 / 75.2, 95550.0 / 261, 16820.0 / 700
_ORBIT = (24361140.0, 0.7308, 28.5, 269.8, 130.5)  # m and degrees


def _launch_masses() -> list[tuple[float, float]]:
    """Return the mass at the start and at the end of every phase."""
    burn = 75.2
    first = 9 * _BOOSTER + _FIRST + _SECOND + _PAYLOAD
    ends = first - 6 * _BOOSTER_FUEL - burn * _FIRST_FLOW
    second = ends - 6 * (_BOOSTER - _BOOSTER_FUEL)
    second_ends = second - 3 * _BOOSTER_FUEL - burn * _FIRST_FLOW
    third = second_ends - 3 * (_BOOSTER - _BOOSTER_FUEL)
    third_ends = third - (261 - 2 * burn) * _FIRST_FLOW
    fourth = third_ends - (_FIRST - _FIRST_FUEL)
    return [(first, ends), (second, second_ends), (third, third_ends), (fourth, _PAYLOAD)]


def _orbit_elements(r: ca.MX, v: ca.MX) -> ca.MX:
    """Return semimajor axis, eccentricity, inclination, node and perigee, m and degrees."""
    h = ca.cross(r, v)
    node = ca.vertcat(-h[1], h[0])
    distance, size = ca.norm_2(r), ca.norm_2(node)
    e = ((ca.sumsqr(v) - _EARTH / distance) * r - ca.dot(r, v) * v) / _EARTH
    degrees = 180 / pi
    return ca.vertcat(
        1 / (2 / distance - ca.sumsqr(v) / _EARTH),
        ca.norm_2(e),
        ca.acos(h[2] / ca.norm_2(h)) * degrees,
        360 - ca.acos(node[0] / size) * degrees,
        ca.acos(ca.dot(node, e[:2]) / (size * ca.norm_2(e))) * degrees,
    )


def delta_launch() -> OptimalControlProblem:
    """Maximise the final mass of a Delta III in a transfer orbit, four phases, SI."""
    problem = OptimalControlProblem("Delta III")
    durations = (75.2, 75.2, 261 - 150.4, (1.0, 700.0))
    thrusts = (6 * 628500 + 1083100, 3 * 628500 + 1083100, 1083100, 110094)
    flows = (6 * _BOOSTER_FLOW + _FIRST_FLOW, 3 * _BOOSTER_FLOW + _FIRST_FLOW)
    flows += (_FIRST_FLOW, _SECOND_FLOW)
    place = np.array([_RADIUS * cos(_LATITUDE), 0.0, _RADIUS * sin(_LATITUDE)])
    pace = np.array([0.0, _RADIUS * _SPIN * cos(_LATITUDE), 0.0])
    phases, masses = [], _launch_masses()
    for k in range(4):
        phase = problem.phase(f"stage {k + 1}", durations[k])
        box = {"lower": -2 * _RADIUS, "upper": 2 * _RADIUS, "unit": "m"}
        r = phase.state("r", 3, initial=place if k == 0 else None, **box)
        box = {"lower": -10000.0, "upper": 10000.0, "unit": "m/s"}
        v = phase.state("v", 3, initial=pace if k == 0 else None, **box)
        start, end = masses[k]
        m = phase.state(
            "m", initial=start, lower=end - 10, upper=start + 10, unit="kg",
            final=(_PAYLOAD, start) if k == 3 else None,
        )  # fmt: skip
        u = phase.control("u", 3, lower=-1.1, upper=1.1)
        distance = ca.norm_2(r)
        wind = v - ca.vertcat(-_SPIN * r[1], _SPIN * r[0], 0)
        density = 1.225 * ca.exp(-(distance - _RADIUS) / 7200)
        speed = ca.sqrt(ca.sumsqr(wind) + 1e-6)  # the wind is zero at the start
        drag = -0.5 * density * 0.5 * 4 * pi * speed * wind
        phase.derivative(r, v)
        phase.derivative(v, -_EARTH / distance**3 * r + (thrusts[k] * u + drag) / m)
        phase.derivative(m, ca.MX(-flows[k]))
        phase.constraint("direction", ca.sumsqr(u), 1.0, 1.0)
        phase.constraint("ground", distance, lower=_RADIUS, unit="m")
        if k == 3:
            phase.end_constraint("orbit", _orbit_elements(r, v), _ORBIT, _ORBIT)
            phase.end_cost(-m)
        phases.append(phase)
    for before, after in pairwise(phases):
        problem.link(before, after, ("r", "v"))
    return problem


def _delta_guess() -> dict[str, Guess]:
    """Return a guess: the launch site, later the perigee of the orbit."""
    a, e, *angles = _ORBIT
    inclination, node, perigee = map(radians, angles)

    def turned(x: float, y: float) -> np.ndarray:
        nodal = np.array([cos(node), sin(node), 0])
        level = np.array([-sin(node), cos(node), 0])
        across = level * cos(inclination) + np.array([0, 0, sin(inclination)])
        first = nodal * cos(perigee) + across * sin(perigee)
        second = -nodal * sin(perigee) + across * cos(perigee)
        return x * first + y * second

    shape = a * (1 - e**2)
    site = (
        np.array([_RADIUS * cos(_LATITUDE), 0.0, _RADIUS * sin(_LATITUDE)]),
        np.array([0.0, _RADIUS * _SPIN * cos(_LATITUDE), 0.0]),
    )
    orbit = turned(shape / (1 + e), 0.0), turned(0.0, sqrt(_EARTH / shape) * (1 + e))
    durations, masses = (75.2, 75.2, 110.6, 700.0), _launch_masses()
    guesses = {}
    for k in range(4):
        r, v = site if k < 2 else orbit
        values = {"r": r, "v": v, "m": line(*masses[k]), "u": np.array([0.0, 1.0, 0.0])}
        guesses[f"stage {k + 1}"] = Guess(durations[k], values)
    return guesses


# aircraft -----------------------------------------------------------------------------------------


def plane_change() -> OptimalControlProblem:
    """Maximise the speed after turning an orbit by 18 degrees in the atmosphere, ft and s."""
    problem = OptimalControlProblem("aero-assisted plane change")
    phase = problem.phase("skip", (800.0, 2000.0))
    limit = radians(89)
    lat = phase.state("latitude", initial=0.0, lower=-limit, upper=limit)
    h = phase.state("h", initial=365000.0, final=365000.0, lower=0.0, upper=400000.0, unit="ft")
    v = phase.state("v", initial=25745.704, lower=20000.0, upper=28000.0, unit="ft/s")
    path = phase.state("path", initial=radians(-0.55), lower=-limit, upper=limit)
    heading = phase.state("heading", initial=0.0, lower=-limit, upper=limit)
    lift = phase.control("lift", lower=0.0, upper=2.0)
    bank = phase.control("bank", lower=0.0, upper=pi)
    earth, mu, mass, area, scale = 2.092643e7, 1.40895e16, 3.315e2, 1.2584e2, 2.41388e4
    first, second = area / (2 * mass) * sqrt(0.032 / 1.4), 0.032 * area / (2 * mass)
    r = earth + h
    density = 3.3195e-5 * ca.exp(-(h - 1e5) / scale)
    phase.derivative(lat, v / r * ca.cos(path) * ca.sin(heading))
    phase.derivative(h, v * ca.sin(path))
    phase.derivative(v, -second * density * v**2 * (1 + lift**2) - mu * ca.sin(path) / r**2)
    phase.derivative(
        path, first * density * v * lift * ca.cos(bank) + ca.cos(path) * (v / r - mu / (r**2 * v))
    )
    phase.derivative(
        heading,
        first * density * v * lift * ca.sin(bank) / ca.cos(path)
        - v / r * ca.cos(path) * ca.cos(heading) * ca.tan(lat),
    )
    at_sea = 3.3195e-5 * float(np.exp(1e5 / scale))
    heat = 17600 * ca.sqrt(density / at_sea) * (v / sqrt(mu / earth)) ** 3.15
    phase.constraint("heat", heat, upper=800.0)
    wanted = cos(radians(18))
    phase.end_constraint("plane", ca.cos(lat) * ca.cos(heading), wanted, wanted)
    phase.end_cost(-v)
    return problem


def _plane_change_guess() -> dict[str, Guess]:
    values = {
        "latitude": 0.0,
        "h": 365000.0,
        "v": 25745.704,
        "path": line(radians(-0.55), 0.0),
        "heading": line(0.0, radians(18)),
        "lift": 1.0,
        "bank": radians(45),
    }
    return {"skip": Guess(800.0, values)}


_MACH = (0.0, 0.4, 0.8, 0.9, 1.0, 1.2, 1.4, 1.6, 1.8)
_LIFT_SLOPE = (3.44, 3.44, 3.44, 3.58, 4.44, 3.44, 3.01, 2.86, 2.44)
_DRAG = (0.013, 0.013, 0.013, 0.014, 0.031, 0.041, 0.039, 0.036, 0.035)
_INDUCED = (0.54, 0.54, 0.54, 0.75, 0.79, 0.78, 0.89, 0.93, 0.93)
_THRUST_MACH = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.2, 1.4, 1.6, 1.8)
_THRUST_HEIGHT = (0.0, 5e3, 10e3, 15e3, 20e3, 25e3, 30e3, 40e3, 50e3, 70e3)  # ft
_THRUST = (  # lbf, one row per Mach number
    (24200, 24000, 20300, 17300, 14500, 12200, 10200, 5700, 3400, 100),
    (28000, 24600, 21100, 18100, 15200, 12800, 10700, 6500, 3900, 200),
    (28300, 25200, 21900, 18700, 15900, 13400, 11200, 7300, 4400, 400),
    (30800, 27200, 23800, 20500, 17300, 14700, 12300, 8100, 4900, 800),
    (34500, 30300, 26600, 23200, 19800, 16800, 14100, 9400, 5600, 1100),
    (37900, 34300, 30400, 26800, 23300, 19800, 16800, 11200, 6800, 1400),
    (36100, 38000, 34900, 31300, 27300, 23600, 20100, 13400, 8300, 1700),
    (34300, 36600, 38500, 36100, 31600, 28100, 24200, 16200, 10000, 2200),
    (32500, 35200, 42100, 38700, 35700, 32000, 28100, 19300, 11900, 2900),
    (30700, 33800, 45700, 41300, 39800, 34600, 31100, 21700, 13300, 3100),
)


def _standard_atmosphere(feet: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return density, slug/ft^3, and speed of sound, ft/s, up to 20 km."""
    metres = 0.3048 * feet
    height = metres * 6356766 / (6356766 + metres)
    temperature = np.maximum(288.15 - 0.0065 * height, 216.65)
    low = (np.minimum(temperature, 288.15) / 288.15) ** 5.25588
    high = np.exp(-9.80665 * np.maximum(height - 11000, 0) / (287.053 * 216.65))
    density = 1.225 * low * high * 288.15 / temperature
    return density / 515.379, np.sqrt(1.4 * 287.053 * temperature) / 0.3048


def climb() -> OptimalControlProblem:
    """Minimise the time of a supersonic climb to 65 600 ft, with tables by cubic splines."""

    def spline(name: str, grids: list, values: np.ndarray) -> ca.Function:
        made = [np.asarray(grid, float).tolist() for grid in grids]
        return ca.interpolant(name, "bspline", made, np.ravel(values, order="F").tolist())

    heights = np.linspace(0.0, 70000.0, 29)
    density_table, sound_table = _standard_atmosphere(heights)
    density = spline("density", [heights], density_table)
    sound = spline("sound", [heights], sound_table)
    slope, zero_lift, induced = (
        spline(name, [_MACH], np.array(table))
        for name, table in (("slope", _LIFT_SLOPE), ("drag", _DRAG), ("induced", _INDUCED))
    )
    push = spline("thrust", [_THRUST_MACH, _THRUST_HEIGHT], np.array(_THRUST))

    problem = OptimalControlProblem("climb")
    phase = problem.phase("climb", (200.0, 500.0))
    h = phase.state("h", initial=0.0, final=65600.0, lower=0.0, upper=69000.0, unit="ft")
    v = phase.state("v", initial=424.26, final=968.148, lower=1.0, upper=2000.0, unit="ft/s")
    limit = radians(89)
    path = phase.state("path", initial=0.0, final=0.0, lower=-limit, upper=limit)
    w = phase.state("w", initial=42000.0, lower=0.0, upper=45000.0, unit="lbf")
    alpha = phase.control("alpha", lower=-radians(20), upper=radians(20))
    mach = v / sound(h)
    thrust = push(ca.vertcat(mach, h))
    pressure = 0.5 * density(h) * v**2 * 530
    lift = pressure * slope(mach) * alpha
    drag = pressure * (zero_lift(mach) + induced(mach) * slope(mach) * alpha**2)
    r, mu, m = 20902900 + h, 0.14076539e17, w / 32.174
    phase.derivative(h, v * ca.sin(path))
    phase.derivative(v, (thrust * ca.cos(alpha) - drag) / m - mu / r**2 * ca.sin(path))
    phase.derivative(
        path,
        (thrust * ca.sin(alpha) + lift) / (m * v) + ca.cos(path) * (v / r - mu / (v * r**2)),
    )
    phase.derivative(w, -thrust / 1600)
    phase.end_cost(phase.duration)
    return problem


def _climb_guess() -> dict[str, Guess]:
    values = {
        "h": line(0.0, 65600.0),
        "v": line(424.26, 968.148),
        "path": 0.0,
        "w": 42000.0,
        "alpha": 0.0,
    }
    return {"climb": Guess(300.0, values)}


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


def _airports() -> tuple[np.ndarray, np.ndarray]:
    here, there = _angles()
    return _on_ground(*here), _on_ground(*there)


def geodesic() -> OptimalControlProblem:
    """Minimise the path over a spheroid from New York to London: states tied by an equation."""
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


def ducted_fan() -> OptimalControlProblem:
    """Move a planar ducted fan sideways by 1 m: time and effort, tilt within 30 degrees."""
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


def quadrotor() -> OptimalControlProblem:
    """Minimise the time of a quadrotor from rest to rest; tilts are limited in size and rate."""
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


def _cruise_guess() -> dict[str, Guess]:
    values = {
        "x": along(lambda s: np.sin(2 * pi * s)),
        "v": along(lambda s: np.cos(2 * pi * s)),
        "u": along(lambda s: -np.sin(2 * pi * s)),
    }
    return {"cycle": Guess(2 * pi, values)}


def periodic_cruise() -> OptimalControlProblem:
    """Minimise the cost rate of a cycle of cruising on and off, Speyer's model."""
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


def wind_shear() -> OptimalControlProblem:
    """Maximise the least height of an aborted landing in a downburst."""
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


def _air(v: ca.MX, alpha: ca.MX, h: ca.MX | float = 0.0) -> tuple[ca.MX, ca.MX]:
    """Return lift and drag of the aircraft on or above the ground, N."""
    part = 33 * ((h + 1.0) / 17.85) ** 1.5
    factor = part / (1 + part) / (pi * 9.45 * 0.801)
    lift = 0.5 + alpha / radians(10) * 1.5
    pressure = 0.5 * 1.225 * v**2 * 124.7
    return pressure * lift, pressure * (0.03 + factor * lift**2)


def balanced_field() -> OptimalControlProblem:
    """Minimise the runway on which a take-off with a failed engine can be finished or rejected."""
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


def _intercept_optimum() -> float:
    return root_scalar(
        lambda t: np.hypot(10 - t, 5 + 1.5 * t) - 0.25 * t**2, bracket=(0.1, 100.0)
    ).root


def intercept() -> OptimalControlProblem:
    """Minimise the time to hit a target in straight flight by an acceleration of 0.5."""
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


def cannonball() -> OptimalControlProblem:
    """Maximise the range of an iron ball with 400 kJ by its size and elevation."""
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


PROBLEMS = (
    SuiteProblem(
        missile,
        kind="state constraint, units",
        source="Subchan and Żbikowski, Computational Optimal Control (2009); PSOPT example "
        "missile: 40.91755",
        published=40.91755,
        reference=40.91194,
        tolerance=2e-4,
        confirmed="fine mesh",
        guess=_missile_guess,
    ),
    SuiteProblem(
        hang_glider,
        kind="units",
        source="COPS 3.0 (Dolan, Moré, Munson 2004), problem 11: 1.25505e3 on coarse meshes; "
        "Bulirsch et al. 1993: 1248",
        published=1248.0,
        reference=1247.9876,
        tolerance=2e-3,
        confirmed="fine mesh",
        sign=-1.0,
        guess=_hang_glider_guess,
    ),
    SuiteProblem(
        shuttle_reentry,
        kind="units",
        source="Betts, Practical Methods (2010), example 6.1: 34.1412 degrees",
        published=34.1412,
        tolerance=2e-6,
        confirmed="fine mesh",
        sign=-1.0,
        guess=_shuttle_guess,
    ),
    SuiteProblem(
        orbit_raising,
        kind="mixed constraint",
        source="Bryson and Ho, section 2.5; YAPSS example orbit_raising: 1.5252777",
        published=1.5252777,
        tolerance=1e-6,
        confirmed="fine mesh",
        sign=-1.0,
        guess=_orbit_raising_guess,
    ),
    SuiteProblem(
        dynamic_soaring,
        kind="parameters, periodic, units",
        source="Zhao, Optim. Control Appl. Meth. 25 (2004); YAPSS example dynamic_soaring: "
        "0.0635869566",
        published=0.0635869566,
        tolerance=1e-5,
        confirmed="fine mesh",
        guess=_soaring_guess,
    ),
    SuiteProblem(
        delta_launch,
        kind="phases, units",
        source="Benson, A Gauss pseudospectral transcription (2004); Betts (2010), example 6.15; "
        "YAPSS example delta_iii_ascent: 7529.712287",
        published=7529.712287,
        tolerance=1e-6,
        confirmed="fine mesh",
        sign=-1.0,
        guess=_delta_guess,
    ),
    SuiteProblem(
        plane_change,
        kind="state constraint, units",
        source="Betts, Practical Methods (2010), example 6.5; MAPTOR example: 22043.5079",
        published=22043.5079,
        tolerance=1e-6,
        confirmed="fine mesh",
        sign=-1.0,
        guess=_plane_change_guess,
    ),
    SuiteProblem(
        climb,
        kind="tables, units",
        source="Bryson, Desai and Hoffman, J. Aircraft 6 (1969); PSOPT example climb: 321.1089, "
        "YAPSS: 320.45, Betts: 324.975, each with its own interpolation",
        published=321.1089,
        tolerance=5e-3,
        confirmed="fine mesh, the same splines",
        reference=319.8680,
        guess=_climb_guess,
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
        ducted_fan,
        kind="free time",
        source="Graichen and Petit (2009); OptimalControlProblems.jl, no figure",
        published=1909.30001,
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
        periodic_cruise,
        kind="periodic",
        source="Speyer and Evans (1984)",
        published=-0.0232710643,
        tolerance=1e-05,
        confirmed="fine mesh",
        guess=_cruise_guess,
    ),
    SuiteProblem(
        wind_shear,
        "minimax, piecewise",
        "Betts 2010, who smooths the wind; ICLOCS2",
        491.85230,
        3e-2,
        OPTI,
        502.2145,
        sign=-1.0,
        guess=_shear_guess,
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
    SuiteProblem(
        intercept, "mixed constraint", SOURCELESS, _intercept_optimum(), 1e-9, "closed form"
    ),
    SuiteProblem(
        cannonball,
        "phases, parameters, units",
        "dymos, with an exponential atmosphere",
        3212.184693,
        1e-8,
        "simplex search over another integrator",
        sign=-1.0,
    ),
)
