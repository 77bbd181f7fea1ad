"""The best timing of a given path on a grid by reachability: two passes of small linear programs.

Along a path q(s) the torque is affine in u = s'' and x = s'^2,
``tau = M q' u + (M q'' + C(q, q') q') x + g``. On every interval u is linear from a to b, so that
``x_{i+1} = x_i + d (a + b)``, and may jump at grid points. Each limit is a half plane in (x_i, a)
at the start of an interval and one in (x_{i+1}, b) at its end, and holds in between to second order
in d. The backward pass finds the interval of x_i from which the end can be reached; the forward
pass takes the largest x_{i+1} in it. After Pham and Pham, "A new approach to time-optimal path
parameterization based on reachability analysis", IEEE T-RO 34(3), 2018, who take u constant on
every interval: on a limit that changes along the path that is slower to first order in d.

Both ends share only ``w = x_i + d a = x_{i+1} - d b``: a set of x_{i+1} leads to an interval of w,
and this to one of x_i. Each step eliminates one of two unknowns in closed form (Fourier and
Motzkin). The ranges allowed by one end alone are computed beforehand, for all intervals at once.

Theory: docs/theory/path_timing.md, equations (2) and (3).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import ROUNDING, FloatArray
from microbot_ocp._base.fast_calls import deferred_call
from microbot_ocp.limits import LimitFamily
from microbot_ocp.motion import numbered
from microbot_ocp.planning.path._curve import TINY, PathCurve, samples_along
from microbot_ocp.planning.path._limits import (
    FAR,
    NEGLIGIBLE,
    LimitRows,
    Nodes,
    PathLimits,
    least_bound,
    nodes_of,
    speed_bound,
)
from microbot_ocp.planning.task import DRY, VISCOUS

SETTLED_CHANGE = 1e-4  # relative change of a duration that ends the doubling of the grid


@dataclass(frozen=True, eq=False)
class Reached:
    """Timing of a curve between two stops, on a grid.

    Attributes
    ----------
    s : array [N+1], parameter of the curve
    speed_squared : array [N+1], (ds/dt)^2
    start, end : arrays [N], d2s/dt2 at both ends of every interval; linear in s between them
    t : array [N+1], times, s
    feasible : True if the curve is feasible within the limits
    blocked_at : parameter from which the end cannot be reached, NaN if feasible
    """

    s: FloatArray
    speed_squared: FloatArray
    start: FloatArray
    end: FloatArray
    t: FloatArray
    feasible: bool
    blocked_at: float

    @property
    def duration(self) -> float:
        """Duration, s."""
        return float(self.t[-1])

    def smoothed(self, curve: PathCurve, other: PathCurve, rise: float, count: int) -> Reached:
        """Return a timing with accelerations smoothed over ``rise`` s, in another path parameter.

        The distance covered is averaged over a window of that length, so that a start like t^2
        becomes one like t^3. Each piece has ``count`` intervals; the window is at least one of
        them.
        """
        grid = path_grid(other, self.s.size)
        steps = np.linalg.norm(np.diff(other.evaluate(grid)[0], axis=0), axis=1)
        ways = np.append(0.0, np.cumsum(steps))
        way = np.interp(curve.parameter(self.s)[0], other.parameter(grid)[0], ways)
        lasts = self.duration
        width = max(rise, lasts / (count * len(other.pieces)))
        # Moving average by the integral of the distance: (A(t) - A(t - width)) / width.
        area = np.append(0.0, np.cumsum(0.5 * np.diff(self.t) * (way[1:] + way[:-1])))

        def sum_until(t: FloatArray) -> FloatArray:
            return np.interp(t, self.t, area) + way[-1] * np.maximum(t - lasts, 0.0)

        dense = np.union1d(self.t, self.t + width)
        mean = (sum_until(dense) - sum_until(dense - width)) / width
        edges = np.interp(np.interp(other.breaks, grid, ways), mean, dense)
        shares = np.linspace(0.0, 1.0, count + 1)[:-1]
        t = np.append((edges[:-1, None] + np.diff(edges)[:, None] * shares).ravel(), edges[-1])
        s = np.interp(np.interp(t, dense, mean), ways, grid)
        s[::count] = other.breaks
        x = np.square(np.gradient(s, t))
        x[[0, -1]] = np.where([other.start_free, other.end_free], x[[0, -1]], 0.0)
        # dx/ds = 2 s'': a constant s'' in each interval follows from x at its ends.
        change = 0.5 * np.diff(x) / np.diff(s)
        return replace(self, s=s, speed_squared=x, start=change, end=change, t=t - t[0])

    def inside(self, i: np.ndarray, share: FloatArray) -> tuple[FloatArray, ...]:
        """Return s, ds/dt and d2s/dt2 at a share of the length of intervals i."""
        d = np.diff(self.s)[i]
        way, rise = share * d, self.end[i] - self.start[i]
        # Integral of dx/ds = 2 s'' with s'' linear from a to b: x_i + 2 a l + (b - a) l^2 / d.
        x = self.speed_squared[i] + way * (2.0 * self.start[i] + rise * share)
        return self.s[i] + way, np.sqrt(np.maximum(x, 0.0)), self.start[i] + rise * share

    def after(self, i: np.ndarray, time: FloatArray) -> tuple[FloatArray, ...]:
        """Return s, ds/dt and d2s/dt2 at times after the start of intervals i.

        In s, the motion s'' = a + k (s - s_i) is a hyperbolic (k > 0) or circular (k < 0) function
        of time.
        """
        a, v = self.start[i], np.sqrt(self.speed_squared[i])
        k = (self.end[i] - a) / np.diff(self.s)[i]
        # The solution of s'' = a + k s is v sinh(r t) / r + a (cosh(r t) - 1) / k with r = sqrt(k).
        # The half-angle form cosh(r t) - 1 = 2 sinh(r t / 2)^2 keeps a small k accurate.
        whole, half = (_sinh_over(k * (f * time) ** 2) for f in (1.0, 0.5))
        way = time * (v * whole + 0.5 * a * time * half**2)
        cosh = 1.0 + 0.5 * k * (time * half) ** 2
        return self.s[i] + way, v * cosh + a * time * whole, a + k * way


def harmonic(s: FloatArray, lasts: float) -> Reached:
    """Return the timing ``1 - cos(pi t / T)`` of the parameter on a grid, whatever the limits."""
    way = (s - s[0]) / (s[-1] - s[0])
    unit = (np.pi / lasts) ** 2 * (s[-1] - s[0])
    rise = unit * (0.5 - way)
    t = lasts / np.pi * np.arccos(1.0 - 2.0 * way)
    x = unit * (s[-1] - s[0]) * way * (1.0 - way)
    return Reached(s, x, rise[:-1], rise[1:], t, True, float("nan"))


def _sinh_over(z: FloatArray) -> FloatArray:
    """Return sinh(r)/r for r = sqrt(z), or sin(r)/r for negative z."""
    r = np.sqrt(np.abs(z))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(r > 0, np.where(z > 0, np.sinh(r), np.sin(r)) / r, 1.0)


# Places of an interval at which limits are checked, shares.
CHECKED_SHARES = (1e-6, 0.25, 0.5, 0.75, 1.0 - 1e-6)


@dataclass(frozen=True, eq=False)
class CurveLimits:
    """Grid, nodes and limits of a curve, for the passes."""

    curve: PathCurve
    fast: bool  # use compiled functions
    s: FloatArray
    nodes: Nodes
    limits: PathLimits
    rows: LimitRows
    has_friction: bool  # True if a limited torque contains friction

    @classmethod
    def of(
        cls, family: LimitFamily, curve: PathCurve, grid: int | FloatArray, fast: bool
    ) -> CurveLimits:
        """Return the limits of a curve on a grid of about so many intervals, or on given points."""
        s = path_grid(curve, grid) if isinstance(grid, int) else grid
        nodes = nodes_of(curve, s)
        limits = PathLimits.of(family, nodes, fast)
        sizes = [family.robot.friction_of(kind) for kind in (VISCOUS, DRY)]
        has_friction = "tau" in limits.half_planes and bool(np.any(sizes))
        return cls(curve, fast, s, nodes, limits, LimitRows.of(nodes, limits), has_friction)

    @property
    def speed_limit(self) -> FloatArray:
        """Largest x [N+1] within the velocity limits at the grid points."""
        return least_bound(self.limits.speed, self.nodes, self.s.size)

    def steady_speed(self) -> FloatArray:
        """Return the speed s' [N+1] up to which further limits hold without s'' and s'''.

        Limits of joints do not count, only expressions that the passes cannot keep.
        """
        family = self.limits.family
        keys = [key for key in self.limits.later if family[key].limit is not None]
        bounds = {key: speed_bound(family, key, self.nodes) for key in keys}
        return np.sqrt(least_bound(bounds, self.nodes, self.s.size))

    def excess(self, timing: Reached) -> FloatArray:
        """Return the largest relative excess [N] over these limits inside every interval."""
        family, worst = self.limits.family, np.full(self.s.size - 1, -1.0)
        i = np.arange(worst.size)
        for share in CHECKED_SHARES:
            r, v, u = timing.inside(i, np.full(i.size, share))
            samples = samples_along(self.curve.evaluate(r), (v, u))
            keys = [*self.limits.half_planes, *self.limits.speed]
            for key, values in family.values(samples, keys).items():
                worst = np.maximum(worst, family[key].use(values).max(axis=1) - 1.0)
        return worst


FRICTION_PASSES = 6  # largest number of linearisations of friction


def reach(
    along: CurveLimits,
    *,
    start_free: bool | None = None,
    end_free: bool | None = None,
    fastest: float | FloatArray = np.inf,
    ends: tuple[float, float] = (0.0, 0.0),
) -> Reached:
    """Find the best timing of a curve on its grid, from rest to rest or with ds/dt at its ends.

    docs/theory/path_timing.md, "Reachability". ``fastest`` [N+1] bounds ds/dt further.
    ``start_free`` and ``end_free`` leave ds/dt free at an end; the default is True for a vanishing
    tangent, because the arm rests there at any ds/dt. Friction depends on the root of x and is
    linearised around the last timing.
    """
    free = (
        along.curve.start_free if start_free is None else start_free,
        along.curve.end_free if end_free is None else end_free,
    )
    speed_limit = np.minimum(along.speed_limit, fastest**2)
    timing = _passes(along, along.rows, speed_limit, free, ends)
    x, before = timing.speed_squared, timing.duration
    for _ in range(FRICTION_PASSES if along.has_friction and timing.feasible else 0):
        if deadline.over():
            break
        bent = along.rows.with_friction(along.nodes, along.limits.family.robot, x)
        timing = _passes(along, bent, speed_limit, free, ends)
        if not timing.feasible:  # at this speed friction alone exceeds the limits
            x = 0.25 * x
            continue
        if abs(timing.duration - before) < 0.01 * SETTLED_CHANGE * timing.duration:
            break
        x, before = timing.speed_squared, timing.duration
    return timing


EVEN_SHARE = 0.1  # share of a piece that is divided evenly


def path_grid(path: PathCurve, count: int) -> FloatArray:
    """Return a grid [N+1] of about ``count`` intervals that includes the breaks of the path.

    The grid is denser near breaks, where inertias often vanish and the curvature jumps.
    """
    lengths = np.diff(path.breaks)
    shares = np.maximum(2, np.round(count * lengths / lengths.sum()).astype(int))
    i, k = numbered(shares)
    n = shares[i]
    dense = 0.5 * (1.0 - np.cos(np.pi * k / n))
    grid = path.breaks[i] + lengths[i] * (EVEN_SHARE * k / n + (1.0 - EVEN_SHARE) * dense)
    return np.append(grid, path.breaks[-1])


FREE_SPEEDS = 1001  # number of free initial speeds that are compared
COMPARED_INTERVALS = 8  # number of intervals over which free initial speeds are compared


def _passes(
    along: CurveLimits,
    rows: LimitRows,
    speed_limit: FloatArray,
    free: tuple[bool, bool],
    ends: tuple[float, float],
) -> Reached:
    s, fast = along.s, along.fast
    begins, finishes = (speed**2 for speed in ends)
    step = np.diff(s)
    steps, width = step[:, None], rows.per_u.shape[1]
    table = np.hstack([rows.per_u, rows.per_x, rows.lower, rows.upper])
    at_ends = deferred_call(_at_ends(width), compiled=fast)
    left, right, x_range, y_range = at_ends(table[: step.size], table[rows.right], steps)
    # Ranges of x at each end, and of w, that the limits of one end allow alone.
    size = 6 * width
    least, most = np.zeros(s.size), speed_limit.copy()
    in_range = deferred_call(_range(size, False), size, compiled=fast)
    for limits, widest, at in ((left, x_range, slice(-1)), (right, y_range, slice(1, None))):
        widest[:, 1] = np.minimum(widest[:, 1], speed_limit[at])
        low, high = in_range(widest, limits, steps)[0].T
        least[at], most[at] = np.maximum(least[at], low), np.minimum(most[at], high)
    widest = np.tile([-FAR, FAR], (step.size, 1))
    w = deferred_call(_range(size, True), size, compiled=fast)(widest, right, steps)[0]
    end = np.array([least[-1], most[-1]])
    if not free[1]:
        end = np.array([max(end[0], finishes), min(max(end[1], 0.0), finishes)])
    # Backward: sets[i] is the interval of x_i from which x_{i+1} in sets[i+1] is reachable.
    bounds = np.column_stack([least[:-1], most[:-1], w])
    backward = deferred_call(_backward(size), kept=True, compiled=fast)
    sets = backward(end, *(table[::-1] for table in (left, right, steps, bounds)))
    low, high = np.vstack([sets[::-1], end]).T
    if not free[0]:
        low[0], high[0] = max(low[0], begins), min(high[0], begins)
    blocked = np.flatnonzero(high < low)
    nothing = np.zeros_like(step)
    if blocked.size:
        unknown, at = np.full_like(s, np.nan), float(s[blocked[-1]])
        return Reached(s, np.zeros_like(s), nothing, nothing, unknown, False, at)
    intervals = left, right, steps, np.column_stack([low[1:], high[1:]])
    first = max(high[0], 0.0)
    if free[0]:  # a large x_0 may forbid larger ones soon after, a small one loses time at once
        tried = [np.linspace(low[0], high[0], FREE_SPEEDS)]
        onward = deferred_call(_onward(size), compiled=fast)
        for interval in zip(*(table[:COMPARED_INTERVALS] for table in intervals), strict=True):
            tried.append(onward(tried[-1][:, None], *interval)[:, 0])
        v = np.sqrt(tried)
        spent = step[: len(v) - 1, None] / np.maximum(v[1:] + v[:-1], TINY)
        first = tried[0][np.argmin(spent.sum(axis=0))]
    after, u = deferred_call(_forward(size), kept=True, compiled=fast)([first], *intervals)
    x, (start, finish) = np.append(first, after[:, 0]), u.T
    t = np.append(0.0, np.cumsum(_durations(x, step, start, finish)))
    # An interval with x = 0 at both ends takes infinite time: the path is blocked there.
    stuck = np.flatnonzero(~np.isfinite(t))
    return Reached(
        s, x, start, finish, t, not stuck.size, float(s[stuck[0] - 1]) if stuck.size else np.nan
    )


def _durations(x: FloatArray, step: FloatArray, start: FloatArray, end: FloatArray) -> FloatArray:
    """Return the durations [N] of intervals, s'' = a + k (s - s_i); infinite if x stays zero.

    With v = s' at both ends, ``w (s_1 - s_0) / (v_0 + v_1)`` is the hyperbolic (k > 0) or circular
    tangent of half the angle ``w t``, w = sqrt|k|.
    """
    k = (end - start) / step
    with np.errstate(divide="ignore", invalid="ignore"):
        steady = 2.0 * step / (np.sqrt(x[:-1]) + np.sqrt(x[1:]))
        w = np.sqrt(np.abs(k))
        half = 0.5 * w * steady
        bent = 2.0 / w * np.where(k > 0, np.arctanh(half), np.arctan(half))
    return np.where(k == 0, steady, bent)


# Smallest magnitude of a divisor, relative to its terms: half of the digits are left.
LEAST_DIVISOR = float(np.sqrt(np.finfo(float).eps))


class _Lines(NamedTuple):
    """Bounds of one unknown, given another: their slope, and upper and lower intercepts [R]."""

    slope: ca.SX
    top: ca.SX
    bottom: ca.SX

    @classmethod
    def of(cls, table: ca.SX) -> _Lines:
        """Return the lines in a column written by :func:`_at_ends`."""
        third = table.numel() // 3
        return cls(*(table[k * third : (k + 1) * third] for k in range(3)))

    def reached(self, way: ca.SX) -> _Lines:
        """Return bounds of ``w = x + way u`` given x, from these bounds of u."""
        one, other = way * self.top, way * self.bottom
        return _Lines(1.0 + way * self.slope, ca.fmax(one, other), ca.fmin(one, other))

    def moved(self, way: ca.SX) -> _Lines:
        """Return bounds of x given ``w = x + way u``, from these bounds of u."""
        ratio = 1.0 + way * self.slope
        # A slope near -1 / way makes x unbounded; the guard keeps the quotient finite.
        tiny = LEAST_DIVISOR * (1.0 + ca.fabs(way * self.slope))
        ratio = 1.0 / ca.if_else(ca.fabs(ratio) <= tiny, tiny, ratio)
        one, other = -way * ratio * self.top, -way * ratio * self.bottom
        return _Lines(ratio, ca.fmax(one, other), ca.fmin(one, other))

    def between(self, low: ca.SX, high: ca.SX, least: Any, most: Any) -> tuple[ca.SX, ca.SX]:
        """Return the least and the largest value allowed anywhere from low to high."""
        one, other = self.slope * low, self.slope * high
        return (
            ca.mmax(ca.vertcat(least, ca.fmin(one, other) + self.bottom)),
            ca.mmin(ca.vertcat(most, ca.fmax(one, other) + self.top)),
        )

    def narrowed(self, least: ca.SX, most: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return bounds of x moved towards those that leave a u, by a step of Newton's method.

        The range of u that x leaves is a concave, piecewise linear function of x. From outside,
        zeros of its tangents reach its end in at most one step per each of its 2 R lines.
        """
        bounds = []
        for x, side in ((least, 1.0), (most, -1.0)):
            above, rise = _lowest(x, self.slope, self.top)
            below, fall = _lowest(x, -self.slope, -self.bottom)
            # At x the range of u has the length room + opening * x, on the two active lines.
            room, opening = above + below, rise + fall
            slack = ROUNDING * (1.0 + ca.fabs(above) + ca.fabs(below))
            missing = -room - opening * x
            nearer = ca.if_else(missing > slack, side * FAR, x)  # infeasible: no x leaves a u
            nearer = ca.if_else(side * opening > 0.0, -room / opening, nearer)
            bounds.append(ca.if_else(missing > 0.0, side * ca.fmax(side * x, side * nearer), x))
        return bounds[0], bounds[1]


def _lowest(x: ca.SX, slope: ca.SX, intercept: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return intercept and slope of the lowest line at x."""
    best, rise, lowest = ca.SX(FAR), ca.SX(0), ca.SX(FAR)
    for s, b in zip(ca.vertsplit(slope), ca.vertsplit(intercept), strict=True):
        value = s * x + b
        best, rise = (ca.if_else(value < lowest, new, old) for new, old in ((b, best), (s, rise)))
        lowest = ca.fmin(lowest, value)
    return best, rise


def _function(name: str, given: list[ca.SX], results: list[ca.SX]) -> ca.Function:
    return ca.Function(f"reach_{name}_{given[1].numel() // 3}", given, ca.cse(results))


# Relative change of an inertia in an interval up to which limits of one end suffice.
SAME_INERTIA = 0.1


@lru_cache(maxsize=32)
def _at_ends(width: int) -> ca.Function:
    """Return the function of bounds of u at both ends of an interval, and of ranges of x.

    Bounds of u are :class:`_Lines`; the ranges of x come from limits without u. If the inertia
    changes much in the interval, limits of the other end count as well: the product of inertia and
    u, both linear, is far from linear between the ends, and an inertia that vanishes at one end
    would leave u free there.
    """
    ends, step = [ca.SX.sym(name, 4 * width) for name in ("left", "right")], ca.SX.sym("step")
    rows = [[end[k * width : (k + 1) * width] for k in range(4)] for end in ends]
    sizes = [ca.fabs(row[0]) for row in rows]
    unlike = ca.fabs(rows[1][0] - rows[0][0]) > SAME_INERTIA * ca.fmax(*sizes)
    counts = ca.vertcat(ca.SX.ones(width), unlike)
    lines, ranges = [], []
    for pair in (rows, rows[::-1]):
        m, c, *bounds = (ca.vertcat(*both) for both in zip(*pair, strict=True))
        # m and c are the coefficients of u and x. A row without u bounds x alone.
        flat = ca.fabs(m) <= NEGLIGIBLE * (ca.fabs(m) + step * ca.fabs(c))
        alone = ca.logic_and(ca.logic_and(counts, flat), c != 0.0)
        matters = ca.logic_and(counts, ca.logic_not(flat))
        one, other = (b / ca.if_else(matters, m, ca.if_else(alone, c, 1.0)) for b in bounds)
        low, high = ca.fmin(one, other), ca.fmax(one, other)
        slope = -c / ca.if_else(matters, m, 1.0)
        parts = ((slope, 0.0), (high, ca.inf), (low, -ca.inf))
        lines.append(ca.vertcat(*(ca.if_else(matters, part, none) for part, none in parts)))
        least = ca.mmax(ca.vertcat(0.0, ca.if_else(alone, low, 0.0)))
        most = ca.mmin(ca.vertcat(FAR, ca.if_else(alone, high, FAR)))
        ranges.append(ca.vertcat(least, most))
    results: Any = ca.cse([*lines, *ranges])
    return ca.Function(f"reach_ends_{width}", [*ends, step], results)


@lru_cache(maxsize=32)
def _range(size: int, on_way: bool) -> ca.Function:
    """Return a Newton step towards the range of x allowed at one end, or of w at the other."""
    x, table, step = ca.SX.sym("x", 2), ca.SX.sym("limits", size), ca.SX.sym("step")
    lines = _Lines.of(table)
    lines = lines.moved(-step) if on_way else lines
    narrower = ca.vertcat(*lines.narrowed(x[0], x[1]))
    going = ca.sum1(narrower != x) > 0
    name = "way_range" if on_way else "range"
    return _function(name, [x, table, step], [narrower, going])


@lru_cache(maxsize=32)
def _backward(size: int) -> ca.Function:
    """Return a step of the backward pass: the x_i from which the set of x_{i+1} is reachable.

    docs/theory/path_timing.md, "Reachability".
    """
    target, bounds, step = ca.SX.sym("target", 2), ca.SX.sym("bounds", 4), ca.SX.sym("step")
    left, right = ca.SX.sym("left", size), ca.SX.sym("right", size)
    y, x, w = ca.vertsplit(target), *ca.vertsplit(bounds, 2)
    w = _Lines.of(right).reached(-step).between(y[0], y[1], w[0], w[1])
    x = _Lines.of(left).moved(step).between(w[0], w[1], x[0], x[1])
    empty = ca.SX(0)
    for low, high in (y, w, x):
        crossed = high < low - ROUNDING * (1.0 + ca.fabs(low))
        empty = ca.logic_or(empty, crossed)
    # Crossed ends mark an empty set, which the next step keeps empty.
    result = ca.if_else(empty, ca.vertcat(1.0, -1.0), ca.vertcat(*x))
    return _function("back", [target, left, right, step, bounds], [result])


def _following(size: int) -> tuple[list[ca.SX], ca.SX]:
    """Return the arguments of a forward step and the largest x_{i+1} that x_i allows."""
    x, bounds, step = ca.SX.sym("x"), ca.SX.sym("bounds", 2), ca.SX.sym("step")
    left, right = ca.SX.sym("left", size), ca.SX.sym("right", size)
    w = _Lines.of(left).reached(step).between(x, x, -FAR, FAR)
    most = _Lines.of(right).moved(-step).between(*w, -FAR, bounds[1])[1]
    return [x, left, right, step, bounds], ca.fmax(most, ca.fmax(bounds[0], 0.0))


@lru_cache(maxsize=32)
def _onward(size: int) -> ca.Function:
    """Return a step of the forward pass that compares free initial speeds."""
    given, y = _following(size)
    return _function("onward", given, [y])


@lru_cache(maxsize=32)
def _forward(size: int) -> ca.Function:
    """Return a step of the forward pass: the largest x_{i+1} that x_i allows, and u at both ends.

    Both u are equal to their mean if the limits allow it, otherwise one is on a limit.
    """
    given, y = _following(size)
    x, left, right, step, _ = given
    ranges = []
    for lines, at in ((_Lines.of(left), x), (_Lines.of(right), y)):
        slack = ROUNDING * (1.0 + ca.fabs(lines.slope * at))
        wider = _Lines(lines.slope, lines.top + slack, lines.bottom - slack)
        ranges.append(wider.between(at, at, -FAR, FAR))
    (low, high), (end_low, end_high) = ranges
    # The step x_{i+1} = x_i + d (a + b) fixes the sum of both u.
    both = (y - x) / step
    most, least = ca.fmin(high, both - end_low), ca.fmax(low, both - end_high)
    start = ca.fmax(ca.fmin(0.5 * both, most), least)
    end = both - start
    # Between positive ends x has a minimum if u changes its sign; it must not be negative.
    dips = ca.logic_and(ca.logic_and(start < 0, end > 0), x * (end - start) < start**2 * step)
    u = ca.if_else(dips, 0.5 * both, ca.vertcat(start, end))
    return _function("on", given, [y, u])
