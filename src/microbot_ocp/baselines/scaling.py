"""The shortest duration at which a shape of motion keeps the limits of a robot."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import cast

import casadi as ca
import numpy as np

from microbot_ocp import checks
from microbot_ocp.checks import FloatArray, InputError
from microbot_ocp.dynamics import inverse_dynamics
from microbot_ocp.motion import PiecewisePolynomial
from microbot_ocp.robot import JointLimits, Limits, Robot

MakeMotion = Callable[[float], PiecewisePolynomial]

POINTS_PER_PIECE = 200  # first grid for the maxima, before they are refined
REFINEMENT_ROUNDS = 8  # each divides the grid step around a maximum by four
CANDIDATES = 60  # at most so many maxima are refined at a time
ROUNDING = 1e-9  # excess over a limit, relative, that is put down to rounding
SCAN_RATIO = 1.05  # step of the search from above, where the feasible set may have gaps
LONGEST = 1e6  # no duration above this many times the first is tried
SHORTEST = 1e-9


@dataclass(frozen=True, eq=False)
class LimitUse:
    """How much of a limit a value uses, joint by joint: 0 at rest or mid-range, 1 at the limit.

    For q it is the distance from the middle of the range, divided by half the range (one-sided
    limits: 1 plus the excess over the limit, divided by the limit). For the other quantities, whose
    limits have zero between them, it is the value divided by the limit of its sign.

    Attributes
    ----------
    quantity : "q", "qd", "qdd", "tau" or "taud"
    lower, upper : array [n]
    lower_scale, upper_scale : array [n]
        Excess over the limit that counts as 1.
    """

    quantity: str
    lower: FloatArray
    upper: FloatArray
    lower_scale: FloatArray
    upper_scale: FloatArray

    @classmethod
    def of(cls, limits: JointLimits, quantity: str) -> LimitUse:
        """The use of one kind of limit."""
        lower, upper = limits.bounds(quantity)
        span = upper - lower
        scales = []
        for bound in (lower, upper):
            scale = np.where(np.isfinite(bound) & (bound != 0), np.abs(bound), 1.0)
            if quantity == "q":
                scale = np.where(np.isfinite(span) & (span > 0), 0.5 * span, scale)
            scales.append(scale)
        return cls(quantity, lower, upper, scales[0], scales[1])

    @property
    def limited(self) -> np.ndarray:
        """Which joints [n] have such a limit, on either side."""
        return np.isfinite(self.lower) | np.isfinite(self.upper)

    def __call__(self, values: FloatArray) -> FloatArray:
        """Use [..., n] of values [..., n]; minus infinity where there is no limit."""
        above = self._side(values - self.upper, self.upper, self.upper_scale)
        below = self._side(self.lower - values, self.lower, self.lower_scale)
        return np.maximum(above, below)

    def _side(self, excess: FloatArray, bound: FloatArray, scale: FloatArray) -> FloatArray:
        use = 1.0 + excess / scale
        if self.quantity != "q":
            # A limit of zero (a joint that must not move that way) is not "used" at rest.
            at_zero = (bound == 0) & (excess <= ROUNDING * scale)
            use = np.where(at_zero, np.minimum(use - 1.0, 0.0), use)
        return use

    def limit(self, value: float, joint: int) -> float:
        """The limit of this joint (lower or upper) that the value is nearer to or beyond."""
        values = np.full(self.lower.size, value)
        above = self._side(values - self.upper, self.upper, self.upper_scale)[joint]
        below = self._side(self.lower - values, self.lower, self.lower_scale)[joint]
        return float(self.upper[joint] if above >= below else self.lower[joint])

    def violation(self, use: float, value: float, joint: int) -> float:
        """Excess over the limit, divided by the limit (by the range for q); 0 where kept."""
        if not use > 1.0:
            return 0.0
        limit = self.limit(value, joint)
        excess = abs(value - limit)
        span = self.upper[joint] - self.lower[joint]
        if self.quantity == "q" and np.isfinite(span) and span > 0:
            return float(excess / span)
        return float(excess / (abs(limit) or 1.0))


@dataclass(frozen=True)
class Scaled:
    """A motion as short as its shape and the limits allow.

    Attributes
    ----------
    polynomial : PiecewisePolynomial
        The motion; it keeps every limit.
    duration : float
        Its duration, s.
    factor : float
        Duration divided by that of the shape given (NaN where a callable was given).
    quantity : str
        The kind of limit that is just met: "qd", "qdd", "tau" or "taud"; "q" where a shorter
        motion of a callable leaves the position limits, "shape" where the callable refuses one.
    joint : str
        Name of the joint that meets it.
    time : float
        When, s.
    value, limit : float
        Value there and the limit, in ``unit``.
    unit : str
    utilisation : float
        Largest share of any velocity, acceleration, torque or torque-rate limit: 1 or just below.
    iterations : int
        How many durations were tried.
    wall_time : float
        s.
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


@dataclass(frozen=True)
class _Peak:
    """Where a motion uses most of its limits."""

    use: float
    quantity: str = "shape"
    joint: int = 0
    time: float = 0.0
    value: float = np.nan
    limit: float = np.nan


@lru_cache(maxsize=64)
def torque_and_rate(robot: Robot) -> ca.Function:
    """Torque and its exact time derivative along a motion.

    Returns
    -------
    casadi.Function
        ``(q[n], qd[n], qdd[n], qddd[n]) -> tau[n], taud[n]``, N m and N m/s.
    """
    state = [ca.SX.sym(name, robot.joint_count) for name in ("q", "qd", "qdd", "qddd")]
    tau = inverse_dynamics(robot)(*state[:3])
    taud = ca.jtimes(tau, ca.vertcat(*state[:3]), ca.vertcat(*state[1:]))
    names = ["q", "qd", "qdd", "qddd"]
    return ca.Function("torque_and_rate", state, [tau, ca.densify(taud)], names, ["tau", "taud"])


class _Demand:
    """Dense maxima of what a motion asks of the limits.

    Every piece is evaluated with both its ends, so both one-sided limits at a break count. The
    grid's largest local maxima are then refined by sampling ever closer around them.
    """

    def __init__(self, robot: Robot, limits: JointLimits) -> None:
        self.robot = robot
        uses = [LimitUse.of(limits, kind) for kind in ("q", "qd", "qdd", "tau", "taud")]
        self.uses = {use.quantity: use for use in uses if use.limited.any()}
        if {"tau", "taud"} & self.uses.keys():
            inverse_dynamics(robot)  # raises for a robot without masses

    def values(
        self, orders: Sequence[FloatArray], piece: np.ndarray, local: FloatArray, kinds: set[str]
    ) -> dict[str, FloatArray]:
        """Values [S,n] of each kind at ``local`` seconds after the start of the pieces [S]."""
        names = ("q", "qd", "qdd", "qddd")
        state: dict[str, FloatArray] = {}
        for name, coefficients in zip(names, orders, strict=True):
            state[name] = _horner(coefficients[piece], local)
        if "taud" in kinds:
            tau, taud = torque_and_rate(self.robot)(*(state[name].T for name in names))
            state["tau"], state["taud"] = np.array(tau).T, np.array(taud).T
        elif "tau" in kinds:
            tau = inverse_dynamics(self.robot)(*(state[name].T for name in names[:3]))
            state["tau"] = np.array(tau).T
        return {kind: state[kind] for kind in kinds}

    def peak(
        self, polynomial: PiecewisePolynomial, kinds: Sequence[str], *, at_rest: bool = False
    ) -> _Peak:
        """The largest use of the limits of these kinds, over all joints and all times."""
        wanted = [kind for kind in kinds if kind in self.uses]
        if not wanted:
            return _Peak(-np.inf)
        orders = _orders(polynomial)
        if at_rest:
            orders = [orders[0], *(np.zeros_like(c) for c in orders[1:])]
        jump = self._torque_jump(polynomial, orders) if "taud" in wanted else None
        if jump is not None:
            return jump
        lengths = np.diff(polynomial.breaks)
        pieces, points = lengths.size, POINTS_PER_PIECE
        fraction = np.linspace(0.0, 1.0, points + 1)
        piece = np.repeat(np.arange(pieces), points + 1)

        def use_at(which: np.ndarray, local: FloatArray) -> FloatArray:
            values = self.values(orders, which, local, set(wanted))
            return np.hstack([self.uses[kind](values[kind]) for kind in wanted])

        local = (lengths[:, None] * fraction).ravel()
        use = use_at(piece, local).reshape(pieces, points + 1, -1)
        k, i, channel = _candidates(use)
        center, best = lengths[k] * fraction[i], use[k, i, channel]
        reach = lengths[k] / points
        offsets = np.linspace(-1.0, 1.0, 9)
        for _ in range(REFINEMENT_ROUNDS):
            around = np.clip(center[:, None] + reach[:, None] * offsets, 0.0, lengths[k][:, None])
            found = use_at(np.repeat(k, offsets.size), around.ravel())
            found = found.reshape(k.size, offsets.size, -1)
            own = np.take_along_axis(found, channel[:, None, None], axis=2)[:, :, 0]
            pick = own.argmax(axis=1)
            row = np.arange(k.size)
            center, best = around[row, pick], np.maximum(best, own[row, pick])
            reach = reach / 4.0
        top = int(best.argmax())
        quantity = wanted[channel[top] // self.robot.joint_count]
        joint = int(channel[top] % self.robot.joint_count)
        value = self.values(orders, k[top : top + 1], center[top : top + 1], set(wanted))
        value = float(value[quantity][0, joint])
        return _Peak(
            use=float(best[top]),
            quantity=quantity,
            joint=joint,
            time=float(polynomial.breaks[k[top]] + center[top]),
            value=value,
            limit=self.uses[quantity].limit(value, joint),
        )

    def _torque_jump(
        self, polynomial: PiecewisePolynomial, orders: Sequence[FloatArray]
    ) -> _Peak | None:
        """An infinite torque rate: a jump of the torque of a joint whose rate is limited."""
        lengths = np.diff(polynomial.breaks)
        inner = np.arange(lengths.size - 1)
        if not inner.size:
            return None
        before = self.values(orders, inner, lengths[:-1], {"tau"})["tau"]
        after = self.values(orders, inner + 1, np.zeros(inner.size), {"tau"})["tau"]
        size = 1.0 + max(np.abs(before).max(), np.abs(after).max())
        step = np.where(self.uses["taud"].limited, after - before, 0.0)
        k, joint = np.unravel_index(np.abs(step).argmax(), step.shape)
        if abs(step[k, joint]) <= 1e-7 * size:
            return None
        value = float(np.copysign(np.inf, step[k, joint]))
        return _Peak(
            use=np.inf,
            quantity="taud",
            joint=int(joint),
            time=float(polynomial.breaks[k + 1]),
            value=value,
            limit=float(
                self.uses["taud"].upper[joint] if value > 0 else self.uses["taud"].lower[joint]
            ),
        )

    def refusal(self, polynomial: PiecewisePolynomial) -> str | None:
        """Why no duration of this shape keeps the limits, or None."""
        robot = self.robot
        place = self.peak(polynomial, ["q"])
        if place.use > 1.0 + ROUNDING:
            return (
                f"the shape leaves the position limits: joint {robot.joint_names[place.joint]!r} "
                f"reaches {_position(robot, place.joint, place.value)} at {place.time:.6g} s, but "
                f"its limit is {_position(robot, place.joint, place.limit)}"
            )
        held = self.peak(polynomial, ["tau"], at_rest=True)
        if held.use > 1.0 + ROUNDING:
            unit = robot.unit("tau", held.joint)
            use = self.uses["tau"]
            pose = polynomial([held.time])[0]
            values = [_position(robot, j, q, short=True) for j, q in enumerate(pose)]
            return (
                f"holding the arm still at q = ({', '.join(values)}), {held.time:.6g} s into the "
                f"shape, takes {held.value:.6g} {unit} at joint {robot.joint_names[held.joint]!r}, "
                f"but its torque limits are {use.lower[held.joint]:g} to "
                f"{use.upper[held.joint]:g} {unit}, so no duration keeps them"
            )
        if "taud" in self.uses:
            jump = self._torque_jump(polynomial, _orders(polynomial))
            if jump is not None:
                return (
                    f"the torque of joint {robot.joint_names[jump.joint]!r} jumps at "
                    f"{jump.time:.6g} s, so no duration keeps its torque rate limit of "
                    f"{abs(jump.limit):g} {robot.unit('taud', jump.joint)}; take a shape with "
                    "continuous acceleration, such as a quintic"
                )
        return None


def shortest_duration(
    robot: Robot,
    make_motion: PiecewisePolynomial | MakeMotion,
    limits: Limits | JointLimits | None = None,
    *,
    first_duration: float = 1.0,
    tolerance: float = 1e-8,
) -> Scaled:
    """Shortest duration at which a shape of motion keeps every limit.

    When a motion is stretched in time by the factor l, velocities go with 1/l, accelerations with
    1/l^2, and the torque at each point of the path is ``g(q) + c / l^2`` with gravity g and c from
    inertia and Coriolis terms (Hollerbach, *Dynamic scaling of manipulator trajectories*, ASME
    Journal of Dynamic Systems, Measurement, and Control 106, 1984). Without joint friction each
    torque is affine in 1/l^2, so if gravity alone is within the limits, the feasible durations are
    all those from some T* on, and T* is found by a bracketed root-find on the largest use of any
    limit. Viscous friction adds a term in 1/l: then an instant may be infeasible only for a band
    of durations, and the search comes from above in steps of 5 %, as it does for Coulomb friction
    and for a callable, about which nothing is known. Position limits do not depend on the duration
    and are checked first, as is the torque that holds the arm still.

    The largest use is that of a dense grid on every piece (both one-sided limits at each break),
    with its maxima refined.

    Parameters
    ----------
    robot : Robot
    make_motion : PiecewisePolynomial or callable
        A shape, which is stretched uniformly, or ``duration (s) -> PiecewisePolynomial`` of that
        duration; an InputError that the callable raises counts as "too short".
    limits : Limits or JointLimits, optional
        Default ``robot.limits``.
    first_duration : float
        First duration that a callable is tried with, s.
    tolerance : float
        The result uses between ``1 - tolerance`` and 1 of the limit that it meets.

    Returns
    -------
    Scaled

    Raises
    ------
    InputError
        No limit at all; the shape leaves the position limits; gravity alone needs more torque than
        allowed; the torque jumps though its rate is limited; nothing limits the motion.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> from microbot_ocp.baselines import cubic, shortest_duration
    >>> robot = mo.load_robot("microbot")
    >>> shape = cubic([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]], [0.0, 1.0])
    >>> found = shortest_duration(robot, shape, mo.Limits(qd_max=2.0))
    >>> round(found.duration, 6), found.quantity, found.joint  # 1.5 L / v
    (1.5, 'qd', 'waist')
    """
    started = time.perf_counter()
    search = _Search(robot, make_motion, limits, first_duration, tolerance)
    return search.run(started)


class _Search:
    """One search for the shortest duration; counts the durations that were tried."""

    def __init__(
        self,
        robot: Robot,
        make_motion: PiecewisePolynomial | MakeMotion,
        limits: Limits | JointLimits | None,
        first_duration: float,
        tolerance: float,
    ) -> None:
        self.robot = robot
        self.tolerance = checks.number("tolerance", tolerance, above=0.0, at_most=1e-3)
        chosen = (robot.limits if limits is None else limits).for_joints(robot.joint_count)
        self.demand = _Demand(robot, chosen)
        self.kinds = [k for k in ("qd", "qdd", "tau", "taud") if k in self.demand.uses]
        if not self.kinds:
            raise InputError(
                "limits must hold a finite qd_max, qdd_max, tau_max or taud_max for at least one "
                "joint, or no duration is too short"
            )
        self.tried = 0
        self.shape = make_motion if isinstance(make_motion, PiecewisePolynomial) else None
        if self.shape is not None:
            shape = self._checked(self.shape)
            self.first = shape.duration
            self.make: MakeMotion = lambda duration: shape.stretched(duration / shape.duration)
            refusal = self.demand.refusal(shape)
        elif callable(make_motion):
            self.first = checks.number("first_duration", first_duration, "s", above=0.0)
            self.make = cast(MakeMotion, make_motion)
            refusal = self._refusal_of_callable()
        else:
            raise InputError(
                "make_motion must be a PiecewisePolynomial or a callable of the duration, not "
                f"{type(make_motion).__name__}"
            )
        if refusal:
            raise InputError(refusal)
        friction = any(link.viscous_friction or link.coulomb_friction for link in robot.links)
        # Without friction a longer duration of the same shape never asks for more.
        self.from_above = self.shape is None or (friction and "tau" in self.kinds)

    def _checked(self, polynomial: PiecewisePolynomial) -> PiecewisePolynomial:
        width = polynomial.coefficients.shape[2]
        if width != self.robot.joint_count:
            raise InputError(
                f"make_motion is for {width} joints, but the robot has {self.robot.joint_count}"
            )
        return polynomial

    def _refusal_of_callable(self) -> str | None:
        """Its path may depend on the duration: refuse only what ten times as long does not cure."""
        refusal = None
        for duration in (self.first, 10.0 * self.first):
            try:
                polynomial = self._made(duration)
            except _TooShort:
                continue
            refusal = self.demand.refusal(polynomial)
            if refusal is None:
                return None
        return refusal

    def _made(self, duration: float) -> PiecewisePolynomial:
        try:
            made = self.make(duration)
        except InputError as problem:
            raise _TooShort(str(problem)) from problem
        if not isinstance(made, PiecewisePolynomial):
            raise InputError(
                f"make_motion must return a PiecewisePolynomial, not {type(made).__name__}"
            )
        if abs(made.duration - duration) > 1e-6 * duration:
            raise InputError(
                f"make_motion({duration:g}) must return a motion of {duration:g} s, not "
                f"{made.duration:g} s"
            )
        return self._checked(made)

    def evaluate(self, duration: float) -> _Peak:
        """The largest use of the limits at this duration."""
        self.tried += 1
        try:
            polynomial = self._made(duration)
        except _TooShort as problem:
            if duration > 0.1 * LONGEST * self.first:
                raise InputError(f"make_motion refuses every duration: {problem}") from problem
            return _Peak(np.inf)
        if self.shape is None:
            place = self.demand.peak(polynomial, ["q"])
            if place.use > 1.0 + ROUNDING:
                return _Peak(np.inf, "q", place.joint, place.time, place.value, place.limit)
        return self.demand.peak(polynomial, self.kinds)

    def run(self, started: float) -> Scaled:
        good, bad = self._bracket()
        good, met, missed = self._narrow(good, bad)
        # Where the use leaps at the bracket's end, what stops the motion is what the shorter asks.
        cause = met if met.use >= 1.0 - 1e-6 else missed
        polynomial = self.make(good)
        named = cause.quantity != "shape"
        return Scaled(
            polynomial=polynomial,
            duration=polynomial.duration,
            factor=good / self.first if self.shape is not None else np.nan,
            quantity=cause.quantity,
            joint=self.robot.joint_names[cause.joint] if named else "",
            time=cause.time,
            value=cause.value,
            limit=cause.limit,
            unit=self.robot.unit(cause.quantity, cause.joint) if named else "",
            utilisation=met.use,
            iterations=self.tried,
            wall_time=time.perf_counter() - started,
        )

    def _bracket(self) -> tuple[tuple[float, _Peak], tuple[float, _Peak]]:
        """A duration that keeps the limits and a shorter one that does not."""
        duration, bad = self.first, None
        peak = self.evaluate(duration)
        while peak.use > 1.0:
            bad = (duration, peak)
            duration *= float(np.clip(peak.use, 1.3, 4.0))
            if duration > LONGEST * self.first:
                raise InputError(self._no_duration(bad))
            peak = self.evaluate(duration)
        good = (duration, peak)
        if self.from_above:
            top = self.evaluate(4.0 * duration)
            if top.use <= 1.0:
                good, bad = (4.0 * duration, top), None
        while bad is None:
            duration, peak = good
            if duration < SHORTEST * self.first:
                raise InputError(
                    "make_motion meets no limit, however short it is: no joint with a limit moves"
                )
            shorter = duration / SCAN_RATIO
            if not self.from_above or peak.use < 0.1:
                shorter = duration * float(np.clip(0.95 * peak.use, 0.1, 0.9))
            trial = (shorter, self.evaluate(shorter))
            if trial[1].use > 1.0:
                bad = trial
            else:
                good = trial
        return good, bad

    def _no_duration(self, last: tuple[float, _Peak]) -> str:
        duration, peak = last
        if peak.quantity == "shape":
            return f"make_motion refuses every duration up to {duration:g} s"
        unit = self.robot.unit(peak.quantity, peak.joint)
        return (
            f"no duration up to {duration:g} s keeps the limits: there {peak.quantity} of joint "
            f"{self.robot.joint_names[peak.joint]!r} is {peak.value:.6g} {unit} at "
            f"{peak.time:.6g} s, its limit {peak.limit:g} {unit}"
        )

    def _narrow(
        self, good: tuple[float, _Peak], bad: tuple[float, _Peak]
    ) -> tuple[float, _Peak, _Peak]:
        """Illinois regula falsi in 1/T^2, in which a torque-limited use is affine."""
        aim = 1.0 - 0.5 * self.tolerance
        weight_good, weight_bad = 1.0, 1.0
        last = 0
        for iteration in range(200):
            (long, met), (short, missed) = good, bad
            if met.use >= 1.0 - self.tolerance or long - short <= 1e-13 * long:
                break
            s_good, s_bad = long**-2, short**-2
            gap_good = (aim - met.use) * weight_good
            gap_bad = (missed.use - aim) * weight_bad
            share = gap_good / (gap_good + gap_bad) if np.isfinite(gap_bad) else 0.5
            if iteration % 4 == 3 or not 0.0 < share < 1.0:
                share = 0.5
            middle = (s_good + share * (s_bad - s_good)) ** -0.5
            if not short < middle < long:
                middle = 0.5 * (short + long)
            trial = (middle, self.evaluate(middle))
            if trial[1].use > 1.0:
                bad, weight_bad = trial, 1.0
                weight_good = 0.5 * weight_good if last == 1 else 1.0
                last = 1
            else:
                good, weight_good = trial, 1.0
                weight_bad = 0.5 * weight_bad if last == -1 else 1.0
                last = -1
        return good[0], good[1], bad[1]


class _TooShort(Exception):
    """A callable that refuses a duration."""


def _orders(polynomial: PiecewisePolynomial) -> list[FloatArray]:
    """Coefficients of position, velocity, acceleration and jerk."""
    orders = [polynomial]
    for _ in range(3):
        orders.append(orders[-1].derivative())
    return [order.coefficients for order in orders]


def _horner(coefficients: FloatArray, local: FloatArray) -> FloatArray:
    value = np.zeros((local.size, coefficients.shape[2]))
    for power in reversed(range(coefficients.shape[1])):
        value = value * local[:, None] + coefficients[:, power]
    return value


def _candidates(use: FloatArray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Local maxima of ``use`` [pieces, points, channels] that may hold the overall one."""
    finite = np.where(np.isfinite(use), use, -1e300)
    left = np.full_like(finite, -np.inf)
    right = np.full_like(finite, -np.inf)
    left[:, 1:], right[:, :-1] = finite[:, :-1], finite[:, 1:]
    curvature = np.zeros_like(finite)
    curvature[:, 1:-1] = np.abs(finite[:, :-2] - 2 * finite[:, 1:-1] + finite[:, 2:])
    curvature[:, 0], curvature[:, -1] = curvature[:, 1], curvature[:, -2]
    # A smooth maximum between grid points lies an eighth of the second difference above them.
    hope = finite + curvature
    peaks = (finite >= left) & (finite > right) & (hope >= finite.max())
    found = np.argwhere(peaks)
    order = np.argsort(-hope[tuple(found.T)], kind="stable")[:CANDIDATES]
    k, i, channel = found[order].T
    return k, i, channel


def _position(robot: Robot, joint: int, value: float, *, short: bool = False) -> str:
    if robot.joint_types[joint] == "prismatic":
        return f"{value:.6g} m"
    degrees = f"{np.degrees(value):.6g} deg"
    return degrees if short else f"{degrees} ({value:.6g} rad)"
