"""Paths around obstacles and their timings, which are starts of a search and its fallback.

A planner finds joint paths around the obstacles. Each path, with a timing that keeps every limit,
is a motion that is proved to keep clear. The search for the fastest motion starts from these paths,
timed by reachability. Its result is the motion found, or a path with its best timing, if that is
faster or the search failed or ran out of time.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.outcome import Advice, Outcome
from microbot_ocp._base.status import Status
from microbot_ocp.limits import LIMIT_TOLERANCE, LimitFamily
from microbot_ocp.motion import Motion, dense_times
from microbot_ocp.ocp.solution import StepProgress, quiet
from microbot_ocp.planning.free import joined
from microbot_ocp.planning.path import LATER, PathTiming, check_path, time_path
from microbot_ocp.planning.search._guided import is_clear
from microbot_ocp.planning.search._result import NONE_WITHIN, is_late, returned, too_late
from microbot_ocp.planning.search._settings import SAME_OPTIMUM, TimeOptimalSettings
from microbot_ocp.planning.task import length_text
from microbot_ocp.planning.timing import PathTimingSettings, best_timing
from microbot_ocp.robot import Robot
from microbot_ocp.scene import (
    Clearance,
    Detour,
    Surroundings,
    detour,
)
from microbot_ocp.trajectories import quintic, shortest_duration

DIFFERENT = 0.02  # relative difference of durations from which two timed paths are different
NOTHING_FASTER = "the search found nothing faster"
AT_CORNERS = "path around obstacles, at rest at its corners"


@dataclass(frozen=True, eq=False)
class ProvedPath:
    """A motion within all limits, with the proof that it keeps clear."""

    motion: Motion
    clearance: Clearance

    @property
    def made_from(self) -> str:
        """Origin of the motion, for messages."""
        how = self.motion.provenance
        if how.get("method") == AT_CORNERS:
            return f"a {AT_CORNERS}"
        return how.get("made_from", "the best timing of a path around the obstacles")


@dataclass(eq=False)
class WayAround:
    """A way from one pose to another around the obstacles, and its timings."""

    family: LimitFamily
    settings: TimeOptimalSettings
    detour: Detour

    @cached_property
    def reached(self) -> PathTiming | None:
        """Best timing under the limits of reachability; None if the path leaves the position
        limits, or if the arm cannot hold one of its poses.
        """
        path = self.detour.path
        assert path is not None
        with suppress(InputError):
            timing = time_path(self.family.robot, path, compiled=self.settings.compiled)
            return timing if timing.solved else None
        return None

    @property
    def bound(self) -> float:
        """Lower bound on the duration, s: reachability leaves out some limits, such as rates."""
        return np.inf if self.reached is None else self.reached.duration

    @property
    def kept(self) -> Motion | None:
        """Motion of the best timing, if reachability covers every limit; None otherwise."""
        timing = self.reached
        if timing is None or self.family.jerk_matters or timing.limits_kept_by[LATER]:
            return None
        return timing.motion("timed path")

    @cached_property
    def motion(self) -> Motion | None:
        """Motion of the best timing within all limits; None if none is found in time."""
        best = self.kept
        if best is not None or deadline.over():
            return best
        path = self.detour.path
        assert path is not None
        with suppress(InputError):
            check_path(self.family, path)
            request = PathTimingSettings(
                limit_tolerance=self.settings.limit_tolerance, compiled=self.settings.compiled
            )
            motion = best_timing(self.family, path, request, "timed path", quiet)
            if motion.solved and _keeps_limits(self.family, motion):
                return motion
        return None if deadline.over() else _resting_at_corners(self.family, self.detour)


@dataclass(eq=False)
class Leg:
    """Ways from one pose [n] to another, found by numbered searches.

    Attributes
    ----------
    ways : list of WayAround
        Ways; the first is feasible within the limits.
    failed : list of Detour
        Searches without a feasible way.
    refused : bool
        True if a way was infeasible within the limits.
    searches : int
        Number of searches made.
    """

    around: Surroundings
    start: FloatArray
    goal: FloatArray
    settings: TimeOptimalSettings
    ways: list[WayAround] = field(default_factory=list)
    failed: list[Detour] = field(default_factory=list)
    refused: bool = False
    searches: int = 0

    @property
    def is_blocked(self) -> bool:
        """True if no search found a way that is feasible within the limits."""
        return self.searches > 0 and not self.ways

    @cached_property
    def first_motion(self) -> Motion | None:
        """First way with a timing within all limits, available soon: the best timing, or one that
        rests at every corner if the best takes long to compute. None if limits forbid both.
        """
        way = self.ways[0]
        return way.kept or _resting_at_corners(way.family, way.detour)

    def search(self, number: int, progress: StepProgress) -> None:
        """Make the search with this number, unless it was made before or is needless."""
        routes = [*(way.detour for way in self.ways), *self.failed]
        # A free straight path makes further searches needless.
        if number < self.searches or any(route.name == "straight" for route in routes):
            return
        self.searches = number + 1
        candidate = detour(self.around, self.start, self.goal, self.settings.seed, number)
        if candidate.path is None:
            self.failed.append(candidate)
            progress(f"search {number}: no path in {candidate.checks} poses")
            return
        family = LimitFamily.of(self.around.robot)
        way = WayAround(family, self.settings, candidate)
        if way.reached is None and _resting_at_corners(family, candidate) is None:
            self.refused = True
            self.failed.append(candidate)
        else:
            self.ways.append(way)

    def way(self, choice: int) -> WayAround:
        """Return the way of a number; the last one if there are fewer."""
        return self.ways[min(choice, len(self.ways) - 1)]

    def bound(self, choice: int) -> float:
        """Return a lower bound on the duration of a way, s."""
        return self.way(choice).bound

    def guess(self, choice: int) -> Motion | None:
        """Return the start of a search: a way timed under the limits of reachability."""
        timing = self.way(choice).reached
        return self.motion(choice) if timing is None else timing.motion("timed path")

    def motion(self, choice: int) -> Motion | None:
        """Return a way with its best timing within all limits; None if none is found in time."""
        way = self.way(choice)
        return way.motion or (self.first_motion if way is self.ways[0] else None)


def _resting_at_corners(family: LimitFamily, way: Detour) -> Motion | None:
    """Return a motion along a polyline that rests at its corners; None if limits forbid it."""
    robot: Robot = family.robot
    # A quintic from rest to rest has zero velocity at both ends, so the polyline is followed
    # exactly and keeps the proof of the path.
    assert way.corners is not None
    ends = itertools.pairwise(way.corners)
    shapes = [quintic(pair, [0.0, 1.0], np.zeros((2, robot.joint_count))) for pair in ends]
    # The motion is only a fallback.
    rough: dict[str, Any] = {"tolerance": SAME_OPTIMUM, "scan": False}
    try:
        scaled = [shortest_duration(robot, path, **rough).polynomial for path in shapes]
    except InputError:  # the path leaves the position limits, or the arm cannot hold a pose
        return None
    how = {"method": AT_CORNERS}
    motion = Motion.from_polynomial(robot, joined(scaled), label="timed path", provenance=how)
    return motion if _keeps_limits(family, motion) else None


def _keeps_limits(family: LimitFamily, motion: Motion) -> bool:
    dense = motion.samples(dense_times(motion)[0])
    return bool(family.excess(dense).max() <= LIMIT_TOLERANCE)


def choices_of(legs: Sequence[Leg]) -> range:
    """Return the numbers of the ways along all legs; empty if a leg has no way."""
    there = all(leg.ways for leg in legs)
    # Choice k takes the k-th path of every leg: all combinations of n legs with k paths would be
    # k^n.
    return range(max((len(leg.ways) for leg in legs), default=1) if there else 0)


def differs(duration: float, others: Iterable[float]) -> bool:
    """Return True if a duration differs from all others, s, so that its path is a new one."""
    return all(abs(duration - other) > DIFFERENT * other for other in others)


def at_least(
    fallback: ProvedPath | None,
    motion: Motion | None,
    proof: Clearance | None,
    wanted: float | None = None,
) -> Motion:
    """Return the motion of a search, or else the fallback, under a wanted duration, s, if any.

    The motion counts if it is proved clear, and is faster than the fallback or of less effort.
    """
    if motion is not None and is_clear(proof):
        faster = fallback is None or motion.duration < fallback.motion.duration
        if faster or "least_effort" in motion.provenance:
            outcome = motion.outcome
            # A proof exists only for motions within the limits, so such a status is disproved,
            # unless the motion only takes longer than the duration that was asked for.
            refused = outcome.status in (Status.INFEASIBLE, Status.LIMITS_EXCEEDED)
            if refused and not is_late(motion):
                outcome = replace(Outcome.of(Status.NOT_ACCEPTED), ledger=outcome.ledger)
            return motion.ended(outcome, clearance=as_plain(proof))
    assert fallback is not None
    outcome = _outcome_of(fallback, motion, proof)
    if outcome.solved and wanted is not None and fallback.motion.duration > wanted:
        outcome = replace(too_late(wanted, fallback.motion.duration), ledger=outcome.ledger)
    remark = f"{fallback.made_from}: {outcome.text}"
    if not outcome.solved:
        outcome = outcome.and_(returned(fallback.made_from))
    return replace(fallback.motion, label="time-optimal", remark=remark).ended(
        outcome, made_from=fallback.made_from, clearance=as_plain(fallback.clearance)
    )


def _outcome_of(fallback: ProvedPath, motion: Motion | None, proof: Clearance | None) -> Outcome:
    """Return the outcome of a search whose motion is replaced by a fallback."""
    if motion is None:
        return Outcome.of(deadline.status())
    outcome, ledger = motion.outcome, motion.outcome.ledger.discarded()
    # A timed path obeys every limit of the search, so the search should not end slower.
    slower = motion.duration >= fallback.motion.duration
    if slower and outcome.status is Status.LIMITS_EXCEEDED:  # the faster path keeps the limits
        outcome = Outcome.of(Status.SOLVED, NOTHING_FASTER)
    if is_clear(proof):
        late = outcome.status is Status.INFEASIBLE  # only for the wanted duration
        outcome = Outcome.of(Status.SOLVED if late else outcome.status, NOTHING_FASTER)
        if deadline.over():
            outcome = Outcome.of(deadline.status())
    elif proof is not None:
        outcome = Outcome.of(Status.NOT_ACCEPTED, proof.sentence)
    elif outcome.status in (Status.INFEASIBLE, Status.LIMITS_EXCEEDED):  # the fallback is feasible
        outcome = Outcome.of(Status.FAILED, NONE_WITHIN)
    # The fallback is named by the caller, once.
    advice = tuple(row for row in outcome.advice if row.kind != "returned")
    return replace(outcome, advice=advice, ledger=ledger)


def not_found(motion: Motion, why: str, hit: Clearance) -> Motion:
    """Return a motion that ignores the obstacles, with its contact and the status "not found"."""
    advice = f"{why}. {Status.NOT_FOUND.sentence}\nReturned is a motion that ignores the obstacles."
    provenance = {"method": "free time-optimal motion among obstacles", **motion.provenance}
    outcome = Outcome.of(Status.NOT_FOUND, advice, Advice("contact", hit.sentence))
    unsolved = replace(motion, label="time-optimal", provenance=provenance)
    return unsolved.ended(outcome, clearance=as_plain(hit))


def touching(hit: Any, wanted: float) -> str:
    other, link = hit.pair.other.name, hit.pair.capsule.name
    if hit.distance <= 0.0:
        sentence = (
            f"in collision with {other!r} by {length_text(abs(hit.distance))} at link {link!r}"
        )
        # Capsules stand out from the meshes of links that they enclose: at a contact within that
        # excess the meshes may not touch.
        excess = sum(getattr(shape, "excess", 0.0) for shape in (hit.pair.capsule, hit.pair.other))
        if -hit.distance < excess:
            sentence += (
                f", whose capsules stand out by up to {length_text(excess)}: the link itself may "
                "be free there; closer ones: robot.with_capsules(mo.fit_capsules(robot, most=4))"
            )
        return sentence
    return (
        f"too near to {other!r}: {length_text(hit.distance)} at link {link!r}, not more than the "
        f"clearance of {length_text(wanted)}"
    )


def as_plain(clearance: Clearance) -> dict[str, Any]:
    names = ("minimum", "time", "pair", "proved", "at_least")
    return {name: getattr(clearance, name) for name in names}


def nothing_found(legs: Sequence[Leg | None], names: Sequence[str]) -> str:
    """Return the reason why no free leg between poses of these names has a timed path."""
    missing = next((k for k, leg in enumerate(legs) if leg and not leg.ways), 0)
    leg = legs[missing]
    if leg is None or leg.ways or leg.refused:
        return "no path around the obstacles that was found can be travelled within the limits"
    failed, start, end = leg.failed, names[missing], names[missing + 1]
    poses = sum(search.checks for search in failed)
    sentence = f"no path from the {start} to the {end} was found in {poses} poses"
    if not failed:
        return sentence
    left = np.degrees(min(search.left for search in failed))
    return f"{sentence}; the search came within {left:.3g} deg (in joint space) of the {end}"
