"""Placement of mesh points at switches."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base.checks import ROUNDING, FloatArray
from microbot_ocp.ocp.arcs._detector import Switch

BRACKET = 0.1  # distance of added points from a junction, as a fraction of the adjacent interval
SHORTENED_RAMP = 0.125  # distance of mesh points from a switch, as a fraction of its ramp


def hold(
    mesh: FloatArray, places: ArrayLike, accuracy: float, taken: Sequence[float] = ()
) -> FloatArray:
    """Move the nearest free mesh point to every place, or add a point there.

    Mesh points within ``accuracy`` of a place in ``taken`` are not moved.
    """
    points, held = mesh.copy(), list(taken)
    for place in np.unique(np.clip(places, 0.0, 1.0)).tolist():
        if min(place, 1.0 - place) > accuracy:
            points = _with_point(points, place, held, accuracy)
            held.append(place)
    return points[np.concatenate([[True], np.diff(points) > ROUNDING])]


def move_to_switches(mesh: FloatArray, switches: Sequence[Switch], accuracy: float) -> FloatArray:
    """Move or add mesh points so that controls switch at mesh points.

    The ramp of a continuous control is shortened: points are set on both sides of the switch, and
    points inside the ramp are dropped.
    """
    points = mesh.copy()
    for ramp in (s for s in switches if s.continuous and s.offset > accuracy):
        reach = SHORTENED_RAMP * (ramp.end - ramp.begin)
        inside = (points > ramp.begin) & (points < ramp.end)
        sides = [p for p in (ramp.place - reach, ramp.place + reach) if 0.0 < p < 1.0]
        points = np.sort(np.concatenate([points[~inside], sides]))
    jumps = [s for s in switches if not s.continuous]
    taken = [s.place for s in jumps if s.offset <= accuracy]
    return hold(points, [s.place for s in jumps if s.offset > accuracy], accuracy, taken)


def _with_point(
    points: FloatArray, place: float, held: Sequence[float], accuracy: float
) -> FloatArray:
    """Set a point at a place: move the nearest one, unless it is an end or holds another place.

    A newly set point gets neighbours that keep its intervals short. Otherwise the rest of the other
    arc inside a long interval would take over the multipliers of that arc.
    """
    nearest = int(np.abs(points - place).argmin())
    point = float(points[nearest])
    is_new = abs(point - place) > accuracy
    if 0.0 < point < 1.0 and all(abs(point - other) > accuracy for other in held):
        points = np.delete(points, nearest)
    before, after = points[points < place].max(), points[points > place].min()
    reach = BRACKET * min(place - before, after - place)
    sides = [place - reach, place + reach] if is_new and reach > accuracy else []
    return np.sort(np.concatenate([points, [place], sides]))
