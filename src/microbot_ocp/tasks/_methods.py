"""The methods that a comparison has: each makes a motion of a task.

A method is a function from :class:`ComparedTask` to a motion, and one line of :data:`METHODS`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.status import Status
from microbot_ocp.limits import LimitFamily
from microbot_ocp.motion import Mark, Motion, PiecewisePolynomial
from microbot_ocp.ocp.solution import StepProgress
from microbot_ocp.planning import (
    PathTimingSettings,
    TimeOptimalSettings,
    best_timing,
    check_path,
    fastest_motion,
    straight_through,
)
from microbot_ocp.robot import Robot
from microbot_ocp.trajectories import (
    Scaled,
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
        """Cubic segments of these durations."""
        via, velocities = self._via(durations)
        return cubic_through(via, velocities)

    def lspb(self, durations: FloatArray, blends: FloatArray) -> PiecewisePolynomial:
        """Linear segments of these durations with parabolic blends."""
        via, velocities = self._via(durations)
        return lspb_through(via, blends, velocities)

    def _via(self, durations: FloatArray) -> tuple[ViaPoints, FloatArray]:
        """Via points and velocities there; given ones are slower as the whole motion is."""
        via = ViaPoints(self.via_q, np.concatenate([[0.0], np.cumsum(durations)]))
        if self.via_qd is None or self.via_t is None:
            return via, via_velocities(via)
        return via, self.via_qd * (self.via_t[-1] / via.t[-1])


@dataclass(frozen=True)
class Method:
    """One way to do a task."""

    title: str
    solve: Callable[[ComparedTask], Motion]
    timed: bool = False  # needs the times of the task


def _as_given(task: ComparedTask) -> Motion:
    return Motion.from_polynomial(
        task.robot,
        task.cubic(task.given),
        label="cubic as given",
        marks=_via_marks(task.given),
        provenance={"method": "cubic segments at the given timing", "status": Status.SOLVED},
        note="not scaled to the limits",
    )


def _scaled_motion(
    task: ComparedTask, scaled: Scaled, durations: FloatArray, label: str, method: str, note: str
) -> Motion:
    """The motion of a shape scaled to the limits, with the durations of its segments."""
    of = f" of {scaled.joint}" if scaled.joint else ""
    where = f"{scaled.quantity.replace('_', ' ')}{of} at {scaled.time:.3f} s"
    velocities = "Craig's heuristic" if task.via_qd is None else "as given, slower as the motion is"
    via = f"; via velocities: {velocities}" if len(durations) > 1 else ""
    return Motion.from_polynomial(
        task.robot,
        scaled.polynomial,
        label=label,
        marks=_via_marks(durations),
        provenance={
            "method": method,
            "status": scaled.status,
            "factor": scaled.factor,
            "segments": durations.tolist(),
            "met": where,
            "iterations": scaled.iterations,
            "wall_time": scaled.wall_time,
        },
        note=f"{note}{via}; just meets the limit of {where}",
    )


def _scaled_cubic(task: ComparedTask) -> Motion:
    scaled = shortest_duration(task.robot, task.cubic(task.given))
    return _scaled_motion(
        task,
        scaled,
        task.given * scaled.factor,
        "cubic, as given, scaled",
        "cubic segments, one time scale",
        f"all times x {scaled.factor:.4f}",
    )


def _best_cubic(task: ComparedTask) -> Motion:
    scaled = best_split(task.robot, task.cubic, task.first)
    assert scaled.split is not None
    return _scaled_motion(
        task,
        scaled,
        scaled.split,
        "cubic, best split",
        "cubic segments, a time scale each",
        _seconds("segments", scaled.split),
    )


def _scaled_lspb(task: ComparedTask) -> Motion:
    share = BLEND if task.blend is None else task.blend
    scaled = shortest_duration(task.robot, task.lspb(task.given, share * task.given))
    motion = _scaled_motion(
        task,
        scaled,
        task.given * scaled.factor,
        "LSPB, as given, scaled",
        "linear segments with parabolic blends, one time scale",
        f"all times x {scaled.factor:.4f}, blends {share:g} of each segment",
    )
    return _with_passages(task, motion, scaled.polynomial)


def _best_lspb(task: ComparedTask) -> Motion:
    """Best durations of the segments and, where no share is given, of their blends."""
    share, count = task.blend, len(task.via_q) - 1

    def durations(parts: FloatArray) -> FloatArray:  # of blends, then of what is between them
        return parts if share is not None else 2.0 * parts[:count] + parts[count:]

    def blends(parts: FloatArray) -> FloatArray:
        return parts[:count] if share is None else share * parts

    first = task.first
    if share is None:
        first = np.hstack([BLEND * first, (1.0 - 2.0 * BLEND) * first])
    scaled = best_split(task.robot, lambda p: task.lspb(durations(p), blends(p)), first)
    assert scaled.split is not None
    segments = durations(scaled.split)
    chosen = f"blends {share:g} of each" if share else _seconds("blends", blends(scaled.split))
    motion = _scaled_motion(
        task,
        scaled,
        segments,
        "LSPB, best split",
        "linear segments with parabolic blends, a time scale each",
        f"{_seconds('segments', segments)}, {chosen}",
    )
    return _with_passages(task, motion, scaled.polynomial)


def _seconds(of: str, durations: FloatArray) -> str:
    if len(durations) > 4:
        return f"{of} of {durations.min():.3f} to {durations.max():.3f} s"
    return f"{of} of {', '.join(f'{duration:.3f}' for duration in durations)} s"


def _with_passages(task: ComparedTask, motion: Motion, polynomial: PiecewisePolynomial) -> Motion:
    """With a note of how LSPB passes the via points."""
    times = np.array([mark.time for mark in motion.marks[1:-1]])
    state = polynomial(times), polynomial.derivative()(times)
    passes = "; ".join(_passage(*point) for point in zip(task.via_q[1:-1], *state, strict=True))
    return motion if not passes else replace(motion, note=f"{motion.note}; {passes}")


def _passage(via: FloatArray, q: FloatArray, qd: FloatArray) -> str:
    miss = float(np.abs(q - via).max())
    speeds = ", ".join(f"{v:.3f}" for v in qd)
    if miss < 1e-9:
        return f"passes the via point, at qd = ({speeds}) rad/s"
    return f"does not pass the via point: misses it by {miss:.4f} rad, qd = ({speeds}) rad/s"


def _straight_path(task: ComparedTask) -> Motion:
    return _timed(task, straight_through(task.via_q), "straight path, best timing")


def _cubic_path(task: ComparedTask) -> Motion:
    """Along the path of the best split, which is not refused for a torque rate, as its cubic is."""
    durations = best_durations(task.robot, task.cubic, task.first)
    return _timed(task, task.cubic(durations), "cubic's path, best timing")


def _timed(task: ComparedTask, path: PiecewisePolynomial, label: str) -> Motion:
    check_path(task.family, path)
    return best_timing(task.family, path, task.path_settings, label, task.tell)


def _free(task: ComparedTask) -> Motion:
    return fastest_motion(task.family, task.via_q, task.free_settings, task.tell)


METHODS: dict[str, Method] = {
    "cubic_report": Method("cubic, as given", _as_given, timed=True),
    "cubic_scaled": Method("cubic, as given, scaled", _scaled_cubic, timed=True),
    "cubic": Method("cubic, best split of times", _best_cubic),
    "lspb_scaled": Method("LSPB, as given, scaled", _scaled_lspb, timed=True),
    "lspb": Method("LSPB, best split of times", _best_lspb),
    "straight_path": Method("straight path, best timing", _straight_path),
    "cubic_path": Method("cubic's path, best timing", _cubic_path),
    "time_optimal": Method("time-optimal, free", _free),
}


def _via_marks(durations: FloatArray) -> list[Mark]:
    times = [0.0, *np.cumsum(durations).tolist()]
    return [Mark(time, f"via {i + 1}") for i, time in enumerate(times)]
