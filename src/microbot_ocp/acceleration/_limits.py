"""Limits of acceleration for planners that know no torque."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.needed import needed
from microbot_ocp._base.status import Status
from microbot_ocp._base.table import Column, Table
from microbot_ocp.acceleration._coupled import CoupledDemand
from microbot_ocp.acceleration._demand import Demand
from microbot_ocp.acceleration._files import form_of, write
from microbot_ocp.acceleration._forms import Terms, torque_terms
from microbot_ocp.acceleration._rate import RateDemand
from microbot_ocp.acceleration._region import Places, places
from microbot_ocp.acceleration._search import (
    Pool,
    Proof,
    Worst,
    drawn,
    largest_box,
    of_largest_product,
    proved,
)
from microbot_ocp.limits import quantity_name
from microbot_ocp.motion import Motion
from microbot_ocp.robot import Robot
from microbot_ocp.scene import Box

MOST_BOXES = 20_000_000


@dataclass(frozen=True, eq=False)
class BreakingState:
    """A state in which a joint needs all of its torque, and more with larger accelerations.

    Attributes
    ----------
    joint : str
    q, qd, qdd : array [n]
        rad, rad/s, rad/s^2 (m, ...).
    payload : float
        kg.
    torque, limit : float
        Needed, and allowed on that side, N m (N).
    """

    joint: str
    q: FloatArray
    qd: FloatArray
    qdd: FloatArray
    payload: float
    torque: float
    limit: float


@dataclass(frozen=True, eq=False)
class AccelerationLimits:
    """The largest box of accelerations that is proved to need no more than the torques.

    Attributes
    ----------
    robot : Robot
    status : Status
        "solved" where the gap is as small as was asked for, "time limit" where the work ended
        before: the box is proved all the same. "infeasible" where there is none.
    qdd_max : array [n]
        Proved: plus and minus, rad/s^2 (m/s^2); zero where there is no box.
    broken : array [n]
        The same box, larger: a state is known that breaks it.
    state : BreakingState
        That state.
    payload : (float, float)
        kg.
    speed : array [n]
        Largest speeds, rad/s (m/s).
    region : str
        In words.
    boxes : int
        Parts of the region and of the speeds that the proof looked at.
    advice : str
    qddd_max, jerk_broken : array [n], optional
        Jerks that are proved, and such that a state breaks, rad/s^3 (m/s^3).
    """

    robot: Robot
    status: Status
    qdd_max: FloatArray
    broken: FloatArray
    state: BreakingState
    payload: tuple[float, float]
    speed: FloatArray
    region: str
    boxes: int
    advice: str = ""
    qddd_max: FloatArray | None = None
    jerk_broken: FloatArray | None = None

    @property
    def solved(self) -> bool:
        """Whether the gap is as small as was asked for."""
        return self.status.solved

    @property
    def gap(self) -> float:
        """Share by which the proved box is smaller than one that is known to break torques."""
        return _gap(self.qdd_max, self.broken)

    @property
    def jerk_gap(self) -> float:
        """The same of jerks and torque rates; NaN without."""
        return _gap(self.qddd_max, self.jerk_broken)

    def table(self) -> Table:
        """Return speeds, and proved and breaking accelerations and jerks of every joint, SI."""
        values = {"speed": self.speed, "acceleration": self.qdd_max, "breaks": self.broken}
        if self.qddd_max is not None and self.jerk_broken is not None:
            values |= {"jerk": self.qddd_max, "jerk breaks": self.jerk_broken}
        columns = [Column("joint", left=True), *(Column(head, "SI", ".4g") for head in values)]
        rows = [*zip(self.robot.joint_names, *values.values(), strict=True)]
        return Table(columns, [[*row] for row in rows])

    @property
    def limited(self) -> Robot:
        """The robot with these limits of speed, acceleration and jerk, for planners of ours."""
        changes = {"qd_max": self._usable.speed, "qdd_max": self.qdd_max, "qddd_max": self.qddd_max}
        return self.robot.with_limits(None, **changes)

    def export(self, path: str | Path, form: str | None = None) -> Path:
        """Write the limits for another planner; return the path.

        Parameters
        ----------
        path : str or Path
        form : {"moveit", "curobo", "urdf"}, optional
            MoveIt's ``joint_limits.yaml``; the part of a cuRobo robot file that holds them; URDF
            1.2, whose limits have attributes of acceleration and jerk. Default by the ending: a
            .urdf file, or MoveIt's. Speeds are those that the limits are proved for.

        Raises
        ------
        InputError
            Another form or ending; limits that allow no motion: none is proved, or only for rest.

        Examples
        --------
        >>> import tempfile
        >>> import microbot_ocp as mo
        >>> found = mo.acceleration_limits(mo.load_robot("planar_2r"), speed=0.2)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     text = found.export(f"{folder}/joint_limits.yaml").read_text()
        >>> text.splitlines()[1:4]
        ['joint_limits:', '  "shoulder":', '    has_velocity_limits: true']
        """
        form, usable = form_of(path, form), self._usable
        load = " to ".join(f"{mass:g}" for mass in dict.fromkeys(self.payload))
        remark = f"proved for payloads of {load} kg and these speeds, {self.region}"
        return write(path, form, self.robot, usable.speed, self.qdd_max, self.qddd_max, remark)

    def ruckig(self) -> Any:
        """Return ``ruckig.InputParameter`` with these limits, for start and target to be filled in.

        Raises
        ------
        InputError
            ruckig is not installed, or as :meth:`export`.
        """
        given = needed("ruckig", "an input of ruckig needs").InputParameter(self.robot.joint_count)
        given.max_velocity = self._usable.speed.tolist()
        given.max_acceleration = self.qdd_max.tolist()
        if self.qddd_max is not None:
            given.max_jerk = self.qddd_max.tolist()
        return given

    @property
    def _usable(self) -> AccelerationLimits:
        """Itself; refused where no motion is allowed."""
        if not self.qdd_max.all():
            raise InputError(f"no box of accelerations is proved: {self.advice}")
        if self.qddd_max is not None and not self.qddd_max.all():
            raise InputError(f"no box of jerks is proved: {self.advice}")
        if not self.speed.any():
            raise InputError("these limits are for an arm at rest: give speed above 0")
        return self


def acceleration_limits(
    robot: Robot,
    payload: float | Sequence[float] = 0.0,
    *,
    region: Box | Motion | ArrayLike | tuple[ArrayLike, ArrayLike] | None = None,
    speed: ArrayLike = 1.0,
    coupled: float | None = None,
    jerk: bool = False,
    equal: bool = False,
    ratios: ArrayLike | None = None,
    payload_center: ArrayLike = (0.0, 0.0, 0.0),
    gap: float = 0.1,
    work: float = 60.0,
    seed: int = 0,
) -> AccelerationLimits:
    """Return the largest accelerations that torques allow in every state of a region.

    Planners that know no torque (MoveIt, ruckig, Pilz, cuRobo) want one limit for each joint. The
    answer is a box ``|qdd_i| <= a_i`` within which **no** position of the region, no speed up to
    ``speed`` and no payload of the range needs more than the torques. It is proved by branch and
    bound over positions and speeds, from bounds of the curvature of mass matrix, Coriolis
    coefficients and gravity, widened by more than the errors of rounding. How much larger a box may
    be is said too: ``broken`` is one that a known state breaks.

    Parameters
    ----------
    robot : Robot
        With masses and limits of all torques.
    payload : float or (float, float)
        Point mass at the tool, kg, or the least and largest one. Torques are affine in it, so that
        both ends suffice.
    region : optional
        Where the arm moves: ``(lower, upper)`` positions of the joints, a :class:`Box` that the
        tool's origin stays in, a motion or poses [N,n] of a path, one box of joint positions
        between each pose and the next. Default the joint limits.
    speed : float or array_like [n]
        Largest speeds either way: a share of the velocity limits, above 0 to 1 or 0 for rest, or
        one number a joint, rad/s (m/s).
    coupled : float, optional
        Bound of the root of the sum of the squares of the joints' speeds, each as a share of
        ``speed``, above 0 to 1: with 1 one joint at its largest speed, or all at a part of theirs.
        Default none: all may have their largest at once.
    jerk : bool
        Find limits of the jerks as well, from those of the torque rates, for the accelerations that
        are proved. Coulomb friction, which steps at speed zero, has no rate here.
    equal : bool
        One acceleration for all joints, in place of the largest product.
    ratios : array_like [n], optional
        Ratios of the accelerations, in place of the largest product.
    payload_center : array_like [3]
        Where the payload is, in the tool frame, m.
    gap : float
        Share by which the proved box may be smaller than one that is known to break torques.
    work : float
        Processor time after which the best box is returned that is proved by then, s.
    seed : int
        Of the states that are drawn to begin with.

    Returns
    -------
    AccelerationLimits
        Largest box that was proved, with one that a known state breaks.

    Raises
    ------
    InputError
        A robot without masses or with a joint without limits of torque, or of torque rate or
        velocity where these are needed; a negative payload; a region outside of the joint limits.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> found = mo.acceleration_limits(mo.load_robot("planar_2r"), speed=0.0, equal=True)
    >>> found.solved, bool(0.9 * found.broken[0] <= found.qdd_max[0] <= found.broken[0])
    (True, True)
    """
    loads, speeds = _loads(payload), _speeds(robot, speed)
    shape = _shape(robot, equal, ratios)
    radius = None if coupled is None else checks.number("coupled", coupled, above=0.0, at_most=1.0)
    if jerk and radius is not None:
        raise InputError("give jerk=True or coupled, not both: jerks are for speeds of a box")
    checks.number("gap", gap, above=0.0, at_most=1.0)
    checks.number("work", work, "s", above=0.0)
    where = places(robot, region)
    arms = _ends(robot, loads, payload_center)
    for key in ("tau", "taud")[: 1 + jerk]:
        _bounds(robot, key)
    terms = _terms(arms, where)
    demands = _demands(arms, terms, speeds, radius)
    box, proof = _largest(demands, where, shape, gap, work, seed)
    worst = proof.pool.worst(box)
    status, advice = Status.SOLVED, ""
    if worst.scale <= 0.0:
        status, advice = Status.INFEASIBLE, _why_none(arms, worst)
    elif not proof.done:
        status, advice = Status.TIME_LIMIT, _unfinished(proof, worst)
    qdd_max, broken = max(proof.scale, 0.0) * box, max(worst.scale, 0.0) * box
    rates: dict[str, FloatArray] = {}
    if jerk and qdd_max.any():
        demands = _rate_demands(arms, terms, speeds, qdd_max)
        box, rate_proof = _largest(demands, where, shape, gap, work, seed)
        worst_rate = rate_proof.pool.worst(box)
        rates = {
            "qddd_max": max(rate_proof.scale, 0.0) * box,
            "jerk_broken": max(worst_rate.scale, 0.0) * box,
        }
        if worst_rate.scale <= 0.0:
            name = robot.joint_names[worst_rate.demand.joint]
            status, advice = (
                Status.INFEASIBLE,
                (
                    f"{name}: speeds and accelerations alone need more than its torque rate: give "
                    "less speed or a smaller region"
                ),
            )
        elif not rate_proof.done and status.solved:
            status, advice = Status.TIME_LIMIT, f"jerk: {_unfinished(rate_proof, worst_rate)}"
    return AccelerationLimits(
        robot=robot,
        status=status,
        qdd_max=qdd_max,
        broken=broken,
        state=_state(arms, worst, broken),
        payload=loads,
        speed=speeds,
        region=where.words,
        boxes=proof.count,
        advice=advice,
        **rates,
    )


def _unfinished(proof: Proof, worst: Worst) -> str:
    left = 100 * (1 - max(proof.scale, 0.0) / worst.scale)
    return f"the work ended at a gap of {left:.3g} %: give more, a smaller region or less speed"


def _largest(
    demands: list[Demand],
    where: Places,
    shape: FloatArray | None,
    gap: float,
    work: float,
    seed: int,
) -> tuple[FloatArray, Proof]:
    """Return the largest box that no known state breaks, and how far it is proved."""
    rng = np.random.default_rng(seed)
    with deadline.within(np.inf, work):
        pool = drawn(demands, where, rng)
        box, pool = _box(pool, where, shape, rng)
        if pool.worst(box).scale <= 0.0:
            return box, Proof(0.0, pool, 0, False)
        proof = proved(pool, box, where, gap, MOST_BOXES)
    if proof.pool.worst(box).scale <= 0.0:  # a state that was met on the way
        proof = proof._replace(scale=0.0)
    return box, proof


def _gap(proved: FloatArray | None, broken: FloatArray | None) -> float:
    if proved is None or broken is None or broken[0] <= 0.0:
        return np.nan
    return 1.0 - float(proved[0] / broken[0])


def _loads(payload: Any) -> tuple[float, float]:
    ends = [payload] * 2 if np.ndim(payload) == 0 else [*payload]
    if len(ends) != 2:
        raise InputError(f"payload must be a mass or (least, largest), kg, not {payload!r}")
    low, high = (checks.number("payload", end, "kg", at_least=0.0) for end in ends)
    if low > high:
        raise InputError(f"payload must be (least, largest), not ({low:g}, {high:g}) kg")
    return low, high


def _ends(robot: Robot, loads: tuple[float, float], center: ArrayLike) -> dict[float, Robot]:
    """Return the arm with the least and the largest payload, by payload.

    What lies between needs torques between: they are affine in a mass, which is looked at here.
    """
    low, high = loads
    arms = {load: robot.with_payload(load, center) for load in sorted({low, high})}
    if low < high:
        middle = robot.with_payload((low + high) / 2, center)
        states = np.random.default_rng(0).uniform(-1.0, 1.0, (3, 8, robot.joint_count))
        ends = [arm.torques_along(*states)["tau"] for arm in (*arms.values(), middle)]
        off = np.abs(ends[2] - (ends[0] + ends[1]) / 2).max()
        if off > 1e-9 * np.abs(ends).max():
            raise RuntimeError(f"torques are off by {off:g} from affine ones in the payload")
    return arms


def _shape(robot: Robot, equal: bool, ratios: ArrayLike | None) -> FloatArray | None:
    if ratios is None:
        return np.ones(robot.joint_count) if equal else None
    if equal:
        raise InputError("give equal=True or ratios, not both")
    values = checks.array("ratios", ratios, (robot.joint_count,))
    for k in np.flatnonzero(values <= 0):
        raise InputError(f"ratios must be above 0, but that of joint {k + 1} is {values[k]:g}")
    return values


def _speeds(robot: Robot, speed: ArrayLike) -> FloatArray:
    if np.ndim(np.asarray(speed, dtype=object)) == 0:
        name = "speed as a share of the velocity limits"
        share = checks.number(name, speed, at_least=0.0, at_most=1.0)
        largest = np.maximum(*(np.abs(bound) for bound in robot.limits.bounds("qd")))
        for k in np.flatnonzero(~np.isfinite(largest)) if share else ():
            raise InputError(
                f"{robot.joint_names[k]} has no limit of velocity to take a share of: give speed "
                f"as one number a joint, {robot.unit('qd', int(k))}"
            )
        return share * largest if share else np.zeros(robot.joint_count)
    values = checks.array("speed", speed, (robot.joint_count,), "rad/s")
    for k in np.flatnonzero(values < 0):
        raise InputError(
            f"speed must be at least 0 {robot.unit('qd', int(k))}, but that of joint {k + 1} is "
            f"{values[k]:g}"
        )
    return values


def _terms(arms: dict[float, Robot], where: Places) -> dict[float, list[Terms]]:
    """Return the terms of the torques of every joint in a region, by payload."""
    ends = (where.boxes.low.min(axis=0), where.boxes.high.max(axis=0))
    low, high = (tuple(end.tolist()) for end in ends)
    return {load: torque_terms(arm, low, high) for load, arm in arms.items()}


def _bounds(robot: Robot, key: str) -> tuple[FloatArray, FloatArray]:
    lower, upper = robot.limits.bounds(key)
    for k in np.flatnonzero(~np.isfinite(upper - lower)):
        raise InputError(
            f"{robot.joint_names[k]} must have limits of {quantity_name(key)} on both sides, not "
            f"[{lower[k]:g}, {upper[k]:g}] {robot.unit(key, int(k))}"
        )
    return lower, upper


def _demands(
    arms: dict[float, Robot],
    terms: dict[float, list[Terms]],
    speeds: FloatArray,
    radius: float | None,
) -> list[Demand]:
    """Return the torques of every joint, on both sides, of arms by their payload."""
    demands = []
    for load, arm in arms.items():
        lower, upper = _bounds(arm, "tau")
        viscous, coulomb = (arm.friction_of(f"{kind}_friction") for kind in ("viscous", "coulomb"))
        for k, of_joint in enumerate(terms[load]):
            for side, limit in ((1.0, upper[k]), (-1.0, -lower[k])):
                demand = of_joint, k, side, limit, speeds, viscous[k], coulomb[k], load
                ball = radius if speeds.any() else None
                demands.append(Demand(*demand) if ball is None else CoupledDemand(*demand, ball))
    return demands


def _rate_demands(
    arms: dict[float, Robot],
    terms: dict[float, list[Terms]],
    speeds: FloatArray,
    accelerations: FloatArray,
) -> list[Demand]:
    """Return the torque rates of every joint of arms by their payload."""
    demands = []
    for load, arm in arms.items():
        limit = np.minimum(*np.abs(_bounds(arm, "taud")))
        viscous = arm.friction_of("viscous_friction")
        for k, of_joint in enumerate(terms[load]):
            demand = of_joint, k, 1.0, limit[k], speeds, viscous[k], 0.0, load, accelerations
            demands.append(RateDemand(*demand))
    return demands


def _box(
    pool: Pool, where: Places, shape: FloatArray | None, rng: np.random.Generator
) -> tuple[FloatArray, Pool]:
    """Return the largest box of accelerations that no known state breaks, of a shape if given."""
    count = len(pool.demands[0].speed)
    moved = np.max([states.rows.max(axis=0) for states in pool.states], axis=0)
    if not moved.all():
        raise InputError(f"joint {int(moved.argmin()) + 1} moves no mass: no torque limits it")
    room = min(float(states.room.min()) for states in pool.states)

    def of_shape(pool: Pool) -> FloatArray:
        if shape is None:
            return of_largest_product(pool, count)
        return shape * pool.worst(shape).scale

    if room <= 0.0:  # no accelerations at all
        return np.ones(count), pool
    return largest_box(pool, where, of_shape, rng)


def _why_none(arms: dict[float, Robot], worst: Worst) -> str:
    """Return why there is no box: gravity or speed alone need more than the torque."""
    arm = arms[worst.demand.payload]
    none = np.zeros(arm.joint_count)
    state, at_rest = (_state(arms, worst, none, moving=moving) for moving in (True, False))
    unit = arm.unit("tau", worst.demand.joint)
    place = ", ".join(arm.position_text(k, q) for k, q in enumerate(state.q.tolist()))
    held = f" with {state.payload:g} kg" if state.payload else ""
    lower = "a lower payload" if state.payload else "higher torques"
    if at_rest.torque >= state.limit:
        why, remedy = f"to hold the arm{held} alone takes {at_rest.torque:.4g}", lower
    else:
        # forces of speeds fall with their square, friction by less: no more than this is possible
        share = np.sqrt((state.limit - at_rest.torque) / (state.torque - at_rest.torque))
        why = f"the arm{held} takes {state.torque:.4g} without any acceleration"
        remedy = f"less than {share:.2g} of these speeds, {lower}"
    return (
        f"{state.joint}: {why}, of {state.limit:.4g} {unit}, at q = ({place}), "
        f"qd = {state.qd.round(3).tolist()} rad/s (m/s): give {remedy} or a smaller region"
    )


def _state(
    arms: dict[float, Robot], worst: Worst, box: FloatArray, *, moving: bool = True
) -> BreakingState:
    """Return the state of a joint's largest torque, from inverse dynamics."""
    demand, arm = worst.demand, arms[worst.demand.payload]
    q, shares = worst.states.q[worst.row], worst.states.shares[worst.row]
    count = q.size
    signs = np.sign(demand.terms.at(q[None])[0, 0, 1 : 1 + count])
    qd, qdd = demand.side * moving * shares * demand.speed, demand.side * signs * box
    torque = arm.torques_along(q[None], qd[None], qdd[None])["tau"][0, demand.joint]
    return BreakingState(
        joint=arm.joint_names[demand.joint],
        q=q,
        qd=qd + 0.0,
        qdd=qdd + 0.0,
        payload=demand.payload,
        torque=float(demand.side * torque),
        limit=float(demand.limit),
    )
