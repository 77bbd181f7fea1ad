"""Speed override and stop on the path: the speed of a motion under way changed within its limits.

The path parameter s is the time of the motion as planned. Scaling the speed by k scales inertial
torques by k^2 but not gravity, so the limits decide how soon the speed may change, and path timing
finds the earliest change. Limits of torque rates, jerk or power are beyond path timing: under them
the speed follows a cubic of time whose start and end are searched, and the limit family judges it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import ROUNDING, FloatArray, InputError
from microbot_ocp._base.codegen import compiles
from microbot_ocp._base.outcome import Outcome
from microbot_ocp._base.status import Status
from microbot_ocp.certificate import limit_checks_of
from microbot_ocp.execution._load import refuse_other_arm
from microbot_ocp.limits import (
    LIMIT_TOLERANCE,
    JointLimits,
    LimitFamily,
    Limits,
    MotionSamples,
)
from microbot_ocp.motion import (
    JUMP_GAP,
    SAMPLE_STEP,
    Motion,
    State,
    dense_times,
    jump_gaps,
    mesh_of,
    polynomial_of,
    sample_times,
)
from microbot_ocp.planning import PathTimingSettings
from microbot_ocp.planning.free import MOST_GRIDS, with_steady_ends
from microbot_ocp.planning.path import (
    CurveLimits,
    CurvePiece,
    PathCurve,
    Reached,
    reach,
    sampled,
    samples_along,
)
from microbot_ocp.planning.task import with_locked_joints_held
from microbot_ocp.robot import Robot

Samples = tuple[FloatArray, State, FloatArray]  # sample times, states, and ends of pieces
Places = tuple[FloatArray, FloatArray]  # path parameters, and their times
TOLERANCE = PathTimingSettings.limit_tolerance


UNCHANGED = "Within its limits the motion cannot change its speed from here: it goes on as planned."
EXCEEDED = "limits are exceeded by {:.3g} % between points of the grid: give a larger grid"
BROKEN = (
    "a change of speed must keep the limits of torque rate, jerk or power, but the motion itself "
    "breaks them: its {}; plan it under these limits, or give limits without them"
)


def overridden(
    robot: Robot,
    motion: Motion,
    at: float,
    speed: float,
    *,
    current: float = 1.0,
    limits: Limits | JointLimits | None = None,
    grid: int = PathTimingSettings.grid,
    compiled: bool = True,
) -> Motion:
    """Change the speed of a motion under way on its path, as soon as the limits allow.

    Parameters
    ----------
    robot : Robot
        Arm that executes the motion.
    motion : Motion
        Motion as planned.
    at : float
        Present place on the path: the time of the motion as planned, s.
    speed : float
        New speed as a fraction of the planned speed, 0 to 1; 0 stops the arm on the path as soon
        as possible.
    current : float
        Present speed as a fraction of the planned speed; 0 if the arm rests after a stop.
    limits : Limits, optional
        Limits to keep; default the robot's own. Limits of velocity, acceleration and torque are
        widened to the values of the motion itself. Under limits of torque rates, jerk, power or
        others that are not half planes of acceleration, the speed changes along a cubic of time,
        the earliest that keeps all limits; earlier changes of another form are not searched.
    grid : int
        Number of grid points on the path besides the breaks of the motion; unused under limits of
        torque rates, jerk or power.
    compiled : bool
        True to use compiled functions if there is a compiler.

    Returns
    -------
    Motion
        Motion from the present state on. Its provenance holds "at", the end on the planned motion,
        to resume from, and "changed_at", the time at which the new speed is reached, s. If the
        limits allow no change of the present speed, the status is "infeasible" and the rest of the
        motion is returned as planned.

    Raises
    ------
    InputError
        The time is outside the motion, a fraction is outside of 0 to 1, the motion itself exceeds
        limits of torque rates, jerk or power, or it belongs to an arm with another payload.

    Examples
    --------
    >>> import numpy as np
    >>> import microbot_ocp as mo
    >>> robot = mo.load_robot("microbot")
    >>> via_q = np.radians([[0, 0, 0], [-90, 90, 90]])
    >>> motion = mo.time_optimal(robot, via_q, reserve=0.1, mesh=40, starts=1)
    >>> stop = mo.execution.overridden(robot, motion, 0.5, 0.0)
    >>> stop.solved, bool(abs(stop.qd[-1]).max() < 1e-6), stop.duration < 0.5
    (True, True, True)
    >>> on = mo.execution.overridden(robot, motion, stop.provenance["at"], 1.0, current=0.0)
    >>> on.solved, bool(np.allclose(on.q[-1], via_q[-1], atol=1e-6))
    (True, True)
    """
    refuse_other_arm(robot, motion)
    checks.number("at", at, "s", at_least=0.0)
    if not at < motion.duration:
        raise InputError(f"at must be before the motion ends, {motion.duration:.6g} s, not {at:g}")
    for name, share in (("speed", speed), ("current", current)):
        checks.number(name, share, at_least=0.0, at_most=1.0)
    rests = not np.any(motion.sample([at]).qd)
    if not speed and (rests or not current):
        raise InputError("speed must be above 0, as the arm rests already")
    family = LimitFamily.of(robot, limits)
    family.refuse_means()
    shape = polynomial_of(motion)
    pieces = zip(shape.coefficients, np.diff(shape.breaks), strict=True)
    curve = PathCurve(tuple(CurvePiece(table, float(d)) for table, d in pieces), True, True)
    evenly = np.linspace(at, motion.duration, grid + 1)
    s = np.union1d(evenly, shape.breaks[shape.breaks > at])
    s = s[np.append(np.diff(s) > ROUNDING * motion.duration, True)]
    # A motion at its limits within the tolerance must remain feasible at its own speed.
    widened = with_locked_joints_held(_widened_limits(family, motion), None)
    override = _Override(motion, widened, curve, s, current, rests, compiles(compiled))
    if later := override.along.limits.later:
        return _changed_by_ramp(
            family, motion, _Ramp(at, speed if rests else current, speed), later
        )
    for _ in range(MOST_GRIDS):
        changed, timing = override.soonest(speed)
        outcome = Outcome.of(Status.SOLVED)
        if not timing.feasible:
            outcome = Outcome.of(Status.INFEASIBLE, UNCHANGED)
            changed, timing = 0, override.as_planned()
        timing, excess = override.judged(timing)
        if not outcome.solved or excess.max() <= TOLERANCE:
            break
        override = override.finer(excess > TOLERANCE)
    places, changed_at = (timing.s, timing.t), float(timing.t[changed])
    samples = sampled([(curve, timing)])
    other = _retimed(override.family.robot, motion, samples, places, changed_at)
    return _with_outcome(other, outcome, float(excess.max()))


@dataclass(frozen=True, eq=False)
class _Override:
    """Rest of a motion as a path, with a grid and the present speed of the arm."""

    planned: Motion
    family: LimitFamily
    curve: PathCurve
    s: FloatArray  # grid of path parameters
    current: float
    rests: bool  # True if the planned motion itself rests at the start
    fast: bool

    @cached_property
    def along(self) -> CurveLimits:
        """Limits on the grid."""
        return self._limits_at(self.s)

    def _limits_at(self, s: FloatArray) -> CurveLimits:
        return CurveLimits.of(self.family, self.curve, s, self.fast)

    def soonest(self, speed: float) -> tuple[int, Reached]:
        """Return the first grid point from which on a speed can be kept, with its timing."""
        last = self.s.size - 1
        # Bisection assumes that a feasible place has only feasible places after it.
        places = np.arange(last + 1) if speed else self._where_it_can_rest()
        best, low, high = (last, self._timed(last, speed)), -1, places.size - 1
        while best[1].feasible and high - low > 1:
            middle = (low + high) // 2
            timing = self._timed(int(places[middle]), speed)
            low, high = (low, middle) if timing.feasible else (middle, high)
            best = (int(places[middle]), timing) if timing.feasible else best
        return best

    def _where_it_can_rest(self) -> np.ndarray:
        """Return the grid points, from the second interval's end on, at which the arm can rest."""
        poses = MotionSamples.at_rest(self.curve.evaluate(self.s)[0])
        return np.flatnonzero((self.family.excess(poses) <= 0.0) & (np.arange(self.s.size) > 1))

    def _timed(self, place: int, speed: float) -> Reached:
        """Return the timing at a speed from a grid point on, or stopped there."""
        along, last = self.along, self.s.size - 1
        if not speed and place < last:
            along = self._limits_at(self.s[: place + 1])
        before = np.arange(along.s.size) < place
        return reach(
            along,
            start_free=self.rests,
            end_free=along.s.size > last,
            fastest=np.where(before | (speed == 0.0), max(self.current, speed), speed),
            ends=(self.current, 0.0),
        )

    def as_planned(self) -> Reached:
        """Return the timing of the planned motion."""
        s, still = self.s, np.zeros(self.s.size - 1)
        return Reached(s, np.ones(s.size), still, still, s - s[0], True, float("nan"))

    def judged(self, timing: Reached) -> tuple[Reached, FloatArray]:
        """Return the timing with steady ends, and the excess over limits in each interval."""
        ends = [0] * self.rests + [-1] * (timing.s.size == self.s.size)
        timing = with_steady_ends(timing, ends)
        return timing, self._limits_at(timing.s).excess(timing)

    def finer(self, cut: np.ndarray) -> _Override:
        """Return this path with the marked ones of its first intervals halved."""
        s = self.s
        middles = 0.5 * (s[1:] + s[:-1])[: cut.size][cut]
        return replace(self, s=np.sort(np.concatenate([s, middles])))


def _retimed(
    robot: Robot, planned: Motion, samples: Samples, places: Places, changed_at: float
) -> Motion:
    """Return the motion with another timing of its path."""
    t, state, breaks = samples
    first, last = places[0][[0, -1]]
    ahead = [mark for mark in planned.marks if first < mark.time <= last]
    marks = [replace(mark, time=float(np.interp(mark.time, *places))) for mark in ahead]
    provenance = {"method": "speed override", "at": float(last)}
    provenance["changed_at"] = changed_at
    return Motion.from_state(
        robot, t, state, label=planned.label, breaks=breaks, marks=marks, provenance=provenance
    )


def _with_outcome(motion: Motion, outcome: Outcome, excess: float) -> Motion:
    if outcome.solved and excess > TOLERANCE:
        outcome = Outcome.of(Status.LIMITS_EXCEEDED, EXCEEDED.format(100.0 * excess))
    return motion.ended(outcome, excess=excess)


@dataclass(frozen=True)
class _Ramp:
    """Speed on the path from a place ``at`` on that changes along a cubic of time.

    With x = (t - begin) / lasts: ds/dt = current + (speed - current) (3 x^2 - 2 x^3).
    """

    at: float
    current: float
    speed: float
    begin: float = 0.0
    lasts: float = 0.0

    @property
    def end(self) -> float:
        return self.begin + self.lasts

    def along(self, t: FloatArray) -> tuple[FloatArray, ...]:
        """Return the path parameter and its three time derivatives at times t [N]."""
        lasts, change = max(self.lasts, ROUNDING), self.speed - self.current
        x = np.clip((t - self.begin) / lasts, 0.0, 1.0)
        after = np.maximum(t - self.end, 0.0)
        inside = (t >= self.begin) & (t <= self.end)
        return (
            self.at + self.current * t + change * (lasts * x**3 * (1.0 - 0.5 * x) + after),
            self.current + change * x**2 * (3.0 - 2.0 * x),
            change * 6.0 * x * (1.0 - x) / lasts,
            change * (6.0 - 12.0 * x) / lasts**2 * inside,
        )


def _state_at(motion: Motion, place: Sequence[FloatArray]) -> MotionSamples:
    """Return the state at places of the planned motion, with the speed's derivatives."""
    s = np.minimum(place[0], motion.duration)
    return samples_along(motion.samples(s), place[1:])


RAMP_PARTS = 20  # smallest number of intervals of a ramp between samples


def _changed_by_ramp(
    family: LimitFamily, motion: Motion, wanted: _Ramp, later: Sequence[str]
) -> Motion:
    """Change the speed by the earliest ramp that keeps all limits."""
    judged, _ = limit_checks_of(family, motion.history())
    excessive = [c for c in judged if c.quantity in later and c.violation > LIMIT_TOLERANCE]
    if excessive:
        raise InputError(BROKEN.format(", ".join(c.excess for c in excessive)))
    most = {c.quantity: np.fmax(1.0, c.utilisation) * (1.0 + TOLERANCE) for c in judged}

    def keeps(place: Sequence[FloatArray]) -> np.ndarray:
        uses = family.use(_state_at(motion, place)).items()
        return np.all([(use <= most[key]).all(axis=1) for key, use in uses], axis=0)

    ramp = _soonest_ramp(wanted, motion, keeps)
    outcome = Outcome.of(Status.SOLVED)
    if ramp is None:
        outcome = Outcome.of(Status.INFEASIBLE, UNCHANGED)
        ramp = _Ramp(wanted.at, 1.0, 1.0, 0.0, motion.duration - wanted.at)
    reached = float(ramp.along(np.array([ramp.end]))[0][0])
    lasts = ramp.end + ((motion.duration - reached) / ramp.speed if ramp.speed else 0.0)
    even = np.linspace(0.0, lasts, RAMP_PARTS * motion.t.size)
    places = ramp.along(even)[0], even
    # Jumps and breaks of the plan move to the times at which the ramp reaches them.
    before_jumps = motion.t[:-1][jump_gaps(motion.t)]
    after = [some[some > ramp.at + JUMP_GAP] for some in (before_jumps, mesh_of(motion))]
    jumps, breaks = (np.interp(each[each < places[0][-1]], *places) for each in after)
    breaks = np.unique([0.0, *breaks, ramp.begin, ramp.end, lasts])
    same = 0.1 * JUMP_GAP
    breaks = np.append(breaks[:-1][np.diff(breaks) > same], lasts)
    begun, ended = breaks >= ramp.begin - same, breaks >= ramp.end - same
    parts = (
        (breaks <= ramp.begin + same, SAMPLE_STEP),
        (begun & (breaks <= ramp.end + same), ramp.lasts / RAMP_PARTS),
        (ended, SAMPLE_STEP),
    )
    none = np.zeros(0)
    times = [sample_times(breaks[k], none, step, 5) for k, step in parts if k.sum() > 1]
    t = np.unique(np.concatenate([jumps, *times]))
    state = State(*_state_at(motion, ramp.along(t))[:3])
    other = _retimed(family.robot, motion, (t, state, breaks), places, ramp.end)
    judged, _ = limit_checks_of(family, other.history())
    excess = max(float(np.nanmax(c.utilisation / most[c.quantity])) for c in judged) - 1.0
    return _with_outcome(other, outcome, excess)


RAMP_STARTS = 21  # samples of the plan that are tried first as starts of a ramp
RAMP_ENDS = 40  # samples of the plan that are tried first as ends of a ramp
COARSE_SAMPLES = 100  # points of a ramp at which limits are checked first
DENSE_SAMPLES = 4  # points of the second check per usual sample of a motion


def _soonest_ramp(
    wanted: _Ramp, motion: Motion, keeps: Callable[[Sequence[FloatArray]], np.ndarray]
) -> _Ramp | None:
    """Return the earliest-ending ramp of those tried; None if no ramp keeps all limits."""
    current, speed, at = wanted.current, wanted.speed, wanted.at
    s = np.append(at, motion.t[motion.t > at + JUMP_GAP])
    s = np.append(s[:-1][~jump_gaps(s)], s[-1])  # a ramp must not begin or end within a jump
    dense = dense_times(motion)[0]
    dense = np.append(at, dense[dense > at])
    none = np.zeros_like(dense)
    at_current, at_speed = (keeps((dense, none + v, none, none)) for v in (current, speed))
    broken = dense[~at_current], dense[~at_speed] if speed else [-np.inf]
    begins = np.flatnonzero(s < np.min(broken[0], initial=np.inf)) if current else np.array([0])
    ends = np.flatnonzero(s > np.max(broken[1], initial=-np.inf))
    best = None
    if current and not speed and at_current.all():  # at the latest it rests at the motion's end
        best = replace(wanted, begin=(s[-1] - at) / current)

    def between(i: int, k: int) -> _Ramp:
        begin = (s[i] - at) / current if current else 0.0
        return replace(wanted, begin=begin, lasts=2.0 * (s[k] - s[i]) / (current + speed))

    # A coarse check rejects most ramps before the dense one.
    def works(ramp: _Ramp) -> bool:
        counts = COARSE_SAMPLES, int(DENSE_SAMPLES * ramp.lasts / SAMPLE_STEP)
        shares = (np.linspace(0.0, 1.0, max(count, 2)) for count in counts)
        return all(keeps(ramp.along(ramp.begin + x * ramp.lasts)).all() for x in shares)

    for i in _evenly_chosen(begins, RAMP_STARTS):
        later = ends[ends > i]
        low = 0
        for high in _evenly_chosen(np.arange(later.size), RAMP_ENDS):
            ramp = between(i, int(later[high]))
            if best is not None and ramp.end >= best.end:
                break
            if not works(ramp):
                low = high
                continue
            best = ramp
            while high - low > 1:
                middle = (low + high) // 2
                ramp = between(i, int(later[middle]))
                low, high, best = (low, middle, ramp) if works(ramp) else (middle, high, best)
            break
    return best


def _evenly_chosen(places: np.ndarray, count: int) -> list[int]:
    """Return at most ``count`` of the places, evenly spread, with the first and the last."""
    chosen = np.linspace(0, len(places) - 1, min(count, len(places)), dtype=int)
    return places[np.unique(chosen)].tolist()


def _widened_limits(family: LimitFamily, motion: Motion) -> LimitFamily:
    """Return the limits, widened to the values of the motion itself."""
    samples = motion.history().samples
    bounds, also = {}, []
    for member in family:
        value, low, high = family.values(samples, [member.key])[member.key]
        if member.order in (1, 2) and not member.varies:
            least, most = np.minimum(value.min(axis=0), low), np.maximum(value.max(axis=0), high)
            low = np.minimum(low, least - TOLERANCE * np.abs(least))
            high = np.maximum(high, most + TOLERANCE * np.abs(most))
            if member.limit is None:
                bounds[f"{member.key}_min"], bounds[f"{member.key}_max"] = low, high
            else:
                also.append(replace(member.limit, lower=low, upper=high))
                continue
        also += [member.limit] if member.limit else []
    return LimitFamily.of(family.robot, family.robot.limits.changed({**bounds, "also": also}))
