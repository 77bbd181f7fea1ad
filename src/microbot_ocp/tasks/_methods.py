"""Methods of a comparison.

A method is a function from :class:`ComparedTask` to a motion, with one entry in :data:`METHODS`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from microbot_ocp._base.checks import ROUNDING, FloatArray
from microbot_ocp._base.outcome import Outcome
from microbot_ocp.limits import LimitFamily, quantity_name
from microbot_ocp.motion import Mark, Motion, PiecewisePolynomial
from microbot_ocp.ocp.solution import StepProgress
from microbot_ocp.planning.path import check_path, straight_through
from microbot_ocp.planning.search import TimeOptimalSettings, fastest_through
from microbot_ocp.planning.task import TIME_LIMIT, Task
from microbot_ocp.planning.timing import PathTimingSettings, best_timing
from microbot_ocp.robot import Robot
from microbot_ocp.trajectories import (
    BLEND,
    Scaled,
    Segments,
    ViaPoints,
    fastest,
    fastest_path,
    first_splits,
    shortest_duration,
    textbook,
    via_velocities,
)

CUBIC, LINEAR = "cubic segments", "linear segments with parabolic blends"


@dataclass(frozen=True, eq=False)
class ComparedTask:
    """Task of a comparison: limits, via points, and arguments of the methods.

    Attributes
    ----------
    family : LimitFamily
        Limits of the task.
    via_q : array [m,n], rad
    via_t : array [m], s, or None
    via_qd : array [m,n], rad/s, or None
        Via velocities of the textbook methods at ``via_t``; None for Craig's heuristic.
    blend : float, or None
        Blend time of LSPB as a share of each segment.
    free_settings, path_settings
        Settings of the free motion and of path timing.
    progress : callable
        Progress function for a line of text or an iteration.
    """

    family: LimitFamily
    via_q: FloatArray
    via_t: FloatArray | None
    via_qd: FloatArray | None
    blend: float | None
    free_settings: TimeOptimalSettings
    path_settings: PathTimingSettings
    progress: StepProgress

    @property
    def robot(self) -> Robot:
        """Robot with the limits of the task."""
        return self.family.robot

    @property
    def given_durations(self) -> FloatArray:
        """Durations [m-1] of the segments by ``via_t``, s."""
        assert self.via_t is not None
        return np.diff(self.via_t)

    @property
    def first_splits(self) -> FloatArray:
        """Start values [s,m-1] for the durations of the segments, in the search for the best, s."""
        first = first_splits(self.via_q)
        return first if self.via_t is None else np.vstack([self.given_durations, first])

    def textbook_velocities(self, via: ViaPoints) -> FloatArray:
        """Return Craig's via velocities, or the given ones scaled with the duration, rad/s."""
        if self.via_qd is None or self.via_t is None:
            return via_velocities(via)
        return self.via_qd * (self.via_t[-1] / via.t[-1])


@dataclass(frozen=True)
class Method:
    """Method: a function from the task to a motion."""

    title: str
    solve: Callable[[ComparedTask], Motion]
    timed: bool = False  # needs via_t
    baseline: bool = False  # textbook method; the fastest baseline is the reference


def _as_given(task: ComparedTask) -> Motion:
    return Motion.from_polynomial(
        task.robot,
        Segments(task.via_q).with_velocities(task.given_durations, task.textbook_velocities),
        label="cubic as given",
        marks=_via_marks(task.given_durations),
        provenance={"method": "cubic segments at the given timing"},
        remark="not scaled to the limits",
    )


def _scaled(task: ComparedTask, blended: bool) -> Motion:
    """Stretch the textbook motion at the given times by one factor until it keeps the limits."""
    segments = Segments(task.via_q, blended, task.blend or BLEND)
    given = segments.with_velocities(task.given_durations, task.textbook_velocities)
    scaled = shortest_duration(task.robot, given)
    scaled = replace(scaled, split=task.given_durations * scaled.factor)
    note = f"all times x {scaled.factor:.4f}"
    return _with_remarks(task, segments, scaled, "as given, scaled", "one time scale", note)


def _textbook(task: ComparedTask, blended: bool) -> Motion:
    """Choose the best times (and blends) for the textbook's via velocities."""
    segments = Segments(task.via_q, blended, task.blend)
    scaled = textbook(task.robot, segments, task.textbook_velocities, task.first_splits)
    return _with_remarks(task, segments, scaled, "textbook velocities", "a time scale each")


def _fastest(task: ComparedTask, blended: bool) -> Motion:
    """Choose the best times (and blends) and the via velocities."""
    segments = Segments(task.via_q, blended, task.blend)
    scaled = fastest(task.robot, segments, task.textbook_velocities, task.first_splits)
    kind, scale = "best times and velocities", "a time scale each, best via velocities"
    return _with_remarks(task, segments, scaled, kind, scale)


def _with_remarks(
    task: ComparedTask, segments: Segments, scaled: Scaled, kind: str, scale: str, note: str = ""
) -> Motion:
    """Return the motion with remarks on its times, velocities, blends and limiting quantity."""
    assert scaled.split is not None
    durations = segments.durations(scaled.split)
    marks = _via_marks(durations)
    owner = f" of {scaled.joint}" if scaled.joint else ""
    where = f"{quantity_name(scaled.quantity)}{owner} at its limit at {scaled.time:.3f} s"
    shape, name = (LINEAR, "LSPB") if segments.blended else (CUBIC, "cubic")
    motion = Motion.from_polynomial(
        task.robot,
        scaled.polynomial,
        label=f"{name}, {kind}",
        marks=marks,
        provenance={
            "method": f"{shape}, {scale}",
            "factor": scaled.factor,
            "segments": durations.tolist(),
            "met": where,
            "iterations": scaled.iterations,
            "wall_time": scaled.wall_time,
        },
    ).ended(Outcome.of(scaled.status))
    remarks = [note or _seconds("segments", durations)]
    state = motion.sample([mark.time for mark in marks[1:-1]])
    if marks[1:-1]:
        given = "by Craig's heuristic" if task.via_qd is None else "as given, scaled like the times"
        remarks.append(f"via velocities {'chosen' if 'best' in kind else given}")
        slow = np.abs(state.qd).max(axis=1) <= ROUNDING * np.abs(motion.qd).max()
        stops = [mark.name for mark, stands in zip(marks[1:-1], slow, strict=True) if stands]
        remarks += [f"a full stop at {', '.join(stops)}"] if stops else []
    remarks.append(where)
    if segments.blended:
        share = segments.blend
        blends = segments.blends(scaled.split)
        remarks.append(f"blends {share:g} of each segment" if share else _seconds("blends", blends))
        units = {task.robot.unit("q", joint) for joint in range(task.robot.joint_count)}
        remarks += map(partial(_passage, sorted(units)), task.via_q[1:-1], state.q, state.qd)
    return replace(motion, remark="; ".join(remarks))


def _seconds(parts: str, durations: FloatArray) -> str:
    if len(durations) > 4:
        return f"{parts} of {durations.min():.3f} to {durations.max():.3f} s"
    return f"{parts} of {', '.join(f'{duration:.3f}' for duration in durations)} s"


def _passage(units: Sequence[str], via: FloatArray, q: FloatArray, qd: FloatArray) -> str:
    """Return a sentence on the position error and the velocity of LSPB at a via point."""
    miss = float(np.abs(q - via).max())
    unit = " or ".join(units)
    speeds = f"({', '.join(f'{v:.3f}' for v in qd)}) {'/s or '.join(units)}/s"
    if miss < ROUNDING:
        return f"passes the via point, at qd = {speeds}"
    return f"does not pass the via point: misses it by {miss:.4f} {unit}, qd = {speeds}"


def _straight_path(task: ComparedTask) -> Motion:
    return _timed(task, straight_through(task.via_q), "straight path, best timing")


def _cubic_path(task: ComparedTask) -> Motion:
    """Time the path of the fastest cubic, which is found also under limits of the torque rate."""
    via = Segments(task.via_q)
    path = fastest_path(task.robot, via, task.textbook_velocities, task.first_splits)
    return _timed(task, path, "cubic's path, best timing")


def _time_optimal(task: ComparedTask) -> Motion:
    through = Task.through(task.family, task.via_q)
    return fastest_through(through, task.free_settings, task.progress, usual=TIME_LIMIT)


def _timed(task: ComparedTask, path: PiecewisePolynomial, label: str) -> Motion:
    check_path(task.family, path)
    return best_timing(task.family, path, task.path_settings, label, task.progress)


def _textbooks(name: str, blended: bool) -> dict[str, Method]:
    """Return the methods for one shape of segments."""
    title = "LSPB" if blended else "cubic"
    kinds: dict[str, tuple[str, Callable[..., Motion], bool]] = {
        f"{name}_scaled": ("as given, scaled", _scaled, True),
        f"{name}_textbook": ("textbook velocities", _textbook, False),
        name: ("best times and velocities", _fastest, False),
    }
    return {
        key: Method(f"{title}, {kind}", partial(solve, blended=blended), timed=timed, baseline=True)
        for key, (kind, solve, timed) in kinds.items()
    }


METHODS: dict[str, Method] = {
    "cubic_report": Method("cubic, as given", _as_given, timed=True),
    **_textbooks("cubic", blended=False),
    **_textbooks("lspb", blended=True),
    "straight_path": Method("straight path, best timing", _straight_path),
    "cubic_path": Method("cubic's path, best timing", _cubic_path),
    "time_optimal": Method("time-optimal, free", _time_optimal),
}


def _via_marks(durations: FloatArray) -> list[Mark]:
    times = [0.0, *np.cumsum(durations).tolist()]
    return [Mark(time, f"via {i + 1}") for i, time in enumerate(times)]
