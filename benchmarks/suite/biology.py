"""Epidemics, tumours and populations."""

from __future__ import annotations

import casadi as ca

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
)
