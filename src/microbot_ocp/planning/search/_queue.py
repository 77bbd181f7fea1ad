"""One queue for every search: candidates of rising accuracy, the most promising first.

Ways through stops, orders of the stops, paths around obstacles and random starts are candidates.
Each level of accuracy costs about ten times the one before, so a candidate is raised to the next
level only if it may still beat the best finished candidate.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from enum import IntEnum
from math import prod
from typing import Generic, Protocol, TypeVar

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


class Queue(Generic[C]):
    """Candidates of a search; iteration yields the one to be raised next.

    That is the candidate with the least hoped-for duration, until a finished one beats all others.
    After the time limit only the most accurate candidate is raised, until one is finished.

    Parameters
    ----------
    first : iterable of candidates
    most : float
        Duration from which candidates are left out, s; if finite, all others are finished.

    Attributes
    ----------
    finished : list of candidates
    """

    def __init__(self, first: Iterable[C], most: float = np.inf) -> None:
        self.finished: list[C] = []
        self._waiting, self._most, self._gain = list(first), most, dict(GAIN)

    def __iter__(self) -> Iterator[C]:
        while self._waiting:
            late = deadline.over()
            # Among ties `min` takes the first candidate of the list.
            least = min(self._waiting, key=lambda c: (-c.level * late, self._hoped(c)))
            if self.finished and (late or self._best() <= self._hoped(least)):
                return
            self._waiting.remove(least)
            yield least

    def put(self, raised: Iterable[C], before: C) -> None:
        """Store the candidates of a higher level that replace a candidate."""
        for candidate in raised:
            if candidate.keeps_limits and before.level in self._gain:
                seen = 1.0 - candidate.duration / before.duration
                self._gain[before.level] = max(self._gain[before.level], SPREAD * seen)
            done = candidate.level is Level.FINISHED
            (self.finished if done else self._waiting).append(candidate)

    @property
    def duration_to_beat(self) -> float:
        """Duration of the best finished candidate, s; infinite without any."""
        return self._best()[1]

    def _best(self) -> tuple[bool, float]:
        if np.isfinite(self._most):
            return False, self._most
        done = ((not c.keeps_limits, c.duration) for c in self.finished)
        return min(done, default=(True, np.inf))

    def _hoped(self, candidate: C) -> tuple[bool, float]:
        # Estimates below a coarse answer are from below: nothing is gained beyond them.
        gains = self._gain.items()
        later = (share for level, share in gains if level >= candidate.level > Level.TIMED)
        return not candidate.keeps_limits, prod(1.0 - share for share in later) * candidate.duration
