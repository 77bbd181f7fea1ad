"""Optimal-control problems with answers known from textbooks, and one that uses every feature."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp.ocp import Accuracy, Solution, SolverSettings, solve
from microbot_ocp.ocp.problem import OptimalControlProblem, Phase


def solve_once(
    problem: Any, mesh: Any = None, guess: Any = None, settings: Any = None, **options: Any
) -> Solution:
    """Solve by IPOPT from one start: the other ways of ``solve`` are the matter of other tests."""
    return solve(problem, mesh, guess, settings or SolverSettings("ipopt"), **options)


def solved_to(
    problem: Any,
    states: float = 1e-6,
    mesh: Any = 20,
    scheme: Any = "radau",
    guess: Any = None,
    settings: Any = None,
    *,
    time_limit: float = 60.0,
    progress: Any = None,
    **asked: Any,
) -> Solution:
    """A solution of an accuracy, the fields of which may be given by name."""
    how = {"scheme": scheme, "time_limit": time_limit, "progress": progress}
    return solve(problem, mesh, guess, settings, accuracy=Accuracy(states, **asked), **how)


def mass(
    problem: OptimalControlProblem,
    name: str,
    duration: float | tuple[float, float] = (0.01, 10.0),
    *,
    force: float = np.inf,
    shape: str = "constant",
    ends: tuple[tuple[float | None, float | None], tuple[float | None, float | None]],
    top: float = np.inf,
) -> tuple[Phase, ca.MX]:
    """A phase of a unit mass pushed along a line: x' = v, v' = u; ends are (x, v) pairs."""
    phase = problem.phase(name, duration)
    (x0, v0), (x1, v1) = ends
    x = phase.state(
        "x", initial=x0, final=x1, upper=top, unit="m", interior_points=bool(top < np.inf)
    )
    v = phase.state("v", initial=v0, final=v1, unit="m/s")
    u = phase.control("u", lower=-force, upper=force, unit="m/s^2", shape=shape)
    phase.derivative(x, v)
    phase.derivative(v, u)
    return phase, u


def double_integrator(shape: str = "constant") -> OptimalControlProblem:
    """From rest to rest over 1 m in the shortest time with at most 1 m/s^2: 2 s."""
    problem = OptimalControlProblem("double integrator")
    phase, _ = mass(problem, "move", force=1.0, shape=shape, ends=((0.0, 0.0), (1.0, 0.0)))
    phase.end_cost(phase.duration)
    return problem


def bryson_denham(top: float, shape: str = "linear") -> OptimalControlProblem:
    """Least effort there and back in 1 s under a ceiling: the cost is 4 / (9 top), top <= 1/6.

    Bryson and Ho, Applied Optimal Control, section 3.11.
    """
    problem = OptimalControlProblem("Bryson-Denham")
    phase, u = mass(problem, "fly", 1.0, shape=shape, ends=((0.0, 1.0), (0.0, -1.0)), top=top)
    phase.running_cost(u**2 / 2)
    return problem


def through_half_way(kept: tuple[str, ...]) -> OptimalControlProblem:
    """Shortest time over 1 m, with 1 m/s^2 in the first half and 2 m/s^2 in the second.

    With x and v kept the mass arrives half-way at 1 m/s and reaches sqrt(1.5) m/s later:
    1/2 + sqrt(3/2) s. Where v may jump, the second half is braking only: 1 + sqrt(1/2) s.
    """
    problem = OptimalControlProblem("half-way")
    first, _ = mass(problem, "first", force=1.0, ends=((0.0, 0.0), (0.5, None)))
    second, _ = mass(problem, "second", force=2.0, ends=((None, None), (1.0, 0.0)))
    for phase in (first, second):
        phase.end_cost(phase.duration)
    problem.link(first, second, kept)
    return problem


def spline(times: tuple[float, float], middle: float) -> OptimalControlProblem:
    """Least integral of u^2 from rest at 0 through ``middle`` to rest at 1: the clamped spline."""
    problem = OptimalControlProblem("spline")
    ends = ((0.0, 0.0), (middle, None)), ((None, None), (1.0, 0.0))
    phases = []
    for name, duration, pair in zip(("first", "second"), times, ends, strict=True):
        phase, u = mass(problem, name, duration, shape="linear", ends=pair)
        phase.running_cost(u**2)
        phases.append(phase)
    problem.link(*phases, ("x", "v", "u"))
    return problem


def regulator(shape: str = "linear") -> OptimalControlProblem:
    """Least half of the integral of x^2 + u^2 from x = 1 over 1 s: the cost is tanh(1) / 2."""
    problem = OptimalControlProblem("regulator")
    phase = problem.phase("calm", 1.0)
    x = phase.state("x", initial=1.0)
    u = phase.control("u", shape=shape)
    phase.derivative(x, u)
    phase.running_cost((x**2 + u**2) / 2)
    return problem


def everything() -> OptimalControlProblem:
    """Two phases with every kind of term: only the derivatives of its program are of interest."""
    problem = OptimalControlProblem("everything")
    first = problem.phase("first", (0.2, 3.0), interior_points=(0.25, 0.6))
    x = first.state("x", 2, lower=-5.0, upper=5.0, initial=[0.1, 0.2], scale=[2.0, 0.5])
    y = first.state("y", lower=-1.0, upper=3.0, interior_points=True, initial=(0.0, 1.0), scale=3.0)
    pull = first.control("pull", 2, scale=[4.0, 0.3], shape="linear", initial=0.0)
    push = first.control("push", lower=-2.0, upper=2.0, scale=1.7, shape="constant")
    k = first.parameter("k", [0.7, -1.3])
    first.derivative(x, ca.vertcat(ca.sin(x[1]) * push + pull[0], -k[0] * x[0] * y + first.time))
    first.derivative(y, ca.tanh(x[0]) * pull[1] + push**2 / first.duration)
    first.constraint("smooth", ca.exp(0.1 * x[0]) * x[1] + first.time * y, -3.0, 9.0, scale=2.0)
    first.constraint("rated", ca.vertcat(first.rate(pull)[0] * x[1], push * y), [-4, -5], [6, 7])
    first.running_cost(ca.sumsqr(first.rate(pull)) * y + push**2 * x[0] * k[1])
    first.end_cost(first.duration**2 + x[0] ** 3 * pull[1])

    second = problem.phase("second", 1.5, interior_points=())
    z = second.state("z", 2, scale=0.4)
    x = second.state("x", 2, final=([-1.0, -2.0], [1.0, 2.0]), scale=[1.5, 0.8])
    pull = second.control("pull", 2, scale=[2.5, 0.6], shape="linear", final=[0.5, 0.25])
    second.derivative(z, ca.vertcat(z[1] * pull[0], -ca.sin(z[0]) + pull[1] * x[0]))
    second.derivative(x, ca.vertcat(x[1] * z[0], ca.cos(pull[0]) - x[0] ** 2))
    second.constraint("product", z[0] * x[1] * pull[0], upper=2.0)
    second.running_cost(ca.sumsqr(z) * ca.sumsqr(pull) + second.time)
    second.end_cost(ca.sumsqr(x) * z[0] * second.duration)
    problem.link(first, second, ("x", "pull"))
    return problem


def oscillator(shape: str = "linear") -> OptimalControlProblem:
    """Van der Pol's oscillator brought to rest, without bounds that act."""
    problem = OptimalControlProblem("oscillator")
    phase = problem.phase("calm", 4.0)
    x = phase.state("x", 2, initial=[0.0, 1.0])
    u = phase.control("u", lower=-2.0, upper=2.0, shape=shape)
    phase.derivative(x, ca.vertcat((1 - x[1] ** 2) * x[0] - x[1] + u, x[0]))
    phase.running_cost(ca.sumsqr(x) + u**2)
    return problem


def pendulum() -> OptimalControlProblem:
    """The shortest swing up with a torque of less than the weight, one switch."""
    problem = OptimalControlProblem("pendulum")
    phase = problem.phase("swing", (0.5, 10.0))
    q = phase.state("q", initial=0.0, final=np.pi, unit="rad")
    w = phase.state("w", initial=0.0, final=0.0, scale=3.0, unit="rad/s")
    u = phase.control("u", lower=-2.0, upper=2.0, unit="1/s^2", shape="constant")
    phase.derivative(q, w)
    phase.derivative(w, u - ca.sin(q))
    phase.end_cost(phase.duration)
    return problem
