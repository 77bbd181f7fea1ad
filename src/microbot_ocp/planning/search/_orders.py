"""The best of all orders of a few stops.

Every order is a candidate of the queue: bounded by the velocity limits, timed from rest to rest
along straight joint paths or paths around the obstacles, solved on a coarse mesh, refined.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Protocol

import numpy as np

from microbot_ocp._base.checks import InputError
from microbot_ocp.motion import Motion
from microbot_ocp.planning.search._branches import Way, least_duration, ways_through
from microbot_ocp.planning.search._queue import Level, Queue
from microbot_ocp.planning.search._refinement import search_of
from microbot_ocp.planning.search._result import LEFT_OUT, fastest, motion_from
from microbot_ocp.planning.search._starts import explore, segment_timings
from microbot_ocp.planning.search._through_stops import (
    SolveRequest,
    fastest_through,
    problem_of,
    with_load_noted,
)
from microbot_ocp.planning.task import CELL_TIME_LIMIT, Segment, Task, one_remark

MOST_ORDERED = 7  # largest number of stops in free order: 5040 orders
OPTIMISTIC_SHARE = (
    0.5  # assumed lower bound on the optimum, as a fraction of the rest-to-rest timing
)

Places = tuple[int, ...]


class OrderedTask(Protocol):
    """A task with its stops in one order."""

    @property
    def rest_duration(self) -> float:
        """Best timing from rest to rest, s; infinite if no way was found."""
        ...

    @property
    def optimistic_duration(self) -> float:
        """Assumed lower bound on the duration of a motion, s; infinite if no way was found."""
        ...

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
    with request.settings.within(CELL_TIME_LIMIT) as limit:
        motion = best_order(request, tasks, partial(_OrderWithoutObstacles, request))
        return with_load_noted(motion, limit)


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
    # Orders that separate two stops with a segment between them are left out; the first stop
    # follows the last in a cycle.
    tied = {(k, (k + 1) % count) for k, kind in enumerate(segments or ()) if kind is not None}
    between = itertools.permutations(range(1, count if cycle else count - 1))
    orders = [(0, *p) if cycle else (0, *p, count - 1) for p in between]
    return [order for order in orders if tied <= set(itertools.pairwise((*order, 0)))]


@dataclass(frozen=True, eq=False)
class _Order:
    """An order of the stops as a candidate of the queue, by their original places."""

    places: Places
    level: Level
    duration: float
    task: OrderedTask | None = None
    motion: Motion | None = None

    @property
    def keeps_limits(self) -> bool:
        """False if nothing was found."""
        return np.isfinite(self.duration) if self.motion is None else self.motion.solved


def best_order(
    request: SolveRequest, tasks: Mapping[Places, Task], ordered: Callable[[Task], OrderedTask]
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
    for places, task in tasks.items():
        row = {"order": list(places), "bound": least_duration(task), "status": LEFT_OUT}
        rows[places] = row | {"coarse": None, "duration": None}
    refused: list[InputError] = []

    first = [_Order(places, Level.BOUND, row["bound"]) for places, row in rows.items()]
    queue = Queue(first, np.inf if request.duration is None else request.duration)
    for order in queue:
        task, least = tasks[order.places], queue.duration_to_beat
        try:
            queue.put([_raised(request, task, order, ordered, rows, least)], before=order)
        except InputError as problem:
            refused.append(problem)
            rows[order.places]["status"] = str(problem)
    if not queue.finished:
        raise refused[0]

    def rank(order: _Order) -> tuple[bool, float, float]:
        assert order.motion is not None
        effort = order.motion.provenance.get("least_effort", {}).get("effort", np.inf)
        calmed = np.inf if request.duration is None else effort
        return not order.motion.solved, calmed, order.motion.duration

    best = min(queue.finished, key=rank)
    return _with_orders(best, list(rows.values()))


def _raised(
    request: SolveRequest,
    task: Task,
    order: _Order,
    ordered: Callable[[Task], OrderedTask],
    rows: Mapping[Places, dict[str, Any]],
    best: float,
) -> _Order:
    """Return an order on the next level, and store its durations in its row."""
    row, name = rows[order.places], _named(order.places)
    if order.task is None:
        timed = ordered(task)
        row["rested"] = timed.rest_duration
        duration = max(order.duration, timed.optimistic_duration)
        return replace(order, level=Level.TIMED, duration=duration, task=timed)
    if order.level is Level.TIMED:
        # A way whose lower bound exceeds a coarse answer is not solved.
        known = [other["coarse"] for other in rows.values() if other["coarse"] is not None]
        coarse = order.task.coarse_duration(min([best, *known]))
        if np.isfinite(coarse):
            row |= {"coarse": coarse, "status": "coarse"}
        request.progress(f"order {name}: {coarse:.4f} s on the coarse mesh")
        return replace(order, level=Level.COARSE, duration=coarse)
    motion = order.task.motion()
    row |= {"duration": motion.duration, "status": str(motion.status)}
    request.progress(f"order {name}: {motion.duration:.4f} s, {motion.status}")
    return replace(order, level=Level.FINISHED, duration=motion.duration, motion=motion)


def _with_orders(best: _Order, rows: list[dict[str, Any]]) -> Motion:
    """Return the motion of an order with the record of all orders."""
    motion, all_orders = best.motion, len(rows)
    assert motion is not None
    rows = [row for row in rows if row["status"] != LEFT_OUT]
    rows.sort(key=lambda row: (row["duration"] or np.inf, row["coarse"] or np.inf))
    coarse, refined = (sum(row[key] is not None for row in rows) for key in ("coarse", "duration"))
    counts = f"{coarse} solved on a coarse mesh, {refined} of them refined"
    given = {"order": list(best.places), "orders": rows, "orders_left_out": all_orders - len(rows)}
    provenance = {**motion.provenance, **given}
    remark = one_remark(f"order {_named(best.places)} of {all_orders}, {counts}", motion.remark)
    return replace(motion, provenance=provenance, remark=remark)


def _named(places: Sequence[int]) -> str:
    return "-".join(str(k + 1) for k in places)


def rest_duration_of(task: Task, durations: Sequence[float | None]) -> float:
    """Return the time of segments from rest to rest, s, with dwells; an unknown one counts zero."""
    return sum(duration or 0.0 for duration in durations) + float(task.dwells.sum())


def optimistic_duration_of(
    task: Task, durations: Sequence[float | None], share: float = OPTIMISTIC_SHARE
) -> float:
    """Return an estimate from below of a motion's duration, s, from its rest-to-rest timings.

    A segment of the motion takes at least a share of its timing.

    Segments without rest between them take at least the root of the sum of their squares: at a
    constant acceleration along a straight line the squares of durations are proportional to
    lengths, which add.
    """
    runs: list[list[float]] = [[]]
    for k, duration in enumerate(durations):
        runs[-1].append(share * (duration or 0.0))
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
        self._state = explore(replace(self._search, problem=least))
        solved = [a.solution.duration for a in self._state.starts if a.solved]
        return min(solved, default=np.inf) + problem.dwell_time

    def motion(self) -> Motion:
        return motion_from(fastest(self._search, self._state, duration=self._request.duration))
