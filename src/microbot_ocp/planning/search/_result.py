"""The motion that a search returns, with what is known of it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from typing import Any

from microbot_ocp._base import deadline
from microbot_ocp._base.status import Status
from microbot_ocp.motion import Motion
from microbot_ocp.ocp.refinement import WORSE
from microbot_ocp.planning.free import Slowed, in_arcs, judged, largest_excess
from microbot_ocp.planning.search._least_effort import LeastEffort, least_effort
from microbot_ocp.planning.search._problem import FreeProblem
from microbot_ocp.planning.search._search import MotionAnswer, MotionSearch, SearchState, ledger_of
from microbot_ocp.planning.search._settings import SEARCH, sparing
from microbot_ocp.planning.search._strategies import (
    STRATEGIES,
    best_of,
    is_enough,
    rank,
    sample,
    settled,
)
from microbot_ocp.planning.task import (
    provenance_of,
    rates_at_reversals,
    verdict,
    with_locked_joints_held,
)

KEEPS_LIMITS = "Returned is {}: it keeps every limit, but others may be faster."


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


def motion_through(search: MotionSearch) -> Motion:
    """The fastest motion through via points, or what is known at least."""
    begin, problem = time.perf_counter(), search.problem
    assert isinstance(problem, FreeProblem)
    with sparing() if problem.slows_down else nullcontext():
        found = fastest(search)
        motion = motion_of_answer(found)
    solution = found.answer.solution
    if problem.slows_down and solution.status is not Status.INTERRUPTED:
        motion = _within_limits(found, motion)
        starts = sample(search, found.state)
        if motion.solved and not settled(starts, search.settings):
            motion = _unsettled(motion)
    if not search.settings.switching_times or not motion.solved:
        return motion
    held: Any = with_locked_joints_held(problem.family).robot
    guesses = problem.guesses(solution)
    exact = in_arcs(problem.family, held, motion, guesses, search.progress)
    spent = time.perf_counter() - begin + search.kernel_time
    return replace(exact, provenance={**exact.provenance, "wall_time": spent})


def motion_of_answer(found: Fastest, **more: Any) -> Motion:
    """The best answer as a motion, with the whole search in its provenance."""
    search, state, solution = found.search, found.state, found.answer.solution
    problem, excess = search.problem, search.problem.excess(solution)
    outcome = verdict(problem.family, solution, excess, search.settings.limit_tolerance)
    outcome["advice"] += problem.scale.active_bounds([p.duration for p in solution.phases])
    outcome["advice"] += rates_at_reversals(problem.family, solution)
    relaxed = next((a.relaxed for a in state.answers if a.relaxed is not None), None)
    if relaxed is not None and not (solution.status.solved or deadline.over()):
        outcome |= judged(relaxed, problem.family, outcome["advice"])
    starts = starts_of(state)
    optima = sorted({round(s["duration"], 3) for s in starts if s["status"] == "solved"})
    provenance = provenance_of(
        "free time-optimal motion, multiple shooting on the inverse dynamics",
        outcome,
        solution,
        found.wall_time + search.kernel_time,
        found.answer.smoothing,
        smoothing_cost=found.smoothing_cost,
        optima_seen=optima,
        starts=starts,
        solves=[solve for answer in state.answers for solve in answer.solves],
        ledger=ledger_of(state, found.answer).as_dicts(),
        kernel_time=search.kernel_time,
        **({"least_effort": found.calmer.as_dict()} if found.calmer else {}),
        **more,
    )
    note = _note(outcome, len(problem.via), len(starts), optima)
    return problem.motion(solution, provenance, note + further_notes(found))


def starts_of(state: SearchState, rested: float = 0.0) -> list[dict[str, Any]]:
    """What every initial guess led to, for the provenance; dwells last ``rested`` s."""
    return [
        {
            "start": answer.start,
            "status": str(answer.solution.status),
            "duration": answer.solution.duration + rested,
        }
        for answer in state.of("start", "known way")
        if answer.before is None or answer.strategy != "start"
    ]


def further_notes(found: Fastest) -> str:
    """What less effort saves, and what the smoothing costs where it is much."""
    solution, note = found.answer.solution, found.calmer.note if found.calmer else ""
    share = found.smoothing_cost / solution.duration
    if not solution.status.solved or share < SEARCH.smoothing_told:
        return note
    return note + f"; without smoothing of the jerk it could be about {100 * share:.1g} % faster"


def _within_limits(found: Fastest, motion: Motion) -> Motion:
    """A motion that keeps the limits in the place of one that does not, or that is slower.

    A solution slowed down by no more than two meshes may differ counts as solved.
    """
    search, solution = found.search, found.answer.solution
    problem = search.problem
    assert isinstance(problem, FreeProblem)
    told, kept = motion.provenance, motion.solved
    kept = kept and not is_enough(problem, search.settings, solution)
    # not even time may be left to slow it down
    if not kept and (problem.way is None or not deadline.over()):
        problem.slowed(solution)
    slower = [problem.way] if problem.way else []
    slower += [Slowed(own, _name(a.solution is solution)) for a, own in _slowed(search, found)]
    if not kept and not slower and problem.known:
        slower = [problem.known]
    if not slower:
        return motion
    known, made_from = min(slower, key=lambda own: own.motion.duration)
    more = known.duration / solution.duration - 1.0
    if kept and (found.calmer or more >= -WORSE):
        return motion
    status, advice, note = told["status"], told["advice"], motion.note
    if status != Status.TIME_LIMIT and solution.status.solved and abs(more) <= WORSE:
        status = Status.SOLVED
    elif status in (Status.LIMITS_EXCEEDED, Status.SOLVED):
        status, advice = Status.NOT_ACCEPTED, Status.NOT_ACCEPTED.sentence
    elif status == Status.INFEASIBLE:  # there is a motion
        status, advice = Status.FAILED, "The search found no motion within the limits."
    if status == Status.SOLVED:
        advice = Status.SOLVED.sentence
        note += f"; slowed down by {100 * more:.2g} % where it exceeded limits"
    else:
        advice += "\n" + KEEPS_LIMITS.format(made_from)
        note = f"not solved: {advice}"
    now = {"status": str(status), "advice": advice, "made_from": made_from}
    now["excess"] = largest_excess(problem.family, known)
    return replace(known, provenance={**told, **now}, note=note)


def _slowed(search: MotionSearch, found: Fastest) -> list[tuple[MotionAnswer, Motion]]:
    """Answers that were slowed down so far, and the motions."""
    problem = search.problem
    assert isinstance(problem, FreeProblem)
    rows = []
    for answer in (*found.state.answers, found.answer):
        motion = problem.slowed_before(answer.solution)
        if motion is not None:
            rows.append((answer, motion))
    return rows


def _name(is_answer: bool) -> str:
    made = "the motion found" if is_answer else "a coarser motion"
    return f"{made}, slowed down at limits"


def _unsettled(motion: Motion) -> Motion:
    """The motion, which is not the fastest where further starts would lead to better ones."""
    told = motion.provenance
    advice = (
        f"Of {len(told['starts'])} starts nearly every one led to another optimum, so that others "
        "may well be faster: allow more tries, or take another seed."
    )
    told = {**told, "status": str(Status.LOCAL_OPTIMUM), "advice": advice}
    return replace(motion, provenance=told, note=f"not solved: {advice}")


def _note(
    outcome: dict[str, Any], via_count: int, start_count: int, optima: Sequence[float]
) -> str:
    if outcome["status"] != "solved":
        return f"not solved: {outcome['advice']}"
    durations = ", ".join(f"{duration:.3f}" for duration in optima)
    passed = {2: "", 3: "via point passed at any velocity; "}
    return (
        f"{passed.get(via_count, 'via points passed at any velocity; ')}{start_count} starts ended "
        f"at {durations} s on the coarse mesh, the best was refined"
    )
