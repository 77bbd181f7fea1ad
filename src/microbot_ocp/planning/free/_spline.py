"""Cubic B-splines on the meshes of phases, in the unknowns of the flat program.

A continuous, piecewise linear acceleration is the second derivative of a cubic spline. In a phase
of duration T with N intervals the position is ``q(s) = sum_j B_j(s) c_j`` with N + 3 coefficients
and s = t / T. Position, velocity and acceleration at an end determine the three coefficients there:

``c_0 = q,  c_1 = q + T v / B_1'(0),  c_2 = q - B_1'' T v / (B_2'' B_1') + T^2 a / B_2''``

Phases therefore share q, v and a at via points. Each unknown u_m has a power p_m of T: 0 for a
coefficient and for q, 1 for v, 2 for a. Derivative d of the position at a point is the sum of
``W_dm T^(p_m - d) u_m`` over the few unknowns in the window of its interval.

Theory: docs/theory/flat.md. Bases: L. Piegl, W. Tiller, The NURBS Book, 2nd ed., section 2.5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from microbot_ocp._base.checks import FloatArray

IntArray = np.ndarray

DEGREE = 3
ENDS = 3  # number of coefficients that q, v and a determine at either end
PLACES = np.array([0.0, 0.5, 1.0])  # places of limits, shares of an interval
# Slope of the parabola through values at the places, at start and end, times half the interval. A
# mean slope over half an interval would let rates exceed their limits by a share of its length.
SLOPES = np.array([[-1.5, 2.0, -0.5], [0.5, -2.0, 1.5]])


def local_bases(
    knots: FloatArray, span: IntArray, s: FloatArray, degree: int, order: int
) -> FloatArray:
    """Return a derivative of the nonzero basis functions at places [S]: [S,degree+1].

    Parameters
    ----------
    knots : array
    span : array of int [S]
        Index of the last knot at or before each place.
    s : array [S]
        Places.
    degree, order : int
        Degree of the spline and order of the derivative.
    """
    if order > 0:
        # B'_{j,p} = p (B_{j,p-1} / (t_{j+p} - t_j) - B_{j+1,p-1} / (t_{j+p+1} - t_{j+1})).
        lower = local_bases(knots, span, s, degree - 1, order - 1)
        bases = np.zeros((s.size, degree + 1))
        for r in range(degree):
            width = knots[span + 1 + r] - knots[span + 1 - degree + r]
            term = degree * lower[:, r] / width
            bases[:, r] -= term
            bases[:, r + 1] += term
        return bases
    bases = np.ones((s.size, 1))
    # Cox-de Boor recursion: each degree follows from the one below by convex combinations.
    for k in range(1, degree + 1):
        higher = np.zeros((s.size, k + 1))
        for r in range(k):
            right, left = knots[span + 1 + r] - s, s - knots[span + 1 - k + r]
            share = bases[:, r] / (right + left)
            higher[:, r] += right * share
            higher[:, r + 1] += left * share
        bases = higher
    return bases


def _end_relations(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return factors [3,3] of q, T v and T^2 a in the coefficients at an end, outermost first.

    ``first`` and ``second`` [3] are derivatives of their basis functions at the end.
    """
    return np.array(
        [
            [1.0, 0.0, 0.0],
            [1.0, 1.0 / first[1], 0.0],
            [1.0, -second[1] / (second[2] * first[1]), 1.0 / second[2]],
        ]
    )


@dataclass(frozen=True, eq=False)
class Windows:
    """Intervals, or ends of phases, whose motion depends on the same number of unknowns.

    Attributes
    ----------
    phase : array of int [K]
    columns : array of int [K,M]
        Index of the first of the n entries of each unknown.
    powers : array [K,M]
        Power of the duration of each unknown.
    anchored : array [K,M]
        One for positions at via points, zero for coefficients: these are relative to the position
        at the start of the phase, which is subtracted from the former.
    weights : array [K,3,3,M]
        W, for position, velocity and acceleration at the start, middle and end of the interval.
    jerks : array [K,M]
        W of the jerk, which is constant in an interval.
    lengths : array [K]
        Length of the interval, share of the phase.
    points : array of int [K,3]
        Indices of the start, middle and end among all points.
    own : slice
        Points of the three that are evaluated in this window; each point has one window.
    """

    phase: IntArray
    columns: IntArray
    powers: FloatArray
    anchored: FloatArray
    weights: FloatArray
    jerks: FloatArray
    lengths: FloatArray
    points: IntArray
    own: slice

    @property
    def is_interval(self) -> bool:
        """True for intervals, False for ends of phases."""
        return self.own.start == 0


@dataclass(frozen=True, eq=False)
class SplineLayout:
    """Places of the unknowns of all phases, and the windows of all intervals.

    Unknowns are, joint by joint: position, velocity and acceleration at the first via point, the
    inner coefficients, position, velocity and acceleration at the next via point, and so on; at the
    end one duration per phase. A via point with a jump of the acceleration has two of them.

    Attributes
    ----------
    meshes : tuple of array [N+1]
    count : int
        Number of joints.
    nodes : tuple of (q, v, a before, a after)
        Index of the first entry of each, for every via point.
    inner : tuple of slice
        Inner coefficients [N-3,n] of every phase.
    durations : slice
        Durations of the phases.
    windows : tuple of Windows
        Windows of the intervals.
    ends : tuple of Windows
        Windows of the last point of every phase.
    points : int
        Number of points: start and middle of every interval, and the end of each phase.
    """

    meshes: tuple[FloatArray, ...]
    count: int
    nodes: tuple[tuple[int, int, int, int], ...]
    inner: tuple[slice, ...]
    durations: slice
    windows: tuple[Windows, ...]
    ends: tuple[Windows, ...]
    points: int

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self.durations.stop

    @property
    def every(self) -> tuple[Windows, ...]:
        """All windows, in which each point is evaluated once."""
        return (*self.windows, *self.ends)


def spline_layout(meshes: Sequence[FloatArray], count: int, jumps: Sequence[bool]) -> SplineLayout:
    """Return the layout of ``count`` joints on a mesh for each phase, with at least four intervals.

    ``jumps`` has True for a via point at which the acceleration may jump.
    """
    nodes: list[tuple[int, int, int, int]] = []
    inner: list[slice] = []
    at = 0

    def node(jump: bool) -> None:
        nonlocal at
        after = at + (3 if jump else 2) * count
        nodes.append((at, at + count, at + 2 * count, after))
        at = after + count

    node(jumps[0])
    for mesh, jump in zip(meshes, jumps[1:], strict=True):
        inner.append(slice(at, at + (mesh.size - 1 - DEGREE) * count))
        at = inner[-1].stop
        node(jump)
    parts = []
    first = 0
    for k, mesh in enumerate(meshes):
        parts.append(_phase_windows(k, mesh, count, nodes[k], inner[k], nodes[k + 1], first))
        first += 2 * mesh.size - 1
    windows = _grouped([w for intervals, _ in parts for w in intervals], slice(0, 2))
    ends = _grouped([end for _, end in parts], slice(2, 3))
    layout = tuple(nodes), tuple(inner), slice(at, at + len(meshes)), windows, ends
    return SplineLayout(tuple(meshes), count, *layout, first)


_Window = tuple[int, IntArray, FloatArray, FloatArray, FloatArray, FloatArray, float, IntArray]


def _phase_windows(
    phase: int,
    mesh: FloatArray,
    count: int,
    start: tuple[int, int, int, int],
    inner: slice,
    end: tuple[int, int, int, int],
    first_point: int,
) -> tuple[list[_Window], _Window]:
    """Return the windows of all intervals of a phase, and the window of its last point."""
    intervals = mesh.size - 1
    knots = np.concatenate([mesh[:1].repeat(DEGREE), mesh, mesh[-1:].repeat(DEGREE)])
    span = (np.arange(intervals) + DEGREE)[:, None] + np.zeros(PLACES.size, dtype=int)
    s = mesh[:-1, None] + PLACES * np.diff(mesh)[:, None]
    bases = np.stack(
        [local_bases(knots, span.ravel(), s.ravel(), DEGREE, d) for d in range(DEGREE + 1)], axis=1
    ).reshape(intervals, PLACES.size, DEGREE + 1, DEGREE + 1)
    q, v, _, a = start
    columns = np.concatenate(
        [[q, v, a], np.arange(inner.start, inner.stop, count), [end[2], end[1], end[0]]]
    )
    powers = np.zeros(columns.size)
    powers[1:3] = powers[-2:-4:-1] = 1.0, 2.0
    anchored = np.zeros(columns.size)
    anchored[[0, -1]] = 1.0
    relation = np.eye(columns.size)
    relation[:ENDS, :ENDS] = _end_relations(bases[0, 0, 1], bases[0, 0, 2])
    # The matrix ``relation`` maps unknowns to B-spline coefficients: identity, except for the
    # three at either end.
    last = _end_relations(bases[-1, -1, 1, ::-1], bases[-1, -1, 2, ::-1])
    relation[-ENDS:, -ENDS:] = last[::-1, ::-1]
    rows = list[_Window]()
    for k in range(intervals):
        low = 0 if k < ENDS else k
        high = columns.size if k + DEGREE >= intervals else k + DEGREE + 1
        weights = bases[k] @ relation[k : k + DEGREE + 1, low:high]
        points = first_point + 2 * k + np.arange(PLACES.size)
        length = float(mesh[k + 1] - mesh[k])
        at = columns[low:high], powers[low:high], anchored[low:high]
        rows.append((phase, *at, weights[:, :DEGREE], weights[0, DEGREE], length, points))
    return rows, rows[-1]


def _grouped(rows: Sequence[_Window], own: slice) -> tuple[Windows, ...]:
    """Return the windows grouped by their number of unknowns."""
    grouped = []
    for size in sorted({row[1].size for row in rows}):
        parts = zip(*(row for row in rows if row[1].size == size), strict=True)
        grouped.append(Windows(*map(np.array, parts), own=own))
    return tuple(grouped)
