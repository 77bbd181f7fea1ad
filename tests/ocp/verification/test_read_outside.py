"""A table that is read outside of its grid: no answer to what was declared."""

import casadi as ca
import numpy as np
import pytest

from helpers import sampled_rows, tells
from microbot_ocp.ocp import (
    OptimalControlProblem,
    SolverSettings,
    Status,
    Thresholds,
    solve,
    verify,
)

GRID = np.linspace(0.0, 1.5, 7)
DRAG = 0.2 * GRID**2
TWO = ca.interpolant("drag", "linear", [GRID, [0.0, 10.0]], [*DRAG, *DRAG])
_v = ca.MX.sym("v")
WAYS = {
    "bspline": ca.interpolant("drag", "bspline", [GRID], DRAG),
    "linear": ca.interpolant("drag", "linear", [GRID], DRAG),
    "written out": ca.interpolant("drag", "linear", [GRID], DRAG, {"inline": True}),
    "two dimensions": lambda v: TWO(ca.vertcat(v, 1.0)),
}
WAYS["in a function"] = ca.Function("users", [_v], [2 * WAYS["linear"](_v)])


def car(way="linear", where="dynamics", fastest=np.inf):
    """2.5 m from rest in the shortest time: it becomes as fast as it may."""
    problem = OptimalControlProblem("car")
    phase = problem.phase("run", (0.1, 10.0))
    x = phase.state("x", initial=0.0, final=2.5, unit="m")
    v = phase.state("v", initial=0.0, upper=fastest, unit="m/s")
    u = phase.control("u", lower=-2.0, upper=2.0)
    drag = WAYS[way](v)
    phase.derivative(x, v)
    phase.derivative(v, u - drag if where == "dynamics" else u)
    if where == "running cost":
        phase.running_cost(0.01 * drag)
    if where == "constraint":
        phase.constraint("drag", drag, upper=10.0)
    if where == "end cost":
        phase.end_cost(0.01 * drag)
    if where == "end constraint":
        phase.end_constraint("drag", drag, upper=10.0)
    phase.end_cost(phase.duration)
    return problem


CASES = [
    *((way, "dynamics") for way in WAYS),
    *(("linear", k) for k in ("running cost", "constraint", "end cost", "end constraint")),
]


@pytest.mark.parametrize(("way", "where"), sampled_rows(CASES, 3))
def test_a_table_left_is_said_with_where(way, where):
    problem = car(way, where)
    solution = solve(problem, 12, settings=SolverSettings("ipopt"))
    assert solution.status is Status.OUTSIDE_TABLE
    tells(solution.advice, "table drag", "1.5", "phase 'run'")
    certificate = verify(problem, solution)
    assert not certificate.ok
    tells(certificate.verdict, "table drag", "1.5", "phase 'run'")
    (use,) = [k for k in certificate.limits if k.kind == "table" and k.relative > 0]
    assert use.limit == 1.5
    assert use.time == pytest.approx(solution.duration, rel=0.15)
    assert use.value == pytest.approx(solution["run"]["v"].max(), rel=0.1)


@pytest.mark.thorough
def test_within_the_grid_nothing_is_said():
    problem = car(fastest=1.5)
    solution = solve(problem, settings=SolverSettings("ipopt"))
    assert solution.status is not Status.OUTSIDE_TABLE
    assert "table" not in solution.advice
    uses = [k for k in verify(problem, solution).limits if k.kind == "table"]
    assert uses
    assert all(use.relative <= Thresholds().excess for use in uses)


@pytest.mark.thorough
@pytest.mark.slow
def test_a_table_left_is_final_for_a_whole_solve():
    solution = solve(car("bspline"))
    assert solution.status is Status.OUTSIDE_TABLE
    assert len(solution.history) <= 4
