"""Initial guesses of a search, and their answers on a coarse mesh.

Guesses are drawn at random, or follow ways through the stops with every segment timed from rest to
rest. If none converges, a known way and a relaxed problem follow. Among obstacles the only guess is
a timed path.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from microbot_ocp.ocp import Solution
from microbot_ocp.ocp.refinement import Refiner
from microbot_ocp.planning.free import (
    SMOOTHING,
    InitialGuess,
    accelerations_jump,
    guess_along,
    guesses_from,
    initial_guesses,
    least_violation,
    limited_rates,
)
from microbot_ocp.planning.search._branches import Way, few_poses, least_time, segment_timings
from microbot_ocp.planning.search._problem import MotionProblem, TrialStart
from microbot_ocp.planning.search._search import (
    MotionAnswer,
    MotionSearch,
    MotionStrategy,
    NextStep,
    SearchState,
    by_promise,
    settled,
)
from microbot_ocp.planning.search._settings import SEARCH
from microbot_ocp.planning.task import LDL, Task, TaskScale, rounded
from microbot_ocp.trajectories import cubic, spline


def explore_mesh(search: MotionSearch) -> int:
    """Return the number of intervals per phase of the coarse mesh."""
    fewest = max(SEARCH.explore_sum // len(search.problem.names), SEARCH.least_explore_mesh)
    return min(full_mesh(search), search.problem.finer * min(fewest, SEARCH.explore_mesh))


def full_mesh(search: MotionSearch) -> int:
    """Return the number of intervals per phase of the first full mesh."""
    if search.settings.mesh is not None:
        return search.settings.mesh
    family = search.problem.family
    switching = accelerations_jump(family) or limited_rates(family)
    most = SEARCH.full_mesh if switching else SEARCH.full_mesh_even
    return max(min(most, SEARCH.full_mesh_sum // len(search.problem.names)), SEARCH.least_mesh)


def coarse(search: MotionSearch) -> Refiner:
    """Return the refiner of coarse answers, with dry friction rounded off."""
    refiner = replace(search.refiner, history=[])
    if refiner.fitted is None:
        return refiner
    kernels = rounded(refiner.transcription, search.problem.scale.velocity)
    return replace(refiner, transcription=kernels)


def sample(state: SearchState) -> list[MotionAnswer]:
    """Return the starts that are compared: all that were solved on the finest mesh of any start."""
    tried = state.of("start")
    finest = max((answer.intervals for answer in tried if answer.solved), default=0)
    return [answer for answer in tried if answer.intervals == finest or not finest]


def next_start(search: MotionSearch, state: SearchState) -> NextStep | None:
    """Return a fresh start while another one is likely to lead to a new optimum.

    If the first starts disagree, they and all later ones are compared on a mesh twice as fine:
    optima of a coarse mesh are not those of a fine one. Among obstacles there are no such starts.
    """
    tried, settings = state.of("start"), search.settings
    if search.problem.timed_path or (tried and search.over):
        return None
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
            if state.made_of(answer, "start") is None:
                return NextStep(answer, intervals=second)
    return _fresh(search, state)


def _fresh(search: MotionSearch, state: SearchState) -> NextStep | None:
    """Return the next initial guess, on the mesh on which answers are compared."""
    drawn = search.problem.is_free and not search.problem.for_comparison
    start = (_next_drawn if drawn else _next_through_ways)(search.problem, state)
    carried = any(answer.before is not None for answer in state.of("start"))
    return start and NextStep(start=start, intervals=_start_meshes(search)[carried])


def _start_meshes(search: MotionSearch) -> tuple[int, int]:
    first = explore_mesh(search)
    return first, min(2 * first, full_mesh(search))


def try_start(search: MotionSearch, step: NextStep) -> MotionAnswer:
    """Solve from an initial guess, or continue an answer on a finer mesh."""
    refiner, start, tolerance = coarse(search), step.start, SEARCH.explore_tolerance
    if start is None:
        name, way = step.answer.start, step.answer.way
        refiner = replace(refiner, rough=tolerance, once=True)
        meshes = [step.intervals] * len(search.problem.names)
        solution = refiner.finer(step.answer.solution, meshes)
    else:
        name, way = start.guess.name, start.way
        refiner = replace(refiner, settings=replace(refiner.settings, **start.settings))
        guesses, solver = start.guess.guesses, start.solver
        solution = refiner.solve(step.intervals, guesses, tolerance=tolerance, solver=solver)
    _report(search, name, solution, f" on {step.intervals} intervals a phase")
    return _answer(search, name, solution, refiner, way)


def _report(search: MotionSearch, start: str, solution: Solution, where: str = "") -> None:
    search.progress(f"start {start}: {solution.duration:.4f} s{where}, {solution.status}")


def _answer(
    search: MotionSearch, start: str, solution: Solution, by: Refiner, way: Way | None = None
) -> MotionAnswer:
    """Return a coarse answer with the refiner that continues it on the usual kernels."""
    solves = tuple(by.history)
    return MotionAnswer(start, solution, search.refiner, SMOOTHING, solves=solves, way=way)


def _nothing_solved(search: MotionSearch, state: SearchState, strategy: str) -> NextStep | None:
    if search.over or any(answer.solved for answer in state.answers) or state.of(strategy):
        return None
    if search.problem.timed_path:  # a motion within limits is known
        return None
    return NextStep(nearest(state))


def nearest(state: SearchState) -> MotionAnswer:
    """Return the start whose answer violates the constraints least."""
    return min(
        state.of("start", "timed path"),
        key=lambda a: (not a.solution.attempts, a.solution.attempts[-1].infeasibility),
    )


def next_from_known(search: MotionSearch, state: SearchState) -> NextStep | None:
    """Return a step from a known way, if no start was solved."""
    step = _nothing_solved(search, state, "known way")
    return step if step is not None and search.problem.fallback is not None else None


def from_known(search: MotionSearch, step: NextStep) -> MotionAnswer:
    """Solve from a known way with its best timing."""
    way, refiner = search.problem.fallback, coarse(search)
    assert way is not None
    solution = refiner.solve(
        [phase.mesh for phase in step.answer.solution.phases],
        search.problem.guesses_along(way.motion),
        tolerance=SEARCH.explore_tolerance,
        barrier=SEARCH.near_way_barrier,
    )
    _report(search, way.made_from, solution)
    return _answer(search, way.made_from, solution, refiner)


def next_relaxed(search: MotionSearch, state: SearchState) -> NextStep | None:
    """Return a step to the relaxed problem, if nothing was solved."""
    return _nothing_solved(search, state, "relaxed problem")


def from_relaxed(search: MotionSearch, step: NextStep) -> MotionAnswer:
    """Solve for the least violation of the limits; if it is zero, solve from there."""
    subject, refiner, problem = step.answer, coarse(search), search.problem
    meshes = [phase.mesh for phase in subject.solution.phases]
    first = problem.drawn(0)
    assert first is not None
    starts = [first.guesses, subject.solution]
    relaxed = least_violation(search.problem.kernels(stated=True), starts, meshes)
    search.progress(f"relaxed problem: {relaxed}")
    solution = subject.solution
    if relaxed.conclusive and relaxed.feasible:
        guesses = guesses_from(relaxed)
        solution = refiner.solve(meshes, guesses, tolerance=SEARCH.explore_tolerance)
    answer = _answer(search, subject.start, solution, refiner, subject.way)
    return replace(answer, relaxed=relaxed)


def next_timed_path(search: MotionSearch, state: SearchState) -> NextStep | None:
    """Return a step from the timed path among obstacles, once."""
    return NextStep() if search.problem.timed_path and not state.answers else None


def from_timed_path(search: MotionSearch, step: NextStep) -> MotionAnswer:
    """Solve on a coarse mesh near a timed path; motions far from it may collide."""
    problem, path, refiner = search.problem, search.problem.timed_path, coarse(search)
    assert path is not None
    refiner, guesses = replace(refiner, once=False), problem.with_closed(path.guesses)
    solution = refiner.solve(explore_mesh(search), guesses, barrier=SEARCH.timed_path_barrier)
    _report(search, path.name, solution)
    return _answer(search, path.name, solution, refiner, problem.ways[0])


FROM_GUESSES = (
    MotionStrategy(
        "start", next_start, try_start, "local optima are several per cent apart", share=0.5
    ),
    MotionStrategy(
        "known way", next_from_known, from_known, "limits so tight that no guess converges"
    ),
    MotionStrategy(
        "relaxed problem", next_relaxed, from_relaxed, "tasks that ask too much: which limit gives"
    ),
)
FROM_PATHS = (
    MotionStrategy(
        "timed path", next_timed_path, from_timed_path, "obstacles, which other starts run into"
    ),
)


# initial guesses --------------------------------------------------------------------------------


def _next_drawn(problem: MotionProblem, state: SearchState) -> TrialStart | None:
    """Return the first guess that was not tried."""
    tried = [answer for answer in state.of("start") if answer.before is None]
    settings, index = problem.settings, len(tried)
    guess = problem.drawn(index)
    if guess is None:
        return None
    both: str | tuple[str, ...] = ("fatrop", "ipopt")
    if index >= settings.starts:  # the two solvers converge from different guesses
        both = "ipopt" if index % 3 == 2 else "fatrop"
    both = "ipopt" if problem.is_flat else both
    solver = both if settings.solver == "auto" else settings.solver
    solved = [answer for answer in tried if answer.solved]
    if not solved:
        return TrialStart(guess, solver, problem.ways[0])
    solver = solver if isinstance(solver, str) else solver[0]
    most = SEARCH.most_iterations  # another guess is cheaper than a slow solve
    return TrialStart(guess, solver, problem.ways[0], {"max_iterations": most})


def _next_through_ways(problem: MotionProblem, state: SearchState) -> TrialStart | None:
    """Return the next way that may be the fastest; curved guesses along the best way come last."""
    pair = next(_guesses(problem, state), None)
    if pair is None:
        return None
    way, guess = pair
    fatrop = {"max_iter": SEARCH.usual_iterations}
    both = "ipopt" if problem.is_flat else ("fatrop", "ipopt")
    return TrialStart(
        replace(guess, guesses=problem.with_closed(guess.guesses)),
        both if problem.settings.solver == "auto" else problem.settings.solver,
        way,
        # IPOPT takes over when fatrop reaches its own, lower limit
        {"max_iterations": SEARCH.most_iterations, "options": {**LDL, "fatrop": fatrop}},
    )


def _guesses(problem: MotionProblem, state: SearchState) -> Iterator[tuple[Way, InitialGuess]]:
    """Yield guesses that were not tried: ways first, then curved ones along the best way."""
    tried, task, settings = {a.start for a in state.of("start")}, problem.task, problem.settings
    for way in problem.ways if settings.starts > 1 else problem.ways[:1]:
        if way.name not in tried and least_of_slower(problem, state, way) is None:
            yield way, rest_to_rest(task, way, problem.names, settings.compiled)
    single = settings.starts == 1 or any(kind is not None for kind in task.segments)
    if problem.for_comparison or single or not tried:
        return
    of_ways = [a for a in state.of("start") if a.way is not None and a.start == a.way.name]
    best = min(of_ways, key=lambda a: (not a.solved, a.solution.duration)).way
    assert best is not None
    further = min(SEARCH.curved_guesses, settings.starts - 1) + 1
    given = task.conditions.velocities
    drawn = problem.family, best.via, problem.names, further, settings.seed
    for g in initial_guesses(*drawn, moving=bool(given.any()), velocities=given):
        name = f"{best.name}, {g.name}"
        if name not in tried:
            yield best, replace(g, name=name)


def least_of_slower(problem: MotionProblem, state: SearchState, way: Way) -> float | None:
    """Return the duration of a way at the highest velocities, s; None unless another is faster.

    Lower bound: no motion on the way is faster. A redundant or tolerant stop may move its pose, so
    there the bound must exceed the best duration by a factor.
    """
    durations = [a.solution.duration for a in state.of("start") if a.solved]
    exact = all(few_poses(problem.task.robot, stop) is not None for stop in problem.task.stops)
    least = least_time(problem.task, way)
    slower = least > (1.0 if exact else SEARCH.prune_factor) * min(
        [*durations, problem.duration_to_beat]
    )
    return least if slower else None


def rest_to_rest(task: Task, way: Way, names: Sequence[str], compiled: bool) -> InitialGuess:
    """Return every segment from rest to rest, with its best timing if its path can be travelled.

    A free segment that begins or ends in motion is a cubic.
    """
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
