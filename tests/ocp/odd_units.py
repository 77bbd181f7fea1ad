"""Problems of COPS 3.0 in units that nobody would choose, without a scale."""

from __future__ import annotations

from math import pi

import casadi as ca
import numpy as np

from microbot_ocp.ocp import OptimalControlProblem

EARTH, GRAVITY, MASS = 6.371e6, 9.81, 3000.0  # m, m/s^2, kg
GODDARD = 1.01283  # highest distance over the starting one, COPS 3.0, problem 10


def goddard_in_si() -> OptimalControlProblem:
    """The rocket of COPS, from a planet as large as the Earth; its numbers span six decades."""
    weight, orbit = MASS * GRAVITY, np.sqrt(EARTH * GRAVITY)
    problem = OptimalControlProblem("Goddard rocket")
    ascent = problem.phase("ascent", (40.0, 800.0))
    height = ascent.state("height", lower=0.0, initial=0.0, unit="m")
    speed = ascent.state("speed", lower=0.0, initial=0.0, unit="m/s")
    mass = ascent.state("mass", lower=0.6 * MASS, upper=MASS, initial=MASS, final=0.6 * MASS)
    thrust = ascent.control("thrust", lower=0.0, upper=3.5 * weight, unit="N")
    drag = 310 * weight * (speed / orbit) ** 2 * ca.exp(-500 * height / EARTH)
    ascent.derivative(height, speed)
    ascent.derivative(speed, (thrust - drag) / mass - GRAVITY / (1 + height / EARTH) ** 2)
    ascent.derivative(mass, -thrust / (0.5 * orbit))
    ascent.end_cost(-height)
    return problem


def robot_arm(length_unit: float, time_unit: float) -> OptimalControlProblem:
    """The arm of COPS in units so many times smaller than those of the source."""
    m, s = length_unit, time_unit
    force, torque = m / s**2, m**3 / s**2
    problem = OptimalControlProblem("robot arm")
    phase = problem.phase("move", (1.0 * s, 20.0 * s))
    rho = phase.state("rho", initial=4.5 * m, final=4.5 * m, lower=0.0, upper=5.0 * m)
    theta = phase.state("theta", initial=0.0, final=2 * pi / 3, lower=-pi, upper=pi)
    phi = phase.state("phi", initial=pi / 4, final=pi / 4, lower=0.0, upper=pi)
    rates = [
        phase.state(f"{name} rate", initial=0.0, final=0.0) for name in ("rho", "theta", "phi")
    ]
    u_rho = phase.control("u_rho", lower=-force, upper=force)
    u_theta = phase.control("u_theta", lower=-torque, upper=torque)
    u_phi = phase.control("u_phi", lower=-torque, upper=torque)
    inertia = ((5.0 * m - rho) ** 3 + rho**3) / 3
    for state, rate in zip((rho, theta, phi), rates, strict=True):
        phase.derivative(state, rate)
    phase.derivative(rates[0], u_rho / 5)
    phase.derivative(rates[1], u_theta / (inertia * ca.sin(phi) ** 2))
    phase.derivative(rates[2], u_phi / inertia)
    phase.end_cost(phase.duration)
    return problem
