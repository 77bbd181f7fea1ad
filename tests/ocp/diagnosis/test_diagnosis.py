"""Contradictory problems whose cheapest way out is known by hand."""

import numpy as np
import pytest

from helpers import tells
from microbot_ocp.ocp.diagnosis import explain
from microbot_ocp.ocp.problem import OptimalControlProblem
from microbot_ocp.ocp.search import solve
from microbot_ocp.ocp.transcription import Transcription
from ocp.textbook import double_integrator, mass


def hurried(force=1.0, duration=1.0):
    """1 m from rest to rest in 1 s takes 4 m/s^2; with 1 m/s^2 it is 0.25 m."""
    problem = OptimalControlProblem("hurried")
    phase, u = mass(problem, "move", duration, force=force, ends=((0.0, 0.0), (1.0, 0.0)))
    phase.running_cost(u**2)
    return problem


def by_name(items):
    return {(item.kind, item.name, item.side): item for item in items}


def test_the_limits_that_fight_are_named_with_what_each_would_give():
    found = explain(hurried(), 20)
    assert found.conclusive
    assert not found.feasible
    (end,) = found.gives
    assert (end.kind, end.name, end.phase, end.unit) == ("final", "x", "move", "m")
    assert end.amount == pytest.approx(0.75, abs=1e-4)
    alternatives = by_name(item for items in found.alternatives for item in items)
    assert alternatives["initial", "x", ""].amount == pytest.approx(0.75, abs=1e-4)
    assert alternatives["duration", "duration", ""].amount == pytest.approx(1.0, abs=1e-4)
    assert alternatives["limit", "u", "lower"].amount == pytest.approx(3.0, abs=1e-3)
    assert alternatives["limit", "u", "upper"].amount == pytest.approx(3.0, abs=1e-3)
    assert {item.name for item in found.conflicts} == {"v"}


def test_it_says_so_in_words_with_units():
    said = str(explain(hurried(), 20))
    tells(said, "No trajectory", "alone", "end of v in phase 'move'")
    lines = said.splitlines()
    (end,) = (line for line in lines if "end of x in phase 'move' (value 1 m)" in line)
    tells(end, "0.75 m")
    (force,) = (line for line in lines if "u in phase 'move' (upper limit 1 m/s^2)" in line)
    tells(force, "3 m/s^2", "t = ")


def test_a_problem_that_can_be_solved_is_called_so():
    found = explain(double_integrator(), 20)
    assert found.feasible
    assert not found.gives
    tells(str(found), "All limits")
    x = found.phases[0]["x"].ravel()
    np.testing.assert_allclose(x[[0, -1]], [0.0, 1.0], atol=1e-4)


def test_a_ceiling_below_the_goal_is_a_path_constraint_that_fights():
    problem = OptimalControlProblem("ceiling")
    phase, _ = mass(problem, "rise", (0.1, 9.0), force=1.0, ends=((0.0, 0.0), (1.0, None)))
    x = phase.states[0].symbol
    phase.constraint("ceiling", 100.0 * x, upper=90.0, scale=100.0, unit="cm")
    found = explain(problem, 12)
    everything = by_name([*found.gives, *(i for items in found.alternatives for i in items)])
    ceiling = everything["limit", "ceiling", "upper"]
    assert ceiling.amount == pytest.approx(10.0, abs=0.05)
    assert ceiling.unit == "cm"
    assert ceiling.limit == pytest.approx(90.0)
    assert everything["final", "x", ""].amount == pytest.approx(0.1, abs=1e-3)


def test_components_and_phases_are_told_apart():
    problem = OptimalControlProblem("two")
    phases = []
    for name in ("first", "second"):
        phase = problem.phase(name, 1.0)
        last = name == "second"
        p = phase.state(
            "p", 2, initial=None if last else 0.0, final=[0.5, 3.0] if last else None, unit="m"
        )
        w = phase.control("w", 2, lower=-1.0, upper=1.0, unit="m/s")
        phase.derivative(p, w)
        phases.append(phase)
    problem.link(*phases)
    found = explain(Transcription(problem), 8)
    # 1 m/s for 1 s in the second phase, as in the first, must be 2 m: both are sqrt(2) then
    assert sum(item.amount for item in found.gives) == pytest.approx(2 * np.sqrt(2) - 2, abs=1e-3)
    assert {item.name for item in found.gives} == {"duration", "w[1]"}
    (end,) = (i for items in found.alternatives for i in items if i.kind == "final")
    assert (end.phase, end.name) == ("second", "p[1]")
    assert end.amount == pytest.approx(1.0, abs=1e-3)


def test_the_solution_that_failed_is_a_start():
    failed = solve(hurried(), 10)
    assert not failed.status.solved
    (end,) = explain(hurried(), 10, failed).gives
    assert end.amount == pytest.approx(0.75, abs=1e-3)
