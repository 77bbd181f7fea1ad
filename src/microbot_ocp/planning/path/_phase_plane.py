"""The phase plane of a path: how fast its parameter may run, how fast it runs at best, and why.

At a point of the path every limit is ``a s'' + f s' + b s'^2 <= h`` (f is viscous friction). From
any two limits that bound s'' from both sides it can be eliminated: what is left bounds s' alone.
The least of these bounds along the path is the maximum-velocity curve of Bobrow, Dubowsky and
Gibson, "Time-optimal control of robotic manipulators along specified paths", IJRR 4(3), 1985: above
it no acceleration keeps every limit. The best profile lies below; at every moment it rides on one
limit, and where it changes from one to the next the drive switches.

Theory: docs/theory/path_timing.md, "The phase plane".
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby, pairwise
from typing import NamedTuple

import numpy as np

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.codegen import compiles
from microbot_ocp._base.status import Status
from microbot_ocp.limits import JointLimits, LimitFamily, Limits
from microbot_ocp.motion import PiecewisePolynomial
from microbot_ocp.planning.path._curve import PathCurve, segments, stops
from microbot_ocp.planning.path._limits import FAR, LimitRows, Nodes, PathLimits
from microbot_ocp.planning.path._reachability import CurveLimits, Reached, reach
from microbot_ocp.planning.task import VISCOUS, check_limits, friction
from microbot_ocp.robot import Robot


@dataclass(frozen=True)
class ArcSettings:
    """Settings by which arcs are told.

    Attributes
    ----------
    active : room below a limit, as a ratio of its range, that counts as on the limit
    fewest : grid intervals of an arc; on fewer it is a touch between two others
    """

    active: float = 0.005
    fewest: int = 3


ARCS = ArcSettings()


class PathLimit(NamedTuple):
    """One limit of one joint.

    Attributes
    ----------
    quantity : str
        Key of the limit, such as "tau".
    joint : int
        Index of the joint, from 0 (0 where the limit is not one of the joints).
    side : int
        1 for the upper limit, -1 for the lower one.
    """

    quantity: str
    joint: int
    side: int


class LimitArc(NamedTuple):
    """A part of the best profile that rides on one limit: path parameters, and the limit.

    ``limit`` is None where the profile rides on none.
    """

    start: float
    end: float
    limit: PathLimit | None


@dataclass(frozen=True, eq=False)
class PhasePlane:
    """Bounds and best profile of the speed ds/dt along a path.

    Attributes
    ----------
    s : array [N]
        Path parameter of the grid points; a stop on the way stands there twice.
    speed : array [N]
        ds/dt of the best timing; NaN where there is none.
    torque_bound : array [N]
        The maximum-velocity curve: largest ds/dt at which the limits of torque and acceleration
        leave an acceleration; infinite where they leave one at any speed.
    velocity_bound : array [N]
        Largest ds/dt that the limits of velocities leave.
    least : array [N]
        Smallest ds/dt at which they leave an acceleration: 0 where the arm can rest.
    velocity_joint : array [N]
        Index of the joint whose velocity limit leaves the least ds/dt; -1 where a limit that is not
        one of the joints, such as of the tool's speed, leaves less.
    arcs : tuple of LimitArc
        Parts of the profile by the limit that it rides on, in order.
    duration : float
        s; NaN where the path cannot be travelled or the time was over.
    blocked_at : float
        Path parameter from which the end cannot be reached, NaN where it can.
    status : Status
        Solved, infeasible, or "time limit": all of the above is of the segments that were done.
    """

    s: FloatArray
    speed: FloatArray
    torque_bound: FloatArray
    velocity_bound: FloatArray
    least: FloatArray
    velocity_joint: np.ndarray
    arcs: tuple[LimitArc, ...]
    duration: float
    blocked_at: float
    status: Status = Status.SOLVED

    @property
    def feasible(self) -> bool:
        """Whether the path can be travelled within the limits at all."""
        return bool(np.isfinite(self.duration))

    @property
    def bound(self) -> FloatArray:
        """Largest admissible ds/dt [N], whatever limits it."""
        return np.minimum(self.torque_bound, self.velocity_bound)

    @property
    def switches(self) -> FloatArray:
        """Path parameters at which the profile changes from one limit to another."""
        return np.array([b.start for a, b in pairwise(self.arcs) if a.limit != b.limit])

    @property
    def switch_speeds(self) -> FloatArray:
        """ds/dt at the switches."""
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

    Limits that are neither of the velocity nor affine in s'' and s'^2 (torque rates, jerk, power)
    have no place in it and are left out, but for the stops that they enforce.

    Parameters
    ----------
    robot : Robot
        With masses.
    path : PiecewisePolynomial
        Joint positions over any path parameter; at a corner the arm stops.
    limits : Limits, optional
        Default the robot's own.
    grid : int
        Intervals of each segment between two stops.
    time_limit : float
        Wall time, s, after which no further segment is begun.

    Returns
    -------
    PhasePlane
        Bounds of ds/dt along the path, and the best profile below them.

    Raises
    ------
    InputError
        A path of another number of joints, limits that leave the time free, a grid too coarse.

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
    begin, parts = float(path.breaks[0]), []
    curves = segments(path, stops(path, family))
    with deadline.within(time_limit):
        for curve in curves:
            if parts and deadline.over():
                break
            parts.append(_segment(family, curve, begin, grid))
            begin = float(parts[-1].s[-1])
    joined = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ("s", "speed", "torque_bound", "velocity_bound", "least", "velocity_joint")
    }
    blocked = [part.blocked_at for part in parts if not part.feasible]
    late = len(parts) < len(curves)
    status = deadline.status() if late else Status.SOLVED
    return PhasePlane(
        **joined,
        arcs=tuple(arc for part in parts for arc in part.arcs),
        duration=float("nan") if late else sum(part.duration for part in parts),
        blocked_at=blocked[0] if blocked else float("nan"),
        status=Status.INFEASIBLE if blocked else status,
    )


def _segment(family: LimitFamily, curve: PathCurve, begin: float, grid: int) -> PhasePlane:
    """Compute the phase plane between two stops, first in the regular parameter of the curve."""
    along = CurveLimits.of(family, curve, grid, compiles())
    timing = reach(along)
    nodes, rows = along.nodes, along.rows
    viscous = np.zeros_like(rows.per_x)
    columns, joints = rows.torques
    viscous[:, columns] = friction(family.robot, VISCOUS)[joints] * nodes.tangent[:, joints]
    least, most = speed_range(rows, viscous)
    size = timing.s.size
    least = _at_points(nodes, size, least, np.maximum)
    most = _at_points(nodes, size, most, np.minimum)
    fastest = np.sqrt(along.speed_limit)
    place, scale = curve.parameter(timing.s)
    profile = np.sqrt(timing.speed_squared) if timing.feasible else np.full(size, np.nan)
    if timing.feasible and along.has_friction:
        rows = rows.with_friction(nodes, family.robot, timing.speed_squared)
    s = begin + place
    return PhasePlane(
        s=s,
        speed=profile * scale,
        torque_bound=most * scale,
        velocity_bound=np.where(fastest >= np.sqrt(FAR), np.inf, fastest * scale),
        least=least * scale,
        velocity_joint=_fastest_joint(along.limits, size),
        arcs=tuple(_arcs(s, timing, rows, along)) if timing.feasible else (),
        duration=timing.duration if timing.feasible else float("nan"),
        blocked_at=float(np.interp(timing.blocked_at, timing.s, s)),
    )


def speed_range(rows: LimitRows, per_v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Give the smallest and largest v = s' [nodes] that leave an s'' within all rows.

    docs/theory/path_timing.md, "The phase plane".

    Parameters
    ----------
    rows : LimitRows
        With constants in s'' and s'^2.
    per_v : array [nodes, rows]
        What the rows have in s' besides (viscous friction).

    Returns
    -------
    least, most : array [nodes]
        ``most`` is below ``least`` where no speed is admissible, infinite where all above are. The
        set between them may have gaps under viscous friction.
    """
    # every row twice, as "at most": a u + f v + b v^2 <= h
    sides = ((1.0, rows.upper), (-1.0, -rows.lower))
    a, f, b = (
        np.hstack([sign * table for sign, _ in sides]) for table in (rows.per_u, per_v, rows.per_x)
    )
    h = np.hstack([bound for _, bound in sides])
    flat = np.abs(a) <= 1e-12 * np.abs(a).max(axis=0, initial=1e-300)
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
    for _ in range(start.shape[1]):  # out of every interval, upwards and downwards
        raised = np.where((start < least) & (least < end), end, least).max(axis=1)[:, None]
        lowered = np.where((start < most) & (most <= end), start, most).min(axis=1)[:, None]
        if np.array_equal(raised, least) and np.array_equal(lowered, most):
            break
        least, most = raised, lowered
    return least.ravel(), most.ravel()


def _refused(b: FloatArray, f: FloatArray, h: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Give open intervals of v >= 0 in which ``f v + b v^2 > h``, two columns for each constraint.

    A start below zero means that zero itself is refused; an empty interval is (inf, inf).
    """
    b = b + 0.0  # no negative zero, whose quotients have the wrong sign
    with np.errstate(divide="ignore", invalid="ignore"):
        square = f**2 + 4 * b * h
        q = -0.5 * (f + np.copysign(np.sqrt(np.maximum(square, 0.0)), f))
        roots = q / b, -h / q
        low, high = np.fmin(*roots), np.fmax(*roots)
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
    """Give values at grid points from those at nodes: at a break the tighter of its two sides."""
    result = values[:size].copy()
    choose.at(result, np.arange(1, size), values[nodes.right])
    return result


def _fastest_joint(limits: PathLimits, size: int) -> np.ndarray:
    """Give the joint whose velocity limit leaves the least speed, at grid points [size], or -1."""
    joints = limits.speed.get("qd")
    if joints is None:
        return np.full(size, -1)
    nearest, least = joints.argmin(axis=1), joints.min(axis=1)
    for bound in limits.speed.values():
        nearest = np.where(bound.min(axis=1) < least, -1, nearest)
    return nearest[:size]


def _arcs(s: FloatArray, timing: Reached, rows: LimitRows, along: CurveLimits) -> list[LimitArc]:
    """Find the runs of grid intervals on the same limit."""
    names, room = _room(timing, rows, along.nodes, along.limits)
    nearest = room.argmin(axis=1)
    on = np.where(room[np.arange(len(room)), nearest] <= ARCS.active, nearest, -1)
    runs = [(key, len(list(group))) for key, group in groupby(on.tolist())]
    merged: list[tuple[int, int]] = []
    for key, length in runs:
        if merged and (length < ARCS.fewest or merged[-1][0] == key):
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
    """Give every limit by name, and the room [N, limits] that the profile leaves below it.

    As a share of its range, the lesser of both ends of every grid interval.
    """
    x = timing.speed_squared[:, None]
    first = np.arange(rows.right.size)
    ends = ((first, x[:-1], timing.start[:, None]), (rows.right, x[1:], timing.end[:, None]))
    names: list[PathLimit] = []
    rooms = []  # at both ends
    span = rows.upper - rows.lower
    for side, bound in ((1, rows.upper), (-1, rows.lower)):
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
