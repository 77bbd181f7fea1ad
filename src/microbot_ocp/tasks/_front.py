"""Fronts of time against effort or torque: the saving by slower motions than the fastest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import InputError
from microbot_ocp._base.showing import DrawnAxes, GivenAxes, view_for
from microbot_ocp.certificate import Certificate, certify
from microbot_ocp.motion import Motion
from microbot_ocp.ocp.solution import StepProgress, quiet
from microbot_ocp.planning.search import TimeOptimalSettings, motions_of_front
from microbot_ocp.planning.task import Segment, Stop, with_changes
from microbot_ocp.robot import JointLimits, Limits, Robot
from microbot_ocp.scene import Scene

SLACKS = (0.01, 0.03, 0.1, 0.3, 1.0)
SHARES = (0.9, 0.8, 0.7, 0.6, 0.5)


@dataclass(frozen=True, eq=False)
class FrontPoint:
    """Motion of a front with its costs.

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
        Reason why the front ends early; empty if it is complete.
    """

    points: tuple[FrontPoint, ...]
    ended: str = ""

    @property
    def certified(self) -> bool:
        """True if every motion is solved and certified."""
        return all(point.motion.solved and point.certificate.ok for point in self.points)

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        points = [
            {
                **{key: getattr(point, key) for key in ("duration", "effort", "peak_torque")},
                "status": str(point.motion.status),
                "certified": point.certificate.ok,
            }
            for point in self.points
        ]
        return {"points": points, "ended": self.ended}

    def plot(self, axes: GivenAxes | None = None) -> DrawnAxes:
        """Plot effort and peak torque over the duration."""
        return view_for(self, "plot")(self, axes)


def time_effort_front(
    robot: Robot,
    via_q: ArrayLike | Sequence[Stop],
    limits: Limits | JointLimits | None = None,
    *,
    slacks: Sequence[float] = SLACKS,
    segments: Sequence[Segment] | None = None,
    cycle: bool = False,
    scene: Scene | None = None,
    progress: StepProgress | None = None,
    **changes: Any,
) -> Front:
    """Return the front of time against effort: certified motions of least effort per duration.

    Parameters
    ----------
    robot, via_q, limits, segments, cycle, scene, progress, **changes
        Parameters of :func:`microbot_ocp.time_optimal`.
    slacks : sequence of float
        Allowed increases of the duration, relative to the shortest duration. Each motion is the
        initial guess of the next.

    Returns
    -------
    Front
        Motions from the fastest to the calmest, with their efforts.

    Raises
    ------
    InputError
        Errors of :func:`microbot_ocp.time_optimal`; no slack, or a slack that is not above zero.
    """
    for slack in slacks:
        checks.number("slacks", slack, above=0.0)
    task = robot, via_q, limits, segments, cycle, scene
    return _front(task, progress, changes, slacks=tuple(slacks))


def time_torque_front(
    robot: Robot,
    via_q: ArrayLike | Sequence[Stop],
    limits: Limits | JointLimits | None = None,
    *,
    shares: Sequence[float] = SHARES,
    segments: Sequence[Segment] | None = None,
    cycle: bool = False,
    scene: Scene | None = None,
    progress: StepProgress | None = None,
    **changes: Any,
) -> Front:
    """Return the front of time against peak torque: fastest motions under reduced torque limits.

    Parameters
    ----------
    robot, via_q, limits, segments, cycle, scene, progress, **changes
        Parameters of :func:`microbot_ocp.time_optimal`.
    shares : sequence of float
        Shares of the torque limits that may be used, above 0 and at most 1. Each motion is the
        initial guess of the next. The front ends at torques that no longer suffice, with the reason
        in ``ended``.

    Returns
    -------
    Front
        Motions certified under the full limits; ``peak_torque`` is the share that a motion uses.

    Raises
    ------
    InputError
        Errors of :func:`microbot_ocp.time_optimal`; no share, or a share outside 0 to 1; a robot
        without masses.
    """
    for share in shares:
        checks.number("shares", share, above=0.0, at_most=1.0)
    if not robot.has_dynamics:
        raise InputError(f"robot {robot.name!r} has no masses, so its motions have no torques")
    task = robot, via_q, limits, segments, cycle, scene
    return _front(task, progress, changes, shares=tuple(shares))


def _front(
    task: Any, progress: StepProgress | None, changes: dict[str, Any], **targets: tuple[float, ...]
) -> Front:
    """Return the front with certified motions."""
    robot, via_q, limits, segments, cycle, scene = task
    if not all(targets.values()):
        raise InputError(f"{next(iter(targets))} must have at least one number")
    try:
        stops = list(via_q)
    except TypeError:
        given = checks.shown(via_q)
        raise InputError(f"via_q must be stops or joint positions, not {given}") from None
    stops = [stop if isinstance(stop, Stop) else Stop(q=stop) for stop in stops]
    settings = with_changes(changes.pop("settings", None) or TimeOptimalSettings(), changes)
    solutions, ended = motions_of_front(
        robot, limits, stops, segments, cycle, scene, settings, progress or quiet, **targets
    )
    points = []
    for effort, motion in solutions:
        certificate = certify(
            robot, motion, limits, via_q=stops, segments=segments, cycle=cycle, scene=scene
        )
        torque = [c for c in certificate.limit_checks if c.quantity == "tau"]
        peak = float(np.nanmax(torque[0].utilisation)) if torque else np.nan
        points.append(FrontPoint(motion.duration, effort, peak, motion, certificate))
    return Front(tuple(points), ended)
