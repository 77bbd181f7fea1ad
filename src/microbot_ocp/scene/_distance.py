"""Distance of a segment from a convex body, as an expression that a solver can follow.

Half the square of the distance of a point from a convex body has the slope x - p with the point p
of the body that is nearest to x. Along a segment it is convex, so bisection of its slope finds the
nearest place; the last step is a secant, which carries the derivatives of that place along. Where a
segment lies flat on a face the nearest place is not unique: a small parabola about the middle is
added, which makes it so. The value is at most the distance, and at contact at most a quarter of
``rounding`` smaller.
"""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca

BISECTIONS = 8  # to a 256th of the segment, before the secant

PointFunction = Callable[[ca.SX], ca.SX]
TINY = 1e-20


def segment_to_body(
    away: PointFunction,
    depth: PointFunction | None,
    start: ca.SX,
    end: ca.SX,
    rounding: ca.SX,
    contact: ca.SX,
) -> ca.SX:
    """Return the distance of a segment from a convex body.

    Parameters
    ----------
    away : callable
        Point [3] -> the point less the nearest one of the body, [3].
    depth : callable or None
        Point [3] -> minus its depth inside the body, anything positive outside; None for a body
        without an inside.
    start, end : expression [3]
    rounding, contact : expression
        m, above 0; and the distance that matters most.
    """
    along, parabola = end - start, 2.0 * rounding * contact

    def slope(t: ca.SX) -> ca.SX:
        return ca.dot(away(start + t * along), along) + parabola * (t - 0.5)

    t = _least(slope)
    point = start + t * along
    square = ca.sumsqr(away(point)) + parabola * ((t - 0.5) ** 2 - 0.25)
    outside = ca.sqrt(ca.fmax(square, TINY))
    return outside if depth is None else outside + ca.fmin(depth(point), 0.0)


def segment_to_function(
    distance: Callable[[ca.SX, ca.SX], ca.SX],
    numbers: ca.SX,
    start: ca.SX,
    end: ca.SX,
    rounding: ca.SX,
) -> ca.SX:
    """Return least value along a segment of a convex function of a point with continuous slopes.

    ``distance`` is a function of the point [3] and of ``numbers``.
    """
    t, bow, given = ca.SX.sym("t"), ca.SX.sym("bow"), ca.SX.sym("given", numbers.shape[0])
    first, last = ca.SX.sym("first", 3), ca.SX.sym("last", 3)
    value = distance(first + t * (last - first), given) + bow * ((t - 0.5) ** 2 - 0.25)
    both = ca.Function("along", [t, first, last, given, bow], [value, ca.gradient(value, t)])
    rest = start, end, numbers, rounding
    return both(_least(lambda t: both(t, *rest)[1]), *rest)[0]


def _least(slope: PointFunction) -> ca.SX:
    """Give where from 0 to 1 a convex function of this slope is least: bisection, then a secant."""
    low, high = ca.SX(0.0), ca.SX(1.0)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        falls = slope(middle) < 0
        low, high = ca.if_else(falls, middle, low), ca.if_else(falls, high, middle)
    before, after = slope(low), slope(high)
    share = -before / ca.fmax(after - before, TINY)
    return low + (high - low) * ca.fmin(ca.fmax(share, 0.0), 1.0)


def segment_to_plane(start_height: ca.SX, end_height: ca.SX, rounding: ca.SX) -> ca.SX:
    """Return the least height of a segment whose ends have these heights over a plane."""
    rise = end_height - start_height
    t = ca.fmin(ca.fmax(0.5 - rise / (2.0 * rounding), 0.0), 1.0)
    return start_height + t * rise + rounding * ((t - 0.5) ** 2 - 0.25)


def from_segment(point: ca.SX, start: ca.SX, end: ca.SX) -> ca.SX:
    """Return a point [3] less the nearest one of the segment between two others."""
    along = end - start
    share = ca.dot(point - start, along) / ca.fmax(ca.sumsqr(along), TINY)
    return point - start - ca.fmin(ca.fmax(share, 0.0), 1.0) * along


def length(vector: ca.SX) -> ca.SX:
    """Return the norm with a slope of zero at zero."""
    return ca.sqrt(ca.fmax(ca.sumsqr(vector), TINY))
