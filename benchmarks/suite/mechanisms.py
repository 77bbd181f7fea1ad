"""Robot arms, cranes and bodies in space."""

from __future__ import annotations

from math import cos, pi, sin
from typing import Any

import casadi as ca
import numpy as np

from benchmarks.suite.problem import (
    LUUS_PROPT,
    OPTI,
    PSOPT_EXAMPLE,
    SOURCELESS,
    SuiteProblem,
    line,
)
from microbot_ocp.ocp import Guess, OptimalControlProblem, Phase
from microbot_ocp.robot import forward_dynamics, load_robot


def luus_arm() -> OptimalControlProblem:
    """Minimise the time of Luus' two-link arm from rest to rest, torques within [-1, 1]."""
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
    """Minimise the time of two links, 0.4 m, 0.5 kg, from (0, -2) to (1, -1) rad, 10 Nm."""
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
    """Minimise the swing of a container moved by a crane in 9 s."""
    return _crane("container crane", 0.0)


def container_crane_with_effort() -> OptimalControlProblem:
    """Minimise the swing of a container moved by a crane, with a small cost on the controls."""
    return _crane("container crane with effort", 0.01)


def tracking_robot() -> OptimalControlProblem:
    """Track a corner by a robot in two phases of 1 s each."""
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
    """Minimise the fuel of Sakawa's free-flying robot with four thrusters in 12 s."""
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
    """Minimise the time to turn an asymmetric body by 150 degrees; q4 is algebraic."""
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


MANUTEC_VOLT = np.array([-126.0, 252.0, 72.0])  # torque per voltage, N m/V


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
    """Minimise the time of the Manutec r3, (0, -1.5, 0) to (1, -1.95, 1) rad, rest to rest."""
    problem, phase, _ = _manutec("Manutec r3, time", (0.1, 5.0))
    phase.end_cost(phase.duration)
    return problem


def manutec_effort() -> OptimalControlProblem:
    """Minimise the integral of squared voltages of the Manutec r3's motion in 0.53 s."""
    problem, phase, u = _manutec("Manutec r3, effort", 0.53)
    phase.running_cost(ca.sumsqr(u))
    return problem


def turbo_generator() -> OptimalControlProblem:
    """Steer a generator near a state that is no equilibrium."""
    problem = OptimalControlProblem("turbo generator")
    phase = problem.phase("only", 20.0)
    s1, s2, s3, s4 = 0.60295, 0.0, 1.87243, 0.79778
    x1, x2 = phase.state("x1", initial=s1), phase.state("x2", initial=s2)
    x3, x4 = phase.state("x3", initial=s3), phase.state("x4", initial=s4)
    u1, u2 = phase.control("u1"), phase.control("u2")
    phase.derivative(x1, x2 * x4)
    phase.derivative(x2, (u1 - 0.02535 * x2) / 0.04225)
    phase.derivative(x3, u2 - 0.17 * x3)
    phase.derivative(x4, -x1 * x2)
    phase.running_cost(2.5 * ((x1 - s1) ** 2 + (x4 - s4) ** 2) + x2**2 + 0.1 * (x3 - s3) ** 2)
    phase.running_cost((u1 - 0.80) ** 2 + (u2 - 0.73962) ** 2)
    return problem


def coulomb_friction() -> OptimalControlProblem:
    """Minimise the time to move two masses on springs with dry friction."""
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


def struck_oscillator() -> OptimalControlProblem:
    """Steer an oscillator that is struck between 0.5 s and 0.6 s: three phases."""
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


def cushioned_oscillation() -> OptimalControlProblem:
    """Minimise the time to stop an oscillating mass by a limited force."""
    problem = OptimalControlProblem("cushioned oscillation")
    phase = problem.phase("only", (0.1, 100.0))
    x = phase.state("x", initial=2.0, final=0.0)
    v = phase.state("v", initial=5.0, final=0.0)
    u = phase.control("u", lower=-5.0, upper=5.0)
    phase.derivative(x, v)
    phase.derivative(v, (u - 10 * x) / 5)
    phase.end_cost(phase.duration)
    return problem


def bouncing_ball() -> OptimalControlProblem:
    """Minimise the thrust that returns a ball, slowed at every bounce, to its height."""
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
    """Minimise the effort of a cart that moves a load; the force of the rope is algebraic."""
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


def sideways() -> OptimalControlProblem:
    """Minimise the path of a car parked 1 sideways, turning radius at least 1, both directions."""
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
    """Minimise the time to swing a pendulum up by a torque of 0.3 of its weight."""
    problem = OptimalControlProblem("weak swing-up")
    phase = problem.phase("swing", (0.1, 50.0))
    q = phase.state("q", initial=0.0, final=pi)
    w = phase.state("w", initial=0.0, final=0.0)
    u = phase.control("u", lower=-0.3, upper=0.3)
    phase.derivative(q, w)
    phase.derivative(w, u - ca.sin(q))
    phase.end_cost(phase.duration)
    return problem


def lift() -> OptimalControlProblem:
    """Minimise the time of a lift over 10 m within limits of speed, acceleration and jerk."""
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


def eight_masses() -> OptimalControlProblem:
    """Steer eight masses on hardening springs to rest by a force on the last."""
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
    SuiteProblem(turbo_generator, "smooth", "OCCAL; PROPT", 15.0198, 1e-5, OPTI, 15.01983),
    SuiteProblem(
        coulomb_friction, "bang-bang, stiff", PSOPT_EXAMPLE, 2.104992, 5e-3, OPTI, 2.11415
    ),
    SuiteProblem(struck_oscillator, "phases", LUUS_PROPT, 58.065, 1e-4, OPTI, 58.065029),
    SuiteProblem(
        cushioned_oscillation,
        "bang-bang",
        "mintOC",
        8.99177,
        1e-6,
        "closed form: circles in the phase plane",
        8.9917704583,
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
    SuiteProblem(lift, "state constraint, order 1 and 2", "closed form", 8.0, 1e-12, "closed form"),
    SuiteProblem(eight_masses, "bang-bang", SOURCELESS, 46.13947, 1e-5, OPTI),
)
