"""Meshes: fractions of a phase."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError

IntArray = np.ndarray
MeshLike = int | ArrayLike
Meshes = Sequence[MeshLike] | MeshLike  # one a phase, or one for all

MOST_INTERVALS = 100_000


def mesh_of(mesh: MeshLike) -> FloatArray:
    """Return increasing fractions [N+1] from 0 to 1 from such, or from a number of intervals."""
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


def with_points(mesh: FloatArray, fractions: Sequence[float]) -> FloatArray:
    """Return the mesh with some fractions among its points.

    The nearest point of its own moves there, where it is nearer than half of the shorter interval
    beside it; otherwise there is one more.
    """
    points = mesh.tolist()
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
    return np.array(points) if wanted else mesh
