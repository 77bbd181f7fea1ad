"""The nonlinear program of a timing under rate limits, with derivatives put together by hand.

Every interval and every mesh point is one call of a small kernel, whose rows, Jacobian entries and
Hessian entries go to known places: nothing is derived or compiled anew for another path.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.codegen import compile_functions
from microbot_ocp.ocp.solvers import as_ipopt_knows

SMOOTHING = 1e-8  # weight of the squared s''': picks one timing where many are equally fast
TOLERANCE = 1e-7
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
# Where in an interval the limit of s' is kept: on a stretch at the limit its middle alone would
# leave s'' an error that is the same in every interval
THIRDS = (1 / 3, 2 / 3)
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
            (np.array(rows, dtype=int), np.array(columns, dtype=int))
            for rows, columns in (k.sparsity().get_triplet() for k in (jacobian, hessian))
        ]
        return cls(values_of, slopes, curvature, *places)


@lru_cache(maxsize=16)
def _kernels(at_points: int, rates: int, fast: bool) -> tuple[_Kernel, _Kernel]:
    """Of a mesh point (v, a), and of an interval.

    That has v, a, its time h, v and a at its end, and d, by which s''' changes evenly in it. With a
    constant s''' a limited rate would be met at one of its ends alone, which costs in proportion to
    the length of the intervals.
    """
    w, c = ca.SX.sym("w", 2), ca.SX.sym("c", len(PARTS) * at_points)
    parts = ca.vertsplit(c, at_points) if at_points else [ca.SX(0, 1)] * len(PARTS)
    point = _Kernel.of(w, c, _terms(parts, w[0], w[1], None), ca.SX(0), fast)
    count = len(PARTS)
    w, c = ca.SX.sym("w", 6), ca.SX.sym("c", count * (3 * rates + at_points) + 1)
    v, a, h, v_end, a_end, d = ca.vertsplit(w)
    j, v_middle = (a_end - a) / h, v + h * (3.0 * a + a_end) / 8.0 - h**2 * d / 24.0
    parts = ca.vertsplit(c[: 3 * count * rates], rates)
    inner = c[3 * count * rates : -1]
    middle = ca.vertsplit(inner, at_points) if at_points else [ca.SX(0, 1)] * count
    start, end, within = parts[:count], parts[count : 2 * count], parts[2 * count :]
    a_middle = 0.5 * (a + a_end) - h * d / 8.0
    values = ca.vertcat(
        v_end - v - 0.5 * h * (a + a_end) + h**2 * d / 12.0,
        c[-1] - h * v - h**2 * (2.0 * a + a_end) / 6.0 + h**3 * d / 24.0,
        _terms(start, v, a, j - 0.5 * d),
        _terms(end, v_end, a_end, j + 0.5 * d),
        _terms(within, v_middle, a_middle, j),
        _terms(middle, v_middle, a_middle, None),
        *(v + h * x * (a + h * x * (0.5 * (j - 0.5 * d) + x * d / 6.0)) for x in THIRDS),
    )
    return point, _Kernel.of(w, c, values, h + SMOOTHING * h * (j**2 + d**2 / 12.0), fast)


@dataclass(frozen=True, eq=False)
class Program:
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

    def solver(self, rows: np.ndarray, barrier: float, linear_solver: str) -> ca.Function:
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
        push: dict[str, Any] = {
            "linear_solver": linear_solver,
            "bound_push": barrier,
            "bound_frac": barrier,
            "mu_init": barrier,
        }
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
                "ipopt": as_ipopt_knows({**OPTIONS, **push, **own}),
                "cache": cache,
            },
        )


@lru_cache(maxsize=8)
def program_of(n: int, at_points: int, rates: int, fast: bool) -> Program:
    point, interval = _kernels(at_points, rates, fast)
    x = ca.MX.sym("x", 4 * n + 2)
    own = point.values.size1_in(1), interval.values.size1_in(1)
    half = len(PARTS) * rates
    p = ca.MX.sym("p", own[0] * (n + 1) + own[1] * n)
    edges = np.cumsum([0, own[0] * (n + 1), *3 * (half * n,), own[0] * n, n]).tolist()
    at, begin, end, within, middle, steps = (
        ca.reshape(p[a:b], -1, size)
        for a, b, size in zip(edges[:-1], edges[1:], (n + 1, *5 * (n,)), strict=True)
    )
    k, i = np.arange(n + 1), np.arange(n)
    of_points = np.vstack([k, n + 1 + k])
    of_intervals = np.vstack([i, n + 1 + i, 2 * n + 2 + i, i + 1, n + 2 + i, 3 * n + 2 + i])
    groups = []
    for kernel, places, constants in (
        (point, of_points, at),
        (interval, of_intervals, ca.vertcat(begin, end, within, middle, steps)),
    ):
        count = places.shape[1]
        w = ca.reshape(x[places.ravel("F").tolist()], places.shape[0], count)
        groups.append((kernel, places, w, constants, count))
    # rows: two equations an interval, those of the points, rates at starts, rates at ends, rates
    # in the middles, other rows there, speeds there
    first = 2 * n + at_points * (n + 1)
    inner = first + 3 * rates * n
    row_places = [
        2 * n + np.arange(at_points)[:, None] + at_points * k,
        np.vstack(
            [
                np.array([[0], [1]]) + 2 * i,
                first + np.arange(rates)[:, None] + rates * i,
                first + rates * n + np.arange(rates)[:, None] + rates * i,
                first + 2 * rates * n + np.arange(rates)[:, None] + rates * i,
                inner + np.arange(at_points)[:, None] + at_points * i,
                inner + at_points * n + np.array([[0], [1]]) + 2 * i,
            ]
        ),
    ]
    values, cost, slope = [], ca.MX(0), ca.MX.zeros(x.shape[0])
    entries, rows, columns = [], [], []
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", inner + (at_points + 2) * n)
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
    return Program(
        x, p, g, ca.densify(cost), slope, ca.vertcat(*entries),
        (np.concatenate(rows), np.concatenate(columns)),
        ca.Function("hessian", [x, p, lam_f, lam_g], [hessian]),
        ca.Function("rows", [x, p], [g]),
    )  # fmt: skip
