"""The refinement of coarse motions: full meshes, split intervals, last digits.

The fastest of several local optima on a coarse mesh is solved on a finer mesh, whose intervals are
split until limits hold between mesh points.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.status import Status
from microbot_ocp.limits import LimitFamily
from microbot_ocp.motion import Motion
from microbot_ocp.ocp import PhaseSolution, Solution, SolverSettings
from microbot_ocp.ocp.refinement import FORESIGHT as LEAST_FORESIGHT, Refiner
from microbot_ocp.ocp.solution import StepProgress
from microbot_ocp.ocp.transcription import mesh_of
from microbot_ocp.planning.free import (
    accelerations_jump,
    limited_rates,
    transcription,
    with_motion,
)
from microbot_ocp.planning.search._problem import MotionProblem
from microbot_ocp.planning.search._queue import Level, Queue
from microbot_ocp.planning.search._search import (
    MotionAnswer,
    MotionSearch,
    SearchState,
    by_promise,
    is_enough,
    slowdown,
)
from microbot_ocp.planning.search._settings import (
    LEAST_GAIN,
    MOST_ITERATIONS,
    SAME_OPTIMUM,
    SMOOTHING_COST_LIMIT,
    TIMED_PATH_BARRIER,
)
from microbot_ocp.planning.search._starts import full_mesh, nearest
from microbot_ocp.planning.task import (
    EXACT_TOLERANCE,
    GAP,
    JERK_SMOOTHING,
    LDL,
    ROUGH_TOLERANCE,
    dry_friction,
    has_windows,
    rate_switches,
    reversals,
    with_windows,
)

FAR_BARRIER = 3e-5  # barrier parameter of a warm start from a coarse to a full mesh
FORESIGHT = 0.1  # share of the accepted excess from which an interval is split
GRADED_SHARE = 0.5  # share of the intervals placed where the acceleration changes
MOST_POLISHED = 15  # largest number of phases that are solved to the full tolerance
REDUCED_SMOOTHING = 1e-2  # factor on the jerk weight of the reduced smoothing
SMOOTHING_BARRIER = 1e-2  # barrier parameter of the first solve with increased smoothing
# Factors on the usual jerk weight, applied one after another
SMOOTHING_FACTORS = (1e6, 1e5, 1e4, 1e3, 1e2, 10.0, 1.0)
SMOOTHING_ITERATIONS = 200  # iteration limit of each solve with increased smoothing
TIMED_PATH_TOLERANCE = 1e-4  # solver tolerance among obstacles, relative
EXACT = 0.1 * EXACT_TOLERANCE  # largest violation of a constraint among obstacles
# Number of meshes among obstacles without halving the least excess: larger distances help sooner
GUIDED_STUBBORN = 2
GUIDED_SWITCHED = 2  # meshes among obstacles whose intervals are split at switches
USUAL_ITERATIONS = 100  # iteration limit of a full or refined mesh, and of the last step


def search_of(problem: MotionProblem, progress: StepProgress) -> MotionSearch:
    """Return the search of a problem, with its compiled program and the settings of its solves."""
    begin, settings = time.perf_counter(), problem.settings
    kernels = problem.kernels()
    if deadline.over():  # the deadline may have prevented compilation: do not keep these kernels
        transcription.cache_clear()
    kernel_time = time.perf_counter() - begin
    windows, rated = has_windows(problem.family), problem.is_rated
    is_guided = problem.timed_path is not None  # a motion within limits is known
    unpolished = windows and not rated  # the last digits of a reversal take hundreds of iterations
    is_rough = not is_guided and (unpolished or len(problem.names) > MOST_POLISHED)
    refiner = Refiner(
        kernels,
        problem.guesses,
        problem.excess,
        settings.limit_tolerance,
        progress=with_motion(progress, problem.family.robot, problem.via),
        settings=SolverSettings(gap=wanted_gap(problem), options=LDL),
        rough=ROUGH_TOLERANCE,
        foresight=FORESIGHT if rated else 1.0,
        polishing=0 if is_rough else USUAL_ITERATIONS,
        fitted=partial(with_windows, dry_friction(problem.family.robot) > 0.0) if windows else None,
        enough=partial(is_enough, problem) if problem.is_free else None,
    )
    if is_guided:
        tolerance, most = TIMED_PATH_TOLERANCE, MOST_ITERATIONS
        # A link equally near to two faces of a body makes iterates alternate between the two
        # constraints: accept the point after a few acceptable iterations.
        options = {**LDL["ipopt"], "acceptable_tol": 10.0 * tolerance}
        # Poses at stops are equations, which a certificate judges more strictly than optimality.
        options |= {"constr_viol_tol": EXACT, "acceptable_constr_viol_tol": EXACT}
        rough = SolverSettings(gap=np.inf, options={"ipopt": options}, max_iterations=most)
        given = {"rough": None, "settings": rough, "once": True, "stubborn": GUIDED_STUBBORN}
        refiner = replace(refiner, tolerance=tolerance, **given)
    return MotionSearch(problem, refiner, progress, kernel_time)


def wanted_gap(problem: MotionProblem) -> float:
    """Return the largest accepted gap between a solution and the optimum on its mesh, relative."""
    # Jerks and torque rates are third derivatives of the spline: rounding hides their last digits.
    return LEAST_GAIN if problem.is_rated else GAP


# finer meshes ---------------------------------------------------------------------------------

TINY = 1e-12
SHORTEST = 0.05  # share of a phase's longest interval below which none is split at a switch
# Name of each step in the ledger
FULL_MESH = "full mesh"
SMOOTHED_LESS = "less smoothing"
SMOOTHED = "less and less smoothing"
SPLIT = "splitting"
LAST_DIGITS = "last digits"


def refine(search: MotionSearch, state: SearchState) -> SearchState:
    """Return the state with the most promising answers refined, and the best one finished."""
    queue = Queue(_promising(search, state))
    for answer in queue:
        if search.over or state.interrupted or _leads_to_known(answer, state.answers):
            continue
        solved, begin = list[MotionAnswer](), time.perf_counter()
        for step in _raised(search, answer):
            state = state.and_(step, begin)
            solved += [step] if step.solved else []
            if search.over or step.interrupted:
                break
            begin = time.perf_counter()
        queue.put(solved[-1:], before=answer)
    return state


def best_of(search: MotionSearch, state: SearchState) -> MotionAnswer:
    """Return the best refined answer, or else the most promising, or else the least infeasible."""
    answers = state.at(Level.FINISHED) or state.at(Level.SPLIT)
    if answers:
        return min(answers, key=lambda answer: (not answer.keeps_limits, answer.duration))
    solved = by_promise(state.answers)
    return solved[0] if solved else nearest(state)


def _promising(search: MotionSearch, state: SearchState) -> list[MotionAnswer]:
    """Return the answers that no finer one supersedes."""

    def supersedes(finer: MotionAnswer, coarser: MotionAnswer) -> bool:
        # A coarse motion may be faster by as much as it exceeds its limits between mesh points.
        more = SAME_OPTIMUM + max(0.0, search.worst(coarser.solution))
        return finer.solved and finer.duration <= (1.0 + more) * coarser.duration

    continued = {a.before for a in state.starts if a.before and supersedes(a, a.before)}
    return by_promise([a for a in state.answers if a not in continued])


def resumed(search: MotionSearch, answer: MotionAnswer) -> MotionAnswer:
    """Solve an answer again under other limits, on its own meshes."""
    weight = answer.smoothing
    kernels = search.problem.smoothed(search.refiner.transcription, weight)
    refiner = replace(search.refiner, transcription=kernels, history=[])
    meshes = [phase.mesh for phase in answer.solution.phases]
    first = replace(refiner, once=False)
    solution = first.solve(meshes, answer.solution, barrier=TIMED_PATH_BARRIER)
    search.progress(f"start {answer.start}: {solution.duration:.6f} s, {solution.status}")
    found = {"solution": solution, "refiner": refiner}
    if answer.level is Level.COARSE:  # still the answer of its start
        return replace(answer, **found, solves=(*answer.solves, *first.history))
    given = {"before": answer, "step": FULL_MESH, "level": Level.FULL}
    return replace(answer, **found, solves=tuple(first.history), **given)


def _leads_to_known(answer: MotionAnswer, others: Sequence[MotionAnswer]) -> bool:
    """Return True if a faster answer on a full mesh probably leads to the same optimum."""
    full = [a for a in (*others, answer) if a.level is Level.FULL]
    return answer in full and answer not in by_promise(full)


def _raised(search: MotionSearch, answer: MotionAnswer) -> Iterator[MotionAnswer]:
    """Yield the answers of the steps that raise an answer by one level.

    A coarse answer is solved on a full mesh, with less smoothing if that is better. After a failure
    it stays a coarse one, to be raised by a homotopy in the smoothing, or else by splitting its own
    intervals.
    """
    if answer.level is Level.SPLIT:
        yield last_digits(search, answer)
    elif answer.level is Level.FULL:
        yield split_where_exceeded(search, answer)
    elif answer.step == FULL_MESH:
        smoothed = None
        if (within := _within_limits(search, answer)) is not None:
            smoothed = less_and_less_smoothing(search, answer, within)
            yield smoothed
        if smoothed is None or not smoothed.solved:
            yield split_where_exceeded(search, answer)
    else:
        full = to_full_mesh(search, answer)
        if full.solution is not answer.solution:
            yield full
            if full.solved and _smooths_too_much(search, full):
                yield less_smoothing(search, full)
        elif search.problem.timed_path is None:  # a coarse motion passes through bodies
            yield replace(answer, before=answer, step=FULL_MESH, solves=full.solves)


def to_full_mesh(search: MotionSearch, subject: MotionAnswer) -> MotionAnswer:
    """Solve on a full mesh, denser where the coarse accelerations change."""
    refiner, before = _going_on(subject), subject.solution
    jumps, mesh = accelerations_jump(search.problem.family), full_mesh(search)
    is_guided = search.problem.timed_path is not None
    even = is_guided and not jumps
    meshes = [mesh if even else graded(phase, mesh) for phase in before.phases]
    more: dict[str, Any] = {}
    if _smooths_too_much(search, subject, meshes):
        refiner, weight = _less_smoothed(search, refiner)
        more = {"refiner": replace(refiner, history=[]), "smoothing": weight}
    finer = partial(_finer, subject, FULL_MESH, Level.FULL, **more)
    if is_guided:  # a small barrier parameter shortens steps near many distance constraints
        refiner = replace(refiner, settings=from_barrier(refiner, TIMED_PATH_BARRIER))
    if is_guided or not jumps:
        solution = refiner.finer(before, meshes)
        if refiner.fitted is not None and solution is not before:
            marks = partial(friction_marks, search)
            solution = refiner.sharpen(solution, marks, worth=LEAST_GAIN)
        return finer(solution, refiner)
    # A warm start with multipliers needs a barrier parameter that matches the mesh error: a smaller
    # one keeps the iterates too near to bounds that are active on the coarse mesh only.
    settings = _at_most(from_barrier(refiner, FAR_BARRIER), USUAL_ITERATIONS)
    farther = replace(refiner, settings=settings, once=True)
    return finer(farther.finer(before, meshes), refiner)


def from_barrier(refiner: Refiner, barrier: float) -> SolverSettings:
    """Return settings of a warm start that begins at a barrier parameter."""
    options = {**refiner.settings.options.get("ipopt", {}), "mu_init": barrier}
    return replace(refiner.settings, options={"ipopt": options})


def _at_most(settings: SolverSettings, iterations: int) -> SolverSettings:
    return replace(settings, max_iterations=min(settings.max_iterations, iterations))


def _going_on(subject: MotionAnswer) -> Refiner:
    """Return the refiner that continues an answer, with the record of its last solve."""
    last = next((answer.solves[-1:] for answer in subject.lineage if answer.solves), ())
    return replace(subject.refiner, history=[*last])


def _finer(
    subject: MotionAnswer, step: str, level: Level, solution: Solution, by: Refiner, **other: Any
) -> MotionAnswer:
    """Return the answer of a step; ``other`` fields replace those of the subject."""
    fields = {"refiner": replace(subject.refiner, history=[]), "solves": tuple(by.history[1:])}
    fields |= {"before": subject, "step": step, "level": level, "relaxed": None}
    return replace(subject, solution=solution, **(fields | other))


def _within_limits(search: MotionSearch, answer: MotionAnswer) -> Motion | None:
    """Return a motion within limits near a solved answer with jumps, or None.

    It is the answer slowed down, or the fallback motion.
    """
    if not (answer.solved and accelerations_jump(search.problem.family)):
        return None
    slowed = search.problem.slowed(answer.solution) if search.problem.is_free else None
    return slowed or getattr(search.problem.fallback, "motion", None)


def less_and_less_smoothing(
    search: MotionSearch, subject: MotionAnswer, within: Motion
) -> MotionAnswer:
    """Solve on the full mesh from a motion within the limits, with decreasing smoothing.

    Homotopy in the weight of the squared jerk. For light or fast arms torques change between coarse
    mesh points by more than the mesh resolves: a coarse optimum is spurious, and a fine mesh does
    not converge from it.
    """
    refiner = _going_on(subject)
    limited = _at_most(refiner.settings, SMOOTHING_ITERATIONS)
    meshes = [full_mesh(search)] * len(search.problem.names)
    start: Any = search.problem.guesses_along(within)
    last: Solution | None = None
    barrier: float | None = SMOOTHING_BARRIER
    for times in SMOOTHING_FACTORS:
        weight = times * subject.smoothing
        kernels = search.problem.smoothed(search.refiner.transcription, weight)
        finer = replace(refiner, transcription=kernels)
        solution = replace(finer, settings=limited).solve(meshes, start, barrier=barrier)
        search.progress(f"smoothed {times:g} times: {solution.duration:.6f} s, {solution.status}")
        if not solution.status.solved:
            break
        worth = np.inf if last is None else last.duration / solution.duration - 1.0
        start, last, barrier = solution, solution, None
        if times == SMOOTHING_FACTORS[-1] or worth < SAME_OPTIMUM:
            finer = replace(finer, history=[])
            given = {"refiner": finer, "smoothing": weight}
            return _finer(subject, SMOOTHED, Level.FULL, solution, refiner, **given)
        if search.over:
            break
    failed = solution if last is None else replace(last, status=Status.FAILED)
    return _finer(subject, SMOOTHED, Level.FULL, failed, refiner)


def _smooths_too_much(search: MotionSearch, answer: MotionAnswer, *meshes: Any) -> bool:
    """Return True if accelerations jump and the usual smoothing costs too much."""
    is_usual = answer.smoothing > REDUCED_SMOOTHING * JERK_SMOOTHING
    jumps = accelerations_jump(search.problem.family)
    return is_usual and jumps and _is_costly(answer.solution, *meshes)


def _is_costly(solution: Solution, meshes: Sequence[int | FloatArray] = ()) -> bool:
    """Return True if the smoothing cost is too large, on a solution's meshes or on given ones.

    A jump of the acceleration by D takes one interval of length h, so its squared jerk, integrated,
    is D^2 / h. Where torques change between coarse mesh points the cost on a finer mesh is larger.
    """
    coarse = fine = 0.0
    own = [phase.mesh for phase in solution.phases]
    for phase, given in zip(solution.phases, meshes or own, strict=True):
        mesh = mesh_of(given)
        cost = (np.diff(phase["qdd"], axis=0) ** 2).sum(axis=1) / np.diff(phase.mesh)
        inside = np.diff(np.searchsorted(mesh, phase.mesh))  # finer intervals in each interval
        coarse, fine = coarse + cost.sum(), fine + (np.maximum(inside, 1) * cost).sum()
    share = (solution.cost - solution.duration) / solution.duration
    return share * fine > SMOOTHING_COST_LIMIT * coarse


def _less_smoothed(search: MotionSearch, refiner: Refiner) -> tuple[Refiner, float]:
    """Return a refiner with less smoothing, and the weight of the squared jerk."""
    weight = REDUCED_SMOOTHING * JERK_SMOOTHING
    # The LDL factorisation without pivots loses the small curvature of a weak jerk term in
    # rounding: 40 iterations instead of 21.
    usual = replace(refiner.settings, options={})
    kernels = search.problem.smoothed(refiner.transcription, weight)
    return replace(refiner, transcription=kernels, settings=usual), weight


def less_smoothing(search: MotionSearch, subject: MotionAnswer) -> MotionAnswer:
    """Solve with less smoothing on the same mesh; later solves keep the weight."""
    refiner, meshes = _going_on(subject), [phase.mesh for phase in subject.solution.phases]
    finer, weight = _less_smoothed(search, refiner)
    settings = _at_most(finer.settings, USUAL_ITERATIONS)
    solution = replace(finer, settings=settings).solve(meshes, subject.solution)
    search.progress(f"smoothed less: {solution.duration:.6f} s, {solution.status}")
    if solution.status.solved and solution.duration >= subject.duration:
        solution = replace(solution, status=Status.NOT_ACCEPTED)
    given = {"refiner": replace(finer, history=[]), "smoothing": weight}
    return _finer(subject, SMOOTHED_LESS, Level.FULL, solution, refiner, **given)


def split_where_exceeded(search: MotionSearch, subject: MotionAnswer) -> MotionAnswer:
    """Split intervals at switches, and until limits hold between mesh points."""
    refiner, best = _going_on(subject), subject.solution
    is_guided, tolerance = search.problem.timed_path is not None, search.settings.limit_tolerance
    # An answer that is solved again keeps the intervals that were split at switches.
    again = subject.before is not None and subject.before.level >= Level.SPLIT
    marks: Any = {
        "switching": partial(switch_marks, search.problem.family),
        "most": 0 if again else GUIDED_SWITCHED if is_guided else np.inf,
        # Other ways around obstacles differ by percents: the last meshes are not worth their time.
        "worth": tolerance if is_guided else LEAST_GAIN,
    }
    if accelerations_jump(search.problem.family):
        refiner = replace(refiner, foresight=FORESIGHT if refiner.rough else LEAST_FORESIGHT)
    if is_guided:  # a failed solve is repeated from a larger barrier
        refiner = replace(refiner, settings=from_barrier(refiner, TIMED_PATH_BARRIER))
    else:
        # The last refinement of a mesh gains almost nothing and may take a thousand iterations.
        rated = search.problem.is_rated
        most = USUAL_ITERATIONS if rated else SMOOTHING_ITERATIONS
        settings = _at_most(refiner.settings, most)
        refiner = replace(refiner, once=rated, worth=LEAST_GAIN, settings=settings)
    best = refiner.refine(best, **marks)
    return _finer(
        subject, SPLIT, Level.SPLIT, best, refiner, slowdown=slowdown(search.problem, best)
    )


def last_digits(search: MotionSearch, subject: MotionAnswer) -> MotionAnswer:
    """Solve to the full tolerance.

    A rough solve from a timed path ends with a positive barrier parameter, which keeps the motion
    off its limits. A few iterations from the multipliers reduce the cost of this to almost zero.
    """
    refiner, solution = _going_on(subject), subject.solution
    tolerance = search.settings.limit_tolerance
    if search.problem.timed_path is None:
        loose = not refiner.is_finished(solution)
    else:
        loose = not solution.gap.total <= tolerance * abs(solution.cost)
        loose = loose and search.worst(solution) <= tolerance
    if loose:
        solution = refiner.polished(solution)
    given = {"slowdown": slowdown(search.problem, solution)}
    return _finer(subject, LAST_DIGITS, Level.FINISHED, solution, refiner, **given)


# mesh density ------------------------------------------------------------------------------------


def switch_marks(family: LimitFamily, solution: Solution) -> list[np.ndarray]:
    """Return masks of intervals in which a limited quantity switches.

    A velocity that changes by more than half of its limit in one interval could change far sooner
    than the mesh allows. Under limits of jerks or torque rates the same holds for accelerations and
    torques. A switch of a rate inside an interval wastes half of the interval: 1 % of the duration
    for a Panda on 60 even intervals. Intervals below ``SHORTEST`` are not marked.
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
        # The longest interval with a reversal sets the friction window: split only such intervals.
        turns &= steps > 0.6 * steps[turns].max(initial=0.0)
        marked.append(turns[:, None] | (excess > search.settings.limit_tolerance))
    return marked


def graded(phase: PhaseSolution, count: int) -> FloatArray:
    """Return a mesh [count+1] of a phase, denser where its accelerations change.

    An interval of length h holds the share ``(1 - g) h + g w / sum(w)`` of the new mesh, with g =
    ``GRADED_SHARE`` and the weight w: h times the largest relative slope of the accelerations.
    Equidistribution: mesh points lie at equal steps of the cumulated shares.
    """
    steps, change = np.diff(phase.mesh), np.abs(np.diff(phase["qdd"], axis=0))
    change = (change / np.maximum(np.abs(phase["qdd"]).max(axis=0), TINY)).max(axis=1)
    slope = np.pad(change / steps, 1)
    # A change may begin anywhere in the interval or in a neighbour, which counts half.
    weight = steps * np.maximum(slope[1:-1], 0.5 * np.maximum(slope[:-2], slope[2:]))
    density = (1.0 - GRADED_SHARE) * steps + GRADED_SHARE * weight / max(weight.sum(), TINY)
    reached = np.concatenate([[0.0], np.cumsum(density)])
    mesh = np.interp(np.linspace(0.0, reached[-1], count + 1), reached, phase.mesh)
    mesh[[0, -1]] = 0.0, 1.0
    return mesh
