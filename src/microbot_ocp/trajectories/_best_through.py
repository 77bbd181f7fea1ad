"""The fastest cubics, and lines with parabolic blends, through via points.

All times and via velocities are optimised.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.checks import FloatArray
from microbot_ocp.limits import LimitFamily
from microbot_ocp.motion import PiecewisePolynomial
from microbot_ocp.robot import JointLimits, Limits, Robot
from microbot_ocp.trajectories._best_split import best_split, first_splits, split_and_shape
from microbot_ocp.trajectories._shortest_duration import Scaled
from microbot_ocp.trajectories._through_points import (
    ViaPoints,
    cubic_through,
    lspb_through,
    spline_velocities,
    via_velocities,
)

Velocities = Callable[[ViaPoints], FloatArray]
BLEND = 0.25  # share of each segment, initial blend time


@dataclass(frozen=True, eq=False)
class Segments:
    """Segments through via points, each made of parts whose durations are free.

    Attributes
    ----------
    via_q : array [m,n]
    blended : bool
        True for linear segments with parabolic blends, False for cubic segments.
    blend : float, optional
        Blend time as a share of each segment. If None, the parts are the blend times [m-1]
        followed by the durations of the linear pieces [m-1].
    """

    via_q: FloatArray
    blended: bool = False
    blend: float | None = None

    @property
    def free_blends(self) -> bool:
        """True if each segment has two parts."""
        return self.blended and self.blend is None

    def parts(self, durations: FloatArray) -> FloatArray:
        """Return initial durations of parts [...,k] for given durations of the segments."""
        if not self.free_blends:
            return durations
        return np.concatenate([BLEND * durations, (1.0 - 2.0 * BLEND) * durations], axis=-1)

    def durations(self, parts: FloatArray) -> FloatArray:
        """Return durations [m-1] of the segments."""
        count = len(self.via_q) - 1
        return 2.0 * parts[:count] + parts[count:] if self.free_blends else parts

    def blends(self, parts: FloatArray) -> FloatArray:
        """Return the blend times [m-1]."""
        return parts[: len(self.via_q) - 1] if self.blend is None else self.blend * parts

    def via(self, parts: FloatArray) -> ViaPoints:
        """Return the via points with their times."""
        return ViaPoints(self.via_q, np.concatenate([[0.0], np.cumsum(self.durations(parts))]))

    def with_velocities(self, parts: FloatArray, choose: Velocities) -> PiecewisePolynomial:
        """Return the motion whose via velocities ``choose`` computes from its times."""
        via = self.via(parts)
        if self.blended:
            return lspb_through(via, self.blends(parts), choose(via))
        return cubic_through(via, choose(via))

    def with_shape(self, parts: FloatArray, shape: FloatArray) -> PiecewisePolynomial:
        """Return the motion with inner via velocities ``shape`` divided by its duration."""

        def velocities(via: ViaPoints) -> FloatArray:
            inner = shape.reshape(-1, via.q.shape[1]) / via.t[-1]
            return np.pad(inner, ((1, 1), (0, 0)))

        return self.with_velocities(parts, velocities)


def textbook(robot: Robot, segments: Segments, usual: Velocities, first: FloatArray) -> Scaled:
    """Return the best split of the time with textbook via velocities.

    ``first`` [s,m-1] holds initial durations of the segments.
    """
    make = partial(segments.with_velocities, choose=usual)
    return best_split(robot, make, segments.parts(first))


def fastest(
    robot: Robot,
    segments: Segments,
    usual: Velocities = via_velocities,
    first: FloatArray | None = None,
) -> Scaled:
    """Return the fastest of all times and via velocities, never slower than :func:`textbook`."""
    durations, shapes = _starts(robot, segments, usual, first)
    return best_split(robot, segments.with_shape, durations, first_shape=shapes)


def fastest_path(
    robot: Robot,
    segments: Segments,
    usual: Velocities = via_velocities,
    first: FloatArray | None = None,
) -> PiecewisePolynomial:
    """Return the path of :func:`fastest`, even if its jumps of the torque violate a limit."""
    durations, shapes = _starts(robot, segments, usual, first)
    return split_and_shape(robot, segments.with_shape, durations, first_shape=shapes)[1]


def _starts(
    robot: Robot, segments: Segments, usual: Velocities, first: FloatArray | None
) -> tuple[FloatArray, FloatArray]:
    """Return initial durations of parts [s,k] and initial via velocities [s,p].

    The best split with textbook velocities is the first, so that no result is slower; stops and the
    velocities of a spline follow, each at both splits of :func:`first_splits`.
    """
    splits = first_splits(segments.via_q)
    make = partial(segments.with_velocities, choose=usual)
    parts, _ = split_and_shape(robot, make, segments.parts(splits if first is None else first))
    starts = [(parts, usual)]
    for split in segments.parts(splits):
        starts += [(split, _stops), (split, spline_velocities)]
    vias = [(segments.via(parts), choose) for parts, choose in starts]
    shapes = [(choose(via)[1:-1] * via.t[-1]).ravel() for via, choose in vias]
    return np.stack([parts for parts, _ in starts]), np.stack(shapes)


def best_cubic(
    robot: Robot,
    via_q: ArrayLike,
    limits: Limits | JointLimits | None = None,
    *,
    time_limit: float = np.inf,
) -> Scaled:
    """Return the fastest cubic segments through via points that keep the limits.

    :func:`best_split` optimises all times and all velocities at the inner via points, from the
    best split with Craig's velocities (:func:`cubic`), from stops and from a spline's velocities.
    Parameters
    ----------
    robot : Robot
    via_q : array_like [m,n]
        Via points, rad (m), at rest at both ends.
    limits : Limits or JointLimits, optional
        Limits; default ``robot.limits``.
    time_limit : float
        Wall time, s, after which the best result so far has the status "time limit".

    Returns
    -------
    Scaled
        Motion; ``split`` holds the durations of the segments.

    Raises
    ------
    InputError
        Wrong via points; errors of :func:`shortest_duration`.

    Examples
    --------
    >>> import numpy as np
    >>> import microbot_ocp as mo
    >>> robot = mo.load_robot("microbot")
    >>> via_q = np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]])
    >>> print(f"{mo.best_cubic(robot, via_q).duration:.3f} s")
    2.074 s
    """
    return _best(robot, via_q, limits, time_limit)


def best_lspb(
    robot: Robot,
    via_q: ArrayLike,
    limits: Limits | JointLimits | None = None,
    *,
    blend: float | None = None,
    time_limit: float = np.inf,
) -> Scaled:
    """Return the fastest linear segments with parabolic blends through via points.

    The method is that of :func:`best_cubic`; the blend times are optimised, too.

    Parameters
    ----------
    robot, via_q, limits, time_limit
        Arguments of :func:`best_cubic`.
    blend : float, optional
        Blend time as a share of each segment, up to 0.5; by default optimised for each.

    Returns
    -------
    Scaled
        Motion; ``split`` holds the blend times, followed by the durations of the linear pieces;
        with ``blend`` the durations of the segments.

    Raises
    ------
    InputError
        Errors of :func:`best_cubic`.
    """
    if blend is not None:
        blend = checks.number("blend", blend, "of a segment", above=0.0, at_most=0.5)
    return _best(robot, via_q, limits, time_limit, blended=True, blend=blend)


def _best(
    robot: Robot,
    via_q: ArrayLike,
    limits: Limits | JointLimits | None,
    time_limit: float,
    **kind: Any,
) -> Scaled:
    started = time.perf_counter()
    first_splits(via_q)  # raises InputError for wrong via points
    segments = Segments(np.asarray(via_q, dtype=float), **kind)
    if limits is not None:
        robot = LimitFamily.of(robot, limits).robot
    with deadline.within(time_limit):
        scaled = fastest(robot, segments)
        status = deadline.status() if deadline.over() else scaled.status
    return replace(scaled, wall_time=time.perf_counter() - started, status=status)


def _stops(via: ViaPoints) -> FloatArray:
    return np.zeros_like(via.q)
