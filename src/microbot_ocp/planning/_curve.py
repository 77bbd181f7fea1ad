"""A joint path ready for timing: pieces whose ends at rest have been given a regular parameter.

A trajectory that starts from rest, such as a cubic or a quintic, has a vanishing tangent there:
q - q(0) ~ s^(m+1), m = 1 for a cubic, 2 for a quintic. With m = 1 the arm leaves at a finite s',
with m = 2 at an infinite one. Such an end is described by another parameter r instead,
``s = L x^e ((1 + e) + (1 - e) x) / 2`` with ``x = r/R``, ``e = p/(m+1)`` and ``R = L (1 + e)/2``,
in which every path leaves like r^p. At the other end of the piece ds/dr = 1 and its slope is zero,
so that r' and r'' are continuous there. Every other piece keeps r = s. With p = 2 the arm starts at
a finite r' and acceleration; where jerk or torque rates are limited it starts with neither, and
p = 1.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.motion import PiecewisePolynomial

IntArray = NDArray[np.intp]

VANISHING = 1e-9  # relative size of a derivative that counts as zero
# Share of a bent piece by which it starts inside, where powers of r are finite; by the power of r
# with which the path leaves. With 1e-6 and p = 1 a quintic's third derivative stops the solver.
INSIDE = {2: 1e-10, 1: 1e-5}


@dataclass(frozen=True, eq=False)
class CurvePiece:
    """One polynomial piece of a path.

    Attributes
    ----------
    coefficients : array [degree+1, n]
        Powers of s since the start of the piece.
    length : float
        Range of s.
    order : int
        Derivatives that vanish at the end that is bent (m).
    bent_at_end : bool
        Whether it is the end that is bent, not the start.
    halved : bool
        Whether it is the first half of a piece of the path, so that it ends inside.
    """

    coefficients: FloatArray
    length: float
    order: int = 0
    bent_at_end: bool = False
    halved: bool = False  # the first half of a piece of the path
    leaves_like: int = 2  # power of r with which the path leaves the bent end (p)

    @property
    def bent(self) -> bool:
        """Whether r is another parameter than s."""
        return self.order + 1 > self.leaves_like

    @property
    def exponent(self) -> float:
        """Power of r in s."""
        return self.leaves_like / (self.order + 1) if self.bent else 1.0

    @property
    def span(self) -> float:
        """Range R of the parameter r."""
        return 0.5 * self.length * (1.0 + self.exponent)

    @property
    def limits(self) -> tuple[float, float]:
        """First and last r that are used."""
        if not self.bent:
            return 0.0, self.span
        margin = INSIDE[self.leaves_like] * self.span
        return (0.0, self.span - margin) if self.bent_at_end else (margin, self.span)

    @property
    def constants(self) -> FloatArray:
        """Everything that tells one piece from another, for kernels that all pieces share."""
        return np.concatenate([self.coefficients.ravel(), [self.length, float(self.bent_at_end)]])


def derivatives(
    table: Any, length: Any, at_end: Any, exponent: float, r: Any, *, highest: int = 3
) -> list[Any]:
    """Position and its derivatives with respect to r, up to ``highest`` <= 3.

    Parameters
    ----------
    table : [degree+1][n], columns of coefficients (numpy or CasADi, any that multiply and add)
    length, at_end : length of the piece; 1 where its end is bent, 0 where its start is
    exponent : power of r in s
    r : parameter, a number or a symbol
    """
    s, slopes = _bend(length, at_end, exponent, r)
    first, second, third = slopes
    along = [_power_sum(table, s, order) for order in range(highest + 1)]
    result = [along[0], along[1] * first]
    if highest >= 2:
        result.append(along[2] * first**2 + along[1] * second)
    if highest >= 3:
        result.append(along[3] * first**3 + 3 * along[2] * first * second + along[1] * third)
    return result


def _bend(length: Any, at_end: Any, exponent: float, r: Any) -> tuple[Any, list[Any]]:
    """s since the start of a piece and its first three derivatives with respect to r."""
    if exponent == 1.0:
        return r, [1.0, 0.0, 0.0]
    span = 0.5 * length * (1.0 + exponent)
    sign = 1.0 - 2.0 * at_end
    x = (at_end * span + sign * r) / span  # distance from the bent end, 0 to 1
    low, high = 0.5 * (1.0 + exponent), 0.5 * (1.0 - exponent)
    s = at_end * length + sign * length * (low * x**exponent + high * x ** (exponent + 1.0))
    slopes, factor = [], length * sign
    for k in range(3):
        low, high = low * (exponent - k), high * (exponent + 1.0 - k)
        factor = factor * sign / span
        slopes.append(factor * (low * x ** (exponent - k - 1.0) + high * x ** (exponent - k)))
    return s, slopes


def _power_sum(table: Any, s: Any, order: int) -> Any:
    """Derivative of the polynomial by Horner's rule."""
    degree = len(table) - 1
    total = 0.0 * table[0]
    for power in range(degree, order - 1, -1):
        factor = float(np.prod([power - k for k in range(order)]))
        total = total * s + factor * table[power]
    return total


def symbolic_derivatives(
    constants: ca.MX, degree: int, joints: int, exponent: float, r: ca.MX
) -> list[ca.MX]:
    """Position, tangent, curvature and third derivative [n] from the constants of a piece."""
    size = (degree + 1) * joints
    table = [constants[k * joints : (k + 1) * joints] for k in range(degree + 1)]
    return derivatives(table, constants[size], constants[size + 1], exponent, r)


def evaluate(piece: CurvePiece, r: FloatArray, *, highest: int = 2) -> list[FloatArray]:
    """Position and derivatives with respect to r, each [N,n], at parameters r [N]."""
    column = np.asarray(r, dtype=float)[:, None]
    table = [row[None, :] for row in piece.coefficients]
    at_end = float(piece.bent_at_end)
    found = derivatives(table, piece.length, at_end, piece.exponent, column, highest=highest)
    return [values * np.ones_like(column) for values in found]


@dataclass(frozen=True, eq=False)
class Curve:
    """Pieces in a row, over one parameter r that runs through all of them.

    Attributes
    ----------
    pieces : tuple of CurvePiece
    start_free, end_free : bool
        Whether the tangent vanishes at an end, so that the arm rests there at any r'.
    """

    pieces: tuple[CurvePiece, ...]
    start_free: bool
    end_free: bool

    @classmethod
    def of(cls, path: PiecewisePolynomial, leaves_like: int = 2) -> Curve:
        """A path between two stops with a regular parameter.

        ``leaves_like`` is the power of it with which the path leaves an end at rest: 2, or 1 where
        the jerk is limited.
        """
        start = vanishing_order(path, float(path.breaks[0]), from_left=False)
        end = vanishing_order(path, float(path.breaks[-1]), from_left=True)
        free = leaves_like == 2
        pieces = _bent_pieces(path, start, end, leaves_like)
        return cls(tuple(pieces), free and start > 0, free and end > 0)

    @property
    def breaks(self) -> FloatArray:
        """Parameters r at which pieces begin and end."""
        spans = np.array([b - a for a, b in (piece.limits for piece in self.pieces)])
        return self.pieces[0].limits[0] + np.concatenate([[0.0], np.cumsum(spans)])

    def evaluate(
        self, r: FloatArray, *, from_left: bool = False, highest: int = 2
    ) -> tuple[FloatArray, ...]:
        """Position and derivatives [N,n]; at a break of the later piece, or the earlier."""
        return self._at(self._piece_of(r, from_left), r, highest)

    def inside(
        self, r: FloatArray, i: IntArray, grid: FloatArray, *, highest: int = 2
    ) -> tuple[FloatArray, ...]:
        """As :meth:`evaluate`, of parameters in the intervals i of a grid that holds the breaks."""
        return self._at(self._piece_of(0.5 * (grid[1:] + grid[:-1]), False)[i], r, highest)

    def _piece_of(self, r: FloatArray, from_left: bool) -> IntArray:
        side = "left" if from_left else "right"
        return np.clip(np.searchsorted(self.breaks, r, side=side) - 1, 0, len(self.pieces) - 1)

    def _at(self, index: IntArray, r: FloatArray, highest: int) -> tuple[FloatArray, ...]:
        """As :meth:`evaluate`, of parameters [N] in pieces ``index`` [N]."""
        begins, ends = np.array([piece.limits for piece in self.pieces]).T
        local = np.clip(r - self.breaks[index] + begins[index], begins[index], ends[index])
        coefficients = np.array([piece.coefficients for piece in self.pieces])
        table = [coefficients[index, power] for power in range(coefficients.shape[1])]
        tables = derivatives(table, 0.0, 0.0, 1.0, local[:, None], highest=highest)
        for k in (0, len(self.pieces) - 1):
            if self.pieces[k].bent:
                here = index == k
                own = evaluate(self.pieces[k], local[here], highest=highest)
                for whole, values in zip(tables, own, strict=True):
                    whole[here] = values
        return tuple(tables)

    def parameter(self, r: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The path's own parameter s since the start of the curve, and ds/dr, both [N]."""
        s, slope, begin = np.zeros_like(r), np.zeros_like(r), 0.0
        for piece, here, local in self._by_piece(r, False):
            own, slopes = _bend(piece.length, float(piece.bent_at_end), piece.exponent, local)
            s[here], slope[here] = begin + own, slopes[0]
            begin += piece.length
        return s, slope

    def _by_piece(self, r: FloatArray, from_left: bool) -> Iterator[tuple[CurvePiece, Any, Any]]:
        """Every piece with the places of its parameters and their values within it."""
        breaks = self.breaks
        side = "left" if from_left else "right"
        index = np.clip(np.searchsorted(breaks, r, side=side) - 1, 0, len(self.pieces) - 1)
        for i, piece in enumerate(self.pieces):
            here = index == i
            yield piece, here, r[here] - breaks[i] + piece.limits[0]


def _bent_pieces(
    path: PiecewisePolynomial, start: int, end: int, leaves_like: int
) -> list[CurvePiece]:
    """Pieces of a path with its ends bent where more derivatives vanish there than they may."""
    pieces = [
        CurvePiece(table, float(length), leaves_like=leaves_like)
        for table, length in zip(path.coefficients, np.diff(path.breaks), strict=True)
    ]
    bent = start + 1 > leaves_like, end + 1 > leaves_like
    if len(pieces) == 1 and all(bent):
        pieces = _halves(pieces[0])
    if bent[0]:
        pieces[0] = replace(pieces[0], order=start)
    if bent[1]:
        pieces[-1] = replace(pieces[-1], order=end, bent_at_end=True)
    return pieces


def vanishing_order(path: PiecewisePolynomial, s: float, *, from_left: bool) -> int:
    """How many derivatives of the path vanish on one side of s, up to its degree - 1."""
    sizes = np.linspace(path.breaks[0], path.breaks[-1], 21)
    curve = path
    for order in range(path.coefficients.shape[1] - 1):
        curve = curve.derivative()
        size = float(np.abs(curve(sizes)).max())
        if float(np.abs(curve(s, from_left=from_left)).max()) > VANISHING * max(size, 1e-300):
            return order
    return path.coefficients.shape[1] - 2


def _halves(piece: CurvePiece) -> list[CurvePiece]:
    """The same piece in two."""
    half = piece.length / 2
    degree = piece.coefficients.shape[0] - 1
    shifted = np.zeros_like(piece.coefficients)
    for k in range(degree + 1):
        for j in range(k + 1):
            shifted[j] += piece.coefficients[k] * _binomial(k, j) * half ** (k - j)
    first = replace(piece, length=half, halved=True)
    return [first, replace(piece, coefficients=shifted, length=half)]


def _binomial(n: int, k: int) -> float:
    return float(np.prod([(n - i) / (i + 1) for i in range(k)]))
