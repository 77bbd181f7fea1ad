"""Rows of the flat program: which limit holds at which point, and where derivatives have entries.

Theory: docs/theory/flat.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.limits import LimitFamily
from microbot_ocp.planning.free._point_limits import ORDERS, PointLimits
from microbot_ocp.planning.free._spline import IntArray, SplineLayout, Windows

POINT_KEYS = ("q", "qd", "qdd")
NOWHERE = -1  # number of a row that the program does not have


@dataclass(frozen=True, eq=False)
class Scales:
    """Sizes that the program is divided by.

    Attributes
    ----------
    unknowns : array [size]
    motion : array [3,n]
        Of positions, velocities and accelerations.
    torque, rate, jerk : array [n]
        Of torques, torque rates and jerks.
    durations : array [m-1]
        Typical ones of the phases, s.
    """

    unknowns: FloatArray
    motion: FloatArray
    torque: FloatArray
    rate: FloatArray
    jerk: FloatArray
    durations: FloatArray

    @property
    def change(self) -> FloatArray:
        """What changes [n] of scaled torques in a second are divided by."""
        return self.rate / self.torque


@dataclass(frozen=True, eq=False)
class FlatRows:
    """Numbers of the rows, in this order: limits at points, bounds of the motion, torque rates,
    jerks.

    Attributes
    ----------
    layout : SplineLayout
    limits : tuple of PointLimits
        One a phase.
    at_points : array of int [P,R]
        Of limits; -1 where there is no row.
    of_motion : array of int [P,3,n]
        Of bounds of position, velocity and acceleration.
    of_rates : array of int [P,J]
        Of the torque rate at the start of an interval, and at its end by its middle point.
    of_jerks : array of int [P,n]
        Of the jerk in the interval that begins at a point.
    torques : array of int [J]
        Rows of limits that are the torques whose rates are limited.
    """

    layout: SplineLayout
    limits: tuple[PointLimits, ...]
    at_points: IntArray
    of_motion: IntArray
    of_rates: IntArray
    of_jerks: IntArray
    torques: IntArray

    @cached_property
    def height(self) -> int:
        """Number of rows."""
        return 1 + max(int(n.max(initial=NOWHERE)) for n in self.tables)

    @property
    def tables(self) -> tuple[IntArray, ...]:
        """All numbers, in the order of the rows."""
        return self.at_points, self.of_motion, self.of_rates, self.of_jerks

    @cached_property
    def phase(self) -> IntArray:
        """Phase of every point [P]."""
        phase = np.zeros(self.layout.points, dtype=int)
        for windows in self.layout.every:
            phase[windows.points[:, windows.own]] = windows.phase[:, None]
        return phase

    def lengths(self) -> FloatArray:
        """Return the share of the phase from each point [P] to the next one; 0 at its end."""
        lengths = np.zeros(self.layout.points)
        for windows in self.layout.windows:
            lengths[windows.points[:, :2]] = 0.5 * windows.lengths[:, None]
        return lengths


def flat_rows(
    layout: SplineLayout, families: Sequence[LimitFamily], limits: Sequence[PointLimits]
) -> FlatRows:
    """Return the rows of phases with these limits.

    At via points the bounds of the motion are those of unknowns. Accelerations are linear in every
    interval, so that they are bounded at mesh points alone. Torques at a via point belong to the
    phase before it, and to the next one, too, where the acceleration jumps or the limits differ.
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
        again = k == 0 or before != after or limit is not limits[k - 1]
        at_points[first + (not again) : last + 1, : limit.count] = True
        for order, key in enumerate(POINT_KEYS):
            step = 2 if key == "qdd" else 1
            inner = slice(first + step, last, step)
            low, high = family.robot.limits.bounds(key)
            of_motion[inner, order] = (low < high) & (np.isfinite(low) | np.isfinite(high))
        begins[first:last] = True
        first = last + 1
    of_rates = begins[:, None] & np.ones(rated.size, dtype=bool)
    starts = np.zeros(points, dtype=bool)
    for windows in layout.windows:
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
    return FlatRows(layout, tuple(limits), at_rows, motions, rates, jerks, rated)


def _limited(families: Sequence[LimitFamily], key: str, count: int) -> IntArray:
    """Return which joints have a limit of a kind in any phase."""
    mask = np.zeros(count, dtype=bool)
    for family in families:
        mask |= np.isfinite(family.robot.limits.bounds(key)).any(axis=0) & (key in family)
    return np.flatnonzero(mask) if key == "taud" else mask


class SparseEntries:
    """A sparse matrix whose entries are given block by block: where each of them goes.

    Several entries may go to one place.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        self.shape = shape
        self._blocks: list[tuple[IntArray, IntArray, np.ndarray]] = []

    def add(self, rows: IntArray, columns: IntArray, kept: np.ndarray) -> None:
        """Add a block of entries, of which some are kept, with numbers of rows and columns."""
        shape = np.broadcast_shapes(rows.shape, columns.shape, kept.shape)
        each = (np.broadcast_to(part, shape) for part in (rows, columns, kept))
        self._blocks.append(tuple(each))  # pyright: ignore[reportArgumentType]

    def placed(self) -> tuple[ca.Sparsity, list[IntArray]]:
        """Return the sparsity, and the place of every entry of each block among its nonzeros."""
        masks = [kept.ravel() for *_, kept in self._blocks]
        rows, columns = (
            np.concatenate(
                [block[k].ravel()[mask] for block, mask in zip(self._blocks, masks, strict=True)]
            )
            for k in (0, 1)
        )
        keys = columns * self.shape[0] + rows
        distinct, slots = np.unique(keys, return_inverse=True)
        column, row = np.divmod(distinct, self.shape[0])
        starts = np.searchsorted(column, np.arange(self.shape[1] + 1))
        places, at = [], 0
        for (_, _, kept), mask in zip(self._blocks, masks, strict=True):
            place = np.full(kept.shape, NOWHERE, dtype=np.intc)
            number = int(mask.sum())
            place[kept] = slots[at : at + number]
            at += number
            places.append(place)
        return ca.Sparsity(*self.shape, starts.tolist(), row.tolist()), places


@dataclass(frozen=True, eq=False)
class WindowPlaces:
    """Where the derivatives in the windows of one size go, among the nonzeros.

    Attributes
    ----------
    limit : [K,L,M,R,n], limit_time : [K,L,R]
    bound : [K,L,3,M,n], bound_time : [K,L,3,n]
    rate : [K,2,M,J,n], rate_time : [K,2,J]
    jerk : [K,M,n], jerk_time : [K,n]
        Of the Jacobian; rates and jerks None where none are limited, or of ends.
    hessian : [K,M,M,n,n], hessian_time : [K,M,n], time_time : [K]
    """

    limit: IntArray
    limit_time: IntArray
    bound: IntArray
    bound_time: IntArray
    rate: IntArray | None
    rate_time: IntArray | None
    jerk: IntArray | None
    jerk_time: IntArray | None
    hessian: IntArray
    hessian_time: IntArray
    time_time: IntArray


def window_places(rows: FlatRows) -> tuple[ca.Sparsity, ca.Sparsity, list[WindowPlaces]]:
    """Return the sparsities of the Jacobian and of the upper triangle of the Hessian, and the
    places of all windows' entries.
    """
    layout = rows.layout
    jacobian = SparseEntries((rows.height, layout.size))
    hessian = SparseEntries((layout.size, layout.size))
    inside = [_add_window(rows, windows, jacobian, hessian) for windows in layout.every]
    of_rows, first = jacobian.placed()
    of_all, second = hessian.placed()
    rest, others, places = iter(first), iter(second), []
    for rates, jerks in inside:
        limits = [next(rest) for _ in range(4)]
        of_rates = [next(rest) if rates else None for _ in range(2)]
        of_jerks = [next(rest) if jerks else None for _ in range(2)]
        places.append(
            WindowPlaces(*limits, *of_rates, *of_jerks, *(next(others) for _ in range(3)))
        )
    return of_rows, of_all, places


def _add_window(
    rows: FlatRows, windows: Windows, jacobian: SparseEntries, hessian: SparseEntries
) -> tuple[bool, bool]:
    """Add the entries of windows; whether there are rates and jerks among them."""
    layout = rows.layout
    columns = windows.columns[..., None] + np.arange(layout.count)  # [K,M,n]
    time = layout.durations.start + windows.phase
    points, weights = windows.points[:, windows.own], windows.weights[:, windows.own]
    used = (weights != 0.0).any(axis=2)  # [K,L,M]

    def put(number: IntArray, at: IntArray, kept: np.ndarray | bool = True) -> None:
        jacobian.add(number, at, (number != NOWHERE) & kept)

    at_points, of_motion = rows.at_points[points], rows.of_motion[points]
    put(at_points[:, :, None, :, None], columns[:, None, :, None, :], used[..., None, None])
    put(at_points, time[:, None, None])
    put(of_motion[:, :, :, None, :], columns[:, None, None], (weights != 0.0)[..., None])
    # the position at a mesh point does not depend on the duration where the window has no v and a
    put(of_motion, time[:, None, None, None])
    rates, jerks = windows.is_interval and rows.torques.size > 0, False
    if rates:
        number = rows.of_rates[windows.points[:, :2]]
        put(number[:, :, None, :, None], columns[:, None, :, None, :])
        put(number, time[:, None, None])
    if windows.is_interval and (rows.of_jerks != NOWHERE).any():
        jerks, number = True, rows.of_jerks[windows.points[:, 0]]
        put(number[:, None, :], columns)
        put(number, time[:, None])
    first, second = columns[:, :, None, :, None], columns[:, None, :, None, :]
    hessian.add(first, second, first <= second)
    hessian.add(columns, time[:, None, None], np.array(True))
    hessian.add(time, time, np.array(True))
    return rates, jerks
