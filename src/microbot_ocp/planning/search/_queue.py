"""One queue for every search: candidates of rising accuracy, the most promising first.

Ways through stops, orders of the stops, paths around obstacles and random starts are candidates.
Each level of accuracy costs about ten times the one before, so a candidate is raised to the next
level only if it may still beat the best finished candidate.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from enum import IntEnum
from math import prod
from typing import Protocol, TypeVar

import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp.planning.search._settings import LEAST_GAIN, SAME_OPTIMUM


class Level(IntEnum):
    """Accuracy of a candidate's duration."""

    BOUND = 0  # lower bound: no motion is faster
    TIMED = 1  # estimate from below by timed paths
    COARSE = 2  # solved on a coarse mesh
    FULL = 3  # solved on a full mesh, or on one between
    SPLIT = 4  # limits hold between mesh points, or links keep clear on a full mesh
    FINISHED = 5  # solved to the wanted gap, and proved to keep clear of obstacles


# Largest share by which later levels are expected to reduce the duration. From coarse to finished,
# all candidates of one task gain similar shares: 0.9 to 1.3 % for six orders of a Puma among
# obstacles, 0.2 to 0.5 % for six of a Microbot.
GAIN = {Level.COARSE: 0.01, Level.FULL: SAME_OPTIMUM, Level.SPLIT: LEAST_GAIN}
SPREAD = 1.5  # expected gain of other candidates, relative to the largest gain seen


class Candidate(Protocol):
    """One way to do the task, solved to some accuracy."""

    @property
    def level(self) -> Level:
        """Accuracy of the duration."""
        ...

    @property
    def duration(self) -> float:
        """Duration, or a low estimate of it, s."""
        ...

    @property
    def keeps_limits(self) -> bool:
        """False for a motion that exceeds its limits: any other one is better."""
        ...


C = TypeVar("C", bound=Candidate)


def best_first(
    first: Iterable[C], raised: Callable[[C, float], Sequence[C]], most: float = np.inf
) -> list[C]:
    """Return the finished candidates of a search.

    The candidate with the least hoped-for duration is raised, again and again, until a finished one
    beats all others. After the time limit only the most accurate candidate is raised, until one is
    finished.

    Parameters
    ----------
    first : iterable of candidates
    raised : callable
        Function of a candidate and the duration to beat, s. It returns the candidates of a higher
        level that replace this candidate, if any.
    most : float
        Duration from which candidates are left out, s; if finite, all others are finished.
    """
    waiting, finished, gain = list(first), list[C](), dict(GAIN)

    def hoped(candidate: C) -> tuple[bool, float]:
        # Estimates below a coarse answer are from below: nothing is gained beyond them.
        later = (share for level, share in gain.items() if level >= candidate.level > Level.TIMED)
        left = prod(1.0 - share for share in later)
        return not candidate.keeps_limits, left * candidate.duration

    def best() -> tuple[bool, float]:
        if np.isfinite(most):
            return False, most
        return min(((not c.keeps_limits, c.duration) for c in finished), default=(True, np.inf))

    while waiting:
        late = deadline.over()
        # Among ties `min` takes the first candidate of the list.
        least = min(waiting, key=lambda c: (-c.level * late, hoped(c)))
        if finished and (late or best() <= hoped(least)):
            break
        waiting.remove(least)
        for candidate in raised(least, best()[1]):
            if candidate.keeps_limits and least.level in gain:
                seen = 1.0 - candidate.duration / least.duration
                gain[least.level] = max(gain[least.level], SPREAD * seen)
            (finished if candidate.level is Level.FINISHED else waiting).append(candidate)
    return finished
