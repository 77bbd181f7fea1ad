"""Typical magnitudes of a task: durations of its segments and accelerations of its joints.

Solvers use absolute tolerances, so a task of microradians and one of metres need units of their
own. Magnitudes within a factor of ten of one keep the unit one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from microbot_ocp._base.checks import LONGEST, FloatArray
from microbot_ocp._base.outcome import Advice
from microbot_ocp.limits import LIMIT_TOLERANCE, LimitFamily, MotionSamples
from microbot_ocp.robot import inverse_dynamics

TYPICAL_SPEED = 2.0  # speed of joints without direct bounds, rad/s (m/s)
POSES_PER_SEGMENT = 5  # poses along every segment for the inertia

# Weight of the squared jerk: it selects one of many equally fast motions. It costs 1.3e-5 of the
# duration of the Microbot task and halves the swing of the torques that are not at a limit.
JERK_SMOOTHING = 1e-6

ACCELERATION_RATIO = 10.0  # unit of the acceleration per typical acceleration
LONGEST_MOTION = 10.0 * LONGEST  # longest straight motion, s: a curved one may be faster
LONGEST_DURATION = 1e3  # upper bound of a duration, per sum of the typical durations
SHORTEST_DURATION = 1e-2  # lower bound of a duration, per time at the highest speed
LEAST_RISE = 5e-3  # share of the duration in which a highest velocity may be reached


@dataclass(frozen=True, eq=False)
class TaskScale:
    """Typical magnitudes of a motion through via points [m,n].

    Attributes
    ----------
    durations : array [m-1]
        Typical durations of the segments from rest to rest, s: those of the slowest joint alone.
    shortest, longest : array [m-1]
        Bounds of the durations for the solver, s, far from expected values.
    time : float
        Unit of time, s: a power of ten, 1 for ordinary tasks.
    position : float
        Unit of the positions, rad (m): a power of ten, 1 for ordinary distances. In a larger unit
        the tolerance of the solvers would be a large part of the motion.
    velocity, acceleration : array [n]
        Units for joints without limits of velocity and acceleration.
    jerk : array [n]
        Unit of the jerk in the smoothing cost.
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
        """Return the magnitudes of a task from its limits, for joints alone, without gravity.

        ``velocities`` [m,n] are given at the via points; by default the arm rests there.
        """
        limits = family.robot.limits
        apart = steps = np.abs(np.diff(via, axis=0))
        speed = _larger(limits.bounds("qd"))
        share = np.linspace(0.0, 1.0, POSES_PER_SEGMENT)[:, None, None]
        accelerated, jerk_limit, holding = _single_joint_bounds(
            family, via[:-1] + share * np.diff(via, axis=0)
        )
        # A joint alone needs from rest to rest over a distance d: 2 sqrt(d / a) under an
        # acceleration a (bang-bang), 1.5 d / v under a velocity v (cubic).
        with np.errstate(divide="ignore", invalid="ignore"):
            alone, given = 2.0 * np.sqrt(steps / accelerated), 0.0
            if velocities is not None and velocities.any():
                given = np.abs(velocities).max(axis=0)
                steps, alone = _in_motion(np.diff(via, axis=0), velocities, accelerated)
            times = np.nan_to_num(
                [
                    1.5 * steps / speed,
                    alone,
                    _under_jerk(steps, jerk_limit),
                    holding,
                ],
                posinf=0.0,
            )
            durations = times.max(axis=(0, 2))
            durations = np.where(durations > 0, durations, steps.max(axis=1) / TYPICAL_SPEED)
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
        unit = ACCELERATION_RATIO * _power(acceleration)
        limited = _larger(limits.bounds("qdd"))
        hardest = np.where(np.isfinite(limited), limited, unit)
        if time != 1.0:  # a slow motion may still start and stop at full acceleration
            possible = np.where(np.isfinite(accelerated), accelerated, 0.0)
            hardest = np.maximum(hardest, ACCELERATION_RATIO * _power(possible))
        jerk = 10.0 * hardest / time
        # A velocity may be reachable faster than the smoothing allows; a larger unit of the jerk
        # keeps the cost of that low. The cheapest rise to a velocity v, by an acceleration that
        # falls linearly to zero, lasts (36 weight v^2 / unit^2)^(1/4).
        with np.errstate(divide="ignore", invalid="ignore"):
            rise = np.maximum(np.nan_to_num(highest / accelerated), LEAST_RISE * durations.sum())
            needed = np.where(np.isfinite(highest), highest, 0.0) / rise**2
            needed *= 6.0 * np.sqrt(JERK_SMOOTHING)
        return cls(
            durations=durations,
            shortest=SHORTEST_DURATION * np.where(fastest > 0, fastest, 0.1 * durations),
            longest=np.full(durations.size, LONGEST_DURATION * durations.sum()),
            time=time,
            position=float(_power(steps.max())),
            velocity=_power(velocity),
            acceleration=unit,
            jerk=np.maximum(jerk, np.where(highest < speed, 0.0, needed)),
        )

    def active_bounds(self, durations: Sequence[float]) -> tuple[Advice, ...]:
        """Return advice on segments whose durations [m-1] are at a bound."""
        rows, why = [], "a bound of the search, which no limit asks for"
        for k, duration in enumerate(durations):
            between = f"between via points {k + 1} and {k + 2}"
            if duration <= self.shortest[k] * (1 + LIMIT_TOLERANCE):
                sentence = f"The time {between} could not be shorter than {duration:.3g} s: {why}."
            elif duration >= self.longest[k] * (1 - LIMIT_TOLERANCE):
                sentence = f"The time {between} could not be longer than {duration:.3g} s: {why}."
            else:
                continue
            rows.append(Advice("bound", sentence, f"time {between}", duration, "s"))
        return tuple(rows)


def _in_motion(
    ways: FloatArray, velocities: FloatArray, acceleration: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the distances [m-1,n] that joints alone travel, and their durations, s.

    Joints move by ``ways`` [m-1,n] between velocities [m,n] at a constant acceleration [n], with
    one sign first and the opposite sign after it. A distance counts at least half of that at the
    peak velocity.
    """
    start, end = velocities[:-1], velocities[1:]
    squares = 0.5 * (start**2 + end**2)
    # Distance of the motion with an acceleration of one sign.
    direct = 0.5 * (start + end) * np.abs(end - start) / acceleration
    sign = np.where(ways >= direct, 1.0, -1.0)
    peak = np.sqrt(np.maximum(sign * acceleration * ways + squares, 0.0))
    lasts = (2.0 * peak - sign * (start + end)) / acceleration
    return np.fmax(np.abs(ways), 0.5 * peak * lasts), lasts


def _stretch(family: LimitFamily, via: FloatArray, durations: FloatArray) -> float:
    """Return the factor on durations within which straight motions exceed further limits tenfold.

    The factor is a power of ten. Limits that already bind an arm at rest do not count: no duration
    helps.
    """
    keys = [member.key for member in family if member.limit is not None and member.order > 0]
    if not keys:
        return 1.0
    s = np.linspace(0.0, 1.0, 2 * POSES_PER_SEGMENT + 1)[1:-1, None, None]
    ways = np.diff(via, axis=0)
    q = via[:-1] + s**3 * (10 - 15 * s + 6 * s**2) * ways
    slopes = (30 * s**2 * (1 - s) ** 2, 60 * s * (1 - s) * (1 - 2 * s), 60 * (1 - 6 * s * (1 - s)))

    def most(stretch: float) -> FloatArray:
        """Return the largest use [k] of each limit, 1 at the limit."""
        spans = (stretch * durations)[:, None]
        moving = [slope * ways / spans**order for order, slope in enumerate(slopes, 1)]
        samples = (part.reshape(-1, via.shape[1]) for part in (q, *moving))
        return np.array([u.max() for u in family.use(MotionSamples(*samples), keys).values()])

    at_rest = most(np.inf) > 1.0
    factor = 1.0
    while (most(factor)[~at_rest] > 10.0).any() and factor * durations.sum() < LONGEST_MOTION:
        factor *= 10.0
    return factor


def _larger(bounds: tuple[FloatArray, FloatArray]) -> FloatArray:
    """Return the magnitudes [n] of limits; infinite for locked joints, which need no time."""
    size = np.maximum(-bounds[0], bounds[1])
    return np.where(size > 0, size, np.inf)


def single_joint_rates(family: LimitFamily, q: FloatArray) -> tuple[FloatArray, dict[str, Any]]:
    """Return the jerk [n] that limits allow to joints alone, and limits that follow from it.

    Over the distances along q [N,n], from rest to rest, a jerk bounds velocities and accelerations:
    for a duration T = (32 d / j)^(1/3) they reach 2 d / T and j T / 4. The changes hold these
    bounds if they are tighter than the robot's. The jerk is infinite without such limits.
    """
    ways = np.abs(np.diff(q, axis=0)).sum(axis=0)
    _, jerk, _ = _single_joint_bounds(family, q[:, None])
    with np.errstate(divide="ignore", invalid="ignore"):
        lasts = _under_jerk(ways, jerk)
        most = {"qd": 2.0 * ways / lasts, "qdd": jerk * lasts / 4.0}
    changes = {}
    for key, size in most.items():
        low, high = family.robot.limits.bounds(key)
        size = np.where((ways > 0) & np.isfinite(jerk), size, np.inf)
        changes[f"{key}_min"] = np.maximum(low, -size)
        changes[f"{key}_max"] = np.minimum(high, size)
    return jerk, changes


def _under_jerk(ways: FloatArray, jerk: FloatArray) -> FloatArray:
    """Return the durations of joints alone over distances from rest to rest, (32 d / j)^(1/3)."""
    return np.cbrt(32.0 * ways / jerk)


def _single_joint_bounds(
    family: LimitFamily, poses: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the accelerations [n] and jerks [n] allowed to single joints, and times [m,n], s.

    The inertia is the median over poses [K,m,n]; without a limit the values are infinite. The times
    are those in which a limited torque rate follows the holding torque over the K poses.
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
        # numpy.median imports numpy.ma, which takes 50 ms.
        ordered = np.sort(inertia, axis=1)
        middle = 0.5 * (ordered[:, (q.shape[1] - 1) // 2] + ordered[:, q.shape[1] // 2])
        middle = np.maximum(middle, 0.0)
        acceleration = np.minimum(acceleration, torque / middle)
        return acceleration, np.minimum(jerk, rate / middle), change / rate


def _power(size: FloatArray) -> FloatArray:
    """Return powers of ten; one for magnitudes of 0.1 to 10, and for zero or infinite ones."""
    usable = np.isfinite(size) & (size > 0)
    size = np.where(usable, size, 1.0)
    exponent = np.log10(size)
    return np.where(np.abs(exponent) <= 1.0, 1.0, 10.0 ** np.round(exponent))
