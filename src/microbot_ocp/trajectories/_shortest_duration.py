"""The shortest duration at which a shape of motion keeps the limits of a robot."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.status import Status
from microbot_ocp.limits import ROUNDING, LimitFamily, Member, Peak, largest_jump, largest_use
from microbot_ocp.motion import PiecewisePolynomial
from microbot_ocp.robot import JointLimits, Limits, Robot

MakeMotion = Callable[[float], PiecewisePolynomial]


LONGEST_DURATION = 1e6  # longest duration, per first duration


@dataclass(frozen=True)
class Scaled:
    """A motion as short as its shape and the limits allow.

    Attributes
    ----------
    polynomial : PiecewisePolynomial
        Motion that keeps every limit.
    duration : float
        Duration of the motion, s.
    factor : float
        Duration divided by that of the given shape; NaN for a callable.
    quantity : str
        Key of the limit that is just met, such as "tau"; "q" if a shorter motion of a callable
        leaves the position limits, "shape" if the callable refuses one.
    joint : str
        Name of the joint at the limit; empty for a limit that is not of a joint.
    time : float
        Time at which the limit is met, s.
    value, limit : float
        Value at that time and the limit, in ``unit``.
    unit : str
    utilisation : float
        Largest share of any limit that depends on the duration, 1 or just below.
    iterations : int
        Number of durations that were tried.
    wall_time : float
        Wall time, s.
    status : Status
        Status SOLVED or TIME_LIMIT.
    split : array [k], optional
        Durations of the parts from :func:`best_split`, s.
    """

    polynomial: PiecewisePolynomial
    duration: float
    factor: float
    quantity: str
    joint: str
    time: float
    value: float
    limit: float
    unit: str
    utilisation: float
    iterations: int
    wall_time: float
    status: Status = Status.SOLVED
    split: FloatArray | None = None

    @property
    def solved(self) -> bool:
        """True if no shorter duration keeps the limits."""
        return self.status.solved


def shortest_duration(
    robot: Robot,
    make_motion: PiecewisePolynomial | MakeMotion,
    limits: Limits | JointLimits | None = None,
    *,
    first_duration: float = 1.0,
    tolerance: float = 1e-8,
    scan: bool = True,
    time_limit: float = np.inf,
) -> Scaled:
    """Return the shortest duration at which a shape of motion keeps every limit.

    Let a motion be stretched in time by the factor l. Velocities scale with 1/l, accelerations
    with 1/l^2, and the torque at each point of the path is ``g(q) + c / l^2`` with gravity g
    and inertial and Coriolis terms c (Hollerbach, *Dynamic scaling of manipulator
    trajectories*, ASME Journal of Dynamic Systems, Measurement, and Control 106, 1984). Without
    joint friction each torque is affine in 1/l^2. If gravity alone is within the limits, the
    feasible durations are therefore all durations from some T*, which a bracketed root search
    on the largest use of any limit finds. Viscous friction adds a term in 1/l, with which an
    instant may be infeasible only for an interval of durations. For this case, for Coulomb
    friction and for a callable the search therefore descends from long durations in steps of 5
    %. Position limits, which do not depend on the duration, and the torque at rest are checked
    first.

    The largest use is evaluated on a dense grid of every piece (both one-sided limits at each
    break), and its maxima are refined.

    Parameters
    ----------
    robot : Robot
    make_motion : PiecewisePolynomial or callable
        Shape, which is stretched uniformly, or ``duration (s) -> PiecewisePolynomial`` of that
        duration; an InputError of the callable means that the duration is too short.
    limits : Limits or JointLimits, optional
        Limits; default ``robot.limits``.
    first_duration : float
        First duration for a callable, s.
    tolerance : float
        Largest unused share of the limit that the result meets.
    scan : bool
        False to bisect in place of the descent: with fewer evaluations, but the result, which keeps
        the limits, may lie beyond a gap.
    time_limit : float
        Wall time, s, after which the shortest duration so far has the status "time limit"; its
        ``utilisation`` is above 1 if no duration of a callable has kept the limits.

    Returns
    -------
    Scaled
        Shortest motion of the shape, with the limit that it meets.

    Raises
    ------
    InputError
        There is no limit; the shape leaves the position limits; gravity alone exceeds the torque
        limits; the torque jumps, at an end at rest or inside, under a limit of its rate (likewise
        the acceleration under one of jerk); or no limit bounds the motion.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> from microbot_ocp.trajectories import cubic, shortest_duration
    >>> robot = mo.load_robot("microbot")
    >>> shape = cubic([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]], [0.0, 1.0])
    >>> found = shortest_duration(robot, shape, mo.Limits(qd_max=2.0))
    >>> round(found.duration, 6), found.quantity, found.joint  # 1.5 L / v
    (1.5, 'qd', 'waist')
    """
    started = time.perf_counter()
    with deadline.within(time_limit):
        search = _DurationSearch(robot, make_motion, limits, first_duration, tolerance, scan)
        return search.run(started)


SCAN_RATIO = 1.05  # ratio of successive durations where the feasible set may have gaps


class _Attempt(NamedTuple):
    """A duration, s, and the largest use of the limits at it."""

    duration: float
    peak: Peak


class _DurationSearch:
    """One search for the shortest duration, which counts the durations that it tries."""

    def __init__(
        self,
        robot: Robot,
        make_motion: PiecewisePolynomial | MakeMotion,
        limits: Limits | JointLimits | None,
        first_duration: float,
        tolerance: float,
        scan: bool,
    ) -> None:
        self.robot = robot
        self.tolerance = checks.number("tolerance", tolerance, above=0.0, at_most=1e-3)
        self.family = LimitFamily.of(robot, limits)
        self.family.refuse_means()
        self.kinds = self.family.of_order(1, 2, 3)
        if not self.kinds:
            raise InputError(
                "limits must hold a finite qd_max, qdd_max, tau_max or another limit of the motion "
                "for at least one joint, or no duration is too short"
            )
        self.tried, self.refusal = 0, ""
        self.shape: PiecewisePolynomial | None = None
        if isinstance(make_motion, PiecewisePolynomial):
            self.shape = shape = checked_shape(robot, make_motion)
            self.first = shape.duration
            self.make: MakeMotion = lambda duration: shape.stretched(duration / shape.duration)
            if refusal := refusal_of(robot, self.family, shape):
                raise InputError(refusal)
        else:
            self.first = checks.number("first_duration", first_duration, "s", above=0.0)
            self.make = make_motion
        friction = any(link.viscous_friction or link.coulomb_friction for link in robot.links)
        # The use of a shape without friction falls with the duration. Nothing is known about the
        # user's own limits.
        self.from_above = scan and (
            self.shape is None
            or (friction and bool({"tau", "taud"} & set(self.kinds)))
            or any(member.limit is not None for member in self.family)
        )

    def evaluate(self, duration: float) -> _Attempt:
        """Return the largest use of the limits at this duration."""
        self.tried += 1
        try:
            polynomial = self.make(duration)
        except InputError as problem:
            self.refusal = f": {problem}"
            return _Attempt(duration, Peak(np.inf))
        if self.shape is None:
            length = checked_shape(self.robot, polynomial).duration
            if abs(length - duration) > ROUNDING * duration:
                raise InputError(
                    f"make_motion({duration:g}) must return a motion of {duration:g} s, not "
                    f"{length:g} s"
                )
            place = largest_use(self.family, polynomial, self.family.of_order(0))
            if place.use > 1.0 + ROUNDING:
                return _Attempt(duration, replace(place, use=np.inf))
        return _Attempt(duration, largest_use(self.family, polynomial, self.kinds))

    def run(self, started: float) -> Scaled:
        (good, met), (_, missed) = self._narrow(*self._bracket())
        # If the use is discontinuous at the bracket, the limit that the shorter duration violates
        # is reported.
        cause = met if met.use >= 1.0 - self.tolerance else missed
        if np.isinf(cause.use) and cause.quantity in self.family.of_order(3):
            raise InputError(_jumps_text(self.family[cause.quantity], cause))
        polynomial = self.make(good)
        member = None if cause.quantity == "shape" else self.family[cause.quantity]
        return Scaled(
            polynomial=polynomial,
            duration=polynomial.duration,
            factor=good / self.first if self.shape is not None else np.nan,
            quantity=cause.quantity,
            joint=member.labels[cause.joint] if member else "",
            time=cause.time,
            value=cause.value,
            limit=cause.limit,
            unit=member.units[cause.joint] if member else "",
            utilisation=met.use,
            iterations=self.tried,
            wall_time=time.perf_counter() - started,
            status=deadline.status() if deadline.over() else Status.SOLVED,
        )

    def _bracket(self) -> tuple[_Attempt, _Attempt]:
        """Return a duration that keeps the limits and a shorter one that does not."""
        good, bad = self.evaluate(self.first), None
        while good.peak.use > 1.0:
            bad = good
            if 2 * bad.duration > LONGEST_DURATION * self.first:
                raise InputError(self._no_duration(bad))
            # Some milliseconds for a shape, so the time limit is not tested.
            if self.shape is None and deadline.over():
                return bad, bad
            good = self.evaluate(2 * bad.duration)
        if self.from_above and not deadline.over():
            longer = self.evaluate(4 * good.duration)
            if longer.peak.use <= 1.0:
                good, bad = longer, None
        while bad is None:
            if deadline.over():
                return good, good
            if good.duration < ROUNDING * self.first:
                raise InputError(
                    "make_motion meets no limit, however short it is: no joint with a limit moves"
                )
            slowly = self.from_above and good.peak.use > 0.1
            shorter = self.evaluate(good.duration / (SCAN_RATIO if slowly else 2))
            good, bad = (good, shorter) if shorter.peak.use > 1.0 else (shorter, None)
        return good, bad

    def _no_duration(self, last: _Attempt) -> str:
        duration, peak = last
        if peak.quantity == "shape":
            return f"make_motion refuses every duration up to {duration:g} s{self.refusal}"
        if refusal := refusal_of(self.robot, self.family, self.make(duration)):
            return refusal
        member = self.family[peak.quantity]
        unit = member.units[peak.joint]
        return (
            f"no duration up to {duration:g} s keeps the limits: there "
            f"{member.title(peak.joint)} is {peak.value:.6g} {unit} at {peak.time:.6g} s, its "
            f"limit {peak.limit:g} {unit}"
        )

    def _narrow(self, good: _Attempt, bad: _Attempt) -> list[_Attempt]:
        """Return the bracket's ends after Illinois regula falsi in 1/T^2.

        A use that a torque determines is affine in 1/T^2.
        """
        aim = 1.0 - 0.5 * self.tolerance
        ends, weights, last = [good, bad], [1.0, 1.0], -1
        for iteration in range(200):
            (long, met), (short, missed) = ends
            near = met.use >= 1.0 - self.tolerance or long - short <= ROUNDING * long
            if near or deadline.over():
                break
            s_good, s_bad = long**-2, short**-2
            gap_good, gap_bad = (aim - met.use) * weights[0], (missed.use - aim) * weights[1]
            share = gap_good / (gap_good + gap_bad) if np.isfinite(gap_bad) else 0.5
            # Bisection in every fourth step bounds the number of steps.
            if iteration % 4 == 3 or not 0.0 < share < 1.0:
                share = 0.5
            middle = (s_good + share * (s_bad - s_good)) ** -0.5
            if not short < middle < long:
                middle = 0.5 * (short + long)
            attempt = self.evaluate(middle)
            end = int(attempt.peak.use > 1.0)
            ends[end], weights[end] = attempt, 1.0
            # Illinois: an end that stays counts half, so that the secant moves it.
            weights[1 - end] = 0.5 * weights[1 - end] if last == end else 1.0
            last = end
        return ends


def checked_shape(robot: Robot, shape: object) -> PiecewisePolynomial:
    """Return a motion of ``make_motion`` after a check of its type and number of joints."""
    if not isinstance(shape, PiecewisePolynomial):
        raise InputError(
            f"make_motion must return a PiecewisePolynomial, not {type(shape).__name__}"
        )
    checks.joints("make_motion", shape.coefficients.shape[2], robot)
    return shape


def refusal_of(robot: Robot, family: LimitFamily, shape: PiecewisePolynomial) -> str | None:
    """Return the reason why no duration of this shape keeps the limits, or None."""
    for key in family.of_order(0):
        place = largest_use(family, shape, [key])
        if place.use > 1.0 + ROUNDING:
            member = family[key]
            return (
                f"the shape leaves the {member.name} limits: "
                f"{_joint_text(member, place)} reaches "
                f"{_value_text(robot, member, place.value, place)} at {place.time:.6g} s, but its "
                f"limit is {_value_text(robot, member, place.limit, place)}"
            )
    held = largest_use(family, shape, family.of_order(1, 2, 3), at_rest=True)
    if held.use > 1.0 + ROUNDING:
        member = family[held.quantity]
        unit = member.units[held.joint]
        pose = shape([held.time])[0]
        values = [robot.position_text(j, q) for j, q in enumerate(pose)]
        return (
            f"holding the arm still at q = ({', '.join(values)}), {held.time:.6g} s into the "
            f"shape, takes {held.value:.6g} {unit} at {_joint_text(member, held)}, but its "
            f"{member.name} limits are {member.lower[held.joint]:g} to "
            f"{member.upper[held.joint]:g} {unit}, so no duration keeps them"
        )
    jump = largest_jump(family, shape, family.keys)
    return None if jump is None else _jumps_text(family[jump.quantity], jump)


def _jumps_text(member: Member, jump: Peak) -> str:
    jumping = "torque" if jump.quantity == "taud" else "acceleration"
    return (
        f"the {jumping} of {_joint_text(member, jump)} jumps at {jump.time:.6g} s, so no duration "
        f"keeps its {member.name} limit of {abs(jump.limit):g} {member.units[jump.joint]}; take a "
        "shape whose acceleration is continuous, and zero where it begins and ends at rest, such "
        "as a quintic"
    )


def _joint_text(member: Member, peak: Peak) -> str:
    label = member.labels[peak.joint]
    return f"joint {label!r}" if label and member.limit is None else member.title(peak.joint)


def _value_text(robot: Robot, member: Member, value: float, peak: Peak) -> str:
    if member.key == "q":
        return robot.position_text(peak.joint, value, with_radians=True)
    return f"{value:.6g} {member.units[peak.joint]}"
