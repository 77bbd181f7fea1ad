"""Epidemics, tumours and populations."""

from __future__ import annotations

from functools import partial
from math import log, pi

import casadi as ca
import numpy as np

from benchmarks.suite.problem import (
    LUUS_PROPT,
    OPTI,
    PROPT,
    Array,
    SuiteProblem,
    along,
    line,
)
from microbot_ocp.ocp import Guess, OptimalControlProblem


def tuberculosis() -> OptimalControlProblem:
    """Minimise infections with two strains of tuberculosis and the effort over 5 years."""
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
    """Minimise a tumour's final volume: 15 mg of anti-angiogenic inhibitor, at most 75 a day."""
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
    """Maximise the harvest of algae that live with bacteria in a chemostat, in 20 days."""
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


# Counts of animals of eight stages at 21 times (Rothschild, Sharov, Kearsley, Bondarenko 1997).
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
    """Fit growth and mortality of eight stages of a marine population to counts: 15 rates."""
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


def marine_population_in_phases() -> OptimalControlProblem:
    """Fit the marine population in a phase between any two counts, with rates as states."""
    problem, counts, before = OptimalControlProblem("marine phases"), ca.DM(_STAGES).T, None
    for number in range(20):
        phase = problem.phase(f"from count {number}", 0.5)
        y = phase.state("animals", 8)
        growth = phase.state("growth", 7, lower=0.0)
        mortality = phase.state("mortality", 8, lower=0.0)
        grown = growth * y[:7]
        phase.derivative(y, ca.vertcat(0, grown) - ca.vertcat(grown, 0) - mortality * y)
        phase.derivative(growth, ca.MX.zeros(7))
        phase.derivative(mortality, ca.MX.zeros(8))
        phase.end_cost(ca.sumsqr(y - counts[:, number + 1]))
        if before is None:
            phase.point_cost(ca.sumsqr(y - counts[:, 0]), at=0.0)
        else:
            problem.link(before, phase)
        before = phase
    return problem


def _counts_guess() -> dict[str, Guess]:
    rates, counts = {"growth": 0.5, "mortality": 0.1}, np.array(_STAGES, dtype=float)
    return {
        f"from count {number}": Guess(
            0.5, {"animals": partial(_between_counts, *counts[number : number + 2]), **rates}
        )
        for number in range(20)
    }


def _between_counts(first: Array, last: Array, s: Array) -> Array:
    return first + s[:, None] * (last - first)


def fishing_with_two_fleets() -> OptimalControlProblem:
    """Steer Lotka-Volterra predators and prey, each fished by a fleet."""
    problem = OptimalControlProblem("two fleets")
    phase = problem.phase("only", 12.0)
    prey = phase.state("prey", initial=0.5)
    predators = phase.state("predators", initial=0.7)
    first = phase.control("first", lower=0.0, upper=1.0)
    second = phase.control("second", lower=0.0, upper=1.0)
    phase.derivative(prey, prey - prey * predators - 0.4 * prey * first)
    phase.derivative(predators, prey * predators - predators - 0.2 * predators * second)
    phase.running_cost((prey - 1) ** 2 + (predators - 1) ** 2)
    return problem


def hiv() -> OptimalControlProblem:
    """Maximise healthy cells with little medicine in 50 days of chemotherapy of HIV."""
    problem = OptimalControlProblem("HIV")
    phase = problem.phase("treat", 50.0)
    healthy = phase.state("healthy", initial=982.8, lower=0.0)
    latent = phase.state("latent", initial=0.05155, lower=0.0)
    active = phase.state("active", initial=6.175e-4, lower=0.0)
    virus = phase.state("virus", initial=0.07306, lower=0.0)
    u = phase.control("u", lower=0.0, upper=1.0)
    infected = 2.4e-5 * virus * healthy
    crowd = 1 - (healthy + latent + active) / 1500
    phase.derivative(
        healthy, 10 / (1 + virus) - 0.02 * healthy + 0.03 * healthy * crowd - infected * (1 - u)
    )
    phase.derivative(latent, infected * (1 - u) - 0.02 * latent - 3e-3 * latent)
    phase.derivative(active, 3e-3 * latent - 0.24 * active)
    phase.derivative(virus, 1200 * 0.24 * active - infected * (1 - u) - 2.4 * virus)
    phase.running_cost(-(healthy - 50 * (1 - u) ** 2))
    return problem


def two_drugs() -> OptimalControlProblem:
    """Steer warfarin and phenylbutazone in the blood to their levels in least time."""
    problem = OptimalControlProblem("two drugs")
    phase = problem.phase("only", (1.0, 500.0))
    x1 = phase.state("warfarin", initial=0.02, final=0.02)
    x2 = phase.state("phenylbutazone", initial=0.0, final=2.0)
    u = phase.control("u", lower=0.0, upper=8.0)
    free = (1 + 0.2 * (x1 + x2)) ** 2
    second, first = free + 232 + 46.4 * x2, free + 232 + 46.4 * x1
    factor = free / (second * first - 2152.96 * x1 * x2)
    phase.derivative(x1, factor * (first * (0.02 - x1) + 46.4 * x1 * (u - 2 * x2)))
    phase.derivative(x2, factor * (second * (u - 2 * x2) + 46.4 * (0.02 - x1)))
    phase.end_cost(phase.duration)
    return problem


CONTACT, RECOVERY, BEDS, INFECTED = 0.3, 0.1, 0.05, 1e-4


def _epidemic_optimum() -> float:
    """Return the optimum: free until the beds are full, constant infections to herd immunity."""
    herd = RECOVERY / CONTACT
    low, high = herd, 1 - INFECTED
    for _ in range(200):  # at s the infected, 1 - s + herd log(s / s0), fill the beds
        middle = (low + high) / 2
        low, high = (
            (middle, high)
            if INFECTED + (1 - INFECTED) - middle + herd * log(middle / (1 - INFECTED)) > BEDS
            else (low, middle)
        )
    return CONTACT * (low - herd) / (RECOVERY * BEDS) - log(low / herd) / BEDS


def epidemic() -> OptimalControlProblem:
    """Minimise the distancing that keeps the infected within the beds."""
    problem = OptimalControlProblem("epidemic")
    phase = problem.phase("only", 300.0)
    s = phase.state("susceptible", initial=1 - INFECTED, lower=0.0, upper=1.0)
    i = phase.state("infected", initial=INFECTED, lower=0.0, upper=BEDS)
    b = phase.control("contact", lower=0.0, upper=CONTACT)
    phase.derivative(s, -b * s * i)
    phase.derivative(i, b * s * i - RECOVERY * i)
    phase.running_cost(CONTACT - b)
    return problem


def greenhouse() -> OptimalControlProblem:
    """Maximise the profit of heating a greenhouse over two days with known sun and temperature."""
    problem = OptimalControlProblem("greenhouse")
    phase = problem.phase("days", 48.0)
    crop = phase.state("crop", initial=0.0)
    temperature = phase.state("temperature", initial=10.0)
    spent = phase.state("spent", initial=0.0)
    heat = phase.control("heat", lower=0.0, upper=10.0)
    swing = ca.sin(4 * pi * phase.time / 48 - 0.65 * pi)
    phase.derivative(crop, 3e-6 / 40 * 800 * swing * temperature)
    phase.derivative(temperature, 15 + 10 * swing - temperature + 0.1 * heat)
    phase.derivative(spent, 7.5e-2 / 220 * heat)
    phase.end_cost(spent - 3e4 / 220 * crop)
    return problem


def metabolic_pathway() -> OptimalControlProblem:
    """Steer a chain of reactions to a steady flux by making its four enzymes in turn."""
    rates, flux, decay = (1.0, 2.0, 4.0, 3.0), 0.2, 0.5
    ends = (5.0, 0.65, 0.32, 0.27)
    problem = OptimalControlProblem("metabolic pathway")
    phase = problem.phase("start", (0.1, 50.0))
    food = [ca.MX(5.0)]
    for k in (1, 2, 3):
        food.append(phase.state(f"s{k}", initial=0.0, final=ends[k], lower=0.0, upper=100.0))
    enzymes = [
        phase.state(f"e{k}", initial=0.0, final=flux * (1 + end) / (rate * end), lower=0.0, upper=1)
        for k, (rate, end) in enumerate(zip(rates, ends, strict=True))
    ]
    speeds = [r * s * e / (1 + s) for r, s, e in zip(rates, food, enzymes, strict=True)]
    for k in (1, 2, 3):
        phase.derivative(food[k], speeds[k - 1] - speeds[k])
    for k, enzyme in enumerate(enzymes):
        made = phase.control(f"u{k}", lower=0.0, upper=1.0)
        phase.derivative(enzyme, made - decay * enzyme)
    phase.running_cost(1 + ca.sum1(ca.vertcat(*enzymes)))
    return problem


def _pathway_guess() -> dict[str, Guess]:
    values = {"s1": 0.0, "s2": 0.0, "s3": 0.0, "u0": 1.0, "u1": 0.0, "u2": 0.0, "u3": 0.0}
    starts = {"e0": 0.0, "e1": -0.1, "e2": -0.5, "e3": -0.6}
    return {"start": Guess(2.0, {**values, **{k: line(s, s + 1) for k, s in starts.items()}})}


def immune_response() -> OptimalControlProblem:
    """Minimise an infection that is lethal untreated, by four treatments."""
    problem = OptimalControlProblem("immune response")
    phase = problem.phase("cure", 10.0)
    pathogen = phase.state("pathogen", initial=3.0, lower=0.0)
    plasma = phase.state("plasma", initial=2.0)
    antibody = phase.state("antibody", initial=4 / 3)
    damage = phase.state("damage", initial=0.0, lower=0.0)
    u1, u2, u3, u4 = (phase.control(f"u{k}", lower=0.0) for k in (1, 2, 3, 4))
    able = ca.if_else(damage < 0.5, ca.cos(pi * damage), 0.0)
    phase.derivative(pathogen, (1 - antibody) * pathogen - u1)
    phase.derivative(plasma, 3 * able * pathogen * antibody - (plasma - 2) + u2)
    phase.derivative(antibody, plasma - (1.5 + 0.5 * pathogen) * antibody + u3)
    phase.derivative(damage, 0.5 * pathogen - damage - u4)
    phase.running_cost(0.5 * (pathogen**2 + damage**2 + u1**2 + u2**2 + u3**2 + u4**2))
    phase.end_cost(0.5 * (pathogen**2 + damage**2))
    return problem


def vaccination() -> OptimalControlProblem:
    """Minimise a disease by vaccination, with a limit of vaccinations in a year."""
    problem = OptimalControlProblem("vaccination")
    phase = problem.phase("years", 20.0)
    susceptible = phase.state("susceptible", initial=1000.0, lower=0.0)
    exposed = phase.state("exposed", initial=100.0, lower=0.0)
    ill = phase.state("ill", initial=50.0, lower=0.0)
    people = phase.state("people", initial=1165.0, lower=0.0)
    u = phase.control("u", lower=0.0, upper=1.0)
    caught = 0.001 * susceptible * ill
    phase.derivative(susceptible, 0.525 * people - 0.5 * susceptible - caught - u * susceptible)
    phase.derivative(exposed, caught - (0.5 + 0.5) * exposed)
    phase.derivative(ill, 0.5 * exposed - (0.1 + 0.2 + 0.5) * ill)
    phase.derivative(people, (0.525 - 0.5) * people - 0.2 * ill)
    phase.constraint("doses", u * susceptible, upper=125.0)
    phase.running_cost(ill + 10 * u)
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
    SuiteProblem(
        marine_population_in_phases,
        kind="parameters, data, phases",
        source="COPS 3.0 (Dolan, Moré, Munson 2004), problem 15: 1.97465e7",
        published=1.97465e7,
        tolerance=1e-5,
        confirmed="fine mesh",
        guess=_counts_guess,
    ),
    SuiteProblem(
        fishing_with_two_fleets,
        kind="bang-singular",
        source="PSOPT example lotka2, relaxed: 1.088024 (640 nodes)",
        published=1.088024,
        tolerance=2e-05,
        reference=1.08801,
        confirmed="fine mesh",
    ),
    SuiteProblem(
        hiv,
        kind="smooth, units",
        source="Kirschner, Lenhart and Serbin (1997)",
        published=-49117.1588,
        tolerance=1e-05,
        confirmed="fine mesh",
    ),
    SuiteProblem(
        two_drugs,
        "bang-bang",
        LUUS_PROPT,
        221.3334,
        5e-4,
        OPTI,
        221.2430,
        guess=lambda: {
            "only": Guess(
                300.0, {"phenylbutazone": line(0.0, 2.0), "u": along(lambda s: 8.0 - 8.0 * s)}
            )
        },
    ),
    SuiteProblem(
        epidemic,
        "state constraint, singular",
        "Miclo, Spiro and Weibull 2020",
        _epidemic_optimum(),
        1e-6,
        "closed form",
    ),
    SuiteProblem(greenhouse, "bang-bang", PROPT, 1.87099, 1e-5, OPTI, sign=-1.0),
    SuiteProblem(metabolic_pathway, "bang-bang", PROPT, 6.0852, 1e-5, OPTI, guess=_pathway_guess),
    SuiteProblem(
        immune_response,
        "smooth",
        "Stengel et al. 2002",
        2.803027,
        1e-5,
        "Opti on 150 intervals, without the branch that is not met",
    ),
    SuiteProblem(
        vaccination,
        "mixed constraint, bang-bang",
        "Biswas, Paiva and de Pinho 2014, with other weights",
        353.3593,
        1e-6,
        OPTI,
    ),
)
