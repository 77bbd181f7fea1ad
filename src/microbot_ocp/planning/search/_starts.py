"""The next initial guess of a search: drawn at random, or along a way through the stops."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from statistics import median
from typing import TYPE_CHECKING

from microbot_ocp.planning.free import InitialGuess, initial_guesses
from microbot_ocp.planning.search._branches import Way, few_poses, least_time
from microbot_ocp.planning.search._problem import MotionProblem, TrialStart
from microbot_ocp.planning.search._settings import SEARCH, STOPS
from microbot_ocp.planning.search._way_guesses import rest_to_rest
from microbot_ocp.planning.task import LDL

if TYPE_CHECKING:
    from microbot_ocp.planning.search._search import SearchState


def next_trial(problem: MotionProblem, state: SearchState) -> TrialStart | None:
    """Return the next initial guess, with its solver; None where there are no more."""
    if problem.is_free and not problem.briefly:
        return _next_drawn(problem, state)
    return _next_through_ways(problem, state)


def _next_drawn(problem: MotionProblem, state: SearchState) -> TrialStart | None:
    """Return the guess after those that were tried."""
    tried = [answer for answer in state.of("start") if answer.before is None]
    settings, index = problem.settings, len(tried)
    guess = problem.drawn(index)
    if guess is None:
        return None
    both: str | tuple[str, ...] = ("fatrop", "ipopt")
    if index >= settings.starts:  # what one misses the other may find
        both = "ipopt" if index % 3 == 2 else "fatrop"
    solver = both if settings.solver == "auto" else settings.solver
    solved = [answer for answer in tried if answer.solved]
    if not solved:
        return TrialStart(guess, solver, way=problem.ways[0])
    # what takes so much longer than starts usually do is given up
    usual = median(a.solution.attempts[-1].iterations for a in solved) if index > 1 else 0
    most = max(SEARCH.least_iterations, int(SEARCH.patience * usual))
    solver = solver if isinstance(solver, str) else solver[0]
    return TrialStart(guess, solver, most, problem.ways[0])


def _next_through_ways(problem: MotionProblem, state: SearchState) -> TrialStart | None:
    """Return the next way that may be the fastest; bows beside the best of them at last."""
    pair = next(_guesses(problem, state), None)
    if pair is None:
        return None
    way, guess = pair
    solved = [answer for answer in state.of("start") if answer.solved]
    most = STOPS.most_iterations
    if solved:
        iterations = max(a.solution.attempts[-1].iterations for a in solved)
        most = min(max(SEARCH.least_iterations, SEARCH.patience * iterations), most)
    return TrialStart(
        replace(guess, guesses=problem.with_closed(guess.guesses)),
        ("fatrop", "ipopt") if problem.settings.solver == "auto" else problem.settings.solver,
        most,
        way,
        # IPOPT solves what takes it more
        options={**LDL, "fatrop": {"max_iter": SEARCH.least_iterations}},
    )


def _guesses(problem: MotionProblem, state: SearchState) -> Iterator[tuple[Way, InitialGuess]]:
    """Yield what was not tried yet: ways, and then bows beside the best of them."""
    tried, task, settings = {a.start for a in state.of("start")}, problem.task, problem.settings
    for way in problem.ways if settings.starts > 1 else problem.ways[:1]:
        if way.name not in tried and least_of_slower(problem, state, way) is None:
            yield way, rest_to_rest(task, way, problem.names, settings.compiled)
    single = settings.starts == 1 or any(kind is not None for kind in task.segments)
    if problem.briefly or single or not tried:
        return
    of_ways = [a for a in state.of("start") if a.way is not None and a.start == a.way.name]
    best = min(of_ways, key=lambda a: (not a.solved, a.solution.duration)).way
    assert best is not None
    further = min(STOPS.bows, settings.starts - 1) + 1
    for g in initial_guesses(problem.family, best.via, problem.names, further, settings.seed):
        name = f"{best.name}, {g.name}"
        if name not in tried:
            yield best, replace(g, name=name)


def least_of_slower(problem: MotionProblem, state: SearchState, way: Way) -> float | None:
    """Return what a way takes at the highest velocities, s; None where no other one takes less."""
    durations = [a.solution.duration for a in state.of("start") if a.solved]
    exact = all(few_poses(problem.task.robot, stop) is not None for stop in problem.task.stops)
    least = least_time(problem.task, way)
    slower = least > (1.0 if exact else STOPS.spare) * min([*durations, problem.beaten])
    return least if slower else None
