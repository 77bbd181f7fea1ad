"""The queue of candidates: which are raised, and which one is the best."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from hypothesis import given, strategies as st

from microbot_ocp._base import deadline
from microbot_ocp.planning.search._queue import GAIN, Level, Queue


@dataclass(frozen=True)
class Way:
    """A way whose duration is known on every level; None for a level that fails."""

    durations: tuple[float | None, ...]
    level: Level = Level.BOUND
    keeps_limits: bool = True

    @property
    def duration(self) -> float:
        return self.durations[self.level] or 0.0


def searched(first: list[Way], most: float = np.inf) -> tuple[list[Way], list[Way]]:
    """Return the finished ways, and those that were raised by a level."""
    queue, raised = Queue(first, most), list[Way]()
    for way in queue:
        raised.append(way)
        level = Level(way.level + 1)
        if way.durations[level] is None:
            continue
        fails = level is Level.FINISHED and way.durations[level] == FAILS
        queue.put([replace(way, level=level, keeps_limits=not fails)], before=way)
    return queue.finished, raised


FAILS = 99.0  # duration of a finished way that exceeds its limits
bounds = st.floats(1.0, 10.0)


@st.composite
def ways(draw: st.DrawFn) -> Way:
    """Return a way with a bound, an estimate from below, and gains no larger than expected."""
    final = draw(bounds)
    split = final / (1.0 - draw(st.floats(0.0, GAIN[Level.SPLIT])))
    full = split / (1.0 - draw(st.floats(0.0, GAIN[Level.FULL])))
    coarse = full / (1.0 - draw(st.floats(0.0, 0.5 * GAIN[Level.COARSE])))
    timed = draw(st.floats(0.3, 1.0)) * final
    return Way((draw(st.floats(0.1, 1.0)) * timed, timed, coarse, full, split, final))


@given(st.lists(ways(), min_size=1, max_size=8))
def test_the_fastest_is_found_and_slow_ones_are_not_raised(some):
    finished, raised = searched(some)
    best = min(way.durations[Level.FINISHED] for way in some)
    assert min(way.duration for way in finished) == best
    for way in raised:
        assert way.level <= Level.COARSE or 0.98 * (way.durations[Level.COARSE] or 0.0) <= best
    refined = {way.durations for way in raised if way.level is Level.BOUND}
    assert all(way.durations in refined for way in some if way.duration < best)


@given(st.lists(ways(), min_size=2, max_size=5, unique=True))
def test_a_way_that_fails_hides_no_other(some):
    fast = min(some, key=lambda way: way.durations[Level.FINISHED])
    others = [way for way in some if way is not fast]
    for fails in (None, FAILS):
        failing = replace(fast, durations=(*fast.durations[:-1], fails))
        finished = [way for way in searched([failing, *others])[0] if way.keeps_limits]
        best = min(way.durations[Level.FINISHED] for way in others)
        assert min(way.duration for way in finished) == best


def test_with_a_longest_duration_all_shorter_ways_are_finished():
    some = [Way((1.0, 1.0, t, t, t, t)) for t in (2.0, 3.0, 4.0)]
    finished, _ = searched(some, most=3.5)
    assert [way.duration for way in finished] == [2.0, 3.0]


def test_at_the_time_limit_the_most_accurate_way_is_finished():
    near = Way((1.0,) * 6, level=Level.COARSE)
    with deadline.within(1e-9):
        finished, raised = searched([Way((0.5,) * 6), near])
    assert [way.duration for way in finished] == [1.0]
    assert {way.durations for way in raised} == {near.durations}


def test_nothing_comes_of_nothing():
    assert searched([]) == ([], [])
    assert searched([Way((1.0, None))])[0] == []
