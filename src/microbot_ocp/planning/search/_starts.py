"""Initial guesses of a search, and their answers on a coarse mesh.

Guesses are drawn at random, or follow ways through the stops with every segment timed from rest to
rest. If none converges, a relaxed problem follows. Among obstacles the only guess is a timed path.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from microbot_ocp.ocp import Solution
from microbot_ocp.ocp.refinement import Refiner
from microbot_ocp.planning.free import (
    InitialGuess,
    accelerations_jump,
    guess_along,
    guesses_from,
    initial_guesses,
    least_violation,
    limited_rates,
)
from microbot_ocp.planning.search._branches import Way, bound_of, segment_timings
from microbot_ocp.planning.search._problem import MotionProblem, TrialStart
from microbot_ocp.planning.search._search import (
    NOTHING,
    START,
    MotionAnswer,
    MotionSearch,
    SearchState,
    by_promise,
    settled,
)
from microbot_ocp.planning.search._settings import (
    COARSE_MESH,
    COARSE_TOLERANCE,
    FULL_MESH,
    MOST_ITERATIONS,
    NEAR_WAY_BARRIER,
    TIMED_PATH_BARRIER,
)
from microbot_ocp.planning.task import Task, TaskScale, rounded
from microbot_ocp.trajectories import cubic, spline

RELAXED = "relaxed problem"  # step in the ledger
COARSE_MESH_SUM = 160  # intervals of all phases of a coarse mesh together
LEAST_COARSE_MESH = 6  # intervals per phase
EXPLORING = 0.5  # share of the time limit after which no further start is solved
FULL_MESH_EVEN = 100  # intervals per phase, for continuous accelerations
FULL_MESH_SUM = 400  # intervals of all phases of the first full mesh together
LEAST_FULL_MESH = 25  # intervals per phase
CURVED_GUESSES = 2  # number of curved initial guesses along the best way through stops


def explore_mesh(search: MotionSearch) -> int:
    """Return the number of intervals per phase of the coarse mesh."""
    # Many phases share a sum of intervals: the cost of a solve depends on the sum.
    fewest = max(COARSE_MESH_SUM // len(search.problem.names), LEAST_COARSE_MESH)
    finer = search.problem.finer
    if search.problem.is_guided_by_rates:
        # 20 intervals cost some ways 3 % of the duration and others nothing: they could not be
        # compared.
        finer *= 2
    return min(full_mesh(search), finer * min(fewest, COARSE_MESH))


def full_mesh(search: MotionSearch) -> int:
    """Return the number of intervals per phase of the first full mesh."""
    if search.settings.mesh is not None:
        return search.settings.mesh
    family = search.problem.family
    switching = accelerations_jump(family) or limited_rates(family)
    most = FULL_MESH if switching else FULL_MESH_EVEN
    return max(min(most, FULL_MESH_SUM // len(search.problem.names)), LEAST_FULL_MESH)


def coarse(search: MotionSearch) -> Refiner:
    """Return the refiner of coarse answers, with dry friction rounded off."""
    refiner = replace(search.refiner, history=[])
    if refiner.fitted is None:
        return refiner
    kernels = rounded(refiner.transcription, search.problem.scale.velocity)
    return replace(refiner, transcription=kernels)


# answers on a coarse mesh ------------------------------------------------------------------------


def explore(search: MotionSearch, state: SearchState = NOTHING) -> SearchState:
    """Return the state with starts solved until another is unlikely to be the best.

    If none is solved, the relaxed problem follows.
    """
    while not state.interrupted and (step := _next_step(search, state)) is not None:
        begin = time.perf_counter()
        state = state.and_(step(), begin)
    return state


def _next_step(search: MotionSearch, state: SearchState) -> Callable[[], MotionAnswer] | None:
    """Return the next solve on a coarse mesh, or None."""
    problem, done = search.problem, {answer.step for answer in state.answers}
    if problem.timed_path is not None:
        return None if done else partial(from_timed_path, search)
    late = search.over or search.spent > EXPLORING
    step = None if done and late else next_start(search, state)
    if step is not None or RELAXED in done or any(answer.solved for answer in state.answers):
        return step
    # A comparison of orders, or a task that was solved before, needs no reason for a failure.
    if search.over or problem.for_comparison or problem.again:
        return None
    return partial(from_relaxed, search, nearest(state))


def sample(state: SearchState) -> list[MotionAnswer]:
    """Return the starts that are compared: all that were solved on the finest mesh of any start."""
    finest = max((answer.intervals for answer in state.starts if answer.solved), default=0)
    return [answer for answer in state.starts if answer.intervals == finest or not finest]


def next_start(search: MotionSearch, state: SearchState) -> Callable[[], MotionAnswer] | None:
    """Return the solve of a fresh start while another one is likely to lead to a new optimum.

    If the first starts disagree, they and all later ones are compared on a mesh twice as fine:
    optima of a coarse mesh are not those of a fine one.
    """
    tried, settings = state.starts, search.settings
    if not search.problem.is_free or len(tried) < settings.starts:
        return _fresh(search, state)
    compared = sample(state)
    if settled(compared, settings):
        return None
    # Different optima may be artefacts of the coarse mesh: each is solved once on a finer one.
    first, second = _start_meshes(search)
    if any(answer.solved for answer in tried):
        carried = by_promise([answer for answer in tried if answer.intervals == first])
        for answer in carried if second > first else ():
            if state.continued(answer) is None:
                return partial(on_finer_mesh, search, answer, second)
    return _fresh(search, state)


def _fresh(search: MotionSearch, state: SearchState) -> Callable[[], MotionAnswer] | None:
    """Return the solve of the next initial guess, on the mesh on which answers are compared."""
    drawn = search.problem.is_free and not search.problem.for_comparison
    start = (_next_drawn if drawn else _next_through_ways)(search.problem, state)
    carried = any(answer.before is not None for answer in state.starts)
    return start and partial(from_guess, search, start, _start_meshes(search)[carried])


def _start_meshes(search: MotionSearch) -> tuple[int, int]:
    first = explore_mesh(search)
    return first, min(2 * first, full_mesh(search))


def from_guess(search: MotionSearch, start: TrialStart, intervals: int) -> MotionAnswer:
    """Solve from an initial guess."""
    refiner, name = coarse(search), start.guess.name
    refiner = replace(refiner, settings=replace(refiner.settings, **start.settings))
    given = {"tolerance": COARSE_TOLERANCE, "barrier": start.barrier}
    solution = refiner.solve(intervals, start.guess.guesses, **given)
    _report(search, name, solution, f" on {intervals} intervals a phase")
    return _answer(search, name, solution, refiner, way=start.way)


def on_finer_mesh(search: MotionSearch, answer: MotionAnswer, intervals: int) -> MotionAnswer:
    """Solve on a finer coarse mesh from an answer."""
    refiner = replace(coarse(search), rough=COARSE_TOLERANCE, once=True)
    solution = refiner.finer(answer.solution, [intervals] * len(search.problem.names))
    _report(search, answer.start, solution, f" on {intervals} intervals a phase")
    return _answer(search, answer.start, solution, refiner, way=answer.way, before=answer)


def _report(search: MotionSearch, start: str, solution: Solution, where: str = "") -> None:
    search.progress(f"start {start}: {solution.duration:.4f} s{where}, {solution.status}")


def _answer(
    search: MotionSearch,
    start: str,
    solution: Solution,
    by: Refiner,
    step: str = START,
    **more: Any,
) -> MotionAnswer:
    """Return a coarse answer with the refiner that continues it on the usual kernels."""
    given = {"solves": tuple(by.history), "step": step, **more}
    return MotionAnswer(start, solution, search.refiner, search.problem.smoothing, **given)


def nearest(state: SearchState) -> MotionAnswer:
    """Return the first answer that violates the constraints least."""
    return min(
        (answer for answer in state.answers if answer.is_first),
        key=lambda a: (not a.solution.attempts, a.solution.attempts[-1].infeasibility),
    )


def from_relaxed(search: MotionSearch, subject: MotionAnswer) -> MotionAnswer:
    """Solve for the least violation of the limits; if it is zero, solve from there.

    It tells which limit a task breaks that asks too much.
    """
    refiner, problem = coarse(search), search.problem
    meshes = [phase.mesh for phase in subject.solution.phases]
    # The point at which a solve failed may swing across its limits between mesh points.
    starts = [guess.guesses for k in range(2) if (guess := problem.drawn(k)) is not None]
    relaxed = least_violation(search.problem.kernels(stated=True), starts, meshes)
    search.progress(f"relaxed problem: {relaxed}")
    solution = subject.solution
    if relaxed.conclusive and relaxed.feasible:
        guesses = guesses_from(relaxed)
        solution = refiner.solve(meshes, guesses, tolerance=COARSE_TOLERANCE)
    given = {"way": subject.way, "before": subject, "relaxed": relaxed}
    return _answer(search, subject.start, solution, refiner, RELAXED, **given)


def from_timed_path(search: MotionSearch) -> MotionAnswer:
    """Solve on a coarse mesh near a timed path; motions far from it may collide."""
    problem, path, refiner = search.problem, search.problem.timed_path, coarse(search)
    assert path is not None
    refiner, guesses = replace(refiner, once=False), problem.with_closed(path.guesses)
    solution = refiner.solve(explore_mesh(search), guesses, barrier=TIMED_PATH_BARRIER)
    _report(search, path.name, solution)
    return _answer(search, path.name, solution, refiner, "timed path", way=problem.ways[0])


# initial guesses --------------------------------------------------------------------------------


def _next_drawn(problem: MotionProblem, state: SearchState) -> TrialStart | None:
    """Return the first guess that was not tried."""
    tried = [answer for answer in state.starts if answer.before is None]
    names = {answer.start for answer in tried}
    drawn = map(problem.drawn, itertools.count())
    guess = next(guess for guess in drawn if guess is None or guess.name not in names)
    if guess is None:
        return None
    # Once a motion is known, another guess is cheaper than a slow solve.
    is_known = any(answer.solved for answer in tried)
    limit = {"max_iterations": MOST_ITERATIONS} if is_known else {}
    return TrialStart(guess, problem.ways[0], limit)


def _next_through_ways(problem: MotionProblem, state: SearchState) -> TrialStart | None:
    """Return the next way that may be the fastest; curved guesses along the best way come last."""
    pair = next(_guesses(problem, state), None)
    if pair is None:
        return None
    way, guess = pair
    guess = replace(guess, guesses=problem.with_closed(guess.guesses))
    return TrialStart(guess, way, {"max_iterations": MOST_ITERATIONS}, NEAR_WAY_BARRIER)


def _guesses(problem: MotionProblem, state: SearchState) -> Iterator[tuple[Way, InitialGuess]]:
    """Yield guesses that were not tried: ways first, then curved ones along the best way."""
    tried, task, settings = {a.start for a in state.starts}, problem.task, problem.settings
    for way in problem.ways if settings.starts > 1 else problem.ways[:1]:
        if way.name not in tried and least_of_slower(problem, state, way) is None:
            yield way, rest_to_rest(task, way, problem.names, settings.compiled)
    single = settings.starts == 1 or any(kind is not None for kind in task.segments)
    if problem.for_comparison or single or not tried:
        return
    of_ways = [a for a in state.starts if a.way is not None and a.start == a.way.name]
    best = min(of_ways, key=lambda a: (not a.solved, a.solution.duration)).way
    assert best is not None
    further = min(CURVED_GUESSES, settings.starts - 1) + 1
    given = task.conditions.velocities
    drawn = problem.family, best.via, problem.names, further, settings.seed
    for g in initial_guesses(*drawn, moving=bool(given.any()), velocities=given):
        name = f"{best.name}, {g.name}"
        if name not in tried:
            yield best, replace(g, name=name)


def least_of_slower(problem: MotionProblem, state: SearchState, way: Way) -> float | None:
    """Return a lower bound on the duration of a way, s; None unless another way is faster."""
    durations = [a.solution.duration for a in state.starts if a.solved]
    least = bound_of(problem.task, way)
    return least if least > min([*durations, problem.duration_to_beat]) else None


def rest_to_rest(task: Task, way: Way, names: Sequence[str], compiled: bool) -> InitialGuess:
    """Return every segment from rest to rest, with its best timing if its path can be travelled.

    A free segment that begins or ends in motion is a cubic.
    """
    # Each segment has its own best timing; passing a stop without rest is what the search gains.
    guesses, given = {}, task.conditions.velocities
    durations = TaskScale.of(task.family, way.via, given).durations
    timings = segment_timings(task, way, compiled)
    rows = zip(names, way.paths, durations, timings, task.segments, strict=True)
    for k, (name, path, duration, timed, kind) in enumerate(rows):
        if kind is None and given[k : k + 2].any():
            shape = cubic(path[[0, -1]], [0.0, float(duration)], given[k : k + 2])
        else:
            shape = timed or spline(path, np.linspace(0.0, float(duration), len(path)))
        guesses[name] = guess_along(shape)
    return InitialGuess(way.name, guesses)
