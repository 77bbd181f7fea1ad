"""What a solve did: the loop of its meshes, their history, and the ledger of its strategies."""

import json

import pytest

from microbot_ocp import Status
from microbot_ocp.ocp import Accuracy, load_solution, save_solution, solve
from microbot_ocp.ocp.mesh import refined
from ocp.textbook import double_integrator


@pytest.fixture(scope="module")
def solution():
    return solve(double_integrator(), 7, accuracy=Accuracy(1e-6, rounds=3))


def halvings(accept, most=5):
    """Of a number, until it is below one."""
    return list(
        refined(
            8.0,
            solve=lambda answer, factor: answer * factor,
            measure=lambda rounds, answer: (len(rounds), answer),
            split=lambda rounds: 0.5,
            accept=accept,
            stop=lambda rounds, _: Status.SOLVED if rounds[-1].solution < most else None,
        )
    )


def test_a_refinement_is_seen_round_by_round_and_says_why_it_ended():
    states = halvings(lambda before, after: after < before, most=1.5)
    assert [state.solution for state in states] == [8.0, 4.0, 2.0, 1.0, 1.0]
    assert [state.ended for state in states] == [None] * 4 + [Status.SOLVED]
    assert states[-1].measure == (3, 1.0)
    assert states[0].rounds == states[-1].rounds[:1]


def test_what_is_not_accepted_ends_a_refinement():
    *_, last = halvings(lambda before, after: after > 3.0, most=1.5)
    assert (last.solution, last.refused, last.ended) == (4.0, 2.0, Status.NOT_ACCEPTED)


def test_every_strategy_has_a_row_that_says_whether_it_decided(solution):
    rows = {row.strategy: row for row in solution.ledger}
    given, finer = rows["as given"], rows["on a finer mesh"]
    assert given.decided
    assert finer.decided
    assert given.cost_before is None
    assert given.cost_after == finer.cost_before == solution.history[0].cost
    assert finer.cost_after == solution.cost
    assert finer.run == len(solution.history) - 1
    assert not rows["from other starts"].decided
    spent = sum(max(attempt.iterations, 0) for attempt in solution.attempts)
    assert given.iterations + finer.iterations == spent
    assert finer.strategy in str(solution.ledger)


def test_the_ledger_is_kept_in_files(solution, tmp_path):
    path = save_solution(solution, tmp_path / "solution.npz")
    assert load_solution(path).ledger == solution.ledger
    assert json.loads(json.dumps(solution.ledger.as_dicts()))[0]["strategy"] == "as given"
