"""Which limits act when, read from a solution on a mesh: every control and limit by itself.

Two controls may switch within an interval of one another, so the arcs of all together say little
where they are short. Along the time every single one is at its upper side, at its lower side or at
neither. Where it passes from one side to the other within a few intervals, its mean over them says
when; where one limit ceases to act another begins. The arcs are what lies between these events.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.ocp.arcs._cutter import Limit, Stretch, controls_at_bounds, limits_of
from microbot_ocp.ocp.solution import PhaseSolution
from microbot_ocp.ocp.verification import phase_layout

LONGEST_SWITCH = 3  # intervals between two sides that count as a switch, not as an arc of its own
TAKING_OVER = 3  # intervals between the end of one limit and the begin of another that replaces it
UNDECIDED = 3  # intervals in which less acts than on both sides: the smeared end of two arcs
LEAST_SHARE = 0.05  # of an interval: less at the other side is none
TOGETHER = 0.02  # of an interval: what is nearer happens at once


@dataclass(frozen=True)
class _Span:
    """What acts between two places, in intervals."""

    begin: float
    end: float
    signature: tuple[int, ...]

    @property
    def acting(self) -> int:
        return sum(map(abs, self.signature))


@dataclass
class _Event:
    """A side that begins at a place in intervals; which it was before says the event before."""

    place: float
    column: int
    side: int


def arcs_between_events(phase: PhaseSolution) -> tuple[list[Stretch], list[Limit]]:
    """Arcs of a phase, be they ever so short, and the limits that act somewhere.

    The signature of an arc is the sides of all control components, then of all limits.
    """
    declared = phase_layout(phase).phase
    limits = limits_of(phase, declared, mixed=True)
    sides, shares = controls_at_bounds(phase, declared)
    controls = len(sides)
    sides += [limit.sides for limit in limits]
    shares += [limit.shares for limit in limits]
    if not sides:
        return [Stretch(0.0, 1.0, (), phase.mesh.size - 1)], limits
    table = np.array(sides).T
    passive = np.array([share is None for share in shares])
    events: list[_Event] = []
    for column, (own, share) in enumerate(zip(sides, shares, strict=True)):
        others = passive & (np.arange(len(sides)) != column)
        events += _events(column, own, share, table[:, others])
    _taken_over(events, passive)
    spans = _decided(_between(events, len(sides), len(table)), controls, shares)
    places = np.arange(len(table) + 1.0)
    found = []
    for span in spans:
        begin, end = np.interp([span.begin, span.end], places, phase.mesh).tolist()
        found.append(Stretch(begin, end, span.signature, round(np.ceil(span.end - span.begin))))
    return found, limits


def _events(
    column: int, sides: np.ndarray, shares: FloatArray | None, others: np.ndarray
) -> list[_Event]:
    """When one column changes.

    ``shares`` [N] is the mean of its value in every interval, 1 at the upper and -1 at the lower
    limit; ``others`` [N, K] are the sides of limits that may determine it where it is at none.
    """
    edges = [0, *(np.flatnonzero(np.diff(sides)) + 1).tolist(), sides.size]
    runs = [(a, b, int(sides[a])) for a, b in itertools.pairwise(edges)]
    found = [_Event(0.0, column, runs[0][2])]
    for index, (begin, after, side) in enumerate(runs):
        before = runs[index - 1][2] if index else 0
        following = runs[index + 1][2] if index + 1 < len(runs) else 0
        if side != 0:
            if not before:  # what was undecided has told already when it begins
                found += [_Event(float(begin), column, side)] * (found[-1].side != side)
            elif before != side:
                found.append(_Event(float(begin), column, side))
            continue
        replaced = others.size and np.any(others[begin:after] != _around(others, begin, after))
        if (
            shares is None
            or replaced
            or after - begin > LONGEST_SWITCH
            or not (before or following)
        ):
            found.append(_Event(float(begin), column, 0))
            continue
        found += _within(column, begin, after, before, following, float(shares[begin:after].sum()))
    return [one for k, one in enumerate(found) if k == 0 or one.side != found[k - 1].side]


def _around(others: np.ndarray, begin: int, after: int) -> np.ndarray:
    """Sides [K] that act on both sides of some intervals."""
    before, following = others[max(begin - 1, 0)], others[min(after, len(others) - 1)]
    return np.where(before == following, before, 0)


def _within(
    column: int, begin: int, after: int, before: int, following: int, area: float
) -> list[_Event]:
    """Switches inside a few intervals, so that the integral over them stays."""
    length = float(after - begin)
    if before and following and before != following:
        own = np.clip((area - following * length) / (before - following), 0.0, length)
        return [_Event(begin + float(own), column, following)]
    side = before or following
    other = float(np.clip((length - side * area) / 2, 0.0, length))
    if other < LEAST_SHARE:
        return [] if before else [_Event(float(begin), column, side)]
    if not before:  # at the start
        return [_Event(float(begin), column, -side), _Event(begin + other, column, side)]
    if not following:  # at the end
        return [_Event(after - other, column, -side)]
    middle = (begin + after) / 2
    return [
        _Event(middle - other / 2, column, -side),
        _Event(middle + other / 2, column, side),
    ]


def _taken_over(events: Sequence[_Event], passive: np.ndarray) -> None:
    """What ends and what begins in its place do so at once.

    Not so two limits of states: only a control at its bound leads from one to the other.
    """
    pairs_of = [(last, e) for last, e in itertools.pairwise(events) if last.column == e.column]
    ends = [e for last, e in pairs_of if last.side != 0 and e.side == 0]
    begins = [e for last, e in pairs_of if last.side == 0 and e.side != 0]
    pairs = sorted(
        (abs(one.place - other.place), i, j)
        for i, one in enumerate(ends)
        for j, other in enumerate(begins)
        if one.column != other.column and not (passive[one.column] and passive[other.column])
    )
    done_ends: set[int] = set()
    done_begins: set[int] = set()
    for gap, i, j in pairs:
        if gap > TAKING_OVER:
            break
        if i in done_ends or j in done_begins:
            continue
        done_ends.add(i)
        done_begins.add(j)
        ends[i].place = begins[j].place = (ends[i].place + begins[j].place) / 2


def _between(events: Sequence[_Event], columns: int, intervals: int) -> list[_Span]:
    """What acts from one event to the next."""
    now = np.zeros(columns, dtype=int)
    spans: list[_Span] = []
    begin = 0.0
    for event in sorted(events, key=lambda e: e.place):
        if event.place - begin > TOGETHER:
            spans.append(_Span(begin, event.place, tuple(now.tolist())))
            begin = event.place
        now[event.column] = event.side
    spans.append(_Span(begin, float(intervals), tuple(now.tolist())))
    return spans


def _decided(
    spans: Sequence[_Span], controls: int, shares: Sequence[FloatArray | None]
) -> list[_Span]:
    """Without short ones on which less acts than there are controls: the smeared ends of others.

    Where one leads to a limit of the states that begins after it, the control that is nearest to a
    bound is at it: only so can the limit be met.
    """
    passive = np.array([share is None for share in shares])
    kept: list[_Span] = []
    groups = [
        (few, list(own)) for few, own in itertools.groupby(spans, lambda s: s.acting < controls)
    ]
    for index, (few, own) in enumerate(groups):
        begin, end = own[0].begin, own[-1].end
        if not few or end - begin > UNDECIDED or len(groups) == 1:
            kept += own
            continue
        before = np.array(kept[-1].signature if kept else own[0].signature)
        after = np.array(groups[min(index + 1, len(groups) - 1)][1][0].signature)
        entered = passive & (after != 0) & (before != after)
        left = ~passive & (before != 0) & (before != after)
        if np.sum(entered) > np.sum(left):
            kept.append(_Span(begin, end, _filled(own[0].signature, begin, end, shares)))
    edges = [(one.end + other.begin) / 2 for one, other in itertools.pairwise(kept)]
    ends = [spans[0].begin, *edges, spans[-1].end]
    return [
        _Span(a, b, span.signature)
        for span, (a, b) in zip(kept, itertools.pairwise(ends), strict=True)
    ]


def _filled(
    signature: tuple[int, ...], begin: float, end: float, shares: Sequence[FloatArray | None]
) -> tuple[int, ...]:
    """With the control that is nearest to a bound at it."""
    rows = slice(int(begin), int(np.ceil(end)))
    means = [
        0.0 if share is None or side else float(share[rows].mean())
        for side, share in zip(signature, shares, strict=True)
    ]
    nearest = int(np.argmax(np.abs(means)))
    return (*signature[:nearest], int(np.sign(means[nearest])), *signature[nearest + 1 :])
