"""What a second is worth: how the duration of a fastest motion changes with its data."""

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

STEP = 1e-3  # m: torques are quadratic in where a point mass is, so that any step is exact
ACCURACY = 0.01  # of slopes that are not flagged


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
    least : float
        What a datum must be worth, s, for its slope to be told to about a hundredth: slopes are
        those of the duration with its smoothing, which changes with the datum, too, and with what
        the solver left of its barrier, so of a limit that the motion only comes near to they say
        nothing. Rows of the table below it are flagged.
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
        """Titles of the limits that bind for sure."""
        return frozenset(row[0] for row in self.table().rows if row[4] == "yes")

    def table(self) -> Table:
        """Return what one unit more of each bound that matters saves, the most for a percent
        first.
        """
        family = LimitFamily.of(self.robot)
        rows = []
        for side, slopes in (("lower", self.lower), ("upper", self.upper)):
            for key, values in slopes.items():
                if key not in family:
                    continue
                member = family[key]
                bounds = getattr(member, side)
                for joint, slope in enumerate(values):
                    # one that varies is no number
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
            notes.append("what barely binds may cease to with a step: its slope is not sure")
        return Table(columns, rows, notes=notes)

    def plot(self, axes: GivenAxes | None = None) -> DrawnAxes:
        """Give bars of what one percent of each limit saves: :func:`microbot_ocp.plots.prices`."""
        return view_for(self, "plot")(self, axes)


@dataclass(frozen=True, eq=False)
class DurationLine:
    """The shortest duration over one datum of a task, with its slopes.

    Attributes
    ----------
    name, unit : str
        Of the datum.
    values : array [K]
        In its unit.
    duration : array [K]
        s; NaN where nothing was found.
    slope : array [K]
        s per unit, by the multipliers of each solve; NaN likewise.
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
        """Before which values [K] other limits bind than at the value before: slopes end there."""
        pairs = zip(self.binding, self.binding[1:], strict=False)
        return np.array([False, *(before != after for before, after in pairs)])

    def table(self) -> Table:
        """Return one row a value, with the limits that begin (+) and cease (-) to bind."""
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
    """Return slopes of the duration; see :meth:`microbot_ocp.Motion.sensitivities`."""
    multipliers = motion.provenance.get("multipliers")
    if not multipliers or "rows" not in multipliers:
        raise InputError(
            "motion has no multipliers: those of time_optimal and prepared solvers through via "
            "points have"
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
        with interpreted():  # arms with a payload are met once
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
