"""Input checks of time-optimal tasks before a solver starts, and the declaration of limits."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from functools import lru_cache, partial
from typing import Any, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.codegen import compile_recipe
from microbot_ocp._base.foreign_words import NAMES
from microbot_ocp.limits import (
    ROUNDING,
    JointLimits,
    LimitChanges,
    LimitFamily,
    Limits,
    Member,
    MotionSamples,
)
from microbot_ocp.ocp import Phase
from microbot_ocp.planning.task._scale import LONGEST_MOTION, TaskScale
from microbot_ocp.robot import (
    Robot,
    has_torque_derivatives,
    inverse_dynamics,
    torque_and_rate,
    torque_derivatives,
)

STATE: tuple[str, ...] = ("q", "qd", "qdd", "qddd")
GAP = 1e-5  # relative gap of a duration to its local optimum
ROUGH_TOLERANCE = 1e-6  # solver tolerance on all meshes but the last one
LDL = {"ipopt": {"linear_solver": "ldl"}}  # options by solver: see ocp/solvers/_ldl.py
# A joint alone takes (factor distance / limit)^(1 / order) from rest to rest under one limit.
REST_TO_REST = {"qd": (1, 1), "qdd": (4, 2), "qddd": (32, 3), "taud": (1, 1)}
MOST_VIA = 500
# Default wall time, s: of motions through via points or along a path; of stops, their orders and
# scenes.
TIME_LIMIT, CELL_TIME_LIMIT = 120.0, 600.0
NEAREST = 1e-8  # smallest distance of states that a certificate tells apart, rad (m)
CHECKS_PER_INTERVAL = 20  # number of checks of the limits inside every mesh interval

Settings = TypeVar("Settings")


def with_changes(settings: Settings, changes: Mapping[str, Any]) -> Settings:
    """Return settings with some fields replaced.

    Raises
    ------
    TypeError
        An unknown setting.
    """
    names = [f.name for f in fields(settings)]  # type: ignore[arg-type]
    for name in changes:
        if name not in names:
            hint = checks.did_you_mean(name, names)
            if NAMES.get(name, name) in LimitChanges.__annotations__:
                hint = (
                    f"; limits go into limits=robot.with_limits({NAMES.get(name, name)}=...).limits"
                )
            raise TypeError(f"there is no setting {name!r}{hint} (settings: {', '.join(names)})")
    return replace(settings, **changes)  # type: ignore[type-var]


def reach_of(robot: Robot) -> float:
    """Return the sum of the lengths of a robot's links and tool, m; 1 if all are zero."""
    rows = np.hypot(robot.a, robot.d)
    return float(rows.sum() + np.linalg.norm(robot.tool[:3, 3])) or 1.0


def _slides(robot: Robot) -> FloatArray:
    """Return the largest displacement [N] of every prismatic joint, m; zero for other joints."""
    low, high = robot.chain.limits.bounds("q")
    prismatic = np.array([kind == "prismatic" for kind in robot.chain.joint_types])
    return np.where(prismatic, np.maximum(np.abs(low), np.abs(high)), 0.0)


def farthest_tool(robot: Robot) -> float:
    """Return an upper bound on the distance of the tool's origin from the base, m."""
    return reach_of(robot) + float(_slides(robot).sum())


def fastest_tool(robot: Robot) -> float:
    """Return an upper bound on the speed of the tool's origin, m/s, with all joints at limits."""
    robot = robot.chain
    speeds = np.maximum(-robot.limits.qd_min, robot.limits.qd_max)
    prismatic = np.array([kind == "prismatic" for kind in robot.joint_types])
    # A revolute joint moves the tool by at most its speed times the length of the links beyond it.
    rows = np.hypot(robot.a, np.abs(robot.d) + _slides(robot))
    beyond = np.append(np.cumsum(rows[:0:-1])[::-1], 0.0) + np.linalg.norm(robot.tool[:3, 3])
    levers = np.where(prismatic, 1.0, beyond)
    return float((speeds[levers > 0] * levers[levers > 0]).sum())


def length_text(value: float) -> str:
    """Return a length for a sentence: in millimetres below one metre."""
    return f"{1e3 * value:.3g} mm" if value < 1.0 else f"{value:.4g} m"


def check_limits(
    robot: Robot, limits: Limits | JointLimits | None, *, means: bool = False
) -> LimitFamily:
    """Return the limits of a task; raise InputError if they leave a joint's motion unbounded.

    ``means`` admits limits of means over the whole motion, for a planner that supports them.
    """
    family = LimitFamily.of(robot, limits)
    if not means:
        family.refuse_means()
    for joint, name in enumerate(robot.joint_names):
        if not family.bounds_motion_of(joint):
            raise InputError(
                f"limits leave joint {name!r} without any bound on its "
                "velocity, acceleration or torque: its shortest time would be zero"
                + ("" if robot.has_dynamics else "; without masses torques bound nothing")
            )
    return family


def check_via(family: LimitFamily, via_q: ArrayLike, *, moving: bool = False) -> FloatArray:
    """Return via points [m,n], m >= 2, rad (m), within the position limits and holdable at rest.

    Only the first and the last point must be holdable; with ``moving`` the first need not be.

    Raises
    ------
    InputError
        Wrong width, not finite, a point outside the position limits, two equal points in a row, a
        pose of rest that gravity makes impossible, or limits that make the motion last for days.
    """
    via = checks.array("via_q", via_q, (None, family.robot.joint_count), "rad")
    count = len(via)
    if not 2 <= count <= MOST_VIA:
        allowed = f"at least 2 points and at most {MOST_VIA} points"
        raise InputError(f"via_q must have {allowed}, not {count:,}")
    check_positions(family, lambda i: f"via point {i + 1}", via)
    for index, apart in enumerate(np.abs(np.diff(via, axis=0)).max(axis=1), 1):
        if 0.0 < apart < NEAREST:
            raise too_near(index, apart, f"below {NEAREST:g} no certificate could tell them apart")
        if apart == 0.0 and moving and index == 1:
            raise InputError(
                "start is at via point 2 already: move that a little, or stop the arm on its path "
                "by mo.execution.overridden"
            )
        if apart == 0.0:
            raise InputError(
                f"via points {index} and {index + 1} are the same: the time between them would "
                "be a duration of zero"
            )
    for joint in np.flatnonzero(locked_joints(family)).tolist():
        for index in np.flatnonzero(np.diff(via[:, joint])).tolist():
            robot = family.robot
            start, end = (robot.position_text(joint, q) for q in via[index : index + 2, joint])
            raise InputError(
                f"joint {robot.joint_names[joint]!r} cannot move, as a limit of its velocity, "
                f"acceleration or jerk is 0, but is at {start} at via point {index + 1} and at "
                f"{end} at the next"
            )
    check_pace(family, via, at_rest=not moving)
    for index in (count - 1,) if moving else (0, count - 1):
        check_rest(family, lambda _, k=index: f"via point {k + 1}", via[[index]])
    return via


def too_near(number: int, apart: float, why: str) -> InputError:
    """Return the error of two consecutive via points, the first numbered from 1, and its reason."""
    return InputError(
        f"via points {number} and {number + 1} are {apart:.2g} rad (m) apart in every joint or "
        f"less: {why}"
    )


def check_pace(family: LimitFamily, places: FloatArray, at_rest: bool = True) -> None:
    """Raise InputError if limits make joints take too long between places [m,n], rad (m).

    A limit of the torque rate counts if torques hold the arm ``at_rest`` in the first and the last
    place.
    """
    robot = family.robot
    way = np.ptp(places, axis=0)
    ways = [(key, way) for key in STATE[1:]]
    if at_rest and "taud" in family:
        held = robot.torques_along(*MotionSamples.at_rest(places[[0, -1]])[:3])["tau"]
        ways.append(("taud", np.ptp(held, axis=0)))
    for key, way in ways:
        low, high = robot.limits.bounds(key)
        most, (factor, order) = np.maximum(-low, high), REST_TO_REST[key]
        share = np.divide(factor * way, most, out=np.zeros_like(way), where=most > 0)
        lasts = share ** (1 / order)
        j = int(lasts.argmax())
        if lasts[j] > checks.LONGEST:
            unit = family[key].units[j]
            raise InputError(
                f"{key}_max of joint {robot.joint_names[j]!r} is {most[j]:g} {unit}, so the motion "
                f"would last more than {lasts[j]:.3g} s: those of at most {checks.LONGEST:g} s are "
                "looked for"
            )
    further = ", ".join(m.name for m in family if m.limit is not None and m.order)
    moving = np.append(True, np.diff(places, axis=0).any(axis=1))
    if not further or not moving[1:].any():
        return
    lasts = float(TaskScale.of(family, places[moving]).durations.sum())
    if lasts > LONGEST_MOTION:
        raise InputError(
            f"a limit ({further}) lets a straight motion last some {lasts:.1g} s: those of at most "
            f"{checks.LONGEST:g} s are looked for"
        )


@lru_cache(maxsize=64)
def locked_joints(family: LimitFamily) -> np.ndarray:
    """Return a mask [n] of joints whose velocity, acceleration or jerk is limited to zero."""
    bounds = [np.array(family.robot.limits.bounds(key)) for key in STATE[1:]]
    return np.any([(pair == 0.0).all(axis=0) for pair in bounds], axis=0)


def with_locked_joints_held(family: LimitFamily, bounded: str | None = "qdd") -> LimitFamily:
    """Return the limits with each locked joint bounded once; more bounds repeat the equation.

    ``bounded`` is the quantity kept at zero; None if the program cannot move these joints anyway.
    """
    locked = locked_joints(family)
    if not locked.any():
        return family
    changes = {}
    for key in STATE:
        low, high = family.robot.limits.bounds(key)
        size = 0.0 if key == bounded else np.inf
        changes[f"{key}_min"] = np.where(locked, -size, low)
        changes[f"{key}_max"] = np.where(locked, size, high)
    return LimitFamily.of(family.robot, family.robot.limits.changed(changes))


def check_positions(family: LimitFamily, label: Callable[[int], str], q: FloatArray) -> None:
    """Raise InputError if one of several poses [N,n] violates the limits of position."""
    robot, keys = family.robot, family.of_order(0)
    for key, values in family.values(MotionSamples.at_rest(q), keys).items():
        member = family[key]
        slack = ROUNDING
        outside = (values.value < values.lower - slack) | (values.value > values.upper + slack)
        for i, j in np.argwhere(outside):
            if key == "q":
                at, low, high = (robot.position_text(j, v) for v in values.entry(i, j))
                raise InputError(
                    f"{label(i)} is outside the position limits: joint {robot.joint_names[j]!r} at "
                    f"{at}, allowed {low} to {high}"
                    f"{checks.degrees_hint(q[i, j]) if robot.joint_types[j] == 'revolute' else ''}"
                )
            raise InputError(f"{label(i)} breaks a limit: {_broken(member, j, values.entry(i, j))}")


def check_rest(family: LimitFamily, label: Callable[[int], str], q: FloatArray) -> None:
    """Raise InputError if gravity exceeds a joint's torque limit in one of several poses [N,n]."""
    for key, values in family.values(MotionSamples.at_rest(q), family.of_order(1, 2, 3)).items():
        member = family[key]
        if np.all((values.value >= values.lower) & (values.value <= values.upper)):
            continue
        for i, j in np.argwhere(member.use(values) > 1.0 + ROUNDING):
            reason = _broken(member, j, values.entry(i, j))
            if key == "tau":
                value, low, high = values.entry(i, j)
                reason = (
                    f"joint {member.labels[j]!r} needs {value:.6g} {member.units[j]} against "
                    f"gravity, allowed {low:.6g} to {high:.6g} {member.units[j]}"
                )
            raise InputError(f"{label(i)} cannot be held at rest: {reason}")


def _broken(member: Member, j: int, entry: tuple[float, ...]) -> str:
    (value, low, high), unit = entry, member.units[j]
    return f"{member.title(j)} is {value:.6g} {unit}, allowed {low:.6g} to {high:.6g} {unit}"


def rate_switches(rate: FloatArray, member: Member) -> np.ndarray:
    """Return a mask of intervals [N] in which a limited jerk or torque rate [N,n] switches.

    A rate switches in an interval if it differs from both neighbours there, and from both together
    by more than a quarter of its range.
    """
    size = np.where(np.isfinite(member.upper), 0.5 * (member.upper - member.lower), np.inf)
    switches = np.zeros(len(rate), dtype=bool)
    change = np.abs(np.diff(rate / size, axis=0))
    before, after = change[:-1], change[1:]
    switches[1:-1] = ((np.minimum(before, after) > 0.02) & (before + after > 0.5)).any(axis=1)
    return switches


def torques_of(robot: Robot, keys: Sequence[str], payload: bool = False) -> Callable[..., Any]:
    """Return a function of q, qd, qdd and qddd (and a payload's mass, kg): torque, torque rate.

    The rate is None unless ``keys`` contain "taud".
    """
    make = torque_and_rate if "taud" in keys else inverse_dynamics
    torques = partial(_with_payload, make, robot) if payload else partial(make, robot)
    if "taud" in keys:
        return torques()
    return lambda q, qd, qdd, _, *held: (torques()(q, qd, qdd, *held), None)


@lru_cache(maxsize=128)
def _with_payload(make: Callable[[Robot], ca.Function], robot: Robot) -> ca.Function:
    """Return a function of a robot's torques with the mass of a payload as the last argument.

    Torques are linear in the mass m: ``tau(m) = tau(0) + m (tau(1) - tau(0))``.
    """
    empty, holding_one = make(robot), make(robot.with_payload(1.0))
    state = [ca.SX.sym(empty.name_in(k), empty.size1_in(k)) for k in range(empty.n_in())]
    payload = ca.SX.sym("payload")
    pairs = zip(*(function.call(state) for function in (empty, holding_one)), strict=True)
    values = [unloaded + payload * (other - unloaded) for unloaded, other in pairs]
    names = [*empty.name_in(), "payload"]
    return ca.Function(empty.name(), [*state, payload], values, names, empty.name_out())


def derivatives_for(*robots: Robot, compiled: bool = False) -> Callable[[ca.Function], Any]:
    """Return the lookup of known derivatives of a function, for a transcription.

    ``compiled`` compiles them, for stages that are not compiled themselves.
    """

    def find(function: ca.Function) -> Any:
        held = "payload" in function.name_in()
        for robot in robots:
            for make in (inverse_dynamics, torque_and_rate) if robot.has_dynamics else ():
                torques = _with_payload(make, robot) if held else make(robot)
                # The hash of a CasADi function identifies its internal object.
                if torques.__hash__() == function.__hash__():
                    rates = make is torque_and_rate
                    derive = partial(torque_derivatives, robot, rates=rates, payload=held)
                    if not compiled or not has_torque_derivatives(robot):
                        return derive()
                    recipe = f"parts of {function.serialize()}"
                    return compile_recipe(recipe, lambda d=derive: (*(d() or ()), function))
            derivatives_of_limit = LimitFamily.of(robot).derivatives(function, compiled)
            if derivatives_of_limit is not None:
                return derivatives_of_limit
        return None

    return find


def _smooth_size(value: Any, upper: FloatArray) -> Any:
    """Return a smooth function of a norm, which has no slope at zero; both are equal at a bound."""
    return 0.5 * (value**2 / upper + upper)


def bounds_in_program(
    declared: Member, bounds: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Return bounds of the constraint of a limit, which a program declares with other numbers."""
    if declared.limit is None or not declared.limit.is_size:
        return bounds
    return bounds[0], _smooth_size(bounds[1], declared.upper)


def declare_limits(
    phase: Phase,
    family: LimitFamily,
    keys: Sequence[str],
    state: tuple[ca.MX, ca.MX, ca.MX, ca.MX],
    reference: FloatArray,
    torques: Callable[..., Any],
    held: Sequence[ca.MX] = (),
    torque_values: Mapping[str, ca.MX] | None = None,
) -> None:
    """Declare the limits of some keys as constraints of a phase.

    Parameters
    ----------
    phase : Phase
    family : LimitFamily
    keys : sequence of str
    state : tuple of MX
        Expressions q, qd, qdd and qddd [n].
    reference : array [n]
        Pose for the scale of bounds that vary.
    torques : callable
        Torque and torque rate of the state and of ``held``.
    held : sequence of MX
        Further arguments of ``torques``.
    torque_values : mapping, optional
        Expressions that replace the torque and its rate, by key.
    """
    joint_values: dict[str, ca.MX] = {
        **dict(zip(STATE, state, strict=True)),
        **(torque_values or {}),
    }
    if {"tau", "taud"} & set(keys) and torque_values is None:
        joint_values["tau"], joint_values["taud"] = torques(*state, *held)
    further = [key for key in keys if family[key].limit is not None]
    payload = _with_payload(torque_and_rate, family.robot) if held and further else None
    limits = {key: family[key].limit for key in further}
    alone = [key for key, limit in limits.items() if limit and limit.knows_derivatives]
    expressions = family.expressions(
        [key for key in further if key not in alone], (*state, *held), payload
    )
    for key in alone:  # a separate function keeps its own derivatives
        expressions |= family.expressions([key], state)
    usual = family.values(MotionSamples.at_rest(reference), further)
    for key in keys:
        member = family[key]
        # A limit of positions changes little between mesh points, so it needs no interior points.
        inner = member.order > 0
        declare = partial(phase.constraint, unit=member.units[0], interior_points=inner)
        if member.limit is None or not member.varies:
            value = joint_values[key] if member.limit is None else expressions[key][0]
            scale = finite_scale(member.lower, member.upper)
            if member.limit is not None and member.limit.is_size:
                value = _smooth_size(value, member.upper)
            declare(member.name, value, member.lower, member.upper, scale=scale)
            continue
        sizes = usual[key].lower, usual[key].upper
        _declare_varying(declare, member.name, *expressions[key], sizes)


def _declare_varying(
    declare: Callable[..., Any], name: str, value: ca.MX, lower: Any, upper: Any, sizes: Any
) -> None:
    """Declare a limit whose bounds are expressions as one constraint for each bound."""
    sides = ("lower", "upper"), (-1.0, 1.0), (lower, upper), sizes
    for side, sign, bound, size in zip(*sides, strict=True):
        constant = not isinstance(bound, ca.MX)
        if constant and not np.isfinite(bound).any():
            continue
        room = sign * (value - (ca.DM(bound) if constant else bound))
        scale = finite_scale(np.ravel(size), np.ravel(size))
        declare(f"{name}, {side} limit", room, upper=0.0, scale=scale)


def finite_scale(
    lower: FloatArray, upper: FloatArray, otherwise: float | FloatArray = 1.0
) -> FloatArray:
    """Return magnitudes [n] of limits, or other values for joints without a limit."""
    size = np.maximum(np.abs(lower), np.abs(upper))
    return np.where(np.isfinite(size) & (size > 0), size, otherwise)
