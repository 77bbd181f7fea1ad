"""The methods that a comparison has: each makes a motion of a task.

A method is a function from :class:`ComparedTask` to a motion, and one line of :data:`METHODS`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.outcome import Outcome
from microbot_ocp.limits import LimitFamily
from microbot_ocp.motion import Mark, Motion, PiecewisePolynomial
from microbot_ocp.ocp.solution import StepProgress
from microbot_ocp.planning import (
    TIME_LIMIT,
    PathTimingSettings,
    Task,
    TimeOptimalSettings,
    best_timing,
    check_path,
    fastest_through,
    straight_through,
)
from microbot_ocp.robot import Robot
from microbot_ocp.trajectories import (
    ViaPoints,
    best_durations,
    best_split,
    cubic_through,
    first_splits,
    lspb_through,
    shortest_duration,
    via_velocities,
)

BLEND = 0.25  # of each segment, where LSPB's times are as given; its best ones start from it
CUBIC, LINEAR = "cubic segments", "linear segments with parabolic blends"


@dataclass(frozen=True, eq=False)
class ComparedTask:
    """Via points, with what is given of the textbook methods.

    Attributes
    ----------
    family : LimitFamily
        The limits of the task.
    via_q : array [m,n], rad
    via_t : array [m], s, or None
    via_qd : array [m,n], rad/s, or None
        Via velocities of the textbook methods at ``via_t``; None for Craig's heuristic.
    blend : float, or None
        Blend time of LSPB as a share of each segment.
    free_settings, path_settings
        For the time-optimal solvers.
    tell : callable
        Takes a line of progress, or an iteration.
    """

    family: LimitFamily
    via_q: FloatArray
    via_t: FloatArray | None
    via_qd: FloatArray | None
    blend: float | None
    free_settings: TimeOptimalSettings
    path_settings: PathTimingSettings
    tell: StepProgress

    @property
    def robot(self) -> Robot:
        """With the limits of the task."""
        return self.family.robot

    @property
    def given(self) -> FloatArray:
        """Durations of the segments as given, s."""
        assert self.via_t is not None
        return np.diff(self.via_t)

    @property
    def first(self) -> FloatArray:
        """Durations [s,m-1] of the segments that the search for the best split starts from."""
        first = first_splits(self.via_q)
        return first if self.via_t is None else np.vstack([self.given, first])

    def cubic(self, durations: FloatArray) -> PiecewisePolynomial:
        """Return cubic segments of these durations."""
        via, velocities = self._via(durations)
        return cubic_through(via, velocities)

    def lspb(self, durations: FloatArray, blends: FloatArray) -> PiecewisePolynomial:
        """Return linear segments of these durations with parabolic blends."""
        via, velocities = self._via(durations)
        return lspb_through(via, blends, velocities)

    def _via(self, durations: FloatArray) -> tuple[ViaPoints, FloatArray]:
        """Return via points and velocities there; given ones are slower as the whole motion is."""
        via = ViaPoints(self.via_q, np.concatenate([[0.0], np.cumsum(durations)]))
        if self.via_qd is None or self.via_t is None:
            return via, via_velocities(via)
        return via, self.via_qd * (self.via_t[-1] / via.t[-1])


@dataclass(frozen=True)
class Method:
    """One way to do a task: a function with what it takes of the task, by default all of it."""

    title: str
    solve: Callable[..., Motion]
    arguments: Callable[[ComparedTask], tuple[Any, ...]] = lambda task: (task,)
    timed: bool = False  # needs the times of the task


def _as_given(task: ComparedTask) -> Motion:
    return Motion.from_polynomial(
        task.robot,
        task.cubic(task.given),
        label="cubic as given",
        marks=_via_marks(task.given),
        provenance={"method": "cubic segments at the given timing"},
        remark="not scaled to the limits",
    )


def _cubic(task: ComparedTask, best: bool) -> Motion:
    return _scaled(task, best, CUBIC, task.cubic, task.first if best else task.given)[0]


def _lspb(task: ComparedTask, best: bool) -> Motion:
    """Take blends of a share of each segment, or as is best for each."""
    share = BLEND if task.blend is None and not best else task.blend
    parts = task.first if best else task.given
    count = len(task.via_q) - 1
    if share is None:  # blends, then what is between them
        parts = np.hstack([BLEND * parts, (1.0 - 2.0 * BLEND) * parts])

    def both(parts: FloatArray) -> tuple[FloatArray, FloatArray]:
        if share is None:
            return 2.0 * parts[:count] + parts[count:], parts[:count]
        return parts, share * parts

    motion, parts = _scaled(
        task, best, LINEAR, lambda parts: task.lspb(*both(parts)), parts, lambda p: both(p)[0]
    )
    blends = f"blends {share:g} of each segment" if share else _seconds("blends", both(parts)[1])
    state = motion.sample([mark.time for mark in motion.marks[1:-1]])
    units = {task.robot.unit("q", joint) for joint in range(task.robot.joint_count)}
    passes = map(partial(_passage, sorted(units)), task.via_q[1:-1], state.q, state.qd)
    return replace(motion, remark="; ".join([motion.remark, blends, *passes]))


def _scaled(
    task: ComparedTask,
    best: bool,
    shape: str,
    make: Callable[[FloatArray], PiecewisePolynomial],
    parts: FloatArray,
    segments: Callable[[FloatArray], FloatArray] = lambda parts: parts,
) -> tuple[Motion, FloatArray]:
    """Return a shape scaled to the limits, all of its parts alike or each as is best, and their
    durations.

    ``segments`` makes durations of the segments of those of the parts.
    """
    if best:
        scaled = best_split(task.robot, make, parts)
        assert scaled.split is not None
        parts, label, scale = scaled.split, "best split", "a time scale each"
        note = _seconds("segments", segments(parts))
    else:
        scaled = shortest_duration(task.robot, make(parts))
        parts, label, scale = parts * scaled.factor, "as given, scaled", "one time scale"
        note = f"all times x {scaled.factor:.4f}"
    durations = segments(parts)
    of = f" of {scaled.joint}" if scaled.joint else ""
    where = f"{scaled.quantity.replace('_', ' ')}{of} at {scaled.time:.3f} s"
    if len(durations) > 1:
        craig, given = "by Craig's heuristic", "as given, scaled like the times"
        note += f"; via velocities {craig if task.via_qd is None else given}"
    motion = Motion.from_polynomial(
        task.robot,
        scaled.polynomial,
        label=f"{'cubic' if shape == CUBIC else 'LSPB'}, {label}",
        marks=_via_marks(durations),
        provenance={
            "method": f"{shape}, {scale}",
            "factor": scaled.factor,
            "segments": durations.tolist(),
            "met": where,
            "iterations": scaled.iterations,
            "wall_time": scaled.wall_time,
        },
        remark=f"{note}; held back by {where}",
    ).ended(Outcome.of(scaled.status))
    return motion, parts


def _seconds(of: str, durations: FloatArray) -> str:
    if len(durations) > 4:
        return f"{of} of {durations.min():.3f} to {durations.max():.3f} s"
    return f"{of} of {', '.join(f'{duration:.3f}' for duration in durations)} s"


def _passage(units: Sequence[str], via: FloatArray, q: FloatArray, qd: FloatArray) -> str:
    """Return how LSPB passes a via point."""
    miss = float(np.abs(q - via).max())
    unit = " or ".join(units)
    speeds = f"({', '.join(f'{v:.3f}' for v in qd)}) {'/s or '.join(units)}/s"
    if miss < 1e-9:
        return f"passes the via point, at qd = {speeds}"
    return f"does not pass the via point: misses it by {miss:.4f} {unit}, qd = {speeds}"


def _straight_path(task: ComparedTask) -> Motion:
    return _timed(task, straight_through(task.via_q), "straight path, best timing")


def _cubic_path(task: ComparedTask) -> Motion:
    """Time the path of the best split, which is not refused for a torque rate, as its cubic is."""
    durations = best_durations(task.robot, task.cubic, task.first)
    return _timed(task, task.cubic(durations), "cubic's path, best timing")


def _timed(task: ComparedTask, path: PiecewisePolynomial, label: str) -> Motion:
    check_path(task.family, path)
    return best_timing(task.family, path, task.path_settings, label, task.tell)


METHODS: dict[str, Method] = {
    "cubic_report": Method("cubic, as given", _as_given, timed=True),
    "cubic_scaled": Method("cubic, as given, scaled", partial(_cubic, best=False), timed=True),
    "cubic": Method("cubic, best split of times", partial(_cubic, best=True)),
    "lspb_scaled": Method("LSPB, as given, scaled", partial(_lspb, best=False), timed=True),
    "lspb": Method("LSPB, best split of times", partial(_lspb, best=True)),
    "straight_path": Method("straight path, best timing", _straight_path),
    "cubic_path": Method("cubic's path, best timing", _cubic_path),
    "time_optimal": Method(
        "time-optimal, free",
        partial(fastest_through, usual=TIME_LIMIT),
        lambda task: (Task.through(task.family, task.via_q), task.free_settings, task.tell),
    ),
}


def _via_marks(durations: FloatArray) -> list[Mark]:
    times = [0.0, *np.cumsum(durations).tolist()]
    return [Mark(time, f"via {i + 1}") for i, time in enumerate(times)]
