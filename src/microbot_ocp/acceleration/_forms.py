"""Coefficients of a joint's torque as functions of position, with bounds of their curvature.

``tau_i = g_i(q) + sum_j M_ij(q) qdd_j + sum_jk C_ijk(q) qd_j qd_k + friction``

Each coefficient g_i, M_ij, C_ijk is called a term. In revolute joints a term is a finite sum of
plane waves ``A cos(nu . q + phase)`` with integer frequencies, ``|nu_j| <= 2``. In prismatic joints
it is a polynomial of degree two at most.

A wave differs from its tangent at c by at most ``A (nu . (q - c))^2 / 2``. The same holds for a
power x^m with |x| <= 1 and m in place of nu. The sum of ``A nu nu'`` over all waves of a term
therefore bounds its curvature everywhere.

A discrete Fourier transform yields the amplitudes A, exactly for such sums. Values and slopes of
the terms come from the robot's own CasADi functions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import ROUNDING, FloatArray, InputError
from microbot_ocp._base.fast_calls import table_call
from microbot_ocp.robot import Robot, forward_kinematics, gravity_torque, mass_matrix

# The mass matrix of eight revolute joints has 5^7 = 78,125 waves: five frequencies for each joint
# but the first.
MOST_WAVES = 100_000
# Angles at which a full turn of the last joint is sampled, and the rows that turn the samples into
# their mean and their waves.
TURN = 2 * np.pi * np.arange(5) / 5
_WAVES = np.array([0.0 * TURN + 1.0, *(f(k * TURN) for f in (np.cos, np.sin) for k in (1, 2))]) / 5
# Coefficients of 1, x, x^2 are _POWERS @ (values at x = -1, 0, 1).
_POWERS = np.array([[0.0, 1.0, 0.0], [-0.5, 0.0, 0.5], [0.5, -1.0, 0.5]])
# Coefficients of the derivative are _SLOPE @ (coefficients of 1, x, x^2).
_SLOPE = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 2.0], [0.0, 0.0, 0.0]])


@dataclass(frozen=True, eq=False)
class Terms:
    """F functions of the joint positions, with bounds of the distance from their tangents.

    Attributes
    ----------
    call : function of q [B,n] to the values and slopes [B, (1 + n) F]
    curvature : array [F,n,n]
        Bound of the curvature: at distances ``|q_j - c_j| <= w_j`` a term differs from its tangent
        at c by at most ``w' curvature w / 2``.
    amplitude : array [F]
        Bound of the absolute value of a term.
    steep, span : array [F,n]
        Bounds of the slope by a position, and of the change over all of its positions.
    second : function of q [B,n] and weights [B,S]
        Second derivatives [B,n n] of the weighted sum of the first S terms; None if S is 0.
    fourth : array [S,P,P]
        Bounds of the fourth derivatives of the first S terms, by pairs of joints.
    rolling : array [F,n,n]
        Part of ``curvature`` that changes with the position of the last joint; None if that joint
        slides or moves others.
    """

    call: Callable[[FloatArray], Any]
    curvature: FloatArray
    amplitude: FloatArray
    steep: FloatArray
    span: FloatArray
    second: Callable[[FloatArray, FloatArray], Any] | None = None
    fourth: FloatArray | None = None
    rolling: FloatArray | None = None

    def at(self, q: FloatArray) -> FloatArray:
        """Return values [B,0,F] and slopes [B,1:,F] of the terms at positions [B,n]."""
        count = len(self.curvature)
        return np.asarray(self.call(q)).reshape(len(q), 1 + q.shape[1], count)

    def tangent_error(self, half: FloatArray, rolling: bool = False) -> FloatArray:
        """Return bounds [B,F] of the distance from the tangents in boxes of half width [B,n].

        With ``rolling`` the distance is that of the part that changes with the last joint.
        """
        curvature = self.rolling if rolling and self.rolling is not None else self.curvature
        squares = (half[:, :, None] * half[:, None, :]).reshape(-1, half.shape[1] ** 2)
        return 0.5 * squares @ curvature.reshape(len(curvature), -1).T

    def bends(self, q: FloatArray, weights: FloatArray) -> FloatArray:
        """Return second derivatives [B,n,n] of the first S terms, summed with weights [B,S]."""
        assert self.second is not None
        return np.asarray(self.second(q, weights)).reshape(len(q), q.shape[1], q.shape[1])

    def over_a_turn(self, q: FloatArray, here: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return means and amplitudes [B,1 + n,F] of values and slopes over the last joint's turn.

        ``here`` are the values and slopes at positions [B,n]. Frequencies are 2 at most, so five
        samples determine the waves in that joint exactly.
        """
        turns = np.repeat(q, 4, axis=0)
        turns[:, -1] += np.tile(TURN[1:], len(q))
        samples = np.hstack([here.reshape(len(q), 1, -1), self.at(turns).reshape(len(q), 4, -1)])
        waves = _WAVES @ samples
        amplitudes = 2.0 * np.sqrt(waves[:, 1:3] ** 2 + waves[:, 3:] ** 2).sum(axis=1)
        return waves[:, 0].reshape(here.shape), amplitudes.reshape(here.shape)

    def parabola_error(self, half: FloatArray) -> FloatArray:
        """Return bounds [B,S] of the first S terms' distance from their second Taylor polynomial.

        The distance of one wave is at most ``A |nu . x|^3 / 6``. By Cauchy and Schwarz,
        ``sum A |nu . x|^3 <= sqrt(sum A (nu . x)^2  sum A (nu . x)^4)``. In these
        even sums mixed products of nu have signs and may cancel, which |nu . x|^3 would not allow.
        """
        assert self.fourth is not None
        first, second = pairs(half.shape[1])
        products = half[:, first] * half[:, second] * np.where(first == second, 1.0, 2.0)
        powers = np.einsum("bp,spq,bq->bs", products, self.fourth, products, optimize=True)
        return np.sqrt(2.0 * self.tangent_error(half)[:, : len(self.fourth)] * powers) / 6.0


def pairs(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices j and k of all pairs j <= k of joints."""
    return np.triu_indices(count)


@lru_cache(maxsize=32)
def torque_terms(robot: Robot, low: tuple[float, ...], high: tuple[float, ...]) -> list[Terms]:
    """Return the terms of every joint's torque: g_i, M_ij for all j, C_ijk for all pairs j <= k.

    ``low`` and ``high`` bound the joint positions, rad (m). The bounds hold for every angle of a
    revolute joint, but for a prismatic joint only between its ends.
    """
    count, chain, to_chain = robot.joint_count, robot.chain, robot.transmission
    first, second = pairs(count)
    waves = _Waves(robot, np.array(low), np.array(high))
    # The waves are those of all joints of the chain; the transmission T maps them to the actuated
    # joints: M = T' M_chain T and g = T' g_chain.
    of_chain = waves.of(mass_matrix(chain), 2)
    square = of_chain.reshape(*of_chain.shape[:-1], chain.joint_count, -1)
    inertia = np.einsum("...kl,ki,lj->...ij", square, to_chain, to_chain)
    gravity = waves.of(gravity_torque(chain), 1) @ to_chain
    q = ca.SX.sym("q", count)
    matrix, torque = mass_matrix(robot)(q), gravity_torque(robot)(q)
    rates = [ca.jacobian(matrix[:, joint], q) for joint in range(count)]
    result = []
    for i in range(count):
        amplitudes, terms = list[np.ndarray]([gravity[..., i]]), [torque[i]]
        for j in range(count):
            amplitudes.append(inertia[..., i, j])
            terms.append(matrix[i, j])
        # Christoffel symbols: C_ijk = (dM_ij/dq_k + dM_ik/dq_j - dM_jk/dq_i) / 2.
        for j, k in zip(first.tolist(), second.tolist(), strict=True):
            changes = (inertia[..., i, j], k), (inertia[..., i, k], j), (-inertia[..., j, k], i)
            amplitudes.append(np.sum([0.5 * waves.slope(*change) for change in changes], axis=0))
            terms.append(0.5 * (rates[j][i, k] + rates[k][i, j] - rates[k][j, i]))
        bounds = _columns([waves.bounds(numbers) for numbers in amplitudes])
        rolling = None
        if robot.coupling is None and robot.joint_types[-1] == "revolute":
            rolling = np.array([waves.bounds(_rolling(numbers))[0] for numbers in amplitudes])
        fourth = np.array([waves.fourth(numbers) for numbers in amplitudes[: 1 + count]])
        weights = ca.SX.sym("weights", 1 + count)
        hessian, _ = ca.hessian(ca.dot(weights, ca.vertcat(*terms[: 1 + count])), q)
        bends = ca.Function("bends", [q, weights], [ca.densify(ca.vec(hessian))])
        call = _with_slopes(terms, q)
        result.append(Terms(call, *bounds, table_call(bends), fourth, rolling))
    return result


def _rolling(numbers: np.ndarray) -> np.ndarray:
    """Return the waves that change with the position of the last joint."""
    changing = numbers.copy()
    changing[..., 0] = 0.0
    return changing


def tool_terms(robot: Robot, frame: FloatArray, low: FloatArray, high: FloatArray) -> Terms:
    """Return the coordinates of the tool's origin in a frame [4,4] as three terms.

    The frame is given in the base frame; ``low`` and ``high`` bound the joint positions, rad (m).
    """

    def place(arm: Robot, q: ca.SX) -> ca.SX:
        origin = forward_kinematics(arm)(q)[:3, 3]
        return ca.DM(frame[:3, :3]).T @ (origin - ca.DM(frame[:3, 3]))

    waves = _Waves(robot, low, high)
    q, chain_q = ca.SX.sym("q", robot.joint_count), ca.SX.sym("q", robot.link_count)
    numbers = waves.of(ca.Function("place", [chain_q], [place(robot.chain, chain_q)]), 1)
    bounds = _columns([waves.bounds(numbers[..., k]) for k in range(3)])
    return Terms(_with_slopes(ca.vertsplit(place(robot, q)), q), *bounds)


def _columns(rows: list[tuple[Any, ...]]) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    curvature, amplitude, steep, span = map(np.array, zip(*rows, strict=True))
    return curvature, amplitude, steep, span


def _with_slopes(terms: Sequence[Any], q: ca.SX) -> Callable[[FloatArray], Any]:
    values = ca.vertcat(*terms)
    outputs = ca.densify(ca.horzcat(values, ca.jacobian(values, q)))
    return table_call(ca.Function("terms", [q], [ca.vec(outputs)]))


class _Waves:
    """Functions of a chain as plane waves in revolute and polynomials in prismatic joints.

    A function is an array of complex amplitudes with one axis for each joint of the chain: over the
    frequencies of a revolute joint, or over the powers 0 to 2 of a prismatic one.
    """

    def __init__(self, robot: Robot, low: FloatArray, high: FloatArray) -> None:
        matrix, chain = robot.transmission, robot.chain
        center = robot.chain_positions((low + high) / 2)
        self._revolute = np.array(chain.joint_types) == "revolute"
        half = np.abs(matrix) @ ((high - low) / 2)
        self._half = np.where(self._revolute, 1.0, np.maximum(half, ROUNDING))
        self._center, self._matrix = np.where(self._revolute, 0.0, center), matrix
        self._robot, self._factors = robot, dict[tuple[int, ...], FloatArray]()

    def of(self, function: ca.Function, degree: int) -> np.ndarray:
        """Return amplitudes [..., F] of a function of all joint positions of the chain.

        Frequencies of revolute joints are ``degree`` at most.
        """
        # 2 degree + 1 equidistant samples determine frequencies -degree to degree exactly.
        sizes = np.where(self._revolute, 2 * degree + 1, 3)
        if degree == 2:
            sizes[0] = 1  # The mass matrix does not depend on the position of the first joint.
        if sizes.prod() > MOST_WAVES:
            raise InputError(
                f"robot {self._robot.name!r} has {sizes.size} joints in its chain: bounds of their "
                "torques are worked out for eight at most"
            )
        axes = [
            2 * np.pi * np.arange(size) / size if revolute or size == 1 else middle + half * _ENDS
            for size, revolute, middle, half in zip(
                sizes, self._revolute, self._center, self._half, strict=True
            )
        ]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, sizes.size)
        entries = ca.densify(ca.vec(function(q := ca.SX.sym("q", sizes.size))))
        values = table_call(ca.Function("entries", [q], [entries]))(points)
        numbers = np.asarray(values).reshape(*sizes, -1).astype(complex)
        for joint, size in enumerate(sizes):
            if self._revolute[joint]:
                numbers = np.fft.fft(numbers, axis=joint) / size
            elif size > 1:
                numbers = _along(_POWERS, numbers, joint)
        return numbers

    def slope(self, numbers: np.ndarray, joint: int) -> np.ndarray:
        """Return amplitudes of the derivative with respect to an actuated joint."""
        total = np.zeros_like(numbers)
        for row in np.flatnonzero(self._matrix[:, joint]).tolist():
            if numbers.shape[row] == 1:
                continue
            if self._revolute[row]:
                shape = [1] * numbers.ndim
                shape[row] = -1
                change = 1j * self._frequencies(numbers.shape[row], row).reshape(shape) * numbers
            else:
                change = _along(_SLOPE / self._half[row], numbers, row)
            total += self._matrix[row, joint] * change
        return total

    def bounds(self, numbers: np.ndarray) -> tuple[FloatArray, float, FloatArray, FloatArray]:
        """Return bounds of waves: curvature [n,n], absolute value, slopes [n] and changes [n].

        A wave ``A cos`` changes by 2 A at most.
        """
        factors, amplitudes = self._slope_factors(numbers.shape), np.abs(numbers).ravel()
        mixed = np.abs((factors * amplitudes[:, None]).T @ factors)
        amplitude = float(amplitudes.sum())
        curvature = mixed * (1 + ROUNDING) + ROUNDING * amplitude
        steep = np.abs(factors).T @ amplitudes * (1 + ROUNDING)
        span = 2.0 * (factors != 0.0).T @ amplitudes * (1 + ROUNDING)
        return curvature, amplitude, steep, span

    def fourth(self, numbers: np.ndarray) -> FloatArray:
        """Return bounds [P,P] of the fourth derivatives of a sum of waves, by pairs of joints."""
        factors, amplitudes = self._slope_factors(numbers.shape), np.abs(numbers).ravel()
        first, second = pairs(factors.shape[1])
        products = factors[:, first] * factors[:, second]
        bounds = np.abs((products * amplitudes[:, None]).T @ products)
        return bounds * (1 + ROUNDING)

    def _slope_factors(self, shape: tuple[int, ...]) -> FloatArray:
        """Return factors [K,n] from the amplitude of each wave to those of its n slopes.

        Factors of waves are frequencies with their signs, so mixed products may cancel. The sign of
        the slope of a power is unknown: with any prismatic joint all factors are made positive.
        """
        if shape not in self._factors:
            axes = [self._frequencies(size, row) for row, size in enumerate(shape)]
            each = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
            signed = self._revolute.all()
            factors = each @ self._matrix if signed else np.abs(each) @ np.abs(self._matrix)
            self._factors[shape] = factors
        return self._factors[shape]

    def _frequencies(self, size: int, row: int) -> np.ndarray:
        if size == 1:
            return np.zeros(1)
        if self._revolute[row]:
            return np.fft.fftfreq(size) * size
        return np.arange(size) / self._half[row]


_ENDS = np.array([-1.0, 0.0, 1.0])


def _along(matrix: FloatArray, numbers: np.ndarray, axis: int) -> np.ndarray:
    return np.moveaxis(np.tensordot(matrix, numbers, axes=(1, axis)), 0, axis)
