"""Piecewise polynomials of time, from which motions are sampled."""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError


class State(NamedTuple):
    """Position, velocity and acceleration at some times, each [N,n]."""

    q: FloatArray
    qd: FloatArray
    qdd: FloatArray


@dataclass(frozen=True, eq=False)
class PiecewisePolynomial:
    """Joint positions as polynomials of the time since the start of each piece.

    Parameters
    ----------
    breaks : array_like [K+1]
        Strictly increasing times, s.
    coefficients : array_like [K, degree+1, n]
        Coefficients, lowest power first.
    """

    breaks: FloatArray
    coefficients: FloatArray

    def __post_init__(self) -> None:
        breaks = checks.times("breaks", self.breaks)
        object.__setattr__(self, "breaks", breaks)
        shape = (breaks.size - 1, None, None)
        coefficients = checks.array("coefficients", self.coefficients, shape)
        if coefficients.size == 0:
            raise InputError(f"coefficients must not be empty, not of shape {coefficients.shape}")
        object.__setattr__(self, "coefficients", coefficients)

    @property
    def duration(self) -> float:
        """Duration, s."""
        return float(self.breaks[-1] - self.breaks[0])

    def derivative(self) -> PiecewisePolynomial:
        """Return the first derivative with respect to time."""
        powers = np.arange(1, self.coefficients.shape[1])
        lowered = self.coefficients[:, 1:] * powers[None, :, None]
        if lowered.shape[1] == 0:
            lowered = np.zeros_like(self.coefficients[:, :1])
        return _trusted(self.breaks, lowered)

    def __call__(self, t: ArrayLike, *, from_left: bool = False) -> FloatArray:
        """Return values [N,n] at times t [N]; at a break, those of the later piece by default."""
        times = np.atleast_1d(t if isinstance(t, np.ndarray) else checks.numbers("t", t))
        if times.ndim != 1:
            raise InputError(f"t must have shape [any], not {list(times.shape)}")
        side = "left" if from_left else "right"
        piece = np.searchsorted(self.breaks[1:-1], times, side=side)
        local = (times - self.breaks[piece])[:, None]
        value = np.zeros((times.size, self.coefficients.shape[2]))
        for of_power in np.ascontiguousarray(self.coefficients.swapaxes(0, 1))[::-1]:
            value *= local
            value += of_power.take(piece, axis=0)
        return value

    def divided(self, times: FloatArray) -> PiecewisePolynomial:
        """Return the polynomial with further breaks, at times inside of it, s."""
        breaks, each = np.union1d(self.breaks, times), self
        terms = []
        for power in range(self.coefficients.shape[1]):
            terms.append(each(breaks[:-1]) / factorial(power))
            each = each.derivative()
        return _trusted(breaks, np.stack(terms, axis=1))

    def stretched(self, factor: float) -> PiecewisePolynomial:
        """Return the polynomial slowed down by ``factor`` (above 0)."""
        factor = checks.number("factor", factor, above=0.0)
        powers = factor ** -np.arange(self.coefficients.shape[1], dtype=float)
        start = self.breaks[0]
        return _trusted(
            start + (self.breaks - start) * factor, self.coefficients * powers[None, :, None]
        )


def _trusted(breaks: FloatArray, coefficients: FloatArray) -> PiecewisePolynomial:
    """Return a polynomial made from a checked one, without further checks."""
    polynomial = object.__new__(PiecewisePolynomial)
    for name, values in (("breaks", breaks), ("coefficients", coefficients)):
        values.setflags(write=False)
        object.__setattr__(polynomial, name, values)
    return polynomial


def quintic_between(start: State, end: State, h: FloatArray) -> FloatArray:
    """Return coefficients [K,6,n] of the quintics between states [K,n] over durations h [K], s."""
    h = np.asarray(h, dtype=float)[:, None]
    q, qd, qdd = start
    # The residuals of a constant acceleration are scaled by the interval to the unit of position.
    dq = end.q - (q + h * (qd + 0.5 * h * qdd))
    dv = (end.qd - (qd + h * qdd)) * h
    da = (end.qdd - qdd) * h**2
    c3 = (10 * dq - 4 * dv + 0.5 * da) / h**3
    c4 = (-15 * dq + 7 * dv - da) / h**4
    c5 = (6 * dq - 3 * dv + 0.5 * da) / h**5
    return np.stack([q, qd, 0.5 * qdd, c3, c4, c5], axis=1)
