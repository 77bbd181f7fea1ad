"""Relations in the place of bounds, and what is refused because no solver could act on it."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from helpers import refused, sampled, tells
from microbot_ocp.ocp import OptimalControlProblem, Phase, SolverSettings, explain, verify
from ocp.textbook import solve_once as solve


def way(*, cost: bool = True) -> tuple[OptimalControlProblem, Phase, ca.MX, ca.MX]:
    """The fastest way of 1 m, at a velocity of at most 10 m/s."""
    problem = OptimalControlProblem("way")
    phase = problem.phase("move", duration=(0.05, 20.0))
    x = phase.state("x", initial=0.0, final=1.0, unit="m")
    v = phase.control("v", lower=-10.0, upper=10.0, shape="linear", unit="m/s")
    phase.derivative(x, v)
    if cost:
        phase.end_cost(phase.duration)
    return problem, phase, x, v


ALONG = {
    "upper": (lambda x, v: v <= 0.5, 2.0),
    "strict": (lambda x, v: v < 0.5, 2.0),
    "number first": (lambda x, v: 0.5 >= v, 2.0),
    "chain": (lambda x, v: -1.0 <= (v <= 0.5), 2.0),
    "chain the other way": (lambda x, v: (-1.0 <= v) <= 0.5, 2.0),
    "both": (lambda x, v: ca.logic_and(v <= 0.5, v >= -1.0), 2.0),
    "equal": (lambda x, v: v == 0.5, 2.0),
    "two expressions": (lambda x, v: v <= 1.0 + x, np.log(2.0)),
    "chain of expressions": (lambda x, v: -x <= (v <= 1.0 + x), np.log(2.0)),
    "column": (lambda x, v: ca.vertcat(v, x) <= [0.5, 2.0], 2.0),
    "column and one number": (lambda x, v: ca.vertcat(v, x - 1.0) <= 0.5, 2.0),
    "array first": (lambda x, v: np.array([0.5, 2.0]) >= ca.vertcat(v, x), 2.0),
}


@pytest.mark.parametrize("case", sampled(ALONG, 4))
def test_a_relation_along_the_phase_holds(case: str) -> None:
    problem, phase, x, v = way()
    relation, duration = ALONG[case]
    phase.constraint("limit", relation(x, v), unit="m/s")
    other_ways = SolverSettings() if case == "equal" else None  # it leaves the start no freedom
    solution = solve(problem, mesh=20, settings=other_ways, scheme="radau")
    assert solution.cost == pytest.approx(duration, rel=1e-4)  # a linear control
    assert verify(problem, solution).ok


def test_relations_at_ends_and_of_the_problem_hold() -> None:
    for declare in (
        lambda problem, phase: phase.end_constraint("late", phase.duration >= 5.0),
        lambda problem, phase: phase.end_constraint("late", phase.duration == 5.0),
        lambda problem, phase: problem.constraint("late", 5.0 <= (phase.duration <= 6.0)),
    ):
        problem, phase, _, _ = way()
        declare(problem, phase)
        assert solve(problem, mesh=4).duration == pytest.approx(5.0, rel=1e-6)


def test_a_relation_at_a_point_holds() -> None:
    problem, phase, _, v = way()
    phase.point_constraint("start", v == 0.25, at=0.0)
    assert solve(problem, mesh=8)["move"]["v"][0, 0] == pytest.approx(0.25)


def test_a_relation_with_a_parameter_holds() -> None:
    problem, phase, _, v = way()
    phase.constraint("limit", v <= phase.parameter("largest", 0.25))
    assert solve(problem, mesh=4).cost == pytest.approx(4.0, rel=1e-6)


def test_an_algebraic_equation_may_be_one() -> None:
    problem, phase, _, v = way()
    force = phase.algebraic("force", upper=1.0, unit="N")
    phase.algebraic_equation(force == 2.0 * v)
    solution = solve(problem, mesh=8, scheme="radau")
    assert solution.cost == pytest.approx(2.0, rel=1e-6)


def test_relations_that_conflict_are_named() -> None:
    problem, phase, _, v = way()
    phase.constraint("slow", v <= 0.5)
    phase.end_constraint("early", phase.duration <= 1.0)
    solution = solve(problem, mesh=8)
    assert not solution.solved
    assert "early" in str(explain(problem, mesh=8)) or "slow" in str(explain(problem, mesh=8))


REFUSED = {
    "no bounds": (
        lambda p, k, x, v: k.constraint("c", v),
        ("constraint 'c'", "no bounds", "x <= 1"),
    ),
    "numbers": (
        lambda p, k, x, v: k.constraint("c", ca.MX(1) <= 2),
        ("constraint 'c'", "no bounds"),
    ),
    "truth": (lambda p, k, x, v: p.constraint("c", True), ("constraint 'c'", "no bounds")),
    "several": (
        lambda p, k, x, v: k.constraint("c", ca.vertcat(v <= 1, x <= 2)),
        ("constraint 'c'", "no bounds"),
    ),
    "bounds, too": (
        lambda p, k, x, v: k.constraint("c", v <= 1, upper=3),
        ("constraint 'c'", "relation", "bounds as well"),
    ),
    "unequal": (
        lambda p, k, x, v: k.constraint("c", v != 1),
        ("constraint 'c'", "(1!=move.v)", "<=, >= and =="),
    ),
    "or": (
        lambda p, k, x, v: k.constraint("c", ca.logic_or(v < 1, v > 2)),
        ("constraint 'c'", "||", "<=, >= and =="),
    ),
    "of a relation": (
        lambda p, k, x, v: k.constraint("c", (v == x) <= 3),
        ("constraint 'c'", "(move.v==move.x)", "relation"),
    ),
    "in a column": (
        lambda p, k, x, v: k.constraint("c", ca.vertcat(v <= 1, x), upper=1),
        ("constraint 'c'", "comparison", "'(move.v<=1)'"),
    ),
    "two values": (
        lambda p, k, x, v: k.constraint("c", ca.if_else(v > 1, 3, 2), upper=2.5),
        ("constraint 'c'", "comparison", "(1<move.v)"),
    ),
    "cost": (
        lambda p, k, x, v: p.cost(k.duration <= 5),
        ("end cost", "(move.duration<=5)", "relation"),
    ),
    "cost with a weight": (
        lambda p, k, x, v: k.end_cost(9 * (x <= 5)),
        ("end cost", "comparison", "'(9*(move.x<=5))'"),
    ),
    "part of a cost": (
        lambda p, k, x, v: k.running_cost(v**2 + 9 * (v > 2)),
        ("running cost", "comparison", "'(9*(2<move.v))'"),
    ),
    "initial": (
        lambda p, k, x, v: k.state("y", initial=x == 1),
        ("initial of 'y'", "(1==move.x)", "relation"),
    ),
    "lower": (
        lambda p, k, x, v: k.state("y", lower=x <= 1),
        ("lower of 'y'", "(move.x<=1)", "relation"),
    ),
    "integral": (lambda p, k, x, v: k.integral("y", v**2 <= 1), ("(sq(move.v)<=1)", "relation")),
    "derivative": (lambda p, k, x, v: k.derivative(x, v <= 1), ("(move.v<=1)", "relation")),
    "value": (lambda p, k, x, v: k.final(x <= 1), ("(move.x<=1)", "relation")),
    "start": (
        lambda p, k, x, v: p.phase("b", 1.0, start=k.duration >= 3),
        ("start of phase 'b'", "(3<=move.duration)", "relation"),
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_no_solver_could_act_on_is_refused(case: str) -> None:
    declare, said = REFUSED[case]
    with refused(*said):
        declare(*way())


def test_a_cost_by_cases_is_accepted() -> None:
    problem, phase, _, v = way(cost=False)
    phase.running_cost(ca.if_else(v > 1.0, (v - 1.0) ** 2, 0.0) + phase.time)
    assert solve(problem, mesh=10).solved


def test_a_problem_without_a_cost_says_so() -> None:
    problem, _, _, _ = way(cost=False)
    solution = solve(problem, mesh=10)
    assert solution.solved
    tells(solution.advice, "No cost")
    tells(verify(problem, solution).verdict, "no cost")
