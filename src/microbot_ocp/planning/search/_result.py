"""The motion that a search returns, with its provenance and remarks."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.outcome import Advice, Outcome
from microbot_ocp._base.status import Status
from microbot_ocp.motion import Motion
from microbot_ocp.ocp import Solution
from microbot_ocp.ocp.refinement import WORSE
from microbot_ocp.ocp.transcription import Guess
from microbot_ocp.planning.free import (
    BUDGET,
    Slowed,
    effort_scale,
    in_arcs,
    judged,
    largest_excess,
    via_times,
)
from microbot_ocp.planning.search._branches import Way
from microbot_ocp.planning.search._chatter import chatter
from microbot_ocp.planning.search._problem import MotionProblem
from microbot_ocp.planning.search._queue import Level
from microbot_ocp.planning.search._refinement import best_of, refine
from microbot_ocp.planning.search._search import (
    NOTHING,
    MotionAnswer,
    MotionSearch,
    SearchState,
    keeps_limits,
    ledger_of,
    settled,
    slowdown,
)
from microbot_ocp.planning.search._settings import (
    NEAR_WAY_BARRIER,
    SAME_OPTIMUM,
    SMOOTHING_COST_LIMIT,
    reserving,
)
from microbot_ocp.planning.search._starts import explore, least_of_slower, next_start, sample
from microbot_ocp.planning.task import (
    one_remark,
    provenance_of,
    rates_at_reversals,
    verdict,
    with_locked_joints_held,
)

LARGEST_SLACK = 20.0  # largest slack for least effort, relative to the shortest duration

LEFT_OUT = "left out"  # status of an untried way
LATE = "late"  # kind of advice: the motion takes longer than the requested duration
NONE_WITHIN = "The search found no motion within the limits."

FREE = "free time-optimal motion, multiple shooting on the inverse dynamics"  # method


def too_late(wanted: float | None, shortest: float) -> Outcome:
    """Return the outcome of a motion whose shortest duration, s, is more than what is wanted."""
    sentence = (
        f"The task cannot be done in {wanted:g} s: the fastest motion that was found takes "
        f"{shortest:.6g} s."
    )
    return Outcome(Status.INFEASIBLE, (Advice(LATE, sentence),))


def is_late(motion: Motion) -> bool:
    """Return True if a motion only takes longer than the duration that was asked for."""
    return LATE in {row.kind for row in motion.outcome.advice}


def is_accepted(motion: Motion) -> bool:
    """Return True if a motion is solved, or only late."""
    return motion.solved or is_late(motion)


def returned(made_from: str) -> Advice:
    """Return advice on a motion that replaces a solution."""
    sentence = f"Returned is {made_from}: it keeps every limit, but others may be faster."
    return Advice("returned", sentence, made_from)


@dataclass(frozen=True, eq=False)
class LeastEffort:
    """Result of the search for less effort than that of the fastest motion.

    Attributes
    ----------
    answer : motion of least effort, or the fastest if none was solved
    slack : allowed share of the duration
    fastest : duration of the fastest motion, s
    effort : time integral of the squared relative torques, s
    effort_of_the_fastest : effort of the fastest motion, s
    status : status of the solve
    """

    answer: MotionAnswer
    slack: float
    fastest: float
    effort: float
    effort_of_the_fastest: float
    status: str

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for the provenance."""
        return {key: value for key, value in vars(self).items() if key != "answer"}

    @property
    def remark(self) -> str:
        """Saved effort and its price, for a remark."""
        duration = self.answer.solution.duration
        if duration == self.fastest:
            return f"no motion of less effort was found ({self.status})"
        saved = 1.0 - self.effort / self.effort_of_the_fastest
        slower = duration / self.fastest - 1.0
        return f"{100 * slower:.3g} % slower than the fastest for {100 * saved:.3g} % less effort"


@dataclass(frozen=True, eq=False)
class Fastest:
    """End of a search: its state, the best answer, and the motion of less effort.

    Attributes
    ----------
    cut : True if the time limit ended the search
    duration : duration asked for least effort, s
    shortest : duration of the fastest motion with dwells, s
    """

    search: MotionSearch
    state: SearchState
    answer: MotionAnswer
    calmer: LeastEffort | None
    wall_time: float
    cut: bool
    duration: float | None = None
    shortest: float = np.nan

    @property
    def smoothing_cost(self) -> float:
        """Increase of the cost by the smoothing of the jerk, s."""
        solution = self.answer.solution
        return 0.0 if self.calmer else max(0.0, solution.cost - solution.duration)

    @property
    def late(self) -> bool:
        """True if the fastest motion takes longer than the given duration."""
        return self.duration is not None and self.duration < self.shortest * (1 - SAME_OPTIMUM)


def fastest(
    search: MotionSearch,
    state: SearchState | None = None,
    slack: float | None = None,
    duration: float | None = None,
) -> Fastest:
    """Return the fastest answer, or one of less effort if a slack or a duration, s, is given."""
    begin, problem = time.perf_counter(), search.problem
    keeps_time = problem.timed_path is None and not problem.again
    with reserving() if keeps_time else nullcontext():
        state = refine(search, explore(search, state or NOTHING))
        answer, calmer = best_of(search, state), None
        # Dwells are not phases of the program.
        shortest = answer.solution.duration + problem.dwell_time
        slack = search.settings.slack if slack is None else slack
        if duration is not None:
            # Dwells are fixed, so the slack is relative to the time in motion.
            slack = (duration - shortest) / answer.solution.duration if answer.solved else 0.0
            slack = min(slack, LARGEST_SLACK)
        if slack > 0.0 and keeps_limits(search, answer.solution) and not search.over:
            start = time.perf_counter()
            calmer = least_effort(search, answer, slack)
            state, answer = state.and_(calmer.answer, start), calmer.answer
        cut = search.over
    spent = time.perf_counter() - begin
    return Fastest(search, state, answer, calmer, spent, cut, duration, shortest)


def motion_from(best: Fastest) -> Motion:
    """Return the fastest motion of a task, or a known one if that is better."""
    search, begin, solution = best.search, time.perf_counter(), best.answer.solution
    problem, motion = search.problem, motion_of_answer(best)
    if solution.status is not Status.INTERRUPTED and best.duration is None:
        motion = _known_if_better(best, motion)
    judged_by_starts = problem.is_free and motion.solved and not problem.again
    if judged_by_starts and not settled(sample(best.state), search.settings):
        outcome = Outcome.of(deadline.status())
        if next_start(search, best.state) is None:  # more time leads to no further start
            count = len(motion.provenance["starts"])
            advice = (
                f"{count} starts led to almost as many different optima, so a faster one may "
                "exist: allow more tries, or take another seed."
            )
            outcome = Outcome.of(Status.LOCAL_OPTIMUM, advice)
        motion = motion.ended(replace(outcome, ledger=motion.outcome.ledger))
    if not search.settings.switching_times or not motion.solved:
        return motion
    held: Any = with_locked_joints_held(problem.family).robot
    exact = in_arcs(problem.family, held, motion, problem.guesses(solution), search.progress)
    spent = motion.provenance["wall_time"] + time.perf_counter() - begin
    return replace(exact, provenance={**exact.provenance, "wall_time": spent})


def motion_of_answer(best: Fastest) -> Motion:
    """Return the best answer as a motion, with the record of the search in its provenance."""
    search, state, solution = best.search, best.state, best.answer.solution
    problem, excess = search.problem, search.problem.excess(solution)
    outcome = verdict(problem.family, solution, excess, search.settings.limit_tolerance).and_(
        *problem.scale.active_bounds([p.duration for p in solution.phases]),
        *rates_at_reversals(problem.family, solution),
    )
    more: dict[str, Any] = {"least_effort": best.calmer.as_dict()} if best.calmer else {}
    # The relaxed problem tells which limit gives, and by how much, if no start converged.
    relaxed = next((a.relaxed for a in state.answers if a.relaxed is not None), None)
    if relaxed is not None and not (solution.status.solved or deadline.over()):
        outcome, least = judged(relaxed, problem.family, outcome)
        more |= least
    if outcome.solved and best.late:
        outcome = too_late(best.duration, best.shortest)
    outcome = replace(outcome, ledger=ledger_of(state, best.answer))
    starts = starts_of(state, problem.dwell_time)
    optima = sorted({round(s["duration"], 3) for s in starts if s["status"] == "solved"})
    method = FREE
    remark = _remark(problem, len(starts), optima)
    if not problem.task.is_plain:
        method = "time-optimal motion through stops"
        more["branches"] = branches_of(problem, state, solution)
        more["segments"] = [type(k).__name__ if k else "free" for k in problem.task.segments]
        # Among obstacles every way has its own search, whose remark is made elsewhere.
        remark = "" if problem.timed_path else remark_of_branches(more["branches"])
    provenance = provenance_of(
        method,
        problem.family,
        solution,
        search.worst(solution),
        best.wall_time + search.kernel_time,
        best.answer.smoothing,
        problem.task,
        smoothing_cost=best.smoothing_cost,
        optima_seen=optima,
        starts=starts,
        solves=[solve for answer in state.answers for solve in answer.solves],
        kernel_time=search.kernel_time,
        **more,
    )
    motion = problem.motion(solution, provenance)
    robot, calmer = problem.family.robot, best.calmer is not None
    swings = chatter(robot, motion, calmer=calmer) if outcome.solved else ()
    remarks = one_remark(remark, *_further_remarks(best), *(row.sentence for row in swings))
    return replace(motion, remark=remarks, outcome=outcome.and_(*swings))


def starts_of(state: SearchState, dwell_time: float = 0.0) -> list[dict[str, Any]]:
    """Return the result of every initial guess, for the provenance; dwells add ``dwell_time`` s."""
    return [
        {
            "start": answer.start,
            "status": str(answer.solution.status),
            "duration": answer.solution.duration + dwell_time,
            "iterations": answer.iterations,
        }
        for answer in state.answers
        if answer.before is None
    ]


def _further_remarks(best: Fastest) -> Iterator[str]:
    """Yield remarks on saved effort, and on smoothing if it costs much."""
    if best.calmer:
        yield best.calmer.remark
    share = best.smoothing_cost / best.answer.solution.duration
    if best.answer.solution.status.solved and share >= SMOOTHING_COST_LIMIT:
        yield f"without smoothing of the jerk it could be about {100 * share:.1g} % faster"


def _known_if_better(best: Fastest, motion: Motion) -> Motion:
    """Return a known motion within the limits if the motion found exceeds them or is slower."""
    problem, solution = best.search.problem, best.answer.solution
    known = problem.way if motion.solved else _known(best)
    if known is None:
        return motion
    # Positive where the known motion is slower than the solution, which may exceed limits.
    more = known.motion.duration / (solution.duration + problem.dwell_time) - 1.0
    if motion.solved and (best.calmer or more >= -WORSE):
        return motion
    how = f"returned is {known.made_from}"
    if solution.status.solved and more > 0.0:
        how = f"slowed down by {100 * more:.2g} % where it exceeded limits"
    outcome = _outcome_of_known(best, motion, abs(more) <= WORSE)
    if not outcome.solved:
        outcome = outcome.and_(returned(known.made_from))
    remark, excess = one_remark(motion.remark, how), largest_excess(problem.family, known.motion)
    return replace(known.motion, provenance=motion.provenance, remark=remark).ended(
        outcome, made_from=known.made_from, excess=excess
    )


def _known(best: Fastest) -> Slowed | None:
    """Return the fastest known motion within the limits."""
    problem, found = best.search.problem, best.answer
    known = [problem.way] if problem.way else []
    # After the deadline a free solution is not slowed down if a known motion exists, or if another
    # call follows.
    if not ((known or problem.again) and problem.is_free and deadline.over()):
        answers = [found]
        if slowdown(problem, found.solution) > WORSE:
            answers += [a for a in best.state.answers if a.start == found.start]
        for answer in answers:
            slowed = problem.slowed(answer.solution)
            if slowed is not None:
                origin = "the motion found" if answer is found else "a coarser motion"
                known.append(Slowed(slowed, f"{origin}, slowed down at limits"))
    return min(known, key=lambda way: way.motion.duration, default=problem.fallback)


def _outcome_of_known(best: Fastest, motion: Motion, as_fast: bool) -> Outcome:
    """Return the outcome of a known motion that replaces the motion found.

    A solution slowed down by no more than the usual difference of two meshes counts as solved. A
    search that was cut short is not called solved, however near its motion is.
    """
    outcome, status = motion.outcome, motion.status
    cut_short = status in (Status.TIME_LIMIT, Status.INTERRUPTED)
    if as_fast and best.answer.solved and not cut_short:
        outcome = Outcome.of(Status.SOLVED)
    elif status in (Status.LIMITS_EXCEEDED, Status.SOLVED):
        outcome = Outcome.of(deadline.status() if best.cut else Status.NOT_ACCEPTED)
    elif status is Status.INFEASIBLE:  # disproved by the known motion
        outcome = Outcome.of(Status.FAILED, NONE_WITHIN)
    return replace(outcome, ledger=motion.outcome.ledger)


def _remark(problem: MotionProblem, start_count: int, optima: Sequence[float]) -> str:
    passed = {2: "", 3: "via point passed at any velocity"}
    via = passed.get(len(problem.via), "via points passed at any velocity")
    if problem.timed_path is not None or problem.again:
        return via
    if not optima:
        return f"none of {start_count} starts led to a motion"
    starts = "1 start" if start_count == 1 else f"{start_count} starts"
    durations = ", ".join(f"{duration:.3f}" for duration in optima)
    ends = f"{starts} ended at {durations} s on the coarse mesh, the best was refined"
    return one_remark(via, ends)


def branches_of(
    problem: MotionProblem, state: SearchState, solution: Solution
) -> list[dict[str, Any]]:
    """Return the coarse duration of every way through the branches, the taken one first."""
    via = poses_at(solution)
    best: dict[str, dict[str, Any]] = {}
    for answer in state.at(Level.COARSE):
        way, coarse = answer.way, answer.solution
        if way is None or answer.relaxed is not None:
            continue
        duration = coarse.duration + problem.dwell_time if answer.solved else None
        # The taken way is the one whose poses at the stops are nearest to those of the motion: a
        # tolerant stop may move.
        apart = float(np.abs(poses_at(coarse) - via).max())
        keep_faster(best, way, row_of_way(way, duration, str(coarse.status), apart=apart))
    rows = sorted(best.values(), key=lambda row: row.pop("apart"))
    for row in rows[:1]:  # empty for a motion that was solved again with larger distances
        row["taken"] = True
    rows.sort(key=taken_first)
    for way in problem.ways:
        least = least_of_slower(problem, state, way)
        if way.name not in best and least is not None:
            rows.append(row_of_way(way, None, LEFT_OUT, at_least=least + problem.dwell_time))
    return rows


def row_of_way(
    way: Way, duration: float | None, status: str, taken: bool = False, **more: float
) -> dict[str, Any]:
    """Return the row of a way in the provenance, with its duration, s, if it was solved."""
    row = {"branches": list(way.branches), "q": way.via.tolist(), "duration": duration}
    return row | {"status": status, "taken": taken, **more}


def keep_faster(rows: dict[str, dict[str, Any]], way: Way, row: dict[str, Any]) -> None:
    """Store the row of a way unless a stored one is as fast."""
    before = rows.get(way.name)
    if before is None or (before["duration"] or np.inf) > (row["duration"] or np.inf):
        rows[way.name] = row


def taken_first(row: dict[str, Any]) -> tuple[bool, float]:
    """Return the sort key of a row: the taken way first, then by duration."""
    return not row["taken"], row["duration"] or np.inf


def remark_of_branches(branches: Sequence[dict[str, Any]]) -> str:
    """Return a remark that compares the taken way with the others on the same coarse mesh."""
    taken, *others = branches
    if not others:
        return "the arm reaches the stops in one way only"
    parts = [f"the best of {len(branches)} ways in which the arm reaches the stops"]
    tried = [entry["duration"] for entry in others if entry["status"] != LEFT_OUT]
    solved = [duration for duration in tried if duration is not None]
    if solved and taken["duration"] is not None:
        longer = 100.0 * (min(solved) / taken["duration"] - 1.0)
        near, more = "is about as fast", f"takes {longer:.1f} % longer"
        parts.append(f"the next one {more if round(longer, 1) else near}")
    if len(tried) > len(solved):
        parts.append(f"{len(tried) - len(solved)} led to no motion")
    if slow := [entry["at_least"] for entry in others if entry["status"] == LEFT_OUT]:
        parts.append(
            f"others need {min(slow):.3f} s or more by their speeds and accelerations alone"
        )
    return "; ".join(parts)


def poses_at(solution: Solution) -> FloatArray:
    """Return joint poses [m,n] at the stops, rad (m)."""
    ends = [phase["q"][-1] for phase in solution.phases]
    return np.array([solution.phases[0]["q"][0], *ends])


# less effort --------------------------------------------------------------------------------------


def least_effort(search: MotionSearch, fastest: MotionAnswer, slack: float) -> LeastEffort:
    """Return the motion of least effort that is at most ``slack`` slower; the fastest if none."""
    problem, solution, slower = search.problem, fastest.solution, 1.0 + slack
    kernels = problem.kernels(budgeted=True)
    allowed = {problem.names[-1]: {BUDGET: slower * solution.duration}}
    kernels, guess = kernels.with_parameters(allowed), partial(_with_clock, search)
    refiner = replace(fastest.refiner, transcription=kernels, guess_from=guess)
    refiner = replace(refiner, rough=None, history=[])
    # The fastest motion is a feasible guess of the new problem only on its own mesh.
    # The time allowed is a bound of the last phase, so the durations of all phases may change.
    meshes = [phase.mesh for phase in solution.phases]
    guesses = guess(solution, slower)
    calmer = refiner.refine(refiner.solve(meshes, guesses, barrier=NEAR_WAY_BARRIER))
    search.progress(f"least effort: {calmer.duration:.6f} s, {calmer.status}")
    solves = tuple(refiner.history)
    answer = replace(fastest, step="least effort", before=fastest, solves=solves)
    if keeps_limits(search, calmer):
        answer = replace(answer, solution=calmer, refiner=refiner)
    efforts = effort_of(search, answer.solution), effort_of(search, solution)
    return LeastEffort(answer, slack, solution.duration, *efforts, str(calmer.status))


def effort_of(search: MotionSearch, solution: Solution) -> float:
    """Return the effort of a solution, s.

    Effort is the integral of ``sum((tau / scale)**2)`` over time; without masses accelerations
    replace the torques.
    """
    problem = search.problem
    motion = problem.motion(solution, {})
    moved = motion.tau if problem.family.robot.has_dynamics else motion.qdd
    scaled = moved / effort_scale(problem.family, problem.scale.acceleration)
    return float(np.trapezoid((scaled**2).sum(axis=1), motion.t))


def _with_clock(search: MotionSearch, solution: Solution, slower: float = 1.0) -> dict[str, Guess]:
    """Return guesses from a solution slowed down by a factor, with the elapsed time as a state.

    The k-th time derivative of q is divided by the k-th power of the factor.
    """
    edges, with_clock = itertools.pairwise(slower * via_times(solution)), {}
    guesses = search.problem.guesses(solution).items()
    for (name, guess), (start, end) in zip(guesses, edges, strict=True):
        rates = {
            key: partial(_slowed, guess.values[key], slower**power)
            for power, key in enumerate(("q", "qd", "qdd"))
        }
        values = {**guess.values, **rates, "clock": partial(_clock, start, end)}
        with_clock[name] = Guess(float(end - start), values)
    return with_clock


def _slowed(curve: Any, by: float, s: FloatArray) -> FloatArray:
    return curve(s) / by


def _clock(start: float, end: float, s: FloatArray) -> FloatArray:
    return start + (end - start) * s[:, None]
