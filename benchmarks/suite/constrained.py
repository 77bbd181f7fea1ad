"""State constraints of order one to three, and obstacles."""

from __future__ import annotations

import casadi as ca

from benchmarks.suite.problem import (
    OPTI,
    PSOPT_EXAMPLE,
    SuiteProblem,
)
from microbot_ocp.ocp import OptimalControlProblem


def _there_and_back(name: str, ceiling: float) -> OptimalControlProblem:
    problem = OptimalControlProblem(name)
    phase = problem.phase("fly", 1.0)
    x = phase.state("x", initial=0.0, final=0.0, upper=ceiling)
    v = phase.state("v", initial=1.0, final=-1.0)
    u = phase.control("u")
    phase.derivative(x, v)
    phase.derivative(v, u)
    phase.running_cost(0.5 * u**2)
    return problem


def breakwell() -> OptimalControlProblem:
    """Minimise half the integral of u^2 there and back in 1 s, x <= 0.1: an arc on the limit."""
    return _there_and_back("Breakwell", 0.1)


def bryson_denham_touch() -> OptimalControlProblem:
    """Minimise half the integral of u^2 there and back in 1 s, x <= 0.2: touched at one instant."""
    return _there_and_back("Bryson-Denham, touched", 0.2)


def jacobson_lele() -> OptimalControlProblem:
    """Minimise the integral of x1^2 + x2^2 + 0.005 u^2 with x2 <= 8 (t - 1/2)^2 - 1/2."""
    problem = OptimalControlProblem("Jacobson and Lele")
    phase = problem.phase("only", 1.0)
    x1 = phase.state("x1", initial=0.0)
    x2 = phase.state("x2", initial=-1.0)
    u = phase.control("u", lower=-20.0, upper=20.0)
    phase.derivative(x1, x2)
    phase.derivative(x2, -x2 + u)
    phase.constraint("limit", x2 - 8 * (phase.time - 0.5) ** 2 + 0.5, upper=0.0)
    phase.running_cost(x1**2 + x2**2 + 0.005 * u**2)
    return problem


def robbins() -> OptimalControlProblem:
    """Minimise the integral of 3 x + u^2/2, triple integrator, (1, -2, 0) to rest, x >= 0."""
    problem = OptimalControlProblem("Robbins")
    phase = problem.phase("only", 10.0)
    x1 = phase.state("x1", initial=1.0, final=0.0, lower=0.0)
    x2 = phase.state("x2", initial=-2.0, final=0.0)
    x3 = phase.state("x3", initial=0.0, final=0.0)
    u = phase.control("u")
    phase.derivative(x1, x2)
    phase.derivative(x2, x3)
    phase.derivative(x3, u)
    phase.running_cost(3 * x1 + 0.5 * u**2)
    return problem


def alp_rider() -> OptimalControlProblem:
    """Steer stiff dynamics over a floor with four peaks for 20 s."""
    problem = OptimalControlProblem("Alp rider")
    phase = problem.phase("ride", 20.0)
    starts, ends = (2.0, 1.0, 2.0, 1.0), (2.0, 3.0, 1.0, -2.0)
    x1, x2, x3, x4 = (
        phase.state(f"x{i + 1}", initial=start, final=end)
        for i, (start, end) in enumerate(zip(starts, ends, strict=True))
    )
    u1 = phase.control("u1")
    u2 = phase.control("u2")
    phase.derivative(x1, -10 * x1 + u1 + u2)
    phase.derivative(x2, -2 * x2 + u1 + 2 * u2)
    phase.derivative(x3, -3 * x3 + 5 * x4 + u1 - u2)
    phase.derivative(x4, 5 * x3 - 3 * x4 + u1 + 3 * u2)
    square = x1**2 + x2**2 + x3**2 + x4**2

    def peak(place: float, width: float) -> ca.MX:
        return ca.exp(-width * (phase.time - place) ** 2)

    floor = 3 * peak(3, 12) + 3 * peak(6, 10) + 3 * peak(10, 6) + 8 * peak(15, 4) + 0.01
    phase.constraint("floor", square - floor, lower=0.0)
    phase.running_cost(100 * square + 0.01 * (u1**2 + u2**2))
    return problem


def two_obstacles() -> OptimalControlProblem:
    """Move at speed 2.138 to (1.2, 1.6) in 1 s around two discs; all feasible paths cost alike."""
    problem = OptimalControlProblem("two obstacles")
    phase = problem.phase("drive", 1.0)
    x = phase.state("x", initial=0.0, final=1.2, lower=0.0, upper=2.0)
    y = phase.state("y", initial=0.0, final=1.6, lower=0.0, upper=2.0)
    heading = phase.control("heading", lower=-10.0, upper=10.0)
    vx, vy = 2.138 * ca.cos(heading), 2.138 * ca.sin(heading)
    phase.derivative(x, vx)
    phase.derivative(y, vy)
    phase.constraint("first disc", (x - 0.4) ** 2 + (y - 0.5) ** 2, lower=0.1)
    phase.constraint("second disc", (x - 0.8) ** 2 + (y - 1.5) ** 2, lower=0.1)
    phase.running_cost(vx**2 + vy**2)
    return problem


def van_der_pol_with_limit() -> OptimalControlProblem:
    """Steer the Van der Pol oscillator of CasADi's examples with x1 >= -0.25."""
    problem = OptimalControlProblem("Van der Pol")
    phase = problem.phase("only", 10.0)
    x1 = phase.state("x1", initial=0.0, lower=-0.25)
    x2 = phase.state("x2", initial=1.0)
    u = phase.control("u", lower=-1.0, upper=1.0)
    phase.derivative(x1, (1 - x2**2) * x1 - x2 + u)
    phase.derivative(x2, x1)
    phase.running_cost(x1**2 + x2**2 + u**2)
    return problem


def limited_rate() -> OptimalControlProblem:
    """Minimise the effort from rest to rest with a force that changes by at most 4 per second."""
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


def egerstedt() -> OptimalControlProblem:
    """Steer a system with three mixed modes and a state that has to stay above 0.4."""
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


def windowed_speed() -> OptimalControlProblem:
    """Move from rest to rest with a speed limit in the middle only, modelled by a steep gate."""
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
    """Minimise the time of a slide to x = 1 above the wall y = x / 2 + 0.1, y downwards."""
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


def beam() -> OptimalControlProblem:
    """Minimise the effort on a beam under a limit of 0.1, in Bocop's formulation."""
    problem = OptimalControlProblem("beam")
    phase = problem.phase("only", 1.0)
    x1 = phase.state("x1", initial=0.0, final=0.0, lower=0.0, upper=0.1)
    x2 = phase.state("x2", initial=1.0, final=-1.0)
    u = phase.control("u", lower=-10.0, upper=10.0)
    phase.derivative(x1, x2)
    phase.derivative(x2, u)
    phase.running_cost(u**2)
    return problem


ROOF = 0.25


def touching() -> OptimalControlProblem:
    """Minimise the jerk of a motion that touches a limit of order three once."""
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


PROBLEMS = (
    SuiteProblem(
        breakwell,
        kind="state constraint, order 2",
        source="PSOPT example breakwell; Bryson and Ho, section 3.11: 4 / (9 L)",
        published=4 / 0.9,
        tolerance=1e-9,
        confirmed="closed form",
    ),
    SuiteProblem(
        bryson_denham_touch,
        kind="state constraint, order 2",
        source="Bryson and Ho, section 3.11, 1/6 <= L <= 1/4: 2 + 6 (1 - 4 L)^2",
        published=2 + 6 * (1 - 0.8) ** 2,
        tolerance=1e-9,
        confirmed="closed form",
    ),
    SuiteProblem(
        jacobson_lele,
        kind="state constraint, order 1",
        source="Jacobson and Lele, IEEE TAC 14 (1969); PSOPT example stc1: 0.1698180",
        published=0.1698180,
        tolerance=2e-5,
        confirmed="fine mesh",
    ),
    SuiteProblem(
        robbins,
        kind="state constraint, order 3",
        source="Robbins, JOTA 1980; CTDirect.jl test problem robbins (Bocop): 19.4",
        published=19.4,
        reference=19.4318,
        tolerance=3e-3,
        confirmed="fine mesh",
    ),
    SuiteProblem(
        alp_rider,
        kind="stiff, state constraint",
        source="Betts, Practical Methods (2010), example 4.12: 2030.85609",
        published=2030.85609,
        tolerance=1e-6,
        confirmed="fine mesh",
    ),
    SuiteProblem(
        two_obstacles,
        kind="obstacles, no unique optimum",
        source="PSOPT example obstacle: 4.571044, the square of the speed",
        published=4.571044,
        tolerance=1e-9,
        confirmed="closed form",
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
        limited_rate,
        kind="state constraint",
        source="PSOPT example control_rate: 1.846315",
        published=1.846315,
        tolerance=0.0001,
        reference=1.846154,
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
        windowed_speed, "state constraint", PSOPT_EXAMPLE, 12.97886, 2e-4, OPTI, 12.980094
    ),
    SuiteProblem(
        walled_brachistochrone,
        "state constraint",
        "Bryson and Ho 1975, section 3.11",
        1.834,
        1e-4,
        OPTI,
        1.8340032,
    ),
    SuiteProblem(beam, "state constraint, order 2", "Bocop", 80 / 9, 1e-9, "closed form"),
    SuiteProblem(
        touching,
        "state constraint, order 3",
        "closed form",
        256.0,
        1e-12,
        "the least norm with the value in the middle",
    ),
)
