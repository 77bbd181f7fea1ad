"""Time against effort or torque: the fastest motion, and what a little more time saves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import InputError
from microbot_ocp._base.showing import DrawnAxes, GivenAxes, view_for
from microbot_ocp.comparison._certificate import Certificate, Tolerances
from microbot_ocp.comparison._task_certificate import certificate_of_task
from microbot_ocp.motion import Motion
from microbot_ocp.ocp.solution import StepProgress, quiet
from microbot_ocp.planning import (
    Segment,
    Stop,
    Task,
    TimeOptimalSettings,
    effort_front,
    task_of,
    torque_front,
)
from microbot_ocp.robot import JointLimits, Limits, Robot

SLACKS = (0.01, 0.03, 0.1, 0.3, 1.0)
SHARES = (0.9, 0.8, 0.7, 0.6, 0.5)


@dataclass(frozen=True, eq=False)
class FrontPoint:
    """One motion of a front.

    Attributes
    ----------
    duration : float, s
    effort : float
        Time integral of the squared torques, each relative to its limit, s.
    peak_torque : float
        Largest share of a torque limit that is used.
    motion : Motion
    certificate : Certificate
    """

    duration: float
    effort: float
    peak_torque: float
    motion: Motion
    certificate: Certificate


@dataclass(frozen=True, eq=False)
class Front:
    """Motions of one task from the fastest to the calmest.

    Attributes
    ----------
    points : tuple of FrontPoint
    ended : str
        Why there is no motion further on; empty where all that were asked for were found.
    """

    points: tuple[FrontPoint, ...]
    ended: str = ""

    @property
    def certified(self) -> bool:
        """Whether every motion is solved and certified."""
        return all(point.motion.solved and point.certificate.ok for point in self.points)

    def plot(self, axes: GivenAxes | None = None) -> DrawnAxes:
        """Effort and peak torque over the duration."""
        return view_for(self, "plot")(self, axes)


def _listed(via_q: Any) -> list[Any]:
    try:
        return list(via_q)
    except TypeError:
        raise InputError(
            f"via_q must be stops or joint positions, not {checks.shown(via_q)}"
        ) from None


def time_effort_front(
    robot: Robot,
    via_q: ArrayLike | Sequence[Stop],
    limits: Limits | JointLimits | None = None,
    *,
    slacks: Sequence[float] = SLACKS,
    segments: Sequence[Segment] | None = None,
    cycle: bool = False,
    progress: StepProgress | None = None,
    **changes: Any,
) -> Front:
    """The front of time against effort: each motion of least effort in its time, certified.

    Parameters
    ----------
    robot, via_q, limits, segments, cycle, progress, **changes
        As of :func:`microbot_ocp.time_optimal`.
    slacks : sequence of float
        By which shares of the shortest duration the motions may be slower. Each starts from the one
        before.

    Returns
    -------
    Front

    Raises
    ------
    InputError
        As of :func:`microbot_ocp.time_optimal`; a slack that is not above zero.
    """
    for slack in slacks:
        checks.number("slacks", slack, above=0.0)
    stops = _listed(via_q)
    task = task_of(robot, stops, limits, segments=segments, cycle=cycle)
    settings = TimeOptimalSettings(**changes)
    return _certified(task, effort_front(task, tuple(slacks), settings, progress or quiet))


def time_torque_front(
    robot: Robot,
    via_q: ArrayLike | Sequence[Stop],
    limits: Limits | JointLimits | None = None,
    *,
    shares: Sequence[float] = SHARES,
    segments: Sequence[Segment] | None = None,
    cycle: bool = False,
    progress: StepProgress | None = None,
    **changes: Any,
) -> Front:
    """The front of time against peak torque: the fastest motion with a share of every torque limit.

    Parameters
    ----------
    robot, via_q, limits, segments, cycle, progress, **changes
        As of :func:`microbot_ocp.time_optimal`.
    shares : sequence of float
        Of the torque limits that may be used, above 0 and at most 1. Each motion starts from the
        one before; the front ends where the torques no longer suffice, and ``ended`` says why.

    Returns
    -------
    Front
        Certified under the whole limits; ``peak_torque`` of a point is the share that it uses.

    Raises
    ------
    InputError
        As of :func:`microbot_ocp.time_optimal`; a share that is not above 0 and at most 1; a robot
        without masses.
    """
    for share in shares:
        checks.number("shares", share, above=0.0, at_most=1.0)
    if not robot.has_dynamics:
        raise InputError(f"robot {robot.name!r} has no masses, so its motions have no torques")
    stops = _listed(via_q)
    task = task_of(robot, stops, limits, segments=segments, cycle=cycle)
    settings = TimeOptimalSettings(**changes)
    return _certified(task, *torque_front(task, tuple(shares), settings, progress or quiet))


def _certified(task: Task, found: Sequence[tuple[float, Motion]], ended: str = "") -> Front:
    points = []
    for effort, motion in found:
        certificate = certificate_of_task(task, motion, Tolerances())
        torque = [c for c in certificate.limit_checks if c.quantity == "tau"]
        peak = float(np.nanmax(torque[0].utilisation)) if torque else np.nan
        points.append(FrontPoint(motion.duration, effort, peak, motion, certificate))
    return Front(tuple(points), ended)
