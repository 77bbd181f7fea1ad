"""Coupled joints: one coordinate drives several joints of a chain.

The N joints of a chain have positions ``q_chain = S q + offsets``, with one entry in each row of
S [N,n]. Their velocities and accelerations are ``S qd`` and ``S qdd``; by virtual work the torques
of the coordinates are ``S' tau_chain``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.limits import JOINT_QUANTITIES, JointLimits, Limits

Mimic = Mapping[str, tuple[str, float, float]]  # joint -> joint that it follows, factor, offset


@dataclass(frozen=True, eq=False)
class Coupling:
    """All N joints of a chain in which some joints follow others.

    Attributes
    ----------
    names : tuple of str
        Names of the joints, from the base outward.
    types : tuple of str
        "revolute" or "prismatic".
    drivers : tuple of int
        Index of the joint that each one follows, from 0; its own index for a coordinate.
    factors, offsets : array [N]
        Factor and offset of the position; 1 and 0 for a coordinate.
    """

    names: tuple[str, ...]
    types: tuple[Any, ...]
    drivers: tuple[int, ...]
    factors: FloatArray
    offsets: FloatArray

    @cached_property
    def rows(self) -> list[int]:
        """Indices [n] of the joints that are coordinates."""
        return [row for row, driver in enumerate(self.drivers) if row == driver]

    @cached_property
    def following(self) -> list[int]:
        """Indices of the joints that follow others."""
        return [row for row, driver in enumerate(self.drivers) if row != driver]

    @cached_property
    def matrix(self) -> FloatArray:
        """Matrix S [N,n]."""
        return self.factors[:, None] * np.equal.outer(self.drivers, self.rows)

    @property
    def mimic(self) -> dict[str, tuple[str, float, float]]:
        """Following joints by name, each with its driver, factor and offset."""
        return {
            self.names[k]: (
                self.names[self.drivers[k]],
                float(self.factors[k]),
                float(self.offsets[k]),
            )
            for k in self.following
        }

    def positions(self, q: FloatArray) -> FloatArray:
        """Return positions [...,N] of all joints from coordinates [...,n]."""
        return q @ self.matrix.T + self.offsets

    def joined(self, limits: JointLimits) -> JointLimits:
        """Return the tightest limits [n] of the coordinates from the limits of all joints.

        Torque limits are those of the coordinates, whose drives also move the following joints.

        Raises
        ------
        InputError
            No position of a coordinate is within all its position limits.
        """
        bounds: dict[str, Any] = {}
        for key in JOINT_QUANTITIES:
            shift = self.offsets if key == "q" else 0.0
            ends = (np.array(limits.bounds(key)) - shift) / self.factors
            if key.startswith("tau"):
                ends[:, self.following] = [[-np.inf], [np.inf]]
            groups = [ends[:, np.equal(self.drivers, row)] for row in self.rows]
            # A negative factor exchanges the bounds, so each end is sorted by min and max.
            low = np.array([group.min(axis=0).max() for group in groups])
            high = np.array([group.max(axis=0).min() for group in groups])
            for row in np.array(self.rows)[low > high].tolist():
                names = [self.names[k] for k, driver in enumerate(self.drivers) if driver == row]
                raise InputError(
                    f"joints {', '.join(map(repr, names))} move together, but no position is "
                    "within the limits of all"
                )
            bounds[f"{key}_min"], bounds[f"{key}_max"] = low, high
        return Limits(**bounds, also=limits.also).for_joints(len(self.rows))

    def spread(self, limits: JointLimits) -> JointLimits:
        """Return limits [N] of all joints from those of the coordinates."""
        bounds: dict[str, Any] = {}
        for key in JOINT_QUANTITIES:
            shift = self.offsets if key == "q" else 0.0
            columns = np.array(limits.bounds(key))[:, [self.rows.index(k) for k in self.drivers]]
            ends = columns * self.factors + shift
            if key.startswith("tau"):
                ends[:, self.following] = [[-np.inf], [np.inf]]
            bounds[f"{key}_min"], bounds[f"{key}_max"] = ends.min(axis=0), ends.max(axis=0)
        return Limits(**bounds).for_joints(len(self.drivers))


def coupling_of(names: Sequence[str], types: Sequence[Any], mimic: Mimic) -> Coupling:
    """Return the coupling of joints that follow others; chains of followers are resolved.

    Raises
    ------
    InputError
        A joint is not in the chain or follows itself, a factor is zero, or a value is not finite.
    """
    drivers, factors, offsets = [], [], []
    for name in mimic:
        checks.one_of("joint that follows another", name, names)
    for name in names:
        at, factor, offset, passed = name, 1.0, 0.0, set[str]()
        while at in mimic:
            if at in passed:
                raise InputError(f"joint {name!r} follows itself, by way of {sorted(passed)}")
            passed.add(at)
            driver, times, plus = mimic[at]
            checks.one_of(f"joint that {at!r} follows", driver, names)
            times = checks.number(f"factor of joint {at!r}", times)
            if times == 0.0:
                raise InputError(f"factor of joint {at!r}, which follows {driver!r}, must not be 0")
            plus = checks.number(f"offset of joint {at!r}", plus)
            at, factor, offset = driver, factor * times, offset + factor * plus
        drivers.append(names.index(at))
        factors.append(factor)
        offsets.append(offset)
    chain = tuple(names), tuple(types), tuple(drivers)
    return Coupling(*chain, np.array(factors), np.array(offsets))
