"""Joint paths for timing: checks, stops, and a regular parameter between stops.

A trajectory that starts from rest, such as a cubic or a quintic, has a vanishing tangent there:
q - q(0) ~ s^(m+1), m = 1 for a cubic, 2 for a quintic. The arm leaves like t^p, p = 2 if its
acceleration may jump and p = 3 if rates are limited, so s grows like t^(p/(m+1)), with an infinite
derivative. Such an end gets another parameter r,
``s = L x^e ((1 + e) + (1 - e) x) / 2`` with ``x = r/R``, ``e = p/(m+1)`` and ``R = L (1 + e)/2``,
in which every path leaves like r^p, at a finite r'. At the other end of the piece ds/dr = 1 with
slope zero, so that r' and r'' are continuous there. Every other piece keeps r = s.

Theory: docs/theory/path_timing.md, equation (4).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import comb, factorial, perm, prod
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microbot_ocp._base import checks
from microbot_ocp._base.checks import ROUNDING, FloatArray, InputError
from microbot_ocp.limits import LimitFamily, MotionSamples
from microbot_ocp.motion import PiecewisePolynomial
from microbot_ocp.planning.task import check_pace, check_positions, check_rest, locked_joints

IntArray = NDArray[np.intp]


TINY = np.finfo(float).tiny / np.finfo(float).eps  # divisor in place of zero
CORNER_JUMP = 1e-6  # jump of the tangent that counts as a corner, per largest tangent


@dataclass(frozen=True, eq=False)
class CurvePiece:
    """One polynomial piece of a path.

    Attributes
    ----------
    coefficients : array [degree+1, n]
        Coefficients of powers of s from the start of the piece; from its end, backwards, if that is
        bent.
    length : float
        Range L of s.
    order : int
        Number m of derivatives that vanish at the bent end.
    bent_at_end : bool
        True if the end is bent, False for the start.
    halved : bool
        True for the first half of a divided piece, whose end is no break of the path.
    leaves_like : int
        Power p of r with which the path leaves the bent end.
    unit : float
        Range of the path's own parameter per unit of s.
    """

    coefficients: FloatArray
    length: float
    order: int = 0
    bent_at_end: bool = False
    halved: bool = False
    leaves_like: int = 2
    unit: float = 1.0

    @property
    def bent(self) -> bool:
        """True if r differs from s."""
        return self.order > 0 and self.order + 1 != self.leaves_like

    @property
    def powers(self) -> tuple[int, int]:
        """Integers p and m + 1, whose ratio e is the power of r in s."""
        return (self.leaves_like, self.order + 1) if self.bent else (1, 1)

    @property
    def span(self) -> float:
        """Range R of the parameter r."""
        return self.length * _span(self.powers)

    @property
    def limits(self) -> tuple[float, float]:
        """First and last r in use."""
        if not self.bent:
            return 0.0, self.span
        margin = ROUNDING * self.span  # at the end itself powers of r are infinite
        return (0.0, self.span - margin) if self.bent_at_end else (margin, self.span)

    def from_the_bent_end(self, r: FloatArray) -> tuple[FloatArray, float]:
        """Return the share x of the range from the bent end, 0 to 1, and its derivative by r."""
        span, sign = self.span, -1.0 if self.bent_at_end else 1.0
        return (float(self.bent_at_end) * span + sign * r) / span, sign / span


def _near_a_bent_end(piece: CurvePiece, r: FloatArray, highest: int) -> list[FloatArray]:
    """Return position and derivatives by r, each [N,n], at parameters r [N,1] of a bent piece.

    docs/theory/path_timing.md, equation (4).
    """
    x, slope = piece.from_the_bent_end(r)
    table, powers, result = piece.coefficients, piece.powers, []
    for order in range(highest + 1):
        total = table[0] if order == 0 else 0.0 * table[0]
        # Coefficients 1 to m are zero: the first m derivatives vanish.
        for k in range(powers[1], len(table)):
            total = total + table[k] * piece.length**k * _bent_power(x, powers, k, order)
        result.append(total * slope**order)
    return result


def _span(powers: tuple[int, int]) -> float:
    """Return R / L."""
    return 0.5 * (1.0 + powers[0] / powers[1])


def _bent_power(x: FloatArray, powers: tuple[int, int], k: int, order: int) -> Any:
    """Return a derivative by x of (s / L)^k, with s from equation (4).

    By Leibniz' rule for ``x^(e k) * (low + (1 - low) x)^k`` with low = (1 + e) / 2.
    """
    low = _span(powers)
    rest, power = 1.0 - low, k * powers[0] / powers[1]
    total: Any = 0.0
    for i in range(order + 1):
        factor = comb(order, i) * perm(k, order - i) * prod(power - j for j in range(i))
        if factor:
            second = rest ** (order - i) * (low + rest * x) ** (k - order + i)
            total = total + factor * x ** (power - i) * second
    return total


def _power_sum(table: Sequence[FloatArray], s: FloatArray, order: int) -> FloatArray:
    """Return a derivative of a polynomial at s by Horner's rule."""
    degree = len(table) - 1
    total = perm(degree, order) * table[degree]
    for power in range(degree - 1, order - 1, -1):
        total = total * s + perm(power, order) * table[power]
    return total


@dataclass(frozen=True, eq=False)
class PathCurve:
    """Consecutive pieces over one parameter r.

    Attributes
    ----------
    pieces : tuple of CurvePiece
    start_free, end_free : bool
        True if the tangent vanishes at the end, so that the arm rests there at any r'.
    """

    pieces: tuple[CurvePiece, ...]
    start_free: bool
    end_free: bool

    @classmethod
    def of(cls, path: PiecewisePolynomial, units: FloatArray, leaves_like: int = 2) -> PathCurve:
        """Return the curve of a path between two stops, with a regular parameter.

        ``units`` [K] are those of its pieces. ``leaves_like`` is the power of the parameter with
        which the path leaves an end at rest: 2, or 3 under limits of rates.
        """
        start, end = vanishing_orders(path, path.breaks[[0, -1]], from_left=True)
        pieces = [
            CurvePiece(table, float(length), leaves_like=leaves_like, unit=float(unit))
            for table, length, unit in zip(
                path.coefficients, np.diff(path.breaks), units, strict=True
            )
        ]
        return cls(tuple(_bent_pieces(pieces, start, end)), start > 0, end > 0)

    @cached_property
    def breaks(self) -> FloatArray:
        """Parameters r at which pieces begin and end."""
        spans = np.array([b - a for a, b in (piece.limits for piece in self.pieces)])
        return self.pieces[0].limits[0] + np.concatenate([[0.0], np.cumsum(spans)])

    @cached_property
    def _tables(self) -> tuple[FloatArray, FloatArray]:
        """First parameters [N] in use of the pieces, and coefficients [degree+1, N, n] by power."""
        begins = np.array([piece.limits[0] for piece in self.pieces])
        return begins, np.stack([piece.coefficients for piece in self.pieces], axis=1)

    def evaluate(
        self, r: FloatArray, *, from_left: bool = False, highest: int = 2
    ) -> tuple[FloatArray, ...]:
        """Return position and derivatives [N,n]; at a break those of the later or earlier piece."""
        return self._at(self._piece_of(r, from_left), r, highest)

    def on_both_sides(self, r: FloatArray, breaks: IntArray) -> tuple[FloatArray, ...]:
        """Return position and derivatives at r [N] from the right, at r[breaks] [K] from the left.

        Tables have N + K rows.
        """
        index = np.append(self._piece_of(r, False), self._piece_of(r[breaks], True))
        return self._at(index, np.append(r, r[breaks]), 2)

    def inside(
        self, r: FloatArray, i: IntArray, grid: FloatArray, *, highest: int = 2
    ) -> tuple[FloatArray, ...]:
        """Return position and derivatives inside the intervals i of a grid with all breaks."""
        return self._at(self._piece_of(0.5 * (grid[1:] + grid[:-1]), False)[i], r, highest)

    def _piece_of(self, r: FloatArray, from_left: bool) -> IntArray:
        return np.searchsorted(self.breaks[1:-1], r, side="left" if from_left else "right")

    def _at(self, index: IntArray, r: FloatArray, highest: int) -> tuple[FloatArray, ...]:
        """Return position and derivatives at parameters [N] in pieces ``index`` [N]."""
        begins, table = self._tables
        # Rounding may put r slightly beyond its piece, which extrapolates smoothly.
        r = np.clip(r, self.breaks[0], self.breaks[-1])
        local = r - self.breaks[index] + begins[index]
        table = [coefficients[index] for coefficients in table]
        tables = [_power_sum(table, local[:, None], order) for order in range(highest + 1)]
        # Only the first and the last piece can be bent.
        for k in (0, len(self.pieces) - 1):
            if self.pieces[k].bent:
                here = index == k
                bent = _near_a_bent_end(self.pieces[k], local[here, None], highest)
                for whole, values in zip(tables, bent, strict=True):
                    whole[here] = values
        return tuple(tables)

    def parameter(self, r: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the path's own parameter s since the start of the curve, and ds/dr, both [N]."""
        s, slope, begin = np.zeros_like(r), np.zeros_like(r), 0.0
        index = self._piece_of(r, False)
        for i, piece in enumerate(self.pieces):
            here = index == i
            local = r[here] - self.breaks[i] + piece.limits[0]
            place, slopes = local, 1.0
            if piece.bent:
                x, per_r = piece.from_the_bent_end(local)
                way, rise = (piece.length * _bent_power(x, piece.powers, 1, k) for k in (0, 1))
                place = piece.length - way if piece.bent_at_end else way
                slopes = np.abs(rise * per_r)
            s[here], slope[here] = begin + piece.unit * place, piece.unit * slopes
            begin += piece.unit * piece.length
        return s, slope


def _bent_pieces(pieces: list[CurvePiece], start: int, end: int) -> list[CurvePiece]:
    """Return pieces with bent ends if more derivatives vanish there than a regular path allows.

    docs/theory/path_timing.md, equation (4).
    """
    bent = [replace(pieces[0], order=order).bent for order in (start, end)]
    # A piece has one bent end at most, so a single piece is halved.
    if len(pieces) == 1 and all(bent):
        first = replace(pieces[0], length=pieces[0].length / 2, halved=True)
        second = _shifted(first.coefficients, first.length)
        pieces = [first, replace(first, coefficients=second, halved=False)]
    if bent[0]:
        pieces[0] = replace(pieces[0], order=start)
    if bent[1]:
        last = pieces[-1]
        table = _shifted(last.coefficients, last.length)
        # Powers of the distance from the end: those of odd degree change their sign.
        table[1::2] *= -1.0
        pieces[-1] = replace(last, coefficients=table, order=end, bent_at_end=True)
    return pieces


def vanishing_orders(path: PiecewisePolynomial, s: FloatArray, *, from_left: bool) -> list[int]:
    """Return the number of derivatives that vanish on one side of s [K], up to the degree - 1."""
    # Places all along the path give the magnitude of a derivative, the last ones are those of s.
    places = np.append(np.linspace(path.breaks[0], path.breaks[-1], 21), s)
    curve, orders, vanish = path, np.zeros(s.size, dtype=int), np.ones(s.size, dtype=bool)
    for _ in range(path.coefficients.shape[1] - 2):
        curve = curve.derivative()
        sizes = np.abs(curve(places, from_left=from_left)).max(axis=1)
        vanish &= sizes[-s.size :] <= ROUNDING * max(sizes.max(), TINY)
        orders += vanish
        if not vanish.any():
            break
    return orders.tolist()


def _shifted(table: FloatArray, by: float) -> FloatArray:
    """Return the coefficients of a polynomial in powers about another place (Taylor shift)."""
    place = np.array(by)
    return np.array([_power_sum([*table], place, k) / factorial(k) for k in range(len(table))])


def samples_along(shape: Sequence[FloatArray], rates: Sequence[ArrayLike]) -> MotionSamples:
    """Return the motion of the joints along a path, equation (5) of docs/theory/path_timing.md.

    ``shape`` holds the pose and its three derivatives by the place, each [N,n]; ``rates`` holds the
    three derivatives of the place by time, [N] or numbers. Without the third ones the jerk is zero.
    """
    q, tangent, curvature, *bend = shape
    v, a, *j = (np.reshape(rate, (-1, 1)) for rate in rates)
    qd = tangent * v
    qdd, qddd = tangent * a + curvature * v**2, np.zeros_like(qd)
    if bend and j:
        qddd = tangent * j[0] + 3 * curvature * v * a + bend[0] * v**3
    return MotionSamples(q, qd, qdd, qddd)


# checks and stops of paths ----------------------------------------------------------------------


def straight_path(via_q: ArrayLike) -> PiecewisePolynomial:
    """Return straight lines in joint space through via points [m,n]; s is the distance, rad (m)."""
    via = checks.array("via_q", via_q, (None, None), "rad")
    if via.shape[0] < 2:
        raise InputError(f"via_q must have at least 2 points, not {via.shape[0]}")
    return straight_through(via)


def straight_through(via: FloatArray) -> PiecewisePolynomial:
    """Return straight lines through checked via points [m,n], as :func:`straight_path` does."""
    steps = np.diff(via, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    if np.any(lengths == 0):
        i = int(np.argmax(lengths == 0)) + 1
        raise InputError(f"via points {i} and {i + 1} are the same: no path between them")
    breaks = np.concatenate([[0.0], np.cumsum(lengths)])
    return PiecewisePolynomial(breaks, np.stack([via[:-1], steps / lengths[:, None]], axis=1))


def check_path(family: LimitFamily, path: PiecewisePolynomial) -> FloatArray:
    """Return the stops of a path; raise InputError if no timing of it can be feasible."""
    robot = family.robot
    if path.coefficients.shape[2] != robot.joint_count:
        raise InputError(
            f"path must have {robot.joint_count} joints, not {path.coefficients.shape[2]}"
        )
    if not np.isfinite(path.coefficients).all():
        raise InputError("path must be finite")
    places = path(np.linspace(path.breaks[0], path.breaks[-1], 101))
    check_pace(family, places)
    for joint in np.flatnonzero(locked_joints(family) & (np.ptp(places, axis=0) > 0)):
        raise InputError(
            f"path moves joint {robot.joint_names[joint]!r}, which cannot move: a limit of its "
            "velocity, acceleration or jerk is 0"
        )
    s = np.linspace(path.breaks[:-1], path.breaks[1:], 51, axis=1).ravel()
    check_positions(family, lambda i: f"path at s = {s[i]:g}", path(s, from_left=True))
    between = stops(path, family)
    rests = np.array([path.breaks[0], *between, path.breaks[-1]])
    check_rest(family, lambda i: f"path at s = {rests[i]:g}", path(rests))
    return between


def corners(path: PiecewisePolynomial) -> FloatArray:
    """Find the breaks at which the direction of the path jumps, whatever its parameter.

    If the path rests on one side only, a jump of the tangent counts.
    """
    before, after, _, is_passed = _tangents(path)
    jump = _jump(before, after, np.maximum(_size(before), _size(after)))
    jump = np.where(is_passed, _jump(_directions(before), _directions(after), 1.0), jump)
    rests = ~np.any((before != 0.0) | (after != 0.0), axis=1)
    turns = [bool(rest) and _turns(path, k) for k, rest in enumerate(rests)]
    return path.breaks[1:-1][jump | np.array(turns, dtype=bool)]


def stops(path: PiecewisePolynomial, family: LimitFamily) -> FloatArray:
    """Find the breaks at which the arm has to stop.

    The arm stops at corners. Under limits of the jerk or the torque rate it also stops where the
    curvature jumps: in motion the acceleration would jump with it.
    """
    turns = corners(path)
    if not family.jerk_matters:
        return turns
    curvatures = _along(regular(path, turns), 2)
    bends = _jump(curvatures[-1, :-1], curvatures[0, 1:], np.abs(curvatures).max())
    return np.union1d(turns, path.breaks[1:-1][bends])


def regular(path: PiecewisePolynomial, turns: FloatArray) -> PiecewisePolynomial:
    """Return the path over a parameter of its own, independent of the unit of the given one.

    Between two corners ``turns`` the tangent is continuous, and its largest entry is 1.
    """
    before, after, sizes, is_passed = _tangents(path)
    is_corner = np.isin(path.breaks[1:-1], turns)
    ratios = np.ones(is_corner.size)
    passed = is_passed & ~is_corner
    ratios[passed] = (_size(after) / np.maximum(_size(before), TINY))[passed]
    scales, run = np.ones(sizes.size), np.append(0, np.cumsum(is_corner))
    # Ratios of tangents at passed breaks make the tangent continuous; each run between corners is
    # divided by its largest entry.
    for i in range(run[-1] + 1):
        here = np.flatnonzero(run == i)
        scale = np.cumprod(np.append(1.0, ratios[here[:-1]]))
        scales[here] = scale * ((sizes[here] / scale).max() or 1.0)
    powers = np.arange(path.coefficients.shape[1])[:, None]
    table = path.coefficients / scales[:, None, None] ** powers
    return PiecewisePolynomial(np.append(0.0, np.cumsum(scales * np.diff(path.breaks))), table)


def segments(
    path: PiecewisePolynomial, between: FloatArray, leaves_like: int = 2
) -> list[PathCurve]:
    """Return the curves between stops; an end at rest is left with this power of the parameter."""
    path, own = regular(path, corners(path)), path
    units = np.diff(own.breaks) / np.diff(path.breaks)
    ends = np.searchsorted(own.breaks, [own.breaks[0], *between, own.breaks[-1]])
    return [
        PathCurve.of(
            PiecewisePolynomial(path.breaks[i : j + 1], path.coefficients[i:j]),
            units[i:j],
            leaves_like,
        )
        for i, j in itertools.pairwise(ends)
    ]


def _turns(path: PiecewisePolynomial, k: int) -> bool:
    """Return True if the path rests at the end of piece k and continues in another direction.

    The first non-vanishing derivative on each side has the direction; its sign alternates
    backwards.
    """
    directions = []
    for piece, from_left, sign in ((k + 1, False, 1.0), (k, True, -1.0)):
        ends = slice(piece, piece + 2)
        curve = PiecewisePolynomial(path.breaks[ends], path.coefficients[piece : piece + 1])
        s = path.breaks[k + 1 : k + 2]
        (order,) = vanishing_orders(curve, s, from_left=from_left)
        for _ in range(order + 1):
            curve = curve.derivative()
        directions.append(_directions(sign**order * curve(s, from_left=from_left)))
    return bool(_jump(directions[0], directions[1], 1.0)[0])


def _along(path: PiecewisePolynomial, order: int) -> FloatArray:
    """Return a derivative of the path at 21 places of every piece [21,K,n], with both ends."""
    table, lengths = path.coefficients.swapaxes(0, 1), np.diff(path.breaks)[:, None]
    return np.array([_power_sum(list(table), x * lengths, order) for x in np.linspace(0, 1, 21)])


def _tangents(
    path: PiecewisePolynomial,
) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.bool_]]:
    """Return the tangents on both sides of inner breaks [K-1,n], zero if they vanish.

    Further results are the largest entry in every piece [K], and a mask of breaks that are passed
    in motion.
    """
    tangents = _along(path, 1)
    sizes = np.abs(tangents).max(axis=(0, 2))
    sides = np.stack([tangents[-1, :-1], tangents[0, 1:]])
    around = np.stack([sizes[:-1], sizes[1:]])
    ratios = np.abs(sides).max(axis=2) / np.maximum(around, TINY)
    sides[ratios <= ROUNDING] = 0.0
    return sides[0], sides[1], sizes, (ratios > CORNER_JUMP).all(axis=0)


def _size(vectors: FloatArray) -> FloatArray:
    """Return the largest entry of each vector [K,n]."""
    return np.abs(vectors).max(axis=1)


def _directions(vectors: FloatArray) -> FloatArray:
    return vectors / np.maximum(_size(vectors), TINY)[:, None]


def _jump(before: FloatArray, after: FloatArray, size: ArrayLike) -> NDArray[np.bool_]:
    """Return a mask of breaks [K-1] at which a vector [K-1,n] jumps, relative to a magnitude."""
    return _size(after - before) > CORNER_JUMP * np.asarray(size)
