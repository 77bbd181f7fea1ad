"""The best timing of a curve under limits of the torque rate and the jerk, from reachability's.

Along a path q(s) torques and accelerations are affine in s'' and s'^2, and their rates are products
of s', s'', s''' with coefficients that depend on s alone. So the mesh points are places on the
path, where all coefficients are numbers before the solver starts, and the unknowns are s', s'' and
the time that each interval takes, in which s''' changes evenly. No dynamics are evaluated inside
the solver. The mesh becomes finer until all limits hold between its points and the duration no
longer changes. After Debrouwere et al., "Time-optimal path following for robots with convex-concave
constraints using sequential convex programming", IEEE T-RO 29(6), 2013, with the time of every
interval as an unknown: near a stop s' is no smooth function of s.

Dry friction turns over within 0.02 rad/s, and a tight limit of the torque rate may leave no start
near that: where the program fails, or leaps over the place, friction turns more gently in a first
one, and from program to program faster.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.codegen import maybe_compiled
from microbot_ocp._base.fast_calls import buffered_call
from microbot_ocp.limits import LimitFamily, MotionSamples
from microbot_ocp.ocp.solution import Attempt, StepProgress, gap_of
from microbot_ocp.ocp.solvers import SolverSettings, status_of
from microbot_ocp.ocp.transcription import Bounds
from microbot_ocp.planning._curve import Curve
from microbot_ocp.planning._friction import dry_friction
from microbot_ocp.planning._path_limits import FAR, PathLimits, nodes_of
from microbot_ocp.planning._rate_program import PARTS, THIRDS, program_of
from microbot_ocp.planning._reachability import Reached
from microbot_ocp.planning._task import CHECKS_PER_INTERVAL
from microbot_ocp.robot import COULOMB_SMOOTHING, Robot, torque_and_rate

RATES = ("taud", "qddd")  # keys of limits that are kept here
BARRIERS = (1e-3, 1e-7)  # of a first solve and of one from a coarser mesh
# In turn: without pivots factors are cheap, but their rounding may hide negative curvature
LINEAR_SOLVERS = ("ldl", "mumps")
SMOOTHED_BARRIER = 1e-3  # of one from dry friction that turns less suddenly
MOST_MESHES = 10
# Percentile of the accelerations at which joints turn back, as the start has it; factor from one
# smoothing of dry friction to the next, and the least that is tried where the solver fails
USUAL, SHARPER, LEAST_SHARPER = 90, 2.0, 1.08
LEAPT = 0.1  # excess of a limit from which a profile is taken to leap over such a place
TURNED = 2.0  # smoothings: velocity at which the friction has all but turned
STEP, MOST_PARTS = 0.7, 8  # change of velocity in an interval within it; parts of one interval
AIMED = 0.5  # of the accepted excess, which falls with the third power of the intervals
SUDDEN = 0.5  # excess of a part by that of the whole from which more parts are needed at once
# Share of the losses at jumps of s''' that the next mesh goes for: a tenth of all intervals; change
# of the duration from mesh to mesh that ends it
MOST_LOSS, SETTLED = 0.8, 5e-5


@dataclass(frozen=True, eq=False)
class Profile:
    """How a curve is travelled: its speed s' and s'' at places s; s''' is linear in between.

    Attributes
    ----------
    s, v, a, t : arrays [N+1]
        Places, s', s'', and the times at which they are passed, s.
    d : array [N]
        By how much s''' changes within each interval.
    gap : float
        How much longer it takes than the local optimum, at most, s.
    attempts : tuple of Attempt
        Solves that led to it.
    """

    s: FloatArray
    v: FloatArray
    a: FloatArray
    t: FloatArray
    d: FloatArray
    gap: float = float("nan")
    attempts: tuple[Attempt, ...] = ()

    @property
    def duration(self) -> float:
        """Time from end to end, s."""
        return float(self.t[-1])

    @property
    def solved(self) -> bool:
        """Whether the last solve converged."""
        return bool(self.attempts) and self.attempts[-1].status.solved

    def inside(self, i: np.ndarray, after: FloatArray) -> tuple[FloatArray, ...]:
        """The parameter and its three derivatives at times since the start of intervals i."""
        h, a, d = np.diff(self.t)[i], self.a[i], self.d[i]
        j, k = (self.a[i + 1] - a) / h - 0.5 * d, after * d / h
        v = self.v[i] + after * (a + after * (j / 2.0 + k / 6.0))
        s = self.s[i] + after * (self.v[i] + after * (a / 2.0 + after * (j / 6.0 + k / 24.0)))
        return np.clip(s, self.s[i], self.s[i + 1]), v, a + after * (j + k / 2.0), j + k

    def at_times(self, t: FloatArray) -> Profile:
        """The same motion with more mesh points, at times among which are those that it has."""
        i = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, self.t.size - 2)
        s, v, a, _ = self.inside(i, t - self.t[i])
        own = np.searchsorted(t, self.t)
        s[own], v[own], a[own] = self.s, self.v, self.a
        d = (self.d / np.diff(self.t))[i[:-1]] * np.diff(t)
        return replace(self, s=s, v=v, a=a, t=t, d=d)


def first_profile(timing: Reached) -> Profile:
    """A timing with a continuous acceleration of the parameter."""
    v, rise = np.sqrt(timing.speed_squared), timing.start
    a = 0.5 * (np.append(rise, rise[-1]) + np.append(rise[0], rise))
    return Profile(timing.s, v, a, timing.t, np.zeros_like(rise))


def with_rates(
    family: LimitFamily,
    curve: Curve,
    start: Profile,
    tolerance: float,
    fast: bool,
    progress: StepProgress,
) -> Profile:
    """The fastest profile of a curve, on a mesh that is refined until all limits hold inside.

    Parameters
    ----------
    family : LimitFamily
    curve : Curve
    start : Profile
    tolerance : float
        Largest relative excess of a limit between mesh points.
    fast : bool
        Whether functions are compiled.
    progress : callable
    """
    found = _Timing(family, curve, start, fast).solved(BARRIERS[0])
    excess = _excess(family, curve, found)
    smoothing = _first_smoothing(family, curve, start)
    rubs = smoothing > COULOMB_SMOOTHING and float(excess.max()) > LEAPT
    if rubs and not deadline.over():
        found = _with_friction(family, curve, start, fast, smoothing)
        excess = _excess(family, curve, found)
    before, parents = np.inf, np.full(len(excess), np.inf)
    for _ in range(MOST_MESHES):
        if not found.solved or deadline.over():
            break
        worst = float(excess.max())
        progress(
            f"mesh {found.s.size - 1}: {found.duration:.6f} s; largest excess of a limit between "
            f"mesh points: {100 * worst:.3g} %"
        )
        kept, settled = worst <= tolerance, rubs or _alike(before, found.duration)
        if kept and settled:
            break
        worst_in = excess.max(axis=1) / tolerance
        parts = _parts_for(worst_in, parents)
        if not settled:
            parts = np.maximum(parts, 1 + _switching(found))
        parents = np.repeat(worst_in, parts)
        t = _with_parts(found.t, parts)
        finer = _Timing(family, curve, found.at_times(t), fast)
        finer = finer.solved(BARRIERS[1])
        if kept and not finer.solved:
            break
        before = found.duration
        found = finer if finer.solved else replace(found, attempts=finer.attempts)
        excess = _excess(family, curve, found)
    return found


def _alike(before: float, after: float) -> bool:
    return abs(after - before) <= SETTLED * after


def _switching(profile: Profile) -> np.ndarray:
    """Intervals [N] in which s''' jumps: where most of what the mesh costs is lost.

    What a jump inside an interval costs grows with its size and the square of the interval.
    """
    h = np.diff(profile.t)
    mean = np.diff(profile.a) / h
    jumps = np.abs(np.diff(mean) - 0.5 * (profile.d[1:] + profile.d[:-1]))
    loss = (np.maximum(np.append(jumps, 0.0), np.append(0.0, jumps)) + np.abs(profile.d)) * h**2
    order = np.argsort(-loss)
    count = np.searchsorted(np.cumsum(loss[order]), MOST_LOSS * loss.sum()) + 1
    chosen = np.zeros(h.size, dtype=bool)
    chosen[order[:count]] = True
    return chosen


def _parts_for(excess: FloatArray, parents: FloatArray) -> np.ndarray:
    """How many parts of each interval [N] keep a limit exceeded by so many times the tolerance.

    Where the excess is hardly less than that of the interval that it is a part of, which is to say
    where a torque goes to its limit faster than an interval lasts, as many as there may be.
    """
    parts = np.where(
        (excess > 1.0) & (excess > SUDDEN * parents),
        MOST_PARTS,
        np.cbrt(np.maximum(excess, 0.0) / AIMED),
    )
    return np.clip(np.ceil(parts), 1, MOST_PARTS).astype(int)


def _with_parts(t: FloatArray, parts: np.ndarray) -> FloatArray:
    """Times [N+1] with each of their intervals in so many parts [N]."""
    first = np.repeat(np.cumsum(parts) - parts, parts)
    share = (np.arange(parts.sum()) - first) / np.repeat(parts, parts)
    return np.append(np.repeat(t[:-1], parts) + share * np.repeat(np.diff(t), parts), t[-1])


def _with_friction(
    family: LimitFamily, curve: Curve, start: Profile, fast: bool, smoothing: float
) -> Profile:
    """A profile for dry friction that turns within its own velocity, by way of wider ones."""
    found, barrier, last, sharper = start, BARRIERS[0], smoothing, SHARPER
    while True:
        tried = _closer_at_reversals(family, curve, found, smoothing)
        tried = _Timing(family, curve, tried, fast, smoothing).solved(barrier)
        if tried.solved:
            found, last, barrier = tried, smoothing, SMOOTHED_BARRIER
        else:  # less at a time
            found, sharper = replace(found, attempts=tried.attempts), np.sqrt(sharper)
        if last == COULOMB_SMOOTHING or sharper < LEAST_SHARPER or deadline.over():
            return found
        smoothing = max(last / sharper, COULOMB_SMOOTHING)


def _first_smoothing(family: LimitFamily, curve: Curve, start: Profile) -> float:
    """A velocity, rad/s (m/s), within which dry friction may turn for the start to be a good one.

    There the friction alone all but keeps the limits of the torque rate. Not less than the robot's.
    """
    limits, dry = family.robot.limits, dry_friction(family.robot)
    limit = np.minimum(limits.taud_max, -limits.taud_min)
    rated = (dry > 0) & np.isfinite(limit) & (limit > 0)
    if "taud" not in family or not rated.any():
        return COULOMB_SMOOTHING
    _, tangent, curvature = curve.evaluate(start.s)
    qdd = np.abs(tangent * start.a[:, None] + curvature * start.v[:, None] ** 2)
    turned = dry[rated] * np.percentile(qdd[:, rated], USUAL, axis=0) / limit[rated]
    return max(float(turned.max()), COULOMB_SMOOTHING)


def _closer_at_reversals(
    family: LimitFamily, curve: Curve, profile: Profile, smoothing: float
) -> Profile:
    """The same motion with more mesh points where the dry friction of a joint turns."""
    dry = dry_friction(family.robot) > 0
    if "taud" not in family or not dry.any():
        return profile
    velocity = (curve.evaluate(profile.s)[1] * profile.v[:, None])[:, dry]
    before, after = velocity[:-1], velocity[1:]
    slow = np.minimum(np.abs(before), np.abs(after)) < TURNED * smoothing
    slow |= before * after < 0
    change = np.where(slow, np.abs(after - before), 0.0).max(axis=1)
    parts = np.clip(np.ceil(change / (STEP * smoothing)), 1, MOST_PARTS).astype(int)
    return profile.at_times(_with_parts(profile.t, parts))


def _excess(family: LimitFamily, curve: Curve, profile: Profile) -> FloatArray:
    """Largest relative excess [N,K] of any limit at K places of every interval.

    Infinite where the profile was not solved.
    """
    if not profile.solved:
        return np.full((profile.s.size - 1, 1), np.inf)
    shares = np.linspace(0.0, 1.0, CHECKS_PER_INTERVAL + 1)
    steps = np.diff(profile.t)
    i = np.repeat(np.arange(steps.size), shares.size)
    s, v, a, j = profile.inside(i, (steps[:, None] * shares).ravel())
    q, tangent, curvature, bend = curve.inside(s, i, profile.s, highest=3)
    v, a, j = (k[:, None] for k in (v, a, j))
    samples = MotionSamples(
        q,
        tangent * v,
        tangent * a + curvature * v**2,
        tangent * j + 3 * curvature * v * a + bend * v**3,
    )
    return family.excess(samples).reshape(-1, shares.size)


@dataclass(frozen=True, eq=False)
class _Rows:
    """Rows ``lower <= value <= upper`` [N+1,k] at mesh points, and what their values are made of.

    ``parts`` are coefficients [N+1,k] by name, of the scaled s' (v), s'' (a) and s''' (j):
    ``jerk j + both v a + cubic v^3 + speed v + push a + square v^2 + dry (...)``, the last being
    tanh(turn v) of torques, and (1 - tanh(turn v)^2) (turn_a a + turn_v v^2) of their rates.
    """

    parts: dict[str, FloatArray]
    lower: FloatArray
    upper: FloatArray

    @property
    def count(self) -> int:
        return self.lower.shape[1]

    def stacked(self) -> FloatArray:
        """Coefficients [10 k, N+1]."""
        return np.hstack([self.parts[name] for name in PARTS]).T


class _Timing:
    """The nonlinear program of one curve on given places."""

    def __init__(
        self,
        family: LimitFamily,
        curve: Curve,
        start: Profile,
        fast: bool,
        smoothing: float = COULOMB_SMOOTHING,
    ) -> None:
        self.start, self.fast = start, fast
        self.start_free, self.end_free = curve.start_free, curve.end_free
        self.scale_v = max(float(start.v.max()), 1e-12)
        moving = np.abs(start.a)
        self.scale_a = max(float(np.percentile(moving, 90)), 1e-6 * self.scale_v)
        self.scale_t = self.scale_v / self.scale_a
        i = np.arange(start.s.size - 1)
        middle, *thirds = (start.inside(i, x * np.diff(start.t))[0] for x in (0.5, *THIRDS))
        left = _coefficients(family, curve, start.s, fast, smoothing)
        right = _coefficients(family, curve, start.s, fast, smoothing, from_left=True)
        inner = _coefficients(family, curve, middle, fast, smoothing)
        unit = (self.scale_v, self.scale_a, self.scale_a / self.scale_t)
        self.nodes, self.begin, self.end, self.within, self.middle = (
            _scaled(rows, unit) for rows in (left[0], left[1], right[1], inner[1], inner[0])
        )
        self.speed = left[2] / self.scale_v
        speeds = _largest_speeds(family, curve, np.ravel(thirds, "F"), fast)
        self.inner_speed = speeds / self.scale_v
        self.intervals = i.size
        self.steps = np.diff(start.s) / (self.scale_v * self.scale_t)

    # the program ----------------------------------------------------------------------------

    def solved(self, barrier: float) -> Profile:
        """The best profile; with another linear solver from the start where the first one fails."""
        begin = time.perf_counter()
        n = self.intervals
        start = self.start
        h = np.maximum(np.diff(start.t), 1e-12) / self.scale_t
        unit = self.scale_a / self.scale_t
        x = np.concatenate([start.v / self.scale_v, start.a / self.scale_a, h, start.d / unit])
        free = np.full(n, np.inf)
        low = np.concatenate([np.zeros(n + 1), np.full(n + 1, -np.inf), np.full(n, 1e-12), -free])
        high = np.concatenate([self.speed, np.full(n + 1, np.inf), free, free])
        for at, free in ((0, self.start_free), (n, self.end_free)):
            if not free:  # else the arm rests there whatever s' and s'' are
                low[[at, n + 1 + at]] = high[[at, n + 1 + at]] = 0.0
        start_x = np.clip(x, low, high)
        program = program_of(n, self.nodes.count, self.begin.count, self.fast)
        coefficients = np.concatenate(
            [self.nodes.stacked().ravel("F"), self.begin.stacked()[:, :-1].ravel("F"),
             self.end.stacked()[:, 1:].ravel("F"), self.within.stacked().ravel("F"),
             self.middle.stacked().ravel("F"), self.steps]
        )  # fmt: skip
        lower = np.concatenate([np.zeros(2 * n), *self._bounds("lower")])
        upper = np.concatenate([np.zeros(2 * n), *self._bounds("upper")])
        rows = np.flatnonzero(np.isfinite(lower) | np.isfinite(upper))
        attempts, gap = list(start.attempts), float("nan")
        for linear_solver in LINEAR_SOLVERS:
            solver = program.solver(rows, barrier, linear_solver)
            created = time.perf_counter()
            answer = solver(
                x0=start_x, p=coefficients, lbx=low, ubx=high, lbg=lower[rows], ubg=upper[rows]
            )
            x, values = (np.array(answer[key]).ravel() for key in ("x", "g"))
            attempts.append(
                self._attempt(solver.stats(), x[2 * n + 2 : 3 * n + 2].sum(), begin, created)
            )
            begin = time.perf_counter()
            lam = [np.array(answer[key]).ravel() for key in ("lam_x", "lam_g")]
            bounds = Bounds(low, high, lower[rows], upper[rows])
            # by the solver's own multipliers: what is left of the slope is not counted
            gap = gap_of(bounds, x, values, np.zeros(1), np.concatenate(lam)).total
            if attempts[-1].status.solved or deadline.over():
                break
            barrier = BARRIERS[0]
        t = np.append(0.0, np.cumsum(x[2 * n + 2 : 3 * n + 2])) * self.scale_t
        return replace(
            start,
            v=x[: n + 1] * self.scale_v,
            a=x[n + 1 : 2 * n + 2] * self.scale_a,
            t=t,
            d=x[3 * n + 2 :] * unit,
            gap=gap * self.scale_t,
            attempts=tuple(attempts),
        )

    def _attempt(self, stats: Any, cost: float, begin: float, created: float) -> Attempt:
        infeasibility = float(stats["iterations"]["inf_pr"][-1])
        return Attempt(
            solver="ipopt",
            status=status_of("ipopt", stats, SolverSettings("ipopt"), infeasibility),
            message=str(stats["return_status"]),
            iterations=int(stats["iter_count"]),
            cost=float(cost) * self.scale_t,
            infeasibility=infeasibility,
            wall_time=time.perf_counter() - created,
            create_time=created - begin,
            function_time=sum(v for k, v in stats.items() if k.startswith("t_wall_nlp_")),
        )

    def _bounds(self, side: str) -> list[FloatArray]:
        return [
            getattr(self.nodes, side).ravel(),
            getattr(self.begin, side)[:-1].ravel(),
            getattr(self.end, side)[1:].ravel(),
            getattr(self.within, side).ravel(),
            getattr(self.middle, side).ravel(),
            self.inner_speed if side == "upper" else np.full(self.inner_speed.size, -np.inf),
        ]


# coefficients -------------------------------------------------------------------------------


def _scaled(rows: _Rows, unit: tuple[float, float, float]) -> _Rows:
    """Rows of s', s'' and s''' in these units, divided by the sizes of their limits."""
    v, a, j = unit
    units = dict(zip(PARTS, (j, v * a, v**3, v, a, v**2, 1.0, v, a, v**2), strict=True))
    sizes = np.maximum(
        *(np.where(np.isfinite(b), np.abs(b), 0.0) for b in (rows.lower, rows.upper))
    )
    size = np.where(sizes > 0, sizes, 1.0)
    turns = ("turn", "turn_a", "turn_v")
    parts = {
        name: values * units[name] / (1.0 if name in turns else size)
        for name, values in rows.parts.items()
    }
    return _Rows(parts, rows.lower / size, rows.upper / size)


def _coefficients(
    family: LimitFamily,
    curve: Curve,
    s: FloatArray,
    fast: bool,
    smoothing: float,
    *,
    from_left: bool = False,
) -> tuple[_Rows, _Rows, FloatArray]:
    """Rows at places s of limits of accelerations and torques, those of rates, largest speeds."""
    q, tangent, curvature, bend = curve.evaluate(s, from_left=from_left, highest=3)
    robot: Robot = family.robot
    zero = np.zeros_like(q)
    links = robot.links if robot.has_dynamics else ()
    nodes = nodes_of(curve, s)
    limits = PathLimits.of(family, nodes, fast)
    speed = _speeds_of(limits, nodes, s.size)
    later, earlier = [], []
    if {"tau", "taud"} & set(family.keys):
        viscous, dry = (
            np.array([getattr(link, k) for link in links]) + zero
            for k in ("viscous_friction", "coulomb_friction")
        )
        turn = tangent / smoothing
        m, c, g, m_rate, c_rate, g_rate = _torques(robot, q, tangent, curvature, bend, fast)
    for key in family.keys:
        if key == "taud":
            parts = (
                m, m_rate + 2 * c, c_rate, g_rate, viscous * tangent, viscous * curvature,
                dry, turn, turn, curvature / smoothing,
            )  # fmt: skip
            later.append((key, parts, zero))
        elif key == "qddd":
            parts = (tangent, 3 * curvature, bend, *(zero,) * 7)
            later.append((key, parts, zero))
        elif key == "tau":
            parts = (zero, zero, zero, viscous * tangent, m, c, dry, turn, zero, zero)
            earlier.append((key, parts, g))
        elif key in limits.half_planes:
            found = limits.half_planes[key]
            own = [k[: s.size] for k in (found.per_u, found.per_x, found.constant)]
            none = np.zeros_like(own[0])
            parts = (none, none, none, none, own[0], own[1], none, none, none, none)
            earlier.append((key, parts, own[2]))
    at_points, rates = (_rows_of(family, limits, found, s.size) for found in (earlier, later))
    return at_points, rates, speed


def _largest_speeds(family: LimitFamily, curve: Curve, s: FloatArray, fast: bool) -> FloatArray:
    """Limits of s' [N] at places s; infinite where there is none."""
    nodes = nodes_of(curve, s)
    return _speeds_of(PathLimits.of(family, nodes, fast), nodes, s.size)


def _speeds_of(limits: PathLimits, nodes: Any, count: int) -> FloatArray:
    most = limits.speed_limit(nodes, count)
    return np.where(most < FAR, np.sqrt(most), np.inf)


def _rows_of(family: LimitFamily, limits: PathLimits, found: list[Any], count: int) -> _Rows:
    none = np.zeros((count, 0))
    tables: dict[str, list[FloatArray]] = {name: [none] for name in PARTS}
    lower, upper = [none], [none]
    for key, parts, constant in found:
        low, high = (
            np.broadcast_to(
                bound[: len(constant)] if np.ndim(bound) == 2 else bound, constant.shape
            )
            for bound in (
                limits.half_planes[key][3:]
                if key in limits.half_planes
                else (family[key].lower, family[key].upper)
            )
        )
        kept = np.flatnonzero((np.isfinite(low) | np.isfinite(high)).any(axis=0))
        for name, values in zip(PARTS, parts, strict=True):
            tables[name].append(np.broadcast_to(values, constant.shape)[:, kept])
        lower.append((low - constant)[:, kept])
        upper.append((high - constant)[:, kept])
    return _Rows({k: np.hstack(v) for k, v in tables.items()}, np.hstack(lower), np.hstack(upper))


def _torques(
    robot: Robot,
    q: FloatArray,
    tangent: FloatArray,
    curvature: FloatArray,
    bend: FloatArray,
    fast: bool,
) -> tuple[FloatArray, ...]:
    """Torque per s'', per s'^2 and at rest without friction, and how each changes along s."""
    call = _rates(robot, len(q), fast)

    def at(v: float, a: float) -> tuple[FloatArray, FloatArray]:
        qdd = a * tangent + v**2 * curvature
        qddd = 3 * v * a * curvature + v**3 * bend
        found = call(q.T, v * tangent.T, qdd.T, qddd.T)
        return found[0].T, found[1].T

    (once, once_rate), (twice, twice_rate) = at(1.0, 0.0), at(2.0, 0.0)
    pushed, pushed_rate = at(1.0, 1.0)
    c = (twice - once) / 3.0
    c_rate = (twice_rate - 2.0 * once_rate) / 6.0
    m_rate = pushed_rate - once_rate - 2.0 * c
    return pushed - once, c, once - c, m_rate, c_rate, once_rate - c_rate


@lru_cache(maxsize=16)
def _rates(robot: Robot, count: int, fast: bool) -> Any:
    smooth = robot.with_links(
        [replace(k, viscous_friction=0.0, coulomb_friction=0.0) for k in robot.links]
    )
    return buffered_call(maybe_compiled(torque_and_rate(smooth), fast).map(count))
