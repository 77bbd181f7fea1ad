"""The limits that make a path infeasible, and the least relaxation that makes it feasible.

On a grid the timing of a path is a linear program in u = s'' and x = s'^2. If it is infeasible, all
limits kept as half planes are widened by a common share of themselves, and the program finds the
smallest such share. The problem is convex, so the result holds for every timing on that grid. The
multipliers identify the decisive limit and its place. Viscous friction, proportional to the root of
x, is left out.
"""

from __future__ import annotations

from typing import Any, NamedTuple

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
    step = np.diff(along.s)
    # A typical x scales the program to order one.
    room = np.where(np.isfinite(size), size, np.inf) / np.maximum(np.abs(rows.per_x), TINY)
    most = along.speed_limit
    unit_x = float(np.median(np.minimum(room.min(axis=1)[: count + 1], most)))
    unit_u = unit_x / float(along.s[-1] - along.s[0])
    # Unknowns: x at the points, u at the start and at the end of every interval, and the share.
    columns = 3 * count + 2
    entries: list[tuple[Any, Any, Any]] = []
    highest, limited, first = [], [], 0
    for ends, x_at, u_at in (
        (np.arange(count), np.arange(count), count + 1 + np.arange(count)),
        (rows.right, np.arange(1, count + 1), 2 * count + 1 + np.arange(count)),
    ):
        scale = np.maximum(size[ends], NEGLIGIBLE)
        bounds = np.stack([rows.upper[ends] / scale, -rows.lower[ends] / scale]).transpose(2, 0, 1)
        k, side, i = np.nonzero(np.isfinite(bounds))
        at, sign = first + np.arange(k.size), 1.0 - 2.0 * side
        entries += [
            (at, x_at[i], sign * (rows.per_x[ends] / scale)[i, k] * unit_x),
            (at, u_at[i], sign * (rows.per_u[ends] / scale)[i, k] * unit_u),
            (at, np.full(k.size, columns - 1), np.full(k.size, -1.0)),
        ]
        highest.append(bounds[k, side, i])
        limited.append((k, ends[i], sign))
        first += k.size
    # Equation of motion: x_{i+1} = x_i + d (u_start + u_end), the integral of dx/ds = 2 u.
    at = first + np.arange(count)
    share = step * unit_u / unit_x
    entries += [
        (at, np.arange(count), np.ones(count)),
        (at, np.arange(1, count + 1), -np.ones(count)),
        (at, count + 1 + np.arange(count), share),
        (at, 2 * count + 1 + np.arange(count), share),
    ]
    i, j, values = (np.concatenate([e[k] for e in entries]) for k in range(3))
    matrix = ca.DM.triplet(i.tolist(), j.tolist(), values, first + count, columns)
    below, above = np.full(columns, -np.inf), np.full(columns, np.inf)
    below[: count + 1], above[: count + 1] = 0.0, np.where(most < FAR, most / unit_x, np.inf)
    for point, free in ((0, curve.start_free), (count, curve.end_free)):
        above[point] = above[point] if free else 0.0
    below[-1] = 0.0
    objective = ca.DM(columns, 1)
    objective[-1] = 1.0
    solver = ca.conic(
        "blocked",
        "highs",
        {"h": ca.Sparsity(columns, columns), "a": matrix.sparsity()},
        {"error_on_fail": False, "highs": {"output_flag": False}},
    )
    answer = solver(
        g=objective,
        a=matrix,
        lba=np.append(np.full(first, -np.inf), np.zeros(count)),
        uba=np.concatenate([*highest, np.zeros(count)]),
        lbx=below,
        ubx=above,
    )
    gives = float(answer["x"][-1])
    if not solver.stats()["success"] or gives <= NOTHING:
        return None
    decides = int(np.abs(np.array(answer["lam_a"]).ravel()[:first]).argmax())
    k, node, sign = (np.concatenate(parts)[decides] for parts in zip(*limited, strict=True))
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
