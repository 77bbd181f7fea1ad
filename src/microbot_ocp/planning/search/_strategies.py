"""The table of strategies by which free motions and motions through stops are found.

The fastest of several local optima on a coarse mesh is solved on a finer one, whose intervals are
split until limits hold between its points. A row is run wherever it has something to work on, the
first of them first.
"""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.status import Status
from microbot_ocp.ocp import Solution, SolverSettings
from microbot_ocp.ocp.refinement import WORSE, Refiner, RefinerSettings
from microbot_ocp.ocp.solution import StepProgress
from microbot_ocp.planning.free import (
    JERK_WEIGHT,
    SMOOTHING,
    accelerations_jump,
    guesses_from,
    initial_guesses,
    least_violation,
    limited_rates,
    transcription,
    with_motion,
)
from microbot_ocp.planning.search._branches import Way
from microbot_ocp.planning.search._problem import MotionProblem, TrialStart
from microbot_ocp.planning.search._search import (
    MotionAnswer,
    MotionSearch,
    MotionStrategy,
    NextStep,
    SearchState,
    by_promise,
    is_enough,
    rank,
    settled,
)
from microbot_ocp.planning.search._settings import SEARCH
from microbot_ocp.planning.search._split_marks import friction_marks, graded, switch_marks
from microbot_ocp.planning.search._starts import next_trial
from microbot_ocp.planning.task import (
    GAP,
    LDL,
    ROUGH_TOLERANCE,
    dry_friction,
    has_windows,
    rounded,
    with_windows,
)


def search_of(problem: MotionProblem, progress: StepProgress) -> MotionSearch:
    """Return the search of a problem: with its program, and how every solve of it is done."""
    begin, settings = time.perf_counter(), problem.settings
    kernels = problem.kernels()
    if deadline.over():  # they may not be compiled: made again the next time
        transcription.cache_clear()
    kernel_time = time.perf_counter() - begin
    windows = has_windows(problem.family)
    polishing = 0 if windows or len(problem.names) > SEARCH.most_polished else SEARCH.polishing
    refiner = Refiner(
        kernels,
        problem.guesses,
        problem.excess,
        settings.limit_tolerance,
        solver="ipopt" if settings.solver == "auto" else settings.solver,
        progress=with_motion(progress, problem.family.robot, problem.via),
        settings=SolverSettings(gap=GAP, options=LDL),
        rough=ROUGH_TOLERANCE,
        polishing=polishing,
        fitted=partial(with_windows, dry_friction(problem.family.robot) > 0.0) if windows else None,
        enough=partial(is_enough, problem) if problem.is_free else None,
    )
    if problem.timed_path is not None:  # a motion within limits is known
        tolerance = SEARCH.timed_path_tolerance
        # where a link is as near to two faces of a thing steps go to and fro between them
        options = {"acceptable_iter": SEARCH.guided_still, "acceptable_tol": 10.0 * tolerance}
        rough = SolverSettings(
            gap=np.inf,
            options={"ipopt": {**LDL["ipopt"], **options}},
            max_iterations=SEARCH.guided_iterations,
        )
        refiner = replace(
            refiner,
            tolerance=tolerance,
            rough=None,
            settings=rough,
            once=True,
            polishing=SEARCH.first_iterations,
        )
    return MotionSearch(problem, refiner, progress, kernel_time)


# coarse answers -------------------------------------------------------------------------------


def explore_mesh(search: MotionSearch) -> int:
    """Return intervals a phase of the first look."""
    fewest = max(SEARCH.explore_sum // len(search.problem.names), SEARCH.least_explore_mesh)
    return min(full_mesh(search), search.problem.finer * min(fewest, SEARCH.explore_mesh))


def full_mesh(search: MotionSearch) -> int:
    """Return intervals a phase of the first full mesh."""
    if search.settings.mesh is not None:
        return search.settings.mesh
    family = search.problem.family
    switching = accelerations_jump(family) or limited_rates(family)
    most = SEARCH.full_mesh if switching else SEARCH.full_mesh_even
    return max(min(most, SEARCH.full_mesh_sum // len(search.problem.names)), SEARCH.least_mesh)


def coarse(search: MotionSearch) -> Refiner:
    """Return how coarse answers are solved for: with dry friction rounded off."""
    refiner = replace(search.refiner, history=[])
    if refiner.fitted is None:
        return refiner
    kernels = rounded(refiner.transcription, search.problem.scale.velocity)
    return replace(refiner, transcription=kernels)


def sample(state: SearchState) -> list[MotionAnswer]:
    """Return the starts that are compared: those on the finest mesh that any of them was solved
    on.
    """
    tried = state.of("start")
    finest = max((answer.intervals for answer in tried if answer.solved), default=0)
    return [answer for answer in tried if answer.intervals == finest or not finest]


def next_start(search: MotionSearch, state: SearchState) -> NextStep | None:
    """Return a fresh start while another is likely to lead elsewhere.

    Where the first starts do not agree they are compared on a mesh twice as fine, as are all that
    follow: optima of a coarse mesh are not those of a fine one. Among obstacles there are none.
    """
    tried, settings = state.of("start"), search.settings
    if search.problem.timed_path or (tried and search.over):
        return None
    if not search.problem.is_free or len(tried) < settings.starts:
        return _fresh(search, state)
    compared = sample(state)
    if settled(compared, settings):
        return None
    first, second = _start_meshes(search)
    if any(answer.solved for answer in tried):
        carried = by_promise([answer for answer in tried if answer.intervals == first])
        for answer in carried if second > first else ():
            if state.made_of(answer, "start") is None:
                return NextStep(answer, intervals=second)
    return _fresh(search, state)


def _fresh(search: MotionSearch, state: SearchState) -> NextStep | None:
    """Return the next initial guess, on the mesh that answers are compared on."""
    start = next_trial(search.problem, state)
    carried = any(answer.before is not None for answer in state.of("start"))
    if start is None:
        return None
    return NextStep(start=start, intervals=_start_meshes(search)[carried])


def _start_meshes(search: MotionSearch) -> tuple[int, int]:
    first = explore_mesh(search)
    return first, min(2 * first, full_mesh(search))


def try_start(search: MotionSearch, step: NextStep) -> MotionAnswer:
    """Solve from an initial guess, or what it led to on a finer mesh."""
    refiner, start = coarse(search), step.start
    if start is None:
        name, way = step.answer.start, step.answer.way
        refiner = replace(refiner, rough=SEARCH.explore_tolerance, once=True)
        meshes = [step.intervals] * len(search.problem.names)
        solution = refiner.finer(step.answer.solution, meshes)
    else:
        name, way = start.guess.name, start.way
        if start.most_iterations is not None:
            limited = replace(refiner.settings, max_iterations=start.most_iterations)
            refiner = replace(refiner, settings=limited)
        if start.options is not None:
            settings = replace(refiner.settings, options=start.options)
            refiner = replace(refiner, settings=settings)
        solution = refiner.solve(
            step.intervals,
            start.guess.guesses,
            tolerance=SEARCH.explore_tolerance,
            solver=start.solver,
        )
    search.progress(
        f"start {name}: {solution.duration:.4f} s on {step.intervals} intervals a phase, "
        f"{solution.status}"
    )
    return _answer(search, "start", name, solution, refiner, way)


def _answer(
    search: MotionSearch,
    strategy: str,
    start: str,
    solution: Solution,
    by: Refiner,
    way: Way | None = None,
) -> MotionAnswer:
    """Return a coarse answer, which the usual kernels refine."""
    solves = tuple(by.history)
    return MotionAnswer(
        strategy,
        start,
        solution,
        search.refiner,
        SMOOTHING,
        solves=solves,
        way=way,
    )


def _nothing_solved(search: MotionSearch, state: SearchState, strategy: str) -> NextStep | None:
    if search.over or any(answer.solved for answer in state.answers) or state.of(strategy):
        return None
    if search.problem.timed_path:  # a motion within limits is known
        return None
    return NextStep(_nearest(state))


def _nearest(state: SearchState) -> MotionAnswer:
    """Return the start whose answer breaks constraints least."""
    return min(
        state.of("start", "timed path"),
        key=lambda a: (not a.solution.attempts, a.solution.attempts[-1].infeasibility),
    )


def next_from_known(search: MotionSearch, state: SearchState) -> NextStep | None:
    """Return a known way where no start led anywhere."""
    step = _nothing_solved(search, state, "known way")
    return step if step is not None and search.problem.fallback is not None else None


def from_known(search: MotionSearch, step: NextStep) -> MotionAnswer:
    """Solve from a way with its best timing."""
    way = search.problem.fallback
    subject = step.answer
    assert way is not None
    refiner = coarse(search)
    solution = refiner.solve(
        [phase.mesh for phase in subject.solution.phases],
        search.problem.guesses_along(way.motion),
        tolerance=SEARCH.explore_tolerance,
        barrier=SEARCH.near_way_barrier,
    )
    search.progress(f"start {way.made_from}: {solution.duration:.4f} s, {solution.status}")
    return _answer(search, "known way", way.made_from, solution, refiner)


def next_relaxed(search: MotionSearch, state: SearchState) -> NextStep | None:
    """Return the relaxed problem where nothing is solved."""
    return _nothing_solved(search, state, "relaxed problem")


def from_relaxed(search: MotionSearch, step: NextStep) -> MotionAnswer:
    """Look at what limits have to give; solve from there where they have to give nothing."""
    subject = step.answer
    refiner, problem = coarse(search), search.problem
    meshes = [phase.mesh for phase in subject.solution.phases]
    initial = initial_guesses(problem.family, problem.via, problem.names, 1, search.settings.seed)
    starts = [next(initial).guesses, subject.solution]
    relaxed = least_violation(refiner.transcription, starts, meshes)
    search.progress(f"relaxed problem: {relaxed}")
    solution = subject.solution
    if relaxed.conclusive and relaxed.feasible:
        guesses = guesses_from(relaxed)
        solution = refiner.solve(meshes, guesses, tolerance=SEARCH.explore_tolerance)
    answer = _answer(search, "relaxed problem", subject.start, solution, refiner, subject.way)
    return replace(answer, relaxed=relaxed)


# finer meshes ---------------------------------------------------------------------------------

COARSE = ("start", "known way", "relaxed problem", "timed path")
ON_FULL_MESH = ("full mesh", "less and less smoothing")


def refined(state: SearchState) -> list[MotionAnswer]:
    """Return the answers that were refined."""
    return state.of("splitting")


def best_of(search: MotionSearch, state: SearchState) -> MotionAnswer:
    """Return the best answer: of those that were refined, else the nearest that there is."""
    answers = state.of("last digits") or refined(state)
    if answers:
        return min(answers, key=lambda answer: rank(search, answer.solution))
    solved = by_promise(state.answers)
    return solved[0] if solved else _nearest(state)


def promising(state: SearchState) -> list[MotionAnswer]:
    """Return the coarse answers that the best motion may come from, the fastest first.

    One that was solved on a finer mesh, too, is among them where that led to a slower optimum.
    """
    compared = [a for a in state.of("start") if not _superseded(state, a)]
    others = [a for a in state.of("known way", "relaxed problem", "timed path") if a.solved]
    return by_promise([*compared, *others])


def _superseded(state: SearchState, answer: MotionAnswer) -> bool:
    finer = state.made_of(answer, "start")
    if finer is None or not finer.solved:
        return False
    return finer.solution.duration <= (1.0 + SEARCH.same) * answer.solution.duration


def next_timed_path(search: MotionSearch, state: SearchState) -> NextStep | None:
    """Return the timed path among obstacles, once."""
    problem, path = search.problem, search.problem.timed_path
    if path is None or state.answers:
        return None
    closed = replace(path, guesses=problem.with_closed(path.guesses))
    return NextStep(start=TrialStart(closed, search.refiner.solver, way=problem.ways[0]))


def from_timed_path(search: MotionSearch, step: NextStep) -> MotionAnswer:
    """Solve on a coarse mesh, near a timed path: farther off lies another way, or none."""
    assert step.start is not None
    way, refiner = step.start.guess, replace(coarse(search), once=False)
    mesh = explore_mesh(search)
    solution = refiner.solve(mesh, way.guesses, barrier=SEARCH.timed_path_barrier)
    search.progress(f"start {way.name}: {solution.duration:.4f} s, {solution.status}")
    return _answer(search, "timed path", way.name, solution, refiner, step.start.way)


def resumed(search: MotionSearch, answer: MotionAnswer) -> SearchState:
    """Return a state in which an answer that was refined under fewer limits is solved again."""
    begin = time.perf_counter()
    weights = {name: {JERK_WEIGHT: answer.smoothing} for name in search.problem.names}
    kernels = search.refiner.transcription.with_parameters(weights)
    refiner = replace(search.refiner, transcription=kernels, history=[])
    meshes = [phase.mesh for phase in answer.solution.phases]
    first = replace(refiner, once=False)
    solution = first.solve(meshes, answer.solution, barrier=SEARCH.timed_path_barrier)
    search.progress(f"start {answer.start}: {solution.duration:.6f} s, {solution.status}")
    again = MotionAnswer(
        "full mesh", answer.start, solution, refiner, answer.smoothing, answer, tuple(first.history)
    )
    return SearchState((replace(again, seconds=time.perf_counter() - begin),))


def next_full_mesh(search: MotionSearch, state: SearchState) -> NextStep | None:
    """Return the most promising coarse answer that may be better than all that were refined.

    A refined answer is faster than its coarse one by what the coarse mesh costs; the others may
    gain as much.
    """
    answers = promising(state)
    done = refined(state)
    if not answers or len(done) >= SEARCH.most_refined or (done and search.over):
        return None
    best = min((rank(search, answer.solution) for answer in done), default=(True, np.inf))
    gains = [_coarse_of(a).solution.duration / a.solution.duration for a in done if a.solved]
    for answer in answers:
        if state.made_of(answer, "full mesh") is None:
            hoped = answer.solution.duration / max([1.0, *gains])
            return None if best <= (False, hoped) else NextStep(answer)
    return None


def _coarse_of(answer: MotionAnswer) -> MotionAnswer:
    return next(a for a in answer.lineage if a.before is None or a.strategy in COARSE)


def to_full_mesh(search: MotionSearch, step: NextStep) -> MotionAnswer:
    """Solve on a finer mesh, finer still where the coarse accelerations change."""
    subject = step.answer
    refiner, before = _going_on(subject), subject.solution
    jumps, mesh = accelerations_jump(search.problem.family), full_mesh(search)
    meshes = [graded(phase, mesh) if jumps else mesh for phase in before.phases]
    is_guided = search.problem.timed_path is not None
    if is_guided:  # near many distances the steps of a small barrier are short
        refiner = replace(refiner, settings=_from_barrier(refiner, SEARCH.timed_path_barrier))
    if is_guided or not jumps:
        solution = refiner.finer(before, meshes)
        if refiner.fitted is not None and solution is not before:
            marks = partial(friction_marks, search)
            solution = refiner.sharpen(solution, marks, worth=SEARCH.worth)
        return _finer(subject, "full mesh", solution, refiner)
    if len(before.phases) > SEARCH.many_phases:
        # multipliers of so coarse a mesh mislead: 87 iterations, 65 without
        guesses, barrier = search.problem.guesses(before), RefinerSettings.warm_barrier
        solution = refiner.solve(meshes, guesses, barrier=barrier)
        if solution.status.solved and solution.cost <= (1 + WORSE) * before.cost:
            return _finer(subject, "full mesh", solution, refiner)
    settings, once = _from_barrier(refiner, SEARCH.far_barrier), False
    if len(before.phases) <= SEARCH.many_phases and _within_limits(search, subject) is not None:
        limited = min(settings.max_iterations, SEARCH.first_iterations)
        settings, once = replace(settings, max_iterations=limited), True
    farther = replace(refiner, settings=settings, once=once)
    return _finer(subject, "full mesh", farther.finer(before, meshes), refiner)


def _from_barrier(refiner: Refiner, barrier: float) -> SolverSettings:
    """Return settings of a solve with multipliers that begins at a barrier parameter."""
    options = {**refiner.settings.options.get("ipopt", {}), "mu_init": barrier}
    return replace(refiner.settings, options={"ipopt": options})


def _going_on(subject: MotionAnswer) -> Refiner:
    """Return what refines an answer, with the record of the solve that it comes from."""
    last = next((answer.solves[-1:] for answer in subject.lineage if answer.solves), ())
    return replace(subject.refiner, history=[*last])


def _finer(
    subject: MotionAnswer,
    strategy: str,
    solution: Solution,
    by: Refiner,
    kernels: Refiner | None = None,
    smoothing: float | None = None,
) -> MotionAnswer:
    weight = subject.smoothing if smoothing is None else smoothing
    refiner, solves = replace(kernels or subject.refiner, history=[]), tuple(by.history[1:])
    return MotionAnswer(
        strategy, subject.start, solution, refiner, weight, solves=solves, way=subject.way
    )


def next_smoother(search: MotionSearch, state: SearchState) -> NextStep | None:
    """Return a coarse answer that no full mesh was solved from, where a motion within limits is
    known.
    """
    for answer in state.of("full mesh"):
        coarser = answer.before
        assert coarser is not None
        refused = answer.solution is coarser.solution or not answer.solved
        if (
            refused
            and accelerations_jump(search.problem.family)
            and not search.over
            and coarser.solved
        ):
            if state.made_of(coarser, "less and less smoothing") is not None:
                continue
            if _within_limits(search, coarser) is not None:
                return NextStep(coarser)
    return None


def _within_limits(search: MotionSearch, answer: MotionAnswer) -> Any:
    """Return a motion within the limits from a coarse answer, or any."""
    slowed = search.problem.slowed(answer.solution)
    return slowed or getattr(search.problem.fallback, "motion", None)


def less_and_less_smoothing(search: MotionSearch, step: NextStep) -> MotionAnswer:
    """Solve on the full mesh from a motion within the limits, smoothed ever less.

    For arms so light or fast that torques change more between the points of a coarse mesh than it
    can tell: what it calls an optimum is none, and finer meshes do not find one from there.
    """
    subject = step.answer
    refiner = _going_on(subject)
    limited = replace(refiner.settings, max_iterations=SEARCH.smoother_iterations)
    meshes = [full_mesh(search)] * len(search.problem.names)
    start: Any = search.problem.guesses_along(_within_limits(search, subject))
    usual = weight = subject.smoothing
    last, kernels = None, refiner.transcription
    barrier: float | None = SEARCH.smoother_barrier
    for steps in (SEARCH.smoother, (*SEARCH.smoothest, *SEARCH.smoother)):
        for times in steps:
            weights = {name: {JERK_WEIGHT: times * usual} for name in search.problem.names}
            kernels = search.refiner.transcription.with_parameters(weights)
            smoothed = replace(refiner, transcription=kernels, settings=limited)
            solution = smoothed.solve(meshes, start, barrier=barrier)
            search.progress(
                f"smoothed {times:g} times: {solution.duration:.6f} s, {solution.status}"
            )
            if not solution.status.solved:
                break
            worth = np.inf if last is None else last.duration / solution.duration - 1.0
            start, last, barrier, weight = solution, solution, None, times * usual
            if times == SEARCH.smoother[-1] or worth < SEARCH.worth_less:
                finer = replace(refiner, transcription=kernels)
                name = "less and less smoothing"
                return _finer(subject, name, solution, refiner, finer, weight)
            if search.over:
                break
        if last is not None or search.over:
            break
    failed = solution if last is None else replace(last, status=Status.FAILED)
    if last is not None:
        search.problem.slowed(failed)  # the motion of this answer that is returned at least
    return _finer(subject, "less and less smoothing", failed, refiner)


def next_less_smoothing(search: MotionSearch, state: SearchState) -> NextStep | None:
    """Return what was solved on a full mesh, where its smoothing costs much."""
    for answer in state.of("full mesh"):
        assert answer.before is not None
        is_usual = answer.smoothing > SEARCH.less_smoothing * SMOOTHING
        costly = answer.solution.cost - answer.solution.duration > (
            SEARCH.smoothing_told * answer.solution.duration
        )
        is_full = answer.solved and answer.solution is not answer.before.solution
        jumps = accelerations_jump(search.problem.family)
        untried = state.made_of(answer, "less smoothing") is None
        if is_full and is_usual and costly and jumps and untried and not search.over:
            return NextStep(answer)
    return None


def less_smoothing(search: MotionSearch, step: NextStep) -> MotionAnswer:
    """Solve on the same mesh with less smoothing, as on all that follow."""
    subject = step.answer
    refiner, weight = _going_on(subject), SEARCH.less_smoothing * SMOOTHING
    lower = {name: {JERK_WEIGHT: weight} for name in search.problem.names}
    # without pivots so little curvature is lost in rounding: 40 iterations in place of 21
    usual = replace(refiner.settings, options={})
    kernels = refiner.transcription.with_parameters(lower)
    finer = replace(refiner, transcription=kernels, settings=usual)
    options = {"ipopt": {"mu_init": SEARCH.less_smoothing_barrier}}
    settings = replace(usual, options=options, max_iterations=SEARCH.most_exact)
    meshes = [phase.mesh for phase in subject.solution.phases]
    solution = replace(finer, settings=settings).solve(meshes, subject.solution)
    search.progress(f"smoothed less: {solution.duration:.6f} s, {solution.status}")
    if solution.status.solved and solution.duration >= subject.solution.duration:
        solution = replace(solution, status=Status.NOT_ACCEPTED)
    return _finer(subject, "less smoothing", solution, refiner, finer, weight)


def next_splitting(search: MotionSearch, state: SearchState) -> NextStep | None:
    """Return what was solved on a full mesh, or where none was the coarse answer itself."""
    for coarser in (*state.of("full mesh"), *state.of("less and less smoothing")):
        before = coarser.before
        assert before is not None
        refined = [m for s in ON_FULL_MESH if (m := state.made_of(before, s)) and m.solved]
        chosen = next((m for m in reversed(refined) if m.solution is not before.solution), before)
        smoothed_less = state.made_of(chosen, "less smoothing")
        if smoothed_less is not None and smoothed_less.solved:
            chosen = smoothed_less
        if chosen is before and search.problem.timed_path is not None:
            continue  # it passes through something between the points of its coarse mesh
        if state.made_of(chosen, "splitting") is None:
            return NextStep(chosen)
    return None


def split_where_exceeded(search: MotionSearch, step: NextStep) -> MotionAnswer:
    """Split intervals until limits hold between mesh points, and where something switches."""
    subject = step.answer
    refiner, best = _going_on(subject), subject.solution
    marks: Any = {"switching": partial(switch_marks, search), "worth": SEARCH.worth}
    usual = refiner.settings
    if accelerations_jump(search.problem.family):
        refiner = replace(refiner, foresight=SEARCH.foresight)
        if subject.strategy in COARSE:  # nothing leads on: what is tried yet is not tried for long
            limited = min(usual.max_iterations, SEARCH.smoother_iterations)
            refiner = replace(refiner, settings=replace(usual, max_iterations=limited))
        if len(search.problem.names) <= SEARCH.many_phases:
            # a refined mesh is seldom refined again: to the last digits at once
            least = replace(usual, max_iterations=min(usual.max_iterations, SEARCH.most_exact))
            best = replace(refiner, settings=least, rough=None, once=True).refine(best, **marks)
    if search.problem.timed_path is not None:  # what did not converge is tried from farther inside
        farther = _from_barrier(refiner, SEARCH.timed_path_barrier)
        refiner = replace(refiner, settings=farther)
    return _finer(subject, "splitting", refiner.refine(best, **marks), refiner)


def next_last_digits(search: MotionSearch, state: SearchState) -> NextStep | None:
    """Return the best of the refined answers."""
    if state.of("last digits") or not refined(state):
        return None
    best = best_of(search, state)
    return NextStep(best) if best.solved and not search.over else None


def last_digits(search: MotionSearch, step: NextStep) -> MotionAnswer:
    """Solve to the full tolerance.

    A rough solve from a timed path ends while limits keep their distances still: from its own
    multipliers it takes some iterations more until these cost next to nothing.
    """
    subject, solution = step.answer, step.answer.solution
    refiner = _going_on(subject)
    loose = not solution.gap.total <= SEARCH.enough * abs(solution.cost)
    if search.problem.timed_path is None:
        solution = refiner.finished(solution)
    elif loose and search.worst(solution) <= search.settings.limit_tolerance:
        solution = refiner.polished(solution, refiner.rounds)
    return _finer(subject, "last digits", solution, refiner)


FROM_PATHS = (
    MotionStrategy(
        "timed path", next_timed_path, from_timed_path, "obstacles, which other starts run into"
    ),
)
STRATEGIES = (
    MotionStrategy(
        "start", next_start, try_start, "local optima are several per cent apart", share=0.5
    ),
    MotionStrategy(
        "known way", next_from_known, from_known, "limits so tight that no guess converges"
    ),
    MotionStrategy(
        "relaxed problem", next_relaxed, from_relaxed, "tasks that ask too much: which limit gives"
    ),
    MotionStrategy(
        "less and less smoothing",
        next_smoother,
        less_and_less_smoothing,
        "arms so light that torques change more between coarse mesh points than they tell",
    ),
    MotionStrategy(
        "less smoothing",
        next_less_smoothing,
        less_smoothing,
        "light arms, whose jerk is large where nothing is smoothed",
    ),
    MotionStrategy(
        "splitting", next_splitting, split_where_exceeded, "limits hold at mesh points only"
    ),
    *FROM_PATHS,
    MotionStrategy("full mesh", next_full_mesh, to_full_mesh, "a coarse mesh costs some per cent"),
    MotionStrategy(
        "last digits", next_last_digits, last_digits, "a gap to the optimum that is known"
    ),
)
