"""The nonlinear program of a timing on places of a path, with explicitly assembled derivatives.

At a given place of a path every limit is a function of s', s'' and s''', whose coefficients are
numbers: the pose, its derivatives, and those of the torque. Every mesh point and every interval is
one call of a small kernel without dynamics, whose values and entries of Jacobian and Hessian go to
known rows and columns. Another path needs no new derivation or compilation. The equations are (5)
to (10) of docs/theory/path_timing.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.codegen import compile_functions
from microbot_ocp._base.ipopt import ipopt, time_limits
from microbot_ocp.limits import LimitFamily, Member
from microbot_ocp.ocp.solvers import as_ipopt_knows

SMOOTHING_WEIGHT = 1e-8  # weight of the squared s''', selects one of many equally fast timings
SPEED_PLACES = (1 / 3, 2 / 3)  # places of an interval at which s' is bounded, shares
TORQUE_PARTS = 6  # coefficients m, c, g of equation (6), and their slopes m', c', g' along s


@dataclass(frozen=True)
class LimitKinds:
    """Kinds of limits that are rows of the program; kernels depend on them alone.

    Attributes
    ----------
    joints : number of joints
    dynamics : True if limits need torques
    of_acceleration : keys of the limits that depend on s'' but not on s'''
    of_rates : keys of the limits that depend on s'''
    family : family with the expressions of further limits, or None
    """

    joints: int
    dynamics: bool
    of_acceleration: tuple[str, ...]
    of_rates: tuple[str, ...]
    family: LimitFamily | None

    @classmethod
    def of(cls, family: LimitFamily) -> LimitKinds:
        """Return the kinds of limits of a family."""
        accelerations, rates = family.of_order(2), family.of_order(3)
        further = any(family[key].limit is not None for key in (*accelerations, *rates))
        return cls(
            joints=family.robot.joint_count,
            dynamics=family.robot.has_dynamics
            and (further or bool({"tau", "taud"} & {*accelerations, *rates})),
            of_acceleration=accelerations,
            of_rates=rates,
            family=family if further else None,
        )

    @property
    def numbers(self) -> int:
        """Number of coefficients at a place."""
        return self.joints * (4 + TORQUE_PARTS * self.dynamics)

    @property
    def further(self) -> tuple[str, ...]:
        """Keys of the limits with expressions of their own."""
        if self.family is None:
            return ()
        keys = (*self.of_acceleration, *self.of_rates)
        return tuple(key for key in keys if self.family[key].limit is not None)


@dataclass(frozen=True, eq=False)
class LimitBounds:
    """Bounds [k] of the rows of a place, divided by their magnitudes."""

    lower: FloatArray
    upper: FloatArray
    size: FloatArray

    @classmethod
    def of(cls, family: LimitFamily, keys: Sequence[str], usual: dict[str, Any]) -> LimitBounds:
        """Return the bounds of the rows of limits; ``usual`` scales those that vary."""
        parts: list[tuple[FloatArray, ...]] = [(np.zeros(0),) * 3]
        for key in keys:
            member = family[key]
            bounds = usual[key] if member.varies else member
            size = _finite_size(np.vstack([bounds.lower, bounds.upper]))
            zero, none = np.zeros_like(size), np.full_like(size, np.inf)
            either = {"lower": (zero, none, size), "upper": (-none, zero, size)}
            sides = [either[side] for side in _sides(member)]
            parts += sides if member.varies else [(member.lower, member.upper, size)]
        lower, upper, size = (np.concatenate(column) for column in zip(*parts, strict=True))
        return cls(lower / size, upper / size, size)


def _sides(member: Member) -> tuple[str, ...]:
    """Return the names of the finite bounds of a varying limit, each of which has its own row."""
    bounds = {"lower": member.lower, "upper": member.upper}
    return tuple(side for side, bound in bounds.items() if not np.isinf(bound).all())


def _finite_size(bounds: FloatArray) -> FloatArray:
    """Return the largest finite magnitude [k] of bounds [m,k]; 1 if there is none."""
    size = np.where(np.isfinite(bounds), np.abs(bounds), 0.0).max(axis=0)
    return np.where(size > 0.0, size, 1.0)


@dataclass(frozen=True, eq=False)
class _Kernel:
    """Values, Jacobian entries and Hessian entries of one interval, or of one mesh point.

    ``used`` holds the indices of the coefficients on which they depend.
    """

    values: ca.Function
    slopes: ca.Function
    curvature: ca.Function
    jacobian: tuple[np.ndarray, np.ndarray]
    hessian: tuple[np.ndarray, np.ndarray]
    used: np.ndarray

    @classmethod
    def of(cls, w: Any, numbers: Any, common: Any, values: Any, cost: Any, fast: bool) -> _Kernel:
        symbol = type(w)
        lam, sigma = symbol.sym("lam", values.shape[0]), symbol.sym("sigma")
        jacobian = ca.jacobian(values, w)
        hessian = ca.triu(ca.hessian(ca.dot(lam, values) + sigma * cost, w)[0])
        every = numbers.shape[0]
        used = np.flatnonzero(ca.which_depends(ca.vertcat(values, cost), numbers)) if every else []
        used = np.array(used, dtype=int)
        chosen = symbol.sym("numbers", used.size)
        full = symbol.zeros(every)
        full[used.tolist()] = chosen
        slope = ca.densify(ca.gradient(cost, w))
        outputs: Any = [values, cost, jacobian.nz[:], slope, hessian.nz[:]]
        outputs = ca.substitute(outputs, [numbers], [full])
        given = [w, chosen, common]
        functions = (
            ca.Function("values", given, ca.cse(outputs[:2])),
            ca.Function("slopes", given, ca.cse(outputs[2:4])),
            ca.Function("curvature", [*given, lam, sigma], ca.cse(outputs[4:])),
        )
        values_of, slopes, curvature = compile_functions(functions) if fast else functions
        of_slopes, of_curvature = (
            (np.array(rows, dtype=int), np.array(columns, dtype=int))
            for rows, columns in (k.sparsity().get_triplet() for k in (jacobian, hessian))
        )
        return cls(values_of, slopes, curvature, of_slopes, of_curvature, used)


@lru_cache(maxsize=16)
def kernels(kinds: LimitKinds, fast: bool) -> tuple[_Kernel, _Kernel]:
    """Return the kernels of a mesh point and of an interval.

    Raises
    ------
    InputError
        The expression of a further limit has no derivatives.
    """
    if kinds.family is None:
        return _kernels_of(ca.SX, kinds, fast)
    for symbol in (ca.SX, ca.MX):  # a table or a spline has no SX form
        try:
            return _kernels_of(symbol, kinds, fast)
        except deadline.Over:
            raise
        except Exception as error:  # a user's expression may raise anything
            problem = error
    names = ", ".join(repr(kinds.family[key].name) for key in kinds.further)
    reason = str(problem).strip().splitlines()[-1:] or [type(problem).__name__]
    raise InputError(
        f"the timing of a path needs derivatives of limit {names}, and its expression has none: "
        f"{reason[0]}"
    ) from problem


def _kernels_of(symbol: Any, kinds: LimitKinds, fast: bool) -> tuple[_Kernel, _Kernel]:
    """Write the rows of docs/theory/path_timing.md, "One program on places".

    An interval has v = s' and a = s'' at both ends, its time h, and d, the linear change of s''' in
    it. A constant s''' would meet a limited rate at one end of the interval only, an error of first
    order in its length.
    """
    one, three = kinds.of_acceleration, kinds.of_rates
    rows = kinds.joints, kinds.numbers
    w = symbol.sym("w", 2)
    numbers, common = symbol.sym("numbers", rows[1]), symbol.sym("common", common_size(kinds))
    values = _limit_rows(kinds, one, numbers, common, (w[0], w[1], 0.0))
    point = _Kernel.of(w, numbers, common, values, symbol(0), fast)
    w, numbers = symbol.sym("w", 6), symbol.sym("numbers", 3 * rows[1] + 1)
    v, a, h, v_end, a_end, d = (w[k] for k in range(6))
    start, end, middle = (numbers[k * rows[1] : (k + 1) * rows[1]] for k in range(3))
    # Equation (8): s''' = j + d (x - 1/2) at a share x of the interval, with the mean j, and s'' =
    # a + h (j x - d x (1 - x) / 2). Equations (9) and (10): v and s at its end, v and a in the
    # middle.
    j = (a_end - a) / h
    a_middle = 0.5 * (a + a_end) - h * d / 8.0
    v_middle = v + h * (3.0 * a + a_end) / 8.0 - h**2 * d / 24.0
    gained = 0.5 * h * (a + a_end) - h**2 * d / 12.0
    travelled = h * v + h**2 * (2.0 * a + a_end) / 6.0 - h**3 * d / 24.0
    values = ca.vertcat(
        v_end - v - gained,
        numbers[-1] - travelled,
        _limit_rows(kinds, three, start, common, (v, a, j - 0.5 * d)),
        _limit_rows(kinds, three, end, common, (v_end, a_end, j + 0.5 * d)),
        _limit_rows(kinds, three, middle, common, (v_middle, a_middle, j)),
        _limit_rows(kinds, one, middle, common, (v_middle, a_middle, 0.0)),
        # The speed at the thirds: at the middle alone, s'' would keep a constant error on an arc at
        # the velocity limit.
        *(v + h * x * (a + h * x * (0.5 * (j - 0.5 * d) + x * d / 6.0)) for x in SPEED_PLACES),
    )
    # Integral of the squared s''' over the interval: h (j^2 + d^2 / 12).
    rough = h * (j**2 + d**2 / 12.0)
    cost = h + SMOOTHING_WEIGHT * rough
    return point, _Kernel.of(w, numbers, common, values, cost, fast)


def common_size(kinds: LimitKinds) -> int:
    """Count the coefficients that all places share."""
    family = kinds.family
    sizes = 0
    for key in (*kinds.of_acceleration, *kinds.of_rates):
        member = family[key] if family else None
        rows = len(_sides(member)) if member and member.varies else 1
        sizes += rows * (len(member.lower) if member else kinds.joints)
    return 2 + 2 * kinds.joints + sizes


def _limit_rows(
    kinds: LimitKinds, keys: Sequence[str], numbers: Any, common: Any, motion: tuple[Any, Any, Any]
) -> Any:
    """Return the values of limits at a place, divided by the magnitudes of their bounds.

    ``motion`` is s', s'' and s''' in the program's unit of time, the first common coefficient.
    """
    n, unit = kinds.joints, common[0]
    parts = [numbers[k * n : (k + 1) * n] for k in range(numbers.shape[0] // n)]
    v, a, j = (rate / unit**k for k, rate in enumerate(motion, start=1))
    q, tangent, curvature, bend = parts[:4]
    # Equations (5) to (7).
    qd = tangent * v
    qdd = tangent * a + curvature * v**2
    qddd = tangent * j + 3.0 * curvature * v * a + bend * v**3
    values = {"qdd": qdd, "qddd": qddd}
    if kinds.dynamics:
        per_a, per_square, held, per_a_rate, per_square_rate, held_rate = parts[4:]
        smoothing, viscous, dry = common[1], common[2 : 2 + n], common[2 + n : 2 + 2 * n]
        side = ca.tanh(qd / smoothing)
        values["tau"] = per_a * a + per_square * v**2 + held + viscous * qd + dry * side
        values["taud"] = (
            per_a * j
            + (per_a_rate + 2.0 * per_square) * v * a
            + per_square_rate * v**3
            + held_rate * v
            + viscous * qdd
            + dry * (1.0 - side**2) * qdd / smoothing
        )
    columns = {key: [value] for key, value in values.items()}
    if kinds.family is not None:
        state, function = [q, qd, qdd, qddd], None
        if kinds.dynamics:
            state += ca.vertsplit(ca.vertcat(values["tau"], values["taud"]))
            function = _given_torques(n)
        expressions = kinds.family.expressions(kinds.further, state, function)
        for key, (value, lower, upper) in expressions.items():
            member, bounds = kinds.family[key], {"lower": lower, "upper": upper}
            sides = [value - bounds[side] for side in _sides(member)]
            columns[key] = sides if member.varies else [value]
    rows, first = [numbers[:0]], 2 + 2 * n
    for key in (*kinds.of_acceleration, *kinds.of_rates):
        for column in columns[key]:
            size = common[first : first + column.shape[0]]
            first += column.shape[0]
            if key in keys:
                rows.append(column / size)
    return ca.vertcat(*rows)


@lru_cache(maxsize=16)
def _given_torques(n: int) -> ca.Function:
    """Return a function that passes on given torques and rates, one argument per number."""
    state = [ca.SX.sym(name, n) for name in ("q", "qd", "qdd", "qddd")]
    torques = [ca.SX.sym(f"torque_{k}") for k in range(2 * n)]
    return ca.Function(
        "given_torques", [*state, *torques], [ca.vertcat(*torques[:n]), ca.vertcat(*torques[n:])]
    )


IPOPT_TOLERANCE = 1e-7  # tolerance of a solve
MOST_ITERATIONS = 120  # iteration limit of a solve


@dataclass(frozen=True, eq=False)
class PlacesProgram:
    """All rows and their derivatives on some intervals; coefficients at places are parameters."""

    x: ca.MX
    p: ca.MX
    g: ca.MX
    cost: ca.MX
    slope: ca.MX
    entries: ca.MX
    places: tuple[np.ndarray, np.ndarray]  # rows and columns of the Jacobian's entries
    hessian: ca.Function
    used: tuple[np.ndarray, np.ndarray]  # coefficients of a mesh point and of an interval

    def solver(self, rows: np.ndarray, barrier: float, linear_solver: str) -> ca.Function:
        """Build IPOPT for some of the rows, with cached derivative functions."""
        height, width = self.g.shape[0], self.x.shape[0]
        new = np.full(height, -1)
        new[rows] = np.arange(rows.size)
        at, columns = self.places
        keep = np.flatnonzero(new[at] >= 0)
        # CasADi's sparsity is column-major: entries are sorted by column, and by row within it.
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
        # CasADi takes these functions from the cache instead of deriving its own.
        cache = {
            "nlp_grad": ca.Function("nlp_grad", curvature, [self.cost, g, stationarity, nothing]),
            "nlp_jac_g": ca.Function("nlp_jac_g", [self.x, self.p], [g, jacobian]),
            "nlp_grad_f": ca.Function("nlp_grad_f", [self.x, self.p], [self.cost, self.slope]),
            "nlp_hess_l": ca.Function(
                "nlp_hess_l", curvature, [self.hessian(self.x, self.p, lam_f, every)]
            ),
        }
        options: dict[str, Any] = {
            "tol": IPOPT_TOLERANCE,
            "max_iter": MOST_ITERATIONS,
            "linear_solver": linear_solver,
            "bound_push": barrier,
            "bound_frac": barrier,
            "mu_init": barrier,
        }
        program = {"x": self.x, "p": self.p, "f": self.cost, "g": g}
        options = as_ipopt_knows(options) | time_limits(deadline.work_left())
        return ipopt("timing", program, options, cache=cache)


@lru_cache(maxsize=8)
def program_of(kinds: LimitKinds, n: int, breaks: tuple[int, ...], fast: bool) -> PlacesProgram:
    """Assemble the program on n intervals.

    The unknowns are s' at the n + 1 places; s'' there, and once more from the left at places where
    s'' may jump (``breaks``); the times of the intervals; the changes of s''' in them. The rows are
    those of the limits, place by place, followed by those of the intervals.
    """
    point, interval = kernels(kinds, fast)
    count = n + 1 + len(breaks)  # number of unknowns s''
    x = ca.MX.sym("x", n + 1 + count + 2 * n)
    after, i = n + 1 + count, np.arange(n)
    right = np.arange(1, n + 1)
    right[np.array(breaks, dtype=int) - 1] = n + 1 + np.arange(len(breaks))
    of_points = np.vstack(
        [np.append(np.arange(n + 1), breaks).astype(int), n + 1 + np.arange(count)]
    )
    of_intervals = np.vstack([i, n + 1 + i, after + i, i + 1, n + 1 + right, after + n + i])
    groups = (point, of_points), (interval, of_intervals)
    sizes = [kernel.used.size * places.shape[1] for kernel, places in groups]
    p = ca.MX.sym("p", common_size(kinds) + sum(sizes))
    common, *numbers = ca.vertsplit(p, np.cumsum([0, common_size(kinds), *sizes]).tolist())
    values, cost, slope = [], ca.MX(0), ca.MX.zeros(x.shape[0])
    entries, rows, columns, bends, bend_places = [], [], [], [], []
    heights = [kernel.values.size1_out(0) for kernel in (point, interval)]
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", heights[0] * count + heights[1] * n)
    first = 0
    for (kernel, places), height, constants in zip(groups, heights, numbers, strict=True):
        width = places.shape[1]
        w = ca.reshape(x[places.ravel("F").tolist()], places.shape[0], width)
        given = [w, ca.reshape(constants, kernel.used.size, width), common]
        lines = first + np.arange(height)[:, None] + height * np.arange(width)
        value, added = _mapped(kernel.values, width)(*given)
        values.append(ca.vec(value))
        cost = cost + ca.sum2(added)
        nonzeros, gradient = _mapped(kernel.slopes, width)(*given)
        entries.append(ca.vec(nonzeros))
        r, c = kernel.jacobian
        rows.append(lines[r].ravel("F"))
        columns.append(places[c].ravel("F"))
        for line, place in enumerate(places):
            slope[place.tolist()] += gradient[line, :].T
        lam = ca.reshape(lam_g[first : first + height * width], height, width)
        bend = _mapped(kernel.curvature, width)(*given, lam, ca.repmat(lam_f, 1, width))
        bends.append(ca.vec(bend))
        r, c = kernel.hessian
        bend_places.append(np.sort([places[r].ravel("F"), places[c].ravel("F")], axis=0))
        first += height * width
    # Intervals share unknowns at mesh points, so Hessian entries of several kernels add up in one
    # place: ``gather`` is the matrix of ones that sums them.
    at_rows, at_columns = np.hstack(bend_places)
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
    return PlacesProgram(
        x, p, ca.vertcat(*values), ca.densify(cost), slope, ca.vertcat(*entries),
        (np.concatenate(rows), np.concatenate(columns)),
        ca.Function("hessian", [x, p, lam_f, lam_g], [hessian]),
        (point.used, interval.used),
    )  # fmt: skip


def _mapped(kernel: ca.Function, count: int) -> ca.Function:
    """Return a kernel mapped over places with common coefficients."""
    return kernel.map("places", "serial", count, [2], [])
