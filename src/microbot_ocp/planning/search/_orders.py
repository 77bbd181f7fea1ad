"""The best of all orders of a few stops, compared on a coarse mesh.

Every order is first timed from rest to rest, along straight joint paths between its stops or along
paths around the obstacles. Orders are then solved on a coarse mesh, the fastest timing first,
unless a lower bound or an optimistic estimate from the timed paths excludes them. Orders within the
error of coarse answers of the best one are refined.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Protocol

import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import InputError
from microbot_ocp.motion import Motion
from microbot_ocp.planning.search._branches import Way, least_duration, ways_through
from microbot_ocp.planning.search._result import LEFT_OUT, fastest, motion_from
from microbot_ocp.planning.search._settings import SEARCH
from microbot_ocp.planning.search._starts import segment_timings
from microbot_ocp.planning.search._strategies import STRATEGIES, search_of
from microbot_ocp.planning.search._through_stops import SolveRequest, fastest_through, problem_of
from microbot_ocp.planning.task import CELL_TIME_LIMIT, Segment, Task, one_remark

MOST_ORDERED = 7  # largest number of stops in free order: 5040 orders
# Coarse and refined durations of one task differ by a common share (0.9 to 1.3 % for six orders of
# a Puma among obstacles, 0.2 to 0.5 % for six of a Microbot), so a larger difference between coarse
# durations decides between two orders.
ACCURACY = 0.01  # relative, on the usual coarse mesh
OPTIMISTIC_SHARE = (
    0.5  # assumed lower bound on the optimum, as a fraction of the rest-to-rest timing
)

Places = tuple[int, ...]


class Candidate(Protocol):
    """One order of the stops, with durations of increasing accuracy.

    Attributes
    ----------
    rest_duration : float
        Best timing from rest to rest, s; infinite if no way was found.
    optimistic_duration : float
        Assumed lower bound on the duration of a motion, s; infinite if no way was found.
    """

    rest_duration: float
    optimistic_duration: float

    def coarse_duration(self, duration_to_beat: float) -> float:
        """Return the best coarse duration, s; ways above ``duration_to_beat``, s, are skipped."""
        ...

    def motion(self) -> Motion:
        """Return the refined motion."""
        ...


def solve_stops(request: SolveRequest) -> Motion:
    """Solve a task with stops, as :func:`microbot_ocp.time_optimal` does."""
    if request.order == "given":
        return fastest_through(request.task(), request.settings, request.progress, request.duration)
    tasks = tasks_in_orders(request)
    with request.settings.within(CELL_TIME_LIMIT):
        return best_order(request, tasks, partial(_OrderWithoutObstacles, request))


def tasks_in_orders(request: SolveRequest) -> dict[Places, Task]:
    """Return the tasks of all orders of some stops, by the original places of the stops.

    Raises
    ------
    InputError
        More stops than all orders allow, and errors of :func:`task_of`.
    """
    request.task()  # checks the input before any order is tried
    orders = _orders(len(request.stops), request.cycle, request.segments)
    return {places: request.task(places) for places in orders}


def _orders(count: int, cycle: bool, segments: Sequence[Segment] | None) -> list[Places]:
    """Return orders of stops: a cycle keeps its first stop, another task its first and last.

    Two stops with a line, circle or joint line between them stay neighbours in every order.

    Raises
    ------
    InputError
        More stops than all orders allow.
    """
    if count > MOST_ORDERED:
        raise InputError(f"order is free for at most {MOST_ORDERED} stops, not {count}")
    tied = {(k, (k + 1) % count) for k, kind in enumerate(segments or ()) if kind is not None}
    between = itertools.permutations(range(1, count if cycle else count - 1))
    orders = [(0, *p) if cycle else (0, *p, count - 1) for p in between]
    return [order for order in orders if tied <= set(itertools.pairwise((*order, 0)))]


def best_order(
    request: SolveRequest, tasks: Mapping[Places, Task], candidate: Callable[[Task], Candidate]
) -> Motion:
    """Return the best of several orders of the stops.

    With a given duration all orders that meet it are refined, and the best is the one of least
    effort. An order that no branch of the arm can follow is excluded.

    Raises
    ------
    InputError
        No order is feasible.
    """
    rows: dict[Places, dict[str, Any]] = {}
    there: dict[Places, Candidate] = {}
    refused: InputError | None = None
    for places, task in tasks.items():
        row = rows[places] = {"order": list(places), "bound": least_duration(task)}
        row |= {"coarse": None, "duration": None, "status": LEFT_OUT}
        if there and deadline.over():
            continue
        try:
            there[places] = candidate(task)
            row["rested"] = there[places].rest_duration
        except InputError as problem:
            refused, row["status"] = problem, str(problem)
    if not there:
        assert refused is not None
        raise refused
    # The most promising orders come first: their coarse durations exclude others.
    ranked = sorted(there, key=lambda p: (there[p].rest_duration, rows[p]["bound"], p))
    coarse: dict[Places, float] = {}
    usual, duration = SEARCH.explore_mesh, request.duration
    # The error of a coarse mesh of N intervals is proportional to 1 / N^2.
    accurate = 1.0 + ACCURACY * max(1.0, usual / (request.settings.mesh or usual)) ** 2
    for places in ranked:
        best = min(coarse.values(), default=np.inf)
        most = best if duration is None else duration
        least = max(
            rows[places]["bound"], there[places].optimistic_duration if np.isfinite(best) else 0.0
        )
        if coarse and (least >= accurate * most or deadline.over()):
            continue
        try:
            coarse[places] = there[places].coarse_duration(accurate * most)
        except InputError as problem:
            refused, rows[places]["status"] = problem, str(problem)
            continue
        if np.isfinite(coarse[places]):
            rows[places] |= {"coarse": coarse[places], "status": "coarse"}
        request.progress(f"order {_named(places)}: {coarse[places]:.4f} s on the coarse mesh")
    if not coarse:
        assert refused is not None
        raise refused
    most = accurate * (min(coarse.values()) if duration is None else duration)
    return _refined(request, rows, there, coarse, most)


def _refined(
    request: SolveRequest,
    orders: dict[Places, dict[str, Any]],
    there: Mapping[Places, Candidate],
    coarse: Mapping[Places, float],
    most: float,
) -> Motion:
    """Return the best of the orders whose coarse duration is at most ``most``, s."""
    near = sorted(coarse, key=lambda p: (coarse[p], there[p].rest_duration, p))
    near = [places for places in near if coarse[places] <= most] or near[:1]
    best: Motion | None = None

    def rank(motion: Motion) -> tuple[bool, float, float]:
        calmed = {} if request.duration is None else motion.provenance.get("least_effort", {})
        return not motion.solved, calmed.get("effort", np.inf), motion.duration

    for places in near:
        if best is not None and deadline.over():
            break
        motion = there[places].motion()
        orders[places] |= {"duration": motion.duration, "status": str(motion.status)}
        request.progress(f"order {_named(places)}: {motion.duration:.4f} s, {motion.status}")
        if best is None or rank(motion) < rank(best):
            best = replace(motion, provenance={**motion.provenance, "order": list(places)})
    assert best is not None
    refined = [row for row in orders.values() if row["duration"] is not None]
    counts = f"{len(coarse)} solved on a coarse mesh, {len(refined)} of them refined"
    rows = [row for row in orders.values() if row["status"] != LEFT_OUT]
    rows.sort(key=lambda row: (row["duration"] or np.inf, row["coarse"] or np.inf))
    left_out, taken = len(orders) - len(rows), _named(best.provenance["order"])
    provenance = {**best.provenance, "orders": rows, "orders_left_out": left_out}
    remark = one_remark(f"order {taken} of {len(orders)}, {counts}", best.remark)
    return replace(best, provenance=provenance, remark=remark)


def _named(places: Sequence[int]) -> str:
    return "-".join(str(k + 1) for k in places)


def rest_duration_of(task: Task, durations: Sequence[float | None]) -> float:
    """Return the time of segments from rest to rest, s, with dwells; an unknown one counts zero."""
    return sum(duration or 0.0 for duration in durations) + float(task.dwells.sum())


def optimistic_duration_of(task: Task, durations: Sequence[float | None]) -> float:
    """Return an estimate from below of a motion's duration, s, from its rest-to-rest timings.

    Segments without rest between them take at least the root of the sum of their squares: at a
    constant acceleration along a straight line the squares of durations are proportional to
    lengths, which add.
    """
    runs: list[list[float]] = [[]]
    for k, duration in enumerate(durations):
        runs[-1].append(OPTIMISTIC_SHARE * (duration or 0.0))
        if task.at_rest(k + 1):
            runs.append([])
    if task.cycle and not task.at_rest(0) and len(runs) > 1:
        runs[0] = [*runs.pop(), *runs[0]]
    return sum(float(np.linalg.norm(run)) for run in runs) + float(task.dwells.sum())


class _OrderWithoutObstacles:
    """One order of stops without obstacles."""

    def __init__(self, request: SolveRequest, task: Task) -> None:
        self._request, self._task = request, task
        estimates: list[tuple[float, float, Way]] = []
        for way in ways_through(task):
            timings = segment_timings(task, way, request.settings.compiled)
            times = [None if shape is None else shape.duration for shape in timings]
            estimates.append(
                (rest_duration_of(task, times), optimistic_duration_of(task, times), way)
            )
        estimates.sort(key=lambda entry: entry[0])
        self._ways = [way for _, _, way in estimates]
        self.rest_duration, self.optimistic_duration = (
            estimates[0][0],
            min(optimistic for _, optimistic, _ in estimates),
        )

    def coarse_duration(self, duration_to_beat: float) -> float:
        request = self._request
        problem = problem_of(self._task, request.settings, request.duration, self._ways)
        self._search = search_of(problem, request.progress)
        least = replace(
            problem, duration_to_beat=duration_to_beat - problem.dwell_time, for_comparison=True
        )
        self._state = replace(self._search, problem=least).run(STRATEGIES[:1])
        solved = [a.solution.duration for a in self._state.of("start") if a.solved]
        return min(solved, default=np.inf) + problem.dwell_time

    def motion(self) -> Motion:
        return motion_from(fastest(self._search, self._state, duration=self._request.duration))
