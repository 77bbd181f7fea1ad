"""The best of all orders of a few stops, decided by coarse answers.

Every order is timed from rest to rest first, along the straight joint paths between its stops or
those around the obstacles. From the fastest of these on, orders are solved on a coarse mesh, unless
a bound or what their timed paths could save at most says that they are slower. Only orders
whose coarse answers differ from the best by less than coarse answers are off are refined.
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
from microbot_ocp.planning.search._through_stops import Asked, fastest_through, problem_of
from microbot_ocp.planning.task import CELL_TIME_LIMIT, Segment, Task, one_remark

MOST_ORDERED = 7  # stops of which every order is looked at
# Coarse answers of one task differ from the refined ones by much the same share (0.9 to 1.3 % for
# six orders of a Puma among obstacles, 0.2 to 0.5 % for six of a Microbot): orders farther apart
# than this are told apart by them
ACCURACY = 0.01  # of the usual coarse mesh
FASTER = 0.5  # of timed paths, what the fastest motion from rest to rest is hoped to take at least

Places = tuple[int, ...]


class Candidate(Protocol):
    """One order of the stops, with what it takes to better and better accuracy, s.

    Attributes
    ----------
    rested, hoped : float
        The best timing from rest to rest, and what it is hoped that a motion takes at least;
        infinite where no way was found.
    """

    rested: float
    hoped: float

    def coarse_duration(self, beaten: float) -> float:
        """Give that of the best coarse answer; ways not faster than ``beaten`` are left out."""
        ...

    def motion(self) -> Motion:
        """Return the refined motion."""
        ...


def solve_stops(asked: Asked) -> Motion:
    """Do as :func:`microbot_ocp.time_optimal`, of stops."""
    if asked.order == "given":
        return fastest_through(asked.task(), asked.settings, asked.progress, asked.duration)
    tasks = tasks_in_orders(asked)
    with asked.settings.within(CELL_TIME_LIMIT):
        return best_order(asked, tasks, partial(_Alone, asked))


def tasks_in_orders(asked: Asked) -> dict[Places, Task]:
    """Return the tasks of all orders of some stops, by the places that stops had.

    Raises
    ------
    InputError
        As of :func:`task_of`; more stops than all orders are looked at of.
    """
    asked.task()  # before any order of it is looked at
    orders = _orders(len(asked.stops), asked.cycle, asked.segments)
    return {places: asked.task(places) for places in orders}


def _orders(count: int, cycle: bool, segments: Sequence[Segment] | None) -> list[Places]:
    """Return orders of stops: a cycle begins with its first, another task keeps its first and last.

    Two stops with a line, circle or joint line between them follow one another in every order.

    Raises
    ------
    InputError
        More stops than all orders are looked at of.
    """
    if count > MOST_ORDERED:
        raise InputError(f"order is free for at most {MOST_ORDERED} stops, not {count}")
    tied = {(k, (k + 1) % count) for k, kind in enumerate(segments or ()) if kind is not None}
    between = itertools.permutations(range(1, count if cycle else count - 1))
    orders = [(0, *p) if cycle else (0, *p, count - 1) for p in between]
    return [order for order in orders if tied <= set(itertools.pairwise((*order, 0)))]


def best_order(
    asked: Asked, tasks: Mapping[Places, Task], candidate: Callable[[Task], Candidate]
) -> Motion:
    """Return the best of several orders of the stops.

    Where a duration is given the orders that can be done in it are all refined: the best is
    the one of least effort. An order that no branch of the arm can follow is not one of them.

    Raises
    ------
    InputError
        No order can be done.
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
            row["rested"] = there[places].rested
        except InputError as problem:
            refused, row["status"] = problem, str(problem)
    if not there:
        assert refused is not None
        raise refused
    ranked = sorted(there, key=lambda p: (there[p].rested, rows[p]["bound"], p))
    coarse: dict[Places, float] = {}
    usual, duration = SEARCH.explore_mesh, asked.duration
    accurate = 1.0 + ACCURACY * max(1.0, usual / (asked.settings.mesh or usual)) ** 2
    for places in ranked:
        best = min(coarse.values(), default=np.inf)
        most = best if duration is None else duration
        least = max(rows[places]["bound"], there[places].hoped if np.isfinite(best) else 0.0)
        if coarse and (least >= accurate * most or deadline.over()):
            continue
        try:
            coarse[places] = there[places].coarse_duration(accurate * most)
        except InputError as problem:
            refused, rows[places]["status"] = problem, str(problem)
            continue
        if np.isfinite(coarse[places]):
            rows[places] |= {"coarse": coarse[places], "status": "coarse"}
        asked.progress(f"order {_named(places)}: {coarse[places]:.4f} s on the coarse mesh")
    if not coarse:
        assert refused is not None
        raise refused
    most = accurate * (min(coarse.values()) if duration is None else duration)
    return _refined(asked, rows, there, coarse, most)


def _refined(
    asked: Asked,
    orders: dict[Places, dict[str, Any]],
    there: Mapping[Places, Candidate],
    coarse: Mapping[Places, float],
    most: float,
) -> Motion:
    """Return the best of the orders whose coarse answers take at most so long, s."""
    near = sorted(coarse, key=lambda p: (coarse[p], there[p].rested, p))
    near = [places for places in near if coarse[places] <= most] or near[:1]
    best: Motion | None = None

    def rank(motion: Motion) -> tuple[bool, float, float]:
        calmed = {} if asked.duration is None else motion.provenance.get("least_effort", {})
        return not motion.solved, calmed.get("effort", np.inf), motion.duration

    for places in near:
        if best is not None and deadline.over():
            break
        motion = there[places].motion()
        orders[places] |= {"duration": motion.duration, "status": str(motion.status)}
        asked.progress(f"order {_named(places)}: {motion.duration:.4f} s, {motion.status}")
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


def rested_of(task: Task, durations: Sequence[float | None]) -> float:
    """Return what segments take from rest to rest together, s; those that are not known take
    nothing.
    """
    return sum(duration or 0.0 for duration in durations) + float(task.dwells.sum())


def hoped_of(task: Task, durations: Sequence[float | None]) -> float:
    """Return what a motion may take at least, s, whose segments take so long from rest to rest.

    Where the arm does not rest between segments it takes at least the root of the sum of their
    squares, as at constant accelerations along one straight line.
    """
    runs: list[list[float]] = [[]]
    for k, duration in enumerate(durations):
        runs[-1].append(FASTER * (duration or 0.0))
        if task.at_rest(k + 1):
            runs.append([])
    if task.cycle and not task.at_rest(0) and len(runs) > 1:
        runs[0] = [*runs.pop(), *runs[0]]
    return sum(float(np.linalg.norm(run)) for run in runs) + float(task.dwells.sum())


class _Alone:
    """An order of stops without obstacles."""

    def __init__(self, asked: Asked, task: Task) -> None:
        self._asked, self._task = asked, task
        estimates: list[tuple[float, float, Way]] = []
        for way in ways_through(task):
            timings = segment_timings(task, way, asked.settings.compiled)
            times = [None if shape is None else shape.duration for shape in timings]
            estimates.append((rested_of(task, times), hoped_of(task, times), way))
        estimates.sort(key=lambda entry: entry[0])
        self._ways = [way for _, _, way in estimates]
        self.rested, self.hoped = estimates[0][0], min(hoped for _, hoped, _ in estimates)

    def coarse_duration(self, beaten: float) -> float:
        asked = self._asked
        problem = problem_of(self._task, asked.settings, asked.duration, self._ways)
        self._search = search_of(problem, asked.progress)
        least = replace(problem, beaten=beaten - problem.rested, briefly=True)
        self._state = replace(self._search, problem=least).run(STRATEGIES[:1])
        solved = [a.solution.duration for a in self._state.of("start") if a.solved]
        return min(solved, default=np.inf) + problem.rested

    def motion(self) -> Motion:
        return motion_from(fastest(self._search, self._state, duration=self._asked.duration))
