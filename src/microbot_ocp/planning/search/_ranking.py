"""What answers of a search are worth: which is better, which are enough."""

from __future__ import annotations

from collections.abc import Sequence

from microbot_ocp.ocp import Solution
from microbot_ocp.planning.search._problem import MotionProblem
from microbot_ocp.planning.search._search import MotionAnswer, MotionSearch
from microbot_ocp.planning.search._settings import SEARCH, TimeOptimalSettings


def is_enough(problem: MotionProblem, settings: TimeOptimalSettings, solution: Solution) -> bool:
    """Return whether a motion on a large mesh is slowed down, by next to nothing, not refined."""
    size = sum(phase.mesh.size - 1 for phase in solution.phases) * problem.family.robot.joint_count
    if size < SEARCH.large or not solution.status.solved or settings.slack:
        return False
    if max(float(e.max()) for e in problem.excess(solution)) <= settings.limit_tolerance:
        return False
    slower = problem.slowed(solution)
    return slower is not None and slower.duration <= (1.0 + SEARCH.enough) * solution.duration


def rank(search: MotionSearch, solution: Solution) -> tuple[bool, float]:
    """Return what keeps its limits first, then what is faster."""
    valid = solution.status.solved and (
        search.worst(solution) <= search.settings.limit_tolerance
        or (search.problem.is_free and is_enough(search.problem, search.settings, solution))
    )
    return not valid, solution.duration


def by_promise(answers: Sequence[MotionAnswer]) -> list[MotionAnswer]:
    """Give the different optima among coarse answers, the fastest first; of the same the first."""
    different = list[MotionAnswer]()
    for coarse in answers:
        if coarse.solved and not any(
            abs(coarse.solution.duration - other.solution.duration)
            <= SEARCH.same * other.solution.duration
            for other in different
        ):
            different.append(coarse)
    return sorted(different, key=lambda coarse: coarse.solution.duration)


def settled(answers: Sequence[MotionAnswer], settings: TimeOptimalSettings) -> bool:
    """Return whether another start would more likely than not lead to what has been seen before.

    After w different outcomes of N starts it leads to a new one with the probability
    w (w + 1) / (N (N - 1)) (Boender and Rinnooy Kan, Math. Programming 37, 1987, 59-80). What was
    carried on from a coarser mesh is an outcome, but no start.
    """
    solved, count = sum(answer.solved for answer in answers), len(answers)
    if solved == 0 or settings.starts == 1:  # of a single start nothing is asked
        return solved > 0
    different = len(by_promise(answers)) + (solved < count)
    count = sum(answer.before is None for answer in answers)
    return 2 * different * (different + 1) <= count * (count - 1)
