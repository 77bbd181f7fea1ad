"""Robot arms, cranes and bodies in space."""

from __future__ import annotations

from math import cos, pi, sin
from typing import Any

import casadi as ca
import numpy as np

from benchmarks.suite.problem import SuiteProblem, line
from microbot_ocp.ocp import Guess, OptimalControlProblem, Phase
from microbot_ocp.robot import forward_dynamics, load_robot


def luus_arm() -> OptimalControlProblem:
    """Luus' two-link arm from rest to rest in the shortest time, torques within [-1, 1]."""
    problem = OptimalControlProblem("two-link arm of Luus")
    phase = problem.phase("move", (1.0, 10.0))
    x1 = phase.state("x1", initial=0.0, final=0.0, lower=-2.0, upper=2.0)
    x2 = phase.state("x2", initial=0.0, final=0.0, lower=-2.0, upper=2.0)
    x3 = phase.state("x3", initial=0.5, final=0.5, lower=-2.0, upper=2.0)
    x4 = phase.state("x4", initial=0.0, final=0.522, lower=-2.0, upper=2.0)
    u1 = phase.control("u1", lower=-1.0, upper=1.0)
    u2 = phase.control("u2", lower=-1.0, upper=1.0)
    s, c = ca.sin(x3), ca.cos(x3)
    common = 31 / 36 + 9 / 4 * s**2
    first = s * (9 / 4 * c * x1**2 + 2 * x2**2) + 4 / 3 * (u1 - u2) - 3 / 2 * c * u2
    second = s * (7 / 2 * x1**2 + 9 / 4 * c * x2**2) - 7 / 3 * u2 + 3 / 2 * c * (u1 - u2)
    phase.derivative(x1, first / common)
    phase.derivative(x2, -second / common)
    phase.derivative(x3, x2 - x1)
    phase.derivative(x4, x1)
    phase.end_cost(phase.duration)
    return problem


def dissanayake_arm() -> OptimalControlProblem:
    """Two links of 0.4 m and 0.5 kg from (0, -2) to (1, -1) rad in the shortest time, 10 Nm."""
    problem = OptimalControlProblem("two-link arm of Dissanayake")
    phase = problem.phase("move", (0.1, 50.0))
    q1 = phase.state("q1", initial=0.0, final=1.0, unit="rad")
    q2 = phase.state("q2", initial=-2.0, final=-1.0, unit="rad")
    w1 = phase.state("w1", initial=0.0, final=0.0, unit="rad/s")
    w2 = phase.state("w2", initial=0.0, final=0.0, unit="rad/s")
    torque1 = phase.control("torque1", lower=-10.0, upper=10.0, unit="N m")
    torque2 = phase.control("torque2", lower=-10.0, upper=10.0, unit="N m")
    length, mass, inertia, centre = 0.4, 0.5, 0.1, 0.2
    across = mass * length * centre * ca.cos(q2)
    h = mass * length * centre * ca.sin(q2)
    h11 = 2 * inertia + mass * centre**2 + mass * (length**2 + centre**2) + 2 * across
    h22 = inertia + mass * centre**2
    h12 = h22 + across
    determinant = h11 * h22 - h12**2
    left1 = torque1 + h * (2 * w1 * w2 + w2**2)
    left2 = torque2 - h * w1**2
    phase.derivative(q1, w1)
    phase.derivative(q2, w2)
    phase.derivative(w1, (h22 * left1 - h12 * left2) / determinant)
    phase.derivative(w2, (h11 * left2 - h12 * left1) / determinant)
    phase.end_cost(phase.duration)
    return problem


def _crane(name: str, effort: float) -> OptimalControlProblem:
    problem = OptimalControlProblem(name)
    phase = problem.phase("move", 9.0)
    x = phase.state("x", initial=0.0, final=10.0)
    rope = phase.state("rope", initial=22.0, final=14.0)
    swing = phase.state("swing", initial=0.0, final=0.0)
    v = phase.state("v", initial=0.0, final=2.5, lower=-2.5, upper=2.5)
    hoist = phase.state("hoist", initial=-1.0, final=0.0, lower=-1.0, upper=1.0)
    rate = phase.state("rate", initial=0.0, final=0.0)
    u1 = phase.control("u1", lower=-2.83374, upper=2.83374)
    u2 = phase.control("u2", lower=-0.80865, upper=0.71265)
    phase.derivative(x, v)
    phase.derivative(rope, hoist)
    phase.derivative(swing, rate)
    phase.derivative(v, u1 + 17.2656 * swing)
    phase.derivative(hoist, u2)
    phase.derivative(rate, -(u1 + 27.0756 * swing + 2 * hoist * rate) / rope)
    phase.running_cost(0.5 * (swing**2 + rate**2 + effort * (u1**2 + u2**2)))
    return problem


def container_crane() -> OptimalControlProblem:
    """A container moved by a crane in 9 s with the least swing."""
    return _crane("container crane", 0.0)


def container_crane_with_effort() -> OptimalControlProblem:
    """The same with a small cost on the controls."""
    return _crane("container crane with effort", 0.01)


def tracking_robot() -> OptimalControlProblem:
    """A robot tracks a corner in two phases of 1 s each."""
    problem = OptimalControlProblem("two-phase robot")
    phases = []
    for k, (start, end) in enumerate((((0.0, 0.0, 0.5, 0.0), None), (None, (0.5, 0.5, 0.0, 0.5)))):
        phase = problem.phase(f"side {k + 1}", 1.0)
        x, y, vx, vy = (
            phase.state(
                name,
                initial=None if start is None else start[i],
                final=None if end is None else end[i],
                lower=-10.0,
                upper=10.0,
            )
            for i, name in enumerate(("x", "y", "vx", "vy"))
        )
        u1 = phase.control("u1", lower=-10.0, upper=10.0)
        u2 = phase.control("u2", lower=-10.0, upper=10.0)
        phase.derivative(x, vx)
        phase.derivative(y, vy)
        phase.derivative(vx, u1)
        phase.derivative(vy, u2)
        wanted = (phase.time / 2, 0, 0.5, 0) if k == 0 else (0.5, phase.time / 2, 0, 0.5)
        near = (x - wanted[0]) ** 2 + (y - wanted[1]) ** 2
        fast = (vx - wanted[2]) ** 2 + (vy - wanted[3]) ** 2
        phase.running_cost(100 * near + 500 * fast)
        phases.append(phase)
    problem.link(*phases)
    return problem


def free_flying_robot() -> OptimalControlProblem:
    """Sakawa's free-flying robot in 12 s with the least fuel, four thrusters."""
    problem = OptimalControlProblem("free-flying robot")
    phase = problem.phase("fly", 12.0)
    x = phase.state("x", initial=-10.0, final=0.0)
    y = phase.state("y", initial=-10.0, final=0.0)
    angle = phase.state("angle", initial=pi / 2, final=0.0)
    vx = phase.state("vx", initial=0.0, final=0.0)
    vy = phase.state("vy", initial=0.0, final=0.0)
    rate = phase.state("rate", initial=0.0, final=0.0)
    u1, u2, u3, u4 = (phase.control(f"u{i}", lower=0.0) for i in (1, 2, 3, 4))
    thrust = u1 - u2 + u3 - u4
    phase.derivative(x, vx)
    phase.derivative(y, vy)
    phase.derivative(angle, rate)
    phase.derivative(vx, thrust * ca.cos(angle))
    phase.derivative(vy, thrust * ca.sin(angle))
    phase.derivative(rate, 0.2 * (u1 - u2) - 0.2 * (u3 - u4))
    phase.constraint("first pair", u1 + u2, upper=1.0)
    phase.constraint("second pair", u3 + u4, upper=1.0)
    phase.running_cost(u1 + u2 + u3 + u4)
    return problem


def reorientation() -> OptimalControlProblem:
    """An asymmetric body turned by 150 degrees in the shortest time; q4 is algebraic."""
    problem = OptimalControlProblem("reorientation")
    phase = problem.phase("turn", (25.0, 35.0))
    half = 75 * pi / 180
    q1 = phase.state("q1", initial=0.0, final=sin(half), lower=-1.0, upper=1.0)
    q2 = phase.state("q2", initial=0.0, final=0.0, lower=-1.0, upper=1.0)
    q3 = phase.state("q3", initial=0.0, final=0.0, lower=-1.0, upper=1.0)
    w1, w2, w3 = (
        phase.state(f"w{i}", initial=0.0, final=0.0, lower=-0.5, upper=0.5) for i in (1, 2, 3)
    )
    u1, u2, u3 = (phase.control(f"u{i}", lower=-50.0, upper=50.0, unit="N m") for i in (1, 2, 3))
    q4 = phase.control("q4", lower=-1.0, upper=1.0)
    ix, iy, iz = 5621.0, 4547.0, 2364.0
    phase.derivative(q1, 0.5 * (w1 * q4 - w2 * q3 + w3 * q2))
    phase.derivative(q2, 0.5 * (w1 * q3 + w2 * q4 - w3 * q1))
    phase.derivative(q3, 0.5 * (-w1 * q2 + w2 * q1 + w3 * q4))
    phase.derivative(w1, (u1 - (iz - iy) * w2 * w3) / ix)
    phase.derivative(w2, (u2 - (ix - iz) * w1 * w3) / iy)
    phase.derivative(w3, (u3 - (iy - ix) * w1 * w2) / iz)
    phase.constraint("norm", q1**2 + q2**2 + q3**2 + q4**2, 1.0, 1.0)
    phase.end_cost(phase.duration)
    return problem


def _reorientation_guess() -> dict[str, Guess]:
    half = 75 * pi / 180
    values = {"q1": line(0.0, sin(half)), "q4": line(1.0, cos(half))}
    values |= dict.fromkeys(("q2", "q3", "w1", "w2", "w3"), 0.0)
    values |= dict.fromkeys(("u1", "u2", "u3"), 50.0)
    return {"turn": Guess(35.0, values)}


MANUTEC_VOLT = np.array([-126.0, 252.0, 72.0])  # N m per V


def _manutec(name: str, duration: float | tuple[float, float]) -> tuple[Any, Phase, Any]:
    robot = load_robot("manutec_r3")
    bounds = robot.limits
    problem = OptimalControlProblem(name)
    phase = problem.phase("move", duration)
    q = phase.state(
        "q", 3, initial=[0.0, -1.5, 0.0], final=[1.0, -1.95, 1.0], lower=bounds.q_min,
        upper=bounds.q_max, unit="rad",
    )  # fmt: skip
    qd = phase.state(
        "qd", 3, initial=[0.0] * 3, final=[0.0] * 3, lower=bounds.qd_min, upper=bounds.qd_max,
        unit="rad/s",
    )  # fmt: skip
    u = phase.control("u", 3, lower=-7.5, upper=7.5, unit="V")
    phase.derivative(q, qd)
    phase.derivative(qd, forward_dynamics(robot)(q, qd, MANUTEC_VOLT * u))
    return problem, phase, u


def manutec_time() -> OptimalControlProblem:
    """The Manutec r3 from rest at (0, -1.5, 0) to rest at (1, -1.95, 1) rad in the least time."""
    problem, phase, _ = _manutec("Manutec r3, time", (0.1, 5.0))
    phase.end_cost(phase.duration)
    return problem


def manutec_effort() -> OptimalControlProblem:
    """The same in 0.53 s with the least integral of the voltages' squares."""
    problem, phase, u = _manutec("Manutec r3, effort", 0.53)
    phase.running_cost(ca.sumsqr(u))
    return problem


PROBLEMS = (
    SuiteProblem(
        luus_arm,
        kind="bang-bang",
        source="Luus, Iterative Dynamic Programming (2000), section 12.4.2: 2.98227994254954",
        published=2.98227994254954,
        tolerance=1e-6,
        confirmed="fine mesh",
    ),
    SuiteProblem(
        dissanayake_arm,
        kind="bang-bang",
        source="Dissanayake, Goh and Phan-Thien, Robotica 9 (1991); PROPT guide, time-optimal "
        "trajectories for robot manipulators: 0.391854539515663",
        published=0.391854539515663,
        tolerance=1e-4,
        confirmed="fine mesh",
    ),
    SuiteProblem(
        container_crane,
        kind="singular, state constraint",
        source="Sakawa and Shindo 1982; Teo, Goh and Wong (1991); PSOPT example crane: 5.1513e-3",
        published=5.1513e-3,
        reference=5.15045e-3,
        tolerance=1e-3,
        confirmed="fine mesh",
    ),
    SuiteProblem(
        container_crane_with_effort,
        kind="state constraint",
        source="Betts, Practical Methods (2010), section 10; MAPTOR example container_crane: "
        "0.0375195",
        published=0.0375195,
        tolerance=2e-6,
        confirmed="fine mesh",
    ),
    SuiteProblem(
        tracking_robot,
        kind="phases",
        source="PSOPT example twophase_robot: 1.042568",
        published=1.042568,
        tolerance=1e-3,
        confirmed="convex program with exact integrals",
        reference=1.04168614,
    ),
    SuiteProblem(
        free_flying_robot,
        kind="bang-bang",
        source="Sakawa, Optim. Control Appl. Meth. 20 (1999); Betts, Practical Methods (2010), "
        "example 6.13: 7.910154",
        published=7.910154,
        tolerance=3e-2,
        confirmed="simulated by another integrator; the printed figure is a local optimum",
        reference=7.6887,
    ),
    SuiteProblem(
        reorientation,
        kind="algebraic, bang-bang",
        source="Betts, Practical Methods (2010), example 6.12: 28.630408; PSOPT: 28.6304",
        published=28.630408,
        tolerance=2e-5,
        confirmed="fine mesh",
        guess=_reorientation_guess,
    ),
    SuiteProblem(
        manutec_time,
        kind="bang-bang, state constraint",
        source="Otter and Tuerk, DFVLR-Mitteilung 88-13 (1988), model 2; Betts, Practical Methods "
        "(2010): 0.4951963",
        published=0.4951963,
        reference=0.495189035837,
        tolerance=2e-5,
        confirmed="nine arcs by Newton's method",
    ),
    SuiteProblem(
        manutec_effort,
        kind="state constraint",
        source="Otter and Tuerk, DFVLR-Mitteilung 88-13 (1988), model 2; Betts, Practical Methods "
        "(2010): 20.404247",
        published=20.404247,
        tolerance=5e-8,
        confirmed="fine mesh",
    ),
)
