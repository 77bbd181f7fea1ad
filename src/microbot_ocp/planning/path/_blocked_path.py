"""What a path that cannot be travelled asks too much: limits may give, as little as possible.

On a grid the timing of a path is a linear program in u = s'' and x = s'^2. Where it has no solution
all limits that are kept as half planes are widened by one share of themselves, the smallest that
leaves one: a convex problem, so what it finds holds for every timing on that grid. The multipliers
say which limit decides, and where. Viscous friction, which goes with the root of x, is left out.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.limits import LimitFamily
from microbot_ocp.planning.path._curve import PathCurve
from microbot_ocp.planning.path._limits import FAR
from microbot_ocp.planning.path._reachability import CurveLimits

GRID = 150  # intervals of a curve
NOTHING = 1e-6  # share of the limits: what need not give


class Blocked(NamedTuple):
    """The limit that decides whether a curve can be travelled.

    ``share`` is that of the limits by which they have to give, ``limit`` the bound of the deciding
    one in its unit, ``at`` the parameter of the curve, ``q`` [n] the pose there.
    """

    key: str
    component: int
    share: float
    limit: float
    at: float
    q: FloatArray


def blocking_limit(family: LimitFamily, curve: PathCurve, fast: bool) -> Blocked | None:
    """Find the limit that keeps a curve from being travelled; None where there is none.

    docs/theory/path_timing.md, "One program on places", end.

    Parameters
    ----------
    family : LimitFamily
    curve : PathCurve
        Between two stops.
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
    # a typical x, so that the program is of order one
    room = np.where(np.isfinite(size), size, np.inf) / np.maximum(np.abs(rows.per_x), 1e-300)
    most = along.speed_limit
    unit_x = float(np.median(np.minimum(room.min(axis=1)[: count + 1], most)))
    unit_u = unit_x / float(along.s[-1] - along.s[0])
    # unknowns: x at the points, u at the start and at the end of every interval, the share
    columns = 3 * count + 2
    entries: list[tuple[Any, Any, Any]] = []
    highest, limited, first = [], [], 0
    for ends, x_at, u_at in (
        (np.arange(count), np.arange(count), count + 1 + np.arange(count)),
        (rows.right, np.arange(1, count + 1), 2 * count + 1 + np.arange(count)),
    ):
        scale = np.maximum(size[ends], 1e-12)
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
    # x at the end of an interval is that at its start and the mean of u times twice its length
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
