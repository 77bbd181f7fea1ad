"""Singular arcs, chattering and bang-bang controls."""

from __future__ import annotations

from math import pi, sqrt

import casadi as ca
import numpy as np

from benchmarks.suite.problem import (
    LUUS_PROPT,
    OPTI,
    PROPT,
    SuiteProblem,
    along,
    line,
)
from microbot_ocp.ocp import Guess, OptimalControlProblem, Phase


def _integrators(
    name: str, duration: float, start: tuple[float, ...]
) -> tuple[OptimalControlProblem, Phase, list[ca.MX]]:
    """Declare a chain of integrators with its control within [-1, 1]."""
    problem = OptimalControlProblem(name)
    phase = problem.phase("only", duration)
    x = [phase.state(f"x{i + 1}", initial=value) for i, value in enumerate(start)]
    u = phase.control("u", lower=-1.0, upper=1.0)
    for state, slope in zip(x, [*x[1:], u], strict=True):
        phase.derivative(state, slope)
    return problem, phase, x


def luus_singular_1() -> OptimalControlProblem:
    """Minimise half the integral of x^2 with x' = u from 1 in 2 s."""
    problem, phase, x = _integrators("Luus, singular control 1", 2.0, (1.0,))
    phase.running_cost(0.5 * x[0] ** 2)
    return problem


def luus_singular_3() -> OptimalControlProblem:
    """Minimise the integral of x1^2 + x2^2 of a double integrator from (0, 1) in 5 s."""
    problem, phase, x = _integrators("Luus, singular control 3", 5.0, (0.0, 1.0))
    phase.running_cost(x[0] ** 2 + x[1] ** 2)
    return problem


def luus_singular_4() -> OptimalControlProblem:
    """Minimise the integral of x1^2 of a triple integrator from (1, 0, 0) in 5 s."""
    problem, phase, x = _integrators("Luus, singular control 4", 5.0, (1.0, 0.0, 0.0))
    phase.running_cost(x[0] ** 2)
    return problem


def luus_singular_5() -> OptimalControlProblem:
    """Minimise Luus' third-order singular problem on [0, 1], u within [0, 10]."""
    problem = OptimalControlProblem("Luus, singular control 5")
    phase = problem.phase("only", 1.0)
    x1 = phase.state("x1", initial=0.0)
    x2 = phase.state("x2", initial=-1.0)
    x3 = phase.state("x3", initial=-sqrt(5))
    u = phase.control("u", lower=0.0, upper=10.0)
    ramp = 16 * phase.time - 8
    phase.derivative(x1, x2)
    phase.derivative(x2, -x3 * u + ramp)
    phase.derivative(x3, u)
    phase.running_cost(x1**2 + x2**2 + 0.0005 * (x2 + ramp - 0.1 * x3 * u**2) ** 2)
    return problem


def bressan() -> OptimalControlProblem:
    """Maximise the integral of x2 - x1^2 with x1' = u, x2' = -x1 from rest in 10 s."""
    problem = OptimalControlProblem("Bressan")
    phase = problem.phase("only", 10.0)
    x1 = phase.state("x1", initial=0.0)
    x2 = phase.state("x2", initial=0.0)
    x3 = phase.state("x3", initial=0.0)
    u = phase.control("u", lower=-1.0, upper=1.0)
    phase.derivative(x1, u)
    phase.derivative(x2, -x1)
    phase.derivative(x3, x2 - x1**2)
    phase.end_cost(-x3)
    return problem


def slow_transfer() -> OptimalControlProblem:
    """Minimise half of time and integral of v^2 from rest at 2 to rest at 5, |u| <= 1."""
    problem = OptimalControlProblem("singular transfer")
    phase = problem.phase("move", (2.0, 8.0))
    x = phase.state("x", initial=2.0, final=5.0, lower=-10.0, upper=10.0)
    v = phase.state("v", initial=0.0, final=0.0, lower=-5.0, upper=5.0)
    u = phase.control("u", lower=-1.0, upper=1.0)
    phase.derivative(x, v)
    phase.derivative(v, u)
    phase.running_cost(0.5 * (1 + v**2))
    return problem


def fuller() -> OptimalControlProblem:
    """Minimise the integral of x^2 from (0, 1) to rest at 0 in 3.5 s, |u| <= 1 (Fuller)."""
    problem = OptimalControlProblem("Fuller")
    phase = problem.phase("only", 3.5)
    x = phase.state("x", initial=0.0, final=0.0)
    v = phase.state("v", initial=1.0, final=0.0)
    u = phase.control("u", lower=-1.0, upper=1.0)
    phase.derivative(x, v)
    phase.derivative(v, u)
    phase.running_cost(x**2)
    return problem


def goddard_in_feet() -> OptimalControlProblem:
    """Maximise the height of Goddard's rocket in feet, pounds of force and slugs."""
    problem = OptimalControlProblem("Goddard rocket in feet")
    phase = problem.phase("ascent", (20.0, 100.0))
    h = phase.state("h", initial=0.0, lower=0.0, upper=30000.0, unit="ft")
    v = phase.state("v", initial=0.0, lower=0.0, upper=15000.0, unit="ft/s")
    m = phase.state("m", initial=3.0, final=1.0, lower=1.0, upper=3.0, unit="slug")
    thrust = phase.control("thrust", lower=0.0, upper=193.044, unit="lbf")
    drag = 5.49153484923381010e-05 * v**2 * ca.exp(-h / 23800)
    phase.derivative(h, v)
    phase.derivative(v, (thrust - drag) / m - 32.174)
    phase.derivative(m, -thrust / 1580.9425279876559)
    phase.end_cost(-h)
    return problem


def _goddard_guess() -> dict[str, Guess]:
    values = {"h": 0.0, "v": 0.0, "m": line(3.0, 1.0), "thrust": line(0.0, 193.044)}
    return {"ascent": Guess(100.0, values)}


def fishing() -> OptimalControlProblem:
    """Steer fished Lotka-Volterra populations near 1 for 12 years, relaxed."""
    problem = OptimalControlProblem("fishing")
    phase = problem.phase("years", 12.0)
    prey = phase.state("prey", initial=0.5, lower=0.0, upper=2.0)
    predator = phase.state("predator", initial=0.7, lower=0.0, upper=2.0)
    boats = phase.control("boats", lower=0.0, upper=1.0)
    phase.derivative(prey, prey - prey * predator - 0.4 * prey * boats)
    phase.derivative(predator, -predator + prey * predator - 0.2 * predator * boats)
    phase.running_cost((prey - 1) ** 2 + (predator - 1) ** 2)
    return problem


def _f8_slopes(a, c, b, w):
    """Return the slopes of angle of attack, pitch and pitch rate c at the elevator's w."""
    attack = -0.877 * a + c - 0.088 * a * c + 0.47 * a**2 - 0.019 * b**2 - a**2 * c + 3.846 * a**3
    attack += -0.215 * w + 0.28 * a**2 * w + 0.47 * a * w**2 + 0.63 * w**3
    rate = -4.208 * a - 0.396 * c - 0.47 * a**2 - 3.564 * a**3
    rate += -20.967 * w + 6.265 * a**2 * w + 46 * a * w**2 + 61.4 * w**3
    return attack, c, rate


def f8_aircraft() -> OptimalControlProblem:
    """Minimise the time of an F-8 aircraft to level flight, elevator within 0.05236 rad."""
    problem = OptimalControlProblem("F-8 aircraft")
    phase = problem.phase("recover", (1.0, 8.0))
    attack = phase.state("attack", initial=0.4655, final=0.0, lower=-2.0, upper=2.0)
    pitch = phase.state("pitch", initial=0.0, final=0.0, lower=-2.0, upper=2.0)
    rate = phase.state("rate", initial=0.0, final=0.0, lower=-2.0, upper=2.0)
    elevator = phase.control("elevator", lower=-0.05236, upper=0.05236)
    slopes = _f8_slopes(attack, rate, pitch, elevator)
    for state, slope in zip((attack, pitch, rate), slopes, strict=True):
        phase.derivative(state, slope)
    phase.end_cost(phase.duration)
    return problem


def _f8_guess() -> dict[str, Guess]:
    """Return a guess by simulation: full deflection, switched near the times of the source."""
    duration, steps = 3.781, 400
    times = np.linspace(0.0, duration, steps + 1)
    up = (times < 1.135) | ((times >= 1.482) & (times < 3.089))
    elevator = np.where(up, 0.05236, -0.05236)
    states = [np.array([0.4655, 0.0, 0.0])]
    for w in elevator[:-1]:
        z, h = states[-1], duration / steps
        middle = z + h / 2 * np.array(_f8_slopes(z[0], z[2], z[1], w))
        states.append(z + h * np.array(_f8_slopes(middle[0], middle[2], middle[1], w)))
    table = np.array(states)

    def sampled(values: np.ndarray):
        return along(lambda s: np.interp(s * duration, times, values))

    values = {name: sampled(table[:, i]) for i, name in enumerate(("attack", "pitch", "rate"))}
    return {"recover": Guess(duration, {**values, "elevator": sampled(elevator)})}


def bridge_crane() -> OptimalControlProblem:
    """Minimise the time of a bridge crane and its load over 15 m from rest to rest, |u| <= 1."""
    problem = OptimalControlProblem("bridge crane")
    phase = problem.phase("move", (0.1, 100.0))
    x = phase.state("x", initial=0.0, final=15.0)
    v = phase.state("v", initial=0.0, final=0.0)
    swing = phase.state("swing", initial=0.0, final=0.0)
    rate = phase.state("rate", initial=0.0, final=0.0)
    u = phase.control("u", lower=-1.0, upper=1.0)
    phase.derivative(x, v)
    phase.derivative(v, u)
    phase.derivative(swing, rate)
    phase.derivative(rate, -0.98 * swing + 0.1 * u)
    phase.end_cost(phase.duration)
    return problem


def _bridge_crane_guess() -> dict[str, Guess]:
    values = {"x": line(0.0, 15.0), "v": 0.0, "swing": 0.0, "rate": 0.0, "u": line(1.0, -1.0)}
    return {"move": Guess(8.0, values)}


def dielectrophoresis() -> OptimalControlProblem:
    """Minimise the time to move a particle from 1 to 2 by a field within [-1, 1]."""
    problem = OptimalControlProblem("dielectrophoretic particle")
    phase = problem.phase("move", (1.0, 100.0))
    x = phase.state("x", initial=1.0, final=2.0)
    y = phase.state("y", initial=0.0)
    u = phase.control("u", lower=-1.0, upper=1.0)
    phase.derivative(x, y * u - 0.75 * u**2)
    phase.derivative(y, -y + u)
    phase.end_cost(phase.duration)
    return problem


def _dielectrophoresis_guess() -> dict[str, Guess]:
    return {"move": Guess(10.0, {"x": line(1.0, 2.0), "y": 0.0, "u": 1.0})}


def two_masses_and_a_spring() -> OptimalControlProblem:
    """Minimise the time of two unit masses with a unit spring, pushed at one, rest to rest."""
    problem = OptimalControlProblem("two masses and a spring")
    phase = problem.phase("move", (0.1, 20.0))
    x1, x2 = (phase.state(name, initial=0.0, final=1.0) for name in ("x1", "x2"))
    v1, v2 = (phase.state(name, initial=0.0, final=0.0) for name in ("v1", "v2"))
    u = phase.control("u", lower=-1.0, upper=1.0)
    phase.derivative(x1, v1)
    phase.derivative(x2, v2)
    phase.derivative(v1, u - (x1 - x2))
    phase.derivative(v2, x1 - x2)
    phase.end_cost(phase.duration)
    return problem


def jackson() -> OptimalControlProblem:
    """Maximise the product of Jackson's catalyst blend after 4, blend within [0, 1]."""
    problem = OptimalControlProblem("Jackson")
    phase = problem.phase("reactor", 4.0)
    a = phase.state("a", initial=1.0, lower=0.0, upper=1.1)
    b = phase.state("b", initial=0.0, lower=0.0, upper=1.1)
    c = phase.state("c", initial=0.0, lower=0.0, upper=1.1)
    u = phase.control("u", lower=0.0, upper=1.0)
    phase.derivative(a, -u * (a - 10 * b))
    phase.derivative(b, u * (a - 10 * b) - (1 - u) * b)
    phase.derivative(c, (1 - u) * b)
    phase.end_cost(-c)
    return problem


def _catalyst(name: str, length: float) -> OptimalControlProblem:
    problem = OptimalControlProblem(name)
    phase = problem.phase("reactor", length)
    a = phase.state("a", initial=1.0)
    b = phase.state("b", initial=0.0)
    u = phase.control("u", lower=0.0, upper=1.0)
    phase.derivative(a, u * (10 * b - a))
    phase.derivative(b, u * (a - 10 * b) - (1 - u) * b)
    phase.end_cost(a + b - 1)
    return problem


def catalyst_mixing() -> OptimalControlProblem:
    """Maximise the product of catalyst mixing in a reactor of length 1."""
    return _catalyst("catalyst mixing", 1.0)


def catalyst_mixing_long() -> OptimalControlProblem:
    """Maximise the product of catalyst mixing in a reactor of length 12."""
    return _catalyst("catalyst mixing, long", 12.0)


FINE = "fine mesh"
LUUS = "Luus, Iterative Dynamic Programming (2000), section 10.2; PROPT guide: "
PSOPT = "Becerra, PSOPT application examples (release 5), "
CTDIRECT = "CTDirect.jl test problems (control-toolbox), "


def rayleigh_in_least_time() -> OptimalControlProblem:
    """Minimise the time of Rayleigh's equation from (-5, -5) to rest, |u| <= 4."""
    problem = OptimalControlProblem("Rayleigh in least time")
    phase = problem.phase("only", (0.1, 100.0))
    x1 = phase.state("x1", initial=-5.0, final=0.0)
    x2 = phase.state("x2", initial=-5.0, final=0.0)
    u = phase.control("u", lower=-1.0, upper=1.0)
    phase.derivative(x1, x2)
    phase.derivative(x2, -x1 + x2 * (1.4 - 0.14 * x2**2) + 4 * u)
    phase.end_cost(phase.duration)
    return problem


def double_oscillator() -> OptimalControlProblem:
    """Minimise motion and control of two masses on springs shaken by a sine; u is the damping."""
    problem = OptimalControlProblem("double oscillator")
    phase = problem.phase("period", 2 * pi)
    x1, x2 = phase.state("x1", initial=0.0), phase.state("x2", initial=0.0)
    v1, v2 = phase.state("v1"), phase.state("v2")
    u = phase.control("u", lower=-1.0, upper=1.0)
    phase.derivative(x1, v1)
    phase.derivative(x2, v2)
    phase.derivative(v1, (-103 * x1 + 3 * x2 + ca.sin(phase.time)) / 100)
    phase.derivative(v2, (3 * x1 - 3 * x2 - 0.5 * (1 - u) * v2) / 2)
    phase.running_cost(0.5 * (x1**2 + x2**2 + u**2))
    return problem


def four_integrators() -> OptimalControlProblem:
    """Minimise the time of a chain of four integrators to rest."""
    problem = OptimalControlProblem("four integrators")
    phase = problem.phase("only", (0.1, 100.0))
    chain = [
        phase.state(f"x{k}", initial=start, final=0.0)
        for k, start in enumerate((0.1, 0.2, 0.3, 0.0), start=1)
    ]
    u = phase.control("u", lower=-1.0, upper=1.0)
    for state, slope in zip(chain, [*chain[1:], u], strict=True):
        phase.derivative(state, slope)
    phase.end_cost(phase.duration)
    return problem


def nishida() -> OptimalControlProblem:
    """Minimise the final state of two damped oscillators by one bounded control."""
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


def third_order() -> OptimalControlProblem:
    """Minimise the time of a third-order system with drag and friction to rest."""
    problem = OptimalControlProblem("third order")
    phase = problem.phase("move", (0.1, 100.0))
    x1 = phase.state("x1", initial=0.0, final=2.0)
    x2 = phase.state("x2", initial=0.931, final=0.0)
    x3 = phase.state("x3", initial=0.9, final=0.0)
    u = phase.control("u", lower=-1.0, upper=1.0)
    phase.derivative(x1, x2)
    phase.derivative(x2, -x2 - 0.1 * x2**3 + x3)
    phase.derivative(x3, -2 * x3 - 0.2 * x3 / ca.sqrt(x3**2 + 1e-4) + 2 * u)
    phase.end_cost(phase.duration)
    return problem


def marchal() -> OptimalControlProblem:
    """Minimise half the integral of x^2: chattering into a singular arc at rest, and out of it."""
    problem = OptimalControlProblem("Marchal")
    phase = problem.phase("only", 8.0)
    x = phase.state("x", initial=2.0, final=2.0)
    y = phase.state("y", initial=-2.0, final=2.0)
    u = phase.control("u", lower=-1.0, upper=1.0)
    phase.derivative(x, y)
    phase.derivative(y, u)
    phase.running_cost(0.5 * x**2)
    return problem


def van_der_pol_in_least_time() -> OptimalControlProblem:
    """Minimise the time of the Van der Pol oscillator, (-0.4, 0.6) to (0.6, 0.4), |u| <= 1."""
    problem = OptimalControlProblem("Van der Pol in least time")
    phase = problem.phase("only", (0.1, 10.0))
    x1 = phase.state("x1", initial=-0.4, final=0.6)
    x2 = phase.state("x2", initial=0.6, final=0.4)
    u = phase.control("u", lower=-1.0, upper=1.0)
    phase.derivative(x1, x2)
    phase.derivative(x2, -x1 - (x1**2 - 1) * x2 + u)
    phase.end_cost(phase.duration)
    return problem


PROBLEMS = (
    SuiteProblem(
        luus_singular_1,
        kind="singular",
        source=LUUS + "0.16666570",
        published=1 / 6,
        tolerance=1e-9,
        confirmed="closed form",
    ),
    SuiteProblem(
        luus_singular_3,
        kind="singular",
        source=LUUS + "0.75399456",
        published=0.75399456,
        tolerance=2e-5,
        confirmed=FINE,
        reference=0.7539839,
    ),
    SuiteProblem(
        luus_singular_4,
        kind="singular",
        source=LUUS + "1.25238965",
        published=1.25238965,
        tolerance=3e-4,
        confirmed=FINE,
        reference=1.25210,
    ),
    SuiteProblem(
        luus_singular_5,
        kind="singular",
        source=PSOPT + "section 7: 0.1192613 (Luus 2000)",
        published=0.1192613,
        tolerance=2e-4,
        confirmed=FINE,
        reference=0.1192477,
    ),
    SuiteProblem(
        bressan,
        kind="bang-singular",
        source="Bressan, Viscosity solutions of Hamilton-Jacobi equations; PROPT guide, singular "
        "control 6; closed form 500/9",
        published=500 / 9,
        tolerance=1e-9,
        confirmed="closed form",
        sign=-1.0,
    ),
    SuiteProblem(
        slow_transfer,
        kind="bang-singular",
        source="PSOPT example singular_di: 3.333328; closed form 10/3",
        published=3.333328,
        tolerance=2e-6,
        reference=10 / 3,
        confirmed="closed form",
    ),
    SuiteProblem(
        fuller,
        kind="chattering",
        source=CTDIRECT + "fuller (Bocop): 2.683944e-1",
        published=0.2683944,
        tolerance=2e-6,
        confirmed=FINE,
    ),
    SuiteProblem(
        goddard_in_feet,
        kind="bang-singular",
        source="YAPSS example goddard_problem_1_phase (GPOPS manual): 18550.87",
        published=18550.8718638,
        tolerance=3e-4,
        confirmed=FINE,
        sign=-1.0,
        guess=_goddard_guess,
    ),
    SuiteProblem(
        fishing,
        kind="bang-singular",
        source="Sager, mintoc.de, Lotka-Volterra fishing problem, relaxed: 1.34408",
        published=1.34408,
        tolerance=1e-5,
        confirmed=FINE,
    ),
    SuiteProblem(
        f8_aircraft,
        kind="bang-bang",
        source="Sager, mintoc.de, F-8 aircraft (Garrard and Jordan 1977): 3.78086",
        published=3.78086,
        tolerance=1e-5,
        confirmed="arcs by another integrator",
        reference=3.780855775,
        guess=_f8_guess,
    ),
    SuiteProblem(
        bridge_crane,
        kind="bang-bang",
        source="Luus (2000), section 12.4.1; PROPT guide, section 16: 8.5789",
        published=8.5789336,
        tolerance=2e-4,
        confirmed="arcs in closed form",
        reference=8.5801026371,
        guess=_bridge_crane_guess,
    ),
    SuiteProblem(
        dielectrophoresis,
        kind="bang-bang",
        source="Chang, Petit and Rouchon, IEEE TAC 51 (2006); PROPT guide: 7.8112",
        published=7.8112,
        tolerance=2e-5,
        confirmed=FINE,
        reference=7.811311,
        guess=_dielectrophoresis_guess,
    ),
    SuiteProblem(
        jackson,
        kind="bang-singular",
        source=CTDIRECT + "jackson (Bocop): 0.192011",
        published=0.192011,
        tolerance=1.2e-3,
        confirmed=FINE,
        reference=0.1918143,
        sign=-1.0,
    ),
    SuiteProblem(
        catalyst_mixing,
        kind="bang-singular",
        source="COPS 3.0 (Dolan, Moré, Munson 2004), problem 14: -4.80556e-2",
        published=-0.0480556,
        tolerance=1e-5,
        confirmed=FINE,
    ),
    SuiteProblem(
        catalyst_mixing_long,
        kind="bang-singular",
        source="Gunn and Thomas, Chem. Eng. Sci. 20 (1965); Luus (2000): 0.477",
        published=-0.477,
        tolerance=2e-3,
        confirmed=FINE,
        reference=-0.477711,
    ),
    SuiteProblem(
        two_masses_and_a_spring,
        kind="bang-bang",
        source="Liu and Wie, J. Guid. Control Dyn. 15 (1992): 4.218",
        published=4.218,
        reference=4.21786651,
        tolerance=5e-5,
        confirmed="closed form of the arcs",
    ),
    SuiteProblem(
        rayleigh_in_least_time,
        kind="bang-bang",
        source="Maurer and Augustin, in Online Optimization of Large Scale Systems (2001): 3.66817",
        published=3.66817,
        tolerance=1e-05,
        confirmed="fine mesh",
    ),
    SuiteProblem(
        double_oscillator,
        kind="smooth",
        source="Coudurier, Lepreux and Petit (2018); OptimalControlProblems.jl, no figure",
        published=0.000911034863,
        tolerance=1e-05,
        confirmed="fine mesh",
    ),
    SuiteProblem(
        four_integrators,
        "bang-bang",
        "the equations of three switches",
        4.831895,
        1e-6,
        "solved for the arcs",
    ),
    SuiteProblem(
        nishida, "bang-bang, linear", LUUS_PROPT, 1.0035, 1e-3, "Opti on 600 intervals", 1.0034994
    ),
    SuiteProblem(third_order, "bang-bang, stiff", PROPT, 2.94565, 1e-5, OPTI),
    SuiteProblem(marchal, "chattering, singular", "Marchal 1973", 1.51523, 2e-5, OPTI),
    SuiteProblem(
        van_der_pol_in_least_time, "bang-bang", "Kaya and Noakes 2003", 1.2540747, 1e-6, OPTI
    ),
)
