"""Rows of the flat program: limits at points, and places of the derivatives' entries.

Theory: docs/theory/flat.md, "Rows".
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.limits import LimitFamily
from microbot_ocp.planning.free._point_limits import FRICTION_RATE, ORDERS, RATED, PointLimits
from microbot_ocp.planning.free._spline import IntArray, SplineLayout, Windows
from microbot_ocp.planning.free._stop_rows import StopRow, stop_rows
from microbot_ocp.planning.task import Conditions

POINT_KEYS = ("q", "qd", "qdd")
NOWHERE = -1  # index of a row that the program does not have


@dataclass(frozen=True, eq=False)
class Scales:
    """Units of the program's unknowns and rows.

    Attributes
    ----------
    unknowns : array [size]
    motion : array [3,n]
        Units of positions, velocities and accelerations.
    torque, rate, jerk : array [n]
        Units of torques, torque rates and jerks.
    durations : array [m-1]
        Typical durations of the phases, s.
    """

    unknowns: FloatArray
    motion: FloatArray
    torque: FloatArray
    rate: FloatArray
    jerk: FloatArray
    durations: FloatArray

    @property
    def change(self) -> FloatArray:
        """Unit [n] of the rate of scaled torques, 1/s."""
        return self.rate / self.torque


@dataclass(frozen=True, eq=False)
class FlatRows:
    """Indices of the rows: limits at points, bounds of the motion, torque rates, jerks, in order.

    Attributes
    ----------
    layout : SplineLayout
    limits : tuple of PointLimits
        Limits of each phase.
    at_points : array of int [P,R]
        Rows of limits; -1 without a row.
    of_motion : array of int [P,3,n]
        Rows of bounds of position, velocity and acceleration.
    of_rates : array of int [P,J]
        Rows of torque rates: at the start of an interval by its first point, at its end by its
        middle point.
    of_jerks : array of int [P,n]
        Rows of the jerk in the interval that begins at a point.
    torques : array of int [J]
        Columns of ``at_points`` with the torques whose rates are limited.
    at_stops : tuple of StopRow
        Conditions on the pose and the velocity at via points.
    """

    layout: SplineLayout
    limits: tuple[PointLimits, ...]
    at_points: IntArray
    of_motion: IntArray
    of_rates: IntArray
    of_jerks: IntArray
    torques: IntArray
    at_stops: tuple[StopRow, ...] = ()

    @cached_property
    def height(self) -> int:
        """Number of rows."""
        along = 1 + max(int(n.max(initial=NOWHERE)) for n in self.tables)
        return along + sum(stop.numbers.size for stop in self.at_stops)

    @property
    def friction(self) -> IntArray:
        """Columns [J] with the rates of dry friction; empty without it."""
        names = self.limits[0].names
        first = next((k for k, (key, *_) in enumerate(names) if key == FRICTION_RATE), NOWHERE)
        return self.torques + first if first != NOWHERE else self.torques[:0]

    @property
    def tables(self) -> tuple[IntArray, ...]:
        """All tables, in the order of the rows."""
        return self.at_points, self.of_motion, self.of_rates, self.of_jerks

    @cached_property
    def phase(self) -> IntArray:
        """Phase of every point [P]."""
        phase = np.zeros(self.layout.points, dtype=int)
        for windows in self.layout.every:
            phase[windows.points[:, windows.own]] = windows.phase[:, None]
        return phase

    def lengths(self) -> FloatArray:
        """Return the distance of each point [P] from the next, share of the phase; 0 at its end."""
        lengths = np.zeros(self.layout.points)
        for windows in self.layout.windows:
            lengths[windows.points[:, :2]] = 0.5 * windows.lengths[:, None]
        return lengths


def flat_rows(
    layout: SplineLayout,
    families: Sequence[LimitFamily],
    limits: Sequence[PointLimits],
    conditions: Conditions,
) -> FlatRows:
    """Return the rows of phases with these limits.

    At via points bounds of the motion are bounds of unknowns. Accelerations are linear in every
    interval, so they are bounded at mesh points alone. So are positions: they turn at most twice in
    an interval, and an excess between mesh points is of second order in its length. Torques at a
    via point belong to the phase before it, and also to the next one if the acceleration jumps or
    the limits differ.
    """
    count, points = layout.count, layout.points
    most = max(limit.count for limit in limits)
    at_points = np.zeros((points, most), dtype=bool)
    of_motion = np.zeros((points, ORDERS, count), dtype=bool)
    rated = _limited(families, "taud", count)
    jerked = _limited(families, "qddd", count)
    begins, first = np.zeros(points, dtype=bool), 0
    for k, (mesh, family, limit) in enumerate(zip(layout.meshes, families, limits, strict=True)):
        last = first + 2 * (mesh.size - 1)
        before, after = layout.nodes[k][2:]
        # Torques at a via point are rows once, unless the two sides differ.
        again = k == 0 or before != after or limit is not limits[k - 1]
        # The parts of a rate have no bounds of their own.
        bounded = [key not in (RATED, FRICTION_RATE) for key, *_ in limit.names]
        at_points[first + (not again) : last + 1, : limit.count] = bounded
        at_points[first + 1 : last : 2, : limit.count] &= limit.inner
        for order, key in enumerate(POINT_KEYS):
            step = 1 if key == "qd" else 2
            inner = slice(first + step, last, step)
            low, high = family.robot.limits.bounds(key)
            of_motion[inner, order] = (low < high) & (np.isfinite(low) | np.isfinite(high))
        # A rate is limited at both ends of an interval: at its first point and, for its end, at its
        # middle.
        begins[first:last] = True
        first = last + 1
    of_rates = begins[:, None] & np.ones(rated.size, dtype=bool)
    starts = np.zeros(points, dtype=bool)
    for windows in layout.windows:
        # A jerk belongs to an interval, so its row stands at the first point.
        starts[windows.points[:, 0]] = True
    of_jerks = starts[:, None] & jerked
    numbers: list[IntArray] = []
    at = 0
    for mask in (at_points, of_motion, of_rates, of_jerks):
        number = np.full(mask.shape, NOWHERE)
        number[mask] = at + np.arange(int(mask.sum()))
        at += int(mask.sum())
        numbers.append(number)
    at_rows, motions, rates, jerks = numbers
    at_stops = stop_rows(layout, conditions, at)
    return FlatRows(layout, tuple(limits), at_rows, motions, rates, jerks, rated, at_stops)


def _limited(families: Sequence[LimitFamily], key: str, count: int) -> IntArray:
    """Return the joints with a limit of a kind in any phase: indices for rates, else a mask."""
    mask = np.zeros(count, dtype=bool)
    for family in families:
        mask |= np.isfinite(family.robot.limits.bounds(key)).any(axis=0) & (key in family)
    return np.flatnonzero(mask) if key == "taud" else mask


class SparseEntries:
    """Entries of a sparse matrix, given block by block.

    Several entries may have one place, at which they add up.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        self.shape = shape
        self._blocks: list[Any] = []

    def add(self, rows: IntArray, columns: IntArray, kept: np.ndarray) -> int:
        """Add entries at rows and columns, of which ``kept`` exist; return the block's index."""
        self._blocks.append(np.broadcast_arrays(rows, columns, kept))
        return len(self._blocks) - 1

    def placed(self) -> tuple[ca.Sparsity, list[IntArray]]:
        """Return the sparsity, and the index among its nonzeros of every entry of each block."""
        rows, columns, kept = (
            np.concatenate([part.ravel() for part in parts])
            for parts in zip(*self._blocks, strict=True)
        )
        # Compressed column order; np.unique sorts the keys and finds shared places.
        keys = (columns * self.shape[0] + rows)[kept]
        distinct, slots = np.unique(keys, return_inverse=True)
        column, row = np.divmod(distinct, self.shape[0])
        starts = np.searchsorted(column, np.arange(self.shape[1] + 1))
        places = np.full(kept.size, NOWHERE, dtype=np.intc)
        places[kept] = slots
        shapes = [kept.shape for *_, kept in self._blocks]
        ends = np.cumsum([np.prod(shape) for shape in shapes])
        of_blocks = map(np.reshape, np.split(places, ends[:-1]), shapes)
        return ca.Sparsity(*self.shape, starts.tolist(), row.tolist()), [*of_blocks]


@dataclass(frozen=True, eq=False, kw_only=True)
class WindowPlaces:
    """Indices among the nonzeros of the derivatives in windows of one size.

    Attributes
    ----------
    limit, limit_time : [K,L,M,R,n], [K,L,R]
        Jacobian of limits by unknowns and by the duration.
    bound, bound_time : [K,L,3,M,n], [K,L,3,n]
        Jacobian of bounds of the motion.
    rate, rate_time : [K,2,M,J,n], [K,2,J]
        Jacobian of torque rates; None without such rows.
    jerk, jerk_time : [K,M,n], [K,n]
        Jacobian of jerks; None without such rows.
    hessian, hessian_time, time_time : [K,M,M,n,n], [K,M,n], [K]
        Hessian by unknowns, by unknowns and duration, and by the duration.
    """

    limit: IntArray
    limit_time: IntArray
    bound: IntArray
    bound_time: IntArray
    rate: IntArray | None = None
    rate_time: IntArray | None = None
    jerk: IntArray | None = None
    jerk_time: IntArray | None = None
    hessian: IntArray
    hessian_time: IntArray
    time_time: IntArray


Places = list[tuple[IntArray, IntArray]]


def window_places(rows: FlatRows) -> tuple[ca.Sparsity, ca.Sparsity, list[WindowPlaces], Places]:
    """Return the sparsities of the Jacobian and the Hessian's upper triangle, with all places.

    The last are places of the conditions at via points: [r,2n] and [2n,2n] of each.
    """
    layout = rows.layout
    jacobian = SparseEntries((rows.height, layout.size))
    hessian = SparseEntries((layout.size, layout.size))
    inside = [_add_window(rows, windows, jacobian, hessian) for windows in layout.every]
    ends = []
    for stop in rows.at_stops:
        one, two = stop.columns[:, None], stop.columns[None, :]
        of_row = jacobian.add(stop.numbers[:, None], two, np.array(True))
        ends.append((of_row, hessian.add(one, two, one <= two)))
    (of_rows, first), (of_all, second) = jacobian.placed(), hessian.placed()
    places = [
        WindowPlaces(
            **{name: first[at] for name, at in one.items()},
            **{name: second[at] for name, at in two.items()},
        )
        for one, two in inside
    ]
    return of_rows, of_all, places, [(first[one], second[two]) for one, two in ends]


def _add_window(
    rows: FlatRows, windows: Windows, jacobian: SparseEntries, hessian: SparseEntries
) -> tuple[dict[str, int], dict[str, int]]:
    """Add the entries of windows; return their blocks in both by the names of their places."""
    layout = rows.layout
    columns = windows.columns[..., None] + np.arange(layout.count)  # [K,M,n]
    time = layout.durations.start + windows.phase
    points, weights = windows.points[:, windows.own], windows.weights[:, windows.own]

    blocks: dict[str, int] = {}

    def put(name: str, number: IntArray, at: IntArray, kept: np.ndarray | bool = True) -> None:
        # Entries of rows that do not exist, and of unknowns without weight, have no place.
        blocks[name] = jacobian.add(number, at, (number != NOWHERE) & kept)

    at_points, of_motion = rows.at_points[points], rows.of_motion[points]
    weighted = (weights != 0.0).any(axis=2)[..., None, None]
    put("limit", at_points[:, :, None, :, None], columns[:, None, :, None, :], weighted)
    put("limit_time", at_points, time[:, None, None])
    weighted = (weights != 0.0)[..., None]
    put("bound", of_motion[:, :, :, None, :], columns[:, None, None], weighted)
    # A position does not depend on the duration if its window has no v and a; zeros are stored.
    put("bound_time", of_motion, time[:, None, None, None])
    if windows.is_interval and rows.torques.size > 0:
        number = rows.of_rates[windows.points[:, :2]]
        put("rate", number[:, :, None, :, None], columns[:, None, :, None, :])
        put("rate_time", number, time[:, None, None])
    if windows.is_interval and (rows.of_jerks != NOWHERE).any():
        number = rows.of_jerks[windows.points[:, 0]]
        put("jerk", number[:, None, :], columns)
        put("jerk_time", number, time[:, None])
    first, second = columns[:, :, None, :, None], columns[:, None, :, None, :]
    return blocks, {
        "hessian": hessian.add(first, second, first <= second),
        "hessian_time": hessian.add(columns, time[:, None, None], np.array(True)),
        "time_time": hessian.add(time, time, np.array(True)),
    }
