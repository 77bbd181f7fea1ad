"""The best timing of a given path on a grid, by reachability: two passes of small linear programs.

Along a path q(s) the torque is affine in u = s'' and x = s'^2,
``tau = M q' u + (M q'' + C(q, q') q') x + g``, so on a grid with u constant over every interval
(x_{i+1} = x_i + 2 d u) each limit is a half plane in (x_i, x_{i+1}). Backward, the set of x_i from
which the end can be reached is an interval; forward, the largest x_{i+1} in it is taken. Source:
Pham and Pham, "A new approach to time-optimal path parameterization based on reachability
analysis", IEEE T-RO 34(3), 2018; limits are kept at both ends of every interval.

The linear programs (two variables) are solved by cutting planes inside one CasADi function mapped
along the grid.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.codegen import maybe_compiled
from microbot_ocp._base.fast_calls import FastCall, buffered_call
from microbot_ocp.limits import LimitFamily
from microbot_ocp.planning._curve import Curve
from microbot_ocp.planning._path_limits import FAR, LimitRows, Nodes, PathLimits, nodes_of

PENALTY = 1e6  # of leaving the feasible set, in the search for its best point
CUTS = 14  # cutting planes of each linear program
ROUNDING = 1e-9
VISCOUS_PASSES = 6  # linearisations of viscous friction, which goes with the root of x


@dataclass(frozen=True, eq=False)
class Reached:
    """Timing of a curve between two stops, on a grid.

    Attributes
    ----------
    s : array [N+1], parameter of the curve
    speed_squared : array [N+1], (ds/dt)^2
    t : array [N+1], times, s
    feasible : whether the curve can be travelled within the limits at all
    blocked_at : parameter from which the end cannot be reached, NaN where feasible
    """

    s: FloatArray
    speed_squared: FloatArray
    t: FloatArray
    feasible: bool
    blocked_at: float

    @property
    def duration(self) -> float:
        """Time from end to end, s."""
        return float(self.t[-1])


@dataclass(frozen=True, eq=False)
class CurveLimits:
    """What the passes need of a curve: its grid, its nodes, its limits at them."""

    s: FloatArray
    nodes: Nodes
    limits: PathLimits
    rows: LimitRows
    viscous: FloatArray

    @classmethod
    def of(cls, family: LimitFamily, curve: Curve, grid: int, fast: bool) -> CurveLimits:
        """Limits of a curve on a grid of about so many intervals."""
        s = path_grid(curve, grid)
        nodes = nodes_of(curve, s)
        limits = PathLimits.of(family, nodes, fast)
        viscous = np.zeros(family.robot.joint_count)
        if "tau" in limits.half_planes:
            viscous = np.array([link.viscous_friction for link in family.robot.links])
        return cls(s, nodes, limits, LimitRows.of(nodes, limits), viscous)


def reach(
    along: CurveLimits,
    *,
    start_free: bool,
    end_free: bool,
    fast: bool,
) -> Reached:
    """Best timing of a curve on its grid, from rest to rest.

    ``start_free`` and ``end_free`` leave ds/dt free at an end where the tangent vanishes, as the
    arm rests there all the same. Viscous friction goes with the root of x and is linearised around
    the timing found last.
    """
    s, free = along.s, (start_free, end_free)
    step = np.diff(s)
    speed_limit = along.limits.speed_limit(along.nodes, s.size)
    timing = _passes(s, along.rows, step, speed_limit, free, fast)
    for _ in range(VISCOUS_PASSES - 1 if along.viscous.any() else 0):
        if not timing.feasible:
            break
        bent = along.rows.with_viscous(along.nodes, along.viscous, timing.speed_squared)
        timing = _passes(s, bent, step, speed_limit, free, fast)
    return timing


def path_grid(path: Curve, count: int) -> FloatArray:
    """Grid [N+1] of about ``count`` intervals with the breaks of the path among its points."""
    lengths = np.diff(path.breaks)
    shares = np.maximum(2, np.round(count * lengths / lengths.sum()).astype(int))
    pieces = [
        np.linspace(a, b, n, endpoint=False)
        for a, b, n in zip(path.breaks[:-1], path.breaks[1:], shares, strict=True)
    ]
    return np.append(np.concatenate(pieces), path.breaks[-1])


@dataclass(frozen=True, eq=False)
class _Lines:
    """Half planes solved for one variable: at most / at least intercept + slope * other."""

    upper: tuple[FloatArray, FloatArray]
    lower: tuple[FloatArray, FloatArray]
    other_low: FloatArray
    other_high: FloatArray


def _lines(p: FloatArray, q: FloatArray, h: FloatArray) -> _Lines:
    """Solve ``p v + q w <= h`` for v; what does not bound v bounds w."""
    h = np.clip(h, -FAR, FAR)
    size = np.abs(p) + np.abs(q)
    flat = np.abs(p) <= 1e-12 * size
    safe = np.where(flat, 1.0, p)
    intercept, slope = h / safe, -q / safe
    above, below = ~flat & (p > 0), ~flat & (p < 0)
    none = h >= FAR
    upper = tuple(np.where(above & ~none, v, f) for v, f in ((intercept, FAR), (slope, 0.0)))
    lower = tuple(np.where(below & ~none, v, f) for v, f in ((intercept, -FAR), (slope, 0.0)))
    safe = np.where(q == 0, 1.0, q)
    bound = h / safe
    high = np.where(flat & (q > 0), bound, FAR).min(axis=1, initial=FAR)
    low = np.where(flat & (q < 0), bound, -FAR).max(axis=1, initial=-FAR)
    return _Lines((upper[0], upper[1]), (lower[0], lower[1]), low, high)


def _passes(
    s: FloatArray,
    rows: LimitRows,
    step: FloatArray,
    speed_limit: FloatArray,
    free: tuple[bool, bool],
    fast: bool,
) -> Reached:
    p, q, h = rows.half_planes(step)
    n, width = p.shape
    back = _lines(p, q, h)
    end = np.array([0.0, speed_limit[-1] if free[1] else 0.0])
    columns = np.vstack(
        [
            *(part.T for part in (*back.upper, *back.lower)),
            back.other_low,
            back.other_high,
            speed_limit[:-1],
        ]
    )
    sets = _backward(width, n, fast)(end, columns[:, ::-1])[:, ::-1]
    low, high = np.append(sets[0], end[0]), np.append(sets[1], end[1])
    if not free[0]:
        high[0] = min(high[0], 0.0) if high[0] < 0 or low[0] > 0 else 0.0
    blocked = np.flatnonzero(high < low)
    if blocked.size or (not free[0] and low[0] > 0):
        at = s[blocked[-1]] if blocked.size else s[0]
        nothing = np.zeros_like(s)
        return Reached(s, nothing, np.full_like(s, np.nan), False, float(at))
    ahead = _lines(q, p, h)
    columns = np.vstack([*(part.T for part in ahead.upper), low[1:], high[1:]])
    first = _free_start(ahead, low, high) if free[0] else high[0]
    forward = _forward(width, n, fast)(first, columns).ravel()
    x = np.maximum(np.append(first, forward), 0.0)
    root = np.sqrt(x)
    with np.errstate(divide="ignore"):
        duration = 2.0 * step / (root[:-1] + root[1:])
    t = np.append(0.0, np.cumsum(duration))
    stuck = np.flatnonzero(~np.isfinite(duration))
    if stuck.size:
        return Reached(s, x, t, False, float(s[stuck[0]]))
    return Reached(s, x, t, True, float("nan"))


def _free_start(ahead: _Lines, low: FloatArray, high: FloatArray) -> float:
    """The x_0 that lets x_1 be largest: where the inertia vanishes the largest x_0 does not."""
    tried = np.linspace(low[0], high[0], 2001)
    intercept, slope = (part[0][:, None] for part in ahead.upper)
    reached = np.minimum((intercept + slope * tried).min(axis=0), high[1])
    return float(tried[np.flatnonzero(reached >= reached.max() * (1 - 1e-9))[-1]])


@lru_cache(maxsize=32)
def _backward(width: int, count: int, fast: bool) -> FastCall:
    """Backward pass over ``count`` intervals: sets of x_i from which the end can be reached."""
    target = ca.MX.sym("target", 2)
    column = ca.MX.sym("column", 4 * width + 3)
    top, top_slope, bottom, bottom_slope = ca.vertsplit(column[: 4 * width], width)
    y_low = ca.fmax(column[4 * width], target[0])
    y_high = ca.fmin(column[4 * width + 1], target[1])
    zero = ca.MX(0)
    top, top_slope = ca.vertcat(top, column[4 * width + 2]), ca.vertcat(top_slope, zero)
    bottom, bottom_slope = ca.vertcat(bottom, zero), ca.vertcat(bottom_slope, zero)
    size = width + 1
    largest, room = _best(size, top, top_slope, bottom, bottom_slope, y_low, y_high)
    smallest, _ = _best(size, -bottom, -bottom_slope, -top, -top_slope, y_low, y_high)
    # an empty set is passed on as one with its ends crossed
    crossed = y_high < y_low - ROUNDING * (1.0 + ca.fabs(y_low))
    empty = ca.logic_or(crossed, room < -ROUNDING * (1.0 + ca.fabs(largest)))
    result = ca.vertcat(
        ca.if_else(empty, 1.0, ca.fmax(-smallest, 0.0)), ca.if_else(empty, -1.0, largest)
    )
    step = ca.Function(f"reach_backward_{width}", [target, column], [result])
    return buffered_call(maybe_compiled(step, fast).mapaccum(count))


@lru_cache(maxsize=32)
def _forward(width: int, count: int, fast: bool) -> FastCall:
    """Forward pass over ``count`` intervals: the largest x_{i+1} in its set that x_i allows."""
    x = ca.SX.sym("x")
    column = ca.SX.sym("column", 2 * width + 2)
    intercept, slope = column[:width], column[width : 2 * width]
    largest = ca.fmin(column[2 * width + 1], ca.mmin(intercept + slope * x))
    result = ca.fmax(largest, column[2 * width])
    step = ca.Function(f"reach_forward_{width}", [x, column], [result])
    return buffered_call(maybe_compiled(step, fast).mapaccum(count))


def _best(
    width: int,
    top: ca.MX,
    top_slope: ca.MX,
    bottom: ca.MX,
    bottom_slope: ca.MX,
    y_low: ca.MX,
    y_high: ca.MX,
) -> tuple[ca.MX, ca.MX]:
    """Largest v with ``lower(y) <= v <= upper(y)`` for a y in [y_low, y_high], and the room left.

    The penalised upper envelope is concave and piecewise linear in y: its maximum is enclosed by
    the tangents at two points and found in finitely many cuts.
    """
    envelope, cut = _cutting_plane(width)
    lines = ca.vertcat(top, top_slope, bottom, bottom_slope)
    left = envelope(y_low, lines)
    right = envelope(ca.fmax(y_high, y_low), lines)
    for _ in range(CUTS):
        left, right = cut(left, right, lines)
    left_wins = left[1] > right[1]
    return ca.if_else(left_wins, left[3], right[3]), ca.if_else(left_wins, left[4], right[4])


@lru_cache(maxsize=32)
def _cutting_plane(width: int) -> tuple[ca.Function, ca.Function]:
    """Envelope at a point, one cut of the bracket; a point is (y, value, slope, top, room)."""
    lines, y = ca.SX.sym("lines", 4 * width), ca.SX.sym("y")
    top, top_slope, bottom, bottom_slope = (
        ca.vertsplit(part) for part in ca.vertsplit(lines, width)
    )
    highest, slope_there = top[0] + top_slope[0] * y, top_slope[0]
    lowest, slope_below = bottom[0] + bottom_slope[0] * y, bottom_slope[0]
    for j in range(1, width):
        value = top[j] + top_slope[j] * y
        slope_there = ca.if_else(value < highest, top_slope[j], slope_there)
        highest = ca.fmin(highest, value)
        value = bottom[j] + bottom_slope[j] * y
        slope_below = ca.if_else(value > lowest, bottom_slope[j], slope_below)
        lowest = ca.fmax(lowest, value)
    room = highest - lowest
    penalty = ca.if_else(room < 0, PENALTY, 0.0)
    point = ca.vertcat(
        y,
        highest + penalty * room,
        slope_there + penalty * (slope_there - slope_below),
        highest,
        room,
    )
    envelope = ca.Function(f"reach_envelope_{width}", [y, lines], [point])
    left, right = ca.SX.sym("left", 5), ca.SX.sym("right", 5)
    meeting = (right[1] - left[1] + left[2] * left[0] - right[2] * right[0]) / (left[2] - right[2])
    inside = ca.logic_and(left[2] > 0, right[2] < 0)
    tried = ca.if_else(inside, meeting, ca.if_else(left[2] > 0, right[0], left[0]))
    middle = envelope(ca.fmin(ca.fmax(tried, left[0]), right[0]), lines)
    rising = middle[2] > 0
    cut = ca.Function(
        f"reach_cut_{width}",
        [left, right, lines],
        [ca.if_else(rising, middle, left), ca.if_else(rising, right, middle)],
    )
    return envelope, cut
