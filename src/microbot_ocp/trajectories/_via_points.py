"""Via points: checked once, with a choice of velocities (Craig, section 7.3)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError


class ViaPoints(NamedTuple):
    """Checked via points: positions [m,n] (rad or m) at times [m] (s)."""

    q: FloatArray
    t: FloatArray

    def given(self, name: str, values: ArrayLike | None, unit: str) -> FloatArray:
        """Return checked values at the via points [m,n]; zeros where none are given."""
        if values is None:
            return np.zeros_like(self.q)
        return checks.array(name, values, self.q.shape, unit)


def via_points(via_q: ArrayLike, via_t: ArrayLike) -> ViaPoints:
    """Check via points and their times.

    Parameters
    ----------
    via_q : array_like [m,n]
        Joint positions, rad (prismatic: m); at least two rows.
    via_t : array_like [m]
        Strictly increasing times, s.

    Returns
    -------
    ViaPoints

    Raises
    ------
    InputError
        Fewer than two via points, wrong shapes, anything not finite, times that do not increase.
    """
    q = checks.array("via_q", via_q, (None, None), "rad")
    if q.shape[0] < 2 or q.shape[1] < 1:
        raise InputError(
            f"via_q must hold at least two via points of at least one joint, not {list(q.shape)}"
        )
    return ViaPoints(q, checks.times("via_t", via_t, len(q)))


def via_velocities(via: ViaPoints) -> FloatArray:
    """Return velocities at via points by the heuristic of Craig, section 7.3.

    At each inner via point and for each joint: zero where the slope of the straight lines between
    the via points changes sign (or is zero on a side), else the mean of the two slopes. Zero at
    both ends.

    Parameters
    ----------
    via : ViaPoints
        Positions [m,n] at times [m].

    Returns
    -------
    array [m,n]
        Velocities, rad/s (m/s).

    Examples
    --------
    >>> via_velocities(via_points([[0.0, 0.0], [1.0, 1.0], [3.0, 0.0]], [0.0, 1.0, 2.0])).tolist()
    [[0.0, 0.0], [1.5, 0.0], [0.0, 0.0]]
    """
    slope = np.diff(via.q, axis=0) / np.diff(via.t)[:, None]
    velocity = np.zeros_like(via.q)
    same_sign = slope[:-1] * slope[1:] > 0
    velocity[1:-1] = np.where(same_sign, 0.5 * (slope[:-1] + slope[1:]), 0.0)
    return velocity
