"""Epidemics, tumours and populations."""

from __future__ import annotations

import casadi as ca
import numpy as np

from benchmarks.suite.problem import SuiteProblem, line
from microbot_ocp.ocp import Guess, OptimalControlProblem


def tuberculosis() -> OptimalControlProblem:
    """Two strains of tuberculosis treated for 5 years: fewest infected, and the effort."""
    problem = OptimalControlProblem("two-strain tuberculosis")
    phase = problem.phase("treat", 5.0)
    people = 30000.0
    starts = {"S": 19000.0, "T": 250.0, "L1": 9000.0, "I1": 1000.0, "L2": 500.0, "I2": 250.0}
    s, t, l1, i1, l2, i2 = (
        phase.state(name, initial=start, lower=0.0, upper=people) for name, start in starts.items()
    )
    u1 = phase.control("u1", lower=0.05, upper=0.95)
    u2 = phase.control("u2", lower=0.05, upper=0.95)
    death, resistant = 0.0143, 0.029 * i2 / people
    infection, relapse = 13 * i1 / people, (1 - u2) * i1
    phase.derivative(s, death * people - s * (infection + resistant + death))
    phase.derivative(t, 2 * u1 * l1 - death * t + i1 - 0.5 * relapse - t * (infection + resistant))
    phase.derivative(
        l1,
        infection * (s + t) - (death + 0.5) * l1 - 2 * u1 * l1 + 0.4 * relapse - resistant * l1,
    )
    phase.derivative(i1, 0.5 * l1 - (death + 1) * i1)
    phase.derivative(l2, 0.1 * relapse - (death + 1) * l2 + resistant * (s + l1 + t))
    phase.derivative(i2, l2 - death * i2)
    phase.running_cost(l2 + i2 + 25 * u1**2 + 250 * u2**2)
    return problem


_CAPACITY = ((5.85 - 0.02) / 0.00873) ** 1.5


def tumour() -> OptimalControlProblem:
    """Tumour anti-angiogenesis: smallest volume at the end, 15 mg of inhibitor at most 75 a day."""
    problem = OptimalControlProblem("tumour")
    phase = problem.phase("treat", (0.1, 5.0))
    p = phase.state("p", initial=_CAPACITY / 2, lower=0.1, upper=_CAPACITY)
    q = phase.state("q", initial=_CAPACITY / 4, lower=0.1, upper=_CAPACITY)
    given = phase.state("given", initial=0.0, lower=0.0, upper=15.0)
    u = phase.control("u", lower=0.0, upper=75.0)
    phase.derivative(p, -0.084 * p * ca.log(p / q))
    phase.derivative(q, q * (5.85 - (0.02 + 0.00873 * p ** (2 / 3) + 0.15 * u)))
    phase.derivative(given, u)
    phase.end_cost(p)
    return problem


def _tumour_guess() -> dict[str, Guess]:
    values = {
        "p": line(_CAPACITY / 2, _CAPACITY),
        "q": line(_CAPACITY / 4, _CAPACITY),
        "given": line(0.0, 15.0),
        "u": 75.0,
    }
    return {"treat": Guess(1.0, values)}


def algae_and_bacteria() -> OptimalControlProblem:
    """A consortium of algae and bacteria in a chemostat: most algae harvested in 20 days."""
    problem = OptimalControlProblem("algae and bacteria")
    phase = problem.phase("harvest", 20.0)
    s = phase.state("s", initial=0.1629, lower=0.0)
    e = phase.state("e", initial=0.0487, lower=0.0)
    v = phase.state("v", initial=0.0003, lower=0.0)
    q = phase.state("q", initial=0.0177, lower=2.7628e-3)
    c = phase.state("c", initial=0.035, lower=0.0)
    share = phase.control("share", lower=0.0, upper=1.0)
    dilution = phase.control("dilution", lower=0.0, upper=1.5)
    eaten = 6.48 * s / (0.09 + s)
    taken = 27.3e-3 * v / (0.57e-3 + v)
    growth = 1.0211 * (1 - 2.7628e-3 / q)
    phase.derivative(s, dilution * (0.5 - s) - eaten * e / 0.44)
    phase.derivative(e, ((1 - share) * eaten - dilution) * e)
    phase.derivative(v, share * 23e-3 * eaten * e - taken * c - dilution * v)
    phase.derivative(q, taken - growth * q)
    phase.derivative(c, (growth - dilution) * c)
    phase.running_cost(-dilution * c)
    return problem


# animals of eight stages at 21 times (Rothschild, Sharov, Kearsley and Bondarenko 1997)
_STAGES = (
    (20000, 17000, 10000, 15000, 12000, 9000, 7000, 3000),
    (12445, 15411, 13040, 13338, 13484, 8426, 6615, 4022),
    (7705, 13074, 14623, 11976, 12453, 9272, 6891, 5020),
    (4664, 8579, 12434, 12603, 11738, 9710, 6821, 5722),
    (2977, 7053, 11219, 11340, 13665, 8534, 6242, 5695),
    (1769, 5054, 10065, 11232, 12112, 9600, 6647, 7034),
    (943, 3907, 9473, 10334, 11115, 8826, 6842, 7348),
    (581, 2624, 7421, 10297, 12427, 8747, 7199, 7684),
    (355, 1744, 5369, 7748, 10057, 8698, 6542, 7410),
    (223, 1272, 4713, 6869, 9564, 8766, 6810, 6961),
    (137, 821, 3451, 6050, 8671, 8291, 6827, 7525),
    (87, 577, 2649, 5454, 8430, 7411, 6423, 8388),
    (49, 337, 2058, 4115, 7435, 7627, 6268, 7189),
    (32, 228, 1440, 3790, 6474, 6658, 5859, 7467),
    (17, 168, 1178, 3087, 6524, 5880, 5562, 7144),
    (11, 99, 919, 2596, 5360, 5762, 4480, 7256),
    (7, 65, 647, 1873, 4556, 5058, 4944, 7538),
    (4, 44, 509, 1571, 4009, 4527, 4233, 6649),
    (2, 27, 345, 1227, 3677, 4229, 3805, 6378),
    (1, 20, 231, 934, 3197, 3695, 3159, 6454),
    (1, 12, 198, 707, 2562, 3163, 3232, 5566),
)  # fmt: skip


def marine_population() -> OptimalControlProblem:
    """Growth and mortality of eight stages of a marine population from counts: 15 rates."""
    problem = OptimalControlProblem("marine population")
    growth = problem.free_parameter("growth", 7, lower=0.0)
    mortality = problem.free_parameter("mortality", 8, lower=0.0)
    phase = problem.phase("all", 10.0)
    y = phase.state("animals", 8)
    grown = growth * y[:7]
    phase.derivative(y, ca.vertcat(0, grown) - ca.vertcat(grown, 0) - mortality * y)
    data = phase.measurement("data", np.linspace(0.0, 10.0, 21), np.array(_STAGES, dtype=float))
    phase.point_cost(ca.sumsqr(y - data))
    return problem


PROBLEMS = (
    SuiteProblem(
        tuberculosis,
        kind="units",
        source="Betts, Practical Methods (2010), example 6.16 (Jung, Lenhart, Feng 2002): "
        "5152.07310",
        published=5152.07310,
        tolerance=1e-6,
        confirmed="fine mesh",
    ),
    SuiteProblem(
        tumour,
        kind="bang-singular, units",
        source="Ledzewicz and Schättler, Optim. Control Appl. Meth. 29 (2008); GPOPS-II example "
        "tumorAntiAngiogenesis; Betts (2010), example 6.17: 7571.6712",
        published=7571.6712,
        tolerance=1e-5,
        confirmed="fine mesh",
        guess=_tumour_guess,
    ),
    SuiteProblem(
        algae_and_bacteria,
        kind="bang-singular",
        source="CTDirect.jl test problem algal_bacterial: 5.45",
        published=5.45,
        reference=5.4520,
        tolerance=2e-3,
        confirmed="fine mesh",
        sign=-1.0,
    ),
    SuiteProblem(
        marine_population,
        kind="parameters, data, units",
        source="COPS 3.0 (Dolan, Moré, Munson 2004), problem 15: 1.97465e7",
        published=1.97465e7,
        tolerance=1e-5,
        confirmed="fine mesh",
    ),
)
