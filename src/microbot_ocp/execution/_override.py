"""Speed override and stop on the path: a motion under way, slowed down within its torques.

The place on the path is the time s of the motion as planned. An even share of its speed divides
what moves by more than what holds: gravity does not scale. How soon the speed may change is what
the limits leave, so the change is timed by the passes of path timing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import InputError
from microbot_ocp._base.codegen import compiles
from microbot_ocp._base.outcome import Outcome
from microbot_ocp._base.status import Status
from microbot_ocp.limits import JointLimits, LimitFamily, Limits, MotionSamples
from microbot_ocp.motion import Motion, PiecewisePolynomial, pieces_of
from microbot_ocp.planning import PathTimingSettings
from microbot_ocp.planning.free import with_steady_ends
from microbot_ocp.planning.path import (
    LATER,
    CurveLimits,
    CurvePiece,
    PathCurve,
    Reached,
    limits_kept_by,
    reach,
    sampled,
)
from microbot_ocp.planning.task import with_locked_joints_held
from microbot_ocp.robot import Robot

TOLERANCE = PathTimingSettings.limit_tolerance
UNCHANGED = "Within the limits the motion cannot go on from here at any other speed on its path."
EXCEEDED = "limits are exceeded by {:.3g} % between places of the grid: give a finer grid"


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
    """Change the speed of a motion that is under way, as soon as the limits allow, on its path.

    Parameters
    ----------
    robot : Robot
    motion : Motion
        As planned.
    at : float
        Where on it the arm is: its time in the motion as planned, s.
    speed : float
        Share of the planned speed to go on with, 0 to 1; 0 stops the arm on the path after the
        shortest way.
    current : float
        Share of the planned speed that the arm has now; 0 where it rests after a stop.
    limits : Limits, optional
        Default the robot's own. What the motion itself exceeds them by is let pass.
    grid : int
        Places on the path besides the breaks of the motion.
    compiled : bool
        Use compiled functions where there is a compiler.

    Returns
    -------
    Motion
        From the present state on. "at" in the provenance is where on the planned motion it ends,
        to resume from, and "changed_at" where the new speed is reached, s. The status is
        "infeasible" where the limits leave no speed to go on with from the present one; the rest of
        the motion is returned as planned then. Limits of rates are not kept, as the remark says.

    Raises
    ------
    InputError
        A time outside the motion, a share outside of 0 to 1.

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
    checks.number("at", at, "s", at_least=0.0)
    if not at < motion.duration:
        raise InputError(f"at must be before the motion ends, {motion.duration:.6g} s, not {at:g}")
    for name, share in (("speed", speed), ("current", current)):
        checks.number(name, share, at_least=0.0, at_most=1.0)
    if not (speed or current):
        raise InputError(
            "speed and current are both 0: an arm that rests in a stop goes on resting"
        )
    override = _Override.of(robot, motion, at, current, limits, grid, compiles(compiled))
    changed, timing = override.soonest(speed)
    outcome = Outcome.of(Status.SOLVED)
    if not timing.feasible:
        outcome = Outcome.of(Status.INFEASIBLE, UNCHANGED)
        changed, timing = 0, override.as_planned()
    return override.motion(timing, changed, outcome)


@dataclass(frozen=True, eq=False)
class _Override:
    """A motion from some time on as a path, with a grid, and the arm's present speed on it."""

    planned: Motion
    robot: Robot
    curve: PathCurve
    along: CurveLimits
    current: float
    rests: bool  # where it begins, whatever the speed
    fast: bool

    @classmethod
    def of(
        cls,
        robot: Robot,
        motion: Motion,
        at: float,
        current: float,
        limits: Limits | JointLimits | None,
        grid: int,
        fast: bool,
    ) -> _Override:
        shape = PiecewisePolynomial(motion.t, pieces_of(motion))
        family = with_locked_joints_held(_widened(LimitFamily.of(robot, limits), motion), None)
        pieces = zip(shape.coefficients, np.diff(shape.breaks), strict=True)
        curve = PathCurve(tuple(CurvePiece(table, float(d)) for table, d in pieces), True, True)
        evenly = np.linspace(at, motion.duration, grid + 1)
        s = np.union1d(evenly, shape.breaks[shape.breaks > at])
        s = s[np.append(np.diff(s) > 1e-9 * motion.duration, True)]
        rests = not np.any(motion.sample([at]).qd)
        return cls(
            motion, robot, curve, CurveLimits.of(family, curve, s, fast), current, rests, fast
        )

    def soonest(self, speed: float) -> tuple[int, Reached]:
        """The first place of the grid from which on a speed can be kept, with its timing."""
        last = self.along.s.size - 1
        places = np.arange(last + 1) if speed else self._where_it_can_rest()
        best, low, high = (last, self._timed(last, speed)), -1, places.size - 1
        while best[1].feasible and high - low > 1:
            middle = (low + high) // 2
            timing = self._timed(int(places[middle]), speed)
            low, high = (low, middle) if timing.feasible else (middle, high)
            best = (int(places[middle]), timing) if timing.feasible else best
        return best

    def _where_it_can_rest(self) -> np.ndarray:
        """Places of the grid, from the second interval's end on, where the limits hold at rest."""
        q = self.curve.evaluate(self.along.s)[0]
        still = np.zeros_like(q)
        holds = self.along.limits.family.excess(MotionSamples(q, still, still, still)) <= 0.0
        return np.flatnonzero(holds & (np.arange(len(q)) > 1))

    def _timed(self, place: int, speed: float) -> Reached:
        """At a speed from a place of the grid on, or stopped there."""
        along, last = self.along, self.along.s.size - 1
        if not speed and place < last:
            along = CurveLimits.of(along.limits.family, self.curve, along.s[: place + 1], self.fast)
        before = np.arange(along.s.size) < place
        return reach(
            along,
            start_free=self.rests,
            end_free=along.s.size > last,
            fast=self.fast,
            fastest=np.where(before | (speed == 0.0), max(self.current, speed), speed),
            ends=(self.current, 0.0),
        )

    def as_planned(self) -> Reached:
        """The timing of the motion itself."""
        s = self.along.s
        still = np.zeros(s.size - 1)
        return Reached(s, np.ones(s.size), still, still, s - s[0], True, float("nan"))

    def motion(self, timing: Reached, changed: int, outcome: Outcome) -> Motion:
        """What follows, from the present state on."""
        ends = [0] * self.rests + [-1] * (timing.s.size == self.along.s.size)
        timing = with_steady_ends(timing, ends)
        along = CurveLimits.of(self.along.limits.family, self.curve, timing.s, self.fast)
        excess = float(along.excess(timing, self.curve).max())
        if outcome.solved and excess > TOLERANCE:
            outcome = Outcome.of(Status.LIMITS_EXCEEDED, EXCEEDED.format(100.0 * excess))
        t, state, breaks = sampled([(self.curve, timing)])
        marks = [
            replace(mark, time=float(np.interp(mark.time, timing.s, timing.t)))
            for mark in self.planned.marks
            if timing.s[0] < mark.time <= timing.s[-1]
        ]
        unkept = ", ".join(limits_kept_by(along.limits)[LATER])
        motion = Motion.from_state(
            self.robot,
            t,
            state,
            label=self.planned.label,
            breaks=breaks,
            marks=marks,
            provenance={
                "method": "another speed on the path, by reachability",
                "at": float(timing.s[-1]),
                "changed_at": float(timing.t[changed]),
            },
            remark=f"not kept: {unkept}" if unkept else "",
        )
        return motion.ended(outcome, excess=excess)


def _widened(family: LimitFamily, motion: Motion) -> LimitFamily:
    """Limits as they are, or as the motion uses them where that is more."""
    _, samples = motion.dense_samples()
    bounds, limits = {}, family.robot.limits
    for key in family.keys:
        if family[key].limit is None and key in ("qd", "qdd", "tau"):
            values = family.values(samples, [key])[key].value
            slack = 1.0 + TOLERANCE
            low, high = limits.bounds(key)
            bounds[f"{key}_min"] = np.minimum(low, slack * np.minimum(values.min(axis=0), low))
            bounds[f"{key}_max"] = np.maximum(high, slack * np.maximum(values.max(axis=0), high))
    return LimitFamily.of(family.robot, limits.changed(bounds))
