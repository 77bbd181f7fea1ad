"""Map of the accelerations that torque allows, over payload and speed."""

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
    """Acceleration limits over a grid of payloads and speeds, one value for all joints.

    Attributes
    ----------
    payloads : array [P]
        Largest payloads, kg; each limit holds for smaller payloads as well.
    speeds : array [S]
        Largest speeds as shares of the velocity limits.
    limits : tuple of tuple of AccelerationLimits
        Limits of every cell: ``limits[p][s]`` belongs to payload p and speed s.
    """

    payloads: FloatArray
    speeds: FloatArray
    limits: tuple[tuple[AccelerationLimits, ...], ...]

    @property
    def qdd_max(self) -> FloatArray:
        """Proved accelerations [P,S], rad/s^2 (m/s^2); zero where no torque is left for any."""
        return np.array([[cell.qdd_max.min() for cell in row] for row in self.limits])

    @property
    def broken(self) -> FloatArray:
        """Accelerations [P,S] at which a known state exceeds a torque, rad/s^2 (m/s^2)."""
        return np.array([[cell.broken.min() for cell in row] for row in self.limits])

    def table(self) -> Table:
        """Return the proved accelerations, one row for each payload, one column for each speed."""
        heads = [f"{100 * share:.3g} % speed" for share in self.speeds]
        columns = [Column("payload", "kg", "g"), *(Column(h, "rad/s^2", ".3g") for h in heads)]
        rows = zip(self.payloads.tolist(), self.qdd_max.tolist(), strict=True)
        return Table(columns, [[load, *values] for load, values in rows])

    def plot(self, guess: float | None = None, axes: GivenAxes | None = None) -> DrawnAxes:
        """Draw the accelerations over the speed with :func:`microbot_ocp.plots.acceleration_map`.

        ``guess`` is the acceleration limit of a driver to compare with, rad/s^2.
        """
        return view_for(self, "plot")(self, guess, axes)


def acceleration_map(
    robot: Robot,
    payloads: Sequence[float],
    speeds: Sequence[float] = (0.0, 0.25, 0.5, 0.75, 1.0),
    **settings: Any,
) -> AccelerationMap:
    """Return the largest acceleration of all joints for each payload and speed.

    Parameters
    ----------
    robot : Robot
    payloads : sequence of float
        Largest payloads, kg, rising; each limit holds for all payloads from zero to it.
    speeds : sequence of float
        Largest speeds as shares of the velocity limits, rising.
    **settings
        Further arguments of :func:`microbot_ocp.acceleration_limits`; ``work`` holds for each cell.

    Raises
    ------
    InputError
        Payloads or speeds that are empty or do not rise, and every error of
        :func:`microbot_ocp.acceleration_limits`.

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
