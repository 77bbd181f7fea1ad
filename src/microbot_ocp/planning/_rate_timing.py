"""The best timing of a curve under limits of the torque rate and the jerk, from reachability's.

Along a path q(s) torques and accelerations are affine in s'' and s'^2, and their rates are products
of s', s'', s''' with coefficients that depend on s alone. So the mesh points are places on the
path, where all coefficients are numbers before the solver starts, and the unknowns are s', s'' and
the time that each interval takes; s is cubic in time in it. No dynamics are evaluated inside the
solver. After Debrouwere et al., "Time-optimal path following for robots with convex-concave
constraints using sequential convex programming", IEEE T-RO 29(6), 2013, with the time of every
interval as an unknown: near a stop s' is no smooth function of s.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.codegen import compile_functions, maybe_compiled
from microbot_ocp._base.fast_calls import buffered_call
from microbot_ocp._base.status import Status
from microbot_ocp.limits import LimitFamily, MotionSamples
from microbot_ocp.ocp.refinement import halved_within, split
from microbot_ocp.ocp.solution import Attempt, StepProgress
from microbot_ocp.planning._curve import Curve
from microbot_ocp.planning._path_limits import FAR, PathLimits, nodes_of
from microbot_ocp.planning._reachability import Reached
from microbot_ocp.planning._task import CHECKS_PER_INTERVAL
from microbot_ocp.robot import COULOMB_SMOOTHING, Robot, torque_and_rate

RATES = ("taud", "qddd")  # keys of limits that are kept here
SMOOTHING = 1e-8  # weight of the squared s''': picks one timing where many are equally fast
NEAR = 0.3  # use of a limit from which the solver is told of it
TOLERANCE = 1e-7
BARRIERS = (1e-2, 1e-4)  # of a first solve and of one from a coarser mesh
MOST_MESHES = 10
FAR_ABOVE = 3.0  # times the accepted excess; halving an interval divides it by about four
MOST_ITERATIONS = 120  # 25 to 45 are usual
OPTIONS = {
    "print_level": 0,
    "sb": "yes",
    "tol": TOLERANCE,
    "max_iter": MOST_ITERATIONS,
    "mumps_permuting_scaling": 0,
    "mumps_pivot_order": 0,
    "acceptable_iter": 0,
}
PARTS: tuple[str, ...] = (
    "jerk",
    "both",
    "cubic",
    "speed",
    "push",
    "square",
    "dry",
    "turn",
    "turn_a",
    "turn_v",
)


@dataclass(frozen=True, eq=False)
class Profile:
    """How a curve is travelled: its speed s' and s'' at places s; s''' is constant in between.

    Attributes
    ----------
    s, v, a, t : arrays [N+1]
        Places, s', s'', and the times at which they are passed, s.
    gap : float
        How much longer it takes than the local optimum, at most, s.
    attempts : tuple of Attempt
        Solves that led to it.
    """

    s: FloatArray
    v: FloatArray
    a: FloatArray
    t: FloatArray
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
        h, a = np.diff(self.t)[i], self.a[i]
        j = (self.a[i + 1] - a) / h
        v = self.v[i] + after * (a + 0.5 * after * j)
        s = self.s[i] + after * (self.v[i] + after * (0.5 * a + after * j / 6.0))
        return np.clip(s, self.s[i], self.s[i + 1]), v, a + after * j, j

    def at_times(self, t: FloatArray) -> Profile:
        """The same motion with more mesh points, at times among which are those that it has."""
        i = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, self.t.size - 2)
        s, v, a, _ = self.inside(i, t - self.t[i])
        own = np.searchsorted(t, self.t)
        s[own], v[own], a[own] = self.s, self.v, self.a
        return replace(self, s=s, v=v, a=a, t=t)


@dataclass(frozen=True)
class Ends:
    """Whether s', and whether s'' is zero at the start and at the end of a curve."""

    still: tuple[bool, bool]
    steady: tuple[bool, bool]


def first_profile(curve: Curve, timing: Reached, count: int) -> Profile:
    """Reachability's timing at so many places on each piece of a curve, evenly spread in time."""
    edges = np.interp(curve.breaks, timing.s, timing.t)
    shares = np.linspace(0.0, 1.0, count + 1)[:-1]
    t = np.append((edges[:-1, None] + np.diff(edges)[:, None] * shares).ravel(), edges[-1])
    s = np.interp(t, timing.t, timing.s)
    s[::count] = curve.breaks
    v = np.sqrt(np.interp(s, timing.s, timing.speed_squared))
    rise = np.diff(v) / np.diff(t)
    return Profile(s, v, 0.5 * (np.append(rise, rise[-1]) + np.append(rise[0], rise)), t)


def with_rates(
    family: LimitFamily,
    curve: Curve,
    start: Profile,
    ends: Ends,
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
    ends : Ends
    tolerance : float
        Largest relative excess of a limit between mesh points.
    fast : bool
        Whether functions are compiled.
    progress : callable
    """
    found = _Timing(family, curve, start, ends, fast).solved(BARRIERS[0])
    for _ in range(MOST_MESHES):
        if not found.solved or deadline.over():
            break
        excess = _excess(family, curve, found)
        worst = float(excess.max())
        progress(
            f"mesh {found.s.size - 1}: {found.duration:.6f} s; largest excess of a limit between "
            f"mesh points: {100 * worst:.3g} %"
        )
        marked = excess > tolerance
        if not marked.any():
            break
        t = split(found.t, marked)
        t = halved_within(t, found.t, excess > FAR_ABOVE * tolerance)
        finer = _Timing(family, curve, found.at_times(t), ends, fast).solved(BARRIERS[1])
        found = finer if finer.solved else replace(found, attempts=finer.attempts)
    return found


def _excess(family: LimitFamily, curve: Curve, profile: Profile) -> FloatArray:
    """Largest relative excess [N,K] of any limit at K places of every interval."""
    shares = np.linspace(0.0, 1.0, CHECKS_PER_INTERVAL + 1)
    steps = np.diff(profile.t)
    i = np.repeat(np.arange(steps.size), shares.size)
    s, v, a, j = profile.inside(i, (steps[:, None] * shares).ravel())
    q, tangent, curvature, bend = curve.inside(s, i, profile.s)
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
        self, family: LimitFamily, curve: Curve, start: Profile, ends: Ends, fast: bool
    ) -> None:
        self.start, self.ends, self.fast = start, ends, fast
        self.scale_v = max(float(start.v.max()), 1e-12)
        moving = np.abs(start.a)
        self.scale_a = max(float(np.percentile(moving, 90)), 1e-6 * self.scale_v)
        self.scale_t = self.scale_v / self.scale_a
        i = np.arange(start.s.size - 1)
        middle = start.inside(i, 0.5 * np.diff(start.t))[0]
        left = _coefficients(family, curve, start.s, fast)
        right = _coefficients(family, curve, start.s, fast, from_left=True)
        inner = _coefficients(family, curve, middle, fast)
        unit = (self.scale_v, self.scale_a, self.scale_a / self.scale_t)
        self.nodes, self.begin, self.end, self.middle = (
            _scaled(rows, unit) for rows in (left[0], left[1], right[1], inner[0])
        )
        self.speed, self.inner_speed = (own[2] / self.scale_v for own in (left, inner))
        self.intervals = i.size
        self.steps = np.diff(start.s) / (self.scale_v * self.scale_t)

    # the program ----------------------------------------------------------------------------

    def solved(self, barrier: float) -> Profile:
        begin = time.perf_counter()
        n = self.intervals
        start = self.start
        h = np.maximum(np.diff(start.t), 1e-12) / self.scale_t
        x = np.concatenate([start.v / self.scale_v, start.a / self.scale_a, h])
        low = np.concatenate([np.zeros(n + 1), np.full(n + 1, -np.inf), np.full(n, 1e-12)])
        high = np.concatenate([self.speed, np.full(2 * n + 1, np.inf)])
        for at, still, steady in zip((0, n), self.ends.still, self.ends.steady, strict=True):
            if still:
                low[at] = high[at] = 0.0
            if steady:
                low[n + 1 + at] = high[n + 1 + at] = 0.0
        x = start_x = np.clip(x, low, high)
        program = _program(n, self.nodes.count, self.begin.count, self.fast)
        coefficients = np.concatenate(
            [self.nodes.stacked().ravel("F"), self.begin.stacked()[:, :-1].ravel("F"),
             self.end.stacked()[:, 1:].ravel("F"), self.middle.stacked().ravel("F"), self.steps]
        )  # fmt: skip
        lower = np.concatenate([np.zeros(2 * n), *self._bounds("lower")])
        upper = np.concatenate([np.zeros(2 * n), *self._bounds("upper")])
        values = np.array(program.values(x, coefficients)).ravel()
        told = (lower == upper) | _near(values, lower, upper, NEAR)
        attempts, gap = list(start.attempts), float("nan")
        for every in (False, True):
            rows = np.flatnonzero(told)
            solver = program.solver(rows, barrier)
            created = time.perf_counter()
            answer = solver(
                x0=x, p=coefficients, lbx=low, ubx=high, lbg=lower[rows], ubg=upper[rows]
            )
            x = np.array(answer["x"]).ravel()
            values = np.array(program.values(x, coefficients)).ravel()
            attempts.append(self._attempt(solver.stats(), x[2 * n + 2 :].sum(), begin, created))
            begin = time.perf_counter()
            gap = _gap(answer, x, low, high, lower[rows], upper[rows])
            broken = ~told & _near(values, lower, upper, 1.0 + TOLERANCE)
            kept = attempts[-1].status.solved and not broken.any()
            if every or kept or deadline.over():
                break
            told = np.isfinite(lower) | np.isfinite(upper)
            x, barrier = start_x, BARRIERS[0]
        t = np.append(0.0, np.cumsum(x[2 * n + 2 :])) * self.scale_t
        return replace(
            start,
            v=x[: n + 1] * self.scale_v,
            a=x[n + 1 : 2 * n + 2] * self.scale_a,
            t=t,
            gap=gap * self.scale_t,
            attempts=tuple(attempts),
        )

    def _attempt(self, stats: Any, cost: float, begin: float, created: float) -> Attempt:
        message = str(stats["return_status"])
        known = {
            "Solve_Succeeded": Status.SOLVED,
            "Maximum_WallTime_Exceeded": Status.TIME_LIMIT,
            "Maximum_Iterations_Exceeded": Status.ITERATION_LIMIT,
            "Infeasible_Problem_Detected": Status.INFEASIBLE,
        }
        return Attempt(
            solver="ipopt",
            status=known.get(message, Status.FAILED),
            message=message,
            iterations=int(stats["iter_count"]),
            cost=float(cost) * self.scale_t,
            infeasibility=float(stats["iterations"]["inf_pr"][-1]),
            wall_time=time.perf_counter() - created,
            create_time=created - begin,
            function_time=sum(v for k, v in stats.items() if k.startswith("t_wall_nlp_")),
        )

    def _bounds(self, side: str) -> list[FloatArray]:
        return [
            getattr(self.nodes, side).ravel(),
            getattr(self.begin, side)[:-1].ravel(),
            getattr(self.end, side)[1:].ravel(),
            getattr(self.middle, side).ravel(),
            self.inner_speed if side == "upper" else np.full(self.intervals, -np.inf),
        ]


def _near(values: FloatArray, lower: FloatArray, upper: FloatArray, share: float) -> np.ndarray:
    """Which rows use so much of one of their bounds; bounds are about one."""
    with np.errstate(invalid="ignore"):
        middle = 0.5 * (lower + upper)
        middle = np.where(np.isfinite(middle), middle, 0.0)
        return (values - middle > share * (upper - middle)) | (
            values - middle < share * (lower - middle)
        )


def _gap(
    answer: Any,
    x: FloatArray,
    low: FloatArray,
    high: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
) -> float:
    """Sum of multipliers times distances to their limits."""
    total = 0.0
    rows = np.array(answer["g"]).ravel()
    for lam, value, least, most in (
        (np.array(answer["lam_x"]).ravel(), x, low, high),
        (np.array(answer["lam_g"]).ravel(), rows, lower, upper),
    ):
        with np.errstate(invalid="ignore"):
            distance = np.where(lam > 0, most - value, value - least)
        total += float(np.abs(lam * np.where(np.isfinite(distance), distance, 0.0)).sum())
    return total


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
    family: LimitFamily, curve: Curve, s: FloatArray, fast: bool, *, from_left: bool = False
) -> tuple[_Rows, _Rows, FloatArray]:
    """Rows at places s of limits of accelerations and torques, those of rates, largest speeds."""
    q, tangent, curvature, bend = curve.derivatives(s, from_left=from_left)
    robot: Robot = family.robot
    zero = np.zeros_like(q)
    links = robot.links if robot.has_dynamics else ()
    nodes = nodes_of(curve, s)
    limits = PathLimits.of(family, nodes, fast)
    most = limits.speed_limit(nodes, s.size)
    speed = np.where(most < FAR, np.sqrt(most), np.inf)
    later, earlier = [], []
    if {"tau", "taud"} & set(family.keys):
        viscous, dry = (
            np.array([getattr(link, k) for link in links]) + zero
            for k in ("viscous_friction", "coulomb_friction")
        )
        turn = tangent / COULOMB_SMOOTHING
        m, c, g, m_rate, c_rate, g_rate = _torques(robot, q, tangent, curvature, bend, fast)
    for key in family.keys:
        if key == "taud":
            parts = (
                m, m_rate + 2 * c, c_rate, g_rate, viscous * tangent, viscous * curvature,
                dry, turn, turn, curvature / COULOMB_SMOOTHING,
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
    return _rows_of(family, limits, earlier), _rows_of(family, limits, later), speed


def _rows_of(family: LimitFamily, limits: PathLimits, found: list[Any]) -> _Rows:
    tables: dict[str, list[FloatArray]] = {name: [] for name in PARTS}
    lower, upper = [], []
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


# derivatives --------------------------------------------------------------------------------


def _terms(parts: list[ca.SX], v: ca.SX, a: ca.SX, j: ca.SX | None) -> ca.SX:
    jerk, both, cubic, speed, push, square, dry, turn, turn_a, turn_v = parts
    smooth = push * a + square * v**2 + speed * v
    side = ca.tanh(turn * v)
    if j is None:
        return smooth + dry * side
    rubbed = dry * (1.0 - side**2) * (turn_a * a + turn_v * v**2)
    return smooth + jerk * j + both * v * a + cubic * v**3 + rubbed


@dataclass(frozen=True, eq=False)
class _Kernel:
    """Values, Jacobian entries and Hessian entries of one interval, or of one mesh point."""

    values: ca.Function
    slopes: ca.Function
    curvature: ca.Function
    jacobian: tuple[np.ndarray, np.ndarray]
    hessian: tuple[np.ndarray, np.ndarray]

    @classmethod
    def of(cls, w: ca.SX, c: ca.SX, values: ca.SX, cost: ca.SX, fast: bool) -> _Kernel:
        lam, sigma = ca.SX.sym("lam", values.shape[0]), ca.SX.sym("sigma")
        jacobian = ca.jacobian(values, w)
        hessian = ca.triu(ca.hessian(ca.dot(lam, values) + sigma * cost, w)[0])
        functions = (
            ca.Function("values", [w, c], ca.cse([values, cost])),
            ca.Function(
                "slopes", [w, c], ca.cse([jacobian.nz[:], ca.densify(ca.gradient(cost, w))])
            ),
            ca.Function("curvature", [w, c, lam, sigma], ca.cse([hessian.nz[:]])),
        )
        values_of, slopes, curvature = compile_functions(functions) if fast else functions
        places = [
            (np.array(rows), np.array(columns))
            for rows, columns in (k.sparsity().get_triplet() for k in (jacobian, hessian))
        ]
        return cls(values_of, slopes, curvature, *places)


@lru_cache(maxsize=16)
def _kernels(at_points: int, rates: int, fast: bool) -> tuple[_Kernel, _Kernel]:
    """Of a mesh point (v, a), and of an interval (v, a, its time, v and a at its end)."""
    w, c = ca.SX.sym("w", 2), ca.SX.sym("c", len(PARTS) * at_points)
    parts = ca.vertsplit(c, at_points) if at_points else [ca.SX(0, 1)] * len(PARTS)
    point = _Kernel.of(w, c, _terms(parts, w[0], w[1], None), ca.SX(0), fast)
    count = len(PARTS)
    w, c = ca.SX.sym("w", 5), ca.SX.sym("c", count * (2 * rates + at_points) + 1)
    v, a, h, v_end, a_end = ca.vertsplit(w)
    j, v_middle = (a_end - a) / h, v + h * (3.0 * a + a_end) / 8.0
    parts = ca.vertsplit(c[: 2 * count * rates], rates)
    inner = c[2 * count * rates : -1]
    middle = ca.vertsplit(inner, at_points) if at_points else [ca.SX(0, 1)] * count
    start, end = parts[:count], parts[count:]
    values = ca.vertcat(
        v_end - v - 0.5 * h * (a + a_end),
        c[-1] - h * v - h**2 * (2.0 * a + a_end) / 6.0,
        _terms(start, v, a, j),
        _terms(end, v_end, a_end, j),
        _terms(middle, v_middle, 0.5 * (a + a_end), None),
        v_middle,
    )
    return point, _Kernel.of(w, c, values, h + SMOOTHING * h * j**2, fast)


@dataclass(frozen=True, eq=False)
class _Program:
    """All rows and their derivatives on a number of intervals, coefficients as parameters."""

    x: ca.MX
    p: ca.MX
    g: ca.MX
    cost: ca.MX
    slope: ca.MX
    entries: ca.MX
    places: tuple[np.ndarray, np.ndarray]  # rows and columns of the entries of the Jacobian
    hessian: ca.Function
    values: ca.Function

    def solver(self, rows: np.ndarray, barrier: float) -> ca.Function:
        """IPOPT on some of the rows."""
        height, width = self.g.shape[0], self.x.shape[0]
        new = np.full(height, -1)
        new[rows] = np.arange(rows.size)
        at, columns = self.places
        keep = np.flatnonzero(new[at] >= 0)
        order = keep[np.lexsort((new[at[keep]], columns[keep]))]
        first = np.searchsorted(columns[order], np.arange(width + 1)).tolist()
        sparsity = ca.Sparsity(rows.size, width, first, new[at[order]].tolist())
        jacobian = ca.MX(sparsity, self.entries[order.tolist()])
        g = self.g[rows.tolist()]
        lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", rows.size)
        every = ca.MX.zeros(height)
        every[rows.tolist()] = lam_g
        curvature = [self.x, self.p, lam_f, lam_g]
        stationarity = lam_f * self.slope + jacobian.T @ lam_g
        nothing = ca.MX.zeros(self.p.shape[0])
        cache = {
            "nlp_grad": ca.Function("nlp_grad", curvature, [self.cost, g, stationarity, nothing]),
            "nlp_jac_g": ca.Function("nlp_jac_g", [self.x, self.p], [g, jacobian]),
            "nlp_grad_f": ca.Function("nlp_grad_f", [self.x, self.p], [self.cost, self.slope]),
            "nlp_hess_l": ca.Function(
                "nlp_hess_l", curvature, [self.hessian(self.x, self.p, lam_f, every)]
            ),
        }
        push = {"bound_push": barrier, "bound_frac": barrier, "mu_init": barrier}
        left = deadline.until() - time.perf_counter()
        own = {"max_wall_time": max(left, 1e-3)} if np.isfinite(left) else {}
        return ca.nlpsol(
            "timing",
            "ipopt",
            {"x": self.x, "p": self.p, "f": self.cost, "g": g},
            {
                "print_time": False,
                "calc_lam_p": False,
                "calc_lam_x": False,
                "error_on_fail": False,
                "show_eval_warnings": False,
                "ipopt": {**OPTIONS, **push, **own},
                "cache": cache,
            },
        )


@lru_cache(maxsize=8)
def _program(n: int, at_points: int, rates: int, fast: bool) -> _Program:
    point, interval = _kernels(at_points, rates, fast)
    x = ca.MX.sym("x", 3 * n + 2)
    own = point.values.size1_in(1), interval.values.size1_in(1)
    half = len(PARTS) * rates
    p = ca.MX.sym("p", own[0] * (n + 1) + own[1] * n)
    edges = np.cumsum([0, own[0] * (n + 1), half * n, half * n, own[0] * n, n]).tolist()
    at, begin, end, middle, steps = (
        ca.reshape(p[a:b], -1, size)
        for a, b, size in zip(edges[:-1], edges[1:], (n + 1, n, n, n, n), strict=True)
    )
    k, i = np.arange(n + 1), np.arange(n)
    of_points = np.vstack([k, n + 1 + k])
    of_intervals = np.vstack([i, n + 1 + i, 2 * n + 2 + i, i + 1, n + 2 + i])
    groups = []
    for kernel, places, constants in (
        (point, of_points, at),
        (interval, of_intervals, ca.vertcat(begin, end, middle, steps)),
    ):
        count = places.shape[1]
        w = ca.reshape(x[places.ravel("F").tolist()], places.shape[0], count)
        groups.append((kernel, places, w, constants, count))
    # rows: two equations an interval, those of the points, rates at starts, rates at ends, those
    # of the middles, speeds there
    first = 2 * n + at_points * (n + 1)
    inner = first + 2 * rates * n
    row_places = [
        2 * n + np.arange(at_points)[:, None] + at_points * k,
        np.vstack(
            [
                np.array([[0], [1]]) + 2 * i,
                first + np.arange(rates)[:, None] + rates * i,
                first + rates * n + np.arange(rates)[:, None] + rates * i,
                inner + np.arange(at_points)[:, None] + at_points * i,
                inner + at_points * n + i,
            ]
        ),
    ]
    values, cost, slope = [], ca.MX(0), ca.MX.zeros(x.shape[0])
    entries, rows, columns = [], [], []
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", inner + (at_points + 1) * n)
    bends, bend_rows, bend_columns = [], [], []
    for (kernel, places, w, constants, count), own_rows in zip(groups, row_places, strict=True):
        found, added = kernel.values.map(count)(w, constants)
        values.append(ca.vec(found))
        cost = cost + ca.sum2(added)
        nonzeros, gradient = kernel.slopes.map(count)(w, constants)
        entries.append(ca.vec(nonzeros))
        r, c = kernel.jacobian
        rows.append(own_rows[r].ravel("F"))
        columns.append(places[c].ravel("F"))
        for line, place in enumerate(places):
            slope[place.tolist()] += gradient[line, :].T
        lam = ca.reshape(lam_g[own_rows.ravel("F").tolist()], own_rows.shape[0], count)
        bend = kernel.curvature.map(count)(w, constants, lam, ca.repmat(lam_f, 1, count))
        bends.append(ca.vec(bend))
        r, c = kernel.hessian
        pair = np.sort([places[r].ravel("F"), places[c].ravel("F")], axis=0)
        bend_rows.append(pair[0])
        bend_columns.append(pair[1])
    order = np.argsort(np.concatenate([k.ravel("F") for k in row_places]))
    g = ca.vertcat(*values)[order.tolist()]
    at_rows, at_columns = np.concatenate(bend_rows), np.concatenate(bend_columns)
    unique, which = np.unique(at_columns * x.shape[0] + at_rows, return_inverse=True)
    gather = ca.DM.triplet(
        which.tolist(), np.arange(which.size).tolist(), ca.DM.ones(which.size),
        unique.size, which.size,
    )  # fmt: skip
    sparsity = ca.Sparsity(
        x.shape[0], x.shape[0],
        np.searchsorted(unique // x.shape[0], np.arange(x.shape[0] + 1)).tolist(),
        (unique % x.shape[0]).tolist(),
    )  # fmt: skip
    hessian = ca.MX(sparsity, ca.mtimes(gather, ca.vertcat(*bends)))
    return _Program(
        x, p, g, ca.densify(cost), slope, ca.vertcat(*entries),
        (np.concatenate(rows), np.concatenate(columns)),
        ca.Function("hessian", [x, p, lam_f, lam_g], [hessian]),
        ca.Function("rows", [x, p], [g]),
    )  # fmt: skip
