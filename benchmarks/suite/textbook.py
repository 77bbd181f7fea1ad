"""Small problems of textbooks, most with a closed form."""

from __future__ import annotations

from cmath import exp, phase
from math import cos, cosh, pi, radians, sin, sinh, sqrt

import casadi as ca
import numpy as np
from scipy.optimize import root_scalar

from benchmarks.suite.problem import (
    PROPT,
    PSOPT_EXAMPLE,
    SOURCELESS,
    SuiteProblem,
)
from microbot_ocp.ocp import Guess, OptimalControlProblem, Phase


def oscillator_in_least_time() -> OptimalControlProblem:
    """Minimise the time of a harmonic oscillator from 9 to rest, |u| <= 1: six arcs."""
    problem = OptimalControlProblem("harmonic oscillator")
    phase = problem.phase("calm", (1.0, 100.0))
    x = phase.state("x", initial=9.0, final=0.0)
    v = phase.state("v", initial=0.0, final=0.0)
    u = phase.control("u", lower=-1.0, upper=1.0)
    phase.derivative(x, v)
    phase.derivative(v, u - x)
    phase.end_cost(phase.duration)
    return problem


def _oscillator_time() -> float:
    """Return the time, computed backwards from rest on circles of the phase plane: part of a turn
    about 1, four half turns about -1 and 1, part of a turn about -1; bisection gives the first."""

    def before(first: float) -> complex:
        z = 1 - exp(1j * first)
        for centre in (-1, 1, -1, 1):
            z = 2 * centre - z
        return z

    low, high = 0.0, pi
    for _ in range(100):
        middle = (low + high) / 2
        low, high = (middle, high) if abs(before(middle) + 1) < 10 else (low, middle)
    rest = -phase(before(low) + 1)
    return low + 4 * pi + rest % (2 * pi)


def least_fuel() -> OptimalControlProblem:
    """Minimise the integral of |u| from rest to rest over 1 m in 3 s, |u| <= 1."""
    problem = OptimalControlProblem("least fuel")
    phase = problem.phase("move", 3.0)
    x = phase.state("x", initial=0.0, final=1.0, unit="m")
    v = phase.state("v", initial=0.0, final=0.0, unit="m/s")
    forward = phase.control("forward", lower=0.0, upper=1.0)
    back = phase.control("back", lower=0.0, upper=1.0)
    phase.derivative(x, v)
    phase.derivative(v, forward - back)
    phase.running_cost(forward + back)
    return problem


def two_sided_effort() -> OptimalControlProblem:
    """Minimise the integral of (a + b)^2, x' = -x - a + b from -1 to 0 in 1 s, a and b >= 0."""
    problem = OptimalControlProblem("two-sided effort")
    phase = problem.phase("rise", 1.0)
    x = phase.state("x", initial=-1.0, final=0.0)
    a = phase.control("a", lower=0.0)
    b = phase.control("b", lower=0.0)
    phase.derivative(x, -x - a + b)
    phase.running_cost((a + b) ** 2)
    return problem


def neuenhofen_kerrigan() -> OptimalControlProblem:
    """Minimise the integral of y^2 + u cos t, y' = y^2/2 + u, on [0, pi/2]."""
    problem = OptimalControlProblem("Neuenhofen and Kerrigan")
    phase = problem.phase("only", pi / 2)
    y = phase.state("y", initial=0.0)
    u = phase.control("u", lower=-1.5, upper=1.0)
    phase.derivative(y, y**2 / 2 + u)
    phase.running_cost(y**2 + ca.cos(phase.time) * u)
    return problem


def _neuenhofen_kerrigan_optimum() -> float:
    node, weight = np.polynomial.legendre.leggauss(60)
    t = (node + 1) * pi / 4
    y = -np.sin(t) / (2 - np.cos(t))
    u = 0.5 - 1.5 / (np.cos(t) - 2) ** 2
    return float(pi / 4 * weight @ (y**2 + np.cos(t) * u))


def farthest_flight() -> OptimalControlProblem:
    """Maximise the distance in 2 s from rest, unit thrust direction (u1, u2), half of gravity."""
    problem = OptimalControlProblem("maximum range")
    phase = problem.phase("fly", 2.0)
    x = phase.state("x", initial=0.0, lower=-10.0, upper=10.0)
    y = phase.state("y", initial=0.0, final=0.1, lower=-10.0, upper=10.0)
    v = phase.state("v", initial=0.0, lower=-10.0, upper=10.0)
    along = phase.control("along", lower=-10.0, upper=10.0)
    up = phase.control("up", lower=-10.0, upper=10.0)
    phase.derivative(x, v * along)
    phase.derivative(y, v * up)
    phase.derivative(v, 0.5 - up)
    phase.constraint("direction", along**2 + up**2, 1.0, 1.0)
    phase.end_cost(-x)
    return problem


def _farthest_flight_guess() -> dict[str, Guess]:
    return {"fly": Guess(2.0, {"x": 0.0, "y": 0.0, "v": 0.0, "along": 1.0, "up": 0.0})}


def isoperimetric() -> OptimalControlProblem:
    """Minimise the integral of x, x' = -sin x + u from 1 to 0, the integral of u^2 being 10."""
    problem = OptimalControlProblem("isoperimetric")
    phase = problem.phase("only", 1.0)
    x = phase.state("x", initial=1.0, final=0.0, lower=-10.0, upper=10.0)
    u = phase.control("u", lower=-4.0, upper=4.0)
    phase.derivative(x, -ca.sin(x) + u)
    phase.integral("spent", u**2, 10.0, 10.0)
    phase.running_cost(x)
    return problem


def interior_point() -> OptimalControlProblem:
    """Minimise the integral of x^2 + u^2 from 1 to 0.75 in 1 s through 0.9 at 0.75 s."""
    problem = OptimalControlProblem("interior point")
    phase = problem.phase("all", 1.0)
    x = phase.state("x", initial=1.0, final=0.75, lower=-1.0, upper=1.0)
    u = phase.control("u", lower=-1.0, upper=1.0)
    phase.derivative(x, u)
    phase.running_cost(x**2 + u**2)
    phase.point_constraint("by way of", x, 0.9, 0.9, at=0.75)
    return problem


def _interior_point_optimum() -> float:
    def arc(a: float, b: float, duration: float) -> float:
        return ((a**2 + b**2) * cosh(duration) - 2 * a * b) / sinh(duration)

    return arc(1.0, 0.9, 0.75) + arc(0.9, 0.75, 0.25)


def van_der_pol_free_end() -> OptimalControlProblem:
    """Minimise half the integral of x1^2 + x2^2 + u^2 of the van der Pol oscillator in 2 s."""
    problem = OptimalControlProblem("van der Pol, free end")
    phase = problem.phase("calm", 2.0)
    x = phase.state("x", initial=1.0)
    v = phase.state("v", initial=0.0)
    u = phase.control("u")
    phase.derivative(x, v)
    phase.derivative(v, (1 - x**2) * v - x + u)
    phase.running_cost(0.5 * (x**2 + v**2 + u**2))
    return problem


def _rayleigh(name: str, duration: float) -> tuple[OptimalControlProblem, Phase, ca.MX, ca.MX]:
    problem = OptimalControlProblem(name)
    phase = problem.phase("calm", duration)
    x = phase.state("x", initial=-5.0)
    v = phase.state("v", initial=-5.0)
    u = phase.control("u")
    phase.derivative(x, v)
    phase.derivative(v, -x + v * (1.4 - 0.14 * v**2) + 4 * u)
    phase.running_cost(u**2 + x**2)
    return problem, phase, x, u


def rayleigh() -> OptimalControlProblem:
    """Minimise the integral of u^2 + x^2 of the Rayleigh equation (a tunnel diode) in 2.5 s."""
    return _rayleigh("Rayleigh", 2.5)[0]


def rayleigh_mixed() -> OptimalControlProblem:
    """Minimise the integral of u^2 + x^2 of Rayleigh's equation in 4.5 s with u + x/6 <= 0."""
    problem, phase, x, u = _rayleigh("Rayleigh, mixed constraint", 4.5)
    phase.constraint("mixed", u + x / 6, upper=0.0)
    return problem


def dubins_car() -> OptimalControlProblem:
    """Minimise the path of a car of unit speed and turning radius from (0, 0), heading along x, to
    (4, 4), heading along y."""
    problem = OptimalControlProblem("Dubins car")
    phase = problem.phase("drive", (1.0, 20.0))
    x = phase.state("x", initial=0.0, final=4.0)
    y = phase.state("y", initial=0.0, final=4.0)
    heading = phase.state("heading", initial=0.0, final=pi / 2)
    turn = phase.control("turn", lower=-1.0, upper=1.0)
    phase.derivative(x, ca.cos(heading))
    phase.derivative(y, ca.sin(heading))
    phase.derivative(heading, turn)
    phase.end_cost(phase.duration)
    return problem


def _dubins_length() -> float:
    """Return the length of left, straight, left: circles about (0, 1) and (3, 4), 90 deg in all."""
    return pi / 2 + sqrt(3**2 + 3**2)


def zermelo_constant_current() -> OptimalControlProblem:
    """Minimise the time of a crossing to (10, 5) at speed 2 in the current (0.5, -1)."""
    problem = OptimalControlProblem("Zermelo, constant current")
    phase = problem.phase("sail", (1.0, 50.0))
    x = phase.state("x", initial=0.0, final=10.0)
    y = phase.state("y", initial=0.0, final=5.0)
    heading = phase.control("heading", lower=-pi, upper=pi)
    phase.derivative(x, 2 * ca.cos(heading) + 0.5)
    phase.derivative(y, 2 * ca.sin(heading) - 1)
    phase.end_cost(phase.duration)
    return problem


def _crossing_time() -> float:
    """Solve the quadratic equation: the distance left after drifting for T is 2 T."""
    a, b, c = 0.5**2 + 1 - 4, -2 * (10 * 0.5 - 5), 10**2 + 5**2
    return (-b - sqrt(b**2 - 4 * a * c)) / (2 * a)


def lunar_ascent() -> OptimalControlProblem:
    """Minimise the time of an ascent from the moon's surface to 185.2 km at 1627 m/s, flat moon,
    constant acceleration of 3 lunar gravities."""
    gravity, height, speed = 1.61544, 185200.0, 1627.0
    problem = OptimalControlProblem("lunar ascent")
    phase = problem.phase("climb", (10.0, 1000.0))
    x = phase.state("x", initial=0.0, unit="m")
    y = phase.state("y", initial=0.0, final=height, unit="m")
    vx = phase.state("vx", initial=0.0, final=speed, unit="m/s")
    vy = phase.state("vy", initial=0.0, final=0.0, unit="m/s")
    angle = phase.control("angle", lower=-pi / 2, upper=pi / 2, unit="rad")
    phase.derivative(x, vx)
    phase.derivative(y, vy)
    phase.derivative(vx, 3 * gravity * ca.cos(angle))
    phase.derivative(vy, 3 * gravity * ca.sin(angle) - gravity)
    phase.end_cost(phase.duration)
    return problem


def _lunar_ascent_time() -> float:
    """Solve tan(angle) = a - b t for three end conditions by Newton's method and quadrature."""
    from scipy.optimize import fsolve

    gravity, height, speed = 1.61544, 185200.0, 1627.0
    node, weight = np.polynomial.legendre.leggauss(80)
    s = (node + 1) / 2

    def left(unknowns: np.ndarray) -> np.ndarray:
        a, b, duration = unknowns
        tangent = a - b * s
        along = 1 / np.sqrt(1 + tangent**2)
        up = tangent * along
        mean = lambda values: float(weight @ values / 2)  # noqa: E731
        return np.array(
            [
                3 * gravity * duration * mean(along) / speed - 1,
                (3 * mean(up) - 1),
                duration**2 * gravity * (3 * mean((1 - s) * up) - 0.5) / height - 1,
            ]
        )

    return float(fsolve(left, [2.0, 2.0, 480.0], xtol=1e-13)[2])


def hypersensitive() -> OptimalControlProblem:
    """Minimise half the integral of x^2 + u^2, x' = -x^3 + u, from 1.5 to 1 in 50 s."""
    return _hypersensitive(50.0, 1.5, 1.0)


def hypersensitive_long() -> OptimalControlProblem:
    """Minimise half the integral of x^2 + u^2, x' = -x^3 + u, from 1 to 1.5 in 10 000 s."""
    return _hypersensitive(10000.0, 1.0, 1.5)


def _hypersensitive(duration: float, start: float, end: float) -> OptimalControlProblem:
    problem = OptimalControlProblem("hypersensitive")
    phase = problem.phase("only", duration)
    x = phase.state("x", initial=start, final=end)
    u = phase.control("u")
    phase.derivative(x, -(x**3) + u)
    phase.running_cost(0.5 * (x**2 + u**2))
    return problem


def _hypersensitive_optimum(start: float, end: float) -> float:
    """Return the optimum: to rest at zero and from there, by two Hamilton-Jacobi equations.

    x^2/2 - x^3 p - p^2/2 = 0 gives the costate p = -x^3 +- x sqrt(1 + x^4); the time in between is
    so long that it does not contribute.
    """
    node, weight = np.polynomial.legendre.leggauss(60)

    def value(x: float, sign: float) -> float:
        s = (node + 1) * x / 2
        return float(x / 2 * weight @ (sign * s**3 + s * np.sqrt(1 + s**4)))

    return value(start, -1.0) + value(end, 1.0)


def moon_landing() -> OptimalControlProblem:
    """Minimise the integral of thrust of a soft landing, lunar units, thrust within [0, 1.227]."""
    problem = OptimalControlProblem("moon landing")
    phase = problem.phase("descend", (0.1, 10.0))
    h = phase.state("h", initial=1.0, final=0.0, lower=-20.0, upper=20.0)
    v = phase.state("v", initial=-0.783, final=0.0, lower=-20.0, upper=20.0)
    m = phase.state("m", initial=1.0, lower=0.01, upper=1.0)
    thrust = phase.control("thrust", lower=0.0, upper=1.227)
    phase.derivative(h, v)
    phase.derivative(v, -1 + thrust / m)
    phase.derivative(m, -thrust / 2.349)
    phase.running_cost(thrust)
    return problem


def _moon_landing_optimum() -> float:
    """Solve for free fall, then full thrust: the rocket equation with two unknown durations."""
    from scipy.optimize import fsolve

    thrust, exhaust = 1.227, 2.349

    def left(durations: np.ndarray) -> list[float]:
        fall, burn = durations
        h, v = 1 - 0.783 * fall - fall**2 / 2, -0.783 - fall
        rest = 1 - thrust / exhaust * burn  # remaining mass
        logarithm = float(np.log(rest))
        flown = exhaust * (exhaust / thrust) * (rest * logarithm - rest + 1)
        return [v - burn - exhaust * logarithm, h + v * burn - burn**2 / 2 + flown]

    found = np.asarray(fsolve(left, [0.3, 1.1], xtol=1e-13))
    return thrust * float(found[1])


BRYSON_HO = "Bryson and Ho, Applied Optimal Control (1975), "
PSOPT = "Becerra, PSOPT application examples (release 5), "
CTDIRECT = "CTDirect.jl test problems (control-toolbox), "
CLOSED = "closed form"
FINE = "fine mesh"


def target_line() -> OptimalControlProblem:
    """Minimise the energy to a line of end states."""
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


def delays() -> OptimalControlProblem:
    """Steer x' = x(t - 1) u(t - 2), as six intervals in parallel, tied at their ends."""
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


def integrator_chain() -> OptimalControlProblem:
    """Minimise the quadratic cost of Nagurka's linear problem with ten states."""
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
    """Minimise the costs of effort and end of x' = u."""
    problem = OptimalControlProblem("Hull")
    phase = problem.phase("only", 10.0)
    x = phase.state("x", initial=1.5)
    u = phase.control("u")
    phase.derivative(x, u)
    phase.running_cost(0.5 * u**2)
    phase.end_cost(2.5 * x**2)
    return problem


def newton() -> OptimalControlProblem:
    """Minimise the resistance of Newton's body, as high as wide: a flat front and a curve."""
    problem = OptimalControlProblem("Newton")
    phase = problem.phase("only", 1.0)
    height = phase.state("height", initial=1.0, final=0.0, lower=0.0, upper=1.0)
    slope = phase.control("slope", lower=-100.0, upper=0.0)
    phase.derivative(height, slope)
    phase.running_cost(8 * phase.time / (1 + slope**2))
    return problem


def brachistochrone_of_given_length() -> OptimalControlProblem:
    """Minimise the time of descent on a wire of 11 m between two points."""
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


def _fall(arc: float, radius: float, gravity: float, longest: float) -> OptimalControlProblem:
    problem = OptimalControlProblem("gravity tunnel")
    phase = problem.phase("fall", (longest / 200, longest))
    x = phase.state("x", initial=radius, final=radius * cos(arc))
    y = phase.state("y", initial=0.0, final=radius * sin(arc))
    v = phase.state("v", initial=0.0)
    heading = phase.control("heading")
    vx, vy = ca.cos(heading), ca.sin(heading)
    phase.derivative(x, v * vx)
    phase.derivative(y, v * vy)
    phase.derivative(v, -gravity / radius * (x * vx + y * vy))
    phase.end_cost(phase.duration)
    return problem


def gravity_tunnel() -> OptimalControlProblem:
    """Minimise the time of a fall from rest through a ball of radius 1 over an arc of 2."""
    return _fall(2.0, 1.0, 1.0, 20.0)


def tunnel_through_the_earth() -> OptimalControlProblem:
    """Minimise the time of a fall through the earth over an arc of 1.2, between two rests."""
    problem = _fall(1.2, 6.371e6, 9.82, 7200.0)
    (phase,) = problem.phases
    phase.end_constraint("rest", phase.states[-1].symbol, 0.0, 0.0)
    return problem


def _hypocycloid(arc: float, radius: float, gravity: float) -> float:
    """Return the time of the fall along a hypocycloid."""
    return sqrt(arc * (2 * pi - arc) * radius / gravity)


def steps() -> OptimalControlProblem:
    """Steer down from 1 to 0, along it, and up again: three phases of a second each."""
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


def grusin() -> OptimalControlProblem:
    """Minimise a path in a plane where moving north costs more near the axis."""
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
    """Return the length of the geodesic x = a sin(b t), y' = b x^2 that arrives, b below 2 pi."""

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


def hanging_chain() -> OptimalControlProblem:
    """Minimise the potential energy of a chain of length 4 between heights of 1 and 3."""
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
    """Return the energy of the catenary y = c cosh((x - m) / c) + d."""
    c = root_scalar(lambda c: 2 * c * np.sinh(0.5 / c) - np.sqrt(12.0), bracket=(0.05, 1.0)).root
    m = 0.5 - c * np.arctanh(2.0 / 4.0)
    d = 1 - c * np.cosh(-m / c)
    x = np.array([0.0, 1.0])
    lengths = c * np.sinh((x - m) / c)
    squares = 0.5 * c * x + c**2 / 4 * np.sinh(2 * (x - m) / c)
    return float(squares[1] - squares[0] + d * (lengths[1] - lengths[0]))


def zermelo_in_shear() -> OptimalControlProblem:
    """Minimise the time home of a boat in a current that grows with the distance from the bank."""
    problem = OptimalControlProblem("Zermelo")
    phase = problem.phase("cross", (0.1, 100.0))
    x = phase.state("x", initial=3.66, final=0.0)
    y = phase.state("y", initial=-1.86, final=0.0)
    heading = phase.control("heading")
    phase.derivative(x, ca.cos(heading) - y)
    phase.derivative(y, ca.sin(heading))
    phase.end_cost(phase.duration)
    return problem


def _target_speed(t: ca.MX | float) -> ca.MX | float:
    return 2 * ca.cos(t) - 2.2 * ca.sin(2.2 * t)


def _target(t: ca.MX | float) -> ca.MX | float:
    return 5 + 2 * ca.sin(t) + ca.cos(2.2 * t)


def departure() -> OptimalControlProblem:
    """Minimise the effort to meet a moving target 2 s after a free departure."""
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
    """Return the least value of the closed form over all departures."""

    def effort(t: float) -> float:
        d, v, duration = float(_target(t + 2)), float(_target_speed(t + 2)), 2.0
        return 12 * d**2 / duration**3 - 12 * d * v / duration**2 + 4 * v**2 / duration

    best, width = 10.0, 10.0
    for _ in range(6):
        grid = np.clip(best + width * np.linspace(-1.0, 1.0, 2001), 0.0, 20.0)
        best, width = grid[np.argmin([effort(t) for t in grid])], width / 100
    return effort(best)


PROBLEMS = (
    SuiteProblem(
        oscillator_in_least_time,
        kind="bang-bang",
        source="Bushaw 1952; Pontryagin et al. 1962, section 5; six arcs of circles",
        published=_oscillator_time(),
        tolerance=1e-9,
        confirmed=CLOSED,
    ),
    SuiteProblem(
        least_fuel,
        kind="bang-bang",
        source="Kirk, Optimal Control Theory (1970), section 5.5; closed form T - sqrt(T^2 - 4 d)",
        published=3 - sqrt(5),
        tolerance=1e-9,
        confirmed=CLOSED,
    ),
    SuiteProblem(
        two_sided_effort,
        kind="smooth",
        source=CTDIRECT + "simple_integrator: 3.13e-1",
        published=0.313,
        tolerance=2e-3,
        reference=2 / (float(np.exp(2.0)) - 1),
        confirmed=CLOSED,
    ),
    SuiteProblem(
        neuenhofen_kerrigan,
        kind="smooth",
        source="Neuenhofen and Kerrigan, CDC 2020; PSOPT example x1: -0.256996962561",
        published=-0.256996962561,
        tolerance=1e-11,
        reference=_neuenhofen_kerrigan_optimum(),
        confirmed=CLOSED,
    ),
    SuiteProblem(
        farthest_flight,
        kind="mixed constraint",
        source=PSOPT + "section 5 (Bryson, Dynamic Optimization, 1999): -1.712313",
        published=1.712313,
        tolerance=1e-5,
        confirmed=FINE,
        sign=-1.0,
        guess=_farthest_flight_guess,
    ),
    SuiteProblem(
        isoperimetric,
        kind="integral constraint",
        source=PSOPT + "isoperimetric: -0.3755057",
        published=-0.3755057,
        tolerance=1e-5,
        confirmed=FINE,
    ),
    SuiteProblem(
        interior_point,
        kind="phases",
        source=PSOPT + "section 6 (Miele): 0.9205314",
        published=0.9205314,
        tolerance=1e-7,
        reference=_interior_point_optimum(),
        confirmed=CLOSED,
    ),
    SuiteProblem(
        van_der_pol_free_end,
        kind="smooth",
        source=CTDIRECT + "vanderpol (Bocop): 1.047921",
        published=1.047921,
        tolerance=2e-4,
        confirmed=FINE,
        reference=1.04780691,
    ),
    SuiteProblem(
        rayleigh,
        kind="smooth",
        source="Maurer and Augustin, in Online Optimization of Large Scale Systems (2001): 29.3760",
        published=29.3760,
        tolerance=2e-5,
        confirmed=FINE,
    ),
    SuiteProblem(
        rayleigh_mixed,
        kind="mixed constraint",
        source=PSOPT + "rayleigh: 44.77625 on 80 nodes",
        published=44.77625,
        tolerance=7e-4,
        confirmed=FINE,
        reference=44.804444,
    ),
    SuiteProblem(
        dubins_car,
        kind="bang-singular",
        source="Dubins, Am. J. Math. 79 (1957): left, straight, left",
        published=_dubins_length(),
        tolerance=1e-9,
        confirmed=CLOSED,
    ),
    SuiteProblem(
        zermelo_constant_current,
        kind="smooth",
        source=BRYSON_HO + "section 2.7; closed form, a straight course",
        published=_crossing_time(),
        tolerance=1e-9,
        confirmed=CLOSED,
    ),
    SuiteProblem(
        lunar_ascent,
        kind="units",
        source="Longuski, Guzmán and Prussing, Optimal Control with Aerospace Applications (2014), "
        "section 4.5; the linear tangent law by quadrature",
        published=_lunar_ascent_time(),
        tolerance=1e-9,
        confirmed=CLOSED,
    ),
    SuiteProblem(
        hypersensitive,
        kind="stiff, unstable",
        source=PSOPT + "hypersensitive (Rao and Mease 2000): 1.330826",
        published=1.330826,
        tolerance=2e-5,
        reference=_hypersensitive_optimum(1.5, 1.0),
        confirmed=CLOSED,
    ),
    SuiteProblem(
        hypersensitive_long,
        kind="stiff, unstable",
        source="Rao and Mease, Optim. Control Appl. Meth. 21 (2000); GPOPS-II (Patterson and Rao, "
        "ACM TOMS 41, 2014) with t_f = 10000; value by quadrature",
        published=_hypersensitive_optimum(1.0, 1.5),
        tolerance=1e-9,
        confirmed=CLOSED,
    ),
    SuiteProblem(
        moon_landing,
        kind="bang-bang",
        source="PSOPT example moon (Meditch 1964): 1.4204",
        published=1.4204,
        tolerance=7e-5,
        reference=_moon_landing_optimum(),
        confirmed=CLOSED,
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
        delays,
        kind="values of other ends",
        source="Göllmann, Kern, Maurer; Betts, Practical Methods (2010), 10.50: 3.10812211",
        published=3.10812211,
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
        brachistochrone_of_given_length,
        kind="integral constraint",
        source="dymos example length_constrained_brachistochrone, 11.9 m",
        published=1.80767971,
        tolerance=1e-05,
        confirmed="fine mesh",
    ),
    SuiteProblem(
        gravity_tunnel,
        "heading from rest, no regular end",
        "Cooper 1966, Through the Earth in forty minutes",
        _hypocycloid(2.0, 1.0, 1.0),
        1e-4,
        "closed form",
    ),
    SuiteProblem(
        tunnel_through_the_earth,
        "heading from rest, units",
        "Cooper 1966, Through the Earth in forty minutes",
        _hypocycloid(1.2, 6.371e6, 9.82),
        1e-4,
        "closed form",
    ),
    SuiteProblem(steps, "phases, state constraint", PSOPT_EXAMPLE, 1.0, 1e-6, "closed form"),
    SuiteProblem(
        grusin, "local optima", PROPT, 6.333416559, 2e-2, "closed form", _grusin_optimum()
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
        departure,
        "free start, local optima",
        SOURCELESS,
        _departure_optimum(),
        1e-9,
        "closed form over all starts",
    ),
)
