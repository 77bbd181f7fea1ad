"""Mesh points where controls switch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.ocp.arcs._detector import Switch


@dataclass(frozen=True)
class MeshPointSettings:
    """Mesh points at junctions and switches.

    Attributes
    ----------
    bracket : of the interval next to a switch: how near to it points are added
    ramp : of a ramp's length, that is left to each side of the switch
    """

    bracket: float = 0.1
    ramp: float = 0.125


MESH_POINTS = MeshPointSettings()


def hold(
    mesh: FloatArray, places: ArrayLike, accuracy: float, taken: Sequence[float] = ()
) -> FloatArray:
    """Move the nearest mesh point that is not taken to every place, or add a point there."""
    points, held = mesh.copy(), list(taken)
    for place in np.unique(np.clip(places, 0.0, 1.0)).tolist():
        if min(place, 1.0 - place) > accuracy:
            points = _with_point(points, place, held, accuracy)
            held.append(place)
    return points[np.concatenate([[True], np.diff(points) > 1e-9])]


def move_to_switches(mesh: FloatArray, switches: Sequence[Switch], accuracy: float) -> FloatArray:
    """Put mesh points where the controls switch.

    A ramp of a continuous control becomes shorter: points go to both sides of the switch, and what
    was inside the ramp is dropped.
    """
    points = mesh.copy()
    for ramp in (s for s in switches if s.continuous and s.offset > accuracy):
        reach = MESH_POINTS.ramp * (ramp.end - ramp.begin)
        inside = (points > ramp.begin) & (points < ramp.end)
        sides = [p for p in (ramp.place - reach, ramp.place + reach) if 0.0 < p < 1.0]
        points = np.sort(np.concatenate([points[~inside], sides]))
    jumps = [s for s in switches if not s.continuous]
    taken = [s.place for s in jumps if s.offset <= accuracy]
    return hold(points, [s.place for s in jumps if s.offset > accuracy], accuracy, taken)


def _with_point(
    points: FloatArray, place: float, held: Sequence[float], accuracy: float
) -> FloatArray:
    """Put a point at a place: the nearest one, unless it is an end or holds another place.

    Where that is news, points on both sides keep the intervals at the place short: a rest of the
    other arc, be it ever so small, takes the multipliers of one of them.
    """
    nearest = int(np.abs(points - place).argmin())
    point = float(points[nearest])
    news = abs(point - place) > accuracy
    if 0.0 < point < 1.0 and all(abs(point - other) > accuracy for other in held):
        points = np.delete(points, nearest)
    before, after = points[points < place].max(), points[points > place].min()
    reach = MESH_POINTS.bracket * min(place - before, after - place)
    sides = [place - reach, place + reach] if news and reach > accuracy else []
    return np.sort(np.concatenate([points, [place], sides]))
