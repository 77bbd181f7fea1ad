"""What holds at the via points of a free motion, and which robot moves between them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.limits import LimitFamily
from microbot_ocp.robot import Robot

Bounds = tuple[FloatArray, FloatArray]


@dataclass(frozen=True)
class Row:
    """A condition on the state at a via point: ``expression(q, qd)`` [k] within bounds [k]."""

    name: str
    expression: Callable[[Any, Any], Any]
    bounds: Bounds


@dataclass(frozen=True)
class EndConditions:
    """What holds at one via point.

    Attributes
    ----------
    q, qd : (lower, upper), each [n]
        Infinite where a joint is free.
    rows : tuple of Row
    qdd : (lower, upper), each [n], optional
        None where the acceleration is free.
    leaps : bool
        Whether the acceleration may jump there.
    """

    q: Bounds
    qd: Bounds
    rows: tuple[Row, ...] = ()
    qdd: Bounds | None = None
    leaps: bool = False


@dataclass(frozen=True, eq=False)
class Conditions:
    """Conditions of a whole motion.

    Attributes
    ----------
    robots : tuple of Robot, one a segment
        With the limits that hold there.
    ends : tuple of EndConditions, one a via point
    closed : tuple of str
        Which of "q", "qd", "qdd" are at the end what they are at the start.
    """

    robots: tuple[Robot, ...]
    ends: tuple[EndConditions, ...]
    closed: tuple[str, ...] = ()


def passing(robot: Robot, via: FloatArray) -> Conditions:
    """Return rest at both ends of via points [m,n], and any velocity at the others."""
    free, rest = np.full(via.shape[1], np.inf), np.zeros(via.shape[1])
    still = (rest, rest) if LimitFamily.of(robot).jerk_matters else None
    last = len(via) - 1
    ends = tuple(
        EndConditions((q, q), (rest, rest), qdd=still)
        if k in (0, last)
        else EndConditions((q, q), (-free, free))
        for k, q in enumerate(via)
    )
    return Conditions((robot,) * last, ends)
