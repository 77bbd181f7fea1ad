"""Chemical reactors and fermentors."""

from __future__ import annotations

import casadi as ca
import numpy as np

from benchmarks.suite.problem import (
    LUUS_PROPT,
    OPTI,
    PROPT,
    SuiteProblem,
    line,
)
from microbot_ocp.ocp import Guess, OptimalControlProblem


def batch_reactor() -> OptimalControlProblem:
    """Maximise B of A -> B -> C after 1 h by the temperature within [298, 398] K."""
    problem = OptimalControlProblem("batch reactor")
    phase = problem.phase("batch", 1.0)
    a = phase.state("a", initial=1.0)
    b = phase.state("b", initial=0.0)
    temperature = phase.control("temperature", lower=298.0, upper=398.0, unit="K")
    first = 4000 * ca.exp(-2500 / temperature)
    second = 620000 * ca.exp(-5000 / temperature)
    phase.derivative(a, -first * a**2)
    phase.derivative(b, first * a**2 - second * b)
    phase.end_cost(-b)
    return problem


def _batch_reactor_guess() -> dict[str, Guess]:
    return {"batch": Guess(1.0, {"a": 1.0, "b": 0.0, "temperature": line(398.0, 298.0)})}


def stirred_tank() -> OptimalControlProblem:
    """Steer Luus' first-order exothermic reaction to rest; a worse local optimum is 0.2444."""
    problem = OptimalControlProblem("stirred tank")
    phase = problem.phase("settle", 0.78)
    x1 = phase.state("x1", initial=0.09)
    x2 = phase.state("x2", initial=0.09)
    u = phase.control("u", lower=0.0, upper=5.0)
    rate = (x2 + 0.5) * ca.exp(25 * x1 / (x1 + 2))
    phase.derivative(x1, -2 * (x1 + 0.25) + rate - u * (x1 + 0.25))
    phase.derivative(x2, 0.5 - x2 - rate)
    phase.running_cost(x1**2 + x2**2 + 0.1 * u**2)
    return problem


def four_reactions() -> OptimalControlProblem:
    """Maximise the profit of four simultaneous reactions in a stirred tank, four controls, 0.2."""
    problem = OptimalControlProblem("four reactions")
    phase = problem.phase("run", 0.2)
    starts = (0.1883, 0.2507, 0.0467, 0.0899, 0.1804, 0.1394, 0.1046)
    x1, x2, x3, x4, x5, x6, x7 = (
        phase.state(f"x{i + 1}", initial=start) for i, start in enumerate(starts)
    )
    u1 = phase.control("u1", lower=0.0, upper=20.0)
    u2 = phase.control("u2", lower=0.0, upper=6.0)
    u3 = phase.control("u3", lower=0.0, upper=4.0)
    u4 = phase.control("u4", lower=0.0, upper=20.0)
    q = u1 + u2 + u4
    phase.derivative(x1, u4 - q * x1 - 17.6 * x1 * x2 - 23 * x1 * x6 * u3)
    phase.derivative(x2, u1 - q * x2 - 17.6 * x1 * x2 - 146 * x2 * x3)
    phase.derivative(x3, u2 - q * x3 - 73 * x2 * x3)
    phase.derivative(x4, -q * x4 + 35.2 * x1 * x2 - 51.3 * x4 * x5)
    phase.derivative(x5, -q * x5 + 219 * x2 * x3 - 51.3 * x4 * x5)
    phase.derivative(x6, -q * x6 + 102.6 * x4 * x5 - 23 * x1 * x6 * u3)
    phase.derivative(x7, -q * x7 + 46 * x1 * x6 * u3)
    profit = 5.8 * (q * x1 - u4) - 3.7 * u1 - 4.1 * u2
    profit += q * (23 * x4 + 11 * x5 + 28 * x6 + 35 * x7) - 5 * u3**2 - 0.099
    phase.running_cost(-profit)
    return problem


def ethanol() -> OptimalControlProblem:
    """Maximise ethanol of a fed-batch fermentation in 63 h, feed at most 12 l/h, at most 200 l."""
    problem = OptimalControlProblem("ethanol")
    phase = problem.phase("ferment", 63.0)
    cells = phase.state("cells", initial=1.0, lower=0.0, unit="g/l")
    glucose = phase.state("glucose", initial=150.0, lower=0.0, unit="g/l")
    product = phase.state("product", initial=0.0, lower=0.0, unit="g/l")
    volume = phase.state("volume", initial=10.0, lower=0.0, upper=200.0, unit="l")
    feed = phase.control("feed", lower=0.0, upper=12.0, unit="l/h")
    growth = 0.408 / (1 + product / 16) * glucose / (0.22 + glucose)
    making = 1 / (1 + product / 71.5) * glucose / (0.44 + glucose)
    phase.derivative(cells, growth * cells - feed * cells / volume)
    phase.derivative(glucose, -10 * growth * cells + feed * (150 - glucose) / volume)
    phase.derivative(product, making * cells - feed * product / volume)
    phase.derivative(volume, feed)
    phase.end_cost(-product * volume)
    return problem


# Measured fractions of gas oil and gasoline, COPS 3.0.
_TIMES = (
    0.0, 0.025, 0.05, 0.075, 0.1, 0.125, 0.15, 0.175, 0.2, 0.225, 0.25,
    0.3, 0.35, 0.4, 0.45, 0.5, 0.55, 0.65, 0.75, 0.85, 0.95,
)  # fmt: skip
_OIL = (
    1.0, 0.8105, 0.6208, 0.5258, 0.4345, 0.3903, 0.3342, 0.3034, 0.2735, 0.2405, 0.2283,
    0.2071, 0.1669, 0.153, 0.1339, 0.1265, 0.12, 0.099, 0.087, 0.077, 0.069,
)  # fmt: skip
_GASOLINE = (
    0.0, 0.2, 0.2886, 0.301, 0.3215, 0.3123, 0.2716, 0.2551, 0.2258, 0.1959, 0.1789,
    0.1457, 0.1198, 0.0909, 0.0719, 0.0561, 0.046, 0.028, 0.019, 0.014, 0.01,
)  # fmt: skip


def cracking() -> OptimalControlProblem:
    """Fit three rates of catalytic cracking of gas oil to 21 measurements."""
    problem = OptimalControlProblem("catalytic cracking")
    a, b, c = (problem.free_parameter(f"rate {i}", lower=0.0, upper=20.0) for i in (1, 2, 3))
    phase = problem.phase("all", _TIMES[-1])
    oil = phase.state("oil", initial=_OIL[0], lower=0.0, upper=2.0)
    gasoline = phase.state("gasoline", initial=_GASOLINE[0], lower=0.0, upper=2.0)
    phase.derivative(oil, -(a + c) * oil**2)
    phase.derivative(gasoline, a * oil**2 - b * gasoline)
    data = phase.measurement("data", _TIMES, np.transpose([_OIL, _GASOLINE]))
    phase.point_cost(ca.sumsqr(ca.vertcat(oil, gasoline) - data))
    return problem


_MINUTES = (1230, 3060, 4920, 7800, 10680, 15030, 22620, 36420)
_ISOMERS = (
    (88.35, 76.4, 65.1, 50.4, 37.5, 25.9, 14.0, 4.5),
    (7.3, 15.6, 23.1, 32.9, 42.7, 49.1, 57.4, 63.1),
    (2.3, 4.5, 5.3, 6.0, 6.0, 5.9, 5.1, 3.8),
    (0.4, 0.7, 1.1, 1.5, 1.9, 2.2, 2.6, 2.9),
    (1.75, 2.8, 5.8, 9.3, 12.0, 17.0, 21.0, 25.7),
)


def isomerisation() -> OptimalControlProblem:
    """Fit five rates of alpha-pinene isomerisation, six orders apart from 1, to 8 measurements."""
    problem = OptimalControlProblem("alpha-pinene")
    k = problem.free_parameter("k", 5, lower=0.0, upper=0.01, unit="1/min")
    phase = problem.phase("all", float(_MINUTES[-1]))
    y = phase.state("y", 5, initial=[100.0, 0.0, 0.0, 0.0, 0.0], unit="%")
    to_third, back = k[1] * y[0], k[4] * y[4]
    slopes = (
        -k[0] * y[0] - to_third,
        k[0] * y[0],
        to_third - (k[2] + k[3]) * y[2] + back,
        k[2] * y[2],
        k[3] * y[2] - back,
    )
    phase.derivative(y, ca.vertcat(*slopes))
    data = phase.measurement("data", _MINUTES, np.transpose(_ISOMERS))
    phase.point_cost(ca.sumsqr(y - data))
    return problem


def isomerisation_in_phases() -> OptimalControlProblem:
    """Fit the isomerisation in a phase between any two measurements, with rates as states."""
    problem, before = OptimalControlProblem("alpha-pinene phases"), None
    times = (0.0, *map(float, _MINUTES))
    for number, data in enumerate(np.transpose(_ISOMERS)):
        phase = problem.phase(f"to sample {number}", times[number + 1] - times[number])
        start = None if before else [100.0, 0.0, 0.0, 0.0, 0.0]
        y, k = phase.state("y", 5, initial=start), phase.state("k", 5, lower=0.0)
        to_third, back = k[1] * y[0], k[4] * y[4]
        slopes = (
            -k[0] * y[0] - to_third,
            k[0] * y[0],
            to_third - (k[2] + k[3]) * y[2] + back,
            k[2] * y[2],
            k[3] * y[2] - back,
        )
        phase.derivative(y, ca.vertcat(*slopes))
        phase.derivative(k, ca.MX.zeros(5))
        phase.end_cost(ca.sumsqr(y - ca.DM(data)))
        if before is not None:
            problem.link(before, phase)
        before = phase
    return problem


_SAMPLES = (
    0.0, 0.05, 0.065, 0.08, 0.123, 0.233, 0.273, 0.354, 0.397, 0.418, 0.502, 0.553, 0.681, 0.75,
    0.916, 0.937, 1.122,
)  # fmt: skip
_METHANOL = (
    1.0, 0.7085, 0.5971, 0.5537, 0.3684, 0.1712, 0.1198, 0.0747, 0.0529, 0.0415, 0.0261, 0.0208,
    0.0085, 0.0053, 0.0019, 0.0018, 0.0006,
)  # fmt: skip
_OLEFINS = (
    0.0, 0.1621, 0.1855, 0.1989, 0.2845, 0.3491, 0.3098, 0.3576, 0.3347, 0.3388, 0.3557, 0.3483,
    0.3836, 0.3611, 0.3609, 0.3485, 0.3698,
)  # fmt: skip
_HYDROCARBONS = (
    0.0, 0.0811, 0.0965, 0.1198, 0.1535, 0.2097, 0.2628, 0.2467, 0.2884, 0.2757, 0.3167, 0.2954,
    0.295, 0.2937, 0.2831, 0.2846, 0.2899,
)  # fmt: skip


def methanol() -> OptimalControlProblem:
    """Fit five rates of methanol to hydrocarbons, one of them zero, to 17 measurements."""
    problem = OptimalControlProblem("methanol")
    a, b, c, d, e = (problem.free_parameter(f"rate {i}", lower=0.0) for i in range(1, 6))
    phase = problem.phase("all", _SAMPLES[-1])
    y1 = phase.state("methanol", initial=1.0)
    y2 = phase.state("olefins", initial=0.0)
    y3 = phase.state("hydrocarbons", initial=0.0)
    whole = (b + e) * y1 + y2
    phase.derivative(y1, -(2 * b - a * y2 / whole + c + d) * y1)
    phase.derivative(y2, a * y1 * (b * y1 - y2) / whole + c * y1)
    phase.derivative(y3, a * y1 * (y2 + e * y1) / whole + d * y1)
    seen = np.transpose([_METHANOL, _OLEFINS, _HYDROCARBONS])
    data = phase.measurement("data", _SAMPLES, seen)
    phase.point_cost(ca.sumsqr(ca.vertcat(y1, y2, y3) - data))
    return problem


def parallel_reactions() -> OptimalControlProblem:
    """Maximise B at the end of a plug-flow reactor with two parallel reactions."""
    problem = OptimalControlProblem("parallel reactions")
    phase = problem.phase("along", 1.0)
    a = phase.state("a", initial=1.0)
    b = phase.state("b", initial=0.0)
    u = phase.control("u", lower=0.0, upper=5.0)
    phase.derivative(a, -(u + u**2 / 2) * a)
    phase.derivative(b, u * a)
    phase.end_cost(-b)
    return problem


RATES = np.array(  # ten reactions, by powers of the fraction of one catalyst
    [
        [0.2918487e-2, -0.8045787e-2, 0.6749947e-2, -0.1416647e-2],
        [0.9509977e1, -0.3500994e2, 0.4283329e2, -0.1733333e2],
        [0.2682093e2, -0.9556079e2, 0.1130398e3, -0.4429997e2],
        [0.2087241e3, -0.7198052e3, 0.8277466e3, -0.3166655e3],
        [0.1350005e1, -0.6850027e1, 0.1216671e2, -0.6666689e1],
        [0.1921995e-1, -0.7945320e-1, 0.1105666, -0.5033333e-1],
        [0.1323596, -0.4696255, 0.5539323, -0.2166664],
        [0.7339981e1, -0.2527328e2, 0.2993329e2, -0.1199999e2],
        [-0.3950534, 0.1679353e1, -0.1777829e1, 0.4974987],
        [-0.2504665e-4, 0.1005854e-1, -0.1986696e-1, 0.9833470e-2],
    ]
)


def bifunctional_catalyst() -> OptimalControlProblem:
    """Maximise benzene from methylcyclopentane by a blend of two catalysts: hundreds of optima."""
    problem = OptimalControlProblem("bifunctional catalyst", maximize=True)
    phase = problem.phase("bed", 2000.0)
    x = [phase.state(f"x{k}", initial=float(k == 1)) for k in range(1, 8)]
    u = phase.control("u", lower=0.6, upper=0.9)
    k = [sum(float(c) * u**power for power, c in enumerate(row)) for row in RATES]
    phase.derivative(x[0], -k[0] * x[0])
    phase.derivative(x[1], k[0] * x[0] - (k[1] + k[2]) * x[1] + k[3] * x[4])
    phase.derivative(x[2], k[1] * x[1])
    phase.derivative(x[3], -k[5] * x[3] + k[4] * x[4])
    made = k[2] * x[1] + k[5] * x[3] + k[6] * x[5] + k[9] * x[6]
    phase.derivative(x[4], made - (k[3] + k[4] + k[7] + k[8]) * x[4])
    phase.derivative(x[5], k[7] * x[4] - k[6] * x[5])
    phase.derivative(x[6], k[8] * x[4] - k[9] * x[6])
    phase.end_cost(x[6])
    return problem


FINE = "fine mesh"


def double_tank() -> OptimalControlProblem:
    """Track a level in the lower one of two tanks, inflow from 1 to 2."""
    problem = OptimalControlProblem("double tank")
    phase = problem.phase("only", 10.0)
    upper = phase.state("upper", initial=2.0, lower=1e-6)
    lower = phase.state("lower", initial=2.0, lower=1e-6)
    flow = phase.control("flow", lower=1.0, upper=2.0)
    phase.derivative(upper, flow - ca.sqrt(upper))
    phase.derivative(lower, ca.sqrt(upper) - ca.sqrt(lower))
    phase.running_cost(2 * (lower - 3) ** 2)
    return problem


def oil_shale() -> OptimalControlProblem:
    """Maximise bitumen by temperature and time of a pyrolysis."""
    problem = OptimalControlProblem("oil shale", maximize=True)
    phase = problem.phase("only", (9.1, 12.0))
    kerogen = phase.state("kerogen", initial=1.0, lower=0.0, upper=1.0)
    bitumen = phase.state("bitumen", initial=0.0, lower=0.0, upper=1.0)
    temperature = phase.control("temperature", lower=698.15, upper=748.15, unit="K")
    exponents = (8.86, 24.25, 23.67, 18.75, 20.70)
    energies = np.array([20300.0, 37400.0, 33800.0, 28200.0, 31000.0]) / 1.9872
    k = [ca.exp(a - b / temperature) for a, b in zip(exponents, energies, strict=True)]
    phase.derivative(kerogen, -k[0] * kerogen - (k[2] + k[3] + k[4]) * kerogen * bitumen)
    phase.derivative(bitumen, k[0] * kerogen - k[1] * bitumen + k[2] * kerogen * bitumen)
    phase.end_cost(bitumen)
    return problem


def two_stage_reactor() -> OptimalControlProblem:
    """Minimise the time of two stirred tanks to their steady state."""
    problem = OptimalControlProblem("two-stage reactor")
    phase = problem.phase("only", (0.1, 100.0))
    starts = (0.1962, -0.0372, 0.0946, 0.0)
    x1, x2, x3, x4 = (
        phase.state(f"x{k}", initial=start, final=0.0) for k, start in enumerate(starts, start=1)
    )
    u1 = phase.control("u1", lower=-1.0, upper=1.0)
    u2 = phase.control("u2", lower=-1.0, upper=1.0)
    first = 1.5e7 * (0.5251 - x1) * ca.exp(-10 / (x2 + 0.6932)) - 1.4280
    first -= 1.5e10 * (0.4748 + x1) * ca.exp(-15 / (x2 + 0.6932))
    second = 1.5e7 * (0.4236 - x2) * ca.exp(-10 / (x4 + 0.6560)) - 0.5086
    second -= 1.5e10 * (0.5764 + x3) * ca.exp(-15 / (x4 + 0.6560))
    phase.derivative(x1, -3 * x1 + first)
    phase.derivative(x2, -11.1558 * x2 + first - 8.1558 * (x2 + 0.1592) * u1)
    phase.derivative(x3, 1.5 * (0.5 * x1 - x3) + second)
    phase.derivative(x4, 0.75 * x2 - 4.9385 * x4 + second - 3.4385 * (x4 + 0.122) * u2)
    phase.end_cost(phase.duration)
    return problem


def penicillin() -> OptimalControlProblem:
    """Maximise penicillin by the feed of a fermentation of 126 h."""
    problem = OptimalControlProblem("penicillin", maximize=True)
    phase = problem.phase("only", 126.0)
    biomass = phase.state("biomass", initial=1.5, lower=0.0, upper=40.0)
    product = phase.state("product", initial=0.0, lower=0.0, upper=50.0)
    substrate = phase.state("substrate", initial=0.0, lower=0.0, upper=25.0)
    volume = phase.state("volume", initial=7.0, lower=0.0, upper=10.0)
    feed = phase.control("feed", lower=0.0, upper=50.0)
    growth = 0.11 * substrate / (0.006 * biomass + substrate)
    making = 0.0055 * substrate / (0.0001 + substrate * (1 + 10 * substrate))
    upkeep = 0.029 * substrate / (0.0001 + substrate)
    phase.derivative(biomass, growth * biomass - feed * biomass / 500 / volume)
    phase.derivative(product, making * biomass - 0.01 * product - feed * product / 500 / volume)
    phase.derivative(
        substrate,
        -(growth / 0.47 + making / 1.2 + upkeep) * biomass + feed / volume * (1 - substrate / 500),
    )
    phase.derivative(volume, feed / 500)
    phase.end_cost(product * volume)
    return problem


def gas_absorber() -> OptimalControlProblem:
    """Steer six plates of an absorber to their steady state."""
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


def food_sterilization() -> OptimalControlProblem:
    """Minimise the loss of quality of a can that is heated until germs are dead, and cooled."""
    problem = OptimalControlProblem("sterilization")
    phase = problem.phase("heat", 1500.0)
    core = phase.state("core", initial=20.0)
    outside = phase.state("outside", initial=20.0)
    killed = phase.state("killed", initial=0.0)
    lost = phase.state("lost", initial=0.0)
    heat = phase.control("heat", lower=0.0, upper=50.0)
    phase.derivative(core, 0.01 * (outside - core))
    phase.derivative(outside, 0.005 * (20 - outside) + 0.01 * heat)
    phase.derivative(killed, ca.exp(np.log(10) / 10 * (core - 121.11)))
    phase.derivative(lost, ca.exp(np.log(10) / 25.56 * (core - 121.11)))
    phase.end_cost(lost + (killed - 100) ** 2 + (core - 40) ** 2)
    return problem


def plug_flow() -> OptimalControlProblem:
    """Maximise the product of a tubular reactor whose temperature is limited."""
    problem = OptimalControlProblem("plug flow", maximize=True)
    phase = problem.phase("flow", 5.0)
    product = phase.state("product", initial=0.0, lower=0.0, upper=10.0)
    temperature = phase.state("temperature", initial=380.0, lower=100.0, upper=460.0, unit="K")
    cooling = phase.control("cooling", lower=0.0, upper=0.5)
    k1 = 1.7536e5 * ca.exp(-1.1374e4 / 1.9872 / temperature)
    k2 = 2.4885e10 * ca.exp(-2.2748e4 / 1.9872 / temperature)
    made = (1 - product) * k1 - product * k2
    phase.derivative(product, made)
    phase.derivative(temperature, 300 * made - cooling * (temperature - 290))
    phase.end_cost(product)
    return problem


def crystalliser() -> OptimalControlProblem:
    """Minimise the volume of new crystals while seeds of potassium sulphate grow by cooling."""
    problem = OptimalControlProblem("crystalliser")
    phase = problem.phase("batch", 1800.0)
    new = [phase.state(f"new {k}", initial=0.0) for k in range(4)]
    seeds = 66.6667
    starts = (seeds * 275.0, seeds * 75750.0, seeds * 20968750.0)
    grown = [phase.state(f"grown {k + 1}", initial=start) for k, start in enumerate(starts)]
    dissolved = phase.state("dissolved", initial=0.1742)
    temperature = phase.state("temperature", initial=50.0, lower=30.0, upper=50.0, unit="C")
    cooling = phase.control("cooling", lower=0.0, upper=0.05, unit="K/s")
    soluble = 6.29e-2 + 2.46e-3 * temperature - 7.14e-6 * temperature**2
    metastable = 7.76e-2 + 2.46e-3 * temperature - 8.10e-6 * temperature**2
    above = ((dissolved - soluble) / soluble) ** 2 + 1e-8
    kelvin = temperature + 273.15
    growth = 1.44e8 * ca.exp(-4859 / kelvin) * above**0.75
    birth = 285.0 * ca.exp(-7517 / kelvin) * above**0.725 * (new[3] + grown[2])
    phase.derivative(new[0], birth)
    for k in (1, 2, 3):
        phase.derivative(new[k], k * growth * new[k - 1])
    phase.derivative(grown[0], growth * seeds)
    phase.derivative(grown[1], 2 * growth * grown[0])
    phase.derivative(grown[2], 3 * growth * grown[1])
    phase.derivative(dissolved, -3 * 2.66e-12 * 1.5 * growth * (new[2] + grown[1]))
    phase.derivative(temperature, -cooling)
    phase.constraint("not dissolving", dissolved - soluble, lower=0.0)
    phase.constraint("metastable", metastable - dissolved, lower=0.0)
    phase.end_constraint("large enough", grown[2], lower=8.3301e9)
    phase.end_cost(new[3])
    return problem


def hicks_ray() -> OptimalControlProblem:
    """Steer a stirred tank to an unstable steady state."""
    problem = OptimalControlProblem("Hicks and Ray")
    phase = problem.phase("change", 120.0)
    c = phase.state("c", initial=0.98, final=0.2632, lower=0.0, upper=1.0)
    temperature = phase.state("temperature", initial=0.39, final=0.6519, lower=0.0, upper=1.0)
    u = phase.control("u", lower=0.0, upper=2.0)
    reaction = 300 * c * ca.exp(-5 / temperature)
    phase.derivative(c, (1 - c) / 20 - reaction)
    phase.derivative(
        temperature,
        (0.3947 - temperature) / 20 + reaction - 600 * 1.95e-4 * u * (temperature - 0.38158),
    )
    phase.running_cost((c - 0.2632) ** 2 + (temperature - 0.6519) ** 2 + (u - 0.76) ** 2)
    return problem


PROBLEMS = (
    SuiteProblem(
        batch_reactor,
        kind="units",
        source="DYNOPT user's guide 4.1, example 6; PROPT guide, section 13: 0.6107994",
        published=0.6107994,
        tolerance=1e-5,
        confirmed=FINE,
        sign=-1.0,
        guess=_batch_reactor_guess,
    ),
    SuiteProblem(
        stirred_tank,
        kind="local optima",
        source="Luus and Cormack, Can. J. Chem. Eng. 50 (1972); Luus (2000): 0.133094",
        published=0.133094,
        tolerance=2e-5,
        confirmed=FINE,
    ),
    SuiteProblem(
        four_reactions,
        kind="bang-singular",
        source="Luus, Int. J. Control 51 (1990): 21.757, controls constant on 20 stages",
        published=21.757,
        tolerance=4e-3,
        confirmed=FINE,
        reference=21.8245,
        sign=-1.0,
    ),
    SuiteProblem(
        ethanol,
        kind="bang-singular, units",
        source="Chen and Hwang, Ind. Eng. Chem. Res. 29 (1990); Luus (1993): 20841",
        published=20841.0,
        tolerance=5e-4,
        confirmed=FINE,
        sign=-1.0,
    ),
    SuiteProblem(
        isomerisation,
        kind="parameters, data",
        source="COPS 3.0 (Dolan, Moré, Munson 2004), problem 12 (Box et al. 1973): 19.8721",
        published=19.8721,
        tolerance=1e-5,
        confirmed=FINE,
    ),
    SuiteProblem(
        isomerisation_in_phases,
        kind="parameters, data, phases",
        source="COPS 3.0 (Dolan, Moré, Munson 2004), problem 12 (Box et al. 1973): 19.8721",
        published=19.8721,
        tolerance=1e-5,
        confirmed=FINE,
    ),
    SuiteProblem(
        cracking,
        kind="parameters, data",
        source="COPS 3.0 (Dolan, Moré, Munson 2004), problem 13: 5.23664e-3; PSOPT: 5.228971e-3",
        published=5.23664e-3,
        tolerance=1e-5,
        confirmed=FINE,
    ),
    SuiteProblem(
        methanol,
        kind="parameters, data",
        source="COPS 3.0 (Dolan, Moré, Munson 2004), problem 14: 9.02229e-3",
        published=9.02229e-3,
        tolerance=1e-5,
        confirmed="SciPy's least squares and LSODA from twelve starts",
    ),
    SuiteProblem(
        parallel_reactions,
        kind="smooth",
        source="Dadebo and McAuley, Comput. Chem. Eng. 19 (1995); PROPT guide, plug-flow reactor: "
        "0.57353",
        published=0.57353,
        reference=0.573545,
        tolerance=5e-5,
        confirmed=FINE,
        sign=-1.0,
    ),
    SuiteProblem(
        bifunctional_catalyst,
        kind="stiff, local optima",
        source="Luus, Dittrich and Keil, Can. J. Chem. Eng. 70 (1992): 10.0942e-3 on ten stages",
        published=10.0942e-3,
        tolerance=1e-3,
        confirmed="exponentials of matrices on 17 stages before a free switch; the policy that is "
        "printed gives 10.09416e-3",
        reference=10.1037e-3,
        sign=-1.0,
    ),
    SuiteProblem(
        double_tank,
        kind="bang-singular",
        source="mintOC: double tank, relaxed",
        published=4.731306,
        tolerance=1e-05,
        confirmed="fine mesh",
    ),
    SuiteProblem(
        oil_shale,
        "bang-singular",
        "Carrasco and Banga 1997; PROPT",
        0.353,
        3e-3,
        OPTI,
        0.353815,
        sign=-1.0,
        guess=lambda: {"only": Guess(9.3, {"temperature": 725.0})},
    ),
    SuiteProblem(
        two_stage_reactor,
        "bang-bang, stiff",
        LUUS_PROPT,
        0.3244,
        3e-3,
        "Opti on 100 intervals",
        0.32365,
        guess=lambda: {"only": Guess(0.3, {"x1": 0.1962, "x2": -0.0372, "x3": 0.0946, "x4": 0.0})},
    ),
    SuiteProblem(
        penicillin,
        "bang-singular, local optima",
        "Cuthrell and Biegler 1989",
        87.69,
        2e-3,
        OPTI,
        87.832,
        sign=-1.0,
    ),
    SuiteProblem(gas_absorber, "linear", LUUS_PROPT, 0.13375, 1e-4, OPTI, 0.13375113),
    SuiteProblem(
        food_sterilization,
        "bang-bang, local optima, units",
        PROPT,
        273.629625,
        1e-6,
        "two switches and another integrator",
    ),
    SuiteProblem(plug_flow, "bang-singular, units", "Luus", 0.677289, 1e-5, OPTI, sign=-1.0),
    SuiteProblem(
        crystalliser,
        "state constraint, units",
        "Shi, El-Farra, Li, Mhaskar and Christofides 2006, with a limit of the rate",
        7.712562e8,
        1e-6,
        "Opti on 480 intervals, in units of its own",
    ),
    SuiteProblem(
        hicks_ray, "unstable, local optima", "ICLOCS2, in a fixed time", 106.86500, 1e-5, OPTI
    ),
)
