"""Limits at a point of a motion as functions of q, qd and qdd, with their derivatives.

One call evaluates all points of a program. Torques use their own derivatives if these are smaller
expressions than automatic ones.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache, partial, reduce
from operator import add
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.fast_calls import RowsInPlace, rows_in_place
from microbot_ocp.limits import LimitFamily, MotionSamples
from microbot_ocp.planning.task import (
    SMOOTHING,
    WINDOW,
    dry_friction,
    finite_scale,
    friction_rate,
    torque_at_drives,
    torques_of,
    without_dry_friction,
)
from microbot_ocp.robot import Robot, torque_derivatives

STATE = ("q", "qd", "qdd")
ORDERS = len(STATE)
HELD = ("payload", WINDOW, SMOOTHING)  # mass at the tool, kg, and parameters of dry friction
# Keys of the parts of a limited torque rate: a difference of torques, and the rate of dry friction.
RATED, FRICTION_RATE = "torque without dry friction", "rate of dry friction"


@dataclass(frozen=True, eq=False)
class PointLimits:
    """Functions of q, qd, qdd [n] and the numbers of ``HELD``, each for any number of points.

    Attributes
    ----------
    names : tuple of (key, component, side)
        Limit of each row. ``side`` is "lower" or "upper" for a bound that varies, whose row is the
        excess of the value over the bound; otherwise empty.
    scale : array [R]
        Divisor of each row.
    values : callable
        Rows [R].
    slopes : callable
        Rows [R], and their derivatives by q, qd and qdd [3*R*n] in this order.
    curvature : callable
        Gradient [3n] of the rows' sum with weights [R], and its second derivatives [B*n*n], in the
        order of ``pairs``; the weights are a further argument.
    pairs : tuple of (int, int), B
        Orders of the derivatives of each block of the curvature.
    inner : array of bool [R]
        Mask of the rows in the middles of intervals. Limits of positions alone change little
        between mesh points.
    distances : tuple of (callable, slice)
        Limits of positions with derivatives of their own, for a number of poses, and their rows.
        These follow the rows of the functions above.
    """

    names: tuple[tuple[str, int, str], ...]
    scale: FloatArray
    values: Callable[[int], RowsInPlace]
    slopes: Callable[[int], RowsInPlace]
    curvature: Callable[[int], RowsInPlace]
    pairs: tuple[tuple[int, int], ...]
    inner: np.ndarray
    distances: tuple[tuple[Callable[[int], Any], slice], ...] = ()

    @property
    def count(self) -> int:
        """Number of rows at a point."""
        return len(self.names)

    @property
    def in_tables(self) -> int:
        """Number of rows of the functions, without distances."""
        return self.distances[0][1].start if self.distances else self.count

    @property
    def torque_scale(self) -> FloatArray:
        """Scales [n] of the torques; empty without torques."""
        return self.scale[[key == "tau" for key, *_ in self.names]]

    def bounds(
        self, family: LimitFamily, widened: Mapping[str, tuple[FloatArray, FloatArray]]
    ) -> tuple[FloatArray, FloatArray]:
        """Return the scaled bounds [R] of the rows under a family, some of them ``widened``."""
        low, high = np.full((2, self.count), np.inf) * [[-1.0], [1.0]]
        for row, (key, component, side) in enumerate(self.names):
            if side:
                high[row] = 0.0
            elif key in family:
                sides = widened.get(key, (family[key].lower, family[key].upper))
                low[row], high[row] = (side[component] for side in sides)
        return low / self.scale, high / self.scale


def point_limits(robot: Robot, keys: tuple[str, ...], payload: bool = False) -> PointLimits:
    """Return the functions of a robot's limits with given keys, as :func:`_in_tables`.

    Distances from obstacles change with every scene, so other limits are cached without them.
    """
    family = LimitFamily.of(robot)
    further = {key: family[key].limit for key in keys if key in family}
    own = {key: limit for key, limit in further.items() if limit and limit.knows_derivatives}
    if not own:
        return _in_tables(robot, keys, payload)
    others = tuple(key for key in keys if key not in own)
    limits = _in_tables(without_distances(robot), others, payload)
    names, scale = [*limits.names], [limits.scale]
    distances = []
    for key, limit in own.items():
        member = family[key]
        size = member.lower.size
        in_poses = partial(limit.expression.in_poses, robot)
        distances.append((in_poses, slice(len(names), len(names) + size)))
        names += [(key, k, "") for k in range(size)]
        scale.append(finite_scale(member.lower, member.upper) * np.ones(size))
    inner = np.append(limits.inner, np.zeros(len(names) - limits.count, dtype=bool))
    return replace(
        limits,
        names=tuple(names),
        scale=np.concatenate(scale),
        inner=inner,
        distances=tuple(distances),
    )


def without_distances(robot: Robot) -> Robot:
    """Return the robot without limits that have derivatives of their own."""
    kept = tuple(limit for limit in robot.limits.also if not limit.knows_derivatives)
    return robot if kept == robot.limits.also else robot.with_limits(also=kept)


@lru_cache(maxsize=32)
def _in_tables(robot: Robot, keys: tuple[str, ...], payload: bool) -> PointLimits:
    """Return the functions of a robot's limits with given keys.

    Parameters
    ----------
    robot : Robot
        Robot with limits; bounds that vary are expressions, others are numbers that may change.
    keys : tuple of str
        Keys of limits that do not depend on the jerk.
    payload : bool
        Use the mass at the tool as an argument of the torques; otherwise it is zero.
    """
    n = robot.joint_count
    state, held = [ca.SX.sym(name, n) for name in STATE], [ca.SX.sym(name) for name in HELD]
    parts = [part for key in keys for part in _parts(robot, key, state, held, payload)]
    weight = ca.vertcat(ca.SX(0, 1), *(part.weight for part in parts))
    value = ca.vertcat(ca.SX(0, 1), *(part.value for part in parts))
    jacobian = ca.vertcat(ca.SX(0, ORDERS * n), *(part.jacobian for part in parts))
    gradient = reduce(add, (part.gradient for part in parts), ca.SX(ORDERS * n, 1))
    hessian = reduce(add, (part.hessian for part in parts), ca.SX(ORDERS * n, ORDERS * n))
    blocks = _blocks(hessian, n)
    by_order = [jacobian[:, d * n : (d + 1) * n] for d in range(ORDERS)]
    slopes = ca.vertcat(*map(_row_major, by_order))
    curvature = ca.vertcat(*map(_row_major, blocks.values()))
    outputs = {
        "values": ([], [value]),
        "slopes": ([], [value, slopes]),
        "curvature": ([weight], [gradient, curvature]),
    }
    functions = [
        rows_in_place(ca.Function(name, [*state, *held, *more], ca.cse([*map(ca.densify, given)])))
        for name, (more, given) in outputs.items()
    ]
    names = tuple(name for part in parts for name in part.names)
    scale = np.concatenate([np.zeros(0), *(part.scale for part in parts)])
    values, slopes_of, curvature_of = functions
    family = LimitFamily.of(robot)
    # Torques whose rates are limited need no limit of their own.
    inner = [key not in family or family[key].order > 0 for key, *_ in names]
    return PointLimits(
        names,
        scale,
        values,
        slopes_of,
        curvature_of,
        tuple(blocks),
        np.array(inner, bool),
    )


def _blocks(hessian: ca.SX, n: int) -> dict[tuple[int, int], ca.SX]:
    """Return the blocks [n,n] of a symmetric matrix, on and above its diagonal, by place.

    Empty blocks are left out; the first one always remains, so that outputs have a shape.
    """
    blocks = {
        (d, e): hessian[d * n : (d + 1) * n, e * n : (e + 1) * n]
        for d in range(ORDERS)
        for e in range(d, ORDERS)
    }
    return {pair: block for pair, block in blocks.items() if block.nnz() or pair == (0, 0)}


class _LimitRows(NamedTuple):
    """Rows of one limit, scaled, with derivatives of their weighted sum."""

    names: list[tuple[str, int, str]]
    scale: FloatArray
    weight: ca.SX
    value: ca.SX
    jacobian: ca.SX
    gradient: ca.SX
    hessian: ca.SX


def _parts(
    robot: Robot, key: str, state: list[ca.SX], held: list[ca.SX], payload: bool
) -> Iterator[_LimitRows]:
    family, y, n = LimitFamily.of(robot), ca.vertcat(*state), robot.joint_count
    member = next((m for m in family if m.key == key), None)
    if key in ("tau", RATED):
        yield _torques(robot, key, state, held, payload)
        return
    if key == FRICTION_RATE:
        # In units of the torque, because a rate is a difference of torques over a time.
        scale = finite_scale(*robot.limits.bounds("tau"))
        rate = friction_rate(robot, state[1], state[2], held[-1])
        yield _with_derivatives([(key, k, "") for k in range(n)], scale, rate, y)
        return
    assert member is not None
    value, lower, upper = family.expressions([key], (*state, ca.SX(n, 1)))[key]
    size = member.lower.size
    if not member.varies:
        scale = finite_scale(member.lower, member.upper) * np.ones(size)
        yield _with_derivatives([(key, k, "") for k in range(size)], scale, value, y)
        return
    usual = family.values(MotionSamples.at_rest(np.zeros(n)), [key])[key]
    for side, sign, bound, typical in (
        ("lower", -1.0, lower, usual.lower),
        ("upper", 1.0, upper, usual.upper),
    ):
        if not isinstance(bound, ca.SX) and not np.isfinite(bound).any():
            continue
        # A bound that varies moves to the left side: the row is the excess, at most zero.
        room = sign * (value - (bound if isinstance(bound, ca.SX) else ca.DM(bound)))
        scale = finite_scale(np.ravel(typical), np.ravel(typical)) * np.ones(size)
        yield _with_derivatives([(key, k, side) for k in range(size)], scale, room, y)


def _torques(
    robot: Robot, key: str, state: list[ca.SX], held: list[ca.SX], payload: bool
) -> _LimitRows:
    """Return the rows of torques: those within windows, or those without dry friction."""
    y, n, (_, qd, qdd) = ca.vertcat(*state), robot.joint_count, state
    mass, window, smoothing = held
    given = [*state, *([mass] if payload else [])]
    scale, weight = finite_scale(*robot.limits.bounds("tau")), ca.SX.sym("weight", n)
    names = [(key, k, "") for k in range(n)]
    dry = key == "tau" and bool(dry_friction(robot).any())
    light = without_dry_friction(robot)
    # Derivatives of recursive Newton-Euler have, from six joints on, half of the operations of
    # automatic differentiation (robot/_torque_derivatives.py).
    own = torque_derivatives(light, payload=payload)
    if own is None:
        value, _ = torques_of(light, ["tau"], payload)(*state, None, *given[ORDERS:])
        if dry:
            value, _ = torque_at_drives(robot, value, qd, qdd, window, smoothing)
        return _with_derivatives(names, scale, value, y, weight)
    value, jacobian = own[0](*given)
    jacobian, scaled = jacobian[:, : 3 * n], weight / ca.DM(scale)
    inverse = ca.diag(1.0 / ca.DM(scale))
    if not dry:
        slope, hessian = own[1](*given, scaled)
        rows = inverse @ value, inverse @ jacobian
        return _LimitRows(names, scale, weight, *rows, slope[: 3 * n], hessian[: 3 * n, : 3 * n])
    # The torque at a drive is a function d(tau, qd, qdd) of its own joint alone, linear in tau.
    tau = ca.SX.sym("tau", n)
    at_drives, _ = torque_at_drives(robot, tau, qd, qdd, window, smoothing)
    arguments = tau, qd, qdd
    first = [ca.gradient(ca.sum1(at_drives), by) for by in arguments]
    second = [[ca.gradient(ca.sum1(f), by) for by in (qd, qdd)] for f in first]
    at_drives, *parts = ca.substitute(
        [at_drives, *first, *itertools.chain(*second)], [tau], [value]
    )
    by_tau, by_qd, by_qdd = parts[:3]
    mixed, (vv, va), (_, aa) = parts[3:5], parts[5:7], parts[7:]
    gradient_rows = ca.diag(by_tau) @ jacobian + ca.horzcat(
        ca.SX(n, n), ca.diag(by_qd), ca.diag(by_qdd)
    )
    _, hessian = own[1](*given, scaled * by_tau)
    cross = ca.horzcat(ca.SX(3 * n, n), *(jacobian.T @ ca.diag(scaled * m) for m in mixed))
    vv, va, aa = (ca.diag(scaled * part) for part in (vv, va, aa))
    nothing = ca.SX(n, n)
    own_part = ca.blockcat([[nothing] * 3, [nothing, vv, va], [nothing, va, aa]])
    hessian = hessian[: 3 * n, : 3 * n] + cross + cross.T + own_part
    rows = inverse @ at_drives, inverse @ gradient_rows
    return _LimitRows(names, scale, weight, *rows, gradient_rows.T @ scaled, hessian)


def _with_derivatives(
    names: list[tuple[str, int, str]],
    scale: FloatArray,
    value: ca.SX,
    y: ca.SX,
    weight: ca.SX | None = None,
) -> _LimitRows:
    value = value / ca.DM(scale)
    weight = ca.SX.sym("weight", scale.size) if weight is None else weight
    hessian, gradient = ca.hessian(ca.dot(weight, value), y)
    return _LimitRows(names, scale, weight, value, ca.jacobian(value, y), gradient, hessian)


def _row_major(block: ca.SX) -> ca.SX:
    """Return the entries of a matrix in row-major order."""
    return ca.densify(ca.vec(ca.densify(block).T))
