"""Coarse to fine: which intervals are split, what is accepted, when it stops."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from microbot_ocp.ocp.refinement import Refiner, split
from microbot_ocp.ocp.search import solve
from microbot_ocp.ocp.solution import Attempt, PhaseSolution, Solution, Status
from microbot_ocp.ocp.solvers import SolveContext, SolverSettings
from microbot_ocp.ocp.transcription import Guess, Transcription
from ocp.textbook import bryson_denham


@pytest.mark.parametrize(
    ("bad", "expected"),
    [
        ([0, 0, 0, 0], [0.0, 0.1, 0.4, 0.6, 1.0]),
        ([0, 0, 0, 1], [0.0, 0.1, 0.4, 0.5, 0.6, 0.8, 1.0]),
        ([1, 0, 0, 0], [0.0, 0.05, 0.1, 0.25, 0.4, 0.6, 1.0]),
        ([0, 1, 0, 0], [0.0, 0.05, 0.1, 0.25, 0.4, 0.5, 0.6, 1.0]),
        ([1, 0, 0, 1], [0.0, 0.05, 0.1, 0.25, 0.4, 0.5, 0.6, 0.8, 1.0]),
    ],
)
def test_bad_intervals_and_their_neighbours_are_halved(bad, expected):
    mesh = np.array([0.0, 0.1, 0.4, 0.6, 1.0])
    np.testing.assert_allclose(split(mesh, np.array(bad, dtype=bool)), expected, rtol=1e-15)


@pytest.mark.parametrize(
    ("row", "bad", "expected"),
    [
        (1, [1, 1, 1, 1, 1], [0.0, 0.05, 0.1, 0.25, 0.4, 0.5, 0.6, 1.0]),
        (1, [0, 0, 1, 0, 0], [0.0, 0.05, 0.1, 0.175, 0.25, 0.325, 0.4, 0.5, 0.6, 1.0]),
        (1, [0, 0, 0, 1, 1], [0.0, 0.05, 0.1, 0.25, 0.325, 0.4, 0.5, 0.6, 1.0]),
        (3, [1, 0, 0, 0, 0], [0.0, 0.1, 0.4, 0.5, 0.6, 0.65, 0.7, 1.0]),
    ],
)
def test_the_bad_stretch_of_an_interval_is_cut_out_and_halved(row, bad, expected):
    mesh = np.array([0.0, 0.1, 0.4, 0.6, 1.0])
    table = np.zeros((4, 5), dtype=bool)
    table[row] = bad
    np.testing.assert_allclose(split(mesh, table), expected, rtol=1e-14)


def solution(cost, status=Status.SOLVED, mesh=4, solver="ipopt"):
    fractions = np.linspace(0.0, 1.0, mesh + 1) if isinstance(mesh, int) else np.asarray(mesh)
    attempt = Attempt(solver, status, "", 1, cost, 0.0, 0.0, 0.0, 0.0)
    phase = PhaseSolution("move", abs(cost), fractions, {})
    return Solution(status, cost, (phase,), (attempt,), np.zeros(0), 0.0)


@pytest.fixture
def pretend(monkeypatch):
    """A refiner whose solves return what is written down here, in order."""

    def prepare(answers, excess=lambda _: [np.zeros(4)], **options):
        calls = []

        def solve(context, mesh, guesses, *, once=False):
            calls.append((mesh[0] if isinstance(mesh, list) else mesh, guesses, context.settings))
            return answers[len(calls) - 1]

        monkeypatch.setattr(SolveContext, "solve", solve)
        refiner = Refiner(None, lambda s: {"from": s.cost}, excess, 0.01, **options)
        return refiner, calls

    return prepare


@pytest.mark.parametrize(
    ("before", "after", "accepted"),
    [
        (solution(2.0), solution(1.9), True),
        (solution(2.0), solution(2.0 * (1 + 0.9e-3)), True),
        (solution(2.0), solution(2.0 * (1 + 1.1e-3)), False),
        (solution(-2.0), solution(-2.0 * (1 - 0.9e-3)), True),
        (solution(-2.0), solution(-2.0 * (1 - 1.1e-3)), False),
        (solution(2.0), solution(1.0, Status.ITERATION_LIMIT), False),
        (solution(2.0), solution(1.0, Status.INFEASIBLE), False),
        (solution(2.0, Status.FAILED), solution(3.0), True),
    ],
)
def test_a_worse_or_failed_finer_result_is_not_accepted(pretend, before, after, accepted):
    said = []
    refiner, calls = pretend([after] * 3, progress=said.append)
    result = refiner.finer(before, [8])
    assert result is (after if accepted else before)
    assert refiner.history[-1]["accepted"] is accepted
    assert ("not accepted" in said[-1]) is not accepted
    assert len(refiner.history) == len(calls)
    assert all(guesses == {"from": before.cost} for _, guesses, _ in calls)


def test_a_failed_solve_is_repeated_with_the_usual_barrier_parameter(pretend):
    bad, good = solution(2.0, Status.FAILED), solution(1.9)
    refiner, calls = pretend([bad, good])
    assert refiner.finer(solution(2.0), [8]) is good
    assert [settings.initial_barrier for _, _, settings in calls] == [1e-4, None]
    assert [entry["accepted"] for entry in refiner.history] == [False, True]


def test_refinement_stops_where_the_excess_is_allowed(pretend):
    excess = {4: [np.array([0.0, 0.05, 0.0, 0.0])], 7: [np.full(7, 0.009)]}
    refiner, calls = pretend([solution(1.0, mesh=7)], lambda s: excess[s.phases[0].mesh.size - 1])
    refiner.history.append({})
    result = refiner.refine(solution(1.0))
    assert result.cost == 1.0
    assert len(calls) == 1
    np.testing.assert_allclose(calls[0][0], [0.0, 0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 1.0])
    assert [entry["excess"] for entry in refiner.history] == [0.05, 0.009]


@pytest.mark.parametrize(("slowed", "kept"), [(None, 0.99), (lambda _: False, 0.98)])
def test_the_last_motion_within_its_limits_is_returned(pretend, slowed, kept):
    """A mesh split at a switch may exceed limits; what may be slowed down goes on from there."""
    found = {1.0: 0.02, 0.99: 0.005, 0.98: 0.5}

    def switching(answer):
        return [np.ones(answer.phases[0].mesh.size - 1, dtype=bool)]

    def excess(answer):
        return [np.full(answer.phases[0].mesh.size - 1, found[answer.cost])]

    refiner, calls = pretend([solution(0.99), solution(0.98)], excess, rounds=2, enough=slowed)
    refiner.history.append({})
    assert refiner.refine(solution(1.0), switching).cost == kept
    assert len(calls) == 2


@pytest.mark.parametrize(("most", "solves"), [(0, 0), (1, 1), (2, 2), (np.inf, 4)])
def test_switches_are_split_on_the_first_meshes_alone(pretend, most, solves):
    answers = [solution(1.0 - 0.01 * k) for k in range(1, 8)]
    refiner, calls = pretend(answers, rounds=4)
    refiner.history.append({})
    refiner.refine(solution(1.0), lambda _: [np.ones(4, dtype=bool)], most=most)
    assert len(calls) == solves


def test_nothing_is_solved_where_the_first_mesh_is_fine_enough(pretend):
    refiner, calls = pretend([], lambda _: [np.full(4, 0.01)])
    refiner.history.append({})
    first = solution(1.0)
    assert refiner.refine(first) is first
    assert not calls


def test_a_solution_that_failed_is_not_refined(pretend):
    refiner, calls = pretend([], lambda _: pytest.fail("asked for the excess of a failure"))
    first = solution(1.0, Status.ITERATION_LIMIT)
    assert refiner.refine(first) is first
    assert not calls


def test_refinement_gives_up_after_its_rounds(pretend):
    answers = [solution(1.0) for _ in range(20)]
    refiner, calls = pretend(answers, lambda _: [np.full(4, 0.5)], rounds=3)
    refiner.history.append({})
    assert refiner.refine(solution(1.0)) is answers[2]
    assert len(calls) == 3


def test_a_round_that_is_refused_is_the_last(pretend):
    failed = solution(0.5, Status.FAILED)
    refiner, calls = pretend([failed] * 20, lambda _: [np.full(4, 0.5)], rounds=5)
    refiner.history.append({})
    first = solution(1.0)
    assert refiner.refine(first) is first
    assert len(calls) <= 2  # once as it is, once more with another start of the solver


@pytest.mark.parametrize(
    ("excess", "answers", "kept"),
    [
        (8.79, [2.0], 0),  # cheaper only by the limits that it exceeds
        (0.2, [1.1], 0),
        (0.2, [2.0, 1.5], 1),  # the cheaper one of two
        (0.2, [1.5, 2.0], 0),
        (0.009, [2.0, 1.5], None),  # it keeps its limits: a dearer answer is another optimum
    ],
)
def test_an_answer_that_exceeds_its_limits_does_not_refuse_a_dearer_one(
    pretend, excess, answers, kept
):
    found = [solution(cost) for cost in answers]
    refiner, calls = pretend(found, lambda _: [np.full(4, excess)])
    first = solution(1.0)
    assert refiner.finer(first, [8]) is (first if kept is None else found[kept])
    assert len(calls) == len(found)


def bulge(result):
    """How far every interval of the flight rises above its ceiling of 1/9 m, as a share of it."""
    fly = result["fly"]
    inside = np.diff(fly.t)[:, None] * np.linspace(0.0, 1.0, 41)
    h = np.diff(fly.t)[:, None]
    slope = np.diff(fly["u"], axis=0) / h
    arcs = fly["x"][:-1] + fly["v"][:-1] * inside
    arcs = arcs + fly["u"][:-1] * inside**2 / 2 + slope * inside**3 / 6
    return [9.0 * arcs.max(axis=1) - 1.0]


def test_a_real_problem_is_refined_until_its_ceiling_holds_between_mesh_points():
    top = 1 / 9

    def guess_from(result):
        fly = result["fly"]
        values = {
            name: partial(
                lambda table, s: np.interp(s, fly.mesh, table)[:, None], fly[name].ravel()
            )
            for name in ("x", "v", "u")
        }
        return {"fly": Guess(fly.duration, values)}

    refiner = Refiner(Transcription(bryson_denham(top)), guess_from, bulge, limit_tolerance=1e-5)
    first = refiner.solve(5, guess_from(solve(bryson_denham(top), 5)))
    assert bulge(first)[0].max() > 1e-3
    last = refiner.refine(first)
    assert bulge(last)[0].max() <= 1e-5
    assert last["fly"].mesh.size < 80  # local, not everywhere
    assert last.cost == pytest.approx(4.0, rel=2e-3)
    assert [entry["intervals"][0] for entry in refiner.history] == sorted(
        entry["intervals"][0] for entry in refiner.history
    )


def test_what_is_to_be_tried_once_is_given_up_where_the_first_start_fails(pretend):
    refiner, calls = pretend([solution(2.0, Status.ITERATION_LIMIT)], once=True)
    before = solution(2.1)
    assert refiner.finer(before, [8]) is before
    assert len(calls) == 1


@pytest.mark.parametrize(("once", "attempts"), [(True, 1), (False, 2)])
def test_a_warm_solve_that_is_to_be_tried_once_is_not_repeated_without_multipliers(once, attempts):
    transcription = Transcription(bryson_denham(top=1 / 9), scheme="trapezoidal")
    refiner = Refiner(transcription, lambda s: {}, lambda s: [np.zeros(40)], 0.01, once=once)
    coarse = refiner.solve(20, {})
    assert coarse.status.solved
    few = SolverSettings("ipopt", max_iterations=1)
    finer = replace(refiner, settings=few).solve(40, coarse)
    assert finer.status is Status.ITERATION_LIMIT
    assert len(finer.attempts) == attempts


def test_a_cheap_answer_far_beyond_its_limits_is_not_accepted(pretend):
    answers = [solution(1e-3), solution(1.9)]
    refiner, calls = pretend(answers, lambda s: [np.full(4, 1e4 if s.cost < 1.0 else 0.005)])
    assert refiner.finer(solution(2.0), [8]).cost == 1.9
    assert len(calls) == 2
