"""Optimal-control problems with published optima, stated with the general layer.

Every problem has its source, its statement and the figure that the source gives, or the formula
where the answer is known in closed form. :data:`PROBLEMS` lists them in the order of the table that
``problems/10_published_optima.py`` prints.

COPS 3.0 stands for E. D. Dolan, J. J. Moré and T. S. Munson, *Benchmarking Optimization Software
with COPS 3.0*, Argonne National Laboratory, report ANL/MCS-TM-273, 2004.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import asinh, cos, cosh, log, pi, sin, sinh, sqrt, tan

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.ocp import (
    Guess,
    OptimalControlProblem,
    Phase,
    Solution,
    SolverSettings,
    solve,
)
from microbot_ocp.ocp.solution import Progress


@dataclass(frozen=True)
class PublishedProblem:
    """A problem and what is known of its answer.

    Attributes
    ----------
    name : str
        Short, for the command line.
    statement, source : str
    optimum : float
        The closed form where there is one, else the figure of the source.
    build : callable
        Makes the problem.
    mesh : int
        Intervals of every phase, enough for ``tolerance``.
    printed : float, optional
        Figure of the source where ``optimum`` is a closed form.
    printed_tolerance : float
        What the digits of the printed figure allow, and the discretisation it was printed for.
    sign : float
        -1 where the source maximises.
    guess : where to start, by phase; the layer's own guess where there is none
    tolerance : float
        Accepted relative difference to ``optimum``.
    """

    name: str
    statement: str
    source: str
    optimum: float
    build: Callable[[], OptimalControlProblem]
    mesh: int = 60
    printed: float | None = None
    printed_tolerance: float = 1e-5
    sign: float = 1.0
    guess: Mapping[str, Guess] | None = None
    tolerance: float = 1e-5

    def solve(
        self,
        scheme: str,
        solver: str,
        mesh: int | None = None,
        progress: Progress | None = None,
    ) -> Solution:
        """The solution by one scheme and solver."""
        settings = SolverSettings(solver=solver, tolerance=1e-9)
        return solve(
            self.build(),
            mesh or self.mesh,
            self.guess,
            settings,
            scheme=scheme,
            progress=progress,
        )

    def error(self, solution: Solution) -> float:
        """Difference to the optimum, relative."""
        return abs(self.sign * solution.cost / self.optimum - 1)


def column(function: Callable[[FloatArray], FloatArray]) -> Callable[[FloatArray], FloatArray]:
    """A guess of one component from a function of the fraction of the phase."""
    return lambda s: function(s)[:, None]


# closed forms and textbooks -----------------------------------------------------------------------


def root(function: Callable[[float], float], low: float, high: float) -> float:
    """Zero of a function that changes its sign between low and high, by bisection."""
    sign = function(low)
    for _ in range(200):
        middle = (low + high) / 2
        if function(middle) * sign > 0:
            low = middle
        else:
            high = middle
    return (low + high) / 2


def double_integrator() -> OptimalControlProblem:
    problem = OptimalControlProblem("double integrator")
    phase = problem.phase("move", (0.1, 10.0))
    x = phase.state("x", initial=0.0, final=1.0, unit="m")
    v = phase.state("v", initial=0.0, final=0.0, unit="m/s")
    u = phase.control("u", lower=-1.0, upper=1.0, unit="m/s^2")
    phase.derivative(x, v)
    phase.derivative(v, u)
    phase.end_cost(phase.duration)
    return problem


CEILING = 1 / 9


def bryson_denham() -> OptimalControlProblem:
    problem = OptimalControlProblem("Bryson-Denham")
    phase = problem.phase("fly", 1.0)
    x = phase.state("x", initial=0.0, final=0.0, upper=CEILING)
    v = phase.state("v", initial=1.0, final=-1.0)
    u = phase.control("u", shape="linear")
    phase.derivative(x, v)
    phase.derivative(v, u)
    phase.running_cost(u**2 / 2)
    return problem


GRAVITY, AWAY, DOWN = 9.81, 10.0, 5.0


def cycloid_time() -> float:
    """Time along the cycloid x = R (a - sin a), y = R (1 - cos a): sqrt(R / g) times the last a."""
    end = root(lambda a: DOWN * (a - sin(a)) - AWAY * (1 - cos(a)), 0.1, 2 * pi - 0.1)
    return sqrt(DOWN / (1 - cos(end)) / GRAVITY) * end


def brachistochrone() -> OptimalControlProblem:
    problem = OptimalControlProblem("brachistochrone")
    phase = problem.phase("slide", (0.5, 5.0))
    x = phase.state("x", initial=0.0, final=AWAY, unit="m")
    y = phase.state("y", initial=0.0, final=DOWN, unit="m")
    v = phase.state("v", initial=0.0, lower=0.0, unit="m/s")
    angle = phase.control("angle", lower=0.0, upper=pi, shape="linear", unit="rad")
    phase.derivative(x, v * ca.sin(angle))
    phase.derivative(y, v * ca.cos(angle))
    phase.derivative(v, GRAVITY * ca.cos(angle))
    phase.end_cost(phase.duration)
    return problem


# the problems of COPS 3.0 -------------------------------------------------------------------------


def robot_arm() -> OptimalControlProblem:
    problem = OptimalControlProblem("robot arm")
    phase = problem.phase("move", (1.0, 20.0))
    length = 5.0
    rho = phase.state("rho", initial=4.5, final=4.5, lower=0.0, upper=length)
    theta = phase.state("theta", initial=0.0, final=2 * pi / 3, lower=-pi, upper=pi)
    phi = phase.state("phi", initial=pi / 4, final=pi / 4, lower=0.0, upper=pi)
    rho_rate = phase.state("rho rate", initial=0.0, final=0.0)
    theta_rate = phase.state("theta rate", initial=0.0, final=0.0)
    phi_rate = phase.state("phi rate", initial=0.0, final=0.0)
    u_rho = phase.control("u_rho", lower=-1.0, upper=1.0)
    u_theta = phase.control("u_theta", lower=-1.0, upper=1.0)
    u_phi = phase.control("u_phi", lower=-1.0, upper=1.0)
    inertia = ((length - rho) ** 3 + rho**3) / 3
    phase.derivative(rho, rho_rate)
    phase.derivative(theta, theta_rate)
    phase.derivative(phi, phi_rate)
    phase.derivative(rho_rate, u_rho / length)
    phase.derivative(theta_rate, u_theta / (inertia * ca.sin(phi) ** 2))
    phase.derivative(phi_rate, u_phi / inertia)
    phase.end_cost(phase.duration)
    return problem


def steering_time() -> float:
    """Least time of the particle by the linear tangent law.

    Bryson and Ho, *Applied Optimal Control*, section 2.4: tan(angle) is linear in time. It falls
    from k to -k here, for vy is zero at both ends; the means of cos and of (1 - s) sin over the
    phase are closed forms of k, and the two end conditions leave the time.
    """

    def duration(k: float) -> float:
        return 45 / 100 * k / asinh(k)

    def height(k: float) -> float:  # 100 T^2 times the mean of (1 - s) sin(angle)
        mean = (k * sqrt(1 + k**2) - asinh(k)) / (4 * k**2)
        return 100 * duration(k) ** 2 * mean

    return duration(root(lambda k: height(k) - 5, 1e-3, 10.0))


def particle_steering() -> OptimalControlProblem:
    problem = OptimalControlProblem("particle steering")
    phase = problem.phase("thrust", (0.1, 5.0))
    x = phase.state("x", initial=0.0, scale=10.0)
    y = phase.state("y", initial=0.0, final=5.0, scale=5.0)
    vx = phase.state("vx", initial=0.0, final=45.0, scale=45.0)
    vy = phase.state("vy", initial=0.0, final=0.0, scale=10.0)
    angle = phase.control("angle", lower=-pi / 2, upper=pi / 2, shape="linear")
    phase.derivative(x, vx)
    phase.derivative(y, vy)
    phase.derivative(vx, 100 * ca.cos(angle))
    phase.derivative(vy, 100 * ca.sin(angle))
    phase.end_cost(phase.duration)
    return problem


def chain_energy() -> float:
    """Potential energy of the catenary y = a cosh((x + c) / a) + d, the integral of y dy/ds."""
    rise, length = 2.0, 4.0
    a = root(lambda a: 2 * a * sinh(1 / (2 * a)) - sqrt(length**2 - rise**2), 0.05, 5.0)
    left = root(lambda z: cosh(z + 1 / a) - cosh(z) - rise / a, -20.0, 20.0)
    right = left + 1 / a
    d = 1 - a * cosh(left)
    return a**2 / 2 * (right - left + (sinh(2 * right) - sinh(2 * left)) / 2) + d * length


def hanging_chain() -> OptimalControlProblem:
    problem = OptimalControlProblem("hanging chain")
    phase = problem.phase("span", 1.0)
    height = phase.state("height", initial=1.0, final=3.0)
    length = phase.state("length", initial=0.0, final=4.0)
    slope = phase.control("slope", shape="linear")
    along = ca.sqrt(1 + slope**2)
    phase.derivative(height, slope)
    phase.derivative(length, along)
    phase.running_cost(height * along)
    return problem


def _rocket(
    problem: OptimalControlProblem,
    name: str,
    duration: tuple[float, float],
    thrust: tuple[float, float],
    *,
    start: tuple[float | None, float | None, float | None] = (None, None, None),
    empty: bool = False,
) -> tuple[Phase, ca.MX]:
    """A phase of the Goddard rocket with its thrust within limits, and the height."""
    phase = problem.phase(name, duration)
    h = phase.state("h", lower=1.0, initial=start[0])
    v = phase.state("v", lower=0.0, initial=start[1], scale=0.1)
    m = phase.state("m", lower=0.6, upper=1.0, initial=start[2], final=0.6 if empty else None)
    force = phase.control("thrust", lower=thrust[0], upper=thrust[1], shape="constant")
    drag = 310 * v**2 * ca.exp(-500 * (h - 1))
    phase.derivative(h, v)
    phase.derivative(v, (force - drag) / m - 1 / h**2)
    phase.derivative(m, -force / 0.5)
    return phase, h


def goddard_rocket() -> OptimalControlProblem:
    problem = OptimalControlProblem("Goddard rocket")
    ascent, h = _rocket(
        problem, "ascent", (0.05, 1.0), (0.0, 3.5), start=(1.0, 0.0, 1.0), empty=True
    )
    ascent.end_cost(-h)
    return problem


def goddard_in_three_phases() -> OptimalControlProblem:
    problem = OptimalControlProblem("Goddard rocket in three phases")
    full, _ = _rocket(problem, "full", (0.001, 0.2), (3.5, 3.5), start=(1.0, 0.0, 1.0))
    between, _ = _rocket(problem, "between", (0.001, 0.2), (0.0, 3.5))
    coast, h = _rocket(problem, "coast", (0.01, 0.5), (0.0, 0.0), empty=True)
    problem.link(full, between)
    problem.link(between, coast)
    coast.end_cost(-h)
    return problem


ROCKET_GUESS = Guess(0.2, {"h": 1.0, "v": 0.05, "m": lambda s: 1 - 0.4 * s[:, None], "thrust": 1.0})
ROCKET_GUESSES = {
    "full": Guess(0.02, {"h": 1.0, "v": 0.05, "m": 0.95, "thrust": 3.5}),
    "between": Guess(0.05, {"h": 1.005, "v": 0.1, "m": 0.7, "thrust": 1.0}),
    "coast": Guess(0.1, {"h": 1.01, "v": 0.05, "m": 0.6, "thrust": 0.0}),
}

# oscillators and pendulums ------------------------------------------------------------------------


def van_der_pol() -> OptimalControlProblem:
    problem = OptimalControlProblem("van der Pol")
    phase = problem.phase("calm", 5.0)
    x1 = phase.state("x1", initial=0.0)
    x2 = phase.state("x2", initial=1.0)
    u = phase.control("u", lower=-0.3, upper=1.0, shape="linear")
    phase.derivative(x1, (1 - x2**2) * x1 - x2 + u)
    phase.derivative(x2, x1)
    phase.running_cost(x1**2 + x2**2 + u**2)
    return problem


def van_der_pol_time() -> OptimalControlProblem:
    problem = OptimalControlProblem("van der Pol in the shortest time")
    phase = problem.phase("calm", (0.5, 10.0))
    x1 = phase.state("x1", initial=1.0)
    x2 = phase.state("x2", initial=1.0)
    u = phase.control("u", lower=-1.0, upper=1.0)
    phase.derivative(x1, x2)
    phase.derivative(x2, -x1 + x2 * (1 - x1**2) + u)
    phase.end_constraint("circle", x1**2 + x2**2, 0.04, 0.04)
    phase.end_cost(phase.duration)
    return problem


TORQUE = 0.5  # of the torque that holds the pendulum level


def swing_up_time() -> float:
    """Shortest swing-up of x'' = -sin x + u, |u| <= k, with two switches, by quadrature.

    Along an arc of constant torque the energy w^2/2 - cos x - u x is conserved, so each arc takes
    the integral of dx / w. The arcs are u = -k from rest at 0 to x1 < 0, u = +k to the turning
    point and up to x2 = x1 + 1/k + pi/2 (from the energy at the end), u = -k to rest at pi; x1 is
    the best of all.
    """
    k = TORQUE
    s, weight = np.polynomial.legendre.leggauss(100)
    angle = (s + 1) * pi / 4

    def arc(a: float, b: float, u: float, energy: float) -> float:
        """Time from a to b; the square roots at turning points are smoothed by x = sin^2."""
        x = a + (b - a) * np.sin(angle) ** 2
        speed = np.sqrt(np.maximum(2 * (energy + np.cos(x) + u * x), 1e-300))
        return float(abs(b - a) * np.sum(weight * pi / 4 * np.sin(2 * angle) / speed))

    def total(x1: float) -> float:
        second = -1 - 2 * k * x1  # energy of the arc with +k, from that of the first at x1
        x2 = x1 + 1 / k + pi / 2
        turning = root(lambda x: second + cos(x) + k * x, -pi / 2, x1)
        third = 1 + k * pi  # at rest at pi
        return (
            arc(0.0, x1, -k, -1.0)
            + arc(x1, turning, k, second)
            + arc(turning, x2, k, second)
            + arc(x2, pi, -k, third)
        )

    low, high = -0.9, -0.05
    golden = (sqrt(5) - 1) / 2
    for _ in range(60):
        a, b = high - golden * (high - low), low + golden * (high - low)
        low, high = (low, b) if total(a) < total(b) else (a, high)
    return total((low + high) / 2)


def pendulum() -> OptimalControlProblem:
    problem = OptimalControlProblem("pendulum swing-up")
    phase = problem.phase("swing", (1.0, 20.0))
    angle = phase.state("angle", initial=0.0, final=pi)
    rate = phase.state("rate", initial=0.0, final=0.0)
    torque = phase.control("torque", lower=-TORQUE, upper=TORQUE)
    phase.derivative(angle, rate)
    phase.derivative(rate, torque - ca.sin(angle))
    phase.end_cost(phase.duration)
    return problem


CART, POLE, LENGTH, FORCE = 1.0, 0.3, 0.5, 10.0


def cart_pole_slopes(angle_rate, force, sine, cosine):
    """Accelerations of the cart and of the pole, with a point mass at its end."""
    pull = force + POLE * sine * (LENGTH * angle_rate**2 + GRAVITY * cosine)
    free = CART + POLE * sine**2
    turn = force * cosine + POLE * LENGTH * angle_rate**2 * sine * cosine
    turn = turn + (CART + POLE) * GRAVITY * sine
    return pull / free, -turn / (LENGTH * free)


def _cart_pole_phase(
    problem: OptimalControlProblem,
    name: str,
    duration: tuple[float, float],
    force: tuple[float, float],
    *,
    first: bool = True,
    last: bool = True,
) -> Phase:
    """A phase of the swing-up with its force within limits, from rest below to rest above."""
    phase = problem.phase(name, duration)
    start, end = (0.0 if first else None), (0.0 if last else None)
    x = phase.state("x", initial=start, final=end, lower=-2.0, upper=2.0, unit="m")
    angle = phase.state("angle", initial=start, final=pi if last else None, unit="rad")
    speed = phase.state("speed", initial=start, final=end, scale=3.0, unit="m/s")
    rate = phase.state("rate", initial=start, final=end, scale=5.0, unit="rad/s")
    push = phase.control("force", lower=force[0], upper=force[1], scale=FORCE, unit="N")
    gain, turn = cart_pole_slopes(rate, push, ca.sin(angle), ca.cos(angle))
    phase.derivative(x, speed)
    phase.derivative(angle, rate)
    phase.derivative(speed, gain)
    phase.derivative(rate, turn)
    phase.end_cost(phase.duration)
    return phase


def cart_pole() -> OptimalControlProblem:
    problem = OptimalControlProblem("cart-pole swing-up")
    _cart_pole_phase(problem, "swing", (0.1, 5.0), (-FORCE, FORCE))
    return problem


CART_POLE_SIGNS = (1, -1, 1, -1)  # of the force on the arcs that the solution of cart_pole has


def cart_pole_arcs() -> OptimalControlProblem:
    problem = OptimalControlProblem("cart-pole swing-up in arcs")
    for arc, sign in enumerate(CART_POLE_SIGNS):
        _cart_pole_phase(
            problem,
            f"arc {arc}",
            (0.02, 2.0),
            (sign * FORCE, sign * FORCE),
            first=arc == 0,
            last=arc == len(CART_POLE_SIGNS) - 1,
        )
    for before, after in zip(problem.phases[:-1], problem.phases[1:], strict=True):
        problem.link(before, after)
    return problem


def cart_pole_guess(duration: float, begin: float, end: float) -> Guess:
    """The angle rises evenly from one fraction of the swing-up to another, all else rests."""
    angle = column(lambda s: pi * (begin + (end - begin) * s))
    values = {"x": 0.0, "angle": angle, "speed": 0.0, "rate": 0.0, "force": 0.0}
    return Guess(duration, values)


# Zermelo ------------------------------------------------------------------------------------------

START_HEADING, END_HEADING = 105 * pi / 180, 240 * pi / 180


def sheared_start() -> tuple[float, float]:
    """Start (x, y) from which the headings 105 to 240 degrees lead to the origin."""

    def place(heading: float) -> tuple[float, float]:
        secant, tangent, last = 1 / cos(heading), tan(heading), 1 / cos(END_HEADING)
        x = log(abs(secant + tangent)) / 2 - secant * tangent / 2 + last * tangent
        return x, secant - last

    (x0, y0), (x1, y1) = place(START_HEADING), place(END_HEADING)
    return x0 - x1, y0 - y1


def zermelo_in_a_shear() -> OptimalControlProblem:
    problem = OptimalControlProblem("Zermelo in a linear current")
    phase = problem.phase("sail", (1.0, 20.0))
    start = sheared_start()
    x = phase.state("x", initial=start[0], final=0.0)
    y = phase.state("y", initial=start[1], final=0.0)
    heading = phase.control("heading", lower=0.0, upper=2 * pi, shape="linear")
    phase.derivative(x, ca.cos(heading) - y)
    phase.derivative(y, ca.sin(heading))
    phase.end_cost(phase.duration)
    return problem


def zermelo_in_a_vortex() -> OptimalControlProblem:
    problem = OptimalControlProblem("Zermelo in a vortex")
    phase = problem.phase("fly", (1.0, 10.0))
    x = phase.state("x", initial=-2.0, final=0.5)
    y = phase.state("y", initial=0.0, final=-1.6)
    heading = phase.control("heading", shape="linear")
    wind = ca.exp(0.25 - x**2 - y**2)
    phase.derivative(x, ca.cos(heading) + y * wind)
    phase.derivative(y, ca.sin(heading) - x * wind)
    phase.end_cost(phase.duration)
    return problem


# several phases -----------------------------------------------------------------------------------


def _mass(
    problem: OptimalControlProblem,
    name: str,
    duration: float | tuple[float, float],
    start: tuple[float | None, float | None] = (None, None),
    end: tuple[float | None, float | None] = (None, None),
    *,
    force: tuple[float, float] = (-np.inf, np.inf),
    shape: str = "constant",
) -> tuple[Phase, ca.MX]:
    """A phase of a unit mass along a line, and its acceleration."""
    phase = problem.phase(name, duration)
    x = phase.state("x", initial=start[0], final=end[0])
    v = phase.state("v", initial=start[1], final=end[1])
    u = phase.control("u", lower=force[0], upper=force[1], shape=shape)
    phase.derivative(x, v)
    phase.derivative(v, u)
    return phase, u


TOP_SPEED, DISTANCE = 2.0, 5.0


def through_a_point() -> OptimalControlProblem:
    problem = OptimalControlProblem("through a point")
    first, u = _mass(problem, "first", 1.0, (0.0, 0.0), (0.3, None), shape="linear")
    first.running_cost(u**2)
    second, u = _mass(problem, "second", 0.5, end=(1.0, 0.0), shape="linear")
    second.running_cost(u**2)
    problem.link(first, second)
    return problem


def spline_effort() -> float:
    """Integral of u^2 of the cubic spline at rest at both ends, u continuous at the point."""
    pieces, heights = (1.0, 0.5), (0.3, 0.7)
    speed = 1.5 * (0.3 / 1.0**2 + 0.7 / 0.5**2) / (1 / 1.0 + 1 / 0.5)
    effort = 0.0
    for h, rise, a, b in zip(pieces, heights, (0.0, speed), (speed, 0.0), strict=True):
        u0 = 6 * rise / h**2 - (4 * a + 2 * b) / h
        u1 = (2 * a + 4 * b) / h - 6 * rise / h**2
        effort += h * (u0**2 + u0 * u1 + u1**2) / 3
    return effort


def trapezoid() -> OptimalControlProblem:
    problem = OptimalControlProblem("trapezoid")
    limits = (-1.0, 1.0)
    gain, _ = _mass(problem, "gain", (0.1, 10.0), (0.0, 0.0), (None, TOP_SPEED), force=limits)
    cruise, _ = _mass(problem, "cruise", (0.1, 10.0), force=(0.0, 0.0))
    brake, _ = _mass(problem, "brake", (0.1, 10.0), end=(DISTANCE, 0.0), force=limits)
    problem.link(gain, cruise)
    problem.link(cruise, brake)
    for phase in problem.phases:
        phase.end_cost(phase.duration)
    return problem


# all of them --------------------------------------------------------------------------------------


COPS = "COPS 3.0 (Dolan, Moré, Munson 2004), "
BRYSON_HO = "Bryson and Ho, Applied Optimal Control (1975), "

PROBLEMS: tuple[PublishedProblem, ...] = (
    PublishedProblem(
        name="double_integrator",
        statement="1 m from rest to rest in the shortest time, |u| <= 1",
        source="closed form, 2 sqrt(distance / acceleration)",
        optimum=2.0,
        build=double_integrator,
    ),
    PublishedProblem(
        name="bryson_denham",
        statement="least integral of u^2/2 there and back in 1 s, x <= 1/9",
        source=BRYSON_HO + "section 3.11: 4 / (9 L)",
        optimum=4 / (9 * CEILING),
        build=bryson_denham,
        mesh=36,
    ),
    PublishedProblem(
        name="brachistochrone",
        statement="fastest slide 10 m away and 5 m down, g = 9.81 m/s^2",
        source="closed form, the cycloid (Bernoulli 1696)",
        optimum=cycloid_time(),
        build=brachistochrone,
    ),
    PublishedProblem(
        name="robot_arm",
        statement="a telescoping arm from rest to rest in the shortest time",
        source=COPS + "problem 8",
        optimum=9.14093,
        build=robot_arm,
        mesh=400,
    ),
    PublishedProblem(
        name="particle_steering",
        statement="constant thrust to y = 5, v = (45, 0) in the shortest time",
        source=COPS + "problem 9; closed form of the linear tangent law",
        optimum=steering_time(),
        build=particle_steering,
        printed=0.554577,
        printed_tolerance=1.2e-5,
    ),
    PublishedProblem(
        name="hanging_chain",
        statement="least potential energy of a chain of length 4 from (0, 1) to (1, 3)",
        source=COPS + "problem 4; closed form of the catenary",
        optimum=chain_energy(),
        build=hanging_chain,
        printed=5.06891,
        printed_tolerance=1e-4,
        guess={
            "span": Guess(
                1.0,
                {
                    "height": column(lambda s: 1 - 2 * s + 4 * s**2),
                    "length": column(lambda s: 4 * s),
                    "slope": column(lambda s: 8 * s - 2),
                },
            )
        },
    ),
    PublishedProblem(
        name="goddard_rocket",
        statement="highest ascent with drag, thrust within [0, 3.5], 40 % of the mass burnt",
        source=COPS + "problem 10",
        optimum=1.01283,
        build=goddard_rocket,
        mesh=100,
        sign=-1.0,
        guess={"ascent": ROCKET_GUESS},
    ),
    PublishedProblem(
        name="van_der_pol",
        statement="least integral of x1^2 + x2^2 + u^2 in 5 s, -0.3 <= u <= 1",
        source="PROPT user's guide (Rutquist and Edvall 2010), example Van der Pol: 2.867259538",
        optimum=2.867259538,
        build=van_der_pol,
        mesh=100,
    ),
    PublishedProblem(
        name="van_der_pol_time",
        statement="from (1, 1) to the circle of radius 0.2 in the shortest time, |u| <= 1",
        source="Maurer, Büskens, Kim and Kaya, Optim. Control Appl. Meth. 26 (2005) 129-156; "
        "figure recomputed from its two arcs by another integrator",
        optimum=2.86419188,
        build=van_der_pol_time,
        mesh=400,
    ),
    PublishedProblem(
        name="pendulum",
        statement="swing-up in the shortest time, torque up to 0.5 m g l",
        source="Chernousko and Reshmin, Nonlinear Dynamics (2007), doi 10.1007/s11071-006-9059-3; "
        "figure by quadrature of its arcs",
        optimum=swing_up_time(),
        build=pendulum,
        mesh=400,
        guess={
            "swing": Guess(
                6.0,
                {
                    "angle": column(lambda s: pi * s - 1.5 * np.sin(pi * s)),
                    "rate": 0.5,
                    "torque": 0.0,
                },
            )
        },
    ),
    PublishedProblem(
        name="cart_pole",
        statement="swing-up in the shortest time, 1 kg + 0.3 kg at 0.5 m, force up to 10 N",
        source="cart-pole of Kelly, SIAM Review 59 (2017) 849-904; no published time: figure "
        "recomputed from its four arcs by another integrator",
        optimum=1.44650567,
        build=cart_pole,
        mesh=200,
        guess={"swing": cart_pole_guess(1.5, 0.0, 1.0)},
        tolerance=2e-4,  # the switches are no mesh points
    ),
    PublishedProblem(
        name="cart_pole_arcs",
        statement="the same as four phases of full force, either way in turn",
        source="as above",
        optimum=1.44650567,
        build=cart_pole_arcs,
        mesh=20,
        guess={f"arc {i}": cart_pole_guess(0.36, i / 4, (i + 1) / 4) for i in range(4)},
    ),
    PublishedProblem(
        name="zermelo_shear",
        statement="shortest sail to the origin in the current -y, headings 105 to 240 degrees",
        source=BRYSON_HO + "section 2.7, closed form tan(end) - tan(start)",
        optimum=tan(END_HEADING) - tan(START_HEADING),
        printed=5.46,
        printed_tolerance=1e-3,
        build=zermelo_in_a_shear,
    ),
    PublishedProblem(
        name="zermelo_vortex",
        statement="shortest flight from (-2, 0) to (0.5, -1.6) through a vortex",
        source=BRYSON_HO + "problem 1 on page 77; figure of the PROPT user's guide: 3.6820085",
        optimum=3.6820085,
        build=zermelo_in_a_vortex,
        guess={
            "fly": Guess(
                3.5,
                {
                    "x": column(lambda s: -2 + 2.5 * s),
                    "y": column(lambda s: -1.6 * s),
                    "heading": -0.5,
                },
            )
        },
    ),
    PublishedProblem(
        name="two_phases",
        statement="least integral of u^2 through 0.3 m at 1 s to rest at 1 m at 1.5 s",
        source="closed form, the clamped cubic spline",
        optimum=spline_effort(),
        build=through_a_point,
        mesh=20,
    ),
    PublishedProblem(
        name="three_phases",
        statement="5 m from rest to rest, gaining, cruising and braking, |u| <= 1, v <= 2",
        source="closed form, distance / speed + speed / acceleration",
        optimum=DISTANCE / TOP_SPEED + TOP_SPEED,
        build=trapezoid,
        mesh=20,
    ),
    PublishedProblem(
        name="goddard_phases",
        statement="the Goddard rocket as full thrust, free thrust and no thrust",
        source=COPS + "problem 10",
        optimum=1.01283,
        build=goddard_in_three_phases,
        mesh=50,
        sign=-1.0,
        guess=ROCKET_GUESSES,
    ),
)
