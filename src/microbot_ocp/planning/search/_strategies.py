"""The table of strategies that find free motions and motions through stops.

The fastest of several local optima on a coarse mesh is solved on a finer mesh, whose intervals are
split until limits hold between mesh points. In each step the first row that has an answer to work
on is run.
"""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.status import Status
from microbot_ocp.limits import LimitFamily
from microbot_ocp.ocp import PhaseSolution, Solution, SolverSettings
from microbot_ocp.ocp.refinement import WORSE, Refiner, RefinerSettings
from microbot_ocp.ocp.solution import StepProgress
from microbot_ocp.ocp.transcription import Transcription
from microbot_ocp.planning.free import (
    JERK_WEIGHT,
    SMOOTHING,
    accelerations_jump,
    limited_rates,
    transcription,
    with_motion,
)
from microbot_ocp.planning.search._problem import MotionProblem
from microbot_ocp.planning.search._search import (
    MotionAnswer,
    MotionSearch,
    MotionStrategy,
    NextStep,
    SearchState,
    by_promise,
    is_enough,
    rank,
)
from microbot_ocp.planning.search._settings import SEARCH
from microbot_ocp.planning.search._starts import FROM_GUESSES, FROM_PATHS, full_mesh, nearest
from microbot_ocp.planning.task import (
    GAP,
    LDL,
    ROUGH_TOLERANCE,
    dry_friction,
    has_windows,
    rate_switches,
    reversals,
    with_windows,
)


def search_of(problem: MotionProblem, progress: StepProgress) -> MotionSearch:
    """Return the search of a problem, with its compiled program and the settings of its solves."""
    begin, settings = time.perf_counter(), problem.settings
    kernels = problem.kernels()
    if deadline.over():  # the deadline may have prevented compilation: do not keep these kernels
        transcription.cache_clear()
    kernel_time = time.perf_counter() - begin
    windows, rated = has_windows(problem.family), problem.is_rated
    is_guided = problem.timed_path is not None  # a motion within limits is known
    is_rough = not is_guided and (windows or len(problem.names) > SEARCH.most_polished)
    refiner = Refiner(
        kernels,
        problem.guesses,
        problem.excess,
        settings.limit_tolerance,
        solver="ipopt" if settings.solver == "auto" else settings.solver,
        progress=with_motion(progress, problem.family.robot, problem.via),
        settings=SolverSettings(gap=wanted_gap(problem), options=LDL),
        rough=ROUGH_TOLERANCE,
        foresight=SEARCH.foresight if rated else 1.0,
        polishing=0 if is_rough else SEARCH.usual_iterations,
        fitted=partial(with_windows, dry_friction(problem.family.robot) > 0.0) if windows else None,
        enough=partial(is_enough, problem) if problem.is_free else None,
    )
    if is_guided:
        tolerance, most = SEARCH.timed_path_tolerance, SEARCH.most_iterations
        # A link equally near to two faces of a body makes iterates alternate between the two
        # constraints: accept the point after a few acceptable iterations.
        still = {
            "acceptable_iter": SEARCH.acceptable_iterations,
            "acceptable_tol": 10.0 * tolerance,
        }
        options = {"ipopt": {**LDL["ipopt"], **still}}
        rough = SolverSettings(gap=np.inf, options=options, max_iterations=most)
        refiner = replace(refiner, tolerance=tolerance, rough=None, settings=rough, once=True)
    return MotionSearch(problem, refiner, progress, kernel_time)


def wanted_gap(problem: MotionProblem) -> float:
    """Return the relative gap to the optimum on a mesh that a solve may leave."""
    # Jerks and torque rates are third derivatives of the spline: rounding hides their last digits.
    return RATED_GAP if problem.is_rated else GAP


# finer meshes ---------------------------------------------------------------------------------

TINY = 1e-12
RATED_GAP = 1e-4  # relative gap wanted under limits of jerks and torque rates
SHORTEST = 0.05  # share of a phase's longest interval: shorter ones are not split at switches
COARSE = ("start", "known way", "relaxed problem", "timed path")
ON_FULL_MESH = ("full mesh", "less and less smoothing")


def best_of(search: MotionSearch, state: SearchState) -> MotionAnswer:
    """Return the best refined answer; the nearest coarse one if there is none."""
    answers = state.of("last digits") or state.of("splitting")
    if answers:
        return min(answers, key=lambda answer: rank(search, answer.solution))
    solved = by_promise(state.answers)
    return solved[0] if solved else nearest(state)


def promising(state: SearchState) -> list[MotionAnswer]:
    """Return the coarse answers that the best motion may come from, the fastest first.

    An answer that was continued on a finer mesh stays in the list if it led to a slower optimum.
    """
    compared = [a for a in state.of("start") if not _superseded(state, a)]
    others = [a for a in state.of("known way", "relaxed problem", "timed path") if a.solved]
    return by_promise([*compared, *others])


def _superseded(state: SearchState, answer: MotionAnswer) -> bool:
    finer = state.made_of(answer, "start")
    if finer is None or not finer.solved:
        return False
    return finer.solution.duration <= (1.0 + SEARCH.same_optimum) * answer.solution.duration


def resumed(search: MotionSearch, answer: MotionAnswer) -> SearchState:
    """Return a state in which a refined answer is solved again under more limits."""
    begin, weight = time.perf_counter(), answer.smoothing
    kernels = _smoothed(search, search.refiner.transcription, weight)
    refiner = replace(search.refiner, transcription=kernels, history=[])
    meshes = [phase.mesh for phase in answer.solution.phases]
    first = replace(refiner, once=False)
    solution = first.solve(meshes, answer.solution, barrier=SEARCH.timed_path_barrier)
    search.progress(f"start {answer.start}: {solution.duration:.6f} s, {solution.status}")
    again = MotionAnswer(
        start=answer.start,
        solution=solution,
        refiner=refiner,
        smoothing=weight,
        before=answer,
        solves=tuple(first.history),
        seconds=time.perf_counter() - begin,
        strategy="full mesh",
    )
    return SearchState((again,))


def _smoothed(search: MotionSearch, kernels: Transcription, weight: float) -> Transcription:
    """Return the program with another weight of the squared jerk."""
    return kernels.with_parameters({name: {JERK_WEIGHT: weight} for name in search.problem.names})


def next_full_mesh(search: MotionSearch, state: SearchState) -> NextStep | None:
    """Return the most promising coarse answer that may beat all refined ones.

    Refinement gains the discretisation error of the coarse mesh. Other answers are assumed to gain
    at most as much.
    """
    answers = promising(state)
    done = state.of("splitting")
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
    """Solve on a full mesh, denser where the coarse accelerations change."""
    subject = step.answer
    refiner, before = _going_on(subject), subject.solution
    jumps, mesh = accelerations_jump(search.problem.family), full_mesh(search)
    meshes = [graded(phase, mesh) if jumps else mesh for phase in before.phases]
    if jumps and is_costly(before, mesh):
        refiner, weight = _less_smoothed(search, refiner)
        subject = replace(subject, refiner=replace(refiner, history=[]), smoothing=weight)
    is_guided = search.problem.timed_path is not None
    if is_guided:  # a small barrier parameter shortens steps near many distance constraints
        refiner = replace(refiner, settings=_from_barrier(refiner, SEARCH.timed_path_barrier))
    if is_guided or not jumps:
        solution = refiner.finer(before, meshes)
        if refiner.fitted is not None and solution is not before:
            marks = partial(friction_marks, search)
            solution = refiner.sharpen(solution, marks, worth=SEARCH.least_gain)
        return _finer(subject, solution, refiner)
    if len(before.phases) > SEARCH.many_phases:
        # Multipliers of a coarse mesh of many phases mislead the solver: start without them.
        guesses, barrier = search.problem.guesses(before), RefinerSettings.warm_barrier
        solution = refiner.solve(meshes, guesses, barrier=barrier)
        if solution.status.solved and solution.cost <= (1 + WORSE) * before.cost:
            return _finer(subject, solution, refiner)
    # A warm start with multipliers needs a barrier parameter that matches the mesh error: from a
    # smaller one the iterates are too near to bounds that are active on the coarse mesh only.
    settings, once = _from_barrier(refiner, SEARCH.far_barrier), False
    if len(before.phases) <= SEARCH.many_phases and _within_limits(search, subject) is not None:
        settings, once = _at_most(settings, SEARCH.usual_iterations), True
    farther = replace(refiner, settings=settings, once=once)
    return _finer(subject, farther.finer(before, meshes), refiner)


def _from_barrier(refiner: Refiner, barrier: float) -> SolverSettings:
    """Return settings of a warm start that begins at a barrier parameter."""
    options = {**refiner.settings.options.get("ipopt", {}), "mu_init": barrier}
    return replace(refiner.settings, options={"ipopt": options})


def _at_most(settings: SolverSettings, iterations: int) -> SolverSettings:
    return replace(settings, max_iterations=min(settings.max_iterations, iterations))


def _going_on(subject: MotionAnswer) -> Refiner:
    """Return the refiner that continues an answer, with the record of its last solve."""
    last = next((answer.solves[-1:] for answer in subject.lineage if answer.solves), ())
    return replace(subject.refiner, history=[*last])


def _finer(subject: MotionAnswer, solution: Solution, by: Refiner, **other: Any) -> MotionAnswer:
    """Return the continued answer; ``other`` fields replace those of the subject."""
    fields = {"refiner": replace(subject.refiner, history=[]), "solves": tuple(by.history[1:])}
    return replace(subject, solution=solution, relaxed=None, **(fields | other))


def next_smoother(search: MotionSearch, state: SearchState) -> NextStep | None:
    """Return a coarse answer whose full mesh failed, if a motion within limits is known."""
    if search.over or not accelerations_jump(search.problem.family):
        return None
    for answer in state.of("full mesh"):
        coarser = answer.before
        assert coarser is not None
        refused = answer.solution is coarser.solution or not answer.solved
        tried = state.made_of(coarser, "less and less smoothing") is not None
        worth = refused and coarser.solved and not tried
        if worth and _within_limits(search, coarser) is not None:
            return NextStep(coarser)
    return None


def _within_limits(search: MotionSearch, answer: MotionAnswer) -> Any:
    """Return a motion within the limits from a coarse answer, or the known one, or None."""
    slowed = search.problem.slowed(answer.solution) if search.problem.is_free else None
    return slowed or getattr(search.problem.fallback, "motion", None)


def less_and_less_smoothing(search: MotionSearch, step: NextStep) -> MotionAnswer:
    """Solve on the full mesh from a motion within the limits, with decreasing smoothing.

    Homotopy in the weight of the squared jerk. For light or fast arms torques change between coarse
    mesh points by more than the mesh resolves: a coarse optimum is spurious, and a fine mesh does
    not converge from it.
    """
    subject = step.answer
    refiner = _going_on(subject)
    limited = _at_most(refiner.settings, SEARCH.smoothing_iterations)
    meshes = [full_mesh(search)] * len(search.problem.names)
    start: Any = search.problem.guesses_along(_within_limits(search, subject))
    last: Solution | None = None
    barrier: float | None = SEARCH.smoothing_barrier
    for times in SEARCH.smoothing_factors:
        weight = times * subject.smoothing
        kernels = _smoothed(search, search.refiner.transcription, weight)
        finer = replace(refiner, transcription=kernels)
        solution = replace(finer, settings=limited).solve(meshes, start, barrier=barrier)
        search.progress(f"smoothed {times:g} times: {solution.duration:.6f} s, {solution.status}")
        if not solution.status.solved:
            break
        worth = np.inf if last is None else last.duration / solution.duration - 1.0
        start, last, barrier = solution, solution, None
        if times == SEARCH.smoothing_factors[-1] or worth < SEARCH.same_optimum:
            finer = replace(finer, history=[])
            return _finer(subject, solution, refiner, refiner=finer, smoothing=weight)
        if search.over:
            break
    failed = solution if last is None else replace(last, status=Status.FAILED)
    if last is not None:
        search.problem.slowed(failed)  # stored: the result falls back to this motion
    return _finer(subject, failed, refiner)


def next_less_smoothing(search: MotionSearch, state: SearchState) -> NextStep | None:
    """Return an answer on a full mesh whose smoothing costs too much."""
    if search.over or not accelerations_jump(search.problem.family):
        return None
    for answer in state.of("full mesh"):
        assert answer.before is not None
        is_usual = answer.smoothing > SEARCH.reduced_smoothing * SMOOTHING
        costly = is_costly(answer.solution)
        is_full = answer.solved and answer.solution is not answer.before.solution
        untried = state.made_of(answer, "less smoothing") is None
        if is_full and is_usual and costly and untried:
            return NextStep(answer)
    return None


def is_costly(solution: Solution, intervals: int = 0) -> bool:
    """Return True if smoothing costs too much of the duration on a mesh of so many intervals.

    A jump of the acceleration takes one interval: its squared jerk, integrated, is inversely
    proportional to the length. Zero means the solution's own mesh.
    """
    growth = max(1.0, *(intervals / (phase.mesh.size - 1) for phase in solution.phases))
    share = SEARCH.smoothing_cost_limit * solution.duration
    return growth * (solution.cost - solution.duration) > share


def _less_smoothed(search: MotionSearch, refiner: Refiner) -> tuple[Refiner, float]:
    """Return a refiner with less smoothing, and the weight of the squared jerk."""
    weight = SEARCH.reduced_smoothing * SMOOTHING
    # The LDL factorisation without pivots loses the small curvature of a weak jerk term in
    # rounding: 40 iterations instead of 21.
    usual = replace(refiner.settings, options={})
    kernels = _smoothed(search, refiner.transcription, weight)
    return replace(refiner, transcription=kernels, settings=usual), weight


def less_smoothing(search: MotionSearch, step: NextStep) -> MotionAnswer:
    """Solve with less smoothing on the same mesh; later solves keep the weight."""
    subject = step.answer
    refiner = _going_on(subject)
    finer, weight = _less_smoothed(search, refiner)
    usual = finer.settings
    options = {"ipopt": {"mu_init": SEARCH.reduced_smoothing_barrier}}
    settings = replace(usual, options=options, max_iterations=SEARCH.usual_iterations)
    meshes = [phase.mesh for phase in subject.solution.phases]
    solution = replace(finer, settings=settings).solve(meshes, subject.solution)
    search.progress(f"smoothed less: {solution.duration:.6f} s, {solution.status}")
    if solution.status.solved and solution.duration >= subject.solution.duration:
        solution = replace(solution, status=Status.NOT_ACCEPTED)
    finer = replace(finer, history=[])
    return _finer(subject, solution, refiner, refiner=finer, smoothing=weight)


def next_splitting(search: MotionSearch, state: SearchState) -> NextStep | None:
    """Return an answer on a full mesh that was not split, or its coarse one if no full one is."""
    for coarser in (*state.of("full mesh"), *state.of("less and less smoothing")):
        before = coarser.before
        assert before is not None
        refined = [m for s in ON_FULL_MESH if (m := state.made_of(before, s)) and m.solved]
        chosen = next((m for m in reversed(refined) if m.solution is not before.solution), before)
        smoothed_less = state.made_of(chosen, "less smoothing")
        if smoothed_less is not None and smoothed_less.solved:
            chosen = smoothed_less
        if chosen is before and search.problem.timed_path is not None:
            continue  # between coarse mesh points it passes through bodies
        if state.made_of(chosen, "splitting") is None:
            return NextStep(chosen)
    return None


def split_where_exceeded(search: MotionSearch, step: NextStep) -> MotionAnswer:
    """Split intervals at switches, and until limits hold between mesh points."""
    subject = step.answer
    refiner, best = _going_on(subject), subject.solution
    marks: Any = {
        "switching": partial(switch_marks, search.problem.family),
        "worth": SEARCH.least_gain,
    }
    if accelerations_jump(search.problem.family):
        usual = _at_most(refiner.settings, SEARCH.smoothing_iterations)
        foresight = SEARCH.foresight if refiner.rough else RefinerSettings.foresight
        refiner = replace(refiner, foresight=foresight, settings=usual)
    if search.problem.is_rated:
        # The last refinement of a mesh gains almost nothing and may take a thousand iterations.
        refiner = replace(
            refiner, once=True, settings=_at_most(refiner.settings, SEARCH.usual_iterations)
        )
    if search.problem.timed_path is not None:  # a failed solve is repeated from a larger barrier
        farther = _from_barrier(refiner, SEARCH.timed_path_barrier)
        refiner = replace(refiner, settings=farther)
    return _finer(subject, refiner.refine(best, **marks), refiner)


def next_last_digits(search: MotionSearch, state: SearchState) -> NextStep | None:
    """Return the best of the refined answers."""
    if state.of("last digits") or not state.of("splitting"):
        return None
    best = best_of(search, state)
    return NextStep(best) if best.solved and not search.over else None


def last_digits(search: MotionSearch, step: NextStep) -> MotionAnswer:
    """Solve to the full tolerance.

    A rough solve from a timed path ends with a positive barrier parameter, so that limits keep a
    distance. A few iterations from its multipliers reduce the cost of this distance to almost zero.
    """
    subject, solution = step.answer, step.answer.solution
    refiner = _going_on(subject)
    loose = not solution.gap.total <= SEARCH.largest_slowdown * abs(solution.cost)
    if search.problem.timed_path is None:
        solution = refiner.finished(solution)
    elif loose and search.worst(solution) <= search.settings.limit_tolerance:
        solution = refiner.polished(solution, refiner.rounds)
    return _finer(subject, solution, refiner)


# mesh density ------------------------------------------------------------------------------------


def switch_marks(family: LimitFamily, solution: Solution) -> list[np.ndarray]:
    """Return masks of intervals in which a limited quantity switches.

    A velocity that changes by more than half of its limit in one interval could change far sooner
    than the mesh allows. Under limits of jerks or torque rates the same holds for accelerations and
    torques, and a rate that switches loses half an interval: 1 % of the motions of a Panda on 60
    even intervals. Intervals below ``SHORTEST`` are not marked.
    """
    robot, rated = family.robot, limited_rates(family)
    marks = []
    for phase in solution.phases:
        q, qd, qdd = (phase[key] for key in ("q", "qd", "qdd"))
        passed = {"qd": qd}
        rates = {"qddd": np.diff(qdd, axis=0) / np.diff(phase.t)[:, None]}
        if rated:
            passed["qdd"] = qdd
        if rated and robot.has_dynamics:
            passed["tau"] = robot.torques_along(q, qd, qdd)["tau"]
        if "taud" in rated:
            middle = (0.5 * (x[:-1] + x[1:]) for x in (q, qd, qdd))
            rates["taud"] = robot.torques_along(*middle, rates["qddd"])["taud"]
        rows = np.zeros(len(rates["qddd"]), dtype=bool)
        for key, values in passed.items():
            limit = np.maximum(*(np.abs(b) for b in robot.limits.bounds(key)))
            limit = np.where(limit > 0, limit, np.inf)
            rows |= (np.abs(np.diff(values, axis=0)) > 0.5 * limit).any(axis=1)
        for key in rated:
            rows |= rate_switches(rates[key], family[key])
        steps = np.diff(phase.mesh)
        marks.append(rows & (steps > SHORTEST * steps.max()))
    return marks


def friction_marks(search: MotionSearch, solution: Solution) -> list[np.ndarray]:
    """Return masks of intervals in which a joint with dry friction reverses or a limit fails."""
    marked, dry = [], dry_friction(search.problem.family.robot) > 0.0
    for phase, excess in zip(solution.phases, search.problem.excess(solution), strict=True):
        turns = reversals(phase["qd"], dry)
        steps = np.diff(phase.mesh)
        # A friction window is as long as the longest interval with a reversal.
        turns &= steps > 0.6 * steps[turns].max(initial=0.0)
        marked.append(turns[:, None] | (excess > search.settings.limit_tolerance))
    return marked


def graded(phase: PhaseSolution, count: int) -> FloatArray:
    """Return a mesh [count+1] of a phase, denser where its accelerations change.

    The density is ``(1 - g) + g w / sum(w)`` with the share g = ``graded_share`` and the weight w
    of an interval: its length times the largest relative slope of the accelerations.
    Equidistribution: mesh points lie at equal steps of the cumulated density.
    """
    steps, change = np.diff(phase.mesh), np.abs(np.diff(phase["qdd"], axis=0))
    change = (change / np.maximum(np.abs(phase["qdd"]).max(axis=0), TINY)).max(axis=1)
    slope = np.pad(change / steps, 1)
    # A change may begin anywhere in the interval or in a neighbour, which counts half.
    weight = steps * np.maximum(slope[1:-1], 0.5 * np.maximum(slope[:-2], slope[2:]))
    density = (1.0 - SEARCH.graded_share) * steps + SEARCH.graded_share * weight / max(
        weight.sum(), TINY
    )
    reached = np.concatenate([[0.0], np.cumsum(density)])
    mesh = np.interp(np.linspace(0.0, reached[-1], count + 1), reached, phase.mesh)
    mesh[[0, -1]] = 0.0, 1.0
    return mesh


STRATEGIES = (
    *FROM_GUESSES,
    MotionStrategy(
        "less and less smoothing",
        next_smoother,
        less_and_less_smoothing,
        "light arms: torques change between coarse mesh points by more than the mesh resolves",
    ),
    MotionStrategy(
        "less smoothing",
        next_less_smoothing,
        less_smoothing,
        "light arms, whose jerk is large without smoothing",
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
