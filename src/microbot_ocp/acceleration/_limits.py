"""Acceleration limits for planners that do not compute torques."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.checks import ROUNDING, FloatArray, InputError
from microbot_ocp._base.needed import needed
from microbot_ocp._base.status import Status
from microbot_ocp._base.table import Column, Table
from microbot_ocp.acceleration import _search as search
from microbot_ocp.acceleration._coupled import CoupledDemand
from microbot_ocp.acceleration._demand import Demand
from microbot_ocp.acceleration._files import form_of, write
from microbot_ocp.acceleration._forms import Terms, torque_terms
from microbot_ocp.acceleration._rate import RateDemand
from microbot_ocp.acceleration._region import PositionRegion, position_region
from microbot_ocp.limits import quantity_name
from microbot_ocp.motion import Motion
from microbot_ocp.robot import Robot
from microbot_ocp.scene import Box

MOST_BOXES = 20_000_000


@dataclass(frozen=True, eq=False)
class BreakingState:
    """State in which a joint needs all of its torque, and more at larger accelerations.

    Attributes
    ----------
    joint : str
        Name of the joint that reaches its torque limit.
    q, qd, qdd : array [n]
        Position, speed and acceleration of all joints, rad, rad/s, rad/s^2 (m, m/s, m/s^2).
    payload : float
        Mass at the tool, kg.
    torque, limit : float
        Torque that the joint needs and torque limit on that side, N m (N).
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
    """Largest box of accelerations that is proved to keep every torque within its limit.

    Attributes
    ----------
    robot : Robot
        Robot that the limits are for.
    status : Status
        "solved" if the gap is at most the given one; "time limit" if the work ended earlier, with a
        box that is proved but smaller; "infeasible" if there is no box.
    qdd_max : array [n]
        Proved limits ``|qdd_i| <= qdd_max_i``, rad/s^2 (m/s^2); zero if there is no box.
    broken : array [n]
        Multiple of the proved box at which ``state`` needs all of a torque, so that every larger
        multiple exceeds it, rad/s^2 (m/s^2).
    state : BreakingState
        State that uses up the torque of a joint with the accelerations ``broken``.
    payload : (float, float)
        Least and largest mass at the tool, kg.
    speed : array [n]
        Largest speeds, rad/s (m/s).
    region : str
        Description of the region of positions.
    boxes : int
        Number of boxes of positions and speeds that the proof evaluated.
    advice : str
        Sentence with cause and remedy if the status is not "solved", otherwise empty.
    qddd_max, jerk_broken : array [n], optional
        Proved limits of the jerks, and the multiple of them at which a known state needs all of a
        torque rate, rad/s^3 (m/s^3).
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
        """True if the gap is at most the given one."""
        return self.status.solved

    @property
    def gap(self) -> float:
        """Relative gap ``1 - qdd_max / broken`` between the proved and the broken box."""
        return _gap(self.qdd_max, self.broken)

    @property
    def jerk_gap(self) -> float:
        """Relative gap ``1 - qddd_max / jerk_broken`` of the jerks; NaN without jerks."""
        return _gap(self.qddd_max, self.jerk_broken)

    def table(self) -> Table:
        """Return a table of speed, proved and broken acceleration and jerk of every joint, SI."""
        values = {"speed": self.speed, "acceleration": self.qdd_max, "breaks": self.broken}
        if self.qddd_max is not None and self.jerk_broken is not None:
            values |= {"jerk": self.qddd_max, "jerk breaks": self.jerk_broken}
        columns = [Column("joint", left=True), *(Column(head, "SI", ".4g") for head in values)]
        rows = [*zip(self.robot.joint_names, *values.values(), strict=True)]
        return Table(columns, [[*row] for row in rows])

    @property
    def limited(self) -> Robot:
        """Robot with these limits of speed, acceleration and jerk, for our own planners."""
        changes = {"qd_max": self._usable.speed, "qdd_max": self.qdd_max, "qddd_max": self.qddd_max}
        return self.robot.with_limits(None, **changes)

    def export(self, path: str | Path, form: str | None = None) -> Path:
        """Write the limits to a file for another planner; return its path.

        Parameters
        ----------
        path : str or Path
            File to write.
        form : {"moveit", "curobo", "urdf"}, optional
            Format: ``joint_limits.yaml`` of MoveIt, the ``cspace`` part of a cuRobo robot file, or
            URDF 1.2, which has attributes for limits of acceleration and jerk. Default: URDF if the
            path ends in .urdf, otherwise MoveIt. The speed limits in files of MoveIt and URDF are
            those of the proof.

        Raises
        ------
        InputError
            Unknown format, an ending that does not fit the format, or limits that allow no motion:
            no box is proved, or the largest speeds are zero.

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
        """Return a ``ruckig.InputParameter`` with these limits; the caller adds start and target.

        Raises
        ------
        InputError
            Missing package ruckig, or limits that allow no motion.
        """
        given = needed("ruckig", "an input of ruckig needs").InputParameter(self.robot.joint_count)
        given.max_velocity = self._usable.speed.tolist()
        given.max_acceleration = self.qdd_max.tolist()
        if self.qddd_max is not None:
            given.max_jerk = self.qddd_max.tolist()
        return given

    @property
    def _usable(self) -> AccelerationLimits:
        """Limits themselves; InputError if they allow no motion."""
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

    Planners that do not compute torques (MoveIt, ruckig, Pilz, cuRobo) need one acceleration limit
    for each joint. The result is a box ``|qdd_i| <= a_i``: inside of it **no** position of the
    region, no speed up to ``speed`` and no payload of the range needs more torque than a joint has.
    By default the box has the largest product of the accelerations.

    Branch and bound over positions and speeds proves the box. It uses bounds of the curvature of
    mass matrix, Coriolis coefficients and gravity, with a margin above all rounding errors. The
    result also holds a larger box, ``broken``, and a state that breaks it: the best possible box
    lies between both. If the robot has capsules, positions in which it touches itself are left out,
    by the rules of :class:`Scene`; capsules fitted around other geometry leave out none.

    Parameters
    ----------
    robot : Robot
        Robot with masses and with limits of all torques.
    payload : float or (float, float)
        Point mass at the tool, or the least and the largest mass, kg. Torques are affine in the
        mass, so a proof for both ends holds for all masses between them.
    region : optional
        Positions that the arm may have: ``(lower, upper)`` joint positions, a :class:`Box` that
        holds the tool's origin, or a path as a motion or as poses [N,n]. A path stands for the
        boxes of joint positions between successive poses. Default: the joint limits.
    speed : float or array_like [n]
        Largest speeds in both directions, as a share of the velocity limits from 0 (rest) to 1, or
        as one value for each joint, rad/s (m/s).
    coupled : float, optional
        Largest value of ``sqrt(sum_j (qd_j / speed_j)^2)``, above 0 and at most 1. With 1, one
        joint alone may have its largest speed. Default: all joints may have it at once.
    jerk : bool
        Compute limits of the jerks as well, for the proved accelerations, from the limits of the
        torque rates. The rate of Coulomb friction, a step at speed zero, is left out.
    equal : bool
        Require one acceleration for all joints.
    ratios : array_like [n], optional
        Required ratios of the accelerations.
    payload_center : array_like [3]
        Position of the payload in the tool frame, m.
    gap : float
        Allowed relative gap between the proved and the broken box, above 0 and at most 1.
    work : float
        Largest processor time, s. At its end the box that is proved so far is returned.
    seed : int
        Seed of the random states that the search starts with.

    Returns
    -------
    AccelerationLimits
        Largest box that is proved, and a larger one that a known state breaks.

    Raises
    ------
    InputError
        A robot without masses; a joint without a limit of torque, or of velocity or torque rate if
        it is needed; a negative payload; a region outside of the joint limits, or without free
        positions.

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
    positions = position_region(robot, region)
    arms = _ends(robot, loads, payload_center)
    for key in ("tau", "taud")[: 1 + jerk]:
        _bounds(robot, key)
    terms = _terms(arms, positions)
    demands = _demands(arms, terms, speeds, radius)
    found = _largest(demands, positions, shape, gap, work, seed)
    status, advice = Status.SOLVED, ""
    if found.worst.scale <= 0.0:
        status, advice = Status.INFEASIBLE, _why_none(arms, found.worst)
    elif not found.done:
        status, advice = Status.TIME_LIMIT, found.unfinished
    rates: dict[str, FloatArray] = {}
    if jerk and found.proved.any():
        demands = _rate_demands(arms, terms, speeds, found.proved)
        rate = _largest(demands, positions, shape, gap, work, seed)
        rates = {"qddd_max": rate.proved, "jerk_broken": rate.broken}
        if rate.worst.scale <= 0.0:
            name = robot.joint_names[rate.worst.demand.joint]
            status = Status.INFEASIBLE
            advice = (
                f"{name}: speeds and accelerations alone need more than its torque rate: give less "
                "speed or a smaller region"
            )
        elif not rate.done and status.solved:
            status, advice = Status.TIME_LIMIT, f"jerk: {rate.unfinished}"
    return AccelerationLimits(
        robot=robot,
        status=status,
        qdd_max=found.proved,
        broken=found.broken,
        state=_state(arms, found.worst, found.broken),
        payload=loads,
        speed=speeds,
        region=positions.words,
        boxes=found.boxes,
        advice=advice,
        **rates,
    )


class _LargestBox(NamedTuple):
    """Largest box of accelerations or jerks.

    ``proved`` and ``broken`` [n] are the box that is proved, and the one that ``worst`` breaks.
    ``boxes`` is the number of boxes of the proof, ``done`` is True if the gap is small enough.
    """

    proved: FloatArray
    broken: FloatArray
    worst: search.CriticalState
    boxes: int
    done: bool

    @property
    def unfinished(self) -> str:
        """Advice if the work ended early."""
        left = 100 * _gap(self.proved, self.broken)
        return f"the work ended at a gap of {left:.3g} %: give more, a smaller region or less speed"


def _largest(
    demands: list[Demand],
    positions: PositionRegion,
    shape: FloatArray | None,
    gap: float,
    work: float,
    seed: int,
) -> _LargestBox:
    """Return the largest box that no known state breaks, and the part of it that is proved."""
    rng = np.random.default_rng(seed)
    with deadline.within(np.inf, work):
        known = search.sampled_states(demands, positions, rng)
        box, known = _box(known, positions, shape, rng)
        proof = search.BoxProof(0.0, known, 0, False)
        if known.worst(box).scale > 0.0:
            proof = search.prove(known, box, positions, gap, MOST_BOXES)
    worst = proof.known.worst(box)  # the proof itself may find a state without any acceleration
    proved, broken = max(min(proof.scale, worst.scale), 0.0), max(worst.scale, 0.0)
    return _LargestBox(proved * box, broken * box, worst, proof.count, proof.done)


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
    """Return the arm with the least and with the largest payload, by payload.

    Torques are affine in the mass, so those of a mass in between lie in between. The function
    checks this property at random states and raises RuntimeError if it fails.
    """
    low, high = loads
    arms = {load: robot.with_payload(load, center) for load in sorted({low, high})}
    if low < high:
        middle = robot.with_payload((low + high) / 2, center)
        states = np.random.default_rng(0).uniform(-1.0, 1.0, (3, 8, robot.joint_count))
        ends = [arm.torques_along(*states)["tau"] for arm in (*arms.values(), middle)]
        off = np.abs(ends[2] - (ends[0] + ends[1]) / 2).max()
        if off > ROUNDING * np.abs(ends).max():
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


def _terms(arms: dict[float, Robot], positions: PositionRegion) -> dict[float, list[Terms]]:
    """Return the terms of every joint's torque, by payload, with bounds valid in a region."""
    ends = (positions.boxes.low.min(axis=0), positions.boxes.high.max(axis=0))
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
    """Return the torque demands of every joint, towards both limits, for every payload."""
    demands = []
    for load, arm in arms.items():
        lower, upper = _bounds(arm, "tau")
        viscous, coulomb = (arm.friction_of(f"{kind}_friction") for kind in ("viscous", "coulomb"))
        for k, joint_terms in enumerate(terms[load]):
            for side, limit in ((1.0, upper[k]), (-1.0, -lower[k])):
                demand = joint_terms, k, side, limit, speeds, viscous[k], coulomb[k], load
                ball = radius if speeds.any() else None
                demands.append(Demand(*demand) if ball is None else CoupledDemand(*demand, ball))
    return demands


def _rate_demands(
    arms: dict[float, Robot],
    terms: dict[float, list[Terms]],
    speeds: FloatArray,
    accelerations: FloatArray,
) -> list[Demand]:
    """Return the torque rate demands of every joint for every payload."""
    demands = []
    for load, arm in arms.items():
        limit = np.minimum(*np.abs(_bounds(arm, "taud")))
        viscous = arm.friction_of("viscous_friction")
        for k, joint_terms in enumerate(terms[load]):
            demand = joint_terms, k, 1.0, limit[k], speeds, viscous[k], 0.0, load, accelerations
            demands.append(RateDemand(*demand))
    return demands


def _box(
    known: search.KnownStates,
    positions: PositionRegion,
    shape: FloatArray | None,
    rng: np.random.Generator,
) -> tuple[FloatArray, search.KnownStates]:
    """Find the largest box [n] that no known state breaks, with ratios ``shape`` if given."""
    count = len(known.demands[0].speed)
    moved = np.max([states.rows.max(axis=0) for states in known.states], axis=0)
    if not moved.all():
        raise InputError(f"joint {int(moved.argmin()) + 1} moves no mass: no torque limits it")
    room = min(float(states.room.min()) for states in known.states)

    def of_shape(known: search.KnownStates) -> FloatArray:
        if shape is None:
            return search.box_of_largest_product(known, count)
        return shape * known.worst(shape).scale

    if room <= 0.0:  # Gravity and speed use up a torque: the box is empty.
        return np.ones(count), known
    return search.largest_box(known, positions, of_shape, rng)


def _why_none(arms: dict[float, Robot], worst: search.CriticalState) -> str:
    """Return the advice for an empty box: gravity or speed alone exceed a torque."""
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
        # If all speeds are scaled by s < 1, Coriolis torques fall with s^2 and friction falls less.
        # This root is therefore an upper bound of s, and the advice says "less than".
        share = np.sqrt((state.limit - at_rest.torque) / (state.torque - at_rest.torque))
        why = f"the arm{held} takes {state.torque:.4g} without any acceleration"
        remedy = f"less than {share:.2g} of these speeds, {lower}"
    return (
        f"{state.joint}: {why}, of {state.limit:.4g} {unit}, at q = ({place}), "
        f"qd = {state.qd.round(3).tolist()} rad/s (m/s): give {remedy} or a smaller region"
    )


def _state(
    arms: dict[float, Robot], worst: search.CriticalState, box: FloatArray, *, moving: bool = True
) -> BreakingState:
    """Return the state of a joint's largest torque, with the torque from inverse dynamics.

    ``worst`` holds speeds for the upper limit; at the lower limit (side -1) all signs are reversed.
    """
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
