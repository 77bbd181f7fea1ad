"""Sizes that follow from a task: how long its segments take, and how hard its joints accelerate.

Solvers compare everything with one, so a task of microradians and one of metres each need units of
their own. Sizes within a factor of ten of the usual ones are left alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.outcome import Advice
from microbot_ocp.limits import LimitFamily, MotionSamples
from microbot_ocp.robot import inverse_dynamics


@dataclass(frozen=True)
class TypicalSettings:
    """Settings of the typical sizes of a task.

    Attributes
    ----------
    speed : rad/s (m/s) of joints that nothing bounds directly
    acceleration : rad/s^2 (m/s^2), ten times what is typical
    poses : along every segment, at which inertias are looked at
    longest : times the sum of the typical durations: no segment takes longer
    shortest : of the time at the highest speed that a joint might reach
    least_rise : share of the duration in which a highest velocity may always be reached
    at_bound : relative distance at which a duration stands on a bound
    """

    speed: float = 2.0
    acceleration: float = 10.0
    poses: int = 5
    longest: float = 1e3
    shortest: float = 1e-2
    least_rise: float = 5e-3
    at_bound: float = 1e-2


TYPICAL = TypicalSettings()

# The smoothing of the jerk lets a velocity v be reached in so many times sqrt(v / jerk): the time
# (36 weight v^2 / jerk^2)^(1/4) costs least, of an acceleration that falls evenly to zero
SMOOTHED_RISE = (36 * 1e-6) ** 0.25


@dataclass(frozen=True, eq=False)
class TaskScale:
    """Sizes of a motion through via points [m,n].

    Attributes
    ----------
    durations : array [m-1]
        Typical durations of the segments, s: from rest to rest, the slowest joint alone.
    shortest, longest : array [m-1]
        Bounds of the durations for the solver, s, far from what is expected.
    time : float
        Unit of time, s: a power of ten, 1 for ordinary tasks.
    position : float
        Unit of the positions, rad (m): a power of ten, 1 for ordinary ways. In a larger one the
        tolerance of the solvers would be a large part of the way.
    velocity, acceleration : array [n]
        Units for joints without such limits.
    jerk : array [n]
        What the smoothing of the jerk is relative to.
    """

    durations: FloatArray
    shortest: FloatArray
    longest: FloatArray
    time: float
    position: float
    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray

    @classmethod
    def of(
        cls, family: LimitFamily, via: FloatArray, velocities: FloatArray | None = None
    ) -> TaskScale:
        """Return sizes of a task from its limits; motions joint by joint, without gravity.

        With ``velocities`` [m,n] at the via points; by default it rests there.
        """
        limits = family.robot.limits
        apart = steps = np.abs(np.diff(via, axis=0))
        speed = _larger(limits.bounds("qd"))
        share = np.linspace(0.0, 1.0, TYPICAL.poses)[:, None, None]
        accelerated, jerk_limit, holding = _alone(family, via[:-1] + share * np.diff(via, axis=0))
        with np.errstate(divide="ignore", invalid="ignore"):
            alone, given = 2.0 * np.sqrt(steps / accelerated), 0.0
            if velocities is not None and velocities.any():
                given = np.abs(velocities).max(axis=0)
                steps, alone = _in_motion(np.diff(via, axis=0), velocities, accelerated)
            times = np.nan_to_num(
                [
                    1.5 * steps / speed,
                    alone,
                    np.cbrt(32.0 * steps / jerk_limit),
                    holding,
                ],
                posinf=0.0,
            )
            durations = times.max(axis=(0, 2))
            durations = np.where(durations > 0, durations, steps.max(axis=1) / TYPICAL.speed)
            durations = durations * _stretch(family, via, durations)
            highest = np.sqrt(given**2 + 2.0 * accelerated * steps.sum(axis=0))
            highest = np.minimum(speed, highest)
            fastest = np.nan_to_num(apart / highest, posinf=0.0).max(axis=1)
            reached = steps / durations[:, None]
            gained = np.minimum(accelerated, 4.0 * reached / durations[:, None])
        velocity, acceleration = (
            np.maximum(size.max(axis=0), 0.1 * size.max()) for size in (reached, gained)
        )
        time = float(_power(durations.max()))
        unit = TYPICAL.acceleration * _power(acceleration)
        limited = _larger(limits.bounds("qdd"))
        hardest = np.where(np.isfinite(limited), limited, unit)
        if time != 1.0:  # slow motions may start and stop as hard as others
            possible = np.where(np.isfinite(accelerated), accelerated, 0.0)
            hardest = np.maximum(hardest, TYPICAL.acceleration * _power(possible))
        jerk = 10.0 * hardest / time
        # Where a velocity is reached sooner than the smoothing lets it, that must not cost much.
        with np.errstate(divide="ignore", invalid="ignore"):
            rise = np.maximum(
                np.nan_to_num(highest / accelerated), TYPICAL.least_rise * durations.sum()
            )
            needed = SMOOTHED_RISE**2 * np.where(np.isfinite(highest), highest, 0.0) / rise**2
        return cls(
            durations=durations,
            shortest=TYPICAL.shortest * np.where(fastest > 0, fastest, 0.1 * durations),
            longest=np.full(durations.size, TYPICAL.longest * durations.sum()),
            time=time,
            position=float(_power(steps.max())),
            velocity=_power(velocity),
            acceleration=unit,
            jerk=np.maximum(jerk, np.where(highest < speed, 0.0, needed)),
        )

    def active_bounds(self, durations: Sequence[float]) -> tuple[Advice, ...]:
        """Return advice on the segments whose durations [m-1] stand on a bound."""
        rows, why = [], "a bound of the search, which no limit asks for"
        for k, duration in enumerate(durations):
            between = f"between via points {k + 1} and {k + 2}"
            if duration <= self.shortest[k] * (1 + TYPICAL.at_bound):
                sentence = f"The time {between} could not be shorter than {duration:.3g} s: {why}."
            elif duration >= self.longest[k] * (1 - TYPICAL.at_bound):
                sentence = f"The time {between} could not be longer than {duration:.3g} s: {why}."
            else:
                continue
            rows.append(Advice("bound", sentence, f"time {between}", duration, "s"))
        return tuple(rows)


def _in_motion(
    ways: FloatArray, velocities: FloatArray, acceleration: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return what joints alone sweep [m-1,n], at least half of it, and how long they take, s.

    They go ``ways`` [m-1,n] between given velocities [m,n] as fast as an acceleration [n] lets
    them: with one sign first, then with the other.
    """
    start, end = velocities[:-1], velocities[1:]
    squares = 0.5 * (start**2 + end**2)
    direct = 0.5 * (start + end) * np.abs(end - start) / acceleration  # with one sign alone
    sign = np.where(ways >= direct, 1.0, -1.0)
    peak = np.sqrt(np.maximum(sign * acceleration * ways + squares, 0.0))
    lasts = (2.0 * peak - sign * (start + end)) / acceleration
    return np.fmax(np.abs(ways), 0.5 * peak * lasts), lasts


def _stretch(family: LimitFamily, via: FloatArray, durations: FloatArray) -> float:
    """Return how many times as long straight motions last within ten times the further limits.

    A power of ten; limits that bind an arm at rest, too, are none of its pace.
    """
    keys = [member.key for member in family if member.limit is not None and member.order > 0]
    if not keys:
        return 1.0
    s, ways = np.linspace(0.0, 1.0, 2 * TYPICAL.poses + 1)[1:-1, None, None], np.diff(via, axis=0)
    q = via[:-1] + s**3 * (10 - 15 * s + 6 * s**2) * ways
    slopes = (30 * s**2 * (1 - s) ** 2, 60 * s * (1 - s) * (1 - 2 * s), 60 * (1 - 6 * s * (1 - s)))

    def most(stretch: float) -> FloatArray:
        """Return the share [k] used of each limit."""
        spans = (stretch * durations)[:, None]
        moving = [slope * ways / spans**order for order, slope in enumerate(slopes, 1)]
        samples = (part.reshape(-1, via.shape[1]) for part in (q, *moving))
        return np.array([u.max() for u in family.use(MotionSamples(*samples), keys).values()])

    at_rest = most(np.inf) > 1.0
    factor = 1.0
    while (most(factor)[~at_rest] > 10.0).any() and factor < 1e12:
        factor *= 10.0
    return factor


def _larger(bounds: tuple[FloatArray, FloatArray]) -> FloatArray:
    """Return sizes [n] of limits; infinite for joints that are held, which need no time."""
    size = np.maximum(-bounds[0], bounds[1])
    return np.where(size > 0, size, np.inf)


def rates_alone(family: LimitFamily, q: FloatArray) -> tuple[FloatArray, dict[str, Any]]:
    """Return what limits of jerk and torque rate leave to joints alone, from rest to rest along q
    [N,n].

    The jerk [n], infinite where nothing limits it, and the velocities and accelerations that are
    reached so, as limits of the joints where theirs are no tighter.
    """
    ways = np.abs(np.diff(q, axis=0)).sum(axis=0)
    _, jerk, _ = _alone(family, q[:, None])
    with np.errstate(invalid="ignore"):
        lasts = np.cbrt(32.0 * ways / jerk)
        most = {"qd": jerk * lasts**2 / 16.0, "qdd": jerk * lasts / 4.0}
    changes = {}
    for key, size in most.items():
        low, high = family.robot.limits.bounds(key)
        size = np.where((ways > 0) & np.isfinite(jerk), size, np.inf)
        changes[f"{key}_min"] = np.maximum(low, -size)
        changes[f"{key}_max"] = np.minimum(high, size)
    return jerk, changes


def _alone(family: LimitFamily, poses: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what limits leave to one joint at a time, whose inertia is the middle one of poses
    [K,m,n].

    The largest acceleration [n] and jerk [n], infinite without a limit, and how long [m,n] its
    torque rate takes through the torques that hold the arm in K poses, s.
    """
    robot, count = family.robot, family.robot.joint_count
    acceleration, jerk, torque, rate = (
        _larger(robot.limits.bounds(key)) for key in ("qdd", "qddd", "tau", "taud")
    )
    if not (robot.has_dynamics and np.isfinite([torque, rate]).any()):
        return acceleration, jerk, np.zeros(poses.shape[1:])
    q = poses.reshape(-1, count).T
    still = np.zeros_like(q)
    function = inverse_dynamics(robot).map(q.shape[1])
    held = np.array(function(q, still, still))
    inertia = np.zeros_like(held)
    for joint in range(count):
        unit = still.copy()
        unit[joint] = 1.0
        inertia[joint] = (np.array(function(q, still, unit)) - held)[joint]
    change = np.abs(np.diff(held.T.reshape(poses.shape), axis=0)).sum(axis=0)
    with np.errstate(divide="ignore"):
        # numpy.median loads numpy.ma, which takes 50 ms
        ordered = np.sort(inertia, axis=1)
        middle = 0.5 * (ordered[:, (q.shape[1] - 1) // 2] + ordered[:, q.shape[1] // 2])
        middle = np.maximum(middle, 0.0)
        acceleration = np.minimum(acceleration, torque / middle)
        return acceleration, np.minimum(jerk, rate / middle), change / rate


def _power(size: FloatArray) -> FloatArray:
    """Return powers of ten; one where a size is within a factor of ten of it, or unknown."""
    usable = np.isfinite(size) & (size > 0)
    size = np.where(usable, size, 1.0)
    return np.where((size >= 0.1) & (size <= 10.0), 1.0, 10.0 ** np.round(np.log10(size)))
