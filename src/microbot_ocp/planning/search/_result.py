"""The motion that a search returns, with what is known of it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from typing import Any

from microbot_ocp._base import deadline
from microbot_ocp._base.outcome import Advice, Outcome
from microbot_ocp._base.status import Status
from microbot_ocp.motion import Motion
from microbot_ocp.ocp.refinement import WORSE
from microbot_ocp.planning.free import Slowed, in_arcs, judged, largest_excess
from microbot_ocp.planning.search._least_effort import LeastEffort, least_effort
from microbot_ocp.planning.search._problem import FreeProblem
from microbot_ocp.planning.search._ranking import is_enough, rank, settled
from microbot_ocp.planning.search._search import MotionAnswer, MotionSearch, SearchState, ledger_of
from microbot_ocp.planning.search._settings import SEARCH, sparing
from microbot_ocp.planning.search._strategies import STRATEGIES, best_of, sample
from microbot_ocp.planning.task import (
    largest,
    provenance_of,
    rates_at_reversals,
    verdict,
    with_locked_joints_held,
)

NONE_WITHIN = "The search found no motion within the limits."


def returned(made_from: str) -> Advice:
    """Return advice on a motion that is returned in the place of a solution."""
    sentence = f"Returned is {made_from}: it keeps every limit, but others may be faster."
    return Advice("returned", sentence, made_from)


@dataclass(frozen=True, eq=False)
class Fastest:
    """The end of a search: its state, the best answer, and what less effort came to."""

    search: MotionSearch
    state: SearchState
    answer: MotionAnswer
    calmer: LeastEffort | None
    wall_time: float

    @property
    def smoothing_cost(self) -> float:
        """What the smoothing of the jerk adds to the cost, s."""
        solution = self.answer.solution
        return 0.0 if self.calmer else max(0.0, solution.cost - solution.duration)


def fastest(
    search: MotionSearch, state: SearchState | None = None, slack: float | None = None
) -> Fastest:
    """Run the whole table, and look for less effort where some slack is given."""
    begin = time.perf_counter()
    state = search.run(STRATEGIES, state)
    answer, calmer = best_of(search, state), None
    slack = search.settings.slack if slack is None else slack
    if slack and rank(search, answer.solution)[0] is False and not search.over:
        calmer = least_effort(search, answer, slack)
        state, answer = state.and_(calmer.answer), calmer.answer
    return Fastest(search, state, answer, calmer, time.perf_counter() - begin)


def motion_through(search: MotionSearch, state: SearchState | None = None) -> Motion:
    """Return the fastest motion through via points, or what is known at least."""
    begin, problem = time.perf_counter(), search.problem
    assert isinstance(problem, FreeProblem)
    with sparing() if problem.is_free else nullcontext():
        best = fastest(search, state)
        motion = motion_of_answer(best)
    solution = best.answer.solution
    if problem.is_free and solution.status is not Status.INTERRUPTED:
        motion = _within_limits(best, motion)
        starts = sample(best.state)
        if motion.solved and not settled(starts, search.settings):
            motion = _unsettled(motion)
    if not search.settings.switching_times or not motion.solved:
        return motion
    held: Any = with_locked_joints_held(problem.family).robot
    guesses = problem.guesses(solution)
    exact = in_arcs(problem.family, held, motion, guesses, search.progress)
    spent = time.perf_counter() - begin + search.kernel_time
    return replace(exact, provenance={**exact.provenance, "wall_time": spent})


def motion_of_answer(best: Fastest, **more: Any) -> Motion:
    """Return the best answer as a motion, with the whole search in its provenance."""
    search, state, solution = best.search, best.state, best.answer.solution
    problem, excess = search.problem, search.problem.excess(solution)
    outcome, least = (
        verdict(problem.family, solution, excess, search.settings.limit_tolerance).and_(
            *problem.scale.active_bounds([p.duration for p in solution.phases]),
            *rates_at_reversals(problem.family, solution),
        ),
        {},
    )
    relaxed = next((a.relaxed for a in state.answers if a.relaxed is not None), None)
    if relaxed is not None and not (solution.status.solved or deadline.over()):
        outcome, least = judged(relaxed, problem.family, outcome)
    outcome = replace(outcome, ledger=ledger_of(state, best.answer))
    starts = starts_of(state)
    optima = sorted({round(s["duration"], 3) for s in starts if s["status"] == "solved"})
    provenance = provenance_of(
        "free time-optimal motion, multiple shooting on the inverse dynamics",
        problem.family,
        solution,
        largest(excess),
        best.wall_time + search.kernel_time,
        best.answer.smoothing,
        smoothing_cost=best.smoothing_cost,
        optima_seen=optima,
        starts=starts,
        solves=[solve for answer in state.answers for solve in answer.solves],
        kernel_time=search.kernel_time,
        **({"least_effort": best.calmer.as_dict()} if best.calmer else {}),
        **least,
        **more,
    )
    remark = _remark(len(problem.via), len(starts), optima) + further_remarks(best)
    return replace(problem.motion(solution, provenance), remark=remark, outcome=outcome)


def starts_of(state: SearchState, rested: float = 0.0) -> list[dict[str, Any]]:
    """Return what every initial guess led to, for the provenance; dwells last ``rested`` s."""
    return [
        {
            "start": answer.start,
            "status": str(answer.solution.status),
            "duration": answer.solution.duration + rested,
        }
        for answer in state.of("start", "known way", "timed path")
        if answer.before is None or answer.strategy != "start"
    ]


def further_remarks(best: Fastest) -> str:
    """Return what less effort saves, and what the smoothing costs where it is much."""
    solution, remark = best.answer.solution, best.calmer.remark if best.calmer else ""
    share = best.smoothing_cost / solution.duration
    if not solution.status.solved or share < SEARCH.smoothing_told:
        return remark
    return remark + f"; without smoothing of the jerk it could be about {100 * share:.1g} % faster"


def _within_limits(best: Fastest, motion: Motion) -> Motion:
    """Return a motion that keeps the limits in the place of one that does not, or that is slower.

    A solution slowed down by no more than two meshes may differ counts as solved.
    """
    search, solution = best.search, best.answer.solution
    problem = search.problem
    assert isinstance(problem, FreeProblem)
    fast_enough = motion.solved and not is_enough(problem, search.settings, solution)
    # not even time may be left to slow it down
    if not fast_enough and (problem.way is None or not deadline.over()):
        problem.slowed(solution)
    slower = [problem.way] if problem.way else []
    slower += [Slowed(slowed, _name(a.solution is solution)) for a, slowed in _slowed(search, best)]
    if not fast_enough and not slower and problem.fallback:
        slower = [problem.fallback]
    if not slower:
        return motion
    fallback, made_from = min(slower, key=lambda slowed: slowed.motion.duration)
    more = fallback.duration / solution.duration - 1.0
    if fast_enough and (best.calmer or more >= -WORSE):
        return motion
    outcome = motion.outcome
    if motion.status is not Status.TIME_LIMIT and solution.status.solved and abs(more) <= WORSE:
        outcome = Outcome.of(Status.SOLVED)
    elif motion.status in (Status.LIMITS_EXCEEDED, Status.SOLVED):
        outcome = Outcome.of(Status.NOT_ACCEPTED)
    elif motion.status is Status.INFEASIBLE:  # there is a motion
        outcome = Outcome.of(Status.FAILED, NONE_WITHIN)
    outcome = replace(outcome, ledger=motion.outcome.ledger)
    if not outcome.solved:
        outcome = outcome.and_(returned(made_from))
    remark = f"{motion.remark}; slowed down by {100 * more:.2g} % where it exceeded limits"
    return replace(fallback, provenance=motion.provenance, remark=remark).ended(
        outcome,
        made_from=made_from,
        excess=largest_excess(problem.family, fallback),
    )


def _slowed(search: MotionSearch, best: Fastest) -> list[tuple[MotionAnswer, Motion]]:
    """Return answers that were slowed down so far, and the motions."""
    problem = search.problem
    assert isinstance(problem, FreeProblem)
    rows = []
    for answer in (*best.state.answers, best.answer):
        motion = problem.slowed_before(answer.solution)
        if motion is not None:
            rows.append((answer, motion))
    return rows


def _name(is_answer: bool) -> str:
    origin = "the motion found" if is_answer else "a coarser motion"
    return f"{origin}, slowed down at limits"


def _unsettled(motion: Motion) -> Motion:
    """Give the motion, which is not the fastest where further starts would lead to better ones."""
    advice = (
        f"Of {len(motion.provenance['starts'])} starts nearly every one led to another optimum, so "
        "that others may well be faster: allow more tries, or take another seed."
    )
    outcome = Outcome.of(Status.LOCAL_OPTIMUM, advice)
    return motion.ended(replace(outcome, ledger=motion.outcome.ledger))


def _remark(via_count: int, start_count: int, optima: Sequence[float]) -> str:
    durations = ", ".join(f"{duration:.3f}" for duration in optima)
    passed = {2: "", 3: "via point passed at any velocity; "}
    return (
        f"{passed.get(via_count, 'via points passed at any velocity; ')}{start_count} starts ended "
        f"at {durations} s on the coarse mesh, the best was refined"
    )
