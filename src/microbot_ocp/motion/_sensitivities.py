"""Derivatives of the shortest duration with respect to limits, via points and payload."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.codegen import interpreted
from microbot_ocp._base.showing import DrawnAxes, GivenAxes, view_for
from microbot_ocp._base.table import Column, Table
from microbot_ocp.limits import LimitFamily
from microbot_ocp.robot import Robot

if TYPE_CHECKING:
    from microbot_ocp.motion._motion import Motion

# M; torques are quadratic in the position of a point mass, so differences of any step are exact.
STEP = 1e-3
ACCURACY = 0.01  # relative error of slopes that are not flagged


@dataclass(frozen=True, eq=False)
class Sensitivities:
    """Derivatives of the shortest duration, valid while the set of active limits does not change.

    Attributes
    ----------
    robot : Robot
    duration : float
        Shortest duration, s.
    lower, upper : mapping from the key of a limit to array [k]
        Derivatives with respect to the bounds, s per unit. A larger upper bound shortens the
        motion, so the derivatives of ``upper`` are at most 0.
    via : array [m,n]
        Derivatives with respect to the via points, s/rad (s/m).
    payload_mass : float
        Derivative with respect to a point mass at the tool's origin, s/kg; NaN without masses.
    payload_place : array [3]
        Derivative with respect to the payload's position in the tool frame, at the given mass,
        s/m; NaN without masses.
    least : float
        Smallest effect |derivative * bound|, s, at which a derivative is accurate to about 1 %.
        The derivatives include changes of the smoothing and of the solver's barrier term, which
        hide the effect of limits that the motion only approaches. The table flags rows below it.
    """

    robot: Robot
    duration: float
    lower: Mapping[str, FloatArray]
    upper: Mapping[str, FloatArray]
    via: FloatArray
    payload_mass: float
    payload_place: FloatArray
    least: float

    @property
    def binding(self) -> frozenset[str]:
        """Titles of the limits that certainly bind."""
        return frozenset(row[0] for row in self.table().rows if row[4] == "yes")

    def table(self) -> Table:
        """Return the time saved by one unit more of each relevant bound, largest effect first."""
        family = LimitFamily.of(self.robot)
        rows = []
        for side, slopes in (("lower", self.lower), ("upper", self.upper)):
            for key, values in slopes.items():
                if key not in family:
                    continue
                member = family[key]
                bounds = getattr(member, side)
                for joint, slope in enumerate(values):
                    # A bound that varies along the motion is NaN.
                    worth = abs(slope * bounds[joint]) if np.isfinite(bounds[joint]) else 0.0
                    if worth > ACCURACY * self.least:
                        saved = -1e3 * slope * (1.0 if side == "upper" else -1.0)
                        name = f"{member.title(joint)}, {side}"
                        unit = f"ms per {member.units[joint]}"
                        flag = "yes" if worth > self.least else "barely"
                        rows.append([name, float(bounds[joint]), saved, unit, flag, 10.0 * worth])
        rows.sort(key=lambda row: -row[-1])
        columns = [
            Column("limit", left=True),
            Column("bound", show=".6g"),
            Column("saves", show=".3g"),
            Column("unit", left=True),
            Column("binds", left=True),
            Column("1 % saves", "ms", ".3g", bar=True),
        ]
        notes = []
        if np.isfinite(self.payload_mass):
            notes = [f"one more kg at the tool costs {1e3 * self.payload_mass:.3g} ms"]
        if any(row[4] == "barely" for row in rows):
            notes.append("a limit that barely binds may become inactive: its slope is uncertain")
        return Table(columns, rows, notes=notes)

    def plot(self, axes: GivenAxes | None = None) -> DrawnAxes:
        """Return bars of the time saved by 1 % of each limit: :func:`microbot_ocp.plots.prices`."""
        return view_for(self, "plot")(self, axes)


@dataclass(frozen=True, eq=False)
class DurationLine:
    """Shortest duration as a function of one datum of a task, with its derivatives.

    Attributes
    ----------
    name, unit : str
        Name and unit of the datum.
    values : array [K]
        Values of the datum, in its unit.
    duration : array [K]
        Shortest durations, s; NaN where none was found.
    slope : array [K]
        Derivatives from the multipliers of each solve, s per unit; NaN where none was found.
    binding : tuple of frozenset of str
        Titles of the limits that bind at each value.
    """

    name: str
    unit: str
    values: FloatArray
    duration: FloatArray
    slope: FloatArray
    binding: tuple[frozenset[str], ...]

    @property
    def changes(self) -> np.ndarray:
        """Mask [K] of the values at which other limits bind than at the value before."""
        pairs = zip(self.binding, self.binding[1:], strict=False)
        return np.array([False, *(before != after for before, after in pairs)])

    def table(self) -> Table:
        """Return one row per value, with the limits that begin (+) and cease (-) to bind."""
        columns = [
            Column(self.name, self.unit, ".6g"),
            Column("T", "s", ".4f"),
            Column("slope", f"ms/{self.unit}" if self.unit else "ms", ".4g"),
            Column("limits that bind", left=True),
        ]
        rows, before = [], frozenset()
        for value, T, slope, now in zip(
            self.values, self.duration, self.slope, self.binding, strict=True
        ):
            changed = [f"+ {each}" for each in sorted(now - before)]
            changed += [f"- {each}" for each in sorted(before - now)]
            rows.append([float(value), float(T), 1e3 * float(slope), ", ".join(changed)])
            before = now
        return Table(columns, rows)

    def plot(self, axes: GivenAxes | None = None) -> DrawnAxes:
        """Return the duration over the datum: :func:`microbot_ocp.plots.duration_line`."""
        return view_for(self, "plot")(self, axes)


def sensitivities_of(
    motion: Motion, robot: Robot, mass: float, center_of_mass: ArrayLike
) -> Sensitivities:
    """Return derivatives of the duration; see :meth:`microbot_ocp.Motion.sensitivities`."""
    multipliers = motion.provenance.get("multipliers")
    if not multipliers or "rows" not in multipliers:
        raise InputError(
            "motion has no multipliers: only motions of time_optimal and of prepared solvers "
            "through via points have them"
        )
    checks.joints("motion", motion.joint_count, robot)
    load = checks.number("mass", mass, "kg", at_least=0.0)
    place = checks.array("center_of_mass", center_of_mass, (3,), "m")
    by_mass, by_place = np.nan, np.full(3, np.nan)
    if robot.has_dynamics:
        limited = []
        for key, row in multipliers["rows"].items():
            samples = motion.samples(np.minimum(row["t"], motion.duration))
            limited.append((key, samples, np.array(row["slopes"])))

        def total(heavy: float, at: FloatArray) -> float:
            family = LimitFamily.of(robot.with_payload(heavy, at))
            return sum(
                float((slopes * family.values(samples, [key])[key].value).sum())
                for key, samples, slopes in limited
                if key in family
            )

        unloaded = total(0.0, place)
        with interpreted():  # each payload is used once
            by_mass = total(1.0, place) - unloaded  # torques are affine in it
            by_place = np.zeros(3)
            if load:
                steps = STEP * np.vstack([np.eye(3), -np.eye(3)])
                sides = np.array([total(load, place + step) for step in steps])
                by_place = (sides[:3] - sides[3:]) / (2.0 * STEP)
    lower, upper = (
        {key: np.array(values) for key, values in multipliers[side].items()}
        for side in ("lower", "upper")
    )
    via, least = np.array(multipliers["via"]), multipliers["beside"] / ACCURACY
    return Sensitivities(robot, motion.duration, lower, upper, via, by_mass, by_place, least)
