"""Baseline of a cell: the moves of a standard robot controller through the stops of a motion.

In a point-to-point move (PTP) all joints start, cruise and stop together. The velocity profile is
trapezoidal, or a double S (limited jerk) if a limit depends on the jerk. Lines and circles of the
tool (LIN, CIRC) have this profile along their path.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from microbot_ocp._base.checks import ROUNDING, FloatArray
from microbot_ocp.motion import Motion, PiecewisePolynomial
from microbot_ocp.planning.search import tool_poses
from microbot_ocp.planning.task import Corner, Task
from microbot_ocp.robot import Robot
from microbot_ocp.trajectories import best_lspb, best_split, cubic, lspb, quintic, spline

PATH_POINTS = 25  # samples per segment of the motion's path, interpolated by a spline
PIECES = 6  # polynomial pieces in each phase of a profile along a path
SHORTEST_PHASE = 1e-3  # smallest phase of a profile along a path, relative to its duration


def controller_duration(task: Task, motion: Motion) -> float:
    """Return the duration of a controller's moves through the stops of a motion, rests included, s.

    Order, branches and limits are those of the motion; the durations of all phases are optimised.
    Trapezoidal moves are blended through stops at which the arm need not rest; moves of limited
    jerk and tool paths go from rest to rest.

    Parameters
    ----------
    task : Task
    motion : Motion
        Motion of this task, with one mark per stop.

    Returns
    -------
    float

    Raises
    ------
    InputError
        The moves cannot keep the limits; raised by :func:`best_split`.
    """
    smooth, duration = task.family.jerk_matters, float(task.dwells.sum())
    arrives = np.array([mark.time for mark in motion.marks])
    leaves = arrives + task.dwells
    for first, last in _runs(task, smooth):
        robot = task.payloads[first].on(task.robot)
        if task.curves[first] is not None:
            times = np.linspace(leaves[first], arrives[last], PATH_POINTS * (last - first))
            duration += _path_duration(robot, motion.sample(times).q, smooth)
            continue
        via_q = motion.sample(np.append(leaves[first:last], arrives[last])).q
        via_q = via_q[np.append(True, np.diff(via_q, axis=0).any(axis=1))]
        if len(via_q) > 1:
            moves = _double_s_duration(robot, via_q) if smooth else best_lspb(robot, via_q).duration
            duration += moves
    return duration


def _runs(task: Task, smooth: bool) -> Iterator[tuple[int, int]]:
    """Yield the first and the last stop of every run from rest to rest."""
    first, last = 0, len(task.segments)
    for stop in range(1, last + 1):
        adjacent = task.segments[stop - 1 : stop + 1]
        blended = not (smooth or any(adjacent) or task.at_rest(stop))
        corner = any(isinstance(segment, Corner) for segment in adjacent)
        if stop == last or not (blended or corner):
            yield first, stop
            first = stop


def _double_s_duration(robot: Robot, ends: FloatArray) -> float:
    def make(parts: FloatArray) -> PiecewisePolynomial:
        profile = _double_s(parts)
        coefficients = profile.coefficients * np.diff(ends, axis=0)
        coefficients[:, 0] += ends[0]
        return PiecewisePolynomial(profile.breaks, coefficients)

    return best_split(robot, make, [1.0, 1.0, 1.0]).duration


def _path_duration(robot: Robot, q: FloatArray, smooth: bool) -> float:
    """Return the duration from rest to rest of a profile along the path through poses [N,n], s."""
    tool = tool_poses(robot, q)
    way = np.linalg.norm(np.diff(tool[:, :3, 3], axis=0), axis=1)
    if not way.max() > ROUNDING * np.ptp(q, axis=0).max():  # pure rotation: measure in joint space
        way = np.linalg.norm(np.diff(q, axis=0), axis=1)
    far = np.append(True, way > 1e-6 * way.max())
    length = np.append(0.0, np.cumsum(way))[far]
    path = spline(q[far], length / length[-1], "natural")
    make = partial(_profile_on_path, path, smooth=smooth)
    return best_split(robot, make, [1.0, 1.0, 1.0] if smooth else [1.0, 1.0]).duration


def _profile_on_path(
    path: PiecewisePolynomial, parts: FloatArray, smooth: bool
) -> PiecewisePolynomial:
    """Return the motion along a path (parameter 0 to 1) with a profile of these phases."""
    parts = parts + SHORTEST_PHASE * parts.sum()
    profile = (
        _double_s(parts)
        if smooth
        else lspb([[0.0], [1.0]], [0.0, 2.0 * parts[0] + parts[1]], parts[0])
    )
    breaks = profile.breaks
    t = np.append(np.linspace(breaks[:-1], breaks[1:], PIECES, endpoint=False).T, breaks[-1])
    # Chain rule on q(s(t)): qd = q' sd, qdd = q'' sd^2 + q' sdd.
    rate, slope = profile.derivative(), path.derivative()
    s, sd, sdd = profile(t).clip(0.0, 1.0)[:, 0], rate(t), rate.derivative()(t)
    if not smooth:
        return cubic(path(s), t, slope(s) * sd)
    return quintic(path(s), t, slope(s) * sd, slope.derivative()(s) * sd**2 + slope(s) * sdd)


def _double_s(parts: FloatArray) -> PiecewisePolynomial:
    """Return the double S profile from 0 to 1.

    Each of its four phases of constant jerk lasts ``parts[0]``, each of its two phases of constant
    acceleration ``parts[1]``, the phase of constant velocity ``parts[2]``, s.
    """
    rise, hold, cruise = parts
    times = np.array([rise, hold, rise, cruise, rise, hold, rise])
    # Unit jerk gives s, sd and sdd of each phase; the last line scales the end position to 1.
    state, rows = np.zeros(3), []
    for jerk, h in zip((1, 0, -1, 0, -1, 0, 1), times, strict=True):
        row = [*state[:2], state[2] / 2, jerk / 6]
        rows.append(row)
        state = np.array([np.polyval(np.polyder(row[::-1], k), h) for k in range(3)])
    coefficients = np.array(rows)[:, :, None] / state[0]
    return PiecewisePolynomial(np.append(0.0, np.cumsum(times)), coefficients)
