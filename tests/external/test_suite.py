"""The suite of published problems: the table is sound, its runner tells what happened."""

from __future__ import annotations

import argparse
from functools import cache

import pytest
from benchmarks.suite import runner
from benchmarks.suite.peer import solve_by_opti
from benchmarks.suite.problem import SuiteProblem
from benchmarks.suite.table import BY_NAME, PROBLEMS

from helpers import tells
from microbot_ocp.ocp import OptimalControlProblem, Phase

pytestmark = pytest.mark.slow

each = pytest.mark.parametrize("problem", PROBLEMS, ids=lambda p: p.name)


@cache
def built(name: str) -> OptimalControlProblem:
    """Build a problem of the suite once for all that is asked of its declaration."""
    return BY_NAME[name].build()


def test_there_are_enough_problems_and_no_name_twice():
    assert len(PROBLEMS) >= 40
    assert len(BY_NAME) == len(PROBLEMS)


@each
def test_the_declaration_is_complete(problem: SuiteProblem):
    built(problem.name).check()
    assert problem.build.__doc__
    assert problem.source
    assert problem.confirmed


@each
def test_nothing_is_tuned(problem: SuiteProblem):
    """No scales and no shapes of controls: what a user declares at first."""
    declared = built(problem.name)
    for phase in declared.phases:
        assert not any(v.scaled for v in phase.variables)
        # what goes on from another phase has to be continuous
        linked = {name for link in declared.links for name in link.names}
        assert all(c.shape == "auto" or c.name in linked for c in phase.controls)
        assert not any(c.scaled for c in [*phase.constraints, *phase.end_constraints])
        assert phase.duration_scale is None


def variables_of(phase: Phase) -> set[str]:
    return {v.name for v in phase.variables}


@pytest.mark.parametrize("problem", [p for p in PROBLEMS if p.guess], ids=lambda p: p.name)
def test_the_guess_speaks_of_the_problem(problem: SuiteProblem):
    assert problem.guess is not None
    guesses = problem.guess()
    phases = {phase.name: phase for phase in built(problem.name).phases}
    assert guesses.keys() == phases.keys()
    for name, guess in guesses.items():
        assert guess.values.keys() <= variables_of(phases[name])
        low, high = phases[name].duration_bounds
        assert low <= guess.duration <= high


@pytest.mark.parametrize("problem", [p for p in PROBLEMS if p.reference], ids=lambda p: p.name)
def test_recomputed_optima_agree_with_the_figures_printed(problem: SuiteProblem):
    assert problem.optimum == pytest.approx(problem.published, rel=problem.tolerance)


QUICK = (
    "two_sided_effort",
    "interior_point",
    "dubins_car",
    pytest.param("lunar_ascent", marks=pytest.mark.thorough),
    "breakwell",
    "bryson_denham_touch",
    "bressan",
    "two_obstacles",
)


@pytest.mark.parametrize("name", QUICK)
def test_plain_casadi_meets_closed_forms(name: str):
    problem = BY_NAME[name]
    result = solve_by_opti(problem.build(), 50, problem.guess and problem.guess())
    assert result.solved
    assert problem.error(result.cost) < 1e-5  # IPOPT moves bounds outwards by 1e-8


def options(**changed: object) -> argparse.Namespace:
    return argparse.Namespace(
        **{"limit": 60, "scheme": None, "controls": None, "mesh": None, **changed}
    )


@pytest.mark.thorough
def test_a_child_says_what_it_found():
    smooth = options(scheme="radau", controls="polynomial")  # as exact as no other shape
    found = runner.run_child("breakwell", "solve", smooth)
    assert found["status"] == "solved"
    assert BY_NAME["breakwell"].error(found["cost"]) < 1e-5
    assert found["iterations"] > 0


@pytest.mark.thorough
def test_a_child_that_does_not_end_is_a_timeout():
    found = runner.run_child("cracking", "peer", options(limit=1, mesh=3000))
    assert found["status"] == runner.TIMEOUT
    assert found["cost"] is None


@pytest.mark.thorough
def test_an_error_is_a_status():
    found = runner.run_child("interior_point", "solve", options(scheme="magic"))
    tells(found["status"], "InputError", "scheme", "shooting, radau", "'magic'")


def test_the_counts_tell_success_from_what_is_called_so():
    optimum = BY_NAME["dubins_car"].optimum
    made = {
        "good": {"cost": optimum, "solved": True, "status": "solved"},
        "near": {"cost": 1.0005 * optimum, "solved": False, "status": "iteration limit"},
        "wrong": {"cost": 1.01 * optimum, "solved": True, "status": "solved"},
        "lost": {"cost": None, "solved": False, "status": runner.TIMEOUT},
    }
    problem = BY_NAME["dubins_car"]
    assert [runner.met(problem, result) for result in made.values()] == [True, True, False, False]
    assert runner.verdict(problem, made["wrong"]).endswith("WRONG")
    assert runner.verdict(problem, made["lost"]) == runner.TIMEOUT
    said = runner.counts({"dubins_car": {"solve": made["wrong"]}}, "solve")
    assert said == (
        "ocp.solve: 0 of 1 within 0.1 % (0 of them reported as solved), 1 wrong successes, "
        "0 timeouts"
    )
