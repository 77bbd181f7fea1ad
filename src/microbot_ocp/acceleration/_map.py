"""Accelerations that torque allows over payload and speed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.showing import DrawnAxes, GivenAxes, view_for
from microbot_ocp._base.table import Column, Table
from microbot_ocp.acceleration._limits import AccelerationLimits, acceleration_limits
from microbot_ocp.robot import Robot


@dataclass(frozen=True, eq=False)
class AccelerationMap:
    """One acceleration for all joints, for each of some payloads and speeds.

    Attributes
    ----------
    payloads : array [P]
        Largest ones, kg; every limit holds for less, too.
    speeds : array [S]
        Shares of the velocity limits.
    limits : tuple of tuple of AccelerationLimits
        By payload, then by speed.
    """

    payloads: FloatArray
    speeds: FloatArray
    limits: tuple[tuple[AccelerationLimits, ...], ...]

    @property
    def qdd_max(self) -> FloatArray:
        """Proved accelerations [P,S], rad/s^2 (m/s^2); zero where gravity or speed need all."""
        return np.array([[cell.qdd_max.min() for cell in row] for row in self.limits])

    @property
    def broken(self) -> FloatArray:
        """Accelerations [P,S] that a known state breaks, rad/s^2 (m/s^2)."""
        return np.array([[cell.broken.min() for cell in row] for row in self.limits])

    def table(self) -> Table:
        """Return proved accelerations, a row for every payload and a column for every speed."""
        heads = [f"{100 * share:.3g} % speed" for share in self.speeds]
        columns = [Column("payload", "kg", "g"), *(Column(h, "rad/s^2", ".3g") for h in heads)]
        rows = zip(self.payloads.tolist(), self.qdd_max.tolist(), strict=True)
        return Table(columns, [[load, *values] for load, values in rows])

    def plot(self, guess: float | None = None, axes: GivenAxes | None = None) -> DrawnAxes:
        """Draw them over the speed, with a driver's guess, rad/s^2:
        :func:`microbot_ocp.plots.acceleration_map`.
        """
        return view_for(self, "plot")(self, guess, axes)


def acceleration_map(
    robot: Robot,
    payloads: Sequence[float],
    speeds: Sequence[float] = (0.0, 0.25, 0.5, 0.75, 1.0),
    **settings: Any,
) -> AccelerationMap:
    """Return the equal accelerations that torque allows over payload and speed.

    Parameters
    ----------
    robot : Robot
    payloads : sequence of float
        kg, rising; each limit is for all payloads from zero on.
    speeds : sequence of float
        Shares of the velocity limits, rising.
    **settings
        Others of :func:`microbot_ocp.acceleration_limits`, such as ``work`` for each.

    Raises
    ------
    InputError
        As :func:`microbot_ocp.acceleration_limits`; nothing to look at.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> robot = mo.load_robot("planar_2r")
    >>> found = mo.acceleration.acceleration_map(robot, [0.0, 1.0], [0.0, 0.2])
    >>> bool((found.qdd_max[0] >= found.qdd_max[1]).all())
    True
    """
    axes = {"payloads": payloads, "speeds": speeds}
    loads, shares = (checks.array(name, given, (None,)) for name, given in axes.items())
    for name, values in (("payloads", loads), ("speeds", shares)):
        if not values.size or (np.diff(values) <= 0.0).any():
            raise InputError(f"{name} must be rising numbers, not {checks.shown(values.tolist())}")
    settings = {"equal": "ratios" not in settings} | settings
    limits = tuple(
        tuple(acceleration_limits(robot, (0.0, load), speed=share, **settings) for share in shares)
        for load in loads
    )
    return AccelerationMap(loads, shares, limits)
