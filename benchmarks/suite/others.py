"""Problems of the suite in other packages: rockit, YAPSS, MAPTOR.

    PYTHON -m benchmarks.suite.others [--only NAME ...] [--tools rockit yapss maptor]
        [--limit SECONDS]

PYTHON is the interpreter of an environment with ``rockit-meco``, ``yapss`` and ``maptor`` besides
the dependencies of this package. Each receives the declaration as a CasADi function, the starting
guess of ``ocp.solve``, and its own defaults: rockit collocation on 50 intervals, YAPSS its own
mesh, MAPTOR the refinement of its mesh from ten intervals of degree four. Only problems of one
phase without algebraic variables, free parameters and values at other places can be converted.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import time
from dataclasses import dataclass
from importlib import import_module
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from benchmarks.suite.table import BY_NAME
from microbot_ocp.ocp import Guess, OptimalControlProblem, Phase
from microbot_ocp.ocp.starts import completed

Array = np.ndarray

TOOLS = ("rockit", "yapss", "maptor")
NAMES = (
    "breakwell",
    "jacobson_lele",
    "rayleigh_mixed",
    "hypersensitive",
    "dubins_car",
    "luus_singular_5",
    "bridge_crane",
    "luus_arm",
    "dissanayake_arm",
    "catalyst_mixing",
    "hang_glider",
    "orbit_raising",
)
INTERVALS = 50
SAMPLES = 11  # samples of the guess
QUIET = {"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": False}


@dataclass(frozen=True)
class _Plain:
    """Problem of one phase as functions and arrays.

    Attributes
    ----------
    along : function (x, u, t, T) -> slopes, constraints, running cost
    at_end : function (x, T) -> constraints, cost
    """

    along: ca.Function
    at_end: ca.Function
    state: tuple[Array, Array]
    control: tuple[Array, Array]
    initial: tuple[Array, Array]
    final: tuple[Array, Array]
    path: tuple[Array, Array]
    end: tuple[Array, Array]
    duration: tuple[float, float]
    states: Array
    controls: Array
    guessed: float


def plain(problem: OptimalControlProblem, guess: dict[str, Guess] | None) -> _Plain:
    """Convert the problem into functions; raise NotImplementedError if that is not possible."""
    phase = problem.phases[0]
    more = (phase.algebraics, phase.free_parameters, phase.measurements, phase.point_constraints)
    if len(problem.phases) > 1 or any(more) or phase.point_costs:
        raise NotImplementedError("more than one phase of states and controls")
    x = ca.vertcat(*(s.symbol for s in phase.states))
    u = ca.vertcat(*(c.symbol for c in phase.controls))
    sign = -1.0 if problem.maximize else 1.0
    values = [p.symbol for p in phase.parameters], [ca.MX(ca.DM(p.value)) for p in phase.parameters]

    def stacked(expressions: list[ca.MX]) -> ca.MX:
        return ca.graph_substitute([ca.vertcat(*expressions, ca.MX(0, 1))], *values)[0]

    slopes = stacked([phase.derivatives[s.name] for s in phase.states])
    running = sign * ca.sum1(stacked(list(phase.running_costs)))
    cost = sign * ca.sum1(stacked(list(phase.end_costs)))
    path = stacked([c.expression for c in phase.constraints])
    end = stacked([c.expression for c in phase.end_constraints])
    along = [slopes, path, ca.densify(running)]
    own = completed(problem, guess)[phase.name]
    share = np.linspace(0.0, 1.0, SAMPLES)
    return _Plain(
        ca.Function("along", [x, u, phase.time, phase.duration], along),
        ca.Function("at_end", [x, phase.duration], [end, ca.densify(cost)]),
        _bounds(phase.states),
        _bounds(phase.controls),
        _ends(phase, "initial"),
        _ends(phase, "final"),
        _bounds(phase.constraints),
        _bounds(phase.end_constraints),
        phase.duration_bounds,
        np.hstack([_sampled(own, v, share) for v in phase.states]),
        np.hstack([_sampled(own, v, share) for v in phase.controls]),
        float(own.duration or 1.0),
    )


def _bounds(items: Any) -> tuple[Array, Array]:
    low, high = ([np.ravel(getattr(i, k)) for i in items] for k in ("lower", "upper"))
    return np.concatenate([*low, np.zeros(0)]), np.concatenate([*high, np.zeros(0)])


def _ends(phase: Phase, which: str) -> tuple[Array, Array]:
    found = [getattr(s, which) or (s.lower, s.upper) for s in phase.states]
    return np.concatenate([low for low, _ in found]), np.concatenate([high for _, high in found])


def _sampled(guess: Guess, variable: Any, share: Array) -> Array:
    value = guess.values.get(variable.name, np.clip(0.0, variable.lower, variable.upper))
    table = np.asarray(value(share) if callable(value) else value, dtype=float)
    return np.broadcast_to(table.reshape(-1, variable.size), (share.size, variable.size))


def by_rockit(p: _Plain) -> tuple[float, bool]:
    rockit: Any = import_module("rockit")

    low, high = p.duration
    free = low < high
    ocp = rockit.Ocp(T=rockit.FreeTime(p.guessed) if free else low)
    x, u = ocp.state(p.states.shape[1]), ocp.control(p.controls.shape[1])
    slopes, path, running = p.along.call([x, u, ocp.t, ocp.T], True, False)
    ocp.set_der(x, slopes)
    ocp.add_objective(ocp.integral(running))
    end, cost = p.at_end(ocp.at_tf(x), ocp.T)
    ocp.add_objective(cost)
    if free:
        total = ocp.T
        ocp.subject_to(total >= low)
        ocp.subject_to(total <= high)
    everywhere = ((x, p.state), (u, p.control), (path, p.path))
    at = ((ocp.at_t0(x), p.initial), (ocp.at_tf(x), p.final), (end, p.end))
    for expression, (lower, upper) in (*everywhere, *at):
        for k in range(expression.shape[0]):
            if lower[k] == upper[k]:
                ocp.subject_to(expression[k] == lower[k])
                continue
            if np.isfinite(lower[k]):
                ocp.subject_to(expression[k] >= lower[k])
            if np.isfinite(upper[k]):
                ocp.subject_to(expression[k] <= upper[k])
    share = ocp.t / p.guessed  # tables of values fail for states in version 0.6.7
    for variable, table in ((x, p.states), (u, p.controls)):
        ocp.set_initial(variable, ca.DM(table[0]) + ca.DM(table[-1] - table[0]) * share)
    ocp.solver("ipopt", QUIET)
    ocp.method(rockit.DirectCollocation(N=INTERVALS))
    solution = ocp.solve()  # it raises if IPOPT does not succeed
    return float(solution.value(ocp.objective)), True


def by_yapss(p: _Plain) -> tuple[float, bool]:
    Problem: Any = import_module("yapss").Problem
    SXW: Any = import_module("yapss.math.wrapper").SXW

    nx, nu, nh, nd = (p.states.shape[1], p.controls.shape[1], p.path[0].size, p.end[0].size)
    ocp = Problem(name="one", nx=[nx], nu=[nu], nq=[1], nh=[nh], nd=nd)
    along, at_end = p.along.expand(), p.at_end.expand()

    def plain_sx(values: Any) -> ca.SX:
        items = [np.ravel(np.asarray(v, dtype=object))[0] for v in values]
        return ca.vertcat(*(v._value if isinstance(v, SXW) else ca.SX(v) for v in items))

    def wrapped(values: ca.SX) -> list[Any]:
        return [SXW(values[k]) for k in range(values.shape[0])]

    def objective(arg: Any) -> None:
        own = arg.phase[0]
        duration = plain_sx([own.final_time])
        cost = at_end(plain_sx(own.final_state), duration)[1]
        arg.objective = SXW(cost + plain_sx([own.integral[0]]))

    def continuous(arg: Any) -> None:
        own = arg.phase[0]
        duration = plain_sx([own.final_time]) if hasattr(own, "final_time") else ca.SX(p.guessed)
        where = plain_sx([own.time])
        slopes, path, running = along(plain_sx(own.state), plain_sx(own.control), where, duration)
        own.dynamics[:] = wrapped(slopes)
        if nh:
            own.path[:] = wrapped(path)
        own.integrand[0] = wrapped(running)[0]

    def discrete(arg: Any) -> None:
        own = arg.phase[0]
        end = at_end(plain_sx(own.final_state), plain_sx([own.final_time]))[0]
        arg.discrete[:] = wrapped(end)

    ocp.functions.objective, ocp.functions.continuous = objective, continuous
    if nd:
        ocp.functions.discrete = discrete
        ocp.bounds.discrete.lower, ocp.bounds.discrete.upper = p.end
    own = ocp.bounds.phase[0]
    own.initial_time.lower = own.initial_time.upper = 0.0
    own.final_time.lower, own.final_time.upper = p.duration
    pairs = [
        (own.state, p.state),
        (own.control, p.control),
        (own.initial_state, p.initial),
        (own.final_state, p.final),
        *([(own.path, p.path)] if nh else []),
    ]
    for bound, (lower, upper) in pairs:
        bound.lower[:], bound.upper[:] = lower, upper
    guess = ocp.guess.phase[0]
    guess.time = list(np.linspace(0.0, p.guessed, SAMPLES))
    guess.state, guess.control = p.states.T.tolist(), p.controls.T.tolist()
    ocp.derivatives.method, ocp.derivatives.order = "auto", "second"
    ocp.ipopt_options.print_level = 0
    solution = ocp.solve()
    return float(solution.objective), solution.nlp_info.ipopt_status == 0


def by_maptor(p: _Plain) -> tuple[float, bool]:
    maptor: Any = import_module("maptor")

    def limits(lower: float, upper: float) -> Any:
        if lower == upper:
            return float(lower)
        ends = tuple(float(v) if np.isfinite(v) else None for v in (lower, upper))
        return None if ends == (None, None) else ends

    problem = maptor.Problem("one")
    phase = problem.set_phase(1)
    t = phase.time(initial=0.0, final=limits(*p.duration))
    states = [
        phase.state(f"x{k}", *(limits(a[k], b[k]) for a, b in (p.initial, p.final, p.state)))
        for k in range(p.states.shape[1])
    ]
    controls = [
        phase.control(f"u{k}", limits(*(b[k] for b in p.control)))
        for k in range(p.controls.shape[1])
    ]
    x = ca.vertcat(*(ca.MX(1, 1) + s for s in states))
    u = ca.vertcat(*(ca.MX(1, 1) + c for c in controls))
    slopes, path, running = p.along.call([x, u, ca.MX(1, 1) + t, t.final], True, False)
    phase.dynamics({s: slopes[k] for k, s in enumerate(states)})
    for expression, (lower, upper), add in (
        (path, p.path, phase.path_constraints),
        (
            p.at_end(ca.vertcat(*(s.final for s in states)), t.final)[0],
            p.end,
            phase.event_constraints,
        ),
    ):
        for k in range(expression.shape[0]):
            if lower[k] == upper[k]:
                add(expression[k] == float(lower[k]))
                continue
            if np.isfinite(lower[k]):
                add(expression[k] >= float(lower[k]))
            if np.isfinite(upper[k]):
                add(expression[k] <= float(upper[k]))
    cost = p.at_end(ca.vertcat(*(s.final for s in states)), t.final)[1]
    problem.minimize(cost + phase.add_integral(running))
    count, degree = 10, 4
    mesh = np.linspace(0.0, 1.0, count + 1)
    phase.mesh([degree] * count, (2 * mesh - 1).tolist())
    share = np.linspace(0.0, 1.0, SAMPLES)
    at = [np.linspace(a, b, degree + 1) for a, b in pairwise(mesh)]
    phase.guess(
        states=[np.array([np.interp(s, share, c) for c in p.states.T]) for s in at],
        controls=[np.array([np.interp(s[:-1], share, c) for c in p.controls.T]) for s in at],
        terminal_time=p.guessed,
    )
    solution = maptor.solve_adaptive(problem, nlp_options=QUIET, show_summary=False)
    return float(solution.status["objective"]), bool(solution.status["success"])


SOLVERS = {"rockit": by_rockit, "yapss": by_yapss, "maptor": by_maptor}


def run(name: str, tool: str) -> dict[str, Any]:
    """Solve one problem by one package; return its result."""
    own = BY_NAME[name]
    guess = None if own.guess is None else dict(own.guess())
    begin = time.process_time()
    try:
        cost, solved = SOLVERS[tool](plain(own.build(), guess))
        error, said = own.error(cost), ""
    except Exception as problem:  # any exception that a user would see is a result, too
        error, solved = None, False
        said = f"{type(problem).__name__}: {(str(problem).strip().splitlines() or [''])[-1]}"
    spent = time.process_time() - begin
    return {"error": error, "solved": solved, "said": said, "seconds": spent}


def _sent(name: str, tool: str, pipe: Any) -> None:
    pipe.send(run(name, tool))


def within(name: str, tool: str, limit: float) -> dict[str, Any]:
    """Solve one problem by one package in a process with a time limit, s."""
    here, there = multiprocessing.Pipe()
    child = multiprocessing.Process(target=_sent, args=(name, tool, there))
    child.start()
    found = {"error": None, "solved": False, "said": "TIMEOUT", "seconds": limit}
    if here.poll(limit):
        found = here.recv()
    child.kill()
    child.join()
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", nargs="+", default=list(NAMES), choices=sorted(BY_NAME))
    parser.add_argument("--tools", nargs="+", default=list(TOOLS), choices=TOOLS)
    parser.add_argument("--limit", type=float, default=60.0, help="wall time of each, s")
    options = parser.parse_args()
    for name in options.only:
        for tool in options.tools:
            print(json.dumps({"name": name, "tool": tool, **within(name, tool, options.limit)}))


if __name__ == "__main__":
    main()
