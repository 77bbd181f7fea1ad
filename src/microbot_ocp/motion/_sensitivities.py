"""What a second is worth: how the duration of a fastest motion changes with its data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.showing import DrawnAxes, GivenAxes, view_for
from microbot_ocp._base.table import Column, Table
from microbot_ocp.limits import LimitFamily
from microbot_ocp.robot import Robot

if TYPE_CHECKING:
    from microbot_ocp.motion._motion import Motion

STEP = 1e-3  # m: torques are quadratic in where a point mass is, so that any step is exact


@dataclass(frozen=True, eq=False)
class Sensitivities:
    """Slopes of the duration of a fastest motion, where the same limits stay active.

    Attributes
    ----------
    robot : Robot
    duration : float
        s.
    lower, upper : mapping from the key of a limit to array [k]
        s per unit of the bound: what one more of it changes. A larger upper bound saves time, so
        that its slopes are not above 0.
    via : array [m,n]
        s/rad (s/m) of the via points.
    payload_mass : float
        s/kg of a point mass at the tool's origin; NaN without masses.
    payload_place : array [3]
        s/m of the place of the payload in the tool frame, with the mass that was given; NaN without
        masses.
    """

    robot: Robot
    duration: float
    lower: Mapping[str, FloatArray]
    upper: Mapping[str, FloatArray]
    via: FloatArray
    payload_mass: float
    payload_place: FloatArray

    def table(self) -> Table:
        """What one unit more of each bound that matters saves, the most for a percent first."""
        family = LimitFamily.of(self.robot)
        rows = []
        for side, slopes in (("lower", self.lower), ("upper", self.upper)):
            for key, values in slopes.items():
                if key not in family:
                    continue
                member = family[key]
                bounds = getattr(member, side)
                for joint, slope in enumerate(values):
                    percent = 0.01 * abs(slope * bounds[joint])
                    if percent > 1e-6 * self.duration:
                        saved = -1e3 * slope * (1.0 if side == "upper" else -1.0)
                        name = f"{member.title(joint)}, {side}"
                        unit = f"ms per {member.units[joint]}"
                        rows.append([name, float(bounds[joint]), saved, unit, 1e3 * percent])
        rows.sort(key=lambda row: -row[-1])
        columns = [
            Column("limit", left=True),
            Column("bound", show=".6g"),
            Column("saves", show=".3g"),
            Column("unit", left=True),
            Column("1 % saves", "ms", ".3g", bar=True),
        ]
        notes = []
        if np.isfinite(self.payload_mass):
            notes = [f"one more kg at the tool costs {1e3 * self.payload_mass:.3g} ms"]
        return Table(columns, rows, notes=notes)

    def plot(self, axes: GivenAxes | None = None) -> DrawnAxes:
        """Bars of what one percent of each limit saves: :func:`microbot_ocp.plots.prices`."""
        return view_for(self, "plot")(self, axes)


def sensitivities_of(
    motion: Motion, robot: Robot, mass: float, center_of_mass: ArrayLike
) -> Sensitivities:
    """Slopes of the duration; see :meth:`microbot_ocp.Motion.sensitivities`."""
    told = motion.provenance.get("multipliers")
    if not told:
        raise InputError(
            "motion has no multipliers: those of time_optimal and prepared solvers through via "
            "points have"
        )
    checks.joints("motion", motion.joint_count, robot)
    load = checks.number("mass", mass, "kg", at_least=0.0)
    place = checks.array("center_of_mass", center_of_mass, (3,), "m")
    by_mass, by_place = np.nan, np.full(3, np.nan)
    if robot.has_dynamics:
        t = np.clip(told["torques"]["t"], 0.0, motion.duration)
        slopes, state = np.array(told["torques"]["slopes"]), motion.sample(t)

        def total(heavy: float, at: FloatArray) -> float:
            loaded = robot.with_payload(heavy, at)
            return float((slopes * loaded.torques_along(*state)["tau"]).sum())

        by_mass = total(load + 1.0, place) - total(load, place)  # torques are affine in it
        sides = [total(load, place + STEP * each) for each in np.vstack([np.eye(3), -np.eye(3)])]
        by_place = (np.array(sides[:3]) - np.array(sides[3:])) / (2.0 * STEP)
    lower, upper = (
        {key: np.array(values) for key, values in told[side].items()} for side in ("lower", "upper")
    )
    via = np.array(told["via"])
    return Sensitivities(robot, motion.duration, lower, upper, via, by_mass, by_place)
