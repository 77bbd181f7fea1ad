"""Direct collocation at Radau or Gauss-Legendre points of any degree, and at mesh points.

The state is a polynomial of degree d over each interval, through the start and the d points, and
satisfies the dynamics at the points, equation (4). Source: Biegler, *Nonlinear Programming*,
chapter 10. Order of the state at the mesh points: 2d - 1 (Radau), 2d (Gauss-Legendre).

Trapezoidal and Hermite-Simpson collocation have the next state as an inner variable. Source: Betts,
*Practical Methods for Optimal Control*, 2nd ed., section 4.5 (compressed forms); orders two and
four.

Theory: docs/theory/transcription.md, equation (4).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.ocp.problem import Phase
from microbot_ocp.ocp.transcription.schemes._base import (
    Fraction,
    Interval,
    IntervalStep,
    StageVariable,
    lagrange,
    pointwise,
    refuse_pointwise,
)

DENSE = 41  # points per interval at which polynomial controls are compared with their bounds


@dataclass(frozen=True)
class Collocation:
    """Collocation at "radau" or "legendre" points.

    Attributes
    ----------
    kind : "radau" (the last point is the end of the interval) or "legendre"
    degree : number of points, 1 to 9
    """

    kind: str = "radau"
    degree: int = 3

    def __post_init__(self) -> None:
        checks.one_of("kind", self.kind, ("radau", "legendre"))
        if not 1 <= self.degree <= 9:
            raise InputError(f"degree must be 1 to 9, not {self.degree}")

    @property
    def points(self) -> tuple[float, ...]:
        """Collocation points as fractions of an interval."""
        return tuple(_coefficients(self.kind, self.degree)[0])

    @property
    def weights(self) -> FloatArray:
        """Quadrature weights [degree] of the points on an interval of length 1."""
        return _coefficients(self.kind, self.degree)[3]

    @property
    def order(self) -> int:
        """Order of the state at the mesh points."""
        return 2 * self.degree - (self.kind == "radau")

    def variables(self, phase: Phase) -> tuple[StageVariable, ...]:
        """Return states, polynomial controls and algebraic variables at every point."""
        inside = [*phase.states, *pointwise(phase)]
        return tuple(StageVariable(v, point) for point in self.points for v in inside)

    def step(self, phase: Phase, interval: Interval, values: Sequence[ca.MX]) -> IntervalStep:
        """Return the step of the polynomial over the interval, with one defect per point."""
        points, slope_matrix, end_weights, cost_weights = _coefficients(self.kind, self.degree)
        states, local = len(phase.states), len(pointwise(phase))
        per_point = states + local
        at_point = [values[i * per_point : (i + 1) * per_point] for i in range(self.degree)]
        x = [interval.x, *(ca.vertcat(*k[:states]) for k in at_point)]
        local_values = [ca.vertcat(*k[states:]) if local else ca.MX(0, 1) for k in at_point]
        defects: list[tuple[float, ca.MX]] = []
        running = ca.MX(0)
        for j, point in enumerate(points):
            u = ca.vertcat(interval.control(point), local_values[j])
            slope, cost = interval.f(x[j + 1], u, point)
            polynomial = sum((slope_matrix[i, j] * k for i, k in enumerate(x)), ca.MX(0))
            defects.append((point, polynomial - interval.length * slope))
            running = running + cost_weights[j] * interval.length * cost
        arrived = sum((end_weights[i] * k for i, k in enumerate(x)), ca.MX(0))

        def at(fraction: Fraction) -> tuple[ca.MX, ca.MX]:
            state = _interpolate([0.0, *points], x, fraction)
            inner = _interpolate(points, local_values, fraction) if local else ca.MX(0, 1)
            return state, ca.vertcat(interval.control(fraction), inner)

        return IntervalStep(arrived, running, tuple(defects), at)


def within_bounds(
    values: FloatArray, points: Sequence[float], lower: FloatArray, upper: FloatArray
) -> FloatArray:
    """Return values of polynomial controls that keep their bounds between the points too.

    A polynomial through points within the bounds may leave them in between, and does so where the
    control jumps. There the values are scaled towards their mean over the interval, just enough to
    keep the bounds: the mean, and with it the motion of the states, is unchanged (the limiter of
    Zhang and Shu, *Journal of Computational Physics* 229, 2010). Other values are not changed.

    Parameters
    ----------
    values : values at the points [M, points, size] in M intervals
    points : fractions of an interval [points]
    lower, upper : bounds [size]
    """
    if len(points) == 1 or not (np.isfinite(lower) | np.isfinite(upper)).any():
        return values
    mean = np.tensordot(values, _quadrature(points), axes=(1, 0))[:, None]
    along = np.einsum("gp,mps->mgs", _dense_basis(tuple(points)), values)
    share = np.ones_like(mean)
    for bound, extreme, sign in (
        (upper, along.max(axis=1, keepdims=True), 1.0),
        (lower, along.min(axis=1, keepdims=True), -1.0),
    ):
        with np.errstate(all="ignore"):
            room = sign * (bound - mean) / (sign * (extreme - mean))
        over = sign * (extreme - bound) > 0
        share = np.where(over, np.minimum(share, np.clip(room, 0.0, 1.0)), share)
    return np.where(share < 1, mean + share * (values - mean), values)


@lru_cache(maxsize=32)
def _dense_basis(points: tuple[float, ...]) -> FloatArray:
    """Return Lagrange polynomials [G, points] on an even grid of an interval."""
    return np.column_stack(lagrange(points, np.linspace(0.0, 1.0, DENSE)))


@lru_cache(maxsize=32)
def _coefficients(kind: str, degree: int) -> tuple[list[float], FloatArray, FloatArray, FloatArray]:
    """Return points, derivative matrix [d+1,d], end weights [d+1] and quadrature weights [d]."""
    points = [float(p) for p in ca.collocation_points(degree, kind)]
    slope, end, _ = ca.collocation_coeff(points)
    return points, np.array(slope), np.array(end).ravel(), _quadrature(points)


def _quadrature(points: Sequence[float]) -> FloatArray:
    """Return integrals [d] of the Lagrange polynomials.

    CasADi's quadrature is wrong for a single Radau point.
    """
    nodes, weights = np.polynomial.legendre.leggauss(len(points))
    bases = lagrange(points, (nodes + 1) / 2)
    return np.array([weights @ (basis * np.ones_like(nodes)) / 2 for basis in bases])


def _interpolate(points: Sequence[float], values: Sequence[ca.MX], s: Fraction) -> ca.MX:
    """Return the Lagrange interpolation at s."""
    if isinstance(s, float) and s in points:
        return values[points.index(s)]
    pairs = zip(lagrange(points, s), values, strict=True)
    return sum((weight * value for weight, value in pairs), ca.MX(0))


# the next state as an inner variable --------------------------------------------------------------


def _next_state(phase: Phase, scheme: str) -> tuple[StageVariable, ...]:
    refuse_pointwise(phase, scheme)
    return tuple(StageVariable(state, 1.0) for state in phase.states)


@dataclass(frozen=True)
class Trapezoidal:
    """Trapezoidal collocation: the derivative is linear over the interval."""

    points: tuple[float, ...] = ()
    order: int = 2

    def variables(self, phase: Phase) -> tuple[StageVariable, ...]:
        """Return the state at the end."""
        return _next_state(phase, "trapezoidal")

    def step(self, phase: Phase, interval: Interval, values: Sequence[ca.MX]) -> IntervalStep:
        """Return the step with one defect, from the derivatives at both ends."""
        h, after = interval.length, ca.vertcat(*values)
        f0, l0 = interval.f(interval.x, interval.control(0.0), 0.0)
        f1, l1 = interval.f(after, interval.control(1.0), 1.0)
        defect = after - interval.x - h / 2 * (f0 + f1)

        def at(s: Fraction) -> tuple[ca.MX, ca.MX]:
            state = interval.x + h * (s * f0 + s**2 / 2 * (f1 - f0))
            return state, interval.control(s)

        return IntervalStep(after, h / 2 * (l0 + l1), ((0.5, defect),), at)


@dataclass(frozen=True)
class HermiteSimpson:
    """Hermite-Simpson collocation: a cubic state that satisfies the dynamics at the midpoint."""

    points: tuple[float, ...] = (0.5,)
    order: int = 4

    def variables(self, phase: Phase) -> tuple[StageVariable, ...]:
        """Return the state at the end."""
        return _next_state(phase, "hermite_simpson")

    def step(self, phase: Phase, interval: Interval, values: Sequence[ca.MX]) -> IntervalStep:
        """Return the step with one defect, by Simpson's rule with the midpoint of the cubic."""
        h, x, after = interval.length, interval.x, ca.vertcat(*values)
        f0, l0 = interval.f(x, interval.control(0.0), 0.0)
        f1, l1 = interval.f(after, interval.control(1.0), 1.0)
        middle = (x + after) / 2 + h / 8 * (f0 - f1)
        fm, lm = interval.f(middle, interval.control(0.5), 0.5)
        defect = after - x - h / 6 * (f0 + 4 * fm + f1)

        def at(s: Fraction) -> tuple[ca.MX, ca.MX]:
            # Cubic Hermite interpolant of both ends and their derivatives.
            state = (
                (1 + 2 * s) * (1 - s) ** 2 * x
                + s * (1 - s) ** 2 * h * f0
                + s**2 * (3 - 2 * s) * after
                + s**2 * (s - 1) * h * f1
            )
            return state, interval.control(s)

        return IntervalStep(after, h / 6 * (l0 + 4 * lm + l1), ((0.5, defect),), at)
