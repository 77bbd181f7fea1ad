"""The best timing of a curve under limits of any form, from the result of the reachability passes.

Mesh points are places on the path, where every coefficient of a limit is known before the solver
starts (docs/theory/path_timing.md, "One program on places"). The unknowns are s', s'' and the time
of each interval, in which s''' is linear. The mesh is refined until all limits hold between its
points and the duration settles. After Debrouwere et al., "Time-optimal path following for robots
with convex-concave constraints using sequential convex programming", IEEE T-RO 29(6), 2013, with
the time of every interval as an unknown: near a stop s' is not a smooth function of s.

Dry friction reverses within 0.02 rad/s, and a tight limit of the torque rate may leave no feasible
start near that. If the program fails, or violates limits between the mesh points at a reversal, a
continuation follows: a first program smooths the friction more, later ones less and less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.fast_calls import deferred_call
from microbot_ocp._base.status import Status
from microbot_ocp.limits import LimitFamily, MotionSamples
from microbot_ocp.motion import with_parts
from microbot_ocp.ocp.mesh import Round, divide, refined
from microbot_ocp.ocp.solution import Attempt, StartingPoint, StepProgress, gap_of
from microbot_ocp.ocp.solvers import LEAST_WARM_BARRIER, Runner, SolverSettings
from microbot_ocp.ocp.transcription import Bounds
from microbot_ocp.planning.path import PathCurve, Reached, largest_speeds, samples_along
from microbot_ocp.planning.task import (
    CHECKS_PER_INTERVAL,
    DRY,
    LDL,
    VISCOUS,
    dry_friction,
    frictionless,
)
from microbot_ocp.planning.timing._places_program import (
    SPEED_PLACES,
    LimitBounds,
    LimitKinds,
    advanced,
    program_of,
)
from microbot_ocp.robot import COULOMB_SMOOTHING, Robot, torque_and_rate

FIRST_BARRIER = 1e-3  # barrier parameter of the first solve, and after a change of friction


@dataclass(frozen=True, eq=False)
class SpeedProfile:
    """Speed profile of a curve: s' and s'' at places s; s''' is linear in time between them.

    Attributes
    ----------
    curve : PathCurve
    s, v, t : arrays [N+1]
        Places, s' there, and the times of passing them, s.
    a, a_end : arrays [N]
        s'' at the start and at the end of every interval; jumps only at breaks of the path.
    d : array [N]
        Change of s''' within each interval.
    gap : float
        Bound on the difference of the duration to the local optimum, s.
    attempts : tuple of Attempt
        Solves that led to the profile.
    """

    curve: PathCurve
    s: FloatArray
    v: FloatArray
    t: FloatArray
    a: FloatArray
    a_end: FloatArray
    d: FloatArray
    gap: float = float("nan")
    attempts: tuple[Attempt, ...] = ()

    @classmethod
    def of(cls, curve: PathCurve, timing: Reached) -> SpeedProfile:
        """Return the profile of a timing, with s'' averaged to be continuous."""
        rise = timing.start
        a = 0.5 * (np.append(rise, rise[-1]) + np.append(rise[0], rise))
        v = np.sqrt(timing.speed_squared)
        return cls(curve, timing.s, v, timing.t, a[:-1], a[1:], np.zeros_like(rise))

    @property
    def j(self) -> FloatArray:
        """Value of s''' at the start of every interval [N]."""
        return (self.a_end - self.a) / np.diff(self.t) - 0.5 * self.d

    @property
    def duration(self) -> float:
        """Duration, s."""
        return float(self.t[-1])

    @property
    def solved(self) -> bool:
        """True if the last solve converged."""
        return bool(self.attempts) and self.attempts[-1].status.solved

    def inside(self, i: np.ndarray, after: FloatArray) -> tuple[FloatArray, ...]:
        """Return s and its three derivatives at times after the start of intervals i."""
        change = after * (self.d / np.diff(self.t))[i]
        way, *rates = advanced(self.v[i], self.a[i], self.j[i], change, after)
        return self.s[i] + way, *rates

    def samples(self, i: np.ndarray, after: FloatArray) -> MotionSamples:
        """Return the motion of the joints at times after the start of intervals i."""
        s, *rates = self.inside(i, after)
        return samples_along(self.curve.inside(s, i, self.s, highest=3), rates)

    def at_times(self, t: FloatArray) -> SpeedProfile:
        """Return the profile with more mesh points, at times that include the present ones."""
        i = np.clip(np.searchsorted(self.t, t[:-1], side="right") - 1, 0, self.t.size - 2)
        s, v, a, _ = self.inside(i, t[:-1] - self.t[i])
        s = np.clip(s, self.s[i], self.s[i + 1])
        a_end = self.inside(i, t[1:] - self.t[i])[2]
        s, v, at = np.append(s, 0.0), np.append(v, 0.0), np.searchsorted(t, self.t)
        s[at], v[at] = self.s, self.v
        d = (self.d / np.diff(self.t))[i] * np.diff(t)
        return replace(self, s=s, v=v, t=t, a=a, a_end=a_end, d=d)

    def without_gaps(self) -> SpeedProfile:
        """Integrate s'' anew from the start, and scale s to the length of the curve.

        The solver's residual of 1e-11 in s, divided by the third power of a short step, would be a
        visible jerk.
        """
        rest = self.a, self.j, self.d, np.diff(self.t)
        v = self.v[0] + np.append(0.0, np.cumsum(advanced(0.0, *rest)[1]))
        way = np.append(0.0, np.cumsum(advanced(v[:-1], *rest)[0]))
        # The ratio differs from one by the residual of equation (9) only.
        ratio = np.ptp(self.s) / way[-1]
        s = self.s[0] + ratio * way
        a, a_end, d = (ratio * part for part in (self.a, self.a_end, self.d))
        return replace(self, s=s, v=ratio * v, a=a, a_end=a_end, d=d)


MOST_MESHES = 10  # largest number of solves on finer meshes
SETTLED_MESH = 5e-5  # relative change of the duration between meshes that ends the refinement
ORDER = 2  # the excess falls with the third power of the step
MISSED_REVERSAL = 0.1  # relative excess of a profile that has missed a friction reversal


_Rounds = tuple[Round[SpeedProfile, FloatArray], ...]


def timed_on_places(
    family: LimitFamily, start: SpeedProfile, tolerance: float, fast: bool, progress: StepProgress
) -> SpeedProfile:
    """Find the fastest profile of a curve on a mesh that is refined until all limits hold inside.

    docs/theory/path_timing.md, "One program on places".

    Parameters
    ----------
    family : LimitFamily
    start : SpeedProfile
    tolerance : float
        Largest relative excess of a limit between mesh points.
    fast : bool
        Compile functions.
    progress : callable
    """
    profile = _Timing(family, start, fast).solved(FIRST_BARRIER)
    smoothing = _first_smoothing(family, start)
    overshoots = not profile.solved or excess_of(family, profile).max() > MISSED_REVERSAL
    has_friction = smoothing > COULOMB_SMOOTHING and overshoots
    if has_friction and not deadline.over():
        profile = _with_friction(family, start, fast, smoothing)

    def solved(_: SpeedProfile, finer: SpeedProfile) -> SpeedProfile:
        return _Timing(family, finer, fast).solved(LEAST_WARM_BARRIER, bent=True)

    def measured(rounds: _Rounds, profile: SpeedProfile) -> FloatArray:
        excess = np.maximum(excess_of(family, profile).max(axis=1), 0.0)
        progress(
            f"mesh {profile.s.size - 1}: {profile.duration:.6f} s; largest excess of a limit "
            f"between mesh points: {100 * excess.max():.3g} %"
        )
        before = rounds[-1].solution.duration if rounds else np.inf
        settled = abs(profile.duration - before) <= SETTLED_MESH * profile.duration
        if not (settled or has_friction):
            excess += 2.0 * tolerance * _switching(profile)  # two parts at least
        return excess

    def divided(rounds: _Rounds) -> SpeedProfile:
        profile = rounds[-1].solution
        return profile.at_times(divide(profile.t, rounds[-1].measure, tolerance, ORDER))

    def ended(rounds: _Rounds, _: SpeedProfile) -> Status | None:
        if not rounds[-1].solution.solved or deadline.over():
            return deadline.status()
        if rounds[-1].measure.max() <= tolerance:
            return Status.SOLVED
        return Status.ROUND_LIMIT if len(rounds) > MOST_MESHES else None

    how = measured, divided, lambda _, finer: finer.solved, ended
    *_, last = refined(profile, solved, *how)
    # A profile within the limits is kept if the finer mesh fails.
    if last.refused is None or excess_of(family, last.solution).max() <= tolerance:
        return last.solution
    return replace(last.solution, attempts=last.refused.attempts)


def _switching(profile: SpeedProfile) -> np.ndarray:
    """Return a mask [N] of intervals with a jump of s''', which cause most of the mesh's loss.

    The loss by a jump inside an interval is proportional to the jump and the squared interval.
    """
    jumps = np.abs(profile.j[1:] - (profile.j + profile.d)[:-1])
    # A jump lies between two intervals, so both get its loss.
    jumps = np.maximum(np.append(jumps, 0.0), np.append(0.0, jumps)) + np.abs(profile.d)
    loss = jumps * np.diff(profile.t) ** 2
    return loss > loss.mean()


SMOOTHING_FACTOR = 2.0  # factor between successive smoothings of dry friction
LEAST_SMOOTHING_FACTOR = 1.08  # smallest factor between successive smoothings


def _with_friction(
    family: LimitFamily, start: SpeedProfile, fast: bool, smoothing: float
) -> SpeedProfile:
    """Find a profile for the robot's dry friction by continuation from smoother friction."""
    profile, last, sharper = start, np.inf, SMOOTHING_FACTOR
    # A smoothing beyond the largest joint speed would remove friction altogether.
    widest = float(np.abs(start.curve.evaluate(start.s)[1] * start.v[:, None]).max())
    while True:
        closer = _closer_at_reversals(family, profile, smoothing)
        closer = _Timing(family, closer, fast, smoothing).solved(FIRST_BARRIER)
        profile = closer if closer.solved else replace(profile, attempts=closer.attempts)
        if closer.solved:
            last = smoothing
        elif np.isfinite(last):
            sharper = np.sqrt(sharper)  # a smaller step of the continuation
        ended = last == COULOMB_SMOOTHING or smoothing > widest or sharper < LEAST_SMOOTHING_FACTOR
        if ended or deadline.over():
            return profile
        wider = smoothing * sharper if np.isinf(last) else last / sharper
        smoothing = max(wider, COULOMB_SMOOTHING)


USUAL_PERCENTILE = 90.0  # percentile of the accelerations that represents all but single peaks


def _first_smoothing(family: LimitFamily, start: SpeedProfile) -> float:
    """Return the velocity, rad/s (m/s), within which friction may reverse in a feasible start.

    A reversal at the acceleration qdd changes the torque at the rate ``dry * qdd / velocity``,
    which must not exceed the limited torque rate. The result is at least the robot's own smoothing.
    """
    limits, dry = family.robot.limits, dry_friction(family.robot)
    limit = np.minimum(limits.taud_max, -limits.taud_min)
    rated = (dry > 0) & np.isfinite(limit) & (limit > 0)
    if "taud" not in family or not rated.any():
        return COULOMB_SMOOTHING
    shape = start.curve.evaluate(start.s[:-1])
    qdd = np.abs(samples_along(shape, (start.v[:-1], start.a)).qdd)
    turned = dry[rated] * np.percentile(qdd[:, rated], USUAL_PERCENTILE, axis=0) / limit[rated]
    return max(float(turned.max()), COULOMB_SMOOTHING)


MOST_PARTS = 8  # largest number of parts of an interval of a reversal
TURNED_VELOCITY = 2.0  # velocity from which friction is constant, per smoothing
REVERSAL_STEP = 0.7  # change of velocity in an interval of a reversal, per smoothing


def _closer_at_reversals(
    family: LimitFamily, profile: SpeedProfile, smoothing: float
) -> SpeedProfile:
    """Return the profile with more mesh points at reversals of joints with dry friction."""
    dry = dry_friction(family.robot) > 0
    if "taud" not in family or not dry.any():
        return profile
    velocity = (profile.curve.evaluate(profile.s)[1] * profile.v[:, None])[:, dry]
    before, after = velocity[:-1], velocity[1:]
    slow = np.minimum(np.abs(before), np.abs(after)) < TURNED_VELOCITY * smoothing
    slow |= before * after < 0
    change = np.where(slow, np.abs(after - before), 0.0).max(axis=1)
    parts = np.clip(np.ceil(change / (REVERSAL_STEP * smoothing)), 1, MOST_PARTS)
    return profile.at_times(with_parts(profile.t, parts.astype(int)))


def excess_of(family: LimitFamily, profile: SpeedProfile) -> FloatArray:
    """Return the largest relative excess [N,K] of any limit at K places of every interval."""
    shares = np.linspace(0.0, 1.0, CHECKS_PER_INTERVAL + 1)
    steps = np.diff(profile.t)
    i = np.repeat(np.arange(steps.size), shares.size)
    samples = profile.samples(i, (steps[:, None] * shares).ravel())
    return family.excess(samples).reshape(-1, shares.size)


SHORTEST_STEP = 1e-12  # smallest duration of an interval in the unit of time
SETTINGS = SolverSettings("ipopt", max_iterations=120)


class _Timing:
    """Nonlinear program of one curve on given places.

    The unit of time is that in which the start accelerates to its largest speed; the unit of s is
    the distance covered at that speed in that time.
    """

    def __init__(
        self,
        family: LimitFamily,
        start: SpeedProfile,
        fast: bool,
        smoothing: float = COULOMB_SMOOTHING,
    ) -> None:
        self.start, self.family, self.fast, curve = start, family, fast, start.curve
        self.free = curve.start_free, curve.end_free
        # A percentile of s'' sets the unit of time: single peaks would make it too short.
        speed = float(start.v.max())
        usual = float(np.percentile(np.abs(start.a), USUAL_PERCENTILE))
        self.time = speed / max(usual, speed / start.duration)
        self.unit = speed * self.time
        self.kinds = LimitKinds.of(family)
        n, robot = start.a.size, family.robot
        self.breaks = np.zeros(0, dtype=int)
        if not family.jerk_matters:  # the curvature, and with it s'', may jump at breaks
            self.breaks = np.flatnonzero(np.isin(start.s, curve.breaks[1:-1]))
        i, h = np.arange(n), np.diff(start.t)
        middle, *inner = (
            np.clip(start.inside(i, x * h)[0], start.s[:-1], start.s[1:])
            for x in (0.5, *SPEED_PLACES)
        )
        right, left, within = (
            _numbers(
                self.kinds, robot, curve.evaluate(s, from_left=side, highest=3), self.unit, fast
            )
            for s, side in ((start.s, False), (start.s, True), (middle, False))
        )
        steps = np.diff(start.s)[:, None] / self.unit
        varying = [key for key in self.kinds.further if family[key].varies]
        resting = MotionSamples.at_rest(curve.evaluate(middle[n // 2 : n // 2 + 1])[0])
        sizes = family.values(resting, varying)
        self.of_acceleration, self.of_rates = (
            LimitBounds.of(family, keys, sizes)
            for keys in (self.kinds.of_acceleration, self.kinds.of_rates)
        )
        common = [
            [self.time, smoothing],
            *(robot.friction_of(kind) for kind in (VISCOUS, DRY)),
            self.of_acceleration.size,
            self.of_rates.size,
        ]
        at_points = np.vstack([right, left[self.breaks]])
        self.of_points, self.of_intervals = (
            np.hstack([np.tile(np.concatenate(common), (len(table), 1)), table])
            for table in (at_points, np.hstack([right[:-1], left[1:], within, steps]))
        )
        v = self.unit / self.time
        self.speed, self.inner_speed = (
            largest_speeds(family, curve, s) / v for s in (start.s, np.stack(inner, axis=1).ravel())
        )

    def solved(self, barrier: float, bent: bool = False) -> SpeedProfile:
        """Solve the program; retry with another linear solver if the first one fails.

        Factors of the first linear solver, without pivots, are cheap, but rounding may hide
        negative curvature. Without limits of rates s'' is linear in every interval unless ``bent``.
        """
        n, start = self.start.a.size, self.start
        # Units of s', s'' and s''' in the program.
        v, a, j = (self.unit / self.time**k for k in (1, 2, 3))
        count = n + 1 + self.breaks.size
        points = np.concatenate([start.a, start.a_end[-1:], start.a_end[self.breaks - 1]])
        h = np.maximum(np.diff(start.t), SHORTEST_STEP * self.time) / self.time
        x = np.concatenate([start.v / v, points / a, h, start.d / j])
        free, none = np.full(count, np.inf), np.full(n, np.inf)
        # An infeasible start with a free d would overshoot limits between the few places at which
        # they are rows.
        bend = none if bent or self.family.jerk_matters else 0.0 * h
        # A positive lower bound of the durations keeps 1 / h finite.
        low = np.concatenate([np.zeros(n + 1), -free, np.full(n, SHORTEST_STEP), -bend])
        high = np.concatenate([self.speed, free, none, bend])
        for at, is_free in zip((0, n), self.free, strict=True):
            if not is_free:  # at a free end the vanishing tangent keeps the arm at rest
                low[at] = high[at] = 0.0
                if self.family.jerk_matters:
                    low[n + 1 + at] = high[n + 1 + at] = 0.0
        bounds = Bounds(low, high, *self._bounds(n, count))
        tables = self.of_points, self.of_intervals
        program = program_of(self.kinds, self.fast, self.breaks, *tables, bounds)
        attempts, guess = list(start.attempts), np.clip(x, low, high)
        for options in (LDL, {}):
            settings = replace(SETTINGS, initial_barrier=barrier, options=options)
            outcome = Runner(program, settings).run("ipopt", StartingPoint(guess))
            x, (rows, variables) = outcome.point.x, outcome.point.multipliers
            cost = outcome.attempt.cost * self.time
            attempts.append(replace(outcome.attempt, cost=cost))
            if outcome.attempt.status.solved or deadline.over():
                break
            barrier = FIRST_BARRIER
        if not attempts[-1].status.solved:
            return replace(start, attempts=tuple(attempts))
        # The solver's own multipliers leave its dual residual out of the gap.
        lam = np.concatenate([variables, rows])
        gap = gap_of(program, x, program.row_values(x), np.zeros(1), lam).total
        h, points = x[n + 1 + count : 2 * n + 1 + count], x[n + 1 : n + 1 + count] * a
        h = np.maximum(h, SHORTEST_STEP)  # IPOPT relaxes its bounds by 1e-8
        ends = points[1 : n + 1].copy()
        ends[self.breaks - 1] = points[n + 1 :]
        return replace(
            start,
            v=x[: n + 1] * v,
            t=np.append(0.0, np.cumsum(h)) * self.time,
            a=points[:n],
            a_end=ends,
            d=x[2 * n + 1 + count :] * j,
            gap=gap * self.time,
            attempts=tuple(attempts),
        )

    def _bounds(self, n: int, count: int) -> tuple[FloatArray, FloatArray]:
        """Return the bounds of all rows, in the order of the program."""
        sides = []
        for side, speed in (("lower", np.full(2 * n, -np.inf)), ("upper", self.inner_speed)):
            of_point, of_rate = (
                getattr(bounds, side) for bounds in (self.of_acceleration, self.of_rates)
            )
            same = np.concatenate([[0.0, 0.0], of_rate, of_rate, of_rate, of_point])
            of_intervals = np.hstack([np.tile(same, (n, 1)), speed.reshape(n, 2)])
            sides.append(np.concatenate([np.tile(of_point, count), of_intervals.ravel()]))
        return sides[0], sides[1]


# coefficients at places -------------------------------------------------------------------------


def _numbers(
    kinds: LimitKinds, robot: Robot, shape: Sequence[FloatArray], unit: float, fast: bool
) -> FloatArray:
    """Return the coefficients [N,K] of limits at places, for s in the given unit.

    ``shape`` holds the pose and its three derivatives by s, each [N,n].
    """
    parts = [derivative * unit**k for k, derivative in enumerate(shape)]
    if kinds.dynamics:
        parts += _torques(robot, parts, fast)
    return np.hstack(parts)


def _torques(robot: Robot, shape: Sequence[FloatArray], fast: bool) -> tuple[FloatArray, ...]:
    """Return m, c and g of equation (6) without friction, and their slopes along s, each [N,n].

    ``shape`` holds the pose and its three derivatives by s, each [N,n]. Three calls of the torque
    ``m s'' + c s'^2 + g`` and its rate ``(m' + 2 c) s' s'' + c' s'^3 + g' s'`` determine them:
    for (s', s'') of (1, 0), (2, 0) and (1, 1), with s''' = 0.
    """
    q, tangent, curvature, bend = shape
    call = deferred_call(torque_and_rate(frictionless(robot)), compiled=fast)

    def at(v: float, a: float) -> tuple[FloatArray, FloatArray]:
        qdd = a * tangent + v**2 * curvature
        qddd = 3 * v * a * curvature + v**3 * bend
        return call(q, v * tangent, qdd, qddd)

    (once, once_rate), (twice, twice_rate) = at(1.0, 0.0), at(2.0, 0.0)
    pushed, pushed_rate = at(1.0, 1.0)
    # The torques are once = c + g and twice = 4 c + g, their rates c' + g' and 8 c' + 2 g'.
    c = (twice - once) / 3.0
    c_rate = (twice_rate - 2.0 * once_rate) / 6.0
    m_rate = pushed_rate - once_rate - 2.0 * c
    return pushed - once, c, once - c, m_rate, c_rate, once_rate - c_rate
