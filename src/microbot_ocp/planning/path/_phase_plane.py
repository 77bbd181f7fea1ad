"""The phase plane of a path: bounds of its speed, the best speed profile, and its active limits.

At a point of the path every limit is ``a s'' + f s' + b s'^2 <= h``, with viscous friction f. Two
limits that bound s'' from both sides eliminate it, and a bound of s' alone remains. The least of
these bounds along the path is the maximum-velocity curve of Bobrow, Dubowsky and Gibson,
"Time-optimal control of robotic manipulators along specified paths", IJRR 4(3), 1985: above it no
acceleration keeps every limit. The best profile lies below it and follows one limit at every
moment; it switches from one limit to the next.

Theory: docs/theory/path_timing.md, "The phase plane".
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby, pairwise
from typing import Any, NamedTuple

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.codegen import compiles
from microbot_ocp.limits import LIMIT_TOLERANCE, JointLimits, Limits
from microbot_ocp.motion import PiecewisePolynomial
from microbot_ocp.planning.path._curve import TINY, segments, stops
from microbot_ocp.planning.path._fast_timing import PathTiming, timed
from microbot_ocp.planning.path._limits import FAR, NEGLIGIBLE, LimitRows, Nodes, PathLimits
from microbot_ocp.planning.path._reachability import CurveLimits, Reached
from microbot_ocp.planning.task import VISCOUS, check_limits
from microbot_ocp.robot import Robot


class PathLimit(NamedTuple):
    """One limit of one joint.

    Attributes
    ----------
    quantity : str
        Key of the limit, such as "tau".
    joint : int
        Index of the joint, from 0; 0 if the limit does not belong to a joint.
    side : int
        1 for the upper limit, -1 for the lower one.
    """

    quantity: str
    joint: int
    side: int


class LimitArc(NamedTuple):
    """A part of the best profile on one limit: path parameters of its ends, and the limit.

    ``limit`` is None for a part below all limits.
    """

    start: float
    end: float
    limit: PathLimit | None


@dataclass(frozen=True, eq=False)
class PhasePlane(PathTiming):
    """Bounds and best profile of the speed ds/dt along a path, with its timing.

    Attributes
    ----------
    torque_bound : array [N+1]
        Maximum-velocity curve: largest ds/dt at which limits of torque and acceleration allow an
        acceleration; infinite if they do at any speed.
    velocity_bound : array [N+1]
        Largest ds/dt within the velocity limits.
    least : array [N+1]
        Smallest ds/dt at which the limits allow an acceleration; 0 if the arm can rest.
    velocity_joint : array [N+1]
        Index of the joint whose velocity limit is the tightest; -1 if a limit of another kind, such
        as the tool's speed, is tighter.
    arcs : tuple of LimitArc
        Parts of the profile by their active limit, in order.
    """

    torque_bound: FloatArray
    velocity_bound: FloatArray
    least: FloatArray
    velocity_joint: np.ndarray
    arcs: tuple[LimitArc, ...]

    @property
    def feasible(self) -> bool:
        """True if the path is feasible within the limits."""
        return bool(np.isfinite(self.duration))

    @property
    def bound(self) -> FloatArray:
        """Largest admissible ds/dt [N] under all limits."""
        return np.minimum(self.torque_bound, self.velocity_bound)

    @property
    def switches(self) -> FloatArray:
        """Path parameters at which the profile switches from one limit to another."""
        return np.array([b.start for a, b in pairwise(self.arcs) if a.limit != b.limit])

    @property
    def switch_speeds(self) -> FloatArray:
        """Speed ds/dt at the switches."""
        return np.interp(self.switches, self.s, self.speed)


def phase_plane(
    robot: Robot,
    path: PiecewisePolynomial,
    limits: Limits | JointLimits | None = None,
    *,
    grid: int = 1000,
    time_limit: float = np.inf,
) -> PhasePlane:
    """Compute the phase plane of a path from rest to rest.

    Limits outside of the phase plane, neither of the velocity nor affine in s'' and s'^2 (torque
    rates, jerk, power), are left out; the stops that they enforce are kept.

    Parameters
    ----------
    robot : Robot
        Robot with masses.
    path : PiecewisePolynomial
        Joint positions over any path parameter; the arm stops at corners.
    limits : Limits, optional
        Default: the robot's own.
    grid : int
        Number of intervals of each segment between two stops.
    time_limit : float
        Wall time, s, after which no further segment is started.

    Returns
    -------
    PhasePlane
        Bounds of ds/dt along the path, and the best profile below them.

    Raises
    ------
    InputError
        A path of another number of joints, limits that leave the duration unbounded from below, or
        a grid that is too coarse.

    Examples
    --------
    >>> import numpy as np
    >>> import microbot_ocp as mo
    >>> robot = mo.load_robot("microbot")
    >>> plane = phase_plane(robot, mo.straight_path(np.radians([[0, 0, 0], [0, 45, 30]])))
    >>> bool((plane.speed <= plane.bound * (1 + 1e-9)).all())
    True
    """
    count = robot.joint_count
    if path.coefficients.shape[2] != count:
        raise InputError(f"path must have {count} joints, not {path.coefficients.shape[2]}")
    checks.whole("grid", grid, "points", at_least=10)
    family = check_limits(robot, limits)
    curves = segments(path, stops(path, family))
    timing = timed(family, path, curves, grid, time_limit, compiles())
    ends = np.cumsum([reached.s.size for _, reached in timing.parts])
    bounds, arcs = [], list[LimitArc]()
    for (along, reached), s in zip(timing.parts, np.split(timing.s, ends), strict=False):
        bounds.append(_bounds(along))
        if reached.feasible:
            arcs += _arcs(s, reached, along)
    joined: Any = {name: np.concatenate([part[name] for part in bounds]) for name in bounds[0]}
    return PhasePlane(**vars(timing), **joined, arcs=tuple(arcs))


def _bounds(along: CurveLimits) -> dict[str, np.ndarray]:
    """Return the bounds of a phase plane between two stops, by the names of its arrays."""
    nodes, rows, size = along.nodes, along.rows, along.s.size
    viscous = np.zeros_like(rows.per_x)
    columns, joints = rows.torques
    coefficients = along.limits.family.robot.friction_of(VISCOUS)
    viscous[:, columns] = coefficients[joints] * nodes.tangent[:, joints]
    least, most = speed_range(rows, viscous)
    least = _at_points(nodes, size, least, np.maximum)
    most = _at_points(nodes, size, most, np.minimum)
    fastest, scale = np.sqrt(along.speed_limit), along.curve.parameter(along.s)[1]
    return {
        "torque_bound": most * scale,
        "velocity_bound": np.where(fastest >= np.sqrt(FAR), np.inf, fastest * scale),
        "least": least * scale,
        "velocity_joint": _fastest_joint(along.limits, size),
    }


def speed_range(rows: LimitRows, per_v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the smallest and largest v = s' [nodes] for which some s'' satisfies all rows.

    docs/theory/path_timing.md, "The phase plane".

    Parameters
    ----------
    rows : LimitRows
        Coefficients of s'' and s'^2, with bounds.
    per_v : array [nodes, rows]
        Coefficients of s' (viscous friction).

    Returns
    -------
    least, most : array [nodes]
        ``most`` is below ``least`` if no speed is admissible, and infinite if no speed is too
        large. Under viscous friction the admissible set may have gaps between them.
    """
    # Both bounds of every row as a u + f v + b v^2 <= h. Fourier-Motzkin: a row with a > 0 plus one
    # with a < 0, each divided by |a|, bounds v alone; so does a row with a = 0.
    sides = ((1.0, rows.upper), (-1.0, -rows.lower))
    a, f, b = (
        np.hstack([sign * table for sign, _ in sides]) for table in (rows.per_u, per_v, rows.per_x)
    )
    h = np.hstack([bound for _, bound in sides])
    flat = np.abs(a) <= NEGLIGIBLE * np.abs(a).max(axis=0, initial=TINY)
    size = np.where(flat, 1.0, np.abs(a))
    f, b, h = f / size, b / size, h / size
    above, below = ~flat & (a > 0), ~flat & (a < 0)

    def pairs(values: FloatArray) -> FloatArray:
        both = values[:, :, None] + values[:, None, :]
        return np.hstack([both.reshape(len(values), -1), values])

    joint = (above[:, :, None] & below[:, None, :]).reshape(len(a), -1)
    used = np.hstack([joint, flat])
    start, end = _refused(pairs(b), pairs(f), np.where(used, pairs(h), np.inf))
    least, most = np.zeros((len(a), 1)), np.full((len(a), 1), np.inf)
    for _ in range(start.shape[1]):  # move both ends out of the refused intervals until none moves
        raised = np.where((start < least) & (least < end), end, least).max(axis=1)[:, None]
        lowered = np.where((start < most) & (most <= end), start, most).min(axis=1)[:, None]
        if np.array_equal(raised, least) and np.array_equal(lowered, most):
            break
        least, most = raised, lowered
    return least.ravel(), most.ravel()


def _refused(b: FloatArray, f: FloatArray, h: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return open intervals of v >= 0 with ``f v + b v^2 > h``, two columns per constraint.

    A start below zero refuses zero as well; an empty interval is (inf, inf).
    """
    b = b + 0.0  # a negative zero would give quotients of the wrong sign
    with np.errstate(divide="ignore", invalid="ignore"):
        square = f**2 + 4 * b * h
        # Roots of b v^2 + f v - h by the stable quadratic formula, without cancellation.
        q = -0.5 * (f + np.copysign(np.sqrt(np.maximum(square, 0.0)), f))
        roots = q / b, -h / q
        low, high = np.fmin(*roots), np.fmax(*roots)
    # b >= 0: refused outside of the roots, or everywhere without roots. b < 0: refused between the
    # roots, if there are any.
    constant = (b == 0) & (f == 0)
    always = (b >= 0) & (square < 0) | constant & (h < 0)
    outside = (b >= 0) & ~always & ~constant
    between = (b < 0) & (square > 0)
    empty = np.inf
    second = np.where(outside, high, np.where(between, low, empty))
    start = np.hstack([np.where(always | outside, -1.0, empty), second])
    end = np.hstack([np.where(outside, low, empty), np.where(between, high, empty)])
    none = np.hstack([np.isinf(h)] * 2) | (end <= 0)
    return np.where(none, empty, start), np.where(none, empty, end)


def _at_points(nodes: Nodes, size: int, values: FloatArray, choose: np.ufunc) -> FloatArray:
    """Return values at grid points from those at nodes: the tighter of both sides of a break."""
    result = values[:size].copy()
    choose.at(result, np.arange(1, size), values[nodes.right])
    return result


def _fastest_joint(limits: PathLimits, size: int) -> np.ndarray:
    """Return the joint with the tightest velocity limit at grid points [size], or -1."""
    joints = limits.speed.get("qd")
    if joints is None:
        return np.full(size, -1)
    nearest, least = joints.argmin(axis=1), joints.min(axis=1)
    for bound in limits.speed.values():
        nearest = np.where(bound.min(axis=1) < least, -1, nearest)
    return nearest[:size]


SHORTEST_ARC = 3  # smallest number of grid intervals of an arc


def _arcs(s: FloatArray, timing: Reached, along: CurveLimits) -> list[LimitArc]:
    """Return the runs of grid intervals on one limit; short runs join the one before."""
    rows = along.rows
    if along.has_friction:
        rows = rows.with_friction(along.nodes, along.limits.family.robot, timing.speed_squared)
    names, room = _room(timing, rows, along.nodes, along.limits)
    nearest = room.argmin(axis=1)
    on = np.where(room[np.arange(len(room)), nearest] <= LIMIT_TOLERANCE, nearest, -1)
    runs = [(key, len(list(group))) for key, group in groupby(on.tolist())]
    # A short touch of another limit within an arc would look like two switches.
    merged: list[tuple[int, int]] = []
    for key, length in runs:
        if merged and (length < SHORTEST_ARC or merged[-1][0] == key):
            merged[-1] = (merged[-1][0], merged[-1][1] + length)
        else:
            merged.append((key, length))
    edges = np.cumsum([0, *(length for _, length in merged)])
    return [
        LimitArc(float(s[a]), float(s[b]), None if key < 0 else names[key])
        for (key, _), (a, b) in zip(merged, pairwise(edges), strict=True)
    ]


def _room(
    timing: Reached, rows: LimitRows, nodes: Nodes, limits: PathLimits
) -> tuple[list[PathLimit], FloatArray]:
    """Return every limit by name, and the distance [N, limits] of the profile from it.

    Distances are shares of the limit's range, the lesser one of both ends of every grid interval.
    """
    x = timing.speed_squared[:, None]
    first = np.arange(rows.right.size)
    ends = ((first, x[:-1], timing.start[:, None]), (rows.right, x[1:], timing.end[:, None]))
    names: list[PathLimit] = []
    rooms = []  # arrays at both ends of intervals
    span = rows.upper - rows.lower
    for side, bound in ((1, rows.upper), (-1, rows.lower)):
        # A limit with one bound has no range: its magnitude, plus one, replaces it.
        size = np.where(np.isfinite(span), span, 1.0 + np.abs(bound))
        values = ((at, rows.per_u[at] * u + rows.per_x[at] * speed) for at, speed, u in ends)
        rooms.append([side * (bound[at] - value) / size[at] for at, value in values])
        names += [PathLimit(quantity, joint, side) for quantity, joint in rows.names]
    with np.errstate(invalid="ignore", divide="ignore"):
        for quantity, bound in limits.speed.items():
            if quantity != "qd":
                rooms.append([1.0 - np.sqrt(speed / bound[at]) for at, speed, _ in ends])
                names += [PathLimit(quantity, k, 1) for k in range(bound.shape[1])]
        if "qd" in limits.speed:
            member = limits.family["qd"]
            sides = np.stack([member.upper, member.lower], axis=1)
            velocities = (nodes.tangent[at] * np.sqrt(speed) for at, speed, _ in ends)
            rooms.append([(1.0 - v[..., None] / sides).reshape(len(v), -1) for v in velocities])
            names += [
                PathLimit("qd", joint, side) for joint in range(len(sides)) for side in (1, -1)
            ]
    room = np.hstack([np.minimum(*pair) for pair in rooms])
    return names, np.nan_to_num(room, nan=np.inf, posinf=np.inf)
