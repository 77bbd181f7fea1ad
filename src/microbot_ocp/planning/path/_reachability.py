"""The best timing of a given path on a grid, by reachability: two passes of small linear programs.

Along a path q(s) the torque is affine in u = s'' and x = s'^2,
``tau = M q' u + (M q'' + C(q, q') q') x + g``. On every interval u runs linearly from a to b, so
that ``x_{i+1} = x_i + d (a + b)``, and may jump at the grid points: each limit is a half plane in
(x_i, a) at the start of an interval and one in (x_{i+1}, b) at its end, and between them it is kept
to second order in d. Backward, the set of x_i from which the end can be reached is an interval;
forward, the largest x_{i+1} in it is taken. After Pham and Pham, "A new approach to time-optimal
path parameterization based on reachability analysis", IEEE T-RO 34(3), 2018, where u is constant on
every interval: riding a limit that changes along the path, that is slower to first order in d.

For a given x_{i+1} the limits at the end bound ``x_{i+1} - d b``, from above and below by piecewise
linear functions, and those at the start then bound x_i. Its extremes are found by cutting planes
inside one CasADi function mapped along the grid.

Theory: docs/theory/path_timing.md, equations (2) and (3).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import casadi as ca
import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.codegen import maybe_compiled
from microbot_ocp._base.fast_calls import FastCall, buffered_call
from microbot_ocp.limits import LimitFamily, MotionSamples
from microbot_ocp.planning.path._curve import PathCurve
from microbot_ocp.planning.path._limits import (
    FAR,
    LimitRows,
    Nodes,
    PathLimits,
    least_bound,
    nodes_of,
    speed_bound,
)


@dataclass(frozen=True)
class ReachabilitySettings:
    """Settings of the passes.

    Attributes
    ----------
    penalty : of leaving the feasible set, in the search for its best point
    cuts : cutting planes of each linear program
    rounding : relative violation of a limit that is none
    friction_passes : linearisations of friction, which goes with the root of x, at most
    settled : relative change of a duration that ends the doubling of the grid
    most_grids, most_points : grids at most, and points above which there is no finer one
    most_settling : points above which the duration alone asks for no finer grid
    shortest, shortest_ratio : s, and ratio to the duration: the least interval that is halved
    places : shares of an interval at which limits are looked at
    alike : relative change of an inertia along an interval up to which one end stands for it
    steep : least relative size of a coefficient that is divided by
    flat : relative size of a coefficient that counts as zero
    starts, starts_over : free starts that are compared, and intervals over which they are
    tiny : of a speed: what is divided by in the place of zero
    short : of k t^2, below which a series replaces sinh and sin
    """

    penalty: float = 1e6
    cuts: int = 14
    rounding: float = 1e-9
    friction_passes: int = 6
    settled: float = 1e-4
    most_grids: int = 9
    most_points: int = 40_000
    most_settling: int = 8000
    shortest: float = 2e-5
    shortest_ratio: float = 1e-4
    places: tuple[float, ...] = (1e-6, 0.25, 0.5, 0.75, 1.0 - 1e-6)
    alike: float = 0.1
    steep: float = 1e-8
    flat: float = 1e-12
    starts: int = 1001
    starts_over: int = 8
    tiny: float = 1e-30
    short: float = 1e-4


REACHABILITY = ReachabilitySettings()
NESTED = {"base": 4}  # a chain of 1000 is made in 5 ms, with CasADi's 10 in 50 ms


@dataclass(frozen=True, eq=False)
class Reached:
    """Timing of a curve between two stops, on a grid.

    Attributes
    ----------
    s : array [N+1], parameter of the curve
    speed_squared : array [N+1], (ds/dt)^2
    start, end : arrays [N], d2s/dt2 at both ends of every interval; linear in s between them
    t : array [N+1], times, s
    feasible : whether the curve can be travelled within the limits at all
    blocked_at : parameter from which the end cannot be reached, NaN where feasible
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
        """Time from end to end, s."""
        return float(self.t[-1])

    def smoothed(self, curve: PathCurve, other: PathCurve, rise: float, count: int) -> Reached:
        """Smooth the accelerations over ``rise`` s, for another parameter of the path.

        The way travelled is the mean of those within that time, so that the arm leaves like t^3
        where it did like t^2; at so many times on each piece, but no finer than these.
        """
        grid = path_grid(other, self.s.size)
        steps = np.linalg.norm(np.diff(other.evaluate(grid)[0], axis=0), axis=1)
        ways = np.append(0.0, np.cumsum(steps))
        way = np.interp(curve.parameter(self.s)[0], other.parameter(grid)[0], ways)
        lasts = self.duration
        width = max(rise, lasts / (count * len(other.pieces)))
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
        change = 0.5 * np.diff(x) / np.diff(s)
        return replace(self, s=s, speed_squared=x, start=change, end=change, t=t - t[0])

    def inside(self, i: np.ndarray, share: FloatArray) -> tuple[FloatArray, ...]:
        """Give s, ds/dt and d2s/dt2 a share of the way through intervals i."""
        d = np.diff(self.s)[i]
        way, rise = share * d, self.end[i] - self.start[i]
        x = self.speed_squared[i] + way * (2.0 * self.start[i] + rise * share)
        return self.s[i] + way, np.sqrt(np.maximum(x, 0.0)), self.start[i] + rise * share

    def after(self, i: np.ndarray, time: FloatArray) -> tuple[FloatArray, ...]:
        """Give s, ds/dt, d2s/dt2 at times since the start of intervals i: s'' = a + k (s - s_i)."""
        a, v = self.start[i], np.sqrt(self.speed_squared[i])
        k = (self.end[i] - a) / np.diff(self.s)[i]
        whole, half = (_sinh_over(k * (f * time) ** 2) for f in (1.0, 0.5))
        way = time * (v * whole + 0.5 * a * time * half**2)
        cosh = 1.0 + 0.5 * k * (time * half) ** 2
        return self.s[i] + way, v * cosh + a * time * whole, a + k * way


def harmonic(s: FloatArray, lasts: float) -> Reached:
    """Give a timing without regard to limits, ``1 - cos(pi t / T)`` in the parameter, on a grid."""
    way = (s - s[0]) / (s[-1] - s[0])
    unit = (np.pi / lasts) ** 2 * (s[-1] - s[0])
    rise = unit * (0.5 - way)
    t = lasts / np.pi * np.arccos(1.0 - 2.0 * way)
    x = unit * (s[-1] - s[0]) * way * (1.0 - way)
    return Reached(s, x, rise[:-1], rise[1:], t, True, float("nan"))


def _sinh_over(z: FloatArray) -> FloatArray:
    """Give sinh(r)/r of r = sqrt(z); sin where z is negative."""
    r = np.sqrt(np.abs(z))
    with np.errstate(divide="ignore", invalid="ignore"):
        far = np.where(z > 0, np.sinh(r), np.sin(r)) / r
    return np.where(r**2 < REACHABILITY.short, 1.0 + z / 6.0 * (1.0 + z / 20.0), far)


@dataclass(frozen=True, eq=False)
class CurveLimits:
    """What the passes need of a curve: its grid, its nodes, its limits at them."""

    s: FloatArray
    nodes: Nodes
    limits: PathLimits
    rows: LimitRows
    has_friction: bool  # whether a torque that is limited has friction in it

    @classmethod
    def of(
        cls, family: LimitFamily, curve: PathCurve, grid: int | FloatArray, fast: bool
    ) -> CurveLimits:
        """Give limits of a curve on a grid of about so many intervals, or on given points."""
        s = path_grid(curve, grid) if isinstance(grid, int) else grid
        nodes = nodes_of(curve, s)
        limits = PathLimits.of(family, nodes, fast)
        has_friction = "tau" in limits.half_planes and any(
            link.viscous_friction or link.coulomb_friction for link in family.robot.links
        )
        return cls(s, nodes, limits, LimitRows.of(nodes, limits), has_friction)

    def steady_speed(self) -> FloatArray:
        """Give the speed s' [N+1] up to which further limits are kept without s'' and s'''.

        Those that the passes cannot keep, limits of the joints aside.
        """
        family = self.limits.family
        keys = [key for key in self.limits.later if family[key].limit is not None]
        bounds = {key: speed_bound(family, key, self.nodes) for key in keys}
        return np.sqrt(least_bound(bounds, self.nodes, self.s.size))

    def excess(self, timing: Reached, curve: PathCurve) -> FloatArray:
        """Give the largest relative excess [N] over any of these limits inside every interval."""
        family, worst = self.limits.family, np.full(self.s.size - 1, -1.0)
        i = np.arange(worst.size)
        for share in REACHABILITY.places:
            r, v, u = timing.inside(i, np.full(i.size, share))
            q, tangent, curvature = curve.evaluate(r)
            v, u = v[:, None], u[:, None]
            qdd = tangent * u + curvature * v**2
            samples = MotionSamples(q, tangent * v, qdd, np.zeros_like(q))
            keys = [*self.limits.half_planes, *self.limits.speed]
            for key, values in family.values(samples, keys).items():
                worst = np.maximum(worst, family[key].use(values).max(axis=1) - 1.0)
        return worst


def reach(
    along: CurveLimits,
    *,
    start_free: bool,
    end_free: bool,
    fast: bool,
    fastest: float | FloatArray = np.inf,
    ends: tuple[float, float] = (0.0, 0.0),
) -> Reached:
    """Find the best timing of a curve on its grid, from rest to rest or with ds/dt at its ends.

    With ds/dt at most ``fastest`` [N+1]; docs/theory/path_timing.md, "Reachability".

    ``start_free`` and ``end_free`` leave ds/dt free at an end where the tangent vanishes, as the
    arm rests there all the same. Friction goes with the root of x and is linearised around the
    timing found last.
    """
    free = (start_free, end_free)
    speed_limit = np.minimum(along.limits.speed_limit(along.nodes, along.s.size), fastest**2)
    timing = _passes(along.s, along.rows, speed_limit, free, fast, ends)
    x, before = timing.speed_squared, timing.duration
    for _ in range(REACHABILITY.friction_passes if along.has_friction and timing.feasible else 0):
        if deadline.over():
            break
        bent = along.rows.with_friction(along.nodes, along.limits.family.robot, x)
        timing = _passes(along.s, bent, speed_limit, free, fast, ends)
        if not timing.feasible:  # at a speed at which friction alone takes more than the limits
            x = 0.25 * x
            continue
        if abs(timing.duration - before) < 0.01 * REACHABILITY.settled * timing.duration:
            break
        x, before = timing.speed_squared, timing.duration
    return timing


def settled(
    family: LimitFamily,
    curve: PathCurve,
    grid: int,
    tolerance: float,
    fast: bool,
    most: int = REACHABILITY.most_grids,
) -> tuple[Reached, CurveLimits, float]:
    """Refine the grid of a timing until its duration settles and limits hold in between.

    ``grid`` is the number of intervals to begin with, ``tolerance`` the largest relative excess
    over a limit inside an interval, ``most`` the number of grids. The last number returned is what
    the excess is in the end.
    """
    s, duration = path_grid(curve, grid), np.inf
    for last in range(most - 1, -1, -1):
        along = CurveLimits.of(family, curve, s, fast)
        timing = reach(along, start_free=curve.start_free, end_free=curve.end_free, fast=fast)
        if not timing.feasible:
            return timing, along, np.inf
        excess = along.excess(timing, curve)
        apart = abs(timing.duration - duration) > REACHABILITY.settled * timing.duration
        cut = (excess > tolerance) | (apart and s.size <= REACHABILITY.most_settling)
        cut &= np.diff(timing.t) > min(
            REACHABILITY.shortest, REACHABILITY.shortest_ratio * timing.duration
        )
        if not cut.any() or not last or s.size > REACHABILITY.most_points or deadline.over():
            break
        duration = timing.duration
        s = np.sort(np.concatenate([s, (0.5 * (s[1:] + s[:-1]))[cut]]))
    return timing, along, float(excess.max())


def path_grid(path: PathCurve, count: int) -> FloatArray:
    """Make a grid [N+1] of about ``count`` intervals with the breaks of the path among its points.

    Near them it is finer: inertias vanish there often, and the curvature jumps.
    """
    lengths = np.diff(path.breaks)
    shares = np.maximum(2, np.round(count * lengths / lengths.sum()).astype(int))
    pieces = [
        a + (b - a) * (0.1 * np.arange(n) / n + 0.45 * (1.0 - np.cos(np.pi * np.arange(n) / n)))
        for a, b, n in zip(path.breaks[:-1], path.breaks[1:], shares, strict=True)
    ]
    return np.append(np.concatenate(pieces), path.breaks[-1])


@dataclass(frozen=True, eq=False)
class _Ends:
    """Limits at one end of every interval, ``low <= m u + c x <= high`` with m >= 0, each [N,W]."""

    m: FloatArray
    c: FloatArray
    low: FloatArray
    high: FloatArray
    step: FloatArray  # [N,1]

    @classmethod
    def of(cls, rows: LimitRows, at: np.ndarray, other: np.ndarray, step: FloatArray) -> _Ends:
        """Give limits at one end; where the inertia changes much, those at the other, too.

        There the product of inertia and u, both linear, is far from linear between the ends, and
        an inertia that vanishes at one of them would leave u free.
        """
        m, c, low, high = (
            np.hstack([a[at], a[other]]) for a in (rows.per_u, rows.per_x, rows.lower, rows.upper)
        )
        here, there = np.hsplit(m, 2)
        alike = np.abs(there - here) <= REACHABILITY.alike * np.maximum(np.abs(here), np.abs(there))
        none = np.zeros_like(alike)
        left_out = np.hstack([none, alike])
        low, high = np.where(left_out, -np.inf, low), np.where(left_out, np.inf, high)
        turned = m < 0
        low, high = np.where(turned, -high, low), np.where(turned, -low, high)
        return cls(np.abs(m), np.where(turned, -c, c), low, high, step[:, None])

    def speeds(self) -> tuple[FloatArray, FloatArray]:
        """Give the smallest and largest x [N] that leave a u within all limits."""
        half = self.m.shape[1] // 2
        least, most = _speeds(*(a[:, :half] for a in (self.m, self.c, self.low, self.high)))
        which = np.flatnonzero(np.isfinite(self.high[:, half:]).any(axis=1))
        if which.size:
            speeds = _speeds(*(a[which] for a in (self.m, self.c, self.low, self.high)))
            least[which] = np.maximum(least[which], speeds[0])
            most[which] = np.minimum(most[which], speeds[1])
        return least, most

    @property
    def flat(self) -> np.ndarray:
        return self.m <= REACHABILITY.flat * (self.m + self.step * np.abs(self.c))

    def lines(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Give the slope in x, and the largest and smallest u at x = 0 [N,R]."""
        m = np.where(self.flat, 1.0, self.m)
        slope = np.where(self.flat, 0.0, -self.c / m)
        sides = ((FAR, self.high), (-FAR, self.low))
        most, least = (np.where(self.flat, far, bound / m) for far, bound in sides)
        return slope, np.clip(most, -FAR, FAR), np.clip(least, -FAR, FAR)

    def moved(self, way: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Bound x by the same limits given ``w = x + way d u``: ratio of w, and intercepts.

        With ``e = m - way d c``, ``e x`` lies between ``m w - way d high`` and ``m w - way d low``:
        where the ratio m/e is positive x is at most ``ratio w + top``, with the w at most that the
        others allow, and at least ``ratio w + bottom``, with the least w; where it is negative the
        other way round.
        """
        moved = way * self.step
        e = self.m - moved * self.c
        # not so small that intercepts reach FAR: there they say that there is no limit
        tiny = REACHABILITY.steep * (self.m + np.abs(moved * self.c))
        none = tiny == 0.0
        e = np.where(np.abs(e) <= tiny, np.where(none, 1.0, tiny), e)
        one, other = -moved * self.low / e, -moved * self.high / e
        top = np.where(none, FAR, np.maximum(one, other))
        bottom = np.where(none, -FAR, np.minimum(one, other))
        return np.where(none, 0.0, self.m / e), np.clip(top, -FAR, FAR), np.clip(bottom, -FAR, FAR)


def _speeds(
    m: FloatArray, c: FloatArray, low: FloatArray, high: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Give the least and largest x with a u of at most (high - c x)/m, at least that of another."""
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = m[:, None, :] * c[:, :, None] - m[:, :, None] * c[:, None, :]
        bound = m[:, None, :] * high[:, :, None] - m[:, :, None] * low[:, None, :]
        flat = m <= REACHABILITY.flat * (m + np.abs(c))
        alone = [np.where(flat, values, np.inf) for values in (high, -low)]
        slope = np.hstack([slope.reshape(len(m), -1), c, -c])
        bound = np.hstack([bound.reshape(len(m), -1), *alone])
        limit = np.nan_to_num(bound / slope, nan=np.inf, posinf=np.inf, neginf=-np.inf)
    open_ = ~np.isfinite(bound) | (slope == 0)
    most = np.where(open_ | (slope < 0), FAR, limit).min(axis=1, initial=FAR)
    return np.where(open_ | (slope > 0), 0.0, limit).max(axis=1, initial=0.0), most


def _reached_from(ends: _Ends, way: float) -> FloatArray:
    """Give lines of the extremes of ``w = x + way d u`` in x [N,3R]: slope, top, bottom."""
    slope, most, least = ends.lines()
    step = way * ends.step
    sides = (most, least) if way > 0 else (least, most)
    top, bottom = (
        np.where(np.abs(side) >= FAR, far, step * side)
        for side, far in zip(sides, (FAR, -FAR), strict=True)
    )
    return np.hstack([1.0 + step * slope, top, bottom])


def _passes(
    s: FloatArray,
    rows: LimitRows,
    speed_limit: FloatArray,
    free: tuple[bool, bool],
    fast: bool,
    ends: tuple[float, float],
) -> Reached:
    begins, finishes = (speed**2 for speed in ends)
    step = np.diff(s)
    n, width = step.size, 2 * rows.per_u.shape[1]
    left = _Ends.of(rows, rows.left, rows.right, step)
    right = _Ends.of(rows, rows.right, rows.left, step)
    (least, most), (before, over) = left.speeds(), right.speeds()
    least = np.maximum(np.append(least, 0.0), np.append(0.0, before))
    most = np.minimum(np.append(most, FAR), np.append(FAR, over))
    most = np.minimum(most, speed_limit)
    end = np.array([least[-1], most[-1]])
    if not free[1]:
        end = np.array([max(end[0], finishes), min(max(end[1], 0.0), finishes)])
    columns = np.hstack(
        [_reached_from(right, -1.0), *left.moved(1.0), least[:-1, None], most[:-1, None]]
    )
    sets = _backward(width, n, fast)(end, columns[::-1].T)[:, ::-1]
    low, high = np.append(sets[0], end[0]), np.append(sets[1], end[1])
    if not free[0]:
        low[0], high[0] = max(low[0], begins), min(high[0], begins)
    blocked = np.flatnonzero(high < low)
    nothing = np.zeros_like(step)
    if blocked.size:
        unknown, at = np.full_like(s, np.nan), float(s[blocked[-1]])
        return Reached(s, np.zeros_like(s), nothing, nothing, unknown, False, at)
    columns = np.hstack(
        [_reached_from(left, 1.0), *right.moved(-1.0)[:2], low[1:, None], high[1:, None]]
    ).T
    forward = _forward(width, n, fast)
    first = high[0]
    if free[0]:  # the largest x_0 may bar larger ones soon after, a small one loses time at once
        tried, onward = [np.linspace(low[0], high[0], REACHABILITY.starts)], _onward(width, fast)
        for column in columns.T[: REACHABILITY.starts_over]:
            tried.append(onward(tried[-1][None], column).ravel())
        v = np.sqrt(np.maximum(tried, 0.0))
        spent = (step[: len(v) - 1, None] / np.maximum(v[1:] + v[:-1], REACHABILITY.tiny)).sum(
            axis=0
        )
        first = tried[0][np.argmin(spent)]
    x = np.maximum(np.append(first, forward(first, columns).ravel()), 0.0)
    start, finish = _accelerations(x, step, left, right)
    t = np.append(0.0, np.cumsum(_durations(x, step, start, finish)))
    stuck = np.flatnonzero(~np.isfinite(t))
    return Reached(
        s, x, start, finish, t, not stuck.size, float(s[stuck[0] - 1]) if stuck.size else np.nan
    )


def _accelerations(
    x: FloatArray, step: FloatArray, left: _Ends, right: _Ends
) -> tuple[FloatArray, FloatArray]:
    """Give u at both ends of the intervals: their mean where limits allow it, else at a limit."""
    bounds = []
    for ends, at in ((left, x[:-1, None]), (right, x[1:, None])):
        slope, most, least = ends.lines()
        slack = REACHABILITY.rounding * (1.0 + np.abs(slope * at))
        bounds.append(
            (
                (least + slope * at - slack).max(axis=1, initial=-FAR),
                (most + slope * at + slack).min(axis=1, initial=FAR),
            )
        )
    (low, high), (end_low, end_high) = bounds
    both = np.diff(x) / step
    most, least = np.minimum(high, both - end_low), np.maximum(low, both - end_high)
    start = np.maximum(np.minimum(0.5 * both, most), least)
    end = both - start
    # x must not dip below zero on the way
    with np.errstate(divide="ignore", invalid="ignore"):
        dip = (start < 0) & (end > 0) & (x[:-1] * (end - start) < start**2 * step)
    return np.where(dip, 0.5 * both, start), np.where(dip, 0.5 * both, end)


def _durations(x: FloatArray, step: FloatArray, start: FloatArray, end: FloatArray) -> FloatArray:
    """Give the times [N] of the intervals, s'' = a + k (s - s_i); infinite where x stays zero."""
    k, v0, v1 = (end - start) / step, np.sqrt(x[:-1]), np.sqrt(x[1:])
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        usual = 2.0 * step / (v0 + v1)
        w = np.sqrt(np.abs(k))
        # u and w s' turn by the angle w t, hyperbolically where k is positive
        grown, shrunk = (end + w * v1, start + w * v0), (end - w * v1, start - w * v0)
        larger = np.abs(grown[0]) + np.abs(grown[1]) > np.abs(shrunk[0]) + np.abs(shrunk[1])
        hyperbolic = np.where(larger, np.log(grown[0] / grown[1]), -np.log(shrunk[0] / shrunk[1]))
        circular = np.arctan2(start * w * v1 * -1.0 + end * w * v0, start * end + w * v0 * w * v1)
        exact = np.where(k > 0, hyperbolic, np.abs(circular)) / w
        series = usual * (1.0 + k * usual**2 / 12.0)
        return np.where(np.abs(k) * usual**2 < REACHABILITY.short, series, exact)


@lru_cache(maxsize=32)
def _backward(width: int, count: int, fast: bool) -> FastCall:
    """Make the backward pass: sets of x_i from which the end can be reached.

    docs/theory/path_timing.md, "Reachability".
    """
    target = ca.MX.sym("target", 2)
    column = ca.MX.sym("column", 6 * width + 2)
    lines, (v_low, v_high) = column[: 6 * width], ca.vertsplit(column[6 * width :])
    after = lines[: 3 * width]
    ratio, top, bottom = (lines[k * width : (k + 1) * width] for k in (3, 4, 5))
    largest, room = _best(width, ca.vertcat(after, ratio, top, bottom, v_low, v_high), target)
    mirrored = ca.vertcat(after, -ratio, -bottom, -top, -v_high, -v_low)
    smallest, _ = _best(width, mirrored, target)
    # an empty set is passed on as one with its ends crossed
    crossed = target[1] < target[0] - REACHABILITY.rounding * (1.0 + ca.fabs(target[0]))
    empty = ca.logic_or(crossed, room < -REACHABILITY.rounding * (1.0 + ca.fabs(largest)))
    result = ca.vertcat(
        ca.if_else(empty, 1.0, ca.fmax(-smallest, 0.0)), ca.if_else(empty, -1.0, largest)
    )
    step = ca.Function(f"reach_back_{width}", [target, column], [result])
    return buffered_call(maybe_compiled(step, fast).mapaccum(count, NESTED))


@lru_cache(maxsize=32)
def _forward(width: int, count: int, fast: bool) -> FastCall:
    """Make the forward pass: every x from the first one and the columns."""
    return buffered_call(_step(width, fast).mapaccum(count, NESTED))


@lru_cache(maxsize=32)
def _onward(width: int, fast: bool) -> FastCall:
    """Make one interval of the forward pass from all starts that are tried, and its column."""
    return buffered_call(_step(width, fast).map("onward", "serial", REACHABILITY.starts, [1], []))


def _step(width: int, fast: bool) -> ca.Function:
    """Give the largest x_{i+1} in its set that x_i allows."""
    x = ca.SX.sym("x")
    column = ca.SX.sym("column", 5 * width + 2)
    slope, high, low, ratio, top = (column[k * width : (k + 1) * width] for k in range(5))
    largest = column[5 * width + 1]
    if width:
        w_high, w_low = ca.mmin(slope * x + high), ca.mmax(slope * x + low)
        largest = ca.fmin(largest, ca.mmin(ratio * ca.if_else(ratio > 0, w_high, w_low) + top))
    result = ca.fmax(largest, column[5 * width])
    return maybe_compiled(ca.Function(f"reach_on_{width}", [x, column], [result]), fast)


def _best(width: int, lines: ca.MX, target: ca.MX) -> tuple[ca.MX, ca.MX]:
    """Give the largest v that some y in the target allows, and the room that is left to it.

    The penalised upper envelope is concave and piecewise linear in y: its maximum is enclosed by
    the tangents at two points and found in finitely many cuts.
    """
    envelope, cut = _cutting_plane(width)
    left = envelope(target[0], lines)
    right = envelope(ca.fmax(target[1], target[0]), lines)
    for _ in range(REACHABILITY.cuts):
        left, right = cut(left, right, lines)
    left_wins = left[1] > right[1]
    return ca.if_else(left_wins, left[3], right[3]), ca.if_else(left_wins, left[4], right[4])


@lru_cache(maxsize=32)
def _cutting_plane(width: int) -> tuple[ca.Function, ca.Function]:
    """Make the envelope at a point, a cut of the bracket; a point: y, value, slope, top, room."""
    lines, y = ca.SX.sym("lines", 6 * width + 2), ca.SX.sym("y")
    parts = [ca.vertsplit(lines[k * width : (k + 1) * width]) if width else [] for k in range(6)]

    def extreme(sign: float, values: list[tuple[ca.SX, ca.SX]]) -> tuple[ca.SX, ca.SX]:
        """Give the least (the largest, where sign is -1) of values with their slopes in y."""
        best, slope = values[0]
        for value, other in values[1:]:
            slope = ca.if_else(sign * value < sign * best, other, slope)
            best = ca.fmin(best, value) if sign > 0 else ca.fmax(best, value)
        return best, slope

    slope, w_top, w_bottom, ratio, top, bottom = parts
    zero = ca.SX(0)
    none = [(ca.SX(0), zero)]
    high = extreme(1.0, [(k * y + h, k) for k, h in zip(slope, w_top, strict=True)] or none)
    low = extreme(-1.0, [(k * y + h, k) for k, h in zip(slope, w_bottom, strict=True)] or none)
    above, below = [(lines[6 * width + 1], zero)], [(lines[6 * width], zero)]
    for k, most, least in zip(ratio, top, bottom, strict=True):
        for (value, tangent), bound, side in (
            ([ca.if_else(k > 0, p, q) for p, q in zip(high, low, strict=True)], most, above),
            ([ca.if_else(k > 0, q, p) for p, q in zip(high, low, strict=True)], least, below),
        ):
            side.append((k * value + bound, k * tangent))
    highest, slope_there = extreme(1.0, above)
    lowest, slope_below = extreme(-1.0, below)
    room = highest - lowest
    penalty = ca.if_else(room < 0, REACHABILITY.penalty, 0.0)
    point = ca.vertcat(
        y,
        highest + penalty * room,
        slope_there + penalty * (slope_there - slope_below),
        highest,
        room,
    )
    envelope = ca.Function(f"reach_curve_{width}", [y, lines], [point])
    left, right = ca.SX.sym("left", 5), ca.SX.sym("right", 5)
    meeting = (right[1] - left[1] + left[2] * left[0] - right[2] * right[0]) / (left[2] - right[2])
    inside = ca.logic_and(left[2] > 0, right[2] < 0)
    tried = ca.if_else(inside, meeting, ca.if_else(left[2] > 0, right[0], left[0]))
    middle = envelope(ca.fmin(ca.fmax(tried, left[0]), right[0]), lines)
    rising = middle[2] > 0
    cut = ca.Function(
        f"reach_halve_{width}",
        [left, right, lines],
        [ca.if_else(rising, middle, left), ca.if_else(rising, right, middle)],
    )
    return envelope, cut
