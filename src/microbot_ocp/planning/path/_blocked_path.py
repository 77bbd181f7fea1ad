"""The limits that make a path infeasible, and the least relaxation that makes it feasible.

On a grid the timing of a path is a linear program in u = s'' and x = s'^2. If it is infeasible, all
limits kept as half planes are widened by a common share of themselves, and the program finds the
smallest such share. The problem is convex, so the result holds for every timing on that grid. The
multipliers identify the decisive limit and its place. Viscous friction, proportional to the root of
x, is left out.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.limits import LimitFamily
from microbot_ocp.planning.path._curve import TINY, PathCurve
from microbot_ocp.planning.path._limits import FAR, NEGLIGIBLE
from microbot_ocp.planning.path._reachability import CurveLimits

GRID = 150  # number of intervals of a curve
NOTHING = 1e-6  # relaxation that counts as zero, share of the limits


class Blocked(NamedTuple):
    """The limit that makes a curve infeasible.

    Attributes
    ----------
    key : key of the limit
    component : index of its component
    share : relaxation of all limits that makes the curve feasible, share of each limit
    limit : bound of the decisive limit in its unit
    at : parameter of the curve
    q : pose [n] there, rad (m)
    """

    key: str
    component: int
    share: float
    limit: float
    at: float
    q: FloatArray


def blocking_limit(family: LimitFamily, curve: PathCurve, fast: bool) -> Blocked | None:
    """Find the limit that makes a curve infeasible; None for a feasible one.

    docs/theory/path_timing.md, "One program on places", end.

    Parameters
    ----------
    family : LimitFamily
    curve : PathCurve
        Curve between two stops.
    fast : bool
        Use compiled functions.
    """
    along = CurveLimits.of(family, curve, GRID, fast)
    rows, limits = along.rows, along.limits
    if not rows.names:
        return None
    lower, upper = (
        np.stack([getattr(limits.half_planes[key], side)[:, j] for key, j in rows.names], axis=1)
        for side in ("lower", "upper")
    )
    size = np.maximum(*(np.where(np.isfinite(b), np.abs(b), 0.0) for b in (lower, upper)))
    count = along.s.size - 1
    # A typical x, at which x or u meets a limit, scales the program to order one.
    most, length = along.speed_limit, float(along.s[-1] - along.s[0])
    used = np.abs(rows.per_x) + np.abs(rows.per_u) / length
    room = np.where(np.isfinite(size), size, np.inf) / np.maximum(used, TINY)
    unit_x = float(np.median(np.minimum(room.min(axis=1)[: count + 1], most)))
    unit_u = unit_x / length
    x, start, end = ca.MX.sym("x", count + 1), ca.MX.sym("start", count), ca.MX.sym("end", count)
    share = ca.MX.sym("share")
    # Equation of motion: x_{i+1} = x_i + d (u_start + u_end), the integral of dx/ds = 2 u.
    motion = x[1:] - x[:-1] - unit_u / unit_x * np.diff(along.s) * (start + end)
    bounded, limited = [], []
    for nodes, at, u in ((np.arange(count), x[:-1], start), (rows.right, x[1:], end)):
        for k, sign in itertools.product(range(len(rows.names)), (1.0, -1.0)):
            bound = (rows.upper if sign > 0 else rows.lower)[nodes, k]
            scale = np.maximum(size[nodes, k], NEGLIGIBLE)
            value = unit_x * rows.per_x[nodes, k] * at + unit_u * rows.per_u[nodes, k] * u
            kept = np.flatnonzero(np.isfinite(bound))
            bounded.append((sign * (value - np.nan_to_num(bound)) / scale - share)[kept])
            limited += [(k, node, sign) for node in nodes[kept].tolist()]
    highest = np.where(most < FAR, most / unit_x, np.inf)
    for point, free in ((0, curve.start_free), (count, curve.end_free)):
        highest[point] = highest[point] if free else 0.0
    solver = ca.qpsol(
        "blocked",
        "highs",
        {
            "x": ca.vertcat(x, share, start, end),
            "f": share,
            "g": ca.vertcat(motion, *bounded),
        },
        {"error_on_fail": False, "highs": {"output_flag": False}},
    )
    unbounded = np.full(2 * count, np.inf)
    answer = solver(
        lbg=np.append(np.zeros(count), np.full(len(limited), -np.inf)),
        ubg=0.0,
        lbx=np.append(np.zeros(count + 2), -unbounded),
        ubx=np.concatenate([highest, [np.inf], unbounded]),
    )
    gives = float(answer["f"])
    if not solver.stats()["success"] or gives <= NOTHING:
        return None
    k, node, sign = limited[np.abs(np.array(answer["lam_g"]).ravel()[count:]).argmax()]
    key, component = rows.names[k]
    point = node if node <= count else int(np.flatnonzero(rows.right == node)[0]) + 1
    return Blocked(
        key=key,
        component=component,
        share=gives,
        limit=float((upper if sign > 0 else lower)[node, k]),
        at=float(along.s[point]),
        q=along.nodes.position[node],
    )
