"""Motion and derivatives in the windows of a flat program, by numpy or in C.

Derivative d of the position in a window is ``y_d = sum_m W_dm T^(p_m - d) u_m``. A limit
g(y_0, y_1, y_2) has the derivatives ``g_y W`` by the unknowns and ``g_y dy/dT`` by the duration. A
weighted sum of limits, with gradient g and Hessian G, has the second derivatives

``W' G W``,  ``W' G dy/dT + (dW/dT)' g``  and  ``(dy/dT)' G dy/dT + g' d^2y/dT^2``

by the unknowns, by unknowns and duration, and by the duration. ``_windows.c`` has the same loops in
C, which avoid numpy's temporary arrays; without that library numpy is used.

Theory: docs/theory/flat.md, equations (2) and (3).
"""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.codegen import ANY_ORDER, CommonLibrary
from microbot_ocp.planning.free._flat_rows import NOWHERE, FlatRows, Scales, WindowPlaces
from microbot_ocp.planning.free._point_limits import ORDERS
from microbot_ocp.planning.free._spline import PLACES, SLOPES, IntArray, Windows

ENDS = [0, 2]  # places at the ends of an interval, where torque rates are limited


@dataclass(frozen=True, eq=False)
class Form:
    """Dimensions and units that all windows of a program share.

    Attributes
    ----------
    joints, rows, points : int
        Numbers n of joints, R of limits at a point, P of points.
    torques : array of int [J]
        Indices of the limits whose rates are limited.
    friction : array of int [J]
        Indices of the rates of dry friction, which are added to them; empty without it.
    pairs : array of int [B,2]
        Orders d, e of the derivatives y_d, y_e of each block of second derivatives.
    scales : Scales
    starts : array [m-1,n]
        Positions to which the coefficients of a phase are relative, rad (m).
    jerk_weight : array [n]
        Weight of the squared jerk in the cost.
    """

    joints: int
    rows: int
    points: int
    torques: IntArray
    friction: IntArray
    pairs: IntArray
    scales: Scales
    starts: FloatArray
    jerk_weight: FloatArray


@dataclass(eq=False)
class MovedWindows:
    """Windows of one size, with the motion in them at the current unknowns.

    Attributes
    ----------
    weights, weight_slopes : arrays [K,3,3,M]
        W T^(p-d) and its derivative by the duration.
    y, y_slopes, y_curvature : arrays [K,3,3,n]
        Position, velocity and acceleration at start, middle and end, with first and second
        derivatives by the duration.
    jerk_weights, jerk_weight_slopes : arrays [K,M]
        Weights of the jerk, and their derivatives by the duration.
    jerk, jerk_slopes, jerk_curvature : arrays [K,n]
        Jerk, with first and second derivatives by the duration.
    """

    windows: Windows
    places: WindowPlaces
    form: Form

    def __post_init__(self) -> None:
        (count, unknowns), joints = self.windows.columns.shape, self.form.joints
        self.weights, self.weight_slopes = np.zeros((2, count, PLACES.size, ORDERS, unknowns))
        shape = (3, count, PLACES.size, ORDERS, joints)
        self.y, self.y_slopes, self.y_curvature = np.zeros(shape)
        self.jerk_weights, self.jerk_weight_slopes = np.zeros((2, count, unknowns))
        self.jerk, self.jerk_slopes, self.jerk_curvature = np.zeros((3, count, joints))


class NumpyLoops:
    """The loops in numpy."""

    def __init__(self, moved: Sequence[MovedWindows]) -> None:
        self.moved = moved

    def move(self, x: FloatArray, T: FloatArray, q: FloatArray) -> None:
        """Evaluate the motion at unknowns x with durations T, and store it in q [3,P,n].

        Positions in q are relative to the start of the phase.
        """
        for moved in self.moved:
            windows, n = moved.windows, moved.form.joints
            u = x[windows.columns[..., None] + np.arange(n)]
            u = u - windows.anchored[..., None] * moved.form.starts[windows.phase][:, None]
            times = T[windows.phase][:, None, None]
            orders = np.arange(ORDERS)[:, None]
            parts = self._moved(windows.weights, windows.powers, orders, times, u)
            moved.weights[...], moved.weight_slopes[...], moved.y[...] = parts[:3]
            moved.y_slopes[...], moved.y_curvature[...] = parts[3:]
            q[:, windows.points[:, windows.own]] = moved.y[:, windows.own].transpose(2, 0, 1, 3)
            if windows.is_interval:
                given = windows.jerks[:, None, None], windows.powers, np.array([[ORDERS]])
                w, w_slopes, *jerks = (part[:, 0, 0] for part in self._moved(*given, times, u))
                moved.jerk_weights[...], moved.jerk_weight_slopes[...] = w, w_slopes
                moved.jerk[...], moved.jerk_slopes[...], moved.jerk_curvature[...] = jerks

    @staticmethod
    def _moved(
        weights: FloatArray, powers: FloatArray, orders: Any, T: FloatArray, u: FloatArray
    ) -> list[FloatArray]:
        # Derivatives of T^k: k T^(k-1) and k (k-1) T^(k-2).
        exponents = powers[:, None, :] - orders
        factor = T**exponents
        slope = factor * exponents / T
        curvature = slope * (exponents - 1.0) / T
        parts = [weights * power[:, None] for power in (factor, slope, curvature)]
        return [*parts[:2], *(part @ u[:, None] for part in parts)]

    def cost(self, T: FloatArray, gradient: FloatArray) -> float:
        """Return the sum of durations and weighted squared jerks, and add its gradient."""
        total, durations = float(T.sum()), gradient[-T.size :]
        durations += 1.0
        for moved in self.moved:
            windows = moved.windows
            if not windows.is_interval:
                continue
            squares = (moved.jerk**2) @ moved.form.jerk_weight * windows.lengths
            total += float(squares @ T[windows.phase])
            spans = (windows.lengths * T[windows.phase])[:, None]
            slope = 2.0 * moved.jerk * moved.form.jerk_weight * spans
            columns = windows.columns[..., None] + np.arange(moved.form.joints)
            np.add.at(gradient, columns, moved.jerk_weights[..., None] * slope[:, None])
            np.add.at(durations, windows.phase, (slope * moved.jerk_slopes).sum(1) + squares)
        return total

    def jacobian(
        self, T: FloatArray, values: FloatArray, slopes: FloatArray, entries: FloatArray
    ) -> None:
        """Store the entries of the Jacobian, from values [P,R] and slopes [P,3*R*n] of limits."""
        for moved in self.moved:
            windows, form, to = moved.windows, moved.form, moved.places
            (count, unknowns), n, own = windows.columns.shape, form.joints, windows.own
            by_motion = slopes.reshape(-1, ORDERS, form.rows * n)[windows.points]
            block = (moved.weights.swapaxes(2, 3) @ by_motion).reshape(
                count, PLACES.size, unknowns, form.rows, n
            )
            shaped = by_motion.reshape(count, PLACES.size, ORDERS, form.rows, n)
            by_time = np.einsum("kldri,kldi->klr", shaped, moved.y_slopes)
            _put(entries, to.limit, block[:, own])
            _put(entries, to.limit_time, by_time[:, own])
            motion = form.scales.motion
            _put(entries, to.bound, moved.weights[:, own, :, :, None] / motion[:, None])
            _put(entries, to.bound_time, moved.y_slopes[:, own] / motion)
            if to.rate is not None:
                # A rate is (SLOPES @ torques) / (h T), up to its scale: its derivatives are those
                # of the torques, minus the part of the quotient by T.
                factor, scale = self._rates(moved, T)
                chosen = _slopes(block[..., form.torques, :]) * factor[..., None, None]
                # Half of an interval, by which the rate of friction becomes a torque difference.
                half = 0.5 * (windows.lengths * form.scales.durations[windows.phase])[:, None, None]
                if form.friction.size:
                    chosen += block[:, ENDS][..., form.friction, :] * half[..., None, None]
                _put(entries, to.rate, chosen / scale[:, None])
                steps = _slopes(values[windows.points][..., form.torques])
                change = _slopes(by_time[..., form.torques])
                change = (change - steps / T[windows.phase][:, None, None]) * factor
                if form.friction.size:
                    change += by_time[:, ENDS][..., form.friction] * half
                _put(entries, to.rate_time, change / scale)
            if to.jerk is not None:
                _put(entries, to.jerk, moved.jerk_weights[..., None] / form.scales.jerk)
                _put(entries, to.jerk_time, moved.jerk_slopes / form.scales.jerk)

    @staticmethod
    def _rates(moved: MovedWindows, T: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the factors [K,1,1] of torque differences, and their scales [J]."""
        phase, scales = moved.windows.phase, moved.form.scales
        return (scales.durations / T)[phase][:, None, None], scales.change[moved.form.torques]

    def hessian(
        self,
        T: FloatArray,
        values: FloatArray,
        slopes: FloatArray,
        blocks: FloatArray,
        gradient: FloatArray,
        of_rates: FloatArray,
        of_jerks: FloatArray,
        of_cost: float,
        entries: FloatArray,
    ) -> None:
        """Add the entries of the Hessian of the Lagrangian, upper triangle.

        Parameters
        ----------
        T : array [m-1]
            Durations, s.
        values, slopes : arrays [P,R], [P,3*R*n]
            Limits and their derivatives; used only under limits of torque rates.
        blocks : array [P,B*n*n]
            Second derivatives of the weighted limits.
        gradient : array [P,3n]
            Gradient of all weighted rows by the motion at the points.
        of_rates : array [P,J]
            Weights of torque differences.
        of_jerks : array [P,n]
            Weights of jerks.
        of_cost : float
            Weight of the cost.
        entries : array
            Nonzeros, in place.
        """
        for moved in self.moved:
            windows, form, to = moved.windows, moved.form, moved.places
            (count, unknowns), n, own = windows.columns.shape, form.joints, windows.own
            points = windows.points[:, own]
            weights, y_slopes = moved.weights[:, own], moved.y_slopes[:, own]
            block = blocks.reshape(-1, len(form.pairs), n, n)[points]
            slope = gradient.reshape(-1, ORDERS, n)[points]
            part = np.zeros((count, unknowns, unknowns, n, n))
            turned = np.zeros((count, points.shape[1], ORDERS, n))
            # ``turned`` is G dy/dT, ``part`` W' G W. Only blocks with d <= e are stored, so the
            # transpose of each other block follows from symmetry.
            for b, (d, e) in enumerate(form.pairs.tolist()):
                one, two = weights[:, :, d], weights[:, :, e]
                product = np.einsum("klm,klo,klij->kmoij", one, two, block[:, :, b], optimize=True)
                part += product
                turned[:, :, d] += np.einsum("klij,klj->kli", block[:, :, b], y_slopes[:, :, e])
                if d != e:
                    part += product.transpose(0, 2, 1, 4, 3)
                    turned[:, :, e] += np.einsum("klij,kli->klj", block[:, :, b], y_slopes[:, :, d])
            by_time = np.einsum("kldm,kldi->kmi", weights, turned)
            by_time += np.einsum("kldm,kldi->kmi", moved.weight_slopes[:, own], slope)
            twice = (y_slopes * turned + slope * moved.y_curvature[:, own]).sum(axis=(1, 2, 3))
            if windows.is_interval:
                self._add_jerks(moved, T, of_jerks, of_cost, part, by_time, twice)
            if to.rate is not None:
                self._add_rates(moved, T, values, slopes, of_rates, by_time, twice)
            for place, value in (
                (to.hessian, part),
                (to.hessian_time, by_time),
                (to.time_time, twice),
            ):
                kept = place != NOWHERE
                np.add.at(entries, place[kept], value[kept])

    @staticmethod
    def _add_jerks(
        moved: MovedWindows,
        T: FloatArray,
        of_jerks: FloatArray,
        of_cost: float,
        part: FloatArray,
        by_time: FloatArray,
        twice: FloatArray,
    ) -> None:
        windows, diagonal = moved.windows, np.arange(moved.form.joints)
        weight, lengths = 2.0 * of_cost * moved.form.jerk_weight, windows.lengths[:, None]
        spans = lengths * T[windows.phase][:, None]
        w, of_rows = moved.jerk_weights, of_jerks[windows.points[:, 0]]
        # The cost of an interval is the weighted squared jerk times its duration h T; the duration
        # appears in both factors.
        products = (w[:, :, None] * w[:, None, :] * spans[..., None])[..., None]
        part[..., diagonal, diagonal] += products * weight
        slope = weight * moved.jerk
        change = slope * lengths + spans * weight * moved.jerk_slopes
        by_time += w[..., None] * change[:, None]
        by_time += moved.jerk_weight_slopes[..., None] * (slope * spans + of_rows)[:, None]
        twice += (
            2.0 * slope * moved.jerk_slopes * lengths
            + spans * (weight * moved.jerk_slopes**2 + slope * moved.jerk_curvature)
            + of_rows * moved.jerk_curvature
        ).sum(axis=1)

    @staticmethod
    def _add_rates(
        moved: MovedWindows,
        T: FloatArray,
        values: FloatArray,
        slopes: FloatArray,
        of_rates: FloatArray,
        by_time: FloatArray,
        twice: FloatArray,
    ) -> None:
        """Add the part of torque rates by their divisor, the duration.

        A rate is D / T with the torque difference D: the part of D is in the weighted torques, and
        the rest is -D_u / T by unknowns, and -2 D_T / T + 2 D / T^2 by the duration.
        """
        windows, form = moved.windows, moved.form
        weight = of_rates[windows.points[:, :2]]  # [K,2,J]
        of_torques = slopes.reshape(-1, ORDERS, form.rows, form.joints)[windows.points]
        chosen = of_torques[..., form.torques, :]
        sums = np.einsum("kpr,pl,kldri->kldi", weight, SLOPES, chosen, optimize=True)
        times = T[windows.phase]
        by_time -= np.einsum("kldm,kldi->kmi", moved.weights, sums) / times[:, None, None]
        steps = _slopes(values[windows.points][..., form.torques])
        twice -= 2.0 * (sums * moved.y_slopes).sum(axis=(1, 2, 3)) / times
        twice += 2.0 * (weight * steps).sum(axis=(1, 2)) / times**2


def _slopes(values: FloatArray) -> FloatArray:
    """Return ``SLOPES`` [K,2,...] of values [K,3,...] at the places of intervals."""
    return np.moveaxis(np.tensordot(SLOPES, values, (1, 1)), 0, 1)


def _put(entries: FloatArray, places: IntArray | None, values: FloatArray) -> None:
    assert places is not None
    kept = places != NOWHERE
    entries[places[kept]] = np.broadcast_to(values, places.shape)[kept]


# loops in C ---------------------------------------------------------------------------------------


class _FormArrays(ctypes.Structure):
    _fields_ = [
        *(
            (name, ctypes.c_long)
            for name in ("joints", "rows", "rated", "friction", "pairs", "points")
        ),
        *((name, ctypes.c_void_p) for name in ("torque", "first", "second", "bound_scale")),
        *(
            (name, ctypes.c_void_p)
            for name in ("rate_scale", "jerk_scale", "jerk_weight", "typical", "starts")
        ),
    ]


_OF_WINDOWS = {
    name: np.intc if name in ("phase", "columns", "points") else float
    for name in ("phase", "columns", "points", "powers", "anchored", "weights", "jerks", "lengths")
}
_OF_PLACES = tuple(field.name for field in fields(WindowPlaces))
_OF_MOTION = (
    *("weights", "weight_slopes", "y", "y_slopes", "y_curvature"),
    *("jerk_weights", "jerk_weight_slopes", "jerk", "jerk_slopes", "jerk_curvature"),
)


class _WindowArrays(ctypes.Structure):
    _fields_ = [
        *((n, ctypes.c_long) for n in ("count", "unknowns", "own_begin", "own_end", "inside")),
        *((name, ctypes.c_void_p) for name in _OF_WINDOWS),
        *((f"to_{name}", ctypes.c_void_p) for name in _OF_PLACES),
        *((f"moved_{name}", ctypes.c_void_p) for name in _OF_MOTION),
    ]


class CompiledLoops(NumpyLoops):
    """The loops in C, on the arrays of the numpy loops."""

    def __init__(self, moved: Sequence[MovedWindows], library: ctypes.CDLL) -> None:
        super().__init__(moved)
        self._library, self._kept = library, list[Any]()
        form = moved[0].form
        scales, joints = form.scales, form.torques
        # The columns of friction follow those of the torques in the same order.
        shift = int(form.friction[0] - joints[0]) if form.friction.size else 0
        numbers = form.joints, form.rows, joints.size, shift, len(form.pairs), form.points
        arrays = (
            *(np.asarray(part, dtype=np.intc) for part in (joints, *form.pairs.T)),
            *(
                scales.motion,
                scales.change[joints],
                scales.jerk,
                form.jerk_weight,
                scales.durations,
                form.starts,
            ),
        )
        self._form = _FormArrays(*numbers, *map(self._address, arrays))
        self._windows = [self._structure(each) for each in moved]
        widest = max(each.windows.columns.shape[1] for each in moved)
        n, rows = form.joints, form.rows
        first = PLACES.size * rows * (widest * n + 1) + widest * joints.size * n
        second = (widest**2 + widest) * n**2 + (ORDERS + widest) * n
        self._work = np.zeros(max(first, second))

    def _address(self, array: FloatArray | IntArray | None) -> int | None:
        if array is None:
            return None
        array = np.ascontiguousarray(array)
        self._kept.append(array)
        return array.ctypes.data

    def _structure(self, moved: MovedWindows) -> _WindowArrays:
        windows = moved.windows
        own = windows.own
        sizes = *windows.columns.shape, own.start, own.stop, windows.is_interval
        given = (np.asarray(getattr(windows, k), dtype=v) for k, v in _OF_WINDOWS.items())
        places = (getattr(moved.places, name) for name in _OF_PLACES)
        motion = (getattr(moved, name) for name in _OF_MOTION)
        return _WindowArrays(
            *sizes, *(self._address(array) for part in (given, places, motion) for array in part)
        )

    def _each(self, name: str, *given: FloatArray | float) -> None:
        function = getattr(self._library, name)
        arguments = [
            ctypes.c_void_p(each.ctypes.data)
            if isinstance(each, np.ndarray)
            else ctypes.c_double(each)
            for each in given
        ]
        for windows in self._windows:
            function(ctypes.byref(windows), ctypes.byref(self._form), *arguments)

    def move(self, x: FloatArray, T: FloatArray, q: FloatArray) -> None:
        self._each("windows_move", x, T, q)

    def cost(self, T: FloatArray, gradient: FloatArray) -> float:
        total = np.array([T.sum()])
        durations = gradient[-T.size :]
        durations += 1.0
        self._each("windows_cost", T, durations, gradient, total)
        return float(total[0])

    def jacobian(
        self, T: FloatArray, values: FloatArray, slopes: FloatArray, entries: FloatArray
    ) -> None:
        self._each("windows_jacobian", T, values, slopes, self._work, entries)

    def hessian(
        self,
        T: FloatArray,
        values: FloatArray,
        slopes: FloatArray,
        blocks: FloatArray,
        gradient: FloatArray,
        of_rates: FloatArray,
        of_jerks: FloatArray,
        of_cost: float,
        entries: FloatArray,
    ) -> None:
        given = T, values, slopes, blocks, gradient, of_rates, of_jerks
        self._each("windows_hessian", *given, of_cost, self._work, entries)


WINDOWS = CommonLibrary(
    "windows", Path(__file__).with_name("_windows.c").read_text("utf-8"), ("-O3", *ANY_ORDER)
)


def loops_of(rows: FlatRows, form: Form, places: Sequence[WindowPlaces]) -> NumpyLoops:
    """Return the loops of a program: in C if possible."""
    pairs = zip(rows.layout.every, places, strict=True)
    moved = [MovedWindows(windows, place, form) for windows, place in pairs]
    try:
        return CompiledLoops(moved, ctypes.CDLL(str(WINDOWS.path())))
    except (OSError, RuntimeError, subprocess.SubprocessError):
        return NumpyLoops(moved)  # equal results, more slowly
