"""Meshes as data: fractions of a phase, and where it matters the degree of every interval."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError

IntArray = np.ndarray


@dataclass(frozen=True, eq=False, init=False)
class Mesh:
    """Mesh points of a phase, and the degree of collocation in every interval.

    Parameters
    ----------
    fractions : array_like [N+1] or int
        Increasing from 0 to 1, or the number of equal intervals.
    degrees : array_like of int [N], or int, optional
        Default: that of the scheme, in all intervals. Only collocation has degrees.

    Examples
    --------
    >>> Mesh([0.0, 0.5, 1.0], degrees=[3, 5]).degrees.tolist()
    [3, 5]
    """

    fractions: FloatArray
    degrees: IntArray | None = None

    def __init__(self, fractions: ArrayLike | int, degrees: ArrayLike | int | None = None) -> None:
        points = _fractions(fractions)
        object.__setattr__(self, "fractions", points)
        object.__setattr__(self, "degrees", _degrees(degrees, points.size - 1))

    @property
    def intervals(self) -> int:
        """Number of intervals N."""
        return self.fractions.size - 1

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        degrees = None if self.degrees is None else self.degrees.tolist()
        return {"fractions": self.fractions.tolist(), "degrees": degrees}

    def __repr__(self) -> str:
        degrees = "" if self.degrees is None else f", degrees={self.degrees.tolist()}"
        return f"Mesh({self.fractions.tolist()}{degrees})"


MeshLike = int | ArrayLike | Mesh
Meshes = Sequence[MeshLike] | MeshLike  # one a phase, or one for all


def mesh_of(given: MeshLike) -> Mesh:
    """Return a mesh from a number of intervals, from fractions, or as it is."""
    return given if isinstance(given, Mesh) else Mesh(given)


def with_points(mesh: Mesh, fractions: Sequence[float]) -> Mesh:
    """Return the mesh with some fractions among its points.

    The nearest point of its own moves there, where it is nearer than half of the shorter interval
    beside it; otherwise there is one more. Chosen degrees stay those of the intervals.
    """
    points, degrees = mesh.fractions.tolist(), mesh.degrees
    wanted = [f for f in fractions if f not in points]
    held = set(fractions)
    for fraction in wanted:
        place = int(np.searchsorted(points, fraction))
        near = min((place - 1, place), key=lambda k: abs(points[k] - fraction))
        movable = 0 < near < len(points) - 1 and points[near] not in held
        gap = abs(points[near] - fraction)
        if movable and 2 * gap < min(np.diff(points[near - 1 : near + 2])):
            points[near] = fraction
        else:
            points.insert(place, fraction)
            if degrees is not None:
                degrees = np.insert(degrees, place, degrees[place - 1])
    return Mesh(points, degrees) if wanted else mesh


MOST_INTERVALS = 100_000


def _fractions(mesh: ArrayLike | int) -> FloatArray:
    if isinstance(mesh, (int, np.integer)):
        if mesh < 2:
            raise InputError(f"mesh must have at least 2 intervals, not {mesh}")
        checks.size("the number of intervals", float(min(mesh, 10**300)), MOST_INTERVALS)
        return np.linspace(0.0, 1.0, int(mesh) + 1)
    if isinstance(mesh, float):
        raise InputError(f"mesh must be a whole number of intervals or fractions, not {mesh}")
    given = checks.array("mesh", mesh, (None,))
    if given.size < 3 or given[0] != 0.0 or given[-1] != 1.0 or np.any(np.diff(given) <= 0):
        raise InputError("mesh must be increasing fractions from 0 to 1, or a number of intervals")
    return given


def _degrees(degrees: ArrayLike | int | None, intervals: int) -> IntArray | None:
    if degrees is None:
        return None
    given = np.asarray(degrees)
    if given.ndim == 0:
        given = np.full(intervals, given)
    if given.shape != (intervals,) or not np.issubdtype(given.dtype, np.integer):
        raise InputError(
            f"degrees must be a whole number or {intervals} of them, one an interval, "
            f"not {degrees!r}"
        )
    return given.astype(int)
